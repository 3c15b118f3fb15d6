#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <set>

#include "apps/forest.h"
#include "apps/forest_instances.h"
#include "apps/habitat.h"
#include "apps/specimens.h"
#include "apps/stages/stages.h"
#include "apps/trees.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/log.h"
#include "core/mesh_io.h"
#include "core/units.h"
#include "grids/marching_tetrahedra.h"
#include "grids/vdb_file.h"
#include "solvers/forest/canopy.h"
#include "solvers/tree/shape.h"
#include "solvers/tree/wood.h"

namespace sekitei::apps {
namespace {

namespace fs = std::filesystem;

struct TreeParams {
    std::string species, origin;
    std::vector<double> starts;
    int generations = 40;
    fs::path obstacle, shade;
    bool scene_obstacles = true;
    std::optional<bool> heroes;
    std::string remove;
    std::optional<double> prune_above;
    std::optional<int> prune_generation;
    int every = 0, sequence = 0;
    std::optional<double> voxel;
    bool leaves = true, wood = false;
    double wood_voxel = 0.02;
    std::string mesh, skeleton;

    static void describe(auto&& field)
    {
        field("species", &TreeParams::species,
              "kinds of trees, separated by commas, for one origin after the other: table-1, "
              "beech, oak, zelkova, cherry, willow, pine, azalea, pollard, or .toml files; empty: "
              "table-1, or as the trees of the scene");
        field(
            "origin", &TreeParams::origin,
            "where trees stand: x,y,z in metres, or x,y for a place on top of what is solid there, "
            "else z = 0; several separated by ';'; empty: one at 0,0,0, or none besides those of "
            "the scene");
        field("starts", &TreeParams::starts, "", kNotNegative,
              "generation before which the tree at each origin does not grow: trees of several "
              "ages");
        field("generations", &TreeParams::generations, "", between(0, 500),
              "how long they grow; in a scene with trees: from there on");
        field("obstacle", &TreeParams::obstacle,
              "scene or mesh file of what they grow beside; empty: nothing");
        field("scene_obstacles", &TreeParams::scene_obstacles,
              "the rock, fences and walls of the scene are obstacles");
        field("shade", &TreeParams::shade,
              "scene file whose canopy_lad shades them: a forest; empty: none");
        field("heroes", &TreeParams::heroes,
              "the single trees of a forest, forest_heroes, grow where they stand, about as high "
              "as it says, in the shade of its others; low ones may die of it; auto: where there "
              "are some");
        field("remove", &TreeParams::remove,
              "trees of the scene to fell first: numbers from 0, separated by commas");
        field("prune_above", &TreeParams::prune_above, "m", kAny,
              "height above which branches of the scene's trees are cut first");
        field("prune_generation", &TreeParams::prune_generation, "", between(0, 1000000),
              "branches of later generations are cut first");
        field("every", &TreeParams::every, "", kNotNegative,
              "also write a scene every so many generations, numbered beside the last one; 0: "
              "only the last");
        field("sequence", &TreeParams::sequence, "", kNotNegative,
              "the same, so many scenes of the whole growth; 0: only the last");
        field("voxel", &TreeParams::voxel, "m", between(1e-3, 100),
              "edge of the voxels of leaves and light; auto: half the smallest leaf-ball's radius");
        field("leaves", &TreeParams::leaves, "single leaves as points");
        field("wood", &TreeParams::wood, "the wood as a level set, tree_sdf");
        field("wood_voxel", &TreeParams::wood_voxel, "m", between(1e-4, 10),
              "with wood: edge of its voxels");
        field("mesh", &TreeParams::mesh,
              "by command, not in recipes: file for the bark as tubes of triangles; empty: none");
        field(
            "skeleton", &TreeParams::skeleton,
            "the same for branches as vertices and edges: .ply, .json or .obj (polylines); empty: "
            "none");
    }
};

/// Positions in metres out of "0m,0m,0m; 3m,2m"; z is NaN where only x and y are given.
std::vector<Vec3d> places(const std::string& text)
{
    std::vector<Vec3d> list;
    for (std::size_t begin = 0; begin <= text.size();) {
        const std::size_t end = std::min(text.find(';', begin), text.size());
        const std::vector<std::string> parts = split_names(text.substr(begin, end - begin));
        begin = end + 1;
        if (parts.empty()) continue;
        if (parts.size() != 2 && parts.size() != 3)
            throw InvalidParameter(fmt::format(
                "tree: origin = {}: expected x,y,z or x,y in metres, several separated by ';'",
                text));
        Vec3d at(0, 0, NAN);
        for (int axis = 0; axis < int(parts.size()); ++axis) {
            try {
                at[axis] = parse_quantity(parts[static_cast<std::size_t>(axis)], "m");
            } catch (const InvalidParameter& error) {
                throw InvalidParameter(fmt::format("tree: origin = {}: {}", text, error.what()));
            }
            if (std::abs(at[axis]) > 1e6)
                throw InvalidParameter(
                    fmt::format("tree: origin = {}: {} m, must be -1e6 to 1e6 m", text, at[axis]));
        }
        list.push_back(at);
    }
    return list;
}

std::vector<int> numbers(const std::string& text)
{
    std::vector<int> list;
    for (const std::string& name : split_names(text)) {
        int value = -1;
        const auto [end, error] = std::from_chars(name.data(), name.data() + name.size(), value);
        if (error != std::errc{} || end != name.data() + name.size() || value < 0)
            throw InvalidParameter(fmt::format(
                "tree: remove = {}: must be numbers of trees from 0, separated by commas", text));
        list.push_back(value);
    }
    return list;
}

bool is_mesh_file(const fs::path& file)
{
    static const std::set<std::string> kSuffixes{".ply", ".obj", ".stl", ".off", ".glb"};
    return kSuffixes.contains(file.extension().string());
}

/// The parameters of P as ones that are auto until they are given.
template <class P>
void add_overrides(ParamList& list, P& values, std::set<std::string>& given,
                   const std::string& otherwise)
{
    for (Param& p : describe_params(values)) {
        if (p.name == "name") continue;
        Param wrapped = p;
        wrapped.optional = true;
        wrapped.help =
            fmt::format("{}; auto: {}", p.help, otherwise.empty() ? p.value_text() : otherwise);
        wrapped.get = [get = p.get, name = p.name, &given] {
            return given.contains(name) ? get() : Json(nullptr);
        };
        wrapped.set = [set = p.set, name = p.name, &given](const Json& value) {
            if (detail::is_auto(value)) {
                given.erase(name);
            } else {
                set(value);
                given.insert(name);
            }
        };
        list.push_back(std::move(wrapped));
    }
}

/// Takes over what was given.
template <class P>
void override_with(P& target, const P& values, const std::set<std::string>& given)
{
    P source = values;
    const ParamList from = describe_params(source), to = describe_params(target);
    for (const Param& p : from)
        if (given.contains(p.name)) find_param(to, p.name)->set(p.get());
}

/// What stands around, and the grids that it refers to.
struct Around {
    double clearance = 0;  ///< that trees keep [m]
    double reach = 0;      ///< to which distances to meshes are worked out [m]
    std::vector<std::unique_ptr<FloatGrid>> grids;
    tree::Surroundings surroundings;

