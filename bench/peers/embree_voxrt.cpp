/* embree_voxrt.cpp - the voxels of a mesh against its triangles, traced by Embree 3 - MIT OR Unlicense, see LICENSE

   peer_embree_voxrt [--full] [--threads N] [--data DIR]

   Both trace the same rays, in turn: Embree the 1,048,576 triangles of blob or hall, voxrt their voxels at 512 to 2048.
   What is right are the triangles, traced one by one in Embree's robust mode: the error of both is the share of rays that
   see something else, that is hit where nothing is, miss, or stop more than 1/256 of the box away from the triangle. */
#include "../bench.h"
#include "../../examples/support/mesh.h"
#include "../../examples/support/scenes.h"
#define VOXRT_IMPLEMENTATION
#include "../../voxrt.h"
#include "peer.h"
#include "../bench_models.h"
#include "embree_rays.h"

enum { ROUNDS = 5 };
static const char *const g_isa = voxrt_isa_name(voxrt_isa_best());
static const char *const g_share = "% of rays that see something else";

/* A mesh as Embree has it: the scene that is measured and the one that is right. */
struct triangles {
    RTCScene scene, robust;
    double bytes, build_bytes_each;
    float box;                       /* longest side */
    size_t count;
};

static triangles open_triangles(RTCDevice device, const sup_mesh &m) {
    triangles t;
    float lo[3], hi[3];
    const long before = g_embree_bytes;
    t.scene = embree_scene(device, m, RTC_BUILD_QUALITY_MEDIUM, RTC_SCENE_FLAG_NONE);
    t.bytes = (double)(g_embree_bytes - before);
    t.count = m.triangle_count;
    t.build_bytes_each = t.bytes / (double)t.count;
    t.robust = embree_scene(device, m, RTC_BUILD_QUALITY_MEDIUM, RTC_SCENE_FLAG_ROBUST);
    (void)sup_mesh_bounds(&m, lo, hi);
    t.box = std::max(hi[0] - lo[0], std::max(hi[1] - lo[1], hi[2] - lo[2]));
    return t;
}

static void fill(embree_rays &e, const rayset &s) {
    for (size_t i = 0; i < s.count; i++) e.set(i, s.ray[i].org, s.ray[i].dir);
}

static double share_off(const std::vector<float> &right, const std::function<float(size_t)> &said, float most) {
    size_t off = 0;
    for (size_t i = 0; i < right.size(); i++) {
        const float t = said(i);
        off += (t < INFINITY) != (right[i] < INFINITY) || (t < INFINITY && fabsf(t - right[i]) > most);
    }
    return 100.0 * (double)off / (double)right.size();
}

static void trace_voxels(const voxrt_tree *tree, const rayset &s, voxrt_hit *hit, uint8_t *hidden) {
    peer_for(s.count, 4096, [&](size_t first, size_t end) {
        if (hidden != nullptr) must(voxrt_occluded(tree, nullptr, s.ray + first, hidden + first, end - first), "occluded");
        else must(voxrt_trace(tree, nullptr, s.ray + first, hit + first, end - first), "trace");
    });
}

static std::vector<float> exact_distances(const triangles &t, const rayset &s) {
    embree_rays e(s.count, false);
    std::vector<float> right(s.count);
    fill(e, s);
    e.trace1(t.robust);
    for (size_t i = 0; i < s.count; i++) right[i] = e.t1(i);
    return right;
}

