/* Light on bit columns against paths through triangles and closed forms; ways of rays that are there to be compared with;
   flicker; scales. */
#include "test.h"
#include "../examples/support/mesh.h"
#include "../examples/support/scenes.h"
#define VOXRT_IMPLEMENTATION
#include "../voxrt.h"
#include "../bench/baseline/columns.h"
#include "gi_models.h"
#include "path_oracle.h"

enum { POINTS = 48 };

typedef struct picture {
    float position[POINTS][3], normal[POINTS][3], albedo[POINTS][3], direct[POINTS][3], indirect[POINTS][3];
    voxrt_gbuffer g;
} picture;

static void add_model(voxrt_gi *gi, const model *m) {
    const voxrt_gi_object o = object_of(m, 1);
    if (voxrt_gi_add(gi, &o, NULL) != VOXRT_OK) abort();
}

static void set_lamp(voxrt_gi *gi, const double at[3], double intensity) {
    voxrt_gi_light l;
    uint32_t a;
    memset(&l, 0, sizeof l);
    for (a = 0; a < 3; a++) {
        l.position[a] = (float)at[a];
        l.color[a] = (float)intensity;
    }
    CHECK(voxrt_gi_set_lights(gi, &l, 1) == VOXRT_OK);
    CHECK(voxrt_gi_update(gi, NULL) == VOXRT_OK);
}

static void open_picture(picture *p) {
    memset(p, 0, sizeof *p);
    p->g = gbuffer_of(POINTS / 4, 4, p->position, p->normal, p->albedo);
}

/* Both scenes get each triangle. */
static void both_quad(model *m, path_scene *s, const double *a, const double *b, const double *c, const double *d, uint8_t grey) {
    quad(m, a, b, c, d, grey);
    path_add(s, a, b, c, voxrti_srgb_to_linear(grey / 255.0), 0);
    path_add(s, a, c, d, voxrti_srgb_to_linear(grey / 255.0), 0);
}

/* A box; inside: its faces look inwards. */
static void both_box(model *m, path_scene *s, const double lo[3], const double hi[3], int inside, uint8_t grey) {
    uint32_t k, side, i;
    for (k = 0; k < 3; k++)
        for (side = 0; side < 2; side++) {
            double p[4][3];
            const int turned = (int)side ^ inside;
            for (i = 0; i < 4; i++) {
                p[i][k] = side ? hi[k] : lo[k];
                p[i][(k + 1) % 3] = (i + 1) % 4 < 2 ? lo[(k + 1) % 3] : hi[(k + 1) % 3];
                p[i][(k + 2) % 3] = i < 2 ? lo[(k + 2) % 3] : hi[(k + 2) % 3];
            }
            both_quad(m, s, p[0], p[turned ? 1 : 3], p[2], p[turned ? 3 : 1], (uint8_t)(grey - 20 * k));
        }
}

TEST(paths_through_triangles_are_right) { /* closed forms */
    static path_scene s;
    static model m;
    const double lo[3] = {-1, -2, -3}, hi[3] = {1, 2, 3}, p[3] = {0.2, -2, 0.7}, up[3] = {0, 1, 0};
    double q, want, error, is;
    int i;
    memset(&s, 0, sizeof s);
    s.state = 1;
    both_box(&m, &s, lo, hi, 1, 188);
    CHECK(s.count == 12);
    q = 0.5;
    for (i = 0; i < s.count; i++) {
        s.albedo[i] = q;
        s.emission[i] = 1;
    }
    for (i = 1; i < 6; i++) { /* a furnace: no noise */
        want = (1 - pow(q, i)) / (1 - q);
        is = path_indirect(&s, p, up, i, 200, &error);
        CHECK_MSG(fabs(is - want) < 1e-9 && error < 1e-6, "%d bounces: %g, not %g", i, is, want);
    }
    for (i = 0; i < s.count; i++) s.emission[i] = fabs(s.n[i][1]) > 0.5 ? 1 : 0; /* floor and ceiling: form factor */
    is = path_indirect(&s, p, up, 1, 200000, &error);
    { /* of a rectangle above a point: four corners */
        const double h = 4, x[2] = {1 - 0.2, 1 + 0.2}, z[2] = {3 - 0.7, 3 + 0.7};
        want = 0;
        for (i = 0; i < 4; i++) {
            const double a = x[i & 1] / h, b = z[i >> 1] / h, ra = sqrt(1 + a * a), rb = sqrt(1 + b * b);
            want += (a / ra * atan(b / ra) + b / rb * atan(a / rb)) / 6.283185307179586;
        }
    }
    CHECK_MSG(fabs(is - want) < 4 * error, "form factor %g, not %g +- %g", is, want, error);
    s.intensity = 8;
    s.lamp[1] = 1;
    for (i = 0; i < s.count; i++) s.emission[i] = 0;
    {
        const double below[3] = {0, -2, 0};
        CHECK(fabs(path_direct(&s, below, up) - 8.0 / 9.0) < 1e-12); /* i / r^2 */
    }
}

/* A room with two boxes and a lamp: irradiance at points of floor, walls and boxes, one and two bounces, by both methods.
   The paths' own noise is allowed for with four standard deviations. */