    /// A band narrower than the clearance does not tell how far its surface is: its triangles take
    /// its place.
    void add_level_set(const FloatGrid& grid, const Progress& progress)
    {
        auto obstacle = tree::level_set_obstacle(grid);
        if (obstacle->reach() >= clearance)
            surroundings.obstacles.push_back(std::move(obstacle));
        else
            add_mesh(marching_tetrahedra(grid, 0, progress), progress);
    }
    void add_mesh(TriMesh mesh, const Progress& progress)
    {
        surroundings.obstacles.push_back(tree::mesh_obstacle(std::move(mesh), reach, progress));
    }
    /// The solid that a scene is about; whether there is one.
    bool add_scene(const Scene& scene, const Progress& progress)
    {
        bool found = false;
        auto keep = [&](const FloatGrid& grid) -> const FloatGrid& {
            return *grids.emplace_back(std::make_unique<FloatGrid>(grid));
        };
        for (const char* name : {"surface_sdf", "obstacle_sdf"})
            if (scene.has(name)) {
                add_level_set(keep(scene.floats(name)), progress);
                found = true;
            }
        if (scene.has("surface_sdf")) return true;
        if (const auto rock = scene.meshes.find("rock"); rock != scene.meshes.end()) {
            add_mesh(rock->second, progress);
            return true;
        }
        if (scene.has("density")) {
            TriMesh mesh = marching_tetrahedra(scene.floats("density"), 0.5, progress);
            if (!mesh.triangles.empty()) {
                add_mesh(std::move(mesh), progress);
                found = true;
            }
        }
        return found;
    }
};

/// The leaves of a forest's other trees, on whose voxels those of the scene's trees go as well.
struct Stand {
    FloatGrid leaves;  ///< leaf area density [1/m]
    double extinction = 0.5, drag = tree::kCanopyDrag;
    double level = 0;  ///< height of its corner [m]
};

std::optional<Stand> stand_of(const Scene& scene)
{
    const auto height = scene.grids.find("canopy_height"), lad = scene.grids.find("canopy_lad");
    if (height == scene.grids.end() || !height->second.extra.contains(kForestSettings)) return {};
    Stand stand;
    // What trees have added to is kept aside as it was.
    if (lad != scene.grids.end() && lad->second.stage == "forest")
        stand.leaves = scene.floats("canopy_lad");
    else if (scene.has("forest_lad"))
        stand.leaves = scene.floats("forest_lad");
    else
        return {};
    stand.level = forest_record(scene).corner.z;
    if (const Json* made = params_of(scene, "forest")) {
        stand.extinction = made->value("extinction", stand.extinction);
        stand.drag = made->value("drag", stand.drag);
    }
    return stand;
}

/// A tree of a forest that is to be grown.
struct Hero {
    Vec3d foot;         ///< [m]
    double height = 0;  ///< [m]
    int species = 0;    ///< among `kinds`
};
struct Heroes {
    std::vector<Hero> trees;
    std::vector<tree::Species> kinds;
};

Heroes heroes_of(const Scene& scene)
{
    const char* const kName = "forest_heroes";
    const ForestModels models = forest_models(scene);
    Heroes heroes;
    std::map<std::string, int> place;
    for (const forest::Instance& at : instances_of(scene.points_of(kName), kName)) {
        if (at.model < 0 || std::size_t(at.model) >= models.size())
            throw InvalidInput(fmt::format("{}: tree {:016x} has the model {}, the forest has {}",
                                           kName, at.uid, at.model, models.size()));
        if (!(at.height > 0 && std::isfinite(at.height)))
            throw InvalidInput(fmt::format("{}: tree {:016x} is {} m high, must be > 0", kName,
                                           at.uid, at.height));
        const std::string& kind =
            models.kinds[std::size_t(at.model) /
                         (std::size_t(models.variants) * models.generations.size())];
        const auto [found, is_new] = place.emplace(kind, int(heroes.kinds.size()));
        if (is_new) heroes.kinds.push_back(specimen_kind(kind));
        heroes.trees.push_back({at.position, at.height, found->second});
    }
    return heroes;
}

/// Heights in branch lengths of a tree that grows alone, after 0, 1, .. generations.
std::vector<double> heights_alone(tree::GroveParams params, const tree::Species& kind,
                                  int generations, std::uint64_t seed, const Progress& progress)
{
    params.keep_tips.clear();
    tree::Grove grove(std::move(params), {kind}, {{}}, seed);
    std::vector<double> heights(std::size_t(generations) + 1);
    grove.grow(generations, progress, [&](const tree::GenerationStatistics& row) {
        const tree::Balls balls = grove.balls();
        double& height = heights[std::size_t(row.generation)];
        for (std::size_t i = 0; i < balls.size(); ++i)
            height = std::max(height, balls.centre[i].z + balls.radius[i]);
    });
    return heights;
}

/// Where heroes stand and when they begin, so that each is about as high as it should be in the
/// end; the highest takes all generations, unless `unit` [m] is given.
/// @param share  of its last height that the highest has after 0, 1, .. generations
std::vector<tree::Plant> plants_of(const Heroes& heroes, const tree::GroveParams& params,
                                   int generations, bool unit_given, double& unit,
                                   std::vector<double>& share, std::uint64_t seed,
                                   const Progress& progress)
{
    std::vector<std::vector<double>> alone;
    std::vector<double> highest;
    for (const tree::Species& kind : heroes.kinds) {
        alone.push_back(heights_alone(params, kind, generations, seed, progress.slice(0, 0)));
        highest.push_back(*std::max_element(alone.back().begin(), alone.back().end()));
        if (highest.back() == 0)
            throw InvalidInput(
                fmt::format("tree: {} does not live for {} generations, must grow to be a hero",
                            kind.name, generations));
    }
    if (!unit_given) {
        unit = 0;
        for (const Hero& hero : heroes.trees)
            unit = std::max(unit, hero.height / highest[std::size_t(hero.species)]);
    }
    const auto tallest =
        std::max_element(heroes.trees.begin(), heroes.trees.end(),
                         [](const Hero& a, const Hero& b) { return a.height < b.height; });
    share.clear();
    for (const double height : alone[std::size_t(tallest->species)])
        share.push_back(std::max(share.empty() ? 0.1 : share.back(),
                                 height / highest[std::size_t(tallest->species)]));
    std::vector<tree::Plant> plants;
    for (const Hero& hero : heroes.trees) {
        const std::vector<double>& heights = alone[std::size_t(hero.species)];
        std::size_t age = 1;
        for (std::size_t g = 1; g < heights.size(); ++g)
            if (std::abs(heights[g] * unit - hero.height) <
                std::abs(heights[age] * unit - hero.height))
                age = g;
        plants.push_back({hero.foot / unit, hero.species, generations - int(age)});
    }
    return plants;
}

/// Height of the uppermost surface under or over a place, a little above it; 0 where there is none.
double top_of(const tree::Surroundings& surroundings, Vec3d at)
{
    constexpr double kHighest = 1000, kLowest = -1000, kNear = 1e-3;  // [m]
    at.z = kHighest;
    if (!surroundings.blocks(at, {0, 0, -1})) return 0;
    // Farther off than its reach, a distance may be any.
    double reach = kHighest;
    for (const auto& obstacle : surroundings.obstacles) reach = std::min(reach, obstacle->reach());
    while (at.z > kLowest) {
        double distance = 0;
        surroundings.nearest(at, distance);
        if (distance < kNear) return at.z + kNear;
        at.z -= std::clamp(distance, kNear / 2, std::max(kNear, reach));
    }
    return 0;
}

/// Bytes of three grids of leaves at the most: blocks of 8^3 voxels around every ball, or all
/// blocks of their box where that is less; as much again while they are written.
double canopy_memory(const tree::Balls& balls, double unit, double voxel)
{
    constexpr double kBytesPerBlock = 6 * 512 * sizeof(float);
    Bounds box;
    double blocks = 0;
    for (std::size_t i = 0; i < balls.size(); ++i) {
        const Vec3d r(balls.radius[i]);
        box.add(balls.centre[i] - r);
        box.add(balls.centre[i] + r);
        const double across = 2 * balls.radius[i] * unit / (8 * voxel) + 2;
        blocks += across * across * across;
    }
    if (balls.size() == 0) return 0;
    const Vec3d size = box.size() * (unit / (8 * voxel)) + Vec3d(2);
    return kBytesPerBlock * std::min(blocks, size.x * size.y * size.z);
}

/// A mesh file without a face: what scripts find where a tree died out.
std::string empty_mesh(const std::string& suffix)
{
    if (suffix == ".obj") return "# no faces\n";
    if (suffix == ".off") return "OFF\n0 0 0\n";
    if (suffix == ".stl") return std::string(84, '\0');
    if (suffix == ".ply")
        return "ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\n"
               "property float z\nelement face 0\nproperty list uchar int vertex_indices\n"
               "end_header\n";
    throw InvalidInput(fmt::format("tree: no tree is left, and {} files cannot be empty", suffix));
}

class TreeStage : public Stage {
public:
    const StageInfo& info() const override
    {
        static const StageInfo kInfo = [] {
            StageInfo info{"tree",
                           "1",
                           "trees grow towards the light that their branches leave one another",
                           OutputKind::Scene,
                           true,
                           {},
                           {"tree_skeleton", "trees", "tree_buds", "tree_growth", "leaves",
                            "canopy_lad", "canopy_RU", "tree_light", "tree_sdf",
                            "canopy_transmittance", "ground_transmittance", "forest_lad"},
                           false,
                           {"tree"}};
            info.reads_if_given = true;
            return info;
        }();
        return kInfo;
    }
    bool reads_scene() override { return false; }
    std::vector<std::string> uses() override
    {
        std::vector<std::string> names = grove_items();
        for (const char* name :
             {"tree_growth", "forest_heroes", "canopy_height", "terrain_height", "forest_lad"})
            names.emplace_back(name);
        if (params_.scene_obstacles)
            for (const char* name : {"surface_sdf", "obstacle_sdf", "density", "rock"})
                names.emplace_back(name);
        return names;
    }
    std::vector<std::string> makes() override
    {
        std::vector<std::string> names = info().makes;
        if (!params_.wood) std::erase(names, "tree_sdf");
        if (!params_.leaves) std::erase(names, "leaves");
        return names;
    }
    std::vector<fs::path> files() override
    {
        std::vector<fs::path> list;
        for (const std::string& name : split_names(params_.species))
            if (fs::path(name).extension() == ".toml") list.emplace_back(name);
        return list;
    }
    std::vector<fs::path> side_files() override
    {
        std::vector<fs::path> list;
        if (!params_.mesh.empty()) list.emplace_back(params_.mesh);
        if (!params_.skeleton.empty()) list.emplace_back(params_.skeleton);
        return list;
    }
    int frame_interval() override
    {
        if (params_.every > 0) return params_.every;
        if (params_.sequence > 0)
            return std::max(1, (params_.generations + params_.sequence - 1) / params_.sequence);
        return 0;
    }

