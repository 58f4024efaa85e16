/* mesh_obj.h - Wavefront OBJ reader with the materials of its MTL files; included by mesh.h
   SPDX-License-Identifier: MIT OR Unlicense */
#ifndef SUP_MESH_OBJ_H
#define SUP_MESH_OBJ_H

#ifndef SUP_MESH_H
#error "include mesh.h instead"
#endif

typedef struct supi_obj_corner {
    uint32_t vertex; /* from 0 */
    uint32_t normal; /* from 1; 0: none */
    uint32_t texcoord; /* from 1; 0: none */
} supi_obj_corner;

typedef struct supi_obj_face {
    const char *at; /* where it stands, for messages */
    size_t first, count;
    uint32_t material; /* from 1; 0: none */
} supi_obj_face;

typedef struct supi_obj_name { /* a piece of the text */
    const char *at;
    size_t length;
    uint64_t hash;
    uint8_t rgb[3], has_rgb, rich; /* rich: more than a colour */
    sup_material material;
} supi_obj_name;

typedef struct supi_obj {
    sup_text text;
    const char *name;
    sup_error *err;
    float *positions, *normals, *texcoords;
    uint8_t *rgb; /* 3 per vertex once a vertex has a colour */
    supi_obj_corner *corners;
    supi_obj_face *faces;
    supi_obj_name *materials, *libraries;
    size_t position_count, position_capacity, normal_count, normal_capacity, rgb_capacity;
    size_t texcoord_count, texcoord_capacity;
    size_t corner_count, corner_capacity, face_count, face_capacity;
    size_t material_count, material_capacity, library_count, library_capacity;
    size_t skipped;
    uint32_t material;
} supi_obj;

SUP_FN int supi_obj_fail(const supi_obj *obj, const char *at, const char *what) {
    return sup_fail(obj->err, "%s: line %lu: %s", obj->name, (unsigned long)sup_text_line(&obj->text, at), what);
}

SUP_FN int supi_obj_memory(const supi_obj *obj) { return sup_fail(obj->err, "%s: out of memory", obj->name); }

/* Past blanks and past a backslash that ends a line: the line goes on behind it. */
SUP_FN void supi_obj_blank(sup_text *text) {
    for (;;) {
        const char *p = text->at;
        while (p < text->end && supi_is_blank(*p)) p++;
        text->at = p;
        if (text->end - p < 2 || *p != '\\' || (p[1] != '\n' && p[1] != '\r')) return;
        p += p[1] == '\r' && text->end - p > 2 && p[2] == '\n' ? 3 : 2;
        text->at = p;
    }
}

SUP_FN int supi_obj_line_ends(const sup_text *text) {
    return text->at == text->end || *text->at == '\n' || *text->at == '\r' || *text->at == '#';
}

/* Past a line, with those that continue it. */
SUP_FN void supi_obj_skip_line(sup_text *text) {
    const int comment = text->at < text->end && *text->at == '#'; /* a comment may end in "C:\meshes\" */
    for (;;) {
        int more;
        const char *p = text->at;
        while (p < text->end && *p != '\n' && *p != '\r') p++;
        more = !comment && p > text->at && p[-1] == '\\';
        text->at = p;
        sup_text_skip_line(text);
        if (!more || text->at == text->end) return;
    }
}

/* The rest of the line without the blanks around it: names of materials and files may contain blanks. */
SUP_FN supi_obj_name supi_obj_rest(sup_text *text) {
    supi_obj_name name;
    const char *end;
    size_t i;
    memset(&name, 0, sizeof name);
    while (text->at < text->end && supi_is_blank(*text->at)) text->at++;
    name.at = text->at;
    for (end = text->at; end < text->end && *end != '\n' && *end != '\r'; end++) {}
    text->at = end;
    while (end > name.at && supi_is_blank(end[-1])) end--;
    name.length = (size_t)(end - name.at);
    name.hash = UINT64_C(0xcbf29ce484222325);
    for (i = 0; i < name.length; i++) name.hash = (name.hash ^ (uint8_t)name.at[i]) * UINT64_C(0x100000001b3);
    return name;
}

SUP_FN int supi_obj_same(const supi_obj_name *a, const supi_obj_name *b) {
    return a->hash == b->hash && a->length == b->length && memcmp(a->at, b->at, a->length) == 0;
}

