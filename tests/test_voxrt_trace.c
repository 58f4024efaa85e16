/* Trees from voxels and rays through them, judged by exact stepping (oracle.h). */
#include "test.h"
static int wrong_calls; /* set while a test makes calls that the library asserts against */
#define VOXRT_ASSERT(cond) ((void)((cond) || wrong_calls || (test_fail(__FILE__, __LINE__, "%s", #cond), abort(), 0)))
#define VOXRT_IMPLEMENTATION
#include "../voxrt.h"
#include "oracle.h"

typedef struct scene {
    uint32_t depth;
    int32_t size;              /* 2^depth */
    oracle_grid g;
    voxrt_voxel *v;
    size_t n;
    voxrt_tree *tree;
    char name[32];
} scene;

enum { BATCH = 4096 };
static const voxrt_isa isas[5] = {VOXRT_ISA_SCALAR, VOXRT_ISA_SSE, VOXRT_ISA_AVX2, VOXRT_ISA_AVX512, VOXRT_ISA_AUTO};
static size_t isa_count; /* of this machine; the ones behind fall back to these */

static uint32_t bits_of(float f) {
    uint32_t u;
    memcpy(&u, &f, sizeof u);
    return u;
}

static const char *ray_text(const voxrt_ray *r) { /* for messages: enough to repeat it */
    static char text[4][200];
    static unsigned at;
    char *p = text[at++ & 3u];
    snprintf(p, sizeof text[0], "org %08x %08x %08x dir %08x %08x %08x t %08x %08x", bits_of(r->org[0]),
             bits_of(r->org[1]), bits_of(r->org[2]), bits_of(r->dir[0]), bits_of(r->dir[1]), bits_of(r->dir[2]),
             bits_of(r->t_min), bits_of(r->t_max));
    return p;
}

static const char *hit_text(const voxrt_hit *h) {
    static char text[4][160];
    static unsigned at;
    char *p = text[at++ & 3u];
    if (h->node == VOXRT_NO_NODE) snprintf(p, sizeof text[0], "miss");
    else snprintf(p, sizeof text[0], "t %.9g (%08x) cell %u %u %u level %u face %u node %u slot %u", (double)h->t,
                  bits_of(h->t), h->cell[0], h->cell[1], h->cell[2], h->level, h->face, h->node, h->slot);
    return p;
}

static int same_hit(const voxrt_hit *a, const voxrt_hit *b) { return memcmp(a, b, sizeof *a) == 0; }

static voxrt_ray ray_of(float ox, float oy, float oz, float dx, float dy, float dz) {
    voxrt_ray r;
    r.org[0] = ox;
    r.org[1] = oy;
    r.org[2] = oz;
    r.dir[0] = dx;
    r.dir[1] = dy;
    r.dir[2] = dz;
    r.t_min = 0.0f;
    r.t_max = INFINITY;
    return r;
}

static int bad_ray(const voxrt_ray *r) { /* as the API says; a NaN in t is bad too */
    int a;
    for (a = 0; a < 3; a++) if (!isfinite(r->org[a]) || !isfinite(r->dir[a])) return 1;
    if (r->dir[0] == 0.0f && r->dir[1] == 0.0f && r->dir[2] == 0.0f) return 1;
    return !(r->t_min <= r->t_max);
}

/* ---- scenes ---- */

static uint32_t hash3(uint32_t x, uint32_t y, uint32_t z) {
    uint32_t h = x * 0x9e3779b1u ^ y * 0x85ebca77u ^ z * 0xc2b2ae3du;
    h ^= h >> 15;
    h *= 0x2c1b3c6du;
    h ^= h >> 12;
    return h * 0x297a2d39u >> 8;
}

static void scene_list(scene *s) { /* the list of voxels, in an order that is not Morton's, and the tree */
    voxrt_build_desc d;
    size_t i, n = 0, total = (size_t)s->g.n[0] * (size_t)s->g.n[1] * (size_t)s->g.n[2];
    int32_t x, y, z;
    for (i = 0; i < (total + 7) / 8; i++) n += voxrti_popcount64(s->g.bits[i]);
    s->v = (voxrt_voxel *)calloc(n + 1, sizeof *s->v);
    if (s->v == NULL) exit(1);
    for (z = 0; z < s->g.n[2]; z++) for (y = 0; y < s->g.n[1]; y++) {
        i = ((size_t)z * (size_t)s->g.n[1] + (size_t)y) * (size_t)s->g.n[0];
        for (x = 0; x < s->g.n[0]; x++, i++) {
            voxrt_voxel *v = &s->v[s->n];
            if ((i & 7) == 0 && s->g.bits[i >> 3] == 0 && x + 7 < s->g.n[0]) { x += 7; i += 7; continue; }
            if ((s->g.bits[i >> 3] >> (i & 7) & 1) == 0) continue;
            v->x = (uint32_t)(x + s->g.lo[0]);
            v->y = (uint32_t)(y + s->g.lo[1]);
            v->z = (uint32_t)(z + s->g.lo[2]);
            s->n++;
        }
    }
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    d.disable_colors = d.disable_normals = 1;
    if (voxrt_tree_from_voxels(&d, s->v, s->n, s->depth, &s->tree) != VOXRT_OK) test_fail(__FILE__, __LINE__, "build %s", s->name);
}

enum { FEW, RANDOM, HALF, SHELL, SOLID, NOISE, CHECKER, FULL, WALLS, CORNERS, KINDS };

/* kind + KINDS: and the eight corners of the grid */
static void scene_make(scene *s, uint32_t depth, int kind) {
    static const char *const names[KINDS] = {"few", "random", "half", "shell", "solid", "noise", "checker", "full", "walls", "corners"};
    int32_t lo[3] = {0, 0, 0}, n[3], x, y, z, i;
    test_rng r = test_rng_make((uint64_t)(kind * 100) + depth);
    memset(s, 0, sizeof *s);
    s->depth = depth;
    s->size = 1 << depth;
    n[0] = n[1] = n[2] = s->size;
    snprintf(s->name, sizeof s->name, "%s depth %u", names[kind % KINDS], depth);
    if (!oracle_grid_make(&s->g, lo, n)) exit(1);
    if (kind >= CORNERS) {
        for (i = 0; i < 8; i++)
            oracle_set(&s->g, (i & 1) != 0 ? s->size - 1 : 0, (i & 2) != 0 ? s->size - 1 : 0, (i & 4) != 0 ? s->size - 1 : 0);
    }
    kind %= KINDS;
    if (kind == FEW) {
        for (i = 0; i < 40; i++)
            oracle_set(&s->g, (int32_t)(test_rng_u32(&r) & (uint32_t)(s->size - 1)),
                       (int32_t)(test_rng_u32(&r) & (uint32_t)(s->size - 1)), (int32_t)(test_rng_u32(&r) & (uint32_t)(s->size - 1)));
    } else if (kind != CORNERS) for (z = 0; z < s->size; z++) for (y = 0; y < s->size; y++) for (x = 0; x < s->size; x++) {
        uint32_t h = hash3((uint32_t)x, (uint32_t)y, (uint32_t)z);
        double c = s->size / 2.0, px = x + 0.5 - c, py = y + 0.5 - c, pz = z + 0.5 - c, q = px * px + py * py + pz * pz;
        int on = 0;
        switch (kind) {
        case RANDOM: on = h % 50 == 0; break;
        case HALF: on = (int)(h & 1u); break;
        case SHELL: on = fabs(sqrt(q) - 0.85 * c) < 0.6 || (x == s->size / 3 && y == x && z == x); break;
        case SOLID: on = q < 0.6 * c * c; break;
        case NOISE: on = hash3((uint32_t)x >> 3, (uint32_t)y >> 3, (uint32_t)z >> 3) % 16 == 0 && h % 8 == 0; break;
        case CHECKER: on = (x + y + z) % 2; break;
        case FULL: on = 1; break;
        default: on = (x % 8 == 3 && h % 64 != 0) || (y % 8 == 4 && h % 16 == 0) || (z % 16 == 8 && h % 4 == 0); break;
        }
        if (on) oracle_set(&s->g, x, y, z);
    }
    scene_list(s);
}

static void scene_drop(scene *s) {
    voxrt_tree_destroy(s->tree);
    free(s->g.bits);
    free(s->v);
    memset(s, 0, sizeof *s);
}

/* ---- the check that all tests share ---- */

typedef struct tally { uint64_t rays, hits, bad, unique, wild, wild_wrong; } tally;

static const char *judge(const oracle_grid *g, const voxrt_ray *r, const voxrt_hit *h, double cell, oracle_hit *first) {
    oracle_ray o;
    oracle_hit said;
    int a;
    memset(&said, 0, sizeof said);
    for (a = 0; a < 3; a++) {
        o.o[a] = (double)r->org[a] / cell;
        o.d[a] = (double)r->dir[a] / cell;
        said.cell[a] = (int32_t)h->cell[a];
    }
    o.t_min = (double)r->t_min;
    o.t_max = (double)r->t_max;
    said.hit = h->node != VOXRT_NO_NODE;
    said.t = (double)h->t;
    said.face = h->face;
    return oracle_judge(g, &o, &said, first);
}

static int is_miss(const voxrt_hit *h) {
    voxrt_hit m;
    memset(&m, 0, sizeof m);
    m.t = INFINITY;
    m.node = VOXRT_NO_NODE;
    return same_hit(h, &m);
}

/* Level, slot and the rest of the bytes of a hit on the leaves. The slot is Morton order in blocks of 4; in a tree of odd
   depth the blocks are those of a tree one level deeper, the model in its first octant. */
static int leaf_form(const scene *s, const voxrt_hit *h) {
    return h->level == s->depth && h->slot == voxrti_slot(h->cell[0] & 3u, h->cell[1] & 3u, h->cell[2] & 3u) &&
           h->plane == 0 && h->face <= 6;
}

/* rays[n], n <= BATCH: equal bits for every isa, one by one too; occluded the same; right by the oracle. Rays of which
   `wild` is set may be wrong, but only for the oracle and seldom. */
