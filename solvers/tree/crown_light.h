#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <span>
#include <string_view>
#include <vector>

#include "core/progress.h"
#include "core/vec.h"
#include "solvers/tree/patches.h"

/// How leaf-balls shade one another [Kanamaru1992, section 3].
namespace sekitei::tree {

enum class Occlusion {
    Ahead,   ///< a ball shades a patch if its centre is ahead and within its radius of the axis
    Full,    ///< wherever the half-line meets it, also from inside: the paper's words
    Exclude  ///< as Ahead, but never a ball that holds the receiver
};
constexpr std::array<std::string_view, 3> choice_names(Occlusion)
{
    return {"ahead", "full", "exclude"};
}
enum class Method {
    Naive,  ///< all pairs of balls, for each patch: the reference
    Sweep,  ///< for each direction, balls sorted into cells across it; the same counts
    Bvh,    ///< Embree, for radii that differ widely
    Grid    ///< extinction on a sparse grid; approximate, for a million balls and more
};
constexpr std::array<std::string_view, 4> choice_names(Method)
{
    return {"naive", "sweep", "bvh", "grid"};
}
enum class LightDirection {
    Mean,      ///< of all light that arrives
    Brightest  ///< the middle of the brightest part of the sky
};
constexpr std::array<std::string_view, 2> choice_names(LightDirection)
{
    return {"mean", "brightest"};
}

/// Balls in tree space [branch lengths].
struct Balls {
    std::vector<Vec3d> centre;
    std::vector<double> radius;

    std::size_t size() const { return centre.size(); }
};

/// Places whose light is asked for. `own` is the ball that a place belongs to and that does not
/// shade it, or kNoBall.
struct Lookers {
    static constexpr std::uint32_t kNoBall = 0xFFFFFFFFu;
    std::vector<Vec3d> at;
    std::vector<std::uint32_t> own;

    std::size_t size() const { return at.size(); }
};

/// What else stands between a place and a patch.
struct Sight {
    bool blocked = false;      ///< by something opaque
    double transmittance = 1;  ///< T of background shade up to there
};
/// Of looker i and patch p; called from any number of threads. Empty: free sight.
using SightOf = std::function<Sight(std::size_t looker, std::size_t patch)>;

struct CrownLightParams {
    double transmission = 0.90;  ///< tau, share of light left behind each ball, 0..1
    Occlusion occlusion = Occlusion::Ahead;
    Method method = Method::Sweep;
    LightDirection direction = LightDirection::Mean;
    double blocked_light = 0;  ///< brightness of what blocks, as B0: albedo * C2
};

/// Light of lookers.
struct CrownLight {
    std::vector<double> light;   ///< L, 1 where nothing is in the way
    std::vector<Vec3d> mean;     ///< m = sum N B S / sum B S; its length is the anisotropy
    std::vector<Vec3d> towards;  ///< u, unit; zero where |m| < 1e-12
};

/// Hits K of each looker and patch: balls that shade it. Row i is looker i's.
/// naive, sweep and bvh count the same, but for bvh's grazing |distance^2 - r^2| < 1e-6 r^2.
/// @throws InvalidParameter  method = grid, which counts nothing
std::vector<std::uint16_t> count_hits(const SkyPatches& sky, const Balls& balls,
                                      const Lookers& lookers, Occlusion occlusion, Method method,
                                      const Progress& progress);

/// B_p = B0_p tau^K_p T_p, or blocked_light tau^K_p T_p where blocked; L = sum B S / sum B0 S, in
/// the order of the patches [Kanamaru1992, section 3].
///
/// Naive: O(n^2 P). Sweep: about 10 balls met by each half-line, O(n P). Memory: 2 bytes for each
/// looker and patch. Grid: errors of L 0.01 in the mean, at most 0.06, against sweep.
/// @throws InvalidParameter  transmission = 0 with method = grid
/// @throws InvalidInput      arrays of different lengths, numbers that are not finite, radii <= 0
///
/// Bit-identical for any number of threads; naive and sweep bit-identical to each other.
CrownLight crown_light(const SkyPatches& sky, const Balls& balls, const Lookers& lookers,
                       const CrownLightParams& params, const SightOf& sight,
                       const Progress& progress);

}  // namespace sekitei::tree
