/* Import: counts, neighbours, shapes that are cut, structured grids, what is wrong with meshes and what becomes of it,
   memory and threads. Oracles work on the input with sorted lists and exact integers. */
#include "test.h"
#define TETCAST_IMPLEMENTATION
#include "tetcast.h"
#include "tets.h"

static tetcast_mesh_desc defaults(void) {
    tetcast_mesh_desc d;
    memset(&d, 0, sizeof d);
    d.env.thread_count = 1;
    d.keep_neighbours = 1;
    return d;
}

/* ---- oracle: neighbours by comparing sorted faces ---- */

typedef struct face { uint32_t v[3], cell, side; } face;

static int face_compare(const void *a, const void *b) {
    const face *p = (const face *)a, *q = (const face *)b;
    int k;
    for (k = 0; k < 3; k++)
        if (p->v[k] != q->v[k]) return p->v[k] < q->v[k] ? -1 : 1;
    return p->cell < q->cell ? -1 : p->cell > q->cell;
}

/* All neighbours of a mesh with its tets: faces of exactly two cells join them. */
static uint32_t (*oracle_neighbours(const tetcast_mesh *m))[4] {
    size_t n = m->cell_count, i, j, k;
    uint32_t (*out)[4] = (uint32_t (*)[4])malloc(n * sizeof *out + 1);
    face *f = (face *)malloc(4 * n * sizeof *f + 1);
    if (out == NULL || f == NULL) abort();
    for (i = 0; i < n; i++)
        for (j = 0; j < 4; j++) {
            face *g = &f[4 * i + j];
            uint32_t c = 0, x;
            for (k = 0; k < 4; k++)
                if (k != j) g->v[c++] = m->tet[i][k];
            if (g->v[0] > g->v[1]) { x = g->v[0]; g->v[0] = g->v[1]; g->v[1] = x; }
            if (g->v[1] > g->v[2]) { x = g->v[1]; g->v[1] = g->v[2]; g->v[2] = x; }
            if (g->v[0] > g->v[1]) { x = g->v[0]; g->v[0] = g->v[1]; g->v[1] = x; }
            g->cell = (uint32_t)i;
            g->side = (uint32_t)j;
            out[i][j] = TETCASTI_NONE;
        }
    qsort(f, 4 * n, sizeof *f, face_compare);
    for (i = 0; i < 4 * n; i = k) {
        for (k = i + 1; k < 4 * n && memcmp(f[k].v, f[i].v, sizeof f[i].v) == 0; k++) { }
        if (k - i == 2) {
            out[f[i].cell][f[i].side] = f[i + 1].cell;
            out[f[i + 1].cell][f[i + 1].side] = f[i].cell;
        }
    }
    free(f);
    return out;
}

/* Volume in exact integers of local units * 2^18, as a double of the right sign. */
static int oracle_sign(const tetcast_mesh *m, const uint32_t *t) {
    long double u[3][3], det;
    int i;
    const tetcasti_vertex *a = &m->vertex[t[0]];
    for (i = 0; i < 3; i++) {
        const tetcasti_vertex *b = &m->vertex[t[i + 1]];
        u[i][0] = (long double)b->x - (long double)a->x;
        u[i][1] = (long double)b->y - (long double)a->y;
        u[i][2] = (long double)b->z - (long double)a->z;
    }
    det = u[0][0] * (u[1][1] * u[2][2] - u[1][2] * u[2][1]) - u[0][1] * (u[1][0] * u[2][2] - u[1][2] * u[2][0]) +
          u[0][2] * (u[1][0] * u[2][1] - u[1][1] * u[2][0]);
    return det > 0 ? 1 : det < 0 ? -1 : 0;
}

/* What holds for every mesh. */
static void check_mesh(const tetcast_mesh *m, int orientable) {
    uint32_t (*n)[4], i, j, k, hull = 0, wrong = 0;
    if (m == NULL) return;
    n = oracle_neighbours(m);
    for (i = 0; i < m->cell_count; i++) {
        const uint32_t *t = m->tet[i];
        uint32_t least = t[2] < t[3] ? t[2] : t[3];
        if (!(t[0] < t[1] && t[1] < least && t[2] != t[3])) wrong |= 1;
        for (j = 0; j < 4; j++) {
            if (t[j] >= m->vertex_count) wrong |= 2;
            if (n[i][j] != m->neighbour[i][j]) wrong |= 4;
            hull += n[i][j] == TETCASTI_NONE;
            if (orientable && n[i][j] != TETCASTI_NONE) { /* the face is seen the other way round by the neighbour */
                const uint32_t *u = m->tet[n[i][j]];
                uint32_t a[3], b[3], turn;
                for (k = 0; k < 4; k++)
                    if (u[k] != t[(j + 1) & 3] && u[k] != t[(j + 2) & 3] && u[k] != t[(j + 3) & 3]) break;
                if (k == 4) continue;
                for (turn = 0; turn < 3; turn++) {
                    a[turn] = t[tetcasti_face_of[j][turn]];
                    b[turn] = u[tetcasti_face_of[k][turn]];
                }
                for (turn = 0; turn < 3 && b[0] != a[0]; turn++) {
                    uint32_t x = b[0];
                    b[0] = b[1];
                    b[1] = b[2];
                    b[2] = x;
                }
                if (b[1] != a[2] || b[2] != a[1]) wrong |= 8;
            }
        }
    }
    CHECK_MSG(wrong == 0, "fault %u", wrong);
    CHECK_EQ_U64(hull, m->face_count);
    for (i = 0; i < m->face_count; i++) {
        const tetcasti_face *f = &m->face[i];
        const uint32_t *t = m->tet[f->cell];
        for (j = 0; j < 4; j++)
            if (t[tetcasti_face_of[j][0]] == f->v[0] && t[tetcasti_face_of[j][1]] == f->v[1] &&
                t[tetcasti_face_of[j][2]] == f->v[2]) break;
        if (j == 4 || n[f->cell][j] != TETCASTI_NONE) wrong |= 16;
    }
    CHECK_MSG(wrong == 0, "fault %u", wrong);
    free(n);
}

/* ---- counts ---- */

TEST(counts) {
    static const uint32_t size[3][5] = {{8, 8, 8, 5, 1715}, {32, 32, 32, 5, 148955}, {40, 32, 32, 6, 224874}};
    uint32_t i;
    for (i = 0; i < (test_quick() ? 1u : 3u); i++) {
        tets t;
        tetcast_report r;
        tetcast_mesh_desc d = defaults();
        tetcast_mesh *m;
        uint64_t quads;
        memset(&t, 0, sizeof t);
        tets_lattice(&t, size[i][0], size[i][1], size[i][2], (int)size[i][3], NULL);
        m = tets_build_desc(&t, &d, &r);
        REQUIRE(m != NULL);
        CHECK_EQ_U64(r.cells, size[i][4]);
        CHECK_EQ_U64(r.vertices, (uint64_t)size[i][0] * size[i][1] * size[i][2]);
        quads = 2u * ((uint64_t)(size[i][0] - 1) * (size[i][1] - 1) + (uint64_t)(size[i][1] - 1) * (size[i][2] - 1) +
                      (uint64_t)(size[i][0] - 1) * (size[i][2] - 1));
        CHECK_EQ_U64(r.hull_faces, 2 * quads);
        CHECK_EQ_U64(r.bad_indices + r.bad_positions + r.repeated + r.duplicates + r.zero_volume + r.inverted +
                     r.nonmanifold_faces + r.bad_values + r.unused_vertices + r.welded, 0);
        if (i == 0) check_mesh(m, 1);
        tetcast_mesh_destroy(m);
        tets_free(&t);
    }
}

/* ---- neighbours and orientation ---- */

TEST(neighbours) { /* any order of everything, jittered until cells are inverted */
    uint32_t k;
    for (k = 0; k < 24; k++) {
        tets t;
        tetcast_report r;
        tetcast_check c;
        tetcast_mesh_desc d = defaults();
        tetcast_mesh *m;
        memset(&t, 0, sizeof t);
        tets_lattice(&t, 9, 7, 8, k & 1 ? 5 : 6, NULL);
        tets_jitter(&t, 9, 7, 8, k < 8 ? 0.3 : k < 16 ? 0.9 : 1.5, k);
        if (k & 2) tets_shuffle(&t, k);
        d.order = (tetcast_order)(k % 3);
        m = tets_build_desc(&t, &d, &r);
        check_mesh(m, 1);
        if (m != NULL) {
            uint32_t i, inverted = 0;
            for (i = 0; i < m->cell_count; i++) inverted += oracle_sign(m, m->tet[i]) < 0;
            CHECK_EQ_U64(r.inverted, inverted);
            CHECK((k < 8) == (inverted == 0));
            CHECK_EQ_U64(tetcast_mesh_check(m, &d.env, &c), TETCAST_OK);
            CHECK_NEAR(c.volume, 8.0 * 6 * 7, 1e-3); /* the sides are flat, so inverted cells take away what overlaps */
            CHECK_EQ_U64(c.components, 1);
            if (k < 8) CHECK_EQ_U64(c.hanging_nodes, 0); /* later vertices have slid past each other on the sides */
            CHECK_EQ_U64(c.coincident_vertices, 0);
            CHECK((c.smallest < 0) == (inverted != 0));
        }
        tetcast_mesh_destroy(m);
        tets_free(&t);
    }
}

