#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>

#include "core/mesh_sites.h"
#include "core/progress.h"
#include "core/vec.h"

/// Where seeds meet a mesh, and the mosses on it.
namespace sekitei::moss {

/// @throws InvalidInput  no sites; arrays that do not fit together
void check_sites(const MeshSites& sites);

/// A point of the land.
struct LandPoint {
    Vec3d at;                ///< [m]
    std::uint32_t site = 0;  ///< triangle it lies on
    bool front = true;       ///< first_hit(): met on the side of its normal
    double distance = 0;     ///< closest(): [m]; first_hit(): in lengths of the way
};

/// The sites of a mesh, to be asked for nearby points and for what a falling seed meets.
///
/// Embree finds the triangles that matter; points and distances are computed again in double from
/// the corners, so that they are the same on every machine. Questions come from any number of
/// threads.
class MeshSurface {
public:
    /// @param sites  must outlive this
    /// @throws InvalidInput  no sites; a vertex that is not finite; arrays that do not fit together
    /// @throws Cancelled     from `progress`
    explicit MeshSurface(const MeshSites& sites, const Progress& progress = {});
    ~MeshSurface();
    MeshSurface(const MeshSurface&) = delete;
    MeshSurface& operator=(const MeshSurface&) = delete;

    const MeshSites& sites() const;
    /// The closest point of the land no farther than `within` [m], on either side; among equally
    /// close triangles that of the lower number.
    std::optional<LandPoint> closest(Vec3d from, double within) const;
    /// The first point met on the way from a point.
    /// @param way  of any length
    std::optional<LandPoint> first_hit(Vec3d from, Vec3d way) const;

private:
    struct Scene;
    std::unique_ptr<Scene> scene_;
};

/// A ball, and how far it is from a place.
struct BallPoint {
    Vec3d at;                ///< on its surface [m]
    std::uint32_t ball = 0;  ///< its number
    double distance = 0;     ///< closest(): [m], below 0 inside; first_hit(): in lengths of the way
};

/// Balls: the mosses of one day. Tested in double; equal distances go to the lower number.
class Balls {
public:
    /// Views the spheres, which must outlive this; may be none.
    /// @throws InvalidInput  a sphere that is not finite, or of negative radius
    explicit Balls(std::span<const Sphere> spheres);
    ~Balls();
    Balls(const Balls&) = delete;
    Balls& operator=(const Balls&) = delete;

    /// The ball whose surface is closest, where that is no farther than `within` [m].
    std::optional<BallPoint> closest(Vec3d from, double within) const;
    /// The first ball that the way enters from outside; one that it starts in does not count.
    std::optional<BallPoint> first_hit(Vec3d from, Vec3d way) const;

private:
    struct Scene;
    std::unique_ptr<Scene> scene_;
};

}  // namespace sekitei::moss