static void check_rays(const scene *s, const voxrt_ray *rays, const uint8_t *wild, size_t n, tally *sum) {
    static voxrt_hit ref[BATCH], hits[BATCH];
    static uint8_t occ[BATCH];
    static size_t turn;
    voxrt_trace_desc d;
    voxrt_stats st;
    uint64_t bad = 0, hit = 0;
    size_t i, k;
    memset(&d, 0, sizeof d);
    for (i = 0; i < n; i++) {
        memset(&ref[i], 0x5a, sizeof ref[i]);
        k = (size_t)voxrt_trace1(s->tree, &rays[i], &ref[i]);
        CHECK_MSG(k == (ref[i].node != VOXRT_NO_NODE), "trace1 returns %d for %s", (int)k, hit_text(&ref[i]));
        hit += k;
    }
    turn++;
    for (k = 0; k < isa_count; k++) {
        d.isa = isas[k];
        d.stats = k == turn % isa_count ? &st : NULL; /* a path of its own */
        memset(&st, 0, sizeof st);
        memset(hits, 0xa5, n * sizeof hits[0]);
        CHECK(voxrt_trace(s->tree, &d, rays, hits, n) == VOXRT_OK);
        if (memcmp(hits, ref, n * sizeof hits[0]) != 0)
            for (i = 0; i < n; i++)
                CHECK_MSG(same_hit(&hits[i], &ref[i]), "%s, isa %d, ray %d of %d %s: %s, alone: %s", s->name, (int)isas[k], (int)i,
                          (int)n, ray_text(&rays[i]), hit_text(&hits[i]), hit_text(&ref[i]));
        if (d.stats == NULL) continue;
        for (i = 0, bad = 0; i < n; i++) bad += (uint64_t)bad_ray(&rays[i]);
        CHECK_MSG(st.rays == n && st.hits == hit && st.bad_rays == bad, "%s: stats %d %d %d, counted %d %d %d", s->name,
                  (int)st.rays, (int)st.hits, (int)st.bad_rays, (int)n, (int)hit, (int)bad);
        memset(occ, 0xa5, n);
        d.stats = turn % 3 == 0 ? &st : NULL;
        CHECK(voxrt_occluded(s->tree, &d, rays, occ, n) == VOXRT_OK);
        for (i = 0; i < n; i++)
            CHECK_MSG(occ[i] == (ref[i].node != VOXRT_NO_NODE), "%s, isa %d, ray %d of %d %s: occluded %d, trace: %s", s->name,
                      (int)isas[k], (int)i, (int)n, ray_text(&rays[i]), occ[i], hit_text(&ref[i]));
    }
    for (i = 0; i < n; i++) {
        oracle_hit first;
        const char *why;
        int b = bad_ray(&rays[i]);
        if (b || ref[i].node == VOXRT_NO_NODE)
            CHECK_MSG(is_miss(&ref[i]), "%s: not a clean miss: %s, %s", s->name, ray_text(&rays[i]), hit_text(&ref[i]));
        else CHECK_MSG(leaf_form(s, &ref[i]) && ref[i].t >= rays[i].t_min && ref[i].t < rays[i].t_max, "%s: not a clean hit: %s: %s",
                       s->name, ray_text(&rays[i]), hit_text(&ref[i]));
        if (b) continue;
        why = judge(&s->g, &rays[i], &ref[i], 1.0, &first);
        sum->unique += first.ties == 0;
        if (wild != NULL && wild[i]) {
            sum->wild++;
            sum->wild_wrong += why != NULL;
            continue;
        }
        CHECK_MSG(why == NULL, "%s: %s: %s: %s; the oracle: %s t %.9g cell %d %d %d face %d, %d ties", s->name, why,
                  ray_text(&rays[i]), hit_text(&ref[i]), first.hit ? "hit" : "miss", first.t, first.cell[0], first.cell[1],
                  first.cell[2], first.face, first.ties);
    }
    sum->rays += n;
    sum->hits += hit;
    sum->bad += bad;
}

/* ---- (a) general rays ---- */

static voxrt_ray general_ray(test_rng *r, float size) {
    voxrt_ray q;
    float to[3], scale = 1.0f;
    uint32_t kind = test_rng_below(r, 8), a;
    memset(&q, 0, sizeof q);
    for (a = 0; a < 3; a++) {
        q.org[a] = kind < 3 ? size * test_rng_float(r) : test_rng_range(r, -size, 2.0f * size);
        to[a] = size * (kind == 7 ? test_rng_range(r, -1.0f, 2.0f) : test_rng_float(r));
    }
    if (test_rng_below(r, 2) != 0) scale = test_rng_range(r, 0.001f, 3.0f);
    for (a = 0; a < 3; a++) q.dir[a] = (to[a] - q.org[a]) * scale;
    q.t_max = INFINITY;
    switch (test_rng_below(r, 8)) {
    case 0: q.t_min = test_rng_float(r); break;
    case 1: q.t_max = test_rng_range(r, 0.0f, 2.0f) / scale; break;
    case 2: q.t_min = test_rng_float(r) / scale; q.t_max = q.t_min + test_rng_float(r) / scale; break;
    case 3: q.t_min = -test_rng_float(r) / scale; break;
    default: break;
    }
    return q;
}

TEST(general_rays) {
    static const struct { uint32_t depth; int kind; uint32_t share; } list[] = {
        {1, HALF, 20}, {1, CORNERS, 20}, {2, RANDOM, 20}, {2, HALF, 20}, {3, RANDOM, 50}, {3, CHECKER, 20}, {4, RANDOM, 50},
        {4, SOLID, 30}, {5, FEW, 50}, {5, NOISE, 50}, {6, FEW, 120}, {6, RANDOM, 120}, {6, HALF, 80}, {6, SHELL, 120},
        {6, SOLID, 120}, {6, NOISE, 120}, {6, WALLS, 80}, {6, FULL, 40}, {7, FEW, 100}, {7, RANDOM, 200}, {7, SHELL, 160},
        {7, SOLID, 120}, {7, NOISE, 160}, {7, CHECKER, 40}, {8, FEW, 30}, {8, NOISE, 40}, {9, FEW, 20}};
    static voxrt_ray rays[BATCH];
    size_t k;
    tally sum;
    memset(&sum, 0, sizeof sum);
    for (k = 0; k < sizeof list / sizeof list[0]; k++) {
        scene s;
        size_t want = list[k].share * (test_quick() ? 50u : 80u), done = 0;
        test_rng r = test_rng_make(k);
        if (test_quick() && list[k].depth > 7) continue;
        scene_make(&s, list[k].depth, list[k].kind);
        while (done < want) {
            size_t i, n = want - done < BATCH ? want - done : (size_t)BATCH;
            for (i = 0; i < n; i++) rays[i] = general_ray(&r, (float)s.size);
            check_rays(&s, rays, NULL, n, &sum);
            done += n;
        }
        scene_drop(&s);
    }
    CHECK(sum.hits * 10 > sum.rays * 3 && sum.hits * 10 < sum.rays * 9); /* or the rays are no test */
    CHECK(sum.unique * 100 > sum.rays * 99);
    if (test_g.verbose) printf("  %d rays, %d hits, %d without ties\n", (int)sum.rays, (int)sum.hits, (int)sum.unique);
}

/* Windows of 64^3 cells in grids of 4096^3 to 2^60 cells, with rays from around them: as exact as in small grids. */
TEST(windows_in_deep_grids) {
    static const uint32_t depths[4] = {12, 13, 16, 20};
    static voxrt_ray rays[BATCH];
    uint32_t k, w, batch;
    tally sum;
    memset(&sum, 0, sizeof sum);
    for (k = 0; k < 4; k++)
        for (w = 0; w < 4; w++) {
            scene s;
            test_rng r = test_rng_make(500 + 10 * k + w);
            int32_t lo[3], n[3] = {64, 64, 64}, x, y, z, a;
            memset(&s, 0, sizeof s);
            s.depth = depths[k];
            s.size = 1 << depths[k];
            snprintf(s.name, sizeof s.name, "window %u depth %u", w, depths[k]);
            for (a = 0; a < 3; a++) /* at the far corner, at the near one, anywhere */
                lo[a] = w == 0 ? s.size - 64 : w == 1 ? 0 : (int32_t)test_rng_below(&r, (uint32_t)s.size - 64u);
            if (!oracle_grid_make(&s.g, lo, n)) exit(1);
            for (z = 0; z < 64; z++) for (y = 0; y < 64; y++) for (x = 0; x < 64; x++) {
                const double p[3] = {x - 31.5, y - 31.5, z - 31.5}, q = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);
                if (w % 2 == 0 ? fabs(q - 28) < 0.7 : hash3((uint32_t)x, (uint32_t)y, (uint32_t)z) % 300 == 0)
                    oracle_set(&s.g, x + lo[0], y + lo[1], z + lo[2]);
            }
            scene_list(&s);
            for (batch = 0; batch < (test_quick() ? 1u : 4u); batch++) {
                uint32_t i;
                for (i = 0; i < BATCH; i++) {
                    rays[i] = general_ray(&r, 64.0f);
                    for (a = 0; a < 3; a++) rays[i].org[a] += (float)lo[a];
                }
                check_rays(&s, rays, NULL, BATCH, &sum);
            }
            scene_drop(&s);
        }
    CHECK(sum.hits * 10 > sum.rays * 2 && sum.hits * 10 < sum.rays * 9);
    if (test_g.verbose) printf("  %d rays, %d hits\n", (int)sum.rays, (int)sum.hits);
}

/* ---- (b) adversarial rays ---- */

static float pick(test_rng *r, const float *of, size_t n) { return of[test_rng_below(r, (uint32_t)n)]; }

static const float odd_dirs[] = {0.0f, -0.0f, 1e-45f, -1e-45f, 1e-30f, -1e-30f, 1.0f, -1.0f, 1.0f, -1.0f, 0.5f, -0.5f, 0.3f, 3.0f};

static void set_to(voxrt_ray *q, const float *to) {
    int a;
    for (a = 0; a < 3; a++) q->dir[a] = to[a] - q->org[a];
}

/* A lattice of 1/8 cells (or whole cells): differences are exact, so rays meet corners and edges exactly. */
static float lattice(test_rng *r, int32_t lo, int32_t hi, int whole) {
    uint32_t n = (uint32_t)(hi - lo) * (whole ? 1u : 8u) + 1u;
    return (float)lo + (float)test_rng_below(r, n) / (whole ? 1.0f : 8.0f);
}

static voxrt_ray nasty_ray(test_rng *r, int32_t size, uint8_t *wild) {
    voxrt_ray q = ray_of(0, 0, 0, 1, 1, 1);
    float to[3], f;
    uint32_t kind = test_rng_below(r, 15), a, b = test_rng_below(r, 3);
    for (a = 0; a < 3; a++) {
        q.org[a] = lattice(r, -size / 2, size + size / 2, (int)test_rng_below(r, 2));
        to[a] = lattice(r, 0, size, 1);
    }
    set_to(&q, to);
    *wild = kind == 12;
    switch (kind) {
    case 0: break;                                                     /* through a corner, exactly */
    case 1:                                                            /* through an edge */
        to[b] = (float)size * test_rng_float(r);
        set_to(&q, to);
        break;
    case 2: case 3:                                                    /* odd direction components, origin anywhere */
        for (a = 0; a < 3; a++) q.dir[a] = pick(r, odd_dirs, sizeof odd_dirs / sizeof odd_dirs[0]);
        if (kind == 3) for (a = 0; a < 3; a++) if (test_rng_below(r, 2) != 0) q.org[a] = (float)size * test_rng_float(r);
        break;
    case 4:                                                            /* along an axis, in planes of the grid */
        for (a = 0; a < 3; a++) {
            q.org[a] = lattice(r, a == b ? -size : 0, a == b ? 2 * size : size, test_rng_below(r, 8) != 0);
            q.dir[a] = a == b ? (test_rng_below(r, 2) != 0 ? 1.0f : -1.0f) : (test_rng_below(r, 2) != 0 ? 0.0f : -0.0f);
        }
        break;
    case 5:                                                            /* in one plane of the grid */
        q.org[b] = lattice(r, 0, size, 1);
        q.dir[b] = test_rng_below(r, 2) != 0 ? 0.0f : -0.0f;
        break;
    case 6:                                                            /* origin on a corner, an edge, a face */
        for (a = 0; a < 3; a++) {
            q.org[a] = a <= b ? lattice(r, 0, size, 1) : (float)size * test_rng_float(r);
            q.dir[a] = test_rng_range(r, -1.0f, 1.0f);
        }
        break;
    case 7:                                                            /* from 10^7 grids away */
        for (a = 0; a < 3; a++) {
            to[a] = test_rng_below(r, 2) != 0 ? (float)size * test_rng_float(r) : to[a];
            q.dir[a] = test_rng_below(r, 3) != 0 ? (test_rng_below(r, 2) != 0 ? 1.0f : -1.0f) : test_rng_range(r, -1.0f, 1.0f);
            if (test_rng_below(r, 4) == 0) q.dir[a] = 0.0f;
        }
        f = (float)size * pick(r, odd_dirs + 6, 2) * (test_rng_below(r, 2) != 0 ? 1e7f : 1048576.0f);
        for (a = 0; a < 3; a++) q.org[a] = to[a] - f * q.dir[a];
        if (f < 0) for (a = 0; a < 3; a++) q.dir[a] = -q.dir[a];
        if (test_rng_below(r, 4) == 0) q.t_min = test_rng_below(r, 2) != 0 ? -test_rng_float(r) : -2.0f * fabsf(f);
        if (test_rng_below(r, 8) == 0) for (a = 0; a < 3; a++) q.dir[a] = -q.dir[a];
        break;
    case 8:                                                            /* very long and very short directions */
        f = test_rng_below(r, 2) != 0 ? 1e20f : 1e-20f;
        for (a = 0; a < 3; a++) q.dir[a] *= f;
        break;
    case 9:                                                            /* NaN, infinity, zero */
        f = test_rng_below(r, 2) != 0 ? NAN : test_rng_below(r, 2) != 0 ? INFINITY : -INFINITY;
        switch (test_rng_below(r, 5)) {
        case 0: q.org[b] = f; break;
        case 1: q.dir[b] = f; break;
        case 2: q.t_min = f; break;
        case 3: q.t_max = f; break;
        default: q.dir[0] = q.dir[1] = q.dir[2] = 0.0f; q.dir[b] = -0.0f; break;
        }
        break;
    case 10:                                                           /* windows in t that begin or end at events */
        for (a = 0; a < 3; a++) q.dir[a] = pick(r, odd_dirs + 6, 8);
        q.t_min = lattice(r, -4, size, 0);
        q.t_max = test_rng_below(r, 3) == 0 ? q.t_min : lattice(r, -4, size, 0);
        if (test_rng_below(r, 4) == 0) q.t_max = INFINITY;
        if (test_rng_below(r, 4) == 0) q.t_min = test_rng_below(r, 2) != 0 ? -INFINITY : 1e-20f;
        if (q.t_min < -1e30f && test_rng_below(r, 4) == 0) q.t_max = q.t_min; /* empty, but not turned round */
        break;
    case 11:                                                           /* equal components */
        for (a = 0; a < 3; a++) q.dir[a] = a == b && test_rng_below(r, 2) != 0 ? 0.0f : test_rng_below(r, 2) != 0 ? 0.7f : -0.7f;
        break;
    case 12: /* any bits. Such a ray can pass a plane at 1e-30 cells, or come from 1e30 cells: no double tells the side. */
        for (a = 0; a < 3; a++) {
            q.dir[a] = test_rng_bits(r);
            if (test_rng_below(r, 2) != 0) q.org[a] = test_rng_bits(r);
        }
        break;
    case 13:                                                           /* past corners and edges at a hair's breadth */
        for (a = 0; a < 3; a++) if (test_rng_below(r, 2) != 0) q.dir[a] = nextafterf(q.dir[a], test_rng_below(r, 2) != 0 ? INFINITY : -INFINITY);
        break;
    default:                                                           /* denormal directions */
        for (a = 0; a < 3; a++) q.dir[a] = ldexpf(q.dir[a], -140);
        if (test_rng_below(r, 2) != 0) for (a = 0; a < 3; a++) q.dir[a] = test_rng_below(r, 2) != 0 ? 1e-45f : -1e-45f;
        break;
    }
    if (kind < 9 && test_rng_below(r, 4) == 0) q.t_max = 1.0f;
    if (kind < 9 && test_rng_below(r, 8) == 0) q.t_min = 0.5f;
    return q;
}