TEST(other_orientation) { /* all cells the other way round: turned silently */
    tets t;
    tetcast_report r;
    tetcast_mesh_desc d = defaults();
    tetcast_mesh *m;
    size_t i, negative = 0;
    memset(&t, 0, sizeof t);
    tets_lattice(&t, 6, 6, 6, 5, NULL);
    m = tets_build_desc(&t, &d, &r);
    negative = (size_t)r.turned;
    CHECK(negative > 0 && negative < t.nt);
    tetcast_mesh_destroy(m);
    for (i = 0; i < t.nt; i++) {
        uint32_t x = t.t[4 * i];
        t.t[4 * i] = t.t[4 * i + 1];
        t.t[4 * i + 1] = x;
    }
    m = tets_build_desc(&t, &d, &r);
    CHECK_EQ_U64(r.turned, t.nt - negative);
    CHECK_EQ_U64(r.inverted, 0);
    check_mesh(m, 1);
    tetcast_mesh_destroy(m);
    tets_free(&t);
}

TEST(source_numbers) { /* vertices and cells can be found again */
    tets t;
    tetcast_mesh_desc d = defaults();
    tetcast_mesh *m;
    uint32_t i, k;
    int wrong = 0;
    memset(&t, 0, sizeof t);
    tets_lattice(&t, 7, 6, 5, 6, NULL);
    tets_jitter(&t, 7, 6, 5, 0.3, 5);
    tets_shuffle(&t, 3);
    m = tets_build_desc(&t, &d, NULL);
    REQUIRE(m != NULL);
    for (i = 0; i < m->vertex_count; i++) {
        double p[3];
        float s;
        uint32_t v;
        tetcast_mesh_vertex(m, i, p, &s, &v);
        for (k = 0; k < 3; k++) wrong |= !(fabs(p[k] - t.p[3 * v + k]) < 1e-6);
        wrong |= s != t.s[v];
    }
    for (i = 0; i < m->cell_count; i++) {
        uint32_t v[4], c, j, found = 0;
        CHECK_EQ_U64(tetcast_mesh_cell(m, i, v, &c), TETCAST_OK);
        for (k = 0; k < 4; k++)
            for (j = 0; j < 4; j++) found += m->source_vertex[v[k]] == t.t[4 * c + j];
        wrong |= found != 4;
    }
    CHECK(!wrong);
    CHECK_EQ_U64(tetcast_mesh_cell(m, m->cell_count, NULL, NULL), TETCAST_ERR_RANGE);
    {
        uint32_t v[4] = {1, 2, 3, 4}, c = 5;
        CHECK_EQ_U64(tetcast_mesh_cell(m, m->cell_count, v, &c), TETCAST_ERR_RANGE);
        CHECK(v[0] == TETCAST_NONE && v[3] == TETCAST_NONE && c == TETCAST_NONE);
    }
    tetcast_mesh_destroy(m);
    tets_free(&t);
}

TEST(hull_faces) { /* outwards and closed: each edge once each way, and what they hold is the volume of all cells */
    tets t;
    tetcast_mesh_desc d = defaults();
    tetcast_mesh *m;
    tetcast_check check;
    static uint8_t edge[400][400];
    double volume = 0.0;
    uint32_t i, k, faces, v[3];
    int open = 0;
    memset(&t, 0, sizeof t);
    tets_lattice(&t, 7, 6, 5, 6, NULL);
    tets_jitter(&t, 7, 6, 5, 0.2, 5);
    m = tets_build_desc(&t, &d, NULL);
    REQUIRE(m != NULL && m->vertex_count <= 400);
    faces = m->face_count;
    CHECK_EQ_U64(faces, 4 * (6 * 5 + 5 * 4 + 4 * 6));
    memset(edge, 0, sizeof edge);
    for (i = 0; i < faces; i++) {
        double p[3][3];
        tetcast_mesh_hull_face(m, i, v);
        for (k = 0; k < 3; k++) {
            tetcast_mesh_vertex(m, v[k], p[k], NULL, NULL);
            edge[v[k]][v[(k + 1) % 3]]++;
        }
        for (k = 0; k < 3; k++)
            volume += p[0][k] * (p[1][(k + 1) % 3] * p[2][(k + 2) % 3] - p[1][(k + 2) % 3] * p[2][(k + 1) % 3]) / 6.0;
    }
    for (i = 0; i < 400; i++)
        for (k = 0; k < 400; k++) open |= edge[i][k] > 1 || edge[i][k] != edge[k][i];
    CHECK(!open);
    CHECK_EQ_U64(tetcast_mesh_check(m, NULL, &check), TETCAST_OK);
    CHECK(fabs(volume - check.volume) < 1e-9 * check.volume);
    tetcast_mesh_hull_face(m, faces, v);
    CHECK(v[0] == TETCAST_NONE && v[1] == TETCAST_NONE && v[2] == TETCAST_NONE);
    tetcast_mesh_hull_face(NULL, 0, v);
    CHECK(v[0] == TETCAST_NONE);
    tetcast_mesh_destroy(m);
    tets_free(&t);
}

/* ---- exact volumes ---- */

TEST(exact_volume) { /* against integers of 128 bits and more, from coordinates that are nearly in a plane */
    test_rng rng = test_rng_make(11);
    uint32_t i, k, zero = 0;
    for (i = 0; i < 20000; i++) {
        tetcasti_vertex v[4];
        int64_t c[4][3], u[3][3];
        double big, det;
        int want;
        long double a, b, sum = 0;
        memset(v, 0, sizeof v);
        for (k = 0; k < 4; k++) {
            uint32_t j;
            for (j = 0; j < 3; j++) c[k][j] = (int64_t)test_rng_below(&rng, i % 3 == 0 ? 4u : 1u << 20) - (1 << 19);
        }
        if (i % 3 != 2) /* the fourth in the plane of the others, or one step off */
            for (k = 0; k < 3; k++) c[3][k] = c[0][k] + (c[1][k] - c[0][k]) + (c[2][k] - c[0][k]);
        if (i % 6 == 1) c[3][i % 3] += 1;
        big = i % 2 ? 256.0 : 1.0 / 262144.0;
        for (k = 0; k < 4; k++) {
            v[k].x = (float)((double)c[k][0] * big);
            v[k].y = (float)((double)c[k][1] * big);
            v[k].z = (float)((double)c[k][2] * big);
        }
        for (k = 0; k < 9; k++) u[k / 3][k % 3] = c[k / 3 + 1][k % 3] - c[0][k % 3];
        for (k = 0; k < 3; k++) { /* below 2^21 each: minors are exact in 64 bits, the sum in a long double of 64 bits */
            int64_t minor = u[1][(k + 1) % 3] * u[2][(k + 2) % 3] - u[1][(k + 2) % 3] * u[2][(k + 1) % 3];
            a = (long double)u[0][k];
            b = (long double)minor;
            sum += a * b;
        }
        want = sum > 0 ? 1 : sum < 0 ? -1 : 0;
        det = tetcasti_volume6(&v[0], &v[1], &v[2], &v[3]);
        zero += det == 0;
        CHECK_MSG((det > 0 ? 1 : det < 0 ? -1 : 0) == want, "case %u: %g, expected %d", i, det, want);
    }
    CHECK(zero > 5000 && zero < 15000);
}

/* ---- shapes ---- */

