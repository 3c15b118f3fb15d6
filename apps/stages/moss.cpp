#include <fmt/format.h>
#include <fmt/ranges.h>

#include <filesystem>

#include "apps/habitat.h"
#include "apps/stages/moss_mesh.h"
#include "apps/stages/stages.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/hash.h"
#include "core/log.h"
#include "core/math.h"
#include "solvers/moss/landing.h"

namespace sekitei::apps {
namespace {

namespace fs = std::filesystem;

constexpr int kCheckpointDays = 30;

/// What carries the moss.
enum class Carrier { Cells, Mesh };
constexpr std::array<std::string_view, 2> choice_names(Carrier)
{
    return {"cells", "mesh"};
}

struct MossParams {
    std::string species = "bryum,hypnum,polytrichum";
    std::optional<std::int64_t> days;
    bool repeat_year = false;
    std::int64_t every = 0;
    std::string checkpoint;
    std::optional<bool> light_gate;
    std::optional<Carrier> surface;
    std::string points;

    static void describe(auto&& field)
    {
        field("surface", &MossParams::surface,
              "what it grows on: cells of a volume or the triangles of a mesh; auto: a mesh where "
              "one is given");
        field("points", &MossParams::points,
              "file for the mosses as points, as `export` writes them; empty: none");
        field("species", &MossParams::species,
              "names of mosses, separated by commas: bryum, hypnum, polytrichum, grimmia, or "
              ".toml files");
        field("days", &MossParams::days, "d", between(1, 1000000),
              "how long they live; auto: as long as the weather");
        field("repeat_year", &MossParams::repeat_year,
              "begin the weather anew when it is shorter than days");
        field("every", &MossParams::every, "d", kNotNegative,
              "also write a scene every so many days, numbered by day beside the last one; 0: only "
              "the last");
        field("light_gate", &MossParams::light_gate,
              "nothing grows in the dark; auto: unless the soil stage has profile = paper");
        field("checkpoint", &MossParams::checkpoint,
              "file to go on from after an interruption, and to write every 30 days; empty: none "
              "(recipes keep their own)");
    }
};

class MossStage : public Stage {
public:
    const StageInfo& info() const override
    {
        static const StageInfo kInfo = [] {
            StageInfo info{
                "moss",
                "1",
                "mosses germinate, grow, spread and die where the climate suits them",
                OutputKind::Scene,
                true,
                climate_needs(),
                {"geology",    "soil_h",       "soil_water",  "soil_theta",      "soil_beta",
                 "soil_Ts",    "soil_rh",      "soil_E",      "soil_runoff",     "statistics",
                 "moss",       "moss_species", "moss_growth", "moss_growth_max", "moss_age",
                 "moss_cover", "moss_id",      "seed_kind",   "seed_species",    "seed_age",
                 "seed_id"},
                false,
                {"light", "soil"}};
            info.needs.push_back("light_S");
            info.reads_mesh = true;
            return info;
        }();
        return kInfo;
    }
    void meets_mesh(bool there) override { mesh_given_ = there; }
    std::vector<std::string> needs() override
    {
        return on_mesh() ? std::vector<std::string>{"rock"} : info().needs;
    }
    std::vector<std::string> uses() override
    {
        if (on_mesh()) return mesh_moss_uses();
        std::vector<std::string> names = climate_uses();
        names.push_back("soil_water");
        return names;
    }
    std::vector<std::string> makes() override
    {
        std::vector<std::string> names = info().makes;
        if (on_mesh()) {
            names = mesh_moss_fields();
            for (const std::string& item : site_items()) names.push_back(item);
            for (const char* item : {"moss", "seeds", "statistics", "weather", "zones"})
                names.emplace_back(item);
        }
        for (const std::string& name : split_names(params_.species))
            names.push_back("suit_" + (fs::path(name).extension() == ".toml"
                                           ? fs::path(name).stem().string()
                                           : name));
        return names;
    }
    std::vector<fs::path> side_files() override
    {
        return params_.points.empty() ? std::vector<fs::path>()
                                      : std::vector<fs::path>{params_.points};
    }
    std::vector<fs::path> files() override
    {
        std::vector<fs::path> list;
        for (const std::string& name : split_names(params_.species))
            if (fs::path(name).extension() == ".toml") list.emplace_back(name);
        return list;
    }
    ParamList params() override
    {
        ParamList list = describe_params(params_);
        for (Param& p : describe_params(rules_))
            if (p.name != "light_gate") list.push_back(std::move(p));
        for (Param& p : describe_params(propagation_)) list.push_back(std::move(p));
        for (Param& p : describe(mesh_)) list.push_back(std::move(p));
        return list;
    }
    void validate() override
    {
        validate_described("moss", params_);
        moss::validate(rules_);
        moss::validate(propagation_);
        moss::validate(mesh_.colony);
        light::validate(mesh_.photons);
        apps::validate(mesh_.climate);
        validate_described("moss", mesh_);
        validate_described("moss", mesh_.land);
        validate_described("moss", mesh_.steady);
        validate_described("moss", mesh_.weather);
        validate_described("moss", mesh_.geology);
        if (!propagation_.spore_wind) warn_unused(*this, {"settling_speed"}, "without spore_wind");
        if (params_.light_gate && !*params_.light_gate)
            warn_unused(*this, {"light_compensation"}, "without light_gate");
        if (!params_.days) warn_unused(*this, {"repeat_year"}, "without days");
        const std::vector<std::string> names = split_names(params_.species);
        if (names.empty()) throw InvalidParameter("moss: species: none; name at least one");
        for (const std::string& name : names)
            if (fs::path(name).extension() != ".toml") find_species(name, {});
    }

