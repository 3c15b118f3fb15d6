#include "solvers/light/light.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <numbers>

#include "core/error.h"
#include "core/parallel.h"
#include "core/solar_day.h"
#include "solvers/rays/embree.h"
#include "tests/support/lantern.h"
#include "tests/support/shapes.h"

namespace sekitei::light {
namespace {

using std::numbers::pi;
using testing::HasSubstr;
using testing::ThrowsMessage;

constexpr double kDegree = pi / 180;
constexpr Site kMorioka{39.70 * kDegree, 141.15 * kDegree};

struct Day {
    std::vector<sun::Moment> moments;
    sun::Radiation radiation;
};

Day day_of(int year, int month, int day, const Site& site = kMorioka)
{
    WeatherDay w;
    w.year = year;
    w.month = month;
    w.day = day;
    w.possible_sunshine = possible_sunshine(site.latitude, day_of_year(year, month, day));
    w.sunshine = 0.5 * w.possible_sunshine;
    Day d{sun::moments_of_day(year, month, day, site), {}};
    d.radiation = sun::radiation(w, site, d.moments);
    return d;
}

/// Sites that own their arrays.
struct Probes {
    std::vector<Vec3d> origin;
    std::vector<Vec3f> normal;
    std::vector<float> area;

    void add(Vec3d p, Vec3d n)
    {
        origin.push_back(p);
        normal.emplace_back(normalized(n));
        area.push_back(4e-4f);
    }
    operator Sites() const { return {origin, normal, area}; }
};

Coefficients traced(const Sites& sites, const std::vector<TriMesh>& meshes,
                    const Params& params = {}, const std::vector<RainWind>& winds = {},
                    double latitude = kMorioka.latitude)
{
    std::vector<const TriMesh*> list;
    for (const TriMesh& m : meshes) list.push_back(&m);
    return trace(sites, list, latitude, winds, params, {});
}

const std::vector<Vec3d> kManyNormals{
    {0, 0, 1},        {0, 1, 0},        {0, -1, 0},     {1, 0, 0},  {-1, 0, 0},
    {0.3, -0.5, 0.8}, {-0.7, 0.6, 0.2}, {0.2, 0.9, -1}, {0, 0, -1}, {0.5, -0.8, 0.05}};

TEST(Light, OfUnshadedPlanesIsThatOfTheFormulas)
{
    Probes probes;
    for (const Vec3d& n : kManyNormals) probes.add({3, 4, 5}, n);
    for (const int bounces : {0, 1}) {
        const Coefficients c = traced(probes, {}, {.bounces = bounces});
        for (const Day& d : {day_of(2024, 6, 21), day_of(2024, 12, 21), day_of(2024, 3, 9)}) {
            const Light light = day(c, probes, d.moments, d.radiation);
            for (std::size_t i = 0; i < probes.origin.size(); ++i) {
                const auto exact =
                    sun::light_on_plane(Vec3d(probes.normal[i]), d.moments, d.radiation, 0.2);
                EXPECT_NEAR(light.direct[i], exact.direct, 1e-3) << i;
                EXPECT_NEAR(light.sky[i], exact.sky, 1e-3) << i;
                EXPECT_NEAR(light.reflected[i], exact.ground, 1e-3) << i;
                EXPECT_FLOAT_EQ(light.total[i],
                                light.direct[i] + light.sky[i] + light.reflected[i]);
            }
        }
    }
}

TEST(Light, OfPlanesInMoriokaIsThePublishedOne)
{
    Probes probes;
    probes.add({}, {0, 0, 1});
    probes.add({}, {0, 1, 0});
    probes.add({}, {0, -1, 0});
    const Coefficients c = traced(probes, {});
    const Day june = day_of(2024, 6, 21), december = day_of(2024, 12, 21);
    const Light summer = day(c, probes, june.moments, june.radiation);
    EXPECT_NEAR(summer.total[0], 242.2, 2.4);
    EXPECT_NEAR(summer.total[1], 117.2, 1.2);
    EXPECT_NEAR(summer.direct[1], 19.3, 0.2);
    EXPECT_NEAR(summer.sky[1], 73.7, 0.7);
    EXPECT_NEAR(summer.reflected[1], 24.2, 0.2);
    EXPECT_NEAR(summer.total[2], 113.3, 1.1);
    const Light winter = day(c, probes, december.moments, december.radiation);
    EXPECT_NEAR(winter.total[2], 119.2, 1.2);
    EXPECT_NEAR(winter.direct[2], 88.7, 0.9);
}

/// A quadrilateral, seen from both sides.
TriMesh quad(Vec3d a, Vec3d b, Vec3d c, Vec3d d)
{
    TriMesh mesh;
    for (const Vec3d& p : {a, b, c, d}) mesh.vertices.emplace_back(p);
    mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
    return mesh;
}

constexpr double kFar = 1e5;

TEST(SkyView, PatchesFillTheHemisphere)
{
    for (const Sky sky : {Sky::Tregenza, Sky::Reinhart})
        for (const int split : {1, 2, 3}) {
            const Directions d =
                directions(kMorioka.latitude, {}, {.sky = sky, .sky_split = split});
            EXPECT_EQ(d.patches, sky == Sky::Tregenza ? 145 : 577);
            EXPECT_EQ(d.sky.size(), std::size_t(d.patches * split * split));
            Vec3d sum;
            double east = 0;
            for (const Directions::Part& part : d.sky) {
                sum += Vec3d(part.weight);
                east += std::max(0.0, double(part.weight.x));
                EXPECT_NEAR(length(part.centre), 1, 1e-6);
            }
            EXPECT_NEAR(sum.x, 0, 1e-5);
            EXPECT_NEAR(sum.y, 0, 1e-5);
            EXPECT_NEAR(sum.z, pi, 1e-5);
            // Where the sectors meet at north and south, what a wall sees is exact.
            if (split == 2) {
                EXPECT_NEAR(east, pi / 2, 1e-5);
            }
        }
}

TEST(SkyView, OverAHorizonIsTheCosineSquared)
{
    for (const double elevation : {24.0, 48.0}) {
        TriMesh ring;
        const int n = 720;
        const double height = 7 * std::tan(elevation * kDegree);
        for (int k = 0; k < n; ++k)
            for (const double z : {-1.0, height})
                ring.vertices.emplace_back(
                    Vec3d(2 + 7 * std::cos(2 * pi * k / n), 1 + 7 * std::sin(2 * pi * k / n), z));
        for (std::uint32_t k = 0; k < std::uint32_t(n); ++k) {
            const std::uint32_t a = 2 * k, b = 2 * ((k + 1) % std::uint32_t(n));
            ring.triangles.push_back({a, b, a + 1});
            ring.triangles.push_back({b, b + 1, a + 1});
        }
        Probes probes;
        probes.add({2, 1, 0}, {0, 0, 1});
        const double exact = std::pow(std::cos(elevation * kDegree), 2);
        for (const Sky sky : {Sky::Tregenza, Sky::Reinhart})
            EXPECT_NEAR(traced(probes, {ring}, {.sky = sky}).sky_view[0], exact, 1e-5);
    }
}

TEST(SkyView, BesideAnEndlessWallIsHalf)
{
    const TriMesh wall =
        quad({1, -kFar, -kFar}, {1, kFar, -kFar}, {1, kFar, kFar}, {1, -kFar, kFar});
    Probes probes;
    probes.add({0.9, 0.3, 0}, {0, 0, 1});
    probes.add({0.9, 0.3, 0}, {1, 0, 0});
    probes.add({0.9, 0.3, 0}, {-1, 0, 0});
    probes.add({0.9, 0.3, 0}, {0, 1, 0});
    const Coefficients c = traced(probes, {wall});
    EXPECT_NEAR(c.sky_view[0], 0.5, 1e-5);
    EXPECT_NEAR(c.sky_view[1], 0, 1e-5);
    EXPECT_NEAR(c.sky_view[2], 0.5, 1e-5);
    EXPECT_NEAR(c.sky_view[3], 0.25, 1e-5);
}

TEST(SkyView, InTheCornerOfABoxIsAQuarter)
{
    const TriMesh east =
        quad({1, -kFar, -kFar}, {1, kFar, -kFar}, {1, kFar, kFar}, {1, -kFar, kFar});
    const TriMesh north =
        quad({-kFar, 2, -kFar}, {kFar, 2, -kFar}, {kFar, 2, kFar}, {-kFar, 2, kFar});
    Probes probes;
    probes.add({0.95, 1.95, 0}, {0, 0, 1});
    probes.add({0.95, 1.95, 0}, {-1, 0, 0});
    const Coefficients c = traced(probes, {east, north});
    EXPECT_NEAR(c.sky_view[0], 0.25, 1e-5);
    EXPECT_NEAR(c.sky_view[1], 0.25, 1e-5);
}

TEST(SkyView, OfACanyonFloorIsTheSineOfItsOpening)
{
    for (const double height : {0.7, 1.5, 4.0}) {
        const TriMesh west =
            quad({-1, -kFar, -1}, {-1, kFar, -1}, {-1, kFar, height}, {-1, -kFar, height});
        const TriMesh east =
            quad({2, -kFar, -1}, {2, kFar, -1}, {2, kFar, height}, {2, -kFar, height});
        Probes probes;
        probes.add({0, 0, 0}, {0, 0, 1});
        const double exact = (1 / std::hypot(1, height) + 2 / std::hypot(2, height)) / 2;
        EXPECT_NEAR(traced(probes, {west, east}).sky_view[0], exact, 0.012) << height;
        EXPECT_NEAR(traced(probes, {west, east}, {.sky = Sky::Reinhart}).sky_view[0], exact, 0.006);
    }
}

TEST(Light, OfALanternFollowsEverySunPosition)
{
    const lantern::Body body(0.03);
    const SurfaceCells& cells = body.cells;
    const Sites sites{body.origins, cells.normal, cells.area};
    const Coefficients c = traced(sites, {body.mesh});
    EXPECT_LE(c.words() * 4, 80u);
    const rays::TriangleScene scene(body.mesh.vertices, body.mesh.triangles, "test");
    double light = 0, off = 0;
    std::size_t within = 0, all = 0;
    std::vector<double> annual(sites.size());
    constexpr int kDays = 13;
    for (int k = 0; k < kDays; ++k) {
        const Date date = date_of(day_number(2023, 1, 5) + 28 * k);
        const Day d = day_of(date.year, date.month, date.day);
        const Light found = day(c, sites, d.moments, d.radiation);
        std::vector<double> exact(sites.size());
        parallel_for(sites.size(), [&](std::size_t i) {
            for (const sun::Moment& m : d.moments) {
                const double cosine = dot(Vec3d(cells.normal[i]), m.to_sun);
                if (cosine > 0 && !scene.occluded(Vec3f(body.origins[i]), Vec3f(m.to_sun), 0, 1e9f))
                    exact[i] += d.radiation.beam_normal * m.share * cosine;
            }
        });
        for (std::size_t i = 0; i < sites.size(); ++i) {
            const double error = double(found.direct[i]) - exact[i];
            off += std::abs(error);
            light += double(found.total[i]);
            annual[i] += error / kDays;
            within += std::abs(error) <= 5;
            ++all;
        }
    }
    EXPECT_LT(off, 0.01 * light);
    EXPECT_GT(double(within) / double(all), 0.99);
    for (const double a : annual) ASSERT_LT(std::abs(a), 5);
}

/// Sites at the middles of a mesh's faces.
Probes faces_of(const TriMesh& mesh, double offset)
{
    Probes probes;
    for (const auto& t : mesh.triangles) {
        const Vec3d a(mesh.vertices[t[0]]), b(mesh.vertices[t[1]]), c(mesh.vertices[t[2]]);
        const Vec3d across = cross(b - a, c - a);
        probes.add((a + b + c) / 3.0 + normalized(across) * offset, across);
        probes.area.back() = static_cast<float>(length(across) / 2);
    }
    return probes;
}

TEST(Light, IsTheSameOnCellsAndOnFaces)
{
    auto bumps = [](Vec3d p) {
        return 0.06 * std::sin(9 * p.x) * std::sin(8 * p.y + 1) * std::sin(7 * p.z + 2);
    };
    for (const double roughness : {0.0, 1.0}) {
        const double voxel = 0.06;
        const Domain box{{21, 22, 21}, {{-0.61, -0.63, -0.1}, voxel}};
        const lantern::Body body(
            level_set_from_function(box,
                                    [&](Vec3d p) {
                                        const Vec3d q = box.transform.world(p) - Vec3d(0, 0, 0.52);
                                        return (length(q) - 0.5 + roughness * bumps(q)) / voxel;
                                    },
                                    {}, {.steepness = 3}),
            box);
        const Sites cells{body.origins, body.cells.normal, body.cells.area};
        // Marching tetrahedra look at the level set's inside as the higher side: turn its faces.
        const Probes faces = faces_of(shapes::inverted(body.mesh), 0.25 * voxel);
        const Coefficients a = traced(cells, {body.mesh}), b = traced(faces, {body.mesh});
        // The faces within each cell.
        std::vector<std::vector<std::size_t>> within(cells.size());
        parallel_for(cells.size(), [&](std::size_t i) {
            for (std::size_t k = 0; k < faces.origin.size(); ++k) {
                const Vec3d way = faces.origin[k] - body.origins[i];
                if (std::max({std::abs(way.x), std::abs(way.y), std::abs(way.z)}) < 0.6 * voxel)
                    within[i].push_back(k);
            }
        });
        double apart = 0, sum = 0;
        for (const Day& d : {day_of(2023, 6, 21), day_of(2023, 9, 23), day_of(2023, 12, 21)}) {
            const Light on_cells = day(a, cells, d.moments, d.radiation);
            const Light on_faces = day(b, faces, d.moments, d.radiation);
            for (std::size_t i = 0; i < cells.size(); ++i) {
                ASSERT_FALSE(within[i].empty());
                double light = 0, area = 0;
                for (const std::size_t k : within[i]) {
                    light += double(on_faces.total[k]) * double(faces.area[k]);
                    area += double(faces.area[k]);
                }
                apart += std::abs(light / area - double(on_cells.total[i]));
                sum += double(on_cells.total[i]);
            }
        }
        EXPECT_LT(apart / sum, 0.02) << roughness;
    }
}

TEST(Light, MirrorsBetweenTheHemispheres)
{
    auto mirrored = [](Vec3d v) { return Vec3d(v.x, -v.y, v.z); };
    Probes north, south;
    for (const Vec3d& n : kManyNormals) {
        north.add({0.1, 0.2, 0.3}, n);
        south.add(mirrored({0.1, 0.2, 0.3}), mirrored(n));
    }
    const TriMesh block = shapes::box({0.9, 0.4, 0}, {2.1, 0.9, 2.3}),
                  roof = shapes::box({-0.6, -1.4, 0.8}, {0.7, -0.4, 0.9});
    auto mirrored_mesh = [](TriMesh m) {
        for (Vec3f& v : m.vertices) v.y = -v.y;
        return m;
    };
    const Params params{.bounces = 0};
    const Coefficients a = traced(north, {block, roof}, params);
    const Coefficients b =
        traced(south, {mirrored_mesh(block), mirrored_mesh(roof)}, params, {}, -kMorioka.latitude);
    for (Day d : {day_of(2024, 6, 21), day_of(2024, 10, 3)}) {
        const Light here = day(a, north, d.moments, d.radiation);
        for (sun::Moment& m : d.moments) m.to_sun = mirrored(m.to_sun);
        const Light there = day(b, south, d.moments, d.radiation);
        for (std::size_t i = 0; i < kManyNormals.size(); ++i) {
            EXPECT_NEAR(here.direct[i], there.direct[i], 1e-3) << i;
            EXPECT_NEAR(here.sky[i], there.sky[i], 1e-3) << i;
        }
    }
}

TEST(Light, ThereIsNoneInPolarNightAndItCirclesInPolarDay)
{
    const Site site{80 * kDegree, 0.3};
    Probes probes;
    for (const Vec3d& n : kManyNormals) probes.add({}, n);
    const Coefficients c = traced(probes, {}, {}, {}, site.latitude);
    const Day night = day_of(2024, 12, 21, site), bright = day_of(2024, 6, 21, site);
    for (const float s : day(c, probes, night.moments, night.radiation).total) EXPECT_EQ(s, 0);
    const Light light = day(c, probes, bright.moments, bright.radiation);
    for (std::size_t i = 0; i < kManyNormals.size(); ++i)
        EXPECT_NEAR(
            light.direct[i],
            sun::light_on_plane(Vec3d(probes.normal[i]), bright.moments, bright.radiation, 0)
                .direct,
            1e-3);
    // The first days of light fall between the rows.
    const Day dawn = day_of(2024, 2, 26, site);
    ASSERT_FALSE(dawn.moments.empty());
    EXPECT_GT(day(c, probes, dawn.moments, dawn.radiation).direct[2], 0);
}

TEST(Light, OfAYearIsMostOnSouthWallsAndLeastOnNorthWalls)
{
    const TriMesh cube = shapes::box({-1, -1, 0}, {1, 1, 2});
    for (const double latitude : {35.0, 45.0}) {
        const Site site{latitude * kDegree, 2.4};
        Probes probes;
        probes.add({0, -1.01, 1}, {0, -1, 0});
        probes.add({1.01, 0, 1}, {1, 0, 0});
        probes.add({-1.01, 0, 1}, {-1, 0, 0});
        probes.add({0, 1.01, 1}, {0, 1, 0});
        const Coefficients c = traced(probes, {cube}, {}, {}, site.latitude);
        std::array<double, 4> sum{};
        for (int month = 1; month <= 12; ++month) {
            const Day d = day_of(2023, month, 15, site);
            const Light light = day(c, probes, d.moments, d.radiation);
            for (std::size_t i = 0; i < 4; ++i) sum[i] += double(light.total[i]);
        }
        EXPECT_GT(sum[0], 1.05 * sum[1]);
        EXPECT_NEAR(sum[1] / sum[2], 1, 0.01);
        EXPECT_GT(sum[2], 1.2 * sum[3]);
    }
}

TEST(RainExposure, OfPlanesIsTheirShareOfTheHorizontal)
{
    Probes probes;
    for (const Vec3d& n : kManyNormals) probes.add({}, n);
    const Coefficients straight = traced(probes, {}, {.rain_cone = 0});
    const Coefficients spread = traced(probes, {}, {.rain_rays = 128});
    for (std::size_t i = 0; i < kManyNormals.size(); ++i) {
        const double z = double(probes.normal[i].z);
        EXPECT_NEAR(straight.rain_exposure[i], std::max(0.0, z), 1e-6) << i;
        if (z > 0.2) {
            EXPECT_NEAR(spread.rain_exposure[i], z, 0.002) << i;
        }
    }
    EXPECT_NEAR(traced(probes, {}).rain_exposure[0], 1, 1e-6);  // exact on the level
}

TEST(RainExposure, LeansWithTheWind)
{
    Probes probes;
    probes.add({}, {-1, 0, 0});
    probes.add({}, {1, 0, 0});
    probes.add({}, {0, 0, 1});
    probes.add({}, {0, -1, 0});
    const Params params{.rain_cone = 0};
    const Coefficients west = traced(probes, {}, params, {{6, 9.0, 1}});
    EXPECT_NEAR(west.rain_exposure[0], 9.0 / 6, 1e-5);
    EXPECT_EQ(west.rain_exposure[1], 0);
    EXPECT_NEAR(west.rain_exposure[2], 1, 1e-6);
    // Three quarters of the rain from the south, the rest in a calm.
    const Coefficients mixed = traced(probes, {}, params, {{4, 3.0, 6}, {0, 0, 2}});
    EXPECT_NEAR(mixed.rain_exposure[3], 0.75 * 0.5, 1e-5);
}

TEST(RainExposure, EndsUnderARoof)
{
    const TriMesh roof = shapes::box({-2, -2, 1}, {2, 2, 1.1});
    Probes probes;
    probes.add({0, 0, 0}, {0, 0, 1});
    probes.add({-1.9, 0, 0}, {0, 0, 1});
    probes.add({-3, 0, 0}, {0, 0, 1});
    const Coefficients calm = traced(probes, {roof});
    EXPECT_EQ(calm.rain_exposure[0], 0);
    EXPECT_NEAR(calm.rain_exposure[2], 1, 1e-6);
    const Coefficients windy = traced(probes, {roof}, {}, {{6, 4, 1}});
    EXPECT_EQ(windy.rain_exposure[0], 0);
    EXPECT_GT(windy.rain_exposure[1], 0.9);
}

TEST(RainWinds, WeighDirectionsByTheirRain)
{
    std::vector<WeatherDay> days(3);
    days[0].precipitation = 2;
    days[0].wind_direction = 6;
    days[0].wind_speed = 3;
    days[1] = days[0];
    days[1].precipitation = 6;
    days[1].wind_speed = 5;
    days[2].wind_direction = 1;
    const std::vector<RainWind> winds = rain_winds(days);
    ASSERT_EQ(winds.size(), 1u);
    EXPECT_EQ(winds[0].direction, 6);
    EXPECT_DOUBLE_EQ(winds[0].speed, 4.5);
    EXPECT_DOUBLE_EQ(winds[0].weight, 8);
    EXPECT_EQ(rain_winds({}).size(), 1u);
}

TEST(ReflectedLight, OfAWallIsThatOfItsOwnDay)
{
    // Faces a high wall that faces south; below lies ground.
    const TriMesh wall = quad({-kFar, 3, 0}, {kFar, 3, 0}, {kFar, 3, kFar}, {-kFar, 3, kFar});
    Probes probes;
    probes.add({0, 2.9, 1e-6}, {0, 1, 0});
    const Params params{.albedo = 0.4, .ground_albedo = 0.1, .links = 64, .ground = 0.0};
    const Coefficients c = traced(probes, {wall}, params);
    const Day d = day_of(2024, 10, 20);
    const double lit = sun::light_on_plane({0, -1, 0}, d.moments, d.radiation, 0.1).total();
    const Light light = day(c, probes, d.moments, d.radiation);
    EXPECT_EQ(light.direct[0], 0);
    EXPECT_EQ(light.sky[0], 0);
    EXPECT_NEAR(light.reflected[0], 0.5 * 0.4 * lit + 0.5 * 0.1 * d.radiation.global, 1e-3);
}

TEST(ReflectedLight, ComesFromTheSitesThatAreSeen)
{
    // A floor of sites, and one above it that looks down.
    TriMesh floor = quad({-9, -9, 0}, {9, -9, 0}, {9, 9, 0}, {-9, 9, 0});
    Probes probes;
    for (int x = -89; x < 90; x += 2)
        for (int y = -89; y < 90; y += 2) {
            probes.add({x / 10.0, y / 10.0, 0.001}, {0, 0, 1});
            probes.area.back() = 0.04f;
        }
    probes.add({0.03, 0.04, 0.4}, {0, 0, -1});
    const Params params{.albedo = 0.5, .ground_albedo = 0, .links = 128};
    const Coefficients c = traced(probes, {floor}, params);
    const Day d = day_of(2024, 5, 2);
    const Light light = day(c, probes, d.moments, d.radiation);
    EXPECT_NEAR(light.reflected.back() / (0.5 * d.radiation.global), 1, 0.01);
    EXPECT_EQ(light.reflected.front(), 0);
    // Under an endless roof the floor is dark, whatever planes in the open get.
    const TriMesh roof =
        quad({-kFar, -kFar, 1}, {kFar, -kFar, 1}, {kFar, kFar, 1}, {-kFar, kFar, 1});
    probes.add({-8.87, -8.87, 0.1}, {0, 0, -1});
    const Coefficients shaded = traced(probes, {floor, roof}, params);
    const Light dark = day(shaded, probes, d.moments, d.radiation);
    EXPECT_NEAR(dark.reflected[probes.origin.size() - 2], 0, 0.5);
    EXPECT_NEAR(dark.reflected.back(), 0, 0.5);
}

TEST(ReflectedLight, GrowsWithEveryBounceAndConvergesToItsSum)
{
    const lantern::Body body(0.06);
    const Sites sites{body.origins, body.cells.normal, body.cells.area};
    const Day d = day_of(2024, 5, 2);
    std::vector<double> sums;
    for (int bounces = 1; bounces <= 4; ++bounces) {
        const Coefficients c = traced(sites, {body.mesh}, {.albedo = 0.6, .bounces = bounces});
        const Light light = day(c, sites, d.moments, d.radiation);
        double sum = 0;
        for (const float r : light.reflected) sum += double(r);
        sums.push_back(sum);
    }
    EXPECT_GT(sums[1] - sums[0], 0);
    EXPECT_GT(sums[2] - sums[1], 0);
    EXPECT_LT(sums[2] - sums[1], 0.6 * (sums[1] - sums[0]));
    EXPECT_LT(sums[3] - sums[2], 0.6 * (sums[2] - sums[1]));
}

TEST(Light, DoesNotReachWhatIsBuried)
{
    Probes probes;
    probes.add({0, 0, -0.1}, {0, 0.6, 0.8});
    const Day d = day_of(2024, 5, 2);
    const Coefficients c = traced(probes, {}, {.ground = 0.0});
    const Light light = day(c, probes, d.moments, d.radiation);
    EXPECT_EQ(light.total[0], 0);
    EXPECT_EQ(c.rain_exposure[0], 0);
}

void expect_same(const Coefficients& a, const Coefficients& b)
{
    EXPECT_EQ(a.bits, b.bits);
    EXPECT_EQ(a.sky_view, b.sky_view);
    EXPECT_EQ(a.rain_exposure, b.rain_exposure);
    EXPECT_EQ(a.links, b.links);
}

TEST(Light, IsTheSameOnAnyNumberOfThreads)
{
    const lantern::Body body(0.05);
    const Sites sites{body.origins, body.cells.normal, body.cells.area};
    const Day d = day_of(2024, 5, 2);
    auto on = [&](std::size_t threads) {
        const ThreadLimit limit(threads);
        const Coefficients c = traced(sites, {body.mesh}, {.bounces = 2}, {{6, 3, 1}});
        return std::pair(c, day(c, sites, d.moments, d.radiation));
    };
    const auto one = on(1), four = on(4);
    expect_same(one.first, four.first);
    EXPECT_EQ(one.second.total, four.second.total);
    EXPECT_EQ(one.second.reflected, four.second.reflected);
}

TEST(Retrace, GivesTheBitsOfAFullTrace)
{
    const lantern::Body body(0.05);
    const Sites sites{body.origins, body.cells.normal, body.cells.area};
    const TriMesh fence = shapes::box({-1.3, 0.9, 0}, {1.1, 1.0, 1.2});
    const TriMesh moved = shapes::box({-1.0, -0.8, 0}, {0.4, -0.6, 0.9});
    const std::vector<RainWind> winds{{1, 4, 1}, {5, 2, 3}};
    const Coefficients bare = traced(sites, {body.mesh}, {}, winds);
    const Coefficients fenced = traced(sites, {body.mesh, fence}, {}, winds);
    const Coefficients after = traced(sites, {moved, body.mesh}, {}, winds);
    ASSERT_NE(bare.bits, fenced.bits);
    ASSERT_NE(bare.links, fenced.links);
    const TriMesh* with_fence[] = {&body.mesh, &fence};
    const TriMesh* with_moved[] = {&body.mesh, &moved};
    const TriMesh* without[] = {&body.mesh};
    const Bounds old_box = fence.bounds(), new_box = moved.bounds();
    const Coefficients came = retrace(bare, sites, with_fence, std::span(&old_box, 1), {});
    expect_same(came, fenced);
    const Bounds both[] = {old_box, new_box};
    expect_same(retrace(came, sites, with_moved, both, {}), after);
    expect_same(retrace(came, sites, without, std::span(&old_box, 1), {}), bare);
    // Nothing is asked where nothing changed.
    expect_same(retrace(bare, sites, with_fence, {}, {}), bare);
}

TEST(Light, WordsGoToPointsAndBack)
{
    Probes probes;
    for (const Vec3d& n : kManyNormals) probes.add({}, n);
    const Coefficients c = traced(probes, {});
    Coefficients back = c;
    back.bits.clear();
    for (std::size_t w = 0; w < c.words(); ++w) {
        const std::vector<std::int32_t> word = c.word(w);
        EXPECT_EQ(word.size(), probes.origin.size());
        back.bits.insert(back.bits.end(), word.begin(), word.end());
    }
    EXPECT_EQ(back.bits, c.bits);
}

TEST(Light, NamesWhatIsWrong)
{
    Probes probes;
    probes.add({}, {0, 0, 1});
    const TriMesh none;
    EXPECT_THAT([&] { traced(probes, {}, {.links = 0}); },
                ThrowsMessage<InvalidInput>(HasSubstr("light: links = 0, must be")));
    EXPECT_THAT(
        [&] { traced(probes, {}, {}, {}, 2.0); },
        ThrowsMessage<InvalidInput>(HasSubstr("latitude = 114.592 deg, must be -90 to 90")));
    EXPECT_THAT(
        [&] {
            traced(probes, {}, {}, {{8, 1, 1}});
        },
        ThrowsMessage<InvalidInput>(HasSubstr("wind direction = 8, must be 0 to 7")));
    EXPECT_THAT(
        [&] {
            traced(probes, {}, {}, {{1, 1, 0}});
        },
        ThrowsMessage<InvalidInput>(HasSubstr("add up to 0")));
    TriMesh bad = shapes::box({0, 0, 0}, {1, 1, 1});
    bad.vertices[3].x = NAN;
    EXPECT_THAT([&] { traced(probes, {bad}); },
                ThrowsMessage<InvalidInput>(HasSubstr("light: vertex 3 is (nan")));
    const Coefficients c = traced(probes, {});
    Probes two = probes;
    two.add({}, {0, 1, 0});
    const Day d = day_of(2024, 5, 2);
    EXPECT_THAT([&] { day(c, two, d.moments, d.radiation); },
                ThrowsMessage<InvalidInput>(HasSubstr("2 sites, but the coefficients are of 1")));
    two.normal[1] = {0, 0, 0};
    EXPECT_THAT([&] { traced(two, {}); }, ThrowsMessage<InvalidInput>(HasSubstr("light: site 1")));
    EXPECT_EQ(traced(Probes(), {}).sites, 0u);

    std::atomic<bool> stop = true;
    const Progress progress({}, &stop);
    EXPECT_THROW(trace(probes, {}, 0.5, {}, {}, progress), Cancelled);
}

}  // namespace
}  // namespace sekitei::light
