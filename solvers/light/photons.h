#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "core/mesh.h"
#include "core/params.h"
#include "core/progress.h"
#include "core/vec.h"

/// Light carried by photons [Nomura2010, ch. 3]: from sun and sky into a scene of land and moss,
/// stored wherever they hit, reflected diffusely until absorbed.
///
/// World axes: x east, y north, z up; metres. All powers are 24-hour means [W].
namespace sekitei::light {

enum class PhotonSearch { Cells, Tree };
constexpr std::array<std::string_view, 2> choice_names(PhotonSearch)
{
    return {"cells", "tree"};
}
enum class PhotonEstimator {
    Kernel,  ///< photons around a place, over the area of the sites around it
    Site     ///< photons of a site over its area, then smoothed; conserves energy exactly
};
constexpr std::array<std::string_view, 2> choice_names(PhotonEstimator)
{
    return {"kernel", "site"};
}
enum class SunLight {
    Parallel,   ///< from the sun's disc, infinitely far away
    Square,     ///< a square lamp, directions that miss the scene drawn again [Nomura2010, eq. 3.1]
    SquareCone  ///< the same lamp, directions drawn towards the scene alone
};
constexpr std::array<std::string_view, 3> choice_names(SunLight)
{
    return {"parallel", "square", "square_cone"};
}
enum class DirectLight {
    Photons,
    Rays  ///< shadow rays towards the sun stand for the first hits of its photons
};
constexpr std::array<std::string_view, 2> choice_names(DirectLight)
{
    return {"photons", "rays"};
}

struct PhotonParams {
    std::int64_t photons = 262'144;
    double photon_radius = 0.10;
    int photon_nearest = 0;
    PhotonSearch photon_search = PhotonSearch::Cells;
    PhotonEstimator photon_estimator = PhotonEstimator::Kernel;
    SunLight sun_light = SunLight::Parallel;
    std::optional<double> square_half;
    std::optional<double> square_distance;
    bool indirect = true;
    DirectLight direct = DirectLight::Photons;
    bool final_gather = false;
    int gather_rays = 64;
    int gather_below = 20;

