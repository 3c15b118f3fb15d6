#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "core/image.h"
#include "core/mesh.h"
#include "core/params.h"
#include "core/progress.h"
#include "grids/scene.h"

/// Preview pictures: a path tracer for meshes and slices through volumes.
namespace sekitei::render {

struct Params {
    int width = 1280, height = 720;
    int samples = 64;  ///< paths a pixel
    int bounces = 4;
    double sun_azimuth = 125, sun_elevation = 22;  ///< [deg], azimuth clockwise from north (+y)
    double sun_size = 0.53;                        ///< apparent diameter [deg]
    double turbidity = 3;
    double exposure = 0;               ///< stops
    std::optional<Vec3d> eye, target;  ///< [m]; auto: from the bounds
    double view_azimuth = 215;  ///< [deg] where the automatic camera stands, seen from the target
    std::optional<double> view_elevation;  ///< [deg]; auto: 8
    double zoom = 1;                       ///< > 1: nearer
    double field_of_view = 35;             ///< vertical [deg]
    bool ground = true;                    ///< a ground plane
    std::optional<double> ground_height;   ///< [m]; auto: at the lowest point
    bool hills = true;                     ///< far ridges along the horizon
    std::optional<double> haze;  ///< distance that air veils to 1/e [m]; auto: 45 times the size
    bool denoise = true;
    std::string field;  ///< mesh attribute shown as colours with a colour bar; empty: rock

