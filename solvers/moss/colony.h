#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/mesh_sites.h"
#include "core/params.h"
#include "core/progress.h"
#include "core/vec.h"
#include "grids/scene.h"
#include "solvers/moss/checkpoint.h"
#include "solvers/moss/mesh_landing.h"
#include "solvers/moss/population.h"

/// Mosses as individuals anywhere on a mesh, and on each other [Nomura2010, section 3].
///
/// The rules of growth, seeds and flight are those of the mosses that live on sites (growth.h,
/// flight.h); what differs is room: here a moss needs a distance, not a site. Everything gives the
/// same bits on any number of threads.
namespace sekitei::moss {

struct ColonyParams {
    double size = 0.01;
    int cap = 16384;
    int spores_per_day = 1;

    static void describe(auto&& field)
    {
        field("size", &ColonyParams::size, "m", between(1e-3, 1),
              "s_full, diameter of a grown moss");
        field("cap", &ColonyParams::cap, "", between(1, 1e8), "most mosses alive at once");
        field("spores_per_day", &ColonyParams::spores_per_day, "", between(0, 1000),
              "shed by each moss that is ripe and growing");
    }
};
/// @throws InvalidParameter
void validate(const ColonyParams& params);

/// What plants and seeds have in common; structure of arrays, 61 bytes each.
struct Individuals {
    std::vector<Vec3f> foot;          ///< [m]
    std::vector<Vec3f> normal;        ///< unit normal of the site, also of those that stand on moss
    std::vector<std::uint32_t> site;  ///< stood on, or below the moss stood on
    std::vector<std::uint64_t> host;  ///< id of the moss stood on, dead or alive; 0: land
    std::vector<float> height;        ///< of the foot over the land, through all hosts [m]
    std::vector<std::uint8_t> species;  ///< from 0
    std::vector<std::uint64_t> id;      ///< a seed's is kept by its plant
    std::vector<std::int32_t> landed;   ///< day on which it came here, as a seed
    std::vector<float> light;           ///< S, kept for who computes it; 0 at first [W/m^2]
    std::vector<float> light_area;      ///< likewise: its kernel's area; 0 at first [m^2]

    std::size_t size() const { return id.size(); }
    friend bool operator==(const Individuals&, const Individuals&) = default;
};

/// 12 bytes more.
struct Plants : Individuals {
    std::vector<float> growth, growth_max;  ///< G_moss and its highest so far
    std::vector<std::int32_t> born;         ///< day of germination

    friend bool operator==(const Plants&, const Plants&) = default;
};

/// Resting seeds, in the order of their ids.
struct Seeds : Individuals {
    std::vector<std::uint8_t> kind;  ///< 1 gemma, 2 spore

    friend bool operator==(const Seeds&, const Seeds&) = default;
};

/// Everything that lives. Ids count up from 1 in the order in which individuals found a place.
struct Colony {
    std::int32_t day = 0;  ///< days lived
    std::uint64_t next_id = 1;
    std::uint64_t arrivals = 0;  ///< spores that came from outside
    Plants plants;
    Seeds seeds;

