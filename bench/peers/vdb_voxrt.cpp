/* vdb_voxrt.cpp - the same voxels in NanoVDB's masks and as OpenVDB's distances - MIT OR Unlicense, see LICENSE

   peer_vdb_voxrt [--full] [--threads N] [--data DIR]

   Both get the same filled cells in grid units and the same rays in floats. NanoVDB looks for the first active voxel of a
   mask grid (firstActive), OpenVDB and NanoVDB for the zero of the distance field of the mesh (LevelSetRayIntersector,
   ZeroCrossing). What is right is stepping through the cells in exact arithmetic (tests/oracle.h). */
#include "../bench.h"
#include "../../examples/support/mesh.h"
#include "../../examples/support/scenes.h"
#define VOXRT_IMPLEMENTATION
#include "../../voxrt.h"
#include "peer.h"
#include "../../tests/oracle.h"
#include "../bench_models.h"
#include <openvdb/openvdb.h>
#include <openvdb/tools/Interpolation.h>
#include <openvdb/tools/MeshToVolume.h>
#include <openvdb/tools/RayIntersector.h>
#include <tbb/global_control.h>
#if PEER_NANOVDB
#  include <nanovdb/util/OpenToNanoVDB.h>
#  include <nanovdb/util/HDDA.h>
#  include <nanovdb/util/Ray.h>
#endif

enum { ROUNDS = 5 };
static size_t every(void) { return g_opt.full ? 1 : 16; } /* of the rays: stepped exactly */
static const char *const g_isa = voxrt_isa_name(voxrt_isa_best());
static const char g_openvdb[] = "OpenVDB " OPENVDB_LIBRARY_VERSION_STRING, g_nanovdb[] = "NanoVDB";

/* ---- voxels in grid units ---- */

struct cells {
    voxrt_tree *tree = nullptr;
    voxrt_tree_info info, from;       /* in grid units; as it was in the world */
    std::vector<voxrt_voxel> list;
    oracle_grid grid;
};

static int take_voxel(void *user, const voxrt_voxel *v, uint32_t) {
    ((std::vector<voxrt_voxel> *)user)->push_back(*v);
    return 0;
}

static void cells_open(cells *c, const voxrt_tree *tree) {
    voxrt_build_desc d;
    const int32_t lo[3] = {0, 0, 0};
    memset(&d, 0, sizeof d);
    memset(&c->grid, 0, sizeof c->grid);
    d.env.thread_count = (uint32_t)g_opt.threads;
    d.disable_colors = d.disable_normals = 1;
    voxrt_tree_get_info(tree, &c->from);
    c->list.reserve(c->from.voxel_count);
    (void)voxrt_tree_each(tree, c->from.depth, take_voxel, &c->list);
    must(voxrt_tree_from_voxels(&d, c->list.data(), c->list.size(), c->from.depth, &c->tree), "voxels");
    voxrt_tree_get_info(c->tree, &c->info);
    if (c->from.depth > 10) return; /* too large for a dense grid of bits */
    const int32_t n[3] = {1 << c->from.depth, 1 << c->from.depth, 1 << c->from.depth};
    if (!oracle_grid_make(&c->grid, lo, n)) run_failed("oracle", "not enough memory");
    for (const voxrt_voxel &v : c->list) oracle_set(&c->grid, (int32_t)v.x, (int32_t)v.y, (int32_t)v.z);
}

static void cells_close(cells *c) {
    voxrt_tree_destroy(c->tree);
    free(c->grid.bits);
}

/* The rays again from where they start in the grid. */
static void into_grid(rayset *s, const voxrt_tree_info *info) {
    for (size_t i = 0; i < s->count; i++)
        for (int a = 0; a < 3; a++)
            s->ray[i].org[a] = (float)(((double)s->ray[i].org[a] - info->world_origin[a]) / info->voxel_size);
}

