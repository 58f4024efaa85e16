/* bench.h - timing, lines of results and ray sets for the programs in bench/ - C99 and C++11 - MIT OR Unlicense, see
   LICENSE

   Include it before any other header. A program prints one flat JSON object a line:

       bench_machine("voxrt", argv[0]);                                       // the first line
       bench_interleave(jobs, 3, 5);                                          // A B C A B C ...
       bench_line("voxrt.trace", "blob-512", "rays_per_second", bench_rate(&jobs[0], n), "1/s");
       bench_num("best", bench_rate_best(&jobs[0], n));
       bench_num("error", 0);
       bench_text("error_unit", "rays");
       bench_end();

   Times are CPU seconds of the process, which neighbours on the machine disturb least, and wall seconds beside them. */
#ifndef BENCH_H_INCLUDED
#define BENCH_H_INCLUDED
#ifndef _POSIX_C_SOURCE
#  define _POSIX_C_SOURCE 200809L
#endif
#if defined(__linux__) && !defined(_DEFAULT_SOURCE)
#  define _DEFAULT_SOURCE /* syscall */
#endif
#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>
#if defined(__linux__)
#  include <linux/perf_event.h>
#  include <sys/syscall.h>
#endif

#if defined(__GNUC__)
#  define BENCH_FN static __attribute__((unused))
#else
#  define BENCH_FN static
#endif

#ifndef BENCH_FLAGS_FILE
#  define BENCH_FLAGS_FILE ".flags" /* beside the program: compiler and flags, by its Makefile */
#endif

enum { BENCH_ROUNDS_MAX = 32 };

/* ---- clocks ---- */

