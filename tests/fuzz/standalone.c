/* standalone.c - drives a fuzz target where libFuzzer is not installed, and repeats what it found

   standalone [-seconds=N] [-iterations=N] [-seed=N] [-max=BYTES] [-prefixes=N] [-crash=FILE] [file or folder]...

   Runs every file and the beginnings of small ones, all of them or N of each, then changes files: bit and byte flips,
   interesting numbers, truncation, insertion, deletion, copies within and splices between files. The same seed gives the
   same inputs. Before each input runs it is kept in memory; when the process is stopped by a signal, or a sanitizer calls
   abort, it is written to the file of -crash. Under the address sanitizer the heap must be as large at the end as it was
   after the files. */
#define _XOPEN_SOURCE 700
#include <dirent.h>
#include <fcntl.h>
#include <signal.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

#if defined(__SANITIZE_ADDRESS__)
void __sanitizer_set_death_callback(void (*callback)(void));
size_t __sanitizer_get_current_allocated_bytes(void);
#define HEAP_BYTES() __sanitizer_get_current_allocated_bytes()
#else
#define HEAP_BYTES() ((size_t)0)
#endif
#define HEAP_SLACK 65536 /* what libc keeps for threads that have ended */

typedef struct input { uint8_t *data; size_t size; } input;

static input *g_files;
static size_t g_file_count, g_file_room;
static uint64_t g_random;
static const uint8_t *g_now;
static size_t g_now_size;
static const char *g_crash_path = "fuzz.crash";