TEST(nasty_rays) {
    static const struct { uint32_t depth; int kind; } list[] = {{1, CORNERS}, {2, HALF}, {3, RANDOM}, {3, HALF}, {4, CHECKER},
        {4, WALLS}, {4, FULL}, {5, RANDOM}, {5, SOLID}, {5, CORNERS}, {6, RANDOM}, {6, SHELL}, {6, FEW}, {6, NOISE}, {7, WALLS}, {7, SHELL}};
    static voxrt_ray rays[BATCH];
    static uint8_t wild[BATCH];
    size_t k, batch, i, most = test_quick() ? 1 : 9;
    tally sum;
    memset(&sum, 0, sizeof sum);
    for (k = 0; k < sizeof list / sizeof list[0]; k++) {
        scene s;
        test_rng r = test_rng_make(1000 + k);
        scene_make(&s, list[k].depth, list[k].kind);
        for (batch = 0; batch < most; batch++) {
            for (i = 0; i < BATCH; i++) rays[i] = nasty_ray(&r, s.size, &wild[i]);
            check_rays(&s, rays, wild, BATCH, &sum);
        }
        scene_drop(&s);
    }
    CHECK(sum.hits * 10 > sum.rays * 2 && sum.bad * 100 > sum.rays * 3 && sum.unique * 10 < sum.rays * 9);
    CHECK_MSG(sum.wild_wrong * 100 < sum.wild, "%d of %d", (int)sum.wild_wrong, (int)sum.wild);
    if (test_g.verbose) printf("  %d rays, %d hits, %d bad, %d without ties\n", (int)sum.rays, (int)sum.hits, (int)sum.bad, (int)sum.unique);
}


/* ---- runs of rays with one origin ---- */

/* The same hits from each isa, one by one, in runs and in another order; occluded agrees. */
static void check_same(const voxrt_tree *tree, const voxrt_trace_desc *desc, const voxrt_ray *rays, size_t n, voxrt_hit *ref) {
    static voxrt_hit hits[BATCH];
    static voxrt_ray mixed[BATCH];
    static uint8_t occ[BATCH];
    static uint32_t order[BATCH];
    test_rng r = test_rng_make(n);
    voxrt_trace_desc d = *desc;
    size_t i, k;
    for (i = 0; i < n; i++) {
        order[i] = (uint32_t)i;
        d.isa = VOXRT_ISA_SCALAR;
        CHECK(voxrt_trace(tree, &d, &rays[i], &ref[i], 1) == VOXRT_OK);
    }
    for (i = n; i > 1; i--) {
        uint32_t j = test_rng_below(&r, (uint32_t)i), t = order[i - 1];
        order[i - 1] = order[j];
        order[j] = t;
    }
    for (i = 0; i < n; i++) mixed[i] = rays[order[i]];
    for (k = 0; k < isa_count; k++) {
        d.isa = isas[k];
        CHECK(voxrt_trace(tree, &d, rays, hits, n) == VOXRT_OK);
        for (i = 0; i < n; i++)
            CHECK_MSG(same_hit(&hits[i], &ref[i]), "isa %d, ray %d of a run of %d, %s: %s, alone: %s", (int)d.isa, (int)i, (int)n,
                      ray_text(&rays[i]), hit_text(&hits[i]), hit_text(&ref[i]));
        CHECK(voxrt_trace(tree, &d, mixed, hits, n) == VOXRT_OK);
        for (i = 0; i < n; i++)
            CHECK_MSG(same_hit(&hits[i], &ref[order[i]]), "isa %d, shuffled, %s: %s, alone: %s", (int)d.isa, ray_text(&mixed[i]),
                      hit_text(&hits[i]), hit_text(&ref[order[i]]));
        CHECK(voxrt_occluded(tree, &d, rays, occ, n) == VOXRT_OK);
        for (i = 0; i < n; i++)
            CHECK_MSG(occ[i] == (ref[i].node != VOXRT_NO_NODE), "isa %d, %s: occluded %d, trace: %s", (int)d.isa,
                      ray_text(&rays[i]), occ[i], hit_text(&ref[i]));
    }
}

/* A run as a camera tile, or one that only looks like it. at: a place worth looking at. */
static void make_run(test_rng *r, const scene *s, voxrt_ray *q, size_t n, const float at[3]) {
    uint32_t kind = test_rng_below(r, 12), a, i;
    float o[3], to[3], u[3], v[3], step = ldexpf(1.0f, -(int)test_rng_below(r, 10)), size = (float)s->size;
    for (a = 0; a < 3; a++) {
        o[a] = kind == 11 ? size * test_rng_range(r, -1000.0f, 1000.0f) : size * test_rng_range(r, -1.0f, 2.0f);
        if (kind == 5) o[a] = lattice(r, -2, s->size + 2, 1);
        u[a] = step * test_rng_range(r, -1.0f, 1.0f);
        v[a] = step * test_rng_range(r, -1.0f, 1.0f);
        to[a] = kind == 8 ? floorf(at[a]) : at[a] + test_rng_range(r, -2.0f, 2.0f);
    }
    if (kind == 4 || test_rng_below(r, 8) == 0) /* in or beside that place */
        for (a = 0; a < 3; a++) {
            o[a] = at[a] + (kind == 4 ? 0.5f : test_rng_range(r, -1.5f, 1.5f));
            to[a] = o[a] + test_rng_range(r, -2.0f, 2.0f);
        }
    if (kind == 9) o[0] = 0.0f;
    for (i = 0; i < n; i++) {
        for (a = 0; a < 3; a++) {
            q[i].org[a] = o[a];
            q[i].dir[a] = (to[a] - o[a]) + u[a] * (float)(i % 8) + v[a] * (float)(i / 8);
            if (kind == 6) q[i].dir[a] = test_rng_range(r, -1.0f, 1.0f);
        }
        q[i].t_min = 0.0f;
        q[i].t_max = INFINITY;
        switch (kind) {
        case 1: if (i > 0) q[i] = q[0]; break;
        case 2: if (i % 3 == 0) for (a = 0; a < 3; a++) q[i].dir[a] = -q[i].dir[a]; break;
        case 3:
            q[i].dir[n % 3] = i % 2 != 0 ? 0.0f : -0.0f;
            if (i % 16 == 15) q[i].dir[(n + 1) % 3] = 0.0f;
            break;
        case 7:
            q[i].t_min = test_rng_below(r, 2) != 0 ? 0.0f : test_rng_float(r);
            q[i].t_max = test_rng_below(r, 2) != 0 ? INFINITY : 2.0f * test_rng_float(r);
            if (i % 32 == 13) q[i].dir[1] = NAN;
            if (i % 32 == 21) q[i].dir[0] = q[i].dir[1] = q[i].dir[2] = 0.0f;
            break;
        case 4: if (i % 4 == 0) q[i].t_min = -0.0f; break; /* begins in a voxel: t is 0, not -0 */
        case 9: if (i % 2 != 0) q[i].org[0] = -0.0f; break;
        case 10: q[i].dir[0] = step * ((float)(i % 8) - 3.5f); break; /* a component that changes its sign in the tile */
        default: break;
        }
    }
}

TEST(runs_of_one_origin) {
    static const struct { uint32_t depth; int kind; } list[] = {{3, RANDOM}, {4, SOLID}, {5, FEW}, {6, SHELL}, {6, NOISE}, {7, FEW},
        {7, SHELL}, {7, WALLS}, {8, NOISE}, {9, FEW}};
    static voxrt_ray rays[BATCH];
    static voxrt_hit ref[BATCH];
    size_t k, batch, i, most = test_quick() ? 1 : 5;
    tally sum;
    memset(&sum, 0, sizeof sum);
    for (k = 0; k < sizeof list / sizeof list[0]; k++) {
        scene s;
        test_rng r = test_rng_make(2000 + k);
        voxrt_trace_desc d;
        if (test_quick() && list[k].depth > 7) continue;
        memset(&d, 0, sizeof d);
        scene_make(&s, list[k].depth, list[k].kind);
        for (batch = 0; batch < most; batch++) {
            for (i = 0; i < BATCH;) {
                size_t n = test_rng_below(&r, 8) != 0 ? 64 : 1 + test_rng_below(&r, 200);
                const voxrt_voxel *v = &s.v[test_rng_below(&r, (uint32_t)s.n)];
                float at[3];
                at[0] = (float)v->x;
                at[1] = (float)v->y;
                at[2] = (float)v->z;
                if (n > BATCH - i) n = BATCH - i;
                make_run(&r, &s, rays + i, n, at);
                i += n;
            }
            check_rays(&s, rays, NULL, BATCH, &sum);
            if (batch % 4 == 0) check_same(s.tree, &d, rays, BATCH, ref);
        }
        scene_drop(&s);
    }
    CHECK(sum.hits * 4 > sum.rays);
    if (test_g.verbose) printf("  %d rays, %d hits\n", (int)sum.rays, (int)sum.hits);
}

/* ---- nothing slips through closed surfaces ---- */

