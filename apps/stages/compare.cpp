#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "apps/habitat.h"
#include "apps/stages/compare_lines.h"
#include "apps/stages/stages.h"
#include "apps/trees.h"
#include "core/error.h"
#include "core/log.h"

namespace sekitei::apps {
namespace {

constexpr int kWest = 6;

/// Means of one scene's statistics.
struct Habitat {
    std::string name, layout;
    double humidity_north = 0, fitness_shade = 0, fitness_shade_west = 0, fitness_low = 0,
           fitness_low_west = 0, cover = 0;
    std::optional<wind::AirTables> tables;
};

Habitat habitat_of(const std::string& name, const Scene& scene)
{
    Habitat h;
    h.name = name;
    if (const Json* made = params_of(scene, "lantern"))
        h.layout = made->value("layout", std::string());
    const Points& points = scene.points_of("statistics");
    auto column = [&](const char* column_name) -> const std::vector<double>& {
        return statistics_column(points, column_name, "compare: " + name);
    };
    const auto &who = column("species"), &day = column("day"), &from = column("wind_direction");
    if (std::none_of(who.begin(), who.end(), [](double s) { return s >= 0; }))
        throw InvalidInput(fmt::format(
            "compare: {}: the statistics are of bare ground; run `sekitei moss` on it", name));
    std::size_t rows = 0, west = 0;
    double last = 0;
    for (std::size_t r = 0; r < who.size(); ++r) last = std::max(last, day[r]);
    for (std::size_t r = 0; r < who.size(); ++r) {
        ++rows;
        h.humidity_north += column("humidity_north")[r];
        h.fitness_shade += column("fitness_shade")[r];
        h.fitness_low += column("fitness_low")[r];
        if (from[r] == kWest) {
            ++west;
            h.fitness_shade_west += column("fitness_shade")[r];
            h.fitness_low_west += column("fitness_low")[r];
        }
        if (day[r] == last) h.cover += column("cover")[r];
    }
    if (rows == 0) throw InvalidInput(fmt::format("compare: {}: no statistics", name));
    const double n = double(rows), w = std::max<double>(1, double(west));
    h.humidity_north /= n;
    h.fitness_shade /= n;
    h.fitness_low /= n;
    h.fitness_shade_west /= w;
    h.fitness_low_west /= w;
    if (scene.points.contains("air_tables")) h.tables = tables_of(scene);
    return h;
}

/// What grows in the zones of roof2x2 [Nomura2010, section 4.1], from the points `zones`.
class Roof {
public:
    enum Zone { kOther, kFront, kBack, kWall, kUnderside, kTop };

    Roof(const std::string& name, const Scene& scene) : points_(scene.points_of("zones"))
    {
        auto column = [&](const char* which) {
            return &statistics_column(points_, which, "compare: " + name);
        };
        day_ = column("day"), zone_ = column("zone"), living_ = column("living");
        growth_ = column("growth"), light_ = column("light"), deviation_ = column("light_sd");
        theta_ = column("theta_median"), fitness_ = column("fitness");
        for (const double day : *day_) last_ = std::max(last_, day);
    }
    /// The last day that both have, or the one asked for.
    double last() const { return last_; }
    double living(double day, std::initializer_list<Zone> zones) const
    {
        return sum(*living_, day, zones);
    }
    double growth(double day, std::initializer_list<Zone> zones) const
    {
        return sum(*growth_, day, zones);
    }
    /// The largest number on any later day.
    double most_after(double day, std::initializer_list<Zone> zones) const
    {
        double most = 0;
        for (double d = day + 1; d <= last_; ++d) most = std::max(most, living(d, zones));
        return most;
    }
    double fitness(Zone zone) const { return at(*fitness_, last_, zone); }
    double theta(Zone zone) const { return at(*theta_, last_, zone); }
    /// Deviation of S over the zone, as a share of its mean: mean over the days.
    double noise(Zone zone) const
    {
        double total = 0;
        for (double d = 1; d <= last_; ++d)
            total += at(*deviation_, d, zone) / at(*light_, d, zone);
        return total / last_;
    }
    static constexpr std::initializer_list<Zone> kShelter{kBack, kWall, kUnderside};

private:
    double sum(const std::vector<double>& values, double day,
               std::initializer_list<Zone> zones) const
    {
        double total = 0;
        for (std::size_t r = 0; r < values.size(); ++r)
            for (const Zone zone : zones)
                if ((*day_)[r] == day && int((*zone_)[r]) == int(zone)) total += values[r];
        return total;
    }
    double at(const std::vector<double>& values, double day, Zone zone) const
    {
        for (std::size_t r = 0; r < values.size(); ++r)
            if ((*day_)[r] == day && int((*zone_)[r]) == int(zone)) return values[r];
        return 0;
    }

