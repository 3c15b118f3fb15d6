#include "solvers/moss/colony.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "core/error.h"
#include "core/math.h"
#include "core/parallel.h"
#include "core/point_search.h"
#include "solvers/moss/flight.h"
#include "solvers/moss/individuals.h"

namespace sekitei::moss {
namespace {

constexpr double kApart = 0.5;        // least distance of two feet / s_full
constexpr double kCrowd = 1.3;        // distance within which others enclose / s_full
constexpr double kCoverRadius = 2.5;  // around a site, / s_full
constexpr double kStack = 3;          // largest height / s_full
constexpr double kPacking =
    0.8660254037844386;            // sqrt(3) / 2: area of a moss packed densely / s_full^2
constexpr double kSameSide = 0.5;  // cosine between normals of one side
constexpr std::size_t kMostFlights = std::size_t{1} << 24;  // seeds in one day

constexpr Stream kSettler{"colony.initial"};

float in_sizes(double sizes, const ColonyParams& params)
{
    return static_cast<float>(sizes * params.size);
}

void check(const Community& community, const MeshSites& sites)
{
    if (community.species.empty() || community.species.size() > 255)
        throw InvalidParameter(
            fmt::format("moss: {} species, must be 1 to 255", community.species.size()));
    check_sites(sites);
}

template <class P>
void check(const P& individuals, const char* what, std::span<const float> fitness,
           const Community& community, const MeshSites& sites, std::int32_t day)
{
    const std::size_t n = individuals.size();
    each_array(individuals, [&](const auto& v) {
        if (v.size() != n)
            throw InvalidInput(fmt::format(
                "moss: {} {}, of which {} values are known, must be as many", n, what, v.size()));
    });
    if (fitness.size() != n)
        throw InvalidInput(
            fmt::format("moss: fitness of {} {}, must be of {}", fitness.size(), what, n));
    for (std::size_t i = 0; i < n; ++i) {
        if (individuals.species[i] >= community.species.size() ||
            individuals.site[i] >= sites.size())
            throw InvalidInput(
                fmt::format("moss: {} {}: species {}, site {}, must be below {} and {}", what, i,
                            individuals.species[i], individuals.site[i], community.species.size(),
                            sites.size()));
        if (!(fitness[i] >= 0 && fitness[i] < 1e30F)) {
            const Vec3f at = individuals.foot[i];
            throw NumericalError(fmt::format(
                "moss: day {}: fitness of {} = {} at ({:.6g}, {:.6g}, {:.6g}), must be finite and "
                ">= 0",
                day, community.species[individuals.species[i]].name, fitness[i], at.x, at.y, at.z));
        }
    }
}

/// A point of the front faces, uniform by area.
Landed anywhere(const MeshSites& sites, const ByArea& by_area, const Draws& draw,
                std::uint64_t counter)
{
    const std::size_t site = by_area(draw(counter));
    const double u = std::sqrt(draw(counter + 1)), v = draw(counter + 2);
    const auto& t = sites.mesh.triangles[site];
    const auto corner = [&](std::size_t k) { return Vec3d(sites.mesh.vertices[t[k]]); };
    return {.where = Landed::Where::Land,
            .foot = Vec3f(corner(0) * (1 - u) + corner(1) * (u * (1 - v)) + corner(2) * (u * v)),
            .normal = sites.normal[site],
            .site = static_cast<std::uint32_t>(site)};
}

/// Of each place from number `first` on, the lower numbers that are closer than a distance.
struct TooClose {
    std::vector<std::uint32_t> begin, other;