static double trace_shape(int kind, double x, double y, double z) { /* negative inside; the cube [-1,1]^3 is the grid */
    double q = sqrt(x * x + y * y + z * z), p, a, b, c;
    switch (kind) {
    case 0: return q - 0.9;
    case 1: /* torus */
        p = sqrt(x * x + y * y) - 0.6;
        return sqrt(p * p + z * z) - 0.25;
    case 2: /* rotated cube: an orthogonal basis with integer entries, 9 long */
        a = fabs(4 * x + 4 * y + 7 * z);
        b = fabs(8 * x - y - 4 * z);
        c = fabs(-x + 8 * y - 4 * z);
        return (a > b ? (a > c ? a : c) : (b > c ? b : c)) / 9 - 0.52;
    default: /* gyroid slab in a ball */
        p = fabs(sin(6 * x) * cos(6 * y) + sin(6 * y) * cos(6 * z) + sin(6 * z) * cos(6 * x)) - 0.5;
        return p > q - 0.93 ? p : q - 0.93;
    }
}

/* A cell is filled when the shape's sign is not the same at its centre and its six face centres. An empty cell has one
   sign there, and shares a face centre with each neighbour: so no 6-connected path of empty cells changes the sign. */
static void scene_shell(scene *s, uint32_t depth, int kind) {
    int32_t lo[3] = {0, 0, 0}, n[3], x, y, z, i;
    double h = 2.0 / (double)(1 << depth);
    memset(s, 0, sizeof *s);
    s->depth = depth;
    s->size = n[0] = n[1] = n[2] = 1 << depth;
    snprintf(s->name, sizeof s->name, "shell %d depth %u", kind, depth);
    if (!oracle_grid_make(&s->g, lo, n)) exit(1);
    for (z = 0; z < s->size; z++) for (y = 0; y < s->size; y++) for (x = 0; x < s->size; x++) {
        double c = trace_shape(kind, (x + 0.5) * h - 1, (y + 0.5) * h - 1, (z + 0.5) * h - 1);
        int differ = 0;
        if (fabs(c) > 12 * h) continue; /* no shape is steeper */
        for (i = 0; i < 6 && !differ; i++) {
            double f = i & 1 ? 1 : 0;
            differ = (trace_shape(kind, (x + (i / 2 == 0 ? f : 0.5)) * h - 1, (y + (i / 2 == 1 ? f : 0.5)) * h - 1,
                            (z + (i / 2 == 2 ? f : 0.5)) * h - 1) < 0) != (c < 0);
        }
        if (differ) oracle_set(&s->g, x, y, z);
    }
    scene_list(s);
}

TEST(closed_shells_do_not_leak) {
    static voxrt_ray rays[BATCH];
    static voxrt_hit hits[BATCH];
    size_t per_shape = test_quick() ? 25000 : 130000, escapes = 0, done, i;
    int kind;
    for (kind = 0; kind < 4; kind++) {
        scene s;
        test_rng r = test_rng_make(3000u + (uint64_t)kind);
        scene_shell(&s, test_quick() ? 6 : 7, kind);
        for (done = 0; done < per_shape; done += BATCH) {
            voxrt_trace_desc d;
            memset(&d, 0, sizeof d);
            d.isa = isas[done / BATCH % isa_count];
            for (i = 0; i < BATCH;) {
                voxrt_ray *q = &rays[i];
                double h = 2.0 / s.size;
                int a;
                if (i % 64 != 0 && done / BATCH % 4 == 3) memcpy(q->org, q[-1].org, sizeof q->org); /* runs */
                else do for (a = 0; a < 3; a++) q->org[a] = lattice(&r, 0, s.size, 0);
                    while (!(trace_shape(kind, (double)q->org[0] * h - 1, (double)q->org[1] * h - 1, (double)q->org[2] * h - 1) < (kind == 3 ? -10 : -1) * h));
                q->t_min = 0.0f;
                q->t_max = INFINITY;
                if (done / BATCH % 4 == 0 || i % 4 == 3) for (a = 0; a < 3; a++) q->dir[a] = test_rng_range(&r, -1.0f, 1.0f);
                else { /* at a corner (i % 4 == 1) or at an edge of a filled cell, exactly */
                    const voxrt_voxel *v = &s.v[test_rng_below(&r, (uint32_t)s.n)];
                    float to[3];
                    to[0] = (float)(v->x + test_rng_below(&r, 2));
                    to[1] = (float)(v->y + test_rng_below(&r, 2));
                    to[2] = (float)(v->z + test_rng_below(&r, 2));
                    if (i % 4 != 1) to[i % 3] = (float)(uint32_t)to[i % 3] + (float)test_rng_below(&r, 16) / 16.0f;
                    set_to(q, to);
                }
                if (q->dir[0] != 0.0f || q->dir[1] != 0.0f || q->dir[2] != 0.0f) i++;
            }
            CHECK(voxrt_trace(s.tree, &d, rays, hits, BATCH) == VOXRT_OK);
            for (i = 0; i < BATCH; i++) {
                if (hits[i].node != VOXRT_NO_NODE && i % 32 != 0) continue;
                escapes += hits[i].node == VOXRT_NO_NODE;
                CHECK_MSG(hits[i].node != VOXRT_NO_NODE, "%s, isa %d: escapes: %s", s.name, (int)d.isa, ray_text(&rays[i]));
                CHECK_MSG(judge(&s.g, &rays[i], &hits[i], 1.0, NULL) == NULL, "%s: %s: %s", s.name, ray_text(&rays[i]), hit_text(&hits[i]));
            }
        }
        scene_drop(&s);
    }
    CHECK(escapes == 0);
}

/* ---- deep trees: a piece of a plane, one cell thin and 6-separating ---- */

enum { PATCH = 96 }; /* the piece reaches so far from its middle in two axes */

/* Cells with 0 <= n.(c - mid) < max|n|: the thinnest 6-separating plane (Andres 1997), one cell for each place across
   the normal's longest axis. */
static void scene_patch(scene *s, uint32_t depth, const int32_t normal[3], const int32_t mid[3]) {
    int32_t lo[3], n[3], c[3], i, j;
    int m = 0, a;
    for (a = 1; a < 3; a++) if (abs(normal[a]) > abs(normal[m])) m = a;
    memset(s, 0, sizeof *s);
    s->depth = depth;
    s->size = 1 << depth;
    snprintf(s->name, sizeof s->name, "patch depth %u", depth);
    for (a = 0; a < 3; a++) {
        lo[a] = mid[a] - PATCH * (a == m ? 2 : 1) - 2;
        n[a] = PATCH * (a == m ? 4 : 2) + 5;
    }
    if (!oracle_grid_make(&s->g, lo, n)) exit(1);
    for (i = -PATCH; i <= PATCH; i++) for (j = -PATCH; j <= PATCH; j++) {
        int64_t q = (int64_t)normal[(m + 1) % 3] * i + (int64_t)normal[(m + 2) % 3] * j, k, w = normal[m];
        if (w < 0) { w = -w; q = -q; }
        k = -q >= 0 ? (-q + w - 1) / w : -(q / w); /* the least k with q + w*k >= 0 */
        c[(m + 1) % 3] = mid[(m + 1) % 3] + i;
        c[(m + 2) % 3] = mid[(m + 2) % 3] + j;
        c[m] = mid[m] + (int32_t)k;
        oracle_set(&s->g, c[0], c[1], c[2]);
    }
    scene_list(s);
}

TEST(deep_planes_do_not_leak) {
    static const uint32_t depths[] = {9, 10, 12, 13, 16, 19, 20, 20, 20};
    static voxrt_ray rays[BATCH];
    static voxrt_hit ref[BATCH];
    size_t k, batch, i, most = test_quick() ? 1 : 2;
    uint64_t most_steps = 0;
    tally sum;
    memset(&sum, 0, sizeof sum);
    for (k = 0; k < sizeof depths / sizeof depths[0]; k++) {
        scene s;
        int32_t normal[3], mid[3], room = 1 << depths[k];
        test_rng r = test_rng_make(4000 + k);
        int a, m = 0;
        if (test_quick() && k % 2 != 0) continue; /* 9, 12, 16, 20, 20 */
        for (a = 0; a < 3; a++) {
            normal[a] = (int32_t)test_rng_below(&r, 2000001) - 1000000;
            mid[a] = room / 2 + (depths[k] > 10 ? (int32_t)test_rng_below(&r, (uint32_t)room / 4) : 0);
        }
        for (a = 1; a < 3; a++) if (abs(normal[a]) > abs(normal[m])) m = a;
        scene_patch(&s, depths[k], normal, mid);
        for (batch = 0; batch < most; batch++) {
            voxrt_trace_desc d;
            voxrt_stats st;
            float org[3] = {0, 0, 0};
            uint32_t tries = 0;
            for (i = 0; i < BATCH;) { /* from one side to a cell near the middle, or to a corner of it */
                voxrt_ray *q = &rays[i];
                const voxrt_voxel *v;
                double across = 0, longest = 0, len = 0;
                float to[3];
                do v = &s.v[test_rng_below(&r, (uint32_t)s.n)];
                while (abs((int32_t)(m == 0 ? v->y : v->x) - mid[m == 0 ? 1 : 0]) > PATCH / 3 ||
                       abs((int32_t)(m == 2 ? v->y : v->z) - mid[m == 2 ? 1 : 2]) > PATCH / 3);
                to[0] = (float)(v->x + test_rng_below(&r, 2));
                to[1] = (float)(v->y + test_rng_below(&r, 2));
                to[2] = (float)(v->z + test_rng_below(&r, 2));
                for (a = 0; a < 3; a++) {
                    if (batch % 2 == 0 && i % 4 < 2) to[a] += i % 4 == 0 ? test_rng_float(&r) - 0.5f : 0.0f;
                    if (batch % 2 == 0 || i % 64 == 0)
                        org[a] = i % 7 == 0 ? lattice(&r, 0, room, 1) : (float)room * test_rng_range(&r, -0.5f, 1.5f);
                    q->org[a] = org[a];
                    q->dir[a] = to[a] - org[a];
                    len += (double)q->dir[a] * (double)q->dir[a];
                    across += (double)q->dir[a] * normal[a];
                    longest += (double)normal[a] * normal[a];
                }
                q->t_min = 0.0f;
                q->t_max = INFINITY;
                if (fabs(across) > 0.15 * sqrt(len * longest) && fabs(across) > 20.0 * fabs((double)normal[m])) i++;
                else if (++tries % 64 == 0) i -= i % 64; /* not so flat, and from a distance: a run begins again */
            }
            check_rays(&s, rays, NULL, BATCH, &sum);
            memset(&d, 0, sizeof d);
            check_same(s.tree, &d, rays, BATCH, ref);
            d.stats = &st;
            for (i = 0; i < BATCH; i++) {
                CHECK_MSG(ref[i].node != VOXRT_NO_NODE, "%s: escapes: %s", s.name, ray_text(&rays[i]));
                memset(&st, 0, sizeof st);
                CHECK(voxrt_trace(s.tree, &d, &rays[i], &ref[i], 1) == VOXRT_OK);
                CHECK_MSG(st.steps <= 3u * (uint64_t)room, "%s: %d steps: %s", s.name, (int)st.steps, ray_text(&rays[i]));
                if (st.steps > most_steps) most_steps = st.steps;
            }
        }
        scene_drop(&s);
    }
    CHECK_EQ_U64(sum.hits, sum.rays);
    if (test_g.verbose) printf("  %d rays, %d without ties, at most %d steps\n", (int)sum.rays, (int)sum.unique, (int)most_steps);
}

/* ---- levels of detail ---- */

