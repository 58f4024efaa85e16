/* cli.h - command line of the example programs: options, help, progress, time
   SPDX-License-Identifier: MIT OR Unlicense

       int shadows = 0;
       double error = 0.5;
       const char *in = NULL;
       sup_option options[] = {
           sup_opt_positional("IN.obj", &in, 1, "mesh to show"),
           sup_opt_flag("shadows", &shadows, "cast shadow rays"),
           sup_opt_real("tolerance", &error, 0.0, 1e6, "E", "error in pixels"),
       };
       const int status = sup_cli_parse(argc, argv, "Shows a mesh.", options, sizeof options / sizeof options[0]);
       if (status >= 0) return status;

   Exit status of all programs: 0 done, 1 the input was bad (one line on stderr), 2 wrong usage. */
#ifndef SUP_CLI_H
#define SUP_CLI_H

#include "base.h"
#include "text.h"
#include <time.h>
#if defined(_WIN32)
#include <io.h>
#endif

typedef enum sup_option_kind {
    SUP_OPT_FLAG,
    SUP_OPT_TEXT,
    SUP_OPT_REAL,
    SUP_OPT_INT,
    SUP_OPT_SIZE,
    SUP_OPT_VEC3,
    SUP_OPT_CHOICE,
    SUP_OPT_POSITIONAL
} sup_option_kind;

/* One option of a program; made by the sup_opt_ functions. Options in one table have different names. */
typedef struct sup_option {
    const char *name; /* without the two dashes; of a positional argument the word that help shows */
    sup_option_kind kind;
    void *value;         /* where the value goes; untouched when the option is not given, so it holds the default */
    const char *metavar; /* what help shows for the value */
    const char *help;
    double lowest, highest;
    const char *choices; /* "a|b|c" */
    int *given;          /* set to 1 when the option is given; may be NULL */
    int required;
} sup_option;

SUP_FN sup_option supi_option(const char *name, sup_option_kind kind, void *value, const char *metavar,
                              const char *help) {
    sup_option option;
    memset(&option, 0, sizeof option);
    option.name = name;
    option.kind = kind;
    option.value = value;
    option.metavar = metavar;
    option.help = help;
    return option;
}

/* --name, which sets *value to 1. */
SUP_FN sup_option sup_opt_flag(const char *name, int *value, const char *help) {
    return supi_option(name, SUP_OPT_FLAG, value, NULL, help);
}

/* --name TEXT; *value points into argv. */
SUP_FN sup_option sup_opt_text(const char *name, const char **value, const char *metavar, const char *help) {
    return supi_option(name, SUP_OPT_TEXT, (void *)value, metavar, help);
}

/* --name NUMBER within lowest..highest. */
SUP_FN sup_option sup_opt_real(const char *name, double *value, double lowest, double highest, const char *metavar,
                               const char *help) {
    sup_option option = supi_option(name, SUP_OPT_REAL, value, metavar, help);
    option.lowest = lowest;
    option.highest = highest;
    return option;
}

/* --name WHOLE-NUMBER within lowest..highest. */
SUP_FN sup_option sup_opt_int(const char *name, int64_t *value, int64_t lowest, int64_t highest, const char *metavar,
                              const char *help) {
    sup_option option = supi_option(name, SUP_OPT_INT, value, metavar, help);
    option.lowest = (double)lowest;
    option.highest = (double)highest;
    return option;
}

/* --name WIDTHxHEIGHT into value[0] and value[1], 1..65535 each. */
SUP_FN sup_option sup_opt_size(const char *name, uint32_t value[2], const char *help) {
    return supi_option(name, SUP_OPT_SIZE, value, "WxH", help);
}

/* --name x,y,z with finite numbers. */
SUP_FN sup_option sup_opt_vec3(const char *name, float value[3], const char *help) {
    return supi_option(name, SUP_OPT_VEC3, value, "x,y,z", help);
}

/* --name WORD, one of "a|b|c"; *value is its place from 0. */
SUP_FN sup_option sup_opt_choice(const char *name, int *value, const char *choices, const char *help) {
    sup_option option = supi_option(name, SUP_OPT_CHOICE, value, choices, help);
    option.choices = choices;
    return option;
}

/* An argument without a name. They are filled in the order of the table; required ones come first. */
SUP_FN sup_option sup_opt_positional(const char *name, const char **value, int required, const char *help) {
    sup_option option = supi_option(name, SUP_OPT_POSITIONAL, (void *)value, name, help);
    option.required = required;
    return option;
}

