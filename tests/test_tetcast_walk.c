/* Rays through meshes: exact signs, no ray lost in vertices, edges, faces, flat, inverted and tangled cells; the length of
   the way inside is that of the geometry, in every form of cells and for every instruction set, with the same bits.

   Which test has which hard case of tetrahedral meshes (in this file where no other is named: test_tetcast_*):
     rays through vertices, along edges, in the planes of faces            lattices, ties, symmetric_views (render)
     ... and nearly so, tilted by 1e-3 to 1e-8                             lattices
     coordinates far from the origin                                       lattices, far_and_large (mesh), planes (strips)
     flat, inverted, tangled cells; no loop, no way lost                   pairs, lattices, flat_meshes, random_bits
     thin cells, down to 1e-8; boundary layers                             lattices, boundary_layers
     faces seen edge-on: places and values                                 single_cell, values_at_cuts
     thousands of cells on a ray; a million rays                           long_bar, long_rays (integrate), million_rays (render)
     signs of determinants, underflow                                      determinant, frames
     cyclic order of cells                                                 cyclic
     holes, several parts, parts that touch in faces, edges, corners       shapes
     fifty layers; layers closer than a depth buffer tells                 fifty_layers, peeling (strips)
     hull and walk agree on silhouettes; every hit of the hull used once   pairs, pixels_are_rays (render)
     eye inside, on a vertex or face; near and far ends inside of cells    eye_inside (render), ends, values_at_cuts
     very distant eye                                                      ends
     imaginary cells, hidden cells, values per cell                        imaginary, forms (render)
     three cells at a face, doubled cells, hanging nodes                   blocks_that_do_not_match, nonmanifold (mesh)
     overlapping parts                                                     overlap
     NaN and infinities in positions and values                            random_bits, bad_values and bad_cells (mesh)
     the forms of the thesis: links of strips, lone cells, repeated        walks and statistics (strips), same_trails (cells)
     vertices, numbers of 32 bits, 16-bit escapes                          escapes, record_of_tet8 (cells)
     what planes do wrong in all this, counted                             planes (strips)
     empty clusters are leapt over                                         leaping, forms (render)
     real meshes, every pixel against every cell                           real_meshes (render)
     the same for any number of threads, tiles and instruction sets        same_bits, forms (render)
     ending early changes no more than the light that is left              early_end (render, integrate)
     sums in 32-bit floats, no 8 or 16 bits between; absorption summed     long_rays, absorption_is_summed (integrate)
     table resolution, steps and peaks, equal ends, lengths beyond         errors_of_all, prefix_is_exact_for_opacity,
     a table, self-attenuation, local edits                                lengths_beyond_the_table, local_update (tables)
     isovalue of a vertex, plateaus, several isovalues, smooth normals,    isovalue_of_vertices, isosurface_of_a_plane (render),
     depth of the surface itself                                           several_isovalues_in_order (optical), closed (isosurface)
     projection: edges, perspective, order, cycles                         (project) */
#include "test.h"
#define TETCAST_IMPLEMENTATION
#include "tetcast.h"
#include "tets.h"

enum { ISAS = 4 };
static const tetcast_isa all_isas[ISAS] = {TETCAST_ISA_SCALAR, TETCAST_ISA_SSE, TETCAST_ISA_AVX2, TETCAST_ISA_AVX512}; /* as far as the machine has them */

static void cast_all(const tetcast_mesh *m, const tetcast_optics *o, tetcast_isa isa, const tetcast_ray *rays, size_t n,
                     tetcast_ray_result *out) {
    tetcast_render_desc d;
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    d.isa = isa;
    memset(out, 0xee, n * sizeof *out);
    CHECK_EQ_U64(tetcast_cast(&d, m, o, rays, n, out, NULL), TETCAST_OK);
}

/* Every form of cells and every instruction set gives the bits of `want`. */
static void check_forms_of(const tetcast_input *in, const tetcast_optics *o, const tetcast_ray *rays, size_t n, const tetcast_ray_result *want) {
    tetcast_ray_result *got = (tetcast_ray_result *)malloc(n * sizeof *got);
    uint32_t kind, isa;
    REQUIRE(got != NULL);
    for (kind = 0; kind < TETCAST_CELLS_COUNT; kind++) {
        tetcast_mesh *m = NULL;
        tetcast_mesh_desc d;
        memset(&d, 0, sizeof d);
        d.env.thread_count = 1;
        d.cells = (tetcast_cells)kind;
        CHECK_EQ_U64(tetcast_mesh_create(&d, in, NULL, &m), TETCAST_OK);
        for (isa = 0; isa < ISAS && m != NULL; isa++) {
            cast_all(m, o, all_isas[isa], rays, n, got);
            CHECK_MSG(memcmp(want, got, n * sizeof *got) == 0, "form %u, instruction set %u: other bits", kind, isa);
        }
        tetcast_mesh_destroy(m);
    }
    free(got);
}

static void check_forms(const tets *t, const tetcast_optics *o, const tetcast_ray *rays, size_t n, const tetcast_ray_result *want) {
    tetcast_input in;
    tetcast_field f;
    tets_input(t, &in, &f);
    check_forms_of(&in, o, rays, n, want);
}

/* Extinction tau everywhere. */
static tetcast_optics *constant_optics(float tau, tetcast_model model) {
    tetcast_control_point p;
    tetcast_transfer_desc td;
    tetcast_optics_desc od;
    tetcast_transfer *t = NULL;
    tetcast_optics *o = NULL;
    memset(&p, 0, sizeof p);
    memset(&td, 0, sizeof td);
    memset(&od, 0, sizeof od);
    p.extinction = tau;
    p.rgb[0] = 1;
    td.points = &p;
    td.point_count = 1;
    od.model = model;
    od.t_min = -1;
    CHECK_EQ_U64(tetcast_transfer_create(&td, &t), TETCAST_OK);
    CHECK_EQ_U64(tetcast_optics_create(t, &od, &o), TETCAST_OK);
    tetcast_transfer_destroy(t);
    return o;
}

/* ---- the sign of a determinant ---- */

static int sign_of(double x) { return (x > 0) - (x < 0); }

TEST(determinant) { /* against products in double precision, which are exact for floats */
    test_rng rng = test_rng_make(1);
    const char *count = getenv("TEST_DETERMINANTS"); /* 1e8 takes a few seconds */
    const uint32_t n = count != NULL ? (uint32_t)strtod(count, NULL) : test_quick() ? 100000 : 3000000;
    uint32_t i, wrong = 0, zeros = 0;
    for (i = 0; i < n; i++) {
        /* multiples of 2^-63 below 2^33, as they come from the frame of a ray: small ones among them */
        tetcasti_point p[2];
        double exact;
        float v;
        uint32_t k;
        memset(p, 0, sizeof p);
        for (k = 0; k < 3; k++) {
            int low = -63 + (int)test_rng_below(&rng, 70);
            double x = ldexp((double)(test_rng_u32(&rng) >> (8 + test_rng_below(&rng, 20))), low);
            if (x >= 8589934592.0) x = ldexp(x, -40);
            if (test_rng_u32(&rng) & 1) x = -x;
            if (k == 0) p[0].x = (float)x;
            if (k == 1) p[0].y = (float)x;
            if (k == 2) p[1].x = (float)x;
        }
        if (i & 1 && p[0].x != 0) { /* nearly on a line through the origin */
            double y = (double)p[0].y * (double)p[1].x / (double)p[0].x;
            y = ldexp(floor(ldexp(y, 63) + 0.5), -63);
            p[1].y = fabs(y) < 8589934592.0 ? (float)y : 0;
            p[1].y = (float)ldexp(floor(ldexp((double)p[1].y, 63)), -63);
            if (i & 2) p[1].y = nextafterf(p[1].y, i & 4 ? 1e9f : -1e9f);
            p[1].y = (float)ldexp(floor(ldexp((double)p[1].y, 63)), -63);
        } else if (i % 8 == 0) {
            p[1] = p[0];
        } else {
            p[1].y = p[0].x;
        }
        exact = (double)p[0].x * (double)p[1].y - (double)p[0].y * (double)p[1].x;
        {
            double a = (double)p[0].x * (double)p[1].y, b = (double)p[0].y * (double)p[1].x;
            v = tetcasti_det(0, &p[0], &p[1]);
            wrong += sign_of((double)v) != (a > b) - (a < b);
            zeros += v == 0;
            if (fabs(exact) > 1e-30) wrong += fabs((double)v - exact) > 2.5e-7 * fabs(exact) && exact == exact && fabs(a) < 1e30 &&
                                              fabs(exact) > 1e-12 * (fabs(a) + fabs(b));
        }
    }
    CHECK_EQ_U64(wrong, 0);
    CHECK(zeros > n / 16);
}

/* ---- fused multiply-adds without the instruction ---- */

#if TETCASTI_SOFT_FMA && !defined(__MINGW32__) /* there fmaf itself is not right */
static int same_float(float a, float b) { return memcmp(&a, &b, sizeof a) == 0 || (a != a && b != b); }

static float scaled(test_rng *rng, int low, int high) { /* 24 random bits, or few; 2^low to 2^high */
    float x = 1.0f + ldexpf((float)(test_rng_u32(rng) >> 9 >> (test_rng_u32(rng) & 1 ? test_rng_below(rng, 23) : 0)), -23);
    x = x < 2.0f ? x : 1.0f;
    x = ldexpf(x, low + (int)test_rng_below(rng, (uint32_t)(high - low + 1)));
    return test_rng_u32(rng) & 1 ? -x : x;
}

