/* zbufrand_render.c - scenes of up to 10^13 triangles -> picture
   SPDX-License-Identifier: MIT OR Unlicense */
#include "support/mesh.h"
#include "support/picture.h"
#define ZBUFRAND_IMPLEMENTATION
#include "zbufrand.h"
#include "support/worlds.h"

enum { MODE_PIXEL, MODE_BLOCKS, MODE_GAUSS, MODE_VORONOI, MODE_NODEPTH, MODE_PULLPUSH, MODE_REGIONS, MODE_LAYERS };

typedef struct options {
    sup_common common;
    const char *scene, *hybrid, *opacity;
    int64_t block, mean, view, frame, frames, scatter, max_frames, classes;
    int64_t grid, leaf, aa, points, buckets, reach, memory;
    double noise, density, gauss, epsilon, smooth, contrast, depth_tolerance, color_tolerance, projected_tolerance, angle_ratio, clip, zone,
        leaf_ratio;
    float material[16]; /* opacities */
    int mode, has_mode, has_block, occlusion, has_occlusion, has_noise, has_gauss, no_repair, no_occlusion, independent, structure, has_structure,
        comb, corners, has_contrast, average, drop_back, thesis, block_planes, mend, strict, paint_triangles, measure_costs;
} options;

typedef struct pictures {
    zbufrand_image image;
    zbufrand_stats stats;
    double seconds;
} pictures;

static int is_world(const char *name) {
    static const char *const names[] = {"forest", "city", "city-small", "city-low", "chess", "landscape"};
    for (size_t i = 0; i < sizeof names / sizeof names[0]; i++)
        if (strcmp(name, names[i]) == 0) return 1;
    return 0;
}

/* Options that are nothing without another one, or say the same thing twice. Returns what parse returns. */
static int check_options(const char *program, const options *o) {
    if (o->scatter && is_world(o->scene)) return sup_bad_usage(program, "--scatter is for mesh files");
    if (o->view && !is_world(o->scene)) return sup_bad_usage(program, "--view: mesh files bring no cameras along");
    if (o->density > 0.0 && o->common.has_tolerance) return sup_bad_usage(program, "--density or --tolerance, not both");
    if (o->mean > 0 && o->has_noise) return sup_bad_usage(program, "--mean or --noise, not both");
    if (o->max_frames > 0 && !o->has_noise) return sup_bad_usage(program, "--max-frames goes with --noise");
    if (o->has_gauss && o->mode != MODE_GAUSS && o->mode != MODE_REGIONS) return sup_bad_usage(program, "--gauss goes with --mode gauss or regions");
    if (o->epsilon > 0.0 && !o->thesis && o->structure == 0)
        return sup_bad_usage(program, "--epsilon goes with one of the thesis' trees: --structure or --thesis");
    if (o->mean == 0 && (o->average != 0 || o->has_contrast)) return sup_bad_usage(program, "--average and --contrast go with --mean");
    if (o->smooth > 0.0 && o->average != (int)ZBUFRAND_ACCUMULATE_SMOOTH) return sup_bad_usage(program, "--smooth goes with --average smooth");
    if (o->mode == MODE_LAYERS && (o->mean > 0 || o->has_noise || o->frames > 0 || o->has_structure || o->thesis || o->common.depth))
        return sup_bad_usage(program, "--mode layers is one picture by the default tree, without --depth");
    if ((o->depth_tolerance > 0.0 || o->color_tolerance > 0.0 || o->drop_back) && o->mode < MODE_GAUSS)
        return sup_bad_usage(program, "--depth-tolerance, --color-tolerance, --drop-back: for --mode gauss, voronoi, nodepth, pullpush, regions, layers");
    if (o->projected_tolerance > 0.0 && o->mode < MODE_GAUSS)
        return sup_bad_usage(program, "--projected-tolerance: for --mode gauss, voronoi, nodepth, pullpush, regions");
    if (o->reach > 0 && o->mode < MODE_GAUSS) return sup_bad_usage(program, "--reach: for --mode gauss, voronoi, nodepth, pullpush, regions");
    if (o->aa > 1 && (o->mode == MODE_LAYERS || o->points > 0)) return sup_bad_usage(program, "--aa goes without --mode layers and --points");
    if (o->points > 0 && (o->mode == MODE_LAYERS || o->mean > 0 || o->has_noise || o->frames > 0 || o->opacity || o->paint_triangles))
        return sup_bad_usage(program, "--points is one picture, without layers, materials and triangles");
    if (o->buckets > 0 && o->points == 0) return sup_bad_usage(program, "--buckets goes with --points");
    if ((o->angle_ratio > 0.0 || o->clip > 0.0 || o->leaf > 0 || o->leaf_ratio > 0.0 || o->corners) && !o->thesis && o->structure == 0)
        return sup_bad_usage(program, "--angle-ratio, --clip, --leaf, --leaf-ratio and --corners go with one of the thesis' trees");
    if (o->grid > 0 && o->structure != (int)ZBUFRAND_STRUCTURE_CLASSES) return sup_bad_usage(program, "--normal-grid goes with --structure classes");
    if (o->zone > 0.0 && o->structure != (int)ZBUFRAND_STRUCTURE_OCTREE && o->structure != (int)ZBUFRAND_STRUCTURE_NORMALS)
        return sup_bad_usage(program, "--zone goes with --structure octree or normals");
    if (o->classes > 0 && o->structure < (int)ZBUFRAND_STRUCTURE_CLASSES)
        return sup_bad_usage(program, "--angle-depth goes with --structure classes or normals");
    if (o->frames && (!o->common.out || o->common.depth || o->mean))
        return sup_bad_usage(program, "--frames needs --out, and goes without --depth and --mean");
    if (o->common.has_tolerance && !(o->common.tolerance > 0.0 && o->common.tolerance < 1.0))
        return sup_bad_usage(program, "--tolerance is a probability: between 0 and 1");
    return -1;
}

/* --paint-triangles */
static void paint_triangles(void *user, const zbufrand_surface *s, size_t count, float *rgba) {
    (void)user;
    for (size_t i = 0; i < count; i++) {
        uint32_t h = (s[i].node * 0x9e3779b9u ^ s[i].triangle) * 0x85ebca6bu;
        h = (h ^ h >> 13) * 0xc2b2ae35u;
        for (uint32_t k = 0; k < 3; k++)
            rgba[4 * i + k] = s[i].triangle == ~0u ? 0.2f : 0.05f + 0.9f * (float)(h >> 8 * k & 255u) / 255.0f;
        rgba[4 * i + 3] = 1.0f;
    }
}

