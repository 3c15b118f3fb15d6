#pragma once

#include <cstdint>

#include "core/mesh.h"
#include "core/progress.h"

namespace sekitei {

/// Counts pairs of triangles of a mesh that share no vertex and yet meet: an edge of one passes
/// from one side of the other's plane to the other side, through the triangle or its rim. Lying in
/// one plane or touching with a corner does not count.
///
/// Orientation tests are in double and take what lies within their rounding error for zero. Boxes
/// in a tree keep the work near n log n; for each triangle at most 4096 others whose boxes overlap
/// its own are looked at, so that the count is a lower bound where more do. The same on any number
/// of threads.
/// @param most  beyond this the count stops and most + 1 is returned
/// @throws Cancelled  from `progress`
std::uint64_t count_self_intersections(const TriMesh& mesh, std::uint64_t most,
                                       const Progress& progress = {});

}  // namespace sekitei
