/* rbf_steps.h - the thesis' encoder of radial basis functions, to be compared with - MIT OR Unlicense, see LICENSE

   Rounds of four steps; 1 and 2 on what the rounds before left over:
   1  centres  a: the values are smoothed over the 25 nearest points by a Gaussian that narrows by 40 % a stage; points
                  where that has an extremum among its 25 become centres, until it is as narrow as the points lie close
               b: what a rough fit of those leaves is cut into clusters: the worst one across its principal axis, until
                  none is worse than the tolerance or there is one for 32 points: the next round goes on
   2  widths   half the way to the next centre; clusters: the width that explains 25 clusters around best. Then bounded
               Gauss-Newton steps, with the weights held
   3  weights and offset of all functions so far: least squares by conjugate gradients, not by a pseudo-inverse
   4  error at the points; another round unless it is small enough
   Domains: a kd-tree over the points; its leaves overlap, points in overlaps belong to all of them, and weights that sum
   to one share their values out. The functions of all leaves add up.
   A vector has common centres, and widths and weights for each component. Functions are Gaussians up to `cut` widths.
   In doubles; one thread, as it was. */
#ifndef RBF_STEPS_H_INCLUDED
#define RBF_STEPS_H_INCLUDED
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { STEPS_NEAR = 25, STEPS_MOST = 4 };

typedef struct steps_function { double c[3], width[STEPS_MOST], weight[STEPS_MOST]; uint32_t leaf; } steps_function;

typedef struct steps_desc {
    double max_error, mean_error;  /* of the length of the difference, absolute; mean 0: any */
    uint32_t leaf;                 /* points of a kd-cell, 0: one domain */
    double overlap;                /* of a cell's sides */
    uint32_t rounds;               /* at most */
    double cut;
} steps_desc;

typedef struct steps_model {
    steps_function *f;
    size_t count, room;
    double offset[STEPS_MOST];
    uint32_t components, leaves, rounds; /* rounds: of the leaf that took most */
    double (*box)[6];                    /* of leaves, with what they overlap */
    double max_error, mean_error;
} steps_model;

/* A domain: its points and what is left of their values. */
typedef struct steps_cell {
    size_t n;
    double (*p)[3], *res[STEPS_MOST], spacing;
    uint32_t (*near)[STEPS_NEAR];
    uint32_t components;
    double cut;
} steps_cell;

static double steps_way2(const double a[3], const double b[3]) {
    return (a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1]) + (a[2] - b[2]) * (a[2] - b[2]);
}

/* The 25 nearest points of each, itself among them; by looking at all. */
static void steps_neighbours(steps_cell *s) {
    size_t i, j;
    double sum = 0.0;
    for (i = 0; i < s->n; i++) {
        double best[STEPS_NEAR];
        uint32_t have = 0, k;
        for (j = 0; j < s->n; j++) {
            const double d = steps_way2(s->p[i], s->p[j]);
            if (have == STEPS_NEAR && d >= best[have - 1]) continue;
            if (have < STEPS_NEAR) have++;
            for (k = have - 1; k > 0 && best[k - 1] > d; k--) {
                best[k] = best[k - 1];
                s->near[i][k] = s->near[i][k - 1];
            }
            best[k] = d;
            s->near[i][k] = (uint32_t)j;
        }
        for (k = have; k < STEPS_NEAR; k++) s->near[i][k] = (uint32_t)i;
        sum += have > 1 ? sqrt(best[1]) : 1.0;
    }
    s->spacing = s->n != 0 ? sum / (double)s->n : 1.0;
}

static double steps_length(const steps_cell *s, size_t i) {
    double sum = 0.0;
    uint32_t c;
    for (c = 0; c < s->components; c++) sum += s->res[c][i] * s->res[c][i];
    return s->components == 1 ? s->res[0][i] : sqrt(sum);
}

static double steps_phi(const steps_cell *s, const steps_function *f, uint32_t c, const double p[3]) {
    const double d2 = steps_way2(f->c, p), w = f->width[c];
    return d2 < s->cut * s->cut * w * w ? exp(-0.5 * d2 / (w * w)) : 0.0;
}

