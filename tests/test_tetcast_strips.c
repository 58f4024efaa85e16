/* Tet20, Tet32, the list of 160 bytes, strips: what they say about a mesh. And what rays by planes do wrong, counted, so
   that a comparison with them compares what it says: where they are right they agree with the walker. */
#include "test.h"
#define TETCAST_IMPLEMENTATION
#include "tetcast.h"
#include "tets.h"
#include "../bench/baseline/strip_planes.h"

enum { FORMS = 5 };
static const tetcast_cells g_forms[FORMS] = {TETCAST_CELLS_TET20, TETCAST_CELLS_TET32, TETCAST_CELLS_LIST160,
                                             TETCAST_CELLS_STRIPS, TETCAST_CELLS_STRIPS_GENERAL};

static int is_strip(tetcast_cells kind) { return kind == TETCAST_CELLS_STRIPS || kind == TETCAST_CELLS_STRIPS_GENERAL; }

static tetcast_mesh *build(const tets *m, tetcast_cells kind, uint32_t threads) {
    tetcast_mesh_desc d;
    memset(&d, 0, sizeof d);
    d.cells = kind;
    d.keep_neighbours = 1;
    d.env.thread_count = threads;
    return tets_build_desc(m, &d, NULL);
}

/* Through each pair of faces of each cell: what a walk would do, against the plain lists. Returns what is wrong. */
static uint64_t check_walks(const tetcast_mesh *mesh) {
    const tetcasti_cells *cells = &mesh->cells;
    const uint32_t *number = is_strip((tetcast_cells)cells->kind) ? (const uint32_t *)cells->side : NULL;
    uint32_t *place = (uint32_t *)malloc(((size_t)mesh->cell_count + 1) * 4);
    uint32_t i, in, out;
    uint64_t wrong = 0;
    for (i = 0; i < mesh->cell_count; i++) place[i] = number ? TETCASTI_NONE : i;
    for (i = 0; number && i < cells->count; i++) {
        if (number[i] == TETCASTI_NONE) continue;
        wrong += place[number[i]] != TETCASTI_NONE; /* twice */
        place[number[i]] = i;
    }
    for (i = 0; i < mesh->cell_count; i++) {
        const uint32_t *t = mesh->tet[i], *n = mesh->neighbour[i];
        if (place[i] == TETCASTI_NONE) {
            wrong++;
            continue;
        }
        for (in = 0; in < 4; in++)
            for (out = 0; out < 4; out++) {
                uint32_t a = t[(in + 1) % 4], b = t[(in + 2) % 4], c = t[(in + 3) % 4], d, next, want;
                uint32_t prev = n[in] == TETCASTI_NONE ? n[in] : place[n[in]];
                tetcasti_node node;
                if (in == out) continue;
                d = tetcasti_enter(cells, cells->kind, place[i], prev, a, b, c, &node);
                if (d != t[in]) {
                    wrong++;
                    continue;
                }
                want = n[out] == TETCASTI_NONE ? n[out] : place[n[out]];
                next = tetcasti_leave(cells, cells->kind, &node, place[i], prev, a, b, c, d, t[out]);
                wrong += next != want;
            }
    }
    for (i = 0; cells->first && i < mesh->face_count; i++) wrong += cells->first[i] != place[mesh->face[i].cell];
    free(place);
    return wrong;
}

static int keep_some(uint32_t x, uint32_t y, uint32_t z) { return (x * 7 + y * 13 + z * 29 + x * y) % 5 != 0; }

TEST(walks) {
    int mesh_kind, f;
    for (mesh_kind = 0; mesh_kind < 6; mesh_kind++) {
        tets m;
        memset(&m, 0, sizeof m);
        switch (mesh_kind) {
        case 0:
            tets_vertex(&m, 0, 0, 0, 0); tets_vertex(&m, 1, 0, 0, 1); tets_vertex(&m, 0, 1, 0, 2); tets_vertex(&m, 0, 0, 1, 3);
            tets_tet(&m, 0, 1, 2, 3);
            break;
        case 1:
            tets_vertex(&m, 0, 0, 0, 0); tets_vertex(&m, 1, 0, 0, 1); tets_vertex(&m, 0, 1, 0, 2); tets_vertex(&m, 0, 0, 1, 3);
            tets_vertex(&m, 1, 1, 1, 4);
            tets_tet(&m, 0, 1, 2, 3);
            tets_tet(&m, 1, 2, 3, 4);
            break;
        case 2: tets_lattice(&m, 9, 7, 8, 5, NULL); break;
        case 3: tets_lattice(&m, 9, 7, 8, 6, NULL); break;
        case 4: tets_lattice(&m, 10, 9, 8, 5, keep_some); break; /* holes, loose cubes */
        default:
            tets_lattice(&m, 12, 11, 10, 6, keep_some);
            tets_shuffle(&m, 5);
            break;
        }
        for (f = 0; f < FORMS; f++) {
            tetcast_mesh *mesh = build(&m, g_forms[f], 0);
            REQUIRE(mesh != NULL);
            CHECK_MSG(check_walks(mesh) == 0, "mesh %d, form %d: %d wrong steps", mesh_kind, (int)g_forms[f],
                      (int)check_walks(mesh));
            tetcast_mesh_destroy(mesh);
        }
        tets_free(&m);
    }
}

