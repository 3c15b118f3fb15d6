// Days of moss on meshes through the stage itself: roof2x2, and a rock of a million triangles with
// a hundred thousand plants.
//
//     mesh_habitat_bench [roof|rock]
#include <fmt/format.h>

#include <cmath>
#include <string>

#include "apps/stage.h"
#include "core/hash.h"
#include "core/mesh_io.h"
#include "core/noise.h"
#include "core/parallel.h"
#include "tests/bench/measure.h"

using namespace sekitei;
using bench::seconds_of;

namespace {

struct Setting {
    std::string name, value;
};

/// Seconds of the moss stage on a mesh, and a hash of what it left.
double run(const TriMesh& mesh, const std::vector<Setting>& settings, std::string& hash,
           std::string& words)
{
    const auto stage = apps::make_stage("moss");
    stage->meets_mesh(true);
    for (const Setting& s : settings) find_param(stage->params(), s.name)->set_text(s.value);
    stage->validate();
    Scene scene;
    scene.meshes["rock"] = mesh;
    apps::StageContext context;
    context.seed = 7;
    Json summary;
    const double seconds = seconds_of([&] { summary = stage->run(scene, context); });
    hash.clear();
    for (const char* name : {"moss", "seeds", "sites", "statistics"})
        hash += content_hash(scene.points.at(name));
    hash = hash_hex(hash).substr(0, 16);
    words = fmt::format("{} sites, {} plants", summary["sites"].get<std::size_t>(),
                        scene.points.at("moss").position.size());
    return seconds;
}

/// A ball of radius 2 m with bumps: n x 2 n quads.
TriMesh rock(int n)
{
    TriMesh mesh;
    auto index = [&](int i, int j) {
        return i == 0 ? 0u : i == n ? 1u : std::uint32_t(2 + (i - 1) * 2 * n + j % (2 * n));
    };
    auto at = [&](double theta, double phi) {
        const Vec3d d{std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi),
                      std::cos(theta)};
        const double bump = std::sin(5 * d.x + 1) * std::sin(7 * d.y) * std::sin(6 * d.z + 2) +
                            0.3 * std::sin(23 * d.x) * std::sin(19 * d.y + 1) * std::sin(21 * d.z);
        return Vec3f(d * (2 + 0.15 * bump));
    };
    mesh.vertices = {at(0, 0), at(M_PI, 0)};
    for (int i = 1; i < n; ++i)
        for (int j = 0; j < 2 * n; ++j) mesh.vertices.push_back(at(M_PI * i / n, M_PI * j / n));
    for (int i = 0; i < n; ++i)
        for (int j = 0; j < 2 * n; ++j) {
            const std::uint32_t a = index(i, j), b = index(i + 1, j), c = index(i + 1, j + 1),
                                d = index(i, j + 1);
            if (i + 1 < n) mesh.triangles.push_back({a, b, c});
            if (i > 0) mesh.triangles.push_back({a, c, d});
        }
    return mesh;
}

void roof()
{
    const TriMesh mesh = read_mesh(std::string(SEKITEI_DATA) + "/meshes/roof2x2.ply");
    for (const char* photons : {"8192", "262144"})
        for (const std::size_t threads : {1, 2}) {
            const ThreadLimit limit(threads);
            std::string hash, words;
            const double seconds = run(mesh,
                                       {{"days", "300"},
                                        {"photons", photons},
                                        {"site", "6cm"},
                                        {"cell", "20cm"},
                                        {"albedo", "0.5"},
                                        {"rain_shelter", "false"},
                                        {"runoff", "false"}},
                                       hash, words);
            fmt::print("roof2x2, 300 days, {} photons, {}, {} threads: {:.1f} s, hash {}\n",
                       photons, words, threads, seconds, hash);
        }
}

void million()
{
    const TriMesh mesh = rock(500);
    fmt::print("rock: {} triangles\n", mesh.triangles.size());
    std::vector<Setting> settings{
        {"site", "1m"},    {"cell", "20cm"},    {"initial_count", "36000"}, {"initial_growth", "1"},
        {"cap", "200000"}, {"sky_light", "60"}, {"open_light", "60"},       {"days", "1"}};
    std::string hash, words;
    const double one = run(mesh, settings, hash, words);
    settings.back().value = "4";
    const double four = run(mesh, settings, hash, words);
    fmt::print("rock: {}: set up, first day and result {:.1f} s, a further day {:.2f} s, hash {}\n",
               words, one, (four - one) / 3, hash);
}

}  // namespace

int main(int argc, char** argv)
{
    const std::string which = argc > 1 ? argv[1] : "";
    if (which.empty() || which == "roof") roof();
    if (which.empty() || which == "rock") million();
}
