/* volume_vtk.h - VTK legacy reader (versions 1.0 to 5.1, text and binary); included by volume.h
   SPDX-License-Identifier: MIT OR Unlicense */
#ifndef SUP_VOLUME_VTK_H
#define SUP_VOLUME_VTK_H

#ifndef SUP_VOLUME_H
#error "include volume.h instead"
#endif

typedef enum supi_vtk_type { /* bytes of a number and whether it is signed or real */
    SUPI_VTK_NONE = 0, SUPI_VTK_BIT, SUPI_VTK_U8, SUPI_VTK_I8, SUPI_VTK_U16, SUPI_VTK_I16, SUPI_VTK_U32, SUPI_VTK_I32,
    SUPI_VTK_U64, SUPI_VTK_I64, SUPI_VTK_F32, SUPI_VTK_F64
} supi_vtk_type;

typedef struct supi_vtk {
    supi_volume_reader *r;
    int binary, major;
    int per_cell;        /* of the attributes that follow; -1: none began yet */
    size_t attributes;   /* how many points or cells they are for */
    /* CELLS as they stand in the file; kinds come later */
    int64_t *offsets;    /* of cell_count + 1 */
    int64_t *corners;
    size_t cells, corner_count;
    uint8_t *types;
    uint32_t *kept;      /* number of a cell of the file among those that are volumes; 0xffffffff: none of them */
    int listed;          /* the kind of DATASET: cells are listed; else it is a grid */
    int grid;            /* DIMENSIONS are known */
} supi_vtk;

SUP_FN supi_vtk_type supi_vtk_parse_type(const char *word, size_t n) {
    static const struct {
        char name[16];
        supi_vtk_type type;
    } names[] = {{"bit", SUPI_VTK_BIT},           {"unsigned_char", SUPI_VTK_U8}, {"char", SUPI_VTK_I8},
                 {"signed_char", SUPI_VTK_I8},    {"unsigned_short", SUPI_VTK_U16}, {"short", SUPI_VTK_I16},
                 {"unsigned_int", SUPI_VTK_U32},  {"int", SUPI_VTK_I32},          {"unsigned_long", SUPI_VTK_U64},
                 {"long", SUPI_VTK_I64},          {"vtkidtype", SUPI_VTK_I32},    {"vtktypeint64", SUPI_VTK_I64},
                 {"vtktypeuint64", SUPI_VTK_U64}, {"vtktypeint32", SUPI_VTK_I32}, {"float", SUPI_VTK_F32},
                 {"double", SUPI_VTK_F64}};
    size_t i;
    for (i = 0; i < sizeof names / sizeof names[0]; i++)
        if (supi_word_is(word, n, names[i].name)) return names[i].type;
    return SUPI_VTK_NONE;
}
SUP_FN size_t supi_vtk_size(supi_vtk_type type) {
    static const uint8_t size[12] = {0, 1, 1, 1, 2, 2, 4, 4, 8, 8, 4, 8};
    return size[type];
}

SUP_FN int supi_vtk_fail(supi_vtk *f, const char *what) {
    supi_volume_reader *r = f->r;
    if (!f->binary) return supi_volume_fail(r, what);
    return sup_fail(r->err, "%s: byte %lu: %s", r->name, (unsigned long)(r->text.at - r->text.begin),
                    r->text.at == r->text.end ? "the file ends too early" : what);
}

/* Behind the keyword's line: binary numbers begin right after its line feed. */
SUP_FN void supi_vtk_begin(supi_vtk *f) {
    sup_text *t = &f->r->text;
    if (f->binary) {
        while (t->at < t->end && *t->at != '\n') t->at++;
        if (t->at < t->end) t->at++;
    }
}
/* Are `count` numbers of that type there? A number of a text has two bytes at least. */
SUP_FN int supi_vtk_fits(supi_vtk *f, uint64_t count, supi_vtk_type type) {
    const uint64_t left = (uint64_t)(f->r->text.end - f->r->text.at);
    if (f->binary && type == SUPI_VTK_BIT) return (count + 7) / 8 <= left;
    return count <= left / (f->binary ? supi_vtk_size(type) : 2u) + (f->binary ? 0u : 1u);
}