static void coarser(const oracle_grid *g, oracle_grid *out) { /* one level up, from the definition */
    int32_t lo[3], n[3], x, y, z;
    int a;
    for (a = 0; a < 3; a++) {
        lo[a] = g->lo[a] >> 1;
        n[a] = ((g->lo[a] + g->n[a] - 1) >> 1) - lo[a] + 1;
    }
    if (!oracle_grid_make(out, lo, n)) exit(1);
    for (z = 0; z < g->n[2]; z++) for (y = 0; y < g->n[1]; y++) for (x = 0; x < g->n[0]; x++)
        if (oracle_get(g, g->lo[0] + x, g->lo[1] + y, g->lo[2] + z))
            oracle_set(out, (g->lo[0] + x) >> 1, (g->lo[1] + y) >> 1, (g->lo[2] + z) >> 1);
}

static void make_levels(const scene *s, oracle_grid *level) { /* [depth + 1] */
    uint32_t k;
    level[s->depth] = s->g;
    for (k = s->depth; k > 0; k--) coarser(&level[k], &level[k - 1]);
}

static void drop_levels(const scene *s, oracle_grid *level) {
    uint32_t k;
    for (k = 0; k < s->depth; k++) free(level[k].bits);
}

typedef struct collected {
    voxrt_voxel *v;
    size_t n, room, stop_at;
    uint64_t last;  /* Morton code */
    int unsorted;
} collected;

static uint64_t morton_of(uint32_t x, uint32_t y, uint32_t z) {
    uint64_t m = 0;
    int b;
    for (b = 20; b >= 0; b--) m = m << 3 | (uint64_t)(x >> b & 1u) | (uint64_t)(y >> b & 1u) << 1 | (uint64_t)(z >> b & 1u) << 2;
    return m;
}

static int collect(void *user, const voxrt_voxel *v, uint32_t palette_index) {
    collected *c = (collected *)user;
    uint64_t m = morton_of(v->x, v->y, v->z);
    (void)palette_index;
    if (c->n == c->room) {
        c->room = 2 * c->room + 64;
        c->v = (voxrt_voxel *)realloc(c->v, c->room * sizeof *c->v);
        if (c->v == NULL) exit(1);
    }
    if (c->n > 0 && m <= c->last) c->unsorted++;
    c->last = m;
    c->v[c->n++] = *v;
    return c->n == c->stop_at ? 77 : 0;
}

TEST(a_forced_level_is_the_tree_of_that_level) {
    static const struct { uint32_t depth; int kind; } list[] = {{1, HALF}, {2, FEW}, {3, RANDOM}, {4, FEW}, {5, RANDOM}, {6, SHELL}, {7, FEW}};
    static voxrt_ray rays[BATCH];
    static uint8_t wild[BATCH], away[BATCH];
    static voxrt_hit hits[BATCH], ref[BATCH];
    size_t j, i;
    uint32_t k, a;
    for (j = 0; j < sizeof list / sizeof list[0]; j++) {
        scene s;
        oracle_grid level[VOXRT_MAX_DEPTH + 1];
        test_rng r = test_rng_make(5000 + j);
        if (test_quick() && list[j].depth > 6) continue;
        scene_make(&s, list[j].depth, list[j].kind);
        make_levels(&s, level);
        for (i = 0; i < BATCH; i++) {
            wild[i] = away[i] = 0;
            rays[i] = i % 2 != 0 || i >= BATCH / 2 ? general_ray(&r, (float)s.size) : nasty_ray(&r, s.size, &wild[i]);
            if (i > BATCH / 2 && i % 32 != 0) memcpy(rays[i].org, rays[i - 1].org, sizeof rays[i].org);
            for (a = 0; a < 3; a++) away[i] |= fabsf(rays[i].org[a]) > 1e4f * (float)s.size;
            away[i] |= wild[i];
        }
        for (k = 0; k <= s.depth + 2; k++) {
            voxrt_trace_desc d;
            voxrt_build_desc b;
            voxrt_tree *t = NULL;
            collected c;
            uint32_t q = k < s.depth ? k : s.depth;
            memset(&d, 0, sizeof d);
            d.max_level_plus_1 = k + 1;
            check_same(s.tree, &d, rays, BATCH, hits);
            for (i = 0; i < BATCH; i++) {
                const char *why;
                CHECK_MSG(is_miss(&hits[i]) || hits[i].level == q, "%s, level %u: %s", s.name, k, hit_text(&hits[i]));
                if (bad_ray(&rays[i]) || wild[i]) continue;
                why = judge(&level[q], &rays[i], &hits[i], (double)(1u << (s.depth - q)), NULL);
                CHECK_MSG(why == NULL, "%s, level %u: %s: %s: %s", s.name, k, why, ray_text(&rays[i]), hit_text(&hits[i]));
            }
            memset(&c, 0, sizeof c);
            CHECK(voxrt_tree_each(s.tree, q, collect, &c) == 0);
            if (q > 0) {
                memset(&b, 0, sizeof b);
                b.box_size = s.size;
                REQUIRE(voxrt_tree_from_voxels(&b, c.v, c.n, q, &t) == VOXRT_OK);
                CHECK(voxrt_trace(t, NULL, rays, ref, BATCH) == VOXRT_OK);
                for (i = 0; i < BATCH; i++)
                    if (!away[i]) /* of those the last bits depend on the size of the tree */
                    CHECK_MSG(ref[i].t == hits[i].t && memcmp(ref[i].cell, hits[i].cell, sizeof ref[i].cell) == 0 &&
                              ref[i].face == hits[i].face, "%s, level %u, %s: %s, its own tree: %s", s.name, k, ray_text(&rays[i]),
                              hit_text(&hits[i]), hit_text(&ref[i]));
                voxrt_tree_destroy(t);
            }
            free(c.v);
        }
        drop_levels(&s, level);
        scene_drop(&s);
    }
}

/* The first cell that counts as a leaf for a cone, by recursion from the root in doubles. *near_it: some comparison was
   too close to rely on. */
typedef struct cone { const oracle_grid *level; uint32_t depth; const voxrt_ray *r; double width, spread; int near_it; uint32_t hit[4]; double t; } cone;

static int cone_visit(cone *c, uint32_t level, uint32_t x, uint32_t y, uint32_t z) {
    double edge = (double)(1u << (c->depth - level)), lo = (double)c->r->t_min, hi = (double)c->r->t_max, at[8];
    uint32_t cell[3], a, i, order[8], n = 0;
    cell[0] = x;
    cell[1] = y;
    cell[2] = z;
    if (!oracle_get(&c->level[level], (int32_t)x, (int32_t)y, (int32_t)z)) return 0;
    for (a = 0; a < 3; a++) {
        double p = (cell[a] * edge - (double)c->r->org[a]) / (double)c->r->dir[a], q = ((cell[a] + 1) * edge - (double)c->r->org[a]) / (double)c->r->dir[a];
        lo = (p < q ? p : q) > lo ? (p < q ? p : q) : lo;
        hi = (p < q ? q : p) < hi ? (p < q ? q : p) : hi;
    }
    if (fabs(hi - lo) < 1e-9 * (1 + fabs(lo))) c->near_it = 1;
    if (lo >= hi) return 0;
    if (fabs(c->width + c->spread * lo - edge) < 1e-5 * edge) c->near_it = 1;
    if (level == c->depth || edge <= c->width + c->spread * lo) {
        c->hit[0] = x;
        c->hit[1] = y;
        c->hit[2] = z;
        c->hit[3] = level;
        c->t = lo;
        return 1;
    }
    for (i = 0; i < 8; i++) { /* children by their place along the ray: sum over the axes in the ray's order */
        uint32_t k = n++;
        at[i] = 0;
        for (a = 0; a < 3; a++) at[i] += (double)((i >> a & 1u) != 0 ? c->r->dir[a] > 0 : c->r->dir[a] < 0);
        while (k > 0 && at[order[k - 1]] > at[i]) { order[k] = order[k - 1]; k--; }
        order[k] = i;
    }
    for (i = 0; i < 8; i++) /* of those with equal sums the ray meets at most one */
        if (cone_visit(c, level + 1, 2 * x + (order[i] & 1u), 2 * y + (order[i] >> 1 & 1u), 2 * z + (order[i] >> 2))) return 1;
    return 0;
}

static void check_cones(int corners) {
    static const struct { uint32_t depth; int kind; } list[] = {{4, FEW}, {5, RANDOM}, {6, SHELL}, {6, NOISE}, {7, FEW}, {8, FEW}};
    static voxrt_ray rays[BATCH];
    static voxrt_hit hits[BATCH], wider[BATCH];
    size_t j, i, m, coarse = 0, fine = 0, judged = 0;
    for (j = 0; j < sizeof list / sizeof list[0]; j++) {
        scene s;
        oracle_grid level[VOXRT_MAX_DEPTH + 1];
        test_rng r = test_rng_make(6000 + j);
        if (test_quick() && list[j].depth > 6) continue;
        scene_make(&s, list[j].depth, list[j].kind + corners * KINDS);
        make_levels(&s, level);
        for (i = 0; i < BATCH; i++) {
            rays[i] = general_ray(&r, (float)s.size);
            if (i >= BATCH / 2 && i % 64 != 0) memcpy(rays[i].org, rays[i - 1].org, sizeof rays[i].org);
        }
        for (m = 0; m < 6; m++) {
            voxrt_trace_desc d;
            memset(&d, 0, sizeof d);
            d.cone_width = m % 3 == 0 ? 0.0f : m % 3 == 1 ? 0.3f : 2.0f;
            d.cone_spread = m == 0 ? 0.5f : m < 3 ? 4.0f : 40.0f; /* of a t that is about 1 where the ray ends */
            if (m == 5) d.max_level_plus_1 = s.depth;
            check_same(s.tree, &d, rays, BATCH, hits);
            for (i = 0; i < BATCH; i++) {
                cone c;
                int is_hit = hits[i].node != VOXRT_NO_NODE;
                double edge = (double)(1u << (s.depth - hits[i].level)), foot = (double)d.cone_width + (double)d.cone_spread * (double)hits[i].t;
                uint32_t finest = d.max_level_plus_1 != 0 ? s.depth - 1 : s.depth;
                if (bad_ray(&rays[i])) continue;
                if (is_hit) {
                    coarse += hits[i].level < finest;
                    fine += hits[i].level == finest;
                    CHECK_MSG(hits[i].level == finest || edge <= foot * 1.000001, "%s: %s: edge %g, footprint %g: %s", s.name, ray_text(&rays[i]),
                              edge, foot, hit_text(&hits[i]));
                    CHECK(oracle_get(&level[hits[i].level], (int32_t)hits[i].cell[0], (int32_t)hits[i].cell[1], (int32_t)hits[i].cell[2]));
                }
                memset(&c, 0, sizeof c);
                c.level = level;
                c.depth = s.depth;
                c.r = &rays[i];
                c.width = (double)d.cone_width;
                c.spread = (double)d.cone_spread;
                if (m != 5 && rays[i].dir[0] != 0.0f && rays[i].dir[1] != 0.0f && rays[i].dir[2] != 0.0f) {
                    int want = cone_visit(&c, 0, 0, 0, 0);
                    if (c.near_it || (corners && want && c.hit[3] == 0)) continue;
                    judged++;
                    CHECK_MSG(want == is_hit && (!want || (c.hit[3] == hits[i].level && memcmp(c.hit, hits[i].cell, 12) == 0 &&
                              fabs(c.t - (double)hits[i].t) <= 1e-6 * (1e-3 + fabs(c.t)))),
                              "%s, cone %g + %g t, %s: %s, by recursion: %s t %.9g cell %u %u %u level %u", s.name, (double)d.cone_width,
                              (double)d.cone_spread, ray_text(&rays[i]), hit_text(&hits[i]), want ? "hit" : "miss", c.t,
                              c.hit[0], c.hit[1], c.hit[2], c.hit[3]);
                }
            }
            d.cone_width *= 1.5f;
            d.cone_spread *= 1.5f;
            CHECK(voxrt_trace(s.tree, &d, rays, wider, BATCH) == VOXRT_OK);
            for (i = 0; i < BATCH; i++) /* a wider cone never sees farther */
                CHECK_MSG(wider[i].t <= hits[i].t || is_miss(&hits[i]) || rays[i].t_min < 0.0f, "%s: %s: %s, 1.5 times as wide: %s", s.name, ray_text(&rays[i]),
                          hit_text(&hits[i]), hit_text(&wider[i]));
        }
        drop_levels(&s, level);
        scene_drop(&s);
    }
    CHECK_MSG(coarse > 1000 && fine > 1000 && judged > 10000, "%d %d %d", (int)coarse, (int)fine, (int)judged);
    if (test_g.verbose) printf("  %d coarse, %d fine hits, %d judged\n", (int)coarse, (int)fine, (int)judged);
}