/* Volume of the tetrahedra and no inner face on the hull: a block of mixed cells. */
TEST(mixed_shapes) {
    uint32_t pass;
    for (pass = 0; pass < 40; pass++) {
        test_rng rng = test_rng_make(pass);
        tetcast_input in;
        tetcast_mesh_desc d = defaults();
        tetcast_report r;
        tetcast_mesh *m = NULL;
        tetcast_check c;
        enum { N = 5 };
        static const uint8_t hex[8] = {0, 1, 3, 2, 4, 5, 7, 6};
        double p[N * N * N + (N - 1) * (N - 1) * (N - 1)][3];
        uint32_t index[8 * 6 * 64 + 8], order[N * N * N + 64], cells = 0, at = 0, i, x, y, z, centre = N * N * N, hull = 0;
        uint8_t shape[6 * 64];
        for (i = 0; i < N * N * N + 64; i++) order[i] = i;
        for (i = N * N * N + 64; i > 1; i--) { /* any numbers: the cuts depend on them */
            uint32_t j = test_rng_below(&rng, i), k = order[i - 1];
            order[i - 1] = order[j];
            order[j] = k;
        }
        for (i = 0; i < N * N * N; i++) {
            double q[3];
            q[0] = i % N;
            q[1] = i / N % N;
            q[2] = i / N / N;
            memcpy(p[order[i]], q, sizeof q);
        }
        for (z = 0; z + 1 < N; z++)
            for (y = 0; y + 1 < N; y++)
                for (x = 0; x + 1 < N; x++) {
                    uint32_t v[8], kind = test_rng_below(&rng, 4), k;
                    double q[3];
                    for (i = 0; i < 8; i++) v[i] = order[((z + (i >> 2)) * N + y + (i >> 1 & 1)) * N + x + (i & 1)];
                    q[0] = x + 0.5;
                    q[1] = y + 0.5;
                    q[2] = z + 0.5;
                    memcpy(p[order[centre]], q, sizeof q);
                    if (kind == 0) { /* voxel */
                        for (i = 0; i < 8; i++) index[at++] = v[i];
                        shape[cells++] = TETCAST_SHAPE_VOXEL;
                    } else if (kind == 1) {
                        for (i = 0; i < 8; i++) index[at++] = v[hex[i]];
                        shape[cells++] = TETCAST_SHAPE_HEXAHEDRON;
                    } else if (kind == 2) { /* six pyramids around the middle */
                        for (k = 0; k < 6; k++) {
                            for (i = 0; i < 4; i++) index[at++] = v[tetcasti_voxel_face[k][i]];
                            index[at++] = order[centre];
                            shape[cells++] = TETCAST_SHAPE_PYRAMID;
                        }
                    } else { /* two prisms: their cut goes through both faces in z, so those must be cut like that too */
                        uint32_t w[2][6] = {{0, 1, 3, 4, 5, 7}, {0, 3, 2, 4, 7, 6}};
                        uint32_t low = v[0] < v[3] ? v[0] : v[3], other = v[1] < v[2] ? v[1] : v[2];
                        uint32_t low2 = v[4] < v[7] ? v[4] : v[7], other2 = v[5] < v[6] ? v[5] : v[6];
                        if (low > other || low2 > other2) { /* neighbours would cut them the other way: a voxel instead */
                            for (i = 0; i < 8; i++) index[at++] = v[i];
                            shape[cells++] = TETCAST_SHAPE_VOXEL;
                        } else {
                            for (k = 0; k < 2; k++) {
                                for (i = 0; i < 6; i++) index[at++] = v[w[k][i]];
                                shape[cells++] = TETCAST_SHAPE_WEDGE;
                            }
                        }
                    }
                    centre++;
                }
        for (; centre < N * N * N + 64; centre++) memset(p[order[centre]], 0, sizeof p[0]);
        memset(&in, 0, sizeof in);
        in.positions.data = p;
        in.positions.type = TETCAST_TYPE_F64;
        in.vertex_count = N * N * N + 64;
        in.indices = index;
        in.index_count = at;
        in.shapes = shape;
        in.cell_count = cells;
        CHECK_EQ_U64(tetcast_mesh_create(&d, &in, &r, &m), TETCAST_OK);
        REQUIRE(m != NULL);
        check_mesh(m, 1);
        hull = 6 * (N - 1) * (N - 1) * 2;
        CHECK_EQ_U64(r.hull_faces, hull);
        CHECK_EQ_U64(r.inverted + r.zero_volume + r.repeated, 0);
        CHECK_EQ_U64(tetcast_mesh_check(m, NULL, &c), TETCAST_OK);
        CHECK_NEAR(c.volume, 64.0, 1e-4);
        tetcast_mesh_destroy(m);
    }
}

TEST(hexahedron_all_numberings) { /* all orders of the numbers of a cube's corners: 5 or 6 cells that fill it */
    uint32_t number[8] = {0, 1, 2, 3, 4, 5, 6, 7}, c[8] = {0, 0, 0, 0, 0, 0, 0, 0}, i = 0, fives = 0, sixes = 0;
    static const int corner[8][3] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}, {0, 0, 1}, {1, 0, 1}, {1, 1, 1}, {0, 1, 1}};
    for (;;) { /* Heap's algorithm */
        uint32_t out[6][4], repeated = 0, n, j, k, volume = 0, place[8], wrong = 0;
        for (j = 0; j < 8; j++) place[number[j]] = j;
        n = tetcasti_cut(TETCAST_SHAPE_HEXAHEDRON, number, out, &repeated);
        for (j = 0; j < n; j++) {
            int e[3][3], det;
            for (k = 0; k < 9; k++) e[k / 3][k % 3] = corner[place[out[j][k / 3 + 1]]][k % 3] - corner[place[out[j][0]]][k % 3];
            det = e[0][0] * (e[1][1] * e[2][2] - e[1][2] * e[2][1]) - e[0][1] * (e[1][0] * e[2][2] - e[1][2] * e[2][0]) +
                  e[0][2] * (e[1][0] * e[2][1] - e[1][1] * e[2][0]);
            if (det == 0) wrong = 1;
            volume += (uint32_t)abs(det);
        }
        fives += n == 5;
        sixes += n == 6;
        CHECK(!wrong && volume == 6 && repeated == 0 && (n == 5 || n == 6));
        while (i < 8 && c[i] >= i) c[i++] = 0;
        if (i == 8) break;
        j = (i & 1u) ? c[i] : 0;
        k = number[j];
        number[j] = number[i];
        number[i] = k;
        c[i]++;
        i = 0;
    }
    CHECK_EQ_U64(fives + sixes, 40320);
    CHECK(fives > 0 && sixes > fives);
}

TEST(degenerate_shapes) { /* a hexahedron with an edge that is a point is a wedge; nothing is left of a flat one */
    double p[8][3] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}, {0, 0, 1}, {1, 0, 1}, {1, 1, 1}, {0, 1, 1}};
    uint32_t wedge[8] = {0, 1, 2, 2, 4, 5, 6, 6}, point[8] = {3, 3, 3, 3, 3, 3, 3, 3};
    uint8_t shape = TETCAST_SHAPE_HEXAHEDRON;
    tetcast_input in;
    tetcast_mesh_desc d = defaults();
    tetcast_report r;
    tetcast_check c;
    tetcast_mesh *m = NULL;
    memset(&in, 0, sizeof in);
    in.positions.data = p;
    in.positions.type = TETCAST_TYPE_F64;
    in.vertex_count = 8;
    in.indices = wedge;
    in.index_count = 8;
    in.shapes = &shape;
    in.cell_count = 1;
    CHECK_EQ_U64(tetcast_mesh_create(&d, &in, &r, &m), TETCAST_OK);
    REQUIRE(m != NULL);
    CHECK_EQ_U64(r.cells, 3);
    CHECK(r.repeated > 0 && r.first_repeated == 0);
    CHECK_EQ_U64(r.hull_faces, 8);
    CHECK_EQ_U64(r.unused_vertices, 2);
    check_mesh(m, 1);
    CHECK_EQ_U64(tetcast_mesh_check(m, NULL, &c), TETCAST_OK);
    CHECK_NEAR(c.volume, 0.5, 1e-6);
    tetcast_mesh_destroy(m);
    in.indices = point;
    CHECK_EQ_U64(tetcast_mesh_create(&d, &in, &r, &m), TETCAST_ERR_EMPTY);
    CHECK(m == NULL);
}

/* ---- structured grids ---- */

static int near_to(double a, double b) { return fabs(a - b) <= 6e-8 * (fabs(b) + 12); }

