/* How good pictures are, against a sphere that is traced as what it is: stairs close up, silhouettes, the codes of
   normals; level of detail while the camera moves: it neither goes back and forth nor flickers more than it has to; and
   the means of meshes that are finer than voxels. -v prints the numbers. */
#include "test.h"
#include "shapes.h"
#define VOXRT_IMPLEMENTATION
#include "../voxrt.h"
#include "ball.h"
#include "voxel_list.h"

/* The sphere of radius `part` around (1, 1, 1) in the cube [0,2)^3, as the thinnest closed shell of 2^depth voxels. */
static voxrt_tree *quality_make_sphere(uint32_t depth, double part) {
    voxrt_build_desc d;
    cells c;
    memset(&c, 0, sizeof c);
    memset(&d, 0, sizeof d);
    d.box_size = 2;
    cells_sphere(&c, 1u << depth, (1u << depth) / 2.0 * part);
    return cells_tree(&c, &d, depth);
}

typedef struct shot { /* a picture and what it is lit by */
    uint32_t size;
    voxrt_camera camera;
    voxrt_light light;
    voxrt_image m;
} shot;

static shot make_shot(uint32_t size) {
    shot s;
    memset(&s, 0, sizeof s);
    s.size = s.m.width = s.m.height = size;
    s.m.rgba8 = (uint8_t *)calloc((size_t)size * size, 4);
    s.m.rgba = (float *)calloc((size_t)size * size, 16);
    s.m.depth = (float *)calloc((size_t)size * size, 4);
    s.m.normal = (float *)calloc((size_t)size * size, 12);
    s.m.hit = (voxrt_hit *)calloc((size_t)size * size, sizeof(voxrt_hit));
    if (!s.m.rgba8 || !s.m.rgba || !s.m.depth || !s.m.normal || !s.m.hit) exit(1);
    s.light.directional = 1;
    s.light.position[0] = 0.6f;
    s.light.position[1] = 0.7f;
    s.light.position[2] = 0.5f;
    s.light.color[0] = s.light.color[1] = s.light.color[2] = 0.9f;
    return s;
}
static void free_shot(shot *s) {
    free(s->m.rgba8);
    free(s->m.rgba);
    free(s->m.depth);
    free(s->m.normal);
    free(s->m.hit);
}

static void quality_draw(shot *s, const voxrt_tree *t, uint32_t samples, int faces) {
    voxrt_render_desc d;
    memset(&d, 0, sizeof d);
    d.camera = s->camera;
    d.lights = &s->light;
    d.light_count = 1;
    d.samples = samples;
    d.face_normals = (uint32_t)faces;
    CHECK(voxrt_render(&d, t, &s->m, NULL) == VOXRT_OK);
}

static void picture_bytes(const shot *s, double *out) { /* on black */
    size_t i;
    for (i = 0; i < (size_t)s->size * s->size; i++) out[i] = (double)s->m.rgba[4 * i];
    ball_bytes(out, (size_t)s->size * s->size);
}

/* Mean structural similarity (Wang et al. 2004) of 8x8 windows, every 4 pixels. */
static double ssim(const double *a, const double *b, uint32_t size) {
    double total = 0;
    uint32_t x, y, i, n = 0;
    for (y = 0; y + 8 <= size; y += 4)
        for (x = 0; x + 8 <= size; x += 4) {
            double ma = 0, mb = 0, aa = 0, bb = 0, ab = 0;
            for (i = 0; i < 64; i++) {
                const double u = a[(y + i / 8) * size + x + i % 8], v = b[(y + i / 8) * size + x + i % 8];
                ma += u / 64;
                mb += v / 64;
                aa += u * u / 64;
                bb += v * v / 64;
                ab += u * v / 64;
            }
            aa -= ma * ma;
            bb -= mb * mb;
            ab -= ma * mb;
            total += (2 * ma * mb + 6.5025) * (2 * ab + 58.5225) / ((ma * ma + mb * mb + 6.5025) * (aa + bb + 58.5225));
            n++;
        }
    return total / n;
}

/* ---- stairs ------------------------------------------------------------------------------------------------ */

