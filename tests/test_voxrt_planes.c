/* Voxels with planes: they lie where the mesh does; rays end where a slow search over all voxels ends them, on every
   instruction set; closed shells keep all rays; files, shared trees and filled hulls keep them; pictures are closer to
   the exact ones than those of cubes, and surfaces throw no shadow on themselves. -v prints the numbers. */
#include "test.h"
#include "shapes.h"
#define VOXRT_IMPLEMENTATION
#include "../voxrt.h"
#include "ball.h"

static voxrt_mesh mesh_of(const shape *s) {
    voxrt_mesh m;
    memset(&m, 0, sizeof m);
    m.positions = s->p;
    m.vertex_count = s->vertices;
    m.indices = s->t;
    m.triangle_count = s->triangles;
    m.normals = s->normal;
    return m;
}

/* What is in the cube [0,2)^3 as a tree. */
static voxrt_tree *planes_make(shape *s, uint32_t resolution, int planes, int fill) {
    voxrt_mesh m = mesh_of(s);
    voxrt_build_desc d;
    voxrt_tree *t = NULL;
    memset(&d, 0, sizeof d);
    d.resolution = resolution;
    d.box_size = 2;
    d.planes = planes != 0;
    d.fill = fill != 0;
    CHECK(voxrt_tree_build(&d, &m, NULL, &t) == VOXRT_OK);
    shape_free(s);
    return t;
}

/* The ball of radius 0.9 around (1, 1, 1). planes: 2: normals point inwards. */
static voxrt_tree *make_ball(uint32_t resolution, int planes, uint32_t rings) {
    shape s;
    size_t i;
    memset(&s, 0, sizeof s);
    shape_sphere(&s, 1, 1, 1, 0.9, rings);
    for (i = 0; planes == 2 && i < 3 * s.vertices; i++) s.normal[i] = -s.normal[i];
    return planes_make(&s, resolution, planes, 0);
}

/* What is in a mixed scene: a ball, a box beside it, and a thin plate that both of its sides share voxels of. */
static voxrt_tree *make_mixed(uint32_t resolution) {
    shape s;
    size_t i;
    memset(&s, 0, sizeof s);
    shape_box(&s, 0.15, 0.2, 0.3, 0.6, 0.9, 0.95);
    shape_box(&s, 1.5, 0.3, 0.3, 1.505, 1.7, 1.6);
    for (i = 0; i < s.vertices; i++) memset(s.normal + 3 * i, 0, 12); /* the triangles' own */
    shape_sphere(&s, 1, 1, 1, 0.5, 40);
    return planes_make(&s, resolution, 1, 0);
}

/* ---- what is stored ---- */

TEST(planes_are_where_triangles_are) {
    static const uint32_t resolution[2] = {32, 128};
    uint32_t k;
    for (k = 0; k < 2; k++) {
        voxrt_tree *t = make_ball(resolution[k], 2 - (int)k, 160);
        voxrt_tree_info info;
        const double edge = 2.0 / (double)resolution[k];
        double most = 0, sum = 0;
        uint64_t i = 0;
        uint32_t x, y, z, n = resolution[k];
        voxrt_tree_get_info(t, &info);
        CHECK(info.has_planes == 1 && info.plane_bytes == info.voxel_count);
        for (z = 0; z < n; z++)
            for (y = 0; y < n; y++)
                for (x = 0; x < n; x++) {
                    voxrt_voxel v;
                    double p[3], r = 0, e;
                    uint64_t code = voxrti_spread3(x) | voxrti_spread3(y) << 1 | voxrti_spread3(z) << 2, at;
                    uint32_t a, node = 0, w;
                    if (!voxrt_tree_get(t, t->depth, x, y, z, &v)) continue;
                    for (w = 0; w + 1 < t->wide; w++) { /* down to the leaf node */
                        const uint32_t slot = (uint32_t)(code >> 6 * (t->wide - 1 - w)) & 63u;
                        node = t->node[node].child +
                               voxrti_popcount64(t->node[node].mask & (((uint64_t)1 << slot) - 1));
                    }
                    at = voxrti_attr_index(t, 2 * t->wide, node, (uint32_t)code & 63u);
                    REQUIRE(at < info.voxel_count && t->plane[at] != 0);
                    p[0] = x + 0.5;
                    p[1] = y + 0.5;
                    p[2] = z + 0.5;
                    for (a = 0; a < 3; a++) {
                        p[a] += (double)v.normal[a] * ((double)t->plane[at] - 128.0) * VOXRTI_PLANE_STEP;
                        r += (p[a] * edge - 1) * (p[a] * edge - 1);
                    }
                    e = fabs(sqrt(r) - 0.9) / edge; /* of the foot of the plane, in voxels */
                    most = e > most ? e : most;
                    sum += e;
                    i++;
                }
        if (test_g.verbose)
            printf("     %u cells: planes are off by %.4f voxels, %.4f at most\n", n, sum / (double)i, most);
        CHECK(i == info.voxel_count && most < (k == 0 ? 0.06 : 0.03) && sum < 0.012 * (double)i);
        voxrt_tree_destroy(t);
    }
}

/* The nearest code, for distances of up to half of the diagonal; none where normals are at odds. */
TEST(codes_of_planes) {
    int32_t i;
    for (i = -140; i <= 140; i++) {
        uint32_t k;
        for (k = 0; k < 3; k++) {
            const double d = (i + (k == 0 ? -0.45 : k == 1 ? 0.0 : 0.45)) * VOXRTI_PLANE_STEP;
            voxrti_fragsum s;
            memset(&s, 0, sizeof s);
            s.s[VOXRTI_SUM_X] = 1000 * (32768 + 8000);
            s.s[VOXRTI_SUM_Y] = 1000 * (32768 - (k == 1 ? 1700 : 1800));
            s.s[VOXRTI_SUM_Z] = 1000 * 32768;
            s.s[VOXRTI_SUM_PLANE] = (uint64_t)(1000 * (32768 + 16384 * d));
            CHECK(voxrti_fragsum_plane(&s, 1e-3) == (k == 1 ? 0 : 128 + (i < -127 ? -127 : i > 127 ? 127 : i)));
        }
    }
}

TEST(sheets_and_insides_stay_cubes) {
    voxrt_tree *t, *shell;
    shape s;
    uint64_t i, none = 0;
    memset(&s, 0, sizeof s);
    shape_box(&s, 0.54, 0.3, 0.3, 0.545, 1.7, 1.6); /* both sides in the same voxels */
    t = planes_make(&s, 64, 1, 0);
    for (i = 0; i < t->voxel_count; i++) none += t->plane[i] == 0;
    CHECK(none * 10 > t->voxel_count * 8);
    voxrt_tree_destroy(t);
    shell = make_ball(64, 1, 60);
    shape_sphere(&s, 1, 1, 1, 0.9, 60);
    t = planes_make(&s, 64, 1, 1);
    for (i = 0, none = 0; i < t->voxel_count; i++) none += t->plane[i] == 0;
    CHECK(t->voxel_count > 3 * shell->voxel_count && none == t->voxel_count - shell->voxel_count);
    voxrt_tree_destroy(shell);
    voxrt_tree_destroy(t);
}

/* ---- rays against all cells one by one ---- */

typedef struct slow_cell { uint32_t c[3], level; double n[3], offset; int cube; } slow_cell;
typedef struct slow_list { slow_cell *v; size_t n, leaves; uint32_t level; const voxrt_tree *t; } slow_list;

static int slow_add(void *user, const voxrt_voxel *v, uint32_t index) {
    slow_list *l = (slow_list *)user;
    slow_cell *s = &l->v[l->n++];
    uint32_t a;
    (void)index;
    s->c[0] = v->x;
    s->c[1] = v->y;
    s->c[2] = v->z;
    s->level = l->level;
    for (a = 0; a < 3; a++) s->n[a] = (double)v->normal[a];
    s->cube = 1;
    if (l->level != l->t->depth) return 0;
    s->cube = l->t->plane[l->leaves] == 0; /* leaves come in the order of their attributes */
    s->offset = ((double)l->t->plane[l->leaves++] - 128.0) * VOXRTI_PLANE_STEP;
    return 0;
}

/* The cells of all levels, large ones first; cones meet the root only in trees of odd depth. */
static slow_list planes_slow_open(const voxrt_tree *t) {
    voxrt_tree_info info;
    slow_list l;
    uint64_t n = 0;
    memset(&l, 0, sizeof l);
    voxrt_tree_get_info(t, &info);
    for (l.level = 0; l.level <= t->depth; l.level++) n += info.level_count[l.level];
    l.v = (slow_cell *)calloc((size_t)n, sizeof *l.v);
    if (l.v == NULL) exit(1);
    l.t = t;
    for (l.level = (t->depth & 1u) ^ 1u; l.level <= t->depth; l.level++) voxrt_tree_each(t, l.level, slow_add, &l);
    return l;
}

static int slow_bad(const voxrt_ray *q) {
    uint32_t a;
    for (a = 0; a < 3; a++)
        if (!isfinite(q->org[a]) || !isfinite(q->dir[a])) return 1;
    return !(q->t_min <= q->t_max) || (q->dir[0] == 0 && q->dir[1] == 0 && q->dir[2] == 0);
}

