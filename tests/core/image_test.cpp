#include "core/image.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <png.h>

#include "core/error.h"
#include "core/random.h"
#include "tests/support/temporary_folder.h"

namespace sekitei {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

constexpr Stream kPixels{"test.pixels"};
constexpr int kWidth = 37, kHeight = 23;

template <class T>
Image<T> noise_image(int channels)
{
    Image<T> image(kWidth, kHeight, channels);
    for (std::size_t i = 0; i < image.pixels.size(); ++i)
        image.pixels[i] = static_cast<T>(hash2(kPixels.id, i));
    return image;
}

/// The same grey picture stored in Adam7 order, which our writer never makes.
std::string interlaced_png(const Image16& image)
{
    std::string bytes;
    png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, nullptr, nullptr);
    png_infop info = png_create_info_struct(png);
    png_set_write_fn(
        png, &bytes,
        [](png_structp p, png_bytep data, png_size_t n) {
            static_cast<std::string*>(png_get_io_ptr(p))
                ->append(reinterpret_cast<const char*>(data), n);
        },
        nullptr);
    png_set_IHDR(png, info, png_uint_32(image.width), png_uint_32(image.height), 16,
                 PNG_COLOR_TYPE_GRAY, PNG_INTERLACE_ADAM7, 0, 0);
    std::vector<png_byte> big;
    for (const std::uint16_t v : image.pixels) {
        big.push_back(static_cast<png_byte>(v >> 8));
        big.push_back(static_cast<png_byte>(v & 255));
    }
    std::vector<png_bytep> rows;
    for (int y = 0; y < image.height; ++y)
        rows.push_back(big.data() + std::size_t(y) * std::size_t(image.width) * 2);
    png_write_info(png, info);
    png_write_image(png, rows.data());
    png_write_end(png, info);
    png_destroy_write_struct(&png, &info);
    return bytes;
}

TEST(Image, SixteenBitGreyComesBack)
{
    const Image16 image = noise_image<std::uint16_t>(1);
    const Image16 back = decode_png_grey16(encode_png(image), "a.png");
    EXPECT_EQ(back.width, kWidth);
    EXPECT_EQ(back.height, kHeight);
    EXPECT_EQ(back.pixels, image.pixels);
}

TEST(Image, EightBitColourComesBack)
{
    const Image8 image = noise_image<std::uint8_t>(3);
    EXPECT_EQ(decode_png_rgb8(encode_png(image), "a.png").pixels, image.pixels);
}

TEST(Image, InterlacedFilesComeBack)
{
    for (const auto& [w, h] : {std::pair{37, 23}, {1, 1}, {3, 2}, {8, 9}, {5, 1}, {1, 6}}) {
        Image16 image(w, h, 1);
        for (std::size_t i = 0; i < image.pixels.size(); ++i)
            image.pixels[i] = static_cast<std::uint16_t>(hash2(5, i));
        EXPECT_EQ(decode_png_grey16(interlaced_png(image), "a.png").pixels, image.pixels);
    }
}

TEST(Image, AlphaIsIgnored)
{
    const Image8 image = noise_image<std::uint8_t>(4);
    const Image8 back = decode_png_rgb8(encode_png(image), "a.png");
    for (int y = 0; y < kHeight; ++y)
        for (int x = 0; x < kWidth; ++x)
            for (int c = 0; c < 3; ++c) ASSERT_EQ(back.at(x, y, c), image.at(x, y, c));
}

TEST(Image, EightBitGreyIsSpreadOverSixteen)
{
    const Image8 image = noise_image<std::uint8_t>(1);
    const Image16 back = decode_png_grey16(encode_png(image), "a.png");
    for (std::size_t i = 0; i < image.pixels.size(); ++i)
        ASSERT_EQ(back.pixels[i], image.pixels[i] * 257);
}

TEST(Image, ColourBecomesLuma)
{
    Image16 image(2, 1, 3);
    image.at(0, 0, 1) = 65535;  // green
    for (int c = 0; c < 3; ++c) image.at(1, 0, c) = 65535;
    const Image16 back = decode_png_grey16(encode_png(image), "a.png");
    EXPECT_NEAR(back.at(0, 0), 0.7152 * 65535, 1);
    EXPECT_EQ(back.at(1, 0), 65535);
}

TEST(Image, EqualPicturesAreEqualFiles)
{
    const std::string bytes = encode_png(noise_image<std::uint8_t>(3));
    EXPECT_EQ(bytes, encode_png(noise_image<std::uint8_t>(3)));
    EXPECT_EQ(bytes.find("tIME"), std::string::npos);
}

