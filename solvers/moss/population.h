#pragma once

#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/params.h"
#include "core/progress.h"
#include "core/vec.h"
#include "grids/scene.h"
#include "solvers/moss/checkpoint.h"
#include "solvers/moss/growth.h"

/// Mosses that live on the sites of a surface: who stands where, day by day [Nomura2010, section
/// 3].
///
/// A site is a surface cell of a volume or a face of a mesh. It has room for one moss and, under
/// it, one seed. Everything here gives the same bits on any number of threads, and does not depend
/// on how sites are numbered beyond the first placement and the spores from outside.
namespace sekitei::moss {

enum class SporeCone { Front, Both };
constexpr std::array<std::string_view, 2> choice_names(SporeCone)
{
    return {"front", "both"};
}

/// How mosses come and how their seeds fly.
struct Propagation {
    std::optional<double> gemma_throw, adhesion;
    double spore_throw = 0.30;
    SporeCone spore_cone = SporeCone::Front;
    bool spore_wind = false;
    double settling_speed = 0.02;
    int external_interval = 10;
    int initial_count = 50;
    double initial_growth = 0.2;

    static constexpr Range kUpTo100{.lower = 0, .upper = 100, .without_lower = true};

    static void describe(auto&& field)
    {
        field("gemma_throw", &Propagation::gemma_throw, "m", kUpTo100,
              "k, how far a gemma is thrown; auto: 1.5 sites");
        field("adhesion", &Propagation::adhesion, "m", kUpTo100,
              "distance from the surface within which a seed sticks; auto: half of gemma_throw");
        field("spore_throw", &Propagation::spore_throw, "m", kUpTo100,
              "l, how far a spore is thrown");
        field("spore_cone", &Propagation::spore_cone,
              "spores leave within 45 degrees of the surface's normal; both: or of its opposite");
        field("spore_wind", &Propagation::spore_wind, "falling spores drift with the wind");
        field("settling_speed", &Propagation::settling_speed, "m/s", kPositive,
              "speed at which a spore falls, when spore_wind is on");
        field("external_interval", &Propagation::external_interval, "d", kNotNegative,
              "days between spores from elsewhere, species in turn; 0: never");
        field("initial_count", &Propagation::initial_count, "", kNotNegative,
              "mosses of each species on day 0");
        field("initial_growth", &Propagation::initial_growth, "", kUpTo100, "their growth");
    }
};
/// @throws InvalidParameter
void validate(const Propagation& propagation);

double gemma_throw(const Propagation& propagation, double spacing);  ///< k [m]
double adhesion(const Propagation& propagation, double spacing);     ///< c_adj [m]

/// Who may live here, and by which rules. Views the species.
struct Community {
    std::span<const Species> species;  ///< 1 to 255
    Rules rules;
    Propagation propagation;
    std::uint64_t seed = 0;
};
/// Every species, the rules and the propagation.
/// @throws InvalidParameter  also when two species have one name
void validate(const Community& community);

/// The sites. Views what it is made from.
struct Surface {
    std::span<const Vec3d> position;  ///< [m]
    std::span<const float> offset;    ///< sdf at the position [m]; empty: all on the surface
    std::span<const Vec3f> normal;    ///< outward unit normal
    std::span<const float> area;      ///< [m^2]
    /// Sites around site i: neighbour[neighbour_begin[i] .. neighbour_begin[i + 1]), itself left
    /// out.
    std::span<const std::uint32_t> neighbour_begin, neighbour;
    double spacing = 0;  ///< edge of a site [m]

    std::size_t size() const { return position.size(); }
    /// Where a moss of the site has its foot: the position moved onto the surface.
    Vec3d foot(std::size_t site) const
    {
        return offset.empty() ? position[site]
                              : position[site] - Vec3d(normal[site]) * double(offset[site]);
    }
};

/// A seed in the air.
struct Flight {
    Vec3d at;              ///< [m]
    Vec3d fall{0, 0, -1};  ///< way of a metre's fall, z = -1
};

/// Where seeds come to rest; each kind of surface has its own.
class Landing {
public:
    static constexpr std::int32_t kLost = -1;

    virtual ~Landing() = default;
    /// The largest adhesion it can tell [m].
    virtual double reach() const { return std::numeric_limits<double>::infinity(); }
    /// The site of each seed, or kLost. Called from many threads at once.
    /// @param adhesion  a seed this near the surface sticks [m]
    virtual void land(std::span<const Flight> seeds, double adhesion,
                      std::span<std::int32_t> site) const = 0;
};

/// The state of all sites, 39 bytes each, as a structure of arrays.
///
/// Species are numbered from 1, 0 is an empty slot. A moss keeps the id of its seed; ids count up
/// from 1 in the order in which individuals found a place.
struct Population {
    std::int32_t day = 0;  ///< days lived
    std::uint64_t next_id = 1;
    std::uint64_t arrivals = 0;  ///< spores that came from outside

    std::vector<std::uint8_t> species;      ///< of the moss
    std::vector<float> growth, growth_max;  ///< G_moss and its highest so far
    std::vector<std::int32_t> born;         ///< day of germination
    std::vector<std::uint64_t> id;

    std::vector<std::uint8_t> seed_kind;  ///< 0 none, 1 gemma, 2 spore
    std::vector<std::uint8_t> seed_species;
    std::vector<std::int32_t> seed_born;  ///< day of release
    std::vector<std::uint64_t> seed_id;

    std::vector<float> cover;  ///< occupied share of the site and its neighbours, 0..1