static oracle_ray exact_ray(const voxrt_ray *r) {
    oracle_ray o;
    memset(&o, 0, sizeof o);
    for (int a = 0; a < 3; a++) {
        o.o[a] = (double)r->org[a];
        o.d[a] = (double)r->dir[a];
    }
    o.t_min = (double)r->t_min;
    o.t_max = (double)r->t_max;
    return o;
}

struct wrong_rays { double all, hits, cells; };

/* Of every 16th ray, with --full of all: how many are hits and should be misses or the other way round, how many end in another cell than exact
   stepping. */
static wrong_rays judge_rays(const cells *c, const rayset *s, const std::vector<voxrt_hit> &hit) {
    wrong_rays w = {0, 0, 0};
    if (c->grid.bits == nullptr) return wrong_rays{1, NAN, NAN};
    for (size_t i = 0; i < s->count; i += every(), w.all += 1) {
        const oracle_ray r = exact_ray(&s->ray[i]);
        oracle_hit said, first;
        memset(&said, 0, sizeof said);
        memset(&first, 0, sizeof first);
        for (int a = 0; a < 3; a++) said.cell[a] = (int32_t)hit[i].cell[a];
        said.hit = hit[i].node != VOXRT_NO_NODE;
        said.t = (double)hit[i].t;
        said.face = hit[i].face;
        const char *why = oracle_judge(&c->grid, &r, &said, &first);
        const int wrong = why != nullptr && strncmp(why, "t is", 4) != 0 && strncmp(why, "not the face", 12) != 0;
        w.cells += wrong;
        w.hits += wrong && (said.hit != 0) != (first.hit != 0);
    }
    return w;
}

/* % of these rays that stop more than 1/256 of the grid away from where exact stepping stops. */
static double far_off(const cells *c, const rayset *s, const std::vector<float> &t) {
    size_t wrong = 0, all = 0;
    for (size_t i = 0; i < s->count; i += every(), all++) {
        const oracle_ray r = exact_ray(&s->ray[i]);
        oracle_hit first;
        memset(&first, 0, sizeof first);
        (void)oracle_judge(&c->grid, &r, nullptr, &first);
        const int hit = first.hit != 0;
        wrong += (t[i] < INFINITY) != (hit != 0) || (hit && fabs((double)t[i] - first.t) > (double)(1u << c->from.depth) / 256.0);
    }
    return 100.0 * (double)wrong / (double)all;
}

static void trace_voxels(const voxrt_tree *tree, const rayset &s, voxrt_hit *hit) {
    peer_for(s.count, 4096, [&](size_t first, size_t end) {
        must(voxrt_trace(tree, nullptr, s.ray + first, hit + first, end - first), "trace");
    });
}

static void put_sizes(peer_side *p, double bytes, const cells &c) {
    p->bytes = bytes;
    p->bytes_each = bytes / (double)c.list.size();
}

/* Rays whose hit differs in any bit from that of the scalar code, for each instruction set that the machine has. */
static void same_bits(const char *kase, const cells &c, const rayset *const *sets, int count) {
    size_t differ = 0, all = 0;
    std::string names;
    for (int k = 0; k < count; k++) {
        const rayset &s = *sets[k];
        std::vector<voxrt_hit> hit[2] = {std::vector<voxrt_hit>(s.count), std::vector<voxrt_hit>(s.count)};
        for (int isa = VOXRT_ISA_SCALAR; isa <= VOXRT_ISA_AVX512; isa++) {
            voxrt_trace_desc d;
            if (isa > (int)voxrt_isa_best() && !(isa == VOXRT_ISA_AVX512 && __builtin_cpu_supports("avx512f"))) continue;
            memset(&d, 0, sizeof d);
            d.isa = (voxrt_isa)isa;
            memset(hit[isa > VOXRT_ISA_SCALAR].data(), 0, s.count * sizeof(voxrt_hit));
            must(voxrt_trace(c.tree, &d, s.ray, hit[isa > VOXRT_ISA_SCALAR].data(), s.count), "trace");
            if (k == 0) names += (names.empty() ? "" : ", ") + std::string(voxrt_isa_name((voxrt_isa)isa));
            for (size_t i = 0; i < s.count && isa > VOXRT_ISA_SCALAR; i++) differ += memcmp(&hit[0][i], &hit[1][i], sizeof(voxrt_hit)) != 0;
        }
        all += s.count;
    }
    peer_side p = peer_ours("", g_isa);
    p.method = "voxrt_trace: " + names;
    p.value = (double)differ;
    p.error = 100.0 * (double)differ / (double)all;
    char text[128];
    snprintf(text, sizeof text, "%s, camera, diffuse, random: hits of other bits than scalar, of %zu rays", kase, all);
    peer_lines("V12", text, "rays", "rays", 0, "% of rays whose hits differ between instruction sets", &p, 1);
}

