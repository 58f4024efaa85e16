/* amr_file.h - locally refined grids from plotfiles of AMReX and BoxLib - MIT OR Unlicense, see LICENSE

       sup_amr amr;
       if (sup_amr_read("plt00100", "density", &amr, &err)) ...
       desc.patches = amr.patches; ...                            (see sup_amr_desc)
       sup_amr_free(&amr);

   A plotfile is a folder: `Header` (text: fields, domain, levels), and per level a text file with the boxes and where
   the values of each lie in binary files beside it. Three dimensions, Cartesian, ratios of refinement (2, 4, 8
   or 16) on all levels, 4- or 8-byte floats in either order of bytes. Include it after tetcast.h. */
#ifndef SUP_AMR_FILE_H
#define SUP_AMR_FILE_H
#ifndef TETCAST_VERSION_MAJOR
#error "include tetcast.h before this header"
#endif

#include "base.h"
#include <math.h>

enum { SUP_AMR_CELLS_END = 1 << 27 };

typedef struct sup_amr {
    tetcast_patch *patches;
    size_t count;
    float *values;              /* of all patches, one after the other */
    uint32_t cells[3], ratio_log[TETCAST_AMR_LEVELS], levels;
    double origin[3], spacing[3];
    char field[64];
} sup_amr;

SUP_FN void sup_amr_free(sup_amr *amr) {
    SUP_FREE(amr->patches);
    SUP_FREE(amr->values);
    memset(amr, 0, sizeof *amr);
}

/* ---- text: numbers and words between blanks, brackets and commas ---- */

typedef struct supi_scan { const char *p, *start, *end; int failed; } supi_scan;

SUP_FN void supi_scan_skip(supi_scan *s) {
    while (s->p < s->end && (*s->p == ' ' || *s->p == '\n' || *s->p == '\r' || *s->p == '\t' || *s->p == '(' || *s->p == ')' ||
                             *s->p == ',')) s->p++;
}

SUP_FN double supi_scan_number(supi_scan *s) {
    char text[64];
    size_t n = 0;
    char *stop;
    double v;
    supi_scan_skip(s);
    while (s->p < s->end && n + 1 < sizeof text && strchr("+-.0123456789eE", *s->p) && *s->p) text[n++] = *s->p++;
    text[n] = '\0';
    v = strtod(text, &stop);
    if (n == 0 || *stop || !(fabs(v) < 1e300)) s->failed = 1;
    return s->failed ? 0.0 : v;
}

SUP_FN int64_t supi_scan_int(supi_scan *s, int64_t lo, int64_t hi) {
    const double v = supi_scan_number(s);
    if (!(v >= (double)lo && v <= (double)hi) || v != floor(v)) s->failed = 1;
    return s->failed ? lo : (int64_t)v;
}

/* The rest of the line, or one word of it. */
SUP_FN void supi_scan_text(supi_scan *s, int word, char *out, size_t room) {
    size_t n = 0;
    while (s->p < s->end && (*s->p == ' ' || *s->p == '\n' || *s->p == '\r')) s->p++;
    while (s->p < s->end && *s->p != '\n' && *s->p != '\r' && !(word && *s->p == ' ')) {
        if (n + 1 < room) out[n++] = *s->p;
        else s->failed = 1;
        s->p++;
    }
    out[n] = '\0';
    if (n == 0) s->failed = 1;
}

/* ((lo) (hi) (type)): cells lo .. hi */
SUP_FN void supi_scan_box(supi_scan *s, int64_t lo[3], int64_t hi[3]) {
    for (int a = 0; a < 3; a++) lo[a] = supi_scan_int(s, -(1 << 24), 1 << 24);
    for (int a = 0; a < 3; a++) hi[a] = supi_scan_int(s, -(1 << 24), 1 << 24);
    for (int a = 0; a < 3; a++) {
        (void)supi_scan_int(s, 0, 0); /* 1: values of nodes or faces */
        if (hi[a] < lo[a]) s->failed = 1;
    }
}

SUP_FN int supi_amr_open(const char *folder, const char *name, char **data, supi_scan *s, sup_error *err) {
    char path[4096];
    size_t size = 0;
    if (snprintf(path, sizeof path, "%s/%s", folder, name) >= (int)sizeof path) return sup_fail(err, "%s: the name is too long", folder);
    if (name[0] == '/' || strstr(name, "..")) return sup_fail(err, "%s: names a file elsewhere: %s", folder, name);
    if (!sup_is_plain_file(path)) return sup_fail(err, "%s: there is no such file", path);
    if (sup_read_file(path, data, &size, err)) return 1;
    memset(s, 0, sizeof *s);
    s->p = s->start = *data;
    s->end = *data + size;
    return 0;
}