    void check_files(const StageContext& context) override
    {
        for (const std::string& name : split_names(params_.species))
            if (fs::path(name).extension() == ".toml") find_species(name, context.folder);
        if (!on_mesh()) return;
        find_soil(mesh_.climate.soil, context.folder);
        if (!mesh_.weather.weather.empty())
            chosen_weather(mesh_.weather, params_.days, params_.repeat_year, "moss",
                           context.folder);
    }

    Need estimate(SceneOutline& outline, const StageContext&) override
    {
        if (on_mesh())
            return {outline.surface_cells,
                    mesh_memory(outline.surface_cells, mesh_.photons, mesh_.colony.cap),
                    outline.surface_cells * 150};
        return {outline.surface_cells, memory(outline.surface_cells), outline.surface_cells * 90};
    }

    Json run(Scene& scene, const StageContext& context) override
    {
        std::vector<moss::Species> species;
        for (const std::string& name : split_names(params_.species))
            species.push_back(find_species(name, context.folder));
        std::erase_if(scene.grids, [](const auto& grid) {  // of species that are here no more
            return grid.first.starts_with("suit_") && grid.second.stage == "moss";
        });
        if (!params_.checkpoint.empty()) check_target(resolve(context, params_.checkpoint));
        if (on_mesh()) return run_on_mesh(scene, context, species);
        std::vector<std::string> of_meshes;
        for (const Param& p : describe(mesh_)) of_meshes.push_back(p.name);
        warn_unused(*this, of_meshes, "on cells");
        ClimateParams ground;
        if (const Json* made = params_of(scene, "soil"))
            for (const Param& p : describe(ground))
                if (made->contains(p.name)) p.set((*made)[p.name]);
        rules_.light_gate = params_.light_gate.value_or(ground.profile == Profile::Full);
        const moss::Community community{species, rules_, propagation_, context.seed};
        moss::validate(community);

        Climate climate(scene, ground, context.folder, context.progress.slice(0, 0.1));
        const SurfaceCells& cells = climate.cells();
        const std::size_t n = cells.size(), there = climate.weather().days.size();
        check_memory("moss", memory(double(n)), context.memory_limit);
        const std::size_t days = params_.days ? std::size_t(*params_.days) : there;
        if (days > there && !params_.repeat_year)
            throw InvalidParameter(fmt::format(
                "moss: days = {}, but the scene's weather has {}; use --repeat-year to begin it "
                "anew, or give the light stage more days",
                days, there));
        if (days > there) climate.repeat(days);

        const FloatGrid& level_set = scene.floats("surface_sdf");
        const moss::Surface surface = moss::surface_of(cells);
        const moss::CellLanding landing(level_set, cells);
        State now{moss::first_settlers(community, surface),
                  climate.ground().initial_water(),
                  GroundMeans(climate.ground()),
                  Statistics(int(species.size())),
                  std::vector<std::vector<float>>(species.size(), std::vector<float>(n)),
                  std::vector<float>(n)};
        if (scene.has("soil_water")) {
            const std::vector<float> water = cells.from_grid(scene.floats("soil_water"), 0);
            now.water.assign(water.begin(), water.end());
        }
        const double floor = scene.domain.dims.z > 0 ? scene.domain.transform.origin.z : 0;
        now.statistics.choose(cells, cells.from_grid(scene.floats("light_S"), 0), floor);
        const fs::path file =
            params_.checkpoint.empty() ? context.checkpoint : resolve(context, params_.checkpoint);
        const std::string recipe = file.empty() ? "" : identity(scene, climate, species, days);
        if (!file.empty() && fs::exists(file)) restore(now, file, recipe, n, context);

        ClimateDay day;
        std::vector<std::vector<float>> fitness(species.size(), std::vector<float>(n));
        const Progress progress = context.progress.slice(0.1, 1);
        for (auto d = static_cast<std::size_t>(now.population.day); d < days; ++d) {
            climate.advance(d, now.water, now.population.cover, day, progress.slice(1, 1));
            for (std::size_t s = 0; s < species.size(); ++s) {
                moss::fitness(species[s], rules_, day.ground.temperature, day.ground.humidity,
                              day.light.total, fitness[s], progress.slice(1, 1));
                add_to_mean(now.fitness[s], d + 1, [&, s](std::size_t i) { return fitness[s][i]; });
            }
            const double from = day.weather.wind_direction * math::kPi / 4;
            const moss::DayStatistics mosses = moss::day(
                now.population, community, surface, landing,
                {fitness, day.wind, {-math::sin(from), -math::cos(from), 0}}, progress.slice(1, 1));
            now.means.add(day, now.water);
            now.statistics.add(int(d) + 1, climate.ground(), day, day.light.total, now.water,
                               {&mosses, now.population.species, fitness});
            now.humidity.swap(day.ground.humidity);
            const int done = int(d) + 1;
            if (params_.every > 0 && context.frame &&
                (done % params_.every == 0 || done == int(days))) {
                put(scene, climate, community, surface, level_set, now);
                label(scene, makes(), std::size_t(done), ground.profile, context.seed);
                context.frame(done, scene);
            }
            if (!file.empty() && done % kCheckpointDays == 0 && done < int(days))
                write_file(file, moss::encode(checkpoint(now, recipe, context.seed)));
            progress.update(double(done) / double(days));
        }
        put(scene, climate, community, surface, level_set, now);
        label(scene, makes(), days, ground.profile, context.seed);
        if (!file.empty() && params_.checkpoint.empty()) {
            std::error_code ignored;
            fs::remove(file, ignored);  // the result itself is kept now
        }

        const moss::DayStatistics last = moss::count(now.population, community, surface);
        double area = 0;
        for (const float a : cells.area) area += double(a);
        Json summary = now.means.summary();
        summary["cells"] = n;
        summary["days"] = days;
        for (std::size_t s = 0; s < species.size(); ++s)
            summary[species[s].name] =
                fmt::format("{} living, {:.3g} of the surface", last.species[s].living,
                            last.species[s].area / area);
        summary["largest_balance_error"] = now.statistics.largest_balance_error();
        if (!climate.ground().has_wind()) summary["wind"] = "as in the weather: no wind stage ran";
        write_points(scene, context);
        return summary;
    }

private:
    bool on_mesh() const
    {
        return params_.surface ? *params_.surface == Carrier::Mesh : mesh_given_;
    }

