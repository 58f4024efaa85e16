/* gi_scene.h - scenes for global illumination as text, read and written: cameras, lights, objects, paths, sequences
   SPDX-License-Identifier: MIT OR Unlicense

   A line is a word and its fields; docs/formats.md has the list. Everything that moves is a function of the time in
   seconds: sup_gi_matrix, sup_gi_place. */
#ifndef SUP_GI_SCENE_H
#define SUP_GI_SCENE_H

#include "base.h"
#include "mesh.h"
#include "text.h"

enum { SUP_GI_NAME = 48, SUP_GI_WORDS = 96 };

typedef struct sup_gi_knot { double t, at[3], tangent[3]; int has_tangent; } sup_gi_knot;
typedef struct sup_gi_path { char name[SUP_GI_NAME]; size_t first, count; int loop; } sup_gi_path;
typedef struct sup_gi_material { char name[SUP_GI_NAME]; double albedo[3], specular[3], exponent, emission[3]; } sup_gi_material;
typedef struct sup_gi_camera {
    char name[SUP_GI_NAME];
    double eye[3], at[3], up[3], fov;
    int path, at_path; /* -1: none */
} sup_gi_camera;
typedef struct sup_gi_lamp {
    int kind; /* 0 point, 1 spot, 2 directional, 3 area */
    double position[3], direction[3], angle, u[3], v[3], color[3];
    int path;
} sup_gi_lamp;
typedef struct sup_gi_thing {
    char *file;                    /* or "scene:NAME", "scene:NAME:DETAIL"; owned */
    double position[3], turn[3], spin[3], scale, color[3], frames[3], spacing;
    int moving, has_color, has_frames, material, path;
    int outwards; /* triangles that face inwards are turned */
    int voxels; /* index of sup_gi_voxels + 1; 0: not said */
} sup_gi_thing;

static const char *const sup_gi_voxels[6] = {"thin", "fat", "raster", "solid", "samples", "body"};

typedef struct sup_gi_scene {
    sup_gi_knot *knots;
    sup_gi_path *paths;
    sup_gi_material *materials;
    sup_gi_camera *cameras;
    sup_gi_lamp *lamps;
    sup_gi_thing *things;
    size_t knot_count, path_count, material_count, camera_count, lamp_count, thing_count;
    size_t knot_room, path_room, material_room, camera_room, lamp_room, thing_room;
    double seconds, white, box[6];
    int has_box;
} sup_gi_scene;

SUP_FN void sup_gi_scene_free(sup_gi_scene *s) {
    size_t i;
    for (i = 0; i < s->thing_count; i++) SUP_FREE(s->things[i].file);
    SUP_FREE(s->knots);
    SUP_FREE(s->paths);
    SUP_FREE(s->materials);
    SUP_FREE(s->cameras);
    SUP_FREE(s->lamps);
    SUP_FREE(s->things);
    memset(s, 0, sizeof *s);
}

/* ---- one line ------------------------------------------------------------------------------------------------- */

typedef struct supi_gi_line {
    const char *word[SUP_GI_WORDS];
    size_t length[SUP_GI_WORDS], count, at;
    const char *name; /* of the file */
    size_t line;
    sup_error *err;
} supi_gi_line;

SUP_FN int supi_gi_fail(const supi_gi_line *l, const char *what, size_t word) {
    const size_t k = word < SUP_GI_WORDS && word < l->count ? word : 0;
    const char *text = k == word && l->count ? l->word[k] : "";
    const int n = k == word && l->count ? (int)(l->length[k] < 60 ? l->length[k] : 60) : 0;
    return sup_fail(l->err, "%s: line %zu: %s%s%.*s%s", l->name, l->line, what, n ? " \"" : "", n, text, n ? "\"" : "");
}

/* Cut the line at text->at into words; a word may stand in double quotes. '#' begins a comment. */
SUP_FN int supi_gi_cut(sup_text *text, supi_gi_line *l) {
    l->count = l->at = 0;
    l->line = sup_text_line(text, text->at);
    for (;;) {
        const char *from;
        int quoted;
        while (text->at < text->end && supi_is_blank(*text->at)) text->at++;
        if (text->at >= text->end || *text->at == '\n' || *text->at == '\r' || *text->at == '#') break;
        quoted = *text->at == '"';
        if (quoted) text->at++;
        from = text->at;
        while (text->at < text->end && *text->at != '\n' && *text->at != '\r' && (quoted ? *text->at != '"' : !supi_is_blank(*text->at)))
            text->at++;
        if (l->count == SUP_GI_WORDS) return supi_gi_fail(l, "more words than a line can have", SUP_GI_WORDS);
        l->word[l->count] = from;
        l->length[l->count++] = (size_t)(text->at - from);
        if (memchr(from, 0, (size_t)(text->at - from)) != NULL) return supi_gi_fail(l, "a byte that is 0 in a word", SUP_GI_WORDS);
        if (quoted && (text->at >= text->end || *text->at != '"')) return supi_gi_fail(l, "a quote is not closed:", l->count - 1);
        if (quoted) text->at++;
    }
    sup_text_skip_line(text);
    return 0;
}

