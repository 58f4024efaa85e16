/* foam_oracle.h - what a ray through Voronoi cells looks like, all in double, slow and plain: for tests and benchmarks
   SPDX-License-Identifier: MIT OR Unlicense */
#ifndef FOAM_ORACLE_H_INCLUDED
#define FOAM_ORACLE_H_INCLUDED
#ifndef TETCAST_H_INCLUDED
#  error "include tetcast.h first"
#endif

TEST_FN double foam_length(const double v[3]) { return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

typedef struct foam_ray { double rgb[3], left, first, length; uint32_t steps; } foam_ray;

/* A ray from site to site, each time to the one whose plane comes first of all sites. */
TEST_FN foam_ray foam_march(const tetcast_site *s, uint32_t n, const tetcast_foam_info *info, const tetcast_ray *ray) {
    foam_ray m;
    double from = ray->t_min, to = ray->t_max, d[3], l = foam_length(ray->dir), t, best = (double)INFINITY;
    uint32_t i, a, at = 0;
    memset(&m, 0, sizeof m);
    m.left = 1;
    m.first = (double)INFINITY;
    if (from == 0 && to == 0) to = (double)INFINITY;
    for (a = 0; a < 3; a++) {
        double t0, t1;
        d[a] = ray->dir[a] / l;
        t0 = (info->box_min[a] - ray->org[a]) / d[a];
        t1 = (info->box_max[a] - ray->org[a]) / d[a];
        from = fmax(from, fmin(t0, t1));
        to = fmin(to, fmax(t0, t1));
    }
    if (!(from < to)) return m;
    for (i = 0; i < n; i++) {
        double square = 0;
        for (a = 0; a < 3; a++) square += pow(ray->org[a] + from * d[a] - s[i].position[a], 2);
        if (square < best) best = square, at = i;
    }
    for (t = from; t < to && m.steps <= n; m.steps++) {
        double next = to, w;
        uint32_t then = at;
        for (i = 0; i < n; i++) {
            double along = 0, offset = 0;
            for (a = 0; a < 3; a++) {
                const double e = s[i].position[a] - s[at].position[a];
                along += e * d[a];
                offset += e * (0.5 * (s[i].position[a] + s[at].position[a]) - ray->org[a]);
            }
            if (along > 1e-12 && offset / along < next) next = fmax(offset / along, t), then = i;
        }
        if (s[at].extinction > 0.0f && m.first == (double)INFINITY) m.first = t;
        w = m.left * (1.0 - exp(-(double)s[at].extinction * (next - t)));
        for (a = 0; a < 3; a++) m.rgb[a] += w * (double)s[at].rgb[a];
        m.left -= w;
        t = next;
        at = then;
    }
    m.length = to - from;
    return m;
}

#endif
