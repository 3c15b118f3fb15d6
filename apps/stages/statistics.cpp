#include <fmt/format.h>

#include <algorithm>
#include <functional>
#include <map>
#include <utility>

#include "apps/forest.h"
#include "apps/habitat.h"
#include "apps/render/plot.h"
#include "apps/stages/stages.h"
#include "apps/trees.h"
#include "core/error.h"

namespace sekitei::apps {
namespace {

class StatisticsStage : public Stage {
public:
    const StageInfo& info() const override
    {
        static const StageInfo kInfo{
            "statistics",
            "1",
            "the numbers of every day of a soil or moss stage, of every generation of trees or "
            "of every step of a forest, as a table",
            OutputKind::Table,
            true,
            {"statistics"},
            {},
            false,
            {"moss"}};
        return kInfo;
    }
    void meets_trees(bool alone) override { trees_ = alone; }
    void meets_forest(bool alone) override { forest_ = alone; }
    std::vector<std::string> needs() override
    {
        if (forest_) return {"forest_growth", "canopy_height"};
        return trees_ ? std::vector<std::string>{"tree_growth"} : info().needs;
    }
    ParamList params() override { return {}; }
    void validate() override {}
    Need estimate(SceneOutline&, const StageContext&) override { return {0, 1e8, 1e6}; }
    Json run(Scene& scene, const StageContext&) override
    {
        if (forest_) {
            const std::vector<forest::StepStatistics> rows = forest_growth_of(scene);
            table = forest_growth_csv(rows, forest_record(scene).species);
            return {{"rows", rows.size()}};
        }
        if (trees_) {
            const std::vector<tree::GenerationStatistics> rows = growth_of(scene);
            table = growth_csv(rows);
            return {{"rows", rows.size()}};
        }
        const Points& points = scene.points_of("statistics");
        table = statistics_csv(points, species_names(scene));
        return {{"rows", points.position.size()}};
    }

private:
    bool trees_ = false, forest_ = false;
};

/// What a plot has along its x axis.
enum class Over { Time, Density };
constexpr std::array<std::string_view, 2> choice_names(Over)
{
    return {"time", "density"};
}

/// Columns of a forest's statistics by name: those of its table, and sums over species or classes.
class ForestColumns {
public:
    using Row = forest::StepStatistics;
    using Value = std::function<double(const Row&)>;

    explicit ForestColumns(const std::vector<forest::Species>& species)
    {
        add("trees", [](const Row& r) { return double(r.trees); });
        add("births", [](const Row& r) { return double(r.births); });
        add("lost", [](const Row& r) { return double(r.lost); });
        add("deaths", [](const Row& r) {
            double sum = 0;
            for (const std::uint64_t n : r.deaths) sum += double(n);
            return sum;
        });
        for (std::size_t c = 0; c < forest::kCauses; ++c)
            add(std::string(choice_names(forest::Cause{})[c]),
                [c](const Row& r) { return double(r.deaths[c]); });
        add("mean_share", [](const Row& r) { return r.mean_share; });
        for (int k = 0; k < Row::kClasses; ++k)
            add(kForestClasses[std::size_t(k)],
                [k](const Row& r) { return double(r.of_class(k)); });
        for (std::size_t s = 0; s < species.size(); ++s) {
            add(species[s].name, [s](const Row& r) {
                double sum = 0;
                for (const std::uint64_t n : r.counts[s]) sum += double(n);
                return sum;
            });
            for (std::size_t k = 0; k < std::size_t(Row::kClasses); ++k)
                add(species[s].name + "_" + kForestClasses[k],
                    [s, k](const Row& r) { return double(r.counts[s][k]); });
        }
    }

    /// @throws InvalidParameter  the nearest name
    const Value& of(const std::string& name) const
    {
        const auto found = std::find(names_.begin(), names_.end(), name);
        if (found != names_.end()) return values_[std::size_t(found - names_.begin())];
        const std::string near = nearest_name(name, names_);
        throw InvalidParameter(
            fmt::format("plot: columns: a forest has no column '{}'{}", name,
                        near.empty() ? "" : fmt::format(", did you mean '{}'?", near)));
    }

private:
    void add(std::string name, Value value)
    {
        names_.push_back(std::move(name));
        values_.push_back(std::move(value));
    }
    std::vector<std::string> names_;
    std::vector<Value> values_;
};

struct PlotChoice {
    std::string columns;
    Over over = Over::Time;
    int width = 1000, height = 560;

