#include "solvers/weathering/weathering.h"

#include <fmt/format.h>

#include <cmath>
#include <optional>

#include "core/error.h"
#include "core/log.h"
#include "solvers/weathering/boundary.h"
#include "solvers/weathering/pieces.h"

namespace sekitei::weathering {
namespace {

void check_transform(std::string_view name, const Transform& found, const Transform& wanted)
{
    if (found == wanted) return;
    throw InvalidInput(fmt::format(
        "weathering: grid `{}` has voxels of {} m with origin ({}, {}, {}), must be on the "
        "scene's lattice, {} m with origin ({}, {}, {}); resample it",
        name, found.voxel, found.origin.x, found.origin.y, found.origin.z, wanted.voxel,
        wanted.origin.x, wanted.origin.y, wanted.origin.z));
}

void check(const Inputs& inputs)
{
    const Domain& domain = inputs.domain;
    if (domain.dims.x <= 0 || domain.dims.y <= 0 || domain.dims.z <= 0)
        throw InvalidInput(
            fmt::format("weathering: the box is {} x {} x {} voxels, must be at "
                        "least one in each direction",
                        domain.dims.x, domain.dims.y, domain.dims.z));
    check_transform("region", inputs.region.transform(), domain.transform);
    check_transform("column", inputs.column.transform(), domain.transform);
    check_transform("body_sdf", inputs.body_sdf.transform(), domain.transform);
    if (inputs.slow_sdf.leaf_count() > 0)
        check_transform("slow_sdf", inputs.slow_sdf.transform(), domain.transform);
    if (inputs.weathering)
        check_transform("weathering", inputs.weathering->transform(), domain.transform);
    if (inputs.terrain) check_transform("terrain", inputs.terrain->transform(), domain.transform);
}

}  // namespace

void validate(const Params& params)
{
    validate_described("weathering", params);
    if (params.open_face && length(*params.open_face) == 0)
        throw InvalidParameter("weathering: open_face = 0,0,0, must be a direction such as 0,-1,0");
    for (const double id : params.remove_columns)
        if (id < 0 || id != std::floor(id))
            throw InvalidParameter(
                fmt::format("weathering: remove_columns = {}, must be whole numbers from 0", id));
    const auto& boxes = params.remove_box;
    if (boxes.size() % 6 != 0)
        throw InvalidParameter(fmt::format(
            "weathering: remove_box has {} numbers, must be six for each box, x0,y0,z0,x1,y1,z1",
            boxes.size()));
    for (std::size_t at = 0; at < boxes.size(); at += 6)
        for (std::size_t k = 0; k < 3; ++k)
            if (!(boxes[at + k] <= boxes[at + k + 3]))
                throw InvalidParameter(fmt::format(
                    "weathering: remove_box runs from {} to {} along {}, must not run backwards",
                    boxes[at + k], boxes[at + k + 3], "xyz"[k]));
}

Result run(const Inputs& inputs, const Params& params, std::uint64_t seed, const Progress& progress)
{
    validate(params);
    check(inputs);
    const std::vector<double> arcs = inputs.lines.arc_lengths();
    const PolylineIndex index(inputs.lines);
    std::optional<Terrain> terrain;
    if (params.cut == Cut::Horizontal) terrain.emplace(inputs, params, seed);
    const Terrain* above = terrain ? &*terrain : nullptr;

    Result result;
    CutResult cut = cut_columns(inputs, params, seed, above, progress.slice(0, 0.2));
    result.weathering = std::move(cut.weathering);
    result.component = component_grid(inputs, cut.pieces, index, arcs, progress.slice(0.2, 0.4));
    progress.update(0.4);
    collapse(inputs, params, result.component, cut.weak, cut.pieces, progress.slice(0.4, 0.55));
    BoundaryResult boundary = find_boundary(inputs, params, result.component, cut.pieces, index,
                                            arcs, above, progress.slice(0.55, 1));
    result.density = std::move(boundary.density);
    result.surface = std::move(boundary.surface);
    result.columns = inputs.lines.count();
    result.pieces = cut.pieces.count();
    for (const std::uint8_t stands : cut.pieces.present) result.removed_pieces += !stands;
    result.removed_voxels = boundary.removed_voxels;
    result.lava_voxels = boundary.lava_voxels;
    result.leaves_touched_share = boundary.leaves_touched_share;
    progress.update(1);
    return result;
}

}  // namespace sekitei::weathering
