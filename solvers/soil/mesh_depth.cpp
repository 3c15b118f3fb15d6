#include "solvers/soil/mesh_depth.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>

#include "core/parallel.h"
#include "solvers/rays/embree.h"

namespace sekitei::soil {
namespace {

using Triangle = std::array<std::uint32_t, 3>;

constexpr double kDeepest = 1.0;      // [m]
constexpr float kWallSlope = 0.10F;   // n.z of the steepest ground that holds a depth of soil
constexpr float kUnderside = -0.30F;  // n.z below which water drips instead of running

/// The sites that look up, or those that look down.
class Sheet {
public:
    Sheet(const MeshSites& sites, bool up, const Progress& progress)
    {
        for (std::uint32_t i = 0; i < sites.size(); ++i)
            if (up ? sites.normal[i].z > 0 : sites.normal[i].z < 0) {
                site_.push_back(i);
                triangles_.push_back(sites.mesh.triangles[i]);
            }
        if (!site_.empty())
            scene_ = std::make_unique<rays::TriangleScene>(sites.mesh.vertices, triangles_,
                                                           "mesh depth", progress);
    }

    /// Straight down from `origin`, from the distance `near` on; infinity if there is nothing.
    double below(Vec3f origin, float near, std::uint32_t& site) const
    {
        rays::Hit hit;
        constexpr float kFar = std::numeric_limits<float>::infinity();
        if (!scene_ || !scene_->intersect(origin, {0, 0, -1}, near, kFar, hit))
            return std::numeric_limits<double>::infinity();
        site = site_[hit.triangle];
        return hit.distance;
    }

private:
    std::vector<std::uint32_t> site_;
    std::vector<Triangle> triangles_;
    std::unique_ptr<rays::TriangleScene> scene_;
};

}  // namespace

MeshDepth mesh_depth(const MeshSites& sites, const Progress& progress)
{
    const std::size_t n = sites.size();
    MeshDepth result{std::vector<float>(n, 1.0F), std::vector<std::int32_t>(n, -1)};
    float extent = 0;
    for (const Vec3f& v : sites.mesh.vertices)
        extent = std::max({extent, std::abs(v.x), std::abs(v.y), std::abs(v.z)});
    // Centroids are rounded to floats: a ray starts this much above its site, or the back of a
    // sheet without thickness would be missed.
    const float lift = 8 * (std::nextafter(extent, INFINITY) - extent);

    const Sheet down(sites, false, progress.slice(0, 0.2));
    progress.update(0.2);
    // Only what looks down ends a solid for a ray that falls. Asking those faces alone finds the
    // first end whatever else lies at the same place, as where one stone stands on another.
    parallel_for_range(
        n,
        [&](std::size_t begin, std::size_t end) {
            progress.check();
            for (std::size_t i = begin; i != end; ++i) {
                if (!(sites.normal[i].z > kWallSlope)) continue;
                std::uint32_t site = 0;
                const Vec3f origin = sites.position[i] + Vec3f(0, 0, lift);
                const double depth =
                    down.below(origin, 0, site) - (double(origin.z) - double(sites.position[i].z));
                result.depth[i] = static_cast<float>(1000 * std::clamp(depth, 0.001, kDeepest));
            }
        },
        1024);
    progress.update(0.5);

    if (std::none_of(sites.normal.begin(), sites.normal.end(),
                     [](Vec3f normal) { return normal.z < kUnderside; }))
        return result;
    const Sheet up(sites, true, progress.slice(0.5, 0.7));
    constexpr double kOwnSheet = 1e-4;  // within it a face that looks down is the drop's own [m]
    parallel_for_range(
        n,
        [&](std::size_t begin, std::size_t end) {
            progress.check();
            for (std::size_t i = begin; i != end; ++i) {
                if (!(sites.normal[i].z < kUnderside)) continue;
                std::uint32_t site = 0, back = 0;
                const Vec3f origin = sites.position[i];
                const double fall = up.below(origin, 0, site);
                if (!std::isfinite(fall)) continue;
                if (down.below(origin, static_cast<float>(kOwnSheet), back) < fall - kOwnSheet)
                    continue;
                if (sites.position[site].z < origin.z)
                    result.drop_target[i] = static_cast<std::int32_t>(site);
            }
        },
        1024);
    progress.update(1);
    return result;
}

}  // namespace sekitei::soil
