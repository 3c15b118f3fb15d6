#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include "core/mesh.h"
#include "solvers/weathering/weathering.h"
#include "tests/solvers/presets/chain.h"
#include "tests/solvers/presets/solid.h"

/// What the paper's figure 13 shows of its three scenes, on the recipes as they are delivered.
namespace sekitei::presets {
namespace {

using Overrides = std::vector<std::string>;

/// Recipes in their own boxes with voxels twice as large.
const std::map<std::string, Overrides> kHalfSize{
    {"cliff", {"lava.voxel=8cm"}},
    {"tower", {"lava.voxel=1m", "lava.size=[\"100m\", \"100m\", \"100m\"]"}},
    {"coast", {"lava.voxel=8cm", "lava.size=[\"12m\", \"12m\", \"12m\"]"}},
    {"chevron", {"lava.voxel=8cm", "lava.size=[\"10m\", \"10m\", \"10m\"]"}},
    {"rosette", {"lava.voxel=8cm", "lava.size=[\"10m\", \"10m\", \"10m\"]"}},
    {"fan", {"lava.voxel=8cm", "lava.size=[\"10m\", \"10m\", \"10m\"]"}},
    {"basin", {"lava.voxel=8cm", "lava.size=[\"10m\", \"10m\", \"10m\"]"}},
};

Scene half_size(const std::string& name)
{
    return run_recipe(name, kHalfSize.at(name));
}

Polylines lines_of(const Scene& scene)
{
    return to_polylines(scene.points_of("centre_lines"), scene.domain.transform);
}

class Rock : public testing::TestWithParam<std::string> {};

TEST_P(Rock, IsASolidOfTheVolumeOfItsDensity)
{
    expect_solid(half_size(GetParam()));
}

INSTANTIATE_TEST_SUITE_P(Scenes, Rock,
                         testing::Values("cliff", "tower", "coast", "chevron", "rosette", "fan",
                                         "basin"),
                         [](const auto& scene) { return scene.param; });

/// From the middle to where the walls of the box, which let no heat through, straighten the lines.
TEST(Tower, ColumnsFanOutwardsOnTheirWayDown)
{
    const Scene scene = half_size("tower");
    const Polylines lines = lines_of(scene);
    const Coord n = scene.domain.dims;
    std::array<double, 5> outward{};  // mean share of the direction, by tenths of the radius
    std::array<int, 5> count{};
    for (std::size_t i = 0; i < lines.count(); ++i) {
        const Vec3d start = lines.line(i)[0], way = end_of(lines, i) - start;
        const Vec3d radial(start.x / n.x - .5, start.y / n.y - .5, 0);
        EXPECT_LT(way.z, 0);
        const auto ring = static_cast<std::size_t>(length(radial) / 0.1);
        if (ring >= 5) continue;
        outward[ring] += dot(normalized(way), normalized(radial));
        ++count[ring];
    }
    for (std::size_t r = 0; r < 5; ++r) {
        outward[r] /= count[r];
        EXPECT_GT(outward[r], 0);
    }
    EXPECT_GT(outward[1], outward[0] + 0.03);
    EXPECT_GT(outward[2], outward[1] + 0.03);
    EXPECT_GT(outward[2], 0.1);
}

TEST(Coast, HasOneFlatStepPerColumn)
{
    const Scene scene =
        run_recipe("coast", {"lava.size=[\"6m\", \"6m\", \"6m\"]", "joint.count=300"});
    const TriMesh& mesh = scene.meshes.at("rock");
    const auto& surface = std::get<std::vector<std::int32_t>>(mesh.face_attributes.at("surface"));
    const auto& column = std::get<std::vector<std::int32_t>>(mesh.face_attributes.at("column"));
    const IntGrid& columns = scene.ints("column");
    // Edges are rounded over a voxel: count faces two voxels inside their column.
    auto inside = [&](Vec3d p, std::int32_t id) {
        const Coord c(int(std::floor(p.x)), int(std::floor(p.y)), int(std::floor(p.z - 0.5)));
        for (int x = -2; x <= 2; ++x)
            for (int y = -2; y <= 2; ++y)
                if (columns.value(c + Coord(x, y, 0)) != id) return false;
        return true;
    };
    struct Step {
        double low = INFINITY, high = -INFINITY, area = 0;
    };
    std::map<std::int32_t, Step> steps;
    for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
        if (surface[t] != static_cast<int>(weathering::Surface::TerrainCut)) continue;
        std::array<Vec3d, 3> p;
        for (std::size_t k = 0; k < 3; ++k)
            p[k] = scene.domain.transform.voxels(Vec3d(mesh.vertices[mesh.triangles[t][k]]));
        if (column[t] < 0 || !inside((p[0] + p[1] + p[2]) / 3.0, column[t])) continue;
        Step& step = steps[column[t]];
        step.area += length(cross(p[1] - p[0], p[2] - p[0])) / 2;
        for (const Vec3d& v : p) {
            step.low = std::min(step.low, v.z);
            step.high = std::max(step.high, v.z);
        }
    }
    EXPECT_GT(steps.size(), 285u);
    double area = 0, lowest = INFINITY, highest = 0;
    for (const auto& [id, step] : steps) {
        EXPECT_LT(step.high - step.low, 2e-3) << "column " << id;
        area += step.area;
        lowest = std::min(lowest, step.low);
        highest = std::max(highest, step.high);
    }
    EXPECT_GT(area, 0.15 * 150 * 150);
    EXPECT_GT(highest - lowest, 0.2 * 150);  // the terrain rises by .3 of the box
}

/// What has fallen from a scene, as shares of its box.
struct Fallen {
    double voxels = 0, removed = 0;
    Vec3d lava, gone;                  // centres of the lava and of what fell
    std::array<double, 4> by_depth{};  // share that fell, by quarters behind the open face y = 0
};

Fallen fallen(const Scene& scene)
{
    const IntGrid& component = scene.ints("component");
    const FloatGrid& density = scene.floats("density");
    const Vec3d n(scene.domain.dims);
    Fallen f;
    std::array<double, 4> whole{};
    for (std::size_t i = 0; i < component.leaf_count(); ++i)
        component.mask(i).for_each([&](int o) {
            const Coord c = leaf_coord(component.origin(i), o);
            const Vec3d p = centre_of(c), x(p.x / n.x, p.y / n.y, p.z / n.z);
            const auto quarter = static_cast<std::size_t>(4 * x.y);
            f.lava += x;
            ++f.voxels;
            ++whole[quarter];
            if (density.value(c) >= 0.5f) return;
            f.gone += x;
            ++f.removed;
            ++f.by_depth[quarter];
        });
    f.lava = f.lava / f.voxels;
    f.gone = f.gone / std::max(1.0, f.removed);
    for (std::size_t q = 0; q < 4; ++q) f.by_depth[q] /= whole[q];
    return f;
}

TEST(Cliff, BreaksInTheLowerLeftNearItsOpenFace)
{
    const std::map<std::string, std::string> kSizes{{"cliff", "[\"20m\", \"4m\", \"12m\"]"},
                                                    {"figure-13a", "[\"20m\", \"2m\", \"12m\"]"}};
    for (const auto& [name, size] : kSizes) {
        SCOPED_TRACE(name);
        const Fallen f = fallen(
            run_recipe(name, {"lava.voxel=8cm", "lava.size=" + size, "weather.remove_box=[]"}));
        EXPECT_GT(f.removed, 0.02 * f.voxels);
        EXPECT_LT(f.removed, 0.3 * f.voxels);
        EXPECT_LT(f.gone.x, f.lava.x - 0.15);
        EXPECT_LT(f.gone.y, f.lava.y - 0.15);
        EXPECT_LT(f.gone.z, f.lava.z - 0.05);
        for (std::size_t q = 1; q < 4; ++q) EXPECT_LT(f.by_depth[q], f.by_depth[q - 1]);
    }
}

TEST(Cliff, HasEveryLavaVoxelInOnePiece)
{
    const Scene scene = half_size("cliff");
    const IntGrid &component = scene.ints("component"), &region = scene.ints("region");
    const IntGrid& column = scene.ints("column");
    std::map<std::int32_t, double> pieces;
    std::map<std::int32_t, std::int32_t> column_of;
    double lava = 0;
    const Coord n = scene.domain.dims;
    GridReader<std::int32_t> in_region(region), in_component(component), in_column(column);
    for (int x = 0; x < n.x; ++x)
        for (int y = 0; y < n.y; ++y)
            for (int z = 0; z < n.z; ++z) {
                const std::int32_t piece = in_component.value({x, y, z});
                ASSERT_EQ(piece >= 0, in_region.value({x, y, z}) == lava::kLava);
                if (piece < 0) continue;
                ++lava;
                ++pieces[piece];
                const std::int32_t owner = in_column.value({x, y, z});
                ASSERT_EQ(column_of.emplace(piece, owner).first->second, owner);
            }
    double sum = 0;
    for (const auto& [id, voxels] : pieces) sum += voxels;
    EXPECT_EQ(sum, lava);
    EXPECT_EQ(sum, static_cast<double>(component.active_count()));
    EXPECT_GT(pieces.size(), 2 * lines_of(scene).count());
}

TEST(Scenes, AreTheSameInAWorldTenTimesLarger)
{
    auto cliff = [](const std::string& size, const std::string& voxel, const std::string& spacing,
                    const std::string& depth, const std::string& reference) {
        return run_recipe("cliff",
                          {"lava.size=" + size, "lava.voxel=" + voxel, "joint.spacing=" + spacing,
                           "weather.depth=" + depth, "weather.cut_ref_length=" + reference});
    };
    const Scene one = cliff("[\"10m\", \"3m\", \"6m\"]", "7cm", "60cm", "1.6m", "1.2m"),
                ten = cliff("[\"100m\", \"30m\", \"60m\"]", "70cm", "6m", "16m", "12m");
    for (const char* name : {"region", "region_coarse", "column", "component", "surface"}) {
        const IntGrid &a = one.ints(name), &b = ten.ints(name);
        ASSERT_EQ(a.leaf_count(), b.leaf_count()) << name;
        std::size_t differ = 0;
        for (std::size_t i = 0; i < a.leaf_count(); ++i)
            for (int o = 0; o < kLeafSize; ++o)
                differ += a.at(i, o) != b.at(i, o) || a.mask(i).test(o) != b.mask(i).test(o);
        EXPECT_EQ(differ, 0u) << name;
    }
    const double a = one.meshes.at("rock").signed_volume(),
                 b = ten.meshes.at("rock").signed_volume();
    EXPECT_NEAR(b, 1000 * a, 1e-4 * b);
}

}  // namespace
}  // namespace sekitei::presets
