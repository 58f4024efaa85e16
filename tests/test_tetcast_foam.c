/* Foams: neighbours are those of a brute-force clipping of each face, rays those of a march through all sites in doubles, and hard
   places of sites (lattices, planes, lines, spheres, doubles, clusters) lose no ray. */
#include "test.h"
#define TETCAST_IMPLEMENTATION
#include "tetcast.h"
#include "foam_oracle.h"

enum { KINDS = 10, MOST = 2048 };
static const char *const kind_name[KINDS] = {"uniform", "clusters", "lattice", "centre of a sphere",
                                              "plane", "line", "doubles", "two scales", "pairs", "close pairs"};

/* Sites of a kind in about the unit cube; colours and extinctions at random, a third of them empty. */
static void make_sites(uint32_t kind, uint32_t n, uint64_t seed, tetcast_site *s) {
    test_rng g = test_rng_make(seed);
    uint32_t i, a, side = 1;
    while ((side + 1) * (side + 1) * (side + 1) <= n) side++;
    for (i = 0; i < n; i++) {
        double v[3];
        for (a = 0; a < 3; a++) v[a] = test_rng_double(&g);
        if (kind == 1 || (kind == 7 && i % 2 != 0))
            for (a = 0; a < 3; a++) v[a] = (kind == 7 ? 0.4 : (double)((i * 7 + a * 3) % 5) / 5.0) + (kind == 7 ? 1e-3 : 1e-2) * (v[a] - 0.5);
        if (kind == 2) { /* the rest doubles some of them */
            v[0] = (double)(i % side) / side;
            v[1] = (double)(i / side % side) / side;
            v[2] = (double)(i / side / side % side) / side;
        }
        if (kind == 3) {
            double l;
            for (a = 0; a < 3; a++) v[a] -= 0.5;
            l = foam_length(v);
            for (a = 0; a < 3; a++) v[a] = i == 0 ? 0.5 : 0.5 + 0.5 * v[a] / l;
        }
        if (kind == 4) v[1] = 0.25;
        if (kind == 5) v[1] = v[2] = v[0];
        if (kind == 6 && i > n / 2)
            for (a = 0; a < 3; a++) v[a] = s[i - n / 2].position[a];
        if (kind >= 8 && i % 2 != 0) /* nearer to each other than floats tell their planes apart */
            for (a = 0; a < 3; a++) v[a] = s[i - 1].position[a] + (kind == 8 ? 1e-5 : 1e-6) * (v[a] - 0.5);
        for (a = 0; a < 3; a++) {
            s[i].position[a] = floor(v[a] * 8388608.0 + 0.5) / 8388608.0; /* as they are kept */
            s[i].rgb[a] = test_rng_float(&g);
        }
        s[i].extinction = test_rng_below(&g, 3) == 0 ? 0.0f : test_rng_range(&g, 0.1f, 4.0f);
    }
}

static tetcast_foam *make_foam(uint32_t kind, uint32_t n, uint64_t seed, tetcast_site *s) {
    tetcast_foam *f = NULL;
    tetcast_foam_desc d;
    uint32_t a;
    memset(&d, 0, sizeof d);
    make_sites(kind, n, seed, s);
    for (a = 0; a < 3; a++) {
        d.box_min[a] = -0.125 * (double)(seed % 3);
        d.box_max[a] = 1.0 + 0.0625 * (double)(seed % 5);
    }
    CHECK_EQ_U64(tetcast_foam_create(&d, s, n, &f), TETCAST_OK);
    return f;
}

/* ---- neighbours ---- */

typedef struct polygon { double x[256][3]; uint32_t n; } polygon;

/* Keep n . x <= offset. */
static void cut_polygon(polygon *p, const double n[3], double offset) {
    polygon q;
    uint32_t i, a;
    q.n = 0;
    for (i = 0; i < p->n; i++) {
        const double *u = p->x[i], *v = p->x[(i + 1) % p->n];
        const double su = n[0] * u[0] + n[1] * u[1] + n[2] * u[2] - offset, sv = n[0] * v[0] + n[1] * v[1] + n[2] * v[2] - offset;
        if (su <= 0.0) memcpy(q.x[q.n++], u, sizeof q.x[0]);
        if ((su <= 0.0) != (sv <= 0.0)) {
            for (a = 0; a < 3; a++) q.x[q.n][a] = u[a] + (v[a] - u[a]) * (su / (su - sv));
            q.n++;
        }
    }
    *p = q;
}

static double polygon_area(const polygon *p) {
    double sum[3] = {0, 0, 0};
    uint32_t i, a;
    for (i = 2; i < p->n; i++)
        for (a = 0; a < 3; a++) {
            const uint32_t b = (a + 1) % 3, c = (a + 2) % 3;
            sum[a] += (p->x[i - 1][b] - p->x[0][b]) * (p->x[i][c] - p->x[0][c]) - (p->x[i - 1][c] - p->x[0][c]) * (p->x[i][b] - p->x[0][b]);
        }
    return 0.5 * foam_length(sum);
}