/* a * b + c in places where roundings go wrong: ties, cancellation, denormals, overflow, anything. */
static void fma_triple(test_rng *rng, uint32_t kind, float v[3]) {
    const float tiny = ldexpf(1.0f, -23);
    switch (kind) {
    case 0: /* any bits: NaN, infinities, -0 */
        v[0] = test_rng_bits(rng);
        v[1] = test_rng_bits(rng);
        v[2] = test_rng_bits(rng);
        break;
    case 1: /* next to the middle between two floats, by less than a double can tell */
        v[2] = scaled(rng, -60, 60);
        v[0] = ldexpf(1.0f + tiny * (float)test_rng_below(rng, 4), ilogbf(v[2]) - 24 - (int)test_rng_below(rng, 2));
        v[1] = 1.0f - tiny * (float)test_rng_below(rng, 4);
        if (test_rng_u32(rng) & 1) v[1] = -v[1];
        break;
    case 2: /* all but nothing is left */
        v[0] = scaled(rng, -20, 20);
        v[1] = scaled(rng, -20, 20);
        v[2] = -(v[0] * v[1]);
        if (test_rng_u32(rng) & 1) v[2] = nextafterf(v[2], v[2] + scaled(rng, 20, 40));
        break;
    case 3: /* denormals */
        v[0] = scaled(rng, -80, -60);
        v[1] = scaled(rng, -90, -60);
        v[2] = ldexpf((float)(int32_t)(test_rng_u32(rng) >> 6) - 33554432.0f, -149 - (int)test_rng_below(rng, 3));
        break;
    case 4: /* near the largest */
        v[0] = scaled(rng, 60, 66);
        v[1] = scaled(rng, 58, 66);
        v[2] = scaled(rng, 100, 127);
        break;
    case 5: { /* zeros and infinities of both signs, ones */
        static const float some[8] = {0.0f, -0.0f, 1.0f, -1.0f, INFINITY, -INFINITY, 1e-45f, 3.4028235e38f};
        uint32_t k;
        for (k = 0; k < 3; k++) v[k] = some[test_rng_below(rng, 8)];
        break;
    }
    default: /* what meshes have */
        v[0] = scaled(rng, -24, 0);
        v[1] = scaled(rng, -24, 1);
        v[2] = scaled(rng, -24, 1);
    }
}
#endif

TEST(fma_in_doubles) { /* one by one and two side by side, against libm; and what the walk makes of them */
#if TETCASTI_SOFT_FMA && !defined(__MINGW32__)
    test_rng rng = test_rng_make(77);
    const uint32_t n = test_quick() ? 400000 : 12000000;
    uint32_t i, k, wrong = 0, twice = 0;
    for (i = 0; i < n; i += 2) {
        float v[2][3], want[2];
        for (k = 0; k < 2; k++) {
            fma_triple(&rng, (i / 2 + k) % 7, v[k]);
            want[k] = fmaf(v[k][0], v[k][1], v[k][2]);
            wrong += !same_float(tetcasti_fmaf(v[k][0], v[k][1], v[k][2]), want[k]);
            twice += !same_float((float)((double)v[k][0] * (double)v[k][1] + (double)v[k][2]), want[k]);
        }
#  if TETCASTI_X64
        {
            float got[4];
            _mm_storeu_ps(got, tetcasti_fma2(_mm_set_pd((double)v[1][0], (double)v[0][0]), _mm_set_pd((double)v[1][1], (double)v[0][1]),
                                             _mm_set_pd((double)v[1][2], (double)v[0][2])));
            for (k = 0; k < 2; k++) wrong += !same_float(got[k], want[k]);
        }
#  endif
    }
    CHECK_EQ_U64(wrong, 0);
    CHECK_MSG(twice > n / 1000, "%u triples would be rounded twice", twice); /* or this would show nothing */
    for (i = 0; i < n / 8; i++) {
        tetcasti_point p[4];
        const tetcasti_point *const face[3] = {&p[0], &p[1], &p[2]};
        float det[2][3], at[2], s[2], w[3];
        const int low = i & 1 ? -20 : -1, high = i & 1 ? 4 : 0;
        for (k = 0; k < 4; k++) {
            p[k].x = scaled(&rng, low, high);
            p[k].y = scaled(&rng, low, high);
            p[k].z = scaled(&rng, low, high);
            p[k].s = scaled(&rng, -30, 1);
        }
        if (i % 3 == 0) p[3].x = p[0].x, p[3].y = p[0].y; /* nothing */
        if (i % 5 == 0) p[3].x = 2.0f * p[1].x, p[3].y = 2.0f * p[1].y;
        if (i % 5 == 1) p[3].x = nextafterf(p[2].x, 9.0f), p[3].y = p[2].y;
        for (k = 0; k < 3; k++) w[k] = fabsf(scaled(&rng, -20, 1));
        for (k = 0; k < 2; k++) {
            tetcasti_det3((int)k, face, &p[3], det[k]);
            tetcasti_face_point((int)k, &p[0], &p[1], &p[2], w[0], w[1], w[2], &at[k], &s[k]);
        }
        wrong += memcmp(det[0], det[1], sizeof det[0]) != 0 || at[0] != at[1] || s[0] != s[1];
    }
    CHECK_EQ_U64(wrong, 0);
#else
    SKIP("fma is an instruction, or libm's");
#endif
}

/* ---- the rule for ties, exhaustively ---- */

TEST(ties) { /* every cell with corners on a small grid around the ray, also in the same place: 0 or 2 faces are passed,
                and the step leads from one to the other */
    const int reach = test_quick() ? 2 : 3, side = 2 * reach + 1;
    const uint32_t places = (uint32_t)(side * side);
    tetcasti_tet16 record;
    tetcasti_cells cells;
    tetcasti_vertex v[4];
    tetcasti_ray ray;
    uint32_t q[4], i, j, k, covered[5] = {0, 0, 0, 0, 0}, wrong = 0, orders = 0;
    memset(&cells, 0, sizeof cells);
    memset(&ray, 0, sizeof ray);
    memset(v, 0, sizeof v);
    record.x = 0 ^ 1 ^ 2 ^ 3;
    for (i = 0; i < 3; i++) record.n[i] = i ^ 3; /* neighbours 0 1 2 3 in the order of vertices */
    cells.data = &record;
    cells.count = 1;
    ray.iz = 1;
    ray.group = 5; /* x, y, z as they are */
    for (i = 0; i < places * places * places * places; i++) {
        uint32_t faces = 0, face[4];
        for (j = 0, k = i; j < 4; j++, k /= places) q[j] = k % places;
        for (j = 0; j < 4; j++) {
            v[j].x = (float)((int)q[j] % side - reach);
            v[j].y = (float)((int)q[j] / side - reach);
            v[j].z = (float)j;
        }
        for (j = 0; j < 4; j++) { /* seen one way round or the other */
            uint32_t f[3], g[3];
            float at;
            int one, two;
            for (k = 0; k < 3; k++) f[k] = (j + 1 + k) & 3;
            g[0] = f[1];
            g[1] = f[0];
            g[2] = f[2];
            one = tetcasti_face_hit(0, &ray, v, f, &at);
            two = tetcasti_face_hit(0, &ray, v, g, &at);
            wrong += one && two;
            if (one || two) {
                tetcasti_start s;
                tetcasti_walk w;
                float s_out;
                memcpy(s.v, one ? f : g, sizeof s.v);
                s.cell = 0;
                s.prev = j;
                tetcasti_walk_begin(0, &ray, v, &s, &w);
                tetcasti_walk_step(0, &cells, TETCAST_CELLS_TET16, &ray, v, &w, &at, &s_out);
                face[faces++] = j;
                orders += w.cell * 4 + j; /* the neighbour's number is that of the vertex opposite the way out */
                wrong += w.cell != w.dropped || w.dropped == j || w.d != j || !(at == at);
                { /* the way out is passed, too, and seen the right way round */
                    uint32_t out[3];
                    float again;
                    out[0] = w.a;
                    out[1] = w.b;
                    out[2] = w.c;
                    wrong += !tetcasti_face_hit(0, &ray, v, out, &again);
                    wrong += !(w.ab >= 0 && w.bc >= 0 && w.ca >= 0 && w.ab + w.bc + w.ca > 0);
                }
                if (faces == 2) { /* the step led from the first one to this one, and back */
                    wrong += w.dropped != face[0];
                }
            }
        }
        covered[faces]++;
    }
    CHECK_EQ_U64(wrong, 0);
    CHECK_EQ_U64(covered[1] + covered[3] + covered[4], 0);
    CHECK(covered[0] > 100000 && covered[2] > 50000);
    CHECK(orders != 0);
}

/* ---- the frame of a ray ---- */