/* Closest hits; any: whether there is one. also: a second row that it answers, or NULL. */
static void compare(const char *id, const char *kase, const triangles &t, const voxrt_tree *tree, const rayset &s, bool coherent, bool any,
                    const char *also = nullptr) {
    const std::vector<float> right = exact_distances(t, s);
    std::vector<voxrt_hit> hit(s.count);
    std::vector<uint8_t> hidden(s.count);
    embree_rays e(s.count, coherent);
    voxrt_tree_info info;
    peer_side p[3] = {peer_ours(any ? "voxrt_occluded" : "voxrt_trace", g_isa),
                      peer_theirs(g_embree_name, any ? "occluded16" : "intersect16"),
                      peer_theirs(g_embree_name, any ? "occluded1" : "intersect1")};
    voxrt_tree_get_info(tree, &info);
    fill(e, s);
    p[0].run = [&] { trace_voxels(tree, s, hit.data(), any ? hidden.data() : nullptr); };
    if (any) {
        p[1].run = [&] { e.occluded16(t.scene); };
        p[2].run = [&] { e.occluded1(t.scene); };
    } else {
        p[1].run = [&] { e.trace16(t.scene); };
        p[2].run = [&] { e.trace1(t.scene); };
    }
    peer_time(p, 3, ROUNDS);
    p[0].bytes = (double)info.geometry_bytes;
    p[0].bytes_each = (double)info.geometry_bytes / (double)info.voxel_count;
    for (int i = 1; i < 3; i++) {
        p[i].bytes = t.bytes;
        p[i].bytes_each = t.build_bytes_each;
    }
    if (any) {
        size_t off[3] = {0, 0, 0};
        for (size_t i = 0; i < s.count; i++) off[0] += (hidden[i] != 0) != (right[i] < INFINITY);
        for (int k = 1; k < 3; k++) { /* both write into the same bytes */
            p[k].run();
            for (size_t i = 0; i < s.count; i++) off[k] += (e.hidden[i] != 0) != (right[i] < INFINITY);
        }
        for (int k = 0; k < 3; k++) p[k].error = 100.0 * (double)off[k] / (double)s.count;
        p[0].hash = bench_hash_bytes(hidden.data(), hidden.size());
    } else {
        p[0].error = share_off(right, [&](size_t i) { return hit[i].node != VOXRT_NO_NODE ? hit[i].t : INFINITY; }, t.box / 256.0f);
        p[1].error = share_off(right, [&](size_t i) { return e.t16(i); }, t.box / 256.0f);
        p[2].error = share_off(right, [&](size_t i) { return e.t1(i); }, t.box / 256.0f);
        p[0].hash = hash_hits(hit.data(), hit.size());
    }
    peer_lines(id, kase, "rays_per_second", "1/s", (double)s.count, g_share, p, 3);
    if (also != nullptr) peer_lines(also, (std::string(kase) + ", against triangles").c_str(), "rays_per_second", "1/s", (double)s.count, g_share, p, 3);
}

static size_t g_held; /* by an allocator that counts */
static void *counted_alloc(size_t size, void *) {
    void *p = malloc(size);
    if (p != nullptr) g_held += size;
    return p;
}
static void counted_free(void *p, size_t size, void *) {
    if (p != nullptr) g_held -= size;
    free(p);
}

