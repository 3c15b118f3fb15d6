#pragma once

#include <cstdint>
#include <span>

#include "core/mesh.h"

namespace sekitei {

/// The triangles of a mesh whose number in `kept` is not 0, in their order, with the vertices that
/// they use, in the order of first use, and the attributes of both.
/// @param kept  one number a triangle
/// @throws InvalidInput  another count, or attributes of another length than the mesh has
TriMesh part_of(const TriMesh& mesh, std::span<const std::uint8_t> kept);

}  // namespace sekitei