SUP_FN int supi_gi_is(const supi_gi_line *l, size_t i, const char *word) {
    return i < l->count && strlen(word) == l->length[i] && memcmp(word, l->word[i], l->length[i]) == 0;
}

/* If the next word is `key`: it and the `n` numbers behind it into out. Returns 1 taken, 0 another word, -1 failed. */
SUP_FN int supi_gi_numbers(supi_gi_line *l, const char *key, double *out, int n) {
    int k;
    if (!supi_gi_is(l, l->at, key)) return 0;
    for (k = 0; k < n; k++) {
        const size_t i = l->at + 1 + (size_t)k;
        const char *p = i < l->count ? l->word[i] : NULL, *end = p ? p + l->length[i] : NULL;
        if (!p || sup_parse_double(&p, end, out + k) || p != end || !(fabs(out[k]) <= 1e30))
            return -supi_gi_fail(l, i < l->count ? "not a number:" : "numbers are missing behind", i < l->count ? i : l->at);
    }
    l->at += 1 + (size_t)n;
    return 1;
}

SUP_FN int supi_gi_name(supi_gi_line *l, char name[SUP_GI_NAME]) {
    if (l->at >= l->count || l->length[l->at] >= SUP_GI_NAME) return supi_gi_fail(l, "a name of at most 47 characters is missing", SUP_GI_WORDS);
    memcpy(name, l->word[l->at], l->length[l->at]);
    name[l->length[l->at++]] = 0;
    return 0;
}

/* `key NAME` of something with names at `names`, `stride` bytes apart, made earlier in the file. */
SUP_FN int supi_gi_reference(supi_gi_line *l, const char *key, const void *names, size_t stride, size_t count, int *out) {
    char name[SUP_GI_NAME];
    size_t i;
    if (!supi_gi_is(l, l->at, key)) return 0;
    l->at++;
    if (supi_gi_name(l, name)) return -1;
    for (i = 0; i < count && strcmp((const char *)names + i * stride, name) != 0; i++) { }
    if (i == count) return -supi_gi_fail(l, "is not in a line above:", l->at - 1);
    *out = (int)i;
    return 1;
}

SUP_FN int supi_gi_flag(supi_gi_line *l, const char *key, int *out) {
    if (!supi_gi_is(l, l->at, key)) return 0;
    l->at++;
    *out = 1;
    return 1;
}

/* Room for one more: returns it, zeroed, or NULL. */
SUP_FN void *supi_gi_more(void *array, size_t *count, size_t *room, size_t size) { /* array: address of a pointer */
    void *p;
    memcpy(&p, array, sizeof p);
    p = sup_grow(p, room, *count + 1, size);
    if (!p) return NULL;
    memcpy(array, &p, sizeof p);
    p = (char *)p + *count * size;
    memset(p, 0, size);
    ++*count;
    return p;
}

/* ---- the lines ------------------------------------------------------------------------------------------------ */

SUP_FN int supi_gi_camera_line(sup_gi_scene *s, supi_gi_line *l) {
    sup_gi_camera *c = (sup_gi_camera *)supi_gi_more(&s->cameras, &s->camera_count, &s->camera_room, sizeof *c);
    if (!c) return supi_gi_fail(l, "out of memory", SUP_GI_WORDS);
    c->up[1] = 1.0;
    c->fov = 40.0;
    c->path = c->at_path = -1;
    if (supi_gi_name(l, c->name)) return 1;
    while (l->at < l->count) {
        int r = supi_gi_numbers(l, "eye", c->eye, 3);
        if (!r) r = supi_gi_numbers(l, "at", c->at, 3);
        if (!r) r = supi_gi_numbers(l, "up", c->up, 3);
        if (!r) r = supi_gi_numbers(l, "fov", &c->fov, 1);
        if (!r) r = supi_gi_reference(l, "path", s->paths, sizeof *s->paths, s->path_count, &c->path);
        if (!r) r = supi_gi_reference(l, "at_path", s->paths, sizeof *s->paths, s->path_count, &c->at_path);
        if (r <= 0) return r < 0 ? 1 : supi_gi_fail(l, "no field of a camera:", l->at);
    }
    if (!(c->fov > 0.0 && c->fov < 180.0)) return supi_gi_fail(l, "fov is not within 0 and 180", SUP_GI_WORDS);
    return 0;
}