SUP_FN int supi_obj_vertex(supi_obj *obj) {
    float value[8];
    size_t count = 0;
    void *grown;
    for (supi_obj_blank(&obj->text); !supi_obj_line_ends(&obj->text); supi_obj_blank(&obj->text)) {
        if (count == 8) break;
        if (sup_parse_float(&obj->text.at, obj->text.end, value + count))
            return supi_obj_fail(obj, obj->text.at, "a number was expected");
        count++;
    }
    if (count < 3) return supi_obj_fail(obj, obj->text.at, "a vertex needs three numbers");
    if (obj->position_count >= 0xfffffffeu)
        return sup_fail(obj->err, "%s: more vertices than 32-bit indices can name", obj->name);
    if (!obj->positions || 3 * obj->position_count + 3 > obj->position_capacity) {
        grown = sup_grow(obj->positions, &obj->position_capacity, 3 * obj->position_count + 3, sizeof(float));
        if (!grown) return supi_obj_memory(obj);
        obj->positions = (float *)grown;
    }
    memcpy(obj->positions + 3 * obj->position_count, value, 3 * sizeof(float));
    if (obj->rgb || count >= 6) { /* four numbers are x y z w; from six on there is a colour */
        const size_t before = obj->rgb ? 3 * obj->position_count : 0;
        uint8_t *rgb;
        grown = sup_grow(obj->rgb, &obj->rgb_capacity, 3 * obj->position_count + 3, 1);
        if (!grown) return supi_obj_memory(obj);
        obj->rgb = (uint8_t *)grown;
        memset(obj->rgb + before, 255, 3 * obj->position_count + 3 - before);
        rgb = obj->rgb + 3 * obj->position_count;
        if (count >= 6) {
            rgb[0] = sup_unit_to_byte((double)value[3]);
            rgb[1] = sup_unit_to_byte((double)value[4]);
            rgb[2] = sup_unit_to_byte((double)value[5]);
        }
    }
    obj->position_count++;
    return 0;
}

SUP_FN int supi_obj_normal(supi_obj *obj) {
    float value[3];
    size_t k;
    void *grown;
    for (k = 0; k < 3; k++) {
        supi_obj_blank(&obj->text);
        if (sup_parse_float(&obj->text.at, obj->text.end, value + k))
            return supi_obj_fail(obj, obj->text.at, "a normal needs three numbers");
    }
    grown = sup_grow(obj->normals, &obj->normal_capacity, 3 * obj->normal_count + 3, sizeof(float));
    if (!grown) return supi_obj_memory(obj);
    obj->normals = (float *)grown;
    memcpy(obj->normals + 3 * obj->normal_count, value, sizeof value);
    obj->normal_count++;
    return 0;
}

/* u v w: one number is enough. */
SUP_FN int supi_obj_texcoord(supi_obj *obj) {
    float value[2] = {0.0f, 0.0f};
    size_t k;
    void *grown;
    for (k = 0; k < 2; k++) {
        supi_obj_blank(&obj->text);
        if (k == 1 && supi_obj_line_ends(&obj->text)) break;
        if (sup_parse_float(&obj->text.at, obj->text.end, value + k))
            return supi_obj_fail(obj, obj->text.at, "texture coordinates need a number or more");
    }
    if (obj->texcoord_count >= 0xfffffffeu)
        return sup_fail(obj->err, "%s: more texture coordinates than 32-bit indices can name", obj->name);
    grown = sup_grow(obj->texcoords, &obj->texcoord_capacity, 2 * obj->texcoord_count + 2, sizeof(float));
    if (!grown) return supi_obj_memory(obj);
    obj->texcoords = (float *)grown;
    memcpy(obj->texcoords + 2 * obj->texcoord_count, value, sizeof value);
    obj->texcoord_count++;
    return 0;
}

/* An index of the file, from 1, or from the end when negative, as an index from 0. Upper bounds are checked when all
   vertices are known. */
