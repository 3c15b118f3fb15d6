#include "core/point_search.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "core/error.h"
#include "core/parallel.h"
#include "core/random.h"

namespace sekitei {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

constexpr Stream kPlace{"point_search_test.place"};

Vec3f random_point(std::uint64_t seed, std::size_t i)
{
    auto draw = [&](std::uint64_t k) { return uniform01(seed, kPlace, i, k); };
    return Vec3f(Vec3d(3 * draw(0) - 1, 2 * draw(1) - 0.7, 0.5 * draw(2) + 10));
}

/// Uniform in a box, in far apart clusters, on a plane, all in one place, on a lattice (distances
/// that equal radii), at both ends of a long line, one and none.
std::vector<std::pair<std::string, std::vector<Vec3f>>> clouds()
{
    std::vector<std::pair<std::string, std::vector<Vec3f>>> all;
    std::vector<Vec3f> uniform, clustered, plane, one_place, lattice, line;
    for (std::size_t i = 0; i < 3000; ++i) {
        const Vec3f p = random_point(1, i);
        uniform.push_back(p);
        const Vec3f corner(float(i % 3) * 900, float(i % 2) * -1500, float(i % 5) * 1e4f);
        clustered.push_back(corner + p * (i % 7 == 0 ? 0.001f : 0.3f));
        plane.emplace_back(p.x, p.y, 1.25f);
        one_place.emplace_back(0.1f, -0.2f, 0.3f);
        line.emplace_back(i % 2 ? 1e6f + p.x : p.x, 0.f, 0.f);
    }
    for (int i = 0; i < 12 * 12 * 12; ++i)
        lattice.push_back(Vec3f(Vec3d(i % 12, i / 12 % 12, i / 144)) * 0.25f);
    all = {{"uniform", uniform},     {"clustered", clustered}, {"plane", plane},
           {"one place", one_place}, {"lattice", lattice},     {"line", line}};
    all.emplace_back("one", std::vector<Vec3f>{{1, 2, 3}});
    all.emplace_back("none", std::vector<Vec3f>{});
    return all;
}

using Found = std::vector<std::pair<std::uint32_t, float>>;

Found brute(const std::vector<Vec3f>& points, Vec3f at, float radius)
{
    Found found;
    for (std::uint32_t i = 0; i < points.size(); ++i)
        if (const float d2 = squared_distance(at, points[i]); d2 <= radius * radius)
            found.emplace_back(i, d2);
    return found;
}
template <class Search>
Found found_by(const Search& search, Vec3f at, float radius)
{
    Found found;
    search.within(at, radius, [&](std::uint32_t i, float d2) { found.emplace_back(i, d2); });
    std::ranges::sort(found);
    return found;
}

std::vector<Vec3f> places_in(const std::vector<Vec3f>& points)
{
    std::vector<Vec3f> places{{0, 0, 0}, {-5, 40, 3}, {0.6f, 0.1f, 10.2f}};
    for (std::size_t i = 0; i < points.size(); i += 1 + points.size() / 12) {
        places.push_back(points[i]);
        places.push_back(points[i] + Vec3f(0.25f, 0, 0));
        places.push_back(points[i] + Vec3f(0.02f, -0.11f, 0.05f));
    }
    return places;
}

TEST(PointSearch, FindsExactlyThePointsOfBruteForce)
{
    for (const auto& [name, points] : clouds()) {
        const KdTree tree(points);
        for (const float edge : {0.25f, 0.07f, 3.0f}) {
            const CellIndex cells(points, edge);
            for (const float radius : {0.0f, 0.05f, 0.25f, 0.5f, 2.5f, 3e4f})
                for (const Vec3f at : places_in(points)) {
                    const Found expected = brute(points, at, radius);
                    ASSERT_EQ(found_by(tree, at, radius), expected) << name << " " << radius;
                    ASSERT_EQ(found_by(cells, at, radius), expected)
                        << name << " " << radius << " " << edge;
                }
        }
    }
}

TEST(PointSearch, DistanceToTheNearestIsThatOfASort)
{
    for (const auto& [name, points] : clouds()) {
        const KdTree tree(points);
        const CellIndex cells(points, 0.2f);
        for (const Vec3f at : places_in(points)) {
            std::vector<float> sorted;
            for (const Vec3f p : points) sorted.push_back(squared_distance(at, p));
            std::ranges::sort(sorted);
            for (const std::size_t k : {1u, 2u, 17u, 100u})
                for (const float most : {0.02f, 0.4f, 40.0f}) {
                    const float expected =
                        sorted.size() >= k ? std::min(most, std::sqrt(sorted[k - 1])) : most;
                    const int number = static_cast<int>(k);
                    EXPECT_EQ(tree.distance_to_nearest(at, number, most), expected) << name;
                    EXPECT_EQ(cells.distance_to_nearest(at, number, most), expected) << name;
                }
        }
    }
}

TEST(PointSearch, SlotsHoldEachPointOnce)
{
    for (const auto& [name, points] : clouds()) {
        auto check = [&](const std::vector<NumberedPoint>& slots) {
            std::vector<int> seen(points.size());
            ASSERT_EQ(slots.size(), points.size());
            for (const NumberedPoint& p : slots) {
                EXPECT_EQ(p.at, points[p.index]);
                EXPECT_EQ(++seen[p.index], 1) << name;
            }
        };
        check(KdTree(points).points());
        check(CellIndex(points, 0.1f).points());
    }
}

TEST(PointSearch, IsTheSameOnAnyNumberOfThreads)
{
    std::vector<Vec3f> points(100'000);
    for (std::size_t i = 0; i < points.size(); ++i) points[i] = random_point(2, i);
    auto on_threads = [&](std::size_t n) {
        const ThreadLimit limit(n);
        std::vector<std::uint32_t> order;
        const KdTree tree(points);
        const CellIndex cells(points, 0.03f);
        for (const auto* slots : {&tree.points(), &cells.points()})
            for (const NumberedPoint& p : *slots) order.push_back(p.index);
        return order;
    };
    EXPECT_EQ(on_threads(1), on_threads(4));
}

TEST(PointSearch, FindsNothingNearWhatIsNotANumber)
{
    const std::vector<Vec3f> points{{0, 0, 0}, {1, 0, 0}};
    const KdTree tree(points);
    const CellIndex cells(points, 1);
    for (const Vec3f at : {Vec3f(NAN, 0, 0), Vec3f(0, 0, NAN)}) {
        EXPECT_TRUE(found_by(tree, at, 2).empty());
        EXPECT_TRUE(found_by(cells, at, 2).empty());
    }
    for (const float radius : {-1.0f, NAN}) {
        EXPECT_TRUE(found_by(tree, {0, 0, 0}, radius).empty());
        EXPECT_TRUE(found_by(cells, {0, 0, 0}, radius).empty());
    }
}

TEST(PointSearch, NamesWhatIsWrong)
{
    const std::vector<Vec3f> bad{{0, 0, 0}, {0, INFINITY, 0}};
    EXPECT_THAT([&] { KdTree{bad}; },
                ThrowsMessage<InvalidInput>(HasSubstr("point 1 is (0, inf, 0), must be finite")));
    EXPECT_THAT([&] { CellIndex(bad, 1); }, ThrowsMessage<InvalidInput>(HasSubstr("point 1")));
    EXPECT_THAT([] { CellIndex({}, 0); }, ThrowsMessage<InvalidParameter>(HasSubstr("edge = 0 m")));
    const std::vector<Vec3f> wide{{0, 0, 0}, {1e30f, 0, 0}};
    EXPECT_THAT([&] { CellIndex(wide, 1e-3f); },
                ThrowsMessage<InvalidParameter>(HasSubstr("too small")));
}

}  // namespace
}  // namespace sekitei
