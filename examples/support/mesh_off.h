/* mesh_off.h - OFF reader (OFF, COFF, NOFF, CNOFF and their ST forms, text); included by mesh.h
   SPDX-License-Identifier: MIT OR Unlicense */
#ifndef SUP_MESH_OFF_H
#define SUP_MESH_OFF_H

#ifndef SUP_MESH_H
#error "include mesh.h instead"
#endif

/* What stands in the first word: ST, C and N say what each vertex has, 4 and n other spaces. */
typedef struct supi_off_kind {
    int texture, colour, normal, other_space;
    size_t length; /* of the word; 0: there is none */
} supi_off_kind;

SUP_FN supi_off_kind supi_off_parse_kind(const char *at, const char *end) {
    supi_off_kind kind;
    const char *p = at;
    memset(&kind, 0, sizeof kind);
    if (end - p >= 2 && p[0] == 'S' && p[1] == 'T') {
        kind.texture = 1;
        p += 2;
    }
    if (p < end && *p == 'C') {
        kind.colour = 1;
        p++;
    }
    if (p < end && *p == 'N') {
        kind.normal = 1;
        p++;
    }
    while (p < end && (*p == '4' || *p == 'n')) {
        kind.other_space = 1;
        p++;
    }
    if (end - p >= 3 && memcmp(p, "OFF", 3) == 0 && (p + 3 == end || supi_is_space(p[3]) || p[3] == '#'))
        kind.length = (size_t)(p + 3 - at);
    return kind;
}

SUP_FN void supi_off_skip(sup_text *text) {
    for (;;) {
        sup_text_skip_space(text);
        if (text->at == text->end || *text->at != '#') return;
        sup_text_skip_line(text);
    }
}

SUP_FN int supi_off_is_header(const char *data, const char *end) {
    sup_text text;
    text.begin = text.at = data;
    text.end = end;
    supi_off_skip(&text);
    return supi_off_parse_kind(text.at, end).length != 0;
}

/* Numbers up to the end of the line, at most 4; returns how many. *whole: none had a point or an exponent. */
SUP_FN size_t supi_off_rest(sup_text *text, double value[4], int *whole) {
    size_t count = 0;
    *whole = 1;
    for (;;) {
        const char *start;
        double number;
        while (text->at < text->end && supi_is_blank(*text->at)) text->at++;
        start = text->at;
        if (count == 4 || sup_parse_double(&text->at, text->end, &number)) break;
        for (; start < text->at; start++) *whole &= !(*start == '.' || *start == 'e' || *start == 'E');
        value[count++] = number;
    }
    sup_text_skip_line(text);
    return count;
}

SUP_FN void supi_off_colour(const double value[4], int whole, uint8_t rgb[3]) {
    size_t k;
    for (k = 0; k < 3; k++) rgb[k] = sup_unit_to_byte(whole ? value[k] / 255.0 : value[k]);
}

