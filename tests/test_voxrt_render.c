/* Pictures: rays and orientation, shading against a plain computation in double precision, shadows, levels of detail
   and their promise in pixels, the same bits for any number of threads, progressive pictures, blur, frame budget. */
#include "test.h"
#define VOXRT_IMPLEMENTATION
#include "../voxrt.h"
#include "voxel_list.h"

static voxrt_voxel *render_add(cells *c, uint32_t x, uint32_t y, uint32_t z, int red, int green, int blue) {
    return cells_add(c, x, y, z, (uint32_t)red | (uint32_t)green << 8 | (uint32_t)blue << 16);
}

static void render_add_box(cells *c, uint32_t x0, uint32_t y0, uint32_t z0, uint32_t x1, uint32_t y1, uint32_t z1) {
    uint32_t x, y, z;
    for (z = z0; z < z1; z++)
        for (y = y0; y < y1; y++)
            for (x = x0; x < x1; x++) (void)render_add(c, x, y, z, 255, 255, 255);
}

/* A tree of all cells; depth levels; the whole grid is the cube of edge `size` at the origin (0: unit voxels). */
static voxrt_tree *render_make_tree(cells *c, uint32_t depth, double size, int normals) {
    voxrt_build_desc d;
    memset(&d, 0, sizeof d);
    d.disable_normals = !normals;
    d.box_size = size;
    return cells_tree(c, &d, depth);
}

/* A sphere in a grid of 2^depth cells, colours by place. */
static voxrt_tree *render_make_sphere(uint32_t depth, double part) {
    const uint32_t n = 1u << depth;
    cells c;
    size_t i;
    memset(&c, 0, sizeof c);
    cells_sphere(&c, n, n / 2.0 * part);
    for (i = 0; i < c.n; i++) {
        c.v[i].rgb[0] = (uint8_t)(c.v[i].x * 255 / n);
        c.v[i].rgb[1] = (uint8_t)(c.v[i].y * 255 / n);
        c.v[i].rgb[2] = (uint8_t)(c.v[i].z * 37);
    }
    return render_make_tree(&c, depth, 2.0, 1);
}

/* All buffers of a picture; `pad` extra bytes behind each row, filled with 0xee. */
typedef struct render_picture { voxrt_image m; size_t pad; } render_picture;

static void *rows(size_t stride, uint32_t h) {
    void *p = malloc(stride * h + 1);
    if (p == NULL) exit(1);
    memset(p, 0xee, stride * h + 1);
    return p;
}

static render_picture make_picture(uint32_t w, uint32_t h, size_t pad, int with_sum) {
    render_picture p;
    memset(&p, 0, sizeof p);
    p.pad = pad;
    p.m.width = w;
    p.m.height = h;
    p.m.rgba8_stride = 4 * (size_t)w + pad;
    p.m.rgba_stride = p.m.sum_stride = 16 * (size_t)w + pad;
    p.m.depth_stride = 4 * (size_t)w + pad;
    p.m.normal_stride = 12 * (size_t)w + pad;
    p.m.hit_stride = sizeof(voxrt_hit) * (size_t)w + pad;
    p.m.rgba8 = (uint8_t *)rows(p.m.rgba8_stride, h);
    p.m.rgba = (float *)rows(p.m.rgba_stride, h);
    p.m.sum = with_sum ? (float *)rows(p.m.sum_stride, h) : NULL;
    p.m.depth = (float *)rows(p.m.depth_stride, h);
    p.m.normal = (float *)rows(p.m.normal_stride, h);
    p.m.hit = (voxrt_hit *)rows(p.m.hit_stride, h);
    return p;
}
static void free_picture(render_picture *p) {
    free(p->m.rgba8);
    free(p->m.rgba);
    free(p->m.sum);
    free(p->m.depth);
    free(p->m.normal);
    free(p->m.hit);
    memset(p, 0, sizeof *p);
}
static uint64_t hash_rows(const void *p, size_t stride, size_t bytes, uint32_t h, uint64_t hash) {
    uint32_t y;
    for (y = 0; y < h; y++) hash = test_fnv1a((const uint8_t *)p + stride * y, bytes, hash);
    return hash;
}
static uint64_t hash_picture(const render_picture *p) {
    uint64_t h = hash_rows(p->m.rgba8, p->m.rgba8_stride, 4 * (size_t)p->m.width, p->m.height, 0);
    h = hash_rows(p->m.rgba, p->m.rgba_stride, 16 * (size_t)p->m.width, p->m.height, h);
    h = hash_rows(p->m.depth, p->m.depth_stride, 4 * (size_t)p->m.width, p->m.height, h);
    h = hash_rows(p->m.normal, p->m.normal_stride, 12 * (size_t)p->m.width, p->m.height, h);
    return hash_rows(p->m.hit, p->m.hit_stride, sizeof(voxrt_hit) * (size_t)p->m.width, p->m.height, h);
}
static const uint8_t *px(const render_picture *p, uint32_t x, uint32_t y) {
    return p->m.rgba8 + p->m.rgba8_stride * y + 4 * (size_t)x;
}
static const float *fpx(const render_picture *p, uint32_t x, uint32_t y) {
    return (const float *)(const void *)((const uint8_t *)p->m.rgba + p->m.rgba_stride * y + 16 * (size_t)x);
}
static float depth_at(const render_picture *p, uint32_t x, uint32_t y) {
    return *(const float *)(const void *)((const uint8_t *)p->m.depth + p->m.depth_stride * y + 4 * (size_t)x);
}
static const float *normal_at(const render_picture *p, uint32_t x, uint32_t y) {
    return (const float *)(const void *)((const uint8_t *)p->m.normal + p->m.normal_stride * y + 12 * (size_t)x);
}
static const voxrt_hit *hit_at(const render_picture *p, uint32_t x, uint32_t y) {
    return (const voxrt_hit *)(const void *)((const uint8_t *)p->m.hit + p->m.hit_stride * y + sizeof(voxrt_hit) * x);
}

static void set3(float *v, double x, double y, double z) {
    v[0] = (float)x;
    v[1] = (float)y;
    v[2] = (float)z;
}
static voxrt_camera render_look(double ex, double ey, double ez, double ax, double ay, double az, float fov) {
    voxrt_camera c;
    memset(&c, 0, sizeof c);
    set3(c.eye, ex, ey, ez);
    set3(c.at, ax, ay, az);
    c.fov_y = fov;
    return c;
}

/* ---- rays -------------------------------------------------------------------------------------------------- */

TEST(ray_conventions) {
    voxrt_camera c = render_look(1, 2, 5, 1, 2, -3, 90);
    voxrt_ray r;
    CHECK(voxrt_camera_ray(&c, 4, 2, 0.5, 0.5, &r) == VOXRT_OK); /* tan 45 = 1: a pixel is 1 wide at depth 1 */
    CHECK_NEAR(r.dir[0], -1.5, 1e-6);
    CHECK_NEAR(r.dir[1], 0.5, 1e-6);
    CHECK_NEAR(r.dir[2], -1, 1e-6);
    CHECK(r.org[0] == 1 && r.org[1] == 2 && r.org[2] == 5 && r.t_min == 0 && r.t_max == INFINITY);
    CHECK(voxrt_camera_ray(&c, 4, 2, 3.5, 1.5, &r) == VOXRT_OK);
    CHECK_NEAR(r.dir[0], 1.5, 1e-6);
    CHECK_NEAR(r.dir[1], -0.5, 1e-6);
    /* from the right, z up: right in the picture is +y */
    c = render_look(10, 0, 0, 0, 0, 0, 60);
    set3(c.up, 0, 0, 2);
    CHECK(voxrt_camera_ray(&c, 100, 100, 100, 50, &r) == VOXRT_OK);
    CHECK_NEAR(r.dir[0], -1, 1e-6);
    CHECK_NEAR(r.dir[1], tan(acos(-1.0) / 6), 1e-6);
    CHECK_NEAR(r.dir[2], 0, 1e-6);
    /* a tilted camera: the ray of the middle is the view, and t is the depth for every ray */
    c = render_look(3, 4, 5, -1, 0.5, 2, 35);
    set3(c.up, 0.2, 1, 0.1);
    {
        double f[3], l = 0;
        uint32_t a, k;
        for (a = 0; a < 3; a++) {
            f[a] = (double)c.at[a] - (double)c.eye[a];
            l += f[a] * f[a];
        }
        for (k = 0; k < 50; k++) {
            double along = 0;
            CHECK(voxrt_camera_ray(&c, 640, 480, k * 640.0 / 49, k * k % 480, &r) == VOXRT_OK);
            for (a = 0; a < 3; a++) along += (double)r.dir[a] * f[a] / sqrt(l);
            CHECK_NEAR(along, 1, 1e-6);
        }
        CHECK(voxrt_camera_ray(&c, 640, 480, 320, 240, &r) == VOXRT_OK);
        for (a = 0; a < 3; a++) CHECK_NEAR(r.dir[a], f[a] / sqrt(l), 1e-6);
    }
    set3(c.up, 4, 3.5, 3); /* along the view: any roll, but a frame */
    CHECK(voxrt_camera_ray(&c, 640, 480, 0, 0, &r) == VOXRT_OK);
    CHECK(voxrt_camera_ray(NULL, 640, 480, 0, 0, &r) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_camera_ray(&c, 640, 0, 0, 0, &r) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_camera_ray(&c, 640, 480, (double)NAN, 0, &r) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_camera_ray(&c, 640, 480, 0, (double)INFINITY, &r) == VOXRT_ERR_INVALID_ARG);
    {
        const double far_out[6] = {1e200, -1e200, 1e300, 1e42, -1.7e308, 1.7e308};
        uint32_t k;
        for (k = 0; k < 6; k++) { /* floats have no such direction */
            CHECK(voxrt_camera_ray(&c, 640, 480, far_out[k], 0, &r) == VOXRT_ERR_INVALID_ARG);
            CHECK(voxrt_camera_ray(&c, 640, 480, 0, far_out[k], &r) == VOXRT_ERR_INVALID_ARG);
        }
        CHECK(voxrt_camera_ray(&c, 640, 480, 1e30, -1e30, &r) == VOXRT_OK);
        CHECK(fabsf(r.dir[0]) < INFINITY && fabsf(r.dir[1]) < INFINITY && fabsf(r.dir[2]) < INFINITY);
    }
    c.fov_y = 180;
    CHECK(voxrt_camera_ray(&c, 640, 480, 0, 0, &r) == VOXRT_ERR_INVALID_ARG);
    c.fov_y = NAN;
    CHECK(voxrt_camera_ray(&c, 640, 480, 0, 0, &r) == VOXRT_ERR_INVALID_ARG);
    c = render_look(1, 1, 1, 1, 1, 1, 40);
    CHECK(voxrt_camera_ray(&c, 640, 480, 0, 0, &r) == VOXRT_ERR_INVALID_ARG);
    c = render_look(1, 1, 1, (double)INFINITY, 1, 1, 40);
    CHECK(voxrt_camera_ray(&c, 640, 480, 0, 0, &r) == VOXRT_ERR_INVALID_ARG);
}

/* How far from the middle of the picture a point is seen: 1 is its edge; infinite: not before the eye. */
static double seen_at(const voxrt_camera *c, uint32_t w, uint32_t h, const double p[3]) {
    voxrt_ray r[3];
    double x = 0, y = 0, z = 0, rx = 0, ry = 0;
    uint32_t a;
    CHECK(voxrt_camera_ray(c, w, h, w * 0.5, h * 0.5, &r[0]) == VOXRT_OK);
    CHECK(voxrt_camera_ray(c, w, h, w, h * 0.5, &r[1]) == VOXRT_OK);
    CHECK(voxrt_camera_ray(c, w, h, w * 0.5, 0, &r[2]) == VOXRT_OK);
    for (a = 0; a < 3; a++) z += (p[a] - (double)c->eye[a]) * (double)r[0].dir[a];
    if (!(z > 0)) return (double)INFINITY;
    for (a = 0; a < 3; a++) { /* from the middle of the plane at depth 1, along its right and its upper edge */
        const double right = (double)r[1].dir[a] - (double)r[0].dir[a], up = (double)r[2].dir[a] - (double)r[0].dir[a];
        const double d = (p[a] - (double)c->eye[a]) / z - (double)r[0].dir[a];
        x += d * right;
        y += d * up;
        rx += right * right;
        ry += up * up;
    }
    return fmax(fabs(x / rx), fabs(y / ry));
}