/* One box of values from its binary file, which stays open in *data while the next box is in it as well. */
SUP_FN int supi_amr_values(const char *folder, const char *level, const char *file, int64_t offset, int64_t component,
                           const int64_t lo[3], const int64_t hi[3], float *out, char **data, size_t *size, char open[256], sup_error *err) {
    char path[512];
    supi_scan s;
    int64_t from[3], to[3], bytes, first, fields, n[3];
    size_t need;
    const unsigned char *p;
    const char *slash = strrchr(level, '/');
    const int part = slash ? (int)(slash - level) : 0;
    if (snprintf(path, sizeof path, "%.*s%s%s", part, level, part ? "/" : "", file) >= (int)sizeof path || strlen(path) > 255)
        return sup_fail(err, "%s: the name %s is too long", folder, file);
    if (strcmp(path, open) != 0) {
        SUP_FREE(*data);
        *data = NULL;
        open[0] = '\0';
        if (supi_amr_open(folder, path, data, &s, err)) return 1;
        *size = (size_t)(s.end - s.p);
        strcpy(open, path);
    }
    if (offset < 0 || (uint64_t)offset + 8 > *size || memcmp(*data + offset, "FAB ((", 6) != 0)
        return sup_fail(err, "%s/%s: there are no values at byte %lld", folder, path, (long long)offset);
    memset(&s, 0, sizeof s);
    s.p = *data + offset + 4;
    s.end = *data + *size;
    (void)supi_scan_int(&s, 8, 8);           /* numbers that describe the format follow */
    bytes = supi_scan_int(&s, 32, 64) / 8;
    for (int i = 0; i < 7; i++) (void)supi_scan_int(&s, 0, 4096);
    (void)supi_scan_int(&s, bytes, bytes);
    first = supi_scan_int(&s, 1, bytes);     /* order of bytes: 1 2 3 4: most significant first */
    for (int i = 1; i < bytes; i++) (void)supi_scan_int(&s, 1, bytes);
    supi_scan_box(&s, from, to);
    fields = supi_scan_int(&s, 1, 100000);
    while (s.p < s.end && *s.p != '\n') s.p++;
    s.p++;
    for (int a = 0; a < 3; a++) {
        n[a] = to[a] - from[a] + 1;
        if (lo[a] < from[a] || hi[a] > to[a]) s.failed = 1;
    }
    if (s.failed || (bytes != 4 && bytes != 8) || component >= fields || sup_mul_size((size_t)n[0], (size_t)n[1], &need) ||
        sup_mul_size(need, (size_t)n[2], &need) || sup_mul_size(need, (size_t)bytes * (size_t)(component + 1), &need) || s.p > s.end ||
        need > (size_t)(s.end - s.p))
        return sup_fail(err, "%s/%s: impossible or too short at byte %lld", folder, path, (long long)offset);
    p = (const unsigned char *)s.p + (size_t)component * (size_t)(n[0] * n[1] * n[2]) * (size_t)bytes;
    for (int64_t z = lo[2]; z <= hi[2]; z++)
        for (int64_t y = lo[1]; y <= hi[1]; y++)
            for (int64_t x = lo[0]; x <= hi[0]; x++) {
                const unsigned char *q = p + (size_t)((x - from[0]) + n[0] * ((y - from[1]) + n[1] * (z - from[2]))) * (size_t)bytes;
                uint64_t u = 0;
                for (int i = 0; i < bytes; i++) u |= (uint64_t)q[first == 1 ? bytes - 1 - i : i] << (8 * i);
                if (bytes == 8) {
                    double v;
                    memcpy(&v, &u, 8);
                    *out++ = (float)v;
                } else {
                    const uint32_t w = (uint32_t)u;
                    memcpy(out++, &w, 4);
                }
            }
    return 0;
}

typedef struct supi_amr_level { int64_t lo[3], hi[3]; char file[256]; } supi_amr_level;

