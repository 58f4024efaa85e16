/* test_volume.c - volume readers, transfer functions and generated volumes of examples/support */
#include "support_memory.h"
#include "../examples/support/transfer.h"
#include "../examples/support/volume_scenes.h"

/* ---- files made here ---------------------------------------------------------------------------------------- */

typedef struct file_text {
    char data[16384];
    size_t size;
} file_text;

static void put(file_text *f, const char *format, ...) TEST_PRINTF(2, 3);
static void put(file_text *f, const char *format, ...) {
    va_list args;
    va_start(args, format);
    f->size += (size_t)vsnprintf(f->data + f->size, sizeof f->data - f->size, format, args);
    va_end(args);
}
static void put_bits(file_text *f, uint64_t bits, int bytes, int big) {
    int i;
    for (i = 0; i < bytes; i++) f->data[f->size++] = (char)(bits >> 8 * (big ? bytes - 1 - i : i));
}
static void put_f32(file_text *f, float x, int big) {
    uint32_t bits;
    memcpy(&bits, &x, 4);
    put_bits(f, bits, 4, big);
}
static void put_f64(file_text *f, double x, int big) {
    uint64_t bits;
    memcpy(&bits, &x, 8);
    put_bits(f, bits, 8, big);
}

/* Two tetrahedra, a triangle, a pyramid, a wedge, a hexahedron over 12 points: what all formats are asked for. */
enum { POINTS = 12, CELLS = 6, KEPT = 5 };
static const int g_type[CELLS] = {10, 10, 5, 14, 13, 12};
static const int g_corners[CELLS] = {4, 4, 3, 5, 6, 8};
static const int g_corner[CELLS][8] = {{0, 1, 2, 3},    {1, 2, 3, 4},       {0, 1, 2},
                                       {4, 5, 6, 7, 8}, {0, 1, 2, 9, 10, 11}, {0, 1, 2, 3, 4, 5, 6, 7}};
static double point(int i, int k) { return (double)((i * 7 + k * 5) % 11) * 0.25 - (double)k; }
static double value(int i) { return (double)(i * i) * 0.5 - 3.0; }
static double cell_value(int i) { return 100.0 - (double)i; }

/* The volume is that one; with cells in the given order of kinds. */
static void check_standard(const sup_volume *v, int has_cell_values) {
    int i, k, c = 0;
    size_t at = 0;
    REQUIRE(v->point_count == POINTS && v->cell_count == KEPT && v->shapes && v->indices);
    for (i = 0; i < POINTS; i++)
        for (k = 0; k < 3; k++) CHECK_NEAR(v->points[3 * i + k], point(i, k), 1e-12);
    for (i = 0; i < CELLS; i++) {
        if (g_type[i] == 5) continue;
        CHECK(v->shapes[c++] == g_type[i]);
        for (k = 0; k < g_corners[i]; k++) CHECK_EQ_U64(v->indices[at++], g_corner[i][k]);
    }
    CHECK(at == v->index_count && v->skipped_cells == 1);
    REQUIRE(v->field_count >= 1 && v->fields[0].count == POINTS);
    for (i = 0; i < POINTS; i++) CHECK_NEAR(v->fields[0].values[i], value(i), 1e-6);
    if (has_cell_values) {
        const sup_field *f = v->fields + v->field_count - 1;
        REQUIRE(f->per_cell && f->count == KEPT && f->components == 1);
        for (i = c = 0; i < CELLS; i++)
            if (g_type[i] != 5) CHECK_NEAR(f->values[c++], cell_value(i), 1e-6);
    }
}

static void put_vtk_number(file_text *f, int binary, const char *type, double x) {
    if (!binary) put(f, strcmp(type, "float") == 0 || strcmp(type, "double") == 0 ? "%.17g " : "%.0f ", x);
    else if (strcmp(type, "float") == 0) put_f32(f, (float)x, 1);
    else if (strcmp(type, "double") == 0) put_f64(f, x, 1);
    else if (strcmp(type, "vtktypeint64") == 0) put_bits(f, (uint64_t)(int64_t)x, 8, 1);
    else if (strcmp(type, "short") == 0) put_bits(f, (uint64_t)(int64_t)x, 2, 1);
    else put_bits(f, (uint64_t)(int64_t)x, 4, 1);
}

static void make_vtk(file_text *f, const char *version, int binary) {
    const int offsets = version[0] >= '5';
    int i, k, total = 0, at = 0;
    f->size = 0;
    for (i = 0; i < CELLS; i++) total += g_corners[i];
    put(f, "# vtk DataFile Version %s\na title\n%s\nDATASET UNSTRUCTURED_GRID\n", version, binary ? "BINARY" : "ASCII");
    put(f, "POINTS %d double\n", (int)POINTS);
    for (i = 0; i < POINTS; i++)
        for (k = 0; k < 3; k++) put_vtk_number(f, binary, "double", point(i, k));
    if (offsets) {
        put(f, "\nMETADATA\nINFORMATION 0\n\nCELLS %d %d\nOFFSETS vtktypeint64\n", (int)CELLS + 1, total);
        for (i = 0; i <= CELLS; i++) {
            put_vtk_number(f, binary, "vtktypeint64", (double)at);
            if (i < CELLS) at += g_corners[i];
        }
        put(f, "\nCONNECTIVITY vtktypeint64\n");
        for (i = 0; i < CELLS; i++)
            for (k = 0; k < g_corners[i]; k++) put_vtk_number(f, binary, "vtktypeint64", (double)g_corner[i][k]);
    } else {
        put(f, "\nCELLS %d %d\n", (int)CELLS, total + (int)CELLS);
        for (i = 0; i < CELLS; i++) {
            put_vtk_number(f, binary, "int", (double)g_corners[i]);
            for (k = 0; k < g_corners[i]; k++) put_vtk_number(f, binary, "int", (double)g_corner[i][k]);
        }
    }
    put(f, "\nCELL_TYPES %d\n", (int)CELLS);
    for (i = 0; i < CELLS; i++) put_vtk_number(f, binary, "int", (double)g_type[i]);
    put(f, "\nPOINT_DATA %d\nSCALARS my%%20field float 1\nLOOKUP_TABLE default\n", (int)POINTS);
    for (i = 0; i < POINTS; i++) put_vtk_number(f, binary, "float", value(i));
    put(f, "\nVECTORS wind float\n");
    for (i = 0; i < 3 * POINTS; i++) put_vtk_number(f, binary, "float", (double)i);
    put(f, "\nFIELD extra 1\nstuff 2 %d short\n", (int)POINTS);
    for (i = 0; i < 2 * POINTS; i++) put_vtk_number(f, binary, "short", (double)(-i));
    put(f, "\nCELL_DATA %d\nSCALARS heat double\nLOOKUP_TABLE default\n", (int)CELLS);
    for (i = 0; i < CELLS; i++) put_vtk_number(f, binary, "double", cell_value(i));
    put(f, "\n");
}