/* The face between two sites, all planes moved outwards by `slack`; an empty polygon: there is none. */
static polygon face_of(const tetcast_site *s, uint32_t n, const tetcast_foam_info *info, uint32_t i, uint32_t j, double slack) {
    polygon p;
    double d[3], u[3], v[3], mid[3], l;
    uint32_t k, a, least = 0;
    for (a = 0; a < 3; a++) {
        d[a] = s[j].position[a] - s[i].position[a];
        mid[a] = 0.5 * (s[i].position[a] + s[j].position[a]);
    }
    l = foam_length(d);
    for (a = 0; a < 3; a++) least = fabs(d[a]) < fabs(d[least]) ? a : least;
    for (a = 0; a < 3; a++) u[a] = (a == least) - d[a] * d[least] / (l * l);
    l = foam_length(u);
    for (a = 0; a < 3; a++) u[a] /= l;
    for (a = 0; a < 3; a++) v[a] = (d[(a + 1) % 3] * u[(a + 2) % 3] - d[(a + 2) % 3] * u[(a + 1) % 3]) / foam_length(d);
    p.n = 4;
    for (k = 0; k < 4; k++)
        for (a = 0; a < 3; a++) p.x[k][a] = mid[a] + (k == 0 || k == 3 ? -8 : 8) * u[a] + (k < 2 ? -8 : 8) * v[a];
    for (a = 0; a < 3; a++) {
        double e[3] = {0, 0, 0};
        e[a] = 1;
        cut_polygon(&p, e, info->box_max[a] + slack);
        e[a] = -1;
        cut_polygon(&p, e, -info->box_min[a] + slack);
    }
    for (k = 0; k < n && p.n != 0; k++) {
        double e[3], offset = 0.0;
        if (k == i || k == j) continue;
        for (a = 0; a < 3; a++) e[a] = s[k].position[a] - s[i].position[a];
        l = foam_length(e);
        if (l < 1e-9) continue; /* a double */
        for (a = 0; a < 3; a++) {
            e[a] /= l;
            offset += e[a] * 0.5 * (s[i].position[a] + s[k].position[a]);
        }
        cut_polygon(&p, e, offset + slack);
    }
    return p;
}

TEST(neighbours_are_those_of_brute_force) {
    static tetcast_site s[MOST];
    uint32_t kind, seed, i, j, faces = 0, missing = 0, extra = 0;
    for (kind = 0; kind < KINDS; kind++)
        for (seed = 0; seed < (test_quick() ? 1u : 3u); seed++) {
            const uint32_t n = 20 + 17 * seed;
            tetcast_foam *f = make_foam(kind, n, seed, s);
            tetcast_foam_info info;
            static uint8_t have[MOST][MOST];
            memset(have, 0, sizeof have);
            REQUIRE(f != NULL);
            tetcast_foam_get_info(f, &info);
            for (i = 0; i < info.cell_count; i++) {
                uint32_t site, other, near[MOST];
                const uint32_t count = tetcast_foam_cell(f, i, &site, near, MOST);
                for (j = 0; j < count; j++) {
                    (void)tetcast_foam_cell(f, near[j], &other, NULL, 0);
                    CHECK(site != other && !have[site][other]);
                    have[site][other] = 1;
                }
            }
            for (i = 0; i < n; i++)
                for (j = 0; j < n; j++) {
                    const double d[3] = {s[i].position[0] - s[j].position[0], s[i].position[1] - s[j].position[1], s[i].position[2] - s[j].position[2]};
                    polygon p;
                    if (foam_length(d) < 1e-9 || (kind == 2 && (i >= info.cell_count || j >= info.cell_count)) || (kind == 6 && (i > n / 2 || j > n / 2)))
                        continue; /* doubles have no cell */
                    p = face_of(s, n, &info, i, j, have[i][j] ? 1e-6 : 0.0);
                    faces += have[i][j];
                    extra += have[i][j] && p.n == 0;
                    missing += !have[i][j] && p.n != 0 && polygon_area(&p) > 1e-7;
                }
            CHECK_MSG(missing == 0 && extra == 0, "%s, %u sites: %u faces are missing, %u too many", kind_name[kind], n, missing, extra);
            tetcast_foam_destroy(f);
        }
    CHECK(faces > 300);
}

/* ---- rays ---- */

static void random_ray(test_rng *g, tetcast_ray *r) {
    uint32_t a;
    memset(r, 0, sizeof *r);
    for (a = 0; a < 3; a++) {
        r->org[a] = 3.0 * test_rng_double(g) - 1.0;
        r->dir[a] = 1.5 * test_rng_double(g) - 0.25 - r->org[a];
    }
    if (test_rng_below(g, 4) == 0) r->t_max = 0.3 + test_rng_double(g);
    if (test_rng_below(g, 4) == 0) r->t_min = r->t_max != 0 ? 0.2 : -0.4;
    if (r->t_min != 0 && r->t_max == 0) r->t_max = 10;
}