/* Writes the options into a table of room for OPTIONS; returns how many there are. */
static size_t option_table(options *o, sup_option *table) {
    size_t n = sup_common_options(&o->common, table);
    sup_option_help(table, n, "size", "pixels of the picture (1312x640)");
    sup_option_help(table, n, "fov", "vertical angle of view, degrees (40, or that of the view)");
    sup_option_help(table, n, "tolerance", "probability that a picture is incomplete (0.05)");
    sup_option_help(table, n, "quiet", "no progress and no warnings");
    table[n++] = sup_opt_text("scene", &o->scene, "forest|city|chess|landscape|FILE", "what to draw; FILE is a mesh");
    table[n++] = sup_opt_given(sup_opt_choice("mode", &o->mode, "pixel|blocks|gauss|voronoi|nodepth|pullpush|regions|layers",
                                              "from samples to pixels (pixel)"), &o->has_mode);
    table[n++] = sup_opt_given(sup_opt_int("block", &o->block, 1, 1024, "D", "edge of blocks, cells or squares in pixels"),
                               &o->has_block);
    table[n++] = sup_opt_text("hybrid", &o->hybrid, "auto|off|large|all|RADIUS",
                              "which triangles are rasterised: the cheaper way (auto), few, all, those near the eye");
    table[n++] = sup_opt_int("mean", &o->mean, 0, 65536, "N", "mean of N frames");
    table[n++] = sup_opt_given(sup_opt_real("noise", &o->noise, 1e-6, 1.0, "RMSE", "frames until the noise is below it"),
                               &o->has_noise);
    table[n++] = sup_opt_int("max-frames", &o->max_frames, 1, 65536, "N", "at most so many frames for --noise (256)");
    table[n++] = sup_opt_real("density", &o->density, 1e-3, 1e4, "L", "samples per pixel instead of --tolerance");
    table[n++] = sup_opt_given(sup_opt_choice("occlusion", &o->occlusion, "blocks|cells|squares|squares-all",
                                              "which samples count as seen"), &o->has_occlusion);
    table[n++] = sup_opt_given(sup_opt_real("gauss", &o->gauss, 0.1, 256.0, "C",
                                            "radius of the Gaussian in pixels (2, or D; 3 in squares of 2)"), &o->has_gauss);
    table[n++] = sup_opt_flag("no-repair", &o->no_repair, "no rays for empty and suspicious pixels");
    table[n++] = sup_opt_flag("no-occlusion", &o->no_occlusion, "draw what is hidden, too");
    table[n++] = sup_opt_flag("independent", &o->independent, "independent samples instead of stratified ones");
    table[n++] = sup_opt_flag("comb", &o->comb, "all samples of a draw at the same place of their strata");
    table[n++] = sup_opt_int("view", &o->view, 1, SUP_WORLD_VIEWS, "K", "one of the cameras that a scene brings along (1)");
    table[n++] = sup_opt_int("frame", &o->frame, 0, 65535, "K", "other random numbers of the same kind");
    table[n++] = sup_opt_int("frames", &o->frames, 1, 100000, "N", "N pictures NAME_0000.png and on: balloons fly by, a mesh turns");
    table[n++] = sup_opt_int("scatter", &o->scatter, 1, 6, "K", "10^K copies of the mesh on a plain");
    table[n++] = sup_opt_given(sup_opt_choice("structure", &o->structure, "default|fair|octree|classes|normals",
                                              "tree that is drawn from: the default, or one of the thesis"),
                               &o->has_structure);
    table[n++] = sup_opt_int("angle-depth", &o->classes, 1, 8, "N", "classes of normals of those: levels of halving (4)");
    table[n++] = sup_opt_real("epsilon", &o->epsilon, 1.001, 1000.0, "E", "how unequal depths they draw as one (1.5)");
    table[n++] = sup_opt_text("opacity", &o->opacity, "A[,A...]", "of materials 0, 1, ...: by chance in a frame, so with --mean or --noise");
    table[n++] = sup_opt_choice("average", &o->average, "mean|smooth|adaptive", "what --mean does with its frames (mean)");
    table[n++] = sup_opt_real("smooth", &o->smooth, 1e-3, 1.0, "E", "weight of a new frame for --average smooth (0.1)");
    table[n++] = sup_opt_given(sup_opt_real("contrast", &o->contrast, -1.0, 1e6, "G", "the mean times that; -1: over frames that hit a pixel"),
                               &o->has_contrast);
    table[n++] = sup_opt_real("depth-tolerance", &o->depth_tolerance, 0.0, 100.0, "T", "modes without depth buffer: samples that much deeper stay, too");
    table[n++] = sup_opt_real("color-tolerance", &o->color_tolerance, 0.0, 10.0, "T", "... and those whose colour differs from the nearest by at most that");
    table[n++] = sup_opt_flag("drop-back", &o->drop_back, "... but none that are seen from behind");
    table[n++] = sup_opt_real("projected-tolerance", &o->projected_tolerance, 0.0, 1e6, "T",
                              "... and those deeper by that on f z / (f + z), f the focal length in pixels");
    table[n++] = sup_opt_int("reach", &o->reach, 1, 65535, "R", "fills: no further than that from a sample (2 D)");
    table[n++] = sup_opt_flag("block-planes", &o->block_planes, "blocks follow the plane of their surface, so that parallel ones do not bleed");
    table[n++] = sup_opt_flag("mend", &o->mend, "empty and suspicious pixels from their neighbours instead of by rays");
    table[n++] = sup_opt_int("aa", &o->aa, 1, 16, "K", "draw it K times as wide and high; pixels are means of K x K");
    table[n++] = sup_opt_int("points", &o->points, 1, 100000000, "N", "N random points of the surface, as a point cloud, instead of the scene");
    table[n++] = sup_opt_int("buckets", &o->buckets, 1, 22, "B", "... whose depths are as good as equal within 2^-B of the depth");
    table[n++] = sup_opt_flag("paint-triangles", &o->paint_triangles, "each triangle in a colour of its own, stored points grey");
    table[n++] = sup_opt_flag("strict", &o->strict, "degenerate triangles are an error");
    table[n++] = sup_opt_int("memory", &o->memory, 1, 1 << 20, "MIB", "most memory of the scene, and of drawing it");
    table[n++] = sup_opt_real("leaf-ratio", &o->leaf_ratio, 1.0, 1e6, "R", "thesis' trees: how much wider than its largest object a leaf may be");
    table[n++] = sup_opt_flag("measure-costs", &o->measure_costs,
                              "what raster and samples cost on this machine decides; pictures differ between machines then");
    table[n++] = sup_opt_real("angle-ratio", &o->angle_ratio, 1.001, 1000.0, "E", "thesis' trees: how unequal angles they draw as one");
    table[n++] = sup_opt_real("clip", &o->clip, 1e-3, 1000.0, "C", "thesis' trees: divide what sticks out and is wider than C times its depth");
    table[n++] = sup_opt_int("normal-grid", &o->grid, 1, 64, "K", "classes of normals: a grid of K x 2K");
    table[n++] = sup_opt_int("leaf", &o->leaf, 1, 1024, "N", "thesis' trees: most objects of a leaf (64)");
    table[n++] = sup_opt_real("zone", &o->zone, 1.0, 2.0, "C", "octree: a cell takes what lies within it enlarged by that (1.5)");
    table[n++] = sup_opt_flag("corners", &o->corners, "thesis' trees: corners of triangles below half a pixel instead of points in them");
    table[n++] = sup_opt_flag("thesis", &o->thesis, "as the thesis' program did; other options change parts of that");
    return n;
}

