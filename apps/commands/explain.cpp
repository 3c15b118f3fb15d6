#include <fmt/format.h>

#include <algorithm>
#include <cmath>

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
    if (!scene.has("moss_species")) return list;
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

int command_explain(const std::string& file, const std::string& at, const Common& common)
{
    const Vec3d asked = point_of(at);
    ReadOptions options;
    options.memory_limit = common.memory_limit;
    const Scene scene = read_vdb(file, options);
    for (const char* need : {"surface_sdf", "surf_normal", "surf_area"})
        if (!scene.has(need))
            throw InvalidInput(
                fmt::format("{}: its surface has no climate to explain, for there is no '{}'{}",
                            file, need, maker_hint("surf_area")));
    const SurfaceCells cells = surface_cells(
        scene.floats("surface_sdf"), scene.vectors("surf_normal"), scene.floats("surf_area"), {});
    std::size_t cell = 0;
    double nearest = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < cells.size(); ++i) {
        const double distance = length(cells.position[i] - asked);
        if (distance < nearest) nearest = distance, cell = i;
    }
    const Coord voxel = cells.voxel[cell];
    auto value = [&](const std::string& name) { return double(scene.floats(name).value(voxel)); };
    auto known = [&](const std::string& name) { return scene.has(name); };

    Json json;
    const Vec3d p = cells.position[cell];
    const Vec3f n = cells.normal[cell];
    json["asked_m"] = {asked.x, asked.y, asked.z};
    json["cell_m"] = {p.x, p.y, p.z};
    json["away_m"] = nearest;
    json["normal"] = {n.x, n.y, n.z};
    std::string text = fmt::format(
        "cell at {:.4g}, {:.4g}, {:.4g} m, {:.3g} m from the point asked for; normal "
        "{:.2f}, {:.2f}, {:.2f}; area {:.3g} cm2\n",
        p.x, p.y, p.z, nearest, n.x, n.y, n.z, double(cells.area[cell]) * 1e4);
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

    if (known("soil_Ts") && known("soil_rh") && known("light_S")) {
        std::vector<moss::Species> species;
        moss::Rules rules;
        if (const Json* made = params_of(scene, "moss")) {
            for (const Param& param : describe_params(rules))
                if (made->contains(param.name) && !(*made)[param.name].is_null())
                    param.set((*made)[param.name]);
            const Json* soil = params_of(scene, "soil");
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
    if (known("moss_growth")) {
        const std::vector<std::string> names = species_names(scene);
        const int who = scene.ints("moss_species").value(voxel);
        const std::string name = who > 0 && std::size_t(who) <= names.size()
                                     ? names[std::size_t(who) - 1]
                                     : std::string("none");
        json["moss"] = name;
        text += who > 0 ? fmt::format("on it: {}, growth {:.3g}, {} days old\n", name,
                                      value("moss_growth"), scene.ints("moss_age").value(voxel))
                        : "on it: no moss\n";
    }
    print(common.json ? json.dump(2) + "\n" : text);
    return 0;
}

}  // namespace sekitei::apps