/* Which points each function reaches, once for steps 2 and 3: lists one after the other. Reach: that of the widest. */
typedef struct steps_lists { size_t *first; uint32_t *point; double *phi; size_t room; } steps_lists;

static int steps_reach(const steps_cell *s, const steps_function *f, size_t count, double wider, steps_lists *l) {
    size_t i, j, n = 0;
    uint32_t c;
    for (i = 0; i < count; i++) {
        double w = 0.0;
        for (c = 0; c < s->components; c++) w = fmax(w, f[i].width[c]);
        w *= s->cut * wider;
        l->first[i] = n;
        for (j = 0; j < s->n; j++) {
            if (steps_way2(f[i].c, s->p[j]) >= w * w) continue;
            if (n == l->room) {
                uint32_t *grown = (uint32_t *)realloc(l->point, (l->room = 2 * l->room + 4096) * sizeof *grown);
                double *phi = (double *)realloc(l->phi, l->room * sizeof *phi);
                if (phi != NULL) l->phi = phi;
                if (grown != NULL) l->point = grown;
                if (grown == NULL || phi == NULL) return 0;
            }
            l->point[n++] = (uint32_t)j;
        }
    }
    l->first[count] = n;
    return 1;
}

/* Weights of one component for res by conjugate gradients on the normal equations; offset NULL: none. work: 2 n + 3
   (count + 1) doubles. */
static void steps_weights(const steps_cell *s, steps_function *f, size_t count, const steps_lists *l, uint32_t c, const double *res,
                          double *offset, double *work) {
    double *r = work, *ap = r + s->n, *g = ap + s->n, *d = g + count + 1, *x = d + count + 1, gg = 0.0, gg0 = 0.0;
    size_t i, k, step;
    memcpy(r, res, s->n * sizeof *r);
    memset(x, 0, (count + 1) * sizeof *x);
    for (i = 0; i < count; i++) /* values of functions at the points that they reach: the matrix, as far as it is not 0 */
        for (k = l->first[i]; k < l->first[i + 1]; k++) l->phi[k] = steps_phi(s, &f[i], c, s->p[l->point[k]]);
    for (step = 0; step < 200; step++) {
        double old = gg, energy = 0.0, alpha;
        gg = 0.0;
        for (i = 0; i <= count; i++) { /* gradient, with a little regularisation */
            double sum = 0.0;
            if (i == count) {
                if (offset != NULL) for (k = 0; k < s->n; k++) sum += r[k];
            } else for (k = l->first[i]; k < l->first[i + 1]; k++) sum += l->phi[k] * r[l->point[k]];
            g[i] = sum - 1e-6 * x[i];
            gg += g[i] * g[i];
        }
        if (step == 0) gg0 = gg;
        else if (!(gg > 1e-16 * gg0)) break;
        if (!(gg > 0.0)) break;
        for (i = 0; i <= count; i++) d[i] = g[i] + (step != 0 ? gg / old * d[i] : 0.0);
        for (k = 0; k < s->n; k++) ap[k] = offset != NULL ? d[count] : 0.0;
        for (i = 0; i < count; i++)
            for (k = l->first[i]; k < l->first[i + 1]; k++) ap[l->point[k]] += d[i] * l->phi[k];
        for (k = 0; k < s->n; k++) energy += ap[k] * ap[k];
        for (i = 0; i <= count; i++) energy += 1e-6 * d[i] * d[i];
        if (!(energy > 0.0)) break;
        alpha = gg / energy;
        for (i = 0; i <= count; i++) x[i] += alpha * d[i];
        for (k = 0; k < s->n; k++) r[k] -= alpha * ap[k];
    }
    for (i = 0; i < count; i++) f[i].weight[c] = x[i];
    if (offset != NULL) *offset = x[count];
}

static void steps_subtract(const steps_cell *s, const steps_function *f, size_t count, const steps_lists *l, uint32_t c, double offset,
                           double *res) {
    size_t i, k;
    for (k = 0; k < s->n; k++) res[k] -= offset;
    for (i = 0; i < count; i++)
        for (k = l->first[i]; k < l->first[i + 1]; k++) res[l->point[k]] -= f[i].weight[c] * steps_phi(s, &f[i], c, s->p[l->point[k]]);
}

