/* test.h - a small test framework for the programs in tests/ - C99 and C++11 - MIT OR Unlicense, see LICENSE

   Include it before any other header: it asks the C library for POSIX (monotonic clock).

       #include "test.h"
       #define VOXRT_IMPLEMENTATION
       #include "../voxrt.h"

       TEST(one_voxel) {
           test_alloc ta;
           voxrt_allocator a;
           test_alloc_init(&ta);
           a.alloc_fn = test_alloc_fn; a.free_fn = test_free_fn; a.user = &ta;
           REQUIRE(something != NULL);          // leaves the test
           CHECK(1 + 1 == 2);                   // goes on after a failure
           CHECK_MSG(x < 3, "x is %d", x);
           CHECK_EQ_U64(test_fnv1a(p, n, 0), 0x1234u);
           test_alloc_check(&ta);               // no leak, no wrong size on free
       }

       int main(int argc, char **argv) {
           test_begin(argc, argv);
           RUN(one_voxel);
           return test_end();
       }

   Arguments of a test program: -v name and time of each test; -l list; any other word runs only the tests whose
   name contains it. Environment: TEST_QUICK=1 asks long tests to be short (test_quick()), RENDER_DATA names the
   folder of test data. The last line printed is `N passed, N failed` and `, N skipped` if there are any.
   CHECK may be used from any thread; REQUIRE, SKIP only in the body of a TEST. */
#ifndef TEST_H_INCLUDED
#define TEST_H_INCLUDED
#ifndef _POSIX_C_SOURCE
#  define _POSIX_C_SOURCE 200809L
#endif
#include <math.h>
#include <signal.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#ifndef CLOCK_MONOTONIC
#  error "include test.h before any other header"
#endif

#if defined(__SANITIZE_ADDRESS__)
#  define TEST_ASAN 1
#elif defined(__has_feature)
#  if __has_feature(address_sanitizer)
#    define TEST_ASAN 1
#  endif
#  if __has_feature(memory_sanitizer)
#    define TEST_MSAN 1
#  endif
#  if __has_feature(thread_sanitizer)
#    define TEST_TSAN 1
#  endif
#endif
#if defined(__SANITIZE_THREAD__) && !defined(TEST_TSAN)
#  define TEST_TSAN 1
#endif
#ifndef TEST_ASAN
#  define TEST_ASAN 0
#endif
#ifndef TEST_MSAN
#  define TEST_MSAN 0
#endif
#ifndef TEST_TSAN
#  define TEST_TSAN 0
#endif
#define TEST_SANITIZED (TEST_ASAN || TEST_MSAN || TEST_TSAN)

#if defined(__GNUC__)
#  define TEST_FN static __attribute__((unused))
#  define TEST_PRINTF(a, b) __attribute__((format(printf, a, b)))
#else
#  define TEST_FN static
#  define TEST_PRINTF(a, b)
#endif

#if defined(_WIN32) /* aligned blocks for free(), as POSIX has them: the few of them are listed. Of one thread */
static void *test_aligned[256][2]; /* what the program has, what malloc gave */
TEST_FN int posix_memalign(void **block, size_t align, size_t size) {
    int i;
    for (i = 0; i < 256; i++) {
        if (test_aligned[i][0] != NULL) continue;
        test_aligned[i][1] = malloc(size + align);
        if (test_aligned[i][1] == NULL) return 1;
        *block = test_aligned[i][0] = (char *)test_aligned[i][1] + (align - ((uintptr_t)test_aligned[i][1] & (align - 1)));
        return 0;
    }
    return 1;
}
TEST_FN void test_free(void *p) {
    int i;
    for (i = 0; i < 256 && (p == NULL || test_aligned[i][0] != p); i++) {}
    if (i < 256) {
        p = test_aligned[i][1];
        test_aligned[i][0] = NULL;
    }
    free(p);
}
#  define free(p) test_free(p)
#endif

/* ---- running ---------------------------------------------------------------------------------------------- */

