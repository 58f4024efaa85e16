/* volume_gmsh.h - Gmsh reader (versions 2.2 and 4.1, text); included by volume.h
   SPDX-License-Identifier: MIT OR Unlicense */
#ifndef SUP_VOLUME_GMSH_H
#define SUP_VOLUME_GMSH_H

#ifndef SUP_VOLUME_H
#error "include volume.h instead"
#endif

/* Kinds of elements: nodes, and as what they are read (0: no volume). */
typedef struct supi_gmsh_kind {
    uint8_t type, nodes, shape, curved;
} supi_gmsh_kind;

SUP_FN const supi_gmsh_kind *supi_gmsh_find(int64_t type) {
    static const supi_gmsh_kind kinds[] = {
        {1, 2, 0, 0},   {2, 3, 0, 0},    {3, 4, 0, 0},    {4, 4, SUP_TETRA, 0},       {5, 8, SUP_HEXAHEDRON, 0},
        {6, 6, SUP_WEDGE, 0},            {7, 5, SUP_PYRAMID, 0},                      {8, 3, 0, 0},
        {9, 6, 0, 0},   {10, 9, 0, 0},   {11, 10, SUP_TETRA, 1},                      {12, 27, SUP_HEXAHEDRON, 1},
        {13, 18, SUP_WEDGE, 1},          {14, 14, SUP_PYRAMID, 1},                    {15, 1, 0, 0},
        {16, 8, 0, 0},  {17, 20, SUP_HEXAHEDRON, 1},      {18, 15, SUP_WEDGE, 1},     {19, 13, SUP_PYRAMID, 1},
        {20, 9, 0, 0},  {21, 10, 0, 0},  {22, 12, 0, 0},  {23, 15, 0, 0},             {24, 15, 0, 0},
        {25, 21, 0, 0}, {26, 4, 0, 0},   {27, 5, 0, 0},   {28, 6, 0, 0},              {29, 20, SUP_TETRA, 1},
        {30, 35, SUP_TETRA, 1},          {31, 56, SUP_TETRA, 1}};
    size_t i;
    for (i = 0; i < sizeof kinds / sizeof kinds[0]; i++)
        if (kinds[i].type == type) return kinds + i;
    return NULL;
}

typedef struct supi_gmsh {
    supi_volume_reader *r;
    supi_ids nodes, cells;
    size_t node_capacity, point_capacity, cell_capacity;
    int version; /* 2 or 4 */
    int has_nodes, has_elements;
} supi_gmsh;

SUP_FN int supi_gmsh_add_node(supi_gmsh *g, int64_t id, const double p[3]) {
    sup_volume *v = g->r->out;
    void *grown = sup_grow(g->nodes.list, &g->node_capacity, g->nodes.count + 1, sizeof *g->nodes.list);
    if (!grown) return supi_volume_memory(g->r);
    g->nodes.list = (supi_id *)grown;
    grown = sup_grow(v->points, &g->point_capacity, v->point_count + 1, 3 * sizeof(double));
    if (!grown) return supi_volume_memory(g->r);
    v->points = (double *)grown;
    g->nodes.list[g->nodes.count].id = id;
    g->nodes.list[g->nodes.count].index = (uint32_t)v->point_count;
    g->nodes.count++;
    memcpy(v->points + 3 * v->point_count++, p, 3 * sizeof(double));
    return 0;
}

SUP_FN int supi_gmsh_nodes(supi_gmsh *g) {
    supi_volume_reader *r = g->r;
    size_t blocks = 1, count = 0, b, i, k;
    int64_t ignored = 0, parametric = 0, twice = 0, dimension = 0;
    double p[3] = {0.0, 0.0, 0.0}, extra;
    if (g->version == 4) {
        if (supi_volume_count(r, 2, &blocks) || supi_volume_count(r, 2, &count) || supi_volume_int(r, &ignored) ||
            supi_volume_int(r, &ignored))
            return 1;
    }
    for (b = 0; b < blocks; b++) {
        size_t first = g->nodes.count;
        if (g->version == 4 && (supi_volume_int(r, &dimension) || supi_volume_int(r, &ignored) ||
                                supi_volume_int(r, &parametric)))
            return 1;
        if (supi_volume_count(r, 2, &count)) return 1;
        if (g->version == 4) { /* all numbers, then all points */
            int64_t id = 0;
            for (i = 0; i < count; i++)
                if (supi_volume_int(r, &id) || supi_gmsh_add_node(g, id, p)) return 1;
        }
        for (i = 0; i < count; i++) {
            int64_t id = 0;
            if (g->version == 2 && supi_volume_int(r, &id)) return 1;
            for (k = 0; k < 3; k++)
                if (supi_volume_real(r, p + k)) return 1;
            for (k = 0; parametric != 0 && k < (size_t)(dimension < 0 ? 0 : dimension > 3 ? 3 : dimension); k++)
                if (supi_volume_real(r, &extra)) return 1;
            if (g->version == 2) {
                if (supi_gmsh_add_node(g, id, p)) return 1;
            } else {
                memcpy(r->out->points + 3 * (first + i), p, sizeof p);
            }
        }
    }
    if (supi_ids_sort(&g->nodes, &twice)) return sup_fail(r->err, "%s: node %ld is there twice", r->name, (long)twice);
    return 0;
}

