/* report.c - turns benchmark lines into pictures and a table

   report [FOLDER]        (default build/bench)

   Reads every FOLDER/NAME.jsonl: one flat JSON object a line, {"bench":"voxrt.trace","case":"dragon-4096",
   "metric":"rays_per_second","value":2.1e7,"unit":"1/s","error":0.4,"error_unit":"px","threads":1,"isa":"avx2",...}.
   A line without "metric" describes the machine and the build. Lines with the same bench, case and metric are a group;
   in it "method" (or else "variant"), "isa" and "threads" tell the curves apart as far as they differ. Writes
     FOLDER/error_BENCH_CASE_METRIC.svg   time against error, both logarithmic, for groups with two different errors
     FOLDER/overview_BENCH.svg            all of those in one picture, for benches that end in ".error": a row for each case,
                                          a column for each metric, the same colour for the same method
     FOLDER/rate_BENCH_METRIC.svg         bars, for metrics whose unit ends in /s
     FOLDER/report.md                     tables (FOLDER/table_*.md, as the programs left them), all numbers, the pictures
   Metrics with the unit s, ms, us or ns are times; of a rate in 1/s the time is its inverse. An error of 0 is drawn
   on the bottom line. */
#define _POSIX_C_SOURCE 200809L
#include <dirent.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MAX_PAIRS = 48, NAME_SIZE = 512 };

typedef struct record {
    char *line;                 /* owns the text of all pairs, cut up by zeros */
    const char *key[MAX_PAIRS];
    const char *value[MAX_PAIRS];
    int count;
} record;

typedef struct list { record *items; size_t count, room; } list;

typedef struct point { double x, y; } point;

/* Okabe and Ito's palette: told apart by all kinds of eyes */
static const char *const g_colors[8] = {
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "currentColor", "#999999"
};

static void fail(const char *what, const char *why) {
    fprintf(stderr, "report: %s: %s\n", what, why);
    exit(1);
}

/* ---- reading ---- */

static const char *get(const record *r, const char *key) { /* "" when it is not there */
    int i;
    for (i = 0; i < r->count; i++) if (strcmp(r->key[i], key) == 0) return r->value[i];
    return "";
}

static double number(const record *r, const char *key) { /* NaN when it is not there */
    const char *s = get(r, key);
    char *end;
    double v = strtod(s, &end);
    return end != s ? v : (double)NAN;
}

static char *skip_blank(char *p) {
    while (*p == ' ' || *p == '\t') p++;
    return p;
}

static char *cut_string(char *p) { /* p behind the opening quote; unescapes in place, returns behind the closing one */
    char *out = p;
    while (*p != 0 && *p != '"') {
        if (*p == '\\' && p[1] != 0) {
            p++;
            if (*p == 'u') { /* no benchmark needs them: shown as they are */
                *out++ = '\\';
            }
            *out++ = *p == 'n' || *p == 't' || *p == 'r' ? ' ' : *p;
            p++;
        } else {
            *out++ = *p++;
        }
    }
    if (*p == 0) return NULL;
    *out = 0;
    return p + 1;
}

static int parse(record *r) { /* 0: not an object that this program understands */
    char *p = skip_blank(r->line);
    if (*p++ != '{') return 0;
    p = skip_blank(p);
    while (*p == '"') {
        char *key = p + 1, *value;
        p = cut_string(key);
        if (p == NULL) return 0;
        p = skip_blank(p);
        if (*p++ != ':') return 0;
        p = skip_blank(p);
        value = p;
        if (*p == '"') {
            value = p + 1;
            p = cut_string(value);
            if (p == NULL) return 0;
            p = skip_blank(p);
        } else { /* a number, true, false, null, or something nested that is kept as text */
            int depth = 0;
            while (*p != 0 && (depth > 0 || (*p != ',' && *p != '}'))) {
                if (*p == '[' || *p == '{') depth++;
                if (*p == ']' || *p == '}') depth--;
                p++;
            }
        }
        if (r->count < MAX_PAIRS) {
            r->key[r->count] = key;
            r->value[r->count] = value;
            r->count++;
        }
        if (*p == '}') { *p = 0; return 1; }
        if (*p != ',') return 0;
        *p++ = 0;
        p = skip_blank(p);
    }
    return *p == '}';
}

