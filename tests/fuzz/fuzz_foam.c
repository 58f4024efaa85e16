/* fuzz_foam.c - bytes as points with colours: a refusal, or cells of which the nearest site has each place, rays that lose none of their
   way through the box, and pictures that are the same for every isa and number of threads. Bytes: 10 of options; then sites of 8: three 16-bit
   numbers, even: a multiple of 1/16, odd: the upper half of a float; extinction; colour. */
#define TETCAST_IMPLEMENTATION
#include "../../tetcast.h"

enum { WIDE = 9, HIGH = 7, PIXELS = WIDE * HIGH, OPTIONS = 10, SITES = 96, RAYS = 16 };

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void must(int ok) {
    if (!ok) abort();
}
static int is_finite(double x) { return x - x == 0.0; }

static double number_of(const uint8_t *b) {
    const uint32_t u = (uint32_t)b[0] << 8 | b[1], bits = u << 16;
    float f;
    memcpy(&f, &bits, sizeof f);
    return u & 1 ? (double)f : ((double)(u >> 1) - 16384.0) / 16.0;
}

static uint32_t sites_of(const uint8_t *b, size_t size, tetcast_site *s) {
    const uint32_t n = size / 8 < SITES ? (uint32_t)(size / 8) : SITES;
    uint32_t i, a;
    memset(s, 0, SITES * sizeof *s);
    for (i = 0; i < n; i++, b += 8) {
        for (a = 0; a < 3; a++) {
            s[i].position[a] = number_of(b + 2 * a);
            s[i].rgb[a] = (float)(b[7] >> 2 * a & 3) / 3.0f;
        }
        s[i].extinction = b[6] < 252 ? (float)b[6] / 64.0f : (float)number_of(b);
    }
    return n;
}

/* Is the site of a place's cell as near as any, but for rounding? Both in the box. */
static void look_for(const tetcast_foam *f, const tetcast_site *s, const tetcast_foam_info *info, const double p[3], uint32_t start) {
    double best = 1e300, mine = 1e300, side = 0;
    const uint32_t cell = tetcast_foam_find(f, p, start);
    uint32_t i, a, site;
    must(cell < info->cell_count);
    (void)tetcast_foam_cell(f, cell, &site, NULL, 0);
    for (a = 0; a < 3; a++) side = fmax(side, info->box_max[a] - info->box_min[a]);
    for (i = 0; i < info->cell_count; i++) {
        uint32_t k;
        double square = 0;
        (void)tetcast_foam_cell(f, i, &k, NULL, 0);
        for (a = 0; a < 3; a++) square += (p[a] - s[k].position[a]) / side * ((p[a] - s[k].position[a]) / side);
        best = fmin(best, square);
        if (k == site) mine = square;
    }
    must(!(sqrt(mine) > sqrt(best) + 1e-4) || !(side > 1e-30));
}

