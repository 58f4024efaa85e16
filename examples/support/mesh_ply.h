/* mesh_ply.h - PLY reader: text, binary little-endian and big-endian; a writer of text; included by mesh.h
   SPDX-License-Identifier: MIT OR Unlicense */
#ifndef SUP_MESH_PLY_H
#define SUP_MESH_PLY_H

#ifndef SUP_MESH_H
#error "include mesh.h instead"
#endif

typedef enum supi_ply_type {
    SUPI_I8,
    SUPI_U8,
    SUPI_I16,
    SUPI_U16,
    SUPI_I32,
    SUPI_U32,
    SUPI_F32,
    SUPI_F64,
    SUPI_NO_TYPE
} supi_ply_type;

/* What a property means to us. X..NZ and RED..BLUE are also places in an array of values. */
typedef enum supi_ply_role {
    SUPI_X,
    SUPI_Y,
    SUPI_Z,
    SUPI_NX,
    SUPI_NY,
    SUPI_NZ,
    SUPI_RED,
    SUPI_GREEN,
    SUPI_BLUE,
    SUPI_ROLE_VALUES,
    SUPI_INDICES,
    SUPI_IGNORED
} supi_ply_role;

typedef struct supi_ply_property {
    supi_ply_type type, count_type; /* count_type: NO_TYPE unless it is a list */
    supi_ply_role role;
} supi_ply_property;

typedef enum supi_ply_kind { SUPI_VERTEX, SUPI_FACE, SUPI_STRIPS, SUPI_OTHER } supi_ply_kind;

typedef struct supi_ply_element {
    supi_ply_kind kind;
    uint64_t count;
    size_t first, properties; /* in the array of all properties */
    uint32_t roles;           /* bits of those that have been given */
    const char *body;         /* where its data begins, once known */
} supi_ply_element;

typedef struct supi_ply {
    sup_text text;
    const char *name;
    sup_error *err;
    int binary, big_endian;
    supi_ply_element *elements;
    supi_ply_property *properties;
    size_t element_count, element_capacity, property_count, property_capacity;
    uint32_t *corners;
    size_t corner_capacity;
    supi_faces faces;
    sup_mesh *mesh;
    int have_vertices;
} supi_ply;

SUP_FN size_t supi_ply_size(supi_ply_type type) {
    static const uint8_t sizes[9] = {1, 1, 2, 2, 4, 4, 4, 8, 0};
    return sizes[type];
}

/* An error at the reading position: by line in a text, by byte in binary data. */
SUP_FN int supi_ply_fail(const supi_ply *ply, const char *what) {
    const int in_text = !ply->binary || !ply->elements || !ply->elements[0].body;
    if (in_text)
        return sup_fail(ply->err, "%s: line %lu: %s", ply->name, (unsigned long)sup_text_line(&ply->text, ply->text.at),
                        what);
    return sup_fail(ply->err, "%s: byte %lu: %s", ply->name, (unsigned long)(ply->text.at - ply->text.begin), what);
}

/* ---- header ------------------------------------------------------------------------------------------------- */

/* The next word of the line, at most to `end`; its length is 0 at the end of the line. */
SUP_FN size_t supi_ply_word(const char **at, const char *end, const char **word) {
    while (*at < end && supi_is_blank(**at)) ++*at;
    *word = *at;
    while (*at < end && !supi_is_space(**at)) ++*at;
    return (size_t)(*at - *word);
}

SUP_FN int supi_ply_same(const char *word, size_t length, const char *name) {
    return strlen(name) == length && memcmp(word, name, length) == 0;
}

SUP_FN supi_ply_type supi_ply_parse_type(const char *word, size_t length) {
    static const char names[16][8] = {"char", "int8",  "uchar", "uint8",  "short", "int16",   "ushort", "uint16",
                                      "int",  "int32", "uint",  "uint32", "float", "float32", "double", "float64"};
    size_t i;
    for (i = 0; i < 16; i++) {
        if (supi_ply_same(word, length, names[i])) return (supi_ply_type)(i / 2);
    }
    return SUPI_NO_TYPE;
}

