/* bench_tets.h - meshes, fields, transfer functions and the acceptance table of bench_tetcast.c - MIT OR Unlicense, see
   LICENSE. Include after bench.h, tets.h of the tests and tetcast.h. */
#ifndef BENCH_TETS_H_INCLUDED
#define BENCH_TETS_H_INCLUDED

static bench_options g_opt;
static double g_busy_sum, g_busy_count; /* wall over CPU seconds of one-thread runs */

static void die(const char *what, const char *why) {
    fprintf(stderr, "bench_tetcast: %s: %s\n", what, why);
    exit(1);
}
static void must(tetcast_result r, const char *what) {
    if (r != TETCAST_OK) die(what, tetcast_result_string(r));
}
static void *must_alloc(size_t n, size_t size) {
    void *p = calloc(n != 0 ? n : 1, size);
    if (p == NULL) die("benchmark", "out of memory");
    return p;
}

/* ---- the field: shells and swirls in the unit cube, 0 to 1 ---- */

static float field(const double *q) {
    const float x = (float)q[0] - 0.5f, y = (float)q[1] - 0.5f, z = (float)q[2] - 0.5f;
    const float r = sqrtf(x * x + y * y + z * z);
    const float s = 0.5f + 0.25f * sinf(18.0f * r) + 0.25f * sinf(9.0f * x + 4.0f * sinf(6.0f * y)) * cosf(8.0f * z);
    return s < 0.0f ? 0.0f : s > 1.0f ? 1.0f : s;
}

static void to_unit_cube(tets *m, double cubes) { /* a lattice of whole numbers */
    size_t i;
    for (i = 0; i < 3 * m->nv; i++) m->p[i] = (double)(float)(m->p[i] / cubes);
    for (i = 0; i < m->nv; i++) m->s[i] = field(m->p + 3 * i);
}

/* ---- Delaunay tetrahedra of random points ---- */

typedef struct delaunay {
    tets *m;
    uint32_t (*cell)[4], (*near)[4]; /* neighbour i is opposite to vertex i */
    uint32_t *mark, *free_list, *cavity;
    size_t count, room, free_count, cavity_count;
    uint32_t stamp, last;
} delaunay;

static double orient(const double *a, const double *b, const double *c, const double *d) {
    const double x0 = b[0] - a[0], y0 = b[1] - a[1], z0 = b[2] - a[2], x1 = c[0] - a[0], y1 = c[1] - a[1];
    const double z1 = c[2] - a[2], x2 = d[0] - a[0], y2 = d[1] - a[1], z2 = d[2] - a[2];
    return x0 * (y1 * z2 - z1 * y2) - y0 * (x1 * z2 - z1 * x2) + z0 * (x1 * y2 - y1 * x2);
}

/* > 0: e lies in the sphere through a cell of positive volume. Where rounding decides: not inside. */
static int in_sphere(const tets *m, const uint32_t v[4], const double *e) {
    double q[4][4], det = 0, all = 0;
    uint32_t i, k;
    for (i = 0; i < 4; i++) {
        for (k = 0; k < 3; k++) q[i][k] = m->p[3 * v[i] + k] - e[k];
        q[i][3] = q[i][0] * q[i][0] + q[i][1] * q[i][1] + q[i][2] * q[i][2];
    }
    for (i = 0; i < 4; i++) {
        const double *a = q[(i + 1) & 3], *b = q[(i + 2) & 3], *c = q[(i + 3) & 3];
        const double minor = a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) +
                             a[2] * (b[0] * c[1] - b[1] * c[0]);
        det += (i & 1 ? -1.0 : 1.0) * q[i][3] * minor;
        all += q[i][3] * fabs(minor);
    }
    return det > 1e-13 * all;
}

static const double *at_vertex(const delaunay *d, uint32_t v) { return d->m->p + 3 * (size_t)v; }

/* Twice the volume between face i of a cell and p, > 0 on the side of the cell. */
static double face_side(const delaunay *d, uint32_t cell, uint32_t i, const double *p) {
    const double *q[4];
    uint32_t k;
    for (k = 0; k < 4; k++) q[k] = k == i ? p : at_vertex(d, d->cell[cell][k]);
    return orient(q[0], q[1], q[2], q[3]);
}

