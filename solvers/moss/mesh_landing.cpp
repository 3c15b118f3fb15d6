#include "solvers/moss/mesh_landing.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/error.h"
#include "core/triangle.h"
#include "solvers/rays/embree.h"

namespace sekitei::moss {
namespace {

constexpr float kFar = std::numeric_limits<float>::infinity();

/// What rounding to float may move a place.
double slack(Vec3d p)
{
    return 1e-6 * std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)});
}

}  // namespace

void check_sites(const MeshSites& sites)
{
    const std::size_t n = sites.size();
    if (n == 0) throw InvalidInput("moss: the land has no sites");
    if (sites.mesh.triangles.size() != n || sites.normal.size() != n || sites.area.size() != n)
        throw InvalidInput(
            fmt::format("moss: {} sites with {} triangles, {} normals, {} areas, must be as many",
                        n, sites.mesh.triangles.size(), sites.normal.size(), sites.area.size()));
}

struct MeshSurface::Scene {
    const MeshSites& sites;
    rays::TriangleScene triangles;

    Scene(const MeshSites& s, const Progress& progress)
        : sites((check_sites(s), s)), triangles(s.mesh.vertices, s.mesh.triangles, "moss", progress)
    {
    }
    std::array<Vec3d, 3> corners(std::uint32_t triangle) const
    {
        const auto& t = sites.mesh.triangles[triangle];
        return {Vec3d(sites.mesh.vertices[t[0]]), Vec3d(sites.mesh.vertices[t[1]]),
                Vec3d(sites.mesh.vertices[t[2]])};
    }
};

MeshSurface::MeshSurface(const MeshSites& sites, const Progress& progress)
    : scene_(std::make_unique<Scene>(sites, progress))
{
}
MeshSurface::~MeshSurface() = default;

const MeshSites& MeshSurface::sites() const
{
    return scene_->sites;
}

std::optional<LandPoint> MeshSurface::closest(Vec3d from, double within) const
{
    LandPoint best;
    bool found = false;
    double best2 = within * within;
    scene_->triangles.near(from, within, [&](std::uint32_t triangle) {
        const auto [a, b, c] = scene_->corners(triangle);
        const Vec3d at = closest_on_triangle(from, a, b, c);
        const double d2 = dot(at - from, at - from);
        if (d2 < best2 || (d2 == best2 && (!found || triangle < best.site))) {
            found = true;
            best2 = d2;
            best.at = at;
            best.site = triangle;
        }
        return std::sqrt(best2);
    });
    if (!found) return std::nullopt;
    best.distance = std::sqrt(best2);
    return best;
}

std::optional<LandPoint> MeshSurface::first_hit(Vec3d from, Vec3d way) const
{
    rays::Hit hit;
    if (!scene_->triangles.intersect(Vec3f(from), Vec3f(way), 0, kFar, hit)) return std::nullopt;
    // Again from the exact origin. The foot stays within the triangle, though the way may pass it
    // by as much as the origin was rounded.
    const auto [a, b, c] = scene_->corners(hit.triangle);
    const Vec3d normal = cross(b - a, c - a);
    const double slope = dot(normal, way);
    const double distance =
        slope != 0 ? std::max(0.0, dot(normal, a - from) / slope) : hit.distance;
    return LandPoint{closest_on_triangle(from + way * distance, a, b, c), hit.triangle, slope <= 0,
                     distance};
}

struct Balls::Scene {
    std::span<const Sphere> spheres;
    RTCDevice device = nullptr;
    RTCScene scene = nullptr;

    /// A question about a way, and its best answer.
    struct Query : rays::QueryContext {
        Query(const Scene& s, Vec3d f, Vec3d w) : scene(s), from(f), way(w) {}
        const Scene& scene;
        const Vec3d from, way;
        bool found = false;
        BallPoint best;
    };