/* ---- masks ---- */

#if PEER_NANOVDB
typedef nanovdb::GridHandle<nanovdb::HostBuffer> nano_handle;

static nano_handle nano_mask(const cells &c) {
    openvdb::BoolGrid::Ptr grid = openvdb::BoolGrid::create(false);
    {
        auto at = grid->getAccessor();
        for (const voxrt_voxel &v : c.list) at.setValueOn(openvdb::Coord((int)v.x, (int)v.y, (int)v.z), true);
    }
    openvdb::MaskGrid mask(*grid);
    return nanovdb::openToNanoVDB<nanovdb::HostBuffer, openvdb::MaskTree, nanovdb::ValueMask>(mask);
}

static void first_active(const char *id, const char *kase, const cells &c, nano_handle &h, const rayset &s) {
    auto *grid = h.grid<nanovdb::ValueMask>();
    std::vector<voxrt_hit> hit[2] = {std::vector<voxrt_hit>(s.count), std::vector<voxrt_hit>(s.count)};
    peer_side p[2] = {peer_ours("voxrt_trace", g_isa), peer_theirs(g_nanovdb, "firstActive, mask grid")};
    p[0].run = [&] { trace_voxels(c.tree, s, hit[0].data()); };
    p[1].run = [&] {
        peer_for(s.count, 4096, [&](size_t first, size_t end) {
            auto at = grid->getAccessor();
            for (size_t i = first; i < end; i++) {
                const voxrt_ray &q = s.ray[i];
                nanovdb::Ray<float> r(nanovdb::Vec3f(q.org[0], q.org[1], q.org[2]), nanovdb::Vec3f(q.dir[0], q.dir[1], q.dir[2]));
                nanovdb::Coord cell;
                voxrt_hit &out = hit[1][i];
                float t = 0.0f;
                out.node = nanovdb::firstActive(r, at, cell, t) ? 0 : VOXRT_NO_NODE;
                out.t = t;
                for (int a = 0; a < 3; a++) out.cell[a] = (uint32_t)cell[a];
            }
        });
    };
    peer_time(p, 2, ROUNDS);
    const wrong_rays w[2] = {judge_rays(&c, &s, hit[0]), judge_rays(&c, &s, hit[1])};
    for (int i = 0; i < 2; i++) p[i].error = 100.0 * w[i].hits / w[i].all;
    put_sizes(&p[0], (double)c.info.geometry_bytes, c);
    put_sizes(&p[1], (double)h.size(), c);
    p[0].hash = hash_hits(hit[0].data(), s.count);
    peer_lines(id, kase, "rays_per_second", "1/s", (double)s.count, "% of rays that hit or miss otherwise than by exact stepping", p, 2);
    if (c.grid.bits == nullptr || g_peer_threads > 1) return;
    for (int i = 0; i < 2; i++) {
        p[i].seconds.clear();
        p[i].value = w[i].cells;
        p[i].error = 100.0 * w[i].cells / w[i].all;
    }
    char judged[128];
    snprintf(judged, sizeof judged, "%s: wrong cells, of %.0f rays%s", kase, w[0].all, every() > 1 ? ", each 16th" : "");
    peer_lines("V12", judged, "wrong_rays", "rays", 0, "% of rays that end in another cell than by exact stepping", p, 2);
}