SUP_FN int supi_gi_material_line(sup_gi_scene *s, supi_gi_line *l) {
    sup_gi_material *m = (sup_gi_material *)supi_gi_more(&s->materials, &s->material_count, &s->material_room, sizeof *m);
    int k;
    if (!m) return supi_gi_fail(l, "out of memory", SUP_GI_WORDS);
    m->albedo[0] = m->albedo[1] = m->albedo[2] = 1.0;
    if (supi_gi_name(l, m->name)) return 1;
    while (l->at < l->count) {
        int r = supi_gi_numbers(l, "albedo", m->albedo, 3);
        if (!r) r = supi_gi_numbers(l, "specular", m->specular, 3);
        if (!r) r = supi_gi_numbers(l, "exponent", &m->exponent, 1);
        if (!r) r = supi_gi_numbers(l, "emission", m->emission, 3);
        if (r <= 0) return r < 0 ? 1 : supi_gi_fail(l, "no field of a material:", l->at);
    }
    for (k = 0; k < 3; k++)
        if (!(m->albedo[k] >= 0.0 && m->albedo[k] <= 1.0 && m->specular[k] >= 0.0 && m->specular[k] <= 1.0 && m->emission[k] >= 0.0))
            return supi_gi_fail(l, "albedo and specular go from 0 to 1, emission from 0", SUP_GI_WORDS);
    if (!(m->exponent >= 0.0 && m->exponent <= 1e6)) return supi_gi_fail(l, "exponent is not within 0 and 1e6", SUP_GI_WORDS);
    return 0;
}

SUP_FN int supi_gi_lamp_line(sup_gi_scene *s, supi_gi_line *l) {
    static const char *const kinds[4] = {"point", "spot", "directional", "area"};
    sup_gi_lamp *m = (sup_gi_lamp *)supi_gi_more(&s->lamps, &s->lamp_count, &s->lamp_room, sizeof *m);
    if (!m) return supi_gi_fail(l, "out of memory", SUP_GI_WORDS);
    m->angle = 45.0;
    m->direction[1] = -1.0;
    m->color[0] = m->color[1] = m->color[2] = 1.0;
    m->path = -1;
    while (m->kind < 4 && !supi_gi_is(l, l->at, kinds[m->kind])) m->kind++;
    if (m->kind == 4) return supi_gi_fail(l, "no kind of light:", l->at);
    l->at++;
    while (l->at < l->count) {
        int r = supi_gi_numbers(l, "position", m->position, 3);
        if (!r) r = supi_gi_numbers(l, "direction", m->direction, 3);
        if (!r) r = supi_gi_numbers(l, "angle", &m->angle, 1);
        if (!r) r = supi_gi_numbers(l, "u", m->u, 3);
        if (!r) r = supi_gi_numbers(l, "v", m->v, 3);
        if (!r) r = supi_gi_numbers(l, "color", m->color, 3);
        if (!r) r = supi_gi_reference(l, "path", s->paths, sizeof *s->paths, s->path_count, &m->path);
        if (r <= 0) return r < 0 ? 1 : supi_gi_fail(l, "no field of a light:", l->at);
    }
    return 0;
}

