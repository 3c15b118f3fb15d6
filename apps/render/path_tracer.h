#pragma once

#include <cmath>
#include <optional>
#include <vector>

#include "apps/render/camera.h"
#include "apps/render/look.h"
#include "apps/render/sky.h"
#include "core/progress.h"

namespace sekitei::rays {
class TriangleScene;
}

namespace sekitei::render {

class Tufts;
class Woods;

/// What is traced. Everything referred to must outlive the call.
struct World {
    const TriMesh& mesh;
    const rays::TriangleScene& rays;    ///< of the mesh
    const std::vector<Vec3f>& normals;  ///< corner_normals(mesh)
    const Look& look;
    const Sky& sky;
    Camera camera;
    std::optional<double> ground;   ///< height of a level plane without end [m]
    double haze = INFINITY;         ///< distance at which air hides all but 1/e of a thing [m]
    bool hills = false;             ///< far ridges along the horizon, seen by the camera only
    std::optional<Vec3f> backdrop;  ///< what the camera sees where there is nothing
    const Tufts* tufts = nullptr;   ///< plants beside the mesh
    const Woods* woods = nullptr;   ///< trees beside it
};

struct TraceParams {
    int width = 320, height = 180, samples = 16, bounces = 4;
    double clamp = 8;  ///< greatest single contribution of indirect light, over the sky's white
};

/// Means over a pixel's samples, rows from the top. What the denoiser needs comes along.
struct Film {
    int width = 0, height = 0;
    std::vector<Vec3f> radiance;
    std::vector<Vec3f> albedo;    ///< of what is seen first, 1 for sky
    std::vector<Vec3f> normal;    ///< with relief, zero for sky
    std::vector<float> depth;     ///< [m], 0 for sky
    std::vector<float> variance;  ///< of the mean of luminance / albedo
    std::uint64_t rays = 0;
};

/// Traces paths: next-event estimation of sun and sky, the sky weighted with scattered rays by the
/// power heuristic [Veach1995]; cosine and visible-normal GGX sampling [Heitz2018]; paths end by
/// Russian roulette. Every random number is a function of (seed, pixel, sample), sums run in sample
/// order: the same bytes on any number of threads.
/// @throws Cancelled
Film trace(const World& world, const TraceParams& params, std::uint64_t seed,
           const Progress& progress);

/// Smooths what noise is left without touching detail: five by five wavelet filter, three times
/// with growing holes, over light divided by albedo; neighbours count less the more their light
/// differs against its estimated error, and across edges of normal and depth
/// [Dammertz2010, Schied2017].
void denoise(Film& film, const Progress& progress);

}  // namespace sekitei::render