TEST(frames) { /* slopes and origins are where no product can underflow; length and place are right */
    test_rng rng = test_rng_make(3);
    tetcasti_box box;
    uint32_t i, k, met = 0;
    for (k = 0; k < 3; k++) {
        box.lo[k] = -268435456.0f * (float)(k + 1) / 2;
        box.hi[k] = 268435456.0f * (float)(k + 1) / 2;
    }
    for (i = 0; i < 20000; i++) {
        double o[3], d[3], offset, l;
        tetcasti_ray r;
        memset(&r, 0, sizeof r);
        for (k = 0; k < 3; k++) {
            o[k] = (test_rng_double(&rng) - 0.5) * 536870912.0 * (i % 7 == 0 ? 1e9 : i % 2 ? 3 : 0.5);
            d[k] = i % 5 == 0 ? (double)test_rng_below(&rng, 3) - 1 : i % 5 == 1 ? pow(10, -12 * test_rng_double(&rng)) : test_rng_double(&rng) - 0.5;
            if (i % 7 == 0) d[k] = -o[k] + (test_rng_double(&rng) - 0.5) * 3e8;
        }
        r.group = tetcasti_ray_group(d);
        if (d[0] == 0 && d[1] == 0 && d[2] == 0) {
            CHECK_EQ_U64(r.group, TETCASTI_NO_RAY);
            continue;
        }
        CHECK(r.group < 6);
        offset = tetcasti_ray_make(&box, o, d, &r);
        if (r.group == TETCASTI_NO_RAY) continue;
        met++;
        CHECK(fabsf(r.sx) <= 1 && fabsf(r.sy) <= 1 && fabsf(r.iz) >= 1 && fabsf(r.iz) < 1.7321f);
        CHECK(ldexp((double)r.sx, 45) == floor(ldexp((double)r.sx, 45)) && ldexp((double)r.sy, 45) == floor(ldexp((double)r.sy, 45)));
        CHECK(ldexp((double)r.ox, 18) == floor(ldexp((double)r.ox, 18)) && ldexp((double)r.oy, 18) == floor(ldexp((double)r.oy, 18)) &&
              ldexp((double)r.oz, 18) == floor(ldexp((double)r.oz, 18)));
        CHECK(fabsf(r.ox) < 4294967296.0f && fabsf(r.oy) < 4294967296.0f && fabsf(r.oz) < 4294967296.0f);
        CHECK(offset >= 0);
        l = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
        {
            const uint8_t *axes = tetcasti_axes[r.group];
            float dir[3];
            double far_away = fabs(o[0]) + fabs(o[1]) + fabs(o[2]) + 1e9;
            tetcasti_ray_direction(&r, dir);
            for (k = 0; k < 3; k++) CHECK_NEAR(dir[k], d[k] / l, 3e-7);
            CHECK_NEAR(r.ox, o[axes[0]] + offset * d[axes[0]] / l, 3e-7 * far_away);
            CHECK_NEAR(r.oz, o[axes[2]] + offset * d[axes[2]] / l, 3e-7 * far_away);
        }
    }
    CHECK(met > 5000);
}

/* ---- lattices: boxes, so that lengths are known ---- */

typedef struct family_stats { uint64_t rays, bad; double worst; } family_stats;

/* Rays of one family through a box of n * n * n vertices, scaled and moved. */
static void make_ray(test_rng *rng, const tets *t, uint32_t n, const double scale[3], const double offset[3], uint32_t family, uint32_t k,
                     tetcast_ray *ray) {
    double o[3], d[3], c = 0.5 * (n - 1);
    uint32_t a;
    int v[3];
    memset(ray, 0, sizeof *ray);
    for (a = 0; a < 3; a++) {
        o[a] = 1 + test_rng_below(rng, n - 2);
        d[a] = 0;
    }
    switch (family) {
    case 0: /* any */
        for (a = 0; a < 3; a++) {
            o[a] = c + (test_rng_double(rng) - 0.5) * 4 * n;
            d[a] = 1 + test_rng_double(rng) * (n - 3) - o[a];
        }
        break;
    case 1: /* along an axis in lattice planes, along edges */
        a = k % 3;
        o[a] = k & 8 ? -10.0 : n + 10.0;
        d[a] = k & 8 ? 1 : -1;
        break;
    case 2: /* along diagonals through vertices */
        do {
            for (a = 0; a < 3; a++) v[a] = (int)test_rng_below(rng, 3) - 1;
        } while (v[0] == 0 && v[1] == 0 && v[2] == 0);
        for (a = 0; a < 3; a++) {
            d[a] = v[a];
            o[a] -= 2.0 * n * d[a];
        }
        break;
    case 3: { /* from one eye at vertices */
        uint32_t i = test_rng_below(rng, (uint32_t)t->nv);
        o[0] = -20;
        o[1] = o[2] = c;
        for (a = 0; a < 3; a++) d[a] = (t->p[3 * i + a] - offset[a]) / scale[a] - o[a];
        break;
    }
    case 4: /* nearly along an axis */
        for (a = 0; a < 3; a++) d[a] = (test_rng_double(rng) - 0.5) * 2 * pow(10, -3 - (double)(k % 6));
        a = k % 3;
        o[a] = -10;
        d[a] = 1;
        break;
    default: { /* from a vertex, an edge, a face or the middle of a cell */
        uint32_t q = test_rng_below(rng, (uint32_t)t->nt), m = 1 + test_rng_below(rng, 4), j;
        for (a = 0; a < 3; a++) {
            o[a] = 0;
            for (j = 0; j < m; j++) o[a] += (t->p[3 * t->t[4 * q + j] + a] - offset[a]) / scale[a] / m;
            d[a] = test_rng_double(rng) - 0.5;
        }
        if (k & 1) {
            for (a = 0; a < 3; a++) d[a] = 0;
            d[k / 2 % 3] = k & 16 ? 1 : -1;
        }
        break;
    }
    }
    for (a = 0; a < 3; a++) {
        ray->org[a] = o[a] * scale[a] + offset[a];
        ray->dir[a] = d[a] * scale[a];
    }
}

/* Lengths between those in a box that is a little smaller and one that is a little larger: positions are rounded to 24
   bits, directions to 2^-46. */
static void check_lengths(const tetcast_ray *rays, const tetcast_ray_result *got, size_t count, uint32_t n, const double scale[3],
                          const double offset[3], family_stats *stats) {
    double size = (n - 1) * fmax(scale[0], fmax(scale[1], scale[2]));
    size_t i;
    int a;
    for (i = 0; i < count; i++) {
        double lo[3], hi[3], d[3], least, most, error;
        memcpy(d, rays[i].dir, sizeof d);
        ref_unit(d);
        for (a = 0; a < 3; a++) {
            double blur = fmax(2e-7 * scale[a] * (n - 1), 1e-9 * size);
            lo[a] = offset[a] + blur;
            hi[a] = offset[a] + scale[a] * (n - 1) - blur;
        }
        least = ref_box(rays[i].org, d, lo, hi, 0, 1e300);
        for (a = 0; a < 3; a++) {
            double blur = 2 * fmax(2e-7 * scale[a] * (n - 1), 1e-9 * size);
            lo[a] -= blur;
            hi[a] += blur;
        }
        most = ref_box(rays[i].org, d, lo, hi, 0, 1e300);
        error = fmax(least - (double)got[i].length, (double)got[i].length - most) / size;
        stats->rays++;
        stats->worst = fmax(stats->worst, error);
        stats->bad += !(error <= 1e-6);
    }
}

TEST(lattices) {
    static const double jitter[4] = {0, 0.2, 0.35, 0.6}, thin[5] = {1, 1e-2, 1e-4, 1e-6, 1e-8}, place[3] = {0, 1000, -1e6};
    uint32_t n = 8, per = test_quick() ? 6 : 40, k, family, i;
    tetcast_ray *rays = (tetcast_ray *)malloc(6 * per * sizeof *rays);
    tetcast_ray_result *got = (tetcast_ray_result *)malloc(6 * per * sizeof *got);
    family_stats stats;
    memset(&stats, 0, sizeof stats);
    REQUIRE(rays != NULL && got != NULL);
    for (k = 0; k < 2 * 4 * 5 * 3; k++) {
        tets t;
        double scale[3] = {1, 1, 1}, offset[3];
        tetcast_mesh *m;
        test_rng rng = test_rng_make(k);
        memset(&t, 0, sizeof t);
        tets_lattice(&t, n, n, n, 5 + (int)(k & 1), NULL);
        tets_jitter(&t, n, n, n, jitter[k / 2 % 4], 7);
        scale[k % 3] = thin[k / 8 % 5];
        for (i = 0; i < 3; i++) offset[i] = place[k / 40] * (double)(i + 1);
        tets_place(&t, scale, offset);
        if (k % 3 == 0) tets_shuffle(&t, 9);
        for (family = 0; family < 6; family++)
            for (i = 0; i < per; i++) make_ray(&rng, &t, n, scale, offset, family, i, &rays[family * per + i]);
        m = tets_build(&t, TETCAST_CELLS_TET16, NULL);
        REQUIRE(m != NULL);
        cast_all(m, NULL, TETCAST_ISA_SCALAR, rays, 6 * per, got);
        check_lengths(rays, got, 6 * per, n, scale, offset, &stats);
        if (k % 5 < (test_quick() ? 1 : 2)) check_forms(&t, NULL, rays, 6 * per, got);
        tetcast_mesh_destroy(m);
        tets_free(&t);
    }
    CHECK_MSG(stats.bad == 0, "%llu of %llu rays have a wrong length, worst %g", (unsigned long long)stats.bad,
              (unsigned long long)stats.rays, stats.worst);
    free(rays);
    free(got);
}

