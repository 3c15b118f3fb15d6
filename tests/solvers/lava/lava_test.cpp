#include "solvers/lava/lava.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <numbers>
#include <sstream>

#include "core/error.h"
#include "core/log.h"
#include "grids/level_set.h"
#include "tests/support/shapes.h"

namespace sekitei::lava {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

const Progress kQuiet;

Result make(Params params, const Inputs& inputs = {}, std::uint64_t seed = 5)
{
    log::set_level(log::Level::Warning);
    return run(inputs, params, seed, kQuiet);
}

Params plain(Preset preset)
{
    Params params;
    params.preset = preset;
    params.noise_amplitude = 0;
    return params;
}

std::int32_t id_at(const IntGrid& region, Coord c)
{
    return region.value(c);
}

std::array<std::int64_t, 3> counts(const IntGrid& region, const Domain& domain)
{
    std::array<std::int64_t, 3> n{};
    for (int x = 0; x < domain.dims.x; ++x)
        for (int y = 0; y < domain.dims.y; ++y)
            for (int z = 0; z < domain.dims.z; ++z)
                ++n[static_cast<std::size_t>(region.value({x, y, z}))];
    return n;
}

/// The regions of the paper's presets by their definitions in box coordinates.
std::int32_t defined(Preset preset, Vec3d u)
{
    const double t = 3.0 / 32;
    switch (preset) {
        case Preset::Chevron:
            return u.z > 1 - t || u.z < t ? kCold : kLava;
        case Preset::Rosette:
            if (u.z > 1 - t || u.z < t) return kCold;
            return length(u - Vec3d(0.5)) < 0.15 ? kSlow : kLava;
        case Preset::Fan:
            if (u.z > 1 - t) return kCold;
            return u.z < 0.12 + 1.6 * (u.x - 0.5) * (u.x - 0.5) ? kSlow : kLava;
        case Preset::Basin:
            return u.z <= 1 - t ? kLava : u.x < 0.5 ? kCold : kSlow;
        case Preset::Cliff:
            return u.z > 1 - t ? kCold : u.z < 0.2 ? kSlow : kLava;
        case Preset::Tower: {
            if (u.z > 1 - t) return kCold;
            const double r2 = (u.x - 0.5) * (u.x - 0.5) + (u.y - 0.5) * (u.y - 0.5);
            return u.z < std::min(0.55, 0.10 + 0.9 * r2) ? kSlow : kLava;
        }
        case Preset::Coast:
            return u.z > 1 - t ? kCold : u.z < 0.1 ? kSlow : kLava;
        default:
            return u.z > 0.75 ? kCold : u.z < 0.25 ? kSlow : kLava;
    }
}

TEST(Lava, CoarseCellsOfChevronAndFanAreTheKnownNumbers)
{
    const Result chevron = make(plain(Preset::Chevron)), fan = make(plain(Preset::Fan));
    EXPECT_EQ(chevron.heat_domain.dims, Coord(32, 32, 32));
    EXPECT_EQ(chevron.domain.dims, Coord(250, 250, 250));
    EXPECT_EQ(counts(chevron.region_coarse, chevron.heat_domain),
              (std::array<std::int64_t, 3>{26624, 6144, 0}));
    EXPECT_EQ(counts(fan.region_coarse, fan.heat_domain),
              (std::array<std::int64_t, 3>{21504, 3072, 8192}));
}

class EachPreset : public testing::TestWithParam<Preset> {};

TEST_P(EachPreset, HasTheRegionsOfItsDefinitionAtBothResolutions)
{
    Params params = plain(GetParam());
    params.voxel = 0.3;
    params.size = Vec3d(45 * 0.3, 62 * 0.3, 39 * 0.3);  // odd, so that x = 1/2 meets centres
    if (GetParam() == Preset::Rosette) params.size = Vec3d(45 * 0.3);
    const Result r = make(params);
    std::size_t wrong = 0;
    for (const auto& [grid, domain] :
         {std::pair(&r.region, &r.domain), std::pair(&r.region_coarse, &r.heat_domain)}) {
        const Vec3d box = Vec3d(r.domain.dims) * r.domain.transform.voxel;
        for (int x = 0; x < domain->dims.x; ++x)
            for (int y = 0; y < domain->dims.y; ++y)
                for (int z = 0; z < domain->dims.z; ++z) {
                    const Vec3d p = domain->transform.world(centre_of({x, y, z}));
                    const std::int32_t id =
                        defined(GetParam(), {p.x / box.x, p.y / box.y, p.z / box.z});
                    wrong +=
                        grid->value({x, y, z}) != id || grid->active({x, y, z}) != (id != kCold);
                }
    }
    EXPECT_EQ(wrong, 0u);
    const auto fine = counts(r.region, r.domain);
    EXPECT_EQ(r.lava_voxels, static_cast<double>(fine[kLava]));
    EXPECT_EQ(r.cold_voxels, static_cast<double>(fine[kCold]));
    EXPECT_EQ(r.slow_voxels, static_cast<double>(fine[kSlow]));
    EXPECT_EQ(r.region.active_count(), static_cast<std::uint64_t>(fine[kLava] + fine[kSlow]));
}

TEST_P(EachPreset, LevelSetsHaveTheSignsOfTheRegions)
{
    Params params;  // with noise
    params.preset = GetParam();
    params.size = Vec3d(64, 40, 56);
    params.voxel = 1;
    const Result r = make(params);
    std::size_t wrong = 0;
    for (int x = 0; x < r.domain.dims.x; ++x)
        for (int y = 0; y < r.domain.dims.y; ++y)
            for (int z = 0; z < r.domain.dims.z; ++z) {
                const Coord c{x, y, z};
                const std::int32_t id = r.region.value(c);
                wrong += (r.body_sdf.value(c) > 0) != (id == kCold);
                wrong += (r.slow_sdf.value(c) < 0) != (id == kSlow);
            }
    EXPECT_EQ(wrong, 0u);
    EXPECT_EQ(r.slow_sdf.leaf_count() == 0, GetParam() == Preset::Chevron);
}

TEST_P(EachPreset, IsTheSameTenTimesLargerAndOnAnyNumberOfThreads)
{
    Params params;
    params.preset = GetParam();
    params.size = Vec3d(4.1, 3.3, 2.9);
    params.voxel = 0.07;
    const Result one = make(params);
    params.size = *params.size * 10.0;
    params.voxel = 0.7;
    for (const std::size_t threads : {1u, 2u, 7u}) {
        const ThreadLimit limit(threads);
        const Result ten = make(params);
        ASSERT_EQ(one.region.topology()->origins(), ten.region.topology()->origins());
        ASSERT_EQ(one.heat_domain.dims, ten.heat_domain.dims);
        std::size_t differing = 0;
        for (std::size_t leaf = 0; leaf < one.region.leaf_count(); ++leaf)
            for (int o = 0; o < kLeafSize; ++o)
                differing += one.region.at(leaf, o) != ten.region.at(leaf, o);
        for (std::size_t leaf = 0; leaf < one.region_coarse.leaf_count(); ++leaf)
            for (int o = 0; o < kLeafSize; ++o)
                differing += one.region_coarse.at(leaf, o) != ten.region_coarse.at(leaf, o);
        EXPECT_EQ(differing, 0u);
    }
}

INSTANTIATE_TEST_SUITE_P(Lava, EachPreset,
                         testing::Values(Preset::Chevron, Preset::Rosette, Preset::Fan,
                                         Preset::Basin, Preset::Cliff, Preset::Tower, Preset::Coast,
                                         Preset::Slab),
                         [](const auto& preset) {
                             return std::string(choice_names(
                                 preset.param)[static_cast<std::size_t>(preset.param)]);
                         });

TEST(Lava, ScenesHaveTheBoxesOfThePaper)
{
    auto boxes = [](Preset preset) {
        const Params params = plain(preset);
        const Estimate e = estimate(params, {});
        EXPECT_EQ(e.voxels, double(e.dims.x) * e.dims.y * e.dims.z);
        return e.dims;
    };
    EXPECT_EQ(boxes(Preset::Cliff), Coord(500, 50, 300));
    EXPECT_EQ(boxes(Preset::Tower), Coord(200, 200, 200));
    EXPECT_EQ(boxes(Preset::Coast), Coord(300, 300, 300));
    EXPECT_EQ(boxes(Preset::Slab), Coord(200, 200, 200));
    const Result cliff = make(plain(Preset::Cliff));
    EXPECT_EQ(cliff.heat_domain.dims, Coord(63, 7, 38));  // ceil(dims / (500 / 63))
    EXPECT_EQ(cliff.heat_domain.transform.origin, cliff.domain.transform.origin);
}

TEST(Lava, LevelSetOfTheValleyIsItsDistanceWithinAFewHundredths)
{
    const Result r = make(plain(Preset::Fan));
    double worst = 0;
    for (int x = 3; x < 250; x += 13)
        for (int z = 20; z < 140; ++z) {
            const Vec3d p = centre_of({x, 117, z});
            double nearest = INFINITY;
            for (double s = p.x - 8; s < p.x + 8; s += 0.01) {
                const double h = 250 * (0.12 + 1.6 * (s / 250 - 0.5) * (s / 250 - 0.5));
                nearest = std::min(nearest, std::hypot(s - p.x, h - p.z));
            }
            if (nearest > 3.5) continue;
            const double v = r.slow_sdf.value({x, 117, z}) / 0.04;
            worst = std::max(worst, std::fabs(std::fabs(v) - nearest));
        }
    EXPECT_LT(worst, 0.05);
    EXPECT_GT(worst, 0);
}

TEST(Lava, LevelSetsKnowNoBoxWallsAndGoOnOneLeafBeyond)
{
    const Result r = make(plain(Preset::Chevron));
    const double bottom = 250 * 3.0 / 32;
    for (const Coord c :
         {Coord(-8, 120, 24), Coord(0, 0, 24), Coord(257, 257, 24), Coord(249, 3, 24)})
        EXPECT_NEAR(r.body_sdf.value(c), (bottom - 24.5) * 0.04, 1e-6);
    EXPECT_EQ(r.body_sdf.value({0, 120, 120}), -r.body_sdf.background());
}

TEST(Lava, CostFollowsTheSurface)
{
    const Result r = make(plain(Preset::Chevron));
    EXPECT_LT(r.body_sdf.dense_leaf_count(), r.body_sdf.leaf_count() / 4);
    EXPECT_LT(r.region.dense_leaf_count(), r.region.leaf_count() / 4);
}

TEST(Lava, NoiseMovesEachBoundaryByItselfWithinItsAmplitude)
{
    Params params;
    params.preset = Preset::Chevron;
    params.size = Vec3d(80, 70, 100);
    params.voxel = 1;
    params.noise_amplitude = 0.06;
    const Result a = make(params, {}, 1), b = make(params, {}, 2);
    double top_move = 0, bottom_move = 0, difference = 0, correlation = 0, largest = 0;
    for (int x = 0; x < 80; ++x)
        for (int y = 0; y < 70; ++y) {
            auto height = [&](const Result& r, int from, int to) {
                double lava = 0;
                for (int z = from; z < to; ++z) lava += r.region.value({x, y, z}) == kLava;
                return lava;
            };
            const double top = 50 + height(a, 50, 100) - 100 * 29.0 / 32,
                         bottom = 50 - height(a, 0, 50) - 100 * 3.0 / 32;
            largest = std::max({largest, std::fabs(top), std::fabs(bottom)});
            top_move += top * top;
            bottom_move += bottom * bottom;
            correlation += top * bottom;
            difference += std::fabs(height(a, 50, 100) - height(b, 50, 100));
        }
    EXPECT_LE(largest, 6.5);
    EXPECT_GT(std::sqrt(top_move / 5600), 0.5);
    EXPECT_GT(std::sqrt(bottom_move / 5600), 0.5);
    EXPECT_LT(std::fabs(correlation) / std::sqrt(top_move * bottom_move), 0.7);
    EXPECT_GT(difference / 5600, 0.5);
}

TEST(Lava, HeightMapKeepsItsHeightsAndItsCompass)
{
    Inputs inputs;
    inputs.height_map = Image16(5, 3, 1);
    for (int y = 0; y < 3; ++y)
        for (int x = 0; x < 5; ++x)
            inputs.height_map->at(x, y) = static_cast<std::uint16_t>(6000 * x + 9000 * y);
    inputs.height_map->at(4, 0) = 65535;  // the north-eastern corner
    Params params = plain(Preset::HeightMap);
    params.metres_per_pixel = 20;
    params.height_low = 130;
    params.height_high = 190;
    params.base = 117.3;
    params.voxel = 0.8;
    const Result r = make(params, inputs);
    EXPECT_EQ(r.domain.dims.x, 125);
    EXPECT_EQ(r.domain.dims.y, 75);
    EXPECT_EQ(r.domain.transform.origin, Vec3d(0, 0, 117.3));
    for (int py = 0; py < 3; ++py)
        for (int px = 0; px < 5; ++px) {
            // The column whose centre is nearest to the pixel's centre; north is up.
            const int x = static_cast<int>((px + 0.5) * 25),
                      y = static_cast<int>((2 - py + 0.5) * 25);
            int lava = 0;
            while (r.region.value({x, y, lava}) == kLava) ++lava;
            const double wanted = 130 + 60.0 * inputs.height_map->at(px, py) / 65535;
            EXPECT_NEAR(117.3 + lava * 0.8, wanted, 0.5 * 0.8 + 0.6) << px << " " << py;
        }
    // Cold above, nothing but lava down to the base; the eastern neighbour of the peak is the wall.
    EXPECT_EQ(id_at(r.region, {118, 70, r.domain.dims.z - 1}), kCold);
    EXPECT_EQ(id_at(r.region, {0, 0, 0}), kLava);
}

TEST(Lava, HeightMapOnAFlatPlainIsWithinHalfAVoxelEverywhere)
{
    Inputs inputs;
    inputs.height_map = Image16(7, 4, 1);
    for (auto& grey : inputs.height_map->pixels) grey = 40000;
    Params params = plain(Preset::HeightMap);
    params.metres_per_pixel = 11;
    params.height_low = 0;
    params.height_high = 50;
    params.cold_ground = true;
    params.base = 3;
    params.voxel = 0.61;
    const Result r = make(params, inputs);
    const double top = 50.0 * 40000 / 65535, columns = double(r.domain.dims.x) * r.domain.dims.y;
    EXPECT_NEAR(r.lava_voxels / columns * 0.61, top - 3, 0.61);
    EXPECT_GT(r.cold_voxels / columns, 30);  // two heat cells above and below
    params.cold_ground = false;
    params.slow = SlowPart::Below;
    params.slow_below = 10;
    const Result with_slow = make(params, inputs);
    EXPECT_NEAR(with_slow.slow_voxels / columns * 0.61, 10 - 3, 0.61);
}

TEST(Lava, TheVolcanoOfTheDataFolderHasItsSummitInTheSouth)
{
    const std::filesystem::path picture =
        std::filesystem::path(SEKITEI_DATA) / "terrain" / "maunga-whau.png";
    Inputs inputs;
    inputs.height_map = read_png_grey16(picture);
    EXPECT_EQ(inputs.height_map->width, 61);
    EXPECT_EQ(inputs.height_map->height, 87);
    Params params = plain(Preset::HeightMap);
    params.metres_per_pixel = 10;
    params.height_low = 94;
    params.height_high = 195;
    params.base = 60;
    params.voxel = 4;
    const Result r = make(params, inputs);
    double summit = 0;
    Coord at;
    for (int x = 0; x < r.domain.dims.x; ++x)
        for (int y = 0; y < r.domain.dims.y; ++y) {
            int z = 0;
            while (r.region.value({x, y, z}) == kLava) ++z;
            if (z > summit) {
                summit = z;
                at = {x, y, z};
            }
        }
    EXPECT_NEAR(60 + summit * 4, 195, 4);
    // The highest number of R's matrix is volcano[20, 31]: row 20 of 87 from the south, column 31
    // of 61 from the east.
    EXPECT_NEAR(at.y * 4, 195, 25);
    EXPECT_NEAR(at.x * 4, 305, 25);
}

Inputs mesh_inputs(TriMesh mesh)
{
    Inputs inputs;
    inputs.mesh = std::move(mesh);
    return inputs;
}

TEST(Lava, ABallMeshKeepsItsVolumeInABoxWithTwoHeatCellsAround)
{
    Params params = plain(Preset::Mesh);
    params.voxel = 0.1;
    const Result r = make(params, mesh_inputs(shapes::ball({10, -20, 30}, 2.6, 5)));
    EXPECT_NEAR(r.lava_voxels * 1e-3 / (4 * std::numbers::pi / 3 * std::pow(2.6, 3)), 1, 5e-3);
    EXPECT_EQ(r.domain.dims, Coord(84, 84, 84));  // 52 + 2 * 16
    EXPECT_NEAR(r.domain.transform.origin.y, -20 - 2.6 - 1.6, 1e-5);
    const double cell = r.heat_domain.transform.voxel;
    EXPECT_NEAR(static_cast<double>(r.region_coarse.active_count()) * cell * cell * cell /
                    (r.lava_voxels * 1e-3),
                1, 0.1);
    EXPECT_EQ(r.slow_voxels, 0);
    // mesh_scale is metres per unit.
    params.mesh_scale = 0.1;
    const Result scaled = make(params, mesh_inputs(shapes::ball({100, -200, 300}, 26, 5)));
    EXPECT_NEAR(scaled.lava_voxels, r.lava_voxels, 0.002 * r.lava_voxels);
}

TEST(Lava, SlowGroundBelowABodyIsPartOfItsRockWithoutASeam)
{
    Params params = plain(Preset::Mesh);
    params.voxel = 0.1;
    params.slow = SlowPart::Below;
    params.slow_below = 1;  // exactly the lower face
    const Result r = make(params, mesh_inputs(shapes::box({0, 0, 1}, {4, 3, 3.5})));
    EXPECT_NEAR(r.lava_voxels, 40 * 30 * 25, 1e-9);
    EXPECT_NEAR(r.slow_voxels, double(r.domain.dims.x) * r.domain.dims.y * 16, 1e-9);
    // On the contact, in the middle of the face, the surface is far.
    EXPECT_LT(r.body_sdf.value({36, 31, 16}), -0.3);
    EXPECT_LT(r.body_sdf.value({36, 31, 15}), -0.3);
    EXPECT_NEAR(r.slow_sdf.value({36, 31, 15}), -0.05, 0.01);
}

TEST(Lava, FacesThatLookDownOrBelongToAGroupCarryAHotLayer)
{
    TriMesh box = shapes::box({0, 0, 0}, {4, 3, 2.5});
    Params params = plain(Preset::Mesh);
    params.voxel = 0.1;
    params.slow = SlowPart::FacingDown;
    params.slow_thickness = 0.6;
    const Result down = make(params, mesh_inputs(box));
    const Result turned = make(params, mesh_inputs(shapes::inverted(box)));
    EXPECT_EQ(down.slow_voxels, turned.slow_voxels);
    const Coord below{36, 31, 12}, beside{12, 31, 28}, deep{36, 31, 8};  // the box starts at 16
    EXPECT_EQ(id_at(down.region, below), kSlow);
    EXPECT_EQ(id_at(down.region, beside), kCold);
    EXPECT_EQ(id_at(down.region, deep), kCold);
    EXPECT_NEAR(down.lava_voxels, 40 * 30 * 25, 1e-9);
    EXPECT_GT(down.slow_voxels, 40 * 30 * 6 * 0.95);
    EXPECT_LT(down.slow_voxels, 52 * 42 * 7);

    Inputs inputs = mesh_inputs(box);
    inputs.mesh_groups = {"walls", "vent"};
    std::vector<std::int32_t> groups(12, 0);
    groups[0] = groups[1] = 1;  // the face at x = 0
    inputs.mesh->face_attributes["group"] = groups;
    params.slow = SlowPart::Group;
    params.slow_group = "vent";
    const Result vent = make(params, inputs);
    EXPECT_EQ(id_at(vent.region, beside), kSlow);
    EXPECT_EQ(id_at(vent.region, below), kCold);
    params.slow_group = "went";
    EXPECT_THAT([&] { make(params, inputs); },
                ThrowsMessage<InvalidInput>(HasSubstr("walls, vent")));
}

TEST(Lava, AnOpenMeshIsRepairedWithItsCountToldOrRefusedWhenStrict)
{
    TriMesh open = shapes::box({0, 0, 0}, {4, 3, 2.5});
    open.triangles.resize(10);
    Params params = plain(Preset::Mesh);
    params.voxel = 0.1;
    std::string told;
    log::set_sink([&](log::Level, const std::string& line) { told += line + "\n"; });
    const Result r = make(params, mesh_inputs(open));
    log::set_sink({});
    EXPECT_NEAR(r.lava_voxels, 40 * 30 * 25, 1);
    EXPECT_THAT(told, HasSubstr("4 open"));
    params.strict = true;
    EXPECT_THAT([&] { make(params, mesh_inputs(open)); },
                ThrowsMessage<InvalidInput>(HasSubstr("4 open, 0 non-manifold")));
    EXPECT_NO_THROW(make(params, mesh_inputs(shapes::box({0, 0, 0}, {4, 3, 2.5}))));
}

TEST(Lava, WhatAnyPartOfASelfIntersectingMeshEnclosesIsInsideAndTheCrossingsAreTold)
{
    // Two boxes that overlap in 1.5 x 1 x 0.5.
    TriMesh both = shapes::box({0, 0, 0}, {4, 3, 2.5});
    const TriMesh other = shapes::box({2.5, 2, 2}, {5, 4, 4});
    for (const auto& [a, b, c] : other.triangles) both.triangles.push_back({a + 8, b + 8, c + 8});
    both.vertices.insert(both.vertices.end(), other.vertices.begin(), other.vertices.end());
    Params params = plain(Preset::Mesh);
    params.voxel = 0.1;
    std::string told;
    log::set_sink([&](log::Level, const std::string& line) { told += line + "\n"; });
    const Result r = make(params, mesh_inputs(both));
    EXPECT_THAT(told, HasSubstr("the mesh intersects itself: "));
    EXPECT_THAT(told, HasSubstr("counts as inside"));
    told.clear();
    make(params, mesh_inputs(other));
    log::set_sink({});
    EXPECT_EQ(told, "");
    const double volume = 4 * 3 * 2.5 + 2.5 * 2 * 2 - 1.5 * 1 * 0.5;
    EXPECT_NEAR(r.lava_voxels, volume * 1000, volume * 1000 * 2e-3);
}

TEST(Lava, AScannedBunnyIsABodyAlsoWithItsFeetCutOff)
{
    const std::filesystem::path path = "/usr/share/glmark2/models/bunny.obj";
    if (!std::filesystem::exists(path)) GTEST_SKIP() << "needs the package glmark2-data";
    TriMesh mesh;
    std::ifstream file(path);
    for (std::string line; std::getline(file, line);) {
        std::istringstream words(line);
        std::string kind;
        words >> kind;
        if (kind == "v") {
            Vec3f v;
            words >> v.x >> v.y >> v.z;
            mesh.vertices.push_back(v);
        } else if (kind == "f") {
            std::array<std::uint32_t, 3> t{};
            for (auto& index : t) {
                std::string word;
                words >> word;
                index = static_cast<std::uint32_t>(std::stoul(word) - 1);
            }
            mesh.triangles.push_back(t);
        }
    }
    const MeshReport report = inspect(mesh);
    Params params = plain(Preset::Mesh);
    params.voxel = mesh.bounds().size().y / 60;
    const Result whole = make(params, mesh_inputs(mesh));
    const double volume = std::fabs(report.volume) / std::pow(*params.voxel, 3);
    EXPECT_EQ(report.open_edges, 0u);
    EXPECT_NEAR(whole.lava_voxels / volume, 1, 0.02);
    // Cut the lowest fiftieth off: what is left is closed near the cut.
    const double floor = mesh.bounds().lower.y + mesh.bounds().size().y / 50;
    std::erase_if(mesh.triangles, [&](const auto& t) {
        return mesh.vertices[t[0]].y < floor || mesh.vertices[t[1]].y < floor ||
               mesh.vertices[t[2]].y < floor;
    });
    EXPECT_GT(inspect(mesh).open_edges, 0u);
    const Result cut = make(params, mesh_inputs(mesh));
    EXPECT_LT(cut.lava_voxels, whole.lava_voxels);
    EXPECT_GT(cut.lava_voxels, 0.95 * whole.lava_voxels);
}

Scene scene_of(const Result& result)
{
    Scene scene;
    scene.grids["region"].values = result.region;
    return scene;
}

TEST(Lava, ARegionMadeElsewhereComesBackVoxelForVoxel)
{
    Params params = plain(Preset::Rosette);
    params.size = Vec3d(9.1, 8.3, 7.7);
    params.voxel = 0.14;
    const Result made = make(params);
    Scene scene = scene_of(made);
    scene.domain = made.domain;
    Inputs inputs;
    inputs.volume = &scene;
    const Result back = make(plain(Preset::Volume), inputs);
    EXPECT_EQ(back.domain, made.domain);
    EXPECT_EQ(back.heat_domain, made.heat_domain);
    std::size_t fine = 0, coarse = 0;
    double worst = 0;
    for (int x = 0; x < made.domain.dims.x; ++x)
        for (int y = 0; y < made.domain.dims.y; ++y)
            for (int z = 0; z < made.domain.dims.z; ++z) {
                const Coord c{x, y, z};
                fine += back.region.value(c) != made.region.value(c);
                if (std::fabs(made.body_sdf.value(c)) < 3 * 0.14)
                    worst = std::max(
                        worst, std::fabs(double(back.body_sdf.value(c)) - made.body_sdf.value(c)));
            }
    for (int x = 0; x < made.heat_domain.dims.x; ++x)
        for (int y = 0; y < made.heat_domain.dims.y; ++y)
            for (int z = 0; z < made.heat_domain.dims.z; ++z)
                coarse +=
                    back.region_coarse.value({x, y, z}) != made.region_coarse.value({x, y, z});
    EXPECT_EQ(fine, 0u);
    EXPECT_EQ(coarse, 0u);
    EXPECT_LT(worst / 0.14, 0.51);
}

TEST(Lava, AForeignLevelSetAnywhereInSpaceBecomesABodyWithACommonMargin)
{
    const TriMesh ball = shapes::ball({-7, 5, 3}, 1.9, 4);
    Scene scene;  // indices from about -100: nothing starts at zero
    const Transform transform{{2, 3, 1}, 0.09};
    scene.grids["sdf"].values = level_set_from_mesh(ball, transform, kQuiet);
    scene.grids["sdf"].grid_class = GridClass::LevelSet;
    Inputs inputs;
    inputs.volume = &scene;
    const Result r = make(plain(Preset::Volume), inputs);
    EXPECT_NEAR(r.lava_voxels * std::pow(0.09, 3) / ball.signed_volume(), 1, 0.005);
    const Vec3d middle = r.domain.transform.voxels({-7, 5, 3});
    EXPECT_EQ(id_at(r.region, Coord(static_cast<int>(middle.x), static_cast<int>(middle.y),
                                    static_cast<int>(middle.z))),
              kLava);
    const Vec3d world = r.domain.transform.world(Vec3d(0.0));
    EXPECT_LT(world.x, -7 - 1.9 - 16 * 0.09 + 0.1);
    // Voxels stay where they were.
    const Vec3d shift = transform.voxels(world);
    EXPECT_NEAR(shift.x, std::round(shift.x), 1e-6);

    scene.grids["other"] = scene.grids["sdf"];
    EXPECT_THAT([&] { make(plain(Preset::Volume), inputs); },
                ThrowsMessage<InvalidInput>(HasSubstr("2 level sets in the volume (other, sdf)")));
    Params wrong = plain(Preset::Volume);
    wrong.voxel = 0.2;
    scene.grids.erase("other");
    EXPECT_THAT([&] { make(wrong, inputs); }, ThrowsMessage<InvalidParameter>(HasSubstr("0.09 m")));
}

TEST(Lava, AForeignRegionWithColdVoxelsKeepsItsOwnBox)
{
    Scene scene;
    IntGrid region(box_topology({-13, 4, 7}, {20, 30, 41}), {{1, 2, 3}, 0.5}, 1);
    region.expand();
    for (std::size_t leaf = 0; leaf < region.leaf_count(); ++leaf)
        for (int o = 0; o < kLeafSize; ++o) {
            const Coord c = leaf_coord(region.origin(leaf), o);
            if (c.x < -13 || c.y < 4 || c.z < 7 || c.x >= 20 || c.y >= 30 || c.z >= 41) continue;
            region.values(leaf)[o] = c.z >= 35 ? 1 : c.z < 12 ? 2 : 0;
            region.mask(leaf).set(o);
        }
    scene.grids["region"].values = region;
    Inputs inputs;
    inputs.volume = &scene;
    const Result r = make(plain(Preset::Volume), inputs);
    EXPECT_EQ(r.domain.dims, Coord(33, 26, 34));
    EXPECT_EQ(r.domain.transform.origin, Vec3d(1 - 6.5, 2 + 2, 3 + 3.5));
    EXPECT_EQ(r.lava_voxels, 33.0 * 26 * 23);
    EXPECT_EQ(r.slow_voxels, 33.0 * 26 * 5);
    EXPECT_EQ(r.cold_voxels, 33.0 * 26 * 6);
    region.values(0)[leaf_offset({-9, 7, 7})] = 5;
    scene.grids["region"].values = region;
    EXPECT_THAT([&] { make(plain(Preset::Volume), inputs); },
                ThrowsMessage<InvalidInput>(HasSubstr("the first is 5 at (-9, 7, 7)")));
}

TEST(Lava, EstimatesAbsurdRequestsInNumbersAndRefusesThem)
{
    Params params = plain(Preset::Chevron);
    params.size = Vec3d(10, 10, 10);
    params.voxel = 1e-9;
    const Estimate e = estimate(params, {});
    EXPECT_NEAR(e.voxels / 1e30, 1, 1e-6);
    EXPECT_GT(e.bytes, 1e27);
    EXPECT_EQ(e.dims, Coord(INT32_MAX, INT32_MAX, INT32_MAX));
    EXPECT_THAT([&] { make(params); },
                ThrowsMessage<LimitExceeded>(HasSubstr("use a larger voxel")));
    params.voxel = 0.05;
    EXPECT_EQ(estimate(params, {}).voxels, 8e6);
    EXPECT_LT(estimate(params, {}).bytes, 2e8);
}

TEST(Lava, NamesWhatIsWrong)
{
    auto running = [](Params params, Inputs inputs = {}) {
        return [params, inputs] { make(params, inputs); };
    };
    Params p = plain(Preset::Chevron);
    p.voxel = 0;
    EXPECT_THAT(running(p), ThrowsMessage<InvalidParameter>(HasSubstr("lava: voxel = 0")));
    p.voxel = -1;
    EXPECT_THAT(running(p), ThrowsMessage<InvalidParameter>(HasSubstr("voxel = -1")));
    p.voxel = NAN;
    EXPECT_THROW(running(p)(), InvalidParameter);
    p = plain(Preset::Chevron);
    p.heat_cell = 0.01;
    EXPECT_THAT(running(p), ThrowsMessage<InvalidParameter>(HasSubstr("heat_cell = 0.01 m")));
    p = plain(Preset::Chevron);
    p.size = Vec3d(3, -2, 1);
    EXPECT_THROW(running(p)(), InvalidParameter);
    p.size = Vec3d(0.01, 0.01, 0.01);
    p.voxel = 0.01;
    EXPECT_NO_THROW(running(p)());  // one voxel, its centre in the lava
    p = plain(Preset::Chevron);
    p.slow = SlowPart::Below;
    EXPECT_THAT(running(p), ThrowsMessage<InvalidParameter>(HasSubstr("slow = below")));
    EXPECT_THAT(running(plain(Preset::Mesh)), ThrowsMessage<InvalidInput>(HasSubstr("--mesh")));
    EXPECT_THAT(running(plain(Preset::HeightMap)),
                ThrowsMessage<InvalidInput>(HasSubstr("--height-map")));
    EXPECT_THAT(running(plain(Preset::Volume)), ThrowsMessage<InvalidInput>(HasSubstr(".vdb")));
    TriMesh points;
    points.vertices = {{0, 0, 0}, {1, 2, 3}};
    EXPECT_THAT(running(plain(Preset::Mesh), mesh_inputs(points)),
                ThrowsMessage<InvalidInput>(HasSubstr("no triangles")));
    TriMesh lone = shapes::box({0, 0, 0}, {1, 1, 1});
    lone.triangles.resize(1);
    EXPECT_THAT(running(plain(Preset::Mesh), mesh_inputs(lone)),
                ThrowsMessage<InvalidInput>(HasSubstr("close its holes")));
    TriMesh nan = shapes::box({0, 0, 0}, {1, 1, 1});
    nan.vertices[3].z = NAN;
    EXPECT_THAT(running(plain(Preset::Mesh), mesh_inputs(nan)),
                ThrowsMessage<InvalidInput>(HasSubstr("vertex 3")));
    p = plain(Preset::Mesh);
    p.size = Vec3d(1, 1, 1);
    EXPECT_THAT(running(p, mesh_inputs(shapes::box({0, 0, 0}, {1, 1, 1}))),
                ThrowsMessage<InvalidParameter>(HasSubstr("size goes with")));
    Scene empty;
    Inputs volume;
    volume.volume = &empty;
    EXPECT_THAT(running(plain(Preset::Volume), volume),
                ThrowsMessage<InvalidInput>(HasSubstr("no grids")));
    Inputs flat;
    flat.height_map = Image16(4, 4, 1);
    p = plain(Preset::HeightMap);
    EXPECT_THAT(running(p, flat), ThrowsMessage<InvalidParameter>(HasSubstr("metres_per_pixel")));
    p.metres_per_pixel = 2.5;
    p.height_low = -1;
    p.height_high = 0.5;
    p.base = 1;
    EXPECT_THAT(running(p, flat), ThrowsMessage<InvalidParameter>(HasSubstr("base = 1 m")));
}

TEST(Lava, TinyAndHugeMeshesGetAVoxelOfTheirSizeAndAWarning)
{
    for (const double size : {1e-6, 1e6}) {
        std::string told;
        log::set_sink([&](log::Level, const std::string& line) { told += line; });
        const Result r =
            make(plain(Preset::Mesh), mesh_inputs(shapes::ball({0, 0, 0}, size / 2, 3)));
        log::set_sink({});
        EXPECT_THAT(told, HasSubstr("--mesh-scale"));
        EXPECT_NEAR(r.domain.dims.x, 250, 1);
        EXPECT_GT(r.lava_voxels, 1e6);
    }
}

TEST(Lava, StopsWhenAsked)
{
    const std::atomic<bool> stop{true};
    EXPECT_THROW(run({}, plain(Preset::Coast), 1, Progress({}, &stop)), Cancelled);
}

}  // namespace
}  // namespace sekitei::lava
