/* Compact forms: every way through every cell, from every neighbour and from outside, against the lists they were made
   from; escapes of Tet8; bytes; gradients; equal walks in all forms. */
#include "test.h"
#define TETCAST_IMPLEMENTATION
#include "tetcast.h"
#include "tets.h"

/* All 12 ways (in through face i, out through face j) of all cells. */
static void check_ways(const tetcast_mesh *m) {
    uint32_t i, j, k, wrong = 0;
    if (m == NULL || m->tet == NULL || m->neighbour == NULL) return;
    for (i = 0; i < m->cell_count; i++) {
        const uint32_t *t = m->tet[i], *n = m->neighbour[i];
        for (j = 0; j < 4; j++) {
            uint32_t f[3], d;
            tetcasti_node node;
            for (k = 0; k < 3; k++) f[k] = t[(j + k + 1) & 3];
            d = tetcasti_enter(&m->cells, m->cells.kind, i, n[j], f[0], f[1], f[2], &node);
            wrong |= d != t[j];
            for (k = 0; k < 4; k++) {
                uint32_t next;
                if (k == j) continue;
                next = tetcasti_leave(&m->cells, m->cells.kind, &node, i, n[j], f[0], f[1], f[2], d, t[k]);
                wrong |= (uint32_t)(next != n[k]) << 1;
            }
        }
    }
    CHECK_MSG(wrong == 0, "kind %u: fault %u", m->cells.kind, wrong);
}

static tetcast_mesh_desc keep_all(uint32_t cells) {
    tetcast_mesh_desc d;
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    d.keep_neighbours = 1;
    d.cells = (tetcast_cells)cells;
    return d;
}

TEST(all_ways) {
    uint32_t kind, pass;
    for (pass = 0; pass < 10; pass++) {
        tets t;
        memset(&t, 0, sizeof t);
        switch (pass) {
        case 0: /* one cell */
            tets_lattice(&t, 2, 2, 2, 5, NULL);
            t.nt = 1;
            break;
        case 1: /* two */
            tets_lattice(&t, 2, 2, 2, 6, NULL);
            t.nt = 2;
            break;
        case 2: tets_lattice(&t, 2, 2, 2, 5, NULL); break;
        case 3: tets_lattice(&t, 9, 9, 9, 5, NULL); break;
        case 4: tets_lattice(&t, 12, 3, 7, 6, NULL); break;
        default:
            tets_lattice(&t, 6 + pass, 8, 7, pass & 1 ? 5 : 6, NULL);
            tets_jitter(&t, 6 + pass, 8, 7, 1.3, pass);
            tets_shuffle(&t, pass);
            break;
        }
        for (kind = 0; kind < 2; kind++) {
            tetcast_mesh_desc d = keep_all(kind);
            tetcast_mesh *m;
            d.order = (tetcast_order)(pass % 3);
            m = tets_build_desc(&t, &d, NULL);
            check_ways(m);
            tetcast_mesh_destroy(m);
        }
        tets_free(&t);
    }
}

/* Cells alone are the same, and are made in 41 bytes each: vertices, neighbours, the number in the input, and a little. */
static void check_lean(const tets *t, const tetcast_mesh_desc *like, const tetcast_mesh *m) {
    tetcast_mesh_desc d = *like;
    tetcast_mesh *lean;
    test_alloc ta;
    test_alloc_init(&ta);
    d.env.allocator.alloc_fn = test_alloc_fn;
    d.env.allocator.free_fn = test_free_fn;
    d.env.allocator.user = &ta;
    d.drop_tets = d.drop_source = d.disable_clusters = 1;
    d.keep_neighbours = 0;
    lean = tets_build_desc(t, &d, NULL);
    REQUIRE(lean != NULL);
    CHECK(lean->tet == NULL && lean->neighbour == NULL && lean->source_cell == NULL && lean->source_vertex == NULL);
    CHECK(lean->cells.data_bytes == m->cells.data_bytes && lean->cells.side_bytes == m->cells.side_bytes);
    CHECK(memcmp(lean->cells.data, m->cells.data, m->cells.data_bytes) == 0);
    CHECK(memcmp(lean->cells.side, m->cells.side, m->cells.side_bytes) == 0);
    if (d.order != TETCAST_ORDER_INPUT) /* there most of them are in the side table */
        CHECK_MSG((size_t)ta.peak_bytes < 41 * (size_t)m->cell_count, "%.1f bytes a cell",
                  (double)ta.peak_bytes / (double)m->cell_count);
    tetcast_mesh_destroy(lean);
    test_alloc_check(&ta);
}

