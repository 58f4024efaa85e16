/* zbuffer.h - every triangle of a scene through zbufrand.h's rasteriser: what sampling is compared with - MIT OR
   Unlicense, see LICENSE

   It uses private functions and brings zbufrand.h with its implementation where that is not there yet. The trees serve
   to drop what is beside the picture, all else is drawn in storage order: the time is proportional to the number of
   triangles in view. */
#ifndef BASELINE_ZBUFFER_H_INCLUDED
#define BASELINE_ZBUFFER_H_INCLUDED
#ifndef ZBUFRAND_IMPLEMENTATION
#  define ZBUFRAND_IMPLEMENTATION
#endif
#include "../../zbufrand.h"

enum { BASELINE_ZBUFFER_ITEMS = 4096, BASELINE_ZBUFFER_LOCALS = 512, BASELINE_ZBUFFER_TASK = 32 };

typedef struct baseline_zbuffer_item { uint32_t local, cluster, number; } baseline_zbuffer_item;

typedef struct baseline_zbuffer {
    const zbufrandi_structure *structure;
    const zbufrand_env *env;
    zbufrandi_cut cut;                 /* scene and camera are used */
    zbufrandi_raster raster;
    baseline_zbuffer_item *item;       /* drawn together */
    zbufrandi_local *local;
    uint32_t item_count, local_count, flushes;
    uint64_t triangles;                /* handed to the rasteriser */
    uint32_t covered[2];               /* tally of covered pixels, hidden ones too */
} baseline_zbuffer;

static void baseline_zbuffer_task(void *ctx, uint32_t task) {
    baseline_zbuffer *z = (baseline_zbuffer *)ctx;
    zbufrandi_raster r = z->raster;
    uint32_t i = task * BASELINE_ZBUFFER_TASK, end = i + BASELINE_ZBUFFER_TASK, local = ~0u;
    uint64_t covered = 0;
    if (end > z->item_count) end = z->item_count;
    for (; i < end; i++) {
        const baseline_zbuffer_item *item = &z->item[i];
        const zbufrandi_local *l = &z->local[item->local];
        const zbufrandi_structure *s = &z->structure[l->structure];
        const zbufrandi_cluster *c = &s->cluster[item->cluster];
        if (item->local != local) zbufrandi_raster_local(&r, l);
        local = item->local;
        covered += zbufrandi_raster_cluster(&r, s->position + 3 * (size_t)c->first_vertex, c->vertex_count,
                                            s->triangle + 3 * (size_t)c->first_triangle, c->triangle_count,
                                            c->flags & ZBUFRANDI_TWO_SIDED, item->number);
    }
    zbufrandi_tally_add(z->covered, covered);
}

static void baseline_zbuffer_flush(baseline_zbuffer *z) {
    zbufrandi_parallel_for(z->env, baseline_zbuffer_task, z,
                           (z->item_count + BASELINE_ZBUFFER_TASK - 1) / BASELINE_ZBUFFER_TASK);
    z->item_count = 0;
    z->local_count = 0;
    z->flushes++;
}

/* Whether a box is beside the picture, behind the near plane or beyond the far one. */
static int baseline_zbuffer_outside(const baseline_zbuffer *z, const zbufrandi_local *l, const zbufrandi_sides *s,
                                    const zbufrandi_node8 *n, uint32_t lane) {
    float q[3], e[3], depth, reach, slack;
    uint32_t a, p;
    for (a = 0; a < 3; a++) {
        e[a] = (n->hi[a][lane] - n->lo[a][lane]) * 0.5f;
        q[a] = (n->lo[a][lane] + n->hi[a][lane]) * 0.5f - l->eye[a];
    }
    slack = (zbufrandi_absf(q[0]) + zbufrandi_absf(q[1]) + zbufrandi_absf(q[2]) + e[0] + e[1] + e[2]) *
            (l->scale * 1e-5f);
    for (p = 0; p < 4; p++) {
        const float d = q[0] * s->side[p][0] + q[1] * s->side[p][1] + q[2] * s->side[p][2];
        reach = e[0] * s->side_e[p][0] + e[1] * s->side_e[p][1] + e[2] * s->side_e[p][2];
        if (d + reach < -slack) return 1;
    }
    depth = q[0] * l->m[2][0] + q[1] * l->m[2][1] + q[2] * l->m[2][2] + l->rest[2];
    reach = e[0] * s->z_e[0] + e[1] * s->z_e[1] + e[2] * s->z_e[2] + slack;
    return depth + reach < (float)z->cut.camera.near_z || depth - reach > (float)z->cut.camera.far_z;
}