/* What the thesis measured on lattices and what its greedy reaches: columns per cell over the 8 numbers of a list. */
TEST(statistics) {
    tets m;
    int general;
    memset(&m, 0, sizeof m);
    tets_lattice(&m, test_quick() ? 16 : 32, test_quick() ? 16 : 32, test_quick() ? 16 : 32, 5, NULL);
    for (general = 0; general < 2; general++) {
        tetcast_mesh *mesh = build(&m, general ? TETCAST_CELLS_STRIPS_GENERAL : TETCAST_CELLS_STRIPS, 0);
        const uint32_t *number;
        uint32_t i, strips = 0, repeated = 0;
        double ratio;
        REQUIRE(mesh != NULL);
        number = (const uint32_t *)mesh->cells.side;
        for (i = 0; i < mesh->cells.count; i++) /* three columns in a row without a cell: the end of a strip */
            strips += number[i] == TETCASTI_NONE && i + 1 < mesh->cells.count && number[i + 1] != TETCASTI_NONE;
        repeated = mesh->cells.count - mesh->cell_count;
        ratio = 3.0 * mesh->cells.count / (8.0 * mesh->cell_count);
        CHECK(repeated > 0 && strips > 0);
        CHECK_MSG(ratio > 0.375 && ratio < (general ? 0.6366 : 0.6342), "%s strips: %.1f %% of a list",
                  general ? "generalised" : "sequential", 100.0 * ratio);
        CHECK_EQ_U64(mesh->cells.data_bytes, (uint64_t)mesh->cells.count * 12);
        tetcast_mesh_destroy(mesh);
    }
    tets_free(&m);
}

TEST(repeated_vertices) { /* the thesis' example 3 4 5 6 3 7: cells 3 4 5 6 and 5 6 3 7, between them a window that is none; where
                             the second one's link across 5 6 3 would be is the slot n2 under its 5 */
    tets m;
    tetcast_mesh *mesh;
    const tetcasti_column *c;
    const uint32_t *number;
    uint32_t i, seen = 0;
    memset(&m, 0, sizeof m);
    tets_lattice(&m, 12, 12, 12, 5, NULL);
    mesh = build(&m, TETCAST_CELLS_STRIPS_GENERAL, 1);
    REQUIRE(mesh != NULL);
    c = (const tetcasti_column *)mesh->cells.data;
    number = (const uint32_t *)mesh->cells.side;
    for (i = 0; i + 5 < mesh->cells.count; i++) {
        const uint32_t from = number[i], to = number[i + 2];
        uint32_t k;
        if (from == TETCASTI_NONE || number[i + 1] != TETCASTI_NONE || to == TETCASTI_NONE || c[i].v != c[i + 4].v) continue;
        for (k = 0; k < 4 && mesh->neighbour[to][k] != from; k++) { }
        CHECK_MSG(k < 4, "columns %u: cells %u and %u are no neighbours", i, from, to);
        CHECK_MSG((c[i + 2].n2 & ~TETCASTI_STRIP_FLAG) == i, "column %u: n2 is %x", i + 2, c[i + 2].n2);
        CHECK_MSG((c[i + 3].n2 & TETCASTI_STRIP_FLAG) == 0, "column %u: the cell before is none", i + 3);
        seen++;
    }
    CHECK_MSG(seen > 100, "%u", seen);
    tetcast_mesh_destroy(mesh);
    tets_free(&m);
}

