/* test_support.c - mesh readers, PNG writer, command line, camera and scenes of examples/support */
#include "support_memory.h"
#include "../examples/support/camera.h"
#include "../examples/support/cli.h"
#include "../examples/support/gi_scene.h"
#include "../examples/support/mesh.h"
#include "../examples/support/png.h"
#include "../examples/support/scenes.h"
#include "png_read.h"

/* ---- numbers in text ---------------------------------------------------------------------------------------- */

static int parse_f(const char *text, float *out) {
    const char *at = text, *end = text + strlen(text);
    return sup_parse_float(&at, end, out) ? -1 : (int)(at - text);
}

static int parse_d(const char *text, double *out) {
    const char *at = text, *end = text + strlen(text);
    return sup_parse_double(&at, end, out) ? -1 : (int)(at - text);
}

static int64_t float_rank(float f) { /* neighbours differ by one */
    uint32_t bits;
    memcpy(&bits, &f, sizeof bits);
    return bits & 0x80000000u ? -(int64_t)(bits & 0x7fffffffu) : (int64_t)bits;
}

TEST(number_forms) {
    static const struct {
        const char *text;
        double value;
        int length;
    } good[] = {{"0", 0, 1},
                {"-0", 0, 2},
                {"+7", 7, 2},
                {"1.", 1, 2},
                {".5", 0.5, 2},
                {"-.25", -0.25, 4},
                {"1e3", 1000, 3},
                {"1E+3", 1000, 4},
                {"25e-2", 0.25, 5},
                {"000123", 123, 6},
                {"1 2", 1, 1},
                {"3/4", 3, 1},
                {"1,5", 1, 1},
                {"9007199254740993", 9007199254740992.0, 16},
                {"123456789012345678901234567890", 123456789012345678901234567890.0, 30},
                {"1e-400", 0, 6},
                {"4.9e-324", 4.9e-324, 8},
                {"1.7976931348623157e308", 1.7976931348623157e308, 22},
                {"0.000000000000000000000000000000000001", 1e-36, 38},
                {"0e999999999999999999999", 0, 23}};
    static const char *const bad[] = {"",     "-",     "+",     ".",    "-.",    "e5",   "1e",    "1e+",
                                      "abc",  "1.2.3", "12abc", "1_0",  "--1",   "0x10", "1e5.5", "nanx",
                                      "infi", "i",     "n",     "nan(", "nan(x", "/",    "1e5e5"};
    size_t i;
    double d;
    float f;
    for (i = 0; i < sizeof good / sizeof good[0]; i++) {
        d = -99;
        CHECK_MSG(parse_d(good[i].text, &d) == good[i].length && d == good[i].value, "\"%s\" is %.17g", good[i].text,
                  d);
    }
    for (i = 0; i < sizeof bad / sizeof bad[0]; i++)
        CHECK_MSG(parse_d(bad[i], &d) < 0, "\"%s\" was read as %g", bad[i], d);
    CHECK(parse_d("-0", &d) == 2 && 1.0 / d < 0);
    CHECK(parse_d("1e999", &d) == 5 && d > DBL_MAX);
    CHECK(parse_d("-1e99999999999999999999", &d) > 0 && d < -DBL_MAX);
    CHECK(parse_d("nan", &d) == 3 && d != d);
    CHECK(parse_d("-NaN", &d) == 4 && d != d);
    CHECK(parse_d("nan(ind)", &d) == 8 && d != d);
    CHECK(parse_d("inf", &d) == 3 && d > DBL_MAX);
    CHECK(parse_d("-Infinity", &d) == 9 && d < -DBL_MAX);
    CHECK(parse_d("1.#INF", &d) == 6 && d > DBL_MAX);
    CHECK(parse_d("-1.#IND", &d) == 7 && d != d);
    CHECK(parse_d("1.#QNAN00", &d) == 9 && d != d);
    CHECK(parse_f("3.4028235e38", &f) > 0 && f == FLT_MAX);
    CHECK(parse_f("3.40282350000000001e38", &f) > 0 && f == FLT_MAX);
    CHECK(parse_f("-3.5e38", &f) > 0 && f < -FLT_MAX);
    CHECK(parse_f("1e-45", &f) > 0 && f > 0.0f);
    CHECK(parse_f("1e300", &f) > 0 && f > FLT_MAX);
}

TEST(numbers_agree_with_libc) {
    test_rng rng = test_rng_make(7);
    int i, n = test_quick() ? 20000 : 300000;
    int64_t worst = 0;
    for (i = 0; i < n; i++) {
        char text[512];
        const uint32_t form = test_rng_below(&rng, 7);
        float f = 0.0f, expect = test_rng_below(&rng, 3) ? test_rng_range(&rng, -100.0f, 100.0f) : test_rng_bits(&rng);
        double d = 0.0;
        int64_t off;
        if (form == 0) snprintf(text, sizeof text, "%.9g", (double)expect);
        else if (form == 1) snprintf(text, sizeof text, "%.6f", (double)expect);
        else if (form == 2) snprintf(text, sizeof text, "%g", (double)expect);
        else if (form == 3) snprintf(text, sizeof text, "%.17g", (double)expect * 1.1);
        else if (form == 4) snprintf(text, sizeof text, "%.3e", (double)expect);
        else if (form == 5) snprintf(text, sizeof text, "%.12f", (double)expect);
        else snprintf(text, sizeof text, "%.19g", (double)expect / 3.0);
        REQUIRE(parse_f(text, &f) == (int)strlen(text));
        REQUIRE(parse_d(text, &d) == (int)strlen(text));
        expect = strtof(text, NULL);
        if (expect != expect) {
            CHECK(f != f && d != d);
            continue;
        }
        off = float_rank(f) - float_rank(expect);
        off = off < 0 ? -off : off;
        if (off > worst) worst = off;
        CHECK_MSG(off <= 1, "\"%s\": %.9g, strtof says %.9g", text, (double)f, (double)expect);
        if (strlen(text) <= 20) CHECK_MSG(d == strtod(text, NULL), "\"%s\": %.17g", text, d);
    }
    CHECK(worst <= 1);
}

TEST(integers) {
    static const struct {
        const char *text;
        int64_t value;
        int length;
    } good[] = {{"0", 0, 1},
                {"-12", -12, 3},
                {"+5 ", 5, 2},
                {"7/8", 7, 1},
                {"9223372036854775807", INT64_MAX, 19},
                {"99999999999999999999", INT64_MAX, 20},
                {"-99999999999999999999", INT64_MIN, 21}};
    static const char *const bad[] = {"", "-", "+", "a", "1a", "1.5", "1e3", "1-2"};
    size_t i;
    for (i = 0; i < sizeof good / sizeof good[0]; i++) {
        const char *at = good[i].text;
        int64_t value = -1;
        CHECK(sup_parse_int(&at, at + strlen(at), &value) == 0 && value == good[i].value &&
              at - good[i].text == good[i].length);
    }
    for (i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        const char *at = bad[i];
        int64_t value;
        CHECK_MSG(sup_parse_int(&at, at + strlen(at), &value) == 1 && at == bad[i], "\"%s\"", bad[i]);
    }
}

TEST(line_numbers) {
    static const char data[] = "a\nb\r\nc\rd\n\ne";
    sup_text text;
    text.begin = text.at = data;
    text.end = data + sizeof data - 1;
    CHECK_EQ_U64(sup_text_line(&text, data), 1);
    CHECK_EQ_U64(sup_text_line(&text, strchr(data, 'b')), 2);
    CHECK_EQ_U64(sup_text_line(&text, strchr(data, 'c')), 3);
    CHECK_EQ_U64(sup_text_line(&text, strchr(data, 'd')), 4);
    CHECK_EQ_U64(sup_text_line(&text, strchr(data, 'e')), 6);
}

/* ---- helpers for meshes -------------------------------------------------------------------------------------- */

/* The materials of the tests: "a.mtl" has them, any other file is missing. */
static int open_materials(void *user, const char *name, char **data, size_t *size) {
    const char *text = (const char *)user;
    *data = NULL;
    if (strcmp(name, "a.mtl") != 0 && strcmp(name, "my materials.mtl") != 0) return 1;
    *size = strlen(text);
    *data = (char *)memory_resize(NULL, *size + 1);
    if (!*data) return 1;
    memcpy(*data, text, *size + 1);
    return 0;
}

static int read_bytes(const void *data, size_t size, sup_format format, sup_mesh *mesh, sup_error *err) {
    static char materials[] = "# materials\r\nnewmtl red\r\nNs 10\r\n  Kd 1 0 0\r\nnewmtl half grey\nKd 0.5\nmap_Kd "
                              "x.png\nnewmtl blue\nKa 1 1 1\n"
                              "Kd 0 \\\n 0.25 1\nnewmtl spectral\nKd spectral file.rfl\nnewmtl none\n";
    void *copy = malloc(size ? size : 1); /* its end is where a sanitizer looks */
    int failed;
    if (size) memcpy(copy, data, size);
    failed = sup_mesh_read_memory(copy, size, format, "test.xyz", open_materials, materials, mesh, err);
    free(copy);
    return failed;
}

static int read_text(const char *text, sup_format format, sup_mesh *mesh, sup_error *err) {
    return read_bytes(text, strlen(text), format, mesh, err);
}

static int same_indices(const sup_mesh *mesh, const uint32_t *expect, size_t triangles) {
    return mesh->triangle_count == triangles && memcmp(mesh->indices, expect, triangles * 3 * sizeof *expect) == 0;
}

static int mesh_is_valid(const sup_mesh *mesh) {
    size_t i;
    if (mesh->vertex_count && !mesh->positions) return 0;
    for (i = 0; i < 3 * mesh->triangle_count; i++) {
        if (mesh->indices[i] >= mesh->vertex_count) return 0;
    }
    return 1;
}

static double length2(const float *v) {
    return (double)v[0] * (double)v[0] + (double)v[1] * (double)v[1] + (double)v[2] * (double)v[2];
}

static double triangle_area(const sup_mesh *mesh, size_t t, double normal[3]) { /* twice */
    const float *p[3];
    double a[3], b[3];
    size_t k;
    for (k = 0; k < 3; k++) p[k] = mesh->positions + 3 * (size_t)mesh->indices[3 * t + k];
    for (k = 0; k < 3; k++) {
        a[k] = (double)p[1][k] - (double)p[0][k];
        b[k] = (double)p[2][k] - (double)p[0][k];
    }
    supi_cross(a, b, normal);
    return sqrt(supi_dot(normal, normal));
}

/* Error texts must name the file, be one line, and fit. */
static void check_error(const sup_error *err, const char *part) {
    CHECK_MSG(strncmp(err->text, "test.xyz: ", 10) == 0, "error without file: \"%s\"", err->text);
    CHECK_MSG(strstr(err->text, part) != NULL, "\"%s\" does not say \"%s\"", err->text, part);
    CHECK(strchr(err->text, '\n') == NULL && strlen(err->text) < sizeof err->text);
}

static void expect_failure(const char *text, sup_format format, const char *part) {
    sup_mesh mesh;
    sup_error err;
    const int failed = read_text(text, format, &mesh, &err);
    CHECK_MSG(failed == 1, "was read: %.60s", text);
    if (failed) check_error(&err, part);
    CHECK(mesh.positions == NULL && mesh.vertex_count == 0 && mesh.triangle_count == 0);
    sup_mesh_free(&mesh);
    CHECK_EQ_I64(g_memory.live, 0);
}

/* ---- OBJ --------------------------------------------------------------------------------------------------------- */

TEST(obj_all_index_forms) {
    static const uint32_t expect[] = {0, 1, 2, 0, 1, 2, 0, 2, 3};
    sup_mesh mesh;
    sup_error err;
    REQUIRE(!read_text(
        "# c\r\nv 0 0 0\r\nv 1 0 0\r\nvt 0 0\nv 1 1 0\r\nv 0 1 0\r\nf 1 2 3\nf 1/1 2/1 3/1\nf -4/-1/ -2/1 -1/1 # x\n",
        SUP_FORMAT_OBJ, &mesh, &err));
    CHECK(same_indices(&mesh, expect, 3) && mesh.vertex_count == 4 && !mesh.normals && !mesh.vertex_rgb &&
          !mesh.triangle_rgb);
    CHECK_STR(err.text, "");
    sup_mesh_free(&mesh);
}

TEST(obj_normals_split_vertices) {
    sup_mesh mesh;
    sup_error err;
    size_t i;
    REQUIRE(!read_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 0 1\nvn 0 0 1\nvn 0 1 0\nf 1//1 2//1 3//1\nf 1//-1 2//-1 "
                       "4//-1\nf 1//1 3/7/1 2//1\n",
                       SUP_FORMAT_OBJ, &mesh, &err));
    CHECK_EQ_U64(mesh.vertex_count, 6); /* 1, 2 and 3 with the first normal, 1, 2 and 4 with the second */
    REQUIRE(mesh.normals != NULL && mesh.triangle_count == 3);
    for (i = 0; i < 9; i++) CHECK(mesh.normals[3 * (size_t)mesh.indices[i] + (i >= 3 && i < 6 ? 1 : 2)] == 1.0f);
    CHECK(mesh.indices[0] == mesh.indices[6] && mesh.indices[2] == mesh.indices[7]);
    sup_mesh_free(&mesh);
    /* corners without a normal beside corners with one */
    REQUIRE(!read_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 0\nvn 1 0 0\nf 1//1 2//1 3\n f 1 2 3\n", SUP_FORMAT_OBJ, &mesh,
                       &err));
    REQUIRE(mesh.normals != NULL);
    CHECK_EQ_U64(mesh.vertex_count, 5);
    CHECK(mesh.normals[3 * mesh.indices[2] + 2] == 1.0f && mesh.normals[3 * mesh.indices[0]] == 1.0f);
    CHECK(mesh.normals[3 * mesh.indices[3] + 2] == 1.0f);
    sup_mesh_free(&mesh);
}

TEST(obj_colours_and_materials) {
    static const uint8_t vertex[] = {255, 0, 128, 255, 255, 255, 0, 255, 0};
    static const uint8_t triangle[] = {255, 255, 255, 255, 0, 0, 128, 128, 128, 0, 64, 255, 255, 255, 255};
    sup_mesh mesh;
    sup_error err;
    REQUIRE(!read_text("v 0 0 0 1 0 .5\nv 1 0 0 1.0\nv 0 1 0 -1 2 nan 1\nf 1 2 3\n", SUP_FORMAT_OBJ, &mesh, &err));
    REQUIRE(mesh.vertex_rgb != NULL);
    CHECK(memcmp(mesh.vertex_rgb, vertex, sizeof vertex) == 0);
    sup_mesh_free(&mesh);
    REQUIRE(!read_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nusemtl red \nf 1 2 3\nusemtl half grey\t\r\nf 1 2 "
                       "3\nusemtl blue\nf 1 2 3\nusemtl none\nf 1 2 3\nmtllib a.mtl\n",
                       SUP_FORMAT_OBJ, &mesh, &err));
    CHECK_STR(err.text, "");
    REQUIRE(mesh.triangle_rgb != NULL && mesh.triangle_count == 5);
    CHECK(memcmp(mesh.triangle_rgb, triangle, sizeof triangle) == 0);
    sup_mesh_free(&mesh);
    REQUIRE(!read_text("mtllib my materials.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n", SUP_FORMAT_OBJ,
                       &mesh, &err));
    CHECK(err.text[0] == '\0' && mesh.triangle_rgb && mesh.triangle_rgb[0] == 255 && mesh.triangle_rgb[1] == 0);
    sup_mesh_free(&mesh);
    REQUIRE(!read_text("mtllib a.mtl b.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n", SUP_FORMAT_OBJ, &mesh,
                       &err));
    check_error(&err, "b.mtl"); /* one of two is missing: a warning */
    CHECK(mesh.triangle_rgb != NULL);
    sup_mesh_free(&mesh);
    REQUIRE(!read_text("mtllib missing.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n", SUP_FORMAT_OBJ, &mesh,
                       &err));
    check_error(&err, "missing.mtl");
    CHECK(mesh.triangle_rgb == NULL && mesh.triangle_count == 1);
    sup_mesh_free(&mesh);
}

