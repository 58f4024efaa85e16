/* embree_rays.h - scenes and rays of Embree 3 for the peer programs - C++17 - MIT OR Unlicense, see LICENSE
   Embree as its manual advises: flush to zero, the coherent flag for camera rays, 16 rays a call or one. */
#ifndef EMBREE_RAYS_H_INCLUDED
#define EMBREE_RAYS_H_INCLUDED
#include <embree3/rtcore.h>
#include <immintrin.h>

static std::atomic<long> g_embree_bytes(0);
static const char *g_embree_name = "Embree";

static bool embree_memory(void *, ssize_t bytes, bool) {
    g_embree_bytes += (long)bytes;
    return true;
}

static void embree_fast_floats(void) { _mm_setcsr(_mm_getcsr() | 0x8040); } /* of the calling thread */

/* threads: that build; those that trace are ours. */
static RTCDevice embree_open(int threads) {
    static char name[32];
    char config[64];
    embree_fast_floats();
    snprintf(config, sizeof config, "threads=%d,set_affinity=0", threads);
    RTCDevice device = rtcNewDevice(config);
    const long version = (long)rtcGetDeviceProperty(device, RTC_DEVICE_PROPERTY_VERSION);
    snprintf(name, sizeof name, "Embree %ld.%ld.%ld", version / 10000, version / 100 % 100, version % 100);
    g_embree_name = name;
    rtcSetDeviceMemoryMonitorFunction(device, embree_memory, nullptr);
    return device;
}

static RTCGeometry embree_geometry(RTCDevice device, const sup_mesh &m, RTCBuildQuality quality) {
    RTCGeometry g = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    rtcSetGeometryBuildQuality(g, quality);
    memcpy(rtcSetNewGeometryBuffer(g, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, m.vertex_count), m.positions,
           12 * (size_t)m.vertex_count);
    memcpy(rtcSetNewGeometryBuffer(g, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, m.triangle_count), m.indices,
           12 * (size_t)m.triangle_count);
    rtcCommitGeometry(g);
    return g;
}

static RTCScene embree_scene(RTCDevice device, const sup_mesh &m, RTCBuildQuality quality, RTCSceneFlags flags) {
    RTCScene scene = rtcNewScene(device);
    rtcSetSceneBuildQuality(scene, quality);
    rtcSetSceneFlags(scene, flags);
    RTCGeometry g = embree_geometry(device, m, quality);
    rtcAttachGeometry(scene, g);
    rtcReleaseGeometry(g);
    rtcCommitScene(scene);
    return scene;
}

/* to_world: three rows of four. */
static void embree_instance(RTCDevice device, RTCScene into, RTCScene of, const double *to_world) {
    float m[12];
    RTCGeometry g = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_INSTANCE);
    for (int i = 0; i < 12; i++) m[i] = (float)to_world[i];
    rtcSetGeometryInstancedScene(g, of);
    rtcSetGeometryTransform(g, 0, RTC_FORMAT_FLOAT3X4_ROW_MAJOR, m);
    rtcCommitGeometry(g);
    rtcAttachGeometry(into, g);
    rtcReleaseGeometry(g);
}

/* Rays that stay as they are from run to run; a run resets what tracing changes, as a renderer has to write it. */
struct embree_rays {
    size_t count = 0;
    bool coherent = false;
    RTCRayHit *one = nullptr;
    RTCRayHit16 *many = nullptr;
    uint8_t *hidden = nullptr;       /* out, of occluded runs */

    embree_rays(size_t n, bool together) : count(n), coherent(together) {
        one = (RTCRayHit *)aligned_alloc(64, (n * sizeof *one + 63) / 64 * 64);
        many = (RTCRayHit16 *)aligned_alloc(64, (n / 16 + 1) * sizeof *many);
        hidden = (uint8_t *)calloc(n + 1, 1);
        if (one == nullptr || many == nullptr || hidden == nullptr) {
            fputs("embree: not enough memory\n", stderr);
            exit(1);
        }
        memset(one, 0, n * sizeof *one);
        memset(many, 0, (n / 16 + 1) * sizeof *many);
    }
    ~embree_rays() {
        free(one);
        free(many);
        free(hidden);
    }
    embree_rays(const embree_rays &) = delete;
    embree_rays &operator=(const embree_rays &) = delete;