static uint32_t new_cell(delaunay *d) {
    if (d->free_count != 0) return d->free_list[--d->free_count];
    if (d->count == d->room) {
        d->room = 2 * d->room + 1024;
        d->cell = (uint32_t(*)[4])realloc(d->cell, d->room * sizeof *d->cell);
        d->near = (uint32_t(*)[4])realloc(d->near, d->room * sizeof *d->near);
        d->mark = (uint32_t *)realloc(d->mark, d->room * sizeof *d->mark);
        d->free_list = (uint32_t *)realloc(d->free_list, d->room * sizeof *d->free_list);
        d->cavity = (uint32_t *)realloc(d->cavity, d->room * sizeof *d->cavity);
        if (!d->cell || !d->near || !d->mark || !d->free_list || !d->cavity) die("benchmark", "out of memory");
    }
    d->mark[d->count] = 0;
    return (uint32_t)d->count++;
}

static void cavity_add(delaunay *d, uint32_t cell) {
    d->mark[cell] = d->stamp;
    d->cavity[d->cavity_count++] = cell;
}

typedef struct rim { uint32_t a, b, cell, face; } rim; /* an edge of the cavity's hull waits for its second face */
enum { RIMS = 4096 };

static void link_rim(delaunay *d, rim *table, uint32_t a, uint32_t b, uint32_t cell, uint32_t face) {
    uint32_t lo = a < b ? a : b, hi = a < b ? b : a, h = (lo * 2654435761u ^ hi * 40503u) >> 7 & (RIMS - 1);
    for (; table[h].cell != TETCAST_NONE; h = (h + 1) & (RIMS - 1)) {
        if (table[h].a != lo || table[h].b != hi) continue;
        d->near[cell][face] = table[h].cell;
        d->near[table[h].cell][table[h].face] = cell;
        return;
    }
    table[h].a = lo;
    table[h].b = hi;
    table[h].cell = cell;
    table[h].face = face;
}

/* Bowyer and Watson: cells whose sphere holds the point make room for cells between their hull and the point. A point
   that lies too near to a plane to tell its side is left out. */
static int insert_point(delaunay *d, uint32_t vertex) {
    static rim table[RIMS];
    const double *p = at_vertex(d, vertex);
    uint32_t cell = d->last, i, k, walked = 0;
    size_t n, from, made;
    for (i = 0; i < 4; i++) { /* to the cell that holds it */
        const uint32_t face = (i + walked) & 3u;
        if (!(face_side(d, cell, face, p) < 0)) continue;
        cell = d->near[cell][face];
        if (cell == TETCAST_NONE || ++walked > 1000000u) return 0;
        i = (uint32_t)-1;
    }
    d->stamp++;
    d->cavity_count = 0;
    cavity_add(d, cell);
    for (n = 0; n < d->cavity_count; n++) {
        for (i = 0; i < 4; i++) {
            const uint32_t to = d->near[d->cavity[n]][i];
            if (to != TETCAST_NONE && d->mark[to] != d->stamp && in_sphere(d->m, d->cell[to], p)) cavity_add(d, to);
        }
    }
    for (n = 0; n < d->cavity_count; n++) { /* all of its hull has to be seen from the point */
        for (i = 0; i < 4; i++) {
            const uint32_t to = d->near[d->cavity[n]][i];
            if (to != TETCAST_NONE && d->mark[to] == d->stamp) continue;
            if (face_side(d, d->cavity[n], i, p) > 1e-14) continue;
            if (to == TETCAST_NONE) return 0;
            cavity_add(d, to);
            n = (size_t)-1;
            break;
        }
    }
    memset(table, 0xff, sizeof table);
    from = d->cavity_count;
    for (n = 0, made = 0; n < from; n++) {
        for (i = 0; i < 4; i++) {
            const uint32_t old = d->cavity[n], to = d->near[old][i];
            uint32_t fresh;
            if (to != TETCAST_NONE && d->mark[to] == d->stamp) continue;
            if (++made > RIMS / 4) die("Delaunay", "a cavity is too large");
            fresh = new_cell(d);
            memcpy(d->cell[fresh], d->cell[old], sizeof d->cell[fresh]);
            d->cell[fresh][i] = vertex;
            d->near[fresh][i] = to;
            for (k = 0; k < 4 && to != TETCAST_NONE; k++) if (d->near[to][k] == old) d->near[to][k] = fresh;
            for (k = 0; k < 4; k++) {
                uint32_t e[2], j, c = 0;
                if (k == i) continue;
                for (j = 0; j < 4; j++) if (j != i && j != k) e[c++] = d->cell[fresh][j];
                link_rim(d, table, e[0], e[1], fresh, k);
            }
            d->last = fresh;
        }
    }
    for (n = 0; n < from; n++) {
        d->free_list[d->free_count++] = d->cavity[n];
        d->mark[d->cavity[n]] = 0;
        d->cell[d->cavity[n]][0] = TETCAST_NONE;
    }
    return 1;
}

