/* volume_scenes.h - volumes made by formulas
   SPDX-License-Identifier: MIT OR Unlicense

   lattice   cube cut into 6 n^3 Kuhn tetrahedra, a swirl inside a shell; detail n, 32
   ball      ball of bent cells, an atomic orbital (3d, m = 0 and 1 mixed); detail n, 48
   ring      ring with a knot of hot gas running round in it, not convex; detail n, 48
   fins      fifty thin plates behind each other: rays leave the mesh and enter it a hundred times; detail n, 24
   bow       curved grid before a blunt body, dense behind the bow shock; detail n, 32

   The coordinates are floats held as doubles. Nothing is random. */
#ifndef SUP_VOLUME_SCENES_H
#define SUP_VOLUME_SCENES_H

#include "volume.h"

#define SUP_VOLUME_SCENES "lattice|ball|ring|fins|bow"

/* gcc 12 -O2 leaves out a rounding to float and back of two doubles side by side: hence volatile. */
SUP_FN double supi_float_of(double x) {
    volatile float f = (float)x;
    return (double)f;
}

/* Points of a grid from p(u, v, w) with u, v, w in 0..1, and a field from the place. */
typedef void supi_place_fn(double u, double v, double w, double p[3]);
typedef double supi_scalar_fn(const double p[3]);

SUP_FN int supi_volume_grid(sup_volume *out, uint32_t nx, uint32_t ny, uint32_t nz, supi_place_fn *place,
                            supi_scalar_fn *scalar, const char *field) {
    const size_t count = (size_t)nx * ny * nz;
    size_t i, j, k, n = 0;
    float *values;
    out->points = (double *)sup_alloc(count, 3 * sizeof(double));
    values = sup_volume_add_field(out, field, strlen(field), 1, 0, count);
    if (!out->points || !values) return 1;
    out->dims[0] = nx;
    out->dims[1] = ny;
    out->dims[2] = nz;
    out->point_count = count;
    for (k = 0; k < nz; k++)
        for (j = 0; j < ny; j++)
            for (i = 0; i < nx; i++, n++) {
                double *p = out->points + 3 * n;
                size_t c;
                place((double)i / (double)(nx - 1), (double)j / (double)(ny - 1), (double)k / (double)(nz - 1), p);
                for (c = 0; c < 3; c++) p[c] = supi_float_of(p[c]);
                values[n] = (float)scalar(p);
            }
    return 0;
}

SUP_FN void supi_place_cube(double u, double v, double w, double p[3]) {
    p[0] = u;
    p[1] = v;
    p[2] = w;
}

SUP_FN double supi_scalar_swirl(const double q[3]) {
    const float x = (float)q[0] - 0.5f, y = (float)q[1] - 0.5f, z = (float)q[2] - 0.5f;
    const float r = sqrtf(x * x + y * y + z * z);
    const float s = 0.5f + 0.25f * sinf(18.0f * r) + 0.25f * sinf(9.0f * x + 4.0f * sinf(6.0f * y)) * cosf(8.0f * z);
    return (double)(s < 0.0f ? 0.0f : s > 1.0f ? 1.0f : s);
}

/* The cube onto the ball: each square shell of the cube becomes a sphere. */
SUP_FN void supi_place_ball(double u, double v, double w, double p[3]) {
    const double x = 2.0 * u - 1.0, y = 2.0 * v - 1.0, z = 2.0 * w - 1.0;
    p[0] = x * sqrt(1.0 - y * y / 2.0 - z * z / 2.0 + y * y * z * z / 3.0);
    p[1] = y * sqrt(1.0 - z * z / 2.0 - x * x / 2.0 + z * z * x * x / 3.0);
    p[2] = z * sqrt(1.0 - x * x / 2.0 - y * y / 2.0 + x * x * y * y / 3.0);
}

SUP_FN double supi_scalar_orbital(const double p[3]) {
    const double r2 = p[0] * p[0] + p[1] * p[1] + p[2] * p[2], r = sqrt(r2) * 18.0;
    const double wave = exp(-r / 3.0) * 324.0 * (3.0 * p[1] * p[1] - r2 + 1.2 * p[0] * p[1]);
    const double density = wave * wave;
    return density / (density + 4.0);
}

SUP_FN void supi_place_ring(double u, double v, double w, double p[3]) {
    const double around = 6.283185307179586 * 0.92 * u, a = 6.283185307179586 * v, r = 0.08 + 0.3 * w;
    const double d = 1.0 + r * cos(a);
    p[0] = d * cos(around);
    p[1] = r * sin(a);
    p[2] = d * sin(around);
}

SUP_FN double supi_scalar_knot(const double p[3]) {
    const double around = atan2(p[2], p[0]), out = sqrt(p[0] * p[0] + p[2] * p[2]) - 1.0;
    double best = 0.0;
    int k;
    for (k = 0; k < 2; k++) {
        const double a = 1.5 * around + 3.141592653589793 * k, cx = 0.22 * cos(a), cy = 0.22 * sin(a);
        best += exp(-((out - cx) * (out - cx) + (p[1] - cy) * (p[1] - cy)) * 90.0);
    }
    return best;
}

SUP_FN void supi_place_bow(double u, double v, double w, double p[3]) {
    const double a = 1.9 * (2.0 * u - 1.0), r = 0.35 + 1.1 * w * w * (0.6 + 0.4 * (1.0 - cos(a)));
    p[0] = -r * cos(a);
    p[1] = 1.4 * (v - 0.5);
    p[2] = r * sin(a) * 1.1;
}

