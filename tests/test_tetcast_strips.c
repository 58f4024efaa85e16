/* test_tetcast_strips.c - Tet20, Tet32, the list of 160 bytes, strips: what they say about a mesh */
#include "test.h"
#define TETCAST_IMPLEMENTATION
#include "tetcast.h"
#include "tets.h"

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

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(walks);
    RUN(statistics);
    RUN(same_for_all_threads);
    RUN(list_of_planes);
    return test_end();
}