/* Close up a voxel is 1 to 50 pixels wide, and the surface is a staircase. With the voxels' normals it is shaded far
   better than with faces, and the blur that knows the size of voxels makes that better again. */
TEST(stairs_close_up) {
    static const struct { uint32_t depth; double pixels; } list[6] = {{8, 1}, {8, 2}, {7, 5}, {7, 10}, {6, 20}, {6, 50}};
    enum { SIZE = 96 };
    static double exact[SIZE * SIZE], got[SIZE * SIZE];
    uint32_t i;
    for (i = 0; i < 6; i++) {
        voxrt_tree *t = quality_make_sphere(list[i].depth, 0.95);
        shot s = make_shot(SIZE);
        const double edge = 2.0 / (1u << list[i].depth), wide = SIZE * edge / list[i].pixels; /* of the picture, in space */
        double p[3], q[3];
        voxrt_blur_desc b;
        memset(&b, 0, sizeof b);
        s.camera.at[0] = wide > 0.6 ? 1.0f : 1.45f; /* the outline is not in the picture */
        s.camera.at[1] = wide > 0.6 ? 1.0f : 1.3f;
        s.camera.at[2] = 1;
        memcpy(s.camera.eye, s.camera.at, sizeof s.camera.eye);
        s.camera.eye[2] = 21;
        s.camera.fov_y = (float)(2 * atan(0.5 * wide / 20) * 57.29577951308232);
        CHECK(ball_picture(&s.camera, SIZE, SIZE, 1, 0.95, s.light.position, exact, NULL));
        ball_bytes(exact, SIZE * SIZE);
        quality_draw(&s, t, 16, 1);
        picture_bytes(&s, got);
        p[0] = ball_psnr(got, exact, SIZE * SIZE);
        q[0] = ssim(got, exact, SIZE);
        quality_draw(&s, t, 16, 0);
        picture_bytes(&s, got);
        p[1] = ball_psnr(got, exact, SIZE * SIZE);
        q[1] = ssim(got, exact, SIZE);
        b.radius = 32;
        b.footprint = (float)(wide / 20 / SIZE);
        b.voxel_size = (float)edge;
        b.depth = list[i].depth;
        CHECK(voxrt_blur(&b, &s.m) == VOXRT_OK);
        picture_bytes(&s, got);
        p[2] = ball_psnr(got, exact, SIZE * SIZE);
        q[2] = ssim(got, exact, SIZE);
        if (test_g.verbose)
            printf("     voxels of %g pixels: faces %.1f dB %.3f, normals %.1f dB %.3f, and blur %.1f dB %.3f\n",
                   list[i].pixels, p[0], q[0], p[1], q[1], p[2], q[2]);
        CHECK(p[1] > p[0] + 3 && q[1] > q[0]);
        CHECK(list[i].pixels < 2 ? p[2] > p[1] - 0.1 : p[2] > p[1] + 2);
        voxrt_tree_destroy(t);
        free_shot(&s);
    }
}

/* ---- silhouettes ------------------------------------------------------------------------------------------- */

/* Against a thousand other samples a pixel: the error of coverage along the outline falls faster than with the square
   root of their number. */
