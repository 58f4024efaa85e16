/* volume_ucd.h - AVS UCD reader (text); included by volume.h
   SPDX-License-Identifier: MIT OR Unlicense */
#ifndef SUP_VOLUME_UCD_H
#define SUP_VOLUME_UCD_H

#ifndef SUP_VOLUME_H
#error "include volume.h instead"
#endif

SUP_FN void supi_ucd_skip(supi_volume_reader *r) { /* white space and comments */
    for (;;) {
        sup_text_skip_space(&r->text);
        if (r->text.at == r->text.end || *r->text.at != '#') return;
        sup_text_skip_line(&r->text);
    }
}

/* id x y z for each point */
SUP_FN int supi_ucd_points(supi_volume_reader *r, size_t count, supi_ids *ids) {
    sup_volume *v = r->out;
    int64_t twice = 0;
    size_t i, k;
    v->points = (double *)sup_alloc(count, 3 * sizeof(double));
    ids->list = (supi_id *)sup_alloc(count, sizeof *ids->list);
    if (!v->points || !ids->list) return supi_volume_memory(r);
    for (i = 0; i < count; i++) {
        if (supi_volume_int(r, &ids->list[i].id)) return 1;
        ids->list[i].index = (uint32_t)i;
        for (k = 0; k < 3; k++)
            if (supi_volume_real(r, v->points + 3 * i + k)) return 1;
    }
    v->point_count = ids->count = count;
    if (supi_ids_sort(ids, &twice))
        return sup_fail(r->err, "%s: point %ld is there twice", r->name, (long)twice);
    return 0;
}

/* id material kind corners...; the corners of pyramids begin with the top here, with the base in VTK */
SUP_FN int supi_ucd_cells(supi_volume_reader *r, size_t count, const supi_ids *points, supi_ids *cells) {
    static const char kinds[8][6] = {"tet", "pyr", "prism", "hex", "pt", "line", "tri", "quad"};
    static const uint8_t corners[8] = {4, 5, 6, 8, 1, 2, 3, 4};
    static const uint8_t shapes[4] = {SUP_TETRA, SUP_PYRAMID, SUP_WEDGE, SUP_HEXAHEDRON};
    int64_t twice = 0;
    size_t i, k;
    cells->list = (supi_id *)sup_alloc(count, sizeof *cells->list);
    if (!cells->list) return supi_volume_memory(r);
    cells->count = 0;
    for (i = 0; i < count; i++) {
        int64_t id = 0, material = 0, number = 0;
        uint32_t corner[8] = {0, 0, 0, 0, 0, 0, 0, 0}, top;
        const char *word;
        size_t length, kind;
        if (supi_volume_int(r, &id) || supi_volume_int(r, &material)) return 1;
        length = supi_volume_word(r, &word);
        for (kind = 0; kind < 8 && !supi_word_is(word, length, kinds[kind]); kind++) {}
        if (kind == 8) return supi_volume_fail(r, "a kind of cell (tet, pyr, prism, hex, ...) was expected");
        for (k = 0; k < corners[kind]; k++) {
            if (supi_volume_int(r, &number)) return 1;
            corner[k] = supi_ids_find(points, number);
            if (corner[k] == 0xffffffffu) return supi_volume_fail(r, "a cell has a point that does not exist");
        }
        if (kind >= 4) {
            r->out->skipped_cells++;
            continue;
        }
        if (kind == 1) {
            top = corner[0];
            for (k = 0; k < 4; k++) corner[k] = corner[k + 1];
            corner[4] = top;
        }
        cells->list[cells->count].id = id;
        cells->list[cells->count].index = (uint32_t)cells->count;
        cells->count++;
        if (supi_volume_add_cell(r, shapes[kind], corner, corners[kind])) return 1;
    }
    if (supi_ids_sort(cells, &twice)) return sup_fail(r->err, "%s: cell %ld is there twice", r->name, (long)twice);
    return 0;
}