    ParamList params() override
    {
        ParamList list = describe_params(params_);
        add_overrides(list, grove_, given_, "");
        add_overrides(list, species_, given_, "of the species");
        return list;
    }

    void validate() override
    {
        validate_described("tree", params_);
        tree::GroveParams grove;
        override_with(grove, grove_, given_);
        tree::validate(grove);
        if (grove.method == tree::Method::Grid && grove.transmission == 0)
            throw InvalidParameter(
                "tree: transmission = 0, must be > 0 with method = grid; use method = sweep");
        if (grove.transmission == 0)
            log::warning("tree: transmission = 0: leaves are made as if it were {}", kNearlyOpaque);
        for (const std::string& name : split_names(params_.species))
            if (fs::path(name).extension() != ".toml") checked(find_tree(name, {}));
        if (split_names(params_.species).empty()) checked({});
        places(params_.origin);
        numbers(params_.remove);
        if (params_.every > 0 && params_.sequence > 0)
            throw InvalidParameter("tree: every and sequence: give one of the two");
        if (!params_.mesh.empty() && !is_mesh_file(params_.mesh))
            throw InvalidParameter(fmt::format(
                "tree: mesh = {}, must end in .ply, .obj, .stl, .off or .glb", params_.mesh));
        const std::string suffix = fs::path(params_.skeleton).extension().string();
        if (!params_.skeleton.empty() && suffix != ".ply" && suffix != ".json" && suffix != ".obj")
            throw InvalidParameter(
                fmt::format("tree: skeleton = {}, must end in .ply, .json or "
                            ".obj",
                            params_.skeleton));
        if (!params_.wood) warn_unused(*this, {"wood_voxel"}, "without wood");
    }