/* What the options without words or lists of their own say, into desc and build. */
static void describe(const options *o, zbufrand_render_desc *desc, zbufrand_build_desc *build) {
    memset(desc, 0, sizeof *desc);
    memset(build, 0, sizeof *build);
    if (o->thesis) zbufrand_preset_thesis(build, desc);
    if (o->has_structure) build->structure = (zbufrand_structure)o->structure;
    build->normal_depth = (uint32_t)o->classes;
    build->normal_grid = (uint32_t)o->grid;
    if (o->leaf > 0) build->leaf_objects = (uint32_t)o->leaf;
    build->tolerance_zone = (float)o->zone;
    build->leaf_ratio = (float)o->leaf_ratio;
    build->strict = (uint32_t)o->strict;
    build->ids = (uint32_t)o->paint_triangles;
    desc->angle_ratio = o->angle_ratio;
    desc->clip_ratio = o->clip;
    desc->reconstruct.tolerance = (float)o->depth_tolerance;
    desc->reconstruct.tolerance_color = (float)o->color_tolerance;
    desc->reconstruct.drop_back = (uint32_t)o->drop_back;
    desc->reconstruct.tolerance_projected = (float)o->projected_tolerance; /* focal: with the camera */
    desc->reconstruct.reach = (uint32_t)o->reach;
    desc->reconstruct.plane_depth = (uint32_t)o->block_planes;
    desc->reconstruct.repair = (uint32_t)o->mend;
    desc->oversample = (uint32_t)o->aa;
    if (o->paint_triangles) desc->shade_fn = paint_triangles;
    if (o->epsilon > 0.0) desc->depth_ratio = o->epsilon;
    desc->tolerance = o->common.has_tolerance ? o->common.tolerance : 0.0; /* 0: the library chooses */
    desc->density = o->density;
    desc->noise = o->noise;
    desc->max_frames = (uint32_t)o->max_frames;
    desc->frame = (uint32_t)o->frame;
    desc->seed = (uint32_t)o->common.seed;
    desc->no_repair |= (uint32_t)(o->no_repair || o->mend);
    desc->no_occlusion |= (uint32_t)o->no_occlusion;
    desc->independent |= (uint32_t)o->independent;
    desc->unlit = (uint32_t)o->common.unlit;
    desc->comb = (uint32_t)o->comb;
    desc->corners = (uint32_t)o->corners;
    if (o->has_block || !o->thesis || o->has_mode)
        desc->reconstruct.block = o->has_block ? (uint32_t)o->block : o->mode == MODE_PIXEL ? 1u : 2u;
    if (o->has_gauss) desc->reconstruct.gauss_radius = (float)o->gauss;
}

/* --mode and --occlusion. Returns what parse returns. */
static int set_mode(const char *program, const options *o, zbufrand_render_desc *desc) {
    if (o->mode == MODE_PIXEL && desc->reconstruct.block > 1 && o->has_mode)
        return sup_bad_usage(program, "--mode pixel has no blocks: use --mode blocks");
    switch (o->mode) {
    case MODE_GAUSS: desc->reconstruct.fill = ZBUFRAND_FILL_GAUSS; break;
    case MODE_VORONOI: desc->reconstruct.fill = ZBUFRAND_FILL_VORONOI; break;
    case MODE_NODEPTH: desc->reconstruct.fill = ZBUFRAND_FILL_VORONOI_L1; break;
    case MODE_PULLPUSH: desc->reconstruct.fill = ZBUFRAND_FILL_PULL_PUSH; break;
    case MODE_REGIONS: desc->reconstruct.fill = ZBUFRAND_FILL_REGIONS; break;
    case MODE_LAYERS: /* counts of samples: nothing rastered, nothing painted over */
        memset(&desc->reconstruct, 0, sizeof desc->reconstruct);
        desc->hybrid = ZBUFRAND_HYBRID_OFF;
        if (!(desc->density > 0.0)) desc->density = 8.0;
        return -1;
    default: break;
    }
    if (o->mode >= MODE_GAUSS) {
        desc->reconstruct.occlusion = ZBUFRAND_OCCLUSION_SQUARES;
    }
    if (o->has_occlusion) desc->reconstruct.occlusion = (zbufrand_occlusion)o->occlusion;
    return -1;
}

/* --opacity A[,A...]. Returns what parse returns. */
static int set_opacity(const char *program, options *o, zbufrand_render_desc *desc) {
    const char *at = o->opacity, *end = at + strlen(at);
    double a;
    for (;;) {
        if (desc->opacity_count == sizeof o->material / sizeof o->material[0] || sup_parse_double(&at, end, &a) || !(a >= 0.0 && a <= 1.0))
            return sup_bad_usage(program, "--opacity: \"%s\" is no list of up to 16 numbers from 0 to 1", o->opacity);
        o->material[desc->opacity_count++] = (float)a;
        if (at == end) break;
        if (*at++ != ',') at = end; /* a number is missing there */
    }
    desc->opacity = o->material;
    return -1;
}

/* --hybrid auto|off|large|all|RADIUS. Returns what parse returns. */
static int set_hybrid(const char *program, const char *text, zbufrand_render_desc *desc) {
    static const struct { const char *name; zbufrand_hybrid hybrid; } words[] = {
        {"auto", ZBUFRAND_HYBRID_AUTO}, {"off", ZBUFRAND_HYBRID_OFF}, {"large", ZBUFRAND_HYBRID_LARGE}, {"all", ZBUFRAND_HYBRID_ALL}};
    const char *at = text, *end = at + strlen(at);
    double radius = 0.0;
    for (size_t i = 0; i < sizeof words / sizeof words[0]; i++)
        if (strcmp(text, words[i].name) == 0) {
            desc->hybrid = words[i].hybrid;
            return -1;
        }
    if (sup_parse_double(&at, end, &radius) || at != end || !(radius >= 0.0))
        return sup_bad_usage(program, "--hybrid: \"%s\" is not auto, off, large, all or a radius", text);
    desc->hybrid = ZBUFRAND_HYBRID_CUBE;
    desc->hybrid_radius = radius;
    return -1;
}

