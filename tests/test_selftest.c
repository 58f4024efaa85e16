/* test_selftest.c - the parts of test.h that other tests rely on */
#include "test.h"

TEST(alloc_counts) {
    test_alloc a;
    void *p, *q;
    test_alloc_init(&a);
    p = test_alloc_fn(100, &a);
    q = test_alloc_fn(0, &a);
    REQUIRE(p != NULL && q != NULL);
#if defined(__EMSCRIPTEN__) /* what its malloc of 2022 gives */
    CHECK(((size_t)p & 7u) == 0);
#else
    CHECK(((size_t)p & 15u) == 0);
#endif
    CHECK_EQ_I64(a.live_blocks, 2);
    CHECK_EQ_U64(a.live_bytes, 100);
    test_free_fn(p, 100, &a);
    test_free_fn(q, 0, &a);
    CHECK_EQ_U64(a.peak_bytes, 100);
    CHECK_EQ_I64(a.count, 2);
    test_alloc_check(&a);
}

TEST(alloc_fails_on_demand) {
    test_alloc a;
    void *p;
    test_alloc_init(&a);
    a.fail_at = 1;
    p = test_alloc_fn(8, &a);
    CHECK(p != NULL);
    CHECK(test_alloc_fn(8, &a) == NULL);
    CHECK(test_alloc_fn((size_t)-1, &a) == NULL);
    a.limit = 16;
    CHECK(test_alloc_fn(9, &a) == NULL);
    test_free_fn(p, 8, &a);
    CHECK_EQ_I64(a.failed, 3);
    test_alloc_check(&a);
    test_alloc_init(&a);
    a.fail_at = 0;
    a.fail_after = 1;
    CHECK(test_alloc_fn(8, &a) == NULL && test_alloc_fn(8, &a) == NULL);
}

TEST(hash_known_values) {
    CHECK_EQ_U64(test_fnv1a("", 0, 0), 0xcbf29ce484222325u);
    CHECK_EQ_U64(test_fnv1a("foobar", 6, 0), 0x85944171f73967e8u);
    CHECK_EQ_U64(test_fnv1a("bar", 3, test_fnv1a("foo", 3, 0)), 0x85944171f73967e8u);
}

TEST(rng_ranges) {
    test_rng r = test_rng_make(1);
    double sum = 0;
    int i;
    for (i = 0; i < 10000; i++) {
        double d = test_rng_double(&r);
        float f = test_rng_float(&r);
        CHECK(d >= 0 && d < 1 && f >= 0 && f < 1);
        CHECK(test_rng_below(&r, 7) < 7);
        sum += d;
    }
    CHECK_NEAR(sum / 10000, 0.5, 0.02);
}

TEST(files_round_trip) {
    const char *path = test_temp_path(".bin");
    unsigned char *p;
    size_t n;
    REQUIRE(test_write_file(path, "a\0b", 3));
    p = test_read_file(path, &n);
    remove(path);
    CHECK(p != NULL && n == 3 && memcmp(p, "a\0b", 4) == 0);
    free(p);
    CHECK(test_read_file(path, &n) == NULL && n == 0);
}

int main(int argc, char **argv) {
    test_begin(argc, argv);
    RUN(alloc_counts);
    RUN(alloc_fails_on_demand);
    RUN(hash_known_values);
    RUN(rng_ranges);
    RUN(files_round_trip);
    return test_end();
}
