/* Where samples fall: densities in the picture, area weights, instances, independence; points of surfaces. Seeds are
   fixed; p-values are stated where a statistic is compared. */
#include "test.h"
#define ZBUFRAND_IMPLEMENTATION
#include "zbufrand.h"
#include "zbufrand_shapes.h"

static zbufrand_scene *sample_scene_of(const zbufrand_mesh *m, int ids) {
    zbufrand_scene *s = NULL;
    zbufrand_build_desc b;
    memset(&b, 0, sizeof b);
    b.ids = ids != 0;
    if (zbufrand_scene_create(NULL, &s) != ZBUFRAND_OK) abort();
    CHECK_EQ_U64(zbufrand_add_mesh(s, 1, NULL, 0, m, NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_scene_build(s, &b, NULL), ZBUFRAND_OK);
    return s;
}

/* A square of edge 2 e in the x-y plane, n x n x 2 triangles, facing +z. */
static void plane(shape *s, uint32_t n, double e) {
    uint32_t i, j, first = (uint32_t)s->vertices;
    for (i = 0; i <= n; i++) {
        for (j = 0; j <= n; j++) (void)shape_vertex(s, e * (2.0 * i / n - 1), e * (2.0 * j / n - 1), 0);
    }
    for (i = 0; i < n; i++) {
        for (j = 0; j < n; j++) {
            uint32_t a = first + i * (n + 1) + j, b = a + n + 1;
            shape_triangle(s, a, b, b + 1);
            shape_triangle(s, a, b + 1, a + 1);
        }
    }
}

/* Distribution of chi-square: value that is exceeded with a probability of about 1e-5 (Wilson and Hilferty). */
static double chi_limit(double k) {
    double z = 4.265, t = 1 - 2 / (9 * k) + z * sqrt(2 / (9 * k));
    return k * t * t * t;
}

enum { GRID = 16, SAMPLE_WIDTH = 320, SAMPLE_HEIGHT = 240 };

typedef struct counts {
    double cell[GRID][GRID];
    uint64_t total, back;
    double z_sum;
} counts;

static int count_sample(void *user, const zbufrand_sample *s, const uint32_t *numbers, size_t n) {
    counts *c = (counts *)user;
    size_t i;
    (void)numbers;
    for (i = 0; i < n; i++) {
        int x = (int)(s[i].x * GRID / SAMPLE_WIDTH), y = (int)(s[i].y * GRID / SAMPLE_HEIGHT);
        if (x < 0 || y < 0 || x >= GRID || y >= GRID || !(s[i].z > 0)) {
            CHECK_MSG(0, "a sample at %g %g, depth %g", (double)s[i].x, (double)s[i].y, (double)s[i].z);
            return 1;
        }
        c->cell[y][x] += 1;
        c->total++;
        c->back += s[i].flags & ZBUFRAND_SAMPLE_BACK;
        c->z_sum += (double)s[i].z;
    }
    return 0;
}

/* ---- density in the picture ---- */

/* A camera at (0, 0, d) above a plane through the origin, tilted: what share of a cell of the picture does it cover?
   By `columns` x 32 rays a cell. half: half the edge of the square. */
static void covered(const zbufrandi_camera *c, double half, int columns, double cell[GRID][GRID]) {
    int x, y, i, j;
    for (y = 0; y < GRID; y++) {
        for (x = 0; x < GRID; x++) {
            int n = 0;
            for (i = 0; i < columns; i++) {
                for (j = 0; j < 32; j++) {
                    double px = (x + (i + 0.5) / columns) * SAMPLE_WIDTH / GRID, py = (y + (j + 0.5) / 32) * SAMPLE_HEIGHT / GRID;
                    double u = (px - c->center_x) / c->focal, v = (c->center_y - py) / c->focal, d[3], t;
                    int a;
                    for (a = 0; a < 3; a++) d[a] = c->dir[a] + u * c->right[a] + v * c->up[a];
                    t = -c->eye[2] / d[2];
                    n += t > c->near_z && d[2] < 0 && fabs(c->eye[0] + t * d[0]) < half && fabs(c->eye[1] + t * d[1]) < half;
                }
            }
            cell[y][x] = n / (32.0 * columns);
        }
    }
}

/* flags 1: no thinning, 2: independent, 4: two-sided from behind */
static void check_density(uint32_t mesh, double tilt, double fov, double density, uint32_t flags) {
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene;
    zbufrand_frame *frame = NULL;
    zbufrand_render_desc d;
    zbufrandi_camera camera;
    zbufrand_stats st;
    counts c;
    static struct { double tilt, fov, sign, cover[GRID][GRID]; } known; /* of the last view: meshes differ more often */
    double (*cover)[GRID] = known.cover, chi = 0, expected, sum = 0, seen = 0, scale, sign = flags & 4 ? -1 : 1;
    uint32_t seed, seeds = test_quick() ? 2 : 4, used = 0;
    int x, y;
    memset(&s, 0, sizeof s);
    memset(&c, 0, sizeof c);
    memset(&d, 0, sizeof d);
    plane(&s, mesh, 3);
    m = mesh_of(&s);
    m.two_sided = (flags & 4) != 0;
    scene = sample_scene_of(&m, 0);
    CHECK_EQ_U64(zbufrand_frame_create(NULL, &frame), ZBUFRAND_OK);
    d.camera.eye[0] = 4 * sin(tilt * 0.0174532925199433);
    d.camera.eye[2] = sign * 4 * cos(tilt * 0.0174532925199433);
    d.camera.up[1] = 1;
    d.camera.fov_y = fov;
    d.density = density;
    d.hybrid = ZBUFRAND_HYBRID_OFF;
    d.no_thinning = flags & 1;
    d.independent = (flags & 2) != 0;
    for (seed = 0; seed < seeds; seed++) {
        d.seed = seed;
        CHECK_EQ_U64(zbufrand_sample_scene(frame, &d, scene, SAMPLE_WIDTH, SAMPLE_HEIGHT, count_sample, &c, &st), ZBUFRAND_OK);
    }
    CHECK_EQ_U64(zbufrandi_camera_open(&d.camera, scene, SAMPLE_WIDTH, SAMPLE_HEIGHT, 0, &camera), ZBUFRAND_OK);
    if (sign < 0) { /* the oracle wants to look down */
        camera.eye[2] = -camera.eye[2];
        camera.dir[2] = -camera.dir[2];
        camera.right[2] = -camera.right[2];
        camera.up[2] = -camera.up[2];
    }
    if (!(known.tilt == tilt && known.fov == fov && known.sign == sign)) {
        covered(&camera, 3, tilt > 80 ? 256 : 32, cover); /* seen edge-on it is a few pixels wide */
        known.tilt = tilt;
        known.fov = fov;
        known.sign = sign;
    }
    scale = density * seeds * (double)SAMPLE_WIDTH * SAMPLE_HEIGHT / (GRID * GRID);
    for (y = 0; y < GRID; y++) {
        for (x = 0; x < GRID; x++) {
            expected = cover[y][x] * scale;
            sum += expected;
            seen += c.cell[y][x];
            if (cover[y][x] < 0.999) continue; /* the edge is known to 1/32 of a cell only */
            if (flags & 1) {
                CHECK_MSG(c.cell[y][x] > expected - 4.5 * sqrt(expected), "tilt %g: %g samples in a cell, at least %g are needed", tilt,
                          c.cell[y][x], expected);
                continue;
            }
            chi += (c.cell[y][x] - expected) * (c.cell[y][x] - expected) / expected;
            used++;
        }
    }
    if (!(flags & 1)) {
        if (used > 0) CHECK_MSG(chi < chi_limit(used), "mesh %u, tilt %g: chi-square %g of %u cells", mesh, tilt, chi, used);
        if ((flags & 2) && used > 20) CHECK_MSG(chi > used - 4.3 * sqrt(2.0 * used), "independent samples are too even: %g of %u", chi, used);
        CHECK_MSG(fabs(seen - sum) < 4.5 * sqrt(sum) + 0.004 * sum + 3, "mesh %u, tilt %g: %g samples, %g expected", mesh, tilt, seen, sum);
    }
    CHECK_EQ_U64(c.back, flags & 4 ? c.total : 0);
    zbufrand_frame_destroy(frame);
    zbufrand_scene_destroy(scene);
    shape_free(&s);
}

TEST(planes) {
    static const double tilt[] = {0, 20, 45, 60, 75, 85, 89, 89.9};
    static const uint32_t mesh[] = {1, 20, 200, 500}; /* from two large triangles to many a pixel */
    uint32_t i, k;
    for (i = 0; i < 8; i++) {
        for (k = 0; k < (test_quick() || i % 3 != 1 ? 3u : 4u); k++) check_density(mesh[k], tilt[i], 40, mesh[k] == 1 ? 5 : 1.3, 0);
    }
}
TEST(wide_angle) {
    check_density(200, 30, 120, 1, 0);
    check_density(500, 60, 130, 0.5, 0);
    check_density(2, 70, 120, 3, 0);
}
TEST(at_least_without_thinning) {
    check_density(300, 60, 60, 1, 1);
    check_density(30, 80, 100, 2, 1);
}
TEST(independent_samples) {
    check_density(1, 30, 40, 3, 2);
    check_density(300, 50, 60, 1, 2);
}
TEST(from_behind) {
    check_density(200, 40, 40, 1, 4);
    check_density(3, 40, 40, 2, 4);
}

/* Area of a polygon of n <= 3 corners within the picture, cut at its four sides one after the other. */
static double area_in_picture(double (*p)[2], int n) {
    double poly[2][12][2], area = 0;
    int side, i, at = 0;
    memcpy(poly[0], p, (size_t)n * sizeof p[0]);
    for (side = 0; side < 4; side++) {
        const int a = side & 1;
        const double limit = side < 2 ? 0 : a == 0 ? SAMPLE_WIDTH : SAMPLE_HEIGHT, sign = side < 2 ? 1 : -1;
        int m = 0;
        for (i = 0; i < n; i++) {
            const double *u = poly[at][i], *v = poly[at][(i + 1) % n];
            const double du = sign * (u[a] - limit), dv = sign * (v[a] - limit);
            if (du >= 0) memcpy(poly[1 - at][m++], u, sizeof poly[0][0]);
            if ((du >= 0) != (dv >= 0)) {
                poly[1 - at][m][a] = limit;
                poly[1 - at][m][1 - a] = u[1 - a] + (v[1 - a] - u[1 - a]) * du / (du - dv);
                m++;
            }
        }
        n = m;
        at = 1 - at;
    }
    for (i = 0; i < n; i++) {
        const double *u = poly[at][i], *v = poly[at][(i + 1) % n];
        area += 0.5 * (u[0] * v[1] - u[1] * v[0]);
    }
    return fabs(area);
}

/* The mean of the projection factor over random points of the triangle at p0, times its area, and that of the squares; the
   area that it has in the picture is returned. */
static double projection_mean(const zbufrand_view *view, const float *p0, uint32_t points, test_rng *r, double *sum, double *sum2) {
    double q[3][3], pixel[3][2], e[2][3], n[3], length = 0;
    uint32_t k, a;
    *sum = *sum2 = 0;
    for (k = 0; k < 3; k++) {
        for (a = 0; a < 3; a++) {
            const double *row = view->world_to_camera[a];
            const float *p = p0 + 3 * k;
            q[k][a] = row[0] * (double)p[0] + row[1] * (double)p[1] + row[2] * (double)p[2] + row[3];
        }
        pixel[k][0] = view->center_x + view->focal * q[k][0] / q[k][2];
        pixel[k][1] = view->center_y - view->focal * q[k][1] / q[k][2];
    }
    for (a = 0; a < 3; a++) {
        e[0][a] = q[1][a] - q[0][a];
        e[1][a] = q[2][a] - q[0][a];
    }
    for (a = 0; a < 3; a++) {
        n[a] = e[0][(a + 1) % 3] * e[1][(a + 2) % 3] - e[0][(a + 2) % 3] * e[1][(a + 1) % 3];
        length += n[a] * n[a];
    }
    length = sqrt(length);
    for (k = 0; k < points; k++) {
        double u = test_rng_double(r), v = test_rng_double(r), p[3], away = 0, far = 0, prj, x, y;
        if (u + v > 1) {
            u = 1 - u;
            v = 1 - v;
        }
        for (a = 0; a < 3; a++) {
            p[a] = q[0][a] + u * e[0][a] + v * e[1][a];
            far += p[a] * p[a];
            away += p[a] * n[a] / length;
        }
        far = sqrt(far);
        /* f^2 cos(beta) / (z^2 cos(alpha)) */
        prj = view->focal * view->focal * (fabs(away) / far) / (p[2] * p[2] * (p[2] / far));
        x = view->center_x + view->focal * p[0] / p[2];
        y = view->center_y - view->focal * p[1] / p[2];
        if (x < 0 || y < 0 || x >= SAMPLE_WIDTH || y >= SAMPLE_HEIGHT) continue;
        prj *= 0.5 * length;
        *sum += prj / points;
        *sum2 += prj * prj / points;
    }
    return area_in_picture(pixel, 3);
}

/* 1 / cos(alpha) in the corners of the picture: 1.22 for a diagonal of 70 degrees, 1.296 for 79. */
static void projection_in_corners(void) {
    static const double diagonal[2] = {70, 79}, want[2] = {1.2208, 1.2960};
    uint32_t k;
    for (k = 0; k < 2; k++) {
        zbufrand_camera camera;
        zbufrand_view view;
        const double half = tan(diagonal[k] * 0.5 * 0.0174532925199433),
            high = half * SAMPLE_HEIGHT / sqrt(SAMPLE_WIDTH * SAMPLE_WIDTH + SAMPLE_HEIGHT * SAMPLE_HEIGHT);
        memset(&camera, 0, sizeof camera);
        camera.at[2] = -1;
        camera.fov_y = 2 * atan(high) / 0.0174532925199433;
        CHECK_EQ_U64(zbufrand_camera_view(&camera, NULL, SAMPLE_WIDTH, SAMPLE_HEIGHT, &view), ZBUFRAND_OK);
        CHECK_NEAR(sqrt(1 + (0.25 * SAMPLE_WIDTH * SAMPLE_WIDTH + 0.25 * SAMPLE_HEIGHT * SAMPLE_HEIGHT) / (view.focal * view.focal)), want[k], 1e-4);
    }
}

/* Triangles anywhere before the camera: the mean of the thesis' projection factor (Definition 6) over their surface, times their
   area, is the part of the picture that they cover, and so is the number of samples over the density. */
TEST(areas_of_triangles) {
    const uint32_t triangles = test_quick() ? 10 : 60, points = 20000;
    const double density = 6;
    test_rng r = test_rng_make(92);
    zbufrand_frame *frame = NULL;
    double all = 0, seen = 0;
    uint32_t t, k, visible = 0;
    CHECK_EQ_U64(zbufrand_frame_create(NULL, &frame), ZBUFRAND_OK);
    for (t = 0; t < triangles; t++) {
        shape s;
        zbufrand_mesh m;
        zbufrand_scene *scene;
        zbufrand_render_desc d;
        zbufrand_view view;
        counts c;
        double area, sum, sum2;
        memset(&s, 0, sizeof s);
        memset(&d, 0, sizeof d);
        memset(&c, 0, sizeof c);
        d.camera.at[2] = -1;
        d.camera.fov_y = t % 3 == 0 ? 100 : 50;
        d.camera.near_z = 0.01;
        d.hybrid = ZBUFRAND_HYBRID_OFF;
        d.density = density;
        for (k = 0; k < 3; k++) { /* within 4 of depth 1 to 5, so partly beside the picture */
            const double z = 1 + 4 * test_rng_double(&r), wide = t % 4 == 0 ? 8 : 2;
            (void)shape_vertex(&s, wide * (test_rng_double(&r) - 0.5), wide * (test_rng_double(&r) - 0.5), -z);
        }
        shape_triangle(&s, 0, 1, 2);
        m = mesh_of(&s);
        m.two_sided = 1;
        scene = sample_scene_of(&m, 0);
        CHECK_EQ_U64(zbufrand_camera_view(&d.camera, scene, SAMPLE_WIDTH, SAMPLE_HEIGHT, &view), ZBUFRAND_OK);
        area = projection_mean(&view, s.p, points, &r, &sum, &sum2);
        CHECK_MSG(fabs(sum - area) < 4.5 * sqrt(fmax(sum2 - sum * sum, 0) / points) + 1e-3, "triangle %u: %g square pixels, %g by the factor",
                  t, area, sum);
        CHECK_EQ_U64(zbufrand_sample_scene(frame, &d, scene, SAMPLE_WIDTH, SAMPLE_HEIGHT, count_sample, &c, NULL), ZBUFRAND_OK);
        CHECK_MSG(fabs((double)c.total - density * area) < 4.5 * sqrt(density * area) + 2, "triangle %u: %g samples for %g", t, (double)c.total,
                  density * area);
        seen += (double)c.total;
        all += density * area;
        visible += area > 100;
        zbufrand_scene_destroy(scene);
        shape_free(&s);
    }
    CHECK_MSG(fabs(seen - all) < 4.5 * sqrt(all), "%g samples for %g", seen, all);
    CHECK(visible > triangles / 2);
    projection_in_corners();
    zbufrand_frame_destroy(frame);
}

/* Nothing is drawn of a surface that faces away. */
TEST(facing_away) {
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene;
    zbufrand_frame *frame = NULL;
    zbufrand_render_desc d;
    counts c;
    uint32_t mesh;
    CHECK_EQ_U64(zbufrand_frame_create(NULL, &frame), ZBUFRAND_OK);
    for (mesh = 1; mesh <= 300; mesh += 299) {
        memset(&s, 0, sizeof s);
        memset(&c, 0, sizeof c);
        memset(&d, 0, sizeof d);
        plane(&s, mesh, 3);
        m = mesh_of(&s);
        scene = sample_scene_of(&m, 0);
        d.camera.eye[2] = -4;
        d.camera.eye[0] = 1;
        d.hybrid = ZBUFRAND_HYBRID_OFF;
        CHECK_EQ_U64(zbufrand_sample_scene(frame, &d, scene, SAMPLE_WIDTH, SAMPLE_HEIGHT, count_sample, &c, NULL), ZBUFRAND_OK);
        CHECK_EQ_U64(c.total, 0);
        zbufrand_scene_destroy(scene);
        shape_free(&s);
    }
    zbufrand_frame_destroy(frame);
}

/* ---- instances are what they stand for ---- */

static void sample_transform(test_rng *r, double scale, int mirror, zbufrand_transform *t) {
    double q[9];
    uint32_t a, b;
    shape_rotation(test_rng_double(r), test_rng_double(r), test_rng_double(r), q);
    for (a = 0; a < 3; a++) {
        for (b = 0; b < 3; b++) t->m[a][b] = q[3 * a + b] * scale * (mirror ? -1 : 1);
        t->m[a][3] = 6 * test_rng_double(r) - 3;
    }
}

/* The torus that is placed, as triangles of its own. */
static void put_torus(shape *all, const zbufrand_transform *t, int mirror) {
    const uint32_t v = (uint32_t)all->vertices;
    shape copy;
    double q[9];
    uint32_t a, b;
    memset(&copy, 0, sizeof copy);
    shape_torus(&copy, 0, 0, 0, 1, 0.4, 30, 15);
    for (a = 0; a < 3; a++) for (b = 0; b < 3; b++) q[3 * a + b] = t->m[a][b];
    shape_place(&copy, q, t->m[0][3], t->m[1][3], t->m[2][3]);
    for (a = 0; a < copy.vertices; a++) (void)shape_vertex(all, (double)copy.p[3 * a], (double)copy.p[3 * a + 1], (double)copy.p[3 * a + 2]);
    for (a = 0; a < copy.triangles; a++) { /* a mirror turns triangles inside out: put that right */
        shape_triangle(all, v + copy.t[3 * a], v + copy.t[3 * a + (mirror ? 2 : 1)], v + copy.t[3 * a + (mirror ? 1 : 2)]);
    }
    shape_free(&copy);
}

/* Triangles of a shape, placed. */
static void put_copy(shape *all, const shape *from, const zbufrand_transform *t, int mirror) {
    const uint32_t v = (uint32_t)all->vertices;
    uint32_t a, b;
    for (a = 0; a < from->vertices; a++) {
        double p[3], q[3];
        for (b = 0; b < 3; b++) p[b] = (double)from->p[3 * a + b];
        zbufrandi_m34_point(ZBUFRANDI_M34(t->m), p, q);
        (void)shape_vertex(all, q[0], q[1], q[2]);
    }
    for (a = 0; a < from->triangles; a++)
        shape_triangle(all, v + from->t[3 * a], v + from->t[3 * a + (mirror ? 2 : 1)], v + from->t[3 * a + (mirror ? 1 : 2)]);
}

TEST(instances_and_copies) {
    test_rng r = test_rng_make(31);
    uint32_t k, i, seed;
    for (k = 0; k < 2; k++) { /* small ones, of which many stand behind one stored point; large ones */
        shape one, all;
        zbufrand_mesh m;
        zbufrand_scene *scene[2] = {NULL, NULL};
        zbufrand_frame *frame = NULL;
        zbufrand_node lib, mesh, group;
        zbufrand_render_desc d;
        counts c[2];
        const uint32_t count = k == 0 ? 400 : 40;
        double chi = 0;
        uint32_t used = 0, x, y;
        memset(&one, 0, sizeof one);
        memset(&all, 0, sizeof all);
        memset(c, 0, sizeof c);
        shape_torus(&one, 0, 0, 0, 1, 0.4, 30, 15);
        CHECK_EQ_U64(zbufrand_scene_create(NULL, &scene[0]), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_list(scene[0], 1, NULL, ZBUFRAND_HIDDEN, &lib), ZBUFRAND_OK);
        m = mesh_of(&one);
        CHECK_EQ_U64(zbufrand_add_mesh(scene[0], lib, NULL, 0, &m, &mesh), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_list(scene[0], lib, NULL, 0, &group), ZBUFRAND_OK); /* two in a group, the group many times */
        for (i = 0; i < 2; i++) {
            zbufrand_transform t;
            sample_transform(&r, 0.3 + 0.2 * i, (int)i, &t);
            CHECK_EQ_U64(zbufrand_add_reference(scene[0], group, &t, mesh, NULL), ZBUFRAND_OK);
            put_torus(&all, &t, (int)i);
        }
        {
            shape pair = all; /* the flattened group; then all its copies */
            memset(&all, 0, sizeof all);
            for (i = 0; i < count; i++) {
                zbufrand_transform t;
                uint32_t a;
                sample_transform(&r, (k == 0 ? 0.15 : 1.0) * pow(10, 0.6 * test_rng_double(&r) - 0.3), (int)(i % 3 == 0), &t);
                if (k == 0) for (a = 0; a < 3; a++) t.m[a][3] *= 1.6;
                CHECK_EQ_U64(zbufrand_add_reference(scene[0], 1, &t, group, NULL), ZBUFRAND_OK);
                put_copy(&all, &pair, &t, i % 3 == 0);
            }
            shape_free(&pair);
        }
        m = mesh_of(&all);
        scene[1] = sample_scene_of(&m, 0);
        CHECK_EQ_U64(zbufrand_scene_build(scene[0], NULL, NULL), ZBUFRAND_OK);
        CHECK_EQ_U64(scene[0]->info.triangles, scene[1]->info.triangles);
        CHECK_NEAR(scene[0]->info.area / scene[1]->info.area, 1, 1e-4);
        CHECK_EQ_U64(zbufrand_frame_create(NULL, &frame), ZBUFRAND_OK);
        memset(&d, 0, sizeof d);
        d.camera.eye[2] = k == 0 ? 40 : 25;
        d.camera.eye[0] = 3;
        d.camera.fov_y = 50;
        d.hybrid = ZBUFRAND_HYBRID_OFF;
        d.density = k == 0 ? 2 : 0.5;
        for (seed = 0; seed < (test_quick() ? 1u : 4u); seed++) {
            for (i = 0; i < 2; i++) {
                d.seed = 100 * i + seed;
                CHECK_EQ_U64(zbufrand_sample_scene(frame, &d, scene[i], SAMPLE_WIDTH, SAMPLE_HEIGHT, count_sample, &c[i], NULL), ZBUFRAND_OK);
            }
        }
        for (y = 0; y < GRID; y++) {
            for (x = 0; x < GRID; x++) {
                double a = c[0].cell[y][x], b = c[1].cell[y][x];
                if (a + b < 20) continue;
                chi += (a - b) * (a - b) / (a + b);
                used++;
            }
        }
        CHECK(used > 10);
        CHECK_MSG(chi < chi_limit(used), "case %u: chi-square %g of %u cells", k, chi, used);
        CHECK_MSG(fabs((double)c[0].total - (double)c[1].total) < 4.5 * sqrt((double)c[0].total + (double)c[1].total), "%llu and %llu samples",
                  (unsigned long long)c[0].total, (unsigned long long)c[1].total);
        CHECK_NEAR(c[0].z_sum / (double)c[0].total, c[1].z_sum / (double)c[1].total, 0.1);
        zbufrand_frame_destroy(frame);
        zbufrand_scene_destroy(scene[0]);
        zbufrand_scene_destroy(scene[1]);
        shape_free(&one);
        shape_free(&all);
    }
}

/* ---- even and uneven ---- */

typedef struct pixels { uint32_t w, h; uint16_t *count; uint64_t total; } pixels;

static int count_pixels(void *user, const zbufrand_sample *s, const uint32_t *numbers, size_t n) {
    pixels *p = (pixels *)user;
    size_t i;
    (void)numbers;
    for (i = 0; i < n; i++) p->count[(uint32_t)s[i].y * p->w + (uint32_t)s[i].x]++;
    p->total += n;
    return 0;
}

/* A wall of triangles of a quarter of a pixel, turned in its plane, before all of the view; by each way of drawing from
   clusters. Numbers of samples in pixels vary as chance has it, less by strata, least by a comb, which all have the same mean.
   Of independent ones as many pixels get none, and two and more, as the laws say; of stratified ones no more stay empty than
   in a simulation of one sample in each stratum of tiny triangles along a Hilbert curve. */
TEST(pixels_hit) {
    static const double densities[6] = {1, 2, 3, 4, 0.1, 0.5}, simulated[4] = {1, 0.0627, 0.0143, 0.0037};
    const uint32_t w = 160, h = 120;
    pixels p;
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene;
    zbufrand_frame *frame = NULL;
    double dispersion[3] = {0, 0, 0};
    uint32_t way, k, i, seed;
    memset(&s, 0, sizeof s);
    memset(&p, 0, sizeof p);
    p.w = w;
    p.h = h;
    p.count = (uint16_t *)malloc(w * h * sizeof *p.count);
    REQUIRE(p.count != NULL);
    plane(&s, 360, 1);
    for (i = 0; i < s.vertices; i++) { /* 0.3 rad */
        const float x = s.p[3 * i], y = s.p[3 * i + 1];
        s.p[3 * i] = 0.955336f * x - 0.295520f * y;
        s.p[3 * i + 1] = 0.295520f * x + 0.955336f * y;
    }
    m = mesh_of(&s);
    scene = sample_scene_of(&m, 0);
    CHECK_EQ_U64(zbufrand_frame_create(NULL, &frame), ZBUFRAND_OK);
    for (way = 0; way < 3; way++) { /* independent, strata, comb */
        for (k = 0; k < 6; k++) {
            zbufrand_render_desc d;
            double empty = 0, twice = 0, sum = 0, square = 0, n = 0;
            const double mu = densities[k];
            if (way > 0 && k > 3) continue;
            memset(&d, 0, sizeof d);
            d.camera.eye[2] = 1.2;
            d.camera.fov_y = 36;
            d.density = mu;
            d.hybrid = ZBUFRAND_HYBRID_OFF;
            d.independent = way == 0;
            d.comb = way == 2;
            d.costs.set = 1e6f; /* from clusters */
            for (seed = 0; seed < (test_quick() ? 1u : 3u); seed++) {
                d.seed = seed;
                memset(p.count, 0, w * h * sizeof *p.count);
                CHECK_EQ_U64(zbufrand_sample_scene(frame, &d, scene, w, h, count_pixels, &p, NULL), ZBUFRAND_OK);
                for (i = 0; i < w * h; i++) {
                    empty += p.count[i] == 0;
                    twice += p.count[i] > 1;
                    sum += p.count[i];
                    square += (double)p.count[i] * p.count[i];
                    n++;
                }
            }
            CHECK_MSG(fabs(sum / n - mu) < 4.5 * sqrt(mu / n) + 1e-3 * mu, "way %u: %g samples a pixel, not %g", way, sum / n, mu);
            if (k == 3) dispersion[way] = (square / n - sum / n * sum / n) / (sum / n);
            if (way == 0) {
                const double none = exp(-mu), two = zbufrand_multi_hit(mu * w * h, w * h);
                CHECK_MSG(fabs(empty / n - none) < 4.5 * sqrt(none / n), "density %g: %g stay empty, not %g", mu, empty / n, none);
                CHECK_MSG(fabs(twice / n - two) < 4.5 * sqrt(two / n), "density %g: %g are hit twice, not %g", mu, twice / n, two);
            } else if (way == 1) {
                CHECK_MSG(empty / n < simulated[k] + 4.5 * sqrt(simulated[k] / n), "density %g: %g stay empty, %g are expected", mu, empty / n, simulated[k]);
            }
        }
    }
    CHECK_MSG(fabs(dispersion[0] - 1) < 0.05 && dispersion[1] < 0.6 && dispersion[2] < dispersion[1], "variance over mean: %g, %g, %g",
              dispersion[0], dispersion[1], dispersion[2]);
    free(p.count);
    zbufrand_frame_destroy(frame);
    zbufrand_scene_destroy(scene);
    shape_free(&s);
}

/* A wall of triangles about as large as a pixel: what falls on one of them is spread on it, and goes on where that of the one
   before ended. Of 57,600 pixels 2868 would get none of 3 independent samples, 204 got none of stratified ones whose places on
   their triangles were those of the R2 sequence. */
TEST(pixels_of_triangles_hit) {
    const uint32_t w = 160, h = 120;
    pixels p;
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene;
    zbufrand_frame *frame = NULL;
    uint32_t i, seed, empty = 0;
    memset(&s, 0, sizeof s);
    memset(&p, 0, sizeof p);
    p.w = w;
    p.h = h;
    p.count = (uint16_t *)malloc(w * h * sizeof *p.count);
    REQUIRE(p.count != NULL);
    plane(&s, 160, 1);
    for (i = 0; i < s.vertices; i++) { /* 0.3 rad */
        const float x = s.p[3 * i], y = s.p[3 * i + 1];
        s.p[3 * i] = 0.955336f * x - 0.295520f * y;
        s.p[3 * i + 1] = 0.295520f * x + 0.955336f * y;
    }
    m = mesh_of(&s);
    scene = sample_scene_of(&m, 0);
    CHECK_EQ_U64(zbufrand_frame_create(NULL, &frame), ZBUFRAND_OK);
    for (seed = 0; seed < 3; seed++) {
        zbufrand_render_desc d;
        memset(&d, 0, sizeof d);
        d.camera.eye[2] = 1.2;
        d.camera.fov_y = 36;
        d.density = 3;
        d.hybrid = ZBUFRAND_HYBRID_OFF;
        d.costs.set = 1e6f; /* from clusters */
        d.seed = seed;
        memset(p.count, 0, w * h * sizeof *p.count);
        CHECK_EQ_U64(zbufrand_sample_scene(frame, &d, scene, w, h, count_pixels, &p, NULL), ZBUFRAND_OK);
        for (i = 0; i < w * h; i++) empty += p.count[i] == 0;
    }
    CHECK_MSG(empty < 130, "%u pixels stay empty", empty);
    free(p.count);
    zbufrand_frame_destroy(frame);
    zbufrand_scene_destroy(scene);
    shape_free(&s);
}

/* Four levels of references, scaled by 10^-3 to 10^3, turned and mirrored, some in one place: as many samples in each part of the
   picture as of the meshes they stand for, and the same area. */
TEST(four_levels) {
    static const double scales[4] = {1e-3, 1e3, 30, 1.0 / 30};
    test_rng r = test_rng_make(32);
    zbufrand_scene *scene[2] = {NULL, NULL};
    zbufrand_transform all[81], next[81];
    zbufrand_node lib, node, list;
    zbufrand_frame *frame = NULL;
    zbufrand_render_desc d;
    zbufrand_mesh m;
    counts c[2];
    shape s;
    double chi = 0, size = 1;
    uint32_t l, i, k, count = 1, seed, used = 0, x, y;
    memset(&s, 0, sizeof s);
    memset(&d, 0, sizeof d);
    memset(c, 0, sizeof c);
    shape_torus(&s, 0, 0, 0, 1, 0.4, 30, 15);
    m = mesh_of(&s);
    all[0] = move_scale(0, 0, 0, 1);
    for (i = 0; i < 2; i++) CHECK_EQ_U64(zbufrand_scene_create(NULL, &scene[i]), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_list(scene[0], 1, NULL, ZBUFRAND_HIDDEN, &lib), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_mesh(scene[0], lib, NULL, 0, &m, &node), ZBUFRAND_OK);
    for (l = 0; l < 4; l++) {
        CHECK_EQ_U64(zbufrand_add_list(scene[0], l == 3 ? 1 : lib, NULL, 0, &list), ZBUFRAND_OK);
        for (k = 0; k < 3; k++) {
            zbufrand_transform t;
            random_transform(&r, scales[l] * (0.5 + 0.5 * test_rng_double(&r)), (int)(k == 1), &t);
            for (i = 0; i < 3; i++) t.m[i][3] *= size * scales[l];
            if (k == 2) t.m[0][3] = t.m[1][3] = t.m[2][3] = 0;
            CHECK_EQ_U64(zbufrand_add_reference(scene[0], list, &t, node, NULL), ZBUFRAND_OK);
            for (i = 0; i < count; i++) zbufrandi_m34_mul(ZBUFRANDI_M34(t.m), ZBUFRANDI_M34(all[i].m), next[3 * i + k].m);
        }
        count *= 3;
        size *= scales[l] * 2;
        node = list;
        memcpy(all, next, count * sizeof *all);
    }
    CHECK_EQ_U64(count, 81);
    for (i = 0; i < count; i++) CHECK_EQ_U64(zbufrand_add_mesh(scene[1], 1, &all[i], 0, &m, NULL), ZBUFRAND_OK);
    for (i = 0; i < 2; i++) CHECK_EQ_U64(zbufrand_scene_build(scene[i], NULL, NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(scene[0]->info.levels, 4);
    CHECK_EQ_U64(scene[0]->info.triangles, scene[1]->info.triangles);
    CHECK_NEAR(scene[0]->info.area / scene[1]->info.area, 1, 1e-5);
    CHECK_EQ_U64(zbufrand_frame_create(NULL, &frame), ZBUFRAND_OK);
    d.camera.near_z = 1e-6;
    d.hybrid = ZBUFRAND_HYBRID_OFF;
    d.density = 1;
    for (seed = 0; seed < 2; seed++) {
        for (i = 0; i < 2; i++) {
            d.seed = 100 * i + seed;
            CHECK_EQ_U64(zbufrand_camera_fit_scene(&d.camera, scene[1], NULL, SAMPLE_WIDTH, SAMPLE_HEIGHT), ZBUFRAND_OK);
            CHECK_EQ_U64(zbufrand_sample_scene(frame, &d, scene[i], SAMPLE_WIDTH, SAMPLE_HEIGHT, count_sample, &c[i], NULL), ZBUFRAND_OK);
        }
    }
    for (y = 0; y < GRID; y++) {
        for (x = 0; x < GRID; x++) {
            const double a = c[0].cell[y][x], b = c[1].cell[y][x];
            if (a + b < 20) continue;
            chi += (a - b) * (a - b) / (a + b);
            used++;
        }
    }
    CHECK_MSG(used > 40 && chi < chi_limit(used), "chi-square %g of %u cells", chi, used);
    CHECK_MSG(c[0].total > 5000 && fabs((double)c[0].total - (double)c[1].total) < 4.5 * sqrt((double)(c[0].total + c[1].total)), "%llu and %llu samples",
              (unsigned long long)c[0].total, (unsigned long long)c[1].total);
    zbufrand_frame_destroy(frame);
    for (i = 0; i < 2; i++) zbufrand_scene_destroy(scene[i]);
    shape_free(&s);
}

/* ---- weights of triangles ---- */

/* One cluster, triangles whose areas in the picture span 12 decades: how often each is sampled. */
/* Area of a mesh in the picture: triangles that face the eye (two_sided: all), one by one, wherever they are. */
static double projected_area(const shape *s, const zbufrand_transform *t, const zbufrandi_camera *c, int two_sided) {
    double sum = 0, p[3][3], q[3][2];
    size_t i;
    int k, a;
    for (i = 0; i < s->triangles; i++) {
        double area;
        for (k = 0; k < 3; k++) {
            double v[3], z;
            for (a = 0; a < 3; a++) v[a] = (double)s->p[3 * s->t[3 * i + (size_t)k] + (size_t)a];
            zbufrandi_m34_point(ZBUFRANDI_M34(t->m), v, p[k]);
            for (a = 0; a < 3; a++) p[k][a] -= c->eye[a];
            z = p[k][0] * c->dir[0] + p[k][1] * c->dir[1] + p[k][2] * c->dir[2];
            q[k][0] = (p[k][0] * c->right[0] + p[k][1] * c->right[1] + p[k][2] * c->right[2]) * c->focal / z;
            q[k][1] = (p[k][0] * c->up[0] + p[k][1] * c->up[1] + p[k][2] * c->up[2]) * c->focal / z;
        }
        area = 0.5 * ((q[1][0] - q[0][0]) * (q[2][1] - q[0][1]) - (q[1][1] - q[0][1]) * (q[2][0] - q[0][0]));
        sum += area > 0 ? area : two_sided ? -area : 0;
    }
    return sum;
}

/* What many instances share has points for each direction of view: as many fall into the picture as into that of any
   other way, for each instance (one in each cell of the picture, turned at random). p below 1e-5 for both sums. */
TEST(points_for_directions) {
    test_rng r = test_rng_make(47);
    int two_sided;
    for (two_sided = 0; two_sided < 2; two_sided++) {
        shape s;
        zbufrand_mesh m;
        zbufrand_scene *scene = NULL;
        zbufrand_frame *frame = NULL;
        zbufrand_node mesh;
        zbufrand_render_desc d;
        zbufrandi_camera camera;
        zbufrand_transform t[GRID * GRID];
        zbufrand_group *group = (zbufrand_group *)malloc(4 * GRID * GRID * sizeof *group);
        double chi = 0, wanted = 0, asked = 0, most = 0;
        const uint32_t seeds = test_quick() ? 2 : 6;
        uint32_t i, views = 0;
        size_t groups, k;
        counts c;
        memset(&s, 0, sizeof s);
        memset(&c, 0, sizeof c);
        memset(&d, 0, sizeof d);
        REQUIRE(group != NULL);
        shape_torus(&s, 0, 0, 0, 1, 0.6, 80, 40);
        CHECK_EQ_U64(zbufrand_scene_create(NULL, &scene), ZBUFRAND_OK);
        m = mesh_of(&s);
        m.two_sided = (uint32_t)two_sided;
        CHECK_EQ_U64(zbufrand_add_mesh(scene, 1, NULL, ZBUFRAND_HIDDEN, &m, &mesh), ZBUFRAND_OK);
        d.camera.eye[2] = 400;
        d.camera.at[2] = -1;
        d.camera.fov_y = 20;
        d.density = 2;
        CHECK_EQ_U64(zbufrandi_camera_open(&d.camera, NULL, SAMPLE_WIDTH, SAMPLE_HEIGHT, 0, &camera), ZBUFRAND_OK);
        for (i = 0; i < GRID * GRID; i++) {
            const double x = (i % GRID + 0.5) * SAMPLE_WIDTH / GRID, y = (i / GRID + 0.5) * SAMPLE_HEIGHT / GRID;
            sample_transform(&r, 1.0 + 0.4 * test_rng_double(&r), (int)(i % 3 == 0), &t[i]);
            t[i].m[0][3] = (x - camera.center_x) * 400 / camera.focal;
            t[i].m[1][3] = (camera.center_y - y) * 400 / camera.focal;
            t[i].m[2][3] = 0;
        }
        CHECK_EQ_U64(zbufrand_add_references(scene, 1, t, GRID * GRID, mesh, NULL), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_scene_build(scene, NULL, NULL), ZBUFRAND_OK);
        REQUIRE(scene->structure[1].first_view != 0);
        CHECK_EQ_U64(zbufrand_frame_create(NULL, &frame), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_select(frame, &d, scene, SAMPLE_WIDTH, SAMPLE_HEIGHT, group, 4 * GRID * GRID, &groups, NULL), ZBUFRAND_OK);
        REQUIRE(groups <= 4 * GRID * GRID);
        for (k = 0; k < groups; k++) {
            views += group[k].kind == ZBUFRAND_DRAW_STORED && group[k].expected < 0.9 * d.density * group[k].area * group[k].factor_max;
            asked += group[k].count;
            CHECK(fabs(group[k].count - group[k].expected) <= 1.001);
        }
        CHECK_MSG(views * 10 >= groups * 9, "only %u of %u groups are for a direction", views, (unsigned)groups);
        for (i = 0; i < seeds; i++) {
            d.seed = i;
            CHECK_EQ_U64(zbufrand_sample_scene(frame, &d, scene, SAMPLE_WIDTH, SAMPLE_HEIGHT, count_sample, &c, NULL), ZBUFRAND_OK);
        }
        for (i = 0; i < GRID * GRID; i++) {
            const int mirrored = i % 3 == 0;
            double expected, off;
            shape turned = s;
            uint32_t *swap = NULL;
            size_t n;
            if (mirrored) { /* the outside stays the outside */
                swap = (uint32_t *)malloc(3 * s.triangles * sizeof *swap);
                REQUIRE(swap != NULL);
                for (n = 0; n < s.triangles; n++) {
                    swap[3 * n] = s.t[3 * n];
                    swap[3 * n + 1] = s.t[3 * n + 2];
                    swap[3 * n + 2] = s.t[3 * n + 1];
                }
                turned.t = swap;
            }
            expected = projected_area(&turned, &t[i], &camera, two_sided) * d.density * seeds;
            free(swap);
            off = c.cell[i / GRID][i % GRID] - expected;
            chi += off * off / expected;
            wanted += expected / seeds;
            most = fabs(off) / sqrt(expected) > most ? fabs(off) / sqrt(expected) : most;
        }
        CHECK_MSG(chi < chi_limit(GRID * GRID), "chi-square %g", chi);
        CHECK_MSG(most < 5.5, "one is off by %g standard deviations", most);
        CHECK_MSG(fabs((double)c.total / seeds - wanted) < 4.5 * sqrt(wanted / seeds) + 0.002 * wanted, "%g samples, not %g",
                  (double)c.total / seeds, wanted);
        CHECK_MSG(asked > wanted && asked < 2.2 * wanted, "%g points for %g samples", asked, wanted); /* most are used */
        zbufrand_frame_destroy(frame);
        zbufrand_scene_destroy(scene);
        shape_free(&s);
        free(group);
    }
}

TEST(twelve_decades_in_a_cluster) {
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene;
    zbufrandi_camera camera;
    zbufrand_camera k;
    zbufrandi_cut cut;
    zbufrandi_target g;
    zbufrandi_local local;
    zbufrandi_draw d;
    zbufrandi_flatten constants;
    static zbufrandi_flat f;
    double area[128], seen[128], chi = 0;
    uint32_t i, j, h, n, used = 0, independent;
    memset(&s, 0, sizeof s);
    for (i = 0; i < 100; i++) { /* side by side, facing +z, legs from 1e-6 to 1 */
        double e = pow(10, -6.0 * i / 99), x = 0.02 * i;
        shape_triangle(&s, shape_vertex(&s, x, 0, 0), shape_vertex(&s, x + e, 0, 0), shape_vertex(&s, x, e, 0));
    }
    for (i = 0; i < 28; i++) shape_triangle(&s, shape_vertex(&s, i, 5, 0), shape_vertex(&s, i, 6, 0), shape_vertex(&s, i + 1, 5, 0)); /* away */
    m = mesh_of(&s);
    scene = sample_scene_of(&m, 1);
    memset(&k, 0, sizeof k);
    k.eye[2] = k.at[2] = 30;
    k.at[2] = 0;
    memset(&g, 0, sizeof g);
    memset(&d, 0, sizeof d);
    memset(&cut, 0, sizeof cut);
    CHECK_EQ_U64(zbufrandi_camera_open(&k, scene, SAMPLE_WIDTH, SAMPLE_HEIGHT, 0, &camera), ZBUFRAND_OK);
    cut.scene = scene;
    cut.camera = camera;
    cut.density = 1;
    g.cut = &cut;
    g.focal = camera.focal;
    g.width = SAMPLE_WIDTH;
    g.height = SAMPLE_HEIGHT;
    g.center_x = (float)camera.center_x;
    g.center_y = (float)camera.center_y;
    zbufrandi_local_root(&camera, &scene->structure[0], 1, &local);
    for (independent = 0; independent < 2; independent++) {
        const zbufrandi_structure *st = &scene->structure[0];
        uint32_t c;
        double draws = 0;
        cut.independent = (int)independent;
        memset(seen, 0, sizeof seen);
        memset(area, 0, sizeof area);
        chi = 0;
        used = 0;
        for (c = 0; c < st->cluster_count; c++) { /* size classes make several clusters of it; each is a test */
            const zbufrandi_cluster *cl = &st->cluster[c];
            double sum = 0;
            uint32_t t;
            d.h_ref = 0;
            for (t = 0; t < cl->triangle_count; t++) {
                uint32_t id = st->triangle_id[cl->first_triangle + t];
                double e = pow(10, -6.0 * id / 99);
                area[t] = id < 100 ? 0.5 * e * e : 0;
                sum += area[t];
                seen[t] = 0;
            }
            if (!(sum > 0)) continue;
            d.h_ref = (float)(sum * camera.focal * camera.focal / 900 * 1.3); /* a bound of the area in the picture */
            d.count = 0x7fffffff;
            draws = 0;
            for (h = 0; h < (test_quick() ? 500u : 5000u); h++) {
                uint32_t wanted = 400;
                d.hash = zbufrandi_hash32(h * 7919u + c);
                zbufrandi_flatten_begin(&g, &d, &local, &constants, &f);
                zbufrandi_flatten_cluster(&g, &constants, st, cl, &f);
                n = wanted;
                if (independent) zbufrandi_flat_independent(&d, &f, cl->triangle_count, 0, n);
                else {
                    zbufrandi_flat_begin(&d, n, 0, &f);
                    zbufrandi_flat_strata(&f, cl->triangle_count, n, 0, n);
                }
                for (j = 0; j < n; j++) {
                    REQUIRE(f.triangle[j] < cl->triangle_count);
                    seen[f.triangle[j]] += 1;
                }
                draws += n;
            }
            for (t = 0; t < cl->triangle_count; t++) {
                double expected = draws * area[t] / sum;
                if (area[t] <= 0) CHECK(seen[t] == 0); /* faces away: never */
                if (expected < 10) {
                    CHECK(seen[t] < 40);
                    continue;
                }
                chi += (seen[t] - expected) * (seen[t] - expected) / expected;
                used++;
            }
        }
        CHECK(used > 20);
        CHECK_MSG(chi < chi_limit(used), "chi-square %g of %u triangles", chi, used);
        if (independent) CHECK_MSG(chi > used - 4.3 * sqrt(2.0 * used), "too even: %g of %u", chi, used);
    }
    zbufrand_scene_destroy(scene);
    shape_free(&s);
}

/* A comb through 100 triangles of equal area, 20 teeth: every fifth. Both forms; unbiased. */
TEST(combs_of_clusters) {
    zbufrandi_flat f[2];
    zbufrandi_draw d;
    uint32_t h, i, first[5] = {0, 0, 0, 0, 0};
    memset(f, 0, sizeof f);
    memset(&d, 0, sizeof d);
    for (i = 0; i < 100; i++) f[0].sum[i] = f[1].sum[i] = 1000000 * (i + 1);
    f[0].total = f[1].total = 100000000;
    for (h = 0; h < 1000; h++) {
        uint32_t wrong = 0;
        d.hash = zbufrandi_hash32(h);
        for (i = 0; i < 2; i++) zbufrandi_flat_begin(&d, 20, 1, &f[i]);
        zbufrandi_flat_strata(&f[0], 100, 20, 0, 20);
#if ZBUFRANDI_AVX2
        if (zbufrandi_cpu_level() >= 3) {
            zbufrandi_flat_strata_avx2(&f[1], 100, 20);
            CHECK(memcmp(f[0].triangle, f[1].triangle, 20) == 0);
        }
#endif
        for (i = 0; i < 20; i++) wrong += f[0].triangle[i] != f[0].triangle[0] + 5 * i;
        CHECK_MSG(wrong == 0 && f[0].triangle[0] < 5, "draw %u: %u teeth", h, wrong);
        first[f[0].triangle[0] % 5]++;
    }
    for (i = 0; i < 5; i++) CHECK_MSG(first[i] > 140 && first[i] < 260, "%u of 1000", first[i]); /* 4.7 standard deviations */
}

/* Weights on a triangle: means, variances, covariance; 64 equal parts. */
TEST(uniform_on_a_triangle) {
    uint32_t mode, i;
    for (mode = 0; mode < 2; mode++) {
        double su = 0, sv = 0, suu = 0, svv = 0, suv = 0, part[64], chi = 0;
        const uint32_t n = 200000;
        memset(part, 0, sizeof part);
        for (i = 0; i < n; i++) {
            float u, v;
            double w[3], fu, fv;
            uint32_t a, b;
            zbufrandi_flat_weights(zbufrandi_hash32(17), zbufrandi_hash32(19), mode ? i : zbufrandi_hash32(i), (int)mode, &u, &v);
            w[1] = (double)u;
            w[2] = (double)v;
            w[0] = 1 - w[1] - w[2];
            CHECK(w[0] >= -1e-6 && w[1] >= 0 && w[2] >= 0);
            su += w[1];
            sv += w[2];
            suu += w[1] * w[1];
            svv += w[2] * w[2];
            suv += w[1] * w[2];
            a = (uint32_t)(w[1] * 8); /* the triangle cut into 8 x 8: 36 upright parts, 28 upside down */
            b = (uint32_t)(w[2] * 8);
            fu = w[1] * 8 - a;
            fv = w[2] * 8 - b;
            {
                uint32_t up = fu + fv < 1, row = a, col = b, id, k;
                for (id = 0, k = 0; k < row; k++) id += 2 * (8 - k) - 1;
                id += 2 * col + (up ? 0 : 1);
                if (id < 64) part[id] += 1;
            }
        }
        CHECK_NEAR(su / n, 1.0 / 3, 0.003);
        CHECK_NEAR(sv / n, 1.0 / 3, 0.003);
        CHECK_NEAR(suu / n - su / n * su / n, 1.0 / 18, 0.001);
        CHECK_NEAR(svv / n - sv / n * sv / n, 1.0 / 18, 0.001);
        CHECK_NEAR(suv / n - su / n * sv / n, -1.0 / 36, 0.001);
        for (i = 0; i < 64; i++) chi += (part[i] - n / 64.0) * (part[i] - n / 64.0) / (n / 64.0);
        CHECK_MSG(chi < chi_limit(63), "chi-square %g", chi);
    }
}

/* ---- points of surfaces ---- */

static double triangle_area(const shape *s, uint32_t t) {
    double n[3];
    zbufrandi_cross(s->p + 3 * s->t[3 * t], s->p + 3 * s->t[3 * t + 1], s->p + 3 * s->t[3 * t + 2], n);
    return 0.5 * sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
}

typedef struct surface_points { size_t n; float *p, *normal; uint8_t *rgb; uint32_t *id; } surface_points;

static void on_their_triangles(const surface_points *g, const shape *s, const uint8_t *color) { /* and as these are */
    size_t i;
    uint32_t k, a;
    for (i = 0; i < g->n; i += 7) {
        uint32_t t = g->id[2 * i + 1];
        const float *v[3];
        double w[3], tn[3], l, off = 0, dot = 0;
        REQUIRE(t < s->triangles);
        for (k = 0; k < 3; k++) v[k] = s->p + 3 * s->t[3 * t + k];
        zbufrandi_cross(v[0], v[1], v[2], tn);
        l = sqrt(tn[0] * tn[0] + tn[1] * tn[1] + tn[2] * tn[2]);
        for (a = 0; a < 3; a++) {
            off += tn[a] / l * ((double)g->p[3 * i + a] - (double)v[0][a]);
            dot += tn[a] / l * (double)g->normal[3 * i + a];
            CHECK_EQ_U64(g->rgb[3 * i + a], color[3 * t + a]);
        }
        CHECK_MSG(fabs(off) < 3e-7, "point %u is %g off its plane", (unsigned)i, off);
        CHECK(dot > 0.9999);
        for (k = 0; k < 3; k++) { /* distance from the edges, to rounding */
            const float *u = v[k], *o = v[(k + 1) % 3];
            double e[3], x[3], le;
            for (a = 0; a < 3; a++) {
                e[a] = (double)o[a] - (double)u[a];
                x[a] = (double)g->p[3 * i + a] - (double)u[a];
            }
            le = sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2]);
            w[k] = (tn[0] * (e[1] * x[2] - e[2] * x[1]) + tn[1] * (e[2] * x[0] - e[0] * x[2]) + tn[2] * (e[0] * x[1] - e[1] * x[0])) / (l * le);
            CHECK_MSG(w[k] > -4e-7, "point %u lies %g outside of its triangle", (unsigned)i, -w[k]);
        }
    }
}

/* Any prefix has as many points on each triangle as its area asks. */
static void as_areas_ask(const surface_points *g, const shape *s, const double *area, double total, uint32_t mode) {
    size_t prefix, i;
    for (prefix = 3000; prefix <= g->n; prefix *= prefix < 20000 ? 8 : 4) {
        double chi = 0, *seen = (double *)calloc(s->triangles, sizeof *seen);
        uint32_t used = 0;
        double small = 0, small_seen = 0;
        REQUIRE(seen != NULL);
        for (i = 0; i < prefix; i++) seen[g->id[2 * i + 1]] += 1;
        for (i = 0; i < s->triangles; i++) {
            double expected = (double)prefix * area[i] / total;
            if (expected < 8) {
                small += expected;
                small_seen += seen[i];
                continue;
            }
            chi += (seen[i] - expected) * (seen[i] - expected) / expected;
            used++;
        }
        CHECK_MSG(used == 0 || chi < chi_limit(used), "mode %u, %zu points: chi-square %g of %u", mode, prefix, chi, used);
        if (mode == 1 && used > 30) CHECK_MSG(chi > used - 4.3 * sqrt(2.0 * used), "independent ones are too even: %g of %u", chi, used);
        CHECK_MSG(fabs(small - small_seen) < 4.5 * sqrt(small) + 1, "%g points on small triangles, %g expected", small_seen, small);
        free(seen);
    }
}

/* Pieces are the same as the whole; less asked for is the same, too; with another seed it is not. */
static void pieces_of_the_whole(const surface_points *g, const zbufrand_scene *scene, zbufrand_surface_points_desc d) {
    const size_t n = g->n;
    size_t done = 0, step = 777;
    float *q = (float *)malloc(12 * n);
    REQUIRE(q != NULL);
    while (done < n) {
        size_t c = n - done < step ? n - done : step;
        d.first = done;
        CHECK_EQ_U64(zbufrand_surface_points(scene, &d, c, q + 3 * done, NULL, NULL, NULL), ZBUFRAND_OK);
        done += c;
        step *= 5;
    }
    CHECK(memcmp(g->p, q, 12 * n) == 0);
    d.first = 0;
    d.seed = 1;
    CHECK_EQ_U64(zbufrand_surface_points(scene, &d, 100, q, NULL, NULL, NULL), ZBUFRAND_OK);
    CHECK(memcmp(g->p, q, 1200) != 0);
    free(q);
}

TEST(points_of_a_mesh) {
    test_rng r = test_rng_make(41);
    const size_t n = test_quick() ? 60000 : 1200000;
    uint32_t mode, i, k, a;
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene;
    surface_points g;
    uint8_t *color;
    double *area, total = 0;
    g.n = n;
    g.p = (float *)malloc(12 * n);
    g.normal = (float *)malloc(12 * n);
    g.rgb = (uint8_t *)malloc(3 * n);
    g.id = (uint32_t *)malloc(8 * n);
    REQUIRE(g.p != NULL && g.normal != NULL && g.rgb != NULL && g.id != NULL);
    memset(&s, 0, sizeof s);
    for (i = 0; i < 4000; i++) { /* legs over six decades: areas over twelve */
        double c[3], e = 0.5 * pow(10, -6 * test_rng_double(&r));
        uint32_t v[3];
        for (a = 0; a < 3; a++) c[a] = test_rng_double(&r);
        for (k = 0; k < 3; k++) {
            double at[3];
            for (a = 0; a < 3; a++) at[a] = c[a] + e * (test_rng_double(&r) - 0.5);
            v[k] = shape_vertex(&s, at[0], at[1], at[2]);
        }
        shape_triangle(&s, v[0], v[1], v[2]);
    }
    color = (uint8_t *)malloc(3 * s.triangles);
    area = (double *)malloc(s.triangles * sizeof *area);
    REQUIRE(color != NULL && area != NULL);
    for (i = 0; i < 3 * s.triangles; i++) color[i] = (uint8_t)test_rng_u32(&r);
    for (i = 0; i < s.triangles; i++) total += area[i] = triangle_area(&s, i);
    m = mesh_of(&s);
    m.triangle_rgb = color;
    scene = sample_scene_of(&m, 1);
    for (mode = 0; mode < 2; mode++) {
        zbufrand_surface_points_desc d;
        memset(&d, 0, sizeof d);
        d.independent = mode;
        CHECK_EQ_U64(zbufrand_surface_points(scene, &d, n, g.p, g.normal, g.rgb, g.id), ZBUFRAND_OK);
        on_their_triangles(&g, &s, color);
        as_areas_ask(&g, &s, area, total, mode);
        pieces_of_the_whole(&g, scene, d);
    }
    free(g.p);
    free(g.normal);
    free(g.rgb);
    free(g.id);
    free(color);
    free(area);
    zbufrand_scene_destroy(scene);
    shape_free(&s);
}

/* Short prefixes of stratified points are more even than chance: mean squares of counts in 64 slabs. */
TEST(short_prefixes_are_even) {
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene;
    double sum[2] = {0, 0};
    uint32_t seed, mode, i;
    memset(&s, 0, sizeof s);
    plane(&s, 60, 1);
    m = mesh_of(&s);
    scene = sample_scene_of(&m, 0);
    for (seed = 0; seed < 20; seed++) {
        for (mode = 0; mode < 2; mode++) {
            zbufrand_surface_points_desc d;
            float p[3 * 500];
            double cell[64];
            memset(&d, 0, sizeof d);
            memset(cell, 0, sizeof cell);
            d.seed = seed;
            d.independent = mode;
            CHECK_EQ_U64(zbufrand_surface_points(scene, &d, 500, p, NULL, NULL, NULL), ZBUFRAND_OK);
            for (i = 0; i < 500; i++) cell[(int)((p[3 * i] + 1) * 3.999f) * 8 + (int)((p[3 * i + 1] + 1) * 3.999f)] += 1;
            for (i = 0; i < 64; i++) sum[mode] += (cell[i] - 500 / 64.0) * (cell[i] - 500 / 64.0) / (500 / 64.0) / 64 / 20;
        }
    }
    CHECK_MSG(sum[1] > 0.85 && sum[1] < 1.15, "independent: variance over mean %g", sum[1]);
    CHECK_MSG(sum[0] < 0.5, "stratified: variance over mean %g", sum[0]);
    zbufrand_scene_destroy(scene);
    shape_free(&s);
}

/* So many independent points that drawing without putting back would show: 2 % of 2^32 places. */
TEST(a_hundred_million_points_are_independent) {
    enum { SIDE = 320, PART = 1 << 18 };
    const uint32_t parts = test_quick() ? 4 : 400, cells = 2 * SIDE * SIDE * 4; /* triangles, in four parts each */
    zbufrand_surface_points_desc d;
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene;
    float *p = (float *)malloc(12 * (size_t)PART);
    uint32_t *id = (uint32_t *)malloc(8 * (size_t)PART), *seen = (uint32_t *)calloc(cells, sizeof *seen), k, i;
    double expected, chi[2] = {0, 0};
    REQUIRE(p != NULL && id != NULL && seen != NULL);
    memset(&s, 0, sizeof s);
    memset(&d, 0, sizeof d);
    plane(&s, SIDE, 1);
    m = mesh_of(&s);
    REQUIRE(s.triangles * 4 == cells);
    scene = sample_scene_of(&m, 1);
    d.independent = 1;
    for (k = 0; k < parts; k++, d.first += PART) {
        CHECK_EQ_U64(zbufrand_surface_points(scene, &d, PART, p, NULL, NULL, id), ZBUFRAND_OK);
        for (i = 0; i < PART; i++) { /* which corner it is near, or none: halves of the barycentric coordinates */
            const uint32_t *t = s.t + 3 * id[2 * i + 1];
            const float *a = s.p + 3 * t[0], *b = s.p + 3 * t[1], *c = s.p + 3 * t[2];
            const double ux = (double)b[0] - (double)a[0], uy = (double)b[1] - (double)a[1], vx = (double)c[0] - (double)a[0],
                vy = (double)c[1] - (double)a[1], x = (double)p[3 * i] - (double)a[0], y = (double)p[3 * i + 1] - (double)a[1],
                det = ux * vy - uy * vx, u = (x * vy - y * vx) / det, v = (ux * y - uy * x) / det;
            seen[4 * id[2 * i + 1] + (u > 0.5 ? 1 : v > 0.5 ? 2 : u + v < 0.5 ? 3 : 0)]++;
        }
    }
    expected = (double)parts * PART / cells;
    for (i = 0; i < cells; i++) {
        const double off = (double)seen[i] - expected, whole = (double)seen[i] + (double)seen[i ^ 1] + (double)seen[i ^ 2] + (double)seen[i ^ 3] - 4 * expected;
        chi[0] += off * off / expected;
        if (i % 4 == 0) chi[1] += whole * whole / (4 * expected);
    }
    for (i = 0; i < 2; i++) {
        const double n = (i == 0 ? cells : cells / 4) - 1;
        chi[i] = (chi[i] - n) / sqrt(2 * n);
        if (test_g.verbose) printf("%g points, chi squared of %g cells is %.2f deviations off\n", (double)parts * PART, n + 1, chi[i]);
        CHECK_MSG(fabs(chi[i]) < 4, "%g points, chi squared of %g cells is %.2f deviations off", (double)parts * PART, n + 1, chi[i]);
    }
    free(p);
    free(id);
    free(seen);
    zbufrand_scene_destroy(scene);
    shape_free(&s);
}

TEST(points_of_instances) {
    test_rng r = test_rng_make(43);
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene = NULL;
    zbufrand_node lib, node, list;
    double weight[30], seen[30], total = 0, chi = 0, center[30][3];
    const uint32_t n = 60000;
    float *p = (float *)malloc(12 * n), *normal = (float *)malloc(12 * n);
    uint32_t i, k, a;
    REQUIRE(p != NULL && normal != NULL);
    memset(&s, 0, sizeof s);
    memset(seen, 0, sizeof seen);
    shape_sphere(&s, 0, 0, 0, 1, 30);
    m = mesh_of(&s);
    CHECK_EQ_U64(zbufrand_scene_create(NULL, &scene), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_list(scene, 1, NULL, ZBUFRAND_HIDDEN, &lib), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_mesh(scene, lib, NULL, 0, &m, &node), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_list(scene, lib, NULL, 0, &list), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_reference(scene, list, NULL, node, NULL), ZBUFRAND_OK); /* two levels */
    for (i = 0; i < 30; i++) {
        zbufrand_transform t;
        double scale = pow(10, 1.5 * test_rng_double(&r) - 1.5);
        sample_transform(&r, scale, (int)(i & 1), &t);
        for (a = 0; a < 3; a++) t.m[a][3] = center[i][a] = a == 0 ? 4.0 * i : 0;
        CHECK_EQ_U64(zbufrand_add_reference(scene, 1, &t, list, NULL), ZBUFRAND_OK);
        total += weight[i] = scale * scale;
    }
    CHECK_EQ_U64(zbufrand_surface_points(scene, NULL, 1, p, NULL, NULL, NULL), ZBUFRAND_ERR_EMPTY); /* not built yet */
    CHECK_EQ_U64(zbufrand_scene_build(scene, NULL, NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_surface_points(scene, NULL, n, p, normal, NULL, NULL), ZBUFRAND_OK);
    for (i = 0; i < n; i++) {
        double d[3], l, dot = 0;
        k = (uint32_t)floor((double)p[3 * i] / 4 + 0.5);
        REQUIRE(k < 30);
        seen[k] += 1;
        for (a = 0; a < 3; a++) d[a] = (double)p[3 * i + a] - center[k][a];
        l = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
        CHECK(l < sqrt(weight[k]) * 1.001 && l > sqrt(weight[k]) * 0.99);
        for (a = 0; a < 3; a++) dot += d[a] / l * (double)normal[3 * i + a];
        CHECK(dot > 0.99);
    }
    for (k = 0; k < 30; k++) {
        double expected = n * weight[k] / total;
        if (expected > 5) chi += (seen[k] - expected) * (seen[k] - expected) / expected;
    }
    CHECK_MSG(chi < chi_limit(29), "chi-square %g", chi);
    free(p);
    free(normal);
    zbufrand_scene_destroy(scene);
    shape_free(&s);
}

/* Smooth normals and colours between vertices. */
/* Four of four of four ... with four meshes at the end, more things than a number has bits for: each mesh gets a quarter
   of the points, and a whole page has the points that are given out one by one. */
TEST(points_of_powers_of_two) {
    enum { N = 8000, LEVELS = 30 };
    static const float p[][3] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}};
    static const uint32_t t[][3] = {{0, 1, 2}, {0, 2, 3}};
    static zbufrand_transform place[LEVELS][4];
    static float position[N][3], normal[N][3];
    static uint32_t id[N][2];
    const size_t page = ZBUFRANDI_PAGE; /* from here on points are made by a page */
    float *all = (float *)malloc(page * 6 * sizeof(float));
    zbufrand_scene *s = NULL;
    zbufrand_surface_points_desc d;
    zbufrand_build_desc b;
    zbufrand_node lib, node, list, mesh[4];
    double step = 1, x = 0;
    uint32_t i, k, mode;
    REQUIRE(all != NULL);
    memset(&b, 0, sizeof b);
    b.ids = 1;
    CHECK_EQ_U64(zbufrand_scene_create(NULL, &s), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_list(s, ZBUFRAND_ROOT, NULL, ZBUFRAND_HIDDEN, &lib), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_list(s, lib, NULL, 0, &node), ZBUFRAND_OK);
    for (i = 0; i < 4; i++) {
        zbufrand_transform at = move_scale(i & 1, i >> 1, 0, 1);
        zbufrand_mesh m;
        memset(&m, 0, sizeof m);
        m.positions = p[0];
        m.vertex_count = 4;
        m.indices = t[0];
        m.triangle_count = 2;
        CHECK_EQ_U64(zbufrand_add_mesh(s, node, &at, ZBUFRAND_OWN_STRUCTURE, &m, &mesh[i]), ZBUFRAND_OK);
    }
    for (k = 0; k < LEVELS; k++) {
        step *= 2;
        for (i = 0; i < 4; i++) place[k][i] = move_scale(step * (i & 1), step * (i >> 1), 0, 1);
        CHECK_EQ_U64(zbufrand_add_list(s, k + 1 == LEVELS ? ZBUFRAND_ROOT : lib, NULL, 0, &list), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_references(s, list, place[k], 4, node, NULL), ZBUFRAND_OK);
        node = list;
    }
    CHECK_EQ_U64(zbufrand_scene_build(s, &b, NULL), ZBUFRAND_OK);
    memset(&d, 0, sizeof d);
    for (mode = 0; mode < 2; mode++) {
        uint32_t count[4] = {0, 0, 0, 0}, first = 0;
        d.independent = mode;
        CHECK_EQ_U64(zbufrand_surface_points(s, &d, N, position[0], NULL, NULL, id[0]), ZBUFRAND_OK);
        for (i = 0; i < N; i++) {
            for (k = 0; k < 4; k++) count[k] += id[i][0] == mesh[k];
            first += id[i][1] == 0;
            x += (double)position[i][0] / (2 * step) / (2.0 * N);
        }
        for (k = 0; k < 4; k++) CHECK_MSG(fabs(count[k] / (double)N - 0.25) < 0.03, "%u of %u points on mesh %u", (unsigned)count[k], (unsigned)N, (unsigned)k);
        CHECK_NEAR(first / (double)N, 0.5, 0.03);
    }
    CHECK_NEAR(x, 0.5, 0.02);
    d.independent = 0;
    CHECK_EQ_U64(zbufrand_surface_points(s, &d, page, all, all + 3 * page, NULL, NULL), ZBUFRAND_OK);
    for (k = 0; k < 3; k++) {
        d.first = 500000 * k; /* within a chapter */
        CHECK_EQ_U64(zbufrand_surface_points(s, &d, N, position[0], normal[0], NULL, NULL), ZBUFRAND_OK);
        CHECK(memcmp(position, all + 3 * d.first, sizeof position) == 0);
        CHECK(memcmp(normal, all + 3 * page + 3 * d.first, sizeof normal) == 0);
    }
    zbufrand_scene_destroy(s);
    free(all);
}

