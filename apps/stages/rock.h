#pragma once

#include <optional>
#include <string>

#include "core/mesh.h"
#include "core/progress.h"
#include "grids/scene.h"

/// The surface of a scene's volumes.
namespace sekitei::apps {

/// Where `grid` has the value `level`, outwards: half its largest value where none is given, 0 for
/// level sets. The surface of `density` has the attributes column, component and surface where the
/// scene has grids of these names; that of `surface_sdf` has surface = soil or rock where the grid
/// `geology` has both.
/// @param memory_limit  [bytes], 0: none
/// @throws InvalidInput  no such grid, no surface; LimitExceeded
TriMesh surface_of(const Scene& scene, const std::string& grid, const std::optional<double>& level,
                   double memory_limit, const Progress& progress);

}  // namespace sekitei::apps
