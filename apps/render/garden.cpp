#include "apps/render/garden.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/error.h"
#include "core/noise.h"
#include "core/parallel.h"
#include "solvers/rays/embree.h"

namespace sekitei::render {
namespace {

Vec3f mix(Vec3f a, Vec3f b, float t)
{
    return a * (1 - t) + b * t;
}

/// Still water: nearly a mirror, with a breath of ripples.
Material water(const SurfacePoint& p, std::uint64_t key)
{
    Material m;
    m.albedo = {0.010f, 0.016f, 0.014f};
    m.specular = 0.8f;  // 2 % head on is half of what stone reflects; wet banks add to it
    m.roughness = p.seen ? 0.06f : 0.30f;
    m.normal = p.normal;
    if (!p.seen) return m;
    double slope_x = 0, slope_y = 0;
    for (const double wavelength : {0.31, 0.11}) {
        if (static_cast<double>(p.footprint) * 3 > wavelength) continue;
        auto height = [&](double dx, double dy) {
            return gradient_noise(
                key, Vec3d((static_cast<double>(p.position.x) + dx) / wavelength,
                           (static_cast<double>(p.position.y) + dy) / wavelength, wavelength * 70));
        };
        const double d = wavelength * 0.05;
        slope_x += 0.006 * (height(d, 0) - height(-d, 0)) / 0.1;
        slope_y += 0.006 * (height(0, d) - height(0, -d)) / 0.1;
    }
    m.normal = normalized(p.normal - Vec3f(Vec3d(slope_x, slope_y, 0)));
    return m;
}

/// Boards that have stood outside for long: grey over brown, grain along z.
Material wood(const SurfacePoint& p, std::uint64_t key)
{
    Material m;
    m.normal = p.normal;
    m.roughness = 0.8f;
    m.specular = p.seen ? 0.5f : 0;
    const Vec3d q(p.position);
    const double grain = gradient_noise(key + 1, Vec3d(q.x * 160, q.y * 160, q.z * 6)) +
                         0.6 * gradient_noise(key + 2, Vec3d(q.x * 420, q.y * 420, q.z * 14));
    const double wide = gradient_noise(key + 3, q * 2.3);
    const auto grey = static_cast<float>(std::clamp(0.5 + 0.8 * wide, 0.0, 1.0));
    m.albedo = mix({0.135f, 0.092f, 0.058f}, {0.180f, 0.165f, 0.145f}, grey) *
               (p.seen ? static_cast<float>(1 + 0.35 * grain) : 1.0f);
    return m;
}

Material foliage(const SurfacePoint& p, const LeafColours& colours, std::uint64_t key)
{
    Material m;
    m.normal = p.normal;
    m.roughness = 0.6f;
    m.specular = p.seen ? 0.4f : 0;
    const auto tone = static_cast<float>(gradient_noise(key + 4, Vec3d(p.position) * 3.7) +
                                         0.6 * gradient_noise(key + 5, Vec3d(p.position) * 17.0));
    m.albedo = mix(colours.dark, colours.bright, std::clamp(0.5f + tone, 0.0f, 1.0f));
    m.transmit = {m.albedo.x * colours.through.x, m.albedo.y * colours.through.y,
                  m.albedo.z * colours.through.z};
    return m;
}

}  // namespace

Material ground_cover(const SurfacePoint& p, float light, std::uint64_t key)
{
    Material m;
    m.normal = p.normal;
    m.specular = 0;
    const Vec3d q(p.position);
    // A pixel is long on the ground, but not wide.
    const double pixel = 0.3 * static_cast<double>(p.footprint);
    auto octave = [&](std::uint64_t k, double wavelength) {
        const double shown = std::clamp(1.6 - 1.2 * pixel / wavelength, 0.0, 1.0);
        return shown > 0 ? shown * gradient_noise(key + k, q / wavelength) : 0.0;
    };
    const double fields = octave(20, 310) + 0.7 * octave(21, 83), patch = octave(22, 17),
                 small = octave(23, 3.1);
    // Grass where there is light, moss and herbs in patches where there is little.
    const auto green = static_cast<float>(
        std::clamp(static_cast<double>(light) * 2.2 - 0.45 + 0.9 * patch + 0.7 * small, 0.0, 1.0));
    const auto dry = static_cast<float>(std::clamp(0.42 + 0.9 * fields + 0.5 * patch, 0.0, 1.0));
    const Vec3f litter = mix({0.040f, 0.030f, 0.018f}, {0.082f, 0.062f, 0.036f},
                             static_cast<float>(std::clamp(0.5 + small, 0.0, 1.0)));
    const Vec3f grass = mix({0.052f, 0.085f, 0.018f}, {0.120f, 0.122f, 0.038f}, dry);
    Vec3f colour = mix(litter, grass, green);
    if (p.seen) {
        const double fine = octave(24, 0.55) + 0.8 * octave(25, 0.13) + 0.8 * octave(26, 0.035);
        colour *= static_cast<float>(std::clamp(1 + 0.75 * fine, 0.35, 1.8));
        // Single leaves on the ground, pale.
        const double leaf = octave(27, 0.06);
        if (leaf > 0.45) colour = mix(colour, {0.135f, 0.100f, 0.055f}, 0.6f * (1 - green));
    }
    m.albedo = colour;
    // Steep places are bare.
    const float steep = std::clamp((0.72f - p.normal.z) * 5, 0.0f, 1.0f);
    m.albedo = mix(m.albedo, {0.105f, 0.088f, 0.068f}, steep);
    return m;
}

Material bark_material(const SurfacePoint& p, std::uint64_t key)
{
    Material m;
    m.normal = p.normal;
    m.roughness = 0.9f;
    m.specular = 0;
    const Vec3d q(p.position);
    const double wide = gradient_noise(key + 6, q * 1.7);
    Vec3f colour = mix({0.078f, 0.060f, 0.046f}, {0.150f, 0.135f, 0.118f},
                       static_cast<float>(std::clamp(0.45 + 0.7 * wide, 0.0, 1.0)));
    if (p.seen) {
        // A furrow is seen where a pixel is smaller than it.
        const auto shown = std::clamp(1.5 - static_cast<double>(p.footprint) / 0.02, 0.0, 1.0);
        const double upright =
            1 - static_cast<double>(p.normal.z) * static_cast<double>(p.normal.z);
        auto height = [&](Vec3d at) {
            return gradient_noise(key + 7,
                                  Vec3d(at.x * 30, at.y * 30, at.z * (30 - 25 * upright))) +
                   0.5 * gradient_noise(key + 8,
                                        Vec3d(at.x * 75, at.y * 75, at.z * (75 - 55 * upright)));
        };
        const double here = height(q);
        colour *= static_cast<float>(1 + shown * std::clamp(0.9 * here, -0.65, 0.5));
        if (shown > 0) {
            constexpr double kStep = 0.003;
            const Vec3d slope((height(q + Vec3d(kStep, 0, 0)) - here) / kStep,
                              (height(q + Vec3d(0, kStep, 0)) - here) / kStep,
                              (height(q + Vec3d(0, 0, kStep)) - here) / kStep);
            const Vec3d n(p.normal), across = slope - n * dot(slope, n);
            m.normal = normalized(Vec3f(n - across * (0.012 * shown)));
        }
        const double lichen = gradient_noise(key + 9, q * 6.0) + 0.5 * wide;
        const auto cover = static_cast<float>(std::clamp((lichen - 0.25) * 3, 0.0, 1.0));
        colour = mix(colour, {0.150f, 0.160f, 0.115f}, 0.5f * cover);
    }
    m.albedo = colour;
    return m;
}

TriMesh joined(const std::vector<Piece>& pieces)
{
    TriMesh all;
    for (std::size_t k = 0; k < pieces.size(); ++k) {
        const TriMesh& mesh = *pieces[k].mesh;
        const auto first = static_cast<std::uint32_t>(all.vertices.size());
        if (mesh.vertices.size() > 0xFFFFFFFFu - first)
            throw LimitExceeded("render: the meshes have more than 2^32 vertices together");
        all.vertices.insert(all.vertices.end(), mesh.vertices.begin(), mesh.vertices.end());
        for (std::size_t i = 0; i < mesh.triangles.size(); ++i) {
            auto t = mesh.triangles[i];
            for (std::uint32_t& v : t) {
                if (v >= mesh.vertices.size())
                    throw InvalidInput(
                        fmt::format("render: triangle {} of mesh {} names vertex {}, but the mesh "
                                    "has {}",
                                    i, k + 1, v, mesh.vertices.size()));
                v += first;
            }
            all.triangles.push_back(t);
        }
    }
    if (all.triangles.empty())
        throw InvalidInput("render: the meshes have no triangles, must have at least one");
    return all;
}

void lay_mats(std::vector<Tuft>& moss, const std::vector<std::string>& species, double size,
              const TriMesh& mesh, const rays::TriangleScene& rays)
{
    parallel_for(
        moss.size(),
        [&](std::size_t i) {
            Tuft& t = moss[i];
            const auto number = static_cast<std::size_t>(t.species) - 1;  // huge where below 1
            if (number >= species.size() || species[number] != "hypnum") return;
            // Where the plant points now: q (0, 1, 0) q^-1.
            const double x = t.orient[0], y = t.orient[1], z = t.orient[2], w = t.orient[3];
            const Vec3d up = normalized(
                Vec3d(2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x)));
            const double reach = size * static_cast<double>(t.scale);
            if (!(reach > 0 && std::isfinite(reach) && dot(up, up) > 0.5)) return;
            rays::Hit hit;
            if (!rays.intersect(Vec3f(t.position + up * reach), Vec3f(-up), 0,
                                static_cast<float>(2 * reach), hit))
                return;
            const auto& corner = mesh.triangles[hit.triangle];
            const Vec3d a(mesh.vertices[corner[0]]);
            Vec3d normal = normalized(
                cross(Vec3d(mesh.vertices[corner[1]]) - a, Vec3d(mesh.vertices[corner[2]]) - a));
            if (dot(normal, up) < 0) normal = -normal;
            // The shortest turn from one to the other, then what was there.
            const Vec3d v = cross(up, normal);
            const double c = 1 + dot(up, normal);
            if (!(c > 0.2)) return;
            t.orient = {static_cast<float>(c * x + v.x * w + v.y * z - v.z * y),
                        static_cast<float>(c * y + v.y * w + v.z * x - v.x * z),
                        static_cast<float>(c * z + v.z * w + v.x * y - v.y * x),
                        static_cast<float>(c * w - v.x * x - v.y * y - v.z * z)};
        },
        256);
}

