/* table.c - one table out of the lines of the peer programs - MIT OR Unlicense, see LICENSE

   peer_table FILE.jsonl > FILE.md

   A row is a task and one peer: of several ways that a peer has the fastest is shown. Every target has a row, also where no
   peer is installed or packaged. Columns of one thread are seconds of the processor, of two threads seconds of the clock. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define NONE (-1.0)

enum { LINE_MOST = 4096, LINES_MOST = 4096, UNITS_MOST = 26, PLACES = 2 };

/* ---- targets ---- */

typedef enum judged { JUDGE_NONE, JUDGE_HIGH, JUDGE_LOW, JUDGE_TIMES } judged; /* TIMES: at least as many times better */

typedef struct target {
    const char *id, *part;    /* part of the task's name; "" all of that id */
    const char *program;      /* that measures it */
    judged how;
    double base, goal;        /* NONE: there is none */
    int threads;              /* of the column that is judged */
    const char *others;       /* measured before on such a machine, not in this run */
} target;

static const target g_targets[] = {
    {"V1", "blob 512, camera", "embree_voxrt", JUDGE_HIGH, 24e6, 56e6, 1, "VoxelRT 18.7 M/s"},
    {"V1", "hall 512, camera", "embree_voxrt", JUDGE_HIGH, 19e6, 43e6, 1, "VoxelRT 14.4 M/s"},
    {"V2", "blob 1024, camera", "embree_voxrt", JUDGE_HIGH, 17.6e6, 40e6, 1, "VoxelRT 11.7 M/s"},
    {"V2", "hall 1024, camera", "embree_voxrt", JUDGE_HIGH, 16.1e6, 37.5e6, 1, "VoxelRT 10.7 M/s"},
    {"V3", "blob 2048, camera", "embree_voxrt", JUDGE_HIGH, 12e6, 36e6, 1, "ESVO in C 3.0 M/s"},
    {"V3", "hall 2048, camera", "embree_voxrt", JUDGE_HIGH, 8.2e6, 25e6, 1, "ESVO in C 2.05 M/s"},
    {"V4", "blob 512, diffuse", "embree_voxrt", JUDGE_HIGH, 12.6e6, 21e6, 1, "VoxelRT 10.5 M/s"},
    {"V4", "blob 1024, diffuse", "embree_voxrt", JUDGE_HIGH, 10.2e6, 17e6, 1, "VoxelRT 6.8 M/s"},
    {"V4", "blob 2048, diffuse", "embree_voxrt", JUDGE_HIGH, NONE, 14e6, 1, "ESVO in C 1.77 M/s"},
    {"V5", "blob 2048, random", "embree_voxrt", JUDGE_HIGH, 2.94e6, 8e6, 1, "ESVO in C 0.98 M/s"},
    {"V6", "", "embree_voxrt", JUDGE_TIMES, 2, 4, 1, "tinybvh 4.06 M/s"},
    {"V7", "equal parts once", "vdb_voxrt", JUDGE_LOW, 0.8, 0.25, 1, "ESVO in C 2.62 B"},
    {"V7", "", "vdb_voxrt", JUDGE_LOW, 0.8, 0.55, 1, "ESVO in C 2.62 B, svo_builder 31.9 B"},
    {"V8", "", "vdb_voxrt", JUDGE_LOW, 3.6, 2.0, 1, "svo_builder 74 B, ESVO 5 B"},
    {"V9", "1024", "vdb_voxrt", JUDGE_LOW, 1.0, 0.3, 2, "svo_builder 4.5 s, obj2voxel 14.7 s"},
    {"V10", "", "embree_voxrt", JUDGE_LOW, 0.060, 0.020, 1, ""},
    {"V11", "blob", "embree_voxrt", JUDGE_LOW, 0.4, 0.14, 1, ""},
    {"V11", "hall", "embree_voxrt", JUDGE_LOW, 0.4, 0.19, 1, ""},
    {"V12", "", "embree_voxrt", JUDGE_LOW, 0, 0, 1, "VoxelRT misses 673 to 9,470"},
    {"Z1", "", "osmesa_zbufrand", JUDGE_HIGH, 40e6, 150e6, 1, "Open3D 18 M/s, trimesh 1.6 M/s"},
    {"Z2", "", "osmesa_zbufrand", JUDGE_HIGH, 100e6, 300e6, 1, ""},
    {"Z3", "8.4 M", "embree_zbufrand", JUDGE_LOW, 0.120, 0.030, 1, "MaskedOcclusionCulling, depth alone 227 ms"},
    {"Z3", "Gaussian", "embree_zbufrand", JUDGE_LOW, 0.120, 0.030, 1, "MaskedOcclusionCulling, depth alone 227 ms"},
    {"Z4", "", "embree_zbufrand", JUDGE_LOW, 0.250, 0.060, 1, ""},
    {"Z5", "", "embree_zbufrand", JUDGE_LOW, 4, 2, 1, ""},
    {"Z6", "", "embree_zbufrand", JUDGE_LOW, 48, 24, 1, ""},
    {"Z7", "", "embree_zbufrand", JUDGE_LOW, 0.6, 0.15, 1, "tinybvh 0.3 s"},
    {"Z8", "", "embree_zbufrand", JUDGE_LOW, 2e-3, 2e-4, 1, ""},
    {"Z9", "", "osmesa_zbufrand", JUDGE_LOW, 3, 3, 1, ""},
    {"T1", "", "vtk_tetcast", JUDGE_LOW, 0.10, 0.045, 1, "Open VKL 0.37 s, sampled"},
    {"T2", "", "vtk_tetcast", JUDGE_LOW, 0.18, 0.10, 1, "Open VKL 0.97 s, sampled"},
    {"T3", "", "vtk_tetcast", JUDGE_LOW, 0.5, 0.22, 1, "Open VKL 2.4 s, sampled"},
    {"T4", "", "vtk_tetcast", JUDGE_HIGH, 1.5, 3, 1, "VTK has none"},
    {"T5", "", "vtk_tetcast", JUDGE_LOW, 28, 20, 1, "Open VKL 256 to 350 B"},
    {"T6", "", "vtk_tetcast", JUDGE_LOW, 0.25, 0.08, 1, "Open VKL 10 s"},
    {"T7", "K32", "vtk_tetcast", JUDGE_HIGH, 1.5e6, 5e6, 1, "Open VKL 0.33 M/s; VTK has none"},
    {"T7", "D31k", "vtk_tetcast", JUDGE_HIGH, 1.5e6, 2.5e6, 1, "Open VKL 1.2 k/s; VTK has none"},
    {"T8", "", "vtk_tetcast", JUDGE_HIGH, 40e6, 120e6, 1, ""},
    {"T9", "", "vtk_tetcast", JUDGE_HIGH, 40e6, 150e6, 1, "Open VKL 1.8 to 19 M/s"},
    {"T10", "", "vtk_tetcast", JUDGE_LOW, 400e6, 250e6, 1, ""},
    {"T11", "PSNR", "vtk_tetcast", JUDGE_HIGH, 45, 60, 1, ""},
    {"T11", "pixels", "vtk_tetcast", JUDGE_LOW, 0, 0, 1, ""},
    {"T12", "", NULL, JUDGE_NONE, NONE, NONE, 1, "not built: the library has tetrahedra, no Voronoi cells"}
};
enum { TARGETS = (int)(sizeof g_targets / sizeof g_targets[0]) };

