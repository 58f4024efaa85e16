/* Closest hits against a loop over all triangles in double; surfaces without gaps; instances; odd rays; both forms. */
#include "test.h"
#define ZBUFRAND_IMPLEMENTATION
#include "zbufrand.h"
#include "../bench/baseline/hit_matrix.h"
#include "../bench/baseline/zbuffer.h"

/* ---- scenes and what they mean, written down a second time ---- */

typedef struct rays_shape {
    float *p;
    uint32_t *index;
    uint32_t vertices, triangles, two_sided;
} rays_shape;

typedef struct placed { const rays_shape *s; double m[3][4]; } placed; /* a mesh as it is drawn */

typedef struct rays_world {
    zbufrand_scene *scene;
    placed *list;
    uint32_t count, room;
} rays_world;

static void shape_alloc(rays_shape *s, uint32_t vertices, uint32_t triangles) {
    s->p = (float *)malloc(3 * sizeof(float) * vertices);
    s->index = (uint32_t *)malloc(3 * sizeof(uint32_t) * triangles);
    if (s->p == NULL || s->index == NULL) abort();
    s->vertices = vertices;
    s->triangles = triangles;
    s->two_sided = 0;
}
static void rays_shape_free(rays_shape *s) { free(s->p); free(s->index); }

/* Closed: poles are single vertices. */
static void rays_shape_sphere(rays_shape *s, test_rng *g, uint32_t nu, uint32_t nv, double radius, double bumps) {
    uint32_t i, j, n = 0, t = 0, k;
    shape_alloc(s, nu * (nv - 1) + 2, 2 * nu * (nv - 1));
    for (j = 0; j <= nv; j++) {
        for (i = 0; i < (j == 0 || j == nv ? 1 : nu); i++) {
            double a = 3.14159265358979 * j / nv, b = 6.28318530717959 * i / nu, r = radius * (1 - bumps * test_rng_double(g));
            s->p[3 * n] = (float)(r * sin(a) * cos(b));
            s->p[3 * n + 1] = (float)(r * cos(a));
            s->p[3 * n + 2] = (float)(r * sin(a) * sin(b));
            n++;
        }
    }
    for (j = 0; j < nv; j++) {
        for (i = 0; i < nu; i++) {
            uint32_t a = j == 0 ? 0 : 1 + (j - 1) * nu + i, b = j == 0 ? 0 : 1 + (j - 1) * nu + (i + 1) % nu;
            uint32_t c = j + 1 == nv ? n - 1 : 1 + j * nu + i, d = j + 1 == nv ? n - 1 : 1 + j * nu + (i + 1) % nu;
            uint32_t six[6];
            six[0] = a; six[1] = b; six[2] = c; six[3] = b; six[4] = d; six[5] = c; /* outside is counter-clockwise */
            for (k = j == 0 ? 3 : 0; k < (j + 1 == nv ? 3u : 6u); k++) s->index[t++] = six[k];
        }
    }
    CHECK_EQ_U64(t, 3 * s->triangles);
    CHECK_EQ_U64(n, s->vertices);
}

static void shape_soup(rays_shape *s, test_rng *g, uint32_t n, double size) {
    uint32_t i, k;
    shape_alloc(s, 3 * n, n);
    for (i = 0; i < n; i++) {
        double c[3];
        for (k = 0; k < 3; k++) c[k] = 2 * test_rng_double(g) - 1;
        for (k = 0; k < 9; k++) s->p[9 * i + k] = (float)(c[k % 3] + size * (2 * test_rng_double(g) - 1));
    }
    for (i = 0; i < 3 * n; i++) s->index[i] = i;
}

static void world_open(rays_world *w) {
    memset(w, 0, sizeof *w);
    if (zbufrand_scene_create(NULL, &w->scene) != ZBUFRAND_OK) abort();
}
static void world_close(rays_world *w) {
    zbufrand_scene_destroy(w->scene);
    free(w->list);
}
static void world_place(rays_world *w, const rays_shape *s, const double m[3][4]) {
    if (w->count == w->room) {
        w->room = 2 * w->room + 16;
        w->list = (placed *)realloc(w->list, w->room * sizeof *w->list);
        if (w->list == NULL) abort();
    }
    w->list[w->count].s = s;
    memcpy(w->list[w->count++].m, m, 12 * sizeof(double));
}

static zbufrand_node world_mesh(rays_world *w, zbufrand_node parent, const zbufrand_transform *t, uint32_t flags, const rays_shape *s) {
    zbufrand_mesh m;
    zbufrand_node n = 0;
    memset(&m, 0, sizeof m);
    m.positions = s->p;
    m.vertex_count = s->vertices;
    m.indices = s->index;
    m.triangle_count = s->triangles;
    m.two_sided = s->two_sided;
    CHECK_EQ_U64(zbufrand_add_mesh(w->scene, parent, t, flags, &m, &n), ZBUFRAND_OK);
    return n;
}

static void random_similarity(test_rng *g, double scale, double move, int mirror, zbufrand_transform *t) {
    double q[4], l = 0, m[3][3];
    int i, j;
    for (i = 0; i < 4; i++) { q[i] = test_rng_double(g) - 0.5; l += q[i] * q[i]; }
    for (i = 0; i < 4; i++) q[i] /= sqrt(l);
    m[0][0] = 1 - 2 * (q[2] * q[2] + q[3] * q[3]); m[0][1] = 2 * (q[1] * q[2] - q[0] * q[3]); m[0][2] = 2 * (q[1] * q[3] + q[0] * q[2]);
    m[1][0] = 2 * (q[1] * q[2] + q[0] * q[3]); m[1][1] = 1 - 2 * (q[1] * q[1] + q[3] * q[3]); m[1][2] = 2 * (q[2] * q[3] - q[0] * q[1]);
    m[2][0] = 2 * (q[1] * q[3] - q[0] * q[2]); m[2][1] = 2 * (q[2] * q[3] + q[0] * q[1]); m[2][2] = 1 - 2 * (q[1] * q[1] + q[2] * q[2]);
    for (i = 0; i < 3; i++) {
        for (j = 0; j < 3; j++) t->m[i][j] = scale * m[i][j] * (mirror && j == 0 ? -1.0 : 1.0);
        t->m[i][3] = move * (2 * test_rng_double(g) - 1);
    }
}
static void compose(double a[3][4], double b[3][4], double out[3][4]) {
    int i, j;
    for (i = 0; i < 3; i++) for (j = 0; j < 4; j++) out[i][j] = a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j] + (j == 3 ? a[i][3] : 0);
}
static zbufrand_transform identity(void) {
    zbufrand_transform t;
    memset(&t, 0, sizeof t);
    t.m[0][0] = t.m[1][1] = t.m[2][2] = 1;
    return t;
}

