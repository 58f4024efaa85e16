/* voxrt_convert.c - mesh -> voxel file, or one voxel file -> another
   SPDX-License-Identifier: MIT OR Unlicense */
#include "support/camera.h"
#include "support/cli.h"
#include "support/displace.h"
#include "support/mesh.h"
#include "support/picture.h"
#include "support/scenes.h"
#define VOXRT_IMPLEMENTATION
#include "voxrt.h"
#include "support/finish.h"
#include "support/voxel_file.h"
#include "support/voxel_mesh.h"

typedef struct convert_options {
    const char *first, *second; /* positional arguments */
    const char *in, *out, *scene, *edit;
    int64_t resolution, palette, threads, detail, fill_depth;
    int separating, palette_method, lod, format, normals, fill, planes, spread, no_colors, no_materials, raw, paged, share;
    int keep_inside_out, stats, quiet;
    int voxels, flip_y, flip_z, swap_angles; /* voxels: `in` is a voxel file; how to turn it */
} convert_options;

enum { NORMALS_SMOOTH, NORMALS_FLAT, NORMALS_NONE };
enum { FORMAT_V5, FORMAT_V4 };

static int parse(int argc, char **argv, convert_options *o) {
    sup_option table[30];
    size_t n = 0, mesh_options, k;
    int status, for_meshes = 0, has_lod = 0;
    memset(o, 0, sizeof *o);
    o->resolution = 1024;
    o->palette = 32767;
    table[n++] = sup_opt_positional("IN.{obj,ply,stl,off,vox}", &o->first, 0,
                                      "mesh to convert, or a voxel file of format 5 or 4; left out with --scene");
    table[n++] = sup_opt_positional("OUT.vox", &o->second, 0, "voxel file to write");
    mesh_options = n;
    table[n++] = sup_opt_int("res", &o->resolution, 1, 65536, "N", "voxels along the longest side (1024)");
    table[n++] = sup_opt_choice("separating", &o->separating, "6|26|thesis",
                                "6: thin and without holes (default); 26: every voxel the surface touches; thesis: the "
                                "scan converter of 2009, has gaps");
    table[n++] = sup_opt_int("palette", &o->palette, 1, 16777216, "N", "colours at most (32767)");
    table[n++] = sup_opt_choice("palette-method", &o->palette_method, "oklab|thesis",
                                "how colours are merged when there are more");
    table[n++] = sup_opt_choice(
        "normals", &o->normals, "smooth|flat|none",
        "of the file or, if it has none, smooth but for edges sharper than 60 degrees; of the triangles; none: shade the "
        "faces of the cubes");
    table[n++] = sup_opt_flag("planes", &o->planes, "a plane in each voxel: smooth outlines and shadows close up; one byte "
                              "a voxel, and --separating 26");
    table[n++] = sup_opt_flag("spread", &o->spread, "larger cells keep how much the normals in them differ: highlights of coarser levels are as "
                              "wide as they should be; one byte a larger cell");
    table[n++] = sup_opt_flag("no-colors", &o->no_colors, "one colour for all");
    table[n++] = sup_opt_flag("no-materials", &o->no_materials, "nothing but the colours of the materials of an OBJ file: no pictures on "
                              "it, no displacement, no mirrors, no glass");
    table[n++] = sup_opt_flag("keep-inside-out", &o->keep_inside_out,
                              "do not turn the normals of a mesh that encloses a negative volume");
    table[n++] = sup_opt_flag("fill", &o->fill, "fill closed hulls");
    table[n++] =
        sup_opt_int("fill-depth", &o->fill_depth, 0, 1048576, "N", "with --fill: only so many voxels deep (0: all)");
    for (k = mesh_options; k < n; k++) table[k].given = &for_meshes;
    table[n++] = sup_opt_given(sup_opt_choice("lod", &o->lod, "mean|majority",
                                              "colours of the coarser levels: mean of the voxels, or the most frequent "
                                              "child as in the thesis"), &has_lod);
    table[n++] = sup_opt_choice("format", &o->format, "v5|v4",
                                "v5: compact and lossless (default); v4: the thesis' octree file");
    table[n++] = sup_opt_flag("raw", &o->raw, "v5 without compression: can be mapped into memory and used in place");
    table[n++] = sup_opt_flag("paged", &o->paged, "v5 in pages, for voxrt_render --memory: of a mesh it is made piece by piece, the voxels need not fit "
                              "into memory, and each page has all its colours");
    table[n++] = sup_opt_flag("share", &o->share, "store equal parts once: less memory when loaded, the same picture");
    table[n++] = sup_opt_text("edit", &o->edit, "FILE", "change the voxels; lines like \"clear sphere X Y Z RADIUS\", \"set box X Y Z "
                              "X Y Z R G B\", \"paint sphere ...\", \"set mesh FILE\", \"undo\"; lengths as in IN; \"finish mirror 0.8\", "
                              "\"finish transparency 1 refraction 1.5 absorption 0 1 2\" are for what is set or painted after them, "
                              "until \"finish plain\"");
    table[n++] = sup_opt_flag("flip-y", &o->flip_y, "of files of format 4 from elsewhere: y runs the other way");
    table[n++] = sup_opt_flag("flip-z", &o->flip_z, "the same for z");
    table[n++] = sup_opt_flag("swap-angles", &o->swap_angles, "their normals have the angles in the other order");
    table[n++] = sup_opt_text("scene", &o->scene, SUP_SCENE_NAMES, "a generated mesh instead of a file");
    table[n++] = sup_opt_int("detail", &o->detail, 0, 65536, "N", "how fine the generated mesh is (0: its default)");
    table[n++] = sup_opt_int("threads", &o->threads, 0, 1024, "N", "threads, 0: one per core; the file is the same");
    table[n++] = sup_opt_flag("stats", &o->stats, "one JSON object on stdout");
    table[n++] = sup_opt_flag("quiet", &o->quiet, "no progress and no warnings");
    status = sup_cli_parse(argc, argv, "Turns a mesh into a voxel file, or a voxel file into one of another kind.", table, n);
    if (status >= 0) return status;
    if (o->scene != NULL) {
        if (o->first == NULL) return sup_bad_usage(argv[0], "OUT.vox is missing");
        if (o->second != NULL) return sup_bad_usage(argv[0], "with --scene there is only one file, OUT.vox");
        if (sup_parse_choice(o->scene, SUP_SCENE_NAMES) < 0)
            return sup_bad_usage(argv[0], "--scene: \"%s\" is none of %s", o->scene, SUP_SCENE_NAMES);
        o->in = o->scene;
        o->out = o->first;
    } else {
        if (o->detail != 0) return sup_bad_usage(argv[0], "--detail goes with --scene");
        if (o->second == NULL)
            return sup_bad_usage(argv[0], "%s is missing", o->first == NULL ? "IN.{obj,ply,stl,off,vox}" : "OUT.vox");
        o->in = o->first;
        o->out = o->second;
        if (strcmp(o->in, o->out) == 0) return sup_bad_usage(argv[0], "\"%s\" is read and written", o->in);
        o->voxels = sup_name_ends(o->in, ".vox");
    }
    if (o->voxels && (for_meshes || (has_lod && o->format != FORMAT_V4)))
        return sup_bad_usage(argv[0], "what a voxel file becomes is said by --format, --lod with v4, --raw and --share");
    if (!o->voxels && (o->flip_y || o->flip_z || o->swap_angles))
        return sup_bad_usage(argv[0], "--flip-y, --flip-z and --swap-angles go with a voxel file");
    if (o->format == FORMAT_V4 && o->palette > 32767)
        return sup_bad_usage(argv[0], "--format v4 holds at most 32767 colours");
    if (o->raw && o->format == FORMAT_V4) return sup_bad_usage(argv[0], "--raw goes with --format v5");
    if (o->paged && (o->raw || o->share || o->format == FORMAT_V4))
        return sup_bad_usage(argv[0], "--paged goes with --format v5, without --raw and --share");
    if (o->share && o->format == FORMAT_V4) return sup_bad_usage(argv[0], "--share goes with --format v5");
    if (o->spread && o->normals == NORMALS_NONE) return sup_bad_usage(argv[0], "--spread needs normals");
    if (o->planes && o->normals == NORMALS_NONE) return sup_bad_usage(argv[0], "--planes needs normals");
    if (o->fill_depth != 0 && !o->fill) return sup_bad_usage(argv[0], "--fill-depth goes with --fill");
    return -1;
}

