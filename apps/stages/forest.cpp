#include "apps/forest.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <thread>

#include "apps/forest_edits.h"
#include "apps/forest_folder.h"
#include "apps/forest_instances.h"
#include "apps/forest_maps.h"
#include "apps/forest_species.h"
#include "apps/habitat.h"
#include "apps/specimens.h"
#include "apps/stages/stages.h"
#include "apps/trees.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/hash.h"
#include "core/log.h"
#include "core/machine.h"
#include "core/math.h"
#include "core/units.h"
#include "grids/vdb_file.h"
#include "solvers/forest/canopy.h"
#include "solvers/forest/instances.h"

namespace sekitei::apps {
namespace {

namespace fs = std::filesystem;
using forest::Forest;
using forest::StepStatistics;

struct ForestParams {
    std::vector<double> size{512};
    Vec3d corner;
    int steps = 50;
    std::string species = kForestTable, initial = "1000", density = "1";
    bool fit = false;
    fs::path edits;
    std::string environment, plantable, blocked_height;
    std::optional<double> temperature;
    double lapse_rate = 0.0065;
    forest::Combine combine = forest::Combine::Minimum;
    fs::path wind;
    double wind_speed = 0, wind_azimuth = 4.71238898038468985;  // from the west
    int every = 0, sequence = 0;
    bool canopy = true, occupancy = false;
    double extinction = 0.5, drag = 0.2;
    std::optional<Vec3d> sun;
    std::string heroes;
    int variants = 3;
    std::vector<double> ages{12, 22, 40};
    std::string instances, fallen, out_of_core;
    std::vector<double> window;
    bool watch_maps = false;
    double step_seconds = 0;
    std::string edit_log;