/* ---- lines ---- */

typedef struct line {
    char id[64], task[128], unit[16], error_unit[128], peer[96], method[128];
    double value, error, bytes, each, times, least, most;
    int threads, ours, file;
} line;

typedef struct skip { char program[64], why[160]; } skip;

static line g_lines[LINES_MOST];
static int g_line_count;
static skip g_skips[32];
static int g_skip_count;
static char g_machine[3][256]; /* compiler, flags, cpu */
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

static void read_line(const char *text, int file) {
    char bench[80], side[16];
    line *l;
    get_text(text, "bench", bench, sizeof bench);
    if (find(text, "program") != NULL && g_machine[0][0] == 0) {
        get_text(text, "compiler", g_machine[0], sizeof g_machine[0]);
        get_text(text, "flags", g_machine[1], sizeof g_machine[1]);
        get_text(text, "cpu", g_machine[2], sizeof g_machine[2]);
    }
    if (strncmp(bench, "peers.", 6) != 0) return;
    if (find(text, "skipped") != NULL) {
        if (g_skip_count == (int)(sizeof g_skips / sizeof g_skips[0])) return;
        memcpy(g_skips[g_skip_count].program, bench + 6, sizeof g_skips[0].program);
        get_text(text, "skipped", g_skips[g_skip_count].why, sizeof g_skips[0].why);
        g_skip_count++;
        return;
    }
    if (g_line_count == LINES_MOST) return;
    l = &g_lines[g_line_count++];
    memcpy(l->id, bench + 6, sizeof l->id);
    get_text(text, "case", l->task, sizeof l->task);
    get_text(text, "unit", l->unit, sizeof l->unit);
    get_text(text, "error_unit", l->error_unit, sizeof l->error_unit);
    get_text(text, "peer", l->peer, sizeof l->peer);
    get_text(text, "method", l->method, sizeof l->method);
    get_text(text, "side", side, sizeof side);
    l->ours = strcmp(side, "ours") == 0;
    l->value = get_number(text, "value");
    l->error = get_number(text, "error");
    l->bytes = get_number(text, "bytes");
    l->each = get_number(text, "bytes_each");
    l->times = get_number(text, "times");
    l->least = get_number(text, "times_least");
    l->most = get_number(text, "times_most");
    l->threads = (int)get_number(text, "threads");
    l->file = file;
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
    else if (v >= 1e4) snprintf(out, size, "%.0f%s%s", v, unit[0] != 0 ? " " : "", unit);
    else snprintf(out, size, "%.3g%s%s", v, unit[0] != 0 ? " " : "", unit);
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

static const target *target_of(const line *l) {
    int i;
    for (i = 0; i < TARGETS; i++)
        if (strcmp(g_targets[i].id, l->id) == 0 && strstr(l->task, g_targets[i].part) != NULL) return &g_targets[i];
    return NULL;
}

static void show_times(char *out, size_t size, const line *theirs) {
    if (theirs == NULL || theirs->times - theirs->times != 0) snprintf(out, size, "-");
    else if (theirs->most > theirs->least) {
        snprintf(out, size, theirs->times < 1.0 ? "**%.2f** (%.2f to %.2f)" : "%.3g (%.3g to %.3g)", theirs->times, theirs->least, theirs->most);
    } else snprintf(out, size, theirs->times < 1.0 ? "**%.2f**" : "%.3g", theirs->times);
}

static int met(const target *t, double bound, double value, double times) {
    switch (t->how) {
    case JUDGE_HIGH: return value >= bound;
    case JUDGE_LOW: return value <= bound;
    case JUDGE_TIMES: return times >= bound;
    default: return 0;
    }
}

static void show_target(const target *t, const line *ours, const line *theirs) {
    const double bound[2] = {t->base, t->goal}, times = theirs != NULL ? theirs->times : (double)NAN;
    char cell[2][40];
    const char *said[2];
    int i;
    for (i = 0; i < 2; i++) {
        const int none = bound[i] < 0;
        show(cell[i], sizeof cell[i], none ? (double)NAN : bound[i], t->how == JUDGE_TIMES ? "times" : ours->unit);
        said[i] = none ? "-" : met(t, bound[i], ours->value, times) ? "yes" : "no";
    }
    printf(" %s / %s | %s / %s |", cell[0], cell[1], said[0], said[1]);
}

static int g_rows, g_lost, g_base[2], g_goal[2]; /* rows with a peer, of those slower; targets met, not met */

/* One task against one peer; peer "": nobody. */
static void row(const line *of, const char *peer) {
    const line *theirs[PLACES], *ours[PLACES], *one_ours, *one_theirs;
    const target *t = target_of(of);
    char a[40], b[40], c[64];
    int i, at;
    for (i = 0; i < PLACES; i++) theirs[i] = fastest(of, peer, i + 1, &ours[i]);
    at = ours[0] != NULL ? 0 : 1;
    one_ours = ours[at];
    one_theirs = theirs[at];
    if (one_ours == NULL) return;
    printf("| %s | %s | %s%s%s |", strlen(of->id) > 1 ? of->id : "", of->task, peer[0] != 0 ? peer : "nobody here",
           one_theirs != NULL && strstr(peer, one_theirs->method) == NULL ? ", " : "",
           one_theirs != NULL && strstr(peer, one_theirs->method) == NULL ? one_theirs->method : "");
    for (i = 0; i < PLACES; i++) {
        show(a, sizeof a, ours[i] != NULL ? ours[i]->value : (double)NAN, of->unit);
        show(b, sizeof b, theirs[i] != NULL ? theirs[i]->value : (double)NAN, of->unit);
        show_times(c, sizeof c, theirs[i]);
        printf(" %s | %s | %s |", a, b, c);
    }
    show(a, sizeof a, one_ours->bytes, "B");
    show(b, sizeof b, one_theirs != NULL ? one_theirs->bytes : (double)NAN, "B");
    printf(" %s / %s |", a, b);
    show(a, sizeof a, one_ours->each, "");
    show(b, sizeof b, one_theirs != NULL ? one_theirs->each : (double)NAN, "");
    printf(" %s / %s |", a, b);
    show(a, sizeof a, one_ours->error, "");
    show(b, sizeof b, one_theirs != NULL ? one_theirs->error : (double)NAN, "");
    printf(" %s / %s (%c) |", a, b, unit_letter(one_ours->error_unit));
    if (t != NULL && t->threads <= PLACES && ours[t->threads - 1] != NULL) {
        const line *judged_ours = ours[t->threads - 1], *judged_theirs = theirs[t->threads - 1];
        const double times = judged_theirs != NULL ? judged_theirs->times : (double)NAN;
        show_target(t, judged_ours, judged_theirs);
        if (!(t->base < 0)) g_base[met(t, t->base, judged_ours->value, times)]++;
        if (!(t->goal < 0)) g_goal[met(t, t->goal, judged_ours->value, times)]++;
    } else {
        printf(" | |");
    }
    printf(" %s |\n", t != NULL ? t->others : "");
    if (one_theirs == NULL || one_theirs->times - one_theirs->times != 0) return;
    g_rows++;
    g_lost += one_theirs->times < 1.0;
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

static const char *why_not(const target *t) {
    int i;
    for (i = 0; t->program != NULL && i < g_skip_count; i++) if (strcmp(g_skips[i].program, t->program) == 0) return g_skips[i].why;
    return t->program == NULL ? t->others : "not run";
}

static void rows_without(const target *t) { /* a target that nothing was measured for */
    int i;
    for (i = 0; i < g_line_count; i++) if (strcmp(g_lines[i].id, t->id) == 0 && strstr(g_lines[i].task, t->part) != NULL) return;
    printf("| %s | %s | %s | - | - | - | - | - | - | - | - | - | | | %s |\n", t->id, t->part, why_not(t),
           t->program != NULL ? t->others : "");
}

static void lost_list(void) {
    int i, n;
    printf("\nWhere we lose (voxels in error everywhere they meet triangles, and beside that):\n\n");
    for (i = 0; i < g_line_count; i++) {
        const line *l = &g_lines[i], *ours;
        if (l->ours || fastest(l, l->peer, l->threads, &ours) != l || ours == NULL) continue;
        if (l->times < 1.0) {
            printf("- %s: %.2f times as good as %s, %s, %d thread%s\n", l->task, l->times, l->peer, l->method, l->threads, l->threads > 1 ? "s" : "");
        }
        if (l->threads == 1 && ours->bytes > l->bytes) {
            char a[40], b[40];
            show(a, sizeof a, ours->bytes, "B");
            show(b, sizeof b, l->bytes, "B");
            printf("- %s: memory %s, %s %s\n", l->task, a, l->peer, b);
        }
        n = l->id[0] == 'V' && strncmp(l->peer, "Embree", 6) == 0;
        if (!n && l->threads == 1 && ours->error > 1.02 * l->error) {
            printf("- %s: error %.3g, %s %.3g (%s)\n", l->task, ours->error, l->peer, l->error, l->error_unit);
        }
    }
}

int main(int argc, char **argv) {
    static char text[LINE_MOST];
    FILE *f = argc == 2 ? fopen(argv[1], "r") : NULL;
    int i, k;
    if (f == NULL) {
        fprintf(stderr, "usage: %s FILE.jsonl > FILE.md\n", argv[0]);
        return 2;
    }
    while (fgets(text, sizeof text, f) != NULL) read_line(text, 0);
    fclose(f);
    printf("%s; %s; peers as the system packages them.\n\n", g_machine[2], g_machine[0]);
    printf("| target | task | peer | ours, 1 thread | theirs | times | ours, 2 threads | theirs | times | memory | bytes each | error | "
           "base / goal | met | others, not run here |\n"
           "| --- | --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | --- |\n");
    for (k = 0; k < TARGETS; k++) {
        if (k == 0 || strcmp(g_targets[k].id, g_targets[k - 1].id) != 0) {
            for (i = 0; i < g_line_count; i++) if (strcmp(g_lines[i].id, g_targets[k].id) == 0) rows_of(i);
        }
        rows_without(&g_targets[k]);
    }
    for (i = 0; i < g_line_count; i++) if (strlen(g_lines[i].id) == 1) rows_of(i);
    for (i = 0; i < g_skip_count; i++) printf("| | | %s | - | - | - | - | - | - | - | - | - | | | |\n", g_skips[i].why);
    printf("\n%d rows have both sides, in %d of them ours is the slower or larger one. Targets: base met %d, missed %d; goal met %d, missed %d.\n",
           g_rows, g_lost, g_base[1], g_base[0], g_goal[1], g_goal[0]);
    printf("\nErrors, ours / theirs:\n\n");
    for (i = 0; i < g_unit_count; i++) printf("- (%c) %s\n", 'a' + i, g_units[i]);
    lost_list();
    return ferror(stdout) || fflush(stdout) != 0;
}
