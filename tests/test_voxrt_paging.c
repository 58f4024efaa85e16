/* Trees in pages: pictures of what is loaded against those of the whole tree, bit by bit; files made piece by piece
   against files of trees; room, threads, damaged files, failures. */
#include "test.h"
#define VOXRT_IMPLEMENTATION
#include "../voxrt.h"

enum { W = 96, H = 64 };

typedef struct picture {
    voxrt_image m;
    uint8_t rgba8[4 * W * H];
    float depth[W * H], normal[3 * W * H];
} picture;

static picture *picture_make(void) {
    picture *p = (picture *)calloc(1, sizeof *p);
    if (p == NULL) abort();
    p->m.width = W;
    p->m.height = H;
    p->m.rgba8 = p->rgba8;
    p->m.depth = p->depth;
    p->m.normal = p->normal;
    return p;
}

static int picture_equal(const picture *a, const picture *b) {
    return memcmp(a->rgba8, b->rgba8, sizeof a->rgba8) == 0 && memcmp(a->depth, b->depth, sizeof a->depth) == 0 &&
           memcmp(a->normal, b->normal, sizeof a->normal) == 0;
}

typedef struct file {
    uint8_t *data;
    size_t size, room;
} file;

static int file_write(void *user, uint64_t offset, const void *from, size_t bytes) {
    file *f = (file *)user;
    const size_t end = (size_t)offset + bytes;
    if (offset > 4096 && offset != f->size) return 1; /* as promised */
    if (end > f->room) {
        f->room = 2 * end;
        f->data = (uint8_t *)realloc(f->data, f->room);
        if (f->data == NULL) abort();
    }
    memcpy(f->data + offset, from, bytes);
    f->size = end > f->size ? end : f->size;
    return 0;
}

static file file_of(const voxrt_tree *t) {
    voxrt_save_desc save;
    file f = {NULL, 0, 0};
    memset(&save, 0, sizeof save);
    save.encoding = VOXRT_ENCODING_PAGED;
    CHECK(voxrt_tree_save_memory(t, &save, NULL, 0, &f.size) == VOXRT_OK);
    f.data = (uint8_t *)malloc(f.size);
    if (f.data == NULL) abort();
    CHECK(voxrt_tree_save_memory(t, &save, f.data, f.size, &f.size) == VOXRT_OK);
    return f;
}

static voxrt_paged *paged_of(const file *f, size_t memory, uint32_t wait) {
    voxrt_paged_desc d;
    voxrt_paged *p = NULL;
    voxrt_error error;
    memset(&d, 0, sizeof d);
    memset(&error, 0, sizeof error);
    d.data = f->data;
    d.size = f->size;
    d.memory = memory;
    d.wait = wait;
    d.env.error = &error;
    CHECK_MSG(voxrt_paged_open(&d, &p) == VOXRT_OK, "%s", error.text);
    return p;
}

/* Hills of n x n squares over [0, 1]^2, with colours; for the file of resolution `res`. */
typedef struct hills {
    float *position;
    uint8_t *rgb;
    uint32_t *index;
    voxrt_mesh mesh;
} hills;

