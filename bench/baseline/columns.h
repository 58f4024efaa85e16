/* columns.h - ways of rays through bit columns that exist only to be compared with - MIT OR Unlicense, see LICENSE

   It uses private functions and brings voxrt.h with its implementation where that is not there yet. Rays are single, in
   single precision, on the grid as voxrt.h makes them ready.

   BASELINE_EPSILON   thesis 5.3: the unit cube, a slab test for the exit from each cell, a quarter of the finest cell
                      farther for the next one; up after each miss. The mask of depths has both ends (the printed XOR of
                      two suffixes loses one)
   BASELINE_MARCH     thesis 6.4.1: points at equal distances, one bit each
   BASELINE_MARCH_3   the same with the cells above and below (Nichols 2010)
   BASELINE_EXACT     cell by cell in double precision: what is right
   BASELINE_OURS      voxrti_column_walk, one ray after the other

   baseline_light is thesis 6.4.1 and 6.4.2 with one of these: gathering, and paths. */
#ifndef BASELINE_COLUMNS_H_INCLUDED
#define BASELINE_COLUMNS_H_INCLUDED
#ifndef VOXRT_IMPLEMENTATION
#  define VOXRT_IMPLEMENTATION
#endif
#include "../../voxrt.h"

typedef enum baseline_way {
    BASELINE_EPSILON, BASELINE_MARCH, BASELINE_MARCH_3, BASELINE_EXACT, BASELINE_OURS
} baseline_way;

static inline int baseline_bit(const voxrt_columns *c, int x, int y, int k) {
    return (int)(c->bits[voxrti_column(c, 0, (uint32_t)x, (uint32_t)y) + ((uint32_t)k >> 5)] >> ((uint32_t)k & 31u) & 1u);
}

/* steps: the most that may be taken; 0: any number */
static int baseline_epsilon(const voxrt_columns *c, const voxrti_column_ray *r, uint32_t steps, voxrti_column_found *f) {
    const uint32_t top = c->levels - 1, finest = c->size[0] > c->size[1] ? c->size[0] : c->size[1];
    const int nz = (int)c->size[2];
    float o[3], d[3], inv[3], p[3], length = 0.0f, further, t = 0.0f, t_end = 1.0f;
    uint32_t level = top < 3 ? top : 3, a, i;
    for (a = 0; a < 3; a++) {
        const float scale = 1.0f / (float)(int32_t)c->size[a];
        o[a] = p[a] = r->o[a] * scale;
        d[a] = r->d[a] * r->t_max * scale;
        if (voxrti_absf(d[a]) < 1e-7f) d[a] = 1e-7f;
        inv[a] = 1.0f / d[a];
        length += d[a] * d[a];
    }
    further = 0.25f / ((float)(int32_t)finest * sqrtf(length));
    for (a = 0; a < 3; a++) { /* out of the box */
        const float e = ((d[a] > 0.0f ? 1.0f : 0.0f) - o[a]) * inv[a];
        t_end = e < t_end ? e : t_end;
    }
    for (i = 0; (steps == 0 || i < steps) && i < 100000 && t <= t_end; i++) {
        const int nx = 1 << c->row_log[level], ny = (int)c->rows[level];
        const float wx = 1.0f / (float)nx, wy = 1.0f / (float)ny;
        const int x = (int)(p[0] * (float)nx), y = (int)(p[1] * (float)ny);
        const uint32_t *column;
        float te, e;
        int z0, z1, lo, hi, w, up = d[2] > 0.0f;
        uint32_t bits = 0;
        if (!(p[0] >= 0.0f) || !(p[1] >= 0.0f) || x >= nx || y >= ny) return 0;
        te = ((float)(x + (d[0] > 0.0f)) * wx - o[0]) * inv[0];
        e = ((float)(y + (d[1] > 0.0f)) * wy - o[1]) * inv[1];
        te = e < te ? e : te;
        e = ((up ? 1.0f : 0.0f) - o[2]) * inv[2];
        te = e < te ? e : te;
        te = te < 1.0f ? te : 1.0f;
        z0 = voxrti_clamp_int((int)(p[2] * (float)nz), 0, nz - 1);
        z1 = voxrti_clamp_int((int)((o[2] + te * d[2]) * (float)nz), 0, nz - 1);
        lo = z0 < z1 ? z0 : z1;
        hi = z0 < z1 ? z1 : z0;
        column = c->bits + voxrti_column(c, level, (uint32_t)x, (uint32_t)y);
        for (w = (up ? lo : hi) >> 5;; w += up ? 1 : -1) {
            bits = column[w] & voxrti_column_mask(lo, hi, w);
            if (bits != 0 || w == (up ? hi : lo) >> 5) break;
        }
        if (bits != 0 && level > 0) {
            level--;
            continue;
        }
        if (bits != 0) {
            f->x = x;
            f->y = y;
            f->k = 32 * w + (up ? (int)voxrti_ctz64(bits) : 31 - (int)voxrti_clz32(bits));
            f->t = t * r->t_max;
            f->face = 6;
            return 1;
        }
        t = te + further;
        for (a = 0; a < 3; a++) p[a] = o[a] + t * d[a];
        if (level < top) level++;
    }
    return 0;
}