/* Step 1a: extrema of ever less smoothed values. mark: 1 for points that are centres. */
static size_t steps_extrema(const steps_cell *s, uint8_t *mark, double *smooth) {
    double w = 2.5 * s->spacing;
    size_t i, found = 0;
    uint32_t k;
    for (; w > 0.5 * s->spacing; w *= 0.6) {
        for (i = 0; i < s->n; i++) {
            double sum = 0.0, all = 0.0;
            for (k = 0; k < STEPS_NEAR; k++) {
                const uint32_t j = s->near[i][k];
                const double g = exp(-0.5 * steps_way2(s->p[i], s->p[j]) / (w * w));
                sum += g * steps_length(s, j);
                all += g;
            }
            smooth[i] = sum / all;
        }
        for (i = 0; i < s->n; i++) {
            uint32_t above = 0, below = 0;
            for (k = 1; k < STEPS_NEAR; k++) {
                above += smooth[i] > smooth[s->near[i][k]];
                below += smooth[i] < smooth[s->near[i][k]];
            }
            if (!mark[i] && (above == STEPS_NEAR - 1 || below == STEPS_NEAR - 1)) {
                mark[i] = 1;
                found++;
            }
        }
    }
    return found;
}

typedef struct steps_cluster { size_t first, count; double centre[3], axis[3], error, width, weight[STEPS_MOST]; } steps_cluster;

/* Middle and principal axis (by powers of the covariance) of what is to be explained, and how badly one Gaussian there
   explains it. */
static void steps_cluster_look(const steps_cell *s, const uint32_t *order, steps_cluster *k) {
    double m[6] = {0, 0, 0, 0, 0, 0}, v[3] = {1.0, 0.7, 0.4}, up[STEPS_MOST] = {0, 0, 0, 0}, weight = 0.0, down = 0.0;
    size_t i;
    uint32_t a, step, c;
    memset(k->centre, 0, sizeof k->centre);
    for (i = 0; i < k->count; i++) weight += fabs(steps_length(s, order[k->first + i]));
    for (i = 0; i < k->count; i++) {
        const double w = weight > 1e-290 ? fabs(steps_length(s, order[k->first + i])) / weight : 1.0 / (double)k->count;
        for (a = 0; a < 3; a++) k->centre[a] += w * s->p[order[k->first + i]][a];
    }
    for (i = 0; i < k->count; i++) {
        const double w = weight > 1e-290 ? fabs(steps_length(s, order[k->first + i])) / weight : 1.0 / (double)k->count;
        const double *p = s->p[order[k->first + i]], x = p[0] - k->centre[0], y = p[1] - k->centre[1], z = p[2] - k->centre[2];
        m[0] += w * x * x;
        m[1] += w * y * y;
        m[2] += w * z * z;
        m[3] += w * x * y;
        m[4] += w * x * z;
        m[5] += w * y * z;
    }
    k->width = fmax(sqrt((m[0] + m[1] + m[2]) / 3.0), 0.5 * s->spacing);
    for (i = 0; i < k->count; i++) {
        const double phi = exp(-0.5 * steps_way2(s->p[order[k->first + i]], k->centre) / (k->width * k->width));
        for (c = 0; c < s->components; c++) up[c] += phi * s->res[c][order[k->first + i]];
        down += phi * phi;
    }
    k->error = 0.0;
    for (i = 0; i < k->count; i++) {
        const double phi = exp(-0.5 * steps_way2(s->p[order[k->first + i]], k->centre) / (k->width * k->width));
        double e = 0.0;
        for (c = 0; c < s->components; c++) {
            const double d = s->res[c][order[k->first + i]] - up[c] / down * phi;
            e += d * d;
        }
        k->error = fmax(k->error, sqrt(e));
    }
    for (c = 0; c < s->components; c++) k->weight[c] = up[c] / down;
    for (step = 0; step < 30; step++) {
        const double x = m[0] * v[0] + m[3] * v[1] + m[4] * v[2], y = m[3] * v[0] + m[1] * v[1] + m[5] * v[2];
        const double z = m[4] * v[0] + m[5] * v[1] + m[2] * v[2], l = sqrt(x * x + y * y + z * z);
        if (!(l > 0.0)) break;
        v[0] = x / l;
        v[1] = y / l;
        v[2] = z / l;
    }
    memcpy(k->axis, v, sizeof v);
    if (k->count < 2) k->error = 0.0;
}