TEST(cones_stop_at_the_level_of_their_width) { check_cones(1); }

TEST(endless_cones) { /* as wide as floats go: the same from each isa */
    static const float odd[4][2] = {{0.0f, INFINITY}, {INFINITY, INFINITY}, {1e-45f, 3e38f}, {3e38f, 0.0f}};
    static voxrt_ray rays[BATCH];
    static voxrt_hit ref[BATCH];
    uint32_t depth, k, i;
    uint8_t wild;
    test_rng r = test_rng_make(77);
    for (depth = 1; depth < 6; depth += 2) {
        scene s;
        scene_make(&s, depth, RANDOM);
        for (k = 0; k < 4; k++) {
            voxrt_trace_desc d;
            memset(&d, 0, sizeof d);
            d.cone_width = odd[k][0];
            d.cone_spread = odd[k][1];
            for (i = 0; i < 640; i++) {
                rays[i] = nasty_ray(&r, s.size, &wild);
                if (i % 2 != 0) memcpy(rays[i].org, rays[i - 1].org, sizeof rays[i].org);
            }
            check_same(s.tree, &d, rays, 640, ref);
        }
        scene_drop(&s);
    }
}

/* ---- trees ---- */

TEST(every_level_holds_the_cells_of_the_grid) {
    static const struct { uint32_t depth; int kind; } list[] = {{1, CORNERS}, {1, HALF}, {2, RANDOM}, {2, FULL},
        {3, HALF}, {4, FEW}, {5, SOLID}, {6, WALLS}, {7, SHELL}};
    size_t j, i;
    for (j = 0; j < sizeof list / sizeof list[0]; j++) {
        scene s;
        oracle_grid level[VOXRT_MAX_DEPTH + 1];
        voxrt_tree_info info;
        test_rng r = test_rng_make(7000 + j);
        uint32_t k, lo[3] = {~0u, ~0u, ~0u}, hi[3] = {0, 0, 0};
        scene_make(&s, list[j].depth, list[j].kind);
        make_levels(&s, level);
        voxrt_tree_get_info(s.tree, &info);
        for (i = 0; i < s.n; i++) {
            uint32_t c[3], a;
            c[0] = s.v[i].x;
            c[1] = s.v[i].y;
            c[2] = s.v[i].z;
            for (a = 0; a < 3; a++) {
                lo[a] = c[a] < lo[a] ? c[a] : lo[a];
                hi[a] = c[a] + 1 > hi[a] ? c[a] + 1 : hi[a];
            }
        }
        CHECK(memcmp(info.cell_min, lo, sizeof lo) == 0 && memcmp(info.cell_max, hi, sizeof hi) == 0);
        CHECK(info.depth == s.depth && info.voxel_count == s.n && info.voxel_size == 1.0 && info.world_origin[0] == 0.0);
        for (k = 0; k <= s.depth; k++) {
            collected c;
            size_t found = 0;
            int32_t x, y, z, size = 1 << k;
            memset(&c, 0, sizeof c);
            for (z = -1; z <= size; z++) for (y = -1; y <= size; y++) for (x = -1; x <= size; x++) {
                int want = oracle_get(&level[k], x, y, z), got;
                voxrt_voxel v;
                if (k > 5 && !want && (x + y + z) % 3 != 0) continue;
                memset(&v, 0xee, sizeof v);
                got = voxrt_tree_get(s.tree, k, (uint32_t)x, (uint32_t)y, (uint32_t)z, found % 2 != 0 ? &v : NULL);
                CHECK_MSG(got == want, "%s, level %u, cell %d %d %d: get says %d", s.name, k, x, y, z, got);
                if (want && got && found % 2 != 0)
                    CHECK(v.x == (uint32_t)x && v.y == (uint32_t)y && v.z == (uint32_t)z && v.has_normal == 0);
                found += (size_t)want;
            }
            CHECK_EQ_U64(info.level_count[k], found);
            CHECK(voxrt_tree_each(s.tree, k, collect, &c) == 0);
            CHECK_EQ_U64(c.n, found);
            CHECK(c.unsorted == 0);
            for (i = 0; i < c.n; i++) CHECK(oracle_get(&level[k], (int32_t)c.v[i].x, (int32_t)c.v[i].y, (int32_t)c.v[i].z));
            c.stop_at = 1 + test_rng_below(&r, (uint32_t)found);
            c.n = 0;
            CHECK(voxrt_tree_each(s.tree, k, collect, &c) == 77 && c.n == c.stop_at);
            free(c.v);
        }
        for (; k <= VOXRT_MAX_DEPTH; k++) CHECK_EQ_U64(info.level_count[k], 0);
        CHECK(voxrt_tree_get(s.tree, s.depth + 1, 0, 0, 0, NULL) == 0);
        CHECK(voxrt_tree_get(s.tree, 0, 1, 0, 0, NULL) == 0 && voxrt_tree_get(s.tree, 0, 0, 0, 0, NULL) == 1);
        drop_levels(&s, level);
        scene_drop(&s);
    }
}

TEST(order_and_copies_of_voxels_do_not_matter) {
    scene s;
    voxrt_voxel *v;
    voxrt_tree *t = NULL;
    voxrt_build_desc d;
    test_rng r = test_rng_make(8);
    size_t i;
    uint32_t threads;
    scene_make(&s, 6, RANDOM);
    v = (voxrt_voxel *)malloc(2 * s.n * sizeof *v);
    REQUIRE(v != NULL);
    for (i = 0; i < 2 * s.n; i++) v[i] = s.v[i % s.n];
    for (i = 2 * s.n; i > 1; i--) {
        size_t j = test_rng_below(&r, (uint32_t)i);
        voxrt_voxel q = v[i - 1];
        v[i - 1] = v[j];
        v[j] = q;
    }
    for (threads = 0; threads < 4; threads++) {
        memset(&d, 0, sizeof d);
        d.env.thread_count = threads;
        d.disable_colors = d.disable_normals = 1;
        REQUIRE(voxrt_tree_from_voxels(&d, v, 2 * s.n, s.depth, &t) == VOXRT_OK);
        CHECK_EQ_U64(voxrt_tree_hash(t), voxrt_tree_hash(s.tree));
        voxrt_tree_destroy(t);
    }
    free(v);
    scene_drop(&s);
}

/* ---- calls ---- */

TEST(steps_are_bounded_and_counted) {
    static const struct { uint32_t depth; int kind; } list[] = {{1, CORNERS}, {3, RANDOM}, {4, CHECKER}, {6, FEW}, {7, WALLS}, {9, FEW}};
    voxrt_trace_desc d;
    voxrt_stats st, sum;
    size_t j, i, k, n = test_quick() ? 2000 : 10000;
    memset(&d, 0, sizeof d);
    for (j = 0; j < sizeof list / sizeof list[0]; j++) {
        scene s;
        test_rng r = test_rng_make(9000 + j);
        uint64_t most = 0;
        scene_make(&s, list[j].depth, list[j].kind);
        for (k = 0; k < isa_count; k++) {
            memset(&sum, 0, sizeof sum);
            for (i = 0; i < n; i++) {
                uint8_t wild, occ;
                voxrt_ray q = i % 2 != 0 ? general_ray(&r, (float)s.size) : nasty_ray(&r, s.size, &wild);
                voxrt_hit h;
                memset(&st, 0, sizeof st);
                d.isa = isas[k];
                d.stats = &st;
                CHECK(voxrt_trace(s.tree, &d, &q, &h, 1) == VOXRT_OK);
                CHECK_MSG(st.steps <= 3u * (uint64_t)s.size, "%s, isa %d: %d steps: %s", s.name, (int)d.isa, (int)st.steps, ray_text(&q));
                CHECK_MSG(st.descents <= (st.steps + 1) * (s.depth + 1), "%s: %d descents", s.name, (int)st.descents);
                CHECK(st.rays == 1 && st.hits == (h.node != VOXRT_NO_NODE) && st.bad_rays == (uint64_t)bad_ray(&q));
                if (st.bad_rays != 0) CHECK(st.steps == 0 && st.descents == 0);
                most = st.steps > most ? st.steps : most;
                d.stats = &sum;
                CHECK(voxrt_occluded(s.tree, &d, &q, &occ, 1) == VOXRT_OK);
                CHECK(sum.rays == i + 1);
            }
        }
        CHECK_MSG(list[j].kind != WALLS || most > 20, "%d", (int)most);
        scene_drop(&s);
    }
}

TEST(any_count_and_any_alignment) {
    static const size_t counts[] = {0, 1, 2, 3, 4, 5, 7, 8, 9, 15, 16, 17, 31, 33, 63, 64, 65, 127, 129, 1000};
    scene s;
    size_t c, k, off, i;
    float *ray_room = (float *)malloc(1010 * sizeof(voxrt_ray));
    uint32_t *hit_room = (uint32_t *)malloc(1010 * sizeof(voxrt_hit));
    uint8_t occ[1100];
    test_rng r = test_rng_make(10);
    scene_make(&s, 5, RANDOM);
    REQUIRE(ray_room != NULL && hit_room != NULL);
    for (c = 0; c < sizeof counts / sizeof counts[0]; c++) for (k = 0; k < 5; k++) for (off = 0; off < 6; off++) {
        size_t n = counts[c];
        voxrt_trace_desc d;
        voxrt_ray *rays = (voxrt_ray *)(void *)(ray_room + off);           /* aligned as a float, no more */
        voxrt_hit *hits = (voxrt_hit *)(void *)(hit_room + 1 + (off * 5) % 6);
        uint32_t *end = (uint32_t *)(void *)(hits + n);
        memset(&d, 0, sizeof d);
        d.isa = isas[k];
        for (i = 0; i < n; i++) {
            rays[i] = general_ray(&r, (float)s.size);
            if (off % 2 != 0 && i > 0) memcpy(rays[i].org, rays[0].org, sizeof rays[i].org);
        }
        memset(hit_room, 0x77, 1010 * sizeof(voxrt_hit));
        memset(occ, 0x77, sizeof occ);
        CHECK(voxrt_trace(s.tree, &d, rays, hits, n) == VOXRT_OK);
        CHECK(voxrt_occluded(s.tree, &d, rays, occ + 1 + off, n) == VOXRT_OK);
        CHECK(hits[-1].face == 0x77 && ((uint32_t *)(void *)hits)[-1] == 0x77777777u);
        for (i = 0; i < 6; i++) CHECK(end[i] == 0x77777777u);
        CHECK(occ[off] == 0x77 && occ[1 + off + n] == 0x77);
        for (i = 0; i < n; i++) {
            voxrt_hit h;
            int one = voxrt_trace1(s.tree, &rays[i], &h);
            CHECK_MSG(same_hit(&h, &hits[i]), "isa %d, %d of %d: %s: %s, alone: %s", (int)d.isa, (int)i, (int)n,
                      ray_text(&rays[i]), hit_text(&hits[i]), hit_text(&h));
            CHECK(occ[1 + off + i] == one);
        }
    }
    CHECK(voxrt_trace(s.tree, NULL, NULL, NULL, 0) == VOXRT_OK);
    CHECK(voxrt_occluded(s.tree, NULL, NULL, NULL, 0) == VOXRT_OK);
    CHECK(voxrt_trace(NULL, NULL, NULL, NULL, 0) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_occluded(NULL, NULL, NULL, NULL, 0) == VOXRT_ERR_INVALID_ARG);
    free(ray_room);
    free(hit_room);
    scene_drop(&s);
}

