/* fuzz_trace.c - bytes as voxels and rays: every isa, alone or in a run, gives the same bits, and the oracle agrees. Bytes:
   depth; voxels; 3 bytes a voxel; 8 16-bit numbers a ray (org, dir, t_min, t_max), odd: a multiple of 1/64, even: the
   upper half of a float. */
#include "../oracle.h"
#define VOXRT_IMPLEMENTATION
#include "../../voxrt.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    enum { RAYS = 128 };
    voxrt_voxel v[255];
    voxrt_ray rays[RAYS];
    voxrt_hit one[RAYS], hits[RAYS];
    uint8_t occ[RAYS], bits[512];
    oracle_grid g;
    voxrt_build_desc b; voxrt_trace_desc d; voxrt_tree *tree = NULL;
    size_t i, k, n = size > 1 ? data[1] : 0, count;
    if (n == 0 || size < 2 + 3 * n) return 0;
    memset(v, 0, sizeof v); memset(bits, 0, sizeof bits); memset(&b, 0, sizeof b); memset(&d, 0, sizeof d); memset(&g, 0, sizeof g);
    g.n[0] = g.n[1] = g.n[2] = 2 << data[0] % 4; g.bits = bits;
    for (i = 0; i < n; i++) {
        const uint8_t *p = data + 2 + 3 * i;
        v[i].x = p[0] & (uint32_t)(g.n[0] - 1); v[i].y = p[1] & (uint32_t)(g.n[0] - 1); v[i].z = p[2] & (uint32_t)(g.n[0] - 1);
        oracle_set(&g, (int32_t)v[i].x, (int32_t)v[i].y, (int32_t)v[i].z);
    }
    b.env.thread_count = b.disable_colors = b.disable_normals = 1;
    if (voxrt_tree_from_voxels(&b, v, n, 1 + data[0] % 4u, &tree) != VOXRT_OK) abort();
    count = (size - 2 - 3 * n) / 16 < RAYS ? (size - 2 - 3 * n) / 16 : (size_t)RAYS;
    for (i = 0; i < count; i++) {
        oracle_ray o; oracle_hit said; float f[8]; int tame = 1; /* doubles are exact enough to tell the side of every plane */
        for (k = 0; k < 8; k++) {
            const uint8_t *p = data + 2 + 3 * n + 16 * i + 2 * k;
            uint32_t u = (uint32_t)p[0] << 8 | p[1], w = u << 16;
            memcpy(&f[k], &w, sizeof w);
            if (u & 1) f[k] = ((float)(u >> 1) - 16384.0f) / 64.0f;
            if (k < 6 || !isinf(f[k])) tame &= fabsf(f[k]) <= 256.0f && f[k] * 2048.0f == floorf(f[k] * 2048.0f);
        }
        for (k = 0; k < 3; k++) { o.o[k] = (double)(rays[i].org[k] = f[k]); o.d[k] = (double)(rays[i].dir[k] = f[k + 3]); }
        o.t_min = (double)(rays[i].t_min = f[6]); o.t_max = (double)(rays[i].t_max = f[7]);
        memset(&said, 0, sizeof said);
        said.hit = voxrt_trace1(tree, &rays[i], &one[i]);
        for (k = 0; k < 3; k++) said.cell[k] = (int32_t)one[i].cell[k];
        said.t = (double)one[i].t; said.face = one[i].face;
        if (tame && f[6] <= f[7] && (f[3] != 0.0f || f[4] != 0.0f || f[5] != 0.0f) && oracle_judge(&g, &o, &said, NULL)) abort();
    }
    for (d.isa = VOXRT_ISA_AUTO; d.isa <= VOXRT_ISA_AVX512; d.isa = (voxrt_isa)(d.isa + 1)) {
        if (voxrt_trace(tree, &d, rays, hits, count) != VOXRT_OK || memcmp(hits, one, count * sizeof one[0]) != 0 ||
            voxrt_occluded(tree, &d, rays, occ, count) != VOXRT_OK) abort();
        for (i = 0; i < count; i++) if (occ[i] != (one[i].node != VOXRT_NO_NODE)) abort();
    }
    voxrt_tree_destroy(tree);
    return 0;
}