static uint64_t spread3(uint32_t v) { /* bits 0..20 to every third place */
    uint64_t x = v;
    x = (x | x << 32) & UINT64_C(0x1f00000000ffff);
    x = (x | x << 16) & UINT64_C(0x1f0000ff0000ff);
    x = (x | x << 8) & UINT64_C(0x100f00f00f00f00f);
    x = (x | x << 4) & UINT64_C(0x10c30c30c30c30c3);
    return (x | x << 2) & UINT64_C(0x1249249249249249);
}
typedef struct keyed { uint64_t key; double p[3]; } keyed;
static int by_key(const void *a, const void *b) {
    const uint64_t x = ((const keyed *)a)->key, y = ((const keyed *)b)->key;
    return (x > y) - (x < y);
}

/* `points` random points in the unit cube and its eight corners. */
static void make_delaunay(tets *m, uint32_t points) {
    static const uint8_t path[6][2] = {{1, 3}, {1, 5}, {2, 3}, {2, 6}, {4, 5}, {4, 6}};
    bench_rng r;
    delaunay d;
    keyed *list = (keyed *)must_alloc(points, sizeof *list);
    uint32_t i, k, j;
    size_t n;
    memset(&d, 0, sizeof d);
    r.state = 1;
    d.m = m;
    for (i = 0; i < 8; i++) tets_vertex(m, i & 1, i >> 1 & 1, i >> 2, 0);
    for (i = 0; i < 6; i++) {
        const uint32_t c = new_cell(&d), v[4] = {0, path[i][0], path[i][1], 7};
        memcpy(d.cell[c], v, sizeof v);
        for (k = 0; k < 4; k++) d.near[c][k] = TETCAST_NONE;
        if (orient(at_vertex(&d, v[0]), at_vertex(&d, v[1]), at_vertex(&d, v[2]), at_vertex(&d, v[3])) < 0) {
            d.cell[c][2] = v[1];
            d.cell[c][1] = v[2];
        }
    }
    for (i = 0; i < 6; i++)
        for (j = 0; j < 6; j++)
            for (k = 0; k < 4 && i != j; k++) { /* the face of i without its vertex k is one of j: all but one in j */
                uint32_t a, b, shared = 0;
                for (a = 0; a < 4; a++)
                    for (b = 0; b < 4; b++) shared += a != k && d.cell[i][a] == d.cell[j][b];
                if (shared == 3) d.near[i][k] = j;
            }
    for (i = 0; i < points; i++) {
        for (k = 0; k < 3; k++) list[i].p[k] = (double)bench_random(&r);
        for (k = 0; k < 3; k++) list[i].key |= spread3((uint32_t)(list[i].p[k] * 2097152.0)) << k;
    }
    qsort(list, points, sizeof *list, by_key);
    for (i = 0; i < points; i++) {
        const uint32_t v = tets_vertex(m, list[i].p[0], list[i].p[1], list[i].p[2], 0);
        if (!insert_point(&d, v)) m->nv--;
    }
    for (n = 0; n < d.count; n++) {
        if (d.cell[n][0] != TETCAST_NONE) tets_tet(m, d.cell[n][0], d.cell[n][1], d.cell[n][2], d.cell[n][3]);
    }
    for (n = 0; n < m->nv; n++) m->s[n] = field(m->p + 3 * n);
    tets_shuffle(m, 5);
    free(list);
    free(d.cell);
    free(d.near);
    free(d.mark);
    free(d.free_list);
    free(d.cavity);
}

