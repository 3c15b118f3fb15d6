#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "apps/render/look.h"
#include "apps/render/render.h"
#include "apps/render/tufts.h"
#include "core/progress.h"

/// Trees of a forest as copies of a few models.
namespace sekitei::render {

/// Level of detail of a tree that is so many pixels high in the picture: 0, the finest, ..
/// kTreeLevels - 1.
std::size_t tree_level(double pixels);
/// The levels that these trees are drawn at, one for each of them.
/// @throws InvalidInput  a tree that is not finite, not larger than nothing or of unknown model
std::vector<std::uint8_t> tree_levels(const std::vector<StandingTree>& trees, std::size_t models,
                                      const TuftView& view);

/// Where a ray meets a tree.
struct WoodHit {
    std::uint32_t tree = 0, triangle = 0;
    double distance = 0;
    float u = 0, v = 0;
};

/// Trees that rays can be asked against, from any number of threads. A mesh is stored once,
/// whatever the number of its copies.
///
/// As in Tufts, Embree says which triangle is met; distance and weights are computed here in
/// double.
class Woods {
public:
    /// @param models  with the meshes of all levels that are needed
    /// @param level   of each tree, see tree_levels()
    /// @param shade_every  one of so many leaves counts for occluded(): stands for what leaves pass
    ///                     on to one another, where that is nearly all the light
    /// @throws InvalidInput   a tree as in tree_levels(); a mesh that is missing or not sound
    /// @throws LimitExceeded  no memory
    Woods(const std::vector<StandingTree>& trees, std::vector<TreeModel> models,
          const std::vector<std::uint8_t>& level, std::uint64_t seed, std::size_t shade_every = 1,
          const Progress& progress = {});
    ~Woods();
    Woods(const Woods&) = delete;
    Woods& operator=(const Woods&) = delete;

    bool intersect(Vec3f origin, Vec3f direction, float far, WoodHit& hit) const;
    bool occluded(Vec3f origin, Vec3f direction, float far) const;

    /// Position, geometric normal (unit, as wound) and soft normal of a hit, in the world.
    void place(const WoodHit& hit, Vec3f& position, Vec3f& geometric, Vec3f& soft) const;
    /// A leaf's normal turned towards that of its crown as a whole; other normals as they are.
    Vec3f rounded(const WoodHit& hit, Vec3f position, Vec3f normal) const;
    /// @param point  position, and `normal` = the soft normal towards the viewer
    Material material(const WoodHit& hit, const SurfacePoint& point) const;

    std::size_t memory_bytes() const;  ///< that Embree, the trees and their models hold
    std::size_t triangles() const;     ///< of all trees, if they were not copies

private:
    struct State;
    std::unique_ptr<State> state_;
};

}  // namespace sekitei::render
