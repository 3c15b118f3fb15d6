#include "grids/nearest_polyline.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>

#include "core/error.h"
#include "core/random.h"

namespace sekitei {
namespace {

/// Three bent lines in a box of 24^3.
Polylines three_lines()
{
    Polylines lines;
    lines.add({{5.13, 4.21, 0}, {7.37, 6.05, 11.7}, {12.91, 5.33, 24}}, StopReason::OutOfDomain);
    lines.add({{18.2, 7.9, 24}, {17.6, 12.4, 9.3}, {19.8, 18.7, 0}}, StopReason::OutOfDomain);
    lines.add({{6.4, 19.3, 24}, {9.7, 15.2, 3.1}}, StopReason::Flat);
    return lines;
}

/// Crooked lines of 1 to `most` points in a box; now and then a point is doubled.
Polylines random_lines(std::uint64_t seed, std::size_t count, std::size_t most, Vec3d box)
{
    constexpr Stream kPoint{"test.point"}, kSize{"test.size"};
    Polylines lines;
    for (std::size_t i = 0; i < count; ++i) {
        const auto n = 1 + static_cast<std::size_t>(uniform01(seed, kSize, i) * double(most));
        std::vector<Vec3d> points;
        for (std::size_t k = 0; k < n; ++k) {
            const std::uint64_t at = i * 1000 + k;
            points.push_back({uniform01(seed, kPoint, at, 0) * box.x,
                              uniform01(seed, kPoint, at, 1) * box.y,
                              uniform01(seed, kPoint, at, 2) * box.z});
            if (k % 5 == 4) points.back() = points[k - 1];
        }
        lines.add(points, StopReason::Flat);
    }
    return lines;
}

template <class F>
void for_each_leaf(Coord dims, F&& f)
{
    for (int x = 0; x < dims.x; x += 8)
        for (int y = 0; y < dims.y; y += 8)
            for (int z = 0; z < dims.z; z += 8) f(Coord(x, y, z));
}

// Counts and distances of an independent script (clamped projection on every segment).
TEST(NearestPolyline, LabelsTheThreeLineSceneAsComputedIndependently)
{
    const PolylineIndex index(three_lines());
    std::array<int, 3> counts{};
    for (int x = 0; x < 24; ++x)
        for (int y = 0; y < 24; ++y)
            for (int z = 0; z < 24; ++z)
                ++counts[static_cast<std::size_t>(index.nearest(centre_of({x, y, z})).line)];
    EXPECT_THAT(counts, testing::ElementsAre(4076, 5211, 4537));

    struct Probe {
        Coord voxel;
        double distance, arc;
        int line;
    };
    for (const Probe& probe :
         {Probe{{0, 0, 0}, 5.954074, 0, 0}, Probe{{12, 12, 12}, 5.315512, 12.555689, 1},
          Probe{{13, 6, 23}, 1.375143, 25.287371, 0}, Probe{{8, 20, 1}, 5.664804, 21.552494, 2}}) {
        const NearestPoint found = index.nearest(centre_of(probe.voxel));
        EXPECT_NEAR(std::sqrt(found.distance2), probe.distance, 1e-5);
        EXPECT_NEAR(found.arc, probe.arc, 1e-5);
        EXPECT_EQ(found.line, probe.line);
        EXPECT_NEAR(length(found.point - centre_of(probe.voxel)), probe.distance, 1e-5);
    }
}

/// Every way of asking agrees with brute force to the last bit, voxel by voxel.
void expect_equal_to_brute_force(const Polylines& lines, Coord dims)
{
    const PolylineIndex index(lines);
    PolylineIndex::Candidates wide, block, narrow;
    std::array<std::int32_t, kLeafSize> line, only;
    std::array<double, kLeafSize> arc;
    std::vector<NearestPoint> per_line;
    for_each_leaf(dims, [&](Coord origin) {
        const Vec3d centre = Vec3d(origin) + Vec3d(4.0);
        const Vec3d wide_centre =
            Vec3d(Coord(origin.x & ~31, origin.y & ~31, origin.z & ~31)) + Vec3d(16.0);
        index.candidates(wide_centre, 15.5 * std::sqrt(3.0), wide);
        index.candidates(centre, 3.5 * std::sqrt(3.0), block);
        PolylineIndex::narrow(wide, centre, 3.5, narrow);
        ASSERT_LE(narrow.segments.size(), block.segments.size());
        PolylineIndex::nearest_in_leaf(origin, narrow, line.data(), arc.data());
        PolylineIndex::nearest_in_leaf(origin, wide, only.data(), nullptr);
        for (int offset = 0; offset < kLeafSize; ++offset) {
            const Vec3d p = centre_of(leaf_coord(origin, offset));
            const NearestPoint exact = index.nearest_brute_force(p);
            for (const NearestPoint& found : {index.nearest(p), PolylineIndex::nearest(p, block),
                                              PolylineIndex::nearest(p, narrow)}) {
                ASSERT_EQ(found.line, exact.line);
                ASSERT_EQ(found.distance2, exact.distance2);
                ASSERT_EQ(found.arc, exact.arc);
                ASSERT_EQ(found.point, exact.point);
            }
            ASSERT_EQ(line[static_cast<std::size_t>(offset)], exact.line);
            ASSERT_EQ(arc[static_cast<std::size_t>(offset)], exact.arc);
            ASSERT_EQ(only[static_cast<std::size_t>(offset)], exact.line);
            PolylineIndex::nearest_per_line(p, block, per_line);
            ASSERT_EQ(per_line.size(), block.lines.size());
            double least = INFINITY;
            for (std::size_t k = 0; k < per_line.size(); ++k) {
                ASSERT_EQ(per_line[k].line, block.lines[k]);
                least = std::min(least, per_line[k].distance2);
            }
            ASSERT_EQ(least, exact.distance2);
        }
    });
}

TEST(NearestPolyline, EqualsBruteForceAmongManyShortLines)
{
    expect_equal_to_brute_force(random_lines(1, 200, 1, {40, 32, 24}), {40, 32, 24});
}

TEST(NearestPolyline, EqualsBruteForceAmongLongObliqueLines)
{
    expect_equal_to_brute_force(random_lines(2, 12, 2, {48, 40, 32}), {48, 40, 32});
}

TEST(NearestPolyline, EqualsBruteForceAmongCrookedLinesWithDoubledPoints)
{
    expect_equal_to_brute_force(random_lines(3, 30, 12, {32, 40, 48}), {32, 40, 48});
}

TEST(NearestPolyline, GivesAnExactTieToTheLowerLineThenTheLowerSegment)
{
    Polylines lines;  // line 1 repeats line 0; a voxel plane lies halfway to line 2
    lines.add({{2.5, 4.5, 0}, {2.5, 4.5, 8}, {2.5, 4.5, 16}}, StopReason::Flat);
    lines.add({{2.5, 4.5, 0}, {2.5, 4.5, 16}}, StopReason::Flat);
    lines.add({{8.5, 4.5, 0}, {8.5, 4.5, 16}}, StopReason::Flat);
    const PolylineIndex index(lines);
    EXPECT_EQ(index.nearest({5.5, 3.5, 4.5}).line, 0);
    EXPECT_EQ(index.nearest({5.5, 3.5, 4.5}).arc, 4.5);
    EXPECT_EQ(index.nearest({6.5, 3.5, 4.5}).line, 2);
    expect_equal_to_brute_force(lines, {16, 8, 16});
}

TEST(NearestPolyline, AnswersNoLineWhenThereIsNone)
{
    const PolylineIndex index(Polylines{});
    PolylineIndex::Candidates found;
    index.candidates({1, 2, 3}, 5, found);
    EXPECT_TRUE(found.segments.empty());
    EXPECT_EQ(index.segment_count(), 0u);
    EXPECT_EQ(index.nearest({1, 2, 3}).line, -1);
    EXPECT_EQ(PolylineIndex::nearest({1, 2, 3}, found).line, -1);
    PolylineIndex::Candidates narrowed;
    PolylineIndex::narrow(found, {1, 2, 3}, 5, narrowed);
    EXPECT_TRUE(narrowed.segments.empty());
    std::array<std::int32_t, kLeafSize> line;
    PolylineIndex::nearest_in_leaf({0, 0, 0}, narrowed, line.data(), nullptr);
    EXPECT_THAT(line, testing::Each(-1));
    EXPECT_EQ(index.nearest_brute_force({1, 2, 3}).line, -1);
}

TEST(Polylines, PassThroughWorldPointsWithoutLosingABit)
{
    const Transform transform{{-1203.7, 88.1, 412.33}, 0.037};
    Polylines lines = random_lines(5, 40, 9, {300, 200, 100});
    for (Vec3d& p : lines.points) p = on_line_lattice(p);
    const Points points = to_points(lines, transform);
    const Polylines back = to_polylines(points, transform);
    EXPECT_EQ(back.points, lines.points);
    EXPECT_EQ(back.begin, lines.begin);
    EXPECT_EQ(back.stop, lines.stop);
    const auto& arc = std::get<std::vector<float>>(points.attributes.at("arc"));
    EXPECT_NEAR(arc[lines.begin[8] - 1], lines.arc_lengths()[lines.begin[8] - 1] * 0.037, 1e-4);
}

TEST(Polylines, NameThePointThatIsOutOfPlace)
{
    Points points = to_points(three_lines(), {});
    std::swap(std::get<std::vector<std::int32_t>>(points.attributes["order"])[3],
              std::get<std::vector<std::int32_t>>(points.attributes["order"])[4]);
    EXPECT_THAT(
        [&] { to_polylines(points, {}); },
        testing::ThrowsMessage<InvalidInput>(testing::HasSubstr("point 3 is point 1 of line 1")));
    points.attributes.erase("stop");
    EXPECT_THAT([&] { to_polylines(points, {}); },
                testing::ThrowsMessage<InvalidInput>(testing::HasSubstr("no attribute `stop`")));
}

}  // namespace
}  // namespace sekitei