    const Points& points_;
    const std::vector<double>*day_, *zone_, *living_, *growth_, *light_, *deviation_, *theta_,
        *fitness_;
    double last_ = 0;
};

/// What the experiments under a roof let expect; scenes are known by their names, R1 to R7.
std::vector<Line> roof_lines(const std::vector<std::pair<std::string, Scene>>& scenes)
{
    std::map<std::string, Roof> runs;
    for (const auto& [name, scene] : scenes)
        if (scene.points.contains("zones")) runs.try_emplace(name, name, scene);
    std::vector<Line> lines;
    constexpr double kAny = std::numeric_limits<double>::infinity();
    auto run = [&](const std::string& name) -> const Roof* {
        const auto found = runs.find(name);
        return found == runs.end() ? nullptr : &found->second;
    };
    auto line = [&](const std::string& measure, const std::string& scene, double value,
                    double lower, double upper) {
        lines.push_back({measure, scene, value, 0, false, lower, upper});
    };
    auto ratio = [&](const std::string& measure, const std::string& scene, double value,
                     double first, double lower, double upper) {
        lines.push_back({measure, scene, value, first, true, lower, upper});
    };
    const auto shelter = Roof::kShelter;
    const Roof *r1 = run("R1"), *r2 = run("R2"), *r7 = run("R7");
    if (r1) {
        line("living in the shelter, last day", "R1", r1->living(r1->last(), shelter), 100, kAny);
        // One or two may stand in the very edge of the roof's shadow.
        line("living in the open after day 100, for 1000 in the shelter", "R1",
             1000 * r1->most_after(100, {Roof::kFront, Roof::kTop}) /
                 r1->living(r1->last(), shelter),
             0, 1);
    }
    if (r1 && r2)
        ratio("living in the shelter, with / without indirect light", "R1/R2",
              r1->living(r1->last(), shelter), r2->living(r2->last(), shelter), 10, kAny);
    if (const Roof* with = run("R3"), *without = run("R3_direct"); with && without)
        ratio("growth in the shelter without gate, with / without indirect light", "R3",
              with->growth(60, shelter), without->growth(60, shelter), 1.05, kAny);
    for (const std::string kind : {"bryum", "hypnum", "polytrichum"})
        if (const Roof* cool = run("R4_" + kind), *warm = run("R4_" + kind + "_warm");
            cool && warm) {
            ratio("underside, day 100, 288.15 K / 293.15 K", "R4 " + kind,
                  cool->living(100, {Roof::kUnderside}), warm->living(100, {Roof::kUnderside}), 1.1,
                  kAny);
            ratio("mean G of the open floor, 288.15 K / 293.15 K", "R4 " + kind,
                  cool->fitness(Roof::kFront), warm->fitness(Roof::kFront), -kAny, kAny);
        }
    if (const Roof* r5 = run("R5"); r1 && r5) {
        // Later both stand at the cap, which R5 shares with walls that only the sky lights.
        ratio("living in the shelter, day 40, with sky / without", "R5/R1", r5->living(40, shelter),
              r1->living(40, shelter), 1, kAny);
        ratio("living in the shelter, day 100, with sky / without", "R5/R1",
              r5->living(100, shelter), r1->living(100, shelter), -kAny, kAny);
    }
    if (const Roof* dry = run("R6"), *wet = run("R6_wet"); dry && wet) {
        line("water of half the back floor, sheltered", "R6", dry->theta(Roof::kBack), 0, 1e-3);
        line("water of half the front floor", "R6", dry->theta(Roof::kFront), 0.4, 0.49);
        ratio("living on the back floor, day 100, sheltered / rained on", "R6/R6_wet",
              dry->living(100, {Roof::kBack}), wet->living(100, {Roof::kBack}), 0, 0.5);
    }
    if (r1 && r7) {
        ratio("living in the shelter, 8192 / 262144 photons", "R7/R1",
              r7->living(r7->last(), shelter), r1->living(r1->last(), shelter), 1.0 / 3, 3);
        line("noise of S on the front floor, 8192 photons", "R7", r7->noise(Roof::kFront), 0.20,
             0.27);
    }
    return lines;
}

/// Text as a cell of comma-separated values.
std::string cell(const std::string& text)
{
    if (text.find_first_of(",\"\n") == std::string::npos) return text;
    std::string quoted = "\"";
    for (const char c : text) quoted += c == '"' ? std::string("\"\"") : std::string(1, c);
    return quoted + '"';
}

struct CompareParams {
    int figure = 0;
    bool coupling = false;

