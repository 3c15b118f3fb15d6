#include "core/params.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/error.h"

namespace sekitei {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

enum class Cut { Perpendicular, Horizontal, None };
constexpr std::array<std::string_view, 3> choice_names(Cut)
{
    return {"perpendicular", "horizontal", "none"};
}

struct Sample {
    double spacing = 0.45;
    double share = 0.5;
    int steps = 6;
    std::int8_t tiny = 1;
    std::uint64_t seed = 7;
    bool closed = true;
    Cut cut = Cut::None;
    std::string title = "cliff";
    std::filesystem::path file = "a/b.vdb";
    Vec3d size{1, 2, 3};
    std::vector<double> levels{1, 2.5};
    std::optional<double> voxel;
    std::optional<Cut> joint_cut;
    std::optional<bool> lit;

    static void describe(auto&& field)
    {
        field("spacing", &Sample::spacing, "m", kPositive, "between centres");
        field("share", &Sample::share, "", kFraction, "of all");
        field("steps", &Sample::steps, "", between(0, 100), "to take");
        field("tiny", &Sample::tiny, "", kAny, "a byte");
        field("seed", &Sample::seed, "", kAny, "of everything");
        field("closed", &Sample::closed, "whether it is");
        field("cut", &Sample::cut, "how columns break");
        field("title", &Sample::title, "of the whole");
        field("file", &Sample::file, "to read");
        field("size", &Sample::size, "m", kPositive, "of the box");
        field("levels", &Sample::levels, "m", kNotNegative, "to cut at");
        field("voxel", &Sample::voxel, "m", kPositive, "edge");
        field("joint_cut", &Sample::joint_cut, "how joints break");
        field("lit", &Sample::lit, "whether it is lit");
    }
};

struct ParamsTest : testing::Test {
    Sample sample;
    ParamList list = describe_params(sample);

