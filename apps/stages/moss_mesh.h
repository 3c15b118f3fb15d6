#pragma once

#include <optional>
#include <string>
#include <vector>

#include "apps/mesh_habitat.h"
#include "apps/stage.h"
#include "solvers/moss/growth.h"
#include "solvers/moss/population.h"

/// Moss on the triangles of a mesh, day by day with the photons that feed it.
namespace sekitei::apps {

/// What a run of moss on a mesh is asked for.
struct MossRun {
    std::vector<moss::Species> species;
    moss::Rules rules;
    moss::Propagation propagation;
    std::optional<std::int64_t> days;
    bool repeat_year = false;
    std::int64_t every = 0;
    std::string checkpoint;  ///< file, empty: that of the context
    std::optional<bool> light_gate;
    Json identity;  ///< all parameters that a checkpoint depends on
};

/// Grids and points that it reads of a scene where they are there: wind and weather.
std::vector<std::string> mesh_moss_uses();
/// Names of the fields it leaves on sites and cells, without those of species.
std::vector<std::string> mesh_moss_fields();

/// Runs all days on the mesh `rock` and leaves what mesh_moss_fields() and site_items() name, and
/// the points `moss`, `seeds`, `statistics`, `weather`.
/// @param params  validated
Json moss_on_mesh(Scene& scene, const StageContext& context, const MeshMossParams& params,
                  const MossRun& run);

}  // namespace sekitei::apps