TEST(obj_traps) {
    sup_mesh mesh;
    sup_error err;
    static const uint32_t continued[] = {0, 1, 2, 0, 2, 3};
    REQUIRE(!read_text("#a comment that ends in C:\\\nv 0 0 0\nv 1 0 0 \\\r\n\nv 1 1 \\\n0\nv 0 1 0\no x\\\nf 1 1 "
                       "1\ng\ns off\nl 1 2\np 1\nf 1 2 \\\n3 \\\r\n4\nf 1 2\nf 1\nf \n",
                       SUP_FORMAT_OBJ, &mesh, &err));
    CHECK(same_indices(&mesh, continued, 2));
    CHECK_EQ_U64(mesh.skipped_faces, 3);
    sup_mesh_free(&mesh);
    /* faces before their vertices; CR alone; no line end at the end; NaN is kept; repeated corners are kept */
    REQUIRE(!read_text("f 1 2 3\rv nan 0 0\rv 1 inf 0\rv 0 1 0\rf 1 1 2\rf 3 2 1", SUP_FORMAT_OBJ, &mesh, &err));
    CHECK(mesh.triangle_count == 3 && mesh.positions[0] != mesh.positions[0] && mesh.positions[4] > FLT_MAX);
    sup_mesh_free(&mesh);
    REQUIRE(!read_text("v 1 2 3", SUP_FORMAT_OBJ, &mesh, &err)); /* points only */
    CHECK(mesh.vertex_count == 1 && mesh.triangle_count == 0);
    sup_mesh_free(&mesh);
    expect_failure("v 0 0\n", SUP_FORMAT_OBJ, "line 1");
    expect_failure("v 0 0 0\n\nv 0 x 0\n", SUP_FORMAT_OBJ, "line 3");
    expect_failure("v 0 0 0\nvn 1 2\n", SUP_FORMAT_OBJ, "line 2");
    expect_failure("v 0 0 0\nf 1 1 2\n", SUP_FORMAT_OBJ, "line 2: face 0: index 2 out of range");
    expect_failure("v 0 0 0\nf 1 1\nf 1 1 1\nf 1 1 -2\n", SUP_FORMAT_OBJ, "index -2 out of range");
    expect_failure("v 0 0 0\nf 1 1 0\n", SUP_FORMAT_OBJ, "line 2");
    expect_failure("v 0 0 0\nf 1//1 1//1 1//1\n", SUP_FORMAT_OBJ, "index of a normal 1 out of range");
    expect_failure("v 0 0 0\nf 1 1 99999999999999999999\n", SUP_FORMAT_OBJ, "out of range");
    expect_failure("v 0 0 0\nf 1 1 1x\n", SUP_FORMAT_OBJ, "line 2");
    expect_failure("v 0 0 0\nf 1 1 1/1/1/1\n", SUP_FORMAT_OBJ, "line 2");
    expect_failure("v 0 0 0\nf 1.5 1 1\n", SUP_FORMAT_OBJ, "line 2");
    expect_failure("# nothing\n", SUP_FORMAT_OBJ, "no vertices");
    expect_failure("v 0 0 0\n\001\002\003\n", SUP_FORMAT_OBJ, "line 2");
    expect_failure("", SUP_FORMAT_OBJ, "empty");
}

/* A polygon must be covered once: the areas of its triangles add up to its own, and all have its orientation. */
static void check_polygon(const float (*points)[2], size_t n, int axis, int flip) {
    char text[4096];
    size_t used = 0, i;
    double area = 0, sum = 0;
    sup_mesh mesh;
    sup_error err;
    for (i = 0; i < n; i++) {
        const float *p = points[flip ? n - 1 - i : i], *q = points[flip ? n - 1 - (i + 1) % n : (i + 1) % n];
        const double x = (double)p[0], y = (double)p[1];
        area += x * (double)q[1] - (double)q[0] * y;
        if (axis == 0) used += (size_t)snprintf(text + used, sizeof text - used, "v 3 %g %g\n", x, y);
        if (axis == 1) used += (size_t)snprintf(text + used, sizeof text - used, "v %g 3 %g\n", y, x);
        if (axis == 2) used += (size_t)snprintf(text + used, sizeof text - used, "v %g %g 3\n", x, y);
    }
    used += (size_t)snprintf(text + used, sizeof text - used, "f");
    for (i = 0; i < n; i++) used += (size_t)snprintf(text + used, sizeof text - used, " %d", (int)i + 1);
    REQUIRE(!read_text(text, SUP_FORMAT_OBJ, &mesh, &err));
    CHECK_EQ_U64(mesh.triangle_count, n - 2);
    for (i = 0; i < mesh.triangle_count; i++) {
        double normal[3], twice = triangle_area(&mesh, i, normal);
        sum += twice;
        CHECK_MSG(normal[axis] * area >= 0, "triangle %d of %d corners is turned over", (int)i, (int)n);
    }
    CHECK_NEAR(sum, fabs(area), 1e-6);
    sup_mesh_free(&mesh);
}

TEST(polygons) {
    static const float arrow[4][2] = {{0, 0}, {4, -2}, {1, 0}, {4, 2}};
    static const float arrow_later[4][2] = {{4, -2}, {1, 0}, {4, 2}, {0, 0}};
    static const float comb[12][2] = {{0, 0}, {7, 0}, {7, 3}, {6, 1}, {5, 3}, {4, 1},
                                      {3, 3}, {3, 1}, {2, 1}, {2, 3}, {1, 1}, {0, 3}};
    static const float straight[6][2] = {{0, 0}, {1, 0}, {2, 0}, {2, 2}, {1, 2}, {0, 2}};
    /* a square with a square hole, joined by a bridge: two corners occur twice */
    static const float hole[10][2] = {{0, 0}, {6, 0}, {6, 6}, {0, 6}, {0, 0}, {2, 2}, {2, 4}, {4, 4}, {4, 2}, {2, 2}};
    int axis, flip;
    for (axis = 0; axis < 3; axis++) {
        for (flip = 0; flip < 2; flip++) {
            check_polygon(arrow, 4, axis, flip);
            check_polygon(arrow_later, 4, axis, flip);
            check_polygon(comb, 12, axis, flip);
            check_polygon(straight, 6, axis, flip);
            check_polygon(hole, 10, axis, flip);
        }
    }
}

TEST(polygons_random_stars) {
    test_rng rng = test_rng_make(3);
    int k, i;
    for (k = 0; k < 200; k++) {
        float points[40][2];
        const int n = 4 + (int)test_rng_below(&rng, 37);
        for (i = 0; i < n; i++) { /* around the origin with any radius: simple, mostly concave */
            const float a = 6.2831853f * (float)i / (float)n, r = test_rng_range(&rng, 0.2f, 1.0f);
            points[i][0] = (float)(int)(r * cosf(a) * 1000.0f);
            points[i][1] = (float)(int)(r * sinf(a) * 1000.0f);
        }
        check_polygon((const float(*)[2])points, (size_t)n, (int)test_rng_below(&rng, 3), (int)test_rng_below(&rng, 2));
    }
}

TEST(polygons_hostile) {
    /* a large outline that crosses itself everywhere must end in time and give n - 2 valid triangles */
    const int n = 3000;
    char *text = (char *)malloc((size_t)n * 40);
    size_t used = 0;
    sup_mesh mesh;
    sup_error err;
    double start;
    int i;
    REQUIRE(text != NULL);
    for (i = 0; i < n; i++) used += (size_t)sprintf(text + used, "v %d %d 0\n", i * 7919 % 1009, i * 104729 % 997);
    used += (size_t)sprintf(text + used, "f");
    for (i = 0; i < n; i++) used += (size_t)sprintf(text + used, " %d", i + 1);
    start = test_now();
    CHECK(!read_bytes(text, used, SUP_FORMAT_OBJ, &mesh, &err));
    CHECK_MSG(test_now() - start < (TEST_SANITIZED ? 30.0 : 5.0), "%.1f s", test_now() - start);
    CHECK(mesh.triangle_count == (size_t)n - 2 && mesh_is_valid(&mesh));
    sup_mesh_free(&mesh);
    /* the work of all polygons is bounded: what comes after too much of it becomes fans */
    for (i = 0; i < 2; i++) {
        static const float arrow[12] = {0, 0, 0, 4, 2, 0, 0, 4, 0, 1, 2, 0}; /* the last corner points inwards */
        static const uint32_t corner[4] = {0, 1, 2, 3}, fan[6] = {0, 1, 2, 0, 2, 3};
        supi_faces faces;
        memset(&faces, 0, sizeof faces);
        faces.work = i ? SUPI_CLIP_WORK : 0;
        CHECK(!supi_add_polygon(&faces, arrow, corner, 4) && faces.count == 2);
        CHECK((memcmp(faces.indices, fan, sizeof fan) == 0) == (i == 1));
        CHECK(i ? faces.work == SUPI_CLIP_WORK : faces.work > 0);
        supi_faces_free(&faces);
    }
    free(text);
}

/* ---- PLY --------------------------------------------------------------------------------------------------------- */

typedef struct byte_file {
    uint8_t data[4096];
    size_t size;
    int big; /* byte order */
} byte_file;

static void put_text(byte_file *b, const char *text) {
    memcpy(b->data + b->size, text, strlen(text));
    b->size += strlen(text);
}

static void put_number(byte_file *b, uint64_t value, size_t size) {
    size_t i;
    for (i = 0; i < size; i++) b->data[b->size++] = (uint8_t)(value >> (8 * (b->big ? size - 1 - i : i)));
}

static void put_float(byte_file *b, float value) {
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    put_number(b, bits, 4);
}

static void put_double(byte_file *b, double value) {
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    put_number(b, bits, 8);
}

/* Two faces, and something of every type around what counts. */
static void make_ply(byte_file *b, int big, const char *line_end) {
    static const char *const header[] = {"comment element vertex 99",
                                         "obj_info x",
                                         "element vertex 4",
                                         "property int8 a",
                                         "property double x",
                                         "property uint8 b",
                                         "property float32 y",
                                         "property list uint16 double c",
                                         "property short z",
                                         "property ushort red",
                                         "property ushort green",
                                         "property uint16 blue",
                                         "property uint d",
                                         "property float nx",
                                         "property float ny",
                                         "property float nz",
                                         "element other 2",
                                         "property list char int e",
                                         "property double f",
                                         "element empty 5",
                                         "element face 3",
                                         "property uchar flags",
                                         "property list uint uint vertex_index",
                                         "property list uchar float texcoord",
                                         "end_header"};
    static const float xyz[4][3] = {{0.5f, 0, -2}, {1, 0, -2}, {1, 1, -300}, {0, 1, 7}};
    size_t i, k;
    memset(b, 0, sizeof *b);
    b->big = big;
    put_text(b, "ply");
    put_text(b, line_end);
    put_text(b, big ? "format binary_big_endian 1.0" : "format binary_little_endian 1.0");
    put_text(b, line_end);
    for (i = 0; i < sizeof header / sizeof header[0]; i++) {
        put_text(b, header[i]);
        put_text(b, line_end);
    }
    for (i = 0; i < 4; i++) {
        put_number(b, 0xff, 1);
        put_double(b, (double)xyz[i][0]);
        put_number(b, '\n', 1);
        put_float(b, xyz[i][1]);
        put_number(b, i, 2);
        for (k = 0; k < i; k++) put_double(b, 1.5);
        put_number(b, (uint64_t)(int64_t)xyz[i][2], 2);
        put_number(b, 65535, 2);
        put_number(b, 257 * i, 2);
        put_number(b, 0, 2);
        put_number(b, 0xdeadbeef, 4);
        put_float(b, 0);
        put_float(b, 0);
        put_float(b, (float)i);
    }
    put_number(b, 3, 1);
    for (i = 0; i < 3; i++) put_number(b, i, 4);
    put_double(b, 1);
    put_number(b, 0, 1);
    put_double(b, 2);
    put_number(b, 1, 1);
    put_number(b, 3, 4);
    for (i = 0; i < 3; i++) put_number(b, i, 4);
    put_number(b, 1, 1);
    put_float(b, 9);
    put_number(b, 1, 1);
    put_number(b, 2, 4);
    put_number(b, 0, 4);
    put_number(b, 1, 4);
    put_number(b, 0, 1);
    put_number(b, 1, 1);
    put_number(b, 4, 4);
    for (i = 0; i < 4; i++) put_number(b, 3 - i, 4);
    put_number(b, 0, 1);
}

TEST(ply_binary_every_type) {
    static const char *const ends[] = {"\n", "\r\n", "\r"};
    static const uint32_t expect[] = {0, 1, 2, 3, 2, 1, 3, 1, 0};
    int big, e;
    for (big = 0; big < 2; big++) {
        for (e = 0; e < 3; e++) {
            byte_file b;
            sup_mesh mesh;
            sup_error err;
            size_t i, header_size;
            make_ply(&b, big, ends[e]);
            header_size = (size_t)(strstr((const char *)b.data, "end_header") - (const char *)b.data) + 10;
            REQUIRE(!read_bytes(b.data, b.size, SUP_FORMAT_AUTO, &mesh, &err));
            CHECK(mesh.vertex_count == 4 && same_indices(&mesh, expect, 3));
            CHECK_EQ_U64(mesh.skipped_faces, 1);
            CHECK(mesh.positions[0] == 0.5f && mesh.positions[2] == -2.0f && mesh.positions[8] == -300.0f &&
                  mesh.positions[11] == 7.0f);
            REQUIRE(mesh.vertex_rgb && mesh.normals);
            for (i = 0; i < 4; i++)
                CHECK(mesh.vertex_rgb[3 * i] == 255 && mesh.vertex_rgb[3 * i + 1] == i &&
                      mesh.normals[3 * i + 2] == (float)i);
            sup_mesh_free(&mesh);
            for (i = 0; i < b.size; i++) { /* cut off anywhere */
                CHECK_MSG(read_bytes(b.data, i, SUP_FORMAT_PLY, &mesh, &err), "cut at %d", (int)i);
                if (i) CHECK(strstr(err.text, i >= header_size ? "byte" : "line") != NULL);
            }
        }
    }
}

#define PLY_HEAD "ply\nformat ascii 1.0\n"
#define PLY_XYZ "property float x\nproperty float y\nproperty float z\n"
#define PLY_FACE "property list uchar int vertex_indices\n"

TEST(ply_ascii) {
    sup_mesh mesh;
    sup_error err;
    static const uint32_t strips[] = {0, 1, 2, 1, 3, 2, 2, 3, 4};
    static const uint32_t quad[] = {0, 1, 2, 0, 2, 3};
    static const uint8_t painted[] = {255, 0, 0, 255, 0, 0, 0, 128, 255};
    REQUIRE(!read_text(
        PLY_HEAD
        "element vertex 4\n" PLY_XYZ
        "property float red\nproperty float green\nproperty float blue\nproperty uchar alpha\nelement face 1\n" PLY_FACE
        "end_header\n0 0 0 1 0 .5 255\n1 0 0 0 1 0 255\n1 1 0 0 0 0 0\n0 1 nan 2 -1 nan 0\n4 0 1 2 3",
        SUP_FORMAT_PLY, &mesh, &err));
    CHECK(same_indices(&mesh, quad, 2) && mesh.vertex_rgb && mesh.vertex_rgb[0] == 255 && mesh.vertex_rgb[2] == 128 &&
          mesh.vertex_rgb[9] == 255 && mesh.vertex_rgb[11] == 0);
    CHECK(mesh.positions[11] != mesh.positions[11]);
    sup_mesh_free(&mesh);
    /* faces before vertices; colours of faces */
    REQUIRE(!read_text(PLY_HEAD
                       "element face 2\n" PLY_FACE
                       "property uchar red\nproperty uchar green\nproperty uchar blue\nelement vertex 4\n" PLY_XYZ
                       "end_header\n4 0 1 2 3 255 0 0\n3 0 1 2 0 128 255\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n",
                       SUP_FORMAT_PLY, &mesh, &err));
    CHECK(mesh.triangle_count == 3 && mesh.triangle_rgb && memcmp(mesh.triangle_rgb, painted, sizeof painted) == 0 &&
          !mesh.vertex_rgb);
    sup_mesh_free(&mesh);
    REQUIRE(!read_text(PLY_HEAD "element tristrips 1\nproperty list int int vertex_indices\nelement vertex 5\n" PLY_XYZ
                                "end_header\n8 0 1 2 3 -1 2 3 4\n0 0 0 1 0 0 0 1 0 1 1 0 2 2 2\n",
                       SUP_FORMAT_PLY, &mesh, &err));
    CHECK(same_indices(&mesh, strips, 3));
    sup_mesh_free(&mesh);
    REQUIRE(!read_text(PLY_HEAD "element vertex 1\n" PLY_XYZ "end_header\n1 2 3\n", SUP_FORMAT_PLY, &mesh, &err));
    check_error(&err, "no triangles"); /* a warning */
    sup_mesh_free(&mesh);
    REQUIRE(!read_text(PLY_HEAD "element vertex 0\n" PLY_XYZ "element face 0\n" PLY_FACE "end_header\n", SUP_FORMAT_PLY,
                       &mesh, &err));
    CHECK(mesh.vertex_count == 0 && mesh.triangle_count == 0);
    sup_mesh_free(&mesh);
    REQUIRE(!read_text(PLY_HEAD "element vertex 3\n" PLY_XYZ "element face 1\n" PLY_FACE
                                "end_header\n0 0 0 1 0 0 1 1 0 3 0.0 1.0 2e0\n",
                       SUP_FORMAT_PLY, &mesh, &err));
    sup_mesh_free(&mesh);
}

