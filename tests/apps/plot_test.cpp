#include "apps/render/plot.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include "core/error.h"

namespace sekitei::render {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;
using Colour = std::array<int, 3>;

constexpr Colour kFirst{0, 114, 178}, kSecond{213, 94, 0};

Colour at(const Image8& image, int x, int y)
{
    return {image.at(x, y, 0), image.at(x, y, 1), image.at(x, y, 2)};
}

/// Mean row of a colour in each column that has it, legend left out.
std::map<int, double> line_of(const Image8& image, Colour colour, int right)
{
    std::map<int, double> rows;
    for (int x = 0; x < right; ++x) {
        double sum = 0, count = 0;
        for (int y = 0; y < image.height; ++y)
            if (at(image, x, y) == colour) {
                sum += y;
                ++count;
            }
        if (count > 0) rows[x] = sum / count;
    }
    return rows;
}

TEST(Plot, AStraightSeriesIsAStraightLineFromCornerToCorner)
{
    Series s{"", {}, {}};
    for (int i = 0; i <= 30; ++i) {
        s.x.push_back(11 + 2 * i);
        s.y.push_back(50 * i);
    }
    const Image8 image = plot({s}, {.width = 840, .height = 300, .low = 0.0, .high = 1500.0});
    const auto line = line_of(image, kFirst, image.width);
    ASSERT_GT(line.size(), 400u);
    const auto [x0, y0] = *line.begin();
    const auto [x1, y1] = *line.rbegin();
    // The y axis is the column with the most ink; the line covers its ends.
    int top = 0, bottom = 0, most = 0;
    for (int x = 0; x < 200; ++x) {
        std::vector<int> rows;
        for (int y = 0; y < image.height; ++y)
            if (at(image, x, y) == Colour{40, 40, 40}) rows.push_back(y);
        if (static_cast<int>(rows.size()) <= most) continue;
        most = static_cast<int>(rows.size());
        top = rows.front();
        bottom = rows.back();
    }
    EXPECT_GT(bottom, top + 200);
    EXPECT_NEAR(y0, bottom, 3.5);
    EXPECT_NEAR(y1, top, 3.5);
    for (const auto& [x, y] : line) EXPECT_NEAR(y, y0 + (y1 - y0) * (x - x0) / (x1 - x0), 1.2) << x;
}

TEST(Plot, ValuesThatAreNotFiniteBreakTheLine)
{
    const Image8 image =
        plot({{"", {0, 1, 2, 3, 4, 5}, {1, 1, NAN, 1, 1, 1}}}, {.width = 800, .height = 200});
    const auto line = line_of(image, kFirst, image.width);
    int widest = 0, previous = line.begin()->first;
    for (const auto& [x, y] : line) {
        widest = std::max(widest, x - previous);
        previous = x;
    }
    const double whole = line.rbegin()->first - line.begin()->first;
    EXPECT_NEAR(widest / whole, 2.0 / 5, 0.02);
}

TEST(Plot, LinesStayInsideTheAxesTheyAreGiven)
{
    const Image8 image = plot({{"", {0, 1, 2}, {-1e9, 5, 1e9}}},
                              {.width = 500, .height = 240, .low = 0.0, .high = 10.0});
    const auto line = line_of(image, kFirst, image.width);
    ASSERT_FALSE(line.empty());
    for (const auto& [x, y] : line) {
        EXPECT_GT(y, 8);
        EXPECT_LT(y, 220);
    }
}

TEST(Plot, SeriesDifferInColourAndStandInTheLegend)
{
    const std::vector<double> x{0, 1};
    const Image8 image = plot({{"bryum", x, {0, 1}}, {"hypnum", x, {1, 0}}}, {});
    const Image8 bare = plot({{"", x, {0, 1}}, {"", x, {1, 0}}}, {});
    for (const Colour& colour : {kFirst, kSecond}) {
        int right = 0, bare_right = 0;
        for (int c = 0; c < image.width; ++c)
            for (int r = 0; r < image.height; ++r) {
                if (at(image, c, r) == colour) right = c;
                if (at(bare, c, r) == colour) bare_right = c;
            }
        EXPECT_LT(right, image.width - 60);  // its stroke in the legend, words after it
        EXPECT_GT(bare_right, image.width - 60);
    }
}

TEST(Plot, ManySamplesAndSingleOnesAreDrawn)
{
    Series noise{"noise", {}, {}};
    for (int i = 0; i < 20000; ++i) {
        noise.x.push_back(i);
        noise.y.push_back(i * 7919 % 1000);
    }
    EXPECT_GT(line_of(plot({noise}, {}), kFirst, 700).size(), 500u);
    EXPECT_FALSE(line_of(plot({{"one", {3}, {4}}}, {.title = "one point"}), kFirst, 700).empty());
}

TEST(Plot, WhatCannotBeDrawnIsNamed)
{
    EXPECT_THAT(
        [] {
            plot({{"a", {1, 2}, {1}}}, {});
        },
        ThrowsMessage<InvalidParameter>("plot: series a has 2 x and 1 y, must be as many"));
    EXPECT_THAT(
        [] {
            plot({{"a", {1}, {NAN}}}, {});
        },
        ThrowsMessage<InvalidInput>(HasSubstr("no finite point")));
    EXPECT_THAT([] { plot({}, {.width = 10}); },
                ThrowsMessage<InvalidParameter>(HasSubstr("size = 10 x 480, must be 200 x 120")));
    EXPECT_THAT(
        [] {
            plot({{"a", {1}, {1}}}, {.low = 2.0, .high = 2.0});
        },
        ThrowsMessage<InvalidParameter>("plot: low = 2, must be below high = 2"));
}

}  // namespace
}  // namespace sekitei::render