    static void describe(auto&& field_)
    {
        field_("width", &Params::width, "", between(16, 16384), "picture width in pixels");
        field_("height", &Params::height, "", between(16, 16384), "picture height in pixels");
        field_("samples", &Params::samples, "", between(1, 65536), "light paths a pixel");
        field_("bounces", &Params::bounces, "", between(0, 64), "longest light path");
        field_("sun_azimuth", &Params::sun_azimuth, "deg", kAny,
               "direction of the sun, clockwise from north (+y)");
        field_("sun_elevation", &Params::sun_elevation, "deg", between(-90, 90),
               "height of the sun above the horizon");
        field_("sun_size", &Params::sun_size, "deg", between(0, 20),
               "apparent diameter of the sun: softness of shadows");
        field_("turbidity", &Params::turbidity, "", between(1, 10), "haze of the sky");
        field_("exposure", &Params::exposure, "", between(-20, 20), "brighter or darker, in stops");
        field_("eye", &Params::eye, "m", kAny, "position of the camera");
        field_("target", &Params::target, "m", kAny, "point the camera looks at");
        field_("view_azimuth", &Params::view_azimuth, "deg", kAny,
               "where the automatic camera stands, clockwise from north, seen from the target");
        field_("view_elevation", &Params::view_elevation, "deg", between(-89, 89),
               "height of the automatic camera above the horizon; auto: 8, over a forest from its "
               "near border");
        field_("zoom", &Params::zoom, "", kPositive,
               "nearer (above 1) or farther than the automatic distance");
        field_("field_of_view", &Params::field_of_view, "deg", between(1, 150),
               "vertical opening of the camera");
        field_("ground", &Params::ground, "a ground plane");
        field_("ground_height", &Params::ground_height, "m", kAny,
               "height of the ground plane, which buries what lies below; auto: the lowest point");
        field_("hills", &Params::hills, "far ridges along the horizon");
        field_("haze", &Params::haze, "m", kPositive,
               "distance at which air hides two thirds of the light from a thing");
        field_("denoise", &Params::denoise, "smooth the noise that is left, keeping detail");
        field_("field", &Params::field, "mesh attribute to show as colours with a colour bar");
    }
};

void validate(const Params& params);

/// Renders `mesh` (attributes `column`, `component`, `surface` steer the rock's look).
/// Sun and sky light, diffuse and rough specular rock; the same bytes on any number of threads.
/// @throws InvalidInput  empty mesh, an attribute that is not there
Image8 run(const TriMesh& mesh, const Params& params, std::uint64_t seed, const Progress& progress);

/// What a mesh is made of.
enum class Substance {
    Rock,     ///< as in run() of one mesh
    Wood,     ///< weathered, grain along z
    Water,    ///< dark, smooth, mirrors the sky; the mesh need not be closed
    Foliage,  ///< matt leaves that let light through
    Bark,     ///< grey and brown, furrowed along what stands upright
    Floor     ///< of a forest: litter, herbs where the vertex attribute `light` (0..1) is large
};

/// Leaves differ between two colours; light that shines through is tinted.
struct LeafColours {
    Vec3f dark{0.060f, 0.105f, 0.028f}, bright{0.110f, 0.150f, 0.040f};
    Vec3f through{0.5f};  ///< share of the colour that is let through
};

struct Piece {
    const TriMesh* mesh = nullptr;  ///< must outlive the call
    Substance substance = Substance::Rock;
    LeafColours leaves{};  ///< of foliage
};

/// A moss plant.
struct Tuft {
    Vec3d position;                           ///< its foot, world [m]
    std::array<float, 4> orient{0, 0, 0, 1};  ///< x y z w; turns local +y along the plant
    float scale = 1;                          ///< of a full-grown plant; 0 is not drawn
    std::int32_t species = 1;                 ///< from 1, see Stuff::species
    float growth = 1.9f;     ///< shoots stand denser up to 2; from 2 on the plant bears capsules
    float wetness = 0.8f;    ///< 0 parched and pale .. 1 soaked, deep green and glossy
    std::int32_t age = 180;  ///< [d]; the young are bright, the old brown at their foot
    std::int64_t id = -1;    ///< tells plants apart from frame to frame; -1: the place in the list
};

/// Levels of detail of trees.
inline constexpr std::size_t kTreeLevels = 6;

/// A copy of a model of a tree.
struct StandingTree {
    Vec3d position;                           ///< its foot, world [m]
    std::array<float, 4> orient{0, 0, 0, 1};  ///< x y z w; +z stays up its trunk
    Vec3f scale{1};                           ///< of a model of height 1 [m]
    std::int32_t model = 0;                   ///< from 0
    std::int64_t id = -1;  ///< tells trees apart from frame to frame; -1: the place in the list
};

/// What stands for trees of one kind, form and age.
struct TreeModel {
    /// From the finest level on: of height 1, foot at the origin, bark and after it leaves of two
    /// triangles each; the face attribute `part` (int32) tells them apart, 0 and 1.
    std::array<TriMesh, kTreeLevels> mesh;
    std::vector<LeafColours> leaves{};  ///< each tree has those of one of them, by its id
    Vec3f bark{1.0f};                   ///< tint
};

/// A garden: meshes of several substances and what grows on them.
struct Stuff {
    std::vector<Piece> pieces;
    std::vector<Tuft> moss;
    double moss_size =
        0.03;  ///< diameter of a plant of scale 1 [m]; 1.6 surface cells closes a mat
    /// Names of species 1, 2, ...: each of these four looks its own way, others as plain cushions.
    /// Mats of hypnum are laid flat onto the mesh, wherever `orient` points.
    std::vector<std::string> species{"bryum", "hypnum", "polytrichum", "grimmia"};
    std::vector<StandingTree> trees;
    std::size_t models = 0;  ///< that `trees` are of
    /// Gives them, with the meshes of those levels at least that it is asked for: one byte a model,
    /// bit l set where level l is needed.
    std::function<std::vector<TreeModel>(const std::vector<std::uint8_t>& levels)> grow;
};

/// Plants of points with the attributes `orient` (four floats), `pscale` (float) and `species`
/// (int32) and, where there are such, `growth` and `wetness` (float), `age` (int32, days) and `id`
/// (int64). Without `growth` a plant is dense as its scale says, and never ripe.
/// @throws InvalidInput  an attribute is missing, of another type or of another length
std::vector<Tuft> tufts_of(const Points& moss);

/// Renders a garden. One piece of rock without moss gives the bytes of run() of its mesh. With
/// `field` the first piece alone is shown in colours.
/// @throws InvalidInput  no triangles, indices or plants out of range; InvalidParameter  moss_size
Image8 run(const Stuff& stuff, const Params& params, std::uint64_t seed, const Progress& progress);

/// Where a photon was stored.
struct PhotonDot {
    Vec3d position;           ///< world [m]
    Vec3f normal;             ///< of the surface, on the side it came from
    std::int32_t bounce = 0;  ///< reflections before
};

/// Photons of points with the attributes `N` (vector) and `bounce` (int32).
/// @throws InvalidInput  an attribute is missing, of another type or of another length
std::vector<PhotonDot> photons_of(const Points& photons);

/// Diameter of a dot where none is given: a 240th of the surface [m].
double photon_dot_size(const TriMesh& mesh);

/// A photon map: the surface, dark and in soft light, with a bright dot for each photon. First hits
/// are pale yellow, those after one reflection orange, later ones red; a legend says so.
/// @param size  diameter of a dot [m]
/// @throws InvalidInput  no triangles, a photon that is not finite; InvalidParameter  size
Image8 run(const TriMesh& mesh, const std::vector<PhotonDot>& photons, double size,
           const Params& params, std::uint64_t seed, const Progress& progress);

struct SliceParams {
    std::string grid;  ///< name of the grid to show
    std::string axis = "x";
    std::optional<double> at;         ///< position along the axis [m]; auto: the middle
    int width = 900;                  ///< of the picture, colour bar included
    std::optional<double> low, high;  ///< values of the bar's ends; auto: from the slice
};

/// A plane through a volume with a colour bar and units; ids (Int32) in distinct colours.
/// Vectors show their direction as colour.
/// @throws InvalidInput  no such grid; InvalidParameter  plane outside the grid
Image8 slice(const Scene& scene, const SliceParams& params);

}  // namespace sekitei::render