static void read_file(list *all, const char *path) {
    FILE *f = fopen(path, "rb");
    char *line = NULL;
    size_t room = 0, at = 0;
    ssize_t n;
    if (f == NULL) fail(path, "cannot be read");
    while ((n = getline(&line, &room, f)) >= 0) {
        record r;
        at++;
        while (n > 0 && (line[n - 1] == '\n' || line[n - 1] == '\r')) line[--n] = 0;
        if (*skip_blank(line) == 0) continue;
        memset(&r, 0, sizeof r);
        r.line = (char *)malloc((size_t)n + 1);
        if (r.line == NULL) fail(path, "no memory");
        memcpy(r.line, line, (size_t)n + 1);
        if (!parse(&r)) {
            fprintf(stderr, "report: %s:%lu: not a flat JSON object, left out\n", path, (unsigned long)at);
            free(r.line);
            continue;
        }
        if (all->count == all->room) {
            all->room = all->room != 0 ? all->room * 2 : 256;
            all->items = (record *)realloc(all->items, all->room * sizeof(record));
            if (all->items == NULL) fail(path, "no memory");
        }
        all->items[all->count++] = r;
    }
    free(line);
    fclose(f);
}

static int by_text(const void *a, const void *b) { return strcmp(*(char *const *)a, *(char *const *)b); }

static void read_folder(list *all, const char *folder) {
    DIR *d = opendir(folder);
    char *paths[256];
    size_t count = 0, i;
    struct dirent *e;
    if (d == NULL) fail(folder, "cannot be read");
    while ((e = readdir(d)) != NULL && count < sizeof paths / sizeof paths[0]) {
        size_t n = strlen(e->d_name), size = strlen(folder) + n + 2;
        if (n < 6 || strcmp(e->d_name + n - 6, ".jsonl") != 0) continue;
        paths[count] = (char *)malloc(size);
        if (paths[count] == NULL) fail(folder, "no memory");
        snprintf(paths[count++], size, "%s/%s", folder, e->d_name);
    }
    closedir(d);
    qsort(paths, count, sizeof paths[0], by_text);
    for (i = 0; i < count; i++) { read_file(all, paths[i]); free(paths[i]); }
}

/* ---- what the numbers mean ---- */

static double seconds(const record *r) { /* NaN when the metric is neither a time nor a rate */
    static const struct { const char *unit; double factor; } units[] = {
        {"s", 1}, {"ms", 1e-3}, {"us", 1e-6}, {"ns", 1e-9}
    };
    const char *unit = get(r, "unit");
    double v = number(r, "value");
    size_t i;
    if (strcmp(unit, "1/s") == 0) return v > 0 ? 1 / v : (double)NAN;
    for (i = 0; i < sizeof units / sizeof units[0]; i++) {
        if (strcmp(unit, units[i].unit) == 0) return v * units[i].factor;
    }
    return (double)NAN;
}

static int is_rate(const record *r) {
    const char *unit = get(r, "unit");
    size_t n = strlen(unit);
    return n >= 2 && strcmp(unit + n - 2, "/s") == 0;
}

static int same(const record *a, const record *b, const char *key) { return strcmp(get(a, key), get(b, key)) == 0; }

static int same_group(const record *a, const record *b) {
    return same(a, b, "bench") && same(a, b, "case") && same(a, b, "metric") && same(a, b, "unit");
}

/* The name of a curve: method, isa and threads, each only if it differs within the records of `same_set`. */
static void series_name(char *out, size_t size, const list *all, const record *r,
                        int (*same_set)(const record *, const record *)) {
    static const char *const keys[] = {"method", "variant", "isa", "threads"};
    size_t used = 0, i, k;
    out[0] = 0;
    for (k = 0; k < sizeof keys / sizeof keys[0]; k++) {
        int differs = 0;
        for (i = 0; i < all->count && !differs; i++) {
            differs = same_set(&all->items[i], r) && !same(&all->items[i], r, keys[k]) &&
                (k != 2 || get(&all->items[i], keys[k])[0] != 0); /* some lines have no isa */
        }
        if (!differs || get(r, keys[k])[0] == 0) continue;
        used += (size_t)snprintf(out + used, size - used, "%s%s%s", used != 0 ? ", " : "", get(r, keys[k]),
            k < 3 ? "" : strcmp(get(r, "threads"), "1") == 0 ? " thread" : " threads");
        if (used >= size) return;
    }
}