SUP_FN int supi_obj_index(const supi_obj *obj, const char *at, int64_t index, size_t count, uint32_t *out) {
    const int64_t value = index < 0 ? (index < -(int64_t)count ? -1 : (int64_t)count + index) : index - 1;
    if (value < 0 || value > INT64_C(0xfffffffd)) {
        (void)sup_fail(obj->err, "%s: line %lu: face %lu: index %ld out of range", obj->name,
                       (unsigned long)sup_text_line(&obj->text, at), (unsigned long)(obj->face_count + obj->skipped),
                       (long)index);
        return 1;
    }
    *out = (uint32_t)value;
    return 0;
}

SUP_FN int supi_obj_is_index(const sup_text *text) {
    return text->at < text->end && (supi_is_digit(*text->at) || *text->at == '-' || *text->at == '+');
}

SUP_FN int supi_obj_add_face(supi_obj *obj, const char *line) {
    sup_text *text = &obj->text;
    const size_t first = obj->corner_count;
    supi_obj_face *face;
    void *grown;
    for (supi_obj_blank(text); !supi_obj_line_ends(text); supi_obj_blank(text)) {
        supi_obj_corner corner = {0, 0, 0};
        int64_t index = 0;
        int failed = sup_parse_int(&text->at, text->end, &index) ||
                     supi_obj_index(obj, line, index, obj->position_count, &corner.vertex);
        if (failed && index != 0) return 1; /* the message names the index */
        if (!failed && text->at < text->end && *text->at == '/') {
            text->at++;
            if (supi_obj_is_index(text)) {
                failed = sup_parse_int(&text->at, text->end, &index);
                if (index < 0) index += (int64_t)obj->texcoord_count + 1;
                if (!failed && index > 0 && index < INT64_C(0xffffffff)) corner.texcoord = (uint32_t)index; /* else none */
            }
            if (!failed && text->at < text->end && *text->at == '/') {
                text->at++;
                if (supi_obj_is_index(text)) {
                    failed = sup_parse_int(&text->at, text->end, &index);
                    if (!failed && supi_obj_index(obj, line, index, obj->normal_count, &corner.normal)) return 1;
                    corner.normal++;
                }
            }
        }
        if (failed || !(supi_obj_line_ends(text) || supi_is_blank(*text->at) || *text->at == '\\')) {
            return supi_obj_fail(obj, text->at, "a face corner must be v, v/vt, v//vn or v/vt/vn, from 1");
        }
        if (!obj->corners || obj->corner_count == obj->corner_capacity) {
            grown = sup_grow(obj->corners, &obj->corner_capacity, obj->corner_count + 1, sizeof corner);
            if (!grown) return supi_obj_memory(obj);
            obj->corners = (supi_obj_corner *)grown;
        }
        obj->corners[obj->corner_count++] = corner;
    }
    if (obj->corner_count - first < 3) {
        obj->corner_count = first;
        obj->skipped++;
        return 0;
    }
    grown = sup_grow(obj->faces, &obj->face_capacity, obj->face_count + 1, sizeof *obj->faces);
    if (!grown) return supi_obj_memory(obj);
    obj->faces = (supi_obj_face *)grown;
    face = obj->faces + obj->face_count++;
    face->at = line;
    face->first = first;
    face->count = obj->corner_count - first;
    face->material = obj->material;
    return 0;
}

/* A material of which nothing is known. */
SUP_FN void supi_mtl_begin(supi_obj_name *name) {
    sup_material *m = &name->material;
    SUP_FREE(m->color_map.name); /* defined before, in this file or in another one: the last one counts */
    SUP_FREE(m->bump_map.name);
    SUP_FREE(m->displace_map.name);
    memset(m, 0, sizeof *m);
    m->transmit[0] = m->transmit[1] = m->transmit[2] = m->ni = m->opacity = 1.0f;
    m->illum = -1;
    name->has_rgb = name->rich = 0;
}

SUP_FN int supi_obj_use_material(supi_obj *obj) {
    const supi_obj_name name = supi_obj_rest(&obj->text);
    size_t i = obj->material_count;
    void *grown;
    while (i > 0 && !supi_obj_same(&name, obj->materials + i - 1)) i--;
    if (i == 0) {
        grown = sup_grow(obj->materials, &obj->material_capacity, obj->material_count + 1, sizeof name);
        if (!grown) return supi_obj_memory(obj);
        obj->materials = (supi_obj_name *)grown;
        obj->materials[obj->material_count++] = name;
        i = obj->material_count;
        supi_mtl_begin(obj->materials + i - 1);
    }
    obj->material = (uint32_t)i;
    return 0;
}