/* When the ray o + t d is between lo and hi; 0: never. */
static int slow_slab(const double o[3], const double d[3], const double lo[3], const double hi[3], double *in, double *out) {
    uint32_t a;
    *in = -(double)INFINITY;
    *out = (double)INFINITY;
    for (a = 0; a < 3; a++) {
        double t0 = (lo[a] - o[a]) / d[a], t1 = (hi[a] - o[a]) / d[a];
        if (d[a] == 0) {
            if (!(lo[a] <= o[a] && o[a] < hi[a])) return 0;
            continue;
        }
        *in = fmax(*in, fmin(t0, t1));
        *out = fmin(*out, fmax(t0, t1));
    }
    return 1;
}

/* First cell along the ray that ends it, and when; -1: none. close: a decision was a matter of rounding. */
static double slow_trace(const slow_list *l, const voxrt_ray *q, const voxrt_trace_desc *desc, const slow_cell **cell, int *close) {
    const double edge = l->t->voxel_size;
    double best = -1, best_from = (double)INFINITY, o[3], d[3], box[2][3], box_in, box_out, speed = 0;
    size_t i;
    uint32_t a;
    *close = 0;
    *cell = NULL;
    if (slow_bad(q)) return -1;
    for (a = 0; a < 3; a++) { /* in voxels */
        o[a] = ((double)q->org[a] - l->t->origin[a]) / edge;
        d[a] = (double)q->dir[a] / edge;
        box[0][a] = l->t->cell_min[a];
        box[1][a] = l->t->cell_max[a];
        speed += d[a] * d[a];
    }
    speed = sqrt(speed);
    if (!slow_slab(o, d, box[0], box[1], &box_in, &box_out)) return -1;
    for (i = 0; i < l->n; i++) {
        const slow_cell *s = &l->v[i];
        const double size = (double)(1u << (l->t->depth - s->level));
        double lo[3], hi[3], in, out, from, at, away = 0;
        for (a = 0; a < 3; a++) {
            lo[a] = s->c[a] * size;
            hi[a] = lo[a] + size;
            away = fmax(away, fabs(o[a] - lo[a] - 0.5));
        }
        if (!slow_slab(o, d, lo, hi, &in, &out)) continue;
        in = at = fmax(in, (double)q->t_min);
        from = fmax(in, box_in);
        out = fmin(fmin(out, box_out), (double)q->t_max);
        if (out < from || from > best_from + 1e-7 / speed) continue;
        if ((out - from) * speed < 1e-5) *close = 1;
        if (from > best_from - 1e-7 / speed) continue;
        if (s->level != l->t->depth) {
            const double wide = ((double)desc->cone_width + (double)desc->cone_spread * in) / edge;
            if (fabs(wide - size) < 1e-5 * size) *close = 1;
            if (wide < size) continue;
        }
        if (!s->cube && !desc->cubes && away < 16777216) {
            double base = -s->offset, slope = 0, over = 0;
            for (a = 0; a < 3; a++) {
                base += s->n[a] * (o[a] - lo[a] - 0.5);
                slope += s->n[a] * d[a];
            }
            if (fabs(base + slope * in) < 1e-5) *close = 1;
            if (base + slope * in > 0) {
                if (!(slope < 0)) continue;
                at = -base / slope;
                for (a = 0; a < 3; a++) over = fmax(over, fabs(o[a] + at * d[a] - lo[a] - 0.5));
                if (fabs(over - 0.5) < 1e-5 || fabs(at - (double)q->t_max) * speed < 1e-5) *close = 1;
                if (over > 0.5 || at >= (double)q->t_max) continue;
            }
        }
        best = at;
        best_from = from;
        *cell = s;
    }
    return *cell != NULL ? best : -1;
}

/* To a point in the scene: tiles, origins in it, on borders of cells and far away, along axes; some are no rays. */
static voxrt_ray slow_ray(test_rng *r, uint32_t i) {
    static const float odd[3] = {NAN, INFINITY, -INFINITY};
    voxrt_ray q;
    uint32_t a;
    q.t_min = i % 5 == 0 ? test_rng_float(r) : i % 13 == 0 ? -2 * test_rng_float(r) : i % 29 == 0 ? -INFINITY : 0.0f;
    q.t_max = i % 7 == 0 ? 1.0f + test_rng_float(r) : INFINITY;
    for (a = 0; a < 3; a++) {
        const float to = test_rng_range(r, 0.3f, 1.7f);
        q.org[a] = i < 64 ? 3.0f + (float)a : i % 19 < 3 ? test_rng_range(r, 0.2f, 1.8f) : test_rng_range(r, -1.0f, 3.0f);
        if (i >= 64 && i % 17 < 2) q.org[a] = floorf(q.org[a] * 16) / 16;
        if (i >= 64 && i % 23 < 2) q.org[a] *= ldexpf(1.0f, 8 + (int)(i / 23 % 14));
        q.dir[a] = to - q.org[a];
    }
    if (i % 11 == 0) q.dir[i % 3] = i % 2 == 0 ? 0.0f : -0.0f;
    if (i % 22 == 0) q.dir[(i + 1) % 3] = 0;
    if (i % 97 == 1) (i % 2 == 0 ? q.org : q.dir)[i % 3] = odd[i % 3];
    if (i % 97 == 2) memset(q.dir, 0, sizeof q.dir);
    if (i % 97 == 3) q.t_min = i % 2 == 0 ? 2.5f : NAN;
    return q;
}

TEST(rays_end_where_slow_ones_do) {
    static const voxrt_isa isa[3] = {VOXRT_ISA_SCALAR, VOXRT_ISA_SSE, VOXRT_ISA_AVX2};
    static const float cone[4][2] = {{0, 0}, {0, 0.13f}, {0.06f, 0.25f}, {0, 0}}; /* a voxel is 0.0625 wide */
    enum { RAYS = 2000 };
    const uint32_t n = test_quick() ? RAYS / 3 : RAYS;
    voxrt_tree *t = make_mixed(32);
    slow_list l = planes_slow_open(t);
    static voxrt_ray ray[RAYS];
    static voxrt_hit hit[3][RAYS], cube[RAYS];
    uint32_t i, k, m;
    test_rng r = test_rng_make(5);
    for (i = 0; i < n; i++) ray[i] = slow_ray(&r, i);
    for (m = 0; m < 4; m++) { /* lines, cones, lines to cubes */
        uint32_t hits = 0, bad = 0, passed = 0, planes = 0, large = 0, unsure = 0;
        voxrt_trace_desc d;
        voxrt_stats stats[3];
        memset(&d, 0, sizeof d);
        memset(stats, 0, sizeof stats);
        d.cubes = 1;
        CHECK(voxrt_trace(t, &d, ray, cube, n) == VOXRT_OK);
        d.cubes = m == 3;
        d.cone_width = cone[m][0];
        d.cone_spread = cone[m][1];
        for (k = 0; k < 3; k++) {
            d.isa = isa[k];
            d.stats = &stats[k];
            CHECK(voxrt_trace(t, &d, ray, hit[k], n) == VOXRT_OK);
            CHECK(memcmp(hit[k], hit[0], n * sizeof hit[0][0]) == 0);
        }
        d.isa = VOXRT_ISA_AUTO;
        d.stats = NULL;
        for (i = 0; i < n; i++) {
            const voxrt_hit *h = &hit[0][i];
            const slow_cell *c;
            int close, same;
            const double at = slow_trace(&l, &ray[i], &d, &c, &close);
            const int is_hit = h->node != VOXRT_NO_NODE;
            voxrt_hit one;
            uint8_t dark;
            if (c == NULL) same = !is_hit;
            else same = is_hit && h->level == c->level && memcmp(h->cell, c->c, sizeof c->c) == 0 &&
                        fabs((double)h->t - at) < 2e-7 * fabs(at) + 1e-7 && h->plane <= !c->cube;
            CHECK_MSG(same || close, "ray %u, %u: t %.9g, is %.9g, level %u, plane %u", i, m, at, (double)h->t, (unsigned)h->level,
                      (unsigned)h->plane);
            unsure += !same;
            hits += (uint32_t)is_hit;
            bad += (uint32_t)slow_bad(&ray[i]);
            planes += h->plane;
            large += is_hit && h->level != t->depth;
            passed += cube[i].node != VOXRT_NO_NODE && memcmp(h->cell, cube[i].cell, sizeof cube[i].cell) != 0;
            CHECK(cube[i].plane == 0 && (h->plane == 0 || (is_hit && h->level == t->depth)));
            CHECK(!is_hit || (h->t >= ray[i].t_min && h->t < ray[i].t_max));
            CHECK(voxrt_occluded(t, &d, &ray[i], &dark, 1) == VOXRT_OK && dark == is_hit);
            if (m != 0) continue;
            CHECK(voxrt_trace1(t, &ray[i], &one) == is_hit && memcmp(&one, h, sizeof one) == 0); /* one by one the same */
            if (is_hit) { /* t_max is where rays end, to the last bit, as is the largest float */
                voxrt_ray q = ray[i];
                q.t_max = h->t;
                CHECK_MSG(!voxrt_trace1(t, &q, &one), "ray %u ends at %.9g, not before %.9g", i, (double)one.t, (double)h->t);
                q.t_max = nextafterf(h->t, INFINITY);
                CHECK(voxrt_trace1(t, &q, &one) && memcmp(&one, h, sizeof one) == 0);
            }
            if (is_hit && h->t > 1.01f * cube[i].t && cube[i].t > 0.1f) {
                voxrt_ray q = ray[i];
                uint32_t a;
                q.t_min = 0;
                q.t_max = INFINITY;
                for (a = 0; a < 3; a++) q.dir[a] *= 0.5f * (h->t + cube[i].t) / 3.4028235e38f;
                CHECK(voxrt_trace1(t, &q, &one) == isfinite(one.t));
            }
        }
        for (k = 0; k < 3; k++)
            CHECK_MSG(stats[k].rays == n && stats[k].hits == hits && stats[k].bad_rays == bad, "isa %u: %u hits, counted %u",
                      (unsigned)isa[k], hits, (unsigned)stats[k].hits);
        if (test_g.verbose)
            printf("     %u rays: %u hits, %u of planes, %u of large cells, %u passed by a voxel, %u unsure\n", n, hits, planes,
                   large, passed, unsure);
        CHECK(hits > n / 3 && bad > n / 100 && unsure < n / 100);
        CHECK(m == 3 ? planes == 0 : planes > n / 20 && passed > n / 10);
        CHECK(m == 1 || m == 2 ? large > n / 10 : large == 0);
    }
    free(l.v);
    voxrt_tree_destroy(t);
}