/* Numbers of components, one line with name and unit for each, then id and values for each of `count` things.
   Things that were skipped (cells that are no volume) have values, too: these are dropped. */
SUP_FN int supi_ucd_data(supi_volume_reader *r, size_t count, const supi_ids *ids, int per_cell) {
    sup_volume *v = r->out;
    size_t components = 0, i, k, j, first = v->field_count;
    size_t *size;
    int failed = 0;
    supi_ucd_skip(r);
    if (supi_volume_count(r, 2, &components)) return 1;
    size = (size_t *)sup_alloc(components, sizeof *size);
    if (!size) return supi_volume_memory(r);
    for (i = 0; i < components && !failed; i++) {
        failed = supi_volume_count(r, 1, size + i);
        if (!failed && (size[i] == 0 || size[i] > 64)) failed = supi_volume_fail(r, "1 to 64 components were expected");
    }
    for (i = 0; i < components && !failed; i++) {
        const char *word, *comma;
        float *values;
        size_t length;
        sup_text_skip_line(&r->text);
        while (r->text.at < r->text.end && supi_is_blank(*r->text.at)) r->text.at++;
        for (word = r->text.at; r->text.at < r->text.end && *r->text.at != '\n' && *r->text.at != '\r'; r->text.at++) {}
        for (comma = word; comma < r->text.at && *comma != ','; comma++) {}
        for (length = (size_t)(comma - word); length > 0 && supi_is_blank(word[length - 1]); length--) {}
        values = ids->count <= SIZE_MAX / sizeof(float) / 64 && ids->count * size[i] <=
                 (size_t)(r->text.end - r->text.at) ? sup_volume_add_field(v, word, length, (uint32_t)size[i], per_cell,
                                                                           ids->count) : NULL;
        if (!values) failed = supi_volume_fail(r, "more values are announced than the file or memory can hold");
        for (k = 0; !failed && k < ids->count * size[i]; k++) values[k] = 0.0f;
    }
    for (j = 0; j < count && !failed; j++) {
        int64_t id = 0;
        uint32_t at;
        failed = supi_volume_int(r, &id);
        if (failed) break;
        at = supi_ids_find(ids, id);
        if (at == 0xffffffffu && !(per_cell && v->skipped_cells))
            failed = supi_volume_fail(r, "values of a point or cell that does not exist");
        for (i = 0; i < components && !failed; i++) {
            for (k = 0; k < size[i] && !failed; k++) {
                double value = 0.0;
                failed = supi_volume_real(r, &value);
                if (!failed && at != 0xffffffffu) v->fields[first + i].values[size[i] * at + k] = (float)value;
            }
        }
    }
    SUP_FREE(size);
    return failed;
}

SUP_FN int supi_read_ucd_body(supi_volume_reader *r, supi_ids *points, supi_ids *cells) {
    size_t count[2] = {0, 0};
    int64_t node_data = 0, cell_data = 0, model_data = 0;
    supi_ucd_skip(r);
    if (supi_volume_count(r, 8, &count[0]) || supi_volume_count(r, 7, &count[1]) || supi_volume_int(r, &node_data) ||
        supi_volume_int(r, &cell_data) || supi_volume_int(r, &model_data))
        return 1;
    if (supi_ucd_points(r, count[0], points) || supi_ucd_cells(r, count[1], points, cells)) return 1;
    if (node_data > 0 && supi_ucd_data(r, count[0], points, 0)) return 1;
    if (cell_data > 0 && supi_ucd_data(r, count[1], cells, 1)) return 1;
    return 0;
}

SUP_FN int supi_read_ucd(supi_volume_reader *r) {
    supi_ids points, cells;
    int failed;
    memset(&points, 0, sizeof points);
    memset(&cells, 0, sizeof cells);
    if ((unsigned char)*r->text.at == 7) return sup_fail(r->err, "%s: binary UCD files are not read", r->name);
    failed = supi_read_ucd_body(r, &points, &cells);
    SUP_FREE(points.list);
    SUP_FREE(cells.list);
    return failed;
}

#endif