/* ---- the oracle ---- */

typedef struct truth {
    double t;       /* INFINITY: nothing */
    double second;  /* next hit behind it */
    int unsure;     /* the ray passes close to an edge in front of it */
} truth;

static truth brute(const rays_world *w, const double o[3], const double d[3], double t_min, double t_max) {
    truth r;
    uint32_t k, i, a, c;
    r.t = r.second = (double)INFINITY;
    r.unsure = 0;
    for (k = 0; k < w->count; k++) {
        double det3 = 0, close_t = 0;
        const placed *p = &w->list[k];
        int odd;
        det3 = p->m[0][0] * (p->m[1][1] * p->m[2][2] - p->m[1][2] * p->m[2][1]) - p->m[0][1] * (p->m[1][0] * p->m[2][2] - p->m[1][2] * p->m[2][0]) +
               p->m[0][2] * (p->m[1][0] * p->m[2][1] - p->m[1][1] * p->m[2][0]);
        odd = det3 < 0;
        for (i = 0; i < p->s->triangles; i++) {
            double v[3][3], e1[3], e2[3], n[3], q[3], x[3], dn = 0, qn = 0, t, b1, b2, len, margin = 1e-5;
            for (c = 0; c < 3; c++) {
                const float *f = &p->s->p[3 * p->s->index[3 * i + c]];
                for (a = 0; a < 3; a++) v[c][a] = p->m[a][0] * (double)f[0] + p->m[a][1] * (double)f[1] + p->m[a][2] * (double)f[2] + p->m[a][3];
            }
            for (a = 0; a < 3; a++) { e1[a] = v[1][a] - v[0][a]; e2[a] = v[2][a] - v[0][a]; q[a] = v[0][a] - o[a]; }
            for (a = 0; a < 3; a++) n[a] = e1[(a + 1) % 3] * e2[(a + 2) % 3] - e1[(a + 2) % 3] * e2[(a + 1) % 3];
            for (a = 0; a < 3; a++) { dn += d[a] * n[a]; qn += q[a] * n[a]; }
            if (dn == 0) continue;
            if (!p->s->two_sided && (odd ? dn < 0 : dn > 0)) continue;
            t = qn / dn;
            if (!(t >= t_min && t <= t_max)) continue;
            len = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
            for (a = 0; a < 3; a++) x[a] = t * d[a] - q[a];
            b1 = b2 = 0;
            for (a = 0; a < 3; a++) {
                b1 += n[a] * (x[(a + 1) % 3] * e2[(a + 2) % 3] - x[(a + 2) % 3] * e2[(a + 1) % 3]);
                b2 += n[a] * (e1[(a + 1) % 3] * x[(a + 2) % 3] - e1[(a + 2) % 3] * x[(a + 1) % 3]);
            }
            b1 /= len;
            b2 /= len;
            close_t = fabs(dn) / sqrt(len * (d[0] * d[0] + d[1] * d[1] + d[2] * d[2])); /* cosine: grazing hits are unsure */
            margin = 1e-5 / (close_t + 1e-6);
            if (b1 < -margin || b2 < -margin || b1 + b2 > 1 + margin) continue;
            if ((b1 < margin || b2 < margin || b1 + b2 > 1 - margin) && t < r.t * (1 + 1e-5)) {
                r.unsure = 1;
                continue;
            }
            if (b1 < 0 || b2 < 0 || b1 + b2 > 1) continue;
            if (t < r.t) { r.second = r.t; r.t = t; }
            else if (t < r.second) r.second = t;
        }
    }
    return r;
}

/* The path counts as far as there are levels, and bytes between the members say nothing. */
static int same_hit(const zbufrandi_ray_hit *a, const zbufrandi_ray_hit *b) {
    return memcmp(a, b, offsetof(zbufrandi_ray_hit, path)) == 0 && memcmp(a->path, b->path, a->levels * sizeof *a->path) == 0;
}

/* Corners of a hit in world coordinates. */
static void hit_point(const rays_world *w, const zbufrandi_rays *r, const zbufrandi_ray_hit *h, double x[3]) {
    const zbufrandi_structure *s = &r->structure[h->structure];
    const zbufrandi_cluster *c = &s->cluster[h->cluster];
    double m[3][4], p[3] = {0, 0, 0};
    int k, a;
    baseline_hit_matrix(r, h, m);
    for (k = 0; k < 3; k++) {
        const float *v = s->position + 3 * ((size_t)c->first_vertex + s->triangle[3 * (size_t)h->triangle + (size_t)k]);
        double weight = k == 0 ? 1.0 - (double)h->u - (double)h->v : k == 1 ? (double)h->u : (double)h->v;
        for (a = 0; a < 3; a++) p[a] += weight * (double)v[a];
    }
    for (a = 0; a < 3; a++) x[a] = m[a][0] * p[0] + m[a][1] * p[1] + m[a][2] * p[2] + m[a][3] + w->scene->structure[0].origin[a];
}

static void rays_open(rays_world *w, zbufrandi_rays *r, int level) {
    zbufrand_scene *s = w->scene;
    CHECK(zbufrandi_rays_begin(r, &s->mem, &s->env, s->structure, s->structure_count, level));
}
static void rays_close(rays_world *w, zbufrandi_rays *r) { zbufrandi_rays_end(r, &w->scene->mem); }

static int cast(const rays_world *w, const zbufrandi_rays *r, const double o[3], const double d[3], double t_min, double t_max, zbufrandi_ray_hit *h) {
    zbufrandi_ray ray;
    int a;
    for (a = 0; a < 3; a++) { ray.o[a] = o[a] - w->scene->structure[0].origin[a]; ray.d[a] = d[a]; }
    ray.t_min = t_min;
    ray.t_max = t_max;
    return zbufrandi_ray_cast(r, &ray, h, NULL, 0);
}

