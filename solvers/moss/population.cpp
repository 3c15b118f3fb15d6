#include "solvers/moss/population.h"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>

#include "core/error.h"
#include "core/parallel.h"
#include "solvers/moss/flight.h"

namespace sekitei::moss {
namespace {

constexpr std::size_t kChunk = 1024;    // sites a task
constexpr std::size_t kFlights = 4096;  // seeds landed together

void check(const Surface& surface)
{
    const std::size_t n = surface.size();
    auto fits = [&](const char* what, std::size_t found, std::size_t expected) {
        if (found != expected)
            throw InvalidInput(
                fmt::format("moss: {} {} for {} sites, must be {}", found, what, n, expected));
    };
    fits("normals", surface.normal.size(), n);
    fits("areas", surface.area.size(), n);
    if (!surface.offset.empty()) fits("offsets", surface.offset.size(), n);
    fits("starts of neighbours", surface.neighbour_begin.size(), n + 1);
    fits("neighbours", surface.neighbour.size(), surface.neighbour_begin.back());
    if (n >= 1u << 31) throw InvalidInput(fmt::format("moss: {} sites, must be below 2^31", n));
    if (!(surface.spacing > 0))
        throw InvalidInput(fmt::format("moss: site spacing = {} m, must be > 0", surface.spacing));
}

void check_species(const Community& community)
{
    if (community.species.empty() || community.species.size() > 255)
        throw InvalidParameter(
            fmt::format("moss: {} species, must be 1 to 255", community.species.size()));
}

/// A site whose moss releases seeds today.
struct Release {
    std::uint32_t site;
    std::uint16_t gemmae;
    bool spore;
};

/// A seed that came down where it may stay.
struct Candidate {
    std::uint64_t parent;
    std::uint32_t site, number;
    std::uint8_t kind, species;
};

/// What a task found out.
struct Found {
    std::vector<SpeciesDay> species;
    std::vector<Release> releases;
    std::vector<Candidate> candidates;
};

void add(std::vector<SpeciesDay>& to, const std::vector<SpeciesDay>& from)
{
    for (std::size_t k = 0; k < to.size(); ++k) add(to[k], from[k]);
}

/// Steps of one day; the order is that of day().
class Step {
public:
    Step(Population& population, const Community& community, const Surface& surface,
         const Landing& landing, const Conditions& conditions)
        : p_(population),
          c_(community),
          surface_(surface),
          landing_(landing),
          conditions_(conditions),
          throw_(gemma_throw(community.propagation, surface.spacing)),
          adhesion_(adhesion(community.propagation, surface.spacing)),
          today_(population.day + 1),
          germination_(community),
          found_((surface.size() + kChunk - 1) / kChunk)
    {
        for (Found& f : found_) f.species.resize(community.species.size());
    }

    DayStatistics run()
    {
        p_.day = today_;
        each_chunk([&](Found& f, std::size_t i) { live(f, i); });
        parallel_for(found_.size(), [&](std::size_t k) { release(found_[k]); });
        settle();
        DayStatistics now = count(p_, c_, surface_);
        for (const Found& f : found_) add(now.species, f.species);
        update_cover(p_, surface_);
        return now;
    }

private:
    template <class F>
    void each_chunk(F&& f)
    {
        parallel_for(found_.size(), [&](std::size_t k) {
            const std::size_t end = std::min(p_.size(), (k + 1) * kChunk);
            for (std::size_t i = k * kChunk; i < end; ++i) f(found_[k], i);
        });
    }

    /// Germination, growth, death; what is released is only noted.
    void live(Found& f, std::size_t i)
    {
        if (p_.seed_kind[i]) germinate(f, i);
        if (!p_.species[i]) return;
        const std::size_t k = p_.species[i] - 1u;
        const DayOfLife today =
            live_a_day(c_.species[k], c_.rules, double(conditions_.fitness[k][i]), p_.growth[i],
                       p_.growth_max[i]);
        if (today.died) {
            ++f.species[k].died;
            clear_moss(i);
        } else if (today.gemmae || today.spore)
            f.releases.push_back({static_cast<std::uint32_t>(i),
                                  static_cast<std::uint16_t>(std::min(today.gemmae, 65535)),
                                  today.spore});
    }