/* 1000 instances, turned and moved; camera rays from outside. voxrt: a group of instances of one tree. */
static void instances(RTCDevice device, const triangles &t, const voxrt_tree *tree) {
    enum { K = 10, COUNT = K * K * K };
    std::vector<voxrt_instance> instance(COUNT);
    std::vector<voxrt_geometry> geometry(COUNT);
    bench_rng rng = {4};
    RTCScene scene[2] = {rtcNewScene(device), rtcNewScene(device)};
    const long before = g_embree_bytes;
    voxrt_geometry whole;
    voxrt_group *group;
    voxrt_camera c;
    voxrt_tree_info info;
    voxrt_tree_get_info(tree, &info);
    for (int i = 0; i < COUNT; i++) {
        const double turn = 6.28318 * (double)bench_random(&rng), cs = cos(turn), sn = sin(turn);
        double m[12] = {cs, 0, sn, 0, 0, 1, 0, 0, -sn, 0, cs, 0};
        const int at[3] = {i % K, i / K % K, i / K / K};
        for (int a = 0; a < 3; a++) m[4 * a + 3] = 4.0 * at[a] + 1.5 * (double)bench_random(&rng);
        memset(&instance[(size_t)i], 0, sizeof instance[0]);
        voxrt_tree_geometry(tree, &instance[(size_t)i].geometry);
        memcpy(instance[(size_t)i].to_world, m, sizeof m);
        must(voxrt_instance_geometry(&instance[(size_t)i], &geometry[(size_t)i]), "instance");
        embree_instance(device, scene[0], t.scene, m);
    }
    rtcCommitScene(scene[0]);
    const double embree_each = (double)(g_embree_bytes - before) / COUNT;
    rtcSetSceneFlags(scene[1], RTC_SCENE_FLAG_ROBUST);
    for (int i = 0; i < COUNT; i++) embree_instance(device, scene[1], t.robust, instance[(size_t)i].to_world);
    rtcCommitScene(scene[1]);
    voxrt_env env;
    memset(&env, 0, sizeof env);
    env.allocator.alloc_fn = counted_alloc;
    env.allocator.free_fn = counted_free;
    g_held = 0;
    must(voxrt_group_create(&env, geometry.data(), geometry.size(), &group), "group");
    const double group_each = (double)g_held / COUNT;
    voxrt_group_geometry(group, &whole);

    rayset s = make_rayset(1024 * 768);
    memset(&c, 0, sizeof c);
    const double eye[3] = {-0.6 * 4 * K, 0.9 * 4 * K, -0.8 * 4 * K}, to[3] = {2.0 * K, 1.6 * K, 2.0 * K};
    for (int a = 0; a < 3; a++) {
        c.eye[a] = eye[a];
        c.at[a] = to[a];
    }
    c.fov_y = 45.0f;
    voxrt_ray *out = s.ray;
    for (uint32_t y = 0; y < 768; y += 8)
        for (uint32_t x = 0; x < 1024; x += 8)
            for (uint32_t i = 0; i < 64; i++, out++) {
                must(voxrt_camera_ray(&c, 1024, 768, x + (i & 7u) + 0.5, y + (i >> 3) + 0.5, out), "camera ray");
            }
    embree_rays e(s.count, true);
    std::vector<voxrt_surface> seen(s.count);
    std::vector<float> right(s.count);
    fill(e, s);
    e.trace1(scene[1]);
    for (size_t i = 0; i < s.count; i++) right[i] = e.t1(i);
    peer_side p[3] = {peer_ours("voxrt_group", g_isa), peer_theirs(g_embree_name, "intersect16"), peer_theirs(g_embree_name, "intersect1")};
    p[0].run = [&] {
        peer_for(s.count, 4096, [&](size_t first, size_t end) {
            voxrt_trace_desc d;
            memset(&d, 0, sizeof d);
            for (size_t i = first; i < end; i += 64) whole.trace_fn(whole.user, &d, s.ray + i, &seen[i], std::min(end - i, (size_t)64));
        });
    };
    p[1].run = [&] { e.trace16(scene[0]); };
    p[2].run = [&] { e.trace1(scene[0]); };
    peer_time(p, 3, ROUNDS);
    p[0].error = share_off(right, [&](size_t i) { return seen[i].t; }, t.box / 256.0f);
    p[1].error = share_off(right, [&](size_t i) { return e.t16(i); }, t.box / 256.0f);
    p[2].error = share_off(right, [&](size_t i) { return e.t1(i); }, t.box / 256.0f);
    p[0].bytes_each = group_each + sizeof(voxrt_instance);
    p[0].bytes = (double)info.total_bytes + COUNT * p[0].bytes_each;
    for (int i = 1; i < 3; i++) {
        p[i].bytes_each = embree_each;
        p[i].bytes = t.bytes + COUNT * embree_each;
    }
    peer_lines("V", "1000 instances of blob 512, camera rays", "rays_per_second", "1/s", (double)s.count, g_share, p, 3);
    free_rayset(&s);
    voxrt_group_destroy(group);
    for (RTCScene i : scene) rtcReleaseScene(i);
}

/* Camera rays through what each side made for the frame: p[0] fat cells, p[1] Embree's, p[2] thin cells. */
static void moved_errors(peer_side *p, const triangles &t, voxrt_columns *columns, RTCScene scene) {
    rayset s = peer_rays("blob");
    const std::vector<float> right = exact_distances(t, s);
    std::vector<voxrt_column_hit> hit(s.count);
    embree_rays e(s.count, true);
    fill(e, s);
    e.trace16(scene);
    p[1].error = share_off(right, [&](size_t i) { return e.t16(i); }, t.box / 256.0f);
    for (int i = 0; i < 3; i += 2) {
        p[i].run();
        must(voxrt_columns_trace(columns, nullptr, s.ray, hit.data(), s.count), "rays in columns");
        p[i].error = share_off(right, [&](size_t k) { return hit[k].t; }, t.box / 256.0f);
    }
    free_rayset(&s);
}