TEST(camera_fit) {
    static const double lo[3] = {-3, 10, -1}, hi[3] = {5, 11, 4};
    test_rng rng = test_rng_make(7);
    uint32_t k, a, corner;
    for (k = 0; k < 200; k++) {
        voxrt_camera c;
        float view[3];
        uint32_t w = 1 + test_rng_below(&rng, 2000), h = 1 + test_rng_below(&rng, 2000);
        double most = 0;
        memset(&c, 0, sizeof c);
        for (a = 0; a < 3; a++) view[a] = test_rng_range(&rng, -1, 1);
        c.fov_y = test_rng_range(&rng, 5, 120);
        if (k & 1u) set3(c.up, 0, 0, 1);
        CHECK(voxrt_camera_fit(&c, lo, hi, (k & 2u) ? view : NULL, w, h) == VOXRT_OK);
        for (corner = 0; corner < 8; corner++) {
            double p[3];
            for (a = 0; a < 3; a++) p[a] = (corner >> a & 1u) ? hi[a] : lo[a];
            most = fmax(most, seen_at(&c, w, h, p));
        }
        CHECK_MSG(most <= 1.0001 && most > 0.5, "corners reach %g of the picture", most);
    }
    {
        static const double low[3] = {0, 0, 0}, high[3] = {1e39, 1, 1}, off[3] = {1e12, 1e12, 1e12};
        static const double end[3] = {1e12 + 1, 1e12 + 1, 1e12 + 1};
        voxrt_camera c = render_look(1, 2, 3, 4, 5, 6, 40), before = c;
        CHECK(voxrt_camera_fit(&c, low, high, NULL, 10, 10) == VOXRT_ERR_INVALID_ARG); /* too far for a float */
        CHECK(voxrt_camera_fit(&c, off, end, NULL, 10, 10) == VOXRT_ERR_INVALID_ARG); /* floats are 65536 apart there */
        CHECK(memcmp(&c, &before, sizeof c) == 0);
    }
}

typedef struct framed { const voxrt_camera *c; const voxrt_tree_info *info; uint32_t w, h; double most; } framed;

static int frame_cell(void *user, const voxrt_voxel *v, uint32_t index) {
    framed *f = (framed *)user;
    const uint32_t cell[3] = {v->x, v->y, v->z};
    uint32_t corner, a;
    (void)index;
    for (corner = 0; corner < 8; corner++) {
        double p[3];
        for (a = 0; a < 3; a++)
            p[a] = f->info->world_origin[a] + f->info->voxel_size * (double)(cell[a] + (corner >> a & 1u));
        f->most = fmax(f->most, seen_at(f->c, f->w, f->h, p));
    }
    return 0;
}

/* Whatever is filled is in the picture; where voxels are no finer than what is looked at it reaches near an edge, and
   the eye is no farther away than for its box. */
TEST(camera_fit_of_trees) {
    static const uint32_t depth[6] = {1, 3, 6, 8, 9, 20};
    test_rng rng = test_rng_make(11);
    uint32_t i, k, a;
    for (i = 0; i < 6; i++) {
        const uint32_t n = 1u << depth[i], cell_count = depth[i] < 3 ? 3 : 40;
        cells l;
        voxrt_tree *t, *shared = NULL;
        voxrt_tree_info info;
        voxrt_build_desc d;
        double lo[3], hi[3];
        memset(&l, 0, sizeof l);
        memset(&d, 0, sizeof d);
        for (k = 0; k < cell_count; k++) /* along a diagonal, so that the box says little */
            (void)render_add(&l, (uint32_t)((uint64_t)(n - 1) * k / cell_count), (uint32_t)((uint64_t)(n - 1) * k / cell_count),
                      (uint32_t)((uint64_t)(n / 2) * (cell_count - k) / cell_count), 255, 0, 0);
        d.box_size = 0.5 + i;
        d.box_min[1] = 3;
        d.box_min[2] = -7;
        t = cells_tree(&l, &d, depth[i]);
        REQUIRE(t != NULL && voxrt_tree_share(t, NULL, &shared) == VOXRT_OK);
        voxrt_tree_get_info(t, &info);
        voxrt_tree_bounds(t, lo, hi);
        for (k = 0; k < 60; k++) {
            const uint32_t w = 1 + test_rng_below(&rng, 2000), h = 1 + test_rng_below(&rng, 2000), square = k % 5 == 4;
            voxrt_camera c, other, box;
            float view[3];
            framed f;
            double far_tree = 0, far_box = 0;
            memset(&c, 0, sizeof c);
            for (a = 0; a < 3; a++) view[a] = test_rng_range(&rng, -1, 1);
            c.fov_y = k % 3 == 0 ? 0 : test_rng_range(&rng, 5, 120);
            if (k & 1u) set3(c.up, 0, 0, 1);
            other = box = c;
            CHECK(voxrt_camera_fit_tree(&c, t, (k & 2u) ? view : NULL, square ? 0 : w, h) == VOXRT_OK);
            CHECK(voxrt_camera_fit_tree(&other, shared, (k & 2u) ? view : NULL, square ? 0 : w, h) == VOXRT_OK);
            CHECK(memcmp(&c, &other, sizeof c) == 0 && c.fov_y == box.fov_y && memcmp(c.up, box.up, sizeof c.up) == 0);
            f.c = &c;
            f.info = &info;
            f.w = square ? h : w;
            f.h = h;
            f.most = 0;
            (void)voxrt_tree_each(t, depth[i], frame_cell, &f);
            CHECK_MSG(f.most <= 1.0001 && (f.most > 0.5 || depth[i] > 6), "depth %u, view %u: voxels reach %g of the picture", depth[i], k, f.most);
            CHECK(voxrt_camera_fit(&box, lo, hi, (k & 2u) ? view : NULL, square ? 0 : w, h) == VOXRT_OK);
            for (a = 0; a < 3; a++) {
                far_tree += ((double)c.eye[a] - (double)c.at[a]) * ((double)c.eye[a] - (double)c.at[a]);
                far_box += ((double)box.eye[a] - (double)box.at[a]) * ((double)box.eye[a] - (double)box.at[a]);
            }
            if (depth[i] <= 6) CHECK_MSG(far_tree <= far_box * 1.0001, "depth %u, view %u: %g, not %g", depth[i], k, far_tree, far_box);
        }
        voxrt_tree_destroy(t);
        voxrt_tree_destroy(shared);
    }
}

/* Trees where floats do not reach, or cannot tell one voxel from the next; views that are none. The camera stays. */
TEST(camera_fit_of_trees_out_of_reach) {
    static const double size[5] = {1e300, 1e39, 1e-3, 1e-300, 1.0}, from[5] = {0, 0, 1e12, 1e30, 1e300};
    const voxrt_camera before = render_look(1, 2, 3, 4, 5, 6, 40);
    const float none[3] = {0, 0, 0}, wrong[3] = {0, NAN, 1};
    cells l;
    voxrt_camera c = before;
    voxrt_tree *t;
    int k;
    memset(&l, 0, sizeof l);
    for (k = 0; k < 5; k++) {
        voxrt_build_desc d;
        render_add_box(&l, 0, 0, 0, 4, 4, 4);
        memset(&d, 0, sizeof d);
        d.box_size = size[k];
        d.box_min[0] = d.box_min[1] = d.box_min[2] = from[k];
        t = cells_tree(&l, &d, 2);
        REQUIRE(t != NULL);
        CHECK_MSG(voxrt_camera_fit_tree(&c, t, NULL, 10, 10) == VOXRT_ERR_INVALID_ARG, "tree %d", k);
        voxrt_tree_destroy(t);
    }
    render_add_box(&l, 0, 0, 0, 4, 4, 4);
    t = render_make_tree(&l, 2, 1.0, 0);
    REQUIRE(t != NULL);
    CHECK(voxrt_camera_fit_tree(&c, t, none, 10, 10) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_camera_fit_tree(&c, t, wrong, 10, 10) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_camera_fit_tree(&c, NULL, NULL, 10, 10) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_camera_fit_tree(NULL, t, NULL, 10, 10) == VOXRT_ERR_INVALID_ARG);
    c.fov_y = 180;
    CHECK(voxrt_camera_fit_tree(&c, t, NULL, 10, 10) == VOXRT_ERR_INVALID_ARG);
    c.fov_y = before.fov_y;
    CHECK(memcmp(&c, &before, sizeof c) == 0);
    voxrt_tree_destroy(t);
}

/* A wall at z = 1 seen from an angle: depth is the distance of the hit point along the view, alpha and miss values. */
TEST(depth_and_alpha) {
    cells c;
    voxrt_tree *t;
    voxrt_render_desc d;
    render_picture p = make_picture(61, 47, 12, 0);
    uint32_t x, y, hits = 0, misses = 0, a;
    double f[3], l = 0;
    memset(&c, 0, sizeof c);
    render_add_box(&c, 0, 0, 0, 16, 16, 1);
    t = render_make_tree(&c, 4, 0, 0);
    memset(&d, 0, sizeof d);
    d.camera = render_look(20, 25, 30, 8, 8, 1, 40);
    for (a = 0; a < 3; a++) {
        f[a] = (double)d.camera.at[a] - (double)d.camera.eye[a];
        l += f[a] * f[a];
    }
    CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
    for (y = 0; y < p.m.height; y++)
        for (x = 0; x < p.m.width; x++) {
            voxrt_ray r;
            double s, q[2];
            CHECK(voxrt_camera_ray(&d.camera, p.m.width, p.m.height, x + 0.5, y + 0.5, &r) == VOXRT_OK);
            s = (1.0 - (double)r.org[2]) / (double)r.dir[2];
            for (a = 0; a < 2; a++) q[a] = (double)r.org[a] + s * (double)r.dir[a];
            if (q[0] > 0.01 && q[1] > 0.01 && q[0] < 15.99 && q[1] < 15.99) { /* meets the upper side of the wall */
                double along = 0, point[3];
                for (a = 0; a < 3; a++) {
                    point[a] = (double)r.org[a] + s * (double)r.dir[a] - (double)d.camera.eye[a];
                    along += point[a] * f[a] / sqrt(l);
                }
                CHECK_NEAR(depth_at(&p, x, y), along, 1e-4);
                CHECK(px(&p, x, y)[3] == 255 && fpx(&p, x, y)[3] == 1);
                CHECK(hit_at(&p, x, y)->face == 5 && normal_at(&p, x, y)[2] == 1);
                if (fabs(q[0] - floor(q[0] + 0.5)) > 1e-5) CHECK_EQ_U64(hit_at(&p, x, y)->cell[0], (uint64_t)q[0]);
                hits++;
            } else if (depth_at(&p, x, y) == INFINITY) {
                for (a = 0; a < 4; a++) CHECK(px(&p, x, y)[a] == 0 && fpx(&p, x, y)[a] == 0);
                for (a = 0; a < 3; a++) CHECK(normal_at(&p, x, y)[a] == 0);
                CHECK(hit_at(&p, x, y)->node == VOXRT_NO_NODE);
                misses++;
            }
        }
    CHECK(hits > 300 && misses > 300);
    for (y = 0; y < p.m.height; y++) /* rows end where they end */
        for (x = 0; x < 12; x++) {
            CHECK(p.m.rgba8[p.m.rgba8_stride * y + 4 * p.m.width + x] == 0xee);
            CHECK(((const uint8_t *)p.m.depth)[p.m.depth_stride * y + 4 * p.m.width + x] == 0xee);
        }
    voxrt_tree_destroy(t);
    free_picture(&p);
}

/* Corners of a cube in different colours: where they have to be in the picture, and exactly as they are stored. */
TEST(orientation_and_unlit_colors) {
    cells c;
    voxrt_tree *t;
    voxrt_render_desc d;
    render_picture p = make_picture(64, 64, 0, 0);
    uint32_t i, x, y, wrong = 0;
    memset(&c, 0, sizeof c);
    (void)render_add(&c, 0, 0, 7, 200, 10, 11);
    (void)render_add(&c, 7, 0, 7, 12, 201, 13);
    (void)render_add(&c, 0, 7, 7, 14, 15, 202);
    (void)render_add(&c, 7, 7, 7, 203, 204, 16);
    t = render_make_tree(&c, 3, 0, 0);
    memset(&d, 0, sizeof d);
    d.camera = render_look(4, 4, 20, 4, 4, 0, 40);
    d.view = VOXRT_VIEW_UNLIT;
    CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
    /* the corner's centre at (+-3.5, +-3.5) and depth 12: 32 + 3.5 / (12 * tan 20) * 32 */
    CHECK(px(&p, 6, 57)[0] == 200 && px(&p, 6, 57)[1] == 10 && px(&p, 6, 57)[2] == 11);
    CHECK(px(&p, 57, 57)[0] == 12 && px(&p, 57, 57)[1] == 201 && px(&p, 57, 57)[2] == 13);
    CHECK(px(&p, 6, 6)[0] == 14 && px(&p, 6, 6)[1] == 15 && px(&p, 6, 6)[2] == 202);
    CHECK(px(&p, 57, 6)[0] == 203 && px(&p, 57, 6)[1] == 204 && px(&p, 57, 6)[2] == 16);
    CHECK(px(&p, 32, 32)[3] == 0);
    voxrt_tree_destroy(t);
    /* every byte value, several samples, both ways to compose */
    for (i = 0; i < 256; i++) (void)render_add(&c, i & 15u, i >> 4, 0, (int)i, (int)(255 - i), (int)(i * 7 & 255));
    t = render_make_tree(&c, 4, 0, 0);
    d.camera = render_look(8, 8, 30, 8, 8, 0, 30);
    for (i = 0; i < 4; i++) {
        d.thesis_compose = i & 1u;
        d.samples = i < 2 ? 1 : 5;
        CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
        for (y = 0; y < 64; y++)
            for (x = 0; x < 64; x++) {
                const voxrt_hit *h = hit_at(&p, x, y);
                uint32_t v = h->cell[0] + 16 * h->cell[1];
                if (h->node == VOXRT_NO_NODE || (i >= 2 && (x % 4 != 1 || y % 4 != 1))) continue;
                if (i >= 2) { /* all samples in one voxel? */
                    voxrt_ray r;
                    voxrt_hit hit;
                    uint32_t k, same = 1;
                    for (k = 0; k < 4; k++) {
                        CHECK(voxrt_camera_ray(&d.camera, 64, 64, x + (k & 1u), y + (k >> 1), &r) == VOXRT_OK);
                        same &= voxrt_trace1(t, &r, &hit) && hit.cell[0] == h->cell[0] && hit.cell[1] == h->cell[1];
                    }
                    if (!same) continue;
                }
                wrong += px(&p, x, y)[0] != v || px(&p, x, y)[1] != 255 - v || px(&p, x, y)[2] != (v * 7 & 255);
            }
        CHECK_EQ_U64(wrong, 0);
    }
    voxrt_tree_destroy(t);
    free_picture(&p);
}

