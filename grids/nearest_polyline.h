#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "grids/polyline.h"

namespace sekitei {

/// The nearest point of a set of polylines.
struct NearestPoint {
    std::int32_t line = -1;
    double distance2 = 0;  ///< squared [voxels^2]
    double arc = 0;        ///< along the line from its first point [voxels]
    Vec3d point;           ///< [voxels]
};

/// Exact nearest polyline with pruning per block.
///
/// A segment j can own a point of the ball (c, rho) only if dist(c, j) <= d* + 2 rho, where d* is
/// the distance from c to the nearest segment (triangle inequality both ways). candidates()
/// collects those from an AABB tree; nearest() is brute force over them. Distances are to segments
/// (clamped projection) in double; on an exact tie the lower line, then the lower segment wins.
class PolylineIndex {
public:
    /// Copies what it needs. No lines: every query answers line -1 at infinite distance.
    explicit PolylineIndex(const Polylines& lines);
    ~PolylineIndex();
    PolylineIndex(PolylineIndex&&) noexcept;
    PolylineIndex& operator=(PolylineIndex&&) noexcept;

    /// Segments that can be nearest for some point of a ball, sorted by (line, segment), with what
    /// nearest() needs laid out for speed. Reuse one per thread.
    struct Candidates {
        std::vector<std::uint32_t> segments;  ///< global segment ids, ascending
        std::vector<std::int32_t> lines;      ///< distinct line ids, ascending
        // Structure of arrays, parallel to `segments`; the first seven go on to a multiple of 8
        // with segments where nothing is near.
        std::vector<double> ax, ay, az, dx, dy, dz, inverse_length2;
        std::vector<double> arc0, length;
        std::vector<std::int32_t> line;
    };
    void candidates(Vec3d centre, double rho, Candidates& out) const;

    /// Those of `from` that can be nearest for some point of the cube centre +- half, without those
    /// that one near segment beats in the whole cube. Linear in `from`, which must hold the
    /// candidates of a larger region, and be another object than `out`.
    static void narrow(const Candidates& from, Vec3d centre, double half, Candidates& out);

    /// Nearest over the candidates for the 512 voxel centres of the leaf at `origin`, in leaf
    /// order. Same line and arc as nearest(), several voxels at a time, for each octant of the leaf
    /// from the candidates that it cannot do without.
    /// @param line  512 line ids; -1 without candidates
    /// @param arc   512 arc lengths [voxels], or null
    static void nearest_in_leaf(Coord origin, const Candidates& candidates, std::int32_t* line,
                                double* arc);

    /// Nearest over the candidates.
    static NearestPoint nearest(Vec3d p, const Candidates& candidates);
    /// Nearest point of each candidate line (one entry per distinct line, in `lines` order).
    static void nearest_per_line(Vec3d p, const Candidates& candidates,
                                 std::vector<NearestPoint>& out);

    /// Nearest over everything, one tree query.
    NearestPoint nearest(Vec3d p) const;
    /// Nearest by looking at every segment: the oracle.
    NearestPoint nearest_brute_force(Vec3d p) const;

    std::size_t segment_count() const;

private:
    struct State;
    std::unique_ptr<State> state_;
};

}  // namespace sekitei
