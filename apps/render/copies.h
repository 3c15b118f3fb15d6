#pragma once

#include <algorithm>

#include "solvers/rays/embree.h"

/// What rays meet of meshes that are stored once and stand in many places. A copy has world(point)
/// and turned(normal); a shape has vertices, normals and triangles. Whoever includes this links
/// `embree`.
namespace sekitei::render {

/// Distance and weights of a hit in double [Moeller1997]; Embree's distance for a ray within the
/// plane. Embree says which triangle it is.
template <class Hit, class Copy, class Shape>
void refine(Hit& hit, const Copy& copy, const Shape& shape, Vec3f origin, Vec3f direction,
            float embree_distance)
{
    const auto& t = shape.triangles[hit.triangle];
    const Vec3d a(copy.world(shape.vertices[t[0]]));
    const Vec3d e1 = Vec3d(copy.world(shape.vertices[t[1]])) - a,
                e2 = Vec3d(copy.world(shape.vertices[t[2]])) - a, d(direction);
    const Vec3d h = cross(d, e2), s = Vec3d(origin) - a, q = cross(s, e1);
    const double det = dot(e1, h);
    if (det == 0) {
        hit.distance = static_cast<double>(embree_distance);
        hit.u = hit.v = 1.0f / 3;
        return;
    }
    const double u = std::clamp(dot(s, h) / det, 0.0, 1.0);
    hit.u = static_cast<float>(u);
    hit.v = static_cast<float>(std::clamp(dot(d, q) / det, 0.0, 1.0 - u));
    hit.distance = std::max(0.0, dot(e2, q) / det);
}

/// Position, geometric normal (unit, as wound) and soft normal of a hit, in the world.
template <class Hit, class Copy, class Shape>
void place_hit(const Hit& hit, const Copy& copy, const Shape& shape, Vec3f& position,
               Vec3f& geometric, Vec3f& soft)
{
    const auto& t = shape.triangles[hit.triangle];
    const Vec3f a = copy.world(shape.vertices[t[0]]), e1 = copy.world(shape.vertices[t[1]]) - a,
                e2 = copy.world(shape.vertices[t[2]]) - a;
    position = a + e1 * hit.u + e2 * hit.v;
    geometric = normalized(cross(e1, e2));
    soft = copy.turned(shape.normals[t[0]] * (1 - hit.u - hit.v) + shape.normals[t[1]] * hit.u +
                       shape.normals[t[2]] * hit.v);
}

}  // namespace sekitei::render