TEST(long_bar) { /* thousands of cells on a ray */
    tets t;
    tetcast_mesh *m;
    tetcast_ray r[3];
    tetcast_ray_result got[3];
    uint32_t n = 2001;
    memset(&t, 0, sizeof t);
    memset(r, 0, sizeof r);
    tets_lattice(&t, n, 2, 2, 6, NULL);
    m = tets_build(&t, TETCAST_CELLS_TET16, NULL);
    REQUIRE(m != NULL);
    r[0].org[0] = -5;
    r[0].org[1] = 0.3;
    r[0].org[2] = 0.6;
    r[0].dir[0] = 3;
    r[1] = r[0];
    r[1].org[1] = r[1].org[2] = 0; /* along an edge of the hull: in or out, but nothing between */
    r[2] = r[0];
    r[2].org[1] = r[2].org[2] = 0.5; /* in the plane of diagonals */
    cast_all(m, NULL, TETCAST_ISA_SCALAR, r, 3, got);
    CHECK(got[0].steps >= 5000);
    CHECK_NEAR(got[0].length, 2000, 2e-3);
    CHECK_NEAR(got[2].length, 2000, 2e-3);
    CHECK(got[1].length == 0 || fabs((double)got[1].length - 2000) < 2e-3);
    CHECK(got[0].walks == 1);
    check_forms(&t, NULL, r, 3, got);
    tetcast_mesh_destroy(m);
    tets_free(&t);
}

TEST(flat_meshes) { /* everything in a plane, on a line, in a point: nothing there, and it ends */
    uint32_t k, i, a;
    for (k = 0; k < 6; k++) {
        tets t;
        tetcast_mesh *m;
        double scale[3] = {1, 1, 1}, offset[3] = {3, 3, 3};
        tetcast_ray rays[200];
        tetcast_ray_result got[200];
        test_rng rng = test_rng_make(k);
        tetcast_optics *o = constant_optics(1, TETCAST_MODEL_VOLUME);
        memset(&t, 0, sizeof t);
        memset(rays, 0, sizeof rays);
        tets_lattice(&t, 5, 5, 5, 5 + (int)(k & 1), NULL);
        scale[k % 3] = 0;
        if (k >= 3) scale[(k + 1) % 3] = 0;
        if (k == 5) scale[0] = scale[1] = scale[2] = 0;
        tets_place(&t, scale, offset);
        m = tets_build(&t, TETCAST_CELLS_TET16, NULL);
        REQUIRE(m != NULL);
        for (i = 0; i < 200; i++)
            for (a = 0; a < 3; a++) {
                rays[i].org[a] = i % 3 == 0 ? 3 + test_rng_below(&rng, 5) : 3 + 4 * test_rng_double(&rng);
                rays[i].dir[a] = i % 2 ? (double)test_rng_below(&rng, 3) - 1 : test_rng_double(&rng) - 0.5;
                rays[i].org[a] -= 10 * rays[i].dir[a];
            }
        cast_all(m, o, TETCAST_ISA_SCALAR, rays, 200, got);
        for (i = 0; i < 200; i++) {
            /* a ray in the very plane of a flat mesh may have any length up to the mesh's */
            CHECK(got[i].length >= 0 && got[i].length <= 7);
            for (a = 0; a < 4; a++) CHECK(got[i].rgba[a] >= 0 && got[i].rgba[a] <= 1);
            if (rays[i].dir[k % 3] != 0 && k < 3) CHECK_NEAR(got[i].length, 0, 1e-5 * 10);
        }
        check_forms(&t, o, rays, 200, got);
        tetcast_optics_destroy(o);
        tetcast_mesh_destroy(m);
        tets_free(&t);
    }
}

/* ---- walks join faces of the hull in pairs ---- */

TEST(pairs) { /* every face of the hull that a line enters is joined with one that it leaves, tangled cells or not */
    uint32_t k, i, a;
    for (k = 0; k < 2 * TETCAST_CELLS_COUNT; k++) {
        tets t;
        tetcast_mesh *m;
        tetcasti_box box;
        uint8_t *used, *left;
        uint32_t wrong = 0, lines = test_quick() ? 20 : 200, entered = 0;
        test_rng rng = test_rng_make(k);
        memset(&t, 0, sizeof t);
        tets_lattice(&t, 6, 6, 6, k & 1 ? 5 : 6, NULL);
        if (k % 6 >= 2) for (i = 0; i < 3 * t.nv; i++) t.p[i] += (k % 6 - 1) * 0.5 * (test_rng_double(&rng) - 0.5); /* the hull, too */
        m = tets_build(&t, (tetcast_cells)(k % TETCAST_CELLS_COUNT), NULL);
        REQUIRE(m != NULL);
        box = m->box;
        used = (uint8_t *)malloc(m->face_count);
        left = (uint8_t *)malloc(m->face_count);
        REQUIRE(used != NULL && left != NULL);
        for (i = 0; i < lines; i++) {
            double o[3], d[3];
            tetcasti_ray r;
            uint32_t f, in = 0, out = 0, steps = 0;
            float at;
            memset(&r, 0, sizeof r);
            memset(used, 0, m->face_count);
            memset(left, 0, m->face_count);
            for (a = 0; a < 3; a++) {
                o[a] = (i % 3 == 0 ? (double)test_rng_below(&rng, 6) / 5 - 0.5 : test_rng_double(&rng) - 0.5) * (double)(box.hi[a] - box.lo[a]);
                d[a] = i % 4 == 0 ? (double)test_rng_below(&rng, 3) - 1 : test_rng_double(&rng) - 0.5;
            }
            r.group = tetcasti_ray_group(d);
            if (r.group == TETCASTI_NO_RAY) continue;
            (void)tetcasti_ray_make(&box, o, d, &r);
            if (r.group == TETCASTI_NO_RAY) continue;
            for (f = 0; f < m->face_count; f++) {
                uint32_t turned[3];
                turned[0] = m->face[f].v[1];
                turned[1] = m->face[f].v[0];
                turned[2] = m->face[f].v[2];
                if (tetcasti_face_hit(0, &r, m->vertex, m->face[f].v, &at)) {
                    tetcasti_start s;
                    tetcasti_walk w;
                    uint32_t g;
                    float value;
                    in++;
                    memcpy(s.v, m->face[f].v, sizeof s.v);
                    s.cell = m->cells.first != NULL ? m->cells.first[f] : m->face[f].cell;
                    s.prev = TETCASTI_NONE;
                    tetcasti_walk_begin(0, &r, m->vertex, &s, &w);
                    while (w.cell != TETCASTI_NONE && steps++ < 100 * m->cell_count)
                        tetcasti_walk_step_any(&m->cells, &r, m->vertex, &w, &at, &value);
                    wrong += w.cell != TETCASTI_NONE;
                    for (g = 0; g < m->face_count; g++) { /* the face it left through, whose cell it was in */
                        const uint32_t *v = m->face[g].v;
                        if (m->face[g].cell == tetcasti_cell_number(&m->cells, w.prev) && (v[0] ^ v[1] ^ v[2]) == (w.a ^ w.b ^ w.c) &&
                            (v[0] == w.a || v[0] == w.b || v[0] == w.c) && (v[1] == w.a || v[1] == w.b || v[1] == w.c)) break;
                    }
                    wrong += g == m->face_count || used[g];
                    if (g < m->face_count) used[g] = 1;
                } else if (tetcasti_face_hit(0, &r, m->vertex, turned, &at)) {
                    out++;
                    left[f] = 1;
                }
            }
            entered += in;
            wrong += in != out;
            for (f = 0; f < m->face_count; f++) wrong += used[f] != left[f];
        }
        CHECK_EQ_U64(wrong, 0);
        CHECK(entered > lines / 4);
        free(used);
        free(left);
        tetcast_mesh_destroy(m);
        tets_free(&t);
    }
}

/* ---- not convex ---- */

static int keep_hollow(uint32_t x, uint32_t y, uint32_t z) { return x < 2 || x > 4 || y < 2 || y > 4 || z < 2 || z > 4; }
static int keep_ring(uint32_t x, uint32_t y, uint32_t z) { (void)z; return x < 2 || x > 4 || y < 2 || y > 4; }
static int keep_u(uint32_t x, uint32_t y, uint32_t z) { (void)z; return x < 2 || x > 4 || y < 2; }
static int keep_face(uint32_t x, uint32_t y, uint32_t z) { (void)y; (void)z; return x != 3; }
static int keep_edge(uint32_t x, uint32_t y, uint32_t z) { (void)z; return (x < 3) == (y < 3); }
static int walk_keep_corner(uint32_t x, uint32_t y, uint32_t z) { return (x < 3) == (y < 3) && (y < 3) == (z < 3); }
static int walk_keep_layers(uint32_t x, uint32_t y, uint32_t z) { (void)x; (void)y; return (z & 1u) == 0; }
static int keep_checker(uint32_t x, uint32_t y, uint32_t z) { return ((x + y + z) & 1u) == 0; }