TEST(silhouettes_get_smoother_with_samples) {
    enum { SIZE = 64, MANY = 1024 };
    static const uint32_t samples[4] = {1, 4, 16, 64};
    static double cover[SIZE * SIZE];
    voxrt_tree *t = quality_make_sphere(7, 0.95);
    shot s = make_shot(SIZE);
    double error[4];
    uint32_t k, i, edge = 0;
    s.camera.at[0] = s.camera.at[1] = s.camera.at[2] = 1;
    s.camera.eye[0] = 3;
    s.camera.eye[1] = 5;
    s.camera.eye[2] = 40;
    s.camera.fov_y = 3.1f;
    {
        voxrt_render_desc d;
        memset(&d, 0, sizeof d);
        d.camera = s.camera;
        d.samples = MANY;
        d.first_sample = 1000;
        CHECK(voxrt_render(&d, t, &s.m, NULL) == VOXRT_OK);
        for (i = 0; i < SIZE * SIZE; i++) cover[i] = (double)s.m.rgba[4 * i + 3];
    }
    for (k = 0; k < 4; k++) {
        quality_draw(&s, t, samples[k], 0);
        error[k] = 0;
        for (i = 0, edge = 0; i < SIZE * SIZE; i++) {
            const double e = (double)s.m.rgba[4 * i + 3] - cover[i];
            if (cover[i] == 0 || cover[i] == 1) continue;
            error[k] += e * e;
            edge++;
        }
        error[k] = sqrt(error[k] / edge);
        if (test_g.verbose) printf("     %u samples: error of coverage %.4f\n", samples[k], error[k]);
    }
    CHECK(edge > 150);
    for (k = 0; k < 3; k++) CHECK(error[k + 1] < 0.7 * error[k]);
    CHECK(error[0] < 0.3 && error[2] < 0.1 && error[3] * 8 < error[0]);
    voxrt_tree_destroy(t);
    free_shot(&s);
}

/* ---- normals ----------------------------------------------------------------------------------------------- */

/* What the codes of normals do to a picture: both stay below one step of a byte in the mean, ours is better. */
TEST(normal_codes_in_the_picture) {
    enum { SIZE = 256 };
    double sum[2] = {0, 0}, most[2] = {0, 0}, n = 0;
    const double l[3] = {0.545, 0.636, 0.546};
    uint32_t x, y, k;
    for (y = 0; y < SIZE; y++)
        for (x = 0; x < SIZE; x++) {
            const double u = (x + 0.5) / SIZE * 2 - 1, v = (y + 0.5) / SIZE * 2 - 1, w = 1 - u * u - v * v;
            double exact;
            float normal[3], got[3];
            if (w <= 0) continue;
            normal[0] = (float)u;
            normal[1] = (float)v;
            normal[2] = (float)sqrt(w);
            exact = l[0] * u + l[1] * v + l[2] * sqrt(w);
            exact = ball_srgb(0.05 + (exact > 0 ? 0.9 * exact : 0));
            n++;
            for (k = 0; k < 2; k++) {
                double e;
                voxrti_normal_decode(k, voxrti_normal_encode(k, normal), got);
                e = l[0] * (double)got[0] + l[1] * (double)got[1] + l[2] * (double)got[2];
                e = fabs(ball_srgb(0.05 + (e > 0 ? 0.9 * e : 0)) - exact);
                sum[k] += e * e;
                most[k] = e > most[k] ? e : most[k];
            }
        }
    for (k = 0; k < 2; k++) {
        sum[k] = sqrt(sum[k] / n);
        if (test_g.verbose)
            printf("     %s: RMSE %.3f, most %.2f of 255\n", k ? "spherical" : "octahedral", sum[k], most[k]);
    }
    CHECK(sum[0] < 1 && sum[1] < 1 && sum[0] < sum[1]);
    CHECK(most[0] < 6 && most[0] <= most[1]);
}

/* ---- levels of detail in motion ---------------------------------------------------------------------------- */

