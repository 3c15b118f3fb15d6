#pragma once

#include <limits>
#include <memory>
#include <vector>

#include "core/mesh.h"
#include "core/progress.h"
#include "core/vec.h"
#include "grids/leaf_grid.h"

/// What stands around trees: rocks, walls, the shade of other forests. World space, metres.
namespace sekitei::tree {

/// A solid thing. Questions come from any number of threads.
class Obstacle {
public:
    virtual ~Obstacle() = default;
    /// Whether the half-line meets it.
    /// @param direction  unit
    virtual bool blocks(Vec3d from, Vec3d direction) const = 0;
    /// Signed distance, negative inside; exact within `reach()` of the surface, beyond that at
    /// least reach(), infinite where nothing is known [m].
    virtual double distance(Vec3d at) const = 0;
    virtual double reach() const = 0;
    /// Unit normal of the surface nearest to a place, outwards; near the surface only.
    virtual Vec3d away(Vec3d at) const = 0;
};

/// A level set: rays are marched through its narrow band, leaf by leaf; what is less than 1/100
/// voxel deep may be passed. Its reach is the band less 1.75 voxels.
/// @param grid  negative inside; must outlive the obstacle
/// @throws InvalidInput  no level set: no band, no active voxels, nothing inside, values beyond the
///                       background or not finite
std::unique_ptr<Obstacle> level_set_obstacle(const FloatGrid& grid);

/// A closed mesh, by Embree. Inside is where it winds around a place more than half a time: parts
/// may overlap (depth is then that under the nearest wall of any), and which way all of it is wound
/// does not matter. Sheets block rays but have no inside.
/// @param reach  to which distances are worked out [m]
/// @throws InvalidInput      no triangles, or vertices that are not finite
/// @throws InvalidParameter  reach <= 0
std::unique_ptr<Obstacle> mesh_obstacle(TriMesh mesh, double reach, const Progress& progress);

/// Shade of leaves that are not the tree's own: exp(-G integral LAD dl) along half-lines.
class BackgroundShade {
public:
    /// @param leaf_area_density  `canopy_lad` [1/m], trilinear between voxel centres, 0 outside;
    ///                           must outlive this
    /// @param projection         G, leaf projection factor, 0..1
    /// @throws InvalidInput      a density below 0 or not finite, or a background that is not 0
    /// @throws InvalidParameter  projection
    BackgroundShade(const FloatGrid& leaf_area_density, double projection);
    /// Exact for the trilinear field. From any number of threads.
    /// @param direction  unit
    double transmittance(Vec3d from, Vec3d direction) const;
    /// The leaves as they were when the others were young: at `share` of their heights over the
    /// nearest of these feet, all of them.
    /// @param share  > 0, at most 1
    void set_growth(double share, std::vector<Vec3d> feet);
    /// Whether light of the lower half of the sky, which stands for what is scattered around a
    /// tree, comes through them undiminished: so it does within a stand.
    void set_lit_from_below(bool lit) { lit_from_below_ = lit; }
    /// Share of their extinction that counts, 0 to 1; at first all.
    void set_strength(double share) { strength_ = share; }

private:
    double depth(Vec3d from, Vec3d direction, double opaque) const;

    const FloatGrid* grid_;
    double projection_, strength_ = 1;
    double share_ = 1;
    bool lit_from_below_ = false;
    std::vector<Vec3d> feet_;
    TopologyPtr blocks_;          ///< 8^3 cells between voxel centres where there are leaves
    std::vector<float> uniform_;  ///< density of those with one only, else -1
    Coord lower_, upper_;         ///< box of the blocks, in blocks
};

/// All of it.
struct Surroundings {
    std::vector<std::unique_ptr<Obstacle>> obstacles;
    std::unique_ptr<BackgroundShade> shade;

    bool empty() const { return obstacles.empty() && !shade; }
    bool blocks(Vec3d from, Vec3d direction) const
    {
        for (const auto& o : obstacles)
            if (o->blocks(from, direction)) return true;
        return false;
    }
    /// The nearest obstacle to a place; null where there is none.
    const Obstacle* nearest(Vec3d at, double& distance) const
    {
        const Obstacle* found = nullptr;
        distance = std::numeric_limits<double>::infinity();
        for (const auto& o : obstacles)
            if (const double d = o->distance(at); d < distance) distance = d, found = o.get();
        return found;
    }
};

}  // namespace sekitei::tree