static void check_rays(const rays_world *w, const zbufrandi_rays *r, test_rng *g, int n, double radius, double tolerance) {
    int k, a, unsure = 0, hits = 0;
    for (k = 0; k < n; k++) {
        double o[3], d[3], x[3], t_min = k % 5 == 0 ? test_rng_double(g) : 0, t_max = k % 7 == 0 ? radius * test_rng_double(g) : (double)INFINITY, len = 0;
        zbufrandi_ray_hit h;
        truth want;
        int got;
        for (a = 0; a < 3; a++) {
            o[a] = radius * (2 * test_rng_double(g) - 1);
            d[a] = radius * 0.5 * (2 * test_rng_double(g) - 1) - (k & 1 ? o[a] : 0);
            len += d[a] * d[a];
        }
        for (a = 0; a < 3; a++) d[a] *= (k % 3 == 0 ? 17.0 : 1.0) / sqrt(len);
        got = cast(w, r, o, d, t_min, t_max, &h);
        want = brute(w, o, d, t_min, t_max);
        if (want.unsure || fabs(want.t - t_min) < 1e-4 || fabs(want.t - t_max) < 1e-4) { unsure++; continue; }
        CHECK_MSG(got == (want.t < (double)INFINITY), "ray %d: got %d, want t %g", k, got, want.t);
        if (!got || !(want.t < (double)INFINITY)) continue;
        hits++;
        CHECK_MSG(fabs(h.t - want.t) <= tolerance * (1 + fabs(want.t)), "ray %d: t %.9g, want %.9g", k, h.t, want.t);
        hit_point(w, r, &h, x);
        for (a = 0; a < 3; a++) CHECK_NEAR(x[a], o[a] + h.t * d[a], 30 * tolerance * radius);
    }
    CHECK_MSG(unsure < n / 3 && (hits > n / 100 || w->count == 1), "%d unsure, %d hits of %d", unsure, hits, n);
}

/* ---- tests ---- */

TEST(one_mesh) {
    test_rng g = test_rng_make(1);
    int level, n;
    for (level = 1; level <= 3; level += 2) {
        for (n = 0; n < 6; n++) {
            rays_world w;
            rays_shape s;
            zbufrandi_rays r;
            zbufrand_transform t = identity();
            world_open(&w);
            if (n % 2 == 0) shape_soup(&s, &g, n == 0 ? 1 : 30 * (uint32_t)n * (uint32_t)n, n == 0 ? 1.0 : 0.2);
            else rays_shape_sphere(&s, &g, 6 * (uint32_t)n, 4 * (uint32_t)n, 1.0, 0.2);
            s.two_sided = (uint32_t)(n >> 1 & 1);
            (void)world_mesh(&w, ZBUFRAND_ROOT, NULL, 0, &s);
            world_place(&w, &s, ZBUFRANDI_M34(t.m));
            CHECK_EQ_U64(zbufrand_scene_build(w.scene, NULL, NULL), ZBUFRAND_OK);
            rays_open(&w, &r, level);
            check_rays(&w, &r, &g, test_quick() ? 100 : 600, n == 0 ? 1.2 : 2.0, 2e-6);
            rays_close(&w, &r);
            world_close(&w);
            rays_shape_free(&s);
        }
    }
}

/* Two levels of instances, mirrored, scaled from 0.001 to 1000, beside meshes of the root; compared with the flat list. */
static void build_forest(rays_world *w, test_rng *g, rays_shape s[3], int n) {
    zbufrand_node tree, leaf, grove, mesh;
    zbufrand_transform to_grove[4], to_world[4];
    double both[3][4];
    double size = n % 3 == 0 ? 1e-3 : n % 3 == 1 ? 1.0 : 1e3;
    int i, j;
    world_open(w);
    shape_soup(&s[0], g, 40, 0.3);
    rays_shape_sphere(&s[1], g, 8, 6, 1.0, 0.3);
    rays_shape_sphere(&s[2], g, 16, 12, 1.5, 0.1);
    s[0].two_sided = 1;
    CHECK_EQ_U64(zbufrand_add_list(w->scene, ZBUFRAND_ROOT, NULL, ZBUFRAND_HIDDEN, &tree), ZBUFRAND_OK);
    (void)world_mesh(w, tree, NULL, 0, &s[0]);
    leaf = world_mesh(w, ZBUFRAND_ROOT, NULL, ZBUFRAND_HIDDEN, &s[1]);
    CHECK_EQ_U64(zbufrand_add_list(w->scene, ZBUFRAND_ROOT, NULL, ZBUFRAND_HIDDEN, &grove), ZBUFRAND_OK);
    for (i = 0; i < 4; i++) {
        random_similarity(g, size * (0.2 + test_rng_double(g)), size * 2, i & 1, &to_grove[i]);
        CHECK_EQ_U64(zbufrand_add_reference(w->scene, grove, &to_grove[i], i < 2 ? tree : leaf, NULL), ZBUFRAND_OK);
    }
    for (j = 0; j < 4; j++) {
        random_similarity(g, (0.5 + 0.5 * test_rng_double(g)) / size, 3, j >> 1, &to_world[j]);
        CHECK_EQ_U64(zbufrand_add_reference(w->scene, ZBUFRAND_ROOT, &to_world[j], grove, NULL), ZBUFRAND_OK);
        if (n > 2) CHECK_EQ_U64(zbufrand_add_reference(w->scene, ZBUFRAND_ROOT, &to_world[j], grove, NULL), ZBUFRAND_OK);
        for (i = 0; i < 4; i++) { /* the same again at the same place: ties everywhere */
            compose(to_world[j].m, to_grove[i].m, both);
            world_place(w, &s[i < 2 ? 0 : 1], ZBUFRANDI_M34(both));
        }
    }
    mesh = world_mesh(w, ZBUFRAND_ROOT, &to_world[0], 0, &s[2]);
    (void)mesh;
    if (n % 3 != 1) return;
    world_place(w, &s[2], ZBUFRANDI_M34(to_world[0].m));
}

TEST(instances) {
    test_rng g = test_rng_make(2);
    int level, n, i;
    for (level = 1; level <= 3; level += 2) {
        for (n = 0; n < 6; n++) {
            rays_world w;
            rays_shape s[3];
            zbufrandi_rays r;
            build_forest(&w, &g, s, n);
            if (n % 3 != 1) world_place(&w, &s[2], ZBUFRANDI_M34(w.scene->graph[w.scene->graph_count - 1].m));
            CHECK_EQ_U64(zbufrand_scene_build(w.scene, NULL, NULL), ZBUFRAND_OK);
            CHECK_EQ_U64(w.scene->structure_count, 4);
            rays_open(&w, &r, level);
            check_rays(&w, &r, &g, test_quick() ? 60 : 400, n % 3 == 2 ? 5.0 : 5.0, 3e-6);
            rays_close(&w, &r);
            world_close(&w);
            for (i = 0; i < 3; i++) rays_shape_free(&s[i]);
        }
    }
}

