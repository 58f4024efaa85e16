/* volume.h - volume meshes and grids: readers for VTK, AVS UCD, PLOT3D, TetGen and Gmsh
   SPDX-License-Identifier: MIT OR Unlicense

       sup_volume volume;
       sup_error err;
       if (sup_volume_read("fins.vtk", &volume, &err)) { fprintf(stderr, "%s\n", err.text); return 1; }
       if (err.text[0]) fprintf(stderr, "warning: %s\n", err.text);
       ...
       sup_volume_free(&volume);

   Read: VTK legacy files of versions 1.0 to 5.1, text and binary (unstructured, structured and rectilinear grids,
   structured points); AVS UCD, text; PLOT3D XYZ with its Q file, binary of either byte order, with and without Fortran
   record marks, one or several grids, blanking; TetGen .node and .ele; Gmsh 2.2 and 4.1, text.
   All readers: the file is read whole; every count that a file claims is checked against the bytes it has before
   memory is taken for it; indices are checked; NaN and infinite numbers are kept; cells that are no volume (points,
   lines, faces) are skipped and counted; curved cells (10, 13, 15, 20, ... nodes) become their straight ones. */
#ifndef SUP_VOLUME_H
#define SUP_VOLUME_H

#include "base.h"
#include "text.h"

/* Values at the points or in the cells. */
typedef struct sup_field {
    char name[64];
    uint32_t components; /* 1: scalar, 3: vector, ... */
    int per_cell;
    size_t count;        /* points or cells */
    float *values;       /* components * count */
} sup_field;

/* Kinds of cells have the numbers and the order of corners of VTK. */
enum { SUP_TETRA = 10, SUP_VOXEL = 11, SUP_HEXAHEDRON = 12, SUP_WEDGE = 13, SUP_PYRAMID = 14 };

/* A volume. Arrays come from SUP_MALLOC and belong to it; NULL where there is no such data.
   dims all 0: cells are listed. Otherwise a grid of dims[0] * dims[1] * dims[2] points, x fastest: curvilinear
   with points, rectilinear with axes, else uniform with origin and spacing. */
typedef struct sup_volume {
    double *points;      /* 3 per point */
    size_t point_count;
    uint32_t *indices;   /* the corners of all cells one after the other */
    size_t index_count;
    uint8_t *shapes;     /* SUP_TETRA ... per cell */
    size_t cell_count;
    uint32_t dims[3];
    double *axes[3];     /* dims[k] numbers each */
    double origin[3], spacing[3];
    int five;            /* cells of a grid become five tetrahedra, not six; no file has it */
    uint8_t *blanks;     /* per point, 0: not there */
    uint8_t *masks;      /* per listed cell, not 0: shows nothing; no file has it */
    sup_field *fields;
    size_t field_count, field_capacity;
    size_t skipped_cells; /* cells that are no volume */
    size_t straightened;  /* curved cells */
} sup_volume;

/* Gives a reader a second file; see sup_open_fn of mesh.h. */
typedef int (*sup_volume_open_fn)(void *user, const char *name, char **data, size_t *size);

/* Free the arrays and clear the volume; a cleared one may be freed again. */
SUP_FN void sup_volume_free(sup_volume *volume) {
    size_t i;
    SUP_FREE(volume->points);
    SUP_FREE(volume->indices);
    SUP_FREE(volume->shapes);
    SUP_FREE(volume->blanks);
    SUP_FREE(volume->masks);
    for (i = 0; i < 3; i++) SUP_FREE(volume->axes[i]);
    for (i = 0; i < volume->field_count; i++) SUP_FREE(volume->fields[i].values);
    SUP_FREE(volume->fields);
    memset(volume, 0, sizeof *volume);
}

/* Corners of a cell of that kind, 0 when it is no volume. */
SUP_FN size_t sup_shape_corners(int shape) {
    return shape == SUP_TETRA ? 4u : shape == SUP_PYRAMID ? 5u : shape == SUP_WEDGE ? 6u :
           shape == SUP_HEXAHEDRON || shape == SUP_VOXEL ? 8u : 0u;
}

/* Add a field of `count` values of `components` numbers, not cleared. Returns its values, or NULL without memory. A name
   of length 0 becomes "data". */
SUP_FN float *sup_volume_add_field(sup_volume *volume, const char *name, size_t length, uint32_t components,
                                   int per_cell, size_t count) {
    sup_field *field;
    size_t total;
    void *grown = sup_grow(volume->fields, &volume->field_capacity, volume->field_count + 1, sizeof *volume->fields);
    if (!grown) return NULL;
    volume->fields = (sup_field *)grown;
    field = volume->fields + volume->field_count;
    memset(field, 0, sizeof *field);
    if (sup_mul_size(components, count, &total)) return NULL;
    field->values = (float *)sup_alloc(total, sizeof(float));
    if (!field->values) return NULL;
    if (length == 0) {
        name = "data";
        length = 4;
    }
    if (length >= sizeof field->name) length = sizeof field->name - 1;
    memcpy(field->name, name, length);
    field->components = components;
    field->per_cell = per_cell;
    field->count = count;
    volume->field_count++;
    return field->values;
}

