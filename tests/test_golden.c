/* test_golden.c - results that are promised to be equal everywhere, as hashes that are written down here: for each instruction
   set that the machine has, for one thread and two, for every compiler, machine and order of bytes, as C and as C++.
   Inputs are made of integers, powers of two, division and square roots alone: no sum of products that rounds, which some
   compilers fuse, and nothing of libm.
   A hash that changes with a new algorithm is set to what -v prints, after a look at why it changed.
   SPDX-License-Identifier: MIT OR Unlicense */
#include "test.h"
#define VOXRT_IMPLEMENTATION
#include "../voxrt.h"
#define ZBUFRAND_IMPLEMENTATION
#include "../zbufrand.h"
#define TETCAST_IMPLEMENTATION
#include "../tetcast.h"
#include "tets.h"

#define GOLDEN_LIST(X) \
    X(VOXRT_TREE, 0xe5c7d6a280236731) \
    X(VOXRT_RAW_FILE, 0xeb2fc7f7ab8d9cef) \
    X(VOXRT_PALETTE, 0xef8dc695a2f0e4b6) \
    X(VOXRT_THESIS, 0x51b76a8621ed5d6e) \
    X(VOXRT_PLANES, 0x357e6b60b48a3ff7) \
    X(VOXRT_FILLED, 0x3a29806768af5cfb) \
    X(VOXRT_SHARED, 0x8184c9e07c99915d) \
    X(VOXRT_V4_FILE, 0x87bac96debcbd2d9) \
    X(VOXRT_HITS, 0x26c7ca51baa623ac) \
    X(VOXRT_CONES, 0x28b5fb2493a2a5f8) \
    X(VOXRT_PLANE_HITS, 0x60fabffab0437afe) \
    X(VOXRT_OCTREE_HITS, 0x70e3b44e1d6d213a) \
    X(VOXRT_PICTURE, 0x7c3131f694bd18ae) \
    X(VOXRT_GLASS_PICTURE, 0xe92462c0825a805f) \
    X(VOXRT_BLURRED, 0x00cd0e4965ebd8ff) \
    X(VOXRT_EDITED, 0x958fecccdd12e848) \
    X(VOXRT_PAGED_FILE, 0xe3209d9d985da196) \
    X(VOXRT_PAGED_PICTURE, 0xd3c40ae0431ca63e) \
    X(VOXRT_COLUMN_HITS, 0x00a2fa880da95b8f) \
    X(VOXRT_GI_FRAMES, 0xf84d60186c9b9d2e) \
    X(VOXRT_GI_WAYS, 0x997738bc1fed236a) \
    X(VOXRT_TONES, 0x09633163be5ac5a7) \
    X(ZBUFRAND_POINTS, 0x924e8b66509a3e01) \
    X(ZBUFRAND_PICTURE, 0xc5316589c6bc86d2) \
    X(ZBUFRAND_SAMPLES, 0x0c3d17118e52dd78) \
    X(ZBUFRAND_RASTERED, 0xf197c6029749e545) \
    X(ZBUFRAND_OVERSAMPLED, 0x312e168309d05c6a) \
    X(ZBUFRAND_THESIS, 0x43700fb4d7d245f5) \
    X(ZBUFRAND_LISTS, 0x073b66ecfe4b092c) \
    X(ZBUFRAND_MEAN, 0x492448b5640a62b7) \
    X(ZBUFRAND_FILLS, 0x0676737e1ae6a77c) \
    X(ZBUFRAND_LAYERS, 0x2be09d015e727e5f) \
    X(ZBUFRAND_ACCUMULATED, 0x6ed73a2e32a28330) \
    X(ZBUFRAND_MENDED, 0x5f837822e0e82415) \
    X(ZBUFRAND_EDITED, 0x18c42eabaa378891) \
    X(ZBUFRAND_THEORY, 0x9d8d59a8e5c1eba8) \
    X(TETCAST_WALKED, 0xa8b9c0dca6b9def2) \
    X(TETCAST_PROJECTED, 0xfeafad46084409a1) \
    X(TETCAST_CELLS, 0x48fdfdf4cd2be3b9) \
    X(TETCAST_MORTON, 0xbc77945eea6007c7) \
    X(TETCAST_MODELS, 0x8ceb645653f09976) \
    X(TETCAST_INTEGRATORS, 0x8abe508bb7c9d412) \
    X(TETCAST_SHADED, 0x5f10756ee21b9bfc) \
    X(TETCAST_SURFACE, 0x839d6d19a99e2a63) \
    X(TETCAST_RESAMPLED, 0x9ff203b75e4e92cf) \
    X(TETCAST_MEANS, 0xeb66e7bfa954b098) \
    X(TETCAST_SECTION, 0xec50f3b477a8e74f) \
    X(TETCAST_BRICK_FILE, 0x7c211c4dc755c6dd) \
    X(TETCAST_BRICK_PICTURE, 0xa60322cb446fcc26) \
    X(TETCAST_AMR, 0x1f6ef42a36395516) \
    X(TETCAST_RBF_FILE, 0x66acbe81bda3f126) \
    X(TETCAST_RBF_VALUES, 0x79df52efdba4d083) \
    X(TETCAST_RBF_PICTURE, 0xd34ee0383845d60a) \
    X(TETCAST_TRACES, 0x8d236ab90943693a) \
    X(TETCAST_FOAM, 0x780ea6560b0d8c4d) \
    X(TETCAST_CODECS, 0x6fc1bc8884aee9f8)

typedef enum golden_name {
#define X(name, hash) GOLDEN_##name,
    GOLDEN_LIST(X)
#undef X
    GOLDEN_COUNT
} golden_name;
static const struct golden { const char *name; uint64_t hash; } golden[GOLDEN_COUNT] = {
#define X(name, hash) {#name, UINT64_C(hash)},
    GOLDEN_LIST(X)
#undef X
};

/* One way of computing: an instruction set and a number of threads. */
typedef struct way { uint32_t isa, threads; } way;

static uint32_t ways(uint32_t best, way out[5]) { /* the scalar one up to the best, with one thread; the default with two */
    const uint32_t last = best >= 3 ? 4 : best; /* some kernels have a wider one than the others' best */
    uint32_t n = 0, isa;
    for (isa = 1; isa <= last; isa++) {
        out[n].isa = isa;
        out[n++].threads = 1;
    }
    out[n].isa = 0;
    out[n++].threads = 2;
    return n;
}

static uint8_t golden_seen[GOLDEN_COUNT];

static void is_golden(golden_name k, uint64_t hash, const way *w) {
    CHECK_MSG(hash == golden[k].hash, "%s, isa %u, %u threads: 0x%016llx", golden[k].name, (unsigned)w->isa, (unsigned)w->threads,
              (unsigned long long)hash);
    if (test_g.verbose) printf("    X(%s, 0x%016llx) isa %u, threads %u\n", golden[k].name, (unsigned long long)hash, (unsigned)w->isa, (unsigned)w->threads);
    golden_seen[k] = 1;
}

/* Numbers as little-endian bytes. */
static uint64_t put_u32(uint64_t h, uint32_t v) {
    uint8_t b[4];
    uint32_t i;
    for (i = 0; i < 4; i++) b[i] = (uint8_t)(v >> 8 * i);
    return test_fnv1a(b, 4, h);
}
static uint64_t put_floats(uint64_t h, const float *v, size_t n) {
    size_t i;
    for (i = 0; i < n; i++) {
        uint32_t u;
        CHECK(v[i] == v[i]); /* NaN has many bits */
        memcpy(&u, v + i, 4);
        h = put_u32(h, u);
    }
    return h;
}
static uint64_t put_doubles(uint64_t h, const double *v, size_t n) {
    size_t i;
    for (i = 0; i < n; i++) {
        uint64_t u;
        CHECK(v[i] == v[i]);
        memcpy(&u, v + i, 8);
        h = put_u32(put_u32(h, (uint32_t)u), (uint32_t)(u >> 32));
    }
    return h;
}
static uint64_t put_u32s(uint64_t h, const uint32_t *v, size_t n) {
    size_t i;
    for (i = 0; i < n; i++) h = put_u32(h, v[i]);
    return h;
}

/* ---- a body: a cube of SIDE squares an edge, drawn out at its vertices, with colours and normals ---- */

enum { SIDE = 10, BODY_TRIANGLES = 6 * SIDE * SIDE * 2, BODY_VERTICES = 3 * BODY_TRIANGLES };
typedef struct body {
    float p[BODY_VERTICES][3], n[BODY_VERTICES][3];
    uint8_t rgb[BODY_VERTICES][3], finish[BODY_TRIANGLES];
} body;

static uint32_t mix(uint32_t v) {
    v = (v ^ v >> 16) * 0x45d9f3bu;
    v = (v ^ v >> 13) * 0xc2b2ae35u;
    return v ^ v >> 16;
}

/* Vertex k of the body at integers c, -SIDE to SIDE: its place is a multiple of 1/1024 and a function of c alone. */
static void body_vertex(body *b, uint32_t k, const int c[3]) {
    const uint32_t r = mix((uint32_t)(c[0] + 64) | (uint32_t)(c[1] + 64) << 8 | (uint32_t)(c[2] + 64) << 16);
    uint32_t a;
    for (a = 0; a < 3; a++) {
        b->p[k][a] = (float)(c[a] * (60 + (int)(r % 24))) / 1024.0f;
        b->n[k][a] = (float)(4 * c[a] + (int)(r >> (8 + 4 * a) & 15) - 8);
        b->rgb[k][a] = (uint8_t)(r >> 8 * a);
    }
}

static void body_make(body *b) {
    static const uint8_t corner[2][3] = {{0, 1, 3}, {0, 3, 2}};
    uint32_t k = 0, face, u, v, t, i;
    for (face = 0; face < 6; face++)
        for (v = 0; v < SIDE; v++)
            for (u = 0; u < SIDE; u++)
                for (t = 0; t < 2; t++) {
                    b->finish[k / 3] = (uint8_t)(face == 0 && u > 2 && v > 2 ? 1 : face == 5 && u < 7 && v < 7 ? 2 : 0);
                    for (i = 0; i < 3; i++) {
                        const uint32_t q = corner[t][face & 1 ? i : 2 - i], axis = face / 2;
                        int c[3];
                        c[axis] = face & 1 ? SIDE : -SIDE;
                        c[(axis + 1) % 3] = 2 * (int)(u + (q & 1)) - SIDE;
                        c[(axis + 2) % 3] = 2 * (int)(v + (q >> 1)) - SIDE;
                        body_vertex(b, k++, c);
                    }
                }
}

/* ---- voxrt.h ---- */

static voxrt_mesh voxel_mesh(const body *b) {
    voxrt_mesh m;
    memset(&m, 0, sizeof m);
    m.positions = b->p[0];
    m.vertex_count = BODY_VERTICES;
    m.triangle_count = BODY_TRIANGLES;
    m.normals = b->n[0];
    m.vertex_rgb = b->rgb[0];
    return m;
}

