#include "apps/render/render.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <set>

#include "apps/render/camera.h"
#include "apps/render/colour.h"
#include "apps/render/corner_normals.h"
#include "apps/render/look.h"
#include "apps/render/path_tracer.h"
#include "apps/render/sampler.h"
#include "apps/render/sky.h"
#include "apps/render/slice.h"
#include "apps/render/text.h"
#include "core/error.h"
#include "core/math.h"
#include "core/parallel.h"
#include "solvers/rays/embree.h"

namespace sekitei::render {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::ThrowsMessage;

void add_quad(TriMesh& mesh, Vec3f a, Vec3f b, Vec3f c, Vec3f d)
{
    const auto i = static_cast<std::uint32_t>(mesh.vertices.size());
    for (const Vec3f v : {a, b, c, d}) mesh.vertices.push_back(v);
    mesh.triangles.push_back({i, i + 1, i + 2});
    mesh.triangles.push_back({i, i + 2, i + 3});
}

void add_box(TriMesh& mesh, Vec3f lo, Vec3f hi)
{
    auto at = [&](int x, int y, int z) {
        return Vec3f(x ? hi.x : lo.x, y ? hi.y : lo.y, z ? hi.z : lo.z);
    };
    add_quad(mesh, at(0, 0, 0), at(0, 1, 0), at(1, 1, 0), at(1, 0, 0));
    add_quad(mesh, at(0, 0, 1), at(1, 0, 1), at(1, 1, 1), at(0, 1, 1));
    add_quad(mesh, at(0, 0, 0), at(1, 0, 0), at(1, 0, 1), at(0, 0, 1));
    add_quad(mesh, at(0, 1, 0), at(0, 1, 1), at(1, 1, 1), at(1, 1, 0));
    add_quad(mesh, at(0, 0, 0), at(0, 0, 1), at(0, 1, 1), at(0, 1, 0));
    add_quad(mesh, at(1, 0, 0), at(1, 1, 0), at(1, 1, 1), at(1, 0, 1));
}

TriMesh ball(Vec3d centre, double radius, int rings)
{
    TriMesh mesh;
    const int around = 2 * rings;
    for (int j = 0; j <= rings; ++j)
        for (int i = 0; i < around; ++i) {
            const double t = math::kPi * j / rings, p = 2 * math::kPi * i / around;
            mesh.vertices.push_back(
                Vec3f(centre + Vec3d(math::sin(t) * math::cos(p), math::sin(t) * math::sin(p),
                                     math::cos(t)) *
                                   radius));
        }
    for (int j = 0; j < rings; ++j)
        for (int i = 0; i < around; ++i) {
            auto at = [&](int row, int column) {
                return static_cast<std::uint32_t>(row * around + column % around);
            };
            if (j + 1 < rings) mesh.triangles.push_back({at(j, i), at(j + 1, i), at(j + 1, i + 1)});
            if (j > 0) mesh.triangles.push_back({at(j, i), at(j + 1, i + 1), at(j, i + 1)});
        }
    return mesh;
}

/// Steps of columns with attributes, well away from the origin.
TriMesh columns()
{
    TriMesh mesh;
    std::vector<std::int32_t> column, surface;
    for (int i = 0; i < 12; ++i) {
        const auto x = 40 + 0.5f * static_cast<float>(i % 4),
                   y = -20 + 0.5f * static_cast<float>(i / 4);
        add_box(mesh, {x, y, 3}, {x + 0.48f, y + 0.48f, 3.6f + 0.37f * static_cast<float>(i % 5)});
        for (int t = 0; t < 12; ++t) {
            column.push_back(i * 3);
            surface.push_back(t == 2 || t == 3 ? i % 6 : 0);
        }
    }
    std::vector<float> height;
    for (const Vec3f& v : mesh.vertices) height.push_back(v.z);
    mesh.face_attributes["column"] = column;
    mesh.face_attributes["surface"] = surface;
    mesh.vertex_attributes["height"] = height;
    return mesh;
}

std::vector<Vec3f> flat_normals(const TriMesh& mesh)
{
    std::vector<Vec3f> normals;
    for (const auto& t : mesh.triangles)
        for (int k = 0; k < 3; ++k)
            normals.push_back(normalized(cross(mesh.vertices[t[1]] - mesh.vertices[t[0]],
                                               mesh.vertices[t[2]] - mesh.vertices[t[0]])));
    return normals;
}

Bounds bounds_of(const TriMesh& mesh)
{
    Bounds bounds;
    for (const Vec3f& v : mesh.vertices) bounds.add(Vec3d(v));
    return bounds;
}

struct Shot {
    int width = 40, height = 30, samples = 16, bounces = 4;
    std::uint64_t seed = 5;
    std::optional<double> ground;
    double view_azimuth = 180, view_elevation = 20;
    std::optional<Vec3d> eye, target;
};

Film shoot(const TriMesh& mesh, const Look& look, const Sky& sky, const Shot& shot)
{
    const rays::TriangleScene rays(mesh.vertices, mesh.triangles, "render");
    const auto normals = flat_normals(mesh);
    Params params;
    params.width = shot.width;
    params.height = shot.height;
    params.view_azimuth = shot.view_azimuth;
    params.view_elevation = shot.view_elevation;
    params.eye = shot.eye;
    params.target = shot.target;
    params.ground = false;
    const World world{.mesh = mesh,
                      .rays = rays,
                      .normals = normals,
                      .look = look,
                      .sky = sky,
                      .camera = make_camera(params, bounds_of(mesh)),
                      .ground = shot.ground,
                      .haze = INFINITY,
                      .hills = false,
                      .backdrop = {}};
    return trace(world,
                 {.width = shot.width,
                  .height = shot.height,
                  .samples = shot.samples,
                  .bounces = shot.bounces,
                  .clamp = 1e6},
                 shot.seed, Progress{});
}

double mean_hit(const Film& film)
{
    double sum = 0, count = 0;
    for (std::size_t i = 0; i < film.radiance.size(); ++i)
        if (film.depth[i] > 0) {
            sum += static_cast<double>(film.radiance[i].y);
            ++count;
        }
    return sum / count;
}

/// Matt and shiny at once.
class ShinyLook : public Look {
public:
    explicit ShinyLook(float roughness) : roughness_(roughness) {}
    Material surface(const SurfacePoint& p) const override
    {
        return {Vec3f(1), p.normal, roughness_, 1};
    }
    Material ground(const SurfacePoint& p) const override { return surface(p); }

private:
    float roughness_;
};

TEST(Render, AWhiteBallInAWhiteSkyCannotBeSeen)
{
    const TriMesh mesh = ball({3, -2, 7}, 2.5, 24);
    const Film film = shoot(mesh, PlainLook(Vec3f(1), Vec3f(1)), Sky::uniform(1, true),
                            {.samples = 64, .bounces = 1});
    EXPECT_NEAR(mean_hit(film), 1, 0.003);
    for (const Vec3f& r : film.radiance) EXPECT_NEAR(r.x, 1, 0.12f);
}

TEST(Render, AWhiteHollowInAWhiteSkyCannotBeSeenOnceLightBouncesLongEnough)
{
    TriMesh mesh;  // a box open at the top and towards the camera
    add_quad(mesh, {0, 0, 0}, {3, 0, 0}, {3, 2, 0}, {0, 2, 0});
    add_quad(mesh, {0, 2, 0}, {3, 2, 0}, {3, 2, 2.5f}, {0, 2, 2.5f});
    add_quad(mesh, {0, 0, 0}, {0, 2, 0}, {0, 2, 2.5f}, {0, 0, 2.5f});
    const PlainLook white(Vec3f(1), Vec3f(1));
    const Sky sky = Sky::uniform(1, true);
    const double few = mean_hit(shoot(mesh, white, sky, {.samples = 64, .bounces = 0}));
    const double many = mean_hit(shoot(mesh, white, sky, {.samples = 64, .bounces = 40}));
    EXPECT_LT(few, 0.97);
    EXPECT_NEAR(many, 1, 0.004);
}

TEST(Render, RoughShineNeverGivesMoreLightThanItReceives)
{
    const TriMesh mesh = ball({0, 0, 0}, 1.5, 24);
    for (const float roughness : {0.3f, 0.6f, 1.0f}) {
        const double seen = mean_hit(shoot(mesh, ShinyLook(roughness), Sky::uniform(1, true),
                                           {.samples = 64, .bounces = 1}));
        EXPECT_LT(seen, 1.003) << roughness;
        EXPECT_GT(seen, 0.85) << roughness;
    }
}

TEST(Render, SunOnAMattPlaneIsAlbedoTimesIrradianceTimesCosineOverPi)
{
    TriMesh mesh;
    add_quad(mesh, {-9, -9, 2}, {9, -9, 2}, {9, 9, 2}, {-9, 9, 2});
    Sky sky = Sky::uniform(0, true);
    const double elevation = 0.6;
    sky.set_sun({math::cos(elevation), 0, math::sin(elevation)}, 0.004, Vec3f(3, 2, 1));
    const Film film = shoot(mesh, PlainLook(Vec3f(0.4f), Vec3f(0)), sky,
                            {.samples = 4, .eye = Vec3d(0, -4, 7), .target = Vec3d(0, 0, 2)});
    const double expected = 0.4 / math::kPi * math::sin(elevation);
    const Vec3f seen = film.radiance[film.radiance.size() / 2 + 20];
    EXPECT_NEAR(seen.x, 3 * expected, 3 * expected * 0.004);
    EXPECT_NEAR(seen.y, 2 * expected, 2 * expected * 0.004);
    EXPECT_NEAR(seen.z, 1 * expected, 1 * expected * 0.004);
}

TEST(Render, PenumbraIsTheShareOfTheDiscThatAnEdgeLeavesFree)
{
    // A roof over x < 0 at height 2 above the plane z = 1; the sun overhead with radius 6 degrees.
    constexpr double kRadius = 6 * math::kPi / 180, kHeight = 2;
    TriMesh mesh;
    add_quad(mesh, {-40, -40, 1}, {40, -40, 1}, {40, 40, 1}, {-40, 40, 1});
    add_quad(mesh, {-40, -40, 3}, {0, -40, 3}, {0, 40, 3}, {-40, 40, 3});
    Sky sky = Sky::uniform(0, true);
    sky.set_sun({0, 0, 1}, kRadius, Vec3f(1));
    const double reach = kHeight * math::sin(kRadius) / math::cos(kRadius);
    for (const double s : {-0.8, -0.3, 0.0, 0.45, 0.8}) {
        // Look at one spot of the plane from far aside, under the roof's level.
        const Vec3d spot{s * reach, 0, 1};
        const Film film = shoot(mesh, PlainLook(Vec3f(1), Vec3f(0)), sky,
                                {.width = 17,
                                 .height = 401,
                                 .samples = 32,
                                 .bounces = 0,
                                 .eye = spot + Vec3d(0.0, -8, 0.9),
                                 .target = spot});
        const double seen = static_cast<double>(film.radiance[200 * 17 + 8].y) * math::kPi;
        const double exact = 0.5 + (std::asin(s) + s * std::sqrt(1 - s * s)) / math::kPi;
        EXPECT_NEAR(seen, exact, 0.05) << s;
    }
}

TEST(Render, APictureIsTheSameOnAnyNumberOfThreads)
{
    const TriMesh mesh = columns();
    Params params;
    params.width = 75;
    params.height = 41;
    params.samples = 5;
    for (const std::string field : {"", "height", "column"}) {
        params.field = field;
        auto on_threads = [&](std::size_t n) {
            const ThreadLimit limit(n);
            return run(mesh, params, 11, Progress{}).pixels;
        };
        const auto one = on_threads(1);
        EXPECT_EQ(one, on_threads(2)) << field;
        EXPECT_EQ(one, on_threads(7)) << field;
        EXPECT_NE(one, run(mesh, params, 12, Progress{}).pixels) << field;
    }
}

TEST(Render, ASceneThatIsItsOwnMirrorImageGivesAPictureThatIs)
{
    TriMesh mesh;  // mirrored in x = 5; the sun and the camera stand in that plane
    add_box(mesh, {4, 0, 1}, {6, 1.5f, 3});
    add_box(mesh, {2, -1, 1}, {3, 0.5f, 2});
    add_box(mesh, {7, -1, 1}, {8, 0.5f, 2});
    const Sky sky = Sky::day({0, -math::cos(0.4), math::sin(0.4)}, 0.03, 3, false);
    const Film film = shoot(mesh, PlainLook(Vec3f(0.5f), Vec3f(0.3f)), sky,
                            {.width = 64, .height = 48, .samples = 64, .ground = 1.0});
    double worst = 0, brightness = 0;
    for (int by = 0; by < 48; by += 8)
        for (int bx = 0; bx < 32; bx += 8) {
            double left = 0, right = 0;
            for (int y = by; y < by + 8; ++y)
                for (int x = bx; x < bx + 8; ++x) {
                    left += static_cast<double>(film.radiance[std::size_t(y * 64 + x)].y);
                    right += static_cast<double>(film.radiance[std::size_t(y * 64 + 63 - x)].y);
                }
            worst = std::max(worst, std::abs(left - right) / (left + right));
            brightness += left + right;
        }
    EXPECT_GT(brightness, 0);
    EXPECT_LT(worst, 0.01);
}

/// Root mean square difference of two renderings that differ only in their seed.
double noise(int samples)
{
    const TriMesh mesh = columns();
    const Sky sky = Sky::day({0.5, -0.6, 0.4}, 0.005, 3, false);
    Shot shot{.width = 48, .height = 36, .samples = samples, .ground = 3.0};
    const PlainLook look(Vec3f(0.3f), Vec3f(0.3f));
    const Film a = shoot(mesh, look, sky, shot);
    shot.seed = 77;
    const Film b = shoot(mesh, look, sky, shot);
    double sum = 0;
    for (std::size_t i = 0; i < a.radiance.size(); ++i) {
        const auto d = static_cast<double>(a.radiance[i].y - b.radiance[i].y);
        sum += d * d;
    }
    return std::sqrt(sum / static_cast<double>(a.radiance.size()));
}

TEST(Render, NoiseFallsAtLeastAsTheRootOfTheSamples)
{
    const double coarse = noise(4), fine = noise(64);
    EXPECT_GT(coarse / fine, 3.8);  // plain random numbers: 4; well-spread ones: somewhat more
    EXPECT_LT(coarse / fine, 16);
}

TEST(Render, DenoisingComesNearerToTheTruth)
{
    const TriMesh mesh = columns();
    const Sky sky = Sky::day({0.5, -0.6, 0.4}, 0.005, 3, false);
    const PlainLook look(Vec3f(0.3f), Vec3f(0.3f));
    const Shot few{.width = 64, .height = 48, .samples = 8, .ground = 3.0};
    Shot many = few;
    many.samples = 512;
    many.seed = 9;
    Film noisy = shoot(mesh, look, sky, few);
    const Film truth = shoot(mesh, look, sky, many);
    auto error = [&] {
        double sum = 0;
        for (std::size_t i = 0; i < truth.radiance.size(); ++i) {
            const auto d = static_cast<double>(noisy.radiance[i].y - truth.radiance[i].y);
            sum += d * d;
        }
        return std::sqrt(sum);
    };
    const double before = error();
    denoise(noisy, Progress{});
    EXPECT_LT(error(), 0.8 * before);
}

TEST(Render, DenoisingLeavesAPictureWithoutNoiseAlone)
{
    Film film;
    film.width = 20;
    film.height = 14;
    for (int i = 0; i < 280; ++i) {
        film.radiance.push_back(Vec3f(0.2f + 0.1f * static_cast<float>(i % 7)));
        film.albedo.push_back(Vec3f(0.5f));
        film.normal.push_back({0, 0, 1});
        film.depth.push_back(4);
        film.variance.push_back(0);
    }
    const auto before = film.radiance;
    denoise(film, Progress{});
    for (std::size_t i = 0; i < before.size(); ++i)
        EXPECT_NEAR(film.radiance[i].x, before[i].x, 1e-4f);
}

TEST(Render, ASunBelowTheHorizonIsLegalAndEverDarker)
{
    double last = INFINITY;
    for (const double degrees : {30.0, 5.0, -3.0, -10.0, -25.0}) {
        const double e = degrees * math::kPi / 180;
        const Sky sky = Sky::day({0, math::cos(e), math::sin(e)}, 0.0046, 3, false);
        EXPECT_LT(static_cast<double>(sky.white()), last) << degrees;
        EXPECT_GT(sky.white(), 0) << degrees;
        EXPECT_EQ(sky.has_sun(), degrees > 0) << degrees;
        last = static_cast<double>(sky.white());
    }
    Params params;
    params.width = 32;
    params.height = 24;
    params.samples = 2;
    for (const double degrees : {-2.0, -12.0, -90.0, 90.0}) {
        params.sun_elevation = degrees;
        const Image8 image = run(columns(), params, 1, Progress{});
        const int brightest = *std::max_element(image.pixels.begin(), image.pixels.end());
        EXPECT_GT(brightest, 40) << degrees;
        EXPECT_GT(std::set<int>(image.pixels.begin(), image.pixels.end()).size(), 12u) << degrees;
    }
}

TEST(Render, TheDaySkyIsBlueOverheadAndTheLowSunRed)
{
    const Sky noon = Sky::day({0.3, 0.2, 0.9}, 0.0046, 2.5, false);
    const Vec3f zenith = noon.radiance(normalized(Vec3f(-0.3f, -0.3f, 0.9f)));
    EXPECT_GT(zenith.z, 1.8f * zenith.x);
    const Sky evening = Sky::day({1, 0, 0.05}, 0.0046, 2.5, false);
    EXPECT_GT(evening.sun_irradiance().x, 4 * evening.sun_irradiance().z);
    EXPECT_GT(noon.sun_irradiance().x, evening.sun_irradiance().x);
    // Clear air overhead lets most of the light through: depth about 0.11 a unit of turbidity.
    EXPECT_NEAR(Sky::day({0, 0, 1}, 0.0046, 1, false).sun_irradiance().y,
                std::exp(-13.558e-6 * 8000 - 1.881e-6 * 15000), 0.01);
}

TEST(Render, SkySamplesFollowTheirStatedDensity)
{
    const Sky sky = Sky::day({0.6, -0.5, 0.4}, 0.0046, 3, true);
    constexpr int kCount = 40000;
    double whole = 0, irradiance = 0, exact = 0;
    for (int i = 0; i < kCount; ++i) {
        Sampler numbers(99, static_cast<std::uint32_t>(i));
        const auto [direction, density] = sky.sample(numbers.next2());
        EXPECT_NEAR(density, sky.density(direction), 2e-2f + 0.5f * density);
        whole += 1 / static_cast<double>(density) / kCount;
        if (direction.z > 0)
            irradiance +=
                static_cast<double>(sky.radiance(direction).y * direction.z / density) / kCount;
        // The same by uniform directions.
        const auto u = numbers.next2();
        const double z = static_cast<double>(u[0]), s = std::sqrt(1 - z * z),
                     p = 2 * math::kPi * static_cast<double>(u[1]);
        exact +=
            static_cast<double>(sky.radiance(Vec3f(Vec3d(s * std::cos(p), s * std::sin(p), z))).y) *
            z * 2 * math::kPi / kCount;
    }
    EXPECT_NEAR(whole, 4 * math::kPi, 0.05);
    EXPECT_NEAR(irradiance, exact, 0.01 * exact);
}

TEST(Render, SamplesAreStratifiedInEveryPowerOfTwo)
{
    for (std::uint64_t key = 1; key < 20; ++key)
        for (int pair = 0; pair < 3; ++pair)
            for (const int across : {1, 2, 4, 8, 16}) {
                std::set<int> cells;
                for (std::uint32_t i = 0; i < 16; ++i) {
                    Sampler numbers(key, i);
                    for (int k = 0; k < pair; ++k) numbers.next2();
                    const auto u = numbers.next2();
                    cells.insert(static_cast<int>(u[0] * static_cast<float>(across)) * 16 +
                                 static_cast<int>(u[1] * static_cast<float>(16 / across)));
                }
                EXPECT_EQ(cells.size(), 16u) << key << ' ' << pair << ' ' << across;
            }
}

TEST(Render, TheAutomaticCameraFramesAllCornersAndStandsNoFartherThanNeeded)
{
    const Bounds flat{{100, -50, 3}, {140, -45, 5}}, tower{{-1, -2, 0}, {1, 1, 30}},
        cliff{{0, 0, 0}, {12, 10, 6}};
    for (const Bounds& bounds : {flat, tower, cliff})
        for (const double azimuth : {0.0, 33.0, 120.0, 215.0, 300.0})
            for (const double elevation : {-20.0, 2.0, 8.0, 40.0, 89.0})
                for (const int width : {300, 1280, 2500}) {
                    Params params;
                    params.width = width;
                    params.view_azimuth = azimuth;
                    params.view_elevation = elevation;
                    params.ground = false;
                    const Camera camera = make_camera(params, bounds);
                    EXPECT_NEAR(camera.right.z, 0, 1e-12);
                    double most = 0;
                    for (int corner = 0; corner < 8; ++corner) {
                        const Vec3d p =
                            camera.project({corner & 1 ? bounds.upper.x : bounds.lower.x,
                                            corner & 2 ? bounds.upper.y : bounds.lower.y,
                                            corner & 4 ? bounds.upper.z : bounds.lower.z});
                        EXPECT_GT(p.z, 0);
                        EXPECT_LE(std::abs(p.x), 0.95);
                        EXPECT_LE(std::abs(p.y), 0.95);
                        most = std::max({most, std::abs(p.x), std::abs(p.y)});
                    }
                    EXPECT_GT(most, 0.7);
                }
}

TEST(Render, TheCameraLooksWhereTheAzimuthSays)
{
    Params params;
    params.view_azimuth = 90;  // stands in the east, looks west
    params.view_elevation = 0;
    const Camera camera = make_camera(params, {{0, 0, 0}, {2, 3, 4}});
    EXPECT_NEAR(camera.forward.x, -1, 1e-12);
    EXPECT_NEAR(camera.right.y, 1, 1e-12);  // north at the right hand
    params.zoom = 2;
    const Camera near = make_camera(params, {{0, 0, 0}, {2, 3, 4}});
    EXPECT_NEAR((near.eye.x - 1) * 2, camera.eye.x - 1, 1e-9);
    params.eye = params.target = Vec3d(1, 1, 1);
    EXPECT_THAT(
        [&] {
            make_camera(params, {{0, 0, 0}, {1, 1, 1}});
        },
        ThrowsMessage<InvalidParameter>(HasSubstr("same point")));
}

TEST(Render, SmoothNormalsEvenOutAWallOfFacetsAndKeepItsEdges)
{
    // An L of two walls whose inner vertices are shaken by a tenth of the spacing.
    TriMesh mesh;
    constexpr int kSide = 14;
    constexpr double kStep = 0.3;
    constexpr Stream kShake{"test.shake"};
    auto vertex = [&](int i, int j) {
        const bool second = i > kSide;
        const double shake =
            i == kSide ? 0 : 0.1 * kStep * (uniform01(3, kShake, std::uint64_t(i * 100 + j)) - 0.5);
        return second ? Vec3f(Vec3d(kSide * kStep + shake, (i - kSide) * kStep, j * kStep))
                      : Vec3f(Vec3d(i * kStep, shake, j * kStep));
    };
    const int columns_count = 2 * kSide + 1;
    for (int j = 0; j <= kSide; ++j)
        for (int i = 0; i < columns_count; ++i) mesh.vertices.push_back(vertex(i, j));
    for (int j = 0; j < kSide; ++j)
        for (int i = 0; i + 1 < columns_count; ++i) {
            const auto a = static_cast<std::uint32_t>(j * columns_count + i), b = a + 1,
                       c = a + static_cast<std::uint32_t>(columns_count), d = c + 1;
            mesh.triangles.push_back({a, b, d});
            mesh.triangles.push_back({a, d, c});
        }
    const auto normals = corner_normals(mesh, 38 * math::kPi / 180);
    double rough = 0, smooth = 0;
    for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
        const int cell = static_cast<int>(t / 2) % (columns_count - 1);
        const Vec3f exact = cell >= kSide ? Vec3f(1, 0, 0) : Vec3f(0, -1, 0);
        const Vec3f facet = flat_normals(mesh)[t * 3];
        for (std::size_t k = 0; k < 3; ++k) {
            rough += static_cast<double>(1 - dot(facet, exact));
            smooth += static_cast<double>(1 - dot(normals[t * 3 + k], exact));
            EXPECT_GT(dot(normals[t * 3 + k], exact), 0.98f) << "edge rounded at " << t;
        }
    }
    EXPECT_LT(smooth, 0.3 * rough);
}