SUP_FN supi_ply_role supi_ply_parse_role(supi_ply_kind kind, int is_list, const char *word, size_t length) {
    static const char names[9][6] = {"x", "y", "z", "nx", "ny", "nz", "red", "green", "blue"};
    size_t i;
    if (is_list) {
        const int indices = supi_ply_same(word, length, "vertex_indices") ||
                            supi_ply_same(word, length, "vertex_index");
        return indices && (kind == SUPI_FACE || kind == SUPI_STRIPS) ? SUPI_INDICES : SUPI_IGNORED;
    }
    if (kind != SUPI_VERTEX && kind != SUPI_FACE) return SUPI_IGNORED;
    if (length > 8 && memcmp(word, "diffuse_", 8) == 0) {
        word += 8;
        length -= 8;
    }
    for (i = 0; i < 9; i++) {
        if (supi_ply_same(word, length, names[i])) {
            return kind == SUPI_FACE && i < (size_t)SUPI_RED ? SUPI_IGNORED : (supi_ply_role)i;
        }
    }
    return SUPI_IGNORED;
}

SUP_FN int supi_ply_header_element(supi_ply *ply, const char **at, const char *end) {
    supi_ply_element *element;
    const char *word;
    size_t length = supi_ply_word(at, end, &word), i;
    int64_t count;
    void *grown = sup_grow(ply->elements, &ply->element_capacity, ply->element_count + 1, sizeof *ply->elements);
    if (!grown) return sup_fail(ply->err, "%s: out of memory", ply->name);
    ply->elements = (supi_ply_element *)grown;
    element = ply->elements + ply->element_count;
    memset(element, 0, sizeof *element);
    element->kind = supi_ply_same(word, length, "vertex")      ? SUPI_VERTEX
                    : supi_ply_same(word, length, "face")      ? SUPI_FACE
                    : supi_ply_same(word, length, "tristrips") ? SUPI_STRIPS
                                                               : SUPI_OTHER;
    element->first = ply->property_count;
    while (*at < end && supi_is_blank(**at)) ++*at;
    if (length == 0 || sup_parse_int(at, end, &count) || count < 0)
        return supi_ply_fail(ply, "element needs a name and a count");
    for (i = 0; element->kind != SUPI_OTHER && i < ply->element_count; i++) {
        if (ply->elements[i].kind == element->kind)
            return supi_ply_fail(ply, "an element is declared twice");
    }
    element->count = (uint64_t)count;
    ply->element_count++;
    return 0;
}

SUP_FN int supi_ply_header_property(supi_ply *ply, const char **at, const char *end) {
    supi_ply_element *element;
    supi_ply_property property;
    const char *word;
    size_t length;
    void *grown;
    if (ply->element_count == 0) return supi_ply_fail(ply, "property before the first element");
    element = ply->elements + ply->element_count - 1;
    property.count_type = SUPI_NO_TYPE;
    length = supi_ply_word(at, end, &word);
    if (supi_ply_same(word, length, "list")) {
        length = supi_ply_word(at, end, &word);
        property.count_type = supi_ply_parse_type(word, length);
        if (property.count_type == SUPI_NO_TYPE) return supi_ply_fail(ply, "unknown type of a list's count");
        if (property.count_type >= SUPI_F32) return supi_ply_fail(ply, "a list's count must be a whole number");
        length = supi_ply_word(at, end, &word);
    }
    property.type = supi_ply_parse_type(word, length);
    if (property.type == SUPI_NO_TYPE) return supi_ply_fail(ply, "unknown type of a property");
    length = supi_ply_word(at, end, &word);
    if (length == 0) return supi_ply_fail(ply, "a property needs a name");
    property.role = supi_ply_parse_role(element->kind, property.count_type != SUPI_NO_TYPE, word, length);
    if (element->roles >> property.role & 1u) property.role = SUPI_IGNORED; /* the first of two with one name counts */
    element->roles |= 1u << property.role;
    grown = sup_grow(ply->properties, &ply->property_capacity, ply->property_count + 1, sizeof property);
    if (!grown) return sup_fail(ply->err, "%s: out of memory", ply->name);
    ply->properties = (supi_ply_property *)grown;
    ply->properties[ply->property_count++] = property;
    element->properties++;
    return 0;
}