TEST(rays_are_those_of_brute_force) {
    enum { RAYS = 64 };
    static tetcast_site s[MOST];
    double worst = 0;
    uint32_t kind, seed, i, a, scenes = 0, hits = 0, off = 0;
    for (kind = 0; kind < KINDS; kind++)
        for (seed = 0; seed < (test_quick() ? 6u : 28u); seed++, scenes++) {
            const uint32_t n = kind == 3 ? 300 : 1 + 9 * seed;
            tetcast_foam *f = make_foam(kind, n, seed, s);
            test_rng g = test_rng_make(1000 * seed + kind);
            tetcast_ray ray[RAYS];
            tetcast_ray_result got[RAYS], same[RAYS];
            tetcast_render_desc rd;
            tetcast_foam_info info;
            REQUIRE(f != NULL);
            memset(&rd, 0, sizeof rd);
            rd.isa = TETCAST_ISA_SCALAR;
            tetcast_foam_get_info(f, &info);
            for (i = 0; i < RAYS; i++) random_ray(&g, &ray[i]);
            CHECK_EQ_U64(tetcast_foam_cast(NULL, f, ray, RAYS, got, NULL), TETCAST_OK);
            CHECK_EQ_U64(tetcast_foam_cast(&rd, f, ray, RAYS, same, NULL), TETCAST_OK);
            CHECK(memcmp(got, same, sizeof got) == 0);
            for (i = 0; i < RAYS; i++) {
                const foam_ray m = foam_march(s, n, &info, &ray[i]);
                const int stopped = got[i].rgba[3] > 0.99f;
                double e = fabs(1.0 - m.left - (double)got[i].rgba[3]);
                for (a = 0; a < 3; a++) e = fmax(e, fabs(m.rgb[a] - (double)got[i].rgba[a]));
                worst = stopped ? worst : fmax(worst, e);
                off += e > (stopped ? 1.0 / 512 : 2e-5);
                hits += m.steps != 0;
                CHECK_MSG(stopped || fabs(m.length - (double)got[i].length) < 1e-5, "%s: length %g instead of %g", kind_name[kind],
                          (double)got[i].length, m.length);
                CHECK((m.first < (double)INFINITY) == (got[i].hit < INFINITY) || m.length < 1e-5);
                CHECK(got[i].steps <= n && (got[i].walks != 0) == (got[i].steps != 0));
            }
            tetcast_foam_destroy(f);
        }
    CHECK_MSG(off == 0, "%u of %u rays are off, the worst by %g", off, hits, worst);
    CHECK(hits > scenes * RAYS / 3);
}

/* Rays that graze the face of two cells: they pass it as near as the contract tells. */
TEST(rays_that_graze_a_face) {
    enum { RAYS = 400 };
    double worst = 0;
    uint32_t k, seen = 0;
    for (k = 0; k < 24; k++) {
        const double dz = 0.27 * pow(10.0, -(double)(k / 6)), sine = pow(10.0, -1.0 - (double)(k % 6));
        const double extinction = 3.0;
        static tetcast_ray ray[RAYS];
        static tetcast_ray_result got[RAYS];
        tetcast_site s[2];
        tetcast_foam_desc d;
        tetcast_foam *f = NULL;
        double place[2][3], w[3], mid[3], t;
        uint32_t i, a;
        memset(s, 0, sizeof s);
        memset(&d, 0, sizeof d);
        memset(ray, 0, sizeof ray);
        for (i = 0; i < 2; i++) {
            s[i].position[0] = 0.31;
            s[i].position[1] = 0.1717 + (i ? dz * sine : 0.0);
            s[i].position[2] = 0.12345 + (i ? dz : 0.0);
            s[i].rgb[2 * i] = 1.0f;
            s[i].extinction = (float)extinction;
        }
        for (a = 0; a < 3; a++) d.box_max[a] = 1.0;
        REQUIRE(tetcast_foam_create(&d, s, 2, &f) == TETCAST_OK);
        for (i = 0; i < f->count && f->count == 2; i++) /* as they are kept */
            for (a = 0; a < 3; a++) place[f->source[i]][a] = f->origin[a] + (double)f->cell[i].place[a] * f->unit;
        for (a = 0; a < 3 && f->count == 2; a++) {
            w[a] = place[1][a] - place[0][a];
            mid[a] = 0.5 * (place[0][a] + place[1][a]);
        }
        if (f->count == 2 && w[1] > 0.0) {
            const double angle = w[1] / sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]);
            for (i = 0; i < RAYS; i++) {
                ray[i].org[0] = 0.9;
                ray[i].org[1] = -0.5;
                ray[i].org[2] = mid[2] - ((i + 0.5) / RAYS - mid[1]) * w[1] / w[2] - (0.9 - mid[0]) * w[0] / w[2];
                ray[i].dir[1] = 1.0;
            }
            CHECK_EQ_U64(tetcast_foam_cast(NULL, f, ray, RAYS, got, NULL), TETCAST_OK);
            for (i = 0; i < RAYS; i++) {
                if (!(ray[i].org[2] > 0.0 && ray[i].org[2] < 1.0)) continue;
                t = (i + 0.5) / RAYS;
                worst = fmax(worst, fabs(1.0 - exp(-extinction * t) - (double)got[i].rgba[0]) / (extinction * 2e-7 / angle + 1e-6));
                seen++;
            }
        }
        tetcast_foam_destroy(f);
    }
    CHECK_MSG(worst <= 1.0 && seen > 12 * RAYS, "%g of what is allowed, %u rays", worst, seen);
}

