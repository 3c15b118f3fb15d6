#include "apps/forest.h"

#include <fmt/format.h>

#include <bit>
#include <map>
#include <optional>

#include "core/csv.h"
#include "core/error.h"
#include "core/json.h"

namespace sekitei::apps {
namespace {

using forest::kCauses;
using forest::StepStatistics;

template <class T>
T from_json(const Json& json)
{
    T value;
    for (const Param& p : describe_params(value))
        if (json.contains(p.name)) p.set(json.at(p.name));
    return value;
}

Json limits_json(const forest::Limits& l)
{
    return {l.factor,  l.dies_below,   l.stands_below, l.best_from,
            l.best_to, l.stands_above, l.dies_above};
}

forest::Limits limits_of(const Json& j)
{
    return {j.at(0).get<std::string>(), j.at(1).get<double>(), j.at(2).get<double>(),
            j.at(3).get<double>(),      j.at(4).get<double>(), j.at(5).get<double>(),
            j.at(6).get<double>()};
}

std::string count_name(std::size_t species, std::size_t height_class)
{
    return fmt::format("count_{}_{}", species, height_class);
}

template <class T>
const std::vector<T>& column(const Points& points, const std::string& where,
                             const std::string& name)
{
    if (const auto* values = points.values<T>(name)) return *values;
    throw InvalidInput(fmt::format("the points '{}' have no attribute '{}'", where, name));
}

}  // namespace

std::int64_t signed_bits(std::uint64_t bits)
{
    return std::bit_cast<std::int64_t>(bits);
}
std::uint64_t unsigned_bits(std::int64_t bits)
{
    return std::bit_cast<std::uint64_t>(bits);
}

std::string forest_settings(const ForestRecord& record)
{
    forest::Params params = record.params;
    // Neither changes what grows.
    params.tile = forest::Params{}.tile;
    params.method = forest::Params{}.method;
    Json species = Json::array();
    for (forest::Species s : record.species) {
        Json entry = params_json(describe_params(s));
        for (const forest::Limits& limits : s.limits)
            entry["limits"].push_back(limits_json(limits));
        species.push_back(std::move(entry));
    }
    return Json{{"width", record.width},
                {"depth", record.depth},
                {"corner", {record.corner.x, record.corner.y, record.corner.z}},
                {"params", params_json(describe_params(params))},
                {"species", species},
                {"models",
                 {{"kinds", record.models.kinds},
                  {"variants", record.models.variants},
                  {"generations", record.models.generations},
                  {"seed", record.models.seed}}},
                {"step", record.step},
                {"seed", record.seed}}
        .dump();
}

ForestRecord forest_record(const Scene& scene)
{
    const auto grid = scene.grids.find("canopy_height");
    if (grid == scene.grids.end() || !grid->second.extra.contains(kForestSettings))
        throw InvalidInput(
            "the scene has no forest: the grid canopy_height of `sekitei forest`, which tells how "
            "it was grown, is not there");
    ForestRecord record;
    try {
        const Json settings = parse_json(grid->second.extra.at(kForestSettings).get<std::string>());
        record.width = settings.at("width").get<double>();
        record.depth = settings.at("depth").get<double>();
        for (int axis = 0; axis < 3; ++axis)
            record.corner[axis] = settings.at("corner").at(std::size_t(axis)).get<double>();
        record.params = from_json<forest::Params>(settings.at("params"));
        for (const Json& s : settings.at("species")) {
            record.species.push_back(from_json<forest::Species>(s));
            for (const Json& limits : s.value("limits", Json::array()))
                record.species.back().limits.push_back(limits_of(limits));
        }
        const Json& models = settings.at("models");
        record.models.kinds = models.at("kinds").get<std::vector<std::string>>();
        record.models.variants = models.at("variants").get<int>();
        record.models.generations = models.at("generations").get<std::vector<int>>();
        record.models.seed = models.at("seed").get<std::uint64_t>();
        record.step = settings.at("step").get<int>();
        record.seed = settings.at("seed").get<std::uint64_t>();
        if (record.models.variants < 1 || record.models.generations.empty())
            throw InvalidInput("no models of trees");
    } catch (const std::exception& error) {  // of JSON, or a value out of its range
        throw InvalidInput(fmt::format(
            "canopy_height: what its forest was grown with is damaged: {}", error.what()));
    }
    return record;
}

ForestModels forest_models(const Scene& scene)
{
    return forest_record(scene).models;
}

void put_forest_growth(Scene& scene, const std::vector<StepStatistics>& rows)
{
    Points points;
    points.stage = "forest";
    std::map<std::string, std::vector<double>> columns;
    for (const char* name : {"step", "trees", "births", "lost", "mean_share"}) columns[name] = {};
    for (const std::string_view name : choice_names(forest::Cause{}))
        columns[std::string(name)] = {};
    for (const StepStatistics& row : rows) {
        points.position.emplace_back(row.step, 0, 0);
        columns["step"].push_back(row.step);
        columns["trees"].push_back(double(row.trees));
        columns["births"].push_back(double(row.births));
        columns["lost"].push_back(double(row.lost));
        for (std::size_t c = 0; c < kCauses; ++c)
            columns[std::string(choice_names(forest::Cause{})[c])].push_back(double(row.deaths[c]));
        columns["mean_share"].push_back(row.mean_share);
        for (std::size_t s = 0; s < row.counts.size(); ++s)
            for (std::size_t k = 0; k < row.counts[s].size(); ++k)
                columns[count_name(s, k)].push_back(double(row.counts[s][k]));
    }
    for (auto& [name, values] : columns) points.attributes[name] = std::move(values);
    scene.points["forest_growth"] = std::move(points);
}

std::vector<StepStatistics> forest_growth_of(const Scene& scene)
{
    const auto found = scene.points.find("forest_growth");
    if (found == scene.points.end()) return {};
    const Points& points = found->second;
    auto value = [&](const std::string& name, std::size_t r) {
        return column<double>(points, "forest_growth", name)[r];
    };
    std::size_t species = 0;
    while (points.attributes.contains(count_name(species, 0))) ++species;
    std::vector<StepStatistics> rows(points.position.size());
    for (std::size_t r = 0; r < rows.size(); ++r) {
        StepStatistics& row = rows[r];
        row.step = int(value("step", r));
        row.trees = std::uint64_t(value("trees", r));
        row.births = std::uint64_t(value("births", r));
        row.lost = std::uint64_t(value("lost", r));
        for (std::size_t c = 0; c < kCauses; ++c)
            row.deaths[c] = std::uint64_t(value(std::string(choice_names(forest::Cause{})[c]), r));
        row.mean_share = value("mean_share", r);
        row.counts.resize(species);
        for (std::size_t s = 0; s < species; ++s)
            for (std::size_t k = 0; k < row.counts[s].size(); ++k)
                row.counts[s][k] = std::uint64_t(value(count_name(s, k), r));
    }
    return rows;
}

std::string forest_growth_csv(const std::vector<StepStatistics>& rows,
                              const std::vector<forest::Species>& species)
{
    std::string text = "step,trees,births,lost";
    for (const std::string_view cause : choice_names(forest::Cause{}))
        text += fmt::format(",{}", cause);
    text += ",mean_share";
    for (const forest::Species& s : species)
        for (const char* name : kForestClasses) text += fmt::format(",{}_{}", s.name, name);
    text += '\n';
    for (const StepStatistics& row : rows) {
        text += fmt::format("{},{},{},{}", row.step, row.trees, row.births, row.lost);
        for (const std::uint64_t deaths : row.deaths) text += fmt::format(",{}", deaths);
        text += fmt::format(",{:.6g}", row.mean_share);
        for (const auto& counts : row.counts)
            for (const std::uint64_t n : counts) text += fmt::format(",{}", n);
        text += '\n';
    }
    return text;
}

double forest_density(const Scene& scene)
{
    for (auto entry = scene.history.rbegin(); entry != scene.history.rend(); ++entry) {
        if (entry->stage != "forest" || !entry->params.contains("density")) continue;
        const std::string text = entry->params.at("density").get<std::string>();
        if (const std::optional<double> value = number_of(text)) return *value;
        throw InvalidInput(
            fmt::format("its forest grew with density = {}, which is not one number", text));
    }
    throw InvalidInput("its history tells of no density; it is not from `sekitei forest`");
}

Json row_json(const StepStatistics& row)
{
    return {{"step", row.step},
            {"trees", row.trees},
            {"births", row.births},
            {"lost", row.lost},
            {"deaths", row.deaths},
            {"counts", row.counts},
            {"mean_share", row.mean_share}};
}

StepStatistics row_of(const Json& json)
{
    StepStatistics row;
    json.at("step").get_to(row.step);
    json.at("trees").get_to(row.trees);
    json.at("births").get_to(row.births);
    json.at("lost").get_to(row.lost);
    json.at("deaths").get_to(row.deaths);
    json.at("counts").get_to(row.counts);
    json.at("mean_share").get_to(row.mean_share);
    return row;
}

void put_forest_trees(Scene& scene, const std::vector<forest::Tree>& trees)
{
    Points points;
    points.stage = "forest";
    std::vector<std::int64_t> uid, kept, cone;
    std::vector<std::int32_t> species, age;
    for (const forest::Tree& tree : trees) {
        points.position.emplace_back(tree.x, tree.y, tree.height);
        uid.push_back(signed_bits(tree.uid));
        species.push_back(tree.species);
        age.push_back(tree.age);
        kept.push_back(signed_bits(tree.kept));
        cone.push_back(tree.cone);
    }
    points.attributes["kept"] = std::move(kept);
    points.attributes["cone"] = std::move(cone);
    points.attributes["uid"] = std::move(uid);
    points.attributes["species"] = std::move(species);
    points.attributes["age"] = std::move(age);
    scene.points["forest_trees"] = std::move(points);
}

std::vector<forest::Tree> forest_trees_of(const Scene& scene)
{
    const Points& points = scene.points_of("forest_trees");
    const auto &uid = column<std::int64_t>(points, "forest_trees", "uid"),
               &kept = column<std::int64_t>(points, "forest_trees", "kept"),
               &cone = column<std::int64_t>(points, "forest_trees", "cone");
    const auto &species = column<std::int32_t>(points, "forest_trees", "species"),
               &age = column<std::int32_t>(points, "forest_trees", "age");
    std::vector<forest::Tree> trees(points.position.size());
    for (std::size_t k = 0; k < trees.size(); ++k) {
        if (species[k] < 0 || species[k] > 255 || age[k] < 0 || age[k] > 0xFFFF)
            throw InvalidInput(fmt::format("forest_trees: tree {} is of species {} and age {}", k,
                                           species[k], age[k]));
        trees[k].x = points.position[k].x;
        trees[k].y = points.position[k].y;
        trees[k].height = points.position[k].z;
        trees[k].uid = unsigned_bits(uid[k]);
        trees[k].species = static_cast<std::uint8_t>(species[k]);
        trees[k].age = static_cast<std::uint16_t>(age[k]);
        trees[k].kept = unsigned_bits(kept[k]);
        trees[k].cone = static_cast<std::uint32_t>(cone[k]);
    }
    return trees;
}

}  // namespace sekitei::apps