TEST(Image, FilesOnDiskComeBack)
{
    const TemporaryFolder folder;
    const auto path = folder / "a.png";
    write_png(path, noise_image<std::uint16_t>(1));
    EXPECT_EQ(read_png_grey16(path).pixels, noise_image<std::uint16_t>(1).pixels);
}

TEST(Image, EveryTruncationIsNamed)
{
    const std::string whole = encode_png(noise_image<std::uint16_t>(1));
    EXPECT_NO_THROW(decode_png_grey16(whole, "a.png"));
    EXPECT_THAT([] { decode_png_grey16("", "a.png"); },
                ThrowsMessage<InvalidInput>(HasSubstr("a.png: empty file")));
    for (std::size_t length = 1; length < whole.size(); ++length)
        ASSERT_THAT([&] { decode_png_grey16(std::string_view(whole).substr(0, length), "a.png"); },
                    ThrowsMessage<InvalidInput>(HasSubstr("a.png: truncated")))
            << length;
}

TEST(Image, AForeignFileIsNamed)
{
    EXPECT_THAT([] { decode_png_rgb8("ply\nformat ascii 1.0\n", "a.png"); },
                ThrowsMessage<InvalidInput>(HasSubstr("a.png: not a PNG")));
}

TEST(Image, DamagedDataAreNamed)
{
    std::string bytes = encode_png(noise_image<std::uint16_t>(1));
    bytes[bytes.size() / 2] = static_cast<char>(bytes[bytes.size() / 2] ^ 16);
    EXPECT_THAT([&] { decode_png_grey16(bytes, "a.png"); },
                ThrowsMessage<InvalidInput>(HasSubstr("a.png: damaged PNG: ")));
}

TEST(Image, AHeaderThatAsksForTooMuchIsRefusedBeforeAllocation)
{
    std::string bytes = encode_png(noise_image<std::uint8_t>(1));
    std::string huge = bytes;
    huge[16] = 0x7f;  // width: 2 billion
    EXPECT_THAT([&] { decode_png_rgb8(huge, "a.png"); },
                ThrowsMessage<InvalidInput>(HasSubstr("must be 1 to 268435456 in all")));
    std::string large = bytes;
    large[18] = 0x3f;  // 16165 x 16151 pixels out of a kilobyte
    large[22] = 0x3f;
    EXPECT_THAT([&] { decode_png_rgb8(large, "a.png"); },
                ThrowsMessage<InvalidInput>(HasSubstr("its header asks for 261 MB of pixels")));
}

TEST(Image, NoMutationDoesWorseThanInvalidInput)
{
    const std::string seeds[] = {encode_png(noise_image<std::uint16_t>(1)),
                                 encode_png(noise_image<std::uint8_t>(4)),
                                 interlaced_png(noise_image<std::uint16_t>(1))};
    std::size_t refused = 0;
    for (std::uint64_t i = 0; i < 3000; ++i) {
        std::string bytes = seeds[i % 3];
        const std::uint64_t key = hash2(kPixels.id, i);
        for (std::uint64_t k = 0; k <= hash2(key, 9) % 3; ++k) {
            // half of the changes hit the header, where the lengths and sizes are
            const std::size_t range = hash2(key, 4 * k) % 2 ? 60 : bytes.size();
            bytes[hash2(key, 4 * k + 1) % range] = static_cast<char>(hash2(key, 4 * k + 2));
        }
        try {
            decode_png_grey16(bytes, "a.png");
            decode_png_rgb8(bytes, "a.png");
        } catch (const InvalidInput&) {
            ++refused;
        }
    }
    EXPECT_GT(refused, 2500u);
}

TEST(Image, AnImpossiblePictureIsNotWritten)
{
    EXPECT_THAT([] { encode_png(Image8(0, 4, 3)); },
                ThrowsMessage<InvalidInput>(HasSubstr("0 x 4 pixels")));
    EXPECT_THAT([] { encode_png(Image8(3, 4, 2)); },
                ThrowsMessage<InvalidInput>(HasSubstr("2 channels")));
    Image8 short_one(3, 4, 1);
    short_one.pixels.pop_back();
    EXPECT_THAT([&] { encode_png(short_one); },
                ThrowsMessage<InvalidInput>(HasSubstr("11 samples")));
}

}  // namespace
}  // namespace sekitei
