/* embree_voxrt.cpp - the voxels of a mesh against its triangles, traced by Embree 3 (BM12) - MIT OR Unlicense, see
   LICENSE

   peer_embree_voxrt [--full] [--threads N]

   Both trace the same rays, in turn, on one thread: Embree the 1,048,576 triangles, voxrt the voxels at 512 to 2048.
   Embree as its manual advises: flush to zero, coherent flag for camera rays, 16 rays a call. Lines as the benches
   have them. Agreement first: Embree has 428,564 hits at a mean t of 2.06838 on blob, 624,109 at 4.37888 on hall. */
#include "../bench.h"
#include "../../examples/support/mesh.h"
#include "../../examples/support/scenes.h"
#define VOXRT_IMPLEMENTATION
#include "../../voxrt.h"
#include "../bench_models.h"
#include <embree3/rtcore.h>
#include <immintrin.h>

struct embree_job {
    RTCScene scene;
    const rayset *rays;
    int packets, coherent;
    RTCRayHit *one;       /* out, packets = 0 */
    RTCRayHit16 *many;    /* out, packets = 1 */
};

static RTCScene make_scene(RTCDevice device, const sup_mesh &m) {
    RTCScene scene = rtcNewScene(device);
    RTCGeometry g = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    rtcSetGeometryBuildQuality(g, RTC_BUILD_QUALITY_MEDIUM);
    memcpy(rtcSetNewGeometryBuffer(g, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, m.vertex_count), m.positions,
        12 * m.vertex_count);
    memcpy(rtcSetNewGeometryBuffer(g, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, m.triangle_count), m.indices,
        12 * m.triangle_count);
    rtcCommitGeometry(g);
    rtcAttachGeometry(scene, g);
    rtcReleaseGeometry(g);
    rtcCommitScene(scene);
    return scene;
}

/* Rays are written once; a run resets only what tracing changes, as the peers' own programs do. */
static void fill_rays(embree_job &j) {
    for (size_t i = 0; i < j.rays->count; i++) {
        const voxrt_ray &r = j.rays->ray[i];
        RTCRayHit &h = j.one[i];
        RTCRayHit16 &p = j.many[i / 16];
        const size_t l = i % 16;
        memset(&h, 0, sizeof h);
        h.ray.org_x = p.ray.org_x[l] = r.org[0];
        h.ray.org_y = p.ray.org_y[l] = r.org[1];
        h.ray.org_z = p.ray.org_z[l] = r.org[2];
        h.ray.dir_x = p.ray.dir_x[l] = r.dir[0];
        h.ray.dir_y = p.ray.dir_y[l] = r.dir[1];
        h.ray.dir_z = p.ray.dir_z[l] = r.dir[2];
        h.ray.mask = p.ray.mask[l] = ~0u;
        h.hit.instID[0] = p.hit.instID[0][l] = RTC_INVALID_GEOMETRY_ID;
        p.ray.tnear[l] = p.ray.time[l] = 0.0f;
        p.ray.id[l] = p.ray.flags[l] = 0;
    }
}

static void run_embree(void *ctx) {
    embree_job &j = *(embree_job *)ctx;
    alignas(64) int valid[16];
    RTCIntersectContext c;
    rtcInitIntersectContext(&c);
    if (j.coherent) c.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    if (!j.packets) {
        for (size_t i = 0; i < j.rays->count; i++) {
            j.one[i].ray.tfar = INFINITY;
            j.one[i].hit.geomID = RTC_INVALID_GEOMETRY_ID;
            rtcIntersect1(j.scene, &c, &j.one[i]);
        }
        return;
    }
    for (size_t i = 0; i < j.rays->count; i += 16) {
        RTCRayHit16 &p = j.many[i / 16];
        for (size_t l = 0; l < 16; l++) {
            valid[l] = i + l < j.rays->count ? -1 : 0;
            p.ray.tfar[l] = INFINITY;
            p.hit.geomID[l] = RTC_INVALID_GEOMETRY_ID;
        }
        rtcIntersect16(valid, j.scene, &c, &p);
    }
}