/* Four at a time with AVX2: the same bits, for plain and shared trees, runs of any length, with rays that are far away
   among them and without. */
TEST(many_rays_are_as_single_ones) {
    static const float cone[3][2] = {{0, 0}, {0, 0.13f}, {0.06f, 0.25f}}; /* a voxel is 0.0625 wide */
    enum { RAYS = 3000 };
    static voxrt_ray ray[2][RAYS];
    static voxrt_hit hit[2][RAYS];
    static float was[RAYS];
    voxrt_tree *t[2] = {make_mixed(32), NULL};
    uint32_t n[2] = {0, 0}, i, k, m, from, far_off = 0;
    test_rng r = test_rng_make(6);
    REQUIRE(voxrt_tree_share(t[0], NULL, &t[1]) == VOXRT_OK);
    for (i = 64; n[0] < RAYS; i++) {
        voxrt_ray q = slow_ray(&r, i);
        uint32_t a;
        int close;
        for (a = 0; i % 5 == 1 && a < 3; a++) { /* through edges and corners of voxels */
            q.org[a] = floorf(test_rng_range(&r, -8.0f, 40.0f)) / 16;
            q.dir[a] = q.org[a] > 1.9f ? -1.0f : q.org[a] < 0.1f ? 1.0f : (float)test_rng_below(&r, 3) - 1;
        }
        close = !slow_bad(&q);
        for (a = 0; a < 3; a++) close &= fabsf(q.org[a]) < 1000.0f;
        far_off += !close;
        ray[0][n[0]++] = q;
        if (close) ray[1][n[1]++] = q;
    }
    CHECK(far_off > RAYS / 50);
    for (k = 0; k < 2; k++) { /* the tree */
        for (m = 0; m < 7; m++) {
            const uint32_t near_by = m >= 3, all = n[near_by];
            voxrt_ray *q = ray[near_by];
            voxrt_trace_desc d;
            uint32_t count, planes = 0;
            memset(&d, 0, sizeof d);
            d.cone_width = cone[m % 3][0];
            d.cone_spread = cone[m % 3][1];
            d.isa = VOXRT_ISA_SCALAR;
            CHECK(voxrt_trace(t[k], &d, q, hit[0], all) == VOXRT_OK);
            if (m == 6) { /* they end where they met something, after they have entered its voxel */
                for (i = 0; i < all; i++) was[i] = q[i].t_max;
                for (i = 0; i < all; i++) q[i].t_max = hit[0][i].t;
                CHECK(voxrt_trace(t[k], &d, q, hit[0], all) == VOXRT_OK);
            }
            d.isa = VOXRT_ISA_AUTO;
            memset(hit[1], 255, sizeof hit[1]);
            for (from = 0, count = 1; from < all; from += count, count = count % 191 + 1) {
                if (count > all - from) count = all - from;
                CHECK(voxrt_trace(t[k], &d, q + from, hit[1] + from, count) == VOXRT_OK);
            }
            CHECK(memcmp(hit[0], hit[1], all * sizeof hit[0][0]) == 0);
            for (i = 0; i < all; i++) planes += hit[0][i].plane;
            CHECK(m == 6 || planes > all / 20);
            for (i = 0; m == 6 && i < all; i++) q[i].t_max = was[i];
        }
    }
    for (k = 0; k < 2; k++) voxrt_tree_destroy(t[k]);
}

/* A tree of 2^depth cells with any planes: through centres, from end to end, any bytes; along axes, diagonals, anywhere. */
static voxrt_tree *any_planes(test_rng *r, uint32_t depth, uint32_t style) {
    static const float axis[7][3] = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}, {1, 1, 1}};
    enum { CELLS = 400 };
    static voxrt_voxel v[CELLS];
    voxrt_tree *t = NULL;
    uint64_t k;
    uint32_t i, a;
    memset(v, 0, sizeof v);
    for (i = 0; i < CELLS; i++) {
        v[i].x = test_rng_below(r, 1u << depth);
        v[i].y = test_rng_below(r, 1u << depth);
        v[i].z = i & 1u ? (v[i].x + v[i].y) / 2 : test_rng_below(r, 1u << depth);
        v[i].has_normal = 1;
        for (a = 0; a < 3; a++) v[i].normal[a] = style < 2 ? axis[i % 7][a] : test_rng_range(r, -1.0f, 1.0f);
    }
    CHECK(voxrt_tree_from_voxels(NULL, v, depth == 1 ? 3 : CELLS, depth, &t) == VOXRT_OK);
    if (t == NULL) exit(1);
    t->plane = (uint8_t *)voxrti_alloc_array(&t->mem, (size_t)t->voxel_count, 1);
    if (t->plane == NULL) exit(1);
    for (k = 0; k < t->voxel_count; k++)
        t->plane[k] = (uint8_t)(style == 0 ? 128u : style == 1 ? 1u + 254u * test_rng_below(r, 2) : test_rng_below(r, 256));
    return t;
}

/* Whatever planes are, in trees of any size: the same bits by all instruction sets, shared and in pages; rays from within
   voxels, in planes, along edges. */
TEST(any_planes_by_all_ways) {
    enum { RAYS = 640 };
    static voxrt_ray ray[RAYS];
    static voxrt_hit hit[3][RAYS];
    test_rng r = test_rng_make(31);
    uint32_t n, i, k, a, planes = 0, passed = 0, inside = 0;
    for (n = 0; n < 18; n++) {
        const uint32_t depth = n < 15 ? 1 + n / 3 : 6;
        voxrt_tree *t = any_planes(&r, depth, n % 3), *shared = NULL;
        const float size = (float)(1u << depth);
        voxrt_trace_desc d;
        voxrt_save_desc sd;
        voxrt_paged_desc pd;
        voxrt_paged *paged = NULL;
        voxrt_geometry of[2];
        uint8_t *file;
        size_t bytes = 0;
        for (i = 0; i < RAYS; i++) {
            for (a = 0; a < 3; a++) {
                ray[i].org[a] = test_rng_range(&r, -0.5f, 1.5f) * size;
                if (i % 3 == 0) ray[i].org[a] = floorf(2 * ray[i].org[a]) / 2; /* centres, edges, corners */
                ray[i].dir[a] = test_rng_range(&r, 0.0f, 1.0f) * size - ray[i].org[a];
                if (i % 6 == 0) ray[i].dir[a] = (float)test_rng_below(&r, 3) - 1.0f;
            }
            ray[i].t_min = i % 7 == 0 ? test_rng_float(&r) : 0.0f;
            ray[i].t_max = i % 11 == 0 ? test_rng_float(&r) * 2 : INFINITY;
        }
        REQUIRE(voxrt_tree_share(t, NULL, &shared) == VOXRT_OK);
        memset(&d, 0, sizeof d);
        d.cone_spread = n % 4 == 3 ? 0.5f : 0.0f;
        d.isa = VOXRT_ISA_SCALAR;
        CHECK(voxrt_trace(t, &d, ray, hit[0], RAYS) == VOXRT_OK);
        d.isa = VOXRT_ISA_AUTO;
        CHECK(voxrt_trace(t, &d, ray, hit[1], RAYS) == VOXRT_OK);
        CHECK(memcmp(hit[0], hit[1], sizeof hit[0]) == 0);
        CHECK(voxrt_trace(shared, &d, ray, hit[1], RAYS) == VOXRT_OK);
        d.cubes = 1;
        CHECK(voxrt_trace(t, &d, ray, hit[2], RAYS) == VOXRT_OK);
        d.cubes = 0;
        for (i = 0; i < RAYS; i++) {
            hit[1][i].node = hit[0][i].node;
            CHECK((hit[2][i].t < INFINITY || !(hit[0][i].t < INFINITY)) && hit[0][i].t >= hit[2][i].t);
            planes += hit[0][i].plane;
            passed += hit[0][i].t > hit[2][i].t;
            inside += hit[0][i].plane != 0 && hit[0][i].face == 6;
        }
        CHECK(memcmp(hit[0], hit[1], sizeof hit[0]) == 0);
        memset(&sd, 0, sizeof sd);
        memset(&pd, 0, sizeof pd);
        sd.encoding = VOXRT_ENCODING_PAGED;
        REQUIRE(voxrt_tree_save_memory(t, &sd, NULL, 0, &bytes) == VOXRT_OK);
        file = (uint8_t *)malloc(bytes);
        REQUIRE(file != NULL && voxrt_tree_save_memory(t, &sd, file, bytes, &bytes) == VOXRT_OK);
        pd.data = file;
        pd.size = bytes;
        pd.wait = 1;
        REQUIRE(voxrt_paged_open(&pd, &paged) == VOXRT_OK);
        voxrt_tree_geometry(t, &of[0]);
        voxrt_paged_geometry(paged, &of[1]);
        for (i = 0; i < RAYS; i += 64) {
            voxrt_surface s[2][64];
            for (k = 0; k < 2; k++) {
                memset(s[k], 0, sizeof s[k]);
                for (a = 0; a < 64; a++) s[k][a].t = INFINITY;
                of[k].trace_fn(of[k].user, &d, ray + i, s[k], 64);
            }
            CHECK(memcmp(s[0], s[1], sizeof s[0]) == 0);
        }
        voxrt_paged_destroy(paged);
        free(file);
        voxrt_tree_destroy(shared);
        voxrt_tree_destroy(t);
    }
    if (test_g.verbose) printf("     %u planes met, %u voxels passed, %u rays began in what is solid\n", planes, passed, inside);
    CHECK(planes > 1000 && passed > 2000 && inside > 20);
}

