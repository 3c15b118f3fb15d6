#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/params.h"
#include "core/progress.h"
#include "core/solar_day.h"
#include "core/weather.h"
#include "solvers/soil/soil.h"
#include "solvers/wind/air.h"

/// Air, rain and soil of a surface under a day's weather. A site is a surface cell of a volume or a
/// face of a mesh: this is written once for both.
namespace sekitei::apps {

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

/// Index of a soil in a list by name, or one read from a .toml file.
soil::Soil find_soil(const std::string& name, const std::filesystem::path& folder);

/// Geology of a soil from a file.
inline constexpr int kOwnSoil = 100;
/// 1.. of soil::preset_soils(), else kOwnSoil.
int geology_of_soil(const std::string& name);
/// Depth of soil that holds water in rock and asphalt [mm].
inline constexpr float kSkinDepth = 20;
/// Whether a geology is rock or harder.
inline bool is_stone(int geology)
{
    return geology >= 3 && geology != kOwnSoil;
}

/// What is known of the sites; arrays have one value each, or none where said.
struct GroundSites {
    std::span<const float> area;           ///< [m^2]; must outlive the ground, like the two below
    std::span<const float> sky_view;       ///< V
    std::span<const float> rain_exposure;  ///< e
    std::vector<std::int32_t> geology;     ///< 1.. of soil::preset_soils(), or kOwnSoil
    std::vector<float> depth;              ///< h [mm]
    soil::Soil own;                        ///< of kOwnSoil
    /// Local speed / speed before the object, of each direction; empty: as in the weather.
    std::array<std::vector<float>, 8> wind_ratio;
    wind::AirTables tables;
    std::vector<std::uint8_t> layer;  ///< of tables.layers; empty without layers
    soil::Paths paths;                ///< of runoff; empty without
};

/// The state of every site on one day.
struct GroundDay {
    WeatherDay weather;
    std::vector<float> wind, air_temperature, air_humidity;
    soil::Runoff rain;  ///< supply: what falls on each site and runs onto it [mm]
    soil::Result ground;
    double rainfall = 0, inflow = 0, evaporation = 0, outflow = 0;  ///< of the surface [mm m^2]
    double balance_error = 0;  ///< water that is not accounted for / water that came
};

class Ground {
public:
    Ground() = default;
    /// @param params  validated; what is auto follows the profile
    Ground(const ClimateParams& params, Site site, GroundSites sites);

    std::size_t size() const { return s_.area.size(); }
    std::span<const float> site_area() const { return s_.area; }
    const std::vector<std::int32_t>& geology() const { return s_.geology; }
    const std::vector<float>& depth() const { return s_.depth; }  ///< h [mm]
    const std::vector<soil::Soil>& soils() const { return soils_; }
    double area() const { return area_; }  ///< of all sites [m^2]
    bool has_wind() const { return !s_.wind_ratio[0].empty(); }
    const wind::AirTables& tables() const { return s_.tables; }

    std::size_t bytes() const;

    /// Water of each site at the start [mm].
    std::vector<double> initial_water() const;

    /// One day from yesterday's water.
    /// @param light  S of each site [W/m^2]
    /// @param water  O at yesterday's end [mm]; becomes today's
    /// @param cover  share covered by moss; empty: bare
    void advance(const WeatherDay& weather, std::span<const float> light,
                 std::vector<double>& water, std::span<const float> cover, GroundDay& day,
                 const Progress& progress) const;

    /// The day of one site again, in another light.
    /// @param day    as advance() left it
    /// @param water  O at yesterday's end [mm]
    soil::Day day_at(std::size_t site, const GroundDay& day, double light, double water,
                     double cover) const;

private:
    static soil::Air air_of(const WeatherDay& weather);

    ClimateParams params_;
    Site site_;
    GroundSites s_;
    std::vector<std::uint8_t> soil_index_;
    std::vector<soil::Soil> soils_;
    std::vector<double> capacity_;
    double area_ = 0;
};

/// What a profile means where a switch is auto.
ClimateParams resolved(ClimateParams params);

}  // namespace sekitei::apps