    static void describe(auto&& field)
    {
        field("figure", &CompareParams::figure, "", between(0, 57),
              "the figure of the paper whose criteria are looked at: of trees 1, 5, 6, 10 to 14 or "
              "16, of forests 48 (4.8), 49, 51 (5.1), 52, 54 to 57; 0: habitats of moss");
        field("coupling", &CompareParams::coupling,
              "how leaves, pond and stones of the first scene, a garden, act on one another: the "
              "others lack one of them");
    }
};

class CompareStage : public Stage {
public:
    const StageInfo& info() const override
    {
        static const StageInfo kInfo{"compare",
                                     "1",
                                     "habitats of several scenes beside the first one's, forms of "
                                     "trees, or forests, with what the papers let expect",
                                     OutputKind::Table,
                                     true,
                                     {"statistics"},
                                     {},
                                     true,
                                     {"lantern", "moss", "tree", "forest.density"}};
        return kInfo;
    }
    std::vector<std::string> needs() override
    {
        if (params_.coupling) return {};
        if (params_.figure == 0) return info().needs;
        if (is_forest_figure(params_.figure))
            return {"forest_trees", "forest_growth", "canopy_height"};
        return {"tree_skeleton", "trees", "canopy_lad"};
    }
    std::vector<std::string> uses() override
    {
        if (params_.coupling)
            return {"air_tables", "water_surface", "canopy_lad", "leaves",     "surf_area",
                    "light_S",    "soil_rh",       "soil_theta", "moss_cover", "tree_growth"};
        if (params_.figure == 0) return {"air_tables", "zones"};
        if (is_forest_figure(params_.figure)) return {};
        return {"tree_growth", "tree_buds"};
    }
    ParamList params() override { return describe_params(params_); }
    void validate() override
    {
        validate_described("compare", params_);
        if (params_.coupling && params_.figure != 0)
            throw InvalidParameter("compare: figure and coupling: give one of the two");
        if (params_.figure != 0 && !is_tree_figure(params_.figure) &&
            !is_forest_figure(params_.figure))
            throw InvalidParameter(
                fmt::format("compare: figure = {}, must be one of {}, or of forests {}",
                            params_.figure, tree_figures(), forest_figures()));
    }
    Need estimate(SceneOutline&, const StageContext&) override { return {0, 1e8, 1e5}; }

    Json run(Scene& scene, const StageContext& context) override
    {
        return run_many({{"", scene}}, context);
    }