/* ---- meshes by name ---- */

enum { MESH_K32, MESH_K55, MESH_D31K, MESH_D150K, MESH_L32, MESH_L128, MESH_BLUNT, MESH_SPX, MESH_COUNT };

typedef struct slot {
    tets t;              /* what the mesh was made of; nothing for a grid */
    tetcast_mesh *mesh;
    int missing;
} slot;
static slot g_slots[MESH_COUNT];
static const char *const g_mesh_name[MESH_COUNT] = {"K32", "K55", "D31k", "D150k", "L32", "L128", "bluntfin", "spx"};

static void make_kuhn(tets *m, uint32_t n) {
    tets_lattice(m, n + 1, n + 1, n + 1, 6, NULL);
    to_unit_cube(m, (double)n);
}

/* A file of the data folder: its cells as tetrahedra, or a grid that goes straight into `mesh`. 1: not there. */
static int read_volume(slot *s, const char *file, const char *name) {
    char path[1024];
    sup_volume v;
    sup_error err;
    tetcast_field f;
    size_t i, k;
    snprintf(path, sizeof path, "%s/tets/%s", g_opt.data, file);
    if (sup_volume_read(path, &v, &err)) return 1;
    memset(&f, 0, sizeof f);
    for (i = 0; i < v.field_count; i++) {
        if (name != NULL && strcmp(v.fields[i].name, name) != 0) continue;
        f.values.data = v.fields[i].values;
        f.values.stride = v.fields[i].components * sizeof(float);
        f.per_cell = (uint32_t)v.fields[i].per_cell;
        break;
    }
    if (f.values.data == NULL) die(path, "no such field");
    f.name = "s";
    if (v.dims[0] != 0) {
        tetcast_grid g;
        memset(&g, 0, sizeof g);
        memcpy(g.dims, v.dims, sizeof g.dims);
        g.positions.data = v.points;
        g.positions.type = TETCAST_TYPE_F64;
        g.blanks = v.blanks;
        g.fields = &f;
        g.field_count = 1;
        must(tetcast_mesh_create_grid(NULL, &g, NULL, &s->mesh), path);
    } else {
        for (i = 0; i < v.point_count; i++)
            tets_vertex(&s->t, v.points[3 * i], v.points[3 * i + 1], v.points[3 * i + 2], (double)v.fields[0].values[i]);
        for (i = 0, k = 0; i < v.cell_count; k += sup_shape_corners(v.shapes[i]), i++) {
            if (v.shapes[i] != SUP_TETRA) die(path, "not only tetrahedra");
            tets_tet(&s->t, v.indices[k], v.indices[k + 1], v.indices[k + 2], v.indices[k + 3]);
        }
    }
    sup_volume_free(&v);
    return 0;
}

static tetcast_mesh *build_mesh(const tets *t, const tetcast_mesh_desc *d) {
    tetcast_input in;
    tetcast_field f;
    tetcast_mesh *mesh = NULL;
    memset(&in, 0, sizeof in);
    memset(&f, 0, sizeof f);
    in.positions.data = t->p;
    in.positions.type = TETCAST_TYPE_F64;
    in.vertex_count = t->nv;
    in.indices = t->t;
    in.index_count = 4 * t->nt;
    in.cell_count = t->nt;
    f.name = "s";
    f.values.data = t->s;
    in.fields = &f;
    in.field_count = 1;
    must(tetcast_mesh_create(d, &in, NULL, &mesh), "mesh");
    return mesh;
}