TEST(grids) {
    uint32_t kind, i, k, five;
    for (five = 0; five < 2; five++)
        for (kind = 0; kind < 3; kind++) {
            tetcast_grid g;
            tetcast_mesh_desc d = defaults();
            tetcast_report r;
            tetcast_mesh *m = NULL;
            tetcast_field f;
            float value[6 * 5 * 4];
            double x[6] = {0, 1, 1.5, 4, 5, 9};
            float y[5] = {-1, 0, 2, 3, 3.5f}, p[120][3];
            int16_t z[4] = {-3, 0, 1, 9};
            int wrong = 0;
            memset(&g, 0, sizeof g);
            memset(&f, 0, sizeof f);
            g.dims[0] = 6;
            g.dims[1] = 5;
            g.dims[2] = 4;
            g.origin[0] = 10;
            g.origin[1] = -20;
            g.origin[2] = 5;
            g.alternate = five;
            for (i = 0; i < 9; i++) g.matrix[i] = i % 4 == 0 ? 0.8 : i == 1 ? 0.6 : i == 3 ? -0.6 : 0.0;
            g.matrix[8] = 1;
            if (kind == 0) { /* uniform */
                g.spacing[0] = 0.5;
                g.spacing[1] = 2;
                g.spacing[2] = 0.25;
            } else if (kind == 1) {
                g.axes[0].data = x;
                g.axes[0].type = TETCAST_TYPE_F64;
                g.axes[1].data = y;
                g.axes[2].data = z;
                g.axes[2].type = TETCAST_TYPE_I16;
            } else {
                for (i = 0; i < 120; i++) {
                    p[i][0] = (float)(i % 6) + 0.1f * (float)(i / 30);
                    p[i][1] = (float)(i / 6 % 5) * (1.0f + 0.1f * (float)(i % 6));
                    p[i][2] = (float)(i / 30);
                }
                g.positions.data = p;
            }
            for (i = 0; i < 120; i++) value[i] = (float)i;
            f.values.data = value;
            g.fields = &f;
            g.field_count = 1;
            CHECK_EQ_U64(tetcast_mesh_create_grid(&d, &g, &r, &m), TETCAST_OK);
            REQUIRE(m != NULL);
            CHECK_EQ_U64(r.cells, (five ? 5 : 6) * 60);
            CHECK_EQ_U64(r.hull_faces, 4 * (5 * 4 + 4 * 3 + 5 * 3));
            CHECK_EQ_U64(r.inverted, 0);
            check_mesh(m, 1);
            for (i = 0; i < m->vertex_count; i++) {
                double q[3], c[3], w[3];
                float s;
                uint32_t v;
                tetcast_mesh_vertex(m, i, q, &s, &v);
                wrong |= s != (float)v;
                if (kind == 2) {
                    for (k = 0; k < 3; k++) w[k] = (double)p[v][k];
                } else {
                    c[0] = kind == 0 ? 0.5 * (v % 6) : x[v % 6];
                    c[1] = kind == 0 ? 2.0 * (v / 6 % 5) : (double)y[v / 6 % 5];
                    c[2] = kind == 0 ? 0.25 * (v / 30) : z[v / 30];
                    for (k = 0; k < 3; k++)
                        w[k] = g.origin[k] + g.matrix[3 * k] * c[0] + g.matrix[3 * k + 1] * c[1] + g.matrix[3 * k + 2] * c[2];
                }
                for (k = 0; k < 3; k++) wrong |= !near_to(q[k], w[k]);
            }
            CHECK(!wrong);
            tetcast_mesh_destroy(m);
        }
}

static int first_value(void *user, const tetcast_crossing *c) {
    *(float *)user = c->front;
    return 1;
}

/* Largest differences of the mesh's function from the trilinear one of its grid of n^3 hexahedra, and from the smooth
   function at the nodes. */
static void hexahedra_differ(uint32_t n, uint32_t alternate, double differ[2]) {
    const uint32_t m = n + 1;
    tetcast_grid g;
    tetcast_field f;
    tetcast_mesh_desc d = defaults();
    tetcast_mesh *mesh = NULL;
    test_rng r = test_rng_make(n);
    float *value = (float *)malloc((size_t)m * m * m * sizeof *value);
    uint32_t i, k;
    memset(&g, 0, sizeof g);
    memset(&f, 0, sizeof f);
    differ[0] = differ[1] = 0;
    if (value == NULL) abort();
    for (i = 0; i < m * m * m; i++) {
        const double x = (double)(i % m) / n, y = (double)(i / m % m) / n, z = (double)(i / m / m) / n;
        value[i] = (float)(x * y + y * z - x * z + x * y * z + 0.2 * sin(3 * x + 2 * y) * cos(3 * z));
    }
    f.values.data = value;
    g.fields = &f;
    g.field_count = 1;
    g.alternate = alternate;
    for (k = 0; k < 3; k++) {
        g.dims[k] = m;
        g.spacing[k] = 1.0 / n;
    }
    CHECK_EQ_U64(tetcast_mesh_create_grid(&d, &g, NULL, &mesh), TETCAST_OK);
    for (i = 0; mesh != NULL && i < 4000; i++) {
        tetcast_ray ray;
        double w[3], hex = 0, smooth;
        float got = NAN;
        uint32_t c[3];
        memset(&ray, 0, sizeof ray);
        ray.dir[0] = 1;
        ray.t_max = 10;
        for (k = 0; k < 3; k++) {
            ray.org[k] = 0.001 + 0.998 * test_rng_double(&r);
            c[k] = (uint32_t)(ray.org[k] * n);
            w[k] = ray.org[k] * n - c[k];
        }
        for (k = 0; k < 8; k++)
            hex += (k & 1 ? w[0] : 1 - w[0]) * (k & 2 ? w[1] : 1 - w[1]) * (k & 4 ? w[2] : 1 - w[2]) *
                   (double)value[c[0] + (k & 1) + m * (c[1] + (k >> 1 & 1) + m * (c[2] + (k >> 2)))];
        smooth = ray.org[0] * ray.org[1] + ray.org[1] * ray.org[2] - ray.org[0] * ray.org[2] +
                 ray.org[0] * ray.org[1] * ray.org[2] +
                 0.2 * sin(3 * ray.org[0] + 2 * ray.org[1]) * cos(3 * ray.org[2]);
        (void)tetcast_probe(mesh, &ray, first_value, &got);
        CHECK(got == got);
        differ[0] = fmax(differ[0], fabs((double)got - hex));
        differ[1] = fmax(differ[1], fabs((double)got - smooth));
    }
    tetcast_mesh_destroy(mesh);
    free(value);
}

TEST(hexahedra_converge) { /* half the size of the cells, a quarter of what cutting hexahedra changes */
    uint32_t alternate, n, k;
    for (alternate = 0; alternate < 2; alternate++) {
        double last[2] = {0, 0}, first[2] = {0, 0};
        for (n = 4; n <= 32; n *= 2) {
            double now[2];
            hexahedra_differ(n, alternate, now);
            if (getenv("TEST_PRINT") != NULL)
                printf("%2u^3 hexahedra, %u each: from trilinear %.3g, from the function %.3g\n", n, alternate ? 5u : 6u,
                       now[0], now[1]);
            for (k = 0; k < 2; k++) {
                CHECK(n == 4 || (now[k] < last[k] / 3 && now[k] > last[k] / 5));
                if (n == 4) first[k] = now[k];
                last[k] = now[k];
            }
        }
        for (k = 0; k < 2; k++) CHECK(first[k] > 50 * last[k] && first[k] < 80 * last[k]); /* 64 */
    }
}

TEST(grid_blanks) { /* a vertex that is blanked takes its eight cells out */
    tetcast_grid g;
    tetcast_mesh_desc d = defaults();
    tetcast_report r;
    tetcast_mesh *m = NULL;
    uint8_t blank[125];
    memset(&g, 0, sizeof g);
    memset(blank, 1, sizeof blank);
    blank[62] = 0;
    g.dims[0] = g.dims[1] = g.dims[2] = 5;
    g.blanks = blank;
    CHECK_EQ_U64(tetcast_mesh_create_grid(&d, &g, &r, &m), TETCAST_OK);
    REQUIRE(m != NULL);
    CHECK_EQ_U64(r.cells, 6 * (64 - 8));
    CHECK_EQ_U64(r.hull_faces, 6 * 16 * 2 + 6 * 4 * 2);
    CHECK_EQ_U64(r.unused_vertices, 1);
    check_mesh(m, 1);
    tetcast_mesh_destroy(m);
    g.dims[1] = 1;
    CHECK_EQ_U64(tetcast_mesh_create_grid(&d, &g, &r, &m), TETCAST_ERR_EMPTY);
    g.dims[0] = g.dims[1] = g.dims[2] = 4096;
    CHECK_EQ_U64(tetcast_mesh_create_grid(&d, &g, &r, &m), TETCAST_ERR_RANGE);
}

/* ---- what is wrong with meshes ---- */