    void check_files(const StageContext& context) override
    {
        for (const std::string& name : split_names(params_.species))
            if (fs::path(name).extension() == ".toml") checked(find_tree(name, context.folder));
    }

    Need estimate(SceneOutline&, const StageContext&) override { return {0, 4e8, 2e7}; }

    Json run(Scene& scene, const StageContext& context) override
    {
        stopped.clear();
        for (const fs::path& file : side_files()) check_target(resolve(context, file));
        const bool goes_on = scene.points.contains("tree_skeleton");
        GroveRecord record;
        if (goes_on) record = grove_record(scene);
        override_with(record.params, grove_, given_);
        const std::optional<Stand> stand = stand_of(scene);
        Heroes heroes;
        std::vector<tree::Plant> of_forest;
        std::vector<double> stand_height;  // its share of the last, by generation
        if (params_.heroes.value_or(!goes_on && scene.points.contains("forest_heroes")))
            heroes = heroes_of(scene);
        if (!heroes.trees.empty()) {
            for (tree::Species& s : heroes.kinds) override_with(s, species_, given_);
            of_forest =
                plants_of(heroes, record.params, params_.generations,
                          goes_on || given_.contains("unit_length"), record.params.unit_length,
                          stand_height, context.seed, context.progress);
            log::info("tree: {} trees of the forest, {:.3g} m a branch", of_forest.size(),
                      record.params.unit_length);
        }
        const double unit = record.params.unit_length;

        Around around;
        surround(around, scene, record.params, stand ? &stand->leaves : nullptr, context);
        std::vector<Vec3d> origins = places(params_.origin);
        for (Vec3d& at : origins)
            if (std::isnan(at.z)) at.z = top_of(around.surroundings, at);
        const bool alone = origins.empty() && of_forest.empty();  // unless trees are there already
        std::vector<std::string> names = split_names(params_.species);
        if (!origins.empty() || (alone && !goes_on)) {
            if (names.empty()) names = {"table-1"};
        } else if (!goes_on) {
            if (!names.empty())
                log::warning("tree: species has no effect on the trees of a forest");
            names.clear();
        }
        std::vector<tree::Species> kinds;
        for (const std::string& name : names) kinds.push_back(find_tree(name, context.folder));
        // For new trees, or else in place of what the old ones were.
        const std::size_t first_kind = record.species.size();
        if (!goes_on || !alone)
            record.species.insert(record.species.end(), kinds.begin(), kinds.end());
        else
            for (std::size_t k = 0; k < record.species.size() && !kinds.empty(); ++k)
                record.species[k] = kinds[k % kinds.size()];
        for (tree::Species& s : record.species) override_with(s, species_, given_);

        std::vector<tree::Plant> plants;
        for (tree::Plant plant : of_forest) {
            plant.species += static_cast<int>(record.species.size());
            if (goes_on) plant.from += record.state.generation;
            plants.push_back(plant);
        }
        record.species.insert(record.species.end(), heroes.kinds.begin(), heroes.kinds.end());
        const std::size_t more = origins.empty() && alone && !goes_on ? 1 : origins.size();
        for (std::size_t k = 0; k < more; ++k) {
            tree::Plant plant;
            if (!origins.empty()) plant.origin = origins[k] / unit;
            plant.species = static_cast<int>(first_kind + k % kinds.size());
            if (k < params_.starts.size()) plant.from = static_cast<int>(params_.starts[k]);
            plants.push_back(plant);
        }

        const tree::Surroundings* surroundings =
            around.surroundings.empty() ? nullptr : &around.surroundings;
        auto planted = [&] {
            return goes_on ? tree::Grove(record.params, record.species, record.state, surroundings)
                           : tree::Grove(record.params, record.species, plants, context.seed,
                                         surroundings);
        };
        tree::Grove grove = planted();
        if (goes_on) {
            for (const int id : numbers(params_.remove)) grove.remove_tree(id);
            prune(grove);
            for (const tree::Plant& plant : plants) grove.add_plant(plant);
        } else if (!params_.remove.empty())
            throw InvalidParameter(fmt::format(
                "tree: remove = {}: there are no trees yet; go on from some with --from FILE",
                params_.remove));
        else if (params_.prune_above || params_.prune_generation)
            log::warning("tree: pruning has no effect without trees to go on from");

        std::vector<tree::GenerationStatistics> growth = growth_of(scene);
        const int before = grove.generation(), every = frame_interval();
        // The others were young when these were: a stand that grows up together.
        auto raise_stand = [&](int done) {
            if (!stand || heroes.trees.empty() || goes_on || !params_.shade.empty()) return;
            std::vector<Vec3d> feet;
            for (const Hero& hero : heroes.trees) feet.push_back(hero.foot);
            around.surroundings.shade->set_growth(stand_height[std::size_t(done)], std::move(feet));
        };
        raise_stand(0);
        const Progress growing = context.progress.slice(0, 0.7);
        auto watch = [&](const tree::GenerationStatistics& row) {
            growth.push_back(row);
            raise_stand(row.generation);
            // Files are the same every time, so that seconds are only told.
            log::detail("tree: generation {}: {} tips, light {:.3f} s, all else {:.3f} s",
                        row.generation, row.tips, row.seconds_light, row.seconds_rest);
            if (every == 0 || !context.frame) return;
            const int done = grove.generation() - before;
            if (done % every != 0 && done != params_.generations) return;
            put(scene, grove, stand, growth, context, growing.slice(1, 1));
            context.frame(grove.generation(), scene);
        };
        tree::Status status = grove.grow(params_.generations, growing, watch);
        // The forest says that its single trees stand there and how high: where its shade, whose
        // leaf area is a guess, kills one or keeps it low, less of it counts.
        if (stand && !heroes.trees.empty() && !goes_on && params_.shade.empty())
            for (const double strength : {0.5, 0.25, 0.0}) {
                if (lowest_hero(grove, heroes) >= kHeroShare) break;
                log::warning(
                    "tree: a single tree died or stayed low in the shade of the forest; they grow "
                    "anew, its leaves count {:.0f} %",
                    100 * strength);
                around.surroundings.shade->set_strength(strength);
                raise_stand(0);
                growth.clear();
                grove = planted();
                status = grove.grow(params_.generations, growing.slice(1, 1), watch);
            }
        put(scene, grove, stand, growth, context, context.progress.slice(0.7, 1));
        if (status == tree::Status::Limit)
            stopped = fmt::format(
                "tree: {} tips after generation {}, the limit is max_tips = {}; the scene is that "
                "of this generation",
                grove.tips(), grove.generation(), record.params.max_tips);
        Json summary = summary_of(grove, status, scene);
        if (!heroes.trees.empty()) {
            // Plants of one call lie one after the other, these first.
            const auto& heights = *scene.points.at("trees").values<float>("height");
            const std::size_t first = grove.plants().size() - plants.size();
            double share = 0;
            std::size_t died = 0;
            for (std::size_t k = 0; k < heroes.trees.size(); ++k) {
                share += double(heights[first + k]) / heroes.trees[k].height;
                died += heights[first + k] == 0;
            }
            const std::size_t live = heroes.trees.size() - died;
            summary["heroes"] = heroes.trees.size();
            if (live > 0) summary["hero_height"] = share / double(live);
            if (died > 0) {
                summary["heroes_died"] = died;
                log::warning(
                    "tree: {} of the forest's {} single trees died in the shade of the others; "
                    "choose higher ones, or give a smaller death_threshold",
                    died, heroes.trees.size());
            }
        }
        return summary;
    }

private:
    /// The least height of the forest's single trees, which are the first plants, over what it
    /// should be.
    static double lowest_hero(const tree::Grove& grove, const Heroes& heroes)
    {
        std::vector<double> top(heroes.trees.size(), 0);
        const tree::Branches& wood = grove.branches();
        for (std::size_t i = 0; i < wood.size(); ++i)
            if (const auto of = std::size_t(wood.tree[i]); of < top.size() && wood.alive(i))
                top[of] = std::max(top[of], wood.end(i).z - grove.plants()[of].origin.z);
        double least = INFINITY;
        for (std::size_t k = 0; k < top.size(); ++k)
            least = std::min(least, top[k] * grove.params().unit_length / heroes.trees[k].height);
        return least;
    }
    static constexpr double kHeroShare = 0.6;

