/* table.c - tables out of the lines of the peer programs - MIT OR Unlicense, see LICENSE

   peer_table FILE.jsonl > FILE.md

   First the targets, each judged once, by the lines of one program. Then the rows: a row is a task and one peer; of several
   ways that a peer has the fastest is shown. Columns of one thread are seconds of the processor, of two threads seconds of
   the clock. Last a list of all rows in which ours is the worse one, and in what. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define NONE (-1.0)

enum { LINE_MOST = 4096, LINES_MOST = 4096, UNITS_MOST = 26, PLACES = 2 };

/* ---- targets ---- */

typedef enum judged { JUDGE_HIGH, JUDGE_LOW, JUDGE_TIMES, JUDGE_PICTURE, JUDGE_CLEANER } judged;
/* HIGH, LOW: the value. TIMES: so many times better than the fastest way of the peer. PICTURE: LOW, and the picture has a
   PSNR of 30 dB and less than 0.1 % holes. CLEANER: LOW, and for the goal a smaller error than that of every peer */

typedef struct target {
    const char *id, *part;    /* part of the task's name, with $ its end; of several tasks the worst counts */
    const char *program;      /* whose lines count; NULL: there is none */
    judged how;
    double base, goal;        /* NONE: there is none */
    int threads;              /* of the lines that count */
    const char *others;       /* measured before on such a machine, not in this run */
} target;

