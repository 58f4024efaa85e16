/* Triangles to voxels, against slow rules written from the definitions.

   Vertices are snapped to 2^-s of a voxel, s = min(8, 20 - depth), half up. Then everything is exact:
   6-separating  a cell is filled when the triangle meets one of the three unit segments that run through its centre
                 along the axes; the triangle's edges count, of a segment's two ends the lower one, and the upper one
                 of the last cell of the grid (Laine 2013)
   26-separating a cell is filled when the closed triangle meets the closed cube (separating axes)
   A triangle that meets no segment at all, and one that is long (over 2 voxels) and narrow (under 1), leaves voxels
   where nothing else is within one cell ("tiny").
   Boxes here are powers of two, so that positions turn into voxels without rounding. */
#include "test.h"
#define VOXRT_IMPLEMENTATION
#include "../voxrt.h"
#include "shapes.h"

#ifdef __SIZEOF_INT128__
__extension__ typedef __int128 wide_int;
#else
typedef int64_t wide_int; /* enough for the grids used here */
#endif

/* ---- sets of cells and builds --------------------------------------------------------------------------------- */

typedef struct voxelize_cells {
    uint32_t n;     /* along an axis */
    uint8_t *c;     /* [n^3] */
    uint8_t *rgb;   /* [3*n^3] or NULL */
    float *normal;  /* [3*n^3] or NULL */
    size_t count;
    uint64_t hash;
    int bad;        /* a cell outside of the grid, or given twice, or out of order */
    uint64_t last;
    voxrt_build_stats stats;
    voxrt_tree_info info;
} voxelize_cells;

static size_t cell_at(uint32_t n, uint32_t x, uint32_t y, uint32_t z) { return ((size_t)z * n + y) * n + x; }

static voxelize_cells cells_make(uint32_t n) {
    voxelize_cells s;
    memset(&s, 0, sizeof s);
    s.n = n;
    s.c = (uint8_t *)calloc((size_t)n * n * n, 1);
    if (s.c == NULL) abort();
    return s;
}

static void voxelize_cells_free(voxelize_cells *s) {
    free(s->c);
    free(s->rgb);
    free(s->normal);
    memset(s, 0, sizeof *s);
}

static int cells_filled(const voxelize_cells *s, int64_t x, int64_t y, int64_t z) {
    int64_t n = s->n;
    if (x < 0 || y < 0 || z < 0 || x >= n || y >= n || z >= n) return 0;
    return s->c[cell_at(s->n, (uint32_t)x, (uint32_t)y, (uint32_t)z)];
}

/* Something filled within r cells? r = 1: the cell and its 26 neighbours. */
static int cells_within(const voxelize_cells *s, int64_t r, int64_t x, int64_t y, int64_t z) {
    int64_t i, j, k;
    for (k = z - r; k <= z + r; k++)
        for (j = y - r; j <= y + r; j++)
            for (i = x - r; i <= x + r; i++)
                if (cells_filled(s, i, j, k)) return 1;
    return 0;
}

static int cells_around(const voxelize_cells *s, int64_t x, int64_t y, int64_t z) { return cells_within(s, 1, x, y, z); }

static int voxelize_take_cell(void *user, const voxrt_voxel *v, uint32_t palette_index) {
    voxelize_cells *s = (voxelize_cells *)user;
    uint64_t key = voxrti_morton(v->x, v->y, v->z);
    size_t i;
    (void)palette_index;
    if (v->x >= s->n || v->y >= s->n || v->z >= s->n || (s->count != 0 && key <= s->last)) {
        s->bad = 1;
        return 0;
    }
    s->last = key;
    i = cell_at(s->n, v->x, v->y, v->z);
    s->c[i] = 1;
    s->count++;
    if (s->rgb != NULL) memcpy(s->rgb + 3 * i, v->rgb, 3);
    if (s->normal != NULL) memcpy(s->normal + 3 * i, v->normal, 12);
    return 0;
}

static voxrt_build_desc desc_of(uint32_t resolution, voxrt_separating separating) {
    voxrt_build_desc d;
    memset(&d, 0, sizeof d);
    d.resolution = resolution;
    d.separating = separating;
    d.env.thread_count = 1;
    return d;
}

/* The grid is the box [0, size)^3. */
static voxrt_build_desc desc_box(uint32_t resolution, voxrt_separating separating, double size) {
    voxrt_build_desc d = desc_of(resolution, separating);
    d.box_size = size;
    return d;
}

static voxrt_mesh voxelize_mesh_of(const shape *s) {
    voxrt_mesh m;
    memset(&m, 0, sizeof m);
    m.positions = s->p;
    m.vertex_count = s->vertices;
    m.indices = s->t;
    m.triangle_count = s->triangles;
    return m;
}

enum { WITH_RGB = 1, WITH_NORMAL = 2 };

/* Build and read back; an empty set with the result in *result when there is no tree. */
static voxelize_cells build_mesh(const voxrt_build_desc *d, const voxrt_mesh *m, int with, voxrt_result *result) {
    voxrt_tree *t = NULL;
    voxelize_cells s = cells_make(d->resolution);
    voxrt_result r = voxrt_tree_build(d, m, &s.stats, &t);
    if (with & WITH_RGB) s.rgb = (uint8_t *)calloc((size_t)s.n * s.n * s.n, 3);
    if (with & WITH_NORMAL) s.normal = (float *)calloc((size_t)s.n * s.n * s.n, 12);
    if (result != NULL) *result = r;
    else CHECK_EQ_U64(r, VOXRT_OK);
    CHECK((r == VOXRT_OK) == (t != NULL));
    if (t != NULL) {
        voxrt_tree_get_info(t, &s.info);
        (void)voxrt_tree_each(t, s.info.depth, voxelize_take_cell, &s);
        CHECK(!s.bad);
        CHECK_EQ_U64(s.count, s.info.voxel_count);
        CHECK_EQ_U64(s.count, s.stats.voxels);
        s.hash = voxrt_tree_hash(t);
    }
    voxrt_tree_destroy(t);
    return s;
}

static voxelize_cells build_shape(const voxrt_build_desc *d, const shape *s) {
    voxrt_mesh m = voxelize_mesh_of(s);
    return build_mesh(d, &m, 0, NULL);
}

static int cells_same(const voxelize_cells *a, const voxelize_cells *b) {
    return a->n == b->n && memcmp(a->c, b->c, (size_t)a->n * a->n * a->n) == 0;
}

/* ---- the rules ------------------------------------------------------------------------------------------------- */

typedef struct snapped { int64_t p[3][3], n[3]; } snapped; /* in 2^-sub voxels */

static uint32_t depth_of(uint32_t resolution) {
    uint32_t d = 0;
    while (((uint32_t)1 << d) < resolution) d++;
    return d < 1 ? 1 : d;
}

static uint32_t sub_of(uint32_t resolution) {
    uint32_t d = depth_of(resolution);
    return d <= 12 ? 8 : 20 - d;
}

static snapped snap(const float *p, const uint32_t *index, double voxel, uint32_t sub) { /* the box begins at 0 */
    snapped t;
    int i, a;
    for (i = 0; i < 3; i++)
        for (a = 0; a < 3; a++)
            t.p[i][a] = (int64_t)floor((double)p[3 * index[i] + (uint32_t)a] / voxel * (double)(1 << sub) + 0.5);
    for (a = 0; a < 3; a++) {
        int u = (a + 1) % 3, w = (a + 2) % 3;
        t.n[a] = (t.p[1][u] - t.p[0][u]) * (t.p[2][w] - t.p[0][w]) - (t.p[1][w] - t.p[0][w]) * (t.p[2][u] - t.p[0][u]);
    }
    return t;
}

static void span(const snapped *t, int a, int64_t *lo, int64_t *hi) {
    int i;
    *lo = *hi = t->p[0][a];
    for (i = 1; i < 3; i++) {
        if (t->p[i][a] < *lo) *lo = t->p[i][a];
        if (t->p[i][a] > *hi) *hi = t->p[i][a];
    }
}

/* Add the crosshair targets. Returns how many the triangle has inside the grid; *ties counts those where the surface
   meets the common end of two segments. */
static size_t rule_6(const snapped *t, uint32_t sub, voxelize_cells *out, size_t *ties) {
    int64_t size = (int64_t)1 << sub, half = size / 2, n = out->n, i, k, c;
    size_t targets = 0;
    int a, e;
    for (a = 0; a < 3; a++) {
        int u = (a + 1) % 3, w = (a + 2) % 3;
        int64_t lo[3], hi[3], q;
        if (t->n[a] == 0) continue;
        for (e = 0; e < 3; e++) {
            span(t, e, &lo[e], &hi[e]);
            lo[e] = lo[e] < 0 ? 0 : lo[e] / size;
            hi[e] = hi[e] < 0 ? -1 : hi[e] / size;
            if (hi[e] > n - 1) hi[e] = n - 1;
        }
        for (k = lo[w]; k <= hi[w]; k++) {
            for (i = lo[u]; i <= hi[u]; i++) {
                int64_t pu = i * size + half, pw = k * size + half;
                int inside = 1;
                wide_int at, den = t->n[a];
                for (e = 0; e < 3; e++) {
                    const int64_t *A = t->p[e], *B = t->p[(e + 1) % 3];
                    wide_int f = (wide_int)(B[u] - A[u]) * (pw - A[w]) - (wide_int)(B[w] - A[w]) * (pu - A[u]);
                    if (t->n[a] > 0 ? f < 0 : f > 0) inside = 0;
                }
                if (!inside) continue;
                at = t->p[0][a] * den - (wide_int)t->n[u] * (pu - t->p[0][u]) - (wide_int)t->n[w] * (pw - t->p[0][w]);
                if (den < 0) { den = -den; at = -at; }
                /* the cell q with q*size <= at/den < (q+1)*size */
                for (q = -1, c = 0; c < n; c++) {
                    wide_int from = den * c * size, to = den * (c + 1) * size;
                    if ((at >= from && at < to) || (c == n - 1 && at == to)) q = c;
                    if (at == from && ties != NULL) ++*ties;
                }
                if (q < 0) continue;
                {
                    uint32_t cell[3];
                    cell[a] = (uint32_t)q;
                    cell[u] = (uint32_t)i;
                    cell[w] = (uint32_t)k;
                    out->c[cell_at(out->n, cell[0], cell[1], cell[2])] = 1;
                    targets++;
                }
            }
        }
    }
    return targets;
}

/* Closed triangle against the closed cube [lo, lo + size]: 3 + 1 + 9 axes. Right for lines and points too. */
static int rule_26_cell(const snapped *t, const int64_t lo[3], int64_t size) {
    wide_int axis[13][3];
    int count = 0, a, e, i, k;
    memset(axis, 0, sizeof axis);
    for (a = 0; a < 3; a++) axis[count++][a] = 1;
    for (a = 0; a < 3; a++) axis[count][a] = t->n[a];
    count++;
    for (e = 0; e < 3; e++) {
        int64_t d[3];
        for (a = 0; a < 3; a++) d[a] = t->p[(e + 1) % 3][a] - t->p[e][a];
        for (a = 0; a < 3; a++) { /* the edge times the unit vector of a */
            axis[count][(a + 1) % 3] = d[(a + 2) % 3];
            axis[count][(a + 2) % 3] = -d[(a + 1) % 3];
            count++;
        }
    }
    for (i = 0; i < count; i++) {
        wide_int t0 = 0, t1 = 0, c0 = 0, c1 = 0;
        for (k = 0; k < 3; k++) {
            wide_int v = axis[i][0] * t->p[k][0] + axis[i][1] * t->p[k][1] + axis[i][2] * t->p[k][2];
            if (k == 0 || v < t0) t0 = v;
            if (k == 0 || v > t1) t1 = v;
        }
        for (k = 0; k < 8; k++) {
            wide_int v = axis[i][0] * (lo[0] + (k & 1 ? size : 0)) + axis[i][1] * (lo[1] + (k & 2 ? size : 0)) +
                         axis[i][2] * (lo[2] + (k & 4 ? size : 0));
            if (k == 0 || v < c0) c0 = v;
            if (k == 0 || v > c1) c1 = v;
        }
        if (t1 < c0 || c1 < t0) return 0;
    }
    return 1;
}

static size_t rule_26(const snapped *t, uint32_t sub, voxelize_cells *out) {
    int64_t size = (int64_t)1 << sub, lo[3], hi[3], c[3], corner[3];
    size_t found = 0;
    int a;
    for (a = 0; a < 3; a++) {
        span(t, a, &lo[a], &hi[a]);
        lo[a] = (int64_t)floor((double)lo[a] / (double)size) - 1;
        hi[a] = (int64_t)floor((double)hi[a] / (double)size) + 1;
        if (lo[a] < 0) lo[a] = 0;
        if (hi[a] > (int64_t)out->n - 1) hi[a] = (int64_t)out->n - 1;
    }
    for (c[2] = lo[2]; c[2] <= hi[2]; c[2]++)
        for (c[1] = lo[1]; c[1] <= hi[1]; c[1]++)
            for (c[0] = lo[0]; c[0] <= hi[0]; c[0]++) {
                for (a = 0; a < 3; a++) corner[a] = c[a] * size;
                if (!rule_26_cell(t, corner, size)) continue;
                out->c[cell_at(out->n, (uint32_t)c[0], (uint32_t)c[1], (uint32_t)c[2])] = 1;
                found++;
            }
    return found;
}