/* From inside a closed surface every ray hits it, also those aimed at vertices and at points of edges, and along axes. */
TEST(no_gaps) {
    test_rng g = test_rng_make(3);
    int level, n;
    for (level = 1; level <= 3; level += 2) {
        for (n = 0; n < 8; n++) {
            rays_world w;
            rays_shape s;
            zbufrandi_rays r;
            zbufrand_transform t;
            zbufrand_node proto;
            uint32_t i, k, a, missed = 0, wrong = 0, many = test_quick() ? 1500 : 12000;
            world_open(&w);
            rays_shape_sphere(&s, &g, 40, 30, 1.0, n & 1 ? 0.05 : 0.0);
            s.two_sided = 1;
            random_similarity(&g, n & 2 ? 1000.0 : 1.0, n & 4 ? 1e5 : 0.0, n & 1, &t);
            proto = world_mesh(&w, ZBUFRAND_ROOT, NULL, ZBUFRAND_HIDDEN, &s);
            CHECK_EQ_U64(zbufrand_add_reference(w.scene, ZBUFRAND_ROOT, &t, proto, NULL), ZBUFRAND_OK);
            CHECK_EQ_U64(zbufrand_scene_build(w.scene, NULL, NULL), ZBUFRAND_OK);
            rays_open(&w, &r, level);
            for (i = 0; i < many; i++) {
                double o[3], d[3], p[3], q[3], weight[3];
                const uint32_t *v = &s.index[3 * test_rng_below(&g, s.triangles)];
                zbufrandi_ray_hit h;
                weight[0] = test_rng_double(&g);
                weight[1] = i % 3 == 0 ? 0 : 1 - weight[0];
                weight[2] = 0;
                if (i % 3 == 0) weight[0] = 1;
                if (i % 3 == 2) { weight[1] *= 0.5; weight[2] = weight[1]; }
                for (a = 0; a < 3; a++) {
                    q[a] = 0.3 * (2 * test_rng_double(&g) - 1);
                    if (i % 4 == 0) q[a] = 0;
                    for (p[a] = 0, k = 0; k < 3; k++) p[a] += weight[k] * (double)s.p[3 * v[k] + a];
                }
                if (i % 16 == 4) { q[0] = p[0]; q[1] = p[1]; }             /* along z */
                if (i % 16 == 8) { q[1] = p[1]; }
                for (a = 0; a < 3; a++) {
                    o[a] = t.m[a][0] * q[0] + t.m[a][1] * q[1] + t.m[a][2] * q[2] + t.m[a][3];
                    d[a] = t.m[a][0] * p[0] + t.m[a][1] * p[1] + t.m[a][2] * p[2] + t.m[a][3] - o[a];
                }
                if (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] > 0.5) continue;
                if (!cast(&w, &r, o, d, 0, (double)INFINITY, &h)) missed++;
                else if (fabs(h.t - 1) > (n & 1 ? 0.6 : 1e-4)) wrong++;
            }
            CHECK_MSG(missed == 0, "case %d: %u of %u rays missed", n, missed, many);
            CHECK_MSG(wrong == 0, "case %d: %u of %u rays hit elsewhere", n, wrong, many);
            rays_close(&w, &r);
            world_close(&w);
            rays_shape_free(&s);
        }
    }
}

/* A grid of squares in a plane, rays through its corners and along its lines, axis-parallel, with zeros of both signs. */
TEST(along_axes) {
    int level, axis, sign, i, j;
    for (level = 1; level <= 3; level += 2) {
        for (axis = 0; axis < 3; axis++) {
            rays_world w;
            rays_shape s;
            zbufrandi_rays r;
            uint32_t n = 0, t = 0, k;
            world_open(&w);
            shape_alloc(&s, 21 * 21, 800);
            for (j = 0; j <= 20; j++) {
                for (i = 0; i <= 20; i++) {
                    s.p[3 * n + (uint32_t)axis] = 0.5f;
                    s.p[3 * n + (uint32_t)(axis + 1) % 3] = (float)i;
                    s.p[3 * n++ + (uint32_t)(axis + 2) % 3] = (float)j;
                }
            }
            for (j = 0; j < 20; j++) {
                for (i = 0; i < 20; i++) {
                    uint32_t a = (uint32_t)(21 * j + i), six[6];
                    six[0] = a; six[1] = a + 1; six[2] = a + 22; six[3] = a; six[4] = a + 22; six[5] = a + 21;
                    for (k = 0; k < 6; k++) s.index[t++] = six[k];
                }
            }
            s.two_sided = 1;
            (void)world_mesh(&w, ZBUFRAND_ROOT, NULL, 0, &s);
            CHECK_EQ_U64(zbufrand_scene_build(w.scene, NULL, NULL), ZBUFRAND_OK);
            rays_open(&w, &r, level);
            for (sign = 0; sign < 2; sign++) {
                for (j = 0; j <= 40; j++) {
                    for (i = 0; i <= 40; i++) {
                        double o[3], d[3];
                        zbufrandi_ray_hit h;
                        o[axis] = sign ? 3.0 : -2.0;
                        d[axis] = sign ? -2.0 : 2.0;
                        o[(axis + 1) % 3] = 0.5 * i;
                        o[(axis + 2) % 3] = 0.5 * j;
                        d[(axis + 1) % 3] = i & 1 ? 0.0 : -0.0;
                        d[(axis + 2) % 3] = j & 1 ? 0.0 : -0.0;
                        CHECK(cast(&w, &r, o, d, 0, (double)INFINITY, &h));
                        CHECK_NEAR(h.t, 1.25, 1e-6);
                        CHECK_EQ_U64(h.back, sign ? 0 : 1); /* u x v = the axis */
                        o[(axis + 1) % 3] += 20.5;
                        if (i > 0) CHECK(!cast(&w, &r, o, d, 0, (double)INFINITY, &h));
                    }
                }
            }
            rays_close(&w, &r);
            world_close(&w);
            rays_shape_free(&s);
        }
    }
}

