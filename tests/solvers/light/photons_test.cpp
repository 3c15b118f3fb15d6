#include "solvers/light/photons.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <numbers>

#include "core/error.h"
#include "core/log.h"
#include "core/parallel.h"
#include "core/random.h"
#include "solvers/light/lobes.h"
#include "tests/support/roof.h"
#include "tests/support/shapes.h"

namespace sekitei::light {
namespace {

using std::numbers::pi;
using testing::HasSubstr;
using testing::ThrowsMessage;

constexpr double kDegree = pi / 180;

/// A level sheet, facing up, z = 0.
TriMesh plate(double half, Vec3d centre = {})
{
    TriMesh mesh;
    for (const Vec3d corner : {Vec3d(-1, -1, 0), Vec3d(1, -1, 0), Vec3d(1, 1, 0), Vec3d(-1, 1, 0)})
        mesh.vertices.emplace_back(centre + corner * half);
    mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
    return mesh;
}

PhotonScene scene_of(const TriMesh& mesh, float albedo)
{
    return {mesh, std::vector<float>(mesh.triangles.size(), albedo), 0.2, 0, {}};
}

Daylight overhead(double open = 150, double sky = 0)
{
    return {{{{0, 0, 1}, open}}, sky};
}

Shot shot_of(const PhotonScene& scene, const Daylight& light, const PhotonParams& params,
             std::uint64_t day = 1)
{
    return shoot(scene, light, params, 7, day, {});
}

void expect_balanced(const Shot& shot)
{
    const Ledger& l = shot.ledger;
    EXPECT_NEAR((l.missed + l.absorbed + l.escaped + l.lost) / l.emitted, 1, 1e-9);
    EXPECT_NEAR((l.absorbed + l.reflected) / l.stored, 1, 1e-9);
    double sum = 0;
    for (const Photon& p : shot.photons) sum += p.flux;
    EXPECT_NEAR(sum / l.stored, 1, 1e-9);
}

TEST(Photons, BringWhatTheSunGivesToAnOpenPlate)
{
    const double half = 0.7;
    const PhotonScene scene = scene_of(plate(half, {3, -2, 5}), 0);
    for (const SunLight kind : {SunLight::Parallel, SunLight::Square, SunLight::SquareCone})
        for (const double elevation : {90.0, 35.0, 10.0}) {
            const PhotonParams params{.photons = 60'000, .sun_light = kind};
            const Shot shot = shot_of(scene, {{fixed_sun(150, elevation * kDegree)}, 0}, params);
            const double found = shot.ledger.stored / (4 * half * half);
            const double error = 150 / std::sqrt(static_cast<double>(shot.photons.size()));
            // The lamp's light falls off towards the plate's rim.
            const double uneven = kind == SunLight::Parallel ? 0 : 0.01 * 150;
            EXPECT_NEAR(found, 150, 3 * error + uneven)
                << choice_names(kind)[static_cast<std::size_t>(kind)] << " " << elevation;
            expect_balanced(shot);
        }
}

TEST(Photons, BringWhatTheSkyGivesToAnOpenPlate)
{
    const PhotonScene scene = scene_of(plate(0.7), 0);
    for (const double beam : {0.0, 90.0}) {
        const Shot shot = shot_of(scene, overhead(beam, 60), {.photons = 60'000});
        double sky = 0, count = 0;
        for (const Photon& p : shot.photons)
            if (p.source == Source::Sky) {
                sky += p.flux;
                ++count;
            }
        EXPECT_NEAR(sky / 1.96, 60, 3 * 60 / std::sqrt(count)) << beam;
        EXPECT_NEAR((shot.ledger.stored - sky) / 1.96, beam, 1.5);
    }
}

TEST(Photons, BeamsAreDrawnByTheirIrradianceAndNoneBelowTheHorizon)
{
    const PhotonScene scene = scene_of(plate(1), 0);
    const Daylight path{{{{0, -1, 1}, 30}, {{3, 0, 4}, 90}, {{0, 1, -0.1}, 500}, {{0, 0, 1}, 0}},
                        0};
    const Shot shot = shot_of(scene, path, {.photons = 50'000});
    double second = 0;
    for (const Photon& p : shot.photons) {
        const Vec3d back = -Vec3d(p.direction);
        const double first_cosine = dot(back, normalized(Vec3d(0, -1, 1)));
        const double second_cosine = dot(back, Vec3d(0.6, 0, 0.8));
        EXPECT_GT(std::max(first_cosine, second_cosine), std::cos(0.2667 * kDegree));
        second += second_cosine > 0.99 ? p.flux : 0;
    }
    EXPECT_NEAR(second / 4, 90 * 0.8, 90 * 0.02);
    EXPECT_NEAR(shot.ledger.stored / 4, 30 * std::sqrt(0.5) + 90 * 0.8, 2);
    // Sun below the horizon all day: sky alone; and a night.
    const Daylight set{{{{0, 1, -0.1}, 500}}, 10};
    for (const Photon& p : shot_of(scene, set, {.photons = 1000}).photons)
        EXPECT_EQ(p.source, Source::Sky);
    const Shot night = shot_of(scene, {}, {.photons = 1000});
    EXPECT_TRUE(night.photons.empty());
    EXPECT_EQ(night.ledger.emitted, 0);
}

TEST(Photons, CarryThePowerOfTheirSource)
{
    // [specified values] exitance and flux of lamps, flux of parallel light and sky
    EXPECT_NEAR(square_exitance(150, 1, 10), 11937.949, 1e-3);
    EXPECT_NEAR(square_exitance(150, 5, 10), 626.41865, 1e-5);
    EXPECT_NEAR(150 / square_exitance(150, 5, 10), 0.23945647, 1e-8);
    const TriMesh mesh = roof::mesh();
    const PhotonScene scene = scene_of(mesh, 0.2f);
    EXPECT_NEAR(scene.radius(), 1.7066, 5e-5);
    std::uint64_t tries = 0;
    const PhotonParams few{.photons = 8192};
    EXPECT_NEAR(emit(scene, overhead(150), few, 1, 1, tries)[0].flux, 0.16754, 1e-5);
    EXPECT_EQ(tries, 8192u);
    EXPECT_NEAR(emit(scene, overhead(0, 60), few, 1, 1, tries)[0].flux, 0.13403, 1e-5);
    const PhotonScene small = scene_of(plate(0.5), 0);
    const PhotonParams lamp{
        .photons = 2000, .sun_light = SunLight::Square, .square_half = 1, .square_distance = 10};
    const float flux = emit(small, overhead(150), lamp, 1, 1, tries)[0].flux;
    EXPECT_NEAR(flux * static_cast<double>(tries) / 1e5, 0.47751796, 1e-6);
    // Aimed photons carry less each, together what arrives from the lamp.
    EXPECT_GT(static_cast<double>(tries), 100 * 2000.0);
    // Sun and sky share photons by power.
    const auto both = emit(scene, overhead(90, 60), {.photons = 100'000}, 1, 1, tries);
    EXPECT_EQ(both.size(), 100'000u);
    EXPECT_NEAR(both.front().flux / both.back().flux, 1, 1e-4);
    EXPECT_NEAR(static_cast<double>(tries), 100'000 * 90.0 / (90 + 120), 1);
}

TEST(Photons, DrawingDirectionsCanBeCancelled)
{
    // The largest lamp there may be: ten thousand directions for a photon.
    const PhotonScene scene = scene_of(plate(0.5), 0);
    PhotonParams lamp{.photons = 1 << 20,
                      .sun_light = SunLight::Square,
                      .square_half = 99 * scene.radius(),
                      .square_distance = 10};
    const std::atomic<bool> stop{true};
    const Progress cancelled({}, &stop);
    std::uint64_t tries = 0;
    EXPECT_THROW(emit(scene, overhead(150), lamp, 1, 1, tries, cancelled), Cancelled);
    EXPECT_EQ(tries, 0u);
    lamp.square_half = 101 * scene.radius();
    EXPECT_THAT([&] { emit(scene, overhead(150), lamp, 1, 1, tries); },
                ThrowsMessage<InvalidParameter>(HasSubstr("square_half")));
}

TEST(Photons, LobesHaveTheirMeans)
{
    constexpr Stream kDraw{"photons_test.lobes"};
    const Frame frame(normalized(Vec3d(0.3, -0.5, -0.8)));
    Vec3d cosine, half, cone;
    const int n = 40'000;
    for (std::uint64_t i = 0; i < n; ++i) {
        const double u = uniform01(1, kDraw, i, 0), v = uniform01(1, kDraw, i, 1);
        cosine += cosine_direction(frame, u, v) / n;
        half += cap_direction(frame, 1, u, v) / n;
        cone += cap_direction(frame, cap_of_cone(pi / 4), u, v) / n;
        ASSERT_NEAR(Turn(u).sine, std::sin(2 * pi * u), 2e-15);
        ASSERT_NEAR(Turn(u).cosine, std::cos(2 * pi * u), 2e-15);
        ASSERT_NEAR(length(cosine_direction(frame, u, v)), 1, 1e-12);
    }
    const double sigma3 = 3 / std::sqrt(n) * 0.3;
    EXPECT_NEAR(dot(cosine, frame.n), 2.0 / 3, sigma3);
    EXPECT_NEAR(dot(half, frame.n), 0.5, sigma3);
    EXPECT_NEAR(dot(cone, frame.n), 0.853553, sigma3);
    for (const Vec3d mean : {cosine, half, cone})
        EXPECT_LT(length(mean - frame.n * dot(mean, frame.n)), 3 * sigma3);
}

TEST(Photons, InAClosedBoxHitOneOverOneMinusAlbedoTimes)
{
    const Vec3d middle(0.4, 0.3, 0.2);
    std::vector<Emitted> starts(20'000);
    constexpr Stream kStart{"photons_test.start"};
    for (std::size_t i = 0; i < starts.size(); ++i)
        starts[i] = {Vec3f(middle),
                     Vec3f(cap_direction(Frame(Vec3d(0, 0, 1)), 2, uniform01(1, kStart, i, 0),
                                         uniform01(1, kStart, i, 1))),
                     0.25f, Source::Sun};
    const TriMesh box = shapes::box({0, 0, 0}, {1, 0.6, 0.4});
    for (const double albedo : {0.0, 0.2, 0.5, 0.95}) {
        const PhotonScene scene = scene_of(box, static_cast<float>(albedo));
        const Shot shot = trace(scene, starts, true, 3, 1, {});
        const double n = static_cast<double>(starts.size());
        const double mean = (1 - std::pow(albedo, 65)) / (1 - albedo);  // up to 64 bounces
        const double sigma = std::sqrt(albedo) / (1 - albedo) / std::sqrt(n);
        EXPECT_NEAR(shot.ledger.stored / shot.ledger.emitted, mean, 3 * sigma + 1e-12) << albedo;
        EXPECT_NEAR(shot.ledger.lost / shot.ledger.emitted, std::pow(albedo, 65), 0.006) << albedo;
        EXPECT_LT(shot.ledger.escaped / shot.ledger.emitted, 3e-3) << albedo;
        expect_balanced(shot);
        // Without bounces all that is reflected is let go.
        const Shot once = trace(scene, starts, false, 3, 1, {});
        EXPECT_EQ(once.photons.size(), starts.size());
        EXPECT_EQ(once.ledger.escaped, once.ledger.reflected);
        EXPECT_NEAR(once.ledger.reflected / once.ledger.emitted, albedo, 0.012);
        expect_balanced(once);
    }
}

TEST(Photons, HitTheBackOfAnOpenSheetOnItsBack)
{
    const TriMesh up = plate(0.5), down = shapes::inverted(up);
    for (const bool back : {false, true}) {
        const Shot shot = shot_of(scene_of(back ? down : up, 0.5f), overhead(), {.photons = 2000});
        ASSERT_GT(shot.photons.size(), 500u);
        for (const Photon& p : shot.photons) {
            EXPECT_EQ(p.back, back);
            EXPECT_EQ(p.normal, Vec3f(0, 0, 1));
        }
        EXPECT_GT(shot.ledger.escaped, 0);
        expect_balanced(shot);
    }
}

TEST(Photons, LiveOnBallsOfMossAndBetweenThem)
{
    // Balls of radius b on a square lattice of spacing g leave 1 - pi b^2 / g^2 of the floor.
    const double b = 0.004, g = 0.012;
    const int across = 30;
    PhotonScene scene = scene_of(plate(across * g / 2), 0.2f);
    std::vector<Sphere> moss;
    for (int i = 0; i < across * across; ++i) {
        const Vec3d cell(i % across + 0.5 - across / 2, i / across + 0.5 - across / 2, 0);
        moss.push_back({Vec3f(cell * g + Vec3d(0, 0, b)), static_cast<float>(b)});
    }
    scene.set_moss(moss);
    const Shot shot = shot_of(scene, overhead(), {.photons = 100'000, .indirect = false});
    double floor = 0;
    for (const Photon& p : shot.photons) {
        floor += p.on_moss ? 0 : 1;
        if (!p.on_moss) continue;
        const Vec3d off = Vec3d(p.position) - Vec3d(moss[p.target].centre);
        EXPECT_NEAR(length(off), b, 1e-7);
        EXPECT_NEAR(dot(off, Vec3d(p.normal)), b, 1e-7);
        EXPECT_FALSE(p.back);
    }
    const double n = static_cast<double>(shot.photons.size());
    EXPECT_NEAR(floor / n, 0.650934, 3 * std::sqrt(0.65 * 0.35 / n));
    // Gone again, the floor is bare.
    scene.set_moss({});
    for (const Photon& p : shot_of(scene, overhead(), {.photons = 1000}).photons)
        EXPECT_FALSE(p.on_moss);
}

TEST(Photons, ReachTheZonesUnderARoofAsAnIndependentMonteCarloFound)
{
    const roof::Scene land(0.2);
    struct Case {
        double beam, sky;
        std::array<std::array<double, 3>, 5> expected;  // beam, sky, indirect by zone
        double hits;
    };
    const Case cases[] = {
        {150, 0, {{{150, 0, 0.11}, {0, 0, 0.226}, {0, 0, 1.82}, {0, 0, 3.44}, {150, 0, 0}}}, 1.021},
        {90,
         60,
         {{{90, 48.3, 0.449}, {0, 32.3, 1.56}, {0, 18.5, 2.95}, {0, 0, 5.19}, {90, 60, 0}}},
         1.026}};
    for (const Case& c : cases) {
        const PhotonScene scene(land.sites.mesh, land.albedo(0.2f), 0.2, 0, {});
        const Shot shot = shot_of(scene, overhead(c.beam, c.sky), {.photons = 1'000'000});
        expect_balanced(shot);
        EXPECT_NEAR(shot.ledger.stored / (shot.ledger.emitted - shot.ledger.missed), c.hits, 0.002);
        std::array<std::array<double, 3>, 6> found{};
        for (const Photon& p : shot.photons) {
            if (p.back) continue;
            const std::size_t part = p.bounce > 0 ? 2 : p.source == Source::Sky ? 1 : 0;
            found[land.zone[p.target]][part] += p.flux;
        }
        for (std::size_t z = 0; z < 5; ++z)
            for (std::size_t part = 0; part < 3; ++part) {
                const double expected = c.expected[z][part];
                const double tolerance = part == 0 ? 0.02 : expected > 1 ? 0.05 : 0.15;
                // The table's sun is a point. The real one creeps under the roof along its open
                // edges, 4 m of them 1.4 m above: by 2 / (3 pi) of the half shadow's half width.
                const double creep = 4 * 1.4 * std::tan(0.2665 * kDegree) * 2 / (3 * pi);
                const double half_shadow =
                    z == roof::BackFloor && part == 0 ? c.beam * creep / roof::kZoneArea[z] : 0;
                EXPECT_NEAR(found[z][part] / roof::kZoneArea[z], expected + half_shadow,
                            tolerance * expected + 0.2 * half_shadow + 1e-9)
                    << roof::kZoneNames[z] << " " << part;
            }
    }
}

TEST(Photons, RaysAskedForTogetherMeetWhatEachMeetsAlone)
{
    const TriMesh land = roof::mesh();
    PhotonScene scene = scene_of(land, 0.5f);
    constexpr Stream kDraw{"photons_test.rays"};
    std::vector<Sphere> moss;
    for (std::uint64_t i = 0; i < 500; ++i)
        moss.push_back(
            {{float(2 * uniform01(1, kDraw, i, 0)), float(-2 * uniform01(1, kDraw, i, 1)),
              float(4 * uniform01(1, kDraw, i, 2) - 1)},
             0.08f});
    for (const std::size_t count : {0u, 1u, 7u, 1003u}) {
        scene.set_moss(count == 7 ? std::vector<Sphere>{} : moss);
        std::vector<PhotonScene::Ray> rays;
        for (std::uint64_t i = 0; i < count; ++i)
            rays.push_back(
                {{float(2 * uniform01(2, kDraw, i, 0)), -1, 0.7f},
                 Vec3f(cosine_direction(Frame(Vec3d(0, -1, 0)), uniform01(2, kDraw, i, 1),
                                        uniform01(2, kDraw, i, 2)))});
        std::vector<PhotonScene::Hit> together(count);
        scene.intersect(rays, together);
        std::size_t met = 0;
        for (std::size_t i = 0; i < count; ++i) {
            PhotonScene::Hit alone;
            const bool meets = scene.intersect(rays[i].origin, rays[i].direction, alone);
            met += meets;
            ASSERT_EQ(meets, std::isfinite(together[i].distance)) << i;
            if (!meets) continue;
            EXPECT_EQ(together[i].distance, alone.distance);
            EXPECT_EQ(together[i].target, alone.target);
            EXPECT_EQ(together[i].on_moss, alone.on_moss);
            EXPECT_EQ(together[i].back, alone.back);
            EXPECT_EQ(together[i].normal, alone.normal);
        }
        if (count > 100) {
            EXPECT_GT(met, count / 8);
            EXPECT_LT(met, count);
        }
    }
}

TEST(Photons, AreStoredPathByPath)
{
    // Each starts with a first hit, and goes on from where it was.
    const PhotonScene scene = scene_of(roof::mesh(), 0.8f);
    const Shot shot = shot_of(scene, overhead(90, 60), {.photons = 5000});
    std::size_t reflected = 0;
    for (std::size_t k = 0; k < shot.photons.size(); ++k) {
        const Photon& p = shot.photons[k];
        if (p.bounce == 0) continue;
        ASSERT_GT(k, 0u);
        const Photon& before = shot.photons[k - 1];
        ASSERT_EQ(p.bounce, before.bounce + 1) << k;
        const Vec3d way = Vec3d(p.position) - Vec3d(before.position);
        EXPECT_GT(dot(way, Vec3d(p.direction)), (1 - 1e-3) * length(way) - 1e-4) << k;
        ++reflected;
    }
    EXPECT_GT(reflected, 200u);
}

TEST(Photons, ThatNoMachineCouldHoldAreRefused)
{
    // In a closed box 20 hits a photon: 2 TB.
    const std::vector<float> white(12, 0.95f);
    TriMesh inside = shapes::box({0, 0, 0}, {1, 1, 1});
    inside.triangles.resize(10);
    const PhotonScene jar(inside, std::span(white).first(10), 0.2, 0, {});
    EXPECT_THAT([&] { shoot(jar, overhead(), {.photons = 1'000'000'000}, 7, 1, {}); },
                ThrowsMessage<LimitExceeded>(testing::AllOf(
                    HasSubstr("photons = 1e+09"), HasSubstr("stored, which needs about"))));
}

TEST(Photons, AreSpreadAtRandom)
{
    // Of 8192 photons 5 % are expected in a disc: their number varies by sqrt(0.95 / (8192 0.05)).
    const PhotonScene scene = scene_of(plate(1), 0);
    const double radius2 = 0.05 * scene.radius() * scene.radius();
    const int days = 200;
    double sum = 0, squares = 0;
    for (int day = 0; day < days; ++day) {
        std::uint64_t tries = 0;
        double inside = 0;
        for (const Emitted& e : emit(scene, overhead(), {.photons = 8192}, 5,
                                     static_cast<std::uint64_t>(day), tries)) {
            const Vec3f at = e.origin - e.direction * (e.origin.z / e.direction.z);
            inside += at.x * at.x + at.y * at.y <= radius2 ? 1 : 0;
        }
        sum += inside / days;
        squares += inside * inside / days;
    }
    EXPECT_NEAR(sum, 0.05 * 8192, 3 * 0.0482 * 409.6 / std::sqrt(days));
    EXPECT_NEAR(std::sqrt(squares - sum * sum) / sum, 0.0482, 3 * 0.0482 / std::sqrt(2.0 * days));
}

TEST(Photons, AreTheSameOnAnyNumberOfThreadsAndNewEveryDay)
{
    const TriMesh mesh = roof::mesh();
    auto shot_on = [&](std::size_t threads, std::uint64_t day, SunLight kind) {
        const ThreadLimit limit(threads);
        const PhotonScene scene = scene_of(mesh, 0.5f);
        return shot_of(scene, overhead(90, 60), {.photons = 20'000, .sun_light = kind}, day);
    };
    auto same = [](const Shot& a, const Shot& b) {
        return a.photons.size() == b.photons.size() &&
               std::memcmp(a.photons.data(), b.photons.data(), a.photons.size() * sizeof(Photon)) ==
                   0 &&
               std::memcmp(&a.ledger, &b.ledger, sizeof(Ledger)) == 0;
    };
    for (const SunLight kind : {SunLight::Parallel, SunLight::Square, SunLight::SquareCone}) {
        const Shot one = shot_on(1, 1, kind);
        EXPECT_TRUE(same(one, shot_on(4, 1, kind)));
        EXPECT_FALSE(same(one, shot_on(1, 2, kind)));
    }
}

TEST(Photons, NameWhatIsWrong)
{
    auto wrong = [](const PhotonParams& params, const char* message) {
        EXPECT_THAT([&] { validate(params); }, ThrowsMessage<InvalidParameter>(HasSubstr(message)));
    };
    wrong({.photons = 0}, "photons = 0, must be 1 to");
    wrong({.photons = -3}, "photons = -3");
    wrong({.photon_radius = 0}, "photon_radius = 0 m, must be 0.0001 to 100");
    wrong({.photon_radius = NAN}, "photon_radius = nan");
    const TriMesh mesh = plate(1);
    for (const float albedo : {-0.1f, 0.96f, NAN})
        EXPECT_THAT([&] { scene_of(mesh, albedo); },
                    ThrowsMessage<InvalidInput>(HasSubstr("albedo of site 0 = ")));
    EXPECT_THAT([&] { PhotonScene(mesh, std::vector<float>(2, 0.2f), 1, 0, {}); },
                ThrowsMessage<InvalidInput>(HasSubstr("albedo of moss = 1, must be 0 to 0.95")));
    EXPECT_THAT([&] { PhotonScene(mesh, std::vector<float>(3, 0.2f), 0, 0, {}); },
                ThrowsMessage<InvalidInput>(HasSubstr("3 albedos for 2 triangles")));
    EXPECT_THAT([&] { PhotonScene(TriMesh{}, {}, 0, 0, {}); }, testing::Throws<InvalidInput>());
    PhotonScene scene = scene_of(mesh, 0);
    const Sphere flat[] = {{{0, 0, 0}, 0.01f}, {{0, 0, 0}, 0}};
    EXPECT_THAT([&] { scene.set_moss(flat); }, ThrowsMessage<InvalidInput>(HasSubstr("moss 1")));
    for (const Daylight& bad :
         {Daylight{{{{0, 0, 0}, 1}}, 0}, Daylight{{{{0, 0, 1}, -1}}, 0},
          Daylight{{{{NAN, 0, 1}, 1}}, 0}, Daylight{{}, -1}, Daylight{{}, NAN}})
        EXPECT_THROW(shot_of(scene, bad, {.photons = 10}), InvalidInput);
    EXPECT_THAT([] { fixed_sun(-1, 1); },
                ThrowsMessage<InvalidParameter>(HasSubstr("open ground")));
    EXPECT_THAT([] { fixed_sun(150, 0); }, ThrowsMessage<InvalidParameter>(HasSubstr("elevation")));
    // A lamp that stands in the scene, or so near that its light is uneven.
    auto lamp = [](double distance) {
        return PhotonParams{.sun_light = SunLight::Square, .square_distance = distance};
    };
    EXPECT_THAT(
        [&] { shot_of(scene, overhead(), lamp(4)); },
        ThrowsMessage<InvalidParameter>(HasSubstr("square_distance = 4 m, must be >= 4.24")));
    EXPECT_THAT([&] { validate(lamp(1000), scene.radius()); },
                ThrowsMessage<InvalidParameter>(HasSubstr("square_cone")));
    std::string said;
    log::set_sink([&](log::Level, const std::string& line) { said = line; });
    validate(lamp(6), scene.radius());
    log::set_sink({});
    EXPECT_THAT(said, HasSubstr("less than 8 radii"));
}

}  // namespace
}  // namespace sekitei::light