/* Step 1b. Returns how many clusters there are. */
static size_t steps_clusters(const steps_cell *s, double tolerance, size_t most, uint32_t *order, steps_cluster *k) {
    size_t n = 1, i;
    for (i = 0; i < s->n; i++) order[i] = (uint32_t)i;
    k[0].first = 0;
    k[0].count = s->n;
    steps_cluster_look(s, order, &k[0]);
    while (n < most) {
        size_t worst = 0, lo, hi;
        steps_cluster *w;
        for (i = 1; i < n; i++) if (k[i].error > k[worst].error) worst = i;
        w = &k[worst];
        if (!(w->error > tolerance)) break;
        lo = w->first;
        hi = w->first + w->count;
        while (lo < hi) {
            const double *p = s->p[order[lo]];
            const double side = (p[0] - w->centre[0]) * w->axis[0] + (p[1] - w->centre[1]) * w->axis[1] + (p[2] - w->centre[2]) * w->axis[2];
            if (side < 0.0) lo++;
            else {
                const uint32_t t = order[lo];
                order[lo] = order[--hi];
                order[hi] = t;
            }
        }
        if (lo == w->first || lo == w->first + w->count) {
            w->error = 0.0;
            continue;
        }
        k[n].first = lo;
        k[n].count = w->first + w->count - lo;
        w->count = lo - w->first;
        steps_cluster_look(s, order, w);
        steps_cluster_look(s, order, &k[n++]);
    }
    return n;
}

/* Half the way to the next centre. */
static void steps_half_way(const steps_cell *s, steps_function *f, size_t count) {
    size_t i, j;
    uint32_t c;
    for (i = 0; i < count; i++) {
        double least = 1e300;
        for (j = 0; j < count; j++)
            if (j != i) least = fmin(least, steps_way2(f[i].c, f[j].c));
        least = least < 1e299 ? 0.5 * sqrt(least) : 4.0 * s->spacing;
        for (c = 0; c < s->components; c++) f[i].width[c] = fmax(least, 0.35 * s->spacing);
    }
}

/* Step 2: Gauss-Newton on the widths, weights held, each coordinate damped and bounded to 30 % a step. res: without the
   functions. */
static void steps_widths(const steps_cell *s, steps_function *f, size_t count, const steps_lists *l, uint32_t c, double *res) {
    size_t i, k;
    uint32_t step;
    steps_subtract(s, f, count, l, c, 0.0, res);
    for (step = 0; step < 3; step++)
        for (i = 0; i < count; i++) {
            const double w = f[i].width[c];
            double jj = 0.0, jr = 0.0, move;
            for (k = l->first[i]; k < l->first[i + 1]; k++) {
                const double *p = s->p[l->point[k]], g = f[i].weight[c] * steps_phi(s, &f[i], c, p);
                const double slope = g * steps_way2(f[i].c, p) / (w * w * w);
                jj += slope * slope;
                jr += slope * res[l->point[k]];
            }
            if (!(jj > 0.0)) continue;
            move = jr / (jj * 1.1);
            move = move > 0.3 * w ? 0.3 * w : move < -0.3 * w ? -0.3 * w : move;
            for (k = l->first[i]; k < l->first[i + 1]; k++) res[l->point[k]] += f[i].weight[c] * steps_phi(s, &f[i], c, s->p[l->point[k]]);
            f[i].width[c] = fmax(w + move, 0.3 * s->spacing);
            for (k = l->first[i]; k < l->first[i + 1]; k++) res[l->point[k]] -= f[i].weight[c] * steps_phi(s, &f[i], c, s->p[l->point[k]]);
        }
}

static double steps_most(const steps_cell *s, double *mean) {
    double most = 0.0;
    size_t i;
    *mean = 0.0;
    for (i = 0; i < s->n; i++) {
        const double e = fabs(steps_length(s, i));
        most = fmax(most, e);
        *mean += e / (double)s->n;
    }
    return most;
}