/* The next number; binary ones are big-endian. bit is not for here. */
SUP_FN int supi_vtk_number(supi_vtk *f, supi_vtk_type type, double *out, int64_t *whole) {
    sup_text *t = &f->r->text;
    const size_t size = supi_vtk_size(type);
    uint64_t bits = 0;
    size_t i;
    if (!f->binary) {
        sup_text_skip_space(t);
        if (whole) {
            if (!sup_parse_int(&t->at, t->end, whole)) return 0;
            return supi_vtk_fail(f, "a whole number was expected");
        }
        if (!sup_parse_double(&t->at, t->end, out)) return 0;
        return supi_vtk_fail(f, "a number was expected");
    }
    if ((size_t)(t->end - t->at) < size) {
        t->at = t->end;
        return supi_vtk_fail(f, "");
    }
    for (i = 0; i < size; i++) bits = bits << 8 | (uint8_t)t->at[i];
    t->at += size;
    if (type == SUPI_VTK_F32 || type == SUPI_VTK_F64) {
        double value;
        if (type == SUPI_VTK_F32) {
            const uint32_t word = (uint32_t)bits;
            float single;
            memcpy(&single, &word, sizeof single);
            value = (double)single;
        } else {
            memcpy(&value, &bits, sizeof value);
        }
        if (out) *out = value;
        if (whole) *whole = value >= -9e15 && value <= 9e15 ? (int64_t)value : INT64_MIN;
        return 0;
    }
    if (type == SUPI_VTK_I8 || type == SUPI_VTK_I16 || type == SUPI_VTK_I32) {
        const uint64_t sign = (uint64_t)1 << (8 * size - 1);
        bits = (bits ^ sign) - sign;
    }
    if (out) {
        if (type == SUPI_VTK_U64) *out = (double)bits;
        else *out = bits >> 63 ? -(double)(0 - bits) : (double)bits;
    }
    if (whole) *whole = bits >> 63 && type == SUPI_VTK_U64 ? INT64_MAX :
                        bits >> 63 ? -(int64_t)(~bits) - 1 : (int64_t)bits;
    return 0;
}

/* `count` numbers into out (NULL: passed over). */
SUP_FN int supi_vtk_floats(supi_vtk *f, supi_vtk_type type, size_t count, float *out) {
    sup_text *t = &f->r->text;
    size_t i;
    double value = 0.0;
    if (f->binary && type == SUPI_VTK_BIT) {
        for (i = 0; out && i < count; i++) out[i] = (float)((uint8_t)t->at[i / 8] >> (7 - i % 8) & 1);
        t->at += (count + 7) / 8;
        return 0;
    }
    if (f->binary && !out) {
        t->at += count * supi_vtk_size(type);
        return 0;
    }
    for (i = 0; i < count; i++) {
        if (supi_vtk_number(f, type, &value, NULL)) return 1;
        if (out) out[i] = (float)value;
    }
    return 0;
}
SUP_FN int supi_vtk_doubles(supi_vtk *f, supi_vtk_type type, size_t count, double **out) {
    size_t i;
    if (type == SUPI_VTK_NONE || type == SUPI_VTK_BIT) return supi_vtk_fail(f, "unknown type of numbers");
    supi_vtk_begin(f);
    if (!supi_vtk_fits(f, count, type)) return supi_vtk_fail(f, "more numbers are announced than the file can hold");
    SUP_FREE(*out);
    *out = (double *)sup_alloc(count, sizeof(double));
    if (!*out) return supi_volume_memory(f->r);
    for (i = 0; i < count; i++)
        if (supi_vtk_number(f, type, *out + i, NULL)) return 1;
    return 0;
}

/* ---- cells -------------------------------------------------------------------------------------------------- */

