#include "core/json.h"

#include <gtest/gtest.h>

#include <string>

namespace sekitei {
namespace {

std::string nested(std::size_t levels)
{
    return std::string(levels, '[') + std::string(levels, ']');
}

TEST(Json, WhatIsNestedTooDeeplyIsNotTaken)
{
    EXPECT_NO_THROW(parse_json(nested(kDeepestJson)));
    EXPECT_THROW(parse_json(nested(kDeepestJson + 1)), Json::parse_error);
    EXPECT_THROW(parse_json(nested(3'000'000)), Json::parse_error);
    EXPECT_TRUE(parse_json(nested(3'000'000), false).is_discarded());
    EXPECT_THROW(parse_json("{\"a\":" + nested(kDeepestJson) + "}"), Json::parse_error);
}

TEST(Json, BracketsInTextAreText)
{
    const Json text = std::string(1000, '[') + "\"\\" + std::string(1000, '{');
    EXPECT_EQ(parse_json(text.dump()), text);
    EXPECT_EQ(parse_json("[[1],[2]]"), Json({{1}, {2}}));
    Json many = Json::array();
    for (int i = 0; i < 1000; ++i) many.push_back(Json::object());
    EXPECT_EQ(parse_json(many.dump()), many);
}

}  // namespace
}  // namespace sekitei
