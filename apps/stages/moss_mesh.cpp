#include "apps/stages/moss_mesh.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <memory>

#include "apps/climate.h"
#include "apps/habitat.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/hash.h"
#include "core/log.h"
#include "core/math.h"
#include "core/parallel.h"
#include "grids/surface_cells.h"
#include "grids/surface_transfer.h"
#include "solvers/light/light.h"
#include "solvers/soil/mesh_depth.h"

namespace sekitei::apps {
namespace {

namespace fs = std::filesystem;

constexpr int kCheckpointDays = 10;
constexpr int kHighestStack = 3;  // of mosses on mosses, in sizes: what photons may meet over land

/// Weather of the run: a file, what the scene has, or the same every day.
Weather weather_of_run(const Scene& scene, const MeshMossParams& params, const MossRun& run,
                       const StageContext& context, bool& real)
{
    real = true;
    if (!params.weather.weather.empty())
        return chosen_weather(params.weather, run.days, run.repeat_year, "moss", context.folder);
    if (scene.points.contains("weather")) {
        const Weather there = weather_of(scene);
        return select_days(there, 0, run.days ? std::size_t(*run.days) : there.days.size(),
                           run.repeat_year);
    }
    real = false;
    return steady_weather(params.steady, run.days ? std::size_t(*run.days) : 365);
}

/// What of a mesh never changes, and its state.
class MeshMoss {
public:
    MeshMoss(Scene& scene, const StageContext& context, const MeshMossParams& params,
             const MossRun& run)
        : scene_(scene),
          context_(context),
          p_(params),
          run_(run),
          was_(scene.meshes.at("rock")),
          sites_(sites_of(was_, params.land.site, "moss", context.progress.slice(0, 0.02))),
          surface_(sites_, context.progress.slice(0.02, 0.03)),
          statistics_(int(run.species.size()), true),
          zones_(was_, sites_, int(run.species.size()))
    {
        const Progress setup = context.progress.slice(0.03, 0.1);
        check_mesh_memory(scene, sites_, p_.photons, p_.colony.cap, p_.cell.value_or(p_.land.site),
                          mesh_moss_fields().size() + run.species.size(), "moss",
                          context.memory_limit);
        check_mesh_albedo(p_.climate.ground.albedo, "moss");
        const bool full = p_.climate.profile == Profile::Full;
        weather_ = weather_of_run(scene, p_, run_, context_, real_weather_);
        mode_ = sun_mode(p_.land, real_weather_);
        sky_ = full && mode_ == SunMode::Path;
        ema_ = p_.ema_days.value_or(full ? 10 : 1);
        rules_ = run.rules;
        rules_.light_gate = run.light_gate.value_or(full);
        community_ = {run.species, rules_, run.propagation, context.seed};
        moss::validate(community_);
        mask_ = p_.mask.empty() ? std::vector<float>() : mask_of(p_.mask);

        Exposure seen = exposure_of(sites_, weather_.site->latitude,
                                    light::rain_winds(weather_.days), setup.slice(0, 0.6));
        sky_view_ = std::move(seen.sky_view);
        rain_exposure_ = std::move(seen.rain_exposure);
        make_ground(setup.slice(0.6, 0.9));
        // Only the water's paths ask who lies beside whom.
        sites_.neighbour_begin = sites_.neighbour = {};

        std::vector<float> albedo(sites_.size());
        for (std::size_t i = 0; i < albedo.size(); ++i) {
            const int g = ground_.geology()[i];
            const soil::Soil& soil =
                g == kOwnSoil ? ground_.soils().back() : ground_.soils()[std::size_t(g - 1)];
            albedo[i] = static_cast<float>(soil.albedo.value_or(p_.climate.ground.albedo));
        }
        rays_ = std::make_unique<light::PhotonScene>(sites_.mesh, albedo, p_.moss_albedo,
                                                     (kHighestStack + 1) * p_.colony.size,
                                                     setup.slice(0.9, 1));
        light::validate(p_.photons, rays_->radius());
        kernel_ = std::make_unique<light::SiteKernel>(sites_.position, sites_.normal, sites_.area,
                                                      p_.photons, p_.colony.size, &sites_.mesh);
        room_ = moss::cover_capacity(p_.colony, sites_);
    }