/* The same option, but *given becomes 1 when it is on the command line. */
SUP_FN sup_option sup_opt_given(sup_option option, int *given) {
    option.given = given;
    return option;
}

/* Read "WIDTHxHEIGHT", 1..65535 each. Returns 0, or 1 and leaves `out`. */
SUP_FN int sup_parse_size(const char *text, uint32_t out[2]) {
    const char *end = text + strlen(text), *x = strchr(text, 'x');
    int64_t width, height;
    if (!x || sup_parse_int(&text, x, &width) || text != x) return 1;
    text = x + 1;
    if (sup_parse_int(&text, end, &height) || text != end) return 1;
    if (width < 1 || width > 65535 || height < 1 || height > 65535) return 1;
    out[0] = (uint32_t)width;
    out[1] = (uint32_t)height;
    return 0;
}

/* Read "x,y,z", finite. Returns 0, or 1 and leaves `out`. */
SUP_FN int sup_parse_vec3(const char *text, float out[3]) {
    const char *end = text + strlen(text);
    float value[3];
    int k;
    for (k = 0; k < 3; k++) {
        if (sup_parse_float(&text, end, value + k) || !(fabsf(value[k]) <= FLT_MAX)) return 1;
        if (k < 2 && (text == end || *text++ != ',')) return 1;
    }
    if (text != end) return 1;
    memcpy(out, value, sizeof value);
    return 0;
}

/* Place of `text` in "a|b|c" from 0, or -1. */
SUP_FN int sup_parse_choice(const char *text, const char *choices) {
    const size_t length = strlen(text);
    int place = 0;
    for (;; place++) {
        const char *bar = strchr(choices, '|');
        const size_t n = bar ? (size_t)(bar - choices) : strlen(choices);
        if (n == length && memcmp(text, choices, n) == 0) return place;
        if (!bar) return -1;
        choices = bar + 1;
    }
}

/* The name of a program without its folder. */
SUP_FN const char *sup_program_name(const char *path) {
    const char *slash = path ? strrchr(path, '/') : NULL;
    return slash ? slash + 1 : path ? path : "program";
}

/* Print "program: text" on stderr; returns 1, the exit status for bad input, so that main can return it. */
SUP_FN int sup_bad_input(const char *program, const char *text) {
    (void)fprintf(stderr, "%s: %s\n", sup_program_name(program), text);
    return 1;
}

/* Print "program: warning: text" on stderr, unless the text is empty, as after a reader without anything to say. */
SUP_FN void sup_warn(const char *program, const char *text) {
    if (text[0]) (void)fprintf(stderr, "%s: warning: %s\n", sup_program_name(program), text);
}

/* Print "program: text" and where help is on stderr; returns 2, the exit status for wrong usage. */
SUP_FN int sup_bad_usage(const char *program, const char *format, ...) SUP_PRINTF(2, 3);
SUP_FN int sup_bad_usage(const char *program, const char *format, ...) {
    va_list args;
    (void)fprintf(stderr, "%s: ", sup_program_name(program));
    va_start(args, format);
    (void)vfprintf(stderr, format, args);
    va_end(args);
    (void)fprintf(stderr, " (%s --help shows the options)\n", sup_program_name(program));
    return 2;
}

SUP_FN void supi_help_text(FILE *stream, const char *text, int column, int from) {
    int at = column;
    if (from < column) (void)fprintf(stream, "%*s", column - from, "");
    else (void)fprintf(stream, "\n%*s", column, "");
    while (*text) {
        size_t n = strcspn(text, " \n");
        if (at > column && at + (int)n + 1 > 100) {
            (void)fprintf(stream, "\n%*s", column, "");
            at = column;
        } else if (at > column) {
            (void)fputc(' ', stream);
            at++;
        }
        (void)fwrite(text, 1, n, stream);
        at += (int)n;
        text += n;
        while (*text == ' ' || *text == '\n') text++;
    }
    (void)fputc('\n', stream);
}