    static void describe(auto&& field)
    {
        field("size", &ForestParams::size, "m", kPositive,
              "west to east and south to north, or one for both; multiples of the pixel");
        field("corner", &ForestParams::corner, "m", kAny,
              "world position of the south-western corner of the ground");
        field("steps", &ForestParams::steps, "", between(0, 100000),
              "how many it grows, about five years each; in a scene with a forest, or with "
              "out_of_core: up to this number");
        field("species", &ForestParams::species,
              "table-5.1 or a .toml file of [[species]]; with ':tall,shrub' after it only these");
        field("initial", &ForestParams::initial,
              "trees to begin with: a number for each species, several separated by commas, or a "
              ".csv file with the columns species,x,y,height");
        field("density", &ForestParams::density,
              "density maps 0..1 of the bands of slices, the lowest first, separated by commas: "
              "numbers, PNG files or VDB grids; one serves all bands");
        field("fit", &ForestParams::fit, "stretch maps of another size to the forest's");
        field("edits", &ForestParams::edits,
              ".toml file of [[edit]]: maps changed, trees felled and planted at given steps");
        field("environment", &ForestParams::environment,
              "maps that species have limits of: water=wet.png,temperature=heat.png[-5..25]");
        field("temperature", &ForestParams::temperature, "C", between(-100, 100),
              "at the corner's height: makes the factor temperature from the terrain");
        field("lapse_rate", &ForestParams::lapse_rate, "", kNotNegative,
              "with temperature: fall with height in degrees a metre");
        field("plantable", &ForestParams::plantable, "map, 0 where nothing may germinate");
        field("blocked_height", &ForestParams::blocked_height,
              "map of the height of rocks above the ground in metres, whose space is taken");
        field("combine", &ForestParams::combine, "how factors act together on growth");
        field("wind", &ForestParams::wind,
              "with windthrow: scene with the grid vel; empty: wind_speed everywhere");
        field("wind_speed", &ForestParams::wind_speed, "m/s", between(0, 200),
              "with windthrow: the wind where no scene gives it");
        field("wind_azimuth", &ForestParams::wind_azimuth, "rad", kAny,
              "with windthrow: where that wind comes from, clockwise from north");
        field("every", &ForestParams::every, "", between(0, 100000),
              "also write a scene every so many steps, numbered beside the last one; 0: only the "
              "last");
        field("sequence", &ForestParams::sequence, "", between(0, 100000),
              "the same, so many scenes of the whole growth; 0: only the last");
        field("canopy", &ForestParams::canopy,
              "leaves as fog, for light, wind and moss: canopy_lad and its kin");
        field("occupancy", &ForestParams::occupancy,
              "the space of every tree as the grid forest_occupancy, which holds its rank, the "
              "attribute `rank` of forest_trees; and the maps as forest_density");
        field("extinction", &ForestParams::extinction, "", between(0, 10),
              "with canopy: share of a leaf area that is its shadow");
        field("drag", &ForestParams::drag, "", between(0, 10),
              "with canopy: drag coefficient of leaves");
        field("sun", &ForestParams::sun, "", kAny,
              "with canopy: x,y,z towards the sun, along which canopy_transmittance is worked out; "
              "auto: upwards");
        field(
            "heroes", &ForestParams::heroes,
            "trees that the tree stage is to grow in place: the highest whose cone reaches x,y in "
            "the world, or else the nearest; several separated by ';'");
        field("variants", &ForestParams::variants, "", between(1, 64),
              "models of each kind of tree");
        field("ages", &ForestParams::ages, "", between(1, 200), "generations of the models");
        field("instances", &ForestParams::instances,
              "by command, not in recipes: file of the trees for other programs, .ply, .csv or "
              ".usda; empty: none");
        field("fallen", &ForestParams::fallen,
              "by command: .csv file of trees that the wind threw; empty: none");
        field("out_of_core", &ForestParams::out_of_core,
              "by command: folder where trees are kept, for forests larger than memory; a run that "
              "was interrupted goes on from there");
        field("window", &ForestParams::window, "m", kNotNegative,
              "with out_of_core: west, south, east, north of the part that the scene shows; empty: "
              "none");
        field("watch_maps", &ForestParams::watch_maps,
              "by command: look at the density maps' files before every step, to paint meanwhile");
        field("step_seconds", &ForestParams::step_seconds, "s", between(0, 3600),
              "with watch_maps: a step takes at least so long");
        field("edit_log", &ForestParams::edit_log,
              "by command: .toml file of all edits as they acted, painted maps beside it; as "
              "`edits` it gives the same forest again");
    }
};

const char* const kGrids[] = {"canopy_lad",       "canopy_transmittance", "canopy_RU",
                              "canopy_height",    "ground_transmittance", "terrain_height",
                              "forest_occupancy", "forest_density"};

/// One number for both directions, or two.
std::array<double, 2> both(const std::vector<double>& size)
{
    if (size.empty() || size.size() > 2)
        throw InvalidParameter(
            fmt::format("forest: size: {} numbers, must be one or two", size.size()));
    return {size.front(), size.back()};
}

/// Words separated by commas, all whole numbers.
std::optional<std::vector<std::uint64_t>> counts_of(const std::string& text)
{
    std::vector<std::uint64_t> counts;
    for (const std::string& word : split_names(text)) {
        if (word.empty() || word.find_first_not_of("0123456789") != std::string::npos ||
            word.size() > 9)
            return std::nullopt;
        counts.push_back(std::stoull(word));
    }
    return counts;
}

std::vector<std::array<double, 2>> hero_places(const std::string& text)
{
    std::vector<std::array<double, 2>> places;
    for (std::size_t begin = 0; begin < text.size();) {
        const std::size_t end = std::min(text.find(';', begin), text.size());
        const std::vector<std::string> parts = split_names(text.substr(begin, end - begin));
        begin = end + 1;
        if (parts.empty()) continue;
        try {
            if (parts.size() != 2) throw InvalidParameter("expected x,y");
            places.push_back({parse_quantity(parts[0], "m"), parse_quantity(parts[1], "m")});
        } catch (const InvalidParameter& error) {
            throw InvalidParameter(
                fmt::format("forest: heroes = {}: {}; give x,y in metres, several separated by ';'",
                            text, error.what()));
        }
    }
    return places;
}

template <class T>
forest::Raster<T> cropped(const forest::Raster<T>& raster, const std::array<int, 4>& window)
{
    if (raster.empty()) return {};
    const auto [i0, i1, j0, j1] = window;
    forest::Raster<T> part(i1 - i0, j1 - j0, raster.at(i0, j0));
    for (int j = j0; j < j1; ++j)
        for (int i = i0; i < i1; ++i) part.set(i - i0, j - j0, raster.at(i, j));
    return part;
}

class ForestStage : public Stage {
public:
    const StageInfo& info() const override
    {
        static const StageInfo kInfo = [] {
            StageInfo info{"forest",
                           "1",
                           "trees claim their space from one another and sort into layers",
                           OutputKind::Scene,
                           true,
                           {},
                           {"forest_instances", "forest_heroes", "forest_trees", "forest_growth",
                            "forest_fallen"},
                           false,
                           {"forest"}};
            info.makes.insert(info.makes.end(), std::begin(kGrids), std::end(kGrids));
            info.reads_if_given = true;
            return info;
        }();
        return kInfo;
    }
    bool reads_scene() override { return false; }
    std::vector<std::string> uses() override
    {
        std::vector<std::string> names{"forest_trees", "forest_growth", "forest_fallen",
                                       "canopy_height"};
        if (terrain_.terrain.empty()) names.emplace_back(kGroundHeight);
        if (params_.plantable.empty()) names.emplace_back(kPlantable);
        if (params_.blocked_height.empty()) names.emplace_back(kBlockedHeight);
        return names;
    }
    std::vector<std::string> makes() override
    {
        std::vector<std::string> names{"forest_instances", "forest_trees", "forest_growth",
                                       "canopy_height"};
        if (!params_.heroes.empty()) names.emplace_back("forest_heroes");
        if (solver_.windthrow > 0) names.emplace_back("forest_fallen");
        if (params_.canopy)
            for (const char* name :
                 {"canopy_lad", "canopy_transmittance", "canopy_RU", "ground_transmittance"})
                names.emplace_back(name);
        if (params_.canopy) names.emplace_back("terrain_height");
        if (params_.canopy && params_.occupancy)
            for (const char* name : {"forest_occupancy", "forest_density"})
                names.emplace_back(name);
        return names;
    }
    std::vector<fs::path> files() override
    {
        std::vector<fs::path> list;
        auto add = [&](const std::vector<fs::path>& more) {
            list.insert(list.end(), more.begin(), more.end());
        };
        add(map_files(params_.density, false));
        add(map_files(params_.environment, true));
        add(map_files(params_.plantable, false));
        add(map_files(params_.blocked_height, false));
        add(map_files(terrain_.terrain, false));
        if (const fs::path file = forest_species_file(params_.species); !file.empty())
            list.push_back(file);
        if (fs::path(params_.initial).extension() == ".csv") list.emplace_back(params_.initial);
        list.insert(list.end(), pictures_.begin(), pictures_.end());
        std::ranges::sort(list);
        list.erase(std::unique(list.begin(), list.end()), list.end());
        return list;
    }
    std::vector<fs::path> side_files() override
    {
        std::vector<fs::path> list;
        for (const std::string& name : {params_.instances, params_.fallen, params_.edit_log})
            if (!name.empty()) list.emplace_back(name);
        return list;
    }
    std::vector<fs::path> side_folders() override
    {
        if (params_.out_of_core.empty()) return {};
        return {params_.out_of_core};
    }
    int frame_interval() override
    {
        if (params_.every > 0) return params_.every;
        if (params_.sequence > 0)
            return std::max(1, (params_.steps + params_.sequence - 1) / params_.sequence);
        return 0;
    }

    ParamList params() override
    {
        ParamList list = describe_params(params_);
        for (Param& p : describe_params(terrain_)) list.push_back(std::move(p));
        for (Param& p : describe_params(solver_)) list.push_back(std::move(p));
        return list;
    }