static int read_text(const file_text *f, const char *name, sup_volume *v, sup_error *err) {
    return sup_volume_read_memory(f->data, f->size, name, NULL, NULL, v, err);
}

TEST(vtk_cells) {
    static const char *const versions[] = {"1.0", "2.0", "3.0", "4.2", "5.1"};
    static file_text f;
    size_t i;
    for (i = 0; i < 10; i++) {
        sup_volume v;
        sup_error err;
        make_vtk(&f, versions[i / 2], (int)(i % 2));
        CHECK_MSG(read_text(&f, "a.vtk", &v, &err) == 0, "version %s: %s", versions[i / 2], err.text);
        check_standard(&v, 1);
        if (v.field_count == 4) {
            CHECK_STR(v.fields[0].name, "my field");
            CHECK(v.fields[1].components == 3 && v.fields[1].values[5] == 5.0f);
            CHECK(v.fields[2].components == 2 && v.fields[2].values[7] == -7.0f);
        } else CHECK(0);
        sup_volume_free(&v);
    }
    CHECK(g_memory.live == 0);
}

TEST(vtk_attributes) { /* all of them, the ones that are passed over as well: what follows is found */
    static const struct {
        const char *head, *type, *name; /* name NULL: no field */
        int numbers, components;
    } part[] = {{"SCALARS a float 2\nLOOKUP_TABLE own", "float", "a", 8, 2}, {"LOOKUP_TABLE own 2", "char", NULL, 8, 0},
                {"VECTORS b double", "double", "b", 12, 3},                 {"NORMALS c float", "float", "c", 12, 3},
                {"TENSORS d float", "float", "d", 36, 9},                   {"TEXTURE_COORDINATES e 2 float", "float", "e", 8, 2},
                {"GLOBAL_IDS f vtktypeint64", "vtktypeint64", "f", 4, 1},   {"FIELD more 2\ng 1 4 int", "int", "g", 4, 1},
                {"METADATA\nINFORMATION 0\n\nh 3 4 short", "short", "h", 12, 3},
                {"METADATA\nCOMPONENT_NAMES\nx\n\nSCALARS i int", "int", "i", 4, 1}};
    static file_text f;
    int binary, i, k, fields;
    for (binary = 0; binary < 2; binary++) {
        sup_volume v;
        sup_error err;
        f.size = 0;
        put(&f, "# vtk DataFile Version 3.0\nt\n%s\nDATASET STRUCTURED_POINTS\nDIMENSIONS 2 2 1\nPOINT_DATA 4\n", binary ? "BINARY" : "ASCII");
        for (i = 0; i < 10; i++) {
            put(&f, "%s\n", part[i].head);
            for (k = 0; k < part[i].numbers; k++) {
                if (binary && strcmp(part[i].type, "char") == 0) put_bits(&f, (uint64_t)k, 1, 1);
                else put_vtk_number(&f, binary, part[i].type, (double)(100 * i + k));
            }
            put(&f, "\n");
        }
        CHECK_MSG(!read_text(&f, "a.vtk", &v, &err), "%s", err.text);
        CHECK(v.field_count == 9);
        for (i = fields = 0; i < 10; i++) {
            const sup_field *field = v.fields + fields;
            if (part[i].name == NULL || (size_t)fields >= v.field_count) continue;
            fields++;
            CHECK_STR(field->name, part[i].name);
            REQUIRE(field->components == (uint32_t)part[i].components && field->count == 4 && !field->per_cell);
            for (k = 0; k < part[i].numbers; k++) CHECK_NEAR(field->values[k], 100 * i + k, 0);
        }
        sup_volume_free(&v);
    }
    CHECK(g_memory.live == 0);
}

TEST(vtk_grids) {
    static file_text f;
    sup_volume v;
    sup_error err;
    int i, kind;
    for (kind = 0; kind < 3; kind++) {
        f.size = 0;
        put(&f, "# vtk DataFile Version 3.0\n\nASCII\r\nDATASET %s\r\nDIMENSIONS 3 2 2\r\n",
            kind == 0 ? "STRUCTURED_POINTS" : kind == 1 ? "RECTILINEAR_GRID" : "STRUCTURED_GRID");
        if (kind == 0) put(&f, "ASPECT_RATIO 1 2 3\nORIGIN -1 -2 -3\n");
        if (kind == 1) put(&f, "X_COORDINATES 3 float\n0 1 4\nY_COORDINATES 2 float\n0 1\nZ_COORDINATES 2 float\n5 6\n");
        if (kind == 2) {
            put(&f, "POINTS 12 float\n");
            for (i = 0; i < 36; i++) put(&f, "%d ", i);
        }
        put(&f, "\nCELL_DATA 2\nSCALARS c int\nLOOKUP_TABLE default\n8 9\nPOINT_DATA 12\nCOLOR_SCALARS rgb 1\n");
        for (i = 0; i < 12; i++) put(&f, "0.%d\n", i % 10);
        CHECK_MSG(read_text(&f, "g.vtk", &v, &err) == 0, "%s", err.text);
        CHECK(v.dims[0] == 3 && v.dims[1] == 2 && v.dims[2] == 2 && v.point_count == 12 && v.field_count == 2);
        if (kind == 0) CHECK(v.spacing[1] == 2.0 && v.origin[2] == -3.0 && v.points == NULL);
        if (kind == 1) CHECK(v.axes[0] != NULL && v.axes[0][2] == 4.0 && v.axes[2][1] == 6.0);
        if (kind == 2) CHECK(v.points != NULL && v.points[35] == 35.0);
        sup_volume_free(&v);
    }
    CHECK(g_memory.live == 0);
}

static void make_ucd(file_text *f) {
    static const char *const names[CELLS] = {"tet", "tet", "tri", "pyr", "prism", "hex"};
    int i, k;
    f->size = 0;
    put(f, "# written here\n%d %d 1 1 0\n", (int)POINTS, (int)CELLS);
    for (i = 0; i < POINTS; i++) put(f, "%d %g %g %g\n", 10 * i + 3, point(i, 0), point(i, 1), point(i, 2));
    for (i = 0; i < CELLS; i++) {
        put(f, "%d 1 %s", i + 1, names[i]);
        for (k = 0; k < g_corners[i]; k++) /* pyramids begin with their top */
            put(f, " %d", 10 * g_corner[i][g_type[i] == 14 ? (k + 4) % 5 : k] + 3);
        put(f, "\n");
    }
    put(f, "1 1\ntemperature, K\n");
    for (i = POINTS - 1; i >= 0; i--) put(f, "%d %g\n", 10 * i + 3, value(i));
    put(f, "1 1\nheat, J\n");
    for (i = 0; i < CELLS; i++) put(f, "%d %g\n", i + 1, cell_value(i));
}

