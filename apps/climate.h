#pragma once

#include <optional>
#include <string>
#include <vector>

#include "apps/stage.h"
#include "core/progress.h"
#include "core/weather.h"
#include "grids/scene.h"
#include "grids/surface_cells.h"
#include "solvers/light/light.h"
#include "solvers/soil/soil.h"
#include "solvers/sun/sun.h"
#include "solvers/wind/air.h"

/// The climate of a scene's surface, day by day: what light, wind and soil left in the scene, put
/// together with the weather. Solvers do not call each other; this is where their results meet.
namespace sekitei::apps {

/// The series `weather` of a scene: a point a day, at the origin, with an attribute for each field.
Points weather_points(const Weather& weather);
/// @throws InvalidInput  no days, an attribute that is missing
Weather weather_of(const Scene& scene);

/// How rain, sky and soil are taken into account.
enum class Profile { Full, Paper };
constexpr std::array<std::string_view, 2> choice_names(Profile)
{
    return {"full", "paper"};
}

struct ClimateParams {
    Profile profile = Profile::Full;
    std::optional<soil::Balance> balance;
    std::optional<bool> sky_view, rain_shelter, runoff;
    std::string soil = "rock";
    std::optional<double> depth;
    double initial_water = 0.5;
    std::optional<double> water_temperature;
    wind::Exchange exchange;
    soil::Params ground;

    static void describe(auto&& field)
    {
        field("profile", &ClimateParams::profile,
              "full, or the papers' simplifications where a switch below is auto");
        field("balance", &ClimateParams::balance,
              "energy balance: exact (full) or linear as in the paper");
        field("sky_view", &ClimateParams::sky_view,
              "cells lose heat only to the sky they see (full), or to all of it (paper)");
        field("rain_shelter", &ClimateParams::rain_shelter,
              "roofs keep rain off (full), or it falls on every cell (paper)");
        field("runoff", &ClimateParams::runoff,
              "water that finds no room runs on over the surface (full), or is gone (paper)");
        field("soil", &ClimateParams::soil,
              "soil of the surface: rock, humus, sand, asphalt, or a .toml file");
        field("depth", &ClimateParams::depth, "m", between(0.001, 1),
              "depth of soil that holds water; auto: 20 mm of rock, else the solid's thickness "
              "below each cell, 1 mm to 1 m");
        field("initial_water", &ClimateParams::initial_water, "", kFraction,
              "water of the first day as a share of what the soil can hold");
        field("water_temperature", &ClimateParams::water_temperature, "K", between(273.15, 313.15),
              "temperature of ponds; auto: 10 C in winter, 20 C in summer");
    }
};

/// All switches of a climate as parameters of a stage.
ParamList describe(ClimateParams& params);
/// @throws InvalidParameter
void validate(const ClimateParams& params);

/// The state of every cell on one day; arrays have the size of the cells.
struct ClimateDay {
    WeatherDay weather;
    light::Light light;
    std::vector<float> wind, air_temperature, air_humidity;
    soil::Runoff rain;  ///< supply: what falls on each cell and runs onto it [mm]
    soil::Result ground;
    double rainfall = 0, inflow = 0, evaporation = 0, outflow = 0;  ///< of the surface [mm m^2]
    double balance_error = 0;  ///< water that is not accounted for / water that came
};

/// What is needed of a scene to know its climate.
std::vector<std::string> climate_needs();
std::vector<std::string> climate_uses();

class Climate {
public:
    /// @param params  validated
    /// @param folder  where relative names of soil files start
    /// @throws InvalidInput  grids that are missing or do not fit together
    Climate(const Scene& scene, const ClimateParams& params, const std::filesystem::path& folder,
            const Progress& progress);

    const SurfaceCells& cells() const { return cells_; }
    const Weather& weather() const { return weather_; }
    const std::vector<std::int32_t>& geology() const { return geology_; }
    const std::vector<float>& depth() const { return depth_; }  ///< h [mm]
    const std::vector<soil::Soil>& soils() const { return soils_; }
    double area() const { return area_; }  ///< of all cells [m^2]
    bool has_wind() const { return has_wind_; }
    const wind::AirTables& tables() const { return tables_; }
    const light::Coefficients& coefficients() const { return coefficients_; }

    /// Memory of soil, wind and the water's paths, besides cells() and coefficients().
    std::size_t bytes() const;

    /// Goes on with the weather from its beginning where it is shorter than `days`.
    /// @throws InvalidParameter  it holds no whole year
    void repeat(std::size_t days) { weather_ = select_days(weather_, 0, days, true); }

    /// Water of each cell at the start [mm].
    std::vector<double> initial_water() const;

    /// One day from yesterday's water.
    /// @param index  day of weather()
    /// @param water  O at yesterday's end [mm]; becomes today's
    /// @param cover  share covered by moss; empty: bare
    void advance(std::size_t index, std::vector<double>& water, std::span<const float> cover,
                 ClimateDay& day, const Progress& progress) const;

private:
    ClimateParams params_;
    SurfaceCells cells_;
    Weather weather_;
    Site site_;
    light::Coefficients coefficients_;
    std::vector<std::int32_t> geology_;
    std::vector<std::uint8_t> soil_index_;
    std::vector<soil::Soil> soils_;
    std::vector<float> depth_;
    std::vector<double> capacity_;
    bool has_wind_ = false;
    std::array<std::vector<float>, 8> wind_ratio_;
    wind::AirTables tables_;
    std::vector<std::uint8_t> layer_;  ///< of tables_.layers, for each cell
    soil::Paths paths_;
    double area_ = 0;
};

/// Index of a soil in a list by name, or one read from a .toml file.
soil::Soil find_soil(const std::string& name, const std::filesystem::path& folder);

/// The points `air_tables`: one for each direction the wind may blow from, at the origin.
Points table_points(const wind::AirTables& tables);
wind::AirTables tables_of(const Scene& scene);

/// The points `daylight`: one at each cell, with the words of its bits and its links.
Points daylight_points(const light::Coefficients& coefficients, const SurfaceCells& cells);
/// Coefficients from `daylight`, `sky_view`, `rain_exposure` and the light stage's parameters in
/// the scene's history.
light::Coefficients coefficients_of(const Scene& scene, const SurfaceCells& cells);

}  // namespace sekitei::apps
