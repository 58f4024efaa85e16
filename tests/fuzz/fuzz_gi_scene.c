/* fuzz_gi_scene.c - bytes as a scene of voxrt_gi: refused with a line, or read; then places at any time are numbers, a
   sequence shows one of its files, and what is written is read as the same scene. */
#define _POSIX_C_SOURCE 200809L
#include "../../examples/support/gi_scene.h"
#include <unistd.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void must(int ok) {
    if (!ok) abort();
}

/* A name that has a quote and a blank in it, or a line's end, cannot be said in a file; nothing reads such a one. */
static void write_and_read(const sup_gi_scene *s) {
    char path[64], *text = NULL;
    size_t n;
    sup_gi_scene again;
    sup_error err;
    (void)snprintf(path, sizeof path, "/tmp/fuzz_gi_scene.%ld.txt", (long)getpid());
    if (sup_gi_scene_write(s, path, "", &err)) return; /* no room on the disk */
    must(sup_read_file(path, &text, &n, &err) == 0);
    must(sup_gi_scene_parse(text, n, path, &again, &err) == 0);
    (void)remove(path);
    must(again.thing_count == s->thing_count && again.lamp_count == s->lamp_count && again.camera_count == s->camera_count);
    must(again.knot_count == s->knot_count && again.material_count == s->material_count && again.path_count == s->path_count);
    must(again.knot_count == 0 || memcmp(&again.knots[again.knot_count - 1].t, &s->knots[s->knot_count - 1].t, 32) == 0);
    for (size_t i = 0; i < s->thing_count; i++) {
        const sup_gi_thing *a = &again.things[i], *b = &s->things[i];
        must(strcmp(a->file, b->file) == 0 && memcmp(a->position, b->position, sizeof a->position) == 0);
        must(a->scale == b->scale && a->path == b->path && a->material == b->material && a->moving == b->moving && a->voxels == b->voxels);
    }
    for (size_t i = 0; i < s->lamp_count; i++) must(memcmp(&again.lamps[i], &s->lamps[i], sizeof again.lamps[i]) == 0);
    sup_gi_scene_free(&again);
    SUP_FREE(text);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static const double times[5] = {0, 0.3, 1, 1e3, 1e9};
    sup_gi_scene s;
    sup_error err;
    size_t i, k, a;
    err.text[0] = '\0';
    if (sup_gi_scene_parse((const char *)data, size, "fuzz", &s, &err) != 0) {
        must(strncmp(err.text, "fuzz: ", 6) == 0 && s.things == NULL && s.thing_count == 0);
        return 0;
    }
    must(s.camera_count > 0 && s.thing_count > 0 && s.seconds > 0.0 && s.white > 0.0);
    for (k = 0; k < 5; k++) {
        const double t = k < 4 ? times[k] : s.seconds;
        for (i = 0; i < s.path_count; i++) {
            double p[3];
            sup_gi_path_at(&s, &s.paths[i], t, p);
            for (a = 0; a < 3; a++) must(!(p[a] != p[a]));
        }
        for (i = 0; i < s.thing_count; i++) {
            const sup_gi_thing *o = &s.things[i];
            double m[12];
            char name[64];
            sup_gi_matrix(&s, o, t, m);
            for (a = 0; a < 12; a++) must(!(m[a] != m[a]));
            if (!o->has_frames) continue;
            must((double)sup_gi_frame(o, t) >= floor(o->frames[0]) && (double)sup_gi_frame(o, t) <= o->frames[1]);
            (void)sup_frame_name(o->file, sup_gi_frame(o, t), name, sizeof name);
        }
        for (i = 0; i < s.lamp_count; i++) {
            float p[3];
            sup_gi_place(&s, s.lamps[i].position, s.lamps[i].path, t, p);
        }
    }
    if (size < 4096) write_and_read(&s);
    sup_gi_scene_free(&s);
    return 0;
}