SUP_FN int supi_vtk_whole_list(supi_vtk *f, supi_vtk_type type, size_t count, int64_t **out) {
    size_t i;
    if (type < SUPI_VTK_U8) return supi_vtk_fail(f, "unknown type of numbers");
    supi_vtk_begin(f);
    if (!supi_vtk_fits(f, count, type)) return supi_vtk_fail(f, "more numbers are announced than the file can hold");
    SUP_FREE(*out);
    *out = (int64_t *)sup_alloc(count, sizeof(int64_t));
    if (!*out) return supi_volume_memory(f->r);
    for (i = 0; i < count; i++)
        if (supi_vtk_number(f, type, NULL, *out + i)) return 1;
    return 0;
}

/* CELLS n size: counts and corners in turns; since 5.0: n + 1 offsets, then all corners. */
SUP_FN int supi_vtk_cells(supi_vtk *f) {
    supi_volume_reader *r = f->r;
    const char *word;
    size_t length, n = 0, total = 0, i, at;
    int64_t *list = NULL;
    if (supi_volume_count(r, 1, &n) || supi_volume_count(r, 1, &total)) return 1;
    if (f->offsets) return supi_vtk_fail(f, "CELLS is there twice");
    if (f->major >= 5) {
        if (n == 0) return supi_vtk_fail(f, "CELLS without the offset of its end");
        sup_text_skip_line(&r->text);
        length = supi_volume_word(r, &word);
        if (!supi_word_is(word, length, "offsets")) return supi_vtk_fail(f, "OFFSETS was expected");
        length = supi_volume_word(r, &word);
        if (supi_vtk_whole_list(f, supi_vtk_parse_type(word, length), n, &f->offsets)) return 1;
        sup_text_skip_space(&r->text);
        length = supi_volume_word(r, &word);
        if (!supi_word_is(word, length, "connectivity")) return supi_vtk_fail(f, "CONNECTIVITY was expected");
        length = supi_volume_word(r, &word);
        if (supi_vtk_whole_list(f, supi_vtk_parse_type(word, length), total, &f->corners)) return 1;
        f->cells = n - 1;
        f->corner_count = total;
    } else {
        if (supi_vtk_whole_list(f, SUPI_VTK_I32, total, &list)) {
            SUP_FREE(list);
            return 1;
        }
        f->corners = list;
        f->offsets = (int64_t *)sup_alloc(n + 1, sizeof(int64_t));
        if (!f->offsets) return supi_volume_memory(r);
        f->offsets[0] = 0;
        for (i = at = 0; i < n; i++) { /* squeeze the counts out */
            const int64_t corners = at < total ? list[at] : -1, first = f->offsets[i];
            if (corners < 0 || (uint64_t)corners > total - at - 1)
                return supi_vtk_fail(f, "CELLS is shorter than its counts say");
            memmove(list + first, list + at + 1, (size_t)corners * sizeof(int64_t));
            at += (size_t)corners + 1;
            f->offsets[i + 1] = first + corners;
        }
        if (at != total) return supi_vtk_fail(f, "CELLS is longer than its counts say");
        f->cells = n;
        f->corner_count = (size_t)f->offsets[n];
    }
    for (i = 0; i < f->cells; i++)
        if (f->offsets[i] < 0 || f->offsets[i + 1] < f->offsets[i] || (uint64_t)f->offsets[i + 1] > f->corner_count)
            return sup_fail(r->err, "%s: the offset of cell %lu is out of range", r->name, (unsigned long)i);
    return 0;
}

