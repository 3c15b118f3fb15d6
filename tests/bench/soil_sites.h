#pragma once

#include <span>
#include <vector>

#include "solvers/soil/soil.h"

namespace sekitei::bench {

/// What the day of soil takes of each site; one air and one soil for all.
struct SoilSites {
    std::vector<double> water, rain;
    std::vector<float> light, wind, sky, cover, depth;

    soil::Inputs inputs() const
    {
        return {.water = water,
                .light = light,
                .temperature = 288.5F,
                .humidity = 0.8F,
                .rain = rain,
                .wind = wind,
                .sky_view = sky,
                .cover = cover,
                .depth = depth,
                .soil = {},
                .soils = std::span(soil::preset_soils()).first(1),
                .air = {0.5, 1013, {}}};
    }
};

}  // namespace sekitei::bench