TEST(escapes) { /* a mesh in no order at all: most of Tet8 is in the side table; and a large one */
    tets t;
    uint32_t pass;
    for (pass = 0; pass < 3; pass++) {
        tetcast_mesh_desc d = keep_all(TETCAST_CELLS_TET8);
        tetcast_mesh_info info;
        tetcast_mesh *m;
        uint32_t n = pass == 2 ? (test_quick() ? 30 : 48) : 24;
        memset(&t, 0, sizeof t);
        tets_lattice(&t, n, n, n, 6, NULL);
        if (pass != 2) tets_shuffle(&t, 7);
        d.order = pass == 0 ? TETCAST_ORDER_INPUT : TETCAST_ORDER_HILBERT;
        m = tets_build_desc(&t, &d, NULL);
        REQUIRE(m != NULL);
        tetcast_mesh_get_info(m, &info);
        CHECK_EQ_U64(info.connectivity_bytes, info.cell_count * 8 + info.escapes * 16);
        CHECK_EQ_U64(info.vertex_bytes, info.vertex_count * 16);
        if (pass == 0) CHECK(info.escapes > info.cell_count / 5);
        else CHECK_MSG((double)info.connectivity_bytes < 10.0 * (double)info.cell_count, "%.2f bytes a cell",
                       (double)info.connectivity_bytes / (double)info.cell_count);
        check_ways(m);
        check_lean(&t, &d, m);
        tetcast_mesh_destroy(m);
        tets_free(&t);
    }
}

TEST(record_of_tet8) { /* what fits and what does not */
    static const uint32_t t[4] = {10, 20, 30, 40}, u[4] = {10, 20, 40, 30}, far_t[4] = {1, 2, 3, 70000};
    uint32_t n[4] = {100, 200, 300, 400};
    tetcasti_tet8 r;
    CHECK(tetcasti_pack8(t, n, 150, &r) == 1);
    CHECK(r.x == (10 ^ 20 ^ 30 ^ 40) && r.n[0] == (uint16_t)((100 - 150) ^ (400 - 150)));
    CHECK(tetcasti_pack8(u, n, 150, &r) == 1);
    CHECK(r.n[0] == (uint16_t)((100 - 150) ^ (300 - 150)) && r.n[2] == (uint16_t)((400 - 150) ^ (300 - 150)));
    CHECK(tetcasti_pack8(far_t, n, 150, &r) == 0);  /* vertices */
    n[1] = 150 + 32767;
    CHECK(tetcasti_pack8(t, n, 150, &r) == 1);
    n[1] = 150 + 32768;
    CHECK(tetcasti_pack8(t, n, 150, &r) == 0);
    n[1] = 40000 - 32767;
    CHECK(tetcasti_pack8(t, n, 40000, &r) == 0);    /* the others are farther */
    n[0] = n[1] = n[2] = n[3] = TETCASTI_NONE;
    CHECK(tetcasti_pack8(t, n, 150, &r) == 0);      /* a cell by itself: the first field would be the mark */
    n[3] = 40000;
    n[2] = 40000 - 32767;
    CHECK(tetcasti_pack8(t, n, 40000, &r) == 1);
    n[2] = 40000 - 32768;                           /* the mark of "none" */
    CHECK(tetcasti_pack8(t, n, 40000, &r) == 0);
}

/* ---- the same cells along a ray in all forms ---- */

typedef struct trail { uint64_t hash; uint32_t count; } trail;
static int trail_add(void *user, const tetcast_crossing *x) {
    trail *t = (trail *)user;
    t->hash = test_fnv1a(&x->cell, 4, t->hash);
    t->hash = test_fnv1a(&x->t_back, 8, t->hash);
    t->hash = test_fnv1a(&x->back, 4, t->hash);
    t->count++;
    return 0;
}

