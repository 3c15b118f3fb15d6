#include "apps/stages/scenery.h"

#include <fmt/format.h>

#include <array>
#include <cmath>
#include <limits>

#include "apps/stage.h"
#include "core/error.h"
#include "core/parallel.h"
#include "grids/marching_tetrahedra.h"

namespace sekitei::apps {
namespace {

constexpr std::array<std::pair<const char*, const char*>, 8> kPlainNames{{
    {"soil_humidity", "soil_rh"},
    {"soil_temperature", "soil_Ts"},
    {"soil_evaporation", "soil_E"},
    {"soil_moisture", "soil_theta"},
    {"soil_depth", "soil_h"},
    {"light", "light_S"},
    {"cover", "moss_cover"},
    {"growth", "moss_growth"},
}};

template <class T>
std::vector<float> around_vertices(const TriMesh& mesh, const LeafGrid<T>& grid)
{
    std::vector<float> values(mesh.vertices.size());
    parallel_for_range(
        values.size(),
        [&](std::size_t begin, std::size_t end) {
            GridReader<T> reader(grid);
            for (std::size_t i = begin; i != end; ++i) {
                const Vec3d p = grid.transform().voxels(Vec3d(mesh.vertices[i]));
                const Coord c(static_cast<int>(std::floor(p.x)), static_cast<int>(std::floor(p.y)),
                              static_cast<int>(std::floor(p.z)));
                double sum = 0, weight = 0, most = 0;
                float nearest = 0;
                for (int d = 0; d < 27; ++d) {
                    const Coord at = c + Coord(d / 9 - 1, d / 3 % 3 - 1, d % 3 - 1);
                    if (!reader.active(at)) continue;
                    const Vec3d away = centre_of(at) - p;
                    const double w = 1 / (0.05 + dot(away, away));
                    sum += w * double(reader.value(at));
                    weight += w;
                    if (w > most) most = w, nearest = static_cast<float>(reader.value(at));
                }
                // Kinds and numbers have no mean.
                if constexpr (std::is_integral_v<T>)
                    values[i] = weight > 0 ? nearest : std::numeric_limits<float>::quiet_NaN();
                else
                    values[i] = weight > 0 ? static_cast<float>(sum / weight)
                                           : std::numeric_limits<float>::quiet_NaN();
            }
        },
        4096);
    return values;
}

}  // namespace

std::vector<std::string> scenery_uses()
{
    return {"obstacle_sdf", "water_surface", "leaves", "surf_area"};
}

TriMesh obstacle_mesh(const Scene& scene)
{
    if (!scene.has("obstacle_sdf")) return {};
    TriMesh mesh = marching_tetrahedra(scene.floats("obstacle_sdf"), 0, {});
    for (auto& t : mesh.triangles) std::swap(t[1], t[2]);  // inside is negative
    return mesh;
}

TriMesh leaf_mesh(const Scene& scene)
{
    TriMesh mesh;
    const auto found = scene.points.find("leaves");
    if (found == scene.points.end()) return mesh;
    const Points& leaves = found->second;
    const auto* n = leaves.values<Vec3f>("N");
    const auto* s = leaves.values<float>("pscale");
    if (!n || !s)
        throw InvalidInput("the points 'leaves' need the attributes N (vec3s) and pscale (float)");
    for (std::size_t i = 0; i < leaves.position.size(); ++i) {
        const Vec3d up((*n)[i]);
        const Vec3d side = normalized(std::abs(up.z) < 0.9 ? cross(up, Vec3d(0, 0, 1))
                                                           : cross(up, Vec3d(1, 0, 0)));
        const Vec3d u = side * double((*s)[i]), v = cross(up, side) * double((*s)[i]);
        const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
        for (const Vec3d corner : {-u - v, u - v, u + v, v - u})
            mesh.vertices.push_back(Vec3f(leaves.position[i] + corner));
        mesh.triangles.push_back({first, first + 1, first + 2});
        mesh.triangles.push_back({first, first + 2, first + 3});
    }
    return mesh;
}

TriMesh water_mesh(const Scene& scene, double ground)
{
    TriMesh mesh;
    if (!scene.has("water_surface")) return mesh;
    const IntGrid& water = scene.ints("water_surface");
    const double v = water.transform().voxel;
    for (std::size_t leaf = 0; leaf < water.leaf_count(); ++leaf)
        water.mask(leaf).for_each([&](int offset) {
            const Coord c = leaf_coord(water.origin(leaf), offset);
            const Vec3d low = water.transform().world(Vec3d(c) + Vec3d(0, 0, 1));
            const float z = static_cast<float>(std::max(low.z, ground + 0.01));
            const auto x0 = float(low.x), y0 = float(low.y), x1 = float(low.x + v),
                       y1 = float(low.y + v);
            const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
            mesh.vertices.insert(mesh.vertices.end(),
                                 {{x0, y0, z}, {x1, y0, z}, {x1, y1, z}, {x0, y1, z}});
            mesh.triangles.push_back({first, first + 1, first + 2});
            mesh.triangles.push_back({first, first + 2, first + 3});
        });
    return mesh;
}

std::string grid_of_field(const std::string& field)
{
    for (const auto& [plain, grid] : kPlainNames)
        if (field == plain) return grid;
    return field;
}

std::string nearest_field(const std::string& field)
{
    std::vector<std::string> known;
    for (const auto& [plain, grid] : kPlainNames) known.emplace_back(plain);
    for (const StageInfo& info : stage_infos())
        known.insert(known.end(), info.makes.begin(), info.makes.end());
    const std::string near = nearest_name(field, known);
    return near.empty() || near == field ? "" : fmt::format("; did you mean '{}'?", near);
}

TriMesh with_field(const TriMesh& mesh, const Scene& scene, const std::string& name,
                   const std::string& shown)
{
    TriMesh painted = mesh;
    const Grid& grid = scene.grids.at(name);
    if (const auto* floats = std::get_if<FloatGrid>(&grid.values))
        painted.vertex_attributes[shown] = around_vertices(mesh, *floats);
    else if (const auto* ints = std::get_if<IntGrid>(&grid.values))
        painted.vertex_attributes[shown] = around_vertices(mesh, *ints);
    else
        throw InvalidInput(fmt::format("render: field = {}: the grid holds {}, expected numbers",
                                       name, grid.type_name()));
    return painted;
}

}  // namespace sekitei::apps