    Json run_on_mesh(Scene& scene, const StageContext& context, std::vector<moss::Species> species)
    {
        Json identity = params_json(params());
        for (const char* free :
             {"checkpoint", "every", "species", "points", "weather", "texture", "cell", "days"})
            identity.erase(free);
        const Json summary = moss_on_mesh(
            scene, context, mesh_,
            {std::move(species), rules_, propagation_, params_.days, params_.repeat_year,
             params_.every, params_.checkpoint, params_.light_gate, identity});
        write_points(scene, context);
        return summary;
    }

    void write_points(const Scene& scene, const StageContext& context) const
    {
        if (!params_.points.empty())
            write_file(resolve(context, params_.points), encode_points(scene.points.at("moss")));
    }

    /// What goes on from day to day.
    struct State {
        moss::Population population;
        std::vector<double> water;
        GroundMeans means;
        Statistics statistics;
        std::vector<std::vector<float>> fitness;  ///< mean G
        std::vector<float> humidity;              ///< rh_s of the last day
    };

    /// What a checkpoint belongs to, apart from the seed: JSON with a name for each part, so that a
    /// refusal tells which differ.
    std::string identity(const Scene& scene, const Climate& climate,
                         const std::vector<moss::Species>& species, std::size_t days)
    {
        Json all = params_json(params());
        for (const char* free : {"checkpoint", "every", "species", "points"}) all.erase(free);
        all["days"] = days;
        all["light_gate"] = rules_.light_gate;
        for (moss::Species kind : species)
            all["species " + kind.name] = hash_hex(params_json(describe_params(kind)).dump());
        if (const Json* soil = params_of(scene, "soil")) all["soil"] = hash_hex(soil->dump());
        std::string soils;
        for (soil::Soil kind : climate.ground().soils())
            soils += params_json(describe_params(kind)).dump();
        all["soils"] = hash_hex(soils);
        std::string wind;
        for (int k = 0; k < 8 && climate.ground().has_wind(); ++k)
            wind += content_hash(scene.grids.at(fmt::format("wind_ratio_{}", k)));
        if (climate.ground().has_wind()) wind += content_hash(scene.points_of("air_tables"));
        all["wind"] = hash_hex(wind);
        for (const char* name : {"surface_sdf", "surf_normal", "surf_area", "sky_view",
                                 "rain_exposure", "light_S", "geology", "soil_h", "soil_water"})
            if (scene.has(name)) all[name] = content_hash(scene.grids.at(name));
        for (const char* name : {"daylight", "weather"})
            all[name] = content_hash(scene.points_of(name));
        return all.dump();
    }