/* On the way towards a thing each ray sees it finer and finer: levels never go back. Rays keep their line. */
TEST(levels_do_not_oscillate) {
    voxrt_tree *t = quality_make_sphere(8, 0.9);
    test_rng r = test_rng_make(11);
    uint32_t rays = 0, lines = test_quick() ? 300 : 2000, k, i, a, back = 0, steps = 0;
    for (k = 0; k < lines; k++) {
        float to[3], u[3];
        double length = 0;
        uint32_t last = 0;
        voxrt_trace_desc d;
        memset(&d, 0, sizeof d);
        d.cone_spread = 0.002f * (1 + test_rng_float(&r));
        for (a = 0; a < 3; a++) {
            to[a] = test_rng_range(&r, 0.2f, 1.8f);
            u[a] = test_rng_range(&r, -1, 1);
            length += (double)u[a] * (double)u[a];
        }
        for (i = 0; i < 160; i++) {
            const double away = 60 * pow(0.965, i);
            voxrt_ray q;
            voxrt_hit h;
            memset(&q, 0, sizeof q);
            q.t_max = INFINITY;
            for (a = 0; a < 3; a++) {
                q.dir[a] = (float)((double)u[a] / sqrt(length));
                q.org[a] = (float)((double)to[a] - away * (double)u[a] / sqrt(length));
            }
            CHECK(voxrt_trace(t, &d, &q, &h, 1) == VOXRT_OK);
            if (h.node == VOXRT_NO_NODE) continue;
            if (away < 2.5) break; /* soon inside */
            rays++;
            back += h.level < last;
            steps += h.level > last;
            last = h.level;
        }
    }
    if (test_g.verbose) printf("     %u rays, %u times finer, %u times coarser\n", rays, steps, back);
    CHECK(steps > 3 * lines);
    CHECK_MSG(back * 1000 <= steps, "%u of %u", back, steps);
    { /* one level for all: never back */
        double away;
        uint32_t last = 0, levels = 0;
        shot s = make_shot(16);
        for (away = 400; away > 1.5; away *= 0.97) {
            voxrt_render_desc d;
            memset(&d, 0, sizeof d);
            d.object_lod = 1;
            d.camera = s.camera;
            for (a = 0; a < 3; a++) d.camera.at[a] = d.camera.eye[a] = 1;
            d.camera.eye[2] += (float)away;
            d.camera.fov_y = 0.5f;
            CHECK(voxrt_render(&d, t, &s.m, NULL) == VOXRT_OK);
            if (s.m.hit[8 * 16 + 8].node == VOXRT_NO_NODE) continue;
            CHECK(s.m.hit[8 * 16 + 8].level >= last);
            levels += s.m.hit[8 * 16 + 8].level != last;
            last = s.m.hit[8 * 16 + 8].level;
        }
        CHECK(levels >= 3 && last == 8);
        free_shot(&s);
    }
    voxrt_tree_destroy(t);
}

/* A flight over a plain of coloured voxels that reaches from near to far away. What changes from frame to frame but not
   in the picture of many rays is flicker. Where voxels are smaller than pixels a level for each pixel has less of it than
   full detail; one level for all is chosen for what is near, and so does nothing for what is far. */
TEST(level_of_detail_flickers_less) {
    enum { SIZE = 80, FRAMES = 8 };
    static double frame[5][2][SIZE * SIZE * 3], ref[2][SIZE * SIZE * 3];
    const uint32_t n = 512;
    const float pixel = 2 * tanf(25 * 0.0174532925f) / SIZE;
    voxrt_voxel *v = (voxrt_voxel *)calloc((size_t)n * n, sizeof *v);
    voxrt_build_desc b;
    voxrt_tree *t = NULL;
    test_rng r = test_rng_make(12);
    shot s = make_shot(SIZE);
    static uint8_t is_far[2][SIZE * SIZE];
    double flicker[5] = {0, 0, 0, 0, 0}, count = 0;
    uint32_t i, k, f, a;
    if (v == NULL) exit(1);
    for (i = 0; i < n * n; i++) {
        v[i].x = i % n;
        v[i].z = i / n;
        for (a = 0; a < 3; a++) v[i].rgb[a] = (uint8_t)(test_rng_below(&r, 2) * 200 + 30);
        v[i].has_normal = 1;
        v[i].normal[1] = 1;
    }
    memset(&b, 0, sizeof b);
    CHECK(voxrt_tree_from_voxels(&b, v, (size_t)n * n, 9, &t) == VOXRT_OK);
    free(v);
    for (f = 0; f < FRAMES; f++) {
        for (k = 0; k < 5; k++) { /* 0: full detail, 1: one level, 2: a level each pixel, 3: many rays, 4: as 2, blended */
            voxrt_render_desc d;
            double *out = k != 3 ? frame[k][f & 1] : ref[f & 1];
            memset(&d, 0, sizeof d);
            d.camera.eye[0] = d.camera.at[0] = 256;
            d.camera.eye[1] = 12;
            d.camera.eye[2] = 514 - 0.37f * (float)f;
            d.camera.at[2] = 430 - 0.37f * (float)f;
            d.camera.fov_y = 50;
            d.view = VOXRT_VIEW_UNLIT;
            d.object_lod = k == 1;
            d.tolerance = k == 1 || k == 2 || k == 4 ? 1.0f : 0.0f;
            d.blend = k == 4;
            d.samples = k == 3 ? 64 : 1;
            CHECK(voxrt_render(&d, t, &s.m, NULL) == VOXRT_OK);
            for (i = 0; i < SIZE * SIZE; i++) {
                for (a = 0; a < 3; a++) out[3 * i + a] = (double)s.m.rgba[4 * i + a];
                if (k == 0) is_far[f & 1][i] = s.m.depth[i] < INFINITY && s.m.depth[i] * pixel > 1.5f;
            }
        }
        for (i = 0; i < SIZE * SIZE * 3 && f > 0; i++) {
            if (!is_far[0][i / 3] || !is_far[1][i / 3]) continue;
            count++;
            for (k = 0; k < 5; k++)
                flicker[k] += fabs((frame[k][f & 1][i] - frame[k][~f & 1][i]) - (ref[f & 1][i] - ref[~f & 1][i]));
        }
    }
    CHECK(count > 3000);
    for (k = 0; k < 5; k++) flicker[k] /= count;
    if (test_g.verbose)
        printf("     flicker: full detail %.4f, one level %.4f, a level each pixel %.4f, blended %.4f\n", flicker[0],
               flicker[1], flicker[2], flicker[4]);
    CHECK(flicker[2] < 0.75 * flicker[1] && flicker[2] < 0.75 * flicker[0] && flicker[4] < 0.65 * flicker[2]);
    voxrt_tree_destroy(t);
    free_shot(&s);
}