void lay_mats(std::vector<Tuft>& moss, const std::vector<std::string>& species, double size,
              const TriMesh& mesh, const Progress& progress)
{
    const rays::TriangleScene rays(mesh.vertices, mesh.triangles, "moss", progress);
    lay_mats(moss, species, size, mesh, rays);
}

GardenLook::GardenLook(const std::vector<Piece>& pieces, std::uint64_t seed,
                       const Progress& progress)
    : key_(hash2(seed, Stream("render.garden").id))
{
    std::size_t first = 0;
    for (const Piece& piece : pieces) {
        if (piece.mesh->triangles.empty()) continue;
        Part part{first, piece.substance, nullptr, piece.leaves, piece.mesh};
        if (piece.substance == Substance::Floor) {
            meadow_ = true;
            const auto light = piece.mesh->vertex_attributes.find("light");
            if (light != piece.mesh->vertex_attributes.end())
                part.light = std::get_if<std::vector<float>>(&light->second);
        }
        if (piece.substance == Substance::Rock) {
            rocks_.push_back(std::make_unique<RockLook>(*piece.mesh, seed, progress));
            part.rock = rocks_.back().get();
            meadow_ = meadow_ || part.rock->has_soil();
        }
        parts_.push_back(part);
        first += piece.mesh->triangles.size();
    }
    // Without any rock the first piece lends its size to the ground's pattern.
    if (rocks_.empty())
        for (const Piece& piece : pieces)
            if (!piece.mesh->triangles.empty()) {
                rocks_.push_back(std::make_unique<RockLook>(*piece.mesh, seed, progress));
                break;
            }
}

