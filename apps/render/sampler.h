#pragma once

#include <array>
#include <cstdint>

#include "core/random.h"

namespace sekitei::render {

/// Well-spread numbers for one light path: the first two dimensions of Sobol's sequence, shuffled
/// and Owen-scrambled anew for each pair of dimensions [Burley2020]. Every number is a function of
/// (pixel, sample, pair), so threads cannot change it.
class Sampler {
public:
    Sampler(std::uint64_t pixel_key, std::uint32_t sample) : key_(pixel_key), sample_(sample) {}

    /// Two numbers in [0, 1).
    std::array<float, 2> next2()
    {
        const std::uint64_t a = mix64(key_ + pair_ * 2), b = mix64(key_ + pair_ * 2 + 1);
        ++pair_;
        const std::uint32_t i = reverse(permute(reverse(sample_), static_cast<std::uint32_t>(a)));
        const std::uint32_t x = reverse(permute(i, static_cast<std::uint32_t>(a >> 32)));
        const std::uint32_t y =
            reverse(permute(reverse(sobol1(i)), static_cast<std::uint32_t>(b >> 32)));
        return {unit(x), unit(y)};
    }

private:
    static float unit(std::uint32_t x) { return static_cast<float>(x >> 8) * 0x1p-24f; }

    static std::uint32_t reverse(std::uint32_t x)
    {
        x = ((x >> 1) & 0x55555555u) | ((x & 0x55555555u) << 1);
        x = ((x >> 2) & 0x33333333u) | ((x & 0x33333333u) << 2);
        x = ((x >> 4) & 0x0F0F0F0Fu) | ((x & 0x0F0F0F0Fu) << 4);
        return __builtin_bswap32(x);
    }

    /// A hash in which a bit depends only on itself and lower ones: an Owen scramble of reversed
    /// bits.
    static std::uint32_t permute(std::uint32_t x, std::uint32_t seed)
    {
        x ^= x * 0x3D20ADEAu;
        x += seed;
        x *= (seed >> 16) | 1;
        x ^= x * 0x05526C56u;
        x ^= x * 0x53A22864u;
        return x;
    }

    /// The sequence's second dimension: the columns of the Pascal matrix modulo 2, bytewise.
    static std::uint32_t sobol1(std::uint32_t i)
    {
        return kTable[0][i & 255] ^ kTable[1][(i >> 8) & 255] ^ kTable[2][(i >> 16) & 255] ^
               kTable[3][i >> 24];
    }
    using Table = std::array<std::array<std::uint32_t, 256>, 4>;
    static constexpr Table make_table()
    {
        Table table{};
        std::uint32_t column = 1u << 31;
        for (int bit = 0; bit < 32; ++bit, column ^= column >> 1)
            for (std::uint32_t v = 0; v < 256; ++v)
                if (v >> (bit & 7) & 1) table[static_cast<std::size_t>(bit >> 3)][v] ^= column;
        return table;
    }
    static const Table kTable;

    std::uint64_t key_;
    std::uint32_t sample_;
    std::uint64_t pair_ = 0;
};

inline constexpr Sampler::Table Sampler::kTable = Sampler::make_table();

}  // namespace sekitei::render