static void look_at(const tetcast_foam *f, const tetcast_site *s, const uint8_t *o) {
    tetcast_foam_info info;
    tetcast_render_desc d;
    tetcast_ray ray[RAYS];
    tetcast_ray_result got[2][RAYS];
    static float rgba[2][PIXELS][4];
    uint32_t i, k, a;
    memset(&d, 0, sizeof d);
    memset(ray, 0, sizeof ray);
    tetcast_foam_get_info(f, &info);
    for (i = 0; i < info.cell_count; i++) {
        uint32_t near_by[SITES], site;
        const uint32_t n = tetcast_foam_cell(f, i, &site, near_by, SITES);
        must(n <= info.most_neighbours && n < info.cell_count);
        for (k = 0; k < n; k++) must(near_by[k] < info.cell_count && near_by[k] != i);
    }
    for (i = 0; i < RAYS; i++)
        for (a = 0; a < 3; a++) { /* to and from places at sites, corners and elsewhere in the box */
            const double w = info.box_max[a] - info.box_min[a], u = (double)(o[(i + a) % OPTIONS] * (i + 1) & 15u) / 15.0;
            ray[i].org[a] = info.box_min[a] + w * (i & 1 ? u : (i >> (a + 1) & 1 ? 1.5 : -0.5));
            ray[i].dir[a] = info.box_min[a] + w * (double)(o[(i + 3 * a) % OPTIONS] * (i + 7) & 15u) / 15.0 - ray[i].org[a];
        }
    for (i = 1; i < RAYS; i += 2) look_for(f, s, &info, ray[i].org, i * 5);
    for (k = 0; k < 2; k++) {
        tetcast_image m;
        memset(&m, 0, sizeof m);
        m.width = WIDE;
        m.height = HIGH;
        m.rgba = rgba[k][0];
        d.env.thread_count = 1 + k;
        d.isa = k ? TETCAST_ISA_AUTO : TETCAST_ISA_SCALAR;
        must(tetcast_foam_cast(&d, f, ray, RAYS, got[k], NULL) == TETCAST_OK);
        must(tetcast_foam_render(&d, f, &m, NULL) == TETCAST_OK);
    }
    must(memcmp(rgba[0], rgba[1], sizeof rgba[0]) == 0 && memcmp(got[0], got[1], sizeof got[0]) == 0);
    for (i = 0; i < PIXELS; i++)
        for (a = 0; a < 4; a++) must(is_finite((double)rgba[0][i][a]) && rgba[0][i][a] >= 0);
    for (i = 0; i < RAYS; i++) {
        double from = 0, to = 1e300, l = 0;
        for (a = 0; a < 3; a++) l += ray[i].dir[a] * ray[i].dir[a];
        l = sqrt(l);
        must(got[0][i].steps <= info.cell_count && is_finite((double)got[0][i].length));
        if (!(l > 1e-30) || got[0][i].rgba[3] > 0.99f) continue;
        for (a = 0; a < 3; a++) {
            const double v = ray[i].dir[a] / l, t0 = (info.box_min[a] - ray[i].org[a]) / v, t1 = (info.box_max[a] - ray[i].org[a]) / v;
            if (fabs(v) < 2e-3) break; /* along a face, which is off by 6e-8 of the longest side */
            from = fmax(from, fmin(t0, t1));
            to = fmin(to, fmax(t0, t1));
        }
        if (a == 3) must(fabs(fmin(fmax(to - from, 0), 3e38) - (double)got[0][i].length) <= 1e-4 * l + 1e-4 * fabs(to));
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *o, size_t size) {
    static tetcast_site s[SITES];
    tetcast_foam_desc d;
    tetcast_foam *f[2] = {NULL, NULL};
    tetcast_foam_info info[2];
    tetcast_result r[2];
    uint32_t n, k, a, i;
    if (size < OPTIONS) return 0;
    n = sites_of(o + OPTIONS, size - OPTIONS, s);
    memset(&d, 0, sizeof d);
    for (a = 0; a < 3 && (o[0] & 1); a++) {
        d.box_min[a] = (double)o[1 + a] - 128;
        d.box_max[a] = d.box_min[a] + (o[0] & 2 ? 0 : (double)o[4 + a]);
    }
    for (k = 0; k < 2; k++) {
        d.env.thread_count = 1 + k;
        d.env.memory_limit = o[0] & 4 ? (size_t)o[7] * 256 : 0;
        r[k] = tetcast_foam_create(&d, s, n, &f[k]);
        must((r[k] == TETCAST_OK) == (f[k] != NULL));
        tetcast_foam_get_info(f[k], &info[k]);
    }
    if (d.env.memory_limit == 0) must(r[0] == r[1] && memcmp(&info[0], &info[1], sizeof info[0]) == 0);
    if (f[0] != NULL && f[1] != NULL)
        for (i = 0; i < info[0].cell_count; i++) {
            uint32_t near_by[2][SITES], count[2];
            for (k = 0; k < 2; k++) count[k] = tetcast_foam_cell(f[k], i, NULL, near_by[k], SITES);
            must(count[0] == count[1] && memcmp(near_by[0], near_by[1], count[0] * sizeof near_by[0][0]) == 0);
        }
    if (f[0] != NULL) {
        look_at(f[0], s, o);
        must(tetcast_foam_paint(f[0], s, n) == TETCAST_OK || info[0].bad_sites != 0);
        look_at(f[0], s, o);
    }
    tetcast_foam_destroy(f[0]);
    tetcast_foam_destroy(f[1]);
    return 0;
}