/* Random rays and rays that are in the lattice's planes; the latter moved by 1e-9 for the reference, in both senses. */
static void check_shape(const tets *t, uint32_t nx, uint32_t ny, uint32_t nz, uint32_t seed) {
    uint32_t count = test_quick() ? 30 : 150, i, a, wrong = 0, several = 0;
    test_rng rng = test_rng_make(seed);
    tetcast_mesh *m = tets_build(t, TETCAST_CELLS_TET16, NULL);
    tetcast_ray *rays = (tetcast_ray *)calloc(count, sizeof *rays);
    tetcast_ray_result *got = (tetcast_ray_result *)malloc(count * sizeof *got);
    tetcast_optics *o = constant_optics(0.25f, TETCAST_MODEL_VOLUME);
    double size[3], big;
    size[0] = nx - 1;
    size[1] = ny - 1;
    size[2] = nz - 1;
    big = fmax(size[0], fmax(size[1], size[2]));
    REQUIRE(m != NULL && rays != NULL && got != NULL);
    for (i = 0; i < count; i++)
        for (a = 0; a < 3; a++) {
            double p = i % 3 == 0 ? (double)test_rng_below(&rng, (uint32_t)size[a] + 1) : size[a] * test_rng_double(&rng);
            rays[i].dir[a] = i % 6 == 0 ? (double)test_rng_below(&rng, 3) - 1 : test_rng_double(&rng) - 0.5;
            rays[i].org[a] = p - (i % 2 ? 3 * big * rays[i].dir[a] : 0);
        }
    cast_all(m, o, TETCAST_ISA_SCALAR, rays, count, got);
    for (i = 0; i < count; i++) {
        double d[3], l = 0, least = 1e300, most = -1e300, got_l = (double)got[i].length;
        uint32_t k;
        memcpy(d, rays[i].dir, sizeof d);
        if (d[0] == 0 && d[1] == 0 && d[2] == 0) {
            wrong += got[i].length != 0;
            continue;
        }
        ref_unit(d);
        for (k = 0; k < (i % 3 == 0 ? 9u : 3u); k++) { /* the ray itself, and beside it */
            double p[3];
            for (a = 0; a < 3; a++) p[a] = rays[i].org[a] + (k == 2 ? 0 : (k >> a & 1u ? 1 : -1) * 3e-6 * big * (a + 1) * 0.37);
            l = ref_length(t, p, d, 0, 1e300);
            least = fmin(least, l);
            most = fmax(most, l);
        }
        if (i % 3 == 0) least -= 1e-4 * big; /* along edges that only touch it may be in or out */
        wrong += !(got_l >= least - 1e-5 * big && got_l <= most + 1e-5 * big);
        wrong += !(fabs((double)got[i].rgba[3] - (1 - exp(-0.25 * got_l))) < 2e-6); /* the length is what is seen */
        several += got[i].walks > 1;
    }
    check_forms(t, o, rays, count, got);
    CHECK_MSG(wrong == 0, "shape %u: %u wrong", seed, wrong);
    CHECK(several > 0 || test_quick());
    tetcast_optics_destroy(o);
    tetcast_mesh_destroy(m);
    free(rays);
    free(got);
}

TEST(shapes) {
    static int (*const keep[8])(uint32_t, uint32_t, uint32_t) = {keep_hollow, keep_ring, keep_u, keep_face,
                                                                 keep_edge, walk_keep_corner, walk_keep_layers, keep_checker};
    uint32_t k;
    for (k = 0; k < 8; k++) {
        tets t;
        memset(&t, 0, sizeof t);
        tets_lattice(&t, 8, 8, 8, k & 1 ? 5 : 6, keep[k]);
        check_shape(&t, 8, 8, 8, k);
        tets_free(&t);
    }
}

TEST(fifty_layers) { /* plates with gaps between them, and plates 1e-6 apart */
    uint32_t pass, i;
    for (pass = 0; pass < 2; pass++) {
        tets t;
        tetcast_mesh *m;
        tetcast_ray rays[64];
        tetcast_ray_result got[64];
        test_rng rng = test_rng_make(pass);
        memset(&t, 0, sizeof t);
        memset(rays, 0, sizeof rays);
        tets_lattice(&t, 3, 3, 101, 6, walk_keep_layers);
        if (pass)
            for (i = 0; i < t.nv; i++) { /* plates of 1 - 1e-6 */
                double z = t.p[3 * i + 2], layer = floor(z / 2);
                t.p[3 * i + 2] = layer + (z - 2 * layer) * (1 - 1e-6);
            }
        m = tets_build(&t, TETCAST_CELLS_TET8, NULL);
        REQUIRE(m != NULL);
        for (i = 0; i < 64; i++) {
            rays[i].org[0] = 0.2 + 1.6 * test_rng_double(&rng);
            rays[i].org[1] = 0.2 + 1.6 * test_rng_double(&rng);
            rays[i].org[2] = i & 1 ? 200 : -100;
            rays[i].dir[2] = i & 1 ? -1 : 1;
            if (i % 4 == 0) rays[i].org[0] = rays[i].org[1] = 1;
        }
        cast_all(m, NULL, TETCAST_ISA_SCALAR, rays, 64, got);
        for (i = 0; i < 64; i++) {
            CHECK_EQ_U64(got[i].walks, 50);
            CHECK_NEAR(got[i].length, 50, 50 * 1e-5);
        }
        check_forms(&t, NULL, rays, 64, got);
        tetcast_mesh_destroy(m);
        tets_free(&t);
    }
}

TEST(blocks_that_do_not_match) { /* hanging nodes: out of one block and into the other at once */
    tets t;
    tetcast_mesh *m;
    tetcast_ray rays[300];
    tetcast_ray_result got[300];
    test_rng rng = test_rng_make(2);
    uint32_t i, a;
    size_t first;
    memset(&t, 0, sizeof t);
    memset(rays, 0, sizeof rays);
    tets_lattice(&t, 4, 4, 4, 5, NULL);
    first = t.nv;
    tets_lattice(&t, 8, 8, 8, 6, NULL);
    for (i = (uint32_t)first; i < t.nv; i++) {
        t.p[3 * i] = t.p[3 * i] * 3 / 7 + 3;
        t.p[3 * i + 1] *= 3.0 / 7;
        t.p[3 * i + 2] *= 3.0 / 7;
    }
    m = tets_build(&t, TETCAST_CELLS_TET16, NULL);
    REQUIRE(m != NULL);
    for (i = 0; i < 300; i++)
        for (a = 0; a < 3; a++) {
            double p = (a == 0 ? 6 : 3) * test_rng_double(&rng);
            rays[i].dir[a] = test_rng_double(&rng) - 0.5;
            if (i % 3 == 0) rays[i].dir[a] = a == 0 ? (i % 2 ? 1 : -1) : 0;
            rays[i].org[a] = p - 20 * rays[i].dir[a];
        }
    cast_all(m, NULL, TETCAST_ISA_SCALAR, rays, 300, got);
    for (i = 0; i < 300; i++) {
        double d[3], lo[3] = {0, 0, 0}, hi[3] = {6, 3, 3};
        memcpy(d, rays[i].dir, sizeof d);
        ref_unit(d);
        CHECK_NEAR(got[i].length, ref_box(rays[i].org, d, lo, hi, 0, 1e300), 2e-5);
    }
    check_forms(&t, NULL, rays, 300, got);
    tetcast_mesh_destroy(m);
    tets_free(&t);
}

TEST(overlap) { /* blocks that overlap: no stretch of a ray counts twice */
    tets t;
    tetcast_mesh *m;
    tetcast_ray r;
    tetcast_ray_result got;
    size_t first, i;
    memset(&t, 0, sizeof t);
    memset(&r, 0, sizeof r);
    tets_lattice(&t, 4, 4, 4, 5, NULL);
    first = t.nv;
    tets_lattice(&t, 4, 4, 4, 5, NULL);
    for (i = first; i < t.nv; i++) t.p[3 * i] += 1.25;
    m = tets_build(&t, TETCAST_CELLS_TET16, NULL);
    REQUIRE(m != NULL);
    r.org[0] = -4;
    r.org[1] = 1.3;
    r.org[2] = 1.7;
    r.dir[0] = 1;
    cast_all(m, NULL, TETCAST_ISA_SCALAR, &r, 1, &got);
    CHECK_NEAR(got.length, 4.25, 1e-5);
    CHECK_EQ_U64(got.walks, 2);
    check_forms(&t, NULL, &r, 1, &got);
    tetcast_mesh_destroy(m);
    tets_free(&t);
}

TEST(cyclic) { /* three prisms that overlap each other in a ring: no order of cells is right, rays do not mind */
    tets t;
    tetcast_mesh *m;
    tetcast_ray rays[400];
    tetcast_ray_result got[400];
    test_rng rng = test_rng_make(9);
    uint32_t i, k, a, hits = 0;
    memset(&t, 0, sizeof t);
    memset(rays, 0, sizeof rays);
    for (k = 0; k < 3; k++) { /* bars along the sides of a triangle, each rising so that it is over the next one */
        double c = cos(2.0943951 * k), s = sin(2.0943951 * k);
        uint32_t v[6];
        for (i = 0; i < 6; i++) {
            double x = i < 3 ? -3 : 3, y = -1.0 + (i % 3 == 1 ? 0.4 : 0.0), z = (i < 3 ? 0 : 1) + (i % 3 == 2 ? 0.25 : 0.0);
            v[i] = tets_vertex(&t, x * c - y * s, x * s + y * c, z, i);
        }
        tets_tet(&t, v[0], v[1], v[2], v[3]);
        tets_tet(&t, v[1], v[2], v[3], v[4]);
        tets_tet(&t, v[2], v[3], v[4], v[5]);
    }
    m = tets_build(&t, TETCAST_CELLS_TET16, NULL);
    REQUIRE(m != NULL);
    for (i = 0; i < 400; i++) {
        for (a = 0; a < 3; a++) {
            rays[i].org[a] = a == 2 ? 10 : 8 * (test_rng_double(&rng) - 0.5);
            rays[i].dir[a] = a == 2 ? -1 : 0.3 * (test_rng_double(&rng) - 0.5);
        }
    }
    cast_all(m, NULL, TETCAST_ISA_SCALAR, rays, 400, got);
    for (i = 0; i < 400; i++) {
        double d[3];
        memcpy(d, rays[i].dir, sizeof d);
        ref_unit(d);
        CHECK_NEAR(got[i].length, ref_length(&t, rays[i].org, d, 0, 1e300), 1e-5);
        hits += got[i].walks > 1;
    }
    check_forms(&t, NULL, rays, 400, got);
    CHECK(hits > 0);
    tetcast_mesh_destroy(m);
    tets_free(&t);
}

