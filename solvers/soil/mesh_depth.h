#pragma once

#include <cstdint>
#include <vector>

#include "core/mesh_sites.h"
#include "core/progress.h"

namespace sekitei::soil {

/// What lies below the sites of a mesh.
struct MeshDepth {
    std::vector<float> depth;  ///< h of the soil, 1 to 1000 [mm]
    /// The site on which a drop from an underside falls, -1: none, or no underside:
    /// Surface::drop_target.
    std::vector<std::int32_t> drop_target;
};

/// Depth: from the site straight down to the first face that looks down, where the solid ends;
/// 1000 mm where there is none (ground without a bottom), 1 mm where n.z <= 0.1 (walls,
/// undersides).
///
/// Drops fall from sites with n.z < -0.3 onto the first face that looks up. None where the back of
/// a sheet is in the way, and where the site below has its centroid no lower (in narrow gaps).
///
/// @throws InvalidInput  what rays cannot meet (rays::TriangleScene)
/// Bit-identical for any number of threads.
MeshDepth mesh_depth(const MeshSites& sites, const Progress& progress);

}  // namespace sekitei::soil
