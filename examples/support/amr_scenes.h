/* amr_scenes.h - a generated grid with local refinement - MIT OR Unlicense, see LICENSE

   Include it after tetcast.h. */
#ifndef SUP_AMR_SCENES_H
#define SUP_AMR_SCENES_H
#ifndef TETCAST_VERSION_MAJOR
#error "include tetcast.h before this header"
#endif

#include "base.h"
#include <math.h>

enum { SUP_BLAST_BLOCK = 8 }; /* cells of a patch along each side */

/* A blast wave: dense shell around thin gas, in a unit cube. */
SUP_FN double sup_blast(double x, double y, double z) {
    const double r = sqrt((x - 0.4) * (x - 0.4) + (y - 0.45) * (y - 0.45) + (z - 0.5) * (z - 0.5)) / 0.34;
    const double ripple = 1.0 + 0.05 * sin(9.0 * x + 4.0 * z) * cos(11.0 * y - 3.0 * x);
    const double inside = 4.0 * pow(r * ripple, 6.0), edge = 1.0 / (1.0 + exp((r * ripple - 1.0) * 60.0));
    return edge * inside + (1.0 - edge);
}

/* Patches of `levels` levels, the coarsest of `cells` (a multiple of 8) along each side, refined by 2 around the shell.
   *patches and *values are from SUP_MALLOC. Returns 1: no memory. */
SUP_FN int sup_blast_patches(uint32_t levels, uint32_t cells, tetcast_patch **patches, size_t *count, float **values) {
    const size_t each = SUP_BLAST_BLOCK * SUP_BLAST_BLOCK * SUP_BLAST_BLOCK;
    size_t n = 0;
    *patches = NULL;
    *values = NULL;
    for (int pass = 0; pass < 2; pass++) {
        n = 0;
        for (uint32_t k = 0; k < levels; k++) {
            const uint32_t blocks = (cells << k) / SUP_BLAST_BLOCK;
            const double side = 1.0 / (double)blocks, cell = 1.0 / (double)(cells << k);
            for (size_t i = 0; i < (size_t)blocks * blocks * blocks; i++) {
                const size_t at[3] = {i % blocks, i / blocks % blocks, i / blocks / blocks};
                float *v;
                if (k > 0) { /* blocks whose corners, or middles, are on both sides of the shell */
                    double least = 1e30, most = 0.0;
                    for (int c = 0; c < 27; c++) {
                        const double v0 = sup_blast(((double)at[0] + 0.5 * (c % 3)) * side, ((double)at[1] + 0.5 * (c / 3 % 3)) * side,
                                                    ((double)at[2] + 0.5 * (c / 9)) * side);
                        least = v0 < least ? v0 : least;
                        most = v0 > most ? v0 : most;
                    }
                    if (most - least < 0.35) continue;
                }
                if (pass == 1) {
                    tetcast_patch *p = *patches + n;
                    v = *values + n * each;
                    p->level = k;
                    for (int a = 0; a < 3; a++) {
                        p->lo[a] = (int32_t)(at[a] * SUP_BLAST_BLOCK);
                        p->dims[a] = SUP_BLAST_BLOCK;
                    }
                    p->values = v;
                    for (size_t c = 0; c < each; c++)
                        v[c] = (float)sup_blast(((double)(at[0] * SUP_BLAST_BLOCK + c % SUP_BLAST_BLOCK) + 0.5) * cell,
                                                ((double)(at[1] * SUP_BLAST_BLOCK + c / SUP_BLAST_BLOCK % SUP_BLAST_BLOCK) + 0.5) * cell,
                                                ((double)(at[2] * SUP_BLAST_BLOCK + c / SUP_BLAST_BLOCK / SUP_BLAST_BLOCK) + 0.5) * cell);
                }
                n++;
            }
        }
        if (pass == 0) {
            *patches = (tetcast_patch *)sup_alloc(n, sizeof **patches);
            *values = (float *)sup_alloc(n * each, sizeof **values);
            if (!*patches || !*values) {
                SUP_FREE(*patches);
                SUP_FREE(*values);
                return 1;
            }
        }
    }
    *count = n;
    return 0;
}

#endif