TEST(same_for_all_threads) {
    tets m;
    int f;
    memset(&m, 0, sizeof m);
    tets_lattice(&m, 26, 26, 26, 6, NULL); /* more than one chunk of strips */
    for (f = 0; f < FORMS; f++) {
        tetcast_mesh *a = build(&m, g_forms[f], 1), *b = build(&m, g_forms[f], 3);
        REQUIRE(a != NULL && b != NULL);
        CHECK(a->cells.data_bytes == b->cells.data_bytes && memcmp(a->cells.data, b->cells.data, a->cells.data_bytes) == 0);
        tetcast_mesh_destroy(a);
        tetcast_mesh_destroy(b);
    }
    tets_free(&m);
}

TEST(list_of_planes) { /* normals point outwards, the gradient reproduces the scalar, back numbers lead back */
    tets m;
    tetcast_mesh *mesh;
    const tetcasti_tet160 *t;
    uint32_t i, k, a;
    memset(&m, 0, sizeof m);
    tets_lattice(&m, 6, 5, 7, 6, NULL);
    tets_jitter(&m, 6, 5, 7, 0.2, 3);
    mesh = build(&m, TETCAST_CELLS_LIST160, 0);
    REQUIRE(mesh != NULL);
    t = (const tetcasti_tet160 *)mesh->cells.data;
    for (i = 0; i < mesh->cell_count; i++)
        for (k = 0; k < 4; k++) {
            double s = (double)t[i].gradient[3], above = 0, l = 0;
            uint32_t n = t[i].n[k];
            for (a = 0; a < 3; a++) {
                s += (double)t[i].gradient[a] * (double)t[i].v[k][a];
                above += (double)t[i].normal[k][a] * ((double)t[i].v[k][a] - (double)t[i].v[(k + 1) % 4][a]);
                l += (double)t[i].normal[k][a] * (double)t[i].normal[k][a];
            }
            CHECK_NEAR(s, mesh->vertex[mesh->tet[i][k]].s, 2e-4);
            CHECK(above < 0); /* vertex k lies below face k */
            CHECK_NEAR(l, 1, 1e-5);
            if (n != TETCASTI_NONE) CHECK_EQ_U64(t[n].n[(uint32_t)t[i].normal[k][3]], i);
            else CHECK(t[i].normal[k][3] == 4.0f);
        }
    tetcast_mesh_destroy(mesh);
    tets_free(&m);
}

/* ---- the baseline: rays by planes, layers of the hull by peeling ---- */

enum { STRIPS_SIDE = 40 };

typedef struct plane_count { uint32_t wrong, rays; baseline_stats stats; } plane_count;

/* The lengths of a picture against those of the walker. `scale`: of the mesh along z; `place`: where it is. */
static void count_wrong(const tets *t, const tetcast_camera *camera, const baseline_desc *desc, double tolerance, plane_count *n) {
    static float length[STRIPS_SIDE * STRIPS_SIDE], want[STRIPS_SIDE * STRIPS_SIDE];
    baseline_list l;
    tetcast_render_desc d;
    tetcast_image im;
    tetcast_mesh *m = tets_build(t, TETCAST_CELLS_TET16, NULL);
    uint32_t i;
    memset(n, 0, sizeof *n);
    memset(&d, 0, sizeof d);
    memset(&im, 0, sizeof im);
    REQUIRE(m != NULL && baseline_list_make(m, &l));
    CHECK(baseline_picture(&l, desc, camera, STRIPS_SIDE, STRIPS_SIDE, NULL, NULL, length, &n->stats));
    d.camera = *camera;
    d.traverse_only = 1;
    im.width = im.height = STRIPS_SIDE;
    im.length = want;
    CHECK_EQ_U64(tetcast_render(&d, m, NULL, &im, NULL), TETCAST_OK);
    for (i = 0; i < STRIPS_SIDE * STRIPS_SIDE; i++) {
        n->rays += want[i] > 0;
        n->wrong += !(fabs((double)length[i] - (double)want[i]) <= tolerance);
    }
    baseline_list_free(&l);
    tetcast_mesh_destroy(m);
}