/* ---- shading ----------------------------------------------------------------------------------------------- */

static double to_linear(double c) { return c <= 0.04045 ? c / 12.92 : pow((c + 0.055) / 1.055, 2.4); }
static double to_srgb(double c) {
    return c <= 0 ? 0 : c >= 1 ? 1 : c <= 0.0031308 ? c * 12.92 : 1.055 * pow(c, 1 / 2.4) - 0.055;
}

/* The formulas of shading and composing in double precision, from normal, depth and colour of each pixel (no shadows). */
static void shade_oracle(const voxrt_render_desc *d, const voxrt_material *m, const render_picture *p, uint32_t x, uint32_t y,
                         const uint8_t rgb[3], double out[3]) {
    voxrt_ray r;
    double point[3], n[3], len = 0;
    size_t l;
    uint32_t a;
    CHECK(voxrt_camera_ray(&d->camera, p->m.width, p->m.height, x + 0.5, y + 0.5, &r) == VOXRT_OK);
    for (a = 0; a < 3; a++) {
        point[a] = (double)r.org[a] + (double)depth_at(p, x, y) * (double)r.dir[a];
        n[a] = (double)normal_at(p, x, y)[a];
        len += (double)r.dir[a] * (double)r.dir[a];
    }
    for (a = 0; a < 3; a++) out[a] = 0;
    {
        double bright[3], shine[3];
        for (a = 0; a < 3; a++) {
            bright[a] = (double)m->ambient[a];
            shine[a] = 0;
        }
        for (l = 0; l < d->light_count; l++) {
            const voxrt_light *light = &d->lights[l];
            double to[3], length = 0, cosine = 0, along = 0, dot = 0;
            for (a = 0; a < 3; a++) {
                to[a] = (double)light->position[a] - (light->directional ? 0.0 : point[a]);
                length += to[a] * to[a];
            }
            for (a = 0; a < 3; a++) {
                to[a] /= sqrt(length);
                cosine += to[a] * n[a];
            }
            if (cosine <= 0) continue;
            for (a = 0; a < 3; a++) { /* mirrored light direction against the direction to the viewer */
                dot = 2 * cosine * n[a] - to[a];
                along += dot * -(double)r.dir[a] / sqrt(len);
            }
            for (a = 0; a < 3; a++) {
                bright[a] += (double)m->diffuse * cosine * (double)light->color[a];
                if (along > 0)
                    shine[a] += (double)m->specular * pow(along, (double)m->shininess) * (double)light->color[a];
            }
        }
        for (a = 0; a < 3; a++) {
            out[a] = d->thesis_compose ? rgb[a] * bright[a] + 255 * shine[a]
                                       : to_linear(rgb[a] / 255.0) * bright[a] + shine[a];
        }
    }
}

TEST(compose) {
    voxrt_tree *t = render_make_sphere(5, 0.9);
    voxrt_render_desc d;
    voxrt_light light[3];
    voxrt_material m;
    render_picture p = make_picture(96, 80, 0, 0);
    uint32_t mode, x, y, a, seen = 0, cut = 0;
    memset(light, 0, sizeof light);
    memset(&d, 0, sizeof d);
    memset(&m, 0, sizeof m);
    set3(light[0].position, -1, 3, 4);
    set3(light[0].color, 0.9, 0.1, 0.05);
    set3(light[1].position, 5, 1, 1);
    set3(light[1].color, 0, 1.9, 0.4);
    light[1].directional = 1;
    set3(light[2].position, 1, -9, 2);
    set3(light[2].color, 0.3, 0.3, 2.5);
    set3(m.ambient, 0.1, 0.02, 0);
    m.diffuse = 0.8f;
    d.camera = render_look(3, 2, 4, 1, 1, 1, 45);
    d.lights = light;
    d.light_count = 3;
    d.material = &m;
    for (mode = 0; mode < 4; mode++) {
        d.thesis_compose = mode & 1u;
        m.specular = mode >= 2 ? 0.7f : 0.0f;
        m.shininess = 12.5f;
        CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
        for (y = 0; y < 80; y++)
            for (x = 0; x < 96; x++) {
                uint8_t rgb[3];
                double want[3];
                if (hit_at(&p, x, y)->node == VOXRT_NO_NODE) continue;
                voxrt_hit_color(t, hit_at(&p, x, y), rgb);
                shade_oracle(&d, &m, &p, x, y, rgb, want);
                seen++;
                for (a = 0; a < 3; a++) {
                    double b, byte = px(&p, x, y)[a];
                    if (d.thesis_compose) {
                        cut += want[a] > 255;
                        want[a] = want[a] > 255 ? 255 : want[a];
                        CHECK_NEAR(fpx(&p, x, y)[a], to_linear(want[a] / 255), 3e-5);
                        b = want[a];
                    } else {
                        CHECK_NEAR(fpx(&p, x, y)[a], want[a], 1e-5 + 1e-5 * want[a]);
                        b = to_srgb(want[a]) * 255;
                    }
                    CHECK_MSG(fabs(byte - b) <= 0.502, "byte %g for %g", byte, b); /* rounded to nearest */
                }
            }
    }
    CHECK(seen > 4000 && cut > 100);
    voxrt_tree_destroy(t);
    free_picture(&p);
}

TEST(default_picture) { /* everything zero: framed, lit, not black, not burnt out */
    voxrt_tree *t = render_make_sphere(6, 0.95);
    render_picture p = make_picture(80, 60, 0, 0);
    uint32_t x, y, hits = 0, burnt = 0, dark = 0;
    CHECK(voxrt_render(NULL, t, &p.m, NULL) == VOXRT_OK);
    for (y = 0; y < 60; y++)
        for (x = 0; x < 80; x++) {
            if (px(&p, x, y)[3] == 0) continue;
            hits++;
            CHECK(x > 0 && x < 79 && y > 0 && y < 59);
            burnt += fpx(&p, x, y)[0] >= 1;
            dark += fpx(&p, x, y)[0] + fpx(&p, x, y)[1] + fpx(&p, x, y)[2] <= 0;
        }
    CHECK(hits > 600);
    CHECK_EQ_U64(burnt, 0);
    CHECK_EQ_U64(dark, 0);
    voxrt_tree_destroy(t);
    free_picture(&p);
}

/* Normals that look away are turned, unless asked not to; never those near the silhouette. */
TEST(two_sided) {
    cells c;
    voxrt_tree *t;
    voxrt_render_desc d;
    voxrt_light light;
    render_picture p = make_picture(32, 32, 0, 0);
    uint32_t x, y;
    memset(&c, 0, sizeof c);
    memset(&d, 0, sizeof d);
    memset(&light, 0, sizeof light);
    for (y = 0; y < 16; y++)
        for (x = 0; x < 16; x++) {
            voxrt_voxel *v = render_add(&c, x, y, 8, 255, 255, 255);
            v->has_normal = 1;
            set3(v->normal, 0, 0, -1);
        }
    t = render_make_tree(&c, 4, 0, 1);
    set3(light.position, 0, 0, 1);
    set3(light.color, 0.5, 0.5, 0.5);
    light.directional = 1;
    d.lights = &light;
    d.light_count = 1;
    d.camera = render_look(8, 8, 30, 8, 8, 0, 30);
    CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
    CHECK_NEAR(fpx(&p, 16, 16)[0], 0.55, 2e-4);
    CHECK(normal_at(&p, 16, 16)[2] > 0.99f);
    d.one_sided = 1;
    CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
    CHECK_NEAR(fpx(&p, 16, 16)[0], 0.05, 1e-6);
    CHECK(normal_at(&p, 16, 16)[2] < -0.99f);
    d.face_normals = 1;
    CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
    CHECK(normal_at(&p, 16, 16)[2] == 1);
    voxrt_tree_destroy(t);
    free_picture(&p);
}

/* ---- shadows ----------------------------------------------------------------------------------------------- */

TEST(shadows) {
    cells c;
    voxrt_tree *t;
    voxrt_render_desc d;
    voxrt_render_stats stats;
    voxrt_light light;
    render_picture p = make_picture(96, 96, 0, 0);
    uint32_t k, x, y;
    memset(&c, 0, sizeof c);
    render_add_box(&c, 0, 0, 0, 32, 1, 32);     /* floor */
    render_add_box(&c, 12, 20, 12, 20, 22, 20); /* a lid above its middle */
    t = render_make_tree(&c, 5, 0, 0);
    memset(&d, 0, sizeof d);
    memset(&light, 0, sizeof light);
    d.camera = render_look(16, 12, 60, 16, 0, 16, 40);
    d.lights = &light;
    d.light_count = 1;
    set3(light.color, 0.5, 0.5, 0.5);
    for (k = 0; k < 5; k++) {
        uint32_t lit = 0, dark = 0, wrong = 0;
        light.directional = k != 2 && k != 3;
        set3(light.position, 0, 1, 0);
        if (k == 2) set3(light.position, 16, 31, 16);  /* above the lid */
        if (k == 3) set3(light.position, 16, 15, 16);  /* below it: no shadow on the floor */
        light.no_shadow = k == 4;
        d.shadows = k != 1;
        memset(&stats, 0, sizeof stats);
        CHECK(voxrt_render(&d, t, &p.m, &stats) == VOXRT_OK);
        for (y = 0; y < 96; y++)
            for (x = 0; x < 96; x++) {
                const voxrt_hit *h = hit_at(&p, x, y);
                voxrt_ray r;
                double q[3], s, u[2];
                int shadowed, a;
                if (h->node == VOXRT_NO_NODE || h->face != 3 || h->cell[1] != 0) continue;
                CHECK(voxrt_camera_ray(&d.camera, 96, 96, x + 0.5, y + 0.5, &r) == VOXRT_OK);
                for (a = 0; a < 3; a++) q[a] = (double)r.org[a] + (double)depth_at(&p, x, y) * (double)r.dir[a];
                s = k == 2 ? (22.0 - 1.0) / (31.0 - 1.0) : 0.0; /* where it passes the lid's upper side */
                for (a = 0; a < 2; a++) u[a] = q[2 * a] + s * (16.0 - q[2 * a]);
                if (fabs(fabs(u[0] - 16) - 4) < 0.6 || fabs(fabs(u[1] - 16) - 4) < 0.6) continue; /* at its edge */
                shadowed = fabs(u[0] - 16) < 4 && fabs(u[1] - 16) < 4 && k != 1 && k != 3 && k != 4;
                lit += !shadowed;
                dark += (uint32_t)shadowed;
                wrong += (fpx(&p, x, y)[0] < 0.051f) != shadowed;
            }
        CHECK_EQ_U64(wrong, 0);
        CHECK(lit > 100 && (dark > 50) == (k == 0 || k == 2));
        CHECK((stats.shadow.rays > 0) == (k != 1 && k != 4));
        CHECK_EQ_U64(stats.primary.rays, 96 * 96);
    }
    voxrt_tree_destroy(t);
    free_picture(&p);
}

/* Pixels of a smooth sphere that face the light, but are dark. A convex body throws no shadow on itself. */
TEST(self_shadow) {
    static const double elevation[6] = {5, 20, 40, 60, 75, 89};
    uint32_t depth, i, x, y, most = test_quick() ? 6 : 7;
    const char *deeper = getenv("TEST_DEPTH");
    if (deeper != NULL) most = (uint32_t)atoi(deeper);
    for (depth = 5; depth <= most; depth++) {
        voxrt_tree *t = render_make_sphere(depth, 0.95);
        render_picture p = make_picture(200, 200, 0, 0);
        uint32_t way, lit = 0, dark[2] = {0, 0};
        for (way = 0; way < 2; way++)
            for (i = 0, lit = 0; i < 6; i++) {
                voxrt_render_desc d;
                voxrt_light light;
                memset(&d, 0, sizeof d);
                memset(&light, 0, sizeof light);
                light.directional = 1;
                set3(light.position, cos(elevation[i] * 0.0174532925), sin(elevation[i] * 0.0174532925), 0.3);
                set3(light.color, 1, 1, 1);
                d.lights = &light;
                d.light_count = 1;
                d.shadows = 1;
                d.thesis_shadows = way == 0;
                d.camera = render_look(2.6, 2.2, 4, 1, 1, 1, 32);
                CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
                for (y = 0; y < 200; y++)
                    for (x = 0; x < 200; x++) {
                        uint8_t rgb[3];
                        double n = 0, l = 0;
                        uint32_t a;
                        if (hit_at(&p, x, y)->node == VOXRT_NO_NODE) continue;
                        voxrt_hit_color(t, hit_at(&p, x, y), rgb);
                        for (a = 0; a < 3; a++) {
                            n += (double)normal_at(&p, x, y)[a] * (double)light.position[a];
                            l += (double)light.position[a] * (double)light.position[a];
                        }
                        if (n / sqrt(l) < 0.02 || rgb[0] < 30) continue;
                        lit++;
                        dark[way] += fpx(&p, x, y)[0] < (float)to_linear(rgb[0] / 255.0) * 0.0501f;
                    }
            }
        if (test_g.verbose)
            printf("     sphere %u^3: %u lit pixels, falsely dark: thesis %.2f %%, lifted origin %.4f %%\n",
                   1u << depth, lit, 100.0 * dark[0] / lit, 100.0 * dark[1] / lit);
        CHECK(lit > 20000);
        CHECK_MSG(dark[0] > lit / 50, "the thesis' origin gives only %u of %u", dark[0], lit);
        CHECK_MSG(dark[1] * 100 <= dark[0], "%u, thesis %u", dark[1], dark[0]); /* -99 % */
        voxrt_tree_destroy(t);
        free_picture(&p);
    }
}