/* Twelve times the volume that the triangles enclose, seen from the middle of the mesh: negative if they face inwards.
 */
static double signed_volume(const sup_mesh *m) {
    float lo[3], hi[3];
    double sum = 0.0;
    if (sup_mesh_bounds(m, lo, hi)) return 0.0;
    for (size_t t = 0; t < m->triangle_count; t++) {
        double p[3][3];
        for (int c = 0; c < 3; c++) {
            for (int a = 0; a < 3; a++) {
                p[c][a] = (double)m->positions[3 * (size_t)m->indices[3 * t + (size_t)c] + (size_t)a] -
                          0.5 * ((double)lo[a] + (double)hi[a]);
            }
        }
        const double v = p[0][0] * (p[1][1] * p[2][2] - p[1][2] * p[2][1]) +
                         p[0][1] * (p[1][2] * p[2][0] - p[1][0] * p[2][2]) +
                         p[0][2] * (p[1][0] * p[2][1] - p[1][1] * p[2][0]);
        if (fabs(v) <= DBL_MAX) sum += v;
    }
    return sum;
}

/* Turn the triangles round; with normals = NULL they follow. Returns 1 when it was done. */
static int turn_outwards(sup_mesh *m) {
    if (m->normals != NULL || !(signed_volume(m) < 0.0)) return 0;
    for (size_t t = 0; t < m->triangle_count; t++) {
        const uint32_t swap = m->indices[3 * t + 1];
        m->indices[3 * t + 1] = m->indices[3 * t + 2];
        m->indices[3 * t + 2] = swap;
        for (int k = 0; m->texcoords != NULL && k < 2; k++) {
            float *uv = m->texcoords + 6 * t, other = uv[2 + k];
            uv[2 + k] = uv[4 + k];
            uv[4 + k] = other;
        }
    }
    return 1;
}