/* A mesh of a million triangles that moves in each frame: its cells in a grid of 256^3, or triangles to be found again. */
static void moving(RTCDevice device, const triangles &t, const sup_mesh &m) {
    voxrt_columns_desc cd;
    voxrt_columns *columns;
    voxrt_columns_insert_desc d;
    voxrt_columns_info info;
    voxrt_build_desc box;
    const voxrt_mesh mesh = sup_voxel_mesh(&m);
    memset(&cd, 0, sizeof cd);
    memset(&d, 0, sizeof d);
    memset(&box, 0, sizeof box);
    peer_box(&m, &box);
    cd.size_x = cd.size_y = cd.size_z = 256;
    for (int a = 0; a < 3; a++) {
        cd.box_min[a] = box.box_min[a];
        cd.box_max[a] = box.box_min[a] + box.box_size;
    }
    must(voxrt_columns_create(&cd, &columns), "columns");
    d.env.thread_count = (uint32_t)g_peer_threads;
    d.mode = VOXRT_COLUMNS_FAT; /* every cell that is touched, as the trees of this comparison */
    RTCScene scene = rtcNewScene(device);
    rtcSetSceneFlags(scene, RTC_SCENE_FLAG_DYNAMIC);
    rtcSetSceneBuildQuality(scene, RTC_BUILD_QUALITY_LOW);
    const long before = g_embree_bytes;
    RTCGeometry g = embree_geometry(device, m, RTC_BUILD_QUALITY_LOW);
    rtcAttachGeometry(scene, g);
    peer_side p[3] = {peer_ours("voxrt_columns_insert, FAT", g_isa), peer_theirs(g_embree_name, "low quality build"),
                      peer_ours("voxrt_columns_insert, THIN", g_isa)};
    p[0].run = [&] {
        d.mode = VOXRT_COLUMNS_FAT;
        voxrt_columns_clear(columns, 1);
        must(voxrt_columns_insert(columns, &d, &mesh, nullptr), "insert");
        voxrt_columns_update(columns);
    };
    p[1].run = [&] {
        rtcUpdateGeometryBuffer(g, RTC_BUFFER_TYPE_VERTEX, 0);
        rtcCommitGeometry(g);
        rtcCommitScene(scene);
    };
    p[2].run = [&] {
        d.mode = VOXRT_COLUMNS_THIN;
        voxrt_columns_clear(columns, 1);
        must(voxrt_columns_insert(columns, &d, &mesh, nullptr), "insert");
        voxrt_columns_update(columns);
    };
    peer_time(p, 3, ROUNDS);
    voxrt_columns_get_info(columns, &info);
    moved_errors(p, t, columns, scene);
    for (int i = 0; i < 3; i += 2) {
        p[i].bytes = (double)info.bytes + 12.0 * (double)m.vertex_count + 12.0 * (double)m.triangle_count;
        p[i].bytes_each = p[i].bytes / (double)m.triangle_count;
    }
    p[1].bytes = (double)(g_embree_bytes - before);
    p[1].bytes_each = p[1].bytes / (double)m.triangle_count;
    peer_lines("V10", "blob, 1.05 M triangles, anew into 256^3", "frame_seconds", "s", 0, g_share, p, 2);
    peer_side thin[2] = {p[2], p[1]};
    peer_lines("V10", "blob, 1.05 M triangles, anew into 256^3, thin cells", "frame_seconds", "s", 0, g_share, thin, 2);
    rtcReleaseGeometry(g);
    rtcReleaseScene(scene);
    voxrt_columns_destroy(columns);
}