    Json run()
    {
        const std::size_t n = sites_.size(), days = weather_.days.size();
        now_.colony = moss::first_settlers(community_, p_.colony, sites_);
        now_.water = ground_.initial_water();
        now_.means.emplace(ground_);
        for (auto* list : {&now_.light, &now_.beam, &now_.sky, &now_.indirect, &now_.humidity})
            list->assign(n, 0);
        now_.fitness.assign(run_.species.size(), std::vector<float>(n));
        classify();
        const fs::path file = run_.checkpoint.empty() ? context_.checkpoint
                                                      : Stage::resolve(context_, run_.checkpoint);
        const std::string recipe = file.empty() ? "" : identity();
        if (!file.empty() && fs::exists(file)) restore(file, recipe);
        now_.cover = moss::cover(now_.colony.plants, p_.colony, sites_, room_);

        const Progress progress = context_.progress.slice(0.1, 0.97);
        for (auto d = static_cast<std::size_t>(now_.colony.day); d < days; ++d) {
            day(d, progress.slice(1, 1));
            const int done = int(d) + 1;
            if (run_.every > 0 && context_.frame && (done % run_.every == 0 || done == int(days))) {
                put(progress.slice(1, 1));
                context_.frame(done, scene_);
            }
            if (!file.empty() && done % kCheckpointDays == 0 && done < int(days))
                write_file(file, moss::encode(checkpoint(recipe)));
            progress.update(double(done) / double(days));
        }
        put(context_.progress.slice(0.97, 1));
        if (!file.empty() && run_.checkpoint.empty()) {
            std::error_code ignored;
            fs::remove(file, ignored);
        }
        return summary();
    }

private:
    std::vector<float> mask_of(const std::string& name) const
    {
        std::vector<float> mask = attribute_at_sites(was_, sites_, name);
        for (std::size_t i = 0; i < mask.size(); ++i)
            if (!(mask[i] >= 0 && mask[i] <= 1))
                throw InvalidInput(
                    fmt::format("the mesh's attribute '{}': {} on face {}, must be 0 to 1", name,
                                mask[i], sites_.face[i]));
        return mask;
    }

    void make_ground(const Progress& progress)
    {
        GroundSites s;
        s.area = sites_.area;
        s.sky_view = sky_view_;
        s.rain_exposure = rain_exposure_;
        s.own = find_soil(p_.climate.soil, context_.folder);
        s.geology = geology_of(was_, sites_, p_, context_.folder, progress.slice(0, 0.2));
        const ClimateParams climate = resolved(p_.climate);
        soil::MeshDepth below = soil::mesh_depth(sites_, progress.slice(0.2, 0.6));
        s.depth = std::move(below.depth);
        for (std::size_t i = 0; i < s.depth.size(); ++i)
            if (climate.depth)
                s.depth[i] = static_cast<float>(*climate.depth * 1000);
            else if (is_stone(s.geology[i]))
                s.depth[i] = kSkinDepth;
        if (scene_.has("wind_ratio_0") && scene_.has("surf_area")) {
            const SurfaceCells cells =
                surface_cells(scene_.floats("surface_sdf"), scene_.vectors("surf_normal"),
                              scene_.floats("surf_area"), progress.slice(0.6, 0.7));
            const SurfaceTransfer transfer =
                cells_to_sites(cells, sites_, progress.slice(0.7, 0.8));
            for (int k = 0; k < 8; ++k)
                s.wind_ratio[std::size_t(k)] = transfer.apply(
                    cells.from_grid(scene_.floats(fmt::format("wind_ratio_{}", k)), 1), 1);
            s.tables = tables_of(scene_);
            if (!s.tables.layers.empty()) {
                s.layer.resize(sites_.size());
                for (std::size_t i = 0; i < s.layer.size(); ++i)
                    s.layer[i] =
                        static_cast<std::uint8_t>(s.tables.layer_at(double(sites_.position[i].z)));
            }
        }
        if (*climate.runoff) {
            std::vector<Vec3d> at;
            std::vector<float> up;
            for (const Vec3f p : sites_.position) at.emplace_back(p);
            for (const Vec3f n : sites_.normal) up.push_back(n.z);
            s.paths = soil::runoff_paths(
                {at, up, sites_.area, sites_.neighbour_begin, sites_.neighbour, below.drop_target},
                progress.slice(0.8, 1));
        }
        ground_ = Ground(p_.climate, *weather_.site, std::move(s));
    }

