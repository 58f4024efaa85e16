/* volume_plot3d.h - PLOT3D reader (XYZ and Q files, binary); included by volume.h
   SPDX-License-Identifier: MIT OR Unlicense

   These files say nothing about themselves: byte order, Fortran record marks, one or several grids, 4 or 8 bytes a
   number, with blanking or without are found by trying which of them gives exactly the size of the file. */
#ifndef SUP_VOLUME_PLOT3D_H
#define SUP_VOLUME_PLOT3D_H

#ifndef SUP_VOLUME_H
#error "include volume.h instead"
#endif

enum { SUPI_P3D_MAX_GRIDS = 4096 };

typedef struct supi_p3d {
    const uint8_t *data;
    size_t size, at;
    int big, marks, several, wide, blanks; /* what is being tried */
    size_t grids;
    size_t points; /* of all grids */
    uint32_t *dims; /* 3 per grid */
} supi_p3d;

SUP_FN uint32_t supi_p3d_u32(const supi_p3d *p, size_t at) {
    const uint8_t *b = p->data + at;
    return p->big ? (uint32_t)b[0] << 24 | (uint32_t)b[1] << 16 | (uint32_t)b[2] << 8 | b[3]
                  : (uint32_t)b[3] << 24 | (uint32_t)b[2] << 16 | (uint32_t)b[1] << 8 | b[0];
}
SUP_FN double supi_p3d_real(const supi_p3d *p, size_t at) {
    const uint32_t a = supi_p3d_u32(p, at);
    float f;
    double d;
    uint64_t bits;
    if (!p->wide) {
        memcpy(&f, &a, sizeof f);
        return (double)f;
    }
    bits = p->big ? (uint64_t)a << 32 | supi_p3d_u32(p, at + 4) : (uint64_t)supi_p3d_u32(p, at + 4) << 32 | a;
    memcpy(&d, &bits, sizeof d);
    return d;
}

/* A record of `bytes` bytes: checks the marks around it, moves p->at behind it, *start is its first byte.
   1: it does not fit. */
SUP_FN int supi_p3d_record(supi_p3d *p, uint64_t bytes, size_t *start) {
    const size_t mark = p->marks ? 4u : 0u, left = p->size - p->at;
    if (left < 2 * mark || bytes > left - 2 * mark) return 1;
    *start = p->at + mark;
    if (mark && (supi_p3d_u32(p, p->at) != (uint32_t)bytes ||
                 supi_p3d_u32(p, *start + (size_t)bytes) != (uint32_t)bytes))
        return 1;
    p->at = *start + (size_t)bytes + mark;
    return 0;
}

/* The number of grids and their sizes. */
SUP_FN int supi_p3d_header(supi_p3d *p) {
    size_t start = 0, g, k;
    p->at = 0;
    p->grids = 1;
    p->points = 0;
    if (p->several) {
        if (supi_p3d_record(p, 4, &start)) return 1;
        p->grids = supi_p3d_u32(p, start);
        if (p->grids < 1 || p->grids > SUPI_P3D_MAX_GRIDS) return 1;
    }
    if (supi_p3d_record(p, 12 * (uint64_t)p->grids, &start)) return 1;
    for (g = 0; g < p->grids; g++) {
        uint64_t n = 1;
        for (k = 0; k < 3; k++) {
            const uint32_t d = supi_p3d_u32(p, start + 12 * g + 4 * k);
            if (d < 1 || d > 0x7fffffffu) return 1;
            p->dims[3 * g + k] = d;
            n *= d;
            if (n > p->size) return 1; /* a point takes more than a byte */
        }
        p->points += (size_t)n;
        if (p->points > p->size) return 1;
    }
    return 0;
}

SUP_FN size_t supi_p3d_grid_points(const supi_p3d *p, size_t g) {
    return (size_t)p->dims[3 * g] * p->dims[3 * g + 1] * p->dims[3 * g + 2];
}

/* Walk over all records; fill what is not NULL. 1: the file is not laid out like this. Bytes may be left: old files fill
   their last block of 512. */