TEST(attributes_of_surface_points) {
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene;
    zbufrand_surface_points_desc d;
    uint8_t *color, rgb[3 * 300];
    float p[3 * 300], n[3 * 300];
    uint32_t i, a;
    memset(&s, 0, sizeof s);
    memset(&d, 0, sizeof d);
    shape_sphere(&s, 5, 6, 7, 2, 40);
    color = (uint8_t *)malloc(3 * s.vertices);
    REQUIRE(color != NULL);
    for (i = 0; i < s.vertices; i++) for (a = 0; a < 3; a++) color[3 * i + a] = (uint8_t)(127.5f + 127.0f * s.normal[3 * i + a]);
    m = mesh_of(&s);
    m.normals = s.normal;
    m.vertex_rgb = color;
    scene = sample_scene_of(&m, 0);
    d.vertex_normals = 1;
    CHECK_EQ_U64(zbufrand_surface_points(scene, &d, 300, p, n, rgb, NULL), ZBUFRAND_OK);
    for (i = 0; i < 300; i++) {
        double dot = 0;
        for (a = 0; a < 3; a++) {
            double x = ((double)p[3 * i + a] - 5 - a) / 2;
            dot += x * (double)n[3 * i + a];
            CHECK_NEAR((double)rgb[3 * i + a], 127.5 + 127 * x, 9);
        }
        CHECK_MSG(dot > 0.995, "normal %u: %g", i, dot);
    }
    {
        uint32_t id[2];
        CHECK_EQ_U64(zbufrand_surface_points(scene, &d, 1, p, NULL, NULL, id), ZBUFRAND_ERR_INVALID_ARG); /* built without ids */
        CHECK_EQ_U64(zbufrand_surface_points(scene, &d, 1, NULL, NULL, NULL, NULL), ZBUFRAND_ERR_INVALID_ARG);
        CHECK_EQ_U64(zbufrand_surface_points(scene, &d, 0, NULL, NULL, NULL, NULL), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_surface_points(NULL, &d, 1, p, NULL, NULL, NULL), ZBUFRAND_ERR_INVALID_ARG);
    }
    free(color);
    zbufrand_scene_destroy(scene);
    shape_free(&s);
}

