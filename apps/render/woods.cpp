#include "apps/render/woods.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "apps/render/copies.h"
#include "apps/render/garden.h"
#include "core/error.h"
#include "core/noise.h"
#include "core/parallel.h"
#include "core/random.h"
#include "solvers/rays/embree.h"

namespace sekitei::render {
namespace {

/// Least heights in pixels of the levels but the coarsest.
constexpr std::array<double, kTreeLevels - 1> kLeastPixels{900, 350, 150, 60, 25};

/// How much a leaf's face gives way to the roundness of its crown: the larger the leaves that stand
/// for many, the more.
constexpr std::array<float, kTreeLevels> kRoundness{0.25f, 0.35f, 0.5f, 0.7f, 0.9f, 1.1f};

Vec3f mix(Vec3f a, Vec3f b, float t)
{
    return a * (1 - t) + b * t;
}
Vec3f times(Vec3f a, Vec3f b)
{
    return {a.x * b.x, a.y * b.y, a.z * b.z};
}

struct Placed {
    Vec3f x, y, z;  // images of the model's axes, with its scale
    Vec3f position;
    std::uint32_t shape = 0;
    std::uint32_t key = 0;
    Vec3f leaf_tint, bark_tint;
    std::uint32_t colours = 0;
    Vec3f world(Vec3f p) const { return position + x * p.x + y * p.y + z * p.z; }
    /// Of a normal, which stretches against the scale.
    Vec3f turned(Vec3f n) const
    {
        return normalized(x * (n.x / dot(x, x)) + y * (n.y / dot(y, y)) + z * (n.z / dot(z, z)));
    }
    /// A place of the world in the model's space.
    Vec3f local(Vec3f p) const
    {
        const Vec3f d = p - position;
        return {dot(d, x) / dot(x, x), dot(d, y) / dot(y, y), dot(d, z) / dot(z, z)};
    }
};

/// A model at one level.
struct Shape {
    std::vector<Vec3f> vertices, normals;
    std::vector<std::array<std::uint32_t, 3>> triangles;
    std::size_t first_leaf = 0;  // triangle
    Vec3f centre, half;          // of the box around its leaves
    float roundness = 0;
    std::uint32_t model = 0;
};

void check(const StandingTree& t, std::size_t i, std::size_t models)
{
    const auto [x, y, z, w] = t.orient;
    const double norm = static_cast<double>(x) * x + static_cast<double>(y) * y +
                        static_cast<double>(z) * z + static_cast<double>(w) * w;
    if (!(std::isfinite(dot(t.position, t.position)) && norm > 1e-12 && norm < 1e12))
        throw InvalidInput(fmt::format(
            "render: tree {} at ({}, {}, {}) m with orient ({}, {}, {}, {}), must be finite, with "
            "an orientation",
            i, t.position.x, t.position.y, t.position.z, x, y, z, w));
    for (int k = 0; k < 3; ++k)
        if (!(t.scale[k] > 0 && t.scale[k] < 1e6f))
            throw InvalidInput(
                fmt::format("render: tree {} has scale ({}, {}, {}), must be above 0 m", i,
                            t.scale.x, t.scale.y, t.scale.z));
    if (t.model < 0 || std::size_t(t.model) >= models)
        throw InvalidInput(fmt::format("render: tree {} is of model {}, must be 0 to {}", i,
                                       t.model, double(models) - 1));
}

Placed placed(const StandingTree& t)
{
    const double x = t.orient[0], y = t.orient[1], z = t.orient[2], w = t.orient[3];
    const double norm = x * x + y * y + z * z + w * w;
    const Vec3d s = Vec3d(t.scale) / norm;
    Placed p;
    p.x =
        Vec3f(Vec3d(w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)) * s.x);
    p.y =
        Vec3f(Vec3d(2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x)) * s.y);
    p.z =
        Vec3f(Vec3d(2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z) * s.z);
    p.position = Vec3f(t.position);
    return p;
}