    void checked(tree::Species species) const
    {
        override_with(species, species_, given_);
        tree::validate(species);
    }

    /// @param leaves  of a forest's trees; may be null
    void surround(Around& around, const Scene& scene, const tree::GroveParams& params,
                  const FloatGrid* leaves, const StageContext& context) const
    {
        around.clearance = params.unit_length * params.clearance;
        around.reach = 4 * params.unit_length * std::max(1.0, params.clearance);
        if (params_.scene_obstacles) around.add_scene(scene, context.progress.slice(0, 0));
        if (!params_.obstacle.empty()) {
            const fs::path file = resolve(context, params_.obstacle);
            try {
                if (is_mesh_file(file)) {
                    MeshReadReport report;
                    TriMesh mesh = read_mesh(file, &report);
                    log_mesh_report(file, report);
                    around.add_mesh(std::move(mesh), context.progress.slice(0, 0));
                } else
                    add_file(around, file, context);
            } catch (const InvalidInput& error) {
                throw named_after(file.string(), error);
            }
        }
        if (!params_.shade.empty()) {
            const fs::path file = resolve(context, params_.shade);
            ReadOptions options;
            options.only = {"canopy_lad"};
            options.memory_limit = context.memory_limit;
            const Scene forest = read_vdb(file, options, context.progress.slice(0, 0));
            const FloatGrid& lad = *around.grids.emplace_back(
                std::make_unique<FloatGrid>(forest.floats("canopy_lad")));
            around.surroundings.shade = std::make_unique<tree::BackgroundShade>(lad, 0.5);
        } else if (leaves) {
            around.surroundings.shade = std::make_unique<tree::BackgroundShade>(*leaves, 0.5);
            around.surroundings.shade->set_lit_from_below(true);
        }
    }