/* Header -> levels, field number. */
SUP_FN int supi_amr_header(const char *folder, const char *field, supi_scan *s, sup_amr *amr, supi_amr_level level[TETCAST_AMR_LEVELS],
                           int64_t *component, sup_error *err) {
    char text[256];
    int64_t fields, grids;
    double lo[3], hi[3];
    supi_scan_text(s, 0, text, sizeof text);
    fields = supi_scan_int(s, 1, 100000);
    *component = field ? -1 : 0;
    for (int64_t i = 0; i < fields && !s->failed; i++) {
        supi_scan_text(s, 0, text, sizeof text);
        if (field ? strcmp(text, field) == 0 : i == 0) {
            *component = i;
            (void)snprintf(amr->field, sizeof amr->field, "%.63s", text);
        }
    }
    if (!s->failed && *component < 0) return sup_fail(err, "%s: there is no field %s", folder, field);
    if (supi_scan_int(s, 1, 3) != 3 && !s->failed) return sup_fail(err, "%s: has not three dimensions", folder);
    (void)supi_scan_number(s);               /* time */
    amr->levels = (uint32_t)supi_scan_int(s, 0, TETCAST_AMR_LEVELS - 1) + 1;
    for (int a = 0; a < 3; a++) lo[a] = supi_scan_number(s);
    for (int a = 0; a < 3; a++) hi[a] = supi_scan_number(s);
    memset(amr->ratio_log, 0, sizeof amr->ratio_log);
    for (uint32_t k = 1; k < amr->levels && !s->failed; k++) {
        const int64_t r = supi_scan_int(s, 2, 16);
        if ((r & (r - 1)) != 0) return sup_fail(err, "%s: a ratio of refinement is no power of two", folder);
        for (amr->ratio_log[k - 1] = 1; (int64_t)1 << amr->ratio_log[k - 1] < r;) amr->ratio_log[k - 1]++;
    }
    for (uint32_t k = 0; k < amr->levels; k++) supi_scan_box(s, level[k].lo, level[k].hi);
    for (uint32_t k = 0; k < amr->levels; k++) (void)supi_scan_int(s, 0, INT32_MAX);       /* steps */
    for (uint32_t k = 0; k < 3 * amr->levels; k++) (void)supi_scan_number(s);              /* sizes of cells */
    if (supi_scan_int(s, 0, 2) != 0 && !s->failed) return sup_fail(err, "%s: coordinates are not Cartesian", folder);
    (void)supi_scan_int(s, 0, INT32_MAX);
    for (uint32_t k = 0; k < amr->levels && !s->failed; k++) {
        (void)supi_scan_int(s, 0, TETCAST_AMR_LEVELS);
        grids = supi_scan_int(s, 0, SUP_AMR_CELLS_END);
        (void)supi_scan_number(s);
        (void)supi_scan_int(s, 0, INT32_MAX);
        for (int64_t i = 0; i < 6 * grids && !s->failed; i++) (void)supi_scan_number(s);
        supi_scan_text(s, 1, level[k].file, sizeof level[k].file - 2);
        strcat(level[k].file, "_H");
    }
    for (int a = 0; a < 3; a++) {
        const int64_t n = level[0].hi[a] - level[0].lo[a] + 1;
        amr->cells[a] = (uint32_t)n;
        amr->origin[a] = lo[a];
        amr->spacing[a] = (hi[a] - lo[a]) / (double)n;
        if (!(amr->spacing[a] > 0.0)) s->failed = 1;
    }
    return s->failed ? sup_fail(err, "%s/Header: impossible at byte %ld", folder, (long)(s->p - s->start)) : 0;
}