    TooClose(std::span<const Vec3f> feet, std::size_t first, float distance)
    {
        constexpr std::size_t kChunk = 512;
        struct Part {
            std::vector<std::uint32_t> count, other;
        };
        const std::size_t n = feet.size() - first;
        std::vector<Part> parts((n + kChunk - 1) / kChunk);
        const CellIndex index(feet, distance);
        parallel_for(parts.size(), [&](std::size_t p) {
            for (std::size_t i = p * kChunk; i < std::min(n, (p + 1) * kChunk); ++i) {
                const std::size_t before = parts[p].other.size();
                index.within(feet[first + i], distance, [&](std::uint32_t k, float d2) {
                    if (k < first + i && d2 < distance * distance) parts[p].other.push_back(k);
                });
                parts[p].count.push_back(
                    static_cast<std::uint32_t>(parts[p].other.size() - before));
            }
        });
        begin.reserve(n + 1);
        begin.push_back(0);
        for (const Part& part : parts) {
            for (const std::uint32_t count : part.count) begin.push_back(begin.back() + count);
            other.insert(other.end(), part.other.begin(), part.other.end());
        }
    }
    std::span<const std::uint32_t> operator[](std::size_t i) const
    {
        return std::span(other).subspan(begin[i], begin[i + 1] - begin[i]);
    }
};

/// Whether others stand all around a foot.
bool enclosed(const Plants& plants, const CellIndex& feet, std::size_t i, float radius)
{
    struct Way {
        double x, y, around;
    };
    constexpr std::size_t kMost = 64;  // more are no news
    std::array<Way, kMost> ways;
    std::size_t n = 0;
    const Vec3d at(plants.foot[i]), normal(plants.normal[i]);
    const Vec3d u = about(normal, {1, 0, 0}), v = about(normal, {0, 1, 0});
    feet.within(plants.foot[i], radius, [&](std::uint32_t k, float) {
        const Vec3d to = Vec3d(plants.foot[k]) - at;
        const double x = dot(to, u), y = dot(to, v), size = std::abs(x) + std::abs(y);
        // Those straight above or below stand in no direction.
        if (k == i || n == kMost || size < 1e-3 * double(radius)) return;
        // Grows with the angle, from 0 to 4 around the circle.
        const double around = y >= 0 ? 1 - x / size : 3 + x / size;
        ways[n++] = {x, y, around};
    });
    if (n < 5) return false;
    std::sort(ways.begin(), ways.begin() + static_cast<std::ptrdiff_t>(n),
              [](const Way& a, const Way& b) { return a.around < b.around; });
    for (std::size_t k = 0; k < n; ++k) {
        const Way &a = ways[k], &b = ways[(k + 1) % n];
        const double sine = a.x * b.y - a.y * b.x, cosine = a.x * b.x + a.y * b.y;
        const double sizes = std::sqrt((a.x * a.x + a.y * a.y) * (b.x * b.x + b.y * b.y));
        if (sine < 0 || cosine < -0.5 * sizes) return false;
    }
    return true;
}

/// Steps of one day; the order is that of day().
class Step {
public:
    Step(const Colony& colony, const Community& community, const ColonyParams& params,
         const MeshSurface& surface, const ColonyConditions& conditions)
        : colony_(colony),
          community_(community),
          params_(params),
          surface_(surface),
          conditions_(conditions),
          germination_(community),
          today_(colony.day + 1),
          statistics_{today_, std::vector<SpeciesDay>(community.species.size())}
    {
        colony_.day = today_;
    }

    DayStatistics run(Colony& result)
    {
        germinate();
        grow();
        release();
        settle();
        drop();
        const DayStatistics now = count(colony_, community_, params_);
        for (std::size_t k = 0; k < now.species.size(); ++k)
            add(statistics_.species[k], now.species[k]);
        result = std::move(colony_);
        return std::move(statistics_);
    }

private:
    /// A moss that releases seeds today.
    struct Release {
        std::uint32_t plant;
        std::uint16_t gemmae, spores;
    };
    /// A seed of today.
    struct Candidate {
        std::uint64_t parent;
        std::uint32_t number;
        std::uint8_t kind, species;
    };

    SpeciesDay& of(std::uint8_t species) { return statistics_.species[species]; }