TEST(ucd) {
    static file_text f;
    sup_volume v;
    sup_error err;
    make_ucd(&f);
    CHECK_MSG(read_text(&f, "a.inp", &v, &err) == 0, "%s", err.text);
    check_standard(&v, 1);
    if (v.field_count) CHECK_STR(v.fields[0].name, "temperature");
    sup_volume_free(&v);
    /* two fields, a vector first, of points; names after blanks */
    f.size = 0;
    put(&f, "4 1 4 0 0\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n1 1 tet 1 2 3 4\n2 3 1\n  speed , m/s\n\theat,\n");
    put(&f, "1 1 2 3 4\n2 5 6 7 8\n3 9 10 11 12\n4 13 14 15 16\n");
    CHECK_MSG(read_text(&f, "a.inp", &v, &err) == 0, "%s", err.text);
    REQUIRE(v.field_count == 2 && v.fields[0].components == 3 && v.fields[1].components == 1);
    CHECK_STR(v.fields[0].name, "speed");
    CHECK_STR(v.fields[1].name, "heat");
    CHECK(v.fields[0].values[11] == 15.0f && v.fields[0].values[3] == 5.0f && v.fields[1].values[2] == 12.0f);
    sup_volume_free(&v);
    /* only of cells; of nothing */
    f.size = 0;
    put(&f, "4 1 0 2 0\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n1 1 tet 1 2 3 4\n2 1 1\na, m\nb, m\n1 8 9\n");
    CHECK_MSG(read_text(&f, "a.inp", &v, &err) == 0, "%s", err.text);
    REQUIRE(v.field_count == 2 && v.fields[0].per_cell && v.fields[1].per_cell);
    CHECK(v.fields[0].values[0] == 8.0f && v.fields[1].values[0] == 9.0f);
    sup_volume_free(&v);
    f.size = 0;
    put(&f, "4 1 0 0 0\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n1 1 tet 1 2 3 4\n");
    CHECK_MSG(read_text(&f, "a.inp", &v, &err) == 0, "%s", err.text);
    CHECK(v.field_count == 0 && v.cell_count == 1);
    sup_volume_free(&v);
}

static void make_gmsh(file_text *f, int version) {
    static const int kinds[CELLS] = {4, 4, 2, 7, 6, 5};
    int i, k;
    f->size = 0;
    put(f, "$MeshFormat\n%s 0 8\n$EndMeshFormat\n$PhysicalNames\n1\n3 1 \"all\"\n$EndPhysicalNames\n",
        version == 2 ? "2.2" : "4.1");
    if (version == 2) put(f, "$Nodes\n%d\n", (int)POINTS);
    else put(f, "$Nodes\n2 %d 1 400\n2 1 0 4\n", (int)POINTS);
    for (i = 0; version == 4 && i < 4; i++) put(f, "%d\n", 400 - 7 * i);
    for (i = 0; i < POINTS; i++) {
        if (version == 4 && i == 4) {
            put(f, "3 1 1 %d\n", (int)POINTS - 4);
            for (k = 4; k < POINTS; k++) put(f, "%d\n", 400 - 7 * k);
        }
        if (version == 2) put(f, "%d ", 400 - 7 * i);
        put(f, "%g %g %g%s\n", point(i, 0), point(i, 1), point(i, 2), version == 4 && i >= 4 ? " 0 0 0" : "");
    }
    put(f, "$EndNodes\n$Elements\n");
    if (version == 2) put(f, "%d\n", (int)CELLS);
    else put(f, "%d %d 1 %d\n", (int)CELLS, (int)CELLS, (int)CELLS);
    for (i = 0; i < CELLS; i++) {
        if (version == 2) put(f, "%d %d 2 1 1", i + 1, kinds[i]);
        else put(f, "3 1 %d 1\n%d", kinds[i], i + 1);
        for (k = 0; k < g_corners[i]; k++) put(f, " %d", 400 - 7 * g_corner[i][k]);
        put(f, "\n");
    }
    put(f, "$EndElements\n$NodeData\n1\n\"a view\"\n1\n0.0\n3\n0\n1\n%d\n", (int)POINTS);
    for (i = 0; i < POINTS; i++) put(f, "%d %g\n", 400 - 7 * i, value(i));
    put(f, "$EndNodeData\n$ElementData\n1\n\"cells\"\n0\n3\n0\n1\n%d\n", (int)CELLS);
    for (i = 0; i < CELLS; i++) put(f, "%d %g\n", i + 1, cell_value(i));
    put(f, "$EndElementData\n");
}

TEST(gmsh) {
    static file_text f;
    int version;
    for (version = 2; version <= 4; version += 2) {
        sup_volume v;
        sup_error err;
        make_gmsh(&f, version);
        CHECK_MSG(read_text(&f, "a.msh", &v, &err) == 0, "%s", err.text);
        check_standard(&v, 1);
        if (v.field_count) CHECK_STR(v.fields[0].name, "a view");
        sup_volume_free(&v);
    }
    f.size = 0; /* ten nodes: the straight tetrahedron of the first four */
    put(&f, "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n10\n");
    for (version = 1; version <= 10; version++) put(&f, "%d %d 0 0\n", version, version);
    put(&f, "$EndNodes\n$Elements\n1\n1 11 0 1 2 3 4 5 6 7 8 9 10\n$EndElements\n");
    {
        sup_volume v;
        sup_error err;
        CHECK(read_text(&f, "a.msh", &v, &err) == 0 && v.cell_count == 1 && v.index_count == 4 && v.straightened == 1);
        CHECK(strstr(err.text, "curved") != NULL);
        sup_volume_free(&v);
    }
}

/* Second files of the readers that need one. */
typedef struct other_file {
    const char *name;
    const file_text *text;
} other_file;
static int open_other(void *user, const char *name, char **data, size_t *size) {
    const other_file *o = (const other_file *)user;
    if (strcmp(name, o->name) != 0) return 1;
    *size = o->text->size;
    *data = (char *)sup_alloc(*size + 1, 1);
    if (!*data) return 1;
    memcpy(*data, o->text->data, *size);
    (*data)[*size] = '\0';
    return 0;
}

static void make_tetgen(file_text *node, file_text *ele, int first) {
    int i;
    node->size = ele->size = 0;
    put(node, "# nodes\n%d 3 1 1\n", (int)POINTS);
    for (i = 0; i < POINTS; i++)
        put(node, "%d %g %g %g %g 0 # here\n", first + i, point(i, 0), point(i, 1), point(i, 2), value(i));
    put(ele, "2 4 1\n1 %d %d %d %d 5\n2 %d %d %d %d 6\n", first, first + 1, first + 2, first + 3, first + 8, first + 9,
        first + 10, first + 11);
}

