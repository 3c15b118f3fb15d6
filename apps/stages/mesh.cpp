#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "apps/garden/plot.h"
#include "apps/ground.h"
#include "apps/stages/rock.h"
#include "apps/stages/stages.h"
#include "core/error.h"
#include "core/parallel.h"
#include "grids/marching_tetrahedra.h"
#include "grids/surface_attributes.h"

namespace sekitei::apps {
namespace {

struct MeshParams {
    std::filesystem::path file;
    double scale = 1;
    UpAxis up = UpAxis::Z;
    std::string grid = "density";
    std::optional<double> iso;

    static void describe(auto&& field)
    {
        field("file", &MeshParams::file,
              "mesh to read in place of a scene: PLY, OBJ, STL or OFF; empty: none");
        field("scale", &MeshParams::scale, "", kPositive, "with file: metres per unit of it");
        field("up", &MeshParams::up,
              "with file: axis that points up there; (x, y, z) with y up becomes (x, -z, y)");
        field("grid", &MeshParams::grid, "float grid whose surface is extracted");
        field("iso", &MeshParams::iso, "", kAny,
              "value at the surface; auto: half the largest value, 0 for level sets");
    }
};

/// Bytes at the peak: the mesh, its attributes and its file, beside the grids it comes from.
double mesh_memory(double triangles)
{
    return 4e8 + triangles * 150;
}
constexpr double kTrianglesPerLeaf = 400;  // of a leaf that the surface meets

double largest(const FloatGrid& grid)
{
    return parallel_fold(
        grid.leaf_count(), 64, 0.0,
        [&](std::size_t begin, std::size_t end) {
            double most = 0;
            for (std::size_t leaf = begin; leaf < end; ++leaf) {
                if (const float* v = grid.values(leaf))
                    most = std::max<double>(most, *std::max_element(v, v + kLeafSize));
                else
                    most = std::max<double>(most, grid.constant(leaf));
            }
            return most;
        },
        [](double a, double b) { return std::max(a, b); });
}

/// Where there is stone as well as soil: the face attribute `surface`, 0 or that of ground, by
/// the nearest cell that knows.
void mark_soil(TriMesh& mesh, const Transform& transform, const IntGrid& geology)
{
    if (!(geology.transform() == transform)) return;
    std::vector<std::int32_t> surface(mesh.triangles.size());
    parallel_for_range(
        surface.size(),
        [&](std::size_t begin, std::size_t end) {
            GridReader<std::int32_t> reader(geology);
            for (std::size_t f = begin; f < end; ++f) {
                Vec3d p;
                for (const std::uint32_t v : mesh.triangles[f])
                    p += transform.voxels(Vec3d(mesh.vertices[v])) / 3.0;
                const Coord c(int(std::floor(p.x)), int(std::floor(p.y)), int(std::floor(p.z)));
                double nearest = std::numeric_limits<double>::infinity();
                for (int d = 0; d < 27; ++d) {
                    const Coord at = c + Coord(d / 9 - 1, d / 3 % 3 - 1, d % 3 - 1);
                    const Vec3d away = centre_of(at) - p;
                    const std::int32_t what = reader.value(at);
                    if (what == 0 || dot(away, away) >= nearest) continue;
                    nearest = dot(away, away);
                    surface[f] = is_stone(what) ? 0 : garden::kGroundSurface;
                }
            }
        },
        4096);
    const auto soil = std::count(surface.begin(), surface.end(), garden::kGroundSurface);
    if (soil > 0 && std::size_t(soil) < surface.size())
        mesh.face_attributes["surface"] = std::move(surface);
}

class MeshStage : public Stage {
public:
    const StageInfo& info() const override
    {
        static const StageInfo kInfo{
            "mesh",
            "1",
            "extract the surface as triangles with column and surface attributes",
            OutputKind::Mesh,
            true,
            {"density", "column", "component", "surface"},
            {"rock"}};
        return kInfo;
    }