Material GardenLook::surface(const SurfacePoint& point) const
{
    const auto after =
        std::upper_bound(parts_.begin(), parts_.end(), point.triangle,
                         [](std::size_t t, const Part& part) { return t < part.first; });
    const Part& part = *(after - 1);
    switch (part.substance) {
        case Substance::Water:
            return water(point, key_);
        case Substance::Wood:
            return wood(point, key_);
        case Substance::Foliage:
            return foliage(point, part.leaves, key_);
        case Substance::Bark:
            return bark_material(point, key_);
        case Substance::Floor: {
            const auto& t = part.mesh->triangles[point.triangle - part.first];
            const float light = part.light ? (*part.light)[t[0]] * (1 - point.u - point.v) +
                                                 (*part.light)[t[1]] * point.u +
                                                 (*part.light)[t[2]] * point.v
                                           : 0;
            return ground_cover(point, light, key_);
        }
        case Substance::Rock:
            break;
    }
    SurfacePoint own = point;
    own.triangle = point.triangle - static_cast<std::uint32_t>(part.first);
    return part.rock->surface(own);
}

Material GardenLook::ground(const SurfacePoint& point) const
{
    if (meadow_) return ground_cover(point, 1, key_);
    return rocks_.front()->ground(point);
}

}  // namespace sekitei::render