static int read_mesh(const char *program, const convert_options *o, sup_mesh *mesh, int *turned) {
    sup_error err;
    sup_error_clear(&err);
    if (o->scene != NULL) {
        const int failed = sup_scene_make(o->scene, (int)o->detail, mesh);
        if (failed == 1) return sup_bad_usage(program, "--detail: out of range for %s", o->scene);
        if (failed) return sup_bad_input(program, "out of memory");
    } else {
        if (sup_mesh_read(o->in, mesh, &err)) return sup_bad_input(program, err.text);
        if (!o->quiet) sup_warn(program, err.text);
    }
    if (o->normals != NORMALS_SMOOTH) {
        SUP_FREE(mesh->normals);
        mesh->normals = NULL;
    }
    /* Generated rooms are seen from inside; files that face inwards are mostly mistakes. */
    *turned = o->scene == NULL && !o->keep_inside_out && turn_outwards(mesh);
    /* Generated meshes without normals have sharp edges. */
    if (o->scene == NULL && o->normals == NORMALS_SMOOTH && mesh->normals == NULL && mesh->triangle_count > 0 &&
        sup_mesh_compute_normals(mesh, &err)) {
        return sup_bad_input(program, err.text);
    }
    return 0;
}

/* Write the file o->out; or, with `size`, to memory: what it takes, and into `buffer` if that is large enough. */
static voxrt_result write_voxels(const convert_options *o, const voxrt_env *env, const voxrt_tree *tree, void *buffer,
                                 size_t capacity, size_t *size) {
    voxrt_result result;
    if (o->format == FORMAT_V4) {
        voxrt_octree_desc desc = {0};
        voxrt_octree *octree = NULL;
        desc.env = *env;
        desc.disable_grid = 1;
        desc.lod_majority = (uint32_t)o->lod;
        result = voxrt_octree_from_tree(&desc, tree, &octree);
        if (result == VOXRT_OK) {
            result = size != NULL ? voxrt_octree_save_memory(octree, env, buffer, capacity, size) :
                                    voxrt_octree_save_file(octree, env, o->out);
        }
        voxrt_octree_destroy(octree);
    } else {
        voxrt_save_desc save = {0};
        save.env = *env;
        save.encoding = o->raw ? VOXRT_ENCODING_RAW : o->paged ? VOXRT_ENCODING_PAGED : VOXRT_ENCODING_COMPACT;
        result = size != NULL ? voxrt_tree_save_memory(tree, &save, buffer, capacity, size) :
                                voxrt_tree_save_file(tree, &save, o->out);
    }
    return result;
}

/* The library writes a new file beside the old one, which it then replaces. A device, a pipe or a link must not be
   replaced: the file is made in memory and written to it. Returns 0, or 1 with err->text set. */
static int write_out(const convert_options *o, const voxrt_env *env, const voxrt_tree *tree, sup_error *err) {
    size_t size = 0;
    void *data = NULL;
    voxrt_result result;
    int failed;
    sup_error_clear(err);
    errno = 0;
    if (!sup_is_special_file(o->out)) {
        result = write_voxels(o, env, tree, NULL, 0, NULL);
    } else {
        result = write_voxels(o, env, tree, NULL, 0, &size);
        if (result == VOXRT_OK) data = sup_alloc(size, 1);
        if (result == VOXRT_OK) result = data == NULL ? VOXRT_ERR_NO_MEMORY : write_voxels(o, env, tree, data, size, &size);
        failed = result == VOXRT_OK && sup_write_file(o->out, data, size, err);
        SUP_FREE(data);
        if (failed) return 1;
    }
    if (result == VOXRT_OK) return 0;
    if (result == VOXRT_ERR_IO && errno != 0) return sup_fail(err, "%s: %s", o->out, strerror(errno));
    return sup_fail(err, "%s: %s", o->out, env->error->text[0] ? env->error->text : voxrt_result_string(result));
}

