#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "apps/ground.h"
#include "apps/stage.h"
#include "apps/weather_choice.h"
#include "core/mesh_sites.h"
#include "core/params.h"
#include "grids/scene.h"
#include "solvers/light/light.h"
#include "solvers/light/photon_map.h"
#include "solvers/light/photons.h"
#include "solvers/moss/colony.h"
#include "solvers/soil/geology.h"

/// Light, ground and mosses on the faces of a mesh: where photons, soil and colonies meet.
namespace sekitei::apps {

enum class SunMode { Fixed, Path };
constexpr std::array<std::string_view, 2> choice_names(SunMode)
{
    return {"fixed", "path"};
}

/// No 24-hour mean on earth is higher than the sun's light outside the air.
inline constexpr Range kDailyLight = between(0, 1400);

/// The mesh as ground that photons fall on.
struct PhotonGround {
    double site = 0.02;
    std::optional<SunMode> sun;
    double open_light = 150;
    double sun_elevation = 90;
    std::optional<double> sky_light;

    static void describe(auto&& field)
    {
        field("site", &PhotonGround::site, "m", between(1e-4, 1000),
              "on a mesh: longest edge of the pieces that have a climate each");
        field("sun", &PhotonGround::sun,
              "on a mesh: fixed in the south, or on its path; auto: path with weather");
        field("open_light", &PhotonGround::open_light, "W/m^2", kDailyLight,
              "with a fixed sun: its light on open level ground, 24-hour mean");
        field("sun_elevation", &PhotonGround::sun_elevation, "deg",
              Range{.lower = 0, .upper = 90, .without_lower = true},
              "with a fixed sun: its height above the horizon");
        field("sky_light", &PhotonGround::sky_light, "W/m^2", kDailyLight,
              "on a mesh: light of the whole sky on open level ground; auto: as the weather says, "
              "0 with a fixed sun or profile = paper");
    }
};

/// Whether the sun moves.
SunMode sun_mode(const PhotonGround& ground, bool has_weather);
/// Sun and sky of days, in equal shares.
/// @param sky  whether the sky shines where sky_light is auto
light::Daylight daylight_of(const PhotonGround& ground, SunMode mode, bool sky,
                            std::span<const WeatherDay> days, const Site& site);

/// What moss on a mesh has beside what moss on cells has.
struct MeshMossParams {
    PhotonGround land;
    WeatherChoice weather;
    SteadyWeather steady;
    ClimateParams climate;
    light::PhotonParams photons;
    moss::ColonyParams colony;
    soil::GeologyParams geology;
    std::filesystem::path texture;
    std::string mask;
    std::optional<int> ema_days;
    double moss_albedo = 0.2;
    bool own_energy = false;
    std::optional<double> cell;

    static void describe(auto&& field)
    {
        field("texture", &MeshMossParams::texture,
              "on a mesh with texture coordinates: PNG whose colours say which soil lies where");
        field("mask", &MeshMossParams::mask,
              "on a mesh: attribute, 0 to 1, by which fitness is multiplied; empty: none");
        field("ema_days", &MeshMossParams::ema_days, "d", between(1, 1000),
              "on a mesh: days over which the photons' light is averaged; auto: 10, or 1 with "
              "profile = paper");
        field("moss_albedo", &MeshMossParams::moss_albedo, "", between(0, 0.95),
              "on a mesh: diffuse reflectance of moss");
        field("own_energy", &MeshMossParams::own_energy,
              "on a mesh: a moss has the temperature of its own light, not of its site's");
        field("cell", &MeshMossParams::cell, "m", kPositive,
              "on a mesh: voxel of the grids that show its fields too; auto: site");
    }
};
ParamList describe(MeshMossParams& params);

/// A face or vertex attribute of a mesh at each site, linear between vertices.
/// @throws InvalidInput  there is none of this name, or it is no number
std::vector<float> attribute_at_sites(const TriMesh& mesh, const MeshSites& sites,
                                      const std::string& name);

/// A number for each site, by the name it has everywhere.
struct SiteField {
    std::string name, unit;
    std::vector<float> values;
};

/// Bytes at the peak: rays' geometry, sites, a day's photons, plants, the scene that is written.
double mesh_memory(double sites, const light::PhotonParams& photons, int plants);
/// Of a mesh divided into sites, with the grids of put_cells().
/// @throws LimitExceeded  naming what to change
void check_mesh_memory(const Scene& scene, const MeshSites& sites,
                       const light::PhotonParams& photons, int plants, double cell,
                       std::size_t fields, const std::string& stage, double limit);

/// Photons are reflected by less than all that comes.
/// @throws InvalidParameter  albedo > 0.95
void check_mesh_albedo(double albedo, const std::string& stage);

/// Divides a mesh into sites; tells where it is open, for nothing grows on the back of a sheet.
MeshSites sites_of(const TriMesh& mesh, double longest_edge, const std::string& who,
                   const Progress& progress);

/// Leaves the divided mesh as `rock`, with the fields and the old face attributes on its faces, and
/// the points `sites`: its centroids, `N`, `area`, `face` of the mesh it was, and the fields.
void put_sites(Scene& scene, const MeshSites& sites, const TriMesh& was,
               const std::vector<SiteField>& fields, const std::vector<std::int32_t>* geology,
               const std::string& stage);

/// The fields as grids: on the cells that the scene's surface has, else on those of a level set of
/// the mesh, which is put too. A mesh that encloses nothing has no cells: a warning.
void put_cells(Scene& scene, const MeshSites& sites, const std::vector<SiteField>& fields,
               double cell, const std::string& stage, const Progress& progress);

/// Names of what put_sites() and put_cells() leave besides the fields.
std::vector<std::string> site_items();

/// What grows and shines in each zone of a mesh, day by day: the points `zones`, a row for each
/// day, zone and species, with `day`, `zone`, `species`, `living`, `growth` (sum of G_moss),
/// `fitness` (mean G by area),
/// `light` (mean S by area), `light_sd` (its deviation), `theta`, `theta_median` (of half the
/// area).
///
/// Zones are the values of the face attribute `zone` (int32); a mesh without it has none.
class ZoneStatistics {
public:
    ZoneStatistics(const TriMesh& mesh, const MeshSites& sites, int species);
    void add(int day, const moss::Plants& plants, std::span<const std::vector<float>> fitness,
             std::span<const float> light, const std::vector<double>& water,
             const std::vector<float>& depth);
    bool empty() const { return zones_.empty(); }
    Points points(const std::string& stage) const;

    std::vector<double> save() const { return rows_; }
    /// @throws InvalidInput  of other zones
    void restore(const std::vector<double>& saved);

private:
    const MeshSites& sites_;
    int species_;
    std::vector<std::int32_t> zones_;     ///< that there are, ascending
    std::vector<std::uint32_t> of_site_;  ///< index into zones_
    std::vector<double> rows_;
};

/// What sky and rain each site sees.
struct Exposure {
    std::vector<float> sky_view, rain_exposure;
};
/// @param winds  of the rain
Exposure exposure_of(const MeshSites& sites, double latitude,
                     const std::vector<light::RainWind>& winds, const Progress& progress);

/// The soil of each site: attribute `geology`, texture, or the parameter.
std::vector<std::int32_t> geology_of(const TriMesh& mesh, const MeshSites& sites,
                                     const MeshMossParams& params,
                                     const std::filesystem::path& folder, const Progress& progress);

}  // namespace sekitei::apps