/* A frame with global light: camera rays, and from each hit a shadow ray, a diffuse ray and four for ambient occlusion. */
static void light(const char *kase, const triangles &t, const voxrt_tree *tree, const rayset &first) {
    rayset s[4] = {second_rays(tree, &first, SECOND_COSINE, 0.0f), make_rayset(0), make_rayset(0), make_rayset(0)};
    const size_t n = s[0].count;
    bench_rng rng = {99};
    free_rayset(&s[1]);
    free_rayset(&s[2]);
    free_rayset(&s[3]);
    s[1] = make_rayset(n); /* shadow */
    s[2] = make_rayset(4 * n);
    for (size_t i = 0; i < n; i++) {
        static const float lamp[3] = {0.365148f, 0.730297f, 0.577350f};
        s[1].ray[i] = s[0].ray[i];
        memcpy(s[1].ray[i].dir, lamp, sizeof lamp);
        for (size_t k = 0; k < 4; k++) {
            voxrt_ray &r = s[2].ray[4 * i + k];
            r = s[0].ray[i];
            bench_cosine(&rng, s[0].ray[i].dir, r.dir);
        }
    }
    std::vector<voxrt_hit> hit(std::max(first.count, n));
    std::vector<uint8_t> hidden(4 * n);
    embree_rays e0(first.count, true), e1(n, false), e2(n, false), e3(4 * n, false);
    fill(e0, first);
    fill(e1, s[0]);
    fill(e2, s[1]);
    fill(e3, s[2]);
    peer_side p[2] = {peer_ours("voxrt_trace, voxrt_occluded", g_isa), peer_theirs(g_embree_name, "intersect16, occluded1")};
    p[0].run = [&] {
        trace_voxels(tree, first, hit.data(), nullptr);
        trace_voxels(tree, s[0], hit.data(), nullptr);
        trace_voxels(tree, s[1], nullptr, hidden.data());
        trace_voxels(tree, s[2], nullptr, hidden.data());
    };
    p[1].run = [&] {
        e0.trace16(t.scene);
        e1.trace1(t.scene);
        e2.occluded16(t.scene);
        e3.occluded1(t.scene);
    };
    peer_time(p, 2, ROUNDS);
    const std::vector<float> right = exact_distances(t, s[2]);
    size_t off[2] = {0, 0};
    for (size_t i = 0; i < right.size(); i++) {
        off[0] += (hidden[i] != 0) != (right[i] < INFINITY);
        off[1] += (e3.hidden[i] != 0) != (right[i] < INFINITY);
    }
    for (int i = 0; i < 2; i++) p[i].error = 100.0 * (double)off[i] / (double)right.size();
    p[1].bytes = t.bytes;
    p[1].bytes_each = t.build_bytes_each;
    voxrt_tree_info info;
    voxrt_tree_get_info(tree, &info);
    p[0].bytes = (double)info.geometry_bytes;
    p[0].bytes_each = p[0].bytes / (double)info.voxel_count;
    peer_lines("V11", kase, "frame_seconds", "s", 0, "% of occlusion rays that see something else", p, 2);
    for (int i = 0; i < 3; i++) free_rayset(&s[i]);
}

/* From inside a closed mesh at its vertices and middles of edges: what gets out. */
static void leaks(const triangles &t, const sup_mesh &m, const voxrt_tree *tree) {
    static const char *const kases[2] = {"at all vertices of the closed blob", "at middles of its edges"};
    for (int k = 0; k < 2; k++) {
        std::vector<float> at;
        for (size_t i = 0; k == 0 && i < 3 * m.vertex_count; i++) at.push_back(m.positions[i]);
        for (size_t i = 0; k == 1 && i < 3 * m.triangle_count && at.size() < 3u << 20; i++) {
            const size_t p = m.indices[i], q = m.indices[i % 3 == 2 ? i - 2 : i + 1];
            if (p < q) for (size_t a = 0; a < 3; a++) at.push_back(0.5f * (m.positions[3 * p + a] + m.positions[3 * q + a]));
        }
        rayset s = inner_rays(at.data(), at.size() / 3, 7);
        char kase[128];
        std::vector<voxrt_hit> hit(s.count);
        embree_rays e(s.count, false);
        peer_side p[3] = {peer_ours("voxrt_trace", g_isa), peer_theirs(g_embree_name, "intersect1"), peer_theirs(g_embree_name, "intersect1, robust")};
        fill(e, s);
        trace_voxels(tree, s, hit.data(), nullptr);
        p[0].value = (double)(s.count - count_hits(hit.data(), s.count));
        for (int i = 1; i < 3; i++) {
            size_t out = 0;
            e.trace1(i == 1 ? t.scene : t.robust);
            for (size_t l = 0; l < s.count; l++) out += !(e.t1(l) < INFINITY);
            p[i].value = (double)out;
        }
        for (peer_side &i : p) i.error = 100.0 * i.value / (double)s.count;
        snprintf(kase, sizeof kase, "rays %s that get out, of %zu", kases[k], s.count);
        peer_lines("V12", kase, "escaped_rays", "rays", 0, "% of rays that get out", p, 3);
        free_rayset(&s);
    }
}