static int baseline_march(const voxrt_columns *c, const voxrti_column_ray *r, uint32_t steps, int three,
                          voxrti_column_found *f) {
    const int nx = (int)c->size[0], ny = (int)c->size[1], nz = (int)c->size[2];
    uint32_t i;
    for (i = 0; i < steps; i++) {
        const float t = r->t_max * ((float)(int32_t)i + 0.5f) / (float)(int32_t)steps;
        const int x = (int)(r->o[0] + t * r->d[0]), y = (int)(r->o[1] + t * r->d[1]), k = (int)(r->o[2] + t * r->d[2]);
        int found;
        if (x < 0 || y < 0 || k < 0 || x >= nx || y >= ny || k >= nz) return 0;
        found = baseline_bit(c, x, y, k);
        if (three && !found) found = (k > 0 && baseline_bit(c, x, y, k - 1)) || (k + 1 < nz && baseline_bit(c, x, y, k + 1));
        if (!found) continue;
        f->x = x;
        f->y = y;
        f->k = k;
        f->t = t;
        f->face = 6;
        return 1;
    }
    return 0;
}

static int baseline_exact(const voxrt_columns *c, const voxrti_column_ray *r, voxrti_column_found *f) {
    double inv[3], t = 0.0, next[3];
    int cell[3], a, step[3];
    for (a = 0; a < 3; a++) {
        cell[a] = (int)r->o[a];
        step[a] = r->d[a] > 0.0f ? 1 : -1;
        inv[a] = r->d[a] != 0.0f ? 1.0 / (double)r->d[a] : 0.0;
    }
    for (;;) {
        int b = 0;
        if (baseline_bit(c, cell[0], cell[1], cell[2])) {
            f->x = cell[0];
            f->y = cell[1];
            f->k = cell[2];
            f->t = (float)t;
            f->face = 6;
            return 1;
        }
        for (a = 0; a < 3; a++) {
            next[a] = r->d[a] != 0.0f ? ((double)(cell[a] + (step[a] > 0)) - (double)r->o[a]) * inv[a] : 1e300;
            if (next[a] < next[b]) b = a;
        }
        if (next[b] > (double)r->t_max) return 0;
        t = next[b];
        cell[b] += step[b];
        if (cell[b] < 0 || cell[b] >= (int)c->size[b]) return 0;
    }
}

/* steps: of a march, or the most of BASELINE_EPSILON */
static int baseline_ray(const voxrt_columns *c, const voxrti_column_ray *r, baseline_way way, uint32_t steps,
                        voxrti_column_found *f) {
    const float reach[3] = {0, 0, 0};
    if (way == BASELINE_EPSILON) return baseline_epsilon(c, r, steps, f);
    if (way == BASELINE_EXACT) return baseline_exact(c, r, f);
    if (way == BASELINE_OURS) return voxrti_column_walk(c, r, NULL, 0, reach, 1, f, NULL, NULL);
    return baseline_march(c, r, steps, way == BASELINE_MARCH_3, f);
}

/* ---- light ---- */

static inline float baseline_radical(uint32_t i, uint32_t base) {
    float inv = 1.0f / (float)(int32_t)base, digit = inv, out = 0.0f;
    for (; i != 0; i /= base, digit *= inv) out += (float)(int32_t)(i % base) * digit;
    return out;
}
static inline float baseline_turned(float u, uint32_t hash) { /* rotated by a number of the pixel */
    u += (float)(hash >> 8) * (1.0f / 16777216.0f);
    return u < 1.0f ? u : u - 1.0f;
}

