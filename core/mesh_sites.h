#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/mesh.h"
#include "core/progress.h"
#include "core/vec.h"

namespace sekitei {

/// The faces of a finely divided mesh: pieces of surface small enough to have one climate each.
///
/// Structure of arrays; site i is triangle i of `mesh`. A function of the mesh alone.
struct MeshSites {
    TriMesh mesh;                     ///< the divided mesh, without attributes
    std::vector<std::uint32_t> face;  ///< of the original mesh, in which each site lies
    std::vector<Vec3f> position;      ///< centroids [m]
    std::vector<Vec3f> normal;        ///< unit, outwards
    std::vector<float> area;          ///< [m^2]
    /// Sites that share an edge or a vertex with site i, ascending, itself left out:
    /// neighbour[neighbour_begin[i] .. neighbour_begin[i + 1]).
    std::vector<std::uint32_t> neighbour_begin, neighbour;

    std::size_t size() const { return position.size(); }
};

/// Halves every edge that is longer than `longest_edge`, at its midpoint and once for both of its
/// triangles, until none is: the surface stays exactly what it was, up to the rounding of the new
/// vertices to floats. Normals are those of the faces; areas are their halves and quarters.
///
/// Vertices at one place become one, whatever attributes told them apart, so that sites are
/// neighbours across creases and seams, and where solids touch edge to edge. Triangles below
/// 1e-12 m^2 are left out and counted in the log; a closed mesh that is inside out is warned of.
/// At an edge where several sheets meet they may run any way.
/// @throws InvalidInput      no triangles; vertices that are not finite, or neighbours that are
///                           wound against each other, with the first ten
/// @throws InvalidParameter  longest_edge <= 0, or too short for float coordinates
/// @throws LimitExceeded     2^31 sites or more: estimated before anything is allocated
///
/// Bit-identical for any number of threads; about 110 bytes a site.
MeshSites mesh_sites(const TriMesh& mesh, double longest_edge, const Progress& progress);

/// Sites as points: what a sum over the area around a place needs where sites are long beside it.
struct SitePieces {
    std::vector<Vec3f> position;      ///< centroids [m]
    std::vector<std::uint32_t> site;  ///< each is part of
    std::vector<float> area;          ///< [m^2]
};

/// Cuts each triangle into k^2 equal ones, none with an edge longer than `longest`, k at most 32.
/// @param area  of each triangle [m^2]
/// @throws InvalidInput  as many areas as triangles are expected
SitePieces cut_sites(const TriMesh& mesh, std::span<const float> area, double longest);

}  // namespace sekitei