Shape shape_of(TriMesh mesh, std::size_t model, std::size_t level)
{
    const std::string_view who = "render: a model of trees";
    if (mesh.triangles.empty()) throw InvalidInput(fmt::format("{} has no triangles", who));
    const auto found = mesh.face_attributes.find("part");
    const auto* part = found == mesh.face_attributes.end()
                           ? nullptr
                           : std::get_if<std::vector<std::int32_t>>(&found->second);
    if (!part || part->size() != mesh.triangles.size() || !std::ranges::is_sorted(*part))
        throw InvalidInput(
            fmt::format("{} does not tell bark from the leaves after it, by 'part'", who));
    Shape s;
    s.first_leaf = std::size_t(std::ranges::lower_bound(*part, 1) - part->begin());
    s.model = static_cast<std::uint32_t>(model);
    s.roundness = kRoundness[level];
    s.vertices = std::move(mesh.vertices);
    s.triangles = std::move(mesh.triangles);
    s.normals.resize(s.vertices.size());
    Bounds box;
    for (std::size_t i = 0; i < s.triangles.size(); ++i) {
        const auto& t = s.triangles[i];
        for (const std::uint32_t v : t)
            if (v >= s.vertices.size() || !std::isfinite(dot(s.vertices[v], s.vertices[v])))
                throw InvalidInput(
                    fmt::format("{}: triangle {} names vertex {}, which is not "
                                "there or not finite",
                                who, i, v));
        const Vec3f a = s.vertices[t[0]], n = cross(s.vertices[t[1]] - a, s.vertices[t[2]] - a);
        for (const std::uint32_t v : t) {
            s.normals[v] += n;
            if (i >= s.first_leaf) box.add(Vec3d(s.vertices[v]));
        }
    }
    for (Vec3f& n : s.normals) {
        n = normalized(n);
        if (!(dot(n, n) > 0.5f)) n = {0, 0, 1};
    }
    if (s.first_leaf < s.triangles.size()) {
        s.centre = Vec3f(box.centre());
        s.half = Vec3f(max(box.size() / 2.0, Vec3d(1e-6)));
    }
    return s;
}

std::uint32_t scramble(std::uint32_t x)
{
    x ^= x >> 16;
    x *= 0x7FEB352Du;
    x ^= x >> 15;
    x *= 0x846CA68Bu;
    return x ^ (x >> 16);
}

}  // namespace

struct Woods::State {
    std::vector<Shape> shapes;
    std::vector<TreeModel> models;  // without meshes
    std::vector<Placed> placed;
    std::uint64_t key = 0;
    std::size_t triangles = 0;

    std::atomic<std::int64_t> bytes{0};
    RTCDevice device = nullptr;
    RTCScene scene = nullptr, shade = nullptr;
    std::vector<RTCScene> prototypes;
    std::size_t shade_every = 1;

    ~State()
    {
        for (RTCScene s : {scene, shade})
            if (s) rtcReleaseScene(s);
        for (RTCScene s : prototypes)
            if (s) rtcReleaseScene(s);
        if (device) rtcReleaseDevice(device);
    }
    RTCScene scene_of(std::size_t every, const Progress& progress);
    void build(const Progress& progress);
};

/// All trees, with one of so many of their leaves.
RTCScene Woods::State::scene_of(std::size_t every, const Progress& progress)
{
    const std::size_t first = prototypes.size();
    for (const Shape& shape : shapes) {
        progress.check();
        auto faces = shape.triangles;
        if (every > 1) {
            std::size_t kept = shape.first_leaf;
            for (std::size_t i = kept; i < faces.size(); ++i)
                if ((i - shape.first_leaf) / 2 % every == 0) faces[kept++] = faces[i];
            faces.resize(kept);
        }
        RTCScene prototype = rtcNewScene(device);
        prototypes.push_back(prototype);
        RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
        void* points =
            rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                    sizeof(Vec3f), shape.vertices.size());
        void* corners = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0,
                                                RTC_FORMAT_UINT3, sizeof(faces[0]), faces.size());
        if (points && corners) {
            std::memcpy(points, shape.vertices.data(), shape.vertices.size() * sizeof(Vec3f));
            std::memcpy(corners, faces.data(), faces.size() * sizeof(faces[0]));
            rtcCommitGeometry(geometry);
            rtcAttachGeometry(prototype, geometry);
            rtcCommitScene(prototype);
        }
        rtcReleaseGeometry(geometry);
    }
    RTCScene all = rtcNewScene(device);
    for (std::size_t i = 0; i < placed.size(); ++i) {
        if (i % 1024 == 0) progress.check();
        const Placed& p = placed[i];
        RTCGeometry instance = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_INSTANCE);
        rtcSetGeometryInstancedScene(instance, prototypes[first + p.shape]);
        const std::array<float, 12> matrix{p.x.x, p.x.y,        p.x.z,        p.y.x,
                                           p.y.y, p.y.z,        p.z.x,        p.z.y,
                                           p.z.z, p.position.x, p.position.y, p.position.z};
        rtcSetGeometryTransform(instance, 0, RTC_FORMAT_FLOAT3X4_COLUMN_MAJOR, matrix.data());
        rtcCommitGeometry(instance);
        rtcAttachGeometryByID(all, instance, static_cast<unsigned>(i));
        rtcReleaseGeometry(instance);
    }
    rtcCommitScene(all);
    return all;
}