static void si(char *out, size_t size, double v) { /* 21.3 M */
    static const char prefix[] = "pnum kMGTP";
    int e = 4;
    if (!(v > 0) || v < 1e-13 || v >= 1e18) { snprintf(out, size, "%g ", v); return; }
    while (v >= 999.5 && e < 9) { v /= 1000; e++; }
    while (v < 0.9995 && e > 0) { v *= 1000; e--; }
    if (e == 4) snprintf(out, size, "%.3g ", v);
    else snprintf(out, size, "%.3g %c", v, prefix[e]);
}

static void value_text(char *out, size_t size, const record *r) {
    const char *unit = get(r, "unit");
    char text[64];
    double v = number(r, "value"), t = seconds(r);
    if (is_rate(r)) {
        si(text, sizeof text, v);
        snprintf(out, size, "%s%s", text, strcmp(unit, "1/s") == 0 ? "/s" : unit);
    } else if (t == t) {
        si(text, sizeof text, t);
        snprintf(out, size, "%ss", text);
    } else if (v == v) {
        snprintf(out, size, "%.6g%s%s", v, unit[0] != 0 ? " " : "", unit);
    } else {
        snprintf(out, size, "%s %s", get(r, "value"), unit);
    }
}

/* ---- writing: beside the file, then renamed ---- */

static FILE *open_part(const char *path) {
    char part[2 * NAME_SIZE + 16];
    FILE *f;
    snprintf(part, sizeof part, "%s.part", path);
    f = fopen(part, "wb");
    if (f == NULL) fail(part, "cannot be written");
    return f;
}

static void close_part(FILE *f, const char *path) {
    char part[2 * NAME_SIZE + 16];
    int bad = ferror(f);
    snprintf(part, sizeof part, "%s.part", path);
    bad |= fclose(f) != 0;
    if (bad || rename(part, path) != 0) fail(path, "cannot be written");
}

static void file_name(char *out, size_t size, const char *format, ...) __attribute__((format(printf, 3, 4)));
static void file_name(char *out, size_t size, const char *format, ...) { /* only harmless characters */
    va_list args;
    char *p;
    va_start(args, format);
    vsnprintf(out, size, format, args);
    va_end(args);
    for (p = out; *p != 0; p++) {
        int ok = (*p >= 'a' && *p <= 'z') || (*p >= 'A' && *p <= 'Z') || (*p >= '0' && *p <= '9');
        if (!ok && *p != '.' && *p != '-') *p = '_';
    }
}

static void put_text(FILE *f, const char *s) { /* for XML */
    for (; *s != 0; s++) {
        if (*s == '<') fputs("&lt;", f);
        else if (*s == '>') fputs("&gt;", f);
        else if (*s == '&') fputs("&amp;", f);
        else fputc(*s, f);
    }
}

static void put_label(FILE *f, double x, double y, const char *attributes, const char *a, const char *b) {
    fprintf(f, "<text x=\"%.1f\" y=\"%.1f\" %s>", x, y, attributes);
    put_text(f, a);
    put_text(f, b);
    fputs("</text>\n", f);
}

/* Light paper, or dark paper where the reader prefers that; what is black in one is white in the other. */
static const char g_style[] =
    "<style>svg{color:#000}text{fill:#222}.soft{fill:#555}.on{fill:#fff}.paper,.hole{fill:#fff}.grid{stroke:#ddd}.axis{stroke:#222}"
    ".ring{stroke:#fff}@media(prefers-color-scheme:dark){svg{color:#fff}text{fill:#ddd}.soft{fill:#aaa}.paper,.hole{fill:#14181e}"
    ".grid{stroke:#39414b}.axis{stroke:#ddd}.ring{stroke:#14181e}}</style>\n";

static void svg_begin(FILE *f, int width, int height) {
    fprintf(f, "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"%d\" height=\"%d\" viewBox=\"0 0 %d %d\" "
        "font-family=\"sans-serif\" font-size=\"12\">\n%s<rect width=\"100%%\" height=\"100%%\" class=\"paper\"/>\n",
        width, height, width, height, g_style);
}

/* ---- time against error ---- */

typedef struct axis { double lo, hi, from, to; } axis; /* logarithms to base 10 -> pixels */

static double place(const axis *a, double v) {
    return a->from + (log10(v) - a->lo) / (a->hi - a->lo) * (a->to - a->from);
}

static void axis_fit(axis *a, double lo, double hi, double from, double to) {
    a->lo = log10(lo) - 0.1;
    a->hi = log10(hi) + 0.1;
    if (a->hi - a->lo < 1) { /* at least one decade */
        double mid = 0.5 * (a->lo + a->hi);
        a->lo = mid - 0.5;
        a->hi = mid + 0.5;
    }
    a->from = from;
    a->to = to;
}