    /// Seeds become plants behind those that are there; fitness_ goes with them.
    void germinate()
    {
        enum : std::uint8_t { Rests, Expired, Sprouts };
        Seeds& seeds = colony_.seeds;
        Plants& plants = colony_.plants;
        std::vector<std::uint8_t> verdict(seeds.size());
        parallel_for(
            seeds.size(),
            [&](std::size_t i) {
                const int age = today_ - seeds.landed[i];
                if (germination_.expired(seeds.species[i], seeds.kind[i], age))
                    verdict[i] = Expired;
                else if (germination_.sprouts(seeds.species[i], seeds.kind[i], age,
                                              double(conditions_.seeds[i])))
                    verdict[i] = Sprouts;
            },
            1024);
        fitness_.assign(conditions_.plants.begin(), conditions_.plants.end());
        std::size_t room = static_cast<std::size_t>(params_.cap);
        room -= std::min(room, plants.size());
        std::vector<std::uint8_t> keep(seeds.size());
        for (std::size_t i = 0; i < seeds.size(); ++i) {
            SpeciesDay& s = of(seeds.species[i]);
            keep[i] = verdict[i] == Rests || (verdict[i] == Sprouts && room == 0);
            s.expired += verdict[i] == Expired;
            s.refused += verdict[i] == Sprouts && room == 0;
            if (keep[i] || verdict[i] == Expired) continue;
            --room;
            ++s.germinated;
            append(plants, seeds, i);
            plants.growth.push_back(0);
            plants.growth_max.push_back(0);
            plants.born.push_back(today_);
            fitness_.push_back(conditions_.seeds[i]);
        }
        keep_only(seeds, keep);
    }

    /// Growth and death; what is released is only noted.
    void grow()
    {
        Plants& plants = colony_.plants;
        std::vector<DayOfLife> today(plants.size());
        parallel_for(
            plants.size(),
            [&](std::size_t i) {
                today[i] = live_a_day(community_.species[plants.species[i]], community_.rules,
                                      double(fitness_[i]), plants.growth[i], plants.growth_max[i]);
            },
            1024);
        std::vector<std::uint8_t> keep(plants.size());
        std::uint32_t living = 0;
        for (std::size_t i = 0; i < plants.size(); ++i) {
            keep[i] = !today[i].died;
            if (today[i].died) {
                ++of(plants.species[i]).died;
                continue;
            }
            const auto gemmae = static_cast<std::uint16_t>(std::min(today[i].gemmae, 65535));
            const auto spores =
                static_cast<std::uint16_t>(today[i].spore ? params_.spores_per_day : 0);
            if (gemmae || spores) releases_.push_back({living, gemmae, spores});
            ++living;
        }
        keep_only(plants, keep);
    }

    /// Throws the seeds, in the order in which they will get places, and lands them.
    void release()
    {
        const Plants& plants = colony_.plants;
        // None from the interior.
        const float crowd = in_sizes(kCrowd, params_);
        if (std::ranges::any_of(releases_, [](const Release& r) { return r.gemmae > 0; })) {
            const CellIndex feet(plants.foot, crowd);
            parallel_for(
                releases_.size(),
                [&](std::size_t k) {
                    if (releases_[k].gemmae && enclosed(plants, feet, releases_[k].plant, crowd))
                        releases_[k].gemmae = 0;
                },
                64);
        }
        std::ranges::sort(releases_, {}, [&](const Release& r) { return plants.id[r.plant]; });
        std::size_t gemmae = 0, spores = 0;
        for (const Release& r : releases_) {
            gemmae += r.gemmae, spores += r.spores;
            of(plants.species[r.plant]).gemmae += r.gemmae;
            of(plants.species[r.plant]).spores += r.spores;
        }
        if (gemmae + spores > kMostFlights)
            throw LimitExceeded(
                fmt::format("moss: day {}: {} seeds, must be at most {}; raise gemma_step or lower "
                            "spores_per_day",
                            today_, gemmae + spores, kMostFlights));

        std::vector<Flight> flights(gemmae + spores);
        candidates_.resize(flights.size());
        std::vector<std::size_t> gemma_at{0}, spore_at{gemmae};
        for (const Release& r : releases_) {
            gemma_at.push_back(gemma_at.back() + r.gemmae);
            spore_at.push_back(spore_at.back() + r.spores);
        }
        const double k = gemma_throw(community_.propagation, params_.size);
        parallel_for(
            releases_.size(),
            [&](std::size_t j) {
                const std::size_t i = releases_[j].plant;
                const Parent parent{plants.id[i], today_, Vec3d(plants.foot[i]),
                                    Vec3d(plants.normal[i])};
                const double wind =
                    conditions_.wind.empty() ? 0 : double(conditions_.wind[plants.site[i]]);
                for (std::uint32_t n = 0; n < releases_[j].gemmae; ++n) {
                    flights[gemma_at[j] + n] = throw_gemma(community_, parent, k, n);
                    candidates_[gemma_at[j] + n] = {parent.id, n, kGemma, plants.species[i]};
                }
                for (std::uint32_t n = 0; n < releases_[j].spores; ++n) {
                    flights[spore_at[j] + n] =
                        throw_spore(community_, parent, n, wind, conditions_.downwind);
                    candidates_[spore_at[j] + n] = {parent.id, n, kSpore, plants.species[i]};
                }
            },
            64);
        landed_ = land(flights, plants, params_, surface_,
                       adhesion(community_.propagation, params_.size));
        arrive();
    }