SUP_FN int supi_p3d_xyz(supi_p3d *p, double *points, uint8_t *blanks) {
    const size_t word = p->wide ? 8u : 4u;
    size_t g, i, k, first = 0, start = 0;
    for (g = 0; g < p->grids; g++) {
        const size_t n = supi_p3d_grid_points(p, g);
        if (supi_p3d_record(p, (uint64_t)n * (3 * word + (p->blanks ? 4u : 0u)), &start)) return 1;
        for (i = 0; points && i < n; i++) {
            for (k = 0; k < 3; k++) points[3 * (first + i) + k] = supi_p3d_real(p, start + word * (k * n + i));
        }
        for (i = 0; blanks && i < n; i++) blanks[first + i] = supi_p3d_u32(p, start + 3 * word * n + 4 * i) != 0;
        first += n;
    }
    return p->at != p->size && (p->size - p->at >= 512 || p->size % 512 != 0);
}
SUP_FN int supi_p3d_q(supi_p3d *p, float *const field[5]) {
    const size_t word = p->wide ? 8u : 4u;
    size_t g, i, k, first = 0, start = 0;
    for (g = 0; g < p->grids; g++) {
        const size_t n = supi_p3d_grid_points(p, g);
        if (supi_p3d_record(p, 4 * word, &start) || supi_p3d_record(p, 5 * (uint64_t)n * word, &start)) return 1;
        for (k = 0; field && k < 5; k++)
            for (i = 0; i < n; i++) {
                const float x = (float)supi_p3d_real(p, start + word * (k * n + i));
                if (k == 0 || k == 4) field[k == 0 ? 0 : 2][first + i] = x;
                else field[1][3 * (first + i) + k - 1] = x;
            }
        first += n;
    }
    return p->at != p->size && (p->size - p->at >= 512 || p->size % 512 != 0);
}

SUP_FN void supi_p3d_layout(supi_p3d *p, int layout) {
    p->big = !(layout & 1);
    p->wide = layout >> 1 & 1;
    p->marks = layout >> 2 & 1;
    p->several = layout >> 3 & 1;
    p->blanks = layout >> 4 & 1;
}

/* Find the layout that leaves the fewest bytes; is_q: of a Q file, whose grids have to be those of `like`. */
SUP_FN int supi_p3d_find(supi_p3d *p, int is_q, const supi_p3d *like) {
    int layout, best = -1;
    size_t least = 512;
    for (layout = 0; layout < (is_q ? 16 : 32); layout++) {
        supi_p3d_layout(p, layout);
        if (supi_p3d_header(p)) continue;
        if (like && (p->grids != like->grids || memcmp(p->dims, like->dims, 12 * p->grids) != 0)) continue;
        if (is_q ? supi_p3d_q(p, NULL) : supi_p3d_xyz(p, NULL, NULL)) continue;
        if (p->size - p->at < least) {
            least = p->size - p->at;
            best = layout;
        }
    }
    if (best < 0) return 1;
    supi_p3d_layout(p, best);
    return supi_p3d_header(p);
}

/* Several grids become a list of hexahedra. */
SUP_FN int supi_p3d_cells(supi_volume_reader *r, const supi_p3d *p, const uint8_t *blanks) {
    size_t g, first = 0;
    for (g = 0; g < p->grids; g++) {
        const size_t nx = p->dims[3 * g], ny = p->dims[3 * g + 1], nz = p->dims[3 * g + 2];
        size_t i, j, k, c;
        for (k = 0; k + 1 < nz; k++)
            for (j = 0; j + 1 < ny; j++)
                for (i = 0; i + 1 < nx; i++) {
                    const size_t at = first + i + nx * (j + ny * k), up = nx * ny;
                    const size_t corner[8] = {at,      at + 1,      at + 1 + nx,      at + nx,
                                              at + up, at + up + 1, at + up + 1 + nx, at + up + nx};
                    uint32_t number[8];
                    int there = 1;
                    for (c = 0; c < 8; c++) {
                        number[c] = (uint32_t)corner[c];
                        if (blanks && !blanks[corner[c]]) there = 0;
                    }
                    if (there && supi_volume_add_cell(r, SUP_HEXAHEDRON, number, 8)) return 1;
                }
        first += nx * ny * nz;
    }
    return 0;
}

/* The name of the Q file: ...xyz... -> ...q..., ending .x or .xyz -> .q. 1: it has no such part. */
SUP_FN int supi_p3d_q_name(const char *name, char *out) {
    const char *slash = strrchr(name, '/'), *base = slash ? slash + 1 : name, *p, *found = NULL;
    for (p = base; *p; p++)
        if (supi_lower(p[0]) == 'x' && supi_lower(p[1]) == 'y' && supi_lower(p[2]) == 'z') found = p;
    if (found) {
        memcpy(out, name, (size_t)(found - name));
        out[found - name] = found[0] == 'X' ? 'Q' : 'q';
        memcpy(out + (found - name) + 1, found + 3, strlen(found + 3) + 1);
        return 0;
    }
    if (!supi_ends_with(name, ".x")) return 1;
    memcpy(out, name, strlen(name) + 1);
    out[strlen(name) - 1] = 'q';
    return 0;
}

