#pragma once

#include <optional>
#include <string>
#include <vector>

#include "apps/ground.h"
#include "apps/stage.h"
#include "core/progress.h"
#include "core/weather.h"
#include "grids/scene.h"
#include "grids/surface_cells.h"
#include "solvers/light/light.h"
#include "solvers/sun/sun.h"
#include "solvers/wind/air.h"

/// The climate of a scene's surface, day by day: what light, wind and soil left in the scene, put
/// together with the weather. Solvers do not call each other; this is where their results meet.
namespace sekitei::apps {

/// The series `weather` of a scene: a point a day, at the origin, with an attribute for each field.
Points weather_points(const Weather& weather);
/// @throws InvalidInput  no days, an attribute that is missing
Weather weather_of(const Scene& scene);

/// The state of every cell on one day; arrays have the size of the cells.
struct ClimateDay : GroundDay {
    light::Light light;
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
    Climate(const Climate&) = delete;  // the ground views the cells
    Climate& operator=(const Climate&) = delete;

    const SurfaceCells& cells() const { return cells_; }
    const Weather& weather() const { return weather_; }
    const Ground& ground() const { return ground_; }
    const light::Coefficients& coefficients() const { return coefficients_; }

    /// Goes on with the weather from its beginning where it is shorter than `days`.
    /// @throws InvalidParameter  it holds no whole year
    void repeat(std::size_t days) { weather_ = select_days(weather_, 0, days, true); }

    /// One day from yesterday's water.
    /// @param index  day of weather()
    /// @param water  O at yesterday's end [mm]; becomes today's
    /// @param cover  share covered by moss; empty: bare
    void advance(std::size_t index, std::vector<double>& water, std::span<const float> cover,
                 ClimateDay& day, const Progress& progress) const;

private:
    SurfaceCells cells_;
    Weather weather_;
    Site site_;
    light::Coefficients coefficients_;
    Ground ground_;
};

/// The points `air_tables`: one for each direction the wind may blow from, at the origin.
Points table_points(const wind::AirTables& tables);
wind::AirTables tables_of(const Scene& scene);

/// The points `daylight`: one at each cell, with the words of its bits and its links.
Points daylight_points(const light::Coefficients& coefficients, const SurfaceCells& cells);
/// Coefficients from `daylight`, `sky_view`, `rain_exposure` and the light stage's parameters in
/// the scene's history.
light::Coefficients coefficients_of(const Scene& scene, const SurfaceCells& cells);

}  // namespace sekitei::apps