static void mask_sizes(const cells &c, const nano_handle &h, const char *kase) {
    voxrt_tree *shared = nullptr;
    voxrt_tree_info info;
    peer_side p[2] = {peer_ours("tree", g_isa), peer_theirs(g_nanovdb, "mask grid")};
    must(voxrt_tree_share(c.tree, nullptr, &shared), "share");
    voxrt_tree_get_info(shared, &info);
    put_sizes(&p[1], (double)h.size(), c);
    p[1].value = p[1].bytes_each;
    p[1].error = (double)c.list.size() - (double)h.grid<nanovdb::ValueMask>()->activeVoxelCount();
    for (int i = 0; i < 2; i++) {
        put_sizes(&p[0], (double)(i == 0 ? c.info.geometry_bytes : info.geometry_bytes), c);
        p[0].value = p[0].bytes_each;
        p[0].error = (double)c.list.size() - (double)(i == 0 ? c.info.voxel_count : info.voxel_count);
        if (i == 1) p[0].method = "tree, equal parts once";
        const std::string text = std::string(kase) + ", geometry" + (i == 0 ? "" : ", ours with equal parts once");
        peer_lines("V7", text.c_str(), "bytes_per_voxel", "B", 0, "voxels lost", p, 2);
    }
    voxrt_tree_destroy(shared);
}
#endif

/* ---- distances ---- */

/* % of the vertices of a mesh whose cell is empty. */
static double cells_missed(const voxrt_tree *tree, const sup_mesh &mesh) {
    cells c;
    size_t missed = 0;
    cells_open(&c, tree);
    for (size_t i = 0; i < mesh.vertex_count; i++) {
        int32_t at[3];
        for (size_t a = 0; a < 3; a++) at[a] = (int32_t)floor(((double)mesh.positions[3 * i + a] - c.from.world_origin[a]) / c.from.voxel_size);
        missed += !oracle_get(&c.grid, at[0], at[1], at[2]);
    }
    cells_close(&c);
    return 100.0 * (double)missed / (double)mesh.vertex_count;
}

/* % of points at which the field is more than half a cell away from 0. */
static double distances_missed(const openvdb::FloatGrid &grid, const std::vector<openvdb::Vec3s> &points) {
    openvdb::tools::GridSampler<openvdb::FloatGrid, openvdb::tools::BoxSampler> at(grid);
    size_t missed = 0;
    for (const openvdb::Vec3s &p : points) missed += !(fabsf(at.isSample(openvdb::Vec3R(p))) <= 0.5f);
    return 100.0 * (double)missed / (double)points.size();
}

/* sRGB bytes of all voxels, in Morton order. */
static std::vector<uint8_t> colours_of(const voxrt_tree *tree) {
    struct { const uint8_t *palette; std::vector<uint8_t> rgb; } to;
    voxrt_tree_info info;
    voxrt_tree_get_info(tree, &info);
    to.palette = voxrt_tree_palette(tree, nullptr);
    voxrt_tree_each(tree, info.depth, [](void *user, const voxrt_voxel *, uint32_t i) {
        decltype(to) *t = (decltype(to) *)user;
        t->rgb.insert(t->rgb.end(), t->palette + 3 * (size_t)i, t->palette + 3 * (size_t)i + 3);
        return 0;
    }, &to);
    return to.rgb;
}

