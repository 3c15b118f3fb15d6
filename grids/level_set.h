#pragma once

#include <functional>
#include <limits>

#include "core/mesh.h"
#include "core/progress.h"
#include "grids/leaf_grid.h"

/// Signed distance fields in a narrow band; negative inside, world units, background = band width.
///
/// Band voxels are active; inactive voxels hold plus or minus the background. Leaves inside the
/// body and beyond the band are constant.
namespace sekitei {

/// Half width of every band, in voxels.
inline constexpr double kBandVoxels = 4.0;

/// Distance to a closed mesh (OpenVDB's meshToVolume); interior leaves are constant -background.
/// Which way the triangles are wound does not matter; where parts overlap, the union is meant.
/// Exact within a voxel of the surface, farther off good to half a voxel (OpenVDB compares only the
/// triangles its neighbours found).
/// @throws InvalidInput  no triangles, NaN or out-of-range vertices, nothing inside (the mesh is
///                       smaller than a voxel, or has holes)
FloatGrid level_set_from_mesh(const TriMesh& mesh, const Transform& transform,
                              const Progress& progress);

/// Distance to a mesh with holes: inside is where the generalised winding number [Jacobson2013]
/// exceeds 1/2, so holes are closed by smooth patches. Found by a tree of dipoles [Barill2018]; cut
/// to the domain's leaves and one beyond. Triangles must agree in orientation, outwards or inwards.
/// @throws InvalidInput  as above; nothing inside
FloatGrid level_set_from_open_mesh(const TriMesh& mesh, const Domain& domain,
                                   const Progress& progress);

/// Distance to the nearest triangle without sign, up to `band` voxels; background = band * voxel.
FloatGrid distance_to_mesh(const TriMesh& mesh, const Transform& transform, double band,
                           const Progress& progress);

/// What is known of an implicit function.
struct ImplicitBounds {
    /// No point at p is nearer to the zero set than |f(p)| / steepness voxels: leaves that lie
    /// farther are not visited. Infinity: unknown, every voxel is visited.
    double steepness = std::numeric_limits<double>::infinity();
    bool is_distance = false;  ///< f is a distance in voxels near its zero set already
};

/// Distance to the zero set of an implicit function f(p), p in voxel units, negative inside, on the
/// domain's leaves and one leaf beyond, as if f went on outside the box.
///
/// f need not be a distance: the foot point is sought along the gradient (central differences), and
/// the distance is that to the tangent plane there. The sign at a voxel is the sign of f, and
/// f = 0 is inside.
FloatGrid level_set_from_function(const Domain& domain, const std::function<double(Vec3d)>& f,
                                  const Progress& progress, ImplicitBounds bounds = {});

/// Distance from a binary set of voxels (value = `inside_value` and active), smoothed by half a
/// voxel without changing a voxel's side: for foreign grids that have only a region. Exact
/// Euclidean distance between voxel centres within the band, less half a voxel. The box walls are
/// not part of the surface: beyond them the outermost voxels go on.
FloatGrid level_set_from_voxels(const LeafGrid<std::int32_t>& region, std::int32_t inside_value,
                                const Domain& domain, const Progress& progress);

/// A field whose signs are right but whose size may not be (the union of two bodies that touch has
/// zeros along their contact; a patched hole has none): wherever the size cannot be the distance to
/// the nearest change of sign, it is replaced by that distance, which is good to a voxel. Cut to
/// the domain's leaves and one beyond; background = band width.
FloatGrid mend_distances(const FloatGrid& field, const Domain& domain, const Progress& progress);
/// The same on all leaves of the field and one beyond.
FloatGrid mend_distances(const FloatGrid& field, const Progress& progress);

/// max(a, b) (intersection), min(a, b) (union) and max(a, -b) (difference) over the union of
/// leaves.
FloatGrid csg_intersection(const FloatGrid& a, const FloatGrid& b);
FloatGrid csg_union(const FloatGrid& a, const FloatGrid& b);
FloatGrid csg_difference(const FloatGrid& a, const FloatGrid& b);

/// Voxels whose value is at most zero, inside [0, dims).
double inside_voxels(const FloatGrid& level_set, const Domain& domain);

}  // namespace sekitei
