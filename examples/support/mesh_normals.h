/* mesh_normals.h - smooth vertex normals that keep creases; included by mesh.h
   SPDX-License-Identifier: MIT OR Unlicense */
#ifndef SUP_MESH_NORMALS_H
#define SUP_MESH_NORMALS_H

#ifndef SUP_MESH_H
#error "include mesh.h instead"
#endif

#define SUPI_CREASE_COSINE 0.5 /* an edge whose triangles turn by more than 60 degrees stays sharp */

typedef struct supi_smooth {
    const sup_mesh *mesh;
    double crease;           /* below -1: no edge is sharp, and all corners in one place share one normal */
    uint32_t *place;         /* [vertices] first vertex with the same position */
    uint32_t *start, *order; /* corners of place p: order[start[p]] .. order[start[p + 1] - 1], ascending */
    float *face;             /* [3 * triangles] unit normals, 0: none */
    float *normals;          /* [3 * vertices] */
    uint8_t *used;           /* [vertices] has its normal */
    uint32_t *extra;         /* vertices to append: which one each is a copy of */
    float *extra_normals;
    uint64_t *moves;         /* corner << 32 | number of the extra vertex it moves to */
    size_t extra_count, extra_capacity, extra_normal_capacity, move_count, move_capacity;
    uint64_t *key;           /* scratch for one place with k corners: [2 k] */
    uint32_t *group;         /* [k] union-find over its corners */
    double *sum;             /* [3 k] by group */
    size_t key_capacity, group_capacity, sum_capacity;
} supi_smooth;

SUP_FN void supi_smooth_free(supi_smooth *s) {
    SUP_FREE(s->place);
    SUP_FREE(s->start);
    SUP_FREE(s->order);
    SUP_FREE(s->face);
    SUP_FREE(s->normals);
    SUP_FREE(s->used);
    SUP_FREE(s->extra);
    SUP_FREE(s->extra_normals);
    SUP_FREE(s->moves);
    SUP_FREE(s->key);
    SUP_FREE(s->group);
    SUP_FREE(s->sum);
}

/* Unit normal of a triangle; 0, and a zero normal, when it has no area or coordinates that are not finite. */
SUP_FN int supi_face_normal(const sup_mesh *mesh, size_t t, float face[3]) {
    const uint32_t *corner = mesh->indices + 3 * t;
    double p[3][3], e[2][3], n[3], l0, l1, area;
    size_t k, j;
    face[0] = face[1] = face[2] = 0.0f;
    for (k = 0; k < 3; k++) {
        for (j = 0; j < 3; j++) p[k][j] = (double)mesh->positions[3 * (size_t)corner[k] + j];
    }
    for (j = 0; j < 3; j++) {
        e[0][j] = p[1][j] - p[0][j];
        e[1][j] = p[2][j] - p[1][j];
    }
    l0 = sqrt(e[0][0] * e[0][0] + e[0][1] * e[0][1] + e[0][2] * e[0][2]);
    l1 = sqrt(e[1][0] * e[1][0] + e[1][1] * e[1][1] + e[1][2] * e[1][2]);
    for (j = 0; j < 3; j++) {
        const size_t u = (j + 1) % 3, v = (j + 2) % 3;
        n[j] = e[0][u] * e[1][v] - e[0][v] * e[1][u];
    }
    area = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    /* Edges that nearly cancel leave a normal of rounding only; 1e-12 is far below what float corners can mean. */
    if (!(area > 1e-12 * l0 * l1) || !(area <= DBL_MAX)) return 0;
    for (j = 0; j < 3; j++) face[j] = (float)(n[j] / area);
    return 1;
}

/* Angle of a triangle with an area at one of its corners. */
SUP_FN double supi_corner_angle(const sup_mesh *mesh, size_t corner) {
    const size_t t = corner / 3 * 3, k = corner % 3;
    const float *at = mesh->positions + 3 * (size_t)mesh->indices[corner];
    const float *next = mesh->positions + 3 * (size_t)mesh->indices[t + (k + 1) % 3];
    const float *last = mesh->positions + 3 * (size_t)mesh->indices[t + (k + 2) % 3];
    double dot = 0.0, a = 0.0, b = 0.0;
    size_t j;
    for (j = 0; j < 3; j++) {
        const double u = (double)next[j] - (double)at[j], v = (double)last[j] - (double)at[j];
        dot += u * v;
        a += u * u;
        b += v * v;
    }
    dot /= sqrt(a) * sqrt(b);
    return acos(dot > 1.0 ? 1.0 : dot < -1.0 ? -1.0 : dot);
}

