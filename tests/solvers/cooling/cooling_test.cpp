#include "solvers/cooling/cooling.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <cstring>
#include <functional>
#include <numbers>

#include "core/error.h"

namespace sekitei::cooling {
namespace {

using std::numbers::pi;
using testing::AllOf;
using testing::HasSubstr;
using testing::ThrowsMessage;

constexpr std::int32_t kLava = 0, kCold = 1, kSlow = 2;
constexpr Transform kPlace{{-3, 7.5, 2}, 0.4};

/// A region by voxel; leaves that are cold throughout are absent.
IntGrid region_of(Coord dims, const std::function<std::int32_t(Coord)>& id)
{
    const Domain domain{dims, kPlace};
    std::vector<Coord> origins;
    const TopologyPtr box = box_topology({0, 0, 0}, dims);
    for (const Coord& o : box->origins()) {
        bool cold = true;
        for (int i = 0; i < kLeafSize; ++i)
            cold = cold && (!domain.contains(leaf_coord(o, i)) || id(leaf_coord(o, i)) == kCold);
        if (!cold) origins.push_back(o);
    }
    auto grid = IntGrid::uninitialised(LeafTopology::build(origins), kPlace, kCold);
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        for (int i = 0; i < kLeafSize; ++i) {
            const Coord c = leaf_coord(grid.origin(leaf), i);
            grid.values(leaf)[i] = domain.contains(c) ? id(c) : kCold;
            if (grid.values(leaf)[i] != kCold) grid.mask(leaf).set(i);
        }
    grid.compress();
    return grid;
}

Result cooled(const IntGrid& region, Coord dims, const Params& params,
              const Checkpoint& checkpoint = {})
{
    return run({region, {dims, kPlace}}, params, checkpoint, {});
}

std::int32_t chevron(Coord c)
{
    return c.z < 3 || c.z > 28 ? kCold : kLava;
}

std::int32_t fan(Coord c)
{
    const double x = (c.x + 0.5) / 32, z = (c.z + 0.5) / 32;
    return c.z > 28 ? kCold : z < 0.12 + 1.6 * (x - 0.5) * (x - 0.5) ? kSlow : kLava;
}

std::int32_t rosette(Coord c)
{
    const Vec3d from_centre = centre_of(c) / 32 - Vec3d(0.5);
    return chevron(c) == kCold ? kCold : length(from_centre) < 0.15 ? kSlow : kLava;
}

template <class Grid>
void expect_same_bytes(const Grid& a, const Grid& b)
{
    ASSERT_EQ(a.topology()->origins(), b.topology()->origins());
    for (std::size_t leaf = 0; leaf < a.leaf_count(); ++leaf) {
        ASSERT_EQ(a.mask(leaf), b.mask(leaf));
        ASSERT_EQ(a.is_constant(leaf), b.is_constant(leaf));
        for (int i = 0; i < kLeafSize; ++i) {
            const auto va = a.at(leaf, i), vb = b.at(leaf, i);
            ASSERT_EQ(std::memcmp(&va, &vb, sizeof va), 0);
        }
    }
}

void expect_same_bytes(const Result& a, const Result& b)
{
    expect_same_bytes(a.temperature, b.temperature);
    expect_same_bytes(a.gradient, b.gradient);
    expect_same_bytes(a.gradient_magnitude, b.gradient_magnitude);
    EXPECT_EQ(a.steps, b.steps);
    EXPECT_EQ(a.last_change, b.last_change);
}

// Computed by an independent program from eq. 2 of the paper.
TEST(Cooling, SlabReachesTheIndependentlyComputedTemperatures)
{
    const Coord dims(5, 3, 32);
    const IntGrid region = region_of(dims, chevron);
    const double expected[3][4] = {{10, 1120.3914, 1999.8176, 2000.0},
                                   {60, 607.7706, 1846.2509, 1999.4413},
                                   {200, 425.8904, 1380.2208, 1878.2447}};
    for (const auto& row : expected) {
        const Result result = cooled(region, dims, {.steps = int(row[0])});
        EXPECT_EQ(result.steps, int(row[0]));
        EXPECT_NEAR(result.temperature.value({2, 1, 3}), row[1], 1e-3);
        EXPECT_NEAR(result.temperature.value({4, 0, 8}), row[2], 1e-3);
        EXPECT_NEAR(result.temperature.value({0, 2, 15}), row[3], 1e-3);
    }
}

TEST(Cooling, SlabApproachesTheFourierSeries)
{
    const Coord dims(2, 9, 32);
    const IntGrid region = region_of(dims, chevron);
    const double deviation[3][2] = {{10, 25.847}, {60, 4.176}, {200, 1.715}};
    for (const auto& row : deviation) {
        const Result result = cooled(region, dims, {.steps = int(row[0])});
        double worst = 0;
        for (int z = 3; z < 29; ++z) {
            double series = 200;
            for (int n = 1; n < 400; n += 2)
                series += 1800 * 4 / (n * pi) * std::sin(n * pi * (z - 2) / 27.0) *
                          std::exp(-std::pow(n * pi / 27, 2) * 0.1 * row[0]);
            worst = std::max(worst, std::abs(series - result.temperature.value({1, 4, z})));
        }
        EXPECT_NEAR(worst, row[1], 0.002);
    }
}

struct Counts {
    int lava = 0, cold = 0, slow = 0, plateau = 0;
};

Counts count(Coord dims, const std::function<std::int32_t(Coord)>& id, const Result& result)
{
    Counts n;
    for (int x = 0; x < dims.x; ++x)
        for (int y = 0; y < dims.y; ++y)
            for (int z = 0; z < dims.z; ++z) {
                const std::int32_t i = id({x, y, z});
                ++(i == kLava ? n.lava : i == kCold ? n.cold : n.slow);
                if (i == kLava && !result.gradient.active({x, y, z})) ++n.plateau;
            }
    return n;
}

TEST(Cooling, ChevronLeavesAPlateauOfFourLayers)
{
    const Coord dims(32, 32, 32);
    const Result result = cooled(region_of(dims, chevron), dims, {.steps = 60});
    EXPECT_NEAR(result.temperature.value({16, 16, 16}), 1999.441, 1e-3);
    EXPECT_NEAR(result.temperature.value({4, 16, 24}), 1727.778, 1e-3);
    EXPECT_NEAR(result.temperature.value({10, 5, 26}), 1301.076, 1e-3);
    EXPECT_NEAR(result.temperature.value({27, 20, 20}), 1981.585, 1e-3);
    const Counts n = count(dims, chevron, result);
    EXPECT_EQ(n.lava, 26624);
    EXPECT_EQ(n.cold, 6144);
    EXPECT_EQ(n.slow, 0);
    EXPECT_EQ(n.plateau, 4096);
    EXPECT_EQ(result.gradient.value({7, 20, 3}), Vec3f(0, 0, 1));  // from cold to hot
    EXPECT_EQ(result.gradient.value({7, 20, 28}), Vec3f(0, 0, -1));
}

TEST(Cooling, FanReachesTheIndependentlyComputedTemperatures)
{
    const Coord dims(32, 32, 32);
    const Result result = cooled(region_of(dims, fan), dims, {.steps = 800});
    EXPECT_NEAR(result.temperature.value({16, 16, 16}), 1486.952, 1e-3);
    EXPECT_NEAR(result.temperature.value({4, 16, 24}), 791.148, 1e-3);
    EXPECT_NEAR(result.temperature.value({10, 5, 26}), 547.989, 1e-3);
    EXPECT_NEAR(result.temperature.value({27, 20, 20}), 1232.396, 1e-3);
    const Counts n = count(dims, fan, result);
    EXPECT_EQ(n.lava, 21504);
    EXPECT_EQ(n.cold, 3072);
    EXPECT_EQ(n.slow, 8192);
    EXPECT_EQ(n.plateau, 0);
}

TEST(Cooling, StoresUnitVectorsAndActiveLavaWithItsHalo)
{
    const Coord dims(32, 32, 32);
    const Result result = cooled(region_of(dims, rosette), dims, {.steps = 300});
    for (int x = 0; x < 32; ++x)
        for (int y = 0; y < 32; ++y)
            for (int z = 0; z < 32; ++z) {
                const Coord c(x, y, z);
                bool near = false;
                for (int n = 0; n < 27; ++n) {
                    const Coord m = c + Coord(n / 9 - 1, n / 3 % 3 - 1, n % 3 - 1);
                    near = near || (Domain{dims, {}}.contains(m) && rosette(m) == kLava);
                }
                ASSERT_EQ(result.temperature.active(c), near);
                const bool directed = result.gradient.active(c);
                ASSERT_EQ(result.gradient_magnitude.active(c), directed);
                ASSERT_TRUE(near || !directed);
                ASSERT_NEAR(length(result.gradient.value(c)), directed ? 1 : 0, 1e-6);
                if (directed) {
                    ASSERT_GE(result.gradient_magnitude.value(c), 1.8f);
                }
            }
    EXPECT_EQ(result.temperature.background(), 200);
    EXPECT_EQ(result.temperature.transform(), kPlace);
    // Halo cells on the cold face point into the lava.
    EXPECT_GT(result.gradient.value({3, 3, 2}).z, 0.99);
    EXPECT_LT(result.gradient.value({3, 3, 29}).z, -0.99);
}

TEST(Cooling, IsMirroredWhereTheRegionIs)
{
    const Coord dims(32, 32, 32);
    const Result result = cooled(region_of(dims, rosette), dims, {.steps = 200});
    for (int x = 0; x < 32; ++x)
        for (int y = 0; y < 32; ++y)
            for (int z = 3; z < 29; ++z) {
                const Coord c(x, y, z);
                ASSERT_NEAR(result.temperature.value(c), result.temperature.value({31 - x, y, z}),
                            1e-3);
                ASSERT_NEAR(result.temperature.value(c), result.temperature.value({y, x, z}), 1e-3);
                ASSERT_NEAR(result.temperature.value(c), result.temperature.value({x, y, 31 - z}),
                            1e-3);
            }
}

std::int32_t ball(Coord c, Vec3d centre)
{
    const double r = length(centre_of(c) - centre);
    return r < 4 ? kSlow : r < 17.3 ? kLava : kCold;
}

TEST(Cooling, SparseRunGivesTheBytesOfTheDenseOne)
{
    const Params params{.slow_temperature = 2100, .steps = 77, .robin = 0.8};
    auto id = [](Coord c) { return ball(c, {21.5, 22, 23}); };
    const Coord small(47, 45, 44), large(203, 130, 81);
    const Result dense = cooled(region_of(small, id), small, params);
    const Result sparse = cooled(region_of(large, id), large, params);
    expect_same_bytes(dense, sparse);
    for (const std::size_t threads : {1u, 2u, 7u}) {
        const ThreadLimit limit(threads);
        expect_same_bytes(cooled(region_of(small, id), small, params), dense);
        expect_same_bytes(cooled(region_of(large, id), large, params), dense);
    }
}

TEST(Cooling, ConstantPartsStayConstants)
{
    const Coord dims(160, 128, 120);
    const Result result = cooled(
        region_of(dims, [](Coord c) { return c.z >= 112 ? kCold : kLava; }), dims, {.steps = 20});
    ASSERT_EQ(result.temperature.leaf_count(), 20u * 16 * 15);
    EXPECT_LE(result.temperature.dense_leaf_count(), 20u * 16 * 7);
    EXPECT_LE(result.gradient.dense_leaf_count(), 20u * 16 * 3);
    EXPECT_EQ(result.temperature.value({80, 60, 3}), 2000);
    EXPECT_LT(result.temperature.value({80, 60, 111}), 1000);
}

TEST(Cooling, SteadyStateBetweenTwoHeldFacesIsLinear)
{
    const Coord dims(3, 4, 21);
    const IntGrid region = region_of(dims, [](Coord c) {
        return c.z == 0 ? kSlow : c.z == 20 ? kCold : kLava;
    });
    const Result result =
        cooled(region, dims, {.alpha = 0.16, .stop = Stop::Steady, .steady_change = 1e-7});
    EXPECT_LT(result.last_change, 1e-7);
    for (int z = 0; z < 21; ++z)
        EXPECT_NEAR(result.temperature.value({1, 2, z}), 2000 - 90.0 * z, 0.01);
    EXPECT_NEAR(result.gradient_magnitude.value({1, 2, 10}), 90, 1e-3);
    EXPECT_THAT(([&] { cooled(region, dims, {.steps = 50, .stop = Stop::Steady}); }),
                ThrowsMessage<NumericalError>(HasSubstr("not steady after 50 steps")));
}

// Slab of thickness L, insulated at one side, convection at the other: T - T_air = (T0 - T_air)
// sum C_n cos(z_n x / L) exp(-z_n^2 Fo), z tan z = Bi L / H [Carslaw1959, 3.11].
double convective_error(int cells, double biot_of_slab)
{
    const Coord dims(2, 3, cells + 3);
    const IntGrid region = region_of(dims, [=](Coord c) { return c.z < cells ? kLava : kCold; });
    const double alpha = 0.125, fourier = 0.25;
    const Params params{.alpha = alpha,
                        .cold_temperature = 300,
                        .steps = int(std::lround(fourier * cells * cells / alpha)),
                        .robin = biot_of_slab / cells};
    const Result result = cooled(region, dims, params);
    double worst = 0;
    for (int z = 0; z < cells; ++z) {
        double exact = 300;
        for (int n = 0; n < 40; ++n) {
            double low = n * pi, high = n * pi + pi / 2;
            for (int i = 0; i < 60; ++i) {
                const double mid = (low + high) / 2;
                (mid * std::tan(mid) < biot_of_slab ? low : high) = mid;
            }
            exact += 1700 * 4 * std::sin(low) / (2 * low + std::sin(2 * low)) *
                     std::cos(low * (z + 0.5) / cells) * std::exp(-low * low * fourier);
        }
        worst = std::max(worst, std::abs(result.temperature.value({1, 1, z}) - exact));
    }
    return worst / 1700;
}

TEST(Cooling, ConvectiveSlabConvergesToTheExactSeriesAtSecondOrder)
{
    for (const double biot : {0.5, 2.0, 20.0}) {
        const double coarse = convective_error(12, biot), fine = convective_error(24, biot);
        EXPECT_LT(fine, 1e-3) << biot;
        EXPECT_NEAR(std::log2(coarse / fine), 2, 0.15) << biot;
    }
}

TEST(Cooling, ConvectionOfEndlessStrengthHoldsTheFaceItself)
{
    // Bi -> infinity: the wall is half a cell away, not at the next cell's centre.
    const Coord dims(2, 2, 12);
    const IntGrid region = region_of(dims, [](Coord c) {
        return c.z == 0 ? kSlow : c.z < 11 ? kLava : kCold;
    });
    const Result result = cooled(region, dims, {.steps = 20000, .robin = 1e12});
    for (int z = 0; z < 11; ++z)
        EXPECT_NEAR(result.temperature.value({0, 1, z}), 2000 - 1800 * z / 10.5, 1e-2);
}

TEST(Cooling, NamesTheStableLimitAndTakesMoreOnlyWhenAllowed)
{
    const Coord dims(8, 9, 10);
    const IntGrid region = region_of(dims, [](Coord c) { return c.z > 3 ? kLava : kCold; });
    EXPECT_THAT(([&] { cooled(region, dims, {.alpha = 0.17}); }),
                ThrowsMessage<InvalidParameter>(HasSubstr("alpha = 0.17, must be <= 1/6")));
    EXPECT_EQ(cooled(region, dims, {.alpha = 0.17, .steps = 3, .allow_unstable = true}).steps, 3);
    EXPECT_EQ(cooled(region, dims, {.alpha = 1.0 / 6, .steps = 3}).steps, 3);
    EXPECT_THAT(
        ([&] { cooled(region, dims, {.alpha = 0.6, .steps = 100000, .allow_unstable = true}); }),
        ThrowsMessage<NumericalError>(HasSubstr("overflows")));
    // A single cell in strong convection loses twice as much on each face.
    const IntGrid cell =
        region_of(dims, [](Coord c) { return c == Coord(3, 4, 5) ? kLava : kCold; });
    EXPECT_THAT(([&] { cooled(cell, dims, {.robin = 1e9}); }),
                ThrowsMessage<InvalidParameter>(
                    AllOf(HasSubstr("alpha = 0.1, must be <= 0.08333"), HasSubstr("convective"))));
    EXPECT_EQ(cooled(cell, dims, {.alpha = 0.08, .steps = 1, .robin = 1e9}).steps, 1);
}

TEST(Cooling, RefusesABodyThatCannotCool)
{
    const Coord dims(10, 11, 12);
    const IntGrid all_lava = region_of(dims, [](Coord) { return kLava; });
    EXPECT_THAT(([&] { cooled(all_lava, dims, {}); }),
                ThrowsMessage<InvalidInput>(HasSubstr("no cooling surface: no columns possible")));
    const IntGrid half = region_of(dims, [](Coord c) { return c.y < 5 ? kLava : kCold; });
    EXPECT_THAT(([&] { cooled(half, dims, {.lava_temperature = 200}); }),
                ThrowsMessage<InvalidInput>(HasSubstr("no cooling surface: no columns possible")));
    const IntGrid hot = region_of(dims, [](Coord c) { return c.y < 5 ? kLava : kSlow; });
    EXPECT_THAT(([&] { cooled(hot, dims, {}); }), ThrowsMessage<InvalidInput>(HasSubstr("2000 K")));
    EXPECT_EQ(cooled(hot, dims, {.slow_temperature = 1500}).steps, 200);
    EXPECT_THAT(
        ([&] { cooled(half, dims, {.steps = 50, .plateau_gradient = 1e5}); }),
        ThrowsMessage<InvalidInput>(AllOf(HasSubstr("after 50 steps"), HasSubstr("100000"))));
}

TEST(Cooling, NamesWhatIsWrongWithTheRegion)
{
    const Coord dims(10, 11, 12);
    const IntGrid cold = region_of(dims, [](Coord c) { return c.x < 3 ? kSlow : kCold; });
    EXPECT_THAT(([&] { cooled(cold, dims, {}); }),
                ThrowsMessage<InvalidInput>(HasSubstr("no lava")));
    EXPECT_THAT(([&] { cooled(IntGrid(LeafTopology::build({}), kPlace, kCold), dims, {}); }),
                ThrowsMessage<InvalidInput>(HasSubstr("no lava")));
    const IntGrid far = region_of({40, 11, 12}, [](Coord c) { return c.x > 30 ? kLava : kCold; });
    EXPECT_THAT(([&] { cooled(far, dims, {}); }),
                ThrowsMessage<InvalidInput>(AllOf(
                    HasSubstr("lie outside the heat domain of 10 x 11 x 12"), HasSubstr("1188"))));
    const IntGrid odd = region_of(dims, [](Coord c) { return c == Coord(9, 2, 7) ? 5 : kLava; });
    EXPECT_THAT(([&] { cooled(odd, dims, {}); }),
                ThrowsMessage<InvalidInput>(HasSubstr("region = 5 at voxel (9, 2, 7)")));
    IntGrid moved = region_of(dims, [](Coord c) { return c.x < 3 ? kLava : kCold; });
    moved.set_transform({{0, 0, 0}, 0.4});
    EXPECT_THAT(([&] { cooled(moved, dims, {}); }),
                ThrowsMessage<InvalidInput>(HasSubstr("resample")));
    EXPECT_THAT(([] { validate({.alpha = -1}); }),
                ThrowsMessage<InvalidParameter>(HasSubstr("alpha")));
    EXPECT_THAT(([] { validate({.lava_temperature = 1e38}); }),
                ThrowsMessage<InvalidParameter>(HasSubstr("lava_temperature")));
}

TEST(Cooling, StepsOfABodyNothingIsKnownOfGrowWithTheSquareOfItsInnerRadius)
{
    const Coord dims{27, 30, 33};
    auto plate = [&](int thickness) {
        return region_of(dims,
                         [=](Coord c) { return c.y >= 5 && c.y < 5 + thickness ? kLava : kCold; });
    };
    auto steps = [&](const IntGrid& region, double alpha, int most) {
        return suitable_steps(region, {dims, kPlace}, alpha, most);
    };
    // Half of the plate's thickness is its inner radius: 0.083 R^2 / alpha.
    EXPECT_EQ(steps(plate(8), 0.1, 5000), 13);
    EXPECT_EQ(steps(plate(16), 0.1, 5000), 53);
    EXPECT_EQ(steps(plate(16), 0.05, 5000), 106);
    EXPECT_EQ(steps(plate(16), 0.1, 40), 40);
    EXPECT_EQ(steps(plate(1), 0.1, 5000), 4);
    const IntGrid hot_below = region_of(dims, [](Coord c) {
        return c.z < 4 ? kSlow : c.z < 12 ? kLava : kCold;
    });
    EXPECT_EQ(steps(hot_below, 0.1, 5000), 5000);
}

TEST(Cooling, TakesNoStepAndTheSmallestBody)
{
    const Coord dims(1, 1, 2);
    const IntGrid region = region_of(dims, [](Coord c) { return c.z == 0 ? kLava : kCold; });
    const Result start = cooled(region, dims, {.steps = 0});
    EXPECT_EQ(start.temperature.value({0, 0, 0}), 2000);
    EXPECT_EQ(start.temperature.value({0, 0, 1}), 200);
    EXPECT_EQ(start.gradient.value({0, 0, 0}), Vec3f(0, 0, -1));
    const Result one = cooled(region, dims, {.steps = 1});
    EXPECT_EQ(one.temperature.value({0, 0, 0}), 1820);
    EXPECT_EQ(one.last_change, 180);
}

// Checkpoints -----------------------------------------------------------------------------------

const Coord kDims(24, 19, 21);
IntGrid checkpoint_region()
{
    return region_of(kDims, [](Coord c) { return ball(c, {11, 9, 10}); });
}

std::vector<std::string> checkpoints_of(const Params& params, Result* result = nullptr)
{
    std::vector<std::string> saved;
    Checkpoint checkpoint;
    checkpoint.save = [&](const std::string& bytes) { saved.push_back(bytes); };
    checkpoint.interval = 1;
    const Result end = cooled(checkpoint_region(), kDims, params, checkpoint);
    if (result) *result = end;
    return saved;
}

TEST(Cooling, ResumesFromAnyCheckpointToTheSameBytes)
{
    for (const Params& params : {Params{.steps = 7000, .plateau_gradient = 0.0, .robin = 1.5},
                                 Params{.steps = 60, .stop = Stop::Steady, .steady_change = 10}}) {
        Params p = params;
        Result whole;
        const auto saved = checkpoints_of(p, &whole);
        ASSERT_GE(saved.size(), 2u);
        for (const std::string& bytes : {saved.front(), saved[saved.size() / 2], saved.back()}) {
            Checkpoint resumed;
            resumed.resume = bytes;
            expect_same_bytes(cooled(checkpoint_region(), kDims, p, resumed), whole);
        }
    }
}

TEST(Cooling, SavesACheckpointWhenCancelled)
{
    const Params params{.steps = 5000};
    std::atomic<bool> cancel{false};
    const Progress progress([&](const std::string&, double done) { cancel = done > 0.3; }, &cancel);
    std::string saved;
    Checkpoint checkpoint;
    checkpoint.save = [&](const std::string& bytes) { saved = bytes; };
    const IntGrid region = checkpoint_region();
    EXPECT_THROW(run({region, {kDims, kPlace}}, params, checkpoint, progress), Cancelled);
    ASSERT_FALSE(saved.empty());
    checkpoint.resume = saved;
    expect_same_bytes(cooled(region, kDims, params, checkpoint), cooled(region, kDims, params));
}

TEST(Cooling, RefusesAForeignOrDamagedCheckpointAndSaysWhy)
{
    const Params params{.steps = 3000};
    const std::string good = checkpoints_of(params).front();
    auto resume = [](const std::string& bytes, const Params& p, const IntGrid& region, Coord dims) {
        Checkpoint checkpoint;
        checkpoint.resume = bytes;
        cooled(region, dims, p, checkpoint);
    };
    auto expect = [&](const std::string& bytes, const Params& p, const char* message) {
        EXPECT_THAT(
            ([&] { resume(bytes, p, checkpoint_region(), kDims); }),
            ThrowsMessage<InvalidInput>(AllOf(HasSubstr(message), HasSubstr("checkpoint"))));
    };
    resume(good, params, checkpoint_region(), kDims);
    expect(good, {.steps = 3001}, "steps = 3000, this run has 3001");
    expect(good, {.alpha = 0.125, .steps = 3000}, "alpha = 0.1, this run has 0.125");
    expect("nonsense", params, "not a checkpoint");
    for (const std::size_t at : {40ul, good.size() / 2, good.size() - 5}) {
        std::string bad = good;
        bad[at] = static_cast<char>(bad[at] ^ 4);
        expect(bad, params, "damaged");
    }
    for (std::size_t keep = 0; keep < good.size(); keep += 997)
        if (keep > 0) expect(good.substr(0, keep), params, "checkpoint");
    const IntGrid other = region_of(kDims, [](Coord c) {
        return c == Coord(11, 9, 10) ? kLava : ball(c, {11, 9, 10});
    });
    EXPECT_THAT(([&] { resume(good, params, other, kDims); }),
                ThrowsMessage<InvalidInput>(HasSubstr("of another run: region = ")));
    EXPECT_THAT(
        ([&] {
            resume(good, params, checkpoint_region(), {24, 19, 22});
        }),
        ThrowsMessage<InvalidInput>(HasSubstr("cells = [24,19,21], this run has [24,19,22]")));
}

}  // namespace
}  // namespace sekitei::cooling