static const target g_targets[] = {
    {"V1", "blob 512, camera", "embree_voxrt", JUDGE_HIGH, 24e6, 56e6, 1, "VoxelRT 18.7 M/s"},
    {"V1", "hall 512, camera", "embree_voxrt", JUDGE_HIGH, 19e6, 43e6, 1, "VoxelRT 14.4 M/s"},
    {"V2", "blob 1024, camera", "embree_voxrt", JUDGE_HIGH, 17.6e6, 40e6, 1, "VoxelRT 11.7 M/s"},
    {"V2", "hall 1024, camera", "embree_voxrt", JUDGE_HIGH, 16.1e6, 37.5e6, 1, "VoxelRT 10.7 M/s"},
    {"V2", "1024, camera", "embree_voxrt", JUDGE_TIMES, NONE, 2, 1, "Embree, 16 rays: 17 to 19 M/s"},
    {"V3", "blob 2048, camera", "embree_voxrt", JUDGE_HIGH, 12e6, 36e6, 1, "ESVO in C 3.0 M/s"},
    {"V3", "hall 2048, camera", "embree_voxrt", JUDGE_HIGH, 8.2e6, 25e6, 1, "ESVO in C 2.05 M/s"},
    {"V4", "blob 512, diffuse", "embree_voxrt", JUDGE_HIGH, 12.6e6, 21e6, 1, "VoxelRT 10.5 M/s"},
    {"V4", "blob 1024, diffuse", "embree_voxrt", JUDGE_HIGH, 10.2e6, 17e6, 1, "VoxelRT 6.8 M/s"},
    {"V4", "blob 2048, diffuse", "embree_voxrt", JUDGE_HIGH, NONE, 14e6, 1, "ESVO in C 1.77 M/s"},
    {"V5", "blob 2048, random", "embree_voxrt", JUDGE_HIGH, 2.94e6, 8e6, 1, "ESVO in C 0.98 M/s"},
    {"V6", "blob 1024, diffuse", "embree_voxrt", JUDGE_TIMES, 2, 4, 1, "tinybvh 4.06 M/s"},
    {"V7", "geometry$", "vdb_voxrt", JUDGE_LOW, 0.8, 0.55, 1, "ESVO in C 2.62 B, svo_builder 31.9 B"},
    {"V7", "equal parts once", "vdb_voxrt", JUDGE_LOW, 0.8, 0.25, 1, "ESVO in C 2.62 B"},
    {"V8", "blob 1024, file with colours and normals$", "vdb_voxrt", JUDGE_LOW, 3.6, 2.0, 2, "svo_builder 74 B, ESVO 5 B"},
    {"V8", "blob 1024, file with colours and normals, ours with 256 colours", "vdb_voxrt", JUDGE_LOW, 3.6, 2.0, 2, "svo_builder 74 B"},
    {"V9", "1024^3", "vdb_voxrt", JUDGE_LOW, 1.0, 0.3, 2, "svo_builder 4.5 s, obj2voxel 14.7 s"},
    {"V10", "256^3$", "embree_voxrt", JUDGE_LOW, 0.060, 0.020, 1, ""},
    {"V11", "blob", "embree_voxrt", JUDGE_LOW, 0.4, 0.14, 1, ""},
    {"V11", "hall", "embree_voxrt", JUDGE_LOW, 0.4, 0.19, 1, ""},
    {"V12", "wrong cells", "vdb_voxrt", JUDGE_LOW, 0, 0, 1, "VoxelRT misses 673 to 9,470"},
    {"V12", "that get out", "embree_voxrt", JUDGE_LOW, NONE, 0, 1, ""},
    {"V12", "bits", "vdb_voxrt", JUDGE_LOW, NONE, 0, 1, ""},
    {"Z1", "", "osmesa_zbufrand", JUDGE_HIGH, 40e6, 150e6, 1, "Open3D 18 M/s, trimesh 1.6 M/s"},
    {"Z2", "samples of blob", "osmesa_zbufrand", JUDGE_HIGH, 100e6, 300e6, 1, ""},
    {"Z3", "frame of blob, 8.4 M triangles$", "embree_zbufrand", JUDGE_PICTURE, 0.120, 0.030, 1, "MaskedOcclusionCulling, depth alone 227 ms"},
    {"Z3", "Gaussian", "embree_zbufrand", JUDGE_PICTURE, 0.120, 0.030, 1, "MaskedOcclusionCulling, depth alone 227 ms"},
    {"Z3", "hall, 8.4 M triangles, our default", "osmesa_zbufrand", JUDGE_PICTURE, 0.120, 0.030, 1, "MaskedOcclusionCulling, depth alone 207 ms"},
    {"Z4", "", "embree_zbufrand", JUDGE_CLEANER, 0.250, 0.060, 1, ""},
    {"Z5", "", "embree_zbufrand", JUDGE_LOW, 4, 2, 1, ""},
    {"Z6", "", "embree_zbufrand", JUDGE_LOW, 48, 24, 1, ""},
    {"Z7", "", "embree_zbufrand", JUDGE_LOW, 0.6, 0.15, 1, "tinybvh 0.3 s"},
    {"Z8", "", "embree_zbufrand", JUDGE_LOW, 2e-3, 2e-4, 1, ""},
    {"Z9", "chi squared of 10^8", "osmesa_zbufrand", JUDGE_LOW, 3, 3, 1, ""},
    {"Z9", "mean of frames", "osmesa_zbufrand", JUDGE_HIGH, 0.45, 0.45, 1, ""},
    {"Z9", "prefix", "osmesa_zbufrand", JUDGE_LOW, NONE, 3, 1, ""},
    {"T1", "", "vtk_tetcast", JUDGE_LOW, 0.10, 0.045, 1, "Open VKL 0.37 s, sampled"},
    {"T2", "", "vtk_tetcast", JUDGE_LOW, 0.18, 0.10, 1, "Open VKL 0.97 s, sampled"},
    {"T3", "", "vtk_tetcast", JUDGE_LOW, 0.5, 0.22, 1, "Open VKL 2.4 s, sampled"},
    {"T4", "", "vtk_tetcast", JUDGE_HIGH, 1.5, 3, 1, "VTK has none"},
    {"T5", "default", "vtk_tetcast", JUDGE_LOW, 28, 20, 1, "Open VKL 256 to 350 B"},
    {"T5", "what rays need", "vtk_tetcast", JUDGE_LOW, 28, 20, 1, "Open VKL 256 to 350 B"},
    {"T5", "strips", "vtk_tetcast", JUDGE_LOW, NONE, 12, 1, "VTK has none"},
    {"T6", "", "vtk_tetcast", JUDGE_LOW, 0.25, 0.08, 1, "Open VKL 10 s"},
    {"T7", "K32", "vtk_tetcast", JUDGE_HIGH, 1.5e6, 5e6, 1, "Open VKL 0.33 M/s; VTK has none"},
    {"T7", "D31k", "vtk_tetcast", JUDGE_HIGH, 1.5e6, 2.5e6, 1, "Open VKL 1.2 k/s; VTK has none"},
    {"T8", "", "vtk_tetcast", JUDGE_HIGH, 40e6, 120e6, 1, ""},
    {"T9", "", "vtk_tetcast", JUDGE_HIGH, 40e6, 150e6, 1, "Open VKL 1.8 to 19 M/s"},
    {"T10", "", "vtk_tetcast", JUDGE_LOW, 400e6, 250e6, 1, ""},
    {"T11", "PSNR", "vtk_tetcast", JUDGE_HIGH, 45, 60, 1, ""},
    {"T11", "pixels", "vtk_tetcast", JUDGE_LOW, 0, 0, 1, ""},
    {"T12", "", "vtk_tetcast", JUDGE_HIGH, NONE, 100e6, 1, "Radiant Foam: on graphics cards only; VTK has none"}
};
enum { TARGETS = (int)(sizeof g_targets / sizeof g_targets[0]) };