/* ---- levels of detail -------------------------------------------------------------------------------------- */

typedef struct level_cells { cells c; } level_cells;
static int take_cell(void *user, const voxrt_voxel *v, uint32_t index) {
    level_cells *l = (level_cells *)user;
    voxrt_voxel *out = render_add(&l->c, v->x, v->y, v->z, v->rgb[0], v->rgb[1], v->rgb[2]);
    (void)index;
    out->has_normal = v->has_normal;
    memcpy(out->normal, v->normal, sizeof out->normal);
    return 0;
}

TEST(forced_level) { /* is the picture of a tree that ends at that level */
    uint32_t depth, k, x, y;
    for (depth = 5; depth <= 6; depth++) {
        voxrt_tree *t = render_make_sphere(depth, 0.9);
        for (k = 1; k <= depth; k++) {
            render_picture p = make_picture(72, 56, 0, 0), q = make_picture(72, 56, 0, 0);
            voxrt_render_desc d;
            level_cells l;
            voxrt_tree *coarse;
            uint32_t differ = 0;
            memset(&l, 0, sizeof l);
            memset(&d, 0, sizeof d);
            CHECK(voxrt_tree_each(t, k, take_cell, &l) == 0);
            coarse = render_make_tree(&l.c, k, 2.0, 1);
            d.camera = render_look(3.1, 2.3, 4.2, 1, 1.05, 0.95, 40);
            CHECK(voxrt_render(&d, coarse, &q.m, NULL) == VOXRT_OK);
            d.max_level_plus_1 = k + 1;
            CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
            for (y = 0; y < 56; y++)
                for (x = 0; x < 72; x++) {
                    const voxrt_hit *a = hit_at(&p, x, y), *b = hit_at(&q, x, y);
                    differ += memcmp(px(&p, x, y), px(&q, x, y), 4) != 0;
                    differ += depth_at(&p, x, y) != depth_at(&q, x, y);
                    differ += a->face != b->face || memcmp(a->cell, b->cell, sizeof a->cell) != 0;
                    differ += a->node != VOXRT_NO_NODE && a->level != k;
                }
            CHECK_MSG(differ == 0, "depth %u level %u: %u differences", depth, k, differ);
            voxrt_tree_destroy(coarse);
            free_picture(&p);
            free_picture(&q);
        }
        voxrt_tree_destroy(t);
    }
}

/* The promise of `tolerance`: cells are at most E pixels wide, as coarse as that allows, and the outline is off by no
   more than a cell. */
TEST(tolerance_in_pixels) {
    static const float tolerance[4] = {0.5f, 1.0f, 2.5f, 7.0f};
    voxrt_tree *t = render_make_sphere(test_quick() ? 6 : 7, 0.9);
    voxrt_tree_info info;
    render_picture p = make_picture(130, 110, 0, 0), full = make_picture(130, 110, 0, 0);
    uint32_t e, k, x, y;
    voxrt_tree_get_info(t, &info);
    for (k = 0; k < 3; k++) {
        voxrt_render_desc d;
        double pixel;
        memset(&d, 0, sizeof d);
        d.camera = k == 0 ? render_look(2, 2, 9, 1, 1, 1, 25) : k == 1 ? render_look(1.2, 2.6, 2.2, 1, 1, 1, 60) :
                   render_look(-60, 20, 90, 1, 1, 1, 2);
        pixel = 2 * tan((double)d.camera.fov_y * 0.00872664626) / 110;
        CHECK(voxrt_render(&d, t, &full.m, NULL) == VOXRT_OK);
        for (e = 0; e < 4; e++) {
            uint32_t coarse = 0, fine = 0, lost = 0, stray = 0, finer = 0;
            int32_t reach = (int32_t)(tolerance[e] * 1.8f) + 2, i, j;
            d.tolerance = tolerance[e];
            CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
            for (y = 0; y < 110; y++)
                for (x = 0; x < 130; x++) {
                    const voxrt_hit *h = hit_at(&p, x, y);
                    int here = h->node != VOXRT_NO_NODE, there = hit_at(&full, x, y)->node != VOXRT_NO_NODE;
                    if (here) {
                        double edge = info.voxel_size * (double)(1u << (info.depth - h->level));
                        double allowed = (double)tolerance[e] * pixel * (double)h->t;
                        if (h->level < info.depth) coarse += edge > allowed * 1.0001;
                        fine += edge * 2 * 1.3 < allowed * 0.9999; /* the ray may have entered the parent before */
                        finer += h->level < info.depth;
                    }
                    if (here == there) continue;
                    {   /* outline: the other state has to be near */
                        int found = 0;
                        for (j = -reach; j <= reach && !found; j++)
                            for (i = -reach; i <= reach && !found; i++) {
                                int32_t u = (int32_t)x + i, v = (int32_t)y + j;
                                if (u < 0 || v < 0 || u >= 130 || v >= 110) continue;
                                found = (hit_at(&full, (uint32_t)u, (uint32_t)v)->node != VOXRT_NO_NODE) == here;
                            }
                        if (there) lost++;
                        else stray += !found;
                    }
                }
            CHECK_EQ_U64(coarse, 0);
            CHECK_EQ_U64(fine, 0);
            CHECK_MSG(lost == 0, "%u pixels lost", lost); /* a coarse cell covers all that is in it */
            CHECK_MSG(stray == 0, "%u pixels are more than %d pixels outside", stray, reach);
            if (k == 2 && e > 1) CHECK(finer > 100);
        }
    }
    voxrt_tree_destroy(t);
    free_picture(&p);
    free_picture(&full);
}

/* Balls, slabs and loose cells at random in 2^depth cells, the whole 2 wide. */
static voxrt_tree *make_random(test_rng *r, uint32_t depth) {
    const uint32_t n = 1u << depth, parts = 1 + test_rng_below(r, 6);
    cells c;
    uint32_t part, i;
    memset(&c, 0, sizeof c);
    for (part = 0; part < parts; part++) {
        const uint32_t kind = test_rng_below(r, 3), count = kind == 0 ? n * n / 2 : n * 4;
        uint32_t a, from[3], to[3];
        double radius = 0.45 * n * test_rng_double(r);
        for (a = 0; a < 3; a++) {
            from[a] = test_rng_below(r, n);
            to[a] = from[a] + 1 + test_rng_below(r, n / 4);
            to[a] = to[a] < n ? to[a] : n;
        }
        if (kind == 1) render_add_box(&c, from[0], from[1], from[2], to[0], to[1], to[2]);
        for (i = 0; i < count && kind != 1; i++) {
            double p[3], length = 0;
            for (a = 0; a < 3; a++) {
                p[a] = kind == 0 ? test_rng_double(r) - 0.5 : n * test_rng_double(r);
                length += p[a] * p[a];
            }
            for (a = 0; a < 3 && kind == 0; a++) p[a] = from[a] + radius * p[a] / sqrt(length + 1e-9);
            for (a = 0; a < 3 && p[a] >= 0 && p[a] < n; a++) {}
            if (a == 3) (void)render_add(&c, (uint32_t)p[0], (uint32_t)p[1], (uint32_t)p[2], 255, (int)(i % 256), 0);
        }
    }
    (void)render_add(&c, n / 2, n / 3, n / 4, 0, 0, 255);
    return render_make_tree(&c, depth, 2.0, 0);
}

/* The same of 240 random scenes, cameras (a few of them among the voxels) and tolerances. */
TEST(tolerance_of_random_scenes) {
    enum { W = 72, H = 54 };
    const uint32_t count = test_quick() ? 40 : 240;
    render_picture p = make_picture(W, H, 0, 0), full = make_picture(W, H, 0, 0);
    uint32_t k, x, y, hits = 0, levels = 0, outlines = 0;
    for (k = 0; k < count; k++) {
        test_rng r = test_rng_make(9000 + k);
        voxrt_tree *t = make_random(&r, 4 + k % 4);
        const double distance = k % 6 == 5 ? 0.7 : 1.5 * pow(40, test_rng_double(&r)), angle = 6.2831853 * test_rng_double(&r);
        const double high = 2 * test_rng_double(&r) - 1, tolerance = (double)(float)(0.3 * pow(30, test_rng_double(&r)));
        uint32_t wide = 0, fine = 0, lost = 0, behind = 0, stray = 0;
        double pixel;
        voxrt_tree_info info;
        voxrt_render_desc d;
        REQUIRE(t != NULL);
        voxrt_tree_get_info(t, &info);
        memset(&d, 0, sizeof d);
        d.camera = render_look(1 + distance * cos(angle), 1 + distance * high, 1 + distance * sin(angle), 1, 1, 1,
                        (float)(distance < 3 ? 40 + 20 * test_rng_double(&r) : 150 / distance));
        pixel = 2 * tan((double)d.camera.fov_y * 0.00872664626) / H;
        CHECK(voxrt_render(&d, t, &full.m, NULL) == VOXRT_OK);
        d.tolerance = (float)tolerance;
        CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
        for (y = 0; y < H; y++)
            for (x = 0; x < W; x++) {
                const voxrt_hit *h = hit_at(&p, x, y), *f = hit_at(&full, x, y);
                const int here = h->node != VOXRT_NO_NODE, there = f->node != VOXRT_NO_NODE;
                if (here) {
                    const double edge = info.voxel_size * (double)(1u << (info.depth - h->level));
                    wide += h->level < info.depth && edge > tolerance * pixel * (double)h->t * 1.0001;
                    fine += 2 * edge < tolerance * pixel * ((double)h->t - 2 * 1.7321 * edge) * 0.9999;
                    levels += h->level < info.depth;
                    hits++;
                }
                lost += there && !here;
                behind += there && here && (double)h->t > (double)f->t * 1.00001 + 1e-6;
                if (here == there || there) continue;
                /* beside the outline: a cell that holds a voxel, no further from it than the cell is wide */
                stray += !voxrt_tree_get(t, h->level, h->cell[0], h->cell[1], h->cell[2], NULL);
                outlines++;
            }
        CHECK_MSG(wide == 0 && fine == 0 && lost == 0 && behind == 0 && stray == 0, "scene %u, tolerance %g: %u wide, %u fine, %u lost, %u behind, %u stray",
                  k, tolerance, wide, fine, lost, behind, stray);
        voxrt_tree_destroy(t);
    }
    if (test_g.verbose) printf("%u hits, %u on larger cells, %u beside\n", hits, levels, outlines);
    CHECK(hits > 100 * count && levels > hits / 4 && outlines > 10 * count);
    free_picture(&p);
    free_picture(&full);
}

TEST(object_level) { /* the coarsest level with size / 2^level <= q e, e: width of a pixel at the box's nearest point */
    voxrt_tree *t = render_make_sphere(6, 0.9);
    voxrt_tree_info info;
    render_picture p = make_picture(64, 64, 0, 0);
    uint32_t k, levels = 0, last = 99;
    double box_min[3], box_max[3];
    voxrt_tree_get_info(t, &info);
    voxrt_tree_bounds(t, box_min, box_max);
    for (k = 0; k < 30; k++) {
        double far_away = 1.5 * pow(1.35, k), e, dist = 0, want;
        voxrt_render_desc d;
        const voxrt_hit *h = hit_at(&p, 32, 32);
        uint32_t a;
        memset(&d, 0, sizeof d);
        d.object_lod = 1;
        d.tolerance = k % 3 == 0 ? 0.0f : 0.7f * (float)(k % 3);
        d.camera = render_look(1 + far_away, 1.01, 1.02, 1, 1.01, 1.02, 50);
        CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
        for (a = 0; a < 3; a++) {
            double low = box_min[a] - (double)d.camera.eye[a], high = (double)d.camera.eye[a] - box_max[a];
            low = low > high ? low : high;
            dist += low > 0 ? low * low : 0;
        }
        e = 2 * tan(25 * 0.0174532925) / 64 * sqrt(dist);
        want = ceil(log2(2.0 / ((d.tolerance > 0 ? (double)d.tolerance : 1.0) * e)));
        want = want < 0 ? 0 : want > info.depth ? info.depth : want;
        if (h->node == VOXRT_NO_NODE) continue;
        CHECK_EQ_U64(h->level, want);
        levels += h->level != last;
        last = h->level;
    }
    CHECK(levels > 4);
    voxrt_tree_destroy(t);
    free_picture(&p);
}