TEST(Render, ColumnWidthIsFoundFromTheWalls)
{
    TriMesh mesh;
    std::vector<std::int32_t> column;
    for (int i = 0; i < 9; ++i) {
        const float x = 1.3f * static_cast<float>(i % 3), y = 1.3f * static_cast<float>(i / 3);
        TriMesh walls;
        add_box(walls, {x, y, 0}, {x + 1.2f, y + 1.2f, 9});
        const auto base = static_cast<std::uint32_t>(mesh.vertices.size());
        mesh.vertices.insert(mesh.vertices.end(), walls.vertices.begin(), walls.vertices.end());
        for (std::size_t t = 4; t < walls.triangles.size(); ++t) {
            auto corners = walls.triangles[t];
            for (auto& c : corners) c += base;
            mesh.triangles.push_back(corners);
            column.push_back(i + 5);
        }
    }
    mesh.face_attributes["column"] = column;
    EXPECT_NEAR(RockLook(mesh, 1).column_width(), 1.2, 0.25);
}

TEST(Render, BadInputIsNamed)
{
    Params params;
    params.width = params.height = 16;
    params.samples = 1;
    EXPECT_THAT([&] { run(TriMesh{}, params, 1, Progress{}); },
                ThrowsMessage<InvalidInput>(HasSubstr("render: the mesh has no triangles")));
    params.field = "moss";
    EXPECT_THAT([&] { run(columns(), params, 1, Progress{}); },
                ThrowsMessage<InvalidInput>(
                    HasSubstr("field = moss, the mesh has column, height, surface")));
    params.field = "";
    TriMesh broken = columns();
    broken.vertices[7].y = NAN;
    EXPECT_THAT([&] { run(broken, params, 1, Progress{}); },
                ThrowsMessage<InvalidInput>(
                    AllOf(HasSubstr("render: vertex 7"), HasSubstr("must be finite"))));
    broken = columns();
    broken.triangles[3][1] = 12345;
    EXPECT_THAT([&] { run(broken, params, 1, Progress{}); },
                ThrowsMessage<InvalidInput>(HasSubstr("triangle 3 names vertex 12345")));
    broken = columns();
    std::get<std::vector<float>>(broken.vertex_attributes["height"]).pop_back();
    params.field = "height";
    EXPECT_THAT([&] { run(broken, params, 1, Progress{}); },
                ThrowsMessage<InvalidInput>(HasSubstr("field height has")));
    params.samples = 0;
    EXPECT_THAT([&] { run(columns(), params, 1, Progress{}); },
                ThrowsMessage<InvalidParameter>(HasSubstr("samples = 0")));
}