TEST(tetgen) {
    static file_text node, ele;
    int first, given;
    for (first = 0; first < 2; first++)
        for (given = 0; given < 2; given++) {
            other_file other;
            sup_volume v;
            sup_error err;
            const file_text *f = given ? &ele : &node;
            make_tetgen(&node, &ele, first);
            other.name = given ? "m.node" : "m.ele";
            other.text = given ? &node : &ele;
            CHECK_MSG(!sup_volume_read_memory(f->data, f->size, given ? "m.ele" : "m.node", open_other, &other, &v, &err),
                      "%s", err.text);
            CHECK(v.point_count == POINTS && v.cell_count == 2 && v.field_count == 2);
            if (v.field_count == 2) {
                CHECK(v.indices[0] == 0 && v.indices[7] == 11 && v.fields[0].values[3] == (float)value(3));
                CHECK(v.fields[1].per_cell && v.fields[1].values[1] == 6.0f);
            }
            sup_volume_free(&v);
            CHECK(sup_volume_read_memory(f->data, f->size, given ? "m.ele" : "m.node", NULL, NULL, &v, &err));
        }
    for (first = 0; first < 8; first++) {
        static const char *const text[8][3] = { /* .node, .ele, what is said */
            {"1 2 0 0\n1 0 0\n", "0 4 0\n", "m.node: line 1: points of three dimensions"},
            {"2 3 0 0\n1 0 0 0\n3 0 0 0\n", "0 4 0\n", "m.node: line 3: the points are not numbered one after"},
            {"1 3 0 0\n1 0 0\n", "0 4 0\n", "m.node: line 3: the file ends too early"},
            {"900 3 0 0\n1 0 0 0\n", "0 4 0\n", "m.node: line 1: more is announced"},
            {"1 3 0 0\n1 0 0 0\n", "1 5 0\n1 1 1 1 1 1\n", "m.ele: line 1: tetrahedra of 4 or 10 points"},
            {"1 3 0 0\n1 0 0 0\n", "1 4 0\n1 1 1 1 2\n", "m.ele: line 2: a cell has a point"},
            {"1 3 0 0\n1 0 0 0\n", "1 4 0\n1 1 0 1 1\n", "m.ele: line 2: a cell has a point"},
            {"1 3 0 0\n1 0 0 0\n", "9 4 0\n1 1 1 1 1\n", "m.ele: line 1: more is announced"}};
        static file_text f;
        other_file other;
        sup_volume v;
        sup_error err;
        f.size = 0;
        put(&f, "%s", text[first][1]);
        other.name = "m.ele";
        other.text = &f;
        CHECK(sup_volume_read_memory(text[first][0], strlen(text[first][0]), "m.node", open_other, &other, &v, &err));
        CHECK_MSG(strstr(err.text, text[first][2]) == err.text, "\"%s\" instead of \"%s\"", err.text, text[first][2]);
    }
    for (first = 0; first < 2; first++) { /* numbers at the ends of what a number can be */
        static const char *const text[2] = {"2 3 0 0\n9223372036854775807 0 0 0\n0 0 0 1\n",
                                            "2 3 0 0\n-9223372036854775808 0 0 0\n-9223372036854775807 0 0 1\n"};
        other_file other;
        sup_volume v;
        sup_error err;
        other.name = "m.ele";
        other.text = &ele;
        CHECK(sup_volume_read_memory(text[first], strlen(text[first]), "m.node", open_other, &other, &v, &err));
        CHECK(strstr(err.text, "numbered") != NULL);
    }
    CHECK(g_memory.live == 0);
}

/* layout: bit 0 little-endian, 1 eight bytes, 2 record marks, 3 several grids, 4 blanking; 5 blocks of 512 */
static void make_plot3d(file_text *f, int layout, int q) {
    static const uint32_t dims[2][3] = {{5, 6, 7}, {2, 2, 3}}; /* more than 512 bytes differ between layouts */
    const int big = !(layout & 1), wide = layout >> 1 & 1, marks = layout >> 2 & 1, several = layout >> 3 & 1;
    const int grids = several ? 2 : 1, blanks = !q && (layout >> 4 & 1);
    int g, k;
    uint32_t i;
    f->size = 0;
    if (several) {
        if (marks) put_bits(f, 4, 4, big);
        put_bits(f, 2, 4, big);
        if (marks) put_bits(f, 4, 4, big);
    }
    if (marks) put_bits(f, (uint64_t)(12 * grids), 4, big);
    for (g = 0; g < grids; g++)
        for (k = 0; k < 3; k++) put_bits(f, dims[g][k], 4, big);
    if (marks) put_bits(f, (uint64_t)(12 * grids), 4, big);
    for (g = 0; g < grids; g++) {
        const uint32_t n = dims[g][0] * dims[g][1] * dims[g][2], word = wide ? 8 : 4;
        const uint32_t bytes = q ? 5 * n * word : n * (3 * word + (blanks ? 4 : 0));
        if (q) {
            if (marks) put_bits(f, 4 * word, 4, big);
            for (k = 0; k < 4; k++) {
                if (wide) put_f64(f, 1.0, big);
                else put_f32(f, 1.0f, big);
            }
            if (marks) put_bits(f, 4 * word, 4, big);
        }
        if (marks) put_bits(f, bytes, 4, big);
        for (k = 0; k < (q ? 5 : 3); k++)
            for (i = 0; i < n; i++) {
                const double x = q ? 1.0 + (double)(100 * k) + (double)i : (double)(k * 50 + g * 1000) + (double)i;
                if (wide) put_f64(f, x, big);
                else put_f32(f, (float)x, big);
            }
        for (i = 0; blanks && i < n; i++) put_bits(f, i != 5, 4, big);
        if (marks) put_bits(f, bytes, 4, big);
    }
    while (layout >> 5 & 1 && f->size % 512 != 0) f->data[f->size++] = 0;
}

