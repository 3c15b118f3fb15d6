#include "core/image.h"

#include <fmt/format.h>
#include <png.h>

#include <algorithm>
#include <bit>
#include <csetjmp>
#include <cstring>
#include <functional>
#include <limits>
#include <string_view>

#include "core/error.h"
#include "core/file_output.h"

namespace sekitei {
namespace {

constexpr std::uint64_t kMostPixels = 1ull << 28;
/// Deflate cannot make more than this out of a byte (RFC 1951: a 258-byte match in two bits).
constexpr std::uint64_t kDeflateRatio = 1032;

/// What libpng complained about last. It lives outside every frame that longjmp leaves.
struct Complaint {
    char text[160] = "";
};

void on_error(png_structp png, png_const_charp message)
{
    auto* complaint = static_cast<Complaint*>(png_get_error_ptr(png));
    std::strncpy(complaint->text, message, sizeof complaint->text - 1);
    png_longjmp(png, 1);
}

void on_warning(png_structp, png_const_charp) {}

/// Runs `f`, which calls libpng and owns nothing that needs a destructor; false if libpng gave up.
template <class F>
bool guarded(png_structp png, const F& f)
{
    if (setjmp(png_jmpbuf(png))) return false;
    f();
    return true;
}

struct Source {
    const char* at;
    const char* end;
};

void read_bytes(png_structp png, png_bytep out, png_size_t count)
{
    auto* source = static_cast<Source*>(png_get_io_ptr(png));
    if (count > static_cast<std::size_t>(source->end - source->at)) png_error(png, "file ends");
    std::memcpy(out, source->at, count);
    source->at += count;
}

/// The two libpng structures of a reader or a writer, released whatever happens.
struct Handles {
    bool writing;
    Complaint complaint;
    png_structp png = nullptr;
    png_infop info = nullptr;

    explicit Handles(bool write) : writing(write)
    {
        png = write
                  ? png_create_write_struct(PNG_LIBPNG_VER_STRING, &complaint, on_error, on_warning)
                  : png_create_read_struct(PNG_LIBPNG_VER_STRING, &complaint, on_error, on_warning);
        if (png) info = png_create_info_struct(png);
        if (!info) {
            release();
            throw Error(ExitCode::Bug,
                        "libpng does not start: its version differs from its header");
        }
    }
    ~Handles() { release(); }
    Handles(const Handles&) = delete;
    Handles& operator=(const Handles&) = delete;