SUP_FN int supi_gi_thing_line(sup_gi_scene *s, supi_gi_line *l) {
    sup_gi_thing *o = (sup_gi_thing *)supi_gi_more(&s->things, &s->thing_count, &s->thing_room, sizeof *o);
    if (!o) return supi_gi_fail(l, "out of memory", SUP_GI_WORDS);
    o->scale = 1.0;
    o->material = o->path = -1;
    if (l->at >= l->count || l->length[l->at] == 0) return supi_gi_fail(l, "a file or scene:NAME is missing", SUP_GI_WORDS);
    o->file = (char *)sup_alloc(l->length[l->at] + 1, 1);
    if (!o->file) return supi_gi_fail(l, "out of memory", SUP_GI_WORDS);
    memcpy(o->file, l->word[l->at], l->length[l->at]);
    o->file[l->length[l->at++]] = 0;
    while (l->at < l->count) {
        int r = supi_gi_numbers(l, "position", o->position, 3);
        if (!r) r = supi_gi_numbers(l, "turn", o->turn, 3);
        if (!r) r = supi_gi_numbers(l, "spin", o->spin, 3);
        if (!r) r = supi_gi_numbers(l, "scale", &o->scale, 1);
        if (!r && (r = supi_gi_numbers(l, "color", o->color, 3)) == 1) o->has_color = 1;
        if (!r && (r = supi_gi_numbers(l, "frames", o->frames, 3)) == 1) o->has_frames = o->moving = 1;
        if (!r) r = supi_gi_flag(l, "moving", &o->moving);
        if (!r) r = supi_gi_flag(l, "outwards", &o->outwards);
        if (!r) r = supi_gi_numbers(l, "spacing", &o->spacing, 1);
        if (!r && supi_gi_is(l, l->at, "voxels")) {
            for (o->voxels = 1; o->voxels < 7 && !supi_gi_is(l, l->at + 1, sup_gi_voxels[o->voxels - 1]); o->voxels++) { }
            if (o->voxels == 7) return supi_gi_fail(l, "voxels: thin, fat, raster, solid, samples or body, not", l->at + 1);
            l->at += 2;
            r = 1;
        }
        if (!r) r = supi_gi_reference(l, "material", s->materials, sizeof *s->materials, s->material_count, &o->material);
        if (!r) r = supi_gi_reference(l, "path", s->paths, sizeof *s->paths, s->path_count, &o->path);
        if (r <= 0) return r < 0 ? 1 : supi_gi_fail(l, "no field of an object:", l->at);
    }
    if (o->path >= 0 || o->spin[0] != 0.0 || o->spin[1] != 0.0 || o->spin[2] != 0.0) o->moving = 1;
    if (!(o->scale > 0.0)) return supi_gi_fail(l, "scale is not above 0", SUP_GI_WORDS);
    if (o->spacing != 0.0 && !(o->spacing >= 0.015625 && o->spacing <= 64.0)) return supi_gi_fail(l, "spacing is not from 1/64 to 64", SUP_GI_WORDS);
    if (o->has_frames && !(o->frames[0] >= 0.0 && o->frames[1] >= o->frames[0] && o->frames[1] < 1e6 && o->frames[2] > 0.0 &&
                           floor(o->frames[0]) == o->frames[0] && floor(o->frames[1]) == o->frames[1]))
        return supi_gi_fail(l, "frames: first, last (not before it; whole numbers) and how many a second", SUP_GI_WORDS);
    return 0;
}

SUP_FN int supi_gi_path_line(sup_gi_scene *s, supi_gi_line *l) {
    sup_gi_path *p = (sup_gi_path *)supi_gi_more(&s->paths, &s->path_count, &s->path_room, sizeof *p);
    if (!p) return supi_gi_fail(l, "out of memory", SUP_GI_WORDS);
    p->first = s->knot_count;
    if (supi_gi_name(l, p->name)) return 1;
    if (l->at < l->count && !supi_gi_flag(l, "loop", &p->loop)) return supi_gi_fail(l, "no field of a path:", l->at);
    return 0;
}

SUP_FN int supi_gi_knot_line(sup_gi_scene *s, supi_gi_line *l) {
    sup_gi_path *p = s->path_count ? &s->paths[s->path_count - 1] : NULL;
    sup_gi_knot *k;
    double v[4];
    if (!p || p->first + p->count != s->knot_count) return supi_gi_fail(l, "a knot without a path above it", SUP_GI_WORDS);
    k = (sup_gi_knot *)supi_gi_more(&s->knots, &s->knot_count, &s->knot_room, sizeof *k);
    if (!k) return supi_gi_fail(l, "out of memory", SUP_GI_WORDS);
    l->at = 0;
    if (supi_gi_numbers(l, "knot", v, 4) < 0) return 1;
    k->t = v[0];
    memcpy(k->at, v + 1, sizeof k->at);
    if (l->at < l->count) {
        const int r = supi_gi_numbers(l, "tangent", k->tangent, 3);
        if (r <= 0) return r < 0 ? 1 : supi_gi_fail(l, "no field of a knot:", l->at);
        k->has_tangent = 1;
    }
    /* tangents are differences of places over those of times: both stay numbers */
    if (p->count && !(k->t - s->knots[p->first + p->count - 1].t >= 1e-6))
        return supi_gi_fail(l, "times of knots ascend by a microsecond at least", SUP_GI_WORDS);
    p->count++;
    return 0;
}