TEST(a_room_as_paths_through_its_triangles_have_it) {
    static path_scene s;
    static model m;
    static picture pic;
    const double lo[3] = {-9, -9, -9}, hi[3] = {9, 9, 9}, none[3] = {0, 0, 0};
    const double lo1[3] = {-6.2, -9, -5.1}, hi1[3] = {-1.3, -1.1, -0.4}, lo2[3] = {1.7, -9, 0.3}, hi2[3] = {6.1, -4.875, 5.2};
    voxrt_gi *gi = make_gi_at(128, 128, 128, 9.6, none);
    voxrt_gi_render_desc d;
    uint32_t i, a, bounces;
    memset(&s, 0, sizeof s);
    memset(&d, 0, sizeof d);
    s.state = 7;
    rng_state = 3;
    both_box(&m, &s, lo, hi, 1, 225);
    both_box(&m, &s, lo1, hi1, 0, 200);
    both_box(&m, &s, lo2, hi2, 0, 230);
    s.lamp[0] = 2.0;
    s.lamp[1] = 6.0;
    s.lamp[2] = 1.0;
    s.intensity = 100;
    add_model(gi, &m);
    set_lamp(gi, s.lamp, s.intensity);
    open_picture(&pic);
    for (i = 0; i < POINTS; i++) { /* not nearer than four cells to an edge */
        const double u = 2 * rnd() - 1, v = 2 * rnd() - 1;
        double p[3] = {u * 8.4, -9, 7.2 + 1.2 * v}, n[3] = {0, 1, 0};
        if (i % 4 == 1) { p[0] = -9; p[1] = u * 8.4; p[2] = v * 8.4; n[1] = 0; n[0] = 1; }
        if (i % 4 == 2) { p[0] = u * 8.4; p[1] = v * 8.4; p[2] = -9; n[1] = 0; n[2] = 1; }
        if (i % 4 == 3) { p[0] = 3.9 + 1.6 * u; p[1] = -4.875; p[2] = 2.7 + 1.8 * v; }
        for (a = 0; a < 3; a++) {
            pic.position[i][a] = (float)p[a];
            pic.normal[i][a] = (float)n[a];
            pic.albedo[i][a] = 1.0f;
        }
    }
    d.rays = test_quick() ? 256 : 1024;
    for (bounces = 1; bounces <= 2; bounces++) {
        double want[POINTS], error[POINTS], mean = 0;
        uint32_t way;
        for (i = 0; i < POINTS; i++) {
            double p[3], n[3];
            for (a = 0; a < 3; a++) {
                p[a] = (double)pic.position[i][a];
                n[a] = (double)pic.normal[i][a];
            }
            want[i] = path_indirect(&s, p, n, (int)bounces, test_quick() ? 400 : 4000, &error[i]);
            mean += want[i] / POINTS;
        }
        for (way = 0; way < 2; way++) {
            double sum = 0, sum_direct = 0, want_direct = 0;
            if (way == 0 && bounces == 2) CHECK(voxrt_gi_bounce(gi, NULL, 16, 0.0f, 5) == VOXRT_OK);
            d.method = way == 0 ? VOXRT_GI_GATHER : VOXRT_GI_PATH;
            d.bounces = bounces;
            CHECK(voxrt_gi_render(&d, gi, &pic.g, pic.direct[0], pic.indirect[0], NULL) == VOXRT_OK);
            for (i = 0; i < POINTS; i++) {
                const double p[3] = {(double)pic.position[i][0], (double)pic.position[i][1], (double)pic.position[i][2]};
                const double n[3] = {(double)pic.normal[i][0], (double)pic.normal[i][1], (double)pic.normal[i][2]};
                const double is = (double)pic.indirect[i][0];
                sum += is / POINTS;
                sum_direct += (double)pic.direct[i][0];
                want_direct += path_direct(&s, p, n) * 0.3183098861837907;
                CHECK_MSG(fabs(is - want[i]) < 0.12 * mean + 4 * error[i] + (d.rays < 1000 ? 0.1 * mean : 0),
                          "way %u, %u bounces, point %u: %g, not %g +- %g (mean %g)", way, bounces, i, is, want[i], error[i], mean);
            }
            CHECK_MSG(fabs(sum / mean - 1) < 0.025, "way %u, %u bounces: mean %g, not %g", way, bounces, sum, mean);
            CHECK_MSG(fabs(sum_direct / want_direct - 1) < 0.01, "direct light %g, not %g", sum_direct, want_direct);
        }
        { /* 65536 virtual lights, 256 for each point: what paths have */
            double by_paths = 0, by_lights = 0;
            for (i = 0; i < POINTS; i++) by_paths += (double)pic.indirect[i][0] / POINTS;
            d.method = VOXRT_GI_VPL;
            d.pattern = 16;
            i = d.rays;
            d.rays = 256;
            CHECK(voxrt_gi_render(&d, gi, &pic.g, NULL, pic.indirect[0], NULL) == VOXRT_OK);
            d.rays = i;
            CHECK(voxrt_gi_virtual_lights(gi, NULL, 0) == 65536u * bounces);
            for (i = 0; i < POINTS; i++) by_lights += (double)pic.indirect[i][0] / POINTS;
            CHECK_MSG(fabs(by_lights / by_paths - 1) < 0.02, "virtual lights, %u bounces: mean %g, by paths %g", bounces, by_lights, by_paths);
        }
        { /* the thesis' gathering and paths, which offsets and lost rays make darker or lighter */
            baseline_light_desc b;
            double sum = 0;
            memset(&b, 0, sizeof b);
            b.way = BASELINE_EPSILON;
            b.rays = d.rays / 2;
            b.bounces = bounces;
            b.radius = 100.0f;
            b.s_n = 1.0f;
            pic.g.albedo = NULL;
            baseline_light(gi, &b, &pic.g, pic.indirect[0]);
            pic.g.albedo = pic.albedo[0];
            for (i = 0; i < POINTS; i++) sum += (double)pic.indirect[i][0] / POINTS;
            CHECK_MSG(fabs(sum / mean - 1) < 0.1, "the thesis' way, %u bounces: mean %g, not %g", bounces, sum, mean);
        }
    }
    voxrt_gi_destroy(gi);
}

/* A closed sphere with a lamp in its middle: k bounces bring i / r^2 (q + ... + q^k), on the default grid to 1 %. */
TEST(closed_sphere_to_a_percent) {
    static model m;
    static picture pic;
    const double none[3] = {0, 0, 0}, r = 9;
    const double q = voxrti_srgb_to_linear(188 / 255.0);
    voxrt_gi *gi = make_gi_at(256, 256, 128, 10, none);
    voxrt_gi_render_desc d;
    uint32_t i, a, bounces;
    rng_state = 13;
    sphere(&m, r, 80, 188, 1);
    add_model(gi, &m);
    set_lamp(gi, none, r * r);
    open_picture(&pic);
    memset(&d, 0, sizeof d);
    for (i = 0; i < POINTS; i++) {
        double v[3], l = 0;
        for (a = 0; a < 3; a++) {
            v[a] = 2 * rnd() - 1;
            l += v[a] * v[a];
        }
        for (a = 0; a < 3; a++) {
            pic.normal[i][a] = (float)(-v[a] / sqrt(l));
            pic.position[i][a] = (float)(v[a] / sqrt(l) * r);
            pic.albedo[i][a] = 1.0f;
        }
    }
    d.rays = test_quick() ? 128 : 512;
    for (bounces = 1; bounces <= 3; bounces++) {
        const double want = q * (1 - pow(q, bounces)) / (1 - q);
        double sum = 0;
        d.method = bounces == 1 ? VOXRT_GI_GATHER : VOXRT_GI_PATH;
        d.bounces = bounces;
        CHECK(voxrt_gi_render(&d, gi, &pic.g, NULL, pic.indirect[0], NULL) == VOXRT_OK);
        for (i = 0; i < POINTS; i++) sum += 3.14159265358979 * (double)pic.indirect[i][0] / POINTS;
        CHECK_MSG(fabs(sum / want - 1) < 0.01, "%u bounces: %.5f, not %.5f", bounces, sum, want);
    }
    voxrt_gi_destroy(gi);
}

/* Light that left a closed sphere's wall once is the same everywhere, wherever the lamp is. Beside the wall it comes from few cells, which
   few of the rays over a hemisphere meet: pixels by 64 rays were dots. */
TEST(lamps_beside_walls_make_no_dots) {
    static model m;
    static picture pic;
    const double none[3] = {0, 0, 0}, r = 9, q = voxrti_srgb_to_linear(188 / 255.0);
    const double h = 20.0 / 128.0; /* a cell */
    const double depth[5] = {2.5, 1.5, 1.0, 0.5, 0.3}; /* of the lamp, in cells */
    /* so near a cell's light is less than at its middle, and maps lose what they see on the slant */
    const double least[4][5] = {{0.95, 0.95, 0.95, 0.8, 0.67}, {0.95, 0.95, 0.95, 0.8, 0.67}, {0.97, 0.97, 0.97, 0.95, 0.95},
                                {0.8, 0.77, 0.7, 0.68, 0.7}};
    voxrt_gi *gi = make_gi_at(128, 128, 128, 10, none);
    uint32_t i, a, k;
    rng_state = 31;
    sphere(&m, r, 80, 188, 1);
    add_model(gi, &m);
    open_picture(&pic);
    for (i = 0; i < POINTS; i++) {
        double v[3], l = 0;
        for (a = 0; a < 3; a++) {
            v[a] = 2 * rnd() - 1;
            l += v[a] * v[a];
        }
        if (v[0] > 0.5 * sqrt(l)) v[0] = -v[0]; /* not where the lamp is */
        for (a = 0; a < 3; a++) {
            pic.normal[i][a] = (float)(-v[a] / sqrt(l));
            pic.position[i][a] = (float)(v[a] / sqrt(l) * r);
            pic.albedo[i][a] = 1.0f;
        }
    }
    for (k = 0; k < 20; k++) { /* by gathering and paths, virtual lights, and with maps of what the lamp sees */
        const double lamp[3] = {r - depth[k % 5] * h, 0, 0};
        double sum = 0, square = 0;
        voxrt_gi_render_desc d;
        set_lamp(gi, lamp, r * r);
        memset(&d, 0, sizeof d);
        d.rays = 64;
        d.method = k / 5 == 1 ? VOXRT_GI_PATH : k / 5 == 2 ? VOXRT_GI_VPL : VOXRT_GI_GATHER;
        d.lookup = k / 5 == 3 ? VOXRT_GI_LOOKUP_MAPS : VOXRT_GI_LOOKUP_CACHE;
        if (k / 5 == 2) d.rays = 1024;
        CHECK(voxrt_gi_render(&d, gi, &pic.g, NULL, pic.indirect[0], NULL) == VOXRT_OK);
        for (i = 0; i < POINTS; i++) {
            const double e = 3.14159265358979 * (double)pic.indirect[i][0] / q;
            sum += e / POINTS;
            square += e * e / POINTS;
        }
        CHECK_MSG(sum > least[k / 5][k % 5] && sum < 1.03 && sqrt(square - sum * sum) < 0.3, "way %u, %.1f cells: %.3f +- %.3f", k / 5,
                  depth[k % 5], sum, sqrt(square - sum * sum));
    }
    voxrt_gi_destroy(gi);
}

