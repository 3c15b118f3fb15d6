#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <functional>
#include <map>

#include "apps/commands/commands.h"
#include "apps/habitat.h"
#include "apps/stage.h"
#include "core/error.h"
#include "core/units.h"
#include "grids/vdb_file.h"

namespace sekitei::apps {
namespace {

/// "1,0.5,20cm" as a point [m].
Vec3d point_of(const std::string& text)
{
    const std::vector<std::string> words = split_names(text);
    if (words.size() != 3) throw InvalidParameter(fmt::format("--at {}: must be x,y,z", text));
    Vec3d p;
    for (int axis = 0; axis < 3; ++axis) try {
            p[axis] = parse_quantity(words[std::size_t(axis)], "m");
        } catch (const InvalidParameter& error) {
            throw InvalidParameter(fmt::format("--at {}: {}", text, error.what()));
        }
    return p;
}

/// A factor of fitness with its name.
struct Factor {
    std::string name;
    double value;
};

/// The species of the moss stage, as it left their numbers.
std::vector<moss::Species> species_of(const Scene& scene)
{
    std::vector<moss::Species> list;
    if (!scene.has("moss_species")) {  // on a mesh only their names are known
        for (const std::string& name : species_names(scene))
            for (const moss::Species& preset : moss::preset_species())
                if (preset.name == name) list.push_back(preset);
        return list;
    }
    const Json& extra = scene.grids.at("moss_species").extra;
    const Json kinds = extra.contains("species")
                           ? Json::parse(extra["species"].get<std::string>(), nullptr, false)
                           : Json();
    for (const Json& kind : kinds.is_array() ? kinds : Json::array()) {
        moss::Species species;
        for (const Param& p : describe_params(species))
            if (kind.is_object() && kind.contains(p.name)) p.set(kind[p.name]);
        moss::validate(species);
        list.push_back(std::move(species));
    }
    return list;
}

}  // namespace

namespace {

/// Where a climate is explained: a cell of a volume, or a site of a mesh.
struct Place {
    Vec3d at;
    Vec3f normal;
    double area = 0;
    std::string what;
    std::int64_t number = 0;  ///< of the site
    std::function<bool(const std::string&)> known;
    std::function<double(const std::string&)> value;
};

template <class Distance>
std::size_t nearest_of(std::size_t count, Distance&& distance)
{
    std::size_t best = 0;
    double least = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < count; ++i)
        if (const double d = distance(i); d < least) least = d, best = i;
    return best;
}

Place cell_at(const Scene& scene, const std::string& file, Vec3d asked)
{
    for (const char* need : {"surface_sdf", "surf_normal", "surf_area"})
        if (!scene.has(need))
            throw InvalidInput(
                fmt::format("{}: its surface has no climate to explain, for there is no '{}'{}",
                            file, need, maker_hint("surf_area")));
    const SurfaceCells cells = surface_cells(
        scene.floats("surface_sdf"), scene.vectors("surf_normal"), scene.floats("surf_area"), {});
    const std::size_t cell =
        nearest_of(cells.size(), [&](std::size_t i) { return length(cells.position[i] - asked); });
    const Coord voxel = cells.voxel[cell];
    return {cells.position[cell],
            cells.normal[cell],
            double(cells.area[cell]),
            "cell",
            std::int64_t(cell),
            [&scene](const std::string& name) { return scene.has(name); },
            [&scene, voxel](const std::string& name) {
                const auto& values = scene.grids.at(name).values;
                if (const auto* whole = std::get_if<IntGrid>(&values))
                    return double(whole->value(voxel));
                return double(scene.floats(name).value(voxel));
            }};
}

/// The face that --face names of `count`.
std::size_t face_of(const std::string& word, std::size_t count)
{
    std::size_t face = 0;
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), face);
    if (error != std::errc{} || end != word.data() + word.size() || face >= count)
        throw InvalidParameter(
            fmt::format("--face {}: must be a whole number from 0 to {}, for the mesh has {} faces",
                        word, count - 1, count));
    return face;
}

