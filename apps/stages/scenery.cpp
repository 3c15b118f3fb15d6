#include "apps/stages/scenery.h"

#include <fmt/format.h>

#include <array>
#include <cmath>
#include <limits>

#include "apps/garden/lantern.h"
#include "apps/stage.h"
#include "apps/trees.h"
#include "core/error.h"
#include "core/parallel.h"
#include "grids/marching_tetrahedra.h"
#include "solvers/tree/wood.h"

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

void add_square(TriMesh& mesh, Vec3d at, Vec3d up, double half)
{
    const Vec3d side =
        normalized(std::abs(up.z) < 0.9 ? cross(up, Vec3d(0, 0, 1)) : cross(up, Vec3d(1, 0, 0)));
    const Vec3d u = side * half, v = cross(up, side) * half;
    const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
    for (const Vec3d corner : {-u - v, u - v, u + v, v - u})
        mesh.vertices.push_back(Vec3f(at + corner));
    mesh.triangles.push_back({first, first + 1, first + 2});
    mesh.triangles.push_back({first, first + 2, first + 3});
}

}  // namespace

std::vector<std::string> scenery_uses()
{
    return {"obstacle_sdf",  "water_surface", "leaves",    "surf_area",
            "tree_skeleton", "trees",         "canopy_lad"};
}

double leaf_slenderness(const std::string& species, bool needles)
{
    return needles ? 0.07 : species == "willow" ? 0.10 : 0.26;
}

void add_leaf(TriMesh& mesh, Vec3d at, const std::array<float, 4>& orient, double area,
              double slender)
{
    struct Corner {
        double across, along;  // of the half width and the length
    };
    // Base, three pairs of sides' corners in a ring, tip: 1.1375 times half width by length.
    constexpr std::array<Corner, 6> kOutline{
        {{0, 0}, {1, 0.35}, {0.75, 0.65}, {0, 1}, {-0.75, 0.65}, {-1, 0.35}}};
    const double long_ = std::sqrt(area / (1.1375 * slender)), wide = slender * long_;
    const double x = double(orient[0]), y = double(orient[1]), z = double(orient[2]),
                 w = double(orient[3]);
    const Vec3d ex(1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        ey(2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)), ez = cross(ex, ey);
    const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
    for (const Corner& c : kOutline)
        mesh.vertices.push_back(
            Vec3f(at + ex * (c.across * wide) + ey * ((c.along - 0.5) * long_) +
                  ez * (0.25 * wide * std::abs(c.across) - 0.15 * long_ * c.along * c.along)));
    for (const auto& t : {std::array<std::uint32_t, 3>{0, 1, 5}, {1, 2, 4}, {1, 4, 5}, {2, 3, 4}})
        mesh.triangles.push_back({first + t[0], first + t[1], first + t[2]});
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
    TriMesh all;
    for (const Crown& crown : crowns(scene)) garden::append(all, crown.leaves);
    return all;
}

std::vector<LeafKind> leaf_kinds(const Scene& scene)
{
    std::vector<LeafKind> list;
    const auto leaves = scene.points.find("leaves");
    if (leaves != scene.points.end() && leaves->second.values<std::array<float, 4>>("orient") &&
        leaves->second.values<std::int32_t>("species") && scene.points.contains("tree_skeleton"))
        for (const tree::Species& kind : grove_record(scene).species)
            list.push_back({kind.name, kind.model == tree::Model::Conifer});
    if (list.empty()) list.emplace_back();
    return list;
}

std::vector<Crown> crowns(const Scene& scene, double scale)
{
    const auto found = scene.points.find("leaves");
    if (found == scene.points.end() || found->second.position.empty()) return {};
    const Points& leaves = found->second;
    const auto* n = leaves.values<Vec3f>("N");
    const auto* s = leaves.values<float>("pscale");
    const auto* orient = leaves.values<std::array<float, 4>>("orient");
    const auto* species = leaves.values<std::int32_t>("species");
    if (!n || !s)
        throw InvalidInput("the points 'leaves' need the attributes N (vec3s) and pscale (float)");
    std::vector<Crown> list;
    for (LeafKind& kind : leaf_kinds(scene)) list.push_back({std::move(kind), {}});
    for (std::size_t i = 0; i < leaves.position.size(); ++i) {
        const std::size_t kind =
            species
                ? std::min<std::size_t>(std::size_t(std::max(0, (*species)[i])), list.size() - 1)
                : 0;
        Crown& crown = list[kind];
        const double half = double((*s)[i]);
        if (orient)
            add_leaf(crown.leaves, leaves.position[i], (*orient)[i],
                     4 * half * half * scale * scale,
                     leaf_slenderness(crown.species, crown.needles));
        else
            add_square(crown.leaves, leaves.position[i], Vec3d((*n)[i]), half);
    }
    return list;
}

std::optional<double> moss_size(const Scene& scene)
{
    // Mosses of a mesh know their host; they have a size of their own and stand closer.
    const auto moss = scene.points.find("moss");
    if (const Json* made = params_of(scene, "moss"); made && moss != scene.points.end() &&
                                                     moss->second.attributes.contains("host") &&
                                                     made->contains("size"))
        return 1.15 * (*made)["size"].get<double>();
    if (scene.has("surf_area")) return 1.6 * scene.floats("surf_area").transform().voxel;
    return {};
}

TriMesh bark_mesh(const Scene& scene, const Progress& progress)
{
    if (!scene.points.contains("tree_skeleton") || !scene.points.contains("trees")) return {};
    const Skeleton wood = skeleton_of(scene);
    return tree::bark_tubes(wood.branches, wood.radius, wood.unit_length, {}, progress);
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

std::vector<float> field_at_vertices(const TriMesh& mesh, const Grid& grid, const std::string& name)
{
    if (const auto* floats = std::get_if<FloatGrid>(&grid.values))
        return around_vertices(mesh, *floats);
    if (const auto* ints = std::get_if<IntGrid>(&grid.values)) return around_vertices(mesh, *ints);
    throw InvalidInput(fmt::format("render: field = {}: the grid holds {}, expected numbers", name,
                                   grid.type_name()));
}

TriMesh with_field(const TriMesh& mesh, const Scene& scene, const std::string& name,
                   const std::string& shown)
{
    TriMesh painted = mesh;
    painted.vertex_attributes[shown] = field_at_vertices(mesh, scene.grids.at(name), name);
    return painted;
}

}  // namespace sekitei::apps