/* ---- a single cell ---- */

typedef struct one_crossing { tetcast_crossing x; uint32_t n; } one_crossing;
static int keep_crossing(void *user, const tetcast_crossing *x) {
    one_crossing *o = (one_crossing *)user;
    o->x = *x;
    o->n++;
    return 0;
}

TEST(single_cell) { /* both silhouettes, from anywhere: entry, exit and values */
    uint32_t k, i, a, met = 0, rays = test_quick() ? 500 : 10000;
    tetcast_mesh *m = NULL;
    tets t;
    test_rng rng = test_rng_make(4);
    memset(&t, 0, sizeof t);
    for (k = 0; k < rays; k++) {
        tetcast_ray r;
        one_crossing got;
        double d[3], lo, hi, g[3], s0, big = 0;
        if (k % 50 == 0) {
            tetcast_mesh_destroy(m);
            tets_free(&t);
            for (i = 0; i < 4; i++) tets_vertex(&t, test_rng_double(&rng), test_rng_double(&rng), test_rng_double(&rng), 0);
            g[0] = g[1] = g[2] = 0;
            for (i = 0; i < 4; i++) t.s[i] = (float)(1.5 * t.p[3 * i] - 0.5 * t.p[3 * i + 1] + 0.25 * t.p[3 * i + 2]);
            tets_tet(&t, 0, 1, 2, 3);
            m = tets_build(&t, (tetcast_cells)(k / 50 % TETCAST_CELLS_COUNT), NULL);
            REQUIRE(m != NULL);
        }
        memset(&r, 0, sizeof r);
        memset(&got, 0, sizeof got);
        for (a = 0; a < 3; a++) {
            double aim = 0, w = 0;
            for (i = 0; i < 4; i++) {
                double x = k % 3 == 0 ? 0.25 : test_rng_double(&rng);
                aim += x * t.p[3 * i + a];
                w += x;
            }
            r.org[a] = 20 * (test_rng_double(&rng) - 0.5);
            r.dir[a] = aim / w - r.org[a];
        }
        memcpy(d, r.dir, sizeof d);
        ref_unit(d);
        tetcast_probe(m, &r, keep_crossing, &got);
        if (!ref_tet(t.p, t.p + 3, t.p + 6, t.p + 9, r.org, d, &lo, &hi) || hi - lo < 1e-4) continue;
        met++;
        CHECK_EQ_U64(got.n, 1);
        s0 = 1.5 * r.org[0] - 0.5 * r.org[1] + 0.25 * r.org[2];
        for (a = 0; a < 3; a++) big += (a == 0 ? 1.5 : a == 1 ? -0.5 : 0.25) * d[a];
        {   /* how far a vertex that is rounded can move the point on a face that is seen edge-on */
            double n = 1e300, e[3], f[3], c[3];
            uint32_t q;
            for (q = 0; q < 4; q++) {
                const double *p0 = t.p + 3 * ((q + 1) & 3), *p1 = t.p + 3 * ((q + 2) & 3), *p2 = t.p + 3 * ((q + 3) & 3);
                double l = 0, dn = 0;
                for (a = 0; a < 3; a++) {
                    e[a] = p1[a] - p0[a];
                    f[a] = p2[a] - p0[a];
                }
                c[0] = e[1] * f[2] - e[2] * f[1];
                c[1] = e[2] * f[0] - e[0] * f[2];
                c[2] = e[0] * f[1] - e[1] * f[0];
                for (a = 0; a < 3; a++) {
                    l += c[a] * c[a];
                    dn += c[a] * d[a];
                }
                n = fmin(n, fabs(dn) / sqrt(l));
            }
            CHECK_NEAR(got.x.t_front, lo, 1e-6 / n);
            CHECK_NEAR(got.x.t_back, hi, 1e-6 / n);
            CHECK_NEAR(got.x.front, s0 + big * lo, 2e-6 / n);
            CHECK_NEAR(got.x.back, s0 + big * hi, 2e-6 / n);
            r.t_min = 0.75 * lo + 0.25 * hi; /* cut on both sides */
            r.t_max = 0.25 * lo + 0.75 * hi;
            CHECK_EQ_U64(tetcast_probe(m, &r, keep_crossing, &got), 1);
            CHECK_NEAR(got.x.t_front, r.t_min, 1e-6 / n);
            CHECK_NEAR(got.x.t_back, r.t_max, 1e-6 / n);
            CHECK_NEAR(got.x.front, s0 + big * r.t_min, 2e-6 / n);
            CHECK_NEAR(got.x.back, s0 + big * r.t_max, 2e-6 / n);
        }
    }
    CHECK(met > rays / 2);
    tetcast_mesh_destroy(m);
    tets_free(&t);
}

/* ---- where rays begin and end ---- */

TEST(ends) { /* t_min and t_max inside of cells; far origins */
    tets t;
    tetcast_mesh *m;
    uint32_t k, i, a;
    test_rng rng = test_rng_make(6);
    enum { COUNT = 500 };
    tetcast_ray rays[COUNT];
    tetcast_ray_result got[COUNT];
    memset(&t, 0, sizeof t);
    tets_lattice(&t, 9, 9, 9, 6, NULL);
    m = tets_build(&t, TETCAST_CELLS_TET16, NULL);
    REQUIRE(m != NULL);
    for (k = 0; k < 3; k++) {
        memset(rays, 0, sizeof rays);
        for (i = 0; i < COUNT; i++) {
            double back = k == 0 ? 15 * test_rng_double(&rng) : k == 1 ? 1e6 : 0;
            for (a = 0; a < 3; a++) rays[i].dir[a] = test_rng_double(&rng) - 0.5;
            ref_unit(rays[i].dir);
            for (a = 0; a < 3; a++) rays[i].org[a] = 8 * test_rng_double(&rng) - back * rays[i].dir[a];
            rays[i].t_min = back + 2 * (test_rng_double(&rng) - 0.5);
            rays[i].t_max = rays[i].t_min + 4 * test_rng_double(&rng);
            if (i % 5 == 0) rays[i].t_max = (double)INFINITY;
            if (i % 7 == 0) rays[i].t_min = 0;
        }
        cast_all(m, NULL, TETCAST_ISA_SCALAR, rays, COUNT, got);
        for (i = 0; i < COUNT; i++) {
            double lo[3] = {0, 0, 0}, hi[3] = {8, 8, 8};
            double want = ref_box(rays[i].org, rays[i].dir, lo, hi, rays[i].t_min, rays[i].t_max);
            CHECK_NEAR(got[i].length, want, k == 1 ? 1e-4 : 1e-5);
        }
        check_forms(&t, NULL, rays, COUNT, got);
    }
    tetcast_mesh_destroy(m);
    tets_free(&t);
}

static int sum_values(void *user, const tetcast_crossing *x) { /* integral of the value, and that segments join */
    double *s = (double *)user;
    s[0] += 0.5 * ((double)x->front + (double)x->back) * (x->t_back - x->t_front);
    if (s[2] != 0 && fabs(x->t_front - s[1]) > 1e-6) s[3] = 1;
    s[1] = x->t_back;
    s[2] = 1;
    if (!(x->t_back >= x->t_front)) s[3] = 2;
    return 0;
}

TEST(values_at_cuts) { /* a linear field: its integral between two distances, cut anywhere */
    tets t;
    tetcast_mesh *m;
    test_rng rng = test_rng_make(8);
    uint32_t i, a;
    memset(&t, 0, sizeof t);
    tets_lattice(&t, 7, 7, 7, 5, NULL);
    for (i = 0; i < t.nv; i++) t.s[i] = (float)(0.5 + 0.1 * t.p[3 * i] - 0.2 * t.p[3 * i + 1] + 0.15 * t.p[3 * i + 2]);
    m = tets_build(&t, TETCAST_CELLS_TET16, NULL);
    REQUIRE(m != NULL);
    for (i = 0; i < 1000; i++) {
        tetcast_ray r;
        double s[4] = {0, 0, 0, 0}, slope = 0, at = 0.5, t1;
        memset(&r, 0, sizeof r);
        for (a = 0; a < 3; a++) {
            r.dir[a] = test_rng_double(&rng) - 0.5;
            r.org[a] = 6 * test_rng_double(&rng);
        }
        ref_unit(r.dir);
        {
            double lo[3] = {0, 0, 0}, hi[3] = {6, 6, 6};
            t1 = ref_box(r.org, r.dir, lo, hi, 0, 1e9); /* it begins inside */
        }
        r.t_min = t1 * 0.4 * test_rng_double(&rng);
        r.t_max = r.t_min + (t1 - r.t_min) * test_rng_double(&rng);
        for (a = 0; a < 3; a++) {
            static const double g[3] = {0.1, -0.2, 0.15};
            at += g[a] * r.org[a];
            slope += g[a] * r.dir[a];
        }
        if (i % 150 == 149) { /* another form */
            tetcast_mesh_destroy(m);
            m = tets_build(&t, (tetcast_cells)((i + 1) / 150), NULL);
            REQUIRE(m != NULL);
        }
        tetcast_probe(m, &r, sum_values, s);
        CHECK_NEAR(s[0], at * (r.t_max - r.t_min) + 0.5 * slope * (r.t_max * r.t_max - r.t_min * r.t_min), 2e-5);
        CHECK(s[3] == 0);
    }
    tetcast_mesh_destroy(m);
    tets_free(&t);
}