SUP_FN int supi_obj_parse(supi_obj *obj) {
    sup_text *text = &obj->text;
    for (;;) {
        const char *line;
        int failed = 0;
        sup_text_skip_space(text);
        line = text->at;
        if (line == text->end) return 0;
        if (*line == 'v' && text->end - line > 1 && (supi_is_blank(line[1]) || line[1] == '\\')) {
            text->at += 1;
            failed = supi_obj_vertex(obj);
        } else if (*line == 'f' && text->end - line > 1 && (supi_is_blank(line[1]) || line[1] == '\\')) {
            text->at += 1;
            failed = supi_obj_add_face(obj, line);
        } else if (sup_text_is_word(line, text->end, "vn")) {
            text->at += 2;
            failed = supi_obj_normal(obj);
        } else if (sup_text_is_word(line, text->end, "vt")) {
            text->at += 2;
            failed = supi_obj_texcoord(obj);
        } else if (sup_text_is_word(line, text->end, "usemtl")) {
            text->at += 6;
            failed = supi_obj_use_material(obj);
        } else if (sup_text_is_word(line, text->end, "mtllib")) {
            void *grown = sup_grow(obj->libraries, &obj->library_capacity, obj->library_count + 1,
                                   sizeof *obj->libraries);
            text->at += 6;
            if (!grown) return supi_obj_memory(obj);
            obj->libraries = (supi_obj_name *)grown;
            obj->libraries[obj->library_count++] = supi_obj_rest(text);
        } else if ((uint8_t)*line < 32 || *line == 127) {
            failed = supi_obj_fail(obj, line, "not a text");
        }
        if (failed) return 1;
        supi_obj_skip_line(text);
    }
}

/* Three numbers, or one for all three, from 0 to 1e6; returns 1 for another form, and `out` is unchanged. */
SUP_FN int supi_mtl_color(sup_text *text, float out[3]) {
    double value[3];
    size_t k;
    for (k = 0; k < 3; k++) {
        supi_obj_blank(text);
        if (sup_parse_double(&text->at, text->end, value + k)) break;
    }
    if (k == 1) value[1] = value[2] = value[0];
    if (k != 1 && k != 3) return 1;
    for (k = 0; k < 3; k++) out[k] = value[k] > 0.0 ? (float)(value[k] < 1e6 ? value[k] : 1e6) : 0.0f;
    return 0;
}

/* A number within least and most; returns 1 when there is none, and `out` is unchanged. */
SUP_FN int supi_mtl_number(sup_text *text, double least, double most, float *out) {
    double value;
    supi_obj_blank(text);
    if (sup_parse_double(&text->at, text->end, &value)) return 1;
    *out = (float)(value > least ? value < most ? value : most : least); /* not a number: least */
    return 0;
}

/* 1 and past it when the next word is this. */
SUP_FN int supi_mtl_option(sup_text *text, const char *word) {
    supi_obj_blank(text);
    if (!sup_text_is_word(text->at, text->end, word)) return 0;
    text->at += strlen(word);
    return 1;
}

SUP_FN void supi_mtl_skip_word(sup_text *text) {
    supi_obj_blank(text);
    while (text->at < text->end && !supi_is_space(*text->at)) text->at++;
}