    void validate() override
    {
        validate_described("forest", params_);
        apps::validate(terrain_);
        forest::Inputs inputs = bare();
        if (solver_.windthrow > 0 && params_.wind.empty() && params_.wind_speed == 0)
            throw InvalidParameter(
                "forest: windthrow without a wind; give wind_speed or a scene with --wind");
        inputs.wind = [](double, double, double) { return Vec3d(); };  // the real one is read later
        for (int axis = 0; axis < 3; ++axis)
            if (!(std::abs(params_.corner[axis]) <= 1e7))
                throw InvalidParameter(
                    fmt::format("forest: corner = {},{},{} m, must be -1e7 to 1e7",
                                params_.corner.x, params_.corner.y, params_.corner.z));
        if (forest_species_file(params_.species).empty()) {
            inputs.species = find_forest_species(params_.species, {}, solver_.spread_mode);
            // Limits are of maps that are read later.
            for (forest::Species& s : inputs.species) s.limits.clear();
            forest::validate(inputs);
        } else {
            inputs.species = forest::table_species();
            inputs.params.spread_mode = forest::SpreadMode::ApexAngle;
            forest::validate(inputs);
        }
        forest::validate(canopy_params());
        map_words("density", params_.density, false);
        map_words("environment", params_.environment, true);
        map_words("plantable", params_.plantable, false);
        map_words("blocked_height", params_.blocked_height, false);
        hero_places(params_.heroes);
        if (params_.every > 0 && params_.sequence > 0)
            throw InvalidParameter("forest: every and sequence: give one of the two");
        if (fs::path(params_.initial).extension() != ".csv" && !counts_of(params_.initial))
            throw InvalidParameter(fmt::format(
                "forest: initial = {}: must be numbers of trees, or a .csv file", params_.initial));
        const std::string suffix = fs::path(params_.instances).extension().string();
        if (!params_.instances.empty() && suffix != ".ply" && suffix != ".csv" && suffix != ".usda")
            throw InvalidParameter(fmt::format(
                "forest: instances = {}, must end in .ply, .csv or .usda", params_.instances));
        for (const auto& [name, file, wanted] :
             {std::tuple{"fallen", params_.fallen, ".csv"},
              std::tuple{"edit_log", params_.edit_log, ".toml"},
              std::tuple{"edits", params_.edits.string(), ".toml"}})
            if (!file.empty() && fs::path(file).extension() != wanted)
                throw InvalidParameter(
                    fmt::format("forest: {} = {}, must end in {}", name, file, wanted));
        if (params_.canopy && solver_.pixel != 1)
            throw InvalidParameter(fmt::format(
                "forest: pixel = {} m: leaves as fog need pixels of 1 m; give canopy = false",
                solver_.pixel));
        const bool rows = !params_.out_of_core.empty();
        if (rows && params_.watch_maps)
            throw InvalidParameter("forest: watch_maps does not go with out_of_core");
        if (rows && frame_interval() > 0)
            throw InvalidParameter("forest: every and sequence do not go with out_of_core");
        if (!params_.window.empty() && (!rows || params_.window.size() != 4))
            throw InvalidParameter(
                "forest: window: must be west, south, east and north in metres, with out_of_core");
        if (params_.watch_maps && params_.edit_log.empty())
            throw InvalidParameter(
                "forest: watch_maps: say with edit_log = FILE.toml where painted maps are kept, "
                "so that the forest can be grown again");
        std::vector<int> ages = model_ages();
        if (ages.empty() || !std::ranges::is_sorted(ages) ||
            std::ranges::adjacent_find(ages) != ages.end())
            throw InvalidParameter("forest: ages: must be numbers that ascend");
        if (!params_.watch_maps) warn_unused(*this, {"step_seconds"}, "without watch_maps");
        if (solver_.windthrow == 0)
            warn_unused(*this, {"wind", "wind_speed", "wind_azimuth", "wind_reference", "fallen"},
                        "without windthrow");
        if (!params_.temperature) warn_unused(*this, {"lapse_rate"}, "without temperature");
        if (!params_.canopy)
            warn_unused(*this, {"occupancy", "extinction", "drag", "sun"}, "without canopy");
    }

    void check_files(const StageContext& context) override { read_inputs(context, {}); }

    Need estimate(SceneOutline& outline, const StageContext&) override
    {
        const forest::Inputs inputs = bare();
        const double area = inputs.width * inputs.depth;
        outline.domain.dims = {inputs.pixels_x(), inputs.pixels_y(), 1};
        outline.domain.transform.voxel = solver_.pixel;
        return {area * solver_.slices, memory(inputs),
                params_.out_of_core.empty() ? area * kTreesPerArea * 200 : 1e6};
    }

    Json run(Scene& scene, const StageContext& context) override
    {
        stopped.clear();
        for (const fs::path& file : side_files()) check_target(resolve(context, file));
        forest::Inputs inputs = read_inputs(context, scene);
        check_initial(inputs, context);
        check_memory("forest", memory(inputs), context.memory_limit,
                     params_.out_of_core.empty() ? "make it smaller, or keep it in a folder with "
                                                   "--out-of-core"
                                                 : "make tiles smaller with --tile");
        return params_.out_of_core.empty() ? run_in_memory(scene, std::move(inputs), context)
                                           : run_by_rows(scene, std::move(inputs), context);
    }

private:
    // --- Inputs ------------------------------------------------------------------------------

    forest::Inputs bare() const
    {
        forest::Inputs inputs;
        const auto [width, depth] = both(params_.size);
        inputs.width = width;
        inputs.depth = depth;
        inputs.params = solver_;
        return inputs;
    }
    forest::CanopyParams canopy_params() const
    {
        forest::CanopyParams params;
        params.extinction = params_.extinction;
        params.drag = params_.drag;
        params.sun = params_.sun;
        params.occupancy = params_.occupancy;
        return params;
    }
    std::vector<int> model_ages() const { return {params_.ages.begin(), params_.ages.end()}; }
    ForestFrame frame() const
    {
        const forest::Inputs inputs = bare();
        return {inputs.pixels_x(), inputs.pixels_y(), solver_.pixel, params_.corner, params_.fit};
    }

    ForestWords words(const forest::Inputs& inputs) const
    {
        return {frame(), inputs.bands(), inputs.species, inputs.seed};
    }

