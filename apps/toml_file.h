#pragma once

#define TOML_HEADER_ONLY 0
#include <fmt/format.h>
#include <toml++/toml.h>

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <string_view>
#include <tuple>
#include <vector>

#include "core/params.h"

/// Files of settings, read so that every mistake is told at once and with its place.
namespace sekitei::apps {

/// Collects everything that is wrong, to be told at once.
class TomlErrors {
public:
    explicit TomlErrors(std::string file) : file_(std::move(file)) {}

    /// "cliff.toml:12:1". Values given by --set were parsed under a name of their own.
    std::string place(const toml::source_region& source) const;
    void add(const toml::source_region& source, const std::string& text);
    void add(const std::string& where, const std::string& text);
    bool any() const { return !found_.empty(); }
    /// @throws InvalidParameter  all of them, one a line, in the order of the file
    void raise() const;

private:
    std::string file_;
    std::map<std::tuple<std::uint32_t, std::uint32_t, std::size_t>, std::string> found_;
};

/// A value as the neutral form that parameters take.
/// @throws InvalidParameter  for dates and tables, naming the key
Json json_of(const toml::node& node, const std::string& key);

/// One key of a table, where it stands and what it holds.
struct TomlEntry {
    std::string key;
    const toml::node* node;
    toml::source_region source;  ///< of the key; of a value given by --set: of that
};

/// The tables and keys of one level in the order of the file; toml++ keeps them by name.
std::vector<TomlEntry> in_file_order(const toml::table& table);

/// Where the key stands that a message names first, as "key = " or "key:" after the name of the
/// process; `fallback` where it names none.
toml::source_region place_of_blame(const toml::table& table, const std::string& process,
                                   std::string_view message, const toml::source_region& fallback);

/// ", did you mean 'spread'?" for a key that is not known; empty where none is near.
std::string did_you_mean(const std::string& key, const std::vector<std::string>& known);

/// @throws InvalidParameter  not TOML, with the place
toml::table parse_toml(const std::string& text, const std::filesystem::path& file);
/// Bytes of the largest file of settings.
inline constexpr std::uint64_t kLargestToml = 4u << 20;
/// @throws InvalidParameter  as it is part of the command line
std::string read_toml_text(const std::filesystem::path& file, std::uint64_t largest = kLargestToml);
toml::table read_toml(const std::filesystem::path& file, std::uint64_t largest = kLargestToml);

}  // namespace sekitei::apps