TEST(Render, PhotonsAreDotsOfTheirOwnLightWhereTheyFellAndShadowsDoNotTouchThem)
{
    // A floor seen from right above: x to the right, y up; 5 mm a pixel at its height.
    TriMesh floor;
    add_quad(floor, {-1, -1, 0.3f}, {1, -1, 0.3f}, {1, 1, 0.3f}, {-1, 1, 0.3f});
    Params params;
    params.width = params.height = 256;
    params.samples = 4;
    params.denoise = false;
    params.eye = Vec3d(0, -0.001, 4.3);
    params.target = Vec3d(0, 0, 0.3);
    params.field_of_view = 2 * std::atan(0.64 / 4) * 180 / math::kPi;
    const std::vector<PhotonDot> photons{{{0.3, 0.2, 0.3}, {0, 0, 1}, 0},
                                         {{-0.3, 0.2, 0.3}, {0, 0, 1}, 1},
                                         {{0.3, -0.4, 0.3}, {0, 0, 1}, 5},
                                         {{-0.3, -0.4, 0.3}, {0, 0, -1}, 0}};  // from below
    auto shot = [&] { return run(floor, photons, 0.12, params, 1, Progress{}); };
    const Image8 image = shot();
    auto at = [&](double x, double y) {
        const auto column = static_cast<std::size_t>(128 + x / 0.005),
                   row = static_cast<std::size_t>(128 - y / 0.005);
        const std::uint8_t* p = image.pixels.data() + (row * 256 + column) * 3;
        return Vec3d(p[0], p[1], p[2]);
    };
    const Vec3d direct = at(0.3, 0.2), once = at(-0.3, 0.2), again = at(0.3, -0.4), bare = at(0, 0);
    EXPECT_GT(direct.y, 230);
    EXPECT_NEAR(direct.x, 255, 1);
    EXPECT_NEAR(once.x, 255, 1);
    EXPECT_LT(once.y, direct.y - 50);
    EXPECT_LT(again.y, once.y - 50);
    EXPECT_GT(again.x, 220);
    EXPECT_LT(bare.x, 110);
    EXPECT_NEAR(length(at(-0.3, -0.4) - bare), 0, 15) << "a photon below shines through the floor";
    // As wide as asked for.
    EXPECT_LT(length(at(0.3 - 0.04, 0.2) - direct), 3);
    EXPECT_GT(length(at(0.3 - 0.09, 0.2) - direct), 100);

    const ThreadLimit limit(1);
    EXPECT_EQ(shot().pixels, image.pixels);
}