/* Rays along the axes of a lattice, through faces, edges and corners of its cells and along them: all of the way counts. */
TEST(rays_in_faces_of_a_lattice) {
    enum { SIDE = 8, N = SIDE * SIDE * SIDE };
    static tetcast_site s[N];
    tetcast_foam *f = NULL;
    tetcast_foam_desc d;
    tetcast_render_desc rd;
    uint32_t i, k, a, axis, isa;
    memset(&d, 0, sizeof d);
    memset(&rd, 0, sizeof rd);
    memset(s, 0, sizeof s);
    for (i = 0; i < N; i++)
        for (a = 0; a < 3; a++) {
            s[i].position[a] = 0.5 + (double)(a == 0 ? i % SIDE : a == 1 ? i / SIDE % SIDE : i / SIDE / SIDE);
            s[i].rgb[a] = 1;
            s[i].extinction = 0.125f;
        }
    for (a = 0; a < 3; a++) d.box_max[a] = SIDE;
    REQUIRE(tetcast_foam_create(&d, s, N, &f) == TETCAST_OK);
    for (i = 0; i < N; i++) { /* cubes: six neighbours, fewer at the box, and none across an edge */
        uint32_t site, want = 0;
        (void)tetcast_foam_cell(f, i, &site, NULL, 0);
        for (a = 0; a < 3; a++) want += (uint32_t)(s[site].position[a] > 0.5) + (uint32_t)(s[site].position[a] < SIDE - 0.5);
        CHECK_EQ_U64(tetcast_foam_cell(f, i, NULL, NULL, 0), want);
    }
    for (isa = TETCAST_ISA_SCALAR; isa <= TETCAST_ISA_AVX2; isa += 2)
        for (axis = 0; axis < 7; axis++) /* along edges, diagonals of faces, and of the cube */
            for (i = 0; i <= 2 * SIDE; i++)
                for (k = 0; k <= 2 * SIDE; k++) {
                    tetcast_ray r;
                    tetcast_ray_result got;
                    double way, from = -(double)INFINITY, to = (double)INFINITY;
                    memset(&r, 0, sizeof r);
                    for (a = 0; a < 3; a++) r.dir[a] = (axis + 1) >> a & 1u;
                    r.org[axis % 3] = -1;
                    r.org[(axis + 1) % 3] = 0.5 * i;
                    r.org[(axis + 2) % 3] = 0.5 * k;
                    for (a = 0; a < 3; a++) {
                        if (r.dir[a] == 0 && (r.org[a] < 0 || r.org[a] > SIDE)) to = -(double)INFINITY;
                        if (r.dir[a] == 0) continue;
                        from = fmax(from, -r.org[a]);
                        to = fmin(to, SIDE - r.org[a]);
                    }
                    way = fmax(to - fmax(from, 0), 0) * foam_length(r.dir);
                    rd.isa = (tetcast_isa)isa;
                    CHECK_EQ_U64(tetcast_foam_cast(&rd, f, &r, 1, &got, NULL), TETCAST_OK);
                    CHECK_NEAR(got.length, way, 1e-5);
                    CHECK_NEAR(got.rgba[3], 1.0 - exp(-0.125 * way), 1e-5);
                    CHECK(got.steps <= 3 * SIDE + 3);
                }
    tetcast_foam_destroy(f);
}

/* Rays along the edge in which the cells of a ring meet, however it is turned: they do not go round in it but reach what is behind. */
TEST(rays_in_edges_of_rings) {
    enum { ROW = 60, MEMBERS = 10 };
    tetcast_site s[MEMBERS + ROW];
    static const uint32_t known[7] = {6459, 16477, 26805, 31602, 41526, 42396, 55782}; /* where floats alone go round */
    const uint32_t turns = test_quick() ? 300 : 3000;
    uint32_t step, lost = 0, a, i, k;
    for (step = 0; step < turns + 7; step++) {
        const uint32_t turn = step < turns ? step : known[step - turns];
        const uint32_t n = 3 + turn % (MEMBERS - 2);
        test_rng g = test_rng_make(turn);
        double u[3], v[3], w[3], l, radius;
        tetcast_foam *f = NULL;
        tetcast_foam_desc d;
        tetcast_ray r[16];
        tetcast_ray_result got[16];
        memset(&d, 0, sizeof d);
        memset(s, 0, sizeof s);
        memset(r, 0, sizeof r);
        for (a = 0; a < 3; a++) {
            w[a] = test_rng_double(&g) - 0.5;
            v[a] = test_rng_double(&g) - 0.5;
            d.box_min[a] = -1;
            d.box_max[a] = 1;
        }
        l = foam_length(w);
        for (a = 0; a < 3; a++) w[a] /= l;
        for (a = 0; a < 3; a++) u[a] = w[(a + 1) % 3] * v[(a + 2) % 3] - w[(a + 2) % 3] * v[(a + 1) % 3];
        l = foam_length(u);
        for (a = 0; a < 3; a++) u[a] /= l;
        for (a = 0; a < 3; a++) v[a] = w[(a + 1) % 3] * u[(a + 2) % 3] - w[(a + 2) % 3] * u[(a + 1) % 3];
        radius = 0.4 * pow(10, -4 * test_rng_double(&g));
        for (i = 0; i < n; i++) { /* a ring of empty cells in a plane across w, nearly; then a row of opaque ones along it */
            const double turned = 6.283185307179586 * (test_rng_below(&g, 2) != 0 ? test_rng_double(&g) : (double)i / n);
            const double off = -0.4 + (turn % 3 != 0 ? pow(10, -8 + 2 * test_rng_double(&g)) * (test_rng_double(&g) - 0.5) : 0);
            for (a = 0; a < 3; a++) s[i].position[a] = off * w[a] + radius * (cos(turned) * u[a] + sin(turned) * v[a]);
        }
        for (k = 0; k < ROW; k++, i++) {
            for (a = 0; a < 3; a++) s[i].position[a] = w[a] * 0.8 * k / ROW + 1e-3 * (test_rng_double(&g) - 0.5);
            s[i].extinction = 50;
        }
        REQUIRE(tetcast_foam_create(&d, s, n + ROW, &f) == TETCAST_OK);
        for (k = 0; k < 16; k++)
            for (a = 0; a < 3; a++) {
                r[k].org[a] = -2 * w[a] + (k % 4 == 0 ? 0 : 1e-8) * (test_rng_double(&g) - 0.5);
                r[k].dir[a] = w[a] + (k < 8 ? 0 : 1e-8) * (test_rng_double(&g) - 0.5);
            }
        CHECK_EQ_U64(tetcast_foam_cast(NULL, f, r, 16, got, NULL), TETCAST_OK);
        for (k = 0; k < 16; k++) lost += got[k].rgba[3] < 0.9f || got[k].steps >= n + ROW;
        tetcast_foam_destroy(f);
    }
    CHECK_MSG(lost == 0, "%u of %u rays are lost", lost, 16 * step);
}