    /// Which sites are shady: by the light of all days together, before any moss grows.
    void classify()
    {
        const light::Daylight all =
            daylight_of(p_.land, mode_, sky_, weather_.days, *weather_.site);
        const light::Shot shot = shoot(*rays_, all, p_.photons, context_.seed, 0, {});
        const light::PhotonLight found = light::light_of_day(
            *rays_, *kernel_, all, shot.photons, {}, {}, p_.photons, context_.seed, 0, {});
        std::vector<float> total(sites_.size());
        for (std::size_t i = 0; i < total.size(); ++i) total[i] = found.sites.total(i);
        const double lowest = sites_.mesh.bounds().lower.z;
        statistics_.choose(sites_, total,
                           scene_.domain.dims.z > 0 ? scene_.domain.transform.origin.z : lowest);
    }

    void day(std::size_t d, const Progress& progress)
    {
        moss::Plants& plants = now_.colony.plants;
        moss::Seeds& seeds = now_.colony.seeds;
        const auto number = static_cast<std::uint64_t>(d) + 1;
        const std::size_t n = sites_.size();

        // Light, with the mosses of the morning in its way.
        const light::Daylight daylight =
            daylight_of(p_.land, mode_, sky_, {&weather_.days[d], 1}, *weather_.site);
        rays_->set_moss(moss::spheres(plants, p_.colony));
        const light::Shot shot =
            shoot(*rays_, daylight, p_.photons, context_.seed, number, progress);
        weigh_new(plants);
        weigh_new(seeds);
        const std::size_t first_seed = plants.size(), all = first_seed + seeds.size();
        std::vector<Vec3f> at(plants.foot), normal(plants.normal);
        std::vector<float> area(plants.light_area);
        std::vector<std::int32_t> ball(all, -1);
        at.insert(at.end(), seeds.foot.begin(), seeds.foot.end());
        normal.insert(normal.end(), seeds.normal.begin(), seeds.normal.end());
        area.insert(area.end(), seeds.light_area.begin(), seeds.light_area.end());
        for (std::size_t i = 0; i < first_seed; ++i) ball[i] = static_cast<std::int32_t>(i);
        const light::PhotonLight found = light::light_of_day(
            *rays_, *kernel_, daylight, shot.photons, {plants.foot, plants.normal, plants.site},
            {at, normal, area, ball}, p_.photons, context_.seed, number, progress);

        std::vector<float> today(n);
        for (std::size_t i = 0; i < n; ++i) today[i] = found.sites.total(i);
        light::running_mean(now_.light, today, int(number), ema_);
        add_to_mean(now_.beam, number, [&](std::size_t i) { return found.sites.beam[i]; });
        add_to_mean(now_.sky, number, [&](std::size_t i) { return found.sites.sky[i]; });
        add_to_mean(now_.indirect, number, [&](std::size_t i) { return found.sites.indirect[i]; });
        remember(plants, found.receivers, 0, int(number));
        remember(seeds, found.receivers, first_seed, int(number));

        // Ground, then fitness of everyone in their own light.
        if (p_.own_energy) {
            water_before_ = now_.water;
            cover_before_ = now_.cover;
        }
        ground_.advance(weather_.days[d], now_.light, now_.water, now_.cover, ground_day_,
                        progress);
        const std::vector<float> plant_fitness = fitness_of(plants),
                                 seed_fitness = fitness_of(seeds);
        for (std::size_t s = 0; s < run_.species.size(); ++s) {
            moss::fitness(run_.species[s], rules_, ground_day_.ground.temperature,
                          ground_day_.ground.humidity, now_.light, site_fitness_(s), progress);
            std::vector<float>& g = site_fitness_(s);
            if (!mask_.empty())
                for (std::size_t i = 0; i < n; ++i) g[i] *= mask_[i];
            add_to_mean(now_.fitness[s], number, [&](std::size_t i) { return g[i]; });
        }

        const double from = weather_.days[d].wind_direction * math::kPi / 4;
        const moss::DayStatistics mosses = moss::day(now_.colony, community_, p_.colony, surface_,
                                                     {plant_fitness,
                                                      seed_fitness,
                                                      ground_day_.wind,
                                                      {-math::sin(from), -math::cos(from), 0}},
                                                     progress);
        now_.cover = moss::cover(now_.colony.plants, p_.colony, sites_, room_);
        now_.means->add(ground_day_, now_.water);
        now_.humidity = ground_day_.ground.humidity;
        count(mosses, shot, found);
    }

