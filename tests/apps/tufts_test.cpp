#include "apps/render/tufts.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>

#include "apps/render/camera.h"
#include "apps/render/path_tracer.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/math.h"
#include "core/mesh_io.h"
#include "core/random.h"
#include "solvers/rays/embree.h"
#include "tests/support/tufts.h"

namespace sekitei::render {
namespace {

using ::testing::HasSubstr;
using ::testing::ThrowsMessage;
using namespace render::testing;

const std::vector<std::string> kKinds{"bryum", "hypnum", "polytrichum", "grimmia", "another"};

/// Calls f with every model in every level and density.
template <class F>
void for_each_model(const F& f)
{
    for (const std::string& name : kKinds)
        for (int model = 0; model < kTuftModels; ++model)
            for (int lod = 0; lod < kTuftLods; ++lod)
                for (int density = 0; density < kTuftDensities; ++density) {
                    SCOPED_TRACE(name + ' ' + std::to_string(model) + " lod " +
                                 std::to_string(lod) + " density " + std::to_string(density));
                    f(name, TuftModel{model, lod, density});
                }
}

Vec3f face_normal(const TuftShape& shape, const std::array<std::uint32_t, 3>& t)
{
    const Vec3f a = shape.vertices[t[0]];
    return cross(shape.vertices[t[1]] - a, shape.vertices[t[2]] - a);
}

TEST(Tufts, FullGrownModelsHaveTheTrianglesOfTheirLevel)
{
    for_each_model([](const std::string& name, const TuftModel& which) {
        const std::size_t triangles = tuft_shape(name, which).triangles.size();
        if (which.density + 1 < kTuftDensities) {
            TuftModel denser = which;
            ++denser.density;
            if (which.lod < 2) {
                EXPECT_LT(triangles, tuft_shape(name, denser).triangles.size());
            }
            return;
        }
        static constexpr std::array<std::size_t, kTuftLods> kLeast{2000, 200, 20},
            kMost{2200, 240, 25};
        EXPECT_GE(triangles, kLeast[static_cast<std::size_t>(which.lod)]);
        EXPECT_LE(triangles, kMost[static_cast<std::size_t>(which.lod)]);
    });
}

TEST(Tufts, ShapesAreSoundAndStandOnTheirFoot)
{
    for_each_model([](const std::string& name, const TuftModel& which) {
        for (const bool stalks : {false, true}) {
            const TuftShape shape = stalks ? tuft_capsules(name, which) : tuft_shape(name, which);
            ASSERT_EQ(shape.normals.size(), shape.vertices.size());
            ASSERT_EQ(shape.height.size(), shape.vertices.size());
            ASSERT_EQ(shape.tone.size(), shape.vertices.size());
            float top = -1, bottom = 1, wide = 0;
            for (const Vec3f& v : shape.vertices) {
                top = std::max(top, v.y);
                bottom = std::min(bottom, v.y);
                wide = std::max(wide, std::sqrt(v.x * v.x + v.z * v.z));
            }
            EXPECT_GT(top, 0.07f);
            EXPECT_LT(wide, 0.72f);
            if (!stalks) {
                EXPECT_LT(bottom, -0.03f);  // rooted, so that slopes show no gap
                EXPECT_GT(bottom, -0.35f);
                EXPECT_GT(wide, 0.3f);
            }
            for (const auto& t : shape.triangles) {
                for (const std::uint32_t v : t) ASSERT_LT(v, shape.vertices.size());
                ASSERT_GT(length(face_normal(shape, t)), 0);
            }
            for (const Vec3f& n : shape.normals) ASSERT_NEAR(length(n), 1, 1e-5f);
        }
    });
    EXPECT_NE(tuft_shape("bryum", {0}).vertices, tuft_shape("bryum", {1}).vertices);
    EXPECT_NE(tuft_shape("bryum", {0}).vertices, tuft_shape("grimmia", {0}).vertices);
}

/// Radius of a ball around all points, nearly the smallest: its centre goes ever shorter steps
/// towards the farthest point.
double ball_radius(const std::vector<Vec3f>& points)
{
    Vec3d centre(points.front());
    double radius = 0;
    for (int step = 1; step <= 200; ++step) {
        Vec3d farthest = centre;
        radius = 0;
        for (const Vec3f& p : points)
            if (const double d = length(Vec3d(p) - centre); d > radius) {
                radius = d;
                farthest = Vec3d(p);
            }
        centre += (farthest - centre) / (step + 1);
    }
    return radius;
}

/// The bounding ball of a plant with its stalks is at most 1.5 across; and no part is farther than
/// 1.5 from the middle of the ball that stands for the plant, half a diameter above its foot.
TEST(Tufts, PlantsWithTheirStalksStayWithinOneAndAHalfDiameters)
{
    for_each_model([](const std::string& name, const TuftModel& which) {
        std::vector<Vec3f> vertices = tuft_shape(name, which).vertices;
        for (const Vec3f& v : tuft_capsules(name, which).vertices) vertices.push_back(v);
        EXPECT_LE(ball_radius(vertices), 0.75);
        for (const Vec3f& v : vertices) ASSERT_LE(length(v - Vec3f(0, 0.5f, 0)), 1.5f);
    });
}

TEST(Tufts, TrianglesAreWoundAsTheNormalsPointAndThosePointOutwards)
{
    for_each_model([](const std::string& name, const TuftModel& which) {
        for (const bool stalks : {false, true}) {
            const TuftShape shape = stalks ? tuft_capsules(name, which) : tuft_shape(name, which);
            std::size_t agree = 0;
            for (const auto& t : shape.triangles)
                agree += dot(face_normal(shape, t),
                             shape.normals[t[0]] + shape.normals[t[1]] + shape.normals[t[2]]) > 0;
            // A drooping leaf is one surface: its two halves may look to different sides.
            EXPECT_GE(static_cast<double>(agree),
                      0.97 * static_cast<double>(shape.triangles.size()));
            TriMesh mesh;
            mesh.vertices = shape.vertices;
            mesh.triangles = shape.triangles;
            EXPECT_EQ(inspect(mesh).misoriented_edges, 0u);
            EXPECT_EQ(inspect(mesh).non_manifold_edges, 0u);
            if (stalks) continue;
            for (std::size_t i = 0; i < shape.vertices.size(); ++i)
                if (shape.height[i] > 0.36f && shape.vertices[i].y > 0.05f) {
                    ASSERT_GT(dot(shape.normals[i], shape.vertices[i]), -0.001f);
                }
        }
    });
}

TEST(Tufts, AModelIsTheSameEveryTimeAndDensitiesKeepTheShootsTheyShare)
{
    for (const std::string& name : kKinds) {
        const TuftShape full = tuft_shape(name, {1, 0, 2}), again = tuft_shape(name, {1, 0, 2}),
                        thin = tuft_shape(name, {1, 0, 0});
        EXPECT_EQ(full.vertices, again.vertices);
        EXPECT_EQ(full.triangles, again.triangles);
        // The inside shrinks; every vertex of a shoot that has grown is one of the full plant's.
        std::vector<Vec3f> there = full.vertices;
        std::sort(there.begin(), there.end());
        std::size_t core = 0;
        for (const Vec3f& v : thin.vertices)
            core += !std::binary_search(there.begin(), there.end(), v);
        EXPECT_LE(core, 61u);
        const double share = static_cast<double>(thin.vertices.size() - 61) /
                             static_cast<double>(full.vertices.size() - 61);
        EXPECT_NEAR(share, 0.45, 0.08);
    }
    EXPECT_EQ(tuft_density(0.2f), 0);
    EXPECT_EQ(tuft_density(1), 1);
    EXPECT_EQ(tuft_density(1.7f), 2);
    EXPECT_EQ(tuft_density(9), 2);
}

TEST(Tufts, ShippedModelsAreWhatTheProgramMakes)
{
    const std::filesystem::path folder = std::filesystem::path(SEKITEI_DATA) / "species";
    std::size_t files = 0;
    for (const TuftFile& file : tuft_files(kSpecies)) {
        ASSERT_TRUE(std::filesystem::exists(folder / file.name)) << file.name;
        EXPECT_EQ(read_file(folder / file.name), file.bytes) << file.name;
        MeshReadReport report;
        const TriMesh mesh = decode_mesh(file.bytes, file.name, &report);
        EXPECT_EQ(report.dropped_zero_area, 0u) << file.name;
        EXPECT_TRUE(mesh.vertex_attributes.contains("normal")) << file.name;
        EXPECT_TRUE(mesh.vertex_attributes.contains("height")) << file.name;
        EXPECT_TRUE(mesh.vertex_attributes.contains("tone")) << file.name;
        ++files;
    }
    EXPECT_EQ(files, 4u * 3 * 3 * 2);
}

/// A plant's triangles in the world, by the rotation's own formula v + 2 q x (q x v + w v).
TriMesh grown(const Tuft& t, const TuftShape& shape, double size)
{
    TriMesh mesh;
    const Vec3d q(static_cast<double>(t.orient[0]), static_cast<double>(t.orient[1]),
                  static_cast<double>(t.orient[2]));
    const auto w = static_cast<double>(t.orient[3]);
    for (const Vec3f& p : shape.vertices) {
        const Vec3d v = Vec3d(p) * (size * static_cast<double>(t.scale));
        mesh.vertices.push_back(Vec3f(t.position + v + cross(q, cross(q, v) + v * w) * 2.0));
    }
    mesh.triangles = shape.triangles;
    return mesh;
}

TEST(Tufts, RaysMeetCopiesWhereTheyMeetTheSameTrianglesUncopied)
{
    constexpr double kSize = 0.037;
    const auto tufts = scattered(60);
    const Tufts copies(tufts, kSpecies, kSize, 9);
    // Which model a plant has shows in what its rays meet: try all for each.
    std::vector<std::vector<TriMesh>> meshes(tufts.size());
    for (std::size_t i = 0; i < tufts.size(); ++i)
        for (int model = 0; model < kTuftModels; ++model)
            meshes[i].push_back(
                grown(tufts[i],
                      tuft_shape(kSpecies[static_cast<std::size_t>(tufts[i].species - 1)], {model}),
                      kSize));
    int met = 0;
    constexpr Stream kRay{"test.ray"};
    for (std::uint64_t r = 0; r < 2000; ++r) {
        const Vec3f origin(
            Vec3d(0.3 * uniform01(2, kRay, r, 0), 0.2 * uniform01(2, kRay, r, 1), 1));
        const Vec3f direction = normalized(
            Vec3f(Vec3d(uniform01(2, kRay, r, 2) - 0.5, uniform01(2, kRay, r, 3) - 0.5, -1.3)));
        TuftHit hit;
        const bool any = copies.intersect(origin, direction, 9, hit);
        EXPECT_EQ(any, copies.occluded(origin, direction, 9));
        if (!any) continue;
        ++met;
        Vec3f position, geometric, soft;
        copies.place(hit, position, geometric, soft);
        const auto distance = static_cast<float>(hit.distance);
        EXPECT_LT(length(position - (origin + direction * distance)), 2e-6f);
        EXPECT_FALSE(copies.occluded(origin, direction, distance * 0.9999f));
        bool found = false;
        for (const TriMesh& mesh : meshes[hit.tuft]) {
            if (hit.triangle >= mesh.triangles.size()) continue;
            const auto& t = mesh.triangles[hit.triangle];
            const Vec3f a = mesh.vertices[t[0]], b = mesh.vertices[t[1]], c = mesh.vertices[t[2]];
            const Vec3f p = a * (1 - hit.u - hit.v) + b * hit.u + c * hit.v;
            found = found || (length(p - position) < 2e-6f &&
                              dot(normalized(cross(b - a, c - a)), geometric) > 0.99f);
        }
        EXPECT_TRUE(found) << r;
    }
    EXPECT_GT(met, 300);
}

TEST(Tufts, SpeciesHaveTheirOwnColours)
{
    std::vector<Vec3d> mean;
    for (std::int32_t species = 1; species <= 4; ++species) {
        Tuft t;
        t.orient = upright(0.3);
        t.species = species;
        std::vector<Tuft> plants;
        for (int i = 0; i < 40; ++i) {
            t.position = Vec3d(0.03 * i, 0.01 * i, 0);
            plants.push_back(t);
        }
        const Tufts tufts(plants, kSpecies, 0.03, 3);
        Vec3d sum;
        double count = 0;
        for (int i = 0; i < 3000; ++i) {
            TuftHit hit;
            const Vec3f origin(Vec3d(0.0004 * i, 0.00013 * i, 0.2));
            if (!tufts.intersect(origin, {0.05f, 0.02f, -1}, 1, hit)) continue;
            SurfacePoint p;
            tufts.place(hit, p.position, p.normal, p.normal);
            sum += Vec3d(tufts.material(hit, p).albedo);
            ++count;
        }
        ASSERT_GT(count, 500);
        mean.push_back(sum / count);
    }
    for (const Vec3d& c : mean) EXPECT_GT(c.y, c.z * 1.15);   // none is blue
    EXPECT_GT(mean[1].x / mean[1].y, mean[0].x / mean[0].y);  // hypnum is more golden than bryum
    EXPECT_LT(mean[2].x / mean[2].y, 0.75);                   // polytrichum green
    EXPECT_LT(mean[2].y, mean[0].y);                          // and darker
    EXPECT_GT(mean[3].z / mean[3].y, 1.3 * mean[0].z / mean[0].y);  // grimmia greyer
}

constexpr double kSize = 0.03;

/// A turf of one species, its plants a bit closer than they are wide, without a row or a grid.
std::vector<Tuft> turf(std::int32_t species)
{
    std::vector<Tuft> plants;
    constexpr Stream kWhere{"test.turf"};
    std::uint64_t k = 0;
    for (int j = -6; j <= 6; ++j)
        for (int i = -6; i <= 6; ++i, ++k) {
            Tuft t;
            t.position = Vec3d(i + 0.5 * (j & 1) + 0.4 * uniform01(1, kWhere, k, 0),
                               0.87 * j + 0.4 * uniform01(1, kWhere, k, 1), 0) *
                         (0.625 * kSize);
            t.orient = upright(6.28 * uniform01(1, kWhere, k, 2));
            t.species = species;
            plants.push_back(t);
        }
    return plants;
}

/// A view that gives every plant this level of detail.
TuftView at_level(int lod)
{
    if (lod == 0) return {};
    return {Vec3d(0, 0, 1e6), kSize / (1e6 * (lod == 1 ? 10.0 : 2.0))};
}

struct Seen {
    Vec3d colour;      // mean of the pixels whose middle meets moss
    double cover = 0;  // their share of the picture
};

/// Daylight on plants over grey ground, seen from so many degrees above the horizon.
Seen look_at(const std::vector<Tuft>& plants, double elevation, int lod = 0, int samples = 4)
{
    const Tufts tufts(plants, kSpecies, kSize, 3, at_level(lod));
    const TriMesh mesh = plane(1, 0);
    const rays::TriangleScene rays(mesh.vertices, mesh.triangles, "test");
    const std::vector<Vec3f> normals(6, Vec3f(0, 0, 1));
    const PlainLook grey(Vec3f(0.3f), Vec3f(0));
    const Sky sky = Sky::day(normalized(Vec3d(0.8, 0.6, 0.7)), 0.0046, 3, false);
    Params params;
    params.width = 72;
    params.height = 54;
    const double e = elevation * math::kPi / 180;
    params.eye = Vec3d(0, -0.32 * math::cos(e), 0.01 + 0.32 * math::sin(e));
    params.target = Vec3d(0, 0, 0.01);
    World world{.mesh = mesh,
                .rays = rays,
                .normals = normals,
                .look = grey,
                .sky = sky,
                .camera = make_camera(params, mesh.bounds()),
                .tufts = &tufts};
    const Film film =
        trace(world, {.width = params.width, .height = params.height, .samples = samples}, 1, {});
    Seen seen;
    double count = 0;
    for (int y = 0; y < params.height; ++y)
        for (int x = 0; x < params.width; ++x) {
            TuftHit hit;
            if (!tufts.intersect(Vec3f(world.camera.eye),
                                 world.camera.direction((x + 0.5) / params.width * 2 - 1,
                                                        1 - (y + 0.5) / params.height * 2),
                                 9, hit))
                continue;
            seen.colour += Vec3d(film.radiance[static_cast<std::size_t>(y * params.width + x)]);
            ++count;
        }
    seen.colour = seen.colour / (count * static_cast<double>(sky.white()));
    seen.cover = count / (params.width * params.height);
    return seen;
}

double luminance(Vec3d c)
{
    return 0.2126 * c.x + 0.7152 * c.y + 0.0722 * c.z;
}

TEST(Tufts, AnotherLevelOfDetailIsAsBrightAsGreenAndAsWide)
{
    for (std::int32_t species = 1; species <= 4; ++species) {
        const auto plants = turf(species);
        std::array<Seen, 3> full;
        constexpr std::array<double, 3> kElevations{15, 40, 75};
        for (std::size_t e = 0; e < 3; ++e) full[e] = look_at(plants, kElevations[e]);
        for (const int lod : {1, 2}) {
            Vec3d mean, mean_full;
            for (std::size_t e = 0; e < 3; ++e) {
                SCOPED_TRACE(kSpecies[static_cast<std::size_t>(species - 1)] + " lod " +
                             std::to_string(lod) + " from " + std::to_string(kElevations[e]));
                const Seen seen = look_at(plants, kElevations[e], lod);
                EXPECT_NEAR(seen.cover / full[e].cover, 1, 0.06);
                EXPECT_NEAR(luminance(seen.colour) / luminance(full[e].colour), 1, 0.20);
                mean += seen.colour;
                mean_full += full[e].colour;
            }
            EXPECT_NEAR(luminance(mean) / luminance(mean_full), 1, 0.05) << species << ' ' << lod;
            EXPECT_NEAR((mean.x / mean.y) / (mean_full.x / mean_full.y), 1, 0.05)
                << species << ' ' << lod;
        }
    }
}

TEST(Tufts, TheLevelOfDetailFollowsTheSizeInThePicture)
{
    EXPECT_EQ(tuft_lod(INFINITY), 0);
    EXPECT_EQ(tuft_lod(10), 0);
    EXPECT_EQ(tuft_lod(9.9), 1);
    EXPECT_EQ(tuft_lod(3), 1);
    EXPECT_EQ(tuft_lod(2.9), 2);
    // Plants of diameter 3 cm; a pixel is 1 mrad wide.
    auto triangles = [](double distance, float scale) {
        Tuft t;
        t.orient = upright(0);
        t.scale = scale;
        return Tufts({t}, kSpecies, kSize, 1, {Vec3d(0, 0, distance), 0.001}).triangles();
    };
    EXPECT_GT(triangles(2.9, 1), 2000u);
    EXPECT_LT(triangles(3.1, 1), 300u);
    EXPECT_LT(triangles(2.9, 0.5f), 300u);
    EXPECT_GT(triangles(9.9, 1), 200u);
    EXPECT_LT(triangles(10.1, 1), 30u);
}

TEST(Tufts, DryMossIsPalerAndYellowerAndSoakedMossDarker)
{
    for (std::int32_t species = 1; species <= 4; ++species) {
        SCOPED_TRACE(kSpecies[static_cast<std::size_t>(species - 1)]);
        double light = INFINITY, yellow = INFINITY;
        for (const float wetness : {0.0f, 0.5f, 0.65f, 0.8f, 0.9f, 1.0f}) {
            auto plants = turf(species);
            for (Tuft& t : plants) t.wetness = wetness;
            const Vec3d seen = look_at(plants, 45).colour;
            EXPECT_LT(luminance(seen), light) << wetness;
            if (wetness <= 0.8f) {
                EXPECT_LT(seen.x / seen.y, yellow) << wetness;
            }
            light = luminance(seen);
            yellow = seen.x / seen.y;
        }
    }
}

TEST(Tufts, MossBrownsAndDullsWithAge)
{
    for (std::int32_t species = 1; species <= 4; ++species) {
        SCOPED_TRACE(kSpecies[static_cast<std::size_t>(species - 1)]);
        double light = INFINITY, green = INFINITY;
        for (const std::int32_t age : {0, 40, 180, 500, 2000}) {
            auto plants = turf(species);
            for (Tuft& t : plants) t.age = age;
            const Vec3d seen = look_at(plants, 45).colour;
            EXPECT_LT(luminance(seen), light) << age;
            EXPECT_LT(seen.y / seen.x, green) << age;
            light = luminance(seen);
            green = seen.y / seen.x;
        }
    }
}

/// Highest point that rays from the side meet of the plant at x, over the feet [diameters].
double seen_height(const Tufts& tufts, double x = 0)
{
    for (double z = 1.6; z > 0; z -= 0.004)
        for (double side = -0.7; side < 0.7; side += 0.002)
            if (tufts.occluded(Vec3f(Vec3d(x + side, -3, z)), {0, 1, 0}, 9)) return z;
    return 0;
}

TEST(Tufts, CapsulesStandOnMossOfGrowthTwoAndMore)
{
    for (std::int32_t species = 1; species <= 4; ++species)
        for (const std::int64_t id : {1, 2, 5}) {
            SCOPED_TRACE(kSpecies[static_cast<std::size_t>(species - 1)]);
            Tuft t;
            t.orient = upright(0.4);
            t.species = species;
            t.id = id;
            t.growth = 1.99f;
            Tuft other = t;
            other.growth = 2;
            other.position.x = 3;
            const double green = seen_height(Tufts({t}, kSpecies, 1, 1));
            const Tufts both({t, other}, kSpecies, 1, 1);
            const double ripe = seen_height(both, 3);
            EXPECT_EQ(seen_height(both), green);
            EXPECT_GT(ripe, green + 0.03);
            EXPECT_LT(ripe, 1.45);
            other.growth = 7;
            EXPECT_EQ(seen_height(Tufts({other}, kSpecies, 1, 1), 3), ripe);
        }
}

TEST(Tufts, APlantOfManyCostsLittleMoreThanItsPlace)
{
    std::vector<Tuft> plants;
    for (int i = 0; i < 20000; ++i) {
        Tuft t;
        t.position = Vec3d(0.02 * (i % 200), 0.02 * (i / 200), 0);
        t.orient = upright(i);
        t.species = 1 + i % 4;
        t.growth = 0.1f * static_cast<float>(i % 25);
        plants.push_back(t);
    }
    const TuftView far{Vec3d(0, 0, 40), 0.001};
    const Tufts few({plants.begin(), plants.begin() + 2000}, kSpecies, kSize, 1, far);
    const Tufts many(plants, kSpecies, kSize, 1, far);
    EXPECT_LT(static_cast<double>(many.memory_bytes() - few.memory_bytes()) / 18000, 1000);
    EXPECT_LT(many.triangles(), 40u * plants.size());
}

TEST(Tufts, APlantKeepsItsLookWhenOthersBeforeItDie)
{
    auto plants = turf(1);
    for (std::size_t i = 0; i < plants.size(); ++i) plants[i].id = static_cast<std::int64_t>(7 * i);
    const std::vector<Tuft> left(plants.begin() + 60, plants.end());
    const Tufts all(plants, kSpecies, kSize, 1), some(left, kSpecies, kSize, 1);
    int met = 0;
    for (const Tuft& t : left) {
        const Vec3f from(t.position + Vec3d(0.001, 0.002, 1));
        TuftHit a, b;
        if (!all.intersect(from, {0, 0, -1}, 9, a) || a.tuft < 60) continue;
        ASSERT_TRUE(some.intersect(from, {0, 0, -1}, 9, b));
        EXPECT_EQ(a.tuft, b.tuft + 60);
        EXPECT_EQ(a.triangle, b.triangle);
        SurfacePoint p;
        EXPECT_EQ(all.material(a, p).albedo, some.material(b, p).albedo);
        ++met;
    }
    EXPECT_GT(met, 40);
}

TEST(Tufts, WhatCannotBeDrawnIsNamed)
{
    Tuft t;
    t.wetness = NAN;
    EXPECT_THAT(
        [&] { Tufts({t}, kSpecies, kSize, 1); },
        ThrowsMessage<InvalidInput>(HasSubstr("render: moss 0 has growth 1.9 and wetness nan")));
}

}  // namespace
}  // namespace sekitei::render