BENCH_FN double bench_clock(clockid_t id) {
    struct timespec t;
    clock_gettime(id, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}
BENCH_FN double bench_wall(void) { return bench_clock(CLOCK_MONOTONIC); }
BENCH_FN double bench_cpu(void) { return bench_clock(CLOCK_PROCESS_CPUTIME_ID); }

/* ---- runs ---- */

typedef struct bench_job {
    const char *name, *isa;
    void (*run)(void *ctx);
    void *ctx;
    double cpu[BENCH_ROUNDS_MAX], wall[BENCH_ROUNDS_MAX]; /* out, of each round */
    int rounds;
} bench_job;

BENCH_FN int bench_compare(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

BENCH_FN double bench_median(const double *v, int n) {
    double s[BENCH_ROUNDS_MAX];
    memcpy(s, v, (size_t)n * sizeof s[0]);
    qsort(s, (size_t)n, sizeof s[0], bench_compare);
    return n % 2 ? s[n / 2] : 0.5 * (s[n / 2 - 1] + s[n / 2]);
}

BENCH_FN double bench_least(const double *v, int n) {
    double m = v[0];
    int i;
    for (i = 1; i < n; i++) if (v[i] < m) m = v[i];
    return m;
}

/* Warm up each job, then run all of them in turn, `rounds` times. */
BENCH_FN void bench_interleave(bench_job *jobs, int count, int rounds) {
    int i, k;
    for (i = 0; i < count; i++) {
        jobs[i].rounds = rounds;
        jobs[i].run(jobs[i].ctx);
    }
    for (k = 0; k < rounds; k++) {
        for (i = 0; i < count; i++) {
            const double w = bench_wall(), c = bench_cpu();
            jobs[i].run(jobs[i].ctx);
            jobs[i].cpu[k] = bench_cpu() - c;
            jobs[i].wall[k] = bench_wall() - w;
        }
    }
}

BENCH_FN double bench_seconds(const bench_job *j) { return bench_median(j->cpu, j->rounds); }
BENCH_FN double bench_seconds_best(const bench_job *j) { return bench_least(j->cpu, j->rounds); }
BENCH_FN double bench_rate(const bench_job *j, double work) { return work / bench_seconds(j); }
BENCH_FN double bench_rate_best(const bench_job *j, double work) { return work / bench_seconds_best(j); }

/* Wall over CPU seconds: 1 when the machine was ours alone, more when it was shared. For one thread. */
BENCH_FN double bench_busy(const bench_job *j) { return bench_median(j->wall, j->rounds) / bench_seconds(j); }

/* How many times faster `ours` is: median over the rounds of base / ours, so that a slow spell hits both. */
BENCH_FN double bench_ratio(const bench_job *base, const bench_job *ours) {
    double r[BENCH_ROUNDS_MAX];
    int k;
    for (k = 0; k < ours->rounds; k++) r[k] = base->cpu[k] / ours->cpu[k];
    return bench_median(r, ours->rounds);
}

/* ---- hardware counters: Linux where it gives them, which in virtual machines is rare ---- */

enum { BENCH_CYCLES, BENCH_CACHE_MISSES, BENCH_COUNTERS };

/* Run once; count[i] < 0: there is no such counter. Counts what this thread does outside of the kernel. */
BENCH_FN void bench_count(void (*run)(void *ctx), void *ctx, double count[BENCH_COUNTERS]) {
    int i;
    for (i = 0; i < BENCH_COUNTERS; i++) count[i] = -1.0;
#if defined(__linux__)
    {
        static const uint64_t config[BENCH_COUNTERS] = {PERF_COUNT_HW_CPU_CYCLES, PERF_COUNT_HW_CACHE_MISSES};
        int fd[BENCH_COUNTERS];
        uint64_t before[BENCH_COUNTERS], after;
        for (i = 0; i < BENCH_COUNTERS; i++) {
            struct perf_event_attr a;
            memset(&a, 0, sizeof a);
            a.type = PERF_TYPE_HARDWARE;
            a.size = sizeof a;
            a.config = config[i];
            a.exclude_kernel = a.exclude_hv = 1;
            fd[i] = (int)syscall(SYS_perf_event_open, &a, 0, -1, -1, 0);
        }
        for (i = 0; i < BENCH_COUNTERS; i++)
            if (fd[i] >= 0 && read(fd[i], &before[i], 8) != 8) before[i] = 0;
        run(ctx);
        for (i = 0; i < BENCH_COUNTERS; i++) {
            if (fd[i] < 0) continue;
            if (read(fd[i], &after, 8) == 8) count[i] = (double)(after - before[i]);
            close(fd[i]);
        }
    }
#else
    run(ctx);
#endif
}

/* ---- lines ---- */

BENCH_FN void bench_quoted(const char *s) {
    putchar('"');
    for (; *s != 0; s++) {
        if (*s == '"' || *s == '\\') putchar('\\');
        if ((unsigned char)*s >= 32) putchar(*s);
    }
    putchar('"');
}

BENCH_FN void bench_text(const char *key, const char *value) {
    printf(",\"%s\":", key);
    bench_quoted(value);
}
BENCH_FN void bench_num(const char *key, double value) {
    if (value - value == 0) printf(",\"%s\":%.7g", key, value);
    else printf(",\"%s\":null", key);
}
BENCH_FN void bench_hash(uint64_t hash) { printf(",\"hash\":\"%016llx\"", (unsigned long long)hash); }
BENCH_FN void bench_end(void) {
    printf("}\n");
    fflush(stdout);
}

BENCH_FN void bench_line(const char *bench, const char *kase, const char *metric, double value, const char *unit) {
    printf("{\"bench\":\"%s\"", bench);
    bench_text("case", kase);
    bench_text("metric", metric);
    bench_num("value", value);
    bench_text("unit", unit);
}

BENCH_FN void bench_skip(const char *bench, const char *kase, const char *why) {
    printf("{\"bench\":\"%s\"", bench);
    bench_text("case", kase);
    bench_text("skipped", why);
    bench_end();
}

/* Folder of the program: that is where its Makefile left the flags, and where results go. */
BENCH_FN void bench_folder(char *out, size_t size, const char *argv0) {
    const char *slash = strrchr(argv0, '/');
    snprintf(out, size, "%.*s", slash != NULL ? (int)(slash - argv0) : 1, slash != NULL ? argv0 : ".");
}

BENCH_FN void bench_first_line(char *out, size_t size, const char *path, const char *start) {
    FILE *f = fopen(path, "r");
    char line[1024];
    out[0] = 0;
    if (f == NULL) return;
    while (fgets(line, sizeof line, f) != NULL) {
        const char *p = line, *colon;
        if (strncmp(line, start, strlen(start)) != 0) continue;
        colon = start[0] != 0 ? strchr(line, ':') : NULL;
        if (colon != NULL) p = colon + 1 + (colon[1] == ' ');
        snprintf(out, size, "%s", p);
        out[strcspn(out, "\n")] = 0;
        break;
    }
    fclose(f);
}

BENCH_FN void bench_machine(const char *name, const char *argv0) {
    char folder[600], path[700], text[1024];
    printf("{\"program\":\"bench_%s\"", name);
#if defined(__clang__)
    bench_text("compiler", "clang " __clang_version__);
#elif defined(__GNUC__)
    bench_text("compiler", "gcc " __VERSION__);
#endif
    bench_folder(folder, sizeof folder, argv0);
    snprintf(path, sizeof path, "%s/" BENCH_FLAGS_FILE, folder);
    bench_first_line(text, sizeof text, path, "");
    bench_text("flags", text[0] != 0 ? text : "unknown");
    bench_first_line(text, sizeof text, "/proc/cpuinfo", "model name");
    bench_text("cpu", text[0] != 0 ? text : "unknown");
    bench_num("cores", (double)sysconf(_SC_NPROCESSORS_ONLN));
    bench_first_line(text, sizeof text, "/proc/loadavg", "");
    bench_text("load", text);
    bench_end();
}

/* ---- hashes, random numbers ---- */

BENCH_FN uint64_t bench_mix(uint64_t h, uint64_t v) {
    h = (h ^ v) * UINT64_C(0x9e3779b97f4a7c15);
    return h ^ h >> 29;
}

BENCH_FN uint64_t bench_hash_bytes(const void *p, size_t n) {
    const unsigned char *b = (const unsigned char *)p;
    uint64_t h = n;
    for (; n >= 8; n -= 8, b += 8) {
        uint64_t v;
        memcpy(&v, b, 8);
        h = bench_mix(h, v);
    }
    while (n-- > 0) h = bench_mix(h, *b++);
    return h;
}

typedef struct bench_rng { uint64_t state; } bench_rng;

BENCH_FN uint32_t bench_random_u32(bench_rng *r) { /* splitmix64 */
    uint64_t z = r->state += UINT64_C(0x9e3779b97f4a7c15);
    z = (z ^ z >> 30) * UINT64_C(0xbf58476d1ce4e5b9);
    z = (z ^ z >> 27) * UINT64_C(0x94d049bb133111eb);
    return (uint32_t)((z ^ z >> 31) >> 32);
}
BENCH_FN float bench_random(bench_rng *r) { return (float)(bench_random_u32(r) >> 8) * (1.0f / 16777216.0f); }

BENCH_FN void bench_unit(float d[3]) {
    const float l = sqrtf(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    int a;
    for (a = 0; a < 3; a++) d[a] /= l;
}

/* A direction with a density proportional to the cosine of its angle to the unit vector n. */
BENCH_FN void bench_cosine(bench_rng *r, const float n[3], float d[3]) {
    const float z = 2.0f * bench_random(r) - 1.0f, phi = 6.28318531f * bench_random(r), q = sqrtf(1.0f - z * z);
    d[0] = n[0] + q * cosf(phi);
    d[1] = n[1] + q * sinf(phi);
    d[2] = n[2] + z;
    if (d[0] * d[0] + d[1] * d[1] + d[2] * d[2] < 1e-8f) memcpy(d, n, 3 * sizeof d[0]);
    bench_unit(d);
}

/* ---- options ---- */

typedef struct bench_options {
    int full, threads;
    const char *only, *data, *table;
} bench_options;

/* 1: BMn was asked for. */
BENCH_FN int bench_wanted(const bench_options *o, int n) {
    char name[16];
    const char *p = o->only;
    size_t len;
    if (p == NULL) return 1;
    len = (size_t)snprintf(name, sizeof name, "BM%d", n);
    for (; (p = strstr(p, name)) != NULL; p += len) {
        if ((p == o->only || p[-1] == ',') && (p[len] == 0 || p[len] == ',')) return 1;
    }
    return 0;
}

/* Returns 0, or 2 after a message on stderr. */
BENCH_FN int bench_parse(int argc, char **argv, bench_options *o) {
    const char *env = getenv("RENDER_DATA");
    int i;
    memset(o, 0, sizeof *o);
    o->threads = 2;
    o->data = env != NULL && env[0] != 0 ? env : "../shared/data";
    for (i = 1; i < argc; i++) {
        const char *value = i + 1 < argc ? argv[i + 1] : NULL;
        if (strcmp(argv[i], "--full") == 0) { o->full = 1; continue; }
        if (value != NULL && strcmp(argv[i], "--only") == 0) o->only = value;
        else if (value != NULL && strcmp(argv[i], "--data") == 0) o->data = value;
        else if (value != NULL && strcmp(argv[i], "--table") == 0) o->table = value;
        else if (value != NULL && strcmp(argv[i], "--threads") == 0 && atoi(value) > 0) o->threads = atoi(value);
        else {
            fprintf(stderr, "usage: %s [--full] [--only BM1,BM6] [--threads N] [--data DIR] [--table FILE]\n", argv[0]);
            return 2;
        }
        i++;
    }
    return 0;
}

/* ---- the acceptance table: what was measured beside what it must and should be ---- */

typedef struct bench_row {
    const char *key, *text, *unit, *must, *goal;
    char measured[96];
} bench_row;

typedef struct bench_table {
    bench_row *rows;
    size_t count;
    const char *title, *file; /* first words above it; name below the folder bench/ */
} bench_table;

BENCH_FN void bench_table_set(bench_table *t, const char *key, const char *format, ...)
    __attribute__((format(printf, 3, 4)));
BENCH_FN void bench_table_set(bench_table *t, const char *key, const char *format, ...) {
    size_t i;
    va_list args;
    for (i = 0; i < t->count; i++) {
        if (strcmp(t->rows[i].key, key) != 0) continue;
        va_start(args, format);
        vsnprintf(t->rows[i].measured, sizeof t->rows[i].measured, format, args);
        va_end(args);
    }
}

/* busy: mean of wall over CPU seconds of the one-thread runs. all: rows that were not run, too. */
BENCH_FN void bench_table_print(const bench_table *t, FILE *f, double busy, int all) {
    size_t i;
    fprintf(f, "%s. How busy the machine was: wall over CPU seconds of the one-thread runs was %.2f (1: nobody else).\n\n",
            t->title, busy);
    fputs("| row | measured | must | goal | unit |\n| --- | ---: | ---: | ---: | --- |\n", f);
    for (i = 0; i < t->count; i++) {
        const bench_row *r = &t->rows[i];
        if (!all && r->measured[0] == 0) continue;
        fprintf(f, "| %s | %s | %s | %s | %s |\n", r->text, r->measured[0] != 0 ? r->measured : "not run", r->must,
                r->goal, r->unit);
    }
}

/* To stderr and to its file. A run of some benchmarks leaves the table of the last whole run alone. */
BENCH_FN void bench_table_end(const bench_table *t, const bench_options *o, double busy, const char *argv0) {
    char folder[600], path[700], part[720];
    FILE *f;
    bench_table_print(t, stderr, busy, o->only == NULL);
    if (o->table == NULL && o->only != NULL) return;
    if (o->table != NULL) {
        snprintf(path, sizeof path, "%s", o->table);
    } else {
        bench_folder(folder, sizeof folder, argv0);
        snprintf(path, sizeof path, "%s/bench/%s", folder, t->file);
    }
    snprintf(part, sizeof part, "%s.part", path);
    f = fopen(part, "w");
    if (f == NULL) return; /* no such folder: only on stderr */
    bench_table_print(t, f, busy, o->only == NULL);
    if (fclose(f) == 0) (void)rename(part, path);
}

#endif