    /// Reads all files that parameters name; where they name none, the land is that of a scene.
    forest::Inputs read_inputs(const StageContext& context, const Scene& scene)
    {
        forest::Inputs inputs = bare();
        inputs.seed = context.seed;
        inputs.species = find_forest_species(params_.species, context.folder, solver_.spread_mode);
        const ForestFrame pixels = frame();
        inputs.density = read_density(params_.density, inputs.bands(), pixels, context);
        forest::Land& land = inputs.land;
        land.pixel = solver_.pixel;
        land.combine = params_.combine;
        land.ground = read_terrain(terrain_, pixels, context);
        if (!params_.plantable.empty())
            land.plantable = read_mask("plantable", params_.plantable, pixels, context);
        if (!params_.blocked_height.empty())
            land.blocked_height =
                read_map("blocked_height", params_.blocked_height, pixels, context);
        take_land(land, scene, pixels);
        land.factors = read_environment(params_.environment, pixels, context);
        auto given = [&](const char* name) {
            return std::ranges::any_of(land.factors,
                                       [&](const forest::Factor& f) { return f.name == name; });
        };
        if (params_.temperature) {
            if (given("temperature"))
                throw InvalidParameter(
                    "forest: temperature is given as a map of the environment and as a number");
            land.add_temperature(*params_.temperature, 0, params_.lapse_rate);
        }
        if (!given("slope")) land.add_slope();
        if (!params_.edits.empty())
            inputs.edits = read_edits(resolve(context, params_.edits), words(inputs));
        for (const forest::Edit& edit : inputs.edits) {
            if (edit.step > params_.steps)
                log::warning("forest: {}: an edit of step {} does not act in {} steps",
                             params_.edits.string(), edit.step, params_.steps);
            const auto outside = std::ranges::count_if(edit.trees, [&](const forest::NewTree& t) {
                return !(t.x >= 0 && t.x < inputs.width && t.y >= 0 && t.y < inputs.depth);
            });
            if (outside > 0)
                log::warning("forest: {}: {} trees to be planted in step {} stand outside",
                             params_.edits.string(), outside, edit.step);
        }
        kinds_.clear();
        for (const forest::Species& s : inputs.species) {
            specimen_kind(s.tree);
            if (std::ranges::find(kinds_, s.tree) == kinds_.end()) kinds_.push_back(s.tree);
        }
        if (fs::path(params_.initial).extension() != ".csv") {
            const std::size_t count = counts_of(params_.initial)->size();
            if (count != 1 && count != inputs.species.size())
                throw InvalidParameter(
                    fmt::format("forest: initial = {}: {} numbers, must be 1 or {}: one for each "
                                "species",
                                params_.initial, count, inputs.species.size()));
        }
        if (solver_.windthrow > 0) inputs.wind = wind_field(context, land);
        return inputs;
    }

    forest::WindField wind_field(const StageContext& context, const forest::Land& land) const
    {
        if (params_.wind.empty()) {
            const Vec3d wind(-params_.wind_speed * math::sin(params_.wind_azimuth),
                             -params_.wind_speed * math::cos(params_.wind_azimuth), 0);
            return [wind](double, double, double) { return wind; };
        }
        ReadOptions options;
        options.only = {"vel"};
        options.memory_limit = context.memory_limit;
        const auto scene = std::make_shared<Scene>(
            read_vdb(resolve(context, params_.wind), options, context.progress.slice(0, 0)));
        const VectorGrid* vel = &scene->vectors("vel");
        const auto ground = std::make_shared<forest::Land>();
        ground->pixel = land.pixel;
        ground->ground = land.ground;
        return [scene, vel, ground, corner = params_.corner](double x, double y, double height) {
            const Vec3d at =
                vel->transform().voxels(corner + Vec3d(x, y, ground->height_at(x, y) + height));
            return Vec3d(
                vel->value({int(std::floor(at.x)), int(std::floor(at.y)), int(std::floor(at.z))}));
        };
    }

    /// Trees that are sown at first.
    double initial_trees(const forest::Inputs& inputs) const
    {
        if (fs::path(params_.initial).extension() == ".csv") return 0;
        const std::vector<std::uint64_t> counts = *counts_of(params_.initial);
        double sum = 0;
        for (const std::uint64_t n : counts) sum += double(n);
        return counts.size() == 1 ? sum * double(inputs.species.size()) : sum;
    }
    void check_initial(const forest::Inputs& inputs, const StageContext& context) const
    {
        const double trees = initial_trees(inputs);
        if (trees > solver_.max_trees)
            throw LimitExceeded(fmt::format(
                "forest: initial = {}: {} trees, the limit is max_trees = {}; raise it with "
                "--max-trees",
                params_.initial, count_text(trees), count_text(solver_.max_trees)));
        const double limit =
            context.memory_limit > 0 ? context.memory_limit : 0.9 * physical_memory();
        check_memory("forest", 1e8 + trees * kBytesSown, limit, "sow fewer trees with --initial");
    }
    /// Seeds may be many: what is there now is what counts.
    void check_growth(const Forest& forest, const StageContext& context) const
    {
        check_memory(
            "forest",
            1e8 + double(forest.size()) * (params_.out_of_core.empty() ? kBytesPerTree : 0),
            context.memory_limit > 0 ? context.memory_limit : 0.9 * physical_memory(),
            "make it smaller, let trees sow less with --seeds-per-step, or keep it in a "
            "folder with --out-of-core");
    }

    /// Bytes at the peak: trees, what a tile works with, results.
    double memory(const forest::Inputs& inputs) const
    {
        const double trees = inputs.width * inputs.depth * kTreesPerArea,
                     tile = double(solver_.tile) * solver_.pixel;
        const double maps = inputs.width * inputs.depth / (solver_.pixel * solver_.pixel) * 2;
        if (params_.out_of_core.empty()) {
            return 1e8 + maps + trees * kBytesPerTree +
                   (params_.canopy ? forest::canopy_memory(inputs, canopy_params()) : 0.0);
        }
        // A few rows of tiles, and one as bytes.
        return 1e8 + maps + 6 * inputs.width * tile * kTreesPerArea * 60;
    }

    // --- Growth ------------------------------------------------------------------------------

    /// Trees to begin with.
    void begin(Forest& forest, const StageContext& context) const
    {
        if (fs::path(params_.initial).extension() == ".csv") {
            forest.plant(
                read_tree_list(resolve(context, params_.initial), words(forest.inputs())).trees);
            return;
        }
        std::vector<std::uint64_t> counts = *counts_of(params_.initial);
        if (counts.size() == 1) counts.assign(forest.inputs().species.size(), counts.front());
        if (const std::uint64_t left = forest.sow(counts); left > 0)
            log::info("forest: {} initial trees found no place where they may stand", left);
    }