/* Reads the command line. Returns -1 to go on, or the exit status. */
static int parse(int argc, char **argv, options *o, zbufrand_render_desc *desc, zbufrand_build_desc *build) {
    sup_option table[SUP_COMMON_OPTIONS + 50];
    int status;
    memset(o, 0, sizeof *o);
    status = sup_cli_parse(argc, argv, "Draws a scene from random points of its surface.", table, option_table(o, table));
    if (status >= 0) return status;
    if (!o->scene) return sup_bad_usage(argv[0], "--scene is missing");
    status = sup_out_check(argv[0], &o->common);
    if (status >= 0) return status;
    status = check_options(argv[0], o);
    if (status >= 0) return status;
    describe(o, desc, build);
    status = set_mode(argv[0], o, desc);
    if (status >= 0 || o->mode == MODE_LAYERS) return status;
    if (o->opacity) status = set_opacity(argv[0], o, desc);
    if (status < 0 && o->hybrid) status = set_hybrid(argv[0], o->hybrid, desc);
    return status;
}

/* ---- scenes ------------------------------------------------------------------------------------------------- */

/* A mesh file as it is, or 10^K copies of it scattered over a plain. turning: the mesh if pictures of it as it turns are
   wanted: it has a structure of its own then, so that it is never taken apart and put together to be moved. */
static int make_mesh_scene(const options *o, const zbufrand_scene_desc *desc, const zbufrand_build_desc *build, sup_world *world,
                           zbufrand_scene_info *info, zbufrand_node *turning, zbufrand_error *error, sup_error *err) {
    const int turns = o->frames > 0 && !o->scatter;
    supi_make make;
    zbufrand_node node;
    float lo[3], hi[3];
    memset(world, 0, sizeof *world);
    memset(&make, 0, sizeof make);
    if (sup_mesh_read(o->scene, &make.mesh, err)) return 1;
    if (err->text[0] && !o->common.quiet) fprintf(stderr, "warning: %s\n", err->text);
    if (make.mesh.normals == NULL && sup_mesh_compute_normals(&make.mesh, err)) {
        sup_mesh_free(&make.mesh);
        return 1;
    }
    (void)sup_mesh_bounds(&make.mesh, lo, hi);
    if (zbufrand_scene_create(desc, &world->scene) != ZBUFRAND_OK) world->failed = 1;
    node = supi_world_mesh(world, &make, ZBUFRAND_ROOT, 1, 0, o->scatter ? ZBUFRAND_HIDDEN : turns ? ZBUFRAND_OWN_STRUCTURE : 0);
    if (turns) *turning = node;
    if (o->scatter && !world->failed) {
        const double wide = hi[0] - lo[0] > hi[2] - lo[2] ? (double)(hi[0] - lo[0]) : (double)(hi[2] - lo[2]);
        size_t count = 1, side = 1;
        zbufrand_transform *t;
        supi_rng rng = {12345};
        for (int64_t k = 0; k < o->scatter; k++) count *= 10;
        while (side * side < count) side++;
        t = supi_world_array(world, count);
        for (size_t i = 0; i < count && t; i++) {
            const double x = (double)(i % side) + 0.3 * ((double)supi_random(&rng) - 0.5);
            const double z = (double)(i / side) + 0.3 * ((double)supi_random(&rng) - 0.5);
            t[i] = supi_world_place(1.6 * wide * (x - 0.5 * (double)side), 0.0, 1.6 * wide * (z - 0.5 * (double)side),
                                    6.2831853 * (double)supi_random(&rng), 1.0);
        }
        if (t && zbufrand_add_references(world->scene, ZBUFRAND_ROOT, t, count, node, NULL) != ZBUFRAND_OK)
            world->failed = 2;
    }
    if (!world->failed && zbufrand_scene_build(world->scene, build, info) == ZBUFRAND_OK) return 0;
    return sup_fail(err, "%s: %s", o->scene, error->text[0] ? error->text : "cannot be built");
}

static void set_camera(const options *o, const sup_world *world, const zbufrand_scene_info *info,
                       zbufrand_camera *camera) {
    sup_camera framed;
    float lo[3], hi[3];
    const size_t view = o->view ? (size_t)o->view - 1 : 0;
    for (int k = 0; k < 3; k++) {
        lo[k] = (float)info->box_min[k];
        hi[k] = (float)info->box_max[k];
    }
    sup_common_camera(&o->common, lo, hi, &framed);
    if (view < world->view_count && !o->common.has_eye && !o->common.has_at) {
        memcpy(framed.eye, world->views[view].eye, sizeof framed.eye);
        memcpy(framed.at, world->views[view].at, sizeof framed.at);
        if (!o->common.has_fov) framed.fov = world->views[view].fov;
    }
    for (int k = 0; k < 3; k++) {
        camera->eye[k] = (double)framed.eye[k];
        camera->at[k] = (double)framed.at[k];
        camera->up[k] = (double)framed.up[k];
    }
    camera->fov_y = (double)framed.fov;
}

/* Out of doors it is morning: a low warm sun, blue light from above, a pale sky. Everything else has the library's lights. */
static void set_morning(const options *o, zbufrand_render_desc *desc) {
    static const zbufrand_light morning[3] = {{{-0.6, 0.5, 0.62}, 1, {1.25f, 1.0f, 0.68f}},
                                              {{0.1, 1.0, -0.1}, 1, {0.26f, 0.36f, 0.52f}},
                                              {{0.7, 0.2, 0.5}, 1, {0.16f, 0.18f, 0.2f}}};
    static const float ambient[3] = {0.16f, 0.19f, 0.22f}, sky[4] = {0.48f, 0.63f, 0.83f, 1.0f};
    if (!is_world(o->scene) || strcmp(o->scene, "chess") == 0 || o->thesis) return;
    desc->lights = morning;
    desc->light_count = sizeof morning / sizeof morning[0];
    memcpy(desc->ambient, ambient, sizeof ambient);
    memcpy(desc->background, sky, sizeof sky);
}

/* ---- pictures ----------------------------------------------------------------------------------------------- */

static double clock_now(void *user) {
    (void)user;
    return sup_now();
}

/* Bytes from linear, premultiplied floats. */
static void make_bytes(zbufrand_image *image) {
    const size_t pixels = (size_t)image->width * image->height;
    for (size_t i = 0; i < pixels; i++) {
        const float *c = image->rgba + 4 * i;
        for (size_t k = 0; k < 3; k++)
            image->rgba8[4 * i + k] = sup_unit_to_byte(zbufrandi_linear_to_srgb(c[3] > 0.0f ? (double)(c[k] / c[3]) : 0.0));
        image->rgba8[4 * i + 3] = sup_unit_to_byte((double)c[3]);
    }
}

/* The background behind linear, premultiplied colours. */
static void put_behind(zbufrand_image *image, const float background[4]) {
    const size_t pixels = (size_t)image->width * image->height;
    for (size_t i = 0; i < pixels; i++) {
        const float rest = 1.0f - image->rgba[4 * i + 3];
        for (size_t k = 0; k < 4; k++) image->rgba[4 * i + k] += rest * background[k];
    }
}