    static void describe(auto&& field)
    {
        field("columns", &PlotChoice::columns,
              "columns of the statistics to draw, separated by commas: cover, living, fitness, "
              "temperature, humidity, theta, evaporation ...; of forests trees, births, deaths, "
              "to_3m, to_8m, to_12m, above, names of species ...; empty: cover, or trees");
        field("over", &PlotChoice::over,
              "days or steps; or, of several forests, the density they grew with: their last rows, "
              "means "
              "where it is the same");
        field("width", &PlotChoice::width, "", between(300, 16384), "picture width in pixels");
        field("height", &PlotChoice::height, "", between(200, 16384), "picture height in pixels");
    }
};

class PlotStage : public Stage {
public:
    const StageInfo& info() const override
    {
        static const StageInfo kInfo{"plot",
                                     "1",
                                     "draw columns of the statistics over days or steps, or of "
                                     "several forests over their density",
                                     OutputKind::Picture,
                                     true,
                                     {"statistics"},
                                     {},
                                     true,
                                     {"moss", "forest.density"}};
        return kInfo;
    }
    void meets_forest(bool alone) override { forest_ = alone; }
    std::vector<std::string> needs() override
    {
        if (forest_) return {"forest_growth", "canopy_height"};
        return info().needs;
    }
    ParamList params() override { return describe_params(params_); }
    void validate() override
    {
        validate_described("plot", params_);
        names_ = split_names(params_.columns);
        if (names_.empty() && !params_.columns.empty())
            throw InvalidParameter("plot: columns: none; name at least one");
    }
    void check_reading() override
    {
        if (forest_) return;  // its species are in the scene
        if (params_.over == Over::Density)
            throw InvalidParameter("plot: over = density, which only forests have");
        std::vector<std::string> known;
        for (const Column& column : Statistics::columns()) known.push_back(column.name);
        for (const std::string& name : names())
            if (std::find(known.begin(), known.end(), name) == known.end()) {
                const std::string near = nearest_name(name, known);
                throw InvalidParameter(
                    fmt::format("plot: columns: there is no column '{}'{}", name,
                                near.empty() ? "" : fmt::format(", did you mean '{}'?", near)));
            }
        const std::string first = names().front();
        for (const std::string& name : names())
            if (unit_of(name) != unit_of(first))
                throw InvalidParameter(fmt::format(
                    "plot: columns: {} is in {}, {} in {}; one plot has one axis, draw two", first,
                    unit_of(first).empty() ? "no unit" : unit_of(first), name,
                    unit_of(name).empty() ? "no unit" : unit_of(name)));
    }
    Need estimate(SceneOutline&, const StageContext&) override { return {0, 1e8, 1e6}; }

    Json run(Scene& scene, const StageContext& context) override
    {
        return run_many({{"", scene}}, context);
    }

    Json run_many(const std::vector<std::pair<std::string, Scene>>& scenes,
                  const StageContext&) override
    {
        if (scenes.empty()) throw InvalidParameter("plot: needs a scene with statistics");
        std::vector<render::Series> series;
        for (const auto& [name, scene] : scenes) {
            const std::size_t before = series.size();
            try {
                if (forest_ && params_.over == Over::Density)
                    add_density(series, scene);
                else if (forest_)
                    add_steps(series, scene);
                else
                    add_days(series, scene);
            } catch (const InvalidInput& error) {
                throw named_after(name, error);
            }
            if (scenes.size() > 1 && params_.over == Over::Time)
                for (std::size_t k = before; k < series.size(); ++k)
                    series[k].name = name + (names().size() > 1 ? " " + series[k].name : "");
        }
        if (params_.over == Over::Density)
            for (render::Series& line : series) join_equal_x(line);
        render::PlotParams plot;
        plot.width = params_.width;
        plot.height = params_.height;
        plot.x_name = params_.over == Over::Density ? "density" : forest_ ? "step" : "day";
        const std::string unit = forest_ ? "" : unit_of(names()[0]);
        plot.y_name = names().size() == 1
                          ? (unit.empty() ? names()[0] : fmt::format("{} [{}]", names()[0], unit))
                      : forest_ ? "trees"
                                : unit;
        plot.from_zero = forest_;
        picture = render::plot(series, plot);
        return {{"lines", series.size()}};
    }

private:
    std::vector<std::string> names() const
    {
        return names_.empty() ? std::vector<std::string>{forest_ ? "trees" : "cover"} : names_;
    }
    static std::string unit_of(const std::string& name)
    {
        for (const Column& column : Statistics::columns())
            if (column.name == name) return column.unit;
        return "";
    }

