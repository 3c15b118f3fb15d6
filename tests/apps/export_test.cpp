// Points to instance: what a million plants cost.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <cstring>

#include "apps/stage.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/hash.h"
#include "core/parallel.h"
#include "core/random.h"
#include "tests/support/temporary_folder.h"

namespace sekitei::apps {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

/// Plants with every attribute that moss on meshes has.
Points plants(std::size_t count)
{
    constexpr Stream kAny{"test.plants"};
    Points points;
    points.position.resize(count);
    std::vector<Vec3f> normal(count, Vec3f(0, 0.6f, 0.8f));
    std::vector<std::array<float, 4>> orient(count);
    std::map<std::string, std::vector<float>> floats;
    for (const char* name : {"pscale", "growth", "growth_max", "S", "suit", "wetness"})
        floats[name].resize(count);
    std::map<std::string, std::vector<std::int32_t>> integers;
    for (const char* name : {"species", "age", "interior"}) integers[name].resize(count);
    std::vector<std::int64_t> id(count), host(count);
    parallel_for(
        count,
        [&](std::size_t i) {
            std::uint64_t k = 0;
            auto u = [&] { return uniform01(1, kAny, i, k++); };
            points.position[i] = {u(), u(), u()};
            for (float& q : orient[i]) q = static_cast<float>(u() - 0.5);
            for (auto& [name, values] : floats) values[i] = static_cast<float>(u());
            for (auto& [name, values] : integers) values[i] = static_cast<std::int32_t>(u() * 1000);
            id[i] = static_cast<std::int64_t>(i * i);
            host[i] = static_cast<std::int64_t>(i) - 1;
        },
        4096);
    points.attributes = {{"N", normal}, {"orient", orient}, {"id", id}, {"host", host}};
    for (auto& [name, values] : floats) points.attributes[name] = values;
    for (auto& [name, values] : integers) points.attributes[name] = values;
    return points;
}

std::string exported(Scene& scene)
{
    const auto stage = make_stage("export");
    StageContext context;
    stage->run(scene, context);
    return std::move(stage->table);
}

TEST(Export, AMillionInstancesAreWrittenInSecondsAndBelow200Megabytes)
{
    Scene scene;
    scene.points["moss"] = plants(1000000);
    const TemporaryFolder folder;
    const auto start = std::chrono::steady_clock::now();
    write_file(folder / "moss.ply", exported(scene));
    const double seconds =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    RecordProperty("seconds", std::to_string(seconds));
    EXPECT_LT(seconds, 10);
    EXPECT_LT(std::filesystem::file_size(folder / "moss.ply"), 200e6);
}

TEST(Export, GivesTheSameBytesOnAnyNumberOfThreadsAndEachValueItsPlace)
{
    Scene scene;
    scene.points["moss"] = plants(40000);
    auto on = [&](std::size_t threads) {
        const ThreadLimit limit(threads);
        return exported(scene);
    };
    const std::string bytes = on(1);
    EXPECT_EQ(bytes, on(4));
    // Attributes in the order of their names: N, S, age ... wetness, each row 108 bytes.
    const std::size_t first = bytes.find("end_header\n") + 11,
                      row = 24 + 12 + 16 + 6 * 4 + 3 * 4 + 16;
    ASSERT_EQ(bytes.size(), first + 40000 * row);
    const Points& points = scene.points["moss"];
    for (const std::size_t i : {0, 1, 16384, 39999}) {
        const char* at = bytes.data() + first + i * row;
        double y = 0;
        float s = 0, wetness = 0;
        std::memcpy(&y, at + 8, 8);
        std::memcpy(&s, at + 24 + 12, 4);
        std::memcpy(&wetness, at + row - 4, 4);
        EXPECT_EQ(y, points.position[i].y);
        EXPECT_EQ(s, (*points.values<float>("S"))[i]);
        EXPECT_EQ(wetness, (*points.values<float>("wetness"))[i]);
    }
}

TEST(Export, NamesAnAttributeWithoutAValueForEachPoint)
{
    Scene scene;
    scene.points["moss"] = plants(3);
    scene.points["moss"].attributes["S"] = std::vector<float>{1, 2};
    EXPECT_THAT([&] { exported(scene); },
                ThrowsMessage<InvalidInput>("export: attribute S has 2 values, must have 3"));
    scene.points["moss"] = plants(0);
    EXPECT_THAT(exported(scene), HasSubstr("element vertex 0\n"));
}

}  // namespace
}  // namespace sekitei::apps