/* ---- ways of rays ---- */

static voxrt_columns *light_hall(uint32_t n, uint32_t depth) {
    voxrt_columns_desc d;
    voxrt_columns *c = NULL;
    voxrti_insert in;
    uint32_t x, y, z;
    memset(&d, 0, sizeof d);
    memset(&in, 0, sizeof in);
    d.size_x = d.size_y = n;
    d.size_z = depth;
    d.depth_axis_plus_1 = 3;
    d.box_max[0] = d.box_max[1] = n;
    d.box_max[2] = depth;
    if (voxrt_columns_create(&d, &c) != VOXRT_OK) abort();
    in.columns = c;
    for (y = 0; y < n; y++)
        for (x = 0; x < n; x++) {
            if (x == 0 || y == 0 || x + 1 == n || y + 1 == n) voxrti_insert_run(&in, x, y, 0, depth - 1);
            if (x % 16 < 3 && y % 16 < 3) voxrti_insert_run(&in, x, y, 0, depth - 9);
            voxrti_insert_run(&in, x, y, 1, 1);
            for (z = 0; z < depth; z++) if (rnd() < 0.0005) voxrti_insert_run(&in, x, y, z, z);
        }
    voxrt_columns_update(c);
    return c;
}

/* What is measured against must be what it says: the library's ray and the scalar walk agree, double stepping but for
   ties; marching comes nearer with more points; the thesis' stepping loses some. */
TEST(ways_of_rays) {
    enum { N = 4000 };
    voxrt_columns *c;
    voxrt_columns_trace_desc d;
    voxrt_stats st;
    uint32_t i, a, wrong_ours = 0, wrong_eps = 0, wrong_march[3] = {0, 0, 0}, hits = 0;
    uint64_t longest = 0;
    rng_state = 5;
    c = light_hall(128, 64);
    for (i = 0; i < N; i++) {
        static const uint32_t points[3] = {60, 600, 6000};
        voxrt_ray ray;
        voxrt_column_hit hit;
        voxrti_column_ray r;
        voxrti_column_found f, e;
        int is, k;
        memset(&ray, 0, sizeof ray);
        memset(&f, 0, sizeof f);
        for (a = 0; a < 3; a++) {
            ray.org[a] = (float)(4 + rnd() * (a < 2 ? 120 : 50));
            ray.dir[a] = (float)(2 * rnd() - 1);
        }
        ray.t_max = INFINITY;
        memset(&d, 0, sizeof d);
        memset(&st, 0, sizeof st);
        d.stats = &st;
        CHECK(voxrt_columns_trace(c, &d, &ray, &hit, 1) == VOXRT_OK);
        longest = st.steps > longest ? st.steps : longest;
        REQUIRE(voxrti_column_ray_open(c, &ray, &r) == 1);
        is = baseline_ray(c, &r, BASELINE_OURS, 0, &f);
        if (is != (hit.t < INFINITY) || (is && ((uint32_t)f.x != hit.cell[0] || (uint32_t)f.y != hit.cell[1] ||
                                                (uint32_t)f.k != hit.cell[2]))) CHECK_MSG(0, "ray %u", i);
        is = baseline_ray(c, &r, BASELINE_EXACT, 0, &e);
        hits += (uint32_t)is;
        if (is != (hit.t < INFINITY) || (is && ((uint32_t)e.x != hit.cell[0] || (uint32_t)e.y != hit.cell[1] ||
                                                (uint32_t)e.k != hit.cell[2]))) wrong_ours++;
        for (k = 0; k < 4; k++) {
            const int s = k < 3 ? baseline_ray(c, &r, BASELINE_MARCH, points[k], &f) : baseline_ray(c, &r, BASELINE_EPSILON, 0, &f);
            const uint32_t bad = s != is || (is && (f.x != e.x || f.y != e.y || f.k != e.k));
            if (k < 3) wrong_march[k] += bad;
            else wrong_eps += bad;
        }
    }
    CHECK(hits == N || hits > N / 2);
    CHECK_MSG(wrong_ours <= N / 2000, "%u rays are not as in double precision", wrong_ours);
    CHECK_MSG(longest <= 3 * (128 + 128) + 8, "%lu steps", (unsigned long)longest);
    CHECK_MSG(wrong_march[0] > wrong_march[1] && wrong_march[1] > wrong_march[2] && wrong_march[2] < N / 100,
              "marching: %u, %u, %u wrong", wrong_march[0], wrong_march[1], wrong_march[2]);
    CHECK_MSG(wrong_eps > 0 && wrong_eps < N / 5, "epsilon stepping: %u wrong", wrong_eps);
    voxrt_columns_destroy(c);
}

/* The thesis' offsets let a kerb of 2.7 cells float above nothing: rays that leave at a low angle start behind it. */
TEST(offsets_lose_what_planes_keep) {
    voxrt_columns_desc cd;
    voxrt_columns *c = NULL;
    voxrti_insert in;
    const double a = 1.7, h = 2.7, exact = 0.5 * (1 - a / sqrt(a * a + h * h)), diagonal = sqrt(3.0);
    const uint32_t many = test_quick() ? 4000 : 40000;
    uint32_t x, y, i, k, hits[2] = {0, 0};
    const float up[3] = {0, 0, 1};
    memset(&cd, 0, sizeof cd);
    cd.size_x = cd.size_y = cd.size_z = 128;
    cd.depth_axis_plus_1 = 3;
    cd.box_max[0] = cd.box_max[1] = cd.box_max[2] = 128;
    REQUIRE(voxrt_columns_create(&cd, &c) == VOXRT_OK);
    memset(&in, 0, sizeof in);
    in.columns = c;
    for (y = 0; y < 128; y++)
        for (x = 0; x < 128; x++) {
            voxrti_insert_run(&in, x, y, 20, 20);
            if (x >= 24 && x <= 30) voxrti_insert_run(&in, x, y, 20, 22);
        }
    voxrt_columns_update(c);
    rng_state = 6;
    for (i = 0; i < many; i++) {
        voxrt_ray r;
        voxrt_columns_trace_desc d;
        float u[2], cosine;
        uint8_t dark;
        memset(&r, 0, sizeof r);
        memset(&d, 0, sizeof d);
        u[0] = (float)rnd() * 0.999999f;
        u[1] = (float)rnd() * 0.999999f;
        cosine = voxrti_lobe_direction(up, u, 1.0f, r.dir);
        for (k = 0; k < 2; k++) {
            const double off = k == 0 ? 0 : 1.2 * diagonal / (double)cosine;
            r.org[0] = (float)(31 + a + off * (double)r.dir[0]);
            r.org[1] = (float)(64.5 + off * (double)r.dir[1]);
            r.org[2] = (float)(20.3 + (k == 0 ? 0 : diagonal) + off * (double)r.dir[2]);
            r.t_max = (float)(40 - off);
            d.normals = k == 0 ? up : NULL;
            if (!(r.t_max > 0)) continue;
            CHECK(voxrt_columns_occluded(c, &d, &r, &dark, 1) == VOXRT_OK);
            hits[k] += dark;
        }
    }
    CHECK_MSG(fabs((double)hits[0] / many - exact) < 0.01 + 4 * sqrt(0.25 / many), "%.4f, not %.4f", (double)hits[0] / many, exact);
    CHECK_MSG((double)hits[1] / many < 0.02, "with offsets %.4f", (double)hits[1] / many);
    voxrt_columns_destroy(c);
}

