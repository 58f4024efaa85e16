/* transfer.h - transfer functions: a small text format, and some by name
   SPDX-License-Identifier: MIT OR Unlicense

   One control point a line: value red green blue extinction. Values ascend, in units of the data; colours are linear,
   0 to 1; extinction is per unit of length. Two lines with one value make a jump. '#' starts a comment.
   Or two lists with values of their own, as many programs have them: lines "value red green blue" for the colours and
   lines "value extinction", in any order of the two. */
#ifndef SUP_TRANSFER_H
#define SUP_TRANSFER_H

#include "base.h"
#include "text.h"

typedef struct sup_control {
    float value, rgb[3], extinction;
} sup_control;

typedef struct sup_transfer {
    sup_control *points; /* from SUP_MALLOC */
    size_t count, capacity;
    size_t colors; /* not 0: the first points are colours, so many; the others are extinctions */
} sup_transfer;

SUP_FN void sup_transfer_free(sup_transfer *transfer) {
    SUP_FREE(transfer->points);
    memset(transfer, 0, sizeof *transfer);
}

SUP_FN int supi_transfer_insert(sup_transfer *t, size_t at, const double number[5]) { /* 1: no memory */
    void *grown = sup_grow(t->points, &t->capacity, t->count + 1, sizeof *t->points);
    sup_control *p;
    if (!grown) return 1;
    t->points = (sup_control *)grown;
    p = t->points + at;
    memmove(p + 1, p, (t->count - at) * sizeof *p);
    t->count++;
    p->value = (float)number[0];
    p->rgb[0] = (float)number[1];
    p->rgb[1] = (float)number[2];
    p->rgb[2] = (float)number[3];
    p->extinction = (float)number[4];
    return 0;
}

SUP_FN int supi_transfer_add(sup_transfer *t, const double number[5]) {
    return supi_transfer_insert(t, t->count, number);
}

/* One line, of n numbers. Returns NULL, or what is wrong with it. */
SUP_FN const char *supi_transfer_line(sup_transfer *t, double number[5], size_t n) {
    const size_t at = n == 4 ? t->colors : t->count, first = n == 2 ? t->colors : 0;
    size_t i;
    if (n != 2 && n != 4 && n != 5) return "value, red, green, blue, extinction were expected";
    if (t->count && (n == 5) != (t->points[0].extinction >= 0.0f && !t->colors && t->points[0].rgb[0] >= 0.0f))
        return "lines of 5 numbers and lists of 4 and 2 numbers do not go together";
    if (n == 2) {
        number[4] = number[1];
        number[1] = number[2] = number[3] = -1.0; /* marks what a point of a list has not */
    } else if (n == 4) {
        number[4] = -1.0;
    }
    if (n != 4 && number[4] < 0.0) return "the extinction is negative";
    for (i = 1; i < 4; i++) if (n != 2 && number[i] < 0.0) return "a colour is negative";
    if (at > first && (float)number[0] < t->points[at - 1].value) return "values have to ascend";
    if (supi_transfer_insert(t, at, number)) return "out of memory";
    t->colors += n == 4;
    return NULL;
}

/* Read a transfer function from memory. Returns 0, or 1 with err->text set and `out` cleared. */
SUP_FN int sup_transfer_read_memory(const char *data, size_t size, const char *name, sup_transfer *out,
                                    sup_error *err) {
    sup_text text;
    size_t line = 0, i;
    int lists;
    sup_error_clear(err);
    memset(out, 0, sizeof *out);
    text.begin = text.at = data;
    text.end = data + size;
    while (text.at < text.end) {
        double number[5];
        const char *what = NULL;
        line++;
        for (i = 0; i < 5 && !what; i++) {
            while (text.at < text.end && supi_is_blank(*text.at)) text.at++;
            if (text.at == text.end || *text.at == '\n' || *text.at == '\r' || *text.at == '#') break;
            if (sup_parse_double(&text.at, text.end, number + i)) what = "a number was expected";
            else if (!(fabs(number[i]) <= (double)FLT_MAX)) what = "a number is not finite";
        }
        while (text.at < text.end && supi_is_blank(*text.at)) text.at++;
        if (!what && text.at < text.end && *text.at != '\n' && *text.at != '\r' && *text.at != '#')
            what = "value, red, green, blue, extinction were expected";
        if (!what && i != 0) what = supi_transfer_line(out, number, i);
        if (what) {
            sup_transfer_free(out);
            return sup_fail(err, "%s: line %lu: %s", name, (unsigned long)line, what);
        }
        sup_text_skip_line(&text);
    }
    lists = out->count && (out->colors || out->points[0].rgb[0] < 0.0f);
    if (out->count == 0 || (lists && (out->colors == 0 || out->colors == out->count))) {
        const char *what = !out->count ? "no control point" : out->colors ? "colours, but no extinctions"
                                                                         : "extinctions, but no colours";
        sup_transfer_free(out);
        return sup_fail(err, "%s: %s", name, what);
    }
    return 0;
}