static const tets *get_tets(int id) { /* NULL: the file is not there */
    slot *s = &g_slots[id];
    if (s->t.nt != 0 || s->missing) return s->missing ? NULL : &s->t;
    switch (id) {
    case MESH_K32: make_kuhn(&s->t, 32); break;
    case MESH_K55: make_kuhn(&s->t, 55); break;
    case MESH_D150K: make_delaunay(&s->t, 150000); break;
    case MESH_L32: tets_lattice(&s->t, 32, 32, 32, 5, NULL); to_unit_cube(&s->t, 31.0); break;
    case MESH_L128: tets_lattice(&s->t, 128, 128, 128, 5, NULL); to_unit_cube(&s->t, 127.0); break;
    case MESH_D31K: s->missing = read_volume(s, "delaunay_208k.vtk", NULL); break;
    case MESH_SPX: s->missing = read_volume(s, "spx.inp", NULL); break;
    default: die("benchmark", "no such mesh");
    }
    return s->missing ? NULL : &s->t;
}

static const tetcast_mesh *get_mesh(int id) { /* NULL: the file is not there */
    slot *s = &g_slots[id];
    if (s->mesh != NULL || s->missing) return s->mesh;
    if (id == MESH_BLUNT) s->missing = read_volume(s, "bluntfinxyz.bin", "density");
    else if (get_tets(id) != NULL) s->mesh = build_mesh(&s->t, NULL);
    return s->mesh;
}

static void drop_mesh(int id) {
    tetcast_mesh_destroy(g_slots[id].mesh);
    tets_free(&g_slots[id].t);
    g_slots[id].mesh = NULL;
}

/* ---- transfer functions: values 0 to 1, extinction per edge of the unit cube ---- */

enum { TF_SMOOTH, TF_PEAK, TF_STEP, TF_FULL, TF_TABLE, TF_COUNT };
enum { TF_POINTS = 5, TF_MOST = 256 };
static const char *const g_tf_name[TF_COUNT] = {"smooth", "peak", "step", "full", "table"};
static const tetcast_control_point g_tf_short[TF_TABLE][TF_POINTS] = {
    /* the peers': empty on 40 % of the range */
    {{0, {0, 0, 1}, 0}, {0.4f, {0, 0.8f, 0.2f}, 0}, {0.5f, {0, 1, 0}, 4}, {0.6f, {0.2f, 0.8f, 0}, 0.2f}, {1, {1, 0, 0}, 1.5f}},
    {{0, {0, 0.2f, 1}, 0}, {0.48f, {0.5f, 0.6f, 1}, 0}, {0.5f, {1, 0.5f, 0.1f}, 60}, {0.52f, {0.2f, 1, 0.1f}, 0}, {1, {1, 0, 0}, 0}},
    {{0, {0.1f, 0.3f, 0.9f}, 0.2f}, {0.5f, {0.1f, 0.3f, 0.9f}, 0.2f}, {0.5f, {0.9f, 0.4f, 0.1f}, 8}, {0.8f, {0.9f, 0.4f, 0.1f}, 8},
     {0.8f, {0.2f, 0.9f, 0.2f}, 1}},
    /* the smooth one, with next to nothing where that is empty */
    {{0, {0, 0, 1}, 0.001f}, {0.4f, {0, 0.8f, 0.2f}, 0.001f}, {0.5f, {0, 1, 0}, 4}, {0.6f, {0.2f, 0.8f, 0}, 0.2f},
     {1, {1, 0, 0}, 1.5f}}};

/* The points of a function. The table has 256, as picture editors and other programs make them. */
static const tetcast_control_point *tf_points(int tf, size_t *count) {
    static tetcast_control_point table[TF_MOST];
    int i, k;
    *count = TF_POINTS;
    if (tf != TF_TABLE) return g_tf_short[tf];
    *count = TF_MOST;
    for (i = 0; i < TF_MOST && table[TF_MOST - 1].value == 0; i++) {
        const float x = (float)i / (TF_MOST - 1), a = (x - 0.78f) / 0.08f, b = (x - 0.5f) / 0.06f;
        table[i].value = x;
        table[i].extinction = 25 * expf(-a * a) + 4 * expf(-b * b) + 0.3f * x * x;
        for (k = 0; k < 3; k++) table[i].rgb[k] = 0.5f + 0.5f * cosf(6.2832f * (x - 0.33f * (float)k - 0.2f));
    }
    return table;
}