static size_t file_size(const char *path) {
    FILE *file = fopen(path, "rb");
    long size = 0;
    if (file != NULL) {
        if (fseek(file, 0, SEEK_END) == 0) size = ftell(file);
        (void)fclose(file);
    }
    return size > 0 ? (size_t)size : 0;
}

enum { MAX_FINISHES = 255 };

/* What a mesh has beside places and colours. */
typedef struct dressing {
    sup_textured textured;
    sup_mesh displaced; /* in place of the mesh if it has triangles */
    voxrt_finish finishes[MAX_FINISHES];
    size_t finish_count;
    uint8_t *of_triangle;
    uint8_t *of_material;
} dressing;

static void free_dressing(dressing *d) {
    sup_textured_free(&d->textured);
    sup_mesh_free(&d->displaced);
    SUP_FREE(d->of_triangle);
    SUP_FREE(d->of_material);
}

/* Finishes of materials, each once. Returns 1 when memory is short. More than there is room for are plain: *left. */
static int make_finishes(const sup_mesh *mesh, dressing *d, size_t *left) {
    d->of_material = (uint8_t *)sup_alloc(mesh->material_count, 1);
    if (d->of_material == NULL) return 1;
    for (size_t i = 0; i < mesh->material_count; i++) {
        voxrt_finish f;
        size_t k = 0;
        d->of_material[i] = 0;
        if (!sup_finish_of(mesh->materials + i, &f)) continue;
        while (k < d->finish_count && memcmp(&d->finishes[k], &f, sizeof f) != 0) k++;
        if (k == MAX_FINISHES) {
            ++*left;
            continue;
        }
        if (k == d->finish_count) d->finishes[d->finish_count++] = f;
        d->of_material[i] = (uint8_t)(k + 1);
    }
    return 0;
}

static void sample_textures(void *user, voxrt_sample *sample) {
    sup_textured_sample((const sup_textured *)user, sample->triangle, sample->weight, sample->footprint, sample->color, sample->normal);
}

static size_t triangles_that_fit(void) {
    const size_t memory = sup_memory_limit();
    return memory / 256; /* with all that is made of a triangle */
}

/* *in: the mesh with textures, displacement and finishes. Returns 0, or the exit status. */
static int dress(const char *program, const convert_options *o, sup_mesh *mesh, dressing *d, voxrt_build_desc *desc, voxrt_mesh *in) {
    const sup_mesh *m = mesh;
    sup_error err;
    float lo[3], hi[3];
    double longest = 0.0;
    size_t left = 0, i;
    char *user = NULL;
    int displaces = 0, failed;
    *in = sup_voxel_mesh(mesh);
    if (mesh->material_count == 0 || mesh->triangle_material == NULL || o->no_materials) return 0;
    if (o->scene == NULL) { /* the user pointer of a callback is not const */
        user = (char *)sup_alloc(strlen(o->in) + 1, 1);
        if (user == NULL) return sup_bad_input(program, "out of memory");
        memcpy(user, o->in, strlen(o->in) + 1);
    }
    failed = sup_textured_open(mesh, o->scene != NULL ? sup_scene_open : supi_open_beside, user, &d->textured, &err);
    SUP_FREE(user);
    if (failed) return sup_bad_input(program, err.text);
    if (!o->quiet) sup_warn(program, err.text);
    for (i = 0; i < mesh->triangle_count && !displaces; i++) displaces = supi_displaced(&d->textured, i) != 0;
    if (displaces && !sup_mesh_bounds(mesh, lo, hi)) {
        for (int a = 0; a < 3; a++) longest = fmax(longest, (double)hi[a] - (double)lo[a]);
        if (sup_mesh_displace(&d->textured, longest / (double)o->resolution, triangles_that_fit(), &d->displaced, &err))
            return sup_bad_input(program, err.text);
        d->displaced.materials = mesh->materials; /* handed over, with their names */
        d->displaced.material_count = mesh->material_count;
        mesh->materials = NULL;
        mesh->material_count = 0;
        d->textured.mesh = m = &d->displaced;
        *in = sup_voxel_mesh(m);
    }
    if (make_finishes(m, d, &left)) return sup_bad_input(program, "out of memory");
    if (left != 0 && !o->quiet) sup_warn(program, "more than 255 kinds of materials: the last ones have only their colours");
    if (d->finish_count != 0 && o->format != FORMAT_V4) {
        d->of_triangle = (uint8_t *)sup_alloc(m->triangle_count, 1);
        if (d->of_triangle == NULL) return sup_bad_input(program, "out of memory");
        for (i = 0; i < m->triangle_count; i++)
            d->of_triangle[i] = m->triangle_material[i] != 0 ? d->of_material[m->triangle_material[i] - 1] : 0;
        desc->finishes = d->finishes;
        desc->finish_count = d->finish_count;
        in->triangle_finish = d->of_triangle;
    }
    if (sup_textured_any(&d->textured)) {
        in->sample_fn = sample_textures;
        in->sample_user = &d->textured;
    }
    return 0;
}