/* Bytes of files with a normal for each vertex and a colour of its own, which 2^24 colours keep and fewer do not. */
static void files_with_colours(const char *name, const voxrt_mesh &mesh, uint32_t resolution) {
    static const uint32_t palette[3] = {1u << 24, 0, 256};
    static const char *const what[3] = {"", "", ", ours with 256 colours"};
    std::vector<uint8_t> all;
    for (int k = 0; k < 3; k++) {
        peer_side p[1] = {peer_ours(k == 1 ? "compact file, at most 32767 colours" : "compact file, 256 colours", g_isa)};
        voxrt_build_desc d;
        voxrt_build_stats stats;
        voxrt_tree *tree = nullptr;
        size_t size = 0;
        double sum = 0;
        memset(&d, 0, sizeof d);
        d.resolution = resolution;
        d.separating = VOXRT_SEPARATING_26;
        d.palette_size = palette[k];
        must(voxrt_tree_build(&d, &mesh, &stats, &tree), "build");
        const std::vector<uint8_t> rgb = colours_of(tree);
        if (k == 0) all = rgb;
        for (size_t i = 0; i < rgb.size(); i++) sum += ((double)rgb[i] - (double)all[i]) * ((double)rgb[i] - (double)all[i]);
        must(voxrt_tree_save_memory(tree, nullptr, nullptr, 0, &size), "size of the file");
        voxrt_tree_destroy(tree);
        if (k == 0) continue;
        p[0].bytes = (double)size;
        p[0].value = p[0].bytes_each = (double)size / (double)stats.voxels;
        p[0].error = std::sqrt(sum / (double)rgb.size());
        const std::string kase = std::string(name) + " " + std::to_string(resolution) + ", file with colours and normals" + what[k];
        peer_lines("V8", kase.c_str(), "bytes_per_voxel", "B", 0, "RMSE of sRGB, of 255, to files that keep all colours", p, 1);
    }
}

/* Mesh to voxels: ours with colours, normals and levels of detail, into a file in memory; theirs distances alone. Leaves the
   distance field. */
static openvdb::FloatGrid::Ptr convert(const model *m, const voxrt_tree *tree, uint32_t resolution) {
    voxrt_tree_info info;
    sup_mesh coloured;
    sup_error err;
    std::vector<openvdb::Vec3s> points;
    std::vector<openvdb::Vec3I> faces;
    std::vector<char> file;
    openvdb::FloatGrid::Ptr grid;
    voxrt_build_stats stats;
    voxrt_tree *made = nullptr;
    size_t size = 0;
    char kase[64];
    peer_side p[2] = {peer_ours("voxrt_tree_build, voxrt_tree_save_memory", g_isa), peer_theirs(g_openvdb, "meshToLevelSet, half width 3")};
    if (sup_scene_make(m->name, 0, &coloured) || sup_mesh_compute_normals(&coloured, &err)) run_failed(m->name, "cannot be made");
    std::vector<uint8_t> rgb(3 * coloured.vertex_count);
    for (size_t i = 0; i < rgb.size(); i++) rgb[i] = (uint8_t)(128.0f + 100.0f * coloured.normals[i]);
    voxrt_mesh mesh = sup_voxel_mesh(&coloured);
    mesh.vertex_rgb = rgb.data();
    voxrt_tree_get_info(tree, &info);
    for (size_t i = 0; i < m->mesh.vertex_count; i++) {
        openvdb::Vec3s q;
        for (int a = 0; a < 3; a++) q[a] = (float)(((double)m->mesh.positions[3 * i + (size_t)a] - info.world_origin[a]) / info.voxel_size);
        points.push_back(q);
    }
    for (size_t i = 0; i < m->mesh.triangle_count; i++) {
        const uint32_t *t = m->mesh.indices + 3 * i;
        faces.push_back(openvdb::Vec3I(t[0], t[1], t[2]));
    }
    p[0].run = [&] {
        voxrt_build_desc d;
        voxrt_save_desc save;
        voxrt_tree_destroy(made);
        made = nullptr;
        memset(&d, 0, sizeof d);
        memset(&save, 0, sizeof save);
        d.env.thread_count = save.env.thread_count = (uint32_t)g_peer_threads;
        d.resolution = resolution;
        d.separating = VOXRT_SEPARATING_26;
        must(voxrt_tree_build(&d, &mesh, &stats, &made), "build");
        if (file.empty()) must(voxrt_tree_save_memory(made, &save, nullptr, 0, &size), "size of the file");
        file.resize(size);
        must(voxrt_tree_save_memory(made, &save, file.data(), file.size(), &size), "file");
    };
    p[1].run = [&] {
        grid = openvdb::tools::meshToLevelSet<openvdb::FloatGrid>(*openvdb::math::Transform::createLinearTransform(1.0), points, faces, 3.0f);
    };
    p[0].run();
    peer_time(p, 2, ROUNDS, false);
    p[0].bytes = (double)size;
    p[0].bytes_each = (double)size / (double)stats.voxels;
    p[1].bytes = (double)grid->memUsage();
    p[1].bytes_each = p[1].bytes / (double)grid->activeVoxelCount();
    p[0].error = cells_missed(made, m->mesh);
    p[1].error = distances_missed(*grid, points);
    voxrt_tree_destroy(made);
    snprintf(kase, sizeof kase, "%s, 1.05 M triangles, to %u^3", m->name, resolution);
    peer_lines("V9", kase, "build_seconds", "s", 0,
               "% of vertices of the mesh that lie in an empty cell, or where the field is not 0 within half a cell", p, 2);
    files_with_colours(m->name, mesh, resolution);
    sup_mesh_free(&coloured);
    return grid;
}