    std::vector<float>& site_fitness_(std::size_t species)
    {
        fitness_today_.resize(run_.species.size());
        fitness_today_[species].resize(sites_.size());
        return fitness_today_[species];
    }

    void count(const moss::DayStatistics& mosses, const light::Shot& shot,
               const light::PhotonLight& found)
    {
        const double rest = std::sqrt(3.0) / 2 * p_.colony.size * p_.colony.size;
        std::vector<double> low(run_.species.size());
        const moss::Plants& plants = now_.colony.plants;
        for (std::size_t i = 0; i < plants.size(); ++i)
            if (statistics_.is_low(plants.site[i])) low[plants.species[i]] += rest;
        double rests_on = 0;
        for (const std::int32_t k : found.sites.photons) rests_on += k;
        const light::Ledger& l = shot.ledger;
        const double more[] = {l.emitted,
                               l.missed,
                               l.absorbed,
                               l.escaped,
                               l.lost,
                               double(shot.photons.size()),
                               rests_on / double(sites_.size())};
        statistics_.add(now_.colony.day, ground_, ground_day_, now_.light, now_.water,
                        {&mosses, {}, fitness_today_, low}, more);
        zones_.add(now_.colony.day, plants, fitness_today_, now_.light, now_.water,
                   ground_.depth());
        lost_ += l.lost;
        emitted_ += l.emitted;
    }

    /// The kernel's area of those that came since yesterday.
    void weigh_new(moss::Individuals& who) const
    {
        std::vector<std::size_t> fresh;
        for (std::size_t i = 0; i < who.size(); ++i)
            if (who.light_area[i] == 0) fresh.push_back(i);
        std::vector<Vec3f> at, normal;
        for (const std::size_t i : fresh)
            at.push_back(who.foot[i]), normal.push_back(who.normal[i]);
        const std::vector<float> area = kernel_->kernel_area(at, normal);
        for (std::size_t k = 0; k < fresh.size(); ++k) who.light_area[fresh[k]] = area[k];
    }

    /// Takes today's light of individuals into their running means, each from its first day on.
    void remember(moss::Individuals& who, const light::Irradiance& found, std::size_t first,
                  int today) const
    {
        parallel_for(
            who.size(),
            [&](std::size_t i) {
                const int lived = std::max(1, today - who.landed[i]);
                who.light[i] += (found.total(first + i) - who.light[i]) /
                                static_cast<float>(std::min(lived, ema_));
            },
            4096);
    }

    std::vector<float> fitness_of(const moss::Individuals& who) const
    {
        std::vector<float> g(who.size());
        parallel_for(
            who.size(),
            [&](std::size_t i) {
                const std::size_t site = who.site[i];
                double temperature = double(ground_day_.ground.temperature[site]),
                       humidity = double(ground_day_.ground.humidity[site]);
                if (p_.own_energy) {
                    const soil::Day own =
                        ground_.day_at(site, ground_day_, double(who.light[i]), water_before_[site],
                                       double(cover_before_[site]));
                    temperature = own.temperature;
                    humidity = own.humidity;
                }
                const double fit = moss::fitness(run_.species[who.species[i]], rules_, temperature,
                                                 humidity, double(who.light[i]))
                                       .total();
                g[i] = static_cast<float>(mask_.empty() ? fit : fit * double(mask_[site]));
            },
            1024);
        return g;
    }

