#include "apps/explain.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "apps/habitat.h"
#include "apps/stage.h"
#include "core/error.h"
#include "core/json.h"

namespace sekitei::apps {
namespace {

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
    const Json kinds =
        extra.contains("species") ? parse_json(extra["species"].get<std::string>(), false) : Json();
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

Explainer::Explainer(const Scene& scene, const std::string& file, bool sites)
    : scene_(scene), mesh_(sites || scene.points.contains("sites"))
{
    if (mesh_) {
        const auto found = scene.points.find("sites");
        if (found == scene.points.end())
            throw InvalidInput(
                fmt::format("{}: --face: the scene is not about a mesh; run `sekitei light` or "
                            "`sekitei moss` on one, or give --at",
                            file));
        const auto* normal = found->second.values<Vec3f>("N");
        const auto* area = found->second.values<float>("area");
        if (!normal || !area)
            throw InvalidInput(fmt::format("{}: the points 'sites' have no N and area", file));
        position_ = found->second.position;
        normal_ = *normal;
        area_ = *area;
    } else {
        for (const char* need : {"surface_sdf", "surf_normal", "surf_area"})
            if (!scene.has(need))
                throw InvalidInput(
                    fmt::format("{}: its surface has no climate to explain, for there is no '{}'{}",
                                file, need, maker_hint("surf_area")));
        SurfaceCells cells =
            surface_cells(scene.floats("surface_sdf"), scene.vectors("surf_normal"),
                          scene.floats("surf_area"), {});
        position_ = std::move(cells.position);
        normal_ = std::move(cells.normal);
        area_ = std::move(cells.area);
        voxel_ = std::move(cells.voxel);
    }
    find_measures(scene);
    find_species(scene);
    find_mosses();
}

bool Explainer::known(const std::string& name) const
{
    if (!mesh_) return scene_.has(name);
    const Points& sites = scene_.points.at("sites");
    return sites.values<float>(name) || sites.values<std::int32_t>(name);
}

std::function<double(std::size_t)> Explainer::values_of(const std::string& name) const
{
    if (mesh_) {
        const Points& sites = scene_.points.at("sites");
        if (const auto* list = sites.values<float>(name))
            return [list](std::size_t place) { return double((*list)[place]); };
        const auto* whole = sites.values<std::int32_t>(name);
        return [whole](std::size_t place) { return double((*whole)[place]); };
    }
    if (const auto* whole = std::get_if<IntGrid>(&scene_.grids.at(name).values))
        return [this, whole](std::size_t place) { return double(whole->value(voxel_[place])); };
    const FloatGrid& grid = scene_.floats(name);
    return [this, &grid](std::size_t place) { return double(grid.value(voxel_[place])); };
}

void Explainer::find_measures(const Scene& scene)
{
    auto measure = [&](const char* name, const char* label, const char* unit) {
        if (known(name)) measures_.push_back({name, label, unit, values_of(name)});
    };
    measure("light_S", "light S", "W/m2");
    measure("light_direct", "  of it direct", "W/m2");
    measure("light_sky", "  of it from the sky", "W/m2");
    measure("light_reflected", "  of it reflected", "W/m2");
    measure("light_indirect", "  of it indirect", "W/m2");
    measure("sky_view", "sky view", "");
    measure("rain_exposure", "rain exposure", "");
    if (known("wind_ratio_0") && scene.points.contains("air_tables") &&
        scene.points.contains("weather")) {
        const wind::AirTables tables = tables_of(scene);
        const Weather weather = weather_of(scene);
        // Wind at a place is its ratio times the inflow: of each direction the sum is enough.
        std::array<double, 8> inflow{};
        for (const WeatherDay& day : weather.days) {
            const auto k = std::size_t(day.wind_direction);
            inflow[k] += day.wind_speed * tables.speed[k];
        }
        for (double& sum : inflow) sum /= double(weather.days.size());
        for (int k = 0; k < 8; ++k) wind_.push_back(values_of(fmt::format("wind_ratio_{}", k)));
        measures_.push_back({"wind_speed", "wind", "m/s", [inflow, this](std::size_t place) {
                                 double speed = 0;
                                 for (int k = 0; k < 8; ++k)
                                     speed += inflow[std::size_t(k)] * wind_ratio(place, k);
                                 return speed;
                             }});
    }
    measure("soil_Ts", "surface temperature T_s", "K");
    measure("soil_rh", "surface humidity rh_s", "");
    measure("soil_theta", "water content theta", "");
    measure("soil_beta", "evaporation share beta", "");
    measure("soil_E", "evaporation E", "mm/day");
    measure("soil_runoff", "runoff", "mm/day");
    measure("soil_water", "water on the last day", "mm");
    measure("soil_h", "depth of soil", "mm");
    measure("moss_cover", "moss around it", "");
}

void Explainer::find_species(const Scene& scene)
{
    if (!known("soil_Ts") || !known("soil_rh") || !known("light_S")) return;
    if (const Json* made = params_of(scene, "moss")) {
        for (const Param& param : describe_params(rules_))
            if (made->contains(param.name) && !(*made)[param.name].is_null())
                param.set((*made)[param.name]);
        // On a mesh the moss stage itself says how the ground is.
        const Json* soil = mesh_ ? made : params_of(scene, "soil");
        if ((*made)["light_gate"].is_null() && soil && soil->value("profile", "") == "paper")
            rules_.light_gate = false;
        species_ = species_of(scene);
    } else
        species_ = moss::preset_species();
    warmth_ = values_of("soil_Ts");
    humidity_ = values_of("soil_rh");
    light_ = values_of("light_S");
    for (const moss::Species& s : species_)
        suit_.push_back(known("suit_" + s.name) ? values_of("suit_" + s.name) : nullptr);
}

void Explainer::find_mosses()
{
    names_ = species_names(scene_);
    if (!mesh_) {
        knows_moss_ = known("moss_growth") && known("moss_species") && known("moss_age");
        return;
    }
    const auto found = scene_.points.find("moss");
    if (found == scene_.points.end()) return;
    const Points& moss = found->second;
    const auto* host = moss.values<std::int64_t>("host");
    const auto* id = moss.values<std::int64_t>("id");
    knows_moss_ = host && id && moss.values<std::int32_t>("species") &&
                  moss.values<float>("growth") && moss.values<std::int32_t>("age");
    if (!knows_moss_) return;
    // A moss stands on land (-1 - site) or on another moss (its id), which may be dead by now.
    std::map<std::int64_t, std::int64_t> host_of;
    for (std::size_t i = 0; i < id->size(); ++i) host_of[(*id)[i]] = (*host)[i];
    for (std::size_t i = 0; i < host->size(); ++i) {
        std::int64_t below = (*host)[i];
        for (int level = 0; below > 0 && level < 8; ++level) {
            const auto next = host_of.find(below);
            below = next == host_of.end() ? 0 : next->second;
        }
        on_site_.emplace(-1 - below, i);
    }
}

std::string Explainer::name(std::size_t place) const
{
    return mesh_ ? fmt::format("face {}", place) : "cell";
}

std::size_t Explainer::nearest(Vec3d point) const
{
    std::size_t best = 0;
    double least = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < size(); ++i)
        if (const double d = length(position_[i] - point); d < least) least = d, best = i;
    return best;
}

Verdict Explainer::verdict(std::size_t place, std::size_t k) const
{
    Verdict verdict;
    const moss::Fitness f =
        moss::fitness(species_[k], rules_, warmth_(place), humidity_(place), light_(place));
    verdict.fitness = f;
    const std::array<double, 4> factors{f.temperature, f.humidity, f.light, f.gate};
    verdict.limiting =
        static_cast<int>(std::min_element(factors.begin(), factors.end()) - factors.begin());
    verdict.grows = f.total() > species_[k].growth_threshold;
    if (suit_[k]) verdict.mean = suit_[k](place);
    return verdict;
}

std::vector<Growing> Explainer::growing(std::size_t place) const
{
    std::vector<Growing> list;
    if (!knows_moss_) return list;
    if (!mesh_) {
        const int who = int(values_of("moss_species")(place));
        if (who > 0)
            list.push_back({std::size_t(who) <= names_.size() ? names_[std::size_t(who) - 1]
                                                              : std::string("none"),
                            values_of("moss_growth")(place), int(values_of("moss_age")(place))});
        return list;
    }
    const Points& moss = scene_.points.at("moss");
    const auto [first, last] = on_site_.equal_range(std::int64_t(place));
    for (auto found = first; found != last; ++found) {
        const std::size_t i = found->second;
        const auto k = static_cast<std::size_t>((*moss.values<std::int32_t>("species"))[i]);
        list.push_back({k < names_.size() ? names_[k] : std::to_string(k),
                        double((*moss.values<float>("growth"))[i]),
                        int((*moss.values<std::int32_t>("age"))[i])});
    }
    return list;
}

std::string explain_text(const Explainer& explainer, std::size_t place,
                         const std::optional<Vec3d>& asked)
{
    const Vec3d p = explainer.position(place);
    const Vec3f n = explainer.normal(place);
    std::string text = fmt::format(
        "{} at {:.4g}, {:.4g}, {:.4g} m{}; normal {:.2f}, {:.2f}, {:.2f}; area {:.3g} "
        "cm2\nmeans over the days of the stages that made them\n",
        explainer.name(place), p.x, p.y, p.z,
        asked ? fmt::format(", {:.3g} m from the point asked for", length(p - *asked)) : "", n.x,
        n.y, n.z, explainer.area(place) * 1e4);
    for (const Measure& m : explainer.measures()) {
        text += fmt::format("  {:<28} {:>10.4g} {}\n", m.label, m.value(place), m.unit);
        if (m.name != "wind_speed") continue;
        std::string ratios;
        for (int k = 0; k < 8; ++k)
            ratios += fmt::format(" {} {:.2f}", wind_name(k), explainer.wind_ratio(place, k));
        text += fmt::format("  {:<28}{}\n", "  its share of the inflow", ratios);
    }
    if (!explainer.species().empty())
        text += "fitness at these means: temperature x humidity x light x gate = G\n";
    for (std::size_t k = 0; k < explainer.species().size(); ++k) {
        const Verdict v = explainer.verdict(place, k);
        const char* limiting = kFactors[std::size_t(v.limiting)];
        text += fmt::format("  {:<12} {:.3f} x {:.3f} x {:.3f} x {:.3f} = {:.3f}, {}{}\n",
                            explainer.species()[k].name, v.fitness.temperature, v.fitness.humidity,
                            v.fitness.light, v.fitness.gate, v.fitness.total(),
                            v.grows ? fmt::format("grows; {} limits", limiting)
                                    : fmt::format("too little to grow: {} limits", limiting),
                            v.mean ? fmt::format("; mean of every day's G {:.3f}", *v.mean) : "");
    }
    if (!explainer.knows_moss()) return text;
    const std::vector<Growing> growing = explainer.growing(place);
    for (const Growing& moss : growing)
        text += fmt::format("on it: {}, growth {:.3g}, {} days old\n", moss.name, moss.growth,
                            moss.days);
    return growing.empty() ? text + "on it: no moss\n" : text;
}

Json explain_json(const Explainer& explainer, std::size_t place, const std::optional<Vec3d>& asked)
{
    Json json;
    const Vec3d p = explainer.position(place);
    const Vec3f n = explainer.normal(place);
    if (asked) json["asked_m"] = {asked->x, asked->y, asked->z};
    json[explainer.of_mesh() ? "site_m" : "cell_m"] = {p.x, p.y, p.z};
    json["away_m"] = asked ? length(p - *asked) : 0.0;
    json["normal"] = {n.x, n.y, n.z};
    for (const Measure& m : explainer.measures()) json[m.name] = m.value(place);
    for (int k = 0; explainer.has_wind() && k < 8; ++k)
        json["wind_ratio"].push_back(explainer.wind_ratio(place, k));
    for (std::size_t k = 0; k < explainer.species().size(); ++k) {
        const Verdict v = explainer.verdict(place, k);
        Json entry = {{"name", explainer.species()[k].name},
                      {"temperature", v.fitness.temperature},
                      {"humidity", v.fitness.humidity},
                      {"light", v.fitness.light},
                      {"gate", v.fitness.gate},
                      {"G", v.fitness.total()},
                      {"limiting", kFactors[std::size_t(v.limiting)]}};
        if (v.mean) entry["mean_G"] = *v.mean;
        json["species"].push_back(std::move(entry));
    }
    if (!explainer.knows_moss()) return json;
    const std::vector<Growing> growing = explainer.growing(place);
    if (explainer.of_mesh()) {
        json["mosses"] = Json::array();
        for (const Growing& moss : growing)
            json["mosses"].push_back(
                {{"name", moss.name}, {"growth", moss.growth}, {"age", moss.days}});
    } else
        json["moss"] = growing.empty() ? "none" : growing.front().name;
    return json;
}

}  // namespace sekitei::apps
