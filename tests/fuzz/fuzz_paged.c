/* fuzz_paged.c - twelve bytes of options, then triangles as those of fuzz_build.c. A file that is made piece by piece has the
   bytes of that of the tree, whatever memory there is for the pieces; writing that fails, memory that is refused and a call that
   is cancelled are told, and nothing is left; rays see the same in the file as in the tree, and in a group of many places of it
   what they see in the nearest of them. */
#define _POSIX_C_SOURCE 200809L
#define VOXRT_IMPLEMENTATION
#include "../../voxrt.h"
#include <unistd.h>
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

enum { OPTIONS = 12, TRIANGLES = 32, PLACES = 64, RAYS = 24 };

static void must(int ok) {
    if (!ok) abort();
}

typedef struct file { uint8_t *data; uint64_t size, room, left; } file; /* left: calls that still work */

static int file_write(void *user, uint64_t offset, const void *from, size_t bytes) {
    file *f = (file *)user;
    const uint64_t end = offset + bytes;
    must(offset <= 4096 || offset == f->size); /* as promised */
    if (f->left-- == 0) return 1;
    if (end > f->room) {
        f->room = 2 * end;
        f->data = (uint8_t *)realloc(f->data, (size_t)f->room);
        must(f->data != NULL);
    }
    memcpy(f->data + offset, from, bytes);
    f->size = end > f->size ? end : f->size;
    return 0;
}

static uint64_t g_requests, g_refused; /* the request that is refused, from 1 on; 0: none */
static void *some_alloc(size_t size, void *user) {
    (void)user;
    return ++g_requests == g_refused ? NULL : malloc(size);
}
static void some_free(void *p, size_t size, void *user) {
    (void)user;
    (void)size;
    free(p);
}

static int g_asked, g_stop;
static int progress(void *user, uint64_t done, uint64_t total) {
    (void)user;
    must(done <= total);
    return ++g_asked == g_stop;
}

static void rays_into(const voxrt_geometry *g, const uint8_t *o, voxrt_ray *ray) {
    uint32_t k, a;
    memset(ray, 0, RAYS * sizeof *ray);
    for (k = 0; k < RAYS; k++) {
        ray[k].t_max = INFINITY;
        for (a = 0; a < 3; a++) {
            const double side = g->box_max[a] - g->box_min[a];
            ray[k].org[a] = (float)(g->box_min[a] + ((k >> a & 1) != 0 ? -0.3 : 1.2) * side);
            ray[k].dir[a] = (float)(g->box_min[a] + (double)((o[(k + a) % OPTIONS] * (k + 3u)) & 255u) / 256.0 * side) - ray[k].org[a];
        }
    }
}

/* Many places of a geometry, some of them in a group of their own, against one after the other. */
static void group_of(const voxrt_geometry *g, const uint8_t *o) {
    static voxrt_instance place[PLACES];
    static voxrt_geometry one[PLACES + 1];
    const uint32_t count = 1 + o[9] % PLACES, inner = count > 4 && (o[10] & 1) ? count / 2 : 0;
    voxrt_env env;
    voxrt_group *group = NULL, *within = NULL;
    voxrt_geometry all;
    voxrt_trace_desc td;
    voxrt_ray ray[RAYS];
    voxrt_surface s[RAYS], t[RAYS];
    uint8_t occluded[RAYS];
    float nearest[RAYS];
    uint32_t i, k;
    memset(&env, 0, sizeof env);
    memset(place, 0, sizeof place);
    env.memory_limit = (size_t)1 << 24;
    for (i = 0; i < count; i++) {
        place[i].geometry = *g;
        for (k = 0; k < 3; k++) {
            place[i].to_world[5 * k] = 1;
            if (o[10] & 2) place[i].to_world[4 * k + (k + i) % 3] += 0.25;
            place[i].to_world[4 * k + 3] = (g->box_max[k] - g->box_min[k]) * ((double)((i * (7u + 4u * k)) % 11u) - 5.0) * (o[10] & 4 ? 0.3 : 1.3);
        }
        if (voxrt_instance_geometry(&place[i], &one[i]) != VOXRT_OK) return;
    }
    if (inner != 0) {
        if (voxrt_group_create(&env, one, inner, &within) != VOXRT_OK) return;
        voxrt_group_geometry(within, &one[count]);
    }
    if (voxrt_group_create(&env, one + inner, count - inner + (inner != 0), &group) != VOXRT_OK) {
        voxrt_group_destroy(within);
        return;
    }
    voxrt_group_geometry(group, &all);
    memset(&td, 0, sizeof td);
    td.isa = (voxrt_isa)(o[11] % 5);
    rays_into(&all, o, ray);
    for (k = 0; k < RAYS; k++) nearest[k] = INFINITY;
    for (i = 0; i < count; i++) {
        one[i].trace_fn(one[i].user, &td, ray, t, RAYS);
        for (k = 0; k < RAYS; k++) nearest[k] = t[k].t < nearest[k] ? t[k].t : nearest[k];
    }
    all.trace_fn(all.user, &td, ray, s, RAYS);
    all.occluded_fn(all.user, &td, ray, occluded, RAYS);
    for (k = 0; k < RAYS; k++) must(s[k].t == nearest[k] && occluded[k] == (nearest[k] < INFINITY));
    voxrt_group_destroy(group);
    voxrt_group_destroy(within);
}

