// Rays a second of whole pictures against bare rtcIntersect1 on the same mesh and camera,
// alternating in one run; median of five, one and two threads.
//
//     render_bench [TRIANGLES]
#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <vector>

#include "apps/render/camera.h"
#include "apps/render/corner_normals.h"
#include "apps/render/look.h"
#include "apps/render/path_tracer.h"
#include "core/hash.h"
#include "core/math.h"
#include "core/parallel.h"
#include "core/random.h"
#include "solvers/rays/embree.h"

namespace sekitei::render {
namespace {

double now()
{
    return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch())
        .count();
}

/// A stepped field of square columns with finely divided walls.
TriMesh columns(std::size_t triangles)
{
    constexpr int kSide = 24;
    constexpr float kWidth = 0.45f;
    constexpr Stream kHeight{"bench.height"};
    const int n = std::max(
        1, static_cast<int>(std::sqrt(static_cast<double>(triangles) / (10.0 * kSide * kSide))));
    TriMesh mesh;
    std::vector<std::int32_t> ids;
    auto sheet = [&](Vec3f origin, Vec3f along, Vec3f up, int id) {
        const auto base = static_cast<std::uint32_t>(mesh.vertices.size());
        const auto row = static_cast<std::uint32_t>(n + 1);
        for (int j = 0; j <= n; ++j)
            for (int i = 0; i <= n; ++i)
                mesh.vertices.push_back(origin +
                                        along * (static_cast<float>(i) / static_cast<float>(n)) +
                                        up * (static_cast<float>(j) / static_cast<float>(n)));
        for (std::uint32_t j = 0; j + 1 < row; ++j)
            for (std::uint32_t i = 0; i + 1 < row; ++i) {
                const std::uint32_t a = base + j * row + i;
                mesh.triangles.push_back({a, a + 1, a + row + 1});
                mesh.triangles.push_back({a, a + row + 1, a + row});
                ids.insert(ids.end(), 2, id);
            }
    };
    for (int j = 0; j < kSide; ++j)
        for (int i = 0; i < kSide; ++i) {
            const int id = j * kSide + i;
            const auto h = static_cast<float>(
                1 + 0.2 * j + uniform01(1, kHeight, static_cast<std::uint64_t>(id)));
            const Vec3f o{kWidth * static_cast<float>(i), kWidth * static_cast<float>(j), 0};
            const Vec3f x{kWidth * 0.97f, 0, 0}, y{0, kWidth * 0.97f, 0}, z{0, 0, h};
            sheet(o, x, z, id);
            sheet(o + x, y, z, id);
            sheet(o + x + y, -x, z, id);
            sheet(o + y, -y, z, id);
            sheet(o + z, x, y, id);
        }
    mesh.face_attributes["column"] = ids;
    return mesh;
}

void bench(std::size_t triangles)
{
    const TriMesh mesh = columns(triangles);
    const rays::TriangleScene rays(mesh.vertices, mesh.triangles, "bench");
    const auto normals = corner_normals(mesh, 38 * math::kPi / 180);
    const RockLook look(mesh, 1);
    const Sky sky = Sky::day({0.6, -0.6, 0.4}, 0.0046, 3, false);
    Params params;
    params.width = 640;
    params.height = 360;
    Bounds bounds;
    for (const Vec3f& v : mesh.vertices) bounds.add(Vec3d(v));
    const World world{.mesh = mesh,
                      .rays = rays,
                      .normals = normals,
                      .look = look,
                      .sky = sky,
                      .camera = make_camera(params, bounds),
                      .ground = 0.0,
                      .haze = 600,
                      .hills = true,
                      .backdrop = {}};
    constexpr int kSamples = 8;
    for (const std::size_t threads : {1u, 2u}) {
        const ThreadLimit limit(threads);
        std::vector<double> ours, raw;
        std::string hash;
        for (int repeat = 0; repeat < 5; ++repeat) {
            double start = now();
            const Film film =
                trace(world, {.width = params.width, .height = params.height, .samples = kSamples},
                      1, Progress{});
            ours.push_back(static_cast<double>(film.rays) / (now() - start) / 1e6);
            Hasher hasher;
            hasher.add(film.radiance.data(), film.radiance.size() * sizeof(Vec3f));
            hash = hasher.hex().substr(0, 16);

            // A primary ray and a bounce off what it meets.
            start = now();
            std::vector<double> counts(static_cast<std::size_t>(params.height));
            constexpr Stream kBounce{"bench.bounce"};
            parallel_for(counts.size(), [&](std::size_t y) {
                for (int s = 0; s < kSamples; ++s)
                    for (int x = 0; x < params.width; ++x) {
                        const Vec3f origin(world.camera.eye),
                            d = world.camera.direction(
                                2.0 * (x + 0.5) / params.width - 1,
                                1 - 2 * (static_cast<double>(y) + 0.5) / params.height);
                        rays::Hit hit;
                        ++counts[y];
                        if (!rays.intersect(origin, d, 0, 1e4f, hit)) continue;
                        const std::uint64_t key =
                            mix64((y << 32) + static_cast<std::uint64_t>(x * kSamples + s));
                        const Vec3f random(
                            static_cast<float>(uniform_of_key(key, kBounce.id) * 2 - 1),
                            static_cast<float>(uniform_of_key(key, 1) * 2 - 1),
                            static_cast<float>(uniform_of_key(key, 2) * 2 - 1));
                        const Vec3f n = normals[std::size_t(hit.triangle) * 3];
                        const Vec3f p = origin + d * static_cast<float>(hit.distance) + n * 1e-3f;
                        ++counts[y];
                        rays.intersect(p, normalized(n + normalized(random)), 0, 1e4f, hit);
                    }
            });
            double total = 0;
            for (const double c : counts) total += c;
            raw.push_back(total / (now() - start) / 1e6);
        }
        std::sort(ours.begin(), ours.end());
        std::sort(raw.begin(), raw.end());
        fmt::print(
            "render, triangles {}, threads {}, Mrays/s {:.2f}, bare intersect1 {:.2f}, ratio "
            "{:.2f}, "
            "Embree {} MB, hash {}\n",
            mesh.triangles.size(), threads, ours[2], raw[2], ours[2] / raw[2],
            rays.memory_bytes() / 1000000, hash);
    }
}

}  // namespace
}  // namespace sekitei::render

int main(int argc, char** argv)
{
    sekitei::render::bench(argc > 1 ? std::strtoull(argv[1], nullptr, 10) : 1500000);
}