TEST(same_trails) {
    tets t;
    tetcast_mesh *m[TETCAST_CELLS_COUNT];
    uint32_t kind, i, a, rays = test_quick() ? 300 : 3000, differ = 0;
    test_rng rng = test_rng_make(5);
    memset(&t, 0, sizeof t);
    tets_lattice(&t, 14, 14, 14, 5, NULL);
    tets_jitter(&t, 14, 14, 14, 0.8, 3);
    tets_shuffle(&t, 4);
    for (kind = 0; kind < TETCAST_CELLS_COUNT; kind++) m[kind] = tets_build(&t, (tetcast_cells)kind, NULL);
    for (i = 0; i < rays; i++) {
        tetcast_ray r;
        trail first, now;
        memset(&r, 0, sizeof r);
        for (a = 0; a < 3; a++) {
            r.org[a] = i % 3 == 0 ? test_rng_below(&rng, 14) : 13 * test_rng_double(&rng);
            r.dir[a] = i % 3 == 1 ? (double)test_rng_below(&rng, 3) - 1 : test_rng_double(&rng) - 0.5;
        }
        if (i % 2) for (a = 0; a < 3; a++) r.org[a] -= 40 * r.dir[a];
        memset(&first, 0, sizeof first);
        for (kind = 0; kind < TETCAST_CELLS_COUNT; kind++) {
            memset(&now, 0, sizeof now);
            if (m[kind] != NULL) tetcast_probe(m[kind], &r, trail_add, &now);
            if (kind == 0) first = now;
            differ += now.hash != first.hash || now.count != first.count;
        }
    }
    CHECK_EQ_U64(differ, 0);
    for (kind = 0; kind < TETCAST_CELLS_COUNT; kind++) tetcast_mesh_destroy(m[kind]);
    tets_free(&t);
}

/* ---- gradients ---- */

TEST(gradients) { /* of a linear field: exact at every vertex */
    tets t;
    tetcast_mesh *m;
    uint32_t i;
    const double scale[3] = {0.01, 3, 1}, offset[3] = {5, -7, 100};
    memset(&t, 0, sizeof t);
    tets_lattice(&t, 8, 7, 6, 5, NULL);
    tets_jitter(&t, 8, 7, 6, 0.5, 3);
    tets_place(&t, scale, offset);
    for (i = 0; i < t.nv; i++) t.s[i] = (float)(3.0 * t.p[3 * i] - 2.0 * t.p[3 * i + 1] + 0.5 * t.p[3 * i + 2]);
    m = tets_build(&t, TETCAST_CELLS_TET16, NULL);
    REQUIRE(m != NULL);
    CHECK_EQ_U64(tetcast_mesh_make_gradients(m, NULL), TETCAST_OK);
    for (i = 0; i < m->vertex_count; i++) {
        CHECK_NEAR(m->gradient[i][0], 3.0, 2e-2); /* 0.01 units wide cells, values near 50: seven digits less four */
        CHECK_NEAR(m->gradient[i][1], -2.0, 1e-4);
        CHECK_NEAR(m->gradient[i][2], 0.5, 1e-4);
    }
    CHECK_EQ_U64(tetcast_mesh_set_field(m, 0), TETCAST_OK);
    CHECK(m->gradient != NULL);
    tetcast_mesh_destroy(m);
    tets_free(&t);
    CHECK_EQ_U64(tetcast_mesh_make_gradients(NULL, NULL), TETCAST_ERR_INVALID_ARG);
}