    void put(const Progress& progress)
    {
        const std::size_t n = sites_.size();
        std::vector<SiteField> fields;
        std::vector<float> total(n);
        for (std::size_t i = 0; i < n; ++i)
            total[i] = now_.beam[i] + now_.sky[i] + now_.indirect[i];
        fields.push_back({"light_S", "W/m^2", std::move(total)});
        fields.push_back({"light_direct", "W/m^2", now_.beam});
        fields.push_back({"light_sky", "W/m^2", now_.sky});
        fields.push_back({"light_indirect", "W/m^2", now_.indirect});
        fields.push_back({"sky_view", "", sky_view_});
        fields.push_back({"rain_exposure", "", rain_exposure_});
        for (const GroundMeans::Field& field : now_.means->fields())
            fields.push_back({field.name, field.unit, field.values});
        fields.push_back({"soil_water", "mm", {now_.water.begin(), now_.water.end()}});
        fields.push_back({"soil_h", "mm", ground_.depth()});
        fields.push_back({"moss_cover", "", now_.cover});
        for (std::size_t s = 0; s < run_.species.size(); ++s)
            fields.push_back({"suit_" + run_.species[s].name, "", now_.fitness[s]});
        put_sites(scene_, sites_, was_, fields, &ground_.geology(), "moss");
        put_cells(scene_, sites_, fields, p_.cell.value_or(p_.land.site), "moss", progress);
        scene_.points["moss"] =
            moss::to_points(now_.colony, community_, p_.colony, surface_,
                            ground_day_.ground.temperature.empty() ? std::vector<float>()
                                                                   : fitness_of(now_.colony.plants),
                            now_.humidity);
        scene_.points["seeds"] = moss::seeds_to_points(now_.colony);
        scene_.points["statistics"] = statistics_.points("moss");
        scene_.points["weather"] = weather_points(weather_);
        if (!zones_.empty()) scene_.points["zones"] = zones_.points("moss");
        for (const char* name : {"moss", "seeds", "weather"}) scene_.points[name].stage = "moss";
        label(scene_, mesh_moss_fields(), std::size_t(now_.colony.day), p_.climate.profile,
              context_.seed);
    }

    Json summary() const
    {
        const moss::DayStatistics last = moss::count(now_.colony, community_, p_.colony);
        Json summary = now_.means->summary();
        summary["sites"] = sites_.size();
        summary["days"] = weather_.days.size();
        for (std::size_t s = 0; s < run_.species.size(); ++s)
            summary[run_.species[s].name] =
                fmt::format("{} living, {:.3g} m2", last.species[s].living, last.species[s].area);
        summary["largest_balance_error"] = statistics_.largest_balance_error();
        if (lost_ > 1e-6 * emitted_) summary["light_lost_W"] = lost_;
        return summary;
    }

    /// What a checkpoint belongs to, apart from the seed.
    std::string identity() const
    {
        Json all = run_.identity;
        all["mesh"] = hash_hex(encode_mesh(was_, ".ply"));
        all["days"] = weather_.days.size();
        for (moss::Species kind : run_.species)
            all["species " + kind.name] = hash_hex(params_json(describe_params(kind)).dump());
        all["weather"] = content_hash(weather_points(weather_));
        if (!p_.texture.empty()) all["texture"] = file_hash(Stage::resolve(context_, p_.texture));
        if (ground_.has_wind()) all["wind"] = content_hash(scene_.points_of("air_tables"));
        return all.dump();
    }

    moss::ColonyCheckpoint checkpoint(const std::string& recipe) const
    {
        moss::ColonyCheckpoint c{context_.seed, recipe, now_.colony, {}};
        c.fields["water"] = now_.water;
        c.fields["means"] = now_.means->save();
        c.fields["statistics"] = statistics_.save();
        c.fields["zones"] = zones_.save();
        for (const auto& [name, list] : lists()) c.fields[name].assign(list->begin(), list->end());
        return c;
    }