/* ---- lines ---- */

typedef struct line {
    char id[64], task[128], unit[16], error_unit[128], peer[96], method[128], program[64], isa[32];
    double value, error, holes, bytes, each, times, least, most;
    int threads, rounds, ours;
} line;

typedef struct skip { char program[64], why[160]; } skip;

static line g_lines[LINES_MOST];
static int g_line_count;
static skip g_skips[32];
static int g_skip_count;
static char g_compiler[256], g_flags[256], g_cpu[256], g_cores[16], g_headers[256], g_isas[256];
static char g_units[UNITS_MOST][128];
static int g_unit_count;

/* The text after "key": of a flat object; NULL: not there. */
static const char *find(const char *text, const char *key) {
    char quoted[64];
    const char *p;
    snprintf(quoted, sizeof quoted, "\"%s\":", key);
    p = strstr(text, quoted);
    return p != NULL ? p + strlen(quoted) : NULL;
}

static void get_text(const char *text, const char *key, char *out, size_t size) {
    const char *p = find(text, key);
    size_t n = 0;
    out[0] = 0;
    if (p == NULL || *p++ != '"') return;
    for (; *p != 0 && *p != '"' && n + 1 < size; p++) {
        if (*p == '\\' && p[1] != 0) p++;
        out[n++] = *p;
    }
    out[n] = 0;
}

static double get_number(const char *text, const char *key) {
    const char *p = find(text, key);
    char *end;
    double v;
    if (p == NULL) return (double)NAN;
    v = strtod(p, &end);
    return end != p ? v : (double)NAN;
}

/* Append a word that is not there yet. */
static void add_word(char *list, size_t size, const char *word) {
    const size_t n = strlen(list);
    if (word[0] != 0 && strstr(list, word) == NULL) snprintf(list + n, size - n, "%s%s", n > 0 ? ", " : "", word);
}

static void read_program(const char *text, char *program, size_t size) {
    static const char start[] = "bench_peers_";
    char name[64];
    get_text(text, "program", name, sizeof name);
    snprintf(program, size, "%s", strncmp(name, start, sizeof start - 1) == 0 ? name + sizeof start - 1 : name);
    if (g_compiler[0] != 0) return;
    get_text(text, "compiler", g_compiler, sizeof g_compiler);
    get_text(text, "flags", g_flags, sizeof g_flags);
    get_text(text, "cpu", g_cpu, sizeof g_cpu);
    snprintf(g_cores, sizeof g_cores, "%.0f", get_number(text, "cores"));
}

