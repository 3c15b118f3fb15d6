#pragma once

#include <cstdint>
#include <string_view>

/// Random numbers with an address instead of an order.
///
/// A number is a function of (seed, stream, identity): a lattice site, a line, a tree. Nothing has
/// state, so threads, topology and other draws cannot change it. All arithmetic is modulo 2^64.
/// mix64 is the finaliser of SplitMix64 [Steele2014].
namespace sekitei {

constexpr std::uint64_t mix64(std::uint64_t x)
{
    x += 0x9E3779B97F4A7C15u;
    x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9u;
    x = (x ^ (x >> 27)) * 0x94D049BB133111EBu;
    return x ^ (x >> 31);
}

/// The key of child `b` of key `a`.
constexpr std::uint64_t hash2(std::uint64_t a, std::uint64_t b)
{
    return mix64(mix64(a) + b);
}

/// Uniform in [0, 1): 53 bits of hash2(key, s).
constexpr double uniform_of_key(std::uint64_t key, std::uint64_t s)
{
    return static_cast<double>(hash2(key, s) >> 11) * 0x1p-53;
}

/// A named family of draws. A new draw is a new stream, so that nothing else is re-rolled.
struct Stream {
    std::uint64_t id;
    constexpr explicit Stream(std::string_view name) : id(0xCBF29CE484222325u)
    {
        for (const char c : name) id = (id ^ static_cast<unsigned char>(c)) * 0x100000001B3u;
    }
};

/// Uniform in [0, 1) for the entity `index` of a stream.
constexpr double uniform01(std::uint64_t seed, Stream stream, std::uint64_t index)
{
    return uniform_of_key(hash2(seed, stream.id), index);
}

/// Uniform in [0, 1) for draw `counter` of the entity `index` of a stream.
constexpr double uniform01(std::uint64_t seed, Stream stream, std::uint64_t index,
                           std::uint64_t counter)
{
    return uniform_of_key(hash2(hash2(seed, stream.id), index), counter);
}

}  // namespace sekitei
