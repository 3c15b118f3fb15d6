#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "apps/stage.h"
#include "core/image.h"
#include "solvers/forest/edits.h"
#include "solvers/forest/land.h"

/// Maps of a forest from pictures, volumes and numbers.
///
/// A word for a map is FILE.png, FILE.vdb, FILE.vdb:GRID or a number, which counts everywhere.
/// Pictures are grey with north up: row 0 is the northern edge. Their size is the forest's in
/// pixels; another one is an error unless `fit` stretches it, each pixel taking the nearest.
/// Volumes are float or integer grids whose index is the pixel, z = 0; voxels without a value have
/// the background.
namespace sekitei::apps {

/// The pixels of a forest.
struct ForestFrame {
    int width = 512, depth = 512;
    double pixel = 1;  ///< [m]
    Vec3d corner{};    ///< of pixel (0, 0) in the world [m]
    bool fit = false;  ///< stretch maps of another size
};

/// One word for a map, taken apart.
struct MapWord {
    std::string option;  ///< "density", for messages
    std::string text;    ///< as written
    std::string name;    ///< "water" of "water=wet.png"
    std::filesystem::path file;
    std::string grid;
    std::optional<double> number;
    /// Values of black and white, of "heat.png[-5..25]".
    std::optional<std::array<double, 2>> range;
};

/// @param named  whether each begins with "NAME="
/// @throws InvalidParameter
std::vector<MapWord> map_words(const std::string& option, const std::string& text, bool named);
/// Files of such a text, for Stage::files().
std::vector<std::filesystem::path> map_files(const std::string& text, bool named);

/// The density maps, one a band of slices, from words separated by commas. One word serves all
/// bands; else there are as many as bands; none is 1 everywhere. A grid with several layers has one
/// a band, index z = 0 the lowest.
/// @throws InvalidParameter  the number of maps, a number that is not 0 to 1
/// @throws InvalidInput      a file: not there, not readable, of another size, values outside 0 to
/// 1
std::vector<forest::DensityMap> read_density(const std::string& text, int bands,
                                             const ForestFrame& frame, const StageContext& context);

/// "water=wet.png,temperature=heat.png[-5..25],light=0.8".
/// @throws InvalidParameter, InvalidInput
std::vector<forest::Factor> read_environment(const std::string& text, const ForestFrame& frame,
                                             const StageContext& context);

/// One map, e.g. `blocked_height`: "rocks.png[0..12]".
/// @throws InvalidParameter, InvalidInput
forest::Raster<float> read_map(const std::string& option, const std::string& text,
                               const ForestFrame& frame, const StageContext& context);
/// 0 where a map is 0, else 1.
forest::Raster<std::uint8_t> read_mask(const std::string& option, const std::string& text,
                                       const ForestFrame& frame, const StageContext& context);

/// Where the ground of a forest lies.
struct TerrainParams {
    std::string terrain;
    std::optional<double> metres_per_pixel, height_low, height_high;

    static void describe(auto&& field)
    {
        field(
            "terrain", &TerrainParams::terrain,
            "height of the ground: a PNG, or a VDB file with a grid `terrain_height`, a level set "
            "or a density, whose highest surface counts; FILE.vdb:GRID names the grid");
        field("metres_per_pixel", &TerrainParams::metres_per_pixel, "m", kPositive,
              "horizontal size of a terrain picture's pixel; auto: the forest's");
        field("height_low", &TerrainParams::height_low, "m", kAny,
              "height of a terrain picture's black; must be given with one");
        field("height_high", &TerrainParams::height_high, "m", kAny,
              "height of its white; must be given with one");
    }
};
/// @throws InvalidParameter
void validate(const TerrainParams& params);

/// Height of the ground above the frame's corner [m]; empty without a terrain.
///
/// A picture is bilinear between the centres of its pixels; its south-western corner is the
/// forest's, and its heights are above that corner. Volumes have heights in the world: one layer of
/// them, as a forest leaves it in `terrain_height`, or a level set or a density, of which the
/// highest surface in each pixel's columns of voxels counts; where there is none the ground is at
/// the corner's height.
/// @throws InvalidParameter, InvalidInput
forest::Raster<float> read_terrain(const TerrainParams& params, const ForestFrame& frame,
                                   const StageContext& context);

/// Grids of one layer that a scene may bring a forest: height of the ground in the world [m], of
/// rocks above it [m], 0 where nothing may germinate.
inline constexpr const char *kGroundHeight = "ground_height", *kBlockedHeight = "blocked_height",
                            *kPlantable = "plantable";
/// Fills those rasters of `land` that are empty from them; each pixel takes the voxel that its
/// middle lies in, beyond them their background.
void take_land(forest::Land& land, const Scene& scene, const ForestFrame& frame);

/// A picture of a map, north up.
Image16 map_image(const forest::DensityMap& map);
Image8 mask_image(const forest::Raster<std::uint8_t>& mask);
/// The same back, or stretched to the frame.
/// @throws InvalidInput  of another size
forest::DensityMap image_map(const Image16& image, const std::string& name,
                             const ForestFrame& frame);
forest::Raster<std::uint8_t> image_mask(const Image16& image, const std::string& name,
                                        const ForestFrame& frame);

/// Density maps that somebody paints while the forest grows.
class MapWatcher {
public:
    /// Reads them for the first time; see read_density().
    MapWatcher(std::string text, int bands, const ForestFrame& frame, const StageContext& context);

    const std::vector<forest::DensityMap>& maps() const { return maps_; }
    /// Looks at the files again: an Edit::Image of this step for each map that is another one now.
    /// A file that cannot be read, e.g. because it is half written, keeps its map; that is told
    /// once, and the next look tries again.
    std::vector<forest::Edit> changes(int step);

private:
    /// Contents of the files by name; empty where one cannot be read.
    std::map<std::string, std::string> hashes() const;

    std::string text_;
    int bands_;
    ForestFrame frame_;
    StageContext context_;
    std::map<std::string, std::string> known_;  ///< hashes of what `maps_` holds
    std::vector<forest::DensityMap> maps_;
    std::string told_;  ///< why the files cannot be read now
};

}  // namespace sekitei::apps