static void read_line(const char *text) {
    static char program[64];
    char bench[80], side[16], header[96];
    line *l;
    get_text(text, "bench", bench, sizeof bench);
    get_text(text, "header", header, sizeof header);
    add_word(g_headers, sizeof g_headers, header);
    if (find(text, "program") != NULL) read_program(text, program, sizeof program);
    if (strncmp(bench, "peers.", 6) != 0) return;
    if (find(text, "skipped") != NULL) {
        if (g_skip_count == (int)(sizeof g_skips / sizeof g_skips[0])) return;
        snprintf(g_skips[g_skip_count].program, sizeof g_skips[0].program, "%.63s", bench + 6);
        get_text(text, "skipped", g_skips[g_skip_count].why, sizeof g_skips[0].why);
        g_skip_count++;
        return;
    }
    if (g_line_count == LINES_MOST) return;
    l = &g_lines[g_line_count++];
    snprintf(l->id, sizeof l->id, "%.63s", bench + 6);
    memcpy(l->program, program, sizeof l->program);
    get_text(text, "case", l->task, sizeof l->task);
    get_text(text, "unit", l->unit, sizeof l->unit);
    get_text(text, "error_unit", l->error_unit, sizeof l->error_unit);
    get_text(text, "peer", l->peer, sizeof l->peer);
    get_text(text, "method", l->method, sizeof l->method);
    get_text(text, "isa", l->isa, sizeof l->isa);
    get_text(text, "side", side, sizeof side);
    l->ours = strcmp(side, "ours") == 0;
    l->value = get_number(text, "value");
    l->error = get_number(text, "error");
    l->holes = get_number(text, "holes");
    l->bytes = get_number(text, "bytes");
    l->each = get_number(text, "bytes_each");
    l->times = get_number(text, "times");
    l->least = get_number(text, "times_least");
    l->most = get_number(text, "times_most");
    l->threads = (int)get_number(text, "threads");
    l->rounds = (int)get_number(text, "rounds");
    if (l->ours) add_word(g_isas, sizeof g_isas, l->isa);
}

/* ---- cells ---- */

static void show(char *out, size_t size, double v, const char *unit) {
    if (v - v != 0) snprintf(out, size, "-");
    else if (strcmp(unit, "1/s") == 0) snprintf(out, size, v >= 1e6 ? "%.3g M/s" : "%.3g k/s", v >= 1e6 ? 1e-6 * v : 1e-3 * v);
    else if (strcmp(unit, "s") == 0 && v >= 1.0) snprintf(out, size, "%.2f s", v);
    else if (strcmp(unit, "s") == 0 && v >= 1e-3) snprintf(out, size, "%.3g ms", 1e3 * v);
    else if (strcmp(unit, "s") == 0) snprintf(out, size, "%.3g us", 1e6 * v);
    else if (strcmp(unit, "B") == 0 && v >= 1e9) snprintf(out, size, "%.2f GB", 1e-9 * v);
    else if (strcmp(unit, "B") == 0 && v >= 1e6) snprintf(out, size, "%.3g MB", 1e-6 * v);
    else if (strcmp(unit, "B") == 0 && v >= 1e3) snprintf(out, size, "%.3g kB", 1e-3 * v);
    else if (v >= 1e3) snprintf(out, size, "%.0f%s%s", v, unit[0] != 0 ? " " : "", unit);
    else snprintf(out, size, "%.3g%s%s", v, unit[0] != 0 ? " " : "", unit);
}

static void show_pair(double ours, double theirs, const char *unit) {
    char a[40], b[40];
    show(a, sizeof a, ours, unit);
    show(b, sizeof b, theirs, unit);
    printf(" %s / %s", a, b);
}

