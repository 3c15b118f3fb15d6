#include "solvers/light/photon_map.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "core/error.h"
#include "core/mesh_sites.h"
#include "core/parallel.h"
#include "tests/support/roof.h"
#include "tests/support/shapes.h"

namespace sekitei::light {
namespace {

using std::numbers::pi;
using testing::HasSubstr;
using testing::ThrowsMessage;

/// A mesh with all that belongs to it.
struct Land {
    MeshSites sites;
    PhotonScene scene;

    Land(const TriMesh& mesh, double longest_edge, float albedo = 0.2f)
        : sites(mesh_sites(mesh, longest_edge, {})),
          scene(sites.mesh, std::vector<float>(sites.size(), albedo), 0.2, 0, {})
    {
    }
    SiteKernel kernel(const PhotonParams& params, double moss_size = 0) const
    {
        return {sites.position, sites.normal, sites.area, params, moss_size};
    }
};

Daylight overhead(double open = 150, double sky = 0)
{
    return {{{{0, 0, 1}, open}}, sky};
}

std::vector<float> totals(const Irradiance& light)
{
    std::vector<float> sums(light.size());
    for (std::size_t i = 0; i < sums.size(); ++i) sums[i] = light.total(i);
    return sums;
}

/// The light of a day on sites, and on receivers if there are any.
PhotonLight day_of(const Land& land, const Daylight& daylight, const PhotonParams& params,
                   const Receivers& receivers = {}, std::uint64_t day = 1)
{
    const SiteKernel kernel = land.kernel(params);
    const Shot shot = shoot(land.scene, daylight, params, 11, day, {});
    return light_of_day(land.scene, kernel, daylight, shot.photons, {}, receivers, params, 11, day,
                        {});
}

struct Places {
    std::vector<Vec3f> position, normal;
    void add(Vec3d p, Vec3d n)
    {
        position.emplace_back(p);
        normal.emplace_back(n);
    }
};

TEST(PhotonMap, AreaOfTheKernelIsThatOfAConeCutByTheSurface)
{
    // pi r^2 / 3 on a plane, half of it at an edge, a quarter at a corner, nothing off the surface
    // or from its other side.
    const double r = 0.1, whole = pi * r * r / 3;
    const Land cube(shapes::box({0, 0, 0}, {0.5, 0.4, 0.3}), 0.015);
    const SiteKernel kernel = cube.kernel({.photon_radius = r});
    const Vec3f up(0, 0, 1);
    auto area = [&](double x, double y, double z, Vec3f n) {
        return kernel.kernel_area(Vec3f(Vec3d(x, y, z)), n, static_cast<float>(r));
    };
    EXPECT_NEAR(area(0.25, 0.2, 0.3, up) / whole, 1, 0.01);
    EXPECT_NEAR(area(0.25, 0, 0.3, up) / whole, 0.5, 0.01);
    EXPECT_NEAR(area(0, 0, 0.3, up) / whole, 0.25, 0.01);
    EXPECT_EQ(area(0.25, 0.2, 0.3, -up), 0);
    EXPECT_EQ(area(0.25, 0.2, 0.33, up), 0);  // off the slab r / 4
    EXPECT_NEAR(area(0.25, 0.2, 0.302, up) / whole, 1, 0.01);
    EXPECT_NEAR(
        cube.kernel({.photon_radius = r}, 0.01).kernel_area({0.25f, 0.2f, 0.33f}, up, 0.1f) / whole,
        std::pow(0.95, 3), 0.35);  // 2 s = 2 cm more: within the slab
    for (std::size_t i = 0; i < 100; ++i)
        EXPECT_EQ(kernel.kernel_area()[i],
                  kernel.kernel_area(cube.sites.position[i], cube.sites.normal[i], 0.1f));
}

TEST(PhotonMap, SumsForManyPlacesAreThoseOfEachAlone)
{
    // Places that share their look at the land and places too far apart to.
    const Land ball(shapes::ball({1, 2, 3}, 0.4, 5), 1);
    for (const PhotonSearch search : {PhotonSearch::Cells, PhotonSearch::Tree})
        for (const double r : {0.02, 0.1, 0.5}) {
            const PhotonParams params{
                .photons = 20'000, .photon_radius = r, .photon_search = search};
            const SiteKernel kernel = ball.kernel(params, 0.003);
            const std::vector<float>& areas = kernel.kernel_area();
            const Shot shot = shoot(ball.scene, overhead(90, 60), params, 3, 1, {});
            const Irradiance light = PhotonMap(shot.photons, {}, kernel, params).at_sites({});
            const auto radius = static_cast<float>(r);
            for (std::size_t i = 0; i < ball.sites.size(); i += 97) {
                const Vec3f at = ball.sites.position[i], n = ball.sites.normal[i];
                EXPECT_FLOAT_EQ(areas[i], kernel.kernel_area(at, n, radius));
                double sum = 0;
                std::int32_t count = 0;
                for (const Photon& p : shot.photons) {
                    const float d2 = squared_distance(at, p.position);
                    if (d2 > radius * radius || dot(p.normal, n) < 0.5f ||
                        std::abs(dot(p.position - at, n)) > kernel.slab(radius))
                        continue;
                    sum += p.flux * (1 - std::sqrt(d2) / radius);
                    ++count;
                }
                EXPECT_EQ(light.photons[i], count);
                EXPECT_NEAR(light.total(i), sum / areas[i], 1e-5 * sum / areas[i]);
            }
        }
}

TEST(PhotonMap, SitesLargerThanTheRadiusAreCut)
{
    // Sites of 8 cm, a radius of 5 cm: as points their areas would be wrong by tens of per cent.
    const double r = 0.05, whole = pi * r * r / 3;
    const Land floor(shapes::box({0, 0, -0.2}, {1, 1, 0}), 0.08);
    const PhotonParams params{.photons = 400'000, .photon_radius = r};
    const auto& s = floor.sites;
    const Shot shot = shoot(floor.scene, overhead(), params, 5, 1, {});
    auto on_threads = [&](std::size_t n) {
        const ThreadLimit limit(n);
        const SiteKernel kernel(s.position, s.normal, s.area, params, 0, &s.mesh);
        for (std::size_t i = 0; i < s.size(); ++i) {
            const Vec3f p = s.position[i];
            if (s.normal[i].z < 0.5f ||
                std::max(std::abs(p.x - 0.5f), std::abs(p.y - 0.5f)) > 0.44f)
                continue;
            EXPECT_NEAR(kernel.kernel_area()[i] / whole, 1, 0.02) << i;
        }
        return PhotonMap(shot.photons, {}, kernel, params).at_sites({}).beam;
    };
    const std::vector<float> beam = on_threads(1);
    EXPECT_EQ(beam, on_threads(2));
    double light = 0, area = 0;
    for (std::size_t i = 0; i < s.size(); ++i) {
        const Vec3f p = s.position[i];
        if (s.normal[i].z < 0.5f || std::max(std::abs(p.x - 0.5f), std::abs(p.y - 0.5f)) > 0.44f)
            continue;
        light += static_cast<double>(beam[i]) * s.area[i];
        area += static_cast<double>(s.area[i]);
    }
    EXPECT_NEAR(light / area, 150, 1.5);
}

TEST(PhotonMap, WeighsPhotonsByDistanceWithinTheSlab)
{
    const Land floor(shapes::box({0, 0, -0.2}, {1, 1, 0}), 0.05);
    const PhotonParams params{.photon_radius = 0.2};
    const SiteKernel kernel = floor.kernel(params, 0.01);  // half a slab: 0.2 / 4 + 2 * 0.01 = 0.07
    const std::vector<Vec3f> at{{0.5f, 0.5f, 0}}, up{{0, 0, 1}};
    const std::vector<float> area = kernel.kernel_area(at, up);
    const std::vector<Vec3f> foot{{0.5f, 0.45f, 0}};
    // What one photon adds, in shares of flux / area.
    auto found = [&](const Photon& photon) {
        const PhotonMap map({&photon, 1}, {foot, up, {}}, kernel, params);
        const Irradiance light = map.at({at, up, area, {}}, {}, {});
        return std::array<float, 3>{light.beam[0] * area[0] / photon.flux,
                                    light.sky[0] * area[0] / photon.flux,
                                    light.indirect[0] * area[0] / photon.flux};
    };
    auto photon_at = [](double x, double z, Vec3d n) {
        return Photon{.position = Vec3f(Vec3d(0.5 + x, 0.5, z)), .normal = Vec3f(n), .flux = 3};
    };
    const Vec3d n(0, 0, 1), steep(std::sin(1.0), 0, std::cos(1.0)), wall(1, 0, 0);
    EXPECT_NEAR(found(photon_at(0, 0, n))[0], 1, 1e-6);
    EXPECT_NEAR(found(photon_at(0.05, 0, n))[0], 0.75, 1e-6);
    EXPECT_NEAR(found(photon_at(-0.19, 0, n))[0], 0.05, 1e-6);
    EXPECT_EQ(found(photon_at(0.21, 0, n))[0], 0);
    EXPECT_NEAR(found(photon_at(0, 0.06, n))[0], 0.7, 1e-6);
    EXPECT_NEAR(found(photon_at(0, -0.06, n))[0], 0.7, 1e-6);
    EXPECT_EQ(found(photon_at(0, 0.08, n))[0], 0);
    EXPECT_NEAR(found(photon_at(0.05, 0, steep))[0], 0.75, 1e-6);  // 57 degrees
    EXPECT_EQ(found(photon_at(0.05, 0, wall))[0], 0);
    EXPECT_EQ(found(photon_at(0, 0, -n))[0], 0);
    // From the sky, and reflected.
    Photon photon = photon_at(0, 0, n);
    photon.source = Source::Sky;
    EXPECT_THAT(found(photon), testing::ElementsAre(0, testing::FloatNear(1, 1e-6f), 0));
    photon.bounce = 1;
    EXPECT_THAT(found(photon), testing::ElementsAre(0, 0, testing::FloatNear(1, 1e-6f)));
    // On moss, wherever its ball was met, at its foot.
    photon = photon_at(0.4, 0.3, wall);
    photon.on_moss = 1;
    EXPECT_NEAR(found(photon)[0], 0.75, 1e-6);
}

TEST(PhotonMap, IsRightOnFacesEdgesAndCorners)
{
    const Land cube(shapes::box({0, 0, 0}, {1, 0.8, 0.6}), 0.02);
    Places faces, edges, corners;
    for (int i = 0; i < 8; ++i) faces.add({0.15 + 0.1 * i, 0.2 + 0.05 * i, 0.6}, {0, 0, 1});
    for (int i = 0; i < 16; ++i)
        edges.add({0.15 + 0.1 * (i % 8), i < 8 ? 0.0 : 0.8, 0.6}, {0, 0, 1});
    for (int i = 0; i < 4; ++i) corners.add({i % 2 ? 1.0 : 0.0, i / 2 ? 0.8 : 0.0, 0.6}, {0, 0, 1});
    for (const PhotonSearch search : {PhotonSearch::Cells, PhotonSearch::Tree}) {
        const PhotonParams params{.photons = 400'000, .photon_search = search};
        const SiteKernel kernel = cube.kernel(params);
        const Shot shot = shoot(cube.scene, overhead(), params, 3, 1, {});
        const PhotonMap map(shot.photons, {}, kernel, params);
        for (const Places* places : {&faces, &edges, &corners}) {
            const std::vector<float> areas = kernel.kernel_area(places->position, places->normal);
            const Irradiance light = map.at({places->position, places->normal, areas, {}}, {}, {});
            double mean = 0, photons = 0;
            for (std::size_t i = 0; i < light.size(); ++i) {
                mean += light.beam[i] / static_cast<double>(light.size());
                photons += light.photons[i];
            }
            EXPECT_NEAR(mean, 150, 3 * 150 / std::sqrt(photons * 2 / 3) + 0.01 * 150)
                << places->position.size();
        }
    }
}

TEST(PhotonMap, FollowsTheCosineOnABall)
{
    const Land ball(shapes::ball({1, 2, 3}, 0.5, 5), 1);
    const PhotonLight light = day_of(ball, overhead(), {.photons = 300'000});
    double sum = 0, expected = 0, worst = 0;
    for (std::size_t i = 0; i < ball.sites.size(); ++i) {
        const double cosine = static_cast<double>(ball.sites.normal[i].z);
        if (cosine < 0.3) continue;
        sum += light.sites.beam[i];
        expected += 150 * cosine;
        worst = std::max(worst, std::abs(light.sites.beam[i] - 150 * cosine));
    }
    EXPECT_NEAR(sum / expected, 1, 0.02);  // a kernel flattens what is round: here by 0.6 %
    EXPECT_LT(worst, 25);
}

TEST(PhotonMap, ZonesUnderARoofHaveTheirBouncedLight)
{
    const roof::Scene zones(0.06);
    const Land land(roof::mesh(), 0.06);
    const std::array<double, 5> expected{0.449, 1.56, 2.95, 5.19, 0};
    for (const PhotonEstimator estimator : {PhotonEstimator::Kernel, PhotonEstimator::Site}) {
        const PhotonLight light =
            day_of(land, overhead(90, 60), {.photons = 500'000, .photon_estimator = estimator});
        const auto indirect = zones.means(light.sites.indirect);
        for (std::size_t z = 0; z < 5; ++z)
            EXPECT_NEAR(indirect[z], expected[z], (expected[z] > 1 ? 0.07 : 0.15) * expected[z])
                << roof::kZoneNames[z];
        EXPECT_NEAR(zones.means(light.sites.beam)[roof::RoofTop], 90, 1.8);
        EXPECT_NEAR(zones.means(light.sites.sky)[roof::RoofTop], 60, 1.2);
    }
}

TEST(PhotonMap, SiteEstimateKeepsAllThatWasStored)
{
    const Land land(roof::mesh(), 0.08, 0.5f);
    const PhotonParams params{.photons = 20'000, .photon_estimator = PhotonEstimator::Site};
    const SiteKernel kernel = land.kernel(params);
    const Shot shot = shoot(land.scene, overhead(90, 60), params, 3, 1, {});
    const Irradiance light = PhotonMap(shot.photons, {}, kernel, params).at_sites({});
    double sum = 0, front = 0;
    for (std::size_t i = 0; i < land.sites.size(); ++i)
        sum += static_cast<double>(light.total(i)) * land.sites.area[i];
    for (const Photon& p : shot.photons) front += p.back ? 0 : p.flux;
    EXPECT_NEAR(sum / front, 1, 1e-6);
    EXPECT_NEAR(front / shot.ledger.stored, 1, 1e-3);  // the rest slipped into a joint
    // Equal light on all sites stays equal, at edges too.
    std::vector<double> flux(land.sites.size());
    for (std::size_t i = 0; i < flux.size(); ++i) flux[i] = 7.0 * land.sites.area[i];
    for (const float s : kernel.spread(flux)) EXPECT_NEAR(s, 7, 0.007);
}

TEST(PhotonMap, SearchesByTreeAndByCellsAgree)
{
    const Land land(roof::mesh(), 0.1, 0.5f);
    for (const int nearest : {0, 30}) {
        PhotonParams params{.photons = 30'000, .photon_nearest = nearest};
        const PhotonLight cells = day_of(land, overhead(90, 60), params);
        params.photon_search = PhotonSearch::Tree;
        const PhotonLight tree = day_of(land, overhead(90, 60), params);
        EXPECT_EQ(cells.sites.photons, tree.sites.photons);
        for (std::size_t i = 0; i < land.sites.size(); ++i)
            EXPECT_NEAR(cells.sites.total(i), tree.sites.total(i), 1e-4) << nearest;
    }
}

TEST(PhotonMap, NearestPhotonsSetTheRadius)
{
    // In bright light the 200th photon is nearer than 10 cm, in dim light farther.
    const Land land(roof::mesh(), 0.05, 0.5f);
    const PhotonParams params{.photons = 100'000, .photon_nearest = 200};
    const PhotonLight light = day_of(land, overhead(), params);
    const roof::Scene zones(0.05);
    std::size_t bright = 0;
    double sum = 0;
    for (std::size_t i = 0; i < land.sites.size(); ++i) {
        const Vec3f p = land.sites.position[i];
        if (zones.zone[i] != roof::FrontFloor || p.x < 0.2f || p.x > 1.8f || p.y < -1.8f ||
            p.y > -1.2f)
            continue;
        EXPECT_GE(light.sites.photons[i], 190);
        EXPECT_LE(light.sites.photons[i], 200);  // all of them, but for those on the other side
        ++bright;
        sum += light.sites.total(i);
    }
    ASSERT_GT(bright, 100u);
    EXPECT_NEAR(sum / static_cast<double>(bright), 150, 6);
}

TEST(PhotonMap, NoiseOfFewPhotonsIsThatOfTheirNumber)
{
    // 28 photons in a disc on open ground: 1 / sqrt(2 n / 3) = 23 %.
    const Land land(roof::mesh(), 0.05);
    const PhotonParams params{.photons = 8192};
    double sum = 0, squares = 0, photons = 0, n = 0;
    for (std::uint64_t day = 1; day <= 8; ++day) {
        const PhotonLight light = day_of(land, overhead(), params, {}, day);
        for (std::size_t i = 0; i < land.sites.size(); ++i) {
            const Vec3f p = land.sites.position[i];
            if (land.sites.normal[i].z < 0.5f || std::abs(p.z) > 1e-4f || p.y > -1.1f) continue;
            if (p.x < 0.1f || p.x > 1.9f || p.y < -1.9f) continue;
            const double s = light.sites.total(i);
            sum += s;
            squares += s * s;
            photons += light.sites.photons[i];
            ++n;
        }
    }
    const double mean = sum / n, noise = std::sqrt(squares / n - mean * mean) / mean;
    EXPECT_NEAR(mean, 150, 3);
    EXPECT_NEAR(photons / n, 28, 1.5);
    EXPECT_GT(noise, 0.20);
    EXPECT_LT(noise, 0.27);
}

TEST(PhotonMap, TheBackOfASheetDoesNotLightItsFront)
{
    TriMesh sheet = shapes::box({0, 0, 0}, {1, 1, 0.5});
    sheet.triangles = {sheet.triangles[8], sheet.triangles[9]};  // the lower face: facing down
    const Land land(sheet, 0.05);
    ASSERT_LT(land.sites.normal[0].z, -0.99f);
    for (const PhotonEstimator estimator : {PhotonEstimator::Kernel, PhotonEstimator::Site}) {
        const PhotonLight light =
            day_of(land, overhead(), {.photons = 10'000, .photon_estimator = estimator});
        for (std::size_t i = 0; i < land.sites.size(); ++i) EXPECT_EQ(light.sites.total(i), 0);
    }
}

/// A floor with balls of moss on a lattice, and the plants as receivers.
struct Garden {
    Land land;
    std::vector<Sphere> moss;
    Places feet;
    std::vector<std::uint32_t> host;
    std::vector<std::int32_t> plant;

    explicit Garden(double spacing) : land(shapes::box({0, 0, -0.1}, {0.6, 0.6, 0}), 0.02)
    {
        const double radius = 0.005;
        const int across = static_cast<int>(0.6 / spacing);
        for (int i = 0; i < across * across; ++i) {
            const Vec3d foot((i % across + 0.5) * spacing, (i / across + 0.5) * spacing, 0);
            feet.add(foot, {0, 0, 1});
            moss.push_back({Vec3f(foot + Vec3d(0, 0, radius)), static_cast<float>(radius)});
            plant.push_back(i);
            std::uint32_t best = 0;
            for (std::uint32_t j = 0; j < land.sites.size(); ++j)
                if (land.sites.normal[j].z > 0.5f &&
                    squared_distance(land.sites.position[j], feet.position.back()) <
                        squared_distance(land.sites.position[best], feet.position.back()))
                    best = j;
            host.push_back(best);
        }
        land.scene.set_moss(moss);
    }
    PhotonLight light(const PhotonParams& params, const Daylight& daylight) const
    {
        const SiteKernel kernel = land.kernel(params, 0.01);
        const std::vector<float> areas = kernel.kernel_area(feet.position, feet.normal);
        const Shot shot = shoot(land.scene, daylight, params, 5, 1, {});
        return light_of_day(land.scene, kernel, daylight, shot.photons,
                            {feet.position, feet.normal, host},
                            {feet.position, feet.normal, areas, plant}, params, 5, 1, {});
    }
};

TEST(PhotonMap, WhatHitsMossCountsWhereItStands)
{
    const Garden garden(0.012);
    for (const PhotonEstimator estimator : {PhotonEstimator::Kernel, PhotonEstimator::Site})
        for (const DirectLight direct : {DirectLight::Photons, DirectLight::Rays}) {
            const PhotonLight light = garden.light(
                {.photons = 60'000, .photon_estimator = estimator, .direct = direct}, overhead());
            double plants = 0, floor = 0, sites = 0;
            for (const float s : light.receivers.beam)
                plants += s / static_cast<double>(light.receivers.size());
            for (std::size_t i = 0; i < light.sites.size(); ++i)
                if (garden.land.sites.normal[i].z > 0.5f) {
                    floor += light.sites.beam[i];
                    ++sites;
                }
            EXPECT_NEAR(plants, 150, 4);
            EXPECT_NEAR(floor / sites, 150, 4);
        }
}

TEST(PhotonMap, NeighboursShadeAPlantInLowLight)
{
    // With the sun 20 degrees high, balls of 1 cm in rows 1.2 cm apart stand in each other's
    // shadow; those of the southern rim do not.
    const Garden garden(0.012);
    const PhotonParams params{.photons = 1000, .direct = DirectLight::Rays};
    const PhotonLight light = garden.light(params, {{fixed_sun(50, 20 * pi / 180)}, 0});
    const int across = 50;
    for (std::size_t i = 0; i < light.receivers.size(); ++i) {
        // The sine of the height varies by 1.3 % over the sun's disc.
        if (static_cast<int>(i) / across == 0)
            EXPECT_NEAR(light.receivers.beam[i], 50, 0.3) << i;
        else
            EXPECT_EQ(light.receivers.beam[i], 0) << i;
    }
}

TEST(PhotonMap, ShadowRaysSeeTheSunSharply)
{
    // 65 thousand photons against shadow rays with 1.5 million photons for what is reflected, all
    // sites: photons alone err by a tenth.
    const roof::Scene zones(0.06);
    const Land land(roof::mesh(), 0.06);
    const PhotonLight reference =
        day_of(land, overhead(), {.photons = 1'500'000, .direct = DirectLight::Rays}, {}, 9);
    auto error = [&](DirectLight direct) {
        const PhotonLight light = day_of(land, overhead(), {.photons = 65'536, .direct = direct});
        double sum = 0, all = 0;
        for (std::size_t i = 0; i < land.sites.size(); ++i) {
            sum += std::abs(light.sites.total(i) - reference.sites.total(i)) *
                   static_cast<double>(land.sites.area[i]);
            all += static_cast<double>(reference.sites.total(i)) * land.sites.area[i];
        }
        return sum / all;
    };
    EXPECT_LT(error(DirectLight::Rays), 0.02);
    EXPECT_GT(error(DirectLight::Photons), 0.05);
    const auto beam = zones.means(reference.sites.beam);
    EXPECT_NEAR(beam[roof::FrontFloor], 150, 1e-3);
    EXPECT_NEAR(beam[roof::BackFloor], 0, 1e-3);
}

TEST(PhotonMap, OfManyDaysSunsEachPlaceDrawsSome)
{
    // 4000 suns between the horizon and the zenith, in the east until noon, brighter when high; a
    // wall in the west takes the afternoon. Exact: the sum over those that the place sees.
    Daylight year;
    double open = 0, morning = 0;
    for (int k = 0; k < 4000; ++k) {
        const double angle = pi * (k + 0.5) / 4000;
        const Daylight::Beam beam{{std::cos(angle), 0, std::sin(angle)}, 0.1 * std::sin(angle)};
        year.beams.push_back(beam);
        open += beam.irradiance * std::sin(angle);
        if (angle < pi / 2) morning += beam.irradiance * std::sin(angle);
    }
    const TriMesh mesh = roof::joined({shapes::box({-1, -1, -0.1}, {1, 1, 0}),
                                       shapes::box({-1.1, -400, -0.1}, {-1.05, 400, 900})});
    const PhotonScene scene(mesh, std::vector<float>(mesh.triangles.size(), 0.2f), 0.2, 0, {});
    Places places;
    for (int i = 0; i < 400; ++i) places.add({-1 + 0.001 * i, -0.9 + 0.004 * i, 0}, {0, 0, 1});
    const Receivers receivers{places.position, places.normal, {}, {}};
    const std::vector<float> beam = beam_by_rays(scene, year, receivers, 3, 1, 0, {});
    double mean = 0;
    for (const float b : beam) {
        EXPECT_NEAR(b, morning, 0.02 * open);  // 512 rays, in order of the day
        mean += b / 400.0;
    }
    EXPECT_NEAR(mean, morning, 2e-3 * open);
}

TEST(PhotonMap, ShadowRaysSeePartOfTheSunsDisc)
{
    // Under the edge of a plate 10 m up: visible at t radii of the disc from the edge is the part
    // 1/2 + (t sqrt(1 - t^2) + asin t) / pi.
    const double height = 10, disc = height * std::tan(0.2665 * pi / 180);
    const TriMesh mesh = roof::joined({shapes::box({-1, -1, -0.1}, {1, 1, 0}),
                                       shapes::box({-4, -4, height}, {0, 4, height + 0.001})});
    const PhotonScene scene(mesh, std::vector<float>(mesh.triangles.size(), 0.2f), 0.2, 0, {});
    for (const double t : {-1.05, -0.5, 0.0, 0.5, 1.05}) {
        Places places;
        for (int i = 0; i < 10000; ++i) places.add({t * disc, -0.9 + 1.8e-4 * i, 0}, {0, 0, 1});
        const Receivers receivers{places.position, places.normal, {}, {}};
        auto on_threads = [&](std::size_t n) {
            const ThreadLimit limit(n);
            return beam_by_rays(scene, overhead(), receivers, 3, 1, 0, {});
        };
        const std::vector<float> beam = on_threads(1);
        EXPECT_EQ(beam, on_threads(2));
        const double s = std::clamp(t, -1.0, 1.0);
        const double expected = 150 * (0.5 + (s * std::sqrt(1 - s * s) + std::asin(s)) / pi);
        double mean = 0;
        std::size_t partly = 0;
        for (const float b : beam) {
            mean += b / 10000.0;
            partly += b > 1 && b < 149;
        }
        EXPECT_NEAR(mean, expected, 0.02 * expected + 1e-3) << t;
        EXPECT_EQ(partly > 9000, std::abs(t) < 1) << t;
    }
}

TEST(PhotonMap, GatheringFindsDimLightWithFewPhotons)
{
    const roof::Scene zones(0.06);
    const Land land(roof::mesh(), 0.06);
    const PhotonParams params{.photons = 65'536, .direct = DirectLight::Rays, .final_gather = true};
    std::array<double, 5> mean{};
    const int days = 2;
    for (std::uint64_t day = 1; day <= days; ++day) {
        const PhotonLight light = day_of(land, overhead(), params, {}, day);
        const auto indirect = zones.means(light.sites.indirect);
        for (std::size_t z = 0; z < 5; ++z) mean[z] += indirect[z] / days;
        EXPECT_NEAR(indirect[roof::BackFloor], 0.226, 0.10 * 0.226) << day;
    }
    EXPECT_NEAR(mean[roof::FrontFloor], 0.11, 0.10 * 0.11);
    EXPECT_NEAR(mean[roof::Wall], 1.82, 0.05 * 1.82);
    EXPECT_NEAR(mean[roof::Underside], 3.44, 0.05 * 3.44);

    // The sky where it is seen.
    PhotonParams few = params;
    few.photons = 4096;
    few.gather_below = 1'000'000;
    few.gather_rays = 256;
    const auto sky = zones.means(day_of(land, overhead(90, 60), few).sites.sky);
    EXPECT_NEAR(sky[roof::FrontFloor], 48.3, 0.5);
    EXPECT_NEAR(sky[roof::BackFloor], 32.3, 0.5);
    EXPECT_NEAR(sky[roof::Wall], 18.5, 0.3);
    EXPECT_NEAR(sky[roof::RoofTop], 60, 1e-3);
}

TEST(PhotonMap, IsTheSameOnAnyNumberOfThreads)
{
    const Garden garden(0.03);
    for (const PhotonEstimator estimator : {PhotonEstimator::Kernel, PhotonEstimator::Site}) {
        const PhotonParams params{.photons = 20'000,
                                  .photon_estimator = estimator,
                                  .direct = DirectLight::Rays,
                                  .final_gather = true,
                                  .gather_below = 1000};
        auto on_threads = [&](std::size_t n) {
            const ThreadLimit limit(n);
            const PhotonLight light = garden.light(params, overhead(90, 60));
            std::vector<float> all = totals(light.sites);
            const std::vector<float> plants = totals(light.receivers);
            all.insert(all.end(), plants.begin(), plants.end());
            return all;
        };
        EXPECT_EQ(on_threads(1), on_threads(4));
    }
}

TEST(PhotonMap, RunningMeanForgetsSlowly)
{
    std::vector<float> mean{100, 0};
    running_mean(mean, std::vector<float>{6, 12}, 1, 10);
    EXPECT_THAT(mean, testing::ElementsAre(6, 12));
    running_mean(mean, std::vector<float>{12, 12}, 2, 10);
    EXPECT_THAT(mean, testing::ElementsAre(9, 12));
    running_mean(mean, std::vector<float>{29, 12}, 500, 10);
    EXPECT_THAT(mean, testing::ElementsAre(11, 12));
    running_mean(mean, std::vector<float>{3, 4}, 500, 1);
    EXPECT_THAT(mean, testing::ElementsAre(3, 4));
}

TEST(PhotonMap, NamesWhatIsWrong)
{
    const Land land(shapes::box({0, 0, 0}, {1, 1, 1}), 0.5);
    const auto& s = land.sites;
    std::vector<Vec3f> normal = s.normal;
    std::vector<float> area = s.area;
    EXPECT_THAT([&] { SiteKernel(s.position, std::span(normal).first(3), area, {}, 0); },
                ThrowsMessage<InvalidInput>(HasSubstr("with 3 normals")));
    area[5] = 0;
    EXPECT_THAT([&] { SiteKernel(s.position, normal, area, {}, 0); },
                ThrowsMessage<InvalidInput>(HasSubstr("site 5: area = 0 m^2")));
    normal[2] = {0, 0, 2};
    EXPECT_THAT([&] { SiteKernel(s.position, normal, s.area, {}, 0); },
                ThrowsMessage<InvalidInput>(HasSubstr("site 2: position")));
    EXPECT_THAT([&] { land.kernel({}, -1); },
                ThrowsMessage<InvalidParameter>(HasSubstr("size of moss = -1 m")));
    const SiteKernel kernel = land.kernel({});
    Photon stray{};
    stray.target = 1'000'000;
    EXPECT_THAT(
        [&] {
            PhotonMap({&stray, 1}, {}, kernel, {});
        },
        ThrowsMessage<InvalidInput>(HasSubstr("site 1000000")));
    stray.on_moss = 1;
    stray.target = 0;
    EXPECT_THAT(
        [&] {
            PhotonMap({&stray, 1}, {}, kernel, {});
        },
        ThrowsMessage<InvalidInput>(HasSubstr("moss 0, of which there are 0")));
    const std::int32_t plants[] = {4};
    EXPECT_THAT(
        [&] {
            light_of_day(land.scene, kernel, {}, {}, {},
                         {std::span(s.position).first(1), std::span(s.normal).first(1),
                          std::span(s.area).first(1), plants},
                         {}, 1, 1, {});
        },
        ThrowsMessage<InvalidInput>(HasSubstr("plant 4")));
}

}  // namespace
}  // namespace sekitei::light