    void go_on(Forest& forest, const Scene& scene) const
    {
        const ForestRecord record = forest_record(scene);
        auto differ = [&](const std::string& what, const std::string& was, const std::string& is) {
            throw InvalidParameter(fmt::format(
                "forest: the scene's forest has {} = {}, not {}; give the same", what, was, is));
        };
        const auto [width, depth] = both(params_.size);
        if (record.width != width || record.depth != depth)
            differ("size", fmt::format("{},{} m", record.width, record.depth),
                   fmt::format("{},{} m", width, depth));
        if (record.params.pixel != solver_.pixel)
            differ("pixel", fmt::format("{} m", record.params.pixel),
                   fmt::format("{} m", solver_.pixel));
        const auto& species = forest.inputs().species;
        if (record.species.size() != species.size())
            differ("species", fmt::format("{} kinds", record.species.size()),
                   fmt::format("{}", species.size()));
        for (std::size_t s = 0; s < species.size(); ++s)
            if (record.species[s].name != species[s].name)
                differ(fmt::format("species {}", s + 1), record.species[s].name, species[s].name);
        forest.resume(record.step, forest_trees_of(scene));
    }

    static void tell(const StepStatistics& row)
    {
        log::detail("forest: step {}: {} trees, {} seedlings, space {:.3f} s, growth {:.3f} s",
                    row.step, row.trees, row.births, row.seconds_draw, row.seconds_grow);
    }

    bool edits_wait(const Forest& forest) const
    {
        return params_.watch_maps ||
               std::ranges::any_of(forest.inputs().edits, [&](const forest::Edit& edit) {
                   return edit.kind == forest::Edit::Kind::Plant && edit.step > forest.step();
               });
    }

    Json run_in_memory(Scene& scene, forest::Inputs inputs, const StageContext& context)
    {
        const bool goes_on = scene.points.contains("forest_trees");
        if (goes_on) warn_unused(*this, {"initial"}, "with a scene's forest");
        std::optional<MapWatcher> watcher;
        if (params_.watch_maps) watcher.emplace(params_.density, inputs.bands(), frame(), context);
        std::vector<forest::Edit> done = inputs.edits;  // what acts, for the log
        Forest forest(std::move(inputs));
        std::vector<StepStatistics> growth;
        std::vector<forest::Fallen> fallen;
        if (goes_on) {
            go_on(forest, scene);
            growth = forest_growth_of(scene);
            fallen = fallen_of(scene);
            if (forest.step() > params_.steps)
                throw InvalidParameter(
                    fmt::format("forest: steps = {}: the scene's forest has grown {} already",
                                params_.steps, forest.step()));
        } else
            begin(forest, context);

        // A recipe that was interrupted goes on from here.
        const fs::path kept = goes_on || params_.watch_maps ? fs::path() : context.checkpoint;
        Json what;
        if (!kept.empty()) {
            what = identity(context);
            if (fs::exists(kept)) {
                auto found = decode_forest(read_file(kept), what, kept.string());
                if (found && found->first.step <= params_.steps) {
                    forest.resume(found->first.step, std::move(found->second));
                    growth = std::move(found->first.growth);
                    fallen = std::move(found->first.fallen);
                    log::info("forest: goes on from step {}", forest.step());
                }
            }
        }
        auto last_kept = std::chrono::steady_clock::now();

        const Progress growing = context.progress.slice(0, 0.7);
        const int every = frame_interval(), first = forest.step();
        while (forest.step() < params_.steps && (forest.size() > 0 || edits_wait(forest))) {
            const auto start = std::chrono::steady_clock::now();
            if (watcher)
                for (forest::Edit& edit : watcher->changes(forest.step() + 1)) {
                    log::info("forest: step {}: density map {} was painted anew", forest.step() + 1,
                              edit.map + 1);
                    done.push_back(edit);
                    write_log(done, forest.inputs().species, context);
                    forest.add_edit(std::move(edit));
                }
            growth.push_back(forest.advance(growing.slice(1, 1)));
            tell(growth.back());
            check_growth(forest, context);
            growing.update(double(forest.step() - first) / double(params_.steps - first));
            if (double(growth.back().trees) > solver_.max_trees) {
                stopped = fmt::format(
                    "forest: {} trees after step {}, the limit is max_trees = {:.0f}; the scene is "
                    "that of this step",
                    growth.back().trees, forest.step(), solver_.max_trees);
                break;
            }
            if (every > 0 && context.frame &&
                (forest.step() % every == 0 || forest.step() == params_.steps)) {
                put(scene, forest, params_.corner, growth, all(fallen, forest), context);
                context.frame(forest.step(), scene);
            }
            if (watcher && params_.step_seconds > 0) wait_until(start, context);
            if (!kept.empty() && std::chrono::steady_clock::now() - last_kept > kKeepEvery) {
                write_file(kept, encode_forest(what, {forest.step(), growth, all(fallen, forest)},
                                               forest.trees()));
                last_kept = std::chrono::steady_clock::now();
            }
        }
        if (forest.size() == 0)
            log::warning("forest: no tree is left after step {}", forest.step());
        put(scene, forest, params_.corner, growth, all(fallen, forest), context);
        write_log(done, forest.inputs().species, context);
        write_side_files(forest, all(fallen, forest), context);
        if (!kept.empty()) {
            std::error_code ignored;
            fs::remove(kept, ignored);  // the result itself is kept now
        }
        return summary_of(forest, growth);
    }

    static std::vector<forest::Fallen> all(std::vector<forest::Fallen> before, const Forest& forest)
    {
        before.insert(before.end(), forest.fallen().begin(), forest.fallen().end());
        return before;
    }

    void wait_until(std::chrono::steady_clock::time_point start, const StageContext& context) const
    {
        const auto end = start + std::chrono::duration<double>(params_.step_seconds);
        while (std::chrono::steady_clock::now() < end) {
            context.progress.check();
            std::this_thread::sleep_for(std::chrono::milliseconds(20));
        }
    }