/* A ray in a plane meets it where it comes into the voxel; one a little above it goes by; behind is solid. */
TEST(rays_in_planes) {
    static const struct { float z, org, t; uint32_t met, face; } go[6] = {
        {0.5f, -2, 2, 1, 0}, {0.4999f, -2, 0, 0, 0}, {0.5001f, -2, 2, 1, 0}, {0.5f, 0.25f, 0, 1, 6}, {0.25f, 0.25f, 0, 0, 0}, {0.75f, 0.25f, 0, 1, 6}};
    voxrt_voxel v;
    voxrt_tree *t = NULL;
    uint32_t i, k;
    memset(&v, 0, sizeof v);
    v.has_normal = 1;
    v.normal[2] = -1; /* codes have that one exactly */
    REQUIRE(voxrt_tree_from_voxels(NULL, &v, 1, 1, &t) == VOXRT_OK);
    t->plane = (uint8_t *)voxrti_alloc_array(&t->mem, 1, 1);
    REQUIRE(t->plane != NULL && t->voxel_count == 1);
    t->plane[0] = 128;
    for (i = 0; i < 6; i++)
        for (k = 0; k < 2; k++) {
            voxrt_ray ray[8];
            voxrt_hit hit[8];
            voxrt_trace_desc d;
            uint32_t j;
            memset(&d, 0, sizeof d);
            memset(ray, 0, sizeof ray);
            d.isa = k == 0 ? VOXRT_ISA_SCALAR : VOXRT_ISA_AUTO;
            for (j = 0; j < 8; j++) {
                ray[j].org[0] = go[i].org;
                ray[j].org[1] = 0.5f;
                ray[j].org[2] = go[i].z;
                ray[j].dir[0] = 1;
                ray[j].t_max = INFINITY;
            }
            CHECK(voxrt_trace(t, &d, ray, hit, 8) == VOXRT_OK);
            for (j = 0; j < 8; j++)
                CHECK_MSG((hit[j].node != VOXRT_NO_NODE) == go[i].met &&
                          (!go[i].met || (hit[j].t == go[i].t && hit[j].plane == 1 && hit[j].face == go[i].face)),
                          "case %u: t %.9g", i, (double)hit[j].t);
        }
    voxrt_tree_destroy(t);
}

/* Rays without a beginning that are so slow that they entered long before any float: they start at the first one. */
TEST(times_are_finite) {
    enum { RAYS = 96 };
    static const float speed[4] = {1e-38f, 4e-39f, -4e-39f, 1e-43f};
    voxrt_tree *t = make_ball(32, 1, 60);
    uint32_t k, i, n = 0, m;
    for (k = 0; k < 8; k++) {
        voxrt_ray ray[RAYS];
        voxrt_hit hit[2][RAYS], one;
        voxrt_trace_desc d;
        memset(&d, 0, sizeof d);
        d.cone_width = k < 4 ? 0.0f : 0.2f;
        for (i = 0; i < RAYS; i++) {
            ray[i].org[0] = 1.0f + 0.02f * (float)i;
            ray[i].org[1] = 1.0f + (i & 1u ? 0.01f * (float)i : 0.0f);
            ray[i].org[2] = 1.0f;
            ray[i].dir[0] = speed[k & 3u];
            ray[i].dir[1] = ray[i].dir[2] = 0;
            ray[i].t_min = -INFINITY;
            ray[i].t_max = i % 3 == 0 ? 1e37f : INFINITY;
        }
        for (m = 0; m < 2; m++) {
            d.isa = m == 0 ? VOXRT_ISA_SCALAR : VOXRT_ISA_AUTO;
            CHECK(voxrt_trace(t, &d, ray, hit[m], RAYS) == VOXRT_OK);
        }
        CHECK(memcmp(hit[0], hit[1], sizeof hit[0]) == 0);
        for (i = 0; i < RAYS; i++) {
            CHECK((hit[0][i].node == VOXRT_NO_NODE) == (hit[0][i].t == INFINITY) && hit[0][i].t >= -3.4028235e38f);
            n += hit[0][i].t == -3.4028235e38f;
            if (k < 4) CHECK(voxrt_trace1(t, &ray[i], &one) == (hit[0][i].t < INFINITY) && memcmp(&one, &hit[0][i], sizeof one) == 0);
        }
    }
    CHECK(n > 10);
    voxrt_tree_destroy(t);
}

/* A roof whose two sides meet at an angle: on the ridge a plane stands for both if it is wide, none does if it is sharp. */
TEST(sharp_ridges_are_cubes) {
    static const double half[2] = {0.3490658504, 0.6981317008}; /* 40 and 80 degrees between the sides */
    uint32_t k, side, n = 0;
    for (k = 0; k < 2; k++) {
        const double across = 0.5 * sin(half[k]), down = 0.5 * cos(half[k]);
        voxrt_tree *t;
        voxrt_voxel v;
        shape s;
        slow_list l;
        size_t i;
        memset(&s, 0, sizeof s);
        memset(&l, 0, sizeof l);
        for (side = 0; side < 2; side++) { /* the ridge goes through the middle of voxels */
            const double x = 65.0 / 64, z = 97.0 / 64, foot = x + (side ? across : -across);
            const uint32_t a = shape_vertex(&s, x, 0.3, z), b = shape_vertex(&s, x, 1.7, z);
            const uint32_t c = shape_vertex(&s, foot, 0.3, z - down), e = shape_vertex(&s, foot, 1.7, z - down);
            shape_triangle(&s, a, side ? c : b, side ? b : c);
            shape_triangle(&s, b, side ? c : e, side ? e : c);
        }
        free(s.normal);
        s.normal = NULL;
        t = planes_make(&s, 64, 1, 0);
        l = planes_slow_open(t);
        for (i = 0, n = 0; i < l.n; i++) {
            if (l.v[i].level != t->depth || l.v[i].c[0] != 32 || l.v[i].c[2] != 48 || l.v[i].c[1] < 12 || l.v[i].c[1] > 52) continue;
            CHECK(l.v[i].cube == (k == 0));
            n++;
        }
        CHECK(n == 41 && voxrt_tree_get(t, 6, 32, 30, 48, &v));
        free(l.v);
        voxrt_tree_destroy(t);
    }
}

TEST(same_voxels_and_planes_by_all_ways) {
    static const voxrt_separating as[3] = {VOXRT_SEPARATING_26, VOXRT_SEPARATING_26, VOXRT_SEPARATING_THESIS};
    voxrt_build_desc d;
    voxrt_mesh m;
    voxrt_tree *t[3] = {NULL, NULL, NULL};
    uint64_t i, none = 0;
    uint32_t k;
    shape s;
    memset(&s, 0, sizeof s);
    memset(&d, 0, sizeof d);
    shape_sphere(&s, 1, 1, 1, 0.9, 60);
    m = mesh_of(&s);
    d.resolution = 64;
    d.box_size = 2;
    for (k = 0; k < 3; k++) { /* what a voxel is does not depend on planes, but that 6 is 26 */
        d.planes = 1;
        d.separating = (voxrt_separating)k;
        REQUIRE(voxrt_tree_build(&d, &m, NULL, &t[0]) == VOXRT_OK);
        d.planes = 0;
        d.separating = as[k];
        REQUIRE(voxrt_tree_build(&d, &m, NULL, &t[1]) == VOXRT_OK);
        CHECK(t[0]->plane != NULL && t[1]->plane == NULL && t[0]->voxel_count == t[1]->voxel_count);
        CHECK(memcmp(t[0]->leaf, t[1]->leaf, 8 * (size_t)t[0]->level_nodes[2]) == 0);
        CHECK(memcmp(t[0]->normal, t[1]->normal, 2 * t[0]->attr_count) == 0);
        voxrt_tree_destroy(t[0]);
        voxrt_tree_destroy(t[1]);
    }
    d.planes = 1;
    d.separating = VOXRT_SEPARATING_6;
    for (k = 0; k < 3; k++) {
        d.env.thread_count = k == 1 ? 4 : 1;
        d.fill_depth = k == 2 ? 2 : 0; /* the shell's planes, and cubes below it */
        d.fill = k == 2;
        REQUIRE(voxrt_tree_build(&d, &m, NULL, &t[k]) == VOXRT_OK);
    }
    CHECK(voxrt_tree_hash(t[0]) == voxrt_tree_hash(t[1]));
    for (i = 0; i < t[2]->voxel_count; i++) none += t[2]->plane[i] == 0;
    CHECK(none > 0 && none == t[2]->voxel_count - t[0]->voxel_count);
    {
        slow_list shell = planes_slow_open(t[0]), thick = planes_slow_open(t[2]);
        size_t at = 0;
        for (i = 0; i < thick.n; i++) {
            const slow_cell *c = &thick.v[i];
            if (c->level != t[0]->depth || c->cube) continue;
            while (at < shell.n && (shell.v[at].level != c->level || memcmp(shell.v[at].c, c->c, sizeof c->c) != 0)) at++;
            REQUIRE(at < shell.n);
            CHECK(shell.v[at].offset == c->offset);
        }
        free(shell.v);
        free(thick.v);
    }
    for (k = 0; k < 3; k++) voxrt_tree_destroy(t[k]);
    shape_free(&s);
}