/* Points: cells by the same sums in plain C; any stride, length and place in memory. */
TEST(points_go_where_sums_say) {
    enum { N = 3000 };
    static float p[N][5];
    static const uint32_t strides[2] = {12, 20};
    uint32_t round, i, k;
    rng_state = 9;
    for (round = 0; round < 8; round++) {
        voxrt_columns *c = light_hall(64, 64), *want = light_hall(64, 64);
        voxrt_columns_insert_desc d;
        voxrt_columns_insert_stats st;
        uint64_t rejected = 0, outside = 0;
        const uint32_t stride = strides[round & 1], n = N - round;
        double m[12] = {0.9, 0.3, -0.1, 3, -0.2, 1.1, 0.2, 5, 0.05, -0.1, 0.8, 2};
        voxrt_columns_clear(c, 1);
        voxrt_columns_clear(want, 1);
        memset(&d, 0, sizeof d);
        memset(&st, 0, sizeof st);
        memcpy(d.to_world, m, sizeof m);
        d.still = round >= 4;
        for (i = 0; i < n; i++) {
            float *q = (float *)(void *)((char *)p + (size_t)i * stride);
            double at[3];
            int bad = 0;
            for (k = 0; k < 3; k++) q[k] = (float)(rnd() * 70 - 3);
            if (i % 101 == 5) q[i % 3] = NAN;
            if (i % 103 == 5) q[i % 3] = INFINITY;
            for (k = 0; k < 3; k++) {
                const double *row = m + 4 * c->axis[k];
                at[k] = row[0] * (double)q[0] + row[1] * (double)q[1] + row[2] * (double)q[2] + row[3];
                bad |= !(at[k] > -1e15 && at[k] < 1e15);
            }
            if (bad) rejected++;
            else if (at[0] < 0 || at[1] < 0 || at[2] < 0 || at[0] >= 64 || at[1] >= 64 || at[2] >= 64) outside++;
            else want->bits[voxrti_column(want, 0, (uint32_t)at[0], (uint32_t)at[1]) + ((uint32_t)at[2] >> 5)] |=
                1u << ((uint32_t)at[2] & 31u);
        }
        CHECK(voxrt_columns_insert_points(c, &d, p[0], stride, n, &st) == VOXRT_OK);
        CHECK(st.items == n && st.rejected == rejected && st.outside == outside);
        CHECK(memcmp(c->bits, want->bits, (size_t)64 * 64 * 8) == 0);
        want->all_changed = 1;
        voxrt_columns_update(want);
        voxrt_columns_update(c); /* what changed only */
        CHECK(memcmp(c->bits, want->bits, ((size_t)c->start[c->levels - 1] + c->words) * 4) == 0);
        CHECK(voxrt_columns_insert_points(c, &d, p[0], stride, n, NULL) == VOXRT_OK); /* again: nothing new */
        CHECK(memcmp(c->bits, want->bits, (size_t)64 * 64 * 8) == 0);
        voxrt_columns_clear(c, 0);
        for (i = 0; i < 64 * 64 * 2; i++) if (c->bits[i] != (d.still ? want->bits[i] : 0)) break;
        CHECK(i == 64 * 64 * 2);
        voxrt_columns_destroy(c);
        voxrt_columns_destroy(want);
    }
}

/* ---- time and scale ---- */

/* The lamp moves: the second difference in time of each pixel, against that of many rays. The same rays in every frame:
   their noise stays where it is. */
TEST(no_flicker_under_a_moving_lamp) {
    enum { W = 48, H = 36 };
    const uint32_t frames = test_quick() ? 6 : 120;
    static path_scene s;
    static model m;
    static float position[W * H][3], normal[W * H][3], albedo[W * H][3], last[2][3][W * H][3];
    const double lo[3] = {-9, -9, -9}, hi[3] = {9, 9, 9}, none[3] = {0, 0, 0}, lo1[3] = {-3, -9, -3}, hi1[3] = {2, -4, 2};
    voxrt_gi *gi = make_gi_at(64, 64, 64, 9.6, none);
    voxrt_camera camera;
    voxrt_gbuffer g;
    double sum[2] = {0, 0};
    uint32_t frame, way, i;
    memset(&s, 0, sizeof s);
    memset(&camera, 0, sizeof camera);
    both_box(&m, &s, lo, hi, 1, 225);
    both_box(&m, &s, lo1, hi1, 0, 200);
    add_model(gi, &m);
    camera.eye[2] = 8.0f;
    camera.at[1] = -2.0f;
    camera.up[1] = 1.0f;
    camera.fov_y = 60.0f;
    g = gbuffer_of(W, H, position, normal, albedo);
    for (frame = 0; frame < frames; frame++) { /* to and fro */
        const double at[3] = {test_quick() ? -4 + 0.3 * frame : -4 * cos(0.075 * frame), 5, 1};
        set_lamp(gi, at, 100);
        if (frame == 0) CHECK(voxrt_gbuffer_from_gi(NULL, &camera, gi, &g) == VOXRT_OK);
        for (way = 0; way < 2; way++) {
            voxrt_gi_render_desc d;
            memset(&d, 0, sizeof d);
            d.rays = way == 0 ? 128 : 16;
            d.filter = way == 0 ? 0 : 3;
            memmove(last[way][0], last[way][1], 2 * sizeof last[0][0]);
            CHECK(voxrt_gi_render(&d, gi, &g, NULL, last[way][2][0], NULL) == VOXRT_OK);
            for (i = 0; i < W * H && frame >= 2; i++)
                sum[way] += fabs((double)last[way][2][i][0] - 2 * (double)last[way][1][i][0] + (double)last[way][0][i][0]);
        }
    }
    CHECK(sum[0] > 0);
    CHECK_MSG(sum[1] < 1.3 * sum[0], "flicker %.5f, of many rays %.5f", sum[1], sum[0]);
    voxrt_gi_destroy(gi);
}

/* The same room small, large, and far away: the same light, but for rounding. */
TEST(scale_and_place_do_not_matter) {
    static path_scene s;
    static model m, n;
    static picture pic;
    static const double scale[4] = {1, 1.0 / 8192, 8192, 1}, shift[4] = {0, 0, 0, 4096};
    static float first[POINTS][3];
    const double lo[3] = {-9, -9, -9}, hi[3] = {9, 9, 9}, lo1[3] = {-3, -9, -3}, hi1[3] = {2, -4, 2};
    uint32_t k, i, a;
    memset(&s, 0, sizeof s);
    both_box(&m, &s, lo, hi, 1, 225);
    both_box(&m, &s, lo1, hi1, 0, 200);
    for (k = 0; k < 4; k++) {
        const double middle[3] = {shift[k], -shift[k], shift[k]}, lamp[3] = {middle[0] + 2 * scale[k], middle[1] + 5 * scale[k], middle[2]};
        voxrt_gi *gi = make_gi_at(64, 64, 64, 10 * scale[k], middle);
        voxrt_gi_render_desc d;
        double worst = 0, mean = 0;
        memset(&d, 0, sizeof d);
        n = m;
        for (i = 0; i < n.points; i++) for (a = 0; a < 3; a++) n.p[i][a] = (float)((double)m.p[i][a] * scale[k] + middle[a]);
        add_model(gi, &n);
        set_lamp(gi, lamp, 100 * scale[k] * scale[k]);
        open_picture(&pic);
        rng_state = 16;
        for (i = 0; i < POINTS; i++) {
            const double x = -8.5 + 17 * rnd(), z = 3 + 5 * rnd();
            pic.position[i][0] = (float)(x * scale[k] + middle[0]);
            pic.position[i][1] = (float)(-9 * scale[k] + middle[1]);
            pic.position[i][2] = (float)(z * scale[k] + middle[2]);
            pic.normal[i][1] = 1.0f;
            pic.albedo[i][0] = pic.albedo[i][1] = pic.albedo[i][2] = 1.0f;
        }
        d.rays = 64;
        CHECK(voxrt_gi_render(&d, gi, &pic.g, NULL, pic.indirect[0], NULL) == VOXRT_OK);
        if (k == 0) memcpy(first, pic.indirect, sizeof first);
        for (i = 0; i < POINTS; i++) {
            mean += (double)first[i][0] / POINTS;
            worst = fmax(worst, fabs((double)pic.indirect[i][0] - (double)first[i][0]));
        }
        /* powers of two: the same numbers; far away floats have 1/2048 of a unit left */
        CHECK_MSG(worst <= (k < 3 ? 1e-3 : 0.06) * mean, "scale %g, shift %g: %g of %g", scale[k], shift[k], worst, mean);
        voxrt_gi_destroy(gi);
    }
}

