/* path_oracle.h - light in scenes of a few triangles, by paths, in double precision - C99 and C++11 - MIT OR Unlicense,
   see LICENSE. Every ray meets every triangle; both sides of a triangle look alike. */
#ifndef PATH_ORACLE_H_INCLUDED
#define PATH_ORACLE_H_INCLUDED
#include <math.h>
#include <stdint.h>
#include <string.h>

#if defined(__GNUC__)
#  define PATH_FN static __attribute__((unused))
#else
#  define PATH_FN static
#endif

typedef struct path_scene {
    double p[256][3][3], n[256][3], albedo[256], emission[256];
    int count;
    double lamp[3], intensity; /* a point; intensity 0: none */
    uint64_t state;
} path_scene;

PATH_FN double path_random(path_scene *s) {
    uint64_t z = s->state += UINT64_C(0x9e3779b97f4a7c15);
    z = (z ^ z >> 30) * UINT64_C(0xbf58476d1ce4e5b9);
    z = (z ^ z >> 27) * UINT64_C(0x94d049bb133111eb);
    return (double)((z ^ z >> 31) >> 11) * (1.0 / 9007199254740992.0);
}

PATH_FN double path_dot(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

PATH_FN void path_cross(const double a[3], const double b[3], double out[3]) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

PATH_FN void path_add(path_scene *s, const double a[3], const double b[3], const double c[3], double albedo, double emission) {
    double u[3], v[3], l;
    int i, k = s->count++;
    for (i = 0; i < 3; i++) {
        s->p[k][0][i] = a[i];
        s->p[k][1][i] = b[i];
        s->p[k][2][i] = c[i];
        u[i] = b[i] - a[i];
        v[i] = c[i] - a[i];
    }
    path_cross(u, v, s->n[k]);
    l = sqrt(path_dot(s->n[k], s->n[k]));
    for (i = 0; i < 3; i++) s->n[k][i] /= l;
    s->albedo[k] = albedo;
    s->emission[k] = emission;
}

/* First triangle from t_min on, -1: none. Moeller & Trumbore 1997. */
PATH_FN int path_meet(const path_scene *s, const double o[3], const double d[3], double t_min, double *t) {
    int best = -1, k, i;
    for (k = 0; k < s->count; k++) {
        double e1[3], e2[3], h[3], q[3], m[3], a, u, v, at;
        for (i = 0; i < 3; i++) {
            e1[i] = s->p[k][1][i] - s->p[k][0][i];
            e2[i] = s->p[k][2][i] - s->p[k][0][i];
            m[i] = o[i] - s->p[k][0][i];
        }
        path_cross(d, e2, h);
        a = path_dot(e1, h);
        if (fabs(a) < 1e-14) continue;
        u = path_dot(m, h) / a;
        if (u < 0 || u > 1) continue;
        path_cross(m, e1, q);
        v = path_dot(d, q) / a;
        if (v < 0 || u + v > 1) continue;
        at = path_dot(e2, q) / a;
        if (at < t_min || at >= *t) continue;
        *t = at;
        best = k;
    }
    return best;
}

/* Irradiance of the lamp at p. */
PATH_FN double path_direct(const path_scene *s, const double p[3], const double n[3]) {
    double d[3], d2, cosine, t = 1 - 1e-9;
    int i;
    if (!(s->intensity > 0)) return 0;
    for (i = 0; i < 3; i++) d[i] = s->lamp[i] - p[i];
    d2 = path_dot(d, d);
    cosine = path_dot(d, n) / sqrt(d2);
    if (cosine <= 0 || path_meet(s, p, d, 1e-9, &t) >= 0) return 0;
    return s->intensity * cosine / d2;
}

/* Mean over `paths` paths of `bounces` of irradiance / pi at p by other surfaces. error: out, of the mean, one standard
   deviation; may be NULL. */
PATH_FN double path_indirect(path_scene *s, const double p0[3], const double n0[3], int bounces, int paths, double *error) {
    double sum = 0, sum2 = 0;
    int i, b, a;
    for (i = 0; i < paths; i++) {
        double p[3], n[3], part = 1, value = 0;
        memcpy(p, p0, sizeof p);
        memcpy(n, n0, sizeof n);
        for (b = 0; b < bounces; b++) {
            const double z = 2 * path_random(s) - 1, turn = 6.283185307179586 * path_random(s), r = sqrt(1 - z * z);
            double d[3], l, t = 1e300;
            int k;
            d[0] = n[0] + r * cos(turn);
            d[1] = n[1] + r * sin(turn);
            d[2] = n[2] + z;
            l = sqrt(path_dot(d, d));
            for (a = 0; a < 3; a++) d[a] /= l;
            k = path_meet(s, p, d, 1e-9, &t);
            if (k < 0) break;
            for (a = 0; a < 3; a++) {
                p[a] += t * d[a];
                n[a] = path_dot(s->n[k], d) < 0 ? s->n[k][a] : -s->n[k][a];
            }
            value += part * (s->emission[k] + s->albedo[k] * 0.3183098861837907 * path_direct(s, p, n));
            part *= s->albedo[k];
        }
        sum += value;
        sum2 += value * value;
    }
    sum /= paths;
    sum2 /= paths;
    if (error != NULL) *error = sqrt((sum2 > sum * sum ? sum2 - sum * sum : 0) / paths);
    return sum;
}

#endif
