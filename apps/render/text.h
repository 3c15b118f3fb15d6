#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "core/image.h"
#include "core/vec.h"

/// Words and colour bars in pictures.
namespace sekitei::render {

using Rgb = Vec3<std::uint8_t>;

inline constexpr int kGlyphWidth = 6, kGlyphHeight = 10;  ///< with spacing, at scale 1

/// Pixels the text is wide.
int text_width(std::string_view text, int scale);

/// Draws ASCII text (and the UTF-8 signs for degree and powers 2, 3), upper left corner of a
/// capital at (x, y), clipped to the picture. Descenders reach two rows below the base line y + 7
/// scale.
void draw_text(Image8& image, int x, int y, std::string_view text, int scale, Rgb colour);

/// Numbers that divide [low, high] evenly in steps of 1, 2 or 5 times a power of ten, about
/// `count` of them, and how to print them.
struct Ticks {
    std::vector<double> values;
    int digits = 0;  ///< after the point; -1: scientific
};
Ticks ticks(double low, double high, int count);
std::string tick_text(double value, const Ticks& of);

/// A vertical bar of colour_of_value() from `low` at its foot to `high` with numbers at its right;
/// `title` above.
void draw_colour_bar(Image8& image, int x, int y, int height, double low, double high,
                     std::string_view title, int scale, Rgb ink);
int colour_bar_width(double low, double high, std::string_view title, int scale);

/// A list of ids with their colours, as many as the height allows.
void draw_id_legend(Image8& image, int x, int y, int height, const std::vector<std::int32_t>& ids,
                    std::string_view title, int scale, Rgb ink);

}  // namespace sekitei::render