void Woods::State::build(const Progress& progress)
{
    device = rtcNewDevice(nullptr);
    if (!device) throw LimitExceeded("render: Embree could not start");
    rtcSetDeviceMemoryMonitorFunction(
        device,
        [](void* total, ssize_t change, bool) {
            static_cast<std::atomic<std::int64_t>*>(total)->fetch_add(change);
            return true;
        },
        &bytes);
    scene = scene_of(1, progress);
    if (shade_every > 1) shade = scene_of(shade_every, progress);
    if (rtcGetDeviceError(device) != RTC_ERROR_NONE)
        throw LimitExceeded("render: no memory for the rays of " +
                            count_text(static_cast<double>(placed.size())) + " trees");
}

std::size_t tree_level(double pixels)
{
    std::size_t level = 0;
    while (level < kLeastPixels.size() && !(pixels >= kLeastPixels[level])) ++level;
    return level;
}

std::vector<std::uint8_t> tree_levels(const std::vector<StandingTree>& trees, std::size_t models,
                                      const TuftView& view)
{
    std::vector<std::uint8_t> levels(trees.size());
    for (std::size_t i = 0; i < trees.size(); ++i) {
        const StandingTree& t = trees[i];
        check(t, i, models);
        // To the nearest point of its axis: who stands beneath a crown sees it well.
        const auto height = static_cast<double>(t.scale.z);
        const Vec3d nearest =
            t.position + Vec3d(0, 0, std::clamp(view.eye.z - t.position.z, 0.0, height));
        const double far = length(nearest - view.eye) * view.pixel;
        levels[i] = static_cast<std::uint8_t>(tree_level(
            far > 0 ? std::max<double>(height, static_cast<double>(t.scale.x)) / far : INFINITY));
    }
    return levels;
}

Woods::Woods(const std::vector<StandingTree>& trees, std::vector<TreeModel> models,
             const std::vector<std::uint8_t>& level, std::uint64_t seed, std::size_t shade_every,
             const Progress& progress)
    : state_(std::make_unique<State>())
{
    State& s = *state_;
    s.key = hash2(seed, Stream("render.woods").id);
    s.shade_every = shade_every;
    std::vector<std::int32_t> shape(models.size() * kTreeLevels, -1);
    s.placed.reserve(trees.size());
    for (std::size_t i = 0; i < trees.size(); ++i) {
        const StandingTree& t = trees[i];
        check(t, i, models.size());
        Placed p = placed(t);
        const auto model = std::size_t(t.model);
        std::int32_t& number = shape[model * kTreeLevels + level[i]];
        if (number < 0) {
            number = static_cast<std::int32_t>(s.shapes.size());
            s.shapes.push_back(shape_of(std::move(models[model].mesh[level[i]]), model, level[i]));
        }
        p.shape = static_cast<std::uint32_t>(number);
        s.triangles += s.shapes[p.shape].triangles.size();
        // Each tree by itself, and in groves that are a little alike.
        const std::uint64_t own =
            hash2(s.key, t.id != -1 ? static_cast<std::uint64_t>(t.id) : std::uint64_t(i));
        p.key = static_cast<std::uint32_t>(own >> 32);
        auto grove = [&](std::uint64_t k, double wavelength) {
            return gradient_noise(hash2(s.key, k), t.position / wavelength);
        };
        const double bright = 1 + 0.62 * (uniform_of_key(own, 1) - 0.5) + 0.22 * grove(1, 47);
        const double warm =
            0.65 * (uniform_of_key(own, 2) - 0.5) + 0.30 * grove(2, 71) + 0.15 * grove(3, 19);
        p.leaf_tint = Vec3f(Vec3d(bright * (1 + 0.50 * warm), bright * (1 + 0.08 * warm),
                                  bright * (1 - 0.4 * warm)));
        const double bark = 1 + 0.5 * (uniform_of_key(own, 3) - 0.5);
        p.bark_tint = models[model].bark * static_cast<float>(bark);
        const std::size_t colours = models[model].leaves.size();
        p.colours = static_cast<std::uint32_t>(
            std::min(double(colours) - 1, uniform_of_key(own, 4) * double(colours)));
        if (colours == 0) p.colours = 0;
        s.placed.push_back(p);
    }
    for (TreeModel& model : models) {
        model.mesh = {};
        if (model.leaves.empty()) model.leaves.emplace_back();
    }
    s.models = std::move(models);
    if (!s.placed.empty()) s.build(progress);
}