typedef struct converted {
    voxrt_tree *tree;
    voxrt_build_stats stats;
    double read_seconds, build_seconds, edit_seconds, write_seconds;
    voxrt_edit_stats edits;
    int edited; /* lines of --edit */
    int turned; /* 1: the mesh faced inwards */
    int had_finishes, had_planes;
} converted;

/* What a file in pages says of itself; bytes as they are in the file. */
static void paged_info(const char *path, voxrt_tree_info *info) {
    voxrt_paged_info paged = {0};
    voxrt_paged *p = NULL;
    sup_error err;
    if (sup_voxels_paged(path, (uint64_t)1 << 30, 0, &p, &err)) return;
    voxrt_paged_get_info(p, &paged);
    voxrt_paged_destroy(p);
    info->depth = paged.depth;
    info->resolution = paged.resolution;
    info->voxel_count = paged.voxel_count;
    info->total_bytes = paged.file_bytes;
    info->finish_count = paged.finish_count;
}

static void print_stats(const convert_options *o, const converted *c) {
    const voxrt_build_stats *s = &c->stats;
    voxrt_tree_info info = {0};
    if (c->tree != NULL) voxrt_tree_get_info(c->tree, &info);
    else paged_info(o->out, &info);
    printf("{\"program\":\"voxrt_convert\",\"in\":");
    sup_json_string(stdout, o->in);
    printf(",\"triangles\":%llu,\"rejected\":%llu,\"degenerate\":%llu,\"fragments\":%llu",
           (unsigned long long)s->triangles, (unsigned long long)s->rejected, (unsigned long long)s->degenerate,
           (unsigned long long)s->fragments);
    printf(",\"turned\":%d,\"resolution\":%u,\"depth\":%u,\"voxels\":%llu,\"colors_in\":%llu,\"palette\":%u,\"finishes\":%u", c->turned,
           info.resolution, info.depth, (unsigned long long)info.voxel_count, (unsigned long long)s->colors_in,
           info.palette_count, info.finish_count);
    printf(",\"geometry_bytes\":%llu,\"color_bytes\":%llu,\"normal_bytes\":%llu,\"bytes\":%llu,\"file_bytes\":%llu,"
           "\"peak_bytes\":%llu",
           (unsigned long long)info.geometry_bytes, (unsigned long long)info.color_bytes,
           (unsigned long long)info.normal_bytes, (unsigned long long)info.total_bytes,
           (unsigned long long)file_size(o->out), (unsigned long long)s->peak_bytes);
    if (o->edit)
        printf(",\"edits\":%d,\"filled\":%llu,\"cleared\":%llu,\"painted\":%llu,\"edit_seconds\":%.6f", c->edited,
               (unsigned long long)c->edits.filled, (unsigned long long)c->edits.cleared,
               (unsigned long long)c->edits.painted, c->edit_seconds);
    printf(",\"read_seconds\":%.6f,\"build_seconds\":%.6f,\"write_seconds\":%.6f}\n", c->read_seconds,
           c->build_seconds, c->write_seconds);
}

static int bad_result(const char *program, const convert_options *o, voxrt_result result, const voxrt_error *error) {
    sup_error err;
    (void)sup_fail(&err, "%s: %s", o->in, error->text[0] ? error->text : voxrt_result_string(result));
    return sup_bad_input(program, err.text);
}

/* The file is made from the mesh, without a tree in memory. */
static int is_direct(const convert_options *o) {
    return o->paged && !o->voxels && !o->edit && !o->fill && !o->lod && !sup_is_special_file(o->out);
}