static uint64_t file_hash(const voxrt_tree *t, voxrt_encoding encoding) {
    voxrt_save_desc d;
    size_t size = 0;
    uint8_t *p;
    uint64_t h;
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    d.encoding = encoding;
    CHECK(voxrt_tree_save_memory(t, &d, NULL, 0, &size) == VOXRT_OK && size > 1000);
    p = (uint8_t *)malloc(size + 1);
    CHECK(p != NULL && voxrt_tree_save_memory(t, &d, p, size, &size) == VOXRT_OK);
    h = test_fnv1a(p, size, 0);
    free(p);
    return h;
}

static uint64_t put_hits(uint64_t h, const voxrt_hit *hit, size_t n) {
    size_t i;
    for (i = 0; i < n; i++) {
        h = put_u32s(put_floats(h, &hit[i].t, 1), hit[i].cell, 3);
        h = put_u32(h, hit[i].slot | (uint32_t)hit[i].level << 8 | (uint32_t)hit[i].face << 16 | (uint32_t)hit[i].plane << 24);
        h = put_u32(h, hit[i].node);
    }
    return h;
}

/* Rays from around a box of edge 2 into it, some along axes, some from one place. */
static void some_rays(voxrt_ray *rays, uint32_t n) {
    test_rng r = test_rng_make(1);
    uint32_t i, a;
    for (i = 0; i < n; i++) {
        for (a = 0; a < 3; a++) {
            rays[i].org[a] = i % 64 > 32 ? i % 64 > 40 ? 1.5f : -0.25f : (float)(int)test_rng_below(&r, 4096) / 1024.0f - 2.0f;
            rays[i].dir[a] = (float)((int)test_rng_below(&r, 2001) - 1000) / 512.0f;
            if (i % 64 > 40) rays[i].dir[a] -= 1.5f;
        }
        if (i % 64 < 32) for (a = 0; a < 3; a++) rays[i].dir[a] -= rays[i].org[a];
        if (i % 16 == 3) rays[i].dir[i / 16 % 3] = 0;
        if (i % 32 == 7) rays[i].dir[0] = rays[i].dir[1] = 0;
        if (rays[i].dir[2] == 0) rays[i].dir[2] = 1;
        rays[i].t_min = 0;
        rays[i].t_max = i % 16 == 5 ? 0.75f : INFINITY;
    }
}

typedef struct bytes { uint8_t *data; size_t size, room; } bytes;
static int sink_write(void *user, uint64_t offset, const void *from, size_t n) {
    bytes *b = (bytes *)user;
    const size_t end = (size_t)offset + n;
    if (end > b->room) {
        b->room = 2 * end;
        b->data = (uint8_t *)realloc(b->data, b->room);
        if (b->data == NULL) return 1;
    }
    if (end > b->size) b->size = end;
    memcpy(b->data + (size_t)offset, from, n);
    return 0;
}

enum { VW = 56, VH = 42 };
static uint64_t voxel_picture(const voxrt_render_desc *desc, const voxrt_tree *tree, int blurred) {
    static uint8_t bytes8[VW * VH * 4];
    static float rgba[VW * VH * 4], depth[VW * VH], normal[VW * VH * 3];
    static voxrt_hit hit[VW * VH];
    voxrt_image image;
    uint64_t h;
    memset(&image, 0, sizeof image);
    image.width = VW;
    image.height = VH;
    image.rgba8 = bytes8;
    image.rgba = rgba;
    image.depth = depth;
    image.normal = normal;
    image.hit = hit;
    CHECK(voxrt_render(desc, tree, &image, NULL) == VOXRT_OK);
    if (blurred) {
        voxrt_blur_desc b;
        memset(&b, 0, sizeof b);
        b.env = desc->env;
        CHECK(voxrt_blur(&b, &image) == VOXRT_OK);
        b.footprint = 1 / 64.0f;
        b.voxel_size = 1 / 32.0f;
        b.depth = 6;
        CHECK(voxrt_blur(&b, &image) == VOXRT_OK);
    }
    h = test_fnv1a(bytes8, sizeof bytes8, 0);
    h = put_floats(h, rgba, VW * VH * 4);
    h = put_floats(h, depth, VW * VH);
    return put_floats(h, normal, VW * VH * 3);
}

TEST(voxrt_trees) {
    static body b;
    voxrt_mesh m;
    way w[5];
    uint32_t k;
    const uint32_t n = ways((uint32_t)VOXRT_ISA_SCALAR, w); /* nothing to choose but threads */
    body_make(&b);
    m = voxel_mesh(&b);
    for (k = 0; k < n; k++) {
        voxrt_build_desc d;
        voxrt_tree *t = NULL, *u = NULL;
        voxrt_octree_desc od;
        voxrt_octree *o = NULL;
        bytes file;
        voxrt_sink sink;
        size_t size = 0;
        uint8_t *p;
        memset(&file, 0, sizeof file);
        memset(&od, 0, sizeof od);
        memset(&d, 0, sizeof d);
        d.env.thread_count = od.env.thread_count = w[k].threads;
        d.resolution = 56;
        REQUIRE(voxrt_tree_build(&d, &m, NULL, &t) == VOXRT_OK);
        is_golden(GOLDEN_VOXRT_TREE, file_hash(t, VOXRT_ENCODING_COMPACT) ^ voxrt_tree_hash(t), &w[k]);
        is_golden(GOLDEN_VOXRT_RAW_FILE, file_hash(t, VOXRT_ENCODING_RAW), &w[k]);
        REQUIRE(voxrt_tree_share(t, &d.env, &u) == VOXRT_OK);
        is_golden(GOLDEN_VOXRT_SHARED, file_hash(u, VOXRT_ENCODING_COMPACT), &w[k]);
        voxrt_tree_destroy(u);

        d.palette_size = 100;
        REQUIRE(voxrt_tree_build(&d, &m, NULL, &u) == VOXRT_OK);
        is_golden(GOLDEN_VOXRT_PALETTE, file_hash(u, VOXRT_ENCODING_COMPACT), &w[k]);
        REQUIRE(voxrt_octree_from_tree(&od, u, &o) == VOXRT_OK);
        CHECK(voxrt_octree_save_memory(o, &od.env, NULL, 0, &size) == VOXRT_OK);
        p = (uint8_t *)malloc(size + 1);
        REQUIRE(p != NULL && voxrt_octree_save_memory(o, &od.env, p, size, &size) == VOXRT_OK);
        is_golden(GOLDEN_VOXRT_V4_FILE, test_fnv1a(p, size, 0), &w[k]);
        free(p);
        voxrt_octree_destroy(o);
        voxrt_tree_destroy(u);

        d.palette_method = VOXRT_PALETTE_THESIS;
        d.separating = VOXRT_SEPARATING_THESIS;
        d.lod_method = VOXRT_LOD_MAJORITY;
        d.resolution = 32;
        REQUIRE(voxrt_tree_build(&d, &m, NULL, &u) == VOXRT_OK);
        is_golden(GOLDEN_VOXRT_THESIS, file_hash(u, VOXRT_ENCODING_COMPACT), &w[k]);
        voxrt_tree_destroy(u);

        memset(&d, 0, sizeof d);
        d.env.thread_count = w[k].threads;
        d.resolution = 40;
        d.planes = d.spread = 1;
        REQUIRE(voxrt_tree_build(&d, &m, NULL, &u) == VOXRT_OK);
        is_golden(GOLDEN_VOXRT_PLANES, file_hash(u, VOXRT_ENCODING_COMPACT), &w[k]);
        sink.write_fn = sink_write;
        sink.user = &file;
        REQUIRE(voxrt_paged_build(&d, &m, &sink, NULL) == VOXRT_OK);
        is_golden(GOLDEN_VOXRT_PAGED_FILE, test_fnv1a(file.data, file.size, 0), &w[k]);
        free(file.data);
        voxrt_tree_destroy(u);

        d.planes = d.spread = 0;
        d.fill = 1;
        d.fill_depth = 3;
        d.separating = VOXRT_SEPARATING_26;
        REQUIRE(voxrt_tree_build(&d, &m, NULL, &u) == VOXRT_OK);
        is_golden(GOLDEN_VOXRT_FILLED, file_hash(u, VOXRT_ENCODING_COMPACT), &w[k]);
        voxrt_tree_destroy(u);
        voxrt_tree_destroy(t);
    }
}

TEST(voxrt_rays) {
    enum { RAYS = 3000 };
    static body b;
    static voxrt_ray rays[RAYS];
    static voxrt_hit hits[RAYS];
    static uint8_t occluded[RAYS];
    voxrt_mesh m;
    voxrt_build_desc d;
    voxrt_tree *t = NULL, *planes = NULL;
    voxrt_octree_desc od;
    voxrt_octree *o = NULL;
    way w[5];
    uint32_t k, i;
    const uint32_t n = ways((uint32_t)voxrt_isa_best(), w);
    body_make(&b);
    m = voxel_mesh(&b);
    memset(&d, 0, sizeof d);
    memset(&od, 0, sizeof od);
    d.env.thread_count = od.env.thread_count = 1;
    d.resolution = 50;
    REQUIRE(voxrt_tree_build(&d, &m, NULL, &t) == VOXRT_OK);
    REQUIRE(voxrt_octree_from_tree(&od, t, &o) == VOXRT_OK);
    d.planes = 1;
    REQUIRE(voxrt_tree_build(&d, &m, NULL, &planes) == VOXRT_OK);
    some_rays(rays, RAYS);
    for (k = 0; k < n; k++) {
        voxrt_trace_desc td;
        voxrt_octree_trace_desc ot;
        uint64_t h;
        memset(&td, 0, sizeof td);
        memset(&ot, 0, sizeof ot);
        td.isa = ot.isa = (voxrt_isa)w[k].isa;
        REQUIRE(voxrt_trace(t, &td, rays, hits, RAYS) == VOXRT_OK);
        REQUIRE(voxrt_occluded(t, &td, rays, occluded, RAYS) == VOXRT_OK);
        h = test_fnv1a(occluded, RAYS, put_hits(0, hits, RAYS));
        for (i = 0; i < RAYS; i++) {
            uint8_t rgb[3];
            float normal[3];
            if (hits[i].node == VOXRT_NO_NODE) continue;
            voxrt_hit_color(t, &hits[i], rgb);
            voxrt_hit_normal(t, &hits[i], normal);
            h = put_floats(test_fnv1a(rgb, 3, h), normal, 3);
        }
        is_golden(GOLDEN_VOXRT_HITS, h, &w[k]);
        REQUIRE(voxrt_trace(planes, &td, rays, hits, RAYS) == VOXRT_OK);
        is_golden(GOLDEN_VOXRT_PLANE_HITS, put_hits(0, hits, RAYS), &w[k]);
        td.cone_width = 1 / 128.0f;
        td.cone_spread = 1 / 32.0f;
        REQUIRE(voxrt_trace(t, &td, rays, hits, RAYS) == VOXRT_OK);
        is_golden(GOLDEN_VOXRT_CONES, put_hits(0, hits, RAYS), &w[k]);
        REQUIRE(voxrt_octree_trace(o, &ot, rays, hits, RAYS) == VOXRT_OK);
        is_golden(GOLDEN_VOXRT_OCTREE_HITS, put_hits(0, hits, RAYS), &w[k]);
    }
    voxrt_octree_destroy(o);
    voxrt_tree_destroy(t);
    voxrt_tree_destroy(planes);
}