SUP_FN int supi_compare_keys(const void *a, const void *b) {
    const uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return (x > y) - (x < y);
}

SUP_FN void supi_sort_keys(uint64_t *key, size_t n) {
    size_t i, k;
    if (n > 48) {
        qsort(key, n, sizeof *key, supi_compare_keys);
        return;
    }
    for (i = 1; i < n; i++) {
        const uint64_t x = key[i];
        for (k = i; k > 0 && key[k - 1] > x; k--) key[k] = key[k - 1];
        key[k] = x;
    }
}

/* Corners by place: vertices with equal coordinates are one place, whatever their index. */
SUP_FN int supi_smooth_places(supi_smooth *s) {
    const sup_mesh *mesh = s->mesh;
    const size_t corners = 3 * mesh->triangle_count, n = mesh->vertex_count;
    size_t slots = 1024, i, slot;
    uint32_t *table, total = 0;
    while (slots < 2 * n) slots *= 2;
    table = (uint32_t *)sup_alloc(slots, sizeof *table);
    if (!table) return 1;
    memset(table, 255, slots * sizeof *table);
    for (i = 0; i < n; i++) {
        float p[3];
        uint32_t bits[3];
        const float *q = mesh->positions + 3 * i;
        size_t j;
        for (j = 0; j < 3; j++) p[j] = q[j] == 0.0f ? 0.0f : q[j]; /* -0 is the same place as 0 */
        memcpy(bits, p, sizeof bits);
        slot = (size_t)supi_mix(supi_mix(bits[0] | ((uint64_t)bits[1] << 32)) ^ bits[2]) & (slots - 1);
        for (; table[slot] != 0xffffffffu; slot = (slot + 1) & (slots - 1)) {
            const float *o = mesh->positions + 3 * (size_t)table[slot];
            if (o[0] == p[0] && o[1] == p[1] && o[2] == p[2]) break;
        }
        if (table[slot] == 0xffffffffu) table[slot] = (uint32_t)i;
        s->place[i] = table[slot];
    }
    SUP_FREE(table);
    memset(s->start, 0, (n + 1) * sizeof *s->start);
    for (i = 0; i < corners; i++) s->start[s->place[mesh->indices[i]]]++;
    for (i = 0; i <= n; i++) { /* ends; filling from the back makes them starts */
        total += s->start[i];
        s->start[i] = total;
    }
    for (i = corners; i-- > 0;) s->order[--s->start[s->place[mesh->indices[i]]]] = (uint32_t)i;
    return 0;
}

SUP_FN uint32_t supi_group_of(uint32_t *group, uint32_t i) {
    while (group[i] != i) {
        group[i] = group[group[i]];
        i = group[i];
    }
    return i;
}

/* Which of the k corners of a place share a normal: those that are connected over edges that are not sharp. */
SUP_FN void supi_smooth_group(supi_smooth *s, const uint32_t *corner, size_t k) {
    const sup_mesh *mesh = s->mesh;
    size_t i, j, n = 0;
    for (i = 0; i < k; i++) {
        s->group[i] = s->crease < -1.0 ? 0 : (uint32_t)i;
        if (s->crease < -1.0) continue;
        for (j = 1; j < 3; j++) { /* the edges to the other two corners of the triangle */
            const uint32_t v = mesh->indices[corner[i] / 3 * 3 + (corner[i] + j) % 3];
            s->key[n++] = (uint64_t)s->place[v] << 32 | i;
        }
    }
    supi_sort_keys(s->key, n);
    for (i = 1; i < n; i++) {
        for (j = i; j-- > 0 && i - j < 8 && s->key[j] >> 32 == s->key[i] >> 32;) {
            const uint32_t a = (uint32_t)s->key[i], b = (uint32_t)s->key[j];
            const float *x = s->face + 3 * (size_t)(corner[a] / 3), *y = s->face + 3 * (size_t)(corner[b] / 3);
            const double cosine =
                (double)x[0] * (double)y[0] + (double)x[1] * (double)y[1] + (double)x[2] * (double)y[2];
            if (cosine >= s->crease) {
                const uint32_t ga = supi_group_of(s->group, a), gb = supi_group_of(s->group, b);
                s->group[ga < gb ? gb : ga] = ga < gb ? ga : gb;
            }
        }
    }
}

