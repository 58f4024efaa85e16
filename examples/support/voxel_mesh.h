/* voxel_mesh.h - meshes for voxrt.h
   SPDX-License-Identifier: MIT OR Unlicense */
#ifndef SUP_VOXEL_MESH_H
#define SUP_VOXEL_MESH_H
#include "mesh.h"
#include "../../voxrt.h"

/* The arrays of `mesh` as voxrt_mesh, borrowed: positions, normals, colours and triangles. */
SUP_FN voxrt_mesh sup_voxel_mesh(const sup_mesh *mesh) {
    voxrt_mesh m;
    memset(&m, 0, sizeof m);
    m.positions = mesh->positions;
    m.vertex_count = mesh->vertex_count;
    m.indices = mesh->indices;
    m.triangle_count = mesh->triangle_count;
    m.normals = mesh->normals;
    m.vertex_rgb = mesh->vertex_rgb;
    m.triangle_rgb = mesh->triangle_rgb;
    return m;
}

#endif