/* The options of a map, then its name: the rest of the line. Returns 1 when memory is short. */
SUP_FN int supi_mtl_map(sup_text *text, sup_map *map) {
    supi_obj_name name;
    float pair[3];
    size_t k;
    const int is_normal = map->is_normal;
    SUP_FREE(map->name);
    memset(map, 0, sizeof *map);
    map->is_normal = is_normal;
    map->scale[0] = map->scale[1] = map->strength = 1.0f;
    for (;;) {
        const int scale = supi_mtl_option(text, "-s"), offset = !scale && supi_mtl_option(text, "-o");
        if (scale || offset || supi_mtl_option(text, "-t")) {
            for (k = 0; k < 3 && !supi_mtl_number(text, -1e6, 1e6, pair + k); k++) {}
            for (; k < 2; k++) pair[k] = scale ? 1.0f : 0.0f;
            if (scale) memcpy(map->scale, pair, sizeof map->scale);
            if (offset) memcpy(map->offset, pair, sizeof map->offset);
        } else if (supi_mtl_option(text, "-bm")) {
            (void)supi_mtl_number(text, -1e6, 1e6, &map->strength);
        } else if (supi_mtl_option(text, "-mm")) {
            float gain = 1.0f;
            (void)supi_mtl_number(text, -1e6, 1e6, &map->base);
            (void)supi_mtl_number(text, -1e6, 1e6, &gain);
            map->strength *= gain;
        } else if (supi_mtl_option(text, "-clamp")) {
            map->clamp = supi_mtl_option(text, "on");
            if (!map->clamp) supi_mtl_skip_word(text);
        } else if (supi_mtl_option(text, "-blendu") || supi_mtl_option(text, "-blendv") || supi_mtl_option(text, "-cc") ||
                   supi_mtl_option(text, "-imfchan") || supi_mtl_option(text, "-texres") || supi_mtl_option(text, "-boost") ||
                   supi_mtl_option(text, "-type")) {
            supi_mtl_skip_word(text);
        } else {
            break;
        }
    }
    name = supi_obj_rest(text);
    if (name.length == 0 || name.length > 4096) return 0;
    map->name = (char *)sup_alloc(name.length + 1, 1);
    if (!map->name) return 1;
    memcpy(map->name, name.at, name.length);
    map->name[name.length] = '\0';
    return 0;
}

/* One statement of a material; what has another form than expected is passed over. Returns 1 when memory is short. */
SUP_FN int supi_mtl_statement(supi_obj_name *name, sup_text *text) {
    sup_material *m = &name->material;
    float value[3];
    size_t k;
    int failed = 0;
    if (supi_mtl_option(text, "kd")) {
        if (supi_mtl_color(text, value)) return 0;
        for (k = 0; k < 3; k++) name->rgb[k] = sup_unit_to_byte((double)value[k]);
        name->has_rgb = 1;
    } else if (supi_mtl_option(text, "ks")) {
        if (!supi_mtl_color(text, m->specular)) name->rich |= m->specular[0] > 0.0f || m->specular[1] > 0.0f || m->specular[2] > 0.0f;
    } else if (supi_mtl_option(text, "ke")) {
        if (!supi_mtl_color(text, m->emission)) name->rich |= m->emission[0] > 0.0f || m->emission[1] > 0.0f || m->emission[2] > 0.0f;
    } else if (supi_mtl_option(text, "tf")) {
        m->has_transmit |= !supi_mtl_color(text, m->transmit);
        for (k = 0; k < 3; k++) m->transmit[k] = m->transmit[k] < 1.0f ? m->transmit[k] : 1.0f;
        if (m->has_transmit) name->rich = 1;
    } else if (supi_mtl_option(text, "ns")) {
        (void)supi_mtl_number(text, 0.0, 1e6, &m->shininess);
    } else if (supi_mtl_option(text, "ni")) {
        (void)supi_mtl_number(text, 0.0, 16.0, &m->ni);
    } else if (supi_mtl_option(text, "d")) {
        (void)supi_mtl_option(text, "-halo");
        if (!supi_mtl_number(text, 0.0, 1.0, &m->opacity)) m->has_opacity = 1;
        name->rich |= m->opacity < 1.0f;
    } else if (supi_mtl_option(text, "tr")) {
        if (!supi_mtl_number(text, 0.0, 1.0, value)) {
            m->opacity = 1.0f - value[0];
            m->has_opacity = 1;
        }
        name->rich |= m->opacity < 1.0f;
    } else if (supi_mtl_option(text, "illum")) {
        if (!supi_mtl_number(text, 0.0, 10.0, value)) m->illum = (int)value[0];
    } else if (supi_mtl_option(text, "map_kd")) {
        failed = supi_mtl_map(text, &m->color_map);
        name->rich |= m->color_map.name != NULL;
    } else if (supi_mtl_option(text, "map_bump") || supi_mtl_option(text, "bump")) {
        m->bump_map.is_normal = 0;
        failed = supi_mtl_map(text, &m->bump_map);
        name->rich |= m->bump_map.name != NULL;
    } else if (supi_mtl_option(text, "norm") || supi_mtl_option(text, "map_kn")) {
        m->bump_map.is_normal = 1;
        failed = supi_mtl_map(text, &m->bump_map);
        name->rich |= m->bump_map.name != NULL;
    } else if (supi_mtl_option(text, "disp") || supi_mtl_option(text, "map_disp")) {
        failed = supi_mtl_map(text, &m->displace_map);
        name->rich |= m->displace_map.name != NULL;
    }
    return failed;
}