/* One element: its nodes follow. */
SUP_FN int supi_gmsh_element(supi_gmsh *g, int64_t id, int64_t type) {
    supi_volume_reader *r = g->r;
    const supi_gmsh_kind *kind = supi_gmsh_find(type);
    uint32_t corner[8] = {0, 0, 0, 0, 0, 0, 0, 0};
    const size_t corners = kind ? sup_shape_corners(kind->shape) : 0;
    int64_t number = 0;
    size_t k;
    if (!kind) return supi_volume_fail(r, "an unknown type of element");
    for (k = 0; k < kind->nodes; k++) {
        if (supi_volume_int(r, &number)) return 1;
        if (k >= corners) continue;
        corner[k] = supi_ids_find(&g->nodes, number);
        if (corner[k] == 0xffffffffu) return supi_volume_fail(r, "an element has a node that does not exist");
    }
    if (corners == 0) {
        r->out->skipped_cells++;
        return 0;
    }
    r->out->straightened += kind->curved;
    {
        void *grown = sup_grow(g->cells.list, &g->cell_capacity, g->cells.count + 1, sizeof *g->cells.list);
        if (!grown) return supi_volume_memory(r);
        g->cells.list = (supi_id *)grown;
        g->cells.list[g->cells.count].id = id;
        g->cells.list[g->cells.count].index = (uint32_t)g->cells.count;
        g->cells.count++;
    }
    return supi_volume_add_cell(r, kind->shape, corner, corners);
}

SUP_FN int supi_gmsh_elements(supi_gmsh *g) {
    supi_volume_reader *r = g->r;
    size_t blocks = 1, count = 0, b, i, k;
    int64_t ignored = 0, id = 0, type = 0, twice = 0;
    size_t tags = 0;
    if (g->version == 4 && (supi_volume_count(r, 2, &blocks) || supi_volume_count(r, 2, &count) ||
                            supi_volume_int(r, &ignored) || supi_volume_int(r, &ignored)))
        return 1;
    for (b = 0; b < blocks; b++) {
        if (g->version == 4 && (supi_volume_int(r, &ignored) || supi_volume_int(r, &ignored) ||
                                supi_volume_int(r, &type)))
            return 1;
        if (supi_volume_count(r, 2, &count)) return 1;
        for (i = 0; i < count; i++) {
            if (supi_volume_int(r, &id)) return 1;
            if (g->version == 2) {
                if (supi_volume_int(r, &type) || supi_volume_count(r, 1, &tags)) return 1;
                for (k = 0; k < tags; k++)
                    if (supi_volume_int(r, &ignored)) return 1;
            }
            if (supi_gmsh_element(g, id, type)) return 1;
        }
    }
    if (supi_ids_sort(&g->cells, &twice))
        return sup_fail(r->err, "%s: element %ld is there twice", r->name, (long)twice);
    return 0;
}