/* ---- hard scenes against paths through their triangles ---- */

static double mean_of(const float (*v)[3], uint32_t n) {
    double sum = 0;
    uint32_t i;
    for (i = 0; i < n; i++) sum += (double)v[i][0] / n;
    return sum;
}

/* Points on the floor of a room of +-9 that has something in it; the lamp; mean of one bounce, by rays on a grid, and by
   paths. */
static void compare_room(model *m, model *more, voxrt_columns_mode mode, path_scene *s, const double lamp[3], const double at[3],
                         const double wide[2], uint32_t nx, uint32_t nz, double *is, double *want, double *error) {
    static picture pic;
    const double none[3] = {0, 0, 0};
    voxrt_gi *gi = make_gi_at(nx, nx, nz, 9.6, none);
    voxrt_gi_render_desc d;
    uint32_t i, a;
    memset(&d, 0, sizeof d);
    s->state = 7;
    s->intensity = 100;
    memcpy(s->lamp, lamp, sizeof s->lamp);
    if (more != NULL) {
        voxrt_gi_object o = object_of(more, 1);
        o.mode = mode;
        CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_OK);
    }
    add_model(gi, m);
    set_lamp(gi, lamp, s->intensity);
    open_picture(&pic);
    rng_state = 5;
    for (i = 0; i < POINTS; i++) {
        pic.position[i][0] = (float)(at[0] + wide[0] * (2 * rnd() - 1));
        pic.position[i][1] = (float)at[1];
        pic.position[i][2] = (float)(at[2] + wide[1] * (2 * rnd() - 1));
        pic.normal[i][1] = 1;
        for (a = 0; a < 3; a++) pic.albedo[i][a] = 1;
    }
    d.rays = test_quick() ? 256 : 512;
    CHECK(voxrt_gi_render(&d, gi, &pic.g, NULL, pic.indirect[0], NULL) == VOXRT_OK);
    *is = mean_of((const float (*)[3])pic.indirect, POINTS);
    *want = *error = 0;
    for (i = 0; i < POINTS; i++) {
        double p[3], n[3] = {0, 1, 0}, e;
        for (a = 0; a < 3; a++) p[a] = (double)pic.position[i][a];
        *want += path_indirect(s, p, n, 1, test_quick() ? 150 : 500, &e) / POINTS;
        *error += e * e / (POINTS * POINTS);
    }
    *error = sqrt(*error);
    voxrt_gi_destroy(gi);
}

/* Bars make it darker under them: as bodies by as much as they should, whether they are eight cells wide or four. By their
   surface they are a cell wider, and it is as dark as under bars that are that wide. Those of two thirds of a cell are in
   cells that know all their faces. */
TEST(under_a_lattice) {
    static const double thick[3] = {0.6, 0.3, 0.05}, apart[3] = {5.0, 2.5, 2.5};
    uint32_t k, i, axis, way;
    for (k = 0; k < 3; k++)
        for (way = 0; way < 3; way++) { /* surface, surface against wider bars, bodies */
            static path_scene s;
            static model room, bars;
            const double lo[3] = {-9, -9, -9}, hi[3] = {9, 9, 9}, lamp[3] = {1, 7, 0.5}, at[3] = {0, -9, 0}, wide[2] = {5, 5};
            const double more = way == 1 ? 0.075 : 0.0, most = k == 2 ? 0.08 : way == 0 ? (k == 0 ? 0.12 : 0.16) : 0.06;
            double is, want, error;
            if (way == 1 && k == 2) continue;
            memset(&s, 0, sizeof s);
            room.points = room.triangles = bars.points = bars.triangles = 0;
            both_box(&room, &s, lo, hi, 1, 225);
            for (axis = 0; axis < 3; axis += 2)
                for (i = 0; i < (k == 0 ? 4 : 7); i++) {
                    static model none;
                    static path_scene other;
                    const double c = -8.1 + apart[k] * i + 0.037 * i;
                    double a[3] = {-9, -5.0, -9}, b[3] = {9, -5.0, 9};
                    if (axis == 2) a[1] = b[1] = -3.6;
                    a[axis] = c;
                    b[axis] = c + thick[k] * 2;
                    a[1] -= thick[k];
                    b[1] += thick[k];
                    other.count = 0;
                    none.points = none.triangles = 0;
                    both_box(&bars, &other, a, b, 0, 200);
                    a[axis] -= more;
                    b[axis] += more;
                    a[1] -= more;
                    b[1] += more;
                    both_box(&none, &s, a, b, 0, 200);
                }
            compare_room(&room, &bars, way == 2 ? VOXRT_COLUMNS_BODY : VOXRT_COLUMNS_THIN, &s, lamp, at, wide, 128, 128, &is, &want, &error);
            CHECK_MSG(fabs(is / want - 1) < most + 4 * error / want, "way %u, bars of %.1f cells: %.4f of %.4f +- %.4f", way,
                      thick[k] * 2 / 0.15, is, want, error);
        }
}

/* A slab as wide as a table, on the floor, half a cell above it, and 1.5 cells: in its shadow, up to where it begins and
   beneath it, there is as much light as by paths. Rays that begin below get into its foot, and must not come out above. */
TEST(slabs_that_lie_and_hover) {
    static const double gap[3] = {0.0, 0.5, 1.5};
    uint32_t k, where;
    for (k = 0; k < 3; k++)
        for (where = 0; where < 2; where++) { /* beside its foot; beneath it */
            static path_scene s;
            static model room, slab;
            const double lo[3] = {-9, -9, -9}, hi[3] = {9, 9, 9}, cell = 0.15, low = -9 + gap[k] * cell;
            const double lo1[3] = {-3, low, -3}, hi1[3] = {3, low + 6 * cell, 3}, lamp[3] = {-4, 6, 1};
            const double at[3] = {where == 0 ? 3 + 1.25 * cell : 1.5, -9, 0}, wide[2] = {where == 0 ? 0.75 * cell : 0.9, 2};
            double is, want, error;
            if (where == 1 && k == 0) continue;
            memset(&s, 0, sizeof s);
            room.points = room.triangles = slab.points = slab.triangles = 0;
            both_box(&room, &s, lo, hi, 1, 225);
            both_box(&slab, &s, lo1, hi1, 0, 200);
            compare_room(&room, &slab, VOXRT_COLUMNS_THIN, &s, lamp, at, wide, 128, 128, &is, &want, &error);
            /* of the floor's light in the open, 0.13 */
            CHECK_MSG(fabs(is - want) < (where == 0 ? 0.02 : 0.004) + 4 * error, "%g cells above the floor, %s: %.4f, not %.4f +- %.4f", gap[k],
                      where ? "beneath" : "beside", is, want, error);
        }
}

TEST(floors_beside_walls) { /* from half a cell to six cells from a wall: as bright as by paths, but for the first cell */
    static const double away[5] = {0.5, 1, 2, 3.5, 6}, bound[5] = {0.16, 0.1, 0.05, 0.04, 0.04};
    uint32_t k;
    for (k = 0; k < 5; k++) {
        static path_scene s;
        static model room;
        const double lo[3] = {-9, -9, -9}, hi[3] = {9, 9, 9}, lamp[3] = {-3, 4, 1}, at[3] = {-9 + 0.15 * away[k], -9, 0}, wide[2] = {0, 6};
        double is, want, error;
        memset(&s, 0, sizeof s);
        room.points = room.triangles = 0;
        both_box(&room, &s, lo, hi, 1, 225);
        compare_room(&room, NULL, VOXRT_COLUMNS_THIN, &s, lamp, at, wide, 128, 128, &is, &want, &error);
        CHECK_MSG(fabs(is / want - 1) < bound[k] + 4 * error / want, "%g cells from the wall: %.4f, not %.4f +- %.4f", away[k], is, want,
                  error);
    }
}

/* A box without a lid: light that leaves it is lost, and not given to what stays (as by dividing by the virtual lights
   that are somewhere). */
