/* voxrt.h - v0.1.0 - sparse voxel octrees: build, file, ray traversal, pictures - MIT OR Unlicense, see end of file
   SPDX-License-Identifier: MIT OR Unlicense

   CONTENTS
   The declarations come first. Sections of the implementation, to be found by searching for >>name:
   @platform      compiler, instruction sets, asserts, bytes
   @memory        every byte comes from here: counted, limited, aligned
   @threads       one parallel-for, error reports
   @math          small vectors, polynomials instead of libm, Morton codes, octahedral normals, sRGB, hashes
   @core          the bytes of a tree
   @normals       the thesis' codes of normals; which code a tree has
   @palette       colours become indices
   @voxelize      triangles -> filled leaves with mean colours and normals
   @fill          the inside of closed hulls
   @tree          leaves -> nodes of all levels -> attributes of the levels of detail; look-up
   @share         equal parts of a tree stored once
   @octree        the octree of the thesis: make, change, convert
   @format_v4     files of the thesis
   @format        version 5 files of trees
   @trace         rays through the tree: scalar, SSE and AVX2; common starts of tiles
   @trace_octree  rays through the octree of the thesis: single, and packets of four
   @shade         surfaces -> colours; lights and shadows
   @render        camera -> rays -> tiles -> buffers
   @post          work on finished pictures: encode, blur, keep to a frame time
   @scene         geometry in other places, many geometries as one
   @columns       a grid of bit columns for what moves: voxelising into it, hierarchy, rays
   @gi            a scene of meshes and lights in columns: what cells look like, how much light falls on them
   @gather        light from other surfaces: G-buffers -> pictures
   @misc          names and versions

   DO THIS
   In one C or C++ file, and only there:
       #define VOXRT_IMPLEMENTATION
       #include "voxrt.h"
   and #include "voxrt.h" without the macro wherever else you use it. Link with -lm -lpthread.
   -ffp-contract=off on the command line is a second guard for equal bits on all machines (see DETERMINISM).

   A PROGRAM (examples/minimal_voxrt.c; png.h beside it writes the picture)

    #include "support/png.h"
    #define VOXRT_IMPLEMENTATION
    #include "voxrt.h"

    enum { N = 192, WIDTH = 800, HEIGHT = 500 };
    static float position[N * N][3];
    static uint8_t color[N * N][3], pixels[WIDTH * HEIGHT][4];
    static uint32_t triangle[N * N * 2][3];

    static void make_torus(void) {
        for (uint32_t i = 0; i < N * N; i++) {
            const uint32_t up = i / N * N + (i + 1) % N, right = (i + N) % (N * N), both = (up + N) % (N * N);
            const uint32_t corners[6] = {i, up, both, i, both, right};
            const float a = 6.2831853f / N * (float)(i / N), b = 6.2831853f / N * (float)(i % N);
            const float r = 1.0f + 0.4f * cosf(b), p[3] = {r * cosf(a), 0.4f * sinf(b), r * sinf(a)};
            memcpy(position[i], p, sizeof p);
            memcpy(triangle[2 * i], corners, sizeof corners);
            for (int k = 0; k < 3; k++) color[i][k] = (uint8_t)(160.0f + 90.0f * sinf(a + 2.0f * (float)k));
        }
    }

    int main(int argc, char **argv) {
        const voxrt_mesh mesh = {.positions = position[0], .vertex_count = N * N, .vertex_rgb = color[0],
                                 .indices = triangle[0], .triangle_count = 2 * N * N};
        const voxrt_build_desc build = {.resolution = 512};               // voxels along the longest side
        const voxrt_render_desc render = {.samples = 16, .shadows = 1};   // the camera frames the torus
        const voxrt_image image = {.width = WIDTH, .height = HEIGHT, .rgba8 = pixels[0]};
        voxrt_tree *tree = NULL;
        sup_error err;

        make_torus();
        voxrt_result result = voxrt_tree_build(&build, &mesh, NULL, &tree);
        if (result == VOXRT_OK) result = voxrt_render(&render, tree, &image, NULL);
        voxrt_tree_destroy(tree);

        if (result != VOXRT_OK) (void)sup_fail(&err, "%s", voxrt_result_string(result));
        else if (!sup_png_write8(argc > 1 ? argv[1] : "voxrt.png", pixels[0], WIDTH, HEIGHT, 4, &err)) return 0;
        fprintf(stderr, "%s\n", err.text);
        return 1;
    }

   WHAT IT DOES
   - Triangle mesh -> sparse voxels of 2^1 to 2^16 cells along an axis, with colours and normals; no gaps: 6-separating
     or conservative. Or a list of voxels, up to 2^20 along an axis. Fills closed hulls.
   - Keeps them as a tree of 4x4x4 nodes in which each octree level can be addressed: 5 to 8 bits a voxel for geometry,
     0.1 to 3 when equal parts are stored once, 2 bytes a cell (of any level) for normals, 0 to 2 bytes for colours as
     a rule. Saves and loads it, or maps a file into memory.
   - Traces rays: closest hit, any hit, with a cone for level of detail, 1 ray or millions, any order.
   - Draws pictures: camera, lights, shadows, anti-aliasing, progressive pictures, level of detail by pixels, heat maps,
     depth, normals, ids; of many trees, moved and repeated, mixed with other geometry through two callbacks; with steps
     of the caller's own for rays, shading, tiles and frames.
   - Voxelises scenes that move into bit columns, in every frame; traces rays through them; finds the light that bounces
     between surfaces: gathering with light kept on cells, paths, ambient occlusion; G-buffers, a filter, tone mapping.
   - Has the octree, the files and the packet tracer of the thesis that it comes from, for comparison.

   WHAT IT DOES NOT DO
   - No reflection or refraction; no textures (colours come per vertex or per triangle).
   - No animation. A tree does not change once it is built, its instances may move; the octree of the thesis can be
     edited voxel by voxel.
   - No smooth surfaces: a voxel is a cube. Close up it is seen as one, with a shading normal.
   - No mesh files, no picture files, no window: examples/support has readers, a PNG writer and a command line.
   - No streaming from disk, no GPU.

   LIMITS
   depth of a tree            20 (VOXRT_MAX_DEPTH): 2^20 cells along an axis; of a voxelised mesh 16
   filled voxels of a tree    2^32 - 2; and 2^32 - 1 nodes
   triangles                  as many as memory holds
   colours of a palette       2^24; in the octree of the thesis 32767
   threads                    64
   lights, geometry, rays     as many as memory holds
   stack                      less than 16 KB in one function, less than 64 KB in all

   OPTIONS
   macro                     meaning                                                  default       same in all files?
   VOXRT_IMPLEMENTATION      emit the code, in exactly one file                       off           no
   VOXRT_STATIC              all functions static; only where the code is, too        off           yes
   VOXRT_DEF                 what stands before declarations                          extern/static yes
   VOXRT_MALLOC(size,user)   default allocator, 16-byte aligned; both or neither      malloc        code only
   VOXRT_FREE(ptr,size,user) its other half                                           free          code only
   VOXRT_ASSERT(cond)        internal checks, and calls that break a contract         assert        code only
   VOXRT_NO_STDIO            no functions with file names, no <stdio.h>               off           yes
   VOXRT_NO_THREADS          never start a thread; env.parallel still works           off, wasm: on code only
   VOXRT_NO_SIMD             scalar code only                                         off           code only
   VOXRT_NO_AVX2             no AVX2                                                  off           code only
   VOXRT_NO_GI               no bit columns and no global illumination                off           yes
   VOXRT_ALLOW_FAST_MATH     accept -ffast-math; nothing is promised then             #error        code only
   No macro changes a struct. The instruction set is chosen when the program runs; desc.isa can lower it.

   MEMORY
   All of it comes through desc.env: its allocator, else VOXRT_MALLOC, else malloc. An object keeps its allocator until
   it is destroyed. env.memory_limit bounds what one call and its results hold at once. Tracing and drawing allocate
   nothing. When memory runs out a call frees what it had and returns VOXRT_ERR_NO_MEMORY.
   Building holds 8 to 18 bytes a voxel at its peak, most with many colours (voxrt_build_stats.peak_bytes); a tree takes
   3 to 6 bytes a voxel with normals, about 1 without normals and colours.

   THREADS
   A call uses env.thread_count threads (0: one per core; 1: never more than the caller's), started and joined within
   the call, with stacks of 512 KB. env.parallel hands the work to the host's job system instead. voxrt_trace and
   voxrt_occluded always run on the calling thread. Trees and octrees may be read by any number of threads at once;
   changing or destroying one needs it for itself. There is no global state, nothing has to be initialised.

   DETERMINISM
   The same input gives the same bits: for any number of threads, any instruction set, any order of triangles, any
   grouping of rays; with gcc or clang at any optimisation. Work is cut by fixed rules, sums are integers or have a
   fixed order, libm is not used but for sqrt, fused multiply-add is switched off (by pragmas in this file).
   x87 code (-m32 without -mfpmath=sse), -std=c99 on s390x (without -fexcess-precision=fast) and -ffast-math break it.

   ERRORS
   Functions that can fail return a voxrt_result and set their outputs to NULL or 0 first. env.error receives the place
   (byte, triangle, voxel) and a sentence. Bad triangles are left out and counted, unless desc.strict. Bad rays miss and
   are counted. A desc has to be zeroed (memset, = {0} or = {} in C++); voxrt checks its first and last member.
   The library never prints, never exits. Loading is safe for any bytes; voxrt_load_desc.trust_input is not.

   COORDINATES AND UNITS
   Right-handed world, any unit. Grid cell (x, y, z) covers world_origin + voxel_size * [x, x+1) and so on. Cells of
   octree level l have an edge of 2^(depth-l) voxels; level 0 is the root (the thesis counts it as level 1). Face codes
   0 to 5: -x +x -y +y -z +z. t is in lengths of dir; depth is the distance along the viewing axis. Row 0 of a picture
   is on top, pixel (i, j) has its centre at (i+0.5, j+0.5), fov_y is the vertical angle.
   Colours: bytes are sRGB, floats are linear; rgba is premultiplied, rgba8 is not.

   FILE FORMAT
   Version 5 (written by voxrt_tree_save_*) holds a tree with everything, raw or entropy coded, checked by checksums;
   version 4 is the thesis' file. docs/formats.md has every byte. The format's version is not the library's.

   ACCURACY
   Voxelising   Vertices are snapped to 1/2^min(8, 20-depth) of a voxel: moved by at most 1/512 voxel along an axis up
                to 4096 cells, 1/32 at 65536. From there on every decision is exact integer arithmetic.
   Rays         Origin and crossings with cell faces are double precision, also for origins far away. The cells that a
                ray visits are a 6-connected path ordered by these crossings: it cannot slip through a 6-separating
                surface. t is rounded once, to float.
   Detail       With cone_width, cone_spread or tolerance a ray stops at a cell no wider than its footprint; with 0 at
                voxels only.
   Normals      Octahedral, 16 bits: at most 0.64 degrees off, 0.32 on average. A tree that was made from an octree of
                the thesis keeps the normals it had, in the thesis' 16 bits.
   Colours      Exact while they fit into the palette. Levels of detail: means in linear light.

   REFERENCES
   M. Bohnen: Ray Tracing von Volumendaten auf Basis des Augenblick-SDK. Diplomarbeit, Univ. Koblenz-Landau, 2009
       (`the thesis': octree, v4 files, packets, start grid, pair-merged palette)
   S. Thiedemann: Voxelbasierte globale Beleuchtung in dynamischen Szenen. Diplomarbeit, Univ. Koblenz-Landau, 2010
       (`thesis (2010)': columns, their hierarchy, gathering, paths)
   S. Laine: A Topological Approach to Voxelization. Computer Graphics Forum 32(4), 2013 (6-separating targets)
   M. Schwarz, H.-P. Seidel: Fast Parallel Surface and Solid Voxelization on GPUs. ACM TOG 29(6), 2010 (26-separating)
   J. Amanatides, A. Woo: A Fast Voxel Traversal Algorithm for Ray Tracing. Eurographics 1987 (crossings as events)
   K. Museth: VDB: High-Resolution Sparse Volumes with Dynamic Topology. ACM TOG 32(3), 2013 (wide nodes with masks)
   S. Laine, T. Karras: Efficient Sparse Voxel Octrees. I3D 2010 (stack and common ancestor by bits, beams, post filter)
   I. Wald et al.: Ray Tracing Animated Scenes using Coherent Grid Traversal. ACM TOG 25(3), 2006 (frusta slab by slab)
   T. Dekker: A Floating-Point Technique for Extending the Available Precision. Numer. Math. 18, 1971 (far origins)
   Z. Cigolle et al.: A Survey of Efficient Representations for Independent Unit Vectors. JCGT 3(2), 2014 (normals)
   B. Ottosson: A perceptual color space for image processing, 2020 (Oklab)
   J. Ward: Hierarchical Grouping to Optimize an Objective Function. JASA 58, 1963; W. Equitz: A New Vector
       Quantization Clustering Algorithm. IEEE Trans. ASSP 37(10), 1989 (palette by pairwise nearest neighbours)
   V. Kaempe, E. Sintorn, U. Assarsson: High Resolution Sparse Voxel DAGs. ACM TOG 32(4), 2013 (equal parts once)
   B. Dado et al.: Geometry and Attribute Compression for Voxel Scenes. Computer Graphics Forum 35(2), 2016
   J. Duda: Asymmetric numeral systems. arXiv:1311.2540, 2013 (entropy coding)
   E. Eisemann, X. Decoret: Fast Scene Voxelization and Applications. I3D 2006 (bits of slabs); Single-Pass GPU Solid
       Voxelization. Graphics Interface 2008 (parity of crossings)
   V. Forest et al.: Real-Time Hierarchical Binary-Scene Voxelization. Journal of Graphics Tools 14(3), 2009
   B. Burley: Practical Hash-Based Owen Scrambling. JCGT 9(4), 2020; T. Duff et al.: Building an Orthonormal Basis,
       Revisited. JCGT 6(1), 2017; F. Drago et al.: Adaptive Logarithmic Mapping. Computer Graphics Forum 22(3), 2003
   M. Roberts: The Unreasonable Effectiveness of Quasirandom Sequences, 2018 (sample positions)
   docs/algorithms.md says which equation is where, and what was corrected. */
#ifndef VOXRT_H_INCLUDED
#define VOXRT_H_INCLUDED
#include <stddef.h>
#include <stdint.h>

#define VOXRT_VERSION_MAJOR 0
#define VOXRT_VERSION_MINOR 1
#define VOXRT_VERSION_PATCH 0
#define VOXRT_VERSION (VOXRT_VERSION_MAJOR * 1000000 + VOXRT_VERSION_MINOR * 1000 + VOXRT_VERSION_PATCH)

#define VOXRT_MAX_DEPTH 20          /* a tree has at most 2^20 cells along an axis */
#define VOXRT_MAX_VOXELIZE_DEPTH 16 /* a mesh is voxelised at 2^16 at most (exact 64-bit predicates) */
#define VOXRT_NO_NODE 0xffffffffu   /* voxrt_hit.node of a miss */

#ifndef VOXRT_DEF
#  ifdef VOXRT_STATIC
#    if defined(__GNUC__) || defined(__clang__)
#      define VOXRT_DEF static __attribute__((unused))
#    else
#      define VOXRT_DEF static
#    endif
#  else
#    define VOXRT_DEF extern
#  endif
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* ---- results, memory, threads ---- */

#define VOXRT_RESULT_LIST(X) \
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
    X(ERR_EMPTY, 10, "nothing to build: no usable triangle or voxel") \
    X(ERR_CHECKSUM, 11, "checksum mismatch: the data is damaged")

typedef enum voxrt_result {
#define VOXRTI_X(name, value, text) VOXRT_##name = value,
    VOXRT_RESULT_LIST(VOXRTI_X)
#undef VOXRTI_X
    VOXRT_RESULT_FORCE_32BIT = 0x7fffffff
} voxrt_result;

/* What went wrong and where. `where` is a byte offset, a triangle or a voxel index, as `text` says. */
typedef struct voxrt_error {
    voxrt_result code;
    uint64_t where;
    char text[200];
} voxrt_error;

typedef struct voxrt_allocator {
    void *(*alloc_fn)(size_t size, void *user); /* 16-byte aligned, or NULL; any thread */
    void (*free_fn)(void *ptr, size_t size, void *user);
    void *user;
} voxrt_allocator;

typedef void voxrt_task_fn(void *task_ctx, uint32_t index);
typedef struct voxrt_parallel { /* run task(ctx, i) once for each i in [0, count), return when all are done */
    void (*for_fn)(voxrt_task_fn *task, void *task_ctx, uint32_t count, void *user);
    void *user;
} voxrt_parallel;

/* Where memory, threads and messages come from; part of every desc. All zero: malloc, one thread per core,
   no limit, silent. */
typedef struct voxrt_env {
    voxrt_allocator allocator;
    voxrt_parallel parallel;  /* set: the host's job system runs the work, no thread is started */
    uint32_t thread_count;    /* 0: one per core; 1: never start a thread */
    size_t memory_limit;      /* bytes that one call and its results may hold at once; 0: none */
    int (*progress_fn)(void *user, uint64_t done, uint64_t total); /* non-zero cancels; called by one thread */
    void *progress_user;
    voxrt_error *error;       /* receives the place and the reason of a failure; may be NULL */
} voxrt_env;

/* ---- building ---- */

/* Triangles to voxelise. Borrowed for the call. */
typedef struct voxrt_mesh {
    const float *positions;        /* xyz per vertex, any unit */
    size_t vertex_count;
    size_t position_stride;        /* bytes, 0: 12 */
    const uint32_t *indices;       /* 3 per triangle; NULL: vertices 3i, 3i+1, 3i+2 */
    size_t triangle_count;
    const float *normals;          /* xyz per vertex, need not be unit; NULL: the triangle's own normal */
    size_t normal_stride;          /* bytes, 0: 12 */
    const uint8_t *vertex_rgb;     /* sRGB bytes per vertex, interpolated in linear light; or NULL */
    size_t vertex_rgb_stride;      /* bytes, 0: 3 */
    const uint8_t *triangle_rgb;   /* sRGB bytes, 3 per triangle, wins over vertex_rgb; or NULL */
} voxrt_mesh;

/* One filled cell. */
typedef struct voxrt_voxel {
    uint32_t x, y, z;
    uint8_t rgb[3];        /* sRGB */
    uint8_t has_normal;
    float normal[3];
} voxrt_voxel;

typedef enum voxrt_separating {
    VOXRT_SEPARATING_6 = 0,      /* every 6-connected path through the surface meets a voxel (default) */
    VOXRT_SEPARATING_26 = 1,     /* every voxel the surface touches (conservative) */
    VOXRT_SEPARATING_THESIS = 2, /* the scan converter of the 2009 thesis: has gaps, for comparison */
    VOXRT_SEPARATING_FORCE_32BIT = 0x7fffffff
} voxrt_separating;

typedef enum voxrt_palette_method {
    VOXRT_PALETTE_OKLAB = 0,  /* pairwise nearest neighbour in Oklab, Ward cost, then k-means (default) */
    VOXRT_PALETTE_THESIS = 1, /* pair merging in RGB with drift damping */
    VOXRT_PALETTE_FORCE_32BIT = 0x7fffffff
} voxrt_palette_method;

typedef enum voxrt_lod_method {
    VOXRT_LOD_MEAN = 0,     /* mean colour in linear light, mean normal, weighted by filled leaves (default) */
    VOXRT_LOD_MAJORITY = 1, /* colour of most children, as in the thesis; mean normal of the children */
    VOXRT_LOD_FORCE_32BIT = 0x7fffffff
} voxrt_lod_method;

/* field           zero means
   resolution      1024 cells along the longest side of the mesh
   separating      6-separating
   palette_size    32767 colours (15 bits); up to 16777216
   margin          half a voxel kept free on each side (thesis: the same); a fixed box: set box_size > 0 */
typedef struct voxrt_build_desc {
    uint32_t _begin_zero;
    voxrt_env env;
    uint32_t resolution;
    voxrt_separating separating;
    uint32_t palette_size;
    voxrt_palette_method palette_method;
    voxrt_lod_method lod_method;
    uint32_t disable_colors;  /* 1: one colour (white) for all */
    uint32_t disable_normals; /* 1: shade by the face that was hit */
    uint32_t fill;            /* 1: fill closed hulls; cells get the attributes of the nearest surface voxel */
    uint32_t fill_depth;      /* with fill: only this many voxels deep, 0: all */
    uint32_t strict;          /* 1: bad triangles are an error (FORMAT) instead of being skipped and counted */
    double box_min[3];        /* with box_size > 0: the world cube that maps to the whole grid; up to 1e300 */
    double box_size;
    uint32_t _end_zero;
} voxrt_build_desc;

typedef struct voxrt_build_stats {
    uint64_t triangles;   /* given */
    uint64_t rejected;    /* NaN, infinite or out-of-range index: left out */
    uint64_t degenerate;  /* zero area at grid precision: kept as a line or a point of voxels */
    uint64_t fragments;   /* triangle-voxel pairs */
    uint64_t voxels;      /* filled leaves */
    uint64_t colors_in;   /* distinct colours before the palette */
    uint64_t peak_bytes;  /* most memory held at once */
} voxrt_build_stats;

typedef struct voxrt_tree voxrt_tree;     /* wide tree: 64-bit masks, what everything traces by default */
typedef struct voxrt_octree voxrt_octree; /* the thesis' octree: 8 bytes a voxel, 8 children a block */

typedef struct voxrt_tree_info {
    uint32_t depth;          /* octree levels below the root: 2^depth cells along an axis */
    uint32_t resolution;     /* as asked for at build time, <= 2^depth */
    double world_origin[3];  /* world position of grid corner (0,0,0) */
    double voxel_size;       /* world edge of a leaf voxel */
    uint32_t cell_min[3], cell_max[3]; /* box of the filled leaves, max exclusive */
    uint32_t has_colors, has_normals;
    uint32_t palette_count;
    uint64_t voxel_count;    /* filled leaves */
    uint64_t level_count[VOXRT_MAX_DEPTH + 1]; /* non-empty cells of each octree level, 0 = root */
    uint64_t geometry_bytes; /* masks and what traversal and addressing need */
    uint64_t color_bytes, normal_bytes, total_bytes;
    uint32_t shared;         /* 1: equal parts are stored once (voxrt_tree_share) */
} voxrt_tree_info;

/* Voxelise a mesh and build the tree with colours, normals and all levels of detail.
   desc   in, NULL: all defaults
   mesh   in, borrowed; triangles with a NaN, infinite or missing vertex are skipped and counted
   stats  out, may be NULL
   The result depends on the triangles as a set, not on their order nor on threads. Cost: O(triangles + voxels);
   holds 8 to 18 bytes a voxel at its peak, most with many colours (stats->peak_bytes tells).
   Errors: INVALID_ARG, UNINIT_DESC, RANGE, EMPTY, NO_MEMORY, CANCELLED; with strict FORMAT, error->where is the first
   bad triangle. Thread safety: calls are independent. Source: Laine 2013 (6), Schwarz & Seidel 2010 (26), thesis 3.1.3
   and 3.1.4. */
VOXRT_DEF voxrt_result voxrt_tree_build(const voxrt_build_desc *desc, const voxrt_mesh *mesh, voxrt_build_stats *stats,
                                        voxrt_tree **out_tree);

/* Build a tree from a list of filled cells in any order; of cells given twice the means are kept.
   depth in 1..VOXRT_MAX_DEPTH; coordinates below 2^depth (else RANGE, error->where = the voxel's index). One voxel
   is a unit cube, the grid's corner is the world's origin; desc's box_min and box_size override that.
   Otherwise as voxrt_tree_build. */
VOXRT_DEF voxrt_result voxrt_tree_from_voxels(const voxrt_build_desc *desc, const voxrt_voxel *voxels, size_t count,
                                              uint32_t depth, voxrt_tree **out_tree);

VOXRT_DEF void voxrt_tree_destroy(voxrt_tree *tree); /* NULL is allowed */
VOXRT_DEF void voxrt_tree_get_info(const voxrt_tree *tree, voxrt_tree_info *info);

/* Look up cell (x, y, z) of an octree level (0 = root, depth = leaves).
   Returns 1 and fills `out` (may be NULL) if anything in the cell is filled, else 0. out->normal is a unit vector,
   or zero with has_normal = 0. Any thread. O(depth). */
VOXRT_DEF int voxrt_tree_get(const voxrt_tree *tree, uint32_t level, uint32_t x, uint32_t y, uint32_t z,
                             voxrt_voxel *out);

/* Call fn for every non-empty cell of an octree level in Morton order (x fastest, z slowest bit of each triple).
   fn returns non-zero to stop; that value is returned. */
VOXRT_DEF int voxrt_tree_each(const voxrt_tree *tree, uint32_t level,
                              int (*fn)(void *user, const voxrt_voxel *voxel, uint32_t palette_index), void *user);

/* The palette: 3 sRGB bytes an entry. Owned by the tree. */
VOXRT_DEF const uint8_t *voxrt_tree_palette(const voxrt_tree *tree, uint32_t *out_count);

/* 64-bit hash of occupancy, attributes and placement: equal trees have equal hashes on every machine, shared or not. */
VOXRT_DEF uint64_t voxrt_tree_hash(const voxrt_tree *tree);

/* A copy of a tree in which equal parts are stored once (a directed acyclic graph), or one without that.
   tree   in, either kind; a copy of what is already as asked for
   env    in, NULL: all zero
   Geometry takes a third of the memory on scanned surfaces and less than a tenth on regular ones. Attributes, all
   levels, hits (but for voxrt_hit.node), pictures and the hash are the same; finding an attribute takes a walk down the
   tree. Cost: O(cells), serial but for the coding of colours; holds up to 32 bytes a leaf node, and 8 a cell if there
   are colours, beside both trees. Errors: INVALID_ARG, NO_MEMORY; RANGE: more than 2^32 - 2 cells of all levels
   together, or an unshared tree beyond the limits. Thread safety: any number of calls on one tree.
   Source: Kaempe et al. 2013; attributes kept aside: Dado et al. 2016. */
VOXRT_DEF voxrt_result voxrt_tree_share(const voxrt_tree *tree, const voxrt_env *env, voxrt_tree **out_tree);
VOXRT_DEF voxrt_result voxrt_tree_unshare(const voxrt_tree *tree, const voxrt_env *env, voxrt_tree **out_tree);

/* ---- rays ---- */

typedef enum voxrt_isa {
    VOXRT_ISA_AUTO = 0,
    VOXRT_ISA_SCALAR = 1,
    VOXRT_ISA_SSE = 2,
    VOXRT_ISA_AVX2 = 3,
    VOXRT_ISA_AVX512 = 4, /* the AVX2 kernel: more lanes do not pay here; rays in columns get its registers */
    VOXRT_ISA_FORCE_32BIT = 0x7fffffff
} voxrt_isa;

/* 32 bytes. A hit has t_min <= t < t_max, t in units of dir's length. */
typedef struct voxrt_ray {
    float org[3];
    float t_min;
    float dir[3]; /* need not be unit length; components may be 0 or -0 */
    float t_max;
} voxrt_ray;

/* 24 bytes. On a miss t = INFINITY, node = VOXRT_NO_NODE, level = 0 and the rest 0. */
typedef struct voxrt_hit {
    float t;
    uint32_t cell[3];  /* of the octree level `level` */
    uint32_t node;     /* wide node that holds the cell; in a shared tree many cells may have the same one */
    uint8_t slot;      /* bit of the node's mask, or octant*8 when level is an octant level */
    uint8_t level;     /* octree level of the cell that was hit; the tree's depth unless level of detail stopped it */
    uint8_t face;      /* face through which the ray entered: 0 -x, 1 +x, 2 -y, 3 +y, 4 -z, 5 +z, 6 origin inside */
    uint8_t _reserved;
} voxrt_hit;

/* Added to, so that many calls sum up. rays, hits and bad_rays do not depend on the isa; the work may. */
typedef struct voxrt_stats {
    uint64_t rays, hits, bad_rays;
    uint64_t steps;    /* cells left (outer iterations) */
    uint64_t descents; /* nodes entered (inner iterations) */
} voxrt_stats;

/* field          zero means
   cone_width     a ray is a line. A cell whose edge (world) is <= cone_width + cone_spread * t counts as a leaf
   cone_spread    growth of the footprint per unit of t. Cones meet large cells only inside the box of the filled
                  leaves, and the root only in trees of odd depth
   max_level      no limit; k: octree level k is the finest (k+1 is given, so 1 = root only) */
typedef struct voxrt_trace_desc {
    uint32_t _begin_zero;
    voxrt_isa isa;
    float cone_width, cone_spread;
    uint32_t max_level_plus_1;
    voxrt_stats *stats; /* NULL: not counted, which is faster */
    uint32_t _end_zero;
} voxrt_trace_desc;

/* Closest filled cell along each ray, on the calling thread.
   desc   in, NULL: defaults
   rays   in, [count]; world units
   hits   out, [count]; must not overlap rays
   Rays with a NaN or infinite origin or direction, direction 0, or t_min > t_max report a miss (bad_rays counts
   them). Runs of rays with one origin (camera tiles) are found and start together behind the empty space that all
   of them cross. The cells visited are 6-connected and ordered by exact events: nothing slips through a surface.
   The same bits for every isa and every grouping of rays. Errors: INVALID_ARG, UNINIT_DESC.
   Thread safety: any number of threads on one tree. Allocates nothing. */
VOXRT_DEF voxrt_result voxrt_trace(const voxrt_tree *tree, const voxrt_trace_desc *desc, const voxrt_ray *rays,
                                   voxrt_hit *hits, size_t count);

/* Is anything hit in [t_min, t_max)?  occluded out, [count], 0 or 1; exactly when voxrt_trace reports a hit. */
VOXRT_DEF voxrt_result voxrt_occluded(const voxrt_tree *tree, const voxrt_trace_desc *desc, const voxrt_ray *rays,
                                      uint8_t *occluded, size_t count);

/* One ray; returns 1 on a hit. The scalar path of voxrt_trace. */
VOXRT_DEF int voxrt_trace1(const voxrt_tree *tree, const voxrt_ray *ray, voxrt_hit *hit);

/* Attributes of a hit. rgb: sRGB bytes; normal: unit vector facing as stored, or the face that was hit when the tree
   has no normals. hit must be a hit of this tree. Any thread. */
VOXRT_DEF void voxrt_hit_color(const voxrt_tree *tree, const voxrt_hit *hit, uint8_t rgb[3]);
VOXRT_DEF void voxrt_hit_normal(const voxrt_tree *tree, const voxrt_hit *hit, float normal[3]);

/* ---- the octree of the thesis ---- */

/* 8 bytes. Voxel i of a block of 8 is child i = (x >= mid) + 2 (y >= mid) + 4 (z >= mid) of its parent.
   Normal: (sin t cos p, sin t sin p, cos t) with t = theta pi/256, p = phi pi/128. */
typedef struct voxrt_octree_voxel {
    uint16_t index;    /* 0: transparent; i: palette entry i-1 */
    uint8_t theta;
    int8_t phi;
    uint32_t children; /* number of the block of its 8 children, voxels 8*children...; 0: a leaf */
} voxrt_octree_voxel;

/* field             zero means
   box_min, box_size one voxel is a unit cube and the grid's corner the world's origin; box_size > 0: the world cube
                     that the root covers. Not for from_tree, which keeps the tree's
   lod_majority      inner voxels get the tree's own level of detail. 1: made anew by voxrt_octree_build_lod
   disable_collapse  8 equal leaves become one when the octree is made from a tree
   grid_level        start grid of 64 cells an axis (level 7) for trees that deep; g: 2^(g-1), 1..10
   disable_grid      1: no start grid
   flip_y, flip_z    files whose y or z runs the other way: children and normals are mirrored
   swap_angles       1: files with phi before theta */
typedef struct voxrt_octree_desc {
    uint32_t _begin_zero;
    voxrt_env env;
    double box_min[3], box_size;
    uint32_t lod_majority;
    uint32_t disable_collapse;
    uint32_t grid_level, disable_grid;
    uint32_t flip_y, flip_z, swap_angles;
    uint32_t _end_zero;
} voxrt_octree_desc;

typedef struct voxrt_octree_info {
    uint32_t depth;          /* levels below the root: 2^depth leaf cells along an axis (thesis: level depth + 1) */
    double world_origin[3];  /* world position of grid corner (0,0,0) */
    double voxel_size;       /* world edge of a leaf of the deepest level */
    uint32_t palette_count;
    uint32_t has_normals;
    uint32_t grid_level;     /* 0: none */
    uint64_t voxel_count;    /* nodes + leaves = 8 * nodes + 1 */
    uint64_t node_count, leaf_count;
    uint64_t filled_leaves;  /* leaves that are not transparent, of any size */
    uint64_t level_count[VOXRT_MAX_DEPTH + 1]; /* voxels of each level, 0 = root */
    uint64_t voxel_bytes;    /* 8 * voxel_count, what the thesis counts */
    uint64_t grid_bytes, total_bytes;
} voxrt_octree_info;

/* An octree of one transparent leaf.
   desc     in, NULL: all defaults
   depth    0..VOXRT_MAX_DEPTH
   palette  in, 3 sRGB bytes an entry, copied; palette_count 0..32767 (else RANGE)
   Errors: INVALID_ARG, UNINIT_DESC, RANGE, NO_MEMORY. Thread safety: calls are independent. */
VOXRT_DEF voxrt_result voxrt_octree_create(const voxrt_octree_desc *desc, uint32_t depth, const uint8_t *palette,
                                           uint32_t palette_count, voxrt_octree **out_octree);

/* Convert. Same cells, same palette (index = entry + 1; more than 32767 entries: RANGE), same levels of detail, same
   placement. Octahedral normals become spherical codes, each rounded to the nearest: up to 0.79 degrees off; those of a
   tree that came from an octree stay as they are. Blocks stand in pre-order.
   O(voxels), 64 bytes a node. Errors: INVALID_ARG, UNINIT_DESC, RANGE, NO_MEMORY. */
VOXRT_DEF voxrt_result voxrt_octree_from_tree(const voxrt_octree_desc *desc, const voxrt_tree *tree,
                                              voxrt_octree **out_octree);

/* Convert back, without loss: same cells (large filled leaves become voxels), same palette, indices and levels of
   detail, and the same normals: such a tree keeps the thesis' codes, also in version 5 files. So a collapsed octree in
   pre-order comes back from its tree byte for byte. Where a filled voxel lies in a transparent one (build_lod was never
   called) the levels of detail are made by majority. Only env of desc is used.
   EMPTY: nothing is filled. RANGE: 2^32 - 2 voxels or more. Otherwise as voxrt_octree_from_tree. */
VOXRT_DEF voxrt_result voxrt_tree_from_octree(const voxrt_octree_desc *desc, const voxrt_octree *octree,
                                              voxrt_tree **out_tree);

VOXRT_DEF void voxrt_octree_destroy(voxrt_octree *octree); /* NULL is allowed */
VOXRT_DEF void voxrt_octree_get_info(const voxrt_octree *octree, voxrt_octree_info *info); /* O(voxels) */

/* The voxels as they are in memory: voxel 0 is the root, 1..7 are unused, then blocks of 8. A child's block has a
   higher number than its parent's. Owned by the octree; valid until it is changed. */
VOXRT_DEF const voxrt_octree_voxel *voxrt_octree_voxels(const voxrt_octree *octree, size_t *out_count);
VOXRT_DEF const uint8_t *voxrt_octree_palette(const voxrt_octree *octree, uint32_t *out_count);

/* The voxel that covers cell (x, y, z) of a level (0 = root): of that level, or a larger leaf. *out_level, if not NULL,
   is its level. A cell outside: a transparent leaf, level 0. Any thread. O(depth). */
VOXRT_DEF voxrt_octree_voxel voxrt_octree_get(const voxrt_octree *octree, uint32_t level, uint32_t x, uint32_t y,
                                              uint32_t z, uint32_t *out_level);

/* Set a leaf of the deepest level, creating what is missing above it with all siblings. A filled leaf that has to be
   split hands its payload to the eight. Drops the start grid; levels of detail are stale until build_lod.
   index   0: make it transparent; 1..palette_count
   normal  need not be unit length; NULL or no direction: +z
   Errors: INVALID_ARG, RANGE (cell or index), NO_MEMORY (the octree covers the same space as before).
   Thread safety: one thread at a time. Thesis 3.1.3. */
VOXRT_DEF voxrt_result voxrt_octree_insert(voxrt_octree *octree, uint32_t x, uint32_t y, uint32_t z, uint32_t index,
                                           const float normal[3]);

/* Payloads of all inner voxels from their children, bottom up: the index most of the filled children have (ties: more
   leaf volume, then the lower index) and the mean of their normals; transparent when nothing below is filled.
   O(voxels), 9 bytes a node meanwhile. Errors: INVALID_ARG, NO_MEMORY (unchanged). Thesis 3.1.4. */
VOXRT_DEF voxrt_result voxrt_octree_build_lod(voxrt_octree *octree);

/* Replace 8 leaves of equal index and normal by their parent, bottom up, and put the blocks in pre-order: equal octrees
   have equal voxels, however they were made. Drops the start grid. Errors: as build_lod. Thesis 3.1.4. */
VOXRT_DEF voxrt_result voxrt_octree_collapse(voxrt_octree *octree);

/* Grid of (2^(level-1))^3 start voxels, level 1..10 but at most depth + 1; 0: none. All coarser grids are kept too, for
   rays with a level limit: 4.6 bytes a cell. Errors: INVALID_ARG, RANGE, NO_MEMORY (no grid then). */
VOXRT_DEF voxrt_result voxrt_octree_build_grid(voxrt_octree *octree, uint32_t level);

typedef struct voxrt_octree_stats { /* added to */
    uint64_t rays, hits, bad_rays;
    uint64_t outer; /* points located, one for each leaf crossed */
    uint64_t inner; /* descents to a child */
    uint64_t grid;  /* points that started in the grid */
    uint64_t stuck; /* rays given up without progress: only with a fixed offset */
} voxrt_octree_stats;

/* field             zero means
   isa               SSE packets of four rays if the machine has SSE4.1; SCALAR: one ray at a time
   max_level_plus_1  no limit; k+1: voxels of octree level k count as leaves
   offset            points lie 2^-24 of the grid beyond each face, doubled where a ray does not get on. Else a fixed
                     offset in leaf edges, as in the thesis
   disable_grid      1: start at the root */
typedef struct voxrt_octree_trace_desc {
    uint32_t _begin_zero;
    voxrt_isa isa;
    uint32_t max_level_plus_1;
    float offset;
    uint32_t disable_grid;
    voxrt_octree_stats *stats; /* NULL: not counted, which is faster */
    uint32_t _end_zero;
} voxrt_octree_trace_desc;

/* Closest filled voxel along each ray by point location, as in the thesis (3.5): single precision, so 1 ray
   in 10^4 (512 cells an axis) to 10^3 (8192) meets a wrong voxel next to the right one; voxrt_trace is exact.
   rays, hits  as voxrt_trace. Rays 4i..4i+3 form a packet: give them neighbouring pixels
   hit->node   index in voxrt_octree_voxels, slot 0; cell, level: of the voxel, above `depth` for large leaves
   The same bits for every isa and every grouping of rays. Errors: INVALID_ARG, UNINIT_DESC.
   Thread safety: any number of threads on one octree. Allocates nothing. */
VOXRT_DEF voxrt_result voxrt_octree_trace(const voxrt_octree *octree, const voxrt_octree_trace_desc *desc,
                                          const voxrt_ray *rays, voxrt_hit *hits, size_t count);

/* Level (for max_level_plus_1 add 1) at which voxels of the point of the octree's box that is closest to the eye are at
   most `pixels` pixels wide. spread: width of a pixel at distance 1, 2 tan(fov_y/2) / height. Thesis 4.3.1. */
VOXRT_DEF uint32_t voxrt_octree_lod_level(const voxrt_octree *octree, const float eye[3], float spread, float pixels);

/* Attributes of a hit, as voxrt_hit_color and voxrt_hit_normal. */
VOXRT_DEF void voxrt_octree_hit_color(const voxrt_octree *octree, const voxrt_hit *hit, uint8_t rgb[3]);
VOXRT_DEF void voxrt_octree_hit_normal(const voxrt_octree *octree, const voxrt_hit *hit, float normal[3]);
/* xyz for each of `count` hits, four at a time, the same bits; 0 for a miss. */
VOXRT_DEF void voxrt_octree_hit_normals(const voxrt_octree *octree, const voxrt_hit *hits, float *normals,
                                        size_t count);

/* Write a version 4 .vox file (docs/formats.md). Placement and depth are not part of it.
   env       where temporary memory and errors go, NULL: the defaults
   buffer, capacity, out_size, errors: as voxrt_tree_save_memory. A file that was read is written as it was.
   O(voxels), 4 bytes a voxel. */
VOXRT_DEF voxrt_result voxrt_octree_save_memory(const voxrt_octree *octree, const voxrt_env *env, void *buffer,
                                                size_t capacity, size_t *out_size);

/* Read a version 4 .vox file, any alignment. Safe for any bytes: holds about twice the size of the file, and the start
   grid. The depth is the deepest level found. A separator other than "||" is accepted; error->text then says so.
   Errors: INVALID_ARG, UNINIT_DESC, TRUNCATED, FORMAT, VERSION (1 to 3 were never documented), NO_MEMORY; error->where
   is a byte offset, for VERSION the version. */
VOXRT_DEF voxrt_result voxrt_octree_load_memory(const voxrt_octree_desc *desc, const void *data, size_t size,
                                                voxrt_octree **out_octree);

#ifndef VOXRT_NO_STDIO
/* As voxrt_tree_save_file and voxrt_tree_load_file. */
VOXRT_DEF voxrt_result voxrt_octree_save_file(const voxrt_octree *octree, const voxrt_env *env, const char *path);
VOXRT_DEF voxrt_result voxrt_octree_load_file(const voxrt_octree_desc *desc, const char *path,
                                              voxrt_octree **out_octree);
#endif

/* ---- files ---- */

typedef enum voxrt_encoding {
    VOXRT_ENCODING_COMPACT = 0, /* smallest: entropy coded (default) */
    VOXRT_ENCODING_RAW = 1,     /* the arrays as they are in memory: voxrt_tree_map_memory can use the file in place */
    VOXRT_ENCODING_FORCE_32BIT = 0x7fffffff
} voxrt_encoding;

/* field             zero means
   encoding          compact
   disable_normals   normals are written when the tree has them */
typedef struct voxrt_save_desc {
    uint32_t _begin_zero;
    voxrt_env env;
    voxrt_encoding encoding;
    uint32_t disable_normals;
    uint32_t _end_zero;
} voxrt_save_desc;

/* field         zero means
   trust_input   everything is checked. 1: the bytes are known to be what save wrote; checksums and the walks over all
                 nodes are left out, the layout of the file is still checked */
typedef struct voxrt_load_desc {
    uint32_t _begin_zero;
    voxrt_env env;
    uint32_t trust_input;
    uint32_t _end_zero;
} voxrt_load_desc;

/* Format of a file by its first bytes (12 are enough): 5 for a tree (voxrt_tree_load_memory), 4 for an octree of the
   thesis (voxrt_octree_load_memory), 0 for anything else. data may be NULL when size is 0. */
VOXRT_DEF uint32_t voxrt_file_kind(const void *data, size_t size);

/* Write a tree as a format 5 file (docs/formats.md) to memory.
   desc      in, NULL: all defaults
   buffer    out, [capacity] bytes, any alignment; NULL: only the size is found (costs as much as writing)
   out_size  out, size of the file; ERR_RANGE when capacity is less, then the buffer is untouched
   The same tree gives the same bytes on every machine. O(tree); holds about the size of the file beside the buffer.
   Errors: INVALID_ARG, UNINIT_DESC, RANGE, NO_MEMORY. Thread safety: any number of calls on one tree. */
VOXRT_DEF voxrt_result voxrt_tree_save_memory(const voxrt_tree *tree, const voxrt_save_desc *desc, void *buffer,
                                              size_t capacity, size_t *out_size);

/* Read a format 5 file from memory, any alignment; nothing of `data` is used after the call.
   Safe for any bytes: whatever is accepted is a tree that can be traced. What a file can make this allocate is bounded
   by its size: about once the file for raw, at most about 11000 times for a hostile compact one (env.memory_limit),
   and 2 MB.
   Errors: INVALID_ARG, UNINIT_DESC, TRUNCATED, FORMAT, VERSION, CHECKSUM, NO_MEMORY; error->where is a byte offset.
   Thread safety: calls are independent. */
VOXRT_DEF voxrt_result voxrt_tree_load_memory(const voxrt_load_desc *desc, const void *data, size_t size,
                                              voxrt_tree **out_tree);

/* Use a raw format 5 file in place, for example a memory-mapped one: nothing is copied.
   data   in, 64-byte aligned; must stay valid and unchanged until the tree is destroyed, which does not free it
   Allocates only the tree's header; with trust_input O(1), else every byte is read once. Checks what load checks.
   Errors: as voxrt_tree_load_memory; INVALID_ARG also for a compact file, a wrong alignment or a big-endian machine
   (load such files instead). */
VOXRT_DEF voxrt_result voxrt_tree_map_memory(const voxrt_load_desc *desc, const void *data, size_t size,
                                             voxrt_tree **out_tree);

#ifndef VOXRT_NO_STDIO
/* As the memory functions; ERR_IO when the file cannot be read or written. Save writes to `path` with ".part" behind
   it and renames when all is written, so that a file is complete or not there; it takes the place of what had the name,
   be that a link or, with the right to do so, a device. Load holds the whole file meanwhile. */
VOXRT_DEF voxrt_result voxrt_tree_save_file(const voxrt_tree *tree, const voxrt_save_desc *desc, const char *path);
VOXRT_DEF voxrt_result voxrt_tree_load_file(const voxrt_load_desc *desc, const char *path, voxrt_tree **out_tree);
#endif

/* ---- pictures ---- */

/* A pinhole. Right-handed coordinates; `up` need not be at right angles to the view. */
typedef struct voxrt_camera {
    float eye[3], at[3];
    float up[3];  /* all zero: +y */
    float fov_y;  /* vertical angle in degrees, below 180; 0: 40 */
} voxrt_camera;

/* color is what a surface of albedo 1 facing the light shows, linear; no falloff with distance. */
typedef struct voxrt_light {
    float position[3];    /* of a point light; directional: the direction towards the light, any length */
    uint32_t directional;
    float color[3];
    uint32_t no_shadow;   /* 1: nothing shadows this light */
} voxrt_light;

/* Phong: colour * (ambient + sum of lights * diffuse * cos) + sum of lights * specular * cos^shininess. */
typedef struct voxrt_material {
    float ambient[3];
    float diffuse;        /* 1: the colour is the albedo; 0.5: the thesis' mid grey */
    float specular, shininess;
} voxrt_material;

/* Where one ray met a surface. On a miss t = INFINITY and the rest 0. */
typedef struct voxrt_surface {
    float t;
    float normal[3];      /* unit length, or all zero: the face's */
    float edge;           /* world edge of the cell that was hit; lifts the origins of shadow rays */
    uint8_t rgb[3];       /* sRGB */
    uint8_t face;         /* as voxrt_hit.face */
} voxrt_surface;

/* Anything a ray can hit: octrees, other trees, polygons. The nearest surface wins, all of them cast shadows.
   trace_fn and occluded_fn get 1..64 rays and are called by many threads at once; they add to desc->stats if it is
   not NULL, and may ignore the other fields. */
typedef struct voxrt_geometry {
    void (*trace_fn)(void *user, const voxrt_trace_desc *desc, const voxrt_ray *rays, voxrt_surface *surfaces,
                     size_t count);
    void (*occluded_fn)(void *user, const voxrt_trace_desc *desc, const voxrt_ray *rays, uint8_t *occluded,
                        size_t count);
    void *user;
    double box_min[3], box_max[3]; /* world; frames the default camera */
} voxrt_geometry;

typedef enum voxrt_view {
    VOXRT_VIEW_SHADED = 0,
    VOXRT_VIEW_UNLIT = 1,      /* plain surface colours */
    VOXRT_VIEW_LIGHT = 2,      /* brightness alone, as if all were white */
    VOXRT_VIEW_SPLIT = 3,      /* left third colours, middle shaded, right third brightness */
    VOXRT_VIEW_NORMALS = 4,    /* (n + 1) / 2 as linear colours */
    VOXRT_VIEW_HEAT_OUTER = 5, /* cells left per ray: white to red at heat_max */
    VOXRT_VIEW_HEAT_INNER = 6, /* nodes entered per ray: over 15 green, 40 yellow, 80 orange, 120 red */
    VOXRT_VIEW_FORCE_32BIT = 0x7fffffff
} voxrt_view;

typedef enum voxrt_stage { /* for measuring: stop after ... */
    VOXRT_STAGE_FULL = 0,
    VOXRT_STAGE_RAYS = 1,  /* making the rays; all of them miss */
    VOXRT_STAGE_SETUP = 2, /* setting them up in the grid; all of them miss */
    VOXRT_STAGE_TRACE = 3, /* tracing: white where something is hit, no attributes are read */
    VOXRT_STAGE_FORCE_32BIT = 0x7fffffff
} voxrt_stage;

/* Buffers of the caller, row 0 on top; any may be NULL. Strides in bytes, 0: rows lie close together. */
typedef struct voxrt_image {
    uint32_t width, height;
    uint8_t *rgba8;        /* sRGB, not premultiplied; alpha = coverage, 0 where nothing was hit */
    float *rgba;           /* linear, premultiplied */
    float *sum;            /* rgba of all samples so far, added up: see first_sample */
    float *depth;          /* along the viewing axis; INFINITY where nothing was hit */
    float *normal;         /* xyz, 0 where nothing was hit */
    voxrt_hit *hit;        /* of the tree; a miss where other geometry is nearer */
    size_t rgba8_stride, rgba_stride, sum_stride, depth_stride, normal_stride, hit_stride;
} voxrt_image;

/* Steps of the caller's own in the drawing of a picture: rays (tracing is up to voxrt_geometry), shading, then what is
   done to finished tiles and to the whole picture. Any of them may be NULL; all but frame_fn are called by many threads
   at once, each pixel and each tile belongs to one call.
   ray_fn    makes the ray through point (x, y) of the picture, in pixels from its upper left corner, instead of the
             camera, which still sets the default lights and the widths of level of detail: t should be depth
   shade_fn  gets 1..64 rays with what they met and its unit normals, as they were turned for shading. colors: in, what
             the library would show; out, what is shown: linear, premultiplied, 0 where nothing is; with thesis_compose
             in units of 255
   tile_fn   gets the pixels [x0, x1) x [y0, y1) when all of them are written
   frame_fn  the same for the picture, on the calling thread, behind all tiles */
typedef struct voxrt_states {
    void (*ray_fn)(void *user, double x, double y, voxrt_ray *ray);
    void (*shade_fn)(void *user, const voxrt_ray *rays, const voxrt_surface *surfaces, const float (*normals)[3],
                     float (*colors)[4], size_t count);
    void (*tile_fn)(void *user, const voxrt_image *image, uint32_t x0, uint32_t y0, uint32_t x1, uint32_t y1);
    void (*frame_fn)(void *user, const voxrt_image *image);
    void *user;
} voxrt_states;

/* field             zero means
   camera            (eye equals at) one that frames everything
   lights            NULL: a key light from the upper left behind the camera, a weak fill light, some ambient light
   material          NULL: ambient 0.05, diffuse 1, no specular
   samples           1 per pixel, at its centre; n: the first n points of a fixed low-discrepancy sequence that begins
                     with the centre
   first_sample      start of the sequence; with image->sum: how many samples the sum holds already
   tolerance         full detail. E: a ray stops at the first cell whose edge is at most E pixels wide
   object_lod        off. 1: instead one level for all, chosen so that the nearest cell is at most `tolerance` (0: 1)
                     pixels wide
   max_level_plus_1  no limit. k+1: octree level k is the finest
   pixel_step        1: a ray for each pixel. k, up to 8: one for each block of k x k pixels, for fast previews
   lod_split         off. k+1: left half of the picture at most octree level k, for comparison
   background        transparent; linear RGBA, premultiplied */
typedef struct voxrt_render_desc {
    uint32_t _begin_zero;
    voxrt_env env;
    voxrt_isa isa;
    voxrt_camera camera;
    const voxrt_light *lights;
    size_t light_count;
    const voxrt_material *material;
    const voxrt_geometry *geometry; /* besides the tree; NULL: none */
    size_t geometry_count;
    const voxrt_states *states;     /* the caller's own steps; NULL: none */
    voxrt_view view;
    uint32_t shadows;
    uint32_t face_normals;    /* 1: shade by the faces of the cubes */
    uint32_t one_sided;       /* 1: surfaces seen from behind stay dark instead of turning their normal */
    uint32_t thesis_compose;  /* 1: bytes * brightness, cut at 255, as in 2009; default: linear light, then sRGB */
    uint32_t thesis_shadows;  /* 1: shadow rays start at the hit itself, with stripes; for comparison */
    uint32_t samples, first_sample;
    float tolerance;
    uint32_t object_lod;
    uint32_t max_level_plus_1;
    uint32_t pixel_step;
    uint32_t lod_split;
    float background[4];
    float heat_max;           /* cells that are fully red; 0: 64 */
    voxrt_stage stage;
    uint32_t no_compose;      /* 1: trace and shade, but leave rgba8 and rgba alone; for measuring */
    uint32_t _end_zero;
} voxrt_render_desc;

typedef struct voxrt_render_stats { /* added to */
    voxrt_stats primary, shadow;
} voxrt_render_stats;

/* The ray through point (x, y) of the picture plane, in pixels from its upper left corner: (i+0.5, j+0.5) is the
   centre of pixel (i, j). dir has length 1 along the viewing axis, so that t is the depth. t_min 0, t_max INFINITY.
   INVALID_ARG: eye equals at, a number is not finite, or the angle is not in (0, 180). */
VOXRT_DEF voxrt_result voxrt_camera_ray(const voxrt_camera *camera, uint32_t width, uint32_t height, double x, double y,
                                        voxrt_ray *out_ray);

/* Set eye and at so that the box fills the picture; keeps up and fov_y.
   view  from the object towards the eye, any length; NULL: from the front, a little from above and the right
   INVALID_ARG: the box or view is not finite, the angle is not in (0, 180), or a float cannot hold the place. */
VOXRT_DEF voxrt_result voxrt_camera_fit(voxrt_camera *camera, const double box_min[3], const double box_max[3],
                                        const float view[3], uint32_t width, uint32_t height);

/* The same for what is filled in the cells of octree level 6: closer than its box allows. O(4096) or so. */
VOXRT_DEF voxrt_result voxrt_camera_fit_tree(voxrt_camera *camera, const voxrt_tree *tree, const float view[3],
                                             uint32_t width, uint32_t height);

/* World box of the filled voxels. */
VOXRT_DEF void voxrt_tree_bounds(const voxrt_tree *tree, double box_min[3], double box_max[3]);

/* A tree as voxrt_geometry: to show several. The tree is borrowed. */
VOXRT_DEF void voxrt_tree_geometry(const voxrt_tree *tree, voxrt_geometry *out_geometry);

/* The thesis' octree as voxrt_geometry, traced by its packets: max_level_plus_1 counts, tolerance does not. steps and
   descents of the stats are its outer and inner loops. Borrowed. O(1); its box is the whole grid. */
VOXRT_DEF void voxrt_octree_geometry(const voxrt_octree *octree, voxrt_geometry *out_geometry);

/* A geometry in another place: moved, turned, scaled, mirrored or sheared. t stays the same, widths of cells and of
   cones go by the largest scale, normals by the transposed inverse. The face of a hit becomes the nearest one of the
   world. */
typedef struct voxrt_instance {
    voxrt_geometry geometry; /* what is shown */
    double to_world[12];     /* three rows of four: world = to_world * (x, y, z, 1) */
    double _to_object[12], _stretch;
} voxrt_instance;

/* An instance as voxrt_geometry. The instance is borrowed and must stay where it is; call again after a change.
   INVALID_ARG: no functions, or to_world is not finite or has no inverse that doubles can tell: |det| of its 3x3 part
   is at most 1e-12 times the cube of its largest element. */
VOXRT_DEF voxrt_result voxrt_instance_geometry(voxrt_instance *instance, voxrt_geometry *out_geometry);

/* Many geometries as one, by a hierarchy of their boxes: a run of rays meets only those whose boxes it crosses.
   env       where memory and errors come from, NULL: the defaults
   geometry  in, [count], copied; what they stand for is borrowed until the group is destroyed. At least one, at most
             2^31 - 1, with boxes within -1e38 and 1e38; they may overlap. Among equal distances the first is seen
   O(count log count), 136 bytes for each. Errors: INVALID_ARG, RANGE, NO_MEMORY; error->where: which one.
   Thread safety: any number of threads may draw a group. Groups can hold instances of groups, a few deep. */
typedef struct voxrt_group voxrt_group;
VOXRT_DEF voxrt_result voxrt_group_create(const voxrt_env *env, const voxrt_geometry *geometry, size_t count,
                                          voxrt_group **out_group);
VOXRT_DEF void voxrt_group_destroy(voxrt_group *group); /* NULL is allowed */
VOXRT_DEF void voxrt_group_geometry(const voxrt_group *group, voxrt_geometry *out_geometry); /* borrowed */

/* Draw.
   desc    in, NULL: all defaults
   tree    in, NULL: only desc->geometry
   image   buffers in and out; with more than one sample depth, normal and hit are those of sample 0, and they are
           left alone when first_sample > 0. A width or height of 0 is allowed
   stats   may be NULL; counting costs a little
   Progressive pictures: call with samples = 1, first_sample = 0, 1, 2, ... and image->sum: each call leaves the mean of
   all samples so far, the same bits as one call with that many samples.
   The same bits for any number of threads and any isa. Allocates nothing. Colours of lights, material and background
   are within -1e12 and 1e12, so that no pixel overflows.
   Errors: INVALID_ARG (env.error says what), UNINIT_DESC, RANGE, CANCELLED (then the picture is incomplete). Thread
   safety: any number of calls on one tree. */
VOXRT_DEF voxrt_result voxrt_render(const voxrt_render_desc *desc, const voxrt_tree *tree, const voxrt_image *image,
                                    voxrt_render_stats *stats);

/* rgba -> rgba8, for pictures that were changed after drawing. env may be NULL. INVALID_ARG: a buffer is missing.
   Thread safety: any number of calls on different pictures. */
VOXRT_DEF voxrt_result voxrt_image_encode(const voxrt_env *env, const voxrt_image *image);

/* field      zero means
   radius     4 pixels: a Gauss with a standard deviation of radius / 2, cut off at radius; at most 64
   footprint  blur all with `radius`. Width of a pixel at depth 1 (2 tan(fov_y/2) / height): blur only where voxels are
              larger than 1.5 pixels, with a radius of the voxel's size, at most `radius`, and not across edges: needs
              depth and hit, and normal if there is one
   voxel_size world edge of a leaf voxel; depth levels of the tree: with footprint */
typedef struct voxrt_blur_desc {
    uint32_t _begin_zero;
    voxrt_env env;
    float radius;
    float footprint;
    float voxel_size;
    uint32_t depth;
    uint32_t _end_zero;
} voxrt_blur_desc;

/* Blur image->rgba in place, then write rgba8 if it is there. Holds one copy of rgba.
   Errors: INVALID_ARG, UNINIT_DESC, NO_MEMORY (picture unchanged). */
VOXRT_DEF voxrt_result voxrt_blur(const voxrt_blur_desc *desc, const voxrt_image *image);

/* Keep frames within a time. When one took longer than target_ms the next gets a larger tolerance (up to 4 times
   `finest`, which saves 10 to 40 %) and, if that is not enough, a ray for each block of pixels only; with time to spare
   both go back. Slow frames are those of the change itself: one or two.
   budget   zeroed before the first frame. Out: pixel_step for the next frame's desc
   finest   tolerance when there is time enough; 0: 0.25
   Returns the tolerance for the next frame. O(1); no errors: times that are not positive numbers change nothing. */
typedef struct voxrt_budget {
    float bias, sum;
    uint32_t pixel_step;
    uint32_t _step;   /* of the frame before, with its bias and time */
    float _bias, _frame_ms;
} voxrt_budget;
VOXRT_DEF float voxrt_budget_update(voxrt_budget *budget, float frame_ms, float target_ms, float finest);


/* ---- bit columns: a dynamic volume for rays ---- */
#ifndef VOXRT_NO_GI

/* A box of the world as a grid of bits, 128 or so of them in a column: a surface is voxelised into it in a millisecond,
   again in every frame. The box need not be a cube, nor its cells. Above the columns stands a hierarchy of 2 x 2
   columns ORed, with all bits along the depth. What is inserted as `still` stays when the rest is cleared. */
typedef struct voxrt_columns voxrt_columns;

typedef enum voxrt_columns_mode {
    VOXRT_COLUMNS_THIN = 0,   /* cells in which the surface meets a line through the centre along x, y or z:
                                 6-separating,
                                 no ray slips through (default) */
    VOXRT_COLUMNS_FAT = 1,    /* every cell that the surface touches */
    VOXRT_COLUMNS_RASTER = 2, /* lines along the depth only, as in one pass of a rasteriser: gaps in steep surfaces */
    VOXRT_COLUMNS_SOLID = 3,  /* cells with their centre inside a closed mesh, and its THIN surface */
    VOXRT_COLUMNS_SAMPLES = 4, /* cells of points on each triangle, which stay where they are on it as it moves: gaps
                                  where they lie too far apart */
    VOXRT_COLUMNS_BODY = 5,   /* cells with their centre inside a closed mesh, and THIN ones where there are none: on
                                 average as wide as the mesh is. The others make it wider, THIN and SOLID by half a
                                 cell on each side */
    VOXRT_COLUMNS_MODE_FORCE_32BIT = 0x7fffffff
} voxrt_columns_mode;

/* field              zero means
   size_x, size_y     256 cells across the depth; powers of two, 4 to 4096
   size_z             128 cells along the depth; 64, 128 or 256
   depth_axis_plus_1  the shortest side of the box; 1, 2, 3: x, y, z. The other two follow in cyclic order
   box_min, box_max   (no default) world box, every side longer than 0 */
typedef struct voxrt_columns_desc {
    uint32_t _begin_zero;
    voxrt_env env;
    uint32_t size_x, size_y, size_z;
    uint32_t depth_axis_plus_1;
    double box_min[3], box_max[3];
    uint32_t _end_zero;
} voxrt_columns_desc;

/* field      zero means
   to_world   (all zero) the mesh is in world coordinates; else three rows of four: world = to_world * (x, y, z, 1)
   still      1: into the layer that voxrt_columns_clear keeps
   spacing    SAMPLES: 0.5 of the shortest side of a cell between points that are side by side; 1/64 to 64 */
typedef struct voxrt_columns_insert_desc {
    uint32_t _begin_zero;
    voxrt_env env; /* thread_count, parallel and error count */
    voxrt_columns_mode mode;
    double to_world[12];
    uint32_t still;
    float spacing;
    uint32_t _end_zero;
} voxrt_columns_insert_desc;

typedef struct voxrt_columns_insert_stats { /* added to */
    uint64_t items;        /* triangles or points */
    uint64_t rejected;     /* NaN, infinite, or an index out of range: left out */
    uint64_t outside;      /* not in the box */
    uint64_t open_columns; /* SOLID, BODY: columns in which the mesh is not closed; they got no inside */
} voxrt_columns_insert_stats;

typedef struct voxrt_columns_info {
    uint32_t axis[3];      /* world axes of the grid's x, y and depth */
    uint32_t size[3];      /* cells along them */
    double cell[3];        /* world lengths of a cell along them */
    double diagonal;       /* of a cell */
    uint64_t cells;        /* that are set */
    uint64_t bytes;
} voxrt_columns_info;

/* An empty volume. Errors: INVALID_ARG (box, sizes), UNINIT_DESC, NO_MEMORY. O(columns). */
VOXRT_DEF voxrt_result voxrt_columns_create(const voxrt_columns_desc *desc, voxrt_columns **out_columns);
VOXRT_DEF void voxrt_columns_destroy(voxrt_columns *columns); /* NULL is allowed */
VOXRT_DEF void voxrt_columns_get_info(const voxrt_columns *columns, voxrt_columns_info *info); /* O(columns) */

/* Set the cells of a mesh. Positions and indices of `mesh` count; triangles with a NaN, infinite or missing vertex are
   left out and counted. The set does not depend on their order nor on threads.
   desc   in, NULL: THIN, world coordinates
   stats  added to, may be NULL
   Vertices are snapped to 1/256 of a cell, then decisions are exact (THIN, RASTER, SOLID); FAT may take cells that lie
   up to 1e-6 of a cell beside the surface. SAMPLES: rows of points along the longest edge; triangles smaller than what
   a point stands for have one now and then, so that they cost by area; those with 16383 in a row are THIN.
   O(triangles + cells). Errors: INVALID_ARG, UNINIT_DESC, NO_MEMORY (SOLID, BODY). Thread safety: one call on a volume
   at a time. Source: Laine 2013 (thin), Eisemann & Decoret 2006 (raster) and 2008 (solid), Zhang et al. 2007 (fat). */
VOXRT_DEF voxrt_result voxrt_columns_insert(voxrt_columns *columns, const voxrt_columns_insert_desc *desc,
                                            const voxrt_mesh *mesh, voxrt_columns_insert_stats *stats);

/* Set the cells of points: samples of surfaces that move. xyz in, [count], stride in bytes (0: 12). mode is ignored.
   Surfaces have no holes if the samples lie close enough, which is up to the caller. Otherwise as
   voxrt_columns_insert. */
VOXRT_DEF voxrt_result voxrt_columns_insert_points(voxrt_columns *columns, const voxrt_columns_insert_desc *desc,
                                                   const float *xyz, size_t stride, size_t count,
                                                   voxrt_columns_insert_stats *stats);

/* Take out all that was not inserted as still; with `all` that, too. O(columns that had something). */
VOXRT_DEF void voxrt_columns_clear(voxrt_columns *columns, int all);

/* Bring the hierarchy up to date, after inserting or clearing and before tracing. O(columns that changed). */
VOXRT_DEF void voxrt_columns_update(voxrt_columns *columns);

/* Is cell (x, y, z) of the grid set? Level l: any of 2^l x 2^l columns at that z. Outside: 0. Any thread. O(1). */
VOXRT_DEF int voxrt_columns_get(const voxrt_columns *columns, uint32_t level, uint32_t x, uint32_t y, uint32_t z);

/* 20 bytes. On a miss t = INFINITY and the rest 0. */
typedef struct voxrt_column_hit {
    float t;            /* where the ray enters the cell; not before t_min */
    uint32_t cell[3];   /* x, y, z of the grid */
    uint32_t face;      /* of the cell: 2 * world axis + (1: on its upper side); 6: the ray starts in the cell */
} voxrt_column_hit;

/* field              zero means
   normals            in, xyz for each ray, unit length: of the surface it starts on. Cells that the plane through the
                      origin with this normal cuts do not stop it nearby, so rays start on surfaces without an offset
   end_normals        the same for the other end, at t_max; in both a normal of 0 is none
   self_radius        how far from origin and end that holds, world units: 16 cell diagonals
   start_level_plus_1 level 1; results do not depend on it */
typedef struct voxrt_columns_trace_desc {
    uint32_t _begin_zero;
    voxrt_isa isa;
    const float *normals, *end_normals;
    float self_radius;
    uint32_t start_level_plus_1;
    voxrt_stats *stats;  /* NULL: not counted. descents are steps down in the hierarchy */
    uint32_t _end_zero;
} voxrt_columns_trace_desc;

/* First cell that is set along each ray, in the box and in [t_min, t_max], on the calling thread. Exact stepping from
   column to column in floats: no epsilon, no cap on steps. Bad rays miss and are counted (bad_rays). The same bits for
   any isa. Errors: INVALID_ARG, UNINIT_DESC. Thread safety: any number of threads on a volume that does not change.
   Allocates nothing. Source: thesis (2010) 5.2, 5.3; Forest et al. 2009; stepping and the plane rule are ours. */
VOXRT_DEF voxrt_result voxrt_columns_trace(const voxrt_columns *columns, const voxrt_columns_trace_desc *desc,
                                           const voxrt_ray *rays, voxrt_column_hit *hits, size_t count);

/* Is any cell set along the ray? occluded out, [count]: exactly when voxrt_columns_trace reports a hit. */
VOXRT_DEF voxrt_result voxrt_columns_occluded(const voxrt_columns *columns, const voxrt_columns_trace_desc *desc,
                                              const voxrt_ray *rays, uint8_t *occluded, size_t count);

/* A look of a ray at a column of some level. */
typedef struct voxrt_column_step {
    float t_in, t_out;   /* the part of the ray within it, in t of the ray */
    uint32_t level;      /* it is 2^level x 2^level columns wide */
    uint32_t column[2];  /* x >> level, y >> level of the grid */
    uint32_t depth[2];   /* the ray is in the cells from the first of them to the second there, the first is less */
    uint32_t found;      /* 0: none of them is set, the ray goes on behind the column. 1: some are: one level down.
                            2: at level 0: the hit */
} voxrt_column_step;

/* How voxrt_columns_trace finds what it finds: all that one ray looks at, in order.
   desc   in, NULL: none; normals and end_normals of this ray
   steps  out, [most]: the first of them; may be NULL if most is 0
   hit    out, may be NULL: what voxrt_columns_trace gives
   Returns how many there are, 0 if the ray misses the box or an argument is bad. Any thread. */
VOXRT_DEF size_t voxrt_columns_explain(const voxrt_columns *columns, const voxrt_columns_trace_desc *desc,
                                       const voxrt_ray *ray, voxrt_column_step *steps, size_t most,
                                       voxrt_column_hit *hit);
#endif /* VOXRT_NO_GI */

/* ---- global illumination of scenes that move ---- */
#ifndef VOXRT_NO_GI

/* Meshes and lights of a scene, voxelised into columns with colours and normals for both sides of each surface. Light
   that bounces between them is found by rays through the columns. */
typedef struct voxrt_gi voxrt_gi;

/* Linear values. What is diffuse is albedo / pi; the Phong lobe is specular (exponent + 2) / (2 pi) cos^exponent. */
typedef struct voxrt_gi_material {
    float albedo[3];             /* times the mesh's colours; all zero: 1, 1, 1 */
    float specular[3], exponent; /* exponent 0: no lobe */
    float emission[3];           /* radiance of its surface, on the side from which triangles are counter-clockwise */
} voxrt_gi_material;

/* field     zero means
   mesh      positions, indices and colours count; borrowed until the object is taken out or gets another
   to_world  (all zero) the mesh is in world coordinates; else three rows of four
   still     1: it will not move, its voxels are made once
   mode      THIN. SAMPLES: which points of a triangle are taken is found when the object comes and kept, so that they
             follow its surface wherever voxrt_gi_set takes it; triangles that grow by more than a tenth get more.
             SOLID: it is dark inside. BODY: that, and it hides no more than it should; not for rooms, whose inside is
             where the light is
   spacing   SAMPLES: as voxrt_columns_insert_desc.spacing */
typedef struct voxrt_gi_object {
    voxrt_mesh mesh;
    voxrt_gi_material material;
    double to_world[12];
    uint32_t still;
    voxrt_columns_mode mode;
    float spacing;
} voxrt_gi_object;

typedef enum voxrt_gi_light_kind {
    VOXRT_GI_POINT = 0,       /* color: radiant intensity, the same in all directions */
    VOXRT_GI_SPOT = 1,        /* color: radiant intensity within `angle` of direction */
    VOXRT_GI_DIRECTIONAL = 2, /* color: irradiance of a surface that faces it */
    VOXRT_GI_AREA = 3,        /* color: radiance of the rectangle position +- edge_u +- edge_v, on the side of u x v */
    VOXRT_GI_LIGHT_FORCE_32BIT = 0x7fffffff
} voxrt_gi_light_kind;

typedef struct voxrt_gi_light {
    voxrt_gi_light_kind kind;
    float position[3];
    float direction[3];           /* of the light's travel: spot and directional; any length */
    float angle;                  /* spot: half of its opening, degrees, below 90 */
    float edge_u[3], edge_v[3];   /* area */
    float color[3];
} voxrt_gi_light;

/* field    zero means
   columns  the volume; box_min and box_max have no default, env is not used. Nothing outside the box receives or sends
            indirect light
   nested   1: that volume only. n: n - 1 more around it, at most 8, each twice as wide with as many cells: rays go on
            in the next one where they leave the one before. Memory and times go with n */
typedef struct voxrt_gi_desc {
    uint32_t _begin_zero;
    voxrt_env env;
    voxrt_columns_desc columns;
    uint32_t nested;
    uint32_t _end_zero;
} voxrt_gi_desc;

/* An empty scene. Errors: as voxrt_columns_create. */
VOXRT_DEF voxrt_result voxrt_gi_create(const voxrt_gi_desc *desc, voxrt_gi **out_gi);
VOXRT_DEF void voxrt_gi_destroy(voxrt_gi *gi); /* NULL is allowed */

/* Put an object in; at most 65535. out_id, not NULL: its number. O(1). Errors: INVALID_ARG, RANGE, NO_MEMORY. */
VOXRT_DEF voxrt_result voxrt_gi_add(voxrt_gi *gi, const voxrt_gi_object *object, uint32_t *out_id);
/* Change an object: another place, other positions in its mesh, another material. An object that was still and stays so
   has all still ones voxelised again. Errors: INVALID_ARG. */
VOXRT_DEF voxrt_result voxrt_gi_set(voxrt_gi *gi, uint32_t id, const voxrt_gi_object *object);
VOXRT_DEF voxrt_result voxrt_gi_remove(voxrt_gi *gi, uint32_t id); /* its number may be given out again */
/* All lights, copied. Errors: INVALID_ARG (error->where: which one), NO_MEMORY (they stay as they were). */
VOXRT_DEF voxrt_result voxrt_gi_set_lights(voxrt_gi *gi, const voxrt_gi_light *lights, size_t count);

typedef struct voxrt_gi_update_stats {
    uint64_t still_cells, moving_cells; /* that have attributes */
    uint64_t rejected;                  /* triangles left out */
    uint64_t bytes;                     /* of everything */
    uint64_t open_columns;              /* SOLID, BODY: of what was voxelised this time; they got no inside */
} voxrt_gi_update_stats;

/* Voxelise what changed, bring the hierarchy up to date. After every change of objects or lights and before drawing.
   The same bits for any number of threads. O(moving triangles and cells). Errors: INVALID_ARG, NO_MEMORY (call it
   again). Thread safety: alone with the scene. */
VOXRT_DEF voxrt_result voxrt_gi_update(voxrt_gi *gi, voxrt_gi_update_stats *stats);
VOXRT_DEF const voxrt_columns *voxrt_gi_columns(const voxrt_gi *gi); /* owned by gi; the innermost volume */

/* Move the volumes so that `centre` is in their middle, to the next multiple of 8 cells of each. Those that moved are
   voxelised again by the next voxrt_gi_update. out_moved, not NULL: how many. O(1). Errors: INVALID_ARG. */
VOXRT_DEF voxrt_result voxrt_gi_follow(voxrt_gi *gi, const double centre[3], uint32_t *out_moved);

/* Surface in a cell that a ray in direction dir sees. Returns 0 where nothing faces it. radiance: what it sends back
   along the ray: direct light, indirect light as far as it is known, emission. */
typedef struct voxrt_gi_surface {
    float position[3], normal[3], albedo[3], radiance[3];
    uint32_t object;
} voxrt_gi_surface;
VOXRT_DEF int voxrt_gi_get(const voxrt_gi *gi, const voxrt_column_hit *hit, const float dir[3],
                           voxrt_gi_surface *out_surface);

/* What the camera sees, a value for each pixel, row 0 on top. position, normal and albedo have to be there. */
typedef struct voxrt_gbuffer {
    uint32_t width, height;
    float *position;  /* xyz; a pixel that sees nothing has normal 0 */
    float *normal;    /* unit length, towards the camera */
    float *albedo;    /* rgb */
    float *specular;  /* rgb and exponent; NULL: none */
    float *emission;  /* rgb; NULL: none */
    float *before;    /* xyz: where this point of the surface was in the frame before; NULL: where it is */
} voxrt_gbuffer;

/* Fill in a G-buffer from geometry (trees, octrees, instances, groups): position, normal, albedo; the others get 0.
   Errors: INVALID_ARG. O(pixels). */
VOXRT_DEF voxrt_result voxrt_gbuffer_from_geometry(const voxrt_env *env, const voxrt_camera *camera,
                                                   const voxrt_geometry *geometry, const voxrt_gbuffer *gbuffer);
/* The same from the columns of a scene: shows what the rays of indirect light see. */
VOXRT_DEF voxrt_result voxrt_gbuffer_from_gi(const voxrt_env *env, const voxrt_camera *camera, const voxrt_gi *gi,
                                             const voxrt_gbuffer *gbuffer);

/* Fill in what the other two leave out, from the objects whose cells lie at the pixels: specular, emission, and from
   the places of the objects at the last two updates `before`. Buffers that are NULL stay out. Errors: INVALID_ARG.
   O(pixels). Thread safety: as drawing. */
VOXRT_DEF voxrt_result voxrt_gbuffer_materials(const voxrt_env *env, const voxrt_gi *gi, const voxrt_gbuffer *gbuffer);

/* A voxel at an edge has the mean of the normals of two surfaces, and that of an outline may have one that faces away:
   dots along edges. Where the cells know two flat surfaces there, such a normal becomes that of the one which faces the
   camera more. Errors: INVALID_ARG. O(pixels). Thread safety: as drawing. */
VOXRT_DEF voxrt_result voxrt_gbuffer_edges(const voxrt_env *env, const voxrt_camera *camera, const voxrt_gi *gi,
                                           const voxrt_gbuffer *gbuffer);

typedef enum voxrt_gi_method {
    VOXRT_GI_GATHER = 0,  /* rays over the hemisphere; light at their hits from a cache of the cells (default) */
    VOXRT_GI_PATH = 1,    /* paths of `bounces` rays; direct light at each vertex */
    VOXRT_GI_AO = 2,      /* ambient occlusion: how open the hemisphere is, 1 for nothing within `radius` */
    VOXRT_GI_NONE = 3,    /* direct light only */
    VOXRT_GI_VPL = 4,     /* virtual point lights where light falls, `bounces` times; a ray to each */
    VOXRT_GI_METHOD_FORCE_32BIT = 0x7fffffff
} voxrt_gi_method;

typedef enum voxrt_gi_lookup { /* the light of lamps where a ray hits */
    VOXRT_GI_LOOKUP_CACHE = 0,  /* of the side of the cell: found at the first look, kept till something moves */
    VOXRT_GI_LOOKUP_RAYS = 1,   /* by shadow rays from the hit: no blocks of cells, slower */
    VOXRT_GI_LOOKUP_VOLUME = 2, /* as CACHE, found for all cells first */
    VOXRT_GI_LOOKUP_MAPS = 3,   /* maps of what lamps see: what lies near enough in them is lit (thesis 6.3.3); for
                                   points and spots, RAYS for the others. Leaks within its tolerance */
    VOXRT_GI_LOOKUP_FORCE_32BIT = 0x7fffffff
} voxrt_gi_lookup;

/* What the pictures before this one know. One for each sequence of pictures of one size; it notices what it may keep:
   while camera, scene and settings are the same it is the mean of all of them; where the camera or an object moves it
   follows and fades; where only light changes it starts anew, with the same rays, so that noise does not flicker. */
typedef struct voxrt_gi_history voxrt_gi_history;
VOXRT_DEF voxrt_result voxrt_gi_history_create(const voxrt_env *env, voxrt_gi_history **out_history); /* NO_MEMORY */
VOXRT_DEF void voxrt_gi_history_destroy(voxrt_gi_history *history); /* NULL is allowed */

typedef struct voxrt_gi_report {
    uint64_t shaded;    /* pixels that sent rays */
    uint64_t pixels;    /* that see something */
    uint32_t rays;      /* a shaded pixel sent, for indirect light */
    float noise;        /* with `tolerance`: RMS of the noise left in indirect light, as a share of its mean; else 0 */
    float kept;         /* share of pixels that had a history */
} voxrt_gi_report;

/* field         zero means
   camera        needed for Phong lobes (eye), for history and relief
   rays          16 a pixel; VPL: virtual lights a pixel and bounce
   bounces       1; PATH and VPL: GATHER has as many as voxrt_gi_bounce was called for
   radius        rays are as long as the box
   first_ray     where the sequence of each pixel begins: frame * rays for progressive pictures
   shadow        direct light by shadow rays through the columns, or by maps with LOOKUP_MAPS; else rays through this
   filter        0: as sampled. Radius in pixels of a filter that keeps to surfaces; 2 passes. Irradiance and what comes
                 by Phong lobes are filtered for themselves, before colours
   direct_filter the same for direct light: soft edges of shadows
   coarse        1: every pixel sends rays. 2, 4, 8, 16: one in coarse x coarse pixels does; between those that lie on
                 one surface, where no other is near, light is interpolated, elsewhere the mesh is refined (Ward et al.
                 1988). VPL: with a pattern of 1, where as good as the same lights reach the pixels around
   detail        how far light may be interpolated, times the mean distance of what the rays hit: 0.15
   lookup        the cache of the cells
   pattern       VPL: 4 x 4 pixels share 16 sets of lights; 1 to 16
   d_min         VPL: terms cos cos / d^2 over 1 / (4 cell diagonals)^2 are cut off there, and rays as short as that
                 bring back what was cut. Above 0: the thesis' 1 / (d_min + d^2), an area
   map_size      LOOKUP_MAPS: 256 texels along the side of a map
   tolerance     `rays` are sent. Above 0: as many as it takes for this much noise: RMS over the picture of indirect
                 light after the filter, as a share of its mean; at most `rays` (0: 1024). GATHER, PATH, AO
   history       only this picture counts; else those before, too
   keep          pictures that history remembers while things move: 16; at least 1
   relief        0: as it is. Up to 1: indirect light times (relief * cos + 1 - relief), cos between normal and camera:
                 shows shapes where strong filters have made all alike, and is darker (thesis 8.6.1, equation 7)
   report        out, may be NULL */
typedef struct voxrt_gi_render_desc {
    uint32_t _begin_zero;
    voxrt_env env;
    voxrt_isa isa;
    voxrt_gi_method method;
    voxrt_camera camera;
    uint32_t rays, bounces;
    float radius;
    uint32_t first_ray;
    const voxrt_geometry *shadow;
    float shadow_lift;           /* world: how far shadow rays through `shadow` start above the surface */
    uint32_t filter, direct_filter;
    uint32_t coarse;
    float detail;
    voxrt_gi_lookup lookup;
    uint32_t pattern;
    float d_min;
    uint32_t map_size;
    float tolerance;
    voxrt_gi_history *history;
    float keep;
    float relief;
    voxrt_gi_report *report;
    uint32_t _end_zero;
} voxrt_gi_render_desc;

/* Light a G-buffer. direct, indirect: rgb for each pixel, linear: what the surface sends to the camera because of
   lights (with its emission), and because of other surfaces; may be NULL. Surfaces that emit light count as lights. The
   same bits for any number of threads and any isa. env.progress_fn may stop it: what is drawn then is of no use, a
   history stays as it was. Errors: INVALID_ARG, UNINIT_DESC, NO_MEMORY, CANCELLED. Thread
   safety: one call on a scene at a time (it fills the cache). Source: thesis (2010) 6, 7, 8.6. */
VOXRT_DEF voxrt_result voxrt_gi_render(const voxrt_gi_render_desc *desc, voxrt_gi *gi, const voxrt_gbuffer *gbuffer,
                                       float *direct, float *indirect, voxrt_stats *stats);

/* One more bounce: each side of each cell gathers the light of the others with `rays` rays (0: 16), and what it finds
   counts from now on at hits. weight: share of the new value (0: 1); smaller ones let it follow a moving scene without
   flicker. The more often it is called the more bounces there are. seed: another one gives other rays. */
VOXRT_DEF voxrt_result voxrt_gi_bounce(voxrt_gi *gi, const voxrt_env *env, uint32_t rays, float weight, uint32_t seed);

/* Keep frames within a time. Zero it before the first frame; before each frame draw with `rays` and `coarse`, after it
   tell how long it took.
   most    rays a pixel at best; 0: 64
   light_ms, of frame_ms, is what voxrt_gi_render took: it goes by rays, the rest by the frame. Returns 1 when
   the next frame is drawn otherwise than the last. O(1). Times that are not positive numbers change nothing. */
typedef struct voxrt_gi_budget {
    uint32_t rays, coarse, most;
    float _ray_ms;
} voxrt_gi_budget;
VOXRT_DEF int voxrt_gi_budget_update(voxrt_gi_budget *budget, const voxrt_gi_report *report, float frame_ms,
                                     float light_ms, float target_ms);

/* Virtual point lights of the last picture by VOXRT_GI_VPL: xyz, normal and rgb (flux) of each, 9 floats, up to `most`
   of them. Returns how many there are: to show where they lie. */
VOXRT_DEF size_t voxrt_gi_virtual_lights(const voxrt_gi *gi, float *out, size_t most);

typedef enum voxrt_tone {
    VOXRT_TONE_LINEAR = 0, VOXRT_TONE_LOG = 1, VOXRT_TONE_DRAGO = 2, VOXRT_TONE_FORCE_32BIT = 0x7fffffff
} voxrt_tone;
/* rgb (linear, [pixels]) -> values in 0..1, linear, for display; `most` becomes white. In place is allowed.
   Source: Drago et al. 2003 (bias 0.85). */
VOXRT_DEF voxrt_result voxrt_tone_map(voxrt_tone tone, float most, const float *rgb, float *out_rgb, size_t pixels);
#endif /* VOXRT_NO_GI */

/* ---- misc ---- */

VOXRT_DEF const char *voxrt_result_string(voxrt_result result);
VOXRT_DEF uint32_t voxrt_version(void);
VOXRT_DEF const char *voxrt_isa_name(voxrt_isa isa);
VOXRT_DEF voxrt_isa voxrt_isa_best(void); /* what VOXRT_ISA_AUTO picks on this machine */

#ifdef __cplusplus
}
#endif
#endif /* VOXRT_H_INCLUDED */

/* End of API. Stop here if you only use the library. */

#if defined(__INTELLISENSE__) || defined(__JETBRAINS_IDE__)
#  define VOXRT_IMPLEMENTATION
#endif
#if defined(VOXRT_IMPLEMENTATION) && !defined(VOXRT_IMPLEMENTATION_DONE)
#define VOXRT_IMPLEMENTATION_DONE

/* ---------------------------------------------------------------------------
   platform: compiler, instruction sets, asserts, bytes.                        // >>platform
   Equal in all three headers but for the prefix, up to and including math.
   --------------------------------------------------------------------------- */
#include <string.h>
#include <math.h>
#if defined(VOXRT_MALLOC) != defined(VOXRT_FREE)
#  error "define both or neither of VOXRT_MALLOC(size,user) and VOXRT_FREE(ptr,size,user)"
#endif
#ifndef VOXRT_MALLOC
#  include <stdlib.h>
#  define VOXRT_MALLOC(size, user) ((void)(user), malloc(size))
#  define VOXRT_FREE(ptr, size, user) ((void)(user), (void)(size), free(ptr))
#endif
#ifndef VOXRT_ASSERT
#  include <assert.h>
#  define VOXRT_ASSERT(cond) assert(cond)
#endif
#if defined(__FAST_MATH__) && !defined(VOXRT_ALLOW_FAST_MATH)
#  error "voxrt.h needs NaN and infinity; build without -ffast-math or define VOXRT_ALLOW_FAST_MATH"
#endif
#if defined(__wasm__) && !defined(VOXRT_NO_THREADS)
#  define VOXRT_NO_THREADS
#endif
#ifndef VOXRT_NO_THREADS
#  include <pthread.h>
#  include <unistd.h>
#endif
#ifndef VOXRT_NO_STDIO
#  include <stdio.h>
#endif
#if !defined(VOXRT_NO_SIMD) && (defined(__x86_64__) || defined(_M_X64))
#  define VOXRTI_X64 1
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
#    define VOXRTI_TARGET_AVX2
#  else
#    define VOXRTI_TARGET_AVX2 __attribute__((target("avx2,bmi,bmi2,lzcnt,popcnt"))) /* never "fma": same bits */
#  endif
#else
#  define VOXRTI_X64 0
#endif
#if VOXRTI_X64 && !defined(VOXRT_NO_AVX2)
#  define VOXRTI_AVX2 1
#else
#  define VOXRTI_AVX2 0
#endif
#if defined(__GNUC__) && !defined(__clang__)
#  pragma GCC push_options
#  pragma GCC optimize("fp-contract=off")
#elif defined(__clang__)
#  pragma STDC FP_CONTRACT OFF
#endif
#if defined(__GNUC__) || defined(__clang__)
#  if defined(__OPTIMIZE__)
#    define VOXRTI_INLINE static inline __attribute__((always_inline, unused))
#  else /* each inlined copy would have stack of its own */
#    define VOXRTI_INLINE static inline __attribute__((unused))
#  endif
#  define VOXRTI_UNUSED __attribute__((unused))
#  define VOXRTI_NOINLINE __attribute__((noinline))
#  define VOXRTI_LIKELY(x) __builtin_expect(!!(x), 1)
#  define VOXRTI_UNLIKELY(x) __builtin_expect(!!(x), 0)
#  define VOXRTI_PREFETCH(p) __builtin_prefetch(p)
#else
#  define VOXRTI_INLINE static inline
#  define VOXRTI_UNUSED
#  define VOXRTI_NOINLINE
#  define VOXRTI_LIKELY(x) (x)
#  define VOXRTI_UNLIKELY(x) (x)
#  define VOXRTI_PREFETCH(p) ((void)(p))
#endif
#ifdef __cplusplus
extern "C" {
#endif

/* Levels: 1 scalar, 2 SSE 4.1 with POPCNT, 3 AVX2 with BMI2 and POPCNT. */
VOXRTI_UNUSED static int voxrti_cpu_level(void) {
#if VOXRTI_X64 && !defined(_MSC_VER)
    int level = __builtin_cpu_supports("sse4.1") && __builtin_cpu_supports("popcnt") ? 2 : 1;
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("bmi2") && __builtin_cpu_supports("popcnt")) level = 3;
    return level;
#elif VOXRTI_X64
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
#  define voxrti_popcount64(x) ((uint32_t)__builtin_popcountll(x))
#else
VOXRTI_INLINE uint32_t voxrti_popcount64(uint64_t x) {
    x -= (x >> 1) & 0x5555555555555555u;
    x = (x & 0x3333333333333333u) + ((x >> 2) & 0x3333333333333333u);
    x = (x + (x >> 4)) & 0x0f0f0f0f0f0f0f0fu;
    return (uint32_t)((x * 0x0101010101010101u) >> 56);
}
#endif
#if defined(__GNUC__) || defined(__clang__)
#  define voxrti_ctz64(x) ((uint32_t)__builtin_ctzll(x)) /* x != 0 */
#  define voxrti_clz32(x) ((uint32_t)__builtin_clz(x))   /* x != 0 */
#else
VOXRTI_INLINE uint32_t voxrti_ctz64(uint64_t x) { return voxrti_popcount64((x & (0u - x)) - 1u); }
VOXRTI_INLINE uint32_t voxrti_clz32(uint32_t x) {
    x |= x >> 1; x |= x >> 2; x |= x >> 4; x |= x >> 8; x |= x >> 16;
    return 32u - voxrti_popcount64(x);
}
#endif

VOXRTI_INLINE uint32_t voxrti_load_u16(const uint8_t *p) { return (uint32_t)p[0] | (uint32_t)p[1] << 8; }
VOXRTI_INLINE uint32_t voxrti_load_u32(const uint8_t *p) {
    return (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}
VOXRTI_INLINE uint64_t voxrti_load_u64(const uint8_t *p) {
    return (uint64_t)voxrti_load_u32(p) | (uint64_t)voxrti_load_u32(p + 4) << 32;
}
VOXRTI_INLINE void voxrti_store_u16(uint8_t *p, uint32_t v) { p[0] = (uint8_t)v; p[1] = (uint8_t)(v >> 8); }
VOXRTI_INLINE void voxrti_store_u32(uint8_t *p, uint32_t v) {
    p[0] = (uint8_t)v; p[1] = (uint8_t)(v >> 8); p[2] = (uint8_t)(v >> 16); p[3] = (uint8_t)(v >> 24);
}
VOXRTI_INLINE void voxrti_store_u64(uint8_t *p, uint64_t v) {
    voxrti_store_u32(p, (uint32_t)v);
    voxrti_store_u32(p + 4, (uint32_t)(v >> 32));
}
VOXRTI_INLINE int voxrti_little_endian(void) {
    const uint16_t one = 1;
    uint8_t b;
    memcpy(&b, &one, 1);
    return b;
}

/* ---------------------------------------------------------------------------
   memory: every byte comes from here; counted, limited, 64-byte aligned.       // >>memory
   --------------------------------------------------------------------------- */

typedef struct voxrti_mem {
    voxrt_allocator allocator;
    size_t limit;          /* 0: none */
    size_t used, peak;     /* atomics */
} voxrti_mem;

static void *voxrti_default_alloc(size_t size, void *user) { return VOXRT_MALLOC(size, user); }
static void voxrti_default_free(void *ptr, size_t size, void *user) { VOXRT_FREE(ptr, size, user); }

VOXRTI_INLINE int voxrti_mul_size(size_t a, size_t b, size_t *out) {
    if (b != 0 && a > (size_t)-1 / b) return 0;
    *out = a * b;
    return 1;
}

#if defined(__GNUC__)
#  define voxrti_atomic_add(p, v) __atomic_add_fetch(p, v, __ATOMIC_SEQ_CST)
#  define voxrti_atomic_load(p) __atomic_load_n(p, __ATOMIC_SEQ_CST)
#  define voxrti_atomic_store(p, v) __atomic_store_n(p, v, __ATOMIC_SEQ_CST)
#  define voxrti_atomic_max_step(p, seen, v) \
       __atomic_compare_exchange_n(p, seen, v, 0, __ATOMIC_SEQ_CST, __ATOMIC_SEQ_CST)
#else /* no built-in threads there: the host's parallel-for has to be serial */
#  define voxrti_atomic_add(p, v) (*(p) += (v))
#  define voxrti_atomic_load(p) (*(p))
#  define voxrti_atomic_store(p, v) (*(p) = (v))
#  define voxrti_atomic_max_step(p, seen, v) (*(p) = (v), 1)
#endif

/* Not every machine has 64-bit atomics: what threads add to is a low and a high half. Read it after they ended. */
VOXRTI_INLINE void voxrti_tally_add(uint32_t sum[2], uint64_t n) {
    uint32_t low = voxrti_atomic_add(&sum[0], (uint32_t)n);
    (void)voxrti_atomic_add(&sum[1], (uint32_t)(n >> 32) + (low < (uint32_t)n));
}
VOXRTI_INLINE uint64_t voxrti_tally(const uint32_t sum[2]) { return (uint64_t)sum[1] << 32 | sum[0]; }

/* Before each block stand 64..127 bytes: the padding, then size and padding in the last 16. */
static VOXRTI_UNUSED void *voxrti_alloc(voxrti_mem *mem, size_t bytes) {
    size_t total, used, seen, skip;
    uint8_t *raw, *p;
    if (bytes > (size_t)-1 - 256) return NULL;
    total = bytes + 128;
    used = voxrti_atomic_add(&mem->used, total);
    if (mem->limit != 0 && used > mem->limit) {
        (void)voxrti_atomic_add(&mem->used, (size_t)0 - total);
        return NULL;
    }
    raw = (uint8_t *)mem->allocator.alloc_fn(total, mem->allocator.user);
    if (raw == NULL) {
        (void)voxrti_atomic_add(&mem->used, (size_t)0 - total);
        return NULL;
    }
    seen = voxrti_atomic_load(&mem->peak);
    while (seen < used && !voxrti_atomic_max_step(&mem->peak, &seen, used)) { }
    skip = 128 - (size_t)((uintptr_t)raw & 63u);
    if (skip > 64 + 63) skip -= 64;
    p = raw + skip;
    memcpy(p - 8, &skip, sizeof skip);
    memcpy(p - 16, &total, sizeof total);
    return p;
}

static VOXRTI_UNUSED void *voxrti_alloc_array(voxrti_mem *mem, size_t count, size_t size) {
    size_t bytes;
    return voxrti_mul_size(count, size, &bytes) ? voxrti_alloc(mem, bytes) : NULL;
}

static VOXRTI_UNUSED void *voxrti_alloc_zero(voxrti_mem *mem, size_t count, size_t size) {
    size_t bytes;
    void *p = NULL;
    if (voxrti_mul_size(count, size, &bytes)) p = voxrti_alloc(mem, bytes);
    if (p != NULL) memset(p, 0, bytes);
    return p;
}

static VOXRTI_UNUSED void voxrti_free(voxrti_mem *mem, void *ptr) {
    size_t total = 0, skip = 0;
    uint8_t *p = (uint8_t *)ptr;
    if (p == NULL) return;
    memcpy(&skip, p - 8, sizeof skip);
    memcpy(&total, p - 16, sizeof total);
    (void)voxrti_atomic_add(&mem->used, (size_t)0 - total);
    mem->allocator.free_fn(p - skip, total, mem->allocator.user);
}

/* Make room for `need` elements by doubling; keeps the old block when it fails. 1 on success. */
static VOXRTI_UNUSED int voxrti_grow(voxrti_mem *mem, void **array, size_t *capacity, size_t count,
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
    p = voxrti_alloc_array(mem, cap, size);
    if (p == NULL) return 0;
    if (count != 0) memcpy(p, *array, count * size);
    voxrti_free(mem, *array);
    *array = p;
    *capacity = cap;
    return 1;
}

/* ---------------------------------------------------------------------------
   threads: one parallel-for; tasks are cut by a fixed rule, so results do not  // >>threads
   depend on how many threads run them. Error reports.
   --------------------------------------------------------------------------- */

typedef struct voxrti_for {
    voxrt_task_fn *task;
    void *ctx;
    uint32_t count;
    uint32_t next; /* atomic */
} voxrti_for;

static void voxrti_for_drain(voxrti_for *f) {
    for (;;) {
        uint32_t i = voxrti_atomic_add(&f->next, 1u) - 1u;
        if (i >= f->count) return;
        f->task(f->ctx, i);
    }
}

#ifndef VOXRT_NO_THREADS
static void *voxrti_for_thread(void *arg) {
    voxrti_for_drain((voxrti_for *)arg);
    return NULL;
}
#endif

static VOXRTI_UNUSED uint32_t voxrti_thread_count(const voxrt_env *env) {
    uint32_t n = env->thread_count;
#ifndef VOXRT_NO_THREADS
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
static VOXRTI_UNUSED void voxrti_parallel_for(const voxrt_env *env, voxrt_task_fn *task, void *ctx,
                                                    uint32_t count) {
    voxrti_for f;
    f.task = task;
    f.ctx = ctx;
    f.count = count;
    f.next = 0;
    if (count == 0) return;
    if (env->parallel.for_fn != NULL) {
        env->parallel.for_fn(task, ctx, count, env->parallel.user);
        return;
    }
#ifndef VOXRT_NO_THREADS
    {
        pthread_t thread[64];
        pthread_attr_t attr;
        uint32_t want = voxrti_thread_count(env), started = 0, i;
        if (want > count) want = count;
        if (want > 1 && pthread_attr_init(&attr) == 0) {
            (void)pthread_attr_setstacksize(&attr, 512 * 1024);
            while (started + 1 < want && pthread_create(&thread[started], &attr, voxrti_for_thread, &f) == 0)
                started++;
            (void)pthread_attr_destroy(&attr);
        }
        voxrti_for_drain(&f);
        for (i = 0; i < started; i++) (void)pthread_join(thread[i], NULL);
    }
#else
    voxrti_for_drain(&f);
#endif
}

/* Check a desc's env and take its allocator. */
static VOXRTI_UNUSED voxrt_result voxrti_env_open(const voxrt_env *env, voxrti_mem *mem) {
    if ((env->allocator.alloc_fn == NULL) != (env->allocator.free_fn == NULL)) return VOXRT_ERR_INVALID_ARG;
    memset(mem, 0, sizeof *mem);
    mem->allocator = env->allocator;
    mem->limit = env->memory_limit;
    if (mem->allocator.alloc_fn == NULL) {
        mem->allocator.alloc_fn = voxrti_default_alloc;
        mem->allocator.free_fn = voxrti_default_free;
    }
    return VOXRT_OK;
}

/* text may hold one "%": it is replaced by the number `where`. */
static VOXRTI_UNUSED voxrt_result voxrti_fail(voxrt_error *error, voxrt_result code, uint64_t where,
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

VOXRTI_INLINE int voxrti_finite_f(float x) { return x - x == 0.0f; }
VOXRTI_INLINE int voxrti_finite(double x) { return x - x == 0.0; }
VOXRTI_INLINE double voxrti_min(double a, double b) { return a < b ? a : b; }
VOXRTI_INLINE double voxrti_max(double a, double b) { return a > b ? a : b; }
VOXRTI_INLINE double voxrti_abs(double a) { return a < 0 ? -a : a; }
VOXRTI_INLINE float voxrti_absf(float a) { return a < 0 ? -a : a; }
VOXRTI_INLINE float voxrti_dot3(const float *a, const float *b) { return a[0] * b[0] + a[1] * b[1] + a[2] *
                                                                       b[2]; }

/* floor for |x| < 2^62 */
VOXRTI_INLINE int64_t voxrti_floor(double x) {
    int64_t i = (int64_t)x;
    return i - ((double)i > x);
}

VOXRTI_INLINE int voxrti_normalize(float v[3]) { /* 0: no direction, v unchanged */
    double x = (double)v[0], y = (double)v[1], z = (double)v[2], l = x * x + y * y + z * z;
    if (!(l > 0.0) || !voxrti_finite(l)) return 0;
    l = 1.0 / sqrt(l);
    v[0] = (float)(x * l);
    v[1] = (float)(y * l);
    v[2] = (float)(z * l);
    return 1;
}

/* 2^x, |x| < 1000; relative error < 1e-13 */
static VOXRTI_UNUSED double voxrti_exp2(double x) {
    int64_t n = voxrti_floor(x + 0.5);
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
static VOXRTI_UNUSED double voxrti_log2(double x) {
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

static VOXRTI_UNUSED double voxrti_pow(double x, double y) {
    return x > 0.0 ? voxrti_exp2(y * voxrti_log2(x)) : 0.0;
}

/* sin and cos of |x| < 1e5; absolute error < 1e-15 */
static VOXRTI_UNUSED void voxrti_sincos(double x, double *s, double *c) {
    int64_t q = voxrti_floor(x * 0.63661977236758134308 + 0.5);
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

VOXRTI_INLINE uint64_t voxrti_spread3(uint64_t x) { /* 21 bits, two zeros between each */
    x &= 0x1fffff;
    x = (x | x << 32) & 0x1f00000000ffffu;
    x = (x | x << 16) & 0x1f0000ff0000ffu;
    x = (x | x << 8) & 0x100f00f00f00f00fu;
    x = (x | x << 4) & 0x10c30c30c30c30c3u;
    x = (x | x << 2) & 0x1249249249249249u;
    return x;
}
VOXRTI_INLINE uint32_t voxrti_compact3(uint64_t x) {
    x &= 0x1249249249249249u;
    x = (x | x >> 2) & 0x10c30c30c30c30c3u;
    x = (x | x >> 4) & 0x100f00f00f00f00fu;
    x = (x | x >> 8) & 0x1f0000ff0000ffu;
    x = (x | x >> 16) & 0x1f00000000ffffu;
    x = (x | x >> 32) & 0x1fffffu;
    return (uint32_t)x;
}
VOXRTI_INLINE uint64_t voxrti_morton(uint32_t x, uint32_t y, uint32_t z) {
    return voxrti_spread3(x) | voxrti_spread3(y) << 1 | voxrti_spread3(z) << 2;
}

VOXRTI_INLINE uint64_t voxrti_hash_mix(uint64_t h, uint64_t v) {
    h = (h ^ v) * 0x9e3779b97f4a7c15u;
    return h ^ (h >> 29);
}
/* counter-based random bits */
VOXRTI_INLINE uint32_t voxrti_hash32(uint32_t x) {
    x ^= x >> 16;
    x *= 0x7feb352du;
    x ^= x >> 15;
    x *= 0x846ca68bu;
    return x ^ (x >> 16);
}
static VOXRTI_UNUSED uint64_t voxrti_hash_bytes(uint64_t h, const void *data, size_t size) {
    const uint8_t *p = (const uint8_t *)data;
    for (; size >= 8; size -= 8, p += 8) h = voxrti_hash_mix(h, voxrti_load_u64(p));
    for (; size > 0; size--, p++) h = voxrti_hash_mix(h, *p);
    return h;
}

/* sRGB byte <-> linear; IEC 61966-2-1 */
static VOXRTI_UNUSED double voxrti_srgb_to_linear(double c) {
    return c <= 0.04045 ? c / 12.92 : voxrti_pow((c + 0.055) / 1.055, 2.4);
}
static VOXRTI_UNUSED double voxrti_linear_to_srgb(double c) {
    if (!(c > 0.0)) return 0.0;
    if (c >= 1.0) return 1.0;
    return c <= 0.0031308 ? c * 12.92 : 1.055 * voxrti_pow(c, 1.0 / 2.4) - 0.055;
}
/* table[i] = linear light of sRGB byte i in units of 1/65535, rounded; strictly ascending */
static VOXRTI_UNUSED void voxrti_srgb_table(uint32_t table[256]) {
    int i;
    for (i = 0; i < 256; i++) table[i] = (uint32_t)(voxrti_srgb_to_linear((double)i / 255.0) * 65535.0 + 0.5);
}
/* nearest table entry in linear light: exact inverse of the table */
static VOXRTI_UNUSED uint32_t voxrti_srgb_find(const uint32_t table[256], uint32_t linear) {
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
VOXRTI_INLINE void voxrti_oct_decode(uint32_t code, float n[3]) {
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
#if VOXRTI_X64
VOXRTI_INLINE uint32_t voxrti_oct_nearest(int ix, int iy, const float m[3]) {
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
    return voxrti_ctz64((uint64_t)((uint32_t)_mm_movemask_ps(_mm_cmpeq_ps(fx, fy)) | 16u));
}
#else
VOXRTI_INLINE uint32_t voxrti_oct_nearest(int ix, int iy, const float m[3]) {
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

static VOXRTI_UNUSED uint32_t voxrti_oct_encode(const float n[3]) {
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
    k = voxrti_oct_nearest(ix, iy, m);
    if (k > 3) return 0x8080u; /* NaN */
    ix += (int)(k & 1u);
    iy += (int)(k >> 1);
    return (uint32_t)(ix > 255 ? 255 : ix) | (uint32_t)(iy > 255 ? 255 : iy) << 8;
}

/* ---------------------------------------------------------------------------
   core: the bytes of a tree.                                                    // >>core

   A tree has `wide` levels; a node of wide level w covers 4x4x4 cells of octree level v = 2w+2 (v counts from the
   virtual root, a cube of 4^wide cells; when the depth is odd the model lives in the virtual root's octant 0).
   A node is one 64-bit mask. Bit i = x0 + 2*y0 + 4*z0 + 8*x1 + 16*y1 + 32*z1 (x = 2*x1 + x0 ...), Morton order, so
   that byte o of the mask is octant o, and every octree level can be addressed: level 2w+2 by bits, 2w+1 by bytes.
   Nodes of a level stand in Morton order. So the children of a node are contiguous, and the position of a cell
   among the filled cells of its level (its rank) is the index of its attributes. Nothing else is stored:
     interior nodes   16 bytes: mask, index of the first child, rank of the first octant
     leaf nodes        8 bytes: mask; and 8 bytes per 16 leaf nodes: ranks of the first voxel and octant
   Attributes of virtual level v start at attr_first[v], leaves first (attr_first[2*wide] = 0, then level 2*wide-1 and
   so on up to the root): palette index (compressed blocks of 64) and 16-bit normal.

   A shared tree (code != NULL) keeps equal lists of children once:
     interior nodes   16 bytes: mask, index of the first child, cells before it. The children of a node are a run of
                      consecutive nodes as above, but nodes with equal lists of children name the same run. A level is
                      its runs in the order in which they are first named
     leaf nodes       2 bytes: code of the mask, at `child` and behind it
     masks            8 bytes: those codes stand for, each once, the most frequent first. Only when there are more than
                      65536: codes below VOXRTI_COMMON are the most frequent ones, and each block of 4096 leaf nodes has
                      its own masks for the codes above
   Attributes stand depth first: the cell of a node, its octants, then (interior) child after child with all that is
   below it, or (leaf) its voxels. "Cells before" a node are the cells of its run that stand before it, of all levels:
   so the index of an attribute is a sum along the way down, and where the way began does not matter to it.
   --------------------------------------------------------------------------- */

#define VOXRTI_MAX_WIDE 10
#define VOXRTI_COMMON 61440u
#define VOXRTI_CODE_LOG 12 /* log2 of the leaf nodes with masks of their own */

typedef struct voxrti_node {
    uint64_t mask;
    uint32_t child;  /* index of the first child: in tree->node, on the last interior level in tree->leaf */
    uint32_t octant; /* rank of the node's first non-empty octant in its level; shared trees: cells before it */
} voxrti_node;

/* Colour indices of attr_count cells in blocks of 64 (see palette). index_bytes = 0: all cells have entry 0. */
typedef struct voxrti_colors {
    uint32_t *block;     /* [ceil(count/64)] */
    uint8_t *data;       /* [data_bytes], padded by 8 readable bytes */
    size_t block_count, data_bytes;
} voxrti_colors;

struct voxrt_tree {
    voxrti_mem mem;
    int cpu_level;
    uint32_t depth, wide, resolution;
    double origin[3], voxel_size;
    uint32_t cell_min[3], cell_max[3];        /* leaf cells, max exclusive */
    voxrti_node *node;                        /* wide levels 0..wide-2 */
    uint32_t level_first[VOXRTI_MAX_WIDE];    /* first node of wide level w in `node`; [wide-1] = 0 for leaves */
    uint32_t level_nodes[VOXRTI_MAX_WIDE];    /* nodes of wide level w; [wide-1]: leaf nodes */
    uint32_t node_count;                      /* interior nodes */
    uint64_t *leaf;                           /* [level_nodes[wide-1]], padded by 8 */
    uint32_t *rank;                           /* [2*(leaves/16 + 1)]: voxels, octants before leaf node 16*i */
    uint16_t *code;                           /* shared trees: [level_nodes[wide-1]], and `leaf` has masks; or NULL */
    uint32_t *extra;                          /* shared trees: [codes/4096 + 1], added to codes >= VOXRTI_COMMON */
    uint32_t mask_count;                      /* shared trees: masks in `leaf`, padded by 8; else 0 */
    uint64_t attr_first[2 * VOXRTI_MAX_WIDE + 2]; /* by virtual level 0..2*wide, descending; [2*wide+1] = 0 */
    uint64_t attr_count;
    uint64_t voxel_count;
    uint16_t *normal;                         /* [attr_count] or NULL */
    uint32_t spherical;                       /* 1: normals have the thesis' codes (see normals) */
    voxrti_colors colors;                     /* block = NULL: one colour */
    uint8_t *palette;                         /* [3*palette_count], at least one entry */
    uint32_t palette_count;
    const void *borrowed;                     /* the memory image the arrays point into, or NULL: owned */
};

/* Index in `leaf` of the mask of leaf node i. */
VOXRTI_INLINE uint32_t voxrti_leaf_at(const voxrt_tree *t, uint32_t i) {
    uint32_t c;
    if (t->code == NULL) return i;
    c = t->code[i];
    return c < VOXRTI_COMMON ? c : c + t->extra[i >> VOXRTI_CODE_LOG];
}

/* Filled leaves on their way into a tree: 4x4x4 blocks in ascending Morton order, the attributes of their voxels in
   the same order (block after block, bit after bit). Behind them, if lod_count is not 0, those of all larger cells in
   the order of a tree: they count if there are as many as the tree has, else they are made anew. */
typedef struct voxrti_leafset {
    uint64_t *key;    /* [block_count] Morton code of the block (voxel coordinates / 4) */
    uint64_t *mask;   /* [block_count] never 0 */
    uint32_t *rgb;    /* [voxel_count] 0x00BBGGRR, sRGB; NULL: no colours */
    uint16_t *normal; /* [voxel_count] codes; NULL: no normals */
    size_t block_count, voxel_count, lod_count;
    uint32_t spherical; /* as in voxrt_tree */
} voxrti_leafset;

static VOXRTI_UNUSED void voxrti_leafset_free(voxrti_mem *mem, voxrti_leafset *set) {
    voxrti_free(mem, set->key);
    voxrti_free(mem, set->mask);
    voxrti_free(mem, set->rgb);
    voxrti_free(mem, set->normal);
    memset(set, 0, sizeof *set);
}

/* How world positions map to cells: grid = (world - origin) / voxel_size. */
typedef struct voxrti_grid {
    double origin[3], voxel_size;
    uint32_t depth, resolution; /* resolution <= 2^depth */
} voxrti_grid;

/* bit of a mask <-> cell 0..3 in it */
VOXRTI_INLINE uint32_t voxrti_slot(uint32_t x, uint32_t y, uint32_t z) {
    return (x & 1u) | (y & 1u) << 1 | (z & 1u) << 2 | (x & 2u) << 2 | (y & 2u) << 3 | (z & 2u) << 4;
}
VOXRTI_INLINE uint32_t voxrti_slot_x(uint32_t s) { return (s & 1u) | (s >> 2 & 2u); }
VOXRTI_INLINE uint32_t voxrti_slot_y(uint32_t s) { return (s >> 1 & 1u) | (s >> 3 & 2u); }
VOXRTI_INLINE uint32_t voxrti_slot_z(uint32_t s) { return (s >> 2 & 1u) | (s >> 4 & 2u); }

/* bit o of the result = byte o of the mask is not 0 */
VOXRTI_INLINE uint32_t voxrti_octants(uint64_t mask) {
    uint64_t m = mask | mask >> 4;
    m |= m >> 2;
    m |= m >> 1;
    m &= 0x0101010101010101u;
    return (uint32_t)((m * 0x0102040810204080u) >> 56);
}

/* Layers of a mask along x, y, z. */
static const uint64_t voxrti_layer[3][4] = {
    {0x0055005500550055u, 0x00aa00aa00aa00aau, 0x5500550055005500u, 0xaa00aa00aa00aa00u},
    {0x0000333300003333u, 0x0000cccc0000ccccu, 0x3333000033330000u, 0xcccc0000cccc0000u},
    {0x000000000f0f0f0fu, 0x00000000f0f0f0f0u, 0x0f0f0f0f00000000u, 0xf0f0f0f000000000u}};

/* Box of the cells of a mask along axis a, 0..4, hi exclusive; the mask is not 0. */
VOXRTI_INLINE uint32_t voxrti_mask_lo(uint64_t mask, uint32_t a) {
    const uint64_t *l = voxrti_layer[a];
    return (mask & l[0]) != 0 ? 0u : (mask & l[1]) != 0 ? 1u : (mask & l[2]) != 0 ? 2u : 3u;
}
VOXRTI_INLINE uint32_t voxrti_mask_hi(uint64_t mask, uint32_t a) {
    const uint64_t *l = voxrti_layer[a];
    return (mask & l[3]) != 0 ? 4u : (mask & l[2]) != 0 ? 3u : (mask & l[1]) != 0 ? 2u : 1u;
}

/* ---------------------------------------------------------------------------
   normals: the thesis' codes, and which code a tree has.                        // >>normals
   A tree has octahedral normals (see math), or the thesis' when it was made from an octree: so none is rounded twice,
   and an octree comes back from a tree as it was.
   --------------------------------------------------------------------------- */

/* angle of (x, y), error < 1e-13; 0 for the zero vector */
static double voxrti_atan2(double y, double x) {
    double ax = voxrti_abs(x), ay = voxrti_abs(y), m = voxrti_max(ax, ay), r, base = 0, p, s = 0;
    int i;
    if (!(m > 0)) return 0;
    r = voxrti_min(ax, ay) / m;
    if (r > 0.41421356237309504880) {
        r = (r - 1) / (r + 1);
        base = 0.78539816339744830962;
    }
    p = r;
    for (i = 1; i < 36; i += 2) {
        s = s + p / (double)i;
        p = -p * r * r;
    }
    s = base + s;
    if (ay > ax) s = 1.57079632679489661923 - s;
    if (x < 0) s = 3.14159265358979323846 - s;
    return y < 0 ? -s : s;
}

/* Spherical normals of 8+8 bits (thesis eq. 12). Nearest code: theta | phi << 8. -z is out of reach (theta <= 179.3
   degrees). At the pole theta = 0 phi is 0, so that every direction has one code. */
static VOXRTI_UNUSED uint32_t voxrti_sph_encode(const float n[3]) {
    double x = (double)n[0], y = (double)n[1], z = (double)n[2];
    double theta = voxrti_atan2(sqrt(x * x + y * y), z) * 81.487330863050416;  /* 256 / pi */
    double phi = voxrti_atan2(y, x) * 40.743665431525208;
    int64_t t, p;
    if (!voxrti_finite(theta) || !voxrti_finite(phi)) return 0;
    t = voxrti_floor(theta + 0.5);
    p = voxrti_floor(phi + 0.5);
    if (t > 255) t = 255;
    if (t <= 0) return 0;
    return (uint32_t)t | ((uint32_t)p & 255u) << 8;
}

/* sin and cos of k pi/256. Exact reduction to +-pi/4 in units of the code, then polynomials (Cephes): error < 1e-7. The
   4-wide form does the same operations. */
VOXRTI_INLINE void voxrti_sph_sincos(int32_t k, float *s, float *c) {
    int32_t q = (k + 64) >> 7;
    float x = (float)(k - q * 128) * 0.012271846303085130f, x2 = x * x, ps, pc, v;
    ps = ((-1.9515295891e-4f * x2 + 8.3321608736e-3f) * x2 + -1.6666654611e-1f) * x2 * x + x;
    pc = ((2.443315711809948e-5f * x2 + -1.388731625493765e-3f) * x2 + 4.166664568298827e-2f) * x2 * x2;
    pc = pc + (1.0f - 0.5f * x2);
    if (q & 1) {
        v = ps;
        ps = pc;
        pc = -v;
    }
    *s = (q & 2) ? -ps : ps;
    *c = (q & 2) ? -pc : pc;
}
VOXRTI_INLINE void voxrti_sph_decode(uint32_t theta, int32_t phi, float n[3]) {
    float st, ct, sp, cp;
    voxrti_sph_sincos((int32_t)theta, &st, &ct);
    voxrti_sph_sincos(2 * phi, &sp, &cp);
    n[0] = st * cp;
    n[1] = st * sp;
    n[2] = ct;
}


/* Normals of a tree: `spherical` as in voxrt_tree. */
VOXRTI_INLINE void voxrti_normal_decode(uint32_t spherical, uint32_t code, float n[3]) {
    if (spherical) voxrti_sph_decode(code & 255u, (int32_t)((code >> 8 ^ 128u) & 255u) - 128, n);
    else voxrti_oct_decode(code, n);
}
VOXRTI_INLINE uint32_t voxrti_normal_encode(uint32_t spherical, const float n[3]) {
    return spherical ? voxrti_sph_encode(n) : voxrti_oct_encode(n);
}

/* ---------------------------------------------------------------------------
   palette: colours become indices.                                              // >>palette

   A palette has 3 sRGB bytes an entry, sorted by the Morton code of (green, red, blue), so that similar colours have
   near indices. Few enough colours are kept exactly. Otherwise they are merged pair by pair: in Oklab with Ward's cost
   and k-means on top, or in RGB as the thesis does it.
   The stream of indices: blocks of 64, one little-endian word each (in memory: host order), bits 0..3 kind:
     0      all 64 are index word>>4. Other kinds: data at byte 4*(word>>4)
     1      u32: base | bits<<24 (bits 1..24); then 64 codes of `bits` bits: index = base + code
     2..6   64 codes of kind-1 bits, then a table of u16: index = table[code]
     7..11  64 codes of kind-6 bits, then a table of u24
   Code j starts at bit j*bits, low bits first. The table ends with the largest code in use.
   --------------------------------------------------------------------------- */

VOXRTI_INLINE uint32_t voxrti_colors_bits(uint32_t x) { return x == 0 ? 0 : 32u - voxrti_clz32(x); }

VOXRTI_INLINE uint32_t voxrti_load_u24(const uint8_t *p) {
    return (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16;
}

/* code j of a block of codes; may read 3 bytes past them */
VOXRTI_INLINE uint32_t voxrti_colors_code(const uint8_t *codes, uint32_t bits, uint32_t j) {
    uint32_t bit = j * bits;
    return voxrti_load_u32(codes + (bit >> 3)) >> (bit & 7u) & ((1u << bits) - 1u);
}

/* Palette index of cell i. c->block must not be NULL, i < count. */
VOXRTI_INLINE uint32_t voxrti_colors_get(const voxrti_colors *c, uint64_t i) {
    uint32_t word = c->block[i >> 6], kind = word & 15u, j = (uint32_t)i & 63u, bits;
    const uint8_t *p;
    if (kind == 0) return word >> 4;
    p = c->data + (size_t)(word >> 4) * 4;
    if (kind == 1) {
        word = voxrti_load_u32(p);
        return (word & 0xffffffu) + voxrti_colors_code(p + 4, word >> 24, j);
    }
    bits = kind < 7 ? kind - 1 : kind - 6;
    j = voxrti_colors_code(p, bits, j);
    p += 8 * bits;
    return kind < 7 ? voxrti_load_u16(p + 2 * j) : voxrti_load_u24(p + 3 * j);
}

/* out[k] = index of cell first + k; c->block may be NULL (all 0). */
static VOXRTI_UNUSED void voxrti_colors_decode(const voxrti_colors *c, uint64_t first, size_t n, uint32_t *out) {
    size_t k = 0;
    while (k < n) {
        uint64_t i = first + k;
        uint32_t word = c->block != NULL ? c->block[i >> 6] : 0;
        size_t stop = 64 - (size_t)(i & 63u);
        stop = n - k < stop ? n : k + stop;
        if ((word & 15u) == 0) {
            for (; k < stop; k++) out[k] = word >> 4;
        } else {
            for (; k < stop; k++) out[k] = voxrti_colors_get(c, first + k);
        }
    }
}

/* 1 if every index of untrusted blocks is < palette_count and lies in the data, so that get and decode are safe. */
static VOXRTI_UNUSED int voxrti_colors_valid(const voxrti_colors *c, uint64_t count, uint32_t palette_count) {
    size_t b;
    if (palette_count == 0) return 0;
    if (c->block == NULL) return c->block_count == 0 && c->data_bytes == 0;
    if (c->block_count != (count + 63) / 64 || (c->data == NULL && c->data_bytes != 0)) return 0;
    for (b = 0; b < c->block_count; b++) {
        uint32_t word = c->block[b], kind = word & 15u, bits, j, k, high = 0;
        size_t at = (size_t)(word >> 4) * 4, room;
        const uint8_t *p = c->data;
        if (kind == 0) {
            if (word >> 4 >= palette_count) return 0;
            continue;
        }
        if (kind > 11 || at > c->data_bytes || c->data_bytes - at < 8) return 0;
        p += at;
        room = c->data_bytes - at;
        bits = kind == 1 ? p[3] : kind < 7 ? kind - 1 : kind - 6;
        if (bits < 1 || bits > 24) return 0;
        if (kind == 1) {
            room -= 4;
            p += 4;
        }
        if (room < 8 * (size_t)bits) return 0;
        room -= 8 * (size_t)bits;
        if (kind == 1) {
            const uint32_t base = voxrti_load_u32(p - 4) & 0xffffffu;
            if (base + ((1u << bits) - 1) < palette_count) continue; /* whatever the codes are */
            for (j = 0; j < 64; j++)
                if (base + voxrti_colors_code(p, bits, j) >= palette_count) return 0;
            continue;
        }
        for (j = 0; j < 8; j++) { /* 8 codes of at most 5 bits at a time */
            uint64_t codes = voxrti_load_u64(p + bits * j);
            for (k = 0; k < 8; k++, codes >>= bits) {
                const uint32_t code = (uint32_t)codes & ((1u << bits) - 1);
                if (code > high) high = code;
            }
        }
        if (room < (size_t)(high + 1) * (kind < 7 ? 2u : 3u)) return 0;
        p += 8 * bits;
        for (j = 0; j <= high; j++)
            if ((kind < 7 ? voxrti_load_u16(p + 2 * j) : voxrti_load_u24(p + 3 * j)) >= palette_count) return 0;
    }
    return 1;
}

#define VOXRTI_COLORS_CHUNK 1024 /* blocks in one task */

typedef struct voxrti_colors_plan { /* the cheapest form of one block */
    uint32_t kind, bits, base, entries, bytes; /* bytes: multiple of 4 */
    uint32_t table[32];
    uint8_t code[64];
} voxrti_colors_plan;

static void voxrti_colors_choose(const uint32_t *v, voxrti_colors_plan *p) {
    uint32_t lo = v[0], hi = v[0], j, k = 0, width, bits, bytes;
    uint8_t slot[128];
    for (j = 1; j < 64; j++) {
        lo = v[j] < lo ? v[j] : lo;
        hi = v[j] > hi ? v[j] : hi;
    }
    p->base = lo;
    p->kind = 0;
    p->bytes = 0;
    if (lo == hi) return;
    p->kind = 1;
    p->bits = voxrti_colors_bits(hi - lo);
    p->bytes = 4 + 8 * p->bits;
    if (p->bits < 2) return;
    width = hi < 0x10000u ? 2 : 3;
    memset(slot, 255, sizeof slot);
    for (j = 0; j < 64; j++) {
        uint32_t h = v[j] * 0x9e3779b1u >> 25;
        while (slot[h] != 255 && p->table[slot[h]] != v[j]) h = (h + 1) & 127u;
        if (slot[h] == 255) {
            if (k == 32) return;
            slot[h] = (uint8_t)k;
            p->table[k++] = v[j];
        }
        p->code[j] = slot[h];
    }
    bits = voxrti_colors_bits(k - 1);
    bytes = (8 * bits + width * k + 3u) & ~3u;
    if (bytes >= p->bytes) return;
    p->kind = width == 2 ? bits + 1 : bits + 6;
    p->bits = bits;
    p->entries = k;
    p->bytes = bytes;
}

static void voxrti_colors_write(const voxrti_colors_plan *p, const uint32_t *v, uint8_t *out) {
    uint64_t acc = 0;
    uint32_t j, held = 0;
    if (p->kind == 1) {
        voxrti_store_u32(out, p->base | p->bits << 24);
        out += 4;
    }
    for (j = 0; j < 64; j++) {
        acc |= (uint64_t)(p->kind == 1 ? v[j] - p->base : p->code[j]) << held;
        for (held += p->bits; held >= 8; held -= 8, acc >>= 8) *out++ = (uint8_t)acc;
    }
    for (j = 0; p->kind != 1 && j < p->entries; j++) {
        voxrti_store_u16(out, p->table[j]);
        out += 2;
        if (p->kind >= 7) *out++ = (uint8_t)(p->table[j] >> 16);
    }
}

typedef struct voxrti_colors_job {
    const uint32_t *index;
    size_t count, block_count;
    uint32_t *block;
    uint8_t *data;
    uint64_t *first; /* per task: pass 1 writes its bytes, pass 2 reads where they start */
    uint32_t *top;   /* per task: largest index */
    int pass;
} voxrti_colors_job;

static void voxrti_colors_task(void *ctx, uint32_t t) {
    voxrti_colors_job *job = (voxrti_colors_job *)ctx;
    size_t b = (size_t)t * VOXRTI_COLORS_CHUNK, stop = b + VOXRTI_COLORS_CHUNK;
    uint64_t at = job->pass == 1 ? 0 : job->first[t];
    voxrti_colors_plan plan;
    uint32_t tail[64], top = 0, j;
    memset(&plan, 0, sizeof plan);
    if (stop > job->block_count) stop = job->block_count;
    for (; b < stop; b++) {
        const uint32_t *v = job->index + b * 64;
        if (job->pass == 2 && (job->block[b] & 15u) == 0) continue;
        if (job->count - b * 64 < 64) { /* the last block repeats its last index */
            for (j = 0; j < 64; j++) tail[j] = v[b * 64 + j < job->count ? j : job->count - 1 - b * 64];
            v = tail;
        }
        voxrti_colors_choose(v, &plan);
        if (job->pass == 1) {
            for (j = 0; j < 64; j++) top = v[j] > top ? v[j] : top;
            job->block[b] = plan.kind != 0 ? plan.kind : plan.base << 4;
        } else {
            memset(job->data + at + plan.bytes - 4, 0, 4);
            voxrti_colors_write(&plan, v, job->data + at);
            job->block[b] = plan.kind | (uint32_t)(at / 4) << 4;
        }
        at += plan.bytes;
    }
    if (job->pass == 1) {
        job->first[t] = at;
        job->top[t] = top;
    }
}

/* Compress palette indices (each < 2^24). out->block = NULL if all are 0. The same bytes for any thread count.
   Errors: NO_MEMORY, RANGE (an index >= 2^24, or more than 1 GB of data); then *out is all zero. */
static VOXRTI_UNUSED voxrt_result voxrti_colors_encode(voxrti_mem *mem, const voxrt_env *env, const uint32_t *index,
                                                       size_t count, voxrti_colors *out) {
    voxrti_colors_job job;
    size_t tasks, t;
    uint64_t total = 0;
    uint32_t top = 0;
    voxrt_result r = VOXRT_OK;
    memset(out, 0, sizeof *out);
    memset(&job, 0, sizeof job);
    if (count == 0) return VOXRT_OK;
    job.index = index;
    job.count = count;
    job.block_count = (count - 1) / 64 + 1;
    tasks = (job.block_count - 1) / VOXRTI_COLORS_CHUNK + 1;
    if (tasks > 0x7fffffffu) return VOXRT_ERR_RANGE;
    job.block = (uint32_t *)voxrti_alloc_array(mem, job.block_count, sizeof(uint32_t));
    job.first = (uint64_t *)voxrti_alloc_array(mem, tasks, sizeof(uint64_t));
    job.top = (uint32_t *)voxrti_alloc_array(mem, tasks, sizeof(uint32_t));
    if (job.block == NULL || job.first == NULL || job.top == NULL) r = VOXRT_ERR_NO_MEMORY;
    if (r == VOXRT_OK) {
        job.pass = 1;
        voxrti_parallel_for(env, voxrti_colors_task, &job, (uint32_t)tasks);
        for (t = 0; t < tasks; t++) {
            uint64_t bytes = job.first[t];
            job.first[t] = total;
            total += bytes;
            top = job.top[t] > top ? job.top[t] : top;
        }
        if (top >= 0x1000000u) r = voxrti_fail(env->error, VOXRT_ERR_RANGE, top, "palette index % is too large");
        else if (total > (uint64_t)1 << 30)
            r = voxrti_fail(env->error, VOXRT_ERR_RANGE, total, "colours take % bytes, more than 1 GB");
    }
    if (r == VOXRT_OK && total != 0) {
        job.data = (uint8_t *)voxrti_alloc(mem, (size_t)total + 8);
        if (job.data == NULL) r = VOXRT_ERR_NO_MEMORY;
        else {
            memset(job.data + total, 0, 8);
            job.pass = 2;
            voxrti_parallel_for(env, voxrti_colors_task, &job, (uint32_t)tasks);
        }
    }
    voxrti_free(mem, job.first);
    voxrti_free(mem, job.top);
    if (r != VOXRT_OK || top == 0) {
        voxrti_free(mem, job.block);
        return r;
    }
    out->block = job.block;
    out->data = job.data;
    out->block_count = job.block_count;
    out->data_bytes = (size_t)total;
    return VOXRT_OK;
}

/* ---- sets of colours and ranks in them ----

   Members are Morton codes: similar colours have near ranks, and passes over them stay in the caches. A set that may
   get large is a bit for each of the 2^24 codes. Its 4 MB would be the larger part of a little build, which has a hash
   table. */

#define VOXRTI_CSET_WORDS 524288u
#define VOXRTI_CSET_HASHED 65536u /* sets of more members may have a bit for each code */

typedef struct voxrti_cset {
    /* pairs: 32 bits (not every machine has 64-bit atomics), members before them; or NULL: hashed, then pairs of
       1 + code (0: empty) and rank. Ranks are there after voxrti_cset_rank. */
    uint32_t *bits;   /* [2 * VOXRTI_CSET_WORDS] */
    uint32_t *slot;   /* [2 * (slot_mask + 1)] */
    uint32_t slot_mask;
    uint32_t *list;   /* [2 * most members] hashed: the codes, ascending, and scratch */
    uint32_t count;
} voxrti_cset;

static void voxrti_cset_close(voxrti_mem *mem, voxrti_cset *s) {
    voxrti_free(mem, s->bits);
    voxrti_free(mem, s->slot);
    voxrti_free(mem, s->list);
}

/* An empty set for at most `most` members. 0: no memory (still to be closed). */
static int voxrti_cset_open(voxrti_mem *mem, voxrti_cset *s, size_t most) {
    memset(s, 0, sizeof *s);
    if (most > VOXRTI_CSET_HASHED) {
        s->bits = (uint32_t *)voxrti_alloc_zero(mem, VOXRTI_CSET_WORDS, 2 * sizeof(uint32_t));
        return s->bits != NULL;
    }
    s->slot_mask = 63;
    while (s->slot_mask < 2 * most) s->slot_mask = 2 * s->slot_mask + 1;
    s->slot = (uint32_t *)voxrti_alloc_zero(mem, (size_t)s->slot_mask + 1, 2 * sizeof(uint32_t));
    s->list = (uint32_t *)voxrti_alloc_array(mem, 2 * most + 1, sizeof(uint32_t));
    return s->slot != NULL && s->list != NULL;
}

/* Slot of a code, or the empty one where it would be. */
VOXRTI_INLINE uint32_t voxrti_cset_slot(const voxrti_cset *s, uint32_t c) {
    uint32_t h = c * 0x9e3779b1u >> 7 & s->slot_mask;
    while (s->slot[2 * h] != 0 && s->slot[2 * h] != c + 1) h = (h + 1) & s->slot_mask;
    return h;
}

/* Any number of threads at once. */
static void voxrti_cset_add(voxrti_cset *s, uint32_t c) {
    if (s->bits != NULL) {
        uint32_t *word = &s->bits[c >> 5 << 1], bit = 1u << (c & 31u), old = voxrti_atomic_load(word);
        while ((old & bit) == 0 && !voxrti_atomic_max_step(word, &old, old | bit)) { }
    } else {
        uint32_t h = c * 0x9e3779b1u >> 7 & s->slot_mask;
        for (;; h = (h + 1) & s->slot_mask) { /* without threads the step does not compare: look first */
            uint32_t old = voxrti_atomic_load(&s->slot[2 * h]);
            if (old == c + 1 || (old == 0 && voxrti_atomic_max_step(&s->slot[2 * h], &old, c + 1))) return;
            if (old == c + 1) return; /* another thread was first */
        }
    }
}

static void voxrti_cset_rank(voxrti_cset *s) {
    uint32_t w, n = 0, shift, k, sum, c, start[256];
    if (s->bits != NULL) {
        for (w = 0; w < VOXRTI_CSET_WORDS; w++) {
            s->bits[2 * w + 1] = n;
            if (s->bits[2 * w] != 0) n += voxrti_popcount64(s->bits[2 * w]);
        }
        s->count = n;
        return;
    }
    for (w = 0; w <= s->slot_mask; w++)
        if (s->slot[2 * w] != 0) s->list[n++] = s->slot[2 * w] - 1;
    s->count = n;
    for (shift = 0; shift < 24; shift += 8) {
        uint32_t *from = shift == 8 ? s->list + n : s->list, *to = shift == 8 ? s->list : s->list + n;
        memset(start, 0, sizeof start);
        for (w = 0; w < n; w++) start[from[w] >> shift & 255u]++;
        for (k = 0, sum = 0; k < 256; k++) {
            c = start[k];
            start[k] = sum;
            sum += c;
        }
        for (w = 0; w < n; w++) to[start[from[w] >> shift & 255u]++] = from[w];
    }
    if (n != 0) memcpy(s->list, s->list + n, n * sizeof *s->list);
    for (w = 0; w < n; w++) s->slot[2 * voxrti_cset_slot(s, s->list[w]) + 1] = w;
}

VOXRTI_INLINE int voxrti_cset_has(const voxrti_cset *s, uint32_t c) {
    return s->bits != NULL ? (int)(s->bits[c >> 5 << 1] >> (c & 31u) & 1u) : s->slot[2 * voxrti_cset_slot(s, c)] != 0;
}
VOXRTI_INLINE uint32_t voxrti_cset_index(const voxrti_cset *s, uint32_t c) { /* of a member */
    const uint32_t *pair = s->bits != NULL ? s->bits + 2 * (size_t)(c >> 5) : s->slot + 2 * voxrti_cset_slot(s, c);
    return s->bits != NULL ? pair[1] + voxrti_popcount64(pair[0] & ((1u << (c & 31u)) - 1u)) : pair[1];
}

/* list[] = members in ascending order */
static void voxrti_cset_list(const voxrti_cset *s, uint32_t *list) {
    uint32_t w, n = 0;
    if (s->bits == NULL) {
        if (s->count != 0) memcpy(list, s->list, s->count * sizeof *list);
        return;
    }
    for (w = 0; w < VOXRTI_CSET_WORDS; w++) {
        uint32_t m = s->bits[2 * w];
        for (; m != 0; m &= m - 1) list[n++] = w * 32 + voxrti_ctz64(m);
    }
}

VOXRTI_INLINE uint32_t voxrti_pal_rgb_of(uint32_t code) {
    return voxrti_compact3(code >> 1) | voxrti_compact3(code >> 2) << 8 | voxrti_compact3(code) << 16;
}

/* Passes over all cells. A small cache per task saves most of the look-ups, as models have few colours at a place. */
#define VOXRTI_PAL_CHUNK ((size_t)1 << 16)
#define VOXRTI_PAL_CACHE 1024
#define VOXRTI_PAL_SLICES 16u /* tasks of the counting pass, each with its own counters while colours are few */

typedef struct voxrti_pal_pass {
    uint32_t *rgb;
    size_t count, slice;
    voxrti_cset *set;
    const uint32_t *map; /* replace: by rank */
    uint32_t *use;       /* count: by rank; one array per slice, or one for all */
    int apart;
    uint32_t spread[256];
} voxrti_pal_pass;

static void voxrti_pal_pass_open(voxrti_pal_pass *p, uint32_t *rgb, size_t count, voxrti_cset *set) {
    uint32_t i;
    memset(p, 0, sizeof *p);
    p->rgb = rgb;
    p->count = count;
    p->set = set;
    for (i = 0; i < 256; i++) p->spread[i] = (uint32_t)voxrti_spread3(i);
}

VOXRTI_INLINE uint32_t voxrti_pal_code(const uint32_t spread[256], uint32_t rgb) { /* green, red, blue from the top */
    return spread[rgb >> 8 & 255u] << 2 | spread[rgb & 255u] << 1 | spread[rgb >> 16 & 255u];
}

static void voxrti_pal_mark_task(void *ctx, uint32_t t) {
    voxrti_pal_pass *p = (voxrti_pal_pass *)ctx;
    size_t i = (size_t)t * VOXRTI_PAL_CHUNK, stop = i + VOXRTI_PAL_CHUNK;
    uint32_t seen[VOXRTI_PAL_CACHE];
    memset(seen, 255, sizeof seen);
    if (stop > p->count) stop = p->count;
    for (; i < stop; i++) {
        uint32_t c = p->rgb[i] & 0xffffffu, h = c * 0x9e3779b1u >> 22;
        if (seen[h] == c) continue;
        seen[h] = c;
        voxrti_cset_add(p->set, voxrti_pal_code(p->spread, c));
    }
}

static void voxrti_pal_replace_task(void *ctx, uint32_t t) {
    voxrti_pal_pass *p = (voxrti_pal_pass *)ctx;
    size_t i = (size_t)t * VOXRTI_PAL_CHUNK, stop = i + VOXRTI_PAL_CHUNK;
    uint32_t seen[VOXRTI_PAL_CACHE], value[VOXRTI_PAL_CACHE];
    memset(seen, 255, sizeof seen);
    memset(value, 0, sizeof value);
    if (stop > p->count) stop = p->count;
    for (; i < stop; i++) {
        uint32_t c = p->rgb[i] & 0xffffffu, h = c * 0x9e3779b1u >> 22;
        if (seen[h] != c) {
            seen[h] = c;
            value[h] = p->map[voxrti_cset_index(p->set, voxrti_pal_code(p->spread, c))];
        }
        p->rgb[i] = value[h];
    }
}

static void voxrti_pal_count_task(void *ctx, uint32_t t) {
    voxrti_pal_pass *p = (voxrti_pal_pass *)ctx;
    size_t i = t * p->slice, stop = i + p->slice;
    uint32_t seen[VOXRTI_PAL_CACHE], value[VOXRTI_PAL_CACHE];
    uint32_t *use = p->use + (p->apart ? (size_t)t * p->set->count : 0);
    memset(seen, 255, sizeof seen);
    memset(value, 0, sizeof value);
    if (stop > p->count) stop = p->count;
    while (i < stop) {
        uint32_t c = p->rgb[i] & 0xffffffu, h = c * 0x9e3779b1u >> 22;
        size_t first = i++;
        if (seen[h] != c) {
            seen[h] = c;
            value[h] = voxrti_cset_index(p->set, voxrti_pal_code(p->spread, c));
        }
        while (i < stop && (p->rgb[i] & 0xffffffu) == c) i++;
        if (p->apart) use[value[h]] += (uint32_t)(i - first);
        else (void)voxrti_atomic_add(&use[value[h]], (uint32_t)(i - first));
    }
}

/* out[rank] = uses of each colour of the set in rgb[0..count) */
static voxrt_result voxrti_pal_count(voxrti_mem *mem, const voxrt_env *env, uint32_t *rgb, size_t count,
                                     voxrti_cset *set, uint32_t **out) {
    voxrti_pal_pass p;
    uint32_t tasks, i, t;
    voxrti_pal_pass_open(&p, rgb, count, set);
    p.slice = count / VOXRTI_PAL_SLICES + 1;
    if (p.slice < 65536) p.slice = 65536;
    tasks = (uint32_t)((count + p.slice - 1) / p.slice);
    p.apart = set->count <= 65536u;
    p.use = (uint32_t *)voxrti_alloc_zero(mem, set->count, sizeof(uint32_t) * (p.apart && tasks > 1 ? tasks : 1));
    *out = p.use;
    if (p.use == NULL) return VOXRT_ERR_NO_MEMORY;
    voxrti_parallel_for(env, voxrti_pal_count_task, &p, tasks);
    for (t = 1; p.apart && t < tasks; t++)
        for (i = 0; i < set->count; i++) p.use[i] += p.use[(size_t)t * set->count + i];
    return VOXRT_OK;
}

/* ---- lanes: four floats or integers at once; SSE2, or plain C that gives the same bits ----

   A comparison gives all ones or 0 in each lane. */

#if VOXRTI_X64
typedef __m128 voxrti_f4;
typedef __m128i voxrti_i4;
VOXRTI_INLINE voxrti_f4 voxrti_f4_all(float x) { return _mm_set1_ps(x); }
VOXRTI_INLINE voxrti_f4 voxrti_f4_load(const float *p) { return _mm_loadu_ps(p); }
VOXRTI_INLINE void voxrti_f4_store(float *p, voxrti_f4 a) { _mm_storeu_ps(p, a); }
VOXRTI_INLINE voxrti_f4 voxrti_f4_add(voxrti_f4 a, voxrti_f4 b) { return _mm_add_ps(a, b); }
VOXRTI_INLINE voxrti_f4 voxrti_f4_sub(voxrti_f4 a, voxrti_f4 b) { return _mm_sub_ps(a, b); }
VOXRTI_INLINE voxrti_f4 voxrti_f4_mul(voxrti_f4 a, voxrti_f4 b) { return _mm_mul_ps(a, b); }
VOXRTI_INLINE voxrti_f4 voxrti_f4_div(voxrti_f4 a, voxrti_f4 b) { return _mm_div_ps(a, b); }
VOXRTI_INLINE voxrti_f4 voxrti_f4_min(voxrti_f4 a, voxrti_f4 b) { return _mm_min_ps(a, b); } /* a < b ? a : b */
VOXRTI_INLINE voxrti_f4 voxrti_f4_max(voxrti_f4 a, voxrti_f4 b) { return _mm_max_ps(a, b); } /* a > b ? a : b */
VOXRTI_INLINE voxrti_i4 voxrti_f4_less(voxrti_f4 a, voxrti_f4 b) { return _mm_castps_si128(_mm_cmplt_ps(a, b)); }
VOXRTI_INLINE voxrti_i4 voxrti_f4_equal(voxrti_f4 a, voxrti_f4 b) { return _mm_castps_si128(_mm_cmpeq_ps(a, b)); }
VOXRTI_INLINE voxrti_i4 voxrti_f4_int(voxrti_f4 a) { return _mm_cvttps_epi32(a); } /* towards 0 */
VOXRTI_INLINE voxrti_i4 voxrti_f4_bits(voxrti_f4 a) { return _mm_castps_si128(a); }
VOXRTI_INLINE voxrti_f4 voxrti_i4_bits(voxrti_i4 a) { return _mm_castsi128_ps(a); }
VOXRTI_INLINE voxrti_f4 voxrti_i4_float(voxrti_i4 a) { return _mm_cvtepi32_ps(a); }
VOXRTI_INLINE voxrti_i4 voxrti_i4_all(int32_t x) { return _mm_set1_epi32(x); }
VOXRTI_INLINE voxrti_i4 voxrti_i4_set(int32_t a, int32_t b, int32_t c, int32_t d) { return _mm_setr_epi32(a, b, c, d); }
VOXRTI_INLINE voxrti_i4 voxrti_i4_load(const int32_t *p) { return _mm_loadu_si128((const __m128i *)(const void *)p); }
VOXRTI_INLINE void voxrti_i4_store(int32_t *p, voxrti_i4 a) { _mm_storeu_si128((__m128i *)(void *)p, a); }
VOXRTI_INLINE voxrti_i4 voxrti_i4_add(voxrti_i4 a, voxrti_i4 b) { return _mm_add_epi32(a, b); }
VOXRTI_INLINE voxrti_i4 voxrti_i4_less(voxrti_i4 a, voxrti_i4 b) { return _mm_cmplt_epi32(a, b); }
VOXRTI_INLINE voxrti_i4 voxrti_i4_and(voxrti_i4 a, voxrti_i4 b) { return _mm_and_si128(a, b); }
VOXRTI_INLINE voxrti_i4 voxrti_i4_or(voxrti_i4 a, voxrti_i4 b) { return _mm_or_si128(a, b); }
VOXRTI_INLINE voxrti_i4 voxrti_i4_choose(voxrti_i4 m, voxrti_i4 a, voxrti_i4 b) { /* m ? a : b */
    return _mm_or_si128(_mm_and_si128(m, a), _mm_andnot_si128(m, b));
}
VOXRTI_INLINE uint32_t voxrti_i4_signs(voxrti_i4 a) { return (uint32_t)_mm_movemask_ps(_mm_castsi128_ps(a)); }
#else
typedef struct voxrti_f4 { float v[4]; } voxrti_f4;
typedef struct voxrti_i4 { int32_t v[4]; } voxrti_i4;
#define VOXRTI_LANES(type, expression) \
    type r; \
    int i; \
    for (i = 0; i < 4; i++) r.v[i] = expression; \
    return r
VOXRTI_INLINE voxrti_f4 voxrti_f4_all(float x) { VOXRTI_LANES(voxrti_f4, x); }
VOXRTI_INLINE voxrti_f4 voxrti_f4_load(const float *p) { VOXRTI_LANES(voxrti_f4, p[i]); }
VOXRTI_INLINE void voxrti_f4_store(float *p, voxrti_f4 a) { memcpy(p, a.v, sizeof a.v); }
VOXRTI_INLINE voxrti_f4 voxrti_f4_add(voxrti_f4 a, voxrti_f4 b) { VOXRTI_LANES(voxrti_f4, a.v[i] + b.v[i]); }
VOXRTI_INLINE voxrti_f4 voxrti_f4_sub(voxrti_f4 a, voxrti_f4 b) { VOXRTI_LANES(voxrti_f4, a.v[i] - b.v[i]); }
VOXRTI_INLINE voxrti_f4 voxrti_f4_mul(voxrti_f4 a, voxrti_f4 b) { VOXRTI_LANES(voxrti_f4, a.v[i] * b.v[i]); }
VOXRTI_INLINE voxrti_f4 voxrti_f4_div(voxrti_f4 a, voxrti_f4 b) { VOXRTI_LANES(voxrti_f4, a.v[i] / b.v[i]); }
VOXRTI_INLINE voxrti_f4 voxrti_f4_min(voxrti_f4 a, voxrti_f4 b) {
    VOXRTI_LANES(voxrti_f4, a.v[i] < b.v[i] ? a.v[i] : b.v[i]);
}
VOXRTI_INLINE voxrti_f4 voxrti_f4_max(voxrti_f4 a, voxrti_f4 b) {
    VOXRTI_LANES(voxrti_f4, a.v[i] > b.v[i] ? a.v[i] : b.v[i]);
}
VOXRTI_INLINE voxrti_i4 voxrti_f4_less(voxrti_f4 a, voxrti_f4 b) { VOXRTI_LANES(voxrti_i4, -(a.v[i] < b.v[i])); }
VOXRTI_INLINE voxrti_i4 voxrti_f4_equal(voxrti_f4 a, voxrti_f4 b) { VOXRTI_LANES(voxrti_i4, -(a.v[i] == b.v[i])); }
VOXRTI_INLINE voxrti_i4 voxrti_f4_int(voxrti_f4 a) { VOXRTI_LANES(voxrti_i4, (int32_t)a.v[i]); }
VOXRTI_INLINE voxrti_i4 voxrti_f4_bits(voxrti_f4 a) {
    voxrti_i4 r;
    memcpy(&r, &a, sizeof r);
    return r;
}
VOXRTI_INLINE voxrti_f4 voxrti_i4_bits(voxrti_i4 a) {
    voxrti_f4 r;
    memcpy(&r, &a, sizeof r);
    return r;
}
VOXRTI_INLINE voxrti_f4 voxrti_i4_float(voxrti_i4 a) { VOXRTI_LANES(voxrti_f4, (float)a.v[i]); }
VOXRTI_INLINE voxrti_i4 voxrti_i4_all(int32_t x) { VOXRTI_LANES(voxrti_i4, x); }
VOXRTI_INLINE voxrti_i4 voxrti_i4_set(int32_t a, int32_t b, int32_t c, int32_t d) {
    voxrti_i4 r;
    r.v[0] = a;
    r.v[1] = b;
    r.v[2] = c;
    r.v[3] = d;
    return r;
}
VOXRTI_INLINE voxrti_i4 voxrti_i4_load(const int32_t *p) { VOXRTI_LANES(voxrti_i4, p[i]); }
VOXRTI_INLINE void voxrti_i4_store(int32_t *p, voxrti_i4 a) { memcpy(p, a.v, sizeof a.v); }
VOXRTI_INLINE voxrti_i4 voxrti_i4_add(voxrti_i4 a, voxrti_i4 b) {
    VOXRTI_LANES(voxrti_i4, (int32_t)((uint32_t)a.v[i] + (uint32_t)b.v[i]));
}
VOXRTI_INLINE voxrti_i4 voxrti_i4_less(voxrti_i4 a, voxrti_i4 b) { VOXRTI_LANES(voxrti_i4, -(a.v[i] < b.v[i])); }
VOXRTI_INLINE voxrti_i4 voxrti_i4_and(voxrti_i4 a, voxrti_i4 b) { VOXRTI_LANES(voxrti_i4, a.v[i] & b.v[i]); }
VOXRTI_INLINE voxrti_i4 voxrti_i4_or(voxrti_i4 a, voxrti_i4 b) { VOXRTI_LANES(voxrti_i4, a.v[i] | b.v[i]); }
VOXRTI_INLINE voxrti_i4 voxrti_i4_choose(voxrti_i4 m, voxrti_i4 a, voxrti_i4 b) { /* m ? a : b */
    VOXRTI_LANES(voxrti_i4, (m.v[i] & a.v[i]) | (~m.v[i] & b.v[i]));
}
VOXRTI_INLINE uint32_t voxrti_i4_signs(voxrti_i4 a) {
    return (uint32_t)((a.v[0] < 0) | (a.v[1] < 0) << 1 | (a.v[2] < 0) << 2 | (a.v[3] < 0) << 3);
}
#undef VOXRTI_LANES
#endif
VOXRTI_INLINE voxrti_f4 voxrti_f4_choose(voxrti_i4 m, voxrti_f4 a, voxrti_f4 b) { /* m ? a : b */
    return voxrti_i4_bits(voxrti_i4_choose(m, voxrti_f4_bits(a), voxrti_f4_bits(b)));
}
VOXRTI_INLINE float voxrti_f4_least(voxrti_f4 a) {
    float f[4];
    voxrti_f4_store(f, a);
    f[0] = f[0] < f[1] ? f[0] : f[1];
    f[2] = f[2] < f[3] ? f[2] : f[3];
    return f[0] < f[2] ? f[0] : f[2];
}

/* ---- Oklab (Ottosson 2020) ---- */

typedef struct voxrti_oklab {
    double linear[256];   /* of an sRGB byte */
    float linear_f[256];
    double between[255];  /* linear light halfway (in sRGB) from byte i to i+1 */
} voxrti_oklab;

static VOXRTI_UNUSED void voxrti_oklab_init(voxrti_oklab *o) {
    int i;
    for (i = 0; i < 256; i++) {
        o->linear[i] = voxrti_srgb_to_linear((double)i / 255.0);
        o->linear_f[i] = (float)o->linear[i];
    }
    for (i = 0; i < 255; i++) o->between[i] = voxrti_srgb_to_linear(((double)i + 0.5) / 255.0);
}

/* x in [0, 2]; two Halley steps from a bit trick's 5 %: relative error < 1e-12 */
static double voxrti_cbrt(double x) {
    uint64_t bits;
    double t, t3;
    int i;
    if (!(x > 1e-30)) return 0.0;
    memcpy(&bits, &x, sizeof bits);
    bits = bits / 3 + 0x2a9f7893782da1ceu;
    memcpy(&t, &bits, sizeof t);
    for (i = 0; i < 2; i++) {
        t3 = t * t * t;
        t = t * (t3 + 2.0 * x) / (2.0 * t3 + x);
    }
    return t;
}

static void voxrti_oklab_from(const voxrti_oklab *o, uint32_t rgb, double c[3]) {
    double r = o->linear[rgb & 255u], g = o->linear[rgb >> 8 & 255u], b = o->linear[rgb >> 16 & 255u];
    double l = voxrti_cbrt(0.4122214708 * r + 0.5363325363 * g + 0.0514459929 * b);
    double m = voxrti_cbrt(0.2119034982 * r + 0.6806995451 * g + 0.1073969566 * b);
    double s = voxrti_cbrt(0.0883024619 * r + 0.2817188376 * g + 0.6299787005 * b);
    c[0] = 0.2104542553 * l + 0.7936177850 * m - 0.0040720468 * s;
    c[1] = 1.9779984951 * l - 2.4285922050 * m + 0.4505937099 * s;
    c[2] = 0.0259040371 * l + 0.7827717662 * m - 0.8086757660 * s;
}

static uint32_t voxrti_oklab_byte(const voxrti_oklab *o, double x) {
    uint32_t lo = 0, hi = 255;
    while (lo < hi) {
        uint32_t mid = (lo + hi) / 2;
        if (x < o->between[mid]) hi = mid;
        else lo = mid + 1;
    }
    return lo;
}

static uint32_t voxrti_oklab_to(const voxrti_oklab *o, const double c[3]) {
    double l = c[0] + 0.3963377774 * c[1] + 0.2158037573 * c[2];
    double m = c[0] - 0.1055613458 * c[1] - 0.0638541728 * c[2];
    double s = c[0] - 0.0894841775 * c[1] - 1.2914855480 * c[2];
    l = l * l * l;
    m = m * m * m;
    s = s * s * s;
    return voxrti_oklab_byte(o, 4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s) |
           voxrti_oklab_byte(o, -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s) << 8 |
           voxrti_oklab_byte(o, -0.0041960863 * l - 0.7034186147 * m + 1.7076147010 * s) << 16;
}

/* The same for n <= 64 colours in single precision, error < 8e-7. */
static void voxrti_oklab_many(const voxrti_oklab *o, const uint32_t *rgb, uint32_t n, float c[3][64]) {
    static const float to_lms[9] = {0.4122214708f, 0.5363325363f, 0.0514459929f, 0.2119034982f, 0.6806995451f,
                                    0.1073969566f, 0.0883024619f, 0.2817188376f, 0.6299787005f};
    static const float to_lab[9] = {0.2104542553f, 0.7936177850f, -0.0040720468f, 1.9779984951f, -2.4285922050f,
                                    0.4505937099f, 0.0259040371f, 0.7827717662f, -0.8086757660f};
    uint32_t i, k;
    for (i = 0; i < n; i++) {
        c[0][i] = o->linear_f[rgb[i] & 255u];
        c[1][i] = o->linear_f[rgb[i] >> 8 & 255u];
        c[2][i] = o->linear_f[rgb[i] >> 16 & 255u];
    }
    for (; (i & 3u) != 0; i++) c[0][i] = c[1][i] = c[2][i] = 0.0f;
    for (i = 0; i < n; i += 4) {
        voxrti_f4 r = voxrti_f4_load(c[0] + i), g = voxrti_f4_load(c[1] + i), b = voxrti_f4_load(c[2] + i), lms[3];
        for (k = 0; k < 3; k++) { /* cube roots as in voxrti_cbrt; black stays just above 0 */
            voxrti_f4 x, t, t3;
            int round;
            x = voxrti_f4_add(voxrti_f4_mul(r, voxrti_f4_all(to_lms[3 * k])),
                              voxrti_f4_mul(g, voxrti_f4_all(to_lms[3 * k + 1])));
            x = voxrti_f4_add(x, voxrti_f4_mul(b, voxrti_f4_all(to_lms[3 * k + 2])));
            x = voxrti_f4_max(x, voxrti_f4_all(1e-21f));
            t = voxrti_f4_mul(voxrti_i4_float(voxrti_f4_bits(x)), voxrti_f4_all(0.33333333f));
            t = voxrti_i4_bits(voxrti_i4_add(voxrti_f4_int(t), voxrti_i4_all(0x2a514067)));
            for (round = 0; round < 2; round++) {
                t3 = voxrti_f4_mul(voxrti_f4_mul(t, t), t);
                t = voxrti_f4_div(voxrti_f4_mul(t, voxrti_f4_add(voxrti_f4_add(t3, x), x)),
                                  voxrti_f4_add(voxrti_f4_add(t3, t3), x));
            }
            lms[k] = t;
        }
        for (k = 0; k < 3; k++) {
            voxrti_f4 x = voxrti_f4_add(voxrti_f4_mul(lms[0], voxrti_f4_all(to_lab[3 * k])),
                                        voxrti_f4_mul(lms[1], voxrti_f4_all(to_lab[3 * k + 1])));
            voxrti_f4_store(c[k] + i, voxrti_f4_add(x, voxrti_f4_mul(lms[2], voxrti_f4_all(to_lab[3 * k + 2]))));
        }
    }
}

/* ---- nearest neighbours ---- */

typedef struct voxrti_pcell { /* a cluster of colours */
    double c[3];  /* usage-weighted mean: Oklab, or sRGB bytes (thesis) */
    double v;     /* uses */
    double g;     /* drift: merges it stems from (thesis) */
} voxrti_pcell;

enum { VOXRTI_FIND_NEAREST, VOXRTI_FIND_WARD, VOXRTI_FIND_THESIS };

/* A uniform grid of points in single precision, some cells for each point, with an empty cell around. The points of a
   row of cells stand one after the other: a scan may read up to three points too many, which are candidates as well. */
typedef struct voxrti_pgrid {
    float lo[3], edge, inv;
    int32_t dim[3];     /* cells along an axis, the empty ones too */
    uint32_t n;
    uint32_t *start;    /* [cells + 1] */
    float *c[3], *v;    /* [n + 4] by grid cell, in a cell by id; v: 1 / uses (Ward), drift (thesis) */
    int32_t *id;        /* [n + 4] */
} voxrti_pgrid;

static void voxrti_pgrid_free(voxrti_mem *mem, voxrti_pgrid *g) {
    voxrti_free(mem, g->start);
    voxrti_free(mem, g->c[0]);
    voxrti_free(mem, g->id);
    g->start = NULL;
    g->c[0] = NULL;
    g->id = NULL;
}

VOXRTI_INLINE int32_t voxrti_pgrid_axis(const voxrti_pgrid *g, float c, int k) {
    float t = (c - g->lo[k]) * g->inv;
    int32_t i = t > 0.0f ? t < 1e9f ? (int32_t)t : 1000000000 : 0;
    return (i < g->dim[k] - 2 ? i : g->dim[k] - 3) + 1;
}

VOXRTI_INLINE size_t voxrti_pgrid_row(const voxrti_pgrid *g, int32_t z, int32_t y) {
    return ((size_t)z * (size_t)g->dim[1] + (size_t)y) * (size_t)g->dim[0];
}

/* n >= 1; 0: out of memory */
static int voxrti_pgrid_build(voxrti_mem *mem, voxrti_pgrid *g, const voxrti_pcell *p, uint32_t n, int find) {
    double lo[3], hi[3], size = 0.0, edge, want = 2.0 * (double)n + 64.0;
    size_t cells, i;
    int k;
    memset(g, 0, sizeof *g);
    for (k = 0; k < 3; k++) {
        lo[k] = hi[k] = p[0].c[k];
        for (i = 1; i < n; i++) {
            lo[k] = voxrti_min(lo[k], p[i].c[k]);
            hi[k] = voxrti_max(hi[k], p[i].c[k]);
        }
        size = voxrti_max(size, hi[k] - lo[k]);
    }
    if (!(size > 0.0)) size = 1.0;
    edge = size;
    for (;;) {
        double e = edge * 0.875, prod = 1.0;
        for (k = 0; k < 3; k++) prod *= (double)voxrti_floor((hi[k] - lo[k]) / e) + 1.0;
        if (prod > want || e < size * 1e-4) break;
        edge = e;
    }
    g->n = n;
    g->edge = (float)edge;
    g->inv = 1.0f / g->edge;
    cells = 1;
    for (k = 0; k < 3; k++) {
        g->lo[k] = (float)lo[k];
        g->dim[k] = (int32_t)voxrti_floor((hi[k] - lo[k]) / edge) + 3;
        cells *= (size_t)g->dim[k];
    }
    g->start = (uint32_t *)voxrti_alloc_zero(mem, cells + 2, sizeof(uint32_t));
    g->c[0] = (float *)voxrti_alloc_array(mem, (size_t)n + 4, 4 * sizeof(float));
    g->id = (int32_t *)voxrti_alloc_array(mem, (size_t)n + 4, sizeof(int32_t));
    if (g->start == NULL || g->c[0] == NULL || g->id == NULL) {
        voxrti_pgrid_free(mem, g);
        return 0;
    }
    g->c[1] = g->c[0] + n + 4;
    g->c[2] = g->c[1] + n + 4;
    g->v = g->c[2] + n + 4;
    for (i = 0; i < n; i++) {
        uint32_t cell = (uint32_t)(voxrti_pgrid_row(g, voxrti_pgrid_axis(g, (float)p[i].c[2], 2),
                                                    voxrti_pgrid_axis(g, (float)p[i].c[1], 1)) +
                                   (size_t)voxrti_pgrid_axis(g, (float)p[i].c[0], 0));
        g->start[cell + 2]++;
    }
    for (i = 2; i < cells + 2; i++) g->start[i] += g->start[i - 1];
    for (i = 0; i < n + 4; i++) { /* four points that are too far for all start values end the list */
        uint32_t at = (uint32_t)i;
        float c[3];
        for (k = 0; k < 3; k++) c[k] = i < n ? (float)p[i].c[k] : 1e15f;
        if (i < n) at = g->start[voxrti_pgrid_row(g, voxrti_pgrid_axis(g, c[2], 2), voxrti_pgrid_axis(g, c[1], 1)) +
                                 (size_t)voxrti_pgrid_axis(g, c[0], 0) + 1]++;
        for (k = 0; k < 3; k++) g->c[k][at] = c[k];
        g->v[at] = i >= n ? 1e15f : find == VOXRTI_FIND_WARD ? (float)(1.0 / p[i].v) : (float)p[i].g;
        g->id[at] = i < n ? (int32_t)i : 0x7fffffff;
    }
    return 1;
}

typedef struct voxrti_pquery {
    voxrti_f4 c[3], v, best;
    voxrti_i4 id, found;
} voxrti_pquery;

VOXRTI_INLINE void voxrti_pgrid_scan(const voxrti_pgrid *g, size_t first, size_t last, voxrti_pquery *q, int find) {
    uint32_t i = g->start[first], stop = g->start[last + 1];
    for (; i < stop; i += 4) {
        voxrti_f4 x = voxrti_f4_sub(voxrti_f4_load(g->c[0] + i), q->c[0]);
        voxrti_f4 y = voxrti_f4_sub(voxrti_f4_load(g->c[1] + i), q->c[1]);
        voxrti_f4 z = voxrti_f4_sub(voxrti_f4_load(g->c[2] + i), q->c[2]), v, cost;
        voxrti_i4 id = voxrti_i4_load(g->id + i), better;
        cost = voxrti_f4_add(voxrti_f4_add(voxrti_f4_mul(x, x), voxrti_f4_mul(y, y)), voxrti_f4_mul(z, z));
        if (find != VOXRTI_FIND_NEAREST) v = voxrti_f4_load(g->v + i);
        if (find == VOXRTI_FIND_WARD) cost = voxrti_f4_div(cost, voxrti_f4_add(q->v, v));
        if (find == VOXRTI_FIND_THESIS)
            cost = voxrti_f4_mul(cost, voxrti_f4_add(voxrti_f4_add(voxrti_f4_all(1.0f), q->v), v));
        better = voxrti_i4_and(voxrti_f4_equal(cost, q->best), voxrti_i4_less(id, q->found));
        better = voxrti_i4_or(better, voxrti_f4_less(cost, q->best));
        if (find == VOXRTI_FIND_WARD) /* heavier ones only, of equal weight the later ones */
            better = voxrti_i4_and(better, voxrti_i4_or(voxrti_f4_less(v, q->v),
                voxrti_i4_and(voxrti_f4_equal(v, q->v), voxrti_i4_less(q->id, id))));
        if (find == VOXRTI_FIND_THESIS)
            better = voxrti_i4_and(better, voxrti_i4_or(voxrti_i4_less(q->id, id), voxrti_i4_less(id, q->id)));
        q->best = voxrti_f4_choose(better, cost, q->best);
        q->found = voxrti_i4_choose(better, id, q->found);
    }
}

/* Point `c`, `v`, `id`: search outwards, ring of grid cells by ring, for the nearest point or the cheapest partner to
   merge with. Ward's cost d2 / (1/v1 + 1/v2) is bounded only towards heavier points (of equal weight: later ones):
   cost >= d2 * v1/2; so the lighter point of a pair finds it. Ties go to the lower id. Nothing below *cost found: id
   0x7fffffff. */
VOXRTI_INLINE int32_t voxrti_pgrid_search(const voxrti_pgrid *g, const float c[3], float v, int32_t id, int find,
                                          float *cost) {
    int32_t at[3], lo[3], hi[3], r, rings = 0, x, y, z, k, found[4], any;
    float border = 1e15f, best = *cost, scale, reach, each[4];
    voxrti_pquery q;
    scale = find == VOXRTI_FIND_WARD ? 0.5f / v : find == VOXRTI_FIND_THESIS ? 1.0f + v : 1.0f;
    scale *= 0.99999f; /* rounding must not hide an equal cost */
    for (k = 0; k < 3; k++) {
        float below;
        at[k] = voxrti_pgrid_axis(g, c[k], k);
        below = c[k] - (g->lo[k] + (float)(at[k] - 1) * g->edge);
        if (at[k] > 1 && below < border) border = below;
        if (at[k] + 2 < g->dim[k] && g->edge - below < border) border = g->edge - below;
        rings = at[k] - 1 > rings ? at[k] - 1 : rings;
        rings = g->dim[k] - 2 - at[k] > rings ? g->dim[k] - 2 - at[k] : rings;
        q.c[k] = voxrti_f4_all(c[k]);
    }
    q.v = voxrti_f4_all(v);
    q.id = voxrti_i4_all(id);
    q.best = voxrti_f4_all(best);
    q.found = voxrti_i4_all(0x7fffffff);
    /* the row of three cells around the point, then what of the 3x3x3 can be better */
    voxrti_pgrid_scan(g, voxrti_pgrid_row(g, at[2], at[1]) + (size_t)at[0] - 1,
                      voxrti_pgrid_row(g, at[2], at[1]) + (size_t)at[0] + 1, &q, find);
    best = voxrti_f4_least(q.best);
    reach = sqrtf(best / scale);
    for (k = 0; k < 3; k++) {
        float below = c[k] - (g->lo[k] + (float)(at[k] - 1) * g->edge);
        lo[k] = at[k] - (below < reach);
        hi[k] = at[k] + (g->edge - below < reach);
    }
    for (z = lo[2]; z <= hi[2]; z++) {
        for (y = lo[1]; y <= hi[1]; y++) {
            size_t row = voxrti_pgrid_row(g, z, y);
            if (z == at[2] && y == at[1]) continue;
            voxrti_pgrid_scan(g, row + (size_t)lo[0], row + (size_t)hi[0], &q, find);
        }
    }
    best = voxrti_f4_least(q.best);
    for (r = 2; r <= rings; r++) {
        int32_t z0 = at[2] - r > 1 ? at[2] - r : 1, z1 = at[2] + r < g->dim[2] - 2 ? at[2] + r : g->dim[2] - 2;
        int32_t y0 = at[1] - r > 1 ? at[1] - r : 1, y1 = at[1] + r < g->dim[1] - 2 ? at[1] + r : g->dim[1] - 2;
        int32_t x0 = at[0] - r > 1 ? at[0] - r : 1, x1 = at[0] + r < g->dim[0] - 2 ? at[0] + r : g->dim[0] - 2;
        reach = (float)(r - 1) * g->edge + border;
        if (reach > 0.0f && reach * reach * scale > best) break;
        for (z = z0; z <= z1; z++) {
            for (y = y0; y <= y1; y++) {
                size_t row = voxrti_pgrid_row(g, z, y);
                if (z == at[2] - r || z == at[2] + r || y == at[1] - r || y == at[1] + r)
                    voxrti_pgrid_scan(g, row + (size_t)x0, row + (size_t)x1, &q, find);
                else
                    for (x = at[0] - r; x <= at[0] + r; x += 2 * r)
                        if (x > 0 && x < g->dim[0] - 1)
                            voxrti_pgrid_scan(g, row + (size_t)x, row + (size_t)x, &q, find);
            }
        }
        best = voxrti_f4_least(q.best);
    }
    voxrti_f4_store(each, q.best);
    voxrti_i4_store(found, q.found);
    any = 0x7fffffff;
    for (k = 0; k < 4; k++)
        if (!(each[k] > best) && found[k] < any) any = found[k];
    *cost = best;
    return any;
}

VOXRTI_INLINE double voxrti_pcell_d2(const double a[3], const double b[3]) {
    double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
    return x * x + y * y + z * z;
}

VOXRTI_INLINE double voxrti_pcell_cost(const voxrti_pcell *a, const voxrti_pcell *b, int thesis) {
    double d2 = voxrti_pcell_d2(a->c, b->c);
    return thesis ? d2 * (1.0 + a->g + b->g) : d2 * (a->v * b->v / (a->v + b->v));
}

static void voxrti_pcell_merge(voxrti_pcell *a, const voxrti_pcell *b) { /* a takes in b (eq. 3) */
    double v = a->v + b->v;
    int k;
    for (k = 0; k < 3; k++) a->c[k] = (a->c[k] * a->v + b->c[k] * b->v) / v;
    a->v = v;
    a->g = a->g + b->g + 1.0;
}

#define VOXRTI_PAL_GROUP 64u
#define VOXRTI_PAL_CLOSE 512u
#define VOXRTI_PAL_TIES 16u

/* The nearest points of a grid to each of some points that lie close together. Candidates for all of them are those as
   near to the box around them as the one nearest to its centre is to its farthest corner. */
typedef struct voxrti_pgroup {
    float c[3][VOXRTI_PAL_GROUP]; /* the points */
    uint32_t first, n;            /* those in work */
    float close_c[3][VOXRTI_PAL_CLOSE + 4], d2[VOXRTI_PAL_CLOSE + 4];
    int32_t close_id[VOXRTI_PAL_CLOSE + 4];
    uint32_t close;
    int32_t tie[VOXRTI_PAL_TIES]; /* ids that are equally near, but for rounding */
} voxrti_pgroup;

/* Candidates for the points from p->first on, at most up to `stop`. */
static void voxrti_pgroup_open(const voxrti_pgrid *g, voxrti_pgroup *p, uint32_t stop, float slack) {
    float lo[3], hi[3], centre[3], reach, d2 = 1e28f, limit = 0.8f * g->edge;
    int32_t from[3], to[3], y, z, k;
    uint32_t i, n = 0;
    for (k = 0; k < 3; k++) lo[k] = hi[k] = p->c[k][p->first];
    for (i = p->first + 1; i < stop; i++) { /* while the box is not too wide */
        float l[3], h[3], wide = 0.0f;
        for (k = 0; k < 3; k++) {
            l[k] = p->c[k][i] < lo[k] ? p->c[k][i] : lo[k];
            h[k] = p->c[k][i] > hi[k] ? p->c[k][i] : hi[k];
            wide = h[k] - l[k] > wide ? h[k] - l[k] : wide;
        }
        if (wide > limit) break;
        memcpy(lo, l, sizeof lo);
        memcpy(hi, h, sizeof hi);
    }
    p->n = i - p->first;
    reach = 0.0f;
    for (k = 0; k < 3; k++) {
        centre[k] = 0.5f * (lo[k] + hi[k]);
        reach += (hi[k] - lo[k]) * (hi[k] - lo[k]);
    }
    (void)voxrti_pgrid_search(g, centre, 0.0f, -1, VOXRTI_FIND_NEAREST, &d2);
    reach = (0.5f * sqrtf(reach) + sqrtf(d2)) * 1.0001f + 4.0f * slack;
    for (k = 0; k < 3; k++) {
        from[k] = voxrti_pgrid_axis(g, lo[k] - reach, k);
        to[k] = voxrti_pgrid_axis(g, hi[k] + reach, k);
    }
    reach *= reach;
    for (z = from[2]; z <= to[2]; z++) {
        for (y = from[1]; y <= to[1]; y++) {
            size_t row = voxrti_pgrid_row(g, z, y);
            uint32_t end = g->start[row + (size_t)to[0] + 1];
            for (i = g->start[row + (size_t)from[0]]; i < end; i += 4) {
                voxrti_f4 sum = voxrti_f4_all(0.0f);
                uint32_t m, j;
                for (k = 0; k < 3; k++) {
                    voxrti_f4 c = voxrti_f4_load(g->c[k] + i), d;
                    d = voxrti_f4_max(voxrti_f4_sub(voxrti_f4_all(lo[k]), c), voxrti_f4_sub(c, voxrti_f4_all(hi[k])));
                    d = voxrti_f4_max(d, voxrti_f4_all(0.0f));
                    sum = voxrti_f4_add(sum, voxrti_f4_mul(d, d));
                }
                m = 15u & ~voxrti_i4_signs(voxrti_f4_less(voxrti_f4_all(reach), sum));
                if (end - i < 4) m &= (1u << (end - i)) - 1u;
                if (n > VOXRTI_PAL_CLOSE - 4) continue; /* so many entries all about as near: the first ones will do */
                for (j = 0; j < 4; j++) {
                    p->close_id[n] = (int32_t)(i + j);
                    n += m >> j & 1u;
                }
            }
        }
    }
    p->close = n;
    for (i = 0; i < n; i++) {
        uint32_t from_grid = (uint32_t)p->close_id[i];
        for (k = 0; k < 3; k++) p->close_c[k][i] = g->c[k][from_grid];
        p->close_id[i] = g->id[from_grid];
    }
    for (i = p->close; i < p->close + 4; i++)
        for (k = 0; k < 3; k++) p->close_c[k][i] = 1e15f;
}

/* Nearest candidates of point i: those whose distance is within 2 `slack` of the least are put into p->tie. Returns
   their number. slack = 0: 1, of equal ones that with the lowest id. */
static uint32_t voxrti_pgroup_nearest(voxrti_pgroup *p, uint32_t i, float slack) {
    voxrti_f4 x = voxrti_f4_all(p->c[0][i]), y = voxrti_f4_all(p->c[1][i]), z = voxrti_f4_all(p->c[2][i]), limit;
    voxrti_f4 best = voxrti_f4_all(1e28f);
    uint32_t k, n = 0;
    float least;
    for (k = 0; k < p->close; k += 4) {
        voxrti_f4 a = voxrti_f4_sub(voxrti_f4_load(p->close_c[0] + k), x), d2;
        voxrti_f4 b = voxrti_f4_sub(voxrti_f4_load(p->close_c[1] + k), y);
        voxrti_f4 c = voxrti_f4_sub(voxrti_f4_load(p->close_c[2] + k), z);
        d2 = voxrti_f4_add(voxrti_f4_add(voxrti_f4_mul(a, a), voxrti_f4_mul(b, b)), voxrti_f4_mul(c, c));
        voxrti_f4_store(p->d2 + k, d2);
        best = voxrti_f4_min(d2, best);
    }
    least = voxrti_f4_least(best);
    if (slack > 0.0f) least += 4.0f * slack * (sqrtf(least) + slack);
    limit = voxrti_f4_all(least);
    for (k = 0; k < p->close; k += 4) {
        uint32_t m = 15u & ~voxrti_i4_signs(voxrti_f4_less(limit, voxrti_f4_load(p->d2 + k)));
        for (; m != 0; m &= m - 1) {
            int32_t id = p->close_id[k + voxrti_ctz64(m)];
            if (n == 0 || slack > 0.0f) {
                if (n < VOXRTI_PAL_TIES) p->tie[n++] = id;
            } else if (id < p->tie[0]) {
                p->tie[0] = id;
            }
        }
    }
    return n;
}

/* ---- merging ---- */

/* Everything a reduction works on. */
typedef struct voxrti_preduce {
    const voxrt_env *env;
    voxrti_pcell *cell;   /* [n] clusters now */
    uint32_t *label;      /* [points] cluster of each input point */
    uint32_t n, points;
    voxrti_pcell *point;  /* [points] input, for k-means; may be NULL */
    uint32_t *partner;    /* [n] cheapest partner, or VOXRT_NO_NODE */
    double *key;          /* [n] and its cost */
    uint32_t *link;       /* [n] cluster it went into */
    uint64_t *order;      /* [2n] */
    voxrti_pgrid grid;
    float bound;          /* partners that cost more are of no use */
    int thesis;
} voxrti_preduce;

/* Cheapest partner of slot i among the slots after it. Merged slots stand at 1e30, too far for the start value. */
static void voxrti_pal_row(voxrti_preduce *w, uint32_t i) {
    double best = 1e50;
    uint32_t j, found = VOXRT_NO_NODE;
    const voxrti_pcell a = w->cell[i];
    if (w->thesis) {
        for (j = i + 1; j < w->n; j++) {
            double cost = voxrti_pcell_cost(&a, &w->cell[j], 1);
            if (cost < best) {
                best = cost;
                found = j;
            }
        }
    } else {
        for (j = i + 1; j < w->n; j++) {
            double cost = voxrti_pcell_cost(&a, &w->cell[j], 0);
            if (cost < best) {
                best = cost;
                found = j;
            }
        }
    }
    w->key[i] = best;
    w->partner[i] = found;
}

static void voxrti_pal_row_task(void *ctx, uint32_t t) {
    voxrti_preduce *w = (voxrti_preduce *)ctx;
    uint32_t i = t * 64, stop = i + 64;
    for (; i < stop && i < w->n; i++) voxrti_pal_row(w, i);
}

/* Squeeze the merged slots out (link[i] != i), keeping the order; label, partner follow. */
static void voxrti_pal_squeeze(voxrti_preduce *w) {
    uint32_t i, m = 0;
    for (i = 0; i < w->n; i++) { /* links point to lower slots, so these are final already */
        if (w->link[i] == i) {
            w->cell[m] = w->cell[i];
            w->key[m] = w->key[i];
            w->partner[m] = w->partner[i];
            w->link[i] = m++;
        } else w->link[i] = w->link[w->link[i]];
    }
    for (i = 0; i < m; i++)
        if (w->partner[i] != VOXRT_NO_NODE) w->partner[i] = w->link[w->partner[i]];
    for (i = 0; i < w->points; i++) w->label[i] = w->link[w->label[i]];
    for (i = 0; i < m; i++) w->link[i] = i;
    w->n = m;
}

/* Greedy merging, exact: always the cheapest pair (i, j), i < j; ties by lower i, then lower j. The merged cluster
   takes the place of i. O(n) for each merge and each row whose partner is gone. */
static void voxrti_pal_merge_exact(voxrti_preduce *w, uint32_t target) {
    uint32_t alive = w->n, i, j, x;
    for (i = 0; i < w->n; i++) w->link[i] = i;
    voxrti_parallel_for(w->env, voxrti_pal_row_task, w, (w->n + 63) / 64);
    while (alive > target) {
        voxrti_pcell merged;
        double best = w->key[0];
        i = 0;
        for (x = 1; x < w->n; x++) {
            if (w->key[x] < best) {
                best = w->key[x];
                i = x;
            }
        }
        j = w->partner[i];
        voxrti_pcell_merge(&w->cell[i], &w->cell[j]);
        w->link[j] = i;
        w->cell[j].c[0] = 1e30;
        w->key[j] = 1e50;
        alive--;
        merged = w->cell[i];
        for (x = 0; x < i; x++) {
            if (w->link[x] != x) continue;
            if (w->partner[x] == i || w->partner[x] == j) voxrti_pal_row(w, x);
            else {
                double cost = voxrti_pcell_cost(&w->cell[x], &merged, w->thesis);
                if (cost < w->key[x] || (cost == w->key[x] && i < w->partner[x])) {
                    w->key[x] = cost;
                    w->partner[x] = i;
                }
            }
        }
        voxrti_pal_row(w, i);
        for (x = i + 1; x < j; x++)
            if (w->partner[x] == j && w->link[x] == x) voxrti_pal_row(w, x);
        if (alive < w->n - w->n / 4) voxrti_pal_squeeze(w);
    }
    voxrti_pal_squeeze(w);
}

static void voxrti_pal_partner_task(void *ctx, uint32_t t) {
    voxrti_preduce *w = (voxrti_preduce *)ctx;
    const voxrti_pgrid *g = &w->grid;
    uint32_t i = t * 512, stop = i + 512;
    for (; i < stop && i < w->n; i++) {
        float c[3], cost = w->bound;
        int32_t id = g->id[i], found;
        c[0] = g->c[0][i];
        c[1] = g->c[1][i];
        c[2] = g->c[2][i];
        found = w->thesis ? voxrti_pgrid_search(g, c, g->v[i], id, VOXRTI_FIND_THESIS, &cost) :
                            voxrti_pgrid_search(g, c, g->v[i], id, VOXRTI_FIND_WARD, &cost);
        w->partner[id] = found == 0x7fffffff ? VOXRT_NO_NODE : (uint32_t)found;
        w->key[id] = (double)cost;
    }
}

/* Stable sort by the upper 32 bits. Result in a; b is scratch of the same size. */
static void voxrti_pal_sort(uint64_t *a, uint64_t *b, size_t n) {
    uint32_t start[256], shift, k, sum, c;
    size_t i;
    int pass;
    for (pass = 0; pass < 4; pass++) { /* an even number of passes ends in a */
        uint64_t *t = a;
        shift = 32u + 8u * (uint32_t)pass;
        memset(start, 0, sizeof start);
        for (i = 0; i < n; i++) start[a[i] >> shift & 255u]++;
        for (k = 0, sum = 0; k < 256; k++) {
            c = start[k];
            start[k] = sum;
            sum += c;
        }
        for (i = 0; i < n; i++) b[start[a[i] >> shift & 255u]++] = a[i];
        a = b;
        b = t;
    }
}

/* Merging in rounds for many clusters: all find their cheapest partner, the cheapest quarter merges. */
static voxrt_result voxrti_pal_merge_rounds(voxrti_mem *mem, voxrti_preduce *w, uint32_t target) {
    w->bound = 1e28f;
    while (w->n > target) {
        uint32_t want = w->n / 4 + 1, done = 0, i, n = 0, bucket, below = 0, count[2048];
        if (want > w->n - target) want = w->n - target;
        if (!voxrti_pgrid_build(mem, &w->grid, w->cell, w->n, w->thesis ? VOXRTI_FIND_THESIS : VOXRTI_FIND_WARD))
            return VOXRT_ERR_NO_MEMORY;
        voxrti_parallel_for(w->env, voxrti_pal_partner_task, w, (w->n + 511) / 512);
        voxrti_pgrid_free(mem, &w->grid);
        memset(count, 0, sizeof count); /* by exponent and three more bits of the cost */
        for (i = 0; i < w->n; i++) {
            float f = (float)w->key[i];
            uint32_t bits;
            memcpy(&bits, &f, sizeof bits);
            w->link[i] = i;
            if (w->partner[i] == VOXRT_NO_NODE) continue;
            w->order[w->n + n++] = (uint64_t)bits << 32 | i;
            count[bits >> 20]++;
        }
        for (bucket = 0; bucket < 2047 && below < 2 * want; bucket++) below += count[bucket]; /* enough to choose */
        for (i = 0, below = n, n = 0; i < below; i++)
            if (w->order[w->n + i] >> 52 < bucket) w->order[n++] = w->order[w->n + i];
        w->bound = 1e28f;
        if (n >= 2 * want && bucket < 1900) { /* costs grow by about a half from round to round */
            bucket <<= 20;
            memcpy(&w->bound, &bucket, sizeof w->bound);
            w->bound *= 2.0f;
        }
        voxrti_pal_sort(w->order, w->order + w->n, n);
        for (i = 0; i < n && done < want; i++) {
            uint32_t a = (uint32_t)w->order[i], b = w->partner[a], t;
            if (b < a) {
                t = a;
                a = b;
                b = t;
            }
            if (w->key[a] < 0.0 || w->key[b] < 0.0) continue; /* merged in this round */
            voxrti_pcell_merge(&w->cell[a], &w->cell[b]);
            w->link[b] = a;
            w->key[a] = w->key[b] = -1.0;
            done++;
        }
        for (i = 0; i < w->n; i++) w->partner[i] = VOXRT_NO_NODE;
        voxrti_pal_squeeze(w);
    }
    return VOXRT_OK;
}

static void voxrti_pal_assign_task(void *ctx, uint32_t t) {
    voxrti_preduce *w = (voxrti_preduce *)ctx;
    uint32_t at = t * 1024, stop = at + 1024, n, i;
    voxrti_pgroup p;
    if (stop > w->points) stop = w->points;
    for (; at < stop; at += n) {
        n = stop - at < VOXRTI_PAL_GROUP ? stop - at : VOXRTI_PAL_GROUP;
        for (i = 0; i < n; i++) {
            p.c[0][i] = (float)w->point[at + i].c[0];
            p.c[1][i] = (float)w->point[at + i].c[1];
            p.c[2][i] = (float)w->point[at + i].c[2];
        }
        for (p.first = 0; p.first < n; p.first += p.n) {
            voxrti_pgroup_open(&w->grid, &p, n, 0.0f);
            for (i = p.first; i < p.first + p.n; i++) {
                (void)voxrti_pgroup_nearest(&p, i, 0.0f);
                w->label[at + i] = (uint32_t)p.tie[0];
            }
        }
    }
}

/* k-means from the merged clusters; a cluster that loses all its points stays where it is */
static voxrt_result voxrti_pal_kmeans(voxrti_mem *mem, voxrti_preduce *w, uint32_t rounds) {
    voxrti_pcell *sum = (voxrti_pcell *)voxrti_alloc_array(mem, w->n, sizeof(voxrti_pcell));
    uint32_t i, round;
    int k;
    if (sum == NULL) return VOXRT_ERR_NO_MEMORY;
    for (round = 0; round < rounds; round++) {
        if (!voxrti_pgrid_build(mem, &w->grid, w->cell, w->n, VOXRTI_FIND_NEAREST)) {
            voxrti_free(mem, sum);
            return VOXRT_ERR_NO_MEMORY;
        }
        voxrti_parallel_for(w->env, voxrti_pal_assign_task, w, (w->points + 1023) / 1024);
        voxrti_pgrid_free(mem, &w->grid);
        memset(sum, 0, w->n * sizeof *sum);
        for (i = 0; i < w->points; i++) { /* one thread: floating-point sums have one order */
            const voxrti_pcell *p = &w->point[i];
            voxrti_pcell *s = &sum[w->label[i]];
            for (k = 0; k < 3; k++) s->c[k] += p->c[k] * p->v;
            s->v += p->v;
        }
        for (i = 0; i < w->n; i++)
            for (k = 0; k < 3; k++)
                if (sum[i].v > 0.0) w->cell[i].c[k] = sum[i].c[k] / sum[i].v;
    }
    voxrti_free(mem, sum);
    return VOXRT_OK;
}

/* ---- building a palette ---- */

#define VOXRTI_PAL_POINTS 262144u       /* more colours than this share cells of the colour cube first */
#define VOXRTI_PAL_EXACT 4096u          /* up to here each merge is the cheapest of all; above, rounds */
#define VOXRTI_PAL_EXACT_THESIS 20480u
#define VOXRTI_PAL_KMEANS 4u            /* half of them for many entries, where more do not change a thousandth */
#define VOXRTI_PAL_SLACK 2e-6f          /* error of a distance in single precision */

typedef struct voxrti_palbuild {
    const voxrt_env *env;
    voxrti_oklab lab;
    int thesis;
    voxrti_cset all, pal;   /* colours of the cells; colours of the palette */
    uint32_t *color;        /* [all.count] in the order of their codes */
    uint32_t *use, *use_lod;/* [all.count] */
    uint32_t *target;       /* [all.count] thesis: colour it was merged into, or VOXRT_NO_NODE */
    uint32_t *map;          /* [all.count] palette index */
    uint32_t *code;         /* [pal.count] */
    uint32_t *first;        /* [points + 1] reduce: first colour of a point */
    const uint32_t *weight; /* [all.count] reduce: uses; colours of weight 0 do not take part */
    voxrti_preduce red;
    voxrti_pcell *entry;    /* [palette] as points */
    uint32_t spread[256];
} voxrti_palbuild;

static void voxrti_pal_point(const voxrti_palbuild *b, uint32_t rgb, double c[3]) {
    if (!b->thesis) {
        voxrti_oklab_from(&b->lab, rgb, c);
        return;
    }
    c[0] = (double)(rgb & 255u);
    c[1] = (double)(rgb >> 8 & 255u);
    c[2] = (double)(rgb >> 16 & 255u);
}

/* The same for n <= 64 colours, in single precision */
static void voxrti_pal_points(const voxrti_palbuild *b, const uint32_t *rgb, uint32_t n, float c[3][64]) {
    uint32_t i;
    if (!b->thesis) {
        voxrti_oklab_many(&b->lab, rgb, n, c);
        return;
    }
    for (i = 0; i < n; i++) {
        c[0][i] = (float)(rgb[i] & 255u);
        c[1][i] = (float)(rgb[i] >> 8 & 255u);
        c[2][i] = (float)(rgb[i] >> 16 & 255u);
    }
}

static uint32_t voxrti_pal_rgb(const voxrti_palbuild *b, const double c[3]) {
    if (!b->thesis) return voxrti_oklab_to(&b->lab, c);
    return (uint32_t)(c[0] + 0.5) | (uint32_t)(c[1] + 0.5) << 8 | (uint32_t)(c[2] + 0.5) << 16;
}

/* Points: colours that take part, or all those with the same upper bits of their codes, as many bits as leave at most
   `limit` points. They are neighbours in the order of the codes. */
static voxrt_result voxrti_pal_bins(voxrti_mem *mem, voxrti_palbuild *b, uint32_t limit, uint32_t *out_points) {
    uint32_t differ[25], shift = 24, i, n = 1, last = VOXRT_NO_NODE;
    memset(differ, 0, sizeof differ); /* by the highest bit in which a code differs from the one before */
    for (i = 0; i < b->all.count; i++) {
        uint32_t code = voxrti_pal_code(b->spread, b->color[i]);
        if (b->weight[i] == 0) continue;
        if (last != VOXRT_NO_NODE) differ[voxrti_colors_bits(code ^ last) - 1]++;
        last = code;
    }
    while (shift > 0 && n + differ[shift - 1] <= limit) n += differ[--shift];
    *out_points = n;
    b->first = (uint32_t *)voxrti_alloc_array(mem, (size_t)n + 1, sizeof(uint32_t));
    if (b->first == NULL) return VOXRT_ERR_NO_MEMORY;
    for (i = 0, n = 0, last = VOXRT_NO_NODE; i < b->all.count; i++) {
        uint32_t bin = voxrti_pal_code(b->spread, b->color[i]) >> shift;
        if (b->weight[i] == 0) continue;
        if (bin != last) b->first[n++] = i;
        last = bin;
    }
    b->first[n] = b->all.count;
    return VOXRT_OK;
}

static void voxrti_pal_means_task(void *ctx, uint32_t t) {
    voxrti_palbuild *b = (voxrti_palbuild *)ctx;
    uint32_t p = t * 1024, stop = p + 1024, i, from = 0, to = 0;
    float c[3][64];
    int k;
    memset(c, 0, sizeof c);
    if (stop > b->red.points) stop = b->red.points;
    for (; p < stop; p++) {
        voxrti_pcell *cell = &b->red.cell[p];
        memset(cell, 0, sizeof *cell);
        for (i = b->first[p]; i < b->first[p + 1]; i++) {
            double v = (double)b->weight[i];
            if (i >= to) {
                from = i;
                to = b->all.count - i < 64 ? b->all.count : i + 64;
                voxrti_pal_points(b, b->color + from, to - from, c);
            }
            if (b->weight[i] == 0) continue;
            for (k = 0; k < 3; k++) cell->c[k] += (double)c[k][i - from] * v;
            cell->v += v;
        }
        for (k = 0; k < 3; k++) cell->c[k] /= cell->v;
        b->red.label[p] = p;
    }
}

/* The thesis' order of colours is that of 0x00BBGGRR: it decides between equal costs. */
static voxrt_result voxrti_pal_thesis_order(voxrti_mem *mem, voxrti_palbuild *b) {
    voxrti_preduce *w = &b->red;
    voxrti_pcell *cell = (voxrti_pcell *)voxrti_alloc_array(mem, w->n, sizeof *cell);
    uint64_t *order = (uint64_t *)voxrti_alloc_array(mem, (size_t)w->n * 2, sizeof(uint64_t));
    uint32_t i;
    if (cell != NULL && order != NULL) {
        for (i = 0; i < w->n; i++) order[i] = (uint64_t)b->color[b->first[i]] << 32 | i;
        voxrti_pal_sort(order, order + w->n, w->n);
        for (i = 0; i < w->n; i++) {
            cell[i] = w->cell[(uint32_t)order[i]];
            w->label[(uint32_t)order[i]] = i;
        }
        memcpy(w->cell, cell, w->n * sizeof *cell);
    }
    voxrti_free(mem, cell);
    voxrti_free(mem, order);
    return cell != NULL && order != NULL ? VOXRT_OK : VOXRT_ERR_NO_MEMORY;
}

/* Reduce the colours with use > 0 to at most `target` and add them to the palette. */
static voxrt_result voxrti_pal_reduce(voxrti_mem *mem, voxrti_palbuild *b, const uint32_t *use, uint32_t target) {
    voxrti_preduce *w = &b->red;
    uint32_t i, p, n = 0;
    voxrt_result r;
    b->weight = use;
    r = voxrti_pal_bins(mem, b, VOXRTI_PAL_POINTS, &n);
    if (r != VOXRT_OK) return r;
    w->env = b->env;
    w->thesis = b->thesis;
    w->n = w->points = n;
    w->cell = (voxrti_pcell *)voxrti_alloc_array(mem, n, sizeof(voxrti_pcell));
    w->label = (uint32_t *)voxrti_alloc_array(mem, n, sizeof(uint32_t));
    w->partner = (uint32_t *)voxrti_alloc_array(mem, n, sizeof(uint32_t));
    w->key = (double *)voxrti_alloc_array(mem, n, sizeof(double));
    w->link = (uint32_t *)voxrti_alloc_array(mem, n, sizeof(uint32_t));
    if (w->cell == NULL || w->label == NULL || w->partner == NULL || w->key == NULL || w->link == NULL)
        return VOXRT_ERR_NO_MEMORY;
    voxrti_parallel_for(b->env, voxrti_pal_means_task, b, (n + 1023) / 1024);
    if (b->thesis) r = voxrti_pal_thesis_order(mem, b);
    if (r != VOXRT_OK) return r;
    if (n > target) {
        uint32_t exact = b->thesis ? VOXRTI_PAL_EXACT_THESIS : VOXRTI_PAL_EXACT;
        w->order = (uint64_t *)voxrti_alloc_array(mem, (size_t)n * 2, sizeof(uint64_t));
        if (w->order == NULL) return VOXRT_ERR_NO_MEMORY;
        if (!b->thesis) {
            w->point = (voxrti_pcell *)voxrti_alloc_array(mem, n, sizeof(voxrti_pcell));
            if (w->point == NULL) return VOXRT_ERR_NO_MEMORY;
            memcpy(w->point, w->cell, n * sizeof(voxrti_pcell));
        }
        r = voxrti_pal_merge_rounds(mem, w, target > exact ? target : exact);
        if (r != VOXRT_OK) return r;
    }
    if (w->n > target) voxrti_pal_merge_exact(w, target);
    if (w->point != NULL) r = voxrti_pal_kmeans(mem, w, VOXRTI_PAL_KMEANS / (target > 8192 ? 2 : 1));
    if (r != VOXRT_OK) return r;
    for (i = 0; i < w->n; i++)
        voxrti_cset_add(&b->pal, voxrti_pal_code(b->spread, voxrti_pal_rgb(b, w->cell[i].c)));
    if (b->thesis) {
        b->target = (uint32_t *)voxrti_alloc_array(mem, b->all.count, sizeof(uint32_t));
        if (b->target == NULL) return VOXRT_ERR_NO_MEMORY;
        for (i = 0; i < b->all.count; i++) b->target[i] = VOXRT_NO_NODE;
        for (p = 0; p < n; p++)
            for (i = b->first[p]; i < b->first[p + 1]; i++)
                if (use[i] != 0) b->target[i] = voxrti_pal_rgb(b, w->cell[w->label[p]].c);
    }
    return VOXRT_OK;
}

static void voxrti_pal_reduce_free(voxrti_mem *mem, voxrti_palbuild *b) {
    voxrti_free(mem, b->first);
    voxrti_free(mem, b->red.cell);
    voxrti_free(mem, b->red.label);
    voxrti_free(mem, b->red.point);
    voxrti_free(mem, b->red.partner);
    voxrti_free(mem, b->red.key);
    voxrti_free(mem, b->red.link);
    voxrti_free(mem, b->red.order);
    memset(&b->red, 0, sizeof b->red);
    b->first = NULL;
}

/* Nearest entries of the n <= 64 colours whose numbers are in `which`. */
static void voxrti_pal_map_nearest(voxrti_palbuild *b, const uint32_t *which, uint32_t n, voxrti_pgroup *p) {
    uint32_t i, k, ties, rgb[VOXRTI_PAL_GROUP];
    float slack = b->thesis ? 0.0f : VOXRTI_PAL_SLACK;
    memset(rgb, 0, sizeof rgb);
    for (i = 0; i < n; i++) rgb[i] = b->color[which[i]];
    voxrti_pal_points(b, rgb, n, p->c);
    for (p->first = 0; p->first < n; p->first += p->n) {
        voxrti_pgroup_open(&b->red.grid, p, n, slack);
        for (i = p->first; i < p->first + p->n; i++) {
            int32_t found;
            ties = voxrti_pgroup_nearest(p, i, slack);
            found = p->tie[0];
            if (ties > 1) { /* too close for single precision */
                double c[3], d2, best = 1e30;
                voxrti_pal_point(b, rgb[i], c);
                for (k = 0; k < ties; k++) {
                    d2 = voxrti_pcell_d2(c, b->entry[p->tie[k]].c);
                    if (d2 < best || (d2 == best && p->tie[k] < found)) {
                        best = d2;
                        found = p->tie[k];
                    }
                }
            }
            b->map[which[i]] = (uint32_t)found;
        }
    }
}

/* map[colour] = its own entry, or the one it was merged into, or the nearest */
static void voxrti_pal_map_task(void *ctx, uint32_t t) {
    voxrti_palbuild *b = (voxrti_palbuild *)ctx;
    uint32_t i = t * 4096, stop = i + 4096, which[VOXRTI_PAL_GROUP], n = 0, k = 0, end = b->pal.count;
    voxrti_pgroup p;
    if (stop > b->all.count) stop = b->all.count;
    while (k < end) { /* first entry that is not below colour i; both lists ascend */
        uint32_t half = k + (end - k) / 2;
        if (b->code[half] < voxrti_pal_code(b->spread, b->color[i])) k = half + 1;
        else end = half;
    }
    for (; i < stop; i++) {
        uint32_t code = voxrti_pal_code(b->spread, b->color[i]);
        while (k < b->pal.count && b->code[k] < code) k++;
        if (k < b->pal.count && b->code[k] == code) b->map[i] = k;
        else if (b->target != NULL && b->target[i] != VOXRT_NO_NODE)
            b->map[i] = voxrti_cset_index(&b->pal, voxrti_pal_code(b->spread, b->target[i]));
        else which[n++] = i;
        if (n == VOXRTI_PAL_GROUP) {
            voxrti_pal_map_nearest(b, which, n, &p);
            n = 0;
        }
    }
    if (n != 0) voxrti_pal_map_nearest(b, which, n, &p);
}

/* All colours that occur, and those of the leaves that do not fit into the palette, reduced. */
static voxrt_result voxrti_pal_collect(voxrti_mem *mem, voxrti_palbuild *b, uint32_t *rgb, size_t count, size_t census,
                                       uint32_t max_colors, uint32_t *leaf_colors) {
    voxrti_pal_pass pass;
    uint32_t i;
    voxrt_result r = VOXRT_OK;
    if (!voxrti_cset_open(mem, &b->all, count)) return VOXRT_ERR_NO_MEMORY;
    voxrti_pal_pass_open(&pass, rgb, census, &b->all);
    memcpy(b->spread, pass.spread, sizeof b->spread);
    voxrti_parallel_for(b->env, voxrti_pal_mark_task, &pass, (uint32_t)((census - 1) / VOXRTI_PAL_CHUNK + 1));
    voxrti_cset_rank(&b->all);
    *leaf_colors = b->all.count;
    if (count > census) {
        pass.rgb = rgb + census;
        pass.count = count - census;
        voxrti_parallel_for(b->env, voxrti_pal_mark_task, &pass, (uint32_t)((pass.count - 1) / VOXRTI_PAL_CHUNK + 1));
        voxrti_cset_rank(&b->all);
    }
    b->color = (uint32_t *)voxrti_alloc_array(mem, b->all.count, sizeof(uint32_t));
    b->map = (uint32_t *)voxrti_alloc_array(mem, b->all.count, sizeof(uint32_t));
    if (b->color == NULL || b->map == NULL ||
        !voxrti_cset_open(mem, &b->pal, b->all.count < max_colors ? b->all.count : max_colors))
        return VOXRT_ERR_NO_MEMORY;
    voxrti_cset_list(&b->all, b->color);
    for (i = 0; i < b->all.count; i++) b->color[i] = voxrti_pal_rgb_of(b->color[i]);
    if (b->all.count > max_colors) {
        r = voxrti_pal_count(mem, b->env, rgb, census, &b->all, &b->use);
        if (r == VOXRT_OK && *leaf_colors > max_colors) r = voxrti_pal_reduce(mem, b, b->use, max_colors);
        else if (r == VOXRT_OK && *leaf_colors < max_colors) { /* the rest of the room for level-of-detail colours */
            r = voxrti_pal_count(mem, b->env, rgb + census, count - census, &b->all, &b->use_lod);
            for (i = 0; r == VOXRT_OK && i < b->all.count; i++)
                if (b->use[i] != 0) b->use_lod[i] = 0;
            if (r == VOXRT_OK) r = voxrti_pal_reduce(mem, b, b->use_lod, max_colors - *leaf_colors);
        }
        voxrti_pal_reduce_free(mem, b);
    }
    for (i = 0; r == VOXRT_OK && *leaf_colors <= max_colors && i < b->all.count; i++)
        if (b->use == NULL || b->use[i] != 0) voxrti_cset_add(&b->pal, voxrti_pal_code(b->spread, b->color[i]));
    voxrti_cset_rank(&b->pal);
    return r;
}

static voxrt_result voxrti_pal_run(voxrti_mem *mem, voxrti_palbuild *b, uint32_t *rgb, size_t count, size_t census,
                                   uint32_t max_colors, uint8_t **out_palette, uint32_t *out_count,
                                   uint64_t *out_colors_in) {
    voxrti_pal_pass pass;
    uint32_t leaf_colors = 0, i;
    voxrt_result r = voxrti_pal_collect(mem, b, rgb, count, census, max_colors, &leaf_colors);
    if (r != VOXRT_OK) return r;
    *out_count = b->pal.count;
    *out_colors_in = leaf_colors;
    *out_palette = (uint8_t *)voxrti_alloc_array(mem, b->pal.count, 3);
    b->entry = (voxrti_pcell *)voxrti_alloc_zero(mem, b->use != NULL ? b->pal.count : 1, sizeof(voxrti_pcell));
    b->code = (uint32_t *)voxrti_alloc_array(mem, b->pal.count, sizeof(uint32_t));
    if (*out_palette == NULL || b->entry == NULL || b->code == NULL) return VOXRT_ERR_NO_MEMORY;
    voxrti_cset_list(&b->pal, b->code);
    for (i = 0; i < b->pal.count; i++) {
        uint32_t c = voxrti_pal_rgb_of(b->code[i]);
        (*out_palette)[(size_t)i * 3] = (uint8_t)c;
        (*out_palette)[(size_t)i * 3 + 1] = (uint8_t)(c >> 8);
        (*out_palette)[(size_t)i * 3 + 2] = (uint8_t)(c >> 16);
        if (b->use != NULL) voxrti_pal_point(b, c, b->entry[i].c);
    }
    if (b->use != NULL &&
        !voxrti_pgrid_build(mem, &b->red.grid, b->entry, b->pal.count, VOXRTI_FIND_NEAREST)) return VOXRT_ERR_NO_MEMORY;
    voxrti_parallel_for(b->env, voxrti_pal_map_task, b, (b->all.count + 4095) / 4096);
    voxrti_pal_pass_open(&pass, rgb, count, &b->all);
    pass.map = b->map;
    voxrti_parallel_for(b->env, voxrti_pal_replace_task, &pass, (uint32_t)((count - 1) / VOXRTI_PAL_CHUNK + 1));
    return VOXRT_OK;
}

/* Make a palette of at most max_colors (1..2^24) and replace colours by indices.
   rgb_to_index  in: 0x00BBGGRR of `count` cells; out: palette index of each
   census_count  the first so many (leaves) decide the palette, by their usage; 0: all
   out_palette   3 bytes an entry, from voxrti_alloc; at least one entry
   out_colors_in distinct colours of the leaves
   All colours are kept if they fit, else all of the leaves' if these fit; else at most max_colors means remain.
   A colour gets its own entry if the palette has it; with the thesis' method the one it was merged into; else the
   nearest. The thesis' order of colours is that of 0x00BBGGRR. The result depends on how often each colour occurs, not
   on the order of the cells nor on threads. On failure rgb_to_index is unchanged.
   Errors: INVALID_ARG, RANGE, NO_MEMORY. */
static VOXRTI_UNUSED voxrt_result voxrti_palette_build(voxrti_mem *mem, const voxrt_env *env, uint32_t *rgb_to_index,
        size_t count, size_t census_count, uint32_t max_colors, voxrt_palette_method method, uint8_t **out_palette,
        uint32_t *out_count, uint64_t *out_colors_in) {
    voxrti_palbuild *b;
    voxrt_result r;
    *out_palette = NULL;
    *out_count = 0;
    *out_colors_in = 0;
    if (max_colors == 0 || (uint32_t)method > 1u) return VOXRT_ERR_INVALID_ARG;
    if ((uint64_t)count >> 32 != 0)
        return voxrti_fail(env->error, VOXRT_ERR_RANGE, count, "% cells are too many for colours");
    if (count == 0) { /* one white entry */
        *out_palette = (uint8_t *)voxrti_alloc(mem, 3);
        if (*out_palette == NULL) return VOXRT_ERR_NO_MEMORY;
        memset(*out_palette, 255, 3);
        *out_count = 1;
        return VOXRT_OK;
    }
    if (census_count == 0 || census_count > count) census_count = count;
    b = (voxrti_palbuild *)voxrti_alloc_zero(mem, 1, sizeof *b);
    if (b == NULL) return VOXRT_ERR_NO_MEMORY;
    b->env = env;
    b->thesis = method == VOXRT_PALETTE_THESIS;
    voxrti_oklab_init(&b->lab);
    r = voxrti_pal_run(mem, b, rgb_to_index, count, census_count, max_colors, out_palette, out_count, out_colors_in);
    voxrti_pgrid_free(mem, &b->red.grid);
    voxrti_pal_reduce_free(mem, b);
    voxrti_cset_close(mem, &b->all);
    voxrti_cset_close(mem, &b->pal);
    voxrti_free(mem, b->color);
    voxrti_free(mem, b->use);
    voxrti_free(mem, b->use_lod);
    voxrti_free(mem, b->target);
    voxrti_free(mem, b->map);
    voxrti_free(mem, b->code);
    voxrti_free(mem, b->entry);
    voxrti_free(mem, b);
    if (r != VOXRT_OK) {
        voxrti_free(mem, *out_palette);
        *out_palette = NULL;
        *out_count = 0;
    }
    return r;
}

/* ---------------------------------------------------------------------------
   voxelize: triangles -> filled leaves with mean colours and normals.           // >>voxelize

   Vertices are snapped to fixed point, 2^sub units a voxel with depth + sub <= 20: coordinates stay below 2^20, edge
   functions below 2^41, plane values below 2^63, so every decision is an exact 64-bit integer one, and shared
   vertices snap alike: what is closed stays closed, whatever the order of triangles or the number of threads.
   Triangles are binned by bricks of 32^3 voxels (sorted by Morton code). A task works through some bricks one after
   the other with a dense mask, a table voxel -> sum, and sums in integers (exact, so order does not matter), and
   emits its voxels in Morton order: the results of the tasks one after the other are the leaf set.
   --------------------------------------------------------------------------- */

/* Attributes are eight channels: linear light 0..65535, nothing, unit normal, nothing. */
enum { VOXRTI_RGB = 0, VOXRTI_NORMAL = 4, VOXRTI_CHANNELS = 8 };

/* Sums over the fragments of a voxel, of weight times integers: red, blue, green, 1, normal x, z, y, nothing (an order
   that suits four multiplications of two), normals as 2^15 + 2^14 n. Exact, so the order of fragments does not
   matter. */
typedef struct voxrti_fragsum { uint64_t s[8]; } voxrti_fragsum;
enum { VOXRTI_SUM_R, VOXRTI_SUM_B, VOXRTI_SUM_G, VOXRTI_SUM_WEIGHT, VOXRTI_SUM_X, VOXRTI_SUM_Z, VOXRTI_SUM_Y };

typedef struct voxrti_tri {
    int64_t p[3][3];   /* snapped vertices */
    int64_t n[3];      /* normal: twice the area */
    float attr[3][VOXRTI_CHANNELS]; /* of the vertices */
    double length;     /* of n */
    double area;       /* in voxels^2 */
} voxrti_tri;

typedef struct voxrti_vox {
    voxrti_mem *mem;
    const voxrt_build_desc *d;
    const voxrt_mesh *mesh;
    const voxrti_grid *grid;
    uint32_t sub, brick_bits;
    int has_rgb, has_normal;
    uint64_t *ref;             /* brick << 32 | triangle, sorted */
    size_t ref_count;
    size_t *task_first;        /* [tasks + 1] first ref of a task, at a brick's border */
    struct voxrti_bin *bin;    /* [bin_count] what the tasks that bin the triangles found */
    uint32_t bin_count;
    voxrti_leafset *out;       /* [tasks] */
    size_t *out_first;         /* [2 * tasks] blocks and voxels of the tasks before */
    voxrti_leafset *joined;
    uint32_t first_task;
    uint32_t failed;           /* atomic */
    uint32_t fragments[2];     /* a sum of all threads */
    uint32_t srgb[256];
    uint8_t *to_srgb;          /* [65537] linear -> byte */
    uint32_t spread[64];       /* Morton bits of a coordinate inside a brick */
} voxrti_vox;

/* What a task owns while it works. */
typedef struct voxrti_brick {
    voxrti_vox *v;
    uint32_t lo[3];            /* first voxel of the brick */
    uint32_t size;             /* voxels along an axis */
    uint64_t *mask;            /* [size^3/64] target voxels, Morton order */
    uint32_t *slot;            /* [size^3] 1 + index of the voxel's sum; 0: none */
    voxrti_fragsum *sum;
    uint32_t *cell;            /* [sum_capacity] voxel of a sum */
    size_t sum_count, sum_capacity, cell_capacity;
    uint32_t *tiny;            /* voxels touched by triangles that caught no target */
    size_t tiny_count, tiny_capacity;
    uint64_t fragments;
    int failed;
} voxrti_brick;

#define VOXRTI_WEIGHT 65536.0 /* weight of one voxel face of area */

VOXRTI_INLINE uint32_t voxrti_weight(double area) { return (uint32_t)voxrti_min(VOXRTI_WEIGHT * area, 1e9) + 1; }

/* ---- input ---- */

static int voxrti_mesh_vertex(const voxrt_mesh *m, size_t triangle, uint32_t corner, size_t *vertex, float p[3]) {
    size_t i = triangle * 3 + corner, stride = m->position_stride != 0 ? m->position_stride : 12;
    if (m->indices != NULL) i = m->indices[i];
    *vertex = i;
    if (i >= m->vertex_count) return 0;
    memcpy(p, (const uint8_t *)m->positions + i * stride, 12);
    return voxrti_finite_f(p[0]) && voxrti_finite_f(p[1]) && voxrti_finite_f(p[2]);
}

#define VOXRTI_BOX_TASKS 64u

typedef struct voxrti_mesh_box {
    const voxrt_mesh *mesh;
    size_t slice;
    float lo[VOXRTI_BOX_TASKS][3], hi[VOXRTI_BOX_TASKS][3];
    uint32_t any[VOXRTI_BOX_TASKS];
} voxrti_mesh_box;

static void voxrti_mesh_box_task(void *ctx, uint32_t task) {
    voxrti_mesh_box *b = (voxrti_mesh_box *)ctx;
    size_t i = b->slice * task, end = b->mesh->triangle_count - i < b->slice ? b->mesh->triangle_count : i + b->slice;
    float lo[3] = {0, 0, 0}, hi[3] = {0, 0, 0}, p[3][3];
    uint32_t a, k, any = 0;
    for (; i < end; i++) {
        size_t vertex;
        if (!voxrti_mesh_vertex(b->mesh, i, 0, &vertex, p[0]) || !voxrti_mesh_vertex(b->mesh, i, 1, &vertex, p[1]) ||
            !voxrti_mesh_vertex(b->mesh, i, 2, &vertex, p[2]))
            continue;
        if (!any) {
            memcpy(lo, p[0], sizeof lo);
            memcpy(hi, p[0], sizeof hi);
        }
        any = 1;
        for (k = 0; k < 3; k++) {
            for (a = 0; a < 3; a++) {
                lo[a] = p[k][a] < lo[a] ? p[k][a] : lo[a];
                hi[a] = p[k][a] > hi[a] ? p[k][a] : hi[a];
            }
        }
    }
    memcpy(b->lo[task], lo, sizeof lo);
    memcpy(b->hi[task], hi, sizeof hi);
    b->any[task] = any;
}

static VOXRTI_UNUSED voxrt_result voxrti_grid_from_mesh(const voxrt_build_desc *d, const voxrt_mesh *mesh,
                                                        voxrti_grid *grid) {
    double lo[3], hi[3], longest = 0;
    voxrti_mesh_box box;
    uint32_t a, k, any = 0, tasks;
    memset(grid, 0, sizeof *grid);
    grid->resolution = d->resolution;
    grid->depth = 1;
    while (((uint32_t)1 << grid->depth) < grid->resolution) grid->depth++;
    if (d->box_size > 0) {
        memcpy(grid->origin, d->box_min, sizeof grid->origin);
        grid->voxel_size = d->box_size / (double)grid->resolution;
        return VOXRT_OK;
    }
    box.mesh = mesh;
    box.slice = mesh->triangle_count / VOXRTI_BOX_TASKS + 4096;
    tasks = (uint32_t)((mesh->triangle_count + box.slice - 1) / box.slice);
    voxrti_parallel_for(&d->env, voxrti_mesh_box_task, &box, tasks);
    for (a = 0; a < 3; a++) lo[a] = hi[a] = 0;
    for (k = 0; k < tasks; k++) {
        if (!box.any[k]) continue;
        for (a = 0; a < 3; a++) {
            double l = (double)box.lo[k][a], h = (double)box.hi[k][a];
            if (!any || l < lo[a]) lo[a] = l;
            if (!any || h > hi[a]) hi[a] = h;
        }
        any = 1;
    }
    if (!any) return voxrti_fail(d->env.error, VOXRT_ERR_EMPTY, 0, "the mesh has no usable triangle");
    for (a = 0; a < 3; a++) longest = voxrti_max(longest, hi[a] - lo[a]);
    /* half a voxel stays free on both sides; one voxel for a point or a grid of one cell */
    grid->voxel_size = grid->resolution > 1 ? longest / (double)(grid->resolution - 1) : longest;
    if (!(grid->voxel_size > 0)) grid->voxel_size = 1.0;
    for (a = 0; a < 3; a++)
        grid->origin[a] = 0.5 * (lo[a] + hi[a]) - 0.5 * (double)grid->resolution * grid->voxel_size;
    return VOXRT_OK;
}

/* Corners of a triangle in voxels, the lowest one first, so that it does not matter where the triangle begins.
   0: not usable. */
static int voxrti_tri_corners(const voxrti_vox *v, size_t i, double p[3][3], size_t vertex[3]) {
    double scale = 1.0 / v->grid->voxel_size;
    uint32_t k, a, first = 0;
    for (k = 0; k < 3; k++) {
        float f[3];
        if (!voxrti_mesh_vertex(v->mesh, i, k, &vertex[k], f)) return 0;
        for (a = 0; a < 3; a++) {
            p[k][a] = ((double)f[a] - v->grid->origin[a]) * scale;
            if (!(voxrti_abs(p[k][a]) < 1e300)) return 0; /* differences stay finite */
        }
        for (a = 0; a < 3 && p[k][a] == p[first][a]; a++) { }
        if (a < 3 ? p[k][a] < p[first][a] : vertex[k] < vertex[first]) first = k;
    }
    for (; first > 0; first--) {
        double q[3];
        size_t x = vertex[0];
        memcpy(q, p[0], sizeof q);
        memcpy(p[0], p[1], sizeof q);
        memcpy(p[1], p[2], sizeof q);
        memcpy(p[2], q, sizeof q);
        vertex[0] = vertex[1];
        vertex[1] = vertex[2];
        vertex[2] = x;
    }
    return 1;
}

static void voxrti_tri_finish(const voxrti_vox *v, voxrti_tri *t) {
    double x, y, z, s = (double)((uint32_t)1 << v->sub);
    uint32_t a;
    for (a = 0; a < 3; a++) {
        uint32_t b = (a + 1) % 3, c = (a + 2) % 3;
        t->n[a] = (t->p[1][b] - t->p[0][b]) * (t->p[2][c] - t->p[0][c]) -
                  (t->p[1][c] - t->p[0][c]) * (t->p[2][b] - t->p[0][b]);
    }
    x = (double)t->n[0];
    y = (double)t->n[1];
    z = (double)t->n[2];
    t->length = sqrt(x * x + y * y + z * z);
    t->area = 0.5 * t->length / (s * s);
}

/* Attributes of a triangle's corners. */
static void voxrti_tri_attributes(const voxrti_vox *v, size_t i, const size_t vertex[3], const double p[3][3],
                                  voxrti_tri *t) {
    const voxrt_mesh *m = v->mesh;
    uint32_t k, a, faces = 0;
    float f[3];
    memset(t->attr, 0, sizeof t->attr);
    for (k = 0; v->has_rgb && k < 3; k++) {
        const uint8_t *c = m->triangle_rgb != NULL ? m->triangle_rgb + 3 * i :
            m->vertex_rgb + vertex[k] * (m->vertex_rgb_stride != 0 ? m->vertex_rgb_stride : 3);
        for (a = 0; a < 3; a++) t->attr[k][VOXRTI_RGB + a] = (float)v->srgb[c[a]];
    }
    if (!v->has_normal) return;
    for (k = 0; k < 3; k++) {
        if (m->normals != NULL) {
            size_t stride = m->normal_stride != 0 ? m->normal_stride : 12;
            memcpy(f, (const uint8_t *)m->normals + vertex[k] * stride, 12);
        }
        if (m->normals != NULL && voxrti_normalize(f)) memcpy(&t->attr[k][VOXRTI_NORMAL], f, sizeof f);
        else faces |= 1u << k;
    }
    if (faces != 0) { /* the triangle's own normal */
        double n[3], l;
        for (a = 0; a < 3; a++) {
            uint32_t b = (a + 1) % 3, c = (a + 2) % 3;
            n[a] = (p[1][b] - p[0][b]) * (p[2][c] - p[0][c]) - (p[1][c] - p[0][c]) * (p[2][b] - p[0][b]);
        }
        l = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        for (a = 0; a < 3; a++) f[a] = l > 0 && voxrti_finite(l) ? (float)(n[a] / l) : 0.0f;
        for (k = 0; k < 3; k++)
            if (faces >> k & 1u) memcpy(&t->attr[k][VOXRTI_NORMAL], f, sizeof f);
    }
}

/* A corner of a clipped polygon: position and attributes. */
typedef struct voxrti_corner { double p[3]; float attr[VOXRTI_CHANNELS]; } voxrti_corner;

static uint32_t voxrti_clip_plane(const voxrti_corner *in, uint32_t n, voxrti_corner *out, uint32_t a, double at,
                                  int below) {
    uint32_t i, k, count = 0;
    for (i = 0; i < n; i++) {
        const voxrti_corner *p = &in[i], *q = &in[(i + 1) % n];
        double dp = below ? at - p->p[a] : p->p[a] - at, dq = below ? at - q->p[a] : q->p[a] - at;
        if (dp >= 0) out[count++] = *p;
        if ((dp >= 0) != (dq >= 0)) { /* from the inner end: triangles on both sides of an edge get the same point */
            double s;
            if (dp < 0) {
                q = p;
                p = &in[(i + 1) % n];
                s = dq / (dq - dp);
            } else {
                s = dp / (dp - dq);
            }
            for (k = 0; k < 3; k++) out[count].p[k] = p->p[k] + s * (q->p[k] - p->p[k]);
            for (k = 0; k < VOXRTI_CHANNELS; k++)
                out[count].attr[k] = p->attr[k] + (float)s * (q->attr[k] - p->attr[k]);
            out[count++].p[a] = at;
        }
    }
    return count;
}

/* Call fn for triangle i, snapped; clipped to the grid (plus one voxel around) where it leaves it.
   Returns 0 when it is not usable. */
static int voxrti_tri_each(const voxrti_vox *v, size_t i, int attributes,
                           void (*fn)(void *ctx, const voxrti_tri *t, size_t i), void *ctx) {
    double p[3][3], s = (double)((uint32_t)1 << v->sub), end = (double)v->grid->resolution + 1.0;
    size_t vertex[3];
    voxrti_tri t;
    uint32_t k, a, inside = 1, n;
    memset(vertex, 0, sizeof vertex);
    if (!voxrti_tri_corners(v, i, p, vertex)) return 0;
    if (attributes) voxrti_tri_attributes(v, i, vertex, (const double (*)[3])p, &t);
    for (k = 0; k < 3; k++)
        for (a = 0; a < 3; a++) inside &= p[k][a] >= -1.0 && p[k][a] <= end;
    if (inside) {
        for (k = 0; k < 3; k++)
            for (a = 0; a < 3; a++) t.p[k][a] = voxrti_floor(p[k][a] * s + 0.5);
        voxrti_tri_finish(v, &t);
        fn(ctx, &t, i);
    } else {
        voxrti_corner c[2][12];
        memset(c, 0, sizeof c);
        for (k = 0; k < 3; k++) {
            memcpy(c[0][k].p, p[k], sizeof p[k]);
            if (attributes) memcpy(c[0][k].attr, t.attr[k], sizeof t.attr[k]);
        }
        for (a = 0, n = 3; a < 3 && n != 0; a++) {
            n = voxrti_clip_plane(c[0], n, c[1], a, -1.0, 0);
            n = voxrti_clip_plane(c[1], n, c[0], a, end, 1);
        }
        for (k = 1; k + 1 < n; k++) {
            uint32_t j;
            for (j = 0; j < 3; j++) {
                const voxrti_corner *q = &c[0][j == 0 ? 0 : k + j - 1];
                for (a = 0; a < 3; a++) t.p[j][a] = voxrti_floor(q->p[a] * s + 0.5);
                if (attributes) memcpy(t.attr[j], q->attr, sizeof q->attr);
            }
            voxrti_tri_finish(v, &t);
            fn(ctx, &t, i);
        }
    }
    return 1;
}

/* ---- binning ---- */

typedef struct voxrti_bin {
    voxrti_vox *v;
    uint64_t *ref;          /* [count] brick << 32 | triangle */
    size_t count, capacity;
    uint64_t degenerate, rejected, last;
} voxrti_bin;

static void voxrti_bin_tri(void *ctx, const voxrti_tri *t, size_t i) {
    voxrti_bin *b = (voxrti_bin *)ctx;
    uint32_t shift = b->v->brick_bits + b->v->sub, a, k, many;
    int64_t lo[3], hi[3], c[3], size = (int64_t)1 << shift,
                                end = (((int64_t)b->v->grid->resolution - 1) >> b->v->brick_bits);
    if (t->n[0] == 0 && t->n[1] == 0 && t->n[2] == 0) b->degenerate++;
    for (a = 0; a < 3; a++) {
        lo[a] = hi[a] = t->p[0][a];
        for (k = 1; k < 3; k++) {
            if (t->p[k][a] < lo[a]) lo[a] = t->p[k][a];
            if (t->p[k][a] > hi[a]) hi[a] = t->p[k][a];
        }
        lo[a] = lo[a] - 1 < 0 ? 0 : (lo[a] - 1) >> shift; /* -1: closed boxes touch on a brick's face */
        hi[a] = hi[a] < 0 ? -1 : hi[a] >> shift;
        if (hi[a] > end) hi[a] = end;
    }
    many = (hi[0] - lo[0] > 1) + (hi[1] - lo[1] > 1) + (hi[2] - lo[2] > 1) > 1;
    for (c[2] = lo[2]; c[2] <= hi[2]; c[2]++) {
        for (c[1] = lo[1]; c[1] <= hi[1]; c[1]++) {
            for (c[0] = lo[0]; c[0] <= hi[0]; c[0]++) {
                uint64_t ref;
                if (many) { /* does the plane miss the brick? */
                    double d = 0, r = 0;
                    for (a = 0; a < 3; a++) {
                        d += (double)t->n[a] * ((double)(c[a] * size) + 0.5 * (double)size - (double)t->p[0][a]);
                        r += voxrti_abs((double)t->n[a]);
                    }
                    if (voxrti_abs(d) > r * (0.5 * (double)size + 2.0) * 1.0001) continue;
                }
                ref = voxrti_morton((uint32_t)c[0], (uint32_t)c[1], (uint32_t)c[2]) << 32 | (uint64_t)i;
                if (ref == b->last) continue; /* pieces of a clipped triangle */
                b->last = ref;
                if (b->count == b->capacity &&
                    !voxrti_grow(b->v->mem, (void **)&b->ref, &b->capacity, b->count, b->count + 1, sizeof *b->ref)) {
                    voxrti_atomic_store(&b->v->failed, 1u);
                    return;
                }
                b->ref[b->count++] = ref;
            }
        }
    }
}

#define VOXRTI_BIN_CHUNK 16384u

static void voxrti_bin_task(void *ctx, uint32_t task) {
    voxrti_vox *v = (voxrti_vox *)ctx;
    voxrti_bin b;
    size_t i = (size_t)task * VOXRTI_BIN_CHUNK, end = i + VOXRTI_BIN_CHUNK;
    memset(&b, 0, sizeof b);
    b.v = v;
    if (end > v->mesh->triangle_count) end = v->mesh->triangle_count;
    for (; i < end; i++) {
        b.last = ~(uint64_t)0;
        if (!voxrti_tri_each(v, i, 0, voxrti_bin_tri, &b)) b.rejected++;
    }
    v->bin[task] = b;
}

/* One pass of a stable sort of all refs by up to ten bits. It takes them from the bins at first, then from an array. */
#define VOXRTI_SORT_CHUNK 65536u

typedef struct voxrti_refsort {
    const voxrti_bin *bin;
    const uint64_t *from;
    uint64_t *to;
    size_t n, *start;      /* [chunks][1024] where the next ref with these bits goes */
    uint32_t shift, scatter;
} voxrti_refsort;

static void voxrti_refsort_task(void *ctx, uint32_t task) {
    voxrti_refsort *job = (voxrti_refsort *)ctx;
    const uint64_t *a;
    size_t i, n, *start = job->start + (size_t)task * 1024;
    uint32_t shift = job->shift;
    if (job->bin != NULL) {
        a = job->bin[task].ref;
        n = job->bin[task].count;
    } else {
        a = job->from + (size_t)task * VOXRTI_SORT_CHUNK;
        n = job->n - (size_t)task * VOXRTI_SORT_CHUNK;
        if (n > VOXRTI_SORT_CHUNK) n = VOXRTI_SORT_CHUNK;
    }
    if (job->scatter) {
        for (i = 0; i < n; i++) job->to[start[a[i] >> shift & 1023u]++] = a[i];
    } else {
        memset(start, 0, 1024 * sizeof *start);
        for (i = 0; i < n; i++) start[a[i] >> shift & 1023u]++;
    }
}

static void voxrti_refsort_pass(const voxrt_env *env, voxrti_refsort *job, uint32_t chunks) {
    size_t sum = 0, c;
    uint32_t digit, k;
    job->scatter = 0;
    voxrti_parallel_for(env, voxrti_refsort_task, job, chunks);
    for (digit = 0; digit < 1024; digit++) {
        for (k = 0; k < chunks; k++) {
            size_t *start = &job->start[(size_t)k * 1024 + digit];
            c = *start;
            *start = sum;
            sum += c;
        }
    }
    job->scatter = 1;
    voxrti_parallel_for(env, voxrti_refsort_task, job, chunks);
}

/* All refs of the bins in v->ref, sorted by brick, then by triangle. */
static voxrt_result voxrti_bin_sort(voxrti_vox *v) {
    const voxrt_env *env = &v->d->env;
    voxrti_refsort job;
    uint64_t *tmp = NULL;
    uint32_t i, chunks, bits = v->grid->depth > v->brick_bits ? 3 * (v->grid->depth - v->brick_bits) : 0, done;
    memset(&job, 0, sizeof job);
    for (i = 0; i < v->bin_count; i++) job.n += v->bin[i].count;
    v->ref_count = job.n;
    v->ref = (uint64_t *)voxrti_alloc_array(v->mem, job.n + 1, sizeof(uint64_t));
    chunks = (uint32_t)((job.n + VOXRTI_SORT_CHUNK - 1) / VOXRTI_SORT_CHUNK);
    job.start = (size_t *)voxrti_alloc_array(v->mem, v->bin_count + chunks + 1, 1024 * sizeof(size_t));
    if (v->ref != NULL && job.start != NULL) {
        job.bin = v->bin;
        job.to = v->ref;
        job.shift = 32;
        voxrti_refsort_pass(env, &job, v->bin_count);
    }
    for (i = 0; i < v->bin_count; i++) voxrti_free(v->mem, v->bin[i].ref);
    voxrti_free(v->mem, v->bin);
    v->bin = NULL;
    job.bin = NULL;
    if (v->ref != NULL && job.start != NULL && bits > 10)
        tmp = (uint64_t *)voxrti_alloc_array(v->mem, job.n + 1, sizeof(uint64_t));
    for (done = 10; done < bits && tmp != NULL; done += 10) {
        job.from = v->ref;
        job.to = tmp;
        job.shift = 32 + done;
        voxrti_refsort_pass(env, &job, chunks);
        tmp = v->ref;
        v->ref = job.to;
    }
    i = v->ref != NULL && job.start != NULL && (tmp != NULL || bits <= 10);
    voxrti_free(v->mem, tmp);
    voxrti_free(v->mem, job.start);
    return i ? VOXRT_OK : VOXRT_ERR_NO_MEMORY;
}

static voxrt_result voxrti_bin_all(voxrti_vox *v, voxrt_build_stats *stats) {
    uint32_t i;
    v->bin_count = (uint32_t)((v->mesh->triangle_count + VOXRTI_BIN_CHUNK - 1) / VOXRTI_BIN_CHUNK);
    v->bin = (voxrti_bin *)voxrti_alloc_zero(v->mem, v->bin_count, sizeof(voxrti_bin));
    if (v->bin == NULL) return VOXRT_ERR_NO_MEMORY;
    voxrti_parallel_for(&v->d->env, voxrti_bin_task, v, v->bin_count);
    for (i = 0; i < v->bin_count; i++) {
        stats->degenerate += v->bin[i].degenerate;
        stats->rejected += v->bin[i].rejected;
    }
    if (voxrti_atomic_load(&v->failed)) return VOXRT_ERR_NO_MEMORY;
    if (stats->rejected != 0 && v->d->strict) {
        double p[3][3];
        size_t vertex[3], k;
        for (k = 0; k < v->mesh->triangle_count && voxrti_tri_corners(v, k, p, vertex); k++) { }
        return voxrti_fail(v->d->env.error, VOXRT_ERR_FORMAT, k, "triangle % has a bad vertex");
    }
    return voxrti_bin_sort(v);
}

/* ---- rasterising into a brick ---- */

/* Attributes as planes over the columns of an axis: value = at + i * di + k * dk; i and k count from the
   brick's corner. Kept between the corners' values: the planes of slivers are steep, and a voxel that is touched may
   have its centre outside of the triangle. */
typedef struct voxrti_ramp {
    float at[VOXRTI_CHANNELS], di[VOXRTI_CHANNELS], dk[VOXRTI_CHANNELS], lo[VOXRTI_CHANNELS], hi[VOXRTI_CHANNELS];
} voxrti_ramp;

static void voxrti_ramp_make(const voxrti_brick *b, const voxrti_tri *t, uint32_t a, voxrti_ramp *r) {
    uint32_t u = (a + 1) % 3, w = (a + 2) % 3, c;
    double s = (double)((uint32_t)1 << b->v->sub), inv = t->n[a] != 0 ? 1.0 / (double)t->n[a] : 0.0;
    double e1u = (double)(t->p[1][u] - t->p[0][u]), e1w = (double)(t->p[1][w] - t->p[0][w]);
    double e2u = (double)(t->p[2][u] - t->p[0][u]), e2w = (double)(t->p[2][w] - t->p[0][w]);
    double ou = ((double)b->lo[u] + 0.5) * s - (double)t->p[0][u],
           ow = ((double)b->lo[w] + 0.5) * s - (double)t->p[0][w];
    for (c = 0; c < VOXRTI_CHANNELS; c++) {
        double f0 = (double)t->attr[0][c], f1 = (double)t->attr[1][c] - f0, f2 = (double)t->attr[2][c] - f0;
        double gu = (f1 * e2w - f2 * e1w) * inv, gw = (f2 * e1u - f1 * e2u) * inv;
        r->at[c] = t->n[a] != 0 ? (float)(f0 + gu * ou + gw * ow) : (float)(f0 + (f1 + f2) / 3.0);
        r->di[c] = (float)(gu * s);
        r->dk[c] = (float)(gw * s);
        r->lo[c] = (float)(f0 + voxrti_min(0.0, voxrti_min(f1, f2)));
        r->hi[c] = (float)(f0 + voxrti_max(0.0, voxrti_max(f1, f2)));
    }
}

VOXRTI_INLINE float voxrti_ramp_limit(const voxrti_ramp *r, uint32_t c, float x) {
    x = x < r->lo[c] ? r->lo[c] : x;
    return x > r->hi[c] ? r->hi[c] : x;
}

VOXRTI_INLINE uint32_t voxrti_brick_cell(const voxrti_brick *b, const uint32_t c[3]) {
    const uint32_t *spread = b->v->spread;
    return spread[c[0] - b->lo[0]] | spread[c[1] - b->lo[1]] << 1 | spread[c[2] - b->lo[2]] << 2;
}

/* Sum of a voxel; made when it is met first. NULL: no memory. */
VOXRTI_INLINE voxrti_fragsum *voxrti_brick_sum(voxrti_brick *b, uint32_t cell) {
    uint32_t i = b->slot[cell];
    if (i == 0) {
        if (b->sum_count == b->sum_capacity || b->sum_count == b->cell_capacity) {
            if (!voxrti_grow(b->v->mem, (void **)&b->sum, &b->sum_capacity, b->sum_count, b->sum_count + 4096,
                             sizeof *b->sum) ||
                !voxrti_grow(b->v->mem, (void **)&b->cell, &b->cell_capacity, b->sum_count, b->sum_count + 4096,
                             sizeof *b->cell)) {
                b->failed = 1;
                return NULL;
            }
        }
        memset(&b->sum[b->sum_count], 0, sizeof *b->sum);
        b->cell[b->sum_count++] = cell;
        b->slot[cell] = i = (uint32_t)b->sum_count;
    }
    return &b->sum[i - 1];
}

/* Add the integers a[0..3], b[0..3], below 2^16, times `weight`. */
VOXRTI_INLINE void voxrti_fragsum_add(voxrti_fragsum *sum, voxrti_i4 a, voxrti_i4 b, uint32_t weight) {
#if VOXRTI_X64
    const __m128i w = _mm_set1_epi32((int32_t)weight);
    __m128i *s = (__m128i *)(void *)sum->s;
    s[0] = _mm_add_epi64(s[0], _mm_mul_epu32(a, w));
    s[1] = _mm_add_epi64(s[1], _mm_mul_epu32(_mm_srli_epi64(a, 32), w));
    s[2] = _mm_add_epi64(s[2], _mm_mul_epu32(b, w));
    s[3] = _mm_add_epi64(s[3], _mm_mul_epu32(_mm_srli_epi64(b, 32), w));
#else
    uint32_t i;
    for (i = 0; i < 4; i++) {
        sum->s[i / 2 + i % 2 * 2] += (uint64_t)(uint32_t)a.v[i] * weight;
        sum->s[4 + i / 2 + i % 2 * 2] += (uint64_t)(uint32_t)b.v[i] * weight;
    }
#endif
}

static const float voxrti_fragment_scale[2][4] = {{1.0f, 1.0f, 1.0f, 0.0f}, {16384.0f, 16384.0f, 16384.0f, 0.0f}};
static const float voxrti_fragment_shift[2][4] = {{0.5f, 0.5f, 0.5f, 1.0f}, {32768.5f, 32768.5f, 32768.5f, 0.0f}};

/* Four channels of attributes as the integers that are summed, plus what is cut off. */
VOXRTI_INLINE voxrti_f4 voxrti_fragment_scaled(const float *f, uint32_t half) {
    return voxrti_f4_add(voxrti_f4_mul(voxrti_f4_load(f + 4 * half), voxrti_f4_load(voxrti_fragment_scale[half])),
                         voxrti_f4_load(voxrti_fragment_shift[half]));
}

VOXRTI_INLINE void voxrti_fragment(voxrti_brick *b, uint32_t cell, uint32_t weight, voxrti_f4 rgb, voxrti_f4 normal) {
    voxrti_fragsum *s = voxrti_brick_sum(b, cell);
    if (s == NULL) return;
    b->fragments++;
    voxrti_fragsum_add(s, voxrti_f4_int(rgb), voxrti_f4_int(normal), weight);
}

/* The same for attributes that may have been rounded out of their range. */
static void voxrti_fragment_attr(voxrti_brick *b, uint32_t cell, uint32_t weight, const float f[VOXRTI_CHANNELS]) {
    voxrti_f4 least = voxrti_f4_all(0.0f), most = voxrti_f4_all(65535.0f);
    voxrti_fragment(b, cell, weight,
                    voxrti_f4_min(voxrti_f4_max(voxrti_fragment_scaled(f, 0), least), most),
                    voxrti_f4_min(voxrti_f4_max(voxrti_fragment_scaled(f, 1), least), most));
}

/* Columns i of row k in [i0, i1] for which e + i * step >= 0. */
VOXRTI_INLINE void voxrti_row_clip(int64_t e, int64_t step, double inv, int64_t *i0, int64_t *i1) {
    int64_t i;
    if (step == 0) {
        if (e < 0) *i1 = *i0 - 1;
        return;
    }
    if (*i0 > *i1) return;
    i = voxrti_floor(-(double)e * inv); /* near the root; then exactly */
    if (step > 0) {
        while (e + i * step >= 0) i--;
        while (e + i * step < 0) i++;
        if (i > *i0) *i0 = i;
    } else {
        while (e + i * step >= 0) i++;
        while (e + i * step < 0) i--;
        if (i < *i1) *i1 = i;
    }
}

/* Crosshair targets of axis a (Laine 2013): columns whose centre line meets the triangle, edges included; the voxel is
   the floor of the depth. clip: only the brick's, adding fragments; else only count (stops at the first).
   Returns the number of targets. */
static uint64_t voxrti_raster_axis(voxrti_brick *b, const voxrti_tri *t, uint32_t a, int clip) {
    const voxrti_vox *v = b->v;
    uint32_t u = (a + 1) % 3, w = (a + 2) % 3, e, k3;
    int64_t size = (int64_t)1 << v->sub, half = size >> 1, sign = t->n[a] < 0 ? -1 : 1, na = t->n[a] * sign;
    int64_t lo[2], hi[2], limit = (int64_t)v->grid->resolution, i, k, div = na * size;
    int64_t at[3], step_i[3], step_k[3], depth0 = 0, depth_i, depth_k = 0;
    double inv[3], inv_div = 0;
    uint64_t found = 0;
    uint32_t ready = 0, few, weight = 0;
    voxrti_ramp ramp;
    if (na == 0) return 0;
    for (e = 0; e < 2; e++) { /* columns and rows whose centres the box of the projection holds */
        uint32_t x = e == 0 ? u : w;
        lo[e] = hi[e] = t->p[0][x];
        for (k3 = 1; k3 < 3; k3++) {
            if (t->p[k3][x] < lo[e]) lo[e] = t->p[k3][x];
            if (t->p[k3][x] > hi[e]) hi[e] = t->p[k3][x];
        }
        lo[e] = (lo[e] - half + size - 1) >> v->sub;
        hi[e] = (hi[e] - half) >> v->sub;
        if (clip) {
            if (lo[e] < (int64_t)b->lo[x]) lo[e] = (int64_t)b->lo[x];
            if (hi[e] > (int64_t)(b->lo[x] + b->size) - 1) hi[e] = (int64_t)(b->lo[x] + b->size) - 1;
        }
        if (lo[e] < 0) lo[e] = 0;
        if (hi[e] > limit - 1) hi[e] = limit - 1;
        if (lo[e] > hi[e]) return 0;
    }
    few = hi[0] - lo[0] < 4;
    memset(&ramp, 0, sizeof ramp);
    for (e = 0; e < 3; e++) { /* edge functions, >= 0 inside */
        const int64_t *p = t->p[e], *q = t->p[(e + 1) % 3];
        int64_t du = (q[u] - p[u]) * sign, dw = (q[w] - p[w]) * sign;
        at[e] = du * (half - p[w]) - dw * (half - p[u]);
        step_i[e] = -dw * size;
        step_k[e] = du * size;
        inv[e] = few || step_i[e] == 0 ? 0.0 : 1.0 / (double)step_i[e];
    }
    depth_i = -t->n[u] * size * sign;
    for (k = lo[1]; k <= hi[1]; k++) {
        int64_t i0 = lo[0], i1 = hi[0], depth;
        float row[VOXRTI_CHANNELS];
        if (few) { /* a handful of columns: look at each */
            int64_t e0 = at[0] + k * step_k[0] + i0 * step_i[0], e1 = at[1] + k * step_k[1] + i0 * step_i[1];
            int64_t e2 = at[2] + k * step_k[2] + i0 * step_i[2];
            for (; i0 <= i1 && (e0 | e1 | e2) < 0; i0++) {
                e0 += step_i[0];
                e1 += step_i[1];
                e2 += step_i[2];
            }
            for (i = i0; i <= i1 && (e0 | e1 | e2) >= 0; i++) {
                e0 += step_i[0];
                e1 += step_i[1];
                e2 += step_i[2];
            }
            i1 = i - 1;
        } else {
            for (e = 0; e < 3; e++) voxrti_row_clip(at[e] + k * step_k[e], step_i[e], inv[e], &i0, &i1);
        }
        if (i0 > i1) continue;
        if (!clip) return 1;
        if (!ready) { /* the first row that meets anything */
            ready = 1;
            depth0 = t->p[0][a] * na - (t->n[u] * (half - t->p[0][u]) + t->n[w] * (half - t->p[0][w])) * sign;
            depth_k = -t->n[w] * size * sign;
            inv_div = 1.0 / (double)div;
            weight = voxrti_weight((double)na / t->length);
            voxrti_ramp_make(b, t, a, &ramp);
        }
        depth = depth0 + k * depth_k + i0 * depth_i;
        for (e = 0; e < VOXRTI_CHANNELS; e++) row[e] = ramp.at[e] + (float)(k - (int64_t)b->lo[w]) * ramp.dk[e];
        for (i = i0; i <= i1; i++, depth += depth_i) {
            int64_t q = (int64_t)((double)depth * inv_div), r = depth - q * div;
            uint32_t c[3], cell;
            float f[VOXRTI_CHANNELS];
            q += r < 0 ? -1 : r >= div ? 1 : 0;
            if (q == limit && depth == limit * div) q--; /* on the far face of the grid */
            if (q < (int64_t)b->lo[a] || q >= (int64_t)(b->lo[a] + b->size) || q >= limit) continue;
            c[a] = (uint32_t)q;
            c[u] = (uint32_t)i;
            c[w] = (uint32_t)k;
            cell = voxrti_brick_cell(b, c);
            b->mask[cell >> 6] |= (uint64_t)1 << (cell & 63u);
            for (e = 0; e < VOXRTI_CHANNELS; e++)
                f[e] = voxrti_ramp_limit(&ramp, e, row[e] + (float)(i - (int64_t)b->lo[u]) * ramp.di[e]);
            voxrti_fragment_attr(b, cell, weight, f);
            found++;
        }
    }
    return found;
}

/* The same for triangles below 2^14 units in extent, all three axes: edge functions fit into 32 bits, and columns are
   looked at four at a time. Attributes are weighted by the edge functions. Only columns of the brick. Returns 0 if none
   meets the triangle, at any depth; *cut: there may be some outside of the brick. tiny: see voxrti_tri_points. */
static uint64_t voxrti_raster_short(voxrti_brick *b, const voxrti_tri *t, int tiny, int *cut) {
    const voxrti_vox *v = b->v;
    const int32_t size = (int32_t)1 << v->sub, half = size >> 1, limit = (int32_t)v->grid->resolution;
    voxrti_f4 rgb[3], normal[3], rgb_lo, rgb_hi, normal_lo, normal_hi;
    uint32_t a, e, any = 0;
    *cut = 0;
    for (e = 0; e < 3; e++) {
        rgb[e] = voxrti_fragment_scaled(t->attr[e], 0);
        normal[e] = voxrti_fragment_scaled(t->attr[e], 1);
    }
    rgb_lo = voxrti_f4_min(voxrti_f4_min(rgb[0], rgb[1]), rgb[2]);
    rgb_hi = voxrti_f4_max(voxrti_f4_max(rgb[0], rgb[1]), rgb[2]);
    normal_lo = voxrti_f4_min(voxrti_f4_min(normal[0], normal[1]), normal[2]);
    normal_hi = voxrti_f4_max(voxrti_f4_max(normal[0], normal[1]), normal[2]);
    for (e = 1; e < 3; e++) {
        rgb[e] = voxrti_f4_sub(rgb[e], rgb[0]);
        normal[e] = voxrti_f4_sub(normal[e], normal[0]);
    }
    for (a = 0; a < 3; a++) {
        const uint32_t u = (a + 1) % 3, w = (a + 2) % 3;
        const int32_t sign = t->n[a] < 0 ? -1 : 1;
        const int64_t na = t->n[a] * sign, div = na * size;
        int32_t lo[2], hi[2], at[3], step_k[3], i, k;
        int64_t depth0, depth_i, depth_k;
        double inv_div;
        voxrti_f4 inv;
        voxrti_i4 lane[3], step_4[3];
        uint32_t weight;
        if (na == 0) continue;
        for (e = 0; e < 2; e++) { /* columns and rows whose centres the box of the projection holds */
            const uint32_t x = e == 0 ? u : w;
            const int32_t p0 = (int32_t)t->p[0][x], p1 = (int32_t)t->p[1][x], p2 = (int32_t)t->p[2][x];
            int32_t least = p0 < p1 ? p0 : p1, most = p0 > p1 ? p0 : p1, first = (int32_t)b->lo[x];
            least = ((p2 < least ? p2 : least) - half + size - 1) >> v->sub;
            most = ((p2 > most ? p2 : most) - half) >> v->sub;
            lo[e] = least < first ? first : least;
            first += (int32_t)b->size - 1;
            hi[e] = most > first ? first : most;
            if (hi[e] > limit - 1) hi[e] = limit - 1;
            *cut |= lo[e] != least || hi[e] != most;
        }
        if (lo[0] > hi[0] || lo[1] > hi[1]) continue;
        for (e = 0; e < 3; e++) { /* edge functions, >= 0 inside */
            const int64_t *p = t->p[e], *q = t->p[e == 2 ? 0 : e + 1];
            int32_t du = (int32_t)(q[u] - p[u]) * sign, dw = (int32_t)(q[w] - p[w]) * sign, step = -dw * size;
            at[e] = du * (lo[1] * size + half - (int32_t)p[w]) - dw * (lo[0] * size + half - (int32_t)p[u]);
            step_k[e] = du * size;
            lane[e] = voxrti_i4_set(0, step, 2 * step, 3 * step);
            step_4[e] = voxrti_i4_all(4 * step);
        }
        depth_i = -t->n[u] * sign * size;
        depth_k = -t->n[w] * sign * size;
        depth0 = t->p[0][a] * na - (t->n[u] * (lo[0] * size + half - t->p[0][u]) +
                                    t->n[w] * (lo[1] * size + half - t->p[0][w])) * sign;
        inv_div = 1.0 / (double)div;
        inv = voxrti_f4_all((float)((double)size * inv_div));
        weight = tiny ? 1 : voxrti_weight((double)na / t->length);
        for (k = lo[1]; k <= hi[1]; k++) {
            voxrti_i4 e0 = voxrti_i4_add(voxrti_i4_all(at[0]), lane[0]);
            voxrti_i4 e1 = voxrti_i4_add(voxrti_i4_all(at[1]), lane[1]);
            voxrti_i4 e2 = voxrti_i4_add(voxrti_i4_all(at[2]), lane[2]);
            for (i = lo[0]; i <= hi[0]; i += 4) {
                uint32_t m = 15u & ~voxrti_i4_signs(voxrti_i4_or(voxrti_i4_or(e0, e1), e2));
                if (hi[0] - i < 3) m &= (2u << (hi[0] - i)) - 1u;
                if (m != 0) {
                    float b1[4], b2[4];
                    voxrti_f4_store(b1, voxrti_f4_mul(voxrti_i4_float(e2), inv));
                    voxrti_f4_store(b2, voxrti_f4_mul(voxrti_i4_float(e0), inv));
                    any++;
                    for (; m != 0; m &= m - 1) {
                        const uint32_t j = voxrti_ctz64(m);
                        const int64_t depth = depth0 + (i - lo[0] + (int32_t)j) * depth_i;
                        int64_t q = (int64_t)((double)depth * inv_div), r = depth - q * div;
                        voxrti_f4 f1, f2, c, n;
                        uint32_t cell;
                        q += r < 0 ? -1 : r >= div ? 1 : 0;
                        if (q == limit && depth == limit * div) q--; /* on the far face of the grid */
                        if (q < (int64_t)b->lo[a] || q >= (int64_t)(b->lo[a] + b->size) || q >= limit) continue;
                        cell = v->spread[(uint32_t)q - b->lo[a]] << a | v->spread[(uint32_t)i + j - b->lo[u]] << u |
                               v->spread[(uint32_t)k - b->lo[w]] << w;
                        b->mask[cell >> 6] |= (uint64_t)1 << (cell & 63u);
                        f1 = voxrti_f4_all(b1[j]);
                        f2 = voxrti_f4_all(b2[j]);
                        c = voxrti_f4_add(voxrti_f4_mul(f1, rgb[1]), voxrti_f4_mul(f2, rgb[2]));
                        n = voxrti_f4_add(voxrti_f4_mul(f1, normal[1]), voxrti_f4_mul(f2, normal[2]));
                        c = voxrti_f4_min(voxrti_f4_max(voxrti_f4_add(rgb[0], c), rgb_lo), rgb_hi);
                        n = voxrti_f4_min(voxrti_f4_max(voxrti_f4_add(normal[0], n), normal_lo), normal_hi);
                        voxrti_fragment(b, cell, weight, c, n);
                    }
                }
                e0 = voxrti_i4_add(e0, step_4[0]);
                e1 = voxrti_i4_add(e1, step_4[1]);
                e2 = voxrti_i4_add(e2, step_4[2]);
            }
            for (e = 0; e < 3; e++) at[e] += step_k[e];
            depth0 += depth_k;
        }
    }
    return any;
}

/* Is the triangle below 2^14 units in extent? */
VOXRTI_INLINE int voxrti_tri_short(const voxrti_tri *t) {
    uint32_t a;
    uint64_t far_off = 0;
    for (a = 0; a < 3; a++) { /* differences of three numbers are below 2^14 if those to one of them are below 2^13 */
        far_off |= (uint64_t)(t->p[1][a] - t->p[0][a] + 8192);
        far_off |= (uint64_t)(t->p[2][a] - t->p[0][a] + 8192);
    }
    return far_off < 16384;
}

/* Less than a voxel long on each axis. */
VOXRTI_INLINE int voxrti_tri_inside_voxel(const voxrti_vox *v, const voxrti_tri *t) {
    const int64_t size = (int64_t)1 << v->sub;
    uint32_t a;
    int64_t over = 0;
    for (a = 0; a < 3; a++) { /* negative where a difference is not below the size */
        int64_t x = t->p[1][a] - t->p[0][a], y = t->p[2][a] - t->p[0][a], z = y - x;
        over |= (size - 1 - x) | (size - 1 + x) | (size - 1 - y) | (size - 1 + y) | (size - 1 - z) | (size - 1 + z);
    }
    return over >= 0;
}

/* Targets stand for about a voxel face of area each. That is right for triangles of many targets, and for smaller ones
   in the mean, but those in a voxel are few. So triangles that are shorter than a voxel count by their area: a third of
   it at each of three points, exact for what is linear. */
static void voxrti_tri_points(voxrti_brick *b, const voxrti_tri *t) {
    const voxrti_vox *v = b->v;
    const int64_t limit = (int64_t)v->grid->resolution;
    const uint32_t weight = (uint32_t)(VOXRTI_WEIGHT / 3.0 * t->area + 0.5);
    uint32_t e, a;
    for (e = 0; e < 3 && weight != 0; e++) {
        const uint32_t e1 = (e + 1) % 3, e2 = (e + 2) % 3;
        uint32_t c[3], inside = 1;
        float f[VOXRTI_CHANNELS];
        for (a = 0; a < 3; a++) {
            int64_t x = ((4 * t->p[e][a] + t->p[e1][a] + t->p[e2][a]) / 6) >> v->sub;
            if (x == limit) x--;
            inside &= x >= (int64_t)b->lo[a] && x < (int64_t)(b->lo[a] + b->size) && x < limit;
            c[a] = (uint32_t)(x < 0 ? 0 : x);
        }
        if (!inside) continue;
        for (a = 0; a < VOXRTI_CHANNELS; a++)
            f[a] = (4.0f * t->attr[e][a] + t->attr[e1][a] + t->attr[e2][a]) * (1.0f / 6.0f);
        voxrti_fragment_attr(b, voxrti_brick_cell(b, c), weight, f);
    }
}

static void voxrti_tri_mean(const voxrti_tri *t, float f[VOXRTI_CHANNELS]) {
    uint32_t c;
    for (c = 0; c < VOXRTI_CHANNELS; c++) f[c] = (t->attr[0][c] + t->attr[1][c] + t->attr[2][c]) / 3.0f;
}

/* A long triangle that is less than a voxel wide may catch a target only now and then. */
static int voxrti_tri_sliver(const voxrti_vox *v, const voxrti_tri *t) {
    double longest = 0, units = (double)((uint64_t)1 << (2 * v->sub));
    uint32_t e, a;
    for (e = 0; e < 3; e++) {
        double l = 0;
        for (a = 0; a < 3; a++) {
            double d = (double)(t->p[e == 2 ? 0 : e + 1][a] - t->p[e][a]);
            l += d * d;
        }
        longest = voxrti_max(longest, l);
    }
    return longest > 4.0 * units && t->length * t->length < longest * units; /* 2 area < longest edge */
}

/* A triangle that caught no target anywhere, or a sliver: its attributes go to the voxels along its longest edge and at
   the third corner, which are remembered as tiny. counted: they have been added where its area is, or at its targets;
   here they hardly count. */
static void voxrti_tri_tiny(voxrti_brick *b, const voxrti_tri *t, int counted) {
    const voxrti_vox *v = b->v;
    uint32_t e, a, best = 0, main_axis = 0, points;
    int64_t longest = -1, steps = 1, from = 0, to, j;
    uint32_t weight;
    float f[VOXRTI_CHANNELS];
    for (e = 0; e < 3; e++) {
        int64_t l = 0, m = 0;
        uint32_t k = 0;
        for (a = 0; a < 3; a++) {
            int64_t d = t->p[(e + 1) % 3][a] - t->p[e][a];
            d = d < 0 ? -d : d;
            l += d;
            if (d > m) {
                m = d;
                k = a;
            }
        }
        if (l > longest) {
            longest = l;
            best = e;
            main_axis = k;
            steps = (m * 2 >> v->sub) + 1;
        }
    }
    points = (uint32_t)steps + 2;
    to = steps;
    {   /* the steps that can lie in this brick */
        int64_t p = t->p[best][main_axis], d = t->p[(best + 1) % 3][main_axis] - p;
        int64_t x0 = ((int64_t)b->lo[main_axis] << v->sub) - p,
                x1 = ((int64_t)(b->lo[main_axis] + b->size) << v->sub) - p;
        if (d != 0) {
            int64_t s0 = (d > 0 ? x0 : -x1) * steps / (d > 0 ? d : -d) - 1,
                    s1 = (d > 0 ? x1 : -x0) * steps / (d > 0 ? d : -d) + 1;
            from = s0 > 0 ? s0 : 0;
            to = s1 < steps ? s1 : steps;
        }
    }
    weight = counted ? 1 : voxrti_weight(t->area / (double)points);
    voxrti_tri_mean(t, f);
    for (j = from; j <= to + 1; j++) { /* the last one is the third corner */
        uint32_t c[3], cell, inside = 1;
        for (a = 0; a < 3; a++) {
            const int64_t *p = t->p[best], *q = t->p[(best + 1) % 3];
            int64_t x = j > to ? t->p[(best + 2) % 3][a] : p[a] + (q[a] - p[a]) * j / steps;
            x >>= v->sub;
            if (x == (int64_t)v->grid->resolution) x--;
            inside &= x >= (int64_t)b->lo[a] && x < (int64_t)(b->lo[a] + b->size) && x < (int64_t)v->grid->resolution;
            c[a] = (uint32_t)(x < 0 ? 0 : x);
        }
        if (!inside) continue;
        cell = voxrti_brick_cell(b, c);
        voxrti_fragment_attr(b, cell, weight, f);
        if (!voxrti_grow(v->mem, (void **)&b->tiny, &b->tiny_capacity, b->tiny_count, b->tiny_count + 1,
                         sizeof *b->tiny)) {
            b->failed = 1;
            return;
        }
        b->tiny[b->tiny_count++] = cell;
    }
}

/* All voxels of the brick that the closed triangle touches (separating axes, Schwarz & Seidel 2010), row by row. */
static void voxrti_raster_26(voxrti_brick *b, const voxrti_tri *t, uint32_t weight) {
    const voxrti_vox *v = b->v;
    int64_t size = (int64_t)1 << v->sub, lo[3], hi[3], y, z, x, limit = (int64_t)v->grid->resolution;
    uint32_t a, e, main_axis = 0, u, w;
    voxrti_ramp ramp;
    for (a = 0; a < 3; a++) {
        lo[a] = hi[a] = t->p[0][a];
        for (e = 1; e < 3; e++) {
            if (t->p[e][a] < lo[a]) lo[a] = t->p[e][a];
            if (t->p[e][a] > hi[a]) hi[a] = t->p[e][a];
        }
        lo[a] = (lo[a] - 1) >> v->sub; /* closed: a face that is touched counts */
        hi[a] = hi[a] >> v->sub;
        if (lo[a] < (int64_t)b->lo[a]) lo[a] = (int64_t)b->lo[a];
        if (hi[a] > (int64_t)(b->lo[a] + b->size) - 1) hi[a] = (int64_t)(b->lo[a] + b->size) - 1;
        if (hi[a] > limit - 1) hi[a] = limit - 1;
        if ((t->n[a] < 0 ? -t->n[a] : t->n[a]) > (t->n[main_axis] < 0 ? -t->n[main_axis] : t->n[main_axis]))
            main_axis = a;
    }
    u = (main_axis + 1) % 3;
    w = (main_axis + 2) % 3;
    voxrti_ramp_make(b, t, main_axis, &ramp);
    for (z = lo[2]; z <= hi[2]; z++) {
        for (y = lo[1]; y <= hi[1]; y++) {
            int64_t i0 = lo[0], i1 = hi[0], c[3], plane, step = t->n[0] * size, reach[2] = {0, 0};
            uint32_t pair;
            c[0] = 0;
            c[1] = y * size;
            c[2] = z * size;
            /* plane: largest value over the cube >= 0 >= smallest */
            plane = 0;
            for (a = 0; a < 3; a++) {
                plane += t->n[a] * (c[a] - t->p[0][a]);
                reach[t->n[a] > 0] += t->n[a] * size;
            }
            voxrti_row_clip(plane + reach[1], step, step != 0 ? 1.0 / (double)step : 0.0, &i0, &i1);
            voxrti_row_clip(-plane - reach[0], -step, step != 0 ? -1.0 / (double)step : 0.0, &i0, &i1);
            for (pair = 0; pair < 3 && i0 <= i1; pair++) { /* projections along x, y, z */
                uint32_t pu = (pair + 1) % 3, pw = (pair + 2) % 3;
                int64_t sign = t->n[pair] < 0 ? -1 : 1;
                for (e = 0; e < 3; e++) {
                    const int64_t *p = t->p[e], *q = t->p[(e + 1) % 3];
                    int64_t eu = -(q[pw] - p[pw]) * sign, ew = (q[pu] - p[pu]) * sign, at, si;
                    at = eu * (c[pu] - p[pu]) + ew * (c[pw] - p[pw]);
                    at += (eu > 0 ? eu * size : 0) + (ew > 0 ? ew * size : 0);
                    si = pair == 0 ? 0 : (pu == 0 ? eu : ew) * size;
                    voxrti_row_clip(at, si, si != 0 ? 1.0 / (double)si : 0.0, &i0, &i1);
                }
            }
            for (x = i0; x <= i1; x++) {
                uint32_t cc[3], cell;
                float f[VOXRTI_CHANNELS], i, k;
                cc[0] = (uint32_t)x;
                cc[1] = (uint32_t)y;
                cc[2] = (uint32_t)z;
                cell = voxrti_brick_cell(b, cc);
                b->mask[cell >> 6] |= (uint64_t)1 << (cell & 63u);
                i = (float)(cc[u] - b->lo[u]);
                k = (float)(cc[w] - b->lo[w]);
                for (e = 0; e < VOXRTI_CHANNELS; e++)
                    f[e] = voxrti_ramp_limit(&ramp, e, ramp.at[e] + k * ramp.dk[e] + i * ramp.di[e]);
                voxrti_fragment_attr(b, cell, weight, f);
            }
        }
    }
}

/* The thesis' scan converter (3.1.3): two nested loops along the longest edge and at right angles to it. Has gaps. */
static void voxrti_raster_thesis(voxrti_brick *b, const voxrti_tri *t) {
    const voxrti_vox *v = b->v;
    double s = 1.0 / (double)((uint32_t)1 << v->sub), p[3], q[3], dp[3], dq[3], best = 0, f, h, len, mp = 0, mq = 0,
           tiny;
    double vertex[3][3], lp, lq;
    uint32_t e, a, k = 0, c;
    for (e = 0; e < 3; e++) {
        double l = 0;
        for (a = 0; a < 3; a++) {
            double d = (double)(t->p[(e + 1) % 3][a] - t->p[e][a]);
            l += d * d;
        }
        if (l > best) {
            best = l;
            k = e;
        }
    }
    for (e = 0; e < 3; e++)
        for (a = 0; a < 3; a++) vertex[e][a] = (double)t->p[(k + e) % 3][a] * s;
    tiny = 1e-6 * (double)v->grid->resolution;
    len = sqrt(best) * s;
    f = 0;
    for (a = 0; a < 3; a++) {
        p[a] = vertex[1][a] - vertex[0][a];
        mp = voxrti_max(mp, voxrti_abs(p[a]));
        f += (vertex[2][a] - vertex[0][a]) * p[a];
    }
    f = len > 0 ? f / len : 0;
    h = 0;
    for (a = 0; a < 3; a++) {
        q[a] = vertex[2][a] - vertex[0][a] - (len > 0 ? p[a] * f / len : 0);
        mq = voxrti_max(mq, voxrti_abs(q[a]));
        h += q[a] * q[a];
    }
    h = sqrt(h);
    for (a = 0; a < 3; a++) {
        dp[a] = mp > 0 ? p[a] / mp : 0;
        dq[a] = mq > 0 ? q[a] / mq : 0;
    }
    lp = sqrt(dp[0] * dp[0] + dp[1] * dp[1] + dp[2] * dp[2]);
    lq = sqrt(dq[0] * dq[0] + dq[1] * dq[1] + dq[2] * dq[2]);
    {
        uint32_t n = len < tiny ? 0 : (uint32_t)(len / lp), i, j;
        for (i = 0; i <= n; i++) {
            double along = (double)i * lp, lam1 = f > 0 ? h * along / f : h,
                   lam2 = len - f > 0 ? h * (len - along) / (len - f) : h;
            double lam = voxrti_min(lam1, lam2);
            uint32_t m = h < 1e-6 || lq <= 0 || !(lam > 0) ? 0 : (uint32_t)(lam / lq);
            double from = 0, to = (double)m; /* steps that can lie in this brick: one of dq's components is 1 */
            for (a = 0; a < 3; a++) {
                double x = (double)b->lo[a] - vertex[0][a] - (double)i * dp[a];
                if (voxrti_abs(dq[a]) < 0.999) continue;
                x = dq[a] > 0 ? x : -x - (double)b->size;
                from = voxrti_max(from, x - 2.0);
                to = voxrti_min(to, x + (double)b->size + 2.0);
            }
            for (j = (uint32_t)from; (double)j <= to; j++) {
                uint32_t cc[3], inside = 1;
                double b2, b1, b0, across = (double)j * lq;
                float attr[VOXRTI_CHANNELS];
                for (a = 0; a < 3; a++) {
                    int64_t x = voxrti_floor(vertex[0][a] + (double)i * dp[a] + (double)j * dq[a]);
                    inside &=
                        x >= (int64_t)b->lo[a] && x < (int64_t)(b->lo[a] + b->size) && x < (int64_t)v->grid->resolution;
                    cc[a] = (uint32_t)(x < 0 ? 0 : x);
                }
                if (!inside) continue;
                b2 = h > 0 ? across / h : 0;
                b1 = len > 0 ? (along - f * b2) / len : 0;
                b0 = 1 - b1 - b2;
                for (c = 0; c < VOXRTI_CHANNELS; c++)
                    attr[c] = (float)(b0 * (double)t->attr[k][c] + b1 * (double)t->attr[(k + 1) % 3][c] +
                                      b2 * (double)t->attr[(k + 2) % 3][c]);
                e = voxrti_brick_cell(b, cc);
                b->mask[e >> 6] |= (uint64_t)1 << (e & 63u);
                voxrti_fragment_attr(b, e, (uint32_t)VOXRTI_WEIGHT, attr);
            }
        }
    }
}

static void voxrti_brick_tri(void *ctx, const voxrti_tri *t, size_t i) {
    voxrti_brick *b = (voxrti_brick *)ctx;
    uint64_t found = 0;
    uint32_t a;
    int cut = 1, tiny;
    (void)i;
    if (b->failed) return;
    if (b->v->d->separating == VOXRT_SEPARATING_THESIS) {
        voxrti_raster_thesis(b, t);
        return;
    }
    tiny = voxrti_tri_inside_voxel(b->v, t);
    if (tiny) voxrti_tri_points(b, t);
    if (voxrti_tri_short(t)) found = voxrti_raster_short(b, t, tiny, &cut);
    else for (a = 0; a < 3; a++) found += voxrti_raster_axis(b, t, a, 1);
    for (a = 0; a < 3 && found == 0 && cut; a++) found += voxrti_raster_axis(b, t, a, 0);
    if (b->v->d->separating == VOXRT_SEPARATING_26)
        voxrti_raster_26(b, t, found == 0 && !tiny ? voxrti_weight(0.25 * t->area) : 1);
    else if (found == 0 || voxrti_tri_sliver(b->v, t))
        voxrti_tri_tiny(b, t, found != 0 || tiny);
}

/* ---- bricks ---- */

/* Voxels that only tiny triangles touch are filled where nothing else is near: no sliver or wire vanishes, and dense
   meshes do not get thicker. Decided by the targets alone. */
static void voxrti_brick_tiny(voxrti_brick *b) {
    size_t i, keep = 0;
    for (i = 0; i < b->tiny_count; i++) {
        uint32_t x = voxrti_compact3(b->tiny[i]), y = voxrti_compact3(b->tiny[i] >> 1),
                 z = voxrti_compact3(b->tiny[i] >> 2);
        const uint32_t *spread = b->v->spread;
        uint32_t k, any = (uint32_t)(b->mask[b->tiny[i] >> 6] >> (b->tiny[i] & 63u) & 1u);
        for (k = 0; k < 27 && !any; k++) {
            uint32_t nx = x + k % 3 - 1, ny = y + k / 3 % 3 - 1, nz = z + k / 9 - 1, cell;
            if (nx >= b->size || ny >= b->size || nz >= b->size) continue; /* beyond the brick: as if empty */
            cell = spread[nx] | spread[ny] << 1 | spread[nz] << 2;
            any = (uint32_t)(b->mask[cell >> 6] >> (cell & 63u) & 1u);
        }
        if (!any) b->tiny[keep++] = b->tiny[i];
    }
    for (i = 0; i < keep; i++) b->mask[b->tiny[i] >> 6] |= (uint64_t)1 << (b->tiny[i] & 63u);
    b->tiny_count = 0;
}

VOXRTI_INLINE uint32_t voxrti_fragsum_rgb(const voxrti_vox *v, const voxrti_fragsum *s, double inv) {
    return (uint32_t)v->to_srgb[(int32_t)((double)(int64_t)s->s[VOXRTI_SUM_R] * inv + 0.5)] |
           (uint32_t)v->to_srgb[(int32_t)((double)(int64_t)s->s[VOXRTI_SUM_G] * inv + 0.5)] << 8 |
           (uint32_t)v->to_srgb[(int32_t)((double)(int64_t)s->s[VOXRTI_SUM_B] * inv + 0.5)] << 16;
}

VOXRTI_INLINE uint16_t voxrti_fragsum_normal(const voxrti_fragsum *s, double inv) {
    float n[3];
    n[0] = (float)((double)(int64_t)s->s[VOXRTI_SUM_X] * inv - 32768.0);
    n[1] = (float)((double)(int64_t)s->s[VOXRTI_SUM_Y] * inv - 32768.0);
    n[2] = (float)((double)(int64_t)s->s[VOXRTI_SUM_Z] * inv - 32768.0);
    if (n[0] == 0 && n[1] == 0 && n[2] == 0) n[2] = 1.0f; /* opposite normals cancelled */
    return (uint16_t)voxrti_oct_encode(n);
}

/* Emit the brick's voxels behind `out` and clear the brick for the next one. */
static int voxrti_brick_emit(voxrti_brick *b, uint64_t brick, voxrti_leafset *out, size_t capacity[4]) {
    voxrti_vox *v = b->v;
    uint32_t blocks = 1u << (3 * v->brick_bits - 6), i;
    size_t nb = 0, nv = 0, k;
    for (i = 0; i < blocks; i++) {
        nb += b->mask[i] != 0;
        nv += voxrti_popcount64(b->mask[i]);
    }
    if (!voxrti_grow(v->mem, (void **)&out->key, &capacity[0], out->block_count, out->block_count + nb, 8) ||
        !voxrti_grow(v->mem, (void **)&out->mask, &capacity[1], out->block_count, out->block_count + nb, 8) ||
        (v->has_rgb &&
         !voxrti_grow(v->mem, (void **)&out->rgb, &capacity[2], out->voxel_count, out->voxel_count + nv, 4)) ||
        (v->has_normal &&
         !voxrti_grow(v->mem, (void **)&out->normal, &capacity[3], out->voxel_count, out->voxel_count + nv, 2)))
        return 0;
    for (i = 0; i < blocks; i++) {
        uint64_t m = b->mask[i];
        if (m == 0) continue;
        out->key[out->block_count] = brick << (3 * v->brick_bits - 6) | i;
        out->mask[out->block_count++] = m;
        for (; m != 0; m &= m - 1) {
            const voxrti_fragsum *s = &b->sum[b->slot[i * 64 + voxrti_ctz64(m)] - 1];
            double inv = 1.0 / (double)(int64_t)s->s[VOXRTI_SUM_WEIGHT];
            if (v->has_rgb) out->rgb[out->voxel_count] = voxrti_fragsum_rgb(v, s, inv);
            if (v->has_normal) out->normal[out->voxel_count] = voxrti_fragsum_normal(s, inv);
            out->voxel_count++;
        }
        b->mask[i] = 0;
    }
    for (k = 0; k < b->sum_count; k++) b->slot[b->cell[k]] = 0;
    b->sum_count = 0;
    return 1;
}

static void voxrti_brick_task(void *ctx, uint32_t index) {
    voxrti_vox *v = (voxrti_vox *)ctx;
    uint32_t task = v->first_task + index;
    size_t i = v->task_first[task], end = v->task_first[task + 1], cells = (size_t)1 << (3 * v->brick_bits);
    size_t capacity[4] = {0, 0, 0, 0};
    voxrti_brick b;
    int ok = voxrti_atomic_load(&v->failed) == 0;
    memset(&b, 0, sizeof b);
    b.v = v;
    b.size = 1u << v->brick_bits;
    if (ok) {
        b.mask = (uint64_t *)voxrti_alloc_zero(v->mem, cells / 64, sizeof(uint64_t));
        b.slot = (uint32_t *)voxrti_alloc_zero(v->mem, cells, sizeof(uint32_t));
        ok = b.mask != NULL && b.slot != NULL;
    }
    while (ok && i < end) {
        uint64_t brick = v->ref[i] >> 32, last = ~(uint64_t)0;
        b.lo[0] = voxrti_compact3(brick) << v->brick_bits;
        b.lo[1] = voxrti_compact3(brick >> 1) << v->brick_bits;
        b.lo[2] = voxrti_compact3(brick >> 2) << v->brick_bits;
        for (; i < end && v->ref[i] >> 32 == brick && !b.failed; i++) {
            if (v->ref[i] == last) continue; /* another piece of a clipped triangle */
            last = v->ref[i];
            (void)voxrti_tri_each(v, (size_t)(last & 0xffffffffu), 1, voxrti_brick_tri, &b);
        }
        if (!b.failed && b.tiny_count != 0) voxrti_brick_tiny(&b);
        ok = !b.failed && voxrti_brick_emit(&b, brick, &v->out[task], capacity);
    }
    voxrti_free(v->mem, b.mask);
    voxrti_free(v->mem, b.slot);
    voxrti_free(v->mem, b.sum);
    voxrti_free(v->mem, b.cell);
    voxrti_free(v->mem, b.tiny);
    voxrti_tally_add(v->fragments, b.fragments);
    if (!ok) voxrti_atomic_store(&v->failed, 1u);
}

static void voxrti_join_task(void *ctx, uint32_t task) {
    voxrti_vox *v = (voxrti_vox *)ctx;
    voxrti_leafset *s = &v->out[task], *out = v->joined;
    size_t block = v->out_first[2 * task], voxel = v->out_first[2 * task + 1];
    if (s->block_count != 0) {
        memcpy(out->key + block, s->key, s->block_count * 8);
        memcpy(out->mask + block, s->mask, s->block_count * 8);
        if (v->has_rgb) memcpy(out->rgb + voxel, s->rgb, s->voxel_count * 4);
        if (v->has_normal) memcpy(out->normal + voxel, s->normal, s->voxel_count * 2);
    }
    voxrti_leafset_free(v->mem, s);
}

/* Put the tasks' results one after the other. */
static voxrt_result voxrti_leafset_join(voxrti_vox *v, uint32_t tasks, voxrti_leafset *out) {
    uint32_t i;
    v->joined = out;
    v->out_first = (size_t *)voxrti_alloc_array(v->mem, tasks, 2 * sizeof(size_t));
    if (v->out_first == NULL) return VOXRT_ERR_NO_MEMORY;
    for (i = 0; i < tasks; i++) {
        v->out_first[2 * i] = out->block_count;
        v->out_first[2 * i + 1] = out->voxel_count;
        out->block_count += v->out[i].block_count;
        out->voxel_count += v->out[i].voxel_count;
    }
    out->key = (uint64_t *)voxrti_alloc_array(v->mem, out->block_count + 1, sizeof(uint64_t));
    out->mask = (uint64_t *)voxrti_alloc_array(v->mem, out->block_count + 1, sizeof(uint64_t));
    if (v->has_rgb) out->rgb = (uint32_t *)voxrti_alloc_array(v->mem, out->voxel_count + 1, 4);
    if (v->has_normal) out->normal = (uint16_t *)voxrti_alloc_array(v->mem, out->voxel_count + 1, 2);
    if (out->key == NULL || out->mask == NULL || (v->has_rgb && out->rgb == NULL) ||
        (v->has_normal && out->normal == NULL))
        return VOXRT_ERR_NO_MEMORY;
    voxrti_parallel_for(&v->d->env, voxrti_join_task, v, tasks);
    return VOXRT_OK;
}

#define VOXRTI_VOX_BATCH 32u /* tasks between two calls of progress_fn: some ten milliseconds */

static voxrt_result voxrti_voxelize_run(voxrti_vox *v, voxrt_build_stats *stats, voxrti_leafset *out) {
    size_t i, target;
    uint32_t tasks = 0, k, batch;
    voxrt_result r = voxrti_bin_all(v, stats);
    if (r != VOXRT_OK) return r;
    v->task_first = (size_t *)voxrti_alloc_array(v->mem, v->ref_count / 512 + 4, sizeof(size_t));
    if (v->task_first == NULL) return VOXRT_ERR_NO_MEMORY;
    v->task_first[0] = 0;
    for (i = 0, target = 1024; i < v->ref_count; i++) { /* about 1024 refs a task, whole bricks */
        if (i >= target && v->ref[i] >> 32 != v->ref[i - 1] >> 32) {
            v->task_first[++tasks] = i;
            target = i + 1024;
        }
    }
    v->task_first[++tasks] = v->ref_count;
    v->out = (voxrti_leafset *)voxrti_alloc_zero(v->mem, tasks, sizeof *v->out);
    if (v->out == NULL) return VOXRT_ERR_NO_MEMORY;
    batch = v->d->env.progress_fn != NULL ? VOXRTI_VOX_BATCH : tasks;
    for (k = 0; k < tasks && r == VOXRT_OK; k += batch) {
        v->first_task = k;
        voxrti_parallel_for(&v->d->env, voxrti_brick_task, v, tasks - k < batch ? tasks - k : batch);
        if (voxrti_atomic_load(&v->failed)) r = VOXRT_ERR_NO_MEMORY;
        else if (v->d->env.progress_fn != NULL &&
                 v->d->env.progress_fn(v->d->env.progress_user, k + batch < tasks ? k + batch : tasks, tasks) != 0)
            r = VOXRT_ERR_CANCELLED;
    }
    voxrti_free(v->mem, v->ref);
    v->ref = NULL;
    if (r == VOXRT_OK) r = voxrti_leafset_join(v, tasks, out);
    for (k = 0; k < tasks; k++) voxrti_leafset_free(v->mem, &v->out[k]);
    return r;
}

static VOXRTI_UNUSED voxrt_result voxrti_voxelize(voxrti_mem *mem, const voxrt_build_desc *d, const voxrt_mesh *mesh,
                                                  const voxrti_grid *grid, voxrt_build_stats *stats,
                                                  voxrti_leafset *out) {
    voxrti_vox v;
    voxrt_result r = VOXRT_OK;
    uint32_t i, c;
    memset(&v, 0, sizeof v);
    memset(out, 0, sizeof *out);
    stats->triangles = mesh->triangle_count;
    if (mesh->triangle_count >= 0xffffffffu) return VOXRT_ERR_RANGE;
    v.mem = mem;
    v.d = d;
    v.mesh = mesh;
    v.grid = grid;
    v.sub = 20 - grid->depth < 8 ? 20 - grid->depth : 8;
    v.brick_bits = grid->depth > 15 ? 6 : 5;
    v.has_rgb = !d->disable_colors && (mesh->triangle_rgb != NULL || mesh->vertex_rgb != NULL);
    v.has_normal = !d->disable_normals;
    voxrti_srgb_table(v.srgb);
    v.to_srgb = (uint8_t *)voxrti_alloc(mem, 65537);
    if (v.to_srgb == NULL) return VOXRT_ERR_NO_MEMORY;
    for (i = 0, c = 0; i < 65536; i++) { /* voxrti_srgb_find of each */
        while (c < 255 && v.srgb[c + 1] <= i) c++;
        v.to_srgb[i] = (uint8_t)(c + (c < 255 && v.srgb[c + 1] - i < i - v.srgb[c]));
    }
    v.to_srgb[65536] = 255;
    for (i = 0; i < 64; i++) v.spread[i] = (uint32_t)voxrti_spread3(i);
    r = voxrti_voxelize_run(&v, stats, out);
    if (r != VOXRT_OK) voxrti_leafset_free(mem, out);
    stats->fragments = voxrti_tally(v.fragments);
    stats->voxels = out->voxel_count;
    voxrti_free(mem, v.to_srgb);
    for (i = 0; v.bin != NULL && i < v.bin_count; i++) voxrti_free(mem, v.bin[i].ref);
    voxrti_free(mem, v.bin);
    voxrti_free(mem, v.out_first);
    voxrti_free(mem, v.ref);
    voxrti_free(mem, v.task_first);
    voxrti_free(mem, v.out);
    return r;
}

/* ---- lists of voxels ---- */

typedef struct voxrti_keyed { uint64_t key; uint32_t index; } voxrti_keyed;

static void voxrti_keyed_sort(voxrti_keyed *a, voxrti_keyed *tmp, size_t n, uint32_t bits) {
    size_t count[1024], i, sum, c;
    voxrti_keyed *from = a, *to = tmp, *x;
    uint32_t shift;
    for (shift = 0; shift < bits; shift += 10) {
        memset(count, 0, sizeof count);
        for (i = 0; i < n; i++) count[from[i].key >> shift & 1023u]++;
        for (i = 0, sum = 0; i < 1024; i++) {
            c = count[i];
            count[i] = sum;
            sum += c;
        }
        for (i = 0; i < n; i++) to[count[from[i].key >> shift & 1023u]++] = from[i];
        x = from;
        from = to;
        to = x;
    }
    if (from != a) memcpy(a, from, n * sizeof *a);
}

static VOXRTI_UNUSED voxrt_result voxrti_leafset_from_voxels(voxrti_mem *mem, const voxrt_build_desc *d,
                                                             const voxrt_voxel *list, size_t n, uint32_t depth,
                                                             voxrti_leafset *out) {
    voxrti_keyed *a = NULL, *tmp = NULL;
    uint32_t srgb[256], any_normal = 0, limit = (uint32_t)1 << depth;
    size_t i, k, blocks = 0, voxels = 0;
    int ok;
    memset(out, 0, sizeof *out);
    if (n >= 0xffffffffu) return voxrti_fail(d->env.error, VOXRT_ERR_RANGE, n, "% voxels are too many");
    for (i = 0; i < n; i++) {
        if (list[i].x >= limit || list[i].y >= limit || list[i].z >= limit)
            return voxrti_fail(d->env.error, VOXRT_ERR_RANGE, i, "voxel % lies outside the grid");
        any_normal |= list[i].has_normal;
    }
    a = (voxrti_keyed *)voxrti_alloc_array(mem, n + 1, sizeof *a);
    tmp = (voxrti_keyed *)voxrti_alloc_array(mem, n + 1, sizeof *tmp);
    ok = a != NULL && tmp != NULL;
    if (ok) {
        for (i = 0; i < n; i++) {
            a[i].key = voxrti_morton(list[i].x, list[i].y, list[i].z);
            a[i].index = (uint32_t)i;
        }
        voxrti_keyed_sort(a, tmp, n, 3 * depth);
        for (i = 0; i < n; i++) {
            voxels += i == 0 || a[i].key != a[i - 1].key;
            blocks += i == 0 || a[i].key >> 6 != a[i - 1].key >> 6;
        }
    }
    voxrti_free(mem, tmp);
    if (ok) {
        out->key = (uint64_t *)voxrti_alloc_array(mem, blocks + 1, 8);
        out->mask = (uint64_t *)voxrti_alloc_array(mem, blocks + 1, 8);
        if (!d->disable_colors) out->rgb = (uint32_t *)voxrti_alloc_array(mem, voxels + 1, 4);
        if (!d->disable_normals && any_normal) out->normal = (uint16_t *)voxrti_alloc_array(mem, voxels + 1, 2);
        ok = out->key != NULL && out->mask != NULL && (d->disable_colors || out->rgb != NULL) &&
             (d->disable_normals || !any_normal || out->normal != NULL);
    }
    voxrti_srgb_table(srgb);
    for (i = 0; ok && i < n; i = k) {
        uint64_t sum[3] = {0, 0, 0}, c;
        double m[3] = {0, 0, 0};
        uint32_t x;
        if (out->block_count == 0 || out->key[out->block_count - 1] != a[i].key >> 6) {
            out->key[out->block_count] = a[i].key >> 6;
            out->mask[out->block_count++] = 0;
        }
        out->mask[out->block_count - 1] |= (uint64_t)1 << (a[i].key & 63u);
        for (k = i; k < n && a[k].key == a[i].key; k++) {
            const voxrt_voxel *e = &list[a[k].index];
            for (x = 0; x < 3; x++) {
                sum[x] += srgb[e->rgb[x]];
                if (e->has_normal && voxrti_finite_f(e->normal[x])) /* integers: the order does not matter */
                    m[x] += (double)voxrti_floor(voxrti_min(voxrti_max((double)e->normal[x], -1e6), 1e6) * 16384.0);
            }
        }
        c = k - i;
        if (out->rgb != NULL)
            out->rgb[out->voxel_count] = voxrti_srgb_find(srgb, (uint32_t)((sum[0] + c / 2) / c)) |
                                         voxrti_srgb_find(srgb, (uint32_t)((sum[1] + c / 2) / c)) << 8 |
                                         voxrti_srgb_find(srgb, (uint32_t)((sum[2] + c / 2) / c)) << 16;
        if (out->normal != NULL) {
            float f[3];
            for (x = 0; x < 3; x++)
                f[x] = k - i == 1 && list[a[i].index].has_normal ? list[a[i].index].normal[x] : (float)m[x];
            if (!voxrti_normalize(f)) {
                f[0] = f[1] = 0;
                f[2] = 1;
            }
            out->normal[out->voxel_count] = (uint16_t)voxrti_oct_encode(f);
        }
        out->voxel_count++;
    }
    voxrti_free(mem, a);
    if (!ok) {
        voxrti_leafset_free(mem, out);
        return voxrti_fail(d->env.error, VOXRT_ERR_NO_MEMORY, 0, "out of memory");
    }
    return VOXRT_OK;
}

/* ---------------------------------------------------------------------------
   fill: the inside of closed hulls.                                             // >>fill
   Outside is what a 6-connected walk through empty cells reaches from the border of the grid; what is neither filled
   nor outside is inside. Three sizes of cell: voxels in the masks of mixed 4x4x4 blocks, empty blocks, and empty
   words of 4x4x4 blocks (16^3 voxels), all addressed by Morton code: a word of a bit set holds 64 blocks.
   20 bytes per 16^3 voxels of the grid's cube (2.5 MB at 1024^3, 168 MB at 4096^3).
   --------------------------------------------------------------------------- */

typedef struct voxrti_flood {
    voxrti_mem *mem;
    uint64_t *mixed;         /* [words] blocks with filled voxels */
    uint32_t *rank;          /* [words] mixed blocks before the word */
    uint64_t *outside;       /* [words] empty blocks that are outside */
    const uint64_t *filled;  /* [blocks] masks */
    uint64_t *reached;       /* [blocks] outside voxels of mixed blocks */
    uint64_t *queue;         /* block codes; bit 63: a whole word */
    size_t head, tail, capacity;
    uint32_t blocks;         /* blocks along an axis */
    int failed;
} voxrti_flood;

/* axis masks in a 4x4x4 mask: cells with index 0 and 3, even, and 1 */
static const uint64_t voxrti_first4[3] = {0x0055005500550055u, 0x0000333300003333u, 0x000000000f0f0f0fu};
static const uint64_t voxrti_last4[3] = {0xaa00aa00aa00aa00u, 0xcccc0000cccc0000u, 0xf0f0f0f000000000u};
static const uint64_t voxrti_even4[3] = {0x5555555555555555u, 0x3333333333333333u, 0x0f0f0f0f0f0f0f0fu};
static const uint64_t voxrti_one4[3] = {0x00aa00aa00aa00aau, 0x0000cccc0000ccccu, 0x00000000f0f0f0f0u};
static const uint64_t voxrti_two4[3] = {0x5500550055005500u, 0x3333000033330000u, 0x0f0f0f0f00000000u};

/* The cells of m and their face neighbours inside the block. */
static uint64_t voxrti_dilate4(uint64_t m) {
    uint64_t r = m;
    uint32_t a;
    for (a = 0; a < 3; a++) {
        uint32_t s = 1u << a, j = 7u << a; /* even -> odd: s; 1 -> 2: 8*s - s */
        r |= (m & voxrti_even4[a]) << s | (m & ~voxrti_even4[a]) >> s | (m & voxrti_one4[a]) << j |
             (m & voxrti_two4[a]) >> j;
    }
    return r;
}

/* Morton code of the neighbour along axis a; *inside = 0 at the border. `n`: cells along an axis. */
static uint64_t voxrti_step_code(uint64_t code, uint32_t a, int up, uint32_t n, int *inside) {
    uint32_t c[3];
    c[0] = voxrti_compact3(code);
    c[1] = voxrti_compact3(code >> 1);
    c[2] = voxrti_compact3(code >> 2);
    *inside = up ? c[a] + 1 < n : c[a] > 0;
    c[a] = up ? c[a] + 1 : c[a] - 1;
    return *inside ? voxrti_morton(c[0], c[1], c[2]) : 0;
}

static void voxrti_flood_push(voxrti_flood *f, uint64_t item) {
    if (f->head > 4096 && f->head * 2 > f->tail) { /* reuse the front */
        memmove(f->queue, f->queue + f->head, (f->tail - f->head) * sizeof *f->queue);
        f->tail -= f->head;
        f->head = 0;
    }
    if (!voxrti_grow(f->mem, (void **)&f->queue, &f->capacity, f->tail, f->tail + 1, sizeof *f->queue)) {
        f->failed = 1;
        return;
    }
    f->queue[f->tail++] = item;
}

/* Some voxels `seed` of a block are next to the outside. */
static void voxrti_flood_block(voxrti_flood *f, uint64_t code, uint64_t seed) {
    uint64_t word = code >> 6, bit = (uint64_t)1 << (code & 63u);
    if (f->mixed[word] == 0) {
        if (f->outside[word] == 0) {
            f->outside[word] = ~(uint64_t)0;
            voxrti_flood_push(f, word << 6 | (uint64_t)1 << 63);
        }
    } else if ((f->mixed[word] & bit) == 0) {
        if ((f->outside[word] & bit) == 0) {
            f->outside[word] |= bit;
            voxrti_flood_push(f, code);
        }
    } else {
        uint32_t i = f->rank[word] + voxrti_popcount64(f->mixed[word] & (bit - 1));
        uint64_t open = ~f->filled[i], old = f->reached[i], now = old | (seed & open), next;
        while ((next = voxrti_dilate4(now) & open) != now) now = next;
        if (now != old) {
            f->reached[i] = now;
            voxrti_flood_push(f, code);
        }
    }
}

static void voxrti_flood_run(voxrti_flood *f) {
    while (f->head < f->tail && !f->failed) {
        uint64_t item = f->queue[f->head++], code = item & ~((uint64_t)1 << 63), word = code >> 6, k;
        uint32_t a, up;
        int inside;
        if (item >> 63) { /* an empty word: to the six words around it */
            for (a = 0; a < 3; a++) {
                for (up = 0; up < 2; up++) {
                    uint64_t w = voxrti_step_code(word, a, (int)up, f->blocks / 4, &inside), face;
                    if (!inside) continue;
                    if (f->mixed[w] == 0) {
                        voxrti_flood_block(f, w << 6, 0);
                        continue;
                    }
                    face = up ? voxrti_first4[a] : voxrti_last4[a]; /* its blocks that touch */
                    for (k = face; k != 0; k &= k - 1)
                        voxrti_flood_block(f, w << 6 | voxrti_ctz64(k), face);
                }
            }
            continue;
        }
        {
            uint64_t bit = (uint64_t)1 << (code & 63u), e = ~(uint64_t)0;
            if (f->mixed[word] & bit) e = f->reached[f->rank[word] + voxrti_popcount64(f->mixed[word] & (bit - 1))];
            for (a = 0; a < 3; a++) {
                uint32_t shift = 9u << a;
                for (up = 0; up < 2; up++) {
                    uint64_t seed = up ? (e & voxrti_last4[a]) >> shift : (e & voxrti_first4[a]) << shift;
                    uint64_t n = voxrti_step_code(code, a, (int)up, f->blocks, &inside);
                    if (inside && seed != 0) voxrti_flood_block(f, n, seed);
                }
            }
        }
    }
}

/* Flood from the border of the grid. */
static void voxrti_flood_border(voxrti_flood *f) {
    uint32_t a, up, i, k, last = f->blocks - 1;
    for (a = 0; a < 3; a++) {
        for (up = 0; up < 2; up++) {
            for (i = 0; i <= last && !f->failed; i++) {
                for (k = 0; k <= last; k++) {
                    uint32_t c[3];
                    c[a] = up ? last : 0;
                    c[(a + 1) % 3] = i;
                    c[(a + 2) % 3] = k;
                    voxrti_flood_block(f, voxrti_morton(c[0], c[1], c[2]), up ? voxrti_last4[a] : voxrti_first4[a]);
                }
            }
            voxrti_flood_run(f);
        }
    }
}

/* ---- attributes of the inside: breadth first from the surface ---- */

typedef struct voxrti_inside {
    const uint64_t *word;   /* [words] blocks of the new set */
    const uint32_t *rank;   /* [words] */
    uint64_t *left;         /* [blocks] voxels without attributes yet */
    const uint32_t *first;  /* [blocks] rank of the block's first voxel */
    const uint64_t *mask;   /* [blocks] */
} voxrti_inside;

VOXRTI_INLINE size_t voxrti_inside_rank(const voxrti_inside *s, uint32_t block, uint32_t slot) {
    return s->first[block] + voxrti_popcount64(s->mask[block] & (((uint64_t)1 << slot) - 1));
}

/* Spread rgb and normal from voxels that have them, layer by layer; stops after `layers` (0: no limit). */
static voxrt_result voxrti_inside_spread(voxrti_mem *mem, voxrti_inside *s, const uint64_t *key, size_t blocks,
                                         uint32_t axis_blocks, uint32_t layers, voxrti_leafset *set) {
    uint64_t *front[2] = {NULL, NULL};
    size_t count[2] = {0, 0}, capacity[2] = {0, 0}, i, k;
    uint32_t a, up, cur = 0, layer = 0;
    int inside, ok = 1;
    for (i = 0; i < blocks && ok; i++) { /* surface voxels next to something inside, in their own block or beyond */
        uint64_t m = s->mask[i] & ~s->left[i];
        for (; m != 0 && ok; m &= m - 1) {
            ok = voxrti_grow(mem, (void **)&front[0], &capacity[0], count[0], count[0] + 1, sizeof(uint64_t));
            if (ok) front[0][count[0]++] = (uint64_t)i << 6 | voxrti_ctz64(m);
        }
    }
    for (; ok && count[cur] != 0 && (layers == 0 || layer < layers); layer++, cur ^= 1) {
        count[cur ^ 1] = 0;
        for (k = 0; k < count[cur] && ok; k++) {
            uint32_t block = (uint32_t)(front[cur][k] >> 6), slot = (uint32_t)(front[cur][k] & 63u);
            uint64_t code = key[block] << 6 | slot;
            for (a = 0; a < 3; a++) {
                for (up = 0; up < 2; up++) {
                    uint64_t n = voxrti_step_code(code, a, (int)up, axis_blocks * 4, &inside), w, bit;
                    uint32_t b;
                    size_t from, to;
                    if (!inside) continue;
                    w = n >> 12;
                    bit = (uint64_t)1 << (n >> 6 & 63u);
                    if ((s->word[w] & bit) == 0) continue;
                    b = s->rank[w] + voxrti_popcount64(s->word[w] & (bit - 1));
                    bit = (uint64_t)1 << (n & 63u);
                    if ((s->left[b] & bit) == 0) continue;
                    s->left[b] &= ~bit;
                    from = voxrti_inside_rank(s, block, slot);
                    to = voxrti_inside_rank(s, b, (uint32_t)(n & 63u));
                    if (set->rgb != NULL) set->rgb[to] = set->rgb[from];
                    if (set->normal != NULL) set->normal[to] = set->normal[from];
                    ok = ok && voxrti_grow(mem, (void **)&front[cur ^ 1], &capacity[cur ^ 1], count[cur ^ 1],
                                           count[cur ^ 1] + 1, sizeof(uint64_t));
                    if (ok) front[cur ^ 1][count[cur ^ 1]++] = (uint64_t)b << 6 | (n & 63u);
                }
            }
        }
    }
    voxrti_free(mem, front[0]);
    voxrti_free(mem, front[1]);
    return ok ? VOXRT_OK : VOXRT_ERR_NO_MEMORY;
}

/* Replace `set` by the set with the inside `inner` ([old blocks] masks; whole empty blocks where neither mixed nor
   outside) filled. */
static voxrt_result voxrti_fill_emit(voxrti_mem *mem, const voxrti_flood *f, size_t words, uint32_t layers,
                                     voxrti_leafset *set) {
    voxrti_leafset n;
    voxrti_inside s;
    uint64_t *word = (uint64_t *)voxrti_alloc_array(mem, words, sizeof(uint64_t));
    uint32_t *rank = (uint32_t *)voxrti_alloc_array(mem, words, sizeof(uint32_t)), *first = NULL;
    uint64_t *left = NULL;
    size_t i, k, old = 0, at = 0, from = 0;
    voxrt_result r = VOXRT_ERR_NO_MEMORY;
    memset(&n, 0, sizeof n);
    memset(&s, 0, sizeof s);
    if (word != NULL && rank != NULL) {
        for (i = 0; i < words; i++) {
            rank[i] = (uint32_t)n.block_count;
            word[i] = f->mixed[i] | ~f->outside[i];
            n.block_count += voxrti_popcount64(word[i]);
            if (n.block_count > 0xfffffff0u) r = VOXRT_ERR_RANGE;
        }
        if (r != VOXRT_ERR_RANGE) {
            n.key = (uint64_t *)voxrti_alloc_array(mem, n.block_count, sizeof(uint64_t));
            n.mask = (uint64_t *)voxrti_alloc_array(mem, n.block_count, sizeof(uint64_t));
            left = (uint64_t *)voxrti_alloc_array(mem, n.block_count, sizeof(uint64_t));
            first = (uint32_t *)voxrti_alloc_array(mem, n.block_count, sizeof(uint32_t));
            if (n.key != NULL && n.mask != NULL && left != NULL && first != NULL) r = VOXRT_OK;
        }
    }
    for (i = 0; r == VOXRT_OK && i < words; i++) {
        uint64_t m;
        for (m = word[i]; m != 0; m &= m - 1, at++) {
            uint64_t bit = m & (0u - m);
            n.key[at] = (uint64_t)i << 6 | voxrti_ctz64(m);
            if (f->mixed[i] & bit) {
                left[at] = ~(f->reached[old] | f->filled[old]);
                n.mask[at] = ~f->reached[old++];
            } else {
                left[at] = n.mask[at] = ~(uint64_t)0;
            }
            first[at] = (uint32_t)n.voxel_count;
            n.voxel_count += voxrti_popcount64(n.mask[at]);
            if (n.voxel_count > 0xfffffffeu) r = VOXRT_ERR_RANGE;
        }
    }
    if (r == VOXRT_OK && set->rgb != NULL) {
        n.rgb = (uint32_t *)voxrti_alloc_zero(mem, n.voxel_count, sizeof(uint32_t));
        if (n.rgb == NULL) r = VOXRT_ERR_NO_MEMORY;
    }
    if (r == VOXRT_OK && set->normal != NULL) {
        n.normal = (uint16_t *)voxrti_alloc_zero(mem, n.voxel_count, sizeof(uint16_t));
        if (n.normal == NULL) r = VOXRT_ERR_NO_MEMORY;
    }
    for (i = 0, k = 0; r == VOXRT_OK && i < n.block_count; i++) {
        uint64_t m;
        for (m = n.mask[i]; m != 0; m &= m - 1, k++) {
            if (left[i] & m & (0u - m)) continue;
            if (n.rgb != NULL) n.rgb[k] = set->rgb[from];
            if (n.normal != NULL) n.normal[k] = set->normal[from];
            from++;
        }
    }
    VOXRT_ASSERT(r != VOXRT_OK || from == set->voxel_count); /* each voxel that was there has found its place */
    if (r == VOXRT_OK) {
        s.word = word;
        s.rank = rank;
        s.left = left;
        s.first = first;
        s.mask = n.mask;
        r = voxrti_inside_spread(mem, &s, n.key, n.block_count, f->blocks, layers, &n);
    }
    if (r == VOXRT_OK) { /* drop what the layers did not reach */
        size_t blocks = 0, voxels = 0;
        for (i = 0, k = 0; i < n.block_count; i++) {
            uint64_t m, keep = n.mask[i] & ~left[i];
            for (m = n.mask[i]; m != 0; m &= m - 1, k++) {
                if ((keep & m & (0u - m)) == 0) continue;
                if (n.rgb != NULL) n.rgb[voxels] = n.rgb[k];
                if (n.normal != NULL) n.normal[voxels] = n.normal[k];
                voxels++;
            }
            if (keep == 0) continue;
            n.key[blocks] = n.key[i];
            n.mask[blocks++] = keep;
        }
        n.block_count = blocks;
        n.voxel_count = voxels;
        voxrti_leafset_free(mem, set);
        *set = n;
    } else {
        voxrti_leafset_free(mem, &n);
    }
    voxrti_free(mem, word);
    voxrti_free(mem, rank);
    voxrti_free(mem, left);
    voxrti_free(mem, first);
    return r;
}

/* Fill closed hulls; new voxels take the attributes of the nearest surface voxel (in steps through faces), at most
   d->fill_depth layers deep. On failure the set is unchanged. O(voxels + (2^depth/16)^3). */
static VOXRTI_UNUSED voxrt_result voxrti_leafset_fill(voxrti_mem *mem, const voxrt_build_desc *d, uint32_t depth,
                                                      voxrti_leafset *set) {
    voxrti_flood f;
    uint32_t word_bits = depth > 4 ? 3 * (depth - 4) : 0;
    size_t words, i;
    voxrt_result r = VOXRT_OK;
    if (set->block_count == 0) return VOXRT_OK;
    if (depth > 14) return voxrti_fail(d->env.error, VOXRT_ERR_RANGE, depth, "fill supports a depth of 14, not %");
    words = (size_t)1 << word_bits;
    memset(&f, 0, sizeof f);
    f.mem = mem;
    f.blocks = depth > 4 ? 1u << (depth - 2) : 4u;
    f.filled = set->mask;
    f.mixed = (uint64_t *)voxrti_alloc_zero(mem, words, sizeof(uint64_t));
    f.outside = (uint64_t *)voxrti_alloc_zero(mem, words, sizeof(uint64_t));
    f.rank = (uint32_t *)voxrti_alloc_zero(mem, words, sizeof(uint32_t));
    f.reached = (uint64_t *)voxrti_alloc_zero(mem, set->block_count, sizeof(uint64_t));
    if (f.mixed == NULL || f.outside == NULL || f.rank == NULL || f.reached == NULL) {
        r = VOXRT_ERR_NO_MEMORY;
    } else {
        uint32_t before = 0;
        for (i = 0; i < set->block_count; i++) f.mixed[set->key[i] >> 6] |= (uint64_t)1 << (set->key[i] & 63u);
        for (i = 0; i < words; i++) {
            f.rank[i] = before;
            before += voxrti_popcount64(f.mixed[i]);
        }
        voxrti_flood_border(&f);
        r = f.failed ? VOXRT_ERR_NO_MEMORY : voxrti_fill_emit(mem, &f, words, d->fill_depth, set);
    }
    voxrti_free(mem, f.mixed);
    voxrti_free(mem, f.outside);
    voxrti_free(mem, f.rank);
    voxrti_free(mem, f.reached);
    voxrti_free(mem, f.queue);
    return r;
}

/* ---------------------------------------------------------------------------
   tree: leaves -> wide nodes of all levels -> level-of-detail attributes;      // >>tree
   lookup of any cell of any octree level.
   --------------------------------------------------------------------------- */

static void voxrti_tree_free(voxrti_mem *mem, voxrt_tree *t) {
    if (t == NULL) return;
    if (t->borrowed == NULL) {
        voxrti_free(mem, t->node);
        voxrti_free(mem, t->leaf);
        voxrti_free(mem, t->rank);
        voxrti_free(mem, t->code);
        voxrti_free(mem, t->extra);
        voxrti_free(mem, t->normal);
        voxrti_free(mem, t->colors.block);
        voxrti_free(mem, t->colors.data);
        voxrti_free(mem, t->palette);
    }
    voxrti_free(mem, t);
}

VOXRT_DEF void voxrt_tree_destroy(voxrt_tree *tree) {
    if (tree != NULL) {
        voxrti_mem mem = tree->mem;
        voxrti_tree_free(&mem, tree);
    }
}

/* Where the attributes of each virtual level begin, finest first; count: cells of the levels. */
static VOXRTI_UNUSED void voxrti_attr_places(voxrt_tree *t, const uint64_t *count) {
    uint64_t total = 0;
    uint32_t v;
    memset(t->attr_first, 0, sizeof t->attr_first);
    for (v = 2 * t->wide + 1; v-- > 0;) {
        t->attr_first[v] = total;
        total += count[v];
    }
    t->attr_count = total;
}

/* Given wide, depth, level_nodes and the masks of all nodes, derive the rest of the geometry: level_first, child,
   octant, rank, attr_first, counts and the box of the filled cells. Arrays are allocated by the caller: node, leaf
   (padded by 8), rank. ERR_FORMAT: the masks do not describe a tree. O(nodes). */
static VOXRTI_UNUSED voxrt_result voxrti_tree_index(voxrt_tree *t) {
    uint32_t w, i, k, octants = 0, at = 0;
    uint64_t count[2 * VOXRTI_MAX_WIDE + 1], voxels = 0;
    memset(count, 0, sizeof count);
    if (t->depth < 1 || t->depth > VOXRT_MAX_DEPTH || t->wide != (t->depth + 1) / 2) return VOXRT_ERR_FORMAT;
    if (t->level_nodes[0] != 1) return VOXRT_ERR_FORMAT;
    for (w = 0; w + 1 < t->wide; w++) {
        uint64_t children = 0;
        uint32_t first_child = w + 2 < t->wide ? at + t->level_nodes[w] : 0;
        t->level_first[w] = at;
        octants = 0;
        for (i = 0; i < t->level_nodes[w]; i++) {
            voxrti_node *n = &t->node[at + i];
            if (n->mask == 0 || children > 0xffffffffu) return VOXRT_ERR_FORMAT;
            n->child = (uint32_t)(first_child + children);
            n->octant = octants;
            children += voxrti_popcount64(n->mask);
            octants += voxrti_popcount64(voxrti_octants(n->mask));
        }
        if (children != t->level_nodes[w + 1]) return VOXRT_ERR_FORMAT;
        count[2 * w] = t->level_nodes[w];
        count[2 * w + 1] = octants;
        at += t->level_nodes[w];
    }
    if (at != t->node_count) return VOXRT_ERR_FORMAT;
    t->level_first[w] = 0;
    octants = 0;
    for (i = 0; i < t->level_nodes[w]; i++) {
        if ((i & 15u) == 0) {
            t->rank[2 * (i >> 4)] = (uint32_t)voxels;
            t->rank[2 * (i >> 4) + 1] = octants;
        }
        if (t->leaf[i] == 0) return VOXRT_ERR_FORMAT;
        voxels += voxrti_popcount64(t->leaf[i]);
        octants += voxrti_popcount64(voxrti_octants(t->leaf[i]));
        if (voxels > 0xfffffffeu) return VOXRT_ERR_RANGE;
    }
    for (k = 0; k < 8; k++) t->leaf[i + k] = 0;
    for (; (i & 15u) != 0; i++) { }
    t->rank[2 * (i >> 4)] = (uint32_t)voxels;
    t->rank[2 * (i >> 4) + 1] = octants;
    count[2 * w] = t->level_nodes[w];
    count[2 * w + 1] = octants;
    count[2 * w + 2] = voxels;
    t->voxel_count = voxels;
    voxrti_attr_places(t, count);
    return VOXRT_OK;
}

/* Box of the filled leaves; also checks that an odd-depth model stays in octant 0 of the virtual root. O(nodes),
   descending only where the box can still grow. */
static VOXRTI_UNUSED voxrt_result voxrti_tree_box(voxrt_tree *t) {
    struct { uint32_t node, x, y, z; uint64_t mask, left; } stack[VOXRTI_MAX_WIDE];
    uint32_t sp = 1, a, lo[3] = {0xffffffffu, 0xffffffffu, 0xffffffffu}, hi[3] = {0, 0, 0};
    uint64_t root = t->wide > 1 ? t->node[0].mask : t->leaf[0];
    if ((t->depth & 1u) != 0 && (root & ~(uint64_t)0xff) != 0) return VOXRT_ERR_FORMAT;
    memset(stack, 0, sizeof stack);
    stack[0].mask = stack[0].left = root;
    while (sp > 0) {
        const uint32_t w = sp - 1, sh = 2 * (t->wide - sp);
        uint32_t s, c[3], inside = 1;
        uint64_t bit;
        if (sp >= t->wide) { /* a leaf node */
            c[0] = stack[w].x;
            c[1] = stack[w].y;
            c[2] = stack[w].z;
            for (a = 0; a < 3; a++) {
                const uint32_t from = c[a] + voxrti_mask_lo(stack[w].mask, a);
                const uint32_t to = c[a] + voxrti_mask_hi(stack[w].mask, a);
                lo[a] = from < lo[a] ? from : lo[a];
                hi[a] = to > hi[a] ? to : hi[a];
            }
            sp--;
            continue;
        }
        if (stack[w].left == 0) {
            sp--;
            continue;
        }
        s = voxrti_ctz64(stack[w].left);
        bit = (uint64_t)1 << s;
        stack[w].left &= ~bit;
        c[0] = stack[w].x + (voxrti_slot_x(s) << sh);
        c[1] = stack[w].y + (voxrti_slot_y(s) << sh);
        c[2] = stack[w].z + (voxrti_slot_z(s) << sh);
        for (a = 0; a < 3; a++) inside &= c[a] >= lo[a] && c[a] + (1u << sh) <= hi[a];
        if (inside) continue;
        stack[sp].node = t->node[stack[w].node].child + voxrti_popcount64(stack[w].mask & (bit - 1));
        stack[sp].mask = sp + 1 < t->wide ? t->node[stack[sp].node].mask : t->leaf[stack[sp].node];
        stack[sp].left = stack[sp].mask;
        stack[sp].x = c[0];
        stack[sp].y = c[1];
        stack[sp].z = c[2];
        sp++;
    }
    for (a = 0; a < 3; a++) {
        t->cell_min[a] = lo[a];
        t->cell_max[a] = hi[a];
    }
    return VOXRT_OK;
}

/* ---- attributes ---- */

/* Rank of the first voxel of leaf node i. */
VOXRTI_INLINE uint32_t voxrti_leaf_rank(const voxrt_tree *t, uint32_t i) {
    uint32_t r = t->rank[2 * (i >> 4)], k;
    for (k = i & ~15u; k < i; k++) r += voxrti_popcount64(t->leaf[k]);
    return r;
}

/* Rank of its first octant: octants are counted by their place, and these added up at the end. */
VOXRTI_INLINE uint32_t voxrti_octant_rank(const voxrt_tree *t, uint32_t i) {
    uint64_t sum = 0, x;
    uint32_t k;
    for (k = i & ~15u; k < i; k++) {
        x = t->leaf[k];
        x = ((x & 0x7f7f7f7f7f7f7f7fu) + 0x7f7f7f7f7f7f7f7fu) | x;
        sum += (x >> 7) & 0x0101010101010101u;
    }
    return t->rank[2 * (i >> 4) + 1] + (uint32_t)((sum * 0x0101010101010101u) >> 56);
}

/* Index of the attributes of a cell of virtual level v: `node` holds it, at bit `slot` (v even) or octant slot/8 (v
   odd). v = 0: the virtual root. */
VOXRTI_INLINE uint64_t voxrti_attr_index(const voxrt_tree *t, uint32_t v, uint32_t node, uint32_t slot) {
    uint32_t w, r;
    if (v == 0) return t->attr_first[0];
    w = (v - 1) / 2;
    if ((v & 1u) == 0) {
        uint64_t below = ((uint64_t)1 << slot) - 1;
        if (w + 1 == t->wide) r = voxrti_leaf_rank(t, node) + voxrti_popcount64(t->leaf[node] & below);
        else r = t->node[node].child + voxrti_popcount64(t->node[node].mask & below) - t->level_first[w + 1];
    } else {
        uint32_t below = (1u << (slot >> 3)) - 1u;
        if (w + 1 == t->wide) {
            r = voxrti_octant_rank(t, node);
            r += voxrti_popcount64(voxrti_octants(t->leaf[node]) & below);
        } else {
            r = t->node[node].octant + voxrti_popcount64(voxrti_octants(t->node[node].mask) & below);
        }
    }
    return t->attr_first[v] + r;
}

/* Cells of a leaf node: itself, octants, voxels. */
VOXRTI_INLINE uint32_t voxrti_leaf_cells(uint64_t mask) {
    return 1 + voxrti_popcount64(voxrti_octants(mask)) + voxrti_popcount64(mask);
}

/* Index of the attributes of cell (x, y, z) of virtual level v of a shared tree; the cell is not empty. */
static VOXRTI_UNUSED uint64_t voxrti_shared_attr(const voxrt_tree *t, uint32_t v, uint32_t x, uint32_t y, uint32_t z) {
    uint32_t w, node = 0, i, to;
    uint64_t at = 0;
    if (v == 0) return 0;
    for (w = 0;; w++) {
        const uint32_t leaf = w + 1 == t->wide, sh = v - 2 * w - 2;
        const uint64_t mask = leaf ? t->leaf[node] : t->node[node].mask;
        uint64_t below;
        if (v == 2 * w + 1) {
            i = (x & 1u) | (y & 1u) << 1 | (z & 1u) << 2;
            return at + 1 + voxrti_popcount64(voxrti_octants(mask) & ((1u << i) - 1u));
        }
        below = mask & (((uint64_t)1 << voxrti_slot(x >> sh, y >> sh, z >> sh)) - 1);
        at += 1 + voxrti_popcount64(voxrti_octants(mask));
        if (leaf) return at + voxrti_popcount64(below);
        to = t->node[node].child + voxrti_popcount64(below);
        if (w + 2 == t->wide) {
            for (i = t->node[node].child; i < to; i++) at += voxrti_leaf_cells(t->leaf[voxrti_leaf_at(t, i)]);
            node = voxrti_leaf_at(t, to);
        } else {
            at += t->node[to].octant;
            node = to;
        }
        if (sh == 0) return at;
    }
}

VOXRTI_INLINE uint32_t voxrti_color_index(const voxrt_tree *t, uint64_t attr) {
    return t->colors.block != NULL ? voxrti_colors_get(&t->colors, attr) : 0;
}

static void voxrti_attr_voxel(const voxrt_tree *t, uint64_t attr, voxrt_voxel *out) {
    const uint8_t *p = t->palette + (size_t)3 * voxrti_color_index(t, attr);
    out->rgb[0] = p[0];
    out->rgb[1] = p[1];
    out->rgb[2] = p[2];
    out->has_normal = t->normal != NULL;
    out->normal[0] = out->normal[1] = out->normal[2] = 0;
    if (t->normal != NULL) voxrti_normal_decode(t->spherical, t->normal[attr], out->normal);
}

/* ---- build ---- */

/* Exact sums over the filled leaves of a cell. */
typedef struct voxrti_sum {
    uint64_t rgb[3];  /* linear light, 16 bits */
    int64_t normal[3]; /* of 2^14 times the unit vectors */
    uint64_t count;
} voxrti_sum;

typedef struct voxrti_lod {
    voxrt_tree *t;
    voxrt_lod_method method;
    uint32_t w;                 /* the level in work */
    uint32_t *value;            /* [attr_count] colours (mean) or palette indices (majority), or NULL */
    const voxrti_sum *children; /* sums of the nodes of level w+1; NULL on the leaf level */
    voxrti_sum *sums;           /* sums of the nodes of level w */
    uint32_t srgb[256];
} voxrti_lod;

static void voxrti_sum_add_cell(voxrti_lod *l, uint64_t attr, voxrti_sum *s) {
    if (l->value != NULL && l->method == VOXRT_LOD_MEAN) {
        uint32_t c = l->value[attr];
        s->rgb[0] += l->srgb[c & 255u];
        s->rgb[1] += l->srgb[c >> 8 & 255u];
        s->rgb[2] += l->srgb[c >> 16 & 255u];
    }
    if (l->t->normal != NULL) {
        float n[3];
        voxrti_normal_decode(l->t->spherical, l->t->normal[attr], n);
        s->normal[0] += (int64_t)(n[0] * 16384.0f);
        s->normal[1] += (int64_t)(n[1] * 16384.0f);
        s->normal[2] += (int64_t)(n[2] * 16384.0f);
    }
    s->count++;
}

/* Normal of a sum; opposite normals that cancel, but for the error of their codes, leave `fallback`. */
static uint32_t voxrti_sum_normal(const voxrti_lod *l, const voxrti_sum *s, uint32_t fallback) {
    double x = (double)s->normal[0], y = (double)s->normal[1], z = (double)s->normal[2];
    double len = sqrt(x * x + y * y + z * z);
    float n[3];
    if (!(len > 200.0 * (double)s->count)) return fallback;
    n[0] = (float)(x / len);
    n[1] = (float)(y / len);
    n[2] = (float)(z / len);
    return voxrti_normal_encode(l->t->spherical, n);
}

/* Thesis 3.1.4: the mean of the unit normals of n children, each counted once whatever is below it; that of child
   `best` if they cancel each other. */
static uint32_t voxrti_children_normal(const voxrt_tree *t, uint64_t first, uint32_t n, uint32_t best) {
    float sum[3] = {0, 0, 0}, v[3];
    uint32_t i;
    if (n == 1) return t->normal[first];
    for (i = 0; i < n; i++) {
        voxrti_normal_decode(t->spherical, t->normal[first + i], v);
        sum[0] += v[0];
        sum[1] += v[1];
        sum[2] += v[2];
    }
    if (!(sqrtf(voxrti_dot3(sum, sum)) > 0.0122f * (float)n)) return t->normal[first + best]; /* but for their codes */
    (void)voxrti_normalize(sum);
    return voxrti_normal_encode(t->spherical, sum);
}

static uint32_t voxrti_sum_color(const voxrti_lod *l, const voxrti_sum *s) {
    uint64_t h = s->count / 2;
    return voxrti_srgb_find(l->srgb, (uint32_t)((s->rgb[0] + h) / s->count)) |
           voxrti_srgb_find(l->srgb, (uint32_t)((s->rgb[1] + h) / s->count)) << 8 |
           voxrti_srgb_find(l->srgb, (uint32_t)((s->rgb[2] + h) / s->count)) << 16;
}

/* Thesis 3.1.4: a child with the index most children have; ties: more leaves below, then the lower index. */
static uint32_t voxrti_majority(const uint32_t *index, const uint32_t *weight, uint32_t n) {
    uint32_t best = 0, best_votes = 0, i, k;
    uint64_t best_weight = 0;
    for (i = 0; i < n; i++) {
        uint32_t votes = 0;
        uint64_t leaves = 0;
        for (k = 0; k < n; k++) {
            if (index[k] == index[i]) {
                votes++;
                leaves += weight[k];
            }
        }
        if (votes > best_votes || (votes == best_votes && (leaves > best_weight ||
            (leaves == best_weight && index[i] < index[best])))) {
            best = i;
            best_votes = votes;
            best_weight = leaves;
        }
    }
    return best;
}

#define VOXRTI_LOD_CHUNK 4096u

static void voxrti_lod_node(voxrti_lod *l, uint32_t i, uint64_t cell, uint64_t oct_attr) {
    voxrt_tree *t = l->t;
    uint32_t w = l->w, o, leaf = w + 1 == t->wide, thesis = l->method == VOXRT_LOD_MAJORITY;
    uint32_t majority = thesis && l->value != NULL, best = 0;
    uint64_t mask = leaf ? t->leaf[i] : t->node[t->level_first[w] + i].mask;
    uint64_t node_attr = t->attr_first[2 * w] + i, first = t->attr_first[2 * w + 2];
    uint32_t vote[8], vote_weight[8], octants = 0;
    voxrti_sum node_sum;
    memset(&node_sum, 0, sizeof node_sum);
    for (o = 0; o < 8; o++) {
        uint32_t bits = (uint32_t)(mask >> (8 * o)) & 255u, n = 0, index[8], weight[8], a;
        voxrti_sum s;
        if (bits == 0) continue;
        memset(&s, 0, sizeof s);
        for (; bits != 0; bits &= bits - 1, n++, cell++) {
            if (leaf) {
                voxrti_sum_add_cell(l, cell, &s);
            } else {
                const voxrti_sum *c = &l->children[cell - first];
                for (a = 0; a < 3; a++) {
                    s.rgb[a] += c->rgb[a];
                    s.normal[a] += c->normal[a];
                }
                s.count += c->count;
            }
            if (majority) {
                index[n] = l->value[cell];
                weight[n] = leaf ? 1u : (uint32_t)l->children[cell - first].count;
            }
        }
        if (majority) {
            best = voxrti_majority(index, weight, n);
            l->value[oct_attr] = vote[octants] = index[best];
            vote_weight[octants] = (uint32_t)s.count;
        } else if (l->value != NULL) {
            l->value[oct_attr] = voxrti_sum_color(l, &s);
        }
        if (t->normal != NULL)
            t->normal[oct_attr] = (uint16_t)(thesis ? voxrti_children_normal(t, cell - n, n, best) :
                                             voxrti_sum_normal(l, &s, t->normal[cell - n]));
        for (a = 0; a < 3; a++) {
            node_sum.rgb[a] += s.rgb[a];
            node_sum.normal[a] += s.normal[a];
        }
        node_sum.count += s.count;
        octants++;
        oct_attr++;
    }
    oct_attr -= octants;
    if (majority) {
        best = voxrti_majority(vote, vote_weight, octants);
        l->value[node_attr] = vote[best];
    } else if (l->value != NULL) {
        l->value[node_attr] = voxrti_sum_color(l, &node_sum);
    }
    if (t->normal != NULL)
        t->normal[node_attr] = (uint16_t)(thesis ? voxrti_children_normal(t, oct_attr, octants, best) :
                                          voxrti_sum_normal(l, &node_sum, t->normal[oct_attr]));
    l->sums[i] = node_sum;
}

static void voxrti_lod_task(void *ctx, uint32_t task) {
    voxrti_lod *l = (voxrti_lod *)ctx;
    voxrt_tree *t = l->t;
    uint32_t w = l->w, leaf = w + 1 == t->wide, i = task * VOXRTI_LOD_CHUNK, end = i + VOXRTI_LOD_CHUNK;
    uint32_t n0 = leaf ? i : t->level_first[w] + i;
    uint64_t cell = voxrti_attr_index(t, 2 * w + 2, n0, 0), oct = voxrti_attr_index(t, 2 * w + 1, n0, 0);
    if (end > t->level_nodes[w]) end = t->level_nodes[w];
    for (; i < end; i++) {
        uint64_t mask = leaf ? t->leaf[i] : t->node[t->level_first[w] + i].mask;
        voxrti_lod_node(l, i, cell, oct);
        cell += voxrti_popcount64(mask);
        oct += voxrti_popcount64(voxrti_octants(mask));
    }
}

/* Attributes of all levels above the leaves, bottom up. */
static voxrt_result voxrti_tree_lod(voxrti_mem *mem, const voxrt_env *env, voxrt_tree *t, voxrt_lod_method method,
                                    uint32_t *value) {
    voxrti_lod l;
    voxrti_sum *below = NULL;
    uint32_t w;
    if (value == NULL && t->normal == NULL) return VOXRT_OK;
    memset(&l, 0, sizeof l);
    l.t = t;
    l.method = method;
    l.value = value;
    voxrti_srgb_table(l.srgb);
    for (w = t->wide; w-- > 0;) {
        l.sums = (voxrti_sum *)voxrti_alloc_array(mem, t->level_nodes[w], sizeof *l.sums);
        if (l.sums == NULL) {
            voxrti_free(mem, below);
            return VOXRT_ERR_NO_MEMORY;
        }
        l.w = w;
        l.children = below;
        voxrti_parallel_for(env, voxrti_lod_task, &l, (t->level_nodes[w] + VOXRTI_LOD_CHUNK - 1) / VOXRTI_LOD_CHUNK);
        voxrti_free(mem, below);
        below = l.sums;
    }
    voxrti_free(mem, below);
    return VOXRT_OK;
}

/* Masks of all levels from the leaf blocks; consumes set->mask. */
static voxrt_result voxrti_tree_masks(voxrti_mem *mem, voxrt_tree *t, voxrti_leafset *set) {
    size_t n = set->block_count, total = 0, i, k;
    uint32_t w;
    uint64_t *key[2];
    voxrti_node *level[VOXRTI_MAX_WIDE];
    int ok = 1;
    memset(level, 0, sizeof level);
    if (n > 0xfffffff0u || set->voxel_count > 0xfffffffeu) return VOXRT_ERR_RANGE;
    key[0] = set->key;
    key[1] = (uint64_t *)voxrti_alloc_array(mem, n, sizeof(uint64_t));
    if (key[1] == NULL) return VOXRT_ERR_NO_MEMORY;
    t->level_nodes[t->wide - 1] = (uint32_t)n;
    for (w = t->wide - 1; w-- > 0 && ok;) {
        const uint64_t *from = w + 2 == t->wide ? key[0] : key[1];
        uint64_t last = ~(uint64_t)0;
        for (i = 0, k = 0; i < n; i++) {
            if (from[i] >> 6 != last) k++;
            last = from[i] >> 6;
        }
        level[w] = (voxrti_node *)voxrti_alloc_zero(mem, k, sizeof(voxrti_node));
        ok = level[w] != NULL;
        for (i = 0, k = 0, last = ~(uint64_t)0; ok && i < n; i++) {
            uint64_t f = from[i];
            if (f >> 6 != last) {
                last = f >> 6;
                key[1][k++] = last;
            }
            level[w][k - 1].mask |= (uint64_t)1 << (f & 63u);
        }
        n = k;
        t->level_nodes[w] = (uint32_t)n;
        total += n;
    }
    if (ok) {
        t->node_count = (uint32_t)total;
        t->node = (voxrti_node *)voxrti_alloc_array(mem, total + 1, sizeof(voxrti_node));
        t->leaf = (uint64_t *)voxrti_alloc_array(mem, set->block_count + 8, sizeof(uint64_t));
        t->rank = (uint32_t *)voxrti_alloc_array(mem, 2 * (set->block_count / 16 + 2), sizeof(uint32_t));
        ok = t->node != NULL && t->leaf != NULL && t->rank != NULL;
    }
    if (ok) {
        for (w = 0, total = 0; w + 1 < t->wide; w++) {
            memcpy(t->node + total, level[w], t->level_nodes[w] * sizeof(voxrti_node));
            total += t->level_nodes[w];
        }
        memcpy(t->leaf, set->mask, set->block_count * sizeof(uint64_t));
    }
    for (w = 0; w < VOXRTI_MAX_WIDE; w++) voxrti_free(mem, level[w]);
    voxrti_free(mem, key[1]);
    voxrti_free(mem, set->key);
    voxrti_free(mem, set->mask);
    set->key = NULL;
    set->mask = NULL;
    return ok ? VOXRT_OK : VOXRT_ERR_NO_MEMORY;
}

/* The colour stream: palette of the leaves' colours (or the given one, then value holds its indices). complete: value
   has all levels. */
static voxrt_result voxrti_tree_colors(voxrti_mem *mem, const voxrt_build_desc *d, voxrt_tree *t, uint32_t *value,
                                       const uint8_t *palette, uint32_t palette_count, int complete,
                                       uint64_t *colors_in) {
    voxrt_result r = VOXRT_OK;
    size_t leaves = (size_t)t->voxel_count, all = (size_t)t->attr_count;
    voxrt_lod_method lod = palette != NULL ? VOXRT_LOD_MAJORITY : d->lod_method;
    if (palette == NULL && lod == VOXRT_LOD_MEAN) r = voxrti_tree_lod(mem, &d->env, t, lod, value);
    if (r == VOXRT_OK && palette == NULL)
        r = voxrti_palette_build(mem, &d->env, value, lod == VOXRT_LOD_MEAN ? all : leaves, leaves,
                                 d->palette_size, d->palette_method, &t->palette, &t->palette_count, colors_in);
    if (r == VOXRT_OK && palette != NULL) {
        t->palette = (uint8_t *)voxrti_alloc_array(mem, palette_count, 3);
        t->palette_count = palette_count;
        if (t->palette == NULL) return VOXRT_ERR_NO_MEMORY;
        memcpy(t->palette, palette, (size_t)3 * palette_count);
    }
    if (r == VOXRT_OK && lod == VOXRT_LOD_MAJORITY && !complete) r = voxrti_tree_lod(mem, &d->env, t, lod, value);
    if (r == VOXRT_OK) r = voxrti_colors_encode(mem, &d->env, value, all, &t->colors);
    return r;
}

/* Attributes of the leaves, or of all levels if the set has them, into an array for all levels. */
static void *voxrti_tree_attributes(voxrti_mem *mem, const voxrt_tree *t, int complete, void *from, size_t size) {
    void *p;
    if (complete) return from;
    p = voxrti_alloc_array(mem, (size_t)t->attr_count, size);
    if (p != NULL) memcpy(p, from, (size_t)t->voxel_count * size);
    voxrti_free(mem, from);
    return p;
}

/* Build a tree from filled leaves. Consumes the set (also on failure). palette != NULL: set->rgb holds indices into
   it and level of detail votes by majority, so that an octree of the thesis survives the way there and back. */
static VOXRTI_UNUSED voxrt_result voxrti_tree_from_leafset_palette(
        voxrti_mem *mem, const voxrt_build_desc *d, const voxrti_grid *grid, voxrti_leafset *set,
        const uint8_t *palette, uint32_t palette_count, voxrt_build_stats *stats, voxrt_tree **out) {
    voxrt_tree *t;
    uint32_t *value = NULL;
    uint64_t colors_in = 1;
    int complete = 0;
    voxrt_result r = VOXRT_OK;
    *out = NULL;
    if (set->block_count == 0) {
        voxrti_leafset_free(mem, set);
        return voxrti_fail(d->env.error, VOXRT_ERR_EMPTY, 0, "no voxel is filled");
    }
    t = (voxrt_tree *)voxrti_alloc_zero(mem, 1, sizeof *t);
    if (t == NULL) r = VOXRT_ERR_NO_MEMORY;
    if (r == VOXRT_OK) {
        t->cpu_level = voxrti_cpu_level();
        t->depth = grid->depth;
        t->wide = (grid->depth + 1) / 2;
        t->resolution = grid->resolution;
        memcpy(t->origin, grid->origin, sizeof t->origin);
        t->voxel_size = grid->voxel_size;
        r = voxrti_tree_masks(mem, t, set);
    }
    if (r == VOXRT_OK) r = voxrti_tree_index(t);
    if (r == VOXRT_OK) r = voxrti_tree_box(t);
    if (r == VOXRT_OK) complete = set->lod_count != 0 && set->lod_count == t->attr_count - t->voxel_count;
    if (r == VOXRT_OK && set->normal != NULL) {
        t->normal = (uint16_t *)voxrti_tree_attributes(mem, t, complete, set->normal, sizeof(uint16_t));
        t->spherical = set->spherical;
        if (t->normal == NULL) r = VOXRT_ERR_NO_MEMORY;
        set->normal = NULL;
    }
    if (r == VOXRT_OK && set->rgb != NULL) {
        value = (uint32_t *)voxrti_tree_attributes(mem, t, complete, set->rgb, sizeof(uint32_t));
        if (value == NULL) r = VOXRT_ERR_NO_MEMORY;
        set->rgb = NULL;
        if (r == VOXRT_OK) r = voxrti_tree_colors(mem, d, t, value, palette, palette_count, complete, &colors_in);
    } else if (r == VOXRT_OK && !complete) {
        r = voxrti_tree_lod(mem, &d->env, t, d->lod_method, NULL); /* of the normals */
    }
    if (r == VOXRT_OK && t->palette == NULL) {
        t->palette = (uint8_t *)voxrti_alloc(mem, 3);
        t->palette_count = 1;
        if (t->palette == NULL) r = VOXRT_ERR_NO_MEMORY;
        else memset(t->palette, 255, 3);
    }
    voxrti_free(mem, value);
    voxrti_leafset_free(mem, set);
    if (r != VOXRT_OK) {
        voxrti_tree_free(mem, t);
        return voxrti_fail(d->env.error, r, 0, voxrt_result_string(r));
    }
    if (stats != NULL) {
        stats->voxels = t->voxel_count;
        stats->colors_in = colors_in;
        stats->peak_bytes = mem->peak;
    }
    t->mem = *mem;
    t->mem.limit = 0;
    *out = t;
    return VOXRT_OK;
}

static VOXRTI_UNUSED voxrt_result voxrti_tree_from_leafset(voxrti_mem *mem, const voxrt_build_desc *d,
                                                           const voxrti_grid *grid, voxrti_leafset *set,
                                                           voxrt_build_stats *stats, voxrt_tree **out) {
    return voxrti_tree_from_leafset_palette(mem, d, grid, set, NULL, 0, stats, out);
}

/* A box of a desc: neither an edge of a cell, nor its reciprocal, nor the far corner may leave the doubles. */
static voxrt_result voxrti_box_check(voxrt_error *error, const double box_min[3], double size) {
    double most = voxrti_max(voxrti_max(voxrti_abs(box_min[0]), voxrti_abs(box_min[1])), voxrti_abs(box_min[2]));
    if (!voxrti_finite(size) || size < 0 || !voxrti_finite(box_min[0]) || !voxrti_finite(box_min[1]) ||
        !voxrti_finite(box_min[2]))
        return voxrti_fail(error, VOXRT_ERR_INVALID_ARG, 0, "box_min or box_size is not finite");
    if (size > 0 && !(size >= 1e-300 && size <= 1e300 && most <= 1e300))
        return voxrti_fail(error, VOXRT_ERR_RANGE, 0, "box_size is not in 1e-300..1e300, or box_min beyond 1e300");
    return VOXRT_OK;
}

/* Copy a build desc with the defaults filled in. */
static voxrt_result voxrti_build_open(const voxrt_build_desc *desc, voxrt_build_desc *d, voxrti_mem *mem) {
    voxrt_result r;
    memset(d, 0, sizeof *d);
    if (desc != NULL) *d = *desc;
    if (d->_begin_zero != 0 || d->_end_zero != 0) return VOXRT_ERR_UNINIT_DESC; /* its pointers may be wild */
    if (d->env.error != NULL) memset(d->env.error, 0, sizeof *d->env.error);
    if (d->resolution == 0) d->resolution = 1024;
    if (d->palette_size == 0) d->palette_size = 32767;
    if ((uint32_t)d->separating > 2u || (uint32_t)d->palette_method > 1u || (uint32_t)d->lod_method > 1u)
        return voxrti_fail(d->env.error, VOXRT_ERR_INVALID_ARG, 0, "unknown enumerator in the build desc");
    if (d->palette_size > 16777216u)
        return voxrti_fail(d->env.error, VOXRT_ERR_RANGE, d->palette_size, "palette of % colours is too large");
    if (d->resolution > 1u << VOXRT_MAX_VOXELIZE_DEPTH)
        return voxrti_fail(d->env.error, VOXRT_ERR_RANGE, d->resolution, "resolution % is too large");
    r = voxrti_box_check(d->env.error, d->box_min, d->box_size);
    if (r != VOXRT_OK) return r;
    return voxrti_env_open(&d->env, mem);
}

VOXRT_DEF voxrt_result voxrt_tree_build(const voxrt_build_desc *desc, const voxrt_mesh *mesh, voxrt_build_stats *stats,
                                        voxrt_tree **out_tree) {
    voxrt_build_desc d;
    voxrt_build_stats local;
    voxrti_mem mem;
    voxrti_grid grid;
    voxrti_leafset set;
    voxrt_result r;
    if (stats == NULL) stats = &local;
    memset(stats, 0, sizeof *stats);
    if (out_tree == NULL) return VOXRT_ERR_INVALID_ARG;
    *out_tree = NULL;
    r = voxrti_build_open(desc, &d, &mem);
    if (r != VOXRT_OK) return r;
    if (mesh == NULL || (mesh->triangle_count != 0 && mesh->positions == NULL))
        return voxrti_fail(d.env.error, VOXRT_ERR_INVALID_ARG, 0, "no mesh");
    memset(&set, 0, sizeof set);
    r = voxrti_grid_from_mesh(&d, mesh, &grid);
    if (r != VOXRT_OK) return r;
    r = voxrti_voxelize(&mem, &d, mesh, &grid, stats, &set);
    if (r == VOXRT_OK && d.fill) r = voxrti_leafset_fill(&mem, &d, grid.depth, &set);
    if (r != VOXRT_OK) {
        voxrti_leafset_free(&mem, &set);
        if (d.env.error != NULL && d.env.error->code == VOXRT_OK)
            (void)voxrti_fail(d.env.error, r, 0, voxrt_result_string(r));
        return r;
    }
    return voxrti_tree_from_leafset(&mem, &d, &grid, &set, stats, out_tree);
}

VOXRT_DEF voxrt_result voxrt_tree_from_voxels(const voxrt_build_desc *desc, const voxrt_voxel *voxels, size_t count,
                                              uint32_t depth, voxrt_tree **out_tree) {
    voxrt_build_desc d;
    voxrti_mem mem;
    voxrti_grid grid;
    voxrti_leafset set;
    voxrt_result r;
    if (out_tree == NULL) return VOXRT_ERR_INVALID_ARG;
    *out_tree = NULL;
    r = voxrti_build_open(desc, &d, &mem);
    if (r != VOXRT_OK) return r;
    if (voxels == NULL && count != 0) return voxrti_fail(d.env.error, VOXRT_ERR_INVALID_ARG, 0, "no voxels");
    if (depth < 1 || depth > VOXRT_MAX_DEPTH)
        return voxrti_fail(d.env.error, VOXRT_ERR_RANGE, depth, "depth % is out of range");
    memset(&set, 0, sizeof set);
    memset(&grid, 0, sizeof grid);
    grid.depth = depth;
    grid.resolution = 1u << depth;
    grid.voxel_size = 1.0;
    if (d.box_size > 0) {
        memcpy(grid.origin, d.box_min, sizeof grid.origin);
        grid.voxel_size = d.box_size / (double)grid.resolution;
    }
    r = voxrti_leafset_from_voxels(&mem, &d, voxels, count, depth, &set);
    if (r == VOXRT_OK && d.fill) r = voxrti_leafset_fill(&mem, &d, depth, &set);
    if (r != VOXRT_OK) {
        voxrti_leafset_free(&mem, &set);
        if (d.env.error != NULL && d.env.error->code == VOXRT_OK)
            (void)voxrti_fail(d.env.error, r, 0, voxrt_result_string(r));
        return r;
    }
    return voxrti_tree_from_leafset(&mem, &d, &grid, &set, NULL, out_tree);
}

/* ---- queries ---- */

VOXRT_DEF void voxrt_tree_get_info(const voxrt_tree *t, voxrt_tree_info *info) {
    uint32_t e, shift;
    if (info == NULL) return;
    memset(info, 0, sizeof *info);
    if (t == NULL) return;
    shift = 2 * t->wide - t->depth;
    info->depth = t->depth;
    info->resolution = t->resolution;
    memcpy(info->world_origin, t->origin, sizeof t->origin);
    info->voxel_size = t->voxel_size;
    memcpy(info->cell_min, t->cell_min, sizeof t->cell_min);
    memcpy(info->cell_max, t->cell_max, sizeof t->cell_max);
    info->has_colors = t->colors.block != NULL || t->palette_count > 1;
    info->has_normals = t->normal != NULL;
    info->palette_count = t->palette_count;
    info->voxel_count = t->voxel_count;
    for (e = 0; e <= t->depth; e++) {
        uint32_t v = e + shift;
        info->level_count[e] = (v == 0 ? t->attr_count : t->attr_first[v - 1]) - t->attr_first[v];
    }
    info->geometry_bytes = (uint64_t)t->node_count * sizeof(voxrti_node);
    if (t->code != NULL)
        info->geometry_bytes += (uint64_t)t->level_nodes[t->wide - 1] * sizeof *t->code +
                                (uint64_t)t->mask_count * 8 +
                                (uint64_t)((t->level_nodes[t->wide - 1] >> VOXRTI_CODE_LOG) + 1) * sizeof *t->extra;
    else
        info->geometry_bytes += (uint64_t)t->level_nodes[t->wide - 1] * 8 +
                                (uint64_t)(t->level_nodes[t->wide - 1] / 16 + 1) * 8;
    info->shared = t->code != NULL;
    info->color_bytes =
        t->colors.block_count * sizeof(uint32_t) + t->colors.data_bytes + (uint64_t)3 * t->palette_count;
    info->normal_bytes = t->normal != NULL ? t->attr_count * sizeof(uint16_t) : 0;
    info->total_bytes = info->geometry_bytes + info->color_bytes + info->normal_bytes + sizeof *t;
}

VOXRT_DEF const uint8_t *voxrt_tree_palette(const voxrt_tree *tree, uint32_t *out_count) {
    if (out_count != NULL) *out_count = tree != NULL ? tree->palette_count : 0;
    return tree != NULL ? tree->palette : NULL;
}

VOXRT_DEF int voxrt_tree_get(const voxrt_tree *t, uint32_t level, uint32_t x, uint32_t y, uint32_t z,
                             voxrt_voxel *out) {
    uint32_t v, w, node = 0, slot = 0;
    if (out != NULL) memset(out, 0, sizeof *out);
    if (t == NULL || level > t->depth || (x | y | z) >> level != 0) return 0;
    v = level + 2 * t->wide - t->depth;
    for (w = 0; v != 0; w++) {
        uint64_t mask = w + 1 == t->wide ? t->leaf[node] : t->node[node].mask;
        uint32_t sh;
        if (v == 2 * w + 1) { /* an octant of this node */
            slot = 8 * ((x & 1u) | (y & 1u) << 1 | (z & 1u) << 2);
            if ((mask >> slot & 255u) == 0) return 0;
            break;
        }
        sh = v - 2 * w - 2;
        slot = voxrti_slot(x >> sh, y >> sh, z >> sh);
        if ((mask >> slot & 1u) == 0) return 0;
        if (sh == 0) break;
        node = t->node[node].child + voxrti_popcount64(mask & (((uint64_t)1 << slot) - 1));
        if (w + 2 == t->wide) node = voxrti_leaf_at(t, node);
    }
    if (out != NULL) {
        out->x = x;
        out->y = y;
        out->z = z;
        if (t->code != NULL)
            voxrti_attr_voxel(t, voxrti_shared_attr(t, level + 2 * t->wide - t->depth, x, y, z), out);
        else
            voxrti_attr_voxel(t, voxrti_attr_index(t, v, node, slot), out);
    }
    return 1;
}

/* A way through the nodes of wide levels 0..w in Morton order, wherever they are stored. */
typedef struct voxrti_way_node {
    uint32_t node, x, y, z;
    uint64_t mask, left;
    uint64_t attr, next; /* shared trees: index of the attributes of the node itself, of the next leaf node below it */
} voxrti_way_node;

typedef struct voxrti_way {
    const voxrt_tree *t;
    uint32_t w, depth;   /* nodes of level w are visited; entries of `at` in use */
    voxrti_way_node at[VOXRTI_MAX_WIDE];
} voxrti_way;

static void voxrti_way_start(voxrti_way *way, const voxrt_tree *t, uint32_t w) {
    way->t = t;
    way->w = w;
    way->depth = 0;
}

/* The next node of level w; NULL: there is none. Whoever asks for it has used up `left` of the one before. */
static voxrti_way_node *voxrti_way_next(voxrti_way *way) {
    const voxrt_tree *t = way->t;
    if (way->depth == 0) {
        voxrti_way_node *n = &way->at[0];
        memset(n, 0, sizeof *n);
        n->mask = n->left = t->wide > 1 ? t->node[0].mask : t->leaf[0];
        n->next = 1 + voxrti_popcount64(voxrti_octants(n->mask));
        way->depth = 1;
        if (way->w == 0) return n;
    } else if (way->depth == way->w + 1) {
        way->depth--;
    }
    while (way->depth != 0) {
        const uint32_t to = way->depth; /* level of the child */
        voxrti_way_node *p = &way->at[to - 1], *n = &way->at[to];
        uint32_t s;
        if (p->left == 0) {
            way->depth--;
            continue;
        }
        s = voxrti_ctz64(p->left);
        p->left &= p->left - 1;
        n->node = t->node[p->node].child + voxrti_popcount64(p->mask & (((uint64_t)1 << s) - 1));
        n->attr = p->next;
        if (to + 1 == t->wide) {
            n->node = voxrti_leaf_at(t, n->node);
            n->mask = t->leaf[n->node];
            p->next += voxrti_leaf_cells(n->mask);
        } else {
            n->mask = t->node[n->node].mask;
            n->attr += t->node[n->node].octant;
            n->next = n->attr + 1 + voxrti_popcount64(voxrti_octants(n->mask));
        }
        n->left = n->mask;
        n->x = p->x * 4 + voxrti_slot_x(s);
        n->y = p->y * 4 + voxrti_slot_y(s);
        n->z = p->z * 4 + voxrti_slot_z(s);
        way->depth++;
        if (to == way->w) return n;
    }
    return NULL;
}

VOXRT_DEF int voxrt_tree_each(const voxrt_tree *t, uint32_t level,
                              int (*fn)(void *user, const voxrt_voxel *voxel, uint32_t palette_index), void *user) {
    voxrti_way way;
    voxrti_way_node *n;
    uint32_t v;
    uint64_t attr;
    voxrt_voxel voxel;
    if (t == NULL || fn == NULL || level > t->depth) return 0;
    v = level + 2 * t->wide - t->depth;
    attr = t->attr_first[v];
    memset(&voxel, 0, sizeof voxel);
    if (v == 0) {
        if (t->code != NULL) attr = 0;
        voxrti_attr_voxel(t, attr, &voxel);
        return fn(user, &voxel, voxrti_color_index(t, attr));
    }
    voxrti_way_start(&way, t, (v - 1) / 2); /* nodes whose bits or octants are the cells */
    while ((n = voxrti_way_next(&way)) != NULL) {
        const uint32_t leaf = way.w + 1 == t->wide, octants = voxrti_octants(n->mask);
        for (; n->left != 0; attr++) {
            const uint32_t s = voxrti_ctz64(n->left);
            const uint32_t sx = voxrti_slot_x(s), sy = voxrti_slot_y(s), sz = voxrti_slot_z(s);
            const uint64_t below = ((uint64_t)1 << s) - 1;
            int stop;
            if (v & 1u) { /* the whole octant at once */
                n->left &= ~((uint64_t)255 << (s & 56u));
                voxel.x = n->x * 2 + (sx >> 1);
                voxel.y = n->y * 2 + (sy >> 1);
                voxel.z = n->z * 2 + (sz >> 1);
                if (t->code != NULL) attr = n->attr + 1 + voxrti_popcount64(octants & ((1u << (s >> 3)) - 1u));
            } else {
                n->left &= n->left - 1;
                voxel.x = n->x * 4 + sx;
                voxel.y = n->y * 4 + sy;
                voxel.z = n->z * 4 + sz;
                if (t->code != NULL && leaf) {
                    attr = n->attr + 1 + voxrti_popcount64(octants) + voxrti_popcount64(n->mask & below);
                } else if (t->code != NULL && way.w + 2 == t->wide) {
                    const uint32_t child = t->node[n->node].child + voxrti_popcount64(n->mask & below);
                    attr = n->next;
                    n->next += voxrti_leaf_cells(t->leaf[voxrti_leaf_at(t, child)]);
                } else if (t->code != NULL) {
                    const uint32_t child = t->node[n->node].child + voxrti_popcount64(n->mask & below);
                    attr = n->next + t->node[child].octant;
                }
            }
            voxrti_attr_voxel(t, attr, &voxel);
            stop = fn(user, &voxel, voxrti_color_index(t, attr));
            if (stop) return stop;
        }
    }
    return 0;
}

/* The attributes of all cells of virtual level v of a shared tree, in Morton order, into a hash. */
static uint64_t voxrti_shared_hash(const voxrt_tree *t, uint32_t v, int colors, uint64_t h) {
    voxrti_way way;
    voxrti_way_node *n;
    uint32_t leaf = v == 2 * t->wide;
    voxrti_way_start(&way, t, leaf ? t->wide - 1 : v / 2);
    while ((n = voxrti_way_next(&way)) != NULL) { /* the nodes themselves (v even), their octants (v odd), voxels */
        uint64_t at = n->attr, count = 1;
        const uint32_t octants = voxrti_popcount64(voxrti_octants(n->mask));
        n->left = 0;
        if (leaf) {
            at += 1 + octants;
            count = voxrti_popcount64(n->mask);
        } else if (v & 1u) {
            at += 1;
            count = octants;
        }
        for (; count > 0; count--, at++)
            h = voxrti_hash_mix(h, colors ? voxrti_colors_get(&t->colors, at) : (uint64_t)t->normal[at]);
    }
    return h;
}

VOXRT_DEF uint64_t voxrt_tree_hash(const voxrt_tree *t) {
    uint64_t h = 0x243f6a8885a308d3u, i, bits;
    uint32_t a;
    if (t == NULL) return 0;
    h = voxrti_hash_mix(h, t->depth | (uint64_t)t->resolution << 32);
    for (a = 0; a < 4; a++) {
        memcpy(&bits, a < 3 ? &t->origin[a] : &t->voxel_size, sizeof bits);
        h = voxrti_hash_mix(h, bits);
    }
    for (a = 0; a < t->wide && t->code != NULL; a++) {
        voxrti_way way;
        voxrti_way_node *n;
        voxrti_way_start(&way, t, a);
        while ((n = voxrti_way_next(&way)) != NULL) {
            h = voxrti_hash_mix(h, n->mask);
            n->left = 0;
        }
    }
    for (i = 0; i < t->node_count && t->code == NULL; i++) h = voxrti_hash_mix(h, t->node[i].mask);
    for (i = 0; i < t->level_nodes[t->wide - 1] && t->code == NULL; i++) h = voxrti_hash_mix(h, t->leaf[i]);
    h = voxrti_hash_bytes(h, t->palette, (size_t)3 * t->palette_count);
    if (t->spherical) h = voxrti_hash_mix(h, 1);
    if (t->code != NULL) {
        for (a = 2 * t->wide + 1; t->normal != NULL && a-- > 0;) h = voxrti_shared_hash(t, a, 0, h);
        for (a = 2 * t->wide + 1; t->colors.block != NULL && a-- > 0;) h = voxrti_shared_hash(t, a, 1, h);
        return h;
    }
    if (t->normal != NULL)
        for (i = 0; i < t->attr_count; i++) h = voxrti_hash_mix(h, t->normal[i]);
    if (t->colors.block != NULL)
        for (i = 0; i < t->attr_count; i++) h = voxrti_hash_mix(h, voxrti_colors_get(&t->colors, i));
    return h;
}

/* ---------------------------------------------------------------------------
   share: equal parts of a tree stored once; core says what the bytes are.      // >>share

   Bottom up, level by level, each node gets the number of the first node that is equal to it: equal masks of leaf nodes
   first; then lists of children that have equal numbers in a row are the same run, and interior nodes are equal when
   mask and run are. The mask is no part of a run: what moved by a cell within its parent is shared, too (Kaempe et al.
   2013 share whole nodes). Then the runs are laid out top down, each where it is named first.
   Mirrored parts are not found: mirrored leaf nodes would save a third of the masks, which are 2 to 5 % of a tree, and
   cost each ray that enters one; and runs of a curved surface are different however they are turned.
   --------------------------------------------------------------------------- */

/* A set of numbers by what they stand for. */
typedef struct voxrti_intern {
    voxrti_mem *mem;
    uint32_t (*slot)[2]; /* [capacity] number, hash; VOXRT_NO_NODE: free */
    size_t capacity, count; /* capacity: a power of two */
} voxrti_intern;

static int voxrti_intern_grow(voxrti_intern *h) {
    size_t capacity = h->capacity != 0 ? 2 * h->capacity : 1024, i, k;
    uint32_t (*slot)[2] = (uint32_t (*)[2])voxrti_alloc_array(h->mem, capacity, sizeof *slot);
    if (slot == NULL) return 0;
    for (i = 0; i < capacity; i++) slot[i][0] = VOXRT_NO_NODE;
    for (i = 0; i < h->capacity; i++) {
        if (h->slot[i][0] == VOXRT_NO_NODE) continue;
        for (k = h->slot[i][1] & (capacity - 1); slot[k][0] != VOXRT_NO_NODE; k = (k + 1) & (capacity - 1)) { }
        slot[k][0] = h->slot[i][0];
        slot[k][1] = h->slot[i][1];
    }
    voxrti_free(h->mem, h->slot);
    h->slot = slot;
    h->capacity = capacity;
    return 1;
}

/* The number in the set that is the same as `number`, or `number`, which then belongs to it. NO_NODE: no memory. Who
   makes nodes collide on purpose gets a tree with fewer parts shared, not a program that hangs. */
#define VOXRTI_INTERN_LOOKS 1024
static uint32_t voxrti_intern_get(voxrti_intern *h, uint64_t hash, uint32_t number,
                                  int (*same)(const void *user, uint32_t a, uint32_t b), const void *user) {
    const uint32_t key = (uint32_t)(hash >> 32);
    uint32_t looks = 0;
    size_t k;
    if (2 * h->count >= h->capacity && !voxrti_intern_grow(h)) return VOXRT_NO_NODE;
    for (k = key & (h->capacity - 1); h->slot[k][0] != VOXRT_NO_NODE; k = (k + 1) & (h->capacity - 1)) {
        if (h->slot[k][1] == key && same(user, h->slot[k][0], number)) return h->slot[k][0];
        if (++looks == VOXRTI_INTERN_LOOKS) return number;
    }
    h->slot[k][0] = number;
    h->slot[k][1] = key;
    h->count++;
    return number;
}

/* A tree on its way to a shared one. */
typedef struct voxrti_sharer {
    voxrti_mem *mem;
    const voxrt_tree *s;
    voxrt_tree *t;
    const voxrti_node *node;               /* of the level in work, */
    const uint32_t *child;                 /* and the numbers of the nodes below it */
    uint32_t child_first;
    const uint32_t *level_run;             /* and their runs */
    uint32_t *number[VOXRTI_MAX_WIDE];     /* of each node: the first equal one; leaf nodes: the number of the mask */
    uint32_t *run[VOXRTI_MAX_WIDE];        /* of each interior node: the first that has an equal list of children */
    uint64_t *mask;                        /* [mask_count] different masks in the order of their numbers */
    size_t mask_count, mask_capacity;
    uint32_t *code;                        /* numbers of masks of the leaf nodes that are kept */
} voxrti_sharer;

static int voxrti_same_run(const void *user, uint32_t a, uint32_t b) {
    const voxrti_sharer *h = (const voxrti_sharer *)user;
    const uint32_t n = voxrti_popcount64(h->node[a].mask);
    return n == voxrti_popcount64(h->node[b].mask) &&
           memcmp(h->child + (h->node[a].child - h->child_first), h->child + (h->node[b].child - h->child_first),
                  n * sizeof *h->child) == 0;
}

static int voxrti_same_node(const void *user, uint32_t a, uint32_t b) {
    const voxrti_sharer *h = (const voxrti_sharer *)user;
    return h->node[a].mask == h->node[b].mask && h->level_run[a] == h->level_run[b];
}

/* Numbers of n masks, in the order in which they come up: [n] to. By sorting, which takes as long for any masks. */
static voxrt_result voxrti_share_masks_sorted(voxrti_sharer *h, const uint64_t *leaf, uint32_t n, uint32_t *to) {
    voxrti_keyed *key = (voxrti_keyed *)voxrti_alloc_array(h->mem, 2 * (size_t)n, sizeof *key);
    uint32_t i, first = 0;
    size_t count = 0;
    if (key == NULL) return VOXRT_ERR_NO_MEMORY;
    for (i = 0; i < n; i++) {
        key[i].key = leaf[i];
        key[i].index = i;
    }
    voxrti_keyed_sort(key, key + n, n, 64);
    for (i = 0; i < n; i++) {
        if (i == 0 || key[i].key != key[i - 1].key) {
            first = key[i].index; /* stable: the first leaf node that has the mask */
            count++;
        }
        to[key[i].index] = first;
    }
    voxrti_free(h->mem, key);
    voxrti_free(h->mem, h->mask);
    h->mask_count = 0;
    h->mask_capacity = count;
    h->mask = (uint64_t *)voxrti_alloc_array(h->mem, count, sizeof *h->mask);
    if (h->mask == NULL) return VOXRT_ERR_NO_MEMORY;
    for (i = 0; i < n; i++) {
        if (to[i] < i) {
            to[i] = to[to[i]];
        } else {
            h->mask[h->mask_count] = leaf[i];
            to[i] = (uint32_t)h->mask_count++;
        }
    }
    return VOXRT_OK;
}

/* The same by a set of its own: most masks are found at the first look, and then nothing else is read. Masks that a
   file chose so that they collide are sorted. */
typedef struct voxrti_mask_slot { uint64_t mask; uint32_t number; } voxrti_mask_slot; /* mask 0: free */

static voxrt_result voxrti_share_masks(voxrti_sharer *h, const uint64_t *leaf, uint32_t n, uint32_t *to) {
    voxrti_mask_slot *slot = NULL, *old;
    size_t capacity = 0, from, i, k, looks = 0;
    uint32_t next, shift = 64;
    for (next = 0; to != NULL && next < n; next++) {
        const uint64_t mask = leaf[next];
        if (2 * h->mask_count >= capacity) {
            from = capacity;
            capacity = from != 0 ? 2 * from : 1024;
            old = slot;
            slot = (voxrti_mask_slot *)voxrti_alloc_zero(h->mem, capacity, sizeof *slot);
            for (shift = 64, i = capacity; i > 1; i /= 2) shift--;
            for (i = 0; slot != NULL && i < from; i++) {
                if (old[i].mask == 0) continue;
                for (k = (size_t)(old[i].mask * 0x9e3779b97f4a7c15u >> shift); slot[k].mask != 0; looks++)
                    k = (k + 1) & (capacity - 1);
                slot[k] = old[i];
            }
            voxrti_free(h->mem, old);
            if (slot == NULL) return VOXRT_ERR_NO_MEMORY;
        }
        for (k = (size_t)(mask * 0x9e3779b97f4a7c15u >> shift); slot[k].mask != mask && slot[k].mask != 0; looks++)
            k = (k + 1) & (capacity - 1);
        if (looks > 65536 + 16 * (uint64_t)next) { /* half full: 1.5 are usual for a new one, and 0.5 for an old one */
            voxrti_free(h->mem, slot);
            return voxrti_share_masks_sorted(h, leaf, n, to);
        }
        if (slot[k].mask == 0) {
            void *p = h->mask;
            if (!voxrti_grow(h->mem, &p, &h->mask_capacity, h->mask_count, h->mask_count + 1, sizeof(uint64_t))) break;
            h->mask = (uint64_t *)p;
            h->mask[h->mask_count] = mask;
            slot[k].mask = mask;
            slot[k].number = (uint32_t)h->mask_count++;
        }
        to[next] = slot[k].number;
    }
    voxrti_free(h->mem, slot);
    return to != NULL && next == n ? VOXRT_OK : VOXRT_ERR_NO_MEMORY;
}

/* Runs and numbers of the nodes of interior level w. */
static voxrt_result voxrti_share_level(voxrti_sharer *h, uint32_t w) {
    const uint32_t n = h->s->level_nodes[w];
    uint32_t i, k, *run, *number;
    voxrti_intern set;
    int ok, pass;
    h->run[w] = run = (uint32_t *)voxrti_alloc_array(h->mem, n, sizeof(uint32_t));
    h->number[w] = number = (uint32_t *)voxrti_alloc_array(h->mem, n, sizeof(uint32_t));
    h->node = h->s->node + h->s->level_first[w];
    h->child = h->number[w + 1];
    h->child_first = w + 2 < h->s->wide ? h->s->level_first[w + 1] : 0;
    h->level_run = run;
    ok = run != NULL && number != NULL;
    for (pass = 0; ok && pass < 2; pass++) {
        memset(&set, 0, sizeof set);
        set.mem = h->mem;
        for (i = 0; ok && i < n; i++) {
            const voxrti_node *node = &h->node[i];
            uint64_t hash = 2;
            if (pass == 0) {
                const uint32_t *c = h->child + (node->child - h->child_first), m = voxrti_popcount64(node->mask);
                for (k = 0; k < m; k++) hash = voxrti_hash_mix(hash, c[k]);
                run[i] = voxrti_intern_get(&set, voxrti_hash_mix(hash, 0), i, voxrti_same_run, h);
                ok = run[i] != VOXRT_NO_NODE;
            } else {
                hash = voxrti_hash_mix(voxrti_hash_mix(voxrti_hash_mix(hash, node->mask), run[i]), 0);
                number[i] = voxrti_intern_get(&set, hash, i, voxrti_same_node, h);
                ok = number[i] != VOXRT_NO_NODE;
            }
        }
        voxrti_free(h->mem, set.slot);
    }
    return ok ? VOXRT_OK : VOXRT_ERR_NO_MEMORY;
}

/* Lay out the runs of all levels: t->node without `octant`, h->code. */
static voxrt_result voxrti_share_runs(voxrti_sharer *h) {
    const voxrt_tree *s = h->s;
    voxrt_tree *t = h->t;
    uint32_t *from = NULL, *below, *place, w, i, k; /* from, below: which nodes of s the runs of a level hold */
    uint64_t total = 0, n;
    t->level_nodes[0] = 1;
    for (w = 0; w + 1 < t->wide; w++) {
        t->level_first[w] = (uint32_t)total;
        total += t->level_nodes[w];
        for (i = 0, n = 0; i < s->level_nodes[w]; i++)
            if (h->run[w][i] == i) n += voxrti_popcount64(s->node[s->level_first[w] + i].mask);
        t->level_nodes[w + 1] = (uint32_t)n;
    }
    t->node_count = (uint32_t)total;
    t->node = (voxrti_node *)voxrti_alloc_zero(h->mem, (size_t)total + 1, sizeof(voxrti_node));
    h->code = (uint32_t *)voxrti_alloc_array(h->mem, t->level_nodes[t->wide - 1], sizeof(uint32_t));
    if (t->node == NULL || h->code == NULL) return VOXRT_ERR_NO_MEMORY;
    if (t->wide == 1) h->code[0] = h->number[0][0];
    for (w = 0; w + 1 < t->wide; w++) {
        const voxrti_node *node = s->node + s->level_first[w];
        const uint32_t last = w + 2 == t->wide, first = last ? 0 : s->level_first[w + 1];
        uint32_t at = 0;
        place = (uint32_t *)voxrti_alloc_array(h->mem, s->level_nodes[w], sizeof(uint32_t));
        below = last ? h->code : (uint32_t *)voxrti_alloc_array(h->mem, t->level_nodes[w + 1], sizeof(uint32_t));
        if (place == NULL || below == NULL) {
            voxrti_free(h->mem, place);
            if (!last) voxrti_free(h->mem, below);
            voxrti_free(h->mem, from);
            return VOXRT_ERR_NO_MEMORY;
        }
        memset(place, 0xff, (size_t)s->level_nodes[w] * sizeof *place);
        for (i = 0; i < t->level_nodes[w]; i++) {
            const uint32_t like = from != NULL ? from[i] : 0, run = h->run[w][like];
            voxrti_node *to = &t->node[t->level_first[w] + i];
            to->mask = node[like].mask;
            if (place[run] == VOXRT_NO_NODE) {
                const uint32_t c = node[like].child - first, m = voxrti_popcount64(to->mask);
                place[run] = at;
                for (k = 0; k < m; k++) below[at++] = last ? h->number[w + 1][c + k] : c + k;
            }
            to->child = place[run] + (last ? 0 : t->level_first[w] + t->level_nodes[w]);
        }
        voxrti_free(h->mem, place);
        voxrti_free(h->mem, from);
        from = last ? NULL : below;
    }
    return VOXRT_OK;
}

/* Masks and codes from the numbers of the leaf nodes that are kept. [2 mask_count] key, [mask_count] rank: room. */
static voxrt_result voxrti_share_codes(voxrti_sharer *h, uint64_t *key, uint32_t *rank) {
    voxrt_tree *t = h->t;
    const uint32_t n = t->level_nodes[t->wide - 1], block = (uint32_t)1 << VOXRTI_CODE_LOG;
    const size_t all = h->mask_count, common = all <= 65536 ? all : VOXRTI_COMMON;
    size_t i, masks;
    uint32_t pass;
    t->code = (uint16_t *)voxrti_alloc_array(h->mem, n, sizeof(uint16_t));
    t->extra = (uint32_t *)voxrti_alloc_zero(h->mem, ((size_t)n >> VOXRTI_CODE_LOG) + 1, sizeof(uint32_t));
    if (h->mask == NULL || t->code == NULL || t->extra == NULL) return VOXRT_ERR_NO_MEMORY;
    memset(rank, 0xff, all * sizeof *rank); /* masks in the order in which the codes name them: it decides ties */
    for (i = 0, masks = 0; i < n; i++) {
        uint32_t *to = &rank[h->code[i]];
        if (*to == VOXRT_NO_NODE) {
            key[masks] = h->mask[h->code[i]];
            *to = (uint32_t)masks++;
        }
        h->code[i] = *to;
    }
    memcpy(h->mask, key, all * sizeof *key);
    masks = common;
    for (i = 0; i < all; i++) key[i] = (uint64_t)0xffffffffu << 32 | i;
    for (i = 0; i < n; i++) key[h->code[i]] -= (uint64_t)1 << 32;
    voxrti_pal_sort(key, key + all, all); /* how often (descending) << 32 | number */
    for (i = 0; i < all; i++) rank[(uint32_t)key[i]] = (uint32_t)i;
    if (all <= 65536) {
        for (i = 0; i < n; i++) t->code[i] = (uint16_t)rank[h->code[i]];
    } else { /* upper half of key: of each mask the block that has it, and its place there */
        memset(key + all, 0, all * sizeof *key);
        for (pass = 0; pass < 2; pass++) {
            masks = common;
            for (i = 0; i < n; i++) {
                const uint32_t m = h->code[i];
                const size_t start = i >> VOXRTI_CODE_LOG << VOXRTI_CODE_LOG;
                const uint64_t stamp = (uint64_t)start / block + 1 + (uint64_t)pass * 0x80000000u;
                if (i == start) t->extra[i >> VOXRTI_CODE_LOG] = (uint32_t)(masks - common);
                if (rank[m] < common) {
                    t->code[i] = (uint16_t)rank[m];
                    continue;
                }
                if (key[all + m] >> 32 != stamp) {
                    key[all + m] = stamp << 32 | masks;
                    if (pass == 1) t->leaf[masks] = h->mask[m];
                    masks++;
                }
                t->code[i] = (uint16_t)((uint32_t)key[all + m] - t->extra[i >> VOXRTI_CODE_LOG]);
            }
            if (pass == 1) break;
            if (masks > 0xfffffff0u) return VOXRT_ERR_RANGE;
            t->leaf = (uint64_t *)voxrti_alloc_zero(h->mem, masks + 8, sizeof(uint64_t));
            if (t->leaf == NULL) return VOXRT_ERR_NO_MEMORY;
        }
    }
    if (t->leaf == NULL) t->leaf = (uint64_t *)voxrti_alloc_zero(h->mem, masks + 8, sizeof(uint64_t));
    if (t->leaf == NULL) return VOXRT_ERR_NO_MEMORY;
    for (i = 0; i < common; i++) t->leaf[i] = h->mask[(uint32_t)key[i]];
    t->mask_count = (uint32_t)masks;
    return VOXRT_OK;
}

/* What is below a node: cells of all levels, and the box of its voxels from its corner. */
typedef struct voxrti_part {
    uint32_t cells, lo[3], hi[3];
} voxrti_part;

/* The same of leaf nodes, and of those above them, in one word: bytes 16 - lo and hi along x, y, z, of which the
   largest are those of a whole; then octants and voxels, but only of a leaf node. */
#define VOXRTI_PART_BOX 0x0000ffffffffffffu

static uint64_t voxrti_part_leaf(uint64_t mask) {
    uint64_t p = (uint64_t)voxrti_popcount64(voxrti_octants(mask)) << 48 | (uint64_t)voxrti_popcount64(mask) << 56;
    uint32_t a;
    for (a = 0; a < 3; a++)
        p |= (uint64_t)(16 - voxrti_mask_lo(mask, a)) << 8 * a | (uint64_t)voxrti_mask_hi(mask, a) << (24 + 8 * a);
    return p;
}

static void voxrti_part_box(uint64_t packed, voxrti_part *p) {
    uint32_t a;
    for (a = 0; a < 3; a++) {
        p->lo[a] = 16 - ((uint32_t)(packed >> 8 * a) & 255u);
        p->hi[a] = (uint32_t)(packed >> (24 + 8 * a)) & 255u;
    }
}

typedef struct voxrti_shared_indexer {
    voxrt_tree *t;
    uint64_t *mask;         /* [mask_count] voxrti_part_leaf */
    uint16_t (*leaf)[2];    /* [nodes above leaf nodes] octants and voxels of their leaf nodes */
    uint64_t place[64];     /* what a box in cell s adds to the bytes of one in cell 0 */
} voxrti_shared_indexer;

/* The part of node n above leaf nodes, which begin at k. */
static void voxrti_shared_part_last(const voxrti_shared_indexer *x, uint64_t m, uint32_t k, voxrti_part *o,
                                    uint16_t leaf[2]) {
    const uint64_t high = 0x808080808080u;
    uint64_t box = 0, v, ge;
    uint32_t octants = 0, voxels = 0, n = 0;
    for (; m != 0; m &= m - 1, k++, n++) {
        v = x->mask[voxrti_leaf_at(x->t, k)];
        octants += (uint32_t)(v >> 48) & 255u;
        voxels += (uint32_t)(v >> 56);
        v = (v & VOXRTI_PART_BOX) + x->place[voxrti_ctz64(m)];
        ge = ((box | high) - v) & high; /* bytes in which the box is the larger one already */
        ge |= ge - (ge >> 7);
        box = (box & ge) | (v & ~ge);
    }
    voxrti_part_box(box, o);
    o->cells = n + octants + voxels;
    leaf[0] = (uint16_t)octants;
    leaf[1] = (uint16_t)voxels;
}

/* One level of voxrti_shared_index. below: parts of the level beneath it, NULL: leaf nodes. run: NULL: set `octant` of
   the children; else compare it, and runs must stand without gaps in the order in which they are named, for so they are
   written down. [nodes beneath] zeros, for the lengths of the runs. 0: not a tree; or too many cells. */
static int voxrti_shared_parts(const voxrti_shared_indexer *x, uint32_t w, const voxrti_part *below, voxrti_part *out,
                               uint8_t *run) {
    voxrt_tree *t = x->t;
    const uint32_t last = w + 2 == t->wide, first = last ? 0 : t->level_first[w + 1];
    const uint32_t size = (uint32_t)4 << 2 * (t->wide - 2 - w);
    uint32_t i, a, next = 0;
    for (i = 0; i < t->level_nodes[w]; i++) {
        const voxrti_node *n = &t->node[t->level_first[w] + i];
        const uint32_t children = voxrti_popcount64(n->mask);
        uint64_t cells = 0, m;
        uint32_t k = n->child - first;
        voxrti_part *o = &out[i];
        if (n->mask == 0 || n->child < first || k > t->level_nodes[w + 1] || children > t->level_nodes[w + 1] - k)
            return 0;
        if (run != NULL && k == next) {
            run[k] = (uint8_t)children;
            next += children;
        }
        if (run != NULL && (k >= next || run[k] != children)) return 0;
        if (last) {
            voxrti_shared_part_last(x, n->mask, k, o, x->leaf[i]);
            o->cells += 1 + voxrti_popcount64(voxrti_octants(n->mask));
            continue;
        }
        memset(o, 0, sizeof *o);
        o->lo[0] = o->lo[1] = o->lo[2] = 0xffffffffu;
        for (m = n->mask; m != 0; m &= m - 1, k++) {
            const uint32_t s = voxrti_ctz64(m), c[3] = {voxrti_slot_x(s) * size, voxrti_slot_y(s) * size,
                                                        voxrti_slot_z(s) * size};
            voxrti_node *child = &t->node[first + k];
            if (run == NULL) child->octant = (uint32_t)cells;
            else if (child->octant != cells) return 0;
            cells += below[k].cells;
            if (cells > 0xfffffffeu) return 0;
            for (a = 0; a < 3; a++) {
                if (c[a] + below[k].lo[a] < o->lo[a]) o->lo[a] = c[a] + below[k].lo[a];
                if (c[a] + below[k].hi[a] > o->hi[a]) o->hi[a] = c[a] + below[k].hi[a];
            }
        }
        cells += 1 + voxrti_popcount64(voxrti_octants(n->mask));
        if (cells > 0xfffffffeu) return 0;
        o->cells = (uint32_t)cells;
    }
    return run == NULL || next == t->level_nodes[w + 1];
}

/* Cells of each virtual level: how often each node is met, from the root down. The sum is known to be below 2^32. */
static voxrt_result voxrti_shared_counts(voxrti_mem *mem, const voxrti_shared_indexer *x) {
    voxrt_tree *t = x->t;
    uint64_t count[2 * VOXRTI_MAX_WIDE + 1];
    uint32_t w, i, k, *times = NULL, *below = NULL;
    memset(count, 0, sizeof count);
    count[0] = 1;
    for (w = 0; w + 1 < t->wide; w++, times = below) {
        const uint32_t last = w + 2 == t->wide, first = last ? 0 : t->level_first[w + 1];
        below = last ? NULL : (uint32_t *)voxrti_alloc_zero(mem, t->level_nodes[w + 1], sizeof(uint32_t));
        if (below == NULL && !last) {
            voxrti_free(mem, times);
            return VOXRT_ERR_NO_MEMORY;
        }
        for (i = 0; i < t->level_nodes[w]; i++) {
            const voxrti_node *n = &t->node[t->level_first[w] + i];
            const uint64_t met = times != NULL ? times[i] : 1;
            const uint32_t c = n->child - first, m = voxrti_popcount64(n->mask);
            count[2 * w + 1] += met * voxrti_popcount64(voxrti_octants(n->mask));
            count[2 * w + 2] += met * m;
            for (k = c; k < c + m && !last; k++) below[k] += (uint32_t)met;
            if (last) count[2 * w + 3] += met * x->leaf[i][0];
            if (last) count[2 * w + 4] += met * x->leaf[i][1];
        }
        voxrti_free(mem, times);
    }
    if (t->wide == 1) {
        count[1] = voxrti_popcount64(voxrti_octants(t->leaf[0]));
        count[2] = voxrti_popcount64(t->leaf[0]);
    }
    t->voxel_count = count[2 * t->wide];
    voxrti_attr_places(t, count);
    return VOXRT_OK;
}

/* The parts of all levels, bottom up; the root's. */
static voxrt_result voxrti_shared_levels(voxrti_mem *mem, const voxrti_shared_indexer *x, int write,
                                         voxrti_part *root) {
    const voxrt_tree *t = x->t;
    voxrti_part *below = NULL, *part = NULL;
    uint32_t w;
    for (w = t->wide - 1; w-- > 0; below = part) {
        uint8_t *run = write ? NULL : (uint8_t *)voxrti_alloc_zero(mem, t->level_nodes[w + 1], 1);
        int room, ok;
        part = (voxrti_part *)voxrti_alloc_array(mem, t->level_nodes[w], sizeof(voxrti_part));
        room = part != NULL && (write || run != NULL);
        ok = room && voxrti_shared_parts(x, w, below, part, run);
        voxrti_free(mem, below);
        voxrti_free(mem, run);
        if (ok) continue;
        voxrti_free(mem, part);
        return room ? VOXRT_ERR_FORMAT : VOXRT_ERR_NO_MEMORY;
    }
    if (part != NULL) *root = part[0];
    voxrti_free(mem, part);
    return VOXRT_OK;
}

static voxrt_result voxrti_shared_fill(voxrti_mem *mem, voxrti_shared_indexer *x, int write) {
    voxrt_tree *t = x->t;
    const uint32_t above = t->wide > 1 ? t->level_nodes[t->wide - 2] : 1;
    uint32_t i;
    uint64_t mask;
    voxrti_part root;
    voxrt_result r;
    x->mask = (uint64_t *)voxrti_alloc_array(mem, t->mask_count, sizeof(uint64_t));
    x->leaf = (uint16_t (*)[2])voxrti_alloc_array(mem, above, sizeof *x->leaf);
    if (x->mask == NULL || x->leaf == NULL) return VOXRT_ERR_NO_MEMORY;
    for (i = 0; i < t->mask_count; i++) {
        if (t->leaf[i] == 0) return VOXRT_ERR_FORMAT;
        x->mask[i] = voxrti_part_leaf(t->leaf[i]);
    }
    for (i = 0; i < t->level_nodes[t->wide - 1]; i++)
        if (voxrti_leaf_at(t, i) >= t->mask_count) return VOXRT_ERR_FORMAT;
    for (i = 0; i < 64; i++) { /* 2^24 - 1: what hi gains 16 - lo loses */
        mask = (uint64_t)voxrti_slot_x(i) | (uint64_t)voxrti_slot_y(i) << 8 | (uint64_t)voxrti_slot_z(i) << 16;
        x->place[i] = 4 * mask * 0xffffffu;
    }
    if (t->wide == 1 && voxrti_leaf_at(t, 0) != 0) return VOXRT_ERR_FORMAT;
    voxrti_part_box(x->mask[0], &root);
    r = voxrti_shared_levels(mem, x, write, &root);
    if (r != VOXRT_OK) return r;
    if (t->wide > 1 && write) t->node[0].octant = 0;
    if (t->wide > 1 && t->node[0].octant != 0) return VOXRT_ERR_FORMAT;
    mask = t->wide > 1 ? t->node[0].mask : t->leaf[0];
    if ((t->depth & 1u) != 0 && (mask & ~(uint64_t)0xff) != 0) return VOXRT_ERR_FORMAT;
    memcpy(t->cell_min, root.lo, sizeof root.lo);
    memcpy(t->cell_max, root.hi, sizeof root.hi);
    return voxrti_shared_counts(mem, x);
}

/* Given masks, children and codes of a shared tree, and level_first, level_nodes, derive the rest: cells before nodes
   (write; else check them), counts, box. ERR_FORMAT: they are not those of a tree, or of one with too many cells. */
static VOXRTI_UNUSED voxrt_result voxrti_shared_index(voxrti_mem *mem, voxrt_tree *t, int write) {
    voxrti_shared_indexer x;
    voxrt_result r;
    memset(&x, 0, sizeof x);
    x.t = t;
    r = voxrti_shared_fill(mem, &x, write);
    voxrti_free(mem, x.mask);
    voxrti_free(mem, x.leaf);
    return r;
}

/* Attributes of all cells from the order of plain tree s to that of a shared one, or back; either array may be NULL. */
static void voxrti_share_reorder(const voxrt_tree *s, int back, const uint16_t *normal, uint16_t *normal_to,
                                 const uint32_t *color, uint32_t *color_to) {
    struct { uint32_t node; uint64_t left, mask; } stack[VOXRTI_MAX_WIDE];
    uint64_t next[2 * VOXRTI_MAX_WIDE + 1], at = 0;
    uint32_t sp = 1, w, k;
    memcpy(next, s->attr_first, sizeof next);
    stack[0].node = 0;
    stack[0].left = 0;
    for (;;) { /* the node on top of the stack is new */
        uint64_t mask, i;
        uint32_t part, n[3];
        w = sp - 1;
        mask = w + 1 == s->wide ? s->leaf[stack[w].node] : s->node[stack[w].node].mask;
        n[0] = 1;
        n[1] = voxrti_popcount64(voxrti_octants(mask));
        n[2] = w + 1 == s->wide ? voxrti_popcount64(mask) : 0;
        for (part = 0; part < 3; part++) {
            const uint64_t from = back ? at : next[2 * w + part], to = back ? next[2 * w + part] : at;
            for (k = 0; k < n[part] && normal != NULL; k++) normal_to[to + k] = normal[from + k];
            for (k = 0; k < n[part] && color != NULL; k++) color_to[to + k] = color[from + k];
            if (n[part] != 0) next[2 * w + part] += n[part];
            at += n[part];
        }
        stack[w].mask = stack[w].left = w + 1 == s->wide ? 0 : mask;
        while (sp > 0 && stack[sp - 1].left == 0) sp--;
        if (sp == 0) return;
        mask = stack[sp - 1].mask;
        i = stack[sp - 1].left;
        stack[sp - 1].left &= i - 1;
        stack[sp].node = s->node[stack[sp - 1].node].child + voxrti_popcount64(mask & ((i & (0 - i)) - 1));
        sp++;
    }
}

/* Placement and palette of s for t, and its attributes in the order that t needs. plain: which of both is one. */
static voxrt_result voxrti_share_attributes(voxrti_mem *mem, const voxrt_env *env, const voxrt_tree *plain,
                                            const voxrt_tree *s, voxrt_tree *t) {
    const size_t n = (size_t)s->attr_count;
    uint32_t *from = NULL, *to = NULL;
    voxrt_result r = VOXRT_OK;
    size_t i;
    t->spherical = s->spherical;
    t->palette_count = s->palette_count;
    t->palette = (uint8_t *)voxrti_alloc_array(mem, s->palette_count, 3);
    if (t->palette == NULL) return VOXRT_ERR_NO_MEMORY;
    memcpy(t->palette, s->palette, (size_t)3 * s->palette_count);
    if (s->normal != NULL) {
        t->normal = (uint16_t *)voxrti_alloc_array(mem, n, sizeof(uint16_t));
        if (t->normal == NULL) return VOXRT_ERR_NO_MEMORY;
    }
    if (s->colors.block != NULL) {
        from = (uint32_t *)voxrti_alloc_array(mem, n, sizeof(uint32_t));
        to = (uint32_t *)voxrti_alloc_array(mem, n, sizeof(uint32_t));
        if (from == NULL || to == NULL) r = VOXRT_ERR_NO_MEMORY;
        for (i = 0; r == VOXRT_OK && i < n; i++) from[i] = voxrti_colors_get(&s->colors, i);
    }
    if (r == VOXRT_OK) voxrti_share_reorder(plain, plain == t, s->normal, t->normal, from, to);
    voxrti_free(mem, from);
    if (r == VOXRT_OK && to != NULL) r = voxrti_colors_encode(mem, env, to, n, &t->colors);
    voxrti_free(mem, to);
    return r;
}

static voxrt_result voxrti_share_finish(voxrti_sharer *h) {
    uint64_t *key = (uint64_t *)voxrti_alloc_array(h->mem, 2 * h->mask_count, sizeof(uint64_t));
    uint32_t *rank = (uint32_t *)voxrti_alloc_array(h->mem, h->mask_count, sizeof(uint32_t));
    voxrt_result r = VOXRT_ERR_NO_MEMORY;
    if (key != NULL && rank != NULL) r = voxrti_share_codes(h, key, rank);
    voxrti_free(h->mem, key);
    voxrti_free(h->mem, rank);
    return r;
}

/* t->leaf, t->code and t->extra from the masks of the leaf nodes of a shared tree. */
static VOXRTI_UNUSED voxrt_result voxrti_share_decoded(voxrti_mem *mem, voxrt_tree *t, const uint64_t *leaf) {
    const uint32_t n = t->level_nodes[t->wide - 1];
    voxrti_sharer h;
    voxrt_result r;
    memset(&h, 0, sizeof h);
    h.mem = mem;
    h.t = t;
    h.code = (uint32_t *)voxrti_alloc_array(mem, n, sizeof(uint32_t));
    r = voxrti_share_masks(&h, leaf, n, h.code);
    if (r == VOXRT_OK) r = voxrti_share_finish(&h);
    voxrti_free(mem, h.mask);
    voxrti_free(mem, h.code);
    return r;
}

/* The geometry of plain tree s, shared. */
static voxrt_result voxrti_share_geometry(voxrti_mem *mem, const voxrt_tree *s, voxrt_tree *t) {
    const uint32_t last = s->wide - 1;
    voxrti_sharer h;
    uint32_t w;
    voxrt_result r;
    memset(&h, 0, sizeof h);
    h.mem = mem;
    h.s = s;
    h.t = t;
    h.number[last] = (uint32_t *)voxrti_alloc_array(mem, s->level_nodes[last], sizeof(uint32_t));
    r = voxrti_share_masks(&h, s->leaf, s->level_nodes[last], h.number[last]);
    for (w = last; w-- > 0 && r == VOXRT_OK;) r = voxrti_share_level(&h, w);
    if (r == VOXRT_OK) r = voxrti_share_runs(&h);
    for (w = 0; w < s->wide; w++) {
        voxrti_free(mem, h.number[w]);
        voxrti_free(mem, h.run[w]);
    }
    if (r == VOXRT_OK) r = voxrti_share_finish(&h);
    voxrti_free(mem, h.mask);
    voxrti_free(mem, h.code);
    return r == VOXRT_OK ? voxrti_shared_index(mem, t, 1) : r;
}

/* The geometry of shared tree s, plain. */
static voxrt_result voxrti_unshare_geometry(voxrti_mem *mem, const voxrt_tree *s, voxrt_tree *t) {
    uint32_t *from = NULL, *below = NULL, w, i, k;
    uint64_t total = 0, n;
    for (w = 0; w < t->wide; w++) {
        n = (w == 0 ? s->attr_count : s->attr_first[2 * w - 1]) - s->attr_first[2 * w];
        if (w + 1 < t->wide) total += n;
        if (n > 0xfffffff0u || total > 0xfffffff0u) return VOXRT_ERR_RANGE;
        t->level_nodes[w] = (uint32_t)n;
    }
    t->node_count = (uint32_t)total;
    t->node = (voxrti_node *)voxrti_alloc_array(mem, (size_t)total + 1, sizeof(voxrti_node));
    t->leaf = (uint64_t *)voxrti_alloc_array(mem, (size_t)t->level_nodes[t->wide - 1] + 8, sizeof(uint64_t));
    t->rank = (uint32_t *)voxrti_alloc_array(mem, 2 * ((size_t)t->level_nodes[t->wide - 1] / 16 + 2), sizeof(uint32_t));
    if (t->node == NULL || t->leaf == NULL || t->rank == NULL) return VOXRT_ERR_NO_MEMORY;
    if (t->wide == 1) t->leaf[0] = s->leaf[0];
    for (w = 0, total = 0; w + 1 < t->wide; w++, from = below) {
        const uint32_t last = w + 2 == t->wide;
        size_t at = 0;
        below = last ? NULL : (uint32_t *)voxrti_alloc_array(mem, t->level_nodes[w + 1], sizeof(uint32_t));
        if (below == NULL && !last) {
            voxrti_free(mem, from);
            return VOXRT_ERR_NO_MEMORY;
        }
        for (i = 0; i < t->level_nodes[w]; i++) {
            const voxrti_node *node = &s->node[from != NULL ? from[i] : 0];
            const uint32_t m = voxrti_popcount64(node->mask);
            t->node[total++].mask = node->mask;
            for (k = 0; k < m; k++, at++) {
                if (last) t->leaf[at] = s->leaf[voxrti_leaf_at(s, node->child + k)];
                else below[at] = node->child + k;
            }
        }
        voxrti_free(mem, from);
    }
    return voxrti_tree_index(t);
}

static voxrt_result voxrti_share_convert(const voxrt_tree *s, const voxrt_env *env, int share, voxrt_tree **out_tree) {
    voxrt_env e;
    voxrti_mem mem;
    voxrt_tree *t, *other = NULL;
    voxrt_result r;
    if (out_tree == NULL) return VOXRT_ERR_INVALID_ARG;
    *out_tree = NULL;
    memset(&e, 0, sizeof e);
    if (env != NULL) e = *env;
    if (e.error != NULL) memset(e.error, 0, sizeof *e.error);
    if (s == NULL) return voxrti_fail(e.error, VOXRT_ERR_INVALID_ARG, 0, "no tree");
    r = voxrti_env_open(&e, &mem);
    if (r != VOXRT_OK) return r;
    if ((s->code != NULL) == share) { /* the same again: by way of the other kind */
        r = voxrti_share_convert(s, &e, !share, &other);
        if (other == NULL) return r;
        s = other;
    }
    t = (voxrt_tree *)voxrti_alloc_zero(&mem, 1, sizeof *t);
    if (t == NULL) r = VOXRT_ERR_NO_MEMORY;
    if (r == VOXRT_OK && share && s->attr_count > 0xfffffffeu) r = VOXRT_ERR_RANGE;
    if (r == VOXRT_OK) {
        t->cpu_level = s->cpu_level;
        t->depth = s->depth;
        t->wide = s->wide;
        t->resolution = s->resolution;
        memcpy(t->origin, s->origin, sizeof t->origin);
        t->voxel_size = s->voxel_size;
        r = share ? voxrti_share_geometry(&mem, s, t) : voxrti_unshare_geometry(&mem, s, t);
        memcpy(t->cell_min, s->cell_min, sizeof t->cell_min);
        memcpy(t->cell_max, s->cell_max, sizeof t->cell_max);
    }
    if (r == VOXRT_OK) r = voxrti_share_attributes(&mem, &e, share ? s : t, s, t);
    voxrt_tree_destroy(other);
    if (r != VOXRT_OK) {
        voxrti_tree_free(&mem, t);
        return voxrti_fail(e.error, r, 0, voxrt_result_string(r));
    }
    t->mem = mem;
    t->mem.limit = 0;
    *out_tree = t;
    return VOXRT_OK;
}

VOXRT_DEF voxrt_result voxrt_tree_share(const voxrt_tree *tree, const voxrt_env *env, voxrt_tree **out_tree) {
    return voxrti_share_convert(tree, env, 1, out_tree);
}

VOXRT_DEF voxrt_result voxrt_tree_unshare(const voxrt_tree *tree, const voxrt_env *env, voxrt_tree **out_tree) {
    return voxrti_share_convert(tree, env, 0, out_tree);
}

/* ---------------------------------------------------------------------------
   octree: the thesis' structure, for comparison and for its files.              // >>octree

   One array of blocks of 8 voxels, 64 bytes each and aligned to that: a cache line. A voxel is 8 bytes (see the public
   struct). Block 0 holds the root in its first voxel; so 0 as the number of a child block can mean "none". Blocks are
   only ever appended or renumbered in pre-order: a child's block has a higher number than its parent's, and sweeping
   the blocks from last to first visits children before parents.
   --------------------------------------------------------------------------- */

#define VOXRTI_MAX_BLOCKS 0x1fffffffu /* so that every voxel has a 32-bit index other than VOXRT_NO_NODE */

typedef struct voxrt_octree_voxel voxrti_voxel;

struct voxrt_octree {
    voxrti_mem mem;
    int cpu_level;
    uint32_t depth, resolution; /* resolution: kept for the way back to a tree */
    double origin[3], voxel_size;
    voxrti_voxel *voxel;        /* [8 * block_capacity] */
    size_t block_count, block_capacity;
    uint32_t has_normals;
    uint32_t palette_count;
    uint8_t *palette;           /* [3 * palette_count], at least one entry */
    uint32_t *grid;             /* start grids of octree levels 0 .. grid_level-1, one after the other; or NULL */
    uint32_t grid_level;
};

/* index, theta and phi as one number; all transparent voxels are equal, and all codes of the pole */
VOXRTI_INLINE uint32_t voxrti_voxel_key(const voxrti_voxel *v) {
    uint32_t k = (uint32_t)v->index | (uint32_t)v->theta << 16;
    if (v->theta != 0) k |= (uint32_t)(uint8_t)v->phi << 24;
    return v->index == 0 ? 0 : k;
}
VOXRTI_INLINE void voxrti_voxel_set(voxrti_voxel *v, uint32_t index, uint32_t sph) {
    v->index = (uint16_t)index;
    v->theta = (uint8_t)sph;
    v->phi = (int8_t)((int32_t)((sph >> 8 ^ 128u) & 255u) - 128);
}

/* ---- life ---- */

static void voxrti_octree_free(voxrti_mem *mem, voxrt_octree *t) {
    if (t == NULL) return;
    voxrti_free(mem, t->voxel);
    voxrti_free(mem, t->palette);
    voxrti_free(mem, t->grid);
    voxrti_free(mem, t);
}

VOXRT_DEF void voxrt_octree_destroy(voxrt_octree *octree) {
    if (octree != NULL) {
        voxrti_mem mem = octree->mem;
        voxrti_octree_free(&mem, octree);
    }
}

/* Room for `count` blocks. Blocks behind block_count are not zero. */
static int voxrti_octree_reserve(voxrt_octree *t, size_t count) {
    void *p = t->voxel;
    int ok = count <= VOXRTI_MAX_BLOCKS && voxrti_grow(&t->mem, &p, &t->block_capacity, t->block_count, count, 64);
    t->voxel = (voxrti_voxel *)p;
    return ok;
}

/* Append a block of transparent leaves; its number, or 0 when there is no memory. */
VOXRTI_INLINE uint32_t voxrti_octree_block(voxrt_octree *t) {
    if (t->block_count == t->block_capacity && !voxrti_octree_reserve(t, t->block_count + 1)) return 0;
    memset(t->voxel + 8 * t->block_count, 0, 64);
    return (uint32_t)t->block_count++;
}

/* Copy the desc, check it, take its memory. */
static voxrt_result voxrti_octree_open(const voxrt_octree_desc *desc, voxrt_octree_desc *d, voxrti_mem *mem) {
    voxrt_result r;
    memset(d, 0, sizeof *d);
    if (desc != NULL) *d = *desc;
    if (d->_begin_zero != 0 || d->_end_zero != 0) return VOXRT_ERR_UNINIT_DESC;
    if (d->env.error != NULL) memset(d->env.error, 0, sizeof *d->env.error);
    r = voxrti_box_check(d->env.error, d->box_min, d->box_size);
    if (r != VOXRT_OK) return r;
    if (d->grid_level > 10)
        return voxrti_fail(d->env.error, VOXRT_ERR_RANGE, d->grid_level, "start grid of level % is too fine");
    return voxrti_env_open(&d->env, mem);
}

/* A root without children. block_count: room to make. Takes mem over on success. */
static voxrt_octree *voxrti_octree_new(voxrti_mem *mem, size_t block_count, const uint8_t *palette,
                                       uint32_t palette_count) {
    voxrt_octree *t = (voxrt_octree *)voxrti_alloc_zero(mem, 1, sizeof *t);
    if (t == NULL) return NULL;
    t->mem = *mem;
    t->palette = (uint8_t *)voxrti_alloc_zero(&t->mem, (size_t)palette_count + (palette_count == 0), 3);
    if (block_count <= VOXRTI_MAX_BLOCKS) t->voxel = (voxrti_voxel *)voxrti_alloc_array(&t->mem, block_count, 64);
    t->block_capacity = block_count;
    if (t->palette == NULL || t->voxel == NULL) {
        *mem = t->mem;
        voxrti_octree_free(mem, t);
        return NULL;
    }
    if (palette_count != 0) memcpy(t->palette, palette, (size_t)3 * palette_count);
    t->palette_count = palette_count;
    t->cpu_level = voxrti_cpu_level();
    t->voxel_size = 1.0;
    t->has_normals = 1;
    (void)voxrti_octree_block(t);
    return t;
}

static voxrt_result voxrti_octree_fail(voxrt_octree *t, voxrt_error *error, voxrt_result r) {
    voxrt_octree_destroy(t);
    return voxrti_fail(error, r, 0, voxrt_result_string(r));
}

/* Placement for octrees that have none of their own, and the start grid. */
static voxrt_result voxrti_octree_finish(voxrt_octree *t, const voxrt_octree_desc *d, int place) {
    uint32_t g = d->grid_level != 0 ? d->grid_level : 7;
    if (place) {
        t->resolution = 1u << t->depth;
        if (d->box_size > 0) {
            memcpy(t->origin, d->box_min, sizeof t->origin);
            t->voxel_size = d->box_size / (double)t->resolution;
        }
    }
    if (d->disable_grid) return VOXRT_OK;
    return voxrt_octree_build_grid(t, g <= t->depth + 1 ? g : t->depth + 1);
}

VOXRT_DEF voxrt_result voxrt_octree_create(const voxrt_octree_desc *desc, uint32_t depth, const uint8_t *palette,
                                           uint32_t palette_count, voxrt_octree **out_octree) {
    voxrt_octree_desc d;
    voxrti_mem mem;
    voxrt_octree *t;
    voxrt_result r;
    if (out_octree == NULL) return VOXRT_ERR_INVALID_ARG;
    *out_octree = NULL;
    r = voxrti_octree_open(desc, &d, &mem);
    if (r != VOXRT_OK) return r;
    if (palette == NULL && palette_count != 0) return voxrti_fail(d.env.error, VOXRT_ERR_INVALID_ARG, 0, "no palette");
    if (depth > VOXRT_MAX_DEPTH) return voxrti_fail(d.env.error, VOXRT_ERR_RANGE, depth, "depth % is out of range");
    if (palette_count > 32767)
        return voxrti_fail(d.env.error, VOXRT_ERR_RANGE, palette_count, "an octree has at most 32767 colours, not %");
    t = voxrti_octree_new(&mem, 16, palette, palette_count);
    if (t == NULL) return voxrti_octree_fail(NULL, d.env.error, VOXRT_ERR_NO_MEMORY);
    t->depth = depth;
    d.disable_grid = 1; /* the first insertion would drop it */
    (void)voxrti_octree_finish(t, &d, 1);
    *out_octree = t;
    return VOXRT_OK;
}

/* ---- walking ---- */

/* All voxels in pre-order, which is the order of the file. */
typedef struct voxrti_walk {
    const voxrt_octree *t;
    uint32_t block[VOXRT_MAX_DEPTH + 1], i[VOXRT_MAX_DEPTH + 1];
    uint32_t sp, started;
    uint64_t parent;          /* Morton code of the parent of the next voxel */
    uint32_t voxel, level;    /* where we are */
    uint64_t code;            /* Morton code of the voxel's cell in its level */
} voxrti_walk;

static void voxrti_walk_start(voxrti_walk *w, const voxrt_octree *t) {
    memset(w, 0, sizeof *w);
    w->t = t;
}

static int voxrti_walk_next(voxrti_walk *w) {
    uint32_t children;
    if (!w->started) {
        w->started = 1;
    } else {
        while (w->sp > 0 && w->i[w->sp - 1] == 8) {
            w->sp--;
            w->parent >>= 3;
        }
        if (w->sp == 0) return 0;
        w->voxel = 8 * w->block[w->sp - 1] + w->i[w->sp - 1];
        w->code = w->parent << 3 | w->i[w->sp - 1]++;
    }
    w->level = w->sp;
    children = w->t->voxel[w->voxel].children;
    if (children != 0) {
        w->block[w->sp] = children;
        w->i[w->sp++] = 0;
        w->parent = w->code;
    }
    return 1;
}

VOXRT_DEF void voxrt_octree_get_info(const voxrt_octree *t, voxrt_octree_info *info) {
    voxrti_walk w;
    uint32_t g;
    if (info == NULL) return;
    memset(info, 0, sizeof *info);
    if (t == NULL) return;
    info->depth = t->depth;
    memcpy(info->world_origin, t->origin, sizeof t->origin);
    info->voxel_size = t->voxel_size;
    info->palette_count = t->palette_count;
    info->has_normals = t->has_normals;
    info->grid_level = t->grid != NULL ? t->grid_level : 0;
    voxrti_walk_start(&w, t);
    while (voxrti_walk_next(&w)) {
        const voxrti_voxel *v = &t->voxel[w.voxel];
        info->level_count[w.level]++;
        info->voxel_count++;
        if (v->children != 0) info->node_count++;
        else info->filled_leaves += v->index != 0;
    }
    info->leaf_count = info->voxel_count - info->node_count;
    info->voxel_bytes = 8 * info->voxel_count;
    for (g = 0; g < info->grid_level; g++) info->grid_bytes += (uint64_t)4 << 3 * g;
    info->total_bytes = (uint64_t)t->block_capacity * 64 + info->grid_bytes + (uint64_t)3 * t->palette_count;
    info->total_bytes += sizeof *t;
}

VOXRT_DEF const voxrt_octree_voxel *voxrt_octree_voxels(const voxrt_octree *octree, size_t *out_count) {
    if (out_count != NULL) *out_count = octree != NULL ? 8 * octree->block_count : 0;
    return octree != NULL ? octree->voxel : NULL;
}

VOXRT_DEF const uint8_t *voxrt_octree_palette(const voxrt_octree *octree, uint32_t *out_count) {
    if (out_count != NULL) *out_count = octree != NULL ? octree->palette_count : 0;
    return octree != NULL ? octree->palette : NULL;
}

VOXRTI_INLINE uint32_t voxrti_child(uint32_t x, uint32_t y, uint32_t z, uint32_t shift) {
    return (x >> shift & 1u) | (y >> shift & 1u) << 1 | (z >> shift & 1u) << 2;
}

VOXRT_DEF voxrt_octree_voxel voxrt_octree_get(const voxrt_octree *t, uint32_t level, uint32_t x, uint32_t y, uint32_t z,
                                              uint32_t *out_level) {
    voxrti_voxel v;
    uint32_t l = 0;
    memset(&v, 0, sizeof v);
    if (out_level != NULL) *out_level = 0;
    if (t == NULL || level > t->depth || (x | y | z) >> level != 0) return v;
    for (v = t->voxel[0]; l < level && v.children != 0; l++)
        v = t->voxel[8 * (size_t)v.children + voxrti_child(x, y, z, level - 1 - l)];
    if (out_level != NULL) *out_level = l;
    return v;
}

/* ---- changing ---- */

static void voxrti_octree_drop_grid(voxrt_octree *t) {
    voxrti_free(&t->mem, t->grid);
    t->grid = NULL;
    t->grid_level = 0;
}

VOXRT_DEF voxrt_result voxrt_octree_insert(voxrt_octree *t, uint32_t x, uint32_t y, uint32_t z, uint32_t index,
                                           const float normal[3]) {
    uint32_t l, vi = 0, i;
    if (t == NULL) return VOXRT_ERR_INVALID_ARG;
    if ((x | y | z) >> t->depth != 0 || index > t->palette_count) return VOXRT_ERR_RANGE;
    voxrti_octree_drop_grid(t);
    for (l = t->depth; l-- > 0;) {
        uint32_t b = t->voxel[vi].children;
        if (b == 0) {
            voxrti_voxel old = t->voxel[vi];
            b = voxrti_octree_block(t);
            if (b == 0) return VOXRT_ERR_NO_MEMORY;
            if (old.index != 0)
                for (i = 0; i < 8; i++) t->voxel[8 * (size_t)b + i] = old;
            t->voxel[vi].children = b;
        }
        vi = 8 * b + voxrti_child(x, y, z, l);
    }
    voxrti_voxel_set(&t->voxel[vi], index, index != 0 && normal != NULL ? voxrti_sph_encode(normal) : 0);
    return VOXRT_OK;
}

/* Thesis 3.1.4 for one parent: payload of `v` from its block of children. volume: of the leaves that vote for the
   index of each child. */
static void voxrti_octree_lod_voxel(voxrti_voxel *v, const voxrti_voxel *child, const uint64_t volume[8], int normals) {
    uint32_t i, k, best = 8, best_votes = 0;
    uint64_t best_volume = 0;
    float sum[3] = {0, 0, 0}, n[3];
    uint32_t sph;
    for (i = 0; i < 8; i++) {
        uint32_t votes = 0;
        uint64_t leaves = 0;
        if (child[i].index == 0) continue;
        for (k = 0; k < 8; k++) {
            if (child[k].index == child[i].index) {
                votes++;
                leaves += volume[k];
            }
        }
        if (best == 8 || votes > best_votes || (votes == best_votes && (leaves > best_volume ||
            (leaves == best_volume && child[i].index < child[best].index)))) {
            best = i;
            best_votes = votes;
            best_volume = leaves;
        }
        voxrti_sph_decode(child[i].theta, child[i].phi, n);
        sum[0] += n[0];
        sum[1] += n[1];
        sum[2] += n[2];
    }
    if (best == 8) {
        voxrti_voxel_set(v, 0, 0);
        return;
    }
    sph = (uint32_t)child[best].theta | (uint32_t)(uint8_t)child[best].phi << 8;
    if (!(sqrtf(voxrti_dot3(sum, sum)) < 1e-3f)) sph = voxrti_sph_encode(sum);
    voxrti_voxel_set(v, child[best].index, normals ? sph : 0);
}

VOXRT_DEF voxrt_result voxrt_octree_build_lod(voxrt_octree *t) {
    uint64_t *volume; /* of the filled leaves below a block */
    uint8_t *level;   /* of its voxels */
    size_t b, i;
    if (t == NULL) return VOXRT_ERR_INVALID_ARG;
    volume = (uint64_t *)voxrti_alloc_zero(&t->mem, t->block_count, sizeof *volume);
    level = (uint8_t *)voxrti_alloc_zero(&t->mem, t->block_count, 1);
    if (volume == NULL || level == NULL) {
        voxrti_free(&t->mem, volume);
        voxrti_free(&t->mem, level);
        return VOXRT_ERR_NO_MEMORY;
    }
    for (b = 0; b < t->block_count; b++)
        for (i = 0; i < 8; i++)
            if (t->voxel[8 * b + i].children != 0) level[t->voxel[8 * b + i].children] = (uint8_t)(level[b] + 1);
    for (b = t->block_count; b-- > 0;) {
        for (i = 0; i < 8; i++) {
            voxrti_voxel *v = &t->voxel[8 * b + i];
            const voxrti_voxel *child = t->voxel + 8 * (size_t)v->children;
            uint64_t w[8];
            uint32_t k;
            if (v->children == 0) {
                if (v->index != 0) volume[b] += (uint64_t)1 << 3 * (t->depth - level[b]);
                continue;
            }
            for (k = 0; k < 8; k++) {
                if (child[k].children != 0) w[k] = volume[child[k].children];
                else w[k] = (uint64_t)1 << 3 * (t->depth - level[v->children]);
            }
            voxrti_octree_lod_voxel(v, child, w, t->has_normals != 0);
            volume[b] += volume[v->children];
        }
    }
    voxrti_free(&t->mem, volume);
    voxrti_free(&t->mem, level);
    return VOXRT_OK;
}

/* If the children are equal leaves, `v` becomes that leaf. 1 when it did. */
VOXRTI_INLINE int voxrti_octree_merge(voxrti_voxel *v, const voxrti_voxel *child) {
    uint32_t i, key = voxrti_voxel_key(child), sph;
    for (i = 0; i < 8; i++)
        if (child[i].children != 0 || voxrti_voxel_key(child + i) != key) return 0;
    sph = key >> 16;
    voxrti_voxel_set(v, key & 0xffffu, sph);
    v->children = 0;
    return 1;
}

VOXRT_DEF voxrt_result voxrt_octree_collapse(voxrt_octree *t) {
    size_t b, i, kept = 1, at = 0;
    voxrti_voxel *out;
    voxrti_walk w;
    if (t == NULL) return VOXRT_ERR_INVALID_ARG;
    /* enough for what is kept: not all blocks may be in use */
    out = (voxrti_voxel *)voxrti_alloc_array(&t->mem, t->block_count, 64);
    if (out == NULL) return VOXRT_ERR_NO_MEMORY;
    voxrti_octree_drop_grid(t);
    for (b = t->block_count; b-- > 0;) {
        for (i = 0; i < 8; i++) {
            voxrti_voxel *v = &t->voxel[8 * b + i];
            if (v->children != 0) (void)voxrti_octree_merge(v, t->voxel + 8 * (size_t)v->children);
        }
    }
    memset(out, 0, 64);
    voxrti_walk_start(&w, t);
    { /* number[level]: new number of the block whose voxels the walk gives on that level */
        uint32_t number[VOXRT_MAX_DEPTH + 1];
        memset(number, 0, sizeof number);
        while (voxrti_walk_next(&w)) {
            voxrti_voxel v = t->voxel[w.voxel];
            at = 8 * (size_t)number[w.level] + (w.voxel & 7u);
            if (v.children != 0) {
                number[w.level + 1] = (uint32_t)kept++;
                v.children = number[w.level + 1];
            }
            out[at] = v;
        }
    }
    voxrti_free(&t->mem, t->voxel);
    t->voxel = out;
    t->block_capacity = t->block_count;
    t->block_count = kept;
    return VOXRT_OK;
}

/* ---- start grid ---- */

/* An entry holds what the tracer needs, without a look at the voxel: block of its children << 1 | 1 for an inner voxel,
   which is of the grid's own level; (edge of its box in leaf edges - 1) << 2 | filled << 1 for a leaf, of that level or
   larger. The grid of level l has 8^l cells, x fastest. */
#define voxrti_grid_first(l) (((((size_t)1) << 3 * (l)) - 1) / 7) /* start of the grid of octree level l */

VOXRTI_INLINE uint32_t voxrti_grid_entry(const voxrt_octree *t, const voxrti_voxel *v, uint32_t level) {
    if (v->children != 0) return v->children << 1 | 1u;
    return ((1u << (t->depth - level)) - 1u) << 2 | (v->index != 0 ? 2u : 0u);
}

VOXRT_DEF voxrt_result voxrt_octree_build_grid(voxrt_octree *t, uint32_t level) {
    uint32_t l, x, y, z;
    if (t == NULL) return VOXRT_ERR_INVALID_ARG;
    if (level > 10 || level > t->depth + 1) return VOXRT_ERR_RANGE;
    voxrti_octree_drop_grid(t);
    if (level == 0) return VOXRT_OK;
    t->grid = (uint32_t *)voxrti_alloc_array(&t->mem, voxrti_grid_first(level), sizeof *t->grid);
    if (t->grid == NULL) return VOXRT_ERR_NO_MEMORY;
    t->grid_level = level;
    t->grid[0] = voxrti_grid_entry(t, &t->voxel[0], 0);
    for (l = 1; l < level; l++) { /* each from the one above it */
        const uint32_t *from = t->grid + voxrti_grid_first(l - 1);
        uint32_t *to = t->grid + voxrti_grid_first(l), n = 1u << l;
        for (z = 0; z < n; z++) {
            for (y = 0; y < n; y++) {
                for (x = 0; x < n; x++) {
                    uint32_t e = from[((size_t)(z >> 1) * (n >> 1) + (y >> 1)) * (n >> 1) + (x >> 1)];
                    if (e & 1u) e = voxrti_grid_entry(t, &t->voxel[8 * (size_t)(e >> 1) + voxrti_child(x, y, z, 0)], l);
                    *to++ = e;
                }
            }
        }
    }
    return VOXRT_OK;
}

/* ---- from and to the wide tree ---- */

typedef struct voxrti_octree_frame { /* an inner voxel whose children are being filled */
    uint32_t voxel, block;
    uint32_t left;    /* children to come, one bit each */
    uint64_t mask;    /* of the wide node that the voxel is (even level), or is an octant of (odd) */
    uint64_t attr;    /* of the next child */
} voxrti_octree_frame;

typedef struct voxrti_octree_maker {
    voxrt_octree *t;
    const voxrt_tree *s;
    uint32_t *sph;    /* [65536] spherical + 1 by the tree's code, 0: not asked for yet */
    uint64_t next[2 * VOXRTI_MAX_WIDE + 1]; /* attributes of each virtual level, used in order */
} voxrti_octree_maker;

static void voxrti_octree_payload(voxrti_octree_maker *m, uint64_t attr, voxrti_voxel *v) {
    uint32_t sph = 0;
    if (m->s->normal != NULL) {
        uint32_t code = m->s->normal[attr];
        if (m->sph[code] == 0) {
            float n[3];
            voxrti_oct_decode(code, n);
            m->sph[code] = 1 + (m->s->spherical ? code : voxrti_sph_encode(n));
        }
        sph = m->sph[code] - 1;
    }
    voxrti_voxel_set(v, voxrti_color_index(m->s, attr) + 1, sph);
}

/* Give a voxel of virtual level v its block of children with their payloads; `bits` of them are filled. */
static int voxrti_octree_open_voxel(voxrti_octree_maker *m, voxrti_octree_frame *f, uint32_t v, uint32_t voxel,
                                    uint32_t bits, uint64_t mask) {
    uint32_t i;
    f->voxel = voxel;
    f->block = voxrti_octree_block(m->t);
    f->left = bits;
    f->mask = mask;
    f->attr = m->next[v + 1];
    if (f->block == 0) return 0;
    m->t->voxel[voxel].children = f->block;
    for (i = 0; i < 8; i++)
        if (bits >> i & 1u) voxrti_octree_payload(m, m->next[v + 1]++, &m->t->voxel[8 * (size_t)f->block + i]);
    return 1;
}

static uint64_t voxrti_wide_mask(const voxrt_tree *s, uint32_t v, uint64_t attr) { /* of the node that is this cell */
    size_t i = (size_t)(attr - s->attr_first[v]);
    return v / 2 + 1 == s->wide ? s->leaf[i] : s->node[s->level_first[v / 2] + i].mask;
}

/* Depth first, so that blocks are numbered in pre-order, and equal leaves can be taken back as soon as a block is
   complete: it is the last one then. */
static int voxrti_octree_make(voxrti_octree_maker *m, int collapse) {
    voxrti_octree_frame frame[2 * VOXRTI_MAX_WIDE + 1];
    const voxrt_tree *s = m->s;
    voxrt_octree *t = m->t;
    uint32_t top = 2 * s->wide - s->depth, v = top, k; /* v: virtual level of the innermost frame's voxel */
    uint64_t mask = s->wide > 1 ? s->node[0].mask : s->leaf[0];
    for (k = 0; k <= 2 * s->wide; k++) m->next[k] = s->attr_first[k];
    voxrti_octree_payload(m, m->next[v]++, &t->voxel[0]);
    k = v == 0 ? voxrti_octants(mask) : (uint32_t)mask & 255u;
    if (!voxrti_octree_open_voxel(m, &frame[v], v, 0, k, mask)) return 0;
    for (;;) {
        voxrti_octree_frame *f = &frame[v];
        if (f->left != 0 && v + 1 < 2 * s->wide) {
            uint32_t i = voxrti_ctz64(f->left), voxel = 8 * f->block + i;
            f->left &= f->left - 1;
            mask = (v & 1u) != 0 ? voxrti_wide_mask(s, v + 1, f->attr) : f->mask;
            f->attr++;
            k = (v & 1u) != 0 ? voxrti_octants(mask) : (uint32_t)(mask >> 8 * i) & 255u;
            v++;
            if (!voxrti_octree_open_voxel(m, &frame[v], v, voxel, k, mask)) return 0;
            continue;
        }
        if (collapse && voxrti_octree_merge(&t->voxel[f->voxel], t->voxel + 8 * (size_t)f->block)) t->block_count--;
        if (v == top) return 1;
        v--;
    }
}

/* Give back what growing by doubling has left over, if that is much and there is memory for the copy. */
static void voxrti_octree_trim(voxrt_octree *t) {
    voxrti_voxel *p;
    if (t->block_count > t->block_capacity - t->block_capacity / 8) return;
    p = (voxrti_voxel *)voxrti_alloc_array(&t->mem, t->block_count, 64);
    if (p == NULL) return;
    memcpy(p, t->voxel, 64 * t->block_count);
    voxrti_free(&t->mem, t->voxel);
    t->voxel = p;
    t->block_capacity = t->block_count;
}

VOXRT_DEF voxrt_result voxrt_octree_from_tree(const voxrt_octree_desc *desc, const voxrt_tree *s,
                                              voxrt_octree **out_octree) {
    voxrt_octree_desc d;
    voxrti_octree_maker m;
    voxrti_mem mem;
    voxrt_octree *t;
    voxrt_result r;
    uint64_t nodes;
    uint32_t top;
    if (out_octree == NULL) return VOXRT_ERR_INVALID_ARG;
    *out_octree = NULL;
    r = voxrti_octree_open(desc, &d, &mem);
    if (r != VOXRT_OK) return r;
    if (s == NULL) return voxrti_fail(d.env.error, VOXRT_ERR_INVALID_ARG, 0, "no tree");
    if (s->palette_count > 32767)
        return voxrti_fail(d.env.error, VOXRT_ERR_RANGE, s->palette_count,
                           "an octree has at most 32767 colours, not %");
    if (s->code != NULL) {
        voxrt_tree *plain;
        r = voxrt_tree_unshare(s, &d.env, &plain);
        if (r == VOXRT_OK) r = voxrt_octree_from_tree(desc, plain, out_octree);
        voxrt_tree_destroy(plain);
        return r;
    }
    top = 2 * s->wide - s->depth;
    nodes = s->attr_count - s->voxel_count - top; /* odd depth: the virtual root is not ours */
    if (nodes >= VOXRTI_MAX_BLOCKS) return voxrti_fail(d.env.error, VOXRT_ERR_RANGE, nodes, "% nodes are too many");
    /* When most blocks of leaves are full they may all collapse: grow. Else they hardly can: the exact size. */
    if (!d.disable_collapse && s->voxel_count >= 6 * (s->attr_first[2 * s->wide - 2] - s->attr_first[2 * s->wide - 1]))
        nodes = nodes < 1024 ? nodes : 1024;
    t = voxrti_octree_new(&mem, (size_t)nodes + 1, s->palette, s->palette_count);
    if (t == NULL) return voxrti_octree_fail(NULL, d.env.error, VOXRT_ERR_NO_MEMORY);
    t->depth = s->depth;
    t->resolution = s->resolution;
    memcpy(t->origin, s->origin, sizeof t->origin);
    t->voxel_size = s->voxel_size;
    t->has_normals = s->normal != NULL;
    memset(&m, 0, sizeof m);
    m.t = t;
    m.s = s;
    m.sph = (uint32_t *)voxrti_alloc_zero(&t->mem, 65536, sizeof *m.sph);
    if (m.sph == NULL || !voxrti_octree_make(&m, !d.disable_collapse)) r = VOXRT_ERR_NO_MEMORY;
    voxrti_free(&t->mem, m.sph);
    voxrti_octree_trim(t);
    if (r == VOXRT_OK && d.lod_majority) r = voxrt_octree_build_lod(t);
    if (r == VOXRT_OK) r = voxrti_octree_finish(t, &d, 0);
    if (r != VOXRT_OK) return voxrti_octree_fail(t, d.env.error, r);
    *out_octree = t;
    return VOXRT_OK;
}

/* Filled voxels of one level on their way into a tree. */
typedef struct voxrti_octree_cells {
    uint64_t count[VOXRT_MAX_DEPTH + 1]; /* of each level, large leaves cut up */
    uint32_t stale;                      /* a filled voxel in a transparent one: levels of detail were never made */
} voxrti_octree_cells;

static int voxrti_octree_count(const voxrt_octree *t, uint32_t depth, voxrti_octree_cells *n, size_t *blocks) {
    uint32_t clear[VOXRT_MAX_DEPTH + 1], l; /* transparent voxels above those of a level */
    uint64_t last = ~(uint64_t)0;
    voxrti_walk w;
    memset(n, 0, sizeof *n);
    memset(clear, 0, sizeof clear);
    *blocks = 0;
    voxrti_walk_start(&w, t);
    while (voxrti_walk_next(&w)) {
        const voxrti_voxel *v = &t->voxel[w.voxel];
        uint32_t bits = 3 * (depth - w.level);
        uint64_t code = w.code << bits, end = (w.code + 1) << bits;
        if (v->children != 0) {
            clear[w.level + 1] = clear[w.level] + (v->index == 0);
            n->count[w.level] += v->index != 0;
            continue;
        }
        if (v->index == 0) continue;
        if (end - code > 0xfffffffeu - n->count[depth]) return 0; /* too many */
        n->stale |= clear[w.level] != 0;
        *blocks += (size_t)(((end - 1) >> 6) - (code >> 6) + (code >> 6 != last));
        last = (end - 1) >> 6;
        for (l = w.level; l <= depth; l++) n->count[l] += (uint64_t)1 << 3 * (l - w.level);
    }
    return 1;
}

/* Fill the set's arrays: voxels as blocks of 4x4x4 in Morton order, behind them the attributes of the larger cells. A
   walk in pre-order meets the cells of each level in Morton order. */
static void voxrti_octree_leaves(const voxrt_octree *t, uint32_t depth, const voxrti_octree_cells *n,
                                 voxrti_leafset *set) {
    uint64_t next[VOXRT_MAX_DEPTH + 1], at = 0, last = ~(uint64_t)0, i;
    size_t blocks = 0;
    uint32_t l;
    voxrti_walk w;
    for (l = depth + 1; l-- > 0;) {
        next[l] = at;
        at += n->count[l];
    }
    voxrti_walk_start(&w, t);
    while (voxrti_walk_next(&w)) {
        const voxrti_voxel *v = &t->voxel[w.voxel];
        uint32_t bits = 3 * (depth - w.level), end = v->children != 0 ? w.level : depth;
        uint64_t code = w.code << bits;
        if (v->index == 0) continue;
        for (l = set->lod_count != 0 ? w.level : depth; l <= end; l++) {
            for (i = (uint64_t)1 << 3 * (l - w.level); i-- > 0; next[l]++) {
                set->rgb[next[l]] = v->index - 1u;
                if (set->normal != NULL)
                    set->normal[next[l]] = (uint16_t)((uint32_t)v->theta | (uint32_t)(uint8_t)v->phi << 8);
            }
        }
        for (i = v->children != 0 ? 0 : (uint64_t)1 << bits; i-- > 0; code++) {
            if (code >> 6 != last) {
                last = code >> 6;
                set->key[blocks] = last;
                set->mask[blocks++] = 0;
            }
            set->mask[blocks - 1] |= (uint64_t)1 << (code & 63u);
        }
    }
    VOXRT_ASSERT(blocks == set->block_count && next[depth] == set->voxel_count);
    if ((depth & 1u) != 0 && set->lod_count != 0) { /* the virtual root of a tree above its octant 0 */
        i = set->voxel_count + set->lod_count - 1;
        set->rgb[i] = set->rgb[i - 1];
        if (set->normal != NULL) set->normal[i] = set->normal[i - 1];
    }
}

VOXRT_DEF voxrt_result voxrt_tree_from_octree(const voxrt_octree_desc *desc, const voxrt_octree *t,
                                              voxrt_tree **out_tree) {
    voxrt_octree_desc d;
    voxrt_build_desc build;
    voxrti_mem mem;
    voxrti_grid grid;
    voxrti_leafset set;
    voxrti_octree_cells cells;
    uint32_t l;
    voxrt_result r;
    if (out_tree == NULL) return VOXRT_ERR_INVALID_ARG;
    *out_tree = NULL;
    r = voxrti_octree_open(desc, &d, &mem);
    if (r != VOXRT_OK) return r;
    if (t == NULL) return voxrti_fail(d.env.error, VOXRT_ERR_INVALID_ARG, 0, "no octree");
    memset(&build, 0, sizeof build);
    build.env = d.env;
    build.lod_method = VOXRT_LOD_MAJORITY;
    build.palette_size = 32767;
    memset(&grid, 0, sizeof grid);
    memcpy(grid.origin, t->origin, sizeof grid.origin);
    grid.depth = t->depth > 0 ? t->depth : 1; /* a tree has at least one level below the root */
    grid.resolution = t->depth > 0 ? t->resolution : 2;
    grid.voxel_size = t->depth > 0 ? t->voxel_size : 0.5 * t->voxel_size;
    memset(&set, 0, sizeof set);
    if (!voxrti_octree_count(t, grid.depth, &cells, &set.block_count))
        return voxrti_fail(d.env.error, VOXRT_ERR_RANGE, 0, "2^32 - 2 voxels or more");
    set.voxel_count = (size_t)cells.count[grid.depth];
    if (set.voxel_count == 0) return voxrti_fail(d.env.error, VOXRT_ERR_EMPTY, 0, "no voxel is filled");
    if (!cells.stale) {
        for (l = 0; l < grid.depth; l++) set.lod_count += (size_t)cells.count[l];
        set.lod_count += grid.depth & 1u;
    }
    set.spherical = 1;
    set.key = (uint64_t *)voxrti_alloc_array(&mem, set.block_count, sizeof *set.key);
    set.mask = (uint64_t *)voxrti_alloc_array(&mem, set.block_count, sizeof *set.mask);
    set.rgb = (uint32_t *)voxrti_alloc_array(&mem, set.voxel_count + set.lod_count, sizeof *set.rgb);
    if (t->has_normals)
        set.normal = (uint16_t *)voxrti_alloc_array(&mem, set.voxel_count + set.lod_count, sizeof *set.normal);
    if (set.key == NULL || set.mask == NULL || set.rgb == NULL || (t->has_normals && set.normal == NULL)) {
        voxrti_leafset_free(&mem, &set);
        return voxrti_fail(d.env.error, VOXRT_ERR_NO_MEMORY, 0, voxrt_result_string(VOXRT_ERR_NO_MEMORY));
    }
    voxrti_octree_leaves(t, grid.depth, &cells, &set);
    return voxrti_tree_from_leafset_palette(&mem, &build, &grid, &set, t->palette, t->palette_count, NULL, out_tree);
}

/* ---------------------------------------------------------------------------
   format v4: the thesis' .vox file.                                             // >>format_v4

   "MB", u16 version 4, u16 N, N x RGB, "||", then one 4-byte record a voxel in pre-order: u16 (index << 1 | node),
   u8 theta, i8 phi; after a node come its 8 children. Little-endian. Neither placement nor depth are stored.
   Versions 1 to 3 existed but were never documented.
   --------------------------------------------------------------------------- */

VOXRTI_INLINE size_t voxrti_v4_header(uint32_t palette_count) { return 8 + (size_t)3 * palette_count; }

static void voxrti_v4_write(const voxrt_octree *t, uint8_t *p) {
    voxrti_walk w;
    p[0] = 0x4d;
    p[1] = 0x42;
    voxrti_store_u16(p + 2, 4);
    voxrti_store_u16(p + 4, t->palette_count);
    memcpy(p + 6, t->palette, (size_t)3 * t->palette_count);
    p += voxrti_v4_header(t->palette_count);
    p[-2] = p[-1] = 0x7c;
    voxrti_walk_start(&w, t);
    for (; voxrti_walk_next(&w); p += 4) {
        const voxrti_voxel *v = &t->voxel[w.voxel];
        voxrti_store_u16(p, (uint32_t)v->index << 1 | (v->children != 0));
        p[2] = v->theta;
        p[3] = (uint8_t)v->phi;
    }
}

static size_t voxrti_v4_size(const voxrt_octree *t) {
    voxrt_octree_info info;
    voxrt_octree_get_info(t, &info);
    return voxrti_v4_header(t->palette_count) + (size_t)(4 * info.voxel_count);
}

static voxrt_result voxrti_v4_save_open(const voxrt_octree *t, const voxrt_env *env, voxrt_env *e, voxrti_mem *mem) {
    memset(e, 0, sizeof *e);
    if (env != NULL) *e = *env;
    if (e->error != NULL) memset(e->error, 0, sizeof *e->error);
    if (t == NULL) return voxrti_fail(e->error, VOXRT_ERR_INVALID_ARG, 0, "no octree");
    return voxrti_env_open(e, mem);
}

VOXRT_DEF voxrt_result voxrt_octree_save_memory(const voxrt_octree *octree, const voxrt_env *env, void *buffer,
                                                size_t capacity, size_t *out_size) {
    voxrt_env e;
    voxrti_mem mem;
    voxrt_result r;
    if (out_size == NULL) return VOXRT_ERR_INVALID_ARG;
    *out_size = 0;
    r = voxrti_v4_save_open(octree, env, &e, &mem);
    if (r != VOXRT_OK) return r;
    *out_size = voxrti_v4_size(octree);
    if (buffer == NULL) return VOXRT_OK;
    if (capacity < *out_size)
        return voxrti_fail(e.error, VOXRT_ERR_RANGE, *out_size, "the buffer is smaller than % bytes");
    voxrti_v4_write(octree, (uint8_t *)buffer);
    return VOXRT_OK;
}

/* One record. Mirrored axes mirror the normal: phi -> -phi, theta -> pi - theta (255 for -z, which has no code). */
static uint32_t voxrti_v4_record(const voxrt_octree_desc *d, const uint8_t *p, voxrti_voxel *v) {
    uint32_t w = voxrti_load_u16(p), theta = d->swap_angles ? p[3] : p[2], phi = d->swap_angles ? p[2] : p[3];
    if (d->flip_y) phi = (0u - phi) & 255u;
    if (d->flip_z) theta = theta == 0 ? 255 : 256 - theta;
    voxrti_voxel_set(v, w >> 1, theta | phi << 8);
    v->children = 0;
    return w & 1u;
}

/* The voxels behind the header. t has room for as many blocks as `size` bytes can hold complete. */
static voxrt_result voxrti_v4_read(voxrt_octree *t, const voxrt_octree_desc *d, const uint8_t *p, size_t size,
                                   size_t at) {
    voxrt_error *error = d->env.error;
    uint32_t block[VOXRT_MAX_DEPTH], i[VOXRT_MAX_DEPTH], sp = 0, vi = 0;
    uint32_t flip = (d->flip_y ? 2u : 0u) | (d->flip_z ? 4u : 0u);
    for (;;) {
        if (size - at < 4) return voxrti_fail(error, VOXRT_ERR_TRUNCATED, size, "the voxels end early, at byte %");
        if (voxrti_v4_record(d, p + at, &t->voxel[vi])) {
            if (sp == VOXRT_MAX_DEPTH)
                return voxrti_fail(error, VOXRT_ERR_FORMAT, at, "deeper than 20 levels at byte %");
            if (t->block_count == t->block_capacity)
                return voxrti_fail(error, VOXRT_ERR_TRUNCATED, size, "the voxels end early, at byte %");
            block[sp] = t->voxel[vi].children = voxrti_octree_block(t);
            i[sp++] = 0;
            if (sp > t->depth) t->depth = sp;
        }
        if (t->voxel[vi].index > t->palette_count)
            return voxrti_fail(error, VOXRT_ERR_FORMAT, at, "palette index out of range at byte %");
        at += 4;
        while (sp > 0 && i[sp - 1] == 8) sp--;
        if (sp == 0) break;
        vi = 8 * block[sp - 1] + (i[sp - 1]++ ^ flip);
    }
    if (at == size) return VOXRT_OK;
    return voxrti_fail(error, VOXRT_ERR_FORMAT, at, "more data behind the last voxel, at byte %");
}

VOXRT_DEF voxrt_result voxrt_octree_load_memory(const voxrt_octree_desc *desc, const void *data, size_t size,
                                                voxrt_octree **out_octree) {
    voxrt_octree_desc d;
    voxrti_mem mem;
    voxrt_octree *t;
    const uint8_t *p = (const uint8_t *)data;
    size_t at;
    uint32_t n;
    voxrt_result r;
    if (out_octree == NULL) return VOXRT_ERR_INVALID_ARG;
    *out_octree = NULL;
    r = voxrti_octree_open(desc, &d, &mem);
    if (r != VOXRT_OK) return r;
    if (p == NULL && size != 0) return voxrti_fail(d.env.error, VOXRT_ERR_INVALID_ARG, 0, "no data");
    if ((size > 0 && p[0] != 0x4d) || (size > 1 && p[1] != 0x42))
        return voxrti_fail(d.env.error, VOXRT_ERR_FORMAT, 0, "not a .vox file of version 4");
    if (size >= 4 && voxrti_load_u16(p + 2) != 4)
        return voxrti_fail(d.env.error, VOXRT_ERR_VERSION, voxrti_load_u16(p + 2), "version % is unknown");
    if (size < 6) return voxrti_fail(d.env.error, VOXRT_ERR_TRUNCATED, size, "the header ends early, at byte %");
    n = voxrti_load_u16(p + 4);
    if (n > 32767) return voxrti_fail(d.env.error, VOXRT_ERR_FORMAT, 4, "more than 32767 colours");
    at = voxrti_v4_header(n);
    if (size < at) return voxrti_fail(d.env.error, VOXRT_ERR_TRUNCATED, size, "the palette ends early, at byte %");
    if ((p[at - 2] != 0x7c || p[at - 1] != 0x7c))
        (void)voxrti_fail(d.env.error, VOXRT_OK, at - 2, "warning: unusual separator at byte %");
    t = voxrti_octree_new(&mem, (size - at) / 32 + 2, p + 6, n);
    if (t == NULL) return voxrti_octree_fail(NULL, d.env.error, VOXRT_ERR_NO_MEMORY);
    r = voxrti_v4_read(t, &d, p, size, at);
    if (r == VOXRT_OK) {
        r = voxrti_octree_finish(t, &d, 1);
        if (r != VOXRT_OK) (void)voxrti_fail(d.env.error, r, 0, voxrt_result_string(r));
    }
    if (r != VOXRT_OK) {
        voxrt_octree_destroy(t);
        return r;
    }
    *out_octree = t;
    return VOXRT_OK;
}

#ifndef VOXRT_NO_STDIO
static voxrt_result voxrti_write_file(voxrti_mem *mem, const char *path, const void *data, size_t size);
static voxrt_result voxrti_read_file(voxrti_mem *mem, const char *path, void **data, size_t *size);

VOXRT_DEF voxrt_result voxrt_octree_save_file(const voxrt_octree *octree, const voxrt_env *env, const char *path) {
    voxrt_env e;
    voxrti_mem mem;
    uint8_t *data;
    size_t size;
    voxrt_result r = voxrti_v4_save_open(octree, env, &e, &mem);
    if (r != VOXRT_OK) return r;
    if (path == NULL) return voxrti_fail(e.error, VOXRT_ERR_INVALID_ARG, 0, "no path");
    size = voxrti_v4_size(octree);
    data = (uint8_t *)voxrti_alloc(&mem, size);
    if (data == NULL) {
        r = VOXRT_ERR_NO_MEMORY;
    } else {
        voxrti_v4_write(octree, data);
        r = voxrti_write_file(&mem, path, data, size);
    }
    voxrti_free(&mem, data);
    return r == VOXRT_OK ? r : voxrti_fail(e.error, r, 0, voxrt_result_string(r));
}

VOXRT_DEF voxrt_result voxrt_octree_load_file(const voxrt_octree_desc *desc, const char *path,
                                              voxrt_octree **out_octree) {
    voxrt_octree_desc d;
    voxrti_mem mem;
    voxrt_result r;
    void *data;
    size_t size;
    if (out_octree == NULL) return VOXRT_ERR_INVALID_ARG;
    *out_octree = NULL;
    r = voxrti_octree_open(desc, &d, &mem);
    if (r != VOXRT_OK) return r;
    if (path == NULL) return voxrti_fail(d.env.error, VOXRT_ERR_INVALID_ARG, 0, "no path");
    r = voxrti_read_file(&mem, path, &data, &size);
    if (r != VOXRT_OK) return voxrti_fail(d.env.error, r, 0, voxrt_result_string(r));
    if (d.env.memory_limit != 0) /* what the file itself holds counts */
        d.env.memory_limit = d.env.memory_limit > mem.used ? d.env.memory_limit - mem.used : 1;
    r = voxrt_octree_load_memory(&d, data, size, out_octree);
    voxrti_free(&mem, data);
    return r;
}
#endif

/* ---------------------------------------------------------------------------
   format: version 5 files, a voxrt_tree as core describes it.                  // >>format

   Little-endian. 64-byte header, table of sections, sections in the order of their ids, each at the next multiple of
   64 bytes; what lies between is zero. Every byte is covered by a checksum or must be zero. docs/formats.md has the
   byte tables. Raw sections are the arrays of the tree. Coded sections are chunks of 4096 items that decode
   independently, range coded (rANS: Duda 2013) with static tables: 12-bit frequencies of a byte in up to 256 contexts.
   --------------------------------------------------------------------------- */

#define VOXRTI_V5_HEADER 64u
#define VOXRTI_V5_ENTRY 40u
#define VOXRTI_V5_PLACE 144u
#define VOXRTI_V5_SHARING_HEAD 48u
#define VOXRTI_V5_MAX_SECTIONS 64u
#define VOXRTI_V5_OPTIONAL 0x80000000u /* flag in an id: readers that do not know it skip the section */

enum { /* ids */
    VOXRTI_V5_PLACEMENT = 1, VOXRTI_V5_PALETTE = 2, VOXRTI_V5_NODES = 3, VOXRTI_V5_LEAVES = 4, VOXRTI_V5_RANKS = 5,
    VOXRTI_V5_GEOMETRY = 6, VOXRTI_V5_NORMALS = 7, VOXRTI_V5_BLOCKS = 8, VOXRTI_V5_COLORS = 9,
    VOXRTI_V5_SHARING = 10, VOXRTI_V5_CODES = 11, VOXRTI_V5_EXTRA = 12, VOXRTI_V5_IDS = 13
};
enum { /* flags of the header */
    VOXRTI_V5_RAW_FILE = 1, VOXRTI_V5_HAS_NORMALS = 2, VOXRTI_V5_HAS_COLORS = 4, VOXRTI_V5_SPHERICAL = 8,
    VOXRTI_V5_SHARED = 16
};

static const uint8_t voxrti_v5_magic[8] = {0x89, 0x56, 0x4f, 0x58, 0x0d, 0x0a, 0x1a, 0x0a}; /* 89 V O X CR LF ^Z LF */

VOXRT_DEF uint32_t voxrt_file_kind(const void *data, size_t size) {
    const uint8_t *p = (const uint8_t *)data;
    if (p == NULL || size < 4) return 0;
    if (size >= 12 && memcmp(p, voxrti_v5_magic, 8) == 0 && voxrti_load_u16(p + 8) == 5) return 5;
    return p[0] == 0x4d && p[1] == 0x42 && p[2] == 4 && p[3] == 0 ? 4 : 0;
}

/* Any change within one aligned 8-byte word changes it: each step is invertible. */
static uint64_t voxrti_v5_checksum(const uint8_t *data, size_t size) {
    return voxrti_hash_bytes(0x243f6a8885a308d3u ^ size, data, size);
}

/* ---- coded sections ----

   u32 chunk count, u32 bytes of the tables, u16 bytes of each chunk, tables, chunks. Tables: two that groups of 128
   contexts share, then one for each of 256 contexts; a context with an empty table uses its group's. */

#define VOXRTI_CHUNK 4096u
#define VOXRTI_CHUNK_SYMBOLS (9u * VOXRTI_CHUNK) /* most symbols of a chunk: octant mask and 8 bytes a node */
#define VOXRTI_RANS_BITS 12
#define VOXRTI_RANS_ONE (1u << VOXRTI_RANS_BITS)
#define VOXRTI_RANS_LOW 65536u   /* states are in [LOW, 2^32), 16 bits go in and out */
#define VOXRTI_CONTEXTS 256u
#define VOXRTI_TABLES (VOXRTI_CONTEXTS + 2u)

/* mirror[b][m]: bit i of mask m moves to bit i ^ b. It turns what cell b of 2x2x2 sees into what cell 0 would. */
static void voxrti_mirror_table(uint8_t mirror[8][256]) {
    uint32_t b, m, i;
    for (b = 0; b < 8; b++) {
        for (m = 0; m < 256; m++) {
            uint32_t r = 0;
            for (i = 0; i < 8; i++) r |= (m >> i & 1u) << (i ^ b);
            mirror[b][m] = (uint8_t)r;
        }
    }
}

typedef struct voxrti_symbols { /* what a chunk is made of */
    uint8_t context[VOXRTI_CHUNK_SYMBOLS];
    uint8_t symbol[VOXRTI_CHUNK_SYMBOLS];
    uint32_t count;
} voxrti_symbols;

/* Fill `out` with the symbols of a chunk. Any thread. */
typedef void voxrti_source_fn(const void *user, uint32_t chunk, voxrti_symbols *out);

typedef struct voxrti_bytes {
    voxrti_mem *mem;
    uint8_t *data;
    size_t size, capacity;
} voxrti_bytes;

/* Room for n more bytes, not yet counted in size; NULL: no memory. */
static uint8_t *voxrti_bytes_more(voxrti_bytes *b, size_t n) {
    void *p = b->data;
    int ok = n <= (size_t)-1 - b->size && voxrti_grow(b->mem, &p, &b->capacity, b->size, b->size + n, 1);
    b->data = (uint8_t *)p;
    return ok ? b->data + b->size : NULL;
}

/* Frequencies that sum up to 4096, none of a symbol that occurs is 0. */
static void voxrti_frequencies(const uint64_t count[256], uint16_t freq[256]) {
    uint64_t total = 0;
    uint32_t i, sum = 0, most = 0, f[256];
    for (i = 0; i < 256; i++) total += count[i];
    memset(freq, 0, 256 * sizeof *freq);
    if (total == 0) return;
    for (i = 0; i < 256; i++) {
        /* counts are below 2^34, the product fits */
        f[i] = (uint32_t)((count[i] * VOXRTI_RANS_ONE + total / 2) / total);
        if (f[i] == 0 && count[i] != 0) f[i] = 1;
        sum += f[i];
    }
    while (sum != VOXRTI_RANS_ONE) {
        for (i = 0; i < 256; i++)
            if (f[i] > f[most]) most = i;
        if (sum < VOXRTI_RANS_ONE) {
            f[most] += VOXRTI_RANS_ONE - sum;
            break;
        }
        f[most]--;
        sum--;
    }
    for (i = 0; i < 256; i++) freq[i] = (uint16_t)f[i];
}

static uint8_t *voxrti_put_varint(uint8_t *p, uint32_t v) { /* v < 16384 */
    if (v < 128) {
        *p++ = (uint8_t)v;
        return p;
    }
    *p++ = (uint8_t)(v | 128u);
    *p++ = (uint8_t)(v >> 7);
    return p;
}

#define VOXRTI_CODE_SLICES 8u /* tasks that count, at least */
#define VOXRTI_CODE_PART 16u  /* chunks coded by one task */

typedef struct voxrti_encoder {
    voxrti_mem *mem;
    voxrti_source_fn *source;
    const void *user;
    uint32_t chunks, slice; /* slice: chunks counted by one task */
    uint32_t *tally;        /* [slices][VOXRTI_CONTEXTS * 256] */
    voxrti_bytes *part;     /* [parts] */
    uint8_t *sizes;         /* u16 of each chunk */
    size_t *place;          /* [parts] where they go in out */
    uint8_t *out;
    uint32_t failed;        /* atomic */
    uint64_t count[VOXRTI_TABLES][256];
    uint16_t freq[VOXRTI_TABLES][256], start[VOXRTI_TABLES][256];
    uint16_t table[VOXRTI_CONTEXTS];
    uint16_t price[VOXRTI_RANS_ONE + 1]; /* of a symbol of this frequency, in 1/256 bit */
} voxrti_encoder;

static void voxrti_encode_count_task(void *ctx, uint32_t task) {
    voxrti_encoder *e = (voxrti_encoder *)ctx;
    voxrti_symbols *s = (voxrti_symbols *)voxrti_alloc(e->mem, sizeof *s);
    uint32_t *tally = e->tally + (size_t)task * VOXRTI_CONTEXTS * 256, i;
    uint32_t k = task * e->slice, end = e->chunks - k < e->slice ? e->chunks : k + e->slice;
    memset(tally, 0, VOXRTI_CONTEXTS * 256 * sizeof *tally);
    if (s == NULL) voxrti_atomic_store(&e->failed, 1u);
    for (; s != NULL && k < end; k++) {
        e->source(e->user, k, s);
        for (i = 0; i < s->count; i++) tally[(uint32_t)s->context[i] << 8 | s->symbol[i]]++;
    }
    voxrti_free(e->mem, s);
}

/* Tables from the counts of the 256 contexts: those that do not pay for themselves join their group's. */
static void voxrti_encoder_tables(voxrti_encoder *e) {
    uint32_t c, i, g;
    for (i = 1; i <= VOXRTI_RANS_ONE; i++)
        e->price[i] = (uint16_t)(256.0 * ((double)VOXRTI_RANS_BITS - voxrti_log2((double)i)) + 0.5);
    for (c = 0; c < VOXRTI_CONTEXTS; c++)
        for (i = 0; i < 256; i++) e->count[c / 128][i] += e->count[2 + c][i];
    for (g = 0; g < 2; g++) voxrti_frequencies(e->count[g], e->freq[g]);
    for (c = 0; c < VOXRTI_CONTEXTS; c++) {
        uint64_t shared = 0, own = 0;
        voxrti_frequencies(e->count[2 + c], e->freq[2 + c]);
        for (i = 0; i < 256; i++) {
            if (e->count[2 + c][i] == 0) continue;
            shared += e->count[2 + c][i] * e->price[e->freq[c / 128][i]];
            own += e->count[2 + c][i] * e->price[e->freq[2 + c][i]] + (e->freq[2 + c][i] < 128 ? 16u : 24u) * 256u;
        }
        e->table[c] = (uint16_t)(own < shared ? 2 + c : c / 128);
    }
    memset(e->count, 0, 2 * sizeof e->count[0]);
    for (c = 0; c < VOXRTI_CONTEXTS; c++) {
        if (e->table[c] == 2 + c) continue;
        for (i = 0; i < 256; i++) e->count[c / 128][i] += e->count[2 + c][i];
        memset(e->freq[2 + c], 0, sizeof e->freq[2 + c]);
    }
    for (g = 0; g < 2; g++) voxrti_frequencies(e->count[g], e->freq[g]);
    for (c = 0; c < VOXRTI_TABLES; c++) {
        uint32_t sum = 0;
        for (i = 0; i < 256; i++) {
            e->start[c][i] = (uint16_t)sum;
            sum += e->freq[c][i];
        }
    }
}

/* Write the tables; NULL: only their size. */
static size_t voxrti_encoder_write_tables(const voxrti_encoder *e, uint8_t *p) {
    uint8_t one[8] = {0, 0, 0, 0, 0, 0, 0, 0}, *from = p;
    size_t size = 0;
    uint32_t c, i, n;
    for (c = 0; c < VOXRTI_TABLES; c++) {
        for (i = 0, n = 0; i < 256; i++) n += e->freq[c][i] != 0;
        size += (size_t)(voxrti_put_varint(p != NULL ? p : one, n) - (p != NULL ? p : one));
        if (p != NULL) p = from + size;
        for (i = 0; i < 256; i++) {
            if (e->freq[c][i] == 0) continue;
            if (p != NULL) *p++ = (uint8_t)i;
            size += 1 + (size_t)(voxrti_put_varint(p != NULL ? p : one, e->freq[c][i]) - (p != NULL ? p : one));
            if (p != NULL) p = from + size;
        }
    }
    return size;
}

/* Code the symbols, last one first, so that they decode in order. Returns the bytes written to p. Whether a word leaves
   the state cannot be foretold, so there is no branch; words are put down from the end of the room for them. */
static uint32_t voxrti_encode_chunk(const voxrti_encoder *e, const voxrti_symbols *s, uint16_t *words, uint8_t *p) {
    uint32_t x = VOXRTI_RANS_LOW, n = 0, i;
    for (i = s->count; i-- > 0;) {
        uint32_t t = e->table[s->context[i]], f = e->freq[t][s->symbol[i]], full;
        full = x >= (uint64_t)f << (32 - VOXRTI_RANS_BITS);
        words[n] = (uint16_t)x;
        n += full;
        x >>= 16 * full;
        x = ((x / f) << VOXRTI_RANS_BITS) + x % f + e->start[t][s->symbol[i]];
    }
    voxrti_store_u32(p, x);
    for (i = 0; i < n; i++) voxrti_store_u16(p + 4 + 2 * i, words[n - 1 - i]);
    return 4 + 2 * n;
}

static void voxrti_encode_task(void *ctx, uint32_t task) {
    voxrti_encoder *e = (voxrti_encoder *)ctx;
    voxrti_bytes *part = &e->part[task];
    voxrti_symbols *s = (voxrti_symbols *)voxrti_alloc(e->mem, sizeof *s);
    uint16_t *words = (uint16_t *)voxrti_alloc_array(e->mem, VOXRTI_CHUNK_SYMBOLS + 1, sizeof(uint16_t));
    uint32_t k = task * VOXRTI_CODE_PART, end = e->chunks - k < VOXRTI_CODE_PART ? e->chunks : k + VOXRTI_CODE_PART, n;
    int ok = s != NULL && words != NULL;
    part->mem = e->mem;
    for (; ok && k < end; k++) {
        uint8_t *p;
        e->source(e->user, k, s);
        p = voxrti_bytes_more(part, 4 + 2 * (size_t)s->count);
        ok = p != NULL;
        if (!ok) break;
        n = voxrti_encode_chunk(e, s, words, p);
        voxrti_store_u16(e->sizes + (size_t)2 * k, n); /* 12 bits a symbol at most: below 2^16 */
        part->size += n;
    }
    voxrti_free(e->mem, s);
    voxrti_free(e->mem, words);
    if (!ok) voxrti_atomic_store(&e->failed, 1u);
}

static void voxrti_encode_place_task(void *ctx, uint32_t task) {
    voxrti_encoder *e = (voxrti_encoder *)ctx;
    memcpy(e->out + e->place[task], e->part[task].data, e->part[task].size);
    voxrti_free(e->mem, e->part[task].data);
    e->part[task].data = NULL;
}

static voxrt_result voxrti_encode_run(voxrti_encoder *e, const voxrt_env *env, uint32_t slices, uint32_t parts,
                                      voxrti_bytes *out) {
    size_t tables, fixed = 8 + (size_t)2 * e->chunks, total;
    uint32_t i, k;
    voxrti_parallel_for(env, voxrti_encode_count_task, e, slices);
    if (voxrti_atomic_load(&e->failed)) return VOXRT_ERR_NO_MEMORY;
    for (k = 0; k < slices; k++)
        for (i = 0; i < VOXRTI_CONTEXTS * 256; i++)
            e->count[2 + i / 256][i % 256] += e->tally[(size_t)k * VOXRTI_CONTEXTS * 256 + i];
    voxrti_encoder_tables(e);
    tables = voxrti_encoder_write_tables(e, NULL);
    voxrti_parallel_for(env, voxrti_encode_task, e, parts);
    if (voxrti_atomic_load(&e->failed)) return VOXRT_ERR_NO_MEMORY;
    for (k = 0, total = fixed + tables; k < parts; k++) {
        e->place[k] = total;
        total += e->part[k].size;
    }
    e->out = out->data = (uint8_t *)voxrti_alloc(e->mem, total);
    if (e->out == NULL) return VOXRT_ERR_NO_MEMORY;
    out->size = out->capacity = total;
    voxrti_store_u32(e->out, e->chunks);
    voxrti_store_u32(e->out + 4, (uint32_t)tables);
    memcpy(e->out + 8, e->sizes, (size_t)2 * e->chunks);
    (void)voxrti_encoder_write_tables(e, e->out + fixed);
    voxrti_parallel_for(env, voxrti_encode_place_task, e, parts);
    return VOXRT_OK;
}

/* Code `chunks` chunks of symbols into `out`, which is empty. */
static voxrt_result voxrti_encode(voxrti_mem *mem, const voxrt_env *env, voxrti_source_fn *source, const void *user,
                                  uint32_t chunks, voxrti_bytes *out) {
    voxrti_encoder *e = (voxrti_encoder *)voxrti_alloc_zero(mem, 1, sizeof *e);
    uint32_t parts = (chunks + VOXRTI_CODE_PART - 1) / VOXRTI_CODE_PART, slices, k;
    voxrt_result r = VOXRT_ERR_NO_MEMORY;
    if (e == NULL) return r;
    e->mem = mem;
    e->source = source;
    e->user = user;
    e->chunks = chunks;
    e->slice = chunks / VOXRTI_CODE_SLICES + 1;
    if (e->slice > 65536) e->slice = 65536; /* counts stay below 2^32 */
    slices = (chunks + e->slice - 1) / e->slice;
    e->tally = (uint32_t *)voxrti_alloc_array(mem, slices, VOXRTI_CONTEXTS * 256 * sizeof(uint32_t));
    e->part = (voxrti_bytes *)voxrti_alloc_zero(mem, parts, sizeof(voxrti_bytes));
    e->place = (size_t *)voxrti_alloc_array(mem, parts, sizeof(size_t));
    e->sizes = (uint8_t *)voxrti_alloc_array(mem, chunks, 2);
    if (e->tally != NULL && e->part != NULL && e->place != NULL && e->sizes != NULL)
        r = voxrti_encode_run(e, env, slices, parts, out);
    for (k = 0; e->part != NULL && k < parts; k++) voxrti_free(mem, e->part[k].data);
    voxrti_free(mem, e->tally);
    voxrti_free(mem, e->part);
    voxrti_free(mem, e->place);
    voxrti_free(mem, e->sizes);
    voxrti_free(mem, e);
    return r;
}

typedef struct voxrti_rans_table {
    uint32_t range[256]; /* frequency | sum of the frequencies before << 16 */
    uint8_t symbol[VOXRTI_RANS_ONE];
} voxrti_rans_table;

typedef struct voxrti_decoder {
    voxrti_rans_table *table;
    const voxrti_rans_table *of[VOXRTI_CONTEXTS];
    const uint8_t *data;
    uint64_t *offset;   /* [chunks + 1] in data */
    uint32_t chunks;
    uint32_t bad;       /* atomic: a chunk did not decode */
} voxrti_decoder;

static void voxrti_decoder_close(voxrti_mem *mem, voxrti_decoder *d) {
    voxrti_free(mem, d->table);
    voxrti_free(mem, d->offset);
    memset(d, 0, sizeof *d);
}

static int voxrti_get_varint(const uint8_t **p, const uint8_t *end, uint32_t *v) {
    if (*p == end) return 0;
    *v = *(*p)++;
    if (*v < 128) return 1;
    if (*p == end || **p == 0 || **p > 127) return 0; /* one form for each number */
    *v = (*v & 127u) | (uint32_t)*(*p)++ << 7;
    return 1;
}

static int voxrti_read_table(const uint8_t **p, const uint8_t *end, uint32_t n, voxrti_rans_table *t) {
    uint32_t i, sum = 0, last = 0;
    memset(t, 0, sizeof *t);
    for (i = 0; i < n; i++) {
        uint32_t s, f;
        if (*p == end) return 0;
        s = *(*p)++;
        if ((i != 0 && s <= last) || !voxrti_get_varint(p, end, &f) || f == 0 || f > VOXRTI_RANS_ONE - sum) return 0;
        t->range[s] = f | sum << 16;
        memset(t->symbol + sum, (int)s, f);
        sum += f;
        last = s;
    }
    return sum == VOXRTI_RANS_ONE;
}

/* Read tables and chunk sizes of a coded section with exactly `chunks` chunks. */
static voxrt_result voxrti_decoder_open(voxrti_mem *mem, const uint8_t *data, size_t size, uint64_t chunks,
                                        voxrti_decoder *d) {
    const uint8_t *p, *end;
    uint32_t pass, c, used = 0;
    size_t tables, k;
    uint64_t at = 0;
    memset(d, 0, sizeof *d);
    if (size < 8 || voxrti_load_u32(data) != chunks || chunks > (size - 8) / 6) return VOXRT_ERR_FORMAT;
    tables = voxrti_load_u32(data + 4);
    if (tables > size - 8 - 2 * (size_t)chunks) return VOXRT_ERR_FORMAT;
    d->chunks = (uint32_t)chunks;
    d->offset = (uint64_t *)voxrti_alloc_array(mem, (size_t)chunks + 1, sizeof(uint64_t));
    if (d->offset == NULL) return VOXRT_ERR_NO_MEMORY;
    for (k = 0; k < chunks; k++) {
        uint32_t n = voxrti_load_u16(data + 8 + 2 * k);
        if (n < 4 || (n & 1u) != 0) return VOXRT_ERR_FORMAT;
        d->offset[k] = at;
        at += n;
    }
    d->offset[k] = at;
    if (at != size - 8 - 2 * (size_t)chunks - tables) return VOXRT_ERR_FORMAT;
    d->data = data + 8 + 2 * (size_t)chunks + tables;
    end = d->data;
    for (pass = 0; pass < 2; pass++) { /* count, then read; table 0 stands for "none" and gives symbol 0 for ever */
        p = data + 8 + 2 * (size_t)chunks;
        if (pass == 1) {
            d->table = (voxrti_rans_table *)voxrti_alloc_array(mem, used + 1, sizeof(voxrti_rans_table));
            if (d->table == NULL) return VOXRT_ERR_NO_MEMORY;
            memset(&d->table[0], 0, sizeof d->table[0]);
            d->table[0].range[0] = VOXRTI_RANS_ONE;
            for (c = 0; c < VOXRTI_CONTEXTS; c++) d->of[c] = &d->table[0];
        }
        for (c = 0, used = 0; c < VOXRTI_TABLES; c++) {
            uint32_t n, i, f;
            if (!voxrti_get_varint(&p, end, &n) || n > 256) return VOXRT_ERR_FORMAT;
            if (n == 0) continue;
            used++;
            if (pass == 1) {
                if (!voxrti_read_table(&p, end, n, &d->table[used])) return VOXRT_ERR_FORMAT;
                if (c < 2) for (i = 0; i < 128; i++) d->of[128 * c + i] = &d->table[used];
                else d->of[c - 2] = &d->table[used];
                continue;
            }
            for (i = 0; i < n; i++)
                if (p == end || (p++, !voxrti_get_varint(&p, end, &f))) return VOXRT_ERR_FORMAT;
        }
        if (p != end) return VOXRT_ERR_FORMAT;
    }
    return VOXRT_OK;
}

typedef struct voxrti_rans {
    const uint8_t *p, *end;
    uint32_t x, bad;
} voxrti_rans;

static void voxrti_rans_open(const voxrti_decoder *d, uint32_t chunk, voxrti_rans *r) {
    r->p = d->data + d->offset[chunk];
    r->end = d->data + d->offset[chunk + 1];
    r->x = voxrti_load_u32(r->p);
    r->p += 4;
    r->bad = r->x < VOXRTI_RANS_LOW;
}

/* No branches: whether a word is read cannot be foretold. Behind the last word that word is read again. */
VOXRTI_INLINE uint32_t voxrti_rans_get(voxrti_rans *r, const voxrti_rans_table *t) {
    uint32_t slot = r->x & (VOXRTI_RANS_ONE - 1), s = t->symbol[slot], range = t->range[s];
    uint32_t x = (range & 0xffffu) * (r->x >> VOXRTI_RANS_BITS) + slot - (range >> 16), need = x < VOXRTI_RANS_LOW;
    uint32_t more = need & (uint32_t)(r->p < r->end), word = voxrti_load_u16(r->p - 2 + 2 * more);
    r->bad |= need ^ more;
    r->p += 2 * more;
    word |= x << 16;
    r->x = need ? word : x;
    return s;
}

/* Everything was read and the state is the one that the encoder began with. */
VOXRTI_INLINE int voxrti_rans_done(const voxrti_rans *r) {
    return r->bad == 0 && r->p == r->end && r->x == VOXRTI_RANS_LOW;
}

/* ---- coded geometry ----

   The octree's child masks, level by level: of each node of a wide level the octant mask (children at octree level
   2w+1), then the bytes of its octants. Each is coded in the context of the cell's siblings (the mask that the cell is
   a bit of), both mirrored so that the cell is number 0; the bytes of the finest level in a group of their own.
   Of a shared tree the nodes that are kept, each run as the children of the node that names it first, its owner. The
   section `sharing` says which nodes are owners, and which run the others name. */

typedef struct voxrti_family { /* goes through the nodes of a level with the masks that they are bits of */
    const voxrti_node *parent, *base;
    const uint32_t *owner; /* shared trees: the next parent's place behind base; NULL: it is the next node */
    uint64_t mask, left;
} voxrti_family;

static const voxrti_node voxrti_root_family = {1, 0, 0};

/* Bit of the next node among its siblings; *siblings = their mask. */
VOXRTI_INLINE uint32_t voxrti_family_next(voxrti_family *f, uint32_t *siblings) {
    uint32_t s;
    if (f->left == 0) {
        f->parent = f->owner != NULL ? f->base + *f->owner++ : f->parent + 1;
        f->left = f->mask = f->parent->mask;
    }
    s = voxrti_ctz64(f->left);
    f->left &= f->left - 1;
    *siblings = (uint32_t)(f->mask >> (s & 56u)) & 255u;
    return s & 7u;
}

static uint64_t voxrti_chunks(const voxrt_tree *t) {
    uint64_t n = 0;
    uint32_t w;
    for (w = 0; w < t->wide; w++) n += ((uint64_t)t->level_nodes[w] + VOXRTI_CHUNK - 1) / VOXRTI_CHUNK;
    return n;
}

typedef struct voxrti_geometry_source {
    const voxrt_tree *t;
    uint32_t *owner;                        /* shared trees: [node_count], from level_first[w] on those of level w */
    uint32_t owner_count[VOXRTI_MAX_WIDE];
    uint8_t mirror[8][256];
} voxrti_geometry_source;

/* The node whose child `at` of level w >= 1 is, and what is left of its children from there on. */
static voxrti_family voxrti_family_of(const voxrti_geometry_source *g, uint32_t w, uint32_t at) {
    const voxrt_tree *t = g->t;
    uint32_t lo = t->level_first[w - 1], k;
    uint32_t hi = lo + (g->owner != NULL ? g->owner_count[w - 1] : t->level_nodes[w - 1]);
    voxrti_family f;
    if (w + 1 < t->wide) at += t->level_first[w];
    while (hi - lo > 1) {
        uint32_t mid = lo + (hi - lo) / 2;
        if (t->node[g->owner != NULL ? g->owner[mid] : mid].child <= at) lo = mid;
        else hi = mid;
    }
    f.base = t->node;
    f.owner = NULL;
    if (g->owner != NULL) {
        f.owner = g->owner + lo + 1;
        lo = g->owner[lo];
    }
    f.parent = &t->node[lo];
    f.mask = f.left = f.parent->mask;
    for (k = at - f.parent->child; k > 0; k--) f.left &= f.left - 1;
    return f;
}

static void voxrti_geometry_symbols(const void *user, uint32_t chunk, voxrti_symbols *out) {
    const voxrti_geometry_source *g = (const voxrti_geometry_source *)user;
    const voxrt_tree *t = g->t;
    uint32_t w, at, end, n = 0, group, o, k;
    voxrti_family family;
    for (w = 0;; w++) { /* the level that it is of */
        k = (uint32_t)(((uint64_t)t->level_nodes[w] + VOXRTI_CHUNK - 1) / VOXRTI_CHUNK);
        if (chunk < k) break;
        chunk -= k;
    }
    at = chunk * VOXRTI_CHUNK;
    family.parent = family.base = &voxrti_root_family;
    family.owner = NULL;
    family.mask = family.left = 1;
    if (w != 0) family = voxrti_family_of(g, w, at);
    group = w + 1 == t->wide ? 128 : 0;
    end = t->level_nodes[w] - at < VOXRTI_CHUNK ? t->level_nodes[w] : at + VOXRTI_CHUNK;
    for (; at < end; at++) {
        uint64_t mask = group ? t->leaf[voxrti_leaf_at(t, at)] : t->node[t->level_first[w] + at].mask;
        uint32_t octants = voxrti_octants(mask), siblings, b = voxrti_family_next(&family, &siblings);
        out->context[n] = g->mirror[b][siblings] >> 1;
        out->symbol[n++] = g->mirror[b][octants];
        for (k = octants; k != 0; k &= k - 1) {
            o = voxrti_ctz64(k);
            out->context[n] = (uint8_t)(group + (g->mirror[o][octants] >> 1));
            out->symbol[n++] = g->mirror[o][mask >> (8 * o) & 255u];
        }
    }
    out->count = n;
}

/* Owners of runs; and `out`, the section that tells them: stored nodes of each level, masks, 0 (u32 each); a bit for
   each interior node, 1: an owner; u32 for each other one: first node of its run, counted from 0 in the level. */
static voxrt_result voxrti_sharing(voxrti_geometry_source *g, voxrti_bytes *out, int raw) {
    const voxrt_tree *t = g->t;
    const size_t bits = raw ? 0 : ((size_t)t->node_count + 7) / 8;
    uint32_t w, i;
    uint8_t *p;
    p = voxrti_bytes_more(out, VOXRTI_V5_SHARING_HEAD + bits);
    if (p == NULL) return VOXRT_ERR_NO_MEMORY;
    memset(p, 0, VOXRTI_V5_SHARING_HEAD + bits);
    for (w = 0; w < t->wide; w++) voxrti_store_u32(p + 4 * w, t->level_nodes[w]);
    voxrti_store_u32(p + 40, t->mask_count);
    out->size = VOXRTI_V5_SHARING_HEAD + bits;
    if (raw) return VOXRT_OK;
    g->owner = (uint32_t *)voxrti_alloc_array(out->mem, (size_t)t->node_count + 1, sizeof(uint32_t));
    if (g->owner == NULL) return VOXRT_ERR_NO_MEMORY;
    for (w = 0; w + 1 < t->wide; w++) {
        const uint32_t first = w + 2 < t->wide ? t->level_first[w + 1] : 0;
        uint32_t next = first, n = 0;
        for (i = t->level_first[w]; i < t->level_first[w] + t->level_nodes[w]; i++) {
            if (t->node[i].child == next) {
                next += voxrti_popcount64(t->node[i].mask);
                g->owner[t->level_first[w] + n++] = i;
                out->data[VOXRTI_V5_SHARING_HEAD + i / 8] |= (uint8_t)(1u << (i & 7u));
                continue;
            }
            p = voxrti_bytes_more(out, 4);
            if (p == NULL) return VOXRT_ERR_NO_MEMORY;
            voxrti_store_u32(p, t->node[i].child - first);
            out->size += 4;
        }
        g->owner_count[w] = n;
    }
    return VOXRT_OK;
}

typedef struct voxrti_geometry_decoder {
    voxrti_decoder d;
    voxrt_tree *t;
    uint64_t *leaf;           /* masks of the leaf nodes: t->leaf, or on their way there */
    const uint8_t *sharing;   /* shared trees: that section, NULL: a plain one */
    size_t sharing_size, sharing_at; /* what was read of it */
    uint32_t *owner, owner_count;    /* [node_count] owners of level w */
    uint32_t w, first_chunk;  /* of the level in work */
    uint32_t *start;          /* per chunk: parent node of its first node, and how many of the parent's are before */
    uint8_t mirror[8][256];
} voxrti_geometry_decoder;

typedef struct voxrti_geometry_lane { /* of one chunk */
    voxrti_family family;
    voxrti_rans r;
    uint32_t i, end, bad; /* next node of the level */
} voxrti_geometry_lane;

static void voxrti_geometry_open(const voxrti_geometry_decoder *g, uint32_t chunk, voxrti_geometry_lane *l) {
    const voxrt_tree *t = g->t;
    voxrti_family family;
    uint32_t k;
    l->i = chunk * VOXRTI_CHUNK;
    l->end = t->level_nodes[g->w] - l->i < VOXRTI_CHUNK ? t->level_nodes[g->w] : l->i + VOXRTI_CHUNK;
    l->bad = 0;
    family.parent = family.base = &voxrti_root_family;
    family.owner = NULL;
    if (g->w != 0 && g->sharing != NULL) {
        family.base = t->node;
        family.owner = g->owner + g->start[2 * chunk];
        family.parent = t->node + *family.owner++;
    } else if (g->w != 0) {
        family.parent = t->node + t->level_first[g->w - 1] + g->start[2 * chunk];
    }
    family.mask = family.left = family.parent->mask;
    for (k = g->w != 0 ? g->start[2 * chunk + 1] : 0; k > 0; k--) family.left &= family.left - 1;
    l->family = family;
    voxrti_rans_open(&g->d, g->first_chunk + chunk, &l->r);
}

VOXRTI_INLINE uint32_t voxrti_geometry_first(const voxrti_geometry_decoder *g, voxrti_geometry_lane *l) {
    uint32_t siblings, b = voxrti_family_next(&l->family, &siblings), octants;
    octants = g->mirror[b][voxrti_rans_get(&l->r, g->d.of[g->mirror[b][siblings] >> 1])];
    l->bad |= octants == 0;
    return octants;
}

VOXRTI_INLINE uint64_t voxrti_geometry_byte(const voxrti_geometry_decoder *g, uint32_t group, uint32_t octants,
                                            uint32_t k, voxrti_geometry_lane *l) {
    const uint32_t o = voxrti_ctz64(k), s = voxrti_rans_get(&l->r, g->d.of[group + (g->mirror[o][octants] >> 1)]);
    l->bad |= s == 0;
    return (uint64_t)g->mirror[o][s] << (8 * o);
}

VOXRTI_INLINE void voxrti_geometry_put(const voxrti_geometry_decoder *g, uint32_t group, voxrti_geometry_lane *l,
                                       uint64_t mask) {
    if (group) g->leaf[l->i++] = mask;
    else g->t->node[g->t->level_first[g->w] + l->i++].mask = mask;
}

/* Two chunks in turn: while a symbol of one is looked up, one of the other can be. */
static void voxrti_geometry_task(void *ctx, uint32_t task) {
    voxrti_geometry_decoder *g = (voxrti_geometry_decoder *)ctx;
    const uint32_t group = g->w + 1 == g->t->wide ? 128 : 0;
    const uint32_t chunks = (uint32_t)(((uint64_t)g->t->level_nodes[g->w] + VOXRTI_CHUNK - 1) / VOXRTI_CHUNK);
    voxrti_geometry_lane a, b;
    voxrti_geometry_open(g, 2 * task, &a);
    if (2 * task + 1 < chunks) {
        voxrti_geometry_open(g, 2 * task + 1, &b);
        while (b.i < b.end) { /* the first one is whole */
            const uint32_t p = voxrti_geometry_first(g, &a), q = voxrti_geometry_first(g, &b);
            uint32_t i = p, k = q;
            uint64_t m = 0, n = 0;
            for (; i != 0 && k != 0; i &= i - 1, k &= k - 1) {
                m |= voxrti_geometry_byte(g, group, p, i, &a);
                n |= voxrti_geometry_byte(g, group, q, k, &b);
            }
            for (; i != 0; i &= i - 1) m |= voxrti_geometry_byte(g, group, p, i, &a);
            for (; k != 0; k &= k - 1) n |= voxrti_geometry_byte(g, group, q, k, &b);
            voxrti_geometry_put(g, group, &a, m);
            voxrti_geometry_put(g, group, &b, n);
        }
        if (b.bad || !voxrti_rans_done(&b.r)) voxrti_atomic_store(&g->d.bad, 1u);
    }
    while (a.i < a.end) {
        const uint32_t p = voxrti_geometry_first(g, &a);
        uint32_t i = p;
        uint64_t m = 0;
        for (; i != 0; i &= i - 1) m |= voxrti_geometry_byte(g, group, p, i, &a);
        voxrti_geometry_put(g, group, &a, m);
    }
    if (a.bad || !voxrti_rans_done(&a.r)) voxrti_atomic_store(&g->d.bad, 1u);
}

/* Read which runs the nodes of level w name. */
static voxrt_result voxrti_geometry_runs(voxrti_geometry_decoder *g, uint32_t w) {
    const voxrt_tree *t = g->t;
    const uint32_t last = w + 2 == t->wide, base = last ? 0 : t->level_first[w] + t->level_nodes[w];
    uint32_t i, n = 0;
    uint64_t next = 0;
    for (i = t->level_first[w]; i < t->level_first[w] + t->level_nodes[w]; i++) {
        voxrti_node *node = &t->node[i];
        const uint32_t m = voxrti_popcount64(node->mask);
        uint32_t lo = 0, hi = n, run;
        if ((g->sharing[VOXRTI_V5_SHARING_HEAD + i / 8] >> (i & 7u) & 1u) != 0) {
            if (next + m > t->level_nodes[w + 1]) return VOXRT_ERR_FORMAT;
            node->child = base + (uint32_t)next;
            next += m;
            g->owner[n++] = i;
            continue;
        }
        if (g->sharing_size - g->sharing_at < 4 || n == 0) return VOXRT_ERR_FORMAT;
        run = voxrti_load_u32(g->sharing + g->sharing_at);
        g->sharing_at += 4;
        if (run >= next) return VOXRT_ERR_FORMAT;
        while (hi - lo > 1) {
            const uint32_t mid = lo + (hi - lo) / 2;
            if (t->node[g->owner[mid]].child - base <= run) lo = mid;
            else hi = mid;
        }
        if (t->node[g->owner[lo]].child - base != run || voxrti_popcount64(t->node[g->owner[lo]].mask) != m)
            return VOXRT_ERR_FORMAT;
        node->child = base + run;
    }
    g->owner_count = n;
    return VOXRT_OK;
}

/* Where the chunks of level w+1 begin among the nodes of level w; their number must be what the file says. */
static voxrt_result voxrti_geometry_starts(voxrti_mem *mem, voxrti_geometry_decoder *g, uint32_t w) {
    const voxrti_node *node = g->t->node + g->t->level_first[w];
    uint32_t i, n = g->t->level_nodes[w + 1], chunk = 0, parents = g->t->level_nodes[w];
    uint64_t total = 0;
    if (g->sharing != NULL) {
        const voxrt_result r = voxrti_geometry_runs(g, w);
        if (r != VOXRT_OK) return r;
        parents = g->owner_count;
    }
    voxrti_free(mem, g->start);
    g->start = (uint32_t *)voxrti_alloc_array(mem, n / VOXRTI_CHUNK + 1, 2 * sizeof(uint32_t));
    if (g->start == NULL) return VOXRT_ERR_NO_MEMORY;
    for (i = 0; i < parents; i++) {
        uint64_t before = total;
        total += voxrti_popcount64(g->sharing != NULL ? g->t->node[g->owner[i]].mask : node[i].mask);
        if (total > n) return VOXRT_ERR_FORMAT;
        if ((uint64_t)chunk * VOXRTI_CHUNK < total) { /* at most 64 children: at most one start */
            g->start[2 * chunk] = i;
            g->start[2 * chunk + 1] = (uint32_t)((uint64_t)chunk * VOXRTI_CHUNK - before);
            chunk++;
        }
    }
    return total == n ? VOXRT_OK : VOXRT_ERR_FORMAT;
}

static voxrt_result voxrti_geometry_levels(voxrti_mem *mem, const voxrt_env *env, voxrti_geometry_decoder *g,
                                           const uint8_t *data, size_t size) {
    voxrt_tree *t = g->t;
    size_t leaves = t->level_nodes[t->wide - 1];
    voxrt_result r = voxrti_decoder_open(mem, data, size, voxrti_chunks(t), &g->d);
    uint32_t w, at = 0;
    if (r != VOXRT_OK) return r;
    t->node = (voxrti_node *)voxrti_alloc_array(mem, (size_t)t->node_count + 1, sizeof(voxrti_node));
    if (t->node == NULL) return VOXRT_ERR_NO_MEMORY;
    if (g->sharing != NULL) {
        memset(t->node, 0, ((size_t)t->node_count + 1) * sizeof *t->node);
        g->sharing_at = VOXRTI_V5_SHARING_HEAD + ((size_t)t->node_count + 7) / 8;
        if (g->sharing_at > g->sharing_size) return VOXRT_ERR_FORMAT;
        for (at = t->node_count; (at & 7u) != 0; at++)
            if ((g->sharing[VOXRTI_V5_SHARING_HEAD + at / 8] >> (at & 7u) & 1u) != 0) return VOXRT_ERR_FORMAT;
        g->owner = (uint32_t *)voxrti_alloc_array(mem, (size_t)t->node_count + 1, sizeof(uint32_t));
        if (g->owner == NULL) return VOXRT_ERR_NO_MEMORY;
        at = 0;
    }
    for (w = 0; w < t->wide; w++) {
        uint32_t chunks = (uint32_t)(((uint64_t)t->level_nodes[w] + VOXRTI_CHUNK - 1) / VOXRTI_CHUNK);
        if (w != 0) {
            r = voxrti_geometry_starts(mem, g, w - 1);
            if (r != VOXRT_OK) return r;
        }
        if (w + 1 == t->wide) { /* not before the levels above have shown that there are so many */
            g->leaf = (uint64_t *)voxrti_alloc_array(mem, leaves + 8, sizeof(uint64_t));
            if (g->leaf == NULL) return VOXRT_ERR_NO_MEMORY;
            if (g->sharing == NULL) {
                t->leaf = g->leaf;
                t->rank = (uint32_t *)voxrti_alloc_array(mem, 2 * (leaves / 16 + 2), sizeof(uint32_t));
                if (t->rank == NULL) return VOXRT_ERR_NO_MEMORY;
            }
        }
        t->level_first[w] = w + 1 == t->wide ? 0 : at;
        g->w = w;
        voxrti_parallel_for(env, voxrti_geometry_task, g, (chunks + 1) / 2);
        if (voxrti_atomic_load(&g->d.bad)) return VOXRT_ERR_FORMAT;
        g->first_chunk += chunks;
        at += t->level_nodes[w];
    }
    return VOXRT_OK;
}

/* sharing: that section of a shared tree's file, else NULL */
static voxrt_result voxrti_geometry_decode(voxrti_mem *mem, const voxrt_env *env, voxrt_tree *t, const uint8_t *data,
                                           size_t size, const uint8_t *sharing, size_t sharing_size) {
    voxrti_geometry_decoder *g = (voxrti_geometry_decoder *)voxrti_alloc_zero(mem, 1, sizeof *g);
    voxrt_result r;
    if (g == NULL) return VOXRT_ERR_NO_MEMORY;
    g->t = t;
    g->sharing = sharing;
    g->sharing_size = sharing_size;
    voxrti_mirror_table(g->mirror);
    r = voxrti_geometry_levels(mem, env, g, data, size);
    if (r == VOXRT_OK && sharing != NULL) {
        r = g->sharing_at == sharing_size ? voxrti_share_decoded(mem, t, g->leaf) : VOXRT_ERR_FORMAT;
    }
    voxrti_decoder_close(mem, &g->d);
    if (sharing != NULL) voxrti_free(mem, g->leaf);
    voxrti_free(mem, g->owner);
    voxrti_free(mem, g->start);
    voxrti_free(mem, g);
    if (r != VOXRT_OK) return r;
    return sharing != NULL ? voxrti_shared_index(mem, t, 1) : voxrti_tree_index(t);
}

/* ---- coded normals ----

   Each byte of an oct code as the difference to the cell before it (the first of a chunk to 0x80), in the context of
   how large the differences before it were. */

VOXRTI_INLINE uint32_t voxrti_delta_class(uint32_t delta) { /* 0..8: bits of the magnitude */
    uint32_t m = delta < 128 ? delta : 256 - delta;
    return 31 - voxrti_clz32(2 * m + 1);
}

VOXRTI_INLINE uint32_t voxrti_normal_context(uint32_t last) { /* last: the classes of the two differences before */
    return last > 12 ? 12 : last;
}

static void voxrti_normal_symbols(const void *user, uint32_t chunk, voxrti_symbols *out) {
    const voxrt_tree *t = (const voxrt_tree *)user;
    uint64_t i = (uint64_t)chunk * VOXRTI_CHUNK, end = i + VOXRTI_CHUNK;
    uint32_t n = 0, x = 0x80, y = 0x80, last = 0;
    if (end > t->attr_count) end = t->attr_count;
    for (; i < end; i++) {
        uint32_t c = t->normal[i], dx = (c - x) & 255u, dy = ((c >> 8) - y) & 255u, k = voxrti_delta_class(dx);
        out->context[n] = (uint8_t)voxrti_normal_context(last);
        out->symbol[n++] = (uint8_t)dx;
        out->context[n] = (uint8_t)(128 + 4 * k + voxrti_normal_context(last) / 4);
        out->symbol[n++] = (uint8_t)dy;
        last = k + voxrti_delta_class(dy);
        x = c & 255u;
        y = c >> 8;
    }
    out->count = n;
}

typedef struct voxrti_normal_decoder {
    voxrti_decoder d;
    voxrt_tree *t;
    voxrti_rans_table *lane_table; /* AVX2: those of contexts 0 to 12, then 128 to 163; else NULL */
} voxrti_normal_decoder;

#define VOXRTI_NORMAL_TABLES 49u

static void voxrti_normal_chunk(voxrti_normal_decoder *g, uint32_t chunk) {
    uint64_t i = (uint64_t)chunk * VOXRTI_CHUNK, end = i + VOXRTI_CHUNK;
    uint32_t x = 0x80, y = 0x80, last = 0;
    voxrti_rans r;
    if (end > g->t->attr_count) end = g->t->attr_count;
    voxrti_rans_open(&g->d, chunk, &r);
    for (; i < end; i++) {
        uint32_t dx = voxrti_rans_get(&r, g->d.of[voxrti_normal_context(last)]), k = voxrti_delta_class(dx);
        uint32_t dy = voxrti_rans_get(&r, g->d.of[128 + 4 * k + voxrti_normal_context(last) / 4]);
        last = k + voxrti_delta_class(dy);
        x = (x + dx) & 255u;
        y = (y + dy) & 255u;
        g->t->normal[i] = (uint16_t)(x | y << 8);
    }
    if (!voxrti_rans_done(&r)) voxrti_atomic_store(&g->d.bad, 1u);
}

#if VOXRTI_AVX2
/* Eight chunks at once, a lane each: the same steps. */
typedef struct voxrti_normal_lanes {
    const uint8_t *data;          /* where the first of the chunks begins */
    __m256i state, at, end, bad;  /* at, end: bytes from data */
    __m256i x, y, last;
} voxrti_normal_lanes;

VOXRTI_TARGET_AVX2 VOXRTI_INLINE void voxrti_normal_lanes_open(const voxrti_decoder *d, uint32_t chunk,
                                                               voxrti_normal_lanes *l) {
    int32_t at[8], end[8], state[8];
    uint32_t k;
    l->data = d->data + d->offset[chunk];
    for (k = 0; k < 8; k++) {
        at[k] = (int32_t)(d->offset[chunk + k] - d->offset[chunk]);
        end[k] = (int32_t)(d->offset[chunk + k + 1] - d->offset[chunk]);
        state[k] = (int32_t)voxrti_load_u32(l->data + at[k]);
        at[k] += 4;
    }
    l->state = _mm256_loadu_si256((const __m256i *)(const void *)state);
    l->at = _mm256_loadu_si256((const __m256i *)(const void *)at);
    l->end = _mm256_loadu_si256((const __m256i *)(const void *)end);
    l->bad = _mm256_cmpeq_epi32(_mm256_srli_epi32(l->state, 16), _mm256_setzero_si256());
    l->x = l->y = _mm256_set1_epi32(0x80);
    l->last = _mm256_setzero_si256();
}

/* voxrti_rans_get of two groups with tables number table[]: step by step in turn, for between dependent gathers the
   processor does not look far enough ahead by itself. A word is read with the two bytes before it: there are always
   some. */
VOXRTI_TARGET_AVX2 VOXRTI_INLINE void voxrti_normal_lanes_get(voxrti_normal_lanes l[2],
                                                              const voxrti_rans_table *tables,
                                                              const __m256i table[2], __m256i symbol[2]) {
    const int *base = (const int *)(const void *)tables;
    const __m256i zero = _mm256_setzero_si256(), low16 = _mm256_set1_epi32(0xffff), two = _mm256_set1_epi32(2);
    const __m256i low = _mm256_set1_epi32(VOXRTI_RANS_ONE - 1);
    const __m256i bytes = _mm256_set1_epi32((int)sizeof(voxrti_rans_table));
    __m256i slot[2], range[2], x[2], need[2], more[2], at[2];
    uint32_t k;
    for (k = 0; k < 2; k++) {
        slot[k] = _mm256_and_si256(l[k].state, low);
        at[k] = _mm256_mullo_epi32(table[k], bytes);
        symbol[k] = _mm256_add_epi32(at[k], _mm256_add_epi32(slot[k], _mm256_set1_epi32(1024)));
        symbol[k] = _mm256_and_si256(_mm256_i32gather_epi32(base, symbol[k], 1), _mm256_set1_epi32(255));
    }
    for (k = 0; k < 2; k++)
        range[k] = _mm256_i32gather_epi32(base, _mm256_add_epi32(at[k], _mm256_slli_epi32(symbol[k], 2)), 1);
    for (k = 0; k < 2; k++) {
        x[k] = _mm256_mullo_epi32(_mm256_and_si256(range[k], low16), _mm256_srli_epi32(l[k].state, VOXRTI_RANS_BITS));
        x[k] = _mm256_sub_epi32(_mm256_add_epi32(x[k], slot[k]), _mm256_srli_epi32(range[k], 16));
        need[k] = _mm256_cmpeq_epi32(_mm256_srli_epi32(x[k], 16), zero);
        more[k] = _mm256_and_si256(need[k], _mm256_cmpgt_epi32(l[k].end, l[k].at));
        l[k].bad = _mm256_or_si256(l[k].bad, _mm256_andnot_si256(more[k], need[k]));
        slot[k] = _mm256_mask_i32gather_epi32(zero, (const int *)(const void *)l[k].data,
                                              _mm256_sub_epi32(l[k].at, two), more[k], 1);
        l[k].at = _mm256_sub_epi32(l[k].at, _mm256_add_epi32(more[k], more[k]));
    }
    for (k = 0; k < 2; k++) {
        slot[k] = _mm256_or_si256(_mm256_slli_epi32(x[k], 16), _mm256_srli_epi32(slot[k], 16));
        l[k].state = _mm256_blendv_epi8(x[k], slot[k], need[k]);
    }
}

/* voxrti_delta_class: from the exponent of the magnitude as a float */
VOXRTI_TARGET_AVX2 VOXRTI_INLINE __m256i voxrti_normal_lanes_class(__m256i delta) {
    __m256i m = _mm256_min_epi32(delta, _mm256_sub_epi32(_mm256_set1_epi32(256), delta));
    m = _mm256_srli_epi32(_mm256_castps_si256(_mm256_cvtepi32_ps(m)), 23);
    return _mm256_max_epi32(_mm256_sub_epi32(m, _mm256_set1_epi32(126)), _mm256_setzero_si256());
}

/* The next normal of each lane. */
VOXRTI_TARGET_AVX2 VOXRTI_INLINE void voxrti_normal_lanes_next(voxrti_normal_lanes l[2],
                                                               const voxrti_rans_table *tables, uint16_t out[16]) {
    const __m256i byte = _mm256_set1_epi32(255);
    __m256i context[2], dx[2], dy[2], c[2], n;
    uint32_t k;
    for (k = 0; k < 2; k++) context[k] = _mm256_min_epi32(l[k].last, _mm256_set1_epi32(12));
    voxrti_normal_lanes_get(l, tables, context, dx);
    for (k = 0; k < 2; k++) {
        c[k] = voxrti_normal_lanes_class(dx[k]);
        context[k] = _mm256_add_epi32(_mm256_slli_epi32(c[k], 2), _mm256_srli_epi32(context[k], 2));
        context[k] = _mm256_add_epi32(context[k], _mm256_set1_epi32(13));
    }
    voxrti_normal_lanes_get(l, tables, context, dy);
    for (k = 0; k < 2; k++) {
        l[k].last = _mm256_add_epi32(c[k], voxrti_normal_lanes_class(dy[k]));
        l[k].x = _mm256_and_si256(_mm256_add_epi32(l[k].x, dx[k]), byte);
        l[k].y = _mm256_and_si256(_mm256_add_epi32(l[k].y, dy[k]), byte);
        n = _mm256_or_si256(l[k].x, _mm256_slli_epi32(l[k].y, 8));
        _mm_storeu_si128((__m128i *)(void *)(out + 8 * k),
                         _mm_packus_epi32(_mm256_castsi256_si128(n), _mm256_extracti128_si256(n, 1)));
    }
}

VOXRTI_TARGET_AVX2 VOXRTI_INLINE int voxrti_normal_lanes_done(const voxrti_normal_lanes *l) {
    __m256i ok = _mm256_and_si256(_mm256_cmpeq_epi32(l->at, l->end),
                                  _mm256_cmpeq_epi32(l->state, _mm256_set1_epi32((int)VOXRTI_RANS_LOW)));
    return _mm256_movemask_epi8(_mm256_andnot_si256(l->bad, ok)) == -1;
}

VOXRTI_TARGET_AVX2 static void voxrti_normal_chunks16_avx2(voxrti_normal_decoder *g, uint32_t chunk) {
    voxrti_normal_lanes l[2];
    uint16_t *out = g->t->normal + (size_t)chunk * VOXRTI_CHUNK, block[64][16];
    uint32_t i, j, k;
    voxrti_normal_lanes_open(&g->d, chunk, &l[0]);
    voxrti_normal_lanes_open(&g->d, chunk + 8, &l[1]);
    for (i = 0; i < VOXRTI_CHUNK; i += 64) {
        for (j = 0; j < 64; j++) voxrti_normal_lanes_next(l, g->lane_table, block[j]);
        for (k = 0; k < 16; k++)
            for (j = 0; j < 64; j++) out[k * VOXRTI_CHUNK + i + j] = block[j][k];
    }
    if (!voxrti_normal_lanes_done(&l[0]) || !voxrti_normal_lanes_done(&l[1])) voxrti_atomic_store(&g->d.bad, 1u);
}
#endif

static void voxrti_normal_task(void *ctx, uint32_t task) {
    voxrti_normal_decoder *g = (voxrti_normal_decoder *)ctx;
    uint32_t chunk = task * 16, end = g->d.chunks - chunk < 16 ? g->d.chunks : chunk + 16;
#if VOXRTI_AVX2
    if (g->lane_table != NULL && (uint64_t)(chunk + 16) * VOXRTI_CHUNK <= g->t->attr_count) {
        voxrti_normal_chunks16_avx2(g, chunk);
        return;
    }
#endif
    for (; chunk < end; chunk++) voxrti_normal_chunk(g, chunk);
}

static voxrt_result voxrti_normals_decode(voxrti_mem *mem, const voxrt_env *env, voxrt_tree *t, const uint8_t *data,
                                          size_t size) {
    voxrti_normal_decoder g;
    uint64_t chunks = (t->attr_count + VOXRTI_CHUNK - 1) / VOXRTI_CHUNK;
    uint32_t c = 0;
    voxrt_result r;
    (void)c;
    memset(&g, 0, sizeof g);
    g.t = t;
    r = voxrti_decoder_open(mem, data, size, chunks, &g.d);
    if (r == VOXRT_OK) {
        t->normal = (uint16_t *)voxrti_alloc_array(mem, (size_t)t->attr_count, sizeof(uint16_t));
        if (t->normal == NULL) r = VOXRT_ERR_NO_MEMORY;
    }
#if VOXRTI_AVX2
    if (r == VOXRT_OK && chunks >= 16 && voxrti_cpu_level() >= 3) {
        g.lane_table = (voxrti_rans_table *)voxrti_alloc_array(mem, VOXRTI_NORMAL_TABLES, sizeof(voxrti_rans_table));
        if (g.lane_table == NULL) r = VOXRT_ERR_NO_MEMORY;
        for (c = 0; r == VOXRT_OK && c < VOXRTI_NORMAL_TABLES; c++) g.lane_table[c] = *g.d.of[c < 13 ? c : 115 + c];
    }
#endif
    if (r == VOXRT_OK) {
        voxrti_parallel_for(env, voxrti_normal_task, &g, (uint32_t)((chunks + 15) / 16));
        if (voxrti_atomic_load(&g.d.bad)) r = VOXRT_ERR_FORMAT;
    }
    voxrti_free(mem, g.lane_table);
    voxrti_decoder_close(mem, &g.d);
    return r;
}

/* ---- file: what both directions share ---- */

typedef struct voxrti_v5_section {
    uint32_t id, encoding;      /* 0 raw, 1 coded */
    uint64_t offset, size, count;
} voxrti_v5_section;

typedef struct voxrti_v5_file {
    uint32_t section_count;
    voxrti_v5_section section[VOXRTI_V5_IDS]; /* write: in order; read: by id, id = 0: not there */
    voxrti_bytes geometry, normals, sharing;  /* write: coded sections */
} voxrti_v5_file;

VOXRTI_INLINE uint64_t voxrti_v5_align(uint64_t x) { return (x + 63u) & ~(uint64_t)63; }

/* Of header and table, the field itself taken as 0. */
static uint64_t voxrti_v5_head_checksum(const uint8_t *data, uint32_t section_count) {
    uint8_t head[VOXRTI_V5_HEADER];
    memcpy(head, data, sizeof head);
    memset(head + 24, 0, 8);
    return voxrti_hash_bytes(voxrti_v5_checksum(head, sizeof head), data + VOXRTI_V5_HEADER,
                             (size_t)section_count * VOXRTI_V5_ENTRY);
}

/* Enter the checksums of a file that is otherwise complete. Whatever it holds, only its own bytes are touched. */
static void voxrti_v5_seal(uint8_t *p, size_t size) {
    size_t i, n = size < VOXRTI_V5_HEADER ? 0 : voxrti_load_u16(p + 14);
    if (size < VOXRTI_V5_HEADER + n * VOXRTI_V5_ENTRY) return;
    for (i = 0; i < n; i++) {
        uint8_t *e = p + VOXRTI_V5_HEADER + i * VOXRTI_V5_ENTRY;
        uint64_t at = voxrti_load_u64(e + 8), bytes = voxrti_load_u64(e + 16);
        if (at <= size && bytes <= size - at)
            voxrti_store_u64(e + 32, voxrti_v5_checksum(p + (size_t)at, (size_t)bytes));
    }
    voxrti_store_u64(p + 24, voxrti_v5_head_checksum(p, (uint32_t)n));
}

static uint64_t voxrti_rank_count(const voxrt_tree *t) {
    return 2 * (((uint64_t)t->level_nodes[t->wide - 1] + 15) / 16 + 1);
}

/* Size of a raw section of `count` elements. */
static uint64_t voxrti_v5_raw_size(uint32_t id, uint64_t count) {
    switch (id) {
    case VOXRTI_V5_PLACEMENT: return VOXRTI_V5_PLACE;
    case VOXRTI_V5_PALETTE: return 3 * count;
    case VOXRTI_V5_NODES: return 16 * count;
    case VOXRTI_V5_LEAVES: return 8 * (count + 8);
    case VOXRTI_V5_NORMALS: return 2 * count;
    case VOXRTI_V5_COLORS: return count + 8;
    case VOXRTI_V5_SHARING: return count;
    case VOXRTI_V5_CODES: return 2 * count;
    default: return 4 * count; /* ranks, colour blocks, extra */
    }
}

/* Elements of a section. */
static uint64_t voxrti_v5_count(const voxrt_tree *t, uint32_t id) {
    switch (id) {
    case VOXRTI_V5_PLACEMENT: return 1;
    case VOXRTI_V5_PALETTE: return t->palette_count;
    case VOXRTI_V5_NODES: return t->node_count;
    case VOXRTI_V5_LEAVES: return t->mask_count != 0 ? t->mask_count : t->level_nodes[t->wide - 1];
    case VOXRTI_V5_CODES: return t->level_nodes[t->wide - 1];
    case VOXRTI_V5_EXTRA: return ((uint64_t)t->level_nodes[t->wide - 1] >> VOXRTI_CODE_LOG) + 1;
    case VOXRTI_V5_RANKS: return voxrti_rank_count(t);
    case VOXRTI_V5_GEOMETRY: return (uint64_t)t->node_count + t->level_nodes[t->wide - 1];
    case VOXRTI_V5_NORMALS: return t->attr_count;
    case VOXRTI_V5_BLOCKS: return (t->attr_count + 63) / 64;
    default: return t->colors.data_bytes;
    }
}

/* ---- writing ---- */

static void voxrti_store_f64(uint8_t *p, double v) {
    uint64_t bits;
    memcpy(&bits, &v, sizeof bits);
    voxrti_store_u64(p, bits);
}

/* Cells of virtual level v that are not empty. */
static uint64_t voxrti_level_cells(const voxrt_tree *t, uint32_t v) {
    return (v == 0 ? t->attr_count : t->attr_first[v - 1]) - t->attr_first[v];
}

static void voxrti_v5_write_placement(const voxrt_tree *t, uint8_t *p) {
    uint32_t i;
    memset(p, 0, VOXRTI_V5_PLACE);
    for (i = 0; i < 3; i++) {
        voxrti_store_f64(p + 8 * i, t->origin[i]);
        voxrti_store_u32(p + 32 + 4 * i, t->cell_min[i]);
        voxrti_store_u32(p + 44 + 4 * i, t->cell_max[i]);
    }
    voxrti_store_f64(p + 24, t->voxel_size);
    voxrti_store_u32(p + 56, t->palette_count);
    for (i = 0; i < t->wide; i++) {
        voxrti_store_u32(p + 64 + 4 * i, (uint32_t)voxrti_level_cells(t, 2 * i));
        voxrti_store_u32(p + 104 + 4 * i, (uint32_t)(t->attr_first[2 * i] - t->attr_first[2 * i + 1]));
    }
}

static void voxrti_v5_write_section(const voxrt_tree *t, const voxrti_v5_file *f, const voxrti_v5_section *s,
                                    uint8_t *p) {
    size_t i, n = (size_t)s->count;
    switch (s->id) {
    case VOXRTI_V5_PLACEMENT: voxrti_v5_write_placement(t, p); break;
    case VOXRTI_V5_PALETTE: memcpy(p, t->palette, 3 * n); break;
    case VOXRTI_V5_NODES:
        for (i = 0; i < n; i++) {
            voxrti_store_u64(p + 16 * i, t->node[i].mask);
            voxrti_store_u32(p + 16 * i + 8, t->node[i].child);
            voxrti_store_u32(p + 16 * i + 12, t->node[i].octant);
        }
        break;
    case VOXRTI_V5_LEAVES:
        for (i = 0; i < n; i++) voxrti_store_u64(p + 8 * i, t->leaf[i]);
        memset(p + 8 * n, 0, 64);
        break;
    case VOXRTI_V5_RANKS: for (i = 0; i < n; i++) voxrti_store_u32(p + 4 * i, t->rank[i]); break;
    case VOXRTI_V5_GEOMETRY: memcpy(p, f->geometry.data, f->geometry.size); break;
    case VOXRTI_V5_NORMALS:
        if (s->encoding == 1) memcpy(p, f->normals.data, f->normals.size);
        else for (i = 0; i < n; i++) voxrti_store_u16(p + 2 * i, t->normal[i]);
        break;
    case VOXRTI_V5_BLOCKS: for (i = 0; i < n; i++) voxrti_store_u32(p + 4 * i, t->colors.block[i]); break;
    case VOXRTI_V5_SHARING: memcpy(p, f->sharing.data, f->sharing.size); break;
    case VOXRTI_V5_CODES: for (i = 0; i < n; i++) voxrti_store_u16(p + 2 * i, t->code[i]); break;
    case VOXRTI_V5_EXTRA: for (i = 0; i < n; i++) voxrti_store_u32(p + 4 * i, t->extra[i]); break;
    default: /* colours */
        if (n != 0) memcpy(p, t->colors.data, n);
        memset(p + n, 0, 8);
        break;
    }
}

/* Code what is coded and lay out the sections. */
static voxrt_result voxrti_v5_plan(voxrti_mem *mem, const voxrt_save_desc *d, const voxrt_tree *t, voxrti_v5_file *f,
                                   size_t *out_size) {
    uint32_t raw = d->encoding == VOXRT_ENCODING_RAW, shared = t->code != NULL, id, n = 0, i;
    uint64_t at;
    voxrt_result r = VOXRT_OK;
    memset(f, 0, sizeof *f);
    f->geometry.mem = f->normals.mem = f->sharing.mem = mem;
    for (id = VOXRTI_V5_PLACEMENT; id < VOXRTI_V5_IDS && r == VOXRT_OK; id++) {
        voxrti_v5_section *s = &f->section[n];
        if (id >= VOXRTI_V5_NODES && id <= VOXRTI_V5_RANKS && !raw) continue;
        if (id == VOXRTI_V5_RANKS && shared) continue;
        if (id == VOXRTI_V5_GEOMETRY && raw) continue;
        if (id == VOXRTI_V5_SHARING ? !shared : id > VOXRTI_V5_SHARING && !(shared && raw)) continue;
        if (id == VOXRTI_V5_NORMALS && (t->normal == NULL || d->disable_normals != 0)) continue;
        if ((id == VOXRTI_V5_BLOCKS || id == VOXRTI_V5_COLORS) && t->colors.block == NULL) continue;
        s->id = id;
        s->count = voxrti_v5_count(t, id);
        s->size = voxrti_v5_raw_size(id, s->count);
        n++;
        if (id == VOXRTI_V5_GEOMETRY) {
            voxrti_geometry_source *g = (voxrti_geometry_source *)voxrti_alloc_zero(mem, 1, sizeof *g);
            if (g == NULL) return VOXRT_ERR_NO_MEMORY;
            g->t = t;
            voxrti_mirror_table(g->mirror);
            if (shared) r = voxrti_sharing(g, &f->sharing, 0);
            if (r == VOXRT_OK)
                r = voxrti_encode(mem, &d->env, voxrti_geometry_symbols, g, (uint32_t)voxrti_chunks(t), &f->geometry);
            voxrti_free(mem, g->owner);
            voxrti_free(mem, g);
            s->encoding = 1;
            s->size = f->geometry.size;
        } else if (id == VOXRTI_V5_SHARING) {
            voxrti_geometry_source g;
            memset(&g, 0, sizeof g);
            g.t = t;
            if (raw) r = voxrti_sharing(&g, &f->sharing, 1);
            s->count = s->size = f->sharing.size;
        } else if (id == VOXRTI_V5_NORMALS && !raw) {
            r = voxrti_encode(mem, &d->env, voxrti_normal_symbols, t,
                              (uint32_t)((t->attr_count + VOXRTI_CHUNK - 1) / VOXRTI_CHUNK), &f->normals);
            if (r == VOXRT_OK && f->normals.size < s->size) {
                s->encoding = 1;
                s->size = f->normals.size;
            }
        }
    }
    if (r != VOXRT_OK) return r;
    f->section_count = n;
    at = VOXRTI_V5_HEADER + (uint64_t)n * VOXRTI_V5_ENTRY;
    for (i = 0; i < n; i++) {
        f->section[i].offset = voxrti_v5_align(at);
        at = f->section[i].offset + f->section[i].size;
    }
    if (at > (size_t)-1) return VOXRT_ERR_RANGE;
    *out_size = (size_t)at;
    return VOXRT_OK;
}

static void voxrti_v5_write(const voxrt_tree *t, const voxrti_v5_file *f, uint8_t *out, size_t size) {
    uint32_t i, flags = 0, n = f->section_count;
    uint64_t nodes = 0;
    size_t at = VOXRTI_V5_HEADER + (size_t)n * VOXRTI_V5_ENTRY;
    memset(out, 0, at);
    for (i = 0; i < n; i++) {
        const voxrti_v5_section *s = &f->section[i];
        uint8_t *e = out + VOXRTI_V5_HEADER + (size_t)i * VOXRTI_V5_ENTRY;
        memset(out + at, 0, (size_t)s->offset - at);
        voxrti_v5_write_section(t, f, s, out + (size_t)s->offset);
        at = (size_t)(s->offset + s->size);
        voxrti_store_u32(e, s->id);
        voxrti_store_u32(e + 4, s->encoding);
        voxrti_store_u64(e + 8, s->offset);
        voxrti_store_u64(e + 16, s->size);
        voxrti_store_u64(e + 24, s->count);
        if (s->id == VOXRTI_V5_NODES) flags |= VOXRTI_V5_RAW_FILE;
        if (s->id == VOXRTI_V5_NORMALS) flags |= VOXRTI_V5_HAS_NORMALS | VOXRTI_V5_SPHERICAL * t->spherical;
        if (s->id == VOXRTI_V5_BLOCKS) flags |= VOXRTI_V5_HAS_COLORS;
        if (s->id == VOXRTI_V5_SHARING) flags |= VOXRTI_V5_SHARED;
    }
    for (i = 0; i < t->wide; i++) nodes += voxrti_level_cells(t, 2 * i);
    memcpy(out, voxrti_v5_magic, 8);
    voxrti_store_u16(out + 8, 5);
    voxrti_store_u16(out + 12, VOXRTI_V5_HEADER);
    voxrti_store_u16(out + 14, n);
    voxrti_store_u64(out + 16, size);
    voxrti_store_u32(out + 32, flags);
    voxrti_store_u32(out + 36, t->depth);
    voxrti_store_u32(out + 40, t->resolution);
    voxrti_store_u64(out + 48, nodes);
    voxrti_store_u64(out + 56, t->voxel_count);
    voxrti_v5_seal(out, size);
}

static voxrt_result voxrti_save_open(const voxrt_tree *tree, const voxrt_save_desc *desc, voxrt_save_desc *d,
                                     voxrti_mem *mem) {
    memset(d, 0, sizeof *d);
    if (desc != NULL) *d = *desc;
    if (d->_begin_zero != 0 || d->_end_zero != 0) return VOXRT_ERR_UNINIT_DESC;
    if (d->env.error != NULL) memset(d->env.error, 0, sizeof *d->env.error);
    if (tree == NULL) return voxrti_fail(d->env.error, VOXRT_ERR_INVALID_ARG, 0, "no tree");
    if ((uint32_t)d->encoding > 1u) return voxrti_fail(d->env.error, VOXRT_ERR_INVALID_ARG, 0, "unknown encoding");
    return voxrti_env_open(&d->env, mem);
}

VOXRT_DEF voxrt_result voxrt_tree_save_memory(const voxrt_tree *tree, const voxrt_save_desc *desc, void *buffer,
                                              size_t capacity, size_t *out_size) {
    voxrt_save_desc d;
    voxrti_mem mem;
    voxrti_v5_file f;
    size_t size = 0;
    voxrt_result r;
    if (out_size == NULL) return VOXRT_ERR_INVALID_ARG;
    *out_size = 0;
    r = voxrti_save_open(tree, desc, &d, &mem);
    if (r != VOXRT_OK) return r;
    r = voxrti_v5_plan(&mem, &d, tree, &f, &size);
    if (r == VOXRT_OK) {
        *out_size = size;
        if (buffer != NULL && capacity < size) r = VOXRT_ERR_RANGE;
        else if (buffer != NULL) voxrti_v5_write(tree, &f, (uint8_t *)buffer, size);
    }
    voxrti_free(&mem, f.geometry.data);
    voxrti_free(&mem, f.normals.data);
    voxrti_free(&mem, f.sharing.data);
    if (r == VOXRT_ERR_RANGE) return voxrti_fail(d.env.error, r, size, "the file needs % bytes");
    return r == VOXRT_OK ? r : voxrti_fail(d.env.error, r, 0, voxrt_result_string(r));
}

/* ---- reading ---- */

static double voxrti_load_f64(const uint8_t *p) {
    uint64_t bits = voxrti_load_u64(p);
    double v;
    memcpy(&v, &bits, sizeof v);
    return v;
}

typedef struct voxrti_v5_reader {
    voxrt_load_desc desc;
    voxrti_mem mem;
    voxrti_v5_file f;
    const uint8_t *data;
    size_t size;
    int map;                /* use the arrays where they are */
    uint32_t flags;
} voxrti_v5_reader;

static voxrt_result voxrti_v5_fail(voxrti_v5_reader *r, voxrt_result code, uint64_t where, const char *text) {
    return voxrti_fail(r->desc.env.error, code, where, text);
}

static const uint8_t *voxrti_v5_at(const voxrti_v5_reader *r, uint32_t id) {
    return r->data + (size_t)r->f.section[id].offset;
}

/* Header and table: afterwards every section is inside the file, behind the one before it, and unchanged. */
static voxrt_result voxrti_v5_read_table(voxrti_v5_reader *r) {
    const uint8_t *p = r->data;
    uint32_t n, i, last = 0;
    uint64_t at;
    size_t have = r->size < 8 ? r->size : 8, k;
    if (memcmp(p, voxrti_v5_magic, have) != 0)
        return voxrti_v5_fail(r, VOXRT_ERR_FORMAT, 0, "not a voxrt file of format 5");
    if (r->size < VOXRTI_V5_HEADER) return voxrti_v5_fail(r, VOXRT_ERR_TRUNCATED, r->size, "file ends in the header");
    if (voxrti_load_u16(p + 8) != 5)
        return voxrti_v5_fail(r, VOXRT_ERR_VERSION, voxrti_load_u16(p + 8), "format version % is unknown");
    n = voxrti_load_u16(p + 14);
    if (voxrti_load_u16(p + 12) != VOXRTI_V5_HEADER || n > VOXRTI_V5_MAX_SECTIONS)
        return voxrti_v5_fail(r, VOXRT_ERR_FORMAT, 12, "bad header at byte %");
    if (r->size < voxrti_load_u64(p + 16))
        return voxrti_v5_fail(r, VOXRT_ERR_TRUNCATED, r->size, "file ends at byte %");
    at = VOXRTI_V5_HEADER + (uint64_t)n * VOXRTI_V5_ENTRY;
    if (r->size > voxrti_load_u64(p + 16) || r->size < at)
        return voxrti_v5_fail(r, VOXRT_ERR_FORMAT, 16, "size of the file is not the one in its header");
    if (!r->desc.trust_input && voxrti_load_u64(p + 24) != voxrti_v5_head_checksum(p, n))
        return voxrti_v5_fail(r, VOXRT_ERR_CHECKSUM, 24, "header is damaged");
    for (i = 0; i < n; i++) {
        const uint8_t *e = p + VOXRTI_V5_HEADER + (size_t)i * VOXRTI_V5_ENTRY;
        voxrti_v5_section s;
        s.id = voxrti_load_u32(e);
        s.encoding = voxrti_load_u32(e + 4);
        s.offset = voxrti_load_u64(e + 8);
        s.size = voxrti_load_u64(e + 16);
        s.count = voxrti_load_u64(e + 24);
        if (s.id <= last || s.offset != voxrti_v5_align(at) || s.offset > r->size || s.size > r->size - s.offset)
            return voxrti_v5_fail(r, VOXRT_ERR_FORMAT, (uint64_t)(e - p), "bad section table at byte %");
        for (k = (size_t)at; k < (size_t)s.offset; k++)
            if (p[k] != 0) return voxrti_v5_fail(r, VOXRT_ERR_FORMAT, k, "byte % is not zero");
        at = s.offset + s.size;
        last = s.id;
        if (!r->desc.trust_input && voxrti_load_u64(e + 32) != voxrti_v5_checksum(p + (size_t)s.offset, (size_t)s.size))
            return voxrti_v5_fail(r, VOXRT_ERR_CHECKSUM, s.offset, "section at byte % is damaged");
        if (s.id < VOXRTI_V5_IDS) r->f.section[s.id] = s;
        else if ((s.id & VOXRTI_V5_OPTIONAL) == 0)
            return voxrti_v5_fail(r, VOXRT_ERR_VERSION, s.id, "section % is unknown and required");
        if (s.id < VOXRTI_V5_IDS && s.encoding != (s.id == VOXRTI_V5_GEOMETRY ? 1u : 0u) &&
            !(s.id == VOXRTI_V5_NORMALS && s.encoding == 1))
            return voxrti_v5_fail(r, VOXRT_ERR_VERSION, s.id, "section % has an unknown encoding");
    }
    if (at != r->size) return voxrti_v5_fail(r, VOXRT_ERR_FORMAT, at, "something follows the last section");
    return VOXRT_OK;
}

/* Header and placement section -> the tree's fields; every count is checked against its section's size. */
static voxrt_result voxrti_v5_read_placement(voxrti_v5_reader *r, voxrt_tree *t) {
    const uint8_t *h = r->data, *p;
    const voxrti_v5_section *s = r->f.section;
    uint64_t nodes = 0, kept = 0, total = 0, count[2 * VOXRTI_MAX_WIDE + 1];
    uint32_t i, raw = s[VOXRTI_V5_NODES].id != 0, shared = s[VOXRTI_V5_SHARING].id != 0, flags = 0, ok, first = 0;
    if (raw) flags |= VOXRTI_V5_RAW_FILE;
    if (shared) flags |= VOXRTI_V5_SHARED;
    if (s[VOXRTI_V5_NORMALS].id != 0) flags |= VOXRTI_V5_HAS_NORMALS | (voxrti_load_u32(h + 32) & VOXRTI_V5_SPHERICAL);
    if (s[VOXRTI_V5_BLOCKS].id != 0) flags |= VOXRTI_V5_HAS_COLORS;
    r->flags = flags;
    if (voxrti_load_u32(h + 32) != flags || voxrti_load_u32(h + 44) != 0 || s[VOXRTI_V5_PLACEMENT].id == 0 ||
        s[VOXRTI_V5_PLACEMENT].size != VOXRTI_V5_PLACE || s[VOXRTI_V5_PALETTE].id == 0 ||
        (s[VOXRTI_V5_LEAVES].id != 0) != raw || (s[VOXRTI_V5_RANKS].id != 0) != (raw && !shared) ||
        (s[VOXRTI_V5_CODES].id != 0) != (raw && shared) || (s[VOXRTI_V5_EXTRA].id != 0) != (raw && shared) ||
        (shared && s[VOXRTI_V5_SHARING].size < VOXRTI_V5_SHARING_HEAD) ||
        (s[VOXRTI_V5_GEOMETRY].id != 0) == raw || (s[VOXRTI_V5_BLOCKS].id != 0) != (s[VOXRTI_V5_COLORS].id != 0))
        return voxrti_v5_fail(r, VOXRT_ERR_FORMAT, 0, "sections do not belong together");
    p = voxrti_v5_at(r, VOXRTI_V5_PLACEMENT);
    t->spherical = (flags & VOXRTI_V5_SPHERICAL) != 0;
    t->depth = voxrti_load_u32(h + 36);
    t->resolution = voxrti_load_u32(h + 40);
    t->voxel_count = voxrti_load_u64(h + 56);
    t->voxel_size = voxrti_load_f64(p + 24);
    t->palette_count = voxrti_load_u32(p + 56);
    if (t->depth < 1 || t->depth > VOXRT_MAX_DEPTH)
        return voxrti_v5_fail(r, VOXRT_ERR_FORMAT, t->depth, "depth % is out of range");
    t->wide = (t->depth + 1) / 2;
    memset(count, 0, sizeof count);
    ok = voxrti_load_u32(p + 60) == 0 && t->resolution >= 1 && t->resolution <= 1u << t->depth;
    ok = ok && t->palette_count >= 1 && t->palette_count <= 1u << 24;
    ok = ok && t->voxel_size > 0 && voxrti_finite(t->voxel_size * (double)(1u << t->depth));
    for (i = 0; i < 3; i++) {
        t->origin[i] = voxrti_load_f64(p + 8 * i);
        t->cell_min[i] = voxrti_load_u32(p + 32 + 4 * i);
        t->cell_max[i] = voxrti_load_u32(p + 44 + 4 * i);
        ok = ok && voxrti_finite(t->origin[i]) && t->cell_min[i] < t->cell_max[i] && t->cell_max[i] <= 1u << t->depth;
    }
    for (i = 0; i < VOXRTI_MAX_WIDE; i++) {
        uint32_t n = voxrti_load_u32(p + 64 + 4 * i), o = voxrti_load_u32(p + 104 + 4 * i);
        ok = ok && (i < t->wide ? n >= 1 && o >= 1 : n == 0 && o == 0);
        if (!ok) break;
        nodes += n;
        count[2 * i] = n;
        count[2 * i + 1] = o;
        if (shared) {
            n = voxrti_load_u32(voxrti_v5_at(r, VOXRTI_V5_SHARING) + 4 * i);
            ok = i < t->wide ? n >= 1 && n <= 0xfffffff0u : n == 0;
            if (!ok) break;
        }
        kept += n;
        t->level_nodes[i] = n;
        if (i + 1 < t->wide) t->level_first[i] = first;
        if (i + 1 < t->wide) first += n;
    }
    if (shared) {
        const uint8_t *q = voxrti_v5_at(r, VOXRTI_V5_SHARING);
        t->mask_count = voxrti_load_u32(q + 40);
        ok = ok && t->mask_count >= 1 && t->mask_count <= 0xfffffff0u && voxrti_load_u32(q + 44) == 0;
        ok = ok && (!raw || s[VOXRTI_V5_SHARING].size == VOXRTI_V5_SHARING_HEAD);
    }
    ok = ok && nodes == voxrti_load_u64(h + 48) && nodes <= 0xffffffffu && kept <= 0xffffffffu;
    ok = ok && t->level_nodes[0] == 1 && count[0] == 1 && t->voxel_count >= 1 && t->voxel_count < 0xffffffffu;
    if (!ok)
        return voxrti_v5_fail(r, VOXRT_ERR_FORMAT, s[VOXRTI_V5_PLACEMENT].offset, "bad placement section at byte %");
    t->node_count = (uint32_t)kept - t->level_nodes[t->wide - 1];
    count[2 * t->wide] = t->voxel_count;
    for (i = 2 * t->wide + 1; i-- > 0;) {
        t->attr_first[i] = total;
        total += count[i];
    }
    t->attr_count = total;
    for (i = VOXRTI_V5_PLACEMENT; i < VOXRTI_V5_IDS; i++) {
        if (s[i].id == 0) continue;
        if (i == VOXRTI_V5_SHARING) {
            ok = s[i].count == s[i].size;
        } else if (i == VOXRTI_V5_COLORS) {
            ok = s[i].size >= 8 && s[i].count == s[i].size - 8;
            t->colors.data_bytes = ok ? (size_t)s[i].count : 0;
        } else { /* counts are below 2^35 here: no overflow */
            ok = s[i].count == voxrti_v5_count(t, i) &&
                 (s[i].encoding == 1 || s[i].size == voxrti_v5_raw_size(i, s[i].count));
        }
        if (!ok) return voxrti_v5_fail(r, VOXRT_ERR_FORMAT, s[i].offset, "section at byte % has a wrong size");
    }
    return VOXRT_OK;
}

/* The array of a section: in place, or room for it. `size` bytes, of which the file has the first part. */
static void *voxrti_v5_array(voxrti_v5_reader *r, uint32_t id) {
    const uint8_t *from = voxrti_v5_at(r, id);
    void *p;
    if (!r->map) return voxrti_alloc(&r->mem, (size_t)r->f.section[id].size);
    memcpy(&p, &from, sizeof p); /* a tree is only read; its pointers are not const for those who build it */
    return p;
}

static voxrt_result voxrti_v5_read_raw(voxrti_v5_reader *r, voxrt_tree *t) {
    const int shared = t->mask_count != 0;
    size_t i, leaves = (size_t)voxrti_v5_count(t, VOXRTI_V5_LEAVES), ranks = shared ? 0 : (size_t)voxrti_rank_count(t);
    const uint8_t *p;
    t->node = (voxrti_node *)voxrti_v5_array(r, VOXRTI_V5_NODES);
    t->leaf = (uint64_t *)voxrti_v5_array(r, VOXRTI_V5_LEAVES);
    if (shared) {
        t->code = (uint16_t *)voxrti_v5_array(r, VOXRTI_V5_CODES);
        t->extra = (uint32_t *)voxrti_v5_array(r, VOXRTI_V5_EXTRA);
        if (t->code == NULL || t->extra == NULL) return VOXRT_ERR_NO_MEMORY;
    } else {
        t->rank = (uint32_t *)voxrti_v5_array(r, VOXRTI_V5_RANKS);
        if (t->rank == NULL) return VOXRT_ERR_NO_MEMORY;
    }
    if (t->node == NULL || t->leaf == NULL) return VOXRT_ERR_NO_MEMORY;
    if (r->map) return VOXRT_OK;
    p = voxrti_v5_at(r, VOXRTI_V5_NODES);
    for (i = 0; i < t->node_count; i++, p += 16) {
        t->node[i].mask = voxrti_load_u64(p);
        t->node[i].child = voxrti_load_u32(p + 8);
        t->node[i].octant = voxrti_load_u32(p + 12);
    }
    p = voxrti_v5_at(r, VOXRTI_V5_LEAVES);
    for (i = 0; i < leaves + 8; i++) t->leaf[i] = voxrti_load_u64(p + 8 * i);
    if (!shared) p = voxrti_v5_at(r, VOXRTI_V5_RANKS);
    for (i = 0; i < ranks; i++) t->rank[i] = voxrti_load_u32(p + 4 * i);
    if (!shared) return VOXRT_OK;
    p = voxrti_v5_at(r, VOXRTI_V5_CODES);
    for (i = 0; i < t->level_nodes[t->wide - 1]; i++) t->code[i] = (uint16_t)voxrti_load_u16(p + 2 * i);
    p = voxrti_v5_at(r, VOXRTI_V5_EXTRA);
    for (i = 0; i < ((size_t)t->level_nodes[t->wide - 1] >> VOXRTI_CODE_LOG) + 1; i++)
        t->extra[i] = voxrti_load_u32(p + 4 * i);
    return VOXRT_OK;
}

/* Palette, normals, colours. */
static voxrt_result voxrti_v5_read_attributes(voxrti_v5_reader *r, voxrt_tree *t) {
    size_t i;
    const uint8_t *p;
    t->palette = (uint8_t *)voxrti_v5_array(r, VOXRTI_V5_PALETTE);
    if (t->palette == NULL) return VOXRT_ERR_NO_MEMORY;
    if (!r->map) memcpy(t->palette, voxrti_v5_at(r, VOXRTI_V5_PALETTE), (size_t)3 * t->palette_count);
    if ((r->flags & VOXRTI_V5_HAS_NORMALS) != 0) {
        const voxrti_v5_section *s = &r->f.section[VOXRTI_V5_NORMALS];
        p = voxrti_v5_at(r, VOXRTI_V5_NORMALS);
        if (s->encoding == 1) {
            voxrt_result result;
            if (t->attr_count > (size_t)-1 / 2) return VOXRT_ERR_NO_MEMORY;
            result = voxrti_normals_decode(&r->mem, &r->desc.env, t, p, (size_t)s->size);
            if (result != VOXRT_OK) return result;
        } else {
            t->normal = (uint16_t *)voxrti_v5_array(r, VOXRTI_V5_NORMALS);
            if (t->normal == NULL) return VOXRT_ERR_NO_MEMORY;
            for (i = 0; !r->map && i < t->attr_count; i++) t->normal[i] = (uint16_t)voxrti_load_u16(p + 2 * i);
        }
    }
    if ((r->flags & VOXRTI_V5_HAS_COLORS) != 0) {
        t->colors.block_count = (size_t)r->f.section[VOXRTI_V5_BLOCKS].count;
        t->colors.block = (uint32_t *)voxrti_v5_array(r, VOXRTI_V5_BLOCKS);
        t->colors.data = (uint8_t *)voxrti_v5_array(r, VOXRTI_V5_COLORS);
        if (t->colors.block == NULL || t->colors.data == NULL) return VOXRT_ERR_NO_MEMORY;
        if (r->map) return VOXRT_OK;
        p = voxrti_v5_at(r, VOXRTI_V5_BLOCKS);
        for (i = 0; i < t->colors.block_count; i++) t->colors.block[i] = voxrti_load_u32(p + 4 * i);
        memcpy(t->colors.data, voxrti_v5_at(r, VOXRTI_V5_COLORS), t->colors.data_bytes + 8);
    }
    return VOXRT_OK;
}

/* Is what voxrti_tree_index would derive from the masks what the arrays hold? Writes nothing. */
static int voxrti_v5_consistent(const voxrt_tree *t) {
    uint32_t w, i, leaves = t->level_nodes[t->wide - 1];
    uint64_t octants, cells;
    for (w = 0; w + 1 < t->wide; w++) {
        const voxrti_node *n = t->node + t->level_first[w];
        uint64_t child = w + 2 < t->wide ? t->level_first[w + 1] : 0;
        for (i = 0, octants = 0, cells = 0; i < t->level_nodes[w]; i++) {
            if (n[i].mask == 0 || n[i].child != child + cells || n[i].octant != octants) return 0;
            cells += voxrti_popcount64(n[i].mask);
            octants += voxrti_popcount64(voxrti_octants(n[i].mask));
        }
        if (cells != t->level_nodes[w + 1] || octants != t->attr_first[2 * w] - t->attr_first[2 * w + 1]) return 0;
    }
    for (i = 0, octants = 0, cells = 0; i < leaves; i++) {
        if ((i & 15u) == 0 && (t->rank[i >> 3] != cells || t->rank[(i >> 3) + 1] != octants)) return 0;
        if (t->leaf[i] == 0) return 0;
        cells += voxrti_popcount64(t->leaf[i]);
        octants += voxrti_popcount64(voxrti_octants(t->leaf[i]));
    }
    i = (uint32_t)voxrti_rank_count(t);
    return t->rank[i - 2] == cells && t->rank[i - 1] == octants && cells == t->voxel_count &&
           octants == t->attr_first[2 * w] - t->attr_first[2 * w + 1];
}

/* Arrays of the tree whose header fields are set, and what may be wrong with them. */
static voxrt_result voxrti_v5_read_arrays(voxrti_v5_reader *r, voxrt_tree *t) {
    uint32_t raw = (r->flags & VOXRTI_V5_RAW_FILE) != 0, shared = (r->flags & VOXRTI_V5_SHARED) != 0, lo[3], hi[3], i;
    uint64_t attr_first[2 * VOXRTI_MAX_WIDE + 2], root;
    voxrt_result result;
    memcpy(lo, t->cell_min, sizeof lo);
    memcpy(hi, t->cell_max, sizeof hi);
    memcpy(attr_first, t->attr_first, sizeof attr_first);
    if (raw) {
        result = voxrti_v5_read_raw(r, t);
    } else {
        const voxrti_v5_section *s = &r->f.section[VOXRTI_V5_GEOMETRY];
        result = voxrti_geometry_decode(&r->mem, &r->desc.env, t, voxrti_v5_at(r, VOXRTI_V5_GEOMETRY), (size_t)s->size,
                                        shared ? voxrti_v5_at(r, VOXRTI_V5_SHARING) : NULL,
                                        (size_t)r->f.section[VOXRTI_V5_SHARING].size);
        /* voxel_count is part of attr_first */
        if (result == VOXRT_OK && memcmp(attr_first, t->attr_first, sizeof attr_first) != 0) result = VOXRT_ERR_FORMAT;
    }
    if (result != VOXRT_OK) return result;
    root = t->wide > 1 ? t->node[0].mask : t->leaf[0];
    if ((t->depth & 1u) != 0 && (root & ~(uint64_t)0xff) != 0) return VOXRT_ERR_FORMAT;
    result = voxrti_v5_read_attributes(r, t);
    if (result != VOXRT_OK || r->desc.trust_input) return result;
    if (raw)
        for (i = 0; i < 8; i++)
            if (t->leaf[(size_t)voxrti_v5_count(t, VOXRTI_V5_LEAVES) + i] != 0) return VOXRT_ERR_FORMAT;
    if (raw && shared) { /* finds the box, too; as decoding does */
        result = voxrti_shared_index(&r->mem, t, 0);
        if (result == VOXRT_OK && memcmp(attr_first, t->attr_first, sizeof attr_first) != 0) result = VOXRT_ERR_FORMAT;
    } else if (!shared) {
        if (raw && !voxrti_v5_consistent(t)) return VOXRT_ERR_FORMAT;
        result = voxrti_tree_box(t);
    }
    if (result != VOXRT_OK) return result;
    if (memcmp(lo, t->cell_min, sizeof lo) != 0 || memcmp(hi, t->cell_max, sizeof hi) != 0) return VOXRT_ERR_FORMAT;
    return voxrti_colors_valid(&t->colors, t->attr_count, t->palette_count) ? VOXRT_OK : VOXRT_ERR_FORMAT;
}

static voxrt_result voxrti_v5_open(voxrti_v5_reader *r, voxrt_tree **out) {
    voxrt_tree *t;
    voxrt_result result = voxrti_v5_read_table(r);
    if (result != VOXRT_OK) return result;
    if (r->map && r->f.section[VOXRTI_V5_NODES].id == 0)
        return voxrti_v5_fail(r, VOXRT_ERR_INVALID_ARG, 0, "only raw files can be used in place");
    t = (voxrt_tree *)voxrti_alloc_zero(&r->mem, 1, sizeof *t);
    if (t == NULL) return voxrti_v5_fail(r, VOXRT_ERR_NO_MEMORY, 0, voxrt_result_string(VOXRT_ERR_NO_MEMORY));
    if (r->map) t->borrowed = r->data;
    result = voxrti_v5_read_placement(r, t);
    if (result == VOXRT_OK) {
        result = voxrti_v5_read_arrays(r, t);
        if (result != VOXRT_OK)
            (void)voxrti_v5_fail(r, result, 0, result == VOXRT_ERR_NO_MEMORY ? voxrt_result_string(result) :
                                 "masks, counts or colours are inconsistent");
    }
    if (result != VOXRT_OK) {
        voxrti_tree_free(&r->mem, t);
        return result;
    }
    t->cpu_level = voxrti_cpu_level();
    t->mem = r->mem;
    t->mem.limit = 0;
    *out = t;
    return VOXRT_OK;
}

static voxrt_result voxrti_v5_load(const voxrt_load_desc *desc, const void *data, size_t size, int map,
                                   voxrt_tree **out_tree) {
    voxrti_v5_reader r;
    voxrt_result result;
    if (out_tree == NULL) return VOXRT_ERR_INVALID_ARG;
    *out_tree = NULL;
    memset(&r, 0, sizeof r);
    if (desc != NULL) r.desc = *desc;
    if (r.desc._begin_zero != 0 || r.desc._end_zero != 0) return VOXRT_ERR_UNINIT_DESC;
    if (r.desc.env.error != NULL) memset(r.desc.env.error, 0, sizeof *r.desc.env.error);
    if (data == NULL && size != 0) return voxrti_v5_fail(&r, VOXRT_ERR_INVALID_ARG, 0, "no data");
    if (size == 0) return voxrti_v5_fail(&r, VOXRT_ERR_TRUNCATED, 0, "no data");
    if (map && (((uintptr_t)data & 63u) != 0 || !voxrti_little_endian()))
        return voxrti_v5_fail(&r, VOXRT_ERR_INVALID_ARG, 0, "mapping needs 64-byte alignment and a little-endian host");
    result = voxrti_env_open(&r.desc.env, &r.mem);
    if (result != VOXRT_OK) return result;
    r.data = (const uint8_t *)data;
    r.size = size;
    r.map = map;
    return voxrti_v5_open(&r, out_tree);
}

VOXRT_DEF voxrt_result voxrt_tree_load_memory(const voxrt_load_desc *desc, const void *data, size_t size,
                                              voxrt_tree **out_tree) {
    return voxrti_v5_load(desc, data, size, 0, out_tree);
}

VOXRT_DEF voxrt_result voxrt_tree_map_memory(const voxrt_load_desc *desc, const void *data, size_t size,
                                             voxrt_tree **out_tree) {
    return voxrti_v5_load(desc, data, size, 1, out_tree);
}

/* ---- files ---- */

#ifndef VOXRT_NO_STDIO

/* Write `size` bytes to path.part, then rename. Shared with the other format. */
static VOXRTI_UNUSED voxrt_result voxrti_write_file(voxrti_mem *mem, const char *path, const void *data, size_t size) {
    size_t n = strlen(path);
    char *part = (char *)voxrti_alloc(mem, n + 6);
    FILE *file;
    int ok;
    if (part == NULL) return VOXRT_ERR_NO_MEMORY;
    memcpy(part, path, n);
    memcpy(part + n, ".part", 6);
    file = fopen(part, "wb");
    ok = file != NULL;
    if (ok) {
        ok = fwrite(data, 1, size, file) == size;
        ok = fclose(file) == 0 && ok;
#ifdef _WIN32 /* rename does not replace there */
        if (ok) (void)remove(path);
#endif
        ok = ok && rename(part, path) == 0;
        if (!ok) (void)remove(part);
    }
    voxrti_free(mem, part);
    return ok ? VOXRT_OK : VOXRT_ERR_IO;
}

/* The whole file into memory from `mem`; grows with what is really there. */
static VOXRTI_UNUSED voxrt_result voxrti_read_file(voxrti_mem *mem, const char *path, void **data, size_t *size) {
    FILE *file = fopen(path, "rb");
    size_t capacity = 0, n = 0, got;
    voxrt_result r = VOXRT_OK;
    *data = NULL;
    *size = 0;
    if (file == NULL) return VOXRT_ERR_IO;
    do {
        if (n == capacity && !voxrti_grow(mem, data, &capacity, n, n < 65536 ? 65536 : n + 1, 1)) {
            r = VOXRT_ERR_NO_MEMORY;
            break;
        }
        got = fread((uint8_t *)*data + n, 1, capacity - n, file);
        n += got;
    } while (got != 0);
    if (r == VOXRT_OK && ferror(file) != 0) r = VOXRT_ERR_IO;
    (void)fclose(file);
    if (r != VOXRT_OK) {
        voxrti_free(mem, *data);
        *data = NULL;
    }
    *size = n;
    return r;
}

VOXRT_DEF voxrt_result voxrt_tree_save_file(const voxrt_tree *tree, const voxrt_save_desc *desc, const char *path) {
    voxrt_save_desc d;
    voxrti_mem mem;
    voxrti_v5_file f;
    size_t size = 0;
    uint8_t *data = NULL;
    voxrt_result r = voxrti_save_open(tree, desc, &d, &mem);
    if (r != VOXRT_OK) return r;
    if (path == NULL) return voxrti_fail(d.env.error, VOXRT_ERR_INVALID_ARG, 0, "no path");
    r = voxrti_v5_plan(&mem, &d, tree, &f, &size);
    if (r == VOXRT_OK) {
        data = (uint8_t *)voxrti_alloc(&mem, size);
        if (data == NULL) r = VOXRT_ERR_NO_MEMORY;
        else voxrti_v5_write(tree, &f, data, size);
    }
    voxrti_free(&mem, f.geometry.data);
    voxrti_free(&mem, f.normals.data);
    voxrti_free(&mem, f.sharing.data);
    if (r == VOXRT_OK) r = voxrti_write_file(&mem, path, data, size);
    voxrti_free(&mem, data);
    return r == VOXRT_OK ? r : voxrti_fail(d.env.error, r, 0, voxrt_result_string(r));
}

VOXRT_DEF voxrt_result voxrt_tree_load_file(const voxrt_load_desc *desc, const char *path, voxrt_tree **out_tree) {
    voxrt_load_desc d;
    voxrti_mem mem;
    voxrt_result r;
    void *data;
    size_t size;
    if (out_tree == NULL) return VOXRT_ERR_INVALID_ARG;
    *out_tree = NULL;
    memset(&d, 0, sizeof d);
    if (desc != NULL) d = *desc;
    if (d._begin_zero != 0 || d._end_zero != 0) return VOXRT_ERR_UNINIT_DESC;
    if (d.env.error != NULL) memset(d.env.error, 0, sizeof *d.env.error);
    if (path == NULL) return voxrti_fail(d.env.error, VOXRT_ERR_INVALID_ARG, 0, "no path");
    r = voxrti_env_open(&d.env, &mem);
    if (r != VOXRT_OK) return r;
    r = voxrti_read_file(&mem, path, &data, &size);
    if (r != VOXRT_OK) return voxrti_fail(d.env.error, r, 0, voxrt_result_string(r));
    if (d.env.memory_limit != 0) /* what the file itself holds counts */
        d.env.memory_limit = d.env.memory_limit > mem.used ? d.env.memory_limit - mem.used : 1;
    r = voxrt_tree_load_memory(&d, data, size, out_tree);
    voxrti_free(&mem, data);
    return r;
}
#endif
/* ---------------------------------------------------------------------------
   trace: rays through the wide tree.                                            // >>trace

   A ray is mirrored so that it runs in the positive direction of every axis. Its crossing with plane i of axis a is
   the event T_a(i) = (i - o_a) * inv_a, in double precision. All decisions compare events, ties go x before y before
   z, and the cell at time t is the number of events up to t: so the sequence of leaf cells along a ray is fixed by
   the ray alone, whatever empty space is jumped and wherever a beam starts. Exactly one axis steps at a time: the
   path is 6-connected and cannot slip through a 6-separating surface. No epsilon, at most 3*2^depth steps.
   Popping: the highest bit in which old and new cell differ tells the common ancestor.
   Every instruction set computes the same events with the same operations: equal bits.
   --------------------------------------------------------------------------- */

#define VOXRTI_INF ((double)INFINITY)

typedef struct voxrti_rayx {
    double o[3], d[3], inv[3]; /* grid units, mirrored, d >= 0; for d = 0: o = centre of the cell, inv = infinity */
    double t, t_end, t_min;    /* first and last time inside the box of filled cells; start of the ray */
    double base;               /* added to t when the origin was moved next to the box */
    uint32_t c[3];             /* cell at time t, mirrored */
    uint32_t flip;             /* 9 << a for mirrored axes: turns a mirrored slot into a real one */
} voxrti_rayx;

typedef struct voxrti_cone { /* footprint in cells at time t: at least floor_, and width + spread * t */
    double width, spread, floor_;
    int on;
    uint32_t lo[3], hi[3]; /* box of the filled cells, in whole cells of edge floor_ */
} voxrti_cone;

/* ---- exact setup for origins far away: double-double numbers (Dekker 1971, Knuth) ---- */

typedef struct voxrti_dd { double h, l; } voxrti_dd;

static voxrti_dd voxrti_two_sum(double a, double b) {
    voxrti_dd r;
    double bb;
    r.h = a + b;
    bb = r.h - a;
    r.l = (a - (r.h - bb)) + (b - bb);
    return r;
}
static voxrti_dd voxrti_two_prod(double a, double b) {
    voxrti_dd r;
    double p = a * 134217729.0, ah = p - (p - a), al = a - ah, q = b * 134217729.0, bh = q - (q - b), bl = b - bh;
    r.h = a * b;
    r.l = ((ah * bh - r.h) + ah * bl + al * bh) + al * bl;
    return r;
}
static voxrti_dd voxrti_dd_add(voxrti_dd a, voxrti_dd b) {
    voxrti_dd s = voxrti_two_sum(a.h, b.h);
    return voxrti_two_sum(s.h, s.l + (a.l + b.l));
}
static voxrti_dd voxrti_dd_mul(voxrti_dd a, double b) {
    voxrti_dd p = voxrti_two_prod(a.h, b);
    return voxrti_two_sum(p.h, p.l + a.l * b);
}
static voxrti_dd voxrti_dd_div(voxrti_dd a, double b) {
    double q = a.h / b;
    voxrti_dd r = voxrti_two_prod(-q, b);
    r = voxrti_dd_add(a, r);
    return voxrti_two_sum(q, r.h / b);
}

/* Cell of axis b at time t, when axis k has just stepped at t (3: count all events at t). lo <= result <= hi. */
VOXRTI_INLINE uint32_t voxrti_cell_at(const voxrti_rayx *r, uint32_t b, double t, uint32_t k, uint32_t lo,
                                      uint32_t hi) {
    double p = r->o[b] + t * r->d[b], e;
    uint32_t q = p > (double)lo ? p < (double)hi ? (uint32_t)(int32_t)p : hi : lo;
    while (q < hi) {
        e = ((double)(q + 1) - r->o[b]) * r->inv[b];
        if (!(e < t || (e == t && b < k))) break;
        q++;
    }
    while (q > lo) {
        e = ((double)q - r->o[b]) * r->inv[b];
        if (!(e > t || (e == t && b > k))) break;
        q--;
    }
    return q;
}

/* Move the origin of a ray that starts far outside next to the box, exactly to 2^-40 cells up to 2^60 cells away.
   og: the origin in grid units, mirrored. 0: not possible. */
static VOXRTI_NOINLINE int voxrti_ray_rebase(voxrti_rayx *r, const voxrti_dd og[3], const double lo[3],
                                              const double hi[3]) {
    voxrti_dd t, p, q;
    uint32_t a, k = 3;
    t.h = -VOXRTI_INF; /* the box may lie behind the origin: t_min decides */
    t.l = 0;
    for (a = 0; a < 3; a++) {
        if (r->d[a] == 0) continue;
        p.h = lo[a];
        p.l = 0;
        q.h = -og[a].h;
        q.l = -og[a].l;
        p = voxrti_dd_div(voxrti_dd_add(p, q), r->d[a]);
        if (p.h > t.h || (p.h == t.h && p.l > t.l)) {
            t = p;
            k = a;
        }
    }
    if (k == 3) return 0; /* numbers too large to compute with */
    r->base = t.h;
    for (a = 0; a < 3; a++) {
        if (r->d[a] == 0) continue;
        p = voxrti_dd_add(og[a], voxrti_dd_mul(t, r->d[a]));
        r->o[a] = a == k ? lo[a] : p.h + p.l;
        if (!(r->o[a] >= lo[a] - 2)) r->o[a] = lo[a] - 2; /* passes by, or NaN */
        if (r->o[a] > hi[a] + 2) r->o[a] = hi[a] + 2;
    }
    return 1;
}

VOXRTI_INLINE double voxrti_footprint(const voxrti_cone *cone, double t) {
    return voxrti_max(cone->floor_, cone->width + cone->spread * t);
}

#if VOXRTI_X64
#  if defined(_MSC_VER) && !defined(__clang__)
#    define VOXRTI_TARGET_SSE4
#  else
#    define VOXRTI_TARGET_SSE4 __attribute__((target("sse4.1,popcnt")))
#  endif
#endif

/* ---- AVX2: helpers ---- */

#if VOXRTI_AVX2

#define VOXRTI_LOAD4(a) _mm_loadu_si128((const __m128i *)(const void *)(a))
#define VOXRTI_STORE4(a, v) _mm_storeu_si128((__m128i *)(void *)(a), v)
#define VOXRTI_LOADI(a) _mm256_loadu_si256((const __m256i *)(const void *)(a))
#define VOXRTI_STOREI(a, v) _mm256_storeu_si256((__m256i *)(void *)(a), v)
#define VOXRTI_PS(v) _mm256_castsi256_ps(v)
#define VOXRTI_SIGNS(v) ((uint32_t)_mm256_movemask_ps(VOXRTI_PS(v)))
/* b where m is negative */
#define VOXRTI_BLENDI(a, b, m) _mm256_castps_si256(_mm256_blendv_ps(VOXRTI_PS(a), VOXRTI_PS(b), VOXRTI_PS(m)))

VOXRTI_TARGET_AVX2 static inline __m128i voxrti_narrow4(__m256d mask) {
    __m256i v = _mm256_castpd_si256(mask);
    return _mm_castps_si128(_mm_shuffle_ps(_mm_castsi128_ps(_mm256_castsi256_si128(v)),
                                           _mm_castsi128_ps(_mm256_extracti128_si256(v, 1)), 0xdd));
}

#endif

/* ---- beam: where the rays of a tile can first meet anything (after Laine & Karras 2010; Wald et al. 2006) ----
   Rays with one origin that all run along axis m stay inside the slopes [lo, hi] of the two other axes. The tree is
   walked front to back through that frustum, slab by slab: a slab is a layer of cells of one level between two planes
   of axis m; a slab of one level is four of the next. The cells of a slab that the frustum meets are collected from
   all nodes of the slab above it, the 64 cells of a node at a time by mask operations. */

#define VOXRTI_BEAM_CELLS 224        /* room for the cells of the slabs that the walk stands in; at most 256 */
#define VOXRTI_BEAM_ACROSS 8         /* most cells of a slab along u or v (a pair: twice): a wider one ends the walk */
#define VOXRTI_BEAM_MARGIN 0.0078125 /* cells; covers rounding of slopes and positions up to 2^20 cells */

typedef struct voxrti_beam_cell {
    uint32_t node, parent; /* the node that stands for the cell; position in b->cell of the one above it */
    int32_t u, v;          /* in cells of its size */
    uint64_t left;         /* cells in it that the frustum meets */
} voxrti_beam_cell;

typedef struct voxrti_beam_range { int32_t u0[4], u1[4], v0[4], v1[4]; } voxrti_beam_range;

typedef struct voxrti_beam {
    uint32_t on;            /* 0: no beam; 1: rays start at plane z; infinity: nothing can be hit */
    uint32_t m, u, v;       /* main axis and the others */
    uint32_t back;          /* 1: the main axis is mirrored (rays run in its negative direction) */
    double om, o[2];        /* origin: main axis (mirrored), u, v */
    double lo[2], hi[2];    /* slopes du/dm, dv/dm */
    double slow, fast;      /* with level of detail: most and least units of t per cell along the main axis */
    double z;               /* plane of axis m, mirrored coordinates, at which the slab found last begins */
    uint32_t size, first, count;     /* this slab: edge of its cells, b->cell[first .. first + count) */
    uint32_t pair;                   /* 1: it is two; `left` of its cells: 0 or 1 */
    int32_t u0, v0, u1, v1;          /* and the cells that the frustum covers: first and last along u and v */
    uint32_t w;                      /* level whose slabs are being looked through; for it and those above: */
    uint32_t next[VOXRTI_MAX_WIDE];  /* next of its four slabs */
    uint32_t begin[VOXRTI_MAX_WIDE + 1]; /* first of its nodes in `cell`; then the next level's */
    uint32_t plane[VOXRTI_MAX_WIDE]; /* plane at which its first slab begins */
    uint64_t any[VOXRTI_MAX_WIDE];   /* union of its nodes' `left` */
    voxrti_beam_range range[VOXRTI_MAX_WIDE]; /* cells that the frustum covers in each of the four slabs */
    voxrti_beam_cell cell[VOXRTI_BEAM_CELLS];
} voxrti_beam;

/* voxrti_axis_range[a][6 * (i + 1) + k + 1]: cells i..k (cut to 0..3) of axis a as a mask; -1 and 4 lie outside */
#define VOXRTI_RANGES(c0, c1, c2, c3) { \
    0, c0, c0 | c1, c0 | c1 | c2, c0 | c1 | c2 | c3, c0 | c1 | c2 | c3, \
    0, c0, c0 | c1, c0 | c1 | c2, c0 | c1 | c2 | c3, c0 | c1 | c2 | c3, \
    0, 0, c1, c1 | c2, c1 | c2 | c3, c1 | c2 | c3,  0, 0, 0, c2, c2 | c3, c2 | c3,  0, 0, 0, 0, c3, c3, \
    0, 0, 0, 0, 0, 0}
static const uint64_t voxrti_axis_range[3][36] = {
    VOXRTI_RANGES(0x0055005500550055u, 0x00aa00aa00aa00aau, 0x5500550055005500u, 0xaa00aa00aa00aa00u),
    VOXRTI_RANGES(0x0000333300003333u, 0x0000cccc0000ccccu, 0x3333000033330000u, 0xcccc0000cccc0000u),
    VOXRTI_RANGES(0x000000000f0f0f0fu, 0x00000000f0f0f0f0u, 0x0f0f0f0f00000000u, 0xf0f0f0f000000000u)
};

/* The four layers of a node along axis m, front to back. */
VOXRTI_INLINE uint64_t voxrti_beam_slab(const voxrti_beam *b, uint32_t s) {
    return voxrti_axis_range[b->m][7 * (b->back ? 4 - s : s + 1)];
}

VOXRTI_INLINE int32_t voxrti_floor_cell(double x) { return (int32_t)(x + 33554432.0) - 33554432; } /* |x| < 2^25 */

VOXRTI_INLINE uint32_t voxrti_range_index(int32_t i, int32_t k) {
    i = i < -1 ? -1 : i > 4 ? 4 : i;
    k = k < -1 ? -1 : k > 4 ? 4 : k;
    return (uint32_t)(6 * i + k + 7);
}

/* Cells of edge `size` that the frustum meets in four slabs from plane b->plane[w] on, in each node of level w. */
static VOXRTI_UNUSED void voxrti_beam_cut(const voxrt_tree *t, voxrti_beam *b, uint32_t w, double size) {
    voxrti_beam_range *r = &b->range[w];
    double z0 = (double)b->plane[w] - b->om, inv_size = 1.0 / size, z1;
    uint64_t any = 0;
    uint32_t i, s;
    for (s = 0; s < 4; s++, z0 = z1) {
        double from = voxrti_max(z0, 0), p, q, margin = VOXRTI_BEAM_MARGIN;
        z1 = z0 + size;
        p = b->o[0] + voxrti_min(from * b->lo[0], z1 * b->lo[0]) - margin;
        q = b->o[0] + voxrti_max(from * b->hi[0], z1 * b->hi[0]) + margin;
        r->u0[s] = voxrti_floor_cell(p * inv_size);
        r->u1[s] = z1 < 0 ? -1 : voxrti_floor_cell(q * inv_size); /* behind the origin: none */
        p = b->o[1] + voxrti_min(from * b->lo[1], z1 * b->lo[1]) - margin;
        q = b->o[1] + voxrti_max(from * b->hi[1], z1 * b->hi[1]) + margin;
        r->v0[s] = voxrti_floor_cell(p * inv_size);
        r->v1[s] = voxrti_floor_cell(q * inv_size);
    }
    for (i = b->begin[w]; i < b->begin[w + 1]; i++) {
        voxrti_beam_cell *c = &b->cell[i];
        int32_t u = 4 * c->u, v = 4 * c->v;
        uint64_t cells = 0;
        for (s = 0; s < 4; s++)
            cells |= voxrti_beam_slab(b, s) & voxrti_axis_range[b->u][voxrti_range_index(r->u0[s] - u, r->u1[s] - u)] &
                     voxrti_axis_range[b->v][voxrti_range_index(r->v0[s] - v, r->v1[s] - v)];
        c->left = cells & t->node[c->node].mask;
        any |= c->left;
    }
    b->any[w] = any;
}

#if VOXRTI_AVX2
/* The same, the four slabs at once. */
VOXRTI_TARGET_AVX2 static void voxrti_beam_cut_avx2(const voxrt_tree *t, voxrti_beam *b, uint32_t w, double size) {
    const __m256d zero = _mm256_setzero_pd(), margin = _mm256_set1_pd(VOXRTI_BEAM_MARGIN);
    const __m256d inv_size = _mm256_set1_pd(1.0 / size), step = _mm256_set1_pd(size);
    const __m128i out = _mm_set1_epi32(-1), past = _mm_set1_epi32(4), seven = _mm_set1_epi32(7);
    __m256d z0 = _mm256_add_pd(_mm256_set1_pd((double)b->plane[w] - b->om),
                               _mm256_mul_pd(step, _mm256_setr_pd(0, 1, 2, 3)));
    __m256d z1 = _mm256_add_pd(z0, step), from = _mm256_max_pd(z0, zero), p, q;
    __m128i first[2], last[2];
    uint64_t any = 0, slab[4];
    uint32_t i, a, index[2][4];
    const int codes = t->code != NULL && w + 2 == t->wide;
    for (a = 0; a < 2; a++) {
        const __m256d o = _mm256_set1_pd(b->o[a]), lo = _mm256_set1_pd(b->lo[a]), hi = _mm256_set1_pd(b->hi[a]);
        p = _mm256_sub_pd(_mm256_min_pd(_mm256_mul_pd(from, lo), _mm256_mul_pd(z1, lo)), margin);
        q = _mm256_add_pd(_mm256_max_pd(_mm256_mul_pd(from, hi), _mm256_mul_pd(z1, hi)), margin);
        first[a] = _mm256_cvttpd_epi32(_mm256_floor_pd(_mm256_mul_pd(_mm256_add_pd(p, o), inv_size)));
        last[a] = _mm256_cvttpd_epi32(_mm256_floor_pd(_mm256_mul_pd(_mm256_add_pd(q, o), inv_size)));
    }
    last[0] = _mm_blendv_epi8(last[0], out, voxrti_narrow4(_mm256_cmp_pd(z1, zero, _CMP_LT_OQ)));
    VOXRTI_STORE4(b->range[w].u0, first[0]);
    VOXRTI_STORE4(b->range[w].u1, last[0]);
    VOXRTI_STORE4(b->range[w].v0, first[1]);
    VOXRTI_STORE4(b->range[w].v1, last[1]);
    for (i = 0; i < 4; i++) slab[i] = voxrti_beam_slab(b, i);
    for (i = b->begin[w]; i < b->begin[w + 1]; i++) {
        voxrti_beam_cell *c = &b->cell[i];
        uint64_t cells = 0;
        for (a = 0; a < 2; a++) {
            const __m128i at = _mm_set1_epi32(4 * (a == 0 ? c->u : c->v));
            __m128i x = _mm_max_epi32(_mm_min_epi32(_mm_sub_epi32(first[a], at), past), out);
            __m128i y = _mm_max_epi32(_mm_min_epi32(_mm_sub_epi32(last[a], at), past), out);
            x = _mm_add_epi32(_mm_add_epi32(x, x), _mm_slli_epi32(x, 2));
            VOXRTI_STORE4(index[a], _mm_add_epi32(_mm_add_epi32(x, y), seven));
        }
        for (a = 0; a < 4; a++)
            cells |= slab[a] & voxrti_axis_range[b->u][index[0][a]] & voxrti_axis_range[b->v][index[1][a]];
        c->left = cells & t->node[c->node].mask;
        any |= c->left;
        if (codes) VOXRTI_PREFETCH(t->code + t->node[c->node].child);
    }
    b->any[w] = any;
}
#else
#define voxrti_beam_cut_avx2 voxrti_beam_cut /* never asked for */
#endif

/* Walk on to the next slab with cells in the frustum. 0: there is none. 1: its cells are leaf nodes (edge 4), or, with
   `avx2`, nodes above them whose cells or octants are the smallest that level of detail may have to look at; if these
   are octants of one size, two slabs at a time. 2: stop: it is too wide, or has cells that level of detail may accept,
   or holds the origin. */
VOXRTI_INLINE uint32_t voxrti_beam_walk(const voxrt_tree *t, const voxrti_cone *cone, voxrti_beam *b, int avx2) {
    for (;;) {
        uint32_t w = b->w, s = b->next[w]++, sh = 2 * (t->wide - 1 - w), i, end = b->begin[w + 1], n = end;
        double size = (double)((uint32_t)1 << sh);
        uint64_t slab;
        const char *base = sh == 2 ? (const char *)t->leaf : (const char *)t->node;
        const uint32_t shift = sh == 2 ? 3 : 4;
        if (s == 4) {
            if (w == 0) return 0;
            b->w--;
            continue;
        }
        slab = voxrti_beam_slab(b, s);
        b->z = (double)(b->plane[w] + (s << sh));
        b->pair = 0;
        if (avx2 && cone->on && (s & 1u) == 0 && b->z >= b->om &&
            2.0 * voxrti_footprint(cone, (b->z - b->om) * b->fast) >= size &&
            voxrti_footprint(cone, (b->z + 2.0 * size - b->om) * b->slow) < size) {
            b->pair = 1;
            b->next[w]++;
            slab |= voxrti_beam_slab(b, s + 1);
        }
        if ((b->any[w] & slab) == 0) continue;
        for (i = b->begin[w]; i < end; i++) {
            const voxrti_beam_cell c = b->cell[i];
            const uint64_t mask = t->node[c.node].mask;
            const uint32_t child = t->node[c.node].child;
            uint64_t cells = c.left & slab;
            for (; cells != 0 && n < VOXRTI_BEAM_CELLS; cells &= cells - 1) {
                uint32_t slot = voxrti_ctz64(cells);
                voxrti_beam_cell *to = &b->cell[n++];
                to->node = child + voxrti_popcount64(mask & (((uint64_t)1 << slot) - 1));
                to->parent = i;
                if (sh == 2) to->node = voxrti_leaf_at(t, to->node);
                VOXRTI_PREFETCH(base + ((size_t)to->node << shift));
                to->u = 4 * c.u + (int32_t)((slot >> b->u & 1u) | (slot >> (b->u + 2) & 2u));
                to->v = 4 * c.v + (int32_t)((slot >> b->v & 1u) | (slot >> (b->v + 2) & 2u));
                if (avx2) to->left = (slot >> b->m ^ b->back) & 1u;
            }
        }
        b->size = (uint32_t)1 << sh;
        b->first = end;
        b->count = n - end;
        b->u0 = b->range[w].u0[s];
        b->u1 = b->range[w].u1[s];
        b->v0 = b->range[w].v0[s];
        b->v1 = b->range[w].v1[s];
        if (b->pair) {
            const voxrti_beam_range *r = &b->range[w];
            b->u0 = b->u0 < r->u0[s + 1] ? b->u0 : r->u0[s + 1];
            b->u1 = b->u1 > r->u1[s + 1] ? b->u1 : r->u1[s + 1];
            b->v0 = b->v0 < r->v0[s + 1] ? b->v0 : r->v0[s + 1];
            b->v1 = b->v1 > r->v1[s + 1] ? b->v1 : r->v1[s + 1];
        }
        if (b->u1 - b->u0 >= VOXRTI_BEAM_ACROSS << b->pair || b->v1 - b->v0 >= VOXRTI_BEAM_ACROSS << b->pair ||
            n == VOXRTI_BEAM_CELLS)
            return 2;
        if (b->pair) return 1;
        if (cone->on) {
            const double most = voxrti_footprint(cone, (b->z + size - b->om) * b->slow);
            if (avx2 ? size <= most : size <= 2.0 * most) return 2;
            if (avx2 && size <= 4.0 * most) return b->z < b->om ? 2 : 1;
        }
        if (sh == 2) return b->z < b->om ? 2 : 1;
        b->w = ++w;
        b->next[w] = 0;
        b->plane[w] = b->plane[w - 1] + (s << sh);
        b->begin[w + 1] = n;
        if (avx2) voxrti_beam_cut_avx2(t, b, w, 0.25 * size);
        else voxrti_beam_cut(t, b, w, 0.25 * size);
    }
}

/* Nodes from the root to one of level w: rays may start at the deepest that holds them. */
typedef struct voxrti_chain {
    uint64_t at[VOXRTI_MAX_WIDE]; /* addresses; but the root's */
    uint32_t w, cell[3]; /* the leaf cell at the last one's corner, not mirrored */
} voxrti_chain;

VOXRTI_INLINE uint64_t voxrti_address(const voxrt_tree *t, uint32_t w, uint32_t node) {
    return (uint64_t)(w + 1 == t->wide ? (uintptr_t)(t->leaf + node) : (uintptr_t)(t->node + node));
}

/* The nodes down to the first cell of the slab found last; not to itself where level of detail may accept it. */
static VOXRTI_UNUSED void voxrti_beam_chain(const voxrt_tree *t, const voxrti_cone *cone, const voxrti_beam *b,
                                            voxrti_chain *chain) {
    const voxrti_beam_cell *c = &b->cell[b->first];
    uint32_t l;
    chain->cell[b->u] = (uint32_t)c->u * b->size;
    chain->cell[b->v] = (uint32_t)c->v * b->size;
    chain->cell[b->m] = b->back ? ((uint32_t)1 << (2 * t->wide)) - ((uint32_t)b->z + b->size) : (uint32_t)b->z;
    for (l = b->w + 1; l > 0; l--, c = &b->cell[c->parent]) chain->at[l] = voxrti_address(t, l, c->node);
    chain->w = cone->on ? b->w : b->w + 1;
}

VOXRTI_INLINE uint32_t voxrti_slot_of(const uint32_t c[3], uint32_t sh) {
    static const uint8_t spread[4] = {0, 1, 8, 9};
    return (uint32_t)spread[c[0] >> sh & 3u] | (uint32_t)spread[c[1] >> sh & 3u] << 1 |
           (uint32_t)spread[c[2] >> sh & 3u] << 2;
}

/* Address of the root. */
static VOXRTI_UNUSED uint64_t voxrti_root(const voxrt_tree *t) {
    return (uint64_t)(t->wide == 1 ? (uintptr_t)t->leaf : (uintptr_t)t->node);
}

/* The nodes down to the one that holds the origin of a ray, if it lies in the box of the filled cells. */
static VOXRTI_UNUSED void voxrti_chain_to(const voxrt_tree *t, const voxrt_ray *ray, voxrti_chain *chain) {
    const double scale = 1.0 / t->voxel_size;
    uint32_t a, w, node = 0;
    chain->w = 0;
    for (a = 0; a < 3; a++) {
        const double o = ((double)ray->org[a] - t->origin[a]) * scale;
        if (!(o >= (double)t->cell_min[a] && o < (double)t->cell_max[a])) return;
        chain->cell[a] = (uint32_t)(int32_t)o;
    }
    for (w = 0; w + 1 < t->wide; w++) {
        const voxrti_node *n = &t->node[node];
        const uint32_t slot = voxrti_slot_of(chain->cell, 2 * (t->wide - 1 - w));
        if ((n->mask >> slot & 1u) == 0) break;
        node = n->child + voxrti_popcount64(n->mask & (((uint64_t)1 << slot) - 1));
        if (w + 2 == t->wide) node = voxrti_leaf_at(t, node);
        chain->at[w + 1] = voxrti_address(t, w + 1, node);
    }
    chain->w = w;
}

/* Origin and main axis of n rays, if they can make a beam. Then the slopes have to be found. */
static int voxrti_beam_open(const voxrt_tree *t, const voxrt_ray *rays, uint32_t n, voxrti_beam *b) {
    double o[3], scale = 1.0 / t->voxel_size;
    const float *org = rays[0].org, *dir = rays[0].dir;
    float x = voxrti_absf(dir[0]), y = voxrti_absf(dir[1]), z = voxrti_absf(dir[2]);
    uint32_t a;
    b->on = 0;
    if (n < 8 || t->wide == 1 || memcmp(org, rays[n - 1].org, 12) != 0) return 0;
    b->m = x > y ? (x > z ? 0u : 2u) : (y > z ? 1u : 2u);
    b->u = b->m == 0 ? 1u : 0u;
    b->v = b->m == 2 ? 1u : 2u;
    b->back = dir[b->m] < 0;
    for (a = 0; a < 3; a++) {
        o[a] = ((double)org[a] - t->origin[a]) * scale;
        if (!(voxrti_abs(o[a]) < 1048576.0)) return 0;
    }
    b->om = b->back ? (double)((uint32_t)1 << (2 * t->wide)) - o[b->m] : o[b->m];
    b->o[0] = o[b->u];
    b->o[1] = o[b->v];
    return 1;
}

/* Slopes are known: start the walk at the root. least: smallest component of a direction along the main axis. */
VOXRTI_INLINE int voxrti_beam_start(const voxrt_tree *t, const voxrti_cone *cone, double least, voxrti_beam *b,
                                   int avx2) {
    double full = (double)((uint32_t)1 << (2 * t->wide));
    uint32_t i;
    for (i = 0; i < 2; i++)
        if (!(b->lo[i] > -8.0 && b->hi[i] < 8.0 && b->hi[i] - b->lo[i] <= 0.25)) return 0;
    b->slow = 0;
    if (cone->on) { /* octants of the root must not be cells of level of detail: the walk starts at its bits */
        b->slow = t->voxel_size / least * (1.0 + 1e-9);
        if (2.0 * voxrti_footprint(cone, (voxrti_abs(b->om) + full) * b->slow) >= full) return 0;
    }
    memset(&b->cell[0], 0, sizeof b->cell[0]);
    b->w = b->next[0] = b->plane[0] = b->begin[0] = 0;
    b->begin[1] = 1;
    if (avx2) voxrti_beam_cut_avx2(t, b, 0, 0.25 * full);
    else voxrti_beam_cut(t, b, 0, 0.25 * full);
    return 1;
}

/* Common start of n <= 64 rays, if they have one origin, start at it or before it (a beam sees nothing behind its
   origin) and run along one axis. */
static VOXRTI_UNUSED void voxrti_beam_find(const voxrt_tree *t, const voxrti_cone *cone, const voxrt_ray *rays,
                                           uint32_t n, voxrti_beam *b) {
    double least = VOXRTI_INF, sign;
    uint32_t i, k, bad = 0;
    if (!voxrti_beam_open(t, rays, n, b)) return;
    sign = b->back ? -1.0 : 1.0;
    for (k = 0; k < 2; k++) {
        b->lo[k] = VOXRTI_INF;
        b->hi[k] = -VOXRTI_INF;
    }
    for (i = 0; i < n; i++) {
        double dm = (double)rays[i].dir[b->m] * sign, inv = 1.0 / dm, s[2];
        s[0] = (double)rays[i].dir[b->u] * inv;
        s[1] = (double)rays[i].dir[b->v] * inv;
        bad |= !(dm > 0) | (memcmp(rays[i].org, rays[0].org, 12) != 0) | !(rays[i].t_min >= 0.0f);
        least = voxrti_min(least, dm);
        for (k = 0; k < 2; k++) {
            bad |= !voxrti_finite(s[k]);
            b->lo[k] = voxrti_min(b->lo[k], s[k]);
            b->hi[k] = voxrti_max(b->hi[k], s[k]);
        }
    }
    if (bad || !voxrti_beam_start(t, cone, least, b, 0)) return;
    b->on = 1;
    if (voxrti_beam_walk(t, cone, b, 0) == 0) b->z = VOXRTI_INF;
}

/* Times below this round to floats less than x. */
static double voxrti_below(float x) {
    uint32_t bits;
    float before;
    if (x < -3.402823466e38f) x = -3.402823466e38f; /* the bits before -infinity are a NaN's */
    memcpy(&bits, &x, sizeof bits);
    bits = (bits & 0x7fffffffu) == 0 ? 0x80000001u : (bits >> 31) != 0 ? bits + 1u : bits - 1u;
    memcpy(&before, &bits, sizeof before);
    return 0.5 * ((double)before + (double)x);
}

/* Ray -> grid. 0: misses the box of filled cells; -1: not a usable ray. */
static VOXRTI_UNUSED int voxrti_ray_setup(const voxrt_tree *t, const voxrti_cone *cone, const voxrt_ray *ray,
                                          const voxrti_beam *beam, voxrti_rayx *r) {
    double lo[3], hi[3], full = (double)((uint32_t)1 << (2 * t->wide)), scale = 1.0 / t->voxel_size;
    double big = 0, t_in = -VOXRTI_INF, t_out = VOXRTI_INF;
    uint32_t a, k = 3;
    int moving = 0;
    r->flip = 0;
    r->base = 0;
    for (a = 0; a < 3; a++) {
        double o = ((double)ray->org[a] - t->origin[a]) * scale, d = (double)ray->dir[a] * scale;
        if (!voxrti_finite(o) || !voxrti_finite(d)) return -1;
        lo[a] = (double)cone->lo[a];
        hi[a] = (double)cone->hi[a];
        r->inv[a] = VOXRTI_INF;
        if (d < 0) {
            o = full - o;
            d = -d;
            lo[a] = full - (double)cone->hi[a];
            hi[a] = full - (double)cone->lo[a];
            r->flip |= 9u << a;
        }
        if (d != 0) r->inv[a] = 1.0 / d;
        if (r->inv[a] == VOXRTI_INF) d = 0;
        else moving = 1;
        r->o[a] = o;
        r->d[a] = d;
        big = voxrti_max(big, voxrti_abs(o));
    }
    if (!moving || !(ray->t_min <= ray->t_max)) return -1;
    if (big > 16777216.0) {
        voxrti_dd og[3];
        for (a = 0; a < 3; a++) {
            og[a] = voxrti_two_sum((double)ray->org[a], -t->origin[a]);
            if (scale != 1.0) og[a] = voxrti_dd_mul(og[a], scale);
            if (r->flip >> a & 1u) {
                voxrti_dd f;
                f.h = full;
                f.l = 0;
                og[a].h = -og[a].h;
                og[a].l = -og[a].l;
                og[a] = voxrti_dd_add(f, og[a]);
            }
        }
        if (!voxrti_ray_rebase(r, og, lo, hi)) return 0;
    }
    for (a = 0; a < 3; a++) {
        double e;
        if (r->d[a] == 0) {
            if (!(r->o[a] >= lo[a] && r->o[a] < hi[a])) return 0;
            r->o[a] = (double)(int32_t)r->o[a] + 0.5;
            continue;
        }
        e = (lo[a] - r->o[a]) * r->inv[a];
        if (e > t_in) {
            t_in = e;
            k = a;
        }
        t_out = voxrti_min(t_out, (hi[a] - r->o[a]) * r->inv[a]);
    }
    r->t_min = (double)ray->t_min - r->base;
    r->t = voxrti_max(t_in, r->t_min);
    if (r->t > t_in) k = 3;
    /* times beyond the largest float are misses: a hit's t is finite */
    r->t_end = voxrti_min(t_out, voxrti_min(voxrti_below(ray->t_max), 3.4028234663852886e38) - r->base);
    if (beam != NULL && beam->on && big <= 16777216.0) {
        double e = (beam->z - r->o[beam->m]) * r->inv[beam->m];
        if (e > r->t) {
            r->t = e;
            k = beam->m;
            lo[k] = beam->z;
        }
    }
    if (!(r->t < r->t_end)) return 0;
    for (a = 0; a < 3; a++) {
        uint32_t l = (uint32_t)lo[a];
        r->c[a] = a == k ? l : r->d[a] == 0 ? (uint32_t)r->o[a] :
                  voxrti_cell_at(r, a, r->t, k, l, (uint32_t)hi[a] - 1);
    }
    return 1;
}

/* Time at which the ray enters the cell of edge 2^ls that holds c, not before its start; and the face. */
VOXRTI_INLINE double voxrti_entry(const voxrti_rayx *r, const uint32_t c[3], uint32_t ls, uint32_t *face) {
    double t = -VOXRTI_INF, e;
    uint32_t a, f = 6;
    for (a = 0; a < 3; a++) {
        if (r->d[a] == 0) continue;
        e = ((double)(c[a] >> ls << ls) - r->o[a]) * r->inv[a];
        if (e >= t) { /* ties: the axis that stepped last */
            t = e;
            f = a;
        }
    }
    if (t < r->t_min) {
        t = r->t_min;
        f = 6;
    }
    *face = f == 6 ? 6 : 2 * f + (r->flip >> f & 1u);
    return t;
}

static void voxrti_miss(voxrt_hit *hit) {
    memset(hit, 0, sizeof *hit);
    hit->t = INFINITY;
    hit->node = VOXRT_NO_NODE;
}

/* The hit record of the cell of edge 2^ls around c. */
VOXRTI_INLINE void voxrti_hit_fill(const voxrt_tree *t, const voxrti_rayx *r, const uint32_t c[3], uint32_t ls,
                                   uint32_t node, uint32_t slot, voxrt_hit *hit) {
    uint32_t a, face, full = ((uint32_t)1 << (2 * t->wide)) - 1u;
    double te = voxrti_entry(r, c, ls, &face);
    hit->t = (float)(te + r->base);
    for (a = 0; a < 3; a++) hit->cell[a] = ((r->flip >> a & 1u) ? full - c[a] : c[a]) >> ls;
    hit->node = node;
    hit->slot = (uint8_t)slot;
    hit->level = (uint8_t)(t->depth - ls);
    hit->face = (uint8_t)face;
    hit->_reserved = 0;
}

/* Closest hit of one prepared ray. The plain form of all kernels below. */
static VOXRTI_UNUSED int voxrti_trace_scalar(const voxrt_tree *t, const voxrti_rayx *r, const voxrti_cone *cone,
                                             voxrt_hit *hit, voxrt_stats *stats) {
    uint32_t stack_node[VOXRTI_MAX_WIDE], c[3], leaf_w = t->wide - 1, w = 0, node = 0, a;
    uint64_t stack_mask[VOXRTI_MAX_WIDE], mask = leaf_w == 0 ? t->leaf[0] : t->node[0].mask, steps = 0, descents = 0;
    double time = r->t;
    int found = 0;
    for (a = 0; a < 3; a++) c[a] = r->c[a];
    if (cone->on && cone->floor_ >= (double)(1u << 2 * t->wide)) { /* one cell for all */
        voxrti_hit_fill(t, r, c, 2 * t->wide, 0, 0, hit);
        return 1;
    }
    for (;;) {
        uint32_t slot, sh, ls, face[3], old[3], k, x, common;
        double e[3];
        for (;;) { /* down to an empty cell or a voxel */
            sh = 2 * (leaf_w - w);
            slot = voxrti_slot_of(c, sh) ^ r->flip;
            if ((mask >> slot & 1u) == 0) {
                ls = sh + ((mask >> (slot & 56u) & 255u) == 0);
                if (!cone->on || ls != sh || voxrti_footprint(cone, time) < (double)(2u << sh)) break;
                if (voxrti_footprint(cone, voxrti_entry(r, c, sh + 1, &x)) < (double)(2u << sh)) break;
                voxrti_hit_fill(t, r, c, sh + 1, node, slot & 56u, hit);
                found = 1;
                break;
            }
            if (cone->on && voxrti_footprint(cone, time) >= (double)(1u << sh)) {
                if (voxrti_footprint(cone, voxrti_entry(r, c, sh + 1, &x)) >= (double)(2u << sh)) {
                    voxrti_hit_fill(t, r, c, sh + 1, node, slot & 56u, hit);
                    found = 1;
                    break;
                }
                if (voxrti_footprint(cone, voxrti_entry(r, c, sh, &x)) >= (double)(1u << sh)) {
                    voxrti_hit_fill(t, r, c, sh, node, slot, hit);
                    found = 1;
                    break;
                }
            }
            if (w == leaf_w) {
                voxrti_hit_fill(t, r, c, 0, node, slot, hit);
                found = 1;
                break;
            }
            stack_node[w] = node;
            stack_mask[w] = mask;
            node = t->node[node].child + voxrti_popcount64(mask & (((uint64_t)1 << slot) - 1));
            w++;
            if (w == leaf_w) node = voxrti_leaf_at(t, node);
            mask = w == leaf_w ? t->leaf[node] : t->node[node].mask;
            descents++;
        }
        if (found) break;
        for (a = 0; a < 3; a++) {
            old[a] = c[a];
            face[a] = ((c[a] >> ls) + 1) << ls;
            e[a] = ((double)face[a] - r->o[a]) * r->inv[a];
        }
        k = e[0] <= e[1] ? (e[0] <= e[2] ? 0u : 2u) : (e[1] <= e[2] ? 1u : 2u);
        time = e[k];
        steps++;
        if (!(time < r->t_end)) break;
        for (a = 0; a < 3; a++) {
            if (a == k) c[a] = face[a];
            else if (ls != 0) c[a] = voxrti_cell_at(r, a, time, k, old[a], face[a] - 1);
        }
        x = (c[0] ^ old[0]) | (c[1] ^ old[1]) | (c[2] ^ old[2]);
        common = leaf_w - (31u - voxrti_clz32(x)) / 2;
        if (common < w) {
            w = common;
            node = stack_node[w];
            mask = stack_mask[w];
        }
    }
    if (stats != NULL) {
        stats->steps += steps;
        stats->descents += descents;
    }
    if (!found) voxrti_miss(hit);
    return found;
}

static void voxrti_trace_one(const voxrt_tree *t, const voxrti_cone *cone, const voxrti_beam *beam,
                             const voxrt_ray *ray, voxrt_hit *hit, voxrt_stats *stats) {
    voxrti_rayx r;
    int ok = voxrti_ray_setup(t, cone, ray, beam, &r);
    if (stats != NULL) {
        stats->rays++;
        stats->bad_rays += ok < 0;
    }
    if (ok > 0) {
        ok = voxrti_trace_scalar(t, &r, cone, hit, stats);
        if (stats != NULL) stats->hits += (uint64_t)ok;
    } else {
        voxrti_miss(hit);
    }
}
/* ---- AVX2: four rays in, four hits out ---- */

#if VOXRTI_AVX2

/* Four rays: v[0..2] origin (low half) and direction of an axis, v[3] t_min and t_max. */
VOXRTI_TARGET_AVX2 static inline void voxrti_rays4(const voxrt_ray *r0, const voxrt_ray *r1, const voxrt_ray *r2,
                                                   const voxrt_ray *r3, __m256 v[4]) {
    __m256 a = _mm256_loadu_ps(r0->org), b = _mm256_loadu_ps(r1->org), c = _mm256_loadu_ps(r2->org);
    __m256 d = _mm256_loadu_ps(r3->org), p = _mm256_unpacklo_ps(a, b), q = _mm256_unpackhi_ps(a, b);
    __m256 r = _mm256_unpacklo_ps(c, d), s = _mm256_unpackhi_ps(c, d);
    v[0] = _mm256_shuffle_ps(p, r, 0x44);
    v[1] = _mm256_shuffle_ps(p, r, 0xee);
    v[2] = _mm256_shuffle_ps(q, s, 0x44);
    v[3] = _mm256_shuffle_ps(q, s, 0xee);
}

/* voxrti_below of four times */
VOXRTI_TARGET_AVX2 static inline __m256d voxrti_below4(__m128 time) {
    const __m128 t = _mm_max_ps(time, _mm_set1_ps(-3.402823466e38f));
    __m128i x = _mm_castps_si128(t), zero = _mm_cmpeq_epi32(_mm_slli_epi32(x, 1), _mm_setzero_si128());
    __m128i before = _mm_sub_epi32(x, _mm_or_si128(_mm_srai_epi32(x, 31), _mm_set1_epi32(1)));
    before = _mm_blendv_epi8(before, _mm_set1_epi32((int)0x80000001u), zero);
    return _mm256_mul_pd(_mm256_set1_pd(0.5),
                         _mm256_add_pd(_mm256_cvtps_pd(_mm_castsi128_ps(before)), _mm256_cvtps_pd(t)));
}

/* A hit record: time and cell; node, slot, level and face. */
static inline void voxrti_hit_store(voxrt_hit *hit, __m128 time_cell, __m128i node_info) {
    _mm_storeu_ps(&hit->t, time_cell);
    _mm_storel_epi64((__m128i *)(void *)&hit->node, node_info);
}

/* Write the results of four rays: those of `lanes` (bits). c: the voxels that they meet, not mirrored; node:
   VOXRT_NO_NODE where they meet none. */
VOXRTI_TARGET_AVX2 static inline void voxrti_hits4(const voxrt_tree *t, const voxrt_ray *rays, const uint32_t index[4],
                                                   uint32_t lanes, const __m128i c[3], __m128i node, voxrt_hit *hits) {
    const __m256d sign = _mm256_set1_pd(-0.0), scale = _mm256_set1_pd(1.0 / t->voxel_size);
    const __m256d full = _mm256_set1_pd((double)((uint32_t)1 << (2 * t->wide))), zero = _mm256_setzero_pd();
    const __m256d inf = _mm256_set1_pd(VOXRTI_INF), minus = _mm256_xor_pd(inf, sign);
    const __m128i last = _mm_set1_epi32((int)(((uint32_t)1 << (2 * t->wide)) - 1u)), none = _mm_set1_epi32(-1);
    __m128i face = _mm_setzero_si128(), slot = face, info, on, low, high;
    __m256d time = minus, t_min, t_end, e, m;
    __m256 v[4];
    __m128 r0, r1, r2, r3;
    uint32_t a;
    voxrti_rays4(rays + index[0], rays + index[1], rays + index[2], rays + index[3], v);
    for (a = 0; a < 3; a++) { /* as voxrti_ray_setup and voxrti_entry do it */
        __m256d o = _mm256_cvtps_pd(_mm256_castps256_ps128(v[a])), d, neg, inv;
        __m128i back, x;
        o = _mm256_mul_pd(_mm256_sub_pd(o, _mm256_set1_pd(t->origin[a])), scale);
        d = _mm256_mul_pd(_mm256_cvtps_pd(_mm256_extractf128_ps(v[a], 1)), scale);
        neg = _mm256_cmp_pd(d, zero, _CMP_LT_OQ);
        back = voxrti_narrow4(neg);
        o = _mm256_blendv_pd(o, _mm256_sub_pd(full, o), neg);
        x = _mm_blendv_epi8(c[a], _mm_sub_epi32(last, c[a]), back);
        inv = _mm256_div_pd(_mm256_set1_pd(1.0), _mm256_andnot_pd(sign, d));
        e = _mm256_mul_pd(_mm256_sub_pd(_mm256_cvtepi32_pd(x), o), inv);
        e = _mm256_blendv_pd(e, minus, _mm256_cmp_pd(inv, inf, _CMP_EQ_OQ)); /* no motion along this axis */
        m = _mm256_cmp_pd(e, time, _CMP_GE_OQ);
        time = _mm256_blendv_pd(time, e, m);
        face = _mm_blendv_epi8(face, _mm_sub_epi32(_mm_set1_epi32((int)(2 * a)), back), voxrti_narrow4(m));
        x = _mm_and_si128(c[a], _mm_set1_epi32(3));
        x = _mm_and_si128(_mm_or_si128(x, _mm_slli_epi32(x, 2)), _mm_set1_epi32(9));
        slot = _mm_or_si128(slot, _mm_slli_epi32(x, (int)a));
    }
    t_min = _mm256_add_pd(_mm256_cvtps_pd(_mm256_castps256_ps128(v[3])), _mm256_setzero_pd()); /* -0 becomes 0 */
    m = _mm256_cmp_pd(time, t_min, _CMP_LT_OQ);
    time = _mm256_blendv_pd(time, t_min, m);
    face = _mm_blendv_epi8(face, _mm_set1_epi32(6), voxrti_narrow4(m));
    t_end = _mm256_min_pd(voxrti_below4(_mm256_extractf128_ps(v[3], 1)), _mm256_set1_pd(3.4028234663852886e38));
    on = voxrti_narrow4(_mm256_cmp_pd(time, t_end, _CMP_LT_OQ));
    on = _mm_andnot_si128(_mm_cmpeq_epi32(node, none), on);
    node = _mm_or_si128(node, _mm_xor_si128(on, none));
    info = _mm_or_si128(_mm_or_si128(slot, _mm_set1_epi32((int)(t->depth << 8))), _mm_slli_epi32(face, 16));
    info = _mm_and_si128(info, on);
    low = _mm_unpacklo_epi32(node, info);
    high = _mm_unpackhi_epi32(node, info);
    r0 = _mm_blendv_ps(_mm_set1_ps(INFINITY), _mm256_cvtpd_ps(time), _mm_castsi128_ps(on));
    r1 = _mm_castsi128_ps(_mm_and_si128(c[0], on));
    r2 = _mm_castsi128_ps(_mm_and_si128(c[1], on));
    r3 = _mm_castsi128_ps(_mm_and_si128(c[2], on));
    _MM_TRANSPOSE4_PS(r0, r1, r2, r3);
    if (lanes & 1u) voxrti_hit_store(&hits[index[0]], r0, low);
    if (lanes & 2u) voxrti_hit_store(&hits[index[1]], r1, _mm_unpackhi_epi64(low, low));
    if (lanes & 4u) voxrti_hit_store(&hits[index[2]], r2, high);
    if (lanes & 8u) voxrti_hit_store(&hits[index[3]], r3, _mm_unpackhi_epi64(high, high));
}

#endif

/* ---- AVX2: tiles of rays with one origin ----
   Such a beam of up to 64 rays is walked slab by slab. For a slab of leaf nodes (four planes of voxels) the masks of
   all nodes in the frustum are laid out as four small bit pictures, and the rays march through them eight at a time,
   plane by plane: with the main axis as clock a ray's position is two fixed-point numbers, one addition each for a
   plane. No ray looks into the tree.
   Between two planes a ray meets the cell in which it enters, the one in which it leaves, and one between these when
   both coordinates change. Positions are wrong by a few 2^-24 cells. Where that could matter (next to an edge of
   cells) the ray is left to the scalar path: the same hits by construction.
   Level of detail: the footprint at both ends of a slab tells which cells are accepted in it. Are they larger than
   voxels, the cells of nodes further up are the units of march; an octant is eight of them that are all filled. Where
   cells of two sizes may be accepted the pictures are of the larger ones, and rays that meet any are left to others. */

#if VOXRTI_AVX2

#define VOXRTI_TILE_BITS 24 /* fraction of fixed-point positions */

typedef struct voxrti_tile {
    __m256i align;
    double slope[2][64];   /* du/dm, dv/dm */
    float d[3][64], t_max[64]; /* directions: m, u, v */
    int32_t at[2][64];     /* u, v at plane `start`, counted from cell base[], 8.24 bits */
    int32_t step[2][64];   /* slopes, 8.24 bits */
    uint32_t cell[3][64];  /* of hits: m (mirrored), u, v */
    uint32_t side[64];     /* of hits, axis along which it was entered: m, u, v */
    uint32_t node[64];     /* of hits; VOXRT_NO_NODE without one */
    uint32_t ls[64];       /* of hits, with level of detail: log2 of the edge; */
    uint32_t unit[64];     /* and that of the unit in which `cell` counts */
    uint64_t active, rare; /* bit per ray: on its way; left to the scalar path */
    uint64_t later;        /* left to others, from plane `again` on */
    uint32_t limited;      /* a t_max is finite */
    double start, late;    /* plane of the first slab; before it all rays have started */
    double again;
    int32_t base[2];
    uint32_t log;          /* log2 of the unit */
    /* the slab that is marched through */
    uint32_t rows[4][32];  /* bit pictures of its planes: row v, column u, counted from its first node's corner */
    uint8_t leaf[512];     /* places of its nodes in b->cell, 8 v + u; of a pair 16 v + u, second slab + 256 */
} voxrti_tile;

/* The slopes of n <= 64 rays. 0: they are no beam. 1: a beam. 2: one that can be marched as a tile. */
VOXRTI_TARGET_AVX2 static uint32_t voxrti_tile_open(const voxrt_tree *t, const voxrti_cone *cone, const voxrt_ray *rays,
                                                    uint32_t n, voxrti_beam *b, voxrti_tile *k) {
    const __m256d scale = _mm256_set1_pd(1.0 / t->voxel_size), inf = _mm256_set1_pd(VOXRTI_INF);
    const __m256d sign = _mm256_set1_pd(-0.0), turn = _mm256_set1_pd(b->back ? -0.0 : 0.0);
    const __m128 top = _mm_set1_ps(3.402823466e38f);
    const __m128 ox = _mm_set1_ps(rays[0].org[0]), oy = _mm_set1_ps(rays[0].org[1]), oz = _mm_set1_ps(rays[0].org[2]);
    __m256d low[2], high[2], least = inf, most = _mm256_setzero_pd(), wrong = most;
    __m128 differ = _mm_setzero_ps(), finite = differ, late = differ, empty = differ, early = _mm_set1_ps(INFINITY);
    double lo[4], hi[4], dm_most = 0, dm_least = VOXRTI_INF;
    float time[4], t_late = 0;
    uint32_t i;
    low[0] = low[1] = inf;
    high[0] = high[1] = _mm256_xor_pd(inf, sign);
    k->rare = 0;
    for (i = 0; i < n; i += 4) {
        __m256d dm, du, dv, su, sv, inv, still;
        __m256 v[4];
        __m128 x, y;
        VOXRTI_PREFETCH((const void *)((uintptr_t)(rays + i) + 2048)); /* the next tile */
        VOXRTI_PREFETCH((const void *)((uintptr_t)(rays + i) + 2112));
        if (i + 4 <= n) {
            voxrti_rays4(rays + i, rays + i + 1, rays + i + 2, rays + i + 3, v);
        } else {
            voxrti_rays4(rays + i, rays + (i + 1 < n ? i + 1 : i), rays + (i + 2 < n ? i + 2 : i), rays + i, v);
        }
        differ = _mm_or_ps(differ, _mm_xor_ps(ox, _mm256_castps256_ps128(v[0])));
        differ = _mm_or_ps(differ, _mm_xor_ps(oy, _mm256_castps256_ps128(v[1])));
        differ = _mm_or_ps(differ, _mm_xor_ps(oz, _mm256_castps256_ps128(v[2])));
        x = _mm256_extractf128_ps(v[b->m], 1);
        _mm_storeu_ps(k->d[0] + i, x);
        dm = _mm256_xor_pd(turn, _mm256_mul_pd(_mm256_cvtps_pd(x), scale));
        x = _mm256_extractf128_ps(v[b->u], 1);
        _mm_storeu_ps(k->d[1] + i, x);
        du = _mm256_mul_pd(_mm256_cvtps_pd(x), scale);
        x = _mm256_extractf128_ps(v[b->v], 1);
        _mm_storeu_ps(k->d[2] + i, x);
        dv = _mm256_mul_pd(_mm256_cvtps_pd(x), scale);
        y = _mm256_extractf128_ps(v[3], 1);
        _mm_storeu_ps(k->t_max + i, y);
        finite = _mm_or_ps(finite, _mm_cmplt_ps(y, top));
        x = _mm256_castps256_ps128(v[3]);
        early = _mm_min_ps(x, early); /* keeps NaN out; `empty` and `wrong` have it */
        late = _mm_max_ps(x, late);
        empty = _mm_or_ps(empty, _mm_cmpnle_ps(x, y));
        inv = _mm256_div_pd(_mm256_set1_pd(1.0), dm);
        su = _mm256_mul_pd(du, inv);
        sv = _mm256_mul_pd(dv, inv);
        _mm256_storeu_pd(k->slope[0] + i, su);
        _mm256_storeu_pd(k->slope[1] + i, sv);
        low[0] = _mm256_min_pd(su, low[0]);
        low[1] = _mm256_min_pd(sv, low[1]);
        high[0] = _mm256_max_pd(su, high[0]);
        high[1] = _mm256_max_pd(sv, high[1]);
        least = _mm256_min_pd(dm, least);
        most = _mm256_max_pd(dm, most);
        wrong = _mm256_or_pd(wrong, _mm256_cmp_pd(su, sv, _CMP_UNORD_Q));
        /* hardly any motion along u or v: the reciprocal may be infinite */
        still = _mm256_min_pd(_mm256_andnot_pd(sign, du), _mm256_andnot_pd(sign, dv));
        still = _mm256_cmp_pd(still, _mm256_set1_pd(1e-300), _CMP_LT_OQ);
        k->rare |= (uint64_t)(uint32_t)_mm256_movemask_pd(still) << i;
    }
    if (!_mm_testz_si128(_mm_castps_si128(differ), _mm_castps_si128(differ))) return 0;
    for (i = 0; i < 2; i++) {
        _mm256_storeu_pd(lo, low[i]);
        _mm256_storeu_pd(hi, high[i]);
        b->lo[i] = voxrti_min(voxrti_min(lo[0], lo[1]), voxrti_min(lo[2], lo[3]));
        b->hi[i] = voxrti_max(voxrti_max(hi[0], hi[1]), voxrti_max(hi[2], hi[3]));
    }
    _mm256_storeu_pd(lo, least);
    _mm256_storeu_pd(hi, most);
    for (i = 0; i < 4; i++) {
        dm_least = voxrti_min(dm_least, lo[i]);
        dm_most = voxrti_max(dm_most, hi[i]);
    }
    if (_mm_movemask_ps(_mm_cmplt_ps(early, _mm_setzero_ps())) != 0) return 0;
    _mm_storeu_ps(time, late);
    for (i = 0; i < 4; i++) t_late = time[i] > t_late ? time[i] : t_late;
    k->limited = (uint32_t)_mm_movemask_ps(finite);
    if (!(dm_least > 0 && dm_most < VOXRTI_INF)) return 0;
    if (!voxrti_beam_start(t, cone, dm_least * t->voxel_size, b, 1)) return 0;
    k->late = b->om + (double)t_late * dm_most * (1.0 + 1e-9);
    b->fast = (1.0 - 1e-9) / dm_most;
    if (_mm256_movemask_pd(wrong) != 0 || _mm_movemask_ps(empty) != 0 || !(t_late < 3e38f)) return 1;
    return b->lo[0] >= -1.0 && b->lo[1] >= -1.0 && b->hi[0] <= 1.0 && b->hi[1] <= 1.0 ? 2 : 1;
}

/* A node's mask with its bits in the order u + 4 v + 16 m: bits of the slot's number change places, two at a time. */
VOXRTI_INLINE uint64_t voxrti_tile_mask(uint64_t x, uint32_t m) {
    static const struct { uint32_t shift; uint64_t low; } swap[3][3] = { /* slot bits: x0 y0 z0 x1 y1 z1 */
        {{1, 0x2222222222222222u}, {14, 0x0000cccc0000ccccu}, {24, 0x00000000ff00ff00u}}, /* 01, 14, 35 */
        {{6, 0x00cc00cc00cc00ccu}, {24, 0x00000000ff00ff00u}, {16, 0x00000000ffff0000u}}, /* 13, 35, 45 */
        {{6, 0x00cc00cc00cc00ccu}, {4, 0x00f000f000f000f0u}, {8, 0x0000ff000000ff00u}}};  /* 13, 23, 34 */
    uint32_t i;
    for (i = 0; i < 3; i++) {
        uint64_t d = ((x >> swap[m][i].shift) ^ x) & swap[m][i].low;
        x ^= d ^ d << swap[m][i].shift;
    }
    return x;
}

/* All eight bits of the octants that have one. */
VOXRTI_INLINE uint64_t voxrti_fill_octants(uint64_t x) {
    const uint64_t low = 0x7f7f7f7f7f7f7f7fu;
    x = ((((x & low) + low) | x) >> 7) & 0x0101010101010101u;
    return (x << 8) - x;
}

/* Lay out the slab of nodes that the walk has found. Not leaf: above leaf nodes; ls is odd: their octants. */
VOXRTI_TARGET_AVX2 VOXRTI_INLINE void voxrti_tile_slab(const voxrt_tree *t, const voxrti_beam *b, int leaf, uint32_t ls,
                                                       voxrti_tile *k) {
    const __m256i nibble = _mm256_setr_epi32(0, 4, 8, 12, 16, 20, 24, 28), four = _mm256_set1_epi32(15);
    uint32_t *p0 = k->rows[b->back ? 3 : 0], *p1 = k->rows[b->back ? 2 : 1];
    uint32_t *p2 = k->rows[b->back ? 1 : 2], *p3 = k->rows[b->back ? 0 : 3], i;
    memset(k->rows, 0, sizeof k->rows);
    for (i = b->first; i < b->first + b->count; i++) {
        const voxrti_beam_cell *c = &b->cell[i];
        uint64_t mask = leaf ? t->leaf[c->node] : t->node[c->node].mask;
        uint32_t u = (uint32_t)(c->u - b->u0), v = (uint32_t)(c->v - b->v0);
        __m256i x, y;
        if (ls & 1u) mask = voxrti_fill_octants(mask);
        mask = voxrti_tile_mask(mask, b->m);
        x = _mm256_and_si256(_mm256_srlv_epi32(_mm256_set1_epi32((int)(uint32_t)mask), nibble), four);
        y = _mm256_and_si256(_mm256_srlv_epi32(_mm256_set1_epi32((int)(uint32_t)(mask >> 32)), nibble), four);
        x = _mm256_sll_epi32(x, _mm_cvtsi32_si128((int)(4 * u)));
        y = _mm256_sll_epi32(y, _mm_cvtsi32_si128((int)(4 * u)));
        VOXRTI_STORE4(p0 + 4 * v, _mm_or_si128(VOXRTI_LOAD4(p0 + 4 * v), _mm256_castsi256_si128(x)));
        VOXRTI_STORE4(p1 + 4 * v, _mm_or_si128(VOXRTI_LOAD4(p1 + 4 * v), _mm256_extracti128_si256(x, 1)));
        VOXRTI_STORE4(p2 + 4 * v, _mm_or_si128(VOXRTI_LOAD4(p2 + 4 * v), _mm256_castsi256_si128(y)));
        VOXRTI_STORE4(p3 + 4 * v, _mm_or_si128(VOXRTI_LOAD4(p3 + 4 * v), _mm256_extracti128_si256(y, 1)));
        k->leaf[8 * v + u] = (uint8_t)i;
    }
}

/* Lay out the octants of a pair of slabs. */
VOXRTI_TARGET_AVX2 static inline void voxrti_tile_pair(const voxrt_tree *t, const voxrti_beam *b, voxrti_tile *k) {
    uint32_t i;
    memset(k->rows, 0, sizeof k->rows);
    for (i = b->first; i < b->first + b->count; i++) {
        const voxrti_beam_cell *c = &b->cell[i];
        const uint64_t mask = voxrti_fill_octants(b->size == 4 ? t->leaf[c->node] : t->node[c->node].mask);
        const uint32_t x = (uint32_t)_pext_u64(voxrti_tile_mask(mask, b->m), 0x0000050500000505u); /* u + 2 v + 4 m */
        const uint32_t u = (uint32_t)(c->u - b->u0), v = (uint32_t)(c->v - b->v0), second = (uint32_t)c->left;
        uint32_t *p = &k->rows[2 * second + b->back][2 * v], *q = &k->rows[2 * second + 1 - b->back][2 * v];
        p[0] |= (x & 3u) << 2 * u;
        p[1] |= (x >> 2 & 3u) << 2 * u;
        q[0] |= (x >> 4 & 3u) << 2 * u;
        q[1] |= (x >> 6 & 3u) << 2 * u;
        k->leaf[256 * second + 16 * v + u] = (uint8_t)i;
    }
}

/* Row `v` of a bit picture of 8 * groups rows for eight rays; pos: v with its fraction. */
VOXRTI_TARGET_AVX2 VOXRTI_INLINE __m256i voxrti_tile_row(const uint32_t *rows, uint32_t groups, __m256i v,
                                                         __m256i pos) {
    __m256i r = _mm256_permutevar8x32_epi32(VOXRTI_LOADI(rows), v), s; /* takes three bits of v */
    if (groups > 1) {
        s = _mm256_permutevar8x32_epi32(VOXRTI_LOADI(rows + 8), v);
        r = VOXRTI_BLENDI(r, s, _mm256_slli_epi32(pos, 4));
    }
    if (groups > 2) {
        s = _mm256_permutevar8x32_epi32(VOXRTI_LOADI(rows + 16), v);
        s = VOXRTI_BLENDI(s, _mm256_permutevar8x32_epi32(VOXRTI_LOADI(rows + 24), v), _mm256_slli_epi32(pos, 4));
        r = VOXRTI_BLENDI(r, s, _mm256_slli_epi32(pos, 3));
    }
    return r;
}

/* What eight rays meet between two planes. */
typedef struct voxrti_tile_cell {
    __m256i u, v, side;   /* first filled cell; axis along which it is entered: m, u, v */
    __m256i done, unsure; /* sign: there is one; cannot be told */
} voxrti_tile_cell;

/* pu, pv: positions on the first plane, eps/2 more than they are; ra, rb: rows of the bit picture in which the rays
   enter and leave. */
VOXRTI_TARGET_AVX2 VOXRTI_INLINE voxrti_tile_cell voxrti_tile_meet(__m256i pu, __m256i pv, __m256i su, __m256i sv,
                                                                   __m256i ra, __m256i rb, uint32_t eps) {
    const __m256i ua = _mm256_srli_epi32(pu, VOXRTI_TILE_BITS), va = _mm256_srli_epi32(pv, VOXRTI_TILE_BITS);
    const __m256i ub = _mm256_srli_epi32(_mm256_add_epi32(pu, su), VOXRTI_TILE_BITS);
    const __m256i vb = _mm256_srli_epi32(_mm256_add_epi32(pv, sv), VOXRTI_TILE_BITS);
    const __m256i aa = _mm256_slli_epi32(_mm256_srlv_epi32(ra, ua), 31); /* sign: this cell is filled */
    const __m256i ba = _mm256_slli_epi32(_mm256_srlv_epi32(ra, ub), 31);
    const __m256i ab = _mm256_slli_epi32(_mm256_srlv_epi32(rb, ua), 31);
    const __m256i bb = _mm256_slli_epi32(_mm256_srlv_epi32(rb, ub), 31);
    /* does u change before v? the distance to its edge over its slope is less; cross-multiplied */
    __m256i du = _mm256_sub_epi32(_mm256_slli_epi32(_mm256_max_epi32(ua, ub), VOXRTI_TILE_BITS), pu);
    __m256i dv = _mm256_sub_epi32(_mm256_slli_epi32(_mm256_max_epi32(va, vb), VOXRTI_TILE_BITS), pv);
    const __m256 fu = _mm256_cvtepi32_ps(_mm256_abs_epi32(su)), fv = _mm256_cvtepi32_ps(_mm256_abs_epi32(sv));
    const __m256 cross = _mm256_sub_ps(_mm256_mul_ps(_mm256_cvtepi32_ps(_mm256_sign_epi32(du, su)), fv),
                                       _mm256_mul_ps(_mm256_cvtepi32_ps(_mm256_sign_epi32(dv, sv)), fu));
    const __m256 limit = _mm256_mul_ps(_mm256_add_ps(fu, fv), _mm256_set1_ps((float)(eps + 16)));
    const __m256 size = _mm256_andnot_ps(_mm256_set1_ps(-0.0f), cross);
    const __m256i sure = _mm256_castps_si256(_mm256_cmp_ps(size, limit, _CMP_GT_OQ));
    const __m256i u_first = _mm256_castps_si256(cross);
    const __m256i same_u = _mm256_cmpeq_epi32(ua, ub);
    const __m256i two = _mm256_or_si256(same_u, _mm256_cmpeq_epi32(va, vb)); /* no third cell */
    const __m256i mid = _mm256_andnot_si256(two, VOXRTI_BLENDI(ab, ba, u_first));
    voxrti_tile_cell r;
    r.u = VOXRTI_BLENDI(VOXRTI_BLENDI(ub, VOXRTI_BLENDI(ua, ub, u_first), mid), ua, aa);
    r.v = VOXRTI_BLENDI(VOXRTI_BLENDI(vb, VOXRTI_BLENDI(vb, va, u_first), mid), va, aa);
    r.done = _mm256_or_si256(_mm256_or_si256(aa, mid), bb);
    r.unsure = _mm256_or_si256(_mm256_or_si256(ab, ba), bb);
    r.unsure = _mm256_andnot_si256(_mm256_or_si256(_mm256_or_si256(two, sure), aa), r.unsure);
    /* the third cell lies behind the first edge, the last one behind the last edge */
    du = _mm256_srai_epi32(VOXRTI_BLENDI(_mm256_xor_si256(u_first, mid), same_u, two), 31);
    r.side = _mm256_andnot_si256(_mm256_srai_epi32(aa, 31), _mm256_sub_epi32(_mm256_set1_epi32(1), du));
    return r;
}

/* What the march needs to know of a slab, for all rays. */
typedef struct voxrti_tile_view {
    __m256i planes, du, dv, close, u0, v0, z; /* planes since the first; from there to here; limit of `close`; place */
    uint32_t eps; /* more than twice the error of a position */
} voxrti_tile_view;

/* Which cells level of detail accepts in a slab. */
typedef struct voxrti_tile_lod {
    __m256i in[3], out[3]; /* units inside of the box of the filled cells; m, u, v */
    uint32_t ls, unit;     /* log2 of their edge, of the unit */
    uint32_t mixed;        /* those of half that size may be accepted, too */
} voxrti_tile_lod;

VOXRTI_INLINE uint32_t voxrti_exponent(double x) { /* x >= 1 */
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    return (uint32_t)(bits >> 52) - 1023u;
}

VOXRTI_TARGET_AVX2 static inline void voxrti_tile_detail(const voxrt_tree *t, const voxrti_cone *cone,
                                                         const voxrti_beam *b, voxrti_tile_lod *a) {
    const uint32_t full = (uint32_t)1 << (2 * t->wide), axis[3] = {b->m, b->u, b->v};
    double least = voxrti_footprint(cone, (b->z - b->om) * b->fast);
    double most = voxrti_footprint(cone, (b->z + (double)(b->size << b->pair) - b->om) * b->slow);
    uint32_t i, from, to;
    a->ls = most < 2.0 ? 0u : voxrti_exponent(most);
    a->unit = b->pair ? a->ls : a->ls & ~1u;
    if (a->ls == 0) return; /* voxels only */
    a->mixed = a->ls != (least < 2.0 ? 0u : voxrti_exponent(least));
    for (i = 0; i < 3; i++) {
        from = cone->lo[axis[i]];
        to = cone->hi[axis[i]];
        if (i == 0 && b->back) {
            from = full - to;
            to = full - cone->lo[axis[i]];
        }
        from = (from + (((uint32_t)1 << a->ls) - 1u)) >> a->ls << a->ls;
        a->in[i] = _mm256_set1_epi32((int)(from >> a->unit));
        a->out[i] = _mm256_set1_epi32((int)(to >> a->ls << a->ls >> a->unit));
    }
}

VOXRTI_TARGET_AVX2 VOXRTI_INLINE voxrti_tile_view voxrti_tile_look(const voxrti_beam *b, const voxrti_tile *k) {
    const uint32_t planes = (uint32_t)(b->z - k->start) >> k->log;
    const uint32_t u0 = (uint32_t)b->u0 * (4u >> b->pair), v0 = (uint32_t)b->v0 * (4u >> b->pair);
    voxrti_tile_view a;
    a.eps = 2 * planes + 32;
    a.planes = _mm256_set1_epi32((int)planes);
    /* with eps/2 more a position close to an edge, on either side, is one close above it */
    a.du = _mm256_set1_epi32((int)((((uint32_t)k->base[0] - u0) << VOXRTI_TILE_BITS) + a.eps / 2));
    a.dv = _mm256_set1_epi32((int)((((uint32_t)k->base[1] - v0) << VOXRTI_TILE_BITS) + a.eps / 2));
    a.close = _mm256_set1_epi32((int)(a.eps << (32 - VOXRTI_TILE_BITS)));
    a.u0 = _mm256_set1_epi32((int)u0);
    a.v0 = _mm256_set1_epi32((int)v0);
    a.z = _mm256_set1_epi32((int)((uint32_t)b->z >> k->log));
    return a;
}

/* Eight rays through the four planes of voxels (of cells if lod is not NULL) of a slab. At first all planes: which
   rays have a filled cell at a corner of the rectangle of cells in which they enter and leave? Mostly none. Then the
   cells of those that have one, in the first such plane. */
VOXRTI_TARGET_AVX2 VOXRTI_INLINE void voxrti_tile_march(const voxrti_beam *b, voxrti_tile *k,
                                                        const voxrti_tile_view *at, uint32_t first, uint32_t groups,
                                                        const voxrti_tile_lod *lod) {
    const __m256i zero = _mm256_setzero_si256(), one = _mm256_set1_epi32(1);
    const __m256i bits = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
    const __m256i su = VOXRTI_LOADI(k->step[0] + first), sv = VOXRTI_LOADI(k->step[1] + first);
    uint32_t live = (uint32_t)(k->active >> first) & 255u, hit, rare, s;
    __m256i want, got = zero, row_a[4], row_b[4], some[4], pu, pv, u, v, close, ua, va, hu = zero, hv = zero, hm = zero;
    __m256i hs = zero;
    pu = _mm256_add_epi32(_mm256_mullo_epi32(su, at->planes), VOXRTI_LOADI(k->at[0] + first));
    pv = _mm256_add_epi32(_mm256_mullo_epi32(sv, at->planes), VOXRTI_LOADI(k->at[1] + first));
    u = pu = _mm256_add_epi32(pu, at->du);
    v = pv = _mm256_add_epi32(pv, at->dv);
    close = _mm256_min_epu32(_mm256_slli_epi32(u, 32 - VOXRTI_TILE_BITS), _mm256_slli_epi32(v, 32 - VOXRTI_TILE_BITS));
    ua = _mm256_sllv_epi32(one, _mm256_srli_epi32(u, VOXRTI_TILE_BITS));
    va = _mm256_srli_epi32(v, VOXRTI_TILE_BITS);
    for (s = 0; s < 4; s++) {
        __m256i ub, vb;
        row_a[s] = voxrti_tile_row(k->rows[s], groups, va, v);
        u = _mm256_add_epi32(u, su);
        v = _mm256_add_epi32(v, sv);
        ub = _mm256_sllv_epi32(one, _mm256_srli_epi32(u, VOXRTI_TILE_BITS));
        vb = _mm256_srli_epi32(v, VOXRTI_TILE_BITS);
        row_b[s] = voxrti_tile_row(k->rows[s], groups, vb, v);
        some[s] = _mm256_and_si256(_mm256_or_si256(ua, ub), _mm256_or_si256(row_a[s], row_b[s]));
        close = _mm256_min_epu32(close, _mm256_slli_epi32(u, 32 - VOXRTI_TILE_BITS));
        close = _mm256_min_epu32(close, _mm256_slli_epi32(v, 32 - VOXRTI_TILE_BITS));
        ua = ub;
        va = vb;
    }
    want = _mm256_cmpeq_epi32(_mm256_and_si256(_mm256_set1_epi32((int)live), bits), bits);
    for (;;) {
        __m256i p1, p2, p3, plane, ra, rb;
        voxrti_tile_cell c;
        u = _mm256_or_si256(_mm256_or_si256(some[0], some[1]), _mm256_or_si256(some[2], some[3]));
        want = _mm256_andnot_si256(_mm256_cmpeq_epi32(u, zero), want);
        if (VOXRTI_SIGNS(want) == 0) break;
        p1 = _mm256_cmpeq_epi32(some[0], zero); /* not before plane 1, ... */
        p2 = _mm256_and_si256(_mm256_cmpeq_epi32(some[1], zero), p1);
        p3 = _mm256_and_si256(_mm256_cmpeq_epi32(some[2], zero), p2);
        plane = _mm256_sub_epi32(zero, _mm256_add_epi32(_mm256_add_epi32(p1, p2), p3));
        ra = VOXRTI_BLENDI(VOXRTI_BLENDI(VOXRTI_BLENDI(row_a[0], row_a[1], p1), row_a[2], p2), row_a[3], p3);
        rb = VOXRTI_BLENDI(VOXRTI_BLENDI(VOXRTI_BLENDI(row_b[0], row_b[1], p1), row_b[2], p2), row_b[3], p3);
        c = voxrti_tile_meet(_mm256_add_epi32(pu, _mm256_mullo_epi32(su, plane)),
                             _mm256_add_epi32(pv, _mm256_mullo_epi32(sv, plane)), su, sv, ra, rb, at->eps);
        c.unsure = _mm256_and_si256(want, _mm256_srai_epi32(c.unsure, 31));
        close = _mm256_andnot_si256(c.unsure, close);
        c.done = _mm256_and_si256(want, _mm256_srai_epi32(c.done, 31));
        got = _mm256_or_si256(got, c.done);
        hu = _mm256_blendv_epi8(hu, c.u, c.done);
        hv = _mm256_blendv_epi8(hv, c.v, c.done);
        hm = _mm256_blendv_epi8(hm, plane, c.done);
        hs = _mm256_blendv_epi8(hs, c.side, c.done);
        want = _mm256_andnot_si256(_mm256_or_si256(c.done, c.unsure), want);
        if (VOXRTI_SIGNS(want) == 0) break;
        for (s = 0; s < 4; s++) /* passed between filled cells: on behind this plane */
            some[s] = _mm256_andnot_si256(_mm256_cmpeq_epi32(plane, _mm256_set1_epi32((int)s)), some[s]);
    }
    rare = VOXRTI_SIGNS(_mm256_cmpeq_epi32(_mm256_min_epu32(close, at->close), close)) & live;
    hit = VOXRTI_SIGNS(got) & ~rare;
    k->rare |= (uint64_t)rare << first;
    k->active &= ~((uint64_t)(rare | hit) << first);
    if (lod != NULL && hit != 0) { /* a cell that sticks out of the box may be met out there, where it does not count */
        u = _mm256_add_epi32(hu, at->u0);
        v = _mm256_add_epi32(hv, at->v0);
        pu = _mm256_add_epi32(hm, at->z);
        pv = _mm256_or_si256(_mm256_cmpgt_epi32(lod->in[0], pu), _mm256_cmpgt_epi32(lod->in[1], u));
        pv = _mm256_or_si256(pv, _mm256_cmpgt_epi32(lod->in[2], v));
        u = _mm256_and_si256(_mm256_cmpgt_epi32(lod->out[1], u), _mm256_cmpgt_epi32(lod->out[2], v));
        u = _mm256_and_si256(u, _mm256_cmpgt_epi32(lod->out[0], pu));
        s = (lod->mixed ? 255u : VOXRTI_SIGNS(pv) | ~VOXRTI_SIGNS(u)) & hit;
        k->later |= (uint64_t)s << first;
        hit &= ~s;
    }
    if (hit != 0) {
        uint32_t *cm = k->cell[0] + first, *cu = k->cell[1] + first, *cv = k->cell[2] + first, *side = k->side + first;
        uint32_t leaf[8];
        if (lod == NULL || lod->unit == (lod->ls & ~1u)) {
            v = _mm256_add_epi32(_mm256_slli_epi32(_mm256_srli_epi32(hv, 2), 3), _mm256_srli_epi32(hu, 2));
        } else { /* a pair: nodes of two units each */
            v = _mm256_add_epi32(_mm256_slli_epi32(_mm256_srli_epi32(hm, 1), 4), _mm256_srli_epi32(hv, 1));
            v = _mm256_add_epi32(_mm256_slli_epi32(v, 4), _mm256_srli_epi32(hu, 1));
        }
        VOXRTI_STOREI(leaf, v);
        hu = _mm256_add_epi32(hu, at->u0);
        hv = _mm256_add_epi32(hv, at->v0);
        hm = _mm256_add_epi32(hm, at->z);
        VOXRTI_STOREI(cu, _mm256_blendv_epi8(VOXRTI_LOADI(cu), hu, got));
        VOXRTI_STOREI(cv, _mm256_blendv_epi8(VOXRTI_LOADI(cv), hv, got));
        VOXRTI_STOREI(cm, _mm256_blendv_epi8(VOXRTI_LOADI(cm), hm, got));
        VOXRTI_STOREI(side, _mm256_blendv_epi8(VOXRTI_LOADI(side), hs, got));
        for (; hit != 0; hit &= hit - 1) {
            s = voxrti_ctz64(hit);
            k->node[first + s] = b->cell[k->leaf[leaf[s]]].node;
            if (lod == NULL) continue;
            k->ls[first + s] = lod->ls;
            k->unit[first + s] = lod->unit;
        }
    }
}

/* Times at which four rays enter their voxels; c: plane of the axis `side` (mirrored), back: it is mirrored. One
   division a ray: voxrti_entry takes the latest of three times, the march knows which one it is. */
VOXRTI_TARGET_AVX2 static inline __m256d voxrti_tile_times(const voxrti_beam *b, const double full, __m128i side,
                                                           __m128i back, __m128i c, __m256d d) {
    const __m256d is_u = _mm256_castsi256_pd(_mm256_cvtepi32_epi64(_mm_cmpeq_epi32(side, _mm_set1_epi32(1))));
    const __m256d is_v = _mm256_castsi256_pd(_mm256_cvtepi32_epi64(_mm_cmpeq_epi32(side, _mm_set1_epi32(2))));
    const __m256d turned = _mm256_castsi256_pd(_mm256_cvtepi32_epi64(back));
    __m256d u = _mm256_blendv_pd(_mm256_set1_pd(b->o[0]), _mm256_set1_pd(full - b->o[0]), turned);
    __m256d v = _mm256_blendv_pd(_mm256_set1_pd(b->o[1]), _mm256_set1_pd(full - b->o[1]), turned);
    __m256d o = _mm256_blendv_pd(_mm256_blendv_pd(_mm256_set1_pd(b->om), u, is_u), v, is_v);
    return _mm256_mul_pd(_mm256_sub_pd(_mm256_cvtepi32_pd(c), o), _mm256_div_pd(_mm256_set1_pd(1.0), d));
}

/* Write the results of eight rays: those of `lanes` (bits). */
VOXRTI_TARGET_AVX2 VOXRTI_INLINE void voxrti_tile_hits(const voxrt_tree *t, const voxrti_beam *b, const voxrti_tile *k,
                                                       uint32_t first, uint32_t lanes, voxrt_hit *hits, int lod) {
    const double full = (double)((uint32_t)1 << (2 * t->wide));
    const __m256d scale = _mm256_set1_pd(1.0 / t->voxel_size), most = _mm256_set1_pd(3.4028234663852886e38);
    const __m256i side = VOXRTI_LOADI(k->side + first), is_u = _mm256_cmpeq_epi32(side, _mm256_set1_epi32(1));
    const __m256i is_v = _mm256_cmpeq_epi32(side, _mm256_set1_epi32(2)), one = _mm256_set1_epi32(1);
    const __m256i sign = _mm256_set1_epi32((int)0x80000000u), none = _mm256_set1_epi32(-1);
    const __m256i ls = lod ? VOXRTI_LOADI(k->ls + first) : _mm256_setzero_si256();
    const __m256i unit = lod ? VOXRTI_LOADI(k->unit + first) : ls, more = _mm256_sub_epi32(ls, unit);
    __m256i last = _mm256_set1_epi32((int)(((uint32_t)1 << (2 * t->wide)) - 1u));
    __m256i c[3], cell[3], node = VOXRTI_LOADI(k->node + first), back, at, face, slot, info, on, x, r[4];
    __m256d t0, t1, end0 = most, end1 = most;
    __m256 d;
    uint32_t a;
    if (lod) last = _mm256_srlv_epi32(last, unit);
    for (a = 0; a < 3; a++) c[a] = VOXRTI_LOADI(k->cell[a] + first);
    d = _mm256_blendv_ps(_mm256_loadu_ps(k->d[0] + first), _mm256_loadu_ps(k->d[1] + first), VOXRTI_PS(is_u));
    d = _mm256_blendv_ps(d, _mm256_loadu_ps(k->d[2] + first), VOXRTI_PS(is_v));
    back = _mm256_and_si256(_mm256_srai_epi32(_mm256_castps_si256(d), 31), _mm256_or_si256(is_u, is_v));
    d = _mm256_andnot_ps(VOXRTI_PS(sign), d);
    at = VOXRTI_BLENDI(VOXRTI_BLENDI(c[0], c[1], is_u), c[2], is_v);
    at = VOXRTI_BLENDI(at, _mm256_sub_epi32(last, at), back);
    if (lod) at = _mm256_sllv_epi32(_mm256_srlv_epi32(at, more), ls);
    t0 = voxrti_tile_times(b, full, _mm256_castsi256_si128(side), _mm256_castsi256_si128(back),
                           _mm256_castsi256_si128(at),
                           _mm256_mul_pd(_mm256_cvtps_pd(_mm256_castps256_ps128(d)), scale));
    t1 = voxrti_tile_times(b, full, _mm256_extracti128_si256(side, 1), _mm256_extracti128_si256(back, 1),
                           _mm256_extracti128_si256(at, 1),
                           _mm256_mul_pd(_mm256_cvtps_pd(_mm256_extractf128_ps(d, 1)), scale));
    if (k->limited) {
        end0 = _mm256_min_pd(end0, voxrti_below4(_mm_loadu_ps(k->t_max + first)));
        end1 = _mm256_min_pd(end1, voxrti_below4(_mm_loadu_ps(k->t_max + first + 4)));
    }
    on = _mm256_inserti128_si256(_mm256_castsi128_si256(voxrti_narrow4(_mm256_cmp_pd(t0, end0, _CMP_LT_OQ))),
                                 voxrti_narrow4(_mm256_cmp_pd(t1, end1, _CMP_LT_OQ)), 1);
    on = _mm256_andnot_si256(_mm256_cmpeq_epi32(node, none), on);
    cell[b->m] = b->back ? _mm256_sub_epi32(last, c[0]) : c[0];
    cell[b->u] = c[1];
    cell[b->v] = c[2];
    slot = _mm256_setzero_si256();
    for (a = 0; a < 3; a++) {
        if (lod) cell[a] = _mm256_srlv_epi32(cell[a], more);
        x = lod ? _mm256_sllv_epi32(cell[a], _mm256_and_si256(ls, one)) : cell[a]; /* octants: their first cells */
        x = _mm256_and_si256(x, _mm256_set1_epi32(3));
        x = _mm256_and_si256(_mm256_or_si256(x, _mm256_slli_epi32(x, 2)), _mm256_set1_epi32(9));
        slot = _mm256_or_si256(slot, _mm256_sll_epi32(x, _mm_cvtsi32_si128((int)a)));
        cell[a] = _mm256_and_si256(cell[a], on);
    }
    x = _mm256_set1_epi32((int)t->depth);
    if (lod) x = _mm256_sub_epi32(x, ls);
    slot = _mm256_or_si256(slot, _mm256_slli_epi32(x, 8));
    face = _mm256_set1_epi32((int)(2 * b->m + b->back));
    face = VOXRTI_BLENDI(face, _mm256_set1_epi32((int)(2 * b->u)), is_u);
    face = VOXRTI_BLENDI(face, _mm256_set1_epi32((int)(2 * b->v)), is_v);
    face = _mm256_sub_epi32(face, back);
    info = _mm256_and_si256(_mm256_or_si256(slot, _mm256_slli_epi32(face, 16)), on);
    node = _mm256_or_si256(node, _mm256_xor_si256(on, none));
    d = _mm256_insertf128_ps(_mm256_castps128_ps256(_mm256_cvtpd_ps(t0)), _mm256_cvtpd_ps(t1), 1);
    x = _mm256_castps_si256(_mm256_blendv_ps(_mm256_set1_ps(INFINITY), d, VOXRTI_PS(on)));
    /* columns to records; low halves hold rays 0 to 3 */
    at = _mm256_unpacklo_epi32(x, cell[0]);
    x = _mm256_unpackhi_epi32(x, cell[0]);
    back = _mm256_unpacklo_epi32(cell[1], cell[2]);
    face = _mm256_unpackhi_epi32(cell[1], cell[2]);
    r[0] = _mm256_unpacklo_epi64(at, back);
    r[1] = _mm256_unpackhi_epi64(at, back);
    r[2] = _mm256_unpacklo_epi64(x, face);
    r[3] = _mm256_unpackhi_epi64(x, face);
    at = _mm256_unpacklo_epi32(node, info);
    back = _mm256_unpackhi_epi32(node, info);
    for (a = 0; a < 3; a++) VOXRTI_PREFETCH((const void *)((uintptr_t)hits + 64 * sizeof *hits + 64 * a));
    for (a = 0; a < 8; a++) {
        const __m256i two = (a & 2u) ? back : at;
        const __m128i four = a < 4 ? _mm256_castsi256_si128(two) : _mm256_extracti128_si256(two, 1);
        const __m128i low = a < 4 ? _mm256_castsi256_si128(r[a & 3u]) : _mm256_extracti128_si256(r[a & 3u], 1);
        if (lanes >> a & 1u)
            voxrti_hit_store(&hits[a], _mm_castsi128_ps(low), (a & 1u) ? _mm_unpackhi_epi64(four, four) : four);
    }
}

/* Positions and slopes in fixed point, at the plane where the march begins. */
VOXRTI_TARGET_AVX2 static inline void voxrti_tile_begin(const voxrti_beam *b, voxrti_tile *k) {
    const double unit = 1.0 / (double)((uint32_t)1 << k->log);
    const __m256d one = _mm256_set1_pd((double)(1 << VOXRTI_TILE_BITS)), z = _mm256_set1_pd((b->z - b->om) * unit);
    uint32_t i, a;
    k->start = b->z;
    k->base[0] = b->u0 * (int32_t)(4u >> b->pair);
    k->base[1] = b->v0 * (int32_t)(4u >> b->pair);
    for (a = 0; a < 2; a++) {
        const __m256d o = _mm256_set1_pd(b->o[a] * unit - (double)k->base[a]);
        for (i = 0; i < 64; i += 4) {
            __m256d s = _mm256_loadu_pd(k->slope[a] + i), x = _mm256_add_pd(o, _mm256_mul_pd(s, z));
            VOXRTI_STORE4(k->at[a] + i, _mm256_cvtpd_epi32(_mm256_mul_pd(x, one)));
            VOXRTI_STORE4(k->step[a] + i, _mm256_cvtpd_epi32(_mm256_mul_pd(s, one)));
        }
    }
}

/* None of n rays meets anything. */
VOXRTI_TARGET_AVX2 static inline void voxrti_tile_misses(voxrt_hit *hits, uint32_t n) {
    const __m128 inf = _mm_set_ss(INFINITY);
    const __m128i none = _mm_set_epi32(0, 0, 0, -1);
    uint32_t i;
    for (i = 0; i < n; i++) voxrti_hit_store(&hits[i], inf, none);
}

/* March from the slab found by the walk on, as far as it goes; returns what it says then. */
VOXRTI_TARGET_AVX2 VOXRTI_INLINE uint32_t voxrti_tile_slabs(const voxrt_tree *t, const voxrti_cone *cone, uint32_t n,
                                                            voxrti_beam *b, voxrti_tile *k, voxrti_chain *chain,
                                                            int with_lod) {
    uint32_t p, found = 1, begun = 0;
    voxrti_tile_lod lod;
    lod.ls = lod.unit = 0;
    k->log = 0;
    for (; found == 1 && k->active != 0; found = voxrti_beam_walk(t, cone, b, 1)) {
        const uint32_t groups = (uint32_t)(b->v1 - b->v0) / 2 + 1;
        const uint64_t before = k->later;
        voxrti_tile_view at;
        if (with_lod) voxrti_tile_detail(t, cone, b, &lod);
        if (!begun || b->z - k->start > (double)(512u << k->log) || (with_lod && lod.unit != k->log)) {
            k->log = lod.unit;
            voxrti_tile_begin(b, k); /* errors grow */
        }
        begun = 1;
        if (!with_lod) voxrti_tile_slab(t, b, 1, 0, k);
        else if (b->pair) voxrti_tile_pair(t, b, k);
        else voxrti_tile_slab(t, b, b->size == 4, lod.ls, k);
        at = voxrti_tile_look(b, k);
        for (p = 0; p < n; p += 8) {
            if ((k->active >> p & 255u) == 0) continue;
            if (with_lod && lod.ls != 0) voxrti_tile_march(b, k, &at, p, 4, &lod);
            else if (groups == 1) voxrti_tile_march(b, k, &at, p, 1, NULL);
            else if (groups == 2) voxrti_tile_march(b, k, &at, p, 2, NULL);
            else voxrti_tile_march(b, k, &at, p, 4, NULL);
        }
        if (with_lod && before == 0 && k->later != 0) {
            k->again = b->z;
            voxrti_beam_chain(t, cone, b, chain);
        }
    }
    return found;
}

VOXRTI_TARGET_AVX2 static VOXRTI_NOINLINE uint32_t voxrti_tile_slabs_lod(const voxrt_tree *t, const voxrti_cone *cone,
                                                                         uint32_t n, voxrti_beam *b, voxrti_tile *k,
                                                                         voxrti_chain *chain) {
    memset(k->ls, 0, sizeof k->ls);
    memset(k->unit, 0, sizeof k->unit);
    return voxrti_tile_slabs(t, cone, n, b, k, chain, 1);
}

/* Trace a run of n rays as a tile, if it is one. Returns a bit for each ray that is left: when b->on is 1 it starts at
   plane b->z, and `chain` leads there. With stats all are left. */
VOXRTI_TARGET_AVX2 VOXRTI_NOINLINE static uint64_t voxrti_tile_trace(const voxrt_tree *t, const voxrti_cone *cone,
                                                                     const voxrt_ray *rays, uint32_t n, voxrti_beam *b,
                                                                     voxrti_chain *chain, voxrt_hit *hits,
                                                                     const voxrt_stats *stats) {
    voxrti_tile tile, *k = &tile;
    const uint64_t all = ~(uint64_t)0 >> (64 - n);
    uint32_t i, fit, found, lod;
    chain->w = 0;
    if (!voxrti_beam_open(t, rays, n, b)) return all;
    if (n < 64) memset(k, 0, sizeof *k);
    fit = voxrti_tile_open(t, cone, rays, n, b, k);
    if (fit == 0) return all;
    b->on = 1;
    found = voxrti_beam_walk(t, cone, b, 1);
    if (found == 0) {
        b->z = VOXRTI_INF;
        if (stats != NULL) return all; /* unusable rays are misses, but counted */
        voxrti_tile_misses(hits, n);
        return 0;
    }
    if (stats != NULL || fit == 1 || !(b->z > k->late)) {
        voxrti_beam_chain(t, cone, b, chain);
        return all;
    }
    memset(k->node, 0xff, sizeof k->node);
    memset(k->cell, 0, sizeof k->cell);
    memset(k->side, 0, sizeof k->side);
    k->active = all & ~k->rare;
    k->later = 0;
    /* up to the tree's far end, may level of detail accept more than voxels? */
    lod = cone->on && voxrti_footprint(cone, ((double)((uint32_t)1 << (2 * t->wide)) - b->om) * b->slow) >= 2.0;
    if (found == 1 && lod) found = voxrti_tile_slabs_lod(t, cone, n, b, k, chain);
    else if (found == 1) found = voxrti_tile_slabs(t, cone, n, b, k, chain, 0);
    if (found != 2) k->active = 0;
    else if (k->later == 0 && k->active != 0) voxrti_beam_chain(t, cone, b, chain);
    if (k->later != 0) b->z = k->again;
    k->active |= k->later;
    for (i = 0; i < n; i += 8) {
        const uint32_t lanes = (uint32_t)((all & ~(k->rare | k->active)) >> i) & 255u;
        if (lanes == 0) continue;
        if (lod) voxrti_tile_hits(t, b, k, i, lanes, hits + i, 1);
        else voxrti_tile_hits(t, b, k, i, lanes, hits + i, 0);
    }
    for (; k->rare != 0; k->rare &= k->rare - 1) {
        i = voxrti_ctz64(k->rare);
        voxrti_trace_one(t, cone, NULL, rays + i, hits + i, NULL);
    }
    return k->active;
}

#endif /* VOXRTI_AVX2 */
/* ---- AVX2: groups of eight rays in flight, a finished lane takes the next ray ----
   The scalar path with vector masks. A vector of 32-bit integers holds all eight lanes, doubles come in two halves:
   lanes 0 1 4 5, then 2 3 6 7. So unpack and shuffle, which stay inside 128 bits, convert between the two. */

#if VOXRTI_AVX2

/* low or high 32 bits of the eight 64-bit lanes of two halves */
#define VOXRTI_LOW8(a, b) _mm256_castps_si256(_mm256_shuffle_ps(VOXRTI_PS(a), VOXRTI_PS(b), 0x88))
#define VOXRTI_HIGH8(a, b) _mm256_castps_si256(_mm256_shuffle_ps(VOXRTI_PS(a), VOXRTI_PS(b), 0xdd))
#define VOXRTI_MASK8(a, b) VOXRTI_HIGH8(_mm256_castpd_si256(a), _mm256_castpd_si256(b))
#define VOXRTI_PLACE8(lane) (((lane) & 1u) | ((lane) >> 1 & 2u) | ((lane) << 1 & 4u)) /* of its double */

#define VOXRTI_OCTETS 3        /* groups of eight rays in flight */
#define VOXRTI_OCTET_REFILL 6  /* lanes are refilled when at most so many are busy */

#define VOXRTI_READY 16        /* rays prepared at a time */

/* Prepared rays; bits in live: waiting for a lane. */
typedef struct voxrti_ready {
    double o[3][VOXRTI_READY], d[3][VOXRTI_READY], inv[3][VOXRTI_READY];
    double t[VOXRTI_READY], t_end[VOXRTI_READY];
    uint32_t c[3][VOXRTI_READY], w[VOXRTI_READY], flip[VOXRTI_READY], turn[3][VOXRTI_READY], live;
} voxrti_ready;

/* Eight rays in flight. Doubles and addresses of a lane stand at VOXRTI_PLACE8(lane). */
typedef struct voxrti_octet {
    __m256i align; /* all vectors in one cache line each */
    double o[3][8], d[3][8], inv[3][8], t[8], t_end[8];
    uint64_t child[8];                      /* address of the node below */
    uint64_t path[8][VOXRTI_MAX_WIDE + 1];  /* addresses of the nodes from the root to level w, by lane */
    uint32_t c[3][8], w[8], flip[8], turn[3][8], ray[8], alive[8]; /* turn: 4 for a mirrored axis */
    uint32_t live, found, used; /* bit per lane: on its way; stands on a voxel; taken, result not written yet */
    uint32_t coded;             /* shared trees, bit per lane: its leaf node is still the address of a code */
} voxrti_octet;

/* Constants of the step, in memory: gcc would make each anew with three instructions. */
typedef struct voxrti_octet_const {
    __m256i one, three, seven, octant, last_slot, places, bytes, words, nibble, two52, half, exponent, e127, four;
    __m256i leaf_w, node, leaf, leaf_less; /* leaf: where leaf nodes are, or their codes */
    uint32_t coded;                        /* lanes that go to codes: none or all */
} voxrti_octet_const;

VOXRTI_TARGET_AVX2 static void voxrti_octet_open(const voxrt_tree *t, voxrti_octet_const *k) {
    k->one = _mm256_set1_epi32(1);
    k->three = _mm256_set1_epi32(3);
    k->four = _mm256_set1_epi32(4);
    k->seven = _mm256_set1_epi32(7);
    k->octant = _mm256_set1_epi32(56);
    k->last_slot = _mm256_set1_epi32(63);
    k->places = _mm256_set1_epi32(0x0c080400);
    k->bytes = _mm256_set1_epi8(1);
    k->words = _mm256_set1_epi16(1);
    k->nibble = _mm256_set1_epi8(15);
    k->two52 = _mm256_set1_epi32(0x43300000);   /* high half of 2^52 */
    k->half = _mm256_set1_epi32(65536);         /* 2^-16 cells */
    k->exponent = _mm256_set1_epi32(0x41300000); /* of 2^20 */
    k->e127 = _mm256_set1_epi32(127);
    k->leaf_w = _mm256_set1_epi32((int)t->wide - 1);
    k->node = _mm256_set1_epi64x((long long)(intptr_t)t->node);
    k->leaf = _mm256_set1_epi64x(t->code != NULL ? (long long)(intptr_t)t->code : (long long)(intptr_t)t->leaf);
    k->leaf_less = _mm256_set1_epi32(t->code != NULL ? -3 : -1);
    k->coded = t->code != NULL ? 255u : 0u;
}

/* p is within 2^-16 of a whole number (false for NaN) */
VOXRTI_TARGET_AVX2 static inline __m256d voxrti_close4(__m256d p) {
    __m256d f = _mm256_sub_pd(p, _mm256_round_pd(p, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC));
    return _mm256_cmp_pd(_mm256_andnot_pd(_mm256_set1_pd(-0.0), f), _mm256_set1_pd(1.52587890625e-05), _CMP_LT_OQ);
}

/* Prepare the rays `first` to first + 3 of a run. Returns those that enter the box (bits). *rare: those that need the
   scalar path (bad or far away); the others miss the box. The same arithmetic as voxrti_ray_setup. */
VOXRTI_TARGET_AVX2 static inline uint32_t voxrti_setup4(const voxrt_tree *t, const voxrti_cone *cone,
                                                        const voxrt_ray *rays, uint32_t first, const voxrti_beam *beam,
                                                        const voxrti_chain *chain, voxrti_ready *g, uint32_t *rare) {
    const __m256d zero = _mm256_setzero_pd(), inf = _mm256_set1_pd(VOXRTI_INF), sign = _mm256_set1_pd(-0.0);
    const __m256d scale = _mm256_set1_pd(1.0 / t->voxel_size), limit = _mm256_set1_pd(16777216.0);
    const double full = (double)((uint32_t)1 << (2 * t->wide));
    const uint32_t leaf_w = t->wide - 1;
    __m256d o[3], d[3], inv[3], lo[3], hi[3], axis[3], still[3], t_in = _mm256_sub_pd(zero, inf), t_out = inf;
    __m256d bad, out = zero, moving = zero, late = zero, time, t_end, tmin, tmax, e;
    __m128i flip = _mm_setzero_si128();
    __m256 v[4];
    uint32_t a, lane, doubt[3], any = 0, back[3], live;
    voxrti_rays4(rays, rays + 1, rays + 2, rays + 3, v);
    tmin = _mm256_cvtps_pd(_mm256_castps256_ps128(v[3]));
    tmax = _mm256_cvtps_pd(_mm256_extractf128_ps(v[3], 1));
    bad = _mm256_cmp_pd(tmin, tmax, _CMP_NLE_UQ);
    tmax = voxrti_below4(_mm256_extractf128_ps(v[3], 1));
    for (a = 0; a < 3; a++) {
        __m256d oo = _mm256_cvtps_pd(_mm256_castps256_ps128(v[a])), neg, closer;
        __m256d dd = _mm256_cvtps_pd(_mm256_extractf128_ps(v[a], 1));
        oo = _mm256_mul_pd(_mm256_sub_pd(oo, _mm256_set1_pd(t->origin[a])), scale);
        dd = _mm256_mul_pd(dd, scale);
        bad = _mm256_or_pd(bad, _mm256_cmp_pd(_mm256_sub_pd(dd, dd), zero, _CMP_NEQ_UQ));
        neg = _mm256_cmp_pd(dd, zero, _CMP_LT_OQ);
        back[a] = (uint32_t)_mm256_movemask_pd(neg);
        oo = _mm256_blendv_pd(oo, _mm256_sub_pd(_mm256_set1_pd(full), oo), neg);
        dd = _mm256_andnot_pd(sign, dd);
        lo[a] = _mm256_blendv_pd(_mm256_set1_pd((double)cone->lo[a]), _mm256_set1_pd(full - (double)cone->hi[a]), neg);
        hi[a] = _mm256_blendv_pd(_mm256_set1_pd((double)cone->hi[a]), _mm256_set1_pd(full - (double)cone->lo[a]), neg);
        flip = _mm_or_si128(flip, _mm_and_si128(voxrti_narrow4(neg), _mm_set1_epi32(9 << a)));
        bad = _mm256_or_pd(bad, _mm256_cmp_pd(_mm256_andnot_pd(sign, oo), limit, _CMP_NLE_UQ));
        inv[a] = _mm256_div_pd(_mm256_set1_pd(1.0), dd);
        still[a] = _mm256_cmp_pd(inv[a], inf, _CMP_EQ_OQ);
        moving = _mm256_or_pd(moving, _mm256_cmp_pd(inv[a], inf, _CMP_NEQ_UQ));
        if (_mm256_movemask_pd(still[a]) != 0) {
            __m256d mid = _mm256_round_pd(oo, _MM_FROUND_TO_ZERO | _MM_FROUND_NO_EXC);
            mid = _mm256_add_pd(mid, _mm256_set1_pd(0.5));
            e = _mm256_or_pd(_mm256_cmp_pd(oo, lo[a], _CMP_LT_OQ), _mm256_cmp_pd(oo, hi[a], _CMP_NLT_UQ));
            out = _mm256_or_pd(out, _mm256_and_pd(still[a], e));
            oo = _mm256_blendv_pd(oo, mid, still[a]);
            dd = _mm256_andnot_pd(still[a], dd);
        }
        o[a] = oo;
        d[a] = dd;
        e = _mm256_mul_pd(_mm256_sub_pd(lo[a], oo), inv[a]);
        closer = _mm256_andnot_pd(still[a], _mm256_cmp_pd(e, t_in, _CMP_GT_OQ));
        t_in = _mm256_blendv_pd(t_in, e, closer);
        axis[a] = closer;
        if (a > 0) axis[0] = _mm256_andnot_pd(closer, axis[0]);
        if (a > 1) axis[1] = _mm256_andnot_pd(closer, axis[1]);
        e = _mm256_mul_pd(_mm256_sub_pd(hi[a], oo), inv[a]);
        t_out = _mm256_blendv_pd(_mm256_min_pd(t_out, e), t_out, still[a]);
    }
    time = _mm256_max_pd(t_in, tmin);
    e = _mm256_cmp_pd(time, t_in, _CMP_GT_OQ); /* starts inside */
    for (a = 0; a < 3; a++) axis[a] = _mm256_andnot_pd(e, axis[a]);
    if (beam->on) {
        e = t_in;
        for (a = 0; a < 3; a++)
            if (a == beam->m) e = _mm256_mul_pd(_mm256_sub_pd(_mm256_set1_pd(beam->z), o[a]), inv[a]);
        late = _mm256_cmp_pd(e, time, _CMP_GT_OQ);
        time = _mm256_blendv_pd(time, e, late);
        for (a = 0; a < 3; a++) axis[a] = a == beam->m ? _mm256_or_pd(axis[a], late) : _mm256_andnot_pd(late, axis[a]);
    }
    t_end = _mm256_min_pd(t_out, _mm256_min_pd(tmax, _mm256_set1_pd(3.4028234663852886e38)));
    out = _mm256_or_pd(out, _mm256_cmp_pd(time, t_end, _CMP_NLT_UQ));
    *rare = (uint32_t)_mm256_movemask_pd(bad) | (~(uint32_t)_mm256_movemask_pd(moving) & 15u);
    live = 15u & ~(*rare | (uint32_t)_mm256_movemask_pd(out));
    if (live == 0) return 0;
    for (a = 0; a < 3; a++) {
        __m256d p = _mm256_add_pd(o[a], _mm256_mul_pd(time, d[a]));
        e = _mm256_andnot_pd(_mm256_or_pd(axis[a], still[a]), voxrti_close4(p));
        doubt[a] = (uint32_t)_mm256_movemask_pd(e);
        any |= doubt[a];
        p = _mm256_max_pd(_mm256_min_pd(p, _mm256_sub_pd(hi[a], _mm256_set1_pd(1.0))), lo[a]);
        if (beam->on && a == beam->m) lo[a] = _mm256_blendv_pd(lo[a], _mm256_set1_pd(voxrti_min(beam->z, full)), late);
        VOXRTI_STORE4(g->c[a] + first, _mm256_cvttpd_epi32(_mm256_blendv_pd(p, lo[a], axis[a])));
        _mm256_storeu_pd(g->o[a] + first, o[a]);
        _mm256_storeu_pd(g->d[a] + first, d[a]);
        _mm256_storeu_pd(g->inv[a] + first, inv[a]);
    }
    _mm256_storeu_pd(g->t + first, time);
    _mm256_storeu_pd(g->t_end + first, t_end);
    VOXRTI_STORE4(g->flip + first, flip);
    for (a = 0; a < 3; a++)
        VOXRTI_STORE4(g->turn[a] + first,
                      _mm_slli_epi32(_mm_and_si128(_mm_srli_epi32(flip, (int)a), _mm_set1_epi32(1)), 2));
    for (any &= live; any != 0; any &= any - 1) { /* close to an event: decide exactly */
        voxrti_rayx r;
        uint32_t k = 3;
        lane = voxrti_ctz64(any);
        for (a = 0; a < 3; a++) {
            r.o[a] = g->o[a][first + lane];
            r.d[a] = g->d[a][first + lane];
            r.inv[a] = g->inv[a][first + lane];
            if ((uint32_t)_mm256_movemask_pd(axis[a]) >> lane & 1u) k = a;
        }
        for (a = 0; a < 3; a++) {
            uint32_t from = (back[a] >> lane & 1u) ? (uint32_t)full - cone->hi[a] : cone->lo[a];
            uint32_t to = (back[a] >> lane & 1u) ? (uint32_t)full - cone->lo[a] : cone->hi[a];
            if (doubt[a] >> lane & 1u)
                g->c[a][first + lane] = voxrti_cell_at(&r, a, g->t[first + lane], k, from, to - 1);
        }
    }
    { /* start at the deepest node of the chain that holds the ray's first cell */
        __m128i w = _mm_setzero_si128(), x = w;
        uint32_t l;
        if (chain->w != 0) {
            __m256d foot = _mm256_max_pd(_mm256_set1_pd(cone->floor_), _mm256_add_pd(_mm256_set1_pd(cone->width),
                                         _mm256_mul_pd(_mm256_set1_pd(cone->spread), time)));
            for (a = 0; a < 3; a++) {
                __m128i neg = _mm_srai_epi32(_mm_slli_epi32(flip, 31 - (int)a), 31);
                __m128i c = _mm_xor_si128(VOXRTI_LOAD4(g->c[a] + first), _mm_srli_epi32(neg, 32 - 2 * (int)t->wide));
                x = _mm_or_si128(x, _mm_xor_si128(c, _mm_set1_epi32((int)chain->cell[a])));
            }
            for (l = 1; l <= chain->w; l++) {
                __m128i m = _mm_cmpgt_epi32(_mm_set1_epi32(4 << 2 * (leaf_w - l)), x);
                if (cone->on) /* level of detail must not accept the node's octants or itself */
                    m = _mm_and_si128(m, voxrti_narrow4(_mm256_cmp_pd(
                        foot, _mm256_set1_pd((double)(4 << 2 * (leaf_w - l))), _CMP_LT_OQ)));
                w = _mm_sub_epi32(w, m);
            }
        }
        VOXRTI_STORE4(g->w + first, w);
    }
    return live;
}

static inline void voxrti_octet_ray(const voxrti_octet *g, uint32_t lane, voxrti_rayx *r) {
    uint32_t a, i = VOXRTI_PLACE8(lane);
    for (a = 0; a < 3; a++) {
        r->o[a] = g->o[a][i];
        r->d[a] = g->d[a][i];
        r->inv[a] = g->inv[a][i];
        r->c[a] = g->c[a][lane];
    }
    r->flip = g->flip[lane];
    r->base = 0;
}

/* Index of the node in which a lane stands. */
static inline uint32_t voxrti_octet_node(const voxrt_tree *t, const voxrti_octet *g, uint32_t lane) {
    const uint32_t w = g->w[lane];
    const uintptr_t at = (uintptr_t)g->path[lane][w];
    return (uint32_t)(w + 1 == t->wide ? (at - (uintptr_t)t->leaf) / 8 : (at - (uintptr_t)t->node) / 16);
}

/* Level of detail for lanes whose footprint may cover the cell: exact decision as in voxrti_trace_scalar.
   Returns the lanes that hit. */
static VOXRTI_NOINLINE uint32_t voxrti_octet_lod(const voxrt_tree *t, const voxrti_cone *cone, voxrti_octet *g,
                                                 uint32_t lanes, const voxrt_ray *rays, voxrt_hit *hits) {
    uint32_t done = 0, face;
    for (; lanes != 0; lanes &= lanes - 1) {
        voxrti_rayx r;
        uint32_t lane = voxrti_ctz64(lanes), sh = 2 * (t->wide - 1 - g->w[lane]), slot, ls;
        uint32_t node = voxrti_octet_node(t, g, lane);
        uint64_t mask = sh == 0 ? t->leaf[node] : t->node[node].mask;
        voxrti_octet_ray(g, lane, &r);
        r.t_min = (double)rays[g->ray[lane]].t_min;
        slot = voxrti_slot_of(r.c, sh) ^ r.flip;
        for (ls = sh + 2; ls-- > sh;) {
            uint64_t filled = ls > sh ? mask >> (slot & 56u) & 255u : mask >> slot & 1u;
            if (filled != 0 && voxrti_footprint(cone, voxrti_entry(&r, r.c, ls, &face)) >= (double)(1u << ls)) {
                voxrti_hit_fill(t, &r, r.c, ls, node, ls > sh ? slot & 56u : slot, &hits[g->ray[lane]]);
                done |= 1u << lane;
                g->used &= ~(1u << lane); /* written */
                g->alive[lane] = 0;
                break;
            }
        }
    }
    return done;
}

/* Lanes whose position is within 2^-16 of an event of another axis: decide exactly. g->c, ls: cells before the step. */
static VOXRTI_NOINLINE void voxrti_octet_doubt(const voxrti_octet *g, const double time[8], const uint32_t ls[8],
                                               uint32_t lanes, uint32_t q[3][8]) {
    for (; lanes != 0; lanes &= lanes - 1) {
        voxrti_rayx r;
        uint32_t lane = voxrti_ctz64(lanes), a, k = 3, low = ((uint32_t)1 << ls[lane]) - 1u;
        double t = time[VOXRTI_PLACE8(lane)];
        voxrti_octet_ray(g, lane, &r);
        for (a = 0; a < 3; a++)
            if (k == 3 && ((double)((r.c[a] | low) + 1u) - r.o[a]) * r.inv[a] == t) k = a;
        for (a = 0; a < 3; a++)
            if (a != k) q[a][lane] = voxrti_cell_at(&r, a, t, k, r.c[a], r.c[a] | low);
    }
}

/* Slots of the cells x, y, z (0..3) in their nodes: as bytes, spread by one table. */
VOXRTI_TARGET_AVX2 static inline __m256i voxrti_octet_slot(const voxrti_octet_const *k, __m256i x, __m256i y, __m256i z,
                                                           __m256i flip) {
    const __m256i spread = _mm256_setr_epi8(0, 1, 8, 9, 0, 2, 16, 18, 0, 4, 32, 36, 0, 0, 0, 0,
                                            0, 1, 8, 9, 0, 2, 16, 18, 0, 4, 32, 36, 0, 0, 0, 0);
    __m256i s = _mm256_or_si256(x, _mm256_or_si256(_mm256_slli_epi32(y, 8), _mm256_slli_epi32(z, 16)));
    s = _mm256_shuffle_epi8(spread, _mm256_or_si256(s, k->places));
    s = _mm256_madd_epi16(_mm256_maddubs_epi16(s, k->bytes), k->words);
    return _mm256_xor_si256(s, flip);
}

/* Bits set in each of four words. */
VOXRTI_TARGET_AVX2 static inline __m256i voxrti_popcount4(const voxrti_octet_const *k, __m256i v) {
    const __m256i count = _mm256_setr_epi8(0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4,
                                           0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4);
    __m256i a = _mm256_shuffle_epi8(count, _mm256_and_si256(v, k->nibble));
    __m256i b = _mm256_shuffle_epi8(count, _mm256_and_si256(_mm256_srli_epi64(v, 4), k->nibble));
    return _mm256_sad_epu8(_mm256_add_epi8(a, b), _mm256_setzero_si256());
}

/* 16 bytes of each of two nodes. */
VOXRTI_TARGET_AVX2 static inline __m256i voxrti_octet_pair(uint64_t a, uint64_t b) {
    return _mm256_inserti128_si256(_mm256_castsi128_si256(VOXRTI_LOAD4((uintptr_t)a)), VOXRTI_LOAD4((uintptr_t)b), 1);
}

/* Events of the planes behind cells g; g in the low half of each 64-bit lane, 2^52's high half in the other. */
VOXRTI_TARGET_AVX2 static inline __m256d voxrti_octet_event(__m256i g, const double *o, const double *inv) {
    __m256d f = _mm256_sub_pd(_mm256_castsi256_pd(g), _mm256_set1_pd(4503599627370495.0)); /* g + 1 */
    return _mm256_mul_pd(_mm256_sub_pd(f, _mm256_loadu_pd(o)), _mm256_loadu_pd(inv));
}

/* Cells of one axis at time t0, t1; last + 1 where the axis steps. The position plus 2^20 is a fixed-point number:
   20 bits of cell, 32 bits of fraction. *least: less than 2^17 when closer than 2^-16 to a plane of another axis;
   otherwise, rounding being far below, the cell is certain. */
VOXRTI_TARGET_AVX2 static inline __m256i voxrti_octet_cells(const voxrti_octet_const *k, __m256d t0, __m256d t1,
                                                            const double *o, const double *d, __m256i last,
                                                            __m256i steps, __m256i *least) {
    const __m256d bias = _mm256_set1_pd(1048576.0);
    __m256d x0 = _mm256_add_pd(_mm256_loadu_pd(o), _mm256_mul_pd(t0, _mm256_loadu_pd(d)));
    __m256d x1 = _mm256_add_pd(_mm256_loadu_pd(o + 4), _mm256_mul_pd(t1, _mm256_loadu_pd(d + 4)));
    __m256i p0 = _mm256_castpd_si256(_mm256_add_pd(x0, bias)), p1 = _mm256_castpd_si256(_mm256_add_pd(x1, bias)), q;
    q = _mm256_or_si256(_mm256_add_epi32(VOXRTI_LOW8(p0, p1), k->half), steps);
    *least = _mm256_min_epu32(*least, q);
    q = _mm256_sub_epi32(VOXRTI_HIGH8(p0, p1), k->exponent);
    return VOXRTI_BLENDI(q, _mm256_add_epi32(last, k->one), steps);
}

/* Lanes whose footprint may cover the cell (of edge 2^sh) or the octant they stand in; set, octant: filled ones. */
VOXRTI_TARGET_AVX2 static inline uint32_t voxrti_octet_wide(const voxrti_cone *cone, const voxrti_octet *g, __m256i sh,
                                                            __m256i set, __m256i octant) {
    const __m256i two52 = _mm256_set1_epi32(0x43300000), size = _mm256_sllv_epi32(_mm256_set1_epi32(1), sh);
    const __m256d two = _mm256_castsi256_pd(_mm256_slli_epi64(two52, 32)), spread = _mm256_set1_pd(cone->spread);
    const __m256d width = _mm256_set1_pd(cone->width), least = _mm256_set1_pd(cone->floor_);
    __m256d s0 = _mm256_sub_pd(_mm256_castsi256_pd(_mm256_unpacklo_epi32(size, two52)), two), f0, f1;
    __m256d s1 = _mm256_sub_pd(_mm256_castsi256_pd(_mm256_unpackhi_epi32(size, two52)), two);
    f0 = _mm256_max_pd(least, _mm256_add_pd(width, _mm256_mul_pd(spread, _mm256_loadu_pd(g->t))));
    f1 = _mm256_max_pd(least, _mm256_add_pd(width, _mm256_mul_pd(spread, _mm256_loadu_pd(g->t + 4))));
    set = _mm256_and_si256(set, VOXRTI_MASK8(_mm256_cmp_pd(f0, s0, _CMP_GE_OQ), _mm256_cmp_pd(f1, s1, _CMP_GE_OQ)));
    s0 = _mm256_add_pd(s0, s0);
    s1 = _mm256_add_pd(s1, s1);
    sh = VOXRTI_MASK8(_mm256_cmp_pd(f0, s0, _CMP_GE_OQ), _mm256_cmp_pd(f1, s1, _CMP_GE_OQ));
    return VOXRTI_SIGNS(_mm256_or_si256(set, _mm256_and_si256(octant, sh)));
}

/* The masks of the nodes in which the lanes stand, and (interior nodes) first children. The leaf array is padded. */
VOXRTI_TARGET_AVX2 static inline __m256i voxrti_octet_nodes(const voxrti_octet *g, __m256i m[2]) {
    const __m256i a = voxrti_octet_pair(g->path[0][g->w[0]], g->path[4][g->w[4]]);
    const __m256i b = voxrti_octet_pair(g->path[1][g->w[1]], g->path[5][g->w[5]]);
    const __m256i c = voxrti_octet_pair(g->path[2][g->w[2]], g->path[6][g->w[6]]);
    const __m256i d = voxrti_octet_pair(g->path[3][g->w[3]], g->path[7][g->w[7]]);
    m[0] = _mm256_unpacklo_epi64(a, b);
    m[1] = _mm256_unpacklo_epi64(c, d);
    return VOXRTI_LOW8(_mm256_unpackhi_epi64(a, b), _mm256_unpackhi_epi64(c, d));
}

/* The cells of a node that a ray standing in cell x, y, z (0..3, mirrored) can still reach, ANDed to the masks. */
VOXRTI_TARGET_AVX2 static inline void voxrti_octet_reach(const voxrti_octet *g, __m256i x, __m256i y, __m256i z,
                                                         const __m256i m[2], __m256i r[2]) {
    const __m256i tx = _mm256_setr_epi32(-1, (int)0xffaaffaau, (int)0xff00ff00u, (int)0xaa00aa00u,
                                         -1, 0x55ff55ff, 0x00ff00ff, 0x00550055);
    const __m256i ty = _mm256_setr_epi32(-1, (int)0xffffccccu, (int)0xffff0000u, (int)0xcccc0000u,
                                         -1, 0x3333ffff, 0x0000ffff, 0x00003333);
    const __m256i low = _mm256_setr_epi32(-1, (int)0xf0f0f0f0u, 0, 0, -1, -1, -1, 0x0f0f0f0f);
    const __m256i high = _mm256_setr_epi32(-1, -1, -1, (int)0xf0f0f0f0u, -1, 0x0f0f0f0f, 0, 0);
    const __m256i plane = _mm256_and_si256(
        _mm256_permutevar8x32_epi32(tx, _mm256_or_si256(x, VOXRTI_LOADI(g->turn[0]))),
        _mm256_permutevar8x32_epi32(ty, _mm256_or_si256(y, VOXRTI_LOADI(g->turn[1]))));
    z = _mm256_or_si256(z, VOXRTI_LOADI(g->turn[2]));
    x = _mm256_and_si256(plane, _mm256_permutevar8x32_epi32(low, z));
    y = _mm256_and_si256(plane, _mm256_permutevar8x32_epi32(high, z));
    r[0] = _mm256_and_si256(m[0], _mm256_unpacklo_epi32(x, y));
    r[1] = _mm256_and_si256(m[1], _mm256_unpackhi_epi32(x, y));
}

/* Shared trees: from codes to masks. The codes were asked for one group's step ago, the masks are there one later. */
static void voxrti_octet_decode(const voxrt_tree *t, voxrti_octet *g) {
    const uint32_t w = t->wide - 1;
    uint32_t k;
    for (k = g->coded; k != 0; k &= k - 1) {
        uint64_t *at = &g->path[voxrti_ctz64(k)][w];
        const size_t i = (size_t)((uintptr_t)*at - (uintptr_t)t->code) / sizeof *t->code;
        *at = (uint64_t)(uintptr_t)(t->leaf + voxrti_leaf_at(t, (uint32_t)i));
        VOXRTI_PREFETCH((const void *)(uintptr_t)*at);
    }
    g->coded = 0;
}

/* One step of every live lane: over an empty cell, up to the node that holds the next one, and down when that is
   filled. Lanes that end leave g->live; those on a voxel are added to g->found. Masks count by their sign. */
VOXRTI_TARGET_AVX2 static VOXRTI_NOINLINE void voxrti_octet_step(const voxrt_tree *t, const voxrti_cone *cone,
                                                                 const voxrti_octet_const *k, voxrti_octet *g,
                                                                 const voxrt_ray *rays, voxrt_hit *hits,
                                                                 voxrt_stats *stats) {
    const __m256i zero = _mm256_setzero_si256();
    __m256i c0 = VOXRTI_LOADI(g->c[0]), c1 = VOXRTI_LOADI(g->c[1]), c2 = VOXRTI_LOADI(g->c[2]);
    __m256i w = VOXRTI_LOADI(g->w), flip = VOXRTI_LOADI(g->flip), live = VOXRTI_LOADI(g->alive);
    __m256i sh = _mm256_slli_epi32(_mm256_sub_epi32(k->leaf_w, w), 1), m[2], r[2], first, slot, x, y, z, empty, set, on;
    __m256i ls, low, go, least, g0, g1, g2, q0, q1, q2, k0, k1, k2;
    __m256d e0, e1, e2, f0, f1, f2, t0, t1;
    uint32_t l, doubt;
    /* the cell, its octant, the rest of its node: is there anything to meet? */
    voxrti_octet_nodes(g, m);
    x = _mm256_and_si256(_mm256_srlv_epi32(c0, sh), k->three);
    y = _mm256_and_si256(_mm256_srlv_epi32(c1, sh), k->three);
    z = _mm256_and_si256(_mm256_srlv_epi32(c2, sh), k->three);
    slot = voxrti_octet_slot(k, x, y, z, flip);
    r[0] = m[0];
    r[1] = m[1];
    if (!cone->on) voxrti_octet_reach(g, x, y, z, m, r);
    x = _mm256_andnot_si256(slot, k->octant); /* octant to the top, then the cell */
    x = VOXRTI_HIGH8(_mm256_sllv_epi64(r[0], _mm256_unpacklo_epi32(x, zero)),
                     _mm256_sllv_epi64(r[1], _mm256_unpackhi_epi32(x, zero)));
    empty = _mm256_cmpeq_epi32(_mm256_srli_epi32(x, 24), zero);
    set = _mm256_and_si256(_mm256_sllv_epi32(x, _mm256_andnot_si256(slot, k->seven)), live);
    ls = _mm256_sub_epi32(sh, empty);
    if (cone->on) {
        l = voxrti_octet_wide(cone, g, sh, set, _mm256_andnot_si256(empty, live));
        if (l != 0) {
            l = voxrti_octet_lod(t, cone, g, l, rays, hits);
            live = VOXRTI_LOADI(g->alive);
            set = _mm256_and_si256(set, live);
            if (stats != NULL) stats->hits += voxrti_popcount64(l);
        }
    } else {
        ls = _mm256_sub_epi32(ls, VOXRTI_LOW8(_mm256_cmpeq_epi64(r[0], zero), _mm256_cmpeq_epi64(r[1], zero)));
    }
    if (stats != NULL) stats->steps += voxrti_popcount64(VOXRTI_SIGNS(_mm256_andnot_si256(set, live)));
    /* over: the first event of the three far faces of what is empty */
    low = _mm256_sub_epi32(_mm256_sllv_epi32(k->one, ls), k->one);
    g0 = _mm256_or_si256(c0, low); /* last cells before the faces */
    g1 = _mm256_or_si256(c1, low);
    g2 = _mm256_or_si256(c2, low);
    e0 = voxrti_octet_event(_mm256_unpacklo_epi32(g0, k->two52), g->o[0], g->inv[0]);
    f0 = voxrti_octet_event(_mm256_unpackhi_epi32(g0, k->two52), g->o[0] + 4, g->inv[0] + 4);
    e1 = voxrti_octet_event(_mm256_unpacklo_epi32(g1, k->two52), g->o[1], g->inv[1]);
    f1 = voxrti_octet_event(_mm256_unpackhi_epi32(g1, k->two52), g->o[1] + 4, g->inv[1] + 4);
    e2 = voxrti_octet_event(_mm256_unpacklo_epi32(g2, k->two52), g->o[2], g->inv[2]);
    f2 = voxrti_octet_event(_mm256_unpackhi_epi32(g2, k->two52), g->o[2] + 4, g->inv[2] + 4);
    t0 = _mm256_min_pd(_mm256_min_pd(e0, e1), e2);
    t1 = _mm256_min_pd(_mm256_min_pd(f0, f1), f2);
    k0 = VOXRTI_MASK8(_mm256_cmp_pd(e0, t0, _CMP_EQ_OQ), _mm256_cmp_pd(f0, t1, _CMP_EQ_OQ));
    k1 = VOXRTI_MASK8(_mm256_cmp_pd(e1, t0, _CMP_EQ_OQ), _mm256_cmp_pd(f1, t1, _CMP_EQ_OQ));
    k1 = _mm256_andnot_si256(k0, k1);
    k2 = _mm256_xor_si256(_mm256_or_si256(k0, k1), _mm256_set1_epi32(-1));
    on = VOXRTI_MASK8(_mm256_cmp_pd(t0, _mm256_loadu_pd(g->t_end), _CMP_LT_OQ),
                      _mm256_cmp_pd(t1, _mm256_loadu_pd(g->t_end + 4), _CMP_LT_OQ));
    set = _mm256_srai_epi32(set, 31);
    on = _mm256_andnot_si256(set, _mm256_and_si256(live, on));
    least = _mm256_set1_epi32(-1);
    q0 = voxrti_octet_cells(k, t0, t1, g->o[0], g->d[0], g0, k0, &least);
    q1 = voxrti_octet_cells(k, t0, t1, g->o[1], g->d[1], g1, k1, &least);
    q2 = voxrti_octet_cells(k, t0, t1, g->o[2], g->d[2], g2, k2, &least);
    doubt = VOXRTI_SIGNS(_mm256_and_si256(on, _mm256_cmpeq_epi32(_mm256_srli_epi32(least, 17), zero)));
    if (VOXRTI_UNLIKELY(doubt != 0)) {
        uint32_t q[3][8], size[8];
        double at[8];
        VOXRTI_STOREI(q[0], q0);
        VOXRTI_STOREI(q[1], q1);
        VOXRTI_STOREI(q[2], q2);
        VOXRTI_STOREI(size, ls);
        _mm256_storeu_pd(at, t0);
        _mm256_storeu_pd(at + 4, t1);
        voxrti_octet_doubt(g, at, size, doubt, q);
        q0 = VOXRTI_LOADI(q[0]);
        q1 = VOXRTI_LOADI(q[1]);
        q2 = VOXRTI_LOADI(q[2]);
    }
    if (cone->on) {
        e0 = _mm256_castsi256_pd(_mm256_unpacklo_epi32(on, on));
        e1 = _mm256_castsi256_pd(_mm256_unpackhi_epi32(on, on));
        _mm256_storeu_pd(g->t, _mm256_blendv_pd(_mm256_loadu_pd(g->t), t0, e0));
        _mm256_storeu_pd(g->t + 4, _mm256_blendv_pd(_mm256_loadu_pd(g->t + 4), t1, e1));
    }
    q0 = VOXRTI_BLENDI(c0, q0, on);
    q1 = VOXRTI_BLENDI(c1, q1, on);
    q2 = VOXRTI_BLENDI(c2, q2, on);
    VOXRTI_STOREI(g->c[0], q0);
    VOXRTI_STOREI(g->c[1], q1);
    VOXRTI_STOREI(g->c[2], q2);
    /* up: the highest bit that has changed, by the exponent of a float, tells the common ancestor */
    x = _mm256_or_si256(_mm256_or_si256(_mm256_xor_si256(c0, q0), _mm256_xor_si256(c1, q1)), _mm256_xor_si256(c2, q2));
    x = _mm256_sub_epi32(_mm256_srli_epi32(_mm256_castps_si256(_mm256_cvtepi32_ps(x)), 23), k->e127);
    w = _mm256_min_epi32(w, _mm256_sub_epi32(k->leaf_w, _mm256_srai_epi32(x, 1)));
    sh = _mm256_slli_epi32(_mm256_sub_epi32(k->leaf_w, w), 1);
    VOXRTI_STOREI(g->w, w);
    /* down, when the cell is filled: it goes to the top, below it are those before it */
    first = voxrti_octet_nodes(g, m);
    x = _mm256_and_si256(_mm256_srlv_epi32(q0, sh), k->three);
    y = _mm256_and_si256(_mm256_srlv_epi32(q1, sh), k->three);
    z = _mm256_and_si256(_mm256_srlv_epi32(q2, sh), k->three);
    slot = _mm256_xor_si256(voxrti_octet_slot(k, x, y, z, flip), k->last_slot);
    m[0] = _mm256_sllv_epi64(m[0], _mm256_unpacklo_epi32(slot, zero));
    m[1] = _mm256_sllv_epi64(m[1], _mm256_unpackhi_epi32(slot, zero));
    y = _mm256_and_si256(VOXRTI_HIGH8(m[0], m[1]), on);
    if (cone->on) { /* where level of detail may accept a cell it has to be looked at first */
        const __m256i bits = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128), all = _mm256_set1_epi32(-1);
        __m256i wide = _mm256_set1_epi32((int)voxrti_octet_wide(cone, g, sh, all, zero));
        y = _mm256_andnot_si256(_mm256_cmpeq_epi32(_mm256_and_si256(wide, bits), bits), y);
    }
    set = _mm256_or_si256(set, _mm256_srai_epi32(y, 31));
    m[0] = voxrti_popcount4(k, _mm256_add_epi64(m[0], m[0]));
    m[1] = voxrti_popcount4(k, _mm256_add_epi64(m[1], m[1]));
    x = _mm256_cmpeq_epi32(w, k->leaf_w);
    first = _mm256_add_epi32(_mm256_andnot_si256(x, first), VOXRTI_LOW8(m[0], m[1])); /* of a leaf: nonsense */
    g->found |= VOXRTI_SIGNS(_mm256_and_si256(set, x));
    go = _mm256_andnot_si256(x, set);
    live = _mm256_or_si256(go, _mm256_andnot_si256(set, on));
    VOXRTI_STOREI(g->alive, live);
    g->live = VOXRTI_SIGNS(live);
    if (stats != NULL) stats->descents += voxrti_popcount64(VOXRTI_SIGNS(go));
    /* addresses of the nodes below */
    x = _mm256_cmpeq_epi32(_mm256_add_epi32(w, k->one), k->leaf_w);
    y = _mm256_add_epi32(_mm256_and_si256(x, k->leaf_less), k->four); /* log2 of a node's bytes */
    m[0] = _mm256_sllv_epi64(_mm256_unpacklo_epi32(first, zero), _mm256_unpacklo_epi32(y, zero));
    m[1] = _mm256_sllv_epi64(_mm256_unpackhi_epi32(first, zero), _mm256_unpackhi_epi32(y, zero));
    m[0] = _mm256_add_epi64(m[0], _mm256_blendv_epi8(k->node, k->leaf, _mm256_unpacklo_epi32(x, x)));
    m[1] = _mm256_add_epi64(m[1], _mm256_blendv_epi8(k->node, k->leaf, _mm256_unpackhi_epi32(x, x)));
    VOXRTI_STOREI(g->child, m[0]);
    VOXRTI_STOREI(g->child + 4, m[1]);
    g->coded = k->coded & VOXRTI_SIGNS(_mm256_and_si256(go, x));
    for (l = 0; l < 8; l++) { /* fetched while the other groups step */
        const uint64_t at = g->child[VOXRTI_PLACE8(l)];
        g->path[l][g->w[l] + 1] = at;
        VOXRTI_PREFETCH((const void *)(uintptr_t)at);
    }
    VOXRTI_STOREI(g->w, _mm256_sub_epi32(w, go));
}

#define VOXRTI_DONE 32

/* A stream of rays: where the next ones come from, where finished ones go to. */
typedef struct voxrti_stream {
    const voxrt_ray *rays;
    voxrt_hit *hits;
    size_t count, next; /* `next` is the first ray that is not prepared */
    uint64_t left;      /* of the run of 64 rays that holds it: bit per ray that is not traced as part of a tile */
    uint32_t first;     /* first ray in `ready` */
    voxrti_beam beam;   /* of this run */
    voxrti_chain chain;
    voxrti_ready ready;
    uint32_t done_count, done_ray[VOXRTI_DONE], done_node[VOXRTI_DONE], done_cell[3][VOXRTI_DONE];
} voxrti_stream;

/* Prepare rays until one waits for a lane; 0: none is left. */
VOXRTI_TARGET_AVX2 static int voxrti_stream_next(const voxrt_tree *t, const voxrti_cone *cone, voxrti_stream *s,
                                                 voxrt_stats *stats) {
    while (s->ready.live == 0 && s->next < s->count) {
        const voxrt_ray *rays = s->rays + s->next;
        voxrt_hit *hits = s->hits + s->next;
        const size_t rest = s->count - s->next;
        const uint32_t n = rest < VOXRTI_READY ? (uint32_t)rest : VOXRTI_READY, at = (uint32_t)(s->next & 63u);
        uint32_t i, rare = 0, left;
        if (at == 0) {
            const uint32_t run = rest < 64 ? (uint32_t)rest : 64u;
            s->left = voxrti_tile_trace(t, cone, rays, run, &s->beam, &s->chain, hits, stats);
            if (s->left == 0) {
                s->next += run;
                continue;
            }
            if (!s->beam.on) voxrti_chain_to(t, rays, &s->chain);
        }
        left = (uint32_t)(s->left >> at) & ((1u << VOXRTI_READY) - 1u);
        s->first = (uint32_t)s->next;
        s->next += n;
        for (i = 0; i < n; i += 4) {
            const voxrt_ray *in = rays + i;
            voxrt_ray tail[4];
            uint32_t bits = 0;
            if ((left >> i & 15u) == 0) continue;
            if (i + 4 > n) {
                memset(tail, 0, sizeof tail); /* direction 0: rare, and not looked at */
                memcpy(tail, in, (n - i) * sizeof *tail);
                in = tail;
            }
            s->ready.live |= voxrti_setup4(t, cone, in, i, &s->beam, &s->chain, &s->ready, &bits) << i;
            rare |= bits << i;
        }
        s->ready.live &= left;
        rare &= left;
        left &= ~(s->ready.live | rare);
        if (stats != NULL) stats->rays += voxrti_popcount64(left | s->ready.live);
        for (; left != 0; left &= left - 1) voxrti_miss(hits + voxrti_ctz64(left));
        for (; rare != 0; rare &= rare - 1) {
            i = voxrti_ctz64(rare);
            voxrti_trace_one(t, cone, NULL, rays + i, hits + i, stats);
        }
    }
    return s->ready.live != 0;
}

/* Write the hits of all but `keep` of the finished rays, in fours. */
VOXRTI_TARGET_AVX2 static void voxrti_stream_hits(const voxrt_tree *t, voxrti_stream *s, uint32_t keep) {
    while (s->done_count > keep) {
        const uint32_t n = s->done_count < 4 ? s->done_count : 4, i = s->done_count - n;
        uint32_t index[4], a;
        __m128i c[3];
        for (a = 0; a < 4; a++) index[a] = s->done_ray[i + (a < n ? a : 0)];
        for (a = 0; a < 3; a++) c[a] = VOXRTI_LOAD4(s->done_cell[a] + i);
        voxrti_hits4(t, s->rays, index, (1u << n) - 1u, c, VOXRTI_LOAD4(s->done_node + i), s->hits);
        s->done_count = i;
    }
}

/* Put the hits of a group aside and take the next prepared rays into its free lanes. */
VOXRTI_TARGET_AVX2 static inline void voxrti_stream_refill(const voxrt_tree *t, const voxrti_cone *cone,
                                                           voxrti_stream *s, voxrti_octet *g, voxrt_stats *stats) {
    const uint32_t last = ((uint32_t)1 << (2 * t->wide)) - 1u;
    uint32_t k, a;
    if (stats != NULL) stats->hits += voxrti_popcount64(g->found);
    for (k = g->used & ~g->live; k != 0; k &= k - 1) {
        const uint32_t lane = voxrti_ctz64(k), at = s->done_count;
        voxrti_miss(&s->hits[g->ray[lane]]);
        for (a = 0; a < 3; a++) s->done_cell[a][at] = g->c[a][lane] ^ ((0u - (g->flip[lane] >> a & 1u)) & last);
        s->done_ray[at] = g->ray[lane];
        s->done_node[at] = (uint32_t)(((uintptr_t)g->path[lane][t->wide - 1] - (uintptr_t)t->leaf) / 8);
        s->done_count = at + (g->found >> lane & 1u); /* or it stays a miss */
    }
    for (k = ~g->live & 255u; k != 0; k &= k - 1) {
        const uint32_t lane = voxrti_ctz64(k), to = VOXRTI_PLACE8(lane);
        uint32_t i;
        if (s->ready.live == 0 && !voxrti_stream_next(t, cone, s, stats)) break;
        i = voxrti_ctz64(s->ready.live);
        s->ready.live &= s->ready.live - 1;
        memcpy(&g->path[lane][1], &s->chain.at[1], sizeof s->chain.at - sizeof s->chain.at[0]);
        for (a = 0; a < 3; a++) {
            g->o[a][to] = s->ready.o[a][i];
            g->d[a][to] = s->ready.d[a][i];
            g->inv[a][to] = s->ready.inv[a][i];
            g->c[a][lane] = s->ready.c[a][i];
            g->turn[a][lane] = s->ready.turn[a][i];
        }
        g->t[to] = s->ready.t[i];
        g->t_end[to] = s->ready.t_end[i];
        g->flip[lane] = s->ready.flip[i];
        g->ray[lane] = s->first + i;
        g->w[lane] = s->ready.w[i];
        g->alive[lane] = 0xffffffffu;
        g->live |= 1u << lane;
    }
    g->found = 0;
    g->used = g->live;
    voxrti_stream_hits(t, s, 3);
}

VOXRTI_TARGET_AVX2 VOXRTI_NOINLINE static void voxrti_stream_trace(const voxrt_tree *t, const voxrti_cone *cone,
                                                                   voxrti_stream *s, voxrt_stats *stats) {
    voxrti_octet group[VOXRTI_OCTETS];
    voxrti_octet_const k;
    uint32_t i, lane, busy;
    if (!voxrti_stream_next(t, cone, s, stats)) return; /* tiles took all */
    memset(group, 0, sizeof group);
    memset(s->done_ray, 0, sizeof s->done_ray); /* four are written at a time, the last ones for nothing */
    memset(s->done_node, 0, sizeof s->done_node);
    memset(s->done_cell, 0, sizeof s->done_cell);
    for (i = 0; i < VOXRTI_OCTETS; i++)
        for (lane = 0; lane < 8; lane++) group[i].path[lane][0] = voxrti_root(t);
    voxrti_octet_open(t, &k);
    do {
        busy = 0;
        for (i = 0; i < VOXRTI_OCTETS; i++) {
            voxrti_octet *g = &group[i];
            if (g->live != 0) voxrti_octet_step(t, cone, &k, g, s->rays, s->hits, stats);
            voxrti_octet_decode(t, &group[i != 0 ? i - 1 : VOXRTI_OCTETS - 1]);
            if (voxrti_popcount64(g->live) <= VOXRTI_OCTET_REFILL) voxrti_stream_refill(t, cone, s, g, stats);
            busy |= g->live;
        }
    } while (busy != 0);
    voxrti_stream_hits(t, s, 0);
}

/* Trace count (< 2^32) rays. cone->floor_ < 4^wide: one cell for all is left to the scalar path. */
VOXRTI_TARGET_AVX2 static void voxrti_trace_avx2(const voxrt_tree *t, const voxrti_cone *cone, const voxrt_ray *rays,
                                                 voxrt_hit *hits, size_t count, voxrt_stats *stats) {
    voxrti_stream s; /* 10 KB: the rest is written before it is read */
    s.rays = rays;
    s.hits = hits;
    s.count = count;
    s.next = 0;
    s.left = 0;
    s.first = s.done_count = 0;
    s.beam.on = s.chain.w = s.ready.live = 0;
    voxrti_stream_trace(t, cone, &s, stats);
}

#endif /* VOXRTI_AVX2 */

/* ---- SSE: rays one by one, some in flight ----
   One ray in the lanes: x and y side by side, z in a second vector. The same events as everywhere. A visit goes over
   an empty cell, up, and down when the next one is filled; its node is fetched while the other rays are visited. Two
   to eight rays in flight are equally fast, four rays with a lane each would need shifts by lane. */

#if VOXRTI_X64

#define VOXRTI_SINGLES 4 /* rays in flight */

typedef struct voxrti_single {
    uint64_t path[VOXRTI_MAX_WIDE + 1]; /* addresses of the nodes from the root to level w */
    uint32_t c[4], w, ray;              /* c: the cell, mirrored, and 0 */
    voxrti_rayx r;
} voxrti_single;

/* Slot of the cells c (0..3 of each axis) in nodes whose cells have edge 2^sh */
#define VOXRTI_SLOT1(c, sh) \
    (((uint32_t)_mm_movemask_ps(_mm_castsi128_ps(_mm_sll_epi32(c, _mm_cvtsi32_si128((int)(31 - (sh))))))) | \
     ((uint32_t)_mm_movemask_ps(_mm_castsi128_ps(_mm_sll_epi32(c, _mm_cvtsi32_si128((int)(30 - (sh))))))) << 3)
#define VOXRTI_ODD4(a, b) _mm_castps_si128(_mm_shuffle_ps(_mm_castpd_ps(a), _mm_castpd_ps(b), 0xdd))
#define VOXRTI_EVEN4(a, b) _mm_castps_si128(_mm_shuffle_ps(_mm_castpd_ps(a), _mm_castpd_ps(b), 0x88))

/* By the axes whose event is the next: a mask of the first of them. */
static const uint32_t voxrti_first_axis[8][4] = {
    {0, 0, 0, 0}, {~0u, 0, 0, 0}, {0, ~0u, 0, 0}, {~0u, 0, 0, 0}, {0, 0, ~0u, 0}, {~0u, 0, 0, 0}, {0, ~0u, 0, 0},
    {~0u, 0, 0, 0}};

/* Cells of a node that a ray can still reach, by axis, 1 for a mirrored one, and the cell in which it stands (mirrored;
   bits 0 and 3 of a slot). */
static const uint64_t voxrti_reach[3][2][10] = {
    {{~(uint64_t)0, 0xffaaffaaffaaffaau, 0, 0, 0, 0, 0, 0, 0xff00ff00ff00ff00u, 0xaa00aa00aa00aa00u},
     {~(uint64_t)0, 0x55ff55ff55ff55ffu, 0, 0, 0, 0, 0, 0, 0x00ff00ff00ff00ffu, 0x0055005500550055u}},
    {{~(uint64_t)0, 0xffffccccffffccccu, 0, 0, 0, 0, 0, 0, 0xffff0000ffff0000u, 0xcccc0000cccc0000u},
     {~(uint64_t)0, 0x3333ffff3333ffffu, 0, 0, 0, 0, 0, 0, 0x0000ffff0000ffffu, 0x0000333300003333u}},
    {{~(uint64_t)0, 0xfffffffff0f0f0f0u, 0, 0, 0, 0, 0, 0, 0xffffffff00000000u, 0xf0f0f0f000000000u},
     {~(uint64_t)0, 0x0f0f0f0fffffffffu, 0, 0, 0, 0, 0, 0, 0x00000000ffffffffu, 0x000000000f0f0f0fu}}};

/* Within 2^-16 of an event of another axis: decide exactly. q: cells after the event k at time. */
VOXRTI_TARGET_SSE4 static VOXRTI_NOINLINE __m128i voxrti_single_doubt(const voxrti_single *s, double time, uint32_t k,
                                                                      uint32_t low, __m128i q) {
    uint32_t c[4], a;
    _mm_storeu_si128((__m128i *)(void *)c, q);
    for (a = 0; a < 3; a++)
        if (a != k) c[a] = voxrti_cell_at(&s->r, a, time, k, s->c[a], s->c[a] | low);
    return _mm_loadu_si128((const __m128i *)(const void *)c);
}

/* One visit. 0: the ray goes on; 1: it stands on a voxel; 2: a miss. */
VOXRTI_TARGET_SSE4 VOXRTI_INLINE uint32_t voxrti_single_visit(const voxrt_tree *t, voxrti_single *s,
                                                              voxrt_stats *stats) {
    const __m128i c = _mm_loadu_si128((const __m128i *)(const void *)s->c), xyz = _mm_setr_epi32(-1, -1, -1, 0);
    const __m128d oxy = _mm_loadu_pd(s->r.o), oz = _mm_load1_pd(s->r.o + 2), bias = _mm_set1_pd(1048576.0);
    const uint32_t leaf_w = t->wide - 1, flip = s->r.flip;
    uint32_t w = s->w, sh = 2 * (leaf_w - w), at = VOXRTI_SLOT1(c, sh), slot = at ^ flip, set, ls, k, x;
    uint32_t first;
    const uint64_t *node = (const uint64_t *)(uintptr_t)s->path[w];
    uint64_t mask = *node, ahead = mask;
    __m128i over, step, q;
    __m128d exy, ez, time, pxy, pz;
    uintptr_t below;
    set = (uint32_t)(mask >> slot) & 1u;
    ahead &= voxrti_reach[0][flip & 1u][at & 9u] & voxrti_reach[1][flip >> 1 & 1u][at >> 1 & 9u] &
             voxrti_reach[2][flip >> 2 & 1u][at >> 2 & 9u];
    ls = sh + ((ahead >> (slot & 56u) & 255u) == 0) + (ahead == 0);
    q = c;
    if (!set) {
        /* over: the first event of the three far faces of what is empty */
        over = _mm_add_epi32(_mm_or_si128(c, _mm_set1_epi32((int)((1u << ls) - 1u))), _mm_set1_epi32(1));
        exy = _mm_mul_pd(_mm_sub_pd(_mm_cvtepi32_pd(over), oxy), _mm_loadu_pd(s->r.inv));
        ez = _mm_mul_pd(_mm_sub_pd(_mm_cvtepi32_pd(_mm_shuffle_epi32(over, 0xaa)), oz), _mm_load1_pd(s->r.inv + 2));
        time = _mm_min_pd(_mm_min_pd(exy, _mm_shuffle_pd(exy, exy, 1)), ez);
        k = (uint32_t)_mm_movemask_pd(_mm_cmpeq_pd(exy, time));
        k |= ((uint32_t)_mm_movemask_pd(_mm_cmpeq_pd(ez, time)) & 1u) << 2;
        if (stats != NULL) stats->steps++;
        if (!_mm_comilt_sd(time, _mm_load_sd(&s->r.t_end))) return 2;
        step = _mm_loadu_si128((const __m128i *)(const void *)voxrti_first_axis[k]);
        pxy = _mm_add_pd(_mm_add_pd(oxy, _mm_mul_pd(time, _mm_loadu_pd(s->r.d))), bias);
        pz = _mm_add_pd(_mm_add_pd(oz, _mm_mul_pd(time, _mm_load1_pd(s->r.d + 2))), bias);
        q = _mm_or_si128(_mm_add_epi32(VOXRTI_EVEN4(pxy, pz), _mm_set1_epi32(65536)), step);
        q = _mm_cmpeq_epi32(_mm_srli_epi32(q, 17), _mm_setzero_si128());
        x = (uint32_t)_mm_movemask_ps(_mm_castsi128_ps(q)) & 7u;
        q = _mm_sub_epi32(VOXRTI_ODD4(pxy, pz), _mm_set1_epi32(0x41300000)); /* see voxrti_octet_cells */
        q = _mm_and_si128(_mm_blendv_epi8(q, over, step), xyz);
        if (VOXRTI_UNLIKELY(x != 0))
            q = voxrti_single_doubt(s, _mm_cvtsd_f64(time), voxrti_ctz64(k), (1u << ls) - 1u, q);
        _mm_storeu_si128((__m128i *)(void *)s->c, q);
        /* up: the highest bit that has changed tells the common ancestor */
        step = _mm_xor_si128(c, q);
        step = _mm_or_si128(step, _mm_shuffle_epi32(step, 0x4e));
        step = _mm_or_si128(step, _mm_shuffle_epi32(step, 0xb1));
        x = leaf_w - (31u - voxrti_clz32((uint32_t)_mm_cvtsi128_si32(step) | 1u)) / 2;
        w = x < w ? x : w;
    }
    /* down, when the cell is filled */
    sh = 2 * (leaf_w - w);
    slot = VOXRTI_SLOT1(q, sh) ^ flip;
    node = (const uint64_t *)(uintptr_t)s->path[w];
    mask = *node;
    set = (uint32_t)(mask >> slot) & 1u;
    if (w == leaf_w) {
        s->w = w;
        return set;
    }
    if (stats != NULL) stats->descents += set;
    first = (uint32_t)(node[1] & 0xffffffffu) + (uint32_t)_mm_popcnt_u64(mask & (((uint64_t)1 << slot) - 1u));
    if (w + 1 == leaf_w && set) first = voxrti_leaf_at(t, first);
    below = w + 1 == leaf_w ? (uintptr_t)t->leaf + 8 * (uintptr_t)first : (uintptr_t)t->node + 16 * (uintptr_t)first;
    below = set ? below : (uintptr_t)node;
    VOXRTI_PREFETCH((const void *)below);
    s->path[w + 1] = below;
    s->w = w + set;
    return 0;
}

/* Rays one after the other, as long as there are any. */
typedef struct voxrti_single_stream {
    const voxrt_ray *rays;
    voxrt_hit *hits;
    size_t count, next;
    voxrti_beam beam; /* of this run of 64 rays */
    voxrti_chain chain;
} voxrti_single_stream;

/* Take the next ray that enters the box. 0: there is none. */
static VOXRTI_NOINLINE int voxrti_single_next(const voxrt_tree *t, const voxrti_cone *cone, voxrti_single_stream *in,
                                              voxrti_single *s, voxrt_stats *stats) {
    while (in->next < in->count) {
        const size_t at = in->next++;
        uint32_t a, w, x = 0;
        int ok;
        if ((at & 63u) == 0) {
            const uint32_t run = in->count - at < 64 ? (uint32_t)(in->count - at) : 64u;
            voxrti_beam_find(t, cone, in->rays + at, run, &in->beam);
            in->chain.w = 0;
            if (!in->beam.on) voxrti_chain_to(t, in->rays + at, &in->chain);
            else if (in->beam.z < VOXRTI_INF) voxrti_beam_chain(t, cone, &in->beam, &in->chain);
        }
        ok = voxrti_ray_setup(t, cone, &in->rays[at], &in->beam, &s->r);
        if (stats != NULL) {
            stats->rays++;
            stats->bad_rays += ok < 0;
        }
        if (ok <= 0) {
            voxrti_miss(&in->hits[at]);
            continue;
        }
        s->ray = (uint32_t)at;
        s->c[3] = 0;
        for (a = 0; a < 3; a++) {
            s->c[a] = s->r.c[a];
            w = (s->r.flip >> a & 1u) ? ((uint32_t)1 << 2 * t->wide) - 1u : 0;
            x |= s->c[a] ^ w ^ in->chain.cell[a];
        }
        s->path[0] = voxrti_root(t);
        s->w = 0;
        if (in->chain.w != 0) { /* start at the deepest node of the chain that holds the first cell */
            w = t->wide - 1 - (31u - voxrti_clz32(x | 1u)) / 2;
            s->w = w < in->chain.w ? w : in->chain.w;
            for (w = 1; w <= s->w; w++) s->path[w] = in->chain.at[w];
        }
        return 1;
    }
    return 0;
}

/* Trace count (< 2^32) rays without level of detail (with it the scalar path is 1.2 times as fast). */
VOXRTI_TARGET_SSE4 static void voxrti_trace_sse(const voxrt_tree *t, const voxrti_cone *cone, const voxrt_ray *rays,
                                                voxrt_hit *hits, size_t count, voxrt_stats *stats) {
    voxrti_single single[VOXRTI_SINGLES];
    voxrti_single_stream in;
    uint32_t i, n = 0;
    memset(&in, 0, sizeof in);
    in.rays = rays;
    in.hits = hits;
    in.count = count;
    while (n < VOXRTI_SINGLES && voxrti_single_next(t, cone, &in, &single[n], stats)) n++;
    while (n != 0)
        for (i = 0; i < n; i++) {
            voxrti_single *s = &single[i];
            const uint32_t what = voxrti_single_visit(t, s, stats);
            if (VOXRTI_LIKELY(what == 0)) continue;
            if (what == 1) {
                const uint32_t node = (uint32_t)(((uintptr_t)s->path[s->w] - (uintptr_t)t->leaf) / 8);
                voxrti_hit_fill(t, &s->r, s->c, 0, node, voxrti_slot_of(s->c, 0) ^ s->r.flip, &hits[s->ray]);
            } else {
                voxrti_miss(&hits[s->ray]);
            }
            if (stats != NULL) stats->hits += what == 1;
            if (!voxrti_single_next(t, cone, &in, s, stats)) *s = single[--n];
        }
}

#endif /* VOXRTI_X64 */
/* ---------------------------------------------------------------------------
   trace_octree: rays through the thesis' octree.                                // >>trace_octree

   Thesis 3.5: locate the ray's point in the tree, from the start grid down to a leaf; if the leaf is filled it is the
   hit, else the point where the ray leaves it is the next one, pushed by a small offset into the next leaf. Single
   rays, or packets of four in SSE registers, with masks instead of branches. Coordinates are leaf edges. The cell of
   a point is found once, by cutting off its fraction; its bits are the way down, which gives the same boxes as the
   thesis' comparisons with the middles, without a chain of additions. A box is the cell and a mask of its low bits.
   Settings that the thesis leaves open, chosen so that no ray is ever stuck and few meet a wrong voxel (measured with
   the offset sweep of the tests):
   - the direction is scaled by a power of two so that its largest component is in [1, 2); components below 1e-20 of
     that become +-1e-20; the origin moves to the entry into the box, in double precision, once per ray;
   - points lie 2^-24 R behind the face on each axis, R the edge of the grid: about the rounding error of a point. A ray
     that does not get on (its point still lies before the face) goes further, twice as far each time, until it does.
     Half as much costs 40 % more points, twice as much doubles the wrong voxels: 1 in 10^4 rays at R = 512, 5 at 4096,
     10 at 8192;
   - the ray ends when its exit is not before its end; points a little outside count as the nearest cell;
   - at most 6 R points, as a last resort.
   --------------------------------------------------------------------------- */

#define VOXRTI_OCTREE_OFFSET (1.0f / 16777216.0f) /* of the grid's edge */

/* What does not change between the rays of a call. */
typedef struct voxrti_octrace {
    const voxrt_octree *t;
    const uint32_t *grid;      /* start grid in use, or NULL */
    uint32_t grid_log;         /* 2^grid_log cells along an axis */
    uint32_t leaf_log;         /* log2 of the edge of the voxels that count as leaves */
    float full;                /* edge of the root */
    float offset;
    uint32_t fixed;            /* the offset does not grow */
    uint32_t max_outer;
    double scale;              /* cells per world unit */
} voxrti_octrace;

typedef struct voxrti_octray {
    float o[3], d[3], inv[3]; /* origin at the box, direction, its inverse */
    float end;                /* the ray leaves the box, or t_max */
    uint32_t inside;          /* starts at t_min, not at a face of the box */
    double base, unit;        /* t = (base + lambda) * unit */
} voxrti_octray;

/* 1: crosses the box; 0: misses it; -1: not a usable ray. */
static VOXRTI_UNUSED int voxrti_octray_setup(const voxrti_octrace *c, const voxrt_ray *ray, voxrti_octray *r) {
    double full = (double)c->full, o[3], in = -VOXRTI_INF, out = VOXRTI_INF, start, stop;
    float m = 0, s;
    uint32_t a, bits;
    for (a = 0; a < 3; a++) {
        if (!voxrti_finite_f(ray->org[a]) || !voxrti_finite_f(ray->dir[a])) return -1;
        m = voxrti_absf(ray->dir[a]) > m ? voxrti_absf(ray->dir[a]) : m;
    }
    if (!(m > 0) || !(ray->t_min <= ray->t_max)) return -1;
    memcpy(&bits, &m, sizeof bits);
    bits = 0x7f000000u - (bits & 0x7f800000u); /* 2^-exponent; 2^127 if denormal */
    if (bits == 0) bits = 0x00400000u;         /* 2^-127 */
    memcpy(&s, &bits, sizeof s);
    for (a = 0; a < 3; a++) {
        double d, t0, t1;
        float x = ray->dir[a] * s;
        if (voxrti_absf(x) < 1e-20f) {
            uint32_t sign;
            memcpy(&sign, &ray->dir[a], sizeof sign);
            x = sign >> 31 ? -1e-20f : 1e-20f;
        }
        o[a] = ((double)ray->org[a] - c->t->origin[a]) * c->scale;
        r->d[a] = x;
        r->inv[a] = 1.0f / x;
        d = 1.0 / (double)x;
        t0 = (0.0 - o[a]) * d;
        t1 = (full - o[a]) * d;
        in = voxrti_max(in, x < 0 ? t1 : t0);
        out = voxrti_min(out, x < 0 ? t0 : t1);
    }
    r->unit = c->t->voxel_size * (double)s;
    start = (double)ray->t_min / r->unit;
    stop = (double)ray->t_max / r->unit;
    r->inside = start > in;
    start = voxrti_max(in, start);
    if (!(start < voxrti_min(out, stop))) return 0;
    r->base = start;
    r->end = (float)(stop - start);
    for (a = 0; a < 3; a++) {
        float leave;
        r->o[a] = (float)voxrti_min(voxrti_max(o[a] + start * (double)r->d[a], 0.0), full);
        leave = ((r->d[a] < 0 ? 0.0f : c->full) - r->o[a]) * r->inv[a];
        r->end = leave < r->end ? leave : r->end;
    }
    return 0.0f < r->end;
}

static void voxrti_octray_miss(voxrt_hit *hit) {
    memset(hit, 0, sizeof *hit);
    hit->t = INFINITY;
    hit->node = VOXRT_NO_NODE;
}

/* The hit record; a hit that rounds to t_max is none. voxel: VOXRT_NO_NODE if only the grid was asked. */
static int voxrti_octray_hit(const voxrti_octrace *c, const voxrti_octray *r, const voxrt_ray *ray, float lambda,
                             uint32_t voxel, const uint32_t cell[3], uint32_t mask, voxrt_hit *hit) {
    uint32_t a, ls = 0, face = 6, l;
    float first = 0;
    hit->t = (float)((r->base + (double)lambda) * r->unit);
    if (!(hit->t < ray->t_max)) {
        voxrti_octray_miss(hit);
        return 0;
    }
    while (mask >> ls != 0) ls++;
    for (a = 0; a < 3; a++) {
        uint32_t lo = cell[a] & ~mask;
        float t = ((float)(r->d[a] < 0 ? lo + mask + 1u : lo) - r->o[a]) * r->inv[a];
        hit->cell[a] = cell[a] >> ls;
        if (lambda == 0 && r->inside) continue;
        if (face == 6 || t > first) {
            first = t;
            face = 2 * a + (r->d[a] < 0);
        }
    }
    hit->level = (uint8_t)(c->t->depth - ls);
    if (voxel == VOXRT_NO_NODE)
        for (voxel = 0, l = hit->level; l-- > 0;)
            voxel = 8 * c->t->voxel[voxel].children + voxrti_child(hit->cell[0], hit->cell[1], hit->cell[2], l);
    hit->node = voxel;
    hit->slot = 0;
    hit->face = (uint8_t)face;
    hit->_reserved = 0;
    return 1;
}

/* A point that has to go further, and not out of the box. */
VOXRTI_INLINE float voxrti_octray_boost(float p, float d, float boost, float full) {
    p = d < 0 ? p - boost : p + boost;
    return p < 0.0f ? 0.0f : p > full ? full : p;
}

/* ---- one ray (thesis listing 5, corrected) ---- */

static VOXRTI_UNUSED void voxrti_octrace_one(const voxrti_octrace *c, const voxrt_ray *ray, voxrt_hit *hit,
                                             voxrt_octree_stats *stats) {
    const voxrti_voxel *voxels = c->t->voxel;
    voxrti_octray r;
    float lambda = 0, boost = 0, o[3]; /* o: origin and offset */
    uint32_t a, last = (uint32_t)c->full - 1u, left = c->max_outer, inner = 0, top = c->t->depth - c->grid_log;
    int ok = voxrti_octray_setup(c, ray, &r), found = 0, stuck = 0;
    voxrti_octray_miss(hit);
    stats->rays++;
    stats->bad_rays += ok < 0;
    if (ok <= 0) return;
    for (a = 0; a < 3; a++) o[a] = r.o[a] + (r.d[a] < 0 ? -c->offset : c->offset);
    while (left != 0) {
        uint32_t cell[3], vi = 0, children, filled, s = top, mask = (1u << top) - 1u;
        float leave = 0;
        left--;
        for (a = 0; a < 3; a++) {
            float p = o[a] + lambda * r.d[a];
            uint32_t i;
            if (boost > 0) p = voxrti_octray_boost(p, r.d[a], boost, c->full);
            i = (uint32_t)(int32_t)p; /* (-1, 0) gives 0 */
            cell[a] = i < last ? i : last;
        }
        if (c->grid != NULL) {
            uint32_t g = c->grid[(size_t)((cell[2] >> s) << c->grid_log | cell[1] >> s) << c->grid_log | cell[0] >> s];
            children = g >> 1;
            filled = 0;
            vi = VOXRT_NO_NODE;
            if ((g & 1u) == 0) {
                children = 0;
                filled = g & 2u;
                mask = g >> 2;
            }
        } else {
            children = voxels[0].children;
            filled = voxels[0].index;
        }
        while (children != 0 && s > c->leaf_log) {
            s--;
            vi = children * 8 + voxrti_child(cell[0], cell[1], cell[2], s);
            children = voxels[vi].children;
            filled = voxels[vi].index;
            mask = (1u << s) - 1u;
            inner++;
        }
        if (filled != 0) {
            found = voxrti_octray_hit(c, &r, ray, lambda, vi, cell, mask, hit);
            break;
        }
        for (a = 0; a < 3; a++) {
            uint32_t lo = cell[a] & ~mask;
            float t = ((float)(int32_t)(r.d[a] < 0 ? lo : lo + mask + 1u) - r.o[a]) * r.inv[a];
            leave = a == 0 || t < leave ? t : leave;
        }
        if (leave > lambda) {
            lambda = leave;
            boost = 0;
            if (!(lambda < r.end)) break;
        } else {
            stuck = left == 0 || c->fixed;
            if (stuck) break;
            boost = boost > 0 ? boost + boost : c->offset;
        }
    }
    stats->hits += (uint64_t)found;
    stats->outer += c->max_outer - left;
    if (c->grid != NULL) stats->grid += c->max_outer - left;
    stats->inner += inner;
    stats->stuck += (uint64_t)stuck;
}

/* ---- packets of four (thesis listing 4, corrected) ---- */

#if VOXRTI_X64

typedef struct voxrti_octpacket {
    float o[3][4], d[3][4], inv[3][4], end[4];
    double base[4], unit[4];
    uint32_t inside; /* a bit for each lane */
} voxrti_octpacket;

/* Two lanes of the setup in double precision; h = 0 or 2. Returns a bit for each lane that meets the box. */
VOXRTI_TARGET_SSE4 static uint32_t voxrti_octpacket_enter(const voxrti_octrace *c, voxrti_octpacket *p, uint32_t h,
                                                          const __m128 org[3], const __m128 dir[3], __m128 t_min,
                                                          __m128 t_max, __m128 s) {
    const __m128d full = _mm_set1_pd((double)c->full), zero = _mm_setzero_pd();
    __m128d o[3], in = _mm_set1_pd(-VOXRTI_INF), out = _mm_set1_pd(VOXRTI_INF), unit, start, stop;
    uint32_t a, alive;
    for (a = 0; a < 3; a++) {
        __m128d x = _mm_cvtps_pd(dir[a]), d = _mm_div_pd(_mm_set1_pd(1.0), x), t0, t1;
        o[a] = _mm_mul_pd(_mm_sub_pd(_mm_cvtps_pd(org[a]), _mm_set1_pd(c->t->origin[a])), _mm_set1_pd(c->scale));
        t0 = _mm_mul_pd(_mm_sub_pd(zero, o[a]), d);
        t1 = _mm_mul_pd(_mm_sub_pd(full, o[a]), d);
        in = _mm_max_pd(in, _mm_blendv_pd(t0, t1, x));
        out = _mm_min_pd(out, _mm_blendv_pd(t1, t0, x));
    }
    unit = _mm_mul_pd(_mm_set1_pd(c->t->voxel_size), _mm_cvtps_pd(s));
    start = _mm_div_pd(_mm_cvtps_pd(t_min), unit);
    stop = _mm_div_pd(_mm_cvtps_pd(t_max), unit);
    p->inside |= (uint32_t)_mm_movemask_pd(_mm_cmpgt_pd(start, in)) << h;
    start = _mm_max_pd(in, start);
    alive = (uint32_t)_mm_movemask_pd(_mm_cmplt_pd(start, _mm_min_pd(out, stop)));
    _mm_storeu_pd(p->base + h, start);
    _mm_storeu_pd(p->unit + h, unit);
    _mm_storel_pi((__m64 *)(void *)(p->end + h), _mm_cvtpd_ps(_mm_sub_pd(stop, start)));
    for (a = 0; a < 3; a++) {
        __m128d q = _mm_add_pd(o[a], _mm_mul_pd(start, _mm_cvtps_pd(dir[a])));
        _mm_storel_pi((__m64 *)(void *)(p->o[a] + h), _mm_cvtpd_ps(_mm_min_pd(_mm_max_pd(q, zero), full)));
    }
    return alive << h;
}

/* voxrti_octray_setup of four rays: the lanes to trace; *bad: those that are not usable. */
VOXRTI_TARGET_SSE4 static uint32_t voxrti_octpacket_setup(const voxrti_octrace *c, const voxrt_ray *rays, uint32_t n,
                                                          voxrti_octpacket *p, uint32_t *bad) {
    __m128 org[4], dir[4], high[3], high_dir[3], m = _mm_setzero_ps(), ok, s, end, test = _mm_setzero_ps();
    const __m128 zero = _mm_setzero_ps(), sign = _mm_set1_ps(-0.0f), full = _mm_set1_ps(c->full);
    uint32_t a, k, usable, alive;
    __m128i bits;
    for (k = 0; k < 4; k++) { /* a short packet repeats its last ray */
        const voxrt_ray *ray = &rays[k < n ? k : n - 1];
        org[k] = _mm_loadu_ps(ray->org);
        dir[k] = _mm_loadu_ps(ray->dir);
    }
    _MM_TRANSPOSE4_PS(org[0], org[1], org[2], org[3]);
    _MM_TRANSPOSE4_PS(dir[0], dir[1], dir[2], dir[3]);
    for (a = 0; a < 3; a++) {
        test = _mm_add_ps(test, _mm_add_ps(_mm_sub_ps(org[a], org[a]), _mm_sub_ps(dir[a], dir[a]))); /* 0 or NaN */
        m = _mm_max_ps(_mm_andnot_ps(sign, dir[a]), m);
    }
    ok = _mm_and_ps(_mm_and_ps(_mm_cmpeq_ps(test, zero), _mm_cmpgt_ps(m, zero)), _mm_cmple_ps(org[3], dir[3]));
    usable = (uint32_t)_mm_movemask_ps(ok) & ((1u << n) - 1u);
    *bad = ~usable & ((1u << n) - 1u);
    p->inside = 0;
    if (usable == 0) return 0;
    bits = _mm_sub_epi32(_mm_set1_epi32(0x7f000000), _mm_and_si128(_mm_castps_si128(m), _mm_set1_epi32(0x7f800000)));
    bits = _mm_or_si128(bits, _mm_and_si128(_mm_cmpeq_epi32(bits, _mm_setzero_si128()), _mm_set1_epi32(0x00400000)));
    s = _mm_castsi128_ps(bits);
    for (a = 0; a < 3; a++) {
        __m128 x = _mm_mul_ps(dir[a], s), tiny = _mm_cmplt_ps(_mm_andnot_ps(sign, x), _mm_set1_ps(1e-20f));
        x = _mm_blendv_ps(x, _mm_or_ps(_mm_and_ps(dir[a], sign), _mm_set1_ps(1e-20f)), tiny);
        x = _mm_blendv_ps(_mm_set1_ps(1.0f), x, ok); /* no NaN in lanes that are not used */
        org[a] = _mm_and_ps(org[a], ok);
        dir[a] = x;
        _mm_storeu_ps(p->d[a], x);
        _mm_storeu_ps(p->inv[a], _mm_div_ps(_mm_set1_ps(1.0f), x));
        high[a] = _mm_movehl_ps(org[a], org[a]);
        high_dir[a] = _mm_movehl_ps(x, x);
    }
    alive = voxrti_octpacket_enter(c, p, 0, org, dir, org[3], dir[3], s);
    alive |= voxrti_octpacket_enter(c, p, 2, high, high_dir, _mm_movehl_ps(org[3], org[3]),
                                    _mm_movehl_ps(dir[3], dir[3]), _mm_movehl_ps(s, s));
    alive &= usable;
    if (alive == 0) return 0;
    end = _mm_loadu_ps(p->end);
    for (a = 0; a < 3; a++) {
        __m128 face = _mm_andnot_ps(_mm_cmplt_ps(dir[a], zero), full);
        end = _mm_min_ps(_mm_mul_ps(_mm_sub_ps(face, _mm_loadu_ps(p->o[a])), _mm_loadu_ps(p->inv[a])), end);
    }
    _mm_storeu_ps(p->end, end);
    return alive & (uint32_t)_mm_movemask_ps(_mm_cmpgt_ps(end, zero));
}

/* What the lanes that hit something, or do not get on, are dealt with one by one from. */
typedef struct voxrti_octlanes {
    uint32_t cell[3][4], mask[4], voxel[4];
    float lambda[4], boost[4], point[3][4];
} voxrti_octlanes;

/* Fill the records of lanes `m`; how many hits that are. */
static uint32_t voxrti_octpacket_hits(const voxrti_octrace *c, const voxrti_octpacket *p, uint32_t m,
                                      const voxrti_octlanes *l, const voxrt_ray *rays, voxrt_hit *hits) {
    uint32_t n = 0;
    for (; m != 0; m &= m - 1) {
        voxrti_octray r;
        uint32_t a, cell[3], k = voxrti_ctz64(m);
        for (a = 0; a < 3; a++) {
            r.o[a] = p->o[a][k];
            r.d[a] = p->d[a][k];
            r.inv[a] = p->inv[a][k];
            cell[a] = l->cell[a][k];
        }
        r.end = p->end[k];
        r.inside = p->inside >> k & 1u;
        r.base = p->base[k];
        r.unit = p->unit[k];
        n += (uint32_t)voxrti_octray_hit(c, &r, &rays[k], l->lambda[k], l->voxel[k], cell, l->mask[k], &hits[k]);
    }
    return n;
}

/* Push the points of lanes `m` further. again: the last points were pushed too. */
static void voxrti_octpacket_boost(const voxrti_octrace *c, const voxrti_octpacket *p, uint32_t m, int again,
                                   voxrti_octlanes *l) {
    uint32_t k, a;
    for (k = 0; k < 4; k++) {
        if ((m >> k & 1u) == 0 || !again) l->boost[k] = 0;
        if ((m >> k & 1u) == 0) continue;
        l->boost[k] = l->boost[k] > 0 ? l->boost[k] + l->boost[k] : c->offset;
        for (a = 0; a < 3; a++) l->point[a][k] = voxrti_octray_boost(l->point[a][k], p->d[a][k], l->boost[k], c->full);
    }
}

#define voxrti_count4(m) ((uint32_t)(0x4332322132212110u >> 4 * (uint32_t)(m)) & 7u) /* bits set in 4 */
#define voxrti_lanes(v) ((uint32_t)_mm_movemask_ps(_mm_castsi128_ps(v)))
#define voxrti_voxel_load(i) _mm_loadl_epi64((const __m128i *)(const void *)&voxels[(uint32_t)(i)])
#define voxrti_lane_store(p, v) _mm_storeu_si128((__m128i *)(void *)(p), v)

/* One level down: child number w of each lane, two 32-bit words of the four voxels. */
#define voxrti_voxel_load4(w, words, children) do { \
    __m128i v01_ = voxrti_voxel_load(_mm_cvtsi128_si32(w)), v23_ = voxrti_voxel_load(_mm_extract_epi32(w, 2)); \
    v01_ = _mm_unpacklo_epi64(v01_, voxrti_voxel_load(_mm_extract_epi32(w, 1))); \
    v23_ = _mm_unpacklo_epi64(v23_, voxrti_voxel_load(_mm_extract_epi32(w, 3))); \
    words = _mm_castps_si128(_mm_shuffle_ps(_mm_castsi128_ps(v01_), _mm_castsi128_ps(v23_), 0x88)); \
    children = _mm_castps_si128(_mm_shuffle_ps(_mm_castsi128_ps(v01_), _mm_castsi128_ps(v23_), 0xdd)); \
} while (0)

/* Start grid entries of four cells. */
VOXRTI_TARGET_SSE4 VOXRTI_INLINE __m128i voxrti_grid_load4(const voxrti_octrace *c, __m128i x, __m128i y, __m128i z) {
    const __m128i shift = _mm_cvtsi32_si128((int)(c->t->depth - c->grid_log));
    const __m128i row = _mm_cvtsi32_si128((int)c->grid_log);
    const uint32_t *grid = c->grid;
    __m128i g = _mm_or_si128(_mm_sll_epi32(_mm_srl_epi32(z, shift), row), _mm_srl_epi32(y, shift));
    g = _mm_or_si128(_mm_sll_epi32(g, row), _mm_srl_epi32(x, shift));
    return _mm_setr_epi32((int)grid[(uint32_t)_mm_cvtsi128_si32(g)], (int)grid[(uint32_t)_mm_extract_epi32(g, 1)],
                          (int)grid[(uint32_t)_mm_extract_epi32(g, 2)], (int)grid[(uint32_t)_mm_extract_epi32(g, 3)]);
}

/* Where a ray leaves the box of cell j, on one axis. */
VOXRTI_TARGET_SSE4 VOXRTI_INLINE __m128 voxrti_exit4(__m128i j, __m128i mask, __m128i edge, __m128i pos, __m128 o,
                                                     __m128 inv) {
    __m128 face = _mm_cvtepi32_ps(_mm_add_epi32(_mm_andnot_si128(mask, j), _mm_and_si128(edge, pos)));
    return _mm_mul_ps(_mm_sub_ps(face, o), inv);
}

/* Lanes that are through go on computing the same point, so that they touch no new memory. `counted` is a constant. */
VOXRTI_TARGET_SSE4 VOXRTI_INLINE void voxrti_octrace_four(const voxrti_octrace *c, const voxrt_ray *rays,
                                                          voxrt_hit *hits, uint32_t n, voxrt_octree_stats *stats,
                                                          int counted) {
    const voxrti_voxel *voxels = c->t->voxel;
    voxrti_octpacket r;
    voxrti_octlanes l;
    uint32_t k, alive, bad, left = c->max_outer, top = c->t->depth - c->grid_log, outer = 0, inner = 0;
    __m128 lambda = _mm_setzero_ps(), sign = _mm_set1_ps(-0.0f), offset = _mm_set1_ps(c->offset);
    __m128 end, ox, oy, oz, dx, dy, dz, ix, iy, iz, qx, qy, qz, px, py, pz; /* q: origin and offset; p: point */
    __m128i trace, posx, posy, posz;
    const __m128i zero = _mm_setzero_si128(), one = _mm_set1_epi32(1), two = _mm_set1_epi32(2);
    const __m128i last = _mm_set1_epi32((int)c->full - 1), start_mask = _mm_set1_epi32((int)((1u << top) - 1u));
    int again = 0;
    alive = voxrti_octpacket_setup(c, rays, n, &r, &bad);
    for (k = 0; k < n; k++) voxrti_octray_miss(&hits[k]);
    if (counted) {
        stats->rays += n;
        stats->bad_rays += voxrti_count4(bad);
    }
    if (alive == 0) return;
    trace = _mm_cmpgt_epi32(_mm_and_si128(_mm_set1_epi32((int)alive), _mm_setr_epi32(1, 2, 4, 8)), zero);
    ox = _mm_loadu_ps(r.o[0]); oy = _mm_loadu_ps(r.o[1]); oz = _mm_loadu_ps(r.o[2]);
    dx = _mm_loadu_ps(r.d[0]); dy = _mm_loadu_ps(r.d[1]); dz = _mm_loadu_ps(r.d[2]);
    ix = _mm_loadu_ps(r.inv[0]); iy = _mm_loadu_ps(r.inv[1]); iz = _mm_loadu_ps(r.inv[2]);
    end = _mm_loadu_ps(r.end);
    px = qx = _mm_add_ps(ox, _mm_or_ps(_mm_and_ps(dx, sign), offset));
    py = qy = _mm_add_ps(oy, _mm_or_ps(_mm_and_ps(dy, sign), offset));
    pz = qz = _mm_add_ps(oz, _mm_or_ps(_mm_and_ps(dz, sign), offset));
    posx = _mm_castps_si128(_mm_cmpgt_ps(dx, _mm_setzero_ps()));
    posy = _mm_castps_si128(_mm_cmpgt_ps(dy, _mm_setzero_ps()));
    posz = _mm_castps_si128(_mm_cmpgt_ps(dz, _mm_setzero_ps()));
    for (;;) {
        __m128i jx = _mm_min_epu32(_mm_cvttps_epi32(px), last), jy = _mm_min_epu32(_mm_cvttps_epi32(py), last);
        __m128i jz = _mm_min_epu32(_mm_cvttps_epi32(pz), last);
        __m128i mask = start_mask, vi = zero, children, filled, on, edge;
        __m128 leave;
        uint32_t m, s = top;
        left--;
        if (counted) outer += voxrti_count4(voxrti_lanes(trace));
        if (c->grid != NULL) {
            __m128i g = voxrti_grid_load4(c, jx, jy, jz), inner_voxel = _mm_srai_epi32(_mm_slli_epi32(g, 31), 31);
            children = _mm_and_si128(_mm_and_si128(_mm_srli_epi32(g, 1), inner_voxel), trace);
            mask = _mm_blendv_epi8(_mm_srli_epi32(g, 2), start_mask, inner_voxel);
            filled = _mm_andnot_si128(inner_voxel, _mm_and_si128(g, two));
            vi = _mm_set1_epi32(-1);
        } else {
            children = _mm_and_si128(_mm_set1_epi32((int)voxels[0].children), trace);
            filled = _mm_set1_epi32((int)voxels[0].index);
        }
        while (s > c->leaf_log) { /* down. Lanes that are there have children = 0 and read the root's block */
            __m128i down = _mm_cmpgt_epi32(children, zero), shift, w, words;
            m = voxrti_lanes(down);
            if (m == 0) break;
            if (counted) inner += voxrti_count4(m);
            shift = _mm_cvtsi32_si128((int)--s);
            w = _mm_and_si128(_mm_srl_epi32(jx, shift), one);
            w = _mm_or_si128(w, _mm_and_si128(_mm_srl_epi32(_mm_slli_epi32(jy, 1), shift), two));
            w = _mm_or_si128(w, _mm_and_si128(_mm_srl_epi32(_mm_slli_epi32(jz, 2), shift), _mm_set1_epi32(4)));
            w = _mm_or_si128(w, _mm_slli_epi32(children, 3));
            voxrti_voxel_load4(w, words, children);
            children = _mm_and_si128(children, down);
            vi = _mm_blendv_epi8(vi, w, down);
            filled = _mm_blendv_epi8(filled, _mm_slli_epi32(words, 16), down); /* the low half is the index */
            mask = _mm_blendv_epi8(mask, _mm_set1_epi32((int)((1u << s) - 1u)), down);
        }
        on = _mm_andnot_si128(_mm_cmpeq_epi32(filled, zero), trace);
        m = voxrti_lanes(on);
        if (m != 0) {
            voxrti_lane_store(l.cell[0], jx);
            voxrti_lane_store(l.cell[1], jy);
            voxrti_lane_store(l.cell[2], jz);
            voxrti_lane_store(l.mask, mask);
            voxrti_lane_store(l.voxel, vi);
            _mm_storeu_ps(l.lambda, lambda);
            m = voxrti_octpacket_hits(c, &r, m, &l, rays, hits);
            if (counted) stats->hits += m;
            trace = _mm_andnot_si128(on, trace);
        }
        edge = _mm_add_epi32(mask, one);
        leave = voxrti_exit4(jx, mask, edge, posx, ox, ix);
        leave = _mm_min_ps(voxrti_exit4(jy, mask, edge, posy, oy, iy), leave);
        leave = _mm_min_ps(voxrti_exit4(jz, mask, edge, posz, oz, iz), leave);
        on = _mm_and_si128(_mm_castps_si128(_mm_cmpgt_ps(leave, lambda)), trace);
        lambda = _mm_blendv_ps(lambda, leave, _mm_castsi128_ps(on));
        px = _mm_add_ps(qx, _mm_mul_ps(lambda, dx));
        py = _mm_add_ps(qy, _mm_mul_ps(lambda, dy));
        pz = _mm_add_ps(qz, _mm_mul_ps(lambda, dz));
        edge = _mm_xor_si128(on, trace); /* lanes that do not get on */
        m = voxrti_lanes(edge);
        trace = _mm_andnot_si128(_mm_castps_si128(_mm_cmpge_ps(lambda, end)), on);
        if (VOXRTI_UNLIKELY(m != 0)) {
            if (c->fixed || left == 0) {
                if (counted) stats->stuck += voxrti_count4(m);
            } else {
                _mm_storeu_ps(l.point[0], px);
                _mm_storeu_ps(l.point[1], py);
                _mm_storeu_ps(l.point[2], pz);
                voxrti_octpacket_boost(c, &r, m, again, &l);
                px = _mm_loadu_ps(l.point[0]);
                py = _mm_loadu_ps(l.point[1]);
                pz = _mm_loadu_ps(l.point[2]);
                trace = _mm_or_si128(trace, edge);
            }
        }
        again = m != 0;
        if (voxrti_lanes(trace) == 0 || left == 0) break;
    }
    if (counted) {
        stats->outer += outer;
        stats->inner += inner;
        if (c->grid != NULL) stats->grid += outer;
    }
}

VOXRTI_TARGET_SSE4 static void voxrti_octrace_packets(const voxrti_octrace *c, const voxrt_ray *rays, voxrt_hit *hits,
                                                      size_t count, voxrt_octree_stats *stats) {
    size_t i;
    for (i = 0; i < count; i += 4) {
        uint32_t n = count - i < 4 ? (uint32_t)(count - i) : 4u;
        if (stats != NULL) voxrti_octrace_four(c, rays + i, hits + i, n, stats, 1);
        else voxrti_octrace_four(c, rays + i, hits + i, n, stats, 0);
    }
}
#endif

/* ---- entry points ---- */

VOXRT_DEF voxrt_result voxrt_octree_trace(const voxrt_octree *t, const voxrt_octree_trace_desc *desc,
                                          const voxrt_ray *rays, voxrt_hit *hits, size_t count) {
    voxrt_octree_trace_desc d;
    voxrt_octree_stats local;
    voxrti_octrace c;
    size_t i;
    int packets;
    memset(&d, 0, sizeof d);
    if (desc != NULL) d = *desc;
    if (d._begin_zero != 0 || d._end_zero != 0) return VOXRT_ERR_UNINIT_DESC;
    if (t == NULL || (uint32_t)d.isa > 4u || !(d.offset >= 0.0f && d.offset <= 0.5f)) return VOXRT_ERR_INVALID_ARG;
    if (count != 0 && (rays == NULL || hits == NULL)) return VOXRT_ERR_INVALID_ARG;
    memset(&local, 0, sizeof local);
    memset(&c, 0, sizeof c);
    c.t = t;
    c.full = (float)(1u << t->depth);
    if (d.max_level_plus_1 != 0 && d.max_level_plus_1 <= t->depth) c.leaf_log = t->depth + 1 - d.max_level_plus_1;
    c.fixed = d.offset > 0;
    c.offset = d.offset > 0 ? d.offset : c.full * VOXRTI_OCTREE_OFFSET;
    c.max_outer = 6u << t->depth;
    c.scale = 1.0 / t->voxel_size;
    if (t->grid != NULL && !d.disable_grid) { /* with a limit a coarser one, so that below its nodes there is a level */
        uint32_t l = t->grid_level - 1;
        if (d.max_level_plus_1 != 0 && l + 2 > d.max_level_plus_1) l = d.max_level_plus_1 - 2;
        if (d.max_level_plus_1 != 1) {
            c.grid = t->grid + voxrti_grid_first(l);
            c.grid_log = l;
        }
    }
    packets = d.isa != VOXRT_ISA_SCALAR && t->cpu_level >= 2;
#if VOXRTI_X64
    if (packets) voxrti_octrace_packets(&c, rays, hits, count, d.stats != NULL ? &local : NULL);
#else
    packets = 0;
#endif
    if (!packets)
        for (i = 0; i < count; i++) voxrti_octrace_one(&c, rays + i, hits + i, &local);
    if (d.stats != NULL) {
        d.stats->rays += local.rays;
        d.stats->hits += local.hits;
        d.stats->bad_rays += local.bad_rays;
        d.stats->outer += local.outer;
        d.stats->inner += local.inner;
        d.stats->grid += local.grid;
        d.stats->stuck += local.stuck;
    }
    return VOXRT_OK;
}

VOXRT_DEF uint32_t voxrt_octree_lod_level(const voxrt_octree *t, const float eye[3], float spread, float pixels) {
    double size, d2 = 0, want, edge;
    uint32_t a, level = 0;
    if (t == NULL || eye == NULL) return 0;
    size = t->voxel_size * (double)(1u << t->depth);
    for (a = 0; a < 3; a++) {
        double below = t->origin[a] - (double)eye[a], above = (double)eye[a] - (t->origin[a] + size);
        double d = voxrti_max(0.0, voxrti_max(below, above));
        d2 += d * d;
    }
    want = (double)spread * (double)pixels * sqrt(d2); /* edge of the voxels that are small enough */
    for (edge = size; level < t->depth && !(edge <= want); level++) edge = edge * 0.5;
    return level;
}

VOXRT_DEF void voxrt_octree_hit_color(const voxrt_octree *t, const voxrt_hit *hit, uint8_t rgb[3]) {
    uint32_t index;
    VOXRT_ASSERT(hit->node < 8 * t->block_count); /* not a miss, not of another octree */
    index = t->voxel[hit->node].index;
    memcpy(rgb, t->palette + (size_t)3 * (index - (index != 0)), 3);
}

VOXRTI_INLINE void voxrti_face_normal(const voxrt_hit *hit, float n[3]) {
    n[0] = n[1] = n[2] = 0.0f;
    if (hit->node != VOXRT_NO_NODE && hit->face < 6) n[hit->face >> 1] = (hit->face & 1u) ? 1.0f : -1.0f;
}

VOXRT_DEF void voxrt_octree_hit_normal(const voxrt_octree *t, const voxrt_hit *hit, float normal[3]) {
    VOXRT_ASSERT(hit->node < 8 * t->block_count);
    if (t->has_normals) voxrti_sph_decode(t->voxel[hit->node].theta, t->voxel[hit->node].phi, normal);
    else voxrti_face_normal(hit, normal);
}

#if VOXRTI_X64
/* voxrti_sph_sincos of four codes */
VOXRTI_TARGET_SSE4 static void voxrti_sph_sincos4(__m128i k, __m128 *s, __m128 *c) {
    __m128i q = _mm_srai_epi32(_mm_add_epi32(k, _mm_set1_epi32(64)), 7);
    __m128 x = _mm_mul_ps(_mm_cvtepi32_ps(_mm_sub_epi32(k, _mm_slli_epi32(q, 7))), _mm_set1_ps(0.012271846303085130f));
    __m128 x2 = _mm_mul_ps(x, x), ps, pc, odd, sign = _mm_set1_ps(-0.0f), flip;
    ps = _mm_add_ps(_mm_mul_ps(_mm_set1_ps(-1.9515295891e-4f), x2), _mm_set1_ps(8.3321608736e-3f));
    ps = _mm_add_ps(_mm_mul_ps(ps, x2), _mm_set1_ps(-1.6666654611e-1f));
    ps = _mm_add_ps(_mm_mul_ps(_mm_mul_ps(ps, x2), x), x);
    pc = _mm_add_ps(_mm_mul_ps(_mm_set1_ps(2.443315711809948e-5f), x2), _mm_set1_ps(-1.388731625493765e-3f));
    pc = _mm_add_ps(_mm_mul_ps(pc, x2), _mm_set1_ps(4.166664568298827e-2f));
    pc = _mm_mul_ps(_mm_mul_ps(pc, x2), x2);
    pc = _mm_add_ps(pc, _mm_sub_ps(_mm_set1_ps(1.0f), _mm_mul_ps(_mm_set1_ps(0.5f), x2)));
    odd = _mm_castsi128_ps(_mm_slli_epi32(q, 31));
    flip = _mm_and_ps(_mm_castsi128_ps(_mm_slli_epi32(q, 30)), sign);
    *s = _mm_xor_ps(_mm_blendv_ps(ps, pc, odd), flip);
    *c = _mm_xor_ps(_mm_blendv_ps(pc, _mm_xor_ps(ps, sign), odd), flip);
}

/* thesis listing 2: normals of four voxels */
VOXRTI_TARGET_SSE4 static void voxrti_sph_decode4(const voxrti_voxel *v[4], float *n) {
    __m128 st, ct, sp, cp, x, y;
    float f[3][4];
    uint32_t k;
    voxrti_sph_sincos4(_mm_setr_epi32(v[0]->theta, v[1]->theta, v[2]->theta, v[3]->theta), &st, &ct);
    voxrti_sph_sincos4(_mm_setr_epi32(2 * v[0]->phi, 2 * v[1]->phi, 2 * v[2]->phi, 2 * v[3]->phi), &sp, &cp);
    x = _mm_mul_ps(st, cp);
    y = _mm_mul_ps(st, sp);
    _mm_storeu_ps(f[0], x);
    _mm_storeu_ps(f[1], y);
    _mm_storeu_ps(f[2], ct);
    for (k = 0; k < 4; k++) {
        n[3 * k] = f[0][k];
        n[3 * k + 1] = f[1][k];
        n[3 * k + 2] = f[2][k];
    }
}
#endif

VOXRT_DEF void voxrt_octree_hit_normals(const voxrt_octree *t, const voxrt_hit *hits, float *normals, size_t count) {
    size_t i = 0;
#if VOXRTI_X64
    if (t->has_normals && t->cpu_level >= 2) {
        for (; i + 4 <= count; i += 4) {
            const voxrti_voxel *v[4];
            uint32_t k;
            for (k = 0; k < 4; k++) v[k] = &t->voxel[hits[i + k].node != VOXRT_NO_NODE ? hits[i + k].node : 0];
            voxrti_sph_decode4(v, normals + 3 * i);
            for (k = 0; k < 4; k++)
                if (hits[i + k].node == VOXRT_NO_NODE) memset(normals + 3 * (i + k), 0, 3 * sizeof(float));
        }
    }
#endif
    for (; i < count; i++) {
        if (hits[i].node == VOXRT_NO_NODE) memset(normals + 3 * i, 0, 3 * sizeof(float));
        else voxrt_octree_hit_normal(t, &hits[i], normals + 3 * i);
    }
}

/* ---- entry points ---- */

static voxrt_result voxrti_trace_open(const voxrt_tree *t, const voxrt_trace_desc *desc, voxrt_trace_desc *d,
                                      voxrti_cone *cone, int *isa) {
    double scale;
    uint32_t a;
    memset(d, 0, sizeof *d);
    if (desc != NULL) *d = *desc;
    if (d->_begin_zero != 0 || d->_end_zero != 0) return VOXRT_ERR_UNINIT_DESC;
    if (t == NULL || (uint32_t)d->isa > 4u) return VOXRT_ERR_INVALID_ARG;
    if (!(d->cone_width >= 0.0f) || !(d->cone_spread >= 0.0f)) return VOXRT_ERR_INVALID_ARG;
    scale = 1.0 / t->voxel_size;
    cone->width = voxrti_min((double)d->cone_width * scale, 1e300); /* infinity times 0 is no width */
    cone->spread = voxrti_min((double)d->cone_spread * scale, 1e300);
    cone->floor_ = 0;
    if (d->max_level_plus_1 != 0 && d->max_level_plus_1 <= t->depth)
        cone->floor_ = (double)((uint32_t)1 << (t->depth + 1 - d->max_level_plus_1));
    for (a = 0; a < 3; a++) {
        uint32_t f = cone->floor_ > 0 ? (uint32_t)cone->floor_ : 1u;
        cone->lo[a] = t->cell_min[a] / f * f;
        cone->hi[a] = (t->cell_max[a] + f - 1) / f * f;
    }
    cone->on = cone->width > 0 || cone->spread > 0 || cone->floor_ > 0;
    *isa = (int)voxrt_isa_best();
    if (d->isa != VOXRT_ISA_AUTO && (int)d->isa < *isa) *isa = (int)d->isa;
    if (cone->floor_ >= (double)((uint32_t)1 << (2 * t->wide))) *isa = VOXRT_ISA_SCALAR; /* the root alone */
    return VOXRT_OK;
}

VOXRT_DEF int voxrt_trace1(const voxrt_tree *tree, const voxrt_ray *ray, voxrt_hit *hit) {
    voxrti_cone cone;
    memset(&cone, 0, sizeof cone);
    memcpy(cone.lo, tree->cell_min, sizeof cone.lo);
    memcpy(cone.hi, tree->cell_max, sizeof cone.hi);
    voxrti_trace_one(tree, &cone, NULL, ray, hit, NULL);
    return hit->node != VOXRT_NO_NODE;
}

VOXRT_DEF voxrt_result voxrt_trace(const voxrt_tree *tree, const voxrt_trace_desc *desc, const voxrt_ray *rays,
                                   voxrt_hit *hits, size_t count) {
    voxrt_trace_desc d;
    voxrti_cone cone;
    voxrti_beam beam;
    size_t i;
    int isa;
    voxrt_result r = voxrti_trace_open(tree, desc, &d, &cone, &isa);
    if (r != VOXRT_OK) return r;
    if (count != 0 && (rays == NULL || hits == NULL)) return VOXRT_ERR_INVALID_ARG;
#if VOXRTI_AVX2
    if (isa == VOXRT_ISA_AVX2) {
        for (i = 0; i < count; i += 65536) {
            size_t n = count - i < 65536 ? count - i : 65536;
            voxrti_trace_avx2(tree, &cone, rays + i, hits + i, n, d.stats);
        }
        return VOXRT_OK;
    }
#endif
#if VOXRTI_X64
    if (isa >= VOXRT_ISA_SSE && !cone.on) {
        for (i = 0; i < count; i += 65536) {
            size_t n = count - i < 65536 ? count - i : 65536;
            voxrti_trace_sse(tree, &cone, rays + i, hits + i, n, d.stats);
        }
        return VOXRT_OK;
    }
#endif
    for (i = 0; i < count; i++) {
        if ((i & 63u) == 0)
            voxrti_beam_find(tree, &cone, rays + i, count - i < 64 ? (uint32_t)(count - i) : 64u, &beam);
        voxrti_trace_one(tree, &cone, &beam, rays + i, hits + i, d.stats);
    }
    return VOXRT_OK;
}

VOXRT_DEF voxrt_result voxrt_occluded(const voxrt_tree *tree, const voxrt_trace_desc *desc, const voxrt_ray *rays,
                                      uint8_t *occluded, size_t count) {
    voxrt_hit hit[512]; /* 12 KB */
    size_t i, k, n;
    if (count != 0 && occluded == NULL) return VOXRT_ERR_INVALID_ARG;
    for (i = 0; i < count; i += n) {
        voxrt_result r;
        n = count - i < 512 ? count - i : 512;
        r = voxrt_trace(tree, desc, rays + i, hit, n);
        if (r != VOXRT_OK) return r;
        for (k = 0; k < n; k++) occluded[i + k] = hit[k].node != VOXRT_NO_NODE;
    }
    return VOXRT_OK;
}

VOXRTI_INLINE uint64_t voxrti_hit_attr(const voxrt_tree *t, const voxrt_hit *hit) {
    if (t->code != NULL)
        return voxrti_shared_attr(t, (uint32_t)hit->level + 2 * t->wide - t->depth, hit->cell[0], hit->cell[1],
                                  hit->cell[2]);
    return voxrti_attr_index(t, (uint32_t)hit->level + 2 * t->wide - t->depth, hit->node, hit->slot);
}

/* Those of n rays, 0 for misses; the attributes are on their way from memory when this returns. */
VOXRTI_INLINE void voxrti_hit_attrs_each(const voxrt_tree *t, const voxrt_hit *hit, uint32_t n, uint64_t *attr) {
    uint32_t i;
    for (i = 0; i < n; i++) {
        attr[i] = 0;
        if (hit[i].node == VOXRT_NO_NODE) continue;
        attr[i] = voxrti_hit_attr(t, &hit[i]);
        if (t->normal != NULL) VOXRTI_PREFETCH(t->normal + attr[i]);
        if (t->colors.block != NULL) VOXRTI_PREFETCH(t->colors.block + (attr[i] >> 6));
    }
}
#if VOXRTI_AVX2
VOXRTI_TARGET_AVX2 static void voxrti_hit_attrs_popcnt(const voxrt_tree *t, const voxrt_hit *hit, uint32_t n,
                                                       uint64_t *attr) {
    voxrti_hit_attrs_each(t, hit, n, attr); /* ranks by an instruction */
}
#endif
static void voxrti_hit_attrs(voxrt_isa isa, const voxrt_tree *t, const voxrt_hit *hit, uint32_t n, uint64_t *attr) {
#if VOXRTI_AVX2
    if ((isa == VOXRT_ISA_AUTO || isa >= VOXRT_ISA_AVX2) && voxrt_isa_best() >= VOXRT_ISA_AVX2) {
        voxrti_hit_attrs_popcnt(t, hit, n, attr);
        return;
    }
#endif
    (void)isa;
    voxrti_hit_attrs_each(t, hit, n, attr);
}

VOXRTI_INLINE void voxrti_attr_color(const voxrt_tree *t, uint64_t attr, uint8_t rgb[3]) {
    memcpy(rgb, t->palette + (size_t)3 * voxrti_color_index(t, attr), 3);
}

VOXRT_DEF void voxrt_hit_color(const voxrt_tree *tree, const voxrt_hit *hit, uint8_t rgb[3]) {
    voxrti_attr_color(tree, tree->colors.block != NULL ? voxrti_hit_attr(tree, hit) : 0, rgb);
}

VOXRT_DEF void voxrt_hit_normal(const voxrt_tree *tree, const voxrt_hit *hit, float normal[3]) {
    if (tree->normal != NULL) {
        voxrti_normal_decode(tree->spherical, tree->normal[voxrti_hit_attr(tree, hit)], normal);
    } else {
        normal[0] = normal[1] = normal[2] = 0.0f;
        if (hit->face < 6) normal[hit->face >> 1] = (hit->face & 1u) ? 1.0f : -1.0f;
    }
}

/* ---------------------------------------------------------------------------
   shade: surfaces -> colours.                                                   // >>shade
   Rays come in runs of up to 64. Colours of one run: 64 values of red, green, blue, coverage; linear and premultiplied,
   or with thesis_compose sRGB bytes times brightness, 0..255. Shadow rays of a run are traced together, light by light.
   --------------------------------------------------------------------------- */

#define VOXRTI_RUN 64 /* rays traced at once: 8x8 pixels, or blocks of pixels */

typedef struct voxrti_srgb {
    float linear[256];    /* of a byte */
    float from[257];      /* byte b is what values in [from[b], from[b+1]) are written as */
    uint8_t start[1025];  /* byte of the value i/1024 */
} voxrti_srgb;

typedef struct voxrti_frame { /* a camera: direction of the picture point (x, y), both 0 in the middle, y up */
    double forward[3], right[3], up[3]; /* right and up have the length of one pixel at depth 1 */
    float eye[3];
    double pixel;
} voxrti_frame;

/* Pixels of a run. Ray i stands for a block of step x step of them, block (i % columns, i / columns). */
typedef struct voxrti_area { uint32_t x0, y0, x1, y1, step, columns, count; } voxrti_area;
VOXRTI_INLINE uint32_t voxrti_area_x(const voxrti_area *a, uint32_t i) { return a->x0 + i % a->columns * a->step; }
VOXRTI_INLINE uint32_t voxrti_area_y(const voxrti_area *a, uint32_t i) { return a->y0 + i / a->columns * a->step; }

typedef struct voxrti_render {
    const voxrt_render_desc *d;
    const voxrt_image *image;
    const voxrt_tree *tree;
    voxrt_material material;
    voxrt_light light[2];           /* the default ones */
    const voxrt_light *lights;
    size_t light_count;
    voxrti_frame frame;
    voxrt_trace_desc trace, coarse; /* coarse: left half of a split picture */
    uint32_t samples, step, tile, tiles_x, first_tile, count, transparent;
    float background[4];            /* in the units of the colours of a run */
    uint32_t sum[2][5][2];          /* sums of all threads: counts of the primary and the shadow rays */
    voxrti_srgb srgb;
} voxrti_render;

static void voxrti_srgb_open(voxrti_srgb *s) {
    uint32_t i, b = 0;
    for (i = 0; i < 256; i++) {
        s->linear[i] = (float)voxrti_srgb_to_linear((double)i / 255.0);
        s->from[i] = i == 0 ? 0.0f : (float)voxrti_srgb_to_linear(((double)i - 0.5) / 255.0);
    }
    s->from[256] = INFINITY;
    for (i = 0; i <= 1024; i++) {
        while ((float)i * (1.0f / 1024.0f) >= s->from[b + 1]) b++;
        s->start[i] = (uint8_t)b;
    }
}

/* linear value -> nearest sRGB byte */
VOXRTI_INLINE uint8_t voxrti_srgb_byte(const voxrti_srgb *s, float v) {
    uint32_t b;
    if (!(v > 0.0f)) return 0;
    if (v >= 1.0f) return 255;
    b = s->start[(uint32_t)(v * 1024.0f)];
    while (v >= s->from[b + 1]) b++;
    return (uint8_t)b;
}
/* value in units of sRGB bytes, also between them -> linear */
VOXRTI_INLINE float voxrti_srgb_value(const voxrti_srgb *s, float v) {
    uint32_t b;
    if (!(v > 0.0f)) return 0.0f;
    if (v >= 255.0f) return 1.0f;
    b = (uint32_t)v;
    return s->linear[b] + (s->linear[b + 1] - s->linear[b]) * (v - (float)b);
}
/* value in units of 1/255 -> nearest byte */
VOXRTI_INLINE uint8_t voxrti_unit_byte(float v) {
    return !(v > 0.0f) ? (uint8_t)0 : v >= 255.0f ? (uint8_t)255 : (uint8_t)(v + 0.5f);
}

/* Trace a run through everything that is to be seen. hit may be NULL. */
static void voxrti_run_trace(const voxrti_render *c, const voxrt_trace_desc *td, const voxrt_ray *ray,
                             voxrt_surface *surface, voxrt_hit *hit, uint32_t n);

static void voxrti_run_occluded(const voxrti_render *c, const voxrt_trace_desc *td, const voxrt_ray *ray,
                                uint8_t *occluded, uint32_t n) {
    uint8_t more[VOXRTI_RUN];
    uint32_t g, i;
    memset(occluded, 0, n);
    if (c->tree != NULL) (void)voxrt_occluded(c->tree, td, ray, occluded, n);
    for (g = 0; g < c->d->geometry_count; g++) {
        memset(more, 0, sizeof more);
        c->d->geometry[g].occluded_fn(c->d->geometry[g].user, td, ray, more, n);
        for (i = 0; i < n; i++) occluded[i] = (uint8_t)(occluded[i] | more[i]);
    }
}

/* Where a shadow ray starts. A voxel surface is a staircase around the real one: its corners stand up to half a voxel
   diagonal above it. Lifting the origin by 1.5 voxels along the normal and a little towards the light clears the
   stairs at any resolution; what is nearer than that throws no shadow. */
VOXRTI_INLINE void voxrti_shadow_origin(const voxrt_render_desc *d, const voxrt_surface *s, const float p[3],
                                        const float normal[3], const float to_light[3], float org[3]) {
    uint32_t a;
    float lift = d->thesis_shadows ? 0.0f : 1.5f * s->edge;
    float ahead = d->thesis_shadows ? 0.01f * s->edge : 0.5f * s->edge;
    for (a = 0; a < 3; a++) org[a] = p[a] + normal[a] * lift + to_light[a] * ahead;
}

/* Add one light to the brightness of a run. bright, shine: diffuse and specular sums, 3 floats a ray. */
static VOXRTI_NOINLINE void voxrti_run_light(const voxrti_render *c, const voxrt_trace_desc *td,
                                             const voxrt_light *light, const voxrt_ray *ray,
                                             const voxrt_surface *surface, const float (*normal)[3], uint32_t n,
                                             float (*bright)[3], float (*shine)[3]) {
    voxrt_ray shadow[VOXRTI_RUN];
    float diffuse[VOXRTI_RUN], specular[VOXRTI_RUN];
    uint8_t index[VOXRTI_RUN], dark[VOXRTI_RUN];
    uint32_t i, k, a, m = 0;
    float unit[3];
    int shadows = c->d->shadows && !light->no_shadow;
    for (a = 0; a < 3; a++) unit[a] = light->position[a];
    if (light->directional) (void)voxrti_normalize(unit);
    for (i = 0; i < n; i++) {
        float p[3], to[3], cosine;
        voxrt_ray *r = &shadow[m];
        if (!(surface[i].t < INFINITY)) continue;
        for (a = 0; a < 3; a++) {
            p[a] = ray[i].org[a] + ray[i].dir[a] * surface[i].t;
            to[a] = light->directional ? unit[a] : light->position[a] - p[a];
        }
        if (!light->directional) (void)voxrti_normalize(to);
        cosine = voxrti_dot3(normal[i], to);
        if (!(cosine > 0.0f && cosine < 2.0f)) continue; /* above 1: no float is as long as the way to the light */
        diffuse[m] = cosine * c->material.diffuse;
        specular[m] = 0.0f;
        if (c->material.specular > 0.0f) {
            float v[3], along;
            for (a = 0; a < 3; a++) v[a] = -ray[i].dir[a];
            (void)voxrti_normalize(v);
            along = 2.0f * cosine * voxrti_dot3(normal[i], v) - voxrti_dot3(to, v);
            if (along > 0.0f) {
                /* of 2; below -149: no float */
                double power = (double)c->material.shininess * voxrti_log2((double)along);
                if (power > -149.0) specular[m] = c->material.specular * (float)voxrti_exp2(voxrti_min(power, 0.0));
            }
        }
        index[m] = (uint8_t)i;
        dark[m] = 0;
        if (shadows) {
            voxrti_shadow_origin(c->d, &surface[i], p, normal[i], to, r->org);
            r->t_min = 0.0f;
            for (a = 0; a < 3; a++) r->dir[a] = light->directional ? unit[a] : light->position[a] - r->org[a];
            r->t_max = light->directional ? INFINITY : 1.0f;
        }
        m++;
    }
    if (shadows && m != 0) voxrti_run_occluded(c, td, shadow, dark, m);
    for (k = 0; k < m; k++) {
        if (dark[k]) continue;
        i = index[k];
        for (a = 0; a < 3; a++) {
            bright[i][a] += diffuse[k] * light->color[a];
            shine[i][a] += specular[k] * light->color[a];
        }
    }
}

/* View of a pixel column: split pictures show three. */
VOXRTI_INLINE voxrt_view voxrti_view_at(const voxrti_render *c, uint32_t x) {
    uint64_t third = (uint64_t)3 * x / c->image->width;
    if (c->d->view != VOXRT_VIEW_SPLIT) return c->d->view;
    return third == 0 ? VOXRT_VIEW_UNLIT : third == 1 ? VOXRT_VIEW_SHADED : VOXRT_VIEW_LIGHT;
}

/* Unit normals of a run, turned round where the back of a surface is seen. That a normal faces away does not tell: the
   mean of what is in a voxel does so on ridges, too, and at silhouettes. The face through which the ray came helps: the
   back of a surface shows faces that are against its normal, a ridge those that are with it. On a scan, as it is and
   turned inside out, 0.07 and 0.26 % of the pixels are taken for the other side at 256 voxels along an axis, 0.004 and
   0.1 % at 1024. */
static void voxrti_run_normals(const voxrti_render *c, const voxrt_ray *ray, const voxrt_surface *surface, uint32_t n,
                               float (*normal)[3]) {
    uint32_t i, a;
    for (i = 0; i < n; i++) {
        const float *dir = ray[i].dir, *v = surface[i].normal;
        float along;
        int turn;
        normal[i][0] = normal[i][1] = normal[i][2] = 0.0f;
        if (!(surface[i].t < INFINITY)) continue;
        if (c->d->face_normals || (v[0] == 0.0f && v[1] == 0.0f && v[2] == 0.0f)) {
            uint32_t f = surface[i].face;
            if (f < 6) {
                normal[i][f >> 1] = (f & 1u) ? 1.0f : -1.0f;
            } else {
                for (a = 0; a < 3; a++) normal[i][a] = -dir[a];
                (void)voxrti_normalize(normal[i]);
            }
            continue;
        }
        along = voxrti_dot3(v, dir);
        turn = !c->d->one_sided && along > 0.0f;
        if (turn) {
            float away = along / sqrtf(voxrti_dot3(dir, dir)), with = 0.0f;
            uint32_t f = surface[i].face;
            if (f < 6) with = (f & 1u) ? v[f >> 1] : -v[f >> 1];
            turn = away - with > 0.2f;
        }
        for (a = 0; a < 3; a++) normal[i][a] = turn ? -v[a] : v[a];
    }
}

/* Colours of a run. */
static void voxrti_run_shade(const voxrti_render *c, const voxrt_trace_desc *td, const voxrt_ray *ray,
                             const voxrt_surface *surface, const float (*normal)[3], const voxrti_area *area,
                             float (*value)[4]) {
    float bright[VOXRTI_RUN][3], shine[VOXRTI_RUN][3], full = c->d->thesis_compose ? 255.0f : 1.0f;
    uint32_t i, a, l, lit = 0, hits = 0, n = area->count;
    for (i = 0; i < n; i++) hits += surface[i].t < INFINITY;
    if (hits == 0) {
        memset(value, 0, n * sizeof *value);
        return;
    }
    for (i = 0; i < n; i++) {
        voxrt_view view = voxrti_view_at(c, voxrti_area_x(area, i));
        lit |= (view == VOXRT_VIEW_SHADED || view == VOXRT_VIEW_LIGHT) && surface[i].t < INFINITY;
        for (a = 0; a < 3; a++) {
            bright[i][a] = c->material.ambient[a];
            shine[i][a] = 0.0f;
        }
    }
    for (l = 0; lit && l < c->light_count; l++)
        voxrti_run_light(c, td, &c->lights[l], ray, surface, normal, n, bright, shine);
    for (i = 0; i < n; i++) {
        voxrt_view view = voxrti_view_at(c, voxrti_area_x(area, i));
        float *v = value[i];
        v[0] = v[1] = v[2] = v[3] = 0.0f;
        if (!(surface[i].t < INFINITY)) continue;
        v[3] = full;
        for (a = 0; a < 3; a++) {
            float color = view == VOXRT_VIEW_LIGHT || c->d->stage == VOXRT_STAGE_TRACE ? full :
                          c->d->thesis_compose ? (float)surface[i].rgb[a] : c->srgb.linear[surface[i].rgb[a]];
            if (view == VOXRT_VIEW_NORMALS) v[a] = (normal[i][a] + 1.0f) * 0.5f * full;
            else if (view == VOXRT_VIEW_UNLIT || c->d->stage == VOXRT_STAGE_TRACE) v[a] = color;
            else v[a] = color * bright[i][a] + full * shine[i][a];
            if (c->d->thesis_compose && v[a] > 255.0f) v[a] = 255.0f;
        }
    }
}

/* Heat of one ray: how often it stepped (outer) or went down (inner). */
static void voxrti_heat(const voxrti_render *c, const voxrt_ray *ray, float value[4]) {
    static const uint32_t limit[4] = {120, 80, 40, 15};
    static const float paint[5][3] = {{1, 0, 0}, {1, 0.25f, 0}, {1, 1, 0}, {0, 0.6f, 0}, {1, 1, 1}};
    voxrt_trace_desc td = c->trace;
    voxrt_surface surface;
    voxrt_stats stats;
    float full = c->d->thesis_compose ? 255.0f : 1.0f;
    uint32_t k = 0, a;
    memset(&stats, 0, sizeof stats);
    td.stats = &stats;
    td.isa = VOXRT_ISA_SCALAR;
    voxrti_run_trace(c, &td, ray, &surface, NULL, 1);
    value[3] = full;
    if (c->d->view == VOXRT_VIEW_HEAT_OUTER) {
        float h = (float)stats.steps / (c->d->heat_max > 0.0f ? c->d->heat_max : 64.0f);
        value[0] = full;
        value[1] = value[2] = h < 1.0f ? full * (1.0f - h) : 0.0f;
        return;
    }
    while (k < 4 && stats.descents <= limit[k]) k++;
    for (a = 0; a < 3; a++) value[a] = full * paint[k][a];
}

/* ---------------------------------------------------------------------------
   render: camera -> rays -> tiles of 32x32 pixels over the threads -> buffers.  // >>render
   A tile is cut into runs of 8x8 pixels, or of blocks of pixels that share a ray (pixel_step; tiles of 24 to 64 then);
   each run is traced sample by sample, shaded and written. A pixel depends on its run only, so any number of threads
   gives the same bits. Nothing is allocated; a run lives on the stack (14 KB).
   --------------------------------------------------------------------------- */

/* Trace through the tree and fill in what the rays met. */
static void voxrti_tree_trace(const voxrt_tree *tree, const voxrt_trace_desc *td, uint32_t bare, const voxrt_ray *ray,
                              voxrt_surface *surface, voxrt_hit *hit, uint32_t n) {
    uint64_t attr[VOXRTI_RUN];
    uint32_t i;
    if (voxrt_trace(tree, td, ray, hit, n) != VOXRT_OK) memset(hit, 0xff, n * sizeof *hit);
    if (!bare) voxrti_hit_attrs(td->isa, tree, hit, n, attr);
    for (i = 0; i < n; i++) {
        voxrt_surface *s = &surface[i];
        memset(s, 0, sizeof *s);
        s->t = INFINITY;
        if (hit[i].node == VOXRT_NO_NODE) continue;
        s->t = hit[i].t;
        s->face = hit[i].face;
        s->edge = (float)(tree->voxel_size * (double)((uint32_t)1 << (tree->depth - hit[i].level)));
        if (bare) continue;
        voxrti_attr_color(tree, attr[i], s->rgb);
        if (tree->normal != NULL) voxrti_normal_decode(tree->spherical, tree->normal[attr[i]], s->normal);
    }
}

static void voxrti_run_trace(const voxrti_render *c, const voxrt_trace_desc *td, const voxrt_ray *ray,
                             voxrt_surface *surface, voxrt_hit *hit, uint32_t n) {
    voxrt_hit own[VOXRTI_RUN];
    voxrt_surface other[VOXRTI_RUN];
    uint32_t i, g;
    if (hit == NULL) hit = own;
    if (c->tree != NULL && c->d->stage != VOXRT_STAGE_RAYS) {
        voxrti_tree_trace(c->tree, td, c->d->stage != VOXRT_STAGE_FULL, ray, surface, hit, n);
    } else {
        for (i = 0; i < n; i++) {
            memset(&surface[i], 0, sizeof surface[i]);
            surface[i].t = INFINITY;
            voxrti_miss(&hit[i]);
        }
    }
    for (g = 0; g < c->d->geometry_count && c->d->stage != VOXRT_STAGE_RAYS; g++) {
        memset(other, 0, sizeof other);
        for (i = 0; i < n; i++) other[i].t = INFINITY;
        c->d->geometry[g].trace_fn(c->d->geometry[g].user, td, ray, other, n);
        for (i = 0; i < n; i++) {
            if (!(other[i].t < surface[i].t)) continue;
            surface[i] = other[i];
            voxrti_miss(&hit[i]);
        }
    }
}

/* Position of sample s in its pixel: the plastic-number sequence (Roberts 2018), sample 0 in the middle. */
VOXRTI_INLINE void voxrti_sample_at(uint32_t s, double *x, double *y) {
    *x = (double)(uint32_t)(0x80000000u + s * 0xc13fa9a9u) * (1.0 / 4294967296.0);
    *y = (double)(uint32_t)(0x80000000u + s * 0x91e10da6u) * (1.0 / 4294967296.0);
}

VOXRTI_INLINE void voxrti_frame_ray(const voxrti_frame *f, double x, double y, voxrt_ray *ray) {
    uint32_t a;
    for (a = 0; a < 3; a++) {
        ray->org[a] = f->eye[a];
        ray->dir[a] = (float)(f->forward[a] + x * f->right[a] + y * f->up[a]);
    }
    ray->t_min = 0.0f;
    ray->t_max = INFINITY;
}

VOXRTI_INLINE void *voxrti_pixel(void *base, size_t stride, size_t size, uint32_t width, uint32_t x, uint32_t y) {
    return (uint8_t *)base + (stride != 0 ? stride : size * width) * y + size * x;
}

/* The finished mean of a pixel -> rgba and rgba8. total: of all samples so far. */
static void voxrti_pixel_write(const voxrti_render *c, uint32_t x, uint32_t y, const float total[4]) {
    const voxrt_image *m = c->image;
    float v[4], full = c->d->thesis_compose ? 255.0f : 1.0f, rest;
    float scale = 1.0f / (float)(m->sum != NULL ? c->d->first_sample + c->samples : c->samples);
    uint32_t a;
    if (total[3] == 0.0f && c->transparent) {
        if (m->rgba8 != NULL) memset(voxrti_pixel(m->rgba8, m->rgba8_stride, 4, m->width, x, y), 0, 4);
        if (m->rgba != NULL) memset(voxrti_pixel(m->rgba, m->rgba_stride, 16, m->width, x, y), 0, 16);
        return;
    }
    for (a = 0; a < 4; a++) v[a] = total[a] * scale;
    rest = 1.0f - v[3] / full;
    for (a = 0; a < 4; a++) v[a] = v[a] + rest * c->background[a];
    if (m->rgba8 != NULL) {
        uint8_t *out = (uint8_t *)voxrti_pixel(m->rgba8, m->rgba8_stride, 4, m->width, x, y);
        int partly = v[3] > 0.0f && v[3] < full;
        for (a = 0; a < 3; a++) {
            float w = partly ? v[a] / v[3] : v[a];
            if (c->d->thesis_compose) out[a] = voxrti_unit_byte(partly ? w * 255.0f : w);
            else out[a] = voxrti_srgb_byte(&c->srgb, w);
        }
        out[3] = voxrti_unit_byte(v[3] * (255.0f / full));
    }
    if (m->rgba != NULL) {
        if (c->d->thesis_compose && v[3] > 0.0f) { /* sRGB -> linear light */
            v[3] = v[3] / 255.0f;
            for (a = 0; a < 3; a++) v[a] = voxrti_srgb_value(&c->srgb, v[a] / v[3]) * v[3];
        }
        memcpy(voxrti_pixel(m->rgba, m->rgba_stride, 16, m->width, x, y), v, sizeof v);
    }
}

/* What one ray met, for all pixels of its block. */
static void voxrti_block_write(const voxrti_render *c, const voxrti_area *area, uint32_t i, const float *depth,
                               const float *normal, const voxrt_hit *hit) {
    const voxrt_image *m = c->image;
    uint32_t x = voxrti_area_x(area, i), y = voxrti_area_y(area, i), u, v;
    for (v = y; v < y + area->step && v < area->y1; v++) {
        for (u = x; u < x + area->step && u < area->x1; u++) {
            if (m->depth != NULL) memcpy(voxrti_pixel(m->depth, m->depth_stride, 4, m->width, u, v), depth, 4);
            if (m->normal != NULL) memcpy(voxrti_pixel(m->normal, m->normal_stride, 12, m->width, u, v), normal, 12);
            if (m->hit != NULL)
                memcpy(voxrti_pixel(m->hit, m->hit_stride, sizeof *hit, m->width, u, v), hit, sizeof *hit);
        }
    }
}

/* One run: all samples of its pixels. */
static void voxrti_run(const voxrti_render *c, voxrt_render_stats *stats, const voxrti_area *area) {
    const voxrt_image *m = c->image;
    voxrt_ray ray[VOXRTI_RUN];
    voxrt_surface surface[VOXRTI_RUN];
    voxrt_hit hit[VOXRTI_RUN];
    float normal[VOXRTI_RUN][3], value[VOXRTI_RUN][4], total[VOXRTI_RUN][4];
    uint32_t n = area->count, s, i, a, x, y;
    double step = (double)area->step;
    const voxrt_states *own = c->d->states;
    voxrt_trace_desc td = c->d->lod_split != 0 && area->x0 < m->width / 2 ? c->coarse : c->trace, shadow = td;
    td.stats = stats != NULL ? &stats->primary : NULL;
    shadow.stats = stats != NULL ? &stats->shadow : NULL;
    memset(total, 0, sizeof total);
    for (i = 0; m->sum != NULL && c->d->first_sample != 0 && i < n; i++)
        memcpy(total[i], voxrti_pixel(m->sum, m->sum_stride, 16, m->width, voxrti_area_x(area, i),
                                      voxrti_area_y(area, i)), 16);
    for (s = 0; s < c->samples; s++) {
        double sx, sy;
        float depth = INFINITY;
        voxrti_sample_at(c->d->first_sample + s, &sx, &sy);
        for (i = 0; i < n; i++) {
            double px = (double)voxrti_area_x(area, i) + step * sx, py = (double)voxrti_area_y(area, i) + step * sy;
            voxrti_frame_ray(&c->frame, px - 0.5 * (double)m->width, 0.5 * (double)m->height - py, &ray[i]);
            if (own != NULL && own->ray_fn != NULL) own->ray_fn(own->user, px, py, &ray[i]);
        }
        if (c->d->stage == VOXRT_STAGE_SETUP) { /* rays that end where they begin */
            for (i = 0; i < n; i++) ray[i].t_max = 0.0f;
        }
        if (c->d->view >= VOXRT_VIEW_HEAT_OUTER) {
            for (i = 0; i < n; i++) voxrti_heat(c, &ray[i], value[i]);
        } else {
            voxrti_run_trace(c, &td, ray, surface, hit, n);
            for (i = 0; i < n; i++) depth = surface[i].t < depth ? surface[i].t : depth;
            /* shadow rays: as fine as the nearest pixel of the run */
            shadow.cone_width = depth < INFINITY ? depth * td.cone_spread : 0.0f;
            shadow.cone_spread = 0.0f;
            voxrti_run_normals(c, ray, surface, n, normal);
            voxrti_run_shade(c, &shadow, ray, surface, (const float (*)[3])normal, area, value);
            if (own != NULL && own->shade_fn != NULL)
                own->shade_fn(own->user, ray, surface, (const float (*)[3])normal, value, n);
        }
        for (i = 0; i < n; i++) {
            for (a = 0; a < 4; a++) total[i][a] += value[i][a];
        }
        if (c->d->first_sample + s != 0 || c->d->view >= VOXRT_VIEW_HEAT_OUTER) continue;
        if (m->depth == NULL && m->normal == NULL && m->hit == NULL) continue;
        for (i = 0; i < n; i++) voxrti_block_write(c, area, i, &surface[i].t, normal[i], &hit[i]);
    }
    for (y = area->y0; y < area->y1; y++) {
        for (x = area->x0; x < area->x1; x++) {
            i = (y - area->y0) / area->step * area->columns + (x - area->x0) / area->step;
            if (m->sum != NULL) memcpy(voxrti_pixel(m->sum, m->sum_stride, 16, m->width, x, y), total[i], 16);
            if (!c->d->no_compose) voxrti_pixel_write(c, x, y, total[i]);
        }
    }
}

static void voxrti_stats_sum(uint32_t (*to)[2], const voxrt_stats *s) {
    voxrti_tally_add(to[0], s->rays);
    voxrti_tally_add(to[1], s->hits);
    voxrti_tally_add(to[2], s->bad_rays);
    voxrti_tally_add(to[3], s->steps);
    voxrti_tally_add(to[4], s->descents);
}
static void voxrti_stats_add(voxrt_stats *to, uint32_t (*sum)[2]) {
    to->rays += voxrti_tally(sum[0]);
    to->hits += voxrti_tally(sum[1]);
    to->bad_rays += voxrti_tally(sum[2]);
    to->steps += voxrti_tally(sum[3]);
    to->descents += voxrti_tally(sum[4]);
}

static void voxrti_render_tile(void *ctx, uint32_t task) {
    voxrti_render *c = (voxrti_render *)ctx;
    const voxrt_image *m = c->image;
    voxrt_render_stats stats;
    voxrti_area run;
    uint32_t tile = c->first_tile + task, half = m->width / 2, side = 8 * c->step;
    uint32_t x0 = tile % c->tiles_x * c->tile, y0 = tile / c->tiles_x * c->tile;
    uint32_t x1 = m->width - x0 < c->tile ? m->width : x0 + c->tile;
    uint32_t y1 = m->height - y0 < c->tile ? m->height : y0 + c->tile;
    memset(&stats, 0, sizeof stats);
    run.step = c->step;
    for (run.y0 = y0; run.y0 < y1; run.y0 = run.y1) {
        run.y1 = y1 - run.y0 < side ? y1 : run.y0 + side;
        for (run.x0 = x0; run.x0 < x1; run.x0 = run.x1) {
            run.x1 = x1 - run.x0 < side ? x1 : run.x0 + side;
            if (c->d->lod_split != 0 && run.x0 < half && run.x1 > half) run.x1 = half;
            run.columns = (run.x1 - run.x0 + c->step - 1) / c->step;
            run.count = run.columns * ((run.y1 - run.y0 + c->step - 1) / c->step);
            voxrti_run(c, c->count ? &stats : NULL, &run);
        }
    }
    if (c->d->states != NULL && c->d->states->tile_fn != NULL)
        c->d->states->tile_fn(c->d->states->user, m, x0, y0, x1, y1);
    if (c->count) {
        voxrti_stats_sum(c->sum[0], &stats.primary);
        voxrti_stats_sum(c->sum[1], &stats.shadow);
    }
}

/* ---- camera ---- */

static void voxrti_cross(const double a[3], const double b[3], double out[3]) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

static int voxrti_unit(double v[3]) { /* 0: no direction */
    double big = voxrti_max(voxrti_max(voxrti_abs(v[0]), voxrti_abs(v[1])), voxrti_abs(v[2])), l;
    uint32_t a;
    if (!(big > 0.0) || !voxrti_finite(big)) return 0;
    for (a = 0; a < 3; a++) v[a] /= big;
    l = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    for (a = 0; a < 3; a++) v[a] /= l;
    return 1;
}

/* Right and up of a view. An `up` that says nothing (0, along the view) is replaced by the axis farthest from it. */
static void voxrti_frame_axes(const double forward[3], const float up[3], double right[3], double above[3]) {
    uint32_t a, k = 0;
    for (a = 0; a < 3; a++) above[a] = (double)up[a];
    if (up[0] == 0.0f && up[1] == 0.0f && up[2] == 0.0f) above[1] = 1.0;
    if (voxrti_unit(above)) {
        voxrti_cross(forward, above, right);
        if (right[0] * right[0] + right[1] * right[1] + right[2] * right[2] > 1e-12) {
            (void)voxrti_unit(right);
            voxrti_cross(right, forward, above);
            return;
        }
    }
    for (a = 1; a < 3; a++) k = voxrti_abs(forward[a]) < voxrti_abs(forward[k]) ? a : k;
    for (a = 0; a < 3; a++) above[a] = a == k ? 1.0 : 0.0;
    voxrti_cross(forward, above, right);
    (void)voxrti_unit(right);
    voxrti_cross(right, forward, above);
}

/* tan(fov_y/2), or 0 for an angle that is none */
static double voxrti_camera_tangent(const voxrt_camera *camera) {
    double fov = camera->fov_y != 0.0f ? (double)camera->fov_y : 40.0, s, c;
    if (!(fov > 0.0 && fov < 180.0)) return 0.0;
    voxrti_sincos(fov * (3.14159265358979323846 / 360.0), &s, &c);
    return s / c;
}

static voxrt_result voxrti_frame_open(const voxrt_camera *camera, uint32_t height, voxrti_frame *f) {
    double tangent = voxrti_camera_tangent(camera);
    uint32_t a;
    for (a = 0; a < 3; a++) {
        if (!voxrti_finite_f(camera->eye[a]) || !voxrti_finite_f(camera->at[a]) || !voxrti_finite_f(camera->up[a]))
            return VOXRT_ERR_INVALID_ARG;
        f->eye[a] = camera->eye[a];
        f->forward[a] = (double)camera->at[a] - (double)camera->eye[a];
    }
    if (!(tangent > 0.0) || !voxrti_unit(f->forward)) return VOXRT_ERR_INVALID_ARG;
    voxrti_frame_axes(f->forward, camera->up, f->right, f->up);
    f->pixel = height != 0 ? 2.0 * tangent / (double)height : 0.0;
    for (a = 0; a < 3; a++) {
        f->right[a] *= f->pixel;
        f->up[a] *= f->pixel;
    }
    return VOXRT_OK;
}

VOXRT_DEF voxrt_result voxrt_camera_ray(const voxrt_camera *camera, uint32_t width, uint32_t height, double x, double y,
                                        voxrt_ray *out_ray) {
    voxrti_frame f;
    voxrt_result r;
    if (camera == NULL || out_ray == NULL || height == 0) return VOXRT_ERR_INVALID_ARG;
    r = voxrti_frame_open(camera, height, &f);
    if (r == VOXRT_OK) voxrti_frame_ray(&f, x - 0.5 * (double)width, 0.5 * (double)height - y, out_ray);
    return r;
}

/* Fitting a camera of given direction: a point at (x, y, z) (right, above, towards the eye) is in the picture when
   |x - cx| <= (distance - z) * tan_x, so the extremes of +-x + z * tan_x fix the least distance and the shift. */
typedef struct voxrti_fit {
    double origin[3];            /* world */
    double right[3], above[3], back[3], tan_x, tan_y;
    double most[4];              /* of x + z tan_x, -x + z tan_x, y + z tan_y, -y + z tan_y */
    double size;                 /* extent */
} voxrti_fit;

/* An axis-parallel box: centre and half its edges. */
static void voxrti_fit_box(voxrti_fit *f, const double centre[3], const double half[3]) {
    double at[4] = {0.0, 0.0, 0.0, 0.0};
    uint32_t a, k;
    for (a = 0; a < 3; a++) {
        double p = centre[a] - f->origin[a], g[4];
        g[0] = f->right[a] + f->tan_x * f->back[a];
        g[1] = -f->right[a] + f->tan_x * f->back[a];
        g[2] = f->above[a] + f->tan_y * f->back[a];
        g[3] = -f->above[a] + f->tan_y * f->back[a];
        for (k = 0; k < 4; k++) at[k] += p * g[k] + half[a] * voxrti_abs(g[k]);
        f->size = voxrti_max(f->size, 2.0 * half[a]);
    }
    for (k = 0; k < 4; k++) f->most[k] = voxrti_max(f->most[k], at[k]);
}

static voxrt_result voxrti_fit_open(voxrti_fit *f, const voxrt_camera *camera, const float view[3], uint32_t width,
                                    uint32_t height) {
    double forward[3];
    uint32_t a;
    memset(f, 0, sizeof *f);
    f->tan_y = voxrti_camera_tangent(camera);
    f->tan_x = width != 0 && height != 0 ? f->tan_y * (double)width / (double)height : f->tan_y;
    if (!(f->tan_y > 0.0)) return VOXRT_ERR_INVALID_ARG;
    for (a = 0; a < 4; a++) f->most[a] = -VOXRTI_INF;
    if (view != NULL) {
        for (a = 0; a < 3; a++) f->back[a] = (double)view[a];
    } else { /* `up` and the x axis say where the front is: +z with y up, -y with z up */
        double side[3], front[3], up[3];
        for (a = 0; a < 3; a++) up[a] = (double)camera->up[a];
        if (!voxrti_unit(up)) {
            up[0] = up[2] = 0.0;
            up[1] = 1.0;
        }
        for (a = 0; a < 3; a++) side[a] = a == 0 ? 1.0 : 0.0;
        voxrti_cross(side, up, front);
        if (front[0] * front[0] + front[1] * front[1] + front[2] * front[2] < 1e-3) {
            side[0] = 0.0;
            side[1] = 1.0;
            voxrti_cross(side, up, front);
        }
        (void)voxrti_unit(front);
        voxrti_cross(up, front, side);
        for (a = 0; a < 3; a++) f->back[a] = 0.6 * side[a] + 0.42 * up[a] + front[a];
    }
    if (!voxrti_unit(f->back)) return VOXRT_ERR_INVALID_ARG;
    for (a = 0; a < 3; a++) forward[a] = -f->back[a];
    voxrti_frame_axes(forward, camera->up, f->right, f->above);
    return VOXRT_OK;
}

static voxrt_result voxrti_fit_close(const voxrti_fit *f, voxrt_camera *camera) {
    double distance =
        voxrti_max((f->most[0] + f->most[1]) / (2.0 * f->tan_x), (f->most[2] + f->most[3]) / (2.0 * f->tan_y));
    double x = 0.5 * (f->most[0] - f->most[1]), y = 0.5 * (f->most[2] - f->most[3]);
    double at[3], eye[3];
    uint32_t a;
    distance = f->size > 0.0 ? 1.04 * distance + 0.01 * f->size : 1.0;
    for (a = 0; a < 3; a++) {
        at[a] = f->origin[a] + x * f->right[a] + y * f->above[a];
        eye[a] = at[a] + distance * f->back[a];
        if (!(voxrti_abs(at[a]) <= 3e38) || !(voxrti_abs(eye[a]) <= 3e38)) return VOXRT_ERR_INVALID_ARG;
    }
    for (a = 0; a < 3; a++) {
        camera->at[a] = (float)at[a];
        camera->eye[a] = (float)eye[a];
    }
    return VOXRT_OK;
}

VOXRT_DEF voxrt_result voxrt_camera_fit(voxrt_camera *camera, const double box_min[3], const double box_max[3],
                                        const float view[3], uint32_t width, uint32_t height) {
    voxrti_fit f;
    double half[3];
    uint32_t a;
    voxrt_result r;
    if (camera == NULL || box_min == NULL || box_max == NULL) return VOXRT_ERR_INVALID_ARG;
    r = voxrti_fit_open(&f, camera, view, width, height);
    if (r != VOXRT_OK) return r;
    for (a = 0; a < 3; a++) {
        if (!voxrti_finite(box_min[a]) || !voxrti_finite(box_max[a]) || box_min[a] > box_max[a])
            return VOXRT_ERR_INVALID_ARG;
        f.origin[a] = 0.5 * (box_min[a] + box_max[a]);
        half[a] = 0.5 * (box_max[a] - box_min[a]);
    }
    voxrti_fit_box(&f, f.origin, half);
    return voxrti_fit_close(&f, camera);
}

typedef struct voxrti_fit_cells { voxrti_fit fit; const voxrt_tree *tree; double edge; } voxrti_fit_cells;

static int voxrti_fit_cell(void *user, const voxrt_voxel *v, uint32_t index) {
    voxrti_fit_cells *c = (voxrti_fit_cells *)user;
    double centre[3], half[3];
    (void)index;
    centre[0] = c->tree->origin[0] + ((double)v->x + 0.5) * c->edge;
    centre[1] = c->tree->origin[1] + ((double)v->y + 0.5) * c->edge;
    centre[2] = c->tree->origin[2] + ((double)v->z + 0.5) * c->edge;
    half[0] = half[1] = half[2] = 0.5 * c->edge;
    voxrti_fit_box(&c->fit, centre, half);
    return 0;
}

VOXRT_DEF voxrt_result voxrt_camera_fit_tree(voxrt_camera *camera, const voxrt_tree *tree, const float view[3],
                                             uint32_t width, uint32_t height) {
    voxrti_fit_cells c;
    uint32_t a, level;
    voxrt_result r;
    if (camera == NULL || tree == NULL) return VOXRT_ERR_INVALID_ARG;
    r = voxrti_fit_open(&c.fit, camera, view, width, height);
    if (r != VOXRT_OK) return r;
    level = tree->depth < 6 ? tree->depth : 6;
    c.tree = tree;
    c.edge = tree->voxel_size * (double)((uint32_t)1 << (tree->depth - level));
    for (a = 0; a < 3; a++)
        c.fit.origin[a] =
            tree->origin[a] + tree->voxel_size * 0.5 * ((double)tree->cell_min[a] + (double)tree->cell_max[a]);
    (void)voxrt_tree_each(tree, level, voxrti_fit_cell, &c);
    return voxrti_fit_close(&c.fit, camera);
}

/* ---- geometry ---- */

VOXRT_DEF void voxrt_tree_bounds(const voxrt_tree *tree, double box_min[3], double box_max[3]) {
    uint32_t a;
    for (a = 0; a < 3; a++) {
        box_min[a] = tree->origin[a] + tree->voxel_size * (double)tree->cell_min[a];
        box_max[a] = tree->origin[a] + tree->voxel_size * (double)tree->cell_max[a];
    }
}

static void voxrti_geometry_trace(void *user, const voxrt_trace_desc *desc, const voxrt_ray *rays,
                                  voxrt_surface *surfaces, size_t count) {
    voxrt_hit hit[VOXRTI_RUN];
    VOXRT_ASSERT(count <= VOXRTI_RUN);
    voxrti_tree_trace((const voxrt_tree *)user, desc, 0, rays, surfaces, hit, (uint32_t)count);
}
static void voxrti_geometry_occluded(void *user, const voxrt_trace_desc *desc, const voxrt_ray *rays, uint8_t *occluded,
                                     size_t count) {
    (void)voxrt_occluded((const voxrt_tree *)user, desc, rays, occluded, count);
}

VOXRT_DEF void voxrt_tree_geometry(const voxrt_tree *tree, voxrt_geometry *out_geometry) {
    out_geometry->trace_fn = voxrti_geometry_trace;
    out_geometry->occluded_fn = voxrti_geometry_occluded;
    memcpy(&out_geometry->user, &tree, sizeof tree); /* const goes away; the tree is only read */
    voxrt_tree_bounds(tree, out_geometry->box_min, out_geometry->box_max);
}

static void voxrti_octree_desc(const voxrt_trace_desc *desc, voxrt_octree_stats *stats, voxrt_octree_trace_desc *d) {
    memset(stats, 0, sizeof *stats);
    memset(d, 0, sizeof *d);
    d->isa = desc->isa;
    d->max_level_plus_1 = desc->max_level_plus_1;
    d->stats = desc->stats != NULL ? stats : NULL;
}
static void voxrti_octree_add(const voxrt_trace_desc *desc, const voxrt_octree_stats *stats) {
    if (desc->stats == NULL) return;
    desc->stats->rays += stats->rays;
    desc->stats->hits += stats->hits;
    desc->stats->bad_rays += stats->bad_rays;
    desc->stats->steps += stats->outer;
    desc->stats->descents += stats->inner;
}

/* Packets are four rays in order: the same pixels form one at any resolution and on any thread. */
static void voxrti_octree_trace(void *user, const voxrt_trace_desc *desc, const voxrt_ray *rays,
                                voxrt_surface *surfaces, size_t count) {
    const voxrt_octree *t = (const voxrt_octree *)user;
    voxrt_octree_trace_desc d;
    voxrt_octree_stats stats;
    voxrt_hit hit[VOXRTI_RUN];
    float normal[3 * VOXRTI_RUN];
    size_t i;
    VOXRT_ASSERT(count <= VOXRTI_RUN);
    voxrti_octree_desc(desc, &stats, &d);
    if (voxrt_octree_trace(t, &d, rays, hit, count) != VOXRT_OK) return;
    voxrti_octree_add(desc, &stats);
    voxrt_octree_hit_normals(t, hit, normal, count);
    for (i = 0; i < count; i++) {
        voxrt_surface *s = &surfaces[i];
        if (hit[i].node == VOXRT_NO_NODE) continue;
        s->t = hit[i].t;
        s->face = hit[i].face;
        s->edge = (float)(t->voxel_size * (double)((uint32_t)1 << (t->depth - hit[i].level)));
        voxrt_octree_hit_color(t, &hit[i], s->rgb);
        if (t->has_normals) memcpy(s->normal, normal + 3 * i, sizeof s->normal);
    }
}
static void voxrti_octree_occluded(void *user, const voxrt_trace_desc *desc, const voxrt_ray *rays, uint8_t *occluded,
                                   size_t count) {
    voxrt_octree_trace_desc d;
    voxrt_octree_stats stats;
    voxrt_hit hit[VOXRTI_RUN];
    size_t i;
    VOXRT_ASSERT(count <= VOXRTI_RUN);
    voxrti_octree_desc(desc, &stats, &d);
    if (voxrt_octree_trace((const voxrt_octree *)user, &d, rays, hit, count) != VOXRT_OK) return;
    voxrti_octree_add(desc, &stats);
    for (i = 0; i < count; i++) occluded[i] = hit[i].node != VOXRT_NO_NODE;
}

VOXRT_DEF void voxrt_octree_geometry(const voxrt_octree *octree, voxrt_geometry *out_geometry) {
    uint32_t a;
    out_geometry->trace_fn = voxrti_octree_trace;
    out_geometry->occluded_fn = voxrti_octree_occluded;
    memcpy(&out_geometry->user, &octree, sizeof octree);
    for (a = 0; a < 3; a++) {
        out_geometry->box_min[a] = octree->origin[a];
        out_geometry->box_max[a] = octree->origin[a] + octree->voxel_size * (double)((uint32_t)1 << octree->depth);
    }
}

/* ---- the picture ---- */

static int voxrti_finite3(const float *v) {
    return voxrti_finite_f(v[0]) && voxrti_finite_f(v[1]) && voxrti_finite_f(v[2]);
}

/* Box of all that is to be seen; 0: nothing, or not finite. */
static int voxrti_render_box(const voxrti_render *c, double lo[3], double hi[3]) {
    size_t g;
    uint32_t a;
    for (a = 0; a < 3; a++) {
        lo[a] = VOXRTI_INF;
        hi[a] = -VOXRTI_INF;
    }
    if (c->tree != NULL) voxrt_tree_bounds(c->tree, lo, hi);
    for (g = 0; g < c->d->geometry_count; g++) {
        for (a = 0; a < 3; a++) {
            lo[a] = voxrti_min(lo[a], c->d->geometry[g].box_min[a]);
            hi[a] = voxrti_max(hi[a], c->d->geometry[g].box_max[a]);
        }
    }
    for (a = 0; a < 3; a++) {
        if (!voxrti_finite(lo[a]) || !voxrti_finite(hi[a]) || lo[a] > hi[a]) return 0;
    }
    return 1;
}

/* Lights that go with any camera: over its left shoulder, and a weak one from the right. */
static void voxrti_default_lights(voxrti_render *c) {
    static const float place[2][3] = {{-0.75f, 0.85f, 0.6f}, {0.9f, -0.05f, 0.5f}};
    static const float color[2][3] = {{0.76f, 0.74f, 0.7f}, {0.1f, 0.115f, 0.14f}};
    uint32_t l, a;
    for (l = 0; l < 2; l++) {
        for (a = 0; a < 3; a++) {
            double px = c->frame.pixel > 0.0 ? 1.0 / c->frame.pixel : 0.0;
            c->light[l].position[a] = (float)(((double)place[l][0] * c->frame.right[a] +
                                               (double)place[l][1] * c->frame.up[a]) * px -
                                              (double)place[l][2] * c->frame.forward[a]);
            c->light[l].color[a] = color[l][a];
        }
        c->light[l].directional = 1;
        c->light[l].no_shadow = l != 0;
    }
    c->lights = c->light;
    c->light_count = 2;
}

/* One level for the whole object: the cells of its nearest point are about `pixels` wide (thesis 4.3.1). */
static uint32_t voxrti_object_level(const voxrti_render *c, double pixels) {
    const voxrt_tree *t = c->tree;
    double lo[3], hi[3], square = 0.0, width, edge = t->voxel_size;
    uint32_t a, level = t->depth;
    voxrt_tree_bounds(t, lo, hi);
    for (a = 0; a < 3; a++) {
        double e = (double)c->frame.eye[a], d = voxrti_max(voxrti_max(lo[a] - e, e - hi[a]), 0.0);
        square += d * d;
    }
    width = pixels * c->frame.pixel * sqrt(square);
    while (level > 0 && 2.0 * edge <= width) {
        edge *= 2.0;
        level--;
    }
    return level;
}

/* Colours and factors: products of two of them, summed up over lights and samples, stay finite. */
VOXRTI_INLINE int voxrti_amount(float x) { return voxrti_absf(x) <= 1e12f; }

/* What is wrong with the desc but for the camera; NULL: nothing. */
static const char *voxrti_render_bad(const voxrt_render_desc *d, const voxrti_render *c) {
    const voxrt_material *m = d->material;
    size_t i;
    uint32_t a;
    if ((uint32_t)d->view > 6u || (uint32_t)d->stage > 3u || (uint32_t)d->isa > 4u)
        return "render: no such view, stage or isa";
    if (!(d->tolerance >= 0.0f) || !voxrti_finite_f(d->tolerance)) return "render: bad tolerance";
    if (d->first_sample > 0xff000000u || d->samples > 0x00ffffffu || d->pixel_step > 8)
        return "render: first_sample, samples or pixel_step is too large";
    if (c->tree == NULL && d->geometry == NULL) return "render: nothing to draw: no tree and no geometry";
    if (d->geometry == NULL && d->geometry_count != 0) return "render: geometry is NULL";
    for (i = 0; i < d->geometry_count; i++)
        if (d->geometry[i].trace_fn == NULL || d->geometry[i].occluded_fn == NULL)
            return "render: geometry without functions";
    if (d->lights == NULL && d->light_count != 0) return "render: lights is NULL";
    for (i = 0; i < d->light_count; i++) {
        if (!voxrti_finite3(d->lights[i].position)) return "render: place of a light is not finite";
        for (a = 0; a < 3; a++)
            if (!voxrti_amount(d->lights[i].color[a])) return "render: colour of a light is not within -1e12 and 1e12";
    }
    for (a = 0; m != NULL && a < 3; a++)
        if (!voxrti_amount(m->ambient[a])) return "render: ambient is not within -1e12 and 1e12";
    if (m != NULL && (!voxrti_amount(m->diffuse) || !voxrti_amount(m->specular) ||
                      !voxrti_amount(m->shininess) || m->shininess < 0.0f))
        return "render: bad material";
    for (a = 0; a < 4; a++)
        if (!voxrti_amount(d->background[a])) return "render: background is not within -1e12 and 1e12";
    return NULL;
}

/* *what: what is wrong, if something is. */
static voxrt_result voxrti_render_open(const voxrt_render_desc *d, voxrti_render *c, const char **what) {
    const voxrt_image *m = c->image;
    voxrt_camera camera = d->camera;
    double lo[3], hi[3];
    uint32_t l, level;
    voxrt_result r;
    *what = voxrti_render_bad(d, c);
    if (*what != NULL) return VOXRT_ERR_INVALID_ARG;
    *what = "render: the camera cannot frame what is drawn: its box is not finite, or the angle is not in (0, 180)";
    if (camera.eye[0] == camera.at[0] && camera.eye[1] == camera.at[1] && camera.eye[2] == camera.at[2]) {
        if (!voxrti_render_box(c, lo, hi)) return VOXRT_ERR_INVALID_ARG;
        if (c->tree != NULL && d->geometry_count == 0)
            r = voxrt_camera_fit_tree(&camera, c->tree, NULL, m->width, m->height);
        else
            r = voxrt_camera_fit(&camera, lo, hi, NULL, m->width, m->height);
        if (r != VOXRT_OK) return r;
    }
    *what = "render: bad camera: a number is not finite, eye equals at, or the angle is not in (0, 180)";
    r = voxrti_frame_open(&camera, m->height, &c->frame);
    if (r != VOXRT_OK) return r;
    c->samples = d->samples != 0 ? d->samples : 1;
    c->transparent = 1;
    for (l = 0; l < 4; l++) {
        c->transparent &= d->background[l] == 0.0f;
        c->background[l] = d->background[l];
    }
    if (d->thesis_compose) {
        c->background[3] = 255.0f * d->background[3];
        for (l = 0; l < 3 && d->background[3] > 0.0f; l++)
            c->background[l] = c->background[3] *
                               (float)voxrti_linear_to_srgb((double)d->background[l] / (double)d->background[3]);
    }
    c->material.ambient[0] = c->material.ambient[1] = c->material.ambient[2] = 0.05f;
    c->material.diffuse = 1.0f;
    if (d->material != NULL) c->material = *d->material;
    c->lights = d->lights;
    c->light_count = d->light_count;
    if (d->lights == NULL) voxrti_default_lights(c);
    c->trace.isa = d->isa;
    c->trace.max_level_plus_1 = d->max_level_plus_1;
    if (d->object_lod && c->tree != NULL) {
        level = voxrti_object_level(c, d->tolerance > 0.0f ? (double)d->tolerance : 1.0) + 1;
        if (d->max_level_plus_1 == 0 || level < d->max_level_plus_1) c->trace.max_level_plus_1 = level;
    } else if (!d->object_lod) {
        c->trace.cone_spread = (float)((double)d->tolerance * c->frame.pixel);
    }
    c->coarse = c->trace;
    if (d->lod_split != 0 && (c->trace.max_level_plus_1 == 0 || d->lod_split < c->trace.max_level_plus_1))
        c->coarse.max_level_plus_1 = d->lod_split;
    voxrti_srgb_open(&c->srgb);
    return VOXRT_OK;
}

VOXRT_DEF voxrt_result voxrt_render(const voxrt_render_desc *desc, const voxrt_tree *tree, const voxrt_image *image,
                                    voxrt_render_stats *stats) {
    voxrt_render_desc d;
    voxrti_render c;
    voxrt_result r;
    uint32_t rows, y;
    const char *what;
    memset(&d, 0, sizeof d);
    if (desc != NULL) d = *desc;
    if (d._begin_zero != 0 || d._end_zero != 0) return VOXRT_ERR_UNINIT_DESC;
    if (image == NULL) return VOXRT_ERR_INVALID_ARG;
    memset(&c, 0, sizeof c);
    c.d = &d;
    c.image = image;
    c.tree = tree;
    c.count = stats != NULL;
    r = voxrti_render_open(&d, &c, &what);
    if (r != VOXRT_OK) return voxrti_fail(d.env.error, r, 0, what);
    if (image->width == 0 || image->height == 0) return VOXRT_OK;
    c.step = d.pixel_step != 0 ? d.pixel_step : 1;
    c.tile = c.step < 3 ? 32 : 8 * c.step;
    c.tiles_x = (image->width - 1) / c.tile + 1;
    rows = (image->height - 1) / c.tile + 1;
    if ((uint64_t)c.tiles_x * rows > 0x7fffffffu)
        return voxrti_fail(d.env.error, VOXRT_ERR_RANGE, 0, "picture too large");
    if (d.env.progress_fn == NULL) {
        voxrti_parallel_for(&d.env, voxrti_render_tile, &c, c.tiles_x * rows);
    } else {
        for (y = 0; y < rows; y++) {
            c.first_tile = y * c.tiles_x;
            voxrti_parallel_for(&d.env, voxrti_render_tile, &c, c.tiles_x);
            if (d.env.progress_fn(d.env.progress_user, y + 1, rows) != 0)
                return voxrti_fail(d.env.error, VOXRT_ERR_CANCELLED, y, "cancelled");
        }
    }
    if (d.states != NULL && d.states->frame_fn != NULL) d.states->frame_fn(d.states->user, image);
    if (stats != NULL) {
        voxrti_stats_add(&stats->primary, c.sum[0]);
        voxrti_stats_add(&stats->shadow, c.sum[1]);
    }
    return VOXRT_OK;
}

/* ---------------------------------------------------------------------------
   post: work on finished pictures: encode, blur, keep to a frame time.          // >>post
   --------------------------------------------------------------------------- */

typedef struct voxrti_post {
    const voxrt_image *image;
    const voxrt_blur_desc *d;
    float *copy;        /* rgba before (rows), or after the first pass (columns) */
    float weight[65];
    uint32_t radius, vertical;
    voxrti_srgb srgb;
} voxrti_post;

static void voxrti_encode_row(void *ctx, uint32_t y) {
    voxrti_post *p = (voxrti_post *)ctx;
    const voxrt_image *m = p->image;
    uint32_t x, a;
    for (x = 0; x < m->width; x++) {
        float v[4];
        uint8_t *out = (uint8_t *)voxrti_pixel(m->rgba8, m->rgba8_stride, 4, m->width, x, y);
        memcpy(v, voxrti_pixel(m->rgba, m->rgba_stride, 16, m->width, x, y), sizeof v);
        for (a = 0; a < 3; a++)
            out[a] = voxrti_srgb_byte(&p->srgb, v[3] > 0.0f && v[3] < 1.0f ? v[a] / v[3] : v[a]);
        out[3] = voxrti_unit_byte(v[3] * 255.0f);
    }
}

VOXRT_DEF voxrt_result voxrt_image_encode(const voxrt_env *env, const voxrt_image *image) {
    voxrt_env none;
    voxrti_post p;
    memset(&none, 0, sizeof none);
    if (env != NULL && env->error != NULL) memset(env->error, 0, sizeof *env->error);
    if (image == NULL || image->rgba == NULL || image->rgba8 == NULL)
        return voxrti_fail(env != NULL ? env->error : NULL, VOXRT_ERR_INVALID_ARG, 0, "image: no rgba or no rgba8");
    memset(&p, 0, sizeof p);
    p.image = image;
    voxrti_srgb_open(&p.srgb);
    if (image->width != 0) voxrti_parallel_for(env != NULL ? env : &none, voxrti_encode_row, &p, image->height);
    return VOXRT_OK;
}

/* One row of one pass of a separable Gauss; at the border the kernel is cut and weighed anew. */
static void voxrti_blur_row(void *ctx, uint32_t y) {
    voxrti_post *p = (voxrti_post *)ctx;
    const voxrt_image *m = p->image;
    int64_t w = m->width, h = m->height, r = p->radius, x, k;
    uint32_t a;
    for (x = 0; x < w; x++) {
        int64_t at = p->vertical ? (int64_t)y : x, end = p->vertical ? h : w;
        int64_t from = at - r > 0 ? at - r : 0, to = at + r < end - 1 ? at + r : end - 1;
        float sum[4], total = 0.0f, v[4];
        memset(sum, 0, sizeof sum);
        for (k = from; k <= to; k++) {
            float weight = p->weight[k < at ? at - k : k - at];
            if (p->vertical) memcpy(v, p->copy + 4 * (k * w + x), sizeof v);
            else memcpy(v, voxrti_pixel(m->rgba, m->rgba_stride, 16, m->width, (uint32_t)k, y), sizeof v);
            for (a = 0; a < 4; a++) sum[a] += weight * v[a];
            total += weight;
        }
        for (a = 0; a < 4; a++) v[a] = sum[a] / total;
        if (p->vertical) memcpy(voxrti_pixel(m->rgba, m->rgba_stride, 16, m->width, (uint32_t)x, y), v, sizeof v);
        else memcpy(p->copy + 4 * ((int64_t)y * w + x), v, sizeof v);
    }
}

/* One row of the blur that knows voxels (thesis 4.2.2): the radius is the width of the pixel's voxel, and only pixels
   of the same surface take part: depth within three voxels, normals less than 60 degrees apart. */
static void voxrti_smooth_row(void *ctx, uint32_t y) {
    voxrti_post *p = (voxrti_post *)ctx;
    const voxrt_image *m = p->image;
    int64_t w = m->width, h = m->height, x, i, j;
    uint32_t a;
    for (x = 0; x < w; x++) {
        float sum[4], total = 0.0f, v[4], depth, other, edge, pixels, n[3], o[3];
        voxrt_hit hit;
        int64_t r;
        memcpy(v, p->copy + 4 * ((int64_t)y * w + x), sizeof v);
        memcpy(&depth, voxrti_pixel(m->depth, m->depth_stride, 4, m->width, (uint32_t)x, y), 4);
        memcpy(&hit, voxrti_pixel(m->hit, m->hit_stride, sizeof hit, m->width, (uint32_t)x, y), sizeof hit);
        if (!(depth < INFINITY) || hit.node == VOXRT_NO_NODE || hit.level > p->d->depth) continue;
        edge = p->d->voxel_size * (float)((uint32_t)1 << (p->d->depth - hit.level));
        pixels = edge / (p->d->footprint * depth);
        if (!(pixels > 1.5f)) continue;
        if (pixels > p->d->radius) pixels = p->d->radius;
        r = (int64_t)pixels;
        memset(n, 0, sizeof n);
        if (m->normal != NULL) memcpy(n, voxrti_pixel(m->normal, m->normal_stride, 12, m->width, (uint32_t)x, y), 12);
        memset(sum, 0, sizeof sum);
        for (j = -r; j <= r; j++) {
            if ((int64_t)y + j < 0 || (int64_t)y + j >= h) continue;
            for (i = -r; i <= r; i++) {
                uint32_t u = (uint32_t)(x + i), t = (uint32_t)((int64_t)y + j);
                float weight, q = (float)(i * i + j * j) / (pixels * pixels);
                if (x + i < 0 || x + i >= w || q > 1.0f) continue;
                memcpy(&other, voxrti_pixel(m->depth, m->depth_stride, 4, m->width, u, t), 4);
                if (!(other - depth < 3.0f * edge && depth - other < 3.0f * edge)) continue;
                if (m->normal != NULL) {
                    memcpy(o, voxrti_pixel(m->normal, m->normal_stride, 12, m->width, u, t), 12);
                    if (!(voxrti_dot3(n, o) > 0.5f)) continue;
                }
                weight = (1.0f - q) * (1.0f - q) + 1e-3f;
                memcpy(v, p->copy + 4 * ((int64_t)t * w + u), sizeof v);
                for (a = 0; a < 4; a++) sum[a] += weight * v[a];
                total += weight;
            }
        }
        if (!(total > 0.0f)) continue;
        for (a = 0; a < 4; a++) v[a] = sum[a] / total;
        memcpy(voxrti_pixel(m->rgba, m->rgba_stride, 16, m->width, (uint32_t)x, y), v, sizeof v);
    }
}

VOXRT_DEF voxrt_result voxrt_blur(const voxrt_blur_desc *desc, const voxrt_image *image) {
    voxrt_blur_desc d;
    voxrti_post p;
    voxrti_mem mem;
    voxrt_result r;
    size_t bytes;
    uint32_t i, y;
    const char *why;
    memset(&d, 0, sizeof d);
    if (desc != NULL) d = *desc;
    if (d._begin_zero != 0 || d._end_zero != 0) return VOXRT_ERR_UNINIT_DESC;
    if (d.env.error != NULL) memset(d.env.error, 0, sizeof *d.env.error);
    if (d.radius == 0.0f) d.radius = 4.0f;
    why = image == NULL || image->rgba == NULL ? "image: rgba is missing" :
          !(d.radius > 0.0f && d.radius <= 64.0f) ? "radius: not above 0 and up to 64" :
          !(d.footprint >= 0.0f) ? "footprint: not a number from 0" :
          d.depth > VOXRT_MAX_DEPTH ? "depth: more levels than a tree has" :
          d.footprint > 0.0f && (image->depth == NULL || image->hit == NULL) ? "footprint: needs depth and hit" :
          d.footprint > 0.0f && !(d.voxel_size > 0.0f) ? "footprint: needs voxel_size" : NULL;
    if (why != NULL) return voxrti_fail(d.env.error, VOXRT_ERR_INVALID_ARG, 0, why);
    r = voxrti_env_open(&d.env, &mem);
    if (r != VOXRT_OK || image->width == 0 || image->height == 0) return r;
    memset(&p, 0, sizeof p);
    p.image = image;
    p.d = &d;
    p.radius = (uint32_t)d.radius;
    for (i = 0; i <= p.radius; i++) {
        double q = 2.0 * (double)i / (double)d.radius; /* in standard deviations */
        p.weight[i] = (float)voxrti_exp2(-0.72134752044448170368 * q * q);
    }
    if (voxrti_mul_size((size_t)image->width * 16, image->height, &bytes)) p.copy = (float *)voxrti_alloc(&mem, bytes);
    if (p.copy == NULL) return voxrti_fail(d.env.error, VOXRT_ERR_NO_MEMORY, 0, "out of memory");
    if (d.footprint > 0.0f) {
        for (y = 0; y < image->height; y++)
            memcpy(p.copy + (size_t)4 * y * image->width,
                   voxrti_pixel(image->rgba, image->rgba_stride, 16, image->width, 0, y), (size_t)16 * image->width);
        voxrti_parallel_for(&d.env, voxrti_smooth_row, &p, image->height);
    } else {
        voxrti_parallel_for(&d.env, voxrti_blur_row, &p, image->height);
        p.vertical = 1;
        voxrti_parallel_for(&d.env, voxrti_blur_row, &p, image->height);
    }
    voxrti_free(&mem, p.copy);
    return image->rgba8 != NULL ? voxrt_image_encode(&d.env, image) : VOXRT_OK;
}

/* Two levers. Rays for blocks of pixels: a frame then costs between 1/step and 1/step^2, as rays that are farther apart
   share less. So the step is chosen by the one and goes back by the other, when the frame would fit with something to
   spare. When frames get dearer, as in an approach, the next is taken to be dearer by as much. And within that the
   tolerance, by a PI controller on its logarithm: it is worth 10 to 40 % at most (the work for each pixel stays), so
   what is over by more is left to the step. */
VOXRT_DEF float voxrt_budget_update(voxrt_budget *budget, float frame_ms, float target_ms, float finest) {
    double lowest = finest > 0.0f ? voxrti_min((double)finest, 64.0) : 0.25, limit = voxrti_log2(64.0 / lowest);
    double ratio, error, over, growth = 1.0;
    uint32_t step = budget->pixel_step < 1 ? 1 : budget->pixel_step > 8 ? 8 : budget->pixel_step;
    limit = voxrti_min(limit, 2.0);
    if (frame_ms > 0.0f && target_ms > 0.0f && voxrti_finite_f(frame_ms) && voxrti_finite_f(target_ms)) {
        ratio = (double)frame_ms / (double)target_ms;
        if (budget->_step == step && budget->_bias <= budget->bias && budget->_frame_ms > 0.0f)
            growth = voxrti_max(1.0, voxrti_min(1.3, (double)frame_ms / (double)budget->_frame_ms));
        budget->_step = step;
        budget->_bias = budget->bias;
        budget->_frame_ms = frame_ms;
        over = ratio * growth / (1.0 + 0.1 * (limit - (double)budget->bias)); /* what the tolerance will not do */
        if (over > 1.0 && step < 8) {
            uint32_t next = step + 1;
            while (next < 8 && over * (double)step > (double)next) next++;
            step = next;
        } else if (step > 1 && ratio * growth * (double)(step * step) < 0.95 * (double)((step - 1) * (step - 1))) {
            step--;
        }
        error = voxrti_log2(ratio) + 0.1; /* aims a little below the budget */
        error = voxrti_max(-2.0, voxrti_min(2.0, error));
        budget->sum = (float)voxrti_max(0.0, voxrti_min(limit, (double)budget->sum + 0.7 * error));
        budget->bias = (float)voxrti_max(0.0, voxrti_min(limit, (double)budget->sum + 0.3 * error));
    }
    budget->pixel_step = step;
    return (float)voxrti_min(64.0, lowest * voxrti_exp2((double)budget->bias) * (double)step);
}

/* ---------------------------------------------------------------------------
   scene: geometry in other places, and many geometries as one.                  // >>scene
   An instance takes rays into the space of its geometry without making their directions unit length again: t is the
   same in both. A group is a binary tree of boxes, 32 bytes each, in pre-order: objects sorted by the Morton codes of
   their centres, halved down to single ones. Runs of rays go through it together, with one bit a ray.
   --------------------------------------------------------------------------- */

/* out = 3x4 matrix times (v, w) */
static void voxrti_affine(const double m[12], const double v[3], double w, double out[3]) {
    uint32_t a;
    for (a = 0; a < 3; a++) out[a] = m[4 * a] * v[0] + m[4 * a + 1] * v[1] + m[4 * a + 2] * v[2] + m[4 * a + 3] * w;
}

/* Inverse of an affine map by cofactors; 0: there is none, or not all is finite. */
static int voxrti_affine_invert(const double m[12], double out[12]) {
    double det = 0.0, size = 0.0, at[3], o[3];
    uint32_t a, b;
    for (a = 0; a < 3; a++) {
        for (b = 0; b < 3; b++) {
            uint32_t p = 4 * ((b + 1) % 3), q = 4 * ((b + 2) % 3), i = (a + 1) % 3, k = (a + 2) % 3;
            out[4 * a + b] = m[p + i] * m[q + k] - m[p + k] * m[q + i];
            size = voxrti_max(size, voxrti_abs(m[4 * a + b]));
        }
    }
    for (a = 0; a < 3; a++) det += m[4 * a] * out[a];
    if (!(voxrti_abs(det) > 1e-12 * size * size * size) || !voxrti_finite(det)) return 0;
    for (a = 0; a < 3; a++) {
        for (b = 0; b < 3; b++) out[4 * a + b] /= det;
        out[4 * a + 3] = 0.0;
        at[a] = m[4 * a + 3];
    }
    voxrti_affine(out, at, 0.0, o);
    for (a = 0; a < 3; a++) out[4 * a + 3] = -o[a];
    return voxrti_finite(o[0]) && voxrti_finite(o[1]) && voxrti_finite(o[2]);
}

static void voxrti_instance_rays(const voxrt_instance *s, const voxrt_trace_desc *desc, const voxrt_ray *rays,
                                 size_t count, voxrt_ray *out, voxrt_trace_desc *d) {
    size_t i;
    uint32_t a;
    VOXRT_ASSERT(count <= VOXRTI_RUN);
    *d = *desc;
    d->cone_width = (float)((double)desc->cone_width / s->_stretch);
    d->cone_spread = (float)((double)desc->cone_spread / s->_stretch);
    for (i = 0; i < count; i++) {
        double org[3], dir[3], o[3], v[3];
        for (a = 0; a < 3; a++) {
            org[a] = (double)rays[i].org[a];
            dir[a] = (double)rays[i].dir[a];
        }
        voxrti_affine(s->_to_object, org, 1.0, o);
        voxrti_affine(s->_to_object, dir, 0.0, v);
        out[i] = rays[i];
        for (a = 0; a < 3; a++) {
            out[i].org[a] = (float)o[a];
            out[i].dir[a] = (float)v[a];
        }
    }
}

/* Normal and face of an object, seen from the world: normals go by the transposed inverse. */
static void voxrti_instance_surface(const voxrt_instance *s, voxrt_surface *surface) {
    const double *m = s->_to_object, *row;
    double n[3] = {0.0, 0.0, 0.0};
    uint32_t a, k, axis = 0, face = surface->face, stored = 0;
    if (!(surface->t < INFINITY)) return;
    surface->edge = (float)((double)surface->edge * s->_stretch);
    for (a = 0; a < 3; a++) stored |= surface->normal[a] != 0.0f;
    if (face < 6) {
        row = m + 4 * (face >> 1);
        for (a = 1; a < 3; a++) axis = voxrti_abs(row[a]) > voxrti_abs(row[axis]) ? a : axis;
        surface->face = (uint8_t)(2 * axis + ((row[axis] > 0.0) == ((face & 1u) != 0)));
        if (row[(axis + 1) % 3] == 0.0 && row[(axis + 2) % 3] == 0.0 && !stored) return; /* the face says it all */
    } else if (!stored) {
        return;
    }
    for (a = 0; a < 3; a++) {
        for (k = 0; k < 3; k++) {
            double v = stored ? (double)surface->normal[k] : k == face >> 1 ? ((face & 1u) != 0 ? 1.0 : -1.0) : 0.0;
            n[a] += m[4 * k + a] * v;
        }
    }
    (void)voxrti_unit(n);
    for (a = 0; a < 3; a++) surface->normal[a] = (float)n[a];
}

static void voxrti_instance_trace(void *user, const voxrt_trace_desc *desc, const voxrt_ray *rays,
                                  voxrt_surface *surfaces, size_t count) {
    const voxrt_instance *s = (const voxrt_instance *)user;
    voxrt_ray own[VOXRTI_RUN];
    voxrt_trace_desc d;
    size_t i;
    voxrti_instance_rays(s, desc, rays, count, own, &d);
    s->geometry.trace_fn(s->geometry.user, &d, own, surfaces, count);
    for (i = 0; i < count; i++) voxrti_instance_surface(s, &surfaces[i]);
}
static void voxrti_instance_occluded(void *user, const voxrt_trace_desc *desc, const voxrt_ray *rays, uint8_t *occluded,
                                     size_t count) {
    const voxrt_instance *s = (const voxrt_instance *)user;
    voxrt_ray own[VOXRTI_RUN];
    voxrt_trace_desc d;
    voxrti_instance_rays(s, desc, rays, count, own, &d);
    s->geometry.occluded_fn(s->geometry.user, &d, own, occluded, count);
}

VOXRT_DEF voxrt_result voxrt_instance_geometry(voxrt_instance *instance, voxrt_geometry *out_geometry) {
    uint32_t a, k;
    if (instance == NULL || out_geometry == NULL) return VOXRT_ERR_INVALID_ARG;
    if (instance->geometry.trace_fn == NULL || instance->geometry.occluded_fn == NULL) return VOXRT_ERR_INVALID_ARG;
    if (!voxrti_affine_invert(instance->to_world, instance->_to_object)) return VOXRT_ERR_INVALID_ARG;
    instance->_stretch = 0.0;
    for (a = 0; a < 3; a++) {
        const double *m = instance->to_world + a;
        instance->_stretch = voxrti_max(instance->_stretch, sqrt(m[0] * m[0] + m[4] * m[4] + m[8] * m[8]));
    }
    out_geometry->trace_fn = voxrti_instance_trace;
    out_geometry->occluded_fn = voxrti_instance_occluded;
    out_geometry->user = instance;
    for (a = 0; a < 3; a++) { /* each coordinate of the box is a sum of extremes */
        double lo = instance->to_world[4 * a + 3], hi = lo;
        for (k = 0; k < 3; k++) {
            double u = instance->to_world[4 * a + k] * instance->geometry.box_min[k];
            double v = instance->to_world[4 * a + k] * instance->geometry.box_max[k];
            lo += voxrti_min(u, v);
            hi += voxrti_max(u, v);
        }
        out_geometry->box_min[a] = lo;
        out_geometry->box_max[a] = hi;
    }
    return VOXRT_OK;
}

/* ---- groups ---- */

typedef struct voxrti_box { /* 32 bytes */
    float lo[3];
    uint32_t object; /* of a leaf; VOXRT_NO_NODE: an inner box */
    float hi[3];
    uint32_t right;  /* the second child; the first one is the next box */
} voxrti_box;

struct voxrt_group {
    voxrti_mem mem;
    voxrt_geometry *geometry; /* [count] */
    voxrti_box *box;          /* [2 count - 1] */
    size_t count;
    double lo[3], hi[3];
};

static void voxrti_heap_sort(uint64_t *a, size_t n) {
    size_t end = n, start = n / 2, i, k;
    while (end > 1) {
        uint64_t v;
        if (start > 0) {
            v = a[--start];
        } else {
            v = a[--end];
            a[end] = a[0];
        }
        for (i = start; (k = 2 * i + 1) < end; i = k) {
            if (k + 1 < end && a[k] < a[k + 1]) k++;
            if (a[k] <= v) break;
            a[i] = a[k];
        }
        a[i] = v;
    }
}

/* Boxes of the objects order[0 .. n-1] from number `at` on; returns the number behind them. */
static uint32_t voxrti_group_build(voxrt_group *g, const uint64_t *order, size_t n, uint32_t at) {
    voxrti_box *b = &g->box[at];
    uint32_t a, end;
    if (n == 1) {
        const voxrt_geometry *o = &g->geometry[order[0] & 0xffffffffu];
        b->object = (uint32_t)order[0];
        b->right = 0;
        for (a = 0; a < 3; a++) { /* a little larger, for the rounding to float and that of the tests */
            float lo = (float)o->box_min[a], hi = (float)o->box_max[a];
            b->lo[a] = lo - voxrti_absf(lo) * 2.4e-7f - 1e-30f;
            b->hi[a] = hi + voxrti_absf(hi) * 2.4e-7f + 1e-30f;
        }
        return at + 1;
    }
    end = voxrti_group_build(g, order, n / 2, at + 1);
    b->object = VOXRT_NO_NODE;
    b->right = end;
    end = voxrti_group_build(g, order + n / 2, n - n / 2, end);
    for (a = 0; a < 3; a++) {
        const voxrti_box *l = b + 1, *r = &g->box[b->right];
        b->lo[a] = l->lo[a] < r->lo[a] ? l->lo[a] : r->lo[a];
        b->hi[a] = l->hi[a] > r->hi[a] ? l->hi[a] : r->hi[a];
    }
    return end;
}

VOXRT_DEF voxrt_result voxrt_group_create(const voxrt_env *env, const voxrt_geometry *geometry, size_t count,
                                          voxrt_group **out_group) {
    voxrt_env e;
    voxrti_mem mem;
    voxrt_group *g;
    uint64_t *order;
    size_t i;
    uint32_t a;
    voxrt_result r;
    if (out_group == NULL) return VOXRT_ERR_INVALID_ARG;
    *out_group = NULL;
    memset(&e, 0, sizeof e);
    if (env != NULL) e = *env;
    if (e.error != NULL) memset(e.error, 0, sizeof *e.error);
    r = voxrti_env_open(&e, &mem);
    if (r != VOXRT_OK) return r;
    if (geometry == NULL || count == 0) return voxrti_fail(e.error, VOXRT_ERR_INVALID_ARG, 0, "no geometry");
    if (count > 0x7fffffffu) return voxrti_fail(e.error, VOXRT_ERR_RANGE, count, "% geometries are too many");
    for (i = 0; i < count; i++) {
        int ok = geometry[i].trace_fn != NULL && geometry[i].occluded_fn != NULL;
        for (a = 0; a < 3; a++)
            ok = ok && voxrti_abs(geometry[i].box_min[a]) < 1e38 && voxrti_abs(geometry[i].box_max[a]) < 1e38 &&
                 geometry[i].box_min[a] <= geometry[i].box_max[a];
        if (!ok) return voxrti_fail(e.error, VOXRT_ERR_INVALID_ARG, i, "geometry %: no functions or no finite box");
    }
    g = (voxrt_group *)voxrti_alloc_zero(&mem, 1, sizeof *g);
    order = (uint64_t *)voxrti_alloc_array(&mem, count, sizeof *order);
    if (g != NULL) {
        g->geometry = (voxrt_geometry *)voxrti_alloc_array(&mem, count, sizeof *g->geometry);
        g->box = (voxrti_box *)voxrti_alloc_array(&mem, 2 * count, sizeof *g->box);
    }
    if (g == NULL || order == NULL || g->geometry == NULL || g->box == NULL) {
        if (g != NULL) {
            voxrti_free(&mem, g->geometry);
            voxrti_free(&mem, g->box);
        }
        voxrti_free(&mem, g);
        voxrti_free(&mem, order);
        return voxrti_fail(e.error, VOXRT_ERR_NO_MEMORY, 0, voxrt_result_string(VOXRT_ERR_NO_MEMORY));
    }
    memcpy(g->geometry, geometry, count * sizeof *geometry);
    g->count = count;
    for (a = 0; a < 3; a++) {
        g->lo[a] = VOXRTI_INF;
        g->hi[a] = -VOXRTI_INF;
        for (i = 0; i < count; i++) {
            g->lo[a] = voxrti_min(g->lo[a], geometry[i].box_min[a]);
            g->hi[a] = voxrti_max(g->hi[a], geometry[i].box_max[a]);
        }
    }
    for (i = 0; i < count; i++) {
        uint32_t c[3];
        for (a = 0; a < 3; a++) {
            double size = g->hi[a] - g->lo[a], middle = 0.5 * (geometry[i].box_min[a] + geometry[i].box_max[a]);
            c[a] = size > 0.0 ? (uint32_t)(1023.0 * ((middle - g->lo[a]) / size)) : 0;
        }
        order[i] = voxrti_morton(c[0], c[1], c[2]) << 32 | i;
    }
    voxrti_heap_sort(order, count);
    (void)voxrti_group_build(g, order, count, 0);
    voxrti_free(&mem, order);
    g->mem = mem;
    g->mem.limit = 0;
    *out_group = g;
    return VOXRT_OK;
}

VOXRT_DEF void voxrt_group_destroy(voxrt_group *group) {
    if (group != NULL) {
        voxrti_mem mem = group->mem;
        voxrti_free(&mem, group->geometry);
        voxrti_free(&mem, group->box);
        voxrti_free(&mem, group);
    }
}

/* A run of rays on its way through a group. */
typedef struct voxrti_group_run {
    const voxrt_group *g;
    const voxrt_ray *ray;
    double inv[VOXRTI_RUN][3], end[VOXRTI_RUN]; /* 1 / direction; t behind which nothing matters any more */
    voxrt_ray some[VOXRTI_RUN];                 /* those that meet an object, */
    uint8_t index[VOXRTI_RUN];                  /* and which they are */
} voxrti_group_run;

/* The rays that are usable. */
static uint64_t voxrti_group_open(voxrti_group_run *c, const voxrt_group *g, const voxrt_trace_desc *desc,
                                  const voxrt_ray *rays, size_t count) {
    uint64_t live = 0;
    size_t i;
    uint32_t a;
    VOXRT_ASSERT(count <= VOXRTI_RUN);
    c->g = g;
    c->ray = rays;
    for (i = 0; i < count; i++) {
        const voxrt_ray *r = &rays[i];
        int ok = voxrti_finite3(r->org) && voxrti_finite3(r->dir) && r->t_min <= r->t_max;
        ok = ok && (r->dir[0] != 0.0f || r->dir[1] != 0.0f || r->dir[2] != 0.0f);
        for (a = 0; a < 3; a++) c->inv[i][a] = r->dir[a] != 0.0f ? 1.0 / (double)r->dir[a] : 0.0;
        c->end[i] = (double)r->t_max;
        live |= (uint64_t)ok << i;
        if (ok || desc->stats == NULL) continue;
        desc->stats->rays++;
        desc->stats->bad_rays++;
    }
    return live;
}

/* The rays of `mask` that meet a box before their end; a hair's breadth counts as meeting. */
static uint64_t voxrti_group_meet(const voxrti_group_run *c, const voxrti_box *b, uint64_t mask) {
    uint64_t m, out = 0;
    uint32_t a;
    for (m = mask; m != 0; m &= m - 1) {
        uint32_t i = voxrti_ctz64(m);
        double t0 = (double)c->ray[i].t_min, t1 = c->end[i];
        int beside = 0;
        for (a = 0; a < 3; a++) {
            double o = (double)c->ray[i].org[a];
            double u = ((double)b->lo[a] - o) * c->inv[i][a], v = ((double)b->hi[a] - o) * c->inv[i][a];
            if (c->ray[i].dir[a] == 0.0f) {
                beside |= o < (double)b->lo[a] || o > (double)b->hi[a];
                continue;
            }
            t0 = voxrti_max(t0, voxrti_min(u, v));
            t1 = voxrti_min(t1, voxrti_max(u, v));
        }
        if (!beside && !(t0 - 1e-6 * voxrti_abs(t0) > t1 + 1e-6 * voxrti_abs(t1))) out |= m & (0u - m);
    }
    return out;
}

/* The next object on the way and the rays that meet it; 0: there is none. stack: boxes with their rays. */
typedef struct voxrti_group_stack {
    uint32_t box[40];
    uint64_t mask[40];
    uint32_t n;
} voxrti_group_stack;

static int voxrti_group_next(const voxrti_group_run *c, voxrti_group_stack *s, uint64_t live, uint32_t *object,
                             uint64_t *mask) {
    while (s->n != 0) {
        uint32_t at = s->box[--s->n], a, axis = 0, back, i;
        const voxrti_box *b = &c->g->box[at], *l = b + 1, *r = &c->g->box[b->right];
        uint64_t m = voxrti_group_meet(c, b, s->mask[s->n] & live);
        if (m == 0) continue;
        if (b->object != VOXRT_NO_NODE) {
            *object = b->object;
            *mask = m;
            return 1;
        }
        i = voxrti_ctz64(m); /* the first ray says which child is in front */
        for (a = 1; a < 3; a++)
            if (voxrti_absf(l->lo[a] - r->lo[a]) > voxrti_absf(l->lo[axis] - r->lo[axis])) axis = a;
        back = (l->lo[axis] < r->lo[axis]) == (c->ray[i].dir[axis] < 0.0f);
        s->box[s->n] = back ? at + 1 : b->right;
        s->mask[s->n++] = m;
        s->box[s->n] = back ? b->right : at + 1;
        s->mask[s->n++] = m;
    }
    return 0;
}

static size_t voxrti_group_pick(voxrti_group_run *c, uint64_t mask) {
    size_t n = 0;
    for (; mask != 0; mask &= mask - 1) {
        c->index[n] = (uint8_t)voxrti_ctz64(mask);
        c->some[n] = c->ray[c->index[n]];
        n++;
    }
    return n;
}

static void voxrti_group_trace(void *user, const voxrt_trace_desc *desc, const voxrt_ray *rays, voxrt_surface *surfaces,
                               size_t count) {
    voxrti_group_run c;
    voxrti_group_stack s;
    voxrt_surface found[VOXRTI_RUN];
    uint32_t first[VOXRTI_RUN], object;
    uint64_t mask, live = voxrti_group_open(&c, (const voxrt_group *)user, desc, rays, count);
    size_t i, n;
    for (i = 0; i < count; i++) {
        memset(&surfaces[i], 0, sizeof surfaces[i]);
        surfaces[i].t = INFINITY;
        first[i] = 0;
    }
    s.box[0] = 0;
    s.mask[0] = live;
    s.n = 1;
    while (voxrti_group_next(&c, &s, live, &object, &mask)) {
        const voxrt_geometry *g = &c.g->geometry[object];
        n = voxrti_group_pick(&c, mask);
        for (i = 0; i < n; i++) {
            memset(&found[i], 0, sizeof found[i]);
            found[i].t = INFINITY;
        }
        g->trace_fn(g->user, desc, c.some, found, n);
        for (i = 0; i < n; i++) {
            uint32_t k = c.index[i];
            int nearer = found[i].t < surfaces[k].t;
            /* the first object in the list wins among equals, in whatever order they were met */
            nearer = nearer || (found[i].t == surfaces[k].t && found[i].t < INFINITY && object < first[k]);
            if (!nearer) continue;
            surfaces[k] = found[i];
            first[k] = object;
            c.end[k] = (double)found[i].t;
        }
    }
}

static void voxrti_group_occluded(void *user, const voxrt_trace_desc *desc, const voxrt_ray *rays, uint8_t *occluded,
                                  size_t count) {
    voxrti_group_run c;
    voxrti_group_stack s;
    uint8_t found[VOXRTI_RUN];
    uint32_t object;
    uint64_t mask, live = voxrti_group_open(&c, (const voxrt_group *)user, desc, rays, count);
    size_t i, n;
    memset(occluded, 0, count);
    s.box[0] = 0;
    s.mask[0] = live;
    s.n = 1;
    while (live != 0 && voxrti_group_next(&c, &s, live, &object, &mask)) {
        const voxrt_geometry *g = &c.g->geometry[object];
        n = voxrti_group_pick(&c, mask);
        memset(found, 0, sizeof found);
        g->occluded_fn(g->user, desc, c.some, found, n);
        for (i = 0; i < n; i++) {
            if (found[i] == 0) continue;
            occluded[c.index[i]] = 1;
            live &= ~((uint64_t)1 << c.index[i]);
        }
    }
}

VOXRT_DEF void voxrt_group_geometry(const voxrt_group *group, voxrt_geometry *out_geometry) {
    out_geometry->trace_fn = voxrti_group_trace;
    out_geometry->occluded_fn = voxrti_group_occluded;
    memcpy(&out_geometry->user, &group, sizeof group);
    memcpy(out_geometry->box_min, group->lo, sizeof group->lo);
    memcpy(out_geometry->box_max, group->hi, sizeof group->hi);
}

/* ---------------------------------------------------------------------------
   columns: a grid of bit columns: voxelising into it, hierarchy, rays.         // >>columns
   --------------------------------------------------------------------------- */
#ifndef VOXRT_NO_GI

/* The bytes. Column (x, y) of level l is `words` 32-bit words from bits[start[l] + ((y << row_log[l]) + x) * words] on;
   bit k & 31 of word k >> 5 is cell k of the depth. Level l has max(1, nx >> l) x max(1, ny >> l) columns, each the OR
   of the up to 2 x 2 below it. `still` is a level 0 for itself, or NULL. `moving` and `changed` are maps with a bit for
   each column: those with bits that are not still, and those that the levels above do not show yet; a row is 32-bit
   words of its own, and `changed` has all levels. */
#define VOXRTI_COLUMN_LEVELS 13

struct voxrt_columns {
    voxrti_mem mem;
    double origin[3], per_cell[3], cell[3]; /* by grid axis: cell = (world - origin) * per_cell */
    double diagonal;
    uint32_t axis[3], size[3];
    uint32_t words, word_log, levels;
    uint32_t start[VOXRTI_COLUMN_LEVELS], row_log[VOXRTI_COLUMN_LEVELS], rows[VOXRTI_COLUMN_LEVELS];
    uint32_t map_start[VOXRTI_COLUMN_LEVELS], map_row[VOXRTI_COLUMN_LEVELS];
    uint32_t *bits, *still, *moving, *changed;
    uint32_t all_changed;
};

VOXRTI_INLINE uint32_t voxrti_log2_u32(uint32_t x) { return 31u - voxrti_clz32(x); } /* x != 0 */
VOXRTI_INLINE size_t voxrti_column(const voxrt_columns *c, uint32_t level, uint32_t x, uint32_t y) {
    return c->start[level] + ((((size_t)y << c->row_log[level]) + x) << c->word_log);
}

static voxrt_result voxrti_columns_open(const voxrt_columns_desc *d, voxrt_columns *c) {
    uint32_t a, depth = d->depth_axis_plus_1, l, at = 0, map = 0;
    double side[3];
    for (a = 0; a < 3; a++) {
        side[a] = d->box_max[a] - d->box_min[a];
        if (!voxrti_finite(d->box_min[a]) || !voxrti_finite(side[a]) || !(side[a] > 0.0))
            return voxrti_fail(d->env.error, VOXRT_ERR_INVALID_ARG, a, "side % of the box is not longer than 0");
    }
    if (depth > 3) return voxrti_fail(d->env.error, VOXRT_ERR_INVALID_ARG, depth, "there is no axis %");
    if (depth == 0) depth = side[0] < side[1] ? (side[0] < side[2] ? 1 : 3) : side[1] < side[2] ? 2 : 3;
    c->size[0] = d->size_x != 0 ? d->size_x : 256;
    c->size[1] = d->size_y != 0 ? d->size_y : 256;
    c->size[2] = d->size_z != 0 ? d->size_z : 128;
    for (a = 0; a < 3; a++) {
        const uint32_t n = c->size[a];
        if ((n & (n - 1)) != 0 || n < (a == 2 ? 64u : 4u) || n > (a == 2 ? 256u : 4096u))
            return voxrti_fail(d->env.error, VOXRT_ERR_INVALID_ARG, n, "a grid cannot have % cells along this axis");
        c->axis[a] = (depth + a) % 3; /* depth is 1 + axis: the two that follow it, then itself */
        c->origin[a] = d->box_min[c->axis[a]];
        c->cell[a] = side[c->axis[a]] / (double)n;
        c->per_cell[a] = (double)n / side[c->axis[a]];
    }
    c->diagonal = sqrt(c->cell[0] * c->cell[0] + c->cell[1] * c->cell[1] + c->cell[2] * c->cell[2]);
    c->words = c->size[2] / 32;
    c->word_log = voxrti_log2_u32(c->words);
    c->levels = voxrti_log2_u32(c->size[0] > c->size[1] ? c->size[0] : c->size[1]) + 1;
    for (l = 0; l < c->levels; l++) {
        const uint32_t nx = c->size[0] >> l, ny = c->size[1] >> l;
        c->row_log[l] = nx != 0 ? voxrti_log2_u32(nx) : 0;
        c->rows[l] = ny != 0 ? ny : 1;
        c->start[l] = at;
        at += c->words * (c->rows[l] << c->row_log[l]);
        c->map_row[l] = ((1u << c->row_log[l]) + 31) / 32;
        c->map_start[l] = map;
        map += c->map_row[l] * c->rows[l];
    }
    c->bits = (uint32_t *)voxrti_alloc_zero(&c->mem, at + 2, 4); /* four words are read where there are two */
    c->moving = (uint32_t *)voxrti_alloc_zero(&c->mem, (size_t)c->map_row[0] * c->rows[0], 4);
    c->changed = (uint32_t *)voxrti_alloc_zero(&c->mem, map, 4);
    if (c->bits != NULL && c->moving != NULL && c->changed != NULL) return VOXRT_OK;
    return voxrti_fail(d->env.error, VOXRT_ERR_NO_MEMORY, at, "no memory for a grid of % words");
}

VOXRT_DEF voxrt_result voxrt_columns_create(const voxrt_columns_desc *desc, voxrt_columns **out_columns) {
    voxrti_mem mem;
    voxrt_columns *c;
    voxrt_result r;
    if (out_columns == NULL) return VOXRT_ERR_INVALID_ARG;
    *out_columns = NULL;
    if (desc == NULL) return VOXRT_ERR_INVALID_ARG;
    if (desc->_begin_zero != 0 || desc->_end_zero != 0) return VOXRT_ERR_UNINIT_DESC;
    r = voxrti_env_open(&desc->env, &mem);
    if (r != VOXRT_OK) return r;
    c = (voxrt_columns *)voxrti_alloc_zero(&mem, 1, sizeof *c);
    if (c == NULL) return voxrti_fail(desc->env.error, VOXRT_ERR_NO_MEMORY, 0, "no memory for a grid");
    c->mem = mem;
    r = voxrti_columns_open(desc, c);
    if (r == VOXRT_OK) *out_columns = c;
    else voxrt_columns_destroy(c);
    return r;
}

VOXRT_DEF void voxrt_columns_destroy(voxrt_columns *columns) {
    voxrti_mem mem;
    if (columns == NULL) return;
    mem = columns->mem;
    voxrti_free(&mem, columns->bits);
    voxrti_free(&mem, columns->still);
    voxrti_free(&mem, columns->moving);
    voxrti_free(&mem, columns->changed);
    voxrti_free(&mem, columns);
}

VOXRT_DEF void voxrt_columns_get_info(const voxrt_columns *columns, voxrt_columns_info *info) {
    size_t i, n;
    uint32_t a;
    if (info == NULL) return;
    memset(info, 0, sizeof *info);
    if (columns == NULL) return;
    for (a = 0; a < 3; a++) {
        info->axis[a] = columns->axis[a];
        info->size[a] = columns->size[a];
        info->cell[a] = columns->cell[a];
    }
    info->diagonal = columns->diagonal;
    n = (size_t)columns->size[0] * columns->size[1] * columns->words;
    for (i = 0; i < n; i += 2)
        info->cells += voxrti_popcount64((uint64_t)columns->bits[i] << 32 | columns->bits[i + 1]);
    info->bytes = columns->mem.used;
}

VOXRT_DEF int voxrt_columns_get(const voxrt_columns *columns, uint32_t level, uint32_t x, uint32_t y, uint32_t z) {
    if (columns == NULL || level >= columns->levels || x >> columns->row_log[level] != 0 || y >= columns->rows[level] ||
        z >= columns->size[2]) return 0;
    return (int)(columns->bits[voxrti_column(columns, level, x, y) + (z >> 5)] >> (z & 31u) & 1u);
}

VOXRT_DEF void voxrt_columns_clear(voxrt_columns *columns, int all) {
    uint32_t x, y, w;
    if (columns == NULL) return;
    if (all) {
        const size_t n = (size_t)columns->size[0] * columns->size[1] * columns->words;
        memset(columns->bits, 0, n * 4);
        if (columns->still != NULL) memset(columns->still, 0, n * 4);
        memset(columns->moving, 0, (size_t)columns->map_row[0] * columns->rows[0] * 4);
        columns->all_changed = 1;
        return;
    }
    for (y = 0; y < columns->rows[0]; y++)
        for (x = 0; x < columns->map_row[0]; x++) {
            const size_t m = (size_t)y * columns->map_row[0] + x;
            uint32_t bits = columns->moving[m];
            columns->moving[m] = 0;
            columns->changed[m] |= bits;
            for (; bits != 0; bits &= bits - 1) {
                const size_t at = voxrti_column(columns, 0, 32 * x + voxrti_ctz64(bits), y);
                for (w = 0; w < columns->words; w++)
                    columns->bits[at + w] = columns->still != NULL ? columns->still[at + w] : 0;
            }
        }
}

/* ---- setting cells ---- */

typedef struct voxrti_insert {
    voxrt_columns *columns;
    const voxrt_mesh *mesh;
    const uint8_t *points;
    size_t point_stride, count;
    uint32_t *flips;          /* SOLID, BODY: a level 0 of parities, then a map of columns with an odd number of them */
    const uint32_t *inside;   /* BODY: a level 0 of cells with their centre inside; NULL: still to be found */
    double m[12];             /* to cells, by grid axis */
    voxrt_columns_mode mode;
    uint32_t still, shared;   /* shared: by several threads */
    int isa;
    uint32_t *own;            /* a level 0 that gets the cells, too, or NULL */
    const struct voxrti_splat *splat; /* instead of setting cells: what they are made of */
    uint16_t (*lattice)[2];   /* SAMPLES: of each triangle, or NULL: made when it is looked at */
    int grow;                 /* 0: lattices stay; 1: they are made anew where triangles have grown; 2: everywhere */
    double per_length;        /* points for a world unit */
    uint32_t rejected[2], outside[2]; /* tallies */
} voxrti_insert;

#define VOXRTI_INSERT_TASK 1024 /* items */

#if defined(__GNUC__)
#  define voxrti_add_shared(p, v) ((void)__atomic_fetch_add(p, v, __ATOMIC_RELAXED))
#  define voxrti_load_shared(p) __atomic_load_n(p, __ATOMIC_RELAXED)
#  define voxrti_store_shared(p, v) __atomic_store_n(p, v, __ATOMIC_RELAXED)
#else
#  define voxrti_add_shared(p, v) ((void)(*(p) += (v)))
#  define voxrti_load_shared(p) (*(p))
#  define voxrti_store_shared(p, v) ((void)(*(p) = (v)))
#endif

#if defined(__GNUC__)
#  define voxrti_or_shared(p, v) \
       do { if ((__atomic_load_n(p, __ATOMIC_RELAXED) & (v)) != (v)) \
            (void)__atomic_fetch_or(p, v, __ATOMIC_RELAXED); } while (0)
#  define voxrti_xor_shared(p, v) ((void)__atomic_fetch_xor(p, v, __ATOMIC_RELAXED))
#else /* no built-in threads there */
#  define voxrti_or_shared(p, v) ((void)(*(p) |= (v)))
#  define voxrti_xor_shared(p, v) ((void)(*(p) ^= (v)))
#endif

VOXRTI_INLINE void voxrti_insert_or(const voxrti_insert *in, uint32_t *p, uint32_t v) {
    if (in->shared) voxrti_or_shared(p, v);
    else *p |= v;
}

/* Set cells k0 .. k1 of a column. */
static void voxrti_splat_add(const struct voxrti_splat *f, uint32_t x, uint32_t y, uint32_t k);
VOXRTI_INLINE void voxrti_insert_run(const voxrti_insert *in, uint32_t x, uint32_t y, uint32_t k0, uint32_t k1) {
    voxrt_columns *c = in->columns;
    const size_t at = voxrti_column(c, 0, x, y), map = (size_t)y * c->map_row[0] + (x >> 5);
    uint32_t w;
    if (in->splat != NULL) {
        for (; k0 <= k1; k0++) voxrti_splat_add(in->splat, x, y, k0);
        return;
    }
    for (w = k0 >> 5; w <= k1 >> 5; w++) {
        const uint32_t lo = w == k0 >> 5 ? k0 & 31u : 0, hi = w == k1 >> 5 ? k1 & 31u : 31;
        const uint32_t mask = 0xffffffffu << lo & 0xffffffffu >> (31 - hi);
        voxrti_insert_or(in, &c->bits[at + w], mask);
        if (in->still) voxrti_insert_or(in, &c->still[at + w], mask);
        if (in->own != NULL) voxrti_insert_or(in, &in->own[at + w], mask);
    }
    voxrti_insert_or(in, &c->changed[map], 1u << (x & 31u));
    if (!in->still) voxrti_insert_or(in, &c->moving[map], 1u << (x & 31u));
}

/* Toggle cells k .. of a column, and whether it has an odd number of crossings. */
VOXRTI_INLINE void voxrti_insert_flip(const voxrti_insert *in, uint32_t x, uint32_t y, uint32_t k) {
    const voxrt_columns *c = in->columns;
    const size_t at = voxrti_column(c, 0, x, y), n = ((size_t)c->rows[0] << c->row_log[0]) << c->word_log;
    uint32_t w;
    voxrti_xor_shared(&in->flips[n + (size_t)y * c->map_row[0] + (x >> 5)], 1u << (x & 31u));
    for (w = k >> 5; w < c->words; w++) {
        const uint32_t mask = w == k >> 5 ? 0xffffffffu << (k & 31u) : 0xffffffffu;
        voxrti_xor_shared(&in->flips[at + w], mask);
    }
}

/* floor(a / b), b > 0 */
VOXRTI_INLINE int64_t voxrti_floor_div(int64_t a, int64_t b) {
    int64_t q = a / b;
    return q - (a % b < 0);
}
/* floor(a / 256) for |a| < 2^30 */
VOXRTI_INLINE int32_t voxrti_floor_256(int32_t a) { return (int32_t)(((uint32_t)a + 0x40000000u) >> 8) - 0x400000; }

/* BODY: a crossing at `at` (in 1/256 of a cell) of the line along axis a through the centres of (i, j): the cell behind
   it whose centre is inside, or else the one that it lies in. Of two that are inside the one behind the triangle. */
static void voxrti_insert_behind(const voxrti_insert *in, uint32_t a, int32_t i, int32_t j, double at, int up) {
    const voxrt_columns *c = in->columns;
    const int32_t size = (int32_t)c->size[a], upper = (int32_t)(0 - voxrti_floor((128.0 - at) * (1.0 / 256.0)));
    int32_t k = (int32_t)voxrti_floor(at * (1.0 / 256.0)), e;
    for (e = 0; e < 2; e++) { /* the better one last */
        const int32_t q = upper - (int32_t)(e == (up != 0));
        const uint32_t x = (uint32_t)(a == 0 ? q : a == 1 ? j : i), y = (uint32_t)(a == 1 ? q : j);
        const uint32_t z = (uint32_t)(a == 2 ? q : i);
        if (q >= 0 && q < size && (in->inside[voxrti_column(c, 0, x, y) + (z >> 5)] >> (z & 31u) & 1u) != 0) k = q;
    }
    if (k < 0 || k >= size) return;
    {
        const uint32_t z = (uint32_t)(a == 2 ? k : i);
        voxrti_insert_run(in, (uint32_t)(a == 0 ? k : a == 1 ? j : i), (uint32_t)(a == 1 ? k : j), z, z);
    }
}

/* Lines along grid axis a through the centres of the cells that triangle p (in 1/256 of a cell) meets. A centre exactly
   on an edge belongs to one of the two triangles that share it: as if it lay a little to the left of it, and a little
   less above. Rows go along v and their runs along u. flip: toggle what lies above instead of setting the cell. */
static void voxrti_insert_lines(const voxrti_insert *in, const int32_t p[3][3], const int64_t normal[3], uint32_t a,
                                int flip) {
    const uint32_t u = a == 2 ? 0 : 2, v = a == 1 ? 0 : 1;
    const int32_t *q[3];
    const int32_t size_u = (int32_t)in->columns->size[u], size_v = (int32_t)in->columns->size[v];
    const int32_t size_a = (int32_t)in->columns->size[a];
    const double area = (double)normal[a];
    double slope_u, slope_v, lo = 1e30, hi = -1e30;
    int32_t j, j_end, v_min, v_max;
    uint32_t e;
    if (normal[a] == 0) return;
    slope_u = -((double)normal[u] / area);
    slope_v = -((double)normal[v] / area);
    q[0] = p[0];
    e = (uint32_t)((int64_t)(p[1][u] - p[0][u]) * (p[2][v] - p[0][v]) < (int64_t)(p[1][v] - p[0][v]) *
                   (p[2][u] - p[0][u]));
    q[1] = p[1 + e];
    q[2] = p[2 - e];
    v_min = v_max = p[0][v];
    for (e = 0; e < 3; e++) {
        v_min = p[e][v] < v_min ? p[e][v] : v_min;
        v_max = p[e][v] > v_max ? p[e][v] : v_max;
        lo = voxrti_min(lo, (double)p[e][a]);
        hi = voxrti_max(hi, (double)p[e][a]);
    }
    j = voxrti_floor_256(v_min + 127);
    j = j > 0 ? j : 0;
    j_end = voxrti_floor_256(v_max - 128);
    j_end = j_end < size_v - 1 ? j_end : size_v - 1;
    for (; j <= j_end; j++) {
        const int64_t sv = 256 * (int64_t)j + 128;
        int64_t first = 0, last = size_u - 1;
        int32_t i, cell = 0, run = -1;
        double base;
        for (e = 0; e < 3; e++) {
            const int32_t *s = q[e], *t = q[e == 2 ? 0 : e + 1];
            const int64_t du = t[u] - s[u], dv = t[v] - s[v];
            const int64_t most = du * (sv - s[v]) - dv * (128 - s[u]) - (dv > 0 || (dv == 0 && du > 0) ? 0 : 1);
            int64_t at;
            if (dv > 0) { /* 256 dv i <= most */
                at = voxrti_floor_div(most, 256 * dv);
                if (at < last) last = at;
            } else if (dv < 0) {
                at = 0 - voxrti_floor_div(most, -256 * dv);
                if (at > first) first = at;
            } else if (most < 0) {
                last = -1;
            }
        }
        if (first > last) continue;
        base = (double)p[0][a] + slope_v * (double)(sv - p[0][v]) + slope_u * (double)(128 - p[0][u]);
        for (i = (int32_t)first; i <= (int32_t)last; i++) {
            double at = base + slope_u * (double)(256 * i);
            int32_t k;
            at = at < lo ? lo : at > hi ? hi : at;
            if (flip) { /* cells whose centres lie at or above the crossing */
                k = (int32_t)(0 - voxrti_floor((128.0 - at) * (1.0 / 256.0)));
                voxrti_insert_flip(in, (uint32_t)i, (uint32_t)j,
                                   k < 0 ? 0 : k > size_a ? (uint32_t)size_a : (uint32_t)k);
                continue;
            }
            if (in->inside != NULL) {
                voxrti_insert_behind(in, a, i, j, at, normal[a] > 0);
                continue;
            }
            k = (int32_t)voxrti_floor(at * (1.0 / 256.0));
            if (a == 2) {
                if (k >= 0 && k < size_a) voxrti_insert_run(in, (uint32_t)i, (uint32_t)j, (uint32_t)k, (uint32_t)k);
                continue;
            }
            if (run >= 0 && k != cell) { /* runs of cells in one column */
                if (cell >= 0 && cell < size_a)
                    voxrti_insert_run(in, (uint32_t)(a == 0 ? cell : j), (uint32_t)(a == 0 ? j : cell), (uint32_t)run,
                                      (uint32_t)(i - 1));
                run = -1;
            }
            if (run < 0) {
                run = i;
                cell = k;
            }
        }
        if (run >= 0 && cell >= 0 && cell < size_a)
            voxrti_insert_run(in, (uint32_t)(a == 0 ? cell : j), (uint32_t)(a == 0 ? j : cell), (uint32_t)run,
                              (uint32_t)last);
    }
}

/* The part of a convex polygon with sign * point[a] >= sign * at. An edge is cut in the same place whichever way it
   goes. */
static uint32_t voxrti_cut_polygon(const double (*from)[3], uint32_t n, uint32_t a, double at, double sign,
                                   double (*to)[3]) {
    uint32_t i, b, m = 0;
    for (i = 0; i < n; i++) {
        const double *p = from[i], *q = from[i + 1 < n ? i + 1 : 0];
        const double dp = (p[a] - at) * sign, dq = (q[a] - at) * sign;
        if (dp >= 0.0) {
            memcpy(to[m], p, sizeof to[m]);
            m++;
        }
        if ((dp < 0.0 && dq > 0.0) || (dp > 0.0 && dq < 0.0)) {
            const double *lo = dp < 0.0 ? p : q, *hi = dp < 0.0 ? q : p, s = (at - lo[a]) / (hi[a] - lo[a]);
            for (b = 0; b < 3; b++) to[m][b] = b == a ? at : lo[b] + (hi[b] - lo[b]) * s;
            m++;
        }
    }
    return m;
}

#define VOXRTI_FAT_MARGIN 1e-6 /* of a cell: more than rounding can move a corner */

/* All cells that polygon p (n <= 9) meets: cut it into rows, these into columns, and take their depths. */
static void voxrti_insert_fat(const voxrti_insert *in, const double (*p)[3], uint32_t n) {
    const voxrt_columns *c = in->columns;
    double row[12][3], part[12][3], cut[12][3];
    int64_t lo[2], hi[2], i, j, k0, k1;
    double least[3], most[3];
    uint32_t a, m, s, e;
    for (a = 0; a < 3; a++) {
        least[a] = most[a] = p[0][a];
        for (e = 1; e < n; e++) {
            least[a] = voxrti_min(least[a], p[e][a]);
            most[a] = voxrti_max(most[a], p[e][a]);
        }
    }
    for (a = 0; a < 2; a++) {
        lo[a] = voxrti_floor(voxrti_max(least[a] - VOXRTI_FAT_MARGIN, 0.0));
        hi[a] = voxrti_floor(voxrti_min(most[a] + VOXRTI_FAT_MARGIN, (double)c->size[a] - 0.5));
    }
    for (j = lo[1]; j <= hi[1]; j++) {
        s = voxrti_cut_polygon(p, n, 1, (double)j - VOXRTI_FAT_MARGIN, 1.0, cut);
        s = voxrti_cut_polygon((const double (*)[3])cut, s, 1, (double)(j + 1) + VOXRTI_FAT_MARGIN, -1.0, row);
        for (i = lo[0]; i <= hi[0] && s != 0; i++) {
            const double (*q)[3] = (const double (*)[3])row;
            m = s;
            if (lo[0] != hi[0]) {
                m = voxrti_cut_polygon(q, s, 0, (double)i - VOXRTI_FAT_MARGIN, 1.0, cut);
                m = voxrti_cut_polygon((const double (*)[3])cut, m, 0, (double)(i + 1) + VOXRTI_FAT_MARGIN, -1.0, part);
                q = (const double (*)[3])part;
            }
            if (m == 0) continue;
            least[2] = most[2] = q[0][2];
            for (e = 1; e < m; e++) {
                least[2] = voxrti_min(least[2], q[e][2]);
                most[2] = voxrti_max(most[2], q[e][2]);
            }
            k0 = voxrti_floor(voxrti_max(least[2] - VOXRTI_FAT_MARGIN, 0.0));
            k1 = voxrti_floor(voxrti_min(most[2] + VOXRTI_FAT_MARGIN, (double)c->size[2] - 0.5));
            if (k0 <= k1) voxrti_insert_run(in, (uint32_t)i, (uint32_t)j, (uint32_t)k0, (uint32_t)k1);
        }
    }
}

static void voxrti_insert_snapped(const voxrti_insert *in, const double (*p)[3]) {
    int32_t s[3][3];
    int64_t normal[3], d[2][3];
    uint32_t a, e;
    for (e = 0; e < 3; e++)
        for (a = 0; a < 3; a++) s[e][a] = (int32_t)voxrti_floor(p[e][a] * 256.0 + 0.5);
    for (a = 0; a < 3; a++) {
        d[0][a] = s[1][a] - s[0][a];
        d[1][a] = s[2][a] - s[0][a];
    }
    for (a = 0; a < 3; a++) {
        const uint32_t b = (a + 1) % 3, c = (a + 2) % 3;
        normal[a] = d[0][b] * d[1][c] - d[0][c] * d[1][b];
    }
    if (in->mode == VOXRT_COLUMNS_BODY && in->inside == NULL) {
        voxrti_insert_lines(in, (const int32_t (*)[3])s, normal, 2, 1);
        return;
    }
    voxrti_insert_lines(in, (const int32_t (*)[3])s, normal, 2, 0);
    if (in->mode == VOXRT_COLUMNS_SOLID) voxrti_insert_lines(in, (const int32_t (*)[3])s, normal, 2, 1);
    if (in->mode == VOXRT_COLUMNS_RASTER) return;
    voxrti_insert_lines(in, (const int32_t (*)[3])s, normal, 0, 0);
    voxrti_insert_lines(in, (const int32_t (*)[3])s, normal, 1, 0);
}

/* One triangle, in cells. Those that reach far outside are cut to a box around the grid first. */
static int voxrti_insert_triangle(const voxrti_insert *in, const double (*p)[3]) {
    const voxrt_columns *c = in->columns;
    double poly[12][3], cut[12][3], tri[3][3];
    uint32_t a, e, n = 3, far_off = 0;
    /* what lies below the grid toggles it all */
    const int above = in->mode == VOXRT_COLUMNS_SOLID || (in->mode == VOXRT_COLUMNS_BODY && in->inside == NULL);
    for (a = 0; a < 3; a++) {
        const double lo = voxrti_min(p[0][a], voxrti_min(p[1][a], p[2][a]));
        const double hi = voxrti_max(p[0][a], voxrti_max(p[1][a], p[2][a]));
        if (hi < -1e-3 && !(above && a == 2)) return 0;
        if (lo > (double)c->size[a] + 1e-3 && !(above && a == 2)) return 0; /* there it still ends */
        if (lo < -16384.0 || hi > 16384.0) far_off = 1;
    }
    if (in->mode == VOXRT_COLUMNS_FAT) {
        voxrti_insert_fat(in, p, 3);
        return 1;
    }
    if (!far_off) {
        voxrti_insert_snapped(in, p);
        return 1;
    }
    memcpy(poly, p, 3 * sizeof poly[0]);
    for (a = 0; a < 3; a++) {
        if (above && a == 2) continue;
        n = voxrti_cut_polygon((const double (*)[3])poly, n, a, -8.0, 1.0, cut);
        n = voxrti_cut_polygon((const double (*)[3])cut, n, a, (double)c->size[a] + 8.0, -1.0, poly);
    }
    for (e = 0; e < n && above; e++) poly[e][2] = voxrti_max(-16384.0, voxrti_min(16384.0, poly[e][2]));
    for (e = 2; e < n; e++) {
        memcpy(tri[0], poly[0], sizeof tri[0]);
        memcpy(tri[1], poly[e - 1], sizeof tri[1]);
        memcpy(tri[2], poly[e], sizeof tri[2]);
        voxrti_insert_snapped(in, (const double (*)[3])tri);
    }
    return 1;
}

VOXRTI_INLINE int voxrti_insert_point(const voxrti_insert *in, const uint8_t *from, double to[3]) {
    float f[3];
    uint32_t a;
    memcpy(f, from, sizeof f);
    for (a = 0; a < 3; a++) {
        const double *m = in->m + 4 * a;
        to[a] = m[0] * (double)f[0] + m[1] * (double)f[1] + m[2] * (double)f[2] + m[3];
        if (!(to[a] > -1e15 && to[a] < 1e15)) return 0;
    }
    return 1;
}

/* A point in a cell that has been set in the same way changes nothing: most do. */
VOXRTI_INLINE void voxrti_insert_cell(const voxrti_insert *in, uint32_t x, uint32_t y, uint32_t k) {
    const voxrt_columns *c = in->columns;
    const size_t at = voxrti_column(c, 0, x, y) + (k >> 5);
    const uint32_t bit = 1u << (k & 31u);
    uint32_t *word = in->own != NULL ? &in->own[at] : in->still ? &c->still[at] : &c->bits[at];
    if (in->splat != NULL) voxrti_splat_add(in->splat, x, y, k);
    else if ((voxrti_load_shared(word) & bit) == 0) voxrti_insert_run(in, x, y, k, k);
}

/* Points that stay where they are on a triangle, as the texels of an atlas do. Rows lie along its longest edge; row j
   of `rows` is (j + 1/2) / rows of the way up and has as many of the `most` as it is long. Two numbers a triangle:
   rows; most, and which edge, in the two highest bits. 0 rows: no point. */
#define VOXRTI_LATTICE_MOST 16383

/* For triangle i with corners p, world units; `density` points for a unit. Too many: 65535. A triangle that is much
   smaller than what a point stands for has one with a chance, so that cost goes by area: up to eight in that area on
   average, as chance leaves gaps that rows do not. */
static void voxrti_lattice_make(const double (*p)[3], double density, size_t i, uint16_t out[2]) {
    double l[3], across = 0.0, u, v, chance;
    uint32_t a, e, side = 0;
    for (e = 0; e < 3; e++)
        for (l[e] = 0.0, a = 0; a < 3; a++) {
            const double d = p[e == 2 ? 0 : e + 1][a] - p[e][a];
            l[e] += d * d;
        }
    for (e = 1; e < 3; e++) if (l[e] > l[side]) side = e;
    for (a = 0; a < 3; a++) {
        const uint32_t b = (a + 1) % 3, c = (a + 2) % 3;
        const double n = (p[1][b] - p[0][b]) * (p[2][c] - p[0][c]) - (p[1][c] - p[0][c]) * (p[2][b] - p[0][b]);
        across += n * n;
    }
    u = sqrt(l[side]);
    v = u > 0.0 ? sqrt(across) / u * density : 0.0;
    u *= density;
    if (!(u < VOXRTI_LATTICE_MOST && v < VOXRTI_LATTICE_MOST)) {
        out[0] = out[1] = 0xffff;
        return;
    }
    chance = (u < 0.5 ? 2.0 * u : 1.0) * (v < 0.5 ? 2.0 * v : 1.0);
    out[0] = (uint16_t)((double)voxrti_hash32((uint32_t)i + 1u) < chance * 4294967296.0 ? (uint32_t)v + 1 : 0);
    out[1] = (uint16_t)((uint32_t)u + 1 + (side << 14));
}

/* The points of triangle i. As voxrti_insert_triangle. */
static int voxrti_insert_samples(const voxrti_insert *in, const double (*p)[3], size_t i) {
    const voxrt_columns *c = in->columns;
    uint16_t own[2], *lattice = in->lattice != NULL ? in->lattice[i] : own;
    const double size[3] = {(double)c->size[0], (double)c->size[1], (double)c->size[2]};
    double d[2][3];
    uint32_t a, e, j, k, rows, most, side;
    for (a = 0; a < 3; a++) {
        if (voxrti_min(p[0][a], voxrti_min(p[1][a], p[2][a])) >= size[a]) return 0;
        if (voxrti_max(p[0][a], voxrti_max(p[1][a], p[2][a])) < 0.0) return 0;
    }
    if (in->lattice == NULL || in->grow) {
        double w[3][3];
        const double (*q)[3] = (const double (*)[3])w;
        for (e = 0; e < 3; e++) for (a = 0; a < 3; a++) w[e][a] = p[e][a] * c->cell[a];
        if (in->lattice == NULL || in->grow == 2) {
            voxrti_lattice_make(q, in->per_length * (in->lattice != NULL ? 1.1 : 1.0), i, lattice);
        } else {
            uint16_t now[2]; /* what it needs; it was given a tenth more than that */
            voxrti_lattice_make(q, in->per_length, i, now);
            if (now[0] > lattice[0] || (now[1] & VOXRTI_LATTICE_MOST) > (lattice[1] & VOXRTI_LATTICE_MOST))
                voxrti_lattice_make(q, in->per_length * 1.1, i, lattice);
        }
    }
    rows = lattice[0];
    most = lattice[1] & VOXRTI_LATTICE_MOST;
    side = lattice[1] >> 14;
    if (rows > VOXRTI_LATTICE_MOST) return voxrti_insert_triangle(in, p);
    for (a = 0; a < 3; a++) {
        d[0][a] = p[(side + 1) % 3][a] - p[side][a];
        d[1][a] = p[(side + 2) % 3][a] - p[side][a];
    }
    for (j = 0; j < rows; j++) {
        const double v = ((double)j + 0.5) / (double)rows, wide = (1.0 - v) * (double)most;
        const uint32_t n = (uint32_t)wide + (wide > (double)(uint32_t)wide);
        const double part = (1.0 - v) / (double)n;
        double from[3], by[3], q[3];
        uint32_t first = 0, last = n;
        for (a = 0; a < 3; a++) {
            by[a] = d[0][a] * part;
            from[a] = p[side][a] + v * d[1][a] + 0.5 * by[a];
        }
        for (a = 0; a < 3 && n > 8; a++) { /* what lies in the box, and a little more */
            double lo, hi;
            if (voxrti_abs(by[a]) < 1e-9) continue;
            lo = ((by[a] > 0.0 ? -1.0 : size[a] + 1.0) - from[a]) / by[a];
            hi = ((by[a] > 0.0 ? size[a] + 1.0 : -1.0) - from[a]) / by[a];
            if (lo > (double)first) first = lo < (double)n ? (uint32_t)lo : n;
            if (hi < (double)last) last = hi > 0.0 ? (uint32_t)hi : 0;
        }
        for (k = first; k < last; k++) {
            for (a = 0; a < 3; a++) q[a] = from[a] + (double)k * by[a];
            if (q[0] >= 0.0 && q[1] >= 0.0 && q[2] >= 0.0 && q[0] < size[0] && q[1] < size[1] && q[2] < size[2])
                voxrti_insert_cell(in, (uint32_t)q[0], (uint32_t)q[1], (uint32_t)q[2]);
        }
    }
    return 1;
}

static void voxrti_task_insert_mesh(void *ctx, uint32_t index) {
    voxrti_insert *in = (voxrti_insert *)ctx;
    const voxrt_mesh *mesh = in->mesh;
    const size_t stride = mesh->position_stride != 0 ? mesh->position_stride : 12;
    size_t i = (size_t)index * VOXRTI_INSERT_TASK, end = i + VOXRTI_INSERT_TASK;
    uint64_t rejected = 0, outside = 0;
    end = end < in->count ? end : in->count;
    for (; i < end; i++) {
        double p[3][3];
        uint32_t e, ok = 1;
        for (e = 0; e < 3 && ok; e++) {
            const size_t at = mesh->indices != NULL ? (size_t)mesh->indices[3 * i + e] : 3 * i + e;
            ok = at < mesh->vertex_count &&
                voxrti_insert_point(in, (const uint8_t *)mesh->positions + at * stride, p[e]);
        }
        if (!ok) rejected++;
        else if (in->mode == VOXRT_COLUMNS_SAMPLES ? !voxrti_insert_samples(in, (const double (*)[3])p, i) :
                 !voxrti_insert_triangle(in, (const double (*)[3])p)) outside++;
    }
    voxrti_tally_add(in->rejected, rejected);
    voxrti_tally_add(in->outside, outside);
}

/* Points i .. end - 1, those outside and bad ones counted. */
static void voxrti_insert_points_scalar(const voxrti_insert *in, size_t i, size_t end, uint64_t *rejected,
                                        uint64_t *outside) {
    const double nx = (double)in->columns->size[0], ny = (double)in->columns->size[1],
        nz = (double)in->columns->size[2];
    for (; i < end; i++) {
        double p[3];
        if (!voxrti_insert_point(in, in->points + i * in->point_stride, p)) ++*rejected;
        else if (!(p[0] >= 0.0 && p[1] >= 0.0 && p[2] >= 0.0 && p[0] < nx && p[1] < ny && p[2] < nz)) ++*outside;
        else voxrti_insert_cell(in, (uint32_t)p[0], (uint32_t)p[1], (uint32_t)p[2]);
    }
}

#if VOXRTI_AVX2
/* Four points at a time: the same sums in the same order. A row of points is 12 bytes, the last is read apart. */
VOXRTI_TARGET_AVX2 static size_t voxrti_insert_points_avx2(const voxrti_insert *in, size_t i, size_t end,
                                                           uint64_t *rejected, uint64_t *outside) {
    const __m256d zero = _mm256_setzero_pd(), sign = _mm256_set1_pd(-0.0), most = _mm256_set1_pd(1e15);
    const voxrt_columns *c = in->columns;
    const __m256d nx = _mm256_set1_pd((double)c->size[0]), ny = _mm256_set1_pd((double)c->size[1]);
    const __m256d nz = _mm256_set1_pd((double)c->size[2]);
    const __m128i row_log = _mm_cvtsi32_si128((int)c->row_log[0]), word_log = _mm_cvtsi32_si128((int)c->word_log);
    const uint32_t *layer = in->still ? c->still : c->bits;
    for (; i + 5 <= end; i += 4) {
        const uint8_t *from = in->points + i * in->point_stride;
        __m128 r0 = _mm_loadu_ps((const float *)(const void *)from);
        __m128 r1 = _mm_loadu_ps((const float *)(const void *)(from + in->point_stride));
        __m128 r2 = _mm_loadu_ps((const float *)(const void *)(from + 2 * in->point_stride));
        __m128 r3 = _mm_loadu_ps((const float *)(const void *)(from + 3 * in->point_stride));
        __m256d f[3], p[3], bad = zero, out;
        uint32_t a, live, lost;
        uint32_t cx[4], cy[4], ck[4], at[4];
        __m128i x, y, k;
        _MM_TRANSPOSE4_PS(r0, r1, r2, r3);
        f[0] = _mm256_cvtps_pd(r0);
        f[1] = _mm256_cvtps_pd(r1);
        f[2] = _mm256_cvtps_pd(r2);
        for (a = 0; a < 3; a++) {
            const double *m = in->m + 4 * a;
            __m256d sum = _mm256_add_pd(_mm256_mul_pd(_mm256_set1_pd(m[0]), f[0]),
                                        _mm256_mul_pd(_mm256_set1_pd(m[1]), f[1]));
            sum = _mm256_add_pd(sum, _mm256_mul_pd(_mm256_set1_pd(m[2]), f[2]));
            p[a] = _mm256_add_pd(sum, _mm256_set1_pd(m[3]));
            bad = _mm256_or_pd(bad, _mm256_cmp_pd(_mm256_andnot_pd(sign, p[a]), most, _CMP_NLT_UQ));
        }
        out = _mm256_or_pd(_mm256_cmp_pd(_mm256_min_pd(p[0], _mm256_min_pd(p[1], p[2])), zero, _CMP_LT_OQ),
                           _mm256_or_pd(_mm256_cmp_pd(p[0], nx, _CMP_GE_OQ),
                                        _mm256_or_pd(_mm256_cmp_pd(p[1], ny, _CMP_GE_OQ),
                                                     _mm256_cmp_pd(p[2], nz, _CMP_GE_OQ))));
        lost = (uint32_t)_mm256_movemask_pd(bad);
        live = (uint32_t)_mm256_movemask_pd(out) & ~lost;
        if ((lost | live) != 0) {
            *rejected += voxrti_popcount64(lost);
            *outside += voxrti_popcount64(live);
        }
        live = ~(lost | live) & 15u;
        x = _mm256_cvttpd_epi32(p[0]);
        y = _mm256_cvttpd_epi32(p[1]);
        k = _mm256_cvttpd_epi32(p[2]);
        _mm_storeu_si128((__m128i *)(void *)cx, x);
        _mm_storeu_si128((__m128i *)(void *)cy, y);
        _mm_storeu_si128((__m128i *)(void *)ck, k);
        _mm_storeu_si128((__m128i *)(void *)at, _mm_add_epi32(_mm_sll_epi32(_mm_add_epi32(_mm_sll_epi32(y, row_log), x),
                word_log), _mm_srli_epi32(k, 5)));
        for (a = 0; a < 4; a++) {
            if ((live >> a & 1u) == 0 || (voxrti_load_shared(&layer[at[a]]) >> (ck[a] & 31u) & 1u) != 0) continue;
            voxrti_insert_run(in, cx[a], cy[a], ck[a], ck[a]);
        }
    }
    return i;
}
#endif

static void voxrti_task_insert_points(void *ctx, uint32_t index) {
    voxrti_insert *in = (voxrti_insert *)ctx;
    size_t i = (size_t)index * VOXRTI_INSERT_TASK * 16, end = i + VOXRTI_INSERT_TASK * 16;
    uint64_t rejected = 0, outside = 0;
    end = end < in->count ? end : in->count;
#if VOXRTI_AVX2
    if (in->isa >= VOXRT_ISA_AVX2) i = voxrti_insert_points_avx2(in, i, end, &rejected, &outside);
#endif
    voxrti_insert_points_scalar(in, i, end, &rejected, &outside);
    voxrti_tally_add(in->rejected, rejected);
    voxrti_tally_add(in->outside, outside);
}

VOXRTI_INLINE int voxrti_spacing_ok(float spacing) {
    return spacing == 0.0f || (spacing >= 0.015625f && spacing <= 64.0f);
}

/* Close what all kinds of insertion open: the layer, the matrix, the threads. */
static voxrt_result voxrti_insert_open(voxrti_insert *in, voxrt_columns *c, const voxrt_columns_insert_desc *desc,
                                       voxrt_columns_insert_desc *d) {
    uint32_t a, b, any = 0;
    memset(in, 0, sizeof *in);
    if (desc != NULL) *d = *desc;
    else memset(d, 0, sizeof *d);
    if (d->_begin_zero != 0 || d->_end_zero != 0) return VOXRT_ERR_UNINIT_DESC;
    if (c == NULL || (uint32_t)d->mode > VOXRT_COLUMNS_BODY)
        return voxrti_fail(d->env.error, VOXRT_ERR_INVALID_ARG, (uint64_t)d->mode, "no grid, or unknown mode %");
    if (!voxrti_spacing_ok(d->spacing))
        return voxrti_fail(d->env.error, VOXRT_ERR_INVALID_ARG, 0, "spacing is not 0, nor from 1/64 to 64");
    for (a = 0; a < 12; a++) {
        if (!voxrti_finite(d->to_world[a]))
            return voxrti_fail(d->env.error, VOXRT_ERR_INVALID_ARG, a, "to_world[%] is not finite");
        any |= (uint32_t)(d->to_world[a] != 0.0);
    }
    for (a = 0; a < 3; a++) {
        for (b = 0; b < 4; b++) {
            double w = any ? d->to_world[4 * c->axis[a] + b] : b == c->axis[a] ? 1.0 : 0.0;
            if (b == 3) w -= c->origin[a];
            in->m[4 * a + b] = w * c->per_cell[a];
        }
    }
    in->columns = c;
    in->isa = (int)voxrt_isa_best();
    in->mode = d->mode;
    in->per_length = 1.0 / ((d->spacing > 0.0f ? (double)d->spacing : 0.5) *
                            voxrti_min(c->cell[0], voxrti_min(c->cell[1], c->cell[2])));
    in->still = d->still != 0;
    in->shared = d->env.parallel.for_fn != NULL || voxrti_thread_count(&d->env) > 1;
    if (in->still && c->still == NULL) {
        const size_t n = (size_t)c->size[0] * c->size[1] * c->words;
        c->still = (uint32_t *)voxrti_alloc_zero(&c->mem, n, 4);
        if (c->still == NULL)
            return voxrti_fail(d->env.error, VOXRT_ERR_NO_MEMORY, n, "no memory for a layer of % words");
    }
    return VOXRT_OK;
}

/* Parities -> inside, in closed columns; set: these cells. */
static uint64_t voxrti_insert_inside(const voxrti_insert *in, int set) {
    const voxrt_columns *c = in->columns;
    const size_t n = ((size_t)c->rows[0] << c->row_log[0]) << c->word_log;
    uint64_t open = 0;
    uint32_t x, y, w;
    for (y = 0; y < c->size[1]; y++)
        for (x = 0; x < c->size[0]; x++) {
            uint32_t *f = in->flips + voxrti_column(c, 0, x, y);
            if ((in->flips[n + (size_t)y * c->map_row[0] + (x >> 5)] >> (x & 31u) & 1u) != 0) {
                open++;
                memset(f, 0, 4 * (size_t)c->words);
                continue;
            }
            for (w = 0; w < c->words && set; w++) {
                uint32_t bits = f[w];
                while (bits != 0) { /* runs of ones */
                    const uint32_t lo = voxrti_ctz64(bits), up = ~(bits >> lo);
                    const uint32_t run = up != 0 ? voxrti_ctz64(up) : 32;
                    voxrti_insert_run(in, x, y, 32 * w + lo, 32 * w + lo + run - 1);
                    bits = lo + run < 32 ? bits & (0xffffffffu << (lo + run)) : 0;
                }
            }
        }
    return open;
}

static uint32_t voxrti_insert_tasks(const voxrti_insert *in) {
    return (uint32_t)((in->count + VOXRTI_INSERT_TASK - 1) / VOXRTI_INSERT_TASK);
}

/* Make room for parities. BODY: find which cells lie inside; in->flips and in->inside are to be freed. */
static voxrt_result voxrti_insert_parity(voxrti_insert *in, const voxrt_env *env, int set, uint64_t *open) {
    voxrt_columns *c = in->columns;
    const size_t n = ((size_t)c->words * c->size[0] + c->map_row[0]) * c->size[1];
    in->flips = (uint32_t *)voxrti_alloc_zero(&c->mem, n, 4);
    if (in->flips == NULL) return voxrti_fail(env->error, VOXRT_ERR_NO_MEMORY, n, "no memory for % words of parities");
    if (in->mode != VOXRT_COLUMNS_BODY) return VOXRT_OK;
    voxrti_parallel_for(env, voxrti_task_insert_mesh, in, voxrti_insert_tasks(in));
    *open = voxrti_insert_inside(in, set);
    in->inside = in->flips;
    return VOXRT_OK;
}

/* The cells of in->mesh. open: columns in which it is not closed. */
static voxrt_result voxrti_insert_mesh(voxrti_insert *in, const voxrt_env *env, uint64_t *open) {
    voxrt_columns *c = in->columns;
    voxrti_insert again;
    *open = 0;
    in->count = in->mesh->triangle_count;
    if (in->mode == VOXRT_COLUMNS_SOLID || in->mode == VOXRT_COLUMNS_BODY) {
        const voxrt_result r = voxrti_insert_parity(in, env, 1, open);
        if (r != VOXRT_OK) return r;
    }
    again = *in; /* what BODY leaves out has been counted */
    voxrti_parallel_for(env, voxrti_task_insert_mesh, &again, voxrti_insert_tasks(in));
    if (in->mode != VOXRT_COLUMNS_BODY) *in = again;
    if (in->mode == VOXRT_COLUMNS_SOLID) *open = voxrti_insert_inside(in, 1);
    voxrti_free(&c->mem, in->flips);
    in->flips = NULL;
    in->inside = NULL;
    return VOXRT_OK;
}

VOXRT_DEF voxrt_result voxrt_columns_insert(voxrt_columns *columns, const voxrt_columns_insert_desc *desc,
                                            const voxrt_mesh *mesh, voxrt_columns_insert_stats *stats) {
    voxrt_columns_insert_desc d;
    voxrti_insert in;
    uint64_t open = 0;
    voxrt_result r;
    if (mesh == NULL || (mesh->triangle_count != 0 && mesh->positions == NULL)) return VOXRT_ERR_INVALID_ARG;
    r = voxrti_insert_open(&in, columns, desc, &d);
    if (r != VOXRT_OK) return r;
    if (mesh->triangle_count / VOXRTI_INSERT_TASK >= 0x7fffffff)
        return voxrti_fail(d.env.error, VOXRT_ERR_INVALID_ARG, mesh->triangle_count, "% triangles are too many");
    in.mesh = mesh;
    r = voxrti_insert_mesh(&in, &d.env, &open);
    if (r != VOXRT_OK) return r;
    if (stats != NULL) {
        stats->items += in.count;
        stats->rejected += voxrti_tally(in.rejected);
        stats->outside += voxrti_tally(in.outside);
        stats->open_columns += open;
    }
    return VOXRT_OK;
}

VOXRT_DEF voxrt_result voxrt_columns_insert_points(voxrt_columns *columns, const voxrt_columns_insert_desc *desc,
                                                   const float *xyz, size_t stride, size_t count,
                                                   voxrt_columns_insert_stats *stats) {
    voxrt_columns_insert_desc d;
    voxrti_insert in;
    voxrt_result r;
    if ((xyz == NULL && count != 0) || (stride != 0 && stride < 12)) return VOXRT_ERR_INVALID_ARG;
    r = voxrti_insert_open(&in, columns, desc, &d);
    if (r != VOXRT_OK) return r;
    if (count / (VOXRTI_INSERT_TASK * 16) >= 0x7fffffff)
        return voxrti_fail(d.env.error, VOXRT_ERR_INVALID_ARG, count, "% points are too many");
    in.points = (const uint8_t *)xyz;
    in.point_stride = stride != 0 ? stride : 12;
    in.count = count;
    voxrti_parallel_for(&d.env, voxrti_task_insert_points, &in,
                        (uint32_t)((count + VOXRTI_INSERT_TASK * 16 - 1) / (VOXRTI_INSERT_TASK * 16)));
    if (stats != NULL) {
        stats->items += count;
        stats->rejected += voxrti_tally(in.rejected);
        stats->outside += voxrti_tally(in.outside);
    }
    return VOXRT_OK;
}

/* ---- hierarchy ---- */

VOXRTI_INLINE void voxrti_columns_or4(const voxrt_columns *c, uint32_t level, uint32_t x, uint32_t y) {
    const uint32_t right = c->row_log[level - 1] > 0 ? c->words : 0;
    const size_t down = c->rows[level - 1] > 1 ? (size_t)c->words << c->row_log[level - 1] : 0;
    const uint32_t *from = c->bits + voxrti_column(c, level - 1, right != 0 ? 2 * x : 0, down != 0 ? 2 * y : 0);
    uint32_t *to = c->bits + voxrti_column(c, level, x, y), w;
    for (w = 0; w < c->words; w += 2) {
        to[w] = (from[w] | from[w + right]) | (from[w + down] | from[w + right + down]);
        to[w + 1] = (from[w + 1] | from[w + right + 1]) | (from[w + down + 1] | from[w + right + down + 1]);
    }
}

/* A row of a level, from two rows of the level below. */
static void voxrti_columns_or_row(const voxrt_columns *c, uint32_t level, uint32_t y) {
    const uint32_t n = 1u << c->row_log[level];
    uint32_t x = 0;
#if VOXRTI_X64
    const uint32_t words = c->words;
    const int half = c->rows[level - 1] > 1;
    if (c->row_log[level - 1] > 0) {
        const uint32_t *from = c->bits + voxrti_column(c, level - 1, 0, half ? 2 * y : 0);
        const uint32_t *next = from + (half ? (size_t)words << c->row_log[level - 1] : 0);
        uint32_t *to = c->bits + voxrti_column(c, level, 0, y), w;
#  define VOXRTI_LOAD(p) _mm_loadu_si128((const __m128i *)(const void *)(p))
        if (words >= 4) {
            for (; x < n; x++, from += words, next += words)
                for (w = 0; w < words; w += 4, to += 4, from += 4, next += 4)
                    _mm_storeu_si128((__m128i *)(void *)to,
                                     _mm_or_si128(_mm_or_si128(VOXRTI_LOAD(from), VOXRTI_LOAD(from + words)),
                                                  _mm_or_si128(VOXRTI_LOAD(next), VOXRTI_LOAD(next + words))));
        }
#  undef VOXRTI_LOAD
    }
#endif
    for (; x < n; x++) voxrti_columns_or4(c, level, x, y);
}

VOXRT_DEF void voxrt_columns_update(voxrt_columns *columns) {
    voxrt_columns *c = columns;
    uint32_t l, x, y;
    if (c == NULL) return;
    if (c->all_changed) {
        for (l = 1; l < c->levels; l++)
            for (y = 0; y < c->rows[l]; y++) voxrti_columns_or_row(c, l, y);
        for (l = 0; l < c->levels; l++)
            memset(c->changed + c->map_start[l], 0, (size_t)c->map_row[l] * c->rows[l] * 4);
        c->all_changed = 0;
        return;
    }
    for (l = 0; l < c->levels; l++) {
        uint32_t *map = c->changed + c->map_start[l];
        for (y = 0; y < c->rows[l]; y++)
            for (x = 0; x < c->map_row[l]; x++) {
                uint32_t bits = map[(size_t)y * c->map_row[l] + x];
                map[(size_t)y * c->map_row[l] + x] = 0;
                if (bits == 0) continue;
                if (l + 1 < c->levels) { /* mark the parents: one where there was one column only */
                    uint32_t *up = c->changed + c->map_start[l + 1];
                    uint32_t pairs = bits, px = x;
                    if (c->row_log[l] > 0) {
                        pairs = (pairs | pairs >> 1) & 0x55555555u;
                        pairs = (pairs | pairs >> 1) & 0x33333333u;
                        pairs = (pairs | pairs >> 2) & 0x0f0f0f0fu;
                        pairs = (pairs | pairs >> 4) & 0x00ff00ffu;
                        pairs = ((pairs | pairs >> 8) & 0xffffu) << (x & 1u ? 16 : 0);
                        px = x >> 1;
                    }
                    up[(size_t)(c->rows[l] > 1 ? y >> 1 : 0) * c->map_row[l + 1] + px] |= pairs;
                }
                for (; bits != 0 && l > 0; bits &= bits - 1) voxrti_columns_or4(c, l, 32 * x + voxrti_ctz64(bits), y);
            }
    }
}

/* ---- rays ---- */

/* A ray in the grid, in cells: from its entry into the box on, at speed 1 along its fastest axis. world t = t_in + t *
   per_t. */
typedef struct voxrti_column_ray {
    float o[3], d[3], t_max;
    double t_in, per_t;
} voxrti_column_ray;

/* A surface on which an end of the ray lies: the plane n . (cell centre - at) = 0. Cells whose centres are at most half
   a cell's width along n away from it do not count near `at`. As intervals of a column (x, y): base - slope .
   (x + c[0], y + c[1]) -+ half, within lo .. hi, where |x + c[0]| and |y + c[1]| are within reach. */
typedef struct voxrti_column_plane {
    float c[2], slope[2], base, half, lo, hi;
} voxrti_column_plane;

#define VOXRTI_COLUMN_TOP 7 /* no ray looks at levels above: eight of them fit into a register of AVX2 */

/* 1: to be traced; 0: misses the box; -1: a bad ray */
static int voxrti_column_ray_open(const voxrt_columns *c, const voxrt_ray *ray, voxrti_column_ray *r) {
    double o[3], d[3], t0 = (double)ray->t_min, t1 = (double)ray->t_max, speed = 0.0, per_t;
    uint32_t a;
    memset(r, 0, sizeof *r);
    if (!(t0 <= t1) || !voxrti_finite(t0)) return -1;
    for (a = 0; a < 3; a++) {
        const float ro = ray->org[c->axis[a]], rd = ray->dir[c->axis[a]];
        if (!voxrti_finite_f(ro) || !voxrti_finite_f(rd)) return -1;
        o[a] = ((double)ro - c->origin[a]) * c->per_cell[a];
        d[a] = (double)rd * c->per_cell[a];
        speed = voxrti_max(speed, voxrti_abs(d[a]));
    }
    if (!(speed > 0.0)) return -1;
    for (a = 0; a < 3; a++) {
        const double n = (double)c->size[a];
        if (voxrti_abs(d[a]) <= speed * 1e-12) { /* over 4096 cells that is less than floats can tell */
            d[a] = 0.0;
            if (!(o[a] >= 0.0 && o[a] < n)) return 0;
        } else {
            const double inv = 1.0 / d[a], x = (0.0 - o[a]) * inv, y = (n - o[a]) * inv;
            t0 = voxrti_max(t0, x < y ? x : y);
            t1 = voxrti_min(t1, x < y ? y : x);
        }
    }
    if (!(t0 <= t1)) return 0;
    per_t = 1.0 / speed;
    for (a = 0; a < 3; a++) {
        const float most = (float)c->size[a] * (1.0f - 5.9604645e-8f);
        float p = (float)(o[a] + t0 * d[a]);
        p = p > 0.0f ? p : 0.0f;
        r->o[a] = p < most ? p : most;
        r->d[a] = (float)(d[a] * per_t) + 0.0f; /* no -0 */
    }
    r->t_max = (float)((t1 - t0) * speed);
    r->t_in = t0;
    r->per_t = per_t;
    return 1;
}

/* Planes are that much thicker than a cell: a surface between two layers of cells lies in one of them, and where points
   on it are a little off they would be in the shadow of that. */
#define VOXRTI_COLUMN_WIDER 1.02
#define VOXRTI_COLUMN_NO_PLANE 1e9f /* as lo: no cell is above that */

/* at: t of the end point; reach: in cells, along the grid's axes. A normal of 0: no plane. */
static void voxrti_column_plane_open(const voxrt_columns *c, const voxrt_ray *ray, double at, const float normal[3],
                                     const float reach[3], voxrti_column_plane *p) {
    const float limit = (float)c->size[2];
    double wide = 0.0;
    float n[3], end[3], width, flat, steep, inv, lo, hi;
    uint32_t a;
    for (a = 0; a < 3; a++) {
        const uint32_t w = c->axis[a];
        const double m = (double)normal[w] * c->cell[a];
        double x = (((double)ray->org[w] + at * (double)ray->dir[w]) - c->origin[a]) * c->per_cell[a];
        x = x > -1e6 ? x : -1e6; /* nothing is near */
        x = x < 1e6 ? x : 1e6;
        n[a] = (float)m;
        end[a] = (float)x;
        wide += 0.5 * voxrti_abs(m);
    }
    width = (float)(wide * VOXRTI_COLUMN_WIDER);
    flat = 1e-6f * width; /* a plane along the columns: half is so large then that a column is in or out as a whole */
    steep = voxrti_absf(n[2]) > flat ? n[2] : flat;
    inv = 1.0f / steep;
    lo = (end[2] - 0.5f) - reach[2];
    hi = (end[2] - 0.5f) + reach[2];
    p->c[0] = 0.5f - end[0];
    p->c[1] = 0.5f - end[1];
    p->slope[0] = n[0] * inv;
    p->slope[1] = n[1] * inv;
    p->base = end[2] - 0.5f;
    p->half = width * voxrti_absf(inv);
    p->lo = lo > 0.0f ? lo : 0.0f;
    p->hi = hi < limit ? hi : limit;
    if (width > 0.0f && width < 1e30f) return;
    p->slope[0] = p->slope[1] = p->half = 0.0f;
    p->lo = VOXRTI_COLUMN_NO_PLANE;
}

/* Cells lo .. hi of column (x, y) that a plane takes out; lo > hi: none. */
VOXRTI_INLINE void voxrti_column_plane_cells(const voxrti_column_plane *p, const float reach[3], int x, int y,
                                             int *out_lo, int *out_hi) {
    const float dx = (float)x + p->c[0], dy = (float)y + p->c[1];
    const float mid = p->base - (p->slope[0] * dx + p->slope[1] * dy);
    float lo = mid - p->half, hi = mid + p->half;
    int i, k;
    lo = lo > p->lo ? lo : p->lo;
    lo = lo < 512.0f ? lo : 512.0f;
    hi = hi < p->hi ? hi : p->hi;
    hi = hi > -1.0f ? hi : -1.0f;
    i = (int)lo;
    k = (int)hi;
    *out_lo = i + ((float)i < lo); /* ceil */
    *out_hi = k - ((float)k > hi); /* floor */
    if (!(voxrti_absf(dx) <= reach[0] && voxrti_absf(dy) <= reach[1])) *out_hi = -1;
}

VOXRTI_INLINE uint32_t voxrti_column_mask(int lo, int hi, int word) { /* cells lo .. hi of a word */
    lo -= 32 * word;
    hi -= 32 * word;
    if (lo > 31 || hi < 0 || lo > hi) return 0;
    return 0xffffffffu << (lo > 0 ? lo : 0) & 0xffffffffu >> (hi < 31 ? 31 - hi : 0);
}

VOXRTI_INLINE int voxrti_clamp_int(int x, int lo, int hi) { return x < lo ? lo : x > hi ? hi : x; }

typedef struct voxrti_column_found {
    float t;      /* of the ray in cells */
    int x, y, k;
    uint32_t face; /* grid axis: 2 a + (1: upper side), 6: inside */
} voxrti_column_found;

/* Which column along one axis at t, from `from` on and not beyond `most`: all borders are crossed that come before t
   (ties: at t, too). The same answer from any level of the hierarchy: it goes by the t of the borders alone. Where the
   ray is says it but for rounding, less than 1/256 of a cell on at most 4096: look from that much behind, then there is
   one border to ask. */
VOXRTI_INLINE int voxrti_column_at(float o, float d, float inv, float t, int from, int most, int ties) {
    const int on = d >= 0.0f;
    int x = (int)((o - (on ? 0.00390625f : -0.00390625f)) + t * d);
    float ahead;
    if (on) x = x < from ? from : x > most ? most : x;
    else x = x > from ? from : x < most ? most : x;
    ahead = ((float)(x + on) - o) * inv;
    if (x != most && (ahead < t || (ties && ahead == t))) x += on ? 1 : -1;
    return x;
}

typedef struct voxrti_column_log { /* voxrt_columns_explain */
    voxrt_column_step *step;
    size_t count, most;
    double t_in, per_t;
} voxrti_column_log;

static VOXRTI_NOINLINE void voxrti_column_note(voxrti_column_log *log, float t, float te, int level, int cx, int cy,
                                               int lo, int hi, uint32_t found) {
    voxrt_column_step *s;
    if (log->count++ >= log->most) return;
    s = &log->step[log->count - 1];
    s->t_in = (float)(log->t_in + (double)t * log->per_t);
    s->t_out = (float)(log->t_in + (double)te * log->per_t);
    s->level = (uint32_t)level;
    s->column[0] = (uint32_t)cx;
    s->column[1] = (uint32_t)cy;
    s->depth[0] = (uint32_t)lo;
    s->depth[1] = (uint32_t)hi;
    s->found = found;
}

/* Step from column to column; the depths at which the ray is above a column are an interval of its bits. Where a level
   has none of them set it is left as a whole, and the next step tries one level up if it crossed a border of that; else
   one level down. The t of the step out of a column is that of the step into the next: no gap between their
   intervals. */
static int voxrti_column_walk(const voxrt_columns *c, const voxrti_column_ray *r, const voxrti_column_plane *plane,
                              uint32_t planes, const float reach[3], uint32_t start, voxrti_column_found *f,
                              voxrti_column_log *log, voxrt_stats *stats) {
    const float ox = r->o[0], oy = r->o[1], oz = r->o[2], dx = r->d[0], dy = r->d[1], dz = r->d[2], t_max = r->t_max;
    /* a ray that stays in its row never comes to the border ahead: that lies more than 0 away, times infinity */
    const float ix = dx != 0.0f ? 1.0f / dx : INFINITY, iy = dy != 0.0f ? 1.0f / dy : INFINITY;
    const int px = dx >= 0.0f, py = dy >= 0.0f, up = dz >= 0.0f;
    const int nx = (int)c->size[0], ny = (int)c->size[1], nz = (int)c->size[2];
    const int top = c->levels > VOXRTI_COLUMN_TOP ? VOXRTI_COLUMN_TOP : (int)c->levels - 1;
    int level = (int)start < top ? (int)start : top, x = (int)ox, y = (int)oy, ka = (int)oz;
    float t = 0.0f;
    uint64_t steps = 0, descents = 0;
    uint32_t face = 6, found = 0;
    for (;;) {
        const int cx = x >> level, cy = y >> level, ex = (cx + px) << level, ey = (cy + py) << level;
        const float tx = ((float)ex - ox) * ix, ty = ((float)ey - oy) * iy;
        float te = tx < ty ? tx : ty;
        const uint32_t *column = c->bits + voxrti_column(c, (uint32_t)level, (uint32_t)cx, (uint32_t)cy);
        int kb, lo, hi, w, last, gone[2][2], old_x, old_y;
        uint32_t bits = 0, p;
        te = te < t_max ? te : t_max;
        te = te > t ? te : t;
        kb = voxrti_clamp_int((int)(oz + te * dz), 0, nz - 1);
        lo = kb < ka ? kb : ka;
        hi = kb > ka ? kb : ka;
        for (p = 0; p < planes && level == 0; p++)
            voxrti_column_plane_cells(&plane[p], reach, x, y, &gone[p][0], &gone[p][1]);
        last = kb >> 5;
        for (w = ka >> 5;; w += up ? 1 : -1) {
            bits = column[w] & voxrti_column_mask(lo, hi, w);
            for (p = 0; p < planes && level == 0; p++) bits &= ~voxrti_column_mask(gone[p][0], gone[p][1], w);
            if (bits != 0 || w == last) break;
        }
        if (log != NULL) voxrti_column_note(log, t, te, level, cx, cy, lo, hi, bits == 0 ? 0 : level > 0 ? 1 : 2);
        if (bits != 0 && level > 0) {
            level--;
            descents++;
            continue;
        }
        if (bits != 0) {
            const int k = 32 * w + (up ? (int)voxrti_ctz64(bits) : 31 - (int)voxrti_clz32(bits));
            f->t = t;
            if (k != ka) { /* the ray comes from the cells above or below in this column */
                const float tk = ((float)(up ? k : k + 1) - oz) / dz;
                f->t = tk > t ? tk : t;
                face = up ? 4 : 5;
            }
            f->x = x;
            f->y = y;
            f->k = k;
            f->face = face;
            found = 1;
            break;
        }
        steps++;
        if (te >= t_max) break;
        old_x = x;
        old_y = y;
        if (tx < ty) {
            x = px ? ex : ex - 1;
            y = voxrti_column_at(oy, dy, iy, te, y, py ? ((cy + 1) << level) - 1 : cy << level, 1);
            face = px ? 0 : 1;
        } else {
            y = py ? ey : ey - 1;
            x = voxrti_column_at(ox, dx, ix, te, x, px ? ((cx + 1) << level) - 1 : cx << level, 0);
            face = py ? 2 : 3;
        }
        if (x < 0 || y < 0 || x >= nx || y >= ny) break;
        t = te;
        ka = kb;
        if (((x ^ old_x) | (y ^ old_y)) >> (level + 1) != 0 && level < top) level++;
    }
    if (stats != NULL) {
        stats->steps += steps;
        stats->descents += descents;
    }
    return (int)found;
}

#define VOXRTI_COLUMN_BATCH 64 /* rays or points that are worked on side by side */

typedef struct voxrti_column_trace {
    const voxrt_columns *columns;
    const float *normals, *end_normals;
    float reach[3];          /* of the planes, in cells */
    uint32_t start, planes;
    int isa;
    voxrt_stats *stats;
} voxrti_column_trace;

/* What one ray has found: f NULL, nothing. */
VOXRTI_INLINE void voxrti_column_report(const voxrti_column_trace *t, const voxrt_ray *ray, double t_in, double per_t,
                                        const voxrti_column_found *f, voxrt_column_hit *hit) {
    const float at = (float)(t_in + (double)f->t * per_t);
    hit->t = at > ray->t_min ? at : ray->t_min;
    hit->cell[0] = (uint32_t)f->x;
    hit->cell[1] = (uint32_t)f->y;
    hit->cell[2] = (uint32_t)f->k;
    hit->face = f->face == 6 ? 6 : 2 * t->columns->axis[f->face >> 1] + (f->face & 1u);
}

VOXRTI_INLINE void voxrti_column_miss(voxrt_column_hit *hits, uint8_t *occluded, size_t i) {
    if (hits != NULL) {
        memset(&hits[i], 0, sizeof hits[i]);
        hits[i].t = INFINITY;
    } else if (occluded != NULL) {
        occluded[i] = 0;
    }
}

static void voxrti_column_trace_scalar(const voxrti_column_trace *t, const voxrt_ray *rays, size_t count,
                                       voxrt_column_hit *hits, uint8_t *occluded, voxrti_column_log *log) {
    size_t i;
    for (i = 0; i < count; i++) {
        voxrti_column_ray r;
        voxrti_column_plane plane[2];
        voxrti_column_found f;
        uint32_t planes = 0;
        const int open = voxrti_column_ray_open(t->columns, &rays[i], &r);
        voxrti_column_miss(hits, occluded, i);
        if (t->stats != NULL) t->stats->bad_rays += open < 0;
        if (open != 1) continue;
        if (log != NULL) {
            log->t_in = r.t_in;
            log->per_t = r.per_t;
        }
        if (t->normals != NULL)
            voxrti_column_plane_open(t->columns, &rays[i], 0.0, t->normals + 3 * i, t->reach, &plane[planes++]);
        if (t->end_normals != NULL && rays[i].t_max < INFINITY)
            voxrti_column_plane_open(t->columns, &rays[i], (double)rays[i].t_max, t->end_normals + 3 * i, t->reach,
                                     &plane[planes++]);
        if (!voxrti_column_walk(t->columns, &r, plane, planes, t->reach, t->start, &f, log, t->stats)) continue;
        if (t->stats != NULL) t->stats->hits++;
        if (hits != NULL) voxrti_column_report(t, &rays[i], r.t_in, r.per_t, &f, &hits[i]);
        else occluded[i] = 1;
    }
}

/* ---- rays in AVX2: groups of eight, whose steps do not wait for each other ----
   Four lanes of SSE were no faster than one ray after the other. */

#if VOXRTI_AVX2

enum { /* of a ray that is ready, and of two planes */
    VOXRTI_CF_O, VOXRTI_CF_D = 3, VOXRTI_CF_INV = 6, VOXRTI_CF_T_MAX = 8, VOXRTI_CF_PLANE = 9,
    VOXRTI_CP_C = 0, VOXRTI_CP_SLOPE = 2, VOXRTI_CP_BASE = 4, VOXRTI_CP_HALF, VOXRTI_CP_LO, VOXRTI_CP_HI,
    VOXRTI_CP_FIELDS, VOXRTI_CF_FIELDS = 25
};

#define VOXRTI_COLUMN_READY 52 /* rays that are prepared ahead; rows of 60 do not fall on each other in the cache */

/* Rays that are ready, fields apart; any eight in a row can be loaded. */
typedef struct voxrti_column_ready {
    uint32_t count, next;
    float f[VOXRTI_CF_FIELDS][VOXRTI_COLUMN_READY + 8];
    double t_in[VOXRTI_COLUMN_READY + 8], per_t[VOXRTI_COLUMN_READY + 8];
    uint32_t id[VOXRTI_COLUMN_READY + 8];
} voxrti_column_ready;

/* Eight rays on their way. A lane that has ended keeps what it had. */
typedef struct voxrti_column_lanes {
    __m256 f[VOXRTI_CF_FIELDS], behind[2], t; /* behind: origin, 1/256 back */
    __m256i on[2], back[2];                   /* by x, y: 1 forwards, else 0; -1 backwards, else 0 */
    /* by_x: -1 the last step was along x, 0 along y; 1: none yet. hit: -1, it ended at a cell from lo to hi */
    __m256i x, y, level, k, by_x, lo, hi, hit, alive;
    double t_in[8], per_t[8];
    int32_t column[8];                        /* where that of x, y, level starts; 0 for a lane that has ended */
    uint32_t id[8], held;                     /* held: lanes with a ray, bits */
} voxrti_column_lanes;

typedef struct voxrti_column_const {
    const int *bits;
    __m256i start, row, up;  /* by level: where it starts, log2 of its rows, shift that finds borders of the next */
    __m256i last_k, log_x, log_y, level;
    __m256 reach[2];
    __m128i word_log;
    uint32_t planes, fields, words, large;
} voxrti_column_const;

VOXRTI_TARGET_AVX2 static void voxrti_column_const_open(const voxrti_column_trace *t, voxrti_column_const *k) {
    const voxrt_columns *c = t->columns;
    const uint32_t top = c->levels > VOXRTI_COLUMN_TOP ? VOXRTI_COLUMN_TOP : c->levels - 1;
    int32_t start[8], row[8], up[8];
    uint32_t l;
    for (l = 0; l < 8; l++) {
        start[l] = l < c->levels ? (int32_t)c->start[l] : 0;
        row[l] = l < c->levels ? (int32_t)c->row_log[l] : 0;
        up[l] = l < top ? (int32_t)l + 1 : 31;
    }
    k->bits = (const int *)c->bits;
    k->start = _mm256_loadu_si256((const __m256i *)(const void *)start);
    k->row = _mm256_loadu_si256((const __m256i *)(const void *)row);
    k->up = _mm256_loadu_si256((const __m256i *)(const void *)up);
    k->last_k = _mm256_set1_epi32((int)c->size[2] - 1);
    k->log_x = _mm256_set1_epi32((int)voxrti_log2_u32(c->size[0]));
    k->log_y = _mm256_set1_epi32((int)voxrti_log2_u32(c->size[1]));
    k->level = _mm256_set1_epi32((int)(t->start < top ? t->start : top));
    k->reach[0] = _mm256_set1_ps(t->reach[0]);
    k->reach[1] = _mm256_set1_ps(t->reach[1]);
    k->word_log = _mm_cvtsi32_si128((int)c->word_log);
    k->planes = t->planes;
    k->words = c->words;
    k->large = (uint64_t)c->size[0] * c->size[1] * c->words > 0x40000; /* level 0: more than 1 MiB */
    k->fields = VOXRTI_CF_PLANE + VOXRTI_CP_FIELDS * t->planes;
}

/* voxrti_column_ray_open for four rays: what is ready goes to `at` of the arrays. Returns lanes that are to be traced;
   bad: those that are bad. */
VOXRTI_TARGET_AVX2 static uint32_t voxrti_column_setup4(const voxrt_columns *c, const __m256 v[4], uint32_t at,
                                                        voxrti_column_ready *g, uint32_t *bad) {
    const __m256d zero = _mm256_setzero_pd(), sign = _mm256_set1_pd(-0.0);
    __m256d o[3], d[3], t0 = _mm256_cvtps_pd(_mm256_castps256_ps128(v[3])), speed = zero, ok, in = sign, per_t;
    __m256d t1 = _mm256_cvtps_pd(_mm256_extractf128_ps(v[3], 1));
    uint32_t a, good;
    in = _mm256_cmp_pd(in, in, _CMP_EQ_OQ);
    ok = _mm256_and_pd(_mm256_cmp_pd(t0, t1, _CMP_LE_OQ), _mm256_cmp_pd(_mm256_sub_pd(t0, t0), zero, _CMP_EQ_OQ));
    for (a = 0; a < 3; a++) {
        const __m256 w = v[c->axis[a]];
        const __m256d ro = _mm256_cvtps_pd(_mm256_castps256_ps128(w));
        const __m256d rd = _mm256_cvtps_pd(_mm256_extractf128_ps(w, 1));
        const __m256d bad_a = _mm256_add_pd(_mm256_sub_pd(ro, ro), _mm256_sub_pd(rd, rd));
        ok = _mm256_and_pd(ok, _mm256_cmp_pd(bad_a, zero, _CMP_EQ_OQ));
        o[a] = _mm256_mul_pd(_mm256_sub_pd(ro, _mm256_set1_pd(c->origin[a])), _mm256_set1_pd(c->per_cell[a]));
        d[a] = _mm256_mul_pd(rd, _mm256_set1_pd(c->per_cell[a]));
        speed = _mm256_max_pd(speed, _mm256_andnot_pd(sign, d[a]));
    }
    ok = _mm256_and_pd(ok, _mm256_cmp_pd(speed, zero, _CMP_GT_OQ));
    good = (uint32_t)_mm256_movemask_pd(ok);
    *bad = ~good & 15u;
    for (a = 0; a < 3; a++) {
        const __m256d n = _mm256_set1_pd((double)c->size[a]);
        const __m256d still = _mm256_cmp_pd(_mm256_andnot_pd(sign, d[a]), _mm256_mul_pd(speed, _mm256_set1_pd(1e-12)),
                                            _CMP_LE_OQ);
        const __m256d inv = _mm256_div_pd(_mm256_set1_pd(1.0), d[a]);
        const __m256d x = _mm256_mul_pd(_mm256_sub_pd(zero, o[a]), inv), y = _mm256_mul_pd(_mm256_sub_pd(n, o[a]), inv);
        const __m256d t_in = _mm256_max_pd(t0, _mm256_min_pd(x, y)), t_out = _mm256_min_pd(t1, _mm256_max_pd(y, x));
        const __m256d inside = _mm256_and_pd(_mm256_cmp_pd(o[a], zero, _CMP_GE_OQ), _mm256_cmp_pd(o[a], n, _CMP_LT_OQ));
        t0 = _mm256_blendv_pd(t_in, t0, still);
        t1 = _mm256_blendv_pd(t_out, t1, still);
        d[a] = _mm256_andnot_pd(still, d[a]);
        in = _mm256_and_pd(in, _mm256_or_pd(inside, _mm256_cmp_pd(still, still, _CMP_EQ_OQ)));
    }
    in = _mm256_and_pd(in, _mm256_cmp_pd(t0, t1, _CMP_LE_OQ));
    per_t = _mm256_div_pd(_mm256_set1_pd(1.0), speed);
    for (a = 0; a < 3; a++) {
        const __m128 most = _mm_set1_ps((float)c->size[a] * (1.0f - 5.9604645e-8f));
        __m128 p = _mm256_cvtpd_ps(_mm256_add_pd(o[a], _mm256_mul_pd(t0, d[a]))), s;
        p = _mm_min_ps(_mm_max_ps(p, _mm_setzero_ps()), most);
        s = _mm_add_ps(_mm256_cvtpd_ps(_mm256_mul_pd(d[a], per_t)), _mm_setzero_ps());
        _mm_storeu_ps(&g->f[VOXRTI_CF_O + a][at], p);
        _mm_storeu_ps(&g->f[VOXRTI_CF_D + a][at], s);
        if (a < 2) _mm_storeu_ps(&g->f[VOXRTI_CF_INV + a][at], _mm_div_ps(_mm_set1_ps(1.0f), s));
    }
    _mm_storeu_ps(&g->f[VOXRTI_CF_T_MAX][at], _mm256_cvtpd_ps(_mm256_mul_pd(_mm256_sub_pd(t1, t0), speed)));
    _mm256_storeu_pd(&g->t_in[at], t0);
    _mm256_storeu_pd(&g->per_t[at], per_t);
    return good & (uint32_t)_mm256_movemask_pd(in);
}

/* voxrti_column_plane_open for four rays. end: at t_max instead of 0; rays without an end have none. */
VOXRTI_TARGET_AVX2 static void voxrti_column_planes4(const voxrti_column_trace *t, const __m256 v[4], int end,
                                                     const float *normals, uint32_t at,
                                                     float (*f)[VOXRTI_COLUMN_READY + 8]) {
    const voxrt_columns *c = t->columns;
    const __m256d sign = _mm256_set1_pd(-0.0);
    const __m128 half = _mm_set1_ps(0.5f), sign4 = _mm_set1_ps(-0.0f), one = _mm_set1_ps(1.0f);
    __m128 t_end = end ? _mm256_extractf128_ps(v[3], 1) : _mm_setzero_ps();
    __m128 n[3], p[3], width, flat, steep, inv, on, lo;
    __m256d wide = _mm256_setzero_pd();
    uint32_t a;
    for (a = 0; a < 3; a++) {
        const uint32_t w = c->axis[a];
        const __m128 from = _mm_setr_ps(normals[w], normals[3 + w], normals[6 + w], normals[9 + w]);
        const __m256d m = _mm256_mul_pd(_mm256_cvtps_pd(from), _mm256_set1_pd(c->cell[a]));
        __m256d x = _mm256_add_pd(_mm256_cvtps_pd(_mm256_castps256_ps128(v[w])),
                                  _mm256_mul_pd(_mm256_cvtps_pd(t_end),
                                                _mm256_cvtps_pd(_mm256_extractf128_ps(v[w], 1))));
        x = _mm256_mul_pd(_mm256_sub_pd(x, _mm256_set1_pd(c->origin[a])), _mm256_set1_pd(c->per_cell[a]));
        x = _mm256_min_pd(_mm256_max_pd(x, _mm256_set1_pd(-1e6)), _mm256_set1_pd(1e6));
        n[a] = _mm256_cvtpd_ps(m);
        p[a] = _mm256_cvtpd_ps(x);
        wide = _mm256_add_pd(wide, _mm256_mul_pd(_mm256_set1_pd(0.5), _mm256_andnot_pd(sign, m)));
    }
    width = _mm256_cvtpd_ps(_mm256_mul_pd(wide, _mm256_set1_pd(VOXRTI_COLUMN_WIDER)));
    flat = _mm_mul_ps(_mm_set1_ps(1e-6f), width);
    steep = _mm_blendv_ps(flat, n[2], _mm_cmpgt_ps(_mm_andnot_ps(sign4, n[2]), flat));
    inv = _mm_div_ps(one, steep);
    on = _mm_and_ps(_mm_cmpgt_ps(width, _mm_setzero_ps()), _mm_cmplt_ps(width, _mm_set1_ps(1e30f)));
    if (end) on = _mm_and_ps(on, _mm_cmplt_ps(t_end, _mm_set1_ps(INFINITY)));
    for (a = 0; a < 2; a++) {
        _mm_storeu_ps(&f[VOXRTI_CP_C + a][at], _mm_sub_ps(half, p[a]));
        _mm_storeu_ps(&f[VOXRTI_CP_SLOPE + a][at], _mm_and_ps(on, _mm_mul_ps(n[a], inv)));
    }
    p[2] = _mm_sub_ps(p[2], half);
    _mm_storeu_ps(&f[VOXRTI_CP_BASE][at], p[2]);
    _mm_storeu_ps(&f[VOXRTI_CP_HALF][at], _mm_and_ps(on, _mm_mul_ps(width, _mm_andnot_ps(sign4, inv))));
    lo = _mm_max_ps(_mm_sub_ps(p[2], _mm_set1_ps(t->reach[2])), _mm_setzero_ps());
    _mm_storeu_ps(&f[VOXRTI_CP_LO][at], _mm_blendv_ps(_mm_set1_ps(VOXRTI_COLUMN_NO_PLANE), lo, on));
    _mm_storeu_ps(&f[VOXRTI_CP_HI][at], _mm_min_ps(_mm_add_ps(p[2], _mm_set1_ps(t->reach[2])),
                                                   _mm_set1_ps((float)c->size[2])));
}

/* voxrti_column_plane_cells for eight lanes */
VOXRTI_TARGET_AVX2 VOXRTI_INLINE void voxrti_column_planes8(const voxrti_column_const *k, const __m256 *f, __m256i x,
                                                            __m256i y, __m256i *lo, __m256i *hi) {
    const __m256 sign = _mm256_set1_ps(-0.0f);
    const __m256 dx = _mm256_add_ps(_mm256_cvtepi32_ps(x), f[VOXRTI_CP_C]);
    const __m256 dy = _mm256_add_ps(_mm256_cvtepi32_ps(y), f[VOXRTI_CP_C + 1]);
    const __m256 mid = _mm256_sub_ps(f[VOXRTI_CP_BASE], _mm256_add_ps(_mm256_mul_ps(f[VOXRTI_CP_SLOPE], dx),
                                                                      _mm256_mul_ps(f[VOXRTI_CP_SLOPE + 1], dy)));
    const __m256 in = _mm256_and_ps(_mm256_cmp_ps(_mm256_andnot_ps(sign, dx), k->reach[0], _CMP_LE_OQ),
                                    _mm256_cmp_ps(_mm256_andnot_ps(sign, dy), k->reach[1], _CMP_LE_OQ));
    __m256 low = _mm256_max_ps(_mm256_sub_ps(mid, f[VOXRTI_CP_HALF]), f[VOXRTI_CP_LO]);
    __m256 high = _mm256_min_ps(_mm256_add_ps(mid, f[VOXRTI_CP_HALF]), f[VOXRTI_CP_HI]);
    low = _mm256_min_ps(low, _mm256_set1_ps(512.0f));
    high = _mm256_max_ps(high, _mm256_set1_ps(-1.0f));
    *lo = _mm256_cvtps_epi32(_mm256_ceil_ps(low));
    *hi = _mm256_or_si256(_mm256_cvtps_epi32(_mm256_floor_ps(high)), /* -1 if not in */
                          _mm256_andnot_si256(_mm256_castps_si256(in), _mm256_set1_epi32(-1)));
}

/* Where the bits are that the next step looks at: have them brought near, the other groups have their turns first. What
   the second cache holds as a whole is near enough: 4 to 9 % for nothing there, thrice as fast with 20 MB. */
VOXRTI_TARGET_AVX2 VOXRTI_INLINE void voxrti_column_aim8(const voxrti_column_const *k, voxrti_column_lanes *g) {
    const __m256i cx = _mm256_srav_epi32(g->x, g->level), cy = _mm256_srav_epi32(g->y, g->level);
    const __m256i rows = _mm256_permutevar8x32_epi32(k->row, g->level);
    uint32_t i;
    const __m256i column = _mm256_add_epi32(_mm256_permutevar8x32_epi32(k->start, g->level),
            _mm256_sll_epi32(_mm256_add_epi32(_mm256_sllv_epi32(cy, rows), cx), k->word_log));
    _mm256_storeu_si256((__m256i *)(void *)g->column, _mm256_and_si256(g->alive, column));
    for (i = 0; i < 8 && k->large; i++) VOXRTI_PREFETCH(k->bits + g->column[i]);
}

/* Is any of the cells lo .. hi of each of eight columns set? Not 0 if so. Columns are read as a whole and turned over:
   gathers of words, one after the other until the last lane has ended, took a quarter more. */
VOXRTI_TARGET_AVX2 VOXRTI_INLINE __m256i voxrti_column_any8(const voxrti_column_const *k, const int32_t column[8],
                                                            __m256i lo, __m256i hi) {
    const __m256i one = _mm256_set1_epi32(1);
    __m256i any = _mm256_setzero_si256(), word[4], a, b, c, d;
    uint32_t i, first;
    lo = _mm256_add_epi32(lo, one); /* hi may be -1 */
    hi = _mm256_add_epi32(hi, one);
    for (first = 0; first < k->words; first += 4) {
        const int *p = k->bits + first;
#define VOXRTI_TWO(u, v) _mm256_inserti128_si256(_mm256_castsi128_si256( \
        _mm_loadu_si128((const __m128i *)(const void *)(p + column[u]))), \
        _mm_loadu_si128((const __m128i *)(const void *)(p + column[v])), 1)
        const __m256i r0 = VOXRTI_TWO(0, 4), r1 = VOXRTI_TWO(1, 5), r2 = VOXRTI_TWO(2, 6), r3 = VOXRTI_TWO(3, 7);
#undef VOXRTI_TWO
        a = _mm256_unpacklo_epi32(r0, r1);
        b = _mm256_unpackhi_epi32(r0, r1);
        c = _mm256_unpacklo_epi32(r2, r3);
        d = _mm256_unpackhi_epi32(r2, r3);
        word[0] = _mm256_unpacklo_epi64(a, c);
        word[1] = _mm256_unpackhi_epi64(a, c);
        word[2] = _mm256_unpacklo_epi64(b, d);
        word[3] = _mm256_unpackhi_epi64(b, d);
        for (i = 0; i < 4; i++) { /* what lies below goes out at one end, then the rest at the other; 32: all of it */
            const int base = (int)(32 * (first + i));
            const __m256i below = _mm256_subs_epu16(lo, _mm256_set1_epi32(base + 1)); /* at least 0 */
            const __m256i above = _mm256_subs_epu16(_mm256_set1_epi32(base + 32), hi);
            any = _mm256_or_si256(any, _mm256_sllv_epi32(_mm256_srlv_epi32(word[i], below),
                                                         _mm256_add_epi32(below, above)));
        }
    }
    return any;
}

/* What planes leave of lo .. hi may be two or three intervals: take the first cell on the way that is set. gone: what
   they take out, lo and hi of each. */
static VOXRTI_NOINLINE void voxrti_column_apart(const voxrti_column_const *k, const int32_t column[8],
                                                const int32_t (*gone)[8], const int32_t ka[8], int32_t lo[8],
                                                int32_t hi[8]) {
    uint32_t i, p;
    for (i = 0; i < 8; i++) {
        const int up = ka[i] == lo[i];
        int at = up ? lo[i] : hi[i], out;
        for (; at >= lo[i] && at <= hi[i]; at += up ? 1 : -1) {
            for (p = 0, out = 0; p < k->planes; p++) out |= at >= gone[2 * p][i] && at <= gone[2 * p + 1][i];
            if (!out && ((uint32_t)k->bits[column[i] + (at >> 5)] >> (at & 31) & 1u) != 0) break;
        }
        if (!(at >= lo[i] && at <= hi[i])) at = -1;
        lo[i] = at >= 0 ? at : 1;
        hi[i] = at >= 0 ? at : 0;
    }
}

/* One turn of the loop of voxrti_column_walk for the lanes that are alive. Returns those that still are. any: what they
   meet is not asked for. */
VOXRTI_TARGET_AVX2 VOXRTI_INLINE uint32_t voxrti_column_step8(const voxrti_column_const *k, voxrti_column_lanes *g,
                                                              int any, voxrt_stats *stats) {
    const __m256i one = _mm256_set1_epi32(1), zero = _mm256_setzero_si256();
    const __m256i x = g->x, y = g->y, level = g->level, ka = g->k, alive = g->alive;
    const __m256 ox = g->f[VOXRTI_CF_O], oy = g->f[VOXRTI_CF_O + 1], t = g->t, dz = g->f[VOXRTI_CF_D + 2];
    const __m256i cx = _mm256_srav_epi32(x, level), cy = _mm256_srav_epi32(y, level);
    const __m256i ex = _mm256_sllv_epi32(_mm256_add_epi32(cx, g->on[0]), level),
        ey = _mm256_sllv_epi32(_mm256_add_epi32(cy, g->on[1]), level);
    const __m256 tx = _mm256_mul_ps(_mm256_sub_ps(_mm256_cvtepi32_ps(ex), ox), g->f[VOXRTI_CF_INV]);
    const __m256 ty = _mm256_mul_ps(_mm256_sub_ps(_mm256_cvtepi32_ps(ey), oy), g->f[VOXRTI_CF_INV + 1]);
    const __m256 te = _mm256_max_ps(_mm256_min_ps(_mm256_min_ps(tx, ty), g->f[VOXRTI_CF_T_MAX]), t);
    const __m256i kb = _mm256_min_epi32(_mm256_max_epi32(_mm256_cvttps_epi32(_mm256_add_ps(g->f[VOXRTI_CF_O + 2],
            _mm256_mul_ps(te, dz))), zero), k->last_k);
    const __m256i ground = _mm256_cmpeq_epi32(level, zero);
    __m256i lo = _mm256_min_epi32(ka, kb), hi = _mm256_max_epi32(ka, kb), set, step, hit, end;
    if (k->planes != 0 && !_mm256_testz_si256(ground, alive)) { /* what planes leave: mostly an interval */
        const __m256i all_lo = lo, all_hi = hi;
        __m256i gone[4], apart = zero;
        uint32_t p;
        for (p = 0; p < k->planes; p++) {
            __m256i from, to;
            voxrti_column_planes8(k, g->f + VOXRTI_CF_PLANE + p * VOXRTI_CP_FIELDS, x, y, &from, &to);
            to = _mm256_or_si256(to, _mm256_xor_si256(ground, _mm256_set1_epi32(-1))); /* -1: none */
            gone[2 * p] = from;
            gone[2 * p + 1] = to;
            apart = _mm256_or_si256(apart, _mm256_andnot_si256(_mm256_cmpgt_epi32(from, to), _mm256_and_si256(
                    _mm256_cmpgt_epi32(from, lo), _mm256_cmpgt_epi32(hi, to))));
            set = _mm256_cmpgt_epi32(from, lo);
            end = _mm256_cmpgt_epi32(hi, to);
            lo = _mm256_blendv_epi8(_mm256_max_epi32(lo, _mm256_add_epi32(to, one)), lo, set);
            hi = _mm256_blendv_epi8(_mm256_min_epi32(hi, _mm256_sub_epi32(from, one)), hi, end);
        }
        if (!_mm256_testz_si256(apart, alive)) {
            int32_t part[8][8];
            for (p = 0; p < 2 * k->planes; p++) _mm256_storeu_si256((__m256i *)(void *)part[p], gone[p]);
            _mm256_storeu_si256((__m256i *)(void *)part[4], ka);
            _mm256_storeu_si256((__m256i *)(void *)part[5], all_lo);
            _mm256_storeu_si256((__m256i *)(void *)part[6], all_hi);
            voxrti_column_apart(k, g->column, (const int32_t (*)[8])part, part[4], part[5], part[6]);
            lo = _mm256_loadu_si256((const __m256i *)(const void *)part[5]);
            hi = _mm256_loadu_si256((const __m256i *)(const void *)part[6]);
        }
    }
    set = _mm256_cmpeq_epi32(voxrti_column_any8(k, g->column, lo, hi), zero);
    step = _mm256_and_si256(alive, set);
    hit = _mm256_andnot_si256(set, _mm256_and_si256(alive, ground));
    { /* the step out of the cell */
        const __m256 by_x = _mm256_cmp_ps(tx, ty, _CMP_LT_OQ);
        const __m256i by_xi = _mm256_castps_si256(by_x);
        /* the other axis: which column there */
#define VOXRTI_OTHER(of_x, of_y) _mm256_blendv_ps(of_x, of_y, by_x)
#define VOXRTI_OTHER_I(of_x, of_y) _mm256_blendv_epi8(of_x, of_y, by_xi)
        const __m256i from = VOXRTI_OTHER_I(x, y), on = VOXRTI_OTHER_I(g->on[0], g->on[1]);
        const __m256i back = VOXRTI_OTHER_I(g->back[0], g->back[1]);
        const __m256i wide = _mm256_sub_epi32(_mm256_sllv_epi32(one, level), one);
        const __m256i most = _mm256_add_epi32(_mm256_sllv_epi32(VOXRTI_OTHER_I(cx, cy), level),
                                              _mm256_andnot_si256(back, wide));
        const __m256i te_tie = _mm256_sub_epi32(_mm256_castps_si256(te), by_xi); /* by x: the float after it */
        __m256i at = _mm256_cvttps_epi32(_mm256_add_ps(VOXRTI_OTHER(g->behind[0], g->behind[1]),
                _mm256_mul_ps(te, VOXRTI_OTHER(g->f[VOXRTI_CF_D], g->f[VOXRTI_CF_D + 1]))));
        __m256i next_x = _mm256_add_epi32(ex, g->back[0]), next_y = _mm256_add_epi32(ey, g->back[1]), out, crossed;
        __m256 ahead;
        at = _mm256_max_epi32(at, _mm256_min_epi32(from, most));
        at = _mm256_min_epi32(at, _mm256_max_epi32(from, most));
        ahead = _mm256_mul_ps(_mm256_sub_ps(_mm256_cvtepi32_ps(_mm256_add_epi32(at, on)), VOXRTI_OTHER(ox, oy)),
                              VOXRTI_OTHER(g->f[VOXRTI_CF_INV], g->f[VOXRTI_CF_INV + 1]));
#undef VOXRTI_OTHER
#undef VOXRTI_OTHER_I
        at = _mm256_add_epi32(at, _mm256_and_si256(_mm256_add_epi32(on, back), _mm256_andnot_si256(
                _mm256_cmpeq_epi32(at, most),
                _mm256_castps_si256(_mm256_cmp_ps(ahead, _mm256_castsi256_ps(te_tie), _CMP_LT_OQ)))));
        next_x = _mm256_blendv_epi8(at, next_x, by_xi);
        next_y = _mm256_blendv_epi8(next_y, at, by_xi);
        out = _mm256_or_si256(_mm256_srav_epi32(next_x, k->log_x), _mm256_srav_epi32(next_y, k->log_y));
        end = _mm256_andnot_si256(_mm256_cmpeq_epi32(out, zero), step);
        end = _mm256_or_si256(end, _mm256_and_si256(step, _mm256_castps_si256(
                _mm256_cmp_ps(te, g->f[VOXRTI_CF_T_MAX], _CMP_GE_OQ))));
        crossed = _mm256_srlv_epi32(_mm256_or_si256(_mm256_xor_si256(x, next_x), _mm256_xor_si256(y, next_y)),
                                    _mm256_permutevar8x32_epi32(k->up, level));
        /* one up where a border of the next level was crossed, one down where there were bits; masks are -1 */
        g->level = _mm256_sub_epi32(_mm256_add_epi32(level, _mm256_andnot_si256(step, alive)),
                                    _mm256_and_si256(step, _mm256_cmpgt_epi32(crossed, zero)));
        g->x = _mm256_blendv_epi8(x, next_x, step);
        g->y = _mm256_blendv_epi8(y, next_y, step);
        if (!any) g->by_x = _mm256_blendv_epi8(g->by_x, by_xi, step);
    }
    g->t = _mm256_blendv_ps(t, te, _mm256_castsi256_ps(step));
    g->k = _mm256_blendv_epi8(ka, kb, step);
    g->hit = _mm256_or_si256(g->hit, hit);
    if (!any) {
        g->lo = _mm256_blendv_epi8(g->lo, lo, hit);
        g->hi = _mm256_blendv_epi8(g->hi, hi, hit);
    }
    g->alive = _mm256_andnot_si256(_mm256_or_si256(hit, end), alive);
    voxrti_column_aim8(k, g);
    if (stats != NULL) {
        stats->steps += voxrti_popcount64((uint32_t)_mm256_movemask_ps(_mm256_castsi256_ps(step)));
        stats->descents += voxrti_popcount64((uint32_t)_mm256_movemask_ps(_mm256_castsi256_ps(
                _mm256_andnot_si256(_mm256_or_si256(step, ground), alive))));
    }
    return (uint32_t)_mm256_movemask_ps(_mm256_castsi256_ps(g->alive));
}

typedef struct voxrti_column_stream {
    const voxrti_column_trace *trace;
    const voxrt_ray *rays;
    voxrt_column_hit *hits;
    uint8_t *occluded;
    uint32_t done, count;   /* rays that were made ready, and all */
    voxrti_column_const k;
    voxrti_column_ready ready;
} voxrti_column_stream;

/* Make more rays ready, behind those that are left. */
VOXRTI_TARGET_AVX2 static void voxrti_column_more(voxrti_column_stream *s) {
    const voxrti_column_trace *t = s->trace;
    voxrti_column_ready *g = &s->ready;
    const uint32_t left = g->count - g->next;
    uint32_t i, f, p;
    if (left != 0) { /* fewer than eight */
        for (f = 0; f < s->k.fields; f++) memmove(g->f[f], g->f[f] + g->next, 8 * sizeof(float));
        memmove(g->t_in, g->t_in + g->next, 8 * sizeof(double));
        memmove(g->per_t, g->per_t + g->next, 8 * sizeof(double));
        memmove(g->id, g->id + g->next, 8 * sizeof(uint32_t));
    }
    g->next = 0;
    g->count = left;
    while (s->done < s->count && g->count + 4 <= VOXRTI_COLUMN_READY) {
        const uint32_t first = s->done, many = s->count - first < 4 ? s->count - first : 4;
        const voxrt_ray *r[4];
        float normal[12];
        __m256 v[4];
        uint32_t bad, good;
        for (i = 0; i < 4; i++) r[i] = s->rays + first + (i < many ? i : 0);
        voxrti_rays4(r[0], r[1], r[2], r[3], v);
        good = voxrti_column_setup4(t->columns, v, g->count, g, &bad) & ((1u << many) - 1u);
        for (p = 0; p < t->planes; p++) {
            const int end = p == 1 || t->normals == NULL;
            const float *from = (end ? t->end_normals : t->normals) + 3 * (size_t)first;
            if (many < 4) {
                memset(normal, 0, sizeof normal);
                memcpy(normal, from, 12 * many);
                from = normal;
            }
            voxrti_column_planes4(t, v, end, from, g->count, g->f + VOXRTI_CF_PLANE + p * VOXRTI_CP_FIELDS);
        }
        if (t->stats != NULL) t->stats->bad_rays += voxrti_popcount64(bad & ((1u << many) - 1u));
        s->done += many;
        for (i = 0; i < 4; i++) g->id[g->count + i] = first + i;
        if (good == 15) {
            g->count += 4;
            continue;
        }
        {
            const uint32_t from = g->count;
            for (i = 0; i < many; i++) {
                if ((good >> i & 1u) == 0) {
                    voxrti_column_miss(s->hits, s->occluded, first + i);
                    continue;
                }
                for (f = 0; f < s->k.fields; f++) g->f[f][g->count] = g->f[f][from + i];
                g->t_in[g->count] = g->t_in[from + i];
                g->per_t[g->count] = g->per_t[from + i];
                g->id[g->count++] = first + i;
            }
        }
    }
}

/* Report what the lanes that have ended found. */
VOXRTI_TARGET_AVX2 VOXRTI_INLINE void voxrti_column_ended(voxrti_column_stream *s, voxrti_column_lanes *g,
                                                          uint32_t ended, int any) {
    const voxrt_columns *c = s->trace->columns;
    const uint32_t hit = (uint32_t)_mm256_movemask_ps(_mm256_castsi256_ps(g->hit));
    int32_t lo[8], hi[8], ka[8], x[8], y[8], face[8];
    float t[8], oz[8], dz[8];
    if (s->trace->stats != NULL) s->trace->stats->hits += voxrti_popcount64(hit & ended);
    if (any) {
        for (; ended != 0; ended &= ended - 1) {
            const uint32_t i = voxrti_ctz64(ended);
            s->occluded[g->id[i]] = (uint8_t)(hit >> i & 1u);
        }
        return;
    }
    _mm256_storeu_si256((__m256i *)(void *)lo, g->lo);
    _mm256_storeu_si256((__m256i *)(void *)hi, g->hi);
    _mm256_storeu_si256((__m256i *)(void *)ka, g->k);
    _mm256_storeu_si256((__m256i *)(void *)x, g->x);
    _mm256_storeu_si256((__m256i *)(void *)y, g->y);
    /* along y: 2 on, 3 back; along x: 0 on, 1 back; none yet: 6 */
    _mm256_storeu_si256((__m256i *)(void *)face, _mm256_blendv_epi8(
            _mm256_blendv_epi8(_mm256_sub_epi32(_mm256_set1_epi32(3), g->on[1]),
                               _mm256_sub_epi32(_mm256_set1_epi32(1), g->on[0]), g->by_x),
            _mm256_set1_epi32(6), _mm256_cmpeq_epi32(g->by_x, _mm256_set1_epi32(1))));
    _mm256_storeu_ps(t, g->t);
    _mm256_storeu_ps(oz, g->f[VOXRTI_CF_O + 2]);
    _mm256_storeu_ps(dz, g->f[VOXRTI_CF_D + 2]);
    for (; ended != 0; ended &= ended - 1) {
        const uint32_t i = voxrti_ctz64(ended), id = g->id[i], *column;
        const int up = dz[i] >= 0.0f;
        voxrti_column_found f;
        uint32_t bits;
        int w;
        if ((hit >> i & 1u) == 0) {
            voxrti_column_miss(s->hits, s->occluded, id);
            continue;
        }
        column = c->bits + voxrti_column(c, 0, (uint32_t)x[i], (uint32_t)y[i]);
        for (w = (up ? lo[i] : hi[i]) >> 5;; w += up ? 1 : -1) { /* one of them is set */
            bits = column[w] & voxrti_column_mask(lo[i], hi[i], w);
            if (bits != 0) break;
        }
        f.x = x[i];
        f.y = y[i];
        f.k = 32 * w + (up ? (int)voxrti_ctz64(bits) : 31 - (int)voxrti_clz32(bits));
        f.t = t[i];
        f.face = (uint32_t)face[i];
        if (f.k != ka[i]) {
            const float tk = ((float)(up ? f.k : f.k + 1) - oz[i]) / dz[i];
            f.t = tk > t[i] ? tk : t[i];
            f.face = up ? 4 : 5;
        }
        voxrti_column_report(s->trace, &s->rays[id], g->t_in[i], g->per_t[i], &f, &s->hits[id]);
    }
}

/* Give the lanes in `empty` rays that are ready: the first of them the first ray, and so on. */
VOXRTI_TARGET_AVX2 VOXRTI_INLINE void voxrti_column_fill(voxrti_column_stream *s, voxrti_column_lanes *g,
                                                         uint32_t empty, int any) {
    voxrti_column_ready *r = &s->ready;
    const __m256i bit = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128), one = _mm256_set1_epi32(1);
    const __m256 sign = _mm256_set1_ps(-0.0f), behind = _mm256_set1_ps(0.00390625f);
    __m256i rank, mask;
    __m256 maskf;
    uint64_t lanes;
    uint32_t f, a, m, next = r->next;
    while (voxrti_popcount64(empty) > r->count - next) empty &= ~(1u << (31u - voxrti_clz32(empty)));
    if (empty == 0) return;
    /* how many lanes before each one are in `empty`: prefix sums of bytes */
    lanes = (uint64_t)empty * 0x0101010101010101u & 0x8040201008040201u;
    lanes = (lanes + 0x7f7f7f7f7f7f7f7fu) >> 7 & 0x0101010101010101u;
    lanes = lanes * 0x0101010101010101u << 8;
    rank = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128((long long)lanes));
    mask = _mm256_cmpgt_epi32(_mm256_and_si256(_mm256_set1_epi32((int)empty), bit), _mm256_setzero_si256());
    maskf = _mm256_castsi256_ps(mask);
    for (f = 0; f < s->k.fields; f++)
        g->f[f] = _mm256_blendv_ps(g->f[f], _mm256_permutevar8x32_ps(_mm256_loadu_ps(&r->f[f][next]), rank), maskf);
    for (m = empty; m != 0; m &= m - 1, next++) {
        const uint32_t i = voxrti_ctz64(m);
        g->id[i] = r->id[next];
        if (any) continue;
        g->t_in[i] = r->t_in[next];
        g->per_t[i] = r->per_t[next];
    }
    r->next = next;
    g->held |= empty;
    for (a = 0; a < 2; a++) {
        const __m256 d = g->f[VOXRTI_CF_D + a];
        g->back[a] = _mm256_srai_epi32(_mm256_castps_si256(d), 31);
        g->on[a] = _mm256_add_epi32(g->back[a], one);
        g->behind[a] = _mm256_sub_ps(g->f[VOXRTI_CF_O + a], _mm256_or_ps(_mm256_and_ps(d, sign), behind));
    }
    g->x = _mm256_blendv_epi8(g->x, _mm256_cvttps_epi32(g->f[VOXRTI_CF_O]), mask);
    g->y = _mm256_blendv_epi8(g->y, _mm256_cvttps_epi32(g->f[VOXRTI_CF_O + 1]), mask);
    g->k = _mm256_blendv_epi8(g->k, _mm256_cvttps_epi32(g->f[VOXRTI_CF_O + 2]), mask);
    g->level = _mm256_blendv_epi8(g->level, s->k.level, mask);
    if (!any) g->by_x = _mm256_blendv_epi8(g->by_x, one, mask);
    g->t = _mm256_andnot_ps(maskf, g->t);
    g->hit = _mm256_andnot_si256(mask, g->hit);
    g->alive = _mm256_or_si256(g->alive, mask);
    voxrti_column_aim8(&s->k, g);
}

#define VOXRTI_COLUMN_GROUPS 4
#define VOXRTI_COLUMN_IDLE 2 /* lanes of a group that wait for new rays until they get some */

/* What voxrti_column_trace_scalar does: the same steps, the same bits. */
VOXRTI_TARGET_AVX2 VOXRTI_INLINE void voxrti_column_stream8(const voxrti_column_trace *t, const voxrt_ray *rays,
                                                            uint32_t count, voxrt_column_hit *hits,
                                                            uint8_t *occluded, int any_hit) {
    voxrti_column_stream s;
    voxrti_column_lanes g[VOXRTI_COLUMN_GROUPS];
    uint32_t i, groups = count / 16, live[VOXRTI_COLUMN_GROUPS], any, idle;
    groups = groups < 1 ? 1 : groups > VOXRTI_COLUMN_GROUPS ? VOXRTI_COLUMN_GROUPS : groups;
    s.trace = t;
    s.rays = rays;
    s.hits = hits;
    s.occluded = occluded;
    s.done = 0;
    s.count = count;
    s.ready.count = s.ready.next = 0;
    voxrti_column_const_open(t, &s.k);
    memset(g, 0, groups * sizeof g[0]);
    memset(live, 0, sizeof live);
    memset(s.ready.f, 0, s.k.fields * sizeof s.ready.f[0]); /* eight are loaded where there are fewer */
    for (;;) {
        any = 0;
        for (i = 0; i < groups; i++) {
            const uint32_t ended = g[i].held & ~live[i];
            any |= live[i];
            if (live[i] != 0 && voxrti_popcount64(live[i]) > 8 - VOXRTI_COLUMN_IDLE) continue;
            if (s.ready.count - s.ready.next < 8 && s.done < s.count) voxrti_column_more(&s);
            if (live[i] != 0 && s.ready.count == s.ready.next) continue; /* nothing would change */
            if (ended != 0) voxrti_column_ended(&s, &g[i], ended, any_hit);
            g[i].held &= ~ended;
            voxrti_column_fill(&s, &g[i], ~g[i].held & 255u, any_hit);
            live[i] = g[i].held;
            any |= live[i];
        }
        if (any == 0) break;
        do {
            idle = any = 0;
            for (i = 0; i < groups; i++) {
                if (live[i] != 0) live[i] = voxrti_column_step8(&s.k, &g[i], any_hit, t->stats);
                idle |= (uint32_t)(voxrti_popcount64(live[i]) <= 8 - VOXRTI_COLUMN_IDLE);
                any |= live[i];
            }
        } while (s.done == s.count && s.ready.next == s.ready.count ? any != 0 : !idle);
    }
}
VOXRTI_TARGET_AVX2 static VOXRTI_NOINLINE void voxrti_column_hits_avx2(const voxrti_column_trace *t,
                                                                       const voxrt_ray *rays, uint32_t count,
                                                                       voxrt_column_hit *hits) {
    voxrti_column_stream8(t, rays, count, hits, NULL, 0);
}
VOXRTI_TARGET_AVX2 static VOXRTI_NOINLINE void voxrti_column_any_avx2(const voxrti_column_trace *t,
                                                                      const voxrt_ray *rays, uint32_t count,
                                                                      uint8_t *occluded) {
    voxrti_column_stream8(t, rays, count, NULL, occluded, 1);
}

/* The same with the instructions of AVX-512 for 256 bits: their 32 registers hold what 16 do not, 8 % */
#if defined(__GNUC__)
#  define VOXRTI_TARGET_AVX512VL __attribute__((target("avx2,avx512f,avx512vl,bmi,bmi2,lzcnt,popcnt")))
VOXRTI_TARGET_AVX512VL static VOXRTI_NOINLINE void voxrti_column_hits_avx512(const voxrti_column_trace *t,
                                                                             const voxrt_ray *rays, uint32_t count,
                                                                             voxrt_column_hit *hits) {
    voxrti_column_stream8(t, rays, count, hits, NULL, 0);
}
VOXRTI_TARGET_AVX512VL static VOXRTI_NOINLINE void voxrti_column_any_avx512(const voxrti_column_trace *t,
                                                                            const voxrt_ray *rays, uint32_t count,
                                                                            uint8_t *occluded) {
    voxrti_column_stream8(t, rays, count, NULL, occluded, 1);
}
#endif
#endif

static voxrt_result voxrti_column_trace_open(const voxrt_columns *c, const voxrt_columns_trace_desc *desc,
                                             voxrti_column_trace *t) {
    double radius;
    uint32_t a;
    memset(t, 0, sizeof *t);
    t->isa = (int)voxrt_isa_best();
#if VOXRTI_AVX2 && defined(__GNUC__)
    if (t->isa == VOXRT_ISA_AVX2 && __builtin_cpu_supports("avx512vl")) t->isa = VOXRT_ISA_AVX512;
#endif
    if (desc != NULL && desc->isa != VOXRT_ISA_AUTO && (int)desc->isa < t->isa) t->isa = (int)desc->isa;
    t->columns = c;
    t->start = 1; /* what starts on a surface looks at its columns, anyway */
    if (c == NULL) return VOXRT_ERR_INVALID_ARG;
    radius = 16.0 * c->diagonal;
    if (desc == NULL) return VOXRT_OK;
    if (desc->_begin_zero != 0 || desc->_end_zero != 0) return VOXRT_ERR_UNINIT_DESC;
    if (!(desc->self_radius >= 0.0f) || (uint32_t)desc->isa > 4u) return VOXRT_ERR_INVALID_ARG;
    if (desc->self_radius > 0.0f) radius = (double)desc->self_radius;
    if (desc->start_level_plus_1 != 0) t->start = desc->start_level_plus_1 - 1;
    for (a = 0; a < 3; a++) t->reach[a] = (float)voxrti_min(radius * c->per_cell[a], 1e6);
    t->normals = desc->normals;
    t->end_normals = desc->end_normals;
    t->planes = (desc->normals != NULL) + (uint32_t)(desc->end_normals != NULL);
    t->stats = desc->stats;
    return VOXRT_OK;
}

static voxrt_result voxrti_column_trace_all(const voxrt_columns *c, const voxrt_columns_trace_desc *desc,
                                            const voxrt_ray *rays, voxrt_column_hit *hits, uint8_t *occluded,
                                            size_t count) {
    voxrti_column_trace t;
    size_t i, n = count;
    voxrt_result r = voxrti_column_trace_open(c, desc, &t);
    if (r != VOXRT_OK) return r;
    if (count != 0 && (rays == NULL || (hits == NULL && occluded == NULL))) return VOXRT_ERR_INVALID_ARG;
    if (t.stats != NULL) t.stats->rays += count;
    for (i = 0; i < count; i += n) {
        voxrti_column_trace part = t;
        voxrt_column_hit *part_hits = hits != NULL ? hits + i : NULL;
        uint8_t *part_occluded = occluded != NULL ? occluded + i : NULL;
        n = count - i < 0x40000000 ? count - i : 0x40000000;
        if (t.normals != NULL) part.normals = t.normals + 3 * i;
        if (t.end_normals != NULL) part.end_normals = t.end_normals + 3 * i;
#if VOXRTI_AVX2 && defined(__GNUC__)
        if (t.isa == VOXRT_ISA_AVX512) {
            if (part_hits != NULL) voxrti_column_hits_avx512(&part, rays + i, (uint32_t)n, part_hits);
            else voxrti_column_any_avx512(&part, rays + i, (uint32_t)n, part_occluded);
            continue;
        }
#endif
#if VOXRTI_AVX2
        if (t.isa >= VOXRT_ISA_AVX2) {
            if (part_hits != NULL) voxrti_column_hits_avx2(&part, rays + i, (uint32_t)n, part_hits);
            else voxrti_column_any_avx2(&part, rays + i, (uint32_t)n, part_occluded);
            continue;
        }
#endif
        voxrti_column_trace_scalar(&part, rays + i, n, part_hits, part_occluded, NULL);
    }
    return VOXRT_OK;
}

VOXRT_DEF voxrt_result voxrt_columns_trace(const voxrt_columns *columns, const voxrt_columns_trace_desc *desc,
                                           const voxrt_ray *rays, voxrt_column_hit *hits, size_t count) {
    return voxrti_column_trace_all(columns, desc, rays, hits, NULL, count);
}

VOXRT_DEF voxrt_result voxrt_columns_occluded(const voxrt_columns *columns, const voxrt_columns_trace_desc *desc,
                                              const voxrt_ray *rays, uint8_t *occluded, size_t count) {
    return voxrti_column_trace_all(columns, desc, rays, NULL, occluded, count);
}

VOXRT_DEF size_t voxrt_columns_explain(const voxrt_columns *columns, const voxrt_columns_trace_desc *desc,
                                       const voxrt_ray *ray, voxrt_column_step *steps, size_t most,
                                       voxrt_column_hit *hit) {
    voxrti_column_trace t;
    voxrti_column_log log;
    voxrt_column_hit found;
    if (hit != NULL) voxrti_column_miss(hit, NULL, 0);
    if (ray == NULL || (steps == NULL && most != 0)) return 0;
    if (voxrti_column_trace_open(columns, desc, &t) != VOXRT_OK) return 0;
    memset(&log, 0, sizeof log);
    log.step = steps;
    log.most = most;
    if (t.stats != NULL) t.stats->rays++;
    voxrti_column_trace_scalar(&t, ray, 1, &found, NULL, &log);
    if (hit != NULL) *hit = found;
    return log.count;
}
#endif /* VOXRT_NO_GI */

/* ---------------------------------------------------------------------------
   gi: a scene of meshes and lights in columns; what its cells look like from   // >>gi
   both sides, and how much light falls on them.
   --------------------------------------------------------------------------- */
#ifndef VOXRT_NO_GI

/* The bytes. A layer (of what is still, of what moves) has a record for each of its cells, in the order of columns and
   of depth: that of cell k of a column is base[column] + (cells set below k). A record has two sides: where normals of
   the surface in it differ much, those on either side of their mean along the direction in which they differ most: both
   faces of a thin wall, or the two that meet at an edge. A side that has no surface has area 0. */
typedef struct voxrti_gi_record {
    uint16_t normal[2];  /* octahedral */
    uint16_t object[2];
    uint8_t rgb[2][3];   /* albedo, square root of linear values */
    uint8_t area[2];
    int8_t offset[2];    /* of the surface from the cell's centre along the normal, 1/127 of half a diagonal */
} voxrti_gi_record;

typedef struct voxrti_gi_layer {
    const uint32_t *bits;  /* a level 0 */
    uint32_t *base;
    voxrti_gi_record *record;
    uint32_t *direct;      /* two for each record: irradiance by lights, shared exponents; VOXRTI_GI_UNKNOWN */
    uint32_t *bounce;      /* two for each record: irradiance by other surfaces; VOXRTI_GI_UNKNOWN */
    size_t count, capacity;
} voxrti_gi_layer;

#define VOXRTI_GI_UNKNOWN 0xffffffffu

typedef struct voxrti_gi_entry {
    voxrt_gi_object object;
    float emission[3], specular[4]; /* specular is 0 without an exponent */
    uint16_t (*lattice)[2];   /* SAMPLES: of each triangle */
    size_t lattice_count;
    uint32_t used;
    uint32_t placed, moved;   /* by how many updates since it came; its place is not the one of the update before */
    double at[12], back[12];  /* to_world at the last update; from the world of the last update to that before it */
} voxrti_gi_entry;

typedef struct voxrti_emitter { /* a triangle p, p + u, p + v that emits light */
    float p[3], u[3], v[3], n[3], rgb[3], share; /* share: of its area in the sum */
    double sum;                                  /* share * area of all up to this one */
} voxrti_emitter;

#define VOXRTI_GI_EMITTERS 4 /* a kind of light: all surfaces that emit */

/* What a lamp sees. A texel is a position and a normal, 6 floats; normal 0: nothing is there. Faces of 90 degrees look
   along +x, -x, +y, ..., the single face of a spot along its direction. */
struct voxrti_gi_map {
    float *texel;
    uint32_t side, faces;
    float tangent;          /* of half its angle */
};

struct voxrt_gi {
    voxrti_mem mem;
    voxrt_env env;
    voxrt_columns *columns;
    voxrti_gi_entry *entry;
    size_t entry_count, entry_capacity;
    voxrt_gi_light *light;
    size_t light_count;
    voxrti_emitter *emitter;
    size_t emitter_count, emitter_capacity;
    voxrt_gi_light emit;      /* of kind VOXRTI_GI_EMITTERS */
    struct voxrti_gi_map *map; /* for each light, or NULL */
    struct voxrti_vpl *vpl;   /* of the last picture */
    size_t vpl_count, vpl_capacity;
    voxrti_gi_layer layer[2]; /* still, moving */
    voxrti_gi_layer before;   /* the moving layer of the last update, then memory for the next */
    uint32_t *own, *own_before; /* level 0 of the moving layer */
    float lo[3], hi[3];       /* world box */
    double origin_before[3];  /* of the columns, at the last update */
    uint32_t still_changed, changed; /* since the last update */
    uint32_t version;         /* of what can be seen */
    uint64_t rejected, open_columns;
    voxrt_gi *outer;          /* the volume around this one, with the same objects, or NULL */
};

/* Two signed sums: in one word, where a machine can add to it in one go. */
typedef union voxrti_pair { uint64_t both; int32_t each[2]; } voxrti_pair;

/* Sums while a layer is made; integers, so that threads may add in any order. First moments of normals n, two in a word
   (xx yy, zz xy, xz yz, x y, z), then what lies on both sides of the split n . split = split[3]. */
typedef struct voxrti_gi_sides {
    int32_t normal[2][3], offset[2];
    uint32_t rgb[2][3], weight[2], object[2];
} voxrti_gi_sides;
typedef struct voxrti_gi_sum {
    union { voxrti_pair moment[5]; voxrti_gi_sides sides; } u;
    int32_t split[4];
} voxrti_gi_sum;

/* What a triangle adds to each cell it is put into. */
typedef struct voxrti_splat {
    const voxrt_columns *columns;
    const voxrti_gi_layer *layer;
    voxrti_gi_sum *sum;
    double plane[4];      /* distance of a point (in cells) from its plane, along the normal, world units */
    int32_t normal[3];    /* world, times 1024 */
    voxrti_pair moment[5]; /* of that, times 128 */
    uint32_t rgb[3], object, votes;
} voxrti_splat;

/* ---- colours: three floats in a word: 9 bits each and a common exponent (Ward 1991; here as in OpenGL) ---- */

static VOXRTI_UNUSED uint32_t voxrti_rgb9e5(const float rgb[3]) {
    float most = 0.0f, c[3];
    uint32_t bits, out, a;
    int e, i;
    for (a = 0; a < 3; a++) {
        c[a] = rgb[a] > 0.0f ? (rgb[a] < 65408.0f ? rgb[a] : 65408.0f) : 0.0f;
        most = c[a] > most ? c[a] : most;
    }
    memcpy(&bits, &most, 4);
    e = (int)(bits >> 23) - 126; /* most < 2^e */
    if (e < -15) e = -15;
    for (i = 0; i < 2; i++, e++) {
        uint32_t scale_bits = (uint32_t)(9 - e + 127) << 23, q[3];
        float scale;
        memcpy(&scale, &scale_bits, 4);
        for (a = 0; a < 3; a++) q[a] = (uint32_t)(c[a] * scale + 0.5f);
        out = q[0] | q[1] << 9 | q[2] << 18 | (uint32_t)(e + 15) << 27;
        if (q[0] < 512 && q[1] < 512 && q[2] < 512) return out; /* else rounding made it 2^e */
    }
    return 511u | 511u << 9 | 511u << 18 | 31u << 27;
}

VOXRTI_INLINE void voxrti_rgb9e5_decode(uint32_t v, float rgb[3]) {
    const uint32_t bits = ((v >> 27) + 127 - 15 - 9) << 23;
    float scale;
    memcpy(&scale, &bits, 4);
    rgb[0] = (float)(v & 511u) * scale;
    rgb[1] = (float)(v >> 9 & 511u) * scale;
    rgb[2] = (float)(v >> 18 & 511u) * scale;
}

/* ---- cells and their records ---- */

VOXRTI_INLINE size_t voxrti_gi_rank(const voxrt_columns *c, const voxrti_gi_layer *l, uint32_t x, uint32_t y,
                                    uint32_t k) {
    const size_t at = voxrti_column(c, 0, x, y);
    size_t i = l->base[((size_t)y << c->row_log[0]) + x];
    uint32_t w;
    for (w = 0; w < k >> 5; w++) i += voxrti_popcount64(l->bits[at + w]);
    return i + voxrti_popcount64(l->bits[at + w] & ((1u << (k & 31u)) - 1u));
}

/* Which layer has the cell? The moving one wins. Returns the record's index, or -1 as size_t. */
VOXRTI_INLINE size_t voxrti_gi_find(const voxrt_gi *gi, uint32_t x, uint32_t y, uint32_t k, uint32_t *out_layer) {
    const size_t word = voxrti_column(gi->columns, 0, x, y) + (k >> 5);
    uint32_t l;
    for (l = 2; l-- > 0;) {
        if (gi->layer[l].count == 0 || (gi->layer[l].bits[word] >> (k & 31u) & 1u) == 0) continue;
        *out_layer = l;
        return voxrti_gi_rank(gi->columns, &gi->layer[l], x, y, k);
    }
    *out_layer = 0;
    return (size_t)-1;
}

VOXRTI_INLINE voxrti_pair voxrti_pair_make(int32_t a, int32_t b) {
    voxrti_pair p;
#if UINTPTR_MAX > 0xffffffffu
    p.both = (uint64_t)(int64_t)a + ((uint64_t)(int64_t)b << 32);
#else
    p.each[0] = a;
    p.each[1] = b;
#endif
    return p;
}
VOXRTI_INLINE void voxrti_pair_add(voxrti_pair *to, const voxrti_pair *p) {
#if UINTPTR_MAX > 0xffffffffu
    voxrti_add_shared(&to->both, p->both);
#else
    voxrti_add_shared(&to->each[0], p->each[0]);
    voxrti_add_shared(&to->each[1], p->each[1]);
#endif
}
VOXRTI_INLINE void voxrti_pair_open(const voxrti_pair *p, double *a, double *b) {
#if UINTPTR_MAX > 0xffffffffu
    const int32_t low = (int32_t)(uint32_t)p->both;
    *a = (double)low;
    *b = (double)(int32_t)(uint32_t)((p->both - (uint64_t)(int64_t)low) >> 32);
#else
    *a = (double)p->each[0];
    *b = (double)p->each[1];
#endif
}

static void voxrti_splat_add(const voxrti_splat *f, uint32_t x, uint32_t y, uint32_t k) {
    voxrti_gi_sum *sum = &f->sum[voxrti_gi_rank(f->columns, f->layer, x, y, k)];
    voxrti_gi_sides *s = &sum->u.sides;
    uint32_t a, side;
    if (f->votes) {
        for (a = 0; a < 5; a++) voxrti_pair_add(&sum->u.moment[a], &f->moment[a]);
        return;
    }
    side = f->normal[0] * sum->split[0] + f->normal[1] * sum->split[1] + f->normal[2] * sum->split[2] < sum->split[3];
    for (a = 0; a < 3; a++) {
        voxrti_add_shared(&s->normal[side][a], f->normal[a]);
        voxrti_add_shared(&s->rgb[side][a], f->rgb[a]);
    }
    {
        const double d = f->plane[3] - (f->plane[0] * ((double)x + 0.5) + f->plane[1] * ((double)y + 0.5) +
                                        f->plane[2] * ((double)k + 0.5));
        const double unit = 254.0 / f->columns->diagonal;
        voxrti_add_shared(&s->offset[side],
                          (int32_t)voxrti_floor(voxrti_max(-127.0, voxrti_min(127.0, d * unit)) + 0.5));
    }
    voxrti_add_shared(&s->weight[side], 1u);
#if defined(__GNUC__)
    {
        uint32_t seen = __atomic_load_n(&s->object[side], __ATOMIC_RELAXED);
        while (seen < f->object &&
               !__atomic_compare_exchange_n(&s->object[side], &seen, f->object, 1, __ATOMIC_RELAXED,
                                            __ATOMIC_RELAXED)) { }
    }
#else
    if (s->object[side] < f->object) s->object[side] = f->object;
#endif
}

/* The fragment of triangle i: its geometric normal, the mean of its colours. p in cells. 0: it has no area. */
static int voxrti_splat_open(voxrti_splat *f, const voxrt_mesh *mesh, const voxrti_gi_entry *e, size_t i,
                                const double p[3][3], const float srgb[256]) {
    const voxrt_columns *c = f->columns;
    double u[3], v[3], n[3], length = 0.0, rgb[3];
    float nf[3];
    int32_t m[3];
    uint32_t a, k;
    for (a = 0; a < 3; a++) {
        u[a] = (p[1][a] - p[0][a]) * c->cell[a];
        v[a] = (p[2][a] - p[0][a]) * c->cell[a];
    }
    for (a = 0; a < 3; a++) {
        n[a] = u[(a + 1) % 3] * v[(a + 2) % 3] - u[(a + 2) % 3] * v[(a + 1) % 3];
        length += n[a] * n[a];
    }
    if (!(length > 0.0) || !voxrti_finite(length)) return 0;
    length = 1.0 / sqrt(length);
    f->plane[3] = 0.0;
    for (a = 0; a < 3; a++) {
        nf[c->axis[a]] = (float)(n[a] * length);
        f->plane[a] = n[a] * length * c->cell[a];
        f->plane[3] += f->plane[a] * p[0][a];
    }
    for (a = 0; a < 3; a++) {
        f->normal[a] = (int32_t)voxrti_floor((double)nf[a] * 1024.0 + 0.5);
        m[a] = (int32_t)voxrti_floor((double)nf[a] * 128.0 + 0.5);
        rgb[a] = 1.0;
    }
    if (f->votes) {
        f->moment[0] = voxrti_pair_make(m[0] * m[0], m[1] * m[1]);
        f->moment[1] = voxrti_pair_make(m[2] * m[2], m[0] * m[1]);
        f->moment[2] = voxrti_pair_make(m[0] * m[2], m[1] * m[2]);
        f->moment[3] = voxrti_pair_make(m[0], m[1]);
        f->moment[4] = voxrti_pair_make(m[2], 0);
        return 1;
    }
    if (mesh->triangle_rgb != NULL) {
        for (a = 0; a < 3; a++) rgb[a] = (double)srgb[mesh->triangle_rgb[3 * i + a]];
    } else if (mesh->vertex_rgb != NULL) {
        const size_t stride = mesh->vertex_rgb_stride != 0 ? mesh->vertex_rgb_stride : 3;
        for (a = 0; a < 3; a++) {
            rgb[a] = 0.0;
            for (k = 0; k < 3; k++) {
                const size_t at = mesh->indices != NULL ? (size_t)mesh->indices[3 * i + k] : 3 * i + k;
                rgb[a] += (double)srgb[mesh->vertex_rgb[at * stride + a]] * (1.0 / 3.0);
            }
        }
    }
    for (a = 0; a < 3; a++) {
        const float *w = e->object.material.albedo;
        const double albedo = w[0] == 0.0f && w[1] == 0.0f && w[2] == 0.0f ? 1.0 : (double)w[a];
        f->rgb[a] = (uint32_t)voxrti_floor(voxrti_max(0.0, voxrti_min(1.0, rgb[a] * albedo)) * 65535.0 + 0.5);
    }
    return 1;
}

typedef struct voxrti_gi_build {
    voxrt_gi *gi;
    voxrti_gi_layer *layer;
    voxrti_gi_sum *sum;
    voxrti_insert in;      /* of one object */
    uint32_t id, votes;
    float srgb[256];
} voxrti_gi_build;

static void voxrti_task_gi_fragments(void *ctx, uint32_t index) {
    voxrti_gi_build *b = (voxrti_gi_build *)ctx;
    voxrti_insert in = b->in;
    voxrti_splat f;
    const voxrt_mesh *mesh = b->in.mesh;
    const size_t stride = mesh->position_stride != 0 ? mesh->position_stride : 12;
    size_t i = (size_t)index * VOXRTI_INSERT_TASK, end = i + VOXRTI_INSERT_TASK;
    memset(&f, 0, sizeof f);
    f.columns = b->gi->columns;
    f.layer = b->layer;
    f.sum = b->sum;
    f.object = b->id;
    f.votes = b->votes;
    in.splat = &f;
    end = end < in.count ? end : in.count;
    for (; i < end; i++) {
        double p[3][3];
        uint32_t e, ok = 1;
        for (e = 0; e < 3 && ok; e++) {
            const size_t at = mesh->indices != NULL ? (size_t)mesh->indices[3 * i + e] : 3 * i + e;
            ok = at < mesh->vertex_count &&
                voxrti_insert_point(&in, (const uint8_t *)mesh->positions + at * stride, p[e]);
        }
        if (!ok || !voxrti_splat_open(&f, mesh, &b->gi->entry[b->id], i, (const double (*)[3])p, b->srgb)) continue;
        if (in.mode == VOXRT_COLUMNS_SAMPLES) (void)voxrti_insert_samples(&in, (const double (*)[3])p, i);
        else (void)voxrti_insert_triangle(&in, (const double (*)[3])p);
    }
}

/* Normals differ much where their variance along some direction is above this: two flat faces of the same size in a
   cell are split if there are 37 degrees and more between them. */
#define VOXRTI_GI_SPLIT 0.1

/* Moments -> split: across the direction in which normals vary most (power iteration), at their mean. */
static void voxrti_gi_split(voxrti_gi_sum *s) {
    double m[3], c[3][3], v[3], w, most = 0.0, mean = 0.0, vary = 0.0, none;
    uint32_t a, b, turn, top = 0;
    voxrti_pair_open(&s->u.moment[0], &c[0][0], &c[1][1]);
    voxrti_pair_open(&s->u.moment[1], &c[2][2], &c[0][1]);
    voxrti_pair_open(&s->u.moment[2], &c[0][2], &c[1][2]);
    voxrti_pair_open(&s->u.moment[3], &m[0], &m[1]);
    voxrti_pair_open(&s->u.moment[4], &m[2], &none);
    memset(s, 0, sizeof *s);
    w = c[0][0] + c[1][1] + c[2][2]; /* how many, times 128^2 */
    if (!(w > 0.0)) return;
    for (a = 0; a < 3; a++) m[a] *= 128.0 / w;
    for (a = 0; a < 3; a++)
        for (b = a; b < 3; b++) c[a][b] = c[b][a] = c[a][b] / w - m[a] * m[b];
    for (a = 1; a < 3; a++) if (c[a][a] > c[top][top]) top = a;
    for (a = 0; a < 3; a++) v[a] = c[top][a];
    for (turn = 0; turn < 8; turn++) {
        double n[3];
        for (most = 0.0, a = 0; a < 3; a++) most = voxrti_max(most, voxrti_abs(v[a]));
        if (!(most > 1e-9)) return;
        for (a = 0; a < 3; a++) v[a] /= most;
        for (a = 0; a < 3; a++) n[a] = c[a][0] * v[0] + c[a][1] * v[1] + c[a][2] * v[2];
        for (a = 0; a < 3; a++) v[a] = n[a];
    }
    w = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    if (!(w > 1e-9)) return;
    for (top = 0, a = 1; a < 3; a++) if (voxrti_abs(v[a]) > voxrti_abs(v[top])) top = a;
    if (v[top] < 0.0) w = 0.0 - w;
    for (a = 0; a < 3; a++) v[a] /= w;
    for (a = 0; a < 3; a++) {
        vary += v[a] * (c[a][0] * v[0] + c[a][1] * v[1] + c[a][2] * v[2]);
        mean += v[a] * m[a];
    }
    if (!(vary > VOXRTI_GI_SPLIT)) return;
    for (a = 0; a < 3; a++) s->split[a] = (int32_t)voxrti_floor(v[a] * 1024.0 + 0.5);
    s->split[3] = (int32_t)voxrti_floor(mean * 1048576.0 + 0.5);
}

static void voxrti_task_gi_split(void *ctx, uint32_t index) {
    voxrti_gi_build *b = (voxrti_gi_build *)ctx;
    size_t i = (size_t)index * 4096, end = i + 4096;
    end = end < b->layer->count ? end : b->layer->count;
    for (; i < end; i++) voxrti_gi_split(&b->sum[i]);
}

static void voxrti_task_gi_resolve(void *ctx, uint32_t index) {
    voxrti_gi_build *b = (voxrti_gi_build *)ctx;
    size_t i = (size_t)index * 4096, end = i + 4096;
    end = end < b->layer->count ? end : b->layer->count;
    for (; i < end; i++) {
        const voxrti_gi_sides *s = &b->sum[i].u.sides;
        voxrti_gi_record *r = &b->layer->record[i];
        const uint32_t all = s->weight[0] + s->weight[1];
        uint32_t side, a;
        memset(r, 0, sizeof *r);
        for (side = 0; side < 2 && all != 0; side++) {
            float n[3];
            const uint32_t w = s->weight[side];
            if (w == 0) continue;
            for (a = 0; a < 3; a++) {
                n[a] = (float)s->normal[side][a];
                r->rgb[side][a] = (uint8_t)(sqrt((double)s->rgb[side][a] / ((double)w * 65535.0)) * 255.0 + 0.5);
            }
            if (!voxrti_normalize(n)) n[2] = 1.0f;
            r->normal[side] = (uint16_t)voxrti_oct_encode(n);
            r->object[side] = (uint16_t)s->object[side];
            r->area[side] = (uint8_t)(255.0 * (double)w / (double)all + 0.5);
            if (r->area[side] == 0) r->area[side] = 1;
            r->offset[side] = (int8_t)voxrti_floor((double)s->offset[side] / (double)w + 0.5);
        }
    }
}

static void voxrti_gi_layer_free(voxrt_gi *gi, voxrti_gi_layer *l) {
    voxrti_free(&gi->mem, l->base);
    voxrti_free(&gi->mem, l->record);
    voxrti_free(&gi->mem, l->direct);
    voxrti_free(&gi->mem, l->bounce);
    memset(l, 0, sizeof *l);
}

/* Count cells, find room for their records. What bounces is not known. */
static voxrt_result voxrti_gi_layer_open(voxrt_gi *gi, voxrti_gi_layer *l) {
    const voxrt_columns *c = gi->columns;
    const size_t columns = (size_t)c->size[0] * c->size[1];
    size_t i, n = 0;
    uint32_t w;
    l->count = 0;
    if (l->base == NULL) l->base = (uint32_t *)voxrti_alloc_array(&gi->mem, columns, 4);
    if (l->base == NULL) return VOXRT_ERR_NO_MEMORY;
    for (i = 0; i < columns; i++) {
        l->base[i] = (uint32_t)n;
        for (w = 0; w < c->words; w++) n += voxrti_popcount64(l->bits[i * c->words + w]);
    }
    if (n > l->capacity) {
        const size_t want = n + n / 4;
        uint32_t *base = l->base;
        const uint32_t *bits = l->bits;
        l->base = NULL;
        voxrti_gi_layer_free(gi, l);
        l->base = base;
        l->bits = bits;
        l->record = (voxrti_gi_record *)voxrti_alloc_array(&gi->mem, want, sizeof *l->record);
        l->direct = (uint32_t *)voxrti_alloc_array(&gi->mem, want, 8);
        l->bounce = (uint32_t *)voxrti_alloc_array(&gi->mem, want, 8);
        if (l->record == NULL || l->direct == NULL || l->bounce == NULL) {
            voxrti_gi_layer_free(gi, l);
            return VOXRT_ERR_NO_MEMORY;
        }
        l->capacity = want;
    }
    l->count = n;
    if (n != 0) memset(l->bounce, 255, n * 8);
    return VOXRT_OK;
}

/* Which points of an object's triangles are taken: 1, known from before; 2, to be found out; -1, no memory. */
static int voxrti_gi_lattice(voxrt_gi *gi, voxrti_gi_entry *e) {
    const size_t n = e->object.mesh.triangle_count;
    if (e->lattice != NULL && e->lattice_count == n) return 1;
    voxrti_free(&gi->mem, e->lattice);
    e->lattice_count = n;
    e->lattice = (uint16_t (*)[2])voxrti_alloc_zero(&gi->mem, n + 1, sizeof *e->lattice);
    return e->lattice != NULL ? 2 : -1;
}

/* Insert all objects of a layer; then their attributes. */
static voxrt_result voxrti_gi_layer_build(voxrt_gi *gi, uint32_t which) {
    voxrti_gi_layer *l = &gi->layer[which];
    voxrti_gi_build b;
    voxrt_result r;
    size_t i;
    uint32_t pass;
    memset(&b, 0, sizeof b);
    b.gi = gi;
    b.layer = l;
    for (i = 0; i < 256; i++) b.srgb[i] = (float)voxrti_srgb_to_linear((double)i / 255.0);
    for (pass = 0; pass < 3; pass++) { /* cells, then how their normals vary, then the sums of both sides */
        if (pass == 1) {
            r = voxrti_gi_layer_open(gi, l);
            if (r != VOXRT_OK) return r;
            if (l->count == 0) return VOXRT_OK;
            b.sum = (voxrti_gi_sum *)voxrti_alloc_zero(&gi->mem, l->count, sizeof *b.sum);
            if (b.sum == NULL) {
                l->count = 0;
                return VOXRT_ERR_NO_MEMORY;
            }
        }
        if (pass == 2) voxrti_parallel_for(&gi->env, voxrti_task_gi_split, &b, (uint32_t)((l->count + 4095) / 4096));
        b.votes = pass == 1;
        for (i = 0; i < gi->entry_count; i++) {
            voxrti_gi_entry *e = &gi->entry[i];
            voxrt_columns_insert_desc d, open;
            uint64_t leaks;
            if (!e->used || (e->object.still != 0) != (which == 0)) continue;
            memset(&d, 0, sizeof d);
            d.env = gi->env;
            d.mode = e->object.mode;
            d.spacing = e->object.spacing;
            memcpy(d.to_world, e->object.to_world, sizeof d.to_world);
            d.still = which == 0;
            if (pass != 0 && d.mode == VOXRT_COLUMNS_SOLID) d.mode = VOXRT_COLUMNS_THIN;
            r = voxrti_insert_open(&b.in, gi->columns, &d, &open);
            b.in.mesh = &e->object.mesh;
            b.in.count = e->object.mesh.triangle_count;
            b.in.own = which == 1 ? gi->own : NULL;
            b.id = (uint32_t)i;
            if (r == VOXRT_OK && d.mode == VOXRT_COLUMNS_SAMPLES) {
                b.in.grow = pass == 0 ? voxrti_gi_lattice(gi, e) : 0;
                b.in.lattice = e->lattice;
                if (b.in.grow < 0) r = VOXRT_ERR_NO_MEMORY;
            }
            if (r == VOXRT_OK && pass == 0) {
                r = voxrti_insert_mesh(&b.in, &gi->env, &leaks);
                gi->rejected += voxrti_tally(b.in.rejected);
                gi->open_columns += leaks;
            } else if (r == VOXRT_OK) {
                if (d.mode == VOXRT_COLUMNS_BODY) r = voxrti_insert_parity(&b.in, &gi->env, 0, &leaks);
                if (r == VOXRT_OK)
                    voxrti_parallel_for(&gi->env, voxrti_task_gi_fragments, &b, voxrti_insert_tasks(&b.in));
                voxrti_free(&gi->columns->mem, b.in.flips);
            }
            if (r != VOXRT_OK) {
                voxrti_free(&gi->mem, b.sum);
                l->count = 0;
                return r;
            }
        }
    }
    voxrti_parallel_for(&gi->env, voxrti_task_gi_resolve, &b, (uint32_t)((l->count + 4095) / 4096));
    voxrti_free(&gi->mem, b.sum);
    return VOXRT_OK;
}

/* What bounced on the cells of a layer goes over to the cells where their surfaces are now. */
typedef struct voxrti_gi_carry {
    const voxrt_gi *gi;
    voxrti_gi_layer *to;
    const voxrti_gi_layer *from;
} voxrti_gi_carry;

static void voxrti_gi_side_place(const voxrt_gi *gi, const voxrti_gi_record *r, uint32_t side, const uint32_t cell[3],
                                 float position[3], float normal[3]);

/* Bounced light in the old layer on the side that faces n, in the cell at p (in cells) or one that touches it. */
static uint32_t voxrti_gi_carried(const voxrti_gi_carry *w, const double p[3], const float n[3]) {
    static const int8_t step[7][3] = {{0, 0, 0}, {1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
    const voxrt_columns *c = w->gi->columns;
    uint32_t i, a, side;
    for (i = 0; i < 7; i++) {
        uint32_t q[3];
        size_t r;
        for (a = 0; a < 3; a++) {
            const double at = p[a] + (double)step[i][a];
            if (!(at >= 0.0 && at < (double)c->size[a])) break;
            q[a] = (uint32_t)at;
        }
        if (a < 3 || (w->from->bits[voxrti_column(c, 0, q[0], q[1]) + (q[2] >> 5)] >> (q[2] & 31u) & 1u) == 0) continue;
        r = voxrti_gi_rank(c, w->from, q[0], q[1], q[2]);
        for (side = 0; side < 2; side++) {
            float m[3];
            if (w->from->record[r].area[side] == 0) continue;
            voxrti_oct_decode(w->from->record[r].normal[side], m);
            if (voxrti_dot3(m, n) > 0.7f) return w->from->bounce[2 * r + side];
        }
    }
    return VOXRTI_GI_UNKNOWN;
}

static void voxrti_task_gi_carry(void *ctx, uint32_t y) {
    const voxrti_gi_carry *w = (const voxrti_gi_carry *)ctx;
    const voxrt_columns *c = w->gi->columns;
    size_t rec = w->to->base[(size_t)y << c->row_log[0]];
    uint32_t x, k, side, a, b;
    for (x = 0; x < c->size[0]; x++)
        for (k = 0; k < c->words; k++) {
            uint32_t bits = w->to->bits[voxrti_column(c, 0, x, y) + k];
            for (; bits != 0; bits &= bits - 1, rec++)
                for (side = 0; side < 2; side++) {
                    const uint32_t cell[3] = {x, y, 32 * k + voxrti_ctz64(bits)};
                    const voxrti_gi_record *r = &w->to->record[rec];
                    const voxrti_gi_entry *e = &w->gi->entry[r->object[side]];
                    float p[3], n[3], m[3];
                    double q[3];
                    if (r->area[side] == 0) continue;
                    voxrti_gi_side_place(w->gi, r, side, cell, p, n);
                    for (a = 0; a < 3; a++) {
                        const uint32_t g = c->axis[a];
                        double at = (double)p[g];
                        m[g] = n[g];
                        if (e->moved) {
                            at = e->back[4 * g + 3];
                            m[g] = 0.0f;
                            for (b = 0; b < 3; b++) {
                                at += e->back[4 * g + b] * (double)p[b];
                                m[g] += (float)e->back[4 * g + b] * n[b];
                            }
                        }
                        q[a] = (at - w->gi->origin_before[a]) * c->per_cell[a];
                    }
                    (void)voxrti_normalize(m);
                    w->to->bounce[2 * rec + side] = voxrti_gi_carried(w, q, m);
                }
        }
}

/* Where objects were at the last update and where they are now. */
static void voxrti_gi_track(voxrt_gi *gi) {
    static const double same[12] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};
    size_t i;
    uint32_t a, b, k;
    for (i = 0; i < gi->entry_count; i++) {
        voxrti_gi_entry *e = &gi->entry[i];
        const double *now = e->object.to_world;
        double inverse[12];
        int any = 0;
        if (!e->used) continue;
        for (a = 0; a < 12; a++) any |= now[a] != 0.0;
        if (!any) now = same;
        e->moved = e->placed != 0 && memcmp(e->at, now, sizeof e->at) != 0 && voxrti_affine_invert(now, inverse);
        for (a = 0; a < 3 && e->moved; a++)
            for (b = 0; b < 4; b++) {
                e->back[4 * a + b] = b == 3 ? e->at[4 * a + 3] : 0.0;
                for (k = 0; k < 3; k++) e->back[4 * a + b] += e->at[4 * a + k] * inverse[4 * k + b];
            }
        memcpy(e->at, now, sizeof e->at);
        e->placed = 1;
    }
}

/* All triangles of objects that emit light. */
static voxrt_result voxrti_gi_find_emitters(voxrt_gi *gi) {
    double sum = 0.0;
    size_t i, t, room = 0;
    gi->emitter_count = 0;
    for (i = 0; i < gi->entry_count; i++) {
        const voxrti_gi_entry *e = &gi->entry[i];
        if (e->used && e->emission[0] + e->emission[1] + e->emission[2] > 0.0f) room += e->object.mesh.triangle_count;
    }
    if (room > gi->emitter_capacity) {
        voxrti_free(&gi->mem, gi->emitter);
        gi->emitter_capacity = 0;
        gi->emitter = (voxrti_emitter *)voxrti_alloc_array(&gi->mem, room, sizeof *gi->emitter);
        if (gi->emitter == NULL) return VOXRT_ERR_NO_MEMORY;
        gi->emitter_capacity = room;
    }
    for (i = 0; i < gi->entry_count && room != 0; i++) {
        const voxrti_gi_entry *e = &gi->entry[i];
        const voxrt_mesh *mesh = &e->object.mesh;
        const size_t stride = mesh->position_stride != 0 ? mesh->position_stride : 12;
        const float share = 0.2126f * e->emission[0] + 0.7152f * e->emission[1] + 0.0722f * e->emission[2];
        if (!e->used || !(share > 0.0f)) continue;
        for (t = 0; t < mesh->triangle_count; t++) {
            voxrti_emitter *m = &gi->emitter[gi->emitter_count];
            float p[3][3], l;
            uint32_t k, a, b, ok = 1;
            for (k = 0; k < 3 && ok; k++) {
                const size_t at = mesh->indices != NULL ? (size_t)mesh->indices[3 * t + k] : 3 * t + k;
                float v[3];
                ok = at < mesh->vertex_count;
                if (!ok) break;
                memcpy(v, (const uint8_t *)mesh->positions + at * stride, 12);
                for (a = 0; a < 3; a++) {
                    double w = e->at[4 * a + 3];
                    for (b = 0; b < 3; b++) w += e->at[4 * a + b] * (double)v[b];
                    p[k][a] = (float)w;
                    ok &= (uint32_t)(voxrti_absf(p[k][a]) < 1e12f);
                }
            }
            if (!ok) continue;
            for (a = 0; a < 3; a++) {
                m->p[a] = p[0][a];
                m->u[a] = p[1][a] - p[0][a];
                m->v[a] = p[2][a] - p[0][a];
            }
            for (a = 0; a < 3; a++)
                m->n[a] = m->u[(a + 1) % 3] * m->v[(a + 2) % 3] - m->u[(a + 2) % 3] * m->v[(a + 1) % 3];
            l = 0.5f * sqrtf(voxrti_dot3(m->n, m->n));
            if (!voxrti_normalize(m->n) || !(l > 0.0f) || !(l < 1e30f)) continue;
            memcpy(m->rgb, e->emission, 12);
            m->share = share;
            m->sum = sum += (double)share * (double)l;
            gi->emitter_count++;
        }
    }
    return VOXRT_OK;
}

/* Voxelise the layers of one volume that changed, keep what bounced. */
static voxrt_result voxrti_gi_update_one(voxrt_gi *gi) {
    voxrt_columns *c = gi->columns;
    const size_t words = (size_t)c->size[0] * c->size[1] * c->words;
    voxrti_gi_layer old, spare;
    voxrti_gi_carry carry;
    voxrt_result r = VOXRT_OK;
    uint32_t *still = NULL, *own = gi->own;
    gi->rejected = gi->open_columns = 0;
    voxrti_gi_track(gi);
    memset(&old, 0, sizeof old);
    carry.gi = gi;
    if (gi->still_changed && gi->layer[0].count != 0) {
        still = (uint32_t *)voxrti_alloc_array(&gi->mem, words, 4);
        if (still == NULL) return VOXRT_ERR_NO_MEMORY;
        memcpy(still, c->still, words * 4);
        old = gi->layer[0];
        old.bits = still;
        memset(&gi->layer[0], 0, sizeof gi->layer[0]);
    }
    gi->own = gi->own_before;
    gi->own_before = own;
    memset(gi->own, 0, words * 4);
    voxrt_columns_clear(c, gi->still_changed != 0);
    if (gi->still_changed) {
        gi->layer[0].count = 0;
        gi->layer[0].bits = c->still;
        r = voxrti_gi_layer_build(gi, 0);
        if (r == VOXRT_OK && old.count != 0 && gi->layer[0].count != 0) {
            carry.to = &gi->layer[0];
            carry.from = &old;
            voxrti_parallel_for(&gi->env, voxrti_task_gi_carry, &carry, c->size[1]);
        }
        if (r == VOXRT_OK) gi->still_changed = 0;
        voxrti_gi_layer_free(gi, &old);
        voxrti_free(&gi->mem, still);
    }
    spare = gi->before;
    gi->before = gi->layer[1];
    gi->before.bits = gi->own_before;
    gi->layer[1] = spare;
    gi->layer[1].count = 0;
    gi->layer[1].bits = gi->own;
    if (r == VOXRT_OK) r = voxrti_gi_layer_build(gi, 1);
    if (r == VOXRT_OK && gi->before.count != 0 && gi->layer[1].count != 0) {
        carry.to = &gi->layer[1];
        carry.from = &gi->before;
        voxrti_parallel_for(&gi->env, voxrti_task_gi_carry, &carry, c->size[1]);
    }
    memcpy(gi->origin_before, c->origin, sizeof gi->origin_before);
    voxrt_columns_update(c);
    return r;
}

static void voxrti_gi_darken(voxrt_gi *gi);

VOXRT_DEF voxrt_result voxrt_gi_update(voxrt_gi *gi, voxrt_gi_update_stats *stats) {
    voxrt_gi *g;
    voxrt_result r = VOXRT_OK;
    uint32_t changed = 0;
    if (stats != NULL) memset(stats, 0, sizeof *stats);
    if (gi == NULL) return VOXRT_ERR_INVALID_ARG;
    for (g = gi; g != NULL; g = g->outer) changed |= g->changed;
    for (g = gi; g != NULL && r == VOXRT_OK; g = g->outer) {
        if (!changed) voxrti_gi_track(g); /* what moved before stands still now */
        else if ((r = voxrti_gi_update_one(g)) == VOXRT_OK) g->changed = 0;
        else g->changed = 1;
    }
    if (changed) {
        voxrti_gi_darken(gi);
        if (r == VOXRT_OK) r = voxrti_gi_find_emitters(gi);
    }
    if (r != VOXRT_OK) {
        gi->changed = 1;
        return voxrti_fail(gi->env.error, r, 0, "no memory for the attributes of cells");
    }
    for (g = gi; g != NULL && stats != NULL; g = g->outer) {
        stats->still_cells += g->layer[0].count;
        stats->moving_cells += g->layer[1].count;
        stats->rejected += g == gi ? g->rejected : 0;
        stats->open_columns += g == gi ? g->open_columns : 0;
        stats->bytes += g->mem.used + g->columns->mem.used;
    }
    return VOXRT_OK;
}

/* ---- objects and lights ---- */

static voxrt_result voxrti_gi_object_check(const voxrt_gi *gi, const voxrt_gi_object *o) {
    uint32_t a;
    int ok = 1;
    if (gi == NULL || o == NULL || (o->mesh.triangle_count != 0 && o->mesh.positions == NULL))
        return VOXRT_ERR_INVALID_ARG;
    if (o->mesh.triangle_count / VOXRTI_INSERT_TASK >= 0x7fffffff) return VOXRT_ERR_INVALID_ARG;
    for (a = 0; a < 12; a++) ok &= voxrti_finite(o->to_world[a]);
    for (a = 0; a < 3; a++) {
        const voxrt_gi_material *m = &o->material;
        ok &= m->albedo[a] >= 0.0f && m->albedo[a] <= 1.0f && m->specular[a] >= 0.0f && m->specular[a] <= 1.0f;
        ok &= m->emission[a] >= 0.0f && voxrti_finite_f(m->emission[a]);
    }
    ok &= o->material.exponent >= 0.0f && o->material.exponent <= 1e6f;
    ok &= (uint32_t)o->mode <= VOXRT_COLUMNS_BODY && voxrti_spacing_ok(o->spacing);
    return ok ? VOXRT_OK : voxrti_fail(gi->env.error, VOXRT_ERR_INVALID_ARG, 0,
                                       "matrix, material, mode or spacing out of range");
}

static void voxrti_gi_lattice_free(voxrt_gi *gi, voxrti_gi_entry *e) {
    voxrti_free(&gi->mem, e->lattice);
    e->lattice = NULL;
    e->lattice_count = 0;
}

static void voxrti_gi_entry_set(voxrt_gi *gi, size_t id, const voxrt_gi_object *o) {
    voxrti_gi_entry *e = &gi->entry[id];
    if (o->still || (e->used && e->object.still)) gi->still_changed = 1;
    gi->changed = 1;
    if (!e->used) e->placed = 0;
    if (o->mode != VOXRT_COLUMNS_SAMPLES || o->spacing != e->object.spacing ||
        o->mesh.triangle_count != e->lattice_count) voxrti_gi_lattice_free(gi, e);
    e->object = *o;
    e->used = 1;
    memcpy(e->emission, o->material.emission, sizeof e->emission);
    memset(e->specular, 0, sizeof e->specular);
    if (o->material.exponent > 0.0f) {
        memcpy(e->specular, o->material.specular, sizeof o->material.specular);
        e->specular[3] = o->material.exponent;
    }
}

/* Put an object in place id of the outer volumes, too. */
static voxrt_result voxrti_gi_pass_on(voxrt_gi *gi, size_t id, const voxrt_gi_object *object) {
    for (gi = gi->outer; gi != NULL; gi = gi->outer) {
        while (id >= gi->entry_count) {
            const size_t n = gi->entry_count;
            if (!voxrti_grow(&gi->mem, (void **)&gi->entry, &gi->entry_capacity, n, n + 1, sizeof *gi->entry))
                return voxrti_fail(gi->env.error, VOXRT_ERR_NO_MEMORY, id, "no memory for object %");
            memset(&gi->entry[n], 0, sizeof gi->entry[n]);
            gi->entry_count++;
        }
        if (object != NULL) {
            voxrti_gi_entry_set(gi, id, object);
        } else {
            if (gi->entry[id].object.still) gi->still_changed = 1;
            gi->changed = 1;
            voxrti_gi_lattice_free(gi, &gi->entry[id]);
            memset(&gi->entry[id], 0, sizeof gi->entry[id]);
        }
    }
    return VOXRT_OK;
}

VOXRT_DEF voxrt_result voxrt_gi_add(voxrt_gi *gi, const voxrt_gi_object *object, uint32_t *out_id) {
    size_t i;
    voxrt_result r;
    if (out_id != NULL) *out_id = 0;
    r = voxrti_gi_object_check(gi, object);
    if (r != VOXRT_OK) return r;
    for (i = 0; i < gi->entry_count && gi->entry[i].used; i++) { }
    if (i >= 65535) return voxrti_fail(gi->env.error, VOXRT_ERR_RANGE, i, "% objects are the most");
    if (i == gi->entry_count) {
        if (!voxrti_grow(&gi->mem, (void **)&gi->entry, &gi->entry_capacity, gi->entry_count, i + 1, sizeof *gi->entry))
            return voxrti_fail(gi->env.error, VOXRT_ERR_NO_MEMORY, i, "no memory for object %");
        memset(&gi->entry[i], 0, sizeof gi->entry[i]);
        gi->entry_count++;
    }
    r = voxrti_gi_pass_on(gi, i, object);
    if (r != VOXRT_OK) return r;
    voxrti_gi_entry_set(gi, i, object);
    if (out_id != NULL) *out_id = (uint32_t)i;
    return VOXRT_OK;
}

VOXRT_DEF voxrt_result voxrt_gi_set(voxrt_gi *gi, uint32_t id, const voxrt_gi_object *object) {
    voxrt_result r = voxrti_gi_object_check(gi, object);
    if (r != VOXRT_OK) return r;
    if (id >= gi->entry_count || !gi->entry[id].used)
        return voxrti_fail(gi->env.error, VOXRT_ERR_INVALID_ARG, id, "there is no object %");
    voxrti_gi_entry_set(gi, id, object);
    return voxrti_gi_pass_on(gi, id, object);
}

VOXRT_DEF voxrt_result voxrt_gi_remove(voxrt_gi *gi, uint32_t id) {
    if (gi == NULL) return VOXRT_ERR_INVALID_ARG;
    if (id >= gi->entry_count || !gi->entry[id].used)
        return voxrti_fail(gi->env.error, VOXRT_ERR_INVALID_ARG, id, "there is no object %");
    if (gi->entry[id].object.still) gi->still_changed = 1;
    gi->changed = 1;
    voxrti_gi_lattice_free(gi, &gi->entry[id]);
    memset(&gi->entry[id], 0, sizeof gi->entry[id]);
    return voxrti_gi_pass_on(gi, id, NULL);
}

static void voxrti_gi_maps_free(voxrt_gi *gi) {
    size_t i;
    for (i = 0; i < gi->light_count && gi->map != NULL; i++) voxrti_free(&gi->mem, gi->map[i].texel);
    voxrti_free(&gi->mem, gi->map);
    gi->map = NULL;
}

/* Light has changed: nothing is known about it. */
static void voxrti_gi_darken(voxrt_gi *gi) {
    uint32_t l;
    voxrti_gi_maps_free(gi);
    gi->version++;
    for (; gi != NULL; gi = gi->outer)
        for (l = 0; l < 2; l++)
            if (gi->layer[l].count != 0) memset(gi->layer[l].direct, 255, gi->layer[l].count * 8);
}

VOXRT_DEF voxrt_result voxrt_gi_set_lights(voxrt_gi *gi, const voxrt_gi_light *lights, size_t count) {
    voxrt_gi_light *copy = NULL;
    size_t i;
    uint32_t a;
    if (gi == NULL || (lights == NULL && count != 0)) return VOXRT_ERR_INVALID_ARG;
    if (count != 0) {
        copy = (voxrt_gi_light *)voxrti_alloc_array(&gi->mem, count, sizeof *copy);
        if (copy == NULL) return voxrti_fail(gi->env.error, VOXRT_ERR_NO_MEMORY, count, "no memory for % lights");
    }
    for (i = 0; i < count; i++) {
        voxrt_gi_light *s = &copy[i];
        int ok = 1;
        *s = lights[i];
        for (a = 0; a < 3; a++) {
            ok &= voxrti_finite_f(s->position[a]) && voxrti_finite_f(s->direction[a]) && voxrti_finite_f(s->edge_u[a]);
            ok &= voxrti_finite_f(s->edge_v[a]) && s->color[a] >= 0.0f && voxrti_finite_f(s->color[a]);
        }
        if (s->kind == VOXRT_GI_SPOT || s->kind == VOXRT_GI_DIRECTIONAL) ok &= voxrti_normalize(s->direction);
        if (s->kind == VOXRT_GI_SPOT) ok &= s->angle > 0.0f && s->angle < 90.0f;
        if (s->kind == VOXRT_GI_AREA) {
            for (a = 0; a < 3; a++)
                s->direction[a] = s->edge_u[(a + 1) % 3] * s->edge_v[(a + 2) % 3] - s->edge_u[(a + 2) % 3] *
                    s->edge_v[(a + 1) % 3];
            ok &= voxrti_normalize(s->direction);
        }
        if (!ok || (uint32_t)s->kind > VOXRT_GI_AREA) {
            voxrti_free(&gi->mem, copy);
            return voxrti_fail(gi->env.error, VOXRT_ERR_INVALID_ARG, i, "light % is none");
        }
    }
    if (count == gi->light_count && (count == 0 || memcmp(copy, gi->light, count * sizeof *copy) == 0)) {
        voxrti_free(&gi->mem, copy); /* the same ones */
        return VOXRT_OK;
    }
    voxrti_gi_darken(gi);
    voxrti_free(&gi->mem, gi->light);
    gi->light = copy;
    gi->light_count = count;
    return VOXRT_OK;
}

/* One volume; those around it are added by voxrt_gi_create. */
static voxrt_result voxrti_gi_open(const voxrt_gi_desc *desc, const voxrt_columns_desc *columns, voxrt_gi **out_gi) {
    voxrti_mem mem;
    voxrt_columns_desc d;
    voxrt_gi *gi;
    uint32_t a;
    voxrt_result r = voxrti_env_open(&desc->env, &mem);
    *out_gi = NULL;
    if (r != VOXRT_OK) return r;
    gi = (voxrt_gi *)voxrti_alloc_zero(&mem, 1, sizeof *gi);
    if (gi == NULL) return voxrti_fail(desc->env.error, VOXRT_ERR_NO_MEMORY, 0, "no memory for a scene");
    gi->mem = mem;
    gi->env = desc->env;
    gi->still_changed = gi->changed = 1;
    gi->emit.kind = (voxrt_gi_light_kind)VOXRTI_GI_EMITTERS;
    d = *columns;
    d.env = desc->env;
    for (a = 0; a < 3; a++) {
        gi->lo[a] = (float)d.box_min[a];
        gi->hi[a] = (float)d.box_max[a];
    }
    r = voxrt_columns_create(&d, &gi->columns);
    if (r == VOXRT_OK && gi->columns != NULL) {
        const size_t n = (size_t)gi->columns->size[0] * gi->columns->size[1] * gi->columns->words;
        gi->own = (uint32_t *)voxrti_alloc_zero(&gi->mem, n, 4);
        gi->own_before = (uint32_t *)voxrti_alloc_zero(&gi->mem, n, 4);
        gi->columns->still = (uint32_t *)voxrti_alloc_zero(&gi->columns->mem, n, 4);
        memcpy(gi->origin_before, gi->columns->origin, sizeof gi->origin_before);
        if (gi->own == NULL || gi->own_before == NULL || gi->columns->still == NULL)
            r = voxrti_fail(desc->env.error, VOXRT_ERR_NO_MEMORY, n, "no memory for layers of % words");
    }
    if (r == VOXRT_OK) *out_gi = gi;
    else voxrt_gi_destroy(gi);
    return r;
}

VOXRT_DEF voxrt_result voxrt_gi_create(const voxrt_gi_desc *desc, voxrt_gi **out_gi) {
    voxrt_columns_desc d;
    voxrt_gi **to;
    voxrt_result r = VOXRT_OK;
    uint32_t l, a, levels;
    if (out_gi == NULL) return VOXRT_ERR_INVALID_ARG;
    *out_gi = NULL;
    if (desc == NULL) return VOXRT_ERR_INVALID_ARG;
    if (desc->_begin_zero != 0 || desc->_end_zero != 0) return VOXRT_ERR_UNINIT_DESC;
    levels = desc->nested != 0 ? desc->nested : 1;
    if (levels > 8) return voxrti_fail(desc->env.error, VOXRT_ERR_INVALID_ARG, levels, "% nested volumes are too many");
    d = desc->columns;
    for (l = 0, to = out_gi; l < levels && r == VOXRT_OK; l++) {
        r = voxrti_gi_open(desc, &d, to);
        if (r != VOXRT_OK || *to == NULL || (*to)->columns == NULL) break;
        d.depth_axis_plus_1 = (*to)->columns->axis[2] + 1; /* of a box like the first */
        to = &(*to)->outer;
        for (a = 0; a < 3; a++) {
            const double half = 0.5 * (d.box_max[a] - d.box_min[a]);
            d.box_min[a] -= half;
            d.box_max[a] += half;
        }
    }
    if (r != VOXRT_OK) {
        voxrt_gi_destroy(*out_gi);
        *out_gi = NULL;
    }
    return r;
}

VOXRT_DEF void voxrt_gi_destroy(voxrt_gi *gi) {
    while (gi != NULL) {
        voxrt_gi *outer = gi->outer;
        voxrti_mem mem = gi->mem;
        size_t i;
        uint32_t l;
        for (i = 0; i < gi->entry_count; i++) voxrti_gi_lattice_free(gi, &gi->entry[i]);
        for (l = 0; l < 2; l++) voxrti_gi_layer_free(gi, &gi->layer[l]);
        voxrti_gi_layer_free(gi, &gi->before);
        voxrti_gi_maps_free(gi);
        voxrt_columns_destroy(gi->columns);
        voxrti_free(&gi->mem, gi->entry);
        voxrti_free(&gi->mem, gi->light);
        voxrti_free(&gi->mem, gi->emitter);
        voxrti_free(&gi->mem, gi->vpl);
        voxrti_free(&gi->mem, gi->own);
        voxrti_free(&gi->mem, gi->own_before);
        mem = gi->mem;
        voxrti_free(&mem, gi);
        gi = outer;
    }
}

VOXRT_DEF voxrt_result voxrt_gi_follow(voxrt_gi *gi, const double centre[3], uint32_t *out_moved) {
    uint32_t a;
    if (out_moved != NULL) *out_moved = 0;
    if (gi == NULL || centre == NULL) return VOXRT_ERR_INVALID_ARG;
    for (a = 0; a < 3; a++)
        if (!(voxrti_abs(centre[a]) < 1e12))
            return voxrti_fail(gi->env.error, VOXRT_ERR_INVALID_ARG, a, "coordinate % is not finite");
    for (; gi != NULL; gi = gi->outer) {
        voxrt_columns *c = gi->columns;
        int moved = 0;
        for (a = 0; a < 3; a++) { /* by whole steps, so that cells stay where they were */
            const uint32_t w = c->axis[a];
            const double step = 8.0 * c->cell[a], half = 0.5 * c->cell[a] * (double)c->size[a];
            const double by = step * (double)voxrti_floor((centre[w] - half - c->origin[a]) / step + 0.5);
            if (by == 0.0) continue;
            moved = 1;
            c->origin[a] += by;
            gi->lo[w] = (float)c->origin[a];
            gi->hi[w] = (float)(c->origin[a] + 2.0 * half);
        }
        if (moved && out_moved != NULL) ++*out_moved;
        if (moved) gi->still_changed = gi->changed = 1;
    }
    return VOXRT_OK;
}

VOXRT_DEF const voxrt_columns *voxrt_gi_columns(const voxrt_gi *gi) { return gi != NULL ? gi->columns : NULL; }

/* ---- light that falls on cells ---- */

/* One side of a cell, in one of the nested volumes. */
typedef struct voxrti_gi_side {
    const voxrt_gi *gi;
    size_t at;        /* 2 * record + side; -1: none */
    uint32_t layer;
    float position[3], normal[3], albedo[3];
} voxrti_gi_side;

VOXRTI_INLINE const voxrti_gi_entry *voxrti_gi_side_entry(const voxrti_gi_side *s) {
    return &s->gi->entry[s->gi->layer[s->layer].record[s->at >> 1].object[s->at & 1u]];
}

/* A side of the cell (x, y, k) of a record, as it lies in the world. */
static void voxrti_gi_side_place(const voxrt_gi *gi, const voxrti_gi_record *r, uint32_t side, const uint32_t cell[3],
                                 float position[3], float normal[3]) {
    const voxrt_columns *c = gi->columns;
    const float lift = (float)((double)r->offset[side] * (c->diagonal / 254.0));
    uint32_t a;
    voxrti_oct_decode(r->normal[side], normal);
    for (a = 0; a < 3; a++) {
        const uint32_t w = c->axis[a];
        position[w] = (float)(c->origin[a] + ((double)cell[a] + 0.5) * c->cell[a]) + lift * normal[w];
    }
}

/* Which side of a cell does a ray in direction dir see? i, layer: its record. 0: none. */
static int voxrti_gi_side_see(const voxrt_gi *gi, size_t i, uint32_t layer, const uint32_t cell[3], const float dir[3],
                              voxrti_gi_side *s) {
    const voxrti_gi_record *r;
    float best = 0.0f, n[3] = {0, 0, 0};
    uint32_t side, seen = 2, a;
    s->gi = gi;
    s->layer = layer;
    s->at = (size_t)-1;
    if (i == (size_t)-1) return 0;
    r = &gi->layer[s->layer].record[i];
    for (side = 0; side < 2; side++) {
        float facing;
        if (r->area[side] == 0) continue;
        voxrti_oct_decode(r->normal[side], n);
        facing = 0.0f - voxrti_dot3(n, dir);
        if (!(facing > best)) continue;
        best = facing;
        seen = side;
    }
    if (seen == 2) return 0;
    s->at = 2 * i + seen;
    voxrti_gi_side_place(gi, r, seen, cell, s->position, s->normal);
    for (a = 0; a < 3; a++) {
        const float q = (float)r->rgb[seen][a] * (1.0f / 255.0f);
        s->albedo[a] = q * q;
    }
    return 1;
}

static int voxrti_gi_side_open(const voxrt_gi *gi, uint32_t x, uint32_t y, uint32_t k, const float dir[3],
                               voxrti_gi_side *s) {
    const uint32_t cell[3] = {x, y, k};
    uint32_t layer;
    const size_t i = voxrti_gi_find(gi, x, y, k, &layer);
    return voxrti_gi_side_see(gi, i, layer, cell, dir, s);
}

/* Records of the cells that rays have hit, on their way from memory when this returns. */
VOXRTI_INLINE void voxrti_gi_find_each(const voxrt_gi *const *where, const voxrt_column_hit *hit, uint32_t count,
                                       size_t *of, uint8_t *layer) {
    uint32_t i, l;
    for (i = 0; i < count; i++) {
        const voxrt_gi *gi = where[i];
        of[i] = (size_t)-1;
        layer[i] = 0;
        if (!(hit[i].t < INFINITY)) continue;
        of[i] = voxrti_gi_find(gi, hit[i].cell[0], hit[i].cell[1], hit[i].cell[2], &l);
        layer[i] = (uint8_t)l;
        if (of[i] == (size_t)-1) continue;
        VOXRTI_PREFETCH(&gi->layer[l].record[of[i]]);
        VOXRTI_PREFETCH(&gi->layer[l].direct[2 * of[i]]);
        VOXRTI_PREFETCH(&gi->layer[l].bounce[2 * of[i]]);
    }
}
#if VOXRTI_AVX2
VOXRTI_TARGET_AVX2 static void voxrti_gi_find_popcnt(const voxrt_gi *const *where, const voxrt_column_hit *hit,
                                                     uint32_t count, size_t *of, uint8_t *layer) {
    voxrti_gi_find_each(where, hit, count, of, layer); /* ranks by an instruction */
}
#endif
static void voxrti_gi_find_all(int isa, const voxrt_gi *const *where, const voxrt_column_hit *hit, uint32_t count,
                               size_t *of, uint8_t *layer) {
#if VOXRTI_AVX2
    if (isa >= VOXRT_ISA_AVX2) {
        voxrti_gi_find_popcnt(where, hit, count, of, layer);
        return;
    }
#endif
    (void)isa;
    voxrti_gi_find_each(where, hit, count, of, layer);
}

/* t at which a ray meets the plane of the side it hit at t; t itself where the plane lies far from there. */
VOXRTI_INLINE float voxrti_gi_side_meet(const voxrti_gi_side *s, const voxrt_ray *r, float t) {
    const float near_by = 1.0f * (float)s->gi->columns->diagonal;
    float d[3], at;
    uint32_t a;
    for (a = 0; a < 3; a++) d[a] = s->position[a] - r->org[a];
    at = voxrti_dot3(d, s->normal) / voxrti_dot3(r->dir, s->normal);
    return voxrti_absf(at - t) * sqrtf(voxrti_dot3(r->dir, r->dir)) < near_by ? at : t;
}

/* ---- rays through nested volumes ---- */

/* Where a ray that is inside gi's volume at t leaves it; below 0: it is not inside. */
static float voxrti_gi_exit(const voxrt_gi *gi, const voxrt_ray *r, float t) {
    float end = INFINITY;
    uint32_t a;
    for (a = 0; a < 3; a++) {
        const float at = r->org[a] + t * r->dir[a];
        if (!(at >= gi->lo[a] && at <= gi->hi[a])) return -1.0f;
        if (r->dir[a] != 0.0f) {
            const float e = ((r->dir[a] > 0.0f ? gi->hi[a] : gi->lo[a]) - r->org[a]) / r->dir[a];
            end = e < end ? e : end;
        }
    }
    return end > t ? end : t;
}

/* Up to VOXRTI_COLUMN_BATCH rays through the innermost volume that holds their origin, and on through those around it:
   hits, and in which volume; or, with hit NULL, whether there is any. normals, ends: xyz for each ray, at its origin
   and its end, or NULL. */
static void voxrti_gi_trace(const voxrt_gi *gi, int isa, const float *normals, const float *ends, const voxrt_ray *ray,
                            uint32_t count, voxrt_column_hit *hit, const voxrt_gi **where, uint8_t *dark,
                            voxrt_stats *stats) {
    voxrt_columns_trace_desc d;
    voxrt_ray part[VOXRTI_COLUMN_BATCH];
    voxrt_column_hit found[VOXRTI_COLUMN_BATCH];
    float normal[VOXRTI_COLUMN_BATCH][3], end[VOXRTI_COLUMN_BATCH][3];
    float from[VOXRTI_COLUMN_BATCH], next[VOXRTI_COLUMN_BATCH];
    uint8_t of[VOXRTI_COLUMN_BATCH], done[VOXRTI_COLUMN_BATCH], shut[VOXRTI_COLUMN_BATCH];
    const voxrt_gi *g;
    uint32_t i, j, m;
    memset(&d, 0, sizeof d);
    d.isa = (voxrt_isa)isa;
    d.normals = normals;
    d.end_normals = ends;
    d.stats = stats;
    if (gi->outer == NULL) {
        if (hit != NULL) (void)voxrt_columns_trace(gi->columns, &d, ray, hit, count);
        else (void)voxrt_columns_occluded(gi->columns, &d, ray, dark, count);
        for (i = 0; i < count && where != NULL; i++) where[i] = gi;
        return;
    }
    for (i = 0; i < count; i++) {
        from[i] = ray[i].t_min;
        done[i] = 0;
        if (dark != NULL) dark[i] = 0;
        if (hit == NULL) continue;
        memset(&hit[i], 0, sizeof hit[i]);
        hit[i].t = INFINITY;
        where[i] = gi;
    }
    if (normals != NULL) d.normals = normal[0];
    if (ends != NULL) d.end_normals = end[0];
    for (g = gi; g != NULL; g = g->outer) {
        for (i = m = 0; i < count; i++) {
            if (done[i]) continue;
            next[m] = voxrti_gi_exit(g, &ray[i], from[i]);
            if (next[m] < 0.0f && g->outer != NULL) continue;
            part[m] = ray[i];
            part[m].t_min = from[i];
            memset(end[m], 0, sizeof end[m]);
            if (ends != NULL) memcpy(end[m], ends + 3 * i, sizeof end[m]);
            if (next[m] >= 0.0f && next[m] < ray[i].t_max) { /* it does not end here */
                part[m].t_max = next[m];
                memset(end[m], 0, sizeof end[m]);
            }
            if (normals != NULL) memcpy(normal[m], normals + 3 * i, sizeof normal[m]);
            of[m++] = (uint8_t)i;
        }
        if (m == 0) continue;
        if (hit != NULL) (void)voxrt_columns_trace(g->columns, &d, part, found, m);
        else (void)voxrt_columns_occluded(g->columns, &d, part, shut, m);
        for (j = 0; j < m; j++) {
            i = of[j];
            if (hit != NULL ? found[j].t < INFINITY : shut[j] != 0) {
                done[i] = 1;
                if (dark != NULL) dark[i] = 1;
                if (hit == NULL) continue;
                hit[i] = found[j];
                where[i] = g;
            } else if (next[j] < 0.0f || next[j] >= ray[i].t_max) {
                done[i] = 1;
            } else {
                from[i] = next[j];
            }
        }
    }
}

/* ---- samples ---- */

/* Counter-based numbers in [0, 1): a scrambled Sobol point for each index, two dimensions at a time (Burley 2020). */
VOXRTI_INLINE uint32_t voxrti_reverse_bits(uint32_t x) {
    x = (x >> 1 & 0x55555555u) | (x & 0x55555555u) << 1;
    x = (x >> 2 & 0x33333333u) | (x & 0x33333333u) << 2;
    x = (x >> 4 & 0x0f0f0f0fu) | (x & 0x0f0f0f0fu) << 4;
    x = (x >> 8 & 0x00ff00ffu) | (x & 0x00ff00ffu) << 8;
    return x >> 16 | x << 16;
}
VOXRTI_INLINE uint32_t voxrti_scramble(uint32_t x, uint32_t seed) { /* Owen: each bit by those above it */
    x = voxrti_reverse_bits(x);
    x += seed;
    x ^= x * 0x6c50b47cu;
    x ^= x * 0xb82f1e52u;
    x ^= x * 0xc7afe638u;
    x ^= x * 0x8d22f6e6u;
    return voxrti_reverse_bits(x);
}
/* Second Sobol coordinate of i: bit k of i stands for (1 + s)^k, s a shift by one. As a polynomial of s by halves: the
   upper half times (1 + s)^m = upper half + s^m upper half. */
VOXRTI_INLINE uint32_t voxrti_sobol_second(uint32_t i) {
    i ^= i >> 16;
    i ^= i >> 8 & 0x00ff00ffu;
    i ^= i >> 4 & 0x0f0f0f0fu;
    i ^= i >> 2 & 0x33333333u;
    return voxrti_reverse_bits(i ^ (i >> 1 & 0x55555555u));
}
VOXRTI_INLINE void voxrti_sobol2(uint32_t index, uint32_t seed, float out[2]) {
    const uint32_t i = voxrti_scramble(index, seed), x = voxrti_reverse_bits(i), y = voxrti_sobol_second(i);
    out[0] = (float)(voxrti_scramble(x, voxrti_hash32(seed ^ 0x9e3779b9u)) >> 8) * (1.0f / 16777216.0f);
    out[1] = (float)(voxrti_scramble(y, voxrti_hash32(seed ^ 0x7f4a7c15u)) >> 8) * (1.0f / 16777216.0f);
}

/* sin and cos of 2 pi u, u in [0, 1): error < 1e-6 */
VOXRTI_INLINE void voxrti_turn(float u, float *s, float *c) {
    const int q = (int)(u * 4.0f + 0.5f);
    const float r = (u - (float)q * 0.25f) * 6.28318530718f, r2 = r * r; /* |r| <= pi/4 */
    const float sr = r * (1.0f - r2 * (1.0f / 6.0f) * (1.0f - r2 * (1.0f / 20.0f) * (1.0f - r2 * (1.0f / 42.0f))));
    const float cr = 1.0f - r2 * 0.5f *
        (1.0f - r2 * (1.0f / 12.0f) * (1.0f - r2 * (1.0f / 30.0f) * (1.0f - r2 * (1.0f / 56.0f))));
    *s = (q & 1) ? ((q & 2) ? -cr : cr) : ((q & 2) ? -sr : sr);
    *c = (q & 1) ? ((q & 2) ? sr : -sr) : ((q & 2) ? -cr : cr);
}

/* Two unit vectors at right angles to n and to each other (Duff et al. 2017). */
VOXRTI_INLINE void voxrti_tangents(const float n[3], float a[3], float b[3]) {
    const float s = n[2] >= 0.0f ? 1.0f : -1.0f, q = -1.0f / (s + n[2]), w = n[0] * n[1] * q;
    a[0] = 1.0f + s * n[0] * n[0] * q;
    a[1] = s * w;
    a[2] = 0.0f - s * n[0];
    b[0] = w;
    b[1] = s + n[1] * n[1] * q;
    b[2] = 0.0f - n[1];
}

/* A unit vector at `cosine` to n, turned by u. */
VOXRTI_INLINE void voxrti_around(const float n[3], float u, float cosine, float dir[3]) {
    float a[3], b[3], s, c, sine = 1.0f - cosine * cosine;
    uint32_t i;
    voxrti_tangents(n, a, b);
    voxrti_turn(u, &s, &c);
    sine = sine > 0.0f ? sqrtf(sine) : 0.0f;
    for (i = 0; i < 3; i++) dir[i] = (s * sine) * b[i] + (c * sine) * a[i] + cosine * n[i];
}

/* A direction over the hemisphere of n with density cos^power, power >= 1: cosine if 1. Returns the cosine. */
VOXRTI_INLINE float voxrti_lobe_direction(const float n[3], const float u[2], float power, float dir[3]) {
    float cosine;
    if (power == 1.0f) cosine = sqrtf(1.0f - u[1]);
    else cosine = (float)voxrti_pow((double)(1.0f - u[1]), 1.0 / ((double)power + 1.0));
    voxrti_around(n, u[0], cosine, dir);
    return cosine;
}

#if VOXRTI_AVX2
VOXRTI_TARGET_AVX2 VOXRTI_INLINE __m256i voxrti_reverse_bits8(__m256i x) {
    const __m256i bytes = _mm256_setr_epi8(3, 2, 1, 0, 7, 6, 5, 4, 11, 10, 9, 8, 15, 14, 13, 12,
                                           3, 2, 1, 0, 7, 6, 5, 4, 11, 10, 9, 8, 15, 14, 13, 12);
    const __m256i nibble = _mm256_set1_epi8(15);
    const __m256i turned = _mm256_setr_epi8(0, 8, 4, 12, 2, 10, 6, 14, 1, 9, 5, 13, 3, 11, 7, 15,
                                            0, 8, 4, 12, 2, 10, 6, 14, 1, 9, 5, 13, 3, 11, 7, 15);
    const __m256i low = _mm256_shuffle_epi8(turned, _mm256_and_si256(x, nibble));
    const __m256i high = _mm256_shuffle_epi8(turned, _mm256_and_si256(_mm256_srli_epi32(x, 4), nibble));
    return _mm256_shuffle_epi8(_mm256_or_si256(_mm256_slli_epi32(low, 4), high), bytes);
}
/* voxrti_scramble without the first reversal */
VOXRTI_TARGET_AVX2 VOXRTI_INLINE __m256i voxrti_scramble8(__m256i x, __m256i seed) {
    x = _mm256_add_epi32(x, seed);
    x = _mm256_xor_si256(x, _mm256_mullo_epi32(x, _mm256_set1_epi32((int)0x6c50b47cu)));
    x = _mm256_xor_si256(x, _mm256_mullo_epi32(x, _mm256_set1_epi32((int)0xb82f1e52u)));
    x = _mm256_xor_si256(x, _mm256_mullo_epi32(x, _mm256_set1_epi32((int)0xc7afe638u)));
    x = _mm256_xor_si256(x, _mm256_mullo_epi32(x, _mm256_set1_epi32((int)0x8d22f6e6u)));
    return voxrti_reverse_bits8(x);
}
VOXRTI_TARGET_AVX2 VOXRTI_INLINE __m256i voxrti_hash32_8(__m256i x) {
    x = _mm256_xor_si256(x, _mm256_srli_epi32(x, 16));
    x = _mm256_mullo_epi32(x, _mm256_set1_epi32(0x7feb352d));
    x = _mm256_xor_si256(x, _mm256_srli_epi32(x, 15));
    x = _mm256_mullo_epi32(x, _mm256_set1_epi32((int)0x846ca68bu));
    return _mm256_xor_si256(x, _mm256_srli_epi32(x, 16));
}
/* voxrti_sobol2 for eight indices and seeds */
VOXRTI_TARGET_AVX2 VOXRTI_INLINE void voxrti_sobol2_8(__m256i index, __m256i seed, __m256 out[2]) {
    const __m256i i = voxrti_scramble8(voxrti_reverse_bits8(index), seed);
    const __m256 unit = _mm256_set1_ps(1.0f / 16777216.0f);
    __m256i x, y = i;
    y = _mm256_xor_si256(y, _mm256_srli_epi32(y, 16));
    y = _mm256_xor_si256(y, _mm256_and_si256(_mm256_srli_epi32(y, 8), _mm256_set1_epi32(0x00ff00ff)));
    y = _mm256_xor_si256(y, _mm256_and_si256(_mm256_srli_epi32(y, 4), _mm256_set1_epi32(0x0f0f0f0f)));
    y = _mm256_xor_si256(y, _mm256_and_si256(_mm256_srli_epi32(y, 2), _mm256_set1_epi32(0x33333333)));
    y = _mm256_xor_si256(y, _mm256_and_si256(_mm256_srli_epi32(y, 1), _mm256_set1_epi32(0x55555555)));
    x = voxrti_scramble8(i, voxrti_hash32_8(_mm256_xor_si256(seed, _mm256_set1_epi32((int)0x9e3779b9u))));
    y = voxrti_scramble8(y, voxrti_hash32_8(_mm256_xor_si256(seed, _mm256_set1_epi32((int)0x7f4a7c15u))));
    out[0] = _mm256_mul_ps(_mm256_cvtepi32_ps(_mm256_srli_epi32(x, 8)), unit);
    out[1] = _mm256_mul_ps(_mm256_cvtepi32_ps(_mm256_srli_epi32(y, 8)), unit);
}
/* voxrti_turn */
VOXRTI_TARGET_AVX2 VOXRTI_INLINE void voxrti_turn8(__m256 u, __m256 *s, __m256 *c) {
    const __m256 one = _mm256_set1_ps(1.0f);
    const __m256i q = _mm256_cvttps_epi32(_mm256_add_ps(_mm256_mul_ps(u, _mm256_set1_ps(4.0f)), _mm256_set1_ps(0.5f)));
    const __m256 r = _mm256_mul_ps(_mm256_sub_ps(u, _mm256_mul_ps(_mm256_cvtepi32_ps(q), _mm256_set1_ps(0.25f))),
                                   _mm256_set1_ps(6.28318530718f));
    const __m256 r2 = _mm256_mul_ps(r, r), odd = _mm256_castsi256_ps(_mm256_slli_epi32(q, 31));
#define VOXRTI_LESS(k, rest) _mm256_sub_ps(one, _mm256_mul_ps(_mm256_mul_ps(r2, _mm256_set1_ps(k)), rest))
    const __m256 sr = _mm256_mul_ps(r, VOXRTI_LESS(1.0f / 6.0f, VOXRTI_LESS(1.0f / 20.0f,
            _mm256_sub_ps(one, _mm256_mul_ps(r2, _mm256_set1_ps(1.0f / 42.0f))))));
    const __m256 cr = VOXRTI_LESS(0.5f, VOXRTI_LESS(1.0f / 12.0f, VOXRTI_LESS(1.0f / 30.0f,
            _mm256_sub_ps(one, _mm256_mul_ps(r2, _mm256_set1_ps(1.0f / 56.0f))))));
#undef VOXRTI_LESS
    const __m256 two = _mm256_castsi256_ps(_mm256_slli_epi32(_mm256_srli_epi32(q, 1), 31));
    /* quarters 0 1 2 3: sine s, c, -s, -c; cosine c, -s, -c, s */
    *s = _mm256_xor_ps(_mm256_blendv_ps(sr, cr, odd), two);
    *c = _mm256_xor_ps(_mm256_blendv_ps(cr, sr, odd), _mm256_xor_ps(two, odd));
}

/* As below, eight at a time. */
VOXRTI_TARGET_AVX2 static void voxrti_cosine_rays_avx2(const uint32_t *index, const float (*n)[3],
                                                       const uint32_t *seed, uint32_t count, voxrt_ray *ray) {
    const __m256 one = _mm256_set1_ps(1.0f), zero = _mm256_setzero_ps();
    const __m256i third = _mm256_setr_epi32(0, 3, 6, 9, 12, 15, 18, 21);
    uint32_t i, j, a;
    for (i = 0; i < count; i += 8) {
        const __m256 x = _mm256_i32gather_ps(n[i], third, 4), y = _mm256_i32gather_ps(n[i] + 1, third, 4);
        const __m256 z = _mm256_i32gather_ps(n[i] + 2, third, 4);
        const __m256 side = _mm256_blendv_ps(_mm256_set1_ps(-1.0f), one, _mm256_cmp_ps(z, zero, _CMP_GE_OQ));
        const __m256 q = _mm256_div_ps(_mm256_set1_ps(-1.0f), _mm256_add_ps(side, z));
        const __m256 w = _mm256_mul_ps(_mm256_mul_ps(x, y), q);
        __m256 u[2], s, c, cosine, sine, d[3], at[3], bt[3], nn[3];
        float out[3][8];
        voxrti_sobol2_8(_mm256_loadu_si256((const __m256i *)(const void *)(index + i)),
                        _mm256_loadu_si256((const __m256i *)(const void *)(seed + i)), u);
        voxrti_turn8(u[0], &s, &c);
        cosine = _mm256_sqrt_ps(_mm256_sub_ps(one, u[1]));
        sine = _mm256_sqrt_ps(_mm256_max_ps(_mm256_sub_ps(one, _mm256_mul_ps(cosine, cosine)), zero));
        s = _mm256_mul_ps(s, sine);
        c = _mm256_mul_ps(c, sine);
        at[0] = _mm256_add_ps(one, _mm256_mul_ps(_mm256_mul_ps(_mm256_mul_ps(side, x), x), q));
        at[1] = _mm256_mul_ps(side, w);
        at[2] = _mm256_sub_ps(zero, _mm256_mul_ps(side, x));
        bt[0] = w;
        bt[1] = _mm256_add_ps(side, _mm256_mul_ps(_mm256_mul_ps(y, y), q));
        bt[2] = _mm256_sub_ps(zero, y);
        nn[0] = x;
        nn[1] = y;
        nn[2] = z;
        for (a = 0; a < 3; a++) {
            d[a] = _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(s, bt[a]), _mm256_mul_ps(c, at[a])),
                                 _mm256_mul_ps(cosine, nn[a]));
            _mm256_storeu_ps(out[a], d[a]);
        }
        for (j = 0; j < 8 && i + j < count; j++) for (a = 0; a < 3; a++) ray[i + j].dir[a] = out[a][j];
    }
}
#endif

/* Directions of rays over the hemispheres of n, with a density of the cosine: point index[i] of the sequence seed[i].
   index, n and seed have VOXRTI_COLUMN_BATCH entries. */
static void voxrti_cosine_rays(int isa, const uint32_t *index, const float (*n)[3], const uint32_t *seed,
                               uint32_t count, voxrt_ray *ray) {
    uint32_t i;
#if VOXRTI_AVX2
    if (isa >= VOXRT_ISA_AVX2) {
        voxrti_cosine_rays_avx2(index, n, seed, count, ray);
        return;
    }
#endif
    (void)isa;
    for (i = 0; i < count; i++) {
        float u[2];
        voxrti_sobol2(index[i], seed[i], u);
        (void)voxrti_lobe_direction(n[i], u, 1.0f, ray[i].dir);
    }
}

/* Direction of a ray in direction d after a mirror with normal n. */
VOXRTI_INLINE void voxrti_mirror(const float d[3], const float n[3], float out[3]) {
    const float twice = 2.0f * voxrti_dot3(d, n);
    uint32_t a;
    for (a = 0; a < 3; a++) out[a] = d[a] - twice * n[a];
}

/* The Phong lobe for light from `to` that leaves against `view`: (e + 2) / (2 pi) cos^e. All unit. */
VOXRTI_INLINE float voxrti_phong(const float view[3], const float n[3], const float to[3], float exponent) {
    float r[3], c;
    double power;
    voxrti_mirror(view, n, r);
    c = voxrti_dot3(r, to);
    if (!(c > 0.0f)) return 0.0f;
    power = (double)exponent * voxrti_log2((double)c);
    if (power < -120.0) return 0.0f; /* sharp ones go beyond what a power can be */
    return (exponent + 2.0f) * 0.159154943f * (float)voxrti_exp2(power);
}

/* ---- lamps: the caller's lights, and all surfaces that emit light as one more ---- */

VOXRTI_INLINE size_t voxrti_gi_lamps(const voxrt_gi *gi) { return gi->light_count + (gi->emitter_count != 0); }

/* Triangle of the emitters by u[0], by power; a point on it by the rest of u. Returns the triangle. */
static const voxrti_emitter *voxrti_gi_emitter(const voxrt_gi *gi, const float u[2], float p[3]) {
    const double total = gi->emitter[gi->emitter_count - 1].sum, want = (double)u[0] * total;
    size_t lo = 0, hi = gi->emitter_count - 1;
    const voxrti_emitter *e;
    double before, rest;
    float s, v;
    uint32_t a;
    while (lo < hi) {
        const size_t mid = (lo + hi) / 2;
        if (gi->emitter[mid].sum > want) hi = mid;
        else lo = mid + 1;
    }
    e = &gi->emitter[lo];
    before = lo != 0 ? gi->emitter[lo - 1].sum : 0.0;
    rest = (want - before) / (e->sum - before);
    s = sqrtf((float)(rest > 0.0 ? (rest < 1.0 ? rest : 1.0) : 0.0));
    v = u[1] * s;
    for (a = 0; a < 3; a++) p[a] = e->p[a] + (s - v) * e->u[a] + v * e->v[a];
    return e;
}

/* The way from a surface point to light `l`: a point of it by u, and what falls on the surface if nothing is between.
   0: nothing. The ray ends on the light: t_max = 1, or INFINITY. ends: normal of an emitting surface. */
static int voxrti_gi_light_ray(const voxrt_gi *gi, const voxrt_gi_light *l, const float p[3], const float n[3],
                               const float u[2], voxrt_ray *ray, float rgb[3], float ends[3]) {
    const voxrti_emitter *e = NULL;
    const float *color = l->color;
    float d[3], d2 = 0.0f, cosine, scale = 1.0f, at[3];
    uint32_t a;
    if ((uint32_t)l->kind == VOXRTI_GI_EMITTERS) {
        e = voxrti_gi_emitter(gi, u, at);
        color = e->rgb;
        memcpy(ends, e->n, 12);
    }
    for (a = 0; a < 3; a++) {
        d[a] = l->kind == VOXRT_GI_DIRECTIONAL ? 0.0f - l->direction[a] : (e != NULL ? at[a] : l->position[a]) - p[a];
        if (l->kind == VOXRT_GI_AREA) d[a] += l->edge_u[a] * (2.0f * u[0] - 1.0f) + l->edge_v[a] * (2.0f * u[1] - 1.0f);
        d2 += d[a] * d[a];
    }
    cosine = voxrti_dot3(d, n);
    if (!(cosine > 0.0f) || !(d2 < INFINITY)) return 0;
    if (l->kind != VOXRT_GI_DIRECTIONAL) {
        const float inv = 1.0f / sqrtf(d2), along = 0.0f - voxrti_dot3(d, e != NULL ? e->n : l->direction) * inv;
        scale = inv * inv * inv;
        if (l->kind == VOXRT_GI_SPOT) {
            double s, c;
            voxrti_sincos((double)l->angle * (3.14159265358979323846 / 180.0), &s, &c);
            if (!(along >= (float)c)) return 0;
        }
        if (l->kind == VOXRT_GI_AREA) {
            const float *f = l->edge_u, *g = l->edge_v;
            const float x = f[1] * g[2] - f[2] * g[1], y = f[2] * g[0] - f[0] * g[2], z = f[0] * g[1] - f[1] * g[0];
            if (!(along > 0.0f)) return 0;
            scale *= along * 4.0f * sqrtf(x * x + y * y + z * z);
        }
        if (e != NULL) {
            if (!(along > 0.0f)) return 0;
            scale *= along * (float)(gi->emitter[gi->emitter_count - 1].sum / (double)e->share);
        }
    }
    for (a = 0; a < 3; a++) {
        rgb[a] = color[a] * cosine * scale;
        ray->org[a] = p[a];
        ray->dir[a] = d[a];
    }
    ray->t_min = 0.0f;
    ray->t_max = l->kind == VOXRT_GI_DIRECTIONAL ? INFINITY : 1.0f;
    return rgb[0] + rgb[1] + rgb[2] > 0.0f && rgb[0] + rgb[1] + rgb[2] < INFINITY;
}

/* The same for emitters, number `index`: of VOXRTI_EMITTER_CHOICE points one by how much would come from it, for the
   ray to it costs more than looking at all (Talbot et al. 2005). */
#define VOXRTI_EMITTER_CHOICE 8
static int voxrti_emitter_ray(const voxrt_gi *gi, const float p[3], const float n[3], uint32_t index, uint32_t seed,
                              voxrt_ray *ray, float rgb[3], float ends[3]) {
    float sum = 0.0f, mine = 0.0f;
    uint32_t i, a;
    for (i = 0; i < VOXRTI_EMITTER_CHOICE; i++) {
        const uint32_t k = index * VOXRTI_EMITTER_CHOICE + i;
        float u[2], color[3], normal[3], y;
        voxrt_ray r;
        voxrti_sobol2(k, voxrti_hash32(seed), u);
        if (!voxrti_gi_light_ray(gi, &gi->emit, p, n, u, &r, color, normal)) continue;
        y = 0.2126f * color[0] + 0.7152f * color[1] + 0.0722f * color[2];
        sum += y;
        if ((float)(voxrti_hash32(seed ^ voxrti_hash32(k)) >> 8) * (1.0f / 16777216.0f) * sum > y) continue;
        mine = y;
        *ray = r;
        memcpy(rgb, color, 12);
        memcpy(ends, normal, 12);
    }
    if (!(mine > 0.0f)) return 0;
    for (a = 0; a < 3; a++) rgb[a] *= sum / (mine * (float)VOXRTI_EMITTER_CHOICE);
    return 1;
}

/* ---- maps of what lamps see ---- */

static void voxrti_gi_map_axes(const voxrt_gi_light *l, uint32_t face, float f[3], float u[3], float v[3]) {
    if (l->kind == VOXRT_GI_SPOT) {
        memcpy(f, l->direction, 12);
    } else {
        f[0] = f[1] = f[2] = 0.0f;
        f[face >> 1] = (face & 1u) ? -1.0f : 1.0f;
    }
    voxrti_tangents(f, u, v);
}

typedef struct voxrti_gi_map_work { const voxrt_gi *gi; size_t light; int isa; } voxrti_gi_map_work;

static void voxrti_task_gi_map(void *ctx, uint32_t row) {
    const voxrti_gi_map_work *w = (const voxrti_gi_map_work *)ctx;
    const voxrt_gi_light *l = &w->gi->light[w->light];
    const struct voxrti_gi_map *m = &w->gi->map[w->light];
    voxrt_ray ray[VOXRTI_COLUMN_BATCH];
    voxrt_column_hit hit[VOXRTI_COLUMN_BATCH];
    const voxrt_gi *where[VOXRTI_COLUMN_BATCH];
    float f[3], u[3], v[3];
    const float y = ((float)(int32_t)(row % m->side) + 0.5f) * 2.0f / (float)(int32_t)m->side - 1.0f;
    uint32_t x0, x, a;
    voxrti_gi_map_axes(l, row / m->side, f, u, v);
    for (x0 = 0; x0 < m->side; x0 += VOXRTI_COLUMN_BATCH) {
        const uint32_t n = m->side - x0 < VOXRTI_COLUMN_BATCH ? m->side - x0 : VOXRTI_COLUMN_BATCH;
        for (x = 0; x < n; x++) {
            const float s = ((float)(int32_t)(x0 + x) + 0.5f) * 2.0f / (float)(int32_t)m->side - 1.0f;
            for (a = 0; a < 3; a++) {
                ray[x].org[a] = l->position[a];
                ray[x].dir[a] = f[a] + m->tangent * (s * u[a] + y * v[a]);
            }
            ray[x].t_min = 0.0f;
            ray[x].t_max = INFINITY;
        }
        voxrti_gi_trace(w->gi, w->isa, NULL, NULL, ray, n, hit, where, NULL, NULL);
        for (x = 0; x < n; x++) {
            float *texel = m->texel + 6 * ((size_t)row * m->side + x0 + x), t;
            voxrti_gi_side s;
            memset(texel, 0, 24);
            if (!(hit[x].t < INFINITY) || !voxrti_gi_side_open(where[x], hit[x].cell[0], hit[x].cell[1], hit[x].cell[2],
                                                               ray[x].dir, &s)) continue;
            t = voxrti_gi_side_meet(&s, &ray[x], hit[x].t);
            for (a = 0; a < 3; a++) texel[a] = ray[x].org[a] + t * ray[x].dir[a];
            memcpy(texel + 3, s.normal, 12);
        }
    }
}

/* Does light reach p with normal n? It does if what the lamp sees in that direction is near: within a cell's diagonal
   or the width of a texel on its slant, at most 4 diagonals (thesis fig. 24). */
static int voxrti_gi_map_sees(const voxrt_gi *gi, size_t light, const float p[3], const float n[3]) {
    const voxrt_gi_light *l = &gi->light[light];
    const struct voxrti_gi_map *m = &gi->map[light];
    const float h = (float)gi->columns->diagonal;
    float d[3], f[3], u[3], v[3], x, y, z, slant, near_by, apart = 0.0f;
    const float *texel;
    uint32_t face = 0, a, ix, iy;
    for (a = 0; a < 3; a++) d[a] = p[a] - l->position[a];
    if (m->faces == 6) {
        for (a = 1; a < 3; a++) if (voxrti_absf(d[a]) > voxrti_absf(d[face])) face = a;
        face = 2 * face + (d[face] < 0.0f);
    }
    voxrti_gi_map_axes(l, face, f, u, v);
    z = voxrti_dot3(d, f);
    if (!(z > 0.0f)) return 0;
    x = (voxrti_dot3(d, u) / (z * m->tangent) + 1.0f) * 0.5f * (float)(int32_t)m->side;
    y = (voxrti_dot3(d, v) / (z * m->tangent) + 1.0f) * 0.5f * (float)(int32_t)m->side;
    if (!(x >= 0.0f && y >= 0.0f && x <= (float)(int32_t)m->side && y <= (float)(int32_t)m->side)) return 0;
    ix = (uint32_t)x < m->side ? (uint32_t)x : m->side - 1;
    iy = (uint32_t)y < m->side ? (uint32_t)y : m->side - 1;
    texel = m->texel + 6 * (((size_t)face * m->side + iy) * m->side + ix);
    if (!(voxrti_dot3(texel + 3, n) > 0.0f)) return 0;
    for (a = 0; a < 3; a++) {
        apart += (p[a] - texel[a]) * (p[a] - texel[a]);
        d[a] = texel[a] - l->position[a];
    }
    slant = 0.0f - voxrti_dot3(texel + 3, f);
    if (!(slant > 0.001f)) slant = 0.001f;
    near_by = 1.41421356f * 2.0f * voxrti_dot3(d, f) * m->tangent / ((float)(int32_t)m->side * slant);
    near_by = near_by > h ? near_by : h;
    near_by = near_by < 4.0f * h ? near_by : 4.0f * h;
    return apart <= near_by * near_by;
}

/* Points that send rays side by side. */
typedef struct voxrti_points {
    float p[VOXRTI_COLUMN_BATCH][3], n[VOXRTI_COLUMN_BATCH][3];
    float view[VOXRTI_COLUMN_BATCH][3], exponent[VOXRTI_COLUMN_BATCH]; /* unit, towards p; of a Phong lobe, or 0 */
    uint32_t seed[VOXRTI_COLUMN_BATCH], place[VOXRTI_COLUMN_BATCH], count; /* which samples are theirs */
    uint32_t share; /* log2 of how many a place has */
} voxrti_points;

/* Sample number s of a point: which point of which sequence. Points with one seed are places of one sequence, each has
   1 << share of its points; further ones are from the same places of another sequence. share 32: a sequence each. */
VOXRTI_INLINE void voxrti_point_sample(const voxrti_points *q, uint32_t i, uint32_t s, uint32_t *index,
                                       uint32_t *seed) {
    const uint32_t turn = q->share < 32 ? s >> q->share : 0;
    *index = q->share < 32 ? q->place[i] << q->share | (s & ((1u << q->share) - 1u)) : s;
    *seed = turn == 0 ? q->seed[i] : q->seed[i] ^ voxrti_hash32(turn);
}

/* How lamps light points. */
typedef struct voxrti_lighting {
    const voxrt_gi *gi;
    int isa, maps;
    const voxrt_geometry *shadow;  /* NULL: the columns */
    float lift;
    uint32_t first, samples;       /* on lamps that have an area */
} voxrti_lighting;

/* The light of a lamp on points: adds what falls on them to rgb, and what their lobes send along `view`, as if they
   were white, to gloss, unless it is NULL. */
static VOXRTI_NOINLINE void voxrti_light_points(const voxrti_lighting *c, size_t lamp, const voxrti_points *q,
                                                float (*rgb)[3], float (*gloss)[3]) {
    const voxrt_gi_light *l = lamp < c->gi->light_count ? &c->gi->light[lamp] : &c->gi->emit;
    voxrt_ray ray[VOXRTI_COLUMN_BATCH];
    float in[VOXRTI_COLUMN_BATCH][3], normal[VOXRTI_COLUMN_BATCH][3], end[VOXRTI_COLUMN_BATCH][3];
    const float *const ends = (uint32_t)l->kind == VOXRTI_GI_EMITTERS ? end[0] : NULL;
    uint8_t of[VOXRTI_COLUMN_BATCH], dark[VOXRTI_COLUMN_BATCH];
    const int wide = l->kind == VOXRT_GI_AREA || (uint32_t)l->kind == VOXRTI_GI_EMITTERS;
    const int map = c->maps && (l->kind == VOXRT_GI_POINT || l->kind == VOXRT_GI_SPOT);
    const uint32_t samples = wide ? c->samples : 1;
    const float share = 1.0f / (float)(int32_t)samples;
    uint32_t i, a, s, m;
    for (s = 0; s < samples; s++) {
        for (i = m = 0; i < q->count; i++) {
            float u[2] = {0.5f, 0.5f};
            uint32_t index = 0, seed = 0;
            if (wide) {
                voxrti_point_sample(q, i, c->first + s, &index, &seed);
                voxrti_sobol2(index, voxrti_hash32(seed), u);
            }
            if ((uint32_t)l->kind == VOXRTI_GI_EMITTERS) {
                if (!voxrti_emitter_ray(c->gi, q->p[i], q->n[i], index, seed, &ray[m], in[m], end[m])) continue;
            } else if (!voxrti_gi_light_ray(c->gi, l, q->p[i], q->n[i], u, &ray[m], in[m], end[m])) continue;
            memcpy(normal[m], q->n[i], sizeof normal[m]);
            for (a = 0; a < 3 && c->shadow != NULL; a++) { /* from a little above the surface to the light */
                const float up = c->lift * q->n[i][a];
                ray[m].org[a] += up;
                if (ray[m].t_max < INFINITY) ray[m].dir[a] -= up;
                if (ends != NULL) ray[m].dir[a] += c->lift * end[m][a];
            }
            if (c->shadow != NULL && ray[m].t_max < INFINITY) ray[m].t_max *= 0.9999f;
            of[m++] = (uint8_t)i;
        }
        if (m == 0) continue;
        if (map) {
            for (i = 0; i < m; i++) dark[i] = !voxrti_gi_map_sees(c->gi, lamp, q->p[of[i]], q->n[of[i]]);
        } else if (c->shadow != NULL) {
            voxrt_trace_desc d;
            memset(&d, 0, sizeof d);
            d.isa = (voxrt_isa)c->isa;
            memset(dark, 0, sizeof dark);
            c->shadow->occluded_fn(c->shadow->user, &d, ray, dark, m);
        } else {
            voxrti_gi_trace(c->gi, c->isa, normal[0], ends, ray, m, NULL, NULL, dark, NULL);
        }
        for (i = 0; i < m; i++) {
            const uint32_t k = of[i];
            if (dark[i]) continue;
            for (a = 0; a < 3; a++) rgb[k][a] += in[i][a] * share;
            if (gloss != NULL && q->exponent[k] > 0.0f && voxrti_normalize(ray[i].dir)) {
                const float f = voxrti_phong(q->view[k], q->n[k], ray[i].dir, q->exponent[k]) * share;
                for (a = 0; a < 3; a++) gloss[k][a] += in[i][a] * f;
            }
        }
    }
}

#define VOXRTI_GI_AREA_SAMPLES 4     /* for the cache: it is looked at many times */

/* Make sure the direct light on these sides is known. Two threads may find it out at once: they find the same. */
static void voxrti_gi_fill(const voxrt_gi *gi, int isa, const voxrti_gi_side *side, uint32_t count) {
    voxrti_lighting c;
    voxrti_points q;
    float rgb[VOXRTI_COLUMN_BATCH][3];
    uint8_t of[VOXRTI_COLUMN_BATCH];
    uint32_t i, k, m = 0;
    size_t l;
    for (i = 0; i < count; i++) {
        const voxrti_gi_side *s = &side[i];
        if (s->at == (size_t)-1) continue;
        if (voxrti_load_shared(&s->gi->layer[s->layer].direct[s->at]) != VOXRTI_GI_UNKNOWN) continue;
        for (k = 0; k < m; k++)
            if (side[of[k]].at == s->at && side[of[k]].layer == s->layer && side[of[k]].gi == s->gi) break;
        if (k < m) continue;
        memcpy(q.p[m], s->position, sizeof q.p[m]);
        memcpy(q.n[m], s->normal, sizeof q.n[m]);
        memset(rgb[m], 0, sizeof rgb[m]);
        q.exponent[m] = 0.0f;
        q.seed[m] = voxrti_hash32((uint32_t)s->at ^ s->layer << 31);
        of[m++] = (uint8_t)i;
    }
    if (m == 0) return;
    q.count = m;
    q.share = 32;
    memset(&c, 0, sizeof c);
    c.gi = gi;
    c.isa = isa;
    for (l = 0; l < voxrti_gi_lamps(gi); l++) {
        c.samples = VOXRTI_GI_AREA_SAMPLES;
        voxrti_light_points(&c, l, &q, rgb, NULL);
    }
    for (i = 0; i < m; i++)
        voxrti_store_shared(&side[of[i]].gi->layer[side[of[i]].layer].direct[side[of[i]].at], voxrti_rgb9e5(rgb[i]));
}

/* What a side sends out by light that was there before: (direct + bounced) * albedo / pi. A Phong lobe sends bounced
   light on as if it were diffuse. Without direct light it need not be known. Emission is a lamp's. */
VOXRTI_INLINE void voxrti_gi_radiance(const voxrti_gi_side *s, int with_direct, int with_bounces, float rgb[3]) {
    const voxrti_gi_layer *l = &s->gi->layer[s->layer];
    const voxrti_gi_entry *e = voxrti_gi_side_entry(s);
    const uint32_t known = l->bounce[s->at];
    float direct[3] = {0.0f, 0.0f, 0.0f}, more[3] = {0.0f, 0.0f, 0.0f};
    uint32_t a;
    if (with_direct) voxrti_rgb9e5_decode(voxrti_load_shared(&l->direct[s->at]), direct);
    if (with_bounces && known != VOXRTI_GI_UNKNOWN) voxrti_rgb9e5_decode(known, more);
    for (a = 0; a < 3; a++)
        rgb[a] = (direct[a] * s->albedo[a] + more[a] * (s->albedo[a] + e->specular[a])) * 0.318309886f;
}

VOXRT_DEF int voxrt_gi_get(const voxrt_gi *gi, const voxrt_column_hit *hit, const float dir[3],
                           voxrt_gi_surface *out_surface) {
    voxrti_gi_side s;
    uint32_t a;
    memset(out_surface, 0, sizeof *out_surface);
    if (gi == NULL || hit == NULL || hit->cell[0] >= gi->columns->size[0] || hit->cell[1] >= gi->columns->size[1] ||
        hit->cell[2] >= gi->columns->size[2] || !voxrti_gi_side_open(gi, hit->cell[0], hit->cell[1], hit->cell[2], dir,
                                                                     &s))
        return 0;
    voxrti_gi_fill(gi, (int)voxrt_isa_best(), &s, 1);
    memcpy(out_surface->position, s.position, sizeof s.position);
    memcpy(out_surface->normal, s.normal, sizeof s.normal);
    memcpy(out_surface->albedo, s.albedo, sizeof s.albedo);
    voxrti_gi_radiance(&s, 1, 1, out_surface->radiance);
    for (a = 0; a < 3; a++) out_surface->radiance[a] += voxrti_gi_side_entry(&s)->emission[a];
    out_surface->object = gi->layer[s.layer].record[s.at >> 1].object[s.at & 1u];
    return 1;
}

/* ---------------------------------------------------------------------------
   gather: light that comes from other surfaces; pictures from G-buffers.       // >>gather
   --------------------------------------------------------------------------- */

typedef struct voxrti_gather {
    const voxrt_gi_render_desc *d;
    const voxrt_gi *gi;            /* the innermost volume */
    const voxrt_gbuffer *g;
    float *direct, *direct_gloss;  /* irradiance / pi; what lobes send, as if they were white. NULL: not wanted */
    float *indirect, *gloss;
    float *half[2];                /* indirect as two independent sums; NULL: indirect itself */
    float *apart;                  /* 1 / harmonic mean distance of what rays hit, or NULL */
    uint32_t *lit;                 /* VPL, coarse: 128 bits for each pixel, which lights reach it */
    uint8_t *state;                /* coarse: 0 nothing there, 1 interpolated, 2 sends rays */
    uint32_t *list;                /* pixels that do, in runs of VOXRTI_COLUMN_BATCH; VOXRTI_NO_PIXEL fills up */
    size_t list_count;
    uint32_t rays, bounces, first, which; /* of this pass; which: 0, 1 half, 2 indirect itself */
    uint32_t seed, set;            /* set: pixels in VPL's pattern */
    uint32_t share, direct_share;  /* of voxrti_gather_open: indirect, direct light */
    float radius;
    int isa;
    voxrti_frame frame;
    uint32_t sum[3][2]; /* tallies: rays, hits, steps */
    uint32_t want_stats, from;     /* from: first run of the list that is worked on */
    uint64_t done, total;          /* for env.progress_fn: pixels times rays; total is the most */
} voxrti_gather;

#define VOXRTI_NO_PIXEL 0xffffffffu

/* A ray that grazes the surface it starts on can meet cells of that whose surface faces away from it: where the surface
   curves away from its tangent plane, and where cells stick out at edges. As near as this, in cell diagonals, it goes
   on; farther away what faces away is dark. */
#define VOXRTI_GATHER_SELF 16.0f

/* Sample `number` of each point: a ray over its hemisphere with density cos, or, where it has a lobe, in that: what it
   meets. weight: what its light counts for the mean. t of a miss is INFINITY; a hit that shows no side has at =
   -1. */
static void voxrti_gather_rays(const voxrti_gather *w, const voxrti_points *q, uint32_t number, voxrt_ray *ray,
                               float *t, voxrti_gi_side *side, float *weight, voxrt_stats *stats) {
    voxrt_column_hit hit[VOXRTI_COLUMN_BATCH];
    uint32_t index[VOXRTI_COLUMN_BATCH], seed[VOXRTI_COLUMN_BATCH];
    const voxrt_gi *where[VOXRTI_COLUMN_BATCH];
    size_t of[VOXRTI_COLUMN_BATCH];
    uint8_t layer[VOXRTI_COLUMN_BATCH], from[VOXRTI_COLUMN_BATCH];
    voxrt_ray again[VOXRTI_COLUMN_BATCH];
    float normal[VOXRTI_COLUMN_BATCH][3];
    uint32_t i, j, a, more = 0, still, turn;
    memset(hit, 0, sizeof hit);
    memset(index, 0, sizeof index);
    memset(seed, 0, sizeof seed);
    for (i = 0; i < q->count; i++) voxrti_point_sample(q, i, number, &index[i], &seed[i]);
    voxrti_cosine_rays(w->isa, index, q->n, seed, q->count, ray);
    for (i = 0; i < q->count; i++) {
        weight[i] = 1.0f;
        ray[i].t_min = 0.0f;
        ray[i].t_max = w->radius;
        if (q->exponent[i] > 0.0f) { /* below the horizon: nothing, but it counts */
            float axis[3], cosine, u[2];
            voxrti_sobol2(index[i], seed[i], u);
            voxrti_mirror(q->view[i], q->n[i], axis);
            (void)voxrti_lobe_direction(axis, u, q->exponent[i] == 1.0f ? 1.0f : q->exponent[i], ray[i].dir);
            cosine = voxrti_dot3(ray[i].dir, q->n[i]);
            weight[i] = cosine > 0.0f ? cosine * (q->exponent[i] + 2.0f) / (q->exponent[i] + 1.0f) : 0.0f;
            if (!(cosine > 0.0f)) ray[i].t_max = -1.0f;
        }
        for (a = 0; a < 3; a++) ray[i].org[a] = q->p[i][a];
    }
    voxrti_gi_trace(w->gi, w->isa, q->n[0], NULL, ray, q->count, hit, where, NULL, stats);
    voxrti_gi_find_all(w->isa, where, hit, q->count, of, layer);
    for (i = 0; i < q->count; i++) {
        t[i] = hit[i].t;
        side[i].at = (size_t)-1;
        if (!(hit[i].t < INFINITY)) continue;
        if (voxrti_gi_side_see(where[i], of[i], layer[i], hit[i].cell, ray[i].dir, &side[i])) continue;
        if (t[i] > VOXRTI_GATHER_SELF * (float)where[i]->columns->diagonal) continue;
        again[more] = ray[i];
        again[more].t_min = t[i] + 0.5f * (float)where[i]->columns->diagonal;
        memcpy(normal[more], q->n[i], sizeof normal[more]);
        from[more++] = (uint8_t)i;
    }
    for (turn = 0; turn < 4 && more != 0; turn++) {
        voxrti_gi_trace(w->gi, w->isa, normal[0], NULL, again, more, hit, where, NULL, stats);
        voxrti_gi_find_all(w->isa, where, hit, more, of, layer);
        for (j = still = 0; j < more; j++) {
            i = from[j];
            t[i] = hit[j].t;
            if (!(hit[j].t < INFINITY)) continue;
            if (voxrti_gi_side_see(where[j], of[j], layer[j], hit[j].cell, ray[i].dir, &side[i])) continue;
            if (t[i] > VOXRTI_GATHER_SELF * (float)where[j]->columns->diagonal) continue;
            again[still] = again[j];
            again[still].t_min = t[i] + 0.5f * (float)where[j]->columns->diagonal;
            memcpy(normal[still], normal[j], sizeof normal[still]);
            from[still++] = (uint8_t)i;
        }
        more = still;
    }
}

/* What comes back along rays from the sides they hit; 0 where at = -1. */
static VOXRTI_NOINLINE void voxrti_hit_light(const voxrti_gather *w, const voxrti_gi_side *side, const voxrt_ray *ray,
                                             const float *t, uint32_t count, int with_bounces, float (*out)[3]) {
    const int cached = w->d->lookup == VOXRT_GI_LOOKUP_CACHE || w->d->lookup == VOXRT_GI_LOOKUP_VOLUME;
    voxrti_points q;
    voxrti_lighting c;
    float rgb[VOXRTI_COLUMN_BATCH][3], gloss[VOXRTI_COLUMN_BATCH][3];
    uint8_t of[VOXRTI_COLUMN_BATCH];
    uint32_t i, a;
    size_t l;
    if (cached) voxrti_gi_fill(w->gi, w->isa, side, count);
    q.count = 0;
    q.share = 32;
    for (i = 0; i < count; i++) {
        const uint32_t m = q.count;
        const voxrti_gi_entry *e;
        memset(out[i], 0, 12);
        if (side[i].at == (size_t)-1) continue;
        voxrti_gi_radiance(&side[i], cached, with_bounces, out[i]);
        e = voxrti_gi_side_entry(&side[i]);
        if (cached && !(e->specular[3] > 0.0f)) continue; /* lobes look at the light anew */
        memcpy(q.p[m], side[i].position, 12);
        for (a = 0; a < 3 && !cached; a++)
            q.p[m][a] = ray[i].org[a] + voxrti_gi_side_meet(&side[i], &ray[i], t[i]) * ray[i].dir[a];
        memcpy(q.n[m], side[i].normal, 12);
        memcpy(q.view[m], ray[i].dir, 12);
        q.exponent[m] = e->specular[3];
        q.seed[m] = voxrti_hash32((uint32_t)side[i].at + i);
        of[m] = (uint8_t)i;
        q.count++;
    }
    if (q.count == 0) return;
    memset(rgb, 0, sizeof rgb);
    memset(gloss, 0, sizeof gloss);
    memset(&c, 0, sizeof c);
    c.gi = w->gi;
    c.isa = w->isa;
    c.maps = w->d->lookup == VOXRT_GI_LOOKUP_MAPS;
    c.samples = 1;
    c.first = w->first;
    for (l = 0; l < voxrti_gi_lamps(w->gi); l++) voxrti_light_points(&c, l, &q, rgb, gloss);
    for (i = 0; i < q.count; i++) {
        const voxrti_gi_side *s = &side[of[i]];
        const float *specular = voxrti_gi_side_entry(s)->specular;
        for (a = 0; a < 3; a++)
            out[of[i]][a] += (cached ? 0.0f : rgb[i][a] * s->albedo[a] * 0.318309886f) + gloss[i][a] * specular[a];
    }
}

/* At the end of a ray: which lobe does the path leave by? By their brightness. Changes part, and the point's lobe. */
static void voxrti_gather_turn(const voxrti_gi_side *s, const float dir[3], uint32_t seed, voxrti_points *at,
                               uint32_t m, float part[3]) {
    const float *specular = voxrti_gi_side_entry(s)->specular;
    float shine = specular[0] + specular[1] + specular[2], all;
    uint32_t a;
    at->exponent[m] = 0.0f;
    memcpy(at->view[m], dir, 12);
    if (!(specular[3] > 0.0f && shine > 0.0f)) {
        for (a = 0; a < 3; a++) part[a] *= s->albedo[a];
        return;
    }
    all = shine + s->albedo[0] + s->albedo[1] + s->albedo[2];
    if ((float)(voxrti_hash32(seed) >> 8) * (1.0f / 16777216.0f) * all < shine) {
        at->exponent[m] = specular[3];
        for (a = 0; a < 3; a++) part[a] *= specular[a] * all / shine;
    } else {
        for (a = 0; a < 3; a++) part[a] *= s->albedo[a] * all / (all - shine);
    }
}

/* Adds for each point: what comes back along w->rays rays, times weights and colours on the way; apart, unless NULL:
   the sum of 1 / t. */
static VOXRTI_NOINLINE void voxrti_gather_run(const voxrti_gather *w, const voxrti_points *q, float (*out)[3],
                                              float *apart, voxrt_stats *stats) {
    voxrt_ray ray[VOXRTI_COLUMN_BATCH];
    voxrti_gi_side side[VOXRTI_COLUMN_BATCH];
    float t[VOXRTI_COLUMN_BATCH], part[VOXRTI_COLUMN_BATCH][3], rgb[VOXRTI_COLUMN_BATCH][3];
    float weight[VOXRTI_COLUMN_BATCH];
    uint8_t of[VOXRTI_COLUMN_BATCH];
    voxrti_points at;
    uint32_t r, b, i, a, m;
    memset(of, 0, sizeof of);
    memset(part, 0, sizeof part);
    memset(ray, 0, sizeof ray);
    memset(side, 0, sizeof side);
    for (i = 0; i < VOXRTI_COLUMN_BATCH; i++) {
        side[i].gi = w->gi;
        side[i].at = (size_t)-1;
    }
    memset(t, 0, sizeof t);
    memset(weight, 0, sizeof weight);
    memset(rgb, 0, sizeof rgb);
    for (r = 0; r < w->rays; r++) {
        at = *q;
        for (i = 0; i < at.count; i++) {
            of[i] = (uint8_t)i;
            part[i][0] = part[i][1] = part[i][2] = 1.0f;
        }
        for (b = 0; b < w->bounces && at.count != 0; b++) {
            voxrti_gather_rays(w, &at, w->first + r, ray, t, side, weight, stats);
            for (i = 0; i < at.count && b == 0 && apart != NULL; i++)
                if (t[i] < INFINITY) apart[i] += 1.0f / (t[i] + 1e-20f);
            if (w->d->method == VOXRT_GI_AO) {
                for (i = 0; i < at.count; i++)
                    for (a = 0; a < 3 && !(t[i] < INFINITY); a++) out[i][a] += weight[i];
                break;
            }
            voxrti_hit_light(w, side, ray, t, at.count, w->d->method == VOXRT_GI_GATHER, rgb);
            for (i = m = 0; i < at.count; i++) { /* those that go on move up */
                float now[3];
                if (side[i].at == (size_t)-1) continue;
                for (a = 0; a < 3; a++) {
                    now[a] = part[i][a] * weight[i];
                    out[of[i]][a] += rgb[i][a] * now[a];
                }
                at.seed[m] = voxrti_hash32(at.seed[i] + 0x9e3779b9u);
                at.place[m] = at.place[i];
                voxrti_gather_turn(&side[i], ray[i].dir, (at.seed[m] ^ voxrti_hash32(at.place[m])) + w->first + r, &at,
                                   m, now);
                memcpy(part[m], now, sizeof now);
                memcpy(at.p[m], side[i].position, sizeof at.p[m]);
                memcpy(at.n[m], side[i].normal, sizeof at.n[m]);
                of[m++] = of[i];
            }
            at.count = m;
        }
    }
}

/* ---- virtual point lights: where light falls, `bounces` times; each pixel sees one set of them ---- */

typedef struct voxrti_vpl {
    float p[3], n[3], view[3];         /* view: of the light that came */
    float flux[3];                     /* that came, for each pixel's share; 0: not valid, it left the scene */
    float albedo[3], specular[4];
} voxrti_vpl;

typedef struct voxrti_vpl_work {
    voxrti_gather *w;
    size_t first, count;               /* of this bounce */
    uint32_t level;
    float power;                       /* sum over lamps of their flux */
} voxrti_vpl_work;

/* Flux of a lamp into the scene. A directional one: through the ball around the box. */
static float voxrti_vpl_power(const voxrt_gi *gi, size_t lamp, float rgb[3]) {
    const voxrt_gi_light *l = lamp < gi->light_count ? &gi->light[lamp] : &gi->emit;
    float scale = 12.5663706f, b[3];
    uint32_t a;
    if (l->kind == VOXRT_GI_SPOT) {
        double s, c;
        voxrti_sincos((double)l->angle * (3.14159265358979323846 / 180.0), &s, &c);
        scale = 6.28318531f * (1.0f - (float)c);
    }
    if (l->kind == VOXRT_GI_DIRECTIONAL) {
        for (a = 0, scale = 0.0f; a < 3; a++) scale += (gi->hi[a] - gi->lo[a]) * (gi->hi[a] - gi->lo[a]);
        scale *= 0.25f * 3.14159265f;
    }
    if (l->kind == VOXRT_GI_AREA) {
        for (a = 0; a < 3; a++)
            b[a] = l->edge_u[(a + 1) % 3] * l->edge_v[(a + 2) % 3] - l->edge_u[(a + 2) % 3] * l->edge_v[(a + 1) % 3];
        scale = 3.14159265f * 4.0f * sqrtf(voxrti_dot3(b, b));
    }
    if ((uint32_t)l->kind == VOXRTI_GI_EMITTERS) scale = 3.14159265f * (float)gi->emitter[gi->emitter_count - 1].sum;
    for (a = 0; a < 3; a++) rgb[a] = (uint32_t)l->kind == VOXRTI_GI_EMITTERS ? scale : l->color[a] * scale;
    return 0.2126f * rgb[0] + 0.7152f * rgb[1] + 0.0722f * rgb[2];
}

/* A ray of light number i of `count` from the lamps, and its flux times count. normal: of the surface it starts on. */
static void voxrti_vpl_start(const voxrti_vpl_work *v, uint32_t i, voxrt_ray *ray, float flux[3], float normal[3]) {
    const voxrt_gi *gi = v->w->gi;
    const voxrt_gi_light *l;
    float u[2], s[2], pick, power = 0.0f, p = 0.0f, cosine;
    size_t lamp;
    uint32_t a;
    voxrti_sobol2(i, 0x51ed270bu, u);
    voxrti_sobol2(i, 0x2c1b3c6du, s);
    pick = s[0] * v->power;
    for (lamp = 0; lamp + 1 < voxrti_gi_lamps(gi); lamp++) {
        p = voxrti_vpl_power(gi, lamp, flux);
        if (power + p > pick) break;
        power += p;
    }
    p = voxrti_vpl_power(gi, lamp, flux);
    l = lamp < gi->light_count ? &gi->light[lamp] : &gi->emit;
    for (a = 0; a < 3; a++) flux[a] = p > 0.0f ? flux[a] * v->power / p : 0.0f;
    memcpy(ray->org, l->position, 12);
    ray->t_min = 0.0f;
    ray->t_max = INFINITY;
    if (l->kind == VOXRT_GI_POINT) { /* uniform over the sphere, the cap: the flux of all is the same */
        static const float up[3] = {0, 0, 1};
        voxrti_around(up, u[0], 1.0f - 2.0f * u[1], ray->dir);
    } else if (l->kind == VOXRT_GI_SPOT) {
        double sine, c;
        voxrti_sincos((double)l->angle * (3.14159265358979323846 / 180.0), &sine, &c);
        cosine = 1.0f - u[1] * (1.0f - (float)c);
        voxrti_around(l->direction, u[0], cosine, ray->dir);
    } else if (l->kind == VOXRT_GI_AREA) {
        float q[2];
        voxrti_sobol2(i, 0x7a4f92c1u, q);
        for (a = 0; a < 3; a++)
            ray->org[a] += l->edge_u[a] * (2.0f * q[0] - 1.0f) + l->edge_v[a] * (2.0f * q[1] - 1.0f);
        (void)voxrti_lobe_direction(l->direction, u, 1.0f, ray->dir);
    } else if (l->kind == VOXRT_GI_DIRECTIONAL) { /* through a disc in front of the ball around the box */
        float x[3], y[3], radius = 0.0f, si, co, r = sqrtf(u[1]);
        voxrti_tangents(l->direction, x, y);
        voxrti_turn(u[0], &si, &co);
        for (a = 0; a < 3; a++) radius += 0.25f * (gi->hi[a] - gi->lo[a]) * (gi->hi[a] - gi->lo[a]);
        radius = sqrtf(radius);
        for (a = 0; a < 3; a++) {
            ray->org[a] = 0.5f * (gi->lo[a] + gi->hi[a]) + radius * (r * (co * x[a] + si * y[a]) - l->direction[a]);
            ray->dir[a] = l->direction[a];
        }
    } else { /* a surface */
        float q[2];
        const voxrti_emitter *e;
        voxrti_sobol2(i, 0x7a4f92c1u, q);
        e = voxrti_gi_emitter(gi, q, ray->org);
        (void)voxrti_lobe_direction(e->n, u, 1.0f, ray->dir);
        for (a = 0; a < 3; a++) flux[a] *= e->rgb[a] / e->share;
        memcpy(normal, e->n, 12);
    }
}

static void voxrti_task_vpl(void *ctx, uint32_t batch) {
    const voxrti_vpl_work *v = (const voxrti_vpl_work *)ctx;
    const voxrti_gather *w = v->w;
    voxrt_ray ray[VOXRTI_COLUMN_BATCH];
    voxrt_column_hit hit[VOXRTI_COLUMN_BATCH];
    const voxrt_gi *where[VOXRTI_COLUMN_BATCH];
    float flux[VOXRTI_COLUMN_BATCH][3], normal[VOXRTI_COLUMN_BATCH][3];
    const size_t first = (size_t)batch * VOXRTI_COLUMN_BATCH;
    const uint32_t n = (uint32_t)(v->count - first < VOXRTI_COLUMN_BATCH ? v->count - first : VOXRTI_COLUMN_BATCH);
    uint32_t i, a;
    if (n == 0) return;
    memset(ray, 0, sizeof ray);
    memset(normal, 0, sizeof normal);
    for (i = 0; i < n; i++) {
        if (v->level == 0) {
            voxrti_vpl_start(v, (uint32_t)(first + i), &ray[i], flux[i], normal[i]);
            for (a = 0; a < 3; a++) flux[i][a] *= 1.0f / (float)(int32_t)w->d->rays;
        } else { /* from the light before: diffuse, or in its lobe */
            const voxrti_vpl *from = &w->gi->vpl[v->first - v->count + first + i];
            const float shine = from->specular[0] + from->specular[1] + from->specular[2];
            const float all = shine + from->albedo[0] + from->albedo[1] + from->albedo[2];
            float u[2], s[2], cosine, k;
            voxrti_sobol2((uint32_t)(first + i), 0x1b873593u * v->level, u);
            voxrti_sobol2((uint32_t)(first + i), 0x85ebca6bu * v->level, s);
            memcpy(ray[i].org, from->p, 12);
            memcpy(normal[i], from->n, 12);
            ray[i].t_min = 0.0f;
            ray[i].t_max = INFINITY;
            if (s[0] * all < shine) {
                float axis[3];
                voxrti_mirror(from->view, from->n, axis);
                (void)voxrti_lobe_direction(axis, u, from->specular[3], ray[i].dir);
                cosine = voxrti_dot3(ray[i].dir, from->n);
                k = cosine * (from->specular[3] + 2.0f) / (from->specular[3] + 1.0f) * all / shine;
                k = k > 0.0f ? k : 0.0f;
                for (a = 0; a < 3; a++) flux[i][a] = from->flux[a] * from->specular[a] * k;
            } else {
                (void)voxrti_lobe_direction(from->n, u, 1.0f, ray[i].dir);
                k = all > shine ? all / (all - shine) : 0.0f;
                for (a = 0; a < 3; a++) flux[i][a] = from->flux[a] * from->albedo[a] * k;
            }
            if (!(flux[i][0] + flux[i][1] + flux[i][2] > 0.0f)) ray[i].t_max = -1.0f;
        }
    }
    voxrti_gi_trace(w->gi, w->isa, normal[0], NULL, ray, n, hit, where, NULL, NULL);
    for (i = 0; i < n; i++) {
        voxrti_vpl *to = &w->gi->vpl[v->first + first + i];
        voxrti_gi_side s;
        memset(to, 0, sizeof *to);
        if (!(hit[i].t < INFINITY) || !voxrti_gi_side_open(where[i], hit[i].cell[0], hit[i].cell[1], hit[i].cell[2],
                                                           ray[i].dir, &s)) continue;
        {
            const float t = voxrti_gi_side_meet(&s, &ray[i], hit[i].t);
            for (a = 0; a < 3; a++) to->p[a] = ray[i].org[a] + t * ray[i].dir[a];
        }
        memcpy(to->n, s.normal, 12);
        memcpy(to->view, ray[i].dir, 12);
        (void)voxrti_normalize(to->view);
        memcpy(to->flux, flux[i], 12);
        memcpy(to->albedo, s.albedo, 12);
        memcpy(to->specular, voxrti_gi_side_entry(&s)->specular, 16);
    }
}

static voxrt_result voxrti_vpl_make(voxrti_gather *w, voxrt_gi *gi) {
    const size_t each = (size_t)w->d->rays * w->set * w->set, n = each * w->bounces;
    voxrti_vpl_work v;
    size_t l;
    gi->vpl_count = 0;
    memset(&v, 0, sizeof v);
    v.w = w;
    for (l = 0; l < voxrti_gi_lamps(gi); l++) {
        float rgb[3];
        v.power += voxrti_vpl_power(gi, l, rgb);
    }
    if (!(v.power > 0.0f) || !voxrti_finite_f(v.power)) return VOXRT_OK;
    if (n > gi->vpl_capacity) {
        voxrti_free(&gi->mem, gi->vpl);
        gi->vpl_capacity = 0;
        gi->vpl = (voxrti_vpl *)voxrti_alloc_array(&gi->mem, n, sizeof *gi->vpl);
        if (gi->vpl == NULL)
            return voxrti_fail(w->d->env.error, VOXRT_ERR_NO_MEMORY, n, "no memory for % virtual lights");
        gi->vpl_capacity = n;
    }
    v.count = each;
    for (; v.level < w->bounces; v.level++, v.first += each)
        voxrti_parallel_for(&w->d->env, voxrti_task_vpl, &v,
                            (uint32_t)((each + VOXRTI_COLUMN_BATCH - 1) / VOXRTI_COLUMN_BATCH));
    gi->vpl_count = n;
    return VOXRT_OK;
}

VOXRT_DEF size_t voxrt_gi_virtual_lights(const voxrt_gi *gi, float *out, size_t most) {
    size_t i;
    uint32_t a;
    if (gi == NULL) return 0;
    for (i = 0; i < gi->vpl_count && i < most; i++)
        for (a = 0; a < 3; a++) {
            out[9 * i + a] = gi->vpl[i].p[a];
            out[9 * i + 3 + a] = gi->vpl[i].n[a];
            out[9 * i + 6 + a] = gi->vpl[i].flux[a];
        }
    return gi->vpl_count;
}

/* The lights of set `set` on points: adds irradiance / pi to out, what white lobes send to gloss. lit: which do. */
static VOXRTI_NOINLINE void voxrti_vpl_run(const voxrti_gather *w, const voxrti_points *q, uint32_t set,
                                           float (*out)[3], float (*gloss)[3], uint32_t (*lit)[4], voxrt_stats *stats) {
    const voxrt_gi *gi = w->gi;
    const size_t each = (size_t)w->d->rays * w->set * w->set;
    const float h = 4.0f * (float)gi->columns->diagonal, bound = 1.0f / (h * h);
    voxrt_ray ray[VOXRTI_COLUMN_BATCH];
    float scale[VOXRTI_COLUMN_BATCH], normal[VOXRTI_COLUMN_BATCH][3], end[VOXRTI_COLUMN_BATCH][3];
    uint8_t of[VOXRTI_COLUMN_BATCH], dark[VOXRTI_COLUMN_BATCH];
    uint32_t b, r, i, a, m;
    for (b = 0; b < w->bounces; b++)
        for (r = 0; r < w->d->rays; r++) {
            const voxrti_vpl *l = &gi->vpl[b * each + (size_t)set * w->d->rays + r];
            if (!(l->flux[0] + l->flux[1] + l->flux[2] > 0.0f)) continue;
            for (i = m = 0; i < q->count; i++) {
                float to[3], d2, c1, c2, inv, term;
                for (a = 0; a < 3; a++) to[a] = l->p[a] - q->p[i][a];
                d2 = voxrti_dot3(to, to);
                if (!(d2 > 0.0f) || d2 > w->radius * w->radius) continue;
                c1 = voxrti_dot3(to, q->n[i]);
                c2 = 0.0f - voxrti_dot3(to, l->n);
                if (!(c1 > 0.0f && c2 > 0.0f)) continue;
                inv = 1.0f / d2;
                if (w->d->d_min > 0.0f) {
                    term = c1 * c2 * inv / (w->d->d_min + d2);
                } else {
                    term = c1 * c2 * inv * inv;
                    term = term < bound ? term : bound;
                }
                scale[m] = term;
                memcpy(ray[m].org, q->p[i], 12);
                memcpy(ray[m].dir, to, 12);
                ray[m].t_min = 0.0f;
                ray[m].t_max = 1.0f;
                memcpy(normal[m], q->n[i], 12);
                memcpy(end[m], l->n, 12);
                of[m++] = (uint8_t)i;
            }
            if (m == 0) continue;
            voxrti_gi_trace(gi, w->isa, normal[0], end[0], ray, m, NULL, NULL, dark, stats);
            for (i = 0; i < m; i++) {
                const uint32_t k = of[i];
                float to[3] = {0, 0, 0}, from[3], shine = 0.0f;
                if (dark[i]) continue;
                lit[k][(b * w->d->rays + r) >> 5 & 3u] |= 1u << ((b * w->d->rays + r) & 31u);
                if (l->specular[3] > 0.0f || (gloss != NULL && q->exponent[k] > 0.0f)) {
                    const float one = 1.0f / sqrtf(voxrti_dot3(ray[i].dir, ray[i].dir));
                    for (a = 0; a < 3; a++) {
                        to[a] = ray[i].dir[a] * one;
                        from[a] = 0.0f - to[a];
                    }
                    if (l->specular[3] > 0.0f) shine = voxrti_phong(l->view, l->n, from, l->specular[3]);
                }
                for (a = 0; a < 3; a++) {
                    const float e = l->flux[a] * (l->albedo[a] * 0.318309886f + l->specular[a] * shine) * scale[i];
                    out[k][a] += e * 0.318309886f;
                    if (gloss != NULL && q->exponent[k] > 0.0f)
                        gloss[k][a] += e * voxrti_phong(q->view[k], q->n[k], to, q->exponent[k]);
                }
            }
        }
}

/* What the bound cut off, by rays as short as that (Kollig & Keller 2004): adds irradiance / pi; apart as
   voxrti_gather_run. */
static VOXRTI_NOINLINE void voxrti_vpl_compensate(const voxrti_gather *w, const voxrti_points *q, float (*out)[3],
                                                  float *apart, voxrt_stats *stats) {
    const float h = 4.0f * (float)w->gi->columns->diagonal, bound = 1.0f / (h * h);
    const uint32_t rays = (w->d->rays + 3) / 4;
    voxrti_gather near_by = *w;
    voxrt_ray ray[VOXRTI_COLUMN_BATCH];
    voxrti_gi_side side[VOXRTI_COLUMN_BATCH];
    float t[VOXRTI_COLUMN_BATCH], weight[VOXRTI_COLUMN_BATCH], rgb[VOXRTI_COLUMN_BATCH][3];
    voxrti_points at = *q;
    uint32_t r, i, a;
    memset(side, 0, sizeof side);
    memset(t, 0, sizeof t);
    memset(weight, 0, sizeof weight);
    memset(rgb, 0, sizeof rgb);
    near_by.radius = h < w->radius ? h : w->radius;
    for (at.share = at.share < 32 ? 0 : 32; at.share < 32 && rays > 1u << at.share; at.share++) { }
    for (i = 0; i < at.count; i++) at.exponent[i] = 0.0f;
    for (r = 0; r < rays; r++) {
        voxrti_gather_rays(&near_by, &at, w->first + r, ray, t, side, weight, stats);
        voxrti_hit_light(&near_by, side, ray, t, at.count, w->bounces > 1, rgb);
        for (i = 0; i < at.count; i++) {
            float c1, c2, rest;
            if (side[i].at == (size_t)-1) continue;
            apart[i] += (float)(int32_t)w->d->rays / ((float)(int32_t)rays * (t[i] + 1e-20f));
            c1 = voxrti_dot3(ray[i].dir, at.n[i]);
            c2 = 0.0f - voxrti_dot3(ray[i].dir, side[i].normal);
            if (!(c1 > 0.0f && c2 > 0.0f)) continue;
            rest = 1.0f - bound * t[i] * t[i] / (c1 * c2);
            if (!(rest > 0.0f)) continue;
            for (a = 0; a < 3; a++) out[i][a] += rgb[i][a] * rest * (1.0f / (float)(int32_t)rays);
        }
    }
}

/* ---- pixels ---- */

/* Bits 0 to 7 of x, a zero before each. */
VOXRTI_INLINE uint32_t voxrti_spread8(uint32_t x) {
    x &= 255u;
    x = (x | x << 4) & 0x0f0fu;
    x = (x | x << 2) & 0x3333u;
    return (x | x << 1) & 0x5555u;
}

/* Does it see a surface? Its normal is of unit length, about, and it is somewhere. */
VOXRTI_INLINE int voxrti_pixel_seen(const voxrt_gbuffer *g, size_t at) {
    const float *n = g->normal + 3 * at, *p = g->position + 3 * at, l = voxrti_dot3(n, n);
    return l > 0.5f && l < 2.0f && voxrti_absf(p[0]) < 1e15f && voxrti_absf(p[1]) < 1e15f && voxrti_absf(p[2]) < 1e15f;
}
/* Of its lobe; 0: none. */
VOXRTI_INLINE float voxrti_pixel_exponent(const voxrt_gbuffer *g, size_t at) {
    const float e = g->specular != NULL ? g->specular[4 * at + 3] : 0.0f;
    return e > 0.0f ? (e < 1e6f ? e : 1e6f) : 0.0f;
}

/* Pixels -> points. share: below 32, pixels of 256 x 256 share a sequence, along a Z curve (Ahmed & Wonka 2020): what
   a pixel and its neighbours send is spread as evenly as what one pixel sends, so their mean is better by more than
   their number; for what a filter will average. */
static void voxrti_gather_open(const voxrti_gather *w, const uint32_t *pixel, uint32_t count, uint32_t share,
                               voxrti_points *q) {
    const voxrt_gbuffer *g = w->g;
    uint32_t i, a;
    q->count = count;
    q->share = share;
    for (i = 0; i < count; i++) {
        const size_t at = pixel[i];
        const uint32_t x = (uint32_t)(at % g->width), y = (uint32_t)(at / g->width), far_ = share < 32 ? 8 : 0;
        memcpy(q->p[i], g->position + 3 * at, 12);
        memcpy(q->n[i], g->normal + 3 * at, 12);
        q->seed[i] = voxrti_hash32((x >> far_) + (y >> far_ << 16)) ^ w->seed;
        q->place[i] = voxrti_spread8(x) | voxrti_spread8(y) << 1;
        q->exponent[i] = voxrti_pixel_exponent(g, at);
        memset(q->view[i], 0, 12);
        if (!(q->exponent[i] > 0.0f)) continue;
        for (a = 0; a < 3; a++) q->view[i][a] = q->p[i][a] - w->frame.eye[a];
        (void)voxrti_normalize(q->view[i]);
    }
}

/* A run of the list: sums over the rays of this pass. */
static void voxrti_task_shade(void *ctx, uint32_t index) {
    voxrti_gather *w = (voxrti_gather *)ctx;
    const uint32_t batch = w->from + index;
    const uint32_t *list = w->list + (size_t)batch * VOXRTI_COLUMN_BATCH;
    voxrti_points q;
    voxrt_stats stats;
    float rgb[VOXRTI_COLUMN_BATCH][3], gloss[VOXRTI_COLUMN_BATCH][3], apart[VOXRTI_COLUMN_BATCH];
    float *to = w->which == 2 ? w->indirect : w->half[w->which];
    uint32_t i, a, n = 0;
    while (n < VOXRTI_COLUMN_BATCH && (size_t)batch * VOXRTI_COLUMN_BATCH + n < w->list_count &&
           list[n] != VOXRTI_NO_PIXEL) n++;
    if (n == 0) return;
    memset(&stats, 0, sizeof stats);
    memset(rgb, 0, sizeof rgb);
    memset(gloss, 0, sizeof gloss);
    memset(apart, 0, sizeof apart);
    voxrti_gather_open(w, list, n, w->share, &q);
    if (w->d->method == VOXRT_GI_VPL) {
        const uint32_t x = list[0] % w->g->width, y = list[0] / w->g->width;
        if (w->gi->vpl_count != 0) {
            uint32_t lit[VOXRTI_COLUMN_BATCH][4];
            memset(lit, 0, sizeof lit);
            voxrti_vpl_run(w, &q, y % w->set * w->set + x % w->set, rgb, w->gloss != NULL ? gloss : NULL, lit,
                           w->want_stats ? &stats : NULL);
            if (!(w->d->d_min > 0.0f)) voxrti_vpl_compensate(w, &q, rgb, apart, w->want_stats ? &stats : NULL);
            for (i = 0; i < n && w->lit != NULL; i++) memcpy(w->lit + 4 * (size_t)list[i], lit[i], 16);
        }
    } else {
        voxrti_points other;
        uint8_t of[VOXRTI_COLUMN_BATCH];
        float more[VOXRTI_COLUMN_BATCH][3];
        other.count = 0;
        other.share = q.share;
        for (i = 0; i < n && w->gloss != NULL && w->d->method != VOXRT_GI_AO; i++) {
            const uint32_t m = other.count;
            if (!(q.exponent[i] > 0.0f)) continue;
            memcpy(other.p[m], q.p[i], 12);
            memcpy(other.n[m], q.n[i], 12);
            memcpy(other.view[m], q.view[i], 12);
            other.exponent[m] = q.exponent[i];
            other.seed[m] = voxrti_hash32(q.seed[i]);
            other.place[m] = q.place[i];
            of[m] = (uint8_t)i;
            other.count++;
        }
        for (i = 0; i < n; i++) q.exponent[i] = 0.0f;
        voxrti_gather_run(w, &q, rgb, w->apart != NULL ? apart : NULL, w->want_stats ? &stats : NULL);
        if (other.count != 0) {
            memset(more, 0, sizeof more);
            voxrti_gather_run(w, &other, more, NULL, w->want_stats ? &stats : NULL);
            for (i = 0; i < other.count; i++) memcpy(gloss[of[i]], more[i], 12);
        }
    }
    for (i = 0; i < n; i++) {
        for (a = 0; a < 3; a++) {
            to[3 * (size_t)list[i] + a] += rgb[i][a];
            if (w->gloss != NULL) w->gloss[3 * (size_t)list[i] + a] += gloss[i][a];
        }
        if (w->apart != NULL) w->apart[list[i]] += apart[i];
    }
    if (w->want_stats) {
        voxrti_tally_add(w->sum[0], stats.rays);
        voxrti_tally_add(w->sum[1], stats.hits);
        voxrti_tally_add(w->sum[2], stats.steps);
    }
}

/* Direct light of a tile of 8 x 8 pixels: irradiance / pi, and what lobes send. */
static void voxrti_task_direct(void *ctx, uint32_t tile) {
    const voxrti_gather *w = (const voxrti_gather *)ctx;
    const voxrt_gbuffer *g = w->g;
    const uint32_t tiles_x = (g->width + 7) / 8, x0 = tile % tiles_x * 8, y0 = tile / tiles_x * 8;
    voxrti_points q;
    voxrti_lighting c;
    uint32_t pixel[VOXRTI_COLUMN_BATCH], n = 0, x, y, i, a;
    float rgb[VOXRTI_COLUMN_BATCH][3], gloss[VOXRTI_COLUMN_BATCH][3];
    size_t l;
    for (y = y0; y < y0 + 8 && y < g->height; y++)
        for (x = x0; x < x0 + 8 && x < g->width; x++) {
            const size_t at = (size_t)y * g->width + x;
            memset(w->direct + 3 * at, 0, 12);
            if (w->direct_gloss != NULL) memset(w->direct_gloss + 3 * at, 0, 12);
            if (voxrti_pixel_seen(g, at)) pixel[n++] = (uint32_t)at;
        }
    if (n == 0) return;
    voxrti_gather_open(w, pixel, n, w->direct_share, &q);
    memset(rgb, 0, sizeof rgb);
    memset(gloss, 0, sizeof gloss);
    memset(&c, 0, sizeof c);
    c.gi = w->gi;
    c.isa = w->isa;
    c.shadow = w->d->shadow;
    c.maps = c.shadow == NULL && w->d->lookup == VOXRT_GI_LOOKUP_MAPS;
    c.lift = w->d->shadow_lift;
    c.first = w->first;
    c.samples = w->rays;
    for (l = 0; l < voxrti_gi_lamps(w->gi); l++)
        voxrti_light_points(&c, l, &q, rgb, w->direct_gloss != NULL ? gloss : NULL);
    for (i = 0; i < n; i++)
        for (a = 0; a < 3; a++) {
            w->direct[3 * (size_t)pixel[i] + a] = rgb[i][a] * 0.318309886f;
            if (w->direct_gloss != NULL) w->direct_gloss[3 * (size_t)pixel[i] + a] = gloss[i][a];
        }
}

/* ---- which pixels send rays ---- */

/* All that see something, in tiles of 8 x 8; with a pattern, those of one of its places after the other. Every tile and
   place begins a run. Without a list: how long it would be. */
static size_t voxrti_list_all(const voxrt_gbuffer *g, uint32_t set, uint32_t *list) {
    const uint32_t side = 8 * set;
    size_t n = 0;
    uint32_t px, py, x0, y0, x, y;
    for (py = 0; py < set; py++)
        for (px = 0; px < set; px++)
            for (y0 = 0; y0 < g->height; y0 += side)
                for (x0 = 0; x0 < g->width; x0 += side) {
                    const size_t from = n;
                    for (y = y0 + py; y < y0 + side && y < g->height; y += set)
                        for (x = x0 + px; x < x0 + side && x < g->width; x += set) {
                            if (!voxrti_pixel_seen(g, (size_t)y * g->width + x)) continue;
                            if (list != NULL) list[n] = (uint32_t)((size_t)y * g->width + x);
                            n++;
                        }
                    for (; n != from && n % VOXRTI_COLUMN_BATCH != 0; n++) if (list != NULL) list[n] = VOXRTI_NO_PIXEL;
                }
    return n;
}

typedef struct voxrti_mesh_work { voxrti_gather *w; float *value; uint32_t step, decide; } voxrti_mesh_work;

/* A row of the mesh of `step` pixels: those that lie between pixels of the mesh twice as wide get the mean of these if
   Ward's bound allows (decide), or were found to (state 1). */
static void voxrti_task_between(void *ctx, uint32_t row) {
    const voxrti_mesh_work *m = (const voxrti_mesh_work *)ctx;
    voxrti_gather *w = m->w;
    const voxrt_gbuffer *g = w->g;
    const uint32_t s = m->step, y = row * s;
    const float bound = w->d->detail > 0.0f ? w->d->detail : 0.15f;
    uint32_t x, i, k, a, n;
    for (x = 0; x < g->width; x += s) {
        const size_t at = (size_t)y * g->width + x;
        const int odd_x = x / s % 2 != 0, odd_y = y / s % 2 != 0;
        size_t from[4];
        int ok = 1;
        if ((!odd_x && !odd_y) || !voxrti_pixel_seen(g, at)) continue;
        if (!m->decide && w->state[at] != 1) continue;
        n = odd_x && odd_y ? 4 : 2;
        for (i = 0; i < n && ok; i++) {
            const int64_t qx = (int64_t)x + (odd_x ? (i % 2 ? (int64_t)s : -(int64_t)s) : 0);
            const int64_t qy = (int64_t)y + (odd_y ? (((odd_x ? i / 2 : i) % 2) ? (int64_t)s : -(int64_t)s) : 0);
            const float *p = g->position + 3 * at, *v = g->normal + 3 * at, *o, *u;
            float d[3], cosine, plane, far_, r;
            ok = qx >= 0 && qy >= 0 && qx < (int64_t)g->width && qy < (int64_t)g->height;
            if (!ok) break;
            from[i] = (size_t)qy * g->width + (size_t)qx;
            if (!m->decide) continue;
            o = g->position + 3 * from[i];
            u = g->normal + 3 * from[i];
            cosine = voxrti_dot3(v, u);
            for (a = 0; a < 3; a++) d[a] = o[a] - p[a];
            plane = voxrti_dot3(d, v);
            far_ = sqrtf(voxrti_dot3(d, d));
            r = w->apart[from[i]];
            ok = cosine > 0.9f && voxrti_absf(plane) < 0.1f * far_ + 1e-20f &&
                far_ * r + sqrtf(2.0f * (cosine < 1.0f ? 1.0f - cosine : 0.0f)) * 0.25f < bound;
            if (g->specular != NULL && g->specular[4 * at + 3] > 0.0f) ok = 0;
            if (w->lit != NULL && ok) { /* edges of shadows of more than one light in 32 */
                uint32_t differ = 0;
                for (k = 0; k < 4; k++) differ += voxrti_popcount64(w->lit[4 * from[i] + k] ^ w->lit[4 * from[0] + k]);
                ok = 32 * differ <= w->d->rays * w->bounces;
            }
        }
        if (m->decide) w->state[at] = ok ? 1 : 2;
        if (m->decide && ok && w->lit != NULL) memcpy(w->lit + 4 * at, w->lit + 4 * from[0], 16);
        if (!ok) continue;
        for (a = 0; a < 3; a++) {
            float sum = 0.0f;
            for (k = 0; k < n; k++) sum += m->value[3 * from[k] + a];
            m->value[3 * at + a] = sum * (n == 4 ? 0.25f : 0.5f);
        }
        for (k = 0; k < n && m->decide; k++) /* as near as the nearest */
            if (w->apart[from[k]] > w->apart[at]) w->apart[at] = w->apart[from[k]];
    }
}

static voxrt_result voxrti_shade_list(voxrti_gather *w) {
    const voxrt_env *env = &w->d->env;
    const uint32_t n = (uint32_t)((w->list_count + VOXRTI_COLUMN_BATCH - 1) / VOXRTI_COLUMN_BATCH);
    const uint32_t most = env->progress_fn != NULL ? 256 : n; /* with someone who may want to stop, in parts */
    uint32_t part;
    for (w->from = 0; w->from < n; w->from += part) {
        part = n - w->from < most ? n - w->from : most;
        voxrti_parallel_for(env, voxrti_task_shade, w, part);
        if (env->progress_fn == NULL) continue;
        w->done += (uint64_t)part * VOXRTI_COLUMN_BATCH * w->rays;
        if (w->done > w->total) w->done = w->total;
        if (env->progress_fn(env->progress_user, w->done, w->total) != 0)
            return voxrti_fail(env->error, VOXRT_ERR_CANCELLED, w->from, "cancelled");
    }
    return VOXRT_OK;
}

/* A pass over a mesh of pixels that is refined where it has to be. With `again` it is already known where. */
static voxrt_result voxrti_shade_coarse(voxrti_gather *w, int again) {
    const voxrt_gbuffer *g = w->g;
    voxrt_result r = VOXRT_OK;
    uint32_t step, x, y;
    const uint32_t first = w->rays;
    voxrti_mesh_work m;
    m.w = w;
    m.value = w->which == 2 ? w->indirect : w->half[w->which];
    m.decide = !again;
    for (step = w->d->coarse; step != 0 && r == VOXRT_OK; step /= 2) {
        m.step = step;
        if (step != w->d->coarse)
            voxrti_parallel_for(&w->d->env, voxrti_task_between, &m, (g->height + step - 1) / step);
        w->list_count = 0;
        for (y = 0; y < g->height; y += step)
            for (x = 0; x < g->width; x += step) {
                const size_t at = (size_t)y * g->width + x;
                const int coarsest = step == w->d->coarse;
                if (!coarsest && x / step % 2 == 0 && y / step % 2 == 0) continue;
                if (!voxrti_pixel_seen(g, at)) continue;
                if (coarsest) w->state[at] = 2;
                if (w->state[at] == 2) w->list[w->list_count++] = (uint32_t)at;
            }
        r = voxrti_shade_list(w);
        for (x = 0; x < w->list_count && !again; x++) w->apart[w->list[x]] *= 1.0f / (float)(int32_t)first;
    }
    return r;
}

/* ---- filter: weights by distance in the picture, angle of normals, distance from the tangent plane ---- */

typedef struct voxrti_gi_filter {
    const voxrt_gbuffer *g;
    const float *from;
    float *to;
    int32_t radius, step_x, step_y;
    float depth_scale; /* 1 / (2 sigma^2) at one pixel's distance */
    float table[65];
} voxrti_gi_filter;

static void voxrti_task_gi_filter(void *ctx, uint32_t y) {
    const voxrti_gi_filter *f = (const voxrti_gi_filter *)ctx;
    const voxrt_gbuffer *g = f->g;
    uint32_t x, a;
    for (x = 0; x < g->width; x++) {
        const size_t at = 3 * ((size_t)y * g->width + x);
        const float *n = g->normal + at, *p = g->position + at;
        float sum[3] = {0, 0, 0}, weight = 0.0f;
        int32_t i;
        for (i = -f->radius; i <= f->radius; i++) {
            const int64_t qx = (int64_t)x + (int64_t)i * f->step_x, qy = (int64_t)y + (int64_t)i * f->step_y;
            const int32_t far_ = i < 0 ? -i : i;
            size_t q;
            float cosine, d[3], plane, w;
            if (qx < 0 || qy < 0 || qx >= (int64_t)g->width || qy >= (int64_t)g->height) continue;
            q = 3 * ((size_t)qy * g->width + (size_t)qx);
            cosine = voxrti_dot3(n, g->normal + q);
            if (!(cosine > 0.0f && cosine < 2.0f)) continue; /* of a normal and a position that are none: not seen */
            for (a = 0; a < 3; a++) d[a] = g->position[q + a] - p[a];
            plane = voxrti_dot3(n, d);
            plane = plane * plane * f->depth_scale / (float)((1 + far_) * (1 + far_));
            if (!(plane <= 20.0f)) continue;
            cosine *= cosine;
            cosine *= cosine;
            cosine *= cosine;
            cosine *= cosine;
            cosine *= cosine; /* to the 32nd */
            /* ~ exp(-plane) */
            w = f->table[far_] * cosine / (1.0f + plane * (1.0f + plane * (0.5f + plane * (1.0f / 6.0f))));
            for (a = 0; a < 3; a++) sum[a] += w * f->from[q + a];
            weight += w;
        }
        for (a = 0; a < 3; a++) f->to[at + a] = weight > 0.0f ? sum[a] / weight : f->from[at + a];
    }
}

/* value, rgb for each pixel, in place. */
static voxrt_result voxrti_gi_filter_run(const voxrt_env *env, const voxrt_gbuffer *g, double diagonal, uint32_t radius,
                                         float *value, voxrti_mem *mem) {
    voxrti_gi_filter f;
    const size_t bytes = (size_t)g->width * g->height * 12;
    const uint32_t r = radius > 64 ? 64 : radius;
    float *other = (float *)voxrti_alloc(mem, bytes);
    double sigma = 0.5 * diagonal;
    uint32_t pass, i;
    if (other == NULL) return voxrti_fail(env->error, VOXRT_ERR_NO_MEMORY, bytes, "no memory for % bytes of a filter");
    memset(&f, 0, sizeof f);
    f.g = g;
    f.radius = (int32_t)r;
    f.depth_scale = (float)(1.0 / (2.0 * sigma * sigma));
    for (i = 0; i <= r; i++) f.table[i] = (float)voxrti_exp2(-1.442695041 * 2.0 * (double)(i * i) / (double)(r * r));
    for (pass = 0; pass < 4; pass++) { /* rows and columns, twice */
        f.from = pass % 2 == 0 ? value : other;
        f.to = pass % 2 == 0 ? other : value;
        f.step_x = pass % 2 == 0;
        f.step_y = pass % 2 == 1;
        voxrti_parallel_for(env, voxrti_task_gi_filter, &f, g->height);
    }
    voxrti_free(mem, other);
    return VOXRT_OK;
}

/* ---- pictures before this one ---- */

typedef struct voxrti_past { /* what the last picture left, and the new one beside it */
    float *value[4], *count; /* rgb: indirect, gloss, direct, its gloss, or NULL; the mean of how many pictures */
    float *position, *normal;
} voxrti_past;

struct voxrt_gi_history {
    voxrti_mem mem;
    voxrt_env env;
    voxrti_past past[2];
    uint32_t width, height, now, pictures, version;
    uint32_t turns;            /* pictures with other rays than the one before */
    uint32_t settings[12];
    voxrt_camera camera;
    voxrti_frame frame;
    float kept;
};

VOXRT_DEF voxrt_result voxrt_gi_history_create(const voxrt_env *env, voxrt_gi_history **out_history) {
    voxrti_mem mem;
    voxrt_env none;
    voxrt_gi_history *h;
    voxrt_result r;
    if (out_history == NULL) return VOXRT_ERR_INVALID_ARG;
    *out_history = NULL;
    memset(&none, 0, sizeof none);
    if (env == NULL) env = &none;
    r = voxrti_env_open(env, &mem);
    if (r != VOXRT_OK) return r;
    h = (voxrt_gi_history *)voxrti_alloc_zero(&mem, 1, sizeof *h);
    if (h == NULL) return voxrti_fail(env->error, VOXRT_ERR_NO_MEMORY, 0, "no memory for a history");
    h->mem = mem;
    h->env = *env;
    *out_history = h;
    return VOXRT_OK;
}

static void voxrti_history_empty(voxrt_gi_history *h) {
    uint32_t i, k;
    for (i = 0; i < 2; i++) {
        for (k = 0; k < 4; k++) voxrti_free(&h->mem, h->past[i].value[k]);
        voxrti_free(&h->mem, h->past[i].count);
        voxrti_free(&h->mem, h->past[i].position);
        voxrti_free(&h->mem, h->past[i].normal);
    }
    memset(h->past, 0, sizeof h->past);
    h->width = h->height = h->pictures = 0;
}

VOXRT_DEF void voxrt_gi_history_destroy(voxrt_gi_history *history) {
    voxrti_mem mem;
    if (history == NULL) return;
    voxrti_history_empty(history);
    mem = history->mem;
    voxrti_free(&mem, history);
}

typedef struct voxrti_reuse {
    const voxrti_gather *w;
    voxrt_gi_history *h;
    float *value[4];
    const voxrti_past *old;
    voxrti_past *now;
    float keep;
    uint32_t same, still;  /* nothing changed: the mean of all pictures; the camera did not */
    uint32_t kept[2];
} voxrti_reuse;

/* Where was this point in the last picture? Weights of up to four pixels there that show the same surface. */
static float voxrti_reuse_find(const voxrti_reuse *u, size_t at, size_t from[4], float weight[4]) {
    const voxrt_gbuffer *g = u->w->g;
    const voxrti_frame *f = &u->h->frame;
    const float *p = (g->before != NULL ? g->before : g->position) + 3 * at, *n = g->normal + 3 * at;
    double v[3], z = 0.0, x = 0.0, y = 0.0, size;
    float sum = 0.0f;
    uint32_t a, i;
    for (a = 0; a < 3; a++) {
        v[a] = (double)p[a] - (double)f->eye[a];
        z += v[a] * f->forward[a];
        x += v[a] * f->right[a];
        y += v[a] * f->up[a];
    }
    for (i = 0; i < 4; i++) weight[i] = 0.0f;
    if (!(z > 0.0)) return 0.0f;
    size = 1.0 / (f->pixel * f->pixel * z);
    x = x * size + 0.5 * (double)g->width - 0.5;
    y = 0.5 * (double)g->height - y * size - 0.5;
    if (!(x > -1.0 && y > -1.0 && x < (double)g->width && y < (double)g->height)) return 0.0f;
    for (i = 0; i < 4; i++) {
        const int64_t qx = voxrti_floor(x) + (int64_t)(i & 1u), qy = voxrti_floor(y) + (int64_t)(i >> 1);
        const double fx = x - (double)voxrti_floor(x), fy = y - (double)voxrti_floor(y);
        const float w = (float)(((i & 1u) ? fx : 1.0 - fx) * ((i >> 1) ? fy : 1.0 - fy));
        float d[3], plane;
        if (qx < 0 || qy < 0 || qx >= (int64_t)g->width || qy >= (int64_t)g->height) continue;
        from[i] = (size_t)qy * g->width + (size_t)qx;
        if (!(u->old->count[from[i]] > 0.0f)) continue;
        for (a = 0; a < 3; a++) d[a] = u->old->position[3 * from[i] + a] - p[a];
        plane = voxrti_absf(voxrti_dot3(d, u->old->normal + 3 * from[i]));
        if (!(plane < 2.0f * (float)(z * f->pixel)) || !(voxrti_dot3(u->old->normal + 3 * from[i], n) > 0.8f)) continue;
        weight[i] = w;
        sum += w;
    }
    if (!(sum > 0.01f)) return 0.0f;
    for (i = 0; i < 4; i++) weight[i] /= sum;
    return sum;
}

/* Mean and deviation of a value on the same surface, 5 x 5 pixels around. */
static void voxrti_reuse_spread(const voxrt_gbuffer *g, const float *value, uint32_t x, uint32_t y, float mean[3],
                                float spread[3]) {
    const size_t at = (size_t)y * g->width + x;
    float sum[3] = {0, 0, 0}, square[3] = {0, 0, 0}, n = 0.0f, d[3];
    int32_t i, j;
    uint32_t a;
    for (j = -2; j <= 2; j++)
        for (i = -2; i <= 2; i++) {
            const int64_t qx = (int64_t)x + i, qy = (int64_t)y + j;
            size_t q;
            if (qx < 0 || qy < 0 || qx >= (int64_t)g->width || qy >= (int64_t)g->height) continue;
            q = (size_t)qy * g->width + (size_t)qx;
            if (!(voxrti_dot3(g->normal + 3 * at, g->normal + 3 * q) > 0.9f)) continue;
            for (a = 0; a < 3; a++) d[a] = g->position[3 * q + a] - g->position[3 * at + a];
            if (!(voxrti_absf(voxrti_dot3(d, g->normal + 3 * at)) <= 0.1f * sqrtf(voxrti_dot3(d, d)))) continue;
            n += 1.0f;
            for (a = 0; a < 3; a++) {
                const float v = value[3 * q + a];
                sum[a] += v;
                square[a] += v * v;
            }
        }
    for (a = 0; a < 3; a++) {
        mean[a] = sum[a] / n;
        spread[a] = square[a] / n - mean[a] * mean[a];
        spread[a] = spread[a] > 0.0f ? sqrtf(spread[a]) : 0.0f;
    }
}

/* History may differ from the mean of 5 x 5 pixels by so many of their deviations: three times what chance does. Where
   it differs more light has changed: it is drawn in, and counts for few pictures. */
#define VOXRTI_REUSE_CLAMP 0.6f
#define VOXRTI_REUSE_CHANGED 2.0f

static void voxrti_task_reuse(void *ctx, uint32_t y) {
    voxrti_reuse *u = (voxrti_reuse *)ctx;
    const voxrt_gbuffer *g = u->w->g;
    uint32_t x, i, k, a, kept = 0;
    for (x = 0; x < g->width; x++) {
        const size_t at = (size_t)y * g->width + x;
        size_t from[4] = {0, 0, 0, 0};
        float weight[4] = {0, 0, 0, 0}, old[4][3], n = 0.0f, share;
        int changed = 0;
        memset(old, 0, sizeof old);
        memcpy(u->now->position + 3 * at, g->position + 3 * at, 12);
        memcpy(u->now->normal + 3 * at, g->normal + 3 * at, 12);
        u->now->count[at] = 0.0f;
        if (!voxrti_pixel_seen(g, at)) {
            for (k = 0; k < 4; k++) if (u->value[k] != NULL) memset(u->now->value[k] + 3 * at, 0, 12);
            continue;
        }
        if (u->same) {
            from[0] = at;
            weight[0] = 1.0f;
            n = u->old->count[at];
        } else if (u->h->pictures != 0 &&
                   !(u->still && (g->before == NULL || memcmp(g->before + 3 * at, g->position + 3 * at, 12) == 0)) &&
                   voxrti_reuse_find(u, at, from, weight) > 0.0f) {
            for (i = 0; i < 4; i++) if (weight[i] > 0.0f) n += weight[i] * u->old->count[from[i]];
            n = n < u->keep - 1.0f ? n : u->keep - 1.0f;
        }
        kept += n > 0.0f;
        for (k = 0; k < 4; k++) {
            float mean[3], spread[3];
            if (u->value[k] == NULL) continue;
            for (a = 0; a < 3; a++) {
                old[k][a] = 0.0f;
                for (i = 0; i < 4 && n > 0.0f; i++)
                    if (weight[i] > 0.0f) old[k][a] += weight[i] * u->old->value[k][3 * from[i] + a];
            }
            if (u->same || !(n > 0.0f)) continue;
            voxrti_reuse_spread(g, u->value[k], x, y, mean, spread);
            for (a = 0; a < 3; a++) {
                const float by = VOXRTI_REUSE_CLAMP * spread[a], v = old[k][a];
                old[k][a] = v < mean[a] - by ? mean[a] - by : v > mean[a] + by ? mean[a] + by : v;
                if (old[k][a] != v) changed = 1;
            }
        }
        if (changed && n > VOXRTI_REUSE_CHANGED) n = VOXRTI_REUSE_CHANGED;
        share = 1.0f / (n + 1.0f);
        u->now->count[at] = n + 1.0f;
        for (k = 0; k < 4; k++)
            for (a = 0; a < 3 && u->value[k] != NULL; a++)
                u->now->value[k][3 * at + a] = old[k][a] + (u->value[k][3 * at + a] - old[k][a]) * share;
    }
    voxrti_tally_add(u->kept, kept);
}

/* Make room, find out what has changed. */
static voxrt_result voxrti_reuse_open(const voxrti_gather *w, const float *const value[4], voxrti_reuse *u) {
    voxrt_gi_history *h = w->d->history;
    const size_t n = (size_t)w->g->width * w->g->height;
    uint32_t settings[12], i, k, ok = 1;
    int still;
    memset(settings, 0, sizeof settings);
    settings[0] = (uint32_t)w->d->method;
    settings[1] = (uint32_t)w->d->lookup;
    settings[2] = w->bounces;
    memcpy(&settings[3], &w->radius, 4);
    memcpy(&settings[4], &w->d->d_min, 4);
    for (k = 0; k < 4; k++) settings[5 + k] = value[k] != NULL;
    settings[9] = w->d->shadow != NULL;
    settings[10] = w->d->coarse;
    if (h->width != w->g->width || h->height != w->g->height || memcmp(settings, h->settings, sizeof settings) != 0) {
        voxrti_history_empty(h);
        for (i = 0; i < 2; i++) {
            for (k = 0; k < 4; k++) {
                if (value[k] == NULL) continue;
                h->past[i].value[k] = (float *)voxrti_alloc_array(&h->mem, n, 12);
                ok &= h->past[i].value[k] != NULL;
            }
            h->past[i].count = (float *)voxrti_alloc_zero(&h->mem, n, 4);
            h->past[i].position = (float *)voxrti_alloc_array(&h->mem, n, 12);
            h->past[i].normal = (float *)voxrti_alloc_array(&h->mem, n, 12);
            ok &= h->past[i].count != NULL && h->past[i].position != NULL && h->past[i].normal != NULL;
        }
        if (!ok) {
            voxrti_history_empty(h);
            return voxrti_fail(w->d->env.error, VOXRT_ERR_NO_MEMORY, n, "no memory for a history of % pixels");
        }
        h->width = w->g->width;
        h->height = w->g->height;
        memcpy(h->settings, settings, sizeof settings);
    }
    memset(u, 0, sizeof *u);
    still = memcmp(h->camera.eye, w->d->camera.eye, 12) == 0 && memcmp(h->camera.at, w->d->camera.at, 12) == 0 &&
        memcmp(h->camera.up, w->d->camera.up, 12) == 0 && h->camera.fov_y == w->d->camera.fov_y;
    u->same = h->pictures != 0 && h->version == w->gi->version && still;
    u->still = (uint32_t)still;
    /* Other rays in each picture, but not where only light and objects move: noise that stays where it is does not
       flicker. Means over changing rays do, and lag behind the light; those over the same rays only lag. */
    if (h->pictures == 0) h->turns = 0;
    else if (u->same || !still) h->turns++;
    u->w = w;
    u->h = h;
    u->keep = w->d->keep > 0.0f ? w->d->keep : 16.0f;
    if (u->keep < 1.0f) u->keep = 1.0f;
    return VOXRT_OK;
}

static void voxrti_reuse_run(voxrti_reuse *u, float *const value[4]) {
    voxrt_gi_history *h = u->h;
    const size_t n = (size_t)h->width * h->height;
    uint32_t k;
    u->old = &h->past[h->now];
    u->now = &h->past[!h->now];
    for (k = 0; k < 4; k++) u->value[k] = value[k];
    voxrti_parallel_for(&u->w->d->env, voxrti_task_reuse, u, h->height);
    for (k = 0; k < 4; k++) if (value[k] != NULL) memcpy(value[k], u->now->value[k], n * 12);
    h->now = !h->now;
    h->pictures++;
    h->version = u->w->gi->version;
    h->camera = u->w->d->camera;
    h->frame = u->w->frame;
    h->kept = (float)voxrti_tally(u->kept);
}

/* ---- a picture ---- */

typedef struct voxrti_combine {
    const voxrt_gbuffer *g;
    float *value;
    const float *gloss;
    int ao, emit;
    float relief, eye[3];
} voxrti_combine;

/* Irradiance / pi and what white lobes send -> what goes to the camera. */
static void voxrti_task_combine(void *ctx, uint32_t y) {
    const voxrti_combine *c = (const voxrti_combine *)ctx;
    const voxrt_gbuffer *g = c->g;
    size_t at = (size_t)y * g->width, end = at + g->width;
    uint32_t a;
    for (; at < end; at++) {
        float part = 1.0f;
        if (c->relief > 0.0f) {
            float to[3], facing = 0.0f;
            for (a = 0; a < 3; a++) to[a] = c->eye[a] - g->position[3 * at + a];
            if (voxrti_normalize(to)) facing = voxrti_dot3(to, g->normal + 3 * at);
            part = 1.0f - c->relief * (1.0f - (facing > 0.0f ? facing : 0.0f));
        }
        for (a = 0; a < 3; a++) {
            float v = c->value[3 * at + a] * part;
            if (!c->ao) v *= g->albedo[3 * at + a];
            if (c->gloss != NULL) v += c->gloss[3 * at + a] * part * g->specular[4 * at + a];
            if (c->emit && g->emission != NULL) v += g->emission[3 * at + a];
            c->value[3 * at + a] = v;
        }
    }
}

typedef struct voxrti_scale { float *value; float by; size_t n; } voxrti_scale;
static void voxrti_task_scale(void *ctx, uint32_t i) {
    const voxrti_scale *s = (const voxrti_scale *)ctx;
    size_t at = (size_t)i << 16, end = at + 65536;
    for (end = end < s->n ? end : s->n; at < end; at++) s->value[at] *= s->by;
}
static void voxrti_scale_run(const voxrt_env *env, float *value, size_t n, float by) {
    voxrti_scale s;
    s.value = value;
    s.n = n;
    s.by = by;
    voxrti_parallel_for(env, voxrti_task_scale, &s, (uint32_t)((n + 65535) >> 16));
}

/* Rays until the two halves of what they found differ as little as asked. The mean of both goes to w->indirect. */
static voxrt_result voxrti_gather_until(voxrti_gather *w, voxrti_mem *mem, float *noise, uint32_t *out_rays) {
    const size_t n = 3 * (size_t)w->g->width * w->g->height;
    const uint32_t most = w->d->rays / 2 > 4 ? w->d->rays / 2 : 4;
    const double diagonal = w->gi->columns->diagonal;
    uint32_t done = 0, more = 4, side;
    float *test = NULL;
    voxrt_result r = VOXRT_OK;
    size_t i;
    w->half[0] = (float *)voxrti_alloc_zero(mem, n, 4);
    w->half[1] = (float *)voxrti_alloc_zero(mem, n, 4);
    if (w->d->filter != 0) test = (float *)voxrti_alloc_array(mem, n, 4);
    if (w->half[0] == NULL || w->half[1] == NULL || (w->d->filter != 0 && test == NULL))
        r = voxrti_fail(w->d->env.error, VOXRT_ERR_NO_MEMORY, n, "no memory for two halves of % values");
    while (r == VOXRT_OK) {
        double sum = 0.0, differ = 0.0, e;
        w->rays = more;
        for (side = 0; side < 2 && r == VOXRT_OK; side++) {
            w->which = side;
            w->first = w->d->first_ray / 2 + done;
            w->seed = side ? 0x68bc21ebu : 0;
            r = w->state != NULL ? voxrti_shade_coarse(w, done != 0 || side != 0) : voxrti_shade_list(w);
        }
        if (r != VOXRT_OK) break;
        done += more;
        /* the filter is linear: it may see the difference itself */
        for (i = 0; i < n; i++) {
            sum += (double)w->half[0][i] + (double)w->half[1][i];
            if (test != NULL) test[i] = w->half[0][i] - w->half[1][i];
        }
        if (test != NULL) r = voxrti_gi_filter_run(&w->d->env, w->g, diagonal, w->d->filter, test, mem);
        for (i = 0; i < n && r == VOXRT_OK; i++) {
            const double d = test != NULL ? (double)test[i] : (double)w->half[0][i] - (double)w->half[1][i];
            differ += d * d;
        }
        e = sum > 0.0 ? sqrt(differ * (double)n) / sum : 0.0;
        *noise = (float)e;
        if (!(e > (double)w->d->tolerance) || done >= most) break;
        e = e / (double)w->d->tolerance; /* noise goes with 1 / sqrt(rays) or faster */
        e = (double)done * (e * e < 8.0 ? e * e : 8.0);
        more = (uint32_t)e + 1 < most ? (uint32_t)e + 1 - done : most - done;
        if (more == 0) more = 1;
    }
    for (i = 0; i < n && r == VOXRT_OK; i++)
        w->indirect[i] = (w->half[0][i] + w->half[1][i]) * (0.5f / (float)(int32_t)done);
    if (r == VOXRT_OK && w->gloss != NULL) voxrti_scale_run(&w->d->env, w->gloss, n, 0.5f / (float)(int32_t)done);
    *out_rays = 2 * done;
    voxrti_free(mem, test);
    voxrti_free(mem, w->half[0]);
    voxrti_free(mem, w->half[1]);
    return r;
}

/* Indirect light of all pixels, before reuse and filters. */
static voxrt_result voxrti_gather_all(voxrti_gather *w, voxrt_gi *gi, voxrti_mem *mem, voxrt_gi_report *report) {
    const size_t n = (size_t)w->g->width * w->g->height;
    size_t i, room;
    voxrt_result r = VOXRT_OK;
    int ok;
    w->set = w->d->method == VOXRT_GI_VPL ? w->d->pattern : 1;
    if (w->d->method == VOXRT_GI_VPL) r = voxrti_vpl_make(w, gi);
    if (r != VOXRT_OK) return r;
    memset(w->indirect, 0, n * 12);
    if (w->gloss != NULL) memset(w->gloss, 0, n * 12);
    room = w->d->coarse > 1 ? n : voxrti_list_all(w->g, w->set, NULL);
    w->list = (uint32_t *)voxrti_alloc_array(mem, room + 1, 4);
    if (w->d->coarse > 1) {
        w->apart = (float *)voxrti_alloc_zero(mem, n, 4);
        w->state = (uint8_t *)voxrti_alloc_zero(mem, n, 1);
        if (w->d->method == VOXRT_GI_VPL) w->lit = (uint32_t *)voxrti_alloc_zero(mem, n, 16);
    }
    ok = w->list != NULL && (w->d->coarse <= 1 || (w->apart != NULL && w->state != NULL &&
                                                   (w->lit != NULL || w->d->method != VOXRT_GI_VPL)));
    if (!ok)
        r = voxrti_fail(w->d->env.error, VOXRT_ERR_NO_MEMORY, n, "no memory for lists of % pixels");
    if (ok && w->d->coarse <= 1) w->list_count = voxrti_list_all(w->g, w->set, w->list);
    report->rays = w->d->rays;
    w->total = (uint64_t)n * w->d->rays;
    if (ok && w->d->tolerance > 0.0f) {
        r = voxrti_gather_until(w, mem, &report->noise, &report->rays);
    } else if (ok) {
        w->which = 2;
        r = w->state != NULL ? voxrti_shade_coarse(w, 0) : voxrti_shade_list(w);
        if (r == VOXRT_OK && w->d->method != VOXRT_GI_VPL) {
            voxrti_scale_run(&w->d->env, w->indirect, 3 * n, 1.0f / (float)(int32_t)w->rays);
            if (w->gloss != NULL) voxrti_scale_run(&w->d->env, w->gloss, 3 * n, 1.0f / (float)(int32_t)w->rays);
        }
    }
    for (i = 0; i < n; i++)
        report->shaded += (w->state != NULL ? w->state[i] == 2 : voxrti_pixel_seen(w->g, i)) ? 1u : 0u;
    voxrti_free(mem, w->list);
    voxrti_free(mem, w->apart);
    voxrti_free(mem, w->lit);
    voxrti_free(mem, w->state);
    return r;
}

/* No way through the volumes is longer. */
static float voxrti_gi_reach(const voxrt_gi *gi) {
    double sum = 0.0;
    uint32_t a;
    while (gi->outer != NULL) gi = gi->outer;
    for (a = 0; a < 3; a++) {
        const double side = gi->columns->cell[a] * (double)gi->columns->size[a];
        sum += side * side;
    }
    return (float)sqrt(sum);
}

typedef struct voxrti_fill_work { const voxrt_gi *gi, *root; uint32_t layer; int isa; } voxrti_fill_work;

/* Both sides of the cells in a row of columns: direct light. */
static void voxrti_task_fill(void *ctx, uint32_t y) {
    const voxrti_fill_work *f = (const voxrti_fill_work *)ctx;
    const voxrt_columns *c = f->gi->columns;
    const voxrti_gi_layer *l = &f->gi->layer[f->layer];
    voxrti_gi_side q[VOXRTI_COLUMN_BATCH];
    size_t rec = l->base[(size_t)y << c->row_log[0]];
    uint32_t x, w, side, n = 0;
    for (x = 0; x < c->size[0]; x++)
        for (w = 0; w < c->words; w++) {
            uint32_t bits = l->bits[voxrti_column(c, 0, x, y) + w];
            for (; bits != 0; bits &= bits - 1, rec++)
                for (side = 0; side < 2; side++) {
                    const uint32_t cell[3] = {x, y, 32 * w + voxrti_ctz64(bits)};
                    if (l->record[rec].area[side] == 0) continue;
                    q[n].gi = f->gi;
                    q[n].at = 2 * rec + side;
                    q[n].layer = f->layer;
                    voxrti_gi_side_place(f->gi, &l->record[rec], side, cell, q[n].position, q[n].normal);
                    if (++n < VOXRTI_COLUMN_BATCH) continue;
                    voxrti_gi_fill(f->root, f->isa, q, n);
                    n = 0;
                }
        }
    if (n != 0) voxrti_gi_fill(f->root, f->isa, q, n);
}

/* What the way of looking up light needs first. */
static voxrt_result voxrti_gi_prepare(const voxrt_gi_render_desc *d, voxrt_gi *gi, int isa) {
    voxrti_gi_map_work m;
    voxrti_fill_work f;
    size_t l;
    f.root = gi;
    f.isa = isa;
    if (d->lookup == VOXRT_GI_LOOKUP_VOLUME) {
        for (f.gi = gi; f.gi != NULL; f.gi = f.gi->outer)
            for (f.layer = 0; f.layer < 2; f.layer++)
                if (f.gi->layer[f.layer].count != 0)
                    voxrti_parallel_for(&d->env, voxrti_task_fill, &f, f.gi->columns->size[1]);
    }
    if (d->lookup != VOXRT_GI_LOOKUP_MAPS || gi->light_count == 0) return VOXRT_OK;
    if (gi->map != NULL && gi->map[0].side == d->map_size) return VOXRT_OK;
    voxrti_gi_maps_free(gi);
    gi->map = (struct voxrti_gi_map *)voxrti_alloc_zero(&gi->mem, gi->light_count, sizeof *gi->map);
    if (gi->map == NULL) return voxrti_fail(d->env.error, VOXRT_ERR_NO_MEMORY, gi->light_count, "no memory for % maps");
    m.gi = gi;
    m.isa = isa;
    for (l = 0; l < gi->light_count; l++) {
        struct voxrti_gi_map *map = &gi->map[l];
        const voxrt_gi_light *light = &gi->light[l];
        double s, c;
        map->side = d->map_size;
        if (light->kind != VOXRT_GI_POINT && light->kind != VOXRT_GI_SPOT) continue;
        voxrti_sincos((double)light->angle * (3.14159265358979323846 / 180.0), &s, &c);
        map->faces = light->kind == VOXRT_GI_POINT ? 6 : 1;
        map->tangent = light->kind == VOXRT_GI_POINT ? 1.0f : (float)(s / c);
        map->texel = (float *)voxrti_alloc_array(&gi->mem, (size_t)map->faces * map->side * map->side, 24);
        if (map->texel == NULL) {
            voxrti_gi_maps_free(gi);
            return voxrti_fail(d->env.error, VOXRT_ERR_NO_MEMORY, l, "no memory for the map of light %");
        }
        m.light = l;
        voxrti_parallel_for(&d->env, voxrti_task_gi_map, &m, map->faces * map->side);
    }
    return VOXRT_OK;
}

/* Defaults, and what is out of range. */
static voxrt_result voxrti_gi_render_open(const voxrt_gi_render_desc *desc, voxrt_gi *gi, const voxrt_gbuffer *g,
                                          voxrt_gi_render_desc *d, voxrti_gather *w) {
    int ok;
    memset(w, 0, sizeof *w);
    if (desc != NULL) *d = *desc;
    else memset(d, 0, sizeof *d);
    if (d->_begin_zero != 0 || d->_end_zero != 0) return VOXRT_ERR_UNINIT_DESC;
    if (gi == NULL || g == NULL || (uint32_t)d->method > VOXRT_GI_VPL || (uint32_t)d->isa > 4u ||
        (uint32_t)d->lookup > VOXRT_GI_LOOKUP_MAPS) return VOXRT_ERR_INVALID_ARG;
    if (!(d->radius >= 0.0f) || !(d->shadow_lift >= 0.0f) || d->rays > 1u << 20 || d->bounces > 1u << 10 ||
        d->filter > 1u << 16 || d->direct_filter > 1u << 16)
        return voxrti_fail(d->env.error, VOXRT_ERR_INVALID_ARG, 0, "rays, bounces, radius or filter out of range");
    if (d->coarse > 16 || (d->coarse & (d->coarse - 1)) != 0 || d->pattern > 16 || !(d->detail >= 0.0f) ||
        !(d->d_min >= 0.0f) || !(d->relief >= 0.0f && d->relief <= 1.0f) || d->map_size > 4096 ||
        !(d->tolerance >= 0.0f) || !(d->keep >= 0.0f))
        return voxrti_fail(d->env.error, VOXRT_ERR_INVALID_ARG, 0, "coarse, pattern, detail or another out of range");
    if ((size_t)g->width * g->height == 0) return VOXRT_OK;
    if (g->position == NULL || g->normal == NULL || g->albedo == NULL || g->width > 65535 || g->height > 65535)
        return voxrti_fail(d->env.error, VOXRT_ERR_INVALID_ARG, 0, "no G-buffer, or a side over 65535");
    if (d->pattern == 0) d->pattern = 4;
    if (d->method == VOXRT_GI_VPL) {
        if (d->pattern != 1) d->coarse = 0;
        d->tolerance = 0.0f;
    }
    if (d->rays == 0) d->rays = d->tolerance > 0.0f ? 1024 : 16;
    if (d->map_size == 0) d->map_size = 256;
    w->d = d;
    w->gi = gi;
    w->g = g;
    w->rays = d->tolerance > 0.0f && d->rays > 16 ? 16 : d->rays;
    w->first = d->first_ray;
    for (w->share = 0; w->rays > 1u << w->share; w->share++) { }
    w->direct_share = w->share;
    if (d->filter == 0) w->share = 32;
    if (d->direct_filter == 0 && d->history != NULL) w->direct_share = 32;
    w->bounces = (d->method == VOXRT_GI_PATH || d->method == VOXRT_GI_VPL) && d->bounces != 0 ? d->bounces : 1;
    w->radius = d->radius > 0.0f ? d->radius : voxrti_gi_reach(gi);
    w->isa = (int)voxrt_isa_best();
    if (d->isa != VOXRT_ISA_AUTO && (int)d->isa < w->isa) w->isa = (int)d->isa;
    ok = voxrti_frame_open(&d->camera, g->height, &w->frame) == VOXRT_OK;
    if (!ok && (d->history != NULL || d->relief > 0.0f))
        return voxrti_fail(d->env.error, VOXRT_ERR_INVALID_ARG, 0, "a history, or relief, needs the camera");
    return VOXRT_OK;
}

VOXRT_DEF voxrt_result voxrt_gi_render(const voxrt_gi_render_desc *desc, voxrt_gi *gi, const voxrt_gbuffer *gbuffer,
                                       float *direct, float *indirect, voxrt_stats *stats) {
    voxrt_gi_render_desc d;
    voxrt_gi_report report;
    voxrti_gather w;
    voxrti_mem mem;
    voxrti_reuse reuse;
    float *value[4] = {NULL, NULL, NULL, NULL};
    voxrt_result r = voxrti_gi_render_open(desc, gi, gbuffer, &d, &w);
    size_t n, i;
    uint32_t k, turns = 0, opened = 0;
    memset(&reuse, 0, sizeof reuse);
    memset(&report, 0, sizeof report);
    if (r == VOXRT_OK && d.report != NULL) *d.report = report;
    if (r != VOXRT_OK || w.d == NULL) return r;
    r = voxrti_env_open(&d.env, &mem);
    if (r != VOXRT_OK) return r;
    n = (size_t)gbuffer->width * gbuffer->height;
    value[0] = indirect;
    value[2] = direct;
    if (indirect != NULL && d.method == VOXRT_GI_NONE) {
        memset(indirect, 0, n * 12);
        value[0] = NULL;
    }
    for (k = 1; k < 4 && gbuffer->specular != NULL && d.method != VOXRT_GI_AO; k += 2) {
        if (value[k - 1] == NULL) continue;
        value[k] = (float *)voxrti_alloc_array(&mem, n, 12);
        if (value[k] == NULL) r = voxrti_fail(d.env.error, VOXRT_ERR_NO_MEMORY, n, "no memory for lobes of % pixels");
    }
    w.indirect = value[0];
    w.gloss = value[1];
    w.direct = value[2];
    w.direct_gloss = value[3];
    w.want_stats = stats != NULL;
    if (r == VOXRT_OK && d.history != NULL) {
        const float *const wanted[4] = {value[0], value[1], value[2], value[3]};
        opened = 1;
        turns = d.history->turns;
        r = voxrti_reuse_open(&w, wanted, &reuse);
        w.first += d.history->turns * d.rays;
    }
    if (r == VOXRT_OK) r = voxrti_gi_prepare(&d, gi, w.isa);
    if (r == VOXRT_OK && direct != NULL)
        voxrti_parallel_for(&d.env, voxrti_task_direct, &w, ((gbuffer->width + 7) / 8) * ((gbuffer->height + 7) / 8));
    if (r == VOXRT_OK && value[0] != NULL) {
        d.first_ray = w.first;
        r = voxrti_gather_all(&w, gi, &mem, &report);
    }
    for (i = 0; i < n; i++) report.pixels += (uint64_t)voxrti_pixel_seen(gbuffer, i);
    if (r == VOXRT_OK && reuse.h != NULL) {
        voxrti_reuse_run(&reuse, value);
        report.kept = report.pixels != 0 ? reuse.h->kept / (float)report.pixels : 0.0f;
    } else if (d.history != NULL && opened) {
        d.history->turns = turns; /* there was no picture */
    }
    for (k = 0; k < 4 && r == VOXRT_OK; k++) {
        const uint32_t radius = k < 2 ? d.filter : d.direct_filter;
        if (value[k] != NULL && radius != 0)
            r = voxrti_gi_filter_run(&d.env, gbuffer, gi->columns->diagonal, radius, value[k], &mem);
    }
    for (k = 0; k < 4 && r == VOXRT_OK; k += 2) {
        voxrti_combine c;
        if (value[k] == NULL) continue;
        c.g = gbuffer;
        c.value = value[k];
        c.gloss = value[k + 1];
        c.ao = k == 0 && d.method == VOXRT_GI_AO;
        c.emit = k == 2;
        c.relief = k == 0 ? d.relief : 0.0f;
        memcpy(c.eye, w.frame.eye, sizeof c.eye);
        voxrti_parallel_for(&d.env, voxrti_task_combine, &c, gbuffer->height);
    }
    voxrti_free(&mem, value[1]);
    voxrti_free(&mem, value[3]);
    if (stats != NULL) {
        stats->rays += voxrti_tally(w.sum[0]);
        stats->hits += voxrti_tally(w.sum[1]);
        stats->steps += voxrti_tally(w.sum[2]);
    }
    if (d.report != NULL) *d.report = report;
    return r;
}

VOXRT_DEF int voxrt_gi_budget_update(voxrt_gi_budget *budget, const voxrt_gi_report *report, float frame_ms,
                                     float light_ms, float target_ms) {
    uint32_t rays, coarse, most;
    double each, room, full;
    if (budget == NULL) return 0;
    most = budget->most != 0 ? budget->most : 64;
    coarse = budget->coarse != 0 ? budget->coarse : 1;
    if (report == NULL || !(frame_ms > 0.0f) || !(light_ms > 0.0f) || !(target_ms > 0.0f) || !(frame_ms < INFINITY) ||
        report->shaded == 0 || report->rays == 0) {
        if (budget->rays == 0) budget->rays = 4;
        if (budget->coarse == 0) budget->coarse = 1;
        return 0;
    }
    each = (double)light_ms / ((double)report->shaded * (double)report->rays);
    if (budget->_ray_ms > 0.0f) each = 0.5 * (each + (double)budget->_ray_ms); /* frames differ */
    budget->_ray_ms = (float)each;
    room = (double)target_ms - ((double)frame_ms - (double)light_ms);
    if (room < 0.1 * (double)target_ms) room = 0.1 * (double)target_ms;
    full = room / (each * (double)(report->pixels != 0 ? report->pixels : report->shaded)); /* rays for every pixel */
    if (full >= 4.0) { /* one pixel in four, and 16 rays of each, is no cheaper */
        coarse = 1;
        rays = full < (double)most ? (uint32_t)full : most;
    } else { /* at least 4 rays, from fewer pixels; how many fewer is seen in the next report */
        const double left = room / each / (double)report->shaded;
        rays = left < 4.0 ? 4 : left < (double)most ? (uint32_t)left : most;
        if (left < 4.0 && coarse < 16) coarse *= 2;
        else if (left >= 16.0 && coarse > 2) {
            coarse /= 2; /* up to four times as many pixels */
            rays /= 4;
        }
    }
    if (rays == budget->rays && coarse == budget->coarse) return 0;
    budget->rays = rays;
    budget->coarse = coarse;
    return 1;
}

/* ---- bounces ---- */

typedef struct voxrti_bounce {
    const voxrt_gi *gi;    /* one of the nested volumes */
    voxrti_gather gather;
    voxrt_gi_render_desc desc;
    uint32_t *next;        /* the new values */
    uint32_t layer, seed;
    float weight;
} voxrti_bounce;

static void voxrti_bounce_flush(const voxrti_bounce *b, voxrti_points *q, const size_t *at) {
    const voxrti_gi_layer *l = &b->gi->layer[b->layer];
    const float scale = 3.14159265f / (float)(int32_t)b->gather.rays;
    float rgb[VOXRTI_COLUMN_BATCH][3], old[3];
    uint32_t i, a;
    memset(rgb, 0, sizeof rgb);
    voxrti_gather_run(&b->gather, q, rgb, NULL, NULL);
    for (i = 0; i < q->count; i++) {
        const uint32_t known = l->bounce[at[i]];
        if (known != VOXRTI_GI_UNKNOWN) voxrti_rgb9e5_decode(known, old);
        for (a = 0; a < 3; a++) {
            rgb[i][a] *= scale;
            if (known != VOXRTI_GI_UNKNOWN) rgb[i][a] = old[a] + (rgb[i][a] - old[a]) * b->weight;
        }
        b->next[at[i]] = voxrti_rgb9e5(rgb[i]);
    }
    q->count = 0;
}

/* Both sides of the cells in a row of columns. */
static void voxrti_task_bounce(void *ctx, uint32_t y) {
    const voxrti_bounce *b = (const voxrti_bounce *)ctx;
    const voxrt_columns *c = b->gi->columns;
    const voxrti_gi_layer *l = &b->gi->layer[b->layer];
    voxrti_points q;
    size_t at[VOXRTI_COLUMN_BATCH], rec = l->base[(size_t)y << c->row_log[0]];
    uint32_t x, w, side, i;
    memset(at, 0, sizeof at);
    q.count = 0;
    q.share = 32;
    for (x = 0; x < c->size[0]; x++)
        for (w = 0; w < c->words; w++) {
            uint32_t bits = l->bits[voxrti_column(c, 0, x, y) + w];
            for (; bits != 0; bits &= bits - 1, rec++)
                for (side = 0; side < 2; side++) {
                    const uint32_t cell[3] = {x, y, 32 * w + voxrti_ctz64(bits)};
                    if (l->record[rec].area[side] == 0) continue;
                    i = q.count++;
                    at[i] = 2 * rec + side;
                    voxrti_gi_side_place(b->gi, &l->record[rec], side, cell, q.p[i], q.n[i]);
                    q.exponent[i] = 0.0f;
                    q.place[i] = 0;
                    q.seed[i] = voxrti_hash32((uint32_t)at[i] * 2u + b->layer) ^ b->seed;
                    if (q.count == VOXRTI_COLUMN_BATCH) voxrti_bounce_flush(b, &q, at);
                }
        }
    if (q.count != 0) voxrti_bounce_flush(b, &q, at);
}

VOXRT_DEF voxrt_result voxrt_gi_bounce(voxrt_gi *gi, const voxrt_env *env, uint32_t rays, float weight, uint32_t seed) {
    voxrti_bounce b;
    voxrt_gi *g;
    uint32_t *next[8][2], l, k;
    voxrt_result r = VOXRT_OK;
    if (gi == NULL || !(weight >= 0.0f && weight <= 1.0f) || rays > 1u << 20) return VOXRT_ERR_INVALID_ARG;
    memset(&b, 0, sizeof b);
    memset(next, 0, sizeof next);
    if (env != NULL) b.desc.env = *env;
    b.weight = weight > 0.0f ? weight : 1.0f;
    b.seed = voxrti_hash32(seed);
    b.gather.d = &b.desc;
    b.gather.gi = gi;
    b.gather.rays = rays != 0 ? rays : 16;
    b.gather.bounces = 1;
    b.gather.radius = voxrti_gi_reach(gi);
    b.gather.isa = (int)voxrt_isa_best();
    for (g = gi, k = 0; g != NULL; g = g->outer, k++)
        for (l = 0; l < 2 && r == VOXRT_OK; l++) {
            if (g->layer[l].count == 0) continue;
            next[k][l] = (uint32_t *)voxrti_alloc_array(&g->mem, g->layer[l].count, 8);
            if (next[k][l] == NULL)
                r = voxrti_fail(b.desc.env.error, VOXRT_ERR_NO_MEMORY, g->layer[l].count,
                                "no memory for light on % cells");
            else memset(next[k][l], 255, g->layer[l].count * 8);
        }
    for (g = gi, k = 0; g != NULL; g = g->outer, k++)
        for (l = 0; l < 2 && r == VOXRT_OK; l++) {
            if (g->layer[l].count == 0) continue;
            b.gi = g;
            b.layer = l;
            b.next = next[k][l];
            voxrti_parallel_for(&b.desc.env, voxrti_task_bounce, &b, g->columns->size[1]);
        }
    for (g = gi, k = 0; g != NULL; g = g->outer, k++)
        for (l = 0; l < 2; l++) {
            if (r == VOXRT_OK && next[k][l] != NULL) memcpy(g->layer[l].bounce, next[k][l], g->layer[l].count * 8);
            voxrti_free(&g->mem, next[k][l]);
        }
    return r;
}

/* ---- G-buffers ---- */

typedef struct voxrti_gbuffer_work {
    const voxrt_gbuffer *g;
    const voxrt_geometry *geometry;
    const voxrt_gi *gi;
    voxrti_frame frame;
    uint32_t tiles_x;
    voxrti_srgb srgb;
} voxrti_gbuffer_work;

static void voxrti_task_gbuffer(void *ctx, uint32_t tile) {
    const voxrti_gbuffer_work *w = (const voxrti_gbuffer_work *)ctx;
    const voxrt_gbuffer *g = w->g;
    const uint32_t x0 = tile % w->tiles_x * 8, y0 = tile / w->tiles_x * 8;
    voxrt_ray ray[VOXRTI_COLUMN_BATCH];
    voxrt_surface surface[VOXRTI_COLUMN_BATCH];
    voxrt_column_hit hit[VOXRTI_COLUMN_BATCH];
    const voxrt_gi *where[VOXRTI_COLUMN_BATCH];
    size_t pixel[VOXRTI_COLUMN_BATCH];
    uint32_t x, y, i, a, n = 0;
    memset(hit, 0, sizeof hit);
    for (y = y0; y < y0 + 8 && y < g->height; y++)
        for (x = x0; x < x0 + 8 && x < g->width; x++) {
            const double px = (double)x + 0.5 - 0.5 * (double)g->width, py = 0.5 * (double)g->height - (double)y - 0.5;
            for (a = 0; a < 3; a++) {
                ray[n].org[a] = w->frame.eye[a];
                ray[n].dir[a] = (float)(w->frame.forward[a] + px * w->frame.right[a] + py * w->frame.up[a]);
            }
            ray[n].t_min = 0.0f;
            ray[n].t_max = INFINITY;
            pixel[n++] = (size_t)y * g->width + x;
        }
    if (w->geometry != NULL) {
        voxrt_trace_desc d;
        memset(&d, 0, sizeof d);
        w->geometry->trace_fn(w->geometry->user, &d, ray, surface, n);
    } else {
        voxrti_gi_trace(w->gi, (int)voxrt_isa_best(), NULL, NULL, ray, n, hit, where, NULL, NULL);
    }
    for (i = 0; i < n; i++) {
        const size_t at = 3 * pixel[i];
        float normal[3] = {0, 0, 0}, facing, length;
        float t = INFINITY;
        if (g->emission != NULL) g->emission[at] = g->emission[at + 1] = g->emission[at + 2] = 0.0f;
        if (g->specular != NULL) memset(g->specular + 4 * pixel[i], 0, 16);
        for (a = 0; a < 3; a++) g->position[at + a] = g->albedo[at + a] = g->normal[at + a] = 0.0f;
        if (g->before != NULL) memset(g->before + at, 0, 12);
        if (w->geometry != NULL) {
            t = surface[i].t;
            memcpy(normal, surface[i].normal, sizeof normal);
            if (t < INFINITY && voxrti_dot3(normal, normal) < 0.25f && surface[i].face < 6)
                normal[surface[i].face >> 1] = (surface[i].face & 1u) ? 1.0f : -1.0f;
            for (a = 0; a < 3 && t < INFINITY; a++) g->albedo[at + a] = w->srgb.linear[surface[i].rgb[a]];
        } else if (hit[i].t < INFINITY) {
            voxrti_gi_side s;
            t = hit[i].t;
            if (voxrti_gi_side_open(where[i], hit[i].cell[0], hit[i].cell[1], hit[i].cell[2], ray[i].dir, &s)) {
                t = voxrti_gi_side_meet(&s, &ray[i], t); /* the surface, not the cell's face */
                memcpy(normal, s.normal, sizeof normal);
                memcpy(g->albedo + at, s.albedo, sizeof s.albedo);
            }
        }
        if (!(t < INFINITY) || !voxrti_normalize(normal)) continue;
        length = sqrtf(voxrti_dot3(ray[i].dir, ray[i].dir));
        facing = voxrti_dot3(normal, ray[i].dir) / length;
        if (facing > 0.5f) { /* the back of a surface */
            for (a = 0; a < 3; a++) normal[a] = 0.0f - normal[a];
        } else if (facing > -0.01f) { /* a voxel of the outline, whose mean normal leans over: just in sight */
            for (a = 0; a < 3; a++) normal[a] -= (facing + 0.01f) / length * ray[i].dir[a];
            (void)voxrti_normalize(normal);
        }
        for (a = 0; a < 3; a++) {
            g->position[at + a] = ray[i].org[a] + t * ray[i].dir[a];
            if (g->before != NULL) g->before[at + a] = g->position[at + a];
            g->normal[at + a] = normal[a];
        }
    }
}

static voxrt_result voxrti_gbuffer_run(const voxrt_env *env, const voxrt_camera *camera, const voxrt_geometry *geometry,
                                       const voxrt_gi *gi, const voxrt_gbuffer *g) {
    voxrti_gbuffer_work w;
    voxrt_env none;
    voxrt_result r;
    memset(&none, 0, sizeof none);
    if (camera == NULL || g == NULL || (geometry == NULL && gi == NULL)) return VOXRT_ERR_INVALID_ARG;
    if (g->width == 0 || g->height == 0) return VOXRT_OK;
    if (g->position == NULL || g->normal == NULL || g->albedo == NULL || g->width > 65535 || g->height > 65535)
        return VOXRT_ERR_INVALID_ARG;
    memset(&w, 0, sizeof w);
    w.g = g;
    w.geometry = geometry;
    w.gi = gi;
    w.tiles_x = (g->width + 7) / 8;
    voxrti_srgb_open(&w.srgb);
    r = voxrti_frame_open(camera, g->height, &w.frame);
    if (r != VOXRT_OK) return r;
    voxrti_parallel_for(env != NULL ? env : &none, voxrti_task_gbuffer, &w, w.tiles_x * ((g->height + 7) / 8));
    return VOXRT_OK;
}

VOXRT_DEF voxrt_result voxrt_gbuffer_from_geometry(const voxrt_env *env, const voxrt_camera *camera,
                                                   const voxrt_geometry *geometry, const voxrt_gbuffer *gbuffer) {
    return geometry != NULL ? voxrti_gbuffer_run(env, camera, geometry, NULL, gbuffer) : VOXRT_ERR_INVALID_ARG;
}
VOXRT_DEF voxrt_result voxrt_gbuffer_from_gi(const voxrt_env *env, const voxrt_camera *camera, const voxrt_gi *gi,
                                             const voxrt_gbuffer *gbuffer) {
    return gi != NULL ? voxrti_gbuffer_run(env, camera, NULL, gi, gbuffer) : VOXRT_ERR_INVALID_ARG;
}

/* ---- what a G-buffer does not know ---- */

/* The object whose surface lies at p with normal n: of the cell there, or the nearest that touches it. */
static const voxrti_gi_entry *voxrti_gi_entry_at(const voxrt_gi *gi, const float p[3], const float n[3]) {
    const voxrt_columns *c;
    const voxrti_gi_entry *found = NULL;
    double at[3];
    float best = INFINITY;
    uint32_t a, i, side;
    for (; gi != NULL; gi = gi->outer) {
        c = gi->columns;
        for (a = 0; a < 3; a++) {
            at[a] = ((double)p[c->axis[a]] - c->origin[a]) * c->per_cell[a];
            if (!(at[a] >= 0.0 && at[a] < (double)c->size[a])) break;
        }
        if (a == 3) break;
    }
    if (gi == NULL) return NULL;
    for (i = 0; i < 27; i++) {
        uint32_t cell[3], layer;
        size_t r;
        for (a = 0; a < 3; a++) {
            const int64_t q = voxrti_floor(at[a]) + (int64_t)(a == 0 ? i % 3 : a == 1 ? i / 3 % 3 : i / 9) - 1;
            if (q < 0 || q >= (int64_t)c->size[a]) break;
            cell[a] = (uint32_t)q;
        }
        if (a < 3 || (r = voxrti_gi_find(gi, cell[0], cell[1], cell[2], &layer)) == (size_t)-1) continue;
        for (side = 0; side < 2; side++) {
            const voxrti_gi_record *rec = &gi->layer[layer].record[r];
            float s[3], m[3], d = 0.0f;
            if (rec->area[side] == 0) continue;
            voxrti_gi_side_place(gi, rec, side, cell, s, m);
            if (!(voxrti_dot3(m, n) > 0.3f)) continue;
            for (a = 0; a < 3; a++) d += (s[a] - p[a]) * (s[a] - p[a]);
            if (!(d < best)) continue;
            best = d;
            found = &gi->entry[rec->object[side]];
        }
    }
    return found;
}

typedef struct voxrti_edge_work { const voxrt_gi *gi; const voxrt_gbuffer *g; voxrti_frame frame; } voxrti_edge_work;

/* Is n, but for a little, a mix of two normals that differ? */
VOXRTI_INLINE int voxrti_normal_mixed(const float n[3], const float f[3], const float g[3]) {
    const float c = voxrti_dot3(f, g), a = voxrti_dot3(n, f), b = voxrti_dot3(n, g);
    const float pa = (a - b * c) / (1.0f - c * c), pb = (b - a * c) / (1.0f - c * c);
    return voxrti_absf(c) < 0.8f && pa > 0.05f && pb > 0.05f && pa * a + pb * b > 0.97f;
}

/* The surface of the cells around p that a pixel at an edge shows: to_eye is from p to the camera, unit length. 0: its
   normal n may stay. */
static int voxrti_edge_normal(const voxrt_gi *gi, const float p[3], const float n[3], const float to_eye[3],
                              float out[3]) {
    const int outline = voxrti_dot3(n, to_eye) < 0.02f; /* it faces away, and was turned until it did not */
    double at[3];
    float face[54][3], best = 0.0f, wide;
    uint32_t a, i, k, side, layer, count = 0, found = 0, cell[3];
    size_t r;
    for (; gi != NULL; gi = gi->outer) {
        for (a = 0; a < 3; a++) {
            at[a] = ((double)p[gi->columns->axis[a]] - gi->columns->origin[a]) * gi->columns->per_cell[a];
            if (!(at[a] >= 0.0 && at[a] < (double)gi->columns->size[a])) break;
            cell[a] = (uint32_t)at[a];
        }
        if (a == 3) break;
    }
    if (gi == NULL) return 0;
    r = voxrti_gi_find(gi, cell[0], cell[1], cell[2], &layer);
    for (side = 0; side < 2 && r != (size_t)-1 && !outline; side++) { /* most pixels */
        if (gi->layer[layer].record[r].area[side] == 0) continue;
        voxrti_oct_decode(gi->layer[layer].record[r].normal[side], face[0]);
        if (voxrti_dot3(face[0], n) > 0.95f) return 0;
    }
    wide = 0.6f * (float)gi->columns->diagonal;
    for (i = 0; i < 27; i++) { /* surfaces near by whose planes go past p */
        for (a = 0; a < 3; a++) {
            const int64_t q = voxrti_floor(at[a]) + (int64_t)(a == 0 ? i % 3 : a == 1 ? i / 3 % 3 : i / 9) - 1;
            if (q < 0 || q >= (int64_t)gi->columns->size[a]) break;
            cell[a] = (uint32_t)q;
        }
        if (a < 3 || (r = voxrti_gi_find(gi, cell[0], cell[1], cell[2], &layer)) == (size_t)-1) continue;
        for (side = 0; side < 2; side++) {
            float place[3], d[3];
            if (gi->layer[layer].record[r].area[side] == 0) continue;
            voxrti_gi_side_place(gi, &gi->layer[layer].record[r], side, cell, place, face[count]);
            for (a = 0; a < 3; a++) d[a] = p[a] - place[a];
            if (voxrti_absf(voxrti_dot3(d, face[count])) > wide) continue;
            if (!outline && voxrti_dot3(face[count], n) > 0.95f) return 0;
            count++;
        }
    }
    for (i = 0; i < count; i++) {
        const float seen = voxrti_dot3(to_eye, face[i]);
        if (!(seen > best + 1e-4f)) continue;
        for (k = 0; k < count; k++) /* of two that make n; or of a surface that is not the one seen from behind */
            if (outline ? k == i && voxrti_absf(voxrti_dot3(n, face[i])) < 0.8f :
                voxrti_normal_mixed(n, face[i], face[k])) break;
        if (k == count) continue;
        best = seen;
        found = 1;
        memcpy(out, face[i], sizeof face[i]);
    }
    return (int)found;
}

static void voxrti_task_edges(void *ctx, uint32_t y) {
    const voxrti_edge_work *w = (const voxrti_edge_work *)ctx;
    const voxrt_gbuffer *g = w->g;
    size_t at = (size_t)y * g->width, end = at + g->width;
    uint32_t a;
    for (; at < end; at++) {
        float to[3], n[3];
        if (!voxrti_pixel_seen(g, at)) continue;
        for (a = 0; a < 3; a++) to[a] = w->frame.eye[a] - g->position[3 * at + a];
        if (!voxrti_normalize(to)) continue;
        if (voxrti_edge_normal(w->gi, g->position + 3 * at, g->normal + 3 * at, to, n))
            memcpy(g->normal + 3 * at, n, sizeof n);
    }
}

VOXRT_DEF voxrt_result voxrt_gbuffer_edges(const voxrt_env *env, const voxrt_camera *camera, const voxrt_gi *gi,
                                           const voxrt_gbuffer *gbuffer) {
    voxrti_edge_work w;
    voxrt_env none;
    voxrt_result r;
    if (gi == NULL || gbuffer == NULL || camera == NULL) return VOXRT_ERR_INVALID_ARG;
    if (gbuffer->width == 0 || gbuffer->height == 0) return VOXRT_OK;
    if (gbuffer->position == NULL || gbuffer->normal == NULL || gbuffer->width > 65535 || gbuffer->height > 65535)
        return VOXRT_ERR_INVALID_ARG;
    memset(&none, 0, sizeof none);
    w.gi = gi;
    w.g = gbuffer;
    r = voxrti_frame_open(camera, gbuffer->height, &w.frame);
    if (r == VOXRT_OK)
        voxrti_parallel_for(env != NULL ? env : &none, voxrti_task_edges, &w, gbuffer->height);
    return r;
}

typedef struct voxrti_material_work { const voxrt_gi *gi; const voxrt_gbuffer *g; } voxrti_material_work;

static void voxrti_task_materials(void *ctx, uint32_t y) {
    const voxrti_material_work *w = (const voxrti_material_work *)ctx;
    const voxrt_gbuffer *g = w->g;
    size_t at = (size_t)y * g->width, end = at + g->width;
    uint32_t a, b;
    for (; at < end; at++) {
        const float *p = g->position + 3 * at;
        const voxrti_gi_entry *e;
        if (!voxrti_pixel_seen(g, at)) continue;
        if (g->before != NULL) memcpy(g->before + 3 * at, p, 12);
        e = voxrti_gi_entry_at(w->gi, p, g->normal + 3 * at);
        if (e == NULL) continue;
        if (g->specular != NULL) memcpy(g->specular + 4 * at, e->specular, 16);
        if (g->emission != NULL) memcpy(g->emission + 3 * at, e->emission, 12);
        for (a = 0; a < 3 && g->before != NULL && e->moved; a++) {
            double q = e->back[4 * a + 3];
            for (b = 0; b < 3; b++) q += e->back[4 * a + b] * (double)p[b];
            g->before[3 * at + a] = (float)q;
        }
    }
}

VOXRT_DEF voxrt_result voxrt_gbuffer_materials(const voxrt_env *env, const voxrt_gi *gi, const voxrt_gbuffer *gbuffer) {
    voxrti_material_work w;
    voxrt_env none;
    if (gi == NULL || gbuffer == NULL) return VOXRT_ERR_INVALID_ARG;
    if (gbuffer->width == 0 || gbuffer->height == 0) return VOXRT_OK;
    if (gbuffer->position == NULL || gbuffer->normal == NULL || gbuffer->width > 65535 || gbuffer->height > 65535)
        return VOXRT_ERR_INVALID_ARG;
    memset(&none, 0, sizeof none);
    w.gi = gi;
    w.g = gbuffer;
    voxrti_parallel_for(env != NULL ? env : &none, voxrti_task_materials, &w, gbuffer->height);
    return VOXRT_OK;
}

/* ---- tone mapping ---- */

VOXRT_DEF voxrt_result voxrt_tone_map(voxrt_tone tone, float most, const float *rgb, float *out_rgb, size_t pixels) {
    const double inv = 1.0 / (double)most, log_most = voxrti_log2(1.0 + (double)most);
    size_t i;
    if ((uint32_t)tone > VOXRT_TONE_DRAGO || !(most > 0.0f) || !voxrti_finite_f(most)) return VOXRT_ERR_INVALID_ARG;
    if (pixels != 0 && (rgb == NULL || out_rgb == NULL)) return VOXRT_ERR_INVALID_ARG;
    for (i = 0; i < pixels; i++) {
        double y = 0.0, scale = inv;
        uint32_t a;
        static const double weight[3] = {0.2126, 0.7152, 0.0722};
        for (a = 0; a < 3; a++) y += weight[a] * voxrti_max(0.0, (double)rgb[3 * i + a]);
        if (!voxrti_finite(y)) y = (double)most;
        if (y > 0.0 && tone == VOXRT_TONE_LOG) scale = voxrti_log2(1.0 + y) / (log_most * y);
        if (y > 0.0 && tone == VOXRT_TONE_DRAGO) { /* bias 0.85: exponent ln(b) / ln(0.5) */
            const double bias = voxrti_pow(y * inv, 0.23446525363702297);
            scale = voxrti_log2(1.0 + y) / (voxrti_log2(2.0 + 8.0 * bias) * (log_most / voxrti_log2(10.0)) * y);
        }
        for (a = 0; a < 3; a++) {
            const double v = (double)rgb[3 * i + a] * scale;
            out_rgb[3 * i + a] = (float)(v > 0.0 ? (v < 1.0 ? v : 1.0) : 0.0);
        }
    }
    return VOXRT_OK;
}
#endif /* VOXRT_NO_GI */

/* ---------------------------------------------------------------------------
   misc: names and versions.                                                     // >>misc
   --------------------------------------------------------------------------- */

VOXRT_DEF const char *voxrt_result_string(voxrt_result result) {
    switch (result) {
#define VOXRTI_X(name, value, text) case VOXRT_##name: return text;
    VOXRT_RESULT_LIST(VOXRTI_X)
#undef VOXRTI_X
    case VOXRT_RESULT_FORCE_32BIT: break;
    }
    return "unknown result";
}

VOXRT_DEF uint32_t voxrt_version(void) { return VOXRT_VERSION; }

VOXRT_DEF const char *voxrt_isa_name(voxrt_isa isa) {
    switch (isa) {
    case VOXRT_ISA_AUTO: return "auto";
    case VOXRT_ISA_SCALAR: return "scalar";
    case VOXRT_ISA_SSE: return "sse";
    case VOXRT_ISA_AVX2: return "avx2";
    case VOXRT_ISA_AVX512: return "avx512";
    case VOXRT_ISA_FORCE_32BIT: break;
    }
    return "unknown";
}

/* For trees AVX-512 gains 3 to 6 % over the AVX2 kernel with 1.6 times its code: there is none. */
VOXRT_DEF voxrt_isa voxrt_isa_best(void) {
    int level = voxrti_cpu_level();
    if (level >= 3 && VOXRTI_AVX2) return VOXRT_ISA_AVX2;
    return level >= 2 ? VOXRT_ISA_SSE : VOXRT_ISA_SCALAR;
}

#ifdef __cplusplus
}
#endif
#if defined(__GNUC__) && !defined(__clang__)
#  pragma GCC pop_options
#endif
#endif /* VOXRT_IMPLEMENTATION */

/*
Choose either licence.

MIT License

Copyright (c) 2026 the voxrt authors

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