SUP_FN int supi_ply_header(supi_ply *ply) {
    sup_text *text = &ply->text;
    const char *mark;
    int has_format = 0, lone_cr;
    if (text->end - text->at < 4 || memcmp(text->at, "ply", 3) != 0 || !supi_is_space(text->at[3]))
        return supi_ply_fail(ply, "not a PLY file");
    for (mark = text->at + 3; mark < text->end && *mark != '\n' && *mark != '\r'; mark++) {}
    /* When lines end with CR alone, an LF behind the last CR is data. */
    lone_cr = mark < text->end && *mark == '\r' && !(mark + 1 < text->end && mark[1] == '\n');
    for (;;) {
        const char *at, *end, *word;
        size_t length;
        int failed = 0;
        while (text->at < text->end && *text->at != '\n' && *text->at != '\r') text->at++;
        if (text->at == text->end) return supi_ply_fail(ply, "the header is cut off: no end_header");
        if (*text->at == '\r' && !lone_cr && text->at + 1 < text->end && text->at[1] == '\n') text->at++;
        text->at++;
        at = text->at;
        for (end = at; end < text->end && *end != '\n' && *end != '\r'; end++) {}
        length = supi_ply_word(&at, end, &word);
        if (supi_ply_same(word, length, "format")) {
            length = supi_ply_word(&at, end, &word);
            ply->big_endian = supi_ply_same(word, length, "binary_big_endian");
            ply->binary = ply->big_endian || supi_ply_same(word, length, "binary_little_endian");
            if (!ply->binary && !supi_ply_same(word, length, "ascii")) failed = supi_ply_fail(ply, "unknown format");
            has_format = 1;
        } else if (supi_ply_same(word, length, "element")) {
            failed = supi_ply_header_element(ply, &at, end);
        } else if (supi_ply_same(word, length, "property")) {
            failed = supi_ply_header_property(ply, &at, end);
        } else if (supi_ply_same(word, length, "end_header")) {
            break;
        } else if (length != 0 && !supi_ply_same(word, length, "comment") && !supi_ply_same(word, length, "obj_info")) {
            failed = supi_ply_fail(ply, "unknown word in the header");
        }
        if (failed) return 1;
    }
    if (!has_format) return supi_ply_fail(ply, "the header has no format line");
    while (text->at < text->end && *text->at != '\n' && *text->at != '\r') text->at++;
    if (text->at < text->end && *text->at == '\r' && !lone_cr && text->at + 1 < text->end && text->at[1] == '\n')
        text->at++;
    if (text->at < text->end) text->at++;
    return 0;
}

/* ---- body --------------------------------------------------------------------------------------------------- */

