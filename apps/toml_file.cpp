#include "apps/toml_file.h"

#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>

#include "core/error.h"
#include "core/file_output.h"

namespace sekitei::apps {
namespace {

/// toml++ goes as deep as dotted keys do, and so would the stack.
void refuse_deep_keys(const std::string& text, const std::filesystem::path& file)
{
    constexpr int kMostDots = 200;
    int dots = 0, line = 1;
    for (const char c : text) {
        if (c == '\n') ++line;
        if (c == '\n' || c == ',' || c == '=' || c == '{') dots = 0;
        if (c == '.' && ++dots > kMostDots)
            throw InvalidParameter(
                fmt::format("{}:{}:1: more than {} dots in a key; recipes have tables such as "
                            "[lava] and no deeper ones",
                            file.string(), line, kMostDots));
    }
}

}  // namespace

std::string TomlErrors::place(const toml::source_region& source) const
{
    if (source.path && *source.path != file_) return *source.path;
    return fmt::format("{}:{}:{}", file_, source.begin.line, source.begin.column);
}

void TomlErrors::add(const toml::source_region& source, const std::string& text)
{
    found_[{source.begin.line, source.begin.column, found_.size()}] = place(source) + ": " + text;
}

void TomlErrors::add(const std::string& where, const std::string& text)
{
    found_[{0xFFFFFFFFu, 0, found_.size()}] = where + ": " + text;
}

void TomlErrors::raise() const
{
    if (!any()) return;
    std::vector<std::string> lines;
    for (const auto& [key, line] : found_) lines.push_back(line);
    throw InvalidParameter(fmt::format("{}", fmt::join(lines, "\n")));
}

Json json_of(const toml::node& node, const std::string& key)
{
    if (const auto* v = node.as_string()) return v->get();
    if (const auto* v = node.as_integer()) return v->get();
    if (const auto* v = node.as_floating_point()) {
        if (!std::isfinite(v->get())) throw InvalidParameter(key + " is not a finite number");
        return v->get();
    }
    if (const auto* v = node.as_boolean()) return v->get();
    if (const auto* v = node.as_array()) {
        Json list = Json::array();
        for (const toml::node& element : *v) list.push_back(json_of(element, key));
        return list;
    }
    throw InvalidParameter(key +
                           " is a table or a date, expected a number, text, true, false or a list");
}

std::vector<TomlEntry> in_file_order(const toml::table& table)
{
    std::vector<TomlEntry> entries;
    for (const auto& [key, node] : table) {
        const bool written = key.source().begin.line > 0;
        entries.push_back({std::string(key.str()), &node, written ? key.source() : node.source()});
    }
    std::stable_sort(entries.begin(), entries.end(), [](const TomlEntry& a, const TomlEntry& b) {
        const auto &p = a.node->source().begin, &q = b.node->source().begin;
        return std::tie(p.line, p.column) < std::tie(q.line, q.column);
    });
    return entries;
}

toml::source_region place_of_blame(const toml::table& table, const std::string& process,
                                   std::string_view message, const toml::source_region& fallback)
{
    if (message.starts_with(process + ": ")) message.remove_prefix(process.size() + 2);
    std::size_t first = message.size();
    toml::source_region place = fallback;
    for (const auto& [key, node, source] : in_file_order(table))
        for (const char* sign : {" = ", ":"}) {
            const std::size_t at = message.find(key + sign);
            const bool whole = at != std::string_view::npos &&
                               (at == 0 || message[at - 1] == ' ' || message[at - 1] == '\n');
            if (!whole || at >= first) continue;
            first = at;
            place = node->source();
        }
    return place;
}

std::string did_you_mean(const std::string& key, const std::vector<std::string>& known)
{
    const std::string near = nearest_name(key, known);
    return near.empty() ? "" : fmt::format(", did you mean '{}'?", near);
}

std::string read_toml_text(const std::filesystem::path& file, std::uint64_t largest)
{
    try {
        return read_file(file, largest);
    } catch (const InvalidInput& error) {
        throw InvalidParameter(error.what());  // a recipe is part of the command line
    }
}

toml::table parse_toml(const std::string& text, const std::filesystem::path& file)
{
    refuse_deep_keys(text, file);
    try {
        return toml::parse(text, file.string());
    } catch (const toml::parse_error& error) {
        throw InvalidParameter(fmt::format("{}:{}:{}: {}", file.string(), error.source().begin.line,
                                           error.source().begin.column, error.description()));
    }
}

toml::table read_toml(const std::filesystem::path& file, std::uint64_t largest)
{
    return parse_toml(read_toml_text(file, largest), file);
}

}  // namespace sekitei::apps