    void release()
    {
        if (writing)
            png_destroy_write_struct(&png, &info);
        else
            png_destroy_read_struct(&png, &info, nullptr);
    }
};

std::uint32_t big_endian(std::string_view bytes, std::size_t at)
{
    std::uint32_t value = 0;
    for (std::size_t i = 0; i < 4; ++i)
        value = value << 8 | static_cast<unsigned char>(bytes[at + i]);
    return value;
}

/// Walks the chunks before libpng sees the file: signature, lengths, sizes.
void check_chunks(std::string_view bytes, const std::string& name)
{
    static constexpr std::string_view kSignature = "\x89PNG\r\n\x1a\n";
    if (bytes.empty()) throw InvalidInput(fmt::format("{}: empty file, expected a PNG", name));
    if (!bytes.starts_with(kSignature.substr(0, std::min(bytes.size(), kSignature.size()))))
        throw InvalidInput(fmt::format("{}: not a PNG: it does not begin with \\x89PNG", name));

    std::size_t at = kSignature.size();
    std::uint64_t data = 0;
    auto truncated = [&](const std::string& what, std::uint64_t needs) {
        return InvalidInput(fmt::format("{}: truncated: {} at byte {} needs {} bytes, file has {}",
                                        name, what, at, needs, bytes.size()));
    };
    double raw_bits = 0;
    for (bool first = true;; first = false) {
        if (bytes.size() < at + 12) throw truncated("the next chunk", at + 12);
        const std::uint64_t length = big_endian(bytes, at);
        const std::string_view type = bytes.substr(at + 4, 4);
        if (type.find_first_not_of("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz") !=
            std::string_view::npos)
            throw InvalidInput(
                fmt::format("{}: damaged: no chunk begins at byte {}, where one must", name, at));
        if (bytes.size() < at + 12 + length)
            throw truncated(fmt::format("chunk {}", type), at + 12 + length);
        if (first) {
            if (type != "IHDR" || length != 13)
                throw InvalidInput(
                    fmt::format("{}: damaged: first chunk is {} of {} bytes, must be IHDR of 13",
                                name, type, length));
            const double width = big_endian(bytes, at + 8), height = big_endian(bytes, at + 12);
            if (width == 0 || height == 0 || width * height > static_cast<double>(kMostPixels))
                throw InvalidInput(fmt::format("{}: {} x {} pixels, must be 1 to {} in all", name,
                                               width, height, kMostPixels));
            const int depth = static_cast<unsigned char>(bytes[at + 16]),
                      colour = static_cast<unsigned char>(bytes[at + 17]);
            const int channels = colour == 2 ? 3 : colour == 4 ? 2 : colour == 6 ? 4 : 1;
            raw_bits = width * height * depth * channels;
        }
        if (type == "IDAT") data += length;
        if (type == "IEND") break;
        at += 12 + length;
    }
    const double least = raw_bits / 8 / static_cast<double>(kDeflateRatio);
    if (static_cast<double>(data) < least)
        throw InvalidInput(
            fmt::format("{}: damaged: its header asks for {} of pixels, its data are {} bytes",
                        name, bytes_text(raw_bits / 8), data));
}

/// Calls put(x, y, samples) for every pixel, with `channels` = 1 or 3 native 16-bit samples if
/// `wide`, else three 8-bit ones. Interlaced passes are scattered here, so that memory is one row.
template <class Put>
void read_pixels(std::string_view bytes, const std::string& name, bool wide,
                 const std::function<void(int width, int height)>& allocate, const Put& put)
{
    check_chunks(bytes, name);
    Handles handles(false);
    Source source{bytes.data(), bytes.data() + bytes.size()};
    png_structp png = handles.png;
    png_infop info = handles.info;
    auto damaged = [&] {
        return InvalidInput(fmt::format("{}: damaged PNG: {}", name, handles.complaint.text));
    };

    png_set_read_fn(png, &source, read_bytes);
    int width = 0, height = 0, channels = 0;
    bool interlaced = false;
    std::size_t row_bytes = 0;
    const bool begun = guarded(png, [&] {
        png_set_user_limits(png, 0x7fffffff, 0x7fffffff);
        png_set_chunk_malloc_max(png, 8'000'000);  // compressed comments may not fill the memory
        png_read_info(png, info);
        png_set_expand(png);
        png_set_strip_alpha(png);
        if (wide) {
            png_set_expand_16(png);
            if constexpr (std::endian::native == std::endian::little) png_set_swap(png);
        } else {
            png_set_scale_16(png);
            png_set_gray_to_rgb(png);
        }
        interlaced = png_get_interlace_type(png, info) != PNG_INTERLACE_NONE;
        png_read_update_info(png, info);
        width = static_cast<int>(png_get_image_width(png, info));
        height = static_cast<int>(png_get_image_height(png, info));
        channels = png_get_channels(png, info);
        row_bytes = png_get_rowbytes(png, info);
    });
    if (!begun) throw damaged();
    const std::size_t sample = wide ? 2 : 1;
    if ((channels != 1 && channels != 3) ||
        row_bytes != std::size_t(width) * std::size_t(channels) * sample)
        throw Error(ExitCode::Bug, fmt::format("{}: libpng gives rows of {} bytes and {} channels",
                                               name, row_bytes, channels));

    allocate(width, height);
    std::vector<unsigned char> row(row_bytes);
    unsigned char* const buffer = row.data();
    const bool read = guarded(png, [&] {
        for (int pass = 0; pass < (interlaced ? PNG_INTERLACE_ADAM7_PASSES : 1); ++pass) {
            const int x0 = interlaced ? PNG_PASS_START_COL(pass) : 0;
            const int dx = interlaced ? 1 << PNG_PASS_COL_SHIFT(pass) : 1;
            const int y0 = interlaced ? PNG_PASS_START_ROW(pass) : 0;
            const int dy = interlaced ? 1 << PNG_PASS_ROW_SHIFT(pass) : 1;
            if (x0 >= width) continue;  // an empty pass has no rows
            for (int y = y0; y < height; y += dy) {
                png_read_row(png, buffer, nullptr);
                const unsigned char* p = buffer;
                for (int x = x0; x < width; x += dx, p += std::size_t(channels) * sample)
                    put(x, y, p, channels);
            }
        }
        png_read_end(png, nullptr);
    });
    if (!read) throw damaged();
}

void append_bytes(png_structp png, png_bytep data, png_size_t count)
{
    // An exception must not cross libpng's frames: they are C.
    bool full = false;
    try {
        static_cast<std::string*>(png_get_io_ptr(png))
            ->append(reinterpret_cast<const char*>(data), count);
    } catch (...) {
        full = true;
    }
    if (full) png_error(png, "out of memory");
}

void no_flush(png_structp) {}

template <class T>
std::string encode(const Image<T>& image)
{
    if (image.width < 1 || image.height < 1 ||
        (image.channels != 1 && image.channels != 3 && image.channels != 4))
        throw InvalidInput(
            fmt::format("png: {} x {} pixels of {} channels, must be at least 1 x 1 of 1, 3 or 4",
                        image.width, image.height, image.channels));
    const std::size_t row = std::size_t(image.width) * std::size_t(image.channels);
    if (image.pixels.size() != row * std::size_t(image.height))
        throw InvalidInput(fmt::format("png: {} samples, must be {} x {} x {}", image.pixels.size(),
                                       image.width, image.height, image.channels));

    Handles handles(true);
    std::string bytes;
    png_structp png = handles.png;
    png_infop info = handles.info;
    png_set_write_fn(png, &bytes, append_bytes, no_flush);
    const bool written = guarded(png, [&] {
        png_set_user_limits(png, 0x7fffffff, 0x7fffffff);
        const int colour = image.channels == 1   ? PNG_COLOR_TYPE_GRAY
                           : image.channels == 3 ? PNG_COLOR_TYPE_RGB
                                                 : PNG_COLOR_TYPE_RGB_ALPHA;
        png_set_IHDR(png, info, static_cast<png_uint_32>(image.width),
                     static_cast<png_uint_32>(image.height), 8 * int(sizeof(T)), colour,
                     PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
        png_write_info(png, info);
        if constexpr (sizeof(T) == 2 && std::endian::native == std::endian::little)
            png_set_swap(png);
        for (int y = 0; y < image.height; ++y)
            png_write_row(
                png, reinterpret_cast<png_const_bytep>(image.pixels.data() + row * std::size_t(y)));
        png_write_end(png, info);
    });
    if (!written) throw Error(ExitCode::Bug, fmt::format("png: {}", handles.complaint.text));
    return bytes;
}

}  // namespace

std::string encode_png(const Image8& image)
{
    return encode(image);
}

std::string encode_png(const Image16& image)
{
    return encode(image);
}

void write_png(const std::filesystem::path& path, const Image8& image)
{
    write_file(path, encode(image));
}

void write_png(const std::filesystem::path& path, const Image16& image)
{
    write_file(path, encode(image));
}

Image16 decode_png_grey16(std::string_view bytes, const std::string& name)
{
    Image16 image;
    read_pixels(
        bytes, name, true, [&](int width, int height) { image = Image16(width, height, 1); },
        [&image](int x, int y, const unsigned char* p, int channels) {
            std::uint16_t s[3];
            std::memcpy(s, p, sizeof(std::uint16_t) * std::size_t(channels));
            // Rec. 709 luma with weights in ten-thousandths, rounded
            image.at(x, y) =
                channels == 1 ? s[0]
                              : static_cast<std::uint16_t>(
                                    (2126u * s[0] + 7152u * s[1] + 722u * s[2] + 5000u) / 10000u);
        });
    return image;
}

Image8 decode_png_rgb8(std::string_view bytes, const std::string& name)
{
    Image8 image;
    read_pixels(
        bytes, name, false, [&](int width, int height) { image = Image8(width, height, 3); },
        [&image](int x, int y, const unsigned char* p, int) {
            std::memcpy(&image.at(x, y), p, 3);
        });
    return image;
}

Image16 read_png_grey16(const std::filesystem::path& path)
{
    return decode_png_grey16(read_file(path), path.string());
}

Image8 read_png_rgb8(const std::filesystem::path& path)
{
    return decode_png_rgb8(read_file(path), path.string());
}

}  // namespace sekitei
