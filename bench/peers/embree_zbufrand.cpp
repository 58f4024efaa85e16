/* embree_zbufrand.cpp - pictures of many triangles by samples and by rays of Embree 3 - MIT OR Unlicense, see LICENSE

   peer_embree_zbufrand [--full] [--threads N]

   Same scene, camera and light; a picture of both is linear colours, eight bits of sRGB and depth. Embree casts one ray
   through the centre of each pixel, 16 a call, and lights its hit by the face normal. What is right is the mean of 256 rays a
   pixel in some of the tiles (bench_worlds.h): the error of both is the RMSE of sRGB values against it. */
#include "../bench.h"
#include "../../examples/support/mesh.h"
#include "../../examples/support/scenes.h"
#define ZBUFRAND_IMPLEMENTATION
#include "../../zbufrand.h"
#include "peer.h"
#include "../../examples/support/worlds.h"
#include "../bench_worlds.h"
#include "embree_rays.h"

enum { ROUNDS = 5, WIDTH = 1024, HEIGHT = 768 };
static const char *const g_isa = zbufrand_isa_name(zbufrand_isa_best());
static const char *const g_rmse = "RMSE of sRGB to 256 rays a pixel";

/* ---- Embree's picture ---- */

struct embree_picture {
    RTCScene scene;
    const zbufrand_transform *instance = nullptr; /* by geometry; NULL: none */
    zbufrandi_camera camera;
    bool shade = true;
    std::vector<float> rgba, depth;
    std::vector<uint8_t> rgba8, encode;           /* encode: 12 bits of linear light to sRGB */

    embree_picture(RTCScene s, const picture_job &like) : scene(s), rgba(4 * WIDTH * HEIGHT), depth(WIDTH * HEIGHT),
                                                          rgba8(4 * WIDTH * HEIGHT), encode(4096) {
        must(zbufrandi_camera_open(&like.desc.camera, like.scene, WIDTH, HEIGHT, 0, &camera), "camera");
        for (size_t i = 0; i < encode.size(); i++) encode[i] = (uint8_t)(255.0 * zbufrandi_linear_to_srgb((double)i / 4095.0) + 0.5);
    }

    void pixel(const RTCRayHit16 &p, size_t l, size_t at) {
        float c[4] = {g_sky[0], g_sky[1], g_sky[2], g_sky[3]};
        depth[at] = INFINITY;
        if (p.hit.geomID[l] != RTC_INVALID_GEOMETRY_ID) {
            float n[3] = {p.hit.Ng_x[l], p.hit.Ng_y[l], p.hit.Ng_z[l]}, q[3] = {n[0], n[1], n[2]};
            float dot = 0, toward = 0, length = 0;
            const float d[3] = {p.ray.dir_x[l], p.ray.dir_y[l], p.ray.dir_z[l]};
            if (instance != nullptr) {
                const zbufrand_transform &t = instance[p.hit.instID[0][l]];
                for (int a = 0; a < 3; a++) n[a] = (float)t.m[a][0] * q[0] + (float)t.m[a][1] * q[1] + (float)t.m[a][2] * q[2];
            }
            for (int a = 0; a < 3; a++) {
                dot += n[a] * (float)g_light[a];
                toward += n[a] * d[a];
                length += n[a] * n[a];
            }
            if (toward > 0) dot = -dot;
            const float light = g_ambient + g_light_color * (dot > 0 ? dot / sqrtf(length) : 0.0f);
            for (int a = 0; a < 3; a++) c[a] = light; /* white, as meshes without colours are */
            depth[at] = p.ray.tfar[l];
        }
        for (size_t a = 0; a < 3; a++) {
            rgba[4 * at + a] = c[a];
            rgba8[4 * at + a] = encode[(size_t)(4095.0f * std::min(std::max(c[a], 0.0f), 1.0f) + 0.5f)];
        }
        rgba[4 * at + 3] = c[3];
        rgba8[4 * at + 3] = 255;
    }

