#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "core/error.h"
#include "core/hash.h"
#include "core/parallel.h"
#include "grids/vdb_points.h"
#include "tests/solvers/moss/sites.h"

namespace sekitei::moss {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;
using testing::ThrowsMessage;

const std::vector<Species> kThree{kind("bryum"), kind("hypnum"), kind("polytrichum")};
const Community kCommunity{kThree, {}, {}, 21};

const Ground& ground()
{
    static const Ground g({49, 45, 41}, bumpy, 0.03);
    return g;
}

std::vector<std::vector<float>> fitness_on(int day)
{
    std::vector<std::vector<float>> g(3);
    for (std::size_t k = 0; k < 3; ++k)
        for (const Vec3d& p : ground().cells.position)
            g[k].push_back(static_cast<float>(0.6 + 0.4 * std::sin(9 * p.x + double(k)) *
                                                        std::cos(8 * p.y + day * 0.1)));
    return g;
}

void live(Population& p, int days)
{
    for (int d = 0; d < days; ++d) {
        const auto g = fitness_on(p.day + 1);
        day(p, kCommunity, ground().surface(), ground().landing, {g, {}, {}}, {});
    }
}

const Population& settled()
{
    static const Population p = [] {
        Population q = first_settlers(kCommunity, ground().surface());
        live(q, 40);
        return q;
    }();
    return p;
}

Checkpoint checkpoint()
{
    return {21, "0123abcd", settled(), {{"soil_water", {1.5, 2.25, -0.0}}, {"empty", {}}}};
}

Checkpoint read(std::string_view bytes)
{
    return decode(bytes, "run/checkpoint.bin", 21, "0123abcd", ground().cells.size());
}

TEST(MossCheckpoint, ComesBackAsItWas)
{
    const Checkpoint c = checkpoint();
    EXPECT_GT(count(settled(), kCommunity, ground().surface()).species[0].living, 100);
    const std::string bytes = encode(c);
    EXPECT_EQ(read(bytes), c);
    EXPECT_EQ(encode(read(bytes)), bytes);
    EXPECT_LT(bytes.size(), 200 + 40 * ground().cells.size());
}

TEST(MossCheckpoint, ARestartEqualsTheUninterruptedRunByteForByte)
{
    Population whole = first_settlers(kCommunity, ground().surface());
    live(whole, 60);
    Population part = read(encode(checkpoint())).population;
    live(part, 20);
    EXPECT_EQ(encode({21, "x", part, {}}), encode({21, "x", whole, {}}));
}

TEST(MossCheckpoint, OfAnotherRunIsRefusedNamingWhatDiffers)
{
    const std::string bytes = encode(checkpoint());
    const std::size_t sites = ground().cells.size();
    auto refuses = [&](std::uint64_t seed, const char* recipe, std::size_t n, auto matcher) {
        EXPECT_THAT([&] { decode(bytes, "run/checkpoint.bin", seed, recipe, n); },
                    ThrowsMessage<InvalidInput>(AllOf(HasSubstr("run/checkpoint.bin"), matcher)));
    };
    refuses(22, "0123abcd", sites,
            AllOf(HasSubstr("seed 21, this run has 22"), Not(HasSubstr("recipe"))));
    refuses(21, "ffff", sites,
            AllOf(HasSubstr("recipe 0123abcd, this run has ffff"), Not(HasSubstr("seed"))));
    refuses(21, "0123abcd", 5, HasSubstr("sites, this run has 5"));
    refuses(1, "ffff", sites, AllOf(HasSubstr("seed 21"), HasSubstr("recipe 0123abcd")));
    std::string newer = bytes;
    newer[8] = 2;
    EXPECT_THAT([&] { read(newer); },
                ThrowsMessage<InvalidInput>(HasSubstr("version 2, this program reads version 1")));
    EXPECT_THAT([&] { read("PK\3\4 something else"); },
                ThrowsMessage<InvalidInput>(HasSubstr("not a checkpoint")));
    EXPECT_THAT([&] { read(""); }, ThrowsMessage<InvalidInput>(HasSubstr("not a checkpoint")));
}

TEST(MossCheckpoint, DamageIsFoundWhereverItIs)
{
    const Population small(3);
    const std::string bytes = encode({21, "0123abcd", small, {{"soil_water", {1, 2, 3}}}});
    auto open = [](std::string_view b) { return decode(b, "c", 21, "0123abcd", 3); };
    EXPECT_NO_THROW(open(bytes));
    for (std::size_t i = 0; i < bytes.size(); ++i) {
        std::string bad = bytes;
        bad[i] = static_cast<char>(bad[i] ^ 0x10);
        EXPECT_THROW(open(bad), InvalidInput) << i;
        EXPECT_THROW(open(std::string_view(bytes).substr(0, i)), InvalidInput) << i;
    }
    EXPECT_THAT([&] { open(bytes + "x"); },
                ThrowsMessage<InvalidInput>(HasSubstr("checksum does not match")));
    // A good checksum over nonsense.
    std::string lies = bytes.substr(0, bytes.size() - 32);
    lies[20 + 8 + 8 + 4 + 8 + 8] = '\x7f';  // number of sites
    lies += hash_hex(lies);
    EXPECT_THAT([&] { open(lies); }, ThrowsMessage<InvalidInput>(HasSubstr("ends too early")));
}

template <class T>
const std::vector<T>& values(const Points& points, const char* name)
{
    return std::get<std::vector<T>>(points.attributes.at(name));
}

TEST(MossPoints, AreTheLivingWithTheirRootsOnTheSurface)
{
    const Surface surface = ground().surface();
    std::vector<float> humidity;
    for (const Vec3d& p : surface.position) humidity.push_back(static_cast<float>(p.x));
    const Points points = to_points(settled(), kCommunity, surface, &ground().level_set, humidity);
    const DayStatistics s = count(settled(), kCommunity, surface);
    ASSERT_EQ(
        points.position.size(),
        static_cast<std::size_t>(s.species[0].living + s.species[1].living + s.species[2].living));
    EXPECT_GT(points.position.size(), 1000u);
    GridReader<float> level_set(ground().level_set);
    const double voxel = ground().box.transform.voxel;
    double worst = 0, strayed = 0, off = 0;
    for (std::size_t k = 0; k < points.position.size(); ++k) {
        const double d =
            double(level_set.sample(ground().box.transform.voxels(points.position[k])));
        worst = std::max(worst, std::abs(d));
        const auto i = static_cast<std::size_t>(values<std::int32_t>(points, "site")[k]);
        ASSERT_LT(length(points.position[k] - surface.position[i]), 1.8 * voxel);
        const Vec3d n(surface.normal[i]), way = points.position[k] - surface.foot(i);
        const double across = length(way - n * dot(way, n));
        off = std::max(off, across);
        strayed += across / double(points.position.size());
        ASSERT_EQ(values<std::int32_t>(points, "species")[k], settled().species[i] - 1);
        ASSERT_EQ(values<std::int64_t>(points, "id")[k],
                  static_cast<std::int64_t>(settled().id[i]));
        ASSERT_EQ(values<std::int32_t>(points, "age")[k], 40 - settled().born[i]);
        ASSERT_EQ(values<float>(points, "growth")[k], settled().growth[i]);
        ASSERT_EQ(values<float>(points, "pscale")[k], std::min(1.0F, settled().growth[i] / 2));
        ASSERT_EQ(values<float>(points, "wetness")[k], humidity[i]);
        ASSERT_EQ(values<Vec3f>(points, "N")[k], surface.normal[i]);
    }
    EXPECT_LT(worst, 0.1 * voxel);
    EXPECT_LT(off, 0.51 * voxel);
    EXPECT_NEAR(strayed, 0.333 * voxel, 0.03 * voxel);  // two thirds of the disc's radius
    EXPECT_EQ(points.stage, "moss");
    EXPECT_FALSE(
        to_points(settled(), kCommunity, surface, nullptr, {}).attributes.contains("wetness"));
}

Vec3d rotated(const std::array<float, 4>& q, Vec3d v)
{
    const Vec3d u(Vec3f(q[0], q[1], q[2]));
    const Vec3d t = cross(u, v) * 2;
    return v + t * double(q[3]) + cross(u, t);
}

TEST(MossPoints, StandBetweenTheNormalAndUprightWithAnyYaw)
{
    std::vector<Vec3f> normals{{0, 0, 1}, {0, 0, -1}, {1, 0, 0}, {0, -1, 0}, {0, 1, 0}};
    for (int k = 0; k < 995; ++k) {
        const double z = 2 * uniform01(1, Stream("z"), static_cast<std::uint64_t>(k)) - 1;
        const double a = 0.37 * k, r = std::sqrt(1 - z * z);
        normals.emplace_back(Vec3d(r * std::cos(a), r * std::sin(a), z));
    }
    Sheet sheet(1000, 1);
    sheet.normal = normals;
    Community community = kCommunity;
    community.propagation.initial_count = 1000;
    const Population p = first_settlers(community, sheet.surface());
    const Points points = to_points(p, community, sheet.surface(), nullptr, {});
    const auto& orient = values<std::array<float, 4>>(points, "orient");
    ASSERT_EQ(orient.size(), 1000u);
    double yaw[2] = {}, least = 1;
    for (std::size_t k = 0; k < orient.size(); ++k) {
        const auto& q = orient[k];
        ASSERT_NEAR(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3], 1, 1e-6);
        const Vec3d axis = rotated(q, {0, 1, 0});
        const Vec3d n(normals[k]);
        ASSERT_LT(length(axis - normalized(n + Vec3d(0, 0, .5))), 1e-5);
        ASSERT_GE(axis.z, n.z - 1e-5);
        least = std::min(least, dot(axis, n));
        // The angle of the turned x about the axis, from a fixed direction across it.
        const Vec3d across = normalized(cross(axis, Vec3d(0.31, -0.52, 0.4)));
        const Vec3d x = rotated(q, {1, 0, 0});
        const double angle = std::atan2(dot(cross(across, x), axis), dot(across, x));
        yaw[0] += std::cos(angle) / 1000;
        yaw[1] += std::sin(angle) / 1000;
    }
    EXPECT_GT(least, std::cos(30.01 * 3.14159265 / 180));
    EXPECT_LT(std::hypot(yaw[0], yaw[1]), 0.09);
}

