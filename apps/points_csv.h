#pragma once

#include <filesystem>
#include <vector>

#include "core/vec.h"

namespace sekitei::apps {

/// Points from lines of "x,y,z"; empty lines and lines that start with # are skipped.
/// @throws InvalidInput  a line that is no point, a file without points
std::vector<Vec3d> read_points_csv(const std::filesystem::path& path);

}  // namespace sekitei::apps