    void run(void) {
        peer_for(WIDTH / 4 * (HEIGHT / 4), 64, [&](size_t first, size_t end) {
            alignas(64) static const int valid[16] = {-1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1};
            const zbufrandi_camera &c = camera;
            RTCRayHit16 p;
            RTCIntersectContext context;
            embree_fast_floats();
            rtcInitIntersectContext(&context);
            context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
            memset(&p, 0, sizeof p);
            for (size_t i = first; i < end; i++) {
                const size_t x0 = i % (WIDTH / 4) * 4, y0 = i / (WIDTH / 4) * 4;
                for (size_t l = 0; l < 16; l++) {
                    const float u = ((float)(x0 + l % 4) + 0.5f - (float)c.center_x) / (float)c.focal;
                    const float v = ((float)c.center_y - (float)(y0 + l / 4) - 0.5f) / (float)c.focal;
                    p.ray.org_x[l] = (float)c.eye[0];
                    p.ray.org_y[l] = (float)c.eye[1];
                    p.ray.org_z[l] = (float)c.eye[2];
                    p.ray.dir_x[l] = (float)c.dir[0] + u * (float)c.right[0] + v * (float)c.up[0];
                    p.ray.dir_y[l] = (float)c.dir[1] + u * (float)c.right[1] + v * (float)c.up[1];
                    p.ray.dir_z[l] = (float)c.dir[2] + u * (float)c.right[2] + v * (float)c.up[2];
                    p.ray.tnear[l] = (float)c.near_z;
                    p.ray.tfar[l] = INFINITY;
                    p.ray.mask[l] = ~0u;
                    p.hit.geomID[l] = p.hit.instID[0][l] = RTC_INVALID_GEOMETRY_ID;
                }
                rtcIntersect16(valid, scene, &context, &p);
                for (size_t l = 0; l < 16 && shade; l++) pixel(p, l, (y0 + l / 4) * WIDTH + x0 + l % 4);
            }
        });
    }
};

/* ---- pictures ---- */

struct frame_times { double ours, theirs, error[2]; };

/* gauss: the nearest samples around a pixel weighted, which shows more than one ray a pixel can. */
static frame_times picture(const char *id, const char *kase, const world *w, RTCScene scene, const zbufrand_transform *instance,
                           double theirs_bytes, double each, double theirs_each, int gauss, uint32_t every, int rounds) {
    picture_job job = picture_open(w, WIDTH, HEIGHT, (uint32_t)g_peer_threads);
    truth *t = truth_make(&job, every);
    embree_picture other(scene, job), rays(scene, job);
    peer_side p[3] = {peer_ours(gauss ? "zbufrand_render, Gaussian of 1.1" : "zbufrand_render", g_isa),
                      peer_theirs(g_embree_name, "intersect16, lit"), peer_theirs(g_embree_name, "intersect16 alone, no picture")};
    if (gauss) {
        job.desc.reconstruct.fill = ZBUFRAND_FILL_GAUSS;
        job.desc.reconstruct.gauss_radius = 1.1f;
        job.desc.reconstruct.gauss_support = 1.5f;
    }
    other.instance = rays.instance = instance;
    rays.shade = false;
    p[0].run = [&] { picture_run(&job); };
    p[1].run = [&] { other.run(); };
    p[2].run = [&] { rays.run(); };
    peer_time(p, 3, rounds);
    const wrong e = judge(t, job.image.rgba, nullptr, job.image.depth, nullptr);
    p[0].error = e.rmse;
    p[0].holes = 100.0 * e.holes;
    p[1].error = judge(t, other.rgba.data(), nullptr, nullptr, nullptr).rmse;
    p[0].bytes = (double)w->info.bytes + (double)job.stats.bytes;
    p[0].bytes_each = each > 0 ? (double)w->info.bytes / each : NAN;
    p[1].bytes = p[2].bytes = theirs_bytes;
    p[1].bytes_each = p[2].bytes_each = theirs_each > 0 ? theirs_bytes / theirs_each : NAN;
    p[0].hash = picture_hash(&job);
    peer_lines(id, kase, "frame_seconds", "s", 0, g_rmse, p, 2);
    peer_side alone[2] = {p[0], p[2]};
    if (!gauss) peer_lines("Z", (std::string(kase) + ", against rays alone").c_str(), "frame_seconds", "s", 0, g_rmse, alone, 2);
    truth_free(t);
    picture_free(&job);
    return frame_times{peer_median(p[0].seconds), peer_median(p[1].seconds), {p[0].error, p[1].error}};
}

struct built { RTCScene scene; double bytes, seconds; };

static built build(RTCDevice device, const sup_mesh &m) {
    built b;
    const long before = g_embree_bytes;
    b.seconds = peer_once([&] { b.scene = embree_scene(device, m, RTC_BUILD_QUALITY_MEDIUM, RTC_SCENE_FLAG_NONE); });
    b.bytes = (double)(g_embree_bytes - before);
    return b;
}

/* ---- building and changing ---- */