/* A camera at up to a billion times the size of the object; and an object far away from zero. */
TEST(far_away) {
    static const double dist[] = {10, 1e3, 1e6, 1e9};
    test_rng g = test_rng_make(4);
    int level, n, k, a;
    for (level = 1; level <= 3; level += 2) {
        for (n = 0; n < 8; n++) {
            rays_world w;
            rays_shape s;
            zbufrandi_rays r;
            zbufrand_transform t = identity();
            zbufrand_node proto;
            int missed = 0, many = test_quick() ? 300 : 2000;
            world_open(&w);
            rays_shape_sphere(&s, &g, 64, 48, 1.0, 0.0);
            for (a = 0; a < 3; a++) t.m[a][3] = n & 4 ? 1e6 * (a + 1) : 0;
            proto = world_mesh(&w, ZBUFRAND_ROOT, n & 4 ? NULL : &t, n & 4 ? ZBUFRAND_HIDDEN : 0, &s);
            if (n & 4) CHECK_EQ_U64(zbufrand_add_reference(w.scene, ZBUFRAND_ROOT, &t, proto, NULL), ZBUFRAND_OK);
            CHECK_EQ_U64(zbufrand_scene_build(w.scene, NULL, NULL), ZBUFRAND_OK);
            rays_open(&w, &r, level);
            for (k = 0; k < many; k++) {
                double o[3], d[3], p[3], x[3], l = 0, away = dist[n & 3], err = 0;
                zbufrandi_ray_hit h;
                for (a = 0; a < 3; a++) { p[a] = test_rng_double(&g) - 0.5; l += p[a] * p[a]; }
                for (a = 0; a < 3; a++) { o[a] = p[a] / sqrt(l) * away + t.m[a][3]; }
                for (a = 0; a < 3; a++) { d[a] = 0.5 * (2 * test_rng_double(&g) - 1) + t.m[a][3] - o[a]; d[a] /= away; }
                if (!cast(&w, &r, o, d, 0, (double)INFINITY, &h)) { missed++; continue; }
                for (l = 0, a = 0; a < 3; a++) { x[a] = o[a] + h.t * d[a] - t.m[a][3]; l += x[a] * x[a]; }
                err = fabs(sqrt(l) - 1);
                CHECK_MSG(err < 0.01 + 1e-6 * (away >= 1e9 ? 10 : 1), "distance %g: error %g", away, err);
                CHECK(h.back == 0);
                hit_point(&w, &r, &h, x);
                for (a = 0; a < 3; a++) CHECK_NEAR(x[a], o[a] + h.t * d[a], 3e-6 + away * 1e-15 + (n & 4 ? 1e-9 : 0));
            }
            CHECK_EQ_U64(missed, 0);
            rays_close(&w, &r);
            world_close(&w);
            rays_shape_free(&s);
        }
    }
}

/* A structure of 200 km with an eye that lies between the floats of its coordinates, a centimetre before a wall. */
TEST(large_structure) {
    int level, k, a;
    for (level = 1; level <= 3; level += 2) {
        rays_world w;
        rays_shape s;
        zbufrandi_rays r;
        test_rng g = test_rng_make(12);
        world_open(&w);
        shape_alloc(&s, 6, 2);
        for (k = 0; k < 2; k++) {
            float *p = s.p + 9 * k, x = k ? 1e5f : -1e5f;
            p[0] = p[3] = p[6] = x;
            p[1] = -1; p[2] = -1; p[4] = 1; p[5] = -1; p[7] = 0; p[8] = 2;
        }
        for (k = 0; k < 6; k++) s.index[k] = (uint32_t)k;
        s.two_sided = 1;
        (void)world_mesh(&w, ZBUFRAND_ROOT, NULL, 0, &s);
        CHECK_EQ_U64(zbufrand_scene_build(w.scene, NULL, NULL), ZBUFRAND_OK);
        rays_open(&w, &r, level);
        for (k = 0; k < 300; k++) {
            double o[3], d[3];
            zbufrandi_ray_hit h;
            const double side = k & 1 ? 1 : -1; /* one of the two is far from the origin of the structure */
            o[0] = side * (1e5 - 0.01 * (1 + test_rng_double(&g)));
            for (a = 1; a < 3; a++) o[a] = 0.2 * (test_rng_double(&g) - 0.5);
            d[0] = side;
            for (a = 1; a < 3; a++) d[a] = 0.5 * (test_rng_double(&g) - 0.5);
            CHECK(cast(&w, &r, o, d, 0, (double)INFINITY, &h));
            CHECK_NEAR(h.t, 1e5 - fabs(o[0]), 1e-8);
        }
        rays_close(&w, &r);
        world_close(&w);
        rays_shape_free(&s);
    }
}

TEST(many_levels) {
    test_rng g = test_rng_make(5);
    int level, n, k, a;
    for (level = 1; level <= 3; level += 2) {
        rays_world w;
        rays_shape s;
        zbufrandi_rays r;
        zbufrand_node inner;
        zbufrandi_ray_hit h;
        double total[3][4], o[3], d[3], x[3];
        zbufrand_transform id = identity();
        world_open(&w);
        rays_shape_sphere(&s, &g, 12, 9, 1.0, 0.0);
        inner = world_mesh(&w, ZBUFRAND_ROOT, NULL, ZBUFRAND_HIDDEN, &s);
        memcpy(total, id.m, sizeof total);
        for (n = 0; n < 63; n++) {
            zbufrand_transform t;
            zbufrand_node list;
            double next[3][4];
            random_similarity(&g, n & 1 ? 2.0 : 0.5, 0.3, n % 3 == 0, &t);
            CHECK_EQ_U64(zbufrand_add_list(w.scene, ZBUFRAND_ROOT, NULL, n == 62 ? 0 : ZBUFRAND_HIDDEN, &list), ZBUFRAND_OK);
            CHECK_EQ_U64(zbufrand_add_reference(w.scene, list, &t, inner, NULL), ZBUFRAND_OK);
            compose(t.m, total, next);
            memcpy(total, next, sizeof total);
            inner = list;
        }
        CHECK_EQ_U64(zbufrand_scene_build(w.scene, NULL, NULL), ZBUFRAND_OK);
        world_place(&w, &s, ZBUFRANDI_M34(total));
        rays_open(&w, &r, level);
        for (k = 0; k < 200; k++) {
            truth want;
            for (a = 0; a < 3; a++) { o[a] = total[a][3] + 8 * (test_rng_double(&g) - 0.5); d[a] = total[a][3] - o[a] + 0.5 * (test_rng_double(&g) - 0.5); }
            want = brute(&w, o, d, 0, (double)INFINITY);
            if (want.unsure) continue;
            CHECK_EQ_U64(cast(&w, &r, o, d, 0, (double)INFINITY, &h), want.t < (double)INFINITY);
            if (!(want.t < (double)INFINITY)) continue;
            CHECK_NEAR(h.t, want.t, 1e-5);
            CHECK_EQ_U64(h.levels, 63);
            hit_point(&w, &r, &h, x);
            for (a = 0; a < 3; a++) CHECK_NEAR(x[a], o[a] + h.t * d[a], 1e-4);
        }
        rays_close(&w, &r);
        world_close(&w);
        rays_shape_free(&s);
    }
}

typedef struct deep {
    zbufrandi_rays r;
    zbufrandi_ray ray[8];
    zbufrandi_ray_hit hit[8];
} deep;

static void *cast_deep(void *arg) {
    deep *k = (deep *)arg;
    CHECK_EQ_U64(zbufrandi_ray_cast_many(&k->r, k->ray, 8, k->hit, NULL, NULL), 8);
    return NULL;
}