/// @param face  as given; empty: the site nearest to `asked`
Place site_at(const Scene& scene, const std::string& file, Vec3d asked, const std::string& face)
{
    const auto found = scene.points.find("sites");
    if (found == scene.points.end())
        throw InvalidInput(fmt::format(
            "{}: --face: the scene is not about a mesh; run `sekitei light` or `sekitei moss` on "
            "one, or give --at",
            file));
    const Points& sites = found->second;
    const std::size_t count = sites.position.size();
    const std::size_t site =
        !face.empty()
            ? face_of(face, count)
            : nearest_of(count, [&](std::size_t i) { return length(sites.position[i] - asked); });
    const auto* normal = sites.values<Vec3f>("N");
    const auto* area = sites.values<float>("area");
    if (!normal || !area)
        throw InvalidInput(fmt::format("{}: the points 'sites' have no N and area", file));
    return {sites.position[site],
            (*normal)[site],
            double((*area)[site]),
            fmt::format("face {}", site),
            std::int64_t(site),
            [&sites](const std::string& name) {
                return sites.values<float>(name) || sites.values<std::int32_t>(name);
            },
            [&sites, site](const std::string& name) {
                if (const auto* list = sites.values<float>(name)) return double((*list)[site]);
                return double((*sites.values<std::int32_t>(name))[site]);
            }};
}

/// The mosses that stand on a site.
std::string mosses_on(const Scene& scene, std::int64_t number, Json& json)
{
    const auto found = scene.points.find("moss");
    if (found == scene.points.end()) return "";
    const Points& moss = found->second;
    const auto* host = moss.values<std::int64_t>("host");
    const auto* id = moss.values<std::int64_t>("id");
    const auto* kind = moss.values<std::int32_t>("species");
    const auto* growth = moss.values<float>("growth");
    const auto* age = moss.values<std::int32_t>("age");
    if (!host || !id || !kind || !growth || !age) return "";
    const std::vector<std::string> names = species_names(scene);
    // A moss stands on land (-1 - site) or on another moss (its id), which may be dead by now.
    std::map<std::int64_t, std::int64_t> host_of;
    for (std::size_t i = 0; i < id->size(); ++i) host_of[(*id)[i]] = (*host)[i];
    auto land_below = [&](std::int64_t below) {
        for (int level = 0; below > 0 && level < 8; ++level) {
            const auto next = host_of.find(below);
            below = next == host_of.end() ? 0 : next->second;
        }
        return -1 - below;
    };
    std::string text;
    json["mosses"] = Json::array();
    for (std::size_t i = 0; i < host->size(); ++i) {
        if (land_below((*host)[i]) != number) continue;
        const std::size_t k = static_cast<std::size_t>((*kind)[i]);
        const std::string name = k < names.size() ? names[k] : std::to_string(k);
        json["mosses"].push_back({{"name", name}, {"growth", (*growth)[i]}, {"age", (*age)[i]}});
        text +=
            fmt::format("on it: {}, growth {:.3g}, {} days old\n", name, (*growth)[i], (*age)[i]);
    }
    return text.empty() ? "on it: no moss\n" : text;
}

}  // namespace