TEST(MossPoints, ComeBackAsAPopulation)
{
    const Surface surface = ground().surface();
    const Points points = to_points(settled(), kCommunity, surface, &ground().level_set, {});
    Population expected = settled();
    for (std::size_t i = 0; i < expected.size(); ++i)
        expected.seed_kind[i] = expected.seed_species[i] = 0, expected.seed_born[i] = 0,
        expected.seed_id[i] = 0;
    Population found = from_points(points, kCommunity, surface, 40);
    EXPECT_LE(found.next_id, expected.next_id);
    found.next_id = expected.next_id;
    found.arrivals = expected.arrivals;
    EXPECT_EQ(found, expected);

    // And through a file's points.
    const Points again = vdb::decode_points(vdb::encode_points("moss", points), "moss");
    EXPECT_EQ(from_points(again, kCommunity, surface, 40),
              from_points(points, kCommunity, surface, 40));
}

TEST(MossPoints, NameWhatIsWrongWithThem)
{
    const Surface surface = ground().surface();
    const Points good = to_points(settled(), kCommunity, surface, nullptr, {});
    auto refuses = [&](auto change, const char* expected) {
        Points points = good;
        change(points.attributes);
        EXPECT_THAT([&] { from_points(points, kCommunity, surface, 40); },
                    ThrowsMessage<InvalidInput>(HasSubstr(expected)));
    };
    using Ints = std::vector<std::int32_t>;
    refuses([](auto& a) { a.erase("growth"); }, "no attribute growth");
    refuses([](auto& a) { a["age"] = std::vector<float>(3); }, "age must be int32");
    refuses([](auto& a) { a["species"] = Ints(3); }, "species has 3 values");
    refuses([](auto& a) { std::get<Ints>(a["species"])[7] = 3; },
            "species of point 7 = 3, must be below 3");
    refuses([](auto& a) { std::get<Ints>(a["site"])[2] = -1; }, "site of point 2 = -1");
    refuses([](auto& a) { std::get<Ints>(a["site"])[2] = std::get<Ints>(a["site"])[1]; },
            "that of no other point");
    refuses([](auto& a) { std::get<Ints>(a["age"])[2] = 41; },
            "age of point 2 = 41, must be 0 to 40");
    refuses([](auto& a) { std::get<std::vector<float>>(a["growth"])[5] = NAN; },
            "growth of point 5 = nan");
}