TEST(Render, PhotonsThatCannotBeDrawnAreNamed)
{
    Points points;
    points.position = {{1, 2, 3}, {4, 5, 6}};
    points.attributes["N"] = std::vector<Vec3f>{{0, 0, 1}, {0, 0, 0}};
    EXPECT_THAT([&] { photons_of(points); },
                ThrowsMessage<InvalidInput>("render: points of photons have no attribute bounce"));
    points.attributes["bounce"] = std::vector<std::int32_t>{0, 1};
    EXPECT_EQ(photons_of(points).size(), 2u);
    Params params;
    params.width = params.height = 16;
    params.samples = 1;
    EXPECT_THAT([&] { run(columns(), photons_of(points), 0.1, params, 1, Progress{}); },
                ThrowsMessage<InvalidInput>("render: photon 1 has no finite place or no normal"));
    EXPECT_THAT([&] { run(columns(), {}, 0.0, params, 1, Progress{}); },
                ThrowsMessage<InvalidParameter>("render: photon_size = 0 m, must be > 0"));
    EXPECT_THAT([&] { run(TriMesh{}, {}, 0.1, params, 1, Progress{}); },
                ThrowsMessage<InvalidInput>(HasSubstr("the meshes have no triangles")));
}

TEST(Render, StopsWhenAsked)
{
    const std::atomic<bool> stop{true};
    Params params;
    params.width = params.height = 64;
    EXPECT_THROW(run(columns(), params, 1, Progress({}, &stop)), Cancelled);
}