TEST(ply_malformed) {
    expect_failure("plx\n", SUP_FORMAT_PLY, "not a PLY");
    expect_failure(PLY_HEAD "element vertex 4\nend_header\n", SUP_FORMAT_PLY, "no x, y, z");
    expect_failure(PLY_HEAD "element face 4\nelement junk 3\nend_header\n", SUP_FORMAT_PLY, "no vertices");
    expect_failure("ply\n", SUP_FORMAT_PLY, "cut off");
    expect_failure("ply\nelement vertex 0\nend_header\n", SUP_FORMAT_PLY, "format");
    expect_failure("ply\nformat binary_middle_endian 1.0\nend_header\n", SUP_FORMAT_PLY, "line 2");
    expect_failure(PLY_HEAD "property float x\nend_header\n", SUP_FORMAT_PLY, "line 3");
    expect_failure(PLY_HEAD "element vertex -1\nend_header\n", SUP_FORMAT_PLY, "line 3");
    expect_failure(PLY_HEAD "element vertex\nend_header\n", SUP_FORMAT_PLY, "line 3");
    expect_failure(PLY_HEAD "element vertex 1\nproperty float128 x\nend_header\n", SUP_FORMAT_PLY, "unknown type");
    expect_failure(PLY_HEAD "element vertex 1\nproperty list float int x\nend_header\n", SUP_FORMAT_PLY,
                   "whole number");
    expect_failure(PLY_HEAD "element vertex 1\nproperty float\nend_header\n", SUP_FORMAT_PLY, "needs a name");
    expect_failure(PLY_HEAD "element vertex 1\nelement vertex 1\nend_header\n", SUP_FORMAT_PLY, "twice");
    expect_failure(PLY_HEAD "elephant\nend_header\n", SUP_FORMAT_PLY, "unknown word");
    expect_failure(PLY_HEAD "end_header\n", SUP_FORMAT_PLY, "no vertices");
    expect_failure(PLY_HEAD "element vertex 1\nproperty float x\nproperty float y\nend_header\n1 1\n", SUP_FORMAT_PLY,
                   "no x, y, z");
    expect_failure(PLY_HEAD "element vertex 1\n" PLY_XYZ "end_header\n1 2 x\n", SUP_FORMAT_PLY,
                   "line 8: a number was expected");
    expect_failure(PLY_HEAD "element vertex 2\n" PLY_XYZ "end_header\n1.25 2 3\n1 2", SUP_FORMAT_PLY, "too early");
    expect_failure(PLY_HEAD "element vertex 3\n" PLY_XYZ "element face 2\n" PLY_FACE
                            "end_header\n0 0 0 1 0 0 1 1 0\n3 0 1 2\n3 0 1 99\n",
                   SUP_FORMAT_PLY, "line 12: face 1: index 99 out of range, there are 3 vertices");
    expect_failure(PLY_HEAD "element vertex 3\n" PLY_XYZ "element face 1\n" PLY_FACE
                            "end_header\n0 0 0 1 0 0 1 1 0\n3 0 1 -1\n",
                   SUP_FORMAT_PLY, "index -1 out of range");
    expect_failure(PLY_HEAD "element vertex 3\n" PLY_XYZ "element face 1\n" PLY_FACE
                            "end_header\n0 0 0 1 0 0 1 1 0\n3 0 1 nan\n",
                   SUP_FORMAT_PLY, "out of range");
    expect_failure(PLY_HEAD "element vertex 3\n" PLY_XYZ "element face 1\n" PLY_FACE
                            "end_header\n0 0 0 1 0 0 1 1 0\n-3 0 1 2\n",
                   SUP_FORMAT_PLY, "no count");
    expect_failure(PLY_HEAD "element vertex 3\n" PLY_XYZ "element face 1\n" PLY_FACE
                            "end_header\n0 0 0 1 0 0 1 1 0\n2.5 0 1 2\n",
                   SUP_FORMAT_PLY, "no count");
    expect_failure(PLY_HEAD "element vertex 3\n" PLY_XYZ "element face 1\n" PLY_FACE
                            "end_header\n0 0 0 1 0 0 1 1 0\n4000000000 0 1 2\n",
                   SUP_FORMAT_PLY, "longer than the file");
    expect_failure(PLY_HEAD "element tristrips 1\nproperty list int int vertex_indices\nelement vertex 1\n" PLY_XYZ
                            "end_header\n3 0 0 -2\n0 0 0\n",
                   SUP_FORMAT_PLY, "index -2 out of range");
}

TEST(ply_headers_of_any_length) { /* in time proportional to their length */
    enum { MANY = 100000 };
    char *text = (char *)malloc((size_t)MANY * 24 + 200);
    size_t used = 0;
    sup_mesh mesh;
    sup_error err;
    double start = test_now();
    int i, k;
    REQUIRE(text != NULL);
    for (k = 0; k < 2; k++) {
        used = (size_t)sprintf(text, PLY_HEAD "%s", k ? "element vertex 1\n" : "");
        for (i = 0; i < MANY; i++) used += (size_t)sprintf(text + used, k ? "property float x\n" : "element other 0\n");
        used += (size_t)sprintf(text + used, "end_header\n0\n");
        CHECK(read_bytes(text, used, SUP_FORMAT_PLY, &mesh, &err) == 1);
    }
    CHECK_MSG(test_now() - start < (TEST_SANITIZED ? 10.0 : 1.5), "%.1f s", test_now() - start);
    free(text);
}

/* ---- STL --------------------------------------------------------------------------------------------------------- */

static void make_stl(byte_file *b, const char *head, uint32_t announced, const float (*points)[3], size_t triangles) {
    size_t t, k;
    memset(b, 0, sizeof *b);
    put_text(b, head);
    b->size = 80;
    put_number(b, announced, 4);
    for (t = 0; t < triangles; t++) {
        for (k = 0; k < 3; k++) put_float(b, 0);
        for (k = 0; k < 9; k++) put_float(b, points[3 * t + k / 3][k % 3]);
        put_number(b, 0x8fff, 2); /* a colour to some programs */
    }
}

TEST(stl_binary) {
    static const float points[6][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 0, 0}, {1, 1, 0}, {-0.0f, 1, 0}};
    static const uint32_t expect[] = {0, 1, 2, 1, 3, 2};
    byte_file b;
    sup_mesh mesh;
    sup_error err;
    size_t i;
    make_stl(&b, "solid looks like text", 2, points, 2);
    REQUIRE(!read_bytes(b.data, b.size, SUP_FORMAT_AUTO, &mesh, &err));
    CHECK(mesh.vertex_count == 4 && same_indices(&mesh, expect, 2)); /* welded, -0 too */
    CHECK(!mesh.normals && err.text[0] == '\0');
    CHECK(!sup_mesh_compute_normals(&mesh, &err) && mesh.normals[2] == 1.0f);
    sup_mesh_free(&mesh);
    make_stl(&b, "binary", 2, points, 2);
    for (i = 0; i < b.size; i++) {
        CHECK(read_bytes(b.data, i, SUP_FORMAT_STL, &mesh, &err));
        if (i) check_error(&err, "byte");
    }
    b.size += 7; /* something behind the triangles: a warning */
    REQUIRE(!read_bytes(b.data, b.size, SUP_FORMAT_STL, &mesh, &err));
    check_error(&err, "7 bytes");
    sup_mesh_free(&mesh);
    make_stl(&b, "hostile", 0xffffffffu, points, 1);
    memory_reset(-1);
    CHECK(read_bytes(b.data, b.size, SUP_FORMAT_STL, &mesh, &err));
    check_error(&err, "announced");
    CHECK(g_memory.largest < 65536);
    make_stl(&b, "none", 0, points, 0);
    REQUIRE(!read_bytes(b.data, b.size, SUP_FORMAT_AUTO, &mesh, &err));
    CHECK(mesh.triangle_count == 0);
    sup_mesh_free(&mesh);
}

TEST(stl_ascii) {
    static const uint32_t expect[] = {0, 1, 2, 0, 2, 3, 1, 4, 2};
    sup_mesh mesh;
    sup_error err;
    REQUIRE(!read_text("solid a name with facet in it\r\nFACET NORMAL 0 0 1\r\nouter loop\r\nvertex 0 0 0\r\nvertex 1 "
                       "0 0\r\nvertex 1 1 0\r\nvertex 0 1 0\nendloop\nendfacet\n"
                       "endsolid a name\nsolid\n facet normal nan nan nan outer loop\n\nouter loop vertex 1 0 -0 "
                       "vertex 2e0 0 0 vertex 1 1 0 endloop endfacet endsolid",
                       SUP_FORMAT_AUTO, &mesh, &err));
    CHECK(mesh.vertex_count == 5 && same_indices(&mesh, expect, 3));
    sup_mesh_free(&mesh);
    REQUIRE(!read_text("solid empty\nendsolid empty\n", SUP_FORMAT_AUTO, &mesh, &err));
    CHECK(mesh.triangle_count == 0 && mesh.vertex_count == 0);
    sup_mesh_free(&mesh);
    expect_failure("solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0\nendloop\n", SUP_FORMAT_STL, "line 5");
    expect_failure("solid\nfacet normal 0 0 1\nvertex 0 0 0\n", SUP_FORMAT_STL, "ends before endsolid");
    expect_failure("solid\nvertex 0 0 0\n", SUP_FORMAT_STL, "line 2: vertex outside");
    expect_failure("solid\nfacet normal 0 0 1\nfacet normal 0 0 1\n", SUP_FORMAT_STL, "line 3");
    expect_failure("solid\nendfacet\n", SUP_FORMAT_STL, "line 2");
    expect_failure("solid\nfacet x\nendsolid\n", SUP_FORMAT_STL, "line 3");
    expect_failure("solid\ngarbage\n", SUP_FORMAT_STL, "line 2: unknown word");
    expect_failure("solid", SUP_FORMAT_STL, "ends before");
}

/* ---- OFF --------------------------------------------------------------------------------------------------------- */

TEST(off_forms) {
    static const uint32_t expect[] = {0, 1, 2, 0, 1, 2, 0, 2, 3};
    static const uint8_t faces[] = {255, 255, 255, 255, 128, 0, 255, 128, 0};
    static const uint8_t colours[] = {255, 0, 0, 0, 128, 255, 1, 2, 3};
    sup_mesh mesh;
    sup_error err;
    REQUIRE(!read_text(
        "# c\n OFF # c\n# c\n4 3 5\n\n0 0 0\n1 0 0 # c\n1 1 0\n0 1 0\n3 0 1 2\n4 0 1 2 3 1.0 0.5 0 1\n2 0 1\n",
        SUP_FORMAT_AUTO, &mesh, &err));
    CHECK(same_indices(&mesh, expect, 3) && mesh.skipped_faces == 1);
    CHECK(mesh.triangle_rgb && memcmp(mesh.triangle_rgb, faces, sizeof faces) == 0);
    sup_mesh_free(&mesh);
    REQUIRE(!read_text("COFF 3 1 3\r\n0 0 0 1.0 0.0 0 1\r\n1 0 0 0 128 255\r\n0 1 0 1 2 3 4\r\n3 0 1 2\r\n",
                       SUP_FORMAT_AUTO, &mesh, &err));
    CHECK(mesh.vertex_rgb && memcmp(mesh.vertex_rgb, colours, sizeof colours) == 0 && mesh.triangle_count == 1 &&
          !mesh.triangle_rgb);
    sup_mesh_free(&mesh);
    REQUIRE(!read_text(
        "NOFF 3 1 3 0 0 0 1 2 3 # edges take the rest of their line\n1 2 3 4 5 6\n7 8 9 0 0 1\n1 1 1 0 1 0\n3 2 1 0\n",
        SUP_FORMAT_OFF, &mesh, &err));
    CHECK(mesh.normals && mesh.normals[0] == 4.0f && mesh.normals[5] == 1.0f && mesh.indices[0] == 2);
    sup_mesh_free(&mesh);
    REQUIRE(
        !read_text("STOFF\n3 1 3\n0 0 0 .5 .5\n1 0 0 .5 .5\n0 1 0 .5 .5\n3 0 1 2 7\n", SUP_FORMAT_AUTO, &mesh, &err));
    CHECK(mesh.positions[3] == 1.0f && mesh.triangle_count == 1);
    sup_mesh_free(&mesh);
    REQUIRE(!read_text("3 1\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", SUP_FORMAT_OFF, &mesh, &err)); /* without its word */
    CHECK(mesh.triangle_count == 1);
    sup_mesh_free(&mesh);
    REQUIRE(!read_text("OFF\n0 0 0\n", SUP_FORMAT_AUTO, &mesh, &err));
    sup_mesh_free(&mesh);
    expect_failure("OFF BINARY\n", SUP_FORMAT_AUTO, "binary");
    expect_failure("4OFF\n1 0 0\n", SUP_FORMAT_AUTO, "three dimensions");
    expect_failure("OFF\nx\n", SUP_FORMAT_OFF, "line 2");
    expect_failure("OFF\n-3 1 0\n", SUP_FORMAT_OFF, "missing");
    expect_failure("OFF\n2 1 0\n0 0 0\n0 0 y\n", SUP_FORMAT_OFF, "line 4: vertex 1");
    expect_failure("OFF\n2 0 0\n0 0 0\n0 0", SUP_FORMAT_OFF, "ends here");
    expect_failure("OFF\n1 1 0\n0 0 0\n3 0 0 1\n", SUP_FORMAT_OFF, "line 4: face 0: index 1 out of range");
    expect_failure("OFF\n1 1 0\n0 0 0\n3 0 0 -1\n", SUP_FORMAT_OFF, "out of range");
    expect_failure("OFF\n1 1 0\n0 0 0\n99 0 0 0\n", SUP_FORMAT_OFF, "face 0: more corners");
    expect_failure("OFF\n1 1 0\n0 0 0\n3 0 0\n", SUP_FORMAT_OFF, "ends here");
    expect_failure("COFF\n1 0 0\n0 0 0\n", SUP_FORMAT_OFF, "no colour");
}

/* ---- all formats ------------------------------------------------------------------------------------------------- */

TEST(formats_by_content) {
    static const struct {
        const char *text, *name;
        sup_format format;
    } cases[] = {{"ply\nformat", "x.obj", SUP_FORMAT_PLY}, {"solid x\n", "x", SUP_FORMAT_STL},
                 {"OFF 1 1", "x.ply", SUP_FORMAT_OFF},     {"#\nCOFF\n", "x", SUP_FORMAT_OFF},
                 {"v 1 2 3\n", "x", SUP_FORMAT_OBJ},       {"# c\n\no x\nv 1 2 3\n", "x", SUP_FORMAT_OBJ},
                 {"o x\n", "a.b/X.OBJ", SUP_FORMAT_OBJ},   {"3 1 0", "x.off", SUP_FORMAT_OFF},
                 {"hello", "x", SUP_FORMAT_AUTO},          {"\001\002v 1", "x.dat", SUP_FORMAT_AUTO},
                 {"plywood", "x", SUP_FORMAT_AUTO},        {"OFFAL", "x", SUP_FORMAT_AUTO}};
    size_t i;
    for (i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        CHECK_MSG(supi_guess_format(cases[i].text, strlen(cases[i].text), cases[i].name) == cases[i].format, "case %d",
                  (int)i);
    }
    expect_failure("hello", SUP_FORMAT_AUTO, "not a mesh");
    expect_failure("", SUP_FORMAT_AUTO, "empty");
}