/* A triangle of 10^9 pixels: within a column of four of them places are still uniform, and many (Kolmogorov and Smirnov, p = 1e-3). */
TEST(fine_places) {
    const uint32_t n = 1u << 22;
    const double edge = 44721 / 4.0;
    uint32_t way, j, i, k;
    double *seen = (double *)malloc(8192 * sizeof *seen);
    REQUIRE(seen != NULL);
    for (way = 0; way < 4; way++) { /* R2 and independent, both weights */
        uint32_t count = 0, distinct = 1;
        double worst = 0;
        for (j = 0; j < n; j++) {
            float u, v;
            double at;
            zbufrandi_flat_weights(0x1234567u, 0x89abcdefu, j, (int)(way & 1), &u, &v);
            at = ((double)(way & 2 ? v : u) - 0.3) * edge;
            if (at >= 0 && at < 1 && count < 8192) seen[count++] = at;
        }
        CHECK_MSG(count > 400 && count < 700, "%u in four pixels", count);
        for (i = 1; i < count; i++) { /* sorted by insertion */
            const double x = seen[i];
            for (k = i; k > 0 && seen[k - 1] > x; k--) seen[k] = seen[k - 1];
            seen[k] = x;
        }
        for (i = 0; i < count; i++) {
            worst = fmax(worst, fmax((i + 1.0) / count - seen[i], seen[i] - (double)i / count));
            distinct += i > 0 && seen[i] > seen[i - 1];
        }
        CHECK_MSG(worst < 1.95 / sqrt(count) + 0.003, "way %u: off by %g of %u", way, worst, count);
        CHECK_MSG(distinct > 200, "only %u places", distinct);
    }
    free(seen);
}