/* Whatever the planes leave open between them, no ray gets through a closed shell, from outside or inside. */
TEST(closed_shells_keep_all_rays) {
    const uint32_t rays = test_quick() ? 20000 : 200000;
    voxrt_tree *t = make_ball(64, 1, 90);
    test_rng r = test_rng_make(9);
    uint32_t i, a, out = 0, in = 0;
    double most = 0;
    for (i = 0; i < rays; i++) {
        double u[3], l = 0;
        voxrt_ray q;
        voxrt_hit h;
        memset(&q, 0, sizeof q);
        q.t_max = INFINITY;
        for (a = 0; a < 3; a++) { /* to corners and edges of cells as often as to anything */
            u[a] = (double)test_rng_range(&r, -1, 1);
            if (i & 1u) u[a] = (floor(u[a] * 32) / 32);
            l += u[a] * u[a];
        }
        if (l < 0.01) continue;
        for (a = 0; a < 3; a++) {
            q.org[a] = 1;
            q.dir[a] = (float)u[a];
        }
        in += !voxrt_trace1(t, &q, &h);
        for (a = 0; a < 3; a++) {
            q.org[a] = (float)(1 + 4 * u[a] / sqrt(l));
            q.dir[a] = (float)(-u[a] / sqrt(l)) + test_rng_range(&r, -0.1f, 0.1f);
        }
        {   /* towards the inner 0.85: must meet the shell at the ball's surface */
            double oo = 0, od = 0, dd = 0, e;
            for (a = 0; a < 3; a++) {
                const double o = (double)q.org[a] - 1, d = (double)q.dir[a];
                oo += o * o;
                od += o * d;
                dd += d * d;
            }
            if (od * od - dd * (oo - 0.85 * 0.85) <= 0) continue;
            if (!voxrt_trace1(t, &q, &h)) {
                out++;
                continue;
            }
            e = fabs(-od - sqrt(od * od - dd * (oo - 0.81)) - (double)h.t * dd) / sqrt(dd) * 32;
            most = e > most ? e : most;
        }
    }
    if (test_g.verbose) printf("     %u rays each way; depth is off by %.3f voxels at most\n", rays, most);
    CHECK(in == 0 && out == 0 && most < 0.75);
    voxrt_tree_destroy(t);
}

/* ---- files, shared trees, failures ---- */

/* A version 5 file without one of its sections and its flag. Returns the size. */
static size_t cut_section(const uint8_t *from, uint8_t *to, uint32_t id, uint32_t flag) {
    const uint32_t n = from[14];
    uint32_t i, left = 0;
    size_t at = 64 + 40 * (size_t)(n - 1);
    memcpy(to, from, 64);
    memset(to + 64, 0, at - 64);
    for (i = 0; i < n; i++) {
        const uint8_t *e = from + 64 + 40 * i;
        uint8_t *out = to + 64 + 40 * left;
        const size_t begin = (size_t)voxrti_v5_align(at), size = (size_t)voxrti_load_u64(e + 16);
        if (e[0] == id) continue;
        memset(to + at, 0, begin - at);
        memcpy(to + begin, from + (size_t)voxrti_load_u64(e + 8), size);
        memcpy(out, e, 40);
        voxrti_store_u64(out + 8, begin);
        at = begin + size;
        left++;
    }
    to[14] = (uint8_t)left;
    to[32] = (uint8_t)(to[32] & ~flag);
    voxrti_store_u64(to + 16, at);
    voxrti_v5_seal(to, at);
    return at;
}

static voxrt_result try_file(uint8_t *file, size_t size, voxrt_tree **tree) {
    voxrti_v5_seal(file, size);
    return voxrt_tree_load_memory(NULL, file, size, tree);
}

/* Files of all four kinds, as they are and as they must not be. */
static void check_file(const voxrt_tree *t, const voxrt_tree *from, int raw, const voxrt_ray *ray, const voxrt_hit *hit, size_t n) {
    voxrt_save_desc sd;
    voxrt_tree *back = NULL;
    voxrt_hit again[512];
    uint8_t *memory, *file, *other, *e;
    size_t size, less, i, k;
    memset(&sd, 0, sizeof sd);
    sd.encoding = raw ? VOXRT_ENCODING_RAW : VOXRT_ENCODING_COMPACT;
    CHECK(voxrt_tree_save_memory(from, &sd, NULL, 0, &size) == VOXRT_OK);
    memory = (uint8_t *)malloc(2 * size + 192);
    REQUIRE(memory != NULL && n <= 512);
    file = memory + (64 - ((uintptr_t)memory & 63u));
    other = file + size + 64 - (size & 63u);
    CHECK(voxrt_tree_save_memory(from, &sd, file, size, &size) == VOXRT_OK);
    for (k = 0; k < (raw ? 2u : 1u); k++) {
        CHECK((k == 0 ? voxrt_tree_load_memory(NULL, file, size, &back) : voxrt_tree_map_memory(NULL, file, size, &back)) == VOXRT_OK);
        REQUIRE(back != NULL);
        CHECK(voxrt_tree_hash(back) == voxrt_tree_hash(t));
        CHECK(voxrt_trace(back, NULL, ray, again, n) == VOXRT_OK);
        for (i = 0; i < n; i++) CHECK(again[i].t == hit[i].t && again[i].plane == hit[i].plane);
        voxrt_tree_destroy(back);
    }
    for (e = file + 64; e[0] != 13; e += 40) REQUIRE(e < file + 64 + 40 * (size_t)file[14]);
    for (k = 0; k < 6; k++) { /* wrong counts, sizes, flag; twice the section before; unknown, coded */
        uint8_t old[40];
        const uint8_t flag = file[32];
        memcpy(old, e, 40);
        if (k < 2) voxrti_store_u64(e + 24, voxrti_load_u64(e + 24) + (k == 0 ? 1 : (uint64_t)-1));
        if (k == 2) file[32] ^= 32;
        if (k == 3) e[0] = e[-40];
        if (k == 4) e[0] = 99;
        if (k == 5) e[4] = 1;
        CHECK_MSG(try_file(file, size, &back) == (k < 4 ? VOXRT_ERR_FORMAT : VOXRT_ERR_VERSION) && back == NULL, "%u", (unsigned)k);
        memcpy(e, old, 40);
        file[32] = flag;
    }
    less = cut_section(file, other, 7, 2); /* planes without normals */
    CHECK(try_file(other, less, &back) == VOXRT_ERR_FORMAT && back == NULL);
    less = cut_section(file, other, 13, 32);
    CHECK(try_file(other, less, &back) == VOXRT_OK && back != NULL && back->plane == NULL);
    voxrt_tree_destroy(back);
    sd.disable_normals = 1; /* no planes either */
    CHECK(voxrt_tree_save_memory(from, &sd, other, size, &less) == VOXRT_OK && less < size);
    CHECK(try_file(other, less, &back) == VOXRT_OK && back != NULL && back->plane == NULL && back->normal == NULL);
    voxrt_tree_destroy(back);
    file[32] |= 8; /* normals that mean something else, and any bytes for planes: rays still end somewhere */
    for (i = 0; i < voxrti_load_u64(e + 16); i++) file[voxrti_load_u64(e + 8) + i] = (uint8_t)(i * 2654435761u >> 13);
    CHECK(try_file(file, size, &back) == VOXRT_OK);
    REQUIRE(back != NULL);
    CHECK(voxrt_trace(back, NULL, ray, again, n) == VOXRT_OK);
    for (i = 0, k = 0; i < n; i++) {
        CHECK((again[i].node == VOXRT_NO_NODE) == (again[i].t == INFINITY) && again[i].t >= 0);
        k += again[i].t < INFINITY && again[i].t != hit[i].t;
    }
    CHECK(k > n / 10);
    voxrt_tree_destroy(back);
    free(memory);
}

