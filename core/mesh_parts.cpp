#include "core/mesh_parts.h"

#include <fmt/format.h>

#include <limits>
#include <vector>

#include "core/error.h"

namespace sekitei {

TriMesh part_of(const TriMesh& mesh, std::span<const std::uint8_t> kept)
{
    if (kept.size() != mesh.triangles.size())
        throw InvalidInput(fmt::format("part of a mesh: {} numbers for {} triangles", kept.size(),
                                       mesh.triangles.size()));
    constexpr std::uint32_t kNone = std::numeric_limits<std::uint32_t>::max();
    TriMesh part;
    std::vector<std::uint32_t> number(mesh.vertices.size(), kNone), vertex, face;
    for (std::size_t f = 0; f < kept.size(); ++f) {
        if (!kept[f]) continue;
        auto t = mesh.triangles[f];
        for (std::uint32_t& v : t) {
            if (number[v] == kNone) {
                number[v] = static_cast<std::uint32_t>(vertex.size());
                vertex.push_back(v);
                part.vertices.push_back(mesh.vertices[v]);
            }
            v = number[v];
        }
        part.triangles.push_back(t);
        face.push_back(static_cast<std::uint32_t>(f));
    }
    auto take = [&](const auto& from, std::size_t count, const std::vector<std::uint32_t>& rows,
                    auto& to) {
        for (const auto& [name, values] : from)
            std::visit(
                [&, attribute = &name](const auto& list) {
                    if (list.size() != count)
                        throw InvalidInput(
                            fmt::format("part of a mesh: attribute {} has {} values, must have {}",
                                        *attribute, list.size(), count));
                    std::decay_t<decltype(list)> some;
                    some.reserve(rows.size());
                    for (const std::uint32_t row : rows) some.push_back(list[row]);
                    to[*attribute] = std::move(some);
                },
                values);
    };
    take(mesh.vertex_attributes, mesh.vertices.size(), vertex, part.vertex_attributes);
    take(mesh.face_attributes, mesh.triangles.size(), face, part.face_attributes);
    return part;
}

}  // namespace sekitei