static char unit_letter(const char *unit) {
    int i;
    for (i = 0; i < g_unit_count; i++) if (strcmp(g_units[i], unit) == 0) return (char)('a' + i);
    if (g_unit_count == UNITS_MOST) return '?';
    snprintf(g_units[g_unit_count], sizeof g_units[0], "%s", unit);
    return (char)('a' + g_unit_count++);
}

static int lower_is_better(const line *l) { return strcmp(l->unit, "1/s") != 0 && strcmp(l->unit, "dB") != 0; }

static int same_task(const line *a, const line *b) { return strcmp(a->id, b->id) == 0 && strcmp(a->task, b->task) == 0; }

/* The fastest way that `peer` has with `threads`, beside the line of ours that was measured with it. peer "": ours alone. */
static const line *fastest(const line *of, const char *peer, int threads, const line **ours) {
    const line *best = NULL, *own = NULL;
    int i;
    *ours = NULL;
    for (i = 0; i < g_line_count; i++) {
        const line *l = &g_lines[i];
        if (!same_task(l, of) || l->threads != threads) continue;
        if (l->ours) {
            own = l;
            if (peer[0] == 0) *ours = l;
            continue;
        }
        if (strcmp(l->peer, peer) != 0) continue;
        if (best != NULL && (lower_is_better(l) ? !(l->value < best->value) : !(l->value > best->value))) continue;
        best = l;
        *ours = own;
    }
    return best;
}

static void show_times(char *out, size_t size, const line *theirs) {
    if (theirs == NULL || theirs->times - theirs->times != 0) snprintf(out, size, "-");
    else if (theirs->most > theirs->least) {
        snprintf(out, size, theirs->times < 1.0 ? "**%.2f** (%.2f to %.2f)" : "%.3g (%.3g to %.3g)", theirs->times, theirs->least, theirs->most);
    } else snprintf(out, size, theirs->times < 1.0 ? "**%.2f**" : "%.3g", theirs->times);
}

/* ---- judging targets ---- */

static int counts_for(const target *t, const line *l) {
    const size_t n = strlen(t->part), m = strlen(l->task);
    if (t->program == NULL || strcmp(t->id, l->id) != 0 || strcmp(t->program, l->program) != 0) return 0;
    if (n > 0 && t->part[n - 1] == '$') return m >= n - 1 && strncmp(l->task + m - (n - 1), t->part, n - 1) == 0;
    return strstr(l->task, t->part) != NULL;
}

/* What a target is judged by: the worst line; its value, or for TIMES its times. n: how many lines. */
typedef struct verdict { const line *of; double value; int picture, n; } verdict;

static verdict judge(const target *t) {
    verdict v = {NULL, (double)NAN, 1, 0};
    int i, k;
    for (i = 0; i < g_line_count; i++) {
        const line *l = &g_lines[i], *ours;
        double value = t->how == JUDGE_TIMES ? (double)NAN : l->value;
        if (!l->ours || l->threads != t->threads || !counts_for(t, l)) continue;
        for (k = i + 1; k < g_line_count; k++) {
            const line *theirs = &g_lines[k];
            if (theirs->ours || !same_task(theirs, l) || fastest(l, theirs->peer, t->threads, &ours) != theirs || ours != l) continue;
            if (t->how == JUDGE_TIMES && !(theirs->times >= value)) value = theirs->times;
            if (t->how == JUDGE_CLEANER && !(l->error < theirs->error)) v.picture = 0;
        }
        if (t->how == JUDGE_PICTURE && !(l->error <= 0.0316228 && l->holes < 0.1)) v.picture = 0; /* 30 dB; % */
        v.n++;
        if (v.of != NULL && (t->how == JUDGE_HIGH || t->how == JUDGE_TIMES ? !(value < v.value) : !(value > v.value))) continue;
        v.of = l;
        v.value = value;
    }
    return v;
}