/* The file against the tree: what rays see, with what is there before pages are read, with all that they need, and with what
   is there then. */
static void look(const file *f, const voxrt_tree *t, const uint8_t *o) {
    voxrt_paged_desc d;
    voxrt_paged *p = NULL;
    voxrt_geometry g, whole;
    voxrt_trace_desc td;
    voxrt_ray ray[RAYS];
    voxrt_surface s[RAYS], same[RAYS];
    voxrt_hit hit[RAYS];
    uint8_t occluded[RAYS];
    uint32_t k, turn;
    memset(&d, 0, sizeof d);
    memset(&td, 0, sizeof td);
    d.data = f->data;
    d.size = f->size;
    d.memory = (size_t)1 << 23;
    must(voxrt_paged_open(&d, &p) == VOXRT_OK);
    voxrt_paged_geometry(p, &g);
    voxrt_tree_geometry(t, &whole);
    rays_into(&g, o, ray);
    td.isa = (voxrt_isa)(o[11] % 5);
    whole.trace_fn(whole.user, &td, ray, same, RAYS);
    must(voxrt_trace(t, &td, ray, hit, RAYS) == VOXRT_OK);
    for (k = 0; k < RAYS; k++)
        if (hit[k].node != VOXRT_NO_NODE) must(voxrt_hit_finish(t, &hit[k]) == same[k].finish);
    for (turn = 0; turn < 3; turn++) {
        voxrt_paged_wait(p, turn == 1);
        g.trace_fn(g.user, &td, ray, s, RAYS);
        g.occluded_fn(g.user, &td, ray, occluded, RAYS);
        for (k = 0; k < RAYS; k++) { /* what is missing is solid, never a hole */
            must(s[k].t <= same[k].t && occluded[k] == (s[k].t < INFINITY));
            if (turn != 1) continue;
            must((s[k].finish != NULL) == (same[k].finish != NULL)); /* each has finishes of its own */
            if (s[k].finish != NULL) must(memcmp(s[k].finish, same[k].finish, sizeof *s[k].finish) == 0);
            s[k].finish = same[k].finish = NULL;
        }
        if (turn == 1) must(memcmp(s, same, sizeof s) == 0);
    }
    must(voxrt_paged_update(p, 0, NULL) == VOXRT_OK);
    voxrt_paged_wait(p, 1);
    group_of(&g, o);
    voxrt_paged_destroy(p);
}

/* The same by way of a file that has a name. */
static void by_name(const voxrt_build_desc *desc, const voxrt_mesh *m, const file *f) {
    char path[64];
    voxrt_paged_desc d;
    voxrt_paged *p = NULL;
    voxrt_build_desc b = *desc;
    voxrt_result r;
    FILE *in = NULL;
    uint64_t i;
    (void)snprintf(path, sizeof path, "/tmp/fuzz_paged.%ld.vox", (long)getpid());
    memset(&b.env, 0, sizeof b.env);
    b.env.thread_count = 1;
    memset(&d, 0, sizeof d);
    r = voxrt_paged_build_file(&b, m, path, NULL);
    if (r == VOXRT_OK) {
        must(voxrt_paged_open_file(&d, path, &p) == VOXRT_OK && (in = fopen(path, "rb")) != NULL);
        for (i = 0; i < f->size && fgetc(in) == f->data[i]; i++) {}
        must(i == f->size && fgetc(in) == EOF && fclose(in) == 0);
    } else must(r == VOXRT_ERR_IO); /* no room on the disk */
    voxrt_paged_destroy(p);
    (void)remove(path);
}

static size_t triangles_of(const uint8_t *data, size_t size, float *p) {
    const size_t n = (size - OPTIONS) / 45 < TRIANGLES ? (size - OPTIONS) / 45 : TRIANGLES;
    size_t i;
    for (i = 0; i < 9 * n; i++) {
        const uint8_t *b = data + OPTIONS + 5 * i;
        memcpy(&p[i], b, 4);
        if (b[4] % 4 == 1 || b[4] % 4 == 2) p[i] = b[4] % 4 == 1 ? (float)(b[0] | b[1] << 8) / 4096.0f : (float)(b[0] % 65) / 4;
        if (b[4] % 4 == 3) p[i] = i < 3 ? 0.0f : p[i - 3 * (1 + b[0] % (i / 3))];
    }
    return n;
}

