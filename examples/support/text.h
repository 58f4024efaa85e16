/* text.h - numbers and words out of text that is already in memory, fast and within its bounds
   SPDX-License-Identifier: MIT OR Unlicense

   Nothing here needs a zero byte behind the text, depends on the locale, or reads past `end`. */
#ifndef SUP_TEXT_H
#define SUP_TEXT_H

#include "base.h"
#include <float.h>
#include <math.h>

/* A text and a reading position in it: begin <= at <= end. */
typedef struct sup_text {
    const char *begin;
    const char *at;
    const char *end;
} sup_text;

/* Number of the line, from 1, that holds `where`; LF, CR LF and CR alone end a line. O(where - begin):
   lines are counted only when a message needs one. */
SUP_FN size_t sup_text_line(const sup_text *text, const char *where) {
    size_t line = 1;
    const char *p;
    for (p = text->begin; p < where; p++) {
        if (*p == '\n' || (*p == '\r' && !(p + 1 < text->end && p[1] == '\n'))) line++;
    }
    return line;
}

SUP_FN int supi_is_blank(char c) { return c == ' ' || c == '\t'; }
SUP_FN int supi_is_space(char c) { return c == ' ' || (c >= '\t' && c <= '\r'); }
SUP_FN int supi_is_digit(char c) { return c >= '0' && c <= '9'; }
SUP_FN char supi_lower(char c) { return c >= 'A' && c <= 'Z' ? (char)(c - 'A' + 'a') : c; }

/* A number must not run into something else: "12abc" and "1.2.3" are mistakes, not the numbers 12 and 1.2. */
SUP_FN int supi_ends_number(const char *p, const char *end) {
    const char c = p < end ? *p : ' ';
    return !(supi_is_digit(c) || c == '.' || c == '_' || c == '+' || c == '-' ||
             (supi_lower(c) >= 'a' && supi_lower(c) <= 'z'));
}

/* Move to the next character that is not white space, line ends included. */
SUP_FN void sup_text_skip_space(sup_text *text) {
    while (text->at < text->end && supi_is_space(*text->at)) text->at++;
}

/* Move past the rest of the line and its end. */
SUP_FN void sup_text_skip_line(sup_text *text) {
    while (text->at < text->end && *text->at != '\n' && *text->at != '\r') text->at++;
    if (text->at < text->end && *text->at == '\r') text->at++;
    if (text->at < text->end && *text->at == '\n') text->at++;
}

/* 1 when the text at `at` begins with the lower-case word `word`, in any case, and the word ends there. */
SUP_FN int sup_text_is_word(const char *at, const char *end, const char *word) {
    for (; *word; word++, at++) {
        if (at == end || supi_lower(*at) != *word) return 0;
    }
    return at == end || supi_is_space(*at);
}

/* Read a whole number at *at, with optional sign. Returns 0 and moves *at behind it, or 1 and does not move.
   Numbers out of range become INT64_MIN or INT64_MAX. */
SUP_FN int sup_parse_int(const char **at, const char *end, int64_t *out) {
    const char *p = *at;
    uint64_t value = 0;
    int negative = 0;
    if (p < end && (*p == '-' || *p == '+')) negative = *p++ == '-';
    if (p == end || !supi_is_digit(*p)) return 1;
    for (; p < end && supi_is_digit(*p); p++) {
        const uint64_t digit = (uint64_t)(*p - '0');
        value = value > (UINT64_C(9223372036854775807) - digit) / 10 ? UINT64_C(9223372036854775807)
                                                                     : value * 10 + digit;
    }
    if (!supi_ends_number(p, end)) return 1;
    *out = negative ? (value == UINT64_C(9223372036854775807) ? INT64_MIN : -(int64_t)value) : (int64_t)value;
    *at = p;
    return 0;
}

/* The words for what is not a number, as C libraries old and new print them: nan, nan(...), inf, infinity;
   and behind "1." the forms #INF, #QNAN, #IND. */
SUP_FN int supi_parse_special(const char **at, const char *end, double *out) {
    static const char names[3][9] = {"infinity", "inf", "nan"};
    const char *p = *at;
    size_t k, i;
    for (k = 0; k < 3; k++) {
        const size_t length = strlen(names[k]);
        if ((size_t)(end - p) < length) continue;
        for (i = 0; i < length && supi_lower(p[i]) == names[k][i]; i++) {}
        if (i < length) continue;
        p += length;
        if (k == 2 && p < end && *p == '(') {
            while (p < end && *p != ')' && !supi_is_space(*p)) p++;
            if (p == end || *p != ')') return 1;
            p++;
        }
        *out = k == 2 ? (double)NAN : (double)INFINITY;
        *at = p;
        return 0;
    }
    return 1;
}

/* The value mantissa * 10^exponent by the C library, which rounds correctly. The text made here has no decimal point,
   so the locale cannot spoil it. */
SUP_FN double supi_scale_slow(uint64_t mantissa, int64_t exponent) {
    char text[48];
    if (mantissa == 0 || exponent < -400) return 0.0;
    if (exponent > 400) return (double)INFINITY;
    /* unsigned long may have 32 bits only: three pieces of nine digits. */
    (void)snprintf(text, sizeof text, "%lu%09lu%09lue%d", (unsigned long)(mantissa / UINT64_C(1000000000000000000)),
                   (unsigned long)(mantissa / 1000000000u % 1000000000u), (unsigned long)(mantissa % 1000000000u),
                   (int)exponent);
    return strtod(text, NULL);
}