/* Towards a grainy ball, from where it is small to where it fills the picture: the change from frame to
   frame against that of many rays a pixel. Where a pixel changes levels nothing jumps. */
TEST(a_dolly_does_not_pop) {
    enum { SIZE = 96, FRAMES = 8 };
    static double frame[2][SIZE * SIZE], last[2][SIZE * SIZE], ref[SIZE * SIZE], before[SIZE * SIZE];
    static float rgba[SIZE * SIZE * 4];
    const int depth = 9;
    double pop[2] = {0, 0}, jump[2] = {0, 0}, count = 0;
    voxrt_build_desc b;
    voxrt_tree *t;
    voxrt_image m;
    cells c;
    uint32_t f, k, i;
    memset(&c, 0, sizeof c);
    memset(&b, 0, sizeof b);
    memset(&m, 0, sizeof m);
    m.width = m.height = SIZE;
    m.rgba = rgba;
    b.box_size = 2;
    cells_sphere(&c, 1u << depth, (1u << depth) / 2.0 * 0.95);
    for (i = 0; i < c.n; i++) {
        voxrt_voxel *v = &c.v[i];
        const uint32_t grain = ((v->x >> 1) * 73856093u ^ (v->y >> 1) * 19349663u ^ (v->z >> 1) * 83492791u) * 2654435761u;
        v->rgb[0] = v->rgb[1] = v->rgb[2] = (uint8_t)(90 + (grain >> 24) / 3);
    }
    t = cells_tree(&c, &b, (uint32_t)depth);
    for (f = 0; f < FRAMES; f++) {
        for (k = 0; k < 3; k++) {
            voxrt_render_desc d;
            memset(&d, 0, sizeof d);
            d.camera.at[0] = d.camera.at[1] = d.camera.at[2] = 1;
            d.camera.eye[0] = d.camera.eye[1] = 1;
            d.camera.eye[2] = (float)(1 + 9 * pow(0.985, f));
            d.camera.fov_y = 18;
            d.tolerance = k < 2 ? 1.0f : 0.0f;
            d.blend = k == 1;
            d.samples = k < 2 ? 4 : 64;
            CHECK(voxrt_render(&d, t, &m, NULL) == VOXRT_OK);
            for (i = 0; i < SIZE * SIZE; i++) (k < 2 ? frame[k] : ref)[i] = (double)rgba[4 * i];
        }
        for (i = 0; i < SIZE * SIZE; i++) {
            const uint32_t x = i % SIZE - SIZE / 2, y = i / SIZE - SIZE / 2;
            if (f > 0 && x * x + y * y < 24 * 24) {
                count++;
                for (k = 0; k < 2; k++) {
                    const double e = fabs((frame[k][i] - last[k][i]) - (ref[i] - before[i]));
                    pop[k] += e;
                    jump[k] = e > jump[k] ? e : jump[k];
                }
            }
            for (k = 0; k < 2; k++) last[k][i] = frame[k][i];
            before[i] = ref[i];
        }
    }
    for (k = 0; k < 2; k++) pop[k] /= count;
    if (test_g.verbose)
        printf("     dolly: levels %.4f, at most %.3f; blended %.4f, at most %.3f\n", pop[0], jump[0], pop[1], jump[1]);
    CHECK(pop[1] < 0.01 && pop[1] < 0.8 * pop[0]);
    voxrt_tree_destroy(t);
}