static int is_sliver(const snapped *t, uint32_t sub) {
    double longest = 0, area2 = 0, size = (double)(1 << sub);
    int e, a;
    for (e = 0; e < 3; e++) {
        double l = 0;
        for (a = 0; a < 3; a++) l += pow((double)(t->p[(e + 1) % 3][a] - t->p[e][a]) / size, 2);
        longest = l > longest ? l : longest;
    }
    for (a = 0; a < 3; a++) area2 += pow((double)t->n[a] / size / size, 2);
    return sqrt(longest) > 1.999 && sqrt(area2) < 1.001 * sqrt(longest);
}

/* ---- triangles of all kinds -------------------------------------------------------------------------------------- */

static const char *const kind_name[] = {"any", "needle", "sliver", "sub-voxel", "lattice", "centres", "in a plane",
                                        "line", "point", "axis right angle", "crossing bricks", "units"};
enum { VOXELIZE_KINDS = 12 };

static void random_triangle(test_rng *r, int kind, double n, float p[9]) { /* in the box [0, n]^3 */
    int i, a, axis = (int)test_rng_below(r, 3);
    float size = (float)n;
    for (i = 0; i < 9; i++) p[i] = test_rng_range(r, 0, size);
    switch (kind) {
    case 1: /* long, with two corners close together */
        for (a = 0; a < 3; a++) {
            p[6 + a] = p[3 + a] + test_rng_range(r, -0.3f, 0.3f);
            if (p[6 + a] < 0 || p[6 + a] > size) p[6 + a] = p[3 + a];
        }
        break;
    case 2: { /* third corner next to the middle of an edge */
        float f = test_rng_float(r);
        for (a = 0; a < 3; a++) {
            p[6 + a] = p[a] + f * (p[3 + a] - p[a]) + test_rng_range(r, -0.02f, 0.02f);
            if (p[6 + a] < 0 || p[6 + a] > size) p[6 + a] = p[a];
        }
        break;
    }
    case 3:
        for (i = 3; i < 9; i++) {
            p[i] = p[i % 3] + test_rng_range(r, -0.7f, 0.7f);
            if (p[i] < 0 || p[i] > size) p[i] = p[i % 3];
        }
        break;
    case 4: for (i = 0; i < 9; i++) p[i] = (float)test_rng_below(r, (uint32_t)n + 1); break;
    case 5: for (i = 0; i < 9; i++) p[i] = (float)test_rng_below(r, (uint32_t)n) + 0.5f; break;
    case 6: /* on a face of the cells, now and then on a centre plane */
        for (i = 0; i < 3; i++) p[3 * i + axis] = 0.5f * (float)test_rng_below(r, 2 * (uint32_t)n + 1);
        p[3 + axis] = p[6 + axis] = p[axis];
        break;
    case 7:
        for (a = 0; a < 3; a++) p[6 + a] = p[3 + a];
        break;
    case 8:
        for (i = 3; i < 9; i++) p[i] = p[i % 3];
        if (test_rng_below(r, 2)) for (i = 0; i < 9; i++) p[i] = floorf(p[i]);
        break;
    case 9:
        for (i = 0; i < 3; i++) p[i] = (float)test_rng_below(r, (uint32_t)n + 1);
        for (i = 3; i < 9; i++) p[i] = p[i % 3];
        p[3 + axis] = (float)test_rng_below(r, (uint32_t)n + 1);
        p[6 + (axis + 1) % 3] = (float)test_rng_below(r, (uint32_t)n + 1);
        break;
    case 10: /* across the middle of the grid */
        for (i = 0; i < 9; i++) p[i] = (float)n * (0.5f + test_rng_range(r, -0.1f, 0.1f));
        break;
    case 11: /* multiples of a few 1/256: ties of edges and depths */
        for (i = 0; i < 9; i++) p[i] = (float)test_rng_below(r, (uint32_t)n * 8 + 1) * 0.125f;
        break;
    default: break;
    }
}

static const uint32_t first_three[3] = {0, 1, 2};

static void check_single(uint32_t n, double box, uint32_t rounds, uint64_t seed) {
    test_rng rng = test_rng_make(seed);
    uint32_t k, sub = sub_of(n);
    for (k = 0; k < rounds; k++) {
        int kind = (int)(k % VOXELIZE_KINDS), mode;
        float p[9];
        snapped t;
        voxrt_mesh m;
        random_triangle(&rng, kind, box, p);
        t = snap(p, first_three, box / n, sub);
        memset(&m, 0, sizeof m);
        m.positions = p;
        m.vertex_count = 3;
        m.triangle_count = 1;
        for (mode = 0; mode < 2; mode++) {
            voxrt_build_desc d = desc_box(n, mode ? VOXRT_SEPARATING_26 : VOXRT_SEPARATING_6, box);
            voxelize_cells want = cells_make(n), got = build_mesh(&d, &m, 0, NULL);
            size_t targets = mode ? rule_26(&t, sub, &want) : rule_6(&t, sub, &want, NULL);
            if (targets != 0 && (mode == 1 || !is_sliver(&t, sub))) {
                CHECK_MSG(cells_same(&want, &got), "mode %d, n %u, round %u, %s: (%g %g %g) (%g %g %g) (%g %g %g)", mode,
                          n, k, kind_name[kind], (double)p[0], (double)p[1], (double)p[2], (double)p[3], (double)p[4],
                          (double)p[5], (double)p[6], (double)p[7], (double)p[8]);
            } else { /* nothing vanishes: a voxel near every point of the longest edge, and only where it touches */
                int e, longest = 0, i;
                double best = -1;
                voxelize_cells touched = cells_make(n);
                size_t j;
                CHECK(mode == 0);
                (void)rule_26(&t, sub, &touched);
                for (j = 0; j < (size_t)n * n * n; j++)
                    if ((got.c[j] && !touched.c[j]) || (want.c[j] && !got.c[j])) break;
                CHECK_MSG(j == (size_t)n * n * n, "%s, round %u: a voxel the triangle does not touch", kind_name[kind], k);
                for (j = 0; n <= 32 && j < (size_t)n * n * n; j++) /* one brick: a new voxel has no target beside it */
                    if (got.c[j] && !want.c[j] && cells_around(&want, (int64_t)(j % n), (int64_t)(j / n % n), (int64_t)(j / n / n)))
                        break;
                CHECK_MSG(n > 32 || j == (size_t)n * n * n, "%s, round %u: a voxel too many", kind_name[kind], k);
                for (e = 0; e < 3; e++) {
                    double l = 0;
                    for (i = 0; i < 3; i++) {
                        double x = (double)(t.p[e][i] - t.p[(e + 1) % 3][i]);
                        l += x * x;
                    }
                    if (l > best) { best = l; longest = e; }
                }
                for (i = 0; i <= 64; i++) {
                    int64_t c[3];
                    int a;
                    for (a = 0; a < 3; a++) {
                        double x = (double)t.p[longest][a], y = (double)t.p[(longest + 1) % 3][a];
                        c[a] = (int64_t)floor((x + (y - x) * i / 64.0) / (double)(1 << sub));
                    }
                    /* the walk takes half voxels: its cells have a voxel within 1, those between them within 2 */
                    CHECK_MSG(cells_within(&got, 2, c[0], c[1], c[2]), "%s, round %u: a gap", kind_name[kind], k);
                }
                voxelize_cells_free(&touched);
            }
            if (t.n[0] == 0 && t.n[1] == 0 && t.n[2] == 0) CHECK_EQ_U64(got.stats.degenerate, 1);
            else CHECK_EQ_U64(got.stats.degenerate, 0);
            CHECK(got.stats.fragments >= got.stats.voxels);
            voxelize_cells_free(&want);
            voxelize_cells_free(&got);
        }
    }
}

TEST(single_triangles) { check_single(16, 16.0, test_quick() ? 240 : 960, 1); }
TEST(single_triangles_scaled) { check_single(16, 1024.0, test_quick() ? 60 : 240, 2); }
TEST(single_triangles_64) { check_single(64, 64.0, test_quick() ? 12 : 36, 3); }
TEST(single_triangles_odd_grid) { check_single(48, 48.0, test_quick() ? 12 : 48, 4); }
TEST(single_triangles_tiny_grids) {
    uint32_t n;
    for (n = 1; n <= 6; n++) check_single(n, (double)n, test_quick() ? 36 : 72, 10 + n);
}

/* A grid of 2^14 has 2^-6 voxels and 2^16 has 2^-4: only a few cells are looked at. */
TEST(fine_grids_snap_coarser) {
    static const uint32_t sizes[3] = {8192, 16384, 65536};
    uint32_t g;
    for (g = 0; g < 3; g++) {
        uint32_t n = sizes[g], sub = sub_of(n), k, base = n - 40;
        test_rng rng = test_rng_make(77 + g);
        CHECK_EQ_U64(sub, g == 0 ? 7 : g == 1 ? 6 : 4);
        for (k = 0; k < (test_quick() ? 12u : 60u); k++) {
            int mode;
            float p[9];
            snapped t, at0;
            voxrt_mesh m;
            int i, a;
            random_triangle(&rng, (int)(k % VOXELIZE_KINDS), 16, p);
            at0 = snap(p, first_three, 1.0, sub); /* before the offset: a multiple of a voxel */
            for (i = 0; i < 9; i++) {
                p[i] = floorf(p[i] * 256.0f + 0.5f) / 256.0f; /* the sum below stays exact: 16 + 8 bits */
                p[i] += (float)base;
            }
            t = snap(p, first_three, 1.0, sub);
            for (i = 0; i < 3; i++)
                for (a = 0; a < 3; a++) t.p[i][a] -= (int64_t)base << sub;
            (void)at0;
            memset(&m, 0, sizeof m);
            m.positions = p;
            m.vertex_count = 3;
            m.triangle_count = 1;
            for (mode = 0; mode < 2; mode++) {
                voxrt_build_desc d = desc_box(n, mode ? VOXRT_SEPARATING_26 : VOXRT_SEPARATING_6, (double)n);
                voxelize_cells want = cells_make(20);
                voxrt_tree *tree = NULL;
                size_t targets = mode ? rule_26(&t, sub, &want) : rule_6(&t, sub, &want, NULL);
                CHECK_EQ_U64(voxrt_tree_build(&d, &m, NULL, &tree), VOXRT_OK);
                if (tree != NULL && targets != 0 && (mode == 1 || !is_sliver(&t, sub))) {
                    uint32_t x, y, z, wrong = 0;
                    voxrt_tree_info info;
                    voxrt_tree_get_info(tree, &info);
                    for (z = 0; z < 18; z++)
                        for (y = 0; y < 18; y++)
                            for (x = 0; x < 18; x++)
                                wrong += voxrt_tree_get(tree, info.depth, base + x, base + y, base + z, NULL) !=
                                         want.c[cell_at(20, x, y, z)];
                    CHECK_MSG(wrong == 0, "n %u, mode %d, round %u, %s: %u cells", n, mode, k, kind_name[k % VOXELIZE_KINDS], wrong);
                }
                voxrt_tree_destroy(tree);
                voxelize_cells_free(&want);
            }
        }
    }
}

static voxrt_separating mode_of(int k) {
    return k == 0 ? VOXRT_SEPARATING_6 : k == 1 ? VOXRT_SEPARATING_26 : VOXRT_SEPARATING_THESIS;
}

/* ---- many triangles ------------------------------------------------------------------------------------------------ */

static void soup(shape *s, test_rng *rng, uint32_t count, double n, int kind, double keep_ties_out) {
    uint32_t k;
    for (k = 0; k < count; k++) {
        float p[9];
        uint32_t v[3];
        int i;
        random_triangle(rng, kind < 0 ? (int)test_rng_below(rng, VOXELIZE_KINDS) : kind, n, p);
        if (keep_ties_out > 0) {
            snapped t = snap(p, first_three, 1.0, 8);
            voxelize_cells c = cells_make((uint32_t)n);
            size_t ties = 0, targets = rule_6(&t, 8, &c, &ties);
            voxelize_cells_free(&c);
            if (ties != 0 || targets == 0 || is_sliver(&t, 8)) continue;
        }
        for (i = 0; i < 3; i++) v[i] = shape_vertex(s, (double)p[3 * i], (double)p[3 * i + 1], (double)p[3 * i + 2]);
        shape_triangle(s, v[0], v[1], v[2]);
    }
}

TEST(soups) {
    uint32_t round, rounds = test_quick() ? 4 : 8;
    for (round = 0; round < rounds; round++) {
        test_rng rng = test_rng_make(100 + round);
        uint32_t n = round % 2 ? 64 : 40, sub = 8, count = 1u << (round % 8);
        shape s;
        int mode;
        memset(&s, 0, sizeof s);
        soup(&s, &rng, count, n, round % 3 ? -1 : 3, 0);
        for (mode = 0; mode < 2; mode++) {
            voxrt_build_desc d = desc_box(n, mode ? VOXRT_SEPARATING_26 : VOXRT_SEPARATING_6, n);
            voxelize_cells want = cells_make(n), touched = cells_make(n), got = build_shape(&d, &s);
            size_t i, none = 0, missing = 0, extra = 0, lost = 0, stray = 0;
            for (i = 0; i < s.triangles; i++) {
                snapped t = snap(s.p, s.t + 3 * i, 1.0, sub);
                if (mode) (void)rule_26(&t, sub, &want);
                else if (rule_6(&t, sub, &want, NULL) == 0 || is_sliver(&t, sub)) { /* may add what it touches, must not vanish */
                    int a;
                    none++;
                    (void)rule_26(&t, sub, &touched);
                    for (a = 0; a < 3; a++)
                        lost += !cells_around(&got, t.p[a][0] >> sub, t.p[a][1] >> sub, t.p[a][2] >> sub);
                }
            }
            for (i = 0; i < (size_t)n * n * n; i++) {
                missing += want.c[i] && !got.c[i];
                extra += got.c[i] && !want.c[i];
                stray += got.c[i] && !want.c[i] && !touched.c[i];
            }
            CHECK_MSG(missing == 0 && lost == 0 && stray == 0, "mode %d, round %u: %u missing, %u lost, %u stray", mode,
                      round, (unsigned)missing, (unsigned)lost, (unsigned)stray);
            CHECK(none != 0 || extra == 0);
            voxelize_cells_free(&want);
            voxelize_cells_free(&touched);
            voxelize_cells_free(&got);
        }
        shape_free(&s);
    }
}