/* The vertices of a mesh as sites, with the colours that the smooth function has there; for the caller to free. */
static tetcast_site *tet_sites(const tets *t) {
    size_t n, i, k;
    const tetcast_control_point *p = tf_points(TF_SMOOTH, &n);
    tetcast_site *s = (tetcast_site *)must_alloc(t->nv, sizeof *s);
    for (i = 0; i < t->nv; i++) {
        double v[4];
        oracle_eval(p, n, (double)t->s[i], 1, v);
        for (k = 0; k < 3; k++) {
            s[i].position[k] = t->p[3 * i + k];
            s[i].rgb[k] = (float)v[k];
        }
        s[i].extinction = (float)v[3];
    }
    return s;
}

/* The largest error of a colour in a picture of a foam, of each pixel of a grid `every` wide. */
static double foam_error(const tetcast_foam *foam, const tetcast_site *sites, size_t count, const tetcast_camera *camera, const float *rgba,
                         uint32_t size, uint32_t every) {
    tetcast_foam_info info;
    double most = 0;
    uint32_t x, y, k;
    tetcast_foam_get_info(foam, &info);
    for (y = every / 2; y < size; y += every)
        for (x = every / 2; x < size; x += every) {
            tetcast_ray ray;
            foam_ray m;
            must(tetcast_camera_ray(camera, size, size, x + 0.5, y + 0.5, &ray), "camera");
            m = foam_march(sites, (uint32_t)count, &info, &ray);
            for (k = 0; k < 3; k++) most = fmax(most, fabs(m.rgb[k] - (double)rgba[4 * ((size_t)y * size + x) + k]));
        }
    return most;
}

/* The function over the range of another field and with a unit of length of its own. */
static tetcast_transfer *make_transfer_range(int tf, float lo, float hi, double per_length, const tetcast_isovalue *iso,
                                             size_t iso_count) {
    tetcast_control_point p[TF_MOST];
    tetcast_transfer_desc d;
    tetcast_transfer *t = NULL;
    size_t n, i;
    const tetcast_control_point *from = tf_points(tf, &n);
    memcpy(p, from, n * sizeof *p);
    for (i = 0; i < n; i++) {
        p[i].value = lo + (hi - lo) * p[i].value;
        p[i].extinction = (float)((double)p[i].extinction * per_length);
    }
    memset(&d, 0, sizeof d);
    d.points = p;
    d.point_count = n;
    d.isovalues = iso;
    d.isovalue_count = iso_count;
    must(tetcast_transfer_create(&d, &t), "transfer function");
    return t;
}

static tetcast_optics *make_optics_range(int tf, float lo, float hi, double per_length, const tetcast_optics_desc *d,
                                         const tetcast_isovalue *iso, size_t iso_count) {
    tetcast_transfer *t = make_transfer_range(tf, lo, hi, per_length, iso, iso_count);
    tetcast_optics *o = NULL;
    must(tetcast_optics_create(t, d, &o), "optics");
    tetcast_transfer_destroy(t);
    return o;
}

static tetcast_optics *make_optics(int tf, const tetcast_optics_desc *d) {
    return make_optics_range(tf, 0, 1, 1, d, NULL, 0);
}

/* ---- the acceptance table ---- */