/* Scenes in any unit: points of a mesh scaled by a power of two are the points of the mesh, scaled. */
TEST(points_of_any_size) {
    static const int exponent[4] = {-62, -33, 31, 48}; /* squares of areas are out of the range of floats in all of them */
    test_rng r = test_rng_make(44);
    const size_t most = test_quick() ? 2000 : (size_t)ZBUFRANDI_PAGE; /* a whole page is another way */
    float *p[2] = {(float *)malloc(12 * most), (float *)malloc(12 * most)}, *n[2] = {(float *)malloc(12 * most), (float *)malloc(12 * most)};
    uint32_t e, i, a;
    shape s;
    zbufrand_mesh m;
    zbufrand_scene *scene;
    REQUIRE(p[0] != NULL && p[1] != NULL && n[0] != NULL && n[1] != NULL);
    memset(&s, 0, sizeof s);
    for (i = 0; i < 900; i++) (void)shape_vertex(&s, test_rng_double(&r), test_rng_double(&r), test_rng_double(&r));
    for (i = 0; i < 900; i += 3) shape_triangle(&s, i, i + 1, i + 2);
    m = mesh_of(&s);
    scene = sample_scene_of(&m, 0);
    CHECK_EQ_U64(zbufrand_surface_points(scene, NULL, most, p[0], n[0], NULL, NULL), ZBUFRAND_OK);
    zbufrand_scene_destroy(scene);
    for (e = 0; e < 4; e++) {
        const float scale = (float)ldexp(1, exponent[e]);
        const size_t count = e == 2 ? most : 2000;
        size_t wrong = 0, k;
        shape t = s;
        t.p = (float *)malloc(12 * s.vertices);
        REQUIRE(t.p != NULL);
        for (k = 0; k < 3 * s.vertices; k++) t.p[k] = s.p[k] * scale;
        m = mesh_of(&t);
        scene = sample_scene_of(&m, 0);
        CHECK_EQ_U64(zbufrand_surface_points(scene, NULL, count, p[1], n[1], NULL, NULL), ZBUFRAND_OK);
        for (k = 0; k < 3 * count; k++) wrong += p[1][k] != p[0][k] * scale || n[1][k] != n[0][k];
        CHECK_MSG(wrong == 0, "2^%d: %zu of %zu numbers", exponent[e], wrong, 6 * count);
        zbufrand_scene_destroy(scene);
        free(t.p);
    }
    shape_free(&s);
    memset(&s, 0, sizeof s);
    for (i = 0; i < 2; i++) { /* needles: the second is three times as wide */
        (void)shape_vertex(&s, 0, 2.0 * i, 0);
        (void)shape_vertex(&s, 1, 2.0 * i, 0);
        (void)shape_vertex(&s, 0.5, 2.0 * i, i ? 3e-23 : 1e-23);
        shape_triangle(&s, 3 * i, 3 * i + 1, 3 * i + 2);
    }
    m = mesh_of(&s);
    scene = sample_scene_of(&m, 0);
    CHECK_EQ_U64(zbufrand_surface_points(scene, NULL, 2000, p[0], n[0], NULL, NULL), ZBUFRAND_OK);
    for (i = a = 0; i < 2000; i++) {
        a += p[0][3 * i + 1] > 1;
        CHECK(n[0][3 * i] == 0 && n[0][3 * i + 1] == -1 && n[0][3 * i + 2] == 0);
    }
    CHECK_MSG(a > 1490 && a < 1510, "%u of 2000 on the wide one", a);
    zbufrand_scene_destroy(scene);
    shape_free(&s);
    for (i = 0; i < 2; i++) {
        free(p[i]);
        free(n[i]);
    }
}