SUP_FN int sup_transfer_read(const char *path, sup_transfer *out, sup_error *err) {
    char *data;
    size_t size;
    int failed;
    memset(out, 0, sizeof *out);
    if (sup_read_file(path, &data, &size, err)) return 1;
    failed = sup_transfer_read_memory(data, size, path, out, err);
    SUP_FREE(data);
    return failed;
}

#define SUP_TRANSFER_NAMES "smooth|hot|cool|gray|rainbow|peak|shells|step|xray"

/* A transfer function by name, one of SUP_TRANSFER_NAMES, for data of lo..hi in something of size `length`: extinctions
   are per length, so that pictures do not depend on the unit.
   Returns 0, or 1 with err->text set. */
SUP_FN int sup_transfer_named(const char *name, double lo, double hi, double length, sup_transfer *out,
                              sup_error *err) {
    /* at, rgb, extinction * length */
    static const double smooth[][5] = {{0, 0, 0, 1, 0},       {0.4, 0, 0.8, 0.2, 0}, {0.5, 0, 1, 0, 6.9},
                                       {0.6, 0.2, 0.8, 0, 0.35}, {1, 1, 0, 0, 2.6}};
    static const double hot[][5] = {{0, 0, 0, 0, 0}, {0.33, 0.8, 0.05, 0, 1}, {0.66, 1, 0.6, 0, 3}, {1, 1, 1, 0.8, 6}};
    static const double cool[][5] = {{0, 0.05, 0.1, 0.6, 0.3}, {0.5, 0.55, 0.6, 0.65, 0}, {1, 0.7, 0.05, 0.02, 6}};
    static const double gray[][5] = {{0, 0, 0, 0, 0}, {1, 1, 1, 1, 6}};
    static const double rainbow[][5] = {{0, 0, 0, 1, 0.6},   {0.25, 0, 1, 1, 0.6}, {0.5, 0, 1, 0, 1.5},
                                        {0.75, 1, 1, 0, 2.5}, {1, 1, 0, 0, 4}};
    static const double peak[][5] = {{0, 0.9, 0.5, 0.1, 0},   {0.48, 0.9, 0.5, 0.1, 0}, {0.5, 0.9, 0.5, 0.1, 60},
                                     {0.52, 0.9, 0.5, 0.1, 0}, {1, 0.9, 0.5, 0.1, 0}};
    static const double shells[][5] = {
        {0, 0.1, 0.2, 0.8, 0},      {0.24, 0.1, 0.2, 0.8, 0},  {0.25, 0.1, 0.3, 0.9, 12}, {0.26, 0.1, 0.4, 0.8, 0},
        {0.49, 0.1, 0.7, 0.3, 0},   {0.5, 0.2, 0.8, 0.3, 25},  {0.51, 0.3, 0.8, 0.2, 0},  {0.74, 0.9, 0.5, 0.1, 0},
        {0.75, 0.95, 0.35, 0.1, 60}, {0.76, 0.9, 0.2, 0.1, 0}, {1, 0.9, 0.1, 0.1, 0}};
    static const double step[][5] = {
        {0, 0.1, 0.3, 0.9, 0}, {0.5, 0.1, 0.3, 0.9, 0}, {0.5, 0.9, 0.4, 0.1, 8}, {1, 0.9, 0.4, 0.1, 8}};
    static const double xray[][5] = {{0, 1, 1, 1, 0}, {1, 1, 1, 1, 2.5}};
    static const struct {
        char name[8];
        const double (*points)[5];
        size_t count;
    } all[] = {{"smooth", smooth, 5}, {"hot", hot, 4},       {"cool", cool, 3}, {"gray", gray, 2}, {"rainbow", rainbow, 5},
               {"peak", peak, 5},     {"shells", shells, 11}, {"step", step, 4}, {"xray", xray, 2}};
    size_t i, k;
    sup_error_clear(err);
    memset(out, 0, sizeof *out);
    if (!(hi > lo)) hi = lo + (fabs(lo) > 1.0 ? fabs(lo) * 1e-6 : 1e-6);
    for (i = 0; i < sizeof all / sizeof all[0]; i++) {
        if (strcmp(name, all[i].name) != 0) continue;
        for (k = 0; k < all[i].count; k++) {
            double number[5];
            memcpy(number, all[i].points[k], sizeof number);
            number[0] = lo + (hi - lo) * number[0];
            number[4] /= length;
            if (supi_transfer_add(out, number)) {
                sup_transfer_free(out);
                return sup_fail(err, "out of memory");
            }
        }
        return 0;
    }
    return sup_fail(err, "\"%s\" is none of %s", name, SUP_TRANSFER_NAMES);
}

#endif
