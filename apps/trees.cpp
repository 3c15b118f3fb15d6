#include "apps/trees.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <bit>
#include <cmath>

#include "apps/presets.h"
#include "core/error.h"
#include "core/json.h"

namespace sekitei::apps {
namespace {

using tree::Branches;
using tree::Grove;
using tree::Species;

constexpr const char* kSettings = "tree";

/// One attribute of a point set.
template <class T>
const std::vector<T>& column(const Points& points, const char* set, const char* name)
{
    if (const auto* values = points.values<T>(name)) {
        if constexpr (std::is_floating_point_v<T>)
            if (!std::all_of(values->begin(), values->end(), [](T v) { return std::isfinite(v); }))
                throw InvalidInput(
                    fmt::format("the points '{}': {} is not finite everywhere", set, name));
        return *values;
    }
    throw InvalidInput(
        fmt::format("the points '{}' have no attribute '{}' of the kind that `sekitei tree` writes",
                    set, name));
}

std::int64_t signed_key(std::uint64_t key)
{
    return std::bit_cast<std::int64_t>(key);
}
std::uint64_t unsigned_key(std::int64_t key)
{
    return std::bit_cast<std::uint64_t>(key);
}

void put_vectors(Points& points, const std::array<const char*, 3>& names,
                 const std::vector<Vec3d>& values)
{
    for (int axis = 0; axis < 3; ++axis) {
        std::vector<double> list(values.size());
        for (std::size_t i = 0; i < values.size(); ++i) list[i] = values[i][axis];
        points.attributes[names[static_cast<std::size_t>(axis)]] = std::move(list);
    }
}

std::vector<Vec3d> vectors(const Points& points, const char* set,
                           const std::array<const char*, 3>& names)
{
    std::vector<Vec3d> values(points.position.size());
    for (int axis = 0; axis < 3; ++axis) {
        const auto& list = column<double>(points, set, names[static_cast<std::size_t>(axis)]);
        for (std::size_t i = 0; i < values.size(); ++i) values[i][axis] = list[i];
    }
    return values;
}

constexpr std::array<const char*, 3> kStart{"sx", "sy", "sz"}, kDirection{"dx", "dy", "dz"},
    kLight{"mx", "my", "mz"}, kOrigin{"ox", "oy", "oz"};

template <class To, class From>
std::vector<To> converted(const std::vector<From>& from)
{
    return {from.begin(), from.end()};
}

Branches branches_of(const Points& points)
{
    auto ints = [&](const char* name) -> const std::vector<std::int32_t>& {
        return column<std::int32_t>(points, "tree_skeleton", name);
    };
    Branches b;
    b.parent = ints("parent");
    b.tree = ints("tree");
    for (const std::int64_t key : column<std::int64_t>(points, "tree_skeleton", "key"))
        b.key.push_back(unsigned_key(key));
    b.generation = ints("generation");
    b.order = converted<std::uint8_t>(ints("order"));
    b.flags = converted<std::uint8_t>(ints("flags"));
    b.start = vectors(points, "tree_skeleton", kStart);
    b.direction = vectors(points, "tree_skeleton", kDirection);
    b.length = column<double>(points, "tree_skeleton", "length");
    b.light = column<double>(points, "tree_skeleton", "light");
    b.light_vector = vectors(points, "tree_skeleton", kLight);
    b.bough = ints("bough");
    b.dead_tips = ints("dead_tips");
    b.died = ints("died");
    for (std::size_t i = 0; i < b.size(); ++i)
        if (b.parent[i] < -1 || b.parent[i] >= std::int32_t(i))
            throw InvalidInput(
                fmt::format("tree_skeleton: branch {} names the parent {}, must be -1 to {}", i,
                            b.parent[i], std::int64_t(i) - 1));
    return b;
}

/// Where leaves and heights of one tree are.
struct Extent {
    double height = 0, crown_radius = 0, crown_base = 0, foot_radius = 0;  // [m]
    int tips = 0;
};

std::vector<Extent> extents(const Grove& grove, std::span<const double> radius)
{
    const double unit = grove.params().unit_length;
    std::vector<Extent> all(grove.plants().size());
    const Branches& b = grove.branches();
    for (const std::uint32_t i : grove.tip_list()) {
        const auto plant = static_cast<std::size_t>(b.tree[i]);
        Extent& e = all[plant];
        const Vec3d at = (b.end(i) - grove.plants()[plant].origin) * unit;
        const double reach = grove.species_of(i).ball_radius * unit;
        if (e.tips == 0 || at.z - reach < e.crown_base) e.crown_base = at.z - reach;
        ++e.tips;
        e.height = std::max(e.height, at.z);
        e.crown_radius = std::max(e.crown_radius, std::sqrt(at.x * at.x + at.y * at.y) + reach);
    }
    for (std::size_t i = 0; i < b.size(); ++i)
        if (b.parent[i] < 0) {
            double& foot = all[static_cast<std::size_t>(b.tree[i])].foot_radius;
            foot = std::max(foot, radius[i]);
        }
    return all;
}

template <class T>
T from_json(const Json& json)
{
    T target;
    for (const Param& p : describe_params(target))
        if (json.contains(p.name)) p.set(json[p.name]);
    return target;
}

}  // namespace

const std::vector<Species>& preset_trees()
{
    static const std::vector<tree::Species> presets{
        {.name = "table-1"},
        {.name = "beech",
         .tropism = 0.3,
         .branch_angle = 12,
         .first_length = 12,
         .vertical_azimuth = tree::Azimuth::Random,
         .leaf_size = 0.07,
         .leaf_orientation = tree::LeafOrientation::Planophile},
        {.name = "oak",
         .tropism = 0.4,
         .death_threshold = 0.58,
         .branch_angle = 16,
         .first_length = 7,
         .vertical_azimuth = tree::Azimuth::Random,
         .tip_radius = 0.002,
         .leaf_size = 0.1},
        {.name = "zelkova",
         .tropism = 0.15,
         .branch_angle = 8,
         .first_length = 10,
         .vertical_azimuth = tree::Azimuth::Random,
         .leaf_size = 0.06},
        {.name = "cherry",
         .tropism = 0.5,
         .branch_angle = 15,
         .first_length = 6,
         .vertical_azimuth = tree::Azimuth::Random,
         .leaf_projection = 0.4,
         .leaf_size = 0.06},
        {.name = "willow",
         .tropism = 0.8,
         .branch_angle = 10,
         .first_length = 14,
         .vertical_azimuth = tree::Azimuth::Random,
         .leaf_size = 0.08},
        {.name = "pine",
         .model = tree::Model::Conifer,
         .tropism = 0.1,
         .ball_radius = 1,
         .death_threshold = 0.45,
         .first_length = 1,
         .leaf_size = 0.06},
        {.name = "azalea",
         .tropism = 0.4,
         .death_threshold = 0.5,
         .branch_angle = 20,
         .first_length = 1,
         .vertical_azimuth = tree::Azimuth::Random,
         .leaf_size = 0.04},
        {.name = "pollard", .latent_share = 1}};
    return presets;
}

Species find_tree(const std::string& name, const std::filesystem::path& folder)
{
    return preset_or_file("species", name, folder, preset_trees(),
                          [](Species& species, const std::string& stem) {
                              if (species.name == Species{}.name) species.name = stem;
                              tree::validate(species);
                          });
}

std::vector<std::string> grove_items()
{
    return {"tree_skeleton", "trees", "tree_buds", "canopy_lad"};
}

std::string grove_settings(const Grove& grove)
{
    tree::GroveParams params = grove.params();
    Json species = Json::array();
    for (Species s : grove.species()) species.push_back(params_json(describe_params(s)));
    const Grove::State state = grove.state();
    return Json{{"params", params_json(describe_params(params))},
                {"species", species},
                {"seed", state.seed},
                {"next_root", state.next_root},
                {"generation", state.generation}}
        .dump();
}

void put_grove(Scene& scene, const Grove& grove, std::span<const double> radius)
{
    const double unit = grove.params().unit_length;
    const Branches& b = grove.branches();
    Points wood;
    wood.stage = "tree";
    for (std::size_t i = 0; i < b.size(); ++i) wood.position.push_back(b.end(i) * unit);
    wood.attributes["parent"] = b.parent;
    wood.attributes["tree"] = b.tree;
    std::vector<std::int64_t> keys;
    for (const std::uint64_t key : b.key) keys.push_back(signed_key(key));
    wood.attributes["key"] = std::move(keys);
    wood.attributes["generation"] = b.generation;
    wood.attributes["order"] = converted<std::int32_t>(b.order);
    wood.attributes["flags"] = converted<std::int32_t>(b.flags);
    put_vectors(wood, kStart, b.start);
    put_vectors(wood, kDirection, b.direction);
    wood.attributes["length"] = b.length;
    wood.attributes["light"] = b.light;
    put_vectors(wood, kLight, b.light_vector);
    wood.attributes["bough"] = b.bough;
    wood.attributes["dead_tips"] = b.dead_tips;
    wood.attributes["died"] = b.died;
    std::vector<float> thick;
    for (const double r : radius) thick.push_back(static_cast<float>(r));
    wood.attributes["radius"] = std::move(thick);
    // Growth goes through the tips in this order.
    std::vector<std::int32_t> place(b.size(), -1);
    for (std::size_t k = 0; k < grove.tip_list().size(); ++k)
        place[grove.tip_list()[k]] = static_cast<std::int32_t>(k);
    wood.attributes["tip"] = std::move(place);
    scene.points["tree_skeleton"] = std::move(wood);

    const std::vector<Extent> extent = extents(grove, radius);
    Points plants;
    plants.stage = "tree";
    std::vector<Vec3d> origin;
    std::vector<std::int32_t> id, species, from, tips;
    std::vector<double> length;
    std::vector<float> height, crown_radius, crown_base, foot;
    for (std::size_t k = 0; k < grove.plants().size(); ++k) {
        const tree::Plant& plant = grove.plants()[k];
        plants.position.push_back(plant.origin * unit);
        origin.push_back(plant.origin);
        id.push_back(static_cast<std::int32_t>(k));
        species.push_back(plant.species);
        from.push_back(plant.from);
        length.push_back(unit);
        tips.push_back(extent[k].tips);
        height.push_back(static_cast<float>(extent[k].height));
        crown_radius.push_back(static_cast<float>(extent[k].crown_radius));
        crown_base.push_back(static_cast<float>(extent[k].crown_base));
        foot.push_back(static_cast<float>(extent[k].foot_radius));
    }
    put_vectors(plants, kOrigin, origin);
    plants.attributes["id"] = std::move(id);
    plants.attributes["species"] = std::move(species);
    plants.attributes["from"] = std::move(from);
    plants.attributes["unit_length"] = std::move(length);
    plants.attributes["tips"] = std::move(tips);
    plants.attributes["height"] = std::move(height);
    plants.attributes["crown_radius"] = std::move(crown_radius);
    plants.attributes["crown_base"] = std::move(crown_base);
    plants.attributes["trunk_radius"] = std::move(foot);
    scene.points["trees"] = std::move(plants);

    const Grove::State state = grove.state();
    // None, where there were some: said so, or older ones would be taken for these.
    if (state.buds.empty() && !scene.points.contains("tree_buds")) return;
    Points waiting;
    waiting.stage = "tree";
    std::vector<Vec3d> at, direction;
    std::vector<std::int64_t> key;
    std::vector<std::int32_t> of, generation;
    for (const Grove::State::Bud& bud : state.buds) {
        waiting.position.push_back(bud.at * unit);
        at.push_back(bud.at);
        direction.push_back(bud.direction);
        key.push_back(signed_key(bud.key));
        of.push_back(bud.tree);
        generation.push_back(bud.generation);
    }
    put_vectors(waiting, kStart, at);
    put_vectors(waiting, kDirection, direction);
    waiting.attributes["key"] = std::move(key);
    waiting.attributes["tree"] = std::move(of);
    waiting.attributes["generation"] = std::move(generation);
    scene.points["tree_buds"] = std::move(waiting);
}

GroveRecord grove_record(const Scene& scene)
{
    GroveRecord record;
    const auto lad = scene.grids.find("canopy_lad");
    if (lad == scene.grids.end() || !lad->second.extra.contains(kSettings))
        throw InvalidInput(
            "the scene has trees, but not the grid canopy_lad of `sekitei tree`, which holds their "
            "parameters");
    try {
        const Json settings = parse_json(lad->second.extra[kSettings].get<std::string>());
        record.params = from_json<tree::GroveParams>(settings.at("params"));
        for (const Json& s : settings.at("species"))
            record.species.push_back(from_json<Species>(s));
        record.state.seed = settings.at("seed").get<std::uint64_t>();
        record.state.next_root = settings.at("next_root").get<std::uint64_t>();
        record.state.generation = settings.at("generation").get<int>();
    } catch (const std::exception& error) {  // of JSON, or a value out of its range
        throw InvalidInput(
            fmt::format("canopy_lad: the parameters of its trees are damaged: {}", error.what()));
    }

    const Points& plants = scene.points_of("trees");
    const std::vector<Vec3d> origin = vectors(plants, "trees", kOrigin);
    const auto &species = column<std::int32_t>(plants, "trees", "species"),
               &from = column<std::int32_t>(plants, "trees", "from");
    for (std::size_t k = 0; k < origin.size(); ++k) {
        if (species[k] < 0 || species[k] >= std::int32_t(record.species.size()))
            throw InvalidInput(fmt::format("trees: tree {} has the species {}, there are {}", k,
                                           species[k], record.species.size()));
        record.state.plants.push_back({origin[k], species[k], from[k]});
    }

    const Points& wood = scene.points_of("tree_skeleton");
    record.state.branches = branches_of(wood);
    for (const std::int32_t tree : record.state.branches.tree)
        if (tree < 0 || tree >= std::int32_t(origin.size()))
            throw InvalidInput(fmt::format("tree_skeleton: there is no tree {}", tree));
    const auto& place = column<std::int32_t>(wood, "tree_skeleton", "tip");
    const auto count = std::size_t(
        std::count_if(place.begin(), place.end(), [](std::int32_t p) { return p >= 0; }));
    record.state.tips.assign(count, 0xFFFFFFFFu);
    for (std::size_t i = 0; i < place.size(); ++i) {
        if (place[i] < 0) continue;
        if (std::size_t(place[i]) >= count || record.state.tips[std::size_t(place[i])] != ~0u)
            throw InvalidInput("tree_skeleton: its tips are not numbered from 0 on");
        record.state.tips[std::size_t(place[i])] = static_cast<std::uint32_t>(i);
    }

    if (const auto found = scene.points.find("tree_buds"); found != scene.points.end()) {
        const Points& buds = found->second;
        const std::vector<Vec3d> at = vectors(buds, "tree_buds", kStart),
                                 direction = vectors(buds, "tree_buds", kDirection);
        const auto& key = column<std::int64_t>(buds, "tree_buds", "key");
        const auto &of = column<std::int32_t>(buds, "tree_buds", "tree"),
                   &generation = column<std::int32_t>(buds, "tree_buds", "generation");
        for (std::size_t k = 0; k < at.size(); ++k)
            record.state.buds.push_back(
                {at[k], direction[k], unsigned_key(key[k]), of[k], generation[k]});
    }
    return record;
}

void put_growth(Scene& scene, const std::vector<tree::GenerationStatistics>& rows)
{
    Points points;
    points.stage = "tree";
    std::map<std::string, std::vector<double>> columns;
    for (const tree::GenerationStatistics& row : rows) {
        points.position.emplace_back(row.generation, 0, 0);
        columns["generation"].push_back(row.generation);
        columns["tips"].push_back(double(row.tips));
        columns["births"].push_back(double(row.births));
        columns["deaths"].push_back(double(row.deaths));
        columns["obstructed"].push_back(double(row.obstructed));
        columns["sprouts"].push_back(double(row.sprouts));
        columns["shed"].push_back(double(row.shed));
        columns["mean_light"].push_back(row.mean_light);
        columns["lowest"].push_back(row.lowest);
        columns["highest"].push_back(row.highest);
        columns["rms_radius"].push_back(row.rms_radius);
        columns["weeping"].push_back(row.weeping);
    }
    for (auto& [name, values] : columns) points.attributes[name] = std::move(values);
    scene.points.erase("tree_growth");
    if (!rows.empty()) scene.points["tree_growth"] = std::move(points);
}

std::vector<tree::GenerationStatistics> growth_of(const Scene& scene)
{
    const auto found = scene.points.find("tree_growth");
    if (found == scene.points.end()) return {};
    const Points& points = found->second;
    auto values = [&](const char* name) -> const std::vector<double>& {
        return column<double>(points, "tree_growth", name);
    };
    std::vector<tree::GenerationStatistics> rows(points.position.size());
    for (std::size_t r = 0; r < rows.size(); ++r) {
        tree::GenerationStatistics& row = rows[r];
        row.generation = int(values("generation")[r]);
        row.tips = std::size_t(values("tips")[r]);
        row.births = std::size_t(values("births")[r]);
        row.deaths = std::size_t(values("deaths")[r]);
        row.obstructed = std::size_t(values("obstructed")[r]);
        row.sprouts = std::size_t(values("sprouts")[r]);
        row.shed = std::size_t(values("shed")[r]);
        row.mean_light = values("mean_light")[r];
        row.lowest = values("lowest")[r];
        row.highest = values("highest")[r];
        row.rms_radius = values("rms_radius")[r];
        row.weeping = values("weeping")[r];
    }
    return rows;
}

std::string growth_csv(const std::vector<tree::GenerationStatistics>& rows)
{
    std::string text =
        "generation,tips,births,deaths,obstructed,sprouts,shed,mean_light,lowest,highest,"
        "rms_radius,weeping\n";
    for (const tree::GenerationStatistics& r : rows)
        text += fmt::format("{},{},{},{},{},{},{},{:.6g},{:.6g},{:.6g},{:.6g},{:.6g}\n",
                            r.generation, r.tips, r.births, r.deaths, r.obstructed, r.sprouts,
                            r.shed, r.mean_light, r.lowest, r.highest, r.rms_radius, r.weeping);
    return text;
}

Skeleton skeleton_of(const Scene& scene)
{
    Skeleton skeleton;
    const Points& wood = scene.points_of("tree_skeleton");
    skeleton.branches = branches_of(wood);
    for (const float r : column<float>(wood, "tree_skeleton", "radius"))
        skeleton.radius.push_back(double(r));
    const auto& length = column<double>(scene.points_of("trees"), "trees", "unit_length");
    if (!length.empty()) skeleton.unit_length = length.front();
    return skeleton;
}

std::string encode_skeleton(const Grove& grove, std::span<const double> radius,
                            std::string_view suffix)
{
    const Branches& b = grove.branches();
    const double unit = grove.params().unit_length;
    // The foot of each first branch is a vertex of its own, before its branch's end.
    struct Vertex {
        Vec3d at;
        std::size_t branch;
    };
    std::vector<Vertex> vertices;
    std::vector<std::size_t> end(b.size()), start(b.size());
    for (std::size_t i = 0; i < b.size(); ++i) {
        if (b.parent[i] < 0) {
            start[i] = vertices.size();
            vertices.push_back({b.start[i] * unit, i});
        } else
            start[i] = end[std::size_t(b.parent[i])];
        end[i] = vertices.size();
        vertices.push_back({b.end(i) * unit, i});
    }
    auto dead_age = [&](std::size_t i) { return b.alive(i) ? -1 : grove.generation() - b.died[i]; };
    std::string text;
    auto out = std::back_inserter(text);
    if (suffix == ".obj") {
        // A branch and its thickest child are one line.
        std::vector<std::int64_t> next(b.size(), -1);
        for (std::size_t i = 0; i < b.size(); ++i)
            if (b.parent[i] >= 0) {
                std::int64_t& child = next[std::size_t(b.parent[i])];
                if (child < 0 || radius[i] > radius[std::size_t(child)]) child = std::int64_t(i);
            }
        text = "# skeleton of trees, metres, z up\n";
        for (const Vertex& v : vertices)
            fmt::format_to(out, "v {:.9g} {:.9g} {:.9g}\n", v.at.x, v.at.y, v.at.z);
        for (std::size_t i = 0; i < b.size(); ++i) {
            if (b.parent[i] >= 0 && next[std::size_t(b.parent[i])] == std::int64_t(i)) continue;
            fmt::format_to(out, "l {}", start[i] + 1);
            for (std::int64_t k = std::int64_t(i); k >= 0; k = next[std::size_t(k)])
                fmt::format_to(out, " {}", end[std::size_t(k)] + 1);
            text += '\n';
        }
        return text;
    }
    if (suffix == ".json") {
        Json vertex = Json::array(), edge = Json::array();
        for (const Vertex& v : vertices)
            vertex.push_back({{"x", v.at.x},
                              {"y", v.at.y},
                              {"z", v.at.z},
                              {"radius", radius[v.branch]},
                              {"generation", b.generation[v.branch]},
                              {"order", b.order[v.branch]},
                              {"light", b.light[v.branch]},
                              {"alive", b.alive(v.branch)},
                              {"dead_age", dead_age(v.branch)},
                              {"tree_id", b.tree[v.branch]},
                              {"key", fmt::format("{:016x}", b.key[v.branch])}});
        for (std::size_t i = 0; i < b.size(); ++i) edge.push_back({start[i], end[i]});
        return Json{{"unit", "m"}, {"vertices", vertex}, {"edges", edge}}.dump(1) + "\n";
    }
    text = fmt::format(
        "ply\nformat ascii 1.0\ncomment skeleton of trees, metres, z up\n"
        "element vertex {}\nproperty double x\nproperty double y\nproperty double z\n"
        "property float radius\nproperty int generation\nproperty int order\n"
        "property float light\nproperty int alive\nproperty int dead_age\n"
        "property int tree_id\nproperty uint key_high\nproperty uint key_low\n"
        "element edge {}\nproperty int vertex1\nproperty int vertex2\nend_header\n",
        vertices.size(), b.size());
    for (const Vertex& v : vertices)
        fmt::format_to(out, "{:.9g} {:.9g} {:.9g} {:.6g} {} {} {:.6g} {} {} {} {} {}\n", v.at.x,
                       v.at.y, v.at.z, radius[v.branch], b.generation[v.branch], b.order[v.branch],
                       b.light[v.branch], int(b.alive(v.branch)), dead_age(v.branch),
                       b.tree[v.branch], b.key[v.branch] >> 32, b.key[v.branch] & 0xFFFFFFFFu);
    for (std::size_t i = 0; i < b.size(); ++i) fmt::format_to(out, "{} {}\n", start[i], end[i]);
    return text;
}

}  // namespace sekitei::apps
