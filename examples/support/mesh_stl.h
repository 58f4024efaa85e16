/* mesh_stl.h - STL reader, text and binary; included by mesh.h
   SPDX-License-Identifier: MIT OR Unlicense */
#ifndef SUP_MESH_STL_H
#define SUP_MESH_STL_H

#ifndef SUP_MESH_H
#error "include mesh.h instead"
#endif

SUP_FN uint32_t supi_little32(const char *p) {
    const uint32_t b0 = (uint8_t)p[0], b1 = (uint8_t)p[1], b2 = (uint8_t)p[2], b3 = (uint8_t)p[3];
    return b0 | (b1 << 8) | (b2 << 16) | (b3 << 24);
}

/* A binary file is as long as its count says. Many begin with "solid" as text files do, so the length decides. */
SUP_FN int supi_stl_is_binary(const char *data, size_t size) {
    return size >= 84 && (size - 84) % 50 == 0 && (size - 84) / 50 == supi_little32(data + 80);
}

/* Vertices made one by the bits of their coordinates, so that neighbours share them and normals can be smooth. */
typedef struct supi_weld {
    float *positions;
    uint32_t *slots; /* index of a vertex + 1, 0: free */
    size_t count, capacity, mask;
} supi_weld;

SUP_FN void supi_weld_free(supi_weld *weld) {
    SUP_FREE(weld->positions);
    SUP_FREE(weld->slots);
    memset(weld, 0, sizeof *weld);
}

SUP_FN size_t supi_weld_slot(const supi_weld *weld, const float *p) {
    uint32_t bits[3];
    size_t slot;
    memcpy(bits, p, sizeof bits);
    slot = (size_t)supi_mix(supi_mix(bits[0] | ((uint64_t)bits[1] << 32)) ^ bits[2]) & weld->mask;
    while (weld->slots[slot] && memcmp(weld->positions + 3 * (size_t)(weld->slots[slot] - 1), p, sizeof bits) != 0) {
        slot = (slot + 1) & weld->mask;
    }
    return slot;
}

/* Index of the vertex at `p`, which is added when it is new. Returns 1 when memory or indices run out. */
SUP_FN int supi_weld_add(supi_weld *weld, const float *point, uint32_t *index) {
    float p[3];
    size_t slot, i;
    for (i = 0; i < 3; i++) p[i] = point[i] == 0.0f ? 0.0f : point[i]; /* -0 is the same place as 0 */
    if (!weld->slots || weld->count * 2 > weld->mask) {
        const size_t slots = weld->slots ? (weld->mask + 1) * 2 : 1024;
        uint32_t *bigger = (uint32_t *)sup_alloc(slots, sizeof *bigger);
        if (!bigger) return 1;
        memset(bigger, 0, slots * sizeof *bigger);
        SUP_FREE(weld->slots);
        weld->slots = bigger;
        weld->mask = slots - 1;
        for (i = 0; i < weld->count; i++) weld->slots[supi_weld_slot(weld, weld->positions + 3 * i)] = (uint32_t)i + 1;
    }
    slot = supi_weld_slot(weld, p);
    if (!weld->slots[slot]) {
        if (weld->count >= 0xfffffffeu) return 1;
        if (!weld->positions || 3 * weld->count + 3 > weld->capacity) {
            void *grown = sup_grow(weld->positions, &weld->capacity, 3 * weld->count + 3, sizeof(float));
            if (!grown) return 1;
            weld->positions = (float *)grown;
        }
        memcpy(weld->positions + 3 * weld->count, p, sizeof p);
        weld->slots[slot] = (uint32_t)++weld->count;
    }
    *index = weld->slots[slot] - 1;
    return 0;
}

SUP_FN int supi_read_stl_binary(const sup_text *text, const char *name, supi_weld *weld, supi_faces *faces,
                                sup_error *err) {
    const size_t size = (size_t)(text->end - text->begin);
    size_t count, t, k, j;
    if (size < 84) return sup_fail(err, "%s: byte %lu: the STL header is cut off", name, (unsigned long)size);
    count = supi_little32(text->begin + 80);
    if (count > (size - 84) / 50) {
        return sup_fail(err, "%s: byte %lu: %lu triangles are announced but the file ends in triangle %lu", name,
                        (unsigned long)size, (unsigned long)count, (unsigned long)((size - 84) / 50));
    }
    for (t = 0; t < count; t++) {
        const char *record = text->begin + 84 + 50 * t + 12; /* behind the normal, which is often wrong or zero */
        uint32_t corner[3] = {0, 0, 0};
        for (k = 0; k < 3; k++) {
            float p[3];
            for (j = 0; j < 3; j++) {
                const uint32_t bits = supi_little32(record + 12 * k + 4 * j);
                memcpy(p + j, &bits, sizeof bits);
            }
            if (supi_weld_add(weld, p, corner + k)) return sup_fail(err, "%s: out of memory", name);
        }
        if (supi_add_polygon(faces, weld->positions, corner, 3)) return sup_fail(err, "%s: out of memory", name);
    }
    if (size - 84 > 50 * count)
        (void)sup_fail(err, "%s: %lu bytes behind the last triangle", name, (unsigned long)(size - 84 - 50 * count));
    return 0;
}