    void germinate(Found& f, std::size_t i)
    {
        const std::size_t k = p_.seed_species[i] - 1u;
        const Species& s = c_.species[k];
        const int age = today_ - p_.seed_born[i];
        if (germination_.expired(k, p_.seed_kind[i], age)) {
            ++f.species[k].expired;
            clear_seed(i);
            return;
        }
        if (const std::size_t resident = p_.species[i];
            resident && s.priority <= c_.species[resident - 1].priority + double(p_.growth[i]))
            return;
        if (!germination_.sprouts(k, p_.seed_kind[i], age, double(conditions_.fitness[k][i])))
            return;
        if (p_.species[i]) ++f.species[p_.species[i] - 1u].displaced;
        ++f.species[k].germinated;
        p_.species[i] = p_.seed_species[i];
        p_.growth[i] = p_.growth_max[i] = 0;
        p_.born[i] = today_;
        p_.id[i] = p_.seed_id[i];
        clear_seed(i);
    }

    void clear_moss(std::size_t i)
    {
        p_.species[i] = 0;
        p_.growth[i] = p_.growth_max[i] = 0;
        p_.born[i] = 0;
        p_.id[i] = 0;
    }
    void clear_seed(std::size_t i)
    {
        p_.seed_kind[i] = p_.seed_species[i] = 0;
        p_.seed_born[i] = 0;
        p_.seed_id[i] = 0;
    }

    /// Throws the seeds of a chunk's parents and keeps those that land where they may stay.
    void release(Found& f)
    {
        std::vector<Flight> flights;
        std::vector<Candidate> seeds;
        auto flush = [&] {
            std::vector<std::int32_t> site(flights.size());
            landing_.land(flights, adhesion_, site);
            for (std::size_t j = 0; j < seeds.size(); ++j) {
                if (site[j] < 0) continue;
                seeds[j].site = static_cast<std::uint32_t>(site[j]);
                assert(seeds[j].site < p_.size());
                if (may_stay(seeds[j])) f.candidates.push_back(seeds[j]);
            }
            flights.clear();
            seeds.clear();
        };
        for (const Release& release : f.releases) {
            const std::size_t i = release.site;
            const Parent parent{p_.id[i], today_, surface_.foot(i), Vec3d(surface_.normal[i])};
            SpeciesDay& s = f.species[p_.species[i] - 1u];
            s.gemmae += release.gemmae;
            s.spores += release.spore;
            for (std::uint32_t n = 0; n < release.gemmae; ++n) {
                flights.push_back(throw_gemma(c_, parent, throw_, n));
                seeds.push_back({p_.id[i], 0, n, kGemma, p_.species[i]});
                if (flights.size() == kFlights) flush();
            }
            if (release.spore) {
                const double wind = conditions_.wind.empty() ? 0 : double(conditions_.wind[i]);
                flights.push_back(throw_spore(c_, parent, 0, wind, conditions_.downwind));
                seeds.push_back({p_.id[i], 0, 0, kSpore, p_.species[i]});
                if (flights.size() == kFlights) flush();
            }
        }
        flush();
    }

    double priority(std::uint8_t species) const { return c_.species[species - 1u].priority; }
    bool may_stay(const Candidate& seed) const
    {
        const std::uint8_t resident = p_.seed_species[seed.site];
        return !resident || priority(seed.species) > priority(resident);
    }

    /// The best seed of each site takes the slot; ids follow the order of seeds, not of sites.
    void settle()
    {
        std::vector<Candidate> seeds;
        for (Found& f : found_) seeds.insert(seeds.end(), f.candidates.begin(), f.candidates.end());
        arrive(seeds);
        if (seeds.empty()) return;

        constexpr std::uint32_t kNone = 0xFFFFFFFFu;
        std::vector<std::uint32_t> best(p_.size(), kNone);
        auto better = [&](const Candidate& a, const Candidate& b) {
            const double pa = priority(a.species), pb = priority(b.species);
            return pa != pb ? pa > pb : earlier(a, b);
        };
        for (std::uint32_t j = 0; j < seeds.size(); ++j) {
            std::uint32_t& b = best[seeds[j].site];
            if (b == kNone || better(seeds[j], seeds[b])) b = j;
        }
        std::vector<Candidate> winners;
        for (std::uint32_t j = 0; j < seeds.size(); ++j)
            if (best[seeds[j].site] == j) winners.push_back(seeds[j]);
        std::ranges::sort(winners, earlier<Candidate>);
        for (const Candidate& seed : winners) {
            const std::size_t i = seed.site;
            if (p_.seed_species[i]) ++found_[0].species[p_.seed_species[i] - 1u].replaced;
            ++found_[0].species[seed.species - 1u].settled;
            p_.seed_kind[i] = std::min(seed.kind, kSpore);
            p_.seed_species[i] = seed.species;
            p_.seed_born[i] = today_;
            p_.seed_id[i] = p_.next_id++;
        }
    }