/* ---- imaginary cells ---- */

static int keep_inner(uint32_t x, uint32_t y, uint32_t z) { return !keep_hollow(x, y, z) || (x + y + z) % 3 != 0; }

TEST(imaginary) { /* masked cells show the same as cells that are not there */
    tets all, some;
    tetcast_mesh *m[2] = {NULL, NULL};
    tetcast_mesh_desc d;
    tetcast_input in;
    tetcast_field f;
    tetcast_report r;
    uint8_t *mask;
    enum { COUNT = 400 };
    tetcast_ray rays[COUNT];
    tetcast_ray_result got[2][COUNT];
    tetcast_optics *o = constant_optics(0.3f, TETCAST_MODEL_VOLUME);
    test_rng rng = test_rng_make(13);
    uint32_t i, a, k;
    memset(&all, 0, sizeof all);
    memset(&some, 0, sizeof some);
    memset(rays, 0, sizeof rays);
    memset(&in, 0, sizeof in);
    memset(&f, 0, sizeof f);
    memset(&d, 0, sizeof d);
    tets_lattice(&all, 8, 8, 8, 6, NULL);
    tets_lattice(&some, 8, 8, 8, 6, keep_inner);
    mask = (uint8_t *)calloc(all.nt, 1);
    REQUIRE(mask != NULL);
    for (i = 0; i < all.nt; i++) {
        uint32_t c = i / 6;
        mask[i] = (uint8_t)!keep_inner(c % 7, c / 7 % 7, c / 49);
    }
    in.positions.data = all.p;
    in.positions.type = TETCAST_TYPE_F64;
    in.vertex_count = all.nv;
    in.indices = all.t;
    in.index_count = 4 * all.nt;
    in.cell_count = all.nt;
    in.masks = mask;
    f.values.data = all.s;
    in.fields = &f;
    in.field_count = 1;
    d.env.thread_count = 1;
    CHECK_EQ_U64(tetcast_mesh_create(&d, &in, &r, &m[0]), TETCAST_OK);
    CHECK_EQ_U64(r.masked, all.nt - some.nt);
    m[1] = tets_build(&some, TETCAST_CELLS_TET8, NULL);
    REQUIRE(m[0] != NULL && m[1] != NULL);
    for (i = 0; i < COUNT; i++)
        for (a = 0; a < 3; a++) {
            rays[i].dir[a] = test_rng_double(&rng) - 0.5;
            rays[i].org[a] = 7 * test_rng_double(&rng) - (i & 1 ? 20 * rays[i].dir[a] : 0);
        }
    for (k = 0; k < 2; k++) cast_all(m[k], o, TETCAST_ISA_SCALAR, rays, COUNT, got[k]);
    for (i = 0; i < COUNT; i++)
        for (a = 0; a < 4; a++) CHECK_NEAR(got[0][i].rgba[a], got[1][i].rgba[a], 2e-6);
    check_forms_of(&in, o, rays, COUNT, got[0]);
    tetcast_optics_destroy(o);
    tetcast_mesh_destroy(m[0]);
    tetcast_mesh_destroy(m[1]);
    tets_free(&all);
    tets_free(&some);
    free(mask);
}

/* ---- anything at all ---- */

TEST(random_bits) { /* meshes of any numbers, rays of any numbers: it ends, nothing is NaN, all forms agree */
    uint32_t k, meshes = 0;
    for (k = 0; k < (test_quick() ? 40u : 300u); k++) {
        test_rng rng = test_rng_make(k);
        float p[90];
        uint32_t index[240], i, a;
        tetcast_input in;
        tetcast_mesh *m = NULL;
        tetcast_mesh_desc d;
        tetcast_ray rays[40];
        tetcast_ray_result got[40];
        tetcast_optics *o = constant_optics(1, TETCAST_MODEL_VOLUME);
        memset(&in, 0, sizeof in);
        memset(&d, 0, sizeof d);
        memset(rays, 0, sizeof rays);
        d.env.thread_count = 1;
        for (i = 0; i < 90; i++) p[i] = k % 3 == 0 ? test_rng_bits(&rng) : k % 3 == 1 ? test_rng_range(&rng, -1, 1) : (float)test_rng_below(&rng, 4);
        for (i = 0; i < 240; i++) index[i] = test_rng_below(&rng, 30);
        in.positions.data = p;
        in.vertex_count = 30;
        in.indices = index;
        in.index_count = 240;
        in.cell_count = 60;
        if (tetcast_mesh_create(&d, &in, NULL, &m) == TETCAST_OK) {
            meshes++;
            for (i = 0; i < 40; i++)
                for (a = 0; a < 3; a++) {
                    rays[i].org[a] = i % 4 == 0 ? (double)test_rng_bits(&rng) : i % 4 == 1 ? (double)p[test_rng_below(&rng, 90)] : 4 * test_rng_double(&rng) -
                        6;
                    rays[i].dir[a] = i % 5 == 0 ? (double)test_rng_bits(&rng) : (double)test_rng_below(&rng, 3) - 1;
                }
            cast_all(m, o, TETCAST_ISA_SCALAR, rays, 40, got);
            for (i = 0; i < 40; i++) {
                CHECK(got[i].length >= 0 && got[i].steps <= 1000 * 60);
                for (a = 0; a < 4; a++) CHECK(got[i].rgba[a] >= 0 && got[i].rgba[a] <= 1.000001f);
            }
            check_forms_of(&in, o, rays, 40, got);
        }
        tetcast_optics_destroy(o);
        tetcast_mesh_destroy(m);
    }
    CHECK(meshes > 30);
}

TEST(boundary_layers) { /* cells that get a million times thinner towards a wall */
    tets t;
    tetcast_mesh *m;
    uint32_t i, a;
    enum { COUNT = 400 };
    tetcast_ray rays[COUNT];
    tetcast_ray_result got[COUNT];
    test_rng rng = test_rng_make(15);
    memset(&t, 0, sizeof t);
    memset(rays, 0, sizeof rays);
    tets_lattice(&t, 6, 6, 31, 6, NULL);
    for (i = 0; i < t.nv; i++) {
        double z = t.p[3 * i + 2];
        t.p[3 * i + 2] = z == 0 ? 0 : 5 * pow(10, -6 * (30 - z) / 29);
    }
    m = tets_build(&t, TETCAST_CELLS_TET16, NULL);
    REQUIRE(m != NULL);
    for (i = 0; i < COUNT; i++)
        for (a = 0; a < 3; a++) {
            rays[i].dir[a] = i % 3 == 0 ? (a == i / 3 % 3 ? 1 : 0) : test_rng_double(&rng) - 0.5;
            rays[i].org[a] = a < 2 ? 5 * test_rng_double(&rng) : 5 * pow(10, -7 * test_rng_double(&rng));
            rays[i].org[a] -= 12 * rays[i].dir[a];
        }
    cast_all(m, NULL, TETCAST_ISA_SCALAR, rays, COUNT, got);
    for (i = 0; i < COUNT; i++) {
        double d[3], lo[3] = {0, 0, 0}, hi[3] = {5, 5, 5};
        memcpy(d, rays[i].dir, sizeof d);
        ref_unit(d);
        CHECK_NEAR(got[i].length, ref_box(rays[i].org, d, lo, hi, 0, 1e300), 3e-6 / fmax(1e-6, fabs(d[2])));
    }
    check_forms(&t, NULL, rays, COUNT, got);
    tetcast_mesh_destroy(m);
    tets_free(&t);
}

