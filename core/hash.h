#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <type_traits>

namespace sekitei {

/// Streaming 128-bit content hash (XXH3). Not cryptographic: it finds damage and change, not
/// malice.
class Hasher {
public:
    Hasher();
    ~Hasher();
    Hasher(const Hasher&) = delete;
    Hasher& operator=(const Hasher&) = delete;

    void add(const void* data, std::size_t bytes);
    void add(std::string_view text);
    template <class T>
    requires std::is_trivially_copyable_v<T>
    void add_value(const T& value) { add(&value, sizeof value); }

    std::string hex() const;  ///< 32 lower-case hexadecimal digits
    std::uint64_t low64() const;

private:
    struct State;
    State* state_;
};

/// The hash of one block of bytes, as 32 hexadecimal digits.
std::string hash_hex(std::string_view bytes);

/// XXH3-64 of one block.
std::uint64_t hash64(const void* data, std::size_t bytes, std::uint64_t seed = 0);

}  // namespace sekitei