/* Read a mesh and make the tree, or the file. Returns 0 or the exit status. */
static int build(const char *program, const convert_options *o, const voxrt_env *env, converted *c) {
    static const voxrt_separating separating[3] = {VOXRT_SEPARATING_6, VOXRT_SEPARATING_26, VOXRT_SEPARATING_THESIS};
    voxrt_build_desc desc = {0};
    voxrt_mesh in;
    voxrt_result result;
    sup_mesh mesh = {0};
    dressing *d = (dressing *)sup_alloc(1, sizeof *d);
    sup_error err;
    sup_progress progress;
    double start = sup_now();
    int status;
    if (d == NULL) return sup_bad_input(program, "out of memory");
    memset(d, 0, sizeof *d);
    status = read_mesh(program, o, &mesh, &c->turned);
    if (!status) status = dress(program, o, &mesh, d, &desc, &in);
    if (status) {
        free_dressing(d);
        SUP_FREE(d);
        sup_mesh_free(&mesh);
        return status;
    }
    c->read_seconds = sup_now() - start;
    if (o->normals != NORMALS_SMOOTH) in.normals = NULL;
    desc.env = *env;
    sup_progress_begin(&progress, "voxelising", o->quiet);
    if (!progress.quiet) {
        desc.env.progress_fn = sup_progress_fn;
        desc.env.progress_user = &progress;
    }
    desc.resolution = (uint32_t)o->resolution;
    desc.separating = separating[o->separating];
    desc.palette_size = (uint32_t)o->palette;
    desc.palette_method = o->palette_method ? VOXRT_PALETTE_THESIS : VOXRT_PALETTE_OKLAB;
    desc.lod_method = o->lod ? VOXRT_LOD_MAJORITY : VOXRT_LOD_MEAN;
    desc.disable_normals = o->normals == NORMALS_NONE;
    desc.planes = (uint32_t)o->planes;
    desc.spread = (uint32_t)o->spread;
    desc.disable_colors = (uint32_t)o->no_colors;
    desc.fill = (uint32_t)o->fill;
    desc.fill_depth = (uint32_t)o->fill_depth;
    start = sup_now();
    result = is_direct(o) ? voxrt_paged_build_file(&desc, &in, o->out, &c->stats) : voxrt_tree_build(&desc, &in, &c->stats, &c->tree);
    c->build_seconds = sup_now() - start;
    sup_progress_end(&progress);
    c->had_finishes = d->finish_count != 0;
    free_dressing(d);
    SUP_FREE(d);
    sup_mesh_free(&mesh);
    if (result != VOXRT_OK) return bad_result(program, o, result, env->error);
    if (c->stats.rejected != 0 && !o->quiet) {
        (void)sup_fail(&err, "%s: %llu of %llu triangles are left out: coordinates or indices out of range", o->in,
                       (unsigned long long)c->stats.rejected, (unsigned long long)c->stats.triangles);
        sup_warn(program, err.text);
    }
    return 0;
}

/* Read a voxel file. Returns 0 or the exit status. */
static int reopen(const char *program, const convert_options *o, converted *c) {
    const double start = sup_now();
    voxrt_octree_desc how = {0};
    sup_error err;
    how.flip_y = (uint32_t)o->flip_y;
    how.flip_z = (uint32_t)o->flip_z;
    how.swap_angles = (uint32_t)o->swap_angles;
    if (sup_voxels_load(o->in, (uint32_t)o->threads, &how, &c->tree, NULL, &err)) return sup_bad_input(program, err.text);
    c->read_seconds = sup_now() - start;
    return 0;
}

/* ---- edits ---------------------------------------------------------------------------------------------------- */

/* The finish of what is set and painted from a line on: words, each with one number, or with three where there are red,
   green and blue; what is not named is 0, diffuse is 1. `plain`: none. Returns NULL, or what is wrong. */
static const char *edit_finish(const char *at, voxrt_finish *finish, int *has_finish) {
    static const struct { const char *name; size_t offset; int most; double largest; } words[] = {
        {"diffuse", offsetof(voxrt_finish, diffuse), 1, 1.0}, {"specular", offsetof(voxrt_finish, specular), 3, 1e12},
        {"shininess", offsetof(voxrt_finish, shininess), 1, 1e12}, {"mirror", offsetof(voxrt_finish, mirror), 3, 1.0},
        {"transparency", offsetof(voxrt_finish, transparency), 3, 1.0}, {"refraction", offsetof(voxrt_finish, refraction), 1, 16.0},
        {"absorption", offsetof(voxrt_finish, absorption), 3, 1e12}, {"emission", offsetof(voxrt_finish, emission), 3, 1e12}
    };
    static const char numbers[] = "one number or three, from 0 on, was expected";
    const char *end = at + strlen(at);
    int count = 0;
    memset(finish, 0, sizeof *finish);
    finish->diffuse = 1.0f;
    *has_finish = strcmp(at, "plain") != 0;
    if (!*has_finish) return NULL;
    for (; *at != '\0'; count++) {
        const size_t length = strcspn(at, " \t");
        float v[3] = {0.0f};
        size_t k = 0;
        int n = 0;
        while (k < sizeof words / sizeof *words && (strlen(words[k].name) != length || strncmp(at, words[k].name, length) != 0)) k++;
        if (k == sizeof words / sizeof *words)
            return "plain, diffuse, specular, shininess, mirror, transparency, refraction, absorption or emission was expected";
        at += length;
        for (; n < 4; n++) {
            double x = 0.0;
            while (supi_is_blank(*at)) at++;
            if (*at == '\0' || (*at >= 'a' && *at <= 'z')) break;
            if (n == 3 || sup_parse_double(&at, end, &x) || !(x >= 0.0)) return numbers;
            if (!(x <= words[k].largest)) return "the number is too large";
            v[n] = (float)x;
        }
        if (n != 1 && n != words[k].most) return words[k].most == 1 ? "one number was expected" : numbers;
        if (n == 1) v[1] = v[2] = v[0];
        memcpy((char *)finish + words[k].offset, v, (size_t)words[k].most * sizeof *v);
    }
    return count != 0 ? NULL : "what the finish is was expected";
}

