#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <complex>
#include <map>
#include <numeric>
#include <set>

#include "core/error.h"
#include "core/hash.h"
#include "core/parallel.h"
#include "tests/solvers/moss/land.h"

namespace sekitei::moss {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::ThrowsMessage;

const std::vector<Species> kThree{species_called("bryum"), species_called("hypnum"),
                                  species_called("polytrichum")};
const Community kCommunity{kThree, {}, {.spore_throw = 0.1}, 21};
const ColonyParams kParams{.cap = 4000};

const Land& land()
{
    static const Land l(boulder(0.15, 4), 0.03);
    return l;
}

void live(Colony& colony, int days)
{
    for (int d = 0; d < days; ++d) {
        std::vector<float> plants, seeds;
        auto g = [&](Vec3f p) {
            return static_cast<float>(0.6 + 0.4 * std::sin(19 * double(p.x)) *
                                                std::cos(18 * double(p.y) + colony.day));
        };
        for (const Vec3f& p : colony.plants.foot) plants.push_back(g(p));
        for (const Vec3f& p : colony.seeds.foot) seeds.push_back(g(p));
        day(colony, kCommunity, kParams, land().surface, {plants, seeds, {}, {}}, {});
        for (float& light : colony.plants.light) light += 1.5F;  // as who computes it would
    }
}

const Colony& settled()
{
    static const Colony c = [] {
        Colony colony = first_settlers(kCommunity, kParams, land().sites);
        live(colony, 40);
        return colony;
    }();
    return c;
}

ColonyCheckpoint checkpoint()
{
    return {21,
            R"({"mesh": "0123456789abcdef0123456789abcdef", "size": 0.01})",
            settled(),
            {{"soil_water", {1.5, 2.25, -0.0}}, {"empty", {}}}};
}

ColonyCheckpoint read(std::string_view bytes, const std::string& recipe = checkpoint().recipe,
                      std::uint64_t seed = 21)
{
    return decode_colony(bytes, "run/checkpoint.bin", seed, recipe, land().sites.size());
}

// Checkpoints -------------------------------------------------------------------------------------

TEST(ColonyCheckpoint, ComesBackAsItWas)
{
    EXPECT_GT(settled().plants.size(), 1000u);
    EXPECT_GT(settled().seeds.size(), 100u);
    const std::string bytes = encode(checkpoint());
    EXPECT_EQ(read(bytes), checkpoint());
    EXPECT_EQ(encode(read(bytes)), bytes);
    // Little more than the state, which is at most 96 bytes each.
    EXPECT_LT(bytes.size(), 600 + 80 * (settled().plants.size() + settled().seeds.size()));
}

TEST(ColonyCheckpoint, ARestartEqualsTheUninterruptedRunByteForByte)
{
    Colony whole = settled();
    live(whole, 12);
    Colony part = settled();
    live(part, 5);
    part = read(encode({21, checkpoint().recipe, part, {}})).population;
    live(part, 7);
    EXPECT_EQ(encode({21, "", part, {}}), encode({21, "", whole, {}}));
}

TEST(ColonyCheckpoint, OfAnotherMeshOrRunIsRefusedNamingWhatDiffers)
{
    const std::string bytes = encode(checkpoint());
    const std::string other = R"({"mesh": "fedcba9876543210fedcba9876543210", "size": 0.02})";
    EXPECT_THAT([&] { read(bytes, other, 22); },
                ThrowsMessage<InvalidInput>(
                    AllOf(HasSubstr("run/checkpoint.bin: checkpoint of another run"),
                          HasSubstr("seed 21, this run has 22"), HasSubstr("mesh is another"),
                          HasSubstr("size 0.01, this run has 0.02"))));
    EXPECT_THAT([&] { decode_colony(bytes, "c", 21, checkpoint().recipe, 10); },
                ThrowsMessage<InvalidInput>(HasSubstr("beyond the 10 there are")));
    const std::string cells = encode(Checkpoint{21, "", Population(3), {}});
    EXPECT_THAT(
        [&] { read(cells); },
        ThrowsMessage<InvalidInput>("run/checkpoint.bin: not a checkpoint of moss on a mesh"));
    EXPECT_THAT([&] { decode(bytes, "c", 21, "", 3); },
                ThrowsMessage<InvalidInput>("c: not a checkpoint of moss"));
}

TEST(ColonyCheckpoint, DamageIsFoundWhereverItIs)
{
    Colony small;
    plant(small, {1, 2, 3}, 1);
    sow(small, {1, 2, 3}, Seed::Spore);
    const std::string bytes = encode({21, checkpoint().recipe, small, {{"a", {1}}}});
    for (std::size_t i = 0; i < bytes.size(); ++i) {
        std::string bad = bytes;
        bad[i] = static_cast<char>(bad[i] ^ 4);
        EXPECT_THROW(read(bad), InvalidInput) << i;
        EXPECT_THROW(read(bytes.substr(0, i)), InvalidInput) << i;
    }
    small.plants.born.clear();
    EXPECT_THAT(
        [&] {
            read(encode({21, checkpoint().recipe, small, {}}));
        },
        ThrowsMessage<InvalidInput>(HasSubstr("arrays of different lengths")));
}

// Points ------------------------------------------------------------------------------------------

Vec3d turned(const std::array<float, 4>& q, Vec3d v)
{
    const Vec3d u(q[0], q[1], q[2]);
    const double w = q[3];
    return u * (2 * dot(u, v)) + v * (w * w - dot(u, u)) + cross(u, v) * (2 * w);
}

TEST(ColonyPoints, AreTheLivingWithEverythingKnownOfThem)
{
    const Colony& c = settled();
    const std::size_t n = c.plants.size();
    std::vector<float> suit(n), humidity(land().sites.size());
    for (std::size_t i = 0; i < n; ++i) suit[i] = static_cast<float>(i) / 7;
    for (std::size_t i = 0; i < humidity.size(); ++i) humidity[i] = static_cast<float>(i) / 3;
    const Points points = to_points(c, kCommunity, kParams, land().surface, suit, humidity);
    ASSERT_EQ(points.position.size(), n);
    std::vector<std::string> names;
    for (const auto& [name, values] : points.attributes) names.push_back(name);
    EXPECT_THAT(names, testing::UnorderedElementsAre("N", "orient", "pscale", "species", "growth",
                                                     "growth_max", "age", "id", "host", "S", "suit",
                                                     "interior", "wetness"));
    const auto& species = *points.values<std::int32_t>("species");
    const auto& age = *points.values<std::int32_t>("age");
    const auto& id = *points.values<std::int64_t>("id");
    const auto& host = *points.values<std::int64_t>("host");
    const auto& pscale = *points.values<float>("pscale");
    const auto& wetness = *points.values<float>("wetness");
    const auto& inner = *points.values<std::int32_t>("interior");
    EXPECT_EQ(*points.values<float>("S"), c.plants.light);
    EXPECT_EQ(*points.values<float>("suit"), suit);
    EXPECT_EQ(*points.values<float>("growth"), c.plants.growth);
    EXPECT_EQ(*points.values<Vec3f>("N"), c.plants.normal);
    const auto interior_now = interior(c.plants, kParams);
    double moved = 0;
    int on_moss = 0;
    for (std::size_t i = 0; i < n; ++i) {
        EXPECT_EQ(species[i], c.plants.species[i]);
        EXPECT_EQ(age[i], 40 - c.plants.born[i]);
        EXPECT_EQ(id[i], static_cast<std::int64_t>(c.plants.id[i]));
        EXPECT_EQ(host[i], c.plants.host[i] ? static_cast<std::int64_t>(c.plants.host[i])
                                            : -1 - static_cast<std::int64_t>(c.plants.site[i]));
        on_moss += host[i] > 0;
        EXPECT_FLOAT_EQ(pscale[i], static_cast<float>(
                                       std::min(1.0, std::sqrt(double(c.plants.growth[i]) / 2))));
        EXPECT_EQ(wetness[i], humidity[c.plants.site[i]]);
        EXPECT_EQ(inner[i], interior_now[i]);
        const double by = length(points.position[i] - Vec3d(c.plants.foot[i]));
        EXPECT_LT(by, 0.03);
        moved += by / static_cast<double>(n);
        if (host[i] < 0) {
            EXPECT_TRUE(land().surface.closest(points.position[i], 1e-9)) << i;
        }
    }
    EXPECT_GT(moved, 0.001);
    EXPECT_LT(moved, 0.006);
    EXPECT_GT(on_moss, 5);
    EXPECT_GT(std::accumulate(inner.begin(), inner.end(), 0), 5);
    EXPECT_EQ(settled().plants.foot, c.plants.foot);  // nothing feeds back
}

TEST(ColonyPoints, LeanByTenDegreesAtMostFromBetweenNormalAndUpWithAnyYaw)
{
    const Colony& c = settled();
    const Points points = to_points(c, kCommunity, kParams, land().surface, {}, {});
    EXPECT_FALSE(points.attributes.contains("suit"));
    EXPECT_FALSE(points.attributes.contains("wetness"));
    const auto& orient = *points.values<std::array<float, 4>>("orient");
    double most = 0;
    Vec3d forward;
    for (std::size_t i = 0; i < orient.size(); ++i) {
        double size = 0;
        for (const float q : orient[i]) size += double(q) * double(q);
        EXPECT_NEAR(size, 1, 1e-6);
        const Vec3d n(c.plants.normal[i]), axis = normalized(n + Vec3d(0, 0, 1));
        const double lean = std::acos(std::min(1.0, dot(turned(orient[i], {0, 1, 0}), axis)));
        EXPECT_LE(lean, 10.001 * math::kPi / 180);
        most = std::max(most, lean);
        forward += turned(orient[i], {0, 0, 1}) / static_cast<double>(orient.size());
    }
    EXPECT_GT(most, 9.8 * math::kPi / 180);
    EXPECT_LT(length(forward), 0.1);
}

TEST(ColonyPoints, HangingStraightDownIsAWayToStand)
{
    Colony colony;
    plant(colony, {1.5, -2, 0.1}, 1, {0, 0, -1});
    colony.plants.host[0] = 5;
    const Points points = to_points(colony, kCommunity, kParams, land().surface, {}, {});
    const auto& q = (*points.values<std::array<float, 4>>("orient"))[0];
    EXPECT_LT(turned(q, {0, 1, 0}).z, -std::cos(0.1746));
}

/// Power of a signal at k cycles over its length, windowed.
double power(const std::vector<double>& signal, int k)
{
    const double n = static_cast<double>(signal.size());
    std::complex<double> sum;
    for (std::size_t i = 0; i < signal.size(); ++i) {
        const double phase = 2 * math::kPi * (static_cast<double>(i) + 0.5) / n;
        sum += signal[i] * (1 - std::cos(phase)) * std::polar(1.0, -phase * k);
    }
    return std::norm(sum);
}

TEST(ColonyPoints, StrayByNoiseWhoseSpectrumFallsAsOneOverF)
{
    // Rows of plants across a floor, in any direction; how each strays.
    const Land flat(floor_mesh(10, 10), 2);
    constexpr int kPlants = 2048, kRows = 12;
    constexpr double kLength = 8;                   // [m]
    std::map<int, std::pair<double, int>> octaves;  // sum of powers and their number
    double square = 0;
    for (int row = 0; row < kRows; ++row) {
        const double angle = 0.13 * row;
        Colony colony;
        for (int i = 0; i < kPlants; ++i) {
            const double t = kLength * (i + 0.5) / kPlants;
            plant(colony,
                  Vec3d(0.3 + 0.1 * row + t * std::cos(angle), 0.2 + t * std::sin(angle), 0.7), 1);
        }
        const Points points = to_points(colony, kCommunity, kParams, flat.surface, {}, {});
        for (const bool second : {false, true}) {
            std::vector<double> stray;
            for (int i = 0; i < kPlants; ++i) {
                const Vec3d by = points.position[static_cast<std::size_t>(i)] -
                                 Vec3d(colony.plants.foot[static_cast<std::size_t>(i)]);
                EXPECT_NEAR(by.z, 0, 1e-9);
                stray.push_back(second ? by.y : by.x);
                square += stray.back() * stray.back() / (2 * kRows * kPlants);
            }
            // From 0.75 to 24 cycles a metre, 1.5 decades: gradient noise has its power below
            // half the frequency of its lattice, which goes from 2 to 64.
            for (int k = 6; k < 192; ++k) {
                auto& [sum, count] = octaves[static_cast<int>(2 * std::log2(k / 6.0))];
                sum += power(stray, k);
                ++count;
            }
        }
    }
    // Slope of log power against log frequency, by least squares over half octaves.
    double n = 0, x = 0, y = 0, xx = 0, xy = 0;
    for (const auto& [half, total] : octaves) {
        const double u = half / 2.0 * std::log(2), v = std::log(total.first / total.second);
        n += 1, x += u, y += v, xx += u * u, xy += u * v;
    }
    EXPECT_EQ(n, 10);
    EXPECT_NEAR((n * xy - x * y) / (n * xx - x * x), -1, 0.25);
    EXPECT_NEAR(std::sqrt(square), 0.5 * kParams.size * 0.6, 0.5 * kParams.size * 0.3);
}

TEST(ColonyPoints, SeedsAreWhereTheyRest)
{
    const Colony& c = settled();
    const Points points = seeds_to_points(c);
    ASSERT_EQ(points.position.size(), c.seeds.size());
    const auto& kind = *points.values<std::int32_t>("kind");
    const auto& age = *points.values<std::int32_t>("age");
    std::set<int> kinds(kind.begin(), kind.end());
    EXPECT_EQ(kinds, (std::set{1, 2}));
    for (std::size_t i = 0; i < age.size(); ++i) {
        EXPECT_EQ(points.position[i], Vec3d(c.seeds.foot[i]));
        EXPECT_EQ(age[i], 40 - c.seeds.landed[i]);
    }
}

TEST(ColonyPoints, AreTheSameOnAnyNumberOfThreadsAndRefuseWhatDoesNotFit)
{
    auto hash = [](std::size_t threads) {
        const ThreadLimit limit(threads);
        return content_hash(to_points(settled(), kCommunity, kParams, land().surface, {}, {}));
    };
    EXPECT_EQ(hash(1), hash(4));
    const std::vector<float> few(3);
    EXPECT_THROW(to_points(settled(), kCommunity, kParams, land().surface, few, {}), InvalidInput);
    EXPECT_THROW(to_points(settled(), kCommunity, kParams, land().surface, {}, few), InvalidInput);
}

}  // namespace
}  // namespace sekitei::moss