SUP_FN int supi_ply_value(supi_ply *ply, supi_ply_type type, double *out) {
    sup_text *text = &ply->text;
    uint8_t bytes[8] = {0, 0, 0, 0, 0, 0, 0, 0};
    const size_t size = supi_ply_size(type);
    uint64_t bits = 0;
    size_t i;
    if (!ply->binary) {
        sup_text_skip_space(text);
        if (!sup_parse_double(&text->at, text->end, out)) return 0;
        return supi_ply_fail(ply, text->at == text->end ? "the file ends too early" : "a number was expected");
    }
    if ((size_t)(text->end - text->at) < size) return supi_ply_fail(ply, "the file ends too early");
    memcpy(bytes, text->at, size);
    text->at += size;
    for (i = 0; i < size; i++) bits |= (uint64_t)bytes[i] << (8 * (ply->big_endian ? size - 1 - i : i));
    switch (type) {
    case SUPI_I8: *out = (double)(bits < 0x80 ? (int)bits : (int)bits - 0x100); break;
    case SUPI_I16: *out = (double)(bits < 0x8000 ? (int)bits : (int)bits - 0x10000); break;
    case SUPI_I32: *out = (double)(bits < 0x80000000u ? (int64_t)bits : (int64_t)bits - INT64_C(0x100000000)); break;
    case SUPI_F32: {
        const uint32_t word = (uint32_t)bits;
        float value;
        memcpy(&value, &word, sizeof value);
        *out = (double)value;
        break;
    }
    case SUPI_F64: memcpy(out, &bits, sizeof bits); break;
    case SUPI_U8:
    case SUPI_U16:
    case SUPI_U32:
    case SUPI_NO_TYPE:
    default: *out = (double)bits; break;
    }
    return 0;
}

/* Pass over `count` values of one type. In a text any word is a value here: nobody looks at it. */
SUP_FN int supi_ply_skip(supi_ply *ply, supi_ply_type type, uint64_t count) {
    sup_text *text = &ply->text;
    if (ply->binary) {
        const size_t size = supi_ply_size(type);
        if (count > (uint64_t)(text->end - text->at) / size) return supi_ply_fail(ply, "the file ends too early");
        text->at += (size_t)count * size;
        return 0;
    }
    for (; count > 0; count--) {
        sup_text_skip_space(text);
        if (text->at == text->end) return supi_ply_fail(ply, "the file ends too early");
        while (text->at < text->end && !supi_is_space(*text->at)) text->at++;
    }
    return 0;
}

/* The count before a list. A list longer than the rest of the file is an error before anything is allocated for it. */
SUP_FN int supi_ply_count(supi_ply *ply, const supi_ply_property *property, uint64_t *out) {
    double value = 0.0;
    const size_t least = ply->binary ? supi_ply_size(property->type) : 1;
    if (supi_ply_value(ply, property->count_type, &value)) return 1;
    if (!(value >= 0.0) || value != floor(value)) return supi_ply_fail(ply, "a list has a count that is no count");
    if (value > (double)(size_t)(ply->text.end - ply->text.at) / (double)least)
        return supi_ply_fail(ply, "a list is longer than the file");
    *out = (uint64_t)value;
    return 0;
}

SUP_FN uint8_t supi_ply_colour(double value, supi_ply_type type) {
    if (type >= SUPI_F32) return sup_unit_to_byte(value);
    return sup_unit_to_byte(value / (type == SUPI_U16 ? 65535.0 : 255.0));
}