TEST(plot3d) {
    static file_text xyz, q;
    int layout;
    for (layout = 0; layout < 64; layout++) {
        const int several = layout >> 3 & 1;
        other_file other;
        sup_volume v;
        sup_error err;
        make_plot3d(&xyz, layout, 0);
        make_plot3d(&q, layout, 1);
        other.name = "flow/finq.bin";
        other.text = &q;
        CHECK_MSG(!sup_volume_read_memory(xyz.data, xyz.size, "flow/finxyz.bin", open_other, &other, &v, &err),
                  "layout %d: %s", layout, err.text);
        CHECK_EQ_U64(v.point_count, several ? 222 : 210);
        CHECK_MSG(v.field_count == 5, "layout %d: %s", layout, err.text);
        if (several) CHECK(v.cell_count == (layout & 16 ? 118u : 122u) && v.dims[0] == 0);
        else CHECK(v.dims[0] == 5 && v.dims[1] == 6 && v.dims[2] == 7);
        if (v.points) CHECK(v.points[3 * 7] == 7.0 && v.points[3 * 7 + 2] == 107.0);
        if (v.field_count == 5) {
            CHECK(v.fields[0].values[2] == 3.0f && v.fields[1].values[3 * 2 + 1] == 203.0f);
            CHECK_STR(v.fields[0].name, "density");
        }
        if (!several) CHECK((v.blanks != NULL) == (layout >> 4 & 1) && (!v.blanks || (!v.blanks[5] && v.blanks[6])));
        sup_volume_free(&v);
    }
    CHECK(g_memory.live == 0);
}

/* ---- damage ------------------------------------------------------------------------------------------------- */

static void make_any(int kind, file_text *f, file_text *second, other_file *other, const char **name) {
    static const char *const names[8] = {"a.vtk", "a.vtk", "a.vtk", "a.inp", "a.msh", "a.msh", "a.node", "axyz.bin"};
    *name = names[kind];
    second->size = 0;
    other->name = "";
    other->text = second;
    switch (kind) {
    case 0: make_vtk(f, "3.0", 0); break;
    case 1: make_vtk(f, "2.0", 1); break;
    case 2: make_vtk(f, "5.1", 1); break;
    case 3: make_ucd(f); break;
    case 4: make_gmsh(f, 2); break;
    case 5: make_gmsh(f, 4); break;
    case 6:
        make_tetgen(f, second, 1);
        other->name = "a.ele";
        break;
    default:
        make_plot3d(f, 16 + 8 + 4, 0);
        make_plot3d(second, 16 + 8 + 4, 1);
        other->name = "aq.bin";
        break;
    }
}

static void check_indices(const sup_volume *v) {
    size_t i, k, corners = 0;
    for (i = 0; i < v->index_count; i++)
        if (v->indices[i] >= v->point_count) CHECK(0);
    for (i = 0; i < v->cell_count; i++) corners += sup_shape_corners(v->shapes[i]);
    CHECK(corners == v->index_count);
    for (k = 0; k < v->field_count; k++)
        CHECK(v->dims[0] || v->fields[k].count == (v->fields[k].per_cell ? v->cell_count : v->point_count));
}

/* What is wrong with a file is said with its name and a place in it. PLOT3D says nothing about itself: only its size is
   wrong. */
static void check_place(const char *name, size_t size, const char *message) {
    static const char *const places[] = {": line ", ": byte ", ": cell ", "offset of cell ", "of this size", "is empty", "not a volume",
                                         "has no cells", "no $Nodes"};
    size_t i, n = strlen(name);
    int found = 0;
    while (n > 0 && name[n - 1] != '.') n--; /* a.ele for a.node */
    for (i = 0; i < sizeof places / sizeof places[0]; i++) found |= strstr(message, places[i]) != NULL;
    CHECK_MSG(found && strncmp(message, name, n) == 0, "%s, %lu bytes: \"%s\"", name, (unsigned long)size, message);
}

TEST(truncated) {
    static file_text f, second;
    int kind;
    for (kind = 0; kind < 8; kind++) {
        other_file other;
        const char *name;
        size_t size, step = test_quick() ? 7 : 1;
        make_any(kind, &f, &second, &other, &name);
        for (size = 0; size < f.size; size += step) {
            sup_volume v;
            sup_error err;
            char *exact = (char *)malloc(size ? size : 1); /* a sanitizer sees reading beyond it */
            memcpy(exact, f.data, size);
            if (sup_volume_read_memory(exact, size, name, open_other, &other, &v, &err)) check_place(name, size, err.text);
            else check_indices(&v);
            sup_volume_free(&v);
            free(exact);
        }
    }
    for (kind = 6; kind < 8; kind++) { /* the second file */
        other_file other;
        const char *name;
        size_t size;
        make_any(kind, &f, &second, &other, &name);
        for (size = second.size; size > 0;) {
            sup_volume v;
            sup_error err;
            second.size = size -= size < 7 ? 1 : 1 + size % 7;
            if (sup_volume_read_memory(f.data, f.size, name, open_other, &other, &v, &err)) check_place(name, size, err.text);
            else check_indices(&v);
            sup_volume_free(&v);
        }
    }
    CHECK(g_memory.live == 0);
}

TEST(bytes_changed) {
    static file_text f, second;
    test_rng rng = test_rng_make(5);
    int kind, k, rounds = test_quick() ? 300 : 4000;
    for (kind = 0; kind < 8; kind++)
        for (k = 0; k < rounds; k++) {
            other_file other;
            const char *name;
            sup_volume v;
            sup_error err;
            int n = 1 + (int)(test_rng_u32(&rng) % 4);
            make_any(kind, &f, &second, &other, &name);
            for (; n > 0; n--) {
                file_text *at = second.size && test_rng_u32(&rng) % 3 == 0 ? &second : &f;
                at->data[test_rng_u32(&rng) % at->size] =
                    test_rng_u32(&rng) % 2 ? (char)test_rng_u32(&rng) : "0123456789-. \n"[test_rng_u32(&rng) % 14];
            }
            g_memory.largest = 0;
            if (!sup_volume_read_memory(f.data, f.size, name, open_other, &other, &v, &err)) check_indices(&v);
            CHECK_MSG(g_memory.largest < 4u << 20, "%s: %lu bytes for a small file", name, (unsigned long)g_memory.largest);
            sup_volume_free(&v);
        }
    CHECK(g_memory.live == 0);
}

TEST(out_of_memory) {
    static file_text f, second;
    int kind;
    for (kind = 0; kind < 8; kind++) {
        other_file other;
        const char *name;
        int64_t n;
        make_any(kind, &f, &second, &other, &name);
        for (n = 0; n < 200; n++) {
            sup_volume v;
            sup_error err;
            int failed;
            g_memory.fail_at = n;
            g_memory.count = 0;
            failed = sup_volume_read_memory(f.data, f.size, name, open_other, &other, &v, &err);
            g_memory.fail_at = -1;
            sup_volume_free(&v);
            CHECK(g_memory.live == 0);
            if (!failed && g_memory.count <= n) break;
        }
        CHECK(n < 200);
    }
}

