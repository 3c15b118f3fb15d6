#pragma once

#if __has_include(<embree3/rtcore.h>)
#include <embree3/rtcore.h>
#else
#include <embree4/rtcore.h>
#endif

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <string>
#include <vector>

#include "core/error.h"
#include "core/progress.h"
#include "core/vec.h"

/// Rays against triangles, by Embree; the difference between its versions 3 and 4 is hidden here.
/// Whoever includes this links `embree`.
namespace sekitei::rays {

/// A ray from `origin` at distances [near, far], in lengths of `direction`.
inline RTCRay ray_of(Vec3f origin, Vec3f direction, float near, float far)
{
    RTCRay ray;
    ray.org_x = origin.x;
    ray.org_y = origin.y;
    ray.org_z = origin.z;
    ray.dir_x = direction.x;
    ray.dir_y = direction.y;
    ray.dir_z = direction.z;
    ray.tnear = near;
    ray.tfar = far;
    ray.time = 0;
    ray.mask = 0xFFFFFFFFu;
    ray.id = 0;
    ray.flags = 0;
    return ray;
}

/// What Embree hands on from a question to the functions of user geometry; derive from it to have
/// them write answers.
#if RTC_VERSION_MAJOR >= 4
struct QueryContext : RTCRayQueryContext {
    QueryContext() { rtcInitRayQueryContext(this); }
};
#else
struct QueryContext : RTCIntersectContext {
    QueryContext() { rtcInitIntersectContext(this); }
};
#endif

/// What the ray meets first; false where that is nothing.
inline bool first_hit(RTCScene scene, const RTCRay& ray, RTCRayHit& query, QueryContext& context)
{
    query.ray = ray;
    query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    query.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
#if RTC_VERSION_MAJOR >= 4
    RTCIntersectArguments arguments;
    rtcInitIntersectArguments(&arguments);
    arguments.context = &context;
    rtcIntersect1(scene, &query, &arguments);
#else
    rtcIntersect1(scene, &context, &query);
#endif
    return query.hit.geomID != RTC_INVALID_GEOMETRY_ID;
}
inline bool first_hit(RTCScene scene, const RTCRay& ray, RTCRayHit& query)
{
    QueryContext context;
    return first_hit(scene, ray, query, context);
}

/// first_hit() of up to eight rays at once; those whose `valid` is 0 are left alone. What is met at
/// the very edge of two triangles may be the other one of them.
inline void first_hits(RTCScene scene, const int* valid, RTCRayHit8& query)
{
#if RTC_VERSION_MAJOR >= 4
    rtcIntersect8(valid, scene, &query, nullptr);
#else
    QueryContext context;
    rtcIntersect8(valid, scene, &context, &query);
#endif
}

/// Calls f(primitive) for whatever may lie within `radius` of a place, and for some that lie a
/// little farther; f returns the radius that still matters, which only shrinks.
template <class F>
void near(RTCScene scene, Vec3d at, double radius, F&& f)
{
    struct Call {
        F& f;
        double slack;  // what rounding to float may move a place
    } call{f, 1e-6 * std::max({std::abs(at.x), std::abs(at.y), std::abs(at.z)})};
    RTCPointQuery query;
    query.x = static_cast<float>(at.x);
    query.y = static_cast<float>(at.y);
    query.z = static_cast<float>(at.z);
    query.time = 0;
    query.radius = static_cast<float>(radius * (1 + 1e-5) + call.slack);
    RTCPointQueryContext context;
    rtcInitPointQueryContext(&context);
    rtcPointQuery(
        scene, &query, &context,
        [](RTCPointQueryFunctionArguments* args) {
            const Call& c = *static_cast<const Call*>(args->userPtr);
            const auto left = static_cast<float>(c.f(args->primID) * (1 + 1e-5) + c.slack);
            if (!(left < args->query->radius)) return false;
            args->query->radius = left;
            return true;
        },
        &call);
}

/// Whether the ray meets anything.
inline bool any_hit(RTCScene scene, RTCRay ray)
{
#if RTC_VERSION_MAJOR >= 4
    rtcOccluded1(scene, &ray, nullptr);
#else
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcOccluded1(scene, &context, &ray);
#endif
    return ray.tfar < 0;
}

struct Hit {
    std::uint32_t triangle = 0;
    double distance = 0;  ///< in lengths of the ray's direction
    float u = 0, v = 0;   ///< weights of the triangle's second and third corner
};

/// Triangles that rays can be asked against, from any number of threads.
///
/// Embree picks its code by processor and may round differently on another one. It therefore only
/// says which triangle is met; distance and weights are computed again here, in double, from the
/// ray and the corners.
class TriangleScene {
public:
    using Triangle = std::array<std::uint32_t, 3>;