TEST(bad_cells) { /* each fault is counted, the rest is there */
    tets t;
    tetcast_report r;
    tetcast_mesh_desc d = defaults();
    tetcast_mesh *m;
    uint32_t v;
    size_t good;
    memset(&t, 0, sizeof t);
    tets_lattice(&t, 5, 5, 5, 6, NULL);
    good = t.nt;
    v = tets_vertex(&t, (double)NAN, 0, 0, 0);
    tets_tet(&t, 0, 1, 2, v);                       /* NaN */
    v = tets_vertex(&t, 0, -(double)INFINITY, 0, 0);
    tets_tet(&t, 0, 1, 2, v);
    tets_tet(&t, 0, 1, 2, 1000000);                 /* out of range */
    tets_tet(&t, 0xffffffffu, 1, 2, 3);
    tets_tet(&t, 7, 7, 8, 9);                       /* twice the same vertex */
    tets_tet(&t, 7, 8, 9, 7);
    tets_tet(&t, t.t[0], t.t[2], t.t[3], t.t[1]);   /* there already */
    tets_tet(&t, t.t[40], t.t[41], t.t[43], t.t[42]);
    tets_tet(&t, t.t[40], t.t[42], t.t[43], t.t[41]);
    m = tets_build_desc(&t, &d, &r);
    REQUIRE(m != NULL);
    CHECK_EQ_U64(r.input_cells, good + 9);
    CHECK_EQ_U64(r.cells, good);
    CHECK_EQ_U64(r.bad_positions, 2);
    CHECK_EQ_U64(r.first_bad_position, good);
    CHECK_EQ_U64(r.bad_indices, 2);
    CHECK_EQ_U64(r.first_bad_index, good + 2);
    CHECK_EQ_U64(r.repeated, 2);
    CHECK_EQ_U64(r.first_repeated, good + 4);
    CHECK_EQ_U64(r.duplicates, 3);
    CHECK_EQ_U64(r.first_duplicate, good + 6);
    CHECK_EQ_U64(r.nonmanifold_faces, 0);
    CHECK_EQ_U64(r.unused_vertices, 2);
    check_mesh(m, 1);
    tetcast_mesh_destroy(m);
    {
        tetcast_error e;
        memset(&e, 0, sizeof e);
        d.strict = 1;
        d.env.error = &e;
        {
            tetcast_input in;
            memset(&in, 0, sizeof in);
            in.positions.data = t.p;
            in.positions.type = TETCAST_TYPE_F64;
            in.vertex_count = t.nv;
            in.indices = t.t;
            in.index_count = 4 * t.nt;
            in.cell_count = t.nt;
            CHECK_EQ_U64(tetcast_mesh_create(&d, &in, &r, &m), TETCAST_ERR_FORMAT);
            CHECK(m == NULL);
            CHECK_EQ_U64(e.where, good + 2);
            CHECK(strstr(e.text, "66") != NULL || strstr(e.text, "38") != NULL);
        }
    }
    tets_free(&t);
}

TEST(duplicates_at_crowded_faces) { /* four and more cells at each of its faces: the second one is found all the same */
    static const uint32_t side[4][3] = {{0, 1, 2}, {0, 1, 3}, {0, 2, 3}, {1, 2, 3}};
    uint32_t order, i, k;
    for (order = 0; order <= TETCAST_ORDER_INPUT; order++) {
        tets t;
        tetcast_report r;
        tetcast_mesh_desc d = defaults();
        tetcast_mesh *m;
        memset(&t, 0, sizeof t);
        d.order = (tetcast_order)order;
        tets_vertex(&t, 0, 0, 0, 0);
        tets_vertex(&t, 1, 0, 0, 0);
        tets_vertex(&t, 0, 1, 0, 0);
        tets_vertex(&t, 0, 0, 1, 0);
        tets_tet(&t, 0, 1, 2, 3);
        for (i = 0; i < 4; i++)
            for (k = 0; k < 3; k++)
                tets_tet(&t, side[i][0], side[i][1], side[i][2],
                         tets_vertex(&t, i == 2 ? -1.0 - k : 1.0 + k, i == 1 ? -1.0 - k : 1.0 + k, i == 0 ? -1.0 - k : 1.0 + k, 0));
        tets_tet(&t, 2, 0, 1, 3);
        m = tets_build_desc(&t, &d, &r);
        REQUIRE(m != NULL);
        CHECK_EQ_U64(r.duplicates, 1);
        CHECK_EQ_U64(r.first_duplicate, 13);
        CHECK_EQ_U64(r.cells, 13);
        CHECK_EQ_U64(r.nonmanifold_faces, 4);
        tetcast_mesh_destroy(m);
        tets_free(&t);
    }
}

TEST(nonmanifold) { /* three cells at a face: all three have hull there */
    tets t;
    tetcast_report r;
    tetcast_mesh_desc d = defaults();
    tetcast_mesh *m;
    memset(&t, 0, sizeof t);
    tets_vertex(&t, 0, 0, 0, 0);
    tets_vertex(&t, 1, 0, 0, 0);
    tets_vertex(&t, 0, 1, 0, 0);
    tets_vertex(&t, 0.2, 0.2, 1, 0);
    tets_vertex(&t, 0.2, 0.2, -1, 0);
    tets_vertex(&t, 0.4, 0.2, -2, 0);
    tets_tet(&t, 0, 1, 2, 3);
    tets_tet(&t, 0, 1, 2, 4);
    tets_tet(&t, 0, 1, 2, 5);
    m = tets_build_desc(&t, &d, &r);
    REQUIRE(m != NULL);
    CHECK_EQ_U64(r.nonmanifold_faces, 1);
    CHECK_EQ_U64(r.hull_faces, 12);
    CHECK_EQ_U64(r.first_nonmanifold, 0);
    check_mesh(m, 0);
    tetcast_mesh_destroy(m);
    tets_tet(&t, 1, 2, 0, 3); /* and one of them twice */
    m = tets_build_desc(&t, &d, &r);
    REQUIRE(m != NULL);
    CHECK_EQ_U64(r.duplicates, 1);
    CHECK_EQ_U64(r.first_duplicate, 3);
    CHECK_EQ_U64(r.cells, 3);
    CHECK_EQ_U64(r.nonmanifold_faces, 1);
    tetcast_mesh_destroy(m);
    tets_free(&t);
}

TEST(hanging_nodes) { /* two blocks of different resolution beside each other */
    tets t;
    tetcast_mesh_desc d = defaults();
    tetcast_report r;
    tetcast_check c;
    tetcast_mesh *m;
    size_t i, first;
    memset(&t, 0, sizeof t);
    tets_lattice(&t, 3, 3, 3, 6, NULL); /* 2 units wide */
    first = t.nv;
    tets_lattice(&t, 5, 5, 5, 6, NULL); /* 4 cells on 2 units */
    for (i = first; i < t.nv; i++) {
        t.p[3 * i] = t.p[3 * i] * 0.5 + 2;
        t.p[3 * i + 1] *= 0.5;
        t.p[3 * i + 2] *= 0.5;
    }
    d.weld = 1;
    m = tets_build_desc(&t, &d, &r);
    REQUIRE(m != NULL);
    CHECK_EQ_U64(r.welded, 9);
    CHECK_EQ_U64(tetcast_mesh_check(m, NULL, &c), TETCAST_OK);
    CHECK_EQ_U64(c.hanging_nodes, 16); /* all of the fine side's other vertices lie on edges or diagonals of the coarse */
    CHECK_EQ_U64(c.coincident_vertices, 0);
    CHECK_NEAR(c.volume, 16, 1e-5);
    CHECK_EQ_U64(c.components, 2);
    tetcast_mesh_destroy(m);
    d.weld = 0;
    m = tets_build_desc(&t, &d, &r);
    REQUIRE(m != NULL);
    CHECK_EQ_U64(tetcast_mesh_check(m, NULL, &c), TETCAST_OK);
    CHECK_EQ_U64(c.coincident_vertices, 9);
    CHECK_EQ_U64(c.hanging_nodes, 16);
    tetcast_mesh_destroy(m);
    tets_free(&t);
}