#define VTK_HEAD "# vtk DataFile Version 3.0\nt\nASCII\nDATASET UNSTRUCTURED_GRID\n"
#define VTK_GRID "# vtk DataFile Version 3.0\nt\nASCII\nDATASET STRUCTURED_GRID\n"
#define VTK_TETRA VTK_HEAD "POINTS 4 float\n0 0 0 1 0 0 0 1 0 0 0 1\n"
#define VTK_CELL "CELLS 1 5\n4 0 1 2 3\n"
#define VTK_LONG "1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1\n"
#define VTK_VALUES "POINT_DATA 4\nSCALARS s float\nLOOKUP_TABLE default\n1 2 3 4\n"

TEST(messages) {
    static const struct {
        const char *name, *text, *part;
    } bad[] = {{"a.vtk", "# vtk DataFile Version 3.0\nt\nASCII\nDATASET POLYDATA\n", "no volume"},
               {"a.vtk", "# vtk DataFile Version 3.0\nt\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 1 float\n0 0 x\n", "line 6"},
               {"a.vtk", "# vtk DataFile Version 3.0\nt\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 4 float\n0 0 0 1 0 0 0 1 0 0 0 "
                         "1\nCELLS 1 5\n4 0 1 2 4\nCELL_TYPES 1\n10\n", "cell 0 has a point"},
               {"a.vtk", "# vtk DataFile Version 3.0\nt\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 99999999 float\n0 0", "announced"},
               {"a.inp", "1 1 0 0 0\n1 0 0 0\n1 1 cube 1 1 1 1\n", "line 3"},
               {"a.inp", "1 1 0 0 0\n1 0 0 0\n1 1 tet 1 1 2 1\n", "does not exist"},
               {"a.msh", "$MeshFormat\n4.0 0 8\n$EndMeshFormat\n", "version"},
               {"a.msh", "$MeshFormat\n2.2 1 8\n$EndMeshFormat\n", "binary"},
               {"a.vtk", VTK_HEAD "POINTS 1 decimal\n0 0 0\n", "line 5: unknown type"},
               {"a.vtk", VTK_TETRA "CELLS 1 5\n4 0 1 2 3 9\nCELL_TYPES 1\n10\n", "unknown keyword"},
               {"a.vtk", VTK_TETRA "CELLS 1 4\n4 0 1 2\n", "shorter than its counts"},
               {"a.vtk", VTK_TETRA "CELLS 1 7\n4 0 1 2 3 0 1\n", "longer than its counts"},
               {"a.vtk", VTK_TETRA "CELLS 1 4\n3 0 1 2\nCELL_TYPES 1\n10\n", "cell 0 has 3 points"},
               {"a.vtk", VTK_TETRA "CELLS 1 6\n5 0 1 2 3 0\nCELL_TYPES 1\n10\n", "cell 0 has 5 points"},
               {"a.vtk", VTK_TETRA "CELLS 1 5\n4 0 1 -1 3\nCELL_TYPES 1\n10\n", "cell 0 has a point"},
               {"a.vtk", VTK_TETRA VTK_CELL "CELL_TYPES 2\n10 10\n", "does not fit to CELLS"},
               {"a.vtk", VTK_TETRA "CELLS 1 5\n4 0 1 2 3\n", "no cells"},
               {"a.vtk", VTK_TETRA VTK_CELL "CELL_TYPES 1\n10\nPOINT_DATA 3\nSCALARS s float\n", "line 11: values for another number"},
               {"a.vtk", VTK_TETRA VTK_CELL "CELL_TYPES 1\n10\nPOINT_DATA 4\nSCALARS s float 65\n", "1 to 64 components"},
               {"a.vtk", "# vtk DataFile Version 5.1\nt\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 4 float\n0 0 0 1 0 0 0 1 0 0 0 1\n"
                         "CELLS 2 4\nOFFSETS int\n0 5\nCONNECTIVITY int\n0 1 2 3\n", "offset of cell 0"},
               {"a.vtk", "# vtk DataFile Version 5.1\nt\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 4 float\n0 0 0 1 0 0 0 1 0 0 0 1\n"
                         "CELLS 3 4\nOFFSETS int\n0 4 3\nCONNECTIVITY int\n0 1 2 3\n", "offset of cell 1"},
               {"a.vtk", VTK_GRID "DIMENSIONS 0 2 2\n", "line 5: DIMENSIONS have to be positive"},
               {"a.vtk", VTK_GRID "DIMENSIONS 65536 65536 1\n", "more points than"},
               {"a.vtk", VTK_GRID "DIMENSIONS 2 2 2\nPOINTS 7 float\n", "does not fit to DIMENSIONS"},
               {"a.vtk", VTK_GRID "DIMENSIONS 2 2 2\nX_COORDINATES 3 float\n0 1 2\n", "do not fit to DIMENSIONS"},
               {"a.vtk", VTK_GRID "DIMENSIONS 2 2 2\nX_COORDINATES 2 float\n0 1\n", "axis are missing"},
               {"a.vtk", VTK_GRID, "no cells"},
               {"a.vtk", "# vtk DataFile Version 3.0\nt\nEBCDIC\nDATASET UNSTRUCTURED_GRID\n", "line 3: ASCII or BINARY"},
               {"a.vtk", "# vtk DataFile Version 3.0\nt\nASCII\nDATA UNSTRUCTURED_GRID\n", "line 4: DATASET was expected"},
               {"a.vtk", VTK_TETRA VTK_CELL "CELL_TYPES 1\n10\nPOINT_DATA 4\nFIELD f 1\ns 1 4 string\na\nb\nc\nd\n", "strings are not read"},
               {"a.vtk", VTK_TETRA VTK_CELL "CELL_TYPES 1\n10\nPOINT_DATA 4\nLOOKUP_TABLE t 20\n1 2 3 4 5 6 7 8 9 10 11\n", "LOOKUP_TABLE is cut off"},
               {"a.vtk", VTK_TETRA VTK_CELL "CELL_TYPES 1\n10\nPOINT_DATA 4\nCOLOR_SCALARS c 65\n" VTK_LONG, "1 to 64 components"},
               {"a.vtk", "# vtk DataFile Version 5.1\nt\nASCII\nDATASET UNSTRUCTURED_GRID\nCELLS 0 0\n", "offset of its end"},
               {"a.vtk", "# vtk DataFile Version 5.1\nt\nASCII\nDATASET UNSTRUCTURED_GRID\nCELLS 1 0\nOFFSET int\n0\n", "line 6: OFFSETS"},
               {"a.vtk", "# vtk DataFile Version 5.1\nt\nASCII\nDATASET UNSTRUCTURED_GRID\nCELLS 1 0\nOFFSETS int\n0\nCORNERS int\n", "line 8: CONNECTIVITY"},
               /* what comes first decides how much there has to be of what follows */
               {"a.vtk", VTK_TETRA VTK_CELL "CELL_TYPES 1\n10\n" VTK_VALUES "POINTS 5 float\n0 0 0 0 0 0 0 0 0 0 0 0 0 0 0\n", "before the values"},
               {"a.vtk", VTK_TETRA "POINTS 1 float\n0 0 0\n", "POINTS is there twice"},
               {"a.vtk", VTK_HEAD "POINT_DATA 0\nSCALARS s float\nLOOKUP_TABLE default\nPOINTS 1 float\n0 0 0\n", "before the values"},
               {"a.vtk", VTK_TETRA VTK_CELL "CELL_DATA 1\nSCALARS c float\nLOOKUP_TABLE default\n1\nCELL_TYPES 1\n10\n", "before the values"},
               {"a.vtk", VTK_TETRA "CELL_DATA 0\nSCALARS c float\nLOOKUP_TABLE default\n" VTK_CELL "CELL_TYPES 1\n10\n", "before the values"},
               {"a.vtk", VTK_TETRA VTK_CELL VTK_CELL, "CELLS is there twice"},
               {"a.vtk", VTK_TETRA VTK_CELL "CELL_TYPES 1\n10\nDIMENSIONS 9 9 9\n", "no place in this kind"},
               {"a.vtk", VTK_GRID "DIMENSIONS 2 2 2\nCELLS 1 5\n4 0 1 2 3\n", "no place in this kind"},
               {"a.vtk", VTK_GRID "DIMENSIONS 2 1 1\nPOINTS 2 float\n0 0 0 1 1 1\nDIMENSIONS 9 9 9\n", "DIMENSIONS is there twice"},
               {"a.vtk", VTK_GRID "POINTS 2 float\n0 0 0 1 1 1\nDIMENSIONS 9 9 9\n", "DIMENSIONS has to come first"},
               {"a.vtk", VTK_GRID "POINT_DATA 0\nSCALARS s float\nLOOKUP_TABLE default\nDIMENSIONS 1 1 1\n", "has to come first"},
               {"a.msh", "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$NodeData\n0\n0\n3\n0\n1\n0\n$EndNodeData\n", "before the values"},
               {"a.msh", "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n1\n1 0 0 0\n$EndNodes\n"
                         "$ElementData\n0\n0\n3\n0\n1\n0\n$EndElementData\n", "before the values"},
               {"a.msh", "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n2\n1 0 0 0\n1 0 0 0\n$EndNodes\n", "node 1 is there twice"},
               {"a.msh", "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n1\n1 0 0 0\n$EndNodes\n$Elements\n1\n1 4 0 1 1 1 2\n", "line 10: an element has"},
               {"a.msh", "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n1\n1 0 0 0\n$EndNodes\n$Elements\n1\n1 99 0\n", "unknown type of element"},
               {"a.msh", "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n0\n$EndNodes\n$Nodes\n", "$Nodes is there twice"},
               {"a.msh", "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n1\n1 0 0 0\n$EndNodes\n", "no $Elements"},
               {"a.inp", "2 0 0 0 0\n1 0 0 0\n1 0 0 0\n", "point 1 is there twice"},
               {"a.inp", "1 2 0 0 0\n1 0 0 0\n1 1 tet 1 1 1 1\n1 1 tet 1 1 1 1\n", "cell 1 is there twice"},
               {"a.inp", "1 1 1 0 0\n1 0 0 0\n1 1 tet 1 1 1 1\n1 1\ns, m\n2 0\n", "line 6: values of a point"},
               {"a.inp", "1 0 1 0 0\n1 0 0 0\n1 65\nsome, m\n" "1 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0\n", "1 to 64 components"},
               {"a.bin", "nothing of that kind", "PLOT3D"},
               {"a.xyz", "", "empty"},
               {"a.txt", "hello", "not a volume"}};
    size_t i;
    for (i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        sup_volume v;
        sup_error err;
        CHECK(sup_volume_read_memory(bad[i].text, strlen(bad[i].text), bad[i].name, NULL, NULL, &v, &err) == 1);
        CHECK_MSG(strstr(err.text, bad[i].part) != NULL, "\"%s\" does not say \"%s\"", err.text, bad[i].part);
    }
}

