#pragma once

#include <span>
#include <string>
#include <vector>

#include "apps/climate.h"
#include "core/parallel.h"
#include "solvers/moss/population.h"

/// What a run over many days leaves behind: means of the ground, and a row of numbers a day.
namespace sekitei::apps {

/// Takes one more day into means of `count` days, the new one included. A mean kept so stays good
/// to 1e-6 of its size in 4 bytes, however many days there are.
template <class F>
void add_to_mean(std::vector<float>& mean, std::size_t count, F&& value)
{
    const double share = 1 / static_cast<double>(count);
    parallel_for(
        mean.size(),
        [&](std::size_t i) {
            const double before = double(mean[i]);
            mean[i] = static_cast<float>(before + (double(value(i)) - before) * share);
        },
        8192);
}

/// Means over days of what each cell meets.
class GroundMeans {
public:
    explicit GroundMeans(const Ground& ground);
    void add(const GroundDay& day, const std::vector<double>& water);

    /// A mean by the name of its grid, with its unit.
    struct Field {
        const char *name, *unit;
        const std::vector<float>& values;
    };
    /// soil_theta, soil_beta, soil_Ts, soil_rh, soil_E, soil_runoff.
    std::vector<Field> fields() const;
    void put(Scene& scene, const SurfaceCells& cells, const std::string& stage) const;
    Json summary() const;
    std::size_t days() const { return days_; }

    /// The means, for checkpoints.
    std::vector<double> save() const;
    void restore(const std::vector<double>& saved);

private:
    enum { kTheta, kBeta, kTemperature, kHumidity, kEvaporation, kRunoff, kCount };
    const Ground* ground_;
    std::size_t days_ = 0;
    std::array<std::vector<float>, kCount> mean_;
};

/// soil_water [mm] at the end, geology, soil_h [mm].
void put_water(Scene& scene, const Climate& climate, const std::vector<double>& water,
               const std::string& stage);

/// Metadata of the grids of these names that are there: `day` (the last one), `profile`, `seed`.
void label(Scene& scene, const std::vector<std::string>& names, std::size_t day, Profile profile,
           std::uint64_t seed);

/// The mosses of one day, as Statistics counts them.
struct MossDay {
    const moss::DayStatistics* numbers = nullptr;
    std::span<const std::uint8_t> species{};  ///< of each cell's moss, from 1; 0: none
    std::span<const std::vector<float>> fitness{};
    std::span<const double> cover_low{};  ///< [m^2] of each species, where `species` is empty
};

/// One column of `statistics`.
struct Column {
    std::string name, unit, meaning;
};

/// The points `statistics`: a row for each day and species (-1: the ground alone), in that order.
/// Cells below are surface cells of a volume, or the sites of a mesh.
///
/// Means over the surface are weighted by area. "Shade": cells with less than 80 W/m^2 in the mean
/// of the weather's days; "north": cells whose normal points north; "low": below 0.5 m.
class Statistics {
public:
    static const std::vector<Column>& columns();

    /// @param species  how many; 0: rows of the ground alone
    /// @param more     with photon_columns()
    explicit Statistics(int species, bool more = false);
    /// What photons and seeds on a mesh add to columns().
    static const std::vector<Column>& photon_columns();

    /// Says which sites are shady, face north and lie low; until then those columns are 0.
    /// @param sites       cells, or sites of a mesh
    /// @param mean_light  of each [W/m^2]
    /// @param ground      height of the ground [m]
    template <class Sites>
    void choose(const Sites& sites, std::span<const float> mean_light, double ground)
    {
        kind_.resize(sites.size());
        shade_area_ = north_area_ = low_area_ = 0;
        for (std::size_t i = 0; i < sites.size(); ++i)
            choose(i, double(sites.area[i]), sites.normal[i], double(sites.position[i].z) - ground,
                   mean_light[i]);
    }
    bool is_low(std::size_t site) const;

    /// @param more  the first seven of photon_columns(); those of seeds are in `mosses`
    void add(int day, const Ground& ground, const GroundDay& today, std::span<const float> light,
             const std::vector<double>& water, const MossDay& mosses,
             std::span<const double> more = {});

    Points points(const std::string& stage) const;
    double largest_balance_error() const { return largest_error_; }

    std::vector<double> save() const { return rows_; }
    void restore(const std::vector<double>& saved);

private:
    void choose(std::size_t site, double area, Vec3f normal, double height, float light);
    std::size_t width() const;

    int species_;
    bool more_;
    std::vector<std::uint8_t> kind_;  ///< bits: shade, north, low
    double shade_area_ = 0, north_area_ = 0, low_area_ = 0;
    std::vector<double> rows_;
    double largest_error_ = 0;
};

/// One column of a scene's `statistics`.
/// @throws InvalidInput  it is not there; names `who`
const std::vector<double>& statistics_column(const Points& statistics, const std::string& name,
                                             const std::string& who);

/// The rows of `statistics` as comma-separated values with units in the header.
/// @throws InvalidInput  a column is missing
std::string statistics_csv(const Points& statistics, const std::vector<std::string>& species);

/// Names of the species of a scene's moss stage, in order; empty where it had none.
std::vector<std::string> species_names(const Scene& scene);
/// A species by name or from a .toml file.
moss::Species find_species(const std::string& name, const std::filesystem::path& folder);
/// "bryum,hypnum" as names.
std::vector<std::string> split_names(const std::string& list);

}  // namespace sekitei::apps