TEST(Render, WhatPrecedesTheFirstRayStopsWhenAsked)
{
    const std::atomic<bool> stop{true};
    const Progress progress({}, &stop);
    TriMesh mesh = columns();
    EXPECT_THROW(corner_normals(mesh, 0.6, progress), Cancelled);
    EXPECT_THROW(rays::TriangleScene(mesh.vertices, mesh.triangles, "test", progress), Cancelled);
    mesh.face_attributes["column"] = std::vector<std::int32_t>(mesh.triangles.size(), 4);
    EXPECT_THROW(RockLook(mesh, 1, progress), Cancelled);
}

TEST(Render, ATriangleOfOneColourAndAMeshWithoutExtentAreLegal)
{
    TriMesh mesh;
    mesh.vertices = {{5, 5, 5}, {5.5f, 5, 5}, {5, 5.5f, 5}};
    mesh.triangles = {{0, 1, 2}, {0, 0, 0}};
    mesh.vertex_attributes["same"] = std::vector<float>{2, 2, 2};
    Params params;
    params.width = params.height = 24;
    params.samples = 1;
    EXPECT_EQ(run(mesh, params, 1, Progress{}).width, 24);
    params.field = "same";
    EXPECT_EQ(run(mesh, params, 1, Progress{}).height, 24);
    mesh.vertices.assign(3, Vec3f(1, 2, 3));
    EXPECT_EQ(run(mesh, params, 1, Progress{}).height, 24);
}