/* Rays that stay together through all levels of instances get what they get alone, with little stack. */
TEST(deep_packets) {
    enum { STACK = 1 << 21 };
    test_rng g = test_rng_make(15);
    rays_world w;
    rays_shape s;
    zbufrand_node inner;
    uint32_t n, a;
    static deep k;
    world_open(&w);
    rays_shape_sphere(&s, &g, 12, 9, 1.0, 0.0);
    inner = world_mesh(&w, ZBUFRAND_ROOT, NULL, ZBUFRAND_HIDDEN, &s);
    for (n = 0; n < 64; n++) {
        zbufrand_node list;
        CHECK_EQ_U64(zbufrand_add_list(w.scene, ZBUFRAND_ROOT, NULL, n == 63 ? 0 : ZBUFRAND_HIDDEN, &list), ZBUFRAND_OK);
        CHECK_EQ_U64(zbufrand_add_reference(w.scene, list, NULL, inner, NULL), ZBUFRAND_OK);
        inner = list;
    }
    CHECK_EQ_U64(zbufrand_scene_build(w.scene, NULL, NULL), ZBUFRAND_OK);
    rays_open(&w, &k.r, 0);
    for (n = 0; n < 8; n++) {
        for (a = 0; a < 3; a++) {
            k.ray[n].o[a] = 0.1 * a + 0.01 * n - w.scene->structure[0].origin[a] + (a == 2 ? 5 : 0);
            k.ray[n].d[a] = a == 2 ? -1 : 0.001 * a;
        }
        k.ray[n].t_min = 0;
        k.ray[n].t_max = (double)INFINITY;
    }
#if defined(__linux__) && !defined(ZBUFRAND_NO_THREADS)
    {
        pthread_t thread;
        pthread_attr_t attr;
        void *stack = NULL;
        size_t free_bytes = 0;
        if (posix_memalign(&stack, 65536, STACK) != 0 || pthread_attr_init(&attr) != 0) abort();
        memset(stack, 0xa5, STACK);
        if (pthread_attr_setstack(&attr, stack, STACK) != 0 || pthread_create(&thread, &attr, cast_deep, &k) != 0) abort();
        (void)pthread_join(thread, NULL);
        (void)pthread_attr_destroy(&attr);
        while (free_bytes < STACK && ((const uint8_t *)stack)[free_bytes] == 0xa5) free_bytes++;
        CHECK_MSG(TEST_SANITIZED || STACK - free_bytes < 200 * 1024, "%lu KB of stack", (unsigned long)(STACK - free_bytes) >> 10);
        free(stack);
    }
#else
    (void)cast_deep(&k);
#endif
    for (n = 0; n < 8; n++) {
        zbufrandi_ray_hit one;
        CHECK(zbufrandi_ray_cast(&k.r, &k.ray[n], &one, NULL, 0));
        CHECK_EQ_U64(one.levels, 64);
        CHECK(same_hit(&one, &k.hit[n]));
    }
    rays_close(&w, &k.r);
    world_close(&w);
    rays_shape_free(&s);
}

/* Scalar and AVX2 give the same bits, whatever the ray. */
TEST(same_bits) {
    test_rng g = test_rng_make(6);
    int n, k, a, i, many = test_quick() ? 500 : 6000;
    for (n = 0; n < 3; n++) {
        rays_world w;
        rays_shape s[3];
        zbufrandi_rays r1, r3;
        uint64_t hits = 0;
        build_forest(&w, &g, s, n);
        CHECK_EQ_U64(zbufrand_scene_build(w.scene, NULL, NULL), ZBUFRAND_OK);
        rays_open(&w, &r1, 1);
        rays_open(&w, &r3, 0);
        for (k = 0; k < many; k++) {
            double o[3], d[3];
            zbufrandi_ray_hit h1, h3;
            int got1, got3;
            for (a = 0; a < 3; a++) {
                o[a] = 6 * (test_rng_double(&g) - 0.5);
                d[a] = 3 * (test_rng_double(&g) - 0.5) - o[a];
                if (k % 11 == 0 && a == k % 3) d[a] = 0;
                if (k % 29 == 0) d[a] = (double)test_rng_bits(&g);
                if (k % 31 == 0) o[a] = (double)test_rng_bits(&g);
            }
            memset(&h1, 0, sizeof h1);
            memset(&h3, 0, sizeof h3);
            got1 = cast(&w, &r1, o, d, 0, (double)INFINITY, &h1);
            got3 = cast(&w, &r3, o, d, 0, (double)INFINITY, &h3);
            CHECK_EQ_U64(got1, got3);
            CHECK(same_hit(&h1, &h3));
            if (got1) CHECK(h1.t >= 0 && h1.t < (double)INFINITY && h1.u >= 0 && h1.v >= 0 && h1.u + h1.v <= 1.00001f);
            hits += (uint64_t)got1;
        }
        CHECK(hits > (uint64_t)many / 100);
        rays_close(&w, &r1);
        rays_close(&w, &r3);
        world_close(&w);
        for (i = 0; i < 3; i++) rays_shape_free(&s[i]);
    }
}

/* Many rays at once get the hits that they get alone: coherent or not, any count, some of them bad. */
TEST(many_at_once) {
    test_rng g = test_rng_make(10);
    int n, k, a, i, rounds = test_quick() ? 30 : 300;
    for (n = 0; n < 6; n++) {
        rays_world w;
        rays_shape s[3];
        zbufrandi_rays r;
        uint64_t hits = 0, wrong = 0;
        build_forest(&w, &g, s, n);
        CHECK_EQ_U64(zbufrand_scene_build(w.scene, NULL, NULL), ZBUFRAND_OK);
        rays_open(&w, &r, n == 5 ? 1 : 0);
        for (k = 0; k < rounds; k++) {
            zbufrandi_ray ray[70];
            zbufrandi_ray_hit one[70], many[70];
            size_t count = test_rng_below(&g, 71), j, want = 0, got;
            double spread = k % 3 == 0 ? 2.0 : k % 3 == 1 ? 0.1 : 0.003, eye[3], at[3];
            const placed *aim = &w.list[test_rng_below(&g, w.count)];
            for (a = 0; a < 3; a++) { eye[a] = 8 * (test_rng_double(&g) - 0.5); at[a] = aim->m[a][3]; }
            for (j = 0; j < count; j++) {
                for (a = 0; a < 3; a++) {
                    ray[j].o[a] = eye[a] - w.scene->structure[0].origin[a] + (k % 5 == 0 ? spread * test_rng_double(&g) : 0);
                    ray[j].d[a] = at[a] - eye[a] + spread * (test_rng_double(&g) - 0.5);
                    if (k % 7 == 0 && test_rng_below(&g, 9) == 0) ray[j].d[a] = test_rng_below(&g, 2) ? 0 : -0.0;
                    if (k % 11 == 0 && test_rng_below(&g, 30) == 0) ray[j].o[a] = (double)NAN;
                }
                ray[j].t_min = k % 4 == 0 ? test_rng_double(&g) : 0;
                ray[j].t_max = k % 4 == 1 ? 1.5 * test_rng_double(&g) : (double)INFINITY;
            }
            memset(one, 0, sizeof one);
            memset(many, 0, sizeof many);
            for (j = 0; j < count; j++) want += (size_t)zbufrandi_ray_cast(&r, &ray[j], &one[j], NULL, 0);
            got = zbufrandi_ray_cast_many(&r, ray, count, many, NULL, NULL);
            CHECK_EQ_U64(got, want);
            for (j = 0; j < count; j++) wrong += !same_hit(&one[j], &many[j]);
            hits += want;
        }
        CHECK_EQ_U64(wrong, 0);
        CHECK(hits > (uint64_t)rounds);
        rays_close(&w, &r);
        world_close(&w);
        for (i = 0; i < 3; i++) rays_shape_free(&s[i]);
    }
}

