#pragma once

#include <map>
#include <string>
#include <vector>

#include "core/hash.h"
#include "core/mesh_io.h"
#include "grids/scene.h"
#include "tests/apps/climate_scenes.h"
#include "tests/support/shapes.h"

/// Scenes that are about a mesh, and stages run on them.
namespace sekitei::apps::testing {

inline Scene mesh_scene(TriMesh mesh)
{
    Scene scene;
    scene.meshes["rock"] = std::move(mesh);
    return scene;
}

/// Runs `light` or `moss` on the mesh of a scene.
inline Json run_on_mesh(Scene& scene, const std::string& name, Json values,
                        const StageContext& context)
{
    values["surface"] = "mesh";
    return run(scene, name, values, context);
}

/// Hashes of all grids, points and meshes.
inline std::map<std::string, std::string> hashes_of(const Scene& scene)
{
    std::map<std::string, std::string> all;
    for (const auto& [name, grid] : scene.grids) all["grid " + name] = content_hash(grid);
    for (const auto& [name, points] : scene.points) all["points " + name] = content_hash(points);
    for (const auto& [name, mesh] : scene.meshes)
        all["mesh " + name] = hash_hex(encode_mesh(mesh, ".ply"));
    return all;
}

/// A field of the points `sites`.
template <class T = float>
const std::vector<T>& site_values(const Scene& scene, const std::string& name)
{
    return std::get<std::vector<T>>(scene.points_of("sites").attributes.at(name));
}

/// Mean over the sites, by area, of those for which `counts(normal, position)` holds.
template <class F>
double site_mean(const Scene& scene, const std::string& name, F&& counts)
{
    const std::vector<float>&values = site_values(scene, name), &area = site_values(scene, "area");
    const std::vector<Vec3f>& normal = site_values<Vec3f>(scene, "N");
    double sum = 0, all = 0;
    for (std::size_t i = 0; i < values.size(); ++i)
        if (counts(Vec3d(normal[i]), scene.points_of("sites").position[i])) {
            sum += double(values[i]) * double(area[i]);
            all += double(area[i]);
        }
    return sum / all;
}
inline double site_mean(const Scene& scene, const std::string& name)
{
    return site_mean(scene, name, [](Vec3d, Vec3d) { return true; });
}

inline std::size_t living(const Scene& scene)
{
    return scene.points_of("moss").position.size();
}

}  // namespace sekitei::apps::testing
