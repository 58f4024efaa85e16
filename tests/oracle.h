/* oracle.h - exact ray stepping through a grid of bits, and a judge of what a tracer reports - C99 and C++11 - MIT OR
   Unlicense, see LICENSE

   A cell is a unit cube, the grid's corner is the origin. A ray's numbers are floats (24 bits), planes are integers
   below 2^24. The time at which a ray meets plane k of axis a is t = (k - o[a]) / d[a]. Two such times are compared by
   the sign of
       k*d[b] - o[a]*d[b] - j*d[a] + o[b]*d[a]
   Each product has at most 48 bits and an exponent between -298 and 256, so it is exact in a double; the sign of the
   sum of four doubles is taken from their exact sum, an expansion made with error-free additions (Shewchuk 1997, grow
   expansion). A comparison with a float T is the sign of k - o[a] - T*d[a], by the same argument. Plain doubles decide
   first, but only where they differ by more than their error bound. So no answer here depends on rounding; it needs
   doubles that are not computed with more bits (FLT_EVAL_METHOD 0).

   Several answers are right where a ray meets an edge or a corner of cells: tied axes step one after the other, in any
   order, and a ray that runs in a plane of the grid may belong to either side (the side is kept). The judge follows
   all of them: a hit is admissible if some 6-connected sequence of empty cells leads to the hit cell, at the time and
   through the face that were reported; a miss if some sequence reaches the end of the ray. Away from ties there is
   exactly one answer. */
#ifndef ORACLE_H_INCLUDED
#define ORACLE_H_INCLUDED
#include <float.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if defined(__GNUC__)
#  define ORACLE_FN static __attribute__((unused))
#else
#  define ORACLE_FN static
#endif

typedef struct oracle_grid { /* cells lo <= c < lo + n are stored, all others are empty */
    int32_t lo[3], n[3];
    uint8_t *bits;
} oracle_grid;

typedef struct oracle_ray { double o[3], d[3], t_min, t_max; } oracle_ray; /* values of floats, see above */

typedef struct oracle_hit {
    int hit;
    int32_t cell[3];
    double t;
    int face;   /* 0 -x, 1 +x, 2 -y, 3 +y, 4 -z, 5 +z, 6 starts inside */
    int ties;   /* out: exact ties met on the way, 0: the answer is the only one */
} oracle_hit;

ORACLE_FN int oracle_grid_make(oracle_grid *g, const int32_t lo[3], const int32_t n[3]) {
    memcpy(g->lo, lo, sizeof g->lo);
    memcpy(g->n, n, sizeof g->n);
    g->bits = (uint8_t *)calloc(((size_t)n[0] * (size_t)n[1] * (size_t)n[2] + 7) / 8, 1);
    return g->bits != NULL;
}

ORACLE_FN size_t oracle_index(const oracle_grid *g, int32_t x, int32_t y, int32_t z) { /* of a bit; -1: outside */
    x -= g->lo[0];
    y -= g->lo[1];
    z -= g->lo[2];
    if (x < 0 || y < 0 || z < 0 || x >= g->n[0] || y >= g->n[1] || z >= g->n[2]) return (size_t)-1;
    return ((size_t)z * (size_t)g->n[1] + (size_t)y) * (size_t)g->n[0] + (size_t)x;
}

ORACLE_FN int oracle_get(const oracle_grid *g, int32_t x, int32_t y, int32_t z) {
    size_t i = oracle_index(g, x, y, z);
    return i != (size_t)-1 && (g->bits[i >> 3] >> (i & 7) & 1) != 0;
}

ORACLE_FN void oracle_set(oracle_grid *g, int32_t x, int32_t y, int32_t z) {
    size_t i = oracle_index(g, x, y, z);
    if (i != (size_t)-1) g->bits[i >> 3] = (uint8_t)(g->bits[i >> 3] | 1u << (i & 7));
}

/* ---- exact comparison of times: (a, k) is plane k of axis a, (3, T) the time T ---- */

ORACLE_FN int oracle_sum_sign(const double *v, int n) {
    double e[4];
    int i, j, m = 0;
    for (i = 0; i < n; i++) {
        double q = v[i];
        for (j = 0; j < m; j++) { /* two-sum: q + e[j] = s + err, exactly */
            double s = q + e[j], b = s - q, err = (q - (s - b)) + (e[j] - b);
            e[j] = err;
            q = s;
        }
        e[m++] = q;
    }
    for (j = m; j-- > 0;) /* the parts do not overlap: the largest one has the sign */
        if (e[j] != 0) return e[j] > 0 ? 1 : -1;
    return 0;
}

ORACLE_FN double oracle_time(const oracle_ray *r, int a, double k) { /* relative error below 2^-52 */
    return a == 3 ? k : (k - r->o[a]) / r->d[a];
}