static void draw_ticks(FILE *f, const axis *a, int horizontal, double other_from, double other_to, const char *unit) {
    static const double steps[3] = {1, 2, 5};
    int e, s, every = (int)ceil((a->hi - a->lo) / 8);
    if (every < 1) every = 1;
    for (e = (int)floor(a->lo); e <= (int)ceil(a->hi); e++) {
        for (s = 0; s < (a->hi - a->lo < 2.5 ? 3 : 1); s++) {
            double v = steps[s] * pow(10, e), p;
            char text[64];
            if (log10(v) < a->lo || log10(v) > a->hi || e % every != 0) continue;
            p = place(a, v);
            if (unit != NULL) si(text, sizeof text, v);
            else snprintf(text, sizeof text, "%g", v);
            if (horizontal) {
                fprintf(f, "<path d=\"M%.1f %.1fV%.1f\" class=\"grid\"/>\n", p, other_from, other_to);
                put_label(f, p, other_from + 16, "text-anchor=\"middle\"", text, unit != NULL ? unit : "");
            } else {
                fprintf(f, "<path d=\"M%.1f %.1fH%.1f\" class=\"grid\"/>\n", other_from, p, other_to);
                put_label(f, other_from - 6, p + 4, "text-anchor=\"end\"", text, unit != NULL ? unit : "");
            }
        }
    }
}

static int by_x(const void *a, const void *b) {
    const point *p = (const point *)a, *q = (const point *)b;
    if (p->x != q->x) return p->x < q->x ? -1 : 1;
    return p->y < q->y ? 1 : p->y > q->y ? -1 : 0;
}

/* Eight colours; the eight series after that have squares and dashed lines, the next ones diamonds and dots. */
static void draw_mark(FILE *f, double x, double y, int series, int hollow) {
    const char *color = g_colors[series % 8];
    if (series < 8) fprintf(f, "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"4\"", x, y);
    else if (series >= 16) fprintf(f, "<path d=\"M%.1f %.1fl5 5l-5 5l-5 -5z\"", x, y - 5);
    else fprintf(f, "<rect x=\"%.1f\" y=\"%.1f\" width=\"8\" height=\"8\"", x - 4, y - 4);
    if (hollow) fprintf(f, " class=\"hole\" stroke=\"%s\"/>\n", color);
    else fprintf(f, " fill=\"%s\" class=\"ring\"/>\n", color);
}

static void draw_curve(FILE *f, const axis *x, const axis *y, point *points, size_t count, int series) {
    size_t i;
    qsort(points, count, sizeof points[0], by_x);
    fprintf(f, "<polyline fill=\"none\" stroke=\"%s\" stroke-width=\"1.5\"%s points=\"", g_colors[series % 8],
            series < 8 ? "" : series < 16 ? " stroke-dasharray=\"4 3\"" : " stroke-dasharray=\"1 3\"");
    for (i = 0; i < count; i++) {
        fprintf(f, "%.1f,%.1f ", place(x, points[i].x), points[i].y > 0 ? place(y, points[i].y) : y->from);
    }
    fputs("\"/>\n", f);
    for (i = 0; i < count; i++) {
        int zero = !(points[i].y > 0);
        draw_mark(f, place(x, points[i].x), zero ? y->from : place(y, points[i].y), series, zero);
    }
}

/* What the time of a metric is of: frame_seconds, frame_time -> frame; rays_per_second -> rays. */
static const char *timed(const char *name, char out[NAME_SIZE]) {
    static const char *const ends[] = {"_seconds", "_time", "_per_second"};
    size_t i, k;
    for (i = 0; name[i] != 0 && i + 1 < NAME_SIZE; i++) out[i] = name[i] == '_' ? ' ' : name[i];
    if (strncmp(name, "time_", 5) == 0 || strcmp(name, "time") == 0) return strcpy(out, "picture");
    for (k = 0; k < sizeof ends / sizeof ends[0]; k++) {
        const size_t n = strlen(ends[k]);
        if (i > n && strcmp(name + i - n, ends[k]) == 0) i -= n;
    }
    out[i] = 0;
    return out;
}