/* Materials that faces use. Returns 1 when memory is short. */
SUP_FN int supi_obj_parse_materials(supi_obj *obj, const char *data, size_t size) {
    supi_obj_name *material = NULL;
    sup_text text;
    text.begin = text.at = data;
    text.end = data + size;
    for (sup_text_skip_space(&text); text.at < text.end; supi_obj_skip_line(&text), sup_text_skip_space(&text)) {
        if (sup_text_is_word(text.at, text.end, "newmtl")) {
            supi_obj_name name;
            size_t i;
            text.at += 6;
            name = supi_obj_rest(&text);
            material = NULL;
            for (i = 0; i < obj->material_count; i++) {
                if (supi_obj_same(&name, obj->materials + i)) material = obj->materials + i;
            }
            if (material) supi_mtl_begin(material);
        } else if (material && supi_mtl_statement(material, &text)) {
            return 1;
        }
    }
    return 0;
}

/* Open one MTL file by a name that is a piece of the text. Returns 1 when it is missing. */
SUP_FN int supi_obj_open(supi_obj *obj, const char *at, size_t length, sup_open_fn open_fn, void *user) {
    char *name = (char *)sup_alloc(length + 1, 1), *data = NULL;
    size_t size = 0;
    int failed;
    if (!name) return 1;
    memcpy(name, at, length);
    name[length] = '\0';
    failed = open_fn(user, name, &data, &size);
    if (!failed) failed = supi_obj_parse_materials(obj, data, size);
    SUP_FREE(data);
    SUP_FREE(name);
    return failed;
}

SUP_FN void supi_obj_load_materials(supi_obj *obj, sup_open_fn open_fn, void *user) {
    size_t i;
    for (i = 0; open_fn && obj->material_count && i < obj->library_count && i < 64; i++) {
        const supi_obj_name *library = obj->libraries + i;
        const char *at = library->at, *end = library->at + library->length;
        if (library->length == 0 || !supi_obj_open(obj, at, library->length, open_fn, user)) continue;
        while (at < end) { /* not one name with blanks in it, so perhaps several names */
            const char *word = at;
            while (at < end && !supi_is_blank(*at)) at++;
            if ((word == library->at && at == end) || supi_obj_open(obj, word, (size_t)(at - word), open_fn, user)) {
                (void)sup_fail(obj->err, "%s: materials %.*s cannot be read: colours are left out", obj->name,
                               (int)(at - word < 128 ? at - word : 128), word);
            }
            while (at < end && supi_is_blank(*at)) at++;
        }
    }
}

/* Vertices of the file become vertices of the mesh. With normals there is one for each pair of position and normal that
   occurs; `corners[].vertex` is changed to it, and *missing counts those without a normal, whose normals stay 0. */