/* total_bytes is what the allocator gave, but for 128 bytes a block and a few for what stands behind the last element. */
TEST(total_bytes) {
    enum { N = 9 };
    static float v[N * N * N];
    tetcast_field field[3];
    size_t fields;
    int kind, drop, i;
    memset(field, 0, sizeof field);
    for (i = 0; i < N * N * N; i++) v[i] = i == 7 ? NAN : (float)i;
    for (i = 0; i < 3; i++) field[i].values.data = v;
    field[2].per_cell = 1;
    for (kind = 0; kind < TETCAST_CELLS_COUNT; kind++)
        for (fields = 0; fields <= 3; fields++)
            for (drop = 0; drop < 2; drop++) {
                tetcast_mesh_desc d;
                tetcast_mesh_info info;
                tetcast_grid g;
                tetcast_mesh *m = NULL;
                test_alloc ta;
                double left;
                memset(&d, 0, sizeof d);
                memset(&g, 0, sizeof g);
                test_alloc_init(&ta);
                d.env.allocator.alloc_fn = test_alloc_fn;
                d.env.allocator.free_fn = test_free_fn;
                d.env.allocator.user = &ta;
                d.cells = (tetcast_cells)kind;
                d.drop_tets = d.drop_source = d.disable_clusters = (uint32_t)drop;
                d.keep_neighbours = (uint32_t)!drop;
                for (i = 0; i < 3; i++) g.dims[i] = N;
                g.fields = field;
                g.field_count = fields;
                CHECK_EQ_U64(tetcast_mesh_create_grid(&d, &g, NULL, &m), TETCAST_OK);
                REQUIRE(m != NULL);
                tetcast_mesh_get_info(m, &info);
                left = (double)ta.live_bytes - (double)info.total_bytes - 128.0 * (double)ta.live_blocks;
                CHECK_MSG(left >= 0 && left <= 600, "form %d, %u fields, drop %d: %g bytes are not in total_bytes", kind, (unsigned)fields, drop, left);
                tetcast_mesh_destroy(m);
                test_alloc_check(&ta);
            }
}

TEST(info) { /* bytes add up; what was dropped is gone */
    tets t;
    tetcast_mesh_desc d = keep_all(0);
    tetcast_mesh_info info;
    tetcast_mesh *m;
    uint32_t v[4];
    memset(&t, 0, sizeof t);
    tets_lattice(&t, 10, 10, 10, 6, NULL);
    d.drop_tets = d.drop_source = 1;
    d.keep_neighbours = 0;
    d.disable_clusters = 1;
    m = tets_build_desc(&t, &d, NULL);
    REQUIRE(m != NULL);
    tetcast_mesh_get_info(m, &info);
    CHECK_EQ_U64(info.cell_count, 6 * 729);
    CHECK_EQ_U64(info.vertex_count, 1000);
    CHECK_EQ_U64(info.hull_face_count, 6 * 81 * 2);
    CHECK_EQ_U64(info.optional_bytes, 0);
    CHECK_EQ_U64(info.cluster_bytes, 0);
    CHECK_EQ_U64(info.connectivity_bytes, 16 * info.cell_count);
    CHECK_EQ_U64(info.field_bytes, 0); /* the only field is in the vertices */
    {
        float before = 0, after = 0;
        tetcast_mesh_vertex(m, 500, NULL, &before, NULL);
        CHECK_EQ_U64(tetcast_mesh_set_field(m, 0), TETCAST_OK);
        tetcast_mesh_vertex(m, 500, NULL, &after, NULL);
        CHECK(before == after && before != 0);
    }
    CHECK(info.total_bytes >= info.connectivity_bytes + info.vertex_bytes + info.hull_bytes + info.field_bytes);
    CHECK(info.total_bytes <= m->mem.used);
    CHECK(info.box_min[0] == 0 && info.box_max[2] == 9);
    CHECK_EQ_U64(tetcast_mesh_cell(m, 0, v, NULL), TETCAST_ERR_RANGE);
    CHECK_EQ_U64(tetcast_mesh_make_gradients(m, NULL), TETCAST_ERR_INVALID_ARG);
    {
        tetcast_check c;
        CHECK_EQ_U64(tetcast_mesh_check(m, NULL, &c), TETCAST_ERR_INVALID_ARG);
    }
    tetcast_mesh_destroy(m);
    tets_free(&t);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(all_ways);
    RUN(escapes);
    RUN(record_of_tet8);
    RUN(same_trails);
    RUN(gradients);
    RUN(info);
    RUN(total_bytes);
    return test_end();
}