    void restore(const fs::path& file, const std::string& recipe)
    {
        moss::ColonyCheckpoint c = moss::decode_colony(read_file(file, 1ull << 36), file.string(),
                                                       context_.seed, recipe, sites_.size());
        auto field = [&](const std::string& name) -> const std::vector<double>& {
            return c.field(name, file.string());
        };
        auto check = [&](const std::string& name, std::size_t values, std::size_t sites) {
            if (values != sites)
                throw InvalidInput(fmt::format("{}: the field '{}' has {} values for {} sites",
                                               file.string(), name, values, sites));
        };
        const std::size_t kinds = community_.species.size();
        for (const auto* species : {&c.population.plants.species, &c.population.seeds.species})
            for (const std::uint8_t s : *species)
                if (s >= kinds)
                    throw InvalidInput(fmt::format("{}: a moss of species {}, there are {}",
                                                   file.string(), int(s) + 1, kinds));
        check("water", field("water").size(), sites_.size());
        now_.water = field("water");
        now_.means->restore(field("means"));
        statistics_.restore(field("statistics"));
        zones_.restore(field("zones"));
        for (const auto& [name, list] : lists()) {
            const std::vector<double>& kept = field(name);
            check(name, kept.size(), list->size());
            const_cast<std::vector<float>*>(list)->assign(kept.begin(), kept.end());
        }
        now_.colony = std::move(c.population);
        log::info("moss: going on from day {} of {}", now_.colony.day, file.string());
    }

    /// The arrays of floats that go on from day to day, by name.
    std::vector<std::pair<std::string, const std::vector<float>*>> lists() const
    {
        std::vector<std::pair<std::string, const std::vector<float>*>> all{
            {"light", &now_.light},
            {"beam", &now_.beam},
            {"sky", &now_.sky},
            {"indirect", &now_.indirect},
            {"humidity", &now_.humidity}};
        for (std::size_t s = 0; s < now_.fitness.size(); ++s)
            all.emplace_back(fmt::format("fitness_{}", s), &now_.fitness[s]);
        return all;
    }

    /// What goes on from day to day.
    struct State {
        moss::Colony colony;
        std::vector<double> water;
        std::vector<float> light;                ///< S of sites, running mean
        std::vector<float> beam, sky, indirect;  ///< means over all days
        std::vector<float> humidity;             ///< rh_s of the last day
        std::vector<float> cover;
        std::vector<std::vector<float>> fitness;  ///< mean G of sites
        std::optional<GroundMeans> means;
    };

    Scene& scene_;
    const StageContext& context_;
    const MeshMossParams& p_;
    const MossRun& run_;
    const TriMesh was_;
    MeshSites sites_;
    const moss::MeshSurface surface_;
    Weather weather_;
    bool real_weather_ = false, sky_ = false;
    SunMode mode_ = SunMode::Fixed;
    int ema_ = 1;
    moss::Rules rules_;
    moss::Community community_;
    std::vector<float> mask_, sky_view_, rain_exposure_, room_;
    Ground ground_;
    std::unique_ptr<light::PhotonScene> rays_;
    std::unique_ptr<light::SiteKernel> kernel_;
    Statistics statistics_;
    ZoneStatistics zones_;
    State now_;
    GroundDay ground_day_;
    // Of the morning, when plants have an energy balance of their own.
    std::vector<double> water_before_;
    std::vector<float> cover_before_;
    std::vector<std::vector<float>> fitness_today_;
    double lost_ = 0, emitted_ = 0;
};

}  // namespace

std::vector<std::string> mesh_moss_uses()
{
    std::vector<std::string> names{"weather", "surface_sdf", "surf_normal", "surf_area",
                                   "air_tables"};
    for (int k = 0; k < 8; ++k) names.push_back(fmt::format("wind_ratio_{}", k));
    return names;
}

std::vector<std::string> mesh_moss_fields()
{
    return {"light_S",       "light_direct", "light_sky",  "light_indirect", "sky_view",
            "rain_exposure", "soil_theta",   "soil_beta",  "soil_Ts",        "soil_rh",
            "soil_E",        "soil_runoff",  "soil_water", "soil_h",         "moss_cover"};
}

Json moss_on_mesh(Scene& scene, const StageContext& context, const MeshMossParams& params,
                  const MossRun& run)
{
    return MeshMoss(scene, context, params, run).run();
}

}  // namespace sekitei::apps