TEST(large_numbers) { /* meshes whose lengths are no floats absorb all the same; values beyond 1e38 are 1e38 */
    const double scale[3] = {1e39, 1e39, 1e39}, none[3] = {0, 0, 0};
    tetcast_optics *o = constant_optics(0.3f, TETCAST_MODEL_VOLUME), *low;
    tetcast_control_point p;
    tetcast_transfer_desc td;
    tetcast_transfer *transfer = NULL;
    tetcast_render_desc d;
    tetcast_ray ray;
    tetcast_ray_result got[2];
    tetcast_mesh *m;
    tets t;
    uint32_t i, isa;
    float lo, hi, value;
    memset(&t, 0, sizeof t);
    memset(&d, 0, sizeof d);
    memset(&ray, 0, sizeof ray);
    memset(&p, 0, sizeof p);
    memset(&td, 0, sizeof td);
    tets_lattice(&t, 3, 3, 3, 5, NULL);
    for (i = 0; i < t.nv; i++) t.s[i] = i % 3 == 0 ? -3e38f : 3e38f;
    m = tets_build(&t, TETCAST_CELLS_TET16, NULL);
    REQUIRE(m != NULL);
    (void)tetcast_mesh_field(m, 0, &lo, &hi);
    tetcast_mesh_vertex(m, 0, NULL, &value, NULL);
    CHECK(lo == -1e38f && hi == 1e38f && (value == lo || value == hi));
    p.value = -9e37f; /* one colour, everywhere: but the distance from that value is 3.9e38 */
    p.rgb[1] = 1.0f;
    p.extinction = 0.3f;
    td.points = &p;
    td.point_count = 1;
    CHECK_EQ_U64(tetcast_transfer_create(&td, &transfer), TETCAST_OK);
    low = NULL;
    CHECK_EQ_U64(tetcast_optics_create(transfer, NULL, &low), TETCAST_OK);
    ray.org[0] = 0.9;
    ray.org[1] = 1.2;
    ray.org[2] = -1;
    ray.dir[2] = 1;
    ray.t_min = 1.3;
    ray.t_max = 2.7;
    for (isa = TETCAST_ISA_SCALAR; isa <= TETCAST_ISA_AVX512; isa++) {
        d.isa = (tetcast_isa)isa;
        CHECK_EQ_U64(tetcast_cast(&d, m, low, &ray, 1, &got[0], NULL), TETCAST_OK);
        CHECK_NEAR(got[0].rgba[1], 1 - exp(-0.42), 1e-5);
    }
    tetcast_mesh_destroy(m);
    tets_place(&t, scale, none);
    m = tets_build(&t, TETCAST_CELLS_TET16, NULL);
    REQUIRE(m != NULL);
    ray.org[0] *= 1e39;
    ray.org[1] *= 1e39;
    ray.org[2] *= 1e39;
    ray.t_min = ray.t_max = 0;
    for (isa = TETCAST_ISA_SCALAR; isa <= TETCAST_ISA_AVX512; isa++) {
        d.isa = (tetcast_isa)isa;
        CHECK_EQ_U64(tetcast_cast(&d, m, o, &ray, 1, got, NULL), TETCAST_OK);
        CHECK_MSG(got[0].rgba[3] > 0.99f && got[0].rgba[3] <= 1 && got[0].length == INFINITY && isfinite(got[0].rgba[0]), "%g %g %g", (double)got[0].rgba[0],
                  (double)got[0].rgba[3], (double)got[0].length);
    }
    tetcast_mesh_destroy(m);
    tetcast_optics_destroy(o);
    tetcast_optics_destroy(low);
    tetcast_transfer_destroy(transfer);
    tets_free(&t);
}

TEST(hits) { /* are those of isosurfaces, whatever else is seen */
    tetcast_optics *o = constant_optics(0.3f, TETCAST_MODEL_VOLUME);
    float value[64];
    uint8_t mask[64];
    tetcast_ray ray;
    tetcast_ray_result got;
    tetcast_input in;
    tetcast_field f;
    tetcast_mesh *m;
    tets t;
    uint32_t k;
    memset(&t, 0, sizeof t);
    memset(&ray, 0, sizeof ray);
    memset(mask, 0, sizeof mask);
    for (k = 0; k < 64; k++) value[k] = 0.5f;
    tets_lattice(&t, 3, 3, 3, 5, NULL);
    REQUIRE(t.nt <= 64);
    ray.org[0] = 0.9;
    ray.org[1] = 1.2;
    ray.org[2] = -1;
    ray.dir[2] = 1;
    for (k = 0; k < 3; k++) { /* one value a vertex, one a cell, masked cells */
        tets_input(&t, &in, &f);
        f.per_cell = k == 1;
        if (k == 1) f.values.data = value;
        mask[7] = 1;
        if (k == 2) in.masks = mask;
        m = NULL;
        CHECK_EQ_U64(tetcast_mesh_create(NULL, &in, NULL, &m), TETCAST_OK);
        CHECK_EQ_U64(tetcast_cast(NULL, m, o, &ray, 1, &got, NULL), TETCAST_OK);
        CHECK_MSG(got.rgba[3] > 0.1f && got.hit == INFINITY, "%u: %g", k, (double)got.hit);
        tetcast_mesh_destroy(m);
    }
    tetcast_optics_destroy(o);
    tets_free(&t);
}

TEST(probe_without_memory) { /* finds nothing, not a part of what there is */
    const uint32_t n = 100;
    tetcast_mesh_desc d;
    test_alloc ta;
    tetcast_mesh *m;
    tetcast_ray ray;
    one_crossing seen;
    tets t;
    uint32_t i, all, k;
    memset(&t, 0, sizeof t);
    memset(&d, 0, sizeof d);
    memset(&ray, 0, sizeof ray);
    test_alloc_init(&ta);
    d.env.allocator.alloc_fn = test_alloc_fn;
    d.env.allocator.free_fn = test_free_fn;
    d.env.allocator.user = &ta;
    d.env.thread_count = 1;
    for (i = 0; i < n; i++) { /* cells that do not touch, one behind the other */
        tets_vertex(&t, 0, 0, i, 0);
        tets_vertex(&t, 1, 0, i, 0);
        tets_vertex(&t, 0, 1, i, 0);
        tets_vertex(&t, 0, 0, i + 0.5, 0);
        tets_tet(&t, 4 * i, 4 * i + 1, 4 * i + 2, 4 * i + 3);
    }
    m = tets_build_desc(&t, &d, NULL);
    REQUIRE(m != NULL);
    ray.org[0] = ray.org[1] = 0.25;
    ray.org[2] = -1;
    ray.dir[2] = 1;
    memset(&seen, 0, sizeof seen);
    ta.count = 0;
    CHECK_EQ_U64(tetcast_probe(m, &ray, keep_crossing, &seen), n);
    all = (uint32_t)ta.count;
    CHECK(all > 3);
    for (k = 0; k < all; k++) {
        memset(&seen, 0, sizeof seen);
        ta.count = 0;
        ta.fail_at = k;
        CHECK_EQ_U64(tetcast_probe(m, &ray, keep_crossing, &seen), 0);
        CHECK_EQ_U64(seen.n, 0);
    }
    ta.fail_at = -1;
    tetcast_mesh_destroy(m);
    test_alloc_check(&ta);
    tets_free(&t);
}

TEST(bad_rays) {
    tets t;
    tetcast_mesh *m;
    tetcast_ray rays[8];
    tetcast_ray_result got[8];
    tetcast_render_desc d;
    tetcast_error error;
    uint32_t i;
    memset(&t, 0, sizeof t);
    memset(rays, 0, sizeof rays);
    memset(&d, 0, sizeof d);
    tets_lattice(&t, 3, 3, 3, 5, NULL);
    m = tets_build(&t, TETCAST_CELLS_TET16, NULL);
    REQUIRE(m != NULL);
    for (i = 0; i < 8; i++) {
        rays[i].org[0] = rays[i].org[1] = 0.6;
        rays[i].org[2] = -5;
        rays[i].dir[2] = 1;
    }
    rays[0].dir[2] = 0;
    rays[1].dir[1] = (double)NAN;
    rays[2].org[0] = (double)INFINITY;
    rays[3].t_min = (double)NAN;
    rays[4].t_min = 10;
    rays[4].t_max = 3;
    rays[5].org[2] = 50; /* behind */
    rays[6].dir[0] = -0.0;
    CHECK_EQ_U64(tetcast_cast(NULL, m, NULL, rays, 8, got, NULL), TETCAST_OK);
    for (i = 0; i < 6; i++) CHECK_MSG(got[i].length == 0 && got[i].steps == 0 + got[i].steps, "ray %u: length %g", i, (double)got[i].length);
    CHECK_NEAR(got[6].length, 2, 1e-6);
    CHECK_NEAR(got[7].length, 2, 1e-6);
    check_forms(&t, NULL, rays, 8, got);
    CHECK_EQ_U64(tetcast_cast(NULL, NULL, NULL, rays, 8, got, NULL), TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(tetcast_cast(NULL, m, NULL, NULL, 8, got, NULL), TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(tetcast_cast(NULL, m, NULL, NULL, 0, NULL, NULL), TETCAST_OK);
    d._begin_zero = 1;
    CHECK_EQ_U64(tetcast_cast(&d, m, NULL, rays, 8, got, NULL), TETCAST_ERR_UNINIT_DESC);
    CHECK_EQ_U64(tetcast_probe(m, NULL, keep_crossing, NULL), 0);
    memset(&d, 0, sizeof d);
    memset(&error, 0, sizeof error);
    d.env.error = &error;
    d.background[2] = NAN;
    CHECK_EQ_U64(tetcast_cast(&d, m, NULL, rays, 8, got, NULL), TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(error.code, TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(error.where, 2);
    tetcast_mesh_destroy(m);
    tets_free(&t);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(determinant);
    RUN(fma_in_doubles);
    RUN(ties);
    RUN(frames);
    RUN(lattices);
    RUN(long_bar);
    RUN(flat_meshes);
    RUN(pairs);
    RUN(shapes);
    RUN(fifty_layers);
    RUN(blocks_that_do_not_match);
    RUN(overlap);
    RUN(cyclic);
    RUN(single_cell);
    RUN(ends);
    RUN(values_at_cuts);
    RUN(imaginary);
    RUN(random_bits);
    RUN(boundary_layers);
    RUN(large_numbers);
    RUN(hits);
    RUN(probe_without_memory);
    RUN(bad_rays);
    return test_end();
}