static void zero_crossing(const cells &c, const openvdb::FloatGrid::Ptr &grid, const rayset &s, const char *kase) {
    std::vector<voxrt_hit> hit(s.count);
    std::vector<float> t[3];
    openvdb::tools::LevelSetRayIntersector<openvdb::FloatGrid> open(*grid);
    peer_side p[3] = {peer_ours("voxrt_trace", g_isa), peer_theirs(g_openvdb, "LevelSetRayIntersector"), peer_theirs(g_nanovdb, "ZeroCrossing")};
    int count = 2;
    for (std::vector<float> &v : t) v.assign(s.count, INFINITY);
    p[0].run = [&] { trace_voxels(c.tree, s, hit.data()); };
    p[1].run = [&] {
        peer_for(s.count, 4096, [&](size_t first, size_t end) {
            auto own = open;
            for (size_t i = first; i < end; i++) {
                const voxrt_ray &q = s.ray[i];
                openvdb::Vec3d d(q.dir[0], q.dir[1], q.dir[2]), w;
                double z = 0;
                d.normalize(); /* it asks for that to the last bit */
                openvdb::math::Ray<double> r(openvdb::Vec3d(q.org[0], q.org[1], q.org[2]), d);
                t[1][i] = own.intersectsWS(r, w, z) ? (float)(w - r.eye()).length() : INFINITY;
            }
        });
    };
#if PEER_NANOVDB
    nano_handle h = nanovdb::openToNanoVDB(*grid);
    auto *nano = h.grid<float>();
    count = 3;
    p[2].run = [&] {
        peer_for(s.count, 4096, [&](size_t first, size_t end) {
            auto at = nano->getAccessor();
            for (size_t i = first; i < end; i++) {
                const voxrt_ray &q = s.ray[i];
                nanovdb::Ray<float> r(nanovdb::Vec3f(q.org[0], q.org[1], q.org[2]), nanovdb::Vec3f(q.dir[0], q.dir[1], q.dir[2]));
                nanovdb::Coord cell;
                float v = 0.0f, z = 0.0f;
                t[2][i] = nanovdb::ZeroCrossing(r, at, cell, v, z) ? z : INFINITY;
            }
        });
    };
#endif
    peer_time(p, count, ROUNDS);
    for (size_t i = 0; i < s.count; i++) t[0][i] = hit[i].node != VOXRT_NO_NODE ? hit[i].t : INFINITY;
    for (int i = 0; i < count; i++) p[i].error = far_off(&c, &s, t[i]);
    put_sizes(&p[0], (double)c.info.geometry_bytes, c);
    p[1].bytes = (double)grid->memUsage();
    p[1].bytes_each = p[1].bytes / (double)grid->activeVoxelCount();
#if PEER_NANOVDB
    p[2].bytes = (double)h.size();
    p[2].bytes_each = p[2].bytes / (double)grid->activeVoxelCount();
#endif
    peer_lines("V", kase, "rays_per_second", "1/s", (double)s.count, "% of rays that end 1/256 of the grid or more from exact stepping", p, count);
}