/* What a cell is blended with is the cell around it, at any level of any tree, in proportion to how far the footprint has
   grown from the one to the other. */
TEST(colours_go_over_to_the_next_level) {
    static const float width[5] = {1, 1.25f, 1.5f, 1.9999f, 1e6f}; /* of footprints, in voxels */
    enum { RAYS = 64 };
    test_rng r = test_rng_make(21);
    uint32_t depth, k, i, a, w, level, judged = 0;
    for (depth = 1; depth <= 6; depth++) {
        voxrt_tree *tree[2] = {NULL, NULL};
        voxrt_build_desc b;
        voxrt_ray ray[RAYS];
        cells c;
        const uint32_t n = 1u << depth;
        memset(&c, 0, sizeof c);
        memset(&b, 0, sizeof b);
        b.lod_method = VOXRT_LOD_MEAN;
        for (i = 0; i < n * n * n; i++) {
            if (i != 0 && test_rng_float(&r) > 0.5f) continue;
            cells_add(&c, i % n, i / n % n, i / n / n, (uint32_t)(test_rng_float(&r) * 16777215));
            cells_normal(&c, (double)test_rng_range(&r, -1, 1), (double)test_rng_range(&r, -1, 1), 1.1);
        }
        for (i = 0; i < RAYS; i++)
            for (a = 0; a < 3; a++) {
                ray[i].org[a] = -1.0f;
                ray[i].dir[a] = test_rng_range(&r, 0, (float)n) + 1.0f;
                ray[i].t_min = 0;
                ray[i].t_max = INFINITY;
            }
        tree[0] = cells_tree(&c, &b, depth);
        CHECK(voxrt_tree_share(tree[0], NULL, &tree[1]) == VOXRT_OK);
        REQUIRE(tree[1] != NULL);
        for (k = 0; k < 2; k++) {
            voxrt_geometry g;
            voxrt_trace_desc d;
            voxrt_hit hit[RAYS];
            voxrt_surface own[RAYS], mixed[RAYS];
            memset(&d, 0, sizeof d);
            for (level = 1; level <= depth; level++) {
                d.max_level_plus_1 = level + 1;
                CHECK(voxrt_trace(tree[k], &d, ray, hit, RAYS) == VOXRT_OK);
                for (i = 0; i < RAYS; i++) {
                    voxrt_voxel up;
                    uint8_t rgb[3];
                    uint64_t attr;
                    float normal[3];
                    if (hit[i].node == VOXRT_NO_NODE) continue;
                    attr = voxrti_parent_attr(tree[k], &hit[i]);
                    REQUIRE(attr < tree[k]->attr_count && hit[i].level == level);
                    CHECK(voxrt_tree_get(tree[k], level - 1, hit[i].cell[0] >> 1, hit[i].cell[1] >> 1, hit[i].cell[2] >> 1, &up));
                    voxrti_attr_color(tree[k], attr, rgb);
                    voxrti_normal_decode(tree[k]->spherical, tree[k]->normal[attr], normal);
                    CHECK_MSG(memcmp(rgb, up.rgb, 3) == 0, "depth %u, level %u, tree %u", depth, level, k);
                    for (a = 0; a < 3; a++) /* one code, decoded in two places: with fused products the last bit may differ */
                        CHECK_MSG(fabsf(normal[a] - up.normal[a]) < 5e-7f, "depth %u, level %u, tree %u", depth, level, k);
                    judged++;
                }
            }
            voxrt_tree_geometry(tree[k], &g);
            memset(&d, 0, sizeof d);
            for (w = 0; w < 5; w++) {
                const double more = width[w] < 2 ? (double)width[w] - 1 : 1;
                d.cone_width = width[w];
                d.blend = 0;
                CHECK(voxrt_trace(tree[k], &d, ray, hit, RAYS) == VOXRT_OK);
                g.trace_fn(g.user, &d, ray, own, RAYS);
                d.blend = 1;
                g.trace_fn(g.user, &d, ray, mixed, RAYS);
                for (i = 0; i < RAYS; i++) {
                    voxrt_voxel up;
                    double m[3], length = 0;
                    if (hit[i].node == VOXRT_NO_NODE || hit[i].level == 0 || w == 0) {
                        CHECK(memcmp(&own[i], &mixed[i], sizeof own[i]) == 0);
                        continue;
                    }
                    CHECK(hit[i].level == (w < 4 ? depth : 1) && own[i].t == mixed[i].t && own[i].edge == mixed[i].edge);
                    CHECK(voxrt_tree_get(tree[k], hit[i].level - 1u, hit[i].cell[0] >> 1, hit[i].cell[1] >> 1, hit[i].cell[2] >> 1, &up));
                    for (a = 0; a < 3; a++) {
                        const double x = own[i].rgb[a], y = up.rgb[a];
                        CHECK(fabs(sqrt(x * x + more * (y * y - x * x)) - (double)mixed[i].rgb[a]) < 0.51);
                        m[a] = (double)own[i].normal[a] + more * ((double)up.normal[a] - (double)own[i].normal[a]);
                        length += m[a] * m[a];
                    }
                    for (a = 0; a < 3; a++) CHECK(fabs(m[a] / sqrt(length) - (double)mixed[i].normal[a]) < 1e-5);
                    judged++;
                }
            }
        }
        voxrt_tree_destroy(tree[0]);
        voxrt_tree_destroy(tree[1]);
    }
    CHECK(judged > 3000);
}