TEST(voxrt_pictures) {
    static body b;
    voxrt_finish finish[2];
    voxrt_mesh m;
    voxrt_build_desc d;
    voxrt_tree *t = NULL, *glass = NULL;
    voxrt_light light[2];
    voxrt_material material;
    bytes file;
    voxrt_sink sink;
    way w[5];
    uint32_t k;
    const uint32_t n = ways((uint32_t)voxrt_isa_best(), w);
    body_make(&b);
    m = voxel_mesh(&b);
    memset(finish, 0, sizeof finish);
    finish[0].diffuse = 0.5f;
    finish[0].mirror[0] = finish[0].mirror[1] = finish[0].mirror[2] = 0.5f;
    finish[1].diffuse = 1;
    finish[1].transparency[0] = finish[1].transparency[1] = 0.75f;
    finish[1].refraction = 1.5f;
    finish[1].absorption[1] = 0.5f;
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    d.resolution = 50;
    d.planes = d.spread = 1;
    memset(&file, 0, sizeof file);
    sink.write_fn = sink_write;
    sink.user = &file;
    REQUIRE(voxrt_tree_build(&d, &m, NULL, &t) == VOXRT_OK);
    REQUIRE(voxrt_paged_build(&d, &m, &sink, NULL) == VOXRT_OK);
    m.triangle_finish = b.finish;
    d.finishes = finish;
    d.finish_count = 2;
    REQUIRE(voxrt_tree_build(&d, &m, NULL, &glass) == VOXRT_OK);
    memset(light, 0, sizeof light);
    light[0].position[0] = 2;
    light[0].position[1] = 3;
    light[0].position[2] = 2.5f;
    light[0].color[0] = light[0].color[1] = light[0].color[2] = 0.75f;
    light[1].directional = 1;
    light[1].position[0] = -1;
    light[1].position[2] = 1;
    light[1].color[2] = 0.5f;
    memset(&material, 0, sizeof material);
    material.ambient[0] = 0.125f;
    material.diffuse = 0.75f;
    material.specular = 0.5f;
    material.shininess = 24;
    for (k = 0; k < n; k++) {
        voxrt_render_desc r;
        voxrt_paged_desc pd;
        voxrt_paged *paged = NULL;
        voxrt_geometry geometry;
        memset(&r, 0, sizeof r);
        r.env.thread_count = w[k].threads;
        r.isa = (voxrt_isa)w[k].isa;
        r.lights = light;
        r.light_count = 2;
        r.material = &material;
        r.shadows = 1;
        r.samples = 3;
        is_golden(GOLDEN_VOXRT_PICTURE, voxel_picture(&r, t, 0), &w[k]);
        r.samples = 1;
        r.background[0] = 0.25f;
        r.background[3] = 1;
        is_golden(GOLDEN_VOXRT_GLASS_PICTURE, voxel_picture(&r, glass, 0), &w[k]);
        r.tolerance = 1.5f;
        r.blend = 1;
        is_golden(GOLDEN_VOXRT_BLURRED, voxel_picture(&r, t, 1), &w[k]);
        memset(&pd, 0, sizeof pd);
        pd.env.thread_count = 1;
        pd.data = file.data;
        pd.size = file.size;
        pd.wait = 1;
        REQUIRE(voxrt_paged_open(&pd, &paged) == VOXRT_OK);
        voxrt_paged_geometry(paged, &geometry);
        r.geometry = &geometry;
        r.geometry_count = 1;
        is_golden(GOLDEN_VOXRT_PAGED_PICTURE, voxel_picture(&r, NULL, 0), &w[k]);
        voxrt_paged_destroy(paged);
    }
    free(file.data);
    voxrt_tree_destroy(t);
    voxrt_tree_destroy(glass);
}

TEST(voxrt_edits) {
    static body b;
    voxrt_mesh m;
    way w[5];
    uint32_t k;
    const uint32_t n = ways((uint32_t)VOXRT_ISA_SCALAR, w);
    body_make(&b);
    m = voxel_mesh(&b);
    for (k = 0; k < n; k++) {
        static const double lo[3] = {-0.5, -0.25, 0.25}, hi[3] = {0.25, 0.5, 1}, middle[3] = {0.5, 0.5, 0.5}, other[3] = {-0.5, 0.25, 0};
        voxrt_build_desc d;
        voxrt_edit_desc e;
        voxrt_tree *t = NULL;
        voxrt_model *model = NULL;
        memset(&d, 0, sizeof d);
        memset(&e, 0, sizeof e);
        d.env.thread_count = e.env.thread_count = w[k].threads;
        d.resolution = 40;
        REQUIRE(voxrt_tree_build(&d, &m, NULL, &t) == VOXRT_OK);
        REQUIRE(voxrt_model_from_tree(&e.env, t, &model) == VOXRT_OK);
        voxrt_tree_destroy(t);
        e.rgb[0] = 200;
        CHECK(voxrt_model_box(model, &e, lo, hi, NULL) == VOXRT_OK);
        e.op = VOXRT_EDIT_CLEAR;
        CHECK(voxrt_model_sphere(model, &e, middle, 0.375, NULL) == VOXRT_OK);
        e.op = VOXRT_EDIT_PAINT;
        e.rgb[1] = 77;
        CHECK(voxrt_model_sphere(model, &e, other, 0.5, NULL) == VOXRT_OK);
        e.op = VOXRT_EDIT_SET;
        m.triangle_count = 9;
        CHECK(voxrt_model_mesh(model, &e, &m, NULL) == VOXRT_OK);
        m.triangle_count = BODY_TRIANGLES;
        memset(&d, 0, sizeof d);
        d.env.thread_count = w[k].threads;
        REQUIRE(voxrt_tree_from_model(&d, model, &t) == VOXRT_OK);
        is_golden(GOLDEN_VOXRT_EDITED, file_hash(t, VOXRT_ENCODING_COMPACT), &w[k]);
        voxrt_tree_destroy(t);
        voxrt_model_destroy(model);
    }
}

/* A room of planes with a body that moves and two lights, and what a camera sees of it. */
enum { GW = 28, GH = 20, GN = GW * GH };
typedef struct lit_room {
    const way *w;
    voxrt_env env;
    voxrt_gi *gi;
    voxrt_gi_object moving;
    uint32_t id;
    voxrt_camera camera;
    voxrt_gbuffer g;
    float position[3 * GN], normal[3 * GN], albedo[3 * GN], direct[3 * GN], indirect[3 * GN];
} lit_room;

static void lit_room_fill(lit_room *s, const body *b) { /* the objects */
    static const float room[8][3] = {{-1, -1, -1}, {1, -1, -1}, {-1, 1, -1}, {1, 1, -1}, {-1, -1, 1}, {1, -1, 1}, {-1, 1, 1}, {1, 1, 1}};
    static const uint32_t wall[10][3] = {{0, 1, 5}, {0, 5, 4}, {2, 7, 3}, {2, 6, 7}, {0, 6, 2}, {0, 4, 6}, {1, 3, 7}, {1, 7, 5}, {0, 2, 3}, {0, 3, 1}};
    static const uint8_t paint[10][3] = {{200, 200, 200}, {200, 200, 200}, {220, 220, 220}, {220, 220, 220}, {220, 40, 30}, {220, 40, 30},
                                         {40, 200, 60}, {40, 200, 60}, {180, 180, 200}, {180, 180, 200}};
    voxrt_gi_object o;
    memset(&o, 0, sizeof o);
    o.mesh.positions = room[0];
    o.mesh.vertex_count = 8;
    o.mesh.indices = wall[0];
    o.mesh.triangle_count = 10;
    o.mesh.triangle_rgb = paint[0];
    o.still = 1;
    CHECK(voxrt_gi_add(s->gi, &o, NULL) == VOXRT_OK);
    o.mesh = voxel_mesh(b);
    o.material.specular[0] = 0.25f;
    o.material.exponent = 20;
    o.still = 0;
    o.to_world[0] = o.to_world[5] = o.to_world[10] = 0.5;
    o.to_world[3] = 0.125;
    o.to_world[7] = -0.375;
    CHECK(voxrt_gi_add(s->gi, &o, &s->id) == VOXRT_OK);
    s->moving = o;
}

static void lit_room_light(lit_room *s) {
    voxrt_gi_light light[2];
    memset(light, 0, sizeof light);
    light[0].kind = VOXRT_GI_POINT;
    light[0].position[1] = 0.875f;
    light[0].position[2] = 0.5f;
    light[0].color[0] = light[0].color[1] = light[0].color[2] = 2;
    light[1].kind = VOXRT_GI_AREA;
    light[1].position[0] = -0.5f;
    light[1].position[1] = 0.75f;
    light[1].edge_u[0] = 0.25f;
    light[1].edge_v[2] = 0.25f;
    light[1].color[0] = 4;
    CHECK(voxrt_gi_set_lights(s->gi, light, 2) == VOXRT_OK);
}

static int lit_room_make(lit_room *s, const body *b, const way *w) {
    voxrt_gi_desc d;
    uint32_t i;
    memset(s, 0, sizeof *s);
    s->w = w;
    memset(&d, 0, sizeof d);
    d.env.thread_count = w->threads;
    d.columns.size_x = d.columns.size_y = 32;
    d.columns.size_z = 64;
    d.columns.depth_axis_plus_1 = 3;
    for (i = 0; i < 3; i++) {
        d.columns.box_min[i] = -1.0625;
        d.columns.box_max[i] = 1.0625;
    }
    s->env = d.env;
    if (voxrt_gi_create(&d, &s->gi) != VOXRT_OK) return 0;
    lit_room_fill(s, b);
    lit_room_light(s);
    s->camera.eye[0] = 0.25f;
    s->camera.eye[2] = 3;
    s->g.width = GW;
    s->g.height = GH;
    s->g.position = s->position;
    s->g.normal = s->normal;
    s->g.albedo = s->albedo;
    return 1;
}

static uint64_t put_lit(uint64_t h, lit_room *s, voxrt_gi_render_desc *r) { /* the light that a way of computing it finds */
    r->env = s->env;
    r->isa = (voxrt_isa)s->w->isa;
    r->camera = s->camera;
    CHECK(voxrt_gi_render(r, s->gi, &s->g, s->direct, s->indirect, NULL) == VOXRT_OK);
    return put_floats(put_floats(h, s->direct, 3 * GN), s->indirect, 3 * GN);
}