TEST(MossPoints, GridsGetWhatStandsAndRests)
{
    const Population& p = settled();
    const std::vector<std::int32_t> species = moss_species(p), age = moss_age(p);
    const std::vector<std::int32_t> kinds = seed_kind(p), of = seed_species(p), ages = seed_age(p);
    bool moss_seen = false, seed_seen = false;
    for (std::size_t i = 0; i < p.size(); ++i) {
        ASSERT_EQ(species[i], p.species[i]);
        ASSERT_EQ(kinds[i], p.seed_kind[i]);
        ASSERT_EQ(of[i], p.seed_species[i]);
        ASSERT_EQ(age[i], p.species[i] ? 40 - p.born[i] : 0);
        ASSERT_EQ(ages[i], p.seed_kind[i] ? 40 - p.seed_born[i] : 0);
        moss_seen |= age[i] > 5;
        seed_seen |= ages[i] > 5;
    }
    EXPECT_TRUE(moss_seen && seed_seen);
}

TEST(MossPoints, AreTheSameOnAnyNumberOfThreads)
{
    auto on = [&](std::size_t threads) {
        const ThreadLimit limit(threads);
        return content_hash(
            to_points(settled(), kCommunity, ground().surface(), &ground().level_set, {}));
    };
    EXPECT_EQ(on(1), on(4));
}

}  // namespace
}  // namespace sekitei::moss