/* Print usage, summary and the table of options. */
SUP_FN void sup_cli_help(FILE *stream, const char *program, const char *summary, const sup_option *options,
                         size_t count) {
    size_t i;
    (void)fprintf(stream, "usage: %s", sup_program_name(program));
    for (i = 0; i < count; i++) {
        if (options[i].kind == SUP_OPT_POSITIONAL)
            (void)fprintf(stream, options[i].required ? " %s" : " [%s]", options[i].name);
    }
    (void)fprintf(stream, " [options]\n%s\n\n", summary);
    for (i = 0; i < count; i++) {
        const sup_option *o = options + i;
        int at;
        if (o->kind == SUP_OPT_POSITIONAL) at = fprintf(stream, "  %s", o->name);
        else if (o->metavar) at = fprintf(stream, "  --%s %s", o->name, o->metavar);
        else at = fprintf(stream, "  --%s", o->name);
        supi_help_text(stream, o->help, 28, at + 1);
    }
    supi_help_text(stream, "show this", 28, fprintf(stream, "  --help") + 1);
}

/* Store one value. Returns 0, or 2 after a message. */
SUP_FN int supi_cli_store(const char *program, const sup_option *o, const char *text) {
    const char *at = text, *end = text + strlen(text);
    switch (o->kind) {
    case SUP_OPT_FLAG: {
        const int one = 1;
        memcpy(o->value, &one, sizeof one);
        break;
    }
    case SUP_OPT_TEXT:
    case SUP_OPT_POSITIONAL: memcpy(o->value, &text, sizeof text); break;
    case SUP_OPT_REAL: {
        double value;
        if (sup_parse_double(&at, end, &value) || at != end)
            return sup_bad_usage(program, "--%s: \"%s\" is not a number", o->name, text);
        if (!(value >= o->lowest && value <= o->highest)) {
            return sup_bad_usage(program, "--%s: %s is not within %g and %g", o->name, text, o->lowest, o->highest);
        }
        memcpy(o->value, &value, sizeof value);
        break;
    }
    case SUP_OPT_INT: {
        int64_t value;
        if (sup_parse_int(&at, end, &value) || at != end)
            return sup_bad_usage(program, "--%s: \"%s\" is not a whole number", o->name, text);
        if (!((double)value >= o->lowest && (double)value <= o->highest)) {
            return sup_bad_usage(program, "--%s: %s is not within %.0f and %.0f", o->name, text, o->lowest, o->highest);
        }
        memcpy(o->value, &value, sizeof value);
        break;
    }
    case SUP_OPT_SIZE: {
        uint32_t value[2] = {0, 0};
        if (sup_parse_size(text, value))
            return sup_bad_usage(program, "--%s: \"%s\" is not WIDTHxHEIGHT within 1 and 65535", o->name, text);
        memcpy(o->value, value, sizeof value);
        break;
    }
    case SUP_OPT_VEC3: {
        float value[3] = {0.0f, 0.0f, 0.0f};
        if (sup_parse_vec3(text, value)) return sup_bad_usage(program, "--%s: \"%s\" is not x,y,z", o->name, text);
        memcpy(o->value, value, sizeof value);
        break;
    }
    case SUP_OPT_CHOICE: {
        const int value = sup_parse_choice(text, o->choices);
        if (value < 0) return sup_bad_usage(program, "--%s: \"%s\" is none of %s", o->name, text, o->choices);
        memcpy(o->value, &value, sizeof value);
        break;
    }
    }
    if (o->given) *o->given = 1;
    return 0;
}

/* Parse the command line by a table of options: "--name value", "--name=value", flags, and arguments without a name.
   "--" ends the options; the last of repeated options counts; a value may begin with "-" but not with "--".
   options   in, [count]; values are written through it
   Returns -1 to go on, else the exit status: 0 after --help (printed on stdout), 2 after a message on stderr. */
