#pragma once

#include <memory>
#include <vector>

#include "apps/render/look.h"
#include "apps/render/render.h"

namespace sekitei::rays {
class TriangleScene;
}

namespace sekitei::render {

/// All pieces in one mesh, without attributes: what rays meet.
/// @throws InvalidInput  no triangles, an index out of range
TriMesh joined(const std::vector<Piece>& pieces);

/// Lays plants of hypnum, whose mats follow the stone they creep over, flat onto the triangle under
/// or before their foot, if one is nearer than `size` [m]; their yaw stays.
void lay_mats(std::vector<Tuft>& moss, const std::vector<std::string>& species, double size,
              const TriMesh& mesh, const rays::TriangleScene& rays);

/// The same of all triangles of a mesh.
void lay_mats(std::vector<Tuft>& moss, const std::vector<std::string>& species, double size,
              const TriMesh& mesh, const Progress& progress);
/// What grows and lies on the ground of a forest and around it.
/// @param light  that comes through the crowns: 0 litter alone, 1 a meadow
Material ground_cover(const SurfacePoint& point, float light, std::uint64_t key);

/// Bark of trees: plates and furrows along what stands upright, lichen in patches.
Material bark_material(const SurfacePoint& point, std::uint64_t key);

/// Substances of the pieces of joined(). Rock keeps the columns and surfaces its mesh knows; the
/// ground is that of the first rock, around a forest a meadow.
class GardenLook : public Look {
public:
    GardenLook(const std::vector<Piece>& pieces, std::uint64_t seed, const Progress& progress = {});
    Material surface(const SurfacePoint& point) const override;
    Material ground(const SurfacePoint& point) const override;

private:
    struct Part {
        std::size_t first = 0;  // triangle
        Substance substance = Substance::Rock;
        const RockLook* rock = nullptr;
        LeafColours leaves{};
        const TriMesh* mesh = nullptr;
        const std::vector<float>* light = nullptr;  ///< of a forest's floor, at its vertices
    };
    std::vector<Part> parts_;
    std::vector<std::unique_ptr<RockLook>> rocks_;
    std::uint64_t key_;
    bool meadow_ = false;  ///< around a forest or a garden
};

}  // namespace sekitei::render