/* Values of nodes or elements; those that a view does not name stay NaN: cells around them show nothing. */
SUP_FN int supi_gmsh_data(supi_gmsh *g, int per_cell) {
    supi_volume_reader *r = g->r;
    const supi_ids *ids = per_cell ? &g->cells : &g->nodes;
    const char *name = "", *word;
    size_t tags = 0, length = 0, i, k, count = 0, components = 0;
    int64_t number[3] = {0, 1, 0}, id = 0;
    double value = 0.0;
    float *values;
    if (!g->has_nodes || (per_cell && !g->has_elements)) /* they say how many there have to be */
        return supi_volume_fail(r, "nodes and elements have to come before the values");
    if (supi_volume_count(r, 1, &tags)) return 1;
    for (i = 0; i < tags; i++) { /* "name" */
        sup_text_skip_space(&r->text);
        if (r->text.at == r->text.end || *r->text.at != '"') return supi_volume_fail(r, "a name in quotes was expected");
        for (word = ++r->text.at; r->text.at < r->text.end && *r->text.at != '"'; r->text.at++) {}
        if (r->text.at == r->text.end) return supi_volume_fail(r, "a name has no end");
        if (i == 0) {
            name = word;
            length = (size_t)(r->text.at - word);
        }
        r->text.at++;
    }
    if (supi_volume_count(r, 1, &tags)) return 1;
    for (i = 0; i < tags; i++)
        if (supi_volume_real(r, &value)) return 1;
    if (supi_volume_count(r, 1, &tags)) return 1;
    for (i = 0; i < tags; i++) { /* time step, components, how many */
        if (supi_volume_int(r, &id)) return 1;
        if (i < 3) number[i] = id;
    }
    if (number[1] < 1 || number[1] > 64) return supi_volume_fail(r, "1 to 64 components were expected");
    if (number[2] < 0 || (uint64_t)number[2] > (uint64_t)(r->text.end - r->text.at) / 2 + 1)
        return supi_volume_fail(r, "more is announced than the file can hold");
    components = (size_t)number[1];
    count = (size_t)number[2];
    values = sup_volume_add_field(r->out, name, length, (uint32_t)components, per_cell, ids->count);
    if (!values) return supi_volume_memory(r);
    for (i = 0; i < ids->count * components; i++) values[i] = (float)NAN;
    for (i = 0; i < count; i++) {
        uint32_t at;
        if (supi_volume_int(r, &id)) return 1;
        at = supi_ids_find(ids, id);
        if (at == 0xffffffffu && !(per_cell && r->out->skipped_cells))
            return supi_volume_fail(r, "values of a node or element that does not exist");
        for (k = 0; k < components; k++) {
            if (supi_volume_real(r, &value)) return 1;
            if (at != 0xffffffffu) values[components * at + k] = (float)value;
        }
    }
    return 0;
}

SUP_FN int supi_gmsh_sections(supi_gmsh *g) {
    supi_volume_reader *r = g->r;
    sup_text *t = &r->text;
    for (;;) {
        const char *word, *end;
        size_t length;
        int failed = 0;
        sup_text_skip_space(t);
        if (t->at == t->end) break;
        if (*t->at != '$') return supi_volume_fail(r, "a section ($Nodes, ...) was expected");
        length = supi_volume_word(r, &word);
        if (supi_word_is(word, length, "$nodes")) {
            if (g->has_nodes++) return supi_volume_fail(r, "$Nodes is there twice");
            failed = supi_gmsh_nodes(g);
        } else if (supi_word_is(word, length, "$elements")) {
            if (g->has_elements++) return supi_volume_fail(r, "$Elements is there twice");
            failed = supi_gmsh_elements(g);
        } else if (supi_word_is(word, length, "$nodedata")) {
            failed = supi_gmsh_data(g, 0);
        } else if (supi_word_is(word, length, "$elementdata")) {
            failed = supi_gmsh_data(g, 1);
        } else { /* not for us: on to its end */
            while (t->at < t->end && *t->at != '$') t->at++;
        }
        if (failed) return 1;
        sup_text_skip_space(t);
        end = t->at;
        length = supi_volume_word(r, &word);
        if (length < 4 || !supi_word_is(word, 4, "$end")) {
            t->at = end;
            return supi_volume_fail(r, "the end of a section was expected");
        }
    }
    if (!g->has_nodes || !g->has_elements) return sup_fail(r->err, "%s: no $Nodes or no $Elements", r->name);
    return 0;
}

SUP_FN int supi_read_gmsh(supi_volume_reader *r) {
    supi_gmsh g;
    double version = 0.0;
    int64_t binary = 0;
    int failed;
    memset(&g, 0, sizeof g);
    g.r = r;
    sup_text_skip_line(&r->text);
    if (supi_volume_real(r, &version) || supi_volume_int(r, &binary)) return 1;
    if (binary != 0) return supi_volume_fail(r, "binary Gmsh files are not read; save as text");
    if (version >= 2.0 && version < 3.0) g.version = 2;
    else if (version >= 4.1 && version < 5.0) g.version = 4;
    else return supi_volume_fail(r, "a version other than 2.x and 4.1");
    sup_text_skip_line(&r->text);
    sup_text_skip_line(&r->text); /* $EndMeshFormat */
    failed = supi_gmsh_sections(&g);
    SUP_FREE(g.nodes.list);
    SUP_FREE(g.cells.list);
    return failed;
}

#endif