/* ---- same bits --------------------------------------------------------------------------------------------- */

static void backwards(voxrt_task_fn *task, void *ctx, uint32_t count, void *user) {
    (void)user;
    while (count > 0) task(ctx, --count);
}

TEST(threads_tiles_isa) {
    static const uint32_t threads[5] = {1, 2, 3, 8, 64};
    voxrt_tree *t = render_make_sphere(6, 0.9);
    uint32_t k, mode;
    for (mode = 0; mode < 3; mode++) {
        voxrt_render_desc d;
        uint64_t first = 0;
        memset(&d, 0, sizeof d);
        d.shadows = 1;
        d.samples = mode == 0 ? 1 : 3;
        d.tolerance = mode == 2 ? 1.5f : 0.0f;
        for (k = 0; k < 11; k++) {
            render_picture p = make_picture(133, 75, k == 4 ? 20 : 0, k & 1u);
            voxrt_render_stats stats;
            uint64_t h;
            memset(&stats, 0, sizeof stats);
            memset(&d.env, 0, sizeof d.env);
            d.isa = VOXRT_ISA_AUTO;
            if (k < 5) d.env.thread_count = threads[k];
            else if (k == 5) d.env.parallel.for_fn = backwards;
            else if (k < 10) d.isa = (voxrt_isa)(k - 5);
            CHECK(voxrt_render(&d, t, &p.m, k == 10 ? &stats : NULL) == VOXRT_OK);
            h = hash_picture(&p);
            if (k == 0) first = h;
            CHECK_MSG(h == first, "mode %u, way %u: another picture", mode, k);
            if (k == 10) CHECK(stats.primary.rays == 133u * 75u * d.samples && stats.primary.hits > 1000);
            free_picture(&p);
        }
    }
    voxrt_tree_destroy(t);
}

/* A picture is what its rays meet one by one, also with level of detail: runs of rays must not change anything. */
TEST(single_rays) {
    voxrt_tree *t = render_make_sphere(6, 0.9);
    uint32_t mode, x, y;
    for (mode = 0; mode < 12; mode++) {
        render_picture p = make_picture(70, 50, 0, 0);
        voxrt_render_desc d;
        voxrt_trace_desc td;
        voxrti_frame f;
        uint32_t differ = 0;
        memset(&d, 0, sizeof d);
        memset(&td, 0, sizeof td);
        d.camera = mode & 1u ? render_look(3.1, 2.3, 4.2, 1, 1.05, 0.95, 40) : render_look(-7, 0.5, -9, 1, 1, 1, 15);
        if (mode < 8) td.max_level_plus_1 = d.max_level_plus_1 = mode; /* 0: all, 1: the root, ... */
        else d.tolerance = 0.4f * (float)(mode - 7) * (float)(mode - 7);
        CHECK(voxrti_frame_open(&d.camera, 50, &f) == VOXRT_OK);
        td.cone_spread = (float)((double)d.tolerance * f.pixel);
        td.isa = VOXRT_ISA_SCALAR;
        CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
        for (y = 0; y < 50; y++)
            for (x = 0; x < 70; x++) {
                voxrt_ray r;
                voxrt_hit h;
                CHECK(voxrt_camera_ray(&d.camera, 70, 50, x + 0.5, y + 0.5, &r) == VOXRT_OK);
                CHECK(voxrt_trace(t, &td, &r, &h, 1) == VOXRT_OK);
                differ += memcmp(&h, hit_at(&p, x, y), sizeof h) != 0;
            }
        CHECK_MSG(differ == 0, "mode %u: %u pixels differ from their rays", mode, differ);
        free_picture(&p);
    }
    voxrt_tree_destroy(t);
}

TEST(progressive) {
    voxrt_tree *t = render_make_sphere(6, 0.9);
    render_picture p = make_picture(75, 66, 0, 1), q = make_picture(75, 66, 0, 0), ref = make_picture(75, 66, 0, 0);
    voxrt_render_desc d;
    uint32_t k, x, y, a, partial = 0;
    double error[2] = {0, 0}, last = 0;
    memset(&d, 0, sizeof d);
    d.shadows = 1;
    d.samples = 400;
    CHECK(voxrt_render(&d, t, &ref.m, NULL) == VOXRT_OK);
    for (k = 0; k < 33; k++) {
        d.samples = 1;
        d.first_sample = k;
        CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
        if (k != 0 && k != 6 && k != 32) continue;
        d.samples = k + 1;
        d.first_sample = 0;
        CHECK(voxrt_render(&d, t, &q.m, NULL) == VOXRT_OK);
        CHECK_MSG(hash_picture(&p) == hash_picture(&q), "%u passes differ from %u samples", k + 1, k + 1);
        error[0] = 0;
        for (y = 0; y < 66; y++)
            for (x = 0; x < 75; x++) {
                for (a = 0; a < 4; a++) error[0] += pow((double)fpx(&q, x, y)[a] - (double)fpx(&ref, x, y)[a], 2);
                partial += fpx(&q, x, y)[3] > 0 && fpx(&q, x, y)[3] < 1;
            }
        if (k != 0) CHECK_MSG(error[0] < last / 3, "error %g after %g", error[0], last);
        last = error[0];
    }
    CHECK(partial > 100);
    /* alpha counts the samples that hit */
    d.samples = 8;
    CHECK(voxrt_render(&d, t, &q.m, NULL) == VOXRT_OK);
    for (y = 0; y < 66; y++)
        for (x = 0; x < 75; x++) {
            CHECK(fpx(&q, x, y)[3] * 8 == floorf(fpx(&q, x, y)[3] * 8));
            CHECK(px(&q, x, y)[3] == (int)(fpx(&q, x, y)[3] * 255 + 0.5f));
        }
    voxrt_tree_destroy(t);
    free_picture(&p);
    free_picture(&q);
    free_picture(&ref);
}

/* ---- views, background, stages ----------------------------------------------------------------------------- */

TEST(views) {
    voxrt_tree *t = render_make_sphere(5, 0.9);
    render_picture p[5];
    voxrt_render_desc d;
    uint32_t k, x, y, wrong = 0;
    memset(&d, 0, sizeof d);
    d.camera = render_look(4, 3, 5, 1, 1, 1, 30);
    for (k = 0; k < 4; k++) {
        p[k] = make_picture(100, 40, 0, 0);
        d.view = (voxrt_view)k; /* shaded, unlit, light, split */
        CHECK(voxrt_render(&d, t, &p[k].m, NULL) == VOXRT_OK);
    }
    for (y = 0; y < 40; y++)
        for (x = 0; x < 100; x++) {
            uint32_t from = x * 3 < 100 ? 1 : x * 3 < 200 ? 0 : 2;
            wrong += memcmp(px(&p[3], x, y), px(&p[from], x, y), 4) != 0;
        }
    CHECK_EQ_U64(wrong, 0);
    /* two levels side by side */
    p[4] = make_picture(100, 40, 0, 0);
    d.view = VOXRT_VIEW_SHADED;
    d.lod_split = 4;
    CHECK(voxrt_render(&d, t, &p[4].m, NULL) == VOXRT_OK);
    d.lod_split = 0;
    d.max_level_plus_1 = 4;
    CHECK(voxrt_render(&d, t, &p[3].m, NULL) == VOXRT_OK);
    for (y = 0; y < 40; y++)
        for (x = 0; x < 100; x++) wrong += memcmp(px(&p[4], x, y), px(&p[x < 50 ? 3 : 0], x, y), 4) != 0;
    CHECK_EQ_U64(wrong, 0);
    /* background, also under a partly covered pixel */
    d.max_level_plus_1 = 0;
    d.samples = 4;
    CHECK(voxrt_render(&d, t, &p[3].m, NULL) == VOXRT_OK);
    d.background[0] = 0.25f;
    d.background[1] = 0.5f;
    d.background[3] = 1;
    CHECK(voxrt_render(&d, t, &p[4].m, NULL) == VOXRT_OK);
    for (y = 0; y < 40; y++)
        for (x = 0; x < 100; x++) {
            const float *a = fpx(&p[3], x, y), *b = fpx(&p[4], x, y);
            CHECK(b[3] == 1 && px(&p[4], x, y)[3] == 255);
            CHECK_NEAR(b[0], (double)a[0] + (1 - (double)a[3]) * 0.25, 1e-6);
            CHECK_NEAR(b[1], (double)a[1] + (1 - (double)a[3]) * 0.5, 1e-6);
        }
    /* the same background whatever the way to compose; bytes and floats are the same picture */
    d.thesis_compose = 1;
    d.samples = 1;
    CHECK(voxrt_render(&d, t, &p[3].m, NULL) == VOXRT_OK);
    CHECK(px(&p[3], 0, 0)[0] == px(&p[4], 0, 0)[0] && px(&p[3], 0, 0)[1] == px(&p[4], 0, 0)[1]);
    memcpy(p[4].m.rgba, p[3].m.rgba, p[3].m.rgba_stride * 40);
    CHECK(voxrt_image_encode(NULL, &p[4].m) == VOXRT_OK);
    for (y = 0; y < 40; y++)
        for (x = 0; x < 400; x++) wrong += abs((int)px(&p[4], 0, y)[x] - (int)px(&p[3], 0, y)[x]) > 1;
    CHECK_EQ_U64(wrong, 0);
    for (k = 0; k < 5; k++) free_picture(&p[k]);
    voxrt_tree_destroy(t);
}

TEST(heat) {
    voxrt_tree *t = render_make_sphere(6, 0.9);
    render_picture p[2];
    voxrt_render_desc d;
    uint32_t k, x, y, seen[5] = {0, 0, 0, 0, 0};
    memset(&d, 0, sizeof d);
    d.camera = render_look(4, 3, 5, 1, 1, 1, 30);
    d.heat_max = 20;
    for (k = 0; k < 2; k++) {
        p[k] = make_picture(60, 40, 0, 0);
        d.view = k == 0 ? VOXRT_VIEW_HEAT_OUTER : VOXRT_VIEW_HEAT_INNER;
        CHECK(voxrt_render(&d, t, &p[k].m, NULL) == VOXRT_OK);
    }
    for (y = 0; y < 40; y++)
        for (x = 0; x < 60; x++) {
            voxrt_ray r;
            voxrt_hit h;
            voxrt_stats s;
            voxrt_trace_desc td;
            const float *a = fpx(&p[0], x, y), *b = fpx(&p[1], x, y);
            double hot;
            uint32_t band;
            memset(&s, 0, sizeof s);
            memset(&td, 0, sizeof td);
            td.stats = &s;
            td.isa = VOXRT_ISA_SCALAR;
            CHECK(voxrt_camera_ray(&d.camera, 60, 40, x + 0.5, y + 0.5, &r) == VOXRT_OK);
            CHECK(voxrt_trace(t, &td, &r, &h, 1) == VOXRT_OK);
            hot = 1 - (double)s.steps / 20;
            CHECK(a[0] == 1 && a[3] == 1);
            CHECK_NEAR(a[1], hot > 0 ? hot : 0, 1e-6);
            band = s.descents > 120 ? 4 : s.descents > 80 ? 3 : s.descents > 40 ? 2 : s.descents > 15 ? 1 : 0;
            seen[band]++;
            if (band == 0) CHECK(b[0] == 1 && b[1] == 1 && b[2] == 1);
            if (band == 1) CHECK(b[0] == 0 && b[1] > 0 && b[2] == 0); /* green */
            if (band == 2) CHECK(b[0] == 1 && b[1] == 1 && b[2] == 0); /* yellow */
        }
    CHECK(seen[0] > 0);
    for (k = 0; k < 2; k++) { /* the left half of a coarse picture; rays are counted */
        voxrt_render_stats stats;
        memset(&stats, 0, sizeof stats);
        d.view = VOXRT_VIEW_HEAT_OUTER;
        d.max_level_plus_1 = k == 0 ? 5 : 0;
        d.lod_split = k == 0 ? 0 : 5;
        CHECK(voxrt_render(&d, t, &p[k].m, &stats) == VOXRT_OK);
        CHECK_EQ_U64(stats.primary.rays, 60 * 40);
        CHECK(stats.primary.hits > 100 && stats.primary.hits < 60 * 40 && stats.primary.steps > 100);
        CHECK_EQ_U64(stats.shadow.rays + stats.bounce.rays, 0);
    }
    for (y = 0; y < 40; y++) CHECK(memcmp(fpx(&p[0], 0, y), fpx(&p[1], 0, y), 30 * 16) == 0);
    for (y = 0, k = 0; y < 40; y++) k += memcmp(fpx(&p[0], 30, y), fpx(&p[1], 30, y), 30 * 16) != 0;
    CHECK(k > 10);
    for (k = 0; k < 2; k++) free_picture(&p[k]);
    voxrt_tree_destroy(t);
}