/* Returns 0, and writes nothing, when the group of `first` has not two different errors. */
static int error_plot(const list *all, const record *first, const char *path) {
    double t_lo = HUGE_VAL, t_hi = 0, e_lo = HUGE_VAL, e_hi = 0, e_first = (double)NAN;
    int differ = 0, series = 0, hollow = 0;
    size_t i, k, width = 760, height = 460, longest = 0;
    axis x, y;
    FILE *f;
    char text[NAME_SIZE];
    point *points = (point *)malloc((all->count + 1) * sizeof(point));
    if (points == NULL) fail(path, "no memory");
    for (i = 0; i < all->count; i++) {
        const record *r = &all->items[i];
        double t = seconds(r), e = number(r, "error");
        if (!same_group(r, first) || !(t > 0) || !(e >= 0)) continue;
        if (e_first == e_first && e != e_first) differ = 1;
        e_first = e;
        series_name(text, sizeof text, all, r, same_group);
        if (strlen(text) > longest) longest = strlen(text);
        if (t < t_lo) t_lo = t;
        if (t > t_hi) t_hi = t;
        if (e > 0 && e < e_lo) e_lo = e;
        if (e > e_hi) e_hi = e;
    }
    if (!differ) { free(points); return 0; }
    f = open_part(path);
    svg_begin(f, (int)(width + (longest > 26 ? 7 * (longest - 26) : 0)), (int)height);
    axis_fit(&x, t_lo, t_hi, 80, (double)width - 190);
    axis_fit(&y, e_lo, e_hi, (double)height - 60, 50);
    draw_ticks(f, &x, 1, y.from, y.to, "s");
    draw_ticks(f, &y, 0, x.from, x.to, NULL);
    fprintf(f, "<path d=\"M%.1f %.1fV%.1fH%.1f\" fill=\"none\" class=\"axis\"/>\n", x.from, y.to, y.from, x.to);
    fprintf(f, "<text x=\"%.1f\" y=\"24\" font-size=\"15\">", x.from);
    put_text(f, get(first, "case"));
    fputs(": error against time (", f);
    put_text(f, get(first, "bench"));
    fputs(")</text>\n", f);
    put_label(f, 0.5 * (x.from + x.to), y.from + 40, "text-anchor=\"middle\"",
        strcmp(get(first, "unit"), "1/s") == 0 ? "time for one of: " : "time of a ", timed(get(first, "metric"), text));
    fprintf(f, "<g transform=\"translate(20 %.1f) rotate(-90)\">", 0.5 * (y.from + y.to));
    put_label(f, 0, 0, "text-anchor=\"middle\"", "error, ", get(first, "error_unit"));
    fputs("</g>\n", f);
    for (i = 0; i < all->count; i++) { /* each curve at its first record */
        char name[NAME_SIZE], other[NAME_SIZE];
        size_t count = 0, seen = 0;
        if (!same_group(&all->items[i], first)) continue;
        series_name(name, sizeof name, all, &all->items[i], same_group);
        for (k = 0; k < all->count; k++) {
            const record *r = &all->items[k];
            if (!same_group(r, first)) continue;
            series_name(other, sizeof other, all, r, same_group);
            if (strcmp(name, other) != 0) continue;
            if (k < i) seen = 1;
            if (!(seconds(r) > 0) || !(number(r, "error") >= 0)) continue;
            points[count].x = seconds(r);
            points[count].y = number(r, "error");
            hollow |= !(points[count].y > 0);
            count++;
        }
        if (seen || count == 0) continue;
        draw_curve(f, &x, &y, points, count, series);
        draw_mark(f, x.to + 18, y.to + 10 + 20 * series, series, 0);
        put_label(f, x.to + 28, y.to + 14 + 20 * series, "", name[0] != 0 ? name : get(first, "metric"), "");
        series++;
    }
    if (hollow) put_label(f, x.to + 10, y.from, "class=\"soft\"", "hollow: no error", "");
    fputs("</svg>\n", f);
    close_part(f, path);
    free(points);
    return 1;
}

/* ---- many of them ---- */

static int same_case(const record *a, const record *b) { return same(a, b, "bench") && same(a, b, "case"); }
static int same_metric(const record *a, const record *b) { return same(a, b, "bench") && same(a, b, "metric"); }
static int same_method(const record *a, const record *b) { return same(a, b, "bench") && same(a, b, "method"); }