typedef struct editing {
    voxrt_model *model, *before; /* before: as it was before the last line, or NULL */
    voxrt_finish finish;
    int has_finish;
} editing;

/* One line of --edit, without blanks at its ends, done to e->model. Returns NULL, or what is wrong; reason: room for that,
   as much as sup_error has. */
static const char *edit_line(const char *line, const voxrt_env *env, editing *e, voxrt_edit_stats *stats, char *reason) {
    static const char *const ops[3] = {"set", "clear", "paint"};
    voxrt_edit_desc desc = {0};
    voxrt_result result = VOXRT_OK;
    char op[16] = "", shape[16] = "";
    double v[9] = {0.0};
    const char *at, *end;
    int used = 0, n = 0, k, count;
    if (sscanf(line, "%15s %15s %n", op, shape, &used) < 1) return NULL;
    if (strcmp(op, "undo") == 0 && shape[0] == '\0') {
        if (!e->before) return "there is nothing to undo";
        voxrt_model_destroy(e->model);
        e->model = e->before;
        e->before = NULL;
        return NULL;
    }
    if (strcmp(op, "finish") == 0) {
        for (at = line + strlen(op); supi_is_blank(*at);) at++;
        return edit_finish(at, &e->finish, &e->has_finish);
    }
    for (k = 0; k < 3 && strcmp(op, ops[k]) != 0;) k++;
    if (k == 3) return "set, clear, paint, finish or undo was expected";
    desc.env = *env;
    desc.op = (voxrt_edit_op)k;
    if (e->has_finish && desc.op != VOXRT_EDIT_CLEAR) desc.finish = &e->finish;
    voxrt_model_destroy(e->before);
    e->before = NULL;
    if (voxrt_model_copy(env, e->model, &e->before) != VOXRT_OK) return "out of memory";
    if (strcmp(shape, "mesh") == 0) {
        sup_mesh mesh = {0};
        sup_error err;
        voxrt_mesh in;
        if (line[used] == '\0') return "the name of a mesh was expected";
        if (sup_mesh_read(line + used, &mesh, &err)) {
            (void)snprintf(reason, sizeof err.text, "%s", err.text);
            return reason;
        }
        in = sup_voxel_mesh(&mesh);
        result = voxrt_model_mesh(e->model, &desc, &in, stats);
        sup_mesh_free(&mesh);
        return result == VOXRT_OK ? NULL : voxrt_result_string(result);
    }
    if (strcmp(shape, "box") != 0 && strcmp(shape, "sphere") != 0) return "box, sphere or mesh was expected";
    for (at = line + used, end = at + strlen(at); n < 9; n++) {
        while (supi_is_space(*at)) at++;
        if (*at == '\0') break;
        if (sup_parse_double(&at, end, &v[n])) return "a number was expected";
    }
    while (supi_is_space(*at)) at++;
    count = shape[0] == 'b' ? 6 : 4;
    if (*at != '\0' || n != count + (desc.op == VOXRT_EDIT_CLEAR ? 0 : 3)) return "this is another count of numbers";
    for (k = 0; k < 3; k++) {
        const double c = v[count + k];
        if (desc.op != VOXRT_EDIT_CLEAR && !(c >= 0.0 && c <= 255.0)) return "colours are 0 to 255";
        desc.rgb[k] = (uint8_t)(desc.op == VOXRT_EDIT_CLEAR ? 0.0 : c);
    }
    result = shape[0] == 'b' ? voxrt_model_box(e->model, &desc, v, v + 3, stats) : voxrt_model_sphere(e->model, &desc, v, v[3], stats);
    return result == VOXRT_OK ? NULL : voxrt_result_string(result);
}