/* CELL_TYPES n: now the cells are known. */
SUP_FN int supi_vtk_cell_types(supi_vtk *f) {
    supi_volume_reader *r = f->r;
    int64_t *types = NULL;
    size_t n = 0, i, k;
    int failed = 0;
    if (supi_volume_count(r, 1, &n)) return 1;
    if (!f->offsets || n != f->cells || f->kept) return supi_vtk_fail(f, "CELL_TYPES does not fit to CELLS");
    f->kept = (uint32_t *)sup_alloc(n, sizeof *f->kept);
    if (!f->kept) return supi_volume_memory(r);
    failed = supi_vtk_whole_list(f, SUPI_VTK_I32, n, &types);
    for (i = 0; i < n && !failed; i++) {
        const int64_t type = types[i];
        /* 21 and up are curved: the first corners of each are those of its straight form */
        const int curved = type == 24 || type == 25 || type == 26 || type == 27 || type == 29 || type == 31 ||
                           type == 32 || type == 33 || type == 37 || type == 71 || type == 72 || type == 73 || type == 74;
        const int shape = type >= 10 && type <= 14                          ? (int)type
                          : type == 24 || type == 71                        ? SUP_TETRA
                          : type == 25 || type == 29 || type == 33 || type == 72 ? SUP_HEXAHEDRON
                          : type == 26 || type == 31 || type == 32 || type == 73 ? SUP_WEDGE
                          : type == 27 || type == 37 || type == 74          ? SUP_PYRAMID
                                                                            : 0;
        const size_t corners = sup_shape_corners(shape), given = (size_t)(f->offsets[i + 1] - f->offsets[i]);
        uint32_t corner[8];
        f->kept[i] = 0xffffffffu;
        if (corners == 0) {
            r->out->skipped_cells++;
            continue;
        }
        if (given < corners || (!curved && given != corners))
            failed = sup_fail(r->err, "%s: cell %lu has %lu points", r->name, (unsigned long)i, (unsigned long)given);
        for (k = 0; k < corners && !failed; k++) {
            const int64_t number = f->corners[(size_t)f->offsets[i] + k];
            if (number < 0 || (uint64_t)number >= r->out->point_count)
                failed = sup_fail(r->err, "%s: cell %lu has a point that does not exist", r->name, (unsigned long)i);
            else corner[k] = (uint32_t)number;
        }
        if (failed) break;
        r->out->straightened += (size_t)curved;
        f->kept[i] = (uint32_t)r->out->cell_count;
        failed = supi_volume_add_cell(r, shape, corner, corners);
    }
    SUP_FREE(types);
    return failed;
}

/* ---- attributes --------------------------------------------------------------------------------------------- */

/* Values of `tuples` things; those of cells that were skipped are taken out. */
SUP_FN int supi_vtk_values(supi_vtk *f, const char *name, size_t length, supi_vtk_type type, size_t components,
                           size_t tuples) {
    supi_volume_reader *r = f->r;
    sup_volume *v = r->out;
    char plain[64];
    size_t count, i, k, n = 0;
    const int usable = f->per_cell >= 0 && tuples == f->attributes && components > 0;
    float *values = NULL;
    if (type == SUPI_VTK_NONE) return supi_vtk_fail(f, "unknown type of numbers");
    supi_vtk_begin(f);
    if (sup_mul_size(components, tuples, &count) || !supi_vtk_fits(f, count, type))
        return supi_vtk_fail(f, "more numbers are announced than the file can hold");
    if (usable) {
        for (i = 0; i < length && n + 1 < sizeof plain; i++) { /* "%20" is a blank */
            int high = 0, low = 0;
            char c = name[i];
            if (c == '%' && i + 2 < length) {
                const char a = supi_lower(name[i + 1]), b = supi_lower(name[i + 2]);
                high = supi_is_digit(a) ? a - '0' : a >= 'a' && a <= 'f' ? a - 'a' + 10 : -1;
                low = supi_is_digit(b) ? b - '0' : b >= 'a' && b <= 'f' ? b - 'a' + 10 : -1;
                if (high >= 0 && low >= 0 && high + low > 0) {
                    c = (char)(high * 16 + low);
                    i += 2;
                }
            }
            plain[n++] = c;
        }
        values = sup_volume_add_field(v, plain, n, (uint32_t)components, f->per_cell, tuples);
        if (!values) return supi_volume_memory(r);
    }
    if (supi_vtk_floats(f, type, count, values)) return 1;
    if (values && f->per_cell && f->kept && r->out->skipped_cells) {
        for (i = 0; i < tuples; i++) { /* kept[i] <= i */
            if (f->kept[i] == 0xffffffffu) continue;
            for (k = 0; k < components; k++) values[components * f->kept[i] + k] = values[components * i + k];
        }
        v->fields[v->field_count - 1].count = v->cell_count;
    }
    return 0;
}