/* Rays through a lattice of cubes, thin ones where it is far from the origin: any, or along diagonals through vertices. */
static void count_lattice(double jitter, double offset, baseline_form form, int diagonal, plane_count *n) {
    tets t;
    baseline_list l;
    baseline_desc desc;
    tetcast_mesh *m;
    test_rng rng = test_rng_make(3);
    uint32_t i, a, side = 9;
    const double scale[3] = {0.1, 0.1, offset != 0 ? 0.001 : 0.1}, place[3] = {offset, offset, offset};
    memset(&t, 0, sizeof t);
    memset(n, 0, sizeof *n);
    memset(&desc, 0, sizeof desc);
    desc.form = form;
    desc.epsilon = 1e-6f;
    tets_lattice(&t, side, side, side, 6, NULL);
    tets_jitter(&t, side, side, side, jitter, 1);
    tets_place(&t, scale, place);
    m = tets_build(&t, TETCAST_CELLS_TET16, NULL);
    REQUIRE(m != NULL && baseline_list_make(m, &l));
    for (i = 0; i < 200; i++) {
        tetcast_ray r;
        tetcast_ray_result got;
        double length, lo[3], hi[3], want;
        memset(&r, 0, sizeof r);
        do {
            for (a = 0; a < 3; a++) r.dir[a] = diagonal ? (double)test_rng_below(&rng, 3) - 1 : test_rng_double(&rng) - 0.5;
        } while (r.dir[0] == 0 && r.dir[1] == 0 && r.dir[2] == 0);
        ref_unit(r.dir);
        for (a = 0; a < 3; a++) {
            r.dir[a] *= scale[a];
            r.org[a] = (1 + (diagonal ? test_rng_below(&rng, side - 2) : (side - 3) * test_rng_double(&rng))) * scale[a] + offset - 30 * r.dir[a];
            lo[a] = offset;
            hi[a] = offset + (side - 1) * scale[a];
        }
        ref_unit(r.dir);
        want = ref_box(r.org, r.dir, lo, hi, 0, 1e300);
        baseline_ray(&l, &desc, r.org, r.dir, 1e-5f, &length, &n->stats);
        n->rays++;
        n->wrong += fabs(length - want) > 0.03 * want;
        CHECK_EQ_U64(tetcast_cast(NULL, m, NULL, &r, 1, &got, NULL), TETCAST_OK);
        CHECK_NEAR(got.length, want, 1e-3);
    }
    baseline_list_free(&l);
    tetcast_mesh_destroy(m);
    tets_free(&t);
}

TEST(planes) { /* right where cells are good and near the origin; in tangled meshes, and far away in planes of the lattice, not */
    uint32_t f, far_offset = 0, far_vertex = 0;
    for (f = 0; f < 4; f++) {
        static const char *const name[4] = {"by number", "by sign", "by offset", "epsilon"};
        plane_count any, corners, tangled, distant[2];
        count_lattice(0.2, 0, (baseline_form)f, 0, &any);
        count_lattice(0, 0, (baseline_form)f, 1, &corners);
        count_lattice(1.2, 0, (baseline_form)f, 0, &tangled);
        count_lattice(0.2, 1000, (baseline_form)f, 0, &distant[0]);
        count_lattice(0, 1000, (baseline_form)f, 1, &distant[1]);
        printf("  planes %s, wrong of %u: any %u, through vertices %u, tangled %u; at 1000: any %u, through vertices %u\n", name[f],
               any.rays, any.wrong, corners.wrong, tangled.wrong, distant[0].wrong, distant[1].wrong);
        CHECK_EQ_U64(any.wrong, 0);
        CHECK_EQ_U64(any.stats.endless + any.stats.no_exit, 0);
        if (f == BASELINE_EPSILON) CHECK(corners.wrong > corners.rays / 2); /* steps along edges are too short for it */
        CHECK(tangled.wrong > tangled.rays / 4);
        CHECK(distant[1].wrong > 0);
        if (f == BASELINE_OFFSET) far_offset = distant[0].wrong + distant[1].wrong;
        if (f == BASELINE_VERTEX) far_vertex = distant[0].wrong + distant[1].wrong;
    }
    CHECK(far_offset >= far_vertex);
}

