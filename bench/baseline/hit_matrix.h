/* hit_matrix.h - where the rays of zbufrand.h hit, for pictures by rays alone - MIT OR Unlicense, see LICENSE
   It uses private functions and brings zbufrand.h with its implementation where that is not there yet. */
#ifndef BASELINE_HIT_MATRIX_H_INCLUDED
#define BASELINE_HIT_MATRIX_H_INCLUDED
#ifndef ZBUFRAND_IMPLEMENTATION
#  define ZBUFRAND_IMPLEMENTATION
#endif
#include "../../zbufrand.h"

/* Coordinates of the structure that was hit to those of structure 0. */
static void baseline_hit_matrix(const zbufrandi_rays *r, const zbufrandi_ray_hit *hit, double out[3][4]) {
    uint32_t structure = 0, k;
    zbufrandi_m34_identity(out);
    for (k = 0; k < hit->levels; k++) {
        const zbufrandi_instance *in = &r->structure[structure].instance[hit->path[k]];
        zbufrandi_m34_mul(ZBUFRANDI_M34(out), in->to_parent, out);
        structure = in->structure;
    }
}

#endif
