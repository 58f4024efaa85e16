/* Trees in pages: pictures of what is loaded against those of the whole tree, bit by bit; files made piece by piece
   against files of trees; room, threads, damaged files, failures. */
#include "test.h"
#define VOXRT_IMPLEMENTATION
#include "../voxrt.h"

enum { W = 96, H = 64 };

typedef struct paging_picture {
    voxrt_image m;
    uint8_t rgba8[4 * W * H];
    float depth[W * H], normal[3 * W * H];
} paging_picture;

static paging_picture *picture_make(void) {
    paging_picture *p = (paging_picture *)calloc(1, sizeof *p);
    if (p == NULL) abort();
    p->m.width = W;
    p->m.height = H;
    p->m.rgba8 = p->rgba8;
    p->m.depth = p->depth;
    p->m.normal = p->normal;
    return p;
}

static int picture_equal(const paging_picture *a, const paging_picture *b) {
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

/* Hills, their tree, its file, and room for two pictures. */
typedef struct fixture {
    hills h;
    voxrt_tree *t;
    file f;
    paging_picture *exact, *p;
} fixture;

static fixture fixture_make(uint32_t squares, uint32_t resolution, uint32_t planes) {
    fixture x;
    x.h = hills_make(squares, 1);
    x.t = tree_of(&x.h, resolution, planes, 0);
    x.f = file_of(x.t);
    x.exact = picture_make();
    x.p = picture_make();
    return x;
}

static void fixture_free(fixture *x) {
    voxrt_tree_destroy(x->t);
    free(x->f.data);
    free(x->exact);
    free(x->p);
    hills_free(&x->h);
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

static void paging_draw(voxrt_render_desc d, const voxrt_tree *t, voxrt_paged *p, paging_picture *out) {
    voxrt_geometry g;
    if (p != NULL) {
        voxrt_paged_geometry(p, &g);
        d.geometry = &g;
        d.geometry_count = 1;
    }
    CHECK(voxrt_render(&d, t, &out->m, NULL) == VOXRT_OK);
}

/* All that was asked for is loaded, until nothing is missing. Returns the number of pictures. */
static uint32_t draw_until_exact(const voxrt_render_desc *d, voxrt_paged *p, paging_picture *out) {
    voxrt_paged_update_stats s;
    uint32_t n = 0;
    do {
        paging_draw(*d, NULL, p, out);
        CHECK(voxrt_paged_update(p, 0, &s) == VOXRT_OK);
        CHECK((s.loaded != 0) == (s.wanted != 0));
        n++;
    } while (s.wanted != 0 && n < 100);
    return n;
}

/* Level of detail, mixed, of all sizes: cells of each level of pages and those around them. */
static void same_detail(const voxrt_tree *t) {
    file f = file_of(t);
    voxrt_paged *p = paged_of(&f, 0, 1);
    paging_picture *a = picture_make(), *b = picture_make();
    float e;
    REQUIRE(p != NULL);
    for (e = 0.7f; e < 300.0f; e *= 1.6f) {
        voxrt_render_desc d;
        view_of(t, 0, &d);
        d.tolerance = e;
        d.blend = 1;
        paging_draw(d, t, NULL, a);
        paging_draw(d, NULL, p, b);
        CHECK_MSG(picture_equal(a, b), "tolerance %g", (double)e);
    }
    voxrt_paged_destroy(p);
    free(a);
    free(b);
    free(f.data);
}

/* What the header says of a tree: depth, resolution, nodes, voxels. */
static void same_header(const voxrt_tree *t, const file *f) {
    size_t size = 0;
    uint8_t *data;
    CHECK(voxrt_tree_save_memory(t, NULL, NULL, 0, &size) == VOXRT_OK);
    data = (uint8_t *)malloc(size);
    if (data == NULL) abort();
    CHECK(voxrt_tree_save_memory(t, NULL, data, size, &size) == VOXRT_OK && memcmp(data + 36, f->data + 36, 28) == 0);
    free(data);
}

/* Trees of all depths, with all attributes: the same bits, at once and bit by bit. */
static void same(const voxrt_tree *t, uint32_t views) {
    file f = file_of(t);
    voxrt_paged *wait = paged_of(&f, 0, 1);
    paging_picture *a = picture_make(), *b = picture_make();
    uint32_t k;
    REQUIRE(wait != NULL);
    same_header(t, &f);
    for (k = 0; k < views; k++) {
        voxrt_paged *slow = paged_of(&f, 0, 0);
        voxrt_render_desc d;
        view_of(t, k * 2654435761u >> 7, &d);
        paging_draw(d, t, NULL, a);
        paging_draw(d, NULL, wait, b);
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
        same(t, test_quick() ? 3 : 16);
        same_detail(t);
        if (resolution == 64) {
            CHECK(voxrt_tree_share(t, NULL, &s) == VOXRT_OK);
            same(s, 4);
            voxrt_tree_destroy(s);
        }
        voxrt_tree_destroy(t);
    }
    hills_free(&h);
}

/* Triangles whose backs are others' faces leave cubes among voxels with planes. */
TEST(cubes_stand_among_planes) {
    hills h = hills_make(20, 1);
    const size_t n = h.mesh.triangle_count;
    uint32_t *both = (uint32_t *)malloc(2 * 3 * n * sizeof *both);
    voxrt_tree *t;
    size_t i, count = 0;
    int k;
    REQUIRE(both != NULL);
    memcpy(both, h.index, 3 * n * sizeof *both);
    for (i = 0; i < n / 2; i++)
        for (k = 0; k < 3; k++) both[3 * (n + i) + (size_t)k] = h.index[3 * i + (size_t)(2 - k)];
    h.mesh.indices = both;
    h.mesh.triangle_count = n + n / 2;
    t = tree_of(&h, 90, 1, 0);
    for (i = 0; i < (size_t)t->voxel_count; i++) count += t->plane[i] == 0;
    CHECK_MSG(count > 100 && count < (size_t)t->voxel_count, "%u cubes", (unsigned)count);
    same(t, 6);
    voxrt_tree_destroy(t);
    free(both);
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

/* Triangles whose corners come to lie in the next piece when they are rounded: walls just below its first cell. */
TEST(pieces_have_what_is_rounded_into_them) {
    uint32_t k, i, a;
    for (k = 0; k < 6; k++) {
        float position[12];
        const uint32_t index[6] = {0, 1, 2, 2, 1, 3};
        voxrt_build_desc d;
        voxrt_mesh mesh;
        voxrt_tree *t = NULL;
        voxrt_tree_info info;
        voxrt_sink sink;
        file f, b = {NULL, 0, 0};
        memset(&d, 0, sizeof d);
        memset(&mesh, 0, sizeof mesh);
        d.resolution = 4096;
        d.box_size = 4096.0; /* cells are units */
        d.separating = VOXRT_SEPARATING_26;
        d.palette_size = 1u << 24;
        for (i = 0; i < 4; i++) {
            for (a = 0; a < 3; a++) position[3 * i + a] = 40.0f + (float)(a == (k + 1) % 3 ? i & 1u : i >> 1) * 100.0f;
            position[3 * i + k % 3] = k < 3 ? 2047.99951f : 2048.00049f; /* rounded to 1/256: to 2048 */
        }
        mesh.positions = position;
        mesh.vertex_count = 4;
        mesh.indices = index;
        mesh.triangle_count = 2;
        REQUIRE(voxrt_tree_build(&d, &mesh, NULL, &t) == VOXRT_OK);
        voxrt_tree_get_info(t, &info);
        CHECK(info.cell_min[k % 3] == 2047 && info.cell_max[k % 3] == 2049); /* both sides of the border */
        f = file_of(t);
        sink.write_fn = file_write;
        sink.user = &b;
        d.env.memory_limit = 1u << 20; /* many pieces */
        CHECK(voxrt_paged_build(&d, &mesh, &sink, NULL) == VOXRT_OK);
        CHECK_MSG(f.size == b.size && memcmp(f.data, b.data, f.size) == 0, "wall %u", k);
        voxrt_tree_destroy(t);
        free(f.data);
        free(b.data);
    }
}

/* ---- room and time ---- */

static voxrt_allocator counted(test_alloc *ta) {
    voxrt_allocator a;
    test_alloc_init(ta);
    a.alloc_fn = test_alloc_fn;
    a.free_fn = test_free_fn;
    a.user = ta;
    return a;
}

static void stripes(void *user, voxrt_sample *sample) { /* a texture: by the triangle and the place in it */
    (void)user;
    sample->color[0] = sample->weight[0] > 0.5f ? 1.0f : 0.0f;
    sample->color[1] = (float)(sample->triangle % 7) / 7.0f;
    sample->color[2] = 1.0f - sample->color[0];
}

/* Textures, whose triangles have the numbers of the mesh in any piece. */
TEST(pieces_have_textures) {
    hills h = hills_make(40, 0);
    voxrt_build_desc d;
    uint32_t k;
    memset(&d, 0, sizeof d);
    d.resolution = 300;
    d.palette_size = 1u << 24;
    h.index[3 * 5] = 0x7fffffffu; /* a bad triangle has a number, too */
    h.mesh.sample_fn = stripes;
    for (k = 0; k < 3; k++) {
        file pages = {NULL, 0, 0}, of_tree;
        voxrt_sink sink;
        voxrt_tree *t = NULL;
        d.disable_normals = k == 2;
        d.env.memory_limit = 0;
        REQUIRE(voxrt_tree_build(&d, &h.mesh, NULL, &t) == VOXRT_OK);
        of_tree = file_of(t);
        sink.write_fn = file_write;
        sink.user = &pages;
        if (k != 0) d.env.memory_limit = 3u << 20; /* many pieces */
        CHECK(voxrt_paged_build(&d, &h.mesh, &sink, NULL) == VOXRT_OK);
        CHECK_MSG(of_tree.size == pages.size && memcmp(of_tree.data, pages.data, pages.size) == 0, "file %u", k);
        voxrt_tree_destroy(t);
        free(of_tree.data);
        free(pages.data);
    }
    hills_free(&h);
}

/* Mirrors, glass, lamps and the spread of normals: files and pictures as of the tree, with any of them left out. */
TEST(pages_have_finishes_and_spread) {
    static const uint32_t resolution[6] = {2, 7, 30, 60, 200, 300};
    voxrt_finish finish[3];
    paging_picture *a = picture_make(), *b = picture_make();
    uint32_t k, differs = 0;
    memset(finish, 0, sizeof finish);
    finish[0].diffuse = 0.5f;
    finish[0].mirror[0] = finish[0].mirror[1] = 0.5f;
    finish[0].specular[1] = 0.7f;
    finish[0].shininess = 30.0f;
    finish[1].diffuse = 0.3f;
    finish[1].transparency[0] = finish[1].transparency[2] = 0.6f;
    finish[2].diffuse = 1.0f;
    finish[2].emission[1] = 0.5f;
    for (k = 0; k < 12; k++) {
        hills h = hills_make(40, (k & 1u) == 0);
        file pages = {NULL, 0, 0}, of_tree;
        uint8_t *number = (uint8_t *)calloc(h.mesh.triangle_count, 1);
        voxrt_build_desc d;
        voxrt_sink sink;
        voxrt_tree *t = NULL;
        voxrt_tree_info tree;
        voxrt_paged_info info;
        voxrt_paged *wait, *slow;
        voxrt_geometry g, whole;
        size_t i;
        uint32_t view;
        REQUIRE(number != NULL);
        for (i = 0; i < h.mesh.triangle_count; i++) number[i] = (uint8_t)(i / 25 % (k == 7 ? 2 : 4));
        memset(&d, 0, sizeof d);
        d.resolution = resolution[k % 6];
        d.palette_size = 1u << 24;
        d.planes = k >> 1 & 1u;
        d.spread = k != 5;
        d.finishes = k % 4 != 3 || k == 7 ? finish : NULL;
        d.finish_count = d.finishes == NULL ? 0 : k == 7 ? 1 : 3;
        d.disable_normals = k == 5;
        if (d.disable_normals) d.planes = 0;
        if (d.finish_count != 0) h.mesh.triangle_finish = number;
        if (k == 8) h.mesh.sample_fn = stripes;
        REQUIRE(voxrt_tree_build(&d, &h.mesh, NULL, &t) == VOXRT_OK);
        voxrt_tree_get_info(t, &tree);
        of_tree = file_of(t);
        sink.write_fn = file_write;
        sink.user = &pages;
        if (k > 5) d.env.memory_limit = 4u << 20;
        CHECK(voxrt_paged_build(&d, &h.mesh, &sink, NULL) == VOXRT_OK);
        if (tree.finish_count == d.finish_count) /* a tree has those that occur */
            CHECK_MSG(of_tree.size == pages.size && memcmp(of_tree.data, pages.data, pages.size) == 0, "file %u", k);
        wait = paged_of(&pages, 0, 1);
        slow = paged_of(&of_tree, 0, 0);
        REQUIRE(wait != NULL && slow != NULL);
        voxrt_paged_get_info(slow, &info);
        CHECK(info.finish_count == tree.finish_count && info.has_spread == tree.has_spread);
        CHECK(info.has_colors == (d.finish_count != 0 || (k & 1u) == 0 || k == 8));
        voxrt_paged_geometry(wait, &g);
        voxrt_tree_geometry(t, &whole);
        CHECK(g.glass == whole.glass && (tree.finish_count < 3 || g.glass == 1));
        for (view = 0; view < 4; view++) {
            voxrt_render_desc v;
            view_of(t, view | (view == 2 ? 0u : 4u) | (view == 3 ? 8u + 32u : 0u), &v);
            paging_draw(v, t, NULL, a);
            paging_draw(v, NULL, wait, b);
            CHECK_MSG(picture_equal(a, b), "case %u, view %u at once", k, view);
            (void)draw_until_exact(&v, slow, b);
            CHECK_MSG(picture_equal(a, b), "case %u, view %u later", k, view);
            v.bounces_plus_1 = 1;
            paging_draw(v, t, NULL, b);
            differs += !picture_equal(a, b);
        }
        if (k % 3 == 0) same_detail(t);
        voxrt_paged_destroy(wait);
        voxrt_paged_destroy(slow);
        voxrt_tree_destroy(t);
        free(of_tree.data);
        free(pages.data);
        free(number);
        hills_free(&h);
    }
    CHECK_MSG(differs > 8, "light bounces in %u pictures", differs);
    free(a);
    free(b);
}

/* What building says of its progress, and that it may be stopped anywhere, also when all is one piece. */
typedef struct watch {
    uint64_t last, total, stop_at;
    uint32_t calls, back;
} watch;

static int watch_fn(void *user, uint64_t done, uint64_t total) {
    watch *w = (watch *)user;
    w->back += done < w->last || done > total || (w->calls != 0 && total != w->total);
    w->last = done;
    w->total = total;
    return ++w->calls == w->stop_at;
}

TEST(building_can_be_watched_and_stopped) {
    hills h = hills_make(60, 1);
    uint32_t k;
    for (k = 0; k < 3; k++) { /* one piece, many, and more than the levels that progress tells apart */
        voxrt_build_desc d;
        voxrt_sink sink;
        watch w;
        uint64_t calls, stop;
        file to = {NULL, 0, 0};
        memset(&d, 0, sizeof d);
        memset(&w, 0, sizeof w);
        d.resolution = k == 2 ? 4096 : k == 1 ? 600 : 40;
        if (k != 0) d.env.memory_limit = 4u << 20;
        if (k == 2) { /* a small part of the grid, which is cut often */
            d.box_min[0] = d.box_min[1] = d.box_min[2] = -9.5;
            d.box_size = 20.0;
        }
        d.env.progress_fn = watch_fn;
        d.env.progress_user = &w;
        sink.write_fn = file_write;
        sink.user = &to;
        CHECK(voxrt_paged_build(&d, &h.mesh, &sink, NULL) == VOXRT_OK);
        CHECK_MSG(w.calls != 0 && w.back == 0 && w.last == w.total, "case %u: %u calls, %u went back, %g of %g", k, w.calls,
                  w.back, (double)w.last, (double)w.total);
        calls = w.calls;
        for (stop = 1; stop <= calls; stop += 1 + calls / 5) {
            memset(&w, 0, sizeof w);
            w.stop_at = stop;
            to.size = 0;
            CHECK(voxrt_paged_build(&d, &h.mesh, &sink, NULL) == VOXRT_ERR_CANCELLED && w.calls == stop);
        }
        free(to.data);
    }
    hills_free(&h);
}

/* A limit of memory holds for what is made on the way, too: plain copies of shared trees. */
TEST(limits_hold_for_shared_trees) {
    hills h = hills_make(60, 1);
    voxrt_tree *plain = NULL, *shared = NULL;
    voxrt_build_desc build;
    uint32_t what;
    memset(&build, 0, sizeof build);
    build.resolution = 300;
    build.palette_size = 1000;
    CHECK(voxrt_tree_build(&build, &h.mesh, NULL, &plain) == VOXRT_OK);
    CHECK(voxrt_tree_share(plain, NULL, &shared) == VOXRT_OK);
    for (what = 0; what < 4; what++) {
        size_t limit;
        int refused = 0;
        for (limit = 200000; limit < 64u << 20; limit += limit / 4) {
            test_alloc ta;
            voxrt_env env;
            voxrt_result r;
            memset(&env, 0, sizeof env);
            env.allocator = counted(&ta);
            env.memory_limit = limit;
            env.thread_count = 1;
            if (what == 0) {
                voxrt_save_desc d;
                size_t size;
                memset(&d, 0, sizeof d);
                d.env = env;
                d.encoding = VOXRT_ENCODING_PAGED;
                r = voxrt_tree_save_memory(shared, &d, NULL, 0, &size);
            } else if (what == 1) {
                voxrt_model *m = NULL;
                r = voxrt_model_from_tree(&env, shared, &m);
                voxrt_model_destroy(m);
            } else if (what == 2) {
                voxrt_octree_desc d;
                voxrt_octree *o = NULL;
                memset(&d, 0, sizeof d);
                d.env = env;
                r = voxrt_octree_from_tree(&d, shared, &o);
                voxrt_octree_destroy(o);
            } else {
                voxrt_tree *t = NULL;
                r = voxrt_tree_share(shared, &env, &t);
                voxrt_tree_destroy(t);
            }
            test_alloc_check(&ta);
            CHECK_MSG(ta.peak_bytes <= limit, "%u: %g bytes of %g", what, (double)ta.peak_bytes, (double)limit);
            CHECK(r == VOXRT_OK || r == VOXRT_ERR_NO_MEMORY);
            refused += r != VOXRT_OK;
            if (r == VOXRT_OK) break;
        }
        CHECK_MSG(limit < 64u << 20 && refused > 1, "%u: %d refused", what, refused);
    }
    voxrt_tree_destroy(shared);
    voxrt_tree_destroy(plain);
    hills_free(&h);
}

/* Whatever the room is, it is never exceeded, all of it is there from the beginning, and those who wait get exact
   pictures, with any number of threads. */
TEST(room_is_kept) {
    fixture x = fixture_make(60, 500, 1);
    voxrt_paged_desc d;
    voxrt_error error;
    voxrt_paged *paged = NULL;
    size_t least, memory;
    uint32_t k = 0;
    memset(&d, 0, sizeof d);
    memset(&error, 0, sizeof error);
    d.data = x.f.data;
    d.size = x.f.size;
    d.env.error = &error;
    d.memory = 1000;
    CHECK(voxrt_paged_open(&d, &paged) == VOXRT_ERR_RANGE && paged == NULL && error.where > 1000);
    d.memory = least = (size_t)error.where; /* what would do, at the first try */
    REQUIRE(voxrt_paged_open(&d, &paged) == VOXRT_OK);
    voxrt_paged_destroy(paged);
    d.memory = least - 1;
    CHECK(voxrt_paged_open(&d, &paged) == VOXRT_ERR_RANGE && error.where == least);
    for (memory = least; memory < 16 * x.f.size; memory = memory * 3 / 2, k++) {
        test_alloc ta;
        voxrt_paged_info info;
        voxrt_render_desc v;
        int64_t count;
        uint32_t round;
        d.env.allocator = counted(&ta);
        d.memory = memory;
        d.wait = 1;
        REQUIRE(voxrt_paged_open(&d, &paged) == VOXRT_OK);
        count = ta.count;
        CHECK_MSG(ta.live_bytes <= memory, "%g of %g bytes", (double)ta.live_bytes, (double)memory);
        for (round = 0; round < 4; round++) {
            view_of(x.t, round | round << 2 | (round == 3 ? 8u : 0u), &v);
            v.env.thread_count = 1 + k % 4;
            paging_draw(v, x.t, NULL, x.exact);
            paging_draw(v, NULL, paged, x.p);
            CHECK_MSG(picture_equal(x.exact, x.p), "memory %g, view %u", (double)memory, round);
        }
        voxrt_paged_get_info(paged, &info);
        CHECK(info.coarse_rays == 0 && info.bad_pages == 0 && info.memory <= memory && info.loaded_bytes <= memory);
        CHECK(ta.count == count && ta.live_bytes == info.memory);
        if (memory == least) CHECK(info.evictions > 10 && info.reads > info.page_count / 4);
        if (memory > 4 * x.f.size) CHECK(info.evictions == 0 && info.reads == info.loaded_pages);
        CHECK(info.evictions + info.loaded_pages <= info.reads); /* some were read and found no room */
        voxrt_paged_destroy(paged);
        test_alloc_check(&ta);
    }
    fixture_free(&x);
}

/* What cells of a level look like. */
typedef struct looks {
    uint8_t rgb[8][3];
    float normal[8][3];
    uint32_t n;
} looks;

static int looks_add(void *user, const voxrt_voxel *v, uint32_t index) {
    looks *l = (looks *)user;
    (void)index;
    memcpy(l->rgb[l->n], v->rgb, 3);
    memcpy(l->normal[l->n++], v->normal, sizeof v->normal);
    return l->n == 8;
}

/* A picture of what is there has no holes: what it shows is never behind what the whole tree shows; pixels that are
   right stay so; and it is the same for any number of threads. A page at a time. */
TEST(coarse_pictures_get_finer) {
    fixture x = fixture_make(60, 500, 0);
    paging_picture *p = x.p, *q = picture_make(), *before = picture_make();
    uint32_t view;
    for (view = 0; view < (test_quick() ? 2u : 8u); view++) {
        voxrt_paged *one = paged_of(&x.f, 0, 0), *many = paged_of(&x.f, 0, 0);
        voxrt_render_desc d;
        uint32_t n = 0, first = 0, last = 0, i;
        voxrt_paged_update_stats s, r;
        view_of(x.t, view, &d);
        d.view = VOXRT_VIEW_UNLIT; /* shadows of coarse cells come and go */
        paging_draw(d, x.t, NULL, x.exact);
        do {
            uint32_t wrong = 0;
            d.env.thread_count = 1;
            paging_draw(d, NULL, one, p);
            d.env.thread_count = 2 + n % 3;
            paging_draw(d, NULL, many, q);
            CHECK(picture_equal(p, q));
            for (i = 0; i < W * H; i++) {
                const int same_now = p->depth[i] == x.exact->depth[i] && memcmp(p->rgba8 + 4 * i, x.exact->rgba8 + 4 * i, 4) == 0;
                CHECK_MSG(p->depth[i] <= x.exact->depth[i], "pixel %u of picture %u: %g behind %g", i, n, (double)p->depth[i],
                          (double)x.exact->depth[i]);
                if (n != 0) CHECK(p->depth[i] >= before->depth[i]);
                wrong += !same_now;
            }
            if (n == 0) { /* only the first page: cells of level 1 */
                const voxrt_trace_desc td = {0};
                voxrt_geometry g;
                voxrt_surface s1;
                voxrt_ray ray = {{0.0f, 9.0f, 0.0f}, 0.0f, {0.0f, -1.0f, 0.0f}, INFINITY};
                looks l;
                voxrt_paged_geometry(one, &g);
                ray.org[0] = (float)(0.3 * g.box_min[0] + 0.7 * g.box_max[0]);
                ray.org[2] = (float)(0.6 * g.box_min[2] + 0.4 * g.box_max[2]);
                g.trace_fn(g.user, &td, &ray, &s1, 1);
                CHECK(s1.t < INFINITY && s1.edge == (float)(one->tree.voxel_size * (double)(1u << (one->tree.depth - 1))));
                first = wrong;
                l.n = 0;
                (void)voxrt_tree_each(x.t, 1, looks_add, &l);
                CHECK(l.n >= 4);
                for (i = 0; i < W * H; i++) {
                    uint32_t k;
                    if (p->rgba8[4 * i + 3] == 0) continue;
                    for (k = 0; k < l.n && memcmp(l.rgb[k], p->rgba8 + 4 * i, 3) != 0; k++) { }
                    CHECK(k < l.n && fabsf(l.normal[k][0]) == fabsf(p->normal[3 * i])); /* it may be turned */
                }
            }
            last = wrong;
            CHECK(voxrt_paged_update(one, 1, &s) == VOXRT_OK && voxrt_paged_update(many, 1, &r) == VOXRT_OK);
            CHECK(memcmp(&s, &r, sizeof s) == 0);
            CHECK(s.loaded == (s.wanted != 0));
            memcpy(before->depth, p->depth, sizeof p->depth);
        } while (++n < 2000 && s.wanted != 0);
        CHECK_MSG(first > W * H / 8 && last == 0 && n > 8, "%u pixels are wrong, then %u, after %u", first, last, n);
        voxrt_paged_destroy(one);
        voxrt_paged_destroy(many);
    }
    free(q);
    free(before);
    fixture_free(&x);
}

/* With shadows no more is read on the way to the exact picture than that needs, and the order does not depend on threads. */
TEST(shadows_of_coarse_cells_ask_for_nothing) {
    static const voxrt_light low = {{0.9f, 0.15f, 0.4f}, 1, {1.0f, 1.0f, 1.0f}, 0}; /* long shadows */
    fixture x = fixture_make(60, 500, 0);
    uint32_t view;
    for (view = 0; view < 4; view++) {
        voxrt_paged *wait = paged_of(&x.f, 0, 1), *one = paged_of(&x.f, 0, 0), *many = paged_of(&x.f, 0, 0);
        voxrt_paged_info needs, has;
        voxrt_paged_update_stats s, r;
        voxrt_render_desc d;
        uint32_t n;
        REQUIRE(wait != NULL && one != NULL && many != NULL);
        view_of(x.t, view | 4u, &d);
        d.lights = &low;
        d.light_count = 1;
        paging_draw(d, x.t, NULL, x.exact);
        paging_draw(d, NULL, wait, x.p);
        voxrt_paged_get_info(wait, &needs);
        for (n = 0; n < 200; n++) {
            d.env.thread_count = 1;
            paging_draw(d, NULL, one, x.p);
            CHECK(voxrt_paged_update(one, 300000, &s) == VOXRT_OK);
            d.env.thread_count = 3;
            paging_draw(d, NULL, many, x.p);
            CHECK(voxrt_paged_update(many, 300000, &r) == VOXRT_OK && memcmp(&s, &r, sizeof s) == 0);
            if (s.wanted == 0) break;
            CHECK(s.loaded != 0 && s.no_room == 0);
        }
        CHECK(n < 200 && picture_equal(x.p, x.exact));
        voxrt_paged_get_info(one, &has);
        CHECK_MSG(has.reads <= needs.reads, "view %u: %g pages, not %g", view, (double)has.reads, (double)needs.reads);
        voxrt_paged_destroy(wait);
        voxrt_paged_destroy(one);
        voxrt_paged_destroy(many);
    }
    fixture_free(&x);
}

/* Views that follow each other have room for one of them: what the last one loaded gives way. */
static void corner_view(const voxrt_tree *t, uint32_t k, voxrt_render_desc *d) {
    double lo[3], hi[3];
    int a;
    view_of(t, 4, d);
    voxrt_tree_bounds(t, lo, hi);
    for (a = 0; a < 3; a++) {
        const double size = hi[a] - lo[a], side = a == 0 ? k & 1u : k >> 1 & 1u;
        d->camera.eye[a] = (float)(lo[a] + size * (a == 1 ? 2.0 : 0.2 + 0.6 * side));
        d->camera.at[a] = (float)(lo[a] + size * (a == 1 ? 0.0 : 0.21 + 0.58 * side));
    }
}

TEST(views_follow_each_other) {
    fixture x = fixture_make(60, 500, 0);
    voxrt_paged_info info;
    voxrt_paged *p = paged_of(&x.f, 0, 1);
    size_t most = 0, sum = 0;
    uint32_t k;
    REQUIRE(p != NULL);
    for (k = 0; k < 4; k++) {
        voxrt_render_desc d;
        corner_view(x.t, k, &d);
        voxrti_paged_clear(p);
        paging_draw(d, NULL, p, x.p);
        voxrt_paged_get_info(p, &info);
        if ((size_t)info.loaded_bytes > most) most = (size_t)info.loaded_bytes;
        sum += (size_t)info.loaded_bytes;
    }
    voxrt_paged_destroy(p);
    CHECK(most + most / 8 < sum / 2);
    p = paged_of(&x.f, most + most / 8 + 65536, 0);
    REQUIRE(p != NULL);
    for (k = 0; k < 12; k++) {
        voxrt_render_desc d;
        corner_view(x.t, k % 4, &d);
        paging_draw(d, x.t, NULL, x.exact);
        CHECK_MSG(draw_until_exact(&d, p, x.p) < 20 && picture_equal(x.p, x.exact), "view %u", k);
    }
    voxrt_paged_get_info(p, &info);
    CHECK(info.evictions > 20);
    voxrt_paged_destroy(p);
    fixture_free(&x);
}

/* What is loaded, looked at from inside: who owns which frames, nothing without what is above it, sums. */
static void check_arena(const voxrt_paged *p) {
    uint32_t i, f, loaded = 0;
    uint64_t frames = 0;
    for (i = 0; i < p->page_count; i++) {
        const voxrti_page *g = &p->page[i];
        if (g->place == 0) continue;
        loaded++;
        frames += g->frames;
        CHECK(g->place >= p->first_frame && g->place + g->frames <= p->frames);
        for (f = 0; f < g->frames; f++) CHECK(p->owner[g->place + f] == i);
        CHECK_MSG(p->page[g->parent].place != 0, "page %u is there without the one above", i);
    }
    for (f = 0; f < p->frames; f++) {
        if (p->owner[f] == VOXRTI_NO_PAGE) continue;
        CHECK(p->page[p->owner[f]].place <= f && f < p->page[p->owner[f]].place + p->page[p->owner[f]].frames);
    }
    CHECK(loaded == p->loaded_pages && frames == p->loaded_frames);
}

/* 16 patches of voxels far from each other: each has a page of its own below the first one, and some below that. */
static voxrt_tree *patches(float place[16][2]) {
    test_rng r = test_rng_make(3);
    voxrt_voxel *v = (voxrt_voxel *)calloc(16 * 1600, sizeof *v);
    voxrt_tree *t = NULL;
    uint32_t i, k, n = 0;
    if (v == NULL) abort();
    for (k = 0; k < 16; k++) {
        const uint32_t x = 1024 * (k & 3u) + 100 + test_rng_below(&r, 800), z = 1024 * (k >> 2) + 100 + test_rng_below(&r, 800);
        place[k][0] = (float)x;
        place[k][1] = (float)z;
        for (i = 0; i < 1600; i++, n++) {
            v[n].x = x + i % 40;
            v[n].y = 7;
            v[n].z = z + i / 40;
            v[n].rgb[0] = (uint8_t)(16 * k);
        }
    }
    CHECK(voxrt_tree_from_voxels(NULL, v, n, 12, &t) == VOXRT_OK);
    free(v);
    return t;
}

/* The hand of the clock: what was hit since it came by stays once more; what it came by while it was in use counts as
   hit after that; what was hit in this turn stays anyhow, also in the turn after 2^32 - 1. */
TEST(the_hand_of_the_clock) {
    float place[16][2];
    voxrt_tree *t = patches(place);
    file f;
    uint32_t way;
    REQUIRE(t != NULL);
    f = file_of(t);
    for (way = 0; way < 4; way++) {
        voxrt_paged *p = paged_of(&f, 0, 0);
        uint32_t k;
        int full;
        REQUIRE(p != NULL && p->page_count > 17);
        if (way == 3) p->turn = 0xffffffffu - 1;
        for (k = 1; k <= 3; k++) CHECK(p->page[k].parent == 0 && voxrti_paged_load(p, k, &full) == VOXRT_OK && !full);
        p->frames = p->page[3].place + p->page[3].frames; /* no more room than that */
        p->hand = p->page[1].place;
        p->turn++;
        check_arena(p);
        if (way == 0) { /* the first one has been hit since the hand came by, the second one has not */
            p->page[2].passed = p->page[2].used;
            CHECK(voxrti_paged_room(p, 1) != 0);
            CHECK(p->page[1].place != 0 && p->page[2].place == 0 && p->page[3].place != 0);
            p->hand = p->page[1].place; /* it comes by again */
            CHECK(voxrti_paged_room(p, 1) != 0);
            CHECK(p->page[1].place == 0 && p->page[3].place != 0);
        } else if (way == 1) { /* all of them are in use while it comes by: no room. Later they stay for a round. */
            for (k = 1; k <= 3; k++) voxrti_paged_touch(p, k);
            CHECK(voxrti_paged_room(p, 1) == 0);
            p->turn++;
            p->page[3].passed = p->page[3].used;
            p->hand = p->page[1].place;
            CHECK(voxrti_paged_room(p, 1) != 0);
            CHECK(p->page[1].place != 0 && p->page[2].place != 0 && p->page[3].place == 0);
        } else if (way == 2) { /* hit once, some turns ago: it comes round, and the first one goes */
            CHECK(voxrti_paged_room(p, 1) != 0);
            CHECK(p->page[1].place == 0 && p->page[2].place != 0 && p->page[3].place != 0);
        } else { /* turns are counted from 0 on again */
            CHECK(p->turn == 0xffffffffu && voxrt_paged_update(p, 0, NULL) == VOXRT_OK && p->turn == 0);
            for (k = 1; k <= 3; k++) voxrti_paged_touch(p, k);
            for (k = 1; k <= 3; k++) CHECK(p->page[k].passed == 0 && p->page[k].used == 0);
            CHECK(voxrti_paged_room(p, 1) == 0);
            for (k = 1; k <= 3; k++) CHECK(p->page[k].place != 0);
        }
        check_arena(p);
        voxrt_paged_destroy(p);
    }
    free(f.data);
    voxrt_tree_destroy(t);
}

/* Pages that rays asked for, and much else was loaded before they are: those above them may have given way, and what
   makes room for them is never what is above them. */
TEST(what_was_asked_for_long_ago) {
    float place[16][2];
    const voxrt_trace_desc td = {0};
    voxrt_tree *t = patches(place);
    test_rng r = test_rng_make(5);
    voxrt_geometry g, whole;
    uint32_t round, gone = 0, loaded = 0, old = 0;
    file f;
    REQUIRE(t != NULL);
    f = file_of(t);
    voxrt_tree_geometry(t, &whole);
    for (round = 0; round < 30; round++) {
        voxrt_paged *p = paged_of(&f, 0, 0);
        uint32_t k, i, later;
        REQUIRE(p != NULL);
        p->frames = p->first_frame + 8 + round; /* less than it may have when it is opened */
        voxrt_paged_geometry(p, &g);
        for (k = 0; k < 40; k++) {
            for (later = 0; later < 2; later++) { /* some ask, others do not wait until that is there */
                voxrt_ray ray[8];
                voxrt_surface surface[2][8];
                uint32_t patch = 0;
                voxrt_paged_wait(p, later);
                for (i = 0; i < 8; i++) {
                    memset(&ray[i], 0, sizeof ray[i]);
                    if ((i & 3u) == 0) patch = test_rng_below(&r, 16);
                    ray[i].org[0] = place[patch][0] + 39.0f * (float)test_rng_double(&r);
                    ray[i].org[1] = 100.0f;
                    ray[i].org[2] = place[patch][1] + 39.0f * (float)test_rng_double(&r);
                    ray[i].dir[1] = -1.0f;
                    ray[i].t_max = INFINITY;
                }
                g.trace_fn(g.user, &td, ray, surface[0], 8);
                whole.trace_fn(whole.user, &td, ray, surface[1], 8);
                if (!later) continue;
                CHECK(voxrti_tally(p->coarse) == 0 && memcmp(surface[0], surface[1], sizeof surface[0]) == 0);
            }
            voxrt_paged_wait(p, 0);
            for (i = 1; i < p->page_count; i++) {
                const voxrti_page *one = &p->page[i];
                if (one->place != 0 || !one->wanted) continue;
                gone += p->page[one->parent].place == 0;
                old += p->page[one->parent].place != 0 && p->page[one->parent].used != p->turn;
            }
            {
                voxrt_paged_update_stats s;
                CHECK(voxrt_paged_update(p, 0, &s) == VOXRT_OK);
                loaded += s.loaded;
            }
            check_arena(p);
        }
        voxrt_paged_destroy(p);
    }
    CHECK_MSG(gone > 20 && old > 20 && loaded > 20, "%u without, %u with one from before, %u loaded", gone, old, loaded);
    free(f.data);
    voxrt_tree_destroy(t);
}

/* Too little room for a picture, not waiting: what was hit stays, the rest is coarse, nothing changes any more. */
TEST(too_little_room_is_coarse) {
    fixture x = fixture_make(60, 500, 0);
    paging_picture *p = x.p;
    voxrt_paged_desc d;
    voxrt_paged *paged = NULL;
    voxrt_render_desc v;
    voxrt_paged_update_stats s;
    voxrt_paged_info info;
    uint8_t *hit;
    uint32_t n, i;
    memset(&d, 0, sizeof d);
    d.data = x.f.data;
    d.size = x.f.size;
    d.memory = x.f.size / 3;
    REQUIRE(voxrt_paged_open(&d, &paged) == VOXRT_OK);
    hit = (uint8_t *)malloc(paged->page_count);
    REQUIRE(hit != NULL);
    view_of(x.t, 1, &v); /* what it loads has been hit when other views come */
    for (n = 0; n < 3; n++) {
        paging_draw(v, NULL, paged, p);
        CHECK(voxrt_paged_update(paged, 0, NULL) == VOXRT_OK);
    }
    view_of(x.t, 0, &v);
    v.view = VOXRT_VIEW_UNLIT;
    paging_draw(v, x.t, NULL, x.exact);
    for (n = 0; n < 60; n++) {
        paging_draw(v, NULL, paged, p);
        for (i = 0; i < W * H; i++) CHECK(p->depth[i] <= x.exact->depth[i]);
        for (i = 0; i < paged->page_count; i++) {
            hit[i] = paged->page[i].place != 0 && paged->page[i].used == paged->turn;
            CHECK(!hit[i] || paged->page[paged->page[i].parent].used == paged->turn); /* with those above it */
        }
        CHECK(voxrt_paged_update(paged, 0, &s) == VOXRT_OK);
        for (i = 0; i < paged->page_count; i++) CHECK_MSG(!hit[i] || paged->page[i].place != 0, "page %u was hit and is gone", i);
        CHECK(s.no_room == s.wanted - s.loaded);
        if (s.loaded == 0) break;
    }
    CHECK_MSG(n < 60 && s.wanted != 0, "%u pictures, %u wanted", n, s.wanted);
    for (n = 0, i = 0; i < W * H; i++) n += p->depth[i] < x.exact->depth[i];
    CHECK_MSG(n > 0 && n < W * H / 2, "%u pixels are coarse", n);
    free(hit);
    voxrt_paged_wait(paged, 1); /* now the next picture is exact all the same */
    paging_draw(v, NULL, paged, p);
    CHECK(picture_equal(p, x.exact));
    voxrt_paged_wait(paged, 0);
    CHECK(voxrt_paged_update(paged, 0, &s) == VOXRT_OK && s.wanted == 0);
    voxrt_paged_get_info(paged, &info);
    CHECK(info.coarse_rays == 0 && info.memory <= d.memory);
    voxrt_paged_destroy(paged);
    fixture_free(&x);
}

/* Single rays, any directions: surfaces and any hit as of the tree; in an instance in a group, too. */
TEST(rays_are_those_of_the_tree) {
    fixture x = fixture_make(40, 300, 1);
    voxrt_paged *p = paged_of(&x.f, 700000, 1);
    test_rng r = test_rng_make(7);
    voxrt_instance place[2];
    voxrt_group *group[2] = {NULL, NULL};
    voxrt_geometry g[2];
    uint32_t k, i, a, hits = 0, rounds = test_quick() ? 100 : 1000;
    memset(place, 0, sizeof place);
    REQUIRE(p != NULL);
    voxrt_tree_geometry(x.t, &place[0].geometry);
    voxrt_paged_geometry(p, &place[1].geometry);
    for (k = 0; k < 2; k++) {
        CHECK(memcmp(place[0].geometry.box_min, place[k].geometry.box_min, sizeof place[0].geometry.box_min) == 0);
        for (i = 0; i < 3; i++) place[k].to_world[5 * i] = 1.5;
        place[k].to_world[1] = 0.25;
        place[k].to_world[3] = 0.5;
        CHECK(voxrt_instance_geometry(&place[k], &g[k]) == VOXRT_OK);
        CHECK(voxrt_group_create(NULL, &g[k], 1, &group[k]) == VOXRT_OK);
        voxrt_group_geometry(group[k], &g[k]);
    }
    for (k = 0; k < rounds; k++) {
        const voxrt_geometry *of[2];
        voxrt_ray ray[64];
        voxrt_surface s[2][64];
        uint8_t dark[2][64];
        voxrt_stats stats[2];
        voxrt_trace_desc d;
        const size_t n = 1 + test_rng_below(&r, 64);
        memset(&d, 0, sizeof d);
        memset(stats, 0, sizeof stats);
        for (i = 0; i < n; i++) {
            for (a = 0; a < 3; a++) {
                ray[i].org[a] = (float)(-0.5 + 2.5 * test_rng_double(&r));
                ray[i].dir[a] = (float)(0.1 + 0.8 * test_rng_double(&r)) - ray[i].org[a];
            }
            if (test_rng_below(&r, 40) == 0) ray[i].dir[test_rng_below(&r, 3)] = 0.0f;
            if (test_rng_below(&r, 200) == 0) ray[i].dir[1] = NAN;
            ray[i].t_min = 0.0f;
            ray[i].t_max = test_rng_below(&r, 3) == 0 ? (float)test_rng_double(&r) : INFINITY;
        }
        d.isa = (voxrt_isa)(k % 5);
        if (k & 1) d.cone_spread = 0.02f * (float)test_rng_double(&r);
        if (k & 2) d.cone_width = 0.02f * (float)test_rng_double(&r);
        d.blend = k >> 2 & 1;
        d.cubes = k >> 3 & 1;
        d.max_level_plus_1 = (k & 48) == 48 ? 1 + test_rng_below(&r, 10) : 0;
        for (i = 0; i < 2; i++) {
            of[i] = k & 64 ? &g[i] : &place[i].geometry;
            d.stats = &stats[i];
            of[i]->trace_fn(of[i]->user, &d, ray, s[i], n);
            d.stats = NULL;
            of[i]->occluded_fn(of[i]->user, &d, ray, dark[i], n);
        }
        CHECK_MSG(memcmp(s[0], s[1], n * sizeof s[0][0]) == 0, "round %u", k);
        CHECK(memcmp(dark[0], dark[1], n) == 0);
        CHECK(stats[0].rays == stats[1].rays && stats[0].hits == stats[1].hits && stats[0].bad_rays == stats[1].bad_rays);
        hits += (uint32_t)stats[0].hits;
    }
    CHECK_MSG(hits > 10 * rounds, "%u hits", hits);
    for (k = 0; k < 2; k++) voxrt_group_destroy(group[k]);
    voxrt_paged_destroy(p);
    fixture_free(&x);
}

/* A ray that waits has what it needs whenever that fits, whatever has been loaded before. */
TEST(what_fits_is_loaded) {
    fixture x = fixture_make(60, 500, 0);
    const voxrt_trace_desc td = {0};
    test_rng r = test_rng_make(11);
    voxrt_paged *big = paged_of(&x.f, 0, 1);
    voxrt_geometry g, small;
    uint32_t round, i, tight = 0, too_much = 0;
    REQUIRE(big != NULL);
    voxrt_paged_geometry(big, &g);
    for (round = 0; round < 30; round++) {
        voxrt_paged *p = paged_of(&x.f, 0, 1);
        uint64_t room;
        REQUIRE(p != NULL);
        p->frames = p->first_frame + 70 + 5 * round; /* less than it may have when it is opened */
        room = ((uint64_t)p->frames - p->first_frame) * VOXRTI_FRAME;
        voxrt_paged_geometry(p, &small);
        for (i = 0; i < (test_quick() ? 150u : 600u); i++) {
            voxrt_paged_info before, after, needs;
            voxrt_surface s[2];
            voxrt_ray ray;
            uint32_t a;
            for (a = 0; a < 3; a++) { /* flat, over the hills */
                const double size = g.box_max[a] - g.box_min[a];
                ray.org[a] = (float)(g.box_min[a] + size * (a == 1 ? 0.5 + 0.3 * test_rng_double(&r) : -0.1));
                ray.dir[a] = (float)(g.box_min[a] + size * (a == 1 ? 0.3 + 0.4 * test_rng_double(&r) : 0.8 + 0.2 * test_rng_double(&r))) -
                             ray.org[a];
            }
            ray.t_min = 0.0f;
            ray.t_max = INFINITY;
            voxrti_paged_clear(big);
            g.trace_fn(g.user, &td, &ray, &s[0], 1);
            voxrt_paged_get_info(big, &needs);
            voxrt_paged_get_info(p, &before);
            small.trace_fn(small.user, &td, &ray, &s[1], 1);
            voxrt_paged_get_info(p, &after);
            if (needs.loaded_bytes > room) {
                too_much++;
                CHECK(after.coarse_rays == before.coarse_rays + 1);
            } else {
                tight += needs.loaded_bytes > room / 2;
                CHECK_MSG(after.coarse_rays == before.coarse_rays && memcmp(&s[0], &s[1], sizeof s[0]) == 0,
                          "ray %u: %g bytes in %g", i, (double)needs.loaded_bytes, (double)room);
            }
        }
        voxrt_paged_destroy(p);
    }
    CHECK_MSG(tight > 100 && too_much > 10, "%u rays need most of the room, %u more", tight, too_much);
    voxrt_paged_destroy(big);
    fixture_free(&x);
}

/* ---- what goes wrong ---- */

/* Open it, look at it from all sides. Returns what opening says, or the first bad page; the picture may be NULL. */
static voxrt_result paging_use(const uint8_t *data, size_t size, uint32_t trust, paging_picture *p) {
    voxrt_paged_desc d;
    voxrt_paged *paged = NULL;
    voxrt_paged_info info;
    voxrt_render_desc v;
    voxrt_geometry g;
    voxrt_result r;
    uint32_t k;
    memset(&d, 0, sizeof d);
    d.data = data;
    d.size = size;
    d.wait = 1;
    d.trust_input = trust;
    d.memory = 1u << 20;
    r = voxrt_paged_open(&d, &paged);
    CHECK((r == VOXRT_OK) == (paged != NULL));
    if (r != VOXRT_OK) return r;
    voxrt_paged_geometry(paged, &g);
    memset(&v, 0, sizeof v);
    v.geometry = &g;
    v.geometry_count = 1;
    v.env.thread_count = 1;
    for (k = 0; k < 2; k++) { /* from above and from below */
        int a;
        for (a = 0; a < 3; a++) {
            v.camera.at[a] = (float)(0.5 * (g.box_min[a] + g.box_max[a]));
            v.camera.eye[a] = (float)(g.box_min[a] + (a == 1 ? (k ? -3.0 : 4.0) : 0.7) * (g.box_max[a] - g.box_min[a]));
        }
        v.blend = k;
        v.tolerance = (float)k;
        r = voxrt_render(&v, NULL, &p->m, NULL);
        CHECK(r == VOXRT_OK || r == VOXRT_ERR_INVALID_ARG);
    }
    voxrt_paged_get_info(paged, &info);
    CHECK((info.bad_pages == 0) == (info.error.code == VOXRT_OK));
    CHECK(info.bad_pages == 0 || (info.error.where < size && info.coarse_rays > 0));
    voxrt_paged_destroy(paged);
    return info.error.code;
}

TEST(damaged_files_are_refused) {
    fixture x = fixture_make(8, 40, 1);
    const file f = x.f;
    paging_picture *p = x.p;
    test_rng r = test_rng_make(3);
    uint8_t *copy;
    size_t i;
    uint32_t accepted = 0, k;
    CHECK(paging_use(f.data, f.size, 0, p) == VOXRT_OK);
    for (i = 0; i < f.size; i += i < 400 || i + 200 > f.size ? 1 : 97) {
        copy = (uint8_t *)malloc(i != 0 ? i : 1);
        if (copy == NULL) abort();
        memcpy(copy, f.data, i);
        if (i != 0) CHECK(paging_use(copy, i, i & 1, p) == VOXRT_ERR_TRUNCATED);
        free(copy);
    }
    copy = (uint8_t *)malloc(f.size + 1);
    if (copy == NULL) abort();
    memcpy(copy, f.data, f.size);
    copy[f.size] = 0;
    CHECK(paging_use(copy, f.size + 1, 0, p) == VOXRT_ERR_FORMAT);
    for (i = 0; i < f.size; i += i < 400 || i + 200 > f.size ? 1 : test_quick() ? 211 : 61) { /* each change is found */
        const uint8_t was = copy[i];
        copy[i] = (uint8_t)(was ^ (1u << test_rng_below(&r, 8)));
        CHECK_MSG(paging_use(copy, f.size, 0, p) != VOXRT_OK, "byte %u", (unsigned)i);
        copy[i] = was;
    }
    for (k = 0; k < (test_quick() ? 200u : 1000u); k++) { /* and without checksums all of them are harmless */
        const uint32_t n = 1 + test_rng_below(&r, 3);
        uint32_t m;
        memcpy(copy, f.data, f.size);
        for (m = 0; m < n; m++) {
            i = test_rng_below(&r, 2) ? test_rng_below(&r, 400) : test_rng_below(&r, (uint32_t)f.size);
            copy[i] = (uint8_t)(test_rng_below(&r, 3) == 0 ? 255u : copy[i] ^ (1u << test_rng_below(&r, 8)));
        }
        accepted += paging_use(copy, f.size, 1, p) == VOXRT_OK;
    }
    CHECK(accepted > 20);
    free(copy);
    fixture_free(&x);
}

/* One wrong number in a page whose size and all else are right. A file without attributes has masks only. */
static void store8(uint8_t *p, uint64_t v) {
    int k;
    for (k = 0; k < 8; k++) p[k] = (uint8_t)(v >> (8 * k));
}

/* Masks of the page in the buffer: none is 0, and the first ones are as the depth of the tree wants them. */
static void masks_are_checked(voxrt_paged *p, uint32_t id, const uint8_t *data) {
    const uint32_t head = 8 + 8 * ((uint32_t)p->page[id].n1 + p->page[id].n2);
    voxrti_chunk c;
    uint32_t where, i;
    int full;
    for (i = 8; i < head; i += 8) {
        const uint64_t was = voxrti_load_u64(p->buffer + i);
        store8(p->buffer + i, 0);
        CHECK(!voxrti_paged_check(p, id, &c, &where) && (where == i || where == 8));
        store8(p->buffer + i, was);
    }
    if (id == 0 && p->odd) { /* the level above the root has it alone, as its first */
        store8(p->buffer + 8, 2);
        CHECK(!voxrti_paged_check(p, id, &c, &where));
        store8(p->buffer + 8, 1);
    }
    if (id == 0 && (p->tree.depth & 1u) != 0) { /* the root of an odd depth is an octant */
        const uint32_t at = 8 + 8 * p->odd, low = (uint32_t)voxrti_load_u64(p->buffer + at);
        store8(p->buffer + at, (uint64_t)low << 8);
        CHECK(!voxrti_paged_check(p, id, &c, &where));
        store8(p->buffer + at, low);
    }
    if (id != 0) { /* its anchor has another number of children */
        voxrti_page *up = &p->page[p->page[id].parent];
        const uint8_t *mask = data + up->offset + 8 + 8 * ((size_t)up->n1 + (id - up->first_child));
        const uint64_t was = voxrti_load_u64(mask);
        const voxrti_chunk *above;
        voxrt_result r;
        if (up->place == 0) CHECK(voxrti_paged_load(p, p->page[id].parent, &full) == VOXRT_OK && !full);
        above = voxrti_paged_chunk(p, p->page[id].parent);
        REQUIRE(!above->leaf);
        p->tree.node[above->first2 + (id - up->first_child)].mask = was & (was - 1);
        r = voxrti_paged_load(p, id, &full);
        CHECK(r == VOXRT_ERR_FORMAT && p->page[id].bad && p->page[id].place == 0);
        p->tree.node[above->first2 + (id - up->first_child)].mask = was;
        p->page[id].bad = 0;
    }
}

/* The palette of the page in the buffer, a leaf's: 1 if it has an index that could be wrong. */
static uint32_t palette_is_checked(voxrt_paged *p, const voxrti_chunk *leaf, uint32_t id) {
    const uint32_t colors = leaf->colors, finish = leaf->palette + 4 * (colors - 1) + 3, index = leaf->index;
    voxrti_chunk c;
    uint32_t where, wrong = 0;
    if (leaf->bits != 0 && leaf->bits <= 8 && (colors & (colors - 1)) != 0) { /* an index that is not in the palette */
        const uint32_t most = (1u << leaf->bits) - 1, last = (p->buffer[index] & ~most) | colors;
        const uint8_t was = p->buffer[index];
        p->buffer[index] = (uint8_t)last;
        CHECK(!voxrti_paged_check(p, id, &c, &where) && where == index);
        p->buffer[index] = was;
        wrong = 1;
    }
    p->buffer[finish] = 2; /* a finish that is not there */
    CHECK(!voxrti_paged_check(p, id, &c, &where) && where == finish);
    return wrong;
}

/* Finishes in the header and behind the table, and flags that go together. */
static void finishes_are_checked(const file *f, const voxrt_paged_desc *d, const voxrt_error *error) {
    const size_t at = f->size - 72;
    const uint8_t root = f->data[192 + 63];
    uint8_t was[4];
    voxrt_paged *p = NULL;
    f->data[192 + 63] = 2;
    CHECK(voxrt_paged_open(d, &p) == VOXRT_ERR_FORMAT && p == NULL);
    f->data[192 + 63] = 1;
    memcpy(was, f->data + at, 4);
    memset(f->data + at, 0xff, 4); /* not a number */
    CHECK(voxrt_paged_open(d, &p) == VOXRT_ERR_FORMAT && p == NULL && error->where == at);
    memcpy(f->data + at, was, 4);
    f->data[32] ^= 64; /* finishes without their flag, */
    CHECK(voxrt_paged_open(d, &p) == VOXRT_ERR_FORMAT);
    f->data[32] ^= 64 ^ 4; /* without colours, */
    CHECK(voxrt_paged_open(d, &p) == VOXRT_ERR_FORMAT);
    f->data[32] ^= 4 ^ 2; /* spread without normals */
    CHECK(voxrt_paged_open(d, &p) == VOXRT_ERR_FORMAT);
    f->data[32] ^= 2;
    REQUIRE(voxrt_paged_open(d, &p) == VOXRT_OK);
    voxrt_paged_destroy(p);
    f->data[192 + 63] = root;
}

/* Numbers that could be right: only the checksum of the table says that they are not. */
static void table_is_summed(const file *f, voxrt_paged_desc *d, const voxrt_error *error) {
    const size_t at = f->size - 72, table = (size_t)voxrti_load_u64(f->data + 64 + 2 * 40 + 8);
    voxrt_paged *p = NULL;
    uint32_t id;
    for (id = 0; id < 2; id++) {
        uint8_t *byte = f->data + (id == 0 ? at : table) + 16;
        *byte ^= 1; /* shininess of the finish, checksum of a page */
        d->trust_input = 0;
        CHECK_MSG(voxrt_paged_open(d, &p) == VOXRT_ERR_CHECKSUM && p == NULL && error->where == table, "number %u", id);
        d->trust_input = 1;
        CHECK(voxrt_paged_open(d, &p) == VOXRT_OK);
        voxrt_paged_destroy(p);
        *byte ^= 1;
    }
    d->trust_input = 0;
    CHECK(voxrt_paged_open(d, &p) == VOXRT_OK);
    voxrt_paged_destroy(p);
}

TEST(pages_are_checked) {
    static const uint32_t resolution[4] = {40, 100, 7, 200}; /* levels: 3, 4, 2 wide, 4 */
    uint32_t k;
    for (k = 0; k < 8; k++) {
        hills h = hills_make(20, k >= 4);
        voxrt_finish finish;
        uint8_t *number = (uint8_t *)calloc(h.mesh.triangle_count, 1);
        voxrt_build_desc b;
        voxrt_tree *t = NULL;
        voxrt_paged_desc d;
        voxrt_paged *p = NULL;
        voxrt_error error;
        file f;
        uint32_t id, wrong = 0;
        REQUIRE(number != NULL);
        number[0] = 1;
        memset(&finish, 0, sizeof finish);
        finish.diffuse = 0.5f;
        memset(&b, 0, sizeof b);
        b.resolution = resolution[k & 3u];
        b.palette_size = 1u << 24;
        b.disable_normals = k < 4;
        b.spread = b.planes = k >= 4;
        if (k >= 4) {
            h.mesh.triangle_finish = number;
            b.finishes = &finish;
            b.finish_count = 1;
        }
        CHECK(voxrt_tree_build(&b, &h.mesh, NULL, &t) == VOXRT_OK);
        f = file_of(t);
        memset(&d, 0, sizeof d);
        memset(&error, 0, sizeof error);
        d.data = f.data;
        d.size = f.size;
        d.trust_input = 1;
        d.env.error = &error;
        REQUIRE(voxrt_paged_open(&d, &p) == VOXRT_OK);
        for (id = 0; id < p->page_count; id++) {
            voxrti_chunk c;
            uint32_t where;
            memcpy(p->buffer, f.data + p->page[id].offset, p->page[id].size);
            memset(p->buffer + p->page[id].size, 0, 8);
            CHECK(voxrti_paged_check(p, id, &c, &where));
            if (k < 4) masks_are_checked(p, id, f.data);
            else wrong += palette_is_checked(p, &c, id);
        }
        CHECK(k < 4 || wrong != 0 || p->page_count < 3);
        voxrt_paged_destroy(p);
        if (k >= 4) {
            finishes_are_checked(&f, &d, &error);
            table_is_summed(&f, &d, &error);
        }
        voxrt_tree_destroy(t);
        free(f.data);
        free(number);
        hills_free(&h);
    }
}

/* A file that can be read now and then, and changes meanwhile. */
typedef struct source {
    const file *f;
    uint64_t broken_from, broken_to; /* reads that touch these bytes fail, */
    int changed;                     /* or get others */
    uint32_t reads;
} source;

static int source_read(void *user, uint64_t offset, void *to, size_t bytes) {
    source *s = (source *)user;
    const int touches = offset < s->broken_to && offset + bytes > s->broken_from;
    s->reads++;
    if (offset + bytes > s->f->size) return 1;
    if (touches && !s->changed) return 1;
    memcpy(to, s->f->data + offset, bytes);
    if (touches) ((uint8_t *)to)[bytes / 2] ^= 4;
    return 0;
}

TEST(files_change_and_fail) {
    fixture x = fixture_make(30, 300, 0);
    const file f = x.f;
    paging_picture *p = x.p, *exact = x.exact;
    uint32_t k, i;
    for (k = 0; k < 4; k++) {
        source s;
        voxrt_paged_desc d;
        voxrt_paged *paged = NULL;
        voxrt_paged_update_stats u;
        voxrt_paged_info info;
        voxrt_render_desc v;
        voxrt_result r, bad = VOXRT_OK;
        memset(&d, 0, sizeof d);
        memset(&s, 0, sizeof s);
        s.f = &f;
        s.changed = (int)(k & 1u);
        d.read_fn = source_read;
        d.read_user = &s;
        d.size = f.size;
        d.wait = k >> 1;
        REQUIRE(voxrt_paged_open(&d, &paged) == VOXRT_OK);
        s.broken_from = f.size / 4; /* the file is changed while it is open */
        s.broken_to = f.size / 2;
        view_of(x.t, 0, &v);
        v.view = VOXRT_VIEW_UNLIT;
        paging_draw(v, x.t, NULL, exact);
        for (i = 0; i < 20; i++) {
            paging_draw(v, NULL, paged, p);
            r = voxrt_paged_update(paged, 0, &u);
            if (bad == VOXRT_OK) bad = r;
            if (u.wanted == 0) break;
        }
        CHECK(i < 20);
        voxrt_paged_get_info(paged, &info);
        CHECK(info.bad_pages > 0 && info.error.code == (s.changed ? VOXRT_ERR_CHECKSUM : VOXRT_ERR_IO));
        CHECK(d.wait ? bad == VOXRT_OK && info.coarse_rays > 0 : bad == info.error.code);
        CHECK(info.error.where + 100000 > s.broken_from && info.error.where < s.broken_to);
        CHECK(strlen(info.error.text) > 10);
        for (i = 0; i < W * H; i++) CHECK(p->depth[i] <= exact->depth[i]);
        s.reads = 0; /* what is bad is not asked for again */
        paging_draw(v, NULL, paged, p);
        CHECK(voxrt_paged_update(paged, 0, &u) == VOXRT_OK && u.wanted == 0 && s.reads == 0);
        voxrt_paged_destroy(paged);
    }
    fixture_free(&x);
}

TEST(memory_runs_out) {
    fixture x;
    voxrt_build_desc b;
    voxrt_finish finish[2];
    uint8_t number[2 * 12 * 12];
    size_t i;
    int64_t k;
    int which;
    memset(&x, 0, sizeof x);
    memset(&b, 0, sizeof b);
    memset(finish, 0, sizeof finish);
    finish[0].mirror[0] = finish[1].transparency[1] = 1.0f;
    for (i = 0; i < sizeof number; i++) number[i] = (uint8_t)(i % 3);
    x.h = hills_make(12, 1);
    x.h.mesh.triangle_finish = number;
    b.resolution = 100; /* and all that voxels can have */
    b.planes = 1;
    b.spread = 1;
    b.finishes = finish;
    b.finish_count = 2;
    REQUIRE(voxrt_tree_build(&b, &x.h.mesh, NULL, &x.t) == VOXRT_OK);
    x.f = file_of(x.t);
    for (which = 0; which < 3; which++) {
        for (k = 0; k < 10000; k++) {
            test_alloc ta;
            voxrt_env env;
            voxrt_result r;
            memset(&env, 0, sizeof env);
            env.allocator = counted(&ta);
            env.thread_count = 1;
            ta.fail_at = k;
            if (which == 0) {
                voxrt_paged_desc d;
                voxrt_paged *p = NULL;
                memset(&d, 0, sizeof d);
                d.env = env;
                d.data = x.f.data;
                d.size = x.f.size;
                r = voxrt_paged_open(&d, &p);
                CHECK((p != NULL) == (r == VOXRT_OK));
                voxrt_paged_destroy(p);
            } else if (which == 1) {
                voxrt_save_desc d;
                size_t size;
                memset(&d, 0, sizeof d);
                d.env = env;
                d.encoding = VOXRT_ENCODING_PAGED;
                r = voxrt_tree_save_memory(x.t, &d, NULL, 0, &size);
                CHECK(size == (r == VOXRT_OK ? x.f.size : 0));
            } else {
                file to = {NULL, 0, 0};
                voxrt_sink sink;
                sink.write_fn = file_write;
                sink.user = &to;
                b.env = env;
                r = voxrt_paged_build(&b, &x.h.mesh, &sink, NULL);
                free(to.data);
            }
            test_alloc_check(&ta);
            if (ta.failed == 0) {
                CHECK(r == VOXRT_OK && k > 3);
                break;
            }
            CHECK(r == VOXRT_ERR_NO_MEMORY);
        }
        CHECK(k < 10000);
    }
    fixture_free(&x);
}

static int full_disk(void *user, uint64_t offset, const void *from, size_t bytes) {
    int *left = (int *)user;
    (void)offset;
    (void)from;
    (void)bytes;
    return (*left)-- <= 0;
}

/* What a file in memory says of itself, and its table: pages beyond its end, and pages in the header and in the table. */
static void paged_in_memory(const fixture *of) {
    const file f = of->f;
    voxrt_tree *back = NULL;
    uint8_t small[100];
    voxrt_save_desc save;
    voxrt_load_desc load;
    voxrt_paged_desc d;
    voxrt_paged *p = NULL;
    voxrt_error error;
    size_t size;
    int k;
    memset(&save, 0, sizeof save);
    memset(&load, 0, sizeof load);
    memset(&error, 0, sizeof error);
    save.encoding = VOXRT_ENCODING_PAGED;
    CHECK(voxrt_file_kind(f.data, 64) == 6 && voxrt_file_kind(f.data, 12) == 5);
    load.env.error = &error;
    CHECK(voxrt_tree_load_memory(&load, f.data, f.size, &back) == VOXRT_ERR_VERSION && back == NULL);
    CHECK(strstr(error.text, "voxrt_paged_open") != NULL); /* says what does read it */
    CHECK(voxrt_tree_save_memory(of->t, &save, small, sizeof small, &size) == VOXRT_ERR_RANGE && size == f.size);
    memset(&d, 0, sizeof d);
    d.data = f.data;
    d.size = f.size;
    d.trust_input = 1;
    for (k = 0; k < 3; k++) {
        const size_t at = (size_t)voxrti_load_u64(f.data + 64 + 2 * 40 + 8);
        uint8_t *e = f.data + at, was[24];
        uint64_t n2;
        CHECK(voxrt_paged_open(&d, &p) == VOXRT_OK);
        if (k == 0) e += 24 * (p->leaf_first - 1);
        voxrt_paged_destroy(p);
        memcpy(was, e, sizeof was);
        n2 = (uint64_t)voxrti_load_u32(e + 12) + 256;
        if (k == 0) voxrti_store_u32(e + 12, (uint32_t)n2);
        else voxrti_store_u64(e, k == 1 ? 0 : at);
        CHECK(voxrt_paged_open(&d, &p) == VOXRT_ERR_FORMAT && p == NULL);
        memcpy(e, was, sizeof was);
    }
}

/* Files that end too late, too early or much earlier than they say. */
static void paged_sizes(const file *f, const char *path) {
    voxrt_paged *p = NULL;
    FILE *out;
    int k, i;
    out = fopen(path, "ab");
    REQUIRE(out != NULL);
    CHECK(fputc(0, out) == 0 && fclose(out) == 0);
    CHECK(voxrt_paged_open_file(NULL, path, &p) == VOXRT_ERR_FORMAT && p == NULL);
    out = fopen(path, "wb");
    REQUIRE(out != NULL);
    CHECK(fwrite(f->data, 1, f->size - 1, out) == f->size - 1 && fclose(out) == 0);
    CHECK(voxrt_paged_open_file(NULL, path, &p) == VOXRT_ERR_TRUNCATED && p == NULL);
    for (k = 0; k < 3; k++) { /* sizes that no file has are not looked for */
        static const uint64_t claim[3] = {(uint64_t)0 - 1, (uint64_t)1 << 63, (uint64_t)5 << 40};
        uint8_t head[64];
        memcpy(head, f->data, sizeof head);
        for (i = 0; i < 8; i++) head[16 + i] = (uint8_t)(claim[k] >> (8 * i));
        out = fopen(path, "r+b");
        REQUIRE(out != NULL);
        CHECK(fwrite(head, 1, sizeof head, out) == sizeof head && fclose(out) == 0);
        CHECK(voxrt_paged_open_file(NULL, path, &p) == VOXRT_ERR_TRUNCATED && p == NULL);
    }
}

/* A file on disk shows what the tree does; what is no such file, or cannot be written. */
static void paged_files(fixture *of, const voxrt_build_desc *b) {
    const voxrt_mesh *mesh = &of->h.mesh;
    voxrt_tree *t = of->t;
    const char *path = test_temp_path(".vox");
    voxrt_save_desc save;
    voxrt_paged_desc d;
    voxrt_paged *p = NULL;
    voxrt_sink sink;
    voxrt_paged_info info;
    voxrt_tree_info tree;
    voxrt_render_desc v;
    int writes;
    memset(&save, 0, sizeof save);
    memset(&d, 0, sizeof d);
    save.encoding = VOXRT_ENCODING_PAGED;
    CHECK(voxrt_paged_build_file(b, mesh, path, NULL) == VOXRT_OK);
    d.wait = 1;
    REQUIRE(voxrt_paged_open_file(&d, path, &p) == VOXRT_OK);
    voxrt_paged_get_info(p, &info);
    voxrt_tree_get_info(t, &tree);
    CHECK(info.depth == tree.depth && info.resolution == tree.resolution && info.voxel_count == tree.voxel_count);
    CHECK(memcmp(info.world_origin, tree.world_origin, sizeof info.world_origin) == 0 && info.voxel_size == tree.voxel_size);
    CHECK(memcmp(info.cell_min, tree.cell_min, 12) == 0 && memcmp(info.cell_max, tree.cell_max, 12) == 0);
    CHECK(info.has_colors && info.has_normals && !info.has_planes && info.page_count > 10 && info.loaded_pages == 1);
    view_of(t, 2, &v);
    paging_draw(v, t, NULL, of->exact);
    paging_draw(v, NULL, p, of->p);
    CHECK(picture_equal(of->exact, of->p));
    voxrt_paged_destroy(p);
    CHECK(voxrt_tree_save_file(t, &save, path) == VOXRT_OK);
    CHECK(voxrt_paged_open_file(NULL, path, &p) == VOXRT_OK);
    voxrt_paged_destroy(p);
    paged_sizes(&of->f, path);
    (void)remove(path);
    CHECK(voxrt_paged_open_file(NULL, path, &p) == VOXRT_ERR_IO && p == NULL);
    CHECK(voxrt_paged_open_file(NULL, ".", &p) == VOXRT_ERR_IO && p == NULL); /* a folder */
    CHECK(voxrt_paged_build_file(b, mesh, "/nowhere/at/all.vox", NULL) == VOXRT_ERR_IO);
    CHECK(voxrt_tree_save_file(t, &save, "/nowhere/at/all.vox") == VOXRT_ERR_IO);
    for (writes = 0; writes < 12; writes++) {
        int left = writes;
        sink.write_fn = full_disk;
        sink.user = &left;
        CHECK(voxrt_paged_build(b, mesh, &sink, NULL) == VOXRT_ERR_IO);
    }
}

static void paged_arguments(fixture *of, voxrt_build_desc *b) {
    hills *h = &of->h;
    voxrt_paged_desc d;
    voxrt_paged *p = NULL;
    voxrt_sink sink;
    voxrt_paged_info info;
    voxrt_error error;
    int writes = 100;
    memset(&d, 0, sizeof d);
    memset(&error, 0, sizeof error);
    sink.write_fn = full_disk;
    sink.user = &writes;
    d.env.error = &error;
    CHECK(voxrt_paged_open(&d, &p) == VOXRT_ERR_INVALID_ARG && error.text[0] != 0);
    CHECK(voxrt_paged_open(NULL, &p) == VOXRT_ERR_INVALID_ARG && voxrt_paged_open(&d, NULL) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_paged_update(NULL, 0, NULL) == VOXRT_ERR_INVALID_ARG);
    d._end_zero = 1;
    CHECK(voxrt_paged_open(&d, &p) == VOXRT_ERR_UNINIT_DESC);
    CHECK(voxrt_paged_build(b, &h->mesh, NULL, NULL) == VOXRT_ERR_INVALID_ARG);
    { /* vertices that lie over each other; more triangles than have numbers */
        voxrt_mesh m = h->mesh;
        m.position_stride = 11;
        CHECK(voxrt_paged_build(b, &m, &sink, NULL) == VOXRT_ERR_INVALID_ARG);
        m.position_stride = 0;
        m.triangle_count = 0xffffffffu;
        CHECK(voxrt_paged_build(b, &m, &sink, NULL) == VOXRT_ERR_RANGE);
        m.indices = NULL;
        m.triangle_count = 0x55555555u;
        CHECK(voxrt_paged_build(b, &m, &sink, NULL) == VOXRT_ERR_RANGE);
        m.triangle_count = SIZE_MAX;
        CHECK(voxrt_paged_build(b, &m, &sink, NULL) == VOXRT_ERR_RANGE);
    }
    b->fill = 1;
    CHECK(voxrt_paged_build(b, &h->mesh, &sink, NULL) == VOXRT_ERR_INVALID_ARG);
    b->fill = 0;
    h->mesh.triangle_count = 0;
    CHECK(voxrt_paged_build(b, &h->mesh, &sink, NULL) == VOXRT_ERR_EMPTY);
    voxrt_paged_destroy(NULL);
    voxrt_paged_get_info(NULL, &info);
}

TEST(files_and_arguments) {
    fixture of = fixture_make(20, 150, 0);
    voxrt_build_desc b;
    memset(&b, 0, sizeof b);
    b.resolution = 150;
    b.palette_size = 1u << 24;
    paged_in_memory(&of);
    paged_files(&of, &b);
    paged_arguments(&of, &b);
    fixture_free(&of);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(pictures_are_those_of_the_tree);
    RUN(cubes_stand_among_planes);
    RUN(pieces_make_the_same_file);
    RUN(pieces_have_what_is_rounded_into_them);
    RUN(pieces_have_textures);
    RUN(pages_have_finishes_and_spread);
    RUN(building_can_be_watched_and_stopped);
    RUN(limits_hold_for_shared_trees);
    RUN(room_is_kept);
    RUN(coarse_pictures_get_finer);
    RUN(shadows_of_coarse_cells_ask_for_nothing);
    RUN(views_follow_each_other);
    RUN(the_hand_of_the_clock);
    RUN(what_was_asked_for_long_ago);
    RUN(too_little_room_is_coarse);
    RUN(rays_are_those_of_the_tree);
    RUN(what_fits_is_loaded);
    RUN(damaged_files_are_refused);
    RUN(pages_are_checked);
    RUN(files_change_and_fail);
    RUN(memory_runs_out);
    RUN(files_and_arguments);
    return test_end();
}