/* Four levels of references to a triangle of 10^15: areas are beyond floats, which is said. */
TEST(areas_beyond_floats) {
    static const float corner[9] = {0, 0, 0, 9e14f, 0, 0, 0, 9e14f, 0};
    zbufrand_transform t[1000];
    zbufrand_mesh m;
    zbufrand_scene *scene = NULL;
    zbufrand_node node, list;
    float p[3];
    uint32_t i, k;
    memset(t, 0, sizeof t);
    memset(&m, 0, sizeof m);
    for (i = 0; i < 1000; i++) t[i].m[0][0] = t[i].m[1][1] = t[i].m[2][2] = 1;
    m.positions = corner;
    m.vertex_count = 3;
    m.triangle_count = 1;
    CHECK_EQ_U64(zbufrand_scene_create(NULL, &scene), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_add_mesh(scene, 1, NULL, ZBUFRAND_HIDDEN, &m, &node), ZBUFRAND_OK);
    for (k = 0; k < 4; k++) {
        CHECK_EQ_U64(zbufrand_add_list(scene, 1, NULL, k < 3 ? ZBUFRAND_HIDDEN : 0, &list), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_references(scene, list, t, 1000, node, NULL), ZBUFRAND_OK);
        node = list;
    }
    CHECK_EQ_U64(zbufrand_scene_build(scene, NULL, NULL), ZBUFRAND_OK);
    CHECK_EQ_U64(zbufrand_surface_points(scene, NULL, 1, p, NULL, NULL, NULL), ZBUFRAND_ERR_RANGE);
    zbufrand_scene_destroy(scene);
}