/* A closed mesh of triangles far below a voxel is not thicker than the same surface in large triangles. */
TEST(dense_meshes_stay_thin) {
    shape a, b;
    voxrt_build_desc d = desc_box(72, VOXRT_SEPARATING_6, 72); /* bricks of 32 cells */
    voxelize_cells ca, cb;
    memset(&a, 0, sizeof a);
    memset(&b, 0, sizeof b);
    shape_sphere(&a, 35.1, 36.9, 36.05, 33, 40);
    shape_sphere(&b, 35.1, 36.9, 36.05, 33, 330);
    ca = build_shape(&d, &a);
    cb = build_shape(&d, &b);
    CHECK_MSG(fabs((double)ca.count / (double)cb.count - 1) < 0.01, "%u and %u", (unsigned)ca.count, (unsigned)cb.count);
    voxelize_cells_free(&ca);
    voxelize_cells_free(&cb);
    shape_free(&a);
    shape_free(&b);
}

/* Long slivers, and tubes thinner than a voxel, have no gaps of more than a cell. */
TEST(wires_have_no_gaps) {
    test_rng rng = test_rng_make(88);
    uint32_t k, gaps = 0, wires = 0;
    for (k = 0; k < (test_quick() ? 20u : 60u); k++) {
        const uint32_t n = 80;
        double a[3], b[3], m[9], width = k % 3 == 0 ? 0.02 : k % 3 == 1 ? 0.1 : 0.4;
        voxrt_build_desc d = desc_box(n, VOXRT_SEPARATING_6, n);
        shape s;
        voxelize_cells c;
        int i, j, bad = 0;
        memset(&s, 0, sizeof s);
        for (i = 0; i < 3; i++) {
            a[i] = 2 + 76 * test_rng_double(&rng);
            b[i] = 2 + 76 * test_rng_double(&rng);
        }
        shape_rotation(test_rng_double(&rng), test_rng_double(&rng), test_rng_double(&rng), m);
        if (k % 2) { /* one sliver */
            shape_vertex(&s, a[0], a[1], a[2]);
            shape_vertex(&s, b[0], b[1], b[2]);
            shape_vertex(&s, b[0] + m[0] * width, b[1] + m[3] * width, b[2] + m[6] * width);
            shape_triangle(&s, 0, 1, 2);
        } else { /* a tube of three sides */
            for (i = 0; i < 3; i++) {
                for (j = 0; j < 2; j++) {
                    const double *q = j ? b : a;
                    shape_vertex(&s, q[0] + m[i] * width / 2, q[1] + m[3 + i] * width / 2, q[2] + m[6 + i] * width / 2);
                }
            }
            for (i = 0; i < 3; i++) {
                uint32_t u = 2 * (uint32_t)i, v = 2 * (uint32_t)((i + 1) % 3);
                shape_triangle(&s, u, u + 1, v + 1);
                shape_triangle(&s, u, v + 1, v);
            }
        }
        c = build_shape(&d, &s);
        for (i = 0; i <= 500; i++) {
            int64_t q[3];
            for (j = 0; j < 3; j++) q[j] = (int64_t)floor(a[j] + (b[j] - a[j]) * i / 500.0);
            bad += !cells_within(&c, 2, q[0], q[1], q[2]);
        }
        wires++;
        gaps += bad != 0;
        voxelize_cells_free(&c);
        shape_free(&s);
    }
    CHECK_MSG(gaps == 0, "%u of %u wires have gaps", gaps, wires);
}

/* ---- leaks ---------------------------------------------------------------------------------------------------------- */

typedef struct voxelize_body { int what; double m[9], c[3], r[3]; } voxelize_body;

/* Distance-like: below 0 inside, above 0 outside; exact sign for boxes. */
static double body_at(const voxelize_body *b, double x, double y, double z) {
    double d[3], q[3], best = -1e30;
    int a;
    d[0] = x - b->c[0];
    d[1] = y - b->c[1];
    d[2] = z - b->c[2];
    for (a = 0; a < 3; a++) q[a] = b->m[a] * d[0] + b->m[3 + a] * d[1] + b->m[6 + a] * d[2]; /* transposed */
    if (b->what == 0) return sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2]) - b->r[0];
    if (b->what == 1) {
        double w = sqrt(q[0] * q[0] + q[1] * q[1]) - b->r[0];
        return sqrt(w * w + q[2] * q[2]) - b->r[1];
    }
    for (a = 0; a < 3; a++) best = fabs(q[a]) - b->r[a] > best ? fabs(q[a]) - b->r[a] : best;
    return best;
}

/* Flood the empty cells from all cells well inside; how many cells well outside are reached? */
static size_t leaks(const voxelize_cells *s, const voxelize_body *b, int diagonal, size_t *start) {
    uint32_t n = s->n, x, y, z;
    size_t total = (size_t)n * n * n, head = 0, tail = 0, bad = 0;
    uint8_t *seen = (uint8_t *)calloc(total, 1);
    uint32_t *queue = (uint32_t *)malloc(total * sizeof(uint32_t));
    double margin = b->what == 2 ? 0.02 : 0.3;
    if (seen == NULL || queue == NULL) abort();
    for (z = 0; z < n; z++)
        for (y = 0; y < n; y++)
            for (x = 0; x < n; x++) {
                size_t i = cell_at(n, x, y, z);
                if (!s->c[i] && body_at(b, x + 0.5, y + 0.5, z + 0.5) < -margin) {
                    seen[i] = 1;
                    queue[tail++] = (uint32_t)i;
                }
            }
    *start = tail;
    while (head < tail) {
        uint32_t i = queue[head++];
        int64_t cx = i % n, cy = i / n % n, cz = i / n / n, dx, dy, dz;
        if (body_at(b, (double)cx + 0.5, (double)cy + 0.5, (double)cz + 0.5) > margin) bad++;
        for (dz = -1; dz <= 1; dz++)
            for (dy = -1; dy <= 1; dy++)
                for (dx = -1; dx <= 1; dx++) {
                    int64_t ex = cx + dx, ey = cy + dy, ez = cz + dz;
                    size_t k;
                    if (!diagonal && dx * dx + dy * dy + dz * dz != 1) continue;
                    if (ex < 0 || ey < 0 || ez < 0 || ex >= n || ey >= n || ez >= n) continue;
                    k = cell_at(n, (uint32_t)ex, (uint32_t)ey, (uint32_t)ez);
                    if (s->c[k] || seen[k]) continue;
                    seen[k] = 1;
                    queue[tail++] = (uint32_t)k;
                }
    }
    free(seen);
    free(queue);
    return bad;
}

/* what: 0 sphere, 1 torus, 2 box, 3 slab */
static void make_body(shape *s, voxelize_body *b, int what, test_rng *rng, double n) {
    double u = test_rng_double(rng), v = test_rng_double(rng), w = test_rng_double(rng);
    int a;
    memset(s, 0, sizeof *s);
    memset(b, 0, sizeof *b);
    b->what = what > 2 ? 2 : what;
    shape_rotation(u, v, w, b->m);
    for (a = 0; a < 3; a++) b->c[a] = n / 2 + test_rng_double(rng) - 0.5;
    if (what == 0) {
        b->r[0] = n * 0.42;
        shape_sphere(s, 0, 0, 0, b->r[0], 24 + test_rng_below(rng, 60));
    } else if (what == 1) {
        b->r[0] = n * 0.3;
        b->r[1] = n * 0.1;
        shape_torus(s, 0, 0, 0, b->r[0], b->r[1], 100, 50);
    } else {
        for (a = 0; a < 3; a++) b->r[a] = n * 0.26;
        if (what == 3) b->r[2] = 0.3 + 2.0 * test_rng_double(rng); /* half the thickness */
        shape_box(s, -b->r[0], -b->r[1], -b->r[2], b->r[0], b->r[1], b->r[2]);
    }
    shape_place(s, b->m, b->c[0], b->c[1], b->c[2]);
}

TEST(closed_bodies_do_not_leak) {
    static const char *const name[4] = {"sphere", "torus", "cube", "slab"};
    uint32_t round, rounds = test_quick() ? 3 : 9;
    test_rng rng = test_rng_make(5);
    for (round = 0; round < 4 * rounds; round++) {
        shape s;
        voxelize_body b;
        int what = (int)(round % 4), mode;
        make_body(&s, &b, what, &rng, 64);
        for (mode = 0; mode < 2; mode++) {
            voxrt_build_desc d = desc_box(64, mode ? VOXRT_SEPARATING_26 : VOXRT_SEPARATING_6, 64);
            voxelize_cells c = build_shape(&d, &s);
            size_t start, bad = leaks(&c, &b, mode, &start);
            CHECK_MSG(bad == 0, "%s, round %u: %u cells reached outside", name[what], round, (unsigned)bad);
            if (what != 3) CHECK(start > 500);
            voxelize_cells_free(&c);
        }
        shape_free(&s);
    }
}

/* The thesis' converter leaks: the test above is able to fail. */
TEST(thesis_mode_leaks) {
    shape s;
    voxelize_body b;
    test_rng rng = test_rng_make(6);
    voxrt_build_desc d = desc_box(64, VOXRT_SEPARATING_THESIS, 64);
    voxelize_cells c;
    size_t start;
    make_body(&s, &b, 0, &rng, 64);
    c = build_shape(&d, &s);
    CHECK(leaks(&c, &b, 0, &start) > 0);
    voxelize_cells_free(&c);
    shape_free(&s);
}

/* A plane through the whole grid, given as two huge triangles, separates it; so does a sphere that sticks out of it. */
TEST(clipped_meshes_do_not_leak) {
    uint32_t round, rounds = test_quick() ? 6 : 24;
    test_rng rng = test_rng_make(8);
    for (round = 0; round < rounds; round++) {
        int mode;
        shape s;
        voxelize_body b;
        memset(&s, 0, sizeof s);
        memset(&b, 0, sizeof b);
        shape_rotation(test_rng_double(&rng), test_rng_double(&rng), test_rng_double(&rng), b.m);
        if (round % 2) { /* a slab: the lower face of a huge box runs through the grid */
            double far_away = round % 4 == 1 ? 300.0 : 1.0e5;
            b.what = 2;
            b.r[0] = b.r[1] = b.r[2] = far_away;
            b.c[0] = 24 - b.m[2] * far_away;
            b.c[1] = 24 - b.m[5] * far_away;
            b.c[2] = 24 - b.m[8] * far_away;
            shape_box(&s, -far_away, -far_away, -far_away, far_away, far_away, far_away);
        } else {
            b.r[0] = 30 + 40 * test_rng_double(&rng);
            b.c[0] = 24 - b.m[2] * b.r[0];
            b.c[1] = 24 - b.m[5] * b.r[0];
            b.c[2] = 24 - b.m[8] * b.r[0];
            shape_sphere(&s, 0, 0, 0, b.r[0], 90);
        }
        shape_place(&s, b.m, b.c[0], b.c[1], b.c[2]);
        for (mode = 0; mode < 2; mode++) {
            voxrt_build_desc d = desc_box(48, mode ? VOXRT_SEPARATING_26 : VOXRT_SEPARATING_6, 48);
            voxelize_cells c = build_shape(&d, &s);
            size_t start, bad;
            bad = leaks(&c, &b, mode, &start);
            CHECK_MSG(bad == 0, "round %u, mode %d: %u cells reached outside", round, mode, (unsigned)bad);
            CHECK(start > 500);
            voxelize_cells_free(&c);
        }
        shape_free(&s);
    }
}

/* ---- orientation ---------------------------------------------------------------------------------------------------- */

TEST(plane_rotation_sweep) {
    int deg, tilt;
    for (tilt = 0; tilt < 2; tilt++) {
        for (deg = 0; deg <= 90; deg += test_quick() ? 15 : 3) {
            double f = deg * 3.14159265358979323846 / 180, px = cos(f), py = sin(f);
            voxrt_build_desc d = desc_box(128, VOXRT_SEPARATING_6, 128);
            shape s;
            snapped t;
            voxelize_cells want = cells_make(128), got;
            size_t i, missing = 0;
            memset(&s, 0, sizeof s);
            shape_vertex(&s, 64.3 - 40 * px, 64.2 - 40 * py, 64.5);
            shape_vertex(&s, 64.3 + 40 * px, 64.2 + 40 * py, 64.5);
            shape_vertex(&s, 64.3 - 39 * py, 64.2 + 39 * px, tilt ? 64.5 + 39 : 64.5);
            shape_triangle(&s, 0, 1, 2);
            got = build_shape(&d, &s);
            t = snap(s.p, s.t, 1.0, 8);
            (void)rule_6(&t, 8, &want, NULL);
            for (i = 0; i < (size_t)128 * 128 * 128; i++) missing += want.c[i] && !got.c[i];
            CHECK_EQ_U64(missing, 0);
            CHECK(cells_same(&want, &got));
            CHECK(got.count > 1500 && got.count < (tilt ? 6000u : 1700u)); /* area 1560 */
            voxelize_cells_free(&want);
            voxelize_cells_free(&got);
            shape_free(&s);
        }
    }
}