ORACLE_FN int oracle_cmp(const oracle_ray *r, int a, double k, int b, double j) { /* sign of time(a,k) - time(b,j) */
    double ta = oracle_time(r, a, k), tb = oracle_time(r, b, j), v[4];
    int s;
    if (fabs(ta - tb) > 1e-15 * (fabs(ta) + fabs(tb))) return ta > tb ? 1 : -1;
    if (a == 3 && b == 3) return (k > j) - (k < j);
    if (a == 3) return -oracle_cmp(r, b, j, a, k);
    if (b == 3) {
        if (isinf(j)) return j > 0 ? -1 : 1;
        v[0] = k;
        v[1] = -r->o[a];
        v[2] = -(j * r->d[a]);
        s = oracle_sum_sign(v, 3);
        return r->d[a] > 0 ? s : -s;
    }
    v[0] = k * r->d[b];
    v[1] = -(r->o[a] * r->d[b]);
    v[2] = -(j * r->d[a]);
    v[3] = r->o[b] * r->d[a];
    s = oracle_sum_sign(v, 4);
    return (r->d[a] > 0) == (r->d[b] > 0) ? s : -s;
}

/* ---- the walk ---- */

typedef struct oracle_walk {
    const oracle_grid *g;
    const oracle_ray *r;
    const oracle_hit *said; /* what the judge judges, or NULL */
    oracle_hit first;       /* the first admissible hit that was met */
    int32_t c[3];           /* the cell behind the coming event, for alternative 0 */
    int step[3];
    int alive;              /* bit i: alternative i (side of the planes that the ray runs in) is still in empty cells */
    int side[4][3];         /* cell of alternative i = c + side[i] */
    int cell_ok, time_ok, face_ok;
} oracle_walk;

ORACLE_FN double oracle_ulp(double t) { /* distance of the floats around t */
    int e;
    if (isinf(t)) return 0;
    (void)frexp(t, &e);
    return ldexp(1.0, e - 24 > -149 ? e - 24 : -149);
}

ORACLE_FN void oracle_offer(oracle_walk *w, const int32_t c[3], double t, unsigned faces) {
    const oracle_hit *h = w->said;
    int f;
    if (t > w->r->t_max + oracle_ulp(w->r->t_max)) return;
    if (!w->first.hit) {
        w->first.hit = 1;
        memcpy(w->first.cell, c, sizeof w->first.cell);
        w->first.t = t;
        for (f = 6; (faces >> f & 1) == 0;) f--;
        w->first.face = f;
    }
    if (h == NULL || !h->hit || memcmp(h->cell, c, sizeof h->cell) != 0) return;
    w->cell_ok = 1;
    if (!(fabs(h->t - t) <= oracle_ulp(t) * 1.0001)) return; /* 1 ulp, and the double's error */
    w->time_ok = 1;
    if (h->face >= 0 && h->face < 7 && (faces >> h->face & 1) != 0) w->face_ok = 1;
}

/* The axes of `tied` step at time t, one after the other in any order. */
ORACLE_FN void oracle_event(oracle_walk *w, int tied, double t, int start) {
    int i, a, set;
    for (i = 0; i < 4; i++) {
        int open[8]; /* the cell is reached and empty */
        if ((w->alive >> i & 1) == 0) continue;
        for (set = 0; set < 8; set++) {
            int32_t c[3];
            unsigned faces = start ? 1u << 6 : 0;
            open[set] = 0;
            if ((set & ~tied) != 0) continue;
            for (a = 0; a < 3; a++) {
                c[a] = w->c[a] + w->side[i][a] + ((set >> a & 1) != 0 ? w->step[a] : 0);
                if ((set >> a & 1) != 0 && (start || open[set ^ 1 << a])) faces |= 1u << (2 * a + (w->step[a] < 0));
            }
            if (faces == 0 && set != 0) continue;
            if (!oracle_get(w->g, c[0], c[1], c[2])) open[set] = 1;
            else if (faces != 0) oracle_offer(w, c, t, faces);
        }
        if (!open[tied]) w->alive &= ~(1 << i);
    }
    for (a = 0; a < 3; a++) if ((tied >> a & 1) != 0) w->c[a] += w->step[a];
    if ((tied & (tied - 1)) != 0) w->first.ties++;
}