    /// A spore from outside, if one is due.
    void arrive(std::vector<Candidate>& seeds)
    {
        const int interval = c_.propagation.external_interval;
        if (interval <= 0 || today_ % interval != 0 || p_.size() == 0) return;
        const auto number = static_cast<std::uint32_t>(p_.arrivals);
        const std::size_t site =
            ByArea(surface_.area)(Draws(c_.seed, kArrival, p_.arrivals)(counter_of(today_, 0)));
        const Candidate seed{0, static_cast<std::uint32_t>(site), number, kArrived,
                             static_cast<std::uint8_t>(1 + p_.arrivals % c_.species.size())};
        ++p_.arrivals;
        if (may_stay(seed)) seeds.push_back(seed);
    }

    Population& p_;
    const Community& c_;
    const Surface& surface_;
    const Landing& landing_;
    const Conditions& conditions_;
    const double throw_, adhesion_;
    const std::int32_t today_;
    const Germination germination_;
    std::vector<Found> found_;  // one a chunk
};

/// What later steps index with.
void check(const Population& p, const Community& community, const Surface& surface)
{
    const std::size_t n = surface.size();
    for (const std::size_t size :
         {p.species.size(), p.growth.size(), p.growth_max.size(), p.born.size(), p.id.size(),
          p.seed_kind.size(), p.seed_species.size(), p.seed_born.size(), p.seed_id.size(),
          p.cover.size()})
        if (size != n)
            throw InvalidInput(
                fmt::format("moss: a population on {} sites, a surface of {}", size, n));
    const std::size_t count = community.species.size();
    for (std::size_t i = 0; i < n; ++i)
        if (p.species[i] > count || p.seed_species[i] > count || p.seed_kind[i] > kSpore ||
            (p.seed_kind[i] == 0) != (p.seed_species[i] == 0))
            throw InvalidInput(
                fmt::format("moss: site {}: species {}, seed species {} of kind {}; there are {} "
                            "species and 2 kinds",
                            i, p.species[i], p.seed_species[i], p.seed_kind[i], count));
}

void check(const Community& community, const Surface& surface, const Conditions& conditions,
           std::int32_t day)
{
    const std::size_t n = surface.size();
    if (conditions.fitness.size() != community.species.size())
        throw InvalidInput(fmt::format("moss: fitness of {} species, must be of {}",
                                       conditions.fitness.size(), community.species.size()));
    if (!conditions.wind.empty() && conditions.wind.size() != n)
        throw InvalidInput(
            fmt::format("moss: wind at {} sites, must be at {}", conditions.wind.size(), n));
    for (std::size_t k = 0; k < conditions.fitness.size(); ++k) {
        const std::vector<float>& g = conditions.fitness[k];
        if (g.size() != n)
            throw InvalidInput(fmt::format("moss: fitness of {} at {} sites, must be at {}",
                                           community.species[k].name, g.size(), n));
        const int bad = parallel_fold(
            n, 16 * kChunk, 0,
            [&](std::size_t begin, std::size_t end) {
                int found = 0;
                for (std::size_t i = begin; i < end; ++i) found += !(g[i] >= 0 && g[i] < 1e30F);
                return found;
            },
            [](int a, int b) { return a + b; });
        if (bad == 0) continue;
        for (std::size_t i = 0; i < n; ++i)
            if (!(g[i] >= 0 && g[i] < 1e30F)) {
                const Vec3d at = surface.position[i];
                throw NumericalError(fmt::format(
                    "moss: day {}: fitness of {} = {} at site {} ({:.6g}, {:.6g}, {:.6g}), must be "
                    "finite and >= 0",
                    day, community.species[k].name, g[i], i, at.x, at.y, at.z));
            }
    }
}

}  // namespace

void validate(const Propagation& propagation)
{
    validate_described("moss", propagation);
}

double gemma_throw(const Propagation& propagation, double spacing)
{
    return propagation.gemma_throw.value_or(1.5 * spacing);
}

double adhesion(const Propagation& propagation, double spacing)
{
    return propagation.adhesion.value_or(gemma_throw(propagation, spacing) / 2);
}

void validate(const Community& community)
{
    check_species(community);
    for (std::size_t k = 0; k < community.species.size(); ++k) {
        validate(community.species[k]);
        for (std::size_t j = 0; j < k; ++j)
            if (community.species[j].name == community.species[k].name)
                throw InvalidParameter(
                    fmt::format("moss: two species are called {}, names must differ",
                                community.species[k].name));
    }
    validate(community.rules);
    validate(community.propagation);
}

Population::Population(std::size_t sites)
    : species(sites),
      growth(sites),
      growth_max(sites),
      born(sites),
      id(sites),
      seed_kind(sites),
      seed_species(sites),
      seed_born(sites),
      seed_id(sites),
      cover(sites)
{
}

void update_cover(Population& p, const Surface& surface)
{
    parallel_for(
        p.size(),
        [&](std::size_t i) {
            const std::size_t begin = surface.neighbour_begin[i],
                              end = surface.neighbour_begin[i + 1];
            int occupied = p.species[i] != 0;
            for (std::size_t k = begin; k < end; ++k)
                occupied += p.species[surface.neighbour[k]] != 0;
            p.cover[i] = static_cast<float>(occupied) / static_cast<float>(1 + end - begin);
        },
        kChunk);
}

Population first_settlers(const Community& community, const Surface& surface)
{
    check_species(community);
    check(surface);
    Population p(surface.size());
    if (p.size() == 0) return p;
    const ByArea by_area(surface.area);
    const auto count = static_cast<std::uint64_t>(community.propagation.initial_count);
    std::size_t free = p.size();
    for (std::size_t k = 0; k < community.species.size(); ++k)
        for (std::uint64_t n = 0; n < count && free > 0; ++n) {
            const std::uint64_t id = p.next_id++;
            const Draws draw(community.seed, kInitial, id);
            std::size_t site = by_area(draw(0));
            // Draw again while the site is taken; on a crowded surface take the next free one.
            for (std::uint64_t again = 1; again < 64 && p.species[site]; ++again)
                site = by_area(draw(again));
            while (p.species[site]) site = (site + 1) % p.size();
            p.species[site] = static_cast<std::uint8_t>(k + 1);
            p.growth[site] = p.growth_max[site] =
                static_cast<float>(community.propagation.initial_growth);
            p.id[site] = id;
            --free;
        }
    update_cover(p, surface);
    return p;
}

DayStatistics count(const Population& p, const Community& community, const Surface& surface)
{
    DayStatistics now{p.day, std::vector<SpeciesDay>(community.species.size())};
    // Chunks of fixed size, joined in order: the same sums on any number of threads.
    now.species = parallel_fold(
        p.size(), 16 * kChunk, now.species,
        [&](std::size_t begin, std::size_t end) {
            std::vector<SpeciesDay> part(community.species.size());
            for (std::size_t i = begin; i < end; ++i) {
                if (p.seed_species[i]) ++part[p.seed_species[i] - 1u].seeds;
                if (!p.species[i]) continue;
                SpeciesDay& s = part[p.species[i] - 1u];
                ++s.living;
                s.area += double(surface.area[i]);
            }
            return part;
        },
        [](std::vector<SpeciesDay> a, const std::vector<SpeciesDay>& b) {
            add(a, b);
            return a;
        });
    return now;
}

DayStatistics day(Population& population, const Community& community, const Surface& surface,
                  const Landing& landing, const Conditions& conditions, const Progress& progress)
{
    progress.check();
    check_species(community);
    check(surface);
    check(population, community, surface);
    check(community, surface, conditions, population.day + 1);
    const double sticks = adhesion(community.propagation, surface.spacing);
    if (sticks > landing.reach())
        throw InvalidParameter(
            fmt::format("moss: adhesion = {:.6g} m, must be at most {:.6g} m, as "
                        "far as distances to the surface are known",
                        sticks, landing.reach()));
    return Step(population, community, surface, landing, conditions).run();
}

}  // namespace sekitei::moss
