/* ball.h - what a ball in the light looks like, exactly: pictures to compare others with, for tests and benchmarks - C99
   and C++11 - MIT OR Unlicense, see LICENSE. */
#ifndef BALL_H_INCLUDED
#define BALL_H_INCLUDED
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include "../voxrt.h"

#if defined(__GNUC__)
#  define BALL_FN static __attribute__((unused))
#else
#  define BALL_FN static
#endif

/* Linear light -> sRGB in units of bytes, not rounded. */
BALL_FN double ball_srgb(double c) {
    if (c > 1) c = 1;
    return 255 * (c <= 0.0031308 ? c * 12.92 : 1.055 * pow(c, 1.0 / 2.4) - 0.055);
}

/* The same of n values in place. */
BALL_FN void ball_bytes(double *v, size_t n) {
    size_t i;
    for (i = 0; i < n; i++) v[i] = ball_srgb(v[i]);
}

/* Of bytes, in dB. */
BALL_FN double ball_psnr(const double *a, const double *b, size_t n) {
    double sum = 0;
    size_t i;
    for (i = 0; i < n; i++) sum += (a[i] - b[i]) * (a[i] - b[i]);
    return 10 * log10(255.0 * 255.0 * (double)n / (sum + 1e-9));
}

/* The white ball around (at, at, at), on black, lit from direction to_light by 0.9 and from everywhere by 0.05: linear
   light and coverage of each pixel (may be NULL). 256 rays a pixel where its outline is, 16 elsewhere. Returns 0 if
   there is no such camera. */
BALL_FN int ball_picture(const voxrt_camera *camera, uint32_t width, uint32_t height, double at, double radius,
                         const float to_light[3], double *light, double *cover) {
    voxrt_ray corner[3]; /* directions are linear in the place on the picture */
    double l[3], length = 0;
    uint32_t x, y, i, a, n;
    if (voxrt_camera_ray(camera, width, height, 0, 0, &corner[0]) != VOXRT_OK ||
        voxrt_camera_ray(camera, width, height, width, 0, &corner[1]) != VOXRT_OK ||
        voxrt_camera_ray(camera, width, height, 0, height, &corner[2]) != VOXRT_OK)
        return 0;
    for (a = 0; a < 3; a++) length += (double)to_light[a] * (double)to_light[a];
    for (a = 0; a < 3; a++) l[a] = (double)to_light[a] / sqrt(length);
    for (y = 0; y < height; y++)
        for (x = 0; x < width; x++)
            for (n = 4; n <= 16; n += 12) {
                double sum = 0;
                uint32_t hits = 0;
                for (i = 0; i < n * n; i++) {
                    const double in = n == 4 ? 0 : 0.5, whole = n == 4 ? 3 : n; /* first with corners and edges */
                    const double u = (x + (i % n + in) / whole) / width, v = (y + (i / n + in) / whole) / height;
                    double o[3], d[3], od = 0, oo = 0, dd = 0, disc, t, shine = 0;
                    for (a = 0; a < 3; a++) {
                        o[a] = (double)corner[0].org[a] - at;
                        d[a] = (double)corner[0].dir[a];
                        d[a] += u * ((double)corner[1].dir[a] - (double)corner[0].dir[a]) +
                                v * ((double)corner[2].dir[a] - (double)corner[0].dir[a]);
                        od += o[a] * d[a];
                        oo += o[a] * o[a];
                        dd += d[a] * d[a];
                    }
                    disc = od * od - dd * (oo - radius * radius);
                    if (disc <= 0) continue;
                    t = (-od - sqrt(disc)) / dd;
                    if (t <= 0) continue;
                    hits++;
                    for (a = 0; a < 3; a++) shine += (o[a] + t * d[a]) / radius * l[a];
                    sum += 0.05 + (shine > 0 ? 0.9 * shine : 0);
                }
                light[(size_t)y * width + x] = sum / (n * n);
                if (cover != NULL) cover[(size_t)y * width + x] = (double)hits / (n * n);
                if (hits == 0 || hits == n * n) break;
            }
    return 1;
}

#endif