/* What all readers carry. */
typedef struct supi_volume_reader {
    sup_text text;
    const char *name;
    sup_volume *out;
    sup_volume_open_fn open_fn;
    void *open_user;
    sup_error *err;
    size_t index_capacity, cell_capacity;
} supi_volume_reader;

SUP_FN int supi_volume_memory(supi_volume_reader *r) { return sup_fail(r->err, "%s: out of memory", r->name); }

/* An error in a text, with its line. */
SUP_FN int supi_volume_fail(supi_volume_reader *r, const char *what) {
    return sup_fail(r->err, "%s: line %lu: %s", r->name, (unsigned long)sup_text_line(&r->text, r->text.at),
                    r->text.at == r->text.end ? "the file ends too early" : what);
}

/* Append a cell of `shape` with `corners` numbers. 1: no memory. */
SUP_FN int supi_volume_add_cell(supi_volume_reader *r, int shape, const uint32_t *corner, size_t corners) {
    sup_volume *v = r->out;
    void *grown = sup_grow(v->indices, &r->index_capacity, v->index_count + corners, sizeof *v->indices);
    size_t i;
    if (!grown) return supi_volume_memory(r);
    v->indices = (uint32_t *)grown;
    grown = sup_grow(v->shapes, &r->cell_capacity, v->cell_count + 1, 1);
    if (!grown) return supi_volume_memory(r);
    v->shapes = (uint8_t *)grown;
    for (i = 0; i < corners; i++) v->indices[v->index_count++] = corner[i];
    v->shapes[v->cell_count++] = (uint8_t)shape;
    return 0;
}

/* The next number of a text, wherever it stands. */
SUP_FN int supi_volume_real(supi_volume_reader *r, double *out) {
    sup_text_skip_space(&r->text);
    if (!sup_parse_double(&r->text.at, r->text.end, out)) return 0;
    return supi_volume_fail(r, "a number was expected");
}
SUP_FN int supi_volume_int(supi_volume_reader *r, int64_t *out) {
    sup_text_skip_space(&r->text);
    if (!sup_parse_int(&r->text.at, r->text.end, out)) return 0;
    return supi_volume_fail(r, "a whole number was expected");
}
/* A count of things that take at least `least` bytes each in the rest of the file. */
SUP_FN int supi_volume_count(supi_volume_reader *r, size_t least, size_t *out) {
    int64_t value = 0;
    if (supi_volume_int(r, &value)) return 1;
    if (value < 0) return supi_volume_fail(r, "a count is negative");
    if ((uint64_t)value > (uint64_t)(r->text.end - r->text.at) / least + 1 || (uint64_t)value > 0x7fffffffu)
        return supi_volume_fail(r, "more is announced than the file can hold");
    *out = (size_t)value;
    return 0;
}
/* The next word on this line; length 0 at its end. */
SUP_FN size_t supi_volume_word(supi_volume_reader *r, const char **word) {
    sup_text *t = &r->text;
    while (t->at < t->end && supi_is_blank(*t->at)) t->at++;
    *word = t->at;
    while (t->at < t->end && !supi_is_space(*t->at)) t->at++;
    return (size_t)(t->at - *word);
}
SUP_FN int supi_word_is(const char *word, size_t length, const char *lower) {
    size_t i;
    for (i = 0; i < length; i++)
        if (lower[i] == '\0' || supi_lower(word[i]) != lower[i]) return 0;
    return lower[length] == '\0';
}

/* Numbers of points in a file -> 0, 1, 2, ...: as a rule they count up from 0 or 1, but they need not. */
typedef struct supi_id {
    int64_t id;
    uint32_t index;
} supi_id;
typedef struct supi_ids {
    supi_id *list; /* ascending */
    size_t count;
    int straight;  /* list[i].id is list[0].id + i */
} supi_ids;

