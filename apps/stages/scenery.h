#pragma once

#include <optional>
#include <string>
#include <vector>

#include "core/mesh.h"
#include "grids/scene.h"

/// What a scene holds besides its rock, as meshes: for light and for pictures.
namespace sekitei::apps {

/// Names of the grids and points below.
std::vector<std::string> scenery_uses();

/// `obstacle_sdf`: fences, trunks. Empty where there are none, like the others.
TriMesh obstacle_mesh(const Scene& scene);
/// `leaves`: a square for each point, of half edge `pscale` across `N`; where they have `orient`,
/// pointed leaves of the same area.
/// @throws InvalidInput  attributes that are missing
TriMesh leaf_mesh(const Scene& scene);
/// A kind of tree that the points `leaves` are of.
struct LeafKind {
    std::string species;  ///< its name; empty where it is not known
    bool needles = false;
};
/// By number; a leaf of none of them is of the last.
std::vector<LeafKind> leaf_kinds(const Scene& scene);
/// Leaves of one kind of tree.
struct Crown : LeafKind {
    TriMesh leaves;
};
/// The same, one mesh for each species.
/// @param scale  by which pointed leaves are drawn larger
std::vector<Crown> crowns(const Scene& scene, double scale = 1);
/// Half width of a kind's leaves by their length.
double leaf_slenderness(const std::string& species, bool needles);
/// Adds a pointed leaf, creased and bent back, of four triangles.
/// @param at      its middle [m]
/// @param orient  quaternion x y z w: +y along the leaf, +z its upper side
/// @param area    [m^2]
void add_leaf(TriMesh& mesh, Vec3d at, const std::array<float, 4>& orient, double area,
              double slenderness);
/// Diameter of a moss plant of size 1 that closes a mat on the scene's rock [m]; none where the
/// scene does not tell.
std::optional<double> moss_size(const Scene& scene);
/// `tree_skeleton` as tubes of bark.
TriMesh bark_mesh(const Scene& scene, const Progress& progress);
/// `water_surface`: the upper faces of its voxels, at least 1 cm over the ground so that a level
/// ground plane does not cover them.
TriMesh water_mesh(const Scene& scene, double ground);

/// The grid that a field's name means: plain words for the short names of soil grids.
std::string grid_of_field(const std::string& field);

/// "; did you mean 'soil_humidity'?" for a field that nothing is called; empty where nothing is
/// near.
std::string nearest_field(const std::string& field);

/// Values of a grid at the vertices: the mean of the active voxels around each, nearer ones
/// counting more; of whole numbers the nearest; NaN without one near.
/// @throws InvalidInput  not a grid of numbers
std::vector<float> field_at_vertices(const TriMesh& mesh, const Grid& grid,
                                     const std::string& name);

/// The mesh with a vertex attribute `shown`: the mean of the surface cells around each vertex,
/// nearer ones counting more; of whole numbers the nearest. Vertices without a cell near get NaN.
/// @throws InvalidInput  not a grid of numbers
TriMesh with_field(const TriMesh& mesh, const Scene& scene, const std::string& grid,
                   const std::string& shown);

}  // namespace sekitei::apps