/* What several pictures took together, and what is true of each of them. */
static void add_stats(zbufrand_stats *sum, const zbufrand_stats *one, int64_t before) {
    const double n = (double)before;
    sum->triangles = one->triangles;
    sum->nodes += one->nodes;
    sum->tested += one->tested;
    sum->outside += one->outside;
    sum->facing_away += one->facing_away;
    sum->hidden += one->hidden;
    sum->instances += one->instances;
    for (int k = 0; k < 3; k++) sum->draws[k] += one->draws[k];
    for (int k = 0; k < 2; k++) sum->samples[k] += one->samples[k];
    sum->accepted += one->accepted;
    sum->rastered += one->rastered;
    sum->holes += one->holes;
    sum->wrong += one->wrong;
    sum->repaired += one->repaired;
    sum->density = one->density > sum->density ? one->density : sum->density;
    sum->projected_area = (n * sum->projected_area + one->projected_area) / (n + 1.0);
    sum->covered = one->covered > sum->covered ? one->covered : sum->covered;
    /* that no frame is right somewhere is at most as likely as that one of them is not */
    sum->incomplete = before == 0 || one->incomplete < sum->incomplete ? one->incomplete : sum->incomplete;
    for (int k = 0; k < ZBUFRAND_STAGE_COUNT; k++) sum->seconds[k] += one->seconds[k];
    sum->bytes = one->bytes;
}

/* --mean N: N frames with other random numbers each, averaged in linear light. */
static zbufrand_result draw_mean(const options *o, zbufrand_frame *frame, zbufrand_render_desc *desc,
                                 const zbufrand_scene *scene, zbufrand_image *image, zbufrand_stats *stats) {
    zbufrand_image one = *image;
    zbufrand_accumulator_desc ad;
    zbufrand_accumulator *sum = NULL;
    zbufrand_view view;
    float *depth = image->depth != NULL ? image->depth : (float *)sup_alloc((size_t)image->width * image->height, sizeof(float));
    zbufrand_result result;
    float background[4];
    uint32_t spread = 1;
    zbufrand_stats each;
    zbufrand_noise noise;
    memset(stats, 0, sizeof *stats);
    memset(&noise, 0, sizeof noise);
    memcpy(background, desc->background, sizeof background);
    if (o->has_contrast) memset(desc->background, 0, sizeof desc->background); /* empty pixels count as empty */
    memset(&ad, 0, sizeof ad);
    ad.env.thread_count = (uint32_t)o->common.threads;
    ad.width = image->width;
    ad.height = image->height;
    ad.mode = (zbufrand_accumulation)o->average;
    ad.epsilon = (float)o->smooth;
    result = depth != NULL ? zbufrand_accumulator_create(&ad, &sum) : ZBUFRAND_ERR_NO_MEMORY;
    if (result == ZBUFRAND_OK) result = zbufrand_camera_view(&desc->camera, scene, image->width, image->height, &view);
    while (2 * (int64_t)spread <= o->mean && spread < 64) spread *= 2;
    for (int64_t k = 0; k < o->mean && result == ZBUFRAND_OK; k++) {
        desc->frame = (uint32_t)(o->frame + k);
        desc->spread = o->average == 0 ? spread : 1;
        one.depth = k == 0 || o->average != 0 ? depth : NULL; /* depth is that of the first frame, or of the last */
        result = zbufrand_render(frame, desc, scene, &one, &each);
        add_stats(stats, &each, k);
        if (result == ZBUFRAND_OK) result = zbufrand_accumulator_add(sum, image->rgba, o->average != 0 ? depth : NULL, o->average != 0 ? &view : NULL);
    }
    if (result == ZBUFRAND_OK && o->mean > 1) result = zbufrand_accumulator_noise(sum, 0.0, &noise);
    if (result == ZBUFRAND_OK) result = zbufrand_accumulator_get(sum, (float)o->contrast, image->rgba);
    zbufrand_accumulator_destroy(sum);
    if (depth != image->depth) SUP_FREE(depth);
    if (result != ZBUFRAND_OK) return result;
    if (o->has_contrast) put_behind(image, background);
    make_bytes(image);
    stats->frames = (uint32_t)o->mean;
    stats->rmse = o->mean > 1 ? noise.rmse : 0.0;
    return ZBUFRAND_OK;
}

/* --mode layers: samples are counted by layers of depth, which cover as much of a pixel as their counts say. Colours are not lit. */
static int count_layers(void *user, const zbufrand_sample *samples, const uint32_t *numbers, size_t count) {
    (void)numbers;
    return zbufrand_layers_submit((zbufrand_layers *)user, samples, count) != ZBUFRAND_OK;
}
static zbufrand_result draw_layers(const options *o, zbufrand_frame *frame, const zbufrand_render_desc *desc,
                                   const zbufrand_scene *scene, zbufrand_image *image, zbufrand_stats *stats) {
    zbufrand_layers_desc ld;
    zbufrand_layers *layers = NULL;
    zbufrand_result result;
    memset(&ld, 0, sizeof ld);
    ld.env.thread_count = (uint32_t)o->common.threads;
    ld.width = image->width;
    ld.height = image->height;
    ld.density = (float)desc->density;
    ld.dispersion = desc->independent ? 1.0f : 0.4f;
    ld.tolerance = o->depth_tolerance > 0.0 ? (float)o->depth_tolerance : 0.02f; /* what a pixel of rough ground spans */
    result = zbufrand_layers_create(&ld, &layers);
    if (result != ZBUFRAND_OK) return result;
    do {
        result = zbufrand_sample_scene(frame, desc, scene, image->width, image->height, count_layers, layers, stats);
    } while (result == ZBUFRAND_OK && zbufrand_layers_next(layers));
    if (result == ZBUFRAND_OK) result = zbufrand_layers_resolve(layers, image->rgba, NULL);
    zbufrand_layers_destroy(layers);
    if (result != ZBUFRAND_OK) return result;
    put_behind(image, desc->background);
    make_bytes(image);
    return result;
}