TEST(Colour, LightnessRisesEvenlyAlongTheColourMap)
{
    double last = -1;
    for (int i = 0; i <= 40; ++i) {
        const Vec3f c = colour_of_value(i / 40.0);
        const double l =
            std::cbrt(0.2126 * static_cast<double>(c.x) + 0.7152 * static_cast<double>(c.y) +
                      0.0722 * static_cast<double>(c.z));
        EXPECT_GT(l, last) << i;
        if (last >= 0) {
            EXPECT_LT(l - last, 0.04) << i;
        }
        last = l;
    }
}

TEST(Colour, NeighbouringIdsDiffer)
{
    for (int id = -2; id < 500; ++id) {
        const Vec3f d = colour_of_id(id) - colour_of_id(id + 1);
        EXPECT_GT(length(d), 0.08f) << id;
    }
}

TEST(Colour, ToneMappingKeepsGreyAndReachesWhite)
{
    EXPECT_NEAR(tone_map(Vec3f(0.18f)).y, 0.18, 1e-5);
    EXPECT_NEAR(tone_map(Vec3f(16)).y, 1, 1e-5);
    EXPECT_EQ(tone_map(Vec3f(0)).y, 0);
    EXPECT_LE(tone_map(Vec3f(1e6f)).x, 1);
}