TEST(light_that_leaves_is_lost) {
    static path_scene s;
    static model m;
    static picture pic;
    const double lo[3] = {-9, -9, -9}, hi[3] = {9, 9, 9}, none[3] = {0, 0, 0}, lamp[3] = {0, 6, 0};
    voxrt_gi *gi = make_gi_at(64, 64, 64, 9.6, none);
    voxrt_gi_render_desc d;
    double want = 0, is = 0, error = 0;
    uint32_t i, a, k = 0;
    memset(&s, 0, sizeof s);
    memset(&d, 0, sizeof d);
    m.points = m.triangles = 0;
    s.state = 9;
    both_box(&m, &s, lo, hi, 1, 225);
    for (i = 0; i < 12; i++) { /* without the triangles at the top */
        if (s.p[i][0][1] > 8.9 && s.p[i][1][1] > 8.9 && s.p[i][2][1] > 8.9) continue;
        memcpy(s.p[k], s.p[i], sizeof s.p[k]);
        memcpy(s.n[k], s.n[i], sizeof s.n[k]);
        s.albedo[k] = s.albedo[i];
        memcpy(m.index[k], m.index[i], sizeof m.index[k]);
        memcpy(m.rgb[k], m.rgb[i], sizeof m.rgb[k]);
        k++;
    }
    REQUIRE(k == 10);
    s.count = (int)k;
    m.triangles = k;
    memcpy(s.lamp, lamp, sizeof s.lamp);
    s.intensity = 100;
    add_model(gi, &m);
    set_lamp(gi, lamp, s.intensity);
    open_picture(&pic);
    rng_state = 3;
    for (i = 0; i < POINTS; i++) {
        double p[3] = {0, -9, 0}, n[3] = {0, 1, 0}, e;
        for (a = 0; a < 3; a += 2) p[a] = 14 * rnd() - 7;
        for (a = 0; a < 3; a++) {
            pic.position[i][a] = (float)p[a];
            pic.normal[i][a] = (float)n[a];
            pic.albedo[i][a] = 1.0f;
        }
        want += path_indirect(&s, p, n, 1, 1000, &e) / POINTS;
        error += e * e / (POINTS * POINTS);
    }
    d.method = VOXRT_GI_VPL;
    d.rays = 256;
    d.pattern = 4;
    CHECK(voxrt_gi_render(&d, gi, &pic.g, NULL, pic.indirect[0], NULL) == VOXRT_OK);
    for (i = 0; i < gi->vpl_count; i++) k += gi->vpl[i].flux[0] > 0;
    CHECK_MSG(k > 0.6 * (double)gi->vpl_count && k < 0.8 * (double)gi->vpl_count, "%u of %u are somewhere", k, (unsigned)gi->vpl_count);
    is = mean_of((const float (*)[3])pic.indirect, POINTS);
    CHECK_MSG(fabs(is / want - 1) < 0.03 + 4 * sqrt(error) / want, "%.4f, not %.4f +- %.4f", is, want, sqrt(error));
    voxrt_gi_destroy(gi);
}

TEST(balls_do_not_shade_themselves) { /* rays from balls of 4 to 48 cells' radius, seen from outside: less than 1 % meet them */
    static const double radius[4] = {4, 8, 20, 48};
    uint32_t k;
    for (k = 0; k < 4; k++) {
        static model m;
        const double none[3] = {0, 0, 0};
        voxrt_gi *gi = make_gi_at(128, 128, 128, 64, none);
        voxrt_columns_trace_desc d;
        const uint32_t rays = test_quick() ? 4000 : 20000;
        uint32_t i, a, hits = 0;
        sphere(&m, radius[k], 90, 200, 0);
        add_model(gi, &m);
        CHECK(voxrt_gi_update(gi, NULL) == VOXRT_OK);
        memset(&d, 0, sizeof d);
        rng_state = 31 + k;
        for (i = 0; i < rays; i++) {
            voxrt_ray r;
            float n[3], u[2], l;
            uint8_t dark;
            do {
                for (a = 0; a < 3; a++) n[a] = (float)(2 * rnd() - 1);
                l = voxrti_dot3(n, n);
            } while (!(l > 0.01f && l < 1.0f) || !voxrti_normalize(n));
            u[0] = (float)rnd() * 0.999999f;
            u[1] = (float)rnd() * 0.999999f;
            (void)voxrti_lobe_direction(n, u, 1.0f, r.dir);
            for (a = 0; a < 3; a++) r.org[a] = (float)radius[k] * n[a];
            r.t_min = 0;
            r.t_max = 200;
            d.normals = n;
            CHECK(voxrt_columns_occluded(gi->columns, &d, &r, &dark, 1) == VOXRT_OK);
            hits += dark;
        }
        CHECK_MSG(hits < rays / 100, "radius %g: %.4f of the rays", radius[k], (double)hits / rays);
        voxrt_gi_destroy(gi);
    }
}

/* Least upper bound of |share of points in [0, x) x [0, y) - x y|, by all corners the points make. */
static double star(float (*u)[2], uint32_t n) {
    double worst = 0;
    uint32_t i, j, k;
    for (i = 0; i <= n; i++)
        for (j = 0; j <= n; j++) {
            const double x = i < n ? (double)u[i][0] : 1, y = j < n ? (double)u[j][1] : 1;
            uint32_t within = 0, open = 0;
            for (k = 0; k < n; k++) {
                within += (double)u[k][0] <= x && (double)u[k][1] <= y;
                open += (double)u[k][0] < x && (double)u[k][1] < y;
            }
            worst = fmax(worst, fmax((double)within / n - x * y, x * y - (double)open / n));
        }
    return worst;
}

/* Hammersley's points have the discrepancy that theory gives them (Halton & Zaremba 1969), ours are as good and random
   ones are not; a rotation makes it no worse than twice; numbers of one bounce say nothing about those of the next. */
TEST(points_are_even) {
    enum { N = 128 };
    static float u[N][2];
    double d, mean = 0, hammersley, xy = 0, xx = 0, yy = 0;
    uint32_t i, seed;
    for (i = 0; i < N; i++) {
        u[i][0] = (float)i / N;
        u[i][1] = baseline_radical(i, 2);
    }
    hammersley = star(u, N);
    CHECK_MSG(fabs(hammersley * N - (7 / 3.0 + 13 / 9.0)) < 0.3, "%.4f / %u", hammersley * N, N);
    for (i = 0; i < N; i++) {
        u[i][0] = baseline_turned(u[i][0], voxrti_hash32(5));
        u[i][1] = baseline_turned(u[i][1], voxrti_hash32(6));
    }
    d = star(u, N);
    CHECK_MSG(d < 2.5 * hammersley, "%.4f", d);
    for (seed = 0; seed < 8; seed++) {
        for (i = 0; i < N; i++) voxrti_sobol2(i, voxrti_hash32(seed), u[i]);
        mean += star(u, N) / 8;
    }
    CHECK_MSG(mean < 1.25 * hammersley, "%.4f against %.4f", mean, hammersley);
    rng_state = 4;
    for (i = 0; i < N; i++) {
        u[i][0] = (float)rnd();
        u[i][1] = (float)rnd();
    }
    d = star(u, N);
    CHECK_MSG(d > 2 * mean, "random points: %.4f", d);
    for (i = 0; i < 4096; i++) { /* as voxrti_gather_run makes them: the sample of the third bounce and of the fourth */
        const uint32_t third = voxrti_hash32(voxrti_hash32(77u + 0x9e3779b9u) + 0x9e3779b9u);
        float a[2], b[2];
        voxrti_sobol2(i, third, a);
        voxrti_sobol2(i, voxrti_hash32(third + 0x9e3779b9u), b);
        xy += ((double)a[0] - 0.5) * ((double)b[1] - 0.5);
        xx += ((double)a[0] - 0.5) * ((double)a[0] - 0.5);
        yy += ((double)b[1] - 0.5) * ((double)b[1] - 0.5);
    }
    CHECK_MSG(fabs(xy / sqrt(xx * yy)) < 4 / sqrt(4096.0), "correlation %.4f", xy / sqrt(xx * yy));
}