    static moss::Checkpoint checkpoint(const State& now, const std::string& recipe,
                                       std::uint64_t seed)
    {
        moss::Checkpoint c{seed, recipe, now.population, {}};
        c.fields["water"] = now.water;
        c.fields["means"] = now.means.save();
        c.fields["statistics"] = now.statistics.save();
        c.fields["humidity"].assign(now.humidity.begin(), now.humidity.end());
        for (std::size_t s = 0; s < now.fitness.size(); ++s)
            c.fields[fmt::format("fitness_{}", s)].assign(now.fitness[s].begin(),
                                                          now.fitness[s].end());
        return c;
    }

    static void restore(State& now, const fs::path& file, const std::string& recipe,
                        std::size_t cells, const StageContext& context)
    {
        moss::Checkpoint c =
            moss::decode(read_file(file, 1ull << 36), file.string(), context.seed, recipe, cells);
        auto field = [&](const std::string& name) -> const std::vector<double>& {
            return c.field(name, file.string());
        };
        auto of_cells = [&](const std::string& name) -> const std::vector<double>& {
            const std::vector<double>& values = field(name);
            if (values.size() != cells)
                throw InvalidInput(fmt::format("{}: the field '{}' has {} values for {} cells",
                                               file.string(), name, values.size(), cells));
            return values;
        };
        for (const auto* species : {&c.population.species, &c.population.seed_species})
            for (const std::uint8_t s : *species)
                if (s > now.fitness.size())
                    throw InvalidInput(fmt::format("{}: a moss of species {}, there are {}",
                                                   file.string(), int(s), now.fitness.size()));
        now.population = std::move(c.population);
        now.water = of_cells("water");
        now.means.restore(field("means"));
        now.statistics.restore(field("statistics"));
        now.humidity.assign(of_cells("humidity").begin(), of_cells("humidity").end());
        for (std::size_t s = 0; s < now.fitness.size(); ++s) {
            const std::vector<double>& mean = of_cells(fmt::format("fitness_{}", s));
            now.fitness[s].assign(mean.begin(), mean.end());
        }
        log::info("moss: going on from day {} of {}", now.population.day, file.string());
    }

    void put(Scene& scene, const Climate& climate, const moss::Community& community,
             const moss::Surface& surface, const FloatGrid& level_set, const State& now)
    {
        const SurfaceCells& cells = climate.cells();
        now.means.put(scene, cells, "moss");
        put_water(scene, climate, now.water, "moss");
        scene.put("moss_species", cells.to_grid(moss::moss_species(now.population)), "moss");
        scene.put("moss_growth", cells.to_grid(now.population.growth), "", "moss");
        scene.put("moss_growth_max", cells.to_grid(now.population.growth_max), "", "moss");
        scene.put("moss_age", cells.to_grid(moss::moss_age(now.population)), "moss");
        scene.put("moss_cover", cells.to_grid(now.population.cover), "", "moss");
        scene.put("seed_kind", cells.to_grid(moss::seed_kind(now.population)), "moss");
        scene.put("seed_species", cells.to_grid(moss::seed_species(now.population)), "moss");
        scene.put("seed_age", cells.to_grid(moss::seed_age(now.population)), "moss");
        scene.put("moss_id", cells.to_grid(numbers(now.population.id)), "moss");
        scene.put("seed_id", cells.to_grid(numbers(now.population.seed_id)), "moss");
        Json kinds = Json::array();
        for (moss::Species kind : community.species)
            kinds.push_back(params_json(describe_params(kind)));
        scene.grids.at("moss_species").extra["species"] = kinds.dump();
        for (std::size_t s = 0; s < community.species.size(); ++s)
            scene.put("suit_" + community.species[s].name, cells.to_grid(now.fitness[s]), "",
                      "moss");
        scene.points["moss"] =
            moss::to_points(now.population, community, surface, &level_set, now.humidity);
        scene.points["moss"].stage = "moss";
        scene.points["statistics"] = now.statistics.points("moss");
    }

    /// Ids as a grid holds them. Two thousand million plants are more than any run sees.
    static std::vector<std::int32_t> numbers(const std::vector<std::uint64_t>& ids)
    {
        return {ids.begin(), ids.end()};
    }

    static double memory(double cells) { return 2e8 + cells * 900; }

    MossParams params_;
    moss::Rules rules_;
    moss::Propagation propagation_;
    MeshMossParams mesh_;
    bool mesh_given_ = false;
};

}  // namespace

std::unique_ptr<Stage> make_moss()
{
    return std::make_unique<MossStage>();
}

}  // namespace sekitei::apps