    void add_days(std::vector<render::Series>& series, const Scene& scene) const
    {
        const Points& points = scene.points_of("statistics");
        const std::vector<std::string> species = species_names(scene);
        auto column = [&](const std::string& name) -> const std::vector<double>& {
            return statistics_column(points, name, "plot");
        };
        const auto &day = column("day"), &who = column("species");
        for (const std::string& name : names()) {
            const auto& values = column(name);
            // What does not depend on the species is drawn once.
            const bool each = name == "living" || name == "seeds" || name == "germinated" ||
                              name == "died" || name.starts_with("cover") ||
                              name.starts_with("fitness");
            for (int s = -1; s < int(species.size()); ++s) {
                render::Series line;
                line.name = each && s >= 0
                                ? (names().size() > 1 ? species[std::size_t(s)] + " " + name
                                                      : species[std::size_t(s)])
                                : name;
                for (std::size_t r = 0; r < day.size(); ++r)
                    if (who[r] == s) {
                        line.x.push_back(day[r]);
                        line.y.push_back(values[r]);
                    }
                if (line.x.empty()) continue;
                series.push_back(std::move(line));
                if (!each) break;
            }
        }
    }

    void add_steps(std::vector<render::Series>& series, const Scene& scene) const
    {
        const std::vector<forest::StepStatistics> rows = forest_growth_of(scene);
        const ForestColumns columns(forest_record(scene).species);
        for (const std::string& name : names()) {
            render::Series line;
            line.name = name;
            for (const forest::StepStatistics& row : rows) {
                line.x.push_back(row.step);
                line.y.push_back(columns.of(name)(row));
            }
            series.push_back(std::move(line));
        }
    }

    /// One point of each line.
    void add_density(std::vector<render::Series>& series, const Scene& scene) const
    {
        if (series.empty())
            for (const std::string& name : names()) series.push_back({name, {}, {}});
        const std::vector<forest::StepStatistics> rows = forest_growth_of(scene);
        if (rows.empty()) throw InvalidInput("its forest has not grown a step");
        const ForestColumns columns(forest_record(scene).species);
        const double density = forest_density(scene);
        for (std::size_t k = 0; k < names().size(); ++k) {
            series[k].x.push_back(density);
            series[k].y.push_back(columns.of(names()[k])(rows.back()));
        }
    }

    /// Orders the points; of those with equal x remains the mean.
    static void join_equal_x(render::Series& line)
    {
        std::map<double, std::pair<double, double>> sums;  // and counts
        for (std::size_t i = 0; i < line.x.size(); ++i) {
            sums[line.x[i]].first += line.y[i];
            sums[line.x[i]].second += 1;
        }
        line.x.clear();
        line.y.clear();
        for (const auto& [x, sum] : sums) {
            line.x.push_back(x);
            line.y.push_back(sum.first / sum.second);
        }
    }

    PlotChoice params_;
    std::vector<std::string> names_;
    bool forest_ = false;
};

}  // namespace

std::unique_ptr<Stage> make_statistics()
{
    return std::make_unique<StatisticsStage>();
}

std::unique_ptr<Stage> make_plot()
{
    return std::make_unique<PlotStage>();
}

}  // namespace sekitei::apps