TEST(a_sheet_between_two_rooms) { /* 0.1 cells thick, red on one side and green on the other: each room gets its own colour */
    static path_scene s;
    static model m;
    static picture pic;
    const double lo[3] = {-9, -9, -9}, hi[3] = {9, 9, 9}, none[3] = {0, 0, 0}, lamp[3] = {-5, 2, 0}, thick = 0.015;
    const double top[2][4][3] = {{{-thick, -9, -6}, {-thick, -9, 6}, {-thick, 4, 6}, {-thick, 4, -6}},
                                 {{thick, -9, -6}, {thick, 4, -6}, {thick, 4, 6}, {thick, -9, 6}}};
    voxrt_gi *gi = make_gi_at(128, 128, 128, 9.6, none);
    voxrt_gi_render_desc d;
    double sum[2][2] = {{0, 0}, {0, 0}};
    uint32_t i, side, a;
    memset(&s, 0, sizeof s);
    m.points = m.triangles = 0;
    both_box(&m, &s, lo, hi, 1, 120);
    for (side = 0; side < 2; side++) {
        const uint32_t first = m.triangles;
        quad(&m, top[side][0], top[side][1], top[side][2], top[side][3], 0);
        for (i = first; i < m.triangles; i++) m.rgb[i][side] = 230;
    }
    add_model(gi, &m);
    set_lamp(gi, lamp, 100);
    open_picture(&pic);
    rng_state = 8;
    for (i = 0; i < POINTS; i++) { /* on the floor on both sides of it */
        pic.position[i][0] = (float)((i % 2 ? 1 : -1) * (0.8 + 2 * rnd()));
        pic.position[i][1] = -9;
        pic.position[i][2] = (float)(6 * rnd() - 3);
        pic.normal[i][1] = 1;
        for (a = 0; a < 3; a++) pic.albedo[i][a] = 1;
    }
    memset(&d, 0, sizeof d);
    d.rays = 256;
    CHECK(voxrt_gi_render(&d, gi, &pic.g, NULL, pic.indirect[0], NULL) == VOXRT_OK);
    for (i = 0; i < POINTS; i++) for (a = 0; a < 2; a++) sum[i % 2][a] += (double)pic.indirect[i][a];
    /* the lit side is on -x and red; the other one gets no light but from the walls, which are grey */
    CHECK_MSG(sum[0][0] > 1.5 * sum[0][1], "lit side: red %.4f, green %.4f", sum[0][0], sum[0][1]);
    CHECK_MSG(fabs(sum[1][0] / sum[1][1] - 1) < 0.02 && sum[1][0] < sum[0][0], "dark side: red %.4f, green %.4f", sum[1][0], sum[1][1]);
    voxrt_gi_destroy(gi);
}

TEST(coarse_grids_are_near) { /* a room with a block, light on one wall: the finer the grid the nearer the mean */
    static const struct { uint32_t nx, nz; double bound; } grid[4] = {{16, 64, 0.15}, {32, 64, 0.08}, {64, 64, 0.04}, {256, 128, 0.025}};
    uint32_t k;
    for (k = 0; k < 4; k++) {
        static path_scene s;
        static model m;
        const double lo[3] = {-9, -9, -9}, hi[3] = {9, 9, 9}, lo1[3] = {-4.1, -9, -4.3}, hi1[3] = {0.7, -3.2, 0.4};
        const double lamp[3] = {-6.5, 4, 1}, at[3] = {4.5, -9, 3}, wide[2] = {3, 4};
        double is, want, error;
        memset(&s, 0, sizeof s);
        m.points = m.triangles = 0;
        both_box(&m, &s, lo, hi, 1, 225);
        both_box(&m, &s, lo1, hi1, 0, 200);
        compare_room(&m, NULL, VOXRT_COLUMNS_THIN, &s, lamp, at, wide, grid[k].nx, grid[k].nz, &is, &want, &error);
        CHECK_MSG(fabs(is / want - 1) < grid[k].bound + 4 * error / want, "%u columns a side: %.4f of %.4f +- %.4f", grid[k].nx, is, want, error);
    }
}

TEST(a_hall_of_many_triangles) { /* openness within 3 units, against every triangle of the hall */
    sup_mesh mesh;
    static picture pic;
    float lo[3], hi[3];
    voxrt_gi_desc gd;
    voxrt_gi_object o;
    voxrt_gi_render_desc d;
    voxrt_gi *gi = NULL;
    voxrt_tree *tree = NULL;
    voxrt_build_desc build;
    voxrt_geometry geometry;
    const uint32_t rays = test_quick() ? 100 : 400;
    double is, want = 0;
    uint32_t i, k, a;
    REQUIRE(sup_scene_make("pillars", 0, &mesh) == 0 && sup_mesh_bounds(&mesh, lo, hi) == 0);
    memset(&gd, 0, sizeof gd);
    for (a = 0; a < 3; a++) {
        gd.columns.box_min[a] = (double)lo[a] - 0.1;
        gd.columns.box_max[a] = (double)hi[a] + 0.1;
    }
    REQUIRE(voxrt_gi_create(&gd, &gi) == VOXRT_OK);
    memset(&o, 0, sizeof o);
    o.mesh.positions = mesh.positions;
    o.mesh.vertex_count = mesh.vertex_count;
    o.mesh.indices = mesh.indices;
    o.mesh.triangle_count = mesh.triangle_count;
    o.still = 1;
    CHECK(voxrt_gi_add(gi, &o, NULL) == VOXRT_OK && voxrt_gi_update(gi, NULL) == VOXRT_OK);
    memset(&build, 0, sizeof build);
    build.resolution = 1024; /* 4 times as fine, by another way of rays */
    REQUIRE(voxrt_tree_build(&build, &o.mesh, NULL, &tree) == VOXRT_OK);
    voxrt_tree_geometry(tree, &geometry);
    open_picture(&pic);
    rng_state = 44;
    for (i = 0; i < POINTS; i++) {
        pic.position[i][0] = (float)((double)lo[0] + (double)(hi[0] - lo[0]) * (0.3 + 0.4 * rnd()));
        pic.position[i][1] = 1.2f;
        pic.position[i][2] = (float)((double)lo[2] + (double)(hi[2] - lo[2]) * (0.2 + 0.6 * rnd()));
        pic.normal[i][i % 3] = 1;
        for (a = 0; a < 3; a++) pic.albedo[i][a] = 1;
    }
    memset(&d, 0, sizeof d);
    d.method = VOXRT_GI_AO;
    d.rays = rays;
    d.radius = 3;
    CHECK(voxrt_gi_render(&d, gi, &pic.g, NULL, pic.indirect[0], NULL) == VOXRT_OK);
    is = mean_of((const float (*)[3])pic.indirect, POINTS);
    for (i = 0; i < POINTS; i++)
        for (k = 0; k < rays; k++) {
            voxrt_trace_desc t;
            voxrt_ray r;
            float u[2];
            uint8_t dark = 0;
            memset(&t, 0, sizeof t);
            u[0] = (float)rnd() * 0.999999f;
            u[1] = (float)rnd() * 0.999999f;
            (void)voxrti_lobe_direction(pic.normal[i], u, 1.0f, r.dir);
            memcpy(r.org, pic.position[i], sizeof r.org);
            r.t_min = 0;
            r.t_max = 3;
            geometry.occluded_fn(geometry.user, &t, &r, &dark, 1);
            want += (dark ? 0.0 : 1.0) / ((double)POINTS * rays);
        }
    CHECK(want > 0.2 && want < 0.95);
    CHECK_MSG(fabs(is - want) < 0.03, "%zu triangles: openness %.4f, not %.4f", mesh.triangle_count, is, want);
    voxrt_tree_destroy(tree);
    voxrt_gi_destroy(gi);
    sup_mesh_free(&mesh);
}

