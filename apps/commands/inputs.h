#pragma once

#include <filesystem>
#include <string>

/// What a word of the command line names as an input.
namespace sekitei::apps {

bool is_mesh_name(const std::string& name);

/// The mesh that goes beside a scene file of the same name.
std::filesystem::path mesh_beside(const std::string& scene);

/// Whether a scene file is about the triangles of a mesh, which then lies beside it.
bool speaks_of_mesh(const std::string& name);

}  // namespace sekitei::apps
