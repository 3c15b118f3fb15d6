#include "apps/render/corner_normals.h"

#include <cmath>

#include "core/math.h"
#include "core/parallel.h"

namespace sekitei::render {
namespace {

/// The triangles around each vertex, in order.
struct Around {
    std::vector<std::uint32_t> begin, corner;  // corner = 3 triangle + k

    Around(const TriMesh& mesh, const Progress& progress)
        : begin(mesh.vertices.size() + 1), corner(mesh.triangles.size() * 3)
    {
        for (const auto& t : mesh.triangles) {
            progress.check();
            for (const std::uint32_t v : t) ++begin[v + 1];
        }
        for (std::size_t i = 1; i < begin.size(); ++i) begin[i] += begin[i - 1];
        std::vector<std::uint32_t> next(begin.begin(), begin.end() - 1);
        for (std::size_t i = 0; i < mesh.triangles.size(); ++i) {
            progress.check();
            for (std::uint32_t k = 0; k < 3; ++k)
                corner[next[mesh.triangles[i][k]]++] = static_cast<std::uint32_t>(3 * i) + k;
        }
    }
};

}  // namespace

std::vector<Vec3f> corner_normals(const TriMesh& mesh, double crease, const Progress& progress)
{
    const std::size_t count = mesh.triangles.size();
    const Around around(mesh, progress);
    const auto limit = static_cast<float>(math::cos(crease));
    constexpr std::size_t kGrain = 4096;

    // Normals times twice the area.
    std::vector<Vec3f> area(count), face(count);
    parallel_for(
        count,
        [&](std::size_t i) {
            progress.check();
            const auto& t = mesh.triangles[i];
            const Vec3d a(mesh.vertices[t[0]]), b(mesh.vertices[t[1]]), c(mesh.vertices[t[2]]);
            area[i] = Vec3f(cross(b - a, c - a));
            face[i] = normalized(area[i]);
        },
        kGrain);

    // Even out the directions: each triangle takes the mean of its neighbourhood on its side of the
    // creases. A large triangle outweighs slivers; a sliver is outweighed.
    for (int pass = 0; pass < 2; ++pass) {
        std::vector<Vec3f> smooth(count);
        parallel_for(
            count,
            [&](std::size_t i) {
                progress.check();
                const Vec3f own = face[i];
                Vec3f sum = area[i];
                for (const std::uint32_t v : mesh.triangles[i])
                    for (std::uint32_t c = around.begin[v]; c < around.begin[v + 1]; ++c) {
                        const std::size_t j = around.corner[c] / 3;
                        const float alike = dot(own, face[j]) - limit;
                        if (alike > 0) sum += face[j] * (length(area[j]) * alike);
                    }
                const float l = length(sum);
                smooth[i] = l > 0 ? sum / l : own;
            },
            kGrain);
        face.swap(smooth);
    }

    std::vector<Vec3f> normals(count * 3);
    parallel_for(
        count,
        [&](std::size_t i) {
            progress.check();
            for (std::size_t k = 0; k < 3; ++k) {
                const std::uint32_t v = mesh.triangles[i][k];
                Vec3f sum{};
                for (std::uint32_t c = around.begin[v]; c < around.begin[v + 1]; ++c) {
                    const std::size_t j = around.corner[c] / 3;
                    if (dot(face[i], face[j]) > limit) sum += face[j] * length(area[j]);
                }
                const float l = length(sum);
                normals[3 * i + k] = l > 0 ? sum / l : face[i];
            }
        },
        kGrain);
    return normals;
}

}  // namespace sekitei::render