/* A triangle twice as far away as floats go: points of it are refused; half as far they are where it is. */
TEST(places_beyond_floats) {
    static const float corner[9] = {0, 0, 0, 1e10f, 0, 0, 0, 1e10f, 0};
    zbufrand_transform t;
    zbufrand_mesh m;
    uint32_t times, i;
    memset(&t, 0, sizeof t);
    memset(&m, 0, sizeof m);
    t.m[0][0] = t.m[1][1] = t.m[2][2] = 1;
    m.positions = corner;
    m.vertex_count = 3;
    m.triangle_count = 1;
    for (times = 1; times <= 2; times++) {
        zbufrand_scene *scene = NULL;
        zbufrand_node node;
        float p[10][3];
        t.m[2][3] = -3.3e38 * times;
        CHECK_EQ_U64(zbufrand_scene_create(NULL, &scene), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_mesh(scene, 1, &t, 0, &m, &node), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_scene_build(scene, NULL, NULL), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_surface_points(scene, NULL, 10, p[0], NULL, NULL, NULL),
                     times == 1 ? ZBUFRAND_OK : ZBUFRAND_ERR_RANGE);
        for (i = 0; i < 10 && times == 1; i++)
            CHECK(p[i][0] >= 0 && p[i][1] >= 0 && p[i][0] <= 1e10f && p[i][1] <= 1e10f && p[i][2] == -3.3e38f);
        zbufrand_scene_destroy(scene);
    }
}