static bench_row g_rows[] = {
    {"frame-K32", "frame, K32 (196,608 tetrahedra)", "s", "0.10", "0.045", ""},
    {"frame-D31k", "frame, D31k (207,788)", "s", "0.18", "0.10", ""},
    {"frame-D150k", "frame, D150k (10^6 Delaunay)", "s", "0.5", "0.22", ""},
    {"frame-K55", "frame, K55 (998,250)", "s", "", "", ""},
    {"walk-L32", "traversal only, 148,955 tetrahedra", "M steps/s", "120", "225", ""},
    {"walk-L128", "traversal only, 10,241,915 tetrahedra", "M steps/s", "80", "150", ""},
    {"empty-D31k", "transfer function empty on 40 % of the range, D31k (K32)", "times as fast", "1.5", "3", ""},
    {"psnr", "picture against the reference (K32, D31k: least)", "dB", "45", "60", ""},
    {"seams", "the same: pixels off by more than 1/255", "pixels", "0", "0", ""},
    {"error-smooth", "largest colour error, exact, smooth transfer function", "", "1e-5", "1e-6", ""},
    {"error-peak", "the same, peaked transfer function", "", "1e-4", "1e-5", ""},
    {"error-smooth-segment", "the same of single segments, smooth / peaked", "", "1e-5 / 1e-4", "1e-6 / 1e-5", ""},
    {"project", "projection, emission, 10,241,915 tetrahedra (K55, K32)", "M tetrahedra/s", "8", "15", ""},
    {"bytes", "Tet8, D150k: connectivity / all that rays need, everything included", "bytes/tetrahedron", "10 / 16",
     "8.6 / 12", ""},
    {"bytes-more", "all bytes with clusters / with the tets / with both and sources; the default (Tet16 and all of it)",
     "bytes/tetrahedron", "", "", ""},
    {"strips", "sequential strips, bytes of the list's indices, thesis' sphere (thesis 63.4 %)", "%", "63.4", "50", ""},
    {"iso-K32", "first isosurface hit, K32", "M rays/s", "1.5", "5", ""},
    {"iso-D31k", "first isosurface hit, D31k", "M rays/s", "0.8", "2.5", ""},
    {"contour", "isosurface mesh, vertices merged, K55 (D150k)", "M tetrahedra/s", "40", "120", ""},
    {"import", "import and adjacency, 10^6 tetrahedra, D150k (K55)", "s", "0.25", "0.08", ""},
    {"failed", "rays whose way through the mesh is not the exact one", "rays", "0", "0", ""},
    {"tolerance", "tolerance 8/255 against exact, D31k: times as fast (largest error, 1/255)", "", "", "", ""},
    {"edit", "change of the transfer function, exact (full 3D table of 128^2 x 64)", "ms", "", "", ""},
    {"rbf_direct", "functions: evaluations, direct", "G/s", "2.5", "4", ""},
    {"rbf_rays", "functions: evaluations along rays", "G/s", "6", "12", ""},
    {"rbf_frames", "1,173 functions, 400x400, 64 samples; the thesis 44 (error)", "frames/s (1/255)", "30", "80", ""},
    {"rbf_fit", "Tornado 32^3 at mean 1.82 %, max 6.82 %; the thesis 64.5 kB (mean, max)", "kB", "32 in 2 s", "20", ""},
    {"resample", "resample Blunt fin to 512x256x128 (thesis 1670)", "ms", "120", "50", ""},
    {"resample-512", "resample D31k to 512^3 (thesis, 121,668 tetrahedra, 20,900)", "ms", "600", "250", ""},
    {"brick-samples", "trilinear samples of bricks, f32", "M/s", "250", "600", ""},
    {"borders", "levels by distance and borders of 257^3 (bricks adapted; thesis 200)", "ms", "5", "1", ""},
    {"bricks-full", "frame, bricks of 257^3", "ms", "120", "50", ""},
    {"bricks-half", "the same, half the bytes by level of detail", "ms", "40", "15", ""},
    {"foam", "frame, cells of 150,000 points (made in, seconds)", "M cells/s", "", "100", ""},
    {"codec", "colour cells of 512x512, encode / decode (thesis 14.2 / 5.3)", "ms", "0.8 / 0.05", "0.3 / 0.03", ""}
};

static bench_table g_table = {g_rows, sizeof g_rows / sizeof g_rows[0],
                              "512x512 pixels, one core by CPU time, the default instruction set", "table_tetcast.md"};
#define table_set(...) bench_table_set(&g_table, __VA_ARGS__)

#endif
