/* Trees from voxels and rays through them, judged by exact stepping (oracle.h). */
#include "test.h"
static int wrong_calls; /* set while a test makes calls that the library asserts against */
#define VOXRT_ASSERT(cond) ((void)((cond) || wrong_calls || (abort(), 0)))
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

static void scene_make(scene *s, uint32_t depth, int kind) {
    static const char *const names[KINDS] = {"few", "random", "half", "shell", "solid", "noise", "checker", "full", "walls", "corners"};
    int32_t lo[3] = {0, 0, 0}, n[3], x, y, z, i;
    test_rng r = test_rng_make((uint64_t)(kind * 100) + depth);
    memset(s, 0, sizeof *s);
    s->depth = depth;
    s->size = 1 << depth;
    n[0] = n[1] = n[2] = s->size;
    snprintf(s->name, sizeof s->name, "%s depth %u", names[kind], depth);
    if (!oracle_grid_make(&s->g, lo, n)) exit(1);
    if (kind == FEW) {
        for (i = 0; i < 40; i++)
            oracle_set(&s->g, (int32_t)(test_rng_u32(&r) & (uint32_t)(s->size - 1)),
                       (int32_t)(test_rng_u32(&r) & (uint32_t)(s->size - 1)), (int32_t)(test_rng_u32(&r) & (uint32_t)(s->size - 1)));
    } else if (kind == CORNERS) {
        for (i = 0; i < 8; i++)
            oracle_set(&s->g, (i & 1) != 0 ? s->size - 1 : 0, (i & 2) != 0 ? s->size - 1 : 0, (i & 4) != 0 ? s->size - 1 : 0);
    } else for (z = 0; z < s->size; z++) for (y = 0; y < s->size; y++) for (x = 0; x < s->size; x++) {
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
           h->_reserved == 0 && h->face <= 6;
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
        size_t want = list[k].share * (test_quick() ? 50u : 1000u), done = 0;
        test_rng r = test_rng_make(k);
        if (test_quick() && list[k].depth > 7) continue;
        scene_make(&s, list[k].depth, list[k].kind);
        while (done < want) {
            size_t i, n = want - done < BATCH ? want - done : BATCH;
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
    size_t k, batch, i, most = test_quick() ? 1 : 17;
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
    size_t k, batch, i, most = test_quick() ? 1 : 8;
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

static double shape(int kind, double x, double y, double z) { /* negative inside; the cube [-1,1]^3 is the grid */
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
        p = fabs(sin(9 * x) * cos(9 * y) + sin(9 * y) * cos(9 * z) + sin(9 * z) * cos(9 * x)) - 0.5;
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
        double c = shape(kind, (x + 0.5) * h - 1, (y + 0.5) * h - 1, (z + 0.5) * h - 1);
        int differ = 0;
        if (fabs(c) > 12 * h) continue; /* no shape is steeper */
        for (i = 0; i < 6 && !differ; i++) {
            double f = i & 1 ? 1 : 0;
            differ = (shape(kind, (x + (i / 2 == 0 ? f : 0.5)) * h - 1, (y + (i / 2 == 1 ? f : 0.5)) * h - 1,
                            (z + (i / 2 == 2 ? f : 0.5)) * h - 1) < 0) != (c < 0);
        }
        if (differ) oracle_set(&s->g, x, y, z);
    }
    scene_list(s);
}

TEST(closed_shells_do_not_leak) {
    static voxrt_ray rays[BATCH];
    static voxrt_hit hits[BATCH];
    size_t per_shape = test_quick() ? 25000 : 250000, escapes = 0, done, i;
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
                    while (!(shape(kind, (double)q->org[0] * h - 1, (double)q->org[1] * h - 1, (double)q->org[2] * h - 1) < -4 * h));
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
    size_t k, batch, i, most = test_quick() ? 1 : 4;
    uint64_t most_steps = 0;
    tally sum;
    memset(&sum, 0, sizeof sum);
    for (k = 0; k < sizeof depths / sizeof depths[0]; k++) {
        scene s;
        int32_t normal[3], mid[3], room = 1 << depths[k];
        test_rng r = test_rng_make(4000 + k);
        int a, m = 0;
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
                if (fabs(across) > 0.15 * sqrt(len * longest) && fabs(across) > 1e3 * fabs((double)normal[m])) i++;
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

int main(int argc, char **argv) {
    test_begin(argc, argv);
    isa_count = (size_t)voxrti_cpu_level();
    RUN(general_rays);
    RUN(nasty_rays);
    RUN(runs_of_one_origin);
    RUN(closed_shells_do_not_leak);
    RUN(deep_planes_do_not_leak);
    return test_end();
}