TEST(planes_of_strips) { /* faces kept once and turned are the cells' own; rays by them, by none, with and without gradients */
    static const tetcast_cells kinds[2] = {TETCAST_CELLS_STRIPS, TETCAST_CELLS_STRIPS_GENERAL};
    uint32_t kind, keep, i, k;
    for (kind = 0; kind < 2; kind++) {
        tets t;
        tetcast_mesh *m;
        tetcast_optics *o;
        tetcast_transfer *transfer;
        tetcast_transfer_desc td;
        static const tetcast_control_point points[3] = {{0, {0, 0, 1}, 0.1f}, {9, {0, 1, 0}, 0.4f}, {20, {1, 0, 0}, 0.2f}};
        memset(&t, 0, sizeof t);
        memset(&td, 0, sizeof td);
        tets_lattice(&t, 7, 7, 7, 5, NULL);
        tets_jitter(&t, 6, 6, 6, 0.3, 8);
        tets_round(&t);
        for (i = 0; i < t.nv; i++) t.s[i] = (float)(t.p[3 * i] + t.p[3 * i + 1] + sin(t.p[3 * i + 2]) + 2);
        m = build(&t, kinds[kind], 1);
        REQUIRE(m != NULL);
        td.points = points;
        td.point_count = 3;
        CHECK_EQ_U64(tetcast_transfer_create(&td, &transfer), TETCAST_OK);
        CHECK_EQ_U64(tetcast_optics_create(transfer, NULL, &o), TETCAST_OK);
        for (keep = 0; keep < 4; keep++) {
            strips_planes s;
            baseline_stats stats;
            test_rng rng = test_rng_make(12);
            memset(&stats, 0, sizeof stats);
            REQUIRE(strips_planes_make(m, keep, &s));
            CHECK(strips_planes_bytes(&s) > 12.0 * m->cell_count);
            if (keep == (STRIPS_PLANES_NORMALS | STRIPS_PLANES_GRADIENTS)) { /* against the list, cell by cell */
                const uint32_t *cell_of = (const uint32_t *)m->cells.side;
                baseline_list l;
                uint32_t used = 0, turned = 0;
                REQUIRE(baseline_list_make(m, &l));
                for (i = 0; i < s.columns; i++) {
                    const baseline_cell *c = &l.cell[cell_of[i] != TETCASTI_NONE ? cell_of[i] : 0];
                    if (cell_of[i] == TETCASTI_NONE) continue;
                    for (k = 0; k < 4; k++) {
                        const float *p = s.plane[s.number[i][k] & ~STRIPS_PLANES_TURNED];
                        const float sign = s.number[i][k] & STRIPS_PLANES_TURNED ? -1.0f : 1.0f;
                        uint32_t f = 0;
                        while (m->tet[cell_of[i]][f] != s.column[i + k].v) f++;
                        CHECK_NEAR(sign * p[0], c->nx[f], 1e-7); /* a sum of products in another order */
                        CHECK_NEAR(sign * p[1], c->ny[f], 1e-7);
                        CHECK_NEAR(sign * p[2], c->nz[f], 1e-7);
                        CHECK_NEAR(sign * p[3], c->o[f], 1e-6);
                        turned += sign < 0;
                        used++;
                    }
                }
                CHECK_EQ_U64(used, 4 * m->cell_count);
                CHECK_EQ_U64(s.planes, (4 * m->cell_count + m->face_count) / 2); /* each face once */
                CHECK_EQ_U64(turned, s.planes - m->face_count);
                baseline_list_free(&l);
            }
            for (i = 0; i < 400; i++) {
                tetcast_ray r;
                tetcast_ray_result want;
                tetcasti_ray_sum sum;
                double length = 0, to[3];
                float e[3], d[3], at, rgba[4];
                uint32_t column;
                memset(&r, 0, sizeof r);
                for (k = 0; k < 3; k++) {
                    r.org[k] = (double)(float)(3 + 20 * (test_rng_double(&rng) - 0.5) + (k == 2 ? 20 : 0));
                    to[k] = 1 + 4 * test_rng_double(&rng);
                    r.dir[k] = to[k] - r.org[k];
                }
                ref_unit(r.dir);
                for (k = 0; k < 3; k++) {
                    e[k] = (float)r.org[k];
                    d[k] = (float)r.dir[k];
                }
                column = strips_planes_enter(&s, m, &r, &at);
                CHECK_EQ_U64(tetcast_cast(NULL, m, o, &r, 1, &want, NULL), TETCAST_OK);
                if (column == TETCASTI_NONE) {
                    CHECK(want.length == 0);
                    continue;
                }
                tetcasti_ray_begin(o, &sum);
                strips_planes_walk(&s, e, d, column, at, o, &sum, &length, &stats);
                tetcasti_ray_finish(o, &sum, rgba);
                CHECK_NEAR(length, want.length, 1e-4);
                for (k = 0; k < 4; k++) CHECK_NEAR(rgba[k], want.rgba[k], 1e-4);
            }
            CHECK_EQ_U64(stats.no_exit + stats.endless, 0);
            CHECK(stats.walks > 200);
            strips_planes_free(&s);
        }
        tetcast_optics_destroy(o);
        tetcast_transfer_destroy(transfer);
        tetcast_mesh_destroy(m);
        tets_free(&t);
    }
}