    /// The canopy of a forest with the leaves of these trees in it.
    static void put_in_forest(Scene& scene, const Stand& stand, const FloatGrid& leaves)
    {
        FloatGrid lad = forest::with_leaves(stand.leaves, leaves), drag = lad;
        for (std::size_t leaf = 0; leaf < drag.leaf_count(); ++leaf) {
            auto scaled = [&](float v) { return static_cast<float>(stand.drag * double(v)); };
            if (float* values = drag.values(leaf))
                std::transform(values, values + kLeafSize, values, scaled);
            else
                drag.set_constant(leaf, scaled(drag.constant(leaf)));
        }
        const FloatGrid* terrain =
            scene.has("terrain_height") ? &scene.floats("terrain_height") : nullptr;
        forest::Shade shade = forest::shade_of(
            lad,
            [&](int i, int j) {
                if (!terrain) return 0;
                return int(std::lround(double(terrain->value({i, j, 0})) - stand.level));
            },
            stand.extinction);
        using enum GridClass;
        scene.put("canopy_lad", std::move(lad), "1/m", "tree", FogVolume);
        scene.put("canopy_RU", std::move(drag), "1/m", "tree", FogVolume);
        scene.put("canopy_transmittance", std::move(shade.transmittance), "", "tree", FogVolume);
        scene.put("ground_transmittance", std::move(shade.ground_transmittance), "", "tree");
        scene.put("forest_lad", stand.leaves, "1/m", "forest", FogVolume);
    }

