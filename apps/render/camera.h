#pragma once

#include "apps/render/render.h"

namespace sekitei::render {

/// A pinhole with a level horizon. Picture coordinates run from (-1, -1) lower left to (1, 1).
struct Camera {
    Vec3d eye, forward, right, up;
    double tan_x = 1, tan_y = 1;  ///< half openings

    Vec3f direction(double x, double y) const
    {
        return Vec3f(normalized(forward + right * (x * tan_x) + up * (y * tan_y)));
    }
    /// Picture coordinates of a point in front; z is its depth along `forward`.
    Vec3d project(Vec3d p) const
    {
        const Vec3d d = p - eye;
        const double depth = dot(d, forward);
        return {dot(d, right) / (depth * tan_x), dot(d, up) / (depth * tan_y), depth};
    }
};

/// The camera the parameters ask for. Where `eye` is not given it stands in the direction of
/// view_azimuth and view_elevation, as near as all corners of the bounds are inside the picture
/// with a margin, divided by `zoom`.
/// @throws InvalidParameter  eye and target coincide
Camera make_camera(const Params& params, const Bounds& bounds);

}  // namespace sekitei::render
