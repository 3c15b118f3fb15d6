#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "core/noise.h"
#include "grids/nearest_polyline.h"
#include "solvers/weathering/weathering.h"

/// The pieces of columns: where lines are cut, which voxel belongs to which piece, what falls.
namespace sekitei::weathering {

inline constexpr std::int32_t kLavaRegion = 0, kColdRegion = 1, kSlowRegion = 2;

/// All pieces of all lines in flat arrays. Cut k of a line separates its pieces k and k + 1.
struct Pieces {
    bool horizontal = false;            ///< cuts are level planes instead of arc positions
    std::vector<std::uint32_t> first;   ///< first piece of each line; one longer than the lines
    std::vector<double> arc;            ///< of each cut, ascending within a line [voxels]
    std::vector<double> height;         ///< of each level cut [voxels]
    std::vector<double> direction;      ///< sign of dz of the line at each level cut
    std::vector<std::uint8_t> present;  ///< one a piece

    std::size_t count() const { return present.size(); }
    std::size_t first_cut(std::size_t line) const { return first[line] - line; }

    /// The piece that a voxel at height z belongs to, whose nearest point on the line lies at
    /// `arc`.
    std::uint32_t at(std::size_t line, double arc, double z) const;

    /// Distance from there to the nearest piece of the line with present == wanted: 0 if `piece`
    /// is one, infinity if there is none within `reach` [voxels].
    double gap(std::size_t line, std::uint32_t piece, double arc, double z, bool wanted,
               double reach) const;
};

/// The heights at which rock ends in horizontal mode.
class Terrain {
public:
    Terrain(const Inputs& inputs, const Params& params, std::uint64_t seed);

    /// Above the terrain [voxels]: positive where rock is removed.
    double above(Vec3d p) const;
    /// The same for a voxel of the box or one beside it.
    double above(Coord c) const;
    /// The same as a distance.
    double distance_above(Coord c) const;

private:
    static constexpr int kBorder = 2;  ///< voxels of `levels_` around the box
    std::size_t cell(int x, int y) const
    {
        return static_cast<std::size_t>(x + kBorder) *
                   static_cast<std::size_t>(domain_.dims.y + 2 * kBorder) +
               static_cast<std::size_t>(y + kBorder);
    }
    double level(double x, double y) const;  ///< of the fractal terrain [voxels]

    const FloatGrid* level_set_;
    Domain domain_;
    double base_, slope_x_, slope_y_, amplitude_;
    FractalNoise noise_;
    std::vector<double> levels_;  ///< at voxel centres
};

/// Nearest points on chosen lines, from the candidates of a block. One per thread.
class NearLines {
public:
    NearLines(const PolylineIndex& index, const Polylines& lines, const std::vector<double>& arcs)
        : index_(index), lines_(lines), arcs_(arcs)
    {
    }

    /// Prepares for points within rho of centre and lines that own voxels there.
    void enter(Vec3d centre, double rho);
    /// Nearest point of one line.
    NearestPoint nearest(std::int32_t line, Vec3d p);
    /// Arc lengths of the nearest points of a line for the 512 voxels of a leaf.
    void arcs(std::int32_t line, Coord origin, double* arc);

private:
    struct Part {
        const double *ax, *ay, *az, *dx, *dy, *dz, *inverse, *arc0, *length;
        std::size_t count;
    };
    Part part(std::int32_t line);

    const PolylineIndex& index_;
    const Polylines& lines_;
    const std::vector<double>& arcs_;
    PolylineIndex::Candidates candidates_;
    std::vector<std::size_t> begin_;
    PolylineIndex::Candidates whole_;  // all of one line that the block's candidates lack
};

/// Mean W of each component of a walk.
std::vector<double> piece_means(const std::vector<double>& w, const std::vector<int>& component);

/// What cutting yields besides the pieces.
struct CutResult {
    Pieces pieces;
    std::vector<std::uint8_t> weak;  ///< one a piece: mean W above the holding limit
    FloatGrid weathering;            ///< W on voxels crossed by a line; perpendicular mode only
};
CutResult cut_columns(const Inputs& inputs, const Params& params, std::uint64_t seed,
                      const Terrain* terrain, const Progress& progress);

/// The piece of every lava voxel.
/// @throws InvalidInput  a lava voxel whose column has no line
IntGrid component_grid(const Inputs& inputs, const Pieces& pieces, const PolylineIndex& index,
                       const std::vector<double>& arcs, const Progress& progress);

/// Which weak pieces fall: those that touch air, and those that touch a piece that falls. The fixed
/// point is the union of all connected groups of weak pieces with a member in the air, so the order
/// in which contacts are told does not matter.
class Falling {
public:
    explicit Falling(std::size_t pieces);
    void touch(std::uint32_t a, std::uint32_t b);  ///< two weak pieces share a face
    void expose(std::uint32_t a);                  ///< a weak piece has a face on air
    bool falls(std::uint32_t a);

private:
    std::uint32_t group(std::uint32_t a);
    std::vector<std::uint32_t> parent_;
    std::vector<std::uint8_t> exposed_;
};

/// Marks what falls in pieces.present. Columns removed beforehand count as air.
void collapse(const Inputs& inputs, const Params& params, const IntGrid& component,
              const std::vector<std::uint8_t>& weak, Pieces& pieces, const Progress& progress);

/// The wall that open_face names: 2 * axis + (1 for the upper side), or -1.
int open_wall(const Params& params);

}  // namespace sekitei::weathering
