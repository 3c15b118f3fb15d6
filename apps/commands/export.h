#pragma once

#include <string>
#include <vector>

#include "apps/commands/commands.h"

namespace sekitei::apps {

/// Writes what others open of scenes and meshes; returns the exit code.
/// @param targets  files and folders (a name that ends in /, or one that is there)
int command_export(const std::vector<std::string>& inputs, const std::vector<std::string>& targets,
                   const Words& words, const Common& common);

}  // namespace sekitei::apps