TEST(welded_blocks) { /* two blocks that share a side by position only become one */
    tets t;
    tetcast_mesh_desc d = defaults();
    tetcast_report r;
    tetcast_check c;
    tetcast_mesh *m;
    double place[3 * 128];
    size_t i, first, round;
    memset(&t, 0, sizeof t);
    tets_lattice(&t, 4, 4, 4, 6, NULL);
    first = t.nv;
    tets_lattice(&t, 4, 4, 4, 6, NULL);
    for (i = first; i < t.nv; i++) t.p[3 * i] += 3;
    m = tets_build_desc(&t, &d, &r);
    CHECK_EQ_U64(r.hull_faces, 2 * 108);
    tetcast_mesh_destroy(m);
    d.weld = 1;
    m = tets_build_desc(&t, &d, &r);
    CHECK_EQ_U64(r.welded, 16);
    CHECK_EQ_U64(r.hull_faces, 2 * 108 - 2 * 18);
    CHECK_EQ_U64(r.vertices, 2 * 64 - 16);
    CHECK_EQ_U64(r.unused_vertices, 0);
    check_mesh(m, 1);
    CHECK_EQ_U64(tetcast_mesh_check(m, NULL, &c), TETCAST_OK);
    CHECK_EQ_U64(c.components, 1);
    tetcast_mesh_destroy(m);
    memcpy(place, t.p, sizeof(double) * 3 * t.nv);
    for (round = 0; round < 5; round++) { /* far away, and where floats are zero or infinite */
        static const double scale[5] = {1.0, 1e60, 1e-60, 1e-30, 1e60}, offset[5] = {1e9, 0.0, 0.0, 1e9, -1e6};
        for (i = 0; i < 3 * t.nv; i++) t.p[i] = (place[i] + (i % 3 == round % 3 ? offset[round] : 0.0)) * scale[round];
        m = tets_build_desc(&t, &d, &r);
        CHECK_EQ_U64(r.welded, 16);
        CHECK_EQ_U64(r.hull_faces, 2 * 108 - 2 * 18);
        tetcast_mesh_destroy(m);
    }
    tets_free(&t);
}

TEST(flat_cells) { /* zero volume: kept, counted, aspect infinite */
    tets t;
    tetcast_mesh_desc d = defaults();
    tetcast_report r;
    tetcast_check c;
    tetcast_mesh *m;
    const double scale[3] = {1, 1, 0}, offset[3] = {5, 5, 5};
    memset(&t, 0, sizeof t);
    tets_lattice(&t, 4, 4, 4, 5, NULL);
    tets_place(&t, scale, offset);
    m = tets_build_desc(&t, &d, &r);
    REQUIRE(m != NULL);
    CHECK_EQ_U64(r.cells, 135);
    CHECK_EQ_U64(r.zero_volume, 135);
    CHECK_EQ_U64(r.inverted, 0);
    check_mesh(m, 1);
    CHECK_EQ_U64(tetcast_mesh_check(m, NULL, &c), TETCAST_OK);
    CHECK(c.volume == 0 && !(c.aspect < (double)INFINITY));
    CHECK_NEAR(c.longest_edge, sqrt(2.0), 1e-6);
    tetcast_mesh_destroy(m);
    tets_free(&t);
}

/* ---- values ---- */

TEST(value_types) { /* the same numbers in every type, strided and unaligned */
    static const tetcast_type types[9] = {TETCAST_TYPE_F32, TETCAST_TYPE_F64, TETCAST_TYPE_U8, TETCAST_TYPE_I8, TETCAST_TYPE_U16,
                                          TETCAST_TYPE_I16, TETCAST_TYPE_U32, TETCAST_TYPE_I32, TETCAST_TYPE_F16};
    tets t;
    tetcast_field f[18];
    unsigned char memory[9][27 * 11 + 16], cells[9][48 * 8];
    tetcast_mesh_desc d = defaults();
    tetcast_input in;
    tetcast_mesh *m = NULL;
    uint32_t i, k;
    memset(&t, 0, sizeof t);
    memset(f, 0, sizeof f);
    tets_lattice(&t, 3, 3, 3, 6, NULL);
    for (k = 0; k < 9; k++) {
        for (i = 0; i < 48; i++) {
            uint32_t v = i % 27, u32 = v;
            float f32 = (float)v;
            double f64 = v;
            uint16_t u16 = (uint16_t)v, half = 0, exponent = 0;
            unsigned char *p = memory[k] + 3 + 11 * v, *q;
            uint32_t part;
            while (v >> (exponent + 1) != 0) exponent++;
            half = v == 0 ? 0 : (uint16_t)((uint32_t)(exponent + 15) << 10 | (((uint32_t)v << (10 - exponent)) & 1023u));
            q = cells[k] + tetcasti_type_size(types[k]) * i;
            for (part = 0; part < 2; part++, p = q) {
                if (part == 0 && i >= 27) continue;
                switch (types[k]) {
                case TETCAST_TYPE_F32: memcpy(p, &f32, 4); break;
                case TETCAST_TYPE_F64: memcpy(p, &f64, 8); break;
                case TETCAST_TYPE_U8: case TETCAST_TYPE_I8: *p = (unsigned char)v; break;
                case TETCAST_TYPE_U16: case TETCAST_TYPE_I16: memcpy(p, &u16, 2); break;
                case TETCAST_TYPE_F16: memcpy(p, &half, 2); break;
                default: memcpy(p, &u32, 4); break;
                }
            }
        }
        f[k].values.data = memory[k] + 3;
        f[k].values.type = f[k + 9].values.type = types[k];
        f[k].values.stride = 11;
        f[k + 9].values.data = cells[k];
        f[k + 9].per_cell = 1;
        f[k].name = k == 4 ? "temperature" : NULL;
    }
    memset(&in, 0, sizeof in);
    in.positions.data = t.p;
    in.positions.type = TETCAST_TYPE_F64;
    in.vertex_count = t.nv;
    in.indices = t.t;
    in.index_count = 4 * t.nt;
    in.cell_count = t.nt;
    in.fields = f;
    in.field_count = 18;
    CHECK_EQ_U64(tetcast_mesh_create(&d, &in, NULL, &m), TETCAST_OK);
    REQUIRE(m != NULL);
    for (k = 0; k < 18; k++) {
        float lo = 0, hi = 0;
        uint32_t wrong = 0;
        CHECK_EQ_U64(tetcast_mesh_set_field(m, k), TETCAST_OK);
        CHECK(tetcast_mesh_field(m, k, &lo, &hi) != NULL);
        CHECK(lo == 0 && hi == 26);
        if (k < 9) for (i = 0; i < m->vertex_count; i++) wrong |= m->vertex[i].s != (float)m->source_vertex[i];
        else for (i = 0; i < m->cell_count; i++) wrong |= m->cell_value[i] != (float)(m->source_cell[i] % 27);
        CHECK_MSG(!wrong, "field %u", k);
    }
    CHECK_EQ_U64(tetcast_mesh_find_field(m, "temperature"), 4);
    CHECK_EQ_U64(tetcast_mesh_find_field(m, "pressure"), TETCAST_NONE);
    CHECK_EQ_U64(tetcast_mesh_set_field(m, 18), TETCAST_ERR_RANGE);
    CHECK(tetcast_mesh_field(m, 18, NULL, NULL) == NULL);
    tetcast_mesh_destroy(m);
    tets_free(&t);
    {
        static const uint16_t half[7] = {0x0001, 0x03ff, 0x7bff, 0x8001, 0xfbff, 0x3c00, 0x3555};
        static const double want[7] = {5.9604644775390625e-8, 6.0975551605224609e-5, 65504, -5.9604644775390625e-8, -65504, 1, 0.333251953125};
        for (i = 0; i < 7; i++) CHECK(tetcasti_half(half[i]) == want[i]);
        CHECK(tetcasti_half(0x7c00) == (double)INFINITY && !(tetcasti_half(0x7c01) == tetcasti_half(0x7c01)));
    }
}