static hills hills_make(uint32_t n, int colors) {
    hills h;
    uint32_t x, y, k = 0;
    memset(&h, 0, sizeof h);
    h.position = (float *)malloc(sizeof(float) * 3 * (n + 1) * (n + 1));
    h.rgb = (uint8_t *)malloc((size_t)3 * (n + 1) * (n + 1));
    h.index = (uint32_t *)malloc(sizeof(uint32_t) * 6 * n * n);
    if (h.position == NULL || h.rgb == NULL || h.index == NULL) abort();
    for (y = 0; y <= n; y++) {
        for (x = 0; x <= n; x++) {
            const size_t i = x + (size_t)(n + 1) * y;
            const double u = (double)x / n, v = (double)y / n;
            const double z = 0.12 * sin(9.0 * u) * cos(7.0 * v) + 0.03 * sin(41.0 * u + 13.0 * v) + 0.01 * sin(97.0 * v);
            h.position[3 * i] = (float)u;
            h.position[3 * i + 1] = (float)(z + 0.2);
            h.position[3 * i + 2] = (float)v;
            h.rgb[3 * i] = (uint8_t)(90.0 + 400.0 * z);
            h.rgb[3 * i + 1] = (uint8_t)(160.0 + 60.0 * sin(19.0 * u));
            h.rgb[3 * i + 2] = (uint8_t)(x * 7 + y * 3);
        }
    }
    for (y = 0; y < n; y++) {
        for (x = 0; x < n; x++) {
            const uint32_t a = x + (n + 1) * y, b = a + n + 1;
            const uint32_t t[6] = {a, b, a + 1, a + 1, b, b + 1};
            memcpy(h.index + k, t, sizeof t);
            k += 6;
        }
    }
    h.mesh.positions = h.position;
    h.mesh.vertex_count = (size_t)(n + 1) * (n + 1);
    h.mesh.indices = h.index;
    h.mesh.triangle_count = (size_t)2 * n * n;
    if (colors) h.mesh.vertex_rgb = h.rgb;
    return h;
}

static void hills_free(hills *h) {
    free(h->position);
    free(h->rgb);
    free(h->index);
}

static voxrt_tree *tree_of(const hills *h, uint32_t resolution, uint32_t planes, uint32_t no_normals) {
    voxrt_build_desc d;
    voxrt_tree *t = NULL;
    memset(&d, 0, sizeof d);
    d.resolution = resolution;
    d.palette_size = 1u << 24;
    d.planes = planes;
    d.disable_normals = no_normals;
    CHECK(voxrt_tree_build(&d, &h->mesh, NULL, &t) == VOXRT_OK);
    return t;
}

/* A view, as a number says it: from above, across, close by, from inside; level of detail, shadows, ... */
static void view_of(const voxrt_tree *t, uint32_t k, voxrt_render_desc *d) {
    double lo[3], hi[3];
    int a;
    memset(d, 0, sizeof *d);
    voxrt_tree_bounds(t, lo, hi);
    for (a = 0; a < 3; a++) {
        static const double eye[4][3] = {{0.5, 3.0, 1.6}, {-0.3, 1.6, 0.4}, {0.45, 1.2, 0.5}, {0.5, 0.6, 0.5}};
        static const double at[4][3] = {{0.5, 0.0, 0.5}, {0.8, 0.4, 0.6}, {0.55, 0.6, 0.8}, {0.9, 0.5, 0.1}};
        d->camera.eye[a] = (float)(lo[a] + eye[k & 3u][a] * (hi[a] - lo[a]));
        d->camera.at[a] = (float)(lo[a] + at[k & 3u][a] * (hi[a] - lo[a]));
    }
    d->shadows = k >> 2 & 1u;
    d->tolerance = k >> 3 & 1u ? (k >> 4 & 1u ? 4.0f : 1.0f) : 0.0f;
    d->blend = k >> 5 & 1u;
    d->isa = (voxrt_isa)(k >> 6 & 3u);
    d->cubes = (k >> 8 & 3u) == 3;
    d->max_level_plus_1 = (k >> 10 & 7u) == 7 ? 4 : 0;
    d->env.thread_count = 1 + (k & 1u);
}

static void draw(voxrt_render_desc d, const voxrt_tree *t, voxrt_paged *p, picture *out) {
    voxrt_geometry g;
    if (p != NULL) {
        voxrt_paged_geometry(p, &g);
        d.geometry = &g;
        d.geometry_count = 1;
    }
    CHECK(voxrt_render(&d, t, &out->m, NULL) == VOXRT_OK);
}

/* All that was asked for is loaded, until nothing is missing. Returns the number of pictures. */
static uint32_t draw_until_exact(const voxrt_render_desc *d, voxrt_paged *p, picture *out) {
    voxrt_paged_update_stats s;
    uint32_t n = 0;
    do {
        draw(*d, NULL, p, out);
        CHECK(voxrt_paged_update(p, 0, &s) == VOXRT_OK);
        CHECK(s.loaded == s.wanted);
        n++;
    } while (s.wanted != 0 && n < 100);
    return n;
}

