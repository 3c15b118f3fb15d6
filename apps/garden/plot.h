#pragma once

#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/image.h"
#include "core/mesh.h"
#include "core/params.h"
#include "core/progress.h"
#include "grids/scene.h"

/// A piece of ground on which stones, a lantern and a pond are set: what climate, trees and forest
/// then meet.
namespace sekitei::garden {

/// Lists are rows of numbers, separated by ';', numbers by commas; trailing ones may be left out.
/// Places are metres east and north of the plot's middle.
struct PlotParams {
    std::vector<double> size{12, 10};
    Vec3d centre;
    double cell = 0.04;
    std::string stones, lantern;
    double relief = 0.25, relief_wavelength = 4;
    std::string pond, islet;
    double depth = 0.6, bank = 0.12, shore = 0.25;
    std::string soil = "humus";
    double soil_depth = 0.05;
    std::filesystem::path height_map;
    std::optional<double> metres_per_pixel, height_low, height_high;
    std::string cuts;
    double land = 40;

    static void describe(auto&& field)
    {
        field("size", &PlotParams::size, "m", kPositive,
              "the plot from west to east and from south to north, or one for both: where the "
              "ground has a climate of its own");
        field("centre", &PlotParams::centre, "m", kAny, "its middle in the world");
        field("cell", &PlotParams::cell, "m", between(0.005, 1), "edge of the surface cells");
        field("stones", &PlotParams::stones,
              "where rocks of the scenes that it reads stand: x, y, depth in the ground [m], turn "
              "[deg], scale, number of the scene from 0; several separated by ';'");
        field("lantern", &PlotParams::lantern,
              "x, y, turn [deg] of the stone lantern; empty: none");
        field("relief", &PlotParams::relief, "m", kNotNegative, "height of mounds of the ground");
        field("relief_wavelength", &PlotParams::relief_wavelength, "m", kPositive,
              "from mound to mound");
        field("pond", &PlotParams::pond,
              "x, y, length, width [m], turn [deg] of the pond; empty: none");
        field("islet", &PlotParams::islet,
              "x, y, radius [m] of islets in it; several separated by ';'");
        field("depth", &PlotParams::depth, "m", kPositive, "of the pond");
        field("bank", &PlotParams::bank, "m", between(0.01, 10),
              "by which level ground stands above the water");
        field("shore", &PlotParams::shore, "", between(0, 0.5),
              "how much the shore winds, as a share of the width");
        field("soil", &PlotParams::soil,
              "soil of the ground between stones: humus, sand, rock or asphalt");
        field("soil_depth", &PlotParams::soil_depth, "m", between(0.001, 1), "of that soil");
        field("height_map", &PlotParams::height_map,
              "PNG whose grey is the height of the land, its south-western corner at 0, 0; empty: "
              "level");
        field("metres_per_pixel", &PlotParams::metres_per_pixel, "m", kPositive,
              "horizontal size of its pixels; must be given with one");
        field("height_low", &PlotParams::height_low, "m", kAny,
              "height of its black; must be given with one");
        field("height_high", &PlotParams::height_high, "m", kAny,
              "height of its white; must be given with one");
        field("cuts", &PlotParams::cuts,
              "benches that are cut into the land: x, y, height of the floor, length, width [m], "
              "turn [deg]; several separated by ';'");
        field("land", &PlotParams::land, "m", between(0, 1e5),
              "how far pictures show the land around the plot");
    }
};

/// @throws InvalidParameter  a number out of its range, a list that is none, a stone of a scene
/// that
///                           is not there, a stone, lantern or pond outside the plot, a height map
///                           without its sizes or sizes without it
void validate(const PlotParams& params, std::size_t scenes);

/// What a face of the mesh is, as its attribute `surface`; lower numbers are those of rock, see
/// lava.
inline constexpr std::int32_t kGroundSurface = 6, kDressedSurface = 7;

/// Places rocks on a piece of ground.
///
/// The ground is level or as the height map says, less the cuts, plus mounds that fade towards the
/// plot's border. A rock, the surface of `density` at 1/2, stands with the middle of its box at
/// (x, y) and its lowest point so deep below the lowest ground around it; it is turned about the
/// vertical. The pond's shore is an ellipse that gradient noise bends; its water stands `bank`
/// below the ground at its middle.
///
/// @return `surface_sdf` with the box of the plot as domain, whose floor is the water's level where
///         there is a pond, so that only dry ground has cells; `geology` and `soil_h` of its band;
///         `water_surface`; on pixels of 1 m, one layer: `ground_height` [m], `blocked_height` [m]
///         of stones above it, `plantable` (0 on the plot and in the pond); the mesh `rock`:
///         stones as finely as they were made, lantern, ground out to `land`, face attributes
///         `column` (each stone's own numbers), `component`, `surface`.
/// @param rocks      scenes with `density` and, if they like, `column`, `component`, `surface`
/// @param land       the height map, null: level
/// @throws InvalidInput   a density without a surface; a level set cannot be made
/// @throws LimitExceeded  more cells than `most_cells`
///
/// The same bytes for any number of threads.
Scene make_plot(const PlotParams& params, std::span<const Scene* const> rocks, const Image16* land,
                std::uint64_t seed, double most_cells, const Progress& progress);

/// Cells that its ground alone has.
double plot_cells(const PlotParams& params);

}  // namespace sekitei::garden