TEST(files_and_shared_trees_keep_planes) {
    enum { RAYS = 512 };
    voxrt_tree *t = make_mixed(96), *other[2] = {NULL, NULL};
    voxrt_tree_info info;
    voxrt_ray ray[RAYS];
    voxrt_hit hit[RAYS], again[RAYS];
    test_rng r = test_rng_make(3);
    uint32_t i, k, a;
    for (i = 0; i < RAYS; i++) {
        ray[i].t_min = 0;
        ray[i].t_max = INFINITY;
        for (a = 0; a < 3; a++) {
            ray[i].org[a] = test_rng_range(&r, -1.0f, 3.0f);
            ray[i].dir[a] = test_rng_range(&r, 0.3f, 1.7f) - ray[i].org[a];
        }
    }
    CHECK(voxrt_trace(t, NULL, ray, hit, RAYS) == VOXRT_OK);
    CHECK(voxrt_tree_share(t, NULL, &other[0]) == VOXRT_OK);
    CHECK(voxrt_tree_unshare(other[0], NULL, &other[1]) == VOXRT_OK);
    REQUIRE(other[0] != NULL && other[1] != NULL);
    CHECK(memcmp(other[1]->plane, t->plane, t->voxel_count) == 0);
    for (k = 0; k < 2; k++) {
        CHECK(voxrt_trace(other[k], NULL, ray, again, RAYS) == VOXRT_OK);
        for (i = 0; i < RAYS; i++) CHECK(again[i].t == hit[i].t && again[i].plane == hit[i].plane);
        voxrt_tree_get_info(other[k], &info);
        CHECK(info.plane_bytes == (k == 0 ? other[0]->attr_count : t->voxel_count) && info.has_planes == 1);
        CHECK(info.total_bytes == info.geometry_bytes + info.color_bytes + info.normal_bytes + info.plane_bytes + sizeof *t);
        check_file(t, t, (int)k, ray, hit, RAYS);
        check_file(t, other[0], (int)k, ray, hit, RAYS);
    }
    CHECK(voxrt_tree_hash(other[0]) == voxrt_tree_hash(t) && voxrt_tree_hash(other[1]) == voxrt_tree_hash(t));
    t->plane[t->voxel_count / 2] ^= 1;
    CHECK(voxrt_tree_hash(other[0]) != voxrt_tree_hash(t));
    for (k = 0; k < 2; k++) voxrt_tree_destroy(other[k]);
    voxrt_tree_destroy(t);
}

/* Octrees keep the voxels of a tree with planes, as cubes; pictures can be asked to do so, too. */
TEST(what_keeps_no_planes) {
    enum { W = 64 };
    static voxrt_hit hits[2][W * W], octree_hits[W * W];
    voxrt_tree *t = make_ball(32, 1, 60), *back = NULL;
    voxrt_octree *octree = NULL;
    voxrt_render_desc d;
    voxrt_image m;
    static voxrt_ray ray[W * W];
    uint32_t i, planes[2] = {0, 0}, n = 0;
    CHECK(voxrt_octree_from_tree(NULL, t, &octree) == VOXRT_OK);
    REQUIRE(octree != NULL && voxrt_tree_from_octree(NULL, octree, &back) == VOXRT_OK);
    CHECK(back->plane == NULL && back->voxel_count == t->voxel_count && back->normal != NULL);
    CHECK(memcmp(back->leaf, t->leaf, 8 * (size_t)t->level_nodes[t->wide - 1]) == 0);
    memset(&d, 0, sizeof d);
    memset(&m, 0, sizeof m);
    m.width = m.height = W;
    d.camera.eye[0] = d.camera.eye[1] = 3;
    d.camera.eye[2] = 4;
    d.camera.at[0] = d.camera.at[1] = d.camera.at[2] = 1;
    for (d.cubes = 0; d.cubes < 2; d.cubes++) {
        m.hit = hits[d.cubes];
        CHECK(voxrt_render(&d, t, &m, NULL) == VOXRT_OK);
        for (i = 0; i < W * W; i++) planes[d.cubes] += m.hit[i].plane;
    }
    CHECK(planes[0] > W * W / 10 && planes[1] == 0);
    m.hit = hits[0];
    CHECK(voxrt_render(&d, back, &m, NULL) == VOXRT_OK);
    for (i = 0; i < W * W; i++) {
        CHECK(hits[0][i].t == hits[1][i].t && memcmp(hits[0][i].cell, hits[1][i].cell, 12) == 0);
        CHECK(voxrt_camera_ray(&d.camera, W, W, i % W + 0.5, i / W + 0.5, &ray[i]) == VOXRT_OK);
    }
    CHECK(voxrt_octree_trace(octree, NULL, ray, octree_hits, W * W) == VOXRT_OK);
    for (i = 0; i < W * W; i++) {
        CHECK(octree_hits[i].plane == 0);
        n += octree_hits[i].node != VOXRT_NO_NODE;
    }
    CHECK(n > W * W / 10);
    voxrt_octree_destroy(octree);
    voxrt_tree_destroy(back);
    voxrt_tree_destroy(t);
}

/* Normals (as they are) and planes of all voxels of a tree of 128^3 cells: 16 bytes each, zeros where nothing is. */
static float (*all_planes(const voxrt_tree *t))[4] {
    slow_list l = planes_slow_open(t);
    float (*v)[4] = (float (*)[4])calloc(128 * 128 * 128, sizeof *v);
    size_t i;
    uint32_t a;
    if (v == NULL) exit(1);
    for (i = 0; i < l.n; i++) {
        const slow_cell *c = &l.v[i];
        float *to = v[c->c[0] + 128 * (c->c[1] + 128 * c->c[2])];
        if (c->level != t->depth) continue;
        for (a = 0; a < 3; a++) to[a] = (float)c->n[a];
        to[3] = c->cube ? -1000.0f : (float)c->offset;
    }
    free(l.v);
    return v;
}

/* Lines and cones from all around meet in a model what they meet in the tree that it was made of. */
static void rays_meet_the_same(const voxrt_tree *t, const voxrt_model *model) {
    static const float cone[3] = {0.0f, 0.3f, 2.5f}; /* lines, cells of 16 voxels, the root */
    enum { RAYS = 64 };
    voxrt_geometry own, blocks;
    voxrt_trace_desc td;
    voxrt_ray ray[RAYS];
    voxrt_surface want[RAYS], got[RAYS];
    size_t i, planes = 0, spread[3] = {0, 0, 0};
    uint32_t a, k;
    test_rng r = test_rng_make(17);
    memset(&td, 0, sizeof td);
    voxrt_tree_geometry(t, &own);
    voxrt_model_geometry(model, &blocks);
    for (k = 0; k < 3; k++) {
        td.cone_width = cone[k];
        for (i = 0; i < RAYS; i++) {
            for (a = 0; a < 3; a++) {
                ray[i].org[a] = test_rng_range(&r, -1.0f, 3.0f);
                ray[i].dir[a] = test_rng_range(&r, 0.3f, 1.7f) - ray[i].org[a];
            }
            ray[i].t_min = 0;
            ray[i].t_max = INFINITY;
            want[i].t = got[i].t = INFINITY;
        }
        own.trace_fn(own.user, &td, ray, want, RAYS);
        blocks.trace_fn(blocks.user, &td, ray, got, RAYS);
        for (i = 0; i < RAYS; i++) {
            if (k == 0) CHECK(got[i].t == want[i].t && got[i].plane == want[i].plane);
            if (k == 0) CHECK(memcmp(got[i].normal, want[i].normal, sizeof want[i].normal) == 0);
            planes += want[i].plane;
            if (!(got[i].t < INFINITY) || got[i].edge != want[i].edge || (k < 2 && got[i].t != want[i].t)) continue;
            CHECK(got[i].spread == want[i].spread);
            spread[k] += want[i].spread > 0;
        }
    }
    if (test_g.verbose) printf("     %u planes, spread of %u, %u, %u\n", (unsigned)planes, (unsigned)spread[0], (unsigned)spread[1], (unsigned)spread[2]);
    CHECK(planes > RAYS / 2 && spread[0] == 0 && spread[1] > RAYS / 2 && spread[2] > RAYS / 2);
}

/* Planes of 128 cells an edge before and after a box was painted, one cleared, one set and a ball put in. */
static void planes_after_edits(const float (*was)[4], const float (*now)[4]) {
    size_t i, cubes = 0, turned = 0, ball = 0, gone = 0, rim = 0;
    uint32_t a;
    for (i = 0; i < 128 * 128 * 128; i++) {
        const double p[3] = {(double)(i % 128) + 0.5, (double)(i / 128 % 128) + 0.5, (double)(i / 16384) + 0.5};
        double away = 0, foot = 0;
        if (now[i][3] == 0 && was[i][3] == 0) continue;
        for (a = 0; a < 3; a++) away += (p[a] / 64 - (a < 2 ? 1 : 0.6)) * (p[a] / 64 - (a < 2 ? 1 : 0.6));
        if (fabs(sqrt(away) - 0.3) < 0.05) { /* the ball of the mesh */
            for (a = 0; a < 3; a++) {
                const double q = (p[a] + (double)(now[i][a] * now[i][3])) / 64 - (a < 2 ? 1 : 0.6);
                foot += q * q;
            }
            CHECK(now[i][3] > -1 && fabs(sqrt(foot) - 0.3) * 64 < 0.05);
            ball++;
        } else if (now[i][3] == 0) {
            gone++;
        } else if (was[i][3] == 0) {
            CHECK(now[i][3] < -1);
            cubes++;
        } else {
            const int same = memcmp(now[i], was[i], 12) == 0;
            CHECK(now[i][3] == was[i][3] && (same || was[i][3] < -1));
            turned += !same;
            rim += was[i][3] > -1 && p[2] > 64 && (p[0] < 58 ? p[0] > 57 : p[0] < 84) && p[1] > 57 && p[1] < 77;
        }
    }
    CHECK(ball > 3000 && gone > 200 && turned > 100 && turned < 2000 && rim > 10 && cubes > 1000);
    if (test_g.verbose) printf("     %u of the ball, %u gone, %u turned, %u on a rim, %u new cubes\n", (unsigned)ball, (unsigned)gone, (unsigned)turned,
                               (unsigned)rim, (unsigned)cubes);
}