/* Trees of all depths, with all attributes: the same bits, at once and bit by bit. */
static void same(const voxrt_tree *t, uint32_t views) {
    file f = file_of(t);
    voxrt_paged *wait = paged_of(&f, 0, 1);
    picture *a = picture_make(), *b = picture_make();
    uint32_t k;
    REQUIRE(wait != NULL);
    for (k = 0; k < views; k++) {
        voxrt_paged *slow = paged_of(&f, 0, 0);
        voxrt_render_desc d;
        view_of(t, k * 2654435761u >> 7, &d);
        draw(d, t, NULL, a);
        draw(d, NULL, wait, b);
        CHECK_MSG(picture_equal(a, b), "view %u at once", k);
        (void)draw_until_exact(&d, slow, b);
        CHECK_MSG(picture_equal(a, b), "view %u later", k);
        voxrt_paged_destroy(slow);
    }
    voxrt_paged_destroy(wait);
    free(a);
    free(b);
    free(f.data);
}

TEST(pictures_are_those_of_the_tree) {
    hills h = hills_make(60, 1);
    uint32_t resolution;
    for (resolution = 2; resolution <= (test_quick() ? 256u : 1024u); resolution *= 2) {
        voxrt_tree *t = tree_of(&h, resolution, resolution & 0x2aa ? 1 : 0, 0), *s = NULL;
        same(t, test_quick() ? 6 : 16);
        if (resolution == 64) {
            CHECK(voxrt_tree_share(t, NULL, &s) == VOXRT_OK);
            same(s, 4);
            voxrt_tree_destroy(s);
        }
        voxrt_tree_destroy(t);
    }
    hills_free(&h);
}

/* A file that is made piece by piece has the bytes of that of the tree. */
TEST(pieces_make_the_same_file) {
    uint32_t k;
    for (k = 0; k < (test_quick() ? 6u : 16u); k++) {
        static const uint32_t resolution[4] = {200, 60, 511, 7};
        hills h = hills_make(k < 8 ? 45 : 3, (k & 1u) == 0);
        voxrt_build_desc d;
        voxrt_build_stats stats, whole;
        voxrt_tree *t = NULL;
        voxrt_sink sink;
        file a, b = {NULL, 0, 0};
        memset(&d, 0, sizeof d);
        d.resolution = resolution[k & 3u];
        d.palette_size = 1u << 24;
        d.planes = k >> 2 & 1u;
        d.separating = (voxrt_separating)(k % 3);
        d.disable_normals = k == 3;
        d.env.thread_count = 1 + (k & 3u);
        if (k == 5) { /* part of it is outside of the grid */
            d.box_min[0] = 0.3;
            d.box_min[1] = 0.02;
            d.box_size = 0.4;
        }
        h.index[3 * 17 + 1] = 0x7fffffffu; /* a bad triangle */
        REQUIRE(voxrt_tree_build(&d, &h.mesh, &whole, &t) == VOXRT_OK);
        a = file_of(t);
        sink.write_fn = file_write;
        sink.user = &b;
        if ((k & 1u) == 0) d.env.memory_limit = 3u << 20; /* many pieces */
        CHECK(voxrt_paged_build(&d, &h.mesh, &sink, &stats) == VOXRT_OK);
        CHECK_MSG(a.size == b.size && memcmp(a.data, b.data, a.size) == 0, "file %u", k);
        CHECK(stats.voxels == whole.voxels && stats.rejected == 1 && whole.rejected == 1);
        CHECK(stats.fragments == whole.fragments && stats.degenerate == whole.degenerate);
        voxrt_tree_destroy(t);
        free(a.data);
        free(b.data);
        hills_free(&h);
    }
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(pictures_are_those_of_the_tree);
    RUN(pieces_make_the_same_file);
    return test_end();
}