/* Normal of a sum: unit length whatever it is. */
SUP_FN void supi_sum_normal(const double *sum, float *normal) {
    const double length = sqrt(sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]);
    size_t j;
    /* Opposite triangles may cancel to rounding noise: no direction is better than another then. */
    for (j = 0; j < 3; j++) normal[j] = length > 1e-6 ? (float)(sum[j] / length) : j == 1 ? 1.0f : 0.0f;
}

SUP_FN int supi_smooth_copy(supi_smooth *s, uint32_t vertex, const double *sum) {
    const size_t e = s->extra_count;
    void *grown = sup_grow(s->extra, &s->extra_capacity, e + 1, sizeof *s->extra);
    if (!grown) return 1;
    s->extra = (uint32_t *)grown;
    grown = sup_grow(s->extra_normals, &s->extra_normal_capacity, 3 * e + 3, sizeof(float));
    if (!grown) return 1;
    s->extra_normals = (float *)grown;
    s->extra[e] = vertex;
    supi_sum_normal(sum, s->extra_normals + 3 * e);
    s->extra_count++;
    return 0;
}

/* Normals of the vertices of one place. A vertex whose corners lie in several groups keeps the first; for each other
   group it gets a copy. Returns 1 when memory is short. */
SUP_FN int supi_smooth_place(supi_smooth *s, const uint32_t *corner, size_t k) {
    const sup_mesh *mesh = s->mesh;
    void *grown = sup_grow(s->key, &s->key_capacity, 2 * k, sizeof *s->key);
    size_t i, j;
    if (grown) s->key = (uint64_t *)grown;
    if (grown && (grown = sup_grow(s->group, &s->group_capacity, k, sizeof *s->group)) != NULL)
        s->group = (uint32_t *)grown;
    if (grown && (grown = sup_grow(s->sum, &s->sum_capacity, 3 * k, sizeof *s->sum)) != NULL) s->sum = (double *)grown;
    if (!grown) return 1;
    supi_smooth_group(s, corner, k);
    for (i = 0; i < 3 * k; i++) s->sum[i] = 0.0;
    for (i = 0; i < k; i++) {
        const float *face = s->face + 3 * (size_t)(corner[i] / 3);
        s->group[i] = s->group[s->group[i]]; /* never above i, so that one is the root already */
        s->key[i] = (uint64_t)mesh->indices[corner[i]] << 32 | i;
        if (face[0] != 0.0f || face[1] != 0.0f || face[2] != 0.0f) {
            const double weight = supi_corner_angle(mesh, corner[i]);
            for (j = 0; j < 3; j++) s->sum[3 * (size_t)s->group[i] + j] += weight * (double)face[j];
        }
    }
    supi_sort_keys(s->key, k);
    for (i = 0; i < k; i = j) { /* corners of one vertex: the group of the first keeps it, each other one gets a copy */
        const uint32_t v = (uint32_t)(s->key[i] >> 32), first = s->group[(uint32_t)s->key[i]];
        uint32_t last = first;
        size_t n = i;
        s->used[v] = 1;
        supi_sum_normal(s->sum + 3 * (size_t)first, s->normals + 3 * (size_t)v);
        for (j = i; j < k && (uint32_t)(s->key[j] >> 32) == v; j++) {
            const uint32_t at = (uint32_t)s->key[j];
            if (s->group[at] != first) s->key[n++] = (uint64_t)s->group[at] << 32 | at;
        }
        supi_sort_keys(s->key + i, n - i);
        for (; n > i; i++) {
            const uint32_t g = (uint32_t)(s->key[i] >> 32);
            if (g != last && supi_smooth_copy(s, v, s->sum + 3 * (size_t)g)) return 1;
            last = g;
            grown = sup_grow(s->moves, &s->move_capacity, s->move_count + 1, sizeof *s->moves);
            if (!grown) return 1;
            s->moves = (uint64_t *)grown;
            s->moves[s->move_count++] = (uint64_t)corner[(uint32_t)s->key[i]] << 32 | (s->extra_count - 1);
        }
    }
    return 0;
}