/* --points: a point cloud that is random points of the surface, lit from the eye. */
static zbufrand_result draw_points(const options *o, const zbufrand_render_desc *desc, const zbufrand_scene *scene,
                                   zbufrand_image *image, zbufrand_stats *stats) {
    const size_t count = (size_t)o->points;
    float *position = (float *)sup_alloc(3 * count, sizeof(float)), *normal = (float *)sup_alloc(3 * count, sizeof(float));
    uint8_t *rgb = (uint8_t *)sup_alloc(3 * count, 1);
    zbufrand_sample *sample = (zbufrand_sample *)sup_alloc(count, sizeof *sample);
    zbufrand_surface_points_desc pd;
    zbufrand_canvas_desc cd;
    zbufrand_canvas *canvas = NULL;
    zbufrand_points points;
    zbufrand_view view;
    zbufrand_source source = {zbufrand_samples_shade, zbufrand_samples_surface, NULL};
    zbufrand_picture picture;
    zbufrand_submit_stats submitted = {0, 0, 0};
    zbufrand_resolve_stats resolved;
    zbufrand_result result = position && normal && rgb && sample ? ZBUFRAND_OK : ZBUFRAND_ERR_NO_MEMORY;
    memset(&pd, 0, sizeof pd);
    memset(&cd, 0, sizeof cd);
    memset(&points, 0, sizeof points);
    memset(&picture, 0, sizeof picture);
    pd.seed = desc->seed;
    pd.first = (uint64_t)desc->frame * count;
    pd.independent = desc->independent;
    pd.vertex_normals = 1;
    cd.env.thread_count = (uint32_t)o->common.threads;
    cd.isa = (zbufrand_isa)o->common.isa;
    cd.width = image->width;
    cd.height = image->height;
    cd.reconstruct = desc->reconstruct;
    cd.bucket_bits = (uint32_t)o->buckets;
    points.positions = position;
    points.normals = normal;
    points.rgb = rgb;
    points.count = count;
    picture.rgba = image->rgba;
    picture.depth = image->depth;
    source.user = sample;
    if (result == ZBUFRAND_OK) result = zbufrand_surface_points(scene, &pd, count, position, normal, rgb, NULL);
    if (result == ZBUFRAND_OK) result = zbufrand_camera_view(&desc->camera, scene, image->width, image->height, &view);
    if (result == ZBUFRAND_OK) result = zbufrand_project(&view, &points, 0, count, sample);
    if (result == ZBUFRAND_OK) result = zbufrand_canvas_create(&cd, &canvas);
    for (size_t i = 0; i < count && result == ZBUFRAND_OK && !desc->unlit; i++) {
        double toward = 0.0, length = 0.0;
        for (size_t k = 0; k < 3; k++) {
            const double v = desc->camera.eye[k] - (double)position[3 * i + k];
            toward += v * (double)normal[3 * i + k];
            length += v * v;
        }
        for (size_t k = 0; k < 3 && length > 0.0; k++) sample[i].rgb[k] *= 0.1f + 0.9f * (float)(fabs(toward) / sqrt(length));
    }
    if (result == ZBUFRAND_OK) result = zbufrand_canvas_submit(canvas, sample, count, 0, &submitted);
    if (result == ZBUFRAND_OK) result = zbufrand_canvas_resolve(canvas, &source, &picture, &resolved);
    zbufrand_canvas_destroy(canvas);
    SUP_FREE(position);
    SUP_FREE(normal);
    SUP_FREE(rgb);
    SUP_FREE(sample);
    if (result != ZBUFRAND_OK) return result;
    stats->points = count;
    stats->accepted = submitted.accepted;
    stats->covered = resolved.covered;
    stats->holes = resolved.holes;
    stats->wrong = resolved.wrong;
    put_behind(image, desc->background);
    make_bytes(image);
    return result;
}

static int write_pictures(const options *o, zbufrand_image *image, sup_error *err) {
    return sup_out_write(&o->common, image->rgba8, image->rgba, image->depth, image->width, image->height, err);
}

static void print_theory(const options *o, const zbufrand_stats *s) {
    static const char *const bounds[8] = {"union", "direct", "lemma2", "lemma3", "theorem1", "theorem2", "lemma4", "theorem5"};
    const double wanted = 1.0 - (o->common.has_tolerance ? o->common.tolerance : 0.05), seen = (double)s->covered, area = s->projected_area;
    const double samples = s->density * area;
    printf(",\"theory\":{");
    for (int k = 0; k < 8; k++) printf("\"%s\":%.6g,", bounds[k], zbufrand_samples((zbufrand_bound)k, area, seen, 1.0, wanted));
    printf("\"density\":%.6g,\"one_percent_empty\":%.6g,\"ten_empty\":%.6g,\"ten_empty_lemma2\":%.6g,", zbufrand_density(seen, 1.0, wanted),
           zbufrand_samples_for_share(area, 1.0, 0.01), seen > 10.0 ? zbufrand_samples_tolerant(area, seen, 10.0, wanted) : 0.0,
           seen > 10.0 ? zbufrand_samples_lemma2(seen, 10.0, wanted) : 0.0);
    printf("\"success\":%.6g,\"success_bound\":%.6g,\"empty\":%.6g,\"empty_deviation\":%.6g,\"empty_off_by_100\":%.6g,\"hit_twice\":%.6g}",
           zbufrand_success(s->density, seen, 1.0), zbufrand_success_bound(s->density, seen, 1.0), zbufrand_expected_holes(s->density, seen, 1.0),
           sqrt(zbufrand_holes_variance(samples, area)), zbufrand_holes_tail(samples, area, 100.0), zbufrand_multi_hit(samples, area));
}

static void print_stats(const options *o, const zbufrand_scene_info *info, const zbufrand_camera *camera,
                        const zbufrand_costs *costs, const pictures *p) {
    static const char *const stages[ZBUFRAND_STAGE_COUNT] = {"select", "draw", "occlusion", "repair", "shade"};
    const zbufrand_stats *s = &p->stats;
    const zbufrand_isa best = zbufrand_isa_best();
    zbufrand_isa wanted = (zbufrand_isa)o->common.isa;
    printf("{\"program\":\"zbufrand_render\",\"in\":");
    sup_json_string(stdout, o->scene);
    printf(",\"width\":%u,\"height\":%u,\"triangles\":%llu,\"stored_triangles\":%llu,\"bytes\":%llu", p->image.width,
           p->image.height, (unsigned long long)info->triangles, (unsigned long long)info->stored_triangles,
           (unsigned long long)info->bytes);
    if (info->list_objects) {
        printf(",\"list_objects\":%llu,\"list_nodes\":%llu,\"list_classes\":%llu,\"list_bytes\":%llu",
               (unsigned long long)info->list_objects, (unsigned long long)info->list_nodes,
               (unsigned long long)info->list_classes, (unsigned long long)info->list_bytes);
    }
    printf(",\"samples\":%llu,\"accepted\":%llu,\"rastered\":%llu,\"density\":%.6g,\"projected_area\":%.6g",
           (unsigned long long)(s->samples[0] + s->samples[1]), (unsigned long long)s->accepted,
           (unsigned long long)s->rastered, s->density, s->projected_area);
    printf(",\"nodes\":%llu,\"draws\":[%llu,%llu,%llu],\"hidden\":%llu,\"covered\":%llu", (unsigned long long)s->nodes,
           (unsigned long long)s->draws[0], (unsigned long long)s->draws[1], (unsigned long long)s->draws[2],
           (unsigned long long)s->hidden, (unsigned long long)s->covered);
    printf(",\"holes\":%llu,\"wrong\":%llu,\"repaired\":%llu", (unsigned long long)s->holes, (unsigned long long)s->wrong,
           (unsigned long long)s->repaired);
    if (o->aa > 1) printf(",\"aa\":%d", (int)o->aa);
    if (o->points > 0) printf(",\"points\":%llu", (unsigned long long)s->points);
    if (o->measure_costs)
        printf(",\"costs\":{\"triangle\":%.4g,\"edge\":%.4g,\"pixel\":%.4g,\"cluster\":%.4g,\"sample\":%.4g,\"set\":%.4g,\"stored\":%.4g,\"ray\":%.4g}",
               (double)costs->triangle, (double)costs->edge, (double)costs->pixel, (double)costs->cluster, (double)costs->sample,
               (double)costs->set, (double)costs->stored, (double)costs->ray);
    if (o->mode == MODE_LAYERS || o->points > 0) printf(",\"incomplete\":null,\"probability\":null"); /* nothing is promised of counts */
    else printf(",\"incomplete\":%.6g,\"probability\":%.9g", s->incomplete, 1.0 - s->incomplete);
    if (s->covered > 0 && s->projected_area >= (double)s->covered) print_theory(o, s); /* what it asks for, and leaves empty */
    printf(",\"frames\":%u,\"rmse\":%.6g,\"stages\":{", s->frames, s->rmse);
    for (int k = 0; k < ZBUFRAND_STAGE_COUNT; k++) printf("%s\"%s\":%.6f", k ? "," : "", stages[k], s->seconds[k]);
    printf("},\"eye\":[%.9g,%.9g,%.9g],\"at\":[%.9g,%.9g,%.9g]", camera->eye[0], camera->eye[1], camera->eye[2],
           camera->at[0], camera->at[1], camera->at[2]);
    if (wanted == ZBUFRAND_ISA_AUTO || wanted > best) wanted = best;
    printf(",\"seconds\":%.6f,\"isa\":\"%s\",\"threads\":%d}\n", p->seconds,
           zbufrand_isa_name(wanted),
           sup_threads(o->common.threads));
}