    /// A spore from outside, if one is due.
    void arrive()
    {
        const int interval = community_.propagation.external_interval;
        if (interval <= 0 || today_ % interval != 0) return;
        const std::uint64_t number = colony_.arrivals++;
        const auto species = static_cast<std::uint8_t>(number % community_.species.size());
        ++of(species).arrived;
        const MeshSites& sites = surface_.sites();
        landed_.push_back(anywhere(sites, ByArea(sites.area),
                                   Draws(community_.seed, kArrival, number),
                                   counter_of(today_, 0)));
        candidates_.push_back({0, static_cast<std::uint32_t>(number), kArrived, species});
    }

    double priority(std::size_t species) const { return community_.species[species].priority; }

    /// One after the other takes its place, or finds it taken.
    void settle()
    {
        using enum Landed::Where;
        Plants& plants = colony_.plants;
        Seeds& seeds = colony_.seeds;
        std::vector<std::uint32_t> down;
        for (std::uint32_t j = 0; j < landed_.size(); ++j) {
            SpeciesDay& s = of(candidates_[j].species);
            switch (landed_[j].where) {
                case Land:
                case Moss:
                    down.push_back(j);
                    break;
                case BackFace:
                    ++s.back_face;
                    break;
                case Nothing:
                    ++s.no_hit;
                    break;
                case TooHigh:
                    ++s.too_high;
                    break;
            }
        }
        if (down.empty()) return;

        // Everybody: plants, then resting seeds, then those that came down.
        const std::size_t old_seeds = plants.size(), first = old_seeds + seeds.size();
        std::vector<Vec3f> feet;
        feet.reserve(first + down.size());
        feet.insert(feet.end(), plants.foot.begin(), plants.foot.end());
        feet.insert(feet.end(), seeds.foot.begin(), seeds.foot.end());
        for (const std::uint32_t j : down) feet.push_back(landed_[j].foot);
        const TooClose too_close(feet, first, in_sizes(kApart, params_));
        auto species = [&](std::size_t i) {
            return i < old_seeds ? plants.species[i]
                   : i < first   ? seeds.species[i - old_seeds]
                                 : candidates_[down[i - first]].species;
        };
        auto strength = [&](std::size_t i) {
            return priority(species(i)) + (i < old_seeds ? double(plants.growth[i]) : 0);
        };

        std::vector<std::uint8_t> here(feet.size(), 1);
        std::vector<std::uint64_t> id(down.size());
        for (std::size_t k = 0; k < down.size(); ++k) {
            const double own = priority(species(first + k));
            const auto others = too_close[k];
            if (std::ranges::any_of(
                    others, [&](std::uint32_t i) { return here[i] && strength(i) >= own; })) {
                ++of(species(first + k)).collided;
                here[first + k] = 0;
                continue;
            }
            for (const std::uint32_t i : others) {
                if (!here[i]) continue;
                here[i] = 0;
                ++(i < old_seeds ? of(species(i)).displaced : of(species(i)).replaced);
            }
            ++of(species(first + k)).settled;
            id[k] = colony_.next_id++;
        }

        const auto seeds_here = here.begin() + static_cast<std::ptrdiff_t>(old_seeds);
        const auto down_here = here.begin() + static_cast<std::ptrdiff_t>(first);
        keep_only(plants, {here.begin(), seeds_here});
        keep_only(seeds, {seeds_here, down_here});
        for (std::size_t k = 0; k < down.size(); ++k)
            if (here[first + k]) {
                append(seeds, landed_[down[k]], candidates_[down[k]].species, id[k], today_);
                seeds.kind.push_back(std::min(candidates_[down[k]].kind, kSpore));
            }
    }