int main(int argc, char **argv) {
    const int status = peer_parse(argc, argv, &g_opt);
    if (status) return status;
    peer_machine("vdb_voxrt", argv[0], "voxrt.h", voxrt_version());
    tbb::global_control threads(tbb::global_control::max_allowed_parallelism, (size_t)g_peer_threads);
    openvdb::initialize();
    for (int id = MODEL_BLOB; id <= MODEL_HALL; id++) {
        const model *m = get_model(id);
        if (m == nullptr) run_failed(g_models[id].name, "no mesh");
        const bool quick = g_peer_threads > 1 && !g_opt.full;
        if (quick && id != MODEL_BLOB) continue;
        for (uint32_t r = quick ? 1024 : id == MODEL_BLOB ? 256 : 512; r <= (g_opt.full ? 2048u : id == MODEL_BLOB ? 1024u : 512u); r *= 2) {
            const voxrt_tree *tree = get_tree(id, r, KIND_PEER);
            rayset first = peer_rays(m->name);
            rayset diffuse = second_rays(tree, &first, SECOND_COSINE, 0.0f), chords = chord_rays(tree, first.count / 4);
            cells c;
            char kase[64];
            cells_open(&c, tree);
            into_grid(&first, &c.from);
            into_grid(&diffuse, &c.from);
            into_grid(&chords, &c.from);
#if PEER_NANOVDB
            if (r > 256) {
                nano_handle h = nano_mask(c);
                snprintf(kase, sizeof kase, "%s %u, camera rays", m->name, r);
                first_active(r == 512 ? "V1" : r == 1024 ? "V2" : "V3", kase, c, h, first);
                if (id == MODEL_BLOB) {
                    snprintf(kase, sizeof kase, "%s %u, diffuse rays", m->name, r);
                    first_active("V4", kase, c, h, diffuse);
                    snprintf(kase, sizeof kase, "%s %u, random rays", m->name, r);
                    first_active(r == 2048 ? "V5" : "V", kase, c, h, chords);
                    snprintf(kase, sizeof kase, "%s %u", m->name, r);
                    if (r == 1024) mask_sizes(c, h, kase);
                }
            }
#else
            bench_skip("peers.vdb_voxrt", "NanoVDB", "no NanoVDB headers (Debian: libnanovdb-dev)");
#endif
            if (id == MODEL_BLOB && r == (g_peer_threads > 1 ? 1024u : 256u)) {
                openvdb::FloatGrid::Ptr grid = convert(m, tree, r);
                snprintf(kase, sizeof kase, "%s %u, camera rays, distances", m->name, r);
                zero_crossing(c, grid, first, kase);
            }
            if (id == MODEL_BLOB && r == 512) {
                const rayset *const sets[3] = {&first, &diffuse, &chords};
                same_bits("blob 512", c, sets, 3);
            }
            cells_close(&c);
            free_rayset(&first);
            free_rayset(&diffuse);
            free_rayset(&chords);
            drop_trees();
        }
    }
    for (int id = 0; id < MODEL_COUNT; id++) sup_mesh_free(&g_models[id].mesh);
    return 0;
}