/* Corners that are closer together than floats at the distance of the eye are moved by rounding, so that triangles are larger
   in the picture than all bounds: their areas stay in order, and no more samples are drawn than there is room for. */
TEST(corners_moved_by_rounding) {
    test_rng r = test_rng_make(45);
    const uint32_t seeds = test_quick() ? 15 : 60;
    uint32_t seed, i, level, w = 64;
    uint64_t samples = 0;
    for (level = 0; level < 2; level++) {
        for (seed = 0; seed < seeds; seed++) {
            shape s;
            zbufrand_mesh m;
            zbufrand_scene *scene;
            zbufrand_frame *frame = NULL;
            zbufrand_frame_desc fd;
            zbufrand_render_desc d;
            zbufrand_image image;
            zbufrand_stats stats;
            float depth[64 * 64];
            memset(&s, 0, sizeof s);
            memset(&fd, 0, sizeof fd);
            memset(&d, 0, sizeof d);
            memset(&image, 0, sizeof image);
            for (i = 0; i < 576; i++) { /* most at the origin, the others half a step from it */
                const double c = i < 390 ? 0 : 2.98e-8;
                (void)shape_vertex(&s, c + 3e-9 * test_rng_double(&r), c + 3e-9 * test_rng_double(&r), c + 3e-9 * test_rng_double(&r));
            }
            for (i = 0; i < 192; i++) shape_triangle(&s, 3 * i, 3 * i + 1, 3 * i + 2);
            m = mesh_of(&s);
            m.two_sided = 1;
            scene = sample_scene_of(&m, 0);
            fd.isa = level ? ZBUFRAND_ISA_SCALAR : ZBUFRAND_ISA_AUTO;
            fd.env.thread_count = 1;
            CHECK_EQ_U64(zbufrand_frame_create(&fd, &frame), ZBUFRAND_OK);
            d.camera.eye[0] = 0.6;
            d.camera.eye[1] = 0.5;
            d.camera.eye[2] = 0.7;
            d.camera.fov_y = 0.02;
            d.density = 999999;
            d.seed = seed;
            d.hybrid = ZBUFRAND_HYBRID_OFF;
            d.no_repair = 1;
            d.costs.cluster = 1e-3f; /* drawn from the cluster whatever stored points cost */
            image.width = image.height = w;
            image.depth = depth;
            CHECK_EQ_U64(zbufrand_render(frame, &d, scene, &image, &stats), ZBUFRAND_OK);
            samples += stats.samples[1];
            zbufrand_frame_destroy(frame);
            zbufrand_scene_destroy(scene);
            shape_free(&s);
        }
    }
    CHECK_MSG(samples > 50, "only %llu samples", (unsigned long long)samples);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(planes);
    RUN(wide_angle);
    RUN(at_least_without_thinning);
    RUN(independent_samples);
    RUN(from_behind);
    RUN(areas_of_triangles);
    RUN(facing_away);
    RUN(instances_and_copies);
    RUN(pixels_hit);
    RUN(pixels_of_triangles_hit);
    RUN(four_levels);
    RUN(points_for_directions);
    RUN(twelve_decades_in_a_cluster);
    RUN(combs_of_clusters);
    RUN(uniform_on_a_triangle);
    RUN(points_of_a_mesh);
    RUN(short_prefixes_are_even);
    RUN(a_hundred_million_points_are_independent);
    RUN(points_of_instances);
    RUN(points_of_powers_of_two);
    RUN(attributes_of_surface_points);
    RUN(fine_places);
    RUN(points_of_any_size);
    RUN(areas_beyond_floats);
    RUN(places_beyond_floats);
    RUN(corners_moved_by_rounding);
    return test_end();
}
