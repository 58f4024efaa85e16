/* base.h - errors, checked memory and whole-file input and output shared by the example programs
   SPDX-License-Identifier: MIT OR Unlicense

   Include this header, or any other of this folder, before the first system header: it asks for the POSIX
   declarations (clock, terminal test) that -std=c99 hides otherwise. Every function is static, so a program just
   includes what it needs. Names beginning with supi_ are private to this folder. */
#ifndef SUP_BASE_H
#define SUP_BASE_H

#if !defined(_POSIX_C_SOURCE) && !defined(_GNU_SOURCE) && !defined(_WIN32)
#define _POSIX_C_SOURCE 200809L
#endif

#include <errno.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#if defined(_WIN32)
#include <process.h>
#else
#include <sys/stat.h>
#include <unistd.h>
#endif

#if defined(__GNUC__) || defined(__clang__)
#define SUP_FN static __attribute__((unused))
#define SUP_PRINTF(format_at, first_at) __attribute__((format(printf, format_at, first_at)))
#else
#define SUP_FN static
#define SUP_PRINTF(format_at, first_at)
#endif

/* Tests replace these three to make the n-th allocation fail. */
#ifndef SUP_MALLOC
#define SUP_MALLOC(size) malloc(size)
#define SUP_REALLOC(ptr, size) realloc(ptr, size)
#define SUP_FREE(ptr) free(ptr)
#endif

/* What went wrong, or what deserves a warning, as one line without a line feed: "file.ply: line 12: bad number".
   A function that takes a sup_error accepts NULL; it empties the text first. */
typedef struct sup_error {
    char text[256];
} sup_error;

/* Write a message into `err` (which may be NULL) and return 1, so that a function can end with it.
   Longer messages are cut. Allocates nothing. */
SUP_FN int sup_fail(sup_error *err, const char *format, ...) SUP_PRINTF(2, 3);
SUP_FN int sup_fail(sup_error *err, const char *format, ...) {
    if (err) {
        va_list args;
        va_start(args, format);
        (void)vsnprintf(err->text, sizeof err->text, format, args);
        va_end(args);
    }
    return 1;
}

/* Empty `err`, which may be NULL. */
SUP_FN void sup_error_clear(sup_error *err) {
    if (err) err->text[0] = '\0';
}

/* Multiply two sizes into *out; returns 0, or 1 when the product does not fit. */
SUP_FN int sup_mul_size(size_t a, size_t b, size_t *out) {
    if (b != 0 && a > SIZE_MAX / b) return 1;
    *out = a * b;
    return 0;
}

/* Allocate `count` items of `size` bytes, not cleared; free with SUP_FREE.
   Never NULL for a count of zero; NULL when the product overflows or memory is short. */
SUP_FN void *sup_alloc(size_t count, size_t size) {
    size_t bytes;
    if (sup_mul_size(count, size, &bytes)) return NULL;
    return SUP_MALLOC(bytes ? bytes : 1);
}

/* Make room for `needed` items of `size` bytes in `array` (NULL at first), at least doubling *capacity.
   Returns the array, which may have moved, or NULL: then the old array is still valid and still the caller's. */
SUP_FN void *sup_grow(void *array, size_t *capacity, size_t needed, size_t size) {
    size_t target, bytes;
    void *grown;
    if (array && needed <= *capacity) return array;
    target = *capacity < 16 ? 16 : *capacity;
    while (target < needed) target = target > SIZE_MAX / 2 ? needed : target * 2;
    if (sup_mul_size(target, size, &bytes)) return NULL;
    grown = SUP_REALLOC(array, bytes);
    if (grown) *capacity = target;
    return grown;
}

/* Bytes of memory that a program may take: three quarters of what the machine has. More would be promised by many
   systems, and the program killed when it uses it. 0: not known. */
SUP_FN size_t sup_memory_limit(void) {
#if defined(_SC_PHYS_PAGES) && defined(_SC_PAGESIZE)
    const long pages = sysconf(_SC_PHYS_PAGES), page = sysconf(_SC_PAGESIZE);
    size_t bytes;
    if (pages <= 0 || page <= 0) return 0;
    if (sup_mul_size((size_t)pages, (size_t)page, &bytes)) bytes = SIZE_MAX;
    return bytes / 4 * 3;
#else
    return 0;
#endif
}

/* Read the whole file `path` into memory.
   data  out: the bytes and one extra zero byte behind them; free with SUP_FREE. NULL on error.
   size  out: number of bytes without the extra one
   Returns 0, or 1 with err->text set. Works for pipes; refuses folders. Memory: at most twice the file. */