    /// What the trees of a step depend on.
    Json identity(const StageContext& context)
    {
        Json values = params_json(params());
        for (const char* free :
             {"steps",    "instances",  "fallen",       "out_of_core", "window",
              "edit_log", "canopy",     "occupancy",    "extinction",  "drag",
              "sun",      "heroes",     "variants",     "ages",        "every",
              "sequence", "watch_maps", "step_seconds", "corner",      "max_trees"})
            values.erase(free);
        values["seed"] = context.seed;
        const Json hashes = input_hashes(*this, context);
        for (const auto& [name, hash] : hashes.items()) values["file " + name] = hash;
        return values;
    }

    Json run_by_rows(Scene& scene, forest::Inputs inputs, const StageContext& context)
    {
        const std::array<int, 4> window = window_pixels();
        ForestFolder folder(resolve(context, params_.out_of_core), identity(context),
                            context.progress.slice(0, 0));
        const std::vector<forest::Edit> edits = inputs.edits;
        Forest forest(std::move(inputs), folder);
        ForestFolder::State state;
        if (folder.state()) {
            state = *folder.state();
            forest.resume(state.step);
            if (state.step > params_.steps)
                throw InvalidParameter(
                    fmt::format("forest: steps = {}: the forest in {} has grown {} already",
                                params_.steps, params_.out_of_core, state.step));
            log::info("forest: goes on from step {} in {}", state.step, params_.out_of_core);
        } else
            begin(forest, context);

        const std::vector<forest::Fallen> before = state.fallen;
        const Progress growing = context.progress.slice(0, 0.9);
        const int first = forest.step();
        while (forest.step() < params_.steps && (forest.size() > 0 || edits_wait(forest))) {
            const double done = double(forest.step() - first), all_steps = params_.steps - first;
            state.growth.push_back(
                forest.advance(growing.slice(done / all_steps, (done + 1) / all_steps)));
            tell(state.growth.back());
            state.step = forest.step();
            state.fallen = all(before, forest);
            folder.keep(state);
            if (double(state.growth.back().trees) > solver_.max_trees) {
                stopped = fmt::format(
                    "forest: {} trees after step {}, the limit is max_trees = {:.0f}; the folder "
                    "holds this step",
                    state.growth.back().trees, forest.step(), solver_.max_trees);
                break;
            }
        }
        if (forest.size() == 0)
            log::warning("forest: no tree is left after step {}", forest.step());
        if (params_.window.empty()) {
            for (const char* name : {"forest_instances", "forest_trees", "forest_heroes"})
                scene.points.erase(name);
            put_settings(scene, record_of(forest, params_.corner), {});
            put_history(scene, state.growth, state.fallen);
        } else
            put_window(scene, forest, window, state, context);
        write_log(edits, forest.inputs().species, context);
        write_side_files(forest, state.fallen, context);
        return summary_of(forest, state.growth);
    }

    // --- Results -----------------------------------------------------------------------------

    ForestRecord record_of(const Forest& forest, Vec3d corner) const
    {
        ForestRecord record;
        record.width = forest.inputs().width;
        record.depth = forest.inputs().depth;
        record.corner = corner;
        record.params = forest.inputs().params;
        record.species = forest.inputs().species;
        record.models.kinds = kinds_;
        record.models.variants = params_.variants;
        record.models.generations = model_ages();
        record.step = forest.step();
        record.seed = forest.inputs().seed;
        return record;
    }

    static void put_settings(Scene& scene, const ForestRecord& record, FloatGrid height)
    {
        scene.put("canopy_height", std::move(height), "m", "forest");
        scene.grids.at("canopy_height").extra[kForestSettings] = forest_settings(record);
    }

    static std::vector<forest::Fallen> fallen_of(const Scene& scene)
    {
        std::vector<forest::Fallen> list;
        const auto found = scene.points.find("forest_fallen");
        if (found == scene.points.end()) return list;
        const Points& points = found->second;
        const auto* uid = points.values<std::int64_t>("id");
        const auto *step = points.values<std::int32_t>("step"),
                   *species = points.values<std::int32_t>("species");
        const auto *azimuth = points.values<double>("azimuth"),
                   *length = points.values<double>("length"), *x = points.values<double>("x"),
                   *y = points.values<double>("y");
        if (!uid || !step || !species || !azimuth || !length || !x || !y)
            throw InvalidInput(
                "forest_fallen: needs the attributes id, step, species, azimuth, length, x and y");
        for (std::size_t k = 0; k < uid->size(); ++k)
            list.push_back({unsigned_bits((*uid)[k]), (*step)[k], (*species)[k], (*x)[k], (*y)[k],
                            (*azimuth)[k], (*length)[k]});
        return list;
    }

    void put_history(Scene& scene, const std::vector<StepStatistics>& growth,
                     const std::vector<forest::Fallen>& fallen) const
    {
        put_forest_growth(scene, growth);
        scene.points.erase("forest_fallen");
        if (fallen.empty()) return;
        Points points;
        points.stage = "forest";
        std::vector<std::int64_t> uid;
        std::vector<std::int32_t> step, species;
        std::vector<double> azimuth, length, x, y;
        for (const forest::Fallen& f : fallen) {
            points.position.push_back(params_.corner + Vec3d(f.x, f.y, 0));
            uid.push_back(signed_bits(f.uid));
            step.push_back(f.step);
            species.push_back(f.species);
            azimuth.push_back(f.azimuth);
            length.push_back(f.length);
            x.push_back(f.x);
            y.push_back(f.y);
        }
        points.attributes = {{"id", std::move(uid)},
                             {"step", std::move(step)},
                             {"species", std::move(species)},
                             {"azimuth", std::move(azimuth)},
                             {"length", std::move(length)},
                             {"x", std::move(x)},
                             {"y", std::move(y)}};
        scene.points["forest_fallen"] = std::move(points);
    }

    /// Numbers of the models that instances are fitted to.
    forest::ModelTable model_table(const Forest& forest, const Progress& progress)
    {
        if (models_.crown_radius.empty()) {
            std::vector<tree::Species> kinds;
            for (const std::string& kind : kinds_) kinds.push_back(specimen_kind(kind));
            SpecimenParams params;
            params.variants = params_.variants;
            params.generations = model_ages();
            // USD files hold the models themselves.
            const bool meshes = fs::path(params_.instances).extension() == ".usda";
            specimens_ = grow_specimens(
                kinds, params, std::span(kFileDetails).subspan(meshes ? 2 : kFileDetails.size()),
                {}, progress);
            for (const Specimen& model : specimens_)
                models_.crown_radius.push_back(model.crown_radius);
            models_.variants = params_.variants;
            models_.ages = int(params.generations.size());
            models_.kind.clear();
            for (const forest::Species& s : forest.inputs().species)
                models_.kind.push_back(int(std::ranges::find(kinds_, s.tree) - kinds_.begin()));
        }
        return models_;
    }