static void builds(RTCDevice device) {
    supi_make make = blob_mesh(512);
    const double count = (double)make.mesh.triangle_count;
    built b = {nullptr, 0, 0};
    zbufrand_scene_info info;
    peer_side p[2] = {peer_ours("zbufrand_scene_build", g_isa), peer_theirs(g_embree_name, "rtcCommitScene, medium quality")}, size[2];
    zbufrand_mesh mesh;
    memset(&info, 0, sizeof info);
    memset(&mesh, 0, sizeof mesh);
    mesh.positions = make.mesh.positions;
    mesh.vertex_count = make.mesh.vertex_count;
    mesh.indices = make.mesh.indices;
    mesh.triangle_count = make.mesh.triangle_count;
    p[0].run = [&] {
        zbufrand_scene *s;
        zbufrand_scene_desc d;
        memset(&d, 0, sizeof d);
        d.env.thread_count = (uint32_t)g_peer_threads;
        must(zbufrand_scene_create(&d, &s), "scene");
        must(zbufrand_add_mesh(s, ZBUFRAND_ROOT, nullptr, 0, &mesh, nullptr), "mesh");
        must(zbufrand_scene_build(s, nullptr, &info), "build");
        zbufrand_scene_destroy(s);
    };
    p[1].run = [&] {
        if (b.scene != nullptr) rtcReleaseScene(b.scene);
        b = build(device, make.mesh);
    };
    peer_time(p, 2, ROUNDS);
    p[0].error = (double)info.skipped_triangles;
    p[0].bytes = (double)info.bytes;
    p[1].bytes = b.bytes;
    for (int i = 0; i < 2; i++) {
        p[i].bytes_each = p[i].bytes / count;
        size[i] = p[i];
        size[i].seconds.clear();
        size[i].value = p[i].bytes_each;
        size[i].method = i == 0 ? "all that pictures need" : "tree, vertices, indices";
    }
    peer_lines("Z7", "build, blob of 1.05 M triangles", "build_seconds", "s", 0, "triangles left out, which have no area", p, 2);
    peer_lines("Z6", "memory, blob of 1.05 M triangles", "bytes_per_triangle", "B", 0, "triangles left out, which have no area", size, 2);
    rtcReleaseScene(b.scene);
    sup_mesh_free(&make.mesh);
}

/* 400 instances of an object of 10^4 triangles, of which one moves, one comes, or a new mesh comes. */
static void edits(RTCDevice device) {
    enum { COUNT = 400 };
    static const char *const kases[3] = {"object of 10^4 triangles among 400 moved",
                                         "an instance of 10^4 triangles inserted among 400", "a new mesh of 10^4 triangles inserted among 400"};
    supi_make make = blob_mesh(50), copy = blob_mesh(50);
    world *w = world_open("edits", (uint32_t)g_peer_threads);
    const zbufrand_node node = supi_world_mesh(&w->w, &make, ZBUFRAND_ROOT, 0, 0, ZBUFRAND_HIDDEN);
    zbufrand_node first = 0;
    RTCScene object = embree_scene(device, copy.mesh, RTC_BUILD_QUALITY_MEDIUM, RTC_SCENE_FLAG_NONE), all = rtcNewScene(device);
    std::vector<RTCScene> own;
    zbufrand_mesh mesh;
    zbufrand_scene_info info;
    double area = 0;
    int step = 0;
    memset(&mesh, 0, sizeof mesh);
    mesh.positions = copy.mesh.positions;
    mesh.vertex_count = copy.mesh.vertex_count;
    mesh.indices = copy.mesh.indices;
    mesh.triangle_count = copy.mesh.triangle_count;
    auto place = [](int i) { return supi_world_place(3.0 * (i % 20), 0.1 * (i % 7), 3.0 * (i / 20), (double)i, 1.0); };
    rtcSetSceneFlags(all, RTC_SCENE_FLAG_DYNAMIC);
    for (int i = 0; i < COUNT; i++) {
        const zbufrand_transform t = place(i);
        must(zbufrand_add_reference(w->w.scene, ZBUFRAND_ROOT, &t, node, i == 0 ? &first : nullptr), "reference");
        embree_instance(device, all, object, &t.m[0][0]);
    }
    world_build(w);
    rtcCommitScene(all);
    area = w->info.area / COUNT;
    double expected = w->info.area;
    for (int k = 0; k < 3; k++) {
        peer_side p[2] = {peer_ours("zbufrand_scene_update", g_isa), peer_theirs(g_embree_name, "rtcCommitScene")};
        p[0].run = [&] {
            const zbufrand_transform t = place(++step);
            if (k == 0) must(zbufrand_move(w->w.scene, first, &t), "move");
            if (k == 1) must(zbufrand_add_reference(w->w.scene, ZBUFRAND_ROOT, &t, node, nullptr), "reference");
            if (k == 2) must(zbufrand_add_mesh(w->w.scene, ZBUFRAND_ROOT, &t, 0, &mesh, nullptr), "mesh");
            must(zbufrand_scene_update(w->w.scene, nullptr), "update");
            expected += k > 0 ? area : 0;
        };
        p[1].run = [&] {
            const zbufrand_transform t = place(step);
            if (k == 0) {
                float m[12];
                RTCGeometry g = rtcGetGeometry(all, 0);
                for (int i = 0; i < 12; i++) m[i] = (float)t.m[i / 4][i % 4];
                rtcSetGeometryTransform(g, 0, RTC_FORMAT_FLOAT3X4_ROW_MAJOR, m);
                rtcCommitGeometry(g);
            }
            if (k == 1) embree_instance(device, all, object, &t.m[0][0]);
            if (k == 2) {
                own.push_back(embree_scene(device, copy.mesh, RTC_BUILD_QUALITY_MEDIUM, RTC_SCENE_FLAG_NONE));
                embree_instance(device, all, own.back(), &t.m[0][0]);
            }
            rtcCommitScene(all);
        };
        peer_time(p, 2, 15);
        zbufrand_scene_get_info(w->w.scene, &info);
        p[0].error = fabs(info.area - expected) / expected;
        p[0].bytes = (double)info.bytes;
        peer_lines("Z8", kases[k], "update_seconds", "s", 0, "of the area of all triangles", p, 2);
    }
    rtcReleaseScene(all);
    rtcReleaseScene(object);
    for (RTCScene s : own) rtcReleaseScene(s);
    sup_mesh_free(&copy.mesh);
    world_free(w);
}

