#pragma once

#include <memory>
#include <optional>
#include <string>

#include "apps/exchange/files.h"
#include "apps/stage.h"

/// The stage `export` as the command of that name knows it.
namespace sekitei::apps {

struct ExportParams {
    std::string points = "moss";
    TreeDetail trees = TreeDetail::Far;
    int moss_lod = 1;
    Season season = Season::Auto;
    double leaf_scale = 1;
    std::optional<double> tuft_size;
    bool fields = true;
    std::string map = "height";
    std::optional<double> metres_per_pixel;
    bool half = false;

    static void describe(auto&& field)
    {
        field("points", &ExportParams::points,
              "points of the scene that a .ply file has; with --to the surfaces where this is not "
              "given");
        field("trees", &ExportParams::trees,
              "models of a forest's trees: near (20 000 leaves each), middle (2500), far (300)");
        field("moss_lod", &ExportParams::moss_lod, "", between(0, 2),
              "models of moss plants: 0 (2000 triangles), 1 (220), 2 (22)");
        field("season", &ExportParams::season,
              "leaves of trees: auto (by species), green, autumn, blossom or bare (none)");
        field("leaf_scale", &ExportParams::leaf_scale, "", between(0.01, 100),
              "how much larger than they are single leaves of trees become");
        field("tuft_size", &ExportParams::tuft_size, "m", kPositive,
              "diameter of a full-grown moss plant; auto: as `render` draws it");
        field("fields", &ExportParams::fields,
              "light, soil, moss and other fields of the surface at its vertices");
        field("map", &ExportParams::map,
              "what a .png shows from above: height, a field of the surface or a grid one voxel "
              "high");
        field("metres_per_pixel", &ExportParams::metres_per_pixel, "m", kPositive,
              "of .png; auto: pixels of the grid, or a 1024th of the longer side");
        field("half", &ExportParams::half, "16-bit floats in .vdb");
    }
};

/// A stage whose files show more than its result does, the points.
class ExportingStage : public Stage {
public:
    /// Told before anything else which files are asked of it, by name.
    virtual void asked_for(const std::vector<std::string>& files) = 0;
    /// What it reads besides needs() of all that is there.
    virtual std::vector<std::string> chooses(const std::vector<std::string>& present) const = 0;
    /// Writes one of the files, from what it chose.
    virtual void write(const Scene& scene, const std::filesystem::path& file,
                       const StageContext& context) = 0;
    /// Told when all its files are written.
    virtual void done() = 0;
    virtual ExportOptions options(const StageContext& context) const = 0;
};
std::unique_ptr<ExportingStage> make_exporting_stage();

}  // namespace sekitei::apps
