#pragma once

#include <functional>

#include "core/mesh.h"
#include "core/progress.h"
#include "grids/leaf_grid.h"

/// Signed distance fields in a narrow band; negative inside, world units, background = band width.
namespace sekitei {

/// Half width of every band, in voxels.
inline constexpr double kBandVoxels = 4.0;

/// Distance to a closed mesh (OpenVDB's meshToVolume); interior leaves are constant -background.
/// @throws InvalidInput  nothing inside: the mesh is smaller than a voxel
FloatGrid level_set_from_mesh(const TriMesh& mesh, const Transform& transform,
                              const Progress& progress);

/// Distance to the zero set of an implicit function f(p), p in voxel units, negative inside, cut to
/// the domain's leaves. f need not be a distance: values are divided by the gradient length, found
/// by central differences, near the surface.
FloatGrid level_set_from_function(const Domain& domain, const std::function<double(Vec3d)>& f,
                                  const Progress& progress);

/// Distance from a binary set of voxels (active = inside), smoothed by half a voxel: for foreign
/// grids that have only a region. Exact Euclidean distance between voxel centres within the band.
FloatGrid level_set_from_voxels(const LeafGrid<std::int32_t>& region, std::int32_t inside_value,
                                const Domain& domain, const Progress& progress);

/// max(a, b) (intersection), min(a, b) (union) and max(a, -b) (difference) over the union of
/// leaves.
FloatGrid csg_intersection(const FloatGrid& a, const FloatGrid& b);
FloatGrid csg_union(const FloatGrid& a, const FloatGrid& b);
FloatGrid csg_difference(const FloatGrid& a, const FloatGrid& b);

}  // namespace sekitei