SUP_FN int supi_obj_split(supi_obj *obj, sup_mesh *out, size_t *missing) {
    supi_map map;
    size_t i, capacity[3] = {0, 0, 0};
    int failed = 0;
    memset(&map, 0, sizeof map);
    for (i = 0; i < obj->corner_count && !failed; i++) {
        supi_obj_corner *corner = obj->corners + i;
        uint32_t *slot = supi_map_at(&map, ((uint64_t)corner->vertex << 32) | corner->normal);
        if (!slot) {
            failed = 1;
        } else if (*slot == SUPI_MAP_EMPTY) {
            const size_t n = out->vertex_count;
            void *p = sup_grow(out->positions, capacity, 3 * n + 3, sizeof(float));
            void *q = sup_grow(out->normals, capacity + 1, 3 * n + 3, sizeof(float));
            void *c = obj->rgb ? sup_grow(out->vertex_rgb, capacity + 2, 3 * n + 3, 1) : NULL;
            if (p) out->positions = (float *)p;
            if (q) out->normals = (float *)q;
            if (c) out->vertex_rgb = (uint8_t *)c;
            if (!p || !q || (obj->rgb && !c) || n >= 0xfffffffeu) {
                failed = 1;
                break;
            }
            memcpy(out->positions + 3 * n, obj->positions + 3 * (size_t)corner->vertex, 3 * sizeof(float));
            if (obj->rgb) memcpy(out->vertex_rgb + 3 * n, obj->rgb + 3 * (size_t)corner->vertex, 3);
            if (corner->normal) {
                memcpy(out->normals + 3 * n, obj->normals + 3 * (size_t)(corner->normal - 1), 3 * sizeof(float));
            } else {
                memset(out->normals + 3 * n, 0, 3 * sizeof(float));
                ++*missing;
            }
            *slot = (uint32_t)n;
            out->vertex_count++;
        }
        if (!failed) corner->vertex = *slot;
    }
    supi_map_free(&map);
    return failed ? supi_obj_memory(obj) : 0;
}

/* Corners without a normal in a mesh with normals: give them what the triangles around them say. */
SUP_FN int supi_obj_fill_normals(supi_obj *obj, sup_mesh *out) {
    sup_mesh copy = *out;
    size_t i;
    copy.normals = NULL;
    /* no creases: nothing is split, the copy shares its other arrays. NULL: a warning must stay */
    if (supi_compute_normals(&copy, -2.0, NULL)) return supi_obj_memory(obj);
    for (i = 0; i < obj->corner_count; i++) {
        if (obj->corners[i].normal == 0) {
            const size_t at = 3 * (size_t)obj->corners[i].vertex;
            memcpy(out->normals + at, copy.normals + at, 3 * sizeof(float));
        }
    }
    SUP_FREE(copy.normals);
    return 0;
}

/* Hand the materials over to the mesh, if any of them is more than a colour. pictures: one has a picture. */
SUP_FN int supi_obj_keep_materials(supi_obj *obj, sup_mesh *out, int *rich, int *pictures) {
    size_t i;
    for (i = 0; i < obj->material_count; i++) {
        const sup_material *m = &obj->materials[i].material;
        *rich |= obj->materials[i].rich;
        *pictures |= m->color_map.name || m->bump_map.name || m->displace_map.name;
    }
    if (!*rich) return 0;
    out->materials = (sup_material *)sup_alloc(obj->material_count, sizeof *out->materials);
    if (!out->materials) return 1;
    for (i = 0; i < obj->material_count; i++) {
        out->materials[i] = obj->materials[i].material;
        memset(&obj->materials[i].material, 0, sizeof obj->materials[i].material); /* its names are the mesh's now */
    }
    out->material_count = obj->material_count;
    return 0;
}

/* Material and texture coordinates of the triangles of a face. */
SUP_FN int supi_obj_dress(const supi_obj *obj, const supi_obj_face *face, const supi_faces *faces, size_t first,
                          size_t capacity[2], sup_mesh *out, int pictures) {
    size_t t, k;
    void *grown = sup_grow(out->triangle_material, capacity, faces->count, sizeof *out->triangle_material);
    if (!grown) return 1;
    out->triangle_material = (uint32_t *)grown;
    if (pictures) {
        if (faces->count > SIZE_MAX / 6) return 1;
        grown = sup_grow(out->texcoords, capacity + 1, 6 * faces->count, sizeof *out->texcoords);
        if (!grown) return 1;
        out->texcoords = (float *)grown;
    }
    for (t = first; t < faces->count; t++) {
        out->triangle_material[t] = face->material;
        for (k = 0; pictures && k < 3; k++) {
            const uint32_t vt = obj->corners[face->first + faces->place[3 * t + k]].texcoord;
            float *to = out->texcoords + 6 * t + 2 * k;
            to[0] = vt ? obj->texcoords[2 * (size_t)(vt - 1)] : 0.0f;
            to[1] = vt ? obj->texcoords[2 * (size_t)(vt - 1) + 1] : 0.0f;
        }
    }
    return 0;
}