SUP_FN int sup_read_file(const char *path, char **data, size_t *size, sup_error *err) {
    FILE *file;
    char *buffer = NULL;
    size_t capacity = 0, used = 0, hint = 0, want = 65536;
    const size_t limit = sup_memory_limit(); /* an endless stream must not take all there is */
    sup_error_clear(err);
    *data = NULL;
    *size = 0;
    file = fopen(path, "rb");
    if (!file) return sup_fail(err, "%s: %s", path, strerror(errno));
    if (fseek(file, 0, SEEK_END) == 0) {
        const long length = ftell(file);
        if (length > 0) hint = (size_t)length;
        if (fseek(file, 0, SEEK_SET) != 0) hint = 0;
    }
    /* The first piece is small whatever the length says: a folder claims a huge one and fails when it is read. */
    for (;;) {
        size_t got;
        void *grown = want < SIZE_MAX - used && (limit == 0 || used < limit / 2) ? sup_grow(buffer, &capacity, used + want + 1, 1) : NULL;
        if (!grown) {
            SUP_FREE(buffer);
            (void)fclose(file);
            return sup_fail(err, "%s: out of memory after %lu bytes", path, (unsigned long)used);
        }
        buffer = (char *)grown;
        errno = 0;
        got = fread(buffer + used, 1, want, file);
        used += got;
        if (ferror(file)) {
            const int code = errno;
            SUP_FREE(buffer);
            (void)fclose(file);
            return sup_fail(err, "%s: %s", path, code ? strerror(code) : "read error");
        }
        if (got < want) break;
        want = hint > used ? hint - used + 1 : used;
    }
    (void)fclose(file);
    buffer[used] = '\0';
    *data = buffer;
    *size = used;
    return 0;
}

/* 1 when `path` is a plain file: for names that come from a file, which may as well name a device or a pipe. */
SUP_FN int sup_is_plain_file(const char *path) {
#if defined(_WIN32)
    return path[0] != '\0'; /* names like CON are not looked for */
#else
    struct stat about;
    return stat(path, &about) == 0 && S_ISREG(about.st_mode);
#endif
}

/* 1 when `path` is there and is more than a plain file: a device, a pipe, a link. Such a thing is written to; a new file
   of its name would take its place. */
SUP_FN int sup_is_special_file(const char *path) {
#if defined(_WIN32)
    return path[0] == '\0';
#else
    struct stat about;
    return lstat(path, &about) == 0 && !S_ISREG(about.st_mode) && !S_ISDIR(about.st_mode);
#endif
}

/* A file being written beside its final name; see sup_file_open. */
typedef struct sup_file {
    FILE *stream;
    char *path;
    char *temporary; /* empty: written in place */
} sup_file;

SUP_FN void supi_file_forget(sup_file *file) {
    SUP_FREE(file->path);
    SUP_FREE(file->temporary);
    memset(file, 0, sizeof *file);
}

/* Begin to write `path` so that it appears whole or not at all: out->stream is a new file beside it. Only what is more
   than a plain file (sup_is_special_file) is written in place.
   End with sup_file_commit, which gives it its name, or with sup_file_abort, which removes it.
   Returns 0, or 1 with err->text set and nothing to clean up. */
SUP_FN int sup_file_open(const char *path, sup_file *out, sup_error *err) {
    const size_t length = strlen(path);
    const size_t room = length + 64;
    sup_error_clear(err);
    out->stream = NULL;
    out->path = (char *)sup_alloc(length + 1, 1);
    out->temporary = (char *)sup_alloc(room, 1);
    if (!out->path || !out->temporary) {
        supi_file_forget(out);
        (void)sup_fail(err, "%s: out of memory", path);
        return 1;
    }
    memcpy(out->path, path, length + 1);
    /* The process and the address of a block in use make the name unique even among threads. */
    (void)snprintf(out->temporary, room, "%s.%ld-%lx.tmp", path,
#if defined(_WIN32)
                   (long)_getpid(),
#else
                   (long)getpid(),
#endif
                   (unsigned long)((uintptr_t)out->temporary >> 4));
    if (sup_is_special_file(path)) out->temporary[0] = '\0';
    out->stream = fopen(out->temporary[0] ? out->temporary : path, "wb");
    if (!out->stream) {
        const int code = errno;
        supi_file_forget(out);
        (void)sup_fail(err, "%s: %s", path, strerror(code));
        return 1;
    }
    return 0;
}

/* Give up a file begun with sup_file_open: remove what was written. */
SUP_FN void sup_file_abort(sup_file *file) {
    (void)fclose(file->stream);
    if (file->temporary[0]) (void)remove(file->temporary);
    supi_file_forget(file);
}

/* Finish a file begun with sup_file_open and give it its name, replacing an older file of that name.
   Returns 0, or 1 with err->text set (disk full, for example); then no file is left behind. */
SUP_FN int sup_file_commit(sup_file *file, sup_error *err) {
    int failed = ferror(file->stream);
    int code = errno;
    sup_error_clear(err);
    if (fclose(file->stream) != 0) {
        failed = 1;
        code = errno;
    }
    file->stream = NULL;
    if (!failed && file->temporary[0]) {
#if defined(_WIN32)
        (void)remove(file->path); /* rename does not replace there */
#endif
        if (rename(file->temporary, file->path) != 0) {
            failed = 1;
            code = errno;
        }
    }
    if (failed) {
        if (file->temporary[0]) (void)remove(file->temporary);
        (void)sup_fail(err, "%s: %s", file->path, code ? strerror(code) : "write error");
    }
    supi_file_forget(file);
    return failed ? 1 : 0;
}

/* Write `size` bytes as the file `path`, whole or not at all. Returns 0, or 1 with err->text set. */
SUP_FN int sup_write_file(const char *path, const void *data, size_t size, sup_error *err) {
    sup_file file;
    if (sup_file_open(path, &file, err)) return 1;
    if (size && fwrite(data, 1, size, file.stream) != size) {
        const int code = errno;
        sup_file_abort(&file);
        return sup_fail(err, "%s: %s", path, code ? strerror(code) : "write error");
    }
    return sup_file_commit(&file, err);
}

#endif
