#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "core/error.h"
#include "core/image.h"

/// Any bytes are a picture or InvalidInput.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size)
{
    using namespace sekitei;
    const std::string_view bytes(reinterpret_cast<const char*>(data), size);
    try {
        const Image16 grey = decode_png_grey16(bytes, "a.png");
        const Image8 colour = decode_png_rgb8(bytes, "a.png");
        if (grey.width != colour.width || grey.height != colour.height) std::abort();
        if (decode_png_grey16(encode_png(grey), "again.png").pixels != grey.pixels) std::abort();
    } catch (const InvalidInput&) {
    }
    return 0;
}
