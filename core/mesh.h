#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <string>
#include <variant>
#include <vector>

#include "core/vec.h"

namespace sekitei {

/// Triangles with named attributes. Counter-clockwise from outside; world space, metres.
struct TriMesh {
    using Attribute =
        std::variant<std::vector<float>, std::vector<std::int32_t>, std::vector<Vec3f>>;

    std::vector<Vec3f> vertices;
    std::vector<std::array<std::uint32_t, 3>> triangles;
    std::map<std::string, Attribute> vertex_attributes;  ///< one value a vertex
    std::map<std::string, Attribute> face_attributes;    ///< one value a triangle

    Bounds bounds() const;
    /// Enclosed volume by the divergence theorem [m^3]; negative if wound inside out. Ordered sum.
    double signed_volume() const;
    double area() const;  ///< [m^2]
};

/// Results of looking at every edge and triangle once.
struct MeshReport {
    std::size_t vertices = 0, triangles = 0;
    std::size_t open_edges = 0;          ///< used by one triangle
    std::size_t non_manifold_edges = 0;  ///< used by more than two
    std::size_t misoriented_edges = 0;   ///< used twice in the same direction
    std::size_t zero_area = 0;           ///< triangles without area or with a repeated vertex
    std::size_t isolated_vertices = 0;   ///< used by no triangle
    std::size_t bad_vertices = 0;        ///< NaN or infinite
    std::size_t pieces = 0;              ///< connected by shared edges
    std::int64_t euler = 0;              ///< V - E + F over used vertices
    double least_area = 0, volume = 0, area = 0;

    bool closed() const
    {
        return open_edges == 0 && non_manifold_edges == 0 && misoriented_edges == 0;
    }
    double genus() const { return static_cast<double>(pieces) - static_cast<double>(euler) / 2; }
};

/// @throws InvalidInput  a triangle names a vertex that does not exist
MeshReport inspect(const TriMesh& mesh);

double triangle_area(Vec3f a, Vec3f b, Vec3f c);  ///< [m^2], computed in double

}  // namespace sekitei