SUP_FN int supi_obj_build(supi_obj *obj, sup_mesh *out, supi_faces *faces, uint32_t **polygon) {
    size_t f, k, capacity = 0, missing = 0, capacities[2] = {0, 0};
    int normals = 0, colours = 0, rich = 0, pictures = 0;
    for (f = 0; f < obj->face_count; f++) {
        const supi_obj_face *face = obj->faces + f;
        for (k = face->first; k < face->first + face->count; k++) {
            const supi_obj_corner corner = obj->corners[k];
            const int bad = corner.vertex >= obj->position_count;
            if (corner.texcoord > obj->texcoord_count) obj->corners[k].texcoord = 0; /* as if it were not there */
            if (bad || corner.normal > obj->normal_count) {
                return sup_fail(obj->err, "%s: line %lu: face %lu: %s %lu out of range, there are %lu", obj->name,
                                (unsigned long)sup_text_line(&obj->text, face->at), (unsigned long)f,
                                bad ? "index" : "index of a normal",
                                bad ? (unsigned long)corner.vertex + 1 : (unsigned long)corner.normal,
                                (unsigned long)(bad ? obj->position_count : obj->normal_count));
            }
            normals |= corner.normal != 0;
        }
    }
    if (normals) {
        if (supi_obj_split(obj, out, &missing)) return 1;
    } else {
        out->positions = obj->positions;
        out->vertex_rgb = obj->rgb;
        out->vertex_count = obj->position_count;
        obj->positions = NULL;
        obj->rgb = NULL;
    }
    for (k = 0; k < obj->material_count; k++) colours |= obj->materials[k].has_rgb;
    if (supi_obj_keep_materials(obj, out, &rich, &pictures)) return supi_obj_memory(obj);
    faces->keep_places = pictures;
    for (f = 0; f < obj->face_count; f++) {
        const supi_obj_face *face = obj->faces + f;
        const size_t before = faces->count;
        void *grown = sup_grow(*polygon, &capacity, face->count, sizeof **polygon);
        if (!grown) return supi_obj_memory(obj);
        *polygon = (uint32_t *)grown;
        for (k = 0; k < face->count; k++) (*polygon)[k] = obj->corners[face->first + k].vertex;
        if (supi_add_polygon(faces, out->positions, *polygon, face->count)) return supi_obj_memory(obj);
        if (colours && face->material && obj->materials[face->material - 1].has_rgb &&
            supi_paint(faces, before, obj->materials[face->material - 1].rgb))
            return supi_obj_memory(obj);
        if (rich && supi_obj_dress(obj, face, faces, before, capacities, out, pictures)) return supi_obj_memory(obj);
    }
    faces->skipped = obj->skipped;
    supi_faces_finish(faces, out);
    return missing ? supi_obj_fill_normals(obj, out) : 0;
}

SUP_FN int supi_read_obj(const sup_text *text, const char *name, sup_open_fn open_fn, void *open_user, sup_mesh *out,
                         sup_error *err) {
    supi_obj obj;
    supi_faces faces;
    uint32_t *polygon = NULL;
    size_t i;
    int failed;
    memset(&obj, 0, sizeof obj);
    memset(&faces, 0, sizeof faces);
    obj.text = *text;
    obj.name = name;
    obj.err = err;
    failed = supi_obj_parse(&obj);
    if (!failed && obj.position_count == 0) failed = sup_fail(err, "%s: the file has no vertices", name);
    if (!failed) supi_obj_load_materials(&obj, open_fn, open_user);
    if (!failed) failed = supi_obj_build(&obj, out, &faces, &polygon);
    supi_faces_free(&faces);
    SUP_FREE(polygon);
    SUP_FREE(obj.positions);
    SUP_FREE(obj.normals);
    SUP_FREE(obj.texcoords);
    SUP_FREE(obj.rgb);
    SUP_FREE(obj.corners);
    SUP_FREE(obj.faces);
    for (i = 0; i < obj.material_count; i++) {
        SUP_FREE(obj.materials[i].material.color_map.name);
        SUP_FREE(obj.materials[i].material.bump_map.name);
        SUP_FREE(obj.materials[i].material.displace_map.name);
    }
    SUP_FREE(obj.materials);
    SUP_FREE(obj.libraries);
    return failed;
}

#endif