SUP_FN int supi_read_stl_text(sup_text *text, const char *name, supi_weld *weld, supi_faces *faces, sup_error *err) {
    uint32_t *corners = NULL;
    size_t corner_count = 0, corner_capacity = 0;
    int in_facet = 0, in_solid = 0, failed = 0;
    const char *wrong = NULL;
    for (;;) {
        sup_text_skip_space(text);
        if (text->at == text->end) {
            if (in_facet || in_solid) wrong = "the file ends before endsolid";
            break;
        }
        if (sup_text_is_word(text->at, text->end, "vertex")) {
            float p[3];
            size_t k;
            void *grown;
            uint32_t index;
            text->at += 6;
            for (k = 0; k < 3 && !wrong; k++) {
                sup_text_skip_space(text);
                if (sup_parse_float(&text->at, text->end, p + k)) wrong = "a vertex needs three numbers";
            }
            if (!wrong && !in_facet) wrong = "vertex outside of a facet";
            if (wrong) break;
            grown = sup_grow(corners, &corner_capacity, corner_count + 1, sizeof *corners);
            if (!grown || supi_weld_add(weld, p, &index)) {
                if (grown) corners = (uint32_t *)grown;
                failed = sup_fail(err, "%s: out of memory", name);
                break;
            }
            corners = (uint32_t *)grown;
            corners[corner_count++] = index;
        } else if (sup_text_is_word(text->at, text->end, "endfacet")) {
            text->at += 8;
            if (!in_facet) {
                wrong = "endfacet without facet";
                break;
            }
            in_facet = 0;
            if (supi_add_polygon(faces, weld->positions, corners, corner_count)) {
                failed = sup_fail(err, "%s: out of memory", name);
                break;
            }
        } else if (sup_text_is_word(text->at, text->end, "facet")) {
            if (in_facet || !in_solid) {
                wrong = in_facet ? "facet in a facet" : "facet outside of a solid";
                break;
            }
            in_facet = 1;
            corner_count = 0;
            sup_text_skip_line(text);
        } else if (sup_text_is_word(text->at, text->end, "outer")) {
            text->at += 5;
        } else if (sup_text_is_word(text->at, text->end, "loop")) {
            text->at += 4;
        } else if (sup_text_is_word(text->at, text->end, "endloop")) {
            text->at += 7;
        } else if (sup_text_is_word(text->at, text->end, "solid") ||
                   sup_text_is_word(text->at, text->end, "endsolid")) {
            if (in_facet) {
                wrong = "a facet has no endfacet";
                break;
            }
            in_solid = supi_lower(*text->at) == 's';
            sup_text_skip_line(text); /* the name may be any words */
        } else {
            wrong = "unknown word";
            break;
        }
    }
    if (wrong) failed = sup_fail(err, "%s: line %lu: %s", name, (unsigned long)sup_text_line(text, text->at), wrong);
    SUP_FREE(corners);
    return failed;
}

SUP_FN int supi_read_stl(sup_text *text, const char *name, sup_mesh *out, sup_error *err) {
    supi_weld weld;
    supi_faces faces;
    int failed;
    memset(&weld, 0, sizeof weld);
    memset(&faces, 0, sizeof faces);
    sup_text_skip_space(text);
    if (!supi_stl_is_binary(text->begin, (size_t)(text->end - text->begin)) &&
        sup_text_is_word(text->at, text->end, "solid")) {
        failed = supi_read_stl_text(text, name, &weld, &faces, err);
    } else {
        failed = supi_read_stl_binary(text, name, &weld, &faces, err);
    }
    if (failed) {
        supi_faces_free(&faces);
    } else {
        out->positions = weld.positions;
        out->vertex_count = weld.count;
        weld.positions = NULL;
        supi_faces_finish(&faces, out);
    }
    supi_weld_free(&weld);
    return failed;
}

#endif
