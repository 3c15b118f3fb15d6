#include <fmt/format.h>

#include <algorithm>

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
            "the numbers of every day of a soil or moss stage, or of every "
            "generation of trees, as a table",
            OutputKind::Table,
            true,
            {"statistics"},
            {},
            false,
            {"moss"}};
        return kInfo;
    }
    void meets_trees(bool alone) override { trees_ = alone; }
    std::vector<std::string> needs() override
    {
        return trees_ ? std::vector<std::string>{"tree_growth"} : info().needs;
    }
    ParamList params() override { return {}; }
    void validate() override {}
    Need estimate(SceneOutline&, const StageContext&) override { return {0, 1e8, 1e6}; }
    Json run(Scene& scene, const StageContext&) override
    {
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
    bool trees_ = false;
};

struct PlotChoice {
    std::string columns = "cover";
    int width = 1000, height = 560;

    static void describe(auto&& field)
    {
        field("columns", &PlotChoice::columns,
              "columns of the statistics to draw, separated by commas: cover, living, fitness, "
              "temperature, humidity, theta, evaporation ...");
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
                                     "draw columns of the statistics over the days",
                                     OutputKind::Picture,
                                     true,
                                     {"statistics"},
                                     {},
                                     false,
                                     {"moss"}};
        return kInfo;
    }
    ParamList params() override { return describe_params(params_); }
    void validate() override
    {
        validate_described("plot", params_);
        names_ = split_names(params_.columns);
        if (names_.empty()) throw InvalidParameter("plot: columns: none; name at least one");
        std::vector<std::string> known;
        for (const Column& column : Statistics::columns()) known.push_back(column.name);
        for (const std::string& name : names_)
            if (std::find(known.begin(), known.end(), name) == known.end()) {
                const std::string near = nearest_name(name, known);
                throw InvalidParameter(
                    fmt::format("plot: columns: there is no column '{}'{}", name,
                                near.empty() ? "" : fmt::format(", did you mean '{}'?", near)));
            }
        auto unit_of = [](const std::string& name) {
            for (const Column& column : Statistics::columns())
                if (column.name == name) return column.unit;
            return std::string();
        };
        for (const std::string& name : names_)
            if (unit_of(name) != unit_of(names_[0]))
                throw InvalidParameter(fmt::format(
                    "plot: columns: {} is in {}, {} in {}; one plot has one axis, draw two",
                    names_[0], unit_of(names_[0]).empty() ? "no unit" : unit_of(names_[0]), name,
                    unit_of(name).empty() ? "no unit" : unit_of(name)));
    }
    Need estimate(SceneOutline&, const StageContext&) override { return {0, 1e8, 1e6}; }

    Json run(Scene& scene, const StageContext&) override
    {
        const Points& points = scene.points_of("statistics");
        const std::vector<std::string> species = species_names(scene);
        auto column = [&](const std::string& name) -> const std::vector<double>& {
            return statistics_column(points, name, "plot");
        };
        const auto &day = column("day"), &who = column("species");
        std::vector<render::Series> series;
        std::string unit;
        for (const std::string& name : names_) {
            const auto& values = column(name);
            for (const Column& known : Statistics::columns())
                if (known.name == name) unit = known.unit;
            // What does not depend on the species is drawn once.
            const bool each = name == "living" || name == "seeds" || name == "germinated" ||
                              name == "died" || name.starts_with("cover") ||
                              name.starts_with("fitness");
            for (int s = -1; s < int(species.size()); ++s) {
                render::Series line;
                line.name = each && s >= 0
                                ? (names_.size() > 1 ? species[std::size_t(s)] + " " + name
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
        render::PlotParams plot;
        plot.width = params_.width;
        plot.height = params_.height;
        plot.x_name = "day";
        plot.y_name = names_.size() == 1
                          ? (unit.empty() ? names_[0] : fmt::format("{} [{}]", names_[0], unit))
                          : unit;
        picture = render::plot(series, plot);
        return {{"lines", series.size()}};
    }

private:
    PlotChoice params_;
    std::vector<std::string> names_;
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
