#include "solvers/tree/crown_light.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "core/error.h"
#include "core/math.h"
#include "core/parallel.h"
#include "core/random.h"
#include "solvers/tree/crown_shade.h"
#include "solvers/tree/grove.h"

namespace sekitei::tree {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::ThrowsMessage;

constexpr double kTolerance = 1e-9;

double draw(std::uint64_t what, std::uint64_t i)
{
    return uniform_of_key(hash2(7, what), i);
}

/// Every ball looks, from its centre.
Lookers all_of(const Balls& balls)
{
    Lookers lookers{balls.centre, {}};
    for (std::uint32_t i = 0; i < balls.size(); ++i) lookers.own.push_back(i);
    return lookers;
}

/// Balls in the shell of a crown, about as dense as growth keeps them; radii differ by `spread`.
Balls crown(std::size_t n, double spread = 0)
{
    Balls balls;
    const double size = 0.9 * std::sqrt(static_cast<double>(n)) + 2;
    for (std::uint64_t i = 0; i < n; ++i) {
        const double z = 1.6 * draw(1, i) - 0.6, a = 2 * math::kPi * draw(2, i);
        const double out = size * (0.75 + 0.25 * std::cbrt(draw(3, i))), s = std::sqrt(1 - z * z);
        balls.centre.emplace_back(out * s * math::cos(a), out * s * math::sin(a), out * z + 20);
        balls.radius.push_back(2 * (1 + spread * (draw(4, i) - 0.5)));
    }
    return balls;
}

/// Places apart from the balls: some belong to a ball, some to none.
Lookers scattered(const Balls& balls, std::size_t n)
{
    Lookers lookers;
    for (std::uint64_t i = 0; i < n; ++i) {
        const auto j = static_cast<std::uint32_t>(draw(5, i) * static_cast<double>(balls.size()));
        lookers.at.push_back(balls.centre[j] + Vec3d(draw(6, i) - 0.5, draw(7, i) - 0.5, 3));
        lookers.own.push_back(i % 3 == 0 ? Lookers::kNoBall : j);
    }
    return lookers;
}

std::vector<std::uint16_t> hits(const SkyPatches& sky, const Balls& balls, const Lookers& lookers,
                                Occlusion occlusion, Method method)
{
    return count_hits(sky, balls, lookers, occlusion, method, {});
}

CrownLight light_of(const Balls& balls, CrownLightParams params = {}, const SightOf& sight = {})
{
    return crown_light(sky_patches(8, 16, 3, 2), balls, all_of(balls), params, sight, {});
}

void expect_near(Vec3d found, Vec3d expected)
{
    EXPECT_NEAR(found.x, expected.x, kTolerance);
    EXPECT_NEAR(found.y, expected.y, kTolerance);
    EXPECT_NEAR(found.z, expected.z, kTolerance);
}

/// The rules in other words: angles and the half-line's nearest place to the centre. `margin` tells
/// how far the answer is from changing.
bool shades(Vec3d from, Vec3d direction, Vec3d centre, double radius, Occlusion occlusion,
            double& margin)
{
    const Vec3d d = centre - from;
    const double distance = length(d), ahead = dot(d, direction);
    margin = std::abs(distance - radius);
    const bool holds = distance <= radius;
    if (occlusion == Occlusion::Full) {
        const double nearest = length(from + direction * std::max(0.0, ahead) - centre);
        margin = std::min(margin, std::abs(nearest - radius));
        return nearest <= radius;
    }
    const double off = length(cross(d, direction));
    margin = std::min({margin, std::abs(off - radius), std::abs(ahead)});
    if (occlusion == Occlusion::Exclude && holds) return false;
    return ahead > 0 && off <= radius;
}

TEST(SkyPatches, AreThoseOfThePaper)
{
    const SkyPatches sky = sky_patches(8, 16, 3, 2);
    ASSERT_EQ(sky.size(), 128u);
    const double table[4][4] = {{0.191341716, 0.038060234, 0.980785280, 0.029892438},
                                {0.544895107, 0.108386376, 0.831469612, 0.085126460},
                                {0.815493157, 0.162211674, 0.555570233, 0.127400751},
                                {0.961939766, 0.191341716, 0.195090322, 0.150279432}};
    for (std::size_t v = 0; v < 4; ++v) {
        const auto& [x, y, z, s] = table[v];
        expect_near(sky.direction[v * 16], {x, y, z});
        expect_near(sky.direction[(7 - v) * 16], {x, y, -z});
        EXPECT_NEAR(sky.solid[v * 16], s, kTolerance);
        EXPECT_NEAR(sky.solid[(7 - v) * 16 + 5], s, kTolerance);
        EXPECT_EQ(sky.brightness[v * 16], 3);
        EXPECT_EQ(sky.brightness[(7 - v) * 16], 2);
    }
}

TEST(SkyPatches, CoverTheSphereAndMirrorEachOther)
{
    for (const auto& [rows, across] : {std::pair{2, 4}, {8, 16}, {6, 9}, {32, 3}}) {
        const SkyPatches sky = sky_patches(rows, across, 1, 0.5);
        double solid = 0;
        Vec3d sum;
        for (std::size_t p = 0; p < sky.size(); ++p) {
            solid += sky.solid[p];
            sum += sky.direction[p] * sky.solid[p];
            EXPECT_NEAR(length(sky.direction[p]), 1, 1e-15);
            if (across % 2 != 0) continue;
            const std::size_t q = sky.opposite(p);
            EXPECT_EQ(sky.opposite(q), p);
            EXPECT_EQ(sky.direction[q], -sky.direction[p]);
            EXPECT_EQ(sky.solid[q], sky.solid[p]);
        }
        EXPECT_NEAR(solid, 4 * math::kPi, 1e-12);
        EXPECT_LT(length(sum), 1e-12);
        EXPECT_NEAR(sky.open, 3 * math::kPi, 1e-12);
    }
}

TEST(SkyPatches, NameWhatIsOutOfRange)
{
    auto message = [](const std::string& text) {
        return ThrowsMessage<InvalidParameter>(HasSubstr(text));
    };
    EXPECT_THAT([] { sky_patches(7, 16, 3, 2); }, message("patch_rows = 7, must be an even"));
    EXPECT_THAT([] { sky_patches(0, 16, 3, 2); }, message("patch_rows = 0"));
    EXPECT_THAT([] { sky_patches(8, 2, 3, 2); }, message("patch_columns = 2, must be >= 3"));
    EXPECT_THAT([] { sky_patches(8, 16, -1, 2); }, message("-1 above, 2 below, must be >= 0"));
    EXPECT_THAT([] { sky_patches(8, 16, 1, std::nan("")); }, message("must be >= 0"));
    EXPECT_THAT([] { sky_patches(8, 16, 0, 0); }, message("one must be > 0"));
}

TEST(CrownLight, OfALeafAloneIsOneAndComesFromAbove)
{
    const Balls one{{{3, -2, 11}}, {2}};
    for (const auto& [rows, across, z] :
         {std::tuple{4, 8, 0.108239220}, {8, 16, 0.101959116}, {16, 32, 0.100483857}}) {
        const CrownLight light =
            crown_light(sky_patches(rows, across, 3, 2), one, all_of(one), {}, {}, {});
        EXPECT_EQ(light.light[0], 1);
        expect_near(light.mean[0], {0, 0, z});
        expect_near(light.towards[0], {0, 0, 1});
    }
}

struct Case {
    std::vector<Vec3d> balls;  // that which looks first
    int hits;
    double light;
    Vec3d mean;
    Occlusion occlusion = Occlusion::Ahead;
};

TEST(CrownLight, IsThatOfTheTables)
{
    const Vec3d a(0, 0, 0), b(3, .5, 1), c(-1, 2.5, -2), left(-.173648178, 0, 0),
        right(.173648178, 0, 0);
    const std::vector<Case> cases{
        {{{0, 0, 0}, {3, 0, 0}}, 12, 0.986377622, {-0.011972584, 0, 0.102531956}},
        {{{3, 0, 0}, {0, 0, 0}}, 12, 0.986377622, {0.011972584, 0, 0.102531956}},
        {{{0, 0, 0}, {0, 0, 2.5}}, 32, 0.982426407, {0, 0, 0.088215512}},
        {{{0, 0, 2.5}, {0, 0, 0}}, 32, 0.988284271, {0, 0, 0.113484582}},
        {{left, right}, 64, 0.95, {-0.026315789, 0, 0.101959116}},
        {{left, right}, 128, 0.9, {0, 0, 0.101959116}, Occlusion::Full},
        {{left, right}, 0, 1.0, {0, 0, 0.101959116}, Occlusion::Exclude},
        {{a, b, c}, 20, 0.981036647, {-0.007912914, -0.007054022, 0.104943723}},
        {{b, a, c}, 12, 0.988308568, {0.010003741, 0.001258307, 0.105571976}},
        {{c, a, b}, 12, 0.986700416, {-0.004900292, 0.008263374, 0.095984325}}};
    for (const Method method : {Method::Naive, Method::Sweep, Method::Bvh})
        for (const Case& test : cases) {
            const Balls balls{test.balls, std::vector<double>(test.balls.size(), 2.0)};
            const auto counted = hits(sky_patches(8, 16, 3, 2), balls, {{test.balls[0]}, {0}},
                                      test.occlusion, method);
            EXPECT_EQ(std::accumulate(counted.begin(), counted.end(), 0), test.hits);
            const CrownLight light =
                light_of(balls, {.occlusion = test.occlusion, .method = method});
            EXPECT_NEAR(light.light[0], test.light, kTolerance);
            expect_near(light.mean[0], test.mean);
            EXPECT_NEAR(length(light.towards[0]), 1, 1e-15);
        }
}

TEST(CrownLight, ComesPastWhatBlocks)
{
    const SkyPatches sky = sky_patches(8, 16, 3, 2);
    const Balls one{{{1, 2, 3}}, {2}};
    const SightOf wall = [&](std::size_t, std::size_t p) {
        return Sight{sky.direction[p].x > 0, 1};
    };
    const CrownLight dark = light_of(one, {}, wall);
    EXPECT_NEAR(dark.light[0], 0.5, kTolerance);
    expect_near(dark.mean[0], {-0.5, 0, 0.101959116});

    // A wall as bright as the lower sky, all behind a haze that lets a quarter pass.
    const SightOf hazy = [&](std::size_t, std::size_t p) {
        return Sight{sky.direction[p].x > 0, 0.25};
    };
    const CrownLight grey = light_of(one, {.blocked_light = 2}, hazy);
    EXPECT_NEAR(grey.light[0], 0.25 * (3 + 2 + 2 + 2) / 10, kTolerance);

    const SightOf box = [](std::size_t, std::size_t) { return Sight{true, 1}; };
    const CrownLight none = light_of(one, {}, box);
    EXPECT_EQ(none.light[0], 0);
    EXPECT_EQ(none.mean[0], Vec3d());
    EXPECT_EQ(none.towards[0], Vec3d());
}

TEST(CrownLight, NeedsNoDirectionWhereTheSkyIsEven)
{
    const Balls one{{{1, 2, 3}}, {2}};
    const CrownLight light = crown_light(sky_patches(8, 16, 1, 1), one, all_of(one), {}, {}, {});
    EXPECT_EQ(light.light[0], 1);
    EXPECT_LT(length(light.mean[0]), 1e-12);
    EXPECT_EQ(light.towards[0], Vec3d());
}

TEST(CrownLight, PassesClearLeavesAndNotOpaqueOnes)
{
    const Balls balls = crown(60);
    const CrownLight clear = light_of(balls, {.transmission = 1});
    for (const double l : clear.light) EXPECT_EQ(l, 1);

    // Opaque: what is left is the sky between the balls.
    const SkyPatches sky = sky_patches(8, 16, 3, 2);
    const auto counted = hits(sky, balls, all_of(balls), Occlusion::Ahead, Method::Naive);
    const CrownLight opaque = light_of(balls, {.transmission = 0});
    for (std::size_t i = 0; i < balls.size(); ++i) {
        double open = 0;
        for (std::size_t p = 0; p < sky.size(); ++p)
            if (counted[i * sky.size() + p] == 0) open += sky.brightness[p] * sky.solid[p];
        EXPECT_NEAR(opaque.light[i], open / sky.open, kTolerance);
    }
}

TEST(CrownLight, TurnsToTheBrightestPartOfTheSkyIfAsked)
{
    const SkyPatches sky = sky_patches(8, 16, 3, 2);
    const Balls balls = crown(80, 0.3);
    const CrownLightParams params{.direction = LightDirection::Brightest};
    const CrownLight light = light_of(balls, params), mean = light_of(balls);
    const auto counted = hits(sky, balls, all_of(balls), Occlusion::Ahead, Method::Naive);
    EXPECT_EQ(light.mean, mean.mean);
    EXPECT_EQ(light.light, mean.light);
    std::size_t differ = 0;
    for (std::size_t i = 0; i < balls.size(); ++i) {
        std::vector<double> around(sky.size());
        for (std::size_t p = 0; p < sky.size(); ++p)
            for (std::size_t q = 0; q < sky.size(); ++q)
                around[p] += sky.brightness[q] * std::pow(0.9, counted[i * sky.size() + q]) *
                             sky.solid[q] *
                             std::pow(std::max(0.0, dot(sky.direction[p], sky.direction[q])), 4);
        const auto best = std::max_element(around.begin(), around.end());
        const auto chosen = static_cast<std::size_t>(
            std::find(sky.direction.begin(), sky.direction.end(), light.towards[i]) -
            sky.direction.begin());
        ASSERT_LT(chosen, sky.size());
        EXPECT_NEAR(around[chosen], *best, 1e-12 * *best);
        differ += dot(light.towards[i], mean.towards[i]) < 0.9;
    }
    EXPECT_GT(differ, 10u);
}

/// Hits are those of the independent rules, but where a rounding decides.
TEST(CrownHits, AreThoseOfTheRules)
{
    for (const auto& [rows, across] : {std::pair{8, 16}, {4, 7}}) {
        const SkyPatches sky = sky_patches(rows, across, 3, 2);
        const Balls balls = crown(120, 0.8);
        Lookers lookers = scattered(balls, 60);
        const Lookers own = all_of(balls);
        lookers.at.insert(lookers.at.end(), own.at.begin(), own.at.end());
        lookers.own.insert(lookers.own.end(), own.own.begin(), own.own.end());
        for (const Occlusion rule : {Occlusion::Ahead, Occlusion::Full, Occlusion::Exclude}) {
            const auto found = hits(sky, balls, lookers, rule, Method::Sweep);
            ASSERT_EQ(found.size(), lookers.size() * sky.size());
            std::size_t total = 0;
            for (std::size_t i = 0; i < lookers.size(); ++i)
                for (std::size_t p = 0; p < sky.size(); ++p) {
                    int count = 0;
                    double nearest = 1;
                    for (std::size_t j = 0; j < balls.size(); ++j) {
                        if (j == lookers.own[i]) continue;
                        double margin = 1;
                        count += shades(lookers.at[i], sky.direction[p], balls.centre[j],
                                        balls.radius[j], rule, margin);
                        nearest = std::min(nearest, margin);
                    }
                    ASSERT_GT(nearest, 1e-10);
                    ASSERT_EQ(found[i * sky.size() + p], count) << i << ' ' << p;
                    total += static_cast<std::size_t>(count);
                }
            EXPECT_GT(2 * total, found.size());
        }
    }
}

TEST(CrownHits, OfSweepAreThoseOfAllPairs)
{
    for (const auto& [rows, across] : {std::pair{8, 16}, {4, 5}, {2, 3}})
        for (const double spread : {0.0, 1.9})
            for (const Occlusion rule : {Occlusion::Ahead, Occlusion::Full, Occlusion::Exclude}) {
                const SkyPatches sky = sky_patches(rows, across, 3, 2);
                const Balls balls = crown(700, spread);
                Lookers odd = all_of(balls);  // the same places, other balls their own
                for (std::uint32_t i = 0; i < balls.size(); ++i)
                    odd.own[i] = i % 2 == 0 ? Lookers::kNoBall : (i * 31) % 700;
                for (const Lookers& lookers : {all_of(balls), scattered(balls, 333), odd})
                    EXPECT_EQ(hits(sky, balls, lookers, rule, Method::Sweep),
                              hits(sky, balls, lookers, rule, Method::Naive));
            }
}

TEST(CrownHits, OfSweepBearDistancesAndHeaps)
{
    // Two crowns a million apart, a heap in one place, one ball far larger than all others.
    Balls balls = crown(200);
    for (std::size_t i = 100; i < 200; ++i) balls.centre[i] += Vec3d(1e6, -3e5, 2e4);
    for (int i = 0; i < 100; ++i) balls.centre.emplace_back(1, 2, 3), balls.radius.push_back(0.5);
    balls.radius[7] = 90;
    const SkyPatches sky = sky_patches(8, 16, 3, 2);
    for (const Lookers& lookers : {all_of(balls), scattered(balls, 77)})
        EXPECT_EQ(hits(sky, balls, lookers, Occlusion::Ahead, Method::Sweep),
                  hits(sky, balls, lookers, Occlusion::Ahead, Method::Naive));
}

TEST(CrownHits, OfRaysDifferOnlyWhereBallsAreGrazed)
{
    const SkyPatches sky = sky_patches(8, 16, 3, 2);
    const Balls balls = crown(500, 1.9);
    for (const Lookers& lookers : {all_of(balls), scattered(balls, 200)})
        for (const Occlusion rule : {Occlusion::Ahead, Occlusion::Full, Occlusion::Exclude}) {
            const auto pairs = hits(sky, balls, lookers, rule, Method::Naive),
                       rays = hits(sky, balls, lookers, rule, Method::Bvh);
            for (std::size_t k = 0; k < pairs.size(); ++k) {
                if (pairs[k] == rays[k]) continue;
                bool grazes = false;
                const std::size_t i = k / sky.size();
                for (std::size_t j = 0; j < balls.size(); ++j) {
                    double margin = 1;
                    shades(lookers.at[i], sky.direction[k % sky.size()], balls.centre[j],
                           balls.radius[j], rule, margin);
                    grazes |= margin < 1e-6 * balls.radius[j];
                }
                EXPECT_TRUE(grazes) << k;
            }
        }
}

TEST(CrownHits, OfBallsInOnePlaceAreNotAhead)
{
    const SkyPatches sky = sky_patches(8, 16, 3, 2);
    const Balls balls{std::vector<Vec3d>(3, {1, 2, 3}), {2, 2, 1}};
    for (const Method method : {Method::Naive, Method::Sweep, Method::Bvh})
        for (const auto& [rule, count] :
             {std::pair{Occlusion::Ahead, 0}, {Occlusion::Full, 2}, {Occlusion::Exclude, 0}})
            EXPECT_THAT(hits(sky, balls, all_of(balls), rule, method), testing::Each(count));
}

TEST(CrownHits, AreNoneWithoutBallsOrWithoutPlaces)
{
    const SkyPatches sky = sky_patches(4, 8, 3, 2);
    for (const Method method : {Method::Naive, Method::Sweep, Method::Bvh}) {
        EXPECT_THAT(hits(sky, {}, {{{1, 2, 3}}, {Lookers::kNoBall}}, Occlusion::Full, method),
                    testing::Each(0));
        EXPECT_TRUE(hits(sky, crown(3), {}, Occlusion::Full, method).empty());
        EXPECT_EQ(light_of({}, {.method = method}).light.size(), 0u);
    }
}

TEST(CrownLight, IsBitIdenticalForAnyNumberOfThreads)
{
    const Balls balls = crown(400, 0.5);
    for (const Method method : {Method::Naive, Method::Sweep, Method::Bvh, Method::Grid}) {
        auto on_threads = [&](std::size_t n) {
            const ThreadLimit limit(n);
            return light_of(balls, {.method = method});
        };
        const CrownLight one = on_threads(1), two = on_threads(2), four = on_threads(4);
        for (const CrownLight& other : {two, four}) {
            EXPECT_EQ(one.light, other.light);
            EXPECT_EQ(one.mean, other.mean);
            EXPECT_EQ(one.towards, other.towards);
        }
    }
}

/// How light by the grid differs from light by sweep.
struct Errors {
    std::vector<double> light, angle;  ///< ascending; [1], [deg]

