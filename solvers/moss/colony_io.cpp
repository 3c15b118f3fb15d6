#include <fmt/format.h>

#include <array>
#include <cmath>
#include <string_view>

#include "core/error.h"
#include "core/math.h"
#include "core/noise.h"
#include "core/parallel.h"
#include "solvers/moss/checkpoint_codec.h"
#include "solvers/moss/colony.h"
#include "solvers/moss/flight.h"
#include "solvers/moss/individuals.h"

// What leaves a colony and comes back: points, checkpoints.
namespace sekitei::moss {
namespace {

constexpr Stream kLook{"colony.look"}, kStrayU{"colony.stray_u"}, kStrayV{"colony.stray_v"};
constexpr double kStray = 0.5;                  // of a foot by noise of 1, / s_full
constexpr double kTilt = 10 * math::kPi / 180;  // largest, off the growth axis
constexpr int kOctaves = 6;
constexpr double kLongest = 0.5;  // wavelength [m]

/// f: octaves of equal amplitude, whose spectrum falls as 1 / f.
FractalNoise stray(std::uint64_t seed, Stream stream)
{
    return {
        .seed = seed, .stream = stream, .frequency = 1 / kLongest, .hurst = 0, .octaves = kOctaves};
}

}  // namespace

Points to_points(const Colony& colony, const Community& community, const ColonyParams& params,
                 const MeshSurface& surface, std::span<const float> suit,
                 std::span<const float> humidity)
{
    const Plants& p = colony.plants;
    const std::size_t n = p.size(), sites = surface.sites().size();
    if ((!suit.empty() && suit.size() != n) || (!humidity.empty() && humidity.size() != sites))
        throw InvalidInput(
            fmt::format("moss: {} plants on {} sites, fitness of {}, humidity of {} sites", n,
                        sites, suit.size(), humidity.size()));
    Points points;
    points.position.resize(n);
    std::vector<std::array<float, 4>> orient(n);
    std::vector<float> pscale(n), wetness(humidity.empty() ? 0 : n);
    std::vector<std::int32_t> species(n), age(n), inner(n);
    std::vector<std::int64_t> id(n), host(n);
    const std::vector<std::uint8_t> interior_now = interior(p, params);
    const FractalNoise noise_u = stray(community.seed, kStrayU),
                       noise_v = stray(community.seed, kStrayV);
    parallel_for(
        n,
        [&](std::size_t i) {
            const Vec3d foot(p.foot[i]), normal(p.normal[i]);
            const double by = kOctaves * kStray * params.size;  // the noise is a mean of octaves
            const Vec3d strayed = foot + about(normal, {by * noise_u(foot), by * noise_v(foot), 0});
            // What stands on land stays on it, round edges too.
            const auto land = p.host[i] == 0 ? surface.closest(strayed, by) : std::nullopt;
            points.position[i] = land ? land->at : strayed;

            const Draws draw(community.seed, kLook, p.id[i]);
            const Vec3d axis =
                about(growth_axis(normal), direction(math::cos(kTilt * draw(0)), draw(1)));
            orient[i] = orientation(normalized(axis), 2 * math::kPi * draw(2));
            pscale[i] = static_cast<float>(moss_size(params, double(p.growth[i])) / params.size);
            species[i] = p.species[i];
            age[i] = colony.day - p.born[i];
            id[i] = static_cast<std::int64_t>(p.id[i]);
            host[i] = p.host[i] ? static_cast<std::int64_t>(p.host[i])
                                : -1 - static_cast<std::int64_t>(p.site[i]);
            inner[i] = interior_now[i];
            if (!humidity.empty()) wetness[i] = humidity[p.site[i]];
        },
        256);
    points.attributes = {{"N", p.normal},
                         {"orient", std::move(orient)},
                         {"pscale", std::move(pscale)},
                         {"species", std::move(species)},
                         {"growth", p.growth},
                         {"growth_max", p.growth_max},
                         {"age", std::move(age)},
                         {"id", std::move(id)},
                         {"host", std::move(host)},
                         {"S", p.light},
                         {"interior", std::move(inner)}};
    if (!suit.empty()) points.attributes["suit"] = std::vector<float>(suit.begin(), suit.end());
    if (!humidity.empty()) points.attributes["wetness"] = std::move(wetness);
    points.stage = "moss";
    return points;
}

Points seeds_to_points(const Colony& colony)
{
    const Seeds& s = colony.seeds;
    Points points;
    std::vector<std::int32_t> age;
    for (std::size_t i = 0; i < s.size(); ++i) {
        points.position.emplace_back(s.foot[i]);
        age.push_back(colony.day - s.landed[i]);
    }
    points.attributes = {{"species", std::vector<std::int32_t>(s.species.begin(), s.species.end())},
                         {"kind", std::vector<std::int32_t>(s.kind.begin(), s.kind.end())},
                         {"age", std::move(age)}};
    points.stage = "moss";
    return points;
}

namespace {
constexpr CheckpointKind kColony{"SEKICOLO", 1, "a checkpoint of moss on a mesh"};
}

static void each_array_of_both(auto& colony, auto&& f)
{
    each_array(colony.plants, f);
    each_array(colony.seeds, f);
}
template <class F>
static void each_array(Colony& colony, F&& f)
{
    each_array_of_both(colony, f);
}
template <class F>
static void each_array(const Colony& colony, F&& f)
{
    each_array_of_both(colony, f);
}

std::string encode(const ColonyCheckpoint& checkpoint)
{
    return encode(kColony, checkpoint);
}

ColonyCheckpoint decode_colony(std::string_view bytes, const std::string& where, std::uint64_t seed,
                               std::string_view recipe, std::size_t sites)
{
    auto damage = [&](const Colony& colony) -> std::string {
        bool lengths = true, known = true;
        auto look = [&](const auto& individuals) {
            each_array(individuals,
                       [&](const auto& v) { lengths = lengths && v.size() == individuals.size(); });
            for (const std::uint32_t site : individuals.site) known = known && site < sites;
        };
        look(colony.plants);
        look(colony.seeds);
        return !lengths ? "arrays of different lengths"
               : !known ? fmt::format("a moss on a site beyond the {} there are", sites)
                        : "";
    };
    return decode<Colony>(
        kColony, bytes, where, seed, recipe, [](const Colony&) { return std::string(); }, damage);
}

}  // namespace sekitei::moss