SUP_FN int supi_read_off_body(sup_text *text, const char *name, supi_off_kind kind, sup_mesh *out, supi_faces *faces,
                              uint32_t **corners, sup_error *err) {
    const char *const memory = "out of memory";
    const char *wrong = NULL;
    int64_t counts[2] = {0, 0};
    size_t i, k, capacity = 0, vertices, face_count;
    double value[4];
    int whole;
    text->at += kind.length;
    for (k = 0; k < 2 && !wrong; k++) {
        supi_off_skip(text);
        if (sup_parse_int(&text->at, text->end, counts + k) || counts[k] < 0)
            wrong = "the numbers of vertices and faces are missing";
    }
    if (!wrong) sup_text_skip_line(text); /* the number of edges, which nobody needs */
    /* A coordinate takes two bytes at least, and so does a face. */
    if (!wrong && (uint64_t)counts[0] > (uint64_t)(text->end - text->at) / 6 + 1)
        wrong = "more vertices are announced than the file can hold";
    if (!wrong && (uint64_t)counts[1] > (uint64_t)(text->end - text->at) / 2 + 1)
        wrong = "more faces are announced than the file can hold";
    if (wrong) return sup_fail(err, "%s: line %lu: %s", name, (unsigned long)sup_text_line(text, text->at), wrong);
    vertices = (size_t)counts[0];
    face_count = (size_t)counts[1];
    if (vertices > 0xfffffffeu) return sup_fail(err, "%s: more vertices than 32-bit indices can name", name);
    out->positions = (float *)sup_alloc(vertices, 3 * sizeof(float));
    if (kind.normal) out->normals = (float *)sup_alloc(vertices, 3 * sizeof(float));
    if (kind.colour) out->vertex_rgb = (uint8_t *)sup_alloc(vertices, 3);
    if (!out->positions || (kind.normal && !out->normals) || (kind.colour && !out->vertex_rgb))
        return sup_fail(err, "%s: %s", name, memory);
    out->vertex_count = vertices;
    for (i = 0; i < vertices; i++) {
        for (k = 0; k < (kind.normal ? 6u : 3u); k++) {
            supi_off_skip(text);
            if (sup_parse_float(&text->at, text->end, (k < 3 ? out->positions + k : out->normals + k - 3) + 3 * i)) {
                return sup_fail(err, "%s: line %lu: vertex %lu: %s", name, (unsigned long)sup_text_line(text, text->at),
                                (unsigned long)i,
                                text->at == text->end ? "the file ends here" : "a number was expected");
            }
        }
        if (kind.colour) {
            const char *start = text->at;
            if (supi_off_rest(text, value, &whole) < 3) {
                return sup_fail(err, "%s: line %lu: vertex %lu has no colour", name,
                                (unsigned long)sup_text_line(text, start), (unsigned long)i);
            }
            supi_off_colour(value, whole, out->vertex_rgb + 3 * i);
        } else if (kind.texture) {
            sup_text_skip_line(text);
        }
    }
    for (i = 0; i < face_count; i++) {
        int64_t n = 0, index = 0;
        size_t before = faces->count;
        void *grown;
        supi_off_skip(text);
        if (sup_parse_int(&text->at, text->end, &n) || n < 0) {
            wrong = text->at == text->end ? "the file ends here" : "a number of corners was expected";
        } else if ((uint64_t)n > (uint64_t)(text->end - text->at)) {
            wrong = "more corners are announced than the file can hold";
        }
        if (wrong)
            return sup_fail(err, "%s: line %lu: face %lu: %s", name, (unsigned long)sup_text_line(text, text->at),
                            (unsigned long)i, wrong);
        grown = sup_grow(*corners, &capacity, (size_t)n + 1, sizeof **corners);
        if (!grown) return sup_fail(err, "%s: %s", name, memory);
        *corners = (uint32_t *)grown;
        for (k = 0; k < (size_t)n; k++) {
            supi_off_skip(text);
            if (sup_parse_int(&text->at, text->end, &index)) {
                return sup_fail(err, "%s: line %lu: face %lu: %s", name, (unsigned long)sup_text_line(text, text->at),
                                (unsigned long)i,
                                text->at == text->end ? "the file ends here" : "an index was expected");
            }
            if (index < 0 || (uint64_t)index >= vertices) {
                return sup_fail(err, "%s: line %lu: face %lu: index %ld out of range, there are %lu vertices", name,
                                (unsigned long)sup_text_line(text, text->at), (unsigned long)i, (long)index,
                                (unsigned long)vertices);
            }
            (*corners)[k] = (uint32_t)index;
        }
        if (supi_add_polygon(faces, out->positions, *corners, (size_t)n)) return sup_fail(err, "%s: %s", name, memory);
        if (supi_off_rest(text, value, &whole) >= 3 && faces->count > before) {
            uint8_t rgb[3];
            supi_off_colour(value, whole, rgb);
            if (supi_paint(faces, before, rgb)) return sup_fail(err, "%s: %s", name, memory);
        }
    }
    return 0;
}

SUP_FN int supi_read_off(sup_text *text, const char *name, sup_mesh *out, sup_error *err) {
    supi_off_kind kind;
    supi_faces faces;
    uint32_t *corners = NULL;
    const char *p;
    int failed;
    supi_off_skip(text);
    kind = supi_off_parse_kind(text->at, text->end);
    if (kind.length && kind.other_space)
        return sup_fail(err, "%s: OFF files of other than three dimensions are not read", name);
    for (p = text->at + kind.length; p < text->end && supi_is_blank(*p); p++) {}
    if (kind.length && sup_text_is_word(p, text->end, "binary"))
        return sup_fail(err, "%s: binary OFF files are not read", name);
    memset(&faces, 0, sizeof faces);
    failed = supi_read_off_body(text, name, kind, out, &faces, &corners, err);
    SUP_FREE(corners);
    if (failed) supi_faces_free(&faces);
    else supi_faces_finish(&faces, out);
    return failed;
}

#endif
