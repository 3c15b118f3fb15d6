#pragma once

#include <fmt/format.h>

#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "core/error.h"
#include "core/hash.h"
#include "core/params.h"
#include "solvers/moss/checkpoint.h"

/// Bytes of a checkpoint, for any state with `day`, `next_id`, `arrivals` and a function
/// each_array(state, f) that visits its arrays. Not for use outside solvers/moss.
namespace sekitei::moss {

/// Whose checkpoint it is.
struct CheckpointKind {
    std::string_view magic;  ///< 8 bytes
    std::uint32_t version;
    std::string_view name;  ///< "a checkpoint of moss"
};

class CheckpointWriter {
public:
    template <class T>
    void value(const T& v)
    {
        bytes.append(reinterpret_cast<const char*>(&v), sizeof v);
    }
    void text(std::string_view t)
    {
        value(std::uint64_t(t.size()));
        bytes.append(t);
    }
    template <class T>
    void array(const std::vector<T>& v)
    {
        static_assert(std::is_trivially_copyable_v<T>);
        value(std::uint64_t(v.size()));
        if (!v.empty()) bytes.append(reinterpret_cast<const char*>(v.data()), v.size() * sizeof(T));
    }
    std::string bytes;
};

class CheckpointReader {
public:
    CheckpointReader(std::string_view bytes, std::string where)
        : bytes_(bytes), where_(std::move(where))
    {
    }
    template <class T>
    T value()
    {
        T v;
        take(&v, sizeof v);
        return v;
    }
    std::string text()
    {
        std::string t(length(1), '\0');
        take(t.data(), t.size());
        return t;
    }
    template <class T>
    std::vector<T> array()
    {
        std::vector<T> v(length(sizeof(T)));
        take(v.data(), v.size() * sizeof(T));
        return v;
    }
    bool at_end() const { return bytes_.empty(); }
    [[noreturn]] void damaged(std::string_view what) const
    {
        throw InvalidInput(
            fmt::format("{}: damaged checkpoint: {}; start without it", where_, what));
    }

private:
    std::size_t length(std::size_t size)
    {
        const auto n = value<std::uint64_t>();
        if (n > bytes_.size() / size) damaged("it ends too early");
        return static_cast<std::size_t>(n);
    }
    void take(void* to, std::size_t size)
    {
        if (size > bytes_.size()) damaged("it ends too early");
        if (size) std::memcpy(to, bytes_.data(), size);
        bytes_.remove_prefix(size);
    }
    std::string_view bytes_;
    std::string where_;
};

/// What differs between two recipes: the members, where both are JSON objects.
std::string difference(const std::string& before, std::string_view now);

template <class State>
std::string encode(const CheckpointKind& kind, const CheckpointOf<State>& c)
{
    CheckpointWriter w;
    w.bytes.append(kind.magic);
    w.value(kind.version);
    w.value(c.seed);
    w.text(c.recipe);
    w.value(c.population.day);
    w.value(c.population.next_id);
    w.value(c.population.arrivals);
    each_array(c.population, [&](const auto& v) { w.array(v); });
    w.value(std::uint64_t(c.fields.size()));
    for (const auto& [name, values] : c.fields) {
        w.text(name);
        w.array(values);
    }
    w.bytes += hash_hex(w.bytes);
    return std::move(w.bytes);
}

/// @param differs  text(state): "; how it is of another run", or empty
/// @param damage   text(state): what is wrong with its arrays, or empty
template <class State, class Differs, class Damage>
CheckpointOf<State> decode(const CheckpointKind& kind, std::string_view bytes,
                           const std::string& where, std::uint64_t seed, std::string_view recipe,
                           Differs&& differs, Damage&& damage)
{
    constexpr std::size_t kDigest = 32;  // hexadecimal digits at the end
    if (!bytes.starts_with(kind.magic))
        throw InvalidInput(fmt::format("{}: not {}", where, kind.name));
    CheckpointReader r(bytes.substr(kind.magic.size()), where);
    if (const auto version = r.value<std::uint32_t>(); version != kind.version)
        throw InvalidInput(fmt::format(
            "{}: checkpoint of version {}, this program reads version {}; start without it", where,
            version, kind.version));
    if (bytes.size() < kDigest) r.damaged("it ends too early");
    const std::string_view body = bytes.substr(0, bytes.size() - kDigest);
    if (hash_hex(body) != bytes.substr(body.size())) r.damaged("its checksum does not match");

    r = CheckpointReader(body.substr(kind.magic.size() + sizeof kind.version), where);
    CheckpointOf<State> c;
    c.seed = r.value<std::uint64_t>();
    c.recipe = r.text();
    std::string others;
    if (c.seed != seed) others += fmt::format("; seed {}, this run has {}", c.seed, seed);
    if (c.recipe != recipe) others += difference(c.recipe, recipe);
    State& state = c.population;
    state.day = r.value<std::int32_t>();
    state.next_id = r.value<std::uint64_t>();
    state.arrivals = r.value<std::uint64_t>();
    each_array(state, [&](auto& v) {
        v = r.template array<typename std::decay_t<decltype(v)>::value_type>();
    });
    others += differs(state);
    if (!others.empty())
        throw InvalidInput(fmt::format("{}: checkpoint of another run: {}; start without it", where,
                                       others.substr(2)));
    if (const std::string what = damage(state); !what.empty()) r.damaged(what);
    const auto fields = r.value<std::uint64_t>();
    for (std::uint64_t k = 0; k < fields; ++k) {
        std::string name = r.text();
        c.fields[std::move(name)] = r.array<double>();
    }
    if (!r.at_end()) r.damaged("something follows its end");
    return c;
}

}  // namespace sekitei::moss