static void lit_frames(lit_room *s) { /* the body moves between two of them */
    voxrt_gi_history *history = NULL;
    voxrt_gi_report report;
    voxrt_gi_render_desc r;
    uint32_t frame;
    uint64_t h = 0;
    CHECK(voxrt_gi_history_create(&s->env, &history) == VOXRT_OK);
    for (frame = 0; frame < 2; frame++) {
        REQUIRE(voxrt_gi_update(s->gi, NULL) == VOXRT_OK);
        REQUIRE(voxrt_gbuffer_from_gi(&s->env, &s->camera, s->gi, &s->g) == VOXRT_OK);
        h = put_floats(put_floats(put_floats(h, s->position, 3 * GN), s->normal, 3 * GN), s->albedo, 3 * GN);
        memset(&r, 0, sizeof r);
        r.rays = 4;
        r.first_ray = 4 * frame;
        r.filter = 2;
        r.coarse = 2;
        r.history = history;
        r.report = &report;
        h = put_lit(h, s, &r);
        CHECK(voxrt_gi_bounce(s->gi, &s->env, 4, 0, frame) == VOXRT_OK);
        s->moving.to_world[3] += 0.0625;
        CHECK(voxrt_gi_set(s->gi, s->id, &s->moving) == VOXRT_OK);
    }
    is_golden(GOLDEN_VOXRT_GI_FRAMES, h, s->w);
    REQUIRE(voxrt_gi_update(s->gi, NULL) == VOXRT_OK);
    voxrt_gi_history_destroy(history);
}

static void lit_columns(const lit_room *s) { /* rays into the columns */
    enum { RAYS = 2000 };
    static voxrt_ray rays[RAYS];
    static voxrt_column_hit hits[RAYS];
    static uint8_t occluded[RAYS];
    voxrt_columns_trace_desc ct;
    uint32_t i;
    uint64_t h = 0;
    some_rays(rays, RAYS);
    memset(&ct, 0, sizeof ct);
    ct.isa = (voxrt_isa)s->w->isa;
    REQUIRE(voxrt_columns_trace(voxrt_gi_columns(s->gi), &ct, rays, hits, RAYS) == VOXRT_OK);
    REQUIRE(voxrt_columns_occluded(voxrt_gi_columns(s->gi), &ct, rays, occluded, RAYS) == VOXRT_OK);
    for (i = 0; i < RAYS; i++) h = put_u32(put_u32s(put_floats(h, &hits[i].t, 1), hits[i].cell, 3), hits[i].face);
    is_golden(GOLDEN_VOXRT_COLUMN_HITS, test_fnv1a(occluded, RAYS, h), s->w);
}

static void lit_ways(lit_room *s) { /* the other ways, and tones of the last one's picture */
    uint32_t way_no, i;
    uint64_t h = 0;
    for (way_no = 0; way_no < 4; way_no++) {
        voxrt_gi_render_desc r;
        memset(&r, 0, sizeof r);
        r.method = way_no == 0 ? VOXRT_GI_PATH : way_no == 1 ? VOXRT_GI_AO : way_no == 2 ? VOXRT_GI_VPL : VOXRT_GI_GATHER;
        r.rays = 2;
        r.bounces = way_no == 0 ? 2 : 1;
        r.radius = way_no == 1 ? 0.5f : 0;
        r.lookup = way_no == 3 ? VOXRT_GI_LOOKUP_MAPS : VOXRT_GI_LOOKUP_CACHE;
        r.map_size = 32;
        r.direct_filter = 1;
        h = put_lit(h, s, &r);
    }
    is_golden(GOLDEN_VOXRT_GI_WAYS, h, s->w);
    for (i = 0, h = 0; i < 3; i++) {
        CHECK(voxrt_tone_map((voxrt_tone)i, 2, s->direct, s->direct, GN) == VOXRT_OK);
        h = put_floats(h, s->direct, 3 * GN);
    }
    is_golden(GOLDEN_VOXRT_TONES, h, s->w);
}

TEST(voxrt_light) {
    static body b;
    static lit_room s;
    way w[5];
    uint32_t k;
    const uint32_t n = ways((uint32_t)voxrt_isa_best(), w);
    body_make(&b);
    for (k = 0; k < n; k++) {
        REQUIRE(lit_room_make(&s, &b, &w[k]));
        lit_frames(&s);
        lit_columns(&s);
        lit_ways(&s);
        voxrt_gi_destroy(s.gi);
    }
}

/* ---- zbufrand.h ---- */

enum { ZW = 60, ZH = 45, ZN = ZW * ZH };

static zbufrand_scene *random_scene(const body *b, const zbufrand_build_desc *bd, uint32_t threads, zbufrand_node *out_leaf) {
    zbufrand_scene_desc d;
    zbufrand_scene *scene = NULL;
    zbufrand_node list, leaf, tree;
    zbufrand_mesh m;
    zbufrand_transform t;
    test_rng r = test_rng_make(3);
    uint32_t i, a;
    memset(&d, 0, sizeof d);
    d.env.thread_count = threads;
    memset(&m, 0, sizeof m);
    m.positions = b->p[0];
    m.vertex_count = BODY_VERTICES;
    m.triangle_count = BODY_TRIANGLES;
    m.normals = b->n[0];
    m.vertex_rgb = b->rgb[0];
    CHECK(zbufrand_scene_create(&d, &scene) == ZBUFRAND_OK);
    CHECK(zbufrand_add_list(scene, ZBUFRAND_ROOT, NULL, ZBUFRAND_HIDDEN, &list) == ZBUFRAND_OK);
    CHECK(zbufrand_add_mesh(scene, list, NULL, 0, &m, &leaf) == ZBUFRAND_OK);
    CHECK(zbufrand_add_list(scene, list, NULL, 0, &tree) == ZBUFRAND_OK);
    for (i = 0; i < 22; i++) { /* quarter turns, mirrors, powers of two */
        const double scale = i < 3 ? 0.5 : i % 3 == 0 ? 2 : i % 3 == 1 ? 1 : 0.5;
        memset(&t, 0, sizeof t);
        t.m[0][i % 3] = i & 1 ? scale : -scale;
        t.m[1][(i + 1) % 3] = scale;
        t.m[2][(i + 2) % 3] = i & 4 ? scale : -scale;
        for (a = 0; a < 3; a++) t.m[a][3] = (double)((int)test_rng_below(&r, 1025) - 512) / (i < 3 ? 512.0 : 64.0);
        CHECK(zbufrand_add_reference(scene, i < 3 ? tree : ZBUFRAND_ROOT, &t, i < 3 ? leaf : tree, out_leaf) == ZBUFRAND_OK);
    }
    CHECK(zbufrand_scene_build(scene, bd, NULL) == ZBUFRAND_OK);
    return scene;
}

static uint64_t random_picture(zbufrand_frame *frame, const zbufrand_render_desc *desc, const zbufrand_scene *scene) {
    static uint8_t bytes8[4 * ZN];
    static float rgba[4 * ZN], depth[ZN];
    zbufrand_image image;
    zbufrand_render_desc d = *desc;
    zbufrand_stats st;
    uint64_t h;
    memset(&image, 0, sizeof image);
    image.width = ZW;
    image.height = ZH;
    image.rgba8 = bytes8;
    image.rgba = rgba;
    image.depth = depth;
    d.camera.eye[0] = 3;
    d.camera.eye[1] = 4;
    d.camera.eye[2] = 16;
    CHECK(zbufrand_render(frame, &d, scene, &image, &st) == ZBUFRAND_OK);
    CHECK(st.covered > 200);
    h = test_fnv1a(bytes8, sizeof bytes8, 0);
    return put_floats(put_floats(h, rgba, 4 * ZN), depth, ZN);
}

TEST(zbufrand_scenes) {
    enum { POINTS = 1000 };
    static body b;
    static float position[3 * POINTS], normal[3 * POINTS];
    static uint8_t rgb[3 * POINTS];
    static uint32_t triangle[2 * POINTS];
    way w[5];
    uint32_t k, i;
    const uint32_t n = ways((uint32_t)zbufrand_isa_best(), w);
    body_make(&b);
    for (k = 0; k < n; k++) {
        zbufrand_build_desc bd;
        zbufrand_frame_desc fd;
        zbufrand_frame *frame = NULL;
        zbufrand_scene *scene;
        zbufrand_render_desc d;
        zbufrand_surface_points_desc sp;
        zbufrand_node node = 0;
        zbufrand_transform t;
        uint64_t h;
        memset(&bd, 0, sizeof bd);
        bd.ids = 1;
        memset(&fd, 0, sizeof fd);
        fd.env.thread_count = w[k].threads;
        fd.isa = (zbufrand_isa)w[k].isa;
        REQUIRE(zbufrand_frame_create(&fd, &frame) == ZBUFRAND_OK);
        scene = random_scene(&b, &bd, w[k].threads, &node);
        REQUIRE(scene != NULL);
        for (i = 0, h = 0; i < 4; i++) {
            memset(&sp, 0, sizeof sp);
            sp.independent = i & 1;
            sp.vertex_normals = i >> 1;
            sp.first = 7;
            REQUIRE(zbufrand_surface_points(scene, &sp, POINTS, position, normal, rgb, triangle) == ZBUFRAND_OK);
            h = put_floats(put_floats(h, position, 3 * POINTS), normal, 3 * POINTS);
            h = put_u32s(test_fnv1a(rgb, sizeof rgb, h), triangle, 2 * POINTS);
        }
        is_golden(GOLDEN_ZBUFRAND_POINTS, h, &w[k]);

        memset(&d, 0, sizeof d);
        is_golden(GOLDEN_ZBUFRAND_PICTURE, random_picture(frame, &d, scene), &w[k]);
        d.hybrid = ZBUFRAND_HYBRID_OFF;
        is_golden(GOLDEN_ZBUFRAND_SAMPLES, random_picture(frame, &d, scene), &w[k]);
        d.hybrid = ZBUFRAND_HYBRID_ALL;
        d.no_repair = 1;
        is_golden(GOLDEN_ZBUFRAND_RASTERED, random_picture(frame, &d, scene), &w[k]);
        memset(&d, 0, sizeof d);
        d.oversample = 2;
        d.density = 0.75; /* few: rays do the rest */
        is_golden(GOLDEN_ZBUFRAND_OVERSAMPLED, random_picture(frame, &d, scene), &w[k]);
        memset(&d, 0, sizeof d);
        d.noise = 1e-9;
        d.max_frames = 3;
        d.spread = 4;
        is_golden(GOLDEN_ZBUFRAND_MEAN, random_picture(frame, &d, scene), &w[k]);
        memset(&t, 0, sizeof t);
        t.m[0][0] = t.m[1][1] = t.m[2][2] = 2;
        CHECK(zbufrand_move(scene, node, &t) == ZBUFRAND_OK);
        CHECK(zbufrand_scene_update(scene, NULL) == ZBUFRAND_OK);
        memset(&d, 0, sizeof d);
        d.independent = 1;
        is_golden(GOLDEN_ZBUFRAND_EDITED, random_picture(frame, &d, scene), &w[k]);
        zbufrand_scene_destroy(scene);

        memset(&bd, 0, sizeof bd);
        memset(&d, 0, sizeof d);
        zbufrand_preset_thesis(&bd, &d);
        scene = random_scene(&b, &bd, w[k].threads, &node);
        REQUIRE(scene != NULL);
        is_golden(GOLDEN_ZBUFRAND_THESIS, random_picture(frame, &d, scene), &w[k]);
        zbufrand_scene_destroy(scene);
        for (i = ZBUFRAND_STRUCTURE_OCTREE, h = 0; i <= ZBUFRAND_STRUCTURE_NORMALS; i++) {
            memset(&bd, 0, sizeof bd);
            bd.structure = (zbufrand_structure)i;
            scene = random_scene(&b, &bd, w[k].threads, &node);
            REQUIRE(scene != NULL);
            memset(&d, 0, sizeof d);
            d.density = 1;
            h ^= random_picture(frame, &d, scene) << i;
            zbufrand_scene_destroy(scene);
        }
        is_golden(GOLDEN_ZBUFRAND_LISTS, h, &w[k]);
        zbufrand_frame_destroy(frame);
    }
}