    void set(size_t i, const float org[3], const float dir[3]) {
        RTCRayHit &h = one[i];
        RTCRayHit16 &p = many[i / 16];
        const size_t l = i % 16;
        h.ray.org_x = p.ray.org_x[l] = org[0];
        h.ray.org_y = p.ray.org_y[l] = org[1];
        h.ray.org_z = p.ray.org_z[l] = org[2];
        h.ray.dir_x = p.ray.dir_x[l] = dir[0];
        h.ray.dir_y = p.ray.dir_y[l] = dir[1];
        h.ray.dir_z = p.ray.dir_z[l] = dir[2];
        h.ray.mask = p.ray.mask[l] = ~0u;
    }
    RTCIntersectContext context(void) const {
        RTCIntersectContext c;
        rtcInitIntersectContext(&c);
        if (coherent) c.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
        return c;
    }
    void trace1(RTCScene scene) const {
        peer_for(count, 4096, [&](size_t first, size_t end) {
            RTCIntersectContext c = context();
            embree_fast_floats();
            for (size_t i = first; i < end; i++) {
                one[i].ray.tfar = INFINITY;
                one[i].hit.geomID = one[i].hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
                rtcIntersect1(scene, &c, &one[i]);
            }
        });
    }
    int lanes(size_t i, int valid[16]) const { /* of the 16 from i on */
        for (size_t l = 0; l < 16; l++) valid[l] = i + l < count ? -1 : 0;
        return 0;
    }
    void trace16(RTCScene scene) const {
        peer_for(count, 4096, [&](size_t first, size_t end) {
            RTCIntersectContext c = context();
            alignas(64) int valid[16];
            embree_fast_floats();
            for (size_t i = first; i < end; i += 16) {
                RTCRayHit16 &p = many[i / 16];
                lanes(i, valid);
                for (size_t l = 0; l < 16; l++) {
                    p.ray.tfar[l] = INFINITY;
                    p.hit.geomID[l] = p.hit.instID[0][l] = RTC_INVALID_GEOMETRY_ID;
                }
                rtcIntersect16(valid, scene, &c, &p);
            }
        });
    }
    void occluded1(RTCScene scene) const {
        peer_for(count, 4096, [&](size_t first, size_t end) {
            RTCIntersectContext c = context();
            embree_fast_floats();
            for (size_t i = first; i < end; i++) {
                one[i].ray.tfar = INFINITY;
                rtcOccluded1(scene, &c, &one[i].ray);
                hidden[i] = one[i].ray.tfar < 0.0f;
            }
        });
    }
    void occluded16(RTCScene scene) const {
        peer_for(count, 4096, [&](size_t first, size_t end) {
            RTCIntersectContext c = context();
            alignas(64) int valid[16];
            embree_fast_floats();
            for (size_t i = first; i < end; i += 16) {
                RTCRay16 &p = many[i / 16].ray;
                lanes(i, valid);
                for (size_t l = 0; l < 16; l++) p.tfar[l] = INFINITY;
                rtcOccluded16(valid, scene, &c, &p);
                for (size_t l = 0; l < 16 && i + l < count; l++) hidden[i + l] = p.tfar[l] < 0.0f;
            }
        });
    }
    float t1(size_t i) const { return one[i].hit.geomID != RTC_INVALID_GEOMETRY_ID ? one[i].ray.tfar : INFINITY; }
    float t16(size_t i) const {
        return many[i / 16].hit.geomID[i % 16] != RTC_INVALID_GEOMETRY_ID ? many[i / 16].ray.tfar[i % 16] : INFINITY;
    }
};

#endif