/* stored: where l stands in z->local, and since which flush; another flush than the last: it does not stand there. */
static void baseline_zbuffer_node(baseline_zbuffer *z, const zbufrandi_local *l, const zbufrandi_sides *sides,
                                  uint32_t node, uint32_t stored[2]) {
    const zbufrandi_structure *s = &z->structure[l->structure];
    const zbufrandi_node8 *n = &s->node[node];
    uint32_t lane;
    for (lane = 0; lane < n->count; lane++) {
        const uint32_t index = ZBUFRANDI_CHILD_INDEX(n->child[lane]);
        if (baseline_zbuffer_outside(z, l, sides, n, lane)) continue;
        if (ZBUFRANDI_CHILD_KIND(n->child[lane]) == ZBUFRANDI_CHILD_NODE) {
            baseline_zbuffer_node(z, l, sides, index, stored);
        } else if (ZBUFRANDI_CHILD_KIND(n->child[lane]) == ZBUFRANDI_CHILD_INSTANCE) {
            zbufrandi_local inner;
            uint32_t inner_stored[2] = {0, ~0u};
            zbufrandi_sides inner_sides;
            zbufrandi_local_enter(&z->cut, l, ~0u, index, &inner);
            if (z->structure[inner.structure].node_count == 0) continue;
            zbufrandi_sides_of(&z->cut.camera, &inner, &inner_sides);
            baseline_zbuffer_node(z, &inner, &inner_sides, 0, inner_stored);
        } else {
            baseline_zbuffer_item *item;
            if (z->item_count == BASELINE_ZBUFFER_ITEMS ||
                (stored[1] != z->flushes && z->local_count == BASELINE_ZBUFFER_LOCALS)) {
                baseline_zbuffer_flush(z);
            }
            if (stored[1] != z->flushes) {
                stored[0] = z->local_count;
                stored[1] = z->flushes;
                z->local[z->local_count++] = *l;
            }
            item = &z->item[z->item_count++];
            item->local = stored[0];
            item->cluster = index;
            item->number = (uint32_t)z->triangles;
            z->triangles += s->cluster[index].triangle_count;
        }
    }
}

/* Draw all of a built scene into the keys, which are not cleared before. Triangles are numbered in the order in which
   they are met, modulo 2^32.
   out_triangles, out_covered  triangles in view; pixels they covered, hidden ones too; may be NULL
   Errors: NO_MEMORY. */
static ZBUFRANDI_UNUSED zbufrand_result baseline_zbuffer_draw(const zbufrand_scene *scene,
                                                              const zbufrandi_camera *camera,
                                                              const zbufrandi_keys *keys, const zbufrand_env *env,
                                                              zbufrandi_mem *mem, int level, uint64_t *out_triangles,
                                                              uint64_t *out_covered) {
    const int alone = env->parallel.for_fn == NULL && zbufrandi_thread_count(env) == 1;
    baseline_zbuffer z;
    zbufrandi_local root;
    zbufrandi_sides sides;
    uint32_t stored[2] = {0, ~0u};
    memset(&z, 0, sizeof z);
    if (out_triangles != NULL) *out_triangles = 0;
    if (out_covered != NULL) *out_covered = 0;
    if (scene->structure_count == 0 || scene->structure[0].node_count == 0) return ZBUFRAND_OK;
    z.structure = scene->structure;
    z.env = env;
    z.cut.scene = scene;
    z.cut.camera = *camera;
    z.item = (baseline_zbuffer_item *)zbufrandi_alloc_array(mem, BASELINE_ZBUFFER_ITEMS, sizeof *z.item);
    z.local = (zbufrandi_local *)zbufrandi_alloc_array(mem, BASELINE_ZBUFFER_LOCALS, sizeof *z.local);
    if (z.item == NULL || z.local == NULL) {
        zbufrandi_free(mem, z.item);
        zbufrandi_free(mem, z.local);
        return ZBUFRAND_ERR_NO_MEMORY;
    }
    zbufrandi_raster_begin(&z.raster, camera, keys, alone, level);
    zbufrandi_local_root(camera, &scene->structure[0], 0, &root);
    zbufrandi_sides_of(camera, &root, &sides);
    baseline_zbuffer_node(&z, &root, &sides, 0, stored);
    baseline_zbuffer_flush(&z);
    zbufrandi_free(mem, z.item);
    zbufrandi_free(mem, z.local);
    if (out_triangles != NULL) *out_triangles = z.triangles;
    if (out_covered != NULL) *out_covered = zbufrandi_tally(z.covered);
    return ZBUFRAND_OK;
}

#endif /* BASELINE_ZBUFFER_H_INCLUDED */