static int steps_keep(steps_model *m, const steps_function *f, size_t count) {
    if (m->count + count > m->room) {
        steps_function *grown = (steps_function *)realloc(m->f, (m->room = 2 * (m->count + count) + 64) * sizeof *grown);
        if (grown == NULL) return 0;
        m->f = grown;
    }
    memcpy(m->f + m->count, f, count * sizeof *f);
    for (count += m->count; m->count < count; m->count++) m->f[m->count].leaf = m->leaves;
    return 1;
}

/* Widths of the last `count` functions, then weights of all `all`, and what they leave of y. 0: no memory. */
static int steps_fit(steps_cell *s, steps_function *f, size_t all, size_t count, double *const *y, steps_lists *l, double *work,
                     double *offset) {
    double *copy = work + 2 * s->n + 3 * (all + 1);
    uint32_t c;
    l->first = (size_t *)realloc(l->first, (all + 2) * sizeof *l->first);
    if (l->first == NULL || !steps_reach(s, f + all - count, count, 1.5, l)) return 0;
    for (c = 0; c < s->components; c++) {
        memcpy(copy, s->res[c], s->n * sizeof *copy); /* the weights that widths are fitted with: values at the centres */
        steps_widths(s, f + all - count, count, l, c, copy);
    }
    if (!steps_reach(s, f, all, 1.0, l)) return 0;
    for (c = 0; c < s->components; c++) {
        memcpy(s->res[c], y[c], s->n * sizeof *copy);
        steps_weights(s, f, all, l, c, y[c], offset != NULL ? &offset[c] : NULL, work);
        steps_subtract(s, f, all, l, c, offset != NULL ? offset[c] : 0.0, s->res[c]);
    }
    return 1;
}

/* All rounds of one domain; its functions are added to the model. 0: no memory. */
static int steps_encode(steps_cell *s, const steps_desc *d, steps_model *m, double *offset) {
    const size_t n = s->n, end = 2 * n + 1; /* functions */
    uint8_t *mark = (uint8_t *)malloc(n + 1);
    uint32_t *order = (uint32_t *)malloc((n + 1) * sizeof *order);
    steps_cluster *k = (steps_cluster *)malloc((n + 1) * sizeof *k);
    steps_function *f = (steps_function *)malloc(end * sizeof *f);
    double *work = (double *)malloc((3 * n + 3 * end + 16) * sizeof *work), *y[STEPS_MOST] = {NULL, NULL, NULL, NULL}, mean, most;
    steps_lists l;
    size_t have = 0;
    uint32_t round, c;
    int ok = mark != NULL && order != NULL && k != NULL && f != NULL && work != NULL;
    memset(&l, 0, sizeof l);
    for (c = 0; c < s->components; c++) {
        ok = (y[c] = (double *)malloc((n + 1) * sizeof(double))) != NULL && ok;
        if (ok) memcpy(y[c], s->res[c], n * sizeof(double));
    }
    for (round = 0; ok && round < d->rounds; round++) {
        size_t i, count = 0, clusters;
        most = steps_most(s, &mean);
        if (most <= d->max_error && (d->mean_error == 0.0 || mean <= d->mean_error)) break;
        m->rounds = round + 1 > m->rounds ? round + 1 : m->rounds;
        memset(mark, 0, n);
        if (round == 0 && steps_extrema(s, mark, work) != 0) {
            for (i = 0; i < n; i++)
                if (mark[i]) {
                    memcpy(f[count].c, s->p[i], sizeof f[count].c);
                    for (c = 0; c < s->components; c++) f[count].weight[c] = s->res[c][i];
                    count++;
                }
            steps_half_way(s, f, count);
            ok = steps_fit(s, f, count, count, y, &l, work, offset);
            have = count;
            if (!ok) break;
        }
        clusters = steps_clusters(s, d->max_error, n / 32 + 1, order, k);
        if (clusters > end - have) break;
        for (i = 0; i < clusters; i++) {
            memcpy(f[have + i].c, k[i].centre, sizeof f[i].c);
            for (c = 0; c < s->components; c++) {
                f[have + i].weight[c] = k[i].weight[c];
                f[have + i].width[c] = k[i].width;
            }
        }
        have += clusters;
        ok = steps_fit(s, f, have, clusters, y, &l, work, offset);
    }
    ok = ok && steps_keep(m, f, have);
    for (c = 0; c < s->components; c++) free(y[c]);
    free(l.first);
    free(l.point);
    free(l.phi);
    free(mark);
    free(order);
    free(k);
    free(f);
    free(work);
    return ok;
}

