#include "apps/habitat.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>

#include "apps/presets.h"
#include "core/error.h"
#include "core/parallel.h"

namespace sekitei::apps {
namespace {

constexpr float kShade = 80;        // W/m^2
constexpr double kLowHeight = 0.5;  // m
constexpr float kNorth = 0.5f;      // of the normal's y

/// Columns of a row, in this order.
enum {
    kDay,
    kSpecies,
    kDirection,
    kLiving,
    kSeeds,
    kGerminated,
    kDied,
    kCover,
    kFitness,
    kFitnessShade,
    kFitnessLow,
    kCoverLow,
    kLight,
    kTemperature,
    kHumidity,
    kHumidityNorth,
    kTheta,
    kEvaporation,
    kPrecipitation,
    kRunoff,
    kBalance,
    kColumns
};

/// What a cell counts as.
enum : std::uint8_t { kIsShade = 1, kIsNorth = 2, kIsLow = 4 };

/// Sums that belong to one pass over the cells, in a fixed order.
template <std::size_t N, class F>
std::array<double, N> sums_over(std::size_t count, F&& add)
{
    return parallel_fold(
        count, 1024, std::array<double, N>{},
        [&](std::size_t begin, std::size_t end) {
            std::array<double, N> sum{};
            for (std::size_t i = begin; i != end; ++i) add(i, sum);
            return sum;
        },
        [](std::array<double, N> a, const std::array<double, N>& b) {
            for (std::size_t k = 0; k < N; ++k) a[k] += b[k];
            return a;
        });
}

double share_of(double sum, double area)
{
    return area > 0 ? sum / area : 0;
}

}  // namespace

GroundMeans::GroundMeans(const Ground& ground) : ground_(&ground)
{
    for (auto& mean : mean_) mean.assign(ground.size(), 0);
}

void GroundMeans::add(const GroundDay& day, const std::vector<double>& water)
{
    const auto& depth = ground_->depth();
    const double share = 1 / static_cast<double>(++days_);
    parallel_for(
        depth.size(),
        [&](std::size_t i) {
            auto add = [&](int k, double value) {
                float& mean = mean_[std::size_t(k)][i];
                mean = static_cast<float>(double(mean) + (value - double(mean)) * share);
            };
            add(kTheta, water[i] / double(depth[i]));
            add(kBeta, double(day.ground.beta[i]));
            add(kTemperature, double(day.ground.temperature[i]));
            add(kHumidity, double(day.ground.humidity[i]));
            add(kEvaporation, day.ground.evaporation[i]);
            add(kRunoff, std::max(day.ground.runoff[i], day.rain.run[i]));
        },
        4096);
}

std::vector<GroundMeans::Field> GroundMeans::fields() const
{
    return {{"soil_theta", "", mean_[kTheta]},         {"soil_beta", "", mean_[kBeta]},
            {"soil_Ts", "K", mean_[kTemperature]},     {"soil_rh", "", mean_[kHumidity]},
            {"soil_E", "mm/day", mean_[kEvaporation]}, {"soil_runoff", "mm/day", mean_[kRunoff]}};
}

void GroundMeans::put(Scene& scene, const SurfaceCells& cells, const std::string& stage) const
{
    for (const Field& field : fields())
        scene.put(field.name, cells.to_grid(field.values), field.unit, stage);
}

Json GroundMeans::summary() const
{
    const std::span<const float> area = ground_->site_area();
    auto mean = [&](int k) {
        return parallel_sum(area.size(),
                            [&](std::size_t i) {
                                return double(area[i]) * double(mean_[std::size_t(k)][i]);
                            }) /
               ground_->area();
    };
    return {{"mean_temperature", mean(kTemperature)},
            {"mean_humidity", mean(kHumidity)},
            {"mean_theta", mean(kTheta)},
            {"mean_evaporation", mean(kEvaporation)}};
}

std::vector<double> GroundMeans::save() const
{
    std::vector<double> all{double(days_)};
    for (const auto& mean : mean_) all.insert(all.end(), mean.begin(), mean.end());
    return all;
}

void GroundMeans::restore(const std::vector<double>& saved)
{
    const std::size_t n = mean_[0].size();
    if (saved.size() != 1 + kCount * n)
        throw InvalidInput("checkpoint: the means are of another number of cells");
    days_ = static_cast<std::size_t>(saved[0]);
    for (std::size_t k = 0; k < kCount; ++k)
        for (std::size_t i = 0; i < n; ++i) mean_[k][i] = static_cast<float>(saved[1 + k * n + i]);
}

void put_water(Scene& scene, const Climate& climate, const std::vector<double>& water,
               const std::string& stage)
{
    const SurfaceCells& cells = climate.cells();
    scene.put("soil_water", cells.to_grid(std::vector<float>(water.begin(), water.end())), "mm",
              stage);
    scene.put("soil_h", cells.to_grid(climate.ground().depth()), "mm", stage);
    scene.put("geology", cells.to_grid(climate.ground().geology()), stage);
    soil::Soil own = climate.ground().soils().back();
    scene.grids.at("geology").extra["soil"] = params_json(describe_params(own)).dump();
}

void label(Scene& scene, const std::vector<std::string>& names, std::size_t day, Profile profile,
           std::uint64_t seed)
{
    for (const std::string& name : names)
        if (const auto grid = scene.grids.find(name); grid != scene.grids.end())
            grid->second.extra.update(
                {{"day", day},
                 {"profile", std::string(choice_names(profile)[static_cast<std::size_t>(profile)])},
                 {"seed", seed}});
}

const std::vector<Column>& Statistics::columns()
{
    static const std::vector<Column> list = {
        {"day", "", "1 on the first"},
        {"species", "", "number in the moss stage's list, from 0; -1: the ground alone"},
        {"wind_direction", "", "0 to 7 = N NE E SE S SW W NW, where it blows from"},
        {"living", "", "mosses"},
        {"seeds", "", "resting seeds"},
        {"germinated", "", "that day"},
        {"died", "", "that day, displaced ones among them"},
        {"cover", "m^2", "area of cells with this moss"},
        {"fitness", "", "mean G of the surface"},
        {"fitness_shade", "", "mean G of shady cells"},
        {"fitness_low", "", "mean G of shady cells below 0.5 m"},
        {"cover_low", "m^2", "cover below 0.5 m"},
        {"light", "W/m^2", "mean S"},
        {"temperature", "K", "mean T_s"},
        {"humidity", "", "mean rh_s"},
        {"humidity_north", "", "mean rh_s of cells that face north"},
        {"theta", "", "mean water content of the soil"},
        {"evaporation", "mm", "mean E"},
        {"precipitation", "mm", "mean rain that reached the surface"},
        {"runoff", "mm", "water that left the surface, as a mean depth"},
        {"balance_error", "", "water not accounted for, as a share"}};
    return list;
}

const std::vector<Column>& Statistics::photon_columns()
{
    static const std::vector<Column> list = {
        {"emitted", "W", "light sent towards the scene as photons"},
        {"missed", "W", "that met nothing"},
        {"absorbed", "W", "by land and moss"},
        {"escaped", "W", "after a reflection"},
        {"lost", "W", "given up after 64 bounces"},
        {"stored", "", "photons that hit something"},
        {"photons", "", "mean number an estimate of light rests on"},
        {"seeds_lost_back", "", "seeds that fell on the back of a face"},
        {"seeds_lost_nothing", "", "that fell on nothing"},
        {"seeds_lost_high", "", "that would stand too high on other mosses"},
        {"seeds_lost_collision", "", "that came too close to others"},
        {"seeds_lost_cap", "", "oldest ones beyond four caps"},
        {"seeds_lost_expired", "", "that grew too old"},
        {"germination_refused", "", "germinations put off because the cap was reached"}};
    return list;
}

Statistics::Statistics(int species, bool more) : species_(species), more_(more) {}

std::size_t Statistics::width() const
{
    return kColumns + (more_ ? photon_columns().size() : 0);
}

void Statistics::choose(std::size_t i, double area, Vec3f normal, double height, float light)
{
    const bool shade = light<kShade, north = normal.y> kNorth, low = height < kLowHeight;
    kind_[i] = static_cast<std::uint8_t>((shade ? kIsShade : 0) | (north ? kIsNorth : 0) |
                                         (low ? kIsLow : 0));
    if (shade) shade_area_ += area;
    if (north) north_area_ += area;
    if (shade && low) low_area_ += area;
}

bool Statistics::is_low(std::size_t site) const
{
    return !kind_.empty() && (kind_[site] & kIsLow);
}

void Statistics::add(int number, const Ground& ground_, const GroundDay& day,
                     std::span<const float> light, const std::vector<double>& water,
                     const MossDay& mosses, std::span<const double> more)
{
    const std::span<const float> areas = ground_.site_area();
    const double area = ground_.area();
    auto finish = [&](const double* row, const moss::SpeciesDay& of) {
        rows_.insert(rows_.end(), row, row + kColumns);
        if (!more_) return;
        rows_.insert(rows_.end(), more.begin(), more.end());
        for (const std::int64_t n : {of.back_face, of.no_hit, of.too_high, of.collided, of.dropped,
                                     of.expired, of.refused})
            rows_.push_back(double(n));
    };
    double row[kColumns] = {};
    row[kDay] = number;
    row[kSpecies] = -1;
    row[kDirection] = day.weather.wind_direction;
    auto kind = [&](std::size_t i) { return kind_.empty() ? std::uint8_t(0) : kind_[i]; };
    const auto ground = sums_over<6>(areas.size(), [&](std::size_t i, std::array<double, 6>& sum) {
        const double a = double(areas[i]), humidity = a * double(day.ground.humidity[i]);
        sum[0] += a * double(light[i]);
        sum[1] += a * double(day.ground.temperature[i]);
        sum[2] += humidity;
        if (kind(i) & kIsNorth) sum[3] += humidity;
        sum[4] += a * water[i] / double(ground_.depth()[i]);
        sum[5] += a * day.ground.evaporation[i];
    });
    row[kLight] = ground[0] / area;
    row[kTemperature] = ground[1] / area;
    row[kHumidity] = ground[2] / area;
    row[kHumidityNorth] = share_of(ground[3], north_area_);
    row[kTheta] = ground[4] / area;
    row[kEvaporation] = ground[5] / area;
    row[kPrecipitation] = day.rainfall / area;
    row[kRunoff] = day.outflow / area;
    row[kBalance] = day.balance_error;
    largest_error_ = std::max(largest_error_, std::abs(day.balance_error));
    if (species_ == 0) finish(row, {});
    for (int s = 0; s < species_; ++s) {
        const moss::SpeciesDay& of = mosses.numbers->species[std::size_t(s)];
        const std::vector<float>& g = mosses.fitness[std::size_t(s)];
        const auto sums =
            sums_over<4>(areas.size(), [&](std::size_t i, std::array<double, 4>& sum) {
                const double a = double(areas[i]), fit = a * double(g[i]);
                const std::uint8_t k = kind(i);
                sum[0] += fit;
                if (k & kIsShade) sum[1] += fit;
                if ((k & kIsShade) && (k & kIsLow)) sum[2] += fit;
                if ((k & kIsLow) && !mosses.species.empty() && mosses.species[i] == s + 1)
                    sum[3] += a;
            });
        row[kSpecies] = s;
        row[kLiving] = double(of.living);
        row[kSeeds] = double(of.seeds);
        row[kGerminated] = double(of.germinated);
        row[kDied] = double(of.died + of.displaced);
        row[kCover] = of.area;
        row[kFitness] = sums[0] / area;
        row[kFitnessShade] = share_of(sums[1], shade_area_);
        row[kFitnessLow] = share_of(sums[2], low_area_);
        row[kCoverLow] = mosses.cover_low.empty() ? sums[3] : mosses.cover_low[std::size_t(s)];
        finish(row, of);
    }
}

void Statistics::restore(const std::vector<double>& saved)
{
    if (saved.size() % width() != 0)
        throw InvalidInput("checkpoint: the statistics have an odd length");
    rows_ = saved;
    for (std::size_t r = 0; r < rows_.size(); r += width())
        largest_error_ = std::max(largest_error_, std::abs(rows_[r + kBalance]));
}

Points Statistics::points(const std::string& stage) const
{
    Points points;
    const std::size_t n = rows_.size() / width();
    points.position.assign(n, Vec3d());
    for (std::size_t c = 0; c < width(); ++c) {
        std::vector<double> column(n);
        for (std::size_t r = 0; r < n; ++r) column[r] = rows_[r * width() + c];
        points.attributes[c < kColumns ? columns()[c].name : photon_columns()[c - kColumns].name] =
            std::move(column);
    }
    points.stage = stage;
    return points;
}

const std::vector<double>& statistics_column(const Points& statistics, const std::string& name,
                                             const std::string& who)
{
    if (const auto* values = statistics.values<double>(name)) return *values;
    throw InvalidInput(fmt::format(
        "{}: the points 'statistics' have no column '{}'; run the moss stage", who, name));
}

std::string statistics_csv(const Points& statistics, const std::vector<std::string>& species)
{
    std::vector<const std::vector<double>*> columns;
    std::vector<std::string> header;
    std::vector<Column> wanted = Statistics::columns();
    for (const Column& column : Statistics::photon_columns())
        if (statistics.attributes.contains(column.name)) wanted.push_back(column);
    for (const Column& column : wanted) {
        columns.push_back(&statistics_column(statistics, column.name, "statistics"));
        header.push_back(column.unit.empty() ? column.name
                                             : fmt::format("{} [{}]", column.name, column.unit));
    }
    std::string text = fmt::format("{}\n", fmt::join(header, ","));
    for (std::size_t r = 0; r < statistics.position.size(); ++r) {
        for (std::size_t c = 0; c < columns.size(); ++c) {
            if (c > 0) text += ',';
            const double value = (*columns[c])[r];
            if (c == kSpecies)
                text += value < 0                             ? "ground"
                        : std::size_t(value) < species.size() ? species[std::size_t(value)]
                                                              : fmt::format("{}", value);
            else
                text += fmt::format("{:.9g}", value);
        }
        text += '\n';
    }
    return text;
}

std::vector<std::string> split_names(const std::string& list)
{
    std::vector<std::string> names;
    std::size_t begin = 0;
    while (begin <= list.size()) {
        const std::size_t end = std::min(list.find(',', begin), list.size());
        std::string name = list.substr(begin, end - begin);
        while (!name.empty() && name.front() == ' ') name.erase(0, 1);
        while (!name.empty() && name.back() == ' ') name.pop_back();
        if (!name.empty()) names.push_back(std::move(name));
        begin = end + 1;
    }
    return names;
}

moss::Species find_species(const std::string& name, const std::filesystem::path& folder)
{
    return preset_or_file("species", name, folder, moss::preset_species(),
                          [](moss::Species& species, const std::string& stem) {
                              species.name = stem;  // what grids and tables call it
                              moss::validate(species);
                          });
}

std::vector<std::string> species_names(const Scene& scene)
{
    const Json* made = params_of(scene, "moss");
    if (!made || !made->contains("species")) return {};
    std::vector<std::string> names = split_names((*made)["species"].get<std::string>());
    for (std::string& name : names)
        if (std::filesystem::path(name).extension() == ".toml")
            name = std::filesystem::path(name).stem().string();
    return names;
}

}  // namespace sekitei::apps
