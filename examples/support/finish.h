/* finish.h - materials of MTL files -> what voxrt makes of surfaces
   SPDX-License-Identifier: MIT OR Unlicense */
#ifndef SUP_FINISH_H
#define SUP_FINISH_H

#include "mesh.h"
#include "voxrt.h"

/* The illumination models of MTL files: 3, 5 and 8 mirror by Ks; 4, 6, 7 and 9 are glass, bent by Ni; d below 1 alone is a
   thin pane. What is transparent shows its colour (Tf, else none) in what goes through. What could not be seen at all is
   opaque: some exporters write Tf 1 with Ni 1 for that, others Tr 1. Returns 0 for a plain one. */
SUP_FN int sup_finish_of(const sup_material *m, voxrt_finish *f) {
    const int mirror = m->illum == 3 || m->illum == 5 || m->illum == 8;
    const int glass = m->illum == 4 || m->illum == 6 || m->illum == 7 || m->illum == 9;
    int any = 0, hidden, a;
    memset(f, 0, sizeof *f);
    f->diffuse = 1.0f;
    f->shininess = m->shininess;
    f->refraction = glass && m->ni >= 0.0625f && m->ni != 1.0f ? m->ni : 0.0f;
    hidden = f->refraction <= 0.0f;
    for (a = 0; a < 3; a++) {
        const float through = m->has_opacity || !glass ? 1.0f - m->opacity : m->has_transmit ? 1.0f : 0.0f;
        f->specular[a] = m->illum == 0 || m->illum == 1 ? 0.0f : m->specular[a];
        f->mirror[a] = mirror ? m->specular[a] < 1.0f ? m->specular[a] : 1.0f : 0.0f;
        f->transparency[a] = through * m->transmit[a];
        f->emission[a] = m->emission[a];
        hidden = hidden && f->transparency[a] >= 1.0f && f->emission[a] <= 0.0f;
    }
    for (a = 0; a < 3; a++) {
        if (hidden) f->transparency[a] = 0.0f;
        any |= f->specular[a] > 0.0f || f->mirror[a] > 0.0f || f->transparency[a] > 0.0f || f->emission[a] > 0.0f;
    }
    return any;
}

#endif
