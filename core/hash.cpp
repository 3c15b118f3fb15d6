#include "core/hash.h"

#define XXH_INLINE_ALL
#include <fmt/format.h>
#include <xxhash.h>

namespace sekitei {

struct Hasher::State {
    XXH3_state_t* xxh = XXH3_createState();
};

Hasher::Hasher() : state_(new State)
{
    XXH3_128bits_reset(state_->xxh);
}

Hasher::~Hasher()
{
    XXH3_freeState(state_->xxh);
    delete state_;
}

void Hasher::add(const void* data, std::size_t bytes)
{
    XXH3_128bits_update(state_->xxh, data, bytes);
}

void Hasher::add(std::string_view text)
{
    add_value(static_cast<std::uint64_t>(text.size()));  // so that "ab" + "c" is not "a" + "bc"
    add(text.data(), text.size());
}

std::string Hasher::hex() const
{
    const XXH128_hash_t h = XXH3_128bits_digest(state_->xxh);
    return fmt::format("{:016x}{:016x}", h.high64, h.low64);
}

std::uint64_t Hasher::low64() const
{
    return XXH3_128bits_digest(state_->xxh).low64;
}

std::string hash_hex(std::string_view bytes)
{
    const XXH128_hash_t h = XXH3_128bits(bytes.data(), bytes.size());
    return fmt::format("{:016x}{:016x}", h.high64, h.low64);
}

std::uint64_t hash64(const void* data, std::size_t bytes, std::uint64_t seed)
{
    return XXH3_64bits_withSeed(data, bytes, seed);
}

}  // namespace sekitei