    /// Places in `trees` of those asked for, each once: of each place the highest tree whose cone
    /// reaches it, which is seen there from above; where there is none, the nearest.
    std::vector<std::size_t> hero_trees(const Forest& forest,
                                        const std::vector<forest::Tree>& trees, Vec3d corner) const
    {
        std::vector<std::size_t> chosen;
        for (const auto& [x, y] : hero_places(params_.heroes)) {
            const forest::Inputs& inputs = forest.inputs();
            if (!(x >= corner.x && x < corner.x + inputs.width && y >= corner.y &&
                  y < corner.y + inputs.depth))
                throw InvalidParameter(fmt::format(
                    "forest: heroes = {}: {},{} lies outside the forest", params_.heroes, x, y));
            double nearest = INFINITY, highest = 0;
            std::size_t best = trees.size();
            for (std::size_t k = 0; k < trees.size(); ++k) {
                const forest::Tree& tree = trees[k];
                const double dx = corner.x + tree.x - x, dy = corner.y + tree.y - y,
                             away = std::sqrt(dx * dx + dy * dy);
                const bool reaches = away <= tree.height * forest.slope(tree.species);
                if (reaches ? tree.height <= highest : highest > 0 || away >= nearest) continue;
                best = k;
                if (reaches) highest = tree.height;
                nearest = away;
            }
            if (best < trees.size() && std::ranges::find(chosen, best) == chosen.end())
                chosen.push_back(best);
        }
        return chosen;
    }

    void put(Scene& scene, const Forest& forest, Vec3d corner,
             const std::vector<StepStatistics>& growth, const std::vector<forest::Fallen>& fallen,
             const StageContext& context)
    {
        const Progress progress = context.progress.slice(0.7, 1);
        for (const char* name : kGrids) scene.grids.erase(name);
        const std::vector<forest::Tree> trees = forest.trees();
        const std::vector<std::size_t> chosen = hero_trees(forest, trees, corner);
        std::vector<forest::Tree> heroes, others;
        hero_uids_.clear();
        for (const std::size_t k : chosen) {
            heroes.push_back(trees[k]);
            hero_uids_.push_back(trees[k].uid);
        }
        auto is_hero = [&](const forest::Tree& tree) {
            return std::ranges::find(hero_uids_, tree.uid) != hero_uids_.end();
        };
        const forest::ModelTable models = model_table(forest, progress.slice(0, 0.2));
        auto put_list = [&](const char* name, const std::vector<forest::Tree>& list) {
            scene.points[name] =
                instance_points(forest::instances(list, forest.inputs(), models, corner), "forest");
        };
        scene.points.erase("forest_heroes");
        if (heroes.empty())
            put_list("forest_instances", trees);
        else {
            std::ranges::copy_if(trees, std::back_inserter(others),
                                 [&](const forest::Tree& t) { return !is_hero(t); });
            put_list("forest_instances", others);
            put_list("forest_heroes", heroes);
        }
        put_forest_trees(scene, trees);
        if (params_.canopy && params_.occupancy)
            scene.points.at("forest_trees").attributes["rank"] = ranks_of(trees);
        put_history(scene, growth, fallen);

        FloatGrid height;
        if (params_.canopy) {
            forest::Canopy fields = forest::canopy(
                forest, canopy_params(), corner,
                heroes.empty() ? std::function<bool(const forest::Tree&)>{} : is_hero,
                progress.slice(0.2, 1));
            using enum GridClass;
            scene.put("canopy_lad", std::move(fields.leaf_area_density), "1/m", "forest",
                      FogVolume);
            scene.put("canopy_transmittance", std::move(fields.transmittance), "", "forest",
                      FogVolume);
            scene.put("canopy_RU", std::move(fields.drag), "1/m", "forest", FogVolume);
            scene.put("ground_transmittance", std::move(fields.ground_transmittance), "", "forest");
            if (fields.terrain.leaf_count() > 0)
                scene.put("terrain_height", std::move(fields.terrain), "m", "forest");
            if (params_.occupancy) {
                scene.put("forest_occupancy", std::move(fields.owner), "forest");
                scene.put("forest_density", std::move(fields.density), "", "forest");
                scene.grids.at("forest_density").extra["band_height_m"] = solver_.band;
            }
            height = std::move(fields.height);
        }
        put_settings(scene, record_of(forest, corner), std::move(height));
    }

    /// What `forest_occupancy` calls each tree: 1 for the biggest.
    static std::vector<std::int32_t> ranks_of(const std::vector<forest::Tree>& trees)
    {
        std::vector<std::uint32_t> order(trees.size());
        for (std::size_t k = 0; k < order.size(); ++k) order[k] = static_cast<std::uint32_t>(k);
        std::ranges::sort(order, [&](std::uint32_t a, std::uint32_t b) {
            return forest::bigger(trees[a], trees[b]);
        });
        std::vector<std::int32_t> ranks(trees.size());
        for (std::size_t k = 0; k < order.size(); ++k)
            ranks[order[k]] = static_cast<std::int32_t>(k + 1);
        return ranks;
    }

    /// i0, i1, j0, j1.
    std::array<int, 4> window_pixels() const
    {
        if (params_.window.empty()) return {};
        const forest::Inputs inputs = bare();
        const double p = solver_.pixel;
        const std::array<int, 4> window{
            int(std::floor(params_.window[0] / p)), int(std::ceil(params_.window[2] / p)),
            int(std::floor(params_.window[1] / p)), int(std::ceil(params_.window[3] / p))};
        if (window[0] >= window[1] || window[2] >= window[3] || window[1] > inputs.pixels_x() ||
            window[3] > inputs.pixels_y())
            throw InvalidParameter(fmt::format(
                "forest: window = {},{},{},{} m, must be west < east and south < north within {} x "
                "{} m",
                params_.window[0], params_.window[1], params_.window[2], params_.window[3],
                inputs.width, inputs.depth));
        return window;
    }