    static void describe(auto&& field)
    {
        field("photons", &PhotonParams::photons, "", between(1, 1e15), "sent on a day");
        field("photon_radius", &PhotonParams::photon_radius, "m", between(1e-4, 100),
              "within which photons count for a place");
        field("photon_nearest", &PhotonParams::photon_nearest, "", between(0, 100'000),
              "the radius is the distance of this photon, 2 to 20 cm; 0: one radius everywhere");
        field("photon_search", &PhotonParams::photon_search,
              "how photons near a place are found: cells or tree");
        field("photon_estimator", &PhotonParams::photon_estimator,
              "kernel: photons over area around a place; site: over each site, then smoothed");
        field("sun_light", &PhotonParams::sun_light,
              "parallel, square lamp, or the same lamp aimed at the scene (square_cone)");
        field("square_half", &PhotonParams::square_half, "m", kPositive,
              "half the lamp's side; auto: the radius of the scene");
        field("square_distance", &PhotonParams::square_distance, "m", kPositive,
              "of the lamp from the scene's centre; auto: ten times its radius");
        field("indirect", &PhotonParams::indirect, "follow photons after their first hit");
        field("direct", &PhotonParams::direct, "first light of the sun by photons or shadow rays");
        field("final_gather", &PhotonParams::final_gather,
              "places with few photons look around for light instead");
        field("gather_rays", &PhotonParams::gather_rays, "", between(1, 65'536),
              "rays of such a look");
        field("gather_below", &PhotonParams::gather_below, "", between(0, 1e6),
              "photons that are few");
    }
};
/// @throws InvalidParameter  a field out of its range
void validate(const PhotonParams& params);
/// The same, and whether a square lamp keeps clear of a scene: logs a warning where its light falls
/// off visibly across it.
/// @param radius  PhotonScene::radius()
/// @throws InvalidParameter  a lamp nearer than 3 radii, or farther than 100 for `square`
void validate(const PhotonParams& params, double radius);

/// Sources of light of one day.
struct Daylight {
    struct Beam {
        Vec3d towards;          ///< the sun; any length. Below the horizon it sheds nothing.
        double irradiance = 0;  ///< on a plane across it [W/m^2]: share of the day times DNI
    };
    std::vector<Beam> beams;
    double sky = 0;  ///< diffuse on open level ground, of an isotropic sky [W/m^2]
};

/// A sun that stands still, due south.
/// @param open       on open level ground [W/m^2], >= 0
/// @param elevation  [rad], 0 < elevation <= pi / 2
/// @throws InvalidParameter
Daylight::Beam fixed_sun(double open, double elevation);

/// What photons meet: triangles that stay and balls of moss that grow.
///
/// Embree finds what is hit; where, is computed again in double (solvers/rays/embree.h).
class PhotonScene {
public:
    /// @param land         triangle i is site i; copied
    /// @param albedo       diffuse reflectance of each triangle, 0..0.95
    /// @param moss_albedo  of moss, 0..0.95
    /// @param moss_height  highest that moss rises from the land [m], >= 0
    /// @throws InvalidInput  bad mesh or albedo
    PhotonScene(const TriMesh& land, std::span<const float> albedo, double moss_albedo,
                double moss_height, const Progress& progress);
    ~PhotonScene();
    PhotonScene(const PhotonScene&) = delete;
    PhotonScene& operator=(const PhotonScene&) = delete;

    /// Replaces all moss; ball i is plant i.
    /// @throws InvalidInput  a ball that is not finite or has no radius
    void set_moss(std::span<const Sphere> moss);

    /// The ball that holds land and moss: through the corners of the land's box.
    Vec3d centre() const { return centre_; }
    double radius() const { return radius_; }
    const Bounds& bounds() const { return bounds_; }
    std::size_t sites() const { return albedo_.size(); }
    std::span<const Sphere> moss() const { return moss_; }
    double albedo_of(bool on_moss, std::uint32_t target) const
    {
        return on_moss ? moss_albedo_ : static_cast<double>(albedo_[target]);
    }

    struct Hit {
        Vec3d position;
        Vec3d normal;  ///< of the surface, unit, on the side the ray came from
        double distance = 0;
        std::uint32_t target = 0;  ///< site, or plant
        bool on_moss = false;
        bool back = false;  ///< met from inside
    };
    /// What a ray meets first, from 0.1 mm on.
    /// @param direction  unit
    /// @param moss_too   else it passes through moss
    bool intersect(Vec3f origin, Vec3f direction, Hit& hit, bool moss_too = true) const;
    struct Ray {
        Vec3f origin, direction;
    };
    /// The same for many rays, faster. hits[i].distance is infinite where ray i meets nothing.
    void intersect(std::span<const Ray> rays, std::span<Hit> hits) const;
    /// Whether land is in the way, or moss if `moss_too`.
    bool occluded(Vec3f origin, Vec3f direction, bool moss_too) const;
    /// Where rays start that leave a surface on the side of `normal`.
    Vec3f off_surface(Vec3d position, Vec3d normal) const
    {
        return Vec3f(position + normal * lift_);
    }

private:
    void land_hit(Vec3f origin, Vec3f direction, std::uint32_t triangle, Hit& hit) const;
    void moss_hit(Vec3f origin, Vec3f direction, std::uint32_t plant, float met, Hit& hit) const;

    struct Rays;
    std::unique_ptr<Rays> rays_;
    std::vector<float> albedo_;
    std::vector<Sphere> moss_;
    double moss_albedo_ = 0, radius_ = 0, lift_ = 0;
    Bounds bounds_;
    Vec3d centre_;
};

enum class Source : std::uint8_t { Sun, Sky };

/// A photon on its way in.
struct Emitted {
    Vec3f origin, direction;  ///< unit direction of flight
    float flux = 0;           ///< [W]
    Source source = Source::Sun;
};

/// A photon as it arrived somewhere.
struct Photon {
    Vec3f position;
    Vec3f direction;           ///< of flight, unit
    Vec3f normal;              ///< of the surface, on the side it came from
    float flux = 0;            ///< [W]
    std::uint32_t target = 0;  ///< site, or plant
    std::uint8_t bounce = 0;   ///< reflections before
    Source source = Source::Sun;
    std::uint8_t on_moss = 0;
    std::uint8_t back = 0;  ///< hit from inside
};
static_assert(sizeof(Photon) == 48);

/// Where a day's power went [W]. emitted = missed + absorbed + escaped + lost;
/// stored = absorbed + reflected.
struct Ledger {
    double emitted = 0;  ///< towards the scene
    double missed = 0;   ///< met nothing at all
    double absorbed = 0;
    double escaped = 0;  ///< met nothing after a reflection, or was not followed (indirect = off)
    double lost = 0;     ///< given up after 64 bounces or where a hit had no place
    double stored = 0;   ///< sum of the stored photons
    double reflected = 0;
    std::uint64_t photons = 0;  ///< emitted
    std::uint64_t tries = 0;    ///< directions drawn for photons of the sun
};

struct Shot {
    std::vector<Photon> photons;  ///< by path, then by bounce
    Ledger ledger;
};

/// All photons of a day. Sun and sky get shares by power, so that all carry nearly the same flux.
/// @param tries  of Ledger
/// @throws InvalidParameter  params; a lamp too near
/// @throws InvalidInput      daylight that is negative or not a number
/// @throws Cancelled         from `progress`
std::vector<Emitted> emit(const PhotonScene& scene, const Daylight& daylight,
                          const PhotonParams& params, std::uint64_t seed, std::uint64_t day,
                          std::uint64_t& tries, const Progress& progress = {});

/// Follows photons: each hit is stored, then the photon is reflected diffusely with probability
/// albedo or absorbed. Flux never changes.
/// @param indirect  off: first hits only
Shot trace(const PhotonScene& scene, std::span<const Emitted> emitted, bool indirect,
           std::uint64_t seed, std::uint64_t day, const Progress& progress);

/// emit() and trace(). A function of its arguments: the same bits on any number of threads.
///
/// All stored photons are held, 48 bytes each; 60 more while their map is made. Photons on their
/// way take no room, but for those of a square lamp (32 bytes each).
/// @throws LimitExceeded  more stored photons than this machine could hold, reckoned from the first
///                        32 768
/// Logs a warning where more than 1e-6 of the power is lost.
Shot shoot(const PhotonScene& scene, const Daylight& daylight, const PhotonParams& params,
           std::uint64_t seed, std::uint64_t day, const Progress& progress);

/// Exitance of a square lamp of half side a at distance D, facing a point that gets `irradiance`
/// from it: M = E / F, F = 4/pi X atan X, X = x / sqrt(1 + x^2), x = a / D [W/m^2].
double square_exitance(double irradiance, double half, double distance);

}  // namespace sekitei::light