static int met(const target *t, const verdict *v, int goal) {
    const double bound = goal ? t->goal : t->base;
    if (t->how == JUDGE_HIGH || t->how == JUDGE_TIMES) return v->value >= bound;
    return v->value <= bound && (v->picture || (t->how == JUDGE_CLEANER && !goal));
}

static const char *why_not(const target *t) {
    int i;
    for (i = 0; t->program != NULL && i < g_skip_count; i++) if (strcmp(g_skips[i].program, t->program) == 0) return g_skips[i].why;
    return t->program == NULL ? t->others : "not run";
}

enum { SAID_NO, SAID_YES, SAID_NOTHING };
static const char *const g_said[3] = {"no", "yes", "not answered"};

static void show_targets(void) {
    int count[2][3] = {{0, 0, 0}, {0, 0, 0}}, i, k;
    printf("| target | judged by | threads | ours | base | goal | base met | goal met | measured before, not here |\n"
           "| --- | --- | ---: | ---: | ---: | ---: | --- | --- | --- |\n");
    for (i = 0; i < TARGETS; i++) {
        const target *t = &g_targets[i];
        const verdict v = judge(t);
        const double bound[2] = {t->base, t->goal};
        const char *unit = v.of == NULL ? "" : t->how == JUDGE_TIMES ? "times" : v.of->unit;
        char cell[40];
        if (v.of == NULL) {
            printf("| %s | %.*s%s%s | - | - | - | - |", t->id, (int)strcspn(t->part, "$"), t->part, t->part[0] != 0 ? ": " : "", why_not(t));
        } else {
            show(cell, sizeof cell, v.value, unit);
            printf("| %s | %s%s", t->id, v.of->task, t->how == JUDGE_TIMES ? ", times the fastest of the peer" : "");
            if (v.n > 1) printf(", worst of %d", v.n);
            if (t->how == JUDGE_PICTURE) printf("; PSNR %.1f dB, holes %.2g %%", -20.0 * log10(v.of->error), v.of->holes);
            if (t->how == JUDGE_CLEANER) printf("; error %s", v.picture ? "smaller than the peer's" : "not smaller than the peer's");
            printf(" | %d | %s |", t->threads, cell);
            for (k = 0; k < 2; k++) {
                show(cell, sizeof cell, bound[k] < 0 ? (double)NAN : bound[k], unit);
                printf(" %s |", cell);
            }
        }
        for (k = 0; k < 2; k++) {
            const int said = v.of == NULL ? SAID_NOTHING : met(t, &v, k) ? SAID_YES : SAID_NO;
            printf(" %s |", bound[k] < 0 ? "-" : g_said[said]);
            if (!(bound[k] < 0)) count[k][said]++;
        }
        printf(" %s |\n", t->program != NULL ? t->others : "");
    }
    for (k = 0; k < 2; k++)
        printf("%s met %d, missed %d, not answered %d", k == 0 ? "\nBase:" : "; goal:", count[k][SAID_YES], count[k][SAID_NO],
               count[k][SAID_NOTHING]);
    printf(".\n");
}

/* ---- where ours is the worse one ---- */

enum { LOST_VALUE, LOST_MEMORY, LOST_EACH, LOST_ERROR, LOST_KINDS };
static int g_rows, g_rows_lost, g_lost[LOST_KINDS]; /* rows with a peer; of those, with some loss; by kind */
static char g_list[1 << 16];                        /* the rows with a loss, to be shown at the end */
static size_t g_list_length;

static void list_add(const char *text) {
    const int n = snprintf(g_list + g_list_length, sizeof g_list - g_list_length, "%s", text);
    if (n > 0) g_list_length += (size_t)n;
    if (g_list_length >= sizeof g_list) {
        fputs("the list of losses is too long\n", stderr);
        exit(1);
    }
}