SUP_FN int supi_gi_plain_line(sup_gi_scene *s, supi_gi_line *l) {
    double v[6];
    int r;
    l->at = 0;
    if ((r = supi_gi_numbers(l, "seconds", v, 1)) == 1) {
        s->seconds = v[0];
        return s->seconds > 0.0 ? 0 : supi_gi_fail(l, "seconds is not above 0", SUP_GI_WORDS);
    }
    if (!r && (r = supi_gi_numbers(l, "white", v, 1)) == 1) {
        s->white = v[0];
        return s->white > 0.0 ? 0 : supi_gi_fail(l, "white is not above 0", SUP_GI_WORDS);
    }
    if (!r && (r = supi_gi_numbers(l, "box", v, 6)) == 1) {
        memcpy(s->box, v, sizeof s->box);
        s->has_box = 1;
        return v[3] > v[0] && v[4] > v[1] && v[5] > v[2] ? 0 : supi_gi_fail(l, "box: its least corner, then its greatest", SUP_GI_WORDS);
    }
    return r < 0 ? 1 : supi_gi_fail(l, "no line begins with", 0);
}

/* Read a scene of `size` bytes. Returns 0; or 1 with err, and `out` is empty. */
SUP_FN int sup_gi_scene_parse(const char *data, size_t size, const char *name, sup_gi_scene *out, sup_error *err) {
    static const struct { const char *word; int (*fn)(sup_gi_scene *, supi_gi_line *); } kinds[] = {
        {"camera", supi_gi_camera_line}, {"material", supi_gi_material_line}, {"light", supi_gi_lamp_line},
        {"object", supi_gi_thing_line},  {"path", supi_gi_path_line},         {"knot", supi_gi_knot_line},
    };
    sup_text text;
    supi_gi_line l;
    int status = 0, first = 1;
    text.begin = text.at = data;
    text.end = data + size;
    memset(out, 0, sizeof *out);
    out->seconds = out->white = 1.0;
    l.name = name;
    l.err = err;
    while (!status && text.at < text.end) {
        size_t k = 0, n = sizeof kinds / sizeof kinds[0];
        status = supi_gi_cut(&text, &l);
        if (status || l.count == 0) continue;
        if (first) {
            if (!supi_gi_is(&l, 0, "voxrt_gi") || !supi_gi_is(&l, 1, "1") || l.count != 2)
                status = supi_gi_fail(&l, "the first line is not \"voxrt_gi 1\"", SUP_GI_WORDS);
            first = 0;
            continue;
        }
        while (k < n && !supi_gi_is(&l, 0, kinds[k].word)) k++;
        l.at = 1;
        status = k < n ? kinds[k].fn(out, &l) : supi_gi_plain_line(out, &l);
    }
    if (!status && first) status = sup_fail(err, "%s: no scene: the first line is not \"voxrt_gi 1\"", name);
    if (!status && (out->camera_count == 0 || out->thing_count == 0)) status = sup_fail(err, "%s: a scene needs a camera and an object", name);
    for (size_t i = 0; !status && i < out->path_count; i++)
        if (out->paths[i].count == 0) status = sup_fail(err, "%s: path %s has no knots", name, out->paths[i].name);
    if (status) sup_gi_scene_free(out);
    return status;
}

/* ---- writing -------------------------------------------------------------------------------------------------- */

SUP_FN void supi_gi_put_word(FILE *f, const char *before, const char *word) { /* with a quote in it, it has no blank */
    const char *quote = strchr(word, '"') ? "" : "\"";
    fprintf(f, "%s%s%s%s", before, quote, word, quote);
}

SUP_FN void supi_gi_put_number(FILE *f, double v) { /* as short as it can be read back */
    char text[40];
    int digits = 14;
    do (void)snprintf(text, sizeof text, " %.*g", ++digits, v);
    while (digits < 17 && strtod(text, NULL) != v);
    fputs(text, f);
}

SUP_FN void supi_gi_put(FILE *f, const char *key, const double *v, int n) {
    fprintf(f, " %s", key);
    for (int k = 0; k < n; k++) supi_gi_put_number(f, v[k]);
}

SUP_FN void supi_gi_put_path(FILE *f, const sup_gi_scene *s, const char *key, int path) {
    if (path < 0) return;
    fprintf(f, " %s", key);
    supi_gi_put_word(f, " ", s->paths[path].name);
}

/* Is it a file, with a place that goes by the scene's? */
SUP_FN int sup_gi_is_relative(const char *file) {
    return strncmp(file, "scene:", 6) != 0 && strcmp(file, "plane") != 0 && strcmp(file, "mesh") != 0 && file[0] != '/';
}