int command_explain(const std::string& file, const std::string& at, const std::string& face,
                    const Common& common)
{
    if (at.empty() == face.empty())
        throw InvalidParameter("explain: which place? give --at x,y,z or --face NUMBER");
    const Vec3d asked = face.empty() ? point_of(at) : Vec3d();
    ReadOptions options;
    options.memory_limit = common.memory_limit;
    const Scene scene = read_vdb(file, options);
    const bool mesh = !face.empty() || scene.points.contains("sites");
    const Place place = mesh ? site_at(scene, file, asked, face) : cell_at(scene, file, asked);
    auto value = [&](const std::string& name) { return place.value(name); };
    auto known = [&](const std::string& name) { return place.known(name); };

    Json json;
    const Vec3d p = place.at;
    const Vec3f n = place.normal;
    const double nearest = face.empty() ? length(p - asked) : 0;
    if (face.empty()) json["asked_m"] = {asked.x, asked.y, asked.z};
    json[mesh ? "site_m" : "cell_m"] = {p.x, p.y, p.z};
    json["away_m"] = nearest;
    json["normal"] = {n.x, n.y, n.z};
    std::string text = fmt::format(
        "{} at {:.4g}, {:.4g}, {:.4g} m{}; normal {:.2f}, {:.2f}, {:.2f}; area {:.3g} "
        "cm2\n",
        place.what, p.x, p.y, p.z,
        face.empty() ? fmt::format(", {:.3g} m from the point asked for", nearest) : "", n.x, n.y,
        n.z, place.area * 1e4);
    auto row = [&](const char* name, const char* label, const char* unit) {
        if (!known(name)) return;
        json[name] = value(name);
        text += fmt::format("  {:<28} {:>10.4g} {}\n", label, value(name), unit);
    };
    text += "means over the days of the stages that made them\n";
    row("light_S", "light S", "W/m2");
    row("light_direct", "  of it direct", "W/m2");
    row("light_sky", "  of it from the sky", "W/m2");
    row("light_reflected", "  of it reflected", "W/m2");
    row("light_indirect", "  of it indirect", "W/m2");
    row("sky_view", "sky view", "");
    row("rain_exposure", "rain exposure", "");
    if (known("wind_ratio_0") && scene.points.contains("air_tables") &&
        scene.points.contains("weather")) {
        const wind::AirTables tables = tables_of(scene);
        const Weather weather = weather_of(scene);
        double speed = 0;
        for (const WeatherDay& day : weather.days) {
            const auto k = std::size_t(day.wind_direction);
            speed += day.wind_speed * tables.speed[k] *
                     value(fmt::format("wind_ratio_{}", day.wind_direction));
        }
        speed /= double(weather.days.size());
        json["wind_speed"] = speed;
        text += fmt::format("  {:<28} {:>10.4g} m/s\n", "wind", speed);
        std::string ratios;
        for (int k = 0; k < 8; ++k) {
            const double ratio = value(fmt::format("wind_ratio_{}", k));
            json["wind_ratio"].push_back(ratio);
            ratios += fmt::format(" {} {:.2f}", wind_name(k), ratio);
        }
        text += fmt::format("  {:<28}{}\n", "  its share of the inflow", ratios);
    }
    row("soil_Ts", "surface temperature T_s", "K");
    row("soil_rh", "surface humidity rh_s", "");
    row("soil_theta", "water content theta", "");
    row("soil_beta", "evaporation share beta", "");
    row("soil_E", "evaporation E", "mm/day");
    row("soil_runoff", "runoff", "mm/day");
    row("soil_water", "water on the last day", "mm");
    row("soil_h", "depth of soil", "mm");
    row("moss_cover", "moss around it", "");

    if (known("soil_Ts") && known("soil_rh") && known("light_S")) {
        std::vector<moss::Species> species;
        moss::Rules rules;
        if (const Json* made = params_of(scene, "moss")) {
            for (const Param& param : describe_params(rules))
                if (made->contains(param.name) && !(*made)[param.name].is_null())
                    param.set((*made)[param.name]);
            // On a mesh the moss stage itself says how the ground is.
            const Json* soil = mesh ? made : params_of(scene, "soil");
            if ((*made)["light_gate"].is_null() && soil && soil->value("profile", "") == "paper")
                rules.light_gate = false;
            species = species_of(scene);
        } else
            species = moss::preset_species();
        text += "fitness at these means: temperature x humidity x light x gate = G\n";
        for (const moss::Species& s : species) {
            const moss::Fitness f =
                moss::fitness(s, rules, value("soil_Ts"), value("soil_rh"), value("light_S"));
            std::vector<Factor> factors = {{"temperature", f.temperature},
                                           {"humidity", f.humidity},
                                           {"light", f.light},
                                           {"gate", f.gate}};
            const Factor limiting = *std::min_element(
                factors.begin(), factors.end(),
                [](const Factor& a, const Factor& b) { return a.value < b.value; });
            Json entry = {{"name", s.name},           {"temperature", f.temperature},
                          {"humidity", f.humidity},   {"light", f.light},
                          {"gate", f.gate},           {"G", f.total()},
                          {"limiting", limiting.name}};
            std::string daily;
            if (known("suit_" + s.name)) {
                entry["mean_G"] = value("suit_" + s.name);
                daily = fmt::format("; mean of every day's G {:.3f}", value("suit_" + s.name));
            }
            text += fmt::format("  {:<12} {:.3f} x {:.3f} x {:.3f} x {:.3f} = {:.3f}, {}{}\n",
                                s.name, f.temperature, f.humidity, f.light, f.gate, f.total(),
                                f.total() > s.growth_threshold
                                    ? fmt::format("grows; {} limits", limiting.name)
                                    : fmt::format("too little to grow: {} limits", limiting.name),
                                daily);
            json["species"].push_back(std::move(entry));
        }
    }
    if (mesh) {
        text += mosses_on(scene, place.number, json);
    } else if (known("moss_growth")) {
        const std::vector<std::string> names = species_names(scene);
        const int who = int(value("moss_species"));
        const std::string name = who > 0 && std::size_t(who) <= names.size()
                                     ? names[std::size_t(who) - 1]
                                     : std::string("none");
        json["moss"] = name;
        text += who > 0 ? fmt::format("on it: {}, growth {:.3g}, {} days old\n", name,
                                      value("moss_growth"), int(value("moss_age")))
                        : "on it: no moss\n";
    }
    print(common.json ? json.dump(2) + "\n" : text);
    return 0;
}

}  // namespace sekitei::apps