TEST(odd_rays) {
    test_rng g = test_rng_make(7);
    int level, k;
    for (level = 1; level <= 3; level += 2) {
        static const double bad[] = {(double)NAN, (double)INFINITY, -(double)INFINITY, 1e300};
        rays_world w;
        rays_shape s;
        zbufrandi_rays r;
        zbufrandi_ray_hit h;
        double o[3] = {0, 0, -3}, d[3] = {0, 0, 1};
        world_open(&w);
        rays_open(&w, &r, level); /* nothing was built */
        { zbufrandi_ray ray; memset(&ray, 0, sizeof ray); ray.d[2] = 1; ray.t_max = 9; CHECK(!zbufrandi_ray_cast(&r, &ray, &h, NULL, 0)); }
        rays_close(&w, &r);
        CHECK_EQ_U64(zbufrand_scene_build(w.scene, NULL, NULL), ZBUFRAND_OK); /* an empty scene */
        rays_open(&w, &r, level);
        if (w.scene->structure_count != 0) CHECK(!cast(&w, &r, o, d, 0, (double)INFINITY, &h));
        rays_close(&w, &r);
        rays_shape_sphere(&s, &g, 20, 15, 1.0, 0.0);
        (void)world_mesh(&w, ZBUFRAND_ROOT, NULL, 0, &s);
        CHECK_EQ_U64(zbufrand_scene_build(w.scene, NULL, NULL), ZBUFRAND_OK);
        rays_open(&w, &r, level);
        CHECK(cast(&w, &r, o, d, 0, (double)INFINITY, &h));
        CHECK_NEAR(h.t, 2, 0.05);
        CHECK(!cast(&w, &r, o, d, 0, 1.5, &h));
        CHECK(h.t == (double)INFINITY);
        CHECK(!cast(&w, &r, o, d, 2.5, 100, &h)); /* the back of the sphere is not seen from inside */
        CHECK(!cast(&w, &r, o, d, 5, 4, &h));
        CHECK(!cast(&w, &r, o, d, (double)NAN, (double)NAN, &h));
        CHECK(cast(&w, &r, o, d, -5, 4, &h));
        CHECK_NEAR(h.t, 2, 0.05);
        for (k = 0; k < 24; k++) {
            double p[3], q[3];
            memcpy(p, o, sizeof p);
            memcpy(q, d, sizeof q);
            if (k & 1) p[k / 2 % 3] = bad[k / 6];
            else q[k / 2 % 3] = bad[k / 6];
            CHECK(!cast(&w, &r, p, q, 0, (double)INFINITY, &h));
        }
        d[2] = 0;
        CHECK(!cast(&w, &r, o, d, 0, (double)INFINITY, &h));
        d[2] = -1;
        CHECK(!cast(&w, &r, o, d, 0, (double)INFINITY, &h));
        rays_close(&w, &r);
        world_close(&w);
        rays_shape_free(&s);
    }
}

TEST(no_memory) {
    test_rng g = test_rng_make(8);
    rays_shape s;
    rays_world w;
    int n;
    world_open(&w);
    rays_shape_sphere(&s, &g, 20, 15, 1.0, 0.0);
    (void)world_mesh(&w, ZBUFRAND_ROOT, NULL, 0, &s);
    CHECK_EQ_U64(zbufrand_scene_build(w.scene, NULL, NULL), ZBUFRAND_OK);
    for (n = 0; n < 3; n++) {
        test_alloc ta;
        zbufrandi_mem mem;
        zbufrandi_rays r;
        memset(&mem, 0, sizeof mem);
        test_alloc_init(&ta);
        ta.fail_at = n;
        mem.allocator.alloc_fn = test_alloc_fn;
        mem.allocator.free_fn = test_free_fn;
        mem.allocator.user = &ta;
        CHECK_EQ_U64(zbufrandi_rays_begin(&r, &mem, &w.scene->env, w.scene->structure, w.scene->structure_count, 0), n == 2);
        zbufrandi_rays_end(&r, &mem);
        test_alloc_check(&ta);
    }
    world_close(&w);
    rays_shape_free(&s);
}

/* The rasteriser and a ray through the centre of each pixel see the same triangles, but for pixels whose centre lies
   within a rounding of an edge. */
TEST(same_as_raster) {
    test_rng g = test_rng_make(9);
    rays_world w;
    rays_shape s;
    zbufrandi_rays r;
    zbufrandi_camera camera;
    zbufrandi_keys keys;
    zbufrandi_local local;
    zbufrandi_raster ra;
    const zbufrandi_structure *st;
    uint32_t i, j, k, c, differ = 0, seen = 0;
    double worst = 0;
    world_open(&w);
    rays_shape_sphere(&s, &g, 120, 90, 1.0, 0.02);
    (void)world_mesh(&w, ZBUFRAND_ROOT, NULL, 0, &s);
    CHECK_EQ_U64(zbufrand_scene_build(w.scene, NULL, NULL), ZBUFRAND_OK);
    rays_open(&w, &r, 0);
    st = &w.scene->structure[0];
    memset(&camera, 0, sizeof camera);
    memset(&local, 0, sizeof local);
    camera.width = keys.width = 160; camera.height = keys.height = 120;
    camera.center_x = 80; camera.center_y = 60; camera.focal = 150; camera.near_z = 0.01; camera.far_z = (double)INFINITY;
    keys.key = (uint64_t *)malloc(160 * 120 * 8);
    REQUIRE(keys.key != NULL);
    memset(keys.key, 0xff, 160 * 120 * 8);
    for (k = 0; k < 3; k++) local.m[k][k] = k == 0 ? -1.0f : 1.0f; /* eye at z = -2.5, looking along z; -x is right, y up */
    local.eye[0] = (float)(0 - st->origin[0]); local.eye[1] = (float)(0 - st->origin[1]); local.eye[2] = (float)(-2.5 - st->origin[2]);
    local.scale = 1;
    zbufrandi_raster_begin(&ra, &camera, &keys, 1, 0);
    zbufrandi_raster_local(&ra, &local);
    for (c = 0; c < st->cluster_count; c++) {
        zbufrandi_raster_cluster(&ra, st->position + 3 * (size_t)st->cluster[c].first_vertex, st->cluster[c].vertex_count,
                                 st->triangle + 3 * (size_t)st->cluster[c].first_triangle, st->cluster[c].triangle_count, 0, st->cluster[c].first_triangle);
    }
    for (j = 0; j < 120; j++) {
        for (i = 0; i < 160; i++) {
            double o[3] = {0, 0, -2.5}, d[3];
            uint64_t key = keys.key[160 * j + i];
            zbufrandi_ray_hit h;
            int got;
            d[0] = -(i + 0.5 - 80) / 150; d[1] = (60 - (j + 0.5)) / 150; d[2] = 1;
            got = cast(&w, &r, o, d, 0.01, (double)INFINITY, &h);
            seen += got != 0;
            if (got != (key != ZBUFRANDI_EMPTY)) differ++;
            else if (got) {
                if (zbufrandi_key_number(key) != h.triangle) differ++;
                else if (fabs((double)zbufrandi_key_depth(key) / h.t - 1) > worst) worst = fabs((double)zbufrandi_key_depth(key) / h.t - 1);
            }
        }
    }
    CHECK(seen > 8000);
    CHECK_MSG(differ < 40, "%u of %u pixels", differ, seen);
    CHECK_MSG(worst < 1e-3, "%g", worst); /* at the silhouette the slope is large */
    free(keys.key);
    rays_close(&w, &r);
    world_close(&w);
    rays_shape_free(&s);
}