static uint32_t random_u32(void) {
    uint64_t z = (g_random += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return (uint32_t)(z >> 32);
}

static size_t random_below(size_t n) { return n == 0 ? 0 : (size_t)(((uint64_t)random_u32() * n) >> 32); }

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void save_crash(void) { /* async-signal-safe */
    static const char text[] = "\nthe input that did it was written to the file of -crash\n";
    int f = open(g_crash_path, O_WRONLY | O_CREAT | O_TRUNC, 0644);
    size_t done = 0;
    if (f < 0) return;
    while (done < g_now_size) {
        ssize_t n = write(f, g_now + done, g_now_size - done);
        if (n <= 0) break;
        done += (size_t)n;
    }
    close(f);
    if (write(2, text, sizeof text - 1) < 0) return;
}

static void on_signal(int sig) {
    save_crash();
    signal(sig, SIG_DFL);
    raise(sig);
}

static void time_limit(time_t seconds) { /* of the processor: the machine may be busy */
    struct itimerval t;
    memset(&t, 0, sizeof t);
    t.it_value.tv_sec = seconds;
    (void)setitimer(ITIMER_PROF, &t, NULL);
}

static void run(const uint8_t *data, size_t size) {
    /* a copy of exactly this size, so that a sanitizer sees a read behind the end */
    uint8_t *copy = (uint8_t *)malloc(size != 0 ? size : 1);
    if (copy == NULL) return;
    if (size != 0) memcpy(copy, data, size);
    g_now = data;
    g_now_size = size;
    time_limit(20);
    LLVMFuzzerTestOneInput(copy, size);
    time_limit(0);
    free(copy);
}

static void add(const uint8_t *data, size_t size) {
    uint8_t *p = (uint8_t *)malloc(size != 0 ? size : 1);
    if (g_file_count == g_file_room) {
        size_t room = g_file_room != 0 ? g_file_room * 2 : 64;
        input *more = (input *)realloc(g_files, room * sizeof(input));
        if (more != NULL) { g_files = more; g_file_room = room; }
    }
    if (p == NULL || g_file_count == g_file_room) { free(p); return; }
    if (size != 0) memcpy(p, data, size);
    g_files[g_file_count].data = p;
    g_files[g_file_count].size = size;
    g_file_count++;
}

static int by_name(const void *a, const void *b) { return strcmp(*(char *const *)a, *(char *const *)b); }

static void add_path(const char *path, size_t most) {
    struct stat st;
    if (stat(path, &st) != 0) { fprintf(stderr, "%s: not found\n", path); exit(2); }
    if (S_ISDIR(st.st_mode)) { /* in the order of the names, not of the disk */
        char *names[4096];
        size_t count = 0, i;
        struct dirent *e;
        DIR *d = opendir(path);
        if (d == NULL) return;
        while ((e = readdir(d)) != NULL && count < sizeof names / sizeof names[0]) {
            size_t n = strlen(path) + strlen(e->d_name) + 2;
            char *full;
            if (e->d_name[0] == '.' || (full = (char *)malloc(n)) == NULL) continue;
            snprintf(full, n, "%s/%s", path, e->d_name);
            names[count++] = full;
        }
        closedir(d);
        qsort(names, count, sizeof names[0], by_name);
        for (i = 0; i < count; i++) { add_path(names[i], most); free(names[i]); }
    } else {
        FILE *f = fopen(path, "rb");
        uint8_t *p = (uint8_t *)malloc(most);
        if (f != NULL && p != NULL) add(p, fread(p, 1, most, f));
        if (f != NULL) fclose(f);
        free(p);
    }
}

static size_t put_number(uint8_t *p, size_t size) { /* values at the edges, in 1, 2, 4 or 8 bytes, both orders */
    static const uint64_t values[] = {0, 1, 2, 0x7f, 0x80, 0xff, 0x7fff, 0x8000, 0xffff, 0x10000, 0x7fffffff,
        0x80000000u, 0xffffffffu, 0x100000000u, 0x7fffffffffffffffu, 0x8000000000000000u, 0xffffffffffffffffu,
        0x3f800000, 0x7f7fffff, 0x7f800000, 0xff800000u, 0x7fc00000, 0x7ff0000000000000u};
    uint64_t v = values[random_below(sizeof values / sizeof values[0])];
    size_t bytes = (size_t)1 << random_below(4), at, i;
    int big = (int)(random_u32() & 1u);
    if (random_below(4) == 0) v += random_below(3) - 1u;
    if (size < bytes) return size;
    at = random_below(size - bytes + 1);
    if (random_below(2) != 0) at &= ~(bytes - 1);
    for (i = 0; i < bytes; i++) p[at + (big ? bytes - 1 - i : i)] = (uint8_t)(v >> (8 * i));
    return size;
}

static size_t mutate(uint8_t *p, size_t size, size_t most) {
    size_t steps = (size_t)1 << random_below(5), a, b, n;
    while (steps-- != 0) {
        switch (random_below(9)) {
        case 0: case 1:
            if (size != 0) { a = random_below(size); p[a] = (uint8_t)(p[a] ^ (1u << random_below(8))); }
            break;
        case 2:
            if (size != 0) p[random_below(size)] = (uint8_t)random_u32();
            break;
        case 3: case 4: size = put_number(p, size); break;
        case 5: /* cut the end, seldom much */
            if (size != 0) size -= random_below(random_below(4) == 0 ? size + 1 : (size < 16 ? size : 16) + 1);
            break;
        case 6: /* insert */
            n = random_below(random_below(4) == 0 ? 256 : 8) + 1;
            if (n > most - size) break;
            a = random_below(size + 1);
            memmove(p + a + n, p + a, size - a);
            for (b = 0; b < n; b++) p[a + b] = (uint8_t)random_u32();
            size += n;
            break;
        case 7: /* delete or copy a piece */
            if (size < 2) break;
            a = random_below(size);
            b = random_below(size);
            n = random_below(size - (a > b ? a : b)) + 1;
            memmove(p + a, p + b, n);
            if (random_below(2) != 0) { memmove(p + a, p + a + n, size - a - n); size -= n; }
            break;
        default: { /* the end of another file behind the start of this one */
            const input *other = &g_files[random_below(g_file_count)];
            a = random_below(size + 1);
            b = random_below(other->size + 1);
            n = other->size - b;
            if (n > most - a) n = most - a;
            if (n != 0) memcpy(p + a, other->data + b, n);
            size = a + n;
            break;
        }
        }
    }
    return size;
}

int main(int argc, char **argv) {
    double seconds = 0, start;
    unsigned long long iterations = 0, done = 0;
    size_t most = (size_t)1 << 20, prefixes = 512, i, k, heap, after;
    uint8_t *work;
    int a;
    g_random = 1;
    for (a = 1; a < argc; a++) {
        if (strncmp(argv[a], "-seconds=", 9) == 0) seconds = atof(argv[a] + 9);
        else if (strncmp(argv[a], "-iterations=", 12) == 0) iterations = strtoull(argv[a] + 12, NULL, 10);
        else if (strncmp(argv[a], "-seed=", 6) == 0) g_random = strtoull(argv[a] + 6, NULL, 10);
        else if (strncmp(argv[a], "-max=", 5) == 0) most = (size_t)strtoull(argv[a] + 5, NULL, 10);
        else if (strncmp(argv[a], "-prefixes=", 10) == 0) prefixes = (size_t)strtoull(argv[a] + 10, NULL, 10);
        else if (strncmp(argv[a], "-crash=", 7) == 0) g_crash_path = argv[a] + 7;
        else if (argv[a][0] == '-') {
            fprintf(stderr, "see the comment at the top of tests/fuzz/standalone.c\n");
            return 2;
        }
    }
    if (most == 0) most = 1;
    for (a = 1; a < argc; a++) if (argv[a][0] != '-') add_path(argv[a], most);
#if defined(__SANITIZE_ADDRESS__)
    __sanitizer_set_death_callback(save_crash);
#else
    signal(SIGSEGV, on_signal);
    signal(SIGBUS, on_signal);
    signal(SIGFPE, on_signal);
    signal(SIGILL, on_signal);
#endif
    signal(SIGABRT, on_signal);
    signal(SIGPROF, on_signal);
    run((const uint8_t *)"", 0);
    for (i = 0; i < g_file_count; i++) {
        run(g_files[i].data, g_files[i].size);
        if (g_files[i].size > 512) continue;
        for (k = 0; k < prefixes && k < g_files[i].size; k++)
            run(g_files[i].data, prefixes < g_files[i].size ? k * g_files[i].size / prefixes : k);
    }
    printf("%llu files\n", (unsigned long long)g_file_count);
    fflush(stdout);
    if (g_file_count == 0) {
        uint8_t zero[256];
        memset(zero, 0, sizeof zero);
        add(zero, sizeof zero);
        for (i = 0; i < sizeof zero; i++) zero[i] = (uint8_t)random_u32();
        add(zero, sizeof zero);
    }
    work = (uint8_t *)malloc(most);
    if (work == NULL || g_file_count == 0) return 1;
    start = now();
    heap = HEAP_BYTES();
    while (iterations != 0 || seconds > 0) {
        const input *from = &g_files[random_below(g_file_count)];
        size_t size = from->size < most ? from->size : most;
        if (size != 0) memcpy(work, from->data, size);
        size = mutate(work, size, most);
        if ((iterations != 0 && done >= iterations) || (seconds > 0 && now() - start >= seconds)) break;
        run(work, size);
        done++;
    }
    printf("%llu changed inputs in %.1f s\n", done, now() - start);
    after = HEAP_BYTES();
    printf("heap: %llu bytes before, %llu after\n", (unsigned long long)heap, (unsigned long long)after);
    a = after > heap + HEAP_SLACK;
    if (a != 0) fprintf(stderr, "the heap grew\n");
    for (i = 0; i < g_file_count; i++) free(g_files[i].data);
    free(g_files);
    free(work);
    return a;
}