/* Colours are not below 0 however little absorbs, and lengths have numbers however far off a ray begins. */
TEST(ends_of_ranges) {
    tetcast_site s[2];
    tetcast_foam *f = NULL;
    tetcast_foam_desc d;
    tetcast_ray r;
    tetcast_ray_result got;
    uint32_t i, a;
    memset(&d, 0, sizeof d);
    for (a = 0; a < 3; a++) {
        d.box_min[a] = -1;
        d.box_max[a] = 1;
    }
    for (i = 0; i < 2000; i++) {
        memset(s, 0, sizeof s);
        memset(&r, 0, sizeof r);
        s[0].position[0] = -0.5;
        s[1].position[0] = 0.5;
        s[0].extinction = i == 1 ? 0.0311629f : 0.001f + 0.0005f * (float)i; /* where the power of e rises */
        s[1].extinction = 1e-9f;
        s[1].rgb[0] = 1e18f;
        r.org[0] = -2;
        r.dir[0] = 1;
        REQUIRE(tetcast_foam_create(&d, s, 2, &f) == TETCAST_OK);
        CHECK_EQ_U64(tetcast_foam_cast(NULL, f, &r, 1, &got, NULL), TETCAST_OK);
        CHECK_MSG(got.rgba[0] >= 0, "%g", (double)got.rgba[0]);
        if (i == 0) { /* in a face of the box, all but along it */
            r.org[1] = -1;
            r.dir[1] = 1e-310;
            CHECK_EQ_U64(tetcast_foam_cast(NULL, f, &r, 1, &got, NULL), TETCAST_OK);
            CHECK_NEAR(got.length, 2.0, 1e-6);
        }
        tetcast_foam_destroy(f);
    }
    for (a = 0; a < 3; a++) {
        d.box_min[a] = -1e90;
        d.box_max[a] = 1e90;
    }
    memset(&r, 0, sizeof r);
    r.org[2] = 1e91;
    r.dir[2] = 1;
    r.t_min = -1e300;
    s[0].extinction = s[1].extinction = 1;
    REQUIRE(tetcast_foam_create(&d, s, 2, &f) == TETCAST_OK);
    CHECK_EQ_U64(tetcast_foam_cast(NULL, f, &r, 1, &got, NULL), TETCAST_OK);
    CHECK(got.hit >= -3e38f && got.hit < 0);
    tetcast_foam_destroy(f);
}

TEST(places_are_in_the_nearest_cell) {
    static tetcast_site s[MOST];
    uint32_t kind, i, k, a;
    for (kind = 0; kind < KINDS; kind++) {
        const uint32_t n = 400;
        tetcast_foam *f = make_foam(kind, n, kind, s);
        test_rng g = test_rng_make(kind);
        REQUIRE(f != NULL);
        for (k = 0; k < 200; k++) {
            double p[3], best = (double)INFINITY, mine = 0;
            uint32_t site, cell;
            for (a = 0; a < 3; a++) p[a] = test_rng_double(&g);
            cell = tetcast_foam_find(f, p, k * 7u);
            (void)tetcast_foam_cell(f, cell, &site, NULL, 0);
            REQUIRE(site < n);
            for (i = 0; i < n; i++) {
                double square = 0;
                for (a = 0; a < 3; a++) square += pow(p[a] - s[i].position[a], 2);
                best = fmin(best, square);
                mine = i == site ? square : mine;
            }
            CHECK_MSG(sqrt(mine) <= sqrt(best) + 1e-5, "%s: a site at %g, the nearest at %g", kind_name[kind], sqrt(mine), sqrt(best));
        }
        tetcast_foam_destroy(f);
    }
}

/* Sites that are hardly apart, and places between two that are not: from any cell the nearest site is found, but for what
   floats do not tell. */
TEST(places_far_from_close_sites) {
    enum { N = 5 };
    static const double far_off = 1.83746865e19, at[N][3] = {{-1023.5, 1.64067751e12, -1024}, {1.64067751e12, -1024, 5.96875},
        {260, -767.0625, -588}, {0, 1.83746865e19, -260}, {1.83746865e19, -260, 768.9375}};
    tetcast_site s[N];
    tetcast_foam_desc desc;
    tetcast_foam *f = NULL;
    uint32_t i, k, a, start;
    memset(s, 0, sizeof s);
    memset(&desc, 0, sizeof desc);
    for (i = 0; i < N; i++)
        for (a = 0; a < 3; a++) s[i].position[a] = at[i][a];
    for (a = 0; a < 3; a++) {
        desc.box_min[a] = a < 2 ? -1024 : -2e6;
        desc.box_max[a] = a < 2 ? far_off : 772;
    }
    REQUIRE(tetcast_foam_create(&desc, s, N, &f) == TETCAST_OK);
    for (k = 0; k < 1000; k++)
        for (start = 0; start < N; start++) {
            double p[3] = {far_off * (0.51 + 0.0004 * k), far_off * (0.51 + 0.0004 * k), -943852.8}, best = (double)INFINITY, mine = 0;
            uint32_t site;
            (void)tetcast_foam_cell(f, tetcast_foam_find(f, p, start), &site, NULL, 0);
            REQUIRE(site < N);
            for (i = 0; i < N; i++) {
                double square = 0;
                for (a = 0; a < 3; a++) square += pow((p[a] - s[i].position[a]) / far_off, 2);
                best = fmin(best, square);
                mine = i == site ? square : mine;
            }
            CHECK_MSG(sqrt(mine) <= sqrt(best) + 1e-5, "from %u: a site at %g, the nearest at %g", (unsigned)start, sqrt(mine), sqrt(best));
        }
    tetcast_foam_destroy(f);
}