    const Param& at(std::string_view name) const
    {
        const Param* param = find_param(list, name);
        if (!param) throw std::logic_error(std::string(name));
        return *param;
    }
    void expect_refused(std::string_view name, const Json& value, const std::string& message) const
    {
        EXPECT_THAT([&] { at(name).set(value); },
                    ThrowsMessage<InvalidParameter>(HasSubstr(message)))
            << value;
    }
};

TEST_F(ParamsTest, EveryKindTakesAWordOfTheCommandLine)
{
    const std::pair<const char*, const char*> words[] = {{"spacing", "30cm"},
                                                         {"share", "25%"},
                                                         {"steps", "12"},
                                                         {"seed", "18446744073709551615"},
                                                         {"closed", "no"},
                                                         {"cut", "horizontal"},
                                                         {"title", "auto"},
                                                         {"file", "c d.ply"},
                                                         {"size", "12m,10m,600cm"},
                                                         {"levels", "1,2,50cm"},
                                                         {"voxel", "4cm"},
                                                         {"joint-cut", "none"},
                                                         {"lit", "on"}};
    for (const auto& [name, word] : words) at(name).set_text(word);
    EXPECT_DOUBLE_EQ(sample.spacing, 0.3);
    EXPECT_DOUBLE_EQ(sample.share, 0.25);
    EXPECT_EQ(sample.steps, 12);
    EXPECT_EQ(sample.seed, 18446744073709551615u);
    EXPECT_FALSE(sample.closed);
    EXPECT_EQ(sample.cut, Cut::Horizontal);
    EXPECT_EQ(sample.title, "auto");
    EXPECT_EQ(sample.file, "c d.ply");
    EXPECT_EQ(sample.size, Vec3d(12, 10, 6));
    EXPECT_EQ(sample.levels, (std::vector<double>{1, 2, 0.5}));
    EXPECT_EQ(sample.voxel, 0.04);
    EXPECT_EQ(sample.joint_cut, Cut::None);
    EXPECT_EQ(sample.lit, true);
    for (const char* name : {"voxel", "joint_cut", "lit"}) at(name).set_text("auto");
    EXPECT_FALSE(sample.voxel || sample.joint_cut || sample.lit);
}

TEST_F(ParamsTest, CountsWithoutUnitTakeThousandsAndMillions)
{
    at("steps").set_text("0.05k");
    EXPECT_EQ(sample.steps, 50);
    at("seed").set(Json("20k"));
    EXPECT_EQ(sample.seed, 20'000u);
    at("seed").set_text("2.3M");
    EXPECT_EQ(sample.seed, 2'300'000u);
    expect_refused("steps", "1k", "steps = 1000, must be 0 to 100");
    expect_refused("steps", "0.0001k", "steps = 0.0001k");
    expect_refused("tiny", "1k", "tiny = 1k");
    expect_refused("share", "1k", "unit 'k'");  // no count
    expect_refused("spacing", "1k", "unit 'k'");
}

TEST_F(ParamsTest, JsonBringsEveryValueBack)
{
    at("voxel").set(0.1);
    at("seed").set(Json(18446744073709551615u));
    at("size").set(Json::array({0.1, "20cm", 1}));
    const Json json = Json::parse(params_json(list).dump());
    Sample other;
    const ParamList others = describe_params(other);
    for (const auto& [name, value] : json.items()) find_param(others, name)->set(value);
    EXPECT_EQ(params_json(others), params_json(list));
    EXPECT_EQ(other.seed, sample.seed);
    EXPECT_EQ(other.size, Vec3d(0.1, 0.2, 1));
    EXPECT_TRUE(json["lit"].is_null());
}

TEST_F(ParamsTest, ShownValuesReadBack)
{
    at("voxel").set(1.0 / 3);
    for (const Param& p : list) {
        const Json before = p.get();
        p.set_text(p.value_text());
        EXPECT_EQ(p.get(), before) << p.name << " " << p.value_text();
    }
    at("levels").set_text("");
    EXPECT_TRUE(sample.levels.empty());
    EXPECT_EQ(at("levels").value_text(), "none");
    at("levels").set_text("none");
    EXPECT_TRUE(sample.levels.empty());
    EXPECT_EQ(at("spacing").value_text(), "0.45 m");
    EXPECT_EQ(at("lit").value_text(), "auto");
}

TEST_F(ParamsTest, ValuesOutOfRangeAreNamed)
{
    expect_refused("spacing", 0, "spacing = 0 m, must be > 0");
    expect_refused("spacing", "-3cm", "spacing = -0.03 m, must be > 0");
    expect_refused("spacing", NAN, "must be > 0");
    expect_refused("share", 1.5, "share = 1.5, must be 0 to 1");
    expect_refused("steps", 101, "steps = 101, must be 0 to 100");
    expect_refused("size", Json::array({1, 0, 1}), "size = 0 m, must be > 0");
    expect_refused("levels", Json::array({1, -1}), "levels = -1 m, must be >= 0");
    EXPECT_NO_THROW(at("share").set(1));
    EXPECT_NO_THROW(at("share").set(0));
    EXPECT_EQ(sample.spacing, 0.45);  // refused values leave the member alone
}

TEST_F(ParamsTest, IntegersMustFitTheirMember)
{
    expect_refused("tiny", 128, "tiny = 128, must be an integer from -128 to 127");
    expect_refused("tiny", "-129", "must be an integer from -128 to 127");
    expect_refused("seed", -1, "seed = -1, must be an integer from 0 to");
    expect_refused("tiny", Json(18446744073709551615u), "tiny = 18446744073709551615, must be");
    expect_refused("steps", 2.5, "steps = 2.5, must be integer");
    expect_refused("steps", "1e30", "must be 0 to 100");
    expect_refused("tiny", "1e30", "an integer below 9e15");
    at("seed").set_text("9007199254740993");  // 2^53 + 1, which no double holds
    EXPECT_EQ(sample.seed, 9007199254740993u);
    at("tiny").set(-128);
    EXPECT_EQ(sample.tiny, -128);
    at("steps").set(3.0);
    EXPECT_EQ(sample.steps, 3);
}

TEST_F(ParamsTest, ValuesOfAnotherKindAreNamed)
{
    expect_refused("spacing", "2s", "spacing: '2s' has the unit 's', expected one of: um mm cm");
    expect_refused("spacing", true, "spacing = true, must be number [m], > 0");
    expect_refused("spacing", nullptr, "spacing = null");
    expect_refused("closed", "maybe", "closed = maybe, must be true or false");
    expect_refused("title", 3, "title = 3, must be text");
    expect_refused("size", Json::array({1, 2}), "size = [1,2], must be three numbers x,y,z");
    expect_refused("size", "1,2,3,4", "must be three numbers x,y,z");
    expect_refused("size", "5", "must be three numbers x,y,z");
    EXPECT_THAT([&] { at("size").set_text("1,2,"); },
                ThrowsMessage<InvalidParameter>(HasSubstr("'' is not a number")));
    EXPECT_THAT([&] { at("levels").set_text("1,,2"); },
                ThrowsMessage<InvalidParameter>(HasSubstr("'' is not a number")));
    expect_refused("steps", Json::array({"\xff\xfe"}), "steps = [");  // text that is no UTF-8
    expect_refused("title", Json::array({std::string(100, 'x')}), "xxx..., must be text");
}

TEST_F(ParamsTest, MisspeltChoicesFindTheirNeighbour)
{
    expect_refused("cut", "horizontl",
                   "cut = horizontl, must be one of: perpendicular, horizontal, none (did you mean "
                   "'horizontal'?)");
    expect_refused("cut", 1, "must be one of: perpendicular, horizontal, none");
    EXPECT_EQ(nearest_name("spcing", {"steps", "spacing", "share"}), "spacing");
    EXPECT_EQ(nearest_name("colour", {"steps", "spacing"}), "");
    EXPECT_EQ(nearest_name(std::string(1'000'000, 'x'), {"steps", "spacing"}), "");
    EXPECT_EQ(nearest_name("", {"steps"}), "");
}

TEST_F(ParamsTest, NamesHaveTwoSpellings)
{
    EXPECT_EQ(option_name("joint_cut"), "joint-cut");
    EXPECT_EQ(find_param(list, "joint-cut"), find_param(list, "joint_cut"));
    EXPECT_EQ(find_param(list, "joint"), nullptr);
}

TEST_F(ParamsTest, TypesAreDescribedInWords)
{
    EXPECT_EQ(at("spacing").type_text(), "number [m], > 0");
    EXPECT_EQ(at("voxel").type_text(), "number [m], > 0, or auto");
    EXPECT_EQ(at("steps").type_text(), "integer, 0 to 100");
    EXPECT_EQ(at("cut").type_text(), "perpendicular | horizontal | none");
    EXPECT_EQ(at("size").type_text(), "x,y,z [m], > 0");
    EXPECT_EQ(at("lit").type_text(), "true or false, or auto");
}

TEST_F(ParamsTest, ValidationNamesTheSolverAndTheFirstBadField)
{
    EXPECT_NO_THROW(validate_described("joints", sample));
    auto refused = [](const Sample& s, const std::string& message) {
        EXPECT_THAT([&] { validate_described("joints", s); },
                    ThrowsMessage<InvalidParameter>(HasSubstr(message)));
    };
    refused({.spacing = -1}, "joints: spacing = -1 m, must be > 0");
    refused({.spacing = NAN}, "joints: spacing = nan, must be > 0");
    refused({.steps = -1}, "joints: steps = -1, must be 0 to 100");
    refused({.size = {1, INFINITY, 1}}, "joints: size = inf m, must be > 0");
    refused({.levels = {NAN}}, "joints: levels = nan m, must be >= 0");
    refused({.voxel = NAN}, "joints: voxel = nan, must be > 0");
    Sample large;
    large.seed = 18446744073709551615u;
    EXPECT_NO_THROW(validate_described("joints", large));
}

TEST_F(ParamsTest, TheSchemaTellsTypesRangesAndUnits)
{
    const Json schema = params_schema(list);
    EXPECT_EQ(schema["spacing"]["exclusiveMinimum"], 0);
    EXPECT_EQ(schema["spacing"]["unit"], "m");
    EXPECT_EQ(schema["share"]["maximum"], 1);
    EXPECT_EQ(schema["cut"]["enum"], Json({"perpendicular", "horizontal", "none"}));
    EXPECT_EQ(schema["joint_cut"]["enum"], Json({"perpendicular", "horizontal", "none", "auto"}));
    EXPECT_EQ(schema["voxel"]["type"], Json({"number", "string", "null"}));
    EXPECT_EQ(schema["lit"]["type"], Json({"boolean", "string", "null"}));
    EXPECT_EQ(schema["size"]["minItems"], 3);
    EXPECT_EQ(schema["title"]["default"], "cliff");
}

TEST(Range, TextAndBoundsAgree)
{
    EXPECT_EQ(kAny.text(), "a finite number");
    EXPECT_EQ(kPositive.text(), "> 0");
    EXPECT_EQ(between(-2, 5).text(), "-2 to 5");
    const Range half{.lower = 0, .upper = 1, .without_upper = true};
    EXPECT_EQ(half.text(), ">= 0 and < 1");
    EXPECT_TRUE(half.contains(0));
    EXPECT_FALSE(half.contains(1));
    EXPECT_FALSE(kAny.contains(NAN));
    EXPECT_FALSE(kAny.contains(INFINITY));
    EXPECT_TRUE(kAny.contains(-1e300));
}

}  // namespace
}  // namespace sekitei