    friend bool operator==(const Colony&, const Colony&) = default;
};

/// s = s_full sqrt(min(growth, 2) / 2): the cross-section grows linearly [m].
double moss_size(const ColonyParams& params, double growth);
/// Unit vector half-way between a normal and up; the normal itself where that points straight down.
Vec3d growth_axis(Vec3d normal);

/// Day 0: `initial_count` mosses of each species anywhere on the front faces, uniform by area, no
/// two closer than half a size; fewer where there is no room or the cap is reached.
/// @throws InvalidInput  sites whose arrays do not fit together
Colony first_settlers(const Community& community, const ColonyParams& params,
                      const MeshSites& sites);

/// Where a flying seed came down.
struct Landed {
    enum class Where { Land, Moss, BackFace, Nothing, TooHigh };
    Where where = Where::Nothing;  ///< beyond Moss it is lost
    Vec3f foot, normal;
    std::uint32_t site = 0;
    std::uint64_t host = 0;
    float height = 0;  ///< [m]
};

/// Lands seeds one by one: (1) on the closest land no farther than c_adj, from either side; else
/// (2) on the closest living moss no farther than c_adj; else (3) they fall to what they first
/// meet, the front of a face or a moss. Falling on the back of a face or on nothing they are lost,
/// and so are those whose foot would be more than 3 sizes above the land, moss on moss
/// [Nomura2010, sections 3.3, 3.6].
std::vector<Landed> land(std::span<const Flight> seeds, const Plants& plants,
                         const ColonyParams& params, const MeshSurface& surface, double adhesion);

/// G of each individual: in its own light, at the temperature and humidity of its site.
/// @param temperature, humidity  of each site [K, 0..1]
/// @throws InvalidInput  a site or a species that does not exist
std::vector<float> fitness(const Individuals& individuals, const Community& community,
                           std::span<const float> temperature, std::span<const float> humidity,
                           const Progress& progress);

/// What a colony meets on one day.
struct ColonyConditions {
    std::span<const float> plants, seeds;  ///< G of each, of its own species in its own light
    std::span<const float> wind;           ///< speed at each site [m/s]; empty: calm
    Vec3d downwind;                        ///< where it blows to, unit, horizontal
};

/// One day, in this order:
///  - seeds too old to germinate even at G = 1 go; seeds that can, germinate, in the order of their
///    ids until the cap is reached: those beyond it go on resting
///  - mosses grow, today's seedlings with them; those that shrink below their threshold die
///  - a gemma for each step that growth passes for the first time, thrown k in any direction, but
///    none from the interior of a dense patch; spores from each that is ripe and growing, thrown l
///    within a cone [Nomura2010, eqs. 3.22, 3.23]
///  - every `external_interval` days, a spore from outside anywhere on the front faces
///  - all of them land(); then, one by one, gemmae before spores before arrivals, then by the
///    parent's id: where one is closer than half a size to others, living or resting, the largest
///    priority of the species plus growth stays, of equals the older
///  - resting seeds beyond 4 caps are dropped, the oldest first
///
/// @param colony  changed, but whole and as before when this throws
/// @throws InvalidInput    arrays of different lengths, sites or species that do not exist
/// @throws NumericalError  a fitness that is negative or not finite, with the place
/// @throws Cancelled       from `progress`, at the start only
DayStatistics day(Colony& colony, const Community& community, const ColonyParams& params,
                  const MeshSurface& surface, const ColonyConditions& conditions,
                  const Progress& progress);

/// Living, seeds and area as they stand; the rest is 0. A moss counts for sqrt(3)/2 s_full^2, its
/// share of the densest packing.
DayStatistics count(const Colony& colony, const Community& community, const ColonyParams& params);

/// The balls that stand in the light, one a plant: of diameter s, resting on the foot along
/// growth_axis().
std::vector<Sphere> spheres(const Plants& plants, const ColonyParams& params);

/// 1 for plants whose neighbours, the feet within 1.3 s_full, are at least 5 and leave no gap wider
/// than 120 degrees around them in the tangent plane [Nomura2010, section 3.8].
std::vector<std::uint8_t> interior(const Plants& plants, const ColonyParams& params);

/// M, feet that find room around each site: the area of the sites within 2.5 s_full on its side (of
/// normals within 60 degrees), by sqrt(3)/2 s_full^2. A function of the sites alone.
std::vector<float> cover_capacity(const ColonyParams& params, const MeshSites& sites);
/// C_H of each site: m / M, at most 1, with m the feet within 2.5 s_full on its side [Nomura2010,
/// section 3.5].
std::vector<float> cover(const Plants& plants, const ColonyParams& params, const MeshSites& sites,
                         std::span<const float> capacity);

/// The living as points: `N`, `orient` (x y z w; turns +y to growth_axis(), tilted by up to 10
/// degrees, after a random yaw), `pscale` = s / s_full, `species` (from 0), `growth`, `growth_max`,
/// `age` [d], `id`, `host` (int64: the id of a moss, or -1 - site), `S`, `suit`, `interior`,
/// `wetness`. For the look only, feet stray along the surface by up to half a size, by 1/f noise of
/// the place with wavelengths from 0.5 m down, so that no pattern of throws shows [Nomura2010,
/// section 3.8].
/// @param suit      G of each plant; empty: left out
/// @param humidity  rh_s of each site, becomes `wetness`; empty: left out
Points to_points(const Colony& colony, const Community& community, const ColonyParams& params,
                 const MeshSurface& surface, std::span<const float> suit,
                 std::span<const float> humidity);
/// Resting seeds as points where they lie: `species`, `kind` (1 gemma, 2 spore), `age` [d].
Points seeds_to_points(const Colony& colony);

/// As that of a Population; say in the recipe which mesh it belongs to.
using ColonyCheckpoint = CheckpointOf<Colony>;
std::string encode(const ColonyCheckpoint& checkpoint);
/// @throws InvalidInput  as decode() of a Population; also an individual on a site that is not
ColonyCheckpoint decode_colony(std::string_view bytes, const std::string& where, std::uint64_t seed,
                               std::string_view recipe, std::size_t sites);

}  // namespace sekitei::moss
