/* lipschitz_steps.h - steps along a ray by how steep the values are, to be compared with - MIT OR Unlicense, see LICENSE

   What a sampler does that knows a bound of the slope for each brick: a step is as long as the value cannot change by more
   than `delta` in it. The bound here is the best one there can be, the largest difference of neighbours on the ray itself
   within its brick, so no other bound takes fewer steps.
     v        values on the ray at 0, 1 .. n-1
     brick    so many units long; each one is cut into equal steps
     longest  step, in units
     x        out, [room]: borders of steps, ascending, from 0 to n-1
   Returns how many borders there are. No more steps than fit are made: n (range of v / delta + 1) are always enough. */
#ifndef LIPSCHITZ_STEPS_H_INCLUDED
#define LIPSCHITZ_STEPS_H_INCLUDED
#include <math.h>
#include <stddef.h>

static size_t lipschitz_steps(const float *v, size_t n, size_t brick, double delta, double longest, float *x, size_t room) {
    size_t from, out = 0;
    if (n == 0 || room == 0) return 0;
    for (from = 0; from + 1 < n; from += brick) {
        const size_t to = from + brick < n ? from + brick : n - 1, left = room - 1 - out;
        double slope = 0.0, steps;
        size_t i, count;
        for (i = from; i < to; i++) slope = fmax(slope, fabs((double)v[i + 1] - (double)v[i]));
        steps = ceil((double)(to - from) * fmax(slope / delta, 1.0 / longest));
        count = steps < (double)left ? (size_t)steps : left;
        for (i = 0; i < count; i++) x[out++] = (float)((double)from + (double)(to - from) * (double)i / (double)count);
    }
    x[out++] = (float)(n - 1);
    return out;
}

#endif