/* More than theirs, as far as it is shown. */
static int is_more(double ours, double theirs, const char *unit) {
    char a[40], b[40];
    show(a, sizeof a, ours, unit);
    show(b, sizeof b, theirs, unit);
    return ours > theirs && strcmp(a, b) != 0;
}

static void list_pair(const char *what, double ours, double theirs, const char *unit, const char *more) {
    char a[40], b[40], text[400];
    show(a, sizeof a, ours, unit);
    show(b, sizeof b, theirs, unit);
    snprintf(text, sizeof text, "; %s %s against %s%s%s%s", what, a, b, more[0] != 0 ? " (" : "", more, more[0] != 0 ? ")" : "");
    list_add(text);
}

static void count_losses(const line *const *ours, const line *const *theirs, int at) {
    const line *o = ours[at], *t = theirs[at];
    int lost[LOST_KINDS] = {0, 0, 0, 0}, slower[PLACES], i, any = 0;
    char text[400];
    for (i = 0; i < PLACES; i++) {
        slower[i] = 0;
        if (ours[i] == NULL || theirs[i] == NULL) continue;
        if (theirs[i]->times - theirs[i]->times == 0) slower[i] = theirs[i]->times < 1.0;
        else slower[i] = lower_is_better(ours[i]) ? ours[i]->value > theirs[i]->value : ours[i]->value < theirs[i]->value;
        lost[LOST_VALUE] |= slower[i];
    }
    lost[LOST_MEMORY] = is_more(o->bytes, t->bytes, "B");
    lost[LOST_EACH] = is_more(o->each, t->each, "");
    lost[LOST_ERROR] = is_more(o->error, t->error, "");
    g_rows++;
    for (i = 0; i < LOST_KINDS; i++) {
        g_lost[i] += lost[i];
        any |= lost[i];
    }
    g_rows_lost += any;
    if (!any) return;
    snprintf(text, sizeof text, "- %s%s%s (%s)", strlen(o->id) > 1 ? o->id : "", strlen(o->id) > 1 ? " " : "", o->task, t->peer);
    list_add(text);
    for (i = 0; i < PLACES; i++)
        if (slower[i]) list_pair(i == 0 ? "one thread" : "two threads", ours[i]->value, theirs[i]->value, o->unit, "");
    if (lost[LOST_MEMORY]) list_pair("memory", o->bytes, t->bytes, "B", "");
    if (lost[LOST_EACH]) list_pair("bytes each", o->each, t->each, "", "");
    if (lost[LOST_ERROR]) list_pair("error", o->error, t->error, "", o->error_unit);
    list_add("\n");
}

/* ---- rows ---- */

/* One task against one peer; peer "": nobody. */
static void row(const line *of, const char *peer) {
    const line *theirs[PLACES], *ours[PLACES], *one_ours, *one_theirs;
    char a[40], b[40], c[64];
    int i, at, rounds;
    for (i = 0; i < PLACES; i++) theirs[i] = fastest(of, peer, i + 1, &ours[i]);
    at = ours[0] != NULL ? 0 : 1;
    one_ours = ours[at];
    one_theirs = theirs[at];
    if (one_ours == NULL) return;
    printf("| %s | %s | %s | %s", strlen(of->id) > 1 ? of->id : "", of->task, one_ours->method, peer[0] != 0 ? peer : "nobody here");
    if (one_theirs != NULL && strstr(peer, one_theirs->method) == NULL) printf(", %s", one_theirs->method);
    printf(" |");
    for (i = 0; i < PLACES; i++) {
        show(a, sizeof a, ours[i] != NULL ? ours[i]->value : (double)NAN, of->unit);
        show(b, sizeof b, theirs[i] != NULL ? theirs[i]->value : (double)NAN, of->unit);
        show_times(c, sizeof c, theirs[i]);
        printf(" %s | %s | %s |", a, b, c);
    }
    for (i = 0; i < PLACES; i++) {
        rounds = ours[i] == NULL ? 0 : ours[i]->rounds;
        if (theirs[i] != NULL && theirs[i]->rounds < rounds) rounds = theirs[i]->rounds;
        printf(rounds > 0 ? "%s%d" : "%s-", i == 0 ? " " : " / ", rounds);
    }
    printf(" |");
    show_pair(one_ours->bytes, one_theirs != NULL ? one_theirs->bytes : (double)NAN, "B");
    printf(" |");
    show_pair(one_ours->each, one_theirs != NULL ? one_theirs->each : (double)NAN, "");
    printf(" |");
    show_pair(one_ours->error, one_theirs != NULL ? one_theirs->error : (double)NAN, "");
    printf(" (%c) |\n", unit_letter(one_ours->error_unit));
    if (one_theirs != NULL) count_losses(ours, theirs, at);
}