static void some_samples(zbufrand_sample *s, uint32_t n, uint64_t seed) { /* two surfaces that cross */
    test_rng r = test_rng_make(seed);
    uint32_t i, a;
    memset(s, 0, n * sizeof *s);
    for (i = 0; i < n; i++) {
        s[i].x = (float)((int)test_rng_below(&r, 64 * (ZW + 4)) - 128) / 64.0f;
        s[i].y = (float)((int)test_rng_below(&r, 64 * (ZH + 4)) - 128) / 64.0f;
        s[i].z = i & 1 ? 2.0f + s[i].x / 64.0f : 3.0f - s[i].y / 32.0f;
        s[i].slope_x = i & 1 ? -0.004f : 0;
        s[i].slope_y = i & 1 ? 0 : 0.003f;
        for (a = 0; a < 3; a++) s[i].rgb[a] = (float)test_rng_below(&r, 256) / 256.0f;
        s[i].flags = i % 9 == 0 ? (uint32_t)ZBUFRAND_SAMPLE_BACK : 0;
    }
}

/* Samples, and a picture that is made of them. */
enum { SAMPLES = 2500 };
typedef struct sampled {
    const way *w;
    zbufrand_sample s[SAMPLES];
    float rgba[4 * ZN], depth[ZN];
    uint32_t number[ZN];
} sampled;

static void sampled_resolve(sampled *p, zbufrand_canvas_desc *d, uint32_t clear) { /* all samples through a canvas */
    zbufrand_picture picture;
    zbufrand_source source;
    zbufrand_canvas *canvas = NULL;
    memset(&picture, 0, sizeof picture);
    picture.rgba = p->rgba;
    picture.depth = p->depth;
    picture.number = p->number;
    memset(&source, 0, sizeof source);
    source.shade_fn = zbufrand_samples_shade;
    source.surface_fn = zbufrand_samples_surface;
    source.user = p->s;
    d->env.thread_count = p->w->threads;
    d->isa = (zbufrand_isa)p->w->isa;
    d->width = ZW;
    d->height = ZH;
    REQUIRE(zbufrand_canvas_create(d, &canvas) == ZBUFRAND_OK);
    zbufrand_canvas_clear(canvas, clear);
    REQUIRE(zbufrand_canvas_submit(canvas, p->s, SAMPLES, 0, NULL) == ZBUFRAND_OK);
    REQUIRE(zbufrand_canvas_resolve(canvas, &source, &picture, NULL) == ZBUFRAND_OK);
    zbufrand_canvas_destroy(canvas);
}

static void sampled_fills(sampled *p) { /* tests of occlusion and fills in their pairs */
    uint32_t fill, occlusion;
    uint64_t h = 0;
    for (occlusion = 0; occlusion <= ZBUFRAND_OCCLUSION_SQUARES_ALL; occlusion++)
        for (fill = 0; fill <= ZBUFRAND_FILL_REGIONS; fill++) {
            zbufrand_canvas_desc d;
            if (occlusion != 0 && occlusion != 2 && fill != 1 && fill != 4) continue;
            memset(&d, 0, sizeof d);
            d.reconstruct.block = 1 + (occlusion + fill) % 3;
            d.reconstruct.occlusion = (zbufrand_occlusion)occlusion;
            d.reconstruct.fill = (zbufrand_fill)fill;
            d.reconstruct.drop_back = fill == 3;
            d.reconstruct.plane_depth = occlusion == 0 && fill == 2;
            d.reconstruct.repair = fill == 0;
            d.bucket_bits = fill == 5 ? 4 : 0;
            sampled_resolve(p, &d, 5);
            h = put_u32s(put_floats(put_floats(h, p->rgba, 4 * ZN), p->depth, ZN), p->number, ZN);
        }
    is_golden(GOLDEN_ZBUFRAND_FILLS, h, p->w);
}

static void sampled_accumulated(sampled *p) { /* four frames of it, which a camera shifts */
    uint32_t i;
    uint64_t h = 0;
    for (i = 0; i < 3; i++) {
        zbufrand_accumulator_desc ad;
        zbufrand_accumulator *a = NULL;
        zbufrand_noise noise;
        zbufrand_view view;
        uint32_t frame;
        memset(&ad, 0, sizeof ad);
        ad.env.thread_count = p->w->threads;
        ad.width = ZW;
        ad.height = ZH;
        ad.mode = (zbufrand_accumulation)i;
        ad.blur = i == 1 ? 2.0f : 0;
        memset(&view, 0, sizeof view);
        view.world_to_camera[0][0] = view.world_to_camera[1][1] = view.world_to_camera[2][2] = 1;
        view.focal = 50;
        view.center_x = (double)ZW / 2;
        view.center_y = (double)ZH / 2;
        view.near_z = 0.125;
        REQUIRE(zbufrand_accumulator_create(&ad, &a) == ZBUFRAND_OK);
        for (frame = 0; frame < 4; frame++) {
            view.world_to_camera[0][3] = frame / 32.0;
            p->rgba[4 * (40 + ZW * 20) + frame] = 0.75f;
            REQUIRE(zbufrand_accumulator_add(a, p->rgba, p->depth, &view) == ZBUFRAND_OK);
        }
        CHECK(zbufrand_accumulator_noise(a, 0, &noise) == ZBUFRAND_OK);
        h = put_doubles(put_doubles(h, &noise.rmse, 1), &noise.frames, 1);
        CHECK(zbufrand_accumulator_get(a, i == 0 ? -1.0f : 1.25f, p->rgba) == ZBUFRAND_OK);
        h = put_floats(h, p->rgba, 4 * ZN);
        zbufrand_accumulator_destroy(a);
    }
    is_golden(GOLDEN_ZBUFRAND_ACCUMULATED, h, p->w);
}

static void sampled_mended(sampled *p) { /* what is wrong in it */
    static zbufrand_suspect suspects[ZN];
    zbufrand_suspect_desc sd;
    size_t count = 0, i;
    uint64_t h = 0;
    memset(&sd, 0, sizeof sd);
    sd.env.thread_count = p->w->threads;
    sd.isa = (zbufrand_isa)p->w->isa;
    sd.width = ZW;
    sd.height = ZH;
    REQUIRE(zbufrand_find_suspects(&sd, p->depth, suspects, ZN, &count) == ZBUFRAND_OK);
    CHECK(count > 20);
    for (i = 0; i < count; i++) h = put_u32(put_u32(h, suspects[i].pixel), suspects[i].kind);
    REQUIRE(zbufrand_mend(&sd, p->rgba, p->depth, suspects, count) == ZBUFRAND_OK);
    is_golden(GOLDEN_ZBUFRAND_MENDED, put_floats(put_floats(h, p->rgba, 4 * ZN), p->depth, ZN), p->w);
}

static void sampled_layers(sampled *p) { /* its samples, one layer after another */
    static float coverage[2 * ZN];
    zbufrand_layers_desc ld;
    zbufrand_layers *layers = NULL;
    memset(&ld, 0, sizeof ld);
    ld.env.thread_count = p->w->threads;
    ld.width = ZW;
    ld.height = ZH;
    ld.density = 0.75f;
    REQUIRE(zbufrand_layers_create(&ld, &layers) == ZBUFRAND_OK);
    do {
        CHECK(zbufrand_layers_submit(layers, p->s, SAMPLES) == ZBUFRAND_OK);
    } while (zbufrand_layers_next(layers));
    CHECK(zbufrand_layers_resolve(layers, p->rgba, coverage) == ZBUFRAND_OK);
    is_golden(GOLDEN_ZBUFRAND_LAYERS, put_floats(put_floats(0, p->rgba, 4 * ZN), coverage, 2 * ZN), p->w);
    zbufrand_layers_destroy(layers);
}

TEST(zbufrand_reconstruction) {
    static sampled p;
    way w[5];
    uint32_t k;
    const uint32_t n = ways((uint32_t)zbufrand_isa_best(), w);
    for (k = 0; k < n; k++) {
        zbufrand_canvas_desc d;
        p.w = &w[k];
        some_samples(p.s, SAMPLES, 4);
        sampled_fills(&p);
        memset(&d, 0, sizeof d); /* the nearest sample alone, for what is found and mended in it, and added up */
        sampled_resolve(&p, &d, 0);
        sampled_accumulated(&p);
        sampled_mended(&p);
        sampled_layers(&p);
    }
}

TEST(zbufrand_theory) {
    const way one = {1, 1};
    uint64_t h = 0;
    uint32_t i;
    for (i = 0; i < 40; i++) {
        const double area = 1000.0 * (i + 1), seen = 300.0 * (i + 1), d = 1 + i % 3, s = (i + 1) / 64.0;
        double v[16], areas[4], p[4];
        areas[0] = 0.25;
        areas[1] = i / 8.0;
        areas[2] = 1;
        areas[3] = 0.125;
        v[0] = zbufrand_samples((zbufrand_bound)(i % 8), area, seen, d, s);
        v[1] = zbufrand_density(seen, d, s);
        v[2] = zbufrand_samples_for_share(area, d, s);
        v[3] = zbufrand_samples_tolerant(area, seen, i, s);
        v[4] = zbufrand_success(i / 4.0, seen, d);
        v[5] = zbufrand_expected_holes(i / 4.0, seen, d);
        v[6] = zbufrand_holes_variance(area, seen);
        v[7] = zbufrand_holes_tail(area, seen, i);
        v[8] = zbufrand_pixel_law(areas, 4, i / 8.0, p);
        v[9] = zbufrand_front_share(s, i / 4.0);
        v[10] = zbufrand_bleed(i / 4.0, s, 1, i % 4);
        v[11] = zbufrand_multi_hit(area, seen);
        v[12] = zbufrand_harmonic(i / 2.0);
        v[13] = zbufrand_normal_quantile(s);
        v[14] = zbufrand_empty_bound(i / 8.0, 16);
        v[15] = zbufrand_block_spill(i / 4.0, d, s);
        h = put_doubles(put_doubles(h, v, 16), p, 4);
    }
    is_golden(GOLDEN_ZBUFRAND_THEORY, h, &one);
}

/* ---- tetcast.h ---- */

enum { TW = 40, TH = 30, TN = TW * TH };

