#include "apps/render/text.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "apps/render/colour.h"

namespace sekitei::render {
namespace {

/// Seven rows of five dots above the base line, the left one in bit 4, and two below it.
struct Glyph {
    std::array<std::uint8_t, 7> body{};
    std::array<std::uint8_t, 2> descender{};
};
constexpr int kBody = 7, kRows = 9;

constexpr std::uint8_t row_of(const Glyph& glyph, int row)
{
    return row < kBody ? glyph.body[static_cast<std::size_t>(row)]
                       : glyph.descender[static_cast<std::size_t>(row - kBody)];
}

// ASCII 32 to 126, then degree, superscript 2 and 3, and the box for anything else.
constexpr std::array<Glyph, 99> kFont{{
    {{0, 0, 0, 0, 0, 0, 0}},                 // space
    {{4, 4, 4, 4, 4, 0, 4}},                 // !
    {{10, 10, 0, 0, 0, 0, 0}},               // "
    {{10, 10, 31, 10, 31, 10, 10}},          // #
    {{4, 15, 20, 14, 5, 30, 4}},             // $
    {{24, 25, 2, 4, 8, 19, 3}},              // %
    {{12, 18, 20, 8, 21, 18, 13}},           // &
    {{4, 4, 0, 0, 0, 0, 0}},                 // '
    {{2, 4, 8, 8, 8, 4, 2}},                 // (
    {{8, 4, 2, 2, 2, 4, 8}},                 // )
    {{0, 4, 21, 14, 21, 4, 0}},              // *
    {{0, 4, 4, 31, 4, 4, 0}},                // +
    {{0, 0, 0, 0, 12, 4, 8}},                // ,
    {{0, 0, 0, 31, 0, 0, 0}},                // -
    {{0, 0, 0, 0, 0, 12, 12}},               // .
    {{0, 1, 2, 4, 8, 16, 0}},                // /
    {{14, 17, 19, 21, 25, 17, 14}},          // 0
    {{4, 12, 4, 4, 4, 4, 14}},               // 1
    {{14, 17, 1, 6, 8, 16, 31}},             // 2
    {{31, 2, 4, 2, 1, 17, 14}},              // 3
    {{2, 6, 10, 18, 31, 2, 2}},              // 4
    {{31, 16, 30, 1, 1, 17, 14}},            // 5
    {{6, 8, 16, 30, 17, 17, 14}},            // 6
    {{31, 1, 2, 4, 8, 8, 8}},                // 7
    {{14, 17, 17, 14, 17, 17, 14}},          // 8
    {{14, 17, 17, 15, 1, 2, 12}},            // 9
    {{0, 12, 12, 0, 12, 12, 0}},             // :
    {{0, 12, 12, 0, 12, 4, 8}},              // ;
    {{2, 4, 8, 16, 8, 4, 2}},                // <
    {{0, 0, 31, 0, 31, 0, 0}},               // =
    {{8, 4, 2, 1, 2, 4, 8}},                 // >
    {{14, 17, 1, 2, 4, 0, 4}},               // ?
    {{14, 17, 23, 21, 23, 16, 14}},          // @
    {{4, 10, 17, 17, 31, 17, 17}},           // A
    {{30, 17, 17, 30, 17, 17, 30}},          // B
    {{14, 17, 16, 16, 16, 17, 14}},          // C
    {{28, 18, 17, 17, 17, 18, 28}},          // D
    {{31, 16, 16, 30, 16, 16, 31}},          // E
    {{31, 16, 16, 30, 16, 16, 16}},          // F
    {{14, 17, 16, 23, 17, 17, 15}},          // G
    {{17, 17, 17, 31, 17, 17, 17}},          // H
    {{14, 4, 4, 4, 4, 4, 14}},               // I
    {{7, 2, 2, 2, 2, 18, 12}},               // J
    {{17, 18, 20, 24, 20, 18, 17}},          // K
    {{16, 16, 16, 16, 16, 16, 31}},          // L
    {{17, 27, 21, 21, 17, 17, 17}},          // M
    {{17, 25, 21, 19, 17, 17, 17}},          // N
    {{14, 17, 17, 17, 17, 17, 14}},          // O
    {{30, 17, 17, 30, 16, 16, 16}},          // P
    {{14, 17, 17, 17, 21, 18, 13}},          // Q
    {{30, 17, 17, 30, 20, 18, 17}},          // R
    {{15, 16, 16, 14, 1, 1, 30}},            // S
    {{31, 4, 4, 4, 4, 4, 4}},                // T
    {{17, 17, 17, 17, 17, 17, 14}},          // U
    {{17, 17, 17, 17, 17, 10, 4}},           // V
    {{17, 17, 17, 21, 21, 27, 17}},          // W
    {{17, 17, 10, 4, 10, 17, 17}},           // X
    {{17, 17, 10, 4, 4, 4, 4}},              // Y
    {{31, 1, 2, 4, 8, 16, 31}},              // Z
    {{14, 8, 8, 8, 8, 8, 14}},               // [
    {{0, 16, 8, 4, 2, 1, 0}},                // backslash
    {{14, 2, 2, 2, 2, 2, 14}},               // ]
    {{4, 10, 17, 0, 0, 0, 0}},               // ^
    {{0, 0, 0, 0, 0, 0, 31}},                // _
    {{8, 4, 0, 0, 0, 0, 0}},                 // `
    {{0, 0, 14, 1, 15, 17, 15}},             // a
    {{16, 16, 30, 17, 17, 17, 30}},          // b
    {{0, 0, 14, 16, 16, 17, 14}},            // c
    {{1, 1, 15, 17, 17, 17, 15}},            // d
    {{0, 0, 14, 17, 31, 16, 14}},            // e
    {{6, 9, 8, 28, 8, 8, 8}},                // f
    {{0, 0, 15, 17, 17, 17, 15}, {1, 14}},   // g
    {{16, 16, 30, 17, 17, 17, 17}},          // h
    {{4, 0, 12, 4, 4, 4, 14}},               // i
    {{2, 0, 6, 2, 2, 2, 2}, {18, 12}},       // j
    {{16, 16, 18, 20, 24, 20, 18}},          // k
    {{12, 4, 4, 4, 4, 4, 14}},               // l
    {{0, 0, 26, 21, 21, 21, 21}},            // m
    {{0, 0, 30, 17, 17, 17, 17}},            // n
    {{0, 0, 14, 17, 17, 17, 14}},            // o
    {{0, 0, 30, 17, 17, 17, 30}, {16, 16}},  // p
    {{0, 0, 15, 17, 17, 17, 15}, {1, 1}},    // q
    {{0, 0, 22, 25, 16, 16, 16}},            // r
    {{0, 0, 15, 16, 14, 1, 30}},             // s
    {{8, 8, 28, 8, 8, 9, 6}},                // t
    {{0, 0, 17, 17, 17, 19, 13}},            // u
    {{0, 0, 17, 17, 17, 10, 4}},             // v
    {{0, 0, 17, 17, 21, 21, 10}},            // w
    {{0, 0, 17, 10, 4, 10, 17}},             // x
    {{0, 0, 17, 17, 17, 17, 15}, {1, 14}},   // y
    {{0, 0, 31, 2, 4, 8, 31}},               // z
    {{2, 4, 4, 8, 4, 4, 2}},                 // {
    {{4, 4, 4, 4, 4, 4, 4}},                 // |
    {{8, 4, 4, 2, 4, 4, 8}},                 // }
    {{0, 0, 8, 21, 2, 0, 0}},                // ~
    {{12, 18, 18, 12, 0, 0, 0}},             // degree
    {{12, 2, 4, 8, 14, 0, 0}},               // superscript 2
    {{12, 2, 4, 2, 12, 0, 0}},               // superscript 3
    {{31, 17, 17, 17, 17, 17, 31}},          // anything else
}};

/// Glyph numbers of a UTF-8 text.
std::vector<std::size_t> glyphs(std::string_view text)
{
    std::vector<std::size_t> found;
    for (std::size_t i = 0; i < text.size(); ++i) {
        const auto c = static_cast<unsigned char>(text[i]);
        if (c >= 32 && c < 127) {
            found.push_back(c - 32u);
        } else if (c >= 0xC0) {  // the lead byte stands for the whole sign
            std::size_t glyph = 98;
            if (c == 0xC2 && i + 1 < text.size()) {
                const auto d = static_cast<unsigned char>(text[i + 1]);
                glyph = d == 0xB0 ? 95 : d == 0xB2 ? 96 : d == 0xB3 ? 97 : 98;
            }
            found.push_back(glyph);
        } else if (c < 32 || c == 127) {
            found.push_back(98);
        }
    }
    return found;
}

void set_pixel(Image8& image, int x, int y, Rgb colour)
{
    if (x < 0 || y < 0 || x >= image.width || y >= image.height) return;
    image.at(x, y, 0) = colour.x;
    image.at(x, y, 1) = colour.y;
    image.at(x, y, 2) = colour.z;
}

Rgb bytes(Vec3f colour)
{
    return {srgb_byte(static_cast<double>(colour.x)), srgb_byte(static_cast<double>(colour.y)),
            srgb_byte(static_cast<double>(colour.z))};
}

constexpr int kBarWidth = 12;  // at scale 1

}  // namespace

int text_width(std::string_view text, int scale)
{
    const auto count = static_cast<int>(glyphs(text).size());
    return count == 0 ? 0 : (count * kGlyphWidth - 1) * scale;
}

void draw_text(Image8& image, int x, int y, std::string_view text, int scale, Rgb colour)
{
    for (const std::size_t glyph : glyphs(text)) {
        for (int row = 0; row < kRows * scale; ++row)
            for (int column = 0; column < 5 * scale; ++column)
                if (row_of(kFont[glyph], row / scale) >> (4 - column / scale) & 1)
                    set_pixel(image, x + column, y + row, colour);
        x += kGlyphWidth * scale;
    }
}

Ticks ticks(double low, double high, int count)
{
    Ticks t;
    if (!(high > low)) {
        t.values = {low};
        t.digits = low == std::floor(low) && std::abs(low) < 1e6 ? 0 : -1;
        return t;
    }
    const double rough = (high - low) / std::max(1, count);
    // The power of ten at or below it, by multiplication: no log of the C library.
    double power = 1;
    int exponent = 0;
    while (power > rough && exponent > -300) {
        power /= 10;
        --exponent;
    }
    while (power * 10 <= rough && exponent < 300) {
        power *= 10;
        ++exponent;
    }
    // Between steps the geometric mean decides.
    const double share = rough / power;
    const double step = power * (share < 1.41 ? 1 : share < 3.16 ? 2 : share < 7.07 ? 5 : 10);
    if (share >= 7.07) ++exponent;
    for (double k = std::ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; ++k)
        t.values.push_back(k * step == 0 ? 0.0 : k * step);
    const double most = std::max(std::abs(low), std::abs(high));
    t.digits = most >= 1e6 || exponent < -5 ? -1 : std::max(0, -exponent);
    return t;
}

std::string tick_text(double value, const Ticks& of)
{
    return of.digits < 0 ? fmt::format("{:.3g}", value) : fmt::format("{:.{}f}", value, of.digits);
}

int colour_bar_width(double low, double high, std::string_view title, int scale)
{
    const Ticks t = ticks(low, high, 6);
    int widest = 0;
    for (const double v : t.values) widest = std::max(widest, text_width(tick_text(v, t), scale));
    return std::max((kBarWidth + 5) * scale + widest, text_width(title, scale));
}

void draw_colour_bar(Image8& image, int x, int y, int height, double low, double high,
                     std::string_view title, int scale, Rgb ink)
{
    draw_text(image, x, y, title, scale, ink);
    const int top = y + 12 * scale, bar = std::max(2, height - 12 * scale);
    for (int j = 0; j < bar; ++j) {
        const Rgb colour = bytes(colour_of_value(1 - double(j) / (bar - 1)));
        for (int i = 0; i < kBarWidth * scale; ++i) set_pixel(image, x + i, top + j, colour);
    }
    for (int j = 0; j < bar; ++j) {
        set_pixel(image, x - 1, top + j, ink);
        set_pixel(image, x + kBarWidth * scale, top + j, ink);
    }
    for (int i = -1; i <= kBarWidth * scale; ++i) {
        set_pixel(image, x + i, top - 1, ink);
        set_pixel(image, x + i, top + bar, ink);
    }
    const Ticks t = ticks(low, high, 6);
    for (const double v : t.values) {
        const double share = high > low ? (v - low) / (high - low) : 0.5;
        const int j = top + bar - 1 - static_cast<int>(std::lround(share * (bar - 1)));
        for (int i = 0; i < 3 * scale; ++i) set_pixel(image, x + kBarWidth * scale + i, j, ink);
        draw_text(image, x + (kBarWidth + 5) * scale, j - 3 * scale, tick_text(v, t), scale, ink);
    }
}

void draw_id_legend(Image8& image, int x, int y, int height, const std::vector<std::int32_t>& ids,
                    std::string_view title, int scale, Rgb ink)
{
    draw_text(image, x, y, title, scale, ink);
    const int line = 11 * scale;
    const auto room = static_cast<std::size_t>(std::max(1, (height - 12 * scale) / line));
    for (std::size_t i = 0; i < std::min(room, ids.size()); ++i) {
        const int top = y + 12 * scale + static_cast<int>(i) * line;
        if (i + 1 == room && ids.size() > room) {
            draw_text(image, x, top, fmt::format("+{} more", ids.size() - i), scale, ink);
            return;
        }
        const Rgb colour = bytes(colour_of_id(ids[i]));
        for (int b = 0; b < 8 * scale; ++b)
            for (int a = 0; a < kBarWidth * scale; ++a) set_pixel(image, x + a, top + b, colour);
        draw_text(image, x + (kBarWidth + 5) * scale, top, fmt::format("{}", ids[i]), scale, ink);
    }
}

}  // namespace sekitei::render