/* Those records of the bench of `first` that begin a set; returns how many, at most `most`. */
static int firsts(const list *all, const record *first, int (*same_set)(const record *, const record *),
                  const record **out, int most) {
    size_t i;
    int n = 0, k;
    for (i = 0; i < all->count; i++) {
        const record *r = &all->items[i];
        if (!same(r, first, "bench") || !(seconds(r) > 0) || !(number(r, "error") >= 0)) continue;
        for (k = 0; k < n && !same_set(out[k], r); k++) { }
        if (k == n && n < most) out[n++] = r;
    }
    return n;
}

/* One panel: a case and a metric. */
static void panel(FILE *f, const list *all, const record *kase, const record *metric, const record **methods, int method_count,
                  double left, double top, double wide, double high) {
    double t_lo = HUGE_VAL, t_hi = 0, e_lo = HUGE_VAL, e_hi = 0;
    point *points = (point *)malloc((all->count + 1) * sizeof(point));
    axis x, y;
    size_t i;
    int m;
    if (points == NULL) fail("overview", "no memory");
    for (i = 0; i < all->count; i++) { /* times are the same in all panels of a case */
        const record *r = &all->items[i];
        const double t = seconds(r), e = number(r, "error");
        if (!same_case(r, kase) || !(t > 0) || !(e >= 0)) continue;
        if (t < t_lo) t_lo = t;
        if (t > t_hi) t_hi = t;
        if (!same_metric(r, metric)) continue;
        if (e > 0 && e < e_lo) e_lo = e;
        if (e > e_hi) e_hi = e;
    }
    if (!(e_hi > 0)) e_lo = e_hi = 1e-3;
    axis_fit(&x, t_lo, t_hi, left, left + wide);
    axis_fit(&y, e_lo, e_hi, top + high, top);
    draw_ticks(f, &x, 1, y.from, y.to, "s");
    draw_ticks(f, &y, 0, x.from, x.to, NULL);
    fprintf(f, "<path d=\"M%.1f %.1fV%.1fH%.1f\" fill=\"none\" class=\"axis\"/>\n", x.from, y.to, y.from, x.to);
    for (m = 0; m < method_count; m++) {
        size_t n = 0;
        for (i = 0; i < all->count; i++) {
            const record *r = &all->items[i];
            if (!same_case(r, kase) || !same_metric(r, metric) || !same_method(r, methods[m]) || !(seconds(r) > 0) ||
                !(number(r, "error") >= 0)) continue;
            points[n].x = seconds(r);
            points[n++].y = number(r, "error");
        }
        if (n > 0) draw_curve(f, &x, &y, points, n, m);
    }
    free(points);
}

/* Returns 0, and writes nothing, with fewer than two metrics. */
static int overview(const list *all, const record *first, const char *path) {
    enum { MOST = 12 };
    const double wide = 280, high = 190, step_x = 370, step_y = 262, left = 70, top = 76;
    const record *kase[MOST], *metric[MOST], *method[2 * MOST];
    const int cases = firsts(all, first, same_case, kase, MOST), metrics = firsts(all, first, same_metric, metric, MOST),
        methods = firsts(all, first, same_method, method, 2 * MOST);
    int i, k;
    FILE *f;
    if (metrics < 2) return 0;
    f = open_part(path);
    svg_begin(f, (int)(left + step_x * metrics), (int)(top + step_y * cases) + 24 + 20 * ((methods + 2) / 3));
    put_label(f, left, 24, "font-size=\"16\"", get(first, "bench"), ": error (up) against time of a picture (across)");
    for (i = 0; i < metrics; i++) put_label(f, left + step_x * i, 48, "font-weight=\"bold\"", get(metric[i], "error_unit"), "");
    for (k = 0; k < cases; k++) {
        put_label(f, left, top + step_y * k - 8, "font-size=\"14\"", get(kase[k], "case"), "");
        for (i = 0; i < metrics; i++)
            panel(f, all, kase[k], metric[i], method, methods, left + step_x * i, top + step_y * k, wide, high);
    }
    for (i = 0; i < methods; i++) { /* the legend, in three columns below */
        const double x = left + step_x * metrics / 3.0 * (i % 3), y = top + step_y * cases + 20 * (i / 3);
        draw_mark(f, x, y, i, 0);
        put_label(f, x + 10, y + 4, "", get(method[i], "method"), "");
    }
    put_label(f, left, top + step_y * cases + 20 * ((methods + 2) / 3), "class=\"soft\"", "hollow: no error", "");
    fputs("</svg>\n", f);
    close_part(f, path);
    return 1;
}

/* ---- bars ---- */

static int same_bars(const record *a, const record *b) {
    return same(a, b, "bench") && same(a, b, "metric") && same(a, b, "unit");
}