    bool reads_scene() override { return params_.file.empty(); }
    std::vector<std::string> needs() override
    {
        if (!params_.file.empty()) return {};
        if (params_.grid == "density") return info().needs;
        return {params_.grid};
    }

    std::vector<std::string> uses() override
    {
        if (params_.file.empty() && params_.grid == "surface_sdf") return {"geology"};
        return {};
    }

    ParamList params() override { return describe_params(params_); }
    void validate() override
    {
        validate_described("mesh", params_);
        if (!params_.file.empty())
            warn_unused(*this, {"grid", "iso"}, "with file");
        else
            warn_unused(*this, {"scale", "up"}, "without file");
    }

    Need estimate(SceneOutline& outline, const StageContext& context) override
    {
        if (!params_.file.empty()) {
            std::error_code unknown;
            const auto bytes =
                double(std::filesystem::file_size(resolve(context, params_.file), unknown));
            outline.surface_cells = unknown ? 0 : bytes / 25;  // a binary PLY's share of a face
            return {outline.surface_cells, mesh_memory(outline.surface_cells), unknown ? 0 : bytes};
        }
        // A cube of n voxels has 6 n^(2/3) faces with about four triangles each; joints double
        // that.
        const double triangles = 50 * std::pow(std::max(1.0, outline.lava_voxels), 2.0 / 3);
        return {outline.lava_voxels, mesh_memory(triangles), triangles * 38};
    }

    Json run(Scene& scene, const StageContext& context) override
    {
        if (!params_.file.empty()) {
            const std::filesystem::path file = resolve(context, params_.file);
            MeshReadReport report;
            TriMesh mesh = read_mesh(file, &report);
            log_mesh_report(file, report);
            tell_of_textures(file, report);
            raise_up(mesh, params_.up);
            for (Vec3f& v : mesh.vertices) v = Vec3f(Vec3d(v) * params_.scale);
            Json summary = summary_of(mesh);
            scene.meshes["rock"] = std::move(mesh);
            return summary;
        }
        TriMesh mesh =
            surface_of(scene, params_.grid, params_.iso, context.memory_limit, context.progress);
        Json summary = summary_of(mesh);
        scene.meshes["rock"] = std::move(mesh);
        return summary;
    }

private:
    static Json summary_of(const TriMesh& mesh)
    {
        return {{"vertices", mesh.vertices.size()},
                {"triangles", mesh.triangles.size()},
                {"volume_m3", std::abs(mesh.signed_volume())},
                {"area_m2", mesh.area()}};
    }

    MeshParams params_;
};

}  // namespace

TriMesh surface_of(const Scene& scene, const std::string& grid, const std::optional<double>& level,
                   double memory_limit, const Progress& progress)
{
    const FloatGrid& field = scene.floats(grid);
    check_memory("mesh", mesh_memory(kTrianglesPerLeaf * double(field.dense_leaf_count())),
                 memory_limit);
    const bool level_set = scene.grids.at(grid).grid_class == GridClass::LevelSet;
    const double iso = level ? *level : level_set ? 0 : 0.5 * largest(field);
    TriMesh mesh = marching_tetrahedra(field, iso, progress.slice(0, 0.8));
    if (level_set)  // inside is negative there: turn the surface to face out
        for (auto& t : mesh.triangles) std::swap(t[1], t[2]);
    if (mesh.triangles.empty())
        throw InvalidInput(
            fmt::format("mesh: the grid '{}' nowhere crosses iso = {}; nothing is left of the rock",
                        grid, iso));
    if (scene.has("column") && scene.has("component") && scene.has("surface") && grid == "density")
        add_surface_attributes(
            mesh,
            SurfaceGrids{field, iso, scene.ints("column"), scene.ints("component"),
                         scene.ints("surface"), nullptr, nullptr},
            progress.slice(0.8, 1));
    if (grid == "surface_sdf" && scene.has("geology"))
        mark_soil(mesh, field.transform(), scene.ints("geology"));
    return mesh;
}

std::unique_ptr<Stage> make_mesh()
{
    return std::make_unique<MeshStage>();
}

}  // namespace sekitei::apps