static const char *const g_valid[] = {
    "mtllib a.mtl\nv 0 0 0 1 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0.5 0.5 1\nvn 0 0 1\nusemtl red\nf 1 2 3 4\nf 1//1 2//1 "
    "5//1\nusemtl blue\nf -1/1/1 1 2\nf 1 3 2 4\n",
    PLY_HEAD "element vertex 4\n" PLY_XYZ "property float nx\nproperty float ny\nproperty float nz\nproperty uchar "
                                          "red\nproperty uchar green\nproperty uchar blue\n"
             "element face 2\n" PLY_FACE "property float red\nproperty float green\nproperty float blue\nend_header\n0 "
                                         "0 0 0 0 1 1 2 3\n1 0 0 0 0 1 1 2 3\n0.2 0.2 0 0 0 1 1 2 3\n"
             "0 1 0 0 0 1 1 2 3\n4 0 1 2 3 1 0 0\n3 0 1 2 0 0.5 0\n",
    "solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex .2 .2 0\nvertex 0 1 "
    "0\nendloop\nendfacet\nendsolid x\n",
    "STCNOFF\n4 2 0\n0 0 0 0 0 1 255 0 0 255 0 0\n1 0 0 0 0 1 255 0 0 255 0 0\n.2 .2 0 0 0 1 255 0 0 255 0 0\n0 1 0 0 "
    "0 1 255 0 0 255 0 0\n4 0 1 2 3 1.0 0.5 0.25\n3 0 1 2\n"};
static const sup_format g_valid_format[] = {SUP_FORMAT_OBJ, SUP_FORMAT_PLY, SUP_FORMAT_STL, SUP_FORMAT_OFF};

TEST(cut_off_at_every_length) {
    size_t f, n, unread;
    for (f = 0; f < 4; f++) {
        const size_t size = strlen(g_valid[f]);
        unread = 0;
        for (n = 0; n <= size; n++) {
            sup_mesh mesh;
            sup_error err;
            const int failed = read_bytes(g_valid[f], n, g_valid_format[f], &mesh, &err);
            unread += (size_t)failed;
            if (failed) check_error(&err, "");
            else CHECK(mesh_is_valid(&mesh));
            if (n == size) CHECK(!failed && mesh.triangle_count >= 2);
            sup_mesh_free(&mesh);
            CHECK_EQ_I64(g_memory.live, 0);
        }
        CHECK(unread > 20); /* most cuts must be noticed where the format allows it */
    }
}

TEST(every_byte_changed) {
    static const uint8_t values[] = {0, '\n', '\r', ' ', '-', '9', '.', '/', '\\', '#', 'e', 127, 255};
    size_t f, i, k;
    for (f = 0; f < 5; f++) {
        byte_file b;
        memset(&b, 0, sizeof b);
        if (f < 4) put_text(&b, g_valid[f]);
        else make_ply(&b, 1, "\n");
        for (i = 0; i < b.size; i++) {
            const uint8_t old = b.data[i];
            for (k = 0; k < sizeof values; k++) {
                sup_mesh mesh;
                sup_error err;
                b.data[i] = values[k];
                if (!read_bytes(b.data, b.size, f < 4 ? g_valid_format[f] : SUP_FORMAT_PLY, &mesh, &err))
                    CHECK(mesh_is_valid(&mesh));
                sup_mesh_free(&mesh);
            }
            b.data[i] = old;
        }
    }
    CHECK_EQ_I64(g_memory.live, 0);
}

TEST(every_allocation_fails_once) {
    size_t f;
    for (f = 0; f < 5; f++) {
        byte_file b;
        int64_t k;
        int failed = 1;
        memset(&b, 0, sizeof b);
        if (f < 4) put_text(&b, g_valid[f]);
        else make_ply(&b, 0, "\n");
        for (k = 0; failed && k < 200; k++) {
            sup_mesh mesh;
            sup_error err;
            memory_reset(k);
            failed = read_bytes(b.data, b.size, f < 4 ? g_valid_format[f] : SUP_FORMAT_PLY, &mesh, &err);
            if (failed) check_error(&err, "out of memory");
            /* a material that could not be opened is a warning, so the first success may come early */
            if (!failed && g_memory.count > k && err.text[0]) failed = 1;
            g_memory.fail_at = -1;
            sup_mesh_free(&mesh);
            CHECK_EQ_I64(g_memory.live, 0);
        }
        CHECK(!failed && k > 3 && k > g_memory.count); /* the last round had nothing left to fail */
    }
}

TEST(hostile_counts) {
    static const char *const files[] = {
        "ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\nproperty float y\nproperty "
        "float z\nend_header\nabc",
        "ply\nformat ascii 1.0\nelement vertex 4000000000\nproperty float x\nproperty float y\nproperty float "
        "z\nend_header\n1 2 3\n",
        "ply\nformat ascii 1.0\nelement vertex 9223372036854775807\nproperty list uchar int x\nelement face "
        "9223372036854775807\nend_header\n1 2 3\n",
        "ply\nformat ascii 1.0\nelement vertex 18446744073709551617\nproperty float x\nproperty float y\nproperty "
        "float z\nend_header\n1 2 3\n",
        ("ply\nformat binary_big_endian 1.0\nelement face 99999999999\nproperty list uint double "
         "vertex_indices\nelement vertex 1\n"
         "property char x\nproperty char y\nproperty char z\nend_header\n\377\377\377\377aaaaaaaaaaaaaaaaaaaaaaaaaa"),
        "ply\nformat binary_little_endian 1.0\nelement junk 9000000000000000000\nelement vertex 9\nproperty float "
        "x\nend_header\nabc",
        "OFF\n4000000000 1 0\n0 0 0\n",
        "OFF\n1 4000000000 0\n0 0 0\n",
        "OFF\n1 1 0\n0 0 0\n4000000000 0 0 0\n",
        "OFF\n99999999999999999999 99999999999999999999 0\n",
        "v 0 0 0\nf 1 1 4294967295\n",
        "v 0 0 0\nf 1 1 4294967297\n",
        "v 0 0 0\nf 1 1 -4294967297\n"};
    size_t i;
    for (i = 0; i < sizeof files / sizeof files[0]; i++) {
        sup_mesh mesh;
        sup_error err;
        const double start = test_now();
        memory_reset(-1);
        CHECK_MSG(read_text(files[i], SUP_FORMAT_AUTO, &mesh, &err), "file %d was read", (int)i);
        CHECK_MSG(g_memory.largest < 16384, "file %d made an allocation of %d bytes", (int)i, (int)g_memory.largest);
        CHECK_MSG(test_now() - start < 0.5, "file %d took %.2f s", (int)i, test_now() - start);
        CHECK_EQ_I64(g_memory.live, 0);
    }
}