/* TEST_FILE: the file's name where several are one program, see all_voxrt.c */
#ifndef TEST_FILE
#  define TEST_FILE test
#endif
#define TEST_PASTE2(a, b) a##_##b
#define TEST_PASTE(a, b) TEST_PASTE2(a, b)
#define TEST(name) static void TEST_PASTE(TEST_FILE, fn_##name)(void)
#define RUN(name) test_run(#name, TEST_PASTE(TEST_FILE, fn_##name))
#define TEST_MAIN TEST_PASTE(TEST_FILE, main)

#define CHECK(cond) ((cond) ? (void)0 : test_fail(__FILE__, __LINE__, "%s", #cond))
#define CHECK_MSG(cond, ...) ((cond) ? (void)0 : test_fail(__FILE__, __LINE__, __VA_ARGS__))
#define CHECK_EQ_U64(a, b) test_eq_u64((uint64_t)(a), (uint64_t)(b), #a " == " #b, __FILE__, __LINE__)
#define CHECK_EQ_I64(a, b) test_eq_i64((int64_t)(a), (int64_t)(b), #a " == " #b, __FILE__, __LINE__)
#define CHECK_NEAR(a, b, tol) test_near_to((double)(a), (double)(b), (double)(tol), #a " ~ " #b, __FILE__, __LINE__)
#define CHECK_STR(a, b) test_eq_str((a), (b), #a " == " #b, __FILE__, __LINE__)
#define REQUIRE(cond) do { if (!(cond)) { test_fail(__FILE__, __LINE__, "%s", #cond); return; } } while (0)
#define SKIP(reason) do { test_skip(reason); return; } while (0)

enum { TEST_MAX_PRINTED = 8, TEST_MAX_FILTERS = 16 };

typedef struct test_state {
    const char *filters[TEST_MAX_FILTERS];
    int filter_count;
    int verbose, list;
    int passed, failed, skipped;
    unsigned fails;            /* failures in the test that runs; atomic */
    const char *skip_reason;
    const char *name;
} test_state;

static test_state test_g;