/* The ray through the centre of pixel (x, y); t is the depth. */
static void ray_pixel(const zbufrandi_rays *r, const zbufrandi_camera *c, uint32_t x, uint32_t y, zbufrandi_ray *ray) {
    const double u = ((double)x + 0.5 - c->center_x) / c->focal, v = (c->center_y - (double)y - 0.5) / c->focal;
    uint32_t a;
    for (a = 0; a < 3; a++) {
        ray->o[a] = c->eye[a] - (r->structure_count != 0 ? r->structure[0].origin[a] : 0.0);
        ray->d[a] = c->dir[a] + u * c->right[a] + v * c->up[a];
    }
    ray->t_min = c->near_z;
    ray->t_max = c->far_z;
}

/* All of a scene through the rasteriser: the depth that rays find, the same bits for any number of threads; more
   instances and clusters than are kept at once. */
TEST(zbuffer) {
    test_rng g = test_rng_make(11);
    rays_world w;
    rays_shape s[2];
    zbufrandi_rays r;
    zbufrandi_camera camera;
    zbufrandi_keys keys;
    zbufrand_node proto, big;
    zbufrand_scene_info info;
    uint64_t triangles, covered, hash[3];
    uint32_t i, j, k, differ = 0, seen = 0, n = test_quick() ? 700 : 1500;
    int inside;
    world_open(&w);
    rays_shape_sphere(&s[0], &g, 8, 6, 0.2, 0.3);
    rays_shape_sphere(&s[1], &g, 40, 30, 0.6, 0.1);
    proto = world_mesh(&w, ZBUFRAND_ROOT, NULL, ZBUFRAND_HIDDEN, &s[0]);
    big = world_mesh(&w, ZBUFRAND_ROOT, NULL, ZBUFRAND_HIDDEN, &s[1]);
    for (i = 0; i < n; i++) {
        zbufrand_transform t;
        random_similarity(&g, 0.3 + test_rng_double(&g), 3, (int)i & 1, &t);
        t.m[2][3] += 5;
        CHECK_EQ_U64(zbufrand_add_reference(w.scene, ZBUFRAND_ROOT, &t, i % 16 == 0 ? big : proto, NULL), ZBUFRAND_OK);
    }
    CHECK_EQ_U64(zbufrand_scene_build(w.scene, NULL, &info), ZBUFRAND_OK);
    rays_open(&w, &r, 0);
    memset(&camera, 0, sizeof camera);
    camera.width = keys.width = 160; camera.height = keys.height = 120;
    camera.center_x = 80; camera.center_y = 60; camera.near_z = 0.05; camera.far_z = (double)INFINITY;
    camera.right[0] = -1; camera.up[1] = 1; camera.dir[2] = 1;
    keys.key = (uint64_t *)malloc(160 * 120 * 8);
    REQUIRE(keys.key != NULL);
    for (inside = 0; inside < 2; inside++) {
        camera.eye[2] = inside ? 5 : -2;
        camera.focal = inside ? 60 : 50;
        for (k = 0; k < 3; k++) {
            zbufrand_env env;
            memset(&env, 0, sizeof env);
            env.thread_count = k == 0 ? 1 : 4;
            memset(keys.key, 0xff, 160 * 120 * 8);
            CHECK_EQ_U64(baseline_zbuffer_draw(w.scene, &camera, &keys, &env, &w.scene->mem, k == 2 ? 1 : 0, &triangles, &covered), ZBUFRAND_OK);
            hash[k] = test_fnv1a(keys.key, 160 * 120 * 8, covered);
            if (!inside) CHECK_EQ_U64(triangles, info.triangles);
            else CHECK(triangles < info.triangles && triangles > 0);
        }
        CHECK(hash[0] == hash[1] && hash[0] == hash[2]);
        for (j = 0; j < 120; j++) {
            for (i = 0; i < 160; i++) {
                const uint64_t key = keys.key[160 * j + i];
                zbufrandi_ray ray;
                zbufrandi_ray_hit h;
                ray_pixel(&r, &camera, i, j, &ray);
                if (zbufrandi_ray_cast(&r, &ray, &h, NULL, 0) != (key != ZBUFRANDI_EMPTY)) differ++;
                else if (key != ZBUFRANDI_EMPTY) {
                    seen++;
                    if (fabs((double)zbufrandi_key_depth(key) / h.t - 1) > 1e-3) differ++;
                }
            }
        }
    }
    CHECK(seen > 10000);
    CHECK_MSG(differ < 60, "%u of %u pixels", differ, seen);
    free(keys.key);
    rays_close(&w, &r);
    world_close(&w);
    rays_shape_free(&s[0]);
    rays_shape_free(&s[1]);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(one_mesh);
    RUN(instances);
    RUN(no_gaps);
    RUN(along_axes);
    RUN(far_away);
    RUN(large_structure);
    RUN(many_levels);
    RUN(deep_packets);
    RUN(same_bits);
    RUN(many_at_once);
    RUN(odd_rays);
    RUN(no_memory);
    RUN(same_as_raster);
    RUN(zbuffer);
    return test_end();
}