    Population() = default;
    explicit Population(std::size_t sites);
    std::size_t size() const { return species.size(); }
    friend bool operator==(const Population&, const Population&) = default;
};

/// What became of one species on one day.
struct SpeciesDay {
    std::int64_t living = 0, seeds = 0;  ///< at the day's end
    std::int64_t germinated = 0, died = 0;
    std::int64_t displaced = 0;              ///< mosses that gave way to one of higher priority
    std::int64_t gemmae = 0, spores = 0;     ///< released
    std::int64_t settled = 0;                ///< seeds that found a place, from outside included
    std::int64_t expired = 0, replaced = 0;  ///< resting seeds that grew too old, or gave way
    double area = 0;                         ///< of the sites it covers [m^2]

    // Of individuals on meshes only. settled = gemmae + spores + arrived - back_face - no_hit -
    // too_high - collided.
    std::int64_t arrived = 0;                ///< spores from outside
    std::int64_t back_face = 0, no_hit = 0;  ///< lost on the back of a face, or on nothing
    std::int64_t too_high = 0;               ///< lost on mosses that stand on mosses
    std::int64_t collided = 0;               ///< lost to another that was too close
    std::int64_t dropped = 0;                ///< resting seeds beyond four times the cap
    std::int64_t refused = 0;                ///< could have germinated, but for the cap

    friend bool operator==(const SpeciesDay&, const SpeciesDay&) = default;
};

/// Conserved, for each species: living = living yesterday + germinated - died - displaced, and
/// seeds = seeds yesterday + settled - germinated - expired - replaced - dropped.
struct DayStatistics {
    std::int32_t day = 0;
    std::vector<SpeciesDay> species;

    friend bool operator==(const DayStatistics&, const DayStatistics&) = default;
};

/// Day 0: `initial_count` mosses of each species on sites drawn by area, never two on one site;
/// fewer where the sites run out.
/// @throws InvalidInput  arrays of `surface` that do not fit together
Population first_settlers(const Community& community, const Surface& surface);

/// What the mosses meet on one day.
struct Conditions {
    std::span<const std::vector<float>> fitness;  ///< G of each species on each site
    std::span<const float> wind;                  ///< speed at each site [m/s]; empty: calm
    Vec3d downwind;                               ///< where it blows to, unit, horizontal
};

/// One day, in this order:
///  - seeds too old to germinate even at G = 1 go; seeds that can, germinate, if no moss stands on
///    their site or one whose priority (of its species, plus growth) is lower than their species'
///  - mosses grow; those that shrink below their threshold die
///  - a gemma for each step that growth passes for the first time, thrown k in any direction; one
///    spore from each that is ripe and growing, thrown l within a cone [Nomura2010,
///    eqs. 3.22, 3.23]
///  - every `external_interval` days, a spore from outside on a site drawn by area
///  - all of them land. A seed takes the place of a resting one of lower priority, not of an equal;
///    among those of one day higher priority goes first, then gemmae before spores before arrivals,
///    then the older parent
///  - cover
///
/// @param population  changed, but whole and as before when this throws
/// @throws InvalidInput    arrays of different lengths; adhesion beyond the landing's reach
/// @throws NumericalError  a fitness that is negative or not finite, with its site
/// @throws Cancelled       from `progress`, at the start only
///
/// Bit-identical for any number of threads.
DayStatistics day(Population& population, const Community& community, const Surface& surface,
                  const Landing& landing, const Conditions& conditions, const Progress& progress);

/// Recomputes `cover`; day() does it by itself.
void update_cover(Population& population, const Surface& surface);

/// Living, seeds and area as they stand; the rest is 0.
DayStatistics count(const Population& population, const Community& community,
                    const Surface& surface);

/// Values of each site as grids show them: species and kinds as they are, ages in days (0 where
/// the slot is empty).
std::vector<std::int32_t> moss_species(const Population& population);
std::vector<std::int32_t> moss_age(const Population& population);
std::vector<std::int32_t> seed_kind(const Population& population);
std::vector<std::int32_t> seed_species(const Population& population);
std::vector<std::int32_t> seed_age(const Population& population);

/// The living as points, in the order of their sites: `N`, `orient` (x y z w; turns +y to the axis
/// N + up / 2, which leans at most 30 degrees from the normal, after a random yaw), `pscale` =
/// min(1, growth / 2), `species` (from 0), `age` [d], `id` (int64), `site`, `growth`, `growth_max`,
/// `wetness`.
///
/// @param level_set  if given, feet stray from the middle of their cells, by at most half a
///                   spacing so that no lattice shows, and stand on its zero set (trilinear); else
///                   they are at Surface::foot
/// @param humidity   rh_s of each site, becomes `wetness`; empty: left out
Points to_points(const Population& population, const Community& community, const Surface& surface,
                 const FloatGrid* level_set, std::span<const float> humidity);

/// The living of to_points(), without seeds.
/// @throws InvalidInput  an attribute that is missing, of another type or out of range; two on one
///                       site
Population from_points(const Points& points, const Community& community, const Surface& surface,
                       std::int32_t day);

using Checkpoint = CheckpointOf<Population>;
/// A header (magic, version, seed, recipe, day), the arrays, and a checksum over all of it.
std::string encode(const Checkpoint& checkpoint);
/// @param where  for messages
/// @throws InvalidInput  not a checkpoint, damaged, of another version, seed, recipe or number of
///                       sites; names all that differ, with both values
Checkpoint decode(std::string_view bytes, const std::string& where, std::uint64_t seed,
                  std::string_view recipe, std::size_t sites);

}  // namespace sekitei::moss
