#include "apps/render/camera.h"

#include <algorithm>
#include <cmath>

#include "core/error.h"
#include "core/math.h"

namespace sekitei::render {
namespace {

// Shares of the half picture that the object may fill: more air above than ground below.
constexpr double kSide = 0.90, kTop = 0.74, kBottom = 0.80;

constexpr double kLow = 8;  // [deg] of the automatic camera

void look_along(Camera& camera, Vec3d forward)
{
    camera.forward = normalized(forward);
    const Vec3d level{camera.forward.y, -camera.forward.x, 0};
    camera.right = length(level) > 1e-9 ? normalized(level) : Vec3d(1, 0, 0);
    camera.up = cross(camera.right, camera.forward);
}

}  // namespace

Camera make_camera(const Params& params, const Bounds& bounds)
{
    Camera camera;
    constexpr double kDegree = math::kPi / 180;
    const double half = params.field_of_view * kDegree / 2;
    camera.tan_y = math::sin(half) / math::cos(half);
    camera.tan_x = camera.tan_y * params.width / params.height;

    if (params.eye) {
        const Vec3d target = params.target.value_or(bounds.centre());
        if (!(length(target - *params.eye) > 0))
            throw InvalidParameter(
                "render: eye and target are the same point, must differ to give a direction");
        camera.eye = *params.eye;
        look_along(camera, target - *params.eye);
        return camera;
    }

    const double azimuth = params.view_azimuth * kDegree,
                 elevation = params.view_elevation.value_or(kLow) * kDegree;
    const Vec3d away{math::sin(azimuth) * math::cos(elevation),
                     math::cos(azimuth) * math::cos(elevation), math::sin(elevation)};
    look_along(camera, -away);

    // In camera axes a corner (x, y, z) is inside if |x - e_x| <= k (z - e_z), and alike for y: two
    // inequalities a side, whose extremes over the corners give the nearest eye.
    double left = -INFINITY, right = -INFINITY, low = -INFINITY, high = -INFINITY;
    const double kx = camera.tan_x * kSide, kt = camera.tan_y * kTop, kb = camera.tan_y * kBottom;
    double front = INFINITY;
    for (int corner = 0; corner < 8; ++corner) {
        const Vec3d p{corner & 1 ? bounds.upper.x : bounds.lower.x,
                      corner & 2 ? bounds.upper.y : bounds.lower.y,
                      corner & 4 ? bounds.upper.z : bounds.lower.z};
        const double x = dot(p, camera.right), y = dot(p, camera.up), z = dot(p, camera.forward);
        right = std::max(right, x - kx * z);
        left = std::max(left, -x - kx * z);
        high = std::max(high, y - kt * z);
        low = std::max(low, -y - kb * z);
        front = std::min(front, z);
    }
    const double size = std::max(length(bounds.size()), 1e-6);
    double ez = std::min(-(left + right) / (2 * kx), -(high + low) / (kt + kb));
    ez = std::min(ez, front - 0.05 * size);  // never inside
    const double ex = (right + kx * ez - (left + kx * ez)) / 2;
    const double ey = ((high + kt * ez) * kb - (low + kb * ez) * kt) / (kt + kb);
    Vec3d eye = camera.right * ex + camera.up * ey + camera.forward * ez;
    const Vec3d centre = eye + camera.forward * dot(bounds.centre() - eye, camera.forward);
    const Vec3d target = params.target.value_or(centre);
    eye = target + (eye - centre) / params.zoom;
    // Stay above the ground the object stands on.
    if (params.ground && elevation >= 0) eye.z = std::max(eye.z, bounds.lower.z + 0.02 * size);
    camera.eye = eye;
    return camera;
}

}  // namespace sekitei::render