int main(int argc, char **argv) {
    const int status = peer_parse(argc, argv, &g_opt);
    if (status) return status;
    peer_machine("embree_voxrt", argv[0], "voxrt.h", voxrt_version());
    RTCDevice device = embree_open(g_peer_threads);
    for (int id = MODEL_BLOB; id <= (access(g_opt.data, R_OK) == 0 ? MODEL_DRAGON : MODEL_HALL); id++) {
        const model *m = get_model(id);
        if (m == nullptr) continue;
        const triangles t = open_triangles(device, m->mesh);
        for (uint32_t r = 512; r <= (g_peer_threads > 1 && !g_opt.full ? 1024u : 2048u); r *= 2) {
            if (id == MODEL_DRAGON && r != 1024) continue;
            const voxrt_tree *tree = get_tree(id, r, KIND_PEER);
            const char *const row = r == 512 ? "V1" : r == 1024 ? "V2" : "V3";
            char kase[64];
            rayset first = id == MODEL_DRAGON ? camera_rays(tree, 1024, 768) : peer_rays(m->name);
            rayset diffuse = second_rays(tree, &first, SECOND_COSINE, 0.0f), chords = chord_rays(tree, first.count / 4);
            snprintf(kase, sizeof kase, "%s %u, camera rays", m->name, r);
            compare(id == MODEL_DRAGON ? "V" : row, kase, t, tree, first, true, false);
            if (id != MODEL_HALL || r == 1024) {
                snprintf(kase, sizeof kase, "%s %u, diffuse rays", m->name, r);
                compare(id == MODEL_BLOB ? "V4" : "V", kase, t, tree, diffuse, false, false, id == MODEL_BLOB && r == 1024 ? "V6" : nullptr);
            }
            if (id == MODEL_BLOB && r >= 1024) {
                snprintf(kase, sizeof kase, "%s %u, random rays", m->name, r);
                compare(r == 2048 ? "V5" : "V", kase, t, tree, chords, false, false);
            }
            if (id != MODEL_HALL && r == 1024) {
                snprintf(kase, sizeof kase, "%s %u, camera rays, any hit", m->name, r);
                compare("V", kase, t, tree, first, true, true);
                snprintf(kase, sizeof kase, "%s %u, diffuse rays, any hit", m->name, r);
                compare("V", kase, t, tree, diffuse, false, true);
            }
            if (id != MODEL_DRAGON && r == 512) {
                snprintf(kase, sizeof kase, "%s 512, light of a frame", m->name);
                light(kase, t, tree, first);
            }
            if (id == MODEL_BLOB && r == 512) instances(device, t, tree);
            if (id == MODEL_BLOB && r == 1024 && g_peer_threads == 1) leaks(t, m->mesh, tree);
            free_rayset(&first);
            free_rayset(&diffuse);
            free_rayset(&chords);
            drop_trees();
        }
        if (id == MODEL_BLOB) moving(device, t, m->mesh);
        rtcReleaseScene(t.scene);
        rtcReleaseScene(t.robust);
    }
    rtcReleaseDevice(device);
    for (int id = 0; id < MODEL_COUNT; id++) sup_mesh_free(&g_models[id].mesh);
    return 0;
}