TEST(Text, TicksAreRoundAndInside)
{
    for (const auto& [low, high] :
         {std::pair{-3.2, 9.1}, {1e-7, 5e-7}, {250.0, 1473.15}, {0.0, 1.0}}) {
        const Ticks t = ticks(low, high, 6);
        EXPECT_GE(t.values.size(), 3u) << low;
        EXPECT_LE(t.values.size(), 13u) << low;
        for (const double v : t.values) {
            EXPECT_GE(v, low - 1e-9);
            EXPECT_LE(v, high + 1e-9);
        }
    }
    EXPECT_EQ(tick_text(0.25, ticks(0, 1.2, 4)), "0.2");
    EXPECT_EQ(tick_text(400, ticks(250, 1473, 6)), "400");
}

/// Whether a sign has ink in a row; row 0 is the top of a capital, row 7 the first below the base
/// line.
bool has_ink(char sign, int row)
{
    Image8 image(kGlyphWidth, kGlyphHeight, 3);
    std::fill(image.pixels.begin(), image.pixels.end(), std::uint8_t{255});
    draw_text(image, 0, 0, std::string(1, sign), 1, {0, 0, 0});
    for (int x = 0; x < image.width; ++x)
        if (image.at(x, row, 0) == 0) return true;
    return false;
}