TEST(stages) {
    voxrt_tree *t = render_make_sphere(5, 0.9);
    uint32_t k, x, y, hits[4] = {0, 0, 0, 0};
    for (k = 0; k < 4; k++) {
        render_picture p = make_picture(60, 40, 0, 0);
        voxrt_render_desc d;
        voxrt_render_stats stats;
        memset(&d, 0, sizeof d);
        memset(&stats, 0, sizeof stats);
        d.stage = (voxrt_stage)k;
        CHECK(voxrt_render(&d, t, &p.m, &stats) == VOXRT_OK);
        for (y = 0; y < 40; y++)
            for (x = 0; x < 60; x++) hits[k] += px(&p, x, y)[3] == 255;
        if (k == VOXRT_STAGE_SETUP) CHECK(stats.primary.rays == 2400 && stats.primary.steps == 0);
        d.no_compose = 1;
        memset(p.m.rgba8, 7, 60 * 40 * 4);
        CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
        for (x = 0; x < 60 * 40 * 4; x++) CHECK(p.m.rgba8[x] == 7);
        free_picture(&p);
    }
    CHECK(hits[VOXRT_STAGE_FULL] > 300 && hits[VOXRT_STAGE_TRACE] == hits[VOXRT_STAGE_FULL]);
    CHECK(hits[VOXRT_STAGE_RAYS] == 0 && hits[VOXRT_STAGE_SETUP] == 0);
    voxrt_tree_destroy(t);
}

/* ---- several trees ----------------------------------------------------------------------------------------- */

TEST(geometry) { /* two trees drawn together are the picture of one tree with all voxels */
    cells c[3];
    voxrt_tree *t[3];
    voxrt_geometry g[2];
    voxrt_render_desc d;
    render_picture p = make_picture(90, 70, 0, 0), q = make_picture(90, 70, 0, 0);
    test_rng rng = test_rng_make(3);
    uint32_t i, k, x, y;
    memset(c, 0, sizeof c);
    for (i = 0; i < 400; i++) {
        uint32_t at[3], a;
        for (a = 0; a < 3; a++) at[a] = test_rng_below(&rng, 16);
        k = (at[0] ^ at[1] ^ at[2]) & 1u;
        (void)render_add(&c[k], at[0], at[1], at[2], (int)at[0] * 16, (int)at[1] * 16, (int)at[2] * 16);
        (void)render_add(&c[2], at[0], at[1], at[2], (int)at[0] * 16, (int)at[1] * 16, (int)at[2] * 16);
    }
    for (i = 0; i < 3; i++) t[i] = render_make_tree(&c[i], 4, 0, 0);
    memset(&d, 0, sizeof d);
    d.shadows = 1;
    d.camera = render_look(30, 25, 40, 8, 8, 8, 30);
    CHECK(voxrt_render(&d, t[2], &p.m, NULL) == VOXRT_OK);
    for (k = 0; k < 2; k++) {
        uint32_t differ = 0;
        voxrt_tree_geometry(t[0], &g[0]);
        voxrt_tree_geometry(t[1], &g[1]);
        d.geometry = k == 0 ? g + 1 : g;
        d.geometry_count = k == 0 ? 1 : 2;
        CHECK(voxrt_render(&d, k == 0 ? t[0] : NULL, &q.m, NULL) == VOXRT_OK);
        for (y = 0; y < 70; y++)
            for (x = 0; x < 90; x++) {
                differ += memcmp(px(&p, x, y), px(&q, x, y), 4) != 0;
                differ += depth_at(&p, x, y) != depth_at(&q, x, y);
            }
        CHECK_EQ_U64(differ, 0);
    }
    memset(&d.camera, 0, sizeof d.camera); /* framed without a tree */
    CHECK(voxrt_render(&d, NULL, &q.m, NULL) == VOXRT_OK);
    g[0].occluded_fn = NULL;
    CHECK(voxrt_render(&d, NULL, &q.m, NULL) == VOXRT_ERR_INVALID_ARG);
    for (i = 0; i < 3; i++) voxrt_tree_destroy(t[i]);
    free_picture(&p);
    free_picture(&q);
}

TEST(thesis_path) { /* the octree of 2009 shows the same surface but for its few wrong voxels */
    voxrt_tree *t = render_make_sphere(6, 0.9);
    voxrt_octree *o = NULL;
    voxrt_octree_desc od;
    voxrt_geometry g;
    voxrt_render_desc d;
    voxrt_render_stats stats;
    render_picture p = make_picture(120, 90, 0, 0), q = make_picture(120, 90, 0, 0);
    uint32_t x, y, hits = 0, differ = 0;
    memset(&od, 0, sizeof od);
    memset(&d, 0, sizeof d);
    memset(&stats, 0, sizeof stats);
    CHECK(voxrt_octree_from_tree(&od, t, &o) == VOXRT_OK);
    REQUIRE(o != NULL);
    d.shadows = 1;
    d.camera = render_look(3.1, 2.3, 4.2, 1, 1.05, 0.95, 40);
    CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
    voxrt_octree_geometry(o, &g);
    d.geometry = &g;
    d.geometry_count = 1;
    CHECK(voxrt_render(&d, NULL, &q.m, &stats) == VOXRT_OK);
    for (y = 0; y < 90; y++)
        for (x = 0; x < 120; x++) {
            uint32_t a, bad = 0;
            hits += px(&p, x, y)[3] != 0;
            for (a = 0; a < 4; a++) bad |= abs((int)px(&p, x, y)[a] - (int)px(&q, x, y)[a]) > 4; /* 0.8 degrees */
            differ += bad;
        }
    CHECK_MSG(differ * 50 <= hits, "%u of %u pixels differ", differ, hits);
    CHECK(stats.primary.rays == 120 * 90 && stats.primary.steps > 0 && stats.shadow.rays > 0);
    voxrt_octree_destroy(o);
    voxrt_tree_destroy(t);
    free_picture(&p);
    free_picture(&q);
}

/* ---- edges ------------------------------------------------------------------------------------------------- */

static int cancel_fn(void *user, uint64_t done, uint64_t total) {
    uint32_t *calls = (uint32_t *)user;
    CHECK(done <= total);
    return ++*calls == 2;
}

TEST(edges) {
    static const uint32_t size[6][2] = {{0, 0}, {1, 1}, {0, 5}, {5, 0}, {1, 77}, {77, 1}};
    voxrt_tree *t = render_make_sphere(4, 0.9);
    voxrt_render_desc d;
    voxrt_light light;
    render_picture p = make_picture(33, 100, 0, 0);
    uint32_t k, calls = 0;
    memset(&d, 0, sizeof d);
    memset(&light, 0, sizeof light);
    for (k = 0; k < 6; k++) {
        render_picture q = make_picture(size[k][0], size[k][1], 0, 1);
        d.shadows = 1;
        d.samples = 2;
        CHECK(voxrt_render(&d, t, &q.m, NULL) == VOXRT_OK);
        if (k == 1) CHECK(px(&q, 0, 0)[3] > 0);
        d.view = VOXRT_VIEW_SPLIT;
        d.lod_split = 1;
        CHECK(voxrt_render(&d, t, &q.m, NULL) == VOXRT_OK);
        d.view = VOXRT_VIEW_SHADED;
        d.lod_split = 0;
        CHECK(voxrt_blur(NULL, &q.m) == VOXRT_OK);
        free_picture(&q);
    }
    memset(&d, 0, sizeof d);
    d.lights = &light;
    d.light_count = 1;
    set3(light.color, 1, 1, 1);
    light.directional = 1; /* no direction: no light */
    CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
    d.lights = NULL;
    d.light_count = 0;
    d.env.progress_fn = cancel_fn;
    d.env.progress_user = &calls;
    CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_ERR_CANCELLED);
    CHECK_EQ_U64(calls, 2);
    d.env.progress_fn = NULL;
    d.camera = render_look(1, 1, 1, 5, 1, 1, 40); /* from inside, and away */
    CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
    CHECK(depth_at(&p, 16, 50) > 0.5f && depth_at(&p, 16, 50) < 1.0f);
    d.camera = render_look(9, 1, 1, 50, 1, 1, 40);
    CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
    CHECK(depth_at(&p, 16, 50) == INFINITY);
    d.camera = render_look(1.9, 1, 1, 1, 1, 1, 40); /* eye within a voxel */
    CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
    voxrt_tree_destroy(t);
    free_picture(&p);
}

TEST(render_refusals) {
    voxrt_tree *t = render_make_sphere(4, 0.9);
    voxrt_render_desc d;
    voxrt_light light;
    voxrt_image empty;
    voxrt_error error;
    uint32_t k;
    memset(&d, 0, sizeof d);
    memset(&light, 0, sizeof light);
    d.shadows = 1;
    d.samples = 2;
    memset(&empty, 0, sizeof empty); /* no buffer at all */
    empty.width = 40;
    empty.height = 30;
    CHECK(voxrt_render(&d, t, &empty, NULL) == VOXRT_OK);
    CHECK(voxrt_render(&d, NULL, &empty, NULL) == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_render(&d, t, NULL, NULL) == VOXRT_ERR_INVALID_ARG);
    d._begin_zero = 1;
    CHECK(voxrt_render(&d, t, &empty, NULL) == VOXRT_ERR_UNINIT_DESC);
    memset(&d, 0, sizeof d);
    d._end_zero = 1;
    CHECK(voxrt_render(&d, t, &empty, NULL) == VOXRT_ERR_UNINIT_DESC);
    memset(&d, 0, sizeof d);
    memset(&error, 0, sizeof error);
    d.env.error = &error;
    CHECK(voxrt_render(&d, t, NULL, NULL) == VOXRT_ERR_INVALID_ARG && error.code == VOXRT_ERR_INVALID_ARG);
    CHECK(voxrt_render(&d, t, &empty, NULL) == VOXRT_OK && error.code == VOXRT_OK); /* what was wrong is forgotten */
    d.tolerance = -1;
    CHECK(voxrt_render(&d, t, &empty, NULL) == VOXRT_ERR_INVALID_ARG);
    CHECK(error.code == VOXRT_ERR_INVALID_ARG && error.text[0] != 0);
    d.tolerance = NAN;
    CHECK(voxrt_render(&d, t, &empty, NULL) == VOXRT_ERR_INVALID_ARG);
    d.tolerance = 0;
    d.view = (voxrt_view)7;
    CHECK(voxrt_render(&d, t, &empty, NULL) == VOXRT_ERR_INVALID_ARG);
    d.view = VOXRT_VIEW_SHADED;
    d.light_count = 1;
    CHECK(voxrt_render(&d, t, &empty, NULL) == VOXRT_ERR_INVALID_ARG);
    d.lights = &light;
    light.color[1] = NAN;
    CHECK(voxrt_render(&d, t, &empty, NULL) == VOXRT_ERR_INVALID_ARG);
    CHECK(strstr(error.text, "colour of a light") != NULL);
    light.color[1] = 1e13f;
    CHECK(voxrt_render(&d, t, &empty, NULL) == VOXRT_ERR_INVALID_ARG);
    light.color[1] = 0;
    for (k = 0; k < 12; k++) { /* one number of the material or the background is bad */
        static const float bad[2] = {NAN, -INFINITY};
        voxrt_material m;
        float *one = (float *)&m;
        memset(&m, 0, sizeof m);
        one[k < 6 ? k : 0] = k < 6 ? bad[k & 1] : 0.5f;
        if (k >= 6 && k < 10) d.background[k - 6] = k & 1 ? INFINITY : 2e12f;
        if (k == 10) one[5] = -1; /* shininess */
        if (k == 11) one[3] = -1e13f;
        d.material = &m;
        memset(&error, 0, sizeof error);
        CHECK(voxrt_render(&d, t, &empty, NULL) == VOXRT_ERR_INVALID_ARG && error.text[0] != 0);
        memset(d.background, 0, sizeof d.background);
        d.material = NULL;
    }
    d.camera.eye[0] = NAN;
    CHECK(voxrt_render(&d, t, &empty, NULL) == VOXRT_ERR_INVALID_ARG && strstr(error.text, "camera") != NULL);
    voxrt_tree_destroy(t);
}

/* Highlights: the sharper the darker, and never above 1. */
static void sharper_is_darker(const voxrt_tree *t, render_picture *q) {
    static const float sharp[5] = {1, 30, 300, 2000, 1e9f};
    voxrt_render_desc d;
    voxrt_light light;
    voxrt_material m;
    double before = 1e9;
    uint32_t k, x, bad = 0;
    memset(&d, 0, sizeof d);
    memset(&light, 0, sizeof light);
    memset(&m, 0, sizeof m);
    set3(light.color, 1, 1, 1);
    set3(light.position, 1, 3, 2);
    d.lights = &light;
    d.light_count = 1;
    d.material = &m;
    m.specular = 1;
    d.camera = render_look(4, 3, 4, 1, 1, 1, 40);
    d.samples = 1;
    for (k = 0; k < 5; k++) {
        double sum = 0;
        m.shininess = sharp[k];
        CHECK(voxrt_render(&d, t, &q->m, NULL) == VOXRT_OK);
        for (x = 0; x < 40 * 30 * 4; x += 4) {
            bad += !(q->m.rgba[x] >= 0 && q->m.rgba[x] <= 1);
            sum += (double)q->m.rgba[x];
        }
        CHECK(sum <= before && (k > 1 || sum > 0));
        before = sum;
    }
    CHECK_EQ_U64(bad, 0);
}

