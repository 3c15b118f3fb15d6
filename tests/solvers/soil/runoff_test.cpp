#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numeric>

#include "core/error.h"
#include "core/parallel.h"
#include "core/random.h"
#include "solvers/soil/soil.h"

namespace sekitei::soil {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

/// Sites on a grid nx by ny over heights, each with its eight neighbours.
struct Field {
    int nx, ny;
    std::vector<Vec3d> position;
    std::vector<float> up, area;
    std::vector<std::uint32_t> begin{0}, neighbour;
    std::vector<std::int32_t> drop;

    Field(int nx_, int ny_, double spacing, const std::function<double(double, double)>& height)
        : nx(nx_), ny(ny_)
    {
        for (int y = 0; y < ny; ++y)
            for (int x = 0; x < nx; ++x) {
                const double px = spacing * x, py = 1.3 * spacing * y;
                position.emplace_back(px, py, height(px, py));
                up.push_back(0.9F);
                area.push_back(static_cast<float>(
                    spacing * spacing *
                    (1 + uniform01(1, Stream("area"), std::uint64_t(x + nx * y)))));
                for (int dy = -1; dy <= 1; ++dy)
                    for (int dx = -1; dx <= 1; ++dx)
                        if ((dx || dy) && x + dx >= 0 && x + dx < nx && y + dy >= 0 && y + dy < ny)
                            neighbour.push_back(std::uint32_t(x + dx + nx * (y + dy)));
                begin.push_back(static_cast<std::uint32_t>(neighbour.size()));
            }
    }
    std::size_t size() const { return position.size(); }
    std::size_t at(int x, int y) const { return std::size_t(x + nx * y); }
    Surface surface() const { return {position, up, area, begin, neighbour, drop}; }
};

double total(const std::vector<double>& depth, const std::vector<float>& area)
{
    double sum = 0;
    for (std::size_t i = 0; i < depth.size(); ++i) sum += depth[i] * area[i];
    return sum;
}

TEST(Runoff, WaterIsNeitherMadeNorLostOverThirtyDaysOnRoughRock)
{
    Field rock(31, 23, 0.02, [](double x, double y) {
        return 0.3 * x - 0.1 * y + 0.01 * std::sin(170 * x) * std::cos(130 * y);
    });
    // Some undersides drip on lower sites, some out of the scene.
    rock.drop.assign(rock.size(), -1);
    for (std::size_t i = 0; i < rock.size(); i += 11) {
        rock.up[i] = -0.8F;
        for (std::size_t j = 0; j < rock.size() && i % 3; j += 7)
            if (rock.position[j].z < rock.position[i].z) rock.drop[i] = static_cast<int>(j);
    }
    const Paths paths = runoff_paths(rock.surface(), {});
    const Soil soil{"rock", 0.15, 19.4, 0.012};
    const std::vector<float> depth(rock.size(), 20);
    const std::vector<double> capacity(rock.size(), 20 * 0.012);
    std::vector<double> water(rock.size(), 0);
    double rained = 0, evaporated = 0, out = 0;
    Runoff runoff;
    Result result;
    for (int d = 0; d < 30; ++d) {
        std::vector<double> rain(rock.size(), 0);
        if (d % 3 == 0)
            for (std::size_t i = 0; i < rain.size(); ++i)
                rain[i] = 8 * uniform01(3, Stream("P"), i);
        route_rain(paths, rock.area, capacity, water, rain, runoff);
        Inputs in{.water = water,
                  .light = 40.0F,
                  .temperature = 285.0F,
                  .humidity = 0.9F,
                  .rain = runoff.supply,
                  .wind = 1.0F,
                  .sky_view = 0.7F,
                  .cover = 0.0F,
                  .depth = depth,
                  .soil = {},
                  .soils = std::span(&soil, 1),
                  .air = {.sunshine = 0.9}};
        run(in, {}, result, {});
        rained += total(rain, rock.area);
        evaporated += total(result.evaporation, rock.area);
        out += runoff.outflow;
        // Dew that found no room leaves; rain that ran on was routed.
        for (std::size_t i = 0; i < rock.size(); ++i) {
            ASSERT_GE(result.runoff[i], runoff.run[i]);
            out += (result.runoff[i] - runoff.run[i]) * rock.area[i];
        }
        water = result.water;
    }
    EXPECT_GT(out, 0.1 * rained);
    EXPECT_NEAR(rained, total(water, rock.area) + evaporated + out, 1e-9 * rained);
}

TEST(Runoff, OnAPlaneAllFlowsDownhillAndLeavesAtTheLowestRow)
{
    const Field plane(5, 40, 0.03, [](double, double y) { return 0.5 * y; });
    const Paths paths = runoff_paths(plane.surface(), {});
    EXPECT_EQ(paths.ends, 5u);
    Runoff r;
    const std::vector<double> none(plane.size(), 0);
    route_rain(paths, plane.area, none, none, 2.5, r);
    double rain = 0;
    for (const float a : plane.area) rain += 2.5 * a;
    EXPECT_NEAR(r.outflow, rain, 1e-12 * rain);
    // Each row carries the rain of all rows above it.
    for (int y = 0; y < 40; ++y) {
        double carried = 0, above = 0;
        for (int x = 0; x < 5; ++x) carried += r.run[plane.at(x, y)] * plane.area[plane.at(x, y)];
        for (std::size_t i = plane.at(0, y); i < plane.size(); ++i) above += 2.5 * plane.area[i];
        EXPECT_NEAR(carried, above, 1e-12 * above);
    }
}

TEST(Runoff, SharesFollowTheSlopeToThePower)
{
    // One peak, two lower sites at the same distance, drops 3 : 1.
    const std::vector<Vec3d> p = {{0, 0, 1}, {4, 0, -2}, {-4.8989794855663558, 0, 0}};
    const std::vector<float> up(3, 1), area(3, 2);
    const std::vector<std::uint32_t> begin = {0, 2, 3, 4}, neighbour = {1, 2, 0, 0};
    const Paths paths = runoff_paths({p, up, area, begin, neighbour, {}}, {});
    const double expected = std::pow(3.0, 1.1) / (1 + std::pow(3.0, 1.1));
    ASSERT_EQ(paths.begin[1], 2u);
    EXPECT_NEAR(paths.share[0], expected, 1e-6);
    Runoff r;
    const std::vector<double> none(3, 0);
    route_rain(paths, area, none, none, std::vector<double>{1, 0, 0}, r);
    EXPECT_NEAR(r.supply[1], expected, 1e-6);
    EXPECT_DOUBLE_EQ(r.supply[1] + r.supply[2], 1);
}

TEST(Runoff, LevelGroundDrainsToItsEdge)
{
    // A terrace 9 deep, then a fall: no site of the terrace keeps its water.
    const Field steps(3, 20, 0.05, [](double, double y) { return y > 0.6 ? 1.0 : y; });
    const Paths paths = runoff_paths(steps.surface(), {});
    EXPECT_EQ(paths.ends, 3u);
    Runoff r;
    const std::vector<double> none(steps.size(), 0);
    route_rain(paths, steps.area, none, none, 1.0, r);
    EXPECT_NEAR(r.outflow, std::accumulate(steps.area.begin(), steps.area.end(), 0.0), 1e-6);
}

TEST(Runoff, PitsLoseTheirWaterAndSayHowMany)
{
    const Field bowl(9, 9, 0.1, [](double x, double y) {
        return (x - 0.4) * (x - 0.4) + (y - 0.52) * (y - 0.52);
    });
    const Paths paths = runoff_paths(bowl.surface(), {});
    EXPECT_EQ(paths.ends, 1u);
}

TEST(Runoff, ASiteKeepsWhatItHasRoomFor)
{
    const Field plane(1, 3, 0.5, [](double, double y) { return y; });
    Runoff r;
    const std::vector<double> capacity(3, 2.0), water = {2.0, 0.5, 1.0};
    route_rain(runoff_paths(plane.surface(), {}), plane.area, capacity, water, 1.2, r);
    EXPECT_NEAR(r.run[2], 0.2, 1e-12);
    const double onto = 0.2 * plane.area[2] / plane.area[1];
    EXPECT_NEAR(r.supply[1], 1.2 + onto, 1e-12);
    EXPECT_NEAR(r.run[1], std::max(0.0, 0.5 + 1.2 + onto - 2), 1e-12);
}

TEST(Runoff, ACrackCollectsThreeTimesItsOwnRain)
{
    const Field wall(21, 30, 0.02, [](double x, double y) {
        return 4 * y + (std::abs(x - 0.2) < 0.03 ? -0.02 : 0.0);  // groove one site wide
    });
    Runoff r;
    const std::vector<double> none(wall.size(), 0);
    route_rain(runoff_paths(wall.surface(), {}), wall.area, none, none, 1.0, r);
    double crack = 0;
    for (int y = 0; y < 30; ++y) crack += r.supply[wall.at(10, y)];
    double beside = 0;
    for (int y = 0; y < 30; ++y) beside += r.supply[wall.at(3, y)];
    EXPECT_GE(crack / 30, 3);
    EXPECT_GT(crack, beside);
}

TEST(Runoff, ARoofEdgeWetsALineOnTheShelteredFloor)
{
    // A sloping roof ends in an underside that drips on floor site 12; the floor gets no rain.
    Field scene(1, 50, 0.1, [](double, double y) { return y < 2.5 ? 0.0 : 1 + y; });
    scene.drop.assign(scene.size(), -1);
    // Floor 0..19, roof 20..49, no floor-roof neighbours; site 20 is the lip.
    scene.begin = {0};
    scene.neighbour.clear();
    for (std::uint32_t i = 0; i < 50; ++i) {
        if (i != 0 && i != 20) scene.neighbour.push_back(i - 1);
        if (i != 19 && i != 49) scene.neighbour.push_back(i + 1);
        scene.begin.push_back(static_cast<std::uint32_t>(scene.neighbour.size()));
        scene.position[i].z = i < 20 ? 0.0 : 1 + 0.05 * i;
    }
    scene.up[20] = -0.9F;
    scene.drop[20] = 12;
    std::vector<double> rain(50, 0);
    std::fill(rain.begin() + 20, rain.end(), 3.0);
    const std::vector<double> capacity(50, 5.0), water(50, 0.5);
    Runoff r;
    route_rain(runoff_paths(scene.surface(), {}), scene.area, capacity, water, rain, r);
    // 3.5 mm of 5 on the roof: none runs. A second day fills it.
    EXPECT_EQ(r.supply[12], 0);
    const std::vector<double> wet(50, 4.5);
    std::vector<double> dry_floor = wet;
    std::fill(dry_floor.begin(), dry_floor.begin() + 20, 0.5);
    route_rain(runoff_paths(scene.surface(), {}), scene.area, capacity, dry_floor, rain, r);
    double floor = 0, line = 0;
    for (int i = 0; i < 20; ++i) {
        const double theta = std::min(5.0, dry_floor[std::size_t(i)] + r.supply[std::size_t(i)]);
        (i == 12 ? line : floor) += i == 12 ? theta : theta / 19;
    }
    EXPECT_GE(line, 2 * floor);
}

TEST(Runoff, PathsAreTheSameOnAnyNumberOfThreads)
{
    const Field rock(90, 70, 0.02, [](double x, double y) {
        return std::sin(9 * x) * std::cos(7 * y) + 0.2 * std::floor(10 * y);
    });
    auto on = [&](std::size_t threads) {
        const ThreadLimit limit(threads);
        return runoff_paths(rock.surface(), {});
    };
    const Paths one = on(1), four = on(4);
    EXPECT_EQ(one.order, four.order);
    EXPECT_EQ(one.target, four.target);
    EXPECT_EQ(one.share, four.share);
    // The order is one: whoever drains comes before whom it drains into.
    std::vector<std::size_t> rank(rock.size());
    for (std::size_t k = 0; k < rank.size(); ++k) rank[one.order[k]] = k;
    for (std::size_t i = 0; i < rock.size(); ++i)
        for (std::size_t k = one.begin[i]; k < one.begin[i + 1]; ++k)
            ASSERT_LT(rank[i], rank[one.target[k]]);
}

TEST(Runoff, NamesTheBadSite)
{
    Field plane(3, 3, 0.5, [](double, double y) { return y; });
    plane.drop.assign(9, -1);
    plane.drop[1] = 8;
    EXPECT_THAT([&] { runoff_paths(plane.surface(), {}); },
                ThrowsMessage<InvalidInput>(HasSubstr("site 1: drop target 8")));
    plane.drop[1] = -1;
    plane.area[4] = 0;
    EXPECT_THAT([&] { runoff_paths(plane.surface(), {}); },
                ThrowsMessage<InvalidInput>(HasSubstr("site 4: area = 0")));
    plane.area[4] = 1;
    plane.neighbour[0] = 77;
    EXPECT_THAT([&] { runoff_paths(plane.surface(), {}); },
                ThrowsMessage<InvalidInput>(HasSubstr("neighbour = 77")));
    plane.neighbour[0] = 1;
    const Paths paths = runoff_paths(plane.surface(), {});
    Runoff r;
    const std::vector<double> none(9, 0);
    EXPECT_THAT([&] { route_rain(paths, plane.area, none, none, -1.0, r); },
                ThrowsMessage<InvalidInput>(HasSubstr("rain = -1 mm")));
}

}  // namespace
}  // namespace sekitei::soil