static void compare(const char *kase, RTCScene scene, const voxrt_tree *tree, const rayset &rays, int coherent) {
    static const char *const names[3] = {"embree intersect1", "embree intersect16", "tree"};
    embree_job e[2];
    trace_job t[1];
    bench_job b[3];
    RTCRayHit *one = (RTCRayHit *)aligned_alloc(64, (rays.count * sizeof(RTCRayHit) + 63) / 64 * 64);
    RTCRayHit16 *many = (RTCRayHit16 *)aligned_alloc(64, (rays.count / 16 + 1) * sizeof(RTCRayHit16));
    if (one == NULL || many == NULL) run_failed("memory", "not enough");
    memset(one, 0, rays.count * sizeof(RTCRayHit));
    memset(many, 0, (rays.count / 16 + 1) * sizeof(RTCRayHit16));
    memset(b, 0, sizeof b);
    memset(t, 0, sizeof t);
    for (int i = 0; i < 3; i++) {
        b[i].name = names[i];
        b[i].isa = i < 2 ? "native" : voxrt_isa_name(voxrt_isa_best());
        b[i].run = i < 2 ? run_embree : run_trace;
        b[i].ctx = i < 2 ? (void *)&e[i] : (void *)&t[0];
        if (i < 2) {
            e[i].scene = scene;
            e[i].rays = &rays;
            e[i].packets = i;
            e[i].coherent = coherent;
            e[i].one = one;
            e[i].many = many;
        } else {
            t[0].tree = tree;
            t[0].rays = &rays;
            t[0].hit = (voxrt_hit *)must_alloc(rays.count, sizeof(voxrt_hit));
        }
    }
    fill_rays(e[0]);
    bench_interleave(b, 3, 5);
    for (int i = 0; i < 3; i++) {
        double sum = 0.0, hits = 0.0;
        size_t differ = 0;
        for (size_t k = 0; k < rays.count; k++) {
            const int triangle = one[k].hit.geomID != RTC_INVALID_GEOMETRY_ID;
            const int hit = i == 0 ? triangle : i == 1 ? many[k / 16].hit.geomID[k % 16] != RTC_INVALID_GEOMETRY_ID :
                t[0].hit[k].node != VOXRT_NO_NODE;
            differ += hit != triangle;
            if (!hit) continue;
            hits += 1.0;
            sum += (double)(i == 0 ? one[k].ray.tfar : i == 1 ? many[k / 16].ray.tfar[k % 16] : t[0].hit[k].t);
        }
        bench_line("voxrt.embree", kase, "rays_per_second", bench_rate(&b[i], (double)rays.count), "1/s");
        bench_num("best", bench_rate_best(&b[i], (double)rays.count));
        bench_num("error", (double)differ);
        bench_text("error_unit", "rays that hit or miss otherwise than Embree, one by one");
        bench_text("method", names[i]);
        bench_text("isa", b[i].isa);
        bench_num("threads", 1);
        bench_num("wall_per_cpu", bench_busy(&b[i]));
        bench_num("rays", (double)rays.count);
        bench_num("hits", hits);
        bench_num("mean_t", sum / hits);
        if (i >= 2) bench_num("times_embree_16", bench_ratio(&b[1], &b[i]));
        bench_end();
    }
    free(t[0].hit);
    free(one);
    free(many);
}

int main(int argc, char **argv) {
    int status = bench_parse(argc, argv, &g_opt);
    if (status) return status;
    bench_machine("embree_voxrt", argv[0]);
    _mm_setcsr(_mm_getcsr() | 0x8040);
    RTCDevice device = rtcNewDevice("threads=1,set_affinity=0");
    for (int id = MODEL_BLOB; id <= MODEL_HALL; id++) {
        const model *m = get_model(id);
        if (m == NULL) run_failed(g_models[id].name, "no mesh");
        RTCScene scene = make_scene(device, m->mesh);
        rayset first = peer_rays(m->name);
        for (uint32_t r = 512; r <= (g_opt.full ? 2048u : 1024u); r *= 2) {
            const voxrt_tree *tree = get_tree(id, r, KIND_PEER);
            rayset diffuse = second_rays(tree, &first, SECOND_COSINE, 0.0f);
            rayset chords = chord_rays(tree, first.count / 4);
            char kase[64];
            snprintf(kase, sizeof kase, "%s-%u-primary", m->name, r);
            compare(kase, scene, tree, first, 1);
            snprintf(kase, sizeof kase, "%s-%u-diffuse", m->name, r);
            compare(kase, scene, tree, diffuse, 0);
            snprintf(kase, sizeof kase, "%s-%u-random", m->name, r);
            compare(kase, scene, tree, chords, 0);
            free_rayset(&diffuse);
            free_rayset(&chords);
        }
        free_rayset(&first);
        rtcReleaseScene(scene);
        drop_trees();
    }
    rtcReleaseDevice(device);
    for (int id = 0; id < MODEL_COUNT; id++) sup_mesh_free(&g_models[id].mesh);
    return 0;
}