TEST(file_errors) {
    sup_mesh mesh;
    sup_error err;
    const char *path = test_temp_path(".obj");
    char *data;
    size_t size;
    CHECK(sup_mesh_read("/nonexistent/folder/x.obj", &mesh, &err) == 1 &&
          strstr(err.text, "/nonexistent/folder/x.obj: ") == err.text);
    CHECK(sup_mesh_read("/tmp", &mesh, &err) == 1 && strncmp(err.text, "/tmp: ", 6) == 0);
    CHECK(sup_mesh_read("/nonexistent", &mesh, NULL) == 1);
    REQUIRE(test_write_file(path, "", 0));
    CHECK(sup_mesh_read(path, &mesh, &err) == 1 && strstr(err.text, "empty") != NULL);
    REQUIRE(test_write_file(path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nmtllib C:\\x\\none.mtl\nusemtl a\nf 1 2 3\n", 61));
    CHECK(sup_mesh_read(path, &mesh, &err) == 0 && mesh.triangle_count == 1 && strstr(err.text, "none.mtl") != NULL);
    sup_mesh_free(&mesh);
    sup_mesh_free(&mesh); /* twice is allowed */
    CHECK(!sup_read_file(path, &data, &size, &err) && size == 61 && data[61] == '\0');
    SUP_FREE(data);
    remove(path);
    CHECK_EQ_I64(g_memory.live, 0);
}

TEST(large_file) {
    const char *path = test_temp_path(".obj");
    const size_t lines = 30000;
    FILE *file = fopen(path, "wb");
    sup_mesh mesh;
    sup_error err;
    size_t i;
    REQUIRE(file != NULL);
    for (i = 0; i < lines; i++) fprintf(file, "v %d.5 1 2\n", (int)i);
    for (i = 2; i < lines; i++) fprintf(file, "f %d %d %d\n", (int)i - 1, (int)i, (int)i + 1);
    fclose(file);
    CHECK(!sup_mesh_read(path, &mesh, &err) && mesh.vertex_count == lines && mesh.triangle_count == lines - 2);
    if (mesh.positions) CHECK(mesh.positions[3 * lines - 3] == (float)lines - 0.5f);
    sup_mesh_free(&mesh);
    for (i = 0; i < 8; i++) { /* memory runs out while reading */
        memory_reset((int64_t)i);
        if (sup_mesh_read(path, &mesh, &err)) CHECK(strstr(err.text, "out of memory") != NULL);
        g_memory.fail_at = -1;
        sup_mesh_free(&mesh);
        CHECK_EQ_I64(g_memory.live, 0);
    }
    remove(path);
}

TEST(materials_from_files) {
    char obj[1100], text[256], folder[1024];
    const char *path = test_temp_path(".mtl");
    const char *slash = strrchr(path, '/');
    sup_mesh mesh;
    sup_error err;
    REQUIRE(slash != NULL && strlen(path) < sizeof folder);
    snprintf(obj, sizeof obj, "%s.obj", path);
    REQUIRE(test_write_file(path, "newmtl m\nKd 0 1 0\n", 18));
    snprintf(text, sizeof text, "mtllib D:\\other\\machine\\%.100s\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n",
             slash + 1);
    REQUIRE(test_write_file(obj, text, strlen(text)));
    CHECK(!sup_mesh_read(obj, &mesh, &err));
    CHECK_STR(err.text, "");
    CHECK(mesh.triangle_rgb && mesh.triangle_rgb[0] == 0 && mesh.triangle_rgb[1] == 255);
    sup_mesh_free(&mesh);
    /* a device, a folder: never opened, one would not end */
    snprintf(text, sizeof text, "mtllib ../../../../../../../../../../dev/zero\nmtllib .\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n");
    REQUIRE(test_write_file(obj, text, strlen(text)));
    CHECK(!sup_mesh_read(obj, &mesh, &err));
    CHECK(strstr(err.text, "cannot be read") != NULL && mesh.triangle_count == 1);
    sup_mesh_free(&mesh);
    CHECK(sup_is_plain_file(path));
#if !defined(_WIN32) /* there a folder cannot be opened, and devices have other names */
    CHECK(!sup_is_plain_file("/dev/zero") && !sup_is_plain_file("."));
#endif
    remove(obj);
    remove(path);
}

/* ---- normals and bounds ------------------------------------------------------------------------------------------ */

/* A fan of n triangles around the apex (0, 0, h). split: no vertex is shared. */
static void make_fan(supi_make *make, int n, float h, int split) {
    int i, k;
    memset(make, 0, sizeof *make);
    for (i = split ? 0 : -1; i < n; i++) {
        uint32_t corner[3] = {0, 0, 0};
        for (k = 0; k < 3; k++) {
            const double a = 6.283185307179586 * ((i + (k == 2)) % n) / n;
            if (split && k == 0) corner[0] = supi_make_point(make, 0, 0, h);
            else if (split) corner[k] = supi_make_point(make, (float)cos(a), (float)sin(a), 0);
            else if (i < 0 && k == 0) (void)supi_make_point(make, 0, 0, h);
            else if (i >= 0 && k == 1) (void)supi_make_point(make, (float)cos(a), (float)sin(a), 0);
        }
        if (!split) {
            corner[1] = 1 + (uint32_t)i;
            corner[2] = 1 + (uint32_t)(i + 1) % (uint32_t)n;
        }
        if (i >= 0) supi_make_triangle(make, corner[0], corner[1], corner[2]);
    }
}

TEST(a_million_faces) { /* as text and as bytes; read in time proportional to the file */
    enum { SIDE = 708 }; /* 707^2 squares */
    const size_t side = test_quick() ? 100 : SIDE, squares = (side - 1) * (side - 1);
    char *text = (char *)malloc(side * side * 32 + squares * 32 + 200);
    uint8_t *ply;
    sup_mesh mesh, again;
    sup_error err;
    size_t x, y, n = 0, head;
    REQUIRE(text != NULL);
    for (y = 0; y < side; y++)
        for (x = 0; x < side; x++) n += (size_t)sprintf(text + n, "v %d %d 0.5\n", (int)x, (int)y);
    for (y = 0; y + 1 < side; y++)
        for (x = 0; x + 1 < side; x++) {
            const int a = (int)(y * side + x + 1);
            n += (size_t)sprintf(text + n, "f %d %d %d %d\n", a, a + 1, a + 1 + (int)side, a + (int)side);
        }
    CHECK_MSG(!read_bytes((const uint8_t *)text, n, SUP_FORMAT_OBJ, &mesh, &err), "%s", err.text);
    CHECK_EQ_U64(mesh.vertex_count, side * side);
    CHECK_EQ_U64(mesh.triangle_count, 2 * squares);
    CHECK(mesh_is_valid(&mesh));
    head = (size_t)sprintf(text, "ply\nformat binary_little_endian 1.0\nelement vertex %d\nproperty float x\nproperty float y\n"
                                 "property float z\nelement face %d\nproperty list uchar int vertex_indices\nend_header\n",
                           (int)mesh.vertex_count, (int)mesh.triangle_count);
    n = head + 12 * mesh.vertex_count + 13 * mesh.triangle_count;
    ply = (uint8_t *)malloc(n);
    REQUIRE(ply != NULL);
    memcpy(ply, text, head);
    n = head;
    for (x = 0; x < 3 * mesh.vertex_count; x++, n += 4) {
        uint32_t bits;
        memcpy(&bits, mesh.positions + x, 4);
        for (y = 0; y < 4; y++) ply[n + y] = (uint8_t)(bits >> (8 * y));
    }
    for (x = 0; x < 3 * mesh.triangle_count; x++) {
        if (x % 3 == 0) ply[n++] = 3;
        for (y = 0; y < 4; y++) ply[n++] = (uint8_t)(mesh.indices[x] >> (8 * y));
    }
    CHECK_MSG(!read_bytes(ply, n, SUP_FORMAT_AUTO, &again, &err), "%s", err.text);
    CHECK(again.triangle_count == mesh.triangle_count && again.vertex_count == mesh.vertex_count);
    CHECK(memcmp(again.indices, mesh.indices, 12 * mesh.triangle_count) == 0);
    CHECK(memcmp(again.positions, mesh.positions, 12 * mesh.vertex_count) == 0);
    CHECK(!sup_mesh_compute_normals(&again, &err) && again.vertex_count == mesh.vertex_count && again.normals[2] == 1.0f);
    sup_mesh_free(&mesh);
    sup_mesh_free(&again);
    free(ply);
    free(text);
    CHECK_EQ_I64(g_memory.live, 0);
}

TEST(normals_weigh_angles) { /* a flat pyramid: all of its edges are smooth, however its sides are cut */
    supi_make make;
    sup_error err;
    size_t i, k;
    const float apex[3] = {0, 0, 0.2f}, at[4][3] = {{1, 0, 0}, {0, 1, 0}, {-1, 0, 0}, {0, -1, 0}};
    memset(&make, 0, sizeof make);
    (void)supi_make_vertex(&make, apex, NULL, NULL);
    for (i = 0; i < 4; i++) (void)supi_make_vertex(&make, at[i], NULL, NULL);
    for (i = 0; i < 4; i++) {
        const uint32_t a = (uint32_t)i + 1, b = (uint32_t)(i + 1) % 4 + 1;
        if (i < 3) {
            supi_make_triangle(&make, 0, a, b);
        } else { /* the last side in two, at the middle of its base */
            const float middle[3] = {0.5f, -0.5f, 0};
            const uint32_t m = supi_make_vertex(&make, middle, NULL, NULL);
            supi_make_triangle(&make, 0, a, m);
            supi_make_triangle(&make, 0, m, b);
        }
    }
    REQUIRE(!make.failed && !sup_mesh_compute_normals(&make.mesh, &err));
    CHECK_EQ_U64(make.mesh.vertex_count, 6);
    CHECK_NEAR(make.mesh.normals[2], 1.0, 1e-6);
    for (i = 1; i < 5; i++) {
        const float *n = make.mesh.normals + 3 * i, *p = make.mesh.positions + 3 * i;
        for (k = 0; k < 2; k++) CHECK_NEAR(n[k] * p[k], p[k] * p[k] * sqrtf(1 - n[2] * n[2]), 1e-6);
    }
    sup_mesh_free(&make.mesh);
}

TEST(normals_keep_creases) { /* a box with eight vertices becomes one with 24, each normal along an axis */
    supi_make make;
    const float lo[3] = {-1, -1, -1}, hi[3] = {1, 1, 1};
    const uint8_t rgb[3] = {10, 20, 30};
    sup_error err;
    size_t i, k;
    memset(&make, 0, sizeof make);
    supi_make_box(&make, lo, hi, 0);
    REQUIRE(!make.failed && make.mesh.vertex_count == 8);
    make.mesh.vertex_rgb = (uint8_t *)sup_alloc(8, 3);
    for (i = 0; i < 8; i++) memcpy(make.mesh.vertex_rgb + 3 * i, rgb, 3);
    REQUIRE(!sup_mesh_compute_normals(&make.mesh, &err));
    CHECK_EQ_U64(make.mesh.vertex_count, 24);
    for (i = 0; i < make.mesh.triangle_count; i++) {
        float face[3];
        CHECK(supi_face_normal(&make.mesh, i, face));
        for (k = 0; k < 3; k++) {
            const float *n = make.mesh.normals + 3 * (size_t)make.mesh.indices[3 * i + k];
            CHECK(n[0] == face[0] && n[1] == face[1] && n[2] == face[2]);
        }
    }
    for (i = 0; i < 24; i++) CHECK(memcmp(make.mesh.vertex_rgb + 3 * i, rgb, 3) == 0);
    REQUIRE(!sup_mesh_compute_normals(&make.mesh, &err)); /* once more changes nothing */
    CHECK_EQ_U64(make.mesh.vertex_count, 24);
    sup_mesh_free(&make.mesh);
}

TEST(normals_across_repeated_vertices) { /* what shares a place shares a normal, whether or not it shares an index */
    static const struct { int n; float h; size_t copies; } fans[4] = {
        {64, 0.5f, 0},    /* steep, but from one side to the next nearly flat */
        {6, 0.2f, 0}, {4, 0.5f, 0},
        {4, 3.0f, 7}      /* sides turn by 84 degrees: four copies of the apex but one, one of each corner */
    };
    size_t f, i, k;
    for (f = 0; f < 4; f++) {
        supi_make whole, split;
        sup_error err;
        size_t before;
        make_fan(&whole, fans[f].n, fans[f].h, 0);
        make_fan(&split, fans[f].n, fans[f].h, 1);
        REQUIRE(!whole.failed && !split.failed);
        REQUIRE(whole.mesh.triangle_count == split.mesh.triangle_count);
        before = split.mesh.vertex_count;
        REQUIRE(!sup_mesh_compute_normals(&whole.mesh, &err) && !sup_mesh_compute_normals(&split.mesh, &err));
        CHECK_EQ_U64(whole.mesh.vertex_count, (size_t)fans[f].n + 1 + fans[f].copies);
        CHECK_EQ_U64(split.mesh.vertex_count, before); /* enough vertices for everything */
        for (i = 0; i < 3 * whole.mesh.triangle_count; i++) {
            const float *a = whole.mesh.normals + 3 * (size_t)whole.mesh.indices[i];
            const float *b = split.mesh.normals + 3 * (size_t)split.mesh.indices[i];
            for (k = 0; k < 3; k++) CHECK(a[k] == b[k]);
        }
        sup_mesh_free(&whole.mesh);
        sup_mesh_free(&split.mesh);
    }
    CHECK_EQ_I64(g_memory.live, 0);
}

TEST(normals_without_memory) { /* fails wherever it can, and leaves the mesh as it was */
    const float lo[3] = {-1, -1, -1}, hi[3] = {1, 1, 1};
    int64_t k = 0;
    int failed = 1;
    for (; failed; k++) {
        supi_make make;
        sup_error err;
        uint32_t indices[36];
        memset(&make, 0, sizeof make);
        supi_make_box(&make, lo, hi, 0);
        REQUIRE(!make.failed && make.mesh.triangle_count == 12);
        memcpy(indices, make.mesh.indices, sizeof indices);
        memory_reset(k);
        failed = sup_mesh_compute_normals(&make.mesh, &err);
        g_memory.fail_at = -1;
        if (failed) {
            CHECK_STR(err.text, "out of memory for normals of 8 vertices");
            CHECK(make.mesh.normals == NULL && make.mesh.vertex_count == 8);
            CHECK(memcmp(make.mesh.indices, indices, sizeof indices) == 0);
        }
        sup_mesh_free(&make.mesh);
    }
    CHECK(k > 12);
    CHECK_EQ_I64(g_memory.live, 0);
}

TEST(normals_edge_cases) {
    float positions[] = {0, 0, 0, 1, 0, 0, 0,      1, 0, NAN, 0,      0, 2,     0, 0, INFINITY, 1, 1,
                         9, 9, 9, 0, 0, 0, 1e-20f, 0, 0, 0,   1e-20f, 0, 3e38f, 0, 0, 0,        0, 3e38f};
    uint32_t indices[] = {0, 0, 1, 0, 1, 4, 0, 1, 3, 0, 1, 5, 1, 1, 1, 7, 8, 9, 0, 10, 11, 0, 1, 2, 2, 1, 0};
    uint32_t bad[] = {0, 1, 12};
    sup_mesh mesh;
    sup_error err;
    size_t i;
    memset(&mesh, 0, sizeof mesh);
    mesh.positions = positions;
    mesh.indices = indices;
    mesh.vertex_count = 12;
    mesh.triangle_count = 9;
    REQUIRE(!supi_compute_normals(&mesh, -2.0, &err)); /* the arrays are not from the heap: no copies of vertices */
    for (i = 0; i < 12; i++) {
        const float *n = mesh.normals + 3 * i;
        CHECK_NEAR(length2(n), 1.0, 1e-5);
    }
    CHECK(mesh.normals[3 * 6 + 1] == 1.0f);  /* nothing around it */
    CHECK(mesh.normals[3 * 8 + 2] == 1.0f);  /* a tiny triangle counts like any other */
    CHECK(mesh.normals[3 * 11 + 1] < -0.9f); /* and a huge one */
    mesh.indices = bad;
    mesh.triangle_count = 1;
    CHECK(sup_mesh_compute_normals(&mesh, &err) == 1);
    CHECK_STR(err.text, "triangle 0: index 12 out of range");
    SUP_FREE(mesh.normals);
}

TEST(bounds) {
    float positions[] = {NAN, 0, 0, 1, 2, 3, -1, INFINITY, 0, -4, 5, -6};
    float lo[3], hi[3];
    sup_mesh mesh;
    memset(&mesh, 0, sizeof mesh);
    CHECK(sup_mesh_bounds(&mesh, lo, hi) == 1 && lo[0] == 0.0f && hi[2] == 0.0f);
    mesh.positions = positions;
    mesh.vertex_count = 1;
    CHECK(sup_mesh_bounds(&mesh, lo, hi) == 1);
    mesh.vertex_count = 4;
    CHECK(sup_mesh_bounds(&mesh, lo, hi) == 0);
    CHECK(lo[0] == -4.0f && lo[1] == 2.0f && lo[2] == -6.0f && hi[0] == 1.0f && hi[1] == 5.0f && hi[2] == 3.0f);
}

/* ---- real files -------------------------------------------------------------------------------------------------- */

TEST(real_meshes) {
    static const struct {
        const char *name;
        size_t vertices, triangles;
        int normals, colours;
        float size[3];
    } files[] = {{"meshes/stanford-bunny.obj", 35947, 69451, 0, 0, {0.155699f, 0.154334f, 0.120674f}},
                 {"meshes/dragon_res3.ply", 22998, 47794, 0, 0, {0.2036555f, 0.1438697f, 0.0908772f}},
                 {"meshes/horse.ply", 48485, 96966, 0, 1, {0.084006f, 0.183341f, 0.152836f}},
                 {"meshes/rocker-arm.obj", 10044, 20088, 0, 0, {0.303466f, 0.514912f, 1.0f}},
                 {"meshes/spot.obj", 2930, 5856, 0, 0, {0.943104f, 1.690436f, 1.717909f}},
                 {"meshes/suzanne.obj", 507, 968, 1, 0, {2.734372f, 1.968749f, 1.703118f}},
                 {"meshes/teapot.obj", 3644, 6320, 0, 0, {6.434f, 3.15f, 4.0f}}};
    size_t i, k, seen = 0;
    for (i = 0; i < sizeof files / sizeof files[0]; i++) {
        const char *path = test_data_path(files[i].name);
        sup_mesh mesh;
        sup_error err;
        float lo[3], hi[3];
        if (!path) continue;
        seen++;
        CHECK_MSG(!sup_mesh_read(path, &mesh, &err), "%s", err.text);
        CHECK_MSG(err.text[0] == '\0', "%s", err.text);
        CHECK_MSG(mesh.vertex_count == files[i].vertices && mesh.triangle_count == files[i].triangles,
                  "%s: %d vertices, %d triangles", files[i].name, (int)mesh.vertex_count, (int)mesh.triangle_count);
        CHECK((mesh.normals != NULL) == files[i].normals && (mesh.vertex_rgb != NULL) == files[i].colours &&
              mesh.skipped_faces == 0);
        CHECK(mesh_is_valid(&mesh));
        CHECK(!sup_mesh_bounds(&mesh, lo, hi));
        for (k = 0; k < 3; k++) CHECK_NEAR(hi[k] - lo[k], files[i].size[k], 1e-5);
        if (files[i].colours) { /* the horse is white */
            for (k = 0; k < 3 * mesh.vertex_count && mesh.vertex_rgb[k] == 255; k++) {}
            CHECK_EQ_U64(k, 3 * mesh.vertex_count);
        }
        if (files[i].normals) { /* what the file says and what the shape says agree roughly */
            float *given = mesh.normals;
            double agree = 0;
            mesh.normals = NULL;
            CHECK(!supi_compute_normals(&mesh, -2.0, &err)); /* the file has no sharp edges */
            for (k = 0; k < 3 * mesh.vertex_count; k++) agree += (double)given[k] * (double)mesh.normals[k];
            CHECK(agree / (double)mesh.vertex_count > 0.95);
            SUP_FREE(given);
        }
        sup_mesh_free(&mesh);
    }
    CHECK_EQ_I64(g_memory.live, 0);
    if (!seen) SKIP("no test data: set RENDER_DATA");
    CHECK(seen == sizeof files / sizeof files[0]);
}

/* ---- PNG and PFM ------------------------------------------------------------------------------------------------- */

static void check_png(const void *pixels, uint32_t width, uint32_t height, uint32_t channels, uint32_t bits,
                      size_t stride, png_picture *out) {
    sup_picture picture;
    sup_error err;
    uint8_t *file;
    size_t size, y, i, n = (size_t)width * channels * (bits / 8);
    const char *wrong;
    int differs = 0;
    memset(&picture, 0, sizeof picture);
    memset(out, 0, sizeof *out);
    picture.pixels = pixels;
    picture.width = width;
    picture.height = height;
    picture.channels = channels;
    picture.bits = bits;
    picture.stride = stride;
    CHECK_MSG(!sup_png_encode(&picture, &file, &size, &err), "%s", err.text);
    if (!file) return;
    wrong = png_read(file, size, out);
    CHECK_MSG(!wrong, "%ux%u, %u channels, %u bits: %s", (unsigned)width, (unsigned)height, (unsigned)channels,
              (unsigned)bits, wrong);
    if (!wrong) {
        CHECK(out->width == width && out->height == height && out->channels == channels && out->bits == bits);
        for (y = 0; y < height; y++) {
            const uint8_t *row = (const uint8_t *)pixels + y * (stride ? stride : n), *got = out->bytes + y * n;
            if (bits == 8) {
                differs |= memcmp(row, got, n) != 0;
            } else {
                for (i = 0; i < n; i += 2) {
                    uint16_t value;
                    memcpy(&value, row + i, 2);
                    differs |= value != (uint16_t)(got[i] << 8 | got[i + 1]);
                }
            }
        }
        CHECK_MSG(!differs, "%ux%u, %u channels, %u bits: other pixels", (unsigned)width, (unsigned)height,
                  (unsigned)channels, (unsigned)bits);
        free(out->bytes);
        out->bytes = NULL;
        out->row_bytes = size; /* for the caller: size of the file */
    }
    SUP_FREE(file);
}

/* Kinds of pictures: flat, noise, gradient, smooth with noise, few colours, repeated tiles, nearly zero. */
static void fill_picture(uint8_t *p, size_t n, uint32_t width, uint32_t step, int kind, uint64_t seed) {
    test_rng rng = test_rng_make(seed);
    size_t i;
    for (i = 0; i < n; i++) {
        const size_t x = i / step % width, y = i / step / width;
        uint8_t v = 77;
        if (kind == 1) v = (uint8_t)test_rng_u32(&rng);
        if (kind == 2) v = (uint8_t)(x * 3 + y * 2 + i % step * 40);
        if (kind == 3)
            v = (uint8_t)(128.0 + 100.0 * sin((double)x * 0.05) * cos((double)y * 0.07) +
                          (double)test_rng_below(&rng, 4));
        if (kind == 4) v = (uint8_t)(test_rng_below(&rng, 3) * 90);
        if (kind == 5) v = (uint8_t)((x % 13 * 17) ^ (y % 11 * 29));
        if (kind == 6) v = (uint8_t)(test_rng_below(&rng, 200) == 0);
        p[i] = v;
    }
}

TEST(png_round_trips) {
    static const uint32_t sizes[][2] = {{1, 1},   {2, 1},  {1, 2},  {3, 5},    {7, 3},
                                        {16, 16}, {64, 1}, {1, 64}, {257, 33}, {100, 300}};
    uint8_t *pixels = (uint8_t *)malloc(300 * 100 * 8);
    uint32_t kinds[3] = {0, 0, 0}, filters[5] = {0, 0, 0, 0, 0};
    size_t s, k;
    uint32_t channels, bits;
    int kind;
    REQUIRE(pixels != NULL);
    for (s = 0; s < sizeof sizes / sizeof sizes[0]; s++) {
        for (channels = 1; channels <= 4; channels++) {
            for (bits = 8; bits <= 16; bits += 8) {
                for (kind = 0; kind < 7; kind++) {
                    const uint32_t step = channels * bits / 8;
                    png_picture got;
                    fill_picture(pixels, (size_t)sizes[s][0] * sizes[s][1] * step, sizes[s][0], step, kind, s);
                    check_png(pixels, sizes[s][0], sizes[s][1], channels, bits, 0, &got);
                    for (k = 0; k < 3; k++) kinds[k] += got.block_kinds[k];
                    for (k = 0; k < 5; k++) filters[k] += got.filters[k];
                }
            }
        }
    }
    for (k = 0; k < 3; k++) CHECK_MSG(kinds[k] > 0, "no deflate block of kind %d", (int)k);
    for (k = 0; k < 5; k++) CHECK_MSG(filters[k] > 0, "no row with filter %d", (int)k);
    free(pixels);
    CHECK_EQ_I64(g_memory.live, 0);
}

TEST(png_large_and_strided) {
    const uint32_t width = 700, height = 500;
    const size_t n = (size_t)width * height * 4;
    uint8_t *pixels = (uint8_t *)malloc(n);
    png_picture got;
    int kind;
    REQUIRE(pixels != NULL);
    for (kind = 0; kind < 7; kind++) { /* many blocks */
        fill_picture(pixels, n, width, 4, kind, 99);
        check_png(pixels, width, height, 4, 8, 0, &got);
        if (kind == 0) CHECK_MSG(got.row_bytes < n / 300, "flat picture: %d bytes", (int)got.row_bytes);
        if (kind == 1) CHECK_MSG(got.row_bytes < n + n / 500 + 200, "noise: %d bytes", (int)got.row_bytes);
        if (kind == 3) CHECK_MSG(got.row_bytes < n / 2, "smooth picture: %d bytes", (int)got.row_bytes);
        if (kind == 5) CHECK_MSG(got.row_bytes < n / 30, "tiles: %d bytes", (int)got.row_bytes);
    }
    fill_picture(pixels, n, width, 4, 3, 5);
    check_png(pixels, 333, 250, 3, 8, 2800, &got); /* a part of a larger picture */
    check_png(pixels + 2, 333, 250, 1, 16, 1402, &got);
    free(pixels);
}

TEST(png_rejects) {
    static const uint8_t pixel[32] = {0};
    const char *path = test_temp_path(".png");
    sup_picture good, p;
    sup_error err;
    uint8_t *data;
    size_t size;
    int64_t k;
    int failed = 1;
    memset(&good, 0, sizeof good);
    good.pixels = pixel;
    good.width = good.height = 1;
    good.channels = 4;
    good.bits = 8;
#define REJECT(change)                                                                                                 \
    p = good;                                                                                                          \
    change;                                                                                                            \
    CHECK(sup_png_encode(&p, &data, &size, &err) == 1 && !data && size == 0 && err.text[0])
    REJECT(p.height = 0);
    REJECT(p.width = 0);
    REJECT(p.pixels = NULL);
    REJECT(p.channels = 0);
    REJECT(p.channels = 5);
    REJECT(p.bits = 1);
    REJECT(p.bits = 32);
    REJECT(p.stride = 3);
    REJECT((p.width = 0xffffffffu, p.height = 0xffffffffu));
    REJECT((p.width = 1, p.height = 0xffffffffu));
    REJECT((p.width = 0xffffffffu, p.bits = 16));
#undef REJECT
    for (k = 0; failed && k < 50; k++) {
        memory_reset(k);
        failed = sup_png_encode(&good, &data, &size, &err);
        g_memory.fail_at = -1;
        SUP_FREE(data);
        CHECK_EQ_I64(g_memory.live, 0);
    }
    CHECK(!failed && k > 3);
    CHECK(sup_png_write("/nonexistent/x.png", &good, &err) == 1 &&
          strstr(err.text, "/nonexistent/x.png: ") == err.text);
    p = good;
    p.bits = 3;
    CHECK(sup_png_write(path, &p, &err) == 1 && strstr(err.text, path) == err.text);
    CHECK(test_read_file(path, &size) == NULL); /* no file */
    REQUIRE(!sup_png_write(path, &good, &err));
    CHECK(!sup_png_write8(path, pixel, 2, 1, 3, &err)); /* replaces */
    data = test_read_file(path, &size);
    CHECK(data != NULL && size > 60 && data[19] == 2);
    free(data);
    remove(path);
    CHECK_EQ_I64(g_memory.live, 0);
}

TEST(png_is_deterministic) {
    uint8_t pixels[64 * 64 * 4];
    sup_picture p;
    sup_error err;
    uint8_t *a, *b;
    size_t na, nb;
    memset(&p, 0, sizeof p);
    p.pixels = pixels;
    p.width = p.height = 64;
    p.channels = 4;
    p.bits = 8;
    fill_picture(pixels, sizeof pixels, 64, 4, 3, 1);
    REQUIRE(!sup_png_encode(&p, &a, &na, &err) && !sup_png_encode(&p, &b, &nb, &err));
    CHECK(na == nb && memcmp(a, b, na) == 0);
    SUP_FREE(a);
    SUP_FREE(b);
}

TEST(check_sums) {
    CHECK_EQ_U64(supi_crc32((const uint8_t *)"123456789", 9), 0xcbf43926u);
    CHECK_EQ_U64(supi_crc32((const uint8_t *)"", 0), 0);
    CHECK_EQ_U64(supi_adler32((const uint8_t *)"Wikipedia", 9), 0x11e60398u);
    CHECK_EQ_U64(supi_adler32((const uint8_t *)"", 0), 1);
}

/* Frequencies that want long codes: the lengths must keep the limit, be complete, and cost hardly more. */
TEST(huffman_lengths) {
    static const size_t counts[] = {286, 30, 19};
    static const unsigned limits[] = {15, 15, 7};
    test_rng rng = test_rng_make(12);
    size_t c, i, j;
    int round;
    for (c = 0; c < 3; c++) {
        for (round = 0; round < 300; round++) {
            uint32_t freq[286];
            uint8_t lengths[286];
            double sum = 0, entropy = 0, cost = 0, total = 0;
            const size_t n = counts[c];
            size_t used = 0;
            for (i = 0; i < n; i++) {
                if (round == 0)
                    freq[i] = i < 2 ? 1 : i < 40 ? freq[i - 1] + freq[i - 2] : 0; /* Fibonacci: the deepest tree */
                else if (round == 1) freq[i] = 0;
                else if (round == 2) freq[i] = i == 3;
                else if (round == 3) freq[i] = 1;
                else freq[i] = test_rng_below(&rng, 3) ? test_rng_u32(&rng) >> (8 + test_rng_below(&rng, 24)) : 0;
            }
            supi_code_lengths(freq, n, limits[c], lengths);
            for (i = 0; i < n; i++) {
                used += lengths[i] != 0;
                CHECK((lengths[i] != 0) == (freq[i] != 0) && lengths[i] <= limits[c]);
                if (lengths[i]) sum += 1.0 / (double)(1u << lengths[i]);
                total += freq[i];
                cost += (double)freq[i] * lengths[i];
                for (j = 0; j < n && round < 20; j++)
                    CHECK(!(lengths[i] && lengths[j] && freq[i] > freq[j] && lengths[i] > lengths[j]));
            }
            CHECK(sum == 1.0 && used >= 2);
            for (i = 0; i < n; i++) entropy += freq[i] ? (double)freq[i] * log(total / (double)freq[i]) / log(2.0) : 0;
            if (c < 2) CHECK_MSG(cost <= entropy + total + 1, "cost %g, entropy %g", cost / total, entropy / total);
        }
    }
}

TEST(pfm) {
    const float pixels[12] = {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, INFINITY};
    const char *path = test_temp_path(".pfm");
    sup_error err;
    uint8_t *data;
    size_t size;
    REQUIRE(!sup_pfm_write(path, pixels, 2, 2, 3, &err));
    data = test_read_file(path, &size);
    REQUIRE(data != NULL);
    CHECK(size == 12 + 48 && memcmp(data, "PF\n2 2\n-1.0\n", 12) == 0);
    CHECK(memcmp(data + 12, "\0\0\340\100", 4) == 0); /* 7, little-endian: the lower row first */
    CHECK(memcmp(data + 12 + 24, "\0\0\200\077", 4) == 0);
    free(data);
    REQUIRE(!sup_pfm_write(path, pixels, 3, 2, 1, &err));
    data = test_read_file(path, &size);
    REQUIRE(data != NULL);
    CHECK(size == 12 + 24 && memcmp(data, "Pf\n3 2\n-1.0\n", 12) == 0);
    free(data);
    remove(path);
    CHECK(sup_pfm_write(path, pixels, 0, 2, 1, &err) && sup_pfm_write(path, pixels, 2, 0, 1, &err) &&
          sup_pfm_write(path, pixels, 2, 2, 2, &err));
    CHECK(sup_pfm_write("/nonexistent/x", pixels, 2, 2, 1, &err) && strstr(err.text, "/nonexistent/x"));
    CHECK(test_read_file(path, &size) == NULL);
    CHECK_EQ_I64(g_memory.live, 0);
}

TEST(files_appear_whole) {
    const char *path = test_temp_path(".txt");
    sup_file file;
    sup_error err;
    unsigned char *data;
    size_t size;
    REQUIRE(!sup_write_file(path, "old", 3, &err));
    REQUIRE(!sup_file_open(path, &file, &err));
    fprintf(file.stream, "half of");
    fflush(file.stream);
    data = test_read_file(path, &size);
    CHECK(data && size == 3); /* the old one is untouched */
    free(data);
    sup_file_abort(&file);
    data = test_read_file(path, &size);
    CHECK(data && memcmp(data, "old", 3) == 0);
    free(data);
    REQUIRE(!sup_file_open(path, &file, &err));
    fprintf(file.stream, "new!");
    CHECK(!sup_file_commit(&file, &err));
    data = test_read_file(path, &size);
    CHECK(data && size == 4 && memcmp(data, "new!", 4) == 0);
    free(data);
    remove(path);
    CHECK_EQ_I64(g_memory.live, 0);
#if !defined(_WIN32)
    data = test_read_file("/dev/full", &size); /* a device without room, where there is one */
    free(data);
    if (data == NULL) return;
    REQUIRE(!sup_file_open(path, &file, &err));
    file.stream = freopen("/dev/full", "wb", file.stream);
    REQUIRE(file.stream != NULL);
    fprintf(file.stream, "does not fit");
    CHECK(sup_file_commit(&file, &err) == 1 && strstr(err.text, path) == err.text);
    CHECK(test_read_file(path, &size) == NULL);
    CHECK_EQ_I64(g_memory.live, 0);
    /* devices and links are written to, not replaced by a file */
    CHECK(sup_is_special_file("/dev/full") && !sup_is_special_file(path) && !sup_is_special_file("."));
    CHECK(sup_write_file("/dev/full", "does not fit", 12, &err) == 1 && strstr(err.text, "/dev/full") == err.text);
    CHECK(sup_is_special_file("/dev/full"));
    CHECK(!sup_write_file("/dev/null", "gone", 4, &err) && sup_is_special_file("/dev/null"));
    CHECK(!sup_file_open("/dev/null", &file, &err));
    sup_file_abort(&file);
    CHECK(sup_is_special_file("/dev/null"));
    CHECK_EQ_I64(g_memory.live, 0);
#endif
}

TEST(colours) {
    float linear[8] = {0.5f, 0.25f, 0, 0.5f, 2, NAN, -1, 3};
    uint8_t bytes[8];
    int i;
    for (i = 0; i < 256; i++)
        CHECK_EQ_I64((int)(sup_srgb_from_linear(sup_linear_from_srgb((uint8_t)i)) * 255.0f + 0.5f), i);
    sup_rgba8_from_linear(linear, bytes, 2);
    CHECK(bytes[0] == 255 && bytes[1] == 188 && bytes[2] == 0 && bytes[3] == 128);
    CHECK(bytes[4] == 213 && bytes[5] == 0 && bytes[6] == 0 && bytes[7] == 255);
    linear[3] = 0;
    sup_rgba8_from_linear(linear, bytes, 1);
    CHECK(bytes[0] == 0 && bytes[3] == 0);
}

/* ---- command line ------------------------------------------------------------------------------------------------ */

typedef struct line {
    sup_common common;
    const char *in, *out;
    int64_t count;
    int fast, mode;
} line;

static int parse_line(line *l, const char *arguments) { /* words separated by one blank; "" is no word */
    static char text[512];
    char *argv[32];
    char name[] = "prog";
    int argc = 1;
    char *word;
    sup_option options[SUP_COMMON_OPTIONS + 5];
    size_t n;
    memset(l, 0, sizeof *l);
    snprintf(text, sizeof text, "%s", arguments);
    argv[0] = name;
    for (word = strtok(text, " "); word && argc < 32; word = strtok(NULL, " ")) argv[argc++] = word;
    n = sup_common_options(&l->common, options);
    options[n++] = sup_opt_positional("IN", &l->in, 1, "input");
    options[n++] = sup_opt_positional("OUT", &l->out, 0, "output");
    options[n++] = sup_opt_int("count", &l->count, -5, 10, "N", "how many");
    options[n++] = sup_opt_flag("fast", &l->fast, "faster");
    options[n++] = sup_opt_choice("mode", &l->mode, "alpha|beta|gamma", "which");
    return sup_cli_parse(argc, argv, "Tests.", options, n);
}

TEST(command_lines) {
    static const char *const wrong[] = {"",
                                        "--fast",
                                        "in out more",
                                        "in --unknown",
                                        "in --coun 3",
                                        "in --counter 3",
                                        "in -x",
                                        "in --count",
                                        "in --count x",
                                        "in --count 3.5",
                                        "in --count 11",
                                        "in --count -6",
                                        "in --count 99999999999999999999",
                                        "in --count --fast",
                                        "in --count= --fast",
                                        "in --fast=1",
                                        "in --mode delta",
                                        "in --mode alph",
                                        "in --mode alpha|beta",
                                        "in --mode",
                                        "in --size 640",
                                        "in --size 0x480",
                                        "in --size 640x",
                                        "in --size 640x480x2",
                                        "in --size 65536x1",
                                        "in --size -1x1",
                                        "in --size 1e3x1",
                                        "in --eye 1,2",
                                        "in --eye 1,2,3,4",
                                        "in --eye 1,2,nan",
                                        "in --eye 1,,2",
                                        "in --eye a,b,c",
                                        "in --fov 0",
                                        "in --fov 180",
                                        "in --fov nan",
                                        "in --fov inf",
                                        "in --tolerance -1",
                                        "in --threads -1",
                                        "in --isa mmx",
                                        "in --seed -1",
                                        "in --out"};
    line l;
    size_t i;
    for (i = 0; i < sizeof wrong / sizeof wrong[0]; i++)
        CHECK_MSG(parse_line(&l, wrong[i]) == 2, "\"%s\" was accepted", wrong[i]);
    CHECK(parse_line(&l, "in") == -1);
    CHECK_STR(l.in, "in");
    CHECK(!l.out && l.common.size[0] == 1312 && l.common.size[1] == 640 && !l.common.has_eye && !l.common.out &&
          l.common.isa == SUP_ISA_AUTO);
    CHECK(parse_line(&l, "--size=320x200 a --count -5 --eye -1,2.5,-3e2 b --fast --mode gamma --isa avx2 --out - "
                         "--tolerance .25 --seed 7 --stats --quiet --unlit --depth=d=e.pfm") == -1);
    CHECK_STR(l.in, "a");
    CHECK_STR(l.out, "b");
    CHECK_STR(l.common.out, "-");
    CHECK_STR(l.common.depth, "d=e.pfm");
    CHECK(l.common.size[0] == 320 && l.common.size[1] == 200 && l.common.has_size && l.count == -5 && l.fast == 1 &&
          l.mode == 2);
    CHECK(l.common.has_eye && l.common.camera.eye[0] == -1.0f && l.common.camera.eye[2] == -300.0f && !l.common.has_at);
    CHECK(l.common.isa == SUP_ISA_AVX2 && l.common.tolerance == 0.25 && l.common.has_tolerance && l.common.seed == 7 &&
          l.common.stats && l.common.quiet && l.common.unlit);
    CHECK(parse_line(&l, "--count 1 --count=2 -- --fast") == -1); /* the last one counts; behind -- no options */
    CHECK_EQ_I64(l.count, 2);
    CHECK_STR(l.in, "--fast");
    CHECK(!l.fast);
    CHECK(parse_line(&l, "-") == -1);
    CHECK_STR(l.in, "-");
    CHECK(parse_line(&l, "--nonsense --help") == 0);
}

TEST(choices) {
    CHECK_EQ_I64(sup_parse_choice("a", "a|bc|d"), 0);
    CHECK_EQ_I64(sup_parse_choice("bc", "a|bc|d"), 1);
    CHECK_EQ_I64(sup_parse_choice("d", "a|bc|d"), 2);
    CHECK_EQ_I64(sup_parse_choice("b", "a|bc|d"), -1);
    CHECK_EQ_I64(sup_parse_choice("", "a|bc|d"), -1);
}

TEST(clock_and_progress) {
    const double a = sup_now();
    sup_progress progress;
    sup_progress_begin(&progress, "test", 1);
    CHECK(sup_progress_fn(&progress, 1, 0) == 0);
    sup_progress_end(&progress);
    CHECK(sup_now() >= a && sup_now() - a < 60.0);
}

/* ---- camera ------------------------------------------------------------------------------------------------------ */

static void check_frame(const sup_view *view) {
    double right[3];
    supi_cross(view->forward, view->up, right);
    CHECK_NEAR(supi_dot(view->forward, view->forward), 1, 1e-12);
    CHECK_NEAR(supi_dot(view->up, view->up), 1, 1e-12);
    CHECK_NEAR(supi_dot(right, view->right), 1, 1e-12);
}

TEST(camera_frames_boxes) {
    static const float ups[][3] = {{0, 1, 0}, {0, 0, 1}, {1, 0, 0}, {0, -1, 0}, {0, 0, 0}, {1, 2, 3}, {NAN, 0, 0}};
    test_rng rng = test_rng_make(5);
    int i, k, c;
    for (i = 0; i < 2000; i++) {
        sup_camera camera;
        sup_view view;
        float lo[3], hi[3];
        const double aspect = exp((double)test_rng_range(&rng, -1.5f, 1.5f));
        double fill = 0;
        memset(&camera, 0, sizeof camera);
        memcpy(camera.up, ups[i % 7], sizeof camera.up);
        camera.fov = test_rng_range(&rng, 5.0f, 120.0f);
        for (k = 0; k < 3; k++) {
            const float scale = i % 11 == 0 ? 1e-3f : 10.0f;
            lo[k] = test_rng_range(&rng, -scale, scale);
            hi[k] = lo[k] +
                    (test_rng_below(&rng, 5) ? test_rng_range(&rng, 0.0f, 5.0f * scale) : 0.0f); /* some are flat */
        }
        sup_camera_frame(&camera, lo, hi, aspect);
        sup_camera_view(&camera, &view);
        check_frame(&view);
        for (c = 0; c < 8; c++) {
            double d[3], z, x, y;
            for (k = 0; k < 3; k++) d[k] = (double)((c >> k) & 1 ? hi[k] : lo[k]) - (double)camera.eye[k];
            z = supi_dot(d, view.forward) * view.tangent;
            x = fabs(supi_dot(d, view.right)) / (z * aspect);
            y = fabs(supi_dot(d, view.up)) / z;
            CHECK(z > 0 && x < 1 && y < 1);
            fill = x > fill ? x : fill;
            fill = y > fill ? y : fill;
        }
        if (hi[0] - lo[0] + hi[1] - lo[1] + hi[2] - lo[2] > 0.0f)
            CHECK_MSG(fill > 0.6, "the box fills only %.2f of the picture", fill);
        CHECK_NEAR(camera.at[1], 0.5f * (lo[1] + hi[1]), 1e-4);
        if (i % 7 == 0) CHECK(camera.eye[1] > camera.at[1] && camera.eye[2] > camera.at[2]);
    }
}

TEST(camera_edge_cases) {
    const float inf_lo[3] = {-INFINITY, 0, 0}, inf_hi[3] = {0, NAN, 1}, none_lo[3] = {1, 1, 1}, none_hi[3] = {0, 0, 0},
                point[3] = {5, 6, 7};
    sup_camera camera;
    sup_view view;
    sup_common common;
    sup_option options[SUP_COMMON_OPTIONS];
    float org[3], dir[3];
    int k;
    memset(&camera, 0, sizeof camera); /* eye = at, no up, no angle */
    sup_camera_view(&camera, &view);
    check_frame(&view);
    camera.fov = 60;
    camera.up[1] = 1;
    camera.at[1] = -3; /* straight down */
    sup_camera_view(&camera, &view);
    check_frame(&view);
    sup_camera_frame(&camera, inf_lo, inf_hi, 1.0);
    for (k = 0; k < 3; k++) CHECK(fabsf(camera.eye[k]) < 10.0f && camera.at[k] == 0.0f);
    sup_camera_frame(&camera, none_lo, none_hi, (double)NAN);
    for (k = 0; k < 3; k++) CHECK(fabsf(camera.eye[k]) < 10.0f);
    sup_camera_frame(&camera, point, point, 2.0);
    CHECK(camera.at[0] == 5.0f && camera.at[2] == 7.0f && camera.eye[2] > 7.0f);
    /* rays: the middle of the picture is the axis; the corners are at the angles asked for; depth is t */
    memset(&camera, 0, sizeof camera);
    camera.eye[2] = 4;
    camera.up[1] = 1;
    camera.fov = 90;
    sup_camera_view(&camera, &view);
    sup_camera_ray(&camera, &view, 200, 100, 100, 50, org, dir);
    CHECK(org[2] == 4.0f && fabsf(dir[0]) < 1e-6f && fabsf(dir[1]) < 1e-6f && dir[2] == -1.0f);
    sup_camera_ray(&camera, &view, 200, 100, 0, 0, org, dir);
    CHECK_NEAR(dir[0], -2, 1e-6);
    CHECK_NEAR(dir[1], 1, 1e-6);
    CHECK_NEAR(dir[2], -1, 1e-6);
    /* options: what is given stays, what is not frames */
    CHECK(sup_common_options(&common, options) == SUP_COMMON_OPTIONS);
    sup_common_camera(&common, none_hi, none_lo, &camera);
    CHECK(camera.at[0] == 0.5f && camera.fov == 40.0f);
    common.has_eye = 1;
    common.camera.eye[0] = 9;
    sup_common_camera(&common, none_hi, none_lo, &camera);
    CHECK(camera.at[0] == 0.5f && camera.eye[0] == 9.0f && camera.eye[1] == 0.0f);
    common.has_eye = 0;
    common.has_at = 1;
    sup_common_camera(&common, none_hi, none_lo, &camera);
    CHECK(camera.at[0] == 0.0f && camera.eye[2] > 0.5f);
}

/* ---- scenes ------------------------------------------------------------------------------------------------------ */

static int compare_u64(const void *a, const void *b) {
    uint64_t x, y;
    memcpy(&x, a, sizeof x);
    memcpy(&y, b, sizeof y);
    return x < y ? -1 : x > y;
}

/* How many edges do not have as many triangles on one side as on the other, by index; 0: closed and well oriented. */
static size_t open_edges(const sup_mesh *mesh) {
    const size_t n = 3 * mesh->triangle_count;
    uint64_t *edges = (uint64_t *)malloc(n * sizeof *edges + 1);
    size_t i, bad = 0;
    for (i = 0; i < n; i++) {
        const uint64_t a = mesh->indices[i], b = mesh->indices[i % 3 == 2 ? i - 2 : i + 1];
        edges[i] = a < b ? (a << 32 | b) << 1 : (b << 32 | a) << 1 | 1;
    }
    qsort(edges, n, sizeof *edges, compare_u64);
    for (i = 0; i < n;) {
        const uint64_t edge = edges[i] >> 1;
        int64_t balance = 0;
        for (; i < n && edges[i] >> 1 == edge; i++) balance += edges[i] & 1 ? 1 : -1;
        bad += balance != 0;
    }
    free(edges);
    return bad;
}

static double volume(const sup_mesh *mesh) {
    double sum = 0;
    size_t t, k;
    for (t = 0; t < mesh->triangle_count; t++) {
        double p[3][3], normal[3];
        for (k = 0; k < 9; k++)
            p[k / 3][k % 3] = (double)mesh->positions[3 * (size_t)mesh->indices[3 * t + k / 3] + k % 3];
        supi_cross(p[1], p[2], normal);
        sum += supi_dot(p[0], normal) / 6.0;
    }
    return sum;
}

TEST(scenes) {
    static const struct {
        const char *name;
        int detail;
        size_t least, most;
        int closed, normals, vertex_rgb, triangle_rgb;
        double volume;
    } list[] = {{"sphere", 0, 16128, 16128, 1, 1, 0, 0, 4.1846},
                {"sphere", 2, 8, 8, 1, 1, 0, 0, 4.0 / 3.0},
                {"torus", 0, 13824, 13824, 1, 1, 0, 0, 3.148},
                {"torus", 3, 54, 54, 1, 1, 0, 0, 0},
                {"gyroid", 0, 300000, 350000, 1, 1, 0, 0, 1.02},
                {"gyroid", 9, 100, 20000, 1, 1, 0, 0, 0},
                {"terrain", 0, 131072, 131072, 0, 1, 1, 0, 0},
                {"terrain", 1, 2, 2, 0, 1, 1, 0, 0},
                {"menger", 1, 12, 12, 1, 0, 0, 0, 8.0},
                {"menger", 2, 144, 144, 1, 0, 0, 0, 8.0 * 20 / 27},
                {"menger", 0, 36096, 36096, 1, 0, 0, 0, 8.0 * 8000 / 19683},
                {"menger", 5, 672768, 672768, 1, 0, 0, 0, 8.0 * 160000 / 531441},
                {"cornell", 0, 32, 32, 0, 0, 0, 1, 0},
                {"pillars", 0, 100000, 120000, 0, 0, 0, 1, 0},
                {"blob", 0, 1048576, 1048576, 0, 0, 0, 0, 4.0986},
                {"hall", 0, 1048576, 1048576, 0, 0, 0, 0, 0},
                {"hall", 32, 4096, 4096, 0, 0, 0, 0, 0}};
    size_t i, k;
    for (i = 0; i < sizeof list / sizeof list[0]; i++) {
        sup_mesh mesh;
        CHECK(sup_scene_make(list[i].name, list[i].detail, &mesh) == 0);
        CHECK_MSG(mesh.triangle_count >= list[i].least && mesh.triangle_count <= list[i].most, "%s: %d triangles",
                  list[i].name, (int)mesh.triangle_count);
        CHECK(mesh_is_valid(&mesh));
        CHECK((mesh.normals != NULL) == list[i].normals && (mesh.vertex_rgb != NULL) == list[i].vertex_rgb &&
              (mesh.triangle_rgb != NULL) == list[i].triangle_rgb);
        if (list[i].closed) CHECK_EQ_U64(open_edges(&mesh), 0);
        if (list[i].volume > 0)
            CHECK_MSG(fabs(volume(&mesh) / list[i].volume - 1) < 0.01, "%s: volume %g", list[i].name, volume(&mesh));
        for (k = 0; k < 3 * mesh.vertex_count; k++) {
            if (!(fabsf(mesh.positions[k]) < 100.0f)) break;
            if (mesh.normals && !(fabsf(mesh.normals[k]) <= 1.0001f)) break;
        }
        CHECK_MSG(k == 3 * mesh.vertex_count, "%s has a strange vertex", list[i].name);
        sup_mesh_free(&mesh);
    }
    CHECK_EQ_I64(g_memory.live, 0);
}

TEST(scenes_by_name) {
    char names[] = SUP_SCENE_NAMES;
    char *name;
    int count = 0;
    sup_mesh mesh;
    for (name = strtok(names, "|"); name; name = strtok(NULL, "|"), count++) {
        CHECK(sup_scene_make(name, -1, &mesh) == 1);
        CHECK(sup_scene_make(name, 1 << 30, &mesh) == 1 && mesh.positions == NULL);
    }
    CHECK_EQ_I64(count, SUP_SCENE_COUNT);
    CHECK(sup_scene_make("teapot", 0, &mesh) == 1);
    CHECK(sup_scene_make("", 0, &mesh) == 1);
}

TEST(scenes_out_of_memory) {
    static const struct {
        const char *name;
        int detail;
    } list[] = {{"sphere", 4}, {"gyroid", 5}, {"terrain", 4}, {"menger", 2}, {"cornell", 0}};
    size_t i;
    for (i = 0; i < sizeof list / sizeof list[0]; i++) {
        int64_t k;
        int status = 2;
        for (k = 0; status && k < 500; k++) {
            sup_mesh mesh;
            memory_reset(k);
            status = sup_scene_make(list[i].name, list[i].detail, &mesh);
            CHECK(status == 0 || status == 2);
            g_memory.fail_at = -1;
            sup_mesh_free(&mesh);
            CHECK_EQ_I64(g_memory.live, 0);
        }
        CHECK(status == 0 && k > 2);
    }
}

/* Of 32-bit words, as if they stood in memory with the low byte first. */
static uint64_t hash_words(const void *words, size_t bytes) {
    const uint8_t *p = (const uint8_t *)words;
    uint64_t h = 0;
    size_t i;
    for (i = 0; i < bytes; i += 4) {
        uint8_t low_first[4];
        uint32_t w;
        memcpy(&w, p + i, 4);
        low_first[0] = (uint8_t)w; low_first[1] = (uint8_t)(w >> 8);
        low_first[2] = (uint8_t)(w >> 16); low_first[3] = (uint8_t)(w >> 24);
        h = test_fnv1a(low_first, 4, h);
    }
    return h;
}

/* The scenes that other systems are compared on. The numbers were taken from the programs that trace them; parts that
   use sinf or cosf may differ in the last bit with another C library and are compared with a tolerance. */
TEST(comparison_scenes) {
    sup_mesh mesh;
    float *rays;
    double sum = 0;
    size_t i, n = 513 * 513;
    REQUIRE(sup_scene_make("hall", 0, &mesh) == 0);
    CHECK_EQ_U64(mesh.vertex_count, 533505);
    CHECK_EQ_U64(hash_words(mesh.indices, mesh.triangle_count * 12), UINT64_C(0x60e782c6dab83431));
    CHECK_EQ_U64(hash_words(mesh.positions, n * 12), UINT64_C(0xde4a5d64a8d08e02));
    for (i = 3 * n; i < 3 * mesh.vertex_count; i++) sum += (double)fabsf(mesh.positions[i]);
    CHECK_NEAR(sum, 2087387.217824, 0.05);
    sup_mesh_free(&mesh);
    REQUIRE(sup_scene_make("blob", 0, &mesh) == 0);
    CHECK_EQ_U64(mesh.vertex_count, 525312);
    CHECK_EQ_U64(hash_words(mesh.indices, mesh.triangle_count * 12), UINT64_C(0x1be11891e7bb6e15));
    for (sum = 0, i = 0; i < 3 * mesh.vertex_count; i++) sum += (double)fabsf(mesh.positions[i]);
    CHECK_NEAR(sum, 745800.180850, 0.05);
    sup_mesh_free(&mesh);
    REQUIRE(sup_scene_rays_primary("hall", 1024, 768, &rays) == 0);
    CHECK_EQ_U64(hash_words(rays, (size_t)1024 * 768 * 24), UINT64_C(0x987eacccc9e94024));
    SUP_FREE(rays);
    REQUIRE(sup_scene_rays_primary("blob", 1024, 768, &rays) == 0);
    CHECK_EQ_U64(hash_words(rays, (size_t)1024 * 768 * 24), UINT64_C(0xcce24c31cf1bf132));
    SUP_FREE(rays);
    REQUIRE(sup_scene_rays_primary("blob", 13, 9, &rays) == 0); /* tiles that are cut off */
    CHECK_NEAR(length2(rays + 6 * 116 + 3), 1, 1e-6);
    SUP_FREE(rays);
    CHECK(sup_scene_rays_primary("sphere", 8, 8, &rays) == 1 && rays == NULL);
    CHECK(sup_scene_rays_primary("blob", 0, 8, &rays) == 1 && rays == NULL);
    CHECK_EQ_I64(g_memory.live, 0);
}

/* ---- scenes of voxrt_gi ---- */

static const char gi_text[] =
    "voxrt_gi 1 # comment\r\n\n  seconds 4\nwhite 2.5\n"
    "material brass specular 0.3 0.2 0.1 exponent 16 albedo .5 .25 .125\n"
    "path round loop\n knot 0 2 0 0\nknot 1 0 0 2\n knot 2 -2 0 0\nknot 3 0 0 -2\nknot 4 2 0 0\n"
    "path line\nknot 1 0 0 0 tangent 0 0 0\nknot 3 4 0 0 tangent 0 0 0\n"
    "camera front eye 0 2 8 at 0 1 0 path line\ncamera \"from behind\" eye 0 2 -8 at 0 1 0 up 1 0 0 fov 50\n"
    "object \"a file.obj\" scale 2 turn 0 90 0 position 1 2 3\n"
    "object scene:torus:12 spin 0 90 0 material brass path round color 1 0.5 0\n"
    "object b%03d.obj frames 3 6 2 voxels samples spacing 0.25\nobject plane voxels solid outwards\n"
    "light spot position 0 4 0 direction 0 -2 0 angle 30 color 40 36 30 path round\nlight area u 1 0 0 v 0 0 1";

TEST(gi_scenes) {
    sup_gi_scene s;
    sup_error err;
    double m[12], p[3];
    float q[3];
    char name[64];
    int i;
    memory_reset(-1);
    REQUIRE(sup_gi_scene_parse(gi_text, sizeof gi_text - 1, "x", &s, &err) == 0);
    CHECK(s.seconds == 4 && s.white == 2.5 && s.camera_count == 2 && s.thing_count == 4 && s.lamp_count == 2 && s.path_count == 2);
    CHECK_STR(s.cameras[1].name, "from behind");
    CHECK(s.cameras[0].path == 1 && s.cameras[1].path == -1 && s.cameras[1].fov == 50 && s.cameras[1].up[0] == 1);
    CHECK_STR(s.things[0].file, "a file.obj");
    CHECK(!s.things[0].moving && s.things[1].moving && s.things[2].moving && s.things[1].material == 0 && s.things[1].color[1] == 0.5);
    CHECK(s.lamps[0].kind == 1 && s.lamps[0].angle == 30 && s.lamps[1].kind == 3);
    CHECK(s.things[0].voxels == 0 && s.things[2].voxels == 5 && s.things[2].spacing == 0.25 && s.things[3].voxels == 4);
    CHECK(!s.things[0].outwards && s.things[3].outwards);
    sup_gi_matrix(&s, &s.things[0], 0, m); /* twice as large, x to -z, z to x */
    CHECK_NEAR(m[0], 0, 1e-12);
    CHECK_NEAR(m[2], 2, 1e-12);
    CHECK_NEAR(m[8], -2, 1e-12);
    CHECK(m[3] == 1 && m[7] == 2 && m[11] == 3 && fabs(m[5] - 2) < 1e-12);
    sup_gi_path_at(&s, &s.paths[1], 2, p); /* half of the way, at rest at both ends */
    CHECK_NEAR(p[0], 2, 1e-12);
    sup_gi_path_at(&s, &s.paths[1], 1.5, p); /* 3/16 - 2/64 of it */
    CHECK_NEAR(p[0], 4 * (3.0 / 16 - 2.0 / 64), 1e-12);
    sup_gi_path_at(&s, &s.paths[1], 99, p);
    CHECK(p[0] == 4);
    for (i = 0; i < 100; i++) { /* four Hermite arcs with tangents of a square come near a circle; it goes round */
        double r, again[3];
        sup_gi_path_at(&s, &s.paths[0], 0.04 * i, p);
        sup_gi_path_at(&s, &s.paths[0], 0.04 * i + 8, again);
        r = sqrt(p[0] * p[0] + p[2] * p[2]);
        CHECK_MSG(r > 1.7 && r < 2.01, "%g at %d", r, i);
        CHECK_NEAR(p[0], again[0], 1e-9);
    }
    for (i = 1; i < 400; i++) { /* no jump, no bend: also where the loop begins */
        double a[3], b[3], c[3];
        sup_gi_path_at(&s, &s.paths[0], 0.02 * (i - 1), a);
        sup_gi_path_at(&s, &s.paths[0], 0.02 * i, b);
        sup_gi_path_at(&s, &s.paths[0], 0.02 * (i + 1), c);
        CHECK(fabs(a[0] - 2 * b[0] + c[0]) < 0.006 && fabs(a[2] - 2 * b[2] + c[2]) < 0.006);
    }
    sup_gi_place(&s, s.lamps[0].position, s.lamps[0].path, 1, q);
    CHECK(q[0] == 0 && q[1] == 4 && q[2] == 2);
    CHECK(sup_gi_frame(&s.things[2], 0) == 3 && sup_gi_frame(&s.things[2], 1.5) == 6 && sup_gi_frame(&s.things[2], 2.1) == 3);
    CHECK(sup_gi_frame(&s.things[2], 1e25) >= 3 && sup_gi_frame(&s.things[2], 1e25) <= 6);
    CHECK(sup_frame_name("b%03d.obj", 7, name, sizeof name) == 0);
    CHECK_STR(name, "b007.obj");
    CHECK(sup_frame_name("b.obj", 7, name, sizeof name) && sup_frame_name("%s", 7, name, sizeof name) && sup_frame_name("%d%d", 7, name, sizeof name));
    sup_gi_scene_free(&s);
    CHECK(g_memory.live == 0);
}

TEST(gi_scenes_that_are_none) { /* every mistake has its line; any cut and any lack of memory leaves nothing behind */
    static const struct { const char *text, *part; } bad[] = {
        {"", "first line"}, {"voxrt_gi 2\n", "line 1"}, {"voxrt_gi 1\n", "camera and an object"},
        {"voxrt_gi 1\nball\n", "line 2: no line begins with \"ball\""},
        {"voxrt_gi 1\nseconds 0\n", "line 2"}, {"voxrt_gi 1\n\nwhite x\n", "line 3: not a number: \"x\""}, {"voxrt_gi 1\ncamera a eye 1 2\n", "line 2"},
        {"voxrt_gi 1\ncamera a fov 180\n", "line 2"}, {"voxrt_gi 1\nlight sun\n", "kind"}, {"voxrt_gi 1\nlight point path p\n", "line above"},
        {"voxrt_gi 1\nmaterial m albedo 2 0 0\n", "line 2"}, {"voxrt_gi 1\nknot 1 1 1 1\n", "line 2"},
        {"voxrt_gi 1\npath a\nknot 1 0 0 0\nknot 1 0 0 0\n", "line 4"},
        {"voxrt_gi 1\nobject \"a\n", "quote"}, {"voxrt_gi 1\nobject a scale 0\n", "line 2"}, {"voxrt_gi 1\nobject a frames 3 2 1\n", "line 2"},
        {"voxrt_gi 1\nobject a frames 0 1.5 1\n", "whole numbers"},
        {"voxrt_gi 1\nobject a color 1e31 0 0\n", "line 2"}, {"voxrt_gi 1\nobject a blue\n", "blue"}, {"voxrt_gi 1\nbox 0 0 0 1 1 0\n", "line 2"},
        {"voxrt_gi 1\nobject a voxels thick\n", "thick"}, {"voxrt_gi 1\nobject a voxels\n", "voxels"}, {"voxrt_gi 1\nobject a spacing 0.001\n", "spacing"},
        {"voxrt_gi 1\ncamera a\nobject b\npath p\n", "knots"}, {"voxrt_gi 1\ncamera a eye 1 2 nan\n", "line 2"},
    };
    sup_gi_scene s;
    sup_error err;
    size_t i;
    int64_t fail;
    for (i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        memory_reset(-1);
        CHECK_MSG(sup_gi_scene_parse(bad[i].text, strlen(bad[i].text), "x", &s, &err) == 1, "%s", bad[i].text);
        CHECK_MSG(strstr(err.text, bad[i].part) != NULL, "%s: %s", bad[i].text, err.text);
        CHECK(g_memory.live == 0);
    }
    { /* a name with a 0 in it would be written as another */
        static const char zero[] = "voxrt_gi 1\ncamera c\nobject a\0b\n";
        CHECK(sup_gi_scene_parse(zero, sizeof zero - 1, "x", &s, &err) == 1 && strstr(err.text, "line 3") != NULL);
    }
    for (i = 0; i < sizeof gi_text - 1; i++) {
        char *copy = (char *)malloc(i ? i : 1);
        REQUIRE(copy != NULL);
        memcpy(copy, gi_text, i);
        if (sup_gi_scene_parse(copy, i, "x", &s, &err) == 0) sup_gi_scene_free(&s);
        CHECK(g_memory.live == 0);
        free(copy);
    }
    for (fail = 0; fail < 100; fail++) {
        memory_reset(fail);
        if (sup_gi_scene_parse(gi_text, sizeof gi_text - 1, "x", &s, &err) == 0) break;
        CHECK(strstr(err.text, "memory") != NULL && g_memory.live == 0);
    }
    CHECK(fail > 5 && fail < 100);
    if (fail < 100) sup_gi_scene_free(&s);
    CHECK(g_memory.live == 0);
    memory_reset(-1);
}

static int same_bytes(const void *a, const void *b, size_t n) { return n == 0 || memcmp(a, b, n) == 0; }

static void same_scene(const sup_gi_scene *a, const sup_gi_scene *b) {
    size_t i;
    REQUIRE(a->thing_count == b->thing_count && a->path_count == b->path_count && a->knot_count == b->knot_count);
    REQUIRE(a->lamp_count == b->lamp_count && a->camera_count == b->camera_count && a->material_count == b->material_count);
    CHECK(same_bytes(a->knots, b->knots, a->knot_count * sizeof *a->knots) && same_bytes(a->paths, b->paths, a->path_count * sizeof *a->paths));
    CHECK(same_bytes(a->lamps, b->lamps, a->lamp_count * sizeof *a->lamps));
    CHECK(same_bytes(a->cameras, b->cameras, a->camera_count * sizeof *a->cameras));
    CHECK(same_bytes(a->materials, b->materials, a->material_count * sizeof *a->materials));
    CHECK(a->seconds == b->seconds && a->white == b->white && a->has_box == b->has_box && memcmp(a->box, b->box, sizeof a->box) == 0);
    for (i = 0; i < a->thing_count; i++) {
        sup_gi_thing x = a->things[i], y = b->things[i];
        CHECK_STR(x.file, y.file);
        x.file = y.file = NULL;
        CHECK(memcmp(&x, &y, sizeof x) == 0);
    }
}

TEST(gi_scenes_written) { /* read back they are the same; and as they are at a time, in files of their own */
    static const char more[] = "voxrt_gi 1\nbox -1 -0.1 1e-7 1 1 0.3333333333333333\ncamera a\"b eye 0.1 0.2 0.3\nobject plane color 0.1 0.2 0.3\n";
    const char *path = test_temp_path(".txt");
    sup_gi_scene s, again;
    sup_mesh mesh[4], back;
    const sup_mesh *list[4] = {&mesh[0], &mesh[1], &mesh[2], &mesh[3]};
    const double box[6] = {-1, -2, -3, 4, 5, 6};
    sup_error err;
    char *data;
    size_t size;
    int i, k;
    int64_t fail;
    memory_reset(-1);
    for (i = 0; i < 2; i++) {
        REQUIRE(sup_gi_scene_parse(i ? more : gi_text, i ? sizeof more - 1 : sizeof gi_text - 1, "x", &s, &err) == 0);
        REQUIRE(sup_gi_scene_write(&s, path, "", &err) == 0);
        REQUIRE(sup_read_file(path, &data, &size, &err) == 0);
        REQUIRE(sup_gi_scene_parse(data, size, path, &again, &err) == 0);
        same_scene(&s, &again);
        SUP_FREE(data);
        sup_gi_scene_free(&again);
        if (i == 1) sup_gi_scene_free(&s);
        else { /* in another folder: what is a file is found */
            REQUIRE(sup_gi_scene_write(&s, path, "/some/folder", &err) == 0 && sup_read_file(path, &data, &size, &err) == 0);
            REQUIRE(sup_gi_scene_parse(data, size, path, &again, &err) == 0);
            CHECK_STR(again.things[0].file, "/some/folder/a file.obj");
            CHECK_STR(again.things[1].file, "scene:torus:12");
            CHECK_STR(again.things[3].file, "plane");
            SUP_FREE(data);
            sup_gi_scene_free(&again);
            sup_gi_scene_free(&s);
        }
    }
    REQUIRE(sup_gi_scene_parse(gi_text, sizeof gi_text - 1, "x", &s, &err) == 0);
    for (i = 0; i < 4; i++) REQUIRE(sup_scene_make("torus", 8 + i, &mesh[i]) == 0);
    for (fail = 0; fail < 100; fail++) {
        const int64_t live = g_memory.live;
        memory_reset(fail);
        if (sup_gi_export(&s, 1.0, list, box, path, &err) == 0) break;
        CHECK(strstr(err.text, "memory") != NULL && g_memory.live == live);
    }
    CHECK(fail > 5 && fail < 100);
    memory_reset(-1);
    REQUIRE(sup_read_file(path, &data, &size, &err) == 0 && sup_gi_scene_parse(data, size, path, &again, &err) == 0);
    SUP_FREE(data);
    CHECK(again.path_count == 0 && again.has_box && again.box[4] == 5 && again.thing_count == 4 && again.camera_count == 2);
    CHECK(again.cameras[0].eye[0] == 0 && again.lamps[0].position[0] == 0 && again.lamps[0].position[1] == 4 && again.lamps[0].position[2] == 2);
    CHECK(again.things[1].material == 0 && again.materials[0].albedo[0] == 1 && again.materials[0].exponent == 16 && again.things[2].voxels == 5);
    for (i = 0; i < 4; i++) {
        double m[12];
        char name[1100];
        (void)snprintf(name, sizeof name, "%.*s%s", (int)(strrchr(path, '/') + 1 - path), path, again.things[i].file);
        REQUIRE(sup_mesh_read(name, &back, &err) == 0);
        CHECK(!again.things[i].moving && again.things[i].scale == 1 && back.vertex_count == mesh[i].vertex_count);
        REQUIRE(back.triangle_count == mesh[i].triangle_count);
        CHECK(memcmp(back.indices, mesh[i].indices, 12 * back.triangle_count) == 0);
        CHECK((back.vertex_rgb != NULL) == (mesh[i].vertex_rgb != NULL));
        if (back.vertex_rgb && mesh[i].vertex_rgb) CHECK(memcmp(back.vertex_rgb, mesh[i].vertex_rgb, 3 * back.vertex_count) == 0);
        if (back.triangle_rgb && mesh[i].triangle_rgb) CHECK(memcmp(back.triangle_rgb, mesh[i].triangle_rgb, 3 * back.triangle_count) == 0);
        sup_gi_matrix(&s, &s.things[i], 1.0, m);
        for (k = 0; k < 3; k++) {
            const float *p = mesh[i].positions + 3 * 5;
            const double to = m[4 * k] * (double)p[0] + m[4 * k + 1] * (double)p[1] + m[4 * k + 2] * (double)p[2] + m[4 * k + 3];
            CHECK_NEAR((double)back.positions[15 + k], to, 1e-6);
        }
        sup_mesh_free(&back);
        sup_mesh_free(&mesh[i]);
        (void)remove(name);
    }
    (void)remove(path);
    sup_gi_scene_free(&again);
    sup_gi_scene_free(&s);
    CHECK(sup_gi_scene_parse(more, sizeof more - 1, "x", &s, &err) == 0);
    CHECK(sup_gi_scene_write(&s, "no/such/folder/x.txt", "", &err) == 1);
    sup_gi_scene_free(&s);
    CHECK(g_memory.live == 0);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(number_forms);
    RUN(numbers_agree_with_libc);
    RUN(integers);
    RUN(line_numbers);
    RUN(obj_all_index_forms);
    RUN(obj_normals_split_vertices);
    RUN(obj_colours_and_materials);
    RUN(obj_traps);
    RUN(polygons);
    RUN(polygons_random_stars);
    RUN(polygons_hostile);
    RUN(ply_binary_every_type);
    RUN(ply_ascii);
    RUN(ply_malformed);
    RUN(ply_headers_of_any_length);
    RUN(stl_binary);
    RUN(stl_ascii);
    RUN(off_forms);
    RUN(formats_by_content);
    RUN(cut_off_at_every_length);
    RUN(every_byte_changed);
    RUN(every_allocation_fails_once);
    RUN(hostile_counts);
    RUN(file_errors);
    RUN(large_file);
    RUN(materials_from_files);
    RUN(a_million_faces);
    RUN(normals_weigh_angles);
    RUN(normals_keep_creases);
    RUN(normals_across_repeated_vertices);
    RUN(normals_without_memory);
    RUN(normals_edge_cases);
    RUN(bounds);
    RUN(real_meshes);
    RUN(png_round_trips);
    RUN(png_large_and_strided);
    RUN(png_rejects);
    RUN(png_is_deterministic);
    RUN(check_sums);
    RUN(huffman_lengths);
    RUN(pfm);
    RUN(files_appear_whole);
    RUN(colours);
    RUN(command_lines);
    RUN(choices);
    RUN(clock_and_progress);
    RUN(camera_frames_boxes);
    RUN(camera_edge_cases);
    RUN(scenes);
    RUN(scenes_by_name);
    RUN(scenes_out_of_memory);
    RUN(comparison_scenes);
    RUN(gi_scenes);
    RUN(gi_scenes_that_are_none);
    RUN(gi_scenes_written);
    return test_end();
}