static int same_bars_case(const record *a, const record *b) { return same_bars(a, b) && same(a, b, "case"); }

static void rate_bars(const list *all, const record *first, const char *path) {
    const double left = 300, wide = 380, step = 20;
    const char *last_case = NULL;
    double most = 0, y = 50;
    size_t i, count = 0;
    FILE *f = open_part(path);
    for (i = 0; i < all->count; i++) {
        if (!same_bars(&all->items[i], first)) continue;
        count++;
        if (number(&all->items[i], "value") > most) most = number(&all->items[i], "value");
    }
    svg_begin(f, 800, (int)(step * (double)count) + 70);
    put_label(f, 16, 26, "font-size=\"15\"", get(first, "bench"), "");
    put_label(f, left, 26, "", get(first, "metric"), "");
    for (i = 0; i < all->count; i++) {
        const record *r = &all->items[i];
        char name[NAME_SIZE], text[NAME_SIZE], label[2 * NAME_SIZE];
        double v = number(r, "value"), w;
        if (!same_bars(r, first)) continue;
        series_name(name, sizeof name, all, r, same_bars_case);
        value_text(text, sizeof text, r);
        if (get(r, "error")[0] != 0) {
            snprintf(label, sizeof label, "%s  (error %s %s)", text, get(r, "error"), get(r, "error_unit"));
        } else {
            snprintf(label, sizeof label, "%s", text);
        }
        w = most > 0 && v > 0 ? wide * v / most : 0;
        if (last_case == NULL || strcmp(last_case, get(r, "case")) != 0) {
            last_case = get(r, "case");
            put_label(f, 16, y + 4, "", last_case, "");
        }
        put_label(f, left - 8, y + 4, "text-anchor=\"end\" class=\"soft\"", name, "");
        fprintf(f, "<rect x=\"%.1f\" y=\"%.1f\" width=\"%.1f\" height=\"14\" fill=\"%s\"/>\n",
            left, y - 7, w, g_colors[0]);
        if (w > 0.6 * wide) put_label(f, left + w - 6, y + 4, "text-anchor=\"end\" class=\"on\"", label, "");
        else put_label(f, left + w + 6, y + 4, "", label, "");
        y += step;
    }
    fputs("</svg>\n", f);
    close_part(f, path);
}

/* ---- table ---- */

static int is_column(const char *key) {
    static const char *const keys[] = {
        "bench", "case", "metric", "value", "unit", "error", "error_unit", "method", "variant", "isa", "threads",
        "bytes", "hash"
    };
    size_t i;
    for (i = 0; i < sizeof keys / sizeof keys[0]; i++) if (strcmp(keys[i], key) == 0) return 1;
    return 0;
}

static void put_row(FILE *f, const record *r) {
    char text[NAME_SIZE], bytes[64];
    int i, any = 0;
    value_text(text, sizeof text, r);
    si(bytes, sizeof bytes, number(r, "bytes"));
    fprintf(f, "| %s | %s | %s%s | %s | %s %s | %s | %s | %s%s | %.16s |",
        get(r, "case"), get(r, "metric"), get(r, "method"), get(r, "variant"), text,
        get(r, "error"), get(r, "error_unit"), get(r, "threads"), get(r, "isa"),
        get(r, "bytes")[0] != 0 ? bytes : "", get(r, "bytes")[0] != 0 ? "B" : "", get(r, "hash"));
    for (i = 0; i < r->count; i++) {
        if (is_column(r->key[i])) continue;
        fprintf(f, "%s %s=%s", any ? "," : "", r->key[i], r->value[i]);
        any = 1;
    }
    fputs(" |\n", f);
}

static int is_first(const list *all, size_t i, int (*same_set)(const record *, const record *)) {
    size_t k;
    for (k = 0; k < i; k++) if (same_set(&all->items[k], &all->items[i])) return 0;
    return 1;
}

static int same_bench(const record *a, const record *b) { return same(a, b, "bench"); }