/* ---- moving pictures ---------------------------------------------------------------------------------------- */

enum { BALLOONS = 12, BALLOON_ROWS = 50 }; /* each of 10,000 triangles, and a basket */

typedef struct movement {
    zbufrand_node balloon[BALLOONS], model;
    zbufrand_node turning; /* a mesh that turns about its middle, once in all pictures; 0: there is none */
    double middle[3];
    double at[3], reach;
    double edit_seconds;
} movement;

static zbufrand_transform balloon_place(const movement *m, int i, double turn) {
    const double angle = 6.283185307179586 * ((double)i / BALLOONS + turn), size = 0.05 * m->reach;
    return supi_world_place(m->at[0] + 0.45 * m->reach * cos(angle), m->at[1] + (0.14 + 0.05 * sin(3.0 * angle)) * m->reach,
                            m->at[2] + 0.45 * m->reach * sin(angle), angle, size);
}

/* Balloons that fly in a ring before the camera. Every eighth picture one of them leaves and another one comes. */
static zbufrand_result move(movement *m, zbufrand_scene *scene, int64_t frame, int64_t frames) {
    zbufrand_result result = ZBUFRAND_OK;
    if (m->turning != 0) {
        zbufrand_transform turn = supi_world_place(m->middle[0], 0.0, m->middle[2], 6.283185307179586 * (double)frame / (double)frames, 1.0);
        for (int k = 0; k < 3; k++) turn.m[k][3] -= turn.m[k][0] * m->middle[0] + turn.m[k][2] * m->middle[2];
        result = zbufrand_move(scene, m->turning, &turn);
    }
    for (int i = 0; i < BALLOONS && result == ZBUFRAND_OK; i++) {
        const zbufrand_transform place = balloon_place(m, i, (double)frame / (double)frames);
        if (m->balloon[i] != 0 && frame % 8 == 7 && frame / 8 % BALLOONS == i) {
            result = zbufrand_remove(scene, m->balloon[i]);
            m->balloon[i] = 0;
        }
        if (result != ZBUFRAND_OK) break;
        result = m->balloon[i] != 0 ? zbufrand_move(scene, m->balloon[i], &place)
                                    : zbufrand_add_reference(scene, ZBUFRAND_ROOT, &place, m->model, &m->balloon[i]);
    }
    return result == ZBUFRAND_OK ? zbufrand_scene_update(scene, NULL) : result;
}

/* What flies: a striped balloon and its basket, put together in a list that joins the scene when all of it is there. */
static void make_balloon(movement *m, sup_world *world) {
    static const uint8_t stripes[2][3] = {{196, 44, 36}, {236, 226, 208}};
    static const float basket[2][3] = {{-0.2f, -1.75f, -0.2f}, {0.2f, -1.45f, 0.2f}};
    supi_make make;
    memset(&make, 0, sizeof make);
    if (!world->failed && zbufrand_add_list(world->scene, 0, NULL, ZBUFRAND_HIDDEN, &m->model) != ZBUFRAND_OK) world->failed = 2;
    supi_add_blob(&make, 0.0f, 0.0f, 0.0f, 1.0f, 2 * BALLOON_ROWS, BALLOON_ROWS, 0.0f, 1.0f, 1, 0.0f);
    for (size_t i = 0; i < make.mesh.triangle_count && !make.failed; i++) {
        make.mesh.triangle_rgb = (uint8_t *)sup_grow(make.mesh.triangle_rgb, &make.triangle_rgb_capacity, 3 * i + 3, 1);
        if (!make.mesh.triangle_rgb) make.failed = 1;
        else memcpy(make.mesh.triangle_rgb + 3 * i, stripes[i / 2 % (2 * BALLOON_ROWS) / 10 % 2], 3);
    }
    if (!make.failed) make.failed = sup_mesh_compute_normals(&make.mesh, NULL);
    (void)supi_world_mesh(world, &make, m->model, 0, 0, 0);
    memset(&make, 0, sizeof make);
    supi_make_colour(&make, 134, 92, 52);
    supi_make_box(&make, basket[0], basket[1], 0);
    for (int k = 0; k < 4; k++) { /* ropes */
        const float x = k & 1 ? 0.18f : -0.18f, z = k & 2 ? 0.18f : -0.18f;
        const float lo[3] = {x - 0.012f, -1.45f, z - 0.012f}, hi[3] = {x + 0.012f, -0.96f, z + 0.012f};
        supi_make_box(&make, lo, hi, 0);
    }
    (void)supi_world_mesh(world, &make, m->model, 0, 0, 0);
    if (!world->failed && zbufrand_list_append(world->scene, ZBUFRAND_ROOT, m->model) != ZBUFRAND_OK) world->failed = 2;
}

static int make_movement(movement *m, sup_world *world, zbufrand_node turning, const zbufrand_camera *camera) {
    zbufrand_scene_info info;
    memset(m, 0, sizeof *m);
    zbufrand_scene_get_info(world->scene, &info);
    m->turning = turning;
    for (int k = 0; k < 3; k++) {
        m->middle[k] = 0.5 * (info.box_min[k] + info.box_max[k]);
        m->at[k] = camera->at[k];
        m->reach += (camera->at[k] - camera->eye[k]) * (camera->at[k] - camera->eye[k]);
    }
    m->reach = sqrt(m->reach);
    make_balloon(m, world);
    return world->failed;
}