    Json run_many(const std::vector<std::pair<std::string, Scene>>& scenes,
                  const StageContext&) override
    {
        const bool forests = is_forest_figure(params_.figure);
        if (scenes.size() < (forests ? 1 : 2))
            throw InvalidParameter("compare: needs two scenes or more");
        std::vector<Line> lines = params_.coupling      ? garden_lines(scenes)
                                  : forests             ? forest_lines(params_.figure, scenes)
                                  : params_.figure != 0 ? tree_lines(params_.figure, scenes)
                                                        : roof_lines(scenes);
        if (params_.figure == 0 && !params_.coupling && lines.empty()) {
            std::vector<Habitat> all;
            for (const auto& [name, scene] : scenes) all.push_back(habitat_of(name, scene));
            for (std::size_t k = 1; k < all.size(); ++k) add(lines, all[0], all[k]);
        }
        table = "measure,scene,value,first,ratio,expected,holds\n";
        int bounded = 0, held = 0;
        for (const Line& line : lines) {
            const std::string verdict = !line.bounded() ? "" : line.holds() ? "holds" : "MISSED";
            bounded += line.bounded();
            held += line.bounded() && line.holds();
            const std::string ratio =
                line.first != 0 ? fmt::format("{:.3f}", line.value / line.first) : "";
            table +=
                fmt::format("{},{},{:.6g},{:.6g},{},{},{}\n", cell(line.measure), cell(line.scene),
                            line.value, line.first, ratio, line.expected(), verdict);
        }
        show_table(table);
        return {{"expectations", bounded}, {"held", held}};
    }

private:
    CompareParams params_;

    static void add(std::vector<Line>& lines, const Habitat& first, const Habitat& other)
    {
        // What the experiments let expect is beside the lantern alone.
        const bool bare = first.layout == "nothing";
        const bool fence = bare && other.layout == "fence", pond = bare && other.layout == "pond",
                   south = bare && other.layout == "south_fence";
        const double none = -std::numeric_limits<double>::infinity(),
                     any = std::numeric_limits<double>::infinity();
        auto line = [&](const std::string& measure, double value, double before, double lower,
                        double upper, bool ratio = true) {
            lines.push_back({measure, other.name, value, before, ratio, lower, upper});
        };
        if (first.tables && other.tables) {
            for (const int k : {0, 2, 4, 6}) {
                double lower = none, upper = any;
                // A fence shelters from the side it stands on, and less from the other side.
                if (fence || south) {
                    const int near = fence ? 0 : 4;
                    if (k == near)
                        upper = 0.45;
                    else if (k == (near + 4) % 8)
                        upper = 0.85;
                    else
                        lower = 0.85, upper = 1.15;
                }
                line(fmt::format("wind before the object {} (A_U)", wind_name(k)),
                     other.tables->speed[std::size_t(k)], first.tables->speed[std::size_t(k)],
                     lower, upper);
            }
            if (pond || first.layout == "pond" || other.layout == "pond" ||
                other.layout == "garden") {
                line("water touched W (A_T)", other.tables->temperature[6],
                     first.tables->temperature[6], pond ? 1.5 : none, pond ? 5 : any, false);
                line("water touched E (A_T)", other.tables->temperature[2],
                     first.tables->temperature[2], pond ? 0 : none, pond ? 0 : any, false);
                line("A_q - A_T, W", other.tables->humidity[6] - other.tables->temperature[6], 0,
                     pond ? -1e-6 : none, pond ? 1e-6 : any, false);
            }
        }
        const bool wetter = fence || pond;
        line("humidity, cells facing north", other.humidity_north, first.humidity_north,
             wetter ? 1 : none, any);
        line("fitness G, S < 80 W/m2", other.fitness_shade, first.fitness_shade,
             fence  ? 1.05
             : pond ? 1.01
                    : none,
             any);
        line("fitness G, S < 80 W/m2, west wind", other.fitness_shade_west,
             first.fitness_shade_west, pond ? 1.04 : none, any);
        const bool layers = other.tables && !other.tables->layers.empty();
        line("fitness G, below 0.5 m", other.fitness_low, first.fitness_low,
             pond && layers ? 1.05 : none, any);
        line("fitness G, below 0.5 m, west wind", other.fitness_low_west, first.fitness_low_west,
             pond && layers ? 1.15 : none, any);
        line("living cover [m2]", other.cover, first.cover, fence ? 1.05 : pond ? 1.01 : none, any);
    }
};

}  // namespace

std::unique_ptr<Stage> make_compare()
{
    return std::make_unique<CompareStage>();
}

}  // namespace sekitei::apps