    static void add_file(Around& around, const fs::path& file, const StageContext& context)
    {
        ReadOptions options;
        options.keep_foreign = false;
        options.memory_limit = context.memory_limit;
        options.fix_nan = context.fix_nan;
        std::vector<std::string> level_sets, floats;
        bool known = false;
        for (const VdbGridInfo& grid : inspect_vdb(file).grids) {
            if (grid.points) continue;
            known = known || grid.name == "surface_sdf" || grid.name == "density" ||
                    grid.name == "obstacle_sdf";
            if (grid.type.find("float") == std::string::npos) continue;
            floats.push_back(grid.name);
            if (grid.grid_class.find("level") != std::string::npos) level_sets.push_back(grid.name);
        }
        const Progress progress = context.progress.slice(0, 0);
        if (known) {
            options.only = {};
            for (const char* name : {"surface_sdf", "obstacle_sdf", "density"})
                options.if_there.insert(name);
            for (const std::string& name : floats)
                if (options.if_there.contains(name)) options.only.insert(name);
            if (around.add_scene(read_vdb(file, options, progress), progress)) return;
        }
        // A volume of another program: its level set, or the only grid it has.
        const std::vector<std::string>& choice = level_sets.empty() ? floats : level_sets;
        if (choice.size() != 1)
            throw InvalidInput(fmt::format(
                "{}: expected surface_sdf, obstacle_sdf, density or one level set, it has {}",
                file.string(),
                choice.empty() ? "no float grid" : fmt::format("{}", fmt::join(choice, ", "))));
        options.only = {choice.front()};
        const Scene other = read_vdb(file, options, progress);
        around.add_level_set(
            *around.grids.emplace_back(std::make_unique<FloatGrid>(other.floats(choice.front()))),
            progress);
    }

    void prune(tree::Grove& grove) const
    {
        if (!params_.prune_above && !params_.prune_generation) return;
        const double unit = grove.params().unit_length;
        const std::size_t cut = grove.prune([&](const tree::Branches& b, std::size_t i) {
            if (params_.prune_generation && b.generation[i] > *params_.prune_generation)
                return true;
            return params_.prune_above && b.end(i).z * unit > *params_.prune_above;
        });
        log::info("tree: cut {} branches", cut);
    }

