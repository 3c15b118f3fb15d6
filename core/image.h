#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "core/vec.h"

namespace sekitei {

/// Rows from the top; `channels` is 1 (grey), 3 (RGB) or 4 (RGBA).
template <class T>
struct Image {
    int width = 0, height = 0, channels = 1;
    std::vector<T> pixels;

    Image() = default;
    Image(int w, int h, int c)
        : width(w), height(h), channels(c), pixels(std::size_t(w) * std::size_t(h) * std::size_t(c))
    {
    }
    T& at(int x, int y, int c = 0)
    {
        return pixels[(std::size_t(y) * std::size_t(width) + std::size_t(x)) *
                          std::size_t(channels) +
                      std::size_t(c)];
    }
    const T& at(int x, int y, int c = 0) const
    {
        return pixels[(std::size_t(y) * std::size_t(width) + std::size_t(x)) *
                          std::size_t(channels) +
                      std::size_t(c)];
    }
};

using Image8 = Image<std::uint8_t>;
using Image16 = Image<std::uint16_t>;

/// PNG bytes; no time stamp, so equal pictures are equal files.
std::string encode_png(const Image8& image);
std::string encode_png(const Image16& image);

/// Writes a PNG atomically.
void write_png(const std::filesystem::path& path, const Image8& image);
void write_png(const std::filesystem::path& path, const Image16& image);

/// Reads any PNG as 16-bit grey (colour by Rec. 709 luma, 8-bit scaled by 257, alpha ignored).
/// @throws InvalidInput  not a PNG, damaged, more than 2^28 pixels
Image16 read_png_grey16(const std::filesystem::path& path);
/// Reads any PNG as 8-bit RGB; alpha is ignored.
Image8 read_png_rgb8(const std::filesystem::path& path);

/// The same from bytes; `name` is used in messages.
Image16 decode_png_grey16(std::string_view bytes, const std::string& name);
Image8 decode_png_rgb8(std::string_view bytes, const std::string& name);

}  // namespace sekitei