int LLVMFuzzerTestOneInput(const uint8_t *o, size_t size) {
    static const voxrt_finish finishes[2] = {{1, {1, 0, 0}, 9, {0, 0, 0}, {0, 0, 0}, 0, {0, 0, 0}, {0, 0, 0}},
                                             {0, {0, 0, 0}, 0, {1, 1, 1}, {0, 0, 0}, 0, {0, 0, 0}, {0, 0, 0}}};
    static const size_t room[4] = {0, (size_t)1 << 20, (size_t)1 << 17, (size_t)1 << 14};
    float p[9 * TRIANGLES];
    uint8_t rgb[3 * TRIANGLES], finish[TRIANGLES];
    voxrt_build_desc d;
    voxrt_build_stats stats, of_tree;
    voxrt_save_desc save;
    voxrt_mesh m;
    voxrt_tree *t = NULL;
    voxrt_sink sink;
    voxrt_result r, whole;
    file f = {NULL, 0, 0, ~(uint64_t)0};
    size_t i, n, bytes = 0;
    if (size < OPTIONS) return 0;
    n = triangles_of(o, size, p);
    for (i = 0; i < n; i++) memcpy(rgb + 3 * i, o + OPTIONS + 45 * i, 3), finish[i] = o[OPTIONS + 45 * i] % 3;
    memset(&d, 0, sizeof d);
    memset(&m, 0, sizeof m);
    memset(&save, 0, sizeof save);
    d.resolution = 1 + o[0] / 2 + (o[1] & 3) * 16u; /* pages are 64 wide */
    d.separating = (voxrt_separating)(o[1] >> 2 & 3);
    d.disable_normals = o[2] & 1;
    d.disable_colors = o[2] >> 1 & 1;
    d.planes = o[2] >> 2 & 1;
    d.spread = o[2] >> 3 & 1;
    d.strict = o[2] >> 4 & 1;
    d.finishes = finishes;
    d.finish_count = o[2] & 32 ? 2 : 0;
    d.box_size = o[2] & 64 ? 16 : 0;
    d.palette_size = 1u << 24;
    d.env.thread_count = o[5] & 1 ? 1 : 1 + (o[3] & 1); /* requests are counted */
    d.env.memory_limit = (size_t)1 << 26;
    m.positions = p;
    m.vertex_count = 3 * n;
    m.triangle_count = n;
    m.triangle_rgb = o[3] & 2 ? rgb : NULL;
    m.triangle_finish = o[2] & 32 ? finish : NULL;
    whole = voxrt_tree_build(&d, &m, &of_tree, &t);
    must((whole == VOXRT_OK) == (t != NULL));
    d.env.memory_limit = room[o[3] >> 2 & 3] != 0 ? room[o[3] >> 2 & 3] * (1u + o[4]) : d.env.memory_limit;
    d.env.allocator.alloc_fn = some_alloc;
    d.env.allocator.free_fn = some_free;
    d.env.progress_fn = progress;
    g_requests = 0;
    g_asked = 0;
    g_refused = o[5] & 1 ? 1 + o[6] : 0;
    g_stop = o[5] & 2 ? 1 + o[7] % 16 : 0;
    f.left = o[5] & 4 ? o[8] % 64 : ~(uint64_t)0;
    sink.write_fn = file_write;
    sink.user = &f;
    r = voxrt_paged_build(&d, &m, &sink, &stats);
    if (g_stop != 0 && g_asked >= g_stop) must(r == VOXRT_ERR_CANCELLED);
    else if (f.left == ~(uint64_t)0 && (o[5] & 4)) must(r == VOXRT_ERR_IO); /* one call more than worked */
    else if (g_refused != 0 && g_requests >= g_refused) must(r == VOXRT_ERR_NO_MEMORY);
    else must(r == whole || r == VOXRT_ERR_NO_MEMORY || whole == VOXRT_ERR_NO_MEMORY);
    if (r == VOXRT_OK && t != NULL) {
        uint8_t *saved = NULL;
        const uint8_t *palette;
        uint32_t entries = 0;
        int white;
        save.encoding = VOXRT_ENCODING_PAGED;
        must(stats.voxels == of_tree.voxels && stats.rejected == of_tree.rejected && stats.fragments == of_tree.fragments);
        must(voxrt_tree_save_memory(t, &save, NULL, 0, &bytes) == VOXRT_OK);
        palette = voxrt_tree_palette(t, &entries);
        white = entries == 1 && (palette[0] & palette[1] & palette[2]) == 255; /* a tree of one colour, this one, has none in its file */
        if (d.finish_count == 0 && !(white && m.triangle_rgb != NULL)) { /* finishes that no voxel has are there, too */
            must(bytes == f.size && (saved = (uint8_t *)malloc(bytes)) != NULL);
            must(voxrt_tree_save_memory(t, &save, saved, bytes, &bytes) == VOXRT_OK && memcmp(saved, f.data, bytes) == 0);
        }
        free(saved);
        look(&f, t, o);
        if (o[9] >> 6 == 3 && o[8] >> 6 == 3) by_name(&d, &m, &f);
    }
    free(f.data);
    voxrt_tree_destroy(t);
    return 0;
}