SUP_FN int supi_ply_vertices(supi_ply *ply, const supi_ply_element *element) {
    sup_mesh *mesh = ply->mesh;
    const supi_ply_property *properties = ply->properties + element->first;
    supi_ply_type types[SUPI_ROLE_VALUES];
    double value[SUPI_ROLE_VALUES];
    size_t i, k, count;
    int has_normals, has_colours;
    for (k = 0; k < (size_t)SUPI_ROLE_VALUES; k++) {
        types[k] = SUPI_NO_TYPE;
        value[k] = 0.0;
    }
    for (k = 0; k < element->properties; k++) {
        if (properties[k].role < SUPI_ROLE_VALUES) types[properties[k].role] = properties[k].type;
    }
    if (types[SUPI_X] == SUPI_NO_TYPE || types[SUPI_Y] == SUPI_NO_TYPE || types[SUPI_Z] == SUPI_NO_TYPE)
        return supi_ply_fail(ply, "the vertices have no x, y, z");
    if (element->count > 0xfffffffeu) return supi_ply_fail(ply, "more vertices than 32-bit indices can name");
    has_normals = types[SUPI_NX] != SUPI_NO_TYPE && types[SUPI_NY] != SUPI_NO_TYPE && types[SUPI_NZ] != SUPI_NO_TYPE;
    has_colours = types[SUPI_RED] != SUPI_NO_TYPE && types[SUPI_GREEN] != SUPI_NO_TYPE &&
                  types[SUPI_BLUE] != SUPI_NO_TYPE;
    count = (size_t)element->count; /* supi_ply_element_fits has compared it with the file */
    mesh->positions = (float *)sup_alloc(count, 3 * sizeof(float));
    if (has_normals) mesh->normals = (float *)sup_alloc(count, 3 * sizeof(float));
    if (has_colours) mesh->vertex_rgb = (uint8_t *)sup_alloc(count, 3);
    if (!mesh->positions || (has_normals && !mesh->normals) || (has_colours && !mesh->vertex_rgb))
        return sup_fail(ply->err, "%s: out of memory", ply->name);
    for (i = 0; i < count; i++) {
        for (k = 0; k < element->properties; k++) {
            const supi_ply_property *property = properties + k;
            uint64_t items = 1;
            if (property->count_type != SUPI_NO_TYPE && supi_ply_count(ply, property, &items)) return 1;
            if (property->role < SUPI_ROLE_VALUES ? supi_ply_value(ply, property->type, value + property->role)
                                                  : supi_ply_skip(ply, property->type, items))
                return 1;
        }
        for (k = 0; k < 3; k++) {
            mesh->positions[3 * i + k] = sup_to_float(value[k]);
            if (has_normals) mesh->normals[3 * i + k] = sup_to_float(value[(size_t)SUPI_NX + k]);
            if (has_colours)
                mesh->vertex_rgb[3 * i + k] = supi_ply_colour(value[(size_t)SUPI_RED + k], types[(size_t)SUPI_RED + k]);
        }
    }
    mesh->vertex_count = count;
    ply->have_vertices = 1;
    return 0;
}

SUP_FN int supi_ply_bad_index(const supi_ply *ply, uint64_t face, double index) {
    char what[128];
    (void)snprintf(what, sizeof what, "face %lu: index %.0f out of range, there are %lu vertices", (unsigned long)face,
                   index, (unsigned long)ply->mesh->vertex_count);
    return supi_ply_fail(ply, what);
}

/* Strips: each corner makes a triangle with the two before it, every second one turned; -1 begins a new strip. */
SUP_FN int supi_ply_add_strip(supi_ply *ply, size_t n) {
    size_t i, start = 0;
    for (i = 0; i < n; i++) {
        uint32_t t[3];
        const uint32_t *c = ply->corners + i;
        if (*c == 0xffffffffu) {
            start = i + 1;
            continue;
        }
        if (i < start + 2) continue;
        t[0] = c[-2];
        t[1] = (i - start) % 2 ? c[0] : c[-1];
        t[2] = (i - start) % 2 ? c[-1] : c[0];
        if (supi_add_polygon(&ply->faces, ply->mesh->positions, t, 3))
            return sup_fail(ply->err, "%s: out of memory", ply->name);
    }
    return 0;
}

