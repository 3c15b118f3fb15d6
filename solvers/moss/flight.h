#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <span>
#include <tuple>
#include <vector>

#include "core/math.h"
#include "core/random.h"
#include "core/vec.h"
#include "solvers/moss/population.h"

/// What mosses on sites and individuals on meshes have in common: draws, how seeds fly, when they
/// germinate, in which order they are given places. Not for use outside solvers/moss.
namespace sekitei::moss {

constexpr std::uint8_t kGemma = 1, kSpore = 2;
constexpr std::uint8_t kArrived = 3;  // a spore from outside, until it has a place

constexpr Stream kInitial{"moss.initial"}, kGemmaStream{"moss.gemma"}, kSporeStream{"moss.spore"},
    kArrival{"moss.arrival"};

/// Draws of one individual for one purpose.
struct Draws {
    std::uint64_t key;
    Draws(std::uint64_t seed, Stream stream, std::uint64_t id)
        : key(hash2(hash2(seed, stream.id), id))
    {
    }
    double operator()(std::uint64_t counter) const { return uniform_of_key(key, counter); }
};
inline std::uint64_t counter_of(std::int32_t day, std::uint64_t draw)
{
    return (static_cast<std::uint64_t>(day) << 32) | draw;
}

/// The unit vector at a cosine from z and an azimuth u 2 pi.
inline Vec3d direction(double cosine, double u)
{
    const double sine = std::sqrt(std::max(0.0, 1 - cosine * cosine)), phi = 2 * math::kPi * u;
    return {sine * math::cos(phi), sine * math::sin(phi), cosine};
}

/// Turns v from a frame about z to one about the unit vector n [Duff2017].
inline Vec3d about(Vec3d n, Vec3d v)
{
    const double sign = std::copysign(1.0, n.z), a = -1 / (sign + n.z), b = n.x * n.y * a;
    const Vec3d s{1 + sign * n.x * n.x * a, sign * b, -sign * n.x};
    const Vec3d t{b, sign + n.y * n.y * a, -n.y};
    return s * v.x + t * v.y + n * v.z;
}

/// A moss that releases seeds today.
struct Parent {
    std::uint64_t id;
    std::int32_t day;
    Vec3d foot, normal;
};

/// B = M + k I, I uniform on the sphere [Nomura2010, eq. 3.22].
inline Flight throw_gemma(const Community& community, const Parent& parent, double k,
                          std::uint64_t number)
{
    const Draws draw(community.seed, kGemmaStream, parent.id);
    return {parent.foot + direction(1 - 2 * draw(counter_of(parent.day, 2 * number)),
                                    draw(counter_of(parent.day, 2 * number + 1))) *
                              k};
}

/// Q = M + l I_N, I_N uniform in solid angle in the cone about the normal [Nomura2010, eq. 3.23].
/// @param wind  speed [m/s]
inline Flight throw_spore(const Community& community, const Parent& parent, std::uint64_t number,
                          double wind, Vec3d downwind)
{
    constexpr double kCone = 0.70710678118654752440;  // cosine of 45 degrees
    const Propagation& p = community.propagation;
    const Draws draw(community.seed, kSporeStream, parent.id);
    const Vec3d v = direction(1 - (1 - kCone) * draw(counter_of(parent.day, 3 * number)),
                              draw(counter_of(parent.day, 3 * number + 1)));
    Vec3d n = parent.normal;
    if (p.spore_cone == SporeCone::Both && draw(counter_of(parent.day, 3 * number + 2)) < 0.5)
        n = -n;
    Flight f{parent.foot + about(n, v) * p.spore_throw};
    if (p.spore_wind) {
        const double slope = wind / p.settling_speed;
        f.fall = {downwind.x * slope, downwind.y * slope, -1};
    }
    return f;
}

/// Sites drawn by area.
class ByArea {
public:
    explicit ByArea(std::span<const float> area) : up_to_(area.size())
    {
        double sum = 0;
        for (std::size_t i = 0; i < area.size(); ++i) up_to_[i] = sum += double(area[i]);
    }
    std::size_t operator()(double u) const
    {
        const auto at = std::ranges::upper_bound(up_to_, u * up_to_.back());
        return std::min(static_cast<std::size_t>(at - up_to_.begin()), up_to_.size() - 1);
    }

private:
    std::vector<double> up_to_;
};

/// When resting seeds of a community go or germinate. Species are numbered from 0 here.
class Germination {
public:
    explicit Germination(const Community& community) : community_(community)
    {
        for (const Species& s : community.species)
            last_age_.push_back({0, last_germination_age(s, Seed::Gemma, community.rules),
                                 last_germination_age(s, Seed::Spore, community.rules)});
    }
    bool expired(std::size_t species, std::uint8_t kind, int age) const
    {
        return age > last_age_[species][kind];
    }
    bool sprouts(std::size_t species, std::uint8_t kind, int age, double fitness) const
    {
        const Species& s = community_.species[species];
        // Readiness is at most 1: most seeds in bad places are done with here.
        return fitness > s.germination_threshold &&
               germinates(s, kind == kGemma ? Seed::Gemma : Seed::Spore, community_.rules, age,
                          fitness);
    }

private:
    const Community& community_;
    std::vector<std::array<int, 3>> last_age_;  // of each species and kind
};

/// The order in which seeds of one day are given places and ids.
template <class T>
bool earlier(const T& a, const T& b)
{
    return std::tie(a.kind, a.parent, a.number) < std::tie(b.kind, b.parent, b.number);
}

/// The sum of two days.
inline void add(SpeciesDay& a, const SpeciesDay& b)
{
    a.living += b.living, a.seeds += b.seeds;
    a.germinated += b.germinated, a.died += b.died, a.displaced += b.displaced;
    a.gemmae += b.gemmae, a.spores += b.spores, a.settled += b.settled;
    a.expired += b.expired, a.replaced += b.replaced;
    a.area += b.area;
    a.arrived += b.arrived, a.back_face += b.back_face, a.no_hit += b.no_hit;
    a.too_high += b.too_high, a.collided += b.collided;
    a.dropped += b.dropped, a.refused += b.refused;
}

/// The rotation (x y z w) that turns +y to the unit vector `axis`, after a turn by `yaw` about +y.
inline std::array<float, 4> orientation(Vec3d axis, double yaw)
{
    // The half-way rotation between two unit vectors is (1 + y . axis, y x axis), scaled.
    double x = axis.z, z = -axis.x, w = 1 + axis.y;
    const double size = std::sqrt(x * x + z * z + w * w);
    if (size > 1e-6)
        x /= size, z /= size, w /= size;
    else
        x = 1, z = w = 0;  // straight down: half a turn about x
    const double s = math::sin(yaw / 2), c = math::cos(yaw / 2);
    return {static_cast<float>(x * c - z * s), static_cast<float>(w * s),
            static_cast<float>(z * c + x * s), static_cast<float>(w * c)};
}

}  // namespace sekitei::moss