SUP_FN void supi_gi_put_thing(FILE *f, const sup_gi_scene *s, const sup_gi_thing *o, const char *folder) {
    char *whole = NULL;
    const size_t n = strlen(folder) + strlen(o->file) + 2;
    if (folder[0] != '\0' && sup_gi_is_relative(o->file)) whole = (char *)sup_alloc(n, 1);
    if (whole) (void)snprintf(whole, n, "%s/%s", folder, o->file);
    supi_gi_put_word(f, "object ", whole ? whole : o->file);
    SUP_FREE(whole);
    supi_gi_put(f, "position", o->position, 3);
    supi_gi_put(f, "turn", o->turn, 3);
    supi_gi_put(f, "spin", o->spin, 3);
    supi_gi_put(f, "scale", &o->scale, 1);
    if (o->has_color) supi_gi_put(f, "color", o->color, 3);
    if (o->has_frames) supi_gi_put(f, "frames", o->frames, 3);
    if (o->spacing != 0.0) supi_gi_put(f, "spacing", &o->spacing, 1);
    if (o->voxels) fprintf(f, " voxels %s", sup_gi_voxels[o->voxels - 1]);
    if (o->moving) fputs(" moving", f);
    if (o->outwards) fputs(" outwards", f);
    if (o->material >= 0) supi_gi_put_word(f, " material ", s->materials[o->material].name);
    supi_gi_put_path(f, s, "path", o->path);
    fputc('\n', f);
}

/* Write a scene as text that sup_gi_scene_parse reads as the same scene. folder: before names of files that have no
   place of their own, "" for none. Returns 0, or 1 with err->text set and no file. */
SUP_FN int sup_gi_scene_write(const sup_gi_scene *s, const char *path, const char *folder, sup_error *err) {
    static const char *const kinds[4] = {"point", "spot", "directional", "area"};
    sup_file file;
    FILE *f;
    size_t i, k;
    if (sup_file_open(path, &file, err)) return 1;
    f = file.stream;
    fputs("voxrt_gi 1\nseconds", f);
    supi_gi_put_number(f, s->seconds);
    fputs("\nwhite", f);
    supi_gi_put_number(f, s->white);
    fputc('\n', f);
    if (s->has_box) {
        fputs("box", f);
        for (k = 0; k < 6; k++) supi_gi_put_number(f, s->box[k]);
        fputc('\n', f);
    }
    for (i = 0; i < s->material_count; i++) {
        const sup_gi_material *m = &s->materials[i];
        supi_gi_put_word(f, "material ", m->name);
        supi_gi_put(f, "albedo", m->albedo, 3);
        supi_gi_put(f, "specular", m->specular, 3);
        supi_gi_put(f, "exponent", &m->exponent, 1);
        supi_gi_put(f, "emission", m->emission, 3);
        fputc('\n', f);
    }
    for (i = 0; i < s->path_count; i++) {
        supi_gi_put_word(f, "path ", s->paths[i].name);
        fputs(s->paths[i].loop ? " loop\n" : "\n", f);
        for (k = s->paths[i].first; k < s->paths[i].first + s->paths[i].count; k++) {
            fputs("knot", f);
            supi_gi_put_number(f, s->knots[k].t);
            for (int a = 0; a < 3; a++) supi_gi_put_number(f, s->knots[k].at[a]);
            if (s->knots[k].has_tangent) supi_gi_put(f, "tangent", s->knots[k].tangent, 3);
            fputc('\n', f);
        }
    }
    for (i = 0; i < s->camera_count; i++) {
        const sup_gi_camera *c = &s->cameras[i];
        supi_gi_put_word(f, "camera ", c->name);
        supi_gi_put(f, "eye", c->eye, 3);
        supi_gi_put(f, "at", c->at, 3);
        supi_gi_put(f, "up", c->up, 3);
        supi_gi_put(f, "fov", &c->fov, 1);
        supi_gi_put_path(f, s, "path", c->path);
        supi_gi_put_path(f, s, "at_path", c->at_path);
        fputc('\n', f);
    }
    for (i = 0; i < s->lamp_count; i++) {
        const sup_gi_lamp *l = &s->lamps[i];
        fprintf(f, "light %s", kinds[l->kind]);
        supi_gi_put(f, "position", l->position, 3);
        supi_gi_put(f, "direction", l->direction, 3);
        supi_gi_put(f, "angle", &l->angle, 1);
        supi_gi_put(f, "u", l->u, 3);
        supi_gi_put(f, "v", l->v, 3);
        supi_gi_put(f, "color", l->color, 3);
        supi_gi_put_path(f, s, "path", l->path);
        fputc('\n', f);
    }
    for (i = 0; i < s->thing_count; i++) supi_gi_put_thing(f, s, &s->things[i], folder);
    return sup_file_commit(&file, err);
}