TEST(rows_of_strips) { /* strips in rows: each column once, none across an end, little is lost */
    static const tetcast_cells kinds[2] = {TETCAST_CELLS_STRIPS, TETCAST_CELLS_STRIPS_GENERAL};
    uint32_t kind, i, k;
    for (kind = 0; kind < 2; kind++) {
        tets t;
        tetcast_mesh *m;
        strips_rows r;
        uint8_t *used;
        size_t count = 0;
        memset(&t, 0, sizeof t);
        tets_lattice(&t, 26, 26, 26, 5, NULL);
        m = build(&t, kinds[kind], 1);
        REQUIRE(m != NULL);
        CHECK(!strips_rows_make(m, 8, &r)); /* longer than a row */
        REQUIRE(strips_rows_make(m, 2048, &r));
        used = (uint8_t *)calloc((size_t)r.rows * r.width, 1);
        REQUIRE(used != NULL);
        for (i = 0; i < r.strips; i++) {
            CHECK(r.row[i] < r.rows && r.offset[i] + r.length[i] <= r.width);
            CHECK_EQ_U64(r.first[i], i == 0 ? 0 : r.first[i - 1] + r.length[i - 1]);
            for (k = 0; k < r.length[i]; k++) count += used[(size_t)r.row[i] * r.width + r.offset[i] + k]++ == 0;
        }
        CHECK_EQ_U64(count, m->cells.count);
        CHECK((double)count > 0.95 * r.rows * r.width);
        CHECK(kind == 0 ? r.repeated == 0 : r.repeated > 0);
        free(used);
        strips_rows_free(&r);
        tetcast_mesh_destroy(m);
        tets_free(&t);
    }
}

static int keep_layers(uint32_t x, uint32_t y, uint32_t z) { (void)x; (void)y; return (z & 1u) == 0; }
static int strips_keep_corner(uint32_t x, uint32_t y, uint32_t z) { return (x < 2) == (y < 2) && (y < 2) == (z < 2); }

static int keep_two(uint32_t x, uint32_t y, uint32_t z) { (void)x; (void)y; return z != 1; }

TEST(peeling) { /* the same as hit lists but where two layers have one depth */
    uint32_t pass, i;
    for (pass = 0; pass < 4; pass++) {
        tets t;
        tetcast_camera c;
        baseline_desc desc;
        plane_count n;
        memset(&t, 0, sizeof t);
        memset(&c, 0, sizeof c);
        memset(&desc, 0, sizeof desc);
        if (pass < 2) tets_lattice(&t, 5, 5, 5, 5, pass == 1 ? strips_keep_corner : keep_layers);
        else tets_lattice(&t, 5, 5, 4, 5, keep_two);
        for (i = 0; i < t.nv && pass >= 2; i++) { /* a sheet of 1e-6 or 0.1 and at once behind it a plate */
            double z = t.p[3 * i + 2];
            t.p[3 * i + 2] = z < 2.5 ? z * (pass == 2 ? 0.1 : 1e-6) : 3;
        }
        c.at[0] = c.at[1] = c.at[2] = 2;
        c.eye[0] = 2.3;
        c.eye[1] = 3.1;
        c.eye[2] = -21;
        c.fov_y = 9;
        c.up[1] = 1;
        desc.depth_bits = pass >= 2 ? 24 : 0;
        desc.depth_range = 100;
        count_wrong(&t, &c, &desc, 1e-3, &n);
        printf("  peeling: %u of %u wrong, %u layers\n", n.wrong, n.rays, (uint32_t)n.stats.layers);
        CHECK(n.rays > 100 && n.stats.layers > 1);
        if (pass < 3) CHECK(n.wrong <= n.rays / 100); /* pixels of the outline */
        else CHECK(n.wrong > n.rays / 2); /* 24 bits of depth do not tell the plate from the sheet: it is lost */
        tets_free(&t);
    }
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(walks);
    RUN(statistics);
    RUN(repeated_vertices);
    RUN(same_for_all_threads);
    RUN(list_of_planes);
    RUN(planes);
    RUN(planes_of_strips);
    RUN(rows_of_strips);
    RUN(peeling);
    return test_end();
}