    /// Copies what it needs; `vertices` and `triangles` must outlive the scene all the same, since
    /// hits are refined on them.
    /// @throws InvalidInput  no triangle, a vertex that is NaN, infinite or beyond 1e15 m (Embree
    ///                       would drop its triangles without a word), an index out of range
    /// @throws Cancelled  from `progress`, which need not live on
    TriangleScene(const std::vector<Vec3f>& vertices, const std::vector<Triangle>& triangles,
                  const std::string& who, const Progress& progress = {},
                  RTCBuildQuality quality = RTC_BUILD_QUALITY_MEDIUM)
        : vertices_(vertices), triangles_(triangles)
    {
        if (triangles.empty()) throw InvalidInput(who + ": the mesh has no triangles");
        for (std::size_t i = 0; i < vertices.size(); ++i) {
            const Vec3f p = vertices[i];
            const float most = std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)});
            if (!(std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z) && most < 1e15f))
                throw InvalidInput(fmt_vertex(who, i, p));
        }
        for (std::size_t i = 0; i < triangles.size(); ++i)
            for (const std::uint32_t v : triangles[i])
                if (v >= vertices.size())
                    throw InvalidInput(who + ": triangle " + std::to_string(i) + " names vertex " +
                                       std::to_string(v) + ", but the mesh has " +
                                       std::to_string(vertices.size()));
        device_ = rtcNewDevice(nullptr);
        if (!device_) throw LimitExceeded(who + ": Embree could not start");
        rtcSetDeviceMemoryMonitorFunction(device_, &TriangleScene::monitor, &bytes_);
        scene_ = rtcNewScene(device_);
        rtcSetSceneProgressMonitorFunction(
            scene_,
            [](void* wish, double) { return !static_cast<const Progress*>(wish)->cancelled(); },
            const_cast<Progress*>(&progress));
        rtcSetSceneBuildQuality(scene_, quality);
        rtcSetSceneFlags(scene_, RTC_SCENE_FLAG_ROBUST);
        RTCGeometry geometry = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
        void* points = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0,
                                               RTC_FORMAT_FLOAT3, sizeof(Vec3f), vertices.size());
        void* corners =
            rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                    sizeof(Triangle), triangles.size());
        if (points && corners) {
            std::memcpy(points, vertices.data(), vertices.size() * sizeof(Vec3f));
            std::memcpy(corners, triangles.data(), triangles.size() * sizeof(Triangle));
            rtcCommitGeometry(geometry);
            rtcAttachGeometry(scene_, geometry);
            rtcCommitScene(scene_);
        }
        rtcReleaseGeometry(geometry);
        rtcSetSceneProgressMonitorFunction(scene_, nullptr, nullptr);
        if (progress.cancelled()) {
            release();
            throw Cancelled();
        }
        const RTCError error = rtcGetDeviceError(device_);
        if (!points || !corners || error != RTC_ERROR_NONE) {
            release();
            throw LimitExceeded(who + ": no memory for the rays of " +
                                count_text(static_cast<double>(triangles.size())) + " triangles");
        }
    }
    ~TriangleScene() { release(); }
    TriangleScene(const TriangleScene&) = delete;
    TriangleScene& operator=(const TriangleScene&) = delete;

    /// The nearest triangle met at a distance in [near, far].
    bool intersect(Vec3f origin, Vec3f direction, float near, float far, Hit& hit) const
    {
        RTCRayHit query;
        if (!first_hit(scene_, ray_of(origin, direction, near, far), query)) return false;
        hit.triangle = query.hit.primID;
        refine(origin, direction, query.ray.tfar, hit);
        return true;
    }

    /// The same without distance and weights, for whoever works them out in another way.
    bool intersect(Vec3f origin, Vec3f direction, float near, float far,
                   std::uint32_t& triangle) const
    {
        RTCRayHit query;
        if (!first_hit(scene_, ray_of(origin, direction, near, far), query)) return false;
        triangle = query.hit.primID;
        return true;
    }

    /// rays::first_hits() of the triangles.
    void intersect(const int* valid, RTCRayHit8& query) const { first_hits(scene_, valid, query); }

    /// Whether anything is met at a distance in [near, far].
    bool occluded(Vec3f origin, Vec3f direction, float near, float far) const
    {
        return any_hit(scene_, ray_of(origin, direction, near, far));
    }

    /// rays::near() of the triangles.
    template <class F>
    void near(Vec3d at, double radius, F&& f) const
    {
        rays::near(scene_, at, radius, f);
    }

    /// Memory that Embree holds now.
    std::size_t memory_bytes() const
    {
        return static_cast<std::size_t>(std::max<std::int64_t>(0, bytes_.load()));
    }

private:
    static bool monitor(void* total, ssize_t bytes, bool)
    {
        static_cast<std::atomic<std::int64_t>*>(total)->fetch_add(bytes);
        return true;
    }
    static std::string fmt_vertex(const std::string& who, std::size_t i, Vec3f p)
    {
        return who + ": vertex " + std::to_string(i) + " is (" + std::to_string(p.x) + ", " +
               std::to_string(p.y) + ", " + std::to_string(p.z) +
               "), must be finite and within 1e15 m";
    }

    /// Distance and weights in double [Moeller1997]; Embree's distance for a ray within the plane.
    void refine(Vec3f origin, Vec3f direction, float fallback, Hit& hit) const
    {
        const Triangle& t = triangles_[hit.triangle];
        const Vec3d a(vertices_[t[0]]), e1 = Vec3d(vertices_[t[1]]) - a,
                                        e2 = Vec3d(vertices_[t[2]]) - a, d(direction);
        const Vec3d p = cross(d, e2), s = Vec3d(origin) - a, q = cross(s, e1);
        const double det = dot(e1, p);
        if (det == 0) {
            hit.distance = fallback;
            hit.u = hit.v = 1.0f / 3;
            return;
        }
        const double u = std::clamp(dot(s, p) / det, 0.0, 1.0);
        hit.u = static_cast<float>(u);
        hit.v = static_cast<float>(std::clamp(dot(d, q) / det, 0.0, 1.0 - u));
        hit.distance = dot(e2, q) / det;
    }
    void release()
    {
        if (scene_) rtcReleaseScene(scene_);
        if (device_) rtcReleaseDevice(device_);
        scene_ = nullptr;
        device_ = nullptr;
    }

    const std::vector<Vec3f>& vertices_;
    const std::vector<Triangle>& triangles_;
    std::atomic<std::int64_t> bytes_{0};
    RTCDevice device_ = nullptr;
    RTCScene scene_ = nullptr;
};

}  // namespace sekitei::rays
