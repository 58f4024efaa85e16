/* gi_models.h - models, scenes and lamps for tests of light on bit columns - C99 and C++11 - MIT OR Unlicense, see
   LICENSE. Comes after voxrt.h with its implementation. */
#ifndef GI_MODELS_H_INCLUDED
#define GI_MODELS_H_INCLUDED
#ifndef VOXRT_IMPLEMENTATION
#error "include voxrt.h and its implementation before this header"
#endif
#include <math.h>
#include <stdlib.h>
#include <string.h>

#if defined(__GNUC__)
#  define MODEL_FN static __attribute__((unused))
#else
#  define MODEL_FN static
#endif

static uint32_t rng_state = 1;
MODEL_FN double rnd(void) { return (double)(rng_state = voxrti_hash32(rng_state + 0x9e3779b9u)) / 4294967296.0; }

typedef struct model { float p[40000][3]; uint32_t index[40000][3]; uint8_t rgb[40000][3]; uint32_t points, triangles; } model;

/* A G-buffer in arrays of width * height. */
MODEL_FN voxrt_gbuffer gbuffer_of(uint32_t width, uint32_t height, float (*position)[3], float (*normal)[3],
                                  float (*albedo)[3]) {
    voxrt_gbuffer g;
    memset(&g, 0, sizeof g);
    g.width = width;
    g.height = height;
    g.position = position[0];
    g.normal = normal[0];
    g.albedo = albedo[0];
    return g;
}

/* A scene in a cube around `middle`, the depth along z. */
MODEL_FN voxrt_gi *make_gi_at(uint32_t nx, uint32_t ny, uint32_t nz, double half, const double middle[3]) {
    voxrt_gi_desc d;
    voxrt_gi *gi = NULL;
    uint32_t a;
    memset(&d, 0, sizeof d);
    d.columns.size_x = nx;
    d.columns.size_y = ny;
    d.columns.size_z = nz;
    d.columns.depth_axis_plus_1 = 3;
    for (a = 0; a < 3; a++) {
        d.columns.box_min[a] = middle[a] - half;
        d.columns.box_max[a] = middle[a] + half;
    }
    if (voxrt_gi_create(&d, &gi) != VOXRT_OK) abort();
    return gi;
}
MODEL_FN voxrt_gi *make_gi(uint32_t nx, uint32_t ny, uint32_t nz, double half) {
    const double none[3] = {0, 0, 0};
    return make_gi_at(nx, ny, nz, half, none);
}

MODEL_FN voxrt_gi_object object_of(const model *m, uint32_t still) {
    voxrt_gi_object o;
    memset(&o, 0, sizeof o);
    o.mesh.positions = m->p[0];
    o.mesh.vertex_count = m->points;
    o.mesh.indices = m->index[0];
    o.mesh.triangle_count = m->triangles;
    o.mesh.triangle_rgb = m->rgb[0];
    o.still = still;
    return o;
}

MODEL_FN void quad(model *m, const double a[3], const double b[3], const double c[3], const double d[3], uint8_t grey) {
    const double *p[4] = {a, b, c, d};
    const uint32_t v = m->points, t[2][3] = {{v, v + 1, v + 2}, {v, v + 2, v + 3}};
    uint32_t i, k;
    for (i = 0; i < 4; i++) for (k = 0; k < 3; k++) m->p[v + i][k] = (float)p[i][k];
    m->points += 4;
    memcpy(m->index[m->triangles], t, sizeof t);
    memset(m->rgb[m->triangles], grey, 6);
    m->triangles += 2;
}

/* Instead of what was in m. */
MODEL_FN void sphere(model *m, double r, uint32_t rings, uint8_t grey, int inwards) {
    uint32_t i, j, n = 2 * rings;
    m->points = m->triangles = 0;
    for (i = 0; i <= rings; i++)
        for (j = 0; j < n; j++) {
            const double a = 3.14159265358979 * i / rings, b = 6.28318530717959 * j / n;
            m->p[m->points][0] = (float)(r * sin(a) * cos(b));
            m->p[m->points][1] = (float)(r * sin(a) * sin(b));
            m->p[m->points++][2] = (float)(r * cos(a));
        }
    for (i = 0; i < rings; i++)
        for (j = 0; j < n; j++) {
            const uint32_t a = i * n + j, b = i * n + (j + 1) % n, t[2][3] = {{a, a + n, b}, {b, a + n, b + n}};
            uint32_t k;
            memcpy(m->index[m->triangles], t, sizeof t);
            memset(m->rgb[m->triangles], grey, 6);
            for (k = 0; k < 2 && inwards; k++) {
                const uint32_t x = m->index[m->triangles + k][1];
                m->index[m->triangles + k][1] = m->index[m->triangles + k][2];
                m->index[m->triangles + k][2] = x;
            }
            m->triangles += 2;
        }
}

MODEL_FN voxrt_gi_light point_light(float x, float y, float z, float power) {
    voxrt_gi_light l;
    memset(&l, 0, sizeof l);
    l.position[0] = x;
    l.position[1] = y;
    l.position[2] = z;
    l.color[0] = l.color[1] = l.color[2] = power;
    return l;
}

MODEL_FN double rms(float (*a)[3], float (*b)[3], size_t n) { /* of a - b, over the mean of b */
    double sum = 0, mean = 0;
    size_t i;
    for (i = 0; i < n; i++) {
        sum += ((double)a[i][1] - (double)b[i][1]) * ((double)a[i][1] - (double)b[i][1]);
        mean += (double)b[i][1];
    }
    return sqrt(sum / (double)n) / (mean / (double)n);
}

#endif
