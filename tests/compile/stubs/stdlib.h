#ifndef STUB_STDLIB_H
#define STUB_STDLIB_H
#include <stddef.h>
#ifdef __cplusplus
extern "C" {
#endif
void *malloc(size_t);
void *calloc(size_t, size_t);
void free(void *);
void *_aligned_malloc(size_t, size_t);
void _aligned_free(void *);
void *__mingw_aligned_malloc(size_t, size_t);
void __mingw_aligned_free(void *);
char *getenv(const char *);
#ifdef __cplusplus
}
#endif
#endif