/* ---- places at a time ----------------------------------------------------------------------------------------- */

/* Tangent of knot i, for a unit of time: as given, or along the neighbours (Catmull & Rom 1974). */
SUP_FN void supi_gi_tangent(const sup_gi_scene *s, const sup_gi_path *p, size_t i, double out[3]) {
    const sup_gi_knot *k = s->knots + p->first, *a, *b;
    double dt;
    if (k[i].has_tangent || p->count < 2) {
        memcpy(out, k[i].tangent, sizeof k[i].tangent);
        return;
    }
    a = i > 0 ? &k[i - 1] : p->loop ? &k[p->count - 2] : &k[0]; /* of a loop the last knot is the first one again */
    b = i + 1 < p->count ? &k[i + 1] : p->loop ? &k[1] : &k[i];
    dt = b->t - a->t;
    if (p->loop && (i == 0 || i + 1 == p->count)) dt = k[p->count - 1].t - k[p->count - 2].t + k[1].t - k[0].t;
    for (int c = 0; c < 3; c++) out[c] = dt != 0.0 ? (b->at[c] - a->at[c]) / dt : 0.0;
}

/* Cubic Hermite curve through the knots; it stays at its ends, or goes round. */
SUP_FN void sup_gi_path_at(const sup_gi_scene *s, const sup_gi_path *p, double time, double out[3]) {
    const sup_gi_knot *k = s->knots + p->first;
    const double first = k[0].t, last = k[p->count - 1].t;
    double m[2][3], h, t, t2, t3;
    size_t i = 0;
    if (p->loop && last > first) time = first + (time - first) - floor((time - first) / (last - first)) * (last - first);
    if (!(time > first) || p->count < 2) {
        memcpy(out, k[0].at, sizeof k[0].at);
        return;
    }
    if (!(time < last)) {
        memcpy(out, k[p->count - 1].at, sizeof k[0].at);
        return;
    }
    while (i + 2 < p->count && time >= k[i + 1].t) i++;
    h = k[i + 1].t - k[i].t;
    t = (time - k[i].t) / h;
    t2 = t * t;
    t3 = t2 * t;
    supi_gi_tangent(s, p, i, m[0]);
    supi_gi_tangent(s, p, i + 1, m[1]);
    for (int c = 0; c < 3; c++)
        out[c] = (2 * t3 - 3 * t2 + 1) * k[i].at[c] + (t3 - 2 * t2 + t) * h * m[0][c] + (3 * t2 - 2 * t3) * k[i + 1].at[c] +
            (t3 - t2) * h * m[1][c];
}

/* position + what its path adds. */
SUP_FN void sup_gi_place(const sup_gi_scene *s, const double position[3], int path, double time, float out[3]) {
    double add[3] = {0.0, 0.0, 0.0};
    if (path >= 0) sup_gi_path_at(s, &s->paths[path], time, add);
    for (int c = 0; c < 3; c++) out[c] = (float)(position[c] + add[c]);
}

/* Object to world, three rows of four: scaled, turned about x, then y, then z, moved. */
SUP_FN void sup_gi_matrix(const sup_gi_scene *s, const sup_gi_thing *o, double time, double m[12]) {
    double c[3], n[3], add[3] = {0.0, 0.0, 0.0};
    for (int a = 0; a < 3; a++) {
        const double angle = (o->turn[a] + o->spin[a] * time) * (3.14159265358979323846 / 180.0);
        c[a] = cos(angle);
        n[a] = sin(angle);
    }
    if (o->path >= 0) sup_gi_path_at(s, &s->paths[o->path], time, add);
    m[0] = c[2] * c[1];
    m[1] = c[2] * n[1] * n[0] - n[2] * c[0];
    m[2] = c[2] * n[1] * c[0] + n[2] * n[0];
    m[4] = n[2] * c[1];
    m[5] = n[2] * n[1] * n[0] + c[2] * c[0];
    m[6] = n[2] * n[1] * c[0] - c[2] * n[0];
    m[8] = 0.0 - n[1];
    m[9] = c[1] * n[0];
    m[10] = c[1] * c[0];
    for (int a = 0; a < 3; a++) {
        for (int k = 0; k < 3; k++) m[4 * a + k] *= o->scale;
        m[4 * a + 3] = o->position[a] + add[a];
    }
}