/* Bring the walk to the grid. 0: the ray misses it. */
ORACLE_FN int oracle_start(oracle_walk *w, int *tied, double *t) {
    const oracle_ray *r = w->r;
    int a, ea = 3;
    double ek = r->t_min; /* the start is the last of t_min and the entries into the grid and one cell around it */
    w->alive = 1;
    *tied = 0;
    for (a = 0; a < 3; a++) {
        double lo = w->g->lo[a] - 1, hi = w->g->lo[a] + w->g->n[a] + 1;
        w->step[a] = r->d[a] > 0 ? 1 : r->d[a] < 0 ? -1 : 0;
        if (w->step[a] == 0 && (r->o[a] < lo || r->o[a] > hi)) return 0;
        if (w->step[a] != 0 && oracle_cmp(r, a, w->step[a] > 0 ? lo : hi, ea, ek) > 0) {
            ea = a;
            ek = w->step[a] > 0 ? lo : hi;
        }
    }
    for (a = 0; a < 3; a++) {
        int32_t lo = w->g->lo[a] - 1, hi = w->g->lo[a] + w->g->n[a] + 1;
        if (w->step[a] == 0) {
            w->c[a] = (int32_t)floor(r->o[a]);
            if (r->o[a] == floor(r->o[a])) { /* in a plane: both sides */
                int i, n = w->alive == 1 ? 1 : 2;
                for (i = 0; i < n; i++) {
                    memcpy(w->side[n + i], w->side[i], sizeof w->side[i]);
                    w->side[n + i][a] = -1;
                }
                w->alive = n == 1 ? 3 : 15;
                w->first.ties++;
            }
        } else if (w->step[a] > 0) { /* the last plane that is behind or at the start */
            if (oracle_cmp(r, a, hi, ea, ek) <= 0) return 0;
            while (hi - lo > 1) {
                int32_t m = lo + (hi - lo) / 2;
                if (oracle_cmp(r, a, m, ea, ek) <= 0) lo = m; else hi = m;
            }
            w->c[a] = lo;
            if (oracle_cmp(r, a, lo, ea, ek) == 0) { *tied |= 1 << a; w->c[a]--; }
        } else {
            if (oracle_cmp(r, a, lo, ea, ek) <= 0) return 0;
            while (hi - lo > 1) {
                int32_t m = lo + (hi - lo) / 2;
                if (oracle_cmp(r, a, m, ea, ek) <= 0) hi = m; else lo = m;
            }
            w->c[a] = hi - 1;
            if (oracle_cmp(r, a, hi, ea, ek) == 0) { *tied |= 1 << a; w->c[a]++; }
        }
    }
    *t = oracle_time(r, ea, ek);
    if (ea == 3 && *tied != 0) w->first.ties++;
    return 1;
}

/* NULL: what `said` reports is admissible; else why it is not. said = NULL: only the first hit is wanted.
   *first (may be NULL) receives the first admissible hit met, or hit = 0. Rays are finite, d is not 0. */
ORACLE_FN const char *oracle_judge(const oracle_grid *g, const oracle_ray *r, const oracle_hit *said,
                                   oracle_hit *first) {
    oracle_walk w;
    double t = 0, next[3] = {HUGE_VAL, HUGE_VAL, HUGE_VAL}, u = oracle_ulp(r->t_max);
    int a, tied = 0, miss_ok = 0;
    memset(&w, 0, sizeof w);
    w.g = g;
    w.r = r;
    w.said = said;
    if (!(r->t_min < r->t_max) || !oracle_start(&w, &tied, &t) || t > r->t_max + u) {
        miss_ok = 1;
        w.alive = 0;
    } else {
        miss_ok = t >= r->t_max - u;
        oracle_event(&w, tied, t, 1);
        for (a = 0; a < 3; a++)
            if (w.step[a] != 0) next[a] = oracle_time(r, a, w.c[a] + (w.step[a] > 0));
    }
    while (w.alive != 0) {
        int k = next[0] <= next[1] ? (next[0] <= next[2] ? 0 : 2) : (next[1] <= next[2] ? 1 : 2), left = 0;
        double nk = next[k];
        tied = 1 << k;
        for (a = 0; a < 3; a++) /* others within the error bound: exact comparison with the earliest so far */
            if (a != k && w.step[a] != 0 && next[a] - nk <= 1e-15 * (fabs(next[a]) + fabs(nk))) {
                int e = tied & 1 ? 0 : tied & 2 ? 1 : 2;
                int s = oracle_cmp(r, a, w.c[a] + (w.step[a] > 0), e, w.c[e] + (w.step[e] > 0));
                if (s < 0) tied = 1 << a;
                else if (s == 0) tied |= 1 << a;
            }
        t = oracle_time(r, tied & 1 ? 0 : tied & 2 ? 1 : 2, tied & 1 ? w.c[0] + (w.step[0] > 0) :
                        tied & 2 ? w.c[1] + (w.step[1] > 0) : w.c[2] + (w.step[2] > 0));
        if (t >= r->t_max - u || t > (double)FLT_MAX) miss_ok = 1; /* so near the end that rounding decides */
        if (t > r->t_max + u || t > 2.0 * (double)FLT_MAX) break;
        oracle_event(&w, tied, t, 0);
        for (a = 0; a < 3; a++) {
            if ((tied >> a & 1) == 0) continue;
            left |= w.step[a] > 0 ? w.c[a] >= g->lo[a] + g->n[a] : w.c[a] < g->lo[a];
            next[a] = oracle_time(r, a, w.c[a] + (w.step[a] > 0));
        }
        if (left) break;
    }
    if (w.alive != 0) miss_ok = 1;
    if (!w.first.hit) w.first.t = HUGE_VAL;
    if (first != NULL) *first = w.first;
    if (said == NULL) return NULL;
    if (!said->hit) return miss_ok ? NULL : "miss, but filled cells close the way";
    if (!w.cell_ok) return w.first.hit ? "not the first filled cell" : "hit, but nothing is there";
    if (!w.time_ok) return "t is not the time of entry";
    if (!w.face_ok) return "not the face of entry";
    if (!(said->t >= r->t_min && said->t < r->t_max)) return "t is not in [t_min, t_max)";
    return NULL;
}

#endif /* ORACLE_H_INCLUDED */