TEST(long_names) { /* 63 characters are kept */
    static file_text f;
    sup_volume v;
    sup_error err;
    size_t n;
    for (n = 62; n < 200; n = n < 65 ? n + 1 : n * 2) {
        char name[200];
        memset(name, 'n', n);
        name[n] = '\0';
        f.size = 0;
        put(&f, VTK_TETRA VTK_CELL "CELL_TYPES 1\n10\nPOINT_DATA 4\nSCALARS %s float\nLOOKUP_TABLE default\n1 2 3 4\n", name);
        CHECK_MSG(!read_text(&f, "a.vtk", &v, &err), "%s", err.text);
        REQUIRE(v.field_count == 1);
        CHECK_EQ_U64(strlen(v.fields[0].name), n < 63 ? n : 63);
        CHECK(v.fields[0].components == 1 && v.fields[0].values[3] == 4.0f);
        sup_volume_free(&v);
        f.size = 0;
        put(&f, "4 1 1 0 0\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n1 1 tet 1 2 3 4\n1 1\n%s, m\n1 1\n2 2\n3 3\n4 4\n", name);
        CHECK_MSG(!read_text(&f, "a.inp", &v, &err), "%s", err.text);
        REQUIRE(v.field_count == 1);
        CHECK_EQ_U64(strlen(v.fields[0].name), n < 63 ? n : 63);
        CHECK(v.fields[0].values[3] == 4.0f);
        sup_volume_free(&v);
    }
}

TEST(plot3d_marks) { /* each record has its length before and after it: neither may be wrong, in neither file */
    static file_text xyz, q;
    int big, which, wrong = 0;
    for (big = 0; big < 2; big++) {
        const size_t n = 5 * 6 * 7;
        const size_t at[2][6] = {{0, 16, 20, 24 + 12 * n, 0, 0}, {0, 16, 20, 40, 44, 48 + 20 * n}};
        for (which = 0; which < 10; which++) {
            const int of_q = which >= 4;
            other_file other;
            sup_volume v;
            sup_error err;
            make_plot3d(&xyz, 4 + !big, 0);
            make_plot3d(&q, 4 + !big, 1);
            other.name = "aq.bin";
            other.text = &q;
            (of_q ? &q : &xyz)->data[at[of_q][of_q ? which - 4 : which] + (big ? 3 : 0)]++;
            if (sup_volume_read_memory(xyz.data, xyz.size, "axyz.bin", open_other, &other, &v, &err)) {
                CHECK(!of_q && strstr(err.text, "no layout") != NULL);
                wrong++;
            } else {
                CHECK_MSG(of_q && v.field_count == 0 && strstr(err.text, "does not fit") != NULL, "mark %d, %s", which,
                          big ? "big" : "little");
            }
            sup_volume_free(&v);
        }
    }
    CHECK(wrong == 8);
}