    /// The oldest seeds beyond what may rest.
    void drop()
    {
        Seeds& seeds = colony_.seeds;
        const std::size_t most = 4 * static_cast<std::size_t>(params_.cap);
        if (seeds.size() <= most) return;
        const std::size_t n = seeds.size() - most;
        for (std::size_t i = 0; i < n; ++i) ++of(seeds.species[i]).dropped;
        each_array_in_parallel(seeds, [&](auto& v) {
            v.erase(v.begin(), v.begin() + static_cast<std::ptrdiff_t>(n));
        });
    }

    Colony colony_;  // becomes the result when all has gone well
    const Community& community_;
    const ColonyParams& params_;
    const MeshSurface& surface_;
    const ColonyConditions& conditions_;
    const Germination germination_;
    const std::int32_t today_;
    DayStatistics statistics_;
    std::vector<float> fitness_;  // of plants, today's seedlings included
    std::vector<Release> releases_;
    std::vector<Candidate> candidates_;  // in order, with what became of them
    std::vector<Landed> landed_;
};

}  // namespace

void validate(const ColonyParams& params)
{
    validate_described("moss", params);
}

double moss_size(const ColonyParams& params, double growth)
{
    constexpr double kFull = 2;  // G_moss of full size
    return params.size * std::sqrt(std::clamp(growth, 0.0, kFull) / kFull);
}

Vec3d growth_axis(Vec3d normal)
{
    const Vec3d sum = normal + Vec3d(0, 0, 1);
    return dot(sum, sum) > 1e-12 ? normalized(sum) : normal;
}

Colony first_settlers(const Community& community, const ColonyParams& params,
                      const MeshSites& sites)
{
    check(community, sites);
    // Species in turn, so that all suffer alike where the cap is reached.
    const std::size_t kinds = community.species.size();
    const auto wanted = static_cast<std::uint64_t>(community.propagation.initial_count) * kinds;
    const auto count =
        static_cast<std::uint32_t>(std::min(wanted, static_cast<std::uint64_t>(params.cap)));
    const ByArea by_area(sites.area);
    std::vector<std::uint32_t> waiting(count), placed;
    std::iota(waiting.begin(), waiting.end(), 0u);
    std::vector<Landed> place(count);

    // Those that came too close to others draw again.
    constexpr std::uint64_t kRounds = 64;
    for (std::uint64_t round = 0; round < kRounds && !waiting.empty(); ++round) {
        parallel_for(
            waiting.size(),
            [&](std::size_t k) {
                const Draws draw(community.seed, kSettler, waiting[k]);
                place[waiting[k]] = anywhere(sites, by_area, draw, 3 * round);
            },
            1024);
        std::vector<Vec3f> feet;
        for (const std::uint32_t m : placed) feet.push_back(place[m].foot);
        for (const std::uint32_t m : waiting) feet.push_back(place[m].foot);
        const TooClose too_close(feet, placed.size(), in_sizes(kApart, params));
        std::vector<std::uint8_t> here(feet.size(), 1);
        std::vector<std::uint32_t> again;
        const std::size_t first = placed.size();
        for (std::size_t k = 0; k < waiting.size(); ++k) {
            if (std::ranges::any_of(too_close[k], [&](std::uint32_t i) { return here[i]; })) {
                here[first + k] = 0;
                again.push_back(waiting[k]);
            } else
                placed.push_back(waiting[k]);
        }
        waiting = std::move(again);
    }

    std::ranges::sort(placed);
    Colony colony;
    const auto growth = static_cast<float>(community.propagation.initial_growth);
    for (const std::uint32_t m : placed) {
        append(colony.plants, place[m], static_cast<std::uint8_t>(m % kinds), colony.next_id++, 0);
        colony.plants.growth.push_back(growth);
        colony.plants.growth_max.push_back(growth);
        colony.plants.born.push_back(0);
    }
    return colony;
}

std::vector<Landed> land(std::span<const Flight> seeds, const Plants& plants,
                         const ColonyParams& params, const MeshSurface& surface, double adhesion)
{
    using enum Landed::Where;
    const std::vector<Sphere> mosses = spheres(plants, params);
    const Balls balls(mosses);
    const MeshSites& sites = surface.sites();
    auto on_land = [&](const LandPoint& p) {
        return Landed{
            .where = Land, .foot = Vec3f(p.at), .normal = sites.normal[p.site], .site = p.site};
    };
    auto on_moss = [&](const BallPoint& p) {
        const std::size_t host = p.ball;
        const Vec3d normal(plants.normal[host]);
        const double height =
            double(plants.height[host]) + dot(p.at - Vec3d(plants.foot[host]), normal);
        return Landed{.where = height > kStack * params.size ? TooHigh : Moss,
                      .foot = Vec3f(p.at),
                      .normal = plants.normal[host],
                      .site = plants.site[host],
                      .host = plants.id[host],
                      .height = static_cast<float>(std::max(0.0, height))};
    };
    std::vector<Landed> result(seeds.size());
    parallel_for(
        seeds.size(),
        [&](std::size_t i) {
            const auto [at, fall] = seeds[i];
            if (const auto near = surface.closest(at, adhesion)) {
                result[i] = on_land(*near);
                return;
            }
            if (const auto near = balls.closest(at, adhesion)) {
                result[i] = on_moss(*near);
                return;
            }
            const auto ground = surface.first_hit(at, fall);
            const auto ball = balls.first_hit(at, fall);
            if (ball && (!ground || ball->distance < ground->distance))
                result[i] = on_moss(*ball);
            else if (ground && ground->front)
                result[i] = on_land(*ground);
            else
                result[i].where = ground ? BackFace : Nothing;
        },
        64);
    return result;
}

std::vector<float> fitness(const Individuals& individuals, const Community& community,
                           std::span<const float> temperature, std::span<const float> humidity,
                           const Progress& progress)
{
    // Species by species, each as one piece.
    std::vector<std::vector<std::uint32_t>> of(community.species.size());
    for (std::uint32_t i = 0; i < individuals.size(); ++i) {
        const std::uint32_t site = individuals.site[i];
        if (individuals.species[i] >= of.size() || site >= temperature.size() ||
            site >= humidity.size())
            throw InvalidInput(fmt::format(
                "moss: individual {} of species {} on site {}; there are {} species, "
                "temperature of {} sites and humidity of {}",
                i, individuals.species[i], site, of.size(), temperature.size(), humidity.size()));
        of[individuals.species[i]].push_back(i);
    }
    std::vector<float> result(individuals.size());
    for (std::size_t k = 0; k < of.size(); ++k) {
        const std::size_t n = of[k].size();
        std::vector<float> t(n), rh(n), s(n), g(n);
        parallel_for(
            n,
            [&](std::size_t j) {
                const std::uint32_t i = of[k][j];
                t[j] = temperature[individuals.site[i]];
                rh[j] = humidity[individuals.site[i]];
                s[j] = individuals.light[i];
            },
            4096);
        fitness(community.species[k], community.rules, t, rh, s, g, progress);
        for (std::size_t j = 0; j < n; ++j) result[of[k][j]] = g[j];
    }
    return result;
}

DayStatistics day(Colony& colony, const Community& community, const ColonyParams& params,
                  const MeshSurface& surface, const ColonyConditions& conditions,
                  const Progress& progress)
{
    progress.check();
    const MeshSites& sites = surface.sites();
    check(community, sites);
    check(colony.plants, "plants", conditions.plants, community, sites, colony.day + 1);
    check(colony.seeds, "seeds", conditions.seeds, community, sites, colony.day + 1);
    for (const std::uint8_t kind : colony.seeds.kind)
        if (kind != kGemma && kind != kSpore)
            throw InvalidInput(fmt::format("moss: a seed of kind {}, must be 1 or 2", kind));
    if (!conditions.wind.empty() && conditions.wind.size() != sites.size())
        throw InvalidInput(fmt::format("moss: wind at {} sites, must be at {}",
                                       conditions.wind.size(), sites.size()));
    return Step(colony, community, params, surface, conditions).run(colony);
}

DayStatistics count(const Colony& colony, const Community& community, const ColonyParams& params)
{
    DayStatistics now{colony.day, std::vector<SpeciesDay>(community.species.size())};
    for (const std::uint8_t k : colony.plants.species) ++now.species[k].living;
    for (const std::uint8_t k : colony.seeds.species) ++now.species[k].seeds;
    for (SpeciesDay& s : now.species)
        s.area = static_cast<double>(s.living) * kPacking * params.size * params.size;
    return now;
}

std::vector<Sphere> spheres(const Plants& plants, const ColonyParams& params)
{
    std::vector<Sphere> result(plants.size());
    parallel_for(
        plants.size(),
        [&](std::size_t i) {
            const double radius = moss_size(params, double(plants.growth[i])) / 2;
            result[i] = {
                Vec3f(Vec3d(plants.foot[i]) + growth_axis(Vec3d(plants.normal[i])) * radius),
                static_cast<float>(radius)};
        },
        1024);
    return result;
}

std::vector<std::uint8_t> interior(const Plants& plants, const ColonyParams& params)
{
    const float crowd = in_sizes(kCrowd, params);
    const CellIndex feet(plants.foot, crowd);
    std::vector<std::uint8_t> result(plants.size());
    parallel_for(
        plants.size(), [&](std::size_t i) { result[i] = enclosed(plants, feet, i, crowd); }, 64);
    return result;
}

std::vector<float> cover_capacity(const ColonyParams& params, const MeshSites& sites)
{
    const float radius = in_sizes(kCoverRadius, params);
    const SitePieces pieces = cut_sites(sites.mesh, sites.area, double(radius) / 3);
    const CellIndex centres(pieces.position, radius);
    std::vector<float> result(sites.size());
    parallel_for(
        sites.size(),
        [&](std::size_t i) {
            double area = 0;
            centres.within(sites.position[i], radius, [&](std::uint32_t k, float) {
                if (double(dot(sites.normal[i], sites.normal[pieces.site[k]])) >= kSameSide)
                    area += double(pieces.area[k]);
            });
            result[i] = static_cast<float>(area / (kPacking * params.size * params.size));
        },
        256);
    return result;
}

std::vector<float> cover(const Plants& plants, const ColonyParams& params, const MeshSites& sites,
                         std::span<const float> capacity)
{
    if (capacity.size() != sites.size())
        throw InvalidInput(fmt::format("moss: capacity of {} sites, must be of {}", capacity.size(),
                                       sites.size()));
    const float radius = in_sizes(kCoverRadius, params);
    const CellIndex feet(plants.foot, radius);
    std::vector<float> result(sites.size());
    parallel_for(
        sites.size(),
        [&](std::size_t i) {
            int count = 0;
            feet.within(sites.position[i], radius, [&](std::uint32_t k, float) {
                count += double(dot(sites.normal[i], plants.normal[k])) >= kSameSide;
            });
            result[i] = std::min(1.0F, static_cast<float>(count) / capacity[i]);
        },
        256);
    return result;
}

}  // namespace sekitei::moss
