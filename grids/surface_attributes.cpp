#include "grids/surface_attributes.h"

#include <cmath>
#include <limits>
#include <vector>

#include "core/parallel.h"

namespace sekitei {
namespace {

/// Attribute values in the making, one a vertex or one a face.
struct Columns {
    std::vector<std::int32_t> column, component, surface;
    std::vector<float> arc, weathering;

    Columns(std::size_t count, const SurfaceGrids& grids)
        : column(count),
          component(count),
          surface(count),
          arc(grids.arc ? count : 0),
          weathering(grids.weathering ? count : 0)
    {
    }
    void store(std::map<std::string, TriMesh::Attribute>& attributes)
    {
        if (!arc.empty()) attributes["arc"] = std::move(arc);
        if (!weathering.empty()) attributes["weathering"] = std::move(weathering);
        attributes["column"] = std::move(column);
        attributes["component"] = std::move(component);
        attributes["surface"] = std::move(surface);
    }
};

/// Reads the grids for one thread.
class Sampler {
public:
    explicit Sampler(const SurfaceGrids& grids)
        : grids_(grids),
          density_(grids.density),
          column_(grids.column),
          component_(grids.component),
          surface_(grids.surface)
    {
    }

    void sample(Vec3d world, std::size_t i, Columns& out)
    {
        const Coord c = solid_side(grids_.density.transform().voxels(world));
        const std::int32_t column = column_.value(c);
        const bool massive = column < 0;
        out.column[i] = massive ? kMassiveRock : column;
        out.component[i] = massive ? kMassiveRock : component_.value(c);
        out.surface[i] = surface_.value(c);
        if (grids_.arc) out.arc[i] = grids_.arc->value(c);
        if (grids_.weathering) out.weathering[i] = grids_.weathering->value(c);
    }

private:
    /// The nearest solid voxel of the lattice cell around p; every cell that the surface crosses
    /// has one.
    Coord solid_side(Vec3d p)
    {
        const Vec3d u = p - Vec3d(0.5);
        const Coord base(static_cast<int>(std::floor(u.x)), static_cast<int>(std::floor(u.y)),
                         static_cast<int>(std::floor(u.z)));
        Coord best = base;
        double least = std::numeric_limits<double>::infinity();
        for (int k = 0; k < 8; ++k) {
            const Coord c = base + Coord(k >> 2, (k >> 1) & 1, k & 1);
            const Vec3d d = centre_of(c) - p;
            if (!(dot(d, d) < least) || !(density_.value(c) >= grids_.iso)) continue;
            least = dot(d, d);
            best = c;
        }
        return best;
    }

    const SurfaceGrids& grids_;
    GridReader<float> density_;
    GridReader<std::int32_t> column_, component_, surface_;
};

}  // namespace

void add_surface_attributes(TriMesh& mesh, const SurfaceGrids& grids, const Progress& progress)
{
    constexpr std::size_t kGrain = 4096;
    Columns vertices(mesh.vertices.size(), grids), faces(mesh.triangles.size(), grids);
    parallel_for_range(
        mesh.vertices.size(),
        [&](std::size_t begin, std::size_t end) {
            progress.check();
            Sampler sampler(grids);
            for (std::size_t i = begin; i != end; ++i)
                sampler.sample(Vec3d(mesh.vertices[i]), i, vertices);
        },
        kGrain);
    progress.update(0.4);
    parallel_for_range(
        mesh.triangles.size(),
        [&](std::size_t begin, std::size_t end) {
            progress.check();
            Sampler sampler(grids);
            for (std::size_t i = begin; i != end; ++i) {
                const auto& t = mesh.triangles[i];
                const Vec3d sum = Vec3d(mesh.vertices[t[0]]) + Vec3d(mesh.vertices[t[1]]) +
                                  Vec3d(mesh.vertices[t[2]]);
                sampler.sample(sum / 3.0, i, faces);
            }
        },
        kGrain);
    vertices.store(mesh.vertex_attributes);
    faces.store(mesh.face_attributes);
    progress.update(1);
}

}  // namespace sekitei