/* Axes permuted: the same set, permuted. Mirrored: the same where no surface meets the common end of two segments
   exactly (there the lower cell gets it in the mirror and the upper one does not), and no tiny triangles (their voxels are
   found by a walk, half up); closed cubes always. */
TEST(permuted_and_mirrored_axes) {
    static const int order[6][3] = {{0, 1, 2}, {0, 2, 1}, {1, 0, 2}, {1, 2, 0}, {2, 0, 1}, {2, 1, 0}};
    int mode, o, flip;
    for (mode = 0; mode < 2; mode++) {
        const uint32_t n = 40;
        test_rng rng = test_rng_make(31);
        shape s, q;
        voxrt_build_desc d = desc_box(n, mode ? VOXRT_SEPARATING_26 : VOXRT_SEPARATING_6, n);
        voxelize_cells base;
        size_t i;
        memset(&s, 0, sizeof s);
        memset(&q, 0, sizeof q);
        soup(&s, &rng, 90, n, 0, 1);
        soup(&s, &rng, 150, n, 3, 1);
        soup(&s, &rng, 40, n, 4, 1);
        if (mode) soup(&s, &rng, 60, n, -1, 0);
        for (i = 0; i < 3 * s.vertices; i++) s.p[i] = floorf(s.p[i] * 256.0f + 0.5f) / 256.0f;
        base = build_shape(&d, &s);
        CHECK(s.triangles > 100);
        for (i = 0; i < s.vertices; i++) shape_vertex(&q, 0, 0, 0);
        for (i = 0; i < s.triangles; i++) shape_triangle(&q, s.t[3 * i], s.t[3 * i + 1], s.t[3 * i + 2]);
        for (o = 0; o < 6; o++) {
            for (flip = 0; flip < 8; flip++) {
                voxelize_cells got;
                uint32_t c[3], e[3];
                size_t wrong = 0;
                int a;
                for (i = 0; i < s.vertices; i++)
                    for (a = 0; a < 3; a++) {
                        float x = s.p[3 * i + (size_t)order[o][a]];
                        q.p[3 * i + (size_t)a] = flip >> a & 1 ? (float)n - x : x;
                    }
                got = build_shape(&d, &q);
                for (c[2] = 0; c[2] < n; c[2]++)
                    for (c[1] = 0; c[1] < n; c[1]++)
                        for (c[0] = 0; c[0] < n; c[0]++) {
                            for (a = 0; a < 3; a++) e[order[o][a]] = flip >> a & 1 ? n - 1 - c[a] : c[a];
                            wrong += got.c[cell_at(n, c[0], c[1], c[2])] != base.c[cell_at(n, e[0], e[1], e[2])];
                        }
                CHECK_MSG(wrong == 0, "mode %d, order %d, flip %d: %u cells", mode, o, flip, (unsigned)wrong);
                voxelize_cells_free(&got);
            }
        }
        voxelize_cells_free(&base);
        shape_free(&s);
        shape_free(&q);
    }
}

/* ---- order and threads ---------------------------------------------------------------------------------------------- */

static void host_for(voxrt_task_fn *task, void *ctx, uint32_t count, void *user) { /* last one first */
    uint32_t i;
    ++*(int *)user;
    for (i = count; i-- > 0;) task(ctx, i);
}

static uint32_t hash_u32(uint32_t x) {
    x = (x ^ x >> 16) * 0x7feb352du;
    x = (x ^ x >> 15) * 0x846ca68bu;
    return x ^ x >> 16;
}

TEST(order_and_threads) {
    uint32_t round, rounds = test_quick() ? 2 : 4;
    for (round = 0; round < rounds; round++) {
        test_rng rng = test_rng_make(900 + round);
        const uint32_t n = 72;
        shape s;
        voxrt_mesh m;
        uint8_t *rgb;
        uint64_t want = 0;
        size_t i;
        int step, calls = 0;
        memset(&s, 0, sizeof s);
        shape_sphere(&s, 33, 36, 36, 28, 40);
        for (i = 0; i < s.vertices; i++) /* a rough ball with any normals */
            s.p[3 * i] += test_rng_range(&rng, -2, 2);
        soup(&s, &rng, 400, n, 3, 0);
        soup(&s, &rng, 20, n, -1, 0);
        for (i = 0; i < 3 * s.vertices; i++) s.normal[i] = test_rng_range(&rng, -3, 3);
        rgb = (uint8_t *)malloc(3 * s.vertices);
        if (rgb == NULL) abort();
        for (i = 0; i < 3 * s.vertices; i++) rgb[i] = (uint8_t)test_rng_below(&rng, round % 2 ? 4 : 256);
        m = voxelize_mesh_of(&s);
        m.normals = s.normal;
        m.vertex_rgb = rgb;
        for (step = 0; step < 8; step++) {
            static const uint32_t threads[8] = {1, 2, 3, 7, 16, 1, 3, 2};
            voxrt_build_desc d = desc_box(n, round % 3 == 0 ? VOXRT_SEPARATING_6 : round % 3 == 1 ?
                                          VOXRT_SEPARATING_26 : VOXRT_SEPARATING_THESIS, n);
            voxelize_cells c;
            d.env.thread_count = threads[step];
            d.palette_size = round < 3 ? 1u << 24 : 30;
            if (step == 5) {
                d.env.parallel.for_fn = host_for;
                d.env.parallel.user = &calls;
            }
            if (step == 6) { /* other order of the triangles */
                for (i = s.triangles; i > 1; i--) {
                    size_t k = test_rng_below(&rng, (uint32_t)i), a;
                    for (a = 0; a < 3; a++) {
                        uint32_t v = s.t[3 * k + a];
                        s.t[3 * k + a] = s.t[3 * i - 3 + a];
                        s.t[3 * i - 3 + a] = v;
                    }
                }
            }
            if (step == 7) { /* each triangle begins with another corner */
                for (i = 0; i < s.triangles; i++) {
                    uint32_t turn = hash_u32((uint32_t)i) % 3, v[3];
                    memcpy(v, s.t + 3 * i, 12);
                    s.t[3 * i] = v[turn];
                    s.t[3 * i + 1] = v[(turn + 1) % 3];
                    s.t[3 * i + 2] = v[(turn + 2) % 3];
                }
            }
            c = build_mesh(&d, &m, 0, NULL);
            if (step == 0) want = c.hash;
            CHECK_MSG(c.hash == want, "round %u, step %d", round, step);
            voxelize_cells_free(&c);
        }
        CHECK(calls > 0);
        free(rgb);
        shape_free(&s);
    }
}

/* ---- place and scale ------------------------------------------------------------------------------------------------ */

TEST(scaled_meshes) {
    shape s, q;
    test_rng rng = test_rng_make(41);
    voxrt_build_desc d = desc_of(100, VOXRT_SEPARATING_6);
    voxelize_cells base, got;
    size_t i;
    int e;
    memset(&s, 0, sizeof s);
    memset(&q, 0, sizeof q);
    shape_sphere(&s, 0.3, 0.1, -0.2, 1, 30);
    soup(&s, &rng, 50, 1, 0, 0);
    base = build_shape(&d, &s);
    for (i = 0; i < s.vertices; i++) shape_vertex(&q, 0, 0, 0);
    for (i = 0; i < s.triangles; i++) shape_triangle(&q, s.t[3 * i], s.t[3 * i + 1], s.t[3 * i + 2]);
    for (e = -100; e <= 100; e += 20) {
        for (i = 0; i < 3 * s.vertices; i++) q.p[i] = ldexpf(s.p[i], e);
        got = build_shape(&d, &q);
        CHECK_MSG(cells_same(&base, &got), "2^%d", e);
        CHECK_NEAR(got.info.voxel_size, ldexp(base.info.voxel_size, e), 0);
        voxelize_cells_free(&got);
    }
    for (e = -6; e <= 6; e++) {
        for (i = 0; i < 3 * s.vertices; i++) q.p[i] = (float)((double)s.p[i] * pow(10, e));
        got = build_shape(&d, &q);
        CHECK_MSG(fabs((double)got.count / (double)base.count - 1) < 0.002, "1e%d: %u instead of %u", e,
                  (unsigned)got.count, (unsigned)base.count);
        voxelize_cells_free(&got);
    }
    voxelize_cells_free(&base);
    shape_free(&s);
    shape_free(&q);
}

/* Half a voxel stays free on both sides: the longest side spans resolution - 1 voxels, in the middle. */
TEST(default_box) {
    static const uint32_t sizes[4] = {2, 5, 64, 1000};
    int i, axis, a;
    for (i = 0; i < 4; i++) {
        for (axis = 0; axis < 3; axis++) {
            shape s;
            voxrt_tree *t = NULL;
            voxrt_tree_info info;
            voxrt_build_desc d = desc_of(sizes[i], VOXRT_SEPARATING_6);
            double lo[3] = {-3, 5, 11}, hi[3] = {-2, 6.5, 12.25};
            voxrt_mesh m;
            memset(&s, 0, sizeof s);
            hi[axis] = lo[axis] + 7;
            shape_box(&s, lo[0], lo[1], lo[2], hi[0], hi[1], hi[2]);
            m = voxelize_mesh_of(&s);
            CHECK_EQ_U64(voxrt_tree_build(&d, &m, NULL, &t), VOXRT_OK);
            voxrt_tree_get_info(t, &info);
            CHECK_NEAR(info.voxel_size, 7.0 / (sizes[i] - 1), 1e-12);
            for (a = 0; a < 3; a++) {
                double middle = info.world_origin[a] + info.voxel_size * sizes[i] / 2;
                CHECK_NEAR(middle, (lo[a] + hi[a]) / 2, 1e-12);
                CHECK(info.cell_max[a] <= sizes[i]);
            }
            CHECK_EQ_U64(info.cell_min[axis], 0);
            CHECK_EQ_U64(info.cell_max[axis], sizes[i]);
            CHECK_EQ_U64(info.resolution, sizes[i]);
            voxrt_tree_destroy(t);
            shape_free(&s);
        }
    }
}

TEST(aligned_cube) {
    int pass;
    for (pass = 0; pass < 6; pass++) {
        uint32_t n = 16, from = pass < 2 ? 4 : pass < 4 ? 0 : 5, to = pass < 2 ? 12 : 16, x, y, z;
        int mode = pass & 1;
        double unit = 0.25, origin = -10;
        shape s;
        voxrt_build_desc d = desc_of(n, mode ? VOXRT_SEPARATING_26 : VOXRT_SEPARATING_6);
        voxelize_cells got, want = cells_make(n);
        d.box_size = n * unit;
        for (x = 0; x < 3; x++) d.box_min[x] = origin;
        memset(&s, 0, sizeof s);
        shape_box(&s, origin + from * unit, origin + from * unit, origin + from * unit, origin + to * unit,
                  origin + to * unit, origin + to * unit);
        got = build_shape(&d, &s);
        for (z = 0; z < n; z++)
            for (y = 0; y < n; y++)
                for (x = 0; x < n; x++) {
                    uint32_t c[3] = {x, y, z}, a, b, filled = 0;
                    for (a = 0; a < 3; a++) {
                        if (mode) { /* touches the plane, and the face's square in the other axes */
                            int on = (c[a] <= from && from <= c[a] + 1) || (c[a] <= to && to <= c[a] + 1);
                            for (b = 0; b < 3; b++)
                                if (b != a) on = on && c[b] + 1 >= from && c[b] <= to;
                            filled |= (uint32_t)on;
                        } else { /* the floor of the plane; the grid's last plane belongs to the last cell */
                            uint32_t last = to == n ? n - 1 : to;
                            int on = c[a] == from || c[a] == last;
                            for (b = 0; b < 3; b++)
                                if (b != a) on = on && c[b] >= from && c[b] < to;
                            filled |= (uint32_t)on;
                        }
                    }
                    want.c[cell_at(n, x, y, z)] = (uint8_t)filled;
                }
        CHECK_MSG(cells_same(&want, &got), "pass %d", pass);
        CHECK_NEAR(got.info.voxel_size, unit, 0);
        CHECK_NEAR(got.info.world_origin[1], origin, 0);
        voxelize_cells_free(&want);
        voxelize_cells_free(&got);
        shape_free(&s);
    }
}

