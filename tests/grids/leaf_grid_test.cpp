#include "grids/leaf_grid.h"

#include <gtest/gtest.h>

#include <map>
#include <set>

#include "core/random.h"

namespace sekitei {
namespace {

constexpr Transform kPlace{.origin = {1, 2, 3}, .voxel = 0.5};

int drawn(std::uint64_t stream, std::uint64_t i, int below)
{
    return static_cast<int>(uniform01(stream, Stream("leaf_grid_test"), i) * below);
}

/// Leaf origins scattered on both sides of zero.
std::vector<Coord> scattered(std::size_t count)
{
    std::vector<Coord> origins;
    for (std::size_t i = 0; i < count; ++i)
        origins.push_back(
            {drawn(1, i, 12) * 8 - 48, drawn(2, i, 9) * 8 - 40, drawn(3, i, 7) * 8 - 16});
    return origins;
}

/// Leaves that are constant, nearly constant, partly active or full, in no order.
LeafGrid<std::int32_t> mixed()
{
    LeafGrid<std::int32_t> grid(LeafTopology::build(scattered(150)), kPlace, -1);
    for (std::size_t i = 0; i < grid.leaf_count(); ++i) {
        grid.set_constant(i, drawn(4, i, 3));
        if (i % 3 == 0) grid.mask(i) = LeafMask::full();
        if (i % 5 == 0) grid.mask(i).set(drawn(5, i, 512));
    }
    grid.expand();
    for (std::size_t i = 0; i < grid.leaf_count(); i += 2)
        grid.values(i)[drawn(6, i, 512)] = drawn(7, i, 3);
    for (std::size_t i = 1; i < grid.leaf_count(); i += 7) grid.set_constant(i, 9);
    return grid;
}

using Voxels = std::map<Coord, std::pair<std::int32_t, bool>>;
Voxels voxels(const LeafGrid<std::int32_t>& grid)
{
    Voxels all;
    for (std::size_t i = 0; i < grid.leaf_count(); ++i)
        for (int v = 0; v < kLeafSize; ++v)
            all[leaf_coord(grid.origin(i), v)] = {grid.at(i, v), grid.mask(i).test(v)};
    return all;
}

TEST(LeafIndex, OffsetsAndCoordinatesAreInverseOnBothSidesOfZero)
{
    for (int x = -17; x < 17; x += 3)
        for (int y = -9; y < 9; ++y)
            for (int z = -20; z < 4; ++z) {
                const Coord c(x, y, z), o = leaf_origin(c);
                EXPECT_EQ(leaf_coord(o, leaf_offset(c)), c);
                EXPECT_TRUE(o.x <= x && x < o.x + 8 && o.y <= y && y < o.y + 8 && o.z <= z &&
                            z < o.z + 8);
            }
    EXPECT_EQ(leaf_offset({0, 0, 1}), 1);  // z fastest
}

TEST(LeafMask, CountsAndVisitsWhatWasSet)
{
    LeafMask mask;
    std::set<int> set;
    for (std::uint64_t i = 0; i < 200; ++i) {
        const int v = drawn(8, i, 512);
        mask.set(v);
        set.insert(v);
    }
    mask.reset(*set.begin());
    set.erase(set.begin());
    std::vector<int> visited;
    mask.for_each([&](int v) { visited.push_back(v); });
    EXPECT_EQ(visited, std::vector<int>(set.begin(), set.end()));
    EXPECT_EQ(mask.count(), static_cast<int>(set.size()));
    EXPECT_TRUE(LeafMask::full().all());
    EXPECT_TRUE(LeafMask{}.none());
}

TEST(LeafTopology, IsASortedSetThatFindsItsLeaves)
{
    std::vector<Coord> origins = scattered(400);
    const TopologyPtr topology = LeafTopology::build(origins);
    const std::set<Coord> set(origins.begin(), origins.end());
    EXPECT_EQ(topology->origins(), std::vector<Coord>(set.begin(), set.end()));
    for (int x = -64; x <= 64; x += 8)
        for (int y = -56; y <= 48; y += 8)
            for (int z = -32; z <= 56; z += 8) {
                const std::uint32_t leaf = topology->find({x, y, z});
                if (set.contains({x, y, z}))
                    EXPECT_EQ(topology->origin(leaf), Coord(x, y, z));
                else
                    EXPECT_EQ(leaf, kNoLeaf);
            }
    EXPECT_EQ(LeafTopology::build({})->find({0, 0, 0}), kNoLeaf);
}

TEST(LeafTopology, NeighboursAreThoseFoundOneByOne)
{
    const TopologyPtr topology = LeafTopology::build(scattered(300));
    for (std::size_t i = 0; i < topology->size(); ++i)
        for (int dx = -1; dx <= 1; ++dx)
            for (int dy = -1; dy <= 1; ++dy)
                for (int dz = -1; dz <= 1; ++dz)
                    EXPECT_EQ(topology->neighbours()[i][std::size_t(neighbour_index(dx, dy, dz))],
                              topology->find(topology->origin(i) + Coord(8 * dx, 8 * dy, 8 * dz)));
}

TEST(LeafTopology, DilationAddsAllLeavesThatTouchAndMeetTheBox)
{
    const TopologyPtr topology = LeafTopology::build(scattered(60));
    const Coord lower(-41, -40, -9), upper(33, 17, 25);
    std::set<Coord> expected;
    for (const Coord& o : topology->origins())
        for (int dx = -8; dx <= 8; dx += 8)
            for (int dy = -8; dy <= 8; dy += 8)
                for (int dz = -8; dz <= 8; dz += 8) {
                    const Coord n = o + Coord(dx, dy, dz);
                    bool meets = false;  // by looking at each voxel
                    for (int v = 0; v < kLeafSize && !meets; ++v) {
                        const Coord c = leaf_coord(n, v);
                        meets = c.x >= lower.x && c.y >= lower.y && c.z >= lower.z &&
                                c.x < upper.x && c.y < upper.y && c.z < upper.z;
                    }
                    if (meets) expected.insert(n);
                }
    EXPECT_EQ(topology->dilated(lower, upper)->origins(),
              std::vector<Coord>(expected.begin(), expected.end()));
}

TEST(LeafTopology, ABoxIsCoveredExactly)
{
    const TopologyPtr box = box_topology({-3, 0, 9}, {17, 8, 24});
    EXPECT_EQ(box->size(), 4u * 1 * 2);
    EXPECT_EQ(box->origin(0), Coord(-8, 0, 8));
    EXPECT_NE(box->find({16, 0, 16}), kNoLeaf);
}

TEST(LeafGrid, ExpandingAndCompressingChangeNoVoxel)
{
    LeafGrid<std::int32_t> grid = mixed();
    const Voxels before = voxels(grid);
    grid.compress();
    EXPECT_EQ(voxels(grid), before);
    const std::size_t dense = grid.dense_leaf_count();
    EXPECT_LT(dense, grid.leaf_count());
    for (std::size_t i = 0; i < grid.leaf_count(); ++i) {
        std::set<std::int32_t> values;
        for (int v = 0; v < kLeafSize; ++v) values.insert(grid.at(i, v));
        const bool uniform = values.size() == 1 && (grid.mask(i).all() || grid.mask(i).none());
        EXPECT_EQ(grid.is_constant(i), uniform);
    }
    grid.expand();
    EXPECT_EQ(grid.dense_leaf_count(), grid.leaf_count());
    EXPECT_EQ(voxels(grid), before);
    grid.compress();
    EXPECT_EQ(voxels(grid), before);
    EXPECT_EQ(grid.dense_leaf_count(), dense);
}

TEST(LeafGrid, CopiesAreIndependent)
{
    const LeafGrid<std::int32_t> grid = mixed();
    const Voxels before = voxels(grid);
    LeafGrid<std::int32_t> copy = grid;
    copy.expand();
    for (std::size_t i = 0; i < copy.leaf_count(); ++i) copy.values(i)[5] = 77;
    EXPECT_EQ(voxels(grid), before);
}

TEST(LeafGrid, LookUpsAgreeWithAMapOfAllVoxels)
{
    LeafGrid<std::int32_t> grid = mixed();
    grid.compress();
    const Voxels all = voxels(grid);
    GridReader<std::int32_t> reader(grid);
    std::uint64_t active = 0;
    for (const auto& [c, v] : all) active += v.second;
    EXPECT_EQ(grid.active_count(), active);
    for (std::uint64_t i = 0; i < 20000; ++i) {
        const Coord c(drawn(10, i, 130) - 64, drawn(11, i, 110) - 56, drawn(12, i, 90) - 32);
        const auto found = all.find(c);
        const auto expected =
            found == all.end() ? std::pair<std::int32_t, bool>(-1, false) : found->second;
        ASSERT_EQ(grid.value(c), expected.first);
        ASSERT_EQ(grid.active(c), expected.second);
        ASSERT_EQ(reader.active(c), expected.second);
        ASSERT_EQ(reader.value(c), expected.first);
    }
}

TEST(LeafGrid, PartlyDenseHasValuesWhereAsked)
{
    const TopologyPtr topology = LeafTopology::build(scattered(20));
    std::vector<std::uint8_t> dense(topology->size());
    for (std::size_t i = 0; i < dense.size(); i += 3) dense[i] = 1;
    auto grid = LeafGrid<float>::partly_dense(topology, kPlace, 2.5f, dense);
    for (std::size_t i = 0; i < dense.size(); ++i) {
        EXPECT_EQ(grid.is_constant(i), dense[i] == 0);
        if (dense[i])
            std::fill_n(grid.values(i), kLeafSize, static_cast<float>(i));
        else
            EXPECT_EQ(grid.constant(i), 2.5f);
    }
    for (std::size_t i = 0; i < dense.size(); ++i)
        EXPECT_EQ(grid.at(i, 511), dense[i] ? static_cast<float>(i) : 2.5f);
}

TEST(GridReader, TrilinearSamplingIsExactForLinearFields)
{
    auto linear = [](Vec3d p) { return 0.5 * p.x - 2 * p.y + 0.25 * p.z + 3; };
    LeafGrid<float> grid(box_topology({-16, -8, 0}, {16, 16, 24}), kPlace, 0.0f);
    LeafGrid<Vec3f> vectors(grid.topology(), kPlace, Vec3f(0));
    grid.expand();
    vectors.expand();
    for (std::size_t i = 0; i < grid.leaf_count(); ++i)
        for (int v = 0; v < kLeafSize; ++v) {
            const double f = linear(centre_of(leaf_coord(grid.origin(i), v)));
            grid.values(i)[v] = static_cast<float>(f);
            vectors.values(i)[v] = Vec3f(Vec3d(f, -f, 1));
        }
    GridReader<float> reader(grid);
    GridReader<Vec3f> vector_reader(vectors);
    for (std::uint64_t i = 0; i < 2000; ++i) {
        auto u = [&](std::uint64_t draw) { return uniform01(20 + draw, Stream("sample"), i); };
        const Vec3d p(u(0) * 30 - 15, u(1) * 22 - 7, u(2) * 22 + 1);
        ASSERT_NEAR(reader.sample(p), linear(p), 2e-5);
        ASSERT_NEAR(vector_reader.sample(p).y, -linear(p), 2e-5);
    }
    EXPECT_FLOAT_EQ(reader.sample(centre_of({3, 4, 5})),
                    static_cast<float>(linear(centre_of({3, 4, 5}))));
}

}  // namespace
}  // namespace sekitei