/* NAME.png -> NAME_0012.png */
static void frame_name(char *out, size_t size, const char *name, int64_t frame) {
    const char *dot = strrchr(name, '.');
    if (dot == NULL || strchr(dot, '/') != NULL) dot = name + strlen(name);
    snprintf(out, size, "%.*s_%04lld%s", (int)(dot - name), name, (long long)frame, dot);
}

static zbufrand_result draw_frames(options *o, zbufrand_frame *frame, zbufrand_render_desc *desc, sup_world *world,
                                   zbufrand_node turning, pictures *p, sup_error *err, int *written) {
    const char *name = o->common.out;
    char path[4096];
    movement m;
    zbufrand_result result = make_movement(&m, world, turning, &desc->camera) ? ZBUFRAND_ERR_NO_MEMORY : ZBUFRAND_OK;
    zbufrand_stats each;
    *written = 0;
    memset(&p->stats, 0, sizeof p->stats);
    for (int64_t k = 0; k < o->frames && result == ZBUFRAND_OK; k++) {
        const double start = sup_now();
        result = move(&m, world->scene, k, o->frames);
        m.edit_seconds += sup_now() - start;
        if (result == ZBUFRAND_OK) result = zbufrand_render(frame, desc, world->scene, &p->image, &each);
        if (result != ZBUFRAND_OK) break;
        add_stats(&p->stats, &each, k);
        frame_name(path, sizeof path, name, k);
        o->common.out = path;
        *written = write_pictures(o, &p->image, err);
        o->common.out = name;
        if (*written) break;
    }
    if (!o->common.quiet)
        fprintf(stderr, "%lld pictures, edits took %.3f ms each\n", (long long)o->frames,
                1e3 * m.edit_seconds / (double)o->frames);
    p->stats.frames = (uint32_t)o->frames;
    return result;
}

static int make_image(const options *o, zbufrand_image *image) {
    const size_t pixels = (size_t)o->common.size[0] * o->common.size[1];
    memset(image, 0, sizeof *image);
    image->width = o->common.size[0];
    image->height = o->common.size[1];
    image->rgba8 = (uint8_t *)sup_alloc(pixels, 4);
    image->rgba = (float *)sup_alloc(pixels, 16);
    if (o->common.depth) image->depth = (float *)sup_alloc(pixels, 4);
    return !image->rgba8 || !image->rgba || (o->common.depth && !image->depth);
}

int main(int argc, char **argv) {
    options o;
    zbufrand_render_desc desc;
    zbufrand_scene_desc scene_desc;
    zbufrand_build_desc build_desc;
    zbufrand_frame_desc frame_desc;
    zbufrand_frame *frame = NULL;
    zbufrand_scene_info info;
    zbufrand_node turning = 0;
    zbufrand_error error = {ZBUFRAND_OK, 0, ""};
    zbufrand_result result = ZBUFRAND_ERR_NO_MEMORY;
    pictures p;
    sup_world world;
    sup_progress progress;
    sup_error err;
    double start;
    int status = parse(argc, argv, &o, &desc, &build_desc);
    if (status >= 0) return status;
    memset(&scene_desc, 0, sizeof scene_desc);
    memset(&frame_desc, 0, sizeof frame_desc);
    memset(&p, 0, sizeof p);
    sup_progress_begin(&progress, "drawing", o.common.quiet);
    scene_desc.env.thread_count = (uint32_t)o.common.threads;
    scene_desc.env.error = &error;
    scene_desc.env.memory_limit = (size_t)o.memory << 20;
    frame_desc.env = scene_desc.env;
    frame_desc.isa = (zbufrand_isa)o.common.isa;
    build_desc.seed = (uint32_t)o.common.seed;
    desc.clock_fn = clock_now;
    status = is_world(o.scene) ? sup_world_make(o.scene, &scene_desc, &build_desc, &world, &info, &err)
                               : make_mesh_scene(&o, &scene_desc, &build_desc, &world, &info, &turning, &error, &err);
    if (status) {
        sup_world_free(&world);
        return sup_bad_input(argv[0], err.text);
    }
    if (o.view > 0 && (size_t)o.view > world.view_count) {
        status = sup_bad_usage(argv[0], "--view: of %s there are %d", o.scene, (int)world.view_count);
        sup_world_free(&world);
        return status;
    }
    set_camera(&o, &world, &info, &desc.camera);
    set_morning(&o, &desc);
    if (o.projected_tolerance > 0.0) /* pixels; the library has it in any unit, but its depths are ours */
        desc.reconstruct.focal = 0.5f * (float)o.common.size[1] / tanf(0.5f * 0.01745329f * (float)desc.camera.fov_y);
    if (o.measure_costs) result = zbufrand_measure_costs(&frame_desc, clock_now, NULL, &desc.costs);
    if (!make_image(&o, &p.image)) result = zbufrand_frame_create(&frame_desc, &frame);
    if (result == ZBUFRAND_OK && o.common.stats && o.mode != MODE_LAYERS && o.points == 0) /* the first frame of a size also takes its memory: not measured */
        result = zbufrand_render(frame, &desc, world.scene, &p.image, &p.stats);
    start = sup_now();
    if (result == ZBUFRAND_OK) {
        memset(&p.stats, 0, sizeof p.stats);
        result = o.points > 0 ? draw_points(&o, &desc, world.scene, &p.image, &p.stats)
               : o.mode == MODE_LAYERS ? draw_layers(&o, frame, &desc, world.scene, &p.image, &p.stats)
               : o.frames > 0 ? draw_frames(&o, frame, &desc, &world, turning, &p, &err, &status)
               : o.mean > 0 ? draw_mean(&o, frame, &desc, world.scene, &p.image, &p.stats)
                            : zbufrand_render(frame, &desc, world.scene, &p.image, &p.stats);
    }
    p.seconds = sup_now() - start;
    sup_progress_end(&progress);
    if (result != ZBUFRAND_OK) {
        (void)sup_fail(&err, "%s: %s", o.scene, error.text[0] ? error.text : zbufrand_result_string(result));
        status = sup_bad_input(argv[0], err.text);
    } else if (o.frames > 0 ? status : write_pictures(&o, &p.image, &err)) {
        status = sup_bad_input(argv[0], err.text);
    } else if (o.common.stats) {
        print_stats(&o, &info, &desc.camera, &desc.costs, &p);
    }
    SUP_FREE(p.image.rgba8);
    SUP_FREE(p.image.rgba);
    SUP_FREE(p.image.depth);
    zbufrand_frame_destroy(frame);
    sup_world_free(&world);
    return status;
}