/* Places that are hardly beyond a face are found beyond it. */
TEST(places_beside_a_face) {
    tetcast_site s[2];
    tetcast_foam_desc d;
    tetcast_foam *f = NULL;
    uint32_t i, k, a;
    memset(s, 0, sizeof s);
    memset(&d, 0, sizeof d);
    for (i = 0; i < 2; i++) {
        s[i].position[0] = i ? 0.75 : 0.25;
        s[i].position[1] = s[i].position[2] = 0.5;
    }
    for (a = 0; a < 3; a++) d.box_max[a] = 1.0;
    REQUIRE(tetcast_foam_create(&d, s, 2, &f) == TETCAST_OK);
    for (k = 0; k < 8; k++) {
        const double p[3] = {0.5 + (k / 4 ? 1e-6 : -1e-6) * (k % 2 ? 1 : 2), 0.4, 0.6};
        uint32_t site = 2;
        (void)tetcast_foam_cell(f, tetcast_foam_find(f, p, k % 4 / 2), &site, NULL, 0);
        CHECK_EQ_U64(site, k / 4);
    }
    tetcast_foam_destroy(f);
}

/* ---- pictures ---- */

enum { W = 70, H = 45 };

static void foam_picture(const tetcast_foam *f, tetcast_render_desc *d, float *rgba, float *depth, float *length, uint32_t *steps,
    tetcast_render_stats *stats) {
    tetcast_image m;
    memset(&m, 0, sizeof m);
    m.width = W;
    m.height = H;
    m.rgba = rgba;
    m.depth = depth;
    m.length = length;
    m.steps = steps;
    CHECK_EQ_U64(tetcast_foam_render(d, f, &m, stats), TETCAST_OK);
}

TEST(pictures_are_rays) { /* the same bits for any instruction set and number of threads; those of single rays; parts add up to the whole */
    static tetcast_site s[MOST];
    static float rgba[3][W * H][4], depth[3][W * H], length[3][W * H];
    static uint32_t steps[3][W * H];
    tetcast_foam *f = make_foam(0, 900, 1, s);
    tetcast_render_desc d;
    tetcast_render_stats stats;
    uint32_t i, a, isa, threads, seen = 0;
    REQUIRE(f != NULL);
    memset(&d, 0, sizeof d);
    memset(&stats, 0, sizeof stats);
    d.camera.eye[0] = 2.5;
    d.camera.eye[1] = 1.2;
    d.camera.eye[2] = -1.5;
    for (a = 0; a < 3; a++) d.camera.at[a] = 0.5;
    d.isa = TETCAST_ISA_SCALAR;
    d.env.thread_count = 1;
    foam_picture(f, &d, rgba[0][0], depth[0], length[0], steps[0], &stats);
    CHECK(stats.rays == W * H && stats.hit_rays > 500 && stats.steps > 5000 && stats.isa == TETCAST_ISA_SCALAR);
    for (isa = 0; isa < 5; isa++)
        for (threads = 1; threads < 4; threads++) {
            d.isa = (tetcast_isa)isa;
            d.env.thread_count = threads;
            foam_picture(f, &d, rgba[1][0], depth[1], length[1], steps[1], NULL);
            CHECK(memcmp(rgba[0], rgba[1], sizeof rgba[0]) == 0 && memcmp(depth[0], depth[1], sizeof depth[0]) == 0);
            CHECK(memcmp(length[0], length[1], sizeof length[0]) == 0 && memcmp(steps[0], steps[1], sizeof steps[0]) == 0);
        }
    for (i = 0; i < W * H; i++) {
        tetcast_ray r;
        tetcast_ray_result one;
        CHECK_EQ_U64(tetcast_camera_ray(&d.camera, W, H, i % W + 0.5, i / W + 0.5, &r), TETCAST_OK);
        CHECK_EQ_U64(tetcast_foam_cast(&d, f, &r, 1, &one, NULL), TETCAST_OK);
        for (a = 0; a < 4; a++) CHECK_NEAR(one.rgba[a], rgba[0][i][a], 1e-6);
        CHECK((one.hit < INFINITY) == (depth[0][i] < INFINITY));
        if (one.hit < INFINITY) {
            double cosine = 0, l = 0;
            for (a = 0; a < 3; a++) {
                cosine += r.dir[a] * (d.camera.at[a] - d.camera.eye[a]);
                l += pow(d.camera.at[a] - d.camera.eye[a], 2);
            }
            CHECK_NEAR(depth[0][i], (double)one.hit * cosine / sqrt(l), 1e-5);
            seen++;
        }
    }
    CHECK(seen > 300);
    d.clip_far = 2.6f; /* what is in front of a plane, and behind it */
    foam_picture(f, &d, rgba[1][0], NULL, length[1], steps[1], NULL);
    d.clip_near = 2.6f;
    d.clip_far = 0;
    foam_picture(f, &d, rgba[2][0], NULL, length[2], steps[2], NULL);
    for (i = 0; i < W * H; i++) {
        for (a = 0; a < 4; a++) CHECK_NEAR(rgba[1][i][a] + (1 - rgba[1][i][3]) * rgba[2][i][a], rgba[0][i][a], rgba[0][i][3] > 0.99f ? 0.01 : 2e-5);
        if (rgba[0][i][3] < 0.99f) CHECK_NEAR(length[1][i] + length[2][i], length[0][i], 1e-5);
    }
    tetcast_foam_destroy(f);
}