TEST(wrong_arguments_are_refused) {
    voxrt_voxel v[3];
    voxrt_build_desc b;
    voxrt_trace_desc d;
    voxrt_error err;
    voxrt_tree *t = NULL;
    voxrt_ray q = ray_of(0, 0, 0, 1, 1, 1);
    voxrt_hit h;
    uint8_t occ;
    memset(v, 0, sizeof v);
    memset(&b, 0, sizeof b);
    memset(&d, 0, sizeof d);
    memset(&err, 0, sizeof err);
    v[1].x = 3;
    v[2].y = 4;
    b.env.error = &err;
    wrong_calls = 1;
    t = (voxrt_tree *)(void *)&q;
    CHECK(voxrt_tree_from_voxels(&b, v, 3, 2, &t) == VOXRT_ERR_RANGE && t == NULL && err.code == VOXRT_ERR_RANGE && err.where == 2);
    CHECK(err.text[0] != 0);
    CHECK(voxrt_tree_from_voxels(NULL, v, 0, 2, &t) == VOXRT_ERR_EMPTY && t == NULL);
    CHECK(voxrt_tree_from_voxels(NULL, v, 2, 0, &t) != VOXRT_OK && t == NULL);
    CHECK(voxrt_tree_from_voxels(NULL, v, 2, VOXRT_MAX_DEPTH + 1, &t) != VOXRT_OK && t == NULL);
    CHECK(voxrt_tree_from_voxels(NULL, NULL, 2, 2, &t) == VOXRT_ERR_INVALID_ARG && t == NULL);
    CHECK(voxrt_tree_from_voxels(NULL, v, 2, 2, NULL) == VOXRT_ERR_INVALID_ARG);
    b.env.error = NULL;
    b._begin_zero = 1;
    CHECK(voxrt_tree_from_voxels(&b, v, 2, 2, &t) == VOXRT_ERR_UNINIT_DESC && t == NULL);
    b._begin_zero = 0;
    b._end_zero = 0xcdcdcdcdu;
    CHECK(voxrt_tree_from_voxels(&b, v, 2, 2, &t) == VOXRT_ERR_UNINIT_DESC && t == NULL);
    b._end_zero = 0;
    b.box_size = (double)NAN;
    if (voxrt_tree_from_voxels(&b, v, 2, 2, &t) == VOXRT_OK) test_fail(__FILE__, __LINE__, "a NaN as box_size is accepted");
    b.box_size = 1.0;
    b.box_min[1] = (double)INFINITY;
    if (voxrt_tree_from_voxels(&b, v, 2, 2, &t) == VOXRT_OK) test_fail(__FILE__, __LINE__, "an infinite box_min is accepted");
    b.box_min[1] = 0.0;
    { /* boxes whose cells, or the reciprocals of them, are no doubles; what is accepted can be saved and loaded */
        static const double size[7] = {1e-320, 1e-301, 1e301, 1.7e308, 1.0, 1e-300, 1e300}, low[7] = {0, 0, 0, 0, -1e301, 1e300, -1e300};
        static uint8_t file[4096];
        size_t n;
        uint32_t k;
        for (k = 0; k < 7; k++) {
            voxrt_tree *again = NULL;
            b.box_size = size[k];
            b.box_min[1] = low[k];
            CHECK_EQ_U64(voxrt_tree_from_voxels(&b, v, 2, 20, &t), k < 5 ? VOXRT_ERR_RANGE : VOXRT_OK);
            CHECK((t != NULL) == (k >= 5));
            if (t == NULL) continue;
            CHECK(voxrt_tree_save_memory(t, NULL, file, sizeof file, &n) == VOXRT_OK && voxrt_tree_load_memory(NULL, file, n, &again) == VOXRT_OK);
            CHECK(again != NULL && voxrt_tree_hash(again) == voxrt_tree_hash(t));
            voxrt_tree_destroy(again);
            voxrt_tree_destroy(t);
        }
    }
    REQUIRE(voxrt_tree_from_voxels(NULL, v, 2, 2, &t) == VOXRT_OK);
    memset(&h, 0x31, sizeof h);
    d._begin_zero = 5;
    CHECK(voxrt_trace(t, &d, &q, &h, 1) == VOXRT_ERR_UNINIT_DESC && voxrt_occluded(t, &d, &q, &occ, 1) == VOXRT_ERR_UNINIT_DESC);
    d._begin_zero = 0;
    d._end_zero = 5;
    CHECK(voxrt_trace(t, &d, &q, &h, 1) == VOXRT_ERR_UNINIT_DESC && voxrt_occluded(t, &d, &q, &occ, 1) == VOXRT_ERR_UNINIT_DESC);
    d._end_zero = 0;
    CHECK(voxrt_trace(NULL, &d, &q, &h, 1) == VOXRT_ERR_INVALID_ARG && voxrt_occluded(NULL, &d, &q, &occ, 1) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_trace(t, &d, NULL, &h, 1) == VOXRT_ERR_INVALID_ARG && voxrt_occluded(t, &d, NULL, &occ, 1) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_trace(t, &d, &q, NULL, 1) == VOXRT_ERR_INVALID_ARG && voxrt_occluded(t, &d, &q, NULL, 1) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_trace(t, &d, &q, &h, 1) == VOXRT_OK && h.level == 2);
    wrong_calls = 0;
    voxrt_tree_destroy(t);
    voxrt_tree_destroy(NULL);
}

TEST(no_memory_at_any_place) {
    scene s;
    voxrt_build_desc d;
    voxrt_tree *t = NULL;
    test_alloc ta;
    int64_t k;
    size_t i;
    int after;
    scene_make(&s, 5, RANDOM);
    for (i = 0; i < s.n; i++) {
        s.v[i].rgb[0] = (uint8_t)i;
        s.v[i].has_normal = 1;
        s.v[i].normal[i % 3] = 1.0f;
    }
    for (after = 0; after < 2; after++) for (k = 0; k < 1000; k++) {
        voxrt_result result;
        test_alloc_init(&ta);
        ta.fail_at = k;
        ta.fail_after = after;
        memset(&d, 0, sizeof d);
        d.env.allocator.alloc_fn = test_alloc_fn;
        d.env.allocator.free_fn = test_free_fn;
        d.env.allocator.user = &ta;
        d.env.thread_count = 1 + (uint32_t)k % 2;
        t = (voxrt_tree *)(void *)&ta;
        result = voxrt_tree_from_voxels(&d, s.v, s.n, s.depth, &t);
        if (result == VOXRT_OK) voxrt_tree_destroy(t);
        else CHECK_MSG(result == VOXRT_ERR_NO_MEMORY && t == NULL, "allocation %d fails: result %d", (int)k, (int)result);
        test_alloc_check(&ta);
        if (ta.failed == 0) break;
        CHECK_MSG(result == VOXRT_ERR_NO_MEMORY, "allocation %d fails, yet a tree is made", (int)k);
    }
    CHECK(k >= 2 && k < 1000);
    test_alloc_init(&ta); /* a limit */
    d.env.memory_limit = 1000;
    CHECK(voxrt_tree_from_voxels(&d, s.v, s.n, s.depth, &t) == VOXRT_ERR_NO_MEMORY && t == NULL && ta.peak_bytes <= 1000);
    test_alloc_check(&ta);
    scene_drop(&s);
}

/* ---- placement in the world ---- */

TEST(placement_by_powers_of_two_changes_no_bit) {
    static const int scales[] = {-20, -3, 0, 5, 20};
    static const float shifts[] = {0.0f, 1024.0f, -4096.0f};
    scene s;
    size_t j, k, i;
    static voxrt_ray rays[BATCH], moved[BATCH];
    static voxrt_hit ref[BATCH], hits[BATCH];
    test_rng r = test_rng_make(11);
    scene_make(&s, 6, RANDOM);
    for (i = 0; i < BATCH; i++) { /* numbers with few bits, so that the moved rays are exact */
        int a;
        rays[i] = ray_of(0, 0, 0, 0, 0, 0);
        for (a = 0; a < 3; a++) {
            rays[i].org[a] = lattice(&r, -64, 128, 0) + 1.0f / 64.0f * (float)test_rng_below(&r, 8);
            rays[i].dir[a] = lattice(&r, 0, 64, 0) - rays[i].org[a];
        }
        if (i % 64 != 0) memcpy(rays[i].org, rays[i - 1].org, sizeof rays[i].org);
        if (i % 64 != 0 && i >= BATCH / 2) { /* a camera tile */
            memcpy(rays[i].dir, rays[i & ~(size_t)63].dir, sizeof rays[i].dir);
            rays[i].dir[i / 64 % 3] += (float)(i % 8) / 16.0f;
            rays[i].dir[i / 64 % 2 + 1] -= (float)(i / 8 % 8) / 16.0f;
        }
        if (i % 3 == 0) rays[i].t_max = test_rng_float(&r);
    }
    CHECK(voxrt_trace(s.tree, NULL, rays, ref, BATCH) == VOXRT_OK);
    for (j = 0; j < sizeof scales / sizeof scales[0]; j++) for (k = 0; k < sizeof shifts / sizeof shifts[0]; k++) {
        voxrt_build_desc d;
        voxrt_tree *t = NULL;
        voxrt_tree_info info;
        float f = ldexpf(1.0f, scales[j]);
        int a;
        memset(&d, 0, sizeof d);
        d.box_size = (double)f * s.size;
        for (a = 0; a < 3; a++) d.box_min[a] = (double)(shifts[k] * f) * (a == 1 ? -1.0 : 1.0);
        REQUIRE(voxrt_tree_from_voxels(&d, s.v, s.n, s.depth, &t) == VOXRT_OK);
        voxrt_tree_get_info(t, &info);
        CHECK(info.voxel_size == (double)f && memcmp(info.world_origin, d.box_min, sizeof d.box_min) == 0);
        for (i = 0; i < BATCH; i++) {
            moved[i] = rays[i];
            for (a = 0; a < 3; a++) {
                moved[i].org[a] = (rays[i].org[a] + (a == 1 ? -shifts[k] : shifts[k])) * f;
                moved[i].dir[a] = rays[i].dir[a] * f;
            }
        }
        CHECK(voxrt_trace(t, NULL, moved, hits, BATCH) == VOXRT_OK);
        for (i = 0; i < BATCH; i++)
            CHECK_MSG(same_hit(&hits[i], &ref[i]), "scale 2^%d, shift %g: %s: %s, at home %s: %s", scales[j], (double)shifts[k],
                      ray_text(&moved[i]), hit_text(&hits[i]), ray_text(&rays[i]), hit_text(&ref[i]));
        voxrt_tree_destroy(t);
    }
    scene_drop(&s);
}

/* What holds in any placement: the hit cell is met at t but for `eps` cells, and no filled cell is crossed before by more
   than that. o, d: the ray in cells, in doubles. */