/* ---- meshes that are finer than voxels --------------------------------------------------------------------- */

static double linear_of(double c) { return c <= 0.04045 ? c / 12.92 : pow((c + 0.055) / 1.055, 2.4); }

typedef struct light_sum { double sum, square; uint32_t count; } light_sum;

static int add_light(void *user, const voxrt_voxel *v, uint32_t index) {
    light_sum *s = (light_sum *)user;
    const double l = linear_of(v->rgb[0] / 255.0);
    (void)index;
    s->sum += l;
    s->square += l * l;
    s->count++;
    return 0;
}

/* A sloping plane of black and white squares of half a voxel; the white ones are cut into cuts x cuts squares. Its voxels
   are grey, however finely one of the colours is cut. */
TEST(fine_meshes_are_averaged_by_area) {
    enum { SQUARES = 80 };
    static const uint32_t cuts[3] = {1, 2, 5};
    uint32_t c, sep, slope, i, k, a, b, e;
    for (c = 0; c < (test_quick() ? 2u : 3u); c++)
        for (slope = 0; slope < 2; slope++) {
            const size_t most = 2 * (size_t)SQUARES * SQUARES * (cuts[c] * cuts[c] + 1);
            float *p = (float *)malloc(most * 36);
            uint8_t *rgb = (uint8_t *)malloc(most * 3);
            size_t n = 0;
            if (p == NULL || rgb == NULL) exit(1);
            for (i = 0; i < SQUARES; i++)
                for (k = 0; k < SQUARES; k++) {
                    const uint32_t f = (i + k) % 2 ? cuts[c] : 1;
                    for (a = 0; a < f; a++)
                        for (b = 0; b < f; b++)
                            for (e = 0; e < 6; e++) {
                                static const uint8_t corner[6] = {0, 3, 1, 0, 2, 3};
                                const double x = 4.07 + 0.5 * (i + (a + (corner[e] & 1u)) / (double)f);
                                const double z = 4.03 + 0.5 * (k + (b + (corner[e] >> 1)) / (double)f);
                                float *q = p + 9 * n + 3 * (e % 3);
                                q[0] = (float)x;
                                q[1] = (float)(5.13 + slope * (0.31 * (x - 4) + 0.22 * (z - 4)));
                                q[2] = (float)z;
                                if (e % 3 == 2) memset(rgb + 3 * n++, (i + k) % 2 ? 255 : 0, 3);
                            }
                }
            for (sep = 0; sep < 2; sep++) {
                voxrt_mesh m;
                voxrt_build_desc d;
                voxrt_tree *t = NULL;
                light_sum s;
                memset(&m, 0, sizeof m);
                memset(&d, 0, sizeof d);
                memset(&s, 0, sizeof s);
                m.positions = p;
                m.vertex_count = 3 * n;
                m.triangle_count = n;
                m.triangle_rgb = rgb;
                d.resolution = 64;
                d.box_size = 64;
                d.separating = (voxrt_separating)sep;
                REQUIRE(voxrt_tree_build(&d, &m, NULL, &t) == VOXRT_OK);
                (void)voxrt_tree_each(t, 6, add_light, &s);
                s.sum /= s.count;
                s.square = sqrt(fabs(s.square / s.count - s.sum * s.sum));
                if (test_g.verbose)
                    printf("     %u cuts, slope %u, %s-separating: mean %.4f, deviation %.4f\n", cuts[c], slope, sep ? "26" : "6",
                           s.sum, s.square);
                CHECK_NEAR(s.sum, 0.5, sep && slope ? 0.12 : 0.04);
                if (!sep) CHECK(s.square < 0.05); /* of 26 some hold only corners of the plane */
                voxrt_tree_destroy(t);
            }
            free(p);
            free(rgb);
        }
    { /* a dense sphere: only the error of the codes is left */
        shape s;
        voxrt_mesh m;
        voxrt_build_desc d;
        voxrt_tree *t = NULL;
        uint32_t x, y, z, count = 0;
        double mean = 0, worst = 0;
        memset(&s, 0, sizeof s);
        memset(&m, 0, sizeof m);
        memset(&d, 0, sizeof d);
        shape_sphere(&s, 0, 0, 0, 1, 220);
        m.positions = s.p;
        m.vertex_count = s.vertices;
        m.indices = s.t;
        m.triangle_count = s.triangles;
        d.resolution = 48;
        REQUIRE(voxrt_tree_build(&d, &m, NULL, &t) == VOXRT_OK);
        for (z = 0; z < 48; z++)
            for (y = 0; y < 48; y++)
                for (x = 0; x < 48; x++) {
                    voxrt_voxel v;
                    double q[3], l = 0, dot = 0;
                    if (!voxrt_tree_get(t, 6, x, y, z, &v)) continue;
                    q[0] = x - 23.5;
                    q[1] = y - 23.5;
                    q[2] = z - 23.5;
                    for (a = 0; a < 3; a++) l += q[a] * q[a];
                    for (a = 0; a < 3; a++) dot += q[a] / sqrt(l) * (double)v.normal[a];
                    dot = acos(dot > 1 ? 1 : dot) * 57.29577951308232;
                    mean += dot;
                    worst = dot > worst ? dot : worst;
                    count++;
                }
        mean /= count;
        if (test_g.verbose) printf("     sphere of %u triangles: normals off by %.3f, at most %.2f degrees\n",
                                   (uint32_t)s.triangles, mean, worst);
        CHECK(mean < 0.345 && worst < 0.9);
        voxrt_tree_destroy(t);
        shape_free(&s);
    }
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(stairs_close_up);
    RUN(silhouettes_get_smoother_with_samples);
    RUN(normal_codes_in_the_picture);
    RUN(levels_do_not_oscillate);
    RUN(level_of_detail_flickers_less);
    RUN(a_dolly_does_not_pop);
    RUN(colours_go_over_to_the_next_level);
    RUN(fine_meshes_are_averaged_by_area);
    return test_end();
}