TEST(far_from_the_origin) { /* 2^-4 is exact at 1e6 */
    shape s, q;
    voxrt_build_desc d = desc_box(64, VOXRT_SEPARATING_6, 64);
    voxelize_cells base, got;
    size_t i;
    int a;
    memset(&s, 0, sizeof s);
    memset(&q, 0, sizeof q);
    shape_sphere(&s, 32, 32, 32, 29, 20);
    for (i = 0; i < 3 * s.vertices; i++) s.p[i] = floorf(s.p[i] * 16.0f + 0.5f) / 16.0f;
    base = build_shape(&d, &s);
    for (i = 0; i < s.vertices; i++)
        shape_vertex(&q, (double)s.p[3 * i] + 1e6, (double)s.p[3 * i + 1] - 1e6, (double)s.p[3 * i + 2] + 9e5);
    for (i = 0; i < s.triangles; i++) shape_triangle(&q, s.t[3 * i], s.t[3 * i + 1], s.t[3 * i + 2]);
    for (a = 0; a < 3; a++) d.box_min[a] = a == 0 ? 1e6 : a == 1 ? -1e6 : 9e5;
    got = build_shape(&d, &q);
    CHECK(cells_same(&base, &got));
    voxelize_cells_free(&got);
    voxelize_cells_free(&base);
    d = desc_of(64, VOXRT_SEPARATING_6); /* the mesh's own box */
    base = build_shape(&d, &s);
    got = build_shape(&d, &q);
    CHECK_MSG(fabs((double)got.count / (double)base.count - 1) < 0.002, "%u, %u", (unsigned)got.count, (unsigned)base.count);
    voxelize_cells_free(&got);
    voxelize_cells_free(&base);
    shape_free(&s);
    shape_free(&q);
}

/* The grid shows a part of the mesh: the cells are those of the whole mesh. Triangles that leave the grid are cut, the
   new corners are snapped: a plane may move by a fraction of 2^-8 voxels, so a few cells in a thousand may differ. */
TEST(box_smaller_than_the_mesh) {
    uint32_t round, rounds = test_quick() ? 4 : 12;
    test_rng rng = test_rng_make(60);
    for (round = 0; round < rounds; round++) {
        const uint32_t n = 128, part = 32, at = 16 * (1 + test_rng_below(&rng, 5));
        shape s;
        int mode;
        memset(&s, 0, sizeof s);
        if (round % 2) shape_sphere(&s, 64, 64, 64, 60, 5 + 3 * round);
        else soup(&s, &rng, 40, n, round % 4 ? 9 : 0, 0);
        for (mode = 0; mode < 2; mode++) {
            voxrt_build_desc d = desc_box(n, mode ? VOXRT_SEPARATING_26 : VOXRT_SEPARATING_6, n);
            voxelize_cells all = build_shape(&d, &s), got;
            voxrt_mesh m = voxelize_mesh_of(&s);
            voxrt_result r;
            uint32_t x, y, z, c = 0, wrong = 0;
            d.resolution = part;
            d.box_size = part;
            for (x = 0; x < 3; x++) d.box_min[x] = at;
            got = build_mesh(&d, &m, 0, &r);
            for (z = 1; z + 1 < part; z++)
                for (y = 1; y + 1 < part; y++)
                    for (x = 1; x + 1 < part; x++) {
                        uint32_t want = all.c[cell_at(n, x + at, y + at, z + at)];
                        c += want;
                        wrong += want != got.c[cell_at(part, x, y, z)];
                    }
            CHECK(r == VOXRT_OK || (r == VOXRT_ERR_EMPTY && c == 0));
            CHECK_MSG(wrong * 200 <= c, "round %u, mode %d: %u of %u cells", round,
                      mode, wrong, c);
            voxelize_cells_free(&all);
            voxelize_cells_free(&got);
        }
        shape_free(&s);
    }
}

/* A triangle that leaves the grid is cut in pieces; it counts as often as one that does not. */
TEST(clipped_triangles_count_once) {
    int mode;
    for (mode = 0; mode < 2; mode++) {
        shape s;
        static const uint8_t rgb[9] = {0, 0, 0, 255, 255, 255, 255, 255, 255};
        voxrt_build_desc d = desc_box(64, mode_of(mode), 64);
        voxrt_mesh m;
        voxelize_cells c, one;
        uint32_t x, y, wrong = 0;
        memset(&s, 0, sizeof s);
        shape_vertex(&s, -4000, -4000, 20.5); /* all of the plane, cut at all four sides */
        shape_vertex(&s, 9000, -4000, 20.5);
        shape_vertex(&s, -4000, 9000, 20.5);
        shape_vertex(&s, 0, 0, 20.5);
        shape_vertex(&s, 64, 0, 20.5);
        shape_vertex(&s, 64, 64, 20.5);
        shape_vertex(&s, 0, 64, 20.5);
        shape_triangle(&s, 0, 1, 2);
        m = voxelize_mesh_of(&s);
        one = build_mesh(&d, &m, 0, NULL);
        CHECK_EQ_U64(one.stats.degenerate, 0);
        shape_triangle(&s, 3, 4, 5);
        shape_triangle(&s, 3, 5, 6);
        m = voxelize_mesh_of(&s);
        m.triangle_rgb = rgb;
        c = build_mesh(&d, &m, WITH_RGB, NULL);
        for (y = 0; y < 64; y++)
            for (x = 0; x < 64; x++) /* on diagonals of the pieces a triangle may count twice */
                wrong += c.rgb[3 * cell_at(64, x, y, 20)] != 188;
        CHECK_MSG(wrong <= 256, "mode %d: %u of 4096 voxels are not the mean", mode, wrong);
        if (mode == 0) CHECK_MSG(one.stats.fragments >= 4096 && one.stats.fragments <= 4096 + 192, "%u fragments",
                                 (unsigned)one.stats.fragments);
        voxelize_cells_free(&c);
        voxelize_cells_free(&one);
        shape_free(&s);
    }
}

/* What lies beyond the far faces of the grid, less than a voxel away, is cut off as what lies before the near ones. */
TEST(just_outside_of_the_grid) {
    static const float small[3][3] = {{0.3f, 0.2f, 0.2f}, {0.6f, 0.3f, 0.2f}, {0.4f, 0.4f, 0.3f}};
    static const float sliver[3][3] = {{0.3f, 0.2f, 0.2f}, {0.6f, 6.3f, 6.2f}, {0.4f, 3.2f, 3.3f}};
    uint32_t a, k, kind, mode;
    for (mode = 0; mode < 3; mode++)
        for (kind = 0; kind < 2; kind++)
            for (a = 0; a < 3; a++) {
                voxrt_build_desc d = desc_box(100, mode_of((int)mode), 100); /* no multiple of what is worked on at once */
                voxrt_mesh m;
                voxrt_result r;
                voxelize_cells one, both;
                float p[6][3];
                static const uint8_t rgb[6] = {0, 0, 255, 255, 0, 0};
                for (k = 0; k < 6; k++) {
                    p[k][a] = k < 3 ? 99.5f : 100.0f + (kind ? sliver : small)[k % 3][0];
                    p[k][(a + 1) % 3] = 50.0f + (kind ? sliver : small)[k % 3][1];
                    p[k][(a + 2) % 3] = 50.0f + (kind ? sliver : small)[k % 3][2];
                }
                memset(&m, 0, sizeof m);
                m.positions = p[3];
                m.vertex_count = 3;
                m.triangle_count = 1;
                m.triangle_rgb = rgb;
                one = build_mesh(&d, &m, 0, &r);
                CHECK_MSG(r == VOXRT_ERR_EMPTY, "mode %u, kind %u, axis %u: %d", mode, kind, a, (int)r);
                voxelize_cells_free(&one);
                m.positions = p[0];
                one = build_mesh(&d, &m, 0, NULL);
                m.vertex_count = 6;
                m.triangle_count = 2;
                both = build_mesh(&d, &m, WITH_RGB, NULL);
                CHECK_EQ_U64(both.info.voxel_count, one.info.voxel_count);
                CHECK_EQ_U64(both.info.palette_count, 1); /* and nothing of its colour is inside */
                voxelize_cells_free(&one);
                voxelize_cells_free(&both);
                for (k = 0; k < 3; k++) p[k][a] = 100.0f; /* the face itself belongs to the grid */
                m.triangle_count = 1;
                one = build_mesh(&d, &m, 0, &r);
                CHECK_MSG(mode == 2 || r == VOXRT_OK, "mode %u, kind %u, axis %u: %d", mode, kind, a, (int)r);
                voxelize_cells_free(&one);
            }
}

static int write_nowhere(void *user, uint64_t offset, const void *from, size_t bytes) {
    (void)user;
    (void)offset;
    (void)from;
    (void)bytes;
    return 0;
}

/* A line that leaves the grid is cut in pieces, and pieces of triangles may be lines. */
TEST(clipped_lines_count_once) {
    static const float p[9][3] = {{-50, 5.2f, 5.2f}, {5.6f, 5.2f, 5.2f}, {5.6f, 5.2f, 5.2f}, {-9, -9, 8}, {30, -9, 8},
                                  {-9, 30, 8}, {-7, 3, 8}, {9, 3.5f, 8}, {-2, 3, 8}};
    voxrt_build_desc d = desc_box(16, VOXRT_SEPARATING_6, 16);
    voxrt_build_stats stats;
    voxrt_sink sink;
    voxrt_mesh m;
    voxelize_cells c;
    memset(&m, 0, sizeof m);
    memset(&sink, 0, sizeof sink);
    m.positions = p[0];
    m.vertex_count = 9;
    m.triangle_count = 3;
    c = build_mesh(&d, &m, 0, NULL);
    CHECK_EQ_U64(c.stats.degenerate, 1);
    sink.write_fn = write_nowhere;
    CHECK(voxrt_paged_build(&d, &m, &sink, &stats) == VOXRT_OK);
    CHECK_EQ_U64(stats.degenerate, 1);
    voxelize_cells_free(&c);
}

/* Long triangles without an area, or with little, cost what they touch, not what their boxes hold. */
TEST(long_lines_are_cheap) {
    static const float wide[4] = {0, 1e-5f, 1e-3f, 0.02f};
    uint32_t k, mode;
    for (k = 0; k < 4; k++)
        for (mode = test_quick() ? k % 3 : 0; mode < 3; mode += test_quick() ? 2 : 1) {
            float p[3][3] = {{0, 0, 0}, {1, 1, 1}, {0.5f, 0.5f, 0.5f}};
            voxrt_build_desc d;
            voxrt_build_stats stats;
            voxrt_mesh m;
            voxrt_tree *t = NULL;
            memset(&d, 0, sizeof d);
            memset(&m, 0, sizeof m);
            p[2][0] += wide[k];
            d.resolution = 8192;
            d.separating = mode_of((int)mode);
            d.env.memory_limit = (size_t)32 << 20;
            m.positions = p[0];
            m.vertex_count = 3;
            m.triangle_count = 1;
            CHECK_EQ_U64(voxrt_tree_build(&d, &m, &stats, &t), VOXRT_OK);
            CHECK_MSG(stats.voxels >= 8192, "%u voxels", (unsigned)stats.voxels);
            voxrt_tree_destroy(t);
        }
}

/* ---- the thesis' converter --------------------------------------------------------------------------------------- */

TEST(thesis_miss_rates) {
    static const double percent[6] = {0, 2.9, 10, 21.5, 34.8, 49.7}; /* measured by an independent program */
    int k;
    for (k = 0; k < 6; k++) {
        double f = 9 * k * 3.14159265358979323846 / 180, px = cos(f), py = sin(f), missed;
        shape s;
        voxrt_build_desc d = desc_box(256, VOXRT_SEPARATING_THESIS, 256);
        voxelize_cells thin, thesis;
        size_t i, r = 0, lack = 0;
        memset(&s, 0, sizeof s);
        shape_vertex(&s, 128.3 - 80 * px, 128.2 - 80 * py, 128.5);
        shape_vertex(&s, 128.3 + 80 * px, 128.2 + 80 * py, 128.5);
        shape_vertex(&s, 128.3 - 79 * py, 128.2 + 79 * px, 128.5);
        shape_triangle(&s, 0, 1, 2);
        thesis = build_shape(&d, &s);
        d.separating = VOXRT_SEPARATING_6;
        thin = build_shape(&d, &s);
        for (i = 0; i < (size_t)256 * 256 * 256; i++) {
            r += thin.c[i];
            lack += thin.c[i] && !thesis.c[i];
        }
        missed = 100.0 * (double)lack / (double)r;
        CHECK_MSG(fabs(missed - percent[k]) < 1.5, "%d degrees: %.1f %%, not %.1f %%", 9 * k, missed, percent[k]);
        voxelize_cells_free(&thin);
        voxelize_cells_free(&thesis);
        shape_free(&s);
    }
}

/* A plane of unit normal n meets the crosshairs of cells within |largest component of n| / 2 of it, and the cubes of
   cells within (|x| + |y| + |z|) / 2: so many voxels a unit of area, on a sphere 0.827 and 1.5 on average. */
TEST(counts_grow_fourfold) {
    int mode;
    shape s;
    double biggest = 0, weight = 0;
    uint32_t i, k, a;
    memset(&s, 0, sizeof s);
    shape_sphere(&s, 0, 0, 0, 1, 60);
    for (i = 0; i < 400; i++)
        for (k = 0; k < 400; k++) {
            double t = 3.14159265358979323846 * (i + 0.5) / 400, f = 3.14159265358979323846 * (k + 0.5) / 200, n[3], m = 0;
            n[0] = fabs(sin(t) * cos(f));
            n[1] = fabs(sin(t) * sin(f));
            n[2] = fabs(cos(t));
            for (a = 0; a < 3; a++) m = n[a] > m ? n[a] : m;
            biggest += m * sin(t);
            weight += sin(t);
        }
    for (mode = 0; mode < 3; mode++) {
        double before = 0, v = 0, growth = 0, r = 1;
        uint32_t n;
        for (n = 64; n <= (test_quick() ? 256u : 512u); n *= 2) {
            voxrt_build_desc d = desc_of(n, mode == 0 ? VOXRT_SEPARATING_THESIS : mode == 1 ? VOXRT_SEPARATING_6 :
                                         VOXRT_SEPARATING_26);
            voxrt_build_stats st;
            voxrt_tree *t = NULL;
            voxrt_mesh m = voxelize_mesh_of(&s);
            d.disable_normals = 1;
            CHECK_EQ_U64(voxrt_tree_build(&d, &m, &st, &t), VOXRT_OK);
            voxrt_tree_destroy(t);
            v = (double)st.voxels;
            r = (n - 1) / 2.0;
            if (before > 0) growth = v / before;
            before = v;
        }
        CHECK_MSG(fabs(growth - 4) < (mode == 0 ? (test_quick() ? 0.6 : 0.3) : 0.15), "mode %d: %.3f", mode, growth);
        v /= 4 * 3.14159265 * r * r;
        if (mode == 1) CHECK_MSG(fabs(v - biggest / weight) < 0.02, "%.3f voxels a unit, not %.3f", v, biggest / weight);
        if (mode == 2) CHECK_MSG(fabs(v - 1.5) < 0.05, "%.3f voxels a unit", v);
    }
    shape_free(&s);
}

