/* support_memory.h - allocations of examples/support: counted, and made to fail on demand; include test.h before it and
   the headers of examples/support behind it
   SPDX-License-Identifier: MIT OR Unlicense */
#ifndef SUPPORT_MEMORY_H_INCLUDED
#define SUPPORT_MEMORY_H_INCLUDED
#include "test.h"

static struct {
    int64_t fail_at; /* this allocation since the last reset fails, 0 is the first; -1: none */
    int64_t count, live;
    size_t largest;
} g_memory = {-1, 0, 0, 0};

TEST_FN void *memory_resize(void *ptr, size_t size) {
    void *p;
    if (g_memory.count++ == g_memory.fail_at) return NULL;
    p = realloc(ptr, size);
    if (size > g_memory.largest) g_memory.largest = size;
    if (p && !ptr) g_memory.live++;
    return p;
}

TEST_FN void memory_release(void *ptr) {
    if (ptr) g_memory.live--;
    free(ptr);
}

TEST_FN void memory_reset(int64_t fail_at) {
    g_memory.fail_at = fail_at;
    g_memory.count = 0;
    g_memory.largest = 0;
}

#define SUP_MALLOC(size) memory_resize(NULL, size)
#define SUP_REALLOC(ptr, size) memory_resize(ptr, size)
#define SUP_FREE(ptr) memory_release(ptr)

#endif