Woods::~Woods() = default;

bool Woods::intersect(Vec3f origin, Vec3f direction, float far, WoodHit& hit) const
{
    if (!state_->scene) return false;
    RTCRayHit query;
    if (!rays::first_hit(state_->scene, rays::ray_of(origin, direction, 0, far), query))
        return false;
    hit.tree = query.hit.instID[0];
    hit.triangle = query.hit.primID;

    const Placed& p = state_->placed[hit.tree];
    refine(hit, p, state_->shapes[p.shape], origin, direction, query.ray.tfar);
    return true;
}

bool Woods::occluded(Vec3f origin, Vec3f direction, float far) const
{
    if (!state_->scene) return false;
    return rays::any_hit(state_->shade ? state_->shade : state_->scene,
                         rays::ray_of(origin, direction, 0, far));
}

void Woods::place(const WoodHit& hit, Vec3f& position, Vec3f& geometric, Vec3f& soft) const
{
    const Placed& p = state_->placed[hit.tree];
    place_hit(hit, p, state_->shapes[p.shape], position, geometric, soft);
}

Vec3f Woods::rounded(const WoodHit& hit, Vec3f position, Vec3f towards) const
{
    const Placed& p = state_->placed[hit.tree];
    const Shape& shape = state_->shapes[p.shape];
    if (hit.triangle < shape.first_leaf) return towards;
    const Vec3f out = p.local(position) - shape.centre;
    const Vec3f round =
        p.turned({out.x / shape.half.x, out.y / shape.half.y, out.z / shape.half.z});
    const Vec3f n = normalized(towards + round * shape.roundness);
    return dot(n, n) > 0.5f ? n : towards;
}

Material Woods::material(const WoodHit& hit, const SurfacePoint& point) const
{
    const Placed& p = state_->placed[hit.tree];
    const Shape& shape = state_->shapes[p.shape];
    const TreeModel& model = state_->models[shape.model];
    if (hit.triangle < shape.first_leaf) {
        Material m = bark_material(point, state_->key);
        m.albedo = times(m.albedo, p.bark_tint);
        return m;
    }
    const LeafColours& colours = model.leaves[p.colours];
    // A number for each leaf of two triangles.
    const std::uint32_t h = scramble(
        p.key + static_cast<std::uint32_t>((hit.triangle - shape.first_leaf) / 2) * 0x9E3779B9u);
    const float tone = static_cast<float>(h >> 8) * 0x1p-24f;
    // The crown's rim is young and bright, its inside old and dark.
    const Vec3f local = p.local(point.position), out = local - shape.centre;
    const Vec3f r{out.x / shape.half.x, out.y / shape.half.y, out.z / shape.half.z};
    const float rim = std::clamp(0.6f * dot(r, r) + 0.25f * r.z, 0.0f, 1.0f);
    Material m;
    m.normal = point.normal;
    m.roughness = 0.65f;
    m.specular = point.seen ? 0.25f : 0;
    m.albedo = times(mix(colours.dark, colours.bright,
                         std::clamp(0.15f + 0.45f * rim + 0.55f * (tone - 0.3f), 0.0f, 1.0f)),
                     p.leaf_tint);
    for (int i = 0; i < 3; ++i) m.albedo[i] = std::clamp(m.albedo[i], 0.006f, 0.8f);
    m.transmit = times(m.albedo, colours.through);
    return m;
}

std::size_t Woods::memory_bytes() const
{
    std::size_t own = state_->placed.capacity() * sizeof(Placed);
    for (const Shape& s : state_->shapes)
        own += s.vertices.capacity() * 2 * sizeof(Vec3f) + s.triangles.capacity() * 12;
    return static_cast<std::size_t>(std::max<std::int64_t>(0, state_->bytes.load())) + own;
}

std::size_t Woods::triangles() const
{
    return state_->triangles;
}

}  // namespace sekitei::render