TEST(Text, OnlyLettersWithDescendersReachBelowTheBaseLineAndTheyAreNoTallerThanAnX)
{
    const std::string descending = "gjpqy";
    for (char sign = 'A'; sign <= 'z'; ++sign) {
        if (!std::isalnum(static_cast<unsigned char>(sign))) continue;
        const bool below = descending.find(sign) != std::string::npos;
        EXPECT_EQ(has_ink(sign, 7), below) << sign;
        EXPECT_EQ(has_ink(sign, 8), below) << sign;
        if (!below || sign == 'j') continue;
        EXPECT_FALSE(has_ink(sign, 1)) << sign << " stands as high as an x";
        EXPECT_TRUE(has_ink(sign, 2)) << sign;
    }
    EXPECT_FALSE(has_ink('x', 1));
}

// A grid whose every voxel differs, with other extents, edge and origin along each axis.
constexpr Coord kDims{9, 14, 5};
Scene numbered_scene()
{
    Scene scene;
    scene.domain = {kDims, {{10, -20, 3}, 0.25}};
    auto grid = FloatGrid::uninitialised(box_topology({0, 0, 0}, kDims), scene.domain.transform, 0);
    auto ids = IntGrid::uninitialised(grid.topology(), scene.domain.transform, -1);
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        for (int o = 0; o < kLeafSize; ++o) {
            const Coord c = leaf_coord(grid.origin(leaf), o);
            grid.values(leaf)[o] = static_cast<float>(c.x + 9 * c.y + 126 * c.z);
            ids.values(leaf)[o] = c.x + 2 * c.y + 3 * c.z;
            if (scene.domain.contains(c) && !(c == Coord(4, 6, 2))) {
                grid.mask(leaf).set(o);
                ids.mask(leaf).set(o);
            }
        }
    Grid floats;
    floats.values = grid;
    floats.unit = "K";
    scene.grids["number"] = floats;
    Grid names;
    names.values = ids;
    scene.grids["id"] = names;
    return scene;
}

TEST(Slice, ShowsTheVoxelsOfThePlaneAskedFor)
{
    const Scene scene = numbered_scene();
    for (const int axis : {0, 1, 2})
        for (const double share : {0.05, 0.5, 0.99}) {
            SliceParams params;
            params.grid = "number";
            params.axis = std::string(1, static_cast<char>('x' + axis));
            params.low = 0;
            params.high = 630;
            const int plane = static_cast<int>(share * kDims[axis]);
            params.at = scene.domain.transform.origin[axis] + (plane + 0.3) * 0.25;
            const SlicePlot plot = draw_slice(scene, params);
            EXPECT_EQ(plot.plane, plane);
            const int across = axis == 0 ? 1 : 0, upward = axis == 2 ? 1 : 2;
            ASSERT_EQ(plot.columns, kDims[across]);
            ASSERT_EQ(plot.rows, kDims[upward]);
            for (int j = 0; j < plot.rows; ++j)
                for (int i = 0; i < plot.columns; ++i) {
                    Coord c;
                    c[axis] = plane;
                    c[across] = i;
                    c[upward] = j;
                    const int x = plot.left + static_cast<int>((i + 0.5) * plot.scale);
                    const int y = plot.bottom - 1 - static_cast<int>((j + 0.5) * plot.scale);
                    const Vec3f colour = colour_of_value((c.x + 9 * c.y + 126 * c.z) / 630.0);
                    for (int k = 0; k < 3; ++k)
                        EXPECT_EQ(
                            plot.image.at(x, y, k),
                            c == Coord(4, 6, 2) ? 255 : srgb_byte(static_cast<double>(colour[k])))
                            << axis << ' ' << i << ' ' << j;
                }
        }
}

TEST(Slice, ShowsIdsInTheirOwnColours)
{
    SliceParams params;
    params.grid = "id";
    params.axis = "z";
    params.at = 3.3;
    const SlicePlot plot = draw_slice(numbered_scene(), params);
    const int x = plot.left + static_cast<int>(7.5 * plot.scale),
              y = plot.bottom - 1 - static_cast<int>(11.5 * plot.scale);
    const Vec3f colour = colour_of_id(7 + 22 + 3);
    EXPECT_EQ(plot.image.at(x, y, 0), srgb_byte(static_cast<double>(colour.x)));
    EXPECT_EQ(slice(numbered_scene(), params).width, params.width);
}

TEST(Slice, NamesWhatIsWrong)
{
    SliceParams params;
    params.grid = "temperature";
    EXPECT_THAT(
        [&] { slice(numbered_scene(), params); },
        ThrowsMessage<InvalidInput>(HasSubstr("grid = temperature, the scene has id, number")));
    params.grid = "number";
    params.axis = "w";
    EXPECT_THAT([&] { slice(numbered_scene(), params); },
                ThrowsMessage<InvalidParameter>(HasSubstr("axis = w, must be x, y or z")));
    params.axis = "y";
    params.at = -10.0;
    EXPECT_THAT(
        [&] { slice(numbered_scene(), params); },
        ThrowsMessage<InvalidParameter>(HasSubstr("at = -10 m, must be -20 to -16.5 along y")));
    params.at = std::nullopt;
    params.low = 5;
    params.high = 4;
    EXPECT_THAT([&] { slice(numbered_scene(), params); },
                ThrowsMessage<InvalidParameter>(HasSubstr("low = 5")));
}

}  // namespace
}  // namespace sekitei::render