SUP_FN int sup_cli_parse(int argc, char *const *argv, const char *summary, const sup_option *options, size_t count) {
    const char *program = argc > 0 ? argv[0] : "program";
    size_t next = 0, k;
    int i, plain = 0;
    for (i = 1; i < argc; i++) { /* help first: it must work beside mistakes */
        if (strcmp(argv[i], "--") == 0) break;
        if (strcmp(argv[i], "--help") == 0 || strcmp(argv[i], "-h") == 0) {
            sup_cli_help(stdout, program, summary, options, count);
            return 0;
        }
    }
    for (i = 1; i < argc; i++) {
        const char *arg = argv[i], *value = NULL;
        const sup_option *o = NULL;
        if (!plain && strcmp(arg, "--") == 0) {
            plain = 1;
            continue;
        }
        if (plain || arg[0] != '-' || arg[1] == '\0') {
            while (next < count && options[next].kind != SUP_OPT_POSITIONAL) next++;
            if (next == count) return sup_bad_usage(program, "unexpected argument \"%s\"", arg);
            (void)supi_cli_store(program, options + next, arg);
            next++;
            continue;
        }
        if (arg[1] == '-') {
            const size_t length = strcspn(arg + 2, "=");
            for (k = 0; k < count && !o; k++) {
                if (options[k].kind != SUP_OPT_POSITIONAL && strlen(options[k].name) == length &&
                    memcmp(options[k].name, arg + 2, length) == 0)
                    o = options + k;
            }
            if (arg[2 + length] == '=') value = arg + 3 + length;
        }
        if (!o) return sup_bad_usage(program, "unknown option \"%s\"", arg);
        if (o->kind == SUP_OPT_FLAG) {
            if (value) return sup_bad_usage(program, "--%s takes no value", o->name);
            value = "";
        } else if (!value) {
            if (i + 1 >= argc || strncmp(argv[i + 1], "--", 2) == 0)
                return sup_bad_usage(program, "--%s needs a value: %s", o->name, o->metavar);
            value = argv[++i];
        }
        if (supi_cli_store(program, o, value)) return 2;
    }
    for (k = next; k < count; k++) {
        if (options[k].kind == SUP_OPT_POSITIONAL && options[k].required)
            return sup_bad_usage(program, "%s is missing", options[k].name);
    }
    return -1;
}

/* ---- time and progress -------------------------------------------------------------------------------------- */

/* Wall-clock time in seconds from some fixed moment; never runs backwards where the system has such a clock. */
SUP_FN double sup_now(void) {
    struct timespec t;
#if defined(CLOCK_MONOTONIC)
    (void)clock_gettime(CLOCK_MONOTONIC, &t);
#elif defined(TIME_UTC)
    (void)timespec_get(&t, TIME_UTC);
#else
#error "a system header came before this one: define _POSIX_C_SOURCE to 200809L"
#endif
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* How many threads the libraries use when `asked` were asked for: 0 means one per core; 64 at most. */
SUP_FN int sup_threads(int64_t asked) {
#if defined(_SC_NPROCESSORS_ONLN)
    if (asked == 0) asked = (int64_t)sysconf(_SC_NPROCESSORS_ONLN);
#endif
    return asked < 1 ? 1 : asked > 64 ? 64 : (int)asked;
}

/* 1 when stderr is a terminal. */
SUP_FN int sup_is_terminal(void) {
#if defined(_WIN32)
    return _isatty(2) != 0;
#else
    return isatty(2) == 1;
#endif
}

/* A progress line on stderr, shown only on a terminal. */
typedef struct sup_progress {
    const char *label;
    int shown; /* the line is on the screen */
    int quiet;
    double last;
} sup_progress;

/* Begin; `label` must stay valid. quiet: never show anything. */
SUP_FN void sup_progress_begin(sup_progress *progress, const char *label, int quiet) {
    progress->label = label;
    progress->shown = 0;
    progress->quiet = quiet || !sup_is_terminal();
    progress->last = sup_now();
}

/* Show that `done` of `total` parts are done, ten times a second at most. It has the form of the libraries' progress
   callback: user is the sup_progress; returns 0, so it never cancels. One thread at a time. */
SUP_FN int sup_progress_fn(void *user, uint64_t done, uint64_t total) {
    sup_progress *progress = (sup_progress *)user;
    double now;
    if (progress->quiet) return 0;
    now = sup_now();
    if (now - progress->last < 0.1) return 0;
    progress->last = now;
    progress->shown = 1;
    (void)fprintf(stderr, "\r%s %3.0f %%", progress->label, total ? 100.0 * (double)done / (double)total : 0.0);
    (void)fflush(stderr);
    return 0;
}

/* Wipe the line. */
SUP_FN void sup_progress_end(sup_progress *progress) {
    if (progress->shown) (void)fprintf(stderr, "\r%*s\r", (int)strlen(progress->label) + 8, "");
    progress->shown = 0;
}

/* Print a string in quotes as JSON has it: what must be escaped is escaped. */
SUP_FN void sup_json_string(FILE *stream, const char *text) {
    (void)fputc('"', stream);
    for (; *text; text++) {
        const unsigned char c = (unsigned char)*text;
        if (c == '"' || c == '\\') (void)fprintf(stream, "\\%c", c);
        else if (c < 32) (void)fprintf(stream, "\\u%04x", (unsigned)c);
        else (void)fputc(c, stream);
    }
    (void)fputc('"', stream);
}

#endif