/* SCALARS name type [components], then LOOKUP_TABLE name; */
SUP_FN int supi_vtk_scalars(supi_vtk *f) {
    supi_volume_reader *r = f->r;
    const char *name, *word, *back;
    size_t length = supi_volume_word(r, &name), n = supi_volume_word(r, &word);
    const supi_vtk_type type = supi_vtk_parse_type(word, n);
    int64_t components = 1;
    while (r->text.at < r->text.end && supi_is_blank(*r->text.at)) r->text.at++;
    if (r->text.at < r->text.end && supi_is_digit(*r->text.at) && supi_volume_int(r, &components)) return 1;
    if (components < 1 || components > 64) return supi_vtk_fail(f, "1 to 64 components were expected");
    sup_text_skip_line(&r->text);
    back = r->text.at;
    n = supi_volume_word(r, &word);
    if (supi_word_is(word, n, "lookup_table")) (void)supi_volume_word(r, &word);
    else r->text.at = back - 1; /* numbers begin on this line */
    return supi_vtk_values(f, name, length, type, (size_t)components, f->attributes);
}

/* FIELD name arrays; each: name components tuples type */
SUP_FN int supi_vtk_field(supi_vtk *f) {
    supi_volume_reader *r = f->r;
    const char *name, *word;
    size_t length, n, arrays = 0, components = 0, tuples = 0, i;
    (void)supi_volume_word(r, &word);
    if (supi_volume_count(r, 1, &arrays)) return 1;
    for (i = 0; i < arrays; i++) {
        sup_text_skip_space(&r->text);
        length = supi_volume_word(r, &name);
        if (supi_word_is(name, length, "metadata")) { /* about the array before */
            while (r->text.at < r->text.end) {
                sup_text_skip_line(&r->text);
                if (r->text.at < r->text.end && (*r->text.at == '\n' || *r->text.at == '\r')) break;
            }
            i--;
            continue;
        }
        if (supi_volume_count(r, 1, &components) || supi_volume_count(r, 1, &tuples)) return 1;
        n = supi_volume_word(r, &word);
        if (supi_word_is(word, n, "string")) return supi_vtk_fail(f, "arrays of strings are not read");
        if (supi_vtk_values(f, name, length, supi_vtk_parse_type(word, n), components, tuples)) return 1;
    }
    return 0;
}

/* One keyword inside of POINT_DATA or CELL_DATA. -1: it is none of those. */
SUP_FN int supi_vtk_attribute(supi_vtk *f, const char *key, size_t n) {
    supi_volume_reader *r = f->r;
    static const struct {
        char name[16];
        size_t components;
    } fixed[] = {{"vectors", 3}, {"normals", 3}, {"tensors", 9}, {"tensors6", 6}, {"global_ids", 1},
                 {"pedigree_ids", 1}, {"edge_flags", 1}};
    const char *name, *word;
    size_t length, i, count = 0;
    if (supi_word_is(key, n, "field")) return supi_vtk_field(f);
    if (supi_word_is(key, n, "scalars")) return supi_vtk_scalars(f);
    if (supi_word_is(key, n, "lookup_table")) { /* colours: nobody asks for them here */
        (void)supi_volume_word(r, &name);
        if (supi_volume_count(r, 1, &count)) return 1;
        supi_vtk_begin(f);
        if (!supi_vtk_fits(f, 4 * (uint64_t)count, SUPI_VTK_U8)) return supi_vtk_fail(f, "LOOKUP_TABLE is cut off");
        return supi_vtk_floats(f, SUPI_VTK_U8, 4 * count, NULL);
    }
    if (supi_word_is(key, n, "color_scalars")) {
        length = supi_volume_word(r, &name);
        if (supi_volume_count(r, 1, &count)) return 1;
        if (count > 64) return supi_vtk_fail(f, "1 to 64 components were expected");
        return supi_vtk_values(f, name, length, f->binary ? SUPI_VTK_U8 : SUPI_VTK_F32, count, f->attributes);
    }
    if (supi_word_is(key, n, "texture_coordinates")) {
        length = supi_volume_word(r, &name);
        if (supi_volume_count(r, 1, &count)) return 1;
        n = supi_volume_word(r, &word);
        return supi_vtk_values(f, name, length, supi_vtk_parse_type(word, n), count, f->attributes);
    }
    for (i = 0; i < sizeof fixed / sizeof fixed[0]; i++) {
        if (!supi_word_is(key, n, fixed[i].name)) continue;
        length = supi_volume_word(r, &name);
        n = supi_volume_word(r, &word);
        return supi_vtk_values(f, name, length, supi_vtk_parse_type(word, n), fixed[i].components, f->attributes);
    }
    return -1;
}