/* ---- files of others ---------------------------------------------------------------------------------------- */

TEST(real_files) {
    static const struct {
        const char *name;
        size_t points, cells, fields;
        double lo, hi;
    } files[] = {{"tets/delaunay_208k.vtk", 31000, 207788, 1, 0.0007188, 0.998031},
                 {"tets/spx.inp", 2896, 12936, 1, 0.2, 1.0},
                 {"tets/bluntfinxyz.bin", 40960, 0, 5, 0.1926, 4.9775},
                 {"volumes/ironProt.vtk", 314432, 0, 1, 0.0, 255.0}};
    size_t i, k, seen = 0;
    for (i = 0; i < sizeof files / sizeof files[0]; i++) {
        const char *path = test_data_path(files[i].name);
        sup_volume v;
        sup_error err;
        float lo = 1e30f, hi = -1e30f;
        if (!path) continue;
        seen++;
        CHECK_MSG(!sup_volume_read(path, &v, &err), "%s", err.text);
        CHECK(v.point_count == files[i].points && v.cell_count == files[i].cells && v.field_count == files[i].fields);
        for (k = 0; v.field_count && k < v.fields[0].count; k++) {
            lo = v.fields[0].values[k] < lo ? v.fields[0].values[k] : lo;
            hi = v.fields[0].values[k] > hi ? v.fields[0].values[k] : hi;
        }
        CHECK_NEAR(lo, files[i].lo, 1e-5);
        CHECK_NEAR(hi, files[i].hi, 1e-4);
        sup_volume_free(&v);
    }
    if (!seen) SKIP("no test data");
}

/* ---- transfer functions, generated volumes ------------------------------------------------------------------ */

TEST(transfer_functions) {
    static const char good[] = "# a comment\n0 0 0 0 0 # the start\r\n\n 0.5 1 .5 0 1e1\n0.5 0 0 1 2\n1 1 1 1 0";
    static const char lists[] = "0 3\n1 0 1 0\n1 4 # thick\n2 0 0 1\n5 0\n";
    static const struct {
        const char *text, *part;
    } bad[] = {{"0 0 0\n", "line 1"}, {"0 0 0 0\n1 1 1 1\n", "no extinctions"}, {"0 1\n", "no colours"},
               {"0 0 0 0\n0 0 0 0 0\n", "do not go together"}, {"0 1\n0 0 0 0 0\n", "line 2"},
               {"0 0 0 0 0\n0 1\n", "together"}, {"0 1\n0 0 0 0\n-1 0\n", "line 3"}, {"1 0 0 0\n0 1\n0 0 0 0\n", "line 3"},
                    {"0 0 0 0 0\n1 0 0 0 -1\n", "negative"}, {"1 0 0 0 0\n0 0 0 0 0\n", "ascend"},
               {"0 0 0 0 0 0\n", "expected"}, {"", "no control point"},                 {"0 0 nan 0 0\n", "finite"},
               {"0 0 -1 0 0\n", "negative"},  {"0 0 x 0 0\n", "number"}};
    sup_transfer t;
    sup_error err;
    size_t i;
    CHECK(!sup_transfer_read_memory(good, sizeof good - 1, "tf", &t, &err));
    CHECK(t.count == 4 && t.colors == 0 && t.points[1].extinction == 10.0f && t.points[2].value == 0.5f && t.points[2].rgb[2] == 1.0f);
    sup_transfer_free(&t);
    CHECK(!sup_transfer_read_memory(lists, sizeof lists - 1, "tf", &t, &err)); /* colours go before extinctions */
    CHECK(t.count == 5 && t.colors == 2 && t.points[0].rgb[1] == 1.0f && t.points[1].value == 2.0f);
    CHECK(t.points[2].value == 0.0f && t.points[2].extinction == 3.0f && t.points[4].value == 5.0f);
    sup_transfer_free(&t);
    for (i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        CHECK(sup_transfer_read_memory(bad[i].text, strlen(bad[i].text), "tf", &t, &err));
        CHECK_MSG(strstr(err.text, bad[i].part) != NULL, "\"%s\" does not say \"%s\"", err.text, bad[i].part);
    }
    {
        char names[128], *name, *next;
        (void)snprintf(names, sizeof names, "%s", SUP_TRANSFER_NAMES);
        for (name = names; name; name = next) {
            next = strchr(name, '|');
            if (next) *next++ = '\0';
            CHECK(!sup_transfer_named(name, -2.0, 3.0, 10.0, &t, &err));
            CHECK(t.count >= 2 && t.points[0].value == -2.0f && t.points[t.count - 1].value == 3.0f);
            for (i = 1; i < t.count; i++) CHECK(t.points[i].value >= t.points[i - 1].value);
            sup_transfer_free(&t);
        }
    }
    CHECK(sup_transfer_named("purple", 0.0, 1.0, 1.0, &t, &err) && g_memory.live == 0);
}

TEST(generated) {
    static const char *const names[] = {"lattice", "ball", "ring", "fins", "bow"};
    size_t i, k;
    for (i = 0; i < 5; i++) {
        sup_volume v;
        sup_error err;
        int64_t n;
        CHECK(!sup_volume_make(names[i], 8, &v, &err));
        check_indices(&v);
        CHECK(v.field_count == 1 && v.fields[0].count == v.point_count && v.points != NULL);
        for (k = 0; k < v.point_count; k++)
            CHECK(fabsf(v.fields[0].values[k]) < 10.0f && fabs(v.points[3 * k]) < 10.0);
        if (i == 0) CHECK(v.cell_count == 6 * 8 * 8 * 8);
        sup_volume_free(&v);
        for (n = 0; n < 40; n++) {
            int failed;
            g_memory.fail_at = n;
            g_memory.count = 0;
            failed = sup_volume_make(names[i], 4, &v, &err);
            g_memory.fail_at = -1;
            sup_volume_free(&v);
            CHECK(g_memory.live == 0);
            if (!failed) break;
        }
    }
    {
        sup_volume v;
        sup_error err;
        CHECK(sup_volume_make("cube", 0, &v, &err));
    }
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(vtk_cells);
    RUN(vtk_attributes);
    RUN(vtk_grids);
    RUN(ucd);
    RUN(gmsh);
    RUN(tetgen);
    RUN(plot3d);
    RUN(truncated);
    RUN(bytes_changed);
    RUN(out_of_memory);
    RUN(messages);
    RUN(long_names);
    RUN(plot3d_marks);
    RUN(real_files);
    RUN(transfer_functions);
    RUN(generated);
    return test_end();
}