TEST(bad_values) { /* NaN hides the cells around, with per-vertex and per-cell values */
    uint32_t per_cell;
    for (per_cell = 0; per_cell < 2; per_cell++) {
        tets t;
        tetcast_field f;
        tetcast_input in;
        tetcast_mesh_desc d = defaults();
        tetcast_report r;
        tetcast_mesh *m = NULL;
        double value[400];
        uint32_t i, j, wrong = 0, hidden = 0;
        float lo = 0, hi = 0;
        memset(&t, 0, sizeof t);
        memset(&in, 0, sizeof in);
        memset(&f, 0, sizeof f);
        tets_lattice(&t, 5, 4, 4, 6, NULL);
        for (i = 0; i < 400; i++) value[i] = i == 31 ? (double)NAN : i == 45 ? (double)INFINITY : i == 50 ? -(double)INFINITY : (double)i;
        f.values.data = value;
        f.values.type = TETCAST_TYPE_F64;
        f.per_cell = per_cell;
        in.positions.data = t.p;
        in.positions.type = TETCAST_TYPE_F64;
        in.vertex_count = t.nv;
        in.indices = t.t;
        in.index_count = 4 * t.nt;
        in.cell_count = t.nt;
        in.fields = &f;
        in.field_count = 1;
        CHECK_EQ_U64(tetcast_mesh_create(&d, &in, &r, &m), TETCAST_OK);
        REQUIRE(m != NULL);
        CHECK_EQ_U64(r.bad_values, 3);
        CHECK_EQ_U64(r.first_bad_value, 31);
        CHECK(tetcast_mesh_field(m, 0, &lo, &hi) != NULL && lo == 0 && hi == (per_cell ? 215 : 79));
        REQUIRE(m->hidden != NULL);
        for (i = 0; i < m->cell_count; i++) {
            uint32_t bad = 0;
            for (j = 0; j < 4; j++) {
                uint32_t v = per_cell ? m->source_cell[i] : m->source_vertex[m->tet[i][j]];
                bad |= v == 31 || v == 45 || v == 50;
            }
            wrong |= (uint32_t)tetcasti_bit(m->hidden, i) != bad;
            hidden += bad;
        }
        CHECK(!wrong && hidden >= 3);
        for (i = 0; i < m->vertex_count; i++) wrong |= !(m->vertex[i].s == m->vertex[i].s);
        CHECK(!wrong);
        tetcast_mesh_destroy(m);
        { /* masked cells stay masked */
            uint8_t masks[512];
            REQUIRE(t.nt <= sizeof masks);
            for (i = 0; i < t.nt; i++) masks[i] = i % 3 == 0;
            in.masks = masks;
            CHECK_EQ_U64(tetcast_mesh_create(&d, &in, &r, &m), TETCAST_OK);
            REQUIRE(m != NULL && m->hidden != NULL);
            CHECK(r.masked > 0 && r.bad_values == 3);
            for (hidden = 0, i = 0; i < m->cell_count; i++) {
                wrong |= masks[m->source_cell[i]] != 0 && !tetcasti_bit(m->hidden, i);
                hidden += (uint32_t)tetcasti_bit(m->hidden, i);
            }
            CHECK(!wrong && hidden > r.masked);
            tetcast_mesh_destroy(m);
            in.masks = NULL;
        }
        d.strict = 1;
        CHECK_EQ_U64(tetcast_mesh_create(&d, &in, &r, &m), TETCAST_ERR_FORMAT);
        tets_free(&t);
    }
}