    void put(Scene& scene, const tree::Grove& grove, const std::optional<Stand>& stand,
             const std::vector<tree::GenerationStatistics>& growth, const StageContext& context,
             const Progress& progress) const
    {
        const tree::GroveParams& params = grove.params();
        const std::vector<double> radius =
            tree::thickness(grove.branches(), grove.species(), grove.plants());
        put_grove(scene, grove, radius);
        put_growth(scene, growth);
        // No number of leaves is opaque; those that nearly are stand for them.
        tree::Grove leafy = grove;
        if (params.transmission == 0) {
            tree::GroveParams thin = params;
            thin.transmission = kNearlyOpaque;
            leafy.set_params(thin);
        }
        double least = INFINITY;
        for (const tree::Species& s : grove.species()) least = std::min(least, s.ball_radius);
        const double voxel = params_.voxel.value_or(least * params.unit_length / 2);
        check_memory("tree", canopy_memory(leafy.balls(), params.unit_length, voxel),
                     context.memory_limit, fmt::format("make voxel = {:.3g} m larger", voxel));
        tree::Canopy canopy = tree::canopy(leafy, voxel, progress.slice(0, 0.4));
        if (stand)
            put_in_forest(scene, *stand, canopy.leaf_area_density);
        else {
            scene.put("canopy_lad", std::move(canopy.leaf_area_density), "1/m", "tree",
                      GridClass::FogVolume);
            scene.put("canopy_RU", std::move(canopy.drag), "1/m", "tree", GridClass::FogVolume);
        }
        scene.put("tree_light", std::move(canopy.light), "", "tree", GridClass::FogVolume);
        scene.points.erase("leaves");
        if (params_.leaves) put_leaves(scene, leafy);
        scene.grids.erase("tree_sdf");
        if (params_.wood)
            scene.put("tree_sdf",
                      tree::wood_level_set(grove.branches(), radius, params.unit_length,
                                           params_.wood_voxel, progress.slice(0.4, 0.8)),
                      "m", "tree", GridClass::LevelSet);
        const std::string settings = grove_settings(grove);
        for (const char* name : {"canopy_lad", "canopy_RU", "tree_light", "tree_sdf"}) {
            if (!scene.has(name)) continue;
            Json& extra = scene.grids.at(name).extra;
            extra["tree"] = settings;
            extra["tree_version"] = info().version;
            extra["seed"] = std::to_string(grove.state().seed);
            extra["unit_length"] = fmt::format("{}", params.unit_length);
            extra["method"] =
                std::string(choice_names(params.method)[static_cast<std::size_t>(params.method)]);
        }
        if (!params_.skeleton.empty()) {
            const fs::path file = resolve(context, params_.skeleton);
            write_file(file, encode_skeleton(grove, radius, file.extension().string()));
        }
        if (!params_.mesh.empty()) {
            const TriMesh bark = tree::bark_tubes(grove.branches(), radius, params.unit_length, {},
                                                  progress.slice(0.8, 1));
            const fs::path file = resolve(context, params_.mesh);
            if (bark.triangles.empty()) {
                log::warning("{}: empty, no tree is left", file.string());
                write_file(file, empty_mesh(file.extension().string()));
            } else
                write_mesh(file, bark, progress.slice(1, 1));
        }
    }

    static void put_leaves(Scene& scene, const tree::Grove& grove)
    {
        tree::Leaves leaves = tree::leaves(grove, grove.state().seed);
        Points points;
        points.stage = "tree";
        points.position = std::move(leaves.position);
        std::vector<std::int64_t> id(points.position.size());
        for (std::size_t i = 0; i < id.size(); ++i) id[i] = static_cast<std::int64_t>(i);
        points.attributes["id"] = std::move(id);
        points.attributes["N"] = std::move(leaves.normal);
        points.attributes["orient"] = std::move(leaves.orient);
        points.attributes["pscale"] = std::move(leaves.pscale);
        points.attributes["area"] = std::move(leaves.area);
        points.attributes["ball"] = std::move(leaves.ball);
        points.attributes["species"] = std::move(leaves.species);
        points.attributes["tree"] = std::move(leaves.tree);
        scene.points["leaves"] = std::move(points);
    }

    static Json summary_of(const tree::Grove& grove, tree::Status status, const Scene& scene)
    {
        const tree::Shape shape = tree::shape_of(grove);
        const double unit = grove.params().unit_length;
        const Points& plants = scene.points.at("trees");
        double trunk = 0, height = 0, area = 0;
        for (const float r : *plants.values<float>("trunk_radius"))
            trunk = std::max(trunk, 2 * double(r));
        for (const float h : *plants.values<float>("height")) height = std::max(height, double(h));
        if (const auto leaves = scene.points.find("leaves"); leaves != scene.points.end())
            for (const float a : *leaves->second.values<float>("area")) area += double(a);
        Json summary{{"status", status == tree::Status::Extinct ? "extinct"
                                : status == tree::Status::Limit ? "limit"
                                                                : "growing"},
                     {"generation", grove.generation()},
                     {"trees", grove.plants().size()},
                     {"branches", grove.branches().size()},
                     {"tips", grove.tips()},
                     {"height_m", height},
                     {"trunk_diameter_m", trunk}};
        if (area > 0) summary["leaf_area_m2"] = area;
        if (shape.tips > 0) {
            summary["crown_radius_m"] = shape.radius_max * unit;
            summary["lowest_m"] = shape.lowest * unit;
            summary["weeping"] = shape.weeping;
            summary["mean_light"] = shape.mean_light;
            summary["hole_cv"] = shape.hole_cv;
            summary["spacing_cv"] = shape.spacing_cv;
            summary["sphericity"] = shape.sphericity;
            summary["lean"] = Json::array({shape.lean.x, shape.lean.y});
        }
        return summary;
    }

    static constexpr double kNearlyOpaque = 0.01;

    TreeParams params_;
    tree::GroveParams grove_;
    tree::Species species_;
    std::set<std::string> given_;
};

}  // namespace

std::unique_ptr<Stage> make_tree()
{
    return std::make_unique<TreeStage>();
}

}  // namespace sekitei::apps