typedef struct baseline_light_desc {
    baseline_way way;
    uint32_t steps, rays, bounces;  /* bounces 1: Hammersley points; more: Halton's, random ones from the third on */
    float radius, s_n, s_d;         /* offsets along normal and ray, cell diagonals */
} baseline_light_desc;

/* Irradiance / pi by other surfaces: what voxrt_gi_render gives, without colours and filter. Light at hits is that of the
   cells, as there. */
static inline void baseline_light(voxrt_gi *gi, const baseline_light_desc *d, const voxrt_gbuffer *g, float *out) {
    const float h = (float)gi->columns->diagonal;
    const int isa = (int)voxrt_isa_best();
    uint32_t x, y, i, b, a;
    for (y = 0; y < g->height; y++)
        for (x = 0; x < g->width; x++) {
            const size_t at = 3 * ((size_t)y * g->width + x);
            const uint32_t tile = voxrti_hash32((x & 63u) + ((y & 63u) << 6));
            float sum[3] = {0, 0, 0};
            memset(out + at, 0, 12);
            if (!(voxrti_dot3(g->normal + at, g->normal + at) > 0.5f)) continue;
            for (i = 0; i < d->rays; i++) {
                float p[3], n[3], part[3] = {1, 1, 1};
                memcpy(p, g->position + at, sizeof p);
                memcpy(n, g->normal + at, sizeof n);
                for (b = 0; b < d->bounces; b++) {
                    static const uint32_t base[2][2] = {{2, 3}, {5, 7}};
                    const uint32_t hash = voxrti_hash32(tile + b * 7919u);
                    voxrti_column_ray r;
                    voxrti_column_found f;
                    voxrti_gi_side side;
                    voxrt_ray ray;
                    float u[2], cosine, rgb[3], far_off;
                    if (d->bounces == 1) {
                        u[0] = (float)(int32_t)i / (float)(int32_t)d->rays;
                        u[1] = baseline_radical(i, 2);
                    } else if (b < 2) {
                        u[0] = baseline_radical(i + 1, base[b][0]);
                        u[1] = baseline_radical(i + 1, base[b][1]);
                    } else {
                        u[0] = (float)(voxrti_hash32(hash + i * 2u) >> 8) * (1.0f / 16777216.0f);
                        u[1] = (float)(voxrti_hash32(hash + i * 2u + 1u) >> 8) * (1.0f / 16777216.0f);
                    }
                    u[0] = baseline_turned(u[0], hash);
                    u[1] = baseline_turned(u[1], voxrti_hash32(hash ^ 0x55555555u));
                    cosine = voxrti_lobe_direction(n, u, 1.0f, ray.dir);
                    if (!(cosine > 0.0f)) break;
                    far_off = d->s_d * h / cosine;
                    if (far_off > d->radius || d->radius - far_off < 1.5f * h) break;
                    for (a = 0; a < 3; a++) ray.org[a] = p[a] + d->s_n * h * n[a] + far_off * ray.dir[a];
                    ray.t_min = 0.0f;
                    ray.t_max = d->radius - far_off;
                    if (voxrti_column_ray_open(gi->columns, &ray, &r) != 1 ||
                        !baseline_ray(gi->columns, &r, d->way, d->steps, &f)) break;
                    if (!voxrti_gi_side_open(gi, (uint32_t)f.x, (uint32_t)f.y, (uint32_t)f.k, ray.dir, &side)) break;
                    if (voxrti_load_shared(&gi->layer[side.layer].direct[side.at]) == VOXRTI_GI_UNKNOWN)
                        voxrti_gi_fill(gi, isa, &side, 1);
                    voxrti_gi_radiance(&side, 1, d->bounces == 1, rgb);
                    for (a = 0; a < 3; a++) {
                        sum[a] += rgb[a] * part[a];
                        part[a] *= side.albedo[a];
                    }
                    memcpy(p, side.position, sizeof p);
                    memcpy(n, side.normal, sizeof n);
                }
            }
            for (a = 0; a < 3; a++) out[at + a] = sum[a] / (float)(int32_t)d->rays;
        }
}

#endif