/* Put the copies behind the vertices. Returns 1 when memory is short; the mesh is what it was then. */
SUP_FN int supi_smooth_commit(supi_smooth *s, sup_mesh *mesh) {
    const size_t n = mesh->vertex_count, all = n + s->extra_count;
    size_t bytes, i;
    void *grown;
    if (s->extra_count) {
        if (all < n || all > 0xffffffffu || sup_mul_size(all, 3 * sizeof(float), &bytes)) return 1;
        grown = SUP_REALLOC(mesh->positions, bytes);
        if (!grown) return 1;
        mesh->positions = (float *)grown;
        grown = SUP_REALLOC(s->normals, bytes);
        if (!grown) return 1;
        s->normals = (float *)grown;
        if (mesh->vertex_rgb) {
            grown = SUP_REALLOC(mesh->vertex_rgb, 3 * all);
            if (!grown) return 1;
            mesh->vertex_rgb = (uint8_t *)grown;
        }
        for (i = 0; i < s->extra_count; i++) {
            const size_t from = 3 * (size_t)s->extra[i], to = 3 * (n + i);
            memcpy(mesh->positions + to, mesh->positions + from, 3 * sizeof(float));
            memcpy(s->normals + to, s->extra_normals + 3 * i, 3 * sizeof(float));
            if (mesh->vertex_rgb) memcpy(mesh->vertex_rgb + to, mesh->vertex_rgb + from, 3);
        }
        for (i = 0; i < s->move_count; i++)
            mesh->indices[s->moves[i] >> 32] = (uint32_t)(n + (size_t)(s->moves[i] & 0xffffffffu));
        mesh->vertex_count = all;
    }
    SUP_FREE(mesh->normals);
    mesh->normals = s->normals;
    s->normals = NULL;
    return 0;
}

SUP_FN int supi_compute_normals(sup_mesh *mesh, double crease, sup_error *err) {
    const size_t n = mesh->vertex_count, corners = 3 * mesh->triangle_count;
    supi_smooth s;
    size_t i;
    int failed;
    sup_error_clear(err);
    for (i = 0; i < corners; i++) {
        if (mesh->indices[i] < n) continue;
        return sup_fail(err, "triangle %lu: index %lu out of range", (unsigned long)(i / 3),
                        (unsigned long)mesh->indices[i]);
    }
    memset(&s, 0, sizeof s);
    s.mesh = mesh;
    s.crease = crease;
    failed = mesh->triangle_count > 0x55555555u || n >= 0xffffffffu;
    if (!failed) {
        s.place = (uint32_t *)sup_alloc(n, sizeof *s.place);
        s.start = (uint32_t *)sup_alloc(n + 1, sizeof *s.start);
        s.order = (uint32_t *)sup_alloc(corners, sizeof *s.order);
        s.face = (float *)sup_alloc(corners, sizeof *s.face);
        s.normals = (float *)sup_alloc(n, 3 * sizeof *s.normals);
        s.used = (uint8_t *)sup_alloc(n, 1);
        failed = !s.place || !s.start || !s.order || !s.face || !s.normals || !s.used || supi_smooth_places(&s);
    }
    if (!failed) {
        memset(s.used, 0, n);
        for (i = 0; i < mesh->triangle_count; i++) (void)supi_face_normal(mesh, i, s.face + 3 * i);
        for (i = 0; i < n && !failed; i++)
            failed = s.start[i] != s.start[i + 1] &&
                     supi_smooth_place(&s, s.order + s.start[i], s.start[i + 1] - s.start[i]);
    }
    if (!failed) {
        const double none[3] = {0.0, 0.0, 0.0};
        for (i = 0; i < n; i++) if (!s.used[i]) supi_sum_normal(none, s.normals + 3 * i);
        failed = supi_smooth_commit(&s, mesh);
    }
    supi_smooth_free(&s);
    return failed ? sup_fail(err, "out of memory for normals of %lu vertices", (unsigned long)n) : 0;
}

/* Give the mesh unit vertex normals, replacing those it has: the mean of the normals of the triangles around a place,
   each weighted by its angle there (G. Thuermer, C. A. Wuethrich, Computing vertex normals from polygonal facets,
   1998), over those triangles that are connected by edges that turn by at most 60 degrees: sharp edges stay sharp.
   Vertices with the same position count as one, so that files which repeat vertices along their seams are smooth, too.
   A vertex on a sharp edge needs several normals: for each but the first a copy of it is appended, and the corners
   concerned are moved there. Where nothing is sharp positions, colours and indices stay where they are.
   Triangles without area or with coordinates that are not finite contribute nothing; a vertex with nothing around
   it gets (0, 1, 0). Never NaN. Sums in double, in the order of the triangles.
   Returns 0, or 1 with err->text set (memory, or an index out of range); the mesh is unchanged then.
   O(n log d), d triangles around one place; about 36 bytes per triangle and 40 per vertex while it runs. */
SUP_FN int sup_mesh_compute_normals(sup_mesh *mesh, sup_error *err) {
    return supi_compute_normals(mesh, SUPI_CREASE_COSINE, err);
}

#endif