/* Which file of a sequence is shown: its number. */
SUP_FN int sup_gi_frame(const sup_gi_thing *o, double time) {
    const double n = o->frames[1] - o->frames[0] + 1.0, f = fmod(floor(time * o->frames[2] + 1e-9), n);
    return (int)(o->frames[0] + (f < 0.0 ? f + n : f));
}

/* ---- for other renderers -------------------------------------------------------------------------------------- */

/* A scene as it is at a time, for any renderer: `path`, a scene in which nothing moves, with one PLY file for each object
   in world coordinates, its colours in it, PATH-0.ply and so on (the extension of PATH left out). mesh: of each object.
   box: what indirect light sees. Returns 0, or 1 with err->text set. */
SUP_FN int sup_gi_export(const sup_gi_scene *s, double time, const sup_mesh *const *mesh, const double box[6], const char *path, sup_error *err) {
    const char *slash = strrchr(path, '/'), *name = slash ? slash + 1 : path, *dot = strrchr(name, '.');
    const size_t stem = dot && dot != name ? (size_t)(dot - path) : strlen(path), room = strlen(path) + 32;
    sup_gi_scene flat;
    sup_gi_thing *things = (sup_gi_thing *)sup_alloc(s->thing_count, sizeof *things);
    sup_gi_lamp *lamps = (sup_gi_lamp *)sup_alloc(s->lamp_count + 1, sizeof *lamps);
    sup_gi_camera *cameras = (sup_gi_camera *)sup_alloc(s->camera_count, sizeof *cameras);
    char *file = (char *)sup_alloc(s->thing_count + 1, room);
    float at[3];
    size_t i;
    int status = things && lamps && cameras && file ? 0 : sup_fail(err, "%s: out of memory", path);
    flat = *s;
    flat.things = things;
    flat.lamps = lamps;
    flat.cameras = cameras;
    flat.path_count = flat.knot_count = 0;
    flat.has_box = 1;
    memcpy(flat.box, box, sizeof flat.box);
    for (i = 0; !status && i < s->lamp_count; i++) {
        lamps[i] = s->lamps[i];
        sup_gi_place(s, s->lamps[i].position, s->lamps[i].path, time, at);
        for (int a = 0; a < 3; a++) lamps[i].position[a] = (double)at[a];
        lamps[i].path = -1;
    }
    for (i = 0; !status && i < s->camera_count; i++) {
        cameras[i] = s->cameras[i];
        sup_gi_place(s, s->cameras[i].eye, s->cameras[i].path, time, at);
        for (int a = 0; a < 3; a++) cameras[i].eye[a] = (double)at[a];
        sup_gi_place(s, s->cameras[i].at, s->cameras[i].at_path, time, at);
        for (int a = 0; a < 3; a++) cameras[i].at[a] = (double)at[a];
        cameras[i].path = cameras[i].at_path = -1;
    }
    for (i = 0; !status && i < s->thing_count; i++) {
        sup_gi_thing *o = &things[i];
        double m[12];
        char *to = file + i * room;
        (void)snprintf(to, room, "%.*s-%lu.ply", (int)stem, path, (unsigned long)i);
        sup_gi_matrix(s, &s->things[i], time, m);
        status = sup_ply_write(to, mesh[i], m, err);
        memset(o, 0, sizeof *o);
        o->file = to + (name - path);
        o->scale = 1.0;
        o->path = -1;
        o->material = s->things[i].material;
        o->voxels = s->things[i].voxels;
        o->spacing = s->things[i].spacing;
    }
    if (!status) { /* albedo is in the colours now */
        sup_gi_material *materials = (sup_gi_material *)sup_alloc(s->material_count + 1, sizeof *materials);
        if (!materials) status = sup_fail(err, "%s: out of memory", path);
        for (i = 0; !status && i < s->material_count; i++) {
            materials[i] = s->materials[i];
            materials[i].albedo[0] = materials[i].albedo[1] = materials[i].albedo[2] = 1.0;
        }
        flat.materials = materials;
        if (!status) status = sup_gi_scene_write(&flat, path, "", err);
        SUP_FREE(materials);
    }
    SUP_FREE(things);
    SUP_FREE(lamps);
    SUP_FREE(cameras);
    SUP_FREE(file);
    return status;
}

#endif /* SUP_GI_SCENE_H */
