#pragma once

#include <vector>

#include "core/mesh.h"
#include "core/progress.h"

namespace sekitei::render {

/// Normals for smooth shading, three a triangle.
///
/// A corner's normal is the mean of the triangles around its vertex, weighted by area, over those
/// that turn less than `crease` [rad] from its own triangle: planar walls made of many facets
/// become even, edges between them stay sharp. Slivers, whose own normals mean little, first take
/// the mean of what surrounds them. The same bytes on any number of threads.
/// @throws Cancelled  from `progress`
std::vector<Vec3f> corner_normals(const TriMesh& mesh, double crease,
                                  const Progress& progress = {});

}  // namespace sekitei::render