/* A light so far from a surface so far away that no float holds the way: dark, but a number. */
static void light_from_far(void) {
    render_picture q = make_picture(20, 15, 0, 1);
    voxrt_render_desc d;
    voxrt_light light;
    voxrt_voxel v;
    voxrt_build_desc b;
    voxrt_tree *far_tree = NULL;
    uint32_t x, bad = 0, hits = 0;
    memset(&v, 0, sizeof v);
    memset(&b, 0, sizeof b);
    memset(&d, 0, sizeof d);
    memset(&light, 0, sizeof light);
    d.lights = &light;
    d.light_count = 1;
    v.has_normal = 1;
    v.normal[1] = 1;
    v.rgb[0] = 255;
    b.box_size = 1e38;
    b.box_min[1] = -2e38;
    CHECK(voxrt_tree_from_voxels(&b, &v, 1, 2, &far_tree) == VOXRT_OK);
    set3(light.position, 0, 3.4e38, 0);
    set3(light.color, 1, 1, 1);
    CHECK(voxrt_render(&d, far_tree, &q.m, NULL) == VOXRT_OK);
    for (x = 0; x < 20 * 15 * 4; x++) bad += !(fabsf(q.m.rgba[x]) <= 1.0f);
    for (x = 3; x < 20 * 15 * 4; x += 4) hits += q.m.rgba[x] > 0;
    CHECK(bad == 0 && hits > 20);
    voxrt_tree_destroy(far_tree);
    free_picture(&q);
}

/* The most that is allowed: nothing overflows, also where it is blurred. */
TEST(largest_numbers) {
    voxrt_tree *t = render_make_sphere(4, 0.9);
    render_picture q = make_picture(40, 30, 0, 1);
    voxrt_render_desc d;
    voxrt_light light;
    voxrt_material m;
    uint32_t x, bad = 0;
    memset(&d, 0, sizeof d);
    memset(&light, 0, sizeof light);
    d.lights = &light;
    d.light_count = 1;
    set3(m.ambient, 1e12, -1e12, 1e12);
    m.diffuse = m.specular = 1e12f;
    m.shininess = 1e12f;
    set3(light.color, 1e12, 1e12, -1e12);
    set3(light.position, 1, 3, 2);
    d.material = &m;
    d.samples = 7;
    set3(d.background, 1e12, -1e12, 1e12);
    CHECK(voxrt_render(&d, t, &q.m, NULL) == VOXRT_OK && voxrt_blur(NULL, &q.m) == VOXRT_OK);
    for (x = 0; x < 40 * 30 * 4; x++) bad += !(fabsf(q.m.rgba[x]) <= 1e38f);
    CHECK_EQ_U64(bad, 0);
    sharper_is_darker(t, &q);
    light_from_far();
    free_picture(&q);
    voxrt_tree_destroy(t);
}

TEST(allocations) { /* drawing takes none; blur fails cleanly */
    voxrt_tree *t = render_make_sphere(4, 0.9);
    test_alloc ta;
    voxrt_render_desc d;
    voxrt_blur_desc b;
    render_picture p = make_picture(50, 50, 0, 1);
    uint64_t before;
    test_alloc_init(&ta);
    memset(&d, 0, sizeof d);
    memset(&b, 0, sizeof b);
    d.env.allocator.alloc_fn = test_alloc_fn;
    d.env.allocator.free_fn = test_free_fn;
    d.env.allocator.user = &ta;
    d.shadows = 1;
    CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
    CHECK_EQ_I64(ta.count, 0);
    b.env = d.env;
    before = hash_picture(&p);
    ta.fail_at = 0;
    CHECK(voxrt_blur(&b, &p.m) == VOXRT_ERR_NO_MEMORY);
    CHECK(hash_picture(&p) == before);
    ta.fail_at = -1;
    b.env.memory_limit = 1000;
    CHECK(voxrt_blur(&b, &p.m) == VOXRT_ERR_NO_MEMORY);
    b.env.memory_limit = 0;
    CHECK(voxrt_blur(&b, &p.m) == VOXRT_OK);
    CHECK(hash_picture(&p) != before);
    test_alloc_check(&ta);
    voxrt_tree_destroy(t);
    free_picture(&p);
}

/* ---- post -------------------------------------------------------------------------------------------------- */

TEST(encode_and_blur) {
    voxrt_error error;
    voxrt_tree *t = render_make_sphere(5, 0.9);
    render_picture p = make_picture(70, 50, 8, 0), q;
    voxrt_render_desc d;
    voxrt_blur_desc b;
    float *before;
    uint8_t *bytes;
    uint32_t x, y, a;
    int32_t i, j;
    memset(&d, 0, sizeof d);
    memset(&b, 0, sizeof b);
    d.samples = 5;
    CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
    bytes = (uint8_t *)malloc(p.m.rgba8_stride * 50);
    REQUIRE(bytes != NULL);
    memcpy(bytes, p.m.rgba8, p.m.rgba8_stride * 50);
    memset(p.m.rgba8, 0xee, p.m.rgba8_stride * 50);
    CHECK(voxrt_image_encode(NULL, &p.m) == VOXRT_OK);
    CHECK(memcmp(bytes, p.m.rgba8, p.m.rgba8_stride * 50) == 0);
    /* the Gauss, directly and in double precision */
    before = (float *)malloc(p.m.rgba_stride * 50);
    REQUIRE(before != NULL);
    memcpy(before, p.m.rgba, p.m.rgba_stride * 50);
    b.radius = 3;
    CHECK(voxrt_blur(&b, &p.m) == VOXRT_OK);
    for (y = 0; y < 50; y += 3)
        for (x = 0; x < 70; x += 2) {
            double sum[4] = {0, 0, 0, 0}, total = 0;
            for (j = -3; j <= 3; j++)
                for (i = -3; i <= 3; i++) {
                    int32_t u = (int32_t)x + i, v = (int32_t)y + j;
                    double w = exp(-(i * i + j * j) / (2 * 1.5 * 1.5));
                    const float *s;
                    if (u < 0 || v < 0 || u >= 70 || v >= 50) continue;
                    s = (const float *)(const void *)((const uint8_t *)before + p.m.rgba_stride * (uint32_t)v) + 4 * u;
                    for (a = 0; a < 4; a++) sum[a] += w * (double)s[a];
                    total += w;
                }
            for (a = 0; a < 4; a++) CHECK_NEAR(fpx(&p, x, y)[a], sum[a] / total, 1e-5);
        }
    b.radius = 65;
    CHECK(voxrt_blur(&b, &p.m) == VOXRT_ERR_INVALID_ARG);
    b.radius = NAN;
    CHECK(voxrt_blur(&b, &p.m) == VOXRT_ERR_INVALID_ARG);
    free(before);
    free(bytes);
    free_picture(&p);
    /* by voxel size: leaves alone what is sharp enough and never crosses the outline */
    p = make_picture(90, 90, 0, 0);
    q = make_picture(90, 90, 0, 0);
    d.samples = 1;
    for (i = 0; i < 2; i++) {
        uint32_t changed = 0, outline = 0;
        voxrt_tree_info info;
        voxrt_tree_get_info(t, &info);
        d.camera = i == 0 ? render_look(1, 1, 40, 1, 1, 1, 40) : render_look(1, 1, 3.4, 1, 1, 1, 40);
        CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
        CHECK(voxrt_render(&d, t, &q.m, NULL) == VOXRT_OK);
        memset(&b, 0, sizeof b);
        b.radius = 16;
        b.footprint = (float)(2 * tan(20 * 0.0174532925) / 90);
        b.voxel_size = (float)info.voxel_size;
        b.depth = info.depth;
        CHECK(voxrt_blur(&b, &q.m) == VOXRT_OK);
        for (y = 0; y < 90; y++)
            for (x = 0; x < 90; x++) {
                changed += memcmp(fpx(&p, x, y), fpx(&q, x, y), 16) != 0;
                outline += fpx(&p, x, y)[3] != fpx(&q, x, y)[3] && fabsf(fpx(&p, x, y)[3] - fpx(&q, x, y)[3]) > 1e-5f;
            }
        CHECK_EQ_U64(outline, 0);
        CHECK((changed == 0) == (i == 0));
    }
    q.m.hit_stride = 0;
    b.voxel_size = 0;
    CHECK(voxrt_blur(&b, &q.m) == VOXRT_ERR_INVALID_ARG);
    b.env.error = &error;
    CHECK(voxrt_blur(&b, &q.m) == VOXRT_ERR_INVALID_ARG && strstr(error.text, "voxel_size") != NULL);
    CHECK(voxrt_blur(&b, NULL) == VOXRT_ERR_INVALID_ARG && strstr(error.text, "rgba") != NULL);
    bytes = q.m.rgba8;
    q.m.rgba8 = NULL;
    CHECK(voxrt_image_encode(&b.env, &q.m) == VOXRT_ERR_INVALID_ARG && error.code == VOXRT_ERR_INVALID_ARG && error.text[0] != 0);
    q.m.rgba8 = bytes;
    voxrt_tree_destroy(t);
    free_picture(&p);
    free_picture(&q);
}

/* Machines on which a frame takes fixed + cost / step^2 / (tolerance / step)^power ms: the budget is kept soon, is not left
   again, is used, and the best quality comes back when there is time. */
TEST(frame_budget) {
    static const double power[3] = {0.0, 0.15, 1.0}, costs[5] = {8.9, 10.6, 14, 40, 300};
    uint32_t p, c, k;
    for (p = 0; p < 3; p++) {
        for (c = 0; c < 5; c++) {
            voxrt_budget b;
            float tolerance = 0.5f;
            uint32_t over = 0, changes = 0, step = 1;
            double ms = 0;
            memset(&b, 0, sizeof b);
            for (k = 0; k < 200; k++) {
                const double cost = k < 100 ? costs[c] : 4.0;
                ms = 1 + cost / (step * step) * pow(0.5 * step / (double)tolerance, power[p]);
                if (k >= 10 && k < 100) over += ms > 10 * 1.02;
                tolerance = voxrt_budget_update(&b, (float)ms, 10.0f, 0.5f);
                CHECK(b.pixel_step >= 1 && b.pixel_step <= 8);
                CHECK(tolerance >= 0.4999f * (float)b.pixel_step && tolerance <= 64.01f);
                if (k >= 20 && k < 100) changes += b.pixel_step != step;
                step = b.pixel_step;
                if (k == 99) CHECK(ms > (c == 1 || step > 1 ? 1.5 : 8)); /* time that is there is used */
            }
            CHECK_EQ_U64(over, 0);
            CHECK_EQ_U64(changes, 0);
            CHECK_EQ_U64(step, 1);
            CHECK_NEAR(tolerance, 0.5, 1e-3); /* best quality again */
            CHECK(voxrt_budget_update(&b, NAN, 10.0f, 0.5f) == tolerance);
            CHECK(voxrt_budget_update(&b, 10.0f, 0.0f, 0.5f) == tolerance);
        }
    }
    {
        voxrt_budget b;
        memset(&b, 0, sizeof b);
        b.pixel_step = 77; /* not ours */
        CHECK(voxrt_budget_update(&b, 1e30f, 1e-30f, 0.0f) <= 64.0f && b.pixel_step == 8);
        CHECK(voxrt_budget_update(&b, 1.0f, 1.0f, 1e30f) == 64.0f);
    }
}

/* One ray for each block of pixels: the picture is that of an image with fewer pixels, with each pixel as a block. */
TEST(blocks_of_pixels) {
    static const uint32_t sizes[3][2] = {{128, 96}, {64, 64}, {176, 8}};
    voxrt_tree *t = render_make_sphere(6, 0.9);
    uint32_t s, step, k, x, y;
    for (s = 0; s < 3; s++)
        for (step = 2; step <= 8; step *= 2)
            for (k = 0; k < 3; k++) {
                const uint32_t w = sizes[s][0], h = sizes[s][1];
                render_picture p = make_picture(w, h, 4, 1), q = make_picture(w / step, h / step, 0, 1);
                voxrt_render_desc d;
                uint32_t wrong = 0;
                memset(&d, 0, sizeof d);
                d.shadows = 1;
                d.samples = k == 1 ? 5 : 1;
                d.tolerance = k == 2 ? 1.0f : 0.0f;
                d.camera = render_look(3.1, 2.3, 4.2, 1, 1.05, 0.95, 40);
                CHECK(voxrt_render(&d, t, &q.m, NULL) == VOXRT_OK);
                d.pixel_step = step;
                d.tolerance *= (float)step; /* in pixels of this picture */
                CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
                for (y = 0; y < h; y++)
                    for (x = 0; x < w; x++) {
                        wrong += memcmp(px(&p, x, y), px(&q, x / step, y / step), 4) != 0;
                        wrong += memcmp(fpx(&p, x, y), fpx(&q, x / step, y / step), 16) != 0;
                        wrong += depth_at(&p, x, y) != depth_at(&q, x / step, y / step);
                        wrong += memcmp(normal_at(&p, x, y), normal_at(&q, x / step, y / step), 12) != 0;
                        wrong += memcmp(hit_at(&p, x, y), hit_at(&q, x / step, y / step), sizeof(voxrt_hit)) != 0;
                    }
                CHECK_EQ_U64(wrong, 0);
                free_picture(&p);
                free_picture(&q);
            }
    for (step = 1; step <= 9; step++) { /* any size, any step: threads change nothing, each block has one value */
        render_picture p = make_picture(101, 67, 0, 1), q = make_picture(101, 67, 12, 1);
        voxrt_render_desc d;
        voxrt_render_stats stats;
        uint32_t wrong = 0, blocks = 0;
        memset(&d, 0, sizeof d);
        memset(&stats, 0, sizeof stats);
        d.pixel_step = step;
        d.lod_split = step == 3 ? 4 : 0;
        d.camera = render_look(3.1, 2.3, 4.2, 1, 1.05, 0.95, 40);
        d.env.thread_count = 1;
        d.first_sample = 0;
        d.samples = 2;
        CHECK(voxrt_render(&d, t, &p.m, &stats) == (step == 9 ? VOXRT_ERR_INVALID_ARG : VOXRT_OK));
        d.env.thread_count = 3;
        d.samples = 1;
        for (k = 0; k < 2 && step < 9; k++) { /* in two calls */
            d.first_sample = k;
            CHECK(voxrt_render(&d, t, &q.m, NULL) == VOXRT_OK);
        }
        if (step < 9) CHECK_EQ_U64(hash_picture(&p), hash_picture(&q));
        for (y = 0; y < 67 && step < 9; y++)
            for (x = 0; x < 101; x++) {
                const uint32_t half = step == 3 && x >= 50 ? 50 : 0; /* blocks begin again at the split */
                const uint32_t u = half + (x - half) / step * step, v = y / step * step;
                if (step == 3) continue;
                wrong += memcmp(px(&p, x, y), px(&p, u, v), 4) != 0;
                blocks += u == x && v == y;
            }
        if (step < 9 && step != 3) CHECK(wrong == 0 && stats.primary.rays == 2 * blocks);
        free_picture(&p);
        free_picture(&q);
    }
    voxrt_tree_destroy(t);
}