/* Models keep planes and spread: rays meet what they meet in the tree, which comes back; painting changes none, clearing
   none of what is left, what was inside turns into the hole, boxes are cubes, and triangles have planes of their own. */
TEST(edits_keep_planes) {
    static const double lo[3] = {0.9, 0.9, 1.0}, hi[3] = {1.3, 1.2, 2.0}, box[3] = {0.02, 0.02, 0.02}, box_end[3] = {0.2, 0.2, 0.2};
    voxrt_build_desc d;
    voxrt_edit_desc e;
    voxrt_mesh m;
    voxrt_model *first = NULL, *model = NULL;
    voxrt_tree *t = NULL, *back = NULL;
    float (*was)[4], (*now)[4];
    shape s;
    memset(&s, 0, sizeof s);
    memset(&d, 0, sizeof d);
    memset(&e, 0, sizeof e);
    shape_sphere(&s, 1, 1, 1, 0.9, 100);
    m = mesh_of(&s);
    d.resolution = 128;
    d.box_size = 2;
    d.planes = 1;
    d.spread = 1;
    d.fill = 1;
    d.fill_depth = 3;
    REQUIRE(voxrt_tree_build(&d, &m, NULL, &t) == VOXRT_OK && voxrt_model_from_tree(NULL, t, &first) == VOXRT_OK);
    shape_free(&s);
    REQUIRE(voxrt_model_copy(NULL, first, &model) == VOXRT_OK);
    voxrt_model_destroy(first);
    REQUIRE(voxrt_tree_from_model(&d, model, &back) == VOXRT_OK);
    CHECK(voxrt_tree_hash(back) == voxrt_tree_hash(t));
    voxrt_tree_destroy(back);
    rays_meet_the_same(t, model);
    was = all_planes(t);
    voxrt_tree_destroy(t);
    e.op = VOXRT_EDIT_PAINT;
    CHECK(voxrt_model_box(model, &e, box_end, hi, NULL) == VOXRT_OK);
    e.op = VOXRT_EDIT_CLEAR;
    CHECK(voxrt_model_box(model, &e, lo, hi, NULL) == VOXRT_OK);
    e.op = VOXRT_EDIT_SET;
    CHECK(voxrt_model_box(model, &e, box, box_end, NULL) == VOXRT_OK);
    shape_sphere(&s, 1, 1, 0.6, 0.3, 60);
    m = mesh_of(&s);
    CHECK(voxrt_model_mesh(model, &e, &m, NULL) == VOXRT_OK);
    shape_free(&s);
    REQUIRE(voxrt_tree_from_model(NULL, model, &t) == VOXRT_OK && t->plane != NULL && t->spread == NULL);
    now = all_planes(t);
    planes_after_edits((const float (*)[4])was, (const float (*)[4])now);
    free(was);
    free(now);
    voxrt_tree_destroy(t);
    d.spread = 0;
    d.disable_normals = 1;
    d.planes = 0;
    REQUIRE(voxrt_tree_from_model(&d, model, &t) == VOXRT_OK);
    CHECK(t->plane == NULL && t->normal == NULL);
    voxrt_tree_destroy(t);
    voxrt_model_destroy(model);
}

/* Copies of a tree, twice as large, in a group: what rays meet is the same. */
TEST(instances_have_planes) {
    enum { RAYS = 64 };
    voxrt_tree *t = make_ball(32, 1, 60);
    voxrt_instance copy[2];
    voxrt_geometry own, all[2], together;
    voxrt_group *group = NULL;
    voxrt_trace_desc d;
    voxrt_ray ray[RAYS], far_ray[RAYS];
    voxrt_surface want[RAYS], got[RAYS];
    test_rng r = test_rng_make(8);
    uint32_t i, a, k, planes = 0;
    voxrt_tree_geometry(t, &own);
    memset(copy, 0, sizeof copy);
    memset(&d, 0, sizeof d);
    for (k = 0; k < 2; k++) {
        copy[k].geometry = own;
        for (a = 0; a < 3; a++) copy[k].to_world[5 * a] = 2;
        copy[k].to_world[3] = 16.0 * k;
        REQUIRE(voxrt_instance_geometry(&copy[k], &all[k]) == VOXRT_OK);
    }
    REQUIRE(voxrt_group_create(NULL, all, 2, &group) == VOXRT_OK);
    voxrt_group_geometry(group, &together);
    for (i = 0; i < RAYS; i++) {
        ray[i].t_min = 0;
        ray[i].t_max = INFINITY;
        for (a = 0; a < 3; a++) { /* numbers that stay as they are when they are moved */
            ray[i].org[a] = floorf(test_rng_range(&r, -3, 5) * 4096) / 4096;
            ray[i].dir[a] = test_rng_range(&r, 0.3f, 1.7f) - ray[i].org[a];
        }
    }
    for (k = 0; k < 2; k++) {
        for (i = 0; i < RAYS; i++) {
            far_ray[i] = ray[i];
            for (a = 0; a < 3; a++) {
                far_ray[i].org[a] = 2 * ray[i].org[a] + (a == 0 ? 16.0f * (float)k : 0.0f);
                far_ray[i].dir[a] = 2 * ray[i].dir[a];
            }
            far_ray[i].t_max = ray[i].t_max = 1.5f; /* not as far as the other one */
        }
        own.trace_fn(own.user, &d, ray, want, RAYS);
        for (i = 0; i < RAYS; i++) got[i].t = INFINITY;
        together.trace_fn(together.user, &d, far_ray, got, RAYS);
        for (i = 0; i < RAYS; i++) {
            CHECK(got[i].t == want[i].t);
            if (!(want[i].t < INFINITY)) continue;
            planes += want[i].plane;
            CHECK(got[i].plane == want[i].plane && got[i].edge == 2 * want[i].edge);
            for (a = 0; a < 3; a++) CHECK(fabsf(got[i].normal[a] - want[i].normal[a]) < 1e-6f);
        }
    }
    CHECK(planes > RAYS / 2);
    voxrt_group_destroy(group);
    voxrt_tree_destroy(t);
}

TEST(arguments_and_failures) {
    voxrt_build_desc d;
    voxrt_mesh m;
    voxrt_error error;
    voxrt_tree *t = NULL;
    shape s;
    int64_t k, n = 1;
    memset(&s, 0, sizeof s);
    memset(&d, 0, sizeof d);
    shape_sphere(&s, 1, 1, 1, 0.9, 12);
    m = mesh_of(&s);
    m.normals = NULL;
    d.resolution = 16;
    d.planes = 1;
    d.fill = 1;
    d.disable_normals = 1;
    d.env.error = &error;
    CHECK(voxrt_tree_build(&d, &m, NULL, &t) == VOXRT_ERR_INVALID_ARG && t == NULL && error.text[0] != 0);
    d.disable_normals = 0;
    d.env.thread_count = 1;
    for (k = 0; k < n; k++) { /* the n-th allocation fails, in building, sharing and undoing that */
        test_alloc ta;
        voxrt_tree *shared = NULL, *back = NULL;
        voxrt_result result;
        test_alloc_init(&ta);
        ta.fail_at = k;
        d.env.allocator.alloc_fn = test_alloc_fn;
        d.env.allocator.free_fn = test_free_fn;
        d.env.allocator.user = &ta;
        result = voxrt_tree_build(&d, &m, NULL, &t);
        if (result == VOXRT_OK) result = voxrt_tree_share(t, &d.env, &shared);
        if (result == VOXRT_OK) result = voxrt_tree_unshare(shared, &d.env, &back);
        CHECK(result == (ta.count > k ? VOXRT_ERR_NO_MEMORY : VOXRT_OK));
        voxrt_tree_destroy(t);
        voxrt_tree_destroy(shared);
        voxrt_tree_destroy(back);
        if (ta.count > k) n = k + 2;
        test_alloc_check(&ta);
    }
    CHECK(n > 40);
    shape_free(&s);
}

/* ---- pictures ---- */

enum { SIZE = 200 };

/* Voxels of 10 pixels at the outline of a ball. */
TEST(outlines_close_up) {
    static double exact[SIZE * SIZE], got[SIZE * SIZE];
    static float rgba[SIZE * SIZE * 4];
    voxrt_light light;
    voxrt_image m;
    voxrt_render_desc d;
    double p[2];
    uint32_t k, i;
    memset(&light, 0, sizeof light);
    memset(&m, 0, sizeof m);
    memset(&d, 0, sizeof d);
    light.directional = 1;
    light.position[0] = 0.6f;
    light.position[1] = 0.7f;
    light.position[2] = 0.5f;
    light.color[0] = light.color[1] = light.color[2] = 0.9f;
    d.camera.at[0] = d.camera.eye[0] = 1.6f;
    d.camera.at[1] = d.camera.eye[1] = 1.55f;
    d.camera.at[2] = 1;
    d.camera.eye[2] = 21;
    d.camera.fov_y = (float)(2 * atan(0.5 * (double)SIZE / 10 * 2 / 64 / 20) * 57.29577951308232);
    d.lights = &light;
    d.light_count = 1;
    d.samples = 16;
    d.shadows = 1;
    m.width = m.height = SIZE;
    m.rgba = rgba;
    CHECK(ball_picture(&d.camera, SIZE, SIZE, 1, 0.9, light.position, exact, NULL));
    ball_bytes(exact, SIZE * SIZE);
    for (k = 0; k < 2; k++) {
        voxrt_tree *t = make_ball(64, (int)k, 160);
        CHECK(voxrt_render(&d, t, &m, NULL) == VOXRT_OK);
        for (i = 0; i < SIZE * SIZE; i++) got[i] = ball_srgb((double)rgba[4 * i]);
        p[k] = ball_psnr(got, exact, SIZE * SIZE);
        voxrt_tree_destroy(t);
    }
    if (test_g.verbose) printf("     cubes %.1f dB, planes %.1f dB\n", p[0], p[1]);
    CHECK_MSG(p[1] > p[0] + 8 && p[1] > 40, "%.1f and %.1f dB", p[0], p[1]);
}