TEST_FN double test_now(void) { /* seconds, monotonic */
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* True when tests are asked to be short: TEST_QUICK is set to something but 0. */
TEST_FN int test_quick(void) {
    const char *e = getenv("TEST_QUICK");
    return e != NULL && e[0] != 0 && strcmp(e, "0") != 0;
}

TEST_FN void test_fail(const char *file, int line, const char *format, ...) TEST_PRINTF(3, 4);
TEST_FN void test_fail(const char *file, int line, const char *format, ...) {
    unsigned n = __atomic_fetch_add(&test_g.fails, 1u, __ATOMIC_RELAXED);
    char text[1024];
    va_list args;
    if (n >= (unsigned)TEST_MAX_PRINTED) return;
    va_start(args, format);
    vsnprintf(text, sizeof text, format, args);
    va_end(args);
    printf("%s:%d: FAIL %s: %s\n", file, line, test_g.name != NULL ? test_g.name : "?", text);
    fflush(stdout);
}

TEST_FN void test_eq_u64(uint64_t a, uint64_t b, const char *text, const char *file, int line) {
    if (a != b) test_fail(file, line, "%s (0x%llx is not 0x%llx)", text, (unsigned long long)a, (unsigned long long)b);
}

TEST_FN void test_eq_i64(int64_t a, int64_t b, const char *text, const char *file, int line) {
    if (a != b) test_fail(file, line, "%s (%lld is not %lld)", text, (long long)a, (long long)b);
}

TEST_FN void test_near_to(double a, double b, double tol, const char *text, const char *file, int line) {
    if (!(fabs(a - b) <= tol)) { /* NaN fails */
        test_fail(file, line, "%s (%.9g is not %.9g, difference %.3g, allowed %.3g)", text, a, b, a - b, tol);
    }
}

TEST_FN void test_eq_str(const char *a, const char *b, const char *text, const char *file, int line) {
    if (a == NULL || b == NULL || strcmp(a, b) != 0) {
        test_fail(file, line, "%s (\"%s\" is not \"%s\")", text, a != NULL ? a : "NULL", b != NULL ? b : "NULL");
    }
}

TEST_FN void test_skip(const char *reason) { test_g.skip_reason = reason; }

TEST_FN void test_on_signal(int sig) { /* only async-signal-safe calls */
    const char *parts[3];
    int i;
    parts[0] = "FAIL ";
    parts[1] = test_g.name != NULL ? test_g.name : "(no test)";
    parts[2] = ": the program was stopped by a signal in this test\n";
    for (i = 0; i < 3; i++) {
        if (write(1, parts[i], strlen(parts[i])) < 0) break;
    }
    signal(sig, SIG_DFL);
    raise(sig);
}

TEST_FN void test_begin(int argc, char **argv) {
    int i;
    memset(&test_g, 0, sizeof test_g);
    for (i = 1; i < argc; i++) {
        if (strcmp(argv[i], "-v") == 0) test_g.verbose = 1;
        else if (strcmp(argv[i], "-l") == 0) test_g.list = 1;
        else if (argv[i][0] == '-') {
            fprintf(stderr, "usage: %s [-v] [-l] [part of a test's name]...\n", argv[0]);
            exit(2);
        }
        else if (test_g.filter_count < TEST_MAX_FILTERS) test_g.filters[test_g.filter_count++] = argv[i];
    }
    if (!TEST_SANITIZED) {
        signal(SIGABRT, test_on_signal);
        signal(SIGSEGV, test_on_signal);
        signal(SIGFPE, test_on_signal);
        signal(SIGILL, test_on_signal);
        signal(SIGTERM, test_on_signal);
    }
}

TEST_FN void test_run(const char *name, void (*fn)(void)) {
    double start;
    int i, chosen = test_g.filter_count == 0;
    for (i = 0; i < test_g.filter_count; i++) chosen |= strstr(name, test_g.filters[i]) != NULL;
    if (!chosen) return;
    if (test_g.list) { printf("%s\n", name); return; }
    test_g.name = name;
    test_g.skip_reason = NULL;
    __atomic_store_n(&test_g.fails, 0u, __ATOMIC_RELAXED);
    start = test_now();
    fn();
    start = test_now() - start;
    if (test_g.fails > (unsigned)TEST_MAX_PRINTED) {
        printf("FAIL %s: %u failures in all, the first %d are shown\n", name, test_g.fails, (int)TEST_MAX_PRINTED);
    }
    if (test_g.fails != 0) test_g.failed++;
    else if (test_g.skip_reason != NULL) test_g.skipped++;
    else test_g.passed++;
    if (test_g.fails == 0 && test_g.skip_reason != NULL) printf("SKIP %s: %s\n", name, test_g.skip_reason);
    else if (test_g.verbose) printf("%s %s %.3f s\n", test_g.fails != 0 ? "FAIL" : "ok  ", name, start);
    test_g.name = NULL;
    fflush(stdout);
}

TEST_FN int test_end(void) { /* what main returns */
    if (test_g.list) return 0;
    printf("%d passed, %d failed", test_g.passed, test_g.failed);
    if (test_g.skipped != 0) printf(", %d skipped", test_g.skipped);
    printf("\n");
    fflush(stdout);
    return test_g.failed != 0;
}

typedef struct test_file { const char *name; int (*main_fn)(int, char **); } test_file;

TEST_FN int test_run_file(const test_file *files, int argc, char **argv) { /* the one that the program is called by */
    const char *name = argv[0], *p;
    for (p = argv[0]; *p != 0; p++)
        if (*p == '/' || *p == '\\') name = p + 1;
    for (; files->name != NULL; files++) {
        size_t n = strlen(files->name);
        if (strncmp(name, files->name, n) == 0 && (name[n] == 0 || name[n] == '.')) return files->main_fn(argc, argv);
    }
    fprintf(stderr, "%s: to be called by the name of one of its files, as a link\n", argv[0]);
    return 2;
}

/* ---- random numbers and hashes ---------------------------------------------------------------------------- */

typedef struct test_rng { uint64_t state; } test_rng; /* PCG-XSH-RR 64/32; any state is good */

TEST_FN test_rng test_rng_make(uint64_t seed) {
    test_rng r;
    r.state = (seed + 0x9e3779b97f4a7c15u) * 6364136223846793005u + 1442695040888963407u;
    return r;
}

TEST_FN uint32_t test_rng_u32(test_rng *r) {
    uint64_t s = r->state;
    uint32_t x = (uint32_t)(((s >> 18) ^ s) >> 27), k = (uint32_t)(s >> 59);
    r->state = s * 6364136223846793005u + 1442695040888963407u;
    return (x >> k) | (x << ((32u - k) & 31u));
}

TEST_FN uint64_t test_rng_u64(test_rng *r) {
    uint64_t hi = test_rng_u32(r);
    return (hi << 32) | test_rng_u32(r);
}

TEST_FN uint32_t test_rng_below(test_rng *r, uint32_t n) { /* [0,n), n > 0; the bias of 2^-32 does not matter here */
    return (uint32_t)(((uint64_t)test_rng_u32(r) * n) >> 32);
}

TEST_FN double test_rng_double(test_rng *r) { /* [0,1) */
    return (double)(test_rng_u64(r) >> 11) * (1.0 / 9007199254740992.0);
}

TEST_FN float test_rng_float(test_rng *r) { /* [0,1) */
    return (float)(test_rng_u32(r) >> 8) * (1.0f / 16777216.0f);
}

TEST_FN float test_rng_range(test_rng *r, float lo, float hi) { return lo + (hi - lo) * test_rng_float(r); }

TEST_FN float test_rng_bits(test_rng *r) { /* any float: NaN, infinities, denormals, -0 */
    uint32_t u = test_rng_u32(r);
    float f;
    memcpy(&f, &u, sizeof f);
    return f;
}

/* FNV-1a, 64 bit. Start with hash = 0; pass the result on to hash several pieces as one. */
TEST_FN uint64_t test_fnv1a(const void *data, size_t size, uint64_t hash) {
    const unsigned char *p = (const unsigned char *)data;
    size_t i;
    if (hash == 0) hash = 0xcbf29ce484222325u;
    for (i = 0; i < size; i++) hash = (hash ^ p[i]) * 0x100000001b3u;
    return hash;
}

/* ---- allocator that counts, fails on demand and checks ---------------------------------------------------- */

typedef struct test_alloc {
    /* set by the test, after test_alloc_init */
    int64_t fail_at;           /* this allocation (0 is the first) returns NULL; -1: none */
    int fail_after;            /* and so do all later ones */
    uint32_t fail_percent;     /* each allocation fails with this chance, from seed */
    uint64_t seed;
    uint64_t limit;            /* bytes alive at most, 0: none */
    /* read by the test; all changed atomically */
    int64_t count;             /* allocations asked for, failed ones too */
    int64_t failed;            /* allocations that returned NULL */
    int64_t live_blocks;
    uint64_t live_bytes, peak_bytes, total_bytes, largest;
    int64_t errors;            /* wrong size on free, overrun, free of something unknown */
} test_alloc;

typedef struct test_block { uint64_t magic, size, check, pad; } test_block; /* 32 bytes before each block */

#define TEST_BLOCK_LIVE 0x5a11ab1eb10c4a11u
#define TEST_BLOCK_DEAD 0xdeadb10cdeadb10cu
#define TEST_BLOCK_TAIL ((size_t)(TEST_SANITIZED ? 0 : 16)) /* under a sanitizer its own red zone does better */

TEST_FN void test_alloc_init(test_alloc *a) {
    memset(a, 0, sizeof *a);
    a->fail_at = -1;
}

TEST_FN void test_atomic_max(uint64_t *p, uint64_t v) {
    uint64_t seen = __atomic_load_n(p, __ATOMIC_RELAXED);
    while (v > seen && !__atomic_compare_exchange_n(p, &seen, v, 1, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {}
}

TEST_FN void *test_alloc_fn(size_t size, void *user) {
    test_alloc *a = (test_alloc *)user;
    int64_t k = __atomic_fetch_add(&a->count, 1, __ATOMIC_RELAXED);
    uint64_t now;
    unsigned char *p;
    test_block *b;
    int fail = k == a->fail_at || (a->fail_after && a->fail_at >= 0 && k > a->fail_at);
    if (a->fail_percent != 0) {
        test_rng r = test_rng_make(a->seed ^ ((uint64_t)k * 0x2545f4914f6cdd1du));
        fail |= test_rng_below(&r, 100) < a->fail_percent;
    }
    fail |= size > (size_t)-1 - 64;
    now = __atomic_add_fetch(&a->live_bytes, (uint64_t)size, __ATOMIC_RELAXED);
    fail |= a->limit != 0 && now > a->limit;
    p = fail ? NULL : (unsigned char *)malloc(sizeof(test_block) + size + TEST_BLOCK_TAIL);
    if (p == NULL) {
        __atomic_fetch_sub(&a->live_bytes, (uint64_t)size, __ATOMIC_RELAXED);
        __atomic_fetch_add(&a->failed, 1, __ATOMIC_RELAXED);
        return NULL;
    }
    test_atomic_max(&a->peak_bytes, now);
    test_atomic_max(&a->largest, (uint64_t)size);
    __atomic_fetch_add(&a->total_bytes, (uint64_t)size, __ATOMIC_RELAXED);
    __atomic_fetch_add(&a->live_blocks, 1, __ATOMIC_RELAXED);
    b = (test_block *)(void *)p;
    b->magic = TEST_BLOCK_LIVE;
    b->size = size;
    b->check = (uint64_t)size ^ TEST_BLOCK_LIVE;
    b->pad = 0;
    if (!TEST_MSAN) memset(p + sizeof(test_block), 0xcd, size); /* never zero by luck; MSan must see it as unset */
    if (TEST_BLOCK_TAIL != 0) memset(p + sizeof(test_block) + size, 0xfd, TEST_BLOCK_TAIL);
    return p + sizeof(test_block);
}

TEST_FN void test_free_fn(void *ptr, size_t size, void *user) {
    test_alloc *a = (test_alloc *)user;
    unsigned char *p = (unsigned char *)ptr;
    test_block *b;
    size_t i;
    int bad;
    if (ptr == NULL) return;
    b = (test_block *)(void *)(p - sizeof(test_block));
    if (b->magic != TEST_BLOCK_LIVE || b->check != (b->size ^ TEST_BLOCK_LIVE)) {
        __atomic_fetch_add(&a->errors, 1, __ATOMIC_RELAXED);
        test_fail(__FILE__, __LINE__, "free of %p, size %llu: no live block (freed twice, or written before its start)",
            ptr, (unsigned long long)size);
        return;
    }
    if (b->size != size) {
        __atomic_fetch_add(&a->errors, 1, __ATOMIC_RELAXED);
        test_fail(__FILE__, __LINE__, "free says %llu bytes, allocated were %llu",
            (unsigned long long)size, (unsigned long long)b->size);
    }
    size = (size_t)b->size;
    bad = 0;
    for (i = 0; i != TEST_BLOCK_TAIL; i++) bad |= p[size + i] != 0xfd;
    if (bad) {
        __atomic_fetch_add(&a->errors, 1, __ATOMIC_RELAXED);
        test_fail(__FILE__, __LINE__, "written behind the end of a block of %llu bytes", (unsigned long long)size);
    }
    __atomic_fetch_sub(&a->live_bytes, (uint64_t)size, __ATOMIC_RELAXED);
    __atomic_fetch_sub(&a->live_blocks, 1, __ATOMIC_RELAXED);
    b->magic = TEST_BLOCK_DEAD;
    memset(p, 0xdd, size);
    free(b);
}

#define test_alloc_check(a) test_alloc_check_at((a), __FILE__, __LINE__)
TEST_FN void test_alloc_check_at(const test_alloc *a, const char *file, int line) {
    if (a->live_blocks != 0 || a->live_bytes != 0) {
        test_fail(file, line, "leak: %lld blocks, %llu bytes are still allocated",
            (long long)a->live_blocks, (unsigned long long)a->live_bytes);
    }
    if (a->errors != 0) test_fail(file, line, "%lld errors in frees", (long long)a->errors);
}

/* A progress_fn that cancels at one question, counts them and those that say less is done than before. */
typedef struct test_stopper { uint64_t calls, stop_at, done; uint32_t backwards; } test_stopper;

TEST_FN int test_stop_fn(void *user, uint64_t done, uint64_t total) {
    test_stopper *s = (test_stopper *)user;
    s->backwards += done < s->done;
    s->done = done;
    CHECK(done <= total);
    return ++s->calls == s->stop_at;
}

/* ---- files ------------------------------------------------------------------------------------------------ */

/* Runs call(user, allocator, threads) with request 0, 1, 2, ... for memory refused, each once alone and once with all after it,
   until a run asks for no more. It returns 0, or no_memory, and that only where a request was refused (it may do with less),
   and leaves nothing. After the first 100 requests, steps grow by 1/sparse of the request's number (0: every request). */
TEST_FN void test_refuse_requests(const char *name, int (*call)(void *user, test_alloc *, unsigned threads), void *user, unsigned threads,
                                  int no_memory, uint32_t least, int sparse) {
    int64_t k, refused = 0;
    int all, done = 0;
    for (k = 0; !done && k < 100000; k += sparse == 0 || k < 100 ? 1 : 1 + k / sparse)
        for (all = 0; all < 2 && !done; all++) {
            test_alloc ta;
            int r;
            test_alloc_init(&ta);
            ta.fail_at = k;
            ta.fail_after = all;
            r = call(user, &ta, threads);
            CHECK_MSG(r == 0 || (r == no_memory && ta.failed > 0), "%s, request %d: result %d, %d refused", name, (int)k, r, (int)ta.failed);
            refused += r != 0;
            done = ta.failed == 0;
            CHECK(!done || r == 0);
            CHECK_MSG(ta.live_blocks == 0 && ta.errors == 0, "%s, request %d: %d blocks left", name, (int)k, (int)ta.live_blocks);
        }
    if (test_g.verbose) printf("%s, %u threads: %d requests\n", name, threads, (int)k - 1);
    CHECK_MSG(done && refused >= (int64_t)least, "%s: %d refused", name, (int)refused);
}

/* Path of a file of the test data, or NULL when it is not there: `if (!p) SKIP("no data");`. Valid until the
   eighth later call. */
TEST_FN const char *test_data_path(const char *name) {
    static char paths[8][1024];
    static unsigned next;
    char *path = paths[next++ % 8u];
    const char *dir = getenv("RENDER_DATA");
    FILE *f;
    if (dir == NULL || dir[0] == 0) dir = "../shared/data";
    if ((size_t)snprintf(path, sizeof paths[0], "%s/%s", dir, name) >= sizeof paths[0]) return NULL;
    f = fopen(path, "rb");
    if (f == NULL) return NULL;
    fclose(f);
    return path;
}

/* A path for a file that the test writes; different for each process and call. The test removes the file. */
TEST_FN const char *test_temp_path(const char *suffix) {
    static char paths[8][1024];
    static unsigned next;
    unsigned n = next++;
    const char *dir = getenv("TMPDIR");
    if (dir == NULL || dir[0] == 0) dir = getenv("TEMP"); /* Windows */
    if (dir == NULL || dir[0] == 0) dir = "/tmp";
    snprintf(paths[n % 8u], sizeof paths[0], "%s/test_%ld_%u%s", dir, (long)getpid(), n, suffix);
    return paths[n % 8u];
}

/* Whole file in memory from malloc, or NULL. One zero byte follows that is not counted in *size. */
TEST_FN unsigned char *test_read_file(const char *path, size_t *size) {
    FILE *f = path != NULL ? fopen(path, "rb") : NULL;
    unsigned char *p = NULL;
    long n = -1;
    *size = 0;
    if (f == NULL) return NULL;
    if (fseek(f, 0, SEEK_END) == 0) n = ftell(f);
    if (n >= 0 && fseek(f, 0, SEEK_SET) == 0) p = (unsigned char *)malloc((size_t)n + 1);
    if (p != NULL && fread(p, 1, (size_t)n, f) != (size_t)n) { free(p); p = NULL; }
    fclose(f);
    if (p != NULL) { p[n] = 0; *size = (size_t)n; }
    return p;
}

/* 0 when the file could not be written. */
TEST_FN int test_write_file(const char *path, const void *data, size_t size) {
    FILE *f = fopen(path, "wb");
    int ok;
    if (f == NULL) return 0;
    ok = fwrite(data, 1, size, f) == size;
    return fclose(f) == 0 && ok;
}

#endif /* TEST_H_INCLUDED */