    void add(const Balls& balls)
    {
        const CrownLight exact = light_of(balls), grid = light_of(balls, {.method = Method::Grid});
        for (std::size_t i = 0; i < balls.size(); ++i) {
            light.push_back(std::abs(grid.light[i] - exact.light[i]));
            angle.push_back(math::acos(dot(grid.towards[i], exact.towards[i])) * 180 / math::kPi);
        }
        std::sort(light.begin(), light.end());
        std::sort(angle.begin(), angle.end());
    }
    static double mean(const std::vector<double>& v)
    {
        return std::accumulate(v.begin(), v.end(), 0.0) / static_cast<double>(v.size());
    }
    static double p99(const std::vector<double>& v)
    {
        return v[static_cast<std::size_t>(0.99 * static_cast<double>(v.size()))];
    }
};

Grove table_one(std::uint64_t seed, Method method)
{
    GroveParams params;
    params.ground = false;
    params.method = method;
    return {params, {Species{}}, {Plant{}}, seed};
}

TEST(CrownGrid, ErrsLessThanThePatchesDo)
{
    std::vector<Grove> groves;
    for (const std::uint64_t seed : {1u, 2u, 3u}) groves.push_back(table_one(seed, Method::Sweep));
    for (const int generations : {10, 20, 30, 40}) {
        Errors errors;
        for (Grove& grove : groves) {
            while (grove.generation() < generations) grove.step();
            errors.add(grove.balls());
        }
        EXPECT_LE(Errors::mean(errors.light), 0.010) << generations;
        EXPECT_LE(Errors::p99(errors.light), 0.03) << generations;
        EXPECT_LE(errors.light.back(), 0.06) << generations;
        EXPECT_LE(Errors::mean(errors.angle), 4) << generations;
        EXPECT_LE(Errors::p99(errors.angle), 12) << generations;
    }
}

TEST(CrownGrid, GrowsTreesOfAsManyTips)
{
    std::size_t grid = 0, sweep = 0;
    for (std::uint64_t seed = 1; seed <= 5; ++seed) {
        for (const Method method : {Method::Grid, Method::Sweep}) {
            Grove grove = table_one(seed, method);
            grove.grow(30);
            (method == Method::Grid ? grid : sweep) += grove.tips();
        }
    }
    EXPECT_NEAR(static_cast<double>(grid) / static_cast<double>(sweep), 1, 0.1);
}

TEST(CrownGrid, CountsNearBallsByTheRule)
{
    const std::vector<Vec3d> at{{0, 0, 0}, {2.9, .5, 1}, {-1, 1.5, -2}, {.2, .1, .1}};
    const Balls balls{at, std::vector<double>(at.size(), 2.0)};
    for (const Occlusion rule : {Occlusion::Ahead, Occlusion::Full, Occlusion::Exclude}) {
        const CrownLight exact = light_of(balls, {.occlusion = rule}),
                         grid = light_of(balls, {.occlusion = rule, .method = Method::Grid});
        for (std::size_t i = 0; i < at.size(); ++i)
            EXPECT_NEAR(grid.light[i], exact.light[i], 0.005);
    }
}

TEST(CrownGrid, HoldsAllOfEachBallsVolume)
{
    // Depth summed over all directions is the sum of kappa V / distance^2, but for the balls' size.
    const SkyPatches sky = sky_patches(256, 512, 1, 1);
    const Balls balls{{{1.3, 2.2, 7.1}, {14, -20, 3.4}, {-31, 9, 12}}, {1.0, 1.7, 3.3}};
    const Vec3d at(2, 1, -9);
    const double tau = 0.7;
    const ExtinctionGrid grid(sky, balls, tau, Occlusion::Ahead, {});
    std::vector<double> share(sky.size());
    grid.shade(at, Lookers::kNoBall, share);
    double depth = 0, expected = 0;
    for (std::size_t p = 0; p < sky.size(); ++p) depth -= math::log(share[p]) * sky.solid[p];
    for (std::size_t j = 0; j < balls.size(); ++j) {
        const double r = balls.radius[j], d = length(balls.centre[j] - at),
                     kappa = -math::log(tau) / (4 * r / 3);
        expected +=
            kappa * 2 * math::kPi * (r + (r * r - d * d) / (2 * d) * math::log((d + r) / (d - r)));
    }
    EXPECT_NEAR(depth / expected, 1, 0.01);

    // Along the axis of a ball: that of its diameter, blurred by far voxels.
    const Vec3d to = normalized(balls.centre[2] - at);
    double nearest = -1, along = 0;
    for (std::size_t p = 0; p < sky.size(); ++p)
        if (dot(sky.direction[p], to) > nearest)
            nearest = dot(sky.direction[p], to), along = -math::log(share[p]);
    EXPECT_NEAR(along, -math::log(tau) * 1.5, 0.1);
}

TEST(CrownGrid, LetsAllPassWhereLeavesAreClear)
{
    const CrownLight light = light_of(crown(50), {.transmission = 1, .method = Method::Grid});
    for (const double l : light.light) EXPECT_EQ(l, 1);
}

TEST(CrownGrid, SaysThatCrownsAreTooFarApart)
{
    Balls balls = crown(10);
    balls.centre[3] += Vec3d(1e5, 1e5, 1e5);
    EXPECT_THAT([&] { light_of(balls, {.method = Method::Grid}); },
                ThrowsMessage<LimitExceeded>(
                    AllOf(HasSubstr("so far apart"), HasSubstr("method = sweep"))));
    for (Vec3d& p : balls.centre) p += Vec3d(1e10, 0, 0);
    EXPECT_THAT([&] { light_of(balls, {.method = Method::Grid}); },
                ThrowsMessage<LimitExceeded>(HasSubstr("as far out as 1")));
}

TEST(CrownLight, NamesWhatIsOutOfRange)
{
    const Balls good = crown(3);
    auto input = [](const std::string& text) {
        return ThrowsMessage<InvalidInput>(HasSubstr(text));
    };
    auto with = [&](auto change) {
        return [&good, change] {
            Balls balls = good;
            Lookers lookers = all_of(balls);
            change(balls, lookers);
            crown_light(sky_patches(4, 8, 3, 2), balls, lookers, {}, {}, {});
        };
    };
    EXPECT_THAT(with([](Balls& b, Lookers&) { b.radius.pop_back(); }),
                input("3 centres of balls with 2 radii"));
    EXPECT_THAT(with([](Balls&, Lookers& l) { l.own.pop_back(); }),
                input("3 places that look with 2 own balls"));
    EXPECT_THAT(with([](Balls& b, Lookers&) { b.radius[1] = 0; }),
                input("radius of ball 1 = 0, must be > 0"));
    EXPECT_THAT(with([](Balls& b, Lookers&) { b.radius[1] = std::nan(""); }),
                input("radius of ball 1 = nan"));
    EXPECT_THAT(with([](Balls& b, Lookers&) { b.centre[2].y = std::nan(""); }),
                input("centre of ball 2 = ("));
    EXPECT_THAT(with([](Balls&, Lookers& l) { l.at[0].z = INFINITY; }),
                input("place 0 that looks = ("));
    EXPECT_THAT(with([](Balls&, Lookers& l) { l.own[2] = 3; }),
                input("own ball of place 2 = 3, must be below 3"));

    auto parameter = [](const std::string& text) {
        return ThrowsMessage<InvalidParameter>(HasSubstr(text));
    };
    EXPECT_THAT([&] { light_of(good, {.transmission = 1.5}); },
                parameter("transmission = 1.5, must be 0 to 1"));
    EXPECT_THAT([&] { light_of(good, {.transmission = std::nan("")}); },
                parameter("transmission = nan"));
    EXPECT_THAT([&] { light_of(good, {.blocked_light = -1}); },
                parameter("blocked_light = -1, must be >= 0"));
    EXPECT_THAT([&] { light_of(good, {.transmission = 0, .method = Method::Grid}); },
                parameter("sweep"));
    EXPECT_THAT(
        [&] { hits(sky_patches(4, 8, 3, 2), good, all_of(good), Occlusion::Ahead, Method::Grid); },
        parameter("must be naive, sweep or bvh"));
}

}  // namespace
}  // namespace sekitei::tree