    explicit Scene(std::span<const Sphere> s) : spheres(s)
    {
        for (std::size_t i = 0; i < s.size(); ++i) {
            const Vec3f p = s[i].centre;
            const float most = std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z), s[i].radius});
            if (!(std::isfinite(p.x + p.y + p.z) && most < 1e15f && s[i].radius >= 0))
                throw InvalidInput(
                    fmt::format("moss: ball {} at ({}, {}, {}) of radius {} m, must be finite", i,
                                p.x, p.y, p.z, s[i].radius));
        }
        if (s.empty()) return;
        device = rtcNewDevice(nullptr);
        if (!device) throw LimitExceeded("moss: Embree could not start");
        scene = rtcNewScene(device);
        rtcSetSceneBuildQuality(scene, RTC_BUILD_QUALITY_LOW);
        rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);
        RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_USER);
        rtcSetGeometryUserPrimitiveCount(geometry, static_cast<unsigned>(s.size()));
        rtcSetGeometryUserData(geometry, this);
        rtcSetGeometryBoundsFunction(geometry, &Scene::bounds, nullptr);
        rtcSetGeometryIntersectFunction(geometry, &Scene::intersect);
        rtcCommitGeometry(geometry);
        rtcAttachGeometry(scene, geometry);
        rtcReleaseGeometry(geometry);
        rtcCommitScene(scene);
        if (rtcGetDeviceError(device) != RTC_ERROR_NONE) {
            release();
            throw LimitExceeded(fmt::format("moss: no memory for the rays of {} mosses", s.size()));
        }
    }
    ~Scene() { release(); }
    void release()
    {
        if (scene) rtcReleaseScene(scene);
        if (device) rtcReleaseDevice(device);
        scene = nullptr;
        device = nullptr;
    }

    /// A box that still holds the ball when Embree's ray was rounded.
    static void bounds(const RTCBoundsFunctionArguments* args)
    {
        const Sphere& s = static_cast<const Scene*>(args->geometryUserPtr)->spheres[args->primID];
        const Vec3d c(s.centre);
        const double r = double(s.radius) * (1 + 1e-6) + 2 * slack(c);
        RTCBounds& box = *args->bounds_o;
        box.lower_x = static_cast<float>(c.x - r), box.upper_x = static_cast<float>(c.x + r);
        box.lower_y = static_cast<float>(c.y - r), box.upper_y = static_cast<float>(c.y + r);
        box.lower_z = static_cast<float>(c.z - r), box.upper_z = static_cast<float>(c.z + r);
    }

    static void intersect(const RTCIntersectFunctionNArguments* args)
    {
        if (args->valid[0] == 0) return;
        auto& q = static_cast<Query&>(static_cast<rays::QueryContext&>(*args->context));
        const Sphere& s = q.scene.spheres[args->primID];
        const double radius = double(s.radius);
        const Vec3d o = q.from - Vec3d(s.centre);
        const double a = dot(q.way, q.way), b = dot(o, q.way), c = dot(o, o) - radius * radius;
        const double root = b * b - a * c;
        if (c < 0 || b >= 0 || root < 0) return;
        const double t = (-b - std::sqrt(root)) / a;
        if (q.found &&
            (t > q.best.distance || (t == q.best.distance && args->primID > q.best.ball)))
            return;
        q.found = true;
        q.best.distance = t;
        q.best.ball = args->primID;
        // Embree may leave out what lies farther, with room for its rounding.
        const double far = t * (1 + 1e-5) + slack(q.from) / std::sqrt(a);
        auto& ray = reinterpret_cast<RTCRayHit*>(args->rayhit)->ray;
        ray.tfar = std::min(ray.tfar, static_cast<float>(far));
    }
};

Balls::Balls(std::span<const Sphere> spheres) : scene_(std::make_unique<Scene>(spheres)) {}
Balls::~Balls() = default;

std::optional<BallPoint> Balls::closest(Vec3d from, double within) const
{
    if (!scene_->scene) return std::nullopt;
    BallPoint best{{}, 0, within};
    bool found = false;
    rays::near(scene_->scene, from, within, [&](std::uint32_t ball) {
        const Sphere& s = scene_->spheres[ball];
        const double distance = length(from - Vec3d(s.centre)) - double(s.radius);
        if (distance < best.distance ||
            (distance == best.distance && (!found || ball < best.ball))) {
            found = true;
            best.distance = distance;
            best.ball = ball;
        }
        // Inside a ball boxes hold nothing back: all of those that hold the place are looked at.
        return std::max(0.0, best.distance);
    });
    if (!found) return std::nullopt;
    const Sphere& s = scene_->spheres[best.ball];
    const Vec3d centre(s.centre), out = from - centre;
    const double away = length(out);
    best.at = away > 0 ? centre + out * (double(s.radius) / away)
                       : centre + Vec3d(0, 0, double(s.radius));
    return best;
}

std::optional<BallPoint> Balls::first_hit(Vec3d from, Vec3d way) const
{
    if (!scene_->scene) return std::nullopt;
    Scene::Query query(*scene_, from, way);
    RTCRayHit unused;  // the answer is in the query, in double
    rays::first_hit(scene_->scene, rays::ray_of(Vec3f(from), Vec3f(way), 0, kFar), unused, query);
    if (!query.found) return std::nullopt;
    query.best.at = from + way * query.best.distance;
    return query.best;
}

}  // namespace sekitei::moss