/* All peers of a task, at its first line. */
static void rows_of(int first) {
    const char *seen[32];
    int i, k, count = 0;
    for (i = 0; i < first; i++) if (same_task(&g_lines[i], &g_lines[first])) return;
    for (i = first; i < g_line_count; i++) {
        const line *l = &g_lines[i];
        if (l->ours || !same_task(l, &g_lines[first])) continue;
        for (k = 0; k < count; k++) if (strcmp(seen[k], l->peer) == 0) break;
        if (k < count || count == 32) continue;
        seen[count++] = l->peer;
        row(l, l->peer);
    }
    if (count == 0) row(&g_lines[first], "");
}

static void show_rows(void) {
    int i, k;
    printf("| target | task | ours | peer | ours, 1 thread | theirs | times | ours, 2 threads | theirs | times | rounds | memory | "
           "bytes each | error |\n"
           "| --- | --- | --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |\n");
    for (k = 0; k < TARGETS; k++) {
        if (k > 0 && strcmp(g_targets[k].id, g_targets[k - 1].id) == 0) continue;
        for (i = 0; i < g_line_count; i++) if (strcmp(g_lines[i].id, g_targets[k].id) == 0) rows_of(i);
    }
    for (i = 0; i < g_line_count; i++) if (strlen(g_lines[i].id) == 1) rows_of(i);
    for (i = 0; i < g_skip_count; i++) printf("| | | | %s | - | - | - | - | - | - | - | - | - | - |\n", g_skips[i].why);
}

int main(int argc, char **argv) {
    static char text[LINE_MOST];
    FILE *f = argc == 2 ? fopen(argv[1], "r") : NULL;
    int i;
    if (f == NULL) {
        fprintf(stderr, "usage: %s FILE.jsonl > FILE.md\n", argv[0]);
        return 2;
    }
    while (fgets(text, sizeof text, f) != NULL) read_line(text);
    fclose(f);
    printf("%s, %s cores; %s, `%s`; instruction sets of ours: %s; %s. Peers as the system packages them.\n\n", g_cpu, g_cores, g_compiler,
           g_flags, g_isas, g_headers);
    printf("### Targets\n\n");
    show_targets();
    printf("\n### Rows\n\n");
    show_rows();
    printf("\nErrors, ours / theirs:\n\n");
    for (i = 0; i < g_unit_count; i++) printf("- (%c) %s\n", 'a' + i, g_units[i]);
    printf("\n### Where ours is the worse one\n\n");
    printf("%d rows have both sides. Ours is slower, or has the worse number in the columns of times, in %d of them; it needs more "
           "memory in %d, more bytes each in %d, has the larger error in %d. These are the %d rows with one or more of these losses, ours first:\n\n",
           g_rows, g_lost[LOST_VALUE], g_lost[LOST_MEMORY], g_lost[LOST_EACH], g_lost[LOST_ERROR], g_rows_lost);
    fputs(g_list, stdout);
    return ferror(stdout) || fflush(stdout) != 0;
}
