#include "core/gltf.h"
#include "core/mesh_formats.h"

namespace sekitei::mesh_format {

std::string write_glb(const TriMesh& mesh, const Progress& progress)
{
    gltf::File file;
    nlohmann::json primitive = gltf::add_primitive(file, mesh, {}, false, progress);
    primitive["material"] = 0;
    // The default material of glTF is a white mirror; rock is neither.
    const nlohmann::json material = {{"name", "rock"},
                                     {"pbrMetallicRoughness",
                                      {{"baseColorFactor", {0.5, 0.5, 0.5, 1.0}},
                                       {"metallicFactor", 0},
                                       {"roughnessFactor", 1}}}};
    std::string out;
    file.write(
        {{"asset", {{"version", "2.0"}, {"generator", "Sekitei " SEKITEI_VERSION}}},
         {"scene", 0},
         {"scenes", {{{"nodes", {0}}}}},
         {"nodes", {{{"mesh", 0}}}},
         {"materials", {material}},
         {"meshes", {{{"primitives", nlohmann::json::array({std::move(primitive)})}}}}},
        [&](std::string_view part) { out += part; }, progress);
    return out;
}

}  // namespace sekitei::mesh_format