SUP_FN double supi_scalar_bow(const double p[3]) {
    const double r = sqrt(p[0] * p[0] + p[2] * p[2]), a = atan2(p[2], -p[0]);
    const double shock = 0.62 + 0.16 * a * a + 0.05 * cos(9.0 * p[1]), d = (shock - r) / 0.02;
    const double jump = 1.0 / (1.0 + exp(-d)), wall = exp(-(r - 0.35) * 9.0);
    return 0.12 + jump * (0.45 + 0.35 * cos(a) + 0.12 * sin(11.0 * p[1]) * wall) + 0.25 * wall;
}

/* Six tetrahedra for each cell of a lattice, all around the cell's main diagonal. */
SUP_FN int supi_volume_kuhn(sup_volume *out, uint32_t n) {
    static const uint8_t path[6][2] = {{0, 1}, {0, 2}, {1, 0}, {1, 2}, {2, 0}, {2, 1}};
    supi_volume_reader r;
    size_t i, j, k, c;
    const size_t m = (size_t)n + 1, step[3] = {1, m, m * m};
    memset(&r, 0, sizeof r);
    r.out = out;
    r.name = "lattice";
    if (supi_volume_grid(out, n + 1, n + 1, n + 1, supi_place_cube, supi_scalar_swirl, "swirl")) return 1;
    memset(out->dims, 0, sizeof out->dims);
    for (k = 0; k < n; k++)
        for (j = 0; j < n; j++)
            for (i = 0; i < n; i++)
                for (c = 0; c < 6; c++) {
                    const size_t b = i + j * step[1] + k * step[2];
                    const uint32_t corner[4] = {(uint32_t)b, (uint32_t)(b + step[path[c][0]]),
                                                (uint32_t)(b + step[path[c][0]] + step[path[c][1]]),
                                                (uint32_t)(b + step[0] + step[1] + step[2])};
                    if (supi_volume_add_cell(&r, SUP_TETRA, corner, 4)) return 1;
                }
    return 0;
}

/* Plates of one layer of hexahedra each, slightly bent. */
SUP_FN int supi_volume_fins(sup_volume *out, uint32_t n) {
    enum { PLATES = 50 };
    supi_volume_reader r;
    const size_t m = (size_t)n + 1, side = m * m;
    float *values;
    size_t plate, i, j, k, at = 0;
    memset(&r, 0, sizeof r);
    r.out = out;
    r.name = "fins";
    out->points = (double *)sup_alloc(2 * PLATES * side, 3 * sizeof(double));
    values = sup_volume_add_field(out, "heat", 4, 1, 0, 2 * PLATES * side);
    if (!out->points || !values) return 1;
    out->point_count = 2 * PLATES * side;
    for (plate = 0; plate < PLATES; plate++) {
        const size_t first = at;
        for (k = 0; k < 2; k++)
            for (j = 0; j < m; j++)
                for (i = 0; i < m; i++, at++) {
                    const double x = 2.0 * (double)i / (double)n - 1.0, y = 2.0 * (double)j / (double)n - 1.0;
                    double *p = out->points + 3 * at;
                    p[0] = supi_float_of(x);
                    p[1] = supi_float_of(y);
                    p[2] = supi_float_of(2.0 * ((double)plate + 0.45 * (double)k) / PLATES - 1.0 +
                                           0.06 * x * x + 0.05 * sin(3.0 * y));
                    values[at] = (float)exp(-3.0 * (x * x + y * y) - 0.5 * (p[2] + 0.4) * (p[2] + 0.4));
                }
        for (j = 0; j < n; j++)
            for (i = 0; i < n; i++) {
                const size_t b = first + i + j * m;
                const uint32_t corner[8] = {(uint32_t)b, (uint32_t)(b + 1), (uint32_t)(b + 1 + m), (uint32_t)(b + m),
                                            (uint32_t)(b + side), (uint32_t)(b + side + 1),
                                            (uint32_t)(b + side + 1 + m), (uint32_t)(b + side + m)};
                if (supi_volume_add_cell(&r, SUP_HEXAHEDRON, corner, 8)) return 1;
            }
    }
    return 0;
}

/* Make a volume by name, one of SUP_VOLUME_SCENES. detail 0: as listed above, at most 512.
   Returns 0, or 1 with err->text set and `out` cleared. */
SUP_FN int sup_volume_make(const char *name, uint32_t detail, sup_volume *out, sup_error *err) {
    int failed = 1, known = 1;
    sup_error_clear(err);
    memset(out, 0, sizeof *out);
    if (detail > 512) detail = 512;
    if (strcmp(name, "lattice") == 0) {
        failed = supi_volume_kuhn(out, detail ? detail : 32);
    } else if (strcmp(name, "ball") == 0) {
        const uint32_t n = (detail ? detail : 48) + 1;
        failed = supi_volume_grid(out, n, n, n, supi_place_ball, supi_scalar_orbital, "orbital");
    } else if (strcmp(name, "ring") == 0) {
        const uint32_t n = detail ? detail : 48;
        failed = supi_volume_grid(out, 3 * n + 1, n + 1, n / 4 + 2, supi_place_ring, supi_scalar_knot, "knot");
    } else if (strcmp(name, "fins") == 0) {
        failed = supi_volume_fins(out, detail ? detail : 24);
    } else if (strcmp(name, "bow") == 0) {
        const uint32_t n = detail ? detail : 32;
        failed = supi_volume_grid(out, 2 * n + 1, n + 1, n + 1, supi_place_bow, supi_scalar_bow, "density");
    } else {
        known = 0;
    }
    if (!failed) return 0;
    sup_volume_free(out);
    return known ? sup_fail(err, "out of memory") : sup_fail(err, "\"%s\" is none of %s", name, SUP_VOLUME_SCENES);
}

#endif
