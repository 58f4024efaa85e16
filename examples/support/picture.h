/* picture.h - the files that --out and --depth of the programs name
   SPDX-License-Identifier: MIT OR Unlicense */
#ifndef SUP_PICTURE_H
#define SUP_PICTURE_H
#include "camera.h"
#include "cli.h"
#include "png.h"

/* 1 when the name ends with `end`. */
SUP_FN int sup_name_ends(const char *name, const char *end) {
    const size_t n = strlen(name), k = strlen(end);
    return n > k && strcmp(name + n - k, end) == 0;
}

/* 1 when --out wants linear floats instead of sRGB bytes. */
SUP_FN int sup_out_is_linear(const sup_common *common) {
    return common->out && sup_name_ends(common->out, ".pfm");
}

/* What is wrong with --out and --depth, before any work is done: nothing asked for, or an ending that no picture has.
   Returns -1 to go on, else 2 after a message. */
SUP_FN int sup_out_check(const char *program, const sup_common *common) {
    if (!common->out && !common->depth && !common->stats) return sup_bad_usage(program, "--out FILE is missing");
    if (common->out && !sup_name_ends(common->out, ".png") && !sup_name_ends(common->out, ".pfm"))
        return sup_bad_usage(program, "--out: \"%s\" ends with neither .png nor .pfm", common->out);
    if (common->depth && !sup_name_ends(common->depth, ".pfm"))
        return sup_bad_usage(program, "--depth: \"%s\" does not end with .pfm", common->depth);
    return -1;
}

/* Write what --out and --depth name.
   rgba8, rgba, depth   [height][width][4], [4], 1, rows without gaps; those that are not written may be NULL. The
                        floats of a linear picture are packed in place and useless afterwards.
   Returns 0, or 1 with err set. */
SUP_FN int sup_out_write(const sup_common *common, const uint8_t *rgba8, float *rgba, const float *depth,
                         uint32_t width, uint32_t height, sup_error *err) {
    const size_t pixels = (size_t)width * height;
    size_t i;
    if (common->depth && sup_pfm_write(common->depth, depth, width, height, 1, err)) return 1;
    if (!common->out) return 0;
    if (!sup_out_is_linear(common)) return sup_png_write8(common->out, rgba8, width, height, 4, err);
    for (i = 0; i < pixels; i++) memmove(rgba + 3 * i, rgba + 4 * i, 12);
    return sup_pfm_write(common->out, rgba, width, height, 3, err);
}

#endif