/* ---- geometry ----------------------------------------------------------------------------------------------- */

SUP_FN int supi_vtk_dimensions(supi_vtk *f) {
    sup_volume *v = f->r->out;
    size_t k, n = 0, points = 1;
    for (k = 0; k < 3; k++) {
        int64_t d = 0;
        if (supi_volume_int(f->r, &d)) return 1;
        if (d < 1 || d > 0x7fffffff) return supi_vtk_fail(f, "DIMENSIONS have to be positive");
        v->dims[k] = (uint32_t)d;
        if (sup_mul_size(points, (size_t)d, &n) || n > 0xfffffffeu)
            return supi_vtk_fail(f, "more points than 32-bit numbers can name");
        points = n;
    }
    v->point_count = points;
    f->grid = 1;
    return 0;
}

SUP_FN size_t supi_vtk_grid_cells(const sup_volume *v) {
    return (size_t)(v->dims[0] - 1) * (v->dims[1] - 1) * (v->dims[2] - 1);
}

SUP_FN int supi_vtk_geometry(supi_vtk *f, const char *key, size_t n) { /* -1: not such a keyword */
    supi_volume_reader *r = f->r;
    sup_volume *v = r->out;
    const char *word;
    size_t k, count = 0, length;
    const int cells = supi_word_is(key, n, "cells") || supi_word_is(key, n, "cell_types");
    const int points = supi_word_is(key, n, "points"), dimensions = supi_word_is(key, n, "dimensions");
    if (cells ? !f->listed : dimensions && f->listed) return supi_vtk_fail(f, "this has no place in this kind of DATASET");
    if ((cells || points) && f->per_cell >= 0) /* they say how many there have to be */
        return supi_vtk_fail(f, "points and cells have to come before the values");
    if (dimensions && f->grid) return supi_vtk_fail(f, "DIMENSIONS is there twice");
    if (dimensions && (v->points || f->per_cell >= 0)) return supi_vtk_fail(f, "DIMENSIONS has to come first");
    if (points && v->points) return supi_vtk_fail(f, "POINTS is there twice");
    if (points) {
        if (supi_volume_count(r, 1, &count)) return 1;
        if (f->grid && count != v->point_count) return supi_vtk_fail(f, "POINTS does not fit to DIMENSIONS");
        length = supi_volume_word(r, &word);
        if (supi_vtk_doubles(f, supi_vtk_parse_type(word, length), 3 * count, &v->points)) return 1;
        v->point_count = count;
        return 0;
    }
    if (supi_word_is(key, n, "cells")) return supi_vtk_cells(f);
    if (supi_word_is(key, n, "cell_types")) return supi_vtk_cell_types(f);
    if (dimensions) return supi_vtk_dimensions(f);
    if (supi_word_is(key, n, "spacing") || supi_word_is(key, n, "aspect_ratio") || supi_word_is(key, n, "origin")) {
        double *to = supi_word_is(key, n, "origin") ? v->origin : v->spacing;
        for (k = 0; k < 3; k++)
            if (supi_volume_real(r, to + k)) return 1;
        return 0;
    }
    for (k = 0; k < 3; k++) {
        static const char names[3][16] = {"x_coordinates", "y_coordinates", "z_coordinates"};
        if (!supi_word_is(key, n, names[k])) continue;
        if (supi_volume_count(r, 1, &count)) return 1;
        if (!f->grid || count != v->dims[k]) return supi_vtk_fail(f, "coordinates do not fit to DIMENSIONS");
        length = supi_volume_word(r, &word);
        return supi_vtk_doubles(f, supi_vtk_parse_type(word, length), count, &v->axes[k]);
    }
    return -1;
}

