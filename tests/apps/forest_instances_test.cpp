#include "apps/forest_instances.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <sstream>

#include "core/error.h"
#include "core/file_output.h"
#include "core/random.h"
#include "tests/support/temporary_folder.h"

namespace sekitei::apps {
namespace {

using forest::Instance;
using ::testing::HasSubstr;
using ::testing::ThrowsMessage;

constexpr Vec3d kCorner{700000.5, 4000000.25, 120};

std::vector<Instance> trees(std::size_t count)
{
    std::vector<Instance> list(count);
    for (std::size_t i = 0; i < count; ++i) {
        Instance& t = list[i];
        t.uid = hash2(5, i);
        auto u = [&, k = std::uint64_t(0)]() mutable { return uniform_of_key(t.uid, k++); };
        t.position = kCorner + Vec3d(512 * u(), 300 * u(), 3 * u());
        t.yaw = 6.28 * u();
        t.scale = {1 + u(), 0, 2 + 18 * u()};
        t.scale.y = t.scale.x;
        t.height = t.scale.z;
        t.cone_radius = 0.5 * t.height;
        t.crown_radius = t.cone_radius * u();
        t.share = u();
        t.species = int(i % 6);
        t.variant = int(i % 3);
        t.age = int(i % 50);
        t.model = int(i % 2);
    }
    return list;
}

InstanceBlocks in_blocks(const std::vector<Instance>& list, std::size_t size = 7)
{
    return [&list, size](const std::function<void(std::span<const Instance>)>& take) {
        for (std::size_t i = 0; i < list.size(); i += size)
            take(std::span(list).subspan(i, std::min(size, list.size() - i)));
    };
}

std::vector<Prototype> prototypes()
{
    return {{.name = "table-1_0_12"}, {.name = "3 beech", .crown_radius = 0.4}};
}

std::string usda(const std::vector<Instance>& list)
{
    std::string text;
    write_usda(in_blocks(list), prototypes(), kCorner,
               [&](std::string_view piece) { text += piece; });
    return text;
}

/// The values of "name = [ ... ]", parentheses and commas left out.
std::vector<double> array(const std::string& text, const std::string& name)
{
    const std::size_t at = text.find(" " + name + " = [");
    EXPECT_NE(at, std::string::npos) << name;
    if (at == std::string::npos) return {};
    const std::size_t begin = text.find('[', text.find('=', at)) + 1;
    std::string part = text.substr(begin, text.find(']', begin) - begin);
    for (char& c : part)
        if (c == '(' || c == ')' || c == ',') c = ' ';
    std::istringstream in(part);
    std::vector<double> list;
    for (double v = 0; in >> v;) list.push_back(v);
    return list;
}

TEST(ForestInstances, ComeBackFromPoints)
{
    const std::vector<Instance> list = trees(40);
    const Points points = instance_points(list, "forest");
    const std::vector<Instance> again = instances_of(points, "forest_instances");
    ASSERT_EQ(again.size(), list.size());
    for (std::size_t i = 0; i < list.size(); ++i) {
        EXPECT_EQ(again[i].uid, list[i].uid);
        EXPECT_EQ(again[i].position, list[i].position);
        EXPECT_NEAR(again[i].yaw, list[i].yaw, 1e-6);
        EXPECT_FLOAT_EQ(float(again[i].scale.x), float(list[i].scale.x));
        EXPECT_FLOAT_EQ(float(again[i].crown_radius), float(list[i].crown_radius));
        EXPECT_FLOAT_EQ(float(again[i].share), float(list[i].share));
        EXPECT_EQ(again[i].model, list[i].model);
        EXPECT_EQ(again[i].age, list[i].age);
    }
    EXPECT_EQ((*points.values<float>("pscale"))[3], 1.0f);
    Points broken = points;
    broken.attributes.erase("scale");
    EXPECT_THAT(
        [&] { instances_of(broken, "forest_heroes"); },
        ThrowsMessage<InvalidInput>(HasSubstr("'forest_heroes' have no attribute 'scale'")));
}

TEST(ForestInstances, StandInPlyRowByRow)
{
    const std::vector<Instance> list = trees(10);
    std::string bytes = instance_ply_header(list.size());
    EXPECT_THAT(bytes, HasSubstr("element vertex 10\nproperty double x\n"));
    EXPECT_THAT(bytes, HasSubstr("property uint id_high\nproperty uint id_low\n"));
    const std::size_t first = bytes.size();
    append_ply(bytes, list);
    constexpr std::size_t kRow = 3 * 8 + 8 * 4 + 2 * 4 + 4 * 4 + 4 * 4;
    ASSERT_EQ(bytes.size(), first + 10 * kRow);
    auto at = [&]<class T>(std::size_t row, std::size_t place, T value) {
        std::memcpy(&value, bytes.data() + first + row * kRow + place, sizeof value);
        return value;
    };
    EXPECT_EQ(at(4, 8, 0.0), list[4].position.y);
    EXPECT_EQ(at(4, 24 + 4 * 6, 0.0f), float(list[4].scale.z));
    EXPECT_EQ((std::uint64_t(at(4, 56, 0u)) << 32) | at(4, 60, 0u), list[4].uid);
    EXPECT_EQ(at(4, kRow - 4, 0), list[4].model);
}

TEST(ForestInstances, StandInCsvUnderTheSameNames)
{
    const std::vector<Instance> list = trees(3);
    std::string text = instance_csv_header();
    EXPECT_EQ(text,
              "x,y,z,orient_x,orient_y,orient_z,orient_w,scale_x,scale_y,scale_z,pscale,id_high,"
              "id_low,height,crown_radius,cone_radius,R,species,variant,age,model\n");
    text.clear();
    append_csv(text, list);
    std::istringstream lines(text);
    for (const Instance& t : list) {
        std::string line;
        ASSERT_TRUE(std::getline(lines, line));
        std::istringstream cells(line);
        std::vector<double> values;
        for (std::string cell; std::getline(cells, cell, ',');) values.push_back(std::stod(cell));
        ASSERT_EQ(values.size(), 21u);
        EXPECT_EQ(Vec3d(values[0], values[1], values[2]), t.position);
        EXPECT_EQ((std::uint64_t(values[11]) << 32) + std::uint64_t(values[12]), t.uid);
        EXPECT_EQ(float(values[13]), float(t.height));
        EXPECT_EQ(values[20], t.model);
    }
}

TEST(ForestInstances, StandInUsdAsAPointInstancer)
{
    const std::vector<Instance> list = trees(20);
    const std::string text = usda(list);
    EXPECT_EQ(text.substr(0, 10), "#usda 1.0\n");
    EXPECT_THAT(text, HasSubstr("metersPerUnit = 1\n    upAxis = \"Z\"\n)"));
    EXPECT_THAT(text, HasSubstr("def PointInstancer \"forest\"\n{"));
    // Names that USD takes, and prims of these names.
    EXPECT_THAT(text, HasSubstr("rel prototypes = [</forest/prototypes/table_1_0_12>, "
                                "</forest/prototypes/_3_beech>]"));
    EXPECT_THAT(text, HasSubstr("def Xform \"table_1_0_12\""));
    EXPECT_THAT(text, HasSubstr("def Xform \"_3_beech\""));
    EXPECT_EQ(std::count(text.begin(), text.end(), '{'), std::count(text.begin(), text.end(), '}'));
    EXPECT_EQ(std::count(text.begin(), text.end(), '['), std::count(text.begin(), text.end(), ']'));
    EXPECT_EQ(std::count(text.begin(), text.end(), '('), std::count(text.begin(), text.end(), ')'));
    const auto positions = array(text, "positions"), turns = array(text, "orientations"),
               scales = array(text, "scales"), which = array(text, "protoIndices"),
               heights = array(text, "primvars:height");
    ASSERT_EQ(positions.size(), 60u);
    ASSERT_EQ(turns.size(), 80u);
    ASSERT_EQ(scales.size(), 60u);
    ASSERT_EQ(which.size(), 20u);
    ASSERT_EQ(heights.size(), 20u);
    for (std::size_t i = 0; i < 20; ++i) {
        for (int a = 0; a < 3; ++a)
            EXPECT_NEAR(positions[3 * i + std::size_t(a)] + kCorner[a], list[i].position[a], 1e-4);
        EXPECT_NEAR(turns[4 * i], std::cos(list[i].yaw / 2), 1e-4);  // the real part first
        EXPECT_NEAR(turns[4 * i + 3], std::sin(list[i].yaw / 2), 1e-4);
        EXPECT_EQ(turns[4 * i + 1], 0);
        EXPECT_EQ(which[i], list[i].model);
    }
    EXPECT_THAT(text, HasSubstr("double3 xformOp:translate = (700000.5, 4000000.25, 120)"));
}

TEST(ForestInstances, FillTheExtentThatUsdTells)
{
    const std::vector<Instance> list = trees(20);
    const auto box = array(usda(list), "extent");
    for (const Instance& t : list) {
        const Vec3d p = t.position - kCorner;
        EXPECT_LE(box[0], p.x - 0.3 * t.scale.x + 1e-3);
        EXPECT_GE(box[4], p.y + 0.3 * t.scale.y - 1e-3);
        EXPECT_GE(box[5], p.z + t.height - 1e-3);
    }
    EXPECT_LT(box[5], 3 + 20.1);
}

TEST(ForestInstances, FilesAreTheSameInAnyBlocks)
{
    const std::vector<Instance> list = trees(50);
    TemporaryFolder folder;
    for (const std::string suffix : {".ply", ".csv", ".usda"}) {
        const auto a = folder.path() / ("a" + suffix), b = folder.path() / ("b" + suffix);
        write_instances(a, 50, in_blocks(list, 50), prototypes(), kCorner);
        write_instances(b, 50, in_blocks(list, 3), prototypes(), kCorner);
        EXPECT_EQ(read_file(a), read_file(b));
        EXPECT_GT(read_file(a).size(), 2000u);
    }
    EXPECT_THROW(write_instances(folder.path() / "a.obj", 50, in_blocks(list), prototypes(), {}),
                 InvalidParameter);
    // What is announced must come, and nothing is left half-written.
    EXPECT_THROW(write_instances(folder.path() / "c.ply", 51, in_blocks(list), prototypes(), {}),
                 InvalidInput);
    EXPECT_FALSE(std::filesystem::exists(folder.path() / "c.ply"));
}

TEST(ForestInstances, MayBeNone)
{
    const std::string text = usda({});
    EXPECT_THAT(text, HasSubstr("int[] protoIndices = []\n"));
    EXPECT_THAT(text, HasSubstr("extent = [(0, 0, 0), (0, 0, 0)]"));
    EXPECT_THAT(instance_ply_header(0), HasSubstr("element vertex 0\n"));
    EXPECT_TRUE(instances_of(instance_points({}, "forest"), "x").empty());
}

TEST(ForestInstances, OfUnknownModelsAreRefused)
{
    std::vector<Instance> list = trees(4);
    list[2].model = 2;
    EXPECT_THAT([&] { usda(list); },
                ThrowsMessage<InvalidInput>(HasSubstr("has the model 2, there are 2")));
}

}  // namespace
}  // namespace sekitei::apps