/* ---- domains ---- */

typedef struct steps_tree {
    const double (*p)[3];
    const double *values;
    uint32_t components;
    const steps_desc *d;
    steps_model *m;
    double (*box)[6]; /* of the leaves: lo, hi */
    size_t boxes, room;
} steps_tree;

static int steps_cut(steps_tree *t, uint32_t *order, size_t n, const double lo[3], const double hi[3]) {
    double from[3] = {1e300, 1e300, 1e300}, to[3] = {-1e300, -1e300, -1e300}, half;
    size_t i, left = 0, right;
    uint32_t a, axis = 0;
    if (t->d->leaf == 0 || n <= t->d->leaf) {
        if (t->boxes == t->room) {
            double (*grown)[6] = (double (*)[6])realloc(t->box, (t->room = 2 * t->room + 64) * sizeof *grown);
            if (grown == NULL) return 0;
            t->box = grown;
        }
        memcpy(t->box[t->boxes], lo, 24);
        memcpy(t->box[t->boxes] + 3, hi, 24);
        t->boxes++;
        return 1;
    }
    for (i = 0; i < n; i++)
        for (a = 0; a < 3; a++) {
            from[a] = fmin(from[a], t->p[order[i]][a]);
            to[a] = fmax(to[a], t->p[order[i]][a]);
        }
    for (a = 1; a < 3; a++) if (to[a] - from[a] > to[axis] - from[axis]) axis = a;
    for (left = 0, right = n - 1; left < right;) { /* the median goes where it belongs */
        const double pivot = t->p[order[(left + right) / 2]][axis];
        size_t x = left, y = right;
        for (;;) {
            uint32_t swap;
            while (t->p[order[x]][axis] < pivot) x++;
            while (t->p[order[y]][axis] > pivot) y--;
            if (x >= y) break;
            swap = order[x];
            order[x++] = order[y];
            order[y--] = swap;
        }
        if (y >= n / 2) right = y;
        else left = y + 1;
    }
    half = t->p[order[n / 2]][axis];
    {
        double middle[3];
        memcpy(middle, hi, sizeof middle);
        middle[axis] = half;
        if (!steps_cut(t, order, n / 2, lo, middle)) return 0;
        memcpy(middle, lo, sizeof middle);
        middle[axis] = half;
        return steps_cut(t, order + n / 2, n - n / 2, middle, hi);
    }
}

static double steps_smooth(double t) {
    t = t < 0.0 ? 0.0 : t > 1.0 ? 1.0 : t;
    return t * t * (3.0 - 2.0 * t);
}

/* How much of a point belongs to a leaf, before all shares are made to sum to one. */
static double steps_share(const steps_tree *t, size_t leaf, const double p[3]) {
    const double *b = t->box[leaf];
    double w = 1.0;
    uint32_t a;
    for (a = 0; a < 3; a++) {
        const double h = fmax(t->d->overlap * (b[3 + a] - b[a]), 1e-300);
        w *= steps_smooth((p[a] - (b[a] - h)) / (2.0 * h)) * steps_smooth(((b[3 + a] + h) - p[a]) / (2.0 * h));
    }
    return w;
}

static void steps_model_free(steps_model *m) {
    free(m->f);
    free(m->box);
    memset(m, 0, sizeof *m);
}

static void steps_value(const steps_model *m, double cut, const double p[3], double *v) {
    size_t i;
    uint32_t c;
    for (c = 0; c < m->components; c++) v[c] = m->offset[c];
    for (i = 0; i < m->count; i++) {
        const double d2 = steps_way2(m->f[i].c, p), *b = m->box[m->f[i].leaf];
        if (!(p[0] >= b[0] && p[1] >= b[1] && p[2] >= b[2] && p[0] <= b[3] && p[1] <= b[4] && p[2] <= b[5])) continue;
        for (c = 0; c < m->components; c++) {
            const double w = m->f[i].width[c];
            if (d2 < cut * cut * w * w) v[c] += m->f[i].weight[c] * exp(-0.5 * d2 / (w * w));
        }
    }
}

