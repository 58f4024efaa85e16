/* opacity_slices.h - the thesis' slices of different distance and their opacity, to be compared with - MIT OR Unlicense, see LICENSE

   Bricks of level k are cut by slices 2^k d apart, at whole multiples of that from the eye, and each slice counts for the
   way to the next one: opacity 1 - (1 - a)^(2^k). Where a ray goes from one level to another within such a way, part of
   it counts twice or not at all. Seen from one ray, with slot n the way from n d to (n+1) d and level[n] of the brick
   there:
     OPACITY_NAIVE     slot n counts 2^level[n] d where n is a multiple of that, else nothing
     OPACITY_REPAIRED  the thesis clips each slice with the projections of the slices before and behind it, and gives the
                       pieces the opacity of the finer level. A slice of the coarser level k + 1: an even one counts 2^k
                       where 2^k slots on there is a finer brick; an odd one is put in, with 2^k, where 2^k slots back
                       there is one
     OPACITY_EXACT     each slot counts d: what the slices stand for
   The thesis' text has the opacity of the coarser slice in the second case; that is wrong (OPACITY_MISPRINT).
   Levels along a ray differ by one at most from slot to slot. Returns for each slot its way in slots. */
#ifndef OPACITY_SLICES_H_INCLUDED
#define OPACITY_SLICES_H_INCLUDED
#include <stddef.h>
#include <stdint.h>

typedef enum opacity_rule { OPACITY_NAIVE, OPACITY_REPAIRED, OPACITY_MISPRINT, OPACITY_EXACT } opacity_rule;

static void opacity_slots(opacity_rule how, const uint8_t *level, size_t n, uint32_t *ways) {
    size_t i;
    for (i = 0; i < n; i++) {
        const uint32_t k = level[i], whole = (uint32_t)1 << k, half = whole >> 1;
        ways[i] = 0;
        if (how == OPACITY_EXACT) {
            ways[i] = 1;
            continue;
        }
        if (i % whole == 0) {
            ways[i] = whole;
            if (how != OPACITY_NAIVE && k > 0 && i + half < n && level[i + half] < k) ways[i] = half;
        } else if (how != OPACITY_NAIVE && k > 0 && i % whole == half && level[i - half] < k) {
            ways[i] = how == OPACITY_MISPRINT ? whole : half;
        }
    }
}

#endif