/* ---- the caller's own steps -------------------------------------------------------------------------------- */

typedef struct own_steps {
    voxrt_camera camera;
    uint32_t size, tiles[64 * 64], frames, wrong, bits;
    const voxrt_image *image;
} own_steps;

static void own_ray(void *user, double x, double y, voxrt_ray *ray) { /* a second camera, mirrored */
    own_steps *o = (own_steps *)user;
    voxrt_ray q;
    if (voxrt_camera_ray(&o->camera, o->size, o->size, o->size - x, y, &q) == VOXRT_OK) *ray = q;
}

static void own_shade(void *user, const voxrt_ray *rays, const voxrt_surface *surfaces, const float (*normals)[3],
                      float (*colors)[4], size_t count) { /* red for its face, green for the library's, blue for its depth */
    own_steps *o = (own_steps *)user;
    size_t i;
    if (count < 1 || count > 64) voxrti_atomic_add(&o->wrong, 1u);
    for (i = 0; i < count; i++) {
        const float *n = normals[i];
        if (!(surfaces[i].t < INFINITY)) {
            if (colors[i][3] != 0) voxrti_atomic_add(&o->wrong, 1u);
            continue;
        }
        if (fabsf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2] - 1) > 1e-4f || rays[i].t_max != INFINITY)
            voxrti_atomic_add(&o->wrong, 1u);
        colors[i][0] = (float)surfaces[i].face / 8.0f;
        colors[i][2] = surfaces[i].t / 16.0f;
    }
}

static void own_tile(void *user, const voxrt_image *image, uint32_t x0, uint32_t y0, uint32_t x1, uint32_t y1) {
    own_steps *o = (own_steps *)user;
    uint32_t x, y;
    for (y = y0; y < y1; y++)
        for (x = x0; x < x1; x++) { /* written already */
            o->tiles[y * o->size + x]++;
            if (image != o->image || (image->rgba8[4 * (y * o->size + x) + 3] != 0) != (image->depth[y * o->size + x] < INFINITY))
                voxrti_atomic_add(&o->wrong, 1u);
        }
}

static void own_frame(void *user, const voxrt_image *image) {
    own_steps *o = (own_steps *)user;
    uint32_t i;
    o->frames++;
    for (i = 0; i < o->size * o->size; i++) o->wrong += o->tiles[i] != 1 || image != o->image;
}

TEST(steps_of_the_caller) {
    enum { SIZE = 60 };
    static own_steps o;
    voxrt_tree *t = render_make_sphere(5, 0.9);
    render_picture p = make_picture(SIZE, SIZE, 0, 0), q = make_picture(SIZE, SIZE, 0, 0);
    voxrt_render_desc d;
    voxrt_states s;
    uint32_t k, x, y, differ = 0;
    memset(&d, 0, sizeof d);
    memset(&s, 0, sizeof s);
    memset(&o, 0, sizeof o);
    o.size = SIZE;
    o.camera = render_look(3.1, 2.3, 4.2, 1, 1.05, 0.95, 40);
    o.image = &q.m;
    d.camera = o.camera;
    CHECK(voxrt_render(&d, t, &p.m, NULL) == VOXRT_OK);
    s.user = &o;
    d.states = &s; /* none of them: nothing changes */
    CHECK(voxrt_render(&d, t, &q.m, NULL) == VOXRT_OK);
    CHECK_EQ_U64(hash_picture(&p), hash_picture(&q));
    s.ray_fn = own_ray;
    s.tile_fn = own_tile;
    s.frame_fn = own_frame;
    for (k = 1; k < 4; k++) { /* threads */
        memset(o.tiles, 0, sizeof o.tiles);
        d.env.thread_count = k;
        CHECK(voxrt_render(&d, t, &q.m, NULL) == VOXRT_OK);
    }
    CHECK_EQ_U64(o.frames, 3);
    for (y = 0; y < SIZE; y++)
        for (x = 0; x < SIZE; x++)
            differ += memcmp(px(&p, x, y), px(&q, SIZE - 1 - x, y), 4) != 0 || depth_at(&p, x, y) != depth_at(&q, SIZE - 1 - x, y);
    CHECK_EQ_U64(differ, 0);
    memset(&s, 0, sizeof s);
    s.user = &o;
    s.shade_fn = own_shade;
    CHECK(voxrt_render(&d, t, &q.m, NULL) == VOXRT_OK);
    for (y = 0, differ = 0; y < SIZE; y++)
        for (x = 0; x < SIZE; x++) {
            const voxrt_hit *h = hit_at(&q, x, y);
            if (h->node == VOXRT_NO_NODE) {
                differ += fpx(&q, x, y)[3] != 0;
                continue;
            }
            differ += fpx(&q, x, y)[0] != (float)h->face / 8.0f || fpx(&q, x, y)[2] != h->t / 16.0f;
            differ += fpx(&q, x, y)[1] != fpx(&p, x, y)[1] || fpx(&q, x, y)[3] != 1;
        }
    CHECK_EQ_U64(differ, 0);
    CHECK_EQ_U64(o.wrong, 0);
    voxrt_tree_destroy(t);
    free_picture(&p);
    free_picture(&q);
}

/* Rays of the caller's own that begin behind what they meet: t below 0, and shadows all the same. */
static void render_behind_ray(void *user, double x, double y, voxrt_ray *ray) {
    const float shift = *(const float *)user;
    uint32_t a;
    (void)x;
    (void)y;
    for (a = 0; a < 3; a++) ray->org[a] += shift * ray->dir[a];
    ray->t_min = -shift;
}

TEST(behind_the_origin) {
    float shift = 0.0f;
    voxrt_tree *t = render_make_sphere(5, 0.9);
    render_picture p = make_picture(60, 60, 0, 0);
    voxrt_render_desc d;
    voxrt_states s;
    voxrt_render_stats stats[2];
    uint32_t k;
    memset(&d, 0, sizeof d);
    memset(&s, 0, sizeof s);
    memset(stats, 0, sizeof stats);
    d.camera = render_look(3.1, 2.3, 4.2, 1, 1.05, 0.95, 40);
    d.shadows = 1;
    d.tolerance = 1.0f;
    d.states = &s;
    s.ray_fn = render_behind_ray;
    s.user = &shift;
    for (k = 0; k < 2; k++) {
        shift = k == 0 ? 0.0f : 64.0f;
        CHECK(voxrt_render(&d, t, &p.m, &stats[k]) == VOXRT_OK);
        CHECK(k == 0 ? depth_at(&p, 30, 30) > 3 : depth_at(&p, 30, 30) < -58);
    }
    CHECK(stats[0].shadow.rays > 500 && stats[0].primary.hits == stats[1].primary.hits);
    CHECK_EQ_U64(stats[0].shadow.rays, stats[1].shadow.rays);
    voxrt_tree_destroy(t);
    free_picture(&p);
}

/* The back of a surface is told from a ridge by the face through which it is seen: a closed body looks as if it were
   one-sided, and turned inside out it looks the same. */
TEST(fronts_and_backs) {
    static const double view[5][3] = {{3, 2, 4}, {-4, 1, 2}, {0.3, 5, 0.2}, {2, -4, -3}, {5, 0, 0}};
    enum { SIDE = 150 };
    uint32_t shape, k, x, y, a;
    for (shape = 0; shape < 2; shape++) { /* a sphere, and wavy ridges as sharp as voxels can show */
        voxrt_tree *t[2] = {NULL, NULL};
        render_picture p = make_picture(SIDE, SIDE, 0, 0), q = make_picture(SIDE, SIDE, 0, 0), o = make_picture(SIDE, SIDE, 0, 0);
        uint32_t inside, hits = 0, wrong = 0, turned = 0;
        for (inside = 0; inside < 2; inside++) {
            cells c;
            memset(&c, 0, sizeof c);
            if (shape == 0) {
                level_cells l;
                voxrt_tree *s = render_make_sphere(6, 0.9);
                memset(&l, 0, sizeof l);
                CHECK(voxrt_tree_each(s, 6, take_cell, &l) == 0);
                voxrt_tree_destroy(s);
                c = l.c;
                for (x = 0; x < c.n && inside; x++)
                    for (a = 0; a < 3; a++) c.v[x].normal[a] = -c.v[x].normal[a];
            } else { /* a roof upon roofs: height |sawtooth| of x and z, filled below */
                for (y = 0; y < 64; y++)
                    for (x = 0; x < 64; x++) {
                        const int u = (int)(x % 16) - 8, v = (int)(y % 16) - 8;
                        const int h = 20 - (abs(u) > abs(v) ? abs(u) : abs(v));
                        uint32_t z;
                        for (z = 0; z < 3; z++) {
                            voxrt_voxel *w = render_add(&c, x, (uint32_t)(h - (int)z), y, 255, 255, 255);
                            w->has_normal = 1;
                            set3(w->normal, abs(u) >= abs(v) ? (u > 0) - (u < 0) : 0, 1, abs(v) >= abs(u) ? (v > 0) - (v < 0) : 0);
                            for (a = 0; a < 3 && inside; a++) w->normal[a] = -w->normal[a];
                        }
                    }
            }
            t[inside] = render_make_tree(&c, 6, 2.0, 1);
        }
        for (k = 0; k < 5; k++) {
            voxrt_render_desc d;
            memset(&d, 0, sizeof d);
            if (shape == 1 && view[k][1] <= 0.5) continue; /* from above */
            d.camera = render_look(1 + view[k][0], 1 + view[k][1], 1 + view[k][2], 1, shape ? 0.5 : 1, 1, 40);
            CHECK(voxrt_render(&d, t[0], &p.m, NULL) == VOXRT_OK);
            CHECK(voxrt_render(&d, t[1], &q.m, NULL) == VOXRT_OK);
            d.one_sided = 1;
            CHECK(voxrt_render(&d, t[0], &o.m, NULL) == VOXRT_OK);
            for (y = 0; y < SIDE; y++)
                for (x = 0; x < SIDE; x++) {
                    const float *n = normal_at(&o, x, y), *m = normal_at(&p, x, y), *i = normal_at(&q, x, y);
                    if (!(depth_at(&p, x, y) < INFINITY)) continue;
                    hits++;
                    wrong += n[0] != m[0] || n[1] != m[1] || n[2] != m[2];
                    turned += n[0] * i[0] + n[1] * i[1] + n[2] * i[2] < 0.99f;
                }
        }
        if (test_g.verbose) printf("     %u pixels, %u fronts taken for backs, %u backs for fronts\n", hits, wrong, turned);
        CHECK_MSG(wrong * 250 <= hits, "%u of %u", wrong, hits);
        CHECK_MSG(turned * 40 <= hits, "%u of %u", turned, hits);
        voxrt_tree_destroy(t[0]);
        voxrt_tree_destroy(t[1]);
        free_picture(&p);
        free_picture(&q);
        free_picture(&o);
    }
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(ray_conventions);
    RUN(camera_fit);
    RUN(camera_fit_of_trees);
    RUN(camera_fit_of_trees_out_of_reach);
    RUN(depth_and_alpha);
    RUN(orientation_and_unlit_colors);
    RUN(compose);
    RUN(default_picture);
    RUN(two_sided);
    RUN(shadows);
    RUN(self_shadow);
    RUN(forced_level);
    RUN(tolerance_in_pixels);
    RUN(tolerance_of_random_scenes);
    RUN(object_level);
    RUN(threads_tiles_isa);
    RUN(single_rays);
    RUN(progressive);
    RUN(views);
    RUN(heat);
    RUN(stages);
    RUN(geometry);
    RUN(thesis_path);
    RUN(edges);
    RUN(render_refusals);
    RUN(largest_numbers);
    RUN(allocations);
    RUN(encode_and_blur);
    RUN(frame_budget);
    RUN(blocks_of_pixels);
    RUN(steps_of_the_caller);
    RUN(behind_the_origin);
    RUN(fronts_and_backs);
    return test_end();
}
