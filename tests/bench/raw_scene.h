#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <span>

#include "core/mesh.h"
#include "core/vec.h"
#include "solvers/rays/embree.h"

namespace sekitei::bench {

/// Embree's scene of a mesh and balls, as its manual builds one: the peer of our tracers.
struct RawScene {
    RTCDevice device = rtcNewDevice(nullptr);
    RTCScene scene = rtcNewScene(device);

    explicit RawScene(const TriMesh& mesh, std::span<const Sphere> balls = {},
                      RTCBuildQuality quality = RTC_BUILD_QUALITY_MEDIUM)
    {
        RTCGeometry g = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
        auto* points = static_cast<Vec3f*>(rtcSetNewGeometryBuffer(
            g, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, sizeof(Vec3f), mesh.vertices.size()));
        std::ranges::copy(mesh.vertices, points);
        auto* corners = static_cast<std::array<std::uint32_t, 3>*>(rtcSetNewGeometryBuffer(
            g, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, mesh.triangles.size()));
        std::ranges::copy(mesh.triangles, corners);
        attach(g);
        if (!balls.empty()) {
            g = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_SPHERE_POINT);
            auto* spheres = static_cast<Sphere*>(rtcSetNewGeometryBuffer(
                g, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT4, sizeof(Sphere), balls.size()));
            std::ranges::copy(balls, spheres);
            attach(g);
        }
        rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);
        rtcSetSceneBuildQuality(scene, quality);
        rtcCommitScene(scene);
    }
    ~RawScene()
    {
        rtcReleaseScene(scene);
        rtcReleaseDevice(device);
    }
    RawScene(const RawScene&) = delete;
    RawScene& operator=(const RawScene&) = delete;

private:
    void attach(RTCGeometry g)
    {
        rtcCommitGeometry(g);
        rtcAttachGeometry(scene, g);
        rtcReleaseGeometry(g);
    }
};

}  // namespace sekitei::bench