    /// A part of a forest out of core as a forest of its own.
    void put_window(Scene& scene, const Forest& forest, const std::array<int, 4>& window,
                    const ForestFolder::State& state, const StageContext& context)
    {
        const int i0 = window[0], i1 = window[1], j0 = window[2], j1 = window[3];
        const double p = solver_.pixel, x0 = i0 * p, y0 = j0 * p;
        forest::Inputs inputs;
        inputs.params = forest.inputs().params;
        inputs.species = forest.inputs().species;
        inputs.seed = forest.inputs().seed;
        inputs.width = (i1 - i0) * p;
        inputs.depth = (j1 - j0) * p;
        inputs.wind = forest.inputs().wind;
        inputs.land.combine = forest.inputs().land.combine;
        inputs.land.ground = cropped(forest.inputs().land.ground, window);
        inputs.land.blocked_height = cropped(forest.inputs().land.blocked_height, window);
        for (const forest::Factor& f : forest.inputs().land.factors)
            inputs.land.factors.push_back({f.name, cropped(f.value, window)});
        for (const forest::DensityMap& map : forest.density())
            inputs.density.push_back(cropped(map, window));
        std::vector<forest::Tree> trees;
        forest.visit([&](std::span<const forest::Tree> strip) {
            for (forest::Tree tree : strip) {
                const int i = int(std::floor(tree.x / p)), j = int(std::floor(tree.y / p));
                if (i < i0 || i >= i1 || j < j0 || j >= j1) continue;
                tree.x -= x0;
                tree.y -= y0;
                trees.push_back(tree);
            }
        });
        check_memory("forest",
                     double(trees.size()) * kBytesPerTree +
                         (params_.canopy ? forest::canopy_memory(inputs, canopy_params()) : 0.0),
                     context.memory_limit, "make the window smaller");
        Forest part(std::move(inputs));
        part.resume(forest.step(), std::move(trees));
        put(scene, part, params_.corner + Vec3d(x0, y0, 0), state.growth, state.fallen, context);
    }

    void write_log(const std::vector<forest::Edit>& edits,
                   const std::vector<forest::Species>& species, const StageContext& context) const
    {
        if (params_.edit_log.empty()) return;
        const fs::path file = resolve(context, params_.edit_log);
        for (const auto& [name, bytes] : encode_edits(edits, species, file.stem().string()))
            write_file(file.parent_path() / name, bytes, context.progress.slice(1, 1));
    }

    void write_side_files(const Forest& forest, const std::vector<forest::Fallen>& fallen,
                          const StageContext& context)
    {
        if (!params_.instances.empty()) {
            const forest::ModelTable models = model_table(forest, context.progress.slice(1, 1));
            std::vector<Prototype> prototypes;
            static const TriMesh kNone;
            for (const Specimen& model : specimens_)
                prototypes.push_back(
                    {fmt::format("{}_{}_{}", model.kind, model.variant, model.generations),
                     model.mesh.empty() ? &kNone : &model.mesh.front(), model.crown_radius,
                     model.crown_base});
            // Heroes are grown in their places by the tree stage.
            auto stays = [&](const forest::Tree& tree) {
                return std::ranges::find(hero_uids_, tree.uid) == hero_uids_.end();
            };
            write_instances(
                resolve(context, params_.instances), forest.size() - hero_uids_.size(),
                [&](const std::function<void(std::span<const forest::Instance>)>& take) {
                    forest.visit([&](std::span<const forest::Tree> strip) {
                        if (hero_uids_.empty()) {
                            take(forest::instances(strip, forest.inputs(), models, params_.corner));
                            return;
                        }
                        std::vector<forest::Tree> some;
                        std::ranges::copy_if(strip, std::back_inserter(some), stays);
                        take(forest::instances(some, forest.inputs(), models, params_.corner));
                    });
                },
                prototypes, params_.corner, context.progress.slice(1, 1));
        }
        if (!params_.fallen.empty()) {
            std::string text = "id,step,species,x,y,azimuth_rad,length\n";
            for (const forest::Fallen& f : fallen)
                text += fmt::format("{:016x},{},{},{:.6g},{:.6g},{:.6g},{:.6g}\n", f.uid, f.step,
                                    forest.inputs().species[std::size_t(f.species)].name,
                                    params_.corner.x + f.x, params_.corner.y + f.y, f.azimuth,
                                    f.length);
            write_file(resolve(context, params_.fallen), text, context.progress.slice(1, 1));
        }
    }

    Json summary_of(const Forest& forest, const std::vector<StepStatistics>& growth) const
    {
        Json summary{{"status", !stopped.empty()     ? "limit"
                                : forest.size() == 0 ? "extinct"
                                                     : "growing"},
                     {"step", forest.step()},
                     {"trees", forest.size()}};
        if (growth.empty()) return summary;
        const StepStatistics& last = growth.back();
        const std::array<const char*, StepStatistics::kClasses> names{"to_3_m", "to_8_m", "to_12_m",
                                                                      "above_12_m"};
        for (int k = 0; k < StepStatistics::kClasses; ++k)
            summary[names[std::size_t(k)]] = last.of_class(k);
        summary["seedlings"] = last.births;
        summary["mean_R"] = last.mean_share;
        return summary;
    }

    static constexpr std::chrono::seconds kKeepEvery{10};
    static constexpr double kBytesSown = 110;     // a tree, its claim in a tile, room to sort
    static constexpr double kTreesPerArea = 0.6;  // of the table's species, seedlings included
    static constexpr double kBytesPerTree = 400;  // trees, instances, both as they are written

    ForestParams params_;
    TerrainParams terrain_;
    forest::Params solver_;
    std::vector<fs::path> pictures_;  // that edits name
    std::vector<std::string> kinds_;  // of trees, each once
    std::vector<std::uint64_t> hero_uids_;
    std::vector<Specimen> specimens_;
    forest::ModelTable models_;
};

}  // namespace

std::unique_ptr<Stage> make_forest()
{
    return std::make_unique<ForestStage>();
}

}  // namespace sekitei::apps