SUP_FN int supi_vtk_body(supi_vtk *f) {
    supi_volume_reader *r = f->r;
    sup_volume *v = r->out;
    sup_text *t = &r->text;
    for (;;) {
        const char *key;
        size_t n, count = 0;
        int status;
        sup_text_skip_space(t);
        if (t->at == t->end) break;
        n = supi_volume_word(r, &key);
        if (supi_word_is(key, n, "metadata")) { /* up to an empty line */
            while (t->at < t->end) {
                sup_text_skip_line(t);
                if (t->at < t->end && (*t->at == '\n' || *t->at == '\r')) break;
            }
            continue;
        }
        if (supi_word_is(key, n, "point_data") || supi_word_is(key, n, "cell_data")) {
            const size_t cells = f->grid ? supi_vtk_grid_cells(v) : f->cells;
            f->per_cell = supi_word_is(key, n, "cell_data");
            if (supi_volume_count(r, 1, &count)) return 1;
            f->attributes = count;
            if (count != (f->per_cell ? cells : v->point_count))
                return supi_vtk_fail(f, "values for another number of points or cells than there are");
            continue;
        }
        status = supi_vtk_geometry(f, key, n);
        if (status < 0) status = supi_vtk_attribute(f, key, n);
        if (status < 0) {
            t->at = key;
            return supi_vtk_fail(f, "unknown keyword");
        }
        if (status) return 1;
    }
    if (f->listed ? !f->kept : !f->grid) return sup_fail(r->err, "%s: the file has no cells", r->name);
    if (f->grid) {
        size_t k, axes = 0;
        for (k = 0; k < 3; k++) axes += v->axes[k] != NULL;
        if (axes != 0 && axes != 3) return sup_fail(r->err, "%s: coordinates of an axis are missing", r->name);
        for (k = 0; k < 3 && !v->points && axes == 0; k++)
            if (v->spacing[k] == 0.0) v->spacing[k] = 1.0;
    }
    return 0;
}

SUP_FN int supi_read_vtk(supi_volume_reader *r) {
    sup_text *t = &r->text;
    const char *word, *at = t->at + 14;
    supi_vtk f;
    size_t n;
    int failed;
    memset(&f, 0, sizeof f);
    f.r = r;
    f.per_cell = -1;
    while (at < t->end && !supi_is_digit(*at) && *at != '\n') at++;
    f.major = at < t->end && supi_is_digit(*at) ? *at - '0' : 3;
    sup_text_skip_line(t);
    sup_text_skip_line(t); /* the title */
    sup_text_skip_space(t);
    n = supi_volume_word(r, &word);
    if (supi_word_is(word, n, "binary")) f.binary = 1;
    else if (!supi_word_is(word, n, "ascii")) return supi_volume_fail(r, "ASCII or BINARY was expected");
    sup_text_skip_space(t);
    n = supi_volume_word(r, &word);
    if (!supi_word_is(word, n, "dataset")) return supi_volume_fail(r, "DATASET was expected");
    n = supi_volume_word(r, &word);
    if (!supi_word_is(word, n, "unstructured_grid") && !supi_word_is(word, n, "structured_grid") &&
        !supi_word_is(word, n, "rectilinear_grid") && !supi_word_is(word, n, "structured_points"))
        return supi_volume_fail(r, "this kind of DATASET is no volume");
    f.listed = supi_word_is(word, n, "unstructured_grid");
    failed = supi_vtk_body(&f);
    SUP_FREE(f.offsets);
    SUP_FREE(f.corners);
    SUP_FREE(f.types);
    SUP_FREE(f.kept);
    return failed;
}

#endif