/* ---- attributes ----------------------------------------------------------------------------------------------------- */

TEST(one_colour_is_exact) {
    static const uint8_t colour[5][3] = {{0, 0, 0}, {255, 255, 255}, {1, 128, 254}, {10, 11, 12}, {77, 200, 3}};
    shape s;
    int k, mode, per_triangle;
    memset(&s, 0, sizeof s);
    shape_sphere(&s, 16, 16, 16, 14.5, 20);
    {
        test_rng rng = test_rng_make(70);
        soup(&s, &rng, 100, 32, -1, 0);
    }
    for (k = 0; k < 5; k++)
        for (mode = 0; mode < 3; mode++)
            for (per_triangle = 0; per_triangle < 2; per_triangle++) {
                size_t rows = per_triangle ? s.triangles : s.vertices, i, wrong = 0;
                uint8_t *rgb = (uint8_t *)malloc(rows * 3);
                voxrt_build_desc d = desc_box(32, mode_of(mode), 32);
                voxrt_mesh m = voxelize_mesh_of(&s);
                voxelize_cells c;
                if (rgb == NULL) abort();
                for (i = 0; i < rows * 3; i++) rgb[i] = colour[k][i % 3];
                if (per_triangle) m.triangle_rgb = rgb;
                else m.vertex_rgb = rgb;
                c = build_mesh(&d, &m, WITH_RGB, NULL);
                for (i = 0; i < (size_t)32 * 32 * 32; i++) wrong += c.c[i] && memcmp(c.rgb + 3 * i, colour[k], 3) != 0;
                CHECK_MSG(wrong == 0, "colour %d, mode %d, per triangle %d: %u voxels", k, mode, per_triangle,
                          (unsigned)wrong);
                CHECK_EQ_U64(c.info.palette_count, 1);
                voxelize_cells_free(&c);
                free(rgb);
            }
    shape_free(&s);
}

/* Quads side by side in the plane z = 8.5, of two colours: away from the seam each has its own; voxels whose centre is on
   the seam get the mean in linear light. Corners of one colour win over vertices. */
TEST(coplanar_halves) {
    int mode, seam;
    for (seam = 0; seam < 2; seam++)
        for (mode = 0; mode < 2; mode++) {
            double at = seam ? 8.5 : 8;
            shape s;
            uint8_t rgb[12] = {255, 0, 0, 255, 0, 0, 0, 0, 255, 0, 0, 255}, vertex[24];
            voxrt_build_desc d = desc_box(16, mode ? VOXRT_SEPARATING_26 : VOXRT_SEPARATING_6, 16);
            voxrt_mesh m;
            voxelize_cells c;
            uint32_t x, y;
            int k;
            memset(&s, 0, sizeof s);
            memset(vertex, 99, sizeof vertex);
            for (k = 0; k < 2; k++) {
                double x0 = k ? at : 2, x1 = k ? 14 : at;
                uint32_t v = shape_vertex(&s, x0, 2, 8.5);
                shape_vertex(&s, x1, 2, 8.5);
                shape_vertex(&s, x1, 14, 8.5);
                shape_vertex(&s, x0, 14, 8.5);
                shape_triangle(&s, v, v + 1, v + 2);
                shape_triangle(&s, v, v + 2, v + 3);
            }
            m = voxelize_mesh_of(&s);
            m.triangle_rgb = rgb;
            m.vertex_rgb = vertex;
            c = build_mesh(&d, &m, WITH_RGB, NULL);
            for (y = 2; y < 14; y++)
                for (x = 2; x < 14; x++) {
                    size_t i = cell_at(16, x, y, 8);
                    const uint8_t *got = c.rgb + 3 * i;
                    CHECK(c.c[i]);
                    if (x < 7) CHECK_MSG(got[0] == 255 && got[1] == 0 && got[2] == 0, "%u %u", x, y);
                    if (x > 9) CHECK_MSG(got[0] == 0 && got[1] == 0 && got[2] == 255, "%u %u", x, y);
                    if (seam && x == 8) { /* half of full light is byte 188 */
                        if (!mode) CHECK_MSG(got[0] == 188 && got[1] == 0 && got[2] == 188, "%u: %u %u %u", y, got[0], got[1], got[2]);
                        CHECK(got[0] > 100 && got[2] > 100 && got[1] == 0);
                    }
                    if (!seam && !mode && x == 7) CHECK(got[0] == 255 && got[2] == 0); /* centre 7.5 */
                    if (!seam && !mode && x == 8) CHECK(got[0] == 0 && got[2] == 255);
                }
            voxelize_cells_free(&c);
            shape_free(&s);
        }
}

/* No attribute leaves the range of the triangle's corners, whatever its form: slivers have steep gradients. */
typedef struct seen_attributes { uint32_t wrong, voxels; double away; } seen_attributes;

static int look_at_attributes(void *user, const voxrt_voxel *v, uint32_t palette_index) {
    seen_attributes *s = (seen_attributes *)user;
    double angle = acos(fmin(1.0, (double)v->normal[0])) * 57.29578;
    (void)palette_index;
    s->voxels++;
    s->wrong += v->rgb[0] < 3 || v->rgb[0] > 250 || v->rgb[1] < 100 || v->rgb[1] > 119 || v->rgb[2] < 100 || v->rgb[2] > 119;
    s->away = angle > s->away ? angle : s->away;
    return 0;
}

TEST(attributes_stay_between_the_corners) {
    uint32_t g;
    int mode;
    static const uint32_t sizes[3] = {32, 4096, 65536};
    for (g = 0; g < 3; g++) {
        for (mode = 0; mode < 3; mode++) {
            test_rng rng = test_rng_make(500 + g);
            uint32_t n = sizes[g], k, rounds = test_quick() ? 12 : 24;
            double away = 0;
            uint32_t wrong = 0, voxels = 0;
            for (k = 0; k < rounds; k++) {
                float p[9], normal[9];
                uint8_t rgb[9];
                voxrt_mesh m;
                voxrt_build_desc d = desc_box(n, mode_of(mode), n);
                voxrt_tree *t = NULL;
                seen_attributes seen;
                int i;
                random_triangle(&rng, (int)(k % VOXELIZE_KINDS), 16, p);
                for (i = 0; i < 9; i++) {
                    p[i] += (float)(n - 20);
                    rgb[i] = (uint8_t)(i % 3 == 0 ? (i == 3 ? 250 : 3) : 100 + test_rng_below(&rng, 20));
                    normal[i] = i % 3 == 0 ? 1 : test_rng_range(&rng, -0.3f, 0.3f); /* within 23 degrees of x */
                }
                memset(&m, 0, sizeof m);
                m.positions = p;
                m.vertex_count = 3;
                m.triangle_count = 1;
                m.vertex_rgb = rgb;
                m.normals = normal;
                CHECK_EQ_U64(voxrt_tree_build(&d, &m, NULL, &t), VOXRT_OK);
                memset(&seen, 0, sizeof seen);
                (void)voxrt_tree_each(t, depth_of(n), look_at_attributes, &seen);
                wrong += seen.wrong;
                voxels += seen.voxels;
                away = seen.away > away ? seen.away : away;
                voxrt_tree_destroy(t);
            }
            CHECK_MSG(wrong == 0, "n %u, mode %d: %u of %u voxels have another colour", n, mode, wrong, voxels);
            CHECK_MSG(away < 24.3, "n %u, mode %d: a normal is %.1f degrees away", n, mode, away);
        }
    }
}

static double voxelize_to_linear(double c) { return c <= 0.04045 ? c / 12.92 : pow((c + 0.055) / 1.055, 2.4); }
static double voxelize_to_byte(double l) { return 255 * (l <= 0.0031308 ? l * 12.92 : 1.055 * pow(l, 1 / 2.4) - 0.055); }

/* Vertex colours over a large triangle: what linear interpolation in linear light gives at the voxel. */
TEST(interpolated_colours) {
    shape s;
    static const uint8_t rgb[9] = {255, 0, 40, 0, 255, 40, 0, 0, 200};
    voxrt_build_desc d = desc_box(128, VOXRT_SEPARATING_6, 128);
    voxrt_mesh m;
    voxelize_cells c;
    uint32_t x, y, k, seen = 0;
    d.palette_size = 1u << 24;
    memset(&s, 0, sizeof s);
    shape_vertex(&s, 4, 4, 20.5);
    shape_vertex(&s, 124, 4, 20.5);
    shape_vertex(&s, 4, 124, 20.5);
    shape_triangle(&s, 0, 1, 2);
    m = voxelize_mesh_of(&s);
    m.vertex_rgb = rgb;
    c = build_mesh(&d, &m, WITH_RGB, NULL);
    for (y = 0; y < 128; y++)
        for (x = 0; x < 128; x++) {
            size_t i = cell_at(128, x, y, 20);
            double b1 = (x + 0.5 - 4) / 120, b2 = (y + 0.5 - 4) / 120, b0 = 1 - b1 - b2;
            if (!c.c[i]) continue;
            seen++;
            for (k = 0; k < 3; k++) {
                double want = b0 * voxelize_to_linear(rgb[k] / 255.0) + b1 * voxelize_to_linear(rgb[3 + k] / 255.0) +
                    b2 * voxelize_to_linear(rgb[6 + k] / 255.0);
                double diff = fabs(voxelize_to_byte(want < 0 ? 0 : want) - c.rgb[3 * i + k]);
                CHECK_MSG(diff <= 0.6 || (want < 0.001 && diff < 2), "%u %u: %g is %u", x, y, voxelize_to_byte(want), c.rgb[3 * i + k]);
            }
        }
    CHECK(seen > 7000);
    voxelize_cells_free(&c);
    shape_free(&s);
}

TEST(normals_of_a_sphere) {
    shape s;
    int mode;
    for (mode = 0; mode < 3; mode++) {
        uint32_t n = test_quick() || mode != 0 ? 128 : 256, x, y, z;
        double r = n / 2.0 - 2, middle = n / 2.0 + 0.1;
        voxrt_build_desc d = desc_box(n, mode_of(mode), n);
        voxrt_mesh m;
        double worst = 0, sum = 0, worst_flat = 0;
        voxelize_cells c, flat;
        memset(&s, 0, sizeof s);
        shape_sphere(&s, middle, middle, middle, r, n / 4);
        m = voxelize_mesh_of(&s);
        m.normals = s.normal;
        c = build_mesh(&d, &m, WITH_NORMAL, NULL);
        m.normals = NULL; /* the triangles' own */
        flat = build_mesh(&d, &m, WITH_NORMAL, NULL);
        CHECK(cells_same(&c, &flat));
        for (z = 0; z < n; z++)
            for (y = 0; y < n; y++)
                for (x = 0; x < n; x++) {
                    size_t i = cell_at(n, x, y, z);
                    double p[3], l, dot = 0, length = 0, dot_flat = 0;
                    int a;
                    if (!c.c[i]) continue;
                    p[0] = x + 0.5 - middle;
                    p[1] = y + 0.5 - middle;
                    p[2] = z + 0.5 - middle;
                    l = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);
                    for (a = 0; a < 3; a++) {
                        dot += p[a] / l * (double)c.normal[3 * i + (size_t)a];
                        dot_flat += p[a] / l * (double)flat.normal[3 * i + (size_t)a];
                        length += (double)c.normal[3 * i + (size_t)a] * (double)c.normal[3 * i + (size_t)a];
                    }
                    if (!(fabs(length - 1) < 1e-5)) CHECK_NEAR(length, 1, 1e-5);
                    l = acos(dot > 1 ? 1 : dot) * 57.29578;
                    worst = l > worst ? l : worst;
                    sum += l;
                    l = acos(dot_flat > 1 ? 1 : dot_flat) * 57.29578;
                    worst_flat = l > worst_flat ? l : worst_flat;
                }
        /* 0.64 of the code; the surface is up to 0.5 (6) or 0.87 (26) voxels away: 0.23 degrees at r = 126, 0.8 at 62 */
        CHECK_MSG(worst < (n == 256 ? 1.0 : 1.8), "mode %d: %.3f degrees", mode, worst);
        CHECK_MSG(sum / (double)c.count < (n == 256 ? 0.4 : 0.6), "mode %d: mean %.3f degrees", mode, sum / (double)c.count);
        CHECK_MSG(worst_flat < 5, "mode %d: flat %.3f degrees", mode, worst_flat);
        voxelize_cells_free(&c);
        voxelize_cells_free(&flat);
        shape_free(&s);
    }
}