TEST(values_beyond) { /* finite: they are as 1e38 */
    static const float position[4][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    static const uint32_t index[4] = {0, 1, 2, 3};
    static const double wide[] = {3.40282347e38, 3.4028234e38, 1e39, 1e308, -1e39, -1.7e308, 1e38};
    uint32_t i, type;
    for (type = 0; type < 2; type++)
        for (i = 0; i < 7; i++) {
            float value[4] = {1, 1, 1, 1}, lo = 0, hi = 0;
            double values[4] = {1, 1, 1, 1};
            tetcast_field f;
            tetcast_input in;
            tetcast_mesh_desc d = defaults();
            tetcast_report r;
            tetcast_mesh *m = NULL;
            memset(&f, 0, sizeof f);
            memset(&in, 0, sizeof in);
            if (type == 0 && fabs(wide[i]) > 3.41e38) continue;
            values[2] = wide[i];
            value[2] = (float)(type == 0 ? wide[i] : 0.0);
            if (type == 0) f.values.data = value;
            else f.values.data = values;
            f.values.type = type == 0 ? TETCAST_TYPE_F32 : TETCAST_TYPE_F64;
            in.positions.data = position;
            in.vertex_count = 4;
            in.indices = index;
            in.index_count = 4;
            in.cell_count = 1;
            in.fields = &f;
            in.field_count = 1;
            d.strict = 1;
            CHECK_EQ_U64(tetcast_mesh_create(&d, &in, &r, &m), TETCAST_OK);
            REQUIRE(m != NULL);
            CHECK_EQ_U64(r.bad_values, 0);
            CHECK(tetcast_mesh_field(m, 0, &lo, &hi) != NULL && m->hidden == NULL);
            CHECK(wide[i] > 0 ? lo == 1.0f && hi == 1e38f : lo == -1e38f && hi == 1.0f);
            tetcast_mesh_destroy(m);
        }
}

/* ---- arguments, memory, threads ---- */

TEST(arguments) {
    tets t;
    tetcast_input in;
    tetcast_mesh_desc d = defaults();
    tetcast_mesh *m = (tetcast_mesh *)&t;
    tetcast_report r;
    uint8_t shapes[2] = {TETCAST_SHAPE_TETRA, 5};
    memset(&t, 0, sizeof t);
    memset(&in, 0, sizeof in);
    tets_lattice(&t, 2, 2, 2, 5, NULL);
    CHECK_EQ_U64(tetcast_mesh_create(NULL, NULL, NULL, &m), TETCAST_ERR_INVALID_ARG);
    CHECK(m == NULL);
    CHECK_EQ_U64(tetcast_mesh_create(NULL, &in, NULL, NULL), TETCAST_ERR_INVALID_ARG);
    CHECK_EQ_U64(tetcast_mesh_create(NULL, &in, NULL, &m), TETCAST_ERR_EMPTY);
    in.vertex_count = t.nv;
    in.cell_count = t.nt;
    in.indices = t.t;
    in.index_count = 4 * t.nt;
    CHECK_EQ_U64(tetcast_mesh_create(NULL, &in, NULL, &m), TETCAST_ERR_INVALID_ARG); /* no positions */
    in.positions.data = t.p;
    in.positions.type = (tetcast_type)77;
    CHECK_EQ_U64(tetcast_mesh_create(NULL, &in, NULL, &m), TETCAST_ERR_INVALID_ARG);
    in.positions.type = TETCAST_TYPE_F64;
    d._end_zero = 1;
    CHECK_EQ_U64(tetcast_mesh_create(&d, &in, NULL, &m), TETCAST_ERR_UNINIT_DESC);
    d = defaults();
    d.cells = TETCAST_CELLS_COUNT;
    CHECK_EQ_U64(tetcast_mesh_create(&d, &in, NULL, &m), TETCAST_ERR_INVALID_ARG);
    in.index_count--;
    CHECK_EQ_U64(tetcast_mesh_create(NULL, &in, NULL, &m), TETCAST_ERR_TRUNCATED);
    in.index_count++;
    in.cell_count = (size_t)TETCAST_MAX_CELLS + 1;
    CHECK_EQ_U64(tetcast_mesh_create(NULL, &in, NULL, &m), TETCAST_ERR_RANGE);
    in.cell_count = 2;
    in.shapes = shapes;
    CHECK_EQ_U64(tetcast_mesh_create(NULL, &in, &r, &m), TETCAST_OK); /* the rest of the list cannot be read */
    CHECK_EQ_U64(r.bad_shapes, 1);
    CHECK_EQ_U64(r.cells, 1);
    tetcast_mesh_destroy(m);
    d = defaults();
    d.strict = 1;
    CHECK_EQ_U64(tetcast_mesh_create(&d, &in, &r, &m), TETCAST_ERR_FORMAT);
    shapes[0] = 0;
    CHECK_EQ_U64(tetcast_mesh_create(NULL, &in, &r, &m), TETCAST_ERR_EMPTY);
    tetcast_mesh_destroy(NULL);
    tetcast_mesh_get_info(NULL, NULL);
    tets_free(&t);
}

static tetcast_result build_for(const tets *t, const tetcast_mesh_desc *d, tetcast_mesh **m) {
    tetcast_input in;
    tetcast_field f[2];
    memset(&in, 0, sizeof in);
    memset(f, 0, sizeof f);
    in.positions.data = t->p;
    in.positions.type = TETCAST_TYPE_F64;
    in.vertex_count = t->nv;
    in.indices = t->t;
    in.index_count = 4 * t->nt;
    in.cell_count = t->nt;
    f[0].values.data = t->s;
    f[1].values.data = t->p;
    f[1].values.stride = 24;
    f[1].values.type = TETCAST_TYPE_F64;
    in.fields = f;
    in.field_count = 2;
    return tetcast_mesh_create(d, &in, NULL, m);
}

TEST(memory) { /* every allocation fails once; nothing leaks, and less is never enough */
    tets t;
    int64_t k;
    tetcast_cells cells;
    memset(&t, 0, sizeof t);
    tets_lattice(&t, 6, 5, 5, 5, NULL);
    tets_jitter(&t, 6, 5, 5, 1.2, 4);         /* inverted cells: orientation is settled */
    tets_tet(&t, t.t[0], t.t[1], t.t[2], t.t[3]); /* and one that is there twice */
    t.s[3] = NAN;
    for (cells = TETCAST_CELLS_TET16; cells <= TETCAST_CELLS_TET8; cells = (tetcast_cells)(cells + 1))
        for (k = 0;; k++) {
            test_alloc ta;
            tetcast_mesh_desc d = defaults();
            tetcast_mesh *m = NULL;
            tetcast_result r;
            test_alloc_init(&ta);
            ta.fail_at = k;
            d.env.allocator.alloc_fn = test_alloc_fn;
            d.env.allocator.free_fn = test_free_fn;
            d.env.allocator.user = &ta;
            d.cells = cells;
            d.weld = 1;
            r = build_for(&t, &d, &m);
            if (r == TETCAST_OK) {
                CHECK(k > 20);
                ta.fail_at = -1;
                CHECK_EQ_U64(tetcast_mesh_make_gradients(m, NULL), TETCAST_OK);
                tetcast_mesh_destroy(m);
                test_alloc_check(&ta);
                break;
            }
            CHECK_EQ_U64(r, TETCAST_ERR_NO_MEMORY);
            CHECK(m == NULL);
            test_alloc_check(&ta);
        }
    tets_free(&t);
}

TEST(memory_limit) {
    tets t;
    tetcast_mesh_desc d = defaults();
    tetcast_mesh *m = NULL;
    memset(&t, 0, sizeof t);
    tets_lattice(&t, 12, 12, 12, 6, NULL);
    d.env.memory_limit = 300000;
    CHECK_EQ_U64(build_for(&t, &d, &m), TETCAST_ERR_NO_MEMORY);
    d.env.memory_limit = 20000000;
    CHECK_EQ_U64(build_for(&t, &d, &m), TETCAST_OK);
    tetcast_mesh_destroy(m);
    tets_free(&t);
}

static int cancel_at(void *user, uint64_t done, uint64_t total) {
    (void)total;
    return done == *(uint64_t *)user;
}

static void serial_for(tetcast_task_fn *task, void *ctx, uint32_t count, void *user) {
    uint32_t i;
    *(uint32_t *)user += 1;
    for (i = count; i > 0; i--) task(ctx, i - 1);
}

TEST(threads) { /* the same mesh from any number of threads and from the host's tasks, last one first */
    tets t;
    uint64_t hash[6], k, calls = 0;
    uint32_t n = test_quick() ? 10 : 22, host = 0;
    memset(&t, 0, sizeof t);
    tets_lattice(&t, n, n, n, 5, NULL);
    tets_jitter(&t, n, n, n, 0.9, 8);
    tets_shuffle(&t, 8);
    for (k = 0; k < 6; k++) {
        static const uint32_t count[6] = {1, 2, 3, 7, 16, 1};
        tetcast_mesh_desc d = defaults();
        tetcast_mesh *m = NULL;
        d.env.thread_count = count[k];
        if (k == 5) {
            d.env.parallel.for_fn = serial_for;
            d.env.parallel.user = &host;
        }
        d.cells = (tetcast_cells)(0);
        CHECK_EQ_U64(build_for(&t, &d, &m), TETCAST_OK);
        REQUIRE(m != NULL);
        hash[k] = test_fnv1a(m->tet, m->cell_count * sizeof *m->tet, 0);
        hash[k] = test_fnv1a(m->neighbour, m->cell_count * sizeof *m->neighbour, hash[k]);
        hash[k] = test_fnv1a(m->vertex, m->vertex_count * sizeof *m->vertex, hash[k]);
        hash[k] = test_fnv1a(m->cells.data, m->cells.data_bytes, hash[k]);
        hash[k] = test_fnv1a(m->face, m->face_count * sizeof *m->face, hash[k]);
        hash[k] = test_fnv1a(m->source_cell, m->cell_count * sizeof *m->source_cell, hash[k]);
        if (k == 0) check_mesh(m, 1);
        tetcast_mesh_destroy(m);
        CHECK_EQ_U64(hash[k], hash[0]);
    }
    CHECK(host > 5);
    for (calls = 1; calls < 7; calls++) {
        tetcast_mesh_desc d = defaults();
        tetcast_mesh *m = NULL;
        tetcast_result r;
        d.env.progress_fn = cancel_at;
        d.env.progress_user = &calls;
        r = build_for(&t, &d, &m);
        CHECK_EQ_U64(r, calls < 6 ? TETCAST_ERR_CANCELLED : TETCAST_OK);
        CHECK((m != NULL) == (calls == 6));
        tetcast_mesh_destroy(m);
    }
    tets_free(&t);
}

/* ---- places ---- */

TEST(far_and_large) { /* offsets and sizes: the same mesh in local coordinates where the numbers are exact */
    static const double size[8] = {1, 8.4703294725430034e-22, 1.2676506002282294e30, 1, 1e-20, 1e30, 1e-6, 3e7};
    static const double place[8] = {0, 0, 0, 1e6, 0, 0, 1e-3, -4e12};
    uint64_t hash = 0;
    uint32_t k;
    for (k = 0; k < 8; k++) {
        tets t;
        tetcast_mesh_desc d = defaults();
        tetcast_mesh *m;
        double scale[3], offset[3];
        uint32_t i;
        memset(&t, 0, sizeof t);
        tets_lattice(&t, 9, 9, 9, 6, NULL);
        for (i = 0; i < 3; i++) {
            scale[i] = size[k];
            offset[i] = place[k];
        }
        tets_place(&t, scale, offset);
        m = tets_build_desc(&t, &d, NULL);
        REQUIRE(m != NULL);
        if (k == 0) hash = test_fnv1a(m->tet, m->cell_count * sizeof *m->tet, 0);
        if (k < 4) CHECK_EQ_U64(test_fnv1a(m->tet, m->cell_count * sizeof *m->tet, 0), hash);
        for (i = 0; i < 3; i++) {
            float side = m->box.hi[i] - m->box.lo[i];
            CHECK(side >= 536870912.0f * 0.9999f && side < 1073741824.0f * 1.0001f);
        }
        for (i = 0; i < m->vertex_count; i++) {
            double p[3];
            uint32_t v, a;
            tetcast_mesh_vertex(m, i, p, NULL, &v);
            for (a = 0; a < 3; a++) CHECK(fabs(p[a] - t.p[3 * v + a]) <= 8 * size[k] * 6e-8 + fabs(place[k]) * 2.3e-16);
        }
        tetcast_mesh_destroy(m);
        tets_free(&t);
    }
}

TEST(random_bits) { /* any numbers as positions and indices */
    uint32_t k;
    for (k = 0; k < 200; k++) {
        test_rng rng = test_rng_make(k);
        float p[60];
        uint32_t index[160], i;
        tetcast_input in;
        tetcast_mesh_desc d = defaults();
        tetcast_mesh *m = NULL;
        tetcast_report r;
        tetcast_check c;
        tetcast_result result;
        memset(&in, 0, sizeof in);
        for (i = 0; i < 60; i++) p[i] = k & 1 ? test_rng_bits(&rng) : test_rng_range(&rng, 0, 4);
        for (i = 0; i < 160; i++) index[i] = test_rng_below(&rng, k & 2 ? 22u : 20u);
        in.positions.data = p;
        in.vertex_count = 20;
        in.indices = index;
        in.index_count = 160;
        in.cell_count = 40;
        d.weld = k >> 2 & 1u;
        d.order = (tetcast_order)(k % 3);
        result = tetcast_mesh_create(&d, &in, &r, &m);
        CHECK(result == TETCAST_OK || result == TETCAST_ERR_EMPTY);
        CHECK_EQ_U64(r.cells + r.bad_indices + r.bad_positions + r.repeated + r.duplicates, result == TETCAST_OK ? 40 : r.bad_indices + r.bad_positions +
                     r.repeated);
        if (m != NULL) {
            check_mesh(m, 0);
            CHECK_EQ_U64(tetcast_mesh_check(m, NULL, &c), TETCAST_OK);
        }
        tetcast_mesh_destroy(m);
    }
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(counts);
    RUN(neighbours);
    RUN(other_orientation);
    RUN(source_numbers);
    RUN(hull_faces);
    RUN(exact_volume);
    RUN(mixed_shapes);
    RUN(hexahedron_all_numberings);
    RUN(degenerate_shapes);
    RUN(grids);
    RUN(hexahedra_converge);
    RUN(grid_blanks);
    RUN(bad_cells);
    RUN(duplicates_at_crowded_faces);
    RUN(nonmanifold);
    RUN(hanging_nodes);
    RUN(welded_blocks);
    RUN(flat_cells);
    RUN(value_types);
    RUN(bad_values);
    RUN(values_beyond);
    RUN(arguments);
    RUN(memory);
    RUN(memory_limit);
    RUN(threads);
    RUN(far_and_large);
    RUN(random_bits);
    return test_end();
}