static const char *judge_roughly(const oracle_grid *g, const double o[3], const double d[3], const voxrt_hit *h, double eps) {
    double len = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]), end = (double)h->t, lo = 0, hi = HUGE_VAL, t;
    int a;
    if (h->node != VOXRT_NO_NODE)
        for (a = 0; a < 3; a++) {
            double p = o[a] + end * d[a];
            if (p < h->cell[a] - eps || p > h->cell[a] + 1.0 + eps) return "the hit cell is not there";
            if (!oracle_get(g, (int32_t)h->cell[0], (int32_t)h->cell[1], (int32_t)h->cell[2])) return "the hit cell is empty";
        }
    for (a = 0; a < 3; a++) {
        double p = (g->lo[a] - o[a]) / d[a], q = (g->lo[a] + g->n[a] - o[a]) / d[a];
        if (d[a] == 0) { if (o[a] < g->lo[a] || o[a] > g->lo[a] + g->n[a]) return NULL; continue; }
        lo = (p < q ? p : q) > lo ? (p < q ? p : q) : lo;
        hi = (p < q ? q : p) < hi ? (p < q ? q : p) : hi;
    }
    for (t = lo; t < hi && t < end;) { /* cell by cell: the middle of each piece between planes tells the cell */
        double next = hi, m;
        for (a = 0; a < 3; a++) {
            double q, p = o[a] + t * d[a];
            if (d[a] == 0) continue;
            q = ((d[a] > 0 ? floor(p + 1e-9) + 1 : ceil(p - 1e-9) - 1) - o[a]) / d[a];
            next = q < next ? q : next;
        }
        m = 0.5 * (t + next);
        if ((next - t) * len > eps && t * len + eps < end * len &&
            oracle_get(g, (int32_t)floor(o[0] + m * d[0]), (int32_t)floor(o[1] + m * d[1]), (int32_t)floor(o[2] + m * d[2])))
            return h->node != VOXRT_NO_NODE && fabs(t - end) * len <= eps ? NULL : "a filled cell is crossed before";
        t = next > t ? next : t + 1e-9 / len;
    }
    return NULL;
}

TEST(any_placement_in_the_world) {
    static const double sizes[] = {1e-6, 1e-3, 0.37, 1.0, 33.3, 1e6};
    scene s;
    size_t j, k, i;
    static voxrt_ray rays[BATCH];
    static voxrt_hit hits[BATCH];
    test_rng r = test_rng_make(12);
    scene_make(&s, 6, RANDOM);
    for (j = 0; j < sizeof sizes / sizeof sizes[0]; j++) for (k = 0; k < 4; k++) {
        voxrt_build_desc d;
        voxrt_trace_desc td;
        if (test_quick() && (j + k) % 3 != 0) continue;
        voxrt_tree *t = NULL;
        voxrt_tree_info info;
        size_t found = 0;
        int a;
        memset(&d, 0, sizeof d);
        memset(&td, 0, sizeof td);
        d.box_size = sizes[j] * s.size;
        for (a = 0; a < 3; a++) d.box_min[a] = k == 0 ? 0.0 : (k == 1 ? -0.5 : k == 2 ? 100.1 : 1e4 + a) * d.box_size;
        REQUIRE(voxrt_tree_from_voxels(&d, s.v, s.n, s.depth, &t) == VOXRT_OK);
        voxrt_tree_get_info(t, &info);
        for (i = 0; i < BATCH; i++) {
            voxrt_ray q = general_ray(&r, (float)s.size);
            q.t_min = 0.0f;
            q.t_max = INFINITY;
            for (a = 0; a < 3; a++) {
                q.org[a] = (float)(info.world_origin[a] + info.voxel_size * (double)q.org[a]);
                q.dir[a] = (float)(info.voxel_size * (double)q.dir[a]);
            }
            if (i % 64 != 0 && i >= BATCH / 2) { /* a camera tile */
                q = rays[i & ~(size_t)63];
                for (a = 0; a < 3; a++)
                    q.dir[a] += (float)info.voxel_size * (a == (int)(i / 64 % 3) ? (float)(i % 8) * 0.07f : (float)(i / 8 % 8) * 0.05f);
            }
            rays[i] = q;
        }
        check_same(t, &td, rays, BATCH, hits);
        for (i = 0; i < BATCH; i++) {
            double o[3], dir[3];
            const char *why;
            for (a = 0; a < 3; a++) {
                o[a] = ((double)rays[i].org[a] - info.world_origin[a]) / info.voxel_size;
                dir[a] = (double)rays[i].dir[a] / info.voxel_size;
            }
            found += hits[i].node != VOXRT_NO_NODE;
            why = judge_roughly(&s.g, o, dir, &hits[i], 1e-4);
            CHECK_MSG(why == NULL, "voxel %g, %d: %s: %s: %s", sizes[j], (int)k, why, ray_text(&rays[i]), hit_text(&hits[i]));
        }
        CHECK(found > BATCH / 4);
        voxrt_tree_destroy(t);
    }
    scene_drop(&s);
}

/* Mirrored and turned scenes give the same times; cells and faces turn with them. Ties may fall differently: general rays. */
TEST(turned_and_mirrored_scenes_agree) {
    static const int turns[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
    static voxrt_ray rays[BATCH], turned[BATCH];
    static voxrt_hit ref[BATCH], hits[BATCH];
    scene s;
    size_t i;
    int k, flip, a;
    test_rng r = test_rng_make(13);
    scene_make(&s, 6, RANDOM);
    for (i = 0; i < BATCH; i++) { /* a lattice of origins: size - x is exact; directions in general position */
        rays[i] = ray_of(lattice(&r, -64, 128, 0), lattice(&r, -64, 128, 0), lattice(&r, -64, 128, 0), 0, 0, 0);
        for (a = 0; a < 3; a++) rays[i].dir[a] = 64.0f * test_rng_float(&r) - rays[i].org[a] + 1e-3f;
        if (i % 64 != 0) memcpy(rays[i].org, rays[i - 1].org, sizeof rays[i].org);
        if (i % 64 != 0 && i >= BATCH / 2) /* a camera tile */
            for (a = 0; a < 3; a++) rays[i].dir[a] = rays[i - 1].dir[a] + 0.1f * test_rng_float(&r);
    }
    CHECK(voxrt_trace(s.tree, NULL, rays, ref, BATCH) == VOXRT_OK);
    for (k = 0; k < 6; k++) for (flip = 0; flip < 8; flip++) {
        voxrt_voxel *v = (voxrt_voxel *)calloc(s.n, sizeof *v);
        voxrt_tree *t = NULL;
        REQUIRE(v != NULL);
        for (i = 0; i < s.n; i++) {
            uint32_t c[3], q[3];
            c[0] = s.v[i].x;
            c[1] = s.v[i].y;
            c[2] = s.v[i].z;
            for (a = 0; a < 3; a++) q[a] = (flip >> a & 1) != 0 ? 63 - c[turns[k][a]] : c[turns[k][a]];
            v[i].x = q[0];
            v[i].y = q[1];
            v[i].z = q[2];
        }
        REQUIRE(voxrt_tree_from_voxels(NULL, v, s.n, s.depth, &t) == VOXRT_OK);
        for (i = 0; i < BATCH; i++) {
            turned[i] = rays[i];
            for (a = 0; a < 3; a++) {
                float o = rays[i].org[turns[k][a]], d = rays[i].dir[turns[k][a]];
                turned[i].org[a] = (flip >> a & 1) != 0 ? 64.0f - o : o;
                turned[i].dir[a] = (flip >> a & 1) != 0 ? -d : d;
            }
        }
        CHECK(voxrt_trace(t, NULL, turned, hits, BATCH) == VOXRT_OK);
        for (i = 0; i < BATCH; i++) {
            int same = hits[i].t == ref[i].t && hits[i].level == ref[i].level;
            int on_plane = 0;
            for (a = 0; a < 3; a++) {
                uint32_t c = ref[i].cell[turns[k][a]];
                on_plane |= rays[i].org[a] == floorf(rays[i].org[a]);
                if (ref[i].node != VOXRT_NO_NODE) same = same && hits[i].cell[a] == ((flip >> a & 1) != 0 ? 63 - c : c);
                if (ref[i].face / 2 == turns[k][a] && ref[i].face < 6 && ref[i].node != VOXRT_NO_NODE)
                    same = same && hits[i].face == (uint8_t)(2 * a + (int)((ref[i].face & 1u) ^ (uint32_t)(flip >> a & 1)));
            }
            CHECK_MSG(same || on_plane, "turn %d, flip %d: %s: %s, before %s: %s", k, flip, ray_text(&turned[i]),
                      hit_text(&hits[i]), ray_text(&rays[i]), hit_text(&ref[i]));
        }
        voxrt_tree_destroy(t);
        free(v);
    }
    scene_drop(&s);
}

/* ---- attributes: node and slot of a hit lead to the cell that was hit ---- */

TEST(hits_lead_to_the_attributes_of_their_cell) {
    uint32_t depth, k;
    size_t i, seen = 0, many = 0;
    for (depth = 1; depth <= 6; depth++) {
        scene s;
        voxrt_build_desc b;
        voxrt_tree *t = NULL;
        voxrt_tree_info info;
        test_rng r = test_rng_make(14 + depth);
        scene_make(&s, depth, depth < 4 ? HALF : RANDOM);
        for (i = 0; i < s.n; i++) {
            s.v[i].rgb[0] = (uint8_t)(i * 7);
            s.v[i].rgb[1] = (uint8_t)(i >> 5);
            s.v[i].rgb[2] = (uint8_t)(i >> 8);
            s.v[i].has_normal = 1;
            s.v[i].normal[0] = (float)s.v[i].x - 3.5f;
            s.v[i].normal[1] = (float)s.v[i].y * 0.5f - 3.3f;
            s.v[i].normal[2] = (float)s.v[i].z * 0.25f - 1.7f;
        }
        memset(&b, 0, sizeof b);
        REQUIRE(voxrt_tree_from_voxels(&b, s.v, s.n, depth, &t) == VOXRT_OK);
        voxrt_tree_get_info(t, &info);
        many += info.palette_count > 100;
        for (k = 0; k <= depth; k++) for (i = 0; i < 2000; i++) {
            voxrt_ray q = general_ray(&r, (float)s.size);
            voxrt_trace_desc d;
            voxrt_hit h;
            voxrt_voxel v;
            uint8_t rgb[3];
            float n[3];
            memset(&d, 0, sizeof d);
            d.max_level_plus_1 = k + 1;
            CHECK(voxrt_trace(t, &d, &q, &h, 1) == VOXRT_OK);
            if (h.node == VOXRT_NO_NODE) continue;
            seen++;
            CHECK(h.level == k && voxrt_tree_get(t, k, h.cell[0], h.cell[1], h.cell[2], &v) == 1);
            voxrt_hit_color(t, &h, rgb);
            voxrt_hit_normal(t, &h, n);
            CHECK_MSG(memcmp(rgb, v.rgb, 3) == 0, "depth %u, %s: colour %d %d %d, the cell has %d %d %d", depth, hit_text(&h), rgb[0], rgb[1], rgb[2],
                      v.rgb[0], v.rgb[1], v.rgb[2]);
            if (v.has_normal) CHECK_MSG(memcmp(n, v.normal, sizeof n) == 0, "depth %u, %s: normal %g %g %g, the cell has %g %g %g", depth, hit_text(&h),
                (double)n[0], (double)n[1], (double)n[2], (double)v.normal[0], (double)v.normal[1], (double)v.normal[2]);
            if (v.has_normal) CHECK_NEAR(n[0] * n[0] + n[1] * n[1] + n[2] * n[2], 1, 1e-5);
        }
        voxrt_tree_destroy(t);
        scene_drop(&s);
    }
    CHECK(seen > 10000);
    if (many == 0) SKIP("no palette in this header");
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    isa_count = (size_t)voxrti_cpu_level();
    RUN(general_rays);
    RUN(windows_in_deep_grids);
    RUN(nasty_rays);
    RUN(runs_of_one_origin);
    RUN(closed_shells_do_not_leak);
    RUN(deep_planes_do_not_leak);
    RUN(a_forced_level_is_the_tree_of_that_level);
    RUN(cones_stop_at_the_level_of_their_width);
    RUN(endless_cones);
    RUN(every_level_holds_the_cells_of_the_grid);
    RUN(order_and_copies_of_voxels_do_not_matter);
    RUN(steps_are_bounded_and_counted);
    RUN(any_count_and_any_alignment);
    RUN(wrong_arguments_are_refused);
    RUN(no_memory_at_any_place);
    RUN(placement_by_powers_of_two_changes_no_bit);
    RUN(any_placement_in_the_world);
    RUN(turned_and_mirrored_scenes_agree);
    RUN(hits_lead_to_the_attributes_of_their_cell);
    return test_end();
}