/* What --edit says. Returns 0 or the exit status. */
static int edit(const char *program, const convert_options *o, const voxrt_env *env, converted *c) {
    const double start = sup_now();
    editing e = {0};
    voxrt_build_desc desc = {0};
    voxrt_tree_info info;
    voxrt_result result;
    char *text = NULL, *line, *next;
    const char *what = NULL;
    char reason[sizeof(((sup_error *)0)->text)];
    size_t size;
    int number = 0;
    sup_error err;
    if (!o->edit) return 0;
    if (sup_read_file(o->edit, &text, &size, &err)) return sup_bad_input(program, err.text);
    result = voxrt_model_from_tree(env, c->tree, &e.model);
    if (memchr(text, '\0', size)) what = "the file is not text";
    for (line = text; result == VOXRT_OK && !what && line < text + size; line = next) {
        voxrt_edit_stats stats = {0};
        size_t length = strcspn(line, "\r\n"); /* there is a 0 behind a file */
        next = line + length;
        if (next[0] == '\r' && next[1] == '\n') next++;
        next += *next != '\0';
        number++;
        line[length] = '\0';
        line[strcspn(line, "#")] = '\0';
        line += strspn(line, " \t");
        for (length = strlen(line); length > 0 && supi_is_blank(line[length - 1]);) line[--length] = '\0';
        if (length == 0) continue;
        if (length > 4000) what = "the line is too long";
        else what = edit_line(line, env, &e, &stats, reason);
        c->edited++;
        c->edits.filled += stats.filled;
        c->edits.cleared += stats.cleared;
        c->edits.painted += stats.painted;
        c->edits.blocks += stats.blocks;
    }
    SUP_FREE(text);
    if (what && number == 0) (void)sup_fail(&err, "%s: %s", o->edit, what);
    else if (what) (void)sup_fail(&err, "%s: line %d: %s", o->edit, number, what);
    c->edit_seconds = sup_now() - start;
    if (result == VOXRT_OK && !what) {
        voxrt_tree_get_info(c->tree, &info);
        desc.spread = info.has_spread;
        voxrt_tree_destroy(c->tree);
        c->tree = NULL;
        desc.env = *env;
        desc.palette_size = (uint32_t)o->palette;
        desc.lod_method = o->lod ? VOXRT_LOD_MAJORITY : VOXRT_LOD_MEAN;
        result = voxrt_tree_from_model(&desc, e.model, &c->tree);
    }
    voxrt_model_destroy(e.model);
    voxrt_model_destroy(e.before);
    if (what) return sup_bad_input(program, err.text);
    return result == VOXRT_OK ? 0 : bad_result(program, o, result, env->error);
}

/* Equal parts once, or not, as was asked for. Returns 0 or the exit status. */
static int share(const char *program, const convert_options *o, const voxrt_env *env, converted *c) {
    const double start = sup_now();
    voxrt_tree *before = c->tree;
    voxrt_tree_info info;
    voxrt_result result;
    voxrt_tree_get_info(before, &info);
    if (info.shared == (uint32_t)o->share) return 0;
    result = o->share ? voxrt_tree_share(before, env, &c->tree) : voxrt_tree_unshare(before, env, &c->tree);
    voxrt_tree_destroy(before);
    c->build_seconds += sup_now() - start;
    return result == VOXRT_OK ? 0 : bad_result(program, o, result, env->error);
}

int main(int argc, char **argv) {
    convert_options o;
    converted c = {0};
    voxrt_env env = {0};
    voxrt_error error = {VOXRT_OK, 0, ""};
    sup_error err;
    double start;
    int status = parse(argc, argv, &o);
    if (status >= 0) return status;
    env.thread_count = (uint32_t)o.threads;
    env.memory_limit = sup_memory_limit();
    env.error = &error;
    status = o.voxels ? reopen(argv[0], &o, &c) : build(argv[0], &o, &env, &c);
    if (!status) status = edit(argv[0], &o, &env, &c);
    if (!status && c.tree != NULL) {
        voxrt_tree_info info;
        voxrt_tree_get_info(c.tree, &info);
        c.had_finishes |= info.finish_count != 0;
        c.had_planes = info.has_planes || info.has_spread;
    }
    if (!status && c.tree != NULL) status = share(argv[0], &o, &env, &c);
    if (status) {
        voxrt_tree_destroy(c.tree);
        return status;
    }
    if (c.had_finishes && o.format == FORMAT_V4 && !o.quiet)
        sup_warn(argv[0], "files of format 4 have colours only: mirrors, glass and other finishes are left out");
    if (c.had_planes && o.format == FORMAT_V4 && !o.quiet)
        sup_warn(argv[0], "files of format 4 have cubes with one normal: planes and spread are left out");
    start = sup_now();
    if (c.tree != NULL) status = write_out(&o, &env, c.tree, &err);
    c.write_seconds = sup_now() - start;
    if (!status && o.stats) print_stats(&o, &c);
    voxrt_tree_destroy(c.tree);
    return status ? sup_bad_input(argv[0], err.text) : 0;
}