SUP_FN int supi_ply_faces(supi_ply *ply, const supi_ply_element *element) {
    const supi_ply_property *properties = ply->properties + element->first;
    const double limit = (double)ply->mesh->vertex_count;
    int colours = 0;
    uint64_t f;
    size_t k, j;
    for (k = 0; k < element->properties; k++)
        colours += properties[k].role >= SUPI_RED && properties[k].role <= SUPI_BLUE;
    for (f = 0; f < element->count; f++) {
        uint8_t rgb[3] = {255, 255, 255};
        const size_t before = ply->faces.count;
        size_t n = 0;
        int has_list = 0;
        if (element->properties == 0) break;
        for (k = 0; k < element->properties; k++) {
            const supi_ply_property *property = properties + k;
            uint64_t items = 1;
            double value = 0.0;
            if (property->count_type != SUPI_NO_TYPE && supi_ply_count(ply, property, &items)) return 1;
            if (property->role == SUPI_INDICES) {
                void *grown = sup_grow(ply->corners, &ply->corner_capacity, (size_t)items, sizeof *ply->corners);
                if (!grown) return sup_fail(ply->err, "%s: out of memory", ply->name);
                ply->corners = (uint32_t *)grown;
                has_list = 1;
                n = (size_t)items;
                for (j = 0; j < n; j++) {
                    if (supi_ply_value(ply, property->type, &value)) return 1;
                    if (element->kind == SUPI_STRIPS && value == -1.0) {
                        ply->corners[j] = 0xffffffffu;
                        continue;
                    }
                    if (!(value >= 0.0 && value < limit)) return supi_ply_bad_index(ply, f, value);
                    ply->corners[j] = (uint32_t)value;
                }
            } else if (property->role >= SUPI_RED && property->role <= SUPI_BLUE) {
                if (supi_ply_value(ply, property->type, &value)) return 1;
                rgb[property->role - SUPI_RED] = supi_ply_colour(value, property->type);
            } else if (supi_ply_skip(ply, property->type, items)) {
                return 1;
            }
        }
        if (!has_list) continue;
        if (element->kind == SUPI_STRIPS) {
            if (supi_ply_add_strip(ply, n)) return 1;
        } else if (supi_add_polygon(&ply->faces, ply->mesh->positions, ply->corners, n) ||
                   (colours == 3 && ply->faces.count > before && supi_paint(&ply->faces, before, rgb))) {
            return sup_fail(ply->err, "%s: out of memory", ply->name);
        }
    }
    return 0;
}

SUP_FN int supi_ply_skip_element(supi_ply *ply, const supi_ply_element *element) {
    const supi_ply_property *properties = ply->properties + element->first;
    uint64_t i;
    size_t k;
    if (element->properties == 0) return 0;
    for (i = 0; i < element->count; i++) {
        for (k = 0; k < element->properties; k++) {
            uint64_t items = 1;
            if (properties[k].count_type != SUPI_NO_TYPE && supi_ply_count(ply, properties + k, &items)) return 1;
            if (supi_ply_skip(ply, properties[k].type, items)) return 1;
        }
    }
    return 0;
}

/* Compare the announced count with the bytes left: a number takes two bytes of text, or its size in binary. */
SUP_FN int supi_ply_element_fits(const supi_ply *ply, const supi_ply_element *element) {
    uint64_t least = 0;
    const uint64_t left = (uint64_t)(ply->text.end - ply->text.at) + (ply->binary ? 0 : 1);
    size_t k;
    for (k = 0; k < element->properties; k++) {
        const supi_ply_property *property = ply->properties + element->first + k;
        least += ply->binary
                     ? supi_ply_size(property->count_type != SUPI_NO_TYPE ? property->count_type : property->type)
                     : 2;
    }
    return least == 0 || element->count <= left / least;
}

SUP_FN int supi_ply_body(supi_ply *ply) {
    size_t e;
    int late_faces = 0;
    for (e = 0; e < ply->element_count; e++) {
        supi_ply_element *element = ply->elements + e;
        const int needs_vertices = element->kind == SUPI_FACE || element->kind == SUPI_STRIPS;
        element->body = ply->text.at;
        if (!supi_ply_element_fits(ply, element))
            return supi_ply_fail(ply, "more elements are announced than the file can hold");
        if (element->kind == SUPI_VERTEX) {
            if (supi_ply_vertices(ply, element)) return 1;
        } else if (needs_vertices && ply->have_vertices) {
            if (supi_ply_faces(ply, element)) return 1;
        } else {
            late_faces |= needs_vertices;
            if (supi_ply_skip_element(ply, element)) return 1;
        }
    }
    if (!ply->have_vertices) return supi_ply_fail(ply, "the file has no vertices");
    for (e = 0; late_faces && e < ply->element_count && ply->elements[e].kind != SUPI_VERTEX; e++) {
        if (ply->elements[e].kind != SUPI_FACE && ply->elements[e].kind != SUPI_STRIPS) continue;
        ply->text.at = ply->elements[e].body; /* these faces stand before the vertices: read them now */
        if (supi_ply_faces(ply, ply->elements + e)) return 1;
    }
    return 0;
}

