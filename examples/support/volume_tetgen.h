/* volume_tetgen.h - TetGen reader (.node and .ele); included by volume.h
   SPDX-License-Identifier: MIT OR Unlicense */
#ifndef SUP_VOLUME_TETGEN_H
#define SUP_VOLUME_TETGEN_H

#ifndef SUP_VOLUME_H
#error "include volume.h instead"
#endif

/* The next number that is not behind a '#'. */
SUP_FN int supi_tetgen_real(supi_volume_reader *r, double *out) {
    for (;;) {
        sup_text_skip_space(&r->text);
        if (r->text.at == r->text.end || *r->text.at != '#') return supi_volume_real(r, out);
        sup_text_skip_line(&r->text);
    }
}
SUP_FN int supi_tetgen_int(supi_volume_reader *r, int64_t *out) {
    for (;;) {
        sup_text_skip_space(&r->text);
        if (r->text.at == r->text.end || *r->text.at != '#') return supi_volume_int(r, out);
        sup_text_skip_line(&r->text);
    }
}
/* A count on the first line. */
SUP_FN int supi_tetgen_count(supi_volume_reader *r, size_t most, size_t *out) {
    int64_t value = 0;
    if (supi_tetgen_int(r, &value)) return 1;
    if (value < 0 || (uint64_t)value > most) return supi_volume_fail(r, "more is announced than the file can hold");
    *out = (size_t)value;
    return 0;
}

/* count 3 attributes markers; then number x y z attributes marker. *first: the number of the first point. */
SUP_FN int supi_tetgen_nodes(supi_volume_reader *r, int64_t *first) {
    sup_volume *v = r->out;
    const size_t left = (size_t)(r->text.end - r->text.at);
    size_t count = 0, attributes = 0, i, k;
    int64_t dimension = 0, markers = 0, number = 0;
    double value = 0.0;
    if (supi_tetgen_count(r, left / 8 + 1, &count) || supi_tetgen_int(r, &dimension) ||
        supi_tetgen_count(r, 256, &attributes) || supi_tetgen_int(r, &markers))
        return 1;
    if (dimension != 3) return supi_volume_fail(r, "points of three dimensions were expected");
    v->points = (double *)sup_alloc(count, 3 * sizeof(double));
    if (!v->points) return supi_volume_memory(r);
    for (k = 0; k < attributes; k++) {
        char name[32];
        (void)snprintf(name, sizeof name, "attribute_%d", (int)k);
        if (count * attributes > left / 2 + 1 || !sup_volume_add_field(v, name, strlen(name), 1, 0, count))
            return supi_volume_fail(r, "more values are announced than the file or memory can hold");
    }
    for (i = 0; i < count; i++) {
        if (supi_tetgen_int(r, &number)) return 1;
        if (i == 0) *first = number;
        if (*first < 0 || *first > INT64_C(0xffffffff)) return supi_volume_fail(r, "the points are not numbered from 0 or 1");
        if (number != *first + (int64_t)i) return supi_volume_fail(r, "the points are not numbered one after the other");
        for (k = 0; k < 3; k++)
            if (supi_tetgen_real(r, v->points + 3 * i + k)) return 1;
        for (k = 0; k < attributes; k++) {
            if (supi_tetgen_real(r, &value)) return 1;
            v->fields[k].values[i] = (float)value;
        }
        if (markers != 0 && supi_tetgen_real(r, &value)) return 1;
    }
    v->point_count = count;
    return 0;
}

/* count corners attributes; then number corners attributes. */
SUP_FN int supi_tetgen_elements(supi_volume_reader *r, int64_t first) {
    sup_volume *v = r->out;
    const size_t left = (size_t)(r->text.end - r->text.at);
    size_t count = 0, corners = 0, attributes = 0, before = v->field_count, i, k;
    int64_t number = 0;
    double value = 0.0;
    if (supi_tetgen_count(r, left / 9 + 1, &count) || supi_tetgen_count(r, 10, &corners) ||
        supi_tetgen_count(r, 256, &attributes))
        return 1;
    if (corners != 4 && corners != 10) return supi_volume_fail(r, "tetrahedra of 4 or 10 points were expected");
    for (k = 0; k < attributes; k++) {
        char name[32];
        (void)snprintf(name, sizeof name, k ? "region_%d" : "region", (int)k);
        if (count * attributes > left / 2 + 1 || !sup_volume_add_field(v, name, strlen(name), 1, 1, count))
            return supi_volume_fail(r, "more values are announced than the file or memory can hold");
    }
    for (i = 0; i < count; i++) {
        uint32_t corner[4] = {0, 0, 0, 0};
        if (supi_tetgen_int(r, &number)) return 1;
        for (k = 0; k < corners; k++) {
            if (supi_tetgen_int(r, &number)) return 1;
            if (number < first || (uint64_t)(number - first) >= v->point_count)
                return supi_volume_fail(r, "a cell has a point that does not exist");
            if (k < 4) corner[k] = (uint32_t)(number - first);
        }
        for (k = 0; k < attributes; k++) {
            if (supi_tetgen_real(r, &value)) return 1;
            v->fields[before + k].values[i] = (float)value;
        }
        if (supi_volume_add_cell(r, SUP_TETRA, corner, 4)) return 1;
        v->straightened += corners == 10;
    }
    return 0;
}

/* Points and tetrahedra are two files beside each other: either may be given. */
SUP_FN int supi_read_tetgen(supi_volume_reader *r, int is_ele) {
    const sup_text given = r->text;
    const char *given_name = r->name;
    const size_t length = strlen(given_name), stem = length - (is_ele ? 4u : 5u);
    char *other = (char *)sup_alloc(length + 8, 1), *data = NULL;
    size_t size = 0;
    int64_t first = 0;
    int failed = 0, part;
    if (!other) return supi_volume_memory(r);
    memcpy(other, given_name, stem);
    memcpy(other + stem, is_ele ? ".node" : ".ele", is_ele ? 6u : 5u);
    if (!r->open_fn || r->open_fn(r->open_user, other, &data, &size)) {
        failed = sup_fail(r->err, "%s: %s, which belongs to it, cannot be read", given_name, other);
        SUP_FREE(other);
        return failed;
    }
    for (part = 0; part < 2 && !failed; part++) { /* first the points, then the tetrahedra */
        if (part == is_ele) {
            r->text = given;
            r->name = given_name;
        } else {
            r->text.begin = r->text.at = data;
            r->text.end = data + size;
            r->name = other;
        }
        failed = part == 0 ? supi_tetgen_nodes(r, &first) : supi_tetgen_elements(r, first);
    }
    r->name = given_name;
    SUP_FREE(data);
    SUP_FREE(other);
    return failed;
}

#endif
