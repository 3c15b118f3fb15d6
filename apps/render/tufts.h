#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "apps/render/look.h"
#include "apps/render/render.h"
#include "core/progress.h"

/// Moss plants as many copies of a few small meshes.
namespace sekitei::render {

/// One plant in its own space: foot at the origin, +y up along it, about 1 across.
struct TuftShape {
    std::vector<Vec3f> vertices;
    std::vector<Vec3f> normals;  ///< of the cushion as a whole, for soft light
    std::vector<float> height;   ///< along the shoot, 0 foot .. 1 tip; above 1.1 hair, 2 stalks
    std::vector<float> tone;     ///< of the shoot, -1 .. 1
    std::vector<std::array<std::uint32_t, 3>> triangles;
};

inline constexpr int kTuftVariants = 4;

/// Shoots of bryum, hypnum, polytrichum or grimmia; any other name gives cushions.
/// @param variant  0 .. kTuftVariants - 1; the last one bears capsules
TuftShape tuft_shape(const std::string& species, int variant);

/// Where a ray meets a tuft.
struct TuftHit {
    std::uint32_t tuft = 0, triangle = 0;
    double distance = 0;
    float u = 0, v = 0;
};

/// Plants that rays can be asked against, from any number of threads. A shape is stored once,
/// whatever the number of its copies.
///
/// As in rays::TriangleScene, Embree says which triangle is met; distance and weights are computed
/// here in double.
class Tufts {
public:
    /// @param size  diameter of a plant of scale 1 [m]
    /// @throws InvalidInput  a plant that is not finite, without direction or of unknown species
    /// @throws LimitExceeded  no memory
    Tufts(const std::vector<Tuft>& tufts, const std::vector<std::string>& species, double size,
          std::uint64_t seed, const Progress& progress = {});
    ~Tufts();
    Tufts(const Tufts&) = delete;
    Tufts& operator=(const Tufts&) = delete;

    bool intersect(Vec3f origin, Vec3f direction, float far, TuftHit& hit) const;
    bool occluded(Vec3f origin, Vec3f direction, float far) const;

    /// Position, geometric normal (unit, as wound) and soft normal of a hit, in the world.
    void place(const TuftHit& hit, Vec3f& position, Vec3f& geometric, Vec3f& soft) const;
    /// @param point  position, and `normal` = the soft normal towards the viewer
    Material material(const TuftHit& hit, const SurfacePoint& point) const;

    std::size_t memory_bytes() const;  ///< that Embree holds
    std::size_t triangles() const;     ///< of all plants, if they were not copies

private:
    struct State;
    std::unique_ptr<State> state_;
};

}  // namespace sekitei::render