static void lattice_make(tets *m) { /* 7^3 vertices, moved by multiples of 2^-10, shuffled; a hole in the middle */
    test_rng r = test_rng_make(8);
    uint32_t x, y, z;
    size_t i, a;
    memset(m, 0, sizeof *m);
    tets_lattice(m, 7, 7, 7, 6, NULL);
    for (i = 0; i < m->nv; i++) {
        const uint32_t c[3] = {(uint32_t)(i % 7), (uint32_t)(i / 7 % 7), (uint32_t)(i / 49)};
        for (a = 0; a < 3; a++)
            if (c[a] > 0 && c[a] < 6) m->p[3 * i + a] += (double)((int)test_rng_below(&r, 513) - 256) / 1024.0;
        x = c[0] * 5 % 7;
        y = c[1] * 3 % 7;
        z = c[2];
        m->s[i] = (float)(8 * x + 4 * y + 9 * z + test_rng_below(&r, 32)) / 128.0f;
    }
    for (i = 0, x = 0; i < m->nt; i++) { /* cubes of the middle go */
        uint32_t in = 0;
        for (a = 0; a < 3; a++) in += m->p[3 * m->t[4 * i] + a] >= 1.75 && m->p[3 * m->t[4 * i] + a] < 3.25;
        if (in == 3) continue;
        memmove(m->t + 4 * x++, m->t + 4 * i, 16);
    }
    m->nt = x;
    tets_shuffle(m, 9);
}

static const tetcast_control_point steps[7] = {
    {0.1f, {0, 0, 0.5f}, 0}, {0.3f, {0.2f, 0.1f, 1}, 0.5f}, {0.45f, {1, 1, 0.25f}, 1.5f}, {0.45f, {1, 0, 0}, 0},
    {0.7f, {0, 0.75f, 0.25f}, 0}, {0.8f, {0.5f, 1, 0.25f}, 3}, {1.1f, {1, 1, 1}, 6}
};

static tetcast_optics *optics_make(tetcast_model model, tetcast_integrator integrator, uint32_t threads) {
    static const tetcast_isovalue iso[2] = {{0.375f, {1, 0.5f, 0.25f}, 0.5f, 0.5f, 20}, {0.875f, {0.25f, 0.5f, 1}, 1, 0.25f, 0}};
    tetcast_transfer_desc td;
    tetcast_optics_desc od;
    tetcast_transfer *t = NULL;
    tetcast_optics *o = NULL;
    memset(&td, 0, sizeof td);
    td.env.thread_count = 1;
    td.points = steps;
    td.point_count = 7;
    td.isovalues = iso;
    td.isovalue_count = 2;
    CHECK(tetcast_transfer_create(&td, &t) == TETCAST_OK);
    memset(&od, 0, sizeof od);
    od.env.thread_count = threads;
    od.model = model;
    od.integrator = integrator;
    od.samples = 3;
    od.table_values = 20;
    od.table_lengths = 6;
    od.longest = integrator >= TETCAST_INTEGRATOR_TABLE_3D ? 2.0f : 0;
    CHECK(tetcast_optics_create(t, &od, &o) == TETCAST_OK);
    tetcast_transfer_destroy(t);
    return o;
}

typedef struct tet_picture { uint8_t bytes8[4 * TN]; float rgba[4 * TN], depth[TN], length[TN]; uint32_t steps[TN]; } tet_picture;
static tetcast_image tet_image(tet_picture *p) {
    tetcast_image image;
    memset(&image, 0, sizeof image);
    image.width = TW;
    image.height = TH;
    image.rgba8 = p->bytes8;
    image.rgba = p->rgba;
    image.depth = p->depth;
    image.length = p->length;
    image.steps = p->steps;
    return image;
}
static uint64_t tet_hash(const tet_picture *p, uint64_t h) {
    h = test_fnv1a(p->bytes8, sizeof p->bytes8, h);
    h = put_floats(put_floats(put_floats(h, p->rgba, 4 * TN), p->depth, TN), p->length, TN);
    return put_u32s(h, p->steps, TN);
}

static void stripes(void *user, const tetcast_packet *in, float rgba[4][8]) { /* a shader */
    uint32_t i, a;
    (void)user;
    for (i = 0; i < 8; i++) {
        if (!(in->mask >> i & 1)) continue;
        rgba[3][i] = in->length[i] < 1 ? in->length[i] * 0.5f : 0.5f;
        for (a = 0; a < 3; a++) {
            const float g = in->gradient[a][i] < 0 ? -in->gradient[a][i] : in->gradient[a][i];
            rgba[a][i] = rgba[3][i] * (g < 1 ? g : 1);
        }
    }
}

/* A mesh, how to look at it, and the picture. */
typedef struct tet_view {
    const way *w;
    tetcast_mesh *mesh;
    tetcast_render_desc d;
    tet_picture p;
} tet_view;

static void tet_view_start(tet_view *s) { /* by walking from outside */
    memset(&s->d, 0, sizeof s->d);
    s->d.env.thread_count = s->w->threads;
    s->d.isa = (tetcast_isa)s->w->isa;
    s->d.method = TETCAST_METHOD_WALK;
}

static uint64_t put_tets(uint64_t h, tet_view *s, const tetcast_optics *o) {
    const tetcast_image image = tet_image(&s->p);
    CHECK(o != NULL && tetcast_render(&s->d, s->mesh, o, &image, NULL) == TETCAST_OK);
    return tet_hash(&s->p, h);
}

static void mesh_methods(tet_view *s) {
    tetcast_optics *o = optics_make(TETCAST_MODEL_VOLUME, TETCAST_INTEGRATOR_EXACT, s->w->threads);
    s->d.background[0] = 0.25f;
    s->d.background[3] = 1;
    is_golden(GOLDEN_TETCAST_WALKED, put_tets(0, s, o), s->w);
    s->d.method = TETCAST_METHOD_PROJECT;
    is_golden(GOLDEN_TETCAST_PROJECTED, put_tets(0, s, o), s->w);
    tetcast_optics_destroy(o);
}

static void mesh_models(tet_view *s) { /* near by and from within */
    uint32_t i;
    uint64_t h = 0;
    s->d.camera.eye[0] = 11;
    s->d.camera.eye[1] = 4;
    s->d.camera.eye[2] = 2;
    for (i = TETCAST_MODEL_EMISSION; i <= TETCAST_MODEL_MIXED; i++) {
        tetcast_optics *o = optics_make((tetcast_model)i, TETCAST_INTEGRATOR_EXACT, s->w->threads);
        s->d.method = i & 1 ? TETCAST_METHOD_WALK : TETCAST_METHOD_PROJECT;
        s->d.smooth_normals = i == TETCAST_MODEL_MIXED;
        h = put_tets(h, s, o);
        if (i == TETCAST_MODEL_ISOSURFACE) {
            s->d.method = TETCAST_METHOD_WALK;
            h = put_tets(h, s, o);
        }
        tetcast_optics_destroy(o);
    }
    is_golden(GOLDEN_TETCAST_MODELS, h, s->w);
}

static void mesh_integrators(tet_view *s) {
    uint32_t i;
    uint64_t h = 0;
    s->d.method = TETCAST_METHOD_WALK;
    s->d.smooth_normals = 0;
    s->d.camera.eye[0] = 3;
    for (i = TETCAST_INTEGRATOR_PSI_TABLE; i < TETCAST_INTEGRATOR_COUNT; i++) {
        tetcast_optics *o = optics_make(TETCAST_MODEL_VOLUME, (tetcast_integrator)i, s->w->threads);
        h = put_tets(h, s, o);
        tetcast_optics_destroy(o);
    }
    is_golden(GOLDEN_TETCAST_INTEGRATORS, h, s->w);
}

static void mesh_shaded(tet_view *s) { /* by a function of the caller's, clipped */
    tetcast_shade_desc sd;
    tetcast_shader shader;
    tetcast_clip_desc cd;
    tetcast_clip_plane plane;
    tetcast_clip *clip = NULL;
    const tetcast_image image = tet_image(&s->p);
    memset(&shader, 0, sizeof shader);
    shader.needs = TETCAST_NEED_GRADIENT;
    shader.shade_fn = stripes;
    memset(&plane, 0, sizeof plane);
    plane.normal[0] = 1;
    plane.normal[1] = 0.5;
    plane.offset = 2;
    memset(&cd, 0, sizeof cd);
    cd.env.thread_count = 1;
    cd.planes = &plane;
    cd.plane_count = 1;
    REQUIRE(tetcast_clip_create(&cd, &clip) == TETCAST_OK);
    memset(&sd, 0, sizeof sd);
    sd.env.thread_count = s->w->threads;
    sd.clip = clip;
    sd.shader = &shader;
    REQUIRE(tetcast_render_shaded(&sd, s->mesh, NULL, &image, NULL) == TETCAST_OK);
    is_golden(GOLDEN_TETCAST_SHADED, tet_hash(&s->p, 0), s->w);
    tetcast_clip_destroy(clip);
}

static void mesh_surface(const tet_view *s) { /* of one value */
    tetcast_surface_desc fd;
    tetcast_surface surface;
    uint64_t h;
    memset(&fd, 0, sizeof fd);
    fd.env.thread_count = s->w->threads;
    fd.isovalue = 0.5f;
    fd.normals = fd.cells = 1;
    REQUIRE(tetcast_isosurface(&fd, s->mesh, &surface) == TETCAST_OK && surface.triangle_count > 100);
    h = put_floats(put_doubles(0, surface.origin, 3), surface.positions, 3 * (size_t)surface.vertex_count);
    h = put_floats(h, surface.normals, 3 * (size_t)surface.vertex_count);
    h = put_u32s(put_u32s(h, surface.indices, 3 * (size_t)surface.triangle_count), surface.cells, surface.triangle_count);
    is_golden(GOLDEN_TETCAST_SURFACE, h, s->w);
    tetcast_surface_free(&surface);
}

static void mesh_cells(tet_view *s, const tets *m) { /* all kinds show the same; in another order last bits differ */
    tetcast_optics *o = optics_make(TETCAST_MODEL_VOLUME, TETCAST_INTEGRATOR_EXACT, 1);
    uint32_t i;
    tet_view_start(s);
    for (i = 0; i <= TETCAST_CELLS_COUNT; i++) {
        const int morton = i == TETCAST_CELLS_COUNT;
        tetcast_mesh_desc md;
        memset(&md, 0, sizeof md);
        md.env.thread_count = s->w->threads;
        md.cells = morton ? TETCAST_CELLS_TET16 : (tetcast_cells)i;
        md.order = morton ? TETCAST_ORDER_MORTON : TETCAST_ORDER_HILBERT;
        s->mesh = tets_build_desc(m, &md, NULL);
        REQUIRE(s->mesh != NULL);
        is_golden(morton ? GOLDEN_TETCAST_MORTON : GOLDEN_TETCAST_CELLS, put_tets(0, s, o), s->w);
        tetcast_mesh_destroy(s->mesh);
    }
    tetcast_optics_destroy(o);
}