TEST(paint) { /* a foam that is painted is one that was made so; what cannot be painted changes nothing */
    static tetcast_site s[300], t[300];
    static float rgba[2][W * H][4];
    tetcast_foam *f = make_foam(6, 300, 2, s), *g = NULL;
    tetcast_foam_info info;
    tetcast_foam_desc fd;
    tetcast_render_desc d;
    uint32_t i, a;
    memset(&d, 0, sizeof d);
    memset(&fd, 0, sizeof fd);
    REQUIRE(f != NULL);
    memcpy(t, s, sizeof t);
    for (i = 0; i < 300; i++) {
        t[i].extinction = (float)(i % 4);
        for (a = 0; a < 3; a++) t[i].rgb[a] = (float)((i + a) % 3) / 2;
    }
    tetcast_foam_get_info(f, &info);
    memcpy(fd.box_min, info.box_min, sizeof fd.box_min);
    memcpy(fd.box_max, info.box_max, sizeof fd.box_max);
    CHECK(info.duplicates == 149 && info.cell_count == 151 && info.first_duplicate == 151 && info.bad_sites == 0 && info.first_bad == TETCAST_NONE);
    REQUIRE(tetcast_foam_create(&fd, t, 300, &g) == TETCAST_OK);
    CHECK_EQ_U64(tetcast_foam_paint(f, t, 300), TETCAST_OK);
    foam_picture(f, &d, rgba[0][0], NULL, NULL, NULL, NULL);
    foam_picture(g, &d, rgba[1][0], NULL, NULL, NULL, NULL);
    CHECK(memcmp(rgba[0], rgba[1], sizeof rgba[0]) == 0);
    t[0].extinction = 7;
    t[3].rgb[1] = NAN;
    CHECK_EQ_U64(tetcast_foam_paint(f, t, 300), TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(tetcast_foam_paint(f, t, 299), TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(tetcast_foam_paint(f, NULL, 300), TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(tetcast_foam_paint(NULL, t, 300), TETCAST_ERR_INVALID_ARG);
    foam_picture(f, &d, rgba[0][0], NULL, NULL, NULL, NULL);
    CHECK(memcmp(rgba[0], rgba[1], sizeof rgba[0]) == 0);
    tetcast_foam_destroy(f);
    tetcast_foam_destroy(g);
}

TEST(what_is_none) { /* bad sites are left out and counted, bad arguments told, bad rays nothing */
    tetcast_site s[6];
    tetcast_foam *f = NULL;
    tetcast_foam_desc d;
    tetcast_foam_info info;
    tetcast_error error;
    tetcast_ray r[4];
    tetcast_ray_result got[4];
    tetcast_image m;
    uint32_t i, a;
    memset(&d, 0, sizeof d);
    memset(s, 0, sizeof s);
    memset(r, 0, sizeof r);
    memset(&m, 0, sizeof m);
    for (i = 0; i < 6; i++) {
        s[i].position[0] = i;
        s[i].extinction = 1e18f;
        s[i].rgb[1] = 0.5f;
    }
    d.env.error = &error;
    s[1].position[2] = (double)NAN;
    s[2].position[1] = 1e101;
    s[3].rgb[0] = -1;
    s[4].extinction = INFINITY;
    d.box_min[1] = d.box_min[2] = -1;
    d.box_max[1] = d.box_max[2] = 1;
    CHECK_EQ_U64(tetcast_foam_create(&d, s, 6, &f), TETCAST_OK);
    REQUIRE(f != NULL);
    tetcast_foam_get_info(f, &info);
    CHECK(info.bad_sites == 4 && info.first_bad == 1 && info.cell_count == 2 && info.neighbour_count == 2 && info.most_neighbours == 1 && info.box_max[0] == 5);
    r[0].org[0] = -1; /* through an opaque cell */
    r[0].dir[0] = 1;
    r[1].org[0] = (double)NAN;
    r[1].dir[0] = 1;
    r[3].org[1] = 2; /* beside the box */
    r[3].dir[0] = 1;
    CHECK_EQ_U64(tetcast_foam_cast(NULL, f, r, 4, got, NULL), TETCAST_OK);
    CHECK(got[0].rgba[1] == 0.5f && got[0].rgba[3] == 1 && got[0].hit == 1 && got[0].steps == 1 && got[0].length > 2.4f);
    for (i = 1; i < 4; i++) CHECK(got[i].rgba[3] == 0 && got[i].hit == INFINITY && got[i].steps == 0 && got[i].walks == 0 && got[i].length == 0);
    CHECK_EQ_U64(tetcast_foam_cast(NULL, f, NULL, 1, got, NULL), TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(tetcast_foam_cast(NULL, NULL, r, 1, got, NULL), TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(tetcast_foam_cast(NULL, f, NULL, 0, NULL, NULL), TETCAST_OK);
    CHECK_EQ_U64(tetcast_foam_render(NULL, f, &m, NULL), TETCAST_OK);
    CHECK_EQ_U64(tetcast_foam_render(NULL, NULL, &m, NULL), TETCAST_ERR_INVALID_ARG);
    m.width = m.height = 0xffffffffu;
    CHECK_EQ_U64(tetcast_foam_render(NULL, f, &m, NULL), TETCAST_ERR_RANGE);
    CHECK_EQ_U64(tetcast_foam_find(f, r[1].org, 0), TETCAST_NONE);
    CHECK_EQ_U64(tetcast_foam_cell(f, 2, &i, &a, 1), 0);
    CHECK_EQ_U64(i, TETCAST_NONE);
    tetcast_foam_destroy(f);
    CHECK_EQ_U64(tetcast_foam_create(&d, s + 1, 4, &f), TETCAST_ERR_EMPTY);
    CHECK(f == NULL && error.code == TETCAST_ERR_EMPTY && error.where == 0);
    CHECK_EQ_U64(tetcast_foam_create(&d, s, 0, &f), TETCAST_ERR_EMPTY);
    CHECK_EQ_U64(tetcast_foam_create(&d, NULL, 1, &f), TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(tetcast_foam_create(&d, s, (size_t)TETCAST_MAX_VERTICES + 1, &f), TETCAST_ERR_RANGE);
    d.box_min[1] = 2;
    CHECK_EQ_U64(tetcast_foam_create(&d, s, 6, &f), TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(error.where, 1);
    d._end_zero = 1;
    CHECK_EQ_U64(tetcast_foam_create(&d, s, 6, &f), TETCAST_ERR_UNINIT_DESC);
    memset(&d, 0, sizeof d); /* a point far away: there is a camera for it */
    memset(s, 0, sizeof s);
    for (a = 0; a < 3; a++) s[0].position[a] = -1.35e23;
    CHECK_EQ_U64(tetcast_foam_create(&d, s, 1, &f), TETCAST_OK);
    m.width = m.height = 3;
    CHECK_EQ_U64(tetcast_foam_render(NULL, f, &m, NULL), TETCAST_OK);
    tetcast_foam_destroy(f);
    tetcast_foam_destroy(NULL);
    tetcast_foam_get_info(NULL, &info);
    CHECK(info.cell_count == 0);
}

/* Any numbers at all: a foam or a refusal, pictures without NaN. */
TEST(random_bits) {
    static tetcast_site s[64];
    test_rng g = test_rng_make(7);
    uint32_t i, a, k, made = 0;
    for (k = 0; k < (test_quick() ? 200u : 2000u); k++) {
        const uint32_t n = 1 + test_rng_below(&g, 64), mode = test_rng_below(&g, 3);
        tetcast_foam *f = NULL;
        tetcast_foam_desc d;
        tetcast_ray r[8];
        tetcast_ray_result got[8];
        memset(&d, 0, sizeof d);
        memset(r, 0, sizeof r);
        for (i = 0; i < n; i++) {
            for (a = 0; a < 3; a++) {
                s[i].position[a] = mode == 0   ? (double)test_rng_bits(&g) * (test_rng_below(&g, 4) == 0 ? 1e60 : 1.0)
                                   : mode == 1 ? (double)test_rng_below(&g, 4)
                                               : test_rng_double(&g) * 1e-90;
                s[i].rgb[a] = fabsf(test_rng_bits(&g));
            }
            s[i].extinction = fabsf(test_rng_bits(&g));
            if (test_rng_below(&g, 2) == 0) s[i].extinction = s[i].rgb[0] = s[i].rgb[1] = s[i].rgb[2] = 1;
        }
        for (i = 0; i < 8; i++)
            for (a = 0; a < 3; a++) {
                r[i].org[a] = i % 2 ? s[0].position[a] : (double)test_rng_bits(&g);
                r[i].dir[a] = i % 3 ? s[n / 2].position[a] - r[i].org[a] : (double)test_rng_bits(&g);
            }
        if (tetcast_foam_create(&d, s, n, &f) != TETCAST_OK) continue;
        made++;
        CHECK_EQ_U64(tetcast_foam_cast(NULL, f, r, 8, got, NULL), TETCAST_OK);
        for (i = 0; i < 8; i++) {
            CHECK(got[i].rgba[0] >= 0 && got[i].rgba[3] >= 0 && got[i].rgba[3] <= 1);
            CHECK(got[i].length >= 0 && got[i].steps <= n && got[i].hit == got[i].hit);
        }
        tetcast_foam_destroy(f);
    }
    CHECK(made > k / 3);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(neighbours_are_those_of_brute_force);
    RUN(rays_are_those_of_brute_force);
    RUN(rays_that_graze_a_face);
    RUN(rays_in_faces_of_a_lattice);
    RUN(rays_in_edges_of_rings);
    RUN(ends_of_ranges);
    RUN(places_are_in_the_nearest_cell);
    RUN(places_far_from_close_sites);
    RUN(places_beside_a_face);
    RUN(pictures_are_rays);
    RUN(paint);
    RUN(what_is_none);
    RUN(random_bits);
    return test_end();
}