/* What a program wrote as its acceptance table. */
static void put_tables(FILE *f, const char *folder) {
    DIR *d = opendir(folder);
    char *names[64];
    size_t count = 0, i;
    struct dirent *e;
    if (d == NULL) fail(folder, "cannot be read");
    while ((e = readdir(d)) != NULL && count < sizeof names / sizeof names[0]) {
        const size_t n = strlen(e->d_name);
        if (n < 9 || strncmp(e->d_name, "table_", 6) != 0 || strcmp(e->d_name + n - 3, ".md") != 0) continue;
        names[count] = (char *)malloc(n + 1);
        if (names[count] == NULL) fail(folder, "no memory");
        memcpy(names[count++], e->d_name, n + 1);
    }
    closedir(d);
    qsort(names, count, sizeof names[0], by_text);
    for (i = 0; i < count; i++) {
        char path[2 * NAME_SIZE], line[1024];
        FILE *in;
        snprintf(path, sizeof path, "%s/%s", folder, names[i]);
        in = fopen(path, "rb");
        if (in == NULL) fail(path, "cannot be read");
        fprintf(f, "\n## %.*s: what was asked for\n\n", (int)(strlen(names[i]) - 9), names[i] + 6);
        while (fgets(line, sizeof line, in) != NULL) fputs(line, f);
        fclose(in);
        free(names[i]);
    }
}

static void write_report(const list *all, const char *folder) {
    char path[NAME_SIZE], name[NAME_SIZE], svg[2 * NAME_SIZE];
    size_t i, k;
    int plots = 0, p;
    FILE *f;
    snprintf(path, sizeof path, "%s/report.md", folder);
    f = open_part(path);
    fputs("# Benchmarks\n\n", f);
    for (i = 0; i < all->count; i++) {
        const record *r = &all->items[i];
        if (get(r, "metric")[0] != 0) continue;
        fputs("-", f);
        for (p = 0; p < r->count; p++) fprintf(f, "%s %s: %s", p != 0 ? ";" : "", r->key[p], r->value[p]);
        fputs("\n", f);
    }
    put_tables(f, folder);
    for (i = 0; i < all->count; i++) {
        if (get(&all->items[i], "metric")[0] == 0 || !is_first(all, i, same_bench)) continue;
        fprintf(f, "\n## %s\n\n", get(&all->items[i], "bench"));
        k = strlen(get(&all->items[i], "bench"));
        if (k > 6 && strcmp(get(&all->items[i], "bench") + k - 6, ".error") == 0) {
            file_name(name, sizeof name, "overview_%s.svg", get(&all->items[i], "bench"));
            snprintf(svg, sizeof svg, "%s/%s", folder, name);
            if (overview(all, &all->items[i], svg)) {
                fprintf(f, "![time against error](%s)\n", name);
                plots++;
            }
        }
        for (k = i; k < all->count; k++) {
            const record *r = &all->items[k];
            if (!same_bench(r, &all->items[i]) || get(r, "metric")[0] == 0) continue;
            if (is_rate(r) && is_first(all, k, same_bars)) {
                file_name(name, sizeof name, "rate_%s_%s.svg", get(r, "bench"), get(r, "metric"));
                snprintf(svg, sizeof svg, "%s/%s", folder, name);
                rate_bars(all, r, svg);
                fprintf(f, "![%s](%s)\n", get(r, "metric"), name);
                plots++;
            }
            if (is_first(all, k, same_group)) {
                file_name(name, sizeof name, "error_%s_%s_%s.svg", get(r, "bench"), get(r, "case"), get(r, "metric"));
                snprintf(svg, sizeof svg, "%s/%s", folder, name);
                if (error_plot(all, r, svg)) {
                    fprintf(f, "![%s, time against error](%s)\n", get(r, "case"), name);
                    plots++;
                }
            }
        }
        fputs("\n| case | metric | method | value | error | threads | isa | bytes | hash | more |\n"
            "| --- | --- | --- | ---: | ---: | ---: | --- | ---: | --- | --- |\n", f);
        for (k = i; k < all->count; k++) {
            const record *r = &all->items[k];
            if (same_bench(r, &all->items[i]) && get(r, "metric")[0] != 0) put_row(f, r);
        }
    }
    close_part(f, path);
    printf("%s: %lu lines, %d pictures\n", path, (unsigned long)all->count, plots);
}

int main(int argc, char **argv) {
    list all;
    size_t i;
    if (argc > 2 || (argc == 2 && argv[1][0] == '-')) {
        fprintf(stderr, "usage: report [FOLDER with *.jsonl]\n");
        return 2;
    }
    memset(&all, 0, sizeof all);
    read_folder(&all, argc == 2 ? argv[1] : "build/bench");
    write_report(&all, argc == 2 ? argv[1] : "build/bench");
    for (i = 0; i < all.count; i++) free(all.items[i].line);
    free(all.items);
    return 0;
}