TEST(maps_accept_what_is_lit) { /* a slanted floor up to 80 degrees from the lamp: lit but for less than 0.5 %; behind a wall
                                   of 0.1 cells less than 1/1000 of the light gets through */
    static path_scene s;
    static model m;
    static picture pic;
    const double lo[3] = {-9, -9, -9}, hi[3] = {9, 9, 9}, none[3] = {0, 0, 0};
    const double wall[2][4][3] = {{{2, -9, -9}, {2, -9, 9}, {2, 9, 9}, {2, 9, -9}}, {{2.015, -9, -9}, {2.015, 9, -9}, {2.015, 9, 9}, {2.015, -9, 9}}};
    voxrt_gi *gi = make_gi_at(128, 128, 128, 9.6, none);
    voxrt_gi_render_desc d;
    const double lamp[3] = {-8.2, -7.4, 0};
    uint32_t i, a, lit = 0, behind = 0, turn;
    double before = 0, after = 0;
    memset(&s, 0, sizeof s);
    m.points = m.triangles = 0;
    both_box(&m, &s, lo, hi, 1, 200);
    for (i = 0; i < 2; i++) quad(&m, wall[i][0], wall[i][1], wall[i][2], wall[i][3], 200);
    add_model(gi, &m);
    set_lamp(gi, lamp, 100);
    memset(&d, 0, sizeof d);
    d.lookup = VOXRT_GI_LOOKUP_MAPS;
    d.map_size = 256;
    d.rays = 1;
    rng_state = 18;
    open_picture(&pic);
    for (turn = 0; turn < 40; turn++) {
        for (i = 0; i < POINTS; i++) { /* tan 80 degrees = 5.67, times 1.6 above the floor */
            const double x = i % 4 ? -8 + 9 * rnd() : 2.3 + 6 * rnd(), z = i % 4 ? 2 * rnd() - 1 : 16 * rnd() - 8;
            pic.position[i][0] = (float)x;
            pic.position[i][1] = -9;
            pic.position[i][2] = (float)z;
            pic.normal[i][1] = 1;
            for (a = 0; a < 3; a++) pic.albedo[i][a] = 1;
        }
        CHECK(voxrt_gi_render(&d, gi, &pic.g, pic.direct[0], NULL, NULL) == VOXRT_OK);
        for (i = 0; i < POINTS; i++) {
            if (i % 4) {
                lit += pic.direct[i][0] > 0;
                behind++;
                before += (double)pic.direct[i][0];
            } else {
                after += (double)pic.direct[i][0];
            }
        }
    }
    CHECK_MSG(lit > 0.995 * behind, "%u of %u points are lit", lit, behind);
    CHECK_MSG(after < 1e-3 * before, "%g of the light is behind the wall", after / before);
    voxrt_gi_destroy(gi);
}

/* Mean of what comes back along `count` rays from a point: directions by plain chance, or along a sequence. */
static double mean_light(const voxrt_gi *gi, const float p[3], const float n[3], uint32_t count, uint32_t seed, int plain) {
    enum { BATCH = 256 };
    static voxrt_ray ray[BATCH];
    static voxrt_column_hit hit[BATCH];
    static float normal[BATCH][3];
    voxrt_columns_trace_desc d;
    double sum = 0;
    uint32_t i, k, m;
    memset(&d, 0, sizeof d);
    d.normals = normal[0];
    for (i = 0; i < count; i += m) {
        m = count - i < BATCH ? count - i : BATCH;
        for (k = 0; k < m; k++) {
            float u[2];
            voxrti_sobol2(i + k, seed, u);
            if (plain) {
                u[0] = (float)(rnd() * 0.9999999);
                u[1] = (float)(rnd() * 0.9999999);
            }
            (void)voxrti_lobe_direction(n, u, 1.0f, ray[k].dir);
            memcpy(ray[k].org, p, sizeof ray[k].org);
            memcpy(normal[k], n, sizeof normal[k]);
            ray[k].t_min = 0;
            ray[k].t_max = INFINITY;
        }
        CHECK(voxrt_columns_trace(voxrt_gi_columns(gi), &d, ray, hit, m) == VOXRT_OK);
        for (k = 0; k < m; k++) {
            voxrt_gi_surface s;
            if (hit[k].t < INFINITY && voxrt_gi_get(gi, &hit[k], ray[k].dir, &s)) sum += (double)s.radiance[0];
        }
    }
    return sum / count;
}

TEST(errors_fall_with_rays) { /* smooth light: by plain chance as 1 / sqrt(rays), along a sequence faster */
    static path_scene s;
    static model m;
    static picture pic;
    static float truth[POINTS][3];
    static const uint32_t many[3] = {16, 64, 256};
    const double lo[3] = {-9, -9, -9}, hi[3] = {9, 9, 9}, none[3] = {0, 0, 0}, lamp[3] = {0, 2, 0};
    voxrt_gi *gi = make_gi_at(64, 64, 64, 9.6, none);
    voxrt_gi_render_desc d;
    double error[3], slope, mean[POINTS];
    uint32_t i, a, k, turn, plain;
    memset(&s, 0, sizeof s);
    m.points = m.triangles = 0;
    both_box(&m, &s, lo, hi, 1, 200);
    add_model(gi, &m);
    set_lamp(gi, lamp, 100);
    open_picture(&pic);
    rng_state = 77;
    for (i = 0; i < POINTS; i++) {
        pic.position[i][0] = (float)(16 * rnd() - 8);
        pic.position[i][1] = -9;
        pic.position[i][2] = (float)(16 * rnd() - 8);
        pic.normal[i][1] = 1;
        for (a = 0; a < 3; a++) pic.albedo[i][a] = 1;
    }
    memset(&d, 0, sizeof d);
    d.rays = 16384;
    CHECK(voxrt_gi_render(&d, gi, &pic.g, NULL, truth[0], NULL) == VOXRT_OK);
    for (k = 0; k < 3; k++) {
        double sum = 0;
        d.rays = many[k];
        for (turn = 0; turn < 4; turn++) {
            d.first_ray = (1u << 20) + turn * many[k];
            CHECK(voxrt_gi_render(&d, gi, &pic.g, NULL, pic.indirect[0], NULL) == VOXRT_OK);
            for (i = 0; i < POINTS; i++) sum += pow((double)pic.indirect[i][0] - (double)truth[i][0], 2);
        }
        error[k] = sqrt(sum);
    }
    slope = log(error[2] / error[0]) / log(16.0);
    CHECK_MSG(slope < -0.75, "errors %.4g %.4g %.4g: slope %.3f", error[0], error[1], error[2], slope);
    for (i = 0; i < POINTS; i++) mean[i] = mean_light(gi, pic.position[i], pic.normal[i], 8192, 5, 0);
    for (plain = 0; plain < 2; plain++) {
        for (k = 0; k < 3; k++) {
            double sum = 0;
            for (turn = 0; turn < (test_quick() ? 12u : 24u); turn++)
                for (i = 0; i < POINTS; i++)
                    sum += pow(mean_light(gi, pic.position[i], pic.normal[i], many[k], voxrti_hash32(turn * POINTS + i), (int)plain) - mean[i], 2);
            error[k] = sqrt(sum);
        }
        slope = log(error[2] / error[0]) / log(16.0);
        CHECK_MSG(plain ? fabs(slope + 0.5) < 0.05 : slope < -0.75, "%s: errors %.4g %.4g %.4g: slope %.3f",
                  plain ? "by plain chance" : "along a sequence", error[0], error[1], error[2], slope);
    }
    voxrt_gi_destroy(gi);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(paths_through_triangles_are_right);
    RUN(a_room_as_paths_through_its_triangles_have_it);
    RUN(closed_sphere_to_a_percent);
    RUN(lamps_beside_walls_make_no_dots);
    RUN(ways_of_rays);
    RUN(offsets_lose_what_planes_keep);
    RUN(points_go_where_sums_say);
    RUN(no_flicker_under_a_moving_lamp);
    RUN(scale_and_place_do_not_matter);
    RUN(under_a_lattice);
    RUN(slabs_that_lie_and_hover);
    RUN(floors_beside_walls);
    RUN(light_that_leaves_is_lost);
    RUN(balls_do_not_shade_themselves);
    RUN(points_are_even);
    RUN(a_sheet_between_two_rooms);
    RUN(coarse_grids_are_near);
    RUN(a_hall_of_many_triangles);
    RUN(maps_accept_what_is_lit);
    RUN(errors_fall_with_rays);
    return test_end();
}