/* Encode values [n][components] at points. 0: no memory. bytes as the thesis stores it: 4 for each number. */
static int steps_run(const steps_desc *d, const double (*p)[3], const double *values, size_t n, uint32_t components, steps_model *m) {
    double lo[3] = {1e300, 1e300, 1e300}, hi[3] = {-1e300, -1e300, -1e300}, *total = NULL, offset[STEPS_MOST];
    steps_tree t;
    uint32_t *order = (uint32_t *)malloc((n + 1) * sizeof *order), a, c;
    size_t i, leaf;
    int ok = order != NULL;
    memset(m, 0, sizeof *m);
    memset(&t, 0, sizeof t);
    m->components = components;
    t.p = p;
    t.values = values;
    t.components = components;
    t.d = d;
    t.m = m;
    for (i = 0; ok && i < n; i++) {
        order[i] = (uint32_t)i;
        for (a = 0; a < 3; a++) {
            lo[a] = fmin(lo[a], p[i][a]);
            hi[a] = fmax(hi[a], p[i][a]);
        }
        for (c = 0; c < components; c++) m->offset[c] += values[i * components + c] / (double)n;
    }
    ok = ok && steps_cut(&t, order, n, lo, hi);
    if (ok) total = (double *)calloc(n + 1, sizeof *total);
    ok = ok && total != NULL;
    for (i = 0; ok && i < n; i++)
        for (leaf = 0; leaf < t.boxes; leaf++) total[i] += t.boxes == 1 ? 1.0 : steps_share(&t, leaf, p[i]);
    for (leaf = 0; ok && leaf < t.boxes; leaf++) {
        steps_cell s;
        memset(&s, 0, sizeof s);
        s.components = components;
        s.cut = d->cut;
        s.p = (double (*)[3])malloc((n + 1) * sizeof *s.p);
        for (c = 0; c < components; c++) ok = (s.res[c] = (double *)malloc((n + 1) * sizeof(double))) != NULL && ok;
        ok = ok && s.p != NULL;
        for (i = 0; ok && i < n; i++) {
            const double w = t.boxes == 1 ? 1.0 : steps_share(&t, leaf, p[i]) / total[i];
            if (!(w > 0.0)) continue;
            memcpy(s.p[s.n], p[i], sizeof s.p[0]);
            for (c = 0; c < components; c++) s.res[c][s.n] = w * (values[i * components + c] - m->offset[c]);
            s.n++;
        }
        s.near = (uint32_t (*)[STEPS_NEAR])malloc((s.n + 1) * sizeof *s.near);
        ok = ok && s.near != NULL;
        if (ok) steps_neighbours(&s);
        /* an offset would be one of all space: only where there is one domain; several errors meet in overlaps */
        memset(offset, 0, sizeof offset);
        if (ok && s.n != 0) {
            steps_desc one = *d;
            if (t.boxes > 1) one.max_error *= 0.7;
            ok = steps_encode(&s, &one, m, t.boxes == 1 ? offset : NULL);
        }
        for (c = 0; c < components; c++) {
            m->offset[c] += offset[c];
            free(s.res[c]);
        }
        free(s.p);
        free(s.near);
        m->leaves++;
    }
    m->box = t.box;
    for (leaf = 0; leaf < t.boxes; leaf++)
        for (a = 0; a < 3; a++) {
            const double h = t.boxes == 1 ? 1e300 : d->overlap * (t.box[leaf][3 + a] - t.box[leaf][a]);
            t.box[leaf][a] -= h;
            t.box[leaf][3 + a] += h;
        }
    for (i = 0; ok && i < n; i++) {
        double v[STEPS_MOST], e = 0.0;
        steps_value(m, d->cut, p[i], v);
        for (c = 0; c < components; c++) e += (v[c] - values[i * components + c]) * (v[c] - values[i * components + c]);
        m->max_error = fmax(m->max_error, sqrt(e));
        m->mean_error += sqrt(e) / (double)n;
    }
    free(order);
    free(total);
    if (!ok) steps_model_free(m);
    return ok;
}

static size_t steps_bytes(const steps_model *m) {
    return m->count * 4 * (3 + 2 * (size_t)m->components) + 4 * m->components + (m->leaves > 1 ? 24 * (size_t)m->leaves : 0);
}

#endif
