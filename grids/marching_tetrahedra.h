#pragma once

#include "core/mesh.h"
#include "core/progress.h"
#include "grids/leaf_grid.h"

namespace sekitei {

/// The surface where `field` crosses `iso`, as a closed triangle mesh.
///
/// Kuhn subdivision of the lattice of voxel centres: six tetrahedra a cell around the diagonal
/// (0,0,0)-(1,1,1), the same in every cell. A vertex belongs to (lower node, one of seven
/// directions): exactly one a crossing edge. Inside is value >= iso; the crossing parameter is
/// clamped to [1e-3, 1 - 1e-3], so no two vertices coincide and no triangle is empty. Outside all
/// leaves the background counts, so caps close the mesh. Two passes over leaves (count, emit) in
/// leaf order: no hash table, no welding, the same bytes on any number of threads [Doi1991].
///
/// Triangles are counter-clockwise seen from lower values. Vertices in world space.
/// @throws LimitExceeded  more than 2^32 - 1 vertices
TriMesh marching_tetrahedra(const FloatGrid& field, double iso, const Progress& progress);
/// The same with another transform than the field's own.
TriMesh marching_tetrahedra(const FloatGrid& field, double iso, const Transform& transform,
                            const Progress& progress);

}  // namespace sekitei