TEST(tetcast_meshes) {
    static tet_view s;
    tets m;
    way w[5];
    uint32_t k;
    const uint32_t n = ways((uint32_t)tetcast_isa_best(), w);
    lattice_make(&m);
    for (k = 0; k < n; k++) {
        tetcast_mesh_desc md;
        s.w = &w[k];
        memset(&md, 0, sizeof md);
        md.env.thread_count = w[k].threads;
        s.mesh = tets_build_desc(&m, &md, NULL);
        REQUIRE(s.mesh != NULL);
        tet_view_start(&s);
        mesh_methods(&s);
        CHECK(tetcast_mesh_make_gradients(s.mesh, &md.env) == TETCAST_OK);
        mesh_models(&s);
        mesh_integrators(&s);
        mesh_shaded(&s);
        mesh_surface(&s);
        tetcast_mesh_destroy(s.mesh);
        mesh_cells(&s, &m);
    }
    tets_free(&m);
}

/* Places to sample at, in steps of bricks and in the world, and values of two levels of a grid. */
enum { PLACES = 500, NODES = 18 * 18 * 18 };
typedef struct places {
    float x[PLACES], y[PLACES], z[PLACES];
    double world[PLACES][3];
    float coarse[6 * 6 * 6], fine[4 * 4 * 4];
} places;

static void places_make(places *q) {
    test_rng r = test_rng_make(13);
    uint32_t i, a;
    for (i = 0; i < PLACES; i++) {
        q->x[i] = (float)test_rng_below(&r, 33 * 64) / 64.0f;
        q->y[i] = (float)test_rng_below(&r, 33 * 64) / 64.0f;
        q->z[i] = (float)test_rng_below(&r, 33 * 64) / 64.0f;
        for (a = 0; a < 3; a++) q->world[i][a] = (double)test_rng_below(&r, 6 * 256) / 256.0;
    }
    for (i = 0; i < 216; i++) q->coarse[i] = (float)test_rng_below(&r, 256) / 256.0f;
    for (i = 0; i < 64; i++) q->fine[i] = (float)test_rng_below(&r, 256) / 256.0f;
}

static void lattice_resampled(const way *w, const tetcast_mesh *mesh) {
    static float v[NODES], least[NODES], most[NODES], share[NODES];
    tetcast_resample_desc rd;
    tetcast_lattice lattice;
    tetcast_means means;
    uint32_t i;
    uint64_t h;
    REQUIRE(tetcast_lattice_fit(mesh, 18, &lattice) == TETCAST_OK);
    REQUIRE(lattice.dims[0] * lattice.dims[1] * lattice.dims[2] == NODES);
    memset(&rd, 0, sizeof rd);
    rd.env.thread_count = w->threads;
    rd.isa = (tetcast_isa)w->isa;
    rd.use_fill = 1;
    rd.fill = -1;
    REQUIRE(tetcast_resample(&rd, mesh, &lattice, v, NULL) == TETCAST_OK);
    h = put_floats(0, v, NODES);
    rd.extend = 1;
    rd.axis = 2;
    REQUIRE(tetcast_resample(&rd, mesh, &lattice, v, NULL) == TETCAST_OK);
    is_golden(GOLDEN_TETCAST_RESAMPLED, put_floats(h, v, NODES), w);
    means.mean = v;
    means.least = least;
    means.most = most;
    means.share = share;
    REQUIRE(tetcast_resample_mean(&rd.env, mesh, &lattice, &means) == TETCAST_OK);
    for (i = 0; i < NODES; i++)
        if (!(v[i] == v[i])) v[i] = least[i] = most[i] = -1; /* NaN: nothing is there */
    h = put_floats(put_floats(put_floats(put_floats(0, v, NODES), least, NODES), most, NODES), share, NODES);
    is_golden(GOLDEN_TETCAST_MEANS, h, w);
}

static void plane_cut(const way *w, const tetcast_mesh *mesh) { /* samples in a plane, and the polygons that it makes of cells */
    enum { PW = 24, PH = 20 };
    static float v[PW * PH];
    tetcast_env env;
    tetcast_plane plane;
    tetcast_section section;
    uint32_t i;
    uint64_t h;
    memset(&env, 0, sizeof env);
    env.thread_count = w->threads;
    memset(&plane, 0, sizeof plane);
    plane.origin[2] = 1.25;
    plane.u[0] = 6;
    plane.u[2] = 2;
    plane.v[1] = 6;
    plane.v[2] = 1;
    REQUIRE(tetcast_plane_sample(&env, mesh, &plane, PW, PH, v) == TETCAST_OK);
    for (i = 0; i < PW * PH; i++)
        if (!(v[i] == v[i])) v[i] = -1;
    h = put_floats(0, v, PW * PH);
    REQUIRE(tetcast_plane_section(&env, mesh, &plane, &section) == TETCAST_OK && section.polygon_count > 50);
    h = put_doubles(put_doubles(h, section.points[0], 3 * (size_t)section.point_count), &section.area, 1);
    h = put_floats(h, section.values, section.point_count);
    h = put_u32s(put_u32s(h, section.first, section.polygon_count + (size_t)1), section.cells, section.polygon_count);
    tetcast_section_free(&section);
    is_golden(GOLDEN_TETCAST_SECTION, h, w);
}

static uint64_t put_brick_file(uint64_t h, const tetcast_bricks *bricks) {
    const size_t size = tetcast_bricks_file_size(bricks);
    uint8_t *file = (uint8_t *)malloc(size + 1);
    CHECK(file != NULL && tetcast_bricks_write(bricks, file, size) == TETCAST_OK);
    h = test_fnv1a(file, size, h);
    free(file);
    return h;
}

static uint64_t brick_cut(uint64_t h, const way *w, const tetcast_bricks *bricks, const places *q) { /* what a cut has in it, and its picture */
    static float out[PLACES], gradient[PLACES][3];
    static tet_picture p;
    tetcast_optics *o = optics_make(TETCAST_MODEL_MIXED, TETCAST_INTEGRATOR_EXACT, 1);
    tetcast_cut_desc cd;
    tetcast_cut *cut = NULL;
    tetcast_brick_render_desc d;
    const tetcast_image image = tet_image(&p);
    memset(&cd, 0, sizeof cd);
    cd.env.thread_count = w->threads;
    cd.focus[0] = 1;
    cd.focus_radius = 2;
    CHECK(tetcast_cut_create(&cd, bricks, &cut) == TETCAST_OK);
    tetcast_cut_sample(cut, q->x, q->y, q->z, PLACES, (tetcast_isa)w->isa, out);
    h = put_floats(h, out, PLACES);
    tetcast_cut_gradient(cut, q->x, q->y, q->z, PLACES, out, gradient);
    h = put_floats(put_floats(h, out, PLACES), gradient[0], 3 * PLACES);
    memset(&d, 0, sizeof d);
    d.env.thread_count = w->threads;
    d.isa = (tetcast_isa)w->isa;
    CHECK(tetcast_render_bricks(&d, cut, o, &image, NULL) == TETCAST_OK);
    is_golden(GOLDEN_TETCAST_BRICK_PICTURE, tet_hash(&p, 0), w);
    tetcast_cut_destroy(cut);
    tetcast_optics_destroy(o);
    return h;
}

static void bricks_of(const way *w, const tetcast_mesh *mesh, const places *q) { /* files of each kind of number that nodes may be */
    static const tetcast_type smaller[3] = {TETCAST_TYPE_F16, TETCAST_TYPE_U16, TETCAST_TYPE_U8};
    tetcast_bricks_desc bd;
    tetcast_bricks *bricks = NULL;
    uint32_t i;
    uint64_t h;
    memset(&bd, 0, sizeof bd);
    bd.env.thread_count = w->threads;
    bd.log_cells = 3;
    bd.longest = 33;
    bd.max_error = 0.03125f;
    bd.checks = 200;
    REQUIRE(tetcast_bricks_create_mesh(&bd, mesh, NULL, &bricks) == TETCAST_OK);
    h = brick_cut(put_brick_file(0, bricks), w, bricks, q);
    tetcast_bricks_destroy(bricks);
    for (i = 0; i < 3; i++) {
        bd.storage = smaller[i];
        bd.longest = 17;
        bd.max_error = 0;
        REQUIRE(tetcast_bricks_create_mesh(&bd, mesh, NULL, &bricks) == TETCAST_OK);
        h = put_brick_file(h, bricks);
        tetcast_bricks_destroy(bricks);
    }
    is_golden(GOLDEN_TETCAST_BRICK_FILE, h, w);
}

static void amr_of(const way *w, const places *q) { /* a finer patch in a coarse one, by each way of filling in between */
    static float out[PLACES];
    tetcast_patch patch[2];
    tetcast_amr_desc ad;
    tetcast_amr *amr = NULL;
    uint32_t i, a;
    uint64_t h;
    memset(patch, 0, sizeof patch);
    memset(&ad, 0, sizeof ad);
    ad.env.thread_count = w->threads;
    patch[0].values = q->coarse;
    patch[1].values = q->fine;
    patch[1].level = 1;
    for (a = 0; a < 3; a++) {
        ad.cells[a] = patch[0].dims[a] = 6;
        patch[1].dims[a] = 4;
        patch[1].lo[a] = (int32_t)(2 + 2 * a);
    }
    ad.patches = patch;
    ad.patch_count = 2;
    REQUIRE(tetcast_amr_create(&ad, &amr) == TETCAST_OK);
    for (i = TETCAST_AMR_OCTANT, h = 0; i <= TETCAST_AMR_GTI; i++) {
        REQUIRE(tetcast_amr_sample(amr, (tetcast_amr_method)i, (const double (*)[3])q->world, PLACES, out) == TETCAST_OK);
        h = put_floats(h, out, PLACES);
    }
    is_golden(GOLDEN_TETCAST_AMR, h, w);
    tetcast_amr_destroy(amr);
}

TEST(tetcast_lattices) {
    static places q;
    tets m;
    way w[5];
    uint32_t k;
    const uint32_t n = ways((uint32_t)tetcast_isa_best(), w);
    lattice_make(&m);
    places_make(&q);
    for (k = 0; k < n; k++) {
        tetcast_mesh *mesh = tets_build(&m, TETCAST_CELLS_TET16, NULL);
        REQUIRE(mesh != NULL);
        lattice_resampled(&w[k], mesh);
        plane_cut(&w[k], mesh);
        bricks_of(&w[k], mesh, &q);
        tetcast_mesh_destroy(mesh);
        amr_of(&w[k], &q);
    }
    tets_free(&m);
}

/* Data for functions to be fitted to, functions of their own, and places to evaluate them at. */
enum { RBF_DIMS = 11, RBF_DATA = RBF_DIMS * RBF_DIMS * RBF_DIMS, RBF_PLACES = 400, RBF_FUNCTIONS = 60 };
typedef struct functions {
    float data[RBF_DATA];
    double at[RBF_PLACES][3];
    tetcast_rbf_function f[RBF_FUNCTIONS];
} functions;

