#pragma once

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <filesystem>
#include <string>
#include <vector>

#include "apps/recipe.h"
#include "core/error.h"
#include "core/params.h"

namespace sekitei::apps {

/// One of the presets by its name, or what a .toml file describes.
/// @param what    "soil", for messages
/// @param folder  where a relative name of a file starts
/// @param finish  takes what was read and the file's stem; throws where it is not valid
template <class T, class F>
T preset_or_file(const std::string& what, const std::string& name,
                 const std::filesystem::path& folder, const std::vector<T>& presets, F&& finish)
{
    const std::filesystem::path path(name);
    if (path.extension() == ".toml") {
        T read;
        apply_params_file(path.is_absolute() ? path : folder / path, describe_params(read),
                          [&] { finish(read, path.stem().string()); });
        return read;
    }
    std::vector<std::string> names;
    for (const T& preset : presets) {
        if (preset.name == name) return preset;
        names.push_back(preset.name);
    }
    const std::string near = nearest_name(name, names);
    throw InvalidParameter(
        fmt::format("{0} = {1}: no such {0}, expected one of {2} or a .toml file{3}", what, name,
                    fmt::join(names, ", "), near.empty() ? "" : "; did you mean '" + near + "'?"));
}

}  // namespace sekitei::apps