TEST(opposite_normals) { /* the same triangle from both sides */
    shape s;
    int mode;
    memset(&s, 0, sizeof s);
    shape_vertex(&s, 2, 2, 3);
    shape_vertex(&s, 13, 3, 5);
    shape_vertex(&s, 4, 12, 11);
    shape_triangle(&s, 0, 1, 2);
    shape_triangle(&s, 2, 1, 0);
    for (mode = 0; mode < 3; mode++) {
        voxrt_build_desc d = desc_box(16, mode_of(mode), 16);
        voxrt_mesh m = voxelize_mesh_of(&s);
        voxelize_cells c = build_mesh(&d, &m, WITH_NORMAL, NULL);
        size_t i;
        for (i = 0; i < (size_t)16 * 16 * 16; i++)
            if (c.c[i]) {
                double l = 0;
                int a;
                for (a = 0; a < 3; a++) l += (double)c.normal[3 * i + (size_t)a] * (double)c.normal[3 * i + (size_t)a];
                CHECK_NEAR(l, 1, 1e-5);
            }
        voxelize_cells_free(&c);
    }
    shape_free(&s);
}

TEST(bad_normals) { /* NaN, infinite, zero and huge ones: finite unit normals come out */
    shape s;
    int mode, k;
    static const float bad[5] = {NAN, INFINITY, 0, 1e38f, 1e-42f};
    memset(&s, 0, sizeof s);
    shape_sphere(&s, 8, 8, 8, 6, 8);
    for (mode = 0; mode < 3; mode++)
        for (k = 0; k < 5; k++) {
            voxrt_build_desc d = desc_box(16, mode_of(mode), 16);
            voxrt_mesh m = voxelize_mesh_of(&s);
            size_t i;
            voxelize_cells c;
            for (i = 0; i < 3 * s.vertices; i++)
                if (i % 7 == 0 || k > 1) s.normal[i] = k == 3 && i % 2 ? -bad[k] : bad[k];
            m.normals = s.normal;
            c = build_mesh(&d, &m, WITH_NORMAL, NULL);
            CHECK(c.count > 100);
            for (i = 0; i < (size_t)16 * 16 * 16; i++)
                if (c.c[i]) {
                    const float *q = c.normal + 3 * i;
                    double l = (double)q[0] * (double)q[0] + (double)q[1] * (double)q[1] + (double)q[2] * (double)q[2];
                    CHECK_NEAR(l, 1, 1e-5);
                }
            voxelize_cells_free(&c);
        }
    shape_free(&s);
}

/* Very many triangles in one voxel: the sums do not overflow and the mean is exact. */
TEST(a_million_triangles_in_a_voxel) {
    uint32_t n = test_quick() || TEST_SANITIZED ? 100000 : 1000000, k;
    int mode, size;
    float *p = (float *)malloc((size_t)n * 36), *normal = (float *)malloc((size_t)n * 36);
    uint8_t *rgb = (uint8_t *)malloc((size_t)n * 3);
    if (p == NULL || normal == NULL || rgb == NULL) abort();
    for (size = 0; size < 2; size++) { /* 0: over the centre of the voxel, 1: beside it and 1/64 as wide */
        for (k = 0; k < n; k++) {
            float at = size ? 0.25f : 0.1f, e = size ? 1.0f / 64 : 0.8f;
            float q[9] = {5, 5, 5.5f, 5, 5, 5.5f, 5, 5, 5.5f};
            int i;
            for (i = 0; i < 9; i++) q[i] += i % 3 < 2 ? at : 0;
            q[3] += e;
            q[7] += e;
            memcpy(p + 9 * (size_t)k, q, sizeof q);
            for (i = 0; i < 9; i++) normal[9 * (size_t)k + (size_t)i] = i % 3 == (int)(k & 1) ? 1.0f : 0.0f; /* x or y */
            rgb[3 * (size_t)k] = k & 1 ? 255 : 0; /* a half */
            rgb[3 * (size_t)k + 1] = k % 4 == 0 ? 255 : 0; /* a quarter: 0.25 is byte 136.96 */
            rgb[3 * (size_t)k + 2] = 255;
        }
        for (mode = 0; mode < 3; mode++) {
            voxrt_build_desc d = desc_box(8, mode_of(mode), 8);
            voxrt_mesh m;
            voxelize_cells c;
            size_t i = cell_at(8, 5, 5, 5);
            uint32_t used = size == 1 && mode == 0 ? n : n / 20;
            memset(&m, 0, sizeof m);
            m.positions = p;
            m.vertex_count = (size_t)used * 3;
            m.triangle_count = used;
            m.normals = normal;
            m.triangle_rgb = rgb;
            d.palette_size = 1u << 24;
            c = build_mesh(&d, &m, WITH_RGB | WITH_NORMAL, NULL);
            CHECK_EQ_U64(c.count, 1);
            CHECK(c.c[i]);
            CHECK_MSG(c.rgb[3 * i] == 188 && c.rgb[3 * i + 1] == 137 && c.rgb[3 * i + 2] == 255, "mode %d, size %d: %u %u %u",
                      mode, size, c.rgb[3 * i], c.rgb[3 * i + 1], c.rgb[3 * i + 2]);
            CHECK_NEAR(c.normal[3 * i], 0.70711, 0.012);
            CHECK_NEAR(c.normal[3 * i + 1], 0.70711, 0.012);
            CHECK_NEAR(c.normal[3 * i + 2], 0, 0.012);
            voxelize_cells_free(&c);
        }
    }
    free(p);
    free(normal);
    free(rgb);
}

TEST(disabled_attributes) {
    shape s;
    int k;
    memset(&s, 0, sizeof s);
    shape_sphere(&s, 16, 16, 16, 14, 20);
    for (k = 0; k < 4; k++) {
        voxrt_build_desc d = desc_box(32, VOXRT_SEPARATING_6, 32);
        voxrt_mesh m = voxelize_mesh_of(&s);
        static const uint8_t rgb[6] = {1, 2, 3, 1, 9, 9};
        voxelize_cells c;
        size_t i, wrong = 0;
        uint8_t *colour = (uint8_t *)malloc(3 * s.vertices);
        if (colour == NULL) abort();
        for (i = 0; i < 3 * s.vertices; i++) colour[i] = rgb[i % 6];
        m.vertex_rgb = colour;
        d.disable_colors = (uint32_t)k & 1u;
        d.disable_normals = (uint32_t)k >> 1;
        c = build_mesh(&d, &m, WITH_RGB | WITH_NORMAL, NULL);
        CHECK_EQ_U64(c.info.has_colors, !(k & 1));
        CHECK_EQ_U64(c.info.has_normals, !(k & 2));
        if (k & 2) CHECK_EQ_U64(c.info.normal_bytes, 0);
        for (i = 0; i < (size_t)32 * 32 * 32; i++) {
            if (!c.c[i]) continue;
            wrong += c.rgb[3 * i] != (k & 1 ? 255 : 1);
            wrong += ((c.normal[3 * i] != 0) | (c.normal[3 * i + 1] != 0) | (c.normal[3 * i + 2] != 0)) != !(k & 2);
        }
        CHECK_EQ_U64(wrong, 0);
        voxelize_cells_free(&c);
        free(colour);
    }
    shape_free(&s);
}

/* ---- sizes and bad input ----------------------------------------------------------------------------------------- */

TEST(resolutions) {
    static const uint32_t good[8] = {1, 2, 3, 5, 17, 1000, 1024, 65536};
    static const uint32_t wrong[4] = {65537, 1u << 17, 1u << 20, 0xffffffffu};
    static const float p[9] = {0, 0, 0, 1, 0, 0.25f, 0, 1, 0.5f};
    voxrt_mesh m;
    int i;
    memset(&m, 0, sizeof m);
    m.positions = p;
    m.vertex_count = 3;
    m.triangle_count = 1;
    for (i = 0; i < 8; i++) {
        voxrt_build_desc d = desc_of(good[i], VOXRT_SEPARATING_6);
        voxrt_tree *t = NULL;
        voxrt_tree_info info;
        if (good[i] == 65536) d.box_size = 4096; /* 16 voxels a unit */
        CHECK_EQ_U64(voxrt_tree_build(&d, &m, NULL, &t), VOXRT_OK);
        voxrt_tree_get_info(t, &info);
        CHECK_EQ_U64(info.resolution, good[i]);
        CHECK(((uint64_t)1 << info.depth) >= good[i] && info.depth >= 1);
        CHECK(info.depth == 1 || ((uint64_t)1 << (info.depth - 1)) < good[i]);
        CHECK(info.voxel_count > 0);
        CHECK(info.cell_max[0] <= good[i] && info.cell_max[1] <= good[i] && info.cell_max[2] <= good[i]);
        CHECK_EQ_U64(info.level_count[0], 1);
        CHECK_EQ_U64(info.level_count[info.depth], info.voxel_count);
        voxrt_tree_destroy(t);
    }
    for (i = 0; i < 4; i++) {
        voxrt_build_desc d = desc_of(wrong[i], VOXRT_SEPARATING_6);
        voxrt_error e;
        voxrt_tree *t = (voxrt_tree *)&m;
        memset(&e, 0, sizeof e);
        d.env.error = &e;
        CHECK_EQ_U64(voxrt_tree_build(&d, &m, NULL, &t), VOXRT_ERR_RANGE);
        CHECK(t == NULL);
        CHECK_EQ_U64(e.code, VOXRT_ERR_RANGE);
        CHECK(e.text[0] != 0);
    }
    { /* 0 is 1024 */
        voxrt_tree *t = NULL;
        voxrt_tree_info info;
        CHECK_EQ_U64(voxrt_tree_build(NULL, &m, NULL, &t), VOXRT_OK);
        voxrt_tree_get_info(t, &info);
        CHECK_EQ_U64(info.resolution, 1024);
        CHECK_EQ_U64(info.depth, 10);
        voxrt_tree_destroy(t);
    }
}

TEST(bad_triangles_are_skipped_and_counted) {
    uint32_t round;
    for (round = 0; round < 5; round++) {
        test_rng rng = test_rng_make(300 + round);
        shape s, good;
        size_t i, bad = 0, first = 0;
        voxrt_build_desc d = desc_of(64, round & 1 ? VOXRT_SEPARATING_26 : VOXRT_SEPARATING_6);
        voxrt_mesh m;
        voxelize_cells a, b;
        voxrt_error e;
        voxrt_tree *t = NULL;
        voxrt_build_stats st;
        memset(&s, 0, sizeof s);
        memset(&good, 0, sizeof good);
        soup(&s, &rng, 300, 64, 0, 0);
        soup(&s, &rng, round < 1 ? 17000 : 700, 64, 3, 0); /* more than one chunk */
        good.vertices = 0;
        for (i = 0; i < s.triangles; i++) {
            uint32_t k = test_rng_below(&rng, 100);
            int broken = k < 4 || i + 3 > s.triangles;
            if (broken) {
                uint32_t corner = s.t[3 * i + test_rng_below(&rng, 3)], axis = test_rng_below(&rng, 3);
                if (bad++ == 0) first = i;
                if (k % 4 == 0) s.p[3 * corner + axis] = NAN;
                else if (k % 4 == 1) s.p[3 * corner + axis] = INFINITY;
                else if (k % 4 == 2) s.p[3 * corner + axis] = -INFINITY;
                else s.t[3 * i + axis] = k % 8 == 3 ? 0xffffffffu : (uint32_t)s.vertices;
            } else {
                uint32_t v = 0;
                int q;
                for (q = 0; q < 3; q++) {
                    const float *p = s.p + 3 * s.t[3 * i + (size_t)q];
                    v = shape_vertex(&good, (double)p[0], (double)p[1], (double)p[2]);
                }
                shape_triangle(&good, v - 2, v - 1, v);
            }
        }
        d.env.thread_count = 1 + round % 3;
        a = build_shape(&d, &s);
        b = build_shape(&d, &good);
        CHECK_EQ_U64(a.stats.triangles, s.triangles);
        CHECK_EQ_U64(a.stats.rejected, bad);
        CHECK_EQ_U64(b.stats.rejected, 0);
        CHECK(a.hash == b.hash);
        voxelize_cells_free(&a);
        voxelize_cells_free(&b);
        d.strict = 1;
        d.env.error = &e;
        memset(&e, 0, sizeof e);
        m = voxelize_mesh_of(&s);
        t = (voxrt_tree *)&s;
        CHECK(voxrt_tree_build(&d, &m, &st, &t) != VOXRT_OK);
        CHECK(t == NULL);
        CHECK_EQ_U64(e.where, first);
        CHECK(e.code != VOXRT_OK && e.text[0] != 0);
        m = voxelize_mesh_of(&good);
        CHECK_EQ_U64(voxrt_tree_build(&d, &m, &st, &t), VOXRT_OK);
        voxrt_tree_destroy(t);
        shape_free(&s);
        shape_free(&good);
    }
}