/* Shared by the two number readers below. `loose` allows two roundings in double, which is ample for a float. */
SUP_FN int supi_parse_real(const char **at, const char *end, double *out, int loose) {
    static const double powers[23] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,  1e8,  1e9,  1e10, 1e11,
                                      1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};
    const char *p = *at;
    uint64_t mantissa = 0;
    int64_t exponent = 0;
    int digits = 0, any = 0, negative = 0;
    double value;
    if (p < end && (*p == '-' || *p == '+')) negative = *p++ == '-';
    for (; p < end && supi_is_digit(*p); p++) {
        any = 1;
        if (digits < 19) {
            mantissa = mantissa * 10 + (uint64_t)(*p - '0');
            digits += mantissa != 0;
        } else {
            exponent++;
        }
    }
    if (p < end && *p == '.') {
        p++;
        for (; p < end && supi_is_digit(*p); p++) {
            any = 1;
            if (digits < 19) {
                mantissa = mantissa * 10 + (uint64_t)(*p - '0');
                digits += mantissa != 0;
                exponent--;
            }
        }
        if (any && p < end && *p == '#') {
            p++;
            value = p < end && supi_lower(*p) == 'i' && end - p >= 3 && supi_lower(p[2]) == 'f' ? (double)INFINITY
                                                                                                : (double)NAN;
            while (p < end && ((supi_lower(*p) >= 'a' && supi_lower(*p) <= 'z') || supi_is_digit(*p))) p++;
            *out = negative ? -value : value;
            *at = p;
            return 0;
        }
    }
    if (!any) {
        if (p != *at && p[-1] == '.') return 1;
        if (supi_parse_special(&p, end, &value) || !supi_ends_number(p, end)) return 1;
        *out = negative ? -value : value;
        *at = p;
        return 0;
    }
    if (p < end && (*p == 'e' || *p == 'E')) {
        const char *q = p + 1;
        int64_t written = 0;
        int down = 0;
        if (q < end && (*q == '-' || *q == '+')) down = *q++ == '-';
        if (q == end || !supi_is_digit(*q)) return 1;
        for (; q < end && supi_is_digit(*q); q++) {
            if (written < INT64_C(1000000000000)) written = written * 10 + (*q - '0');
        }
        exponent += down ? -written : written;
        p = q;
    }
    if (!supi_ends_number(p, end)) return 1;
    if ((loose || mantissa <= (UINT64_C(1) << 53)) && exponent >= -22 && exponent <= 22) {
        /* Both operands are exact (the mantissa nearly so when loose), so there is one rounding. */
        value = exponent < 0 ? (double)mantissa / powers[-exponent] : (double)mantissa * powers[exponent];
    } else {
        value = supi_scale_slow(mantissa, exponent);
    }
    *out = negative ? -value : value;
    *at = p;
    return 0;
}

/* Read a decimal number at *at: "1", "-.5", "2.e-3", "nan", "-inf". Returns 0 and moves *at behind it, or 1 and does
   not move. Correctly rounded up to 19 digits; further digits are ignored. Too large a number becomes infinity. */
SUP_FN int sup_parse_double(const char **at, const char *end, double *out) { return supi_parse_real(at, end, out, 0); }

/* Round a double to float without leaving the range of float: what is too large becomes infinity. */
SUP_FN float sup_to_float(double value) {
    /* Half a step above FLT_MAX rounds up to infinity; the cast itself would be undefined there. */
    const double edge = (double)FLT_MAX * (1.0 + 1.0 / 33554432.0);
    if (value >= edge) return INFINITY;
    if (value <= -edge) return -INFINITY;
    if (value > (double)FLT_MAX) return FLT_MAX;
    if (value < -(double)FLT_MAX) return -FLT_MAX;
    return (float)value;
}

/* As sup_parse_double, as float: within one unit in the last place of what strtof returns. */
SUP_FN int sup_parse_float(const char **at, const char *end, float *out) {
    double value;
    if (supi_parse_real(at, end, &value, 1)) return 1;
    *out = sup_to_float(value);
    return 0;
}

/* A colour component from 0..1 to 0..255, rounded; what is not a number becomes 0. */
SUP_FN uint8_t sup_unit_to_byte(double value) {
    if (!(value > 0.0)) return 0;
    return value >= 1.0 ? (uint8_t)255 : (uint8_t)(value * 255.0 + 0.5);
}

/* The name of a frame: its number in place of %d, %3d or %03d. Returns 1 when there is none, or `out` is too short. */
SUP_FN int sup_frame_name(const char *pattern, int64_t frame, char *out, size_t size) {
    const char *at = strchr(pattern, '%'), *end = at;
    int digits = 0;
    if (at == NULL) return 1;
    end++;
    while (*end >= '0' && *end <= '9' && digits < 100) digits = 10 * digits + (*end++ - '0');
    if (*end != 'd' || digits > 20 || strchr(end, '%') != NULL) return 1;
    return (size_t)snprintf(out, size, "%.*s%0*d%s", (int)(at - pattern), pattern, digits, (int)frame, end + 1) >= size;
}

/* The name of the picture of a frame: without a %d all of several would go to one file, which is an error. */
SUP_FN int sup_frame_path(const char *pattern, int64_t frame, int64_t frames, char *out, size_t size) {
    if (strchr(pattern, '%') == NULL) return frames > 1 || (size_t)snprintf(out, size, "%s", pattern) >= size;
    return sup_frame_name(pattern, frame, out, size);
}

#endif