/* density, momentum, energy; and from them pressure and speed (a perfect gas, ratio of specific heats 1.4). */
SUP_FN int supi_p3d_read_q(supi_volume_reader *r, const supi_p3d *xyz, const char *name, const char *data, size_t size) {
    static const char names[5][9] = {"density", "momentum", "energy", "pressure", "velocity"};
    static const uint32_t components[5] = {1, 3, 1, 1, 1};
    supi_p3d q = *xyz;
    float *field[5];
    size_t i, k;
    q.data = (const uint8_t *)data;
    q.size = size;
    q.dims = (uint32_t *)sup_alloc(SUPI_P3D_MAX_GRIDS, 12);
    if (!q.dims) return supi_volume_memory(r);
    if (supi_p3d_find(&q, 1, xyz)) {
        SUP_FREE(q.dims);
        (void)sup_fail(r->err, "%s: %s does not fit to it and is left out", r->name, name);
        return 0;
    }
    for (k = 0; k < 5; k++) {
        field[k] = sup_volume_add_field(r->out, names[k], strlen(names[k]), components[k], 0, q.points);
        if (!field[k]) {
            SUP_FREE(q.dims);
            return supi_volume_memory(r);
        }
    }
    (void)supi_p3d_header(&q);
    (void)supi_p3d_q(&q, field);
    for (i = 0; i < q.points; i++) {
        const double d = (double)field[0][i], e = (double)field[2][i];
        const double mx = (double)field[1][3 * i], my = (double)field[1][3 * i + 1], mz = (double)field[1][3 * i + 2];
        const double m2 = mx * mx + my * my + mz * mz;
        field[3][i] = (float)(0.4 * (e - 0.5 * m2 / d));
        field[4][i] = (float)(sqrt(m2) / d);
    }
    SUP_FREE(q.dims);
    return 0;
}

SUP_FN int supi_read_plot3d_body(supi_volume_reader *r, supi_p3d *p) {
    sup_volume *v = r->out;
    uint8_t *blanks = NULL;
    char *name;
    int failed = 0;
    p->data = (const uint8_t *)r->text.begin;
    p->size = (size_t)(r->text.end - r->text.begin);
    if (supi_p3d_find(p, 0, NULL))
        return sup_fail(r->err, "%s: not a binary PLOT3D grid: no layout gives a file of this size", r->name);
    if (p->points > 0xfffffffeu) return sup_fail(r->err, "%s: more points than 32-bit numbers can name", r->name);
    v->points = (double *)sup_alloc(p->points, 3 * sizeof(double));
    if (p->blanks) blanks = (uint8_t *)sup_alloc(p->points, 1);
    if (!v->points || (p->blanks && !blanks)) {
        SUP_FREE(blanks);
        return supi_volume_memory(r);
    }
    v->point_count = p->points;
    (void)supi_p3d_header(p);
    (void)supi_p3d_xyz(p, v->points, blanks);
    if (p->grids == 1) {
        memcpy(v->dims, p->dims, sizeof v->dims);
        v->blanks = blanks;
    } else {
        failed = supi_p3d_cells(r, p, blanks);
        SUP_FREE(blanks);
    }
    if (failed || !r->open_fn) return failed;
    name = (char *)sup_alloc(strlen(r->name) + 1, 1);
    if (!name) return supi_volume_memory(r);
    if (!supi_p3d_q_name(r->name, name)) {
        char *data = NULL;
        size_t size = 0;
        if (!r->open_fn(r->open_user, name, &data, &size)) {
            failed = supi_p3d_read_q(r, p, name, data, size);
            SUP_FREE(data);
        }
    }
    SUP_FREE(name);
    return failed;
}

SUP_FN int supi_read_plot3d(supi_volume_reader *r) {
    supi_p3d p;
    int failed;
    memset(&p, 0, sizeof p);
    p.dims = (uint32_t *)sup_alloc(SUPI_P3D_MAX_GRIDS, 12);
    if (!p.dims) return supi_volume_memory(r);
    failed = supi_read_plot3d_body(r, &p);
    SUP_FREE(p.dims);
    return failed;
}

#endif