/* ---- instances: world_blobs again, with its transforms ---- */

static std::vector<zbufrand_transform> blob_places(int k) {
    std::vector<zbufrand_transform> t;
    bench_rng rng = {4};
    for (int i = 0; i < k * k * k; i++) {
        const double turn = 6.28318 * (double)bench_random(&rng), x = i % k, y = i / k % k, z = i / k / k;
        const double jx = 1.5 * (double)bench_random(&rng), jy = 1.5 * (double)bench_random(&rng);
        t.push_back(supi_world_place(4.0 * x + jx, 4.0 * y + jy, 4.0 * z + 1.5 * (double)bench_random(&rng), turn, 1.0));
    }
    return t;
}

static void huge(RTCDevice device, const frame_times &one) {
    enum { K = 100 };
    const std::vector<zbufrand_transform> places = blob_places(K);
    supi_make make = blob_mesh(512);
    built b = build(device, make.mesh);
    world *w = world_blobs(K, 0);
    RTCScene all = rtcNewScene(device);
    const long before = g_embree_bytes;
    for (const zbufrand_transform &t : places) embree_instance(device, all, b.scene, &t.m[0][0]);
    rtcCommitScene(all);
    const double bytes = b.bytes + (double)(g_embree_bytes - before), count = (double)places.size();
    const frame_times outside = picture("Z4", "1.05*10^12 triangles, 10^6 instances, from outside", w, all, places.data(), bytes, count,
                                        count, 0, g_opt.full ? 32 : 192, ROUNDS);
    world_set_blobs_inside(w, K, 1);
    (void)picture("Z4", "1.05*10^12 triangles, 10^6 instances, from inside", w, all, places.data(), bytes, count, count, 0, g_opt.full ? 32 : 192, ROUNDS);
    peer_side p[2] = {peer_ours("zbufrand_render", g_isa), peer_theirs(g_embree_name, "intersect16, lit")};
    p[0].value = outside.ours / one.ours;
    p[1].value = outside.theirs / one.theirs;
    for (int i = 0; i < 2; i++) p[i].error = outside.error[i];
    peer_lines("Z5", "growth of a frame from 10^6 to 10^12 triangles", "times", "times", 0, g_rmse, p, 2);
    rtcReleaseScene(all);
    rtcReleaseScene(b.scene);
    sup_mesh_free(&make.mesh);
    world_free(w);
}

int main(int argc, char **argv) {
    const int status = peer_parse(argc, argv, &g_opt);
    if (status) return status;
    peer_machine("embree_zbufrand", argv[0], "zbufrand.h", zbufrand_version());
    RTCDevice device = embree_open(g_peer_threads);
    builds(device);
    if (g_peer_threads == 1) edits(device);
    frame_times one = {NAN, NAN, {NAN, NAN}};
    for (int i = 0; i < 2; i++) {
        const int rows = i == 0 ? 512 : 1448;
        supi_make make = blob_mesh(rows);
        built b = build(device, make.mesh);
        world *w = world_blob(rows);
        const double count = (double)make.mesh.triangle_count;
        if (i == 0) {
            one = picture("Z", "frame of blob, 1.05 M triangles", w, b.scene, nullptr, b.bytes, count, count, 0, 16, ROUNDS);
        } else {
            (void)picture("Z3", "frame of blob, 8.4 M triangles", w, b.scene, nullptr, b.bytes, count, count, 0, 16, ROUNDS);
            (void)picture("Z3", "frame of blob, 8.4 M triangles, ours with a Gaussian of 1.1", w, b.scene, nullptr, b.bytes, count, count, 1, 16, ROUNDS);
        }
        rtcReleaseScene(b.scene);
        sup_mesh_free(&make.mesh);
        world_free(w);
    }
    huge(device, one);
    rtcReleaseDevice(device);
    return 0;
}
