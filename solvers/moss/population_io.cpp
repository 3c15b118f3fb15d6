#include <fmt/format.h>

#include <array>
#include <cmath>

#include "core/error.h"
#include "core/parallel.h"
#include "solvers/moss/checkpoint_codec.h"
#include "solvers/moss/flight.h"
#include "solvers/moss/population.h"

// What leaves a population and comes back: values for grids, points, checkpoints.
namespace sekitei::moss {
namespace {

constexpr Stream kYaw{"moss.yaw"};
constexpr Stream kPlace{"moss.place"};
constexpr double kStray = 0.5;     // of a foot from its cell's middle / spacing
constexpr double kFullGrowth = 2;  // G_moss of full visual size

std::vector<std::int32_t> widened(const std::vector<std::uint8_t>& values)
{
    return {values.begin(), values.end()};
}

std::vector<std::int32_t> ages(std::int32_t day, const std::vector<std::uint8_t>& occupied,
                               const std::vector<std::int32_t>& born)
{
    std::vector<std::int32_t> result(occupied.size());
    for (std::size_t i = 0; i < result.size(); ++i) result[i] = occupied[i] ? day - born[i] : 0;
    return result;
}

/// The zero of the level set on the line through p along n, within 2.5 voxels, else `otherwise`.
Vec3d on_surface(GridReader<float>& level_set, const Transform& transform, Vec3d p, Vec3d n,
                 Vec3d otherwise)
{
    auto value = [&](double t) {
        return double(level_set.sample(transform.voxels(p + n * (t * transform.voxel))));
    };
    // Walk from p to the side where the sign changes first, then halve.
    constexpr int kSteps = 20;
    constexpr double kStep = 0.125;
    const double start = value(0);
    const double sign = start < 0 ? 1 : -1;
    for (int k = 1; k <= kSteps; ++k) {
        if ((value(sign * k * kStep) < 0) == (start < 0)) continue;
        double near = sign * (k - 1) * kStep, far = sign * k * kStep;
        for (int halving = 0; halving < 20; ++halving) {
            const double middle = (near + far) / 2;
            ((value(middle) < 0) == (start < 0) ? near : far) = middle;
        }
        return p + n * ((near + far) / 2 * transform.voxel);
    }
    return otherwise;
}

/// Uniform in a disc of radius kStray across n.
Vec3d stray(std::uint64_t key, std::uint64_t id, Vec3d n)
{
    const Vec3d u = normalized(cross(n, std::abs(n.z) < 0.9 ? Vec3d(0, 0, 1) : Vec3d(1, 0, 0)));
    const std::uint64_t own = hash2(key, id);
    const double angle = 2 * math::kPi * uniform_of_key(own, 0);
    const double r = kStray * std::sqrt(uniform_of_key(own, 1));
    return u * (r * math::cos(angle)) + cross(n, u) * (r * math::sin(angle));
}

template <class T>
const std::vector<T>& attribute(const Points& points, const char* name, const char* type)
{
    if (const auto* values = points.values<T>(name)) return *values;
    const auto found = points.attributes.find(name);
    if (found == points.attributes.end())
        throw InvalidInput(fmt::format("moss points: no attribute {}", name));
    if (const auto* values = std::get_if<std::vector<T>>(&found->second))
        throw InvalidInput(fmt::format("moss points: {} has {} values for {} points", name,
                                       values->size(), points.position.size()));
    throw InvalidInput(fmt::format("moss points: {} must be {}", name, type));
}

constexpr CheckpointKind kSites{"SEKIMOSS", 1, "a checkpoint of moss"};

}  // namespace

/// Visits every array of a population, in the order of the file.
template <class P, class F>
static void each_array(P& p, F&& f)
{
    f(p.species), f(p.growth), f(p.growth_max), f(p.born), f(p.id);
    f(p.seed_kind), f(p.seed_species), f(p.seed_born), f(p.seed_id);
    f(p.cover);
}

std::vector<std::int32_t> moss_species(const Population& p)
{
    return widened(p.species);
}
std::vector<std::int32_t> moss_age(const Population& p)
{
    return ages(p.day, p.species, p.born);
}
std::vector<std::int32_t> seed_kind(const Population& p)
{
    return widened(p.seed_kind);
}
std::vector<std::int32_t> seed_species(const Population& p)
{
    return widened(p.seed_species);
}
std::vector<std::int32_t> seed_age(const Population& p)
{
    return ages(p.day, p.seed_kind, p.seed_born);
}

Points to_points(const Population& p, const Community& community, const Surface& surface,
                 const FloatGrid* level_set, std::span<const float> humidity)
{
    if (p.size() != surface.size() || (!humidity.empty() && humidity.size() != p.size()))
        throw InvalidInput(
            fmt::format("moss: {} sites with moss, {} of the surface, {} with humidity", p.size(),
                        surface.size(), humidity.size()));
    std::vector<std::int32_t> site;
    for (std::size_t i = 0; i < p.size(); ++i)
        if (p.species[i]) site.push_back(static_cast<std::int32_t>(i));
    const std::size_t n = site.size();

    Points points;
    points.position.resize(n);
    std::vector<Vec3f> normal(n);
    std::vector<std::array<float, 4>> orient(n);
    std::vector<float> pscale(n), growth(n), growth_max(n), wetness(humidity.empty() ? 0 : n);
    std::vector<std::int32_t> species(n), age(n);
    std::vector<std::int64_t> id(n);
    const std::uint64_t yaw_key = hash2(community.seed, kYaw.id);
    const std::uint64_t place_key = hash2(community.seed, kPlace.id);
    parallel_for_range(
        n,
        [&](std::size_t begin, std::size_t end) {
            std::optional<GridReader<float>> reader;
            if (level_set) reader.emplace(*level_set);
            for (std::size_t k = begin; k < end; ++k) {
                const auto i = static_cast<std::size_t>(site[k]);
                const Vec3d normal_d = normalized(Vec3d(surface.normal[i]));
                points.position[k] = surface.foot(i);
                if (reader) {
                    const Vec3d middle = on_surface(*reader, level_set->transform(),
                                                    surface.position[i], normal_d, surface.foot(i));
                    // Off the lattice, anywhere in the cell; where an edge is near, the middle.
                    const Vec3d strayed = on_surface(
                        *reader, level_set->transform(),
                        surface.position[i] + stray(place_key, p.id[i], normal_d) * surface.spacing,
                        normal_d, middle);
                    points.position[k] =
                        length(strayed - middle) < 0.9 * surface.spacing ? strayed : middle;
                }
                normal[k] = surface.normal[i];
                orient[k] = orientation(normalized(normal_d + Vec3d(0, 0, 0.5)),
                                        2 * math::kPi * uniform_of_key(yaw_key, p.id[i]));
                growth[k] = p.growth[i];
                growth_max[k] = p.growth_max[i];
                pscale[k] = static_cast<float>(std::min(1.0, double(p.growth[i]) / kFullGrowth));
                species[k] = p.species[i] - 1;
                age[k] = p.day - p.born[i];
                id[k] = static_cast<std::int64_t>(p.id[i]);
                if (!humidity.empty()) wetness[k] = humidity[i];
            }
        },
        256);
    points.attributes = {{"N", std::move(normal)},
                         {"orient", std::move(orient)},
                         {"pscale", std::move(pscale)},
                         {"species", std::move(species)},
                         {"age", std::move(age)},
                         {"id", std::move(id)},
                         {"site", std::move(site)},
                         {"growth", std::move(growth)},
                         {"growth_max", std::move(growth_max)}};
    if (!humidity.empty()) points.attributes["wetness"] = std::move(wetness);
    points.stage = "moss";
    return points;
}

Population from_points(const Points& points, const Community& community, const Surface& surface,
                       std::int32_t day)
{
    const auto& site = attribute<std::int32_t>(points, "site", "int32");
    const auto& species = attribute<std::int32_t>(points, "species", "int32");
    const auto& age = attribute<std::int32_t>(points, "age", "int32");
    const auto& id = attribute<std::int64_t>(points, "id", "int64");
    const auto& growth = attribute<float>(points, "growth", "float");
    const auto& growth_max = attribute<float>(points, "growth_max", "float");
    Population p(surface.size());
    p.day = day;
    for (std::size_t k = 0; k < points.position.size(); ++k) {
        auto require = [&](bool good, const char* name, double value, const std::string& range) {
            if (!good)
                throw InvalidInput(fmt::format("moss points: {} of point {} = {:.9g}, must be {}",
                                               name, k, value, range));
        };
        require(site[k] >= 0 && static_cast<std::size_t>(site[k]) < p.size(), "site", site[k],
                fmt::format("below {}, the number of sites", p.size()));
        require(species[k] >= 0 && static_cast<std::size_t>(species[k]) < community.species.size(),
                "species", species[k],
                fmt::format("below {}, the number of species", community.species.size()));
        require(age[k] >= 0 && age[k] <= day, "age", age[k], fmt::format("0 to {}", day));
        require(id[k] >= 1, "id", static_cast<double>(id[k]), "positive");
        require(growth[k] >= 0 && growth[k] < 1e30F, "growth", growth[k], "finite, not negative");
        require(growth_max[k] >= growth[k] && growth_max[k] < 1e30F, "growth_max", growth_max[k],
                "finite, at least growth");
        const auto i = static_cast<std::size_t>(site[k]);
        require(!p.species[i], "site", site[k], "that of no other point");
        p.species[i] = static_cast<std::uint8_t>(species[k] + 1);
        p.born[i] = day - age[k];
        p.id[i] = static_cast<std::uint64_t>(id[k]);
        p.growth[i] = growth[k];
        p.growth_max[i] = growth_max[k];
        p.next_id = std::max(p.next_id, p.id[i] + 1);
    }
    update_cover(p, surface);
    return p;
}

std::string difference(const std::string& before, std::string_view now)
{
    const Json a = Json::parse(before, nullptr, false), b = Json::parse(now, nullptr, false);
    if (!a.is_object() || !b.is_object())
        return fmt::format("; recipe {}, this run has {}", before, now);
    constexpr std::size_t kHash = 32;  // whose digits tell nobody anything
    std::string text;
    auto add = [&](const std::string& name, const Json& x, const Json& y) {
        if (x == y) return;
        const Json& any = x.is_null() ? y : x;
        if (any.is_string() && any.get_ref<const std::string&>().size() == kHash)
            text += fmt::format("; {} {}", name,
                                x.is_null()   ? "was not there"
                                : y.is_null() ? "is gone"
                                              : "is another");
        else
            text += fmt::format("; {} {}, this run has {}", name, x.dump(), y.dump());
    };
    for (const auto& [name, value] : a.items())
        add(name, value, b.contains(name) ? b[name] : Json());
    for (const auto& [name, value] : b.items())
        if (!a.contains(name)) add(name, Json(), value);
    return text;
}

std::string encode(const Checkpoint& c)
{
    return encode(kSites, c);
}

Checkpoint decode(std::string_view bytes, const std::string& where, std::uint64_t seed,
                  std::string_view recipe, std::size_t sites)
{
    auto differs = [&](const Population& p) {
        return p.size() == sites ? std::string()
                                 : fmt::format("; {} sites, this run has {}", p.size(), sites);
    };
    auto damage = [&](Population& p) {
        bool good = true;
        each_array(p, [&](const auto& v) { good = good && v.size() == sites; });
        return good ? "" : "arrays of different lengths";
    };
    return decode<Population>(kSites, bytes, where, seed, recipe, differs, damage);
}

}  // namespace sekitei::moss