SUP_FN int supi_id_compare(const void *a, const void *b) {
    const supi_id *x = (const supi_id *)a, *y = (const supi_id *)b;
    return x->id < y->id ? -1 : x->id > y->id ? 1 : x->index < y->index ? -1 : 1;
}
/* Sort; 1 when a number is there twice, which is then *twice. */
SUP_FN int supi_ids_sort(supi_ids *ids, int64_t *twice) {
    size_t i;
    int sorted = 1;
    for (i = 1; i < ids->count && sorted; i++) sorted = ids->list[i - 1].id < ids->list[i].id;
    if (!sorted) qsort(ids->list, ids->count, sizeof *ids->list, supi_id_compare);
    ids->straight = 1;
    for (i = 1; i < ids->count; i++) {
        if (ids->list[i].id == ids->list[i - 1].id) {
            *twice = ids->list[i].id;
            return 1;
        }
        if (ids->list[i].id != ids->list[i - 1].id + 1) ids->straight = 0;
    }
    return 0;
}
/* 0xffffffff: there is no such number. */
SUP_FN uint32_t supi_ids_find(const supi_ids *ids, int64_t id) {
    size_t lo = 0, hi = ids->count;
    if (ids->count == 0 || id < ids->list[0].id || id > ids->list[ids->count - 1].id) return 0xffffffffu;
    if (ids->straight) return ids->list[(size_t)(id - ids->list[0].id)].index;
    while (lo < hi) {
        const size_t mid = lo + (hi - lo) / 2;
        if (ids->list[mid].id < id) lo = mid + 1;
        else hi = mid;
    }
    return lo < ids->count && ids->list[lo].id == id ? ids->list[lo].index : 0xffffffffu;
}

/* 1 when `name` ends with the lower-case `end`, in any case. */
SUP_FN int supi_ends_with(const char *name, const char *end) {
    const size_t n = strlen(name), m = strlen(end);
    return n >= m && supi_word_is(name + n - m, m, end);
}

#include "volume_gmsh.h"
#include "volume_plot3d.h"
#include "volume_tetgen.h"
#include "volume_ucd.h"
#include "volume_vtk.h"

/* Read a volume from `size` bytes at `data`. Formats are told by content, and where that does not tell by the end of
   `name`: .node and .ele TetGen, .inp UCD, .bin .xyz .x .p3d PLOT3D.
   name      also names the file in messages
   open_fn   gives the Q file of a PLOT3D file, the .node of an .ele; NULL: there are none
   out       out: the volume; free with sup_volume_free. Cleared on error
   err       out: the error, or after success a warning or an empty text; may be NULL
   Returns 0, or 1 with err->text set. */
SUP_FN int sup_volume_read_memory(const void *data, size_t size, const char *name, sup_volume_open_fn open_fn,
                                  void *open_user, sup_volume *out, sup_error *err) {
    sup_error unused;
    supi_volume_reader r;
    int failed;
    if (!err) err = &unused;
    sup_error_clear(err);
    memset(out, 0, sizeof *out);
    memset(&r, 0, sizeof r);
    r.text.begin = r.text.at = size ? (const char *)data : "";
    r.text.end = r.text.begin + size;
    r.name = name;
    r.out = out;
    r.open_fn = open_fn;
    r.open_user = open_user;
    r.err = err;
    if (size == 0) return sup_fail(err, "%s: the file is empty", name);
    if (size > 14 && memcmp(data, "# vtk DataFile", 14) == 0) failed = supi_read_vtk(&r);
    else if (size > 11 && memcmp(data, "$MeshFormat", 11) == 0) failed = supi_read_gmsh(&r);
    else if (supi_ends_with(name, ".node")) failed = supi_read_tetgen(&r, 0);
    else if (supi_ends_with(name, ".ele")) failed = supi_read_tetgen(&r, 1);
    else if (supi_ends_with(name, ".inp")) failed = supi_read_ucd(&r);
    else if (supi_ends_with(name, ".bin") || supi_ends_with(name, ".xyz") || supi_ends_with(name, ".x") ||
             supi_ends_with(name, ".p3d"))
        failed = supi_read_plot3d(&r);
    else failed = sup_fail(err, "%s: not a volume in VTK, UCD, PLOT3D, TetGen or Gmsh format", name);
    if (failed) {
        sup_volume_free(out);
        return 1;
    }
    if (out->straightened && !err->text[0])
        (void)sup_fail(err, "%s: %lu curved cells were made straight", name, (unsigned long)out->straightened);
    return 0;
}

/* A name of a second file stands for itself: the readers make it from the first one's. */
SUP_FN int supi_volume_open(void *user, const char *name, char **data, size_t *size) {
    (void)user;
    return sup_read_file(name, data, size, NULL);
}

/* Read a volume file and the files that belong to it. Returns 0, or 1 with err->text set. */
SUP_FN int sup_volume_read(const char *path, sup_volume *out, sup_error *err) {
    char *data;
    size_t size;
    int failed;
    memset(out, 0, sizeof *out);
    if (sup_read_file(path, &data, &size, err)) return 1;
    failed = sup_volume_read_memory(data, size, path, supi_volume_open, NULL, out, err);
    SUP_FREE(data);
    return failed;
}

#endif
