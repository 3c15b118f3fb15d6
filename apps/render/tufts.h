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
    std::vector<Vec3f> normals;  ///< of the cushion as a whole, for soft light; of stalks their own
    std::vector<float> height;   ///< along the shoot, 0 foot .. 1 tip; above 1.1 hair, 2 stalks
    std::vector<float>
        tone;  ///< of the shoot, -1 .. 1; lower where shade between shoots is left out
    std::vector<std::array<std::uint32_t, 3>> triangles;  ///< wound as the normals point
};

inline constexpr int kTuftModels = 3, kTuftLods = 3, kTuftDensities = 3;
inline constexpr float kRipe = 2;  ///< growth from which a moss bears capsules

/// Which mesh stands for a plant.
struct TuftModel {
    int model = 0;    ///< 0 .. kTuftModels - 1: siblings
    int lod = 0;      ///< of a full-grown plant: 0 at least 2000 triangles, 1 some 220, 2 some 22
    int density = 2;  ///< 0 .. kTuftDensities - 1: a bit less than half, 7 in 10, all of the shoots
};

/// Shoots of bryum, hypnum, polytrichum or grimmia; any other name gives cushions. Models of one
/// species differ only in their random numbers; levels and densities of one model are the same
/// shoots, drawn coarser or left out. All of it lies in a ball of diameter 1.5 with its
/// sporophytes.
TuftShape tuft_shape(const std::string& species, const TuftModel& which);
/// The stalks and capsules that this model bears when ripe: few on the first, more on the others.
TuftShape tuft_capsules(const std::string& species, const TuftModel& which);

/// Both in one where it is ripe.
TuftShape tuft_shape(const std::string& species, const TuftModel& which, bool ripe);
/// Which of the siblings stands for a plant.
/// @param place  in the list, for plants without number
int tuft_sibling(std::uint64_t seed, std::int64_t id, std::size_t place);
/// Colour of a plant of half a year's moist growth.
/// @param height  along the shoot, as in TuftShape
Vec3f tuft_colour(const std::string& species, float height);

/// Density 0 .. kTuftDensities - 1 of a moss of this growth.
int tuft_density(float growth);
/// Level of detail of a plant that is so many pixels wide in the picture.
int tuft_lod(double pixels);

struct TuftFile {
    std::string name, bytes;
};
/// Models of a moss of this growth as PLY with normals and the attributes `height` and `tone`:
/// NAME_MODEL_lodK.ply, and from growth 2 on NAME_MODEL_capsules_lodK.ply.
std::vector<TuftFile> tuft_files(const std::vector<std::string>& species, float growth = 2);

/// From where plants are looked at, to choose their level of detail.
struct TuftView {
    Vec3d eye;
    double pixel = 0;  ///< angle that a pixel is wide [rad]; 0: everything in full detail
};

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
          std::uint64_t seed, const TuftView& view = {}, const Progress& progress = {});
    ~Tufts();
    Tufts(const Tufts&) = delete;
    Tufts& operator=(const Tufts&) = delete;

    bool intersect(Vec3f origin, Vec3f direction, float far, TuftHit& hit) const;
    bool occluded(Vec3f origin, Vec3f direction, float far) const;

    /// Position, geometric normal (unit, as wound) and soft normal of a hit, in the world.
    void place(const TuftHit& hit, Vec3f& position, Vec3f& geometric, Vec3f& soft) const;
    /// @param point  position, and `normal` = the soft normal towards the viewer
    Material material(const TuftHit& hit, const SurfacePoint& point) const;

    std::size_t memory_bytes() const;  ///< that Embree and the plants hold
    std::size_t triangles() const;     ///< of all plants, if they were not copies

private:
    struct State;
    std::unique_ptr<State> state_;
};

}  // namespace sekitei::render
