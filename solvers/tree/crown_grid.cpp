#include <fmt/format.h>

#include "core/error.h"
#include "solvers/tree/crown_shade.h"

namespace sekitei::tree {

struct ExtinctionGrid::Cells {};

ExtinctionGrid::ExtinctionGrid(const SkyPatches&, const Balls&, double, Occlusion, const Progress&)
{
    throw InvalidParameter("tree: method = grid is not there yet, sweep is");
}
ExtinctionGrid::~ExtinctionGrid() = default;
void ExtinctionGrid::shade(Vec3d, std::uint32_t, std::span<double>) const {}

}  // namespace sekitei::tree
