#pragma once

#include <cstddef>
#include <string>

#include "core/mesh.h"
#include "core/progress.h"

/// OBJ files of several objects.
namespace sekitei {

/// What stands before an object, whose faces count from there.
struct ObjCounts {
    std::size_t vertices = 0, normals = 0, textures = 0;
};

/// Vertices and faces of one mesh, a group `column_00042` for each column where the face attribute
/// `column` exists; adds to `counts`.
std::string obj_object(const TriMesh& mesh, ObjCounts& counts, const Progress& progress = {});

}  // namespace sekitei