SUP_FN int supi_read_ply(const sup_text *text, const char *name, sup_mesh *out, sup_error *err) {
    supi_ply ply;
    int failed;
    memset(&ply, 0, sizeof ply);
    ply.text = *text;
    ply.name = name;
    ply.err = err;
    ply.mesh = out;
    /* Never NULL, so that elements without properties may point into it. */
    ply.properties = (supi_ply_property *)sup_grow(NULL, &ply.property_capacity, 1, sizeof *ply.properties);
    failed = ply.properties ? supi_ply_header(&ply) || supi_ply_body(&ply) : sup_fail(err, "%s: out of memory", name);
    if (!failed) {
        supi_faces_finish(&ply.faces, out);
        if (out->triangle_count == 0)
            (void)sup_fail(err, "%s: there are %lu points but no triangles", name, (unsigned long)out->vertex_count);
    }
    supi_faces_free(&ply.faces);
    SUP_FREE(ply.elements);
    SUP_FREE(ply.properties);
    SUP_FREE(ply.corners);
    return failed;
}

/* Write positions, colours and triangles as text. m: NULL, or three rows of four that every point is taken through.
   Returns 0, or 1 with err->text set and no file. */
SUP_FN int sup_ply_write(const char *path, const sup_mesh *mesh, const double m[12], sup_error *err) {
    static const char colour[] = "property uchar red\nproperty uchar green\nproperty uchar blue\n";
    sup_file file;
    size_t i;
    if (sup_file_open(path, &file, err)) return 1;
    fprintf(file.stream, "ply\nformat ascii 1.0\nelement vertex %lu\nproperty float x\nproperty float y\nproperty float z\n%s",
            (unsigned long)mesh->vertex_count, mesh->vertex_rgb ? colour : "");
    fprintf(file.stream, "element face %lu\nproperty list uchar int vertex_indices\n%send_header\n", (unsigned long)mesh->triangle_count,
            mesh->triangle_rgb ? colour : "");
    for (i = 0; i < mesh->vertex_count; i++) {
        const float *p = mesh->positions + 3 * i;
        double q[3];
        int a;
        for (a = 0; a < 3; a++)
            q[a] = m ? m[4 * a] * (double)p[0] + m[4 * a + 1] * (double)p[1] + m[4 * a + 2] * (double)p[2] + m[4 * a + 3] : (double)p[a];
        fprintf(file.stream, "%.9g %.9g %.9g", q[0], q[1], q[2]);
        if (mesh->vertex_rgb) fprintf(file.stream, " %u %u %u", mesh->vertex_rgb[3 * i], mesh->vertex_rgb[3 * i + 1], mesh->vertex_rgb[3 * i + 2]);
        fputc('\n', file.stream);
    }
    for (i = 0; i < mesh->triangle_count; i++) {
        const uint32_t *t = mesh->indices + 3 * i;
        fprintf(file.stream, "3 %lu %lu %lu", (unsigned long)t[0], (unsigned long)t[1], (unsigned long)t[2]);
        if (mesh->triangle_rgb)
            fprintf(file.stream, " %u %u %u", mesh->triangle_rgb[3 * i], mesh->triangle_rgb[3 * i + 1], mesh->triangle_rgb[3 * i + 2]);
        fputc('\n', file.stream);
    }
    return sup_file_commit(&file, err);
}

#endif
