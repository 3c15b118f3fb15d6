#include "solvers/moss/mesh_landing.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <map>

#include "core/error.h"
#include "core/parallel.h"
#include "tests/solvers/moss/land.h"

namespace sekitei::moss {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

constexpr Stream kAt{"test.at"}, kWay{"test.way"};

Vec3d anywhere(std::uint64_t i, Vec3d lower, Vec3d upper)
{
    return {lower.x + (upper.x - lower.x) * uniform01(3, kAt, i, 0),
            lower.y + (upper.y - lower.y) * uniform01(3, kAt, i, 1),
            lower.z + (upper.z - lower.z) * uniform01(3, kAt, i, 2)};
}
Vec3d any_way(std::uint64_t i)
{
    return direction(1 - 2 * uniform01(3, kWay, i, 0), uniform01(3, kWay, i, 1)) * 0.7;
}

struct Corners {
    Vec3d a, b, c;
    Corners(const MeshSites& s, std::size_t i)
        : a(s.mesh.vertices[s.mesh.triangles[i][0]]),
          b(s.mesh.vertices[s.mesh.triangles[i][1]]),
          c(s.mesh.vertices[s.mesh.triangles[i][2]])
    {
    }
};

/// Distance to a segment, and to a triangle by another way than the code under test: the foot of
/// the perpendicular where it lies within, else the nearest of the three sides.
double to_segment(Vec3d p, Vec3d a, Vec3d b)
{
    const double t = std::clamp(dot(p - a, b - a) / dot(b - a, b - a), 0.0, 1.0);
    return length(p - a - (b - a) * t);
}
double to_triangle(Vec3d p, const Corners& t)
{
    const Vec3d n = normalized(cross(t.b - t.a, t.c - t.a));
    const Vec3d q = p - n * dot(p - t.a, n);
    const bool within = dot(cross(t.b - t.a, q - t.a), n) >= 0 &&
                        dot(cross(t.c - t.b, q - t.b), n) >= 0 &&
                        dot(cross(t.a - t.c, q - t.c), n) >= 0;
    return within ? std::abs(dot(p - t.a, n))
                  : std::min({to_segment(p, t.a, t.b), to_segment(p, t.b, t.c),
                              to_segment(p, t.c, t.a)});
}

TEST(MeshLanding, TheClosestPointIsThatOfAllTriangles)
{
    const Land land(boulder(0.4, 3), 0.2);
    int found = 0;
    for (std::uint64_t i = 0; i < 400; ++i) {
        const Vec3d p = anywhere(i, {1, -2.5, -0.2}, {2, -1.5, 0.8});
        double best = INFINITY;
        for (std::size_t t = 0; t < land.sites.size(); ++t)
            best = std::min(best, to_triangle(p, Corners(land.sites, t)));
        const auto near = land.surface.closest(p, 0.1);
        ASSERT_EQ(near.has_value(), best <= 0.1) << i;
        if (!near) continue;
        ++found;
        EXPECT_NEAR(near->distance, best, 1e-12);
        EXPECT_NEAR(length(near->at - p), best, 1e-12);
        EXPECT_LT(to_triangle(near->at, Corners(land.sites, near->site)), 1e-12);
    }
    EXPECT_GT(found, 100);
}

TEST(MeshLanding, TheFirstHitIsThatOfAllTrianglesWithItsSide)
{
    const Land land(boulder(0.4, 3), 0.2);
    int front = 0, back = 0, none = 0;
    for (std::uint64_t i = 0; i < 600; ++i) {
        const Vec3d p = anywhere(i, {0.8, -2.7, -0.4}, {2.2, -1.3, 1.0}), way = any_way(i);
        double best = INFINITY;
        bool outwards = false;
        for (std::size_t k = 0; k < land.sites.size(); ++k) {
            const Corners t(land.sites, k);
            const Vec3d n = cross(t.b - t.a, t.c - t.a);
            const double d = dot(t.a - p, n) / dot(way, n);
            if (d < 0 || d > best || to_triangle(p + way * d, t) > 1e-9) continue;
            best = d;
            outwards = dot(way, n) <= 0;
        }
        const auto hit = land.surface.first_hit(p, way);
        ASSERT_EQ(hit.has_value(), best < INFINITY) << i;
        if (!hit) {
            ++none;
            continue;
        }
        EXPECT_NEAR(hit->distance, best, 1e-6);
        EXPECT_LT(length(hit->at - (p + way * best)), 1e-6);
        EXPECT_EQ(hit->front, outwards);
        ++(hit->front ? front : back);
    }
    EXPECT_GT(front, 50);
    EXPECT_GT(back, 50);
    EXPECT_GT(none, 50);
}

TEST(MeshLanding, AmongEquallyCloseTrianglesTheLowestNumberIsTaken)
{
    const Land land(floor_mesh(1, 1, 0.5), 0.13);
    std::map<std::uint32_t, std::vector<std::uint32_t>> around;  // triangles of each vertex
    for (std::uint32_t t = 0; t < land.sites.size(); ++t)
        for (const std::uint32_t v : land.sites.mesh.triangles[t]) around[v].push_back(t);
    for (const auto& [vertex, triangles] : around) {
        const Vec3d at(land.sites.mesh.vertices[vertex]);
        // As far as is allowed, to the last bit, which is found too.
        const auto near = land.surface.closest(at + Vec3d(0, 0, 0.25), 0.25);
        ASSERT_TRUE(near);
        EXPECT_EQ(near->site, triangles[0]);
        EXPECT_EQ(near->distance, 0.25);
        EXPECT_EQ(near->at, at);
        EXPECT_FALSE(land.surface.closest(at + Vec3d(0, 0, 0.25), std::nextafter(0.25, 0.0)));
    }
    EXPECT_GT(around.size(), 50u);
}

TEST(MeshLanding, FarFromTheOriginNothingIsMissed)
{
    TriMesh mesh = floor_mesh(1, 1, 0);
    for (Vec3f& v : mesh.vertices) v += Vec3f(4096, -8192, 512);
    const Land land(mesh, 0.05);
    for (std::uint64_t i = 0; i < 200; ++i) {
        const Vec3d p = anywhere(i, {4096.1, -8191.9, 512}, {4096.9, -8191.1, 512.006});
        const auto near = land.surface.closest(p, 0.006);
        ASSERT_TRUE(near) << i;
        EXPECT_NEAR(near->at.z, 512, 1e-12);
        const auto hit = land.surface.first_hit(p + Vec3d(0, 0, 1), {0, 0, -1});
        ASSERT_TRUE(hit);
        EXPECT_NEAR(hit->distance, p.z + 1 - 512, 1e-9);
    }
}

TEST(MeshLanding, BallsAreThoseOfAnExhaustiveSearch)
{
    std::vector<Sphere> spheres;
    for (std::uint64_t i = 0; i < 300; ++i)
        spheres.push_back({Vec3f(anywhere(i + 1000, {0, 0, 0}, {0.2, 0.2, 0.2})),
                           static_cast<float>(0.005 * uniform01(3, kAt, i, 7))});
    spheres[17] = spheres[5];  // equals
    const Balls balls(spheres);
    int near_found = 0, hit_found = 0;
    for (std::uint64_t i = 0; i < 2000; ++i) {
        const Vec3d p = anywhere(i, {-0.01, -0.01, -0.01}, {0.21, 0.21, 0.21}), way = any_way(i);
        double closest = INFINITY, first = INFINITY;
        std::uint32_t closest_ball = 0, first_ball = 0;
        for (std::uint32_t k = 0; k < spheres.size(); ++k) {
            const Vec3d c(spheres[k].centre);
            const double r = double(spheres[k].radius);
            const double d = length(p - c) - r;
            if (d < closest) closest = d, closest_ball = k;
            // The middle of the chord, then back by half of it.
            const double middle = dot(c - p, way) / dot(way, way);
            const double off = length(p + way * middle - c);
            if (off > r || d < 0) continue;
            const double t = middle - std::sqrt(r * r - off * off) / length(way);
            if (t > 0 && t < first) first = t, first_ball = k;
        }
        const auto near = balls.closest(p, 0.003);
        ASSERT_EQ(near.has_value(), closest <= 0.003);
        if (near) {
            ++near_found;
            EXPECT_EQ(near->ball, closest_ball);
            EXPECT_NEAR(near->distance, closest, 1e-15);
            EXPECT_NEAR(length(near->at - Vec3d(spheres[near->ball].centre)),
                        double(spheres[near->ball].radius), 1e-12);
        }
        const auto hit = balls.first_hit(p, way);
        ASSERT_EQ(hit.has_value(), first < INFINITY);
        if (hit) {
            ++hit_found;
            EXPECT_EQ(hit->ball, first_ball);
            EXPECT_NEAR(hit->distance, first, 1e-9);
        }
    }
    EXPECT_GT(near_found, 50);
    EXPECT_GT(hit_found, 100);
    const auto twin = balls.closest(Vec3d(spheres[5].centre), 0);
    ASSERT_TRUE(twin);
    EXPECT_EQ(twin->ball, 5u);
}

TEST(MeshLanding, NoBallsAreNoTrouble)
{
    const Balls none({});
    EXPECT_FALSE(none.closest({}, 1));
    EXPECT_FALSE(none.first_hit({}, {0, 0, -1}));
}

TEST(MeshLanding, BadInputIsNamed)
{
    MeshSites sites;
    EXPECT_THAT([&] { MeshSurface{sites}; },
                ThrowsMessage<InvalidInput>(HasSubstr("moss: the land has no sites")));
    sites = mesh_sites(floor_mesh(1, 1), 0.3, {});
    sites.area.pop_back();
    EXPECT_THAT([&] { MeshSurface{sites}; },
                ThrowsMessage<InvalidInput>(HasSubstr("areas, must be as many")));
    const std::vector<Sphere> bad{{{0, 0, 0}, 1}, {{0, NAN, 0}, 1}};
    EXPECT_THAT([&] { Balls{bad}; },
                ThrowsMessage<InvalidInput>(HasSubstr("moss: ball 1 at (0, nan, 0)")));
}

// Seeds come down ---------------------------------------------------------------------------------

using Where = Landed::Where;
const ColonyParams kParams;

Landed one(const Land& land, const Colony& colony, Vec3d at, Vec3d fall = {0, 0, -1})
{
    const Flight seed{at, fall};
    return moss::land(std::span(&seed, 1), colony.plants, kParams, land.surface, 0.0075)[0];
}

TEST(MeshLanding, NearLandASeedSticksFromEitherSide)
{
    const Land land(floor_mesh(1, 1));
    for (const double dz : {0.0074, -0.0074}) {
        const Landed at = one(land, {}, {0.3, 0.4, 0.7 + dz});
        EXPECT_EQ(at.where, Where::Land);
        EXPECT_FLOAT_EQ(at.foot.z, 0.7F);
        EXPECT_FLOAT_EQ(at.foot.x, 0.3F);
        EXPECT_EQ(at.normal, Vec3f(0, 0, 1));
        EXPECT_EQ(at.host, 0u);
        EXPECT_EQ(at.height, 0);
    }
    EXPECT_EQ(one(land, {}, {0.3, 0.4, 0.7 + 0.0076}).where, Where::Land);  // falls
    EXPECT_EQ(one(land, {}, {0.3, 0.4, 0.7 - 0.0076}).where, Where::Nothing);
    EXPECT_EQ(one(land, {}, {-0.006, 0.4, 0.7}).where, Where::Land);  // beside the rim
    EXPECT_EQ(one(land, {}, {-0.0076, 0.4, 0.7}).where, Where::Nothing);
}

TEST(MeshLanding, InsideAClosedSolidASeedDies)
{
    const Land land(shapes::box({0, 0, 0}, {0.4, 0.3, 0.2}), 0.05);
    EXPECT_EQ(one(land, {}, {0.2, 0.15, 0.1}).where, Where::BackFace);
    EXPECT_EQ(one(land, {}, {0.2, 0.15, 0.19}).where, Where::BackFace);
    EXPECT_EQ(one(land, {}, {0.2, 0.15, 0.195}).where, Where::Land);
    EXPECT_EQ(one(land, {}, {0.2, 0.15, 0.5}).where, Where::Land);
    EXPECT_EQ(one(land, {}, {0.2, 0.15, -0.02}).where, Where::Nothing);
    EXPECT_EQ(one(land, {}, {0.42, 0.15, 0.1}).where, Where::Nothing);
    // Sticks to the underside and to the wall, whose site it gets.
    for (const auto& [at, normal] :
         {std::pair{Vec3d(0.2, 0.15, -0.005), Vec3f(0, 0, -1)}, {{0.405, 0.15, 0.1}, {1, 0, 0}}}) {
        const Landed stuck = one(land, {}, at);
        EXPECT_EQ(stuck.where, Where::Land);
        EXPECT_EQ(stuck.normal, normal);
        EXPECT_EQ(land.sites.normal[stuck.site], normal);
    }
}

TEST(MeshLanding, OnTheBackOfASheetASeedDies)
{
    TriMesh mesh = floor_mesh(1, 1, 0.5);
    for (auto& t : mesh.triangles) std::swap(t[1], t[2]);  // looks down
    const Land land(mesh, 0.1);
    EXPECT_EQ(one(land, {}, {0.5, 0.5, 0.9}).where, Where::BackFace);
}

TEST(MeshLanding, AwayFromLandItSticksToTheClosestMossOrFallsOnOne)
{
    const Land land(floor_mesh(1, 1));
    Colony colony;
    plant(colony, {0.5, 0.5, 0.7}, 2);      // a ball of 5 mm, its middle 5 mm up
    plant(colony, {0.525, 0.5, 0.7}, 0.5);  // of 2.5 mm
    const Landed near = one(land, colony, {0.5, 0.5, 0.7162});
    EXPECT_EQ(near.where, Where::Moss);
    EXPECT_EQ(near.host, 1u);
    EXPECT_FLOAT_EQ(near.foot.z, 0.71F);
    EXPECT_NEAR(near.height, 0.01, 1e-7);
    // Above the small one, too far to stick to either: straight down onto it.
    const Landed fallen = one(land, colony, {0.526, 0.5, 0.74});
    EXPECT_EQ(fallen.host, 2u);
    EXPECT_NEAR(fallen.foot.z, 0.7025 + std::sqrt(0.0025 * 0.0025 - 1e-6), 1e-6);
    EXPECT_FLOAT_EQ(fallen.foot.x, 0.526F);
    EXPECT_EQ(one(land, colony, {0.51, 0.5, 0.74}).where, Where::Land);
    // Slanted past both.
    EXPECT_EQ(one(land, colony, {0.45, 0.5, 0.74}, {1.3, 0, -1}).host, 1u);
    EXPECT_EQ(one(land, colony, {0.45, 0.5, 0.74}, {3, 0, -1}).host, 0u);
}

TEST(MeshLanding, StacksOfMossEndAtThreeSizes)
{
    const Land land(floor_mesh(1, 1));
    Colony colony;
    plant(colony, {0.5, 0.5, 0.7}, 2);
    std::vector<Where> found;
    for (int storey = 1; storey <= 4; ++storey) {
        const Landed at = one(land, colony, {0.5002, 0.5, 0.9});
        found.push_back(at.where);
        if (at.where != Where::Moss) break;
        EXPECT_EQ(at.host, static_cast<std::uint64_t>(storey));
        EXPECT_NEAR(at.height, 0.01 * storey, 1e-4);
        append(colony.plants, at, 0, colony.next_id++, 0);
        for (auto* growth : {&colony.plants.growth, &colony.plants.growth_max})
            growth->push_back(2);
        colony.plants.born.push_back(0);
    }
    EXPECT_EQ(found, (std::vector{Where::Moss, Where::Moss, Where::Moss, Where::TooHigh}));
}

TEST(MeshLanding, ThreeQuartersOfTheGemmaeSurviveOnAFloorAndTheirMeanThrowIsKnown)
{
    const Land land(floor_mesh(1, 1), 0.1);
    constexpr double k = 0.015;
    constexpr std::size_t n = 40000;
    const Community community{{}, {}, {}, 77};
    std::vector<Flight> seeds;
    for (std::uint64_t i = 0; i < n; ++i)
        seeds.push_back(throw_gemma(community, {i + 1, 3, {0.5, 0.5, 0.7F}, {0, 0, 1}}, k, i % 3));
    const auto landed = moss::land(seeds, {}, kParams, land.surface, k / 2);
    double survived = 0, sum = 0;
    for (const Landed& at : landed) {
        if (at.where != Where::Land) {
            EXPECT_EQ(at.where, Where::Nothing);
            continue;
        }
        ++survived;
        sum += std::hypot(double(at.foot.x) - 0.5, double(at.foot.y) - 0.5) / k;
    }
    EXPECT_NEAR(survived / n, 0.75, 3 * std::sqrt(0.75 * 0.25 / n));
    // Variance of the sine under the survivors: 1 - E[cos^2] - mean^2.
    const double variance = 1 - (1 + 0.125) / 4.5 - 0.842469 * 0.842469;
    EXPECT_NEAR(sum / survived, 0.842469, 3 * std::sqrt(variance / survived));
}

TEST(MeshLanding, SporesFillTheirConeAboutAnyNormal)
{
    constexpr std::size_t n = 40000;
    const Vec3d normal = normalized(Vec3d(0.3, -0.8, -0.4));
    Community community{{}, {}, {}, 78};
    double cosine = 0, sine = 0, lowest = 1;
    int back = 0;
    auto each = [&](auto&& f) {
        for (std::uint64_t i = 0; i < n; ++i) {
            const Flight q = throw_spore(community, {i + 1, 12, {1, 2, 3}, normal}, i % 2, 0, {});
            const Vec3d v = (q.at - Vec3d(1, 2, 3)) / 0.30;
            f(dot(v, normal), v - normal * dot(v, normal));
        }
    };
    Vec3d aside;
    each([&](double c, Vec3d side) {
        aside += side / double(n);
        cosine += c / n;
        sine += std::sqrt(1 - c * c) / n;
        lowest = std::min(lowest, c);
    });
    EXPECT_GT(lowest, std::sqrt(0.5) - 1e-12);
    EXPECT_NEAR(cosine, 0.853553, 3 * (1 - std::sqrt(0.5)) / std::sqrt(12.0 * n));
    EXPECT_NEAR(sine, 0.487205, 3 * 0.19 / std::sqrt(n));
    community.propagation.spore_cone = SporeCone::Both;
    EXPECT_LT(length(aside), 3 * 0.53 / std::sqrt(n));
    each([&](double c, Vec3d) { back += c < 0; });
    EXPECT_NEAR(back, n / 2.0, 3 * std::sqrt(n / 4.0));
}

TEST(MeshLanding, OnABoxsEdgeSeedsGoToBothFacesAsAnExhaustiveSearchSays)
{
    const Land land(shapes::box({0, 0, 0}, {0.3, 0.3, 0.2}), 0.05);
    constexpr std::size_t n = 3000;
    const Community community{{}, {}, {}, 79};
    std::vector<Flight> seeds;
    for (std::uint64_t i = 0; i < n; ++i)
        seeds.push_back(
            throw_gemma(community, {i + 1, 3, {0.3F, 0.15, 0.2F}, {0, 0, 1}}, 0.015, 0));
    const auto landed = moss::land(seeds, {}, kParams, land.surface, 0.0075);
    int top = 0, side = 0;
    for (std::size_t i = 0; i < n; ++i) {
        const Vec3d p = seeds[i].at;
        const bool inside = p.x < 0.3 && p.z < 0.2;
        const double to_top = std::hypot(std::max(0.0, p.x - double(0.3F)), p.z - double(0.2F)),
                     to_side = std::hypot(p.x - double(0.3F), std::max(0.0, p.z - double(0.2F)));
        if (std::min(to_top, to_side) <= 0.0075) {
            ASSERT_EQ(landed[i].where, Where::Land) << i;
            if (std::abs(to_top - to_side) < 1e-9) continue;  // the rim itself: either
            const bool on_top = land.sites.normal[landed[i].site].z > 0.5F;
            EXPECT_EQ(on_top, to_top < to_side) << i;
            ++(on_top ? top : side);
        } else
            EXPECT_EQ(landed[i].where, inside               ? Where::BackFace
                                       : p.x < double(0.3F) ? Where::Land
                                                            : Where::Nothing)
                << i;
    }
    EXPECT_GT(top, 300);
    EXPECT_GT(side, 300);
}

TEST(MeshLanding, IsTheSameOnAnyNumberOfThreads)
{
    const Land land(boulder(0.3, 4), 0.05);
    const Species bryum = species_called("bryum");
    const Community community{std::span(&bryum, 1), {}, {.initial_count = 400}, 80};
    const Colony colony = first_settlers(community, kParams, land.sites);
    std::vector<Flight> seeds;
    for (std::uint64_t i = 0; i < 5000; ++i)
        seeds.push_back({anywhere(i, {1.1, -2.4, -0.1}, {1.9, -1.6, 0.7}), {0.2, -0.1, -1}});
    auto feet = [&](std::size_t threads) {
        const ThreadLimit limit(threads);
        std::vector<Vec3f> result;
        for (const Landed& at : moss::land(seeds, colony.plants, kParams, land.surface, 0.0075)) {
            result.push_back(at.foot);
            result.push_back({static_cast<float>(at.site), static_cast<float>(at.host), at.height});
        }
        return result;
    };
    EXPECT_EQ(feet(1), feet(4));
}

}  // namespace
}  // namespace sekitei::moss