static void functions_make(functions *q) {
    test_rng r = test_rng_make(17);
    tetcast_rbf_function *f = q->f;
    uint32_t i, a;
    for (i = 0; i < RBF_DATA; i++) { /* two bumps and some noise */
        const int c[3] = {(int)(i % RBF_DIMS), (int)(i / RBF_DIMS % RBF_DIMS), (int)(i / RBF_DIMS / RBF_DIMS)};
        int d = 0, e = 0;
        for (a = 0; a < 3; a++) {
            d += (c[a] - 3) * (c[a] - 3);
            e += (c[a] - 7) * (c[a] - 7);
        }
        q->data[i] = 4.0f / (float)(4 + d);
        if (e < d) q->data[i] = 3.0f / (float)(4 + e);
        q->data[i] += (float)test_rng_below(&r, 16) / 1024.0f;
    }
    for (i = 0; i < RBF_PLACES; i++)
        for (a = 0; a < 3; a++) q->at[i][a] = (double)test_rng_below(&r, 10 * 128) / 128.0;
    memset(f, 0, sizeof q->f);
    for (i = 0; i < RBF_FUNCTIONS; i++) {
        for (a = 0; a < 3; a++) {
            f[i].centre[a] = (double)test_rng_below(&r, 10 * 64) / 64.0;
            f[i].weight[a] = (float)((int)test_rng_below(&r, 257) - 128) / 128.0f;
            f[i].axis[a] = i % 3 == 0 ? (double)((int)test_rng_below(&r, 17) - 8) : 0;
        }
        f[i].width = (double)(32 + test_rng_below(&r, 96)) / 64.0;
        if (f[i].axis[0] != 0) f[i].stretch = 0.5;
    }
}

/* Returns the hash of the values that are fitted to the data. */
static uint64_t functions_fitted(const way *w, const functions *q, const tetcast_rbf_eval_desc *ed) {
    static float value[RBF_PLACES], jacobian[3 * RBF_PLACES];
    static tet_picture p;
    tetcast_rbf_fit_desc fd;
    tetcast_rbf_points points;
    tetcast_rbf_render_desc rd;
    tetcast_rbf *fit = NULL;
    tetcast_optics *o = optics_make(TETCAST_MODEL_MIXED, TETCAST_INTEGRATOR_EXACT, 1);
    const tetcast_image image = tet_image(&p);
    uint8_t *file;
    size_t size = 0;
    uint64_t h;
    memset(&points, 0, sizeof points);
    points.values.data = q->data;
    points.count = RBF_DATA;
    points.components = 1;
    points.dims[0] = points.dims[1] = points.dims[2] = RBF_DIMS;
    memset(&fd, 0, sizeof fd);
    fd.env.thread_count = w->threads;
    fd.isa = (tetcast_isa)w->isa;
    fd.max_error = 0.0625f;
    CHECK(tetcast_rbf_fit(&fd, &points, NULL, &fit) == TETCAST_OK);
    CHECK(tetcast_rbf_save_memory(fit, NULL, 0, &size) == TETCAST_OK);
    file = (uint8_t *)malloc(size + 1);
    CHECK(file != NULL && tetcast_rbf_save_memory(fit, file, size, &size) == TETCAST_OK);
    is_golden(GOLDEN_TETCAST_RBF_FILE, test_fnv1a(file, size, 0), w);
    free(file);
    CHECK(tetcast_rbf_eval(ed, fit, q->at[0], RBF_PLACES, value, jacobian) == TETCAST_OK);
    h = put_floats(put_floats(0, value, RBF_PLACES), jacobian, 3 * RBF_PLACES);
    memset(&rd, 0, sizeof rd);
    rd.env.thread_count = w->threads;
    rd.isa = (tetcast_isa)w->isa;
    rd.step = 0.375f;
    CHECK(tetcast_rbf_render(&rd, fit, o, &image, NULL) == TETCAST_OK);
    is_golden(GOLDEN_TETCAST_RBF_PICTURE, tet_hash(&p, 0), w);
    tetcast_rbf_destroy(fit);
    tetcast_optics_destroy(o);
    return h;
}

static uint64_t put_flow_features(uint64_t h, const float *value, const float *jacobian) { /* of every eighth place */
    uint32_t i;
    for (i = 0; i < RBF_PLACES; i += 8) {
        tetcast_flow features;
        tetcast_flow_features(value + 3 * i, jacobian + 9 * i, &features);
        h = put_floats(put_floats(h, &features.speed, 1), features.vorticity, 3);
        h = put_floats(put_floats(h, &features.lambda2, 1), &features.helicity, 1);
    }
    return h;
}

static void flow_traced(const way *w, const tetcast_rbf *flow, const functions *q) { /* by all steppers */
    enum { SEEDS = 20, STEPS = 12 };
    static double paths[SEEDS][STEPS + 1][3];
    static uint32_t lengths[SEEDS];
    static tetcast_trace_end ends[SEEDS];
    uint32_t i;
    uint64_t h = 0;
    for (i = TETCAST_STEPPER_RK4; i <= TETCAST_STEPPER_DOPRI5; i++) {
        tetcast_rbf_trace_desc td;
        memset(&td, 0, sizeof td);
        td.env.thread_count = w->threads;
        td.isa = (tetcast_isa)w->isa;
        td.stepper = (tetcast_stepper)i;
        td.dt = 0.25;
        td.steps = STEPS;
        memset(paths, 0, sizeof paths);
        REQUIRE(tetcast_rbf_trace(&td, flow, q->at[0], SEEDS, paths[0][0], lengths, ends) == TETCAST_OK);
        h = put_u32s(put_doubles(h, paths[0][0], SEEDS * (STEPS + 1) * 3), lengths, SEEDS);
    }
    is_golden(GOLDEN_TETCAST_TRACES, h, w);
}

TEST(tetcast_functions) {
    static functions q;
    static float value[3 * RBF_PLACES], jacobian[9 * RBF_PLACES];
    way w[5];
    uint32_t k, i;
    const uint32_t n = ways((uint32_t)tetcast_isa_best(), w);
    functions_make(&q);
    for (k = 0; k < n; k++) {
        tetcast_rbf_eval_desc ed;
        tetcast_rbf_desc cd;
        uint64_t h;
        memset(&ed, 0, sizeof ed);
        ed.env.thread_count = w[k].threads;
        ed.isa = (tetcast_isa)w[k].isa;
        h = functions_fitted(&w[k], &q, &ed);
        for (i = 0; i < TETCAST_KERNEL_COUNT; i++) {
            tetcast_rbf *flow = NULL;
            memset(&cd, 0, sizeof cd);
            cd.env.thread_count = 1;
            cd.components = 3;
            cd.box_max[0] = cd.box_max[1] = cd.box_max[2] = 10;
            cd.kernel = (tetcast_kernel)i;
            cd.functions = q.f;
            cd.function_count = RBF_FUNCTIONS;
            cd.offset[0] = 0.5f;
            REQUIRE(tetcast_rbf_create(&cd, &flow) == TETCAST_OK);
            REQUIRE(tetcast_rbf_eval(&ed, flow, q.at[0], RBF_PLACES, value, jacobian) == TETCAST_OK);
            h = put_floats(put_floats(h, value, 3 * RBF_PLACES), jacobian, 9 * RBF_PLACES);
            h = put_flow_features(h, value, jacobian);
            if (i == TETCAST_KERNEL_GAUSS) flow_traced(&w[k], flow, &q);
            tetcast_rbf_destroy(flow);
        }
        is_golden(GOLDEN_TETCAST_RBF_VALUES, h, &w[k]);
    }
}

TEST(tetcast_foams) {
    enum { SITES = 500, NEAR = 64 };
    static tetcast_site site[SITES];
    static tet_picture p;
    test_rng r = test_rng_make(19);
    way w[5];
    uint32_t k, i, a;
    const uint32_t n = ways((uint32_t)tetcast_isa_best(), w);
    memset(site, 0, sizeof site);
    for (i = 0; i < SITES; i++) { /* half of them in the corners of cubes */
        for (a = 0; a < 3; a++) {
            site[i].position[a] = i % 2 ? (double)test_rng_below(&r, 6) : (double)test_rng_below(&r, 10 * 128) / 256.0;
            site[i].rgb[a] = (float)test_rng_below(&r, 256) / 256.0f;
        }
        site[i].extinction = (float)test_rng_below(&r, 4) / 2.0f;
    }
    for (k = 0; k < n; k++) {
        tetcast_foam_desc d;
        tetcast_foam *foam = NULL;
        tetcast_foam_info info;
        tetcast_render_desc rd;
        const tetcast_image image = tet_image(&p);
        uint64_t h = 0;
        memset(&d, 0, sizeof d);
        memset(&rd, 0, sizeof rd);
        d.env.thread_count = rd.env.thread_count = w[k].threads;
        rd.isa = (tetcast_isa)w[k].isa;
        rd.background[3] = 1;
        REQUIRE(tetcast_foam_create(&d, site, SITES, &foam) == TETCAST_OK);
        tetcast_foam_get_info(foam, &info);
        for (i = 0; i < info.cell_count; i++) {
            uint32_t near_by[NEAR], own;
            const uint32_t count = tetcast_foam_cell(foam, i, &own, near_by, NEAR);
            REQUIRE(count <= NEAR);
            h = put_u32s(put_u32s(h, &own, 1), near_by, count);
        }
        REQUIRE(tetcast_foam_render(&rd, foam, &image, NULL) == TETCAST_OK);
        is_golden(GOLDEN_TETCAST_FOAM, tet_hash(&p, h), &w[k]);
        tetcast_foam_destroy(foam);
    }
}

TEST(tetcast_codecs) {
    enum { W = 30, H = 21 };
    static uint8_t rgba[4 * W * H], packed[8 * W * H], back[4 * W * H];
    const way one = {1, 1};
    const size_t n = tetcast_ccc_size(W, H, 1);
    size_t size;
    uint64_t h;
    uint32_t i;
    for (i = 0; i < 4 * W * H; i++) rgba[i] = (uint8_t)(mix(i / 24) + (i & 3) * 16 + (i / (4 * W)));
    REQUIRE(n > 0 && n <= sizeof packed && tetcast_pack_bound(W, H) <= sizeof packed);
    tetcast_ccc_encode(rgba, W, H, 0, 1, packed);
    h = test_fnv1a(packed, n, 0);
    tetcast_ccc_encode_fitted(rgba, W, H, 0, 1, packed);
    h = test_fnv1a(packed, n, h);
    tetcast_ccc_decode(packed, W, H, 0, 1, back);
    h = test_fnv1a(back, sizeof back, h);
    size = tetcast_pack(rgba, W, H, 0, packed);
    is_golden(GOLDEN_TETCAST_CODECS, test_fnv1a(packed, size, h), &one);
}

TEST(all_looked_at) {
    uint32_t i;
    if (test_g.filter_count != 0) SKIP("some tests were left out");
    for (i = 0; i < GOLDEN_COUNT; i++) CHECK_MSG(golden_seen[i], "%s", golden[i].name);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(voxrt_trees);
    RUN(voxrt_rays);
    RUN(voxrt_pictures);
    RUN(voxrt_edits);
    RUN(voxrt_light);
    RUN(zbufrand_scenes);
    RUN(zbufrand_reconstruction);
    RUN(zbufrand_theory);
    RUN(tetcast_meshes);
    RUN(tetcast_lattices);
    RUN(tetcast_functions);
    RUN(tetcast_foams);
    RUN(tetcast_codecs);
    RUN(all_looked_at);
    return test_end();
}