/* Pixels of a ball that face the light and are dark, over all heights of the light. */
TEST(no_false_shadows) {
    static float rgba[SIZE * SIZE * 4];
    const char *more = getenv("TEST_DEPTH");
    const uint32_t resolution = 1u << (more != NULL ? atoi(more) : 6);
    uint32_t k, e, x, y, a, lit = 0, dark[3] = {0, 0, 0}, leaks[3] = {0, 0, 0};
    for (k = 0; k < 3; k++) { /* as in the thesis, cubes, planes */
        voxrt_tree *t = make_ball(resolution, k == 2, 2 * resolution);
        for (e = 1, lit = 0; e < 90; e += 8) {
            const double up = e * 0.017453292519943, around = e * 2.39996;
            const double l[3] = {cos(up) * cos(around), sin(up), cos(up) * sin(around)};
            voxrt_render_desc d;
            voxrt_light light;
            voxrt_image m;
            memset(&d, 0, sizeof d);
            memset(&light, 0, sizeof light);
            memset(&m, 0, sizeof m);
            m.width = m.height = SIZE;
            m.rgba = rgba;
            light.directional = 1;
            for (a = 0; a < 3; a++) {
                light.position[a] = (float)l[a];
                light.color[a] = 1;
                d.camera.at[a] = 1;
            }
            d.camera.eye[0] = 2.2f;
            d.camera.eye[1] = 2.5f;
            d.camera.eye[2] = 3.3f;
            d.camera.fov_y = 36;
            d.lights = &light;
            d.light_count = 1;
            d.shadows = 1;
            d.view = VOXRT_VIEW_LIGHT;
            d.thesis_shadows = k == 0;
            CHECK(voxrt_render(&d, t, &m, NULL) == VOXRT_OK);
            for (y = 0; y < SIZE; y++)
                for (x = 0; x < SIZE; x++) {
                    voxrt_ray q;
                    double oo = 0, od = 0, dd = 0, c = 0, at;
                    CHECK(voxrt_camera_ray(&d.camera, SIZE, SIZE, x + 0.5, y + 0.5, &q) == VOXRT_OK);
                    for (a = 0; a < 3; a++) {
                        const double o = (double)q.org[a] - 1, v = (double)q.dir[a];
                        oo += o * o;
                        od += o * v;
                        dd += v * v;
                    }
                    if (od * od - dd * (oo - 0.81) <= 0) continue;
                    at = (-od - sqrt(od * od - dd * (oo - 0.81))) / dd;
                    for (a = 0; a < 3; a++) c += ((double)q.org[a] - 1 + at * (double)q.dir[a]) / 0.9 * l[a];
                    lit += c > 0.02;
                    dark[k] += c > 0.02 && rgba[4 * (y * SIZE + x)] < 0.0501f;
                    leaks[k] += c < -0.05 && rgba[4 * (y * SIZE + x)] > 0.0501f;
                }
        }
        voxrt_tree_destroy(t);
    }
    if (test_g.verbose)
        printf("     %u cells, %u pixels: false shadow thesis %.3f %%, cubes %.3f %%, planes %.4f %%; light where none "
               "falls %u, %u, %u\n", resolution, lit, 100.0 * dark[0] / lit, 100.0 * dark[1] / lit, 100.0 * dark[2] / lit,
               leaks[0], leaks[1], leaks[2]);
    CHECK(lit > 50000 && dark[0] > lit / 10 && dark[2] * 100 < dark[0] && dark[2] <= dark[1]);
    CHECK(leaks[2] == 0);
}

/* Shadow rays of flat surfaces start above all voxels of these, not much higher than that: cubes are not met again. */
TEST(shadow_rays_leave_their_surface) {
    test_rng r = test_rng_make(21);
    uint32_t k, i, a, met = 0, low = 0, all = 0;
    for (k = 0; k < 40; k++) {
        static const uint32_t index[3] = {0, 1, 2};
        float position[9];
        double n[3], u[3], v[3], size = 0, l1;
        voxrt_build_desc d;
        voxrt_render_desc how;
        voxrt_mesh m;
        voxrt_tree *t = NULL;
        memset(&d, 0, sizeof d);
        memset(&m, 0, sizeof m);
        memset(&how, 0, sizeof how);
        for (a = 0; a < 3; a++) n[a] = k < 3 ? (a == k ? 1.0 : 0.0) : 2 * test_rng_double(&r) - 1;
        for (a = 0; a < 3; a++) size += n[a] * n[a];
        for (a = 0; a < 3; a++) n[a] /= sqrt(size);
        l1 = fabs(n[0]) + fabs(n[1]) + fabs(n[2]);
        a = fabs(n[0]) < 0.6 ? 0u : 1u; /* two directions in the plane */
        for (i = 0; i < 3; i++) u[i] = (i == a ? 1.0 : 0.0) - n[a] * n[i];
        for (i = 0; i < 3; i++) v[i] = n[(i + 1) % 3] * u[(i + 2) % 3] - n[(i + 2) % 3] * u[(i + 1) % 3];
        for (a = 0; a < 3; a++) {
            position[a] = (float)(1.003 - 0.5 * u[a] - 0.4 * v[a]);
            position[3 + a] = (float)(1.003 + 0.5 * u[a] - 0.4 * v[a]);
            position[6 + a] = (float)(1.003 + 0.7 * v[a]);
        }
        d.resolution = 128;
        d.box_size = 2;
        d.planes = 1;
        m.positions = position;
        m.vertex_count = 3;
        m.indices = index;
        m.triangle_count = 1;
        REQUIRE(voxrt_tree_build(&d, &m, NULL, &t) == VOXRT_OK);
        for (i = 0; i < 200; i++) {
            const double x = 0.3 * (test_rng_double(&r) - 0.5), y = 0.3 * (test_rng_double(&r) - 0.5);
            voxrt_trace_desc td;
            voxrt_hit hit;
            voxrt_surface s;
            voxrt_ray ray, shadow;
            float normal[3], to[3], p[3], up = 0;
            uint8_t dark = 0;
            memset(&td, 0, sizeof td);
            memset(&s, 0, sizeof s);
            for (a = 0; a < 3; a++) {
                ray.org[a] = (float)(1.003 + x * u[a] + y * v[a] + 0.8 * n[a]);
                ray.dir[a] = (float)(-n[a]);
                normal[a] = s.normal[a] = (float)n[a];
                to[a] = (float)(n[a] + 4 * (test_rng_double(&r) - 0.5));
                up += to[a] * normal[a];
            }
            ray.t_min = 0;
            ray.t_max = INFINITY;
            if (up < 0.05f || voxrt_trace(t, &td, &ray, &hit, 1) != VOXRT_OK || hit.plane == 0) continue;
            s.t = hit.t;
            s.plane = hit.plane;
            s.edge = 2.0f / 128;
            for (a = 0; a < 3; a++) p[a] = ray.org[a] + ray.dir[a] * hit.t;
            voxrti_shadow_origin(&how, &s, p, normal, to, shadow.org);
            for (a = 0; a < 3; a++) shadow.dir[a] = to[a];
            shadow.t_min = 0;
            shadow.t_max = INFINITY;
            td.cubes = 1;
            CHECK(voxrt_occluded(t, &td, &shadow, &dark, 1) == VOXRT_OK);
            met += dark;
            for (a = 0; a < 3; a++) shadow.org[a] = p[a] + 0.7f * (float)l1 * s.edge * normal[a];
            CHECK(voxrt_occluded(t, &td, &shadow, &dark, 1) == VOXRT_OK);
            low += dark;
            all++;
        }
        voxrt_tree_destroy(t);
    }
    CHECK_MSG(all > 2000 && met * 200 < all && low * 20 > all, "%u of %u meet their surface, %u from lower", met, all, low);
    if (test_g.verbose) printf("     %u of %u meet their surface, %u from 0.7 of that height\n", met, all, low);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(planes_are_where_triangles_are);
    RUN(codes_of_planes);
    RUN(sheets_and_insides_stay_cubes);
    RUN(rays_end_where_slow_ones_do);
    RUN(many_rays_are_as_single_ones);
    RUN(any_planes_by_all_ways);
    RUN(rays_in_planes);
    RUN(times_are_finite);
    RUN(sharp_ridges_are_cubes);
    RUN(same_voxels_and_planes_by_all_ways);
    RUN(closed_shells_keep_all_rays);
    RUN(files_and_shared_trees_keep_planes);
    RUN(what_keeps_no_planes);
    RUN(edits_keep_planes);
    RUN(instances_have_planes);
    RUN(arguments_and_failures);
    RUN(outlines_close_up);
    RUN(shadow_rays_leave_their_surface);
    RUN(no_false_shadows);
    return test_end();
}