/* Boxes of a level and their values. */
SUP_FN int supi_amr_boxes(const char *folder, const supi_amr_level *level, uint32_t k, int64_t component, sup_amr *amr, size_t *room,
                          size_t *used, size_t *value_room, sup_error *err) {
    char *data = NULL, *binary = NULL, open[256] = "", file[256], word[16];
    size_t size = 0, first = amr->count;
    int64_t boxes = 0, lo[3], hi[3];
    supi_scan s;
    int failed = supi_amr_open(folder, level->file, &data, &s, err);
    if (failed) return 1;
    (void)supi_scan_int(&s, 0, 100);
    (void)supi_scan_int(&s, 0, 100);
    (void)supi_scan_int(&s, 1, 100000);
    (void)supi_scan_int(&s, 0, 100);          /* ghost cells, one number or three */
    supi_scan_skip(&s);
    while (s.p > data && s.p[-1] == ',' && !s.failed) {
        (void)supi_scan_int(&s, 0, 100);
        supi_scan_skip(&s);
    }
    boxes = supi_scan_int(&s, 0, SUP_AMR_CELLS_END);
    (void)supi_scan_int(&s, 0, 0);
    for (int64_t i = 0; i < boxes && !s.failed; i++) {
        tetcast_patch *p;
        size_t n = 1;
        supi_scan_box(&s, lo, hi);
        if (s.failed) break;
        p = (tetcast_patch *)sup_grow(amr->patches, room, amr->count + 1, sizeof *p);
        if (!p) {
            failed = sup_fail(err, "out of memory");
            break;
        }
        amr->patches = p;
        p += amr->count++;
        memset(p, 0, sizeof *p);
        p->level = k;
        for (int a = 0; a < 3; a++) {
            p->lo[a] = (int32_t)(lo[a] - level->lo[a]);
            p->dims[a] = (uint32_t)(hi[a] - lo[a] + 1);
            if (lo[a] < level->lo[a] || hi[a] > level->hi[a]) s.failed = 1;
            n *= p->dims[a]; /* at most 2^25 each: checked below before it is used */
            if (n > SUP_AMR_CELLS_END) {
                s.failed = 1;
                n = 0;
            }
        }
        if (*used + n > SUP_AMR_CELLS_END) s.failed = 1;
        else *used += n;
    }
    if (!failed && !s.failed && supi_scan_int(&s, boxes, boxes) != boxes) s.failed = 1;
    if (!failed && !s.failed) {
        float *v = (float *)sup_grow(amr->values, value_room, *used + 1, sizeof *v);
        if (!v) failed = sup_fail(err, "out of memory");
        else amr->values = v;
    }
    for (size_t i = first, at = 0; !failed && !s.failed && i < amr->count; i++) {
        const tetcast_patch *p = &amr->patches[i];
        int64_t offset;
        if (i == first) {
            at = *used;
            for (size_t j = first; j < amr->count; j++)
                at -= (size_t)amr->patches[j].dims[0] * amr->patches[j].dims[1] * amr->patches[j].dims[2];
        }
        supi_scan_text(&s, 1, word, sizeof word);
        if (strcmp(word, "FabOnDisk:") != 0) s.failed = 1;
        supi_scan_text(&s, 1, file, sizeof file);
        offset = supi_scan_int(&s, 0, (int64_t)1 << 50);
        if (s.failed) break;
        for (int a = 0; a < 3; a++) {
            lo[a] = p->lo[a] + level->lo[a];
            hi[a] = lo[a] + p->dims[a] - 1;
        }
        failed = supi_amr_values(folder, level->file, file, offset, component, lo, hi, amr->values + at, &binary, &size, open, err);
        at += (size_t)p->dims[0] * p->dims[1] * p->dims[2];
    }
    if (s.failed && !failed) failed = sup_fail(err, "%s/%s: impossible at byte %ld", folder, level->file, (long)(s.p - data));
    SUP_FREE(binary);
    SUP_FREE(data);
    return failed;
}

/* Read a plotfile. field NULL: the first one. Returns 0, or 1 with err->text set. */
SUP_FN int sup_amr_read(const char *folder, const char *field, sup_amr *amr, sup_error *err) {
    supi_amr_level level[TETCAST_AMR_LEVELS];
    char *data = NULL;
    size_t room = 0, used = 0, value_room = 0, at = 0;
    int64_t component = 0;
    supi_scan s;
    int failed;
    memset(amr, 0, sizeof *amr);
    memset(level, 0, sizeof level);
    if (supi_amr_open(folder, "Header", &data, &s, err)) return 1;
    failed = supi_amr_header(folder, field, &s, amr, level, &component, err);
    SUP_FREE(data);
    for (uint32_t k = 0; k < amr->levels && !failed; k++)
        failed = supi_amr_boxes(folder, &level[k], k, component, amr, &room, &used, &value_room, err);
    for (size_t i = 0; i < amr->count && !failed; i++) { /* where they are is known only now */
        amr->patches[i].values = amr->values + at;
        at += (size_t)amr->patches[i].dims[0] * amr->patches[i].dims[1] * amr->patches[i].dims[2];
    }
    if (failed) sup_amr_free(amr);
    return failed;
}

/* A folder with a Header in it? */
SUP_FN int sup_amr_is(const char *path) {
    char name[4096];
    if (snprintf(name, sizeof name, "%s/Header", path) >= (int)sizeof name) return 0;
    return sup_is_plain_file(name);
}

SUP_FN void sup_amr_desc(const sup_amr *amr, tetcast_amr_desc *desc) {
    memset(desc, 0, sizeof *desc);
    desc->patches = amr->patches;
    desc->patch_count = amr->count;
    memcpy(desc->ratio_logs, amr->ratio_log, sizeof desc->ratio_logs);
    for (int a = 0; a < 3; a++) {
        desc->cells[a] = amr->cells[a];
        desc->origin[a] = amr->origin[a];
        desc->spacing[a] = amr->spacing[a];
    }
}

#endif