TEST(nothing_to_build) {
    static const float nan_only[9] = {NAN, 0, 0, 1, 0, 0, 0, 1, 0};
    static const uint32_t wild[3] = {0, 1, 3};
    voxrt_build_desc d = desc_of(32, VOXRT_SEPARATING_6);
    voxrt_mesh m;
    voxrt_tree *t = (voxrt_tree *)&m;
    voxrt_build_stats st;
    voxrt_error e;
    memset(&m, 0, sizeof m);
    d.env.error = &e;
    CHECK_EQ_U64(voxrt_tree_build(&d, &m, NULL, &t), VOXRT_ERR_EMPTY);
    CHECK(t == NULL && e.code == VOXRT_ERR_EMPTY);
    m.positions = nan_only;
    m.vertex_count = 3;
    CHECK_EQ_U64(voxrt_tree_build(&d, &m, NULL, &t), VOXRT_ERR_EMPTY);
    m.triangle_count = 1;
    CHECK_EQ_U64(voxrt_tree_build(&d, &m, NULL, &t), VOXRT_ERR_EMPTY);
    m.indices = wild;
    CHECK_EQ_U64(voxrt_tree_build(&d, &m, &st, &t), VOXRT_ERR_EMPTY);
    CHECK(st.triangles == 1 && st.rejected == 1);
    d.strict = 1; /* the first bad triangle, though there is no good one */
    CHECK_EQ_U64(voxrt_tree_build(&d, &m, &st, &t), VOXRT_ERR_FORMAT);
    CHECK(e.code == VOXRT_ERR_FORMAT && e.where == 0 && st.rejected == 1);
    d.strict = 0;
    d.box_size = 1; /* all of it is outside */
    d.box_min[0] = 100;
    {
        static const float p[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
        m.positions = p;
        m.indices = NULL;
        CHECK_EQ_U64(voxrt_tree_build(&d, &m, NULL, &t), VOXRT_ERR_EMPTY);
    }
    CHECK_EQ_U64(voxrt_tree_build(&d, NULL, NULL, &t), VOXRT_ERR_INVALID_ARG);
    CHECK_EQ_U64(voxrt_tree_build(&d, &m, NULL, NULL), VOXRT_ERR_INVALID_ARG);
    m.positions = NULL;
    CHECK_EQ_U64(voxrt_tree_build(&d, &m, NULL, &t), VOXRT_ERR_INVALID_ARG);
    {
        static const float p[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
        static const double bad[4] = {-1, (double)NAN, (double)INFINITY, 0};
        int i;
        m.positions = p;
        for (i = 0; i < 4; i++) {
            voxrt_result r;
            d = desc_of(32, VOXRT_SEPARATING_6);
            d.box_size = bad[i];
            if (bad[i] == 0) d.separating = (voxrt_separating)7;
            r = voxrt_tree_build(&d, &m, NULL, &t);
            CHECK_MSG(r == VOXRT_ERR_INVALID_ARG || r == VOXRT_ERR_RANGE, "box %g: %d", bad[i], (int)r);
            voxrt_tree_destroy(t);
        }
        d = desc_of(32, VOXRT_SEPARATING_6);
        d.box_size = 1;
        d.box_min[1] = (double)NAN;
        CHECK(voxrt_tree_build(&d, &m, NULL, &t) != VOXRT_OK);
    }
}

TEST(flat_inputs) {
    static const uint32_t line[9] = {0, 4, 8, 8, 3, 0, 1, 2, 7};
    float p[27];
    int k, mode;
    for (k = 0; k < 4; k++) {
        for (mode = 0; mode < 3; mode++) {
            voxrt_build_desc d = desc_of(32, mode_of(mode));
            voxrt_mesh m;
            voxelize_cells c;
            int i;
            for (i = 0; i < 27; i++) { /* three triangles: 0 a point, 1 a line along x, 2 a diagonal, 3 a plane's square */
                int v = i / 3, a = i % 3;
                p[i] = k == 0 ? 3.25f : k == 1 ? (a == 0 ? (float)v : 7) : k == 2 ? (float)v * (float)(a + 1) :
                       a == 2 ? 1 : (float)(a == 0 ? v % 3 : v / 3);
            }
            memset(&m, 0, sizeof m);
            m.positions = p;
            m.vertex_count = 9;
            m.triangle_count = 3;
            m.indices = line;
            if (k == 3) {
                static const uint32_t quad[6] = {0, 2, 8, 0, 8, 6};
                m.indices = quad;
                m.triangle_count = 2;
            }
            c = build_mesh(&d, &m, 0, NULL);
            if (k != 2) CHECK_EQ_U64(c.stats.degenerate, k == 3 ? 0 : 3); /* snapping bends the diagonal */
            if (k == 0) CHECK_MSG(c.count >= 1 && c.count <= 8, "%u", (unsigned)c.count);
            if ((k == 1 || k == 2) && mode != 2) { /* no gap along the longest axis */
                int axis = k == 1 ? 0 : 2;
                CHECK_EQ_U64(c.info.cell_min[axis], 0);
                CHECK_EQ_U64(c.info.cell_max[axis], 32);
                CHECK_MSG(c.count >= (mode == 0 ? 11u : 32u) && c.count <= 300, /* each third cell: no gap of more than one */
                           "k %d mode %d: %u", k, mode, (unsigned)c.count);
            }
            if (k == 3 && mode != 2) CHECK(c.count >= 900); /* the thesis misses a half on the diagonal */
            voxelize_cells_free(&c);
        }
    }
}

TEST(huge_and_small_coordinates) { /* the ends of floats: no undefined conversions, a result or a clean error */
    static const float scale[7] = {1e-45f, 1e-38f, 1e-20f, 1e20f, 1e30f, 1e37f, 3.4e38f};
    int i, mode, box;
    for (i = 0; i < 7; i++)
        for (mode = 0; mode < 3; mode++)
            for (box = 0; box < 3; box++) {
                float p[18] = {-1, -1, 0, 1, -0.9f, 0.3f, 0.8f, 1, -0.2f, 0, 0.1f, 1, 0, 0, 0, 0.1f, 0.2f, 0.3f};
                voxrt_build_desc d = desc_of(64, mode_of(mode));
                voxrt_mesh m;
                voxrt_tree *t = NULL;
                voxrt_result r;
                int k;
                for (k = 0; k < 18; k++) p[k] *= scale[i];
                memset(&m, 0, sizeof m);
                m.positions = p;
                m.vertex_count = 6;
                m.triangle_count = 2;
                if (box == 1) {
                    d.box_size = 2;
                    for (k = 0; k < 3; k++) d.box_min[k] = -1;
                }
                if (box == 2) {
                    d.box_size = 2e-30;
                    for (k = 0; k < 3; k++) d.box_min[k] = -1e-30;
                }
                r = voxrt_tree_build(&d, &m, NULL, &t);
                CHECK_MSG(r == VOXRT_OK || r == VOXRT_ERR_RANGE || (box != 0 && r == VOXRT_ERR_EMPTY), "%d %d %d: %d", i,
                          mode, box, (int)r);
                if (box == 0 && i > 0) CHECK_EQ_U64(r, VOXRT_OK);
                if (t != NULL) {
                    voxrt_tree_info info;
                    voxrt_tree_get_info(t, &info);
                    CHECK(info.voxel_count > 0 && info.voxel_size > 0 && isfinite(info.voxel_size));
                    if (box == 0 && i > 0) CHECK(info.voxel_count > 1000);
                }
                voxrt_tree_destroy(t);
            }
}

TEST(strides) {
    shape s;
    voxrt_build_desc d = desc_box(32, VOXRT_SEPARATING_6, 32);
    voxrt_mesh m;
    voxelize_cells a, b;
    float *wide;
    float *normal;
    uint8_t *rgb, *tight;
    size_t i;
    test_rng rng = test_rng_make(9);
    memset(&s, 0, sizeof s);
    shape_sphere(&s, 16, 16, 16, 14, 12);
    wide = (float *)calloc(s.vertices, 20);
    normal = (float *)calloc(s.vertices, 16);
    rgb = (uint8_t *)calloc(s.vertices, 5);
    tight = (uint8_t *)calloc(s.vertices, 3);
    if (wide == NULL || normal == NULL || rgb == NULL || tight == NULL) abort();
    for (i = 0; i < s.vertices; i++) {
        memcpy(wide + 5 * i, s.p + 3 * i, 12);
        memcpy(normal + 4 * i, s.normal + 3 * i, 12);
        tight[3 * i] = rgb[5 * i] = (uint8_t)test_rng_u32(&rng);
        tight[3 * i + 1] = rgb[5 * i + 1] = (uint8_t)test_rng_u32(&rng);
        tight[3 * i + 2] = rgb[5 * i + 2] = (uint8_t)test_rng_u32(&rng);
    }
    m = voxelize_mesh_of(&s);
    m.normals = s.normal;
    m.vertex_rgb = tight;
    a = build_mesh(&d, &m, 0, NULL);
    m.positions = wide;
    m.position_stride = 20;
    m.normals = normal;
    m.normal_stride = 16;
    m.vertex_rgb = rgb;
    m.vertex_rgb_stride = 5;
    b = build_mesh(&d, &m, 0, NULL);
    CHECK(a.hash == b.hash);
    voxelize_cells_free(&a);
    voxelize_cells_free(&b);
    free(wide);
    free(normal);
    free(rgb);
    free(tight);
    shape_free(&s);
}

/* Vertices that lie over each other are a mistake, for each array; 0 and what an element has are not. */
TEST(strides_that_are_too_short) {
    static const float p[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
    static const uint8_t rgb[9] = {255, 0, 0, 0, 255, 0, 0, 0, 255};
    uint32_t array, stride;
    for (array = 0; array < 3; array++)
        for (stride = 0; stride <= 12; stride++) {
            const uint32_t least = array < 2 ? 12 : 3;
            voxrt_build_desc d = desc_of(8, VOXRT_SEPARATING_6);
            voxrt_error e;
            voxrt_mesh m;
            voxrt_tree *t = NULL;
            voxrt_result r;
            if (stride > least) continue;
            memset(&m, 0, sizeof m);
            memset(&e, 0, sizeof e);
            d.env.error = &e;
            m.positions = m.normals = p;
            m.vertex_rgb = rgb;
            m.vertex_count = 3;
            m.triangle_count = 1;
            *(array == 0 ? &m.position_stride : array == 1 ? &m.normal_stride : &m.vertex_rgb_stride) = stride;
            r = voxrt_tree_build(&d, &m, NULL, &t);
            CHECK_MSG(r == (stride == 0 || stride == least ? VOXRT_OK : VOXRT_ERR_INVALID_ARG), "array %u, stride %u", array, stride);
            CHECK((r == VOXRT_OK) == (t != NULL) && (r == VOXRT_OK || strstr(e.text, "stride") != NULL));
            voxrt_tree_destroy(t);
        }
}

/* Said at once, and before anything is allocated: also for numbers that no sum fits into. */
TEST(too_many_triangles) {
    static const float p[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
    static const uint32_t index[3] = {0, 1, 2};
    const size_t count[5] = {0xffffffffu, SIZE_MAX, SIZE_MAX - 1, SIZE_MAX - 5000, SIZE_MAX / 2 + 1};
    int i, how;
    for (i = 0; i < 5; i++)
        for (how = 0; how < 4; how++) { /* with indices; with a box */
            voxrt_build_desc d = desc_of(8, VOXRT_SEPARATING_6);
            voxrt_error e;
            voxrt_build_stats stats;
            voxrt_mesh m;
            voxrt_tree *t = NULL;
            test_alloc ta;
            memset(&m, 0, sizeof m);
            memset(&e, 0, sizeof e);
            test_alloc_init(&ta);
            d.env.allocator.alloc_fn = test_alloc_fn;
            d.env.allocator.free_fn = test_free_fn;
            d.env.allocator.user = &ta;
            d.env.error = &e;
            d.box_size = how & 2 ? 2 : 0;
            m.positions = p;
            m.vertex_count = 3;
            m.triangle_count = count[i];
            if (how & 1) m.indices = index;
            CHECK_EQ_U64(voxrt_tree_build(&d, &m, &stats, &t), VOXRT_ERR_RANGE);
            CHECK(t == NULL && e.where == count[i] && strstr(e.text, "triangles are too many") != NULL && ta.count == 0);
        }
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(single_triangles);
    RUN(single_triangles_scaled);
    RUN(single_triangles_64);
    RUN(single_triangles_odd_grid);
    RUN(single_triangles_tiny_grids);
    RUN(fine_grids_snap_coarser);
    RUN(soups);
    RUN(dense_meshes_stay_thin);
    RUN(wires_have_no_gaps);
    RUN(closed_bodies_do_not_leak);
    RUN(thesis_mode_leaks);
    RUN(clipped_meshes_do_not_leak);
    RUN(plane_rotation_sweep);
    RUN(permuted_and_mirrored_axes);
    RUN(order_and_threads);
    RUN(scaled_meshes);
    RUN(default_box);
    RUN(aligned_cube);
    RUN(far_from_the_origin);
    RUN(box_smaller_than_the_mesh);
    RUN(clipped_triangles_count_once);
    RUN(just_outside_of_the_grid);
    RUN(clipped_lines_count_once);
    RUN(long_lines_are_cheap);
    RUN(thesis_miss_rates);
    RUN(counts_grow_fourfold);
    RUN(one_colour_is_exact);
    RUN(coplanar_halves);
    RUN(attributes_stay_between_the_corners);
    RUN(interpolated_colours);
    RUN(normals_of_a_sphere);
    RUN(opposite_normals);
    RUN(bad_normals);
    RUN(a_million_triangles_in_a_voxel);
    RUN(disabled_attributes);
    RUN(resolutions);
    RUN(bad_triangles_are_skipped_and_counted);
    RUN(nothing_to_build);
    RUN(flat_inputs);
    RUN(huge_and_small_coordinates);
    RUN(strides);
    RUN(strides_that_are_too_short);
    RUN(too_many_triangles);
    return test_end();
}
