// A day of photons: tracing against a bare loop of Embree's closest-hit rays over the same mix of
// rays, searches built, estimates. Prints: case, size, threads, seconds, what it comes to, hash.

#include <fmt/format.h>

#include <cmath>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "core/mesh_sites.h"
#include "core/parallel.h"
#include "core/random.h"
#include "solvers/light/lobes.h"
#include "solvers/light/photon_map.h"
#include "solvers/rays/embree.h"
#include "tests/bench/measure.h"
#include "tests/bench/raw_scene.h"
#include "tests/support/roof.h"

namespace {

using namespace sekitei;
using bench::hash_of;
using bench::median;

struct RecordedRay {
    Vec3f origin, direction;
};

/// The rays of the photons: the first ones, and from stored hits as many as were reflected, drawn
/// alike.
std::vector<RecordedRay> record(const light::PhotonScene& scene,
                                const std::vector<light::Emitted>& emitted,
                                const std::vector<light::Photon>& stored)
{
    constexpr Stream kDraw{"photon_bench.reflected"};
    std::vector<RecordedRay> rays;
    for (const auto& e : emitted) rays.push_back({e.origin, e.direction});
    for (std::size_t i = 0; i < stored.size(); ++i) {
        const light::Photon& p = stored[i];
        if (uniform01(1, kDraw, i, 0) >= scene.albedo_of(p.on_moss, p.target)) continue;
        const Vec3d n(p.normal);
        rays.push_back({scene.off_surface(Vec3d(p.position), n),
                        Vec3f(light::cosine_direction(light::Frame(n), uniform01(1, kDraw, i, 1),
                                                      uniform01(1, kDraw, i, 2)))});
    }
    return rays;
}

/// One after the other, as Embree's manual writes it.
std::vector<std::uint32_t> raw_hits(RTCScene scene, const std::vector<RecordedRay>& recorded)
{
    std::vector<std::uint32_t> met(recorded.size());
    parallel_for(
        recorded.size(),
        [&](std::size_t i) {
            const auto& [origin, direction] = recorded[i];
            RTCRayHit q{};
            rays::first_hit(scene, rays::ray_of(origin, direction, 1e-4f, INFINITY), q);
            met[i] = q.hit.primID;
        },
        2048);
    return met;
}

struct Bench {
    std::string name;
    int rounds;
    std::function<void()> work;
    std::function<std::string()> hash;
    std::function<std::string(double)> note;
};

struct Seconds {
    double two;        ///< passed, on two threads
    double processor;  ///< of processor, on one thread: hardly hurt by whatever else runs
};

/// Medians of rounds that take turns, on two threads and on one.
std::vector<Seconds> run(const std::string& what, const std::vector<Bench>& cases)
{
    fmt::print("{}\n", what);
    const std::vector<bench::Rounds> rounds = bench::in_turn(cases);
    std::vector<Seconds> all;
    for (std::size_t c = 0; c < cases.size(); ++c) {
        const bench::Rounds &on_one = rounds[2 * c], &on_two = rounds[2 * c + 1];
        const double one = median(on_one.seconds);
        const Seconds s{median(on_two.seconds), median(on_one.processor)};
        all.push_back(s);
        fmt::print(
            "{}: 1 thread {:.2f} ms ({:.2f} of processor), 2 threads {:.2f} ms ({:.2f} x), {}, {} "
            "{}\n",
            cases[c].name, 1e3 * one, 1e3 * s.processor, 1e3 * s.two, one / s.two,
            cases[c].note(s.two), on_one.hash, on_one.hash == on_two.hash ? "same" : "DIFFERENT");
    }
    return all;
}

template <class T>
std::string hash_bytes(const std::vector<T>& values)
{
    return hash_of(values);
}

/// Plants on the land at random, facing up or out.
struct Plants {
    std::vector<Sphere> balls;
    std::vector<Vec3f> foot, normal;
    std::vector<std::uint32_t> site;
    std::vector<std::int32_t> plant;

    Plants(const MeshSites& sites, std::size_t count)
    {
        constexpr Stream kPlant{"photon_bench.plant"};
        for (std::size_t i = 0; i < count; ++i) {
            const auto j = static_cast<std::size_t>(uniform01(3, kPlant, i) *
                                                    static_cast<double>(sites.size()));
            foot.push_back(sites.position[j]);
            normal.push_back(sites.normal[j]);
            site.push_back(static_cast<std::uint32_t>(j));
            plant.push_back(static_cast<std::int32_t>(i));
            const float r = 0.002f + 0.003f * static_cast<float>(uniform01(4, kPlant, i));
            balls.push_back({sites.position[j] + sites.normal[j] * r, r});
        }
    }
};

void day_on(const std::string& name, const TriMesh& mesh, double longest_edge, std::size_t plants,
            double sky)
{
    const MeshSites sites = mesh_sites(mesh, longest_edge, {});
    light::PhotonScene scene(sites.mesh, std::vector<float>(sites.size(), 0.5f), 0.2, 0.0, {});
    const Plants moss(sites, plants);
    scene.set_moss(moss.balls);
    const light::Daylight daylight{{{{0, 0, 1}, 150 - sky}}, sky};
    const light::PhotonParams params;
    const bench::RawScene raw(sites.mesh, moss.balls, RTC_BUILD_QUALITY_HIGH);

    std::uint64_t tries = 0;
    std::vector<light::Emitted> emitted = light::emit(scene, daylight, params, 1, 1, tries);
    light::Shot shot = light::trace(scene, emitted, true, 1, 1, {});
    const std::vector<RecordedRay> rays = record(scene, emitted, shot.photons);
    std::vector<std::uint32_t> met;
    const auto ray_count = static_cast<double>(rays.size());
    auto rate = [&](double s) { return fmt::format("{:.2f} M rays/s", ray_count / s / 1e6); };
    auto photon_rate = [&](double s) {
        return fmt::format("{:.2f} M rays/s, {:.2f} M photons/s", ray_count / s / 1e6,
                           static_cast<double>(params.photons) / s / 1e6);
    };
    const auto tracing = run(
        fmt::format("{}: {} sites, {} plants, {} photons emitted, {} stored, sky {} of 150 W/m^2",
                    name, sites.size(), plants, emitted.size(), shot.photons.size(), sky),
        {{"bare Embree, the same kind of rays (peer)", 5, [&] { met = raw_hits(raw.scene, rays); },
          [&] { return hash_bytes(met); }, rate},
         {"emit", 5, [&] { emitted = light::emit(scene, daylight, params, 1, 1, tries); },
          [&] { return hash_bytes(emitted); }, photon_rate},
         {"emission to stored hits", 5,
          [&] { shot = light::shoot(scene, daylight, params, 1, 1, {}); },
          [&] { return hash_bytes(shot.photons); }, photon_rate},
         {"moss into the scene", 3, [&] { scene.set_moss(moss.balls); },
          [] { return std::string(); }, [](double) { return std::string(); }}});
    fmt::print("tracing / bare Embree: {:.2f} by time on 2 threads, {:.2f} by processor on 1\n",
               tracing[0].two / tracing[2].two, tracing[0].processor / tracing[2].processor);

    for (const light::PhotonSearch search :
         {light::PhotonSearch::Cells, light::PhotonSearch::Tree}) {
        light::PhotonParams p = params;
        p.photon_search = search;
        const light::SiteKernel kernel(sites.position, sites.normal, sites.area, p, 0.01);
        std::vector<Vec3f> points;
        for (const auto& photon : shot.photons) points.push_back(photon.position);
        const std::vector<float> areas = kernel.kernel_area(moss.foot, moss.normal);
        const light::MossHosts hosts{moss.foot, moss.normal, moss.site};
        const light::PhotonMap map(shot.photons, hosts, kernel, p);
        light::Irradiance on_sites, on_plants;
        std::vector<std::uint32_t> order;
        // Photons within the radius, those on the other side and off the slab included.
        double tests = 0;
        const CellIndex cells(points, static_cast<float>(p.photon_radius));
        for (const auto* at : {&sites.position, &moss.foot})
            tests += parallel_sum(at->size(), [&](std::size_t i) {
                std::size_t n = 0;
                cells.within_slots((*at)[i], static_cast<float>(p.photon_radius),
                                   [&](std::size_t, float) { ++n; });
                return static_cast<double>(n);
            });
        auto keep_order = [&](const auto& index) {
            order.clear();
            for (const auto& s : index.points()) order.push_back(s.index);
        };
        const bool tree = search == light::PhotonSearch::Tree;
        KdTree kd;
        CellIndex ci;
        run(tree ? "by tree" : "by cells",
            {{"index alone", 7,
              [&] {
                  if (tree)
                      kd = KdTree(points);
                  else
                      ci = CellIndex(points, static_cast<float>(p.photon_radius));
              },
              [&] {
                  if (tree)
                      keep_order(kd);
                  else
                      keep_order(ci);
                  return hash_bytes(order);
              },
              [&](double s) {
                  return fmt::format("{:.1f} ms for 262144 points",
                                     1e3 * s * 262144 / static_cast<double>(points.size()));
              }},
             {"photon map", 5,
              [&] { const light::PhotonMap again(shot.photons, hosts, kernel, p); },
              [] { return std::string(); }, [](double) { return std::string(); }},
             {"estimates at sites and plants", 3,
              [&] {
                  on_sites = map.at_sites({});
                  on_plants = map.at({moss.foot, moss.normal, areas, moss.plant}, on_sites, {});
              },
              [&] { return hash_bytes(on_sites.indirect) + hash_bytes(on_plants.beam); },
              [&](double s) {
                  return fmt::format("{:.0f} M photons in reach/s, {:.0f} a place", tests / s / 1e6,
                                     tests / static_cast<double>(sites.size() + plants));
              }}});
    }
    fmt::print("bytes: {} a photon, {} more in the map\n\n", sizeof(light::Photon),
               light::PhotonMap::bytes_per_photon());
}

/// A day as a program has it, part by part: once the kernel's areas of all sites, then moss into
/// the scene, photons, areas of new plants, light of everyone.
void whole_day(const std::string& name, const TriMesh& mesh, double longest_edge,
               std::size_t plants, double sky)
{
    const MeshSites sites = mesh_sites(mesh, longest_edge, {});
    light::PhotonScene scene(sites.mesh, std::vector<float>(sites.size(), 0.5f), 0.2, 0.0, {});
    const Plants moss(sites, plants);
    const light::Daylight daylight{{{{0, 0, 1}, 150 - sky}}, sky};
    const light::PhotonParams params;
    std::unique_ptr<light::SiteKernel> kernel;
    light::Shot shot;
    std::vector<float> areas;
    light::PhotonLight found;
    auto nothing = [](double) { return std::string(); };
    const auto parts =
        run(fmt::format("{}, a day: {} sites, {} plants", name, sites.size(), plants),
            {{"once: kernel areas of the sites", 1,
              [&] {
                  kernel = std::make_unique<light::SiteKernel>(
                      sites.position, sites.normal, sites.area, params, 0.01, &sites.mesh);
              },
              [&] { return hash_bytes(kernel->kernel_area()); }, nothing},
             {"moss into the scene", 3, [&] { scene.set_moss(moss.balls); },
              [] { return std::string(); }, nothing},
             {"photons", 3, [&] { shot = light::shoot(scene, daylight, params, 1, 1, {}); },
              [&] { return hash_bytes(shot.photons); }, nothing},
             {"kernel areas of the plants", 3,
              [&] { areas = kernel->kernel_area(moss.foot, moss.normal); },
              [&] { return hash_bytes(areas); }, nothing},
             {"light of sites and plants", 3,
              [&] {
                  found = light::light_of_day(
                      scene, *kernel, daylight, shot.photons, {moss.foot, moss.normal, moss.site},
                      {moss.foot, moss.normal, areas, moss.plant}, params, 1, 1, {});
              },
              [&] { return hash_bytes(found.sites.indirect) + hash_bytes(found.receivers.beam); },
              nothing}});
    double two = 0, processor = 0;
    for (std::size_t k = 1; k < parts.size(); ++k) {
        two += parts[k].two;
        processor += parts[k].processor;
    }
    fmt::print("day: {:.2f} s on 2 threads, {:.2f} s of processor on 1\n\n", two, processor);
}

/// A floor and a boulder of about a million triangles.
TriMesh rock()
{
    TriMesh ball = shapes::ball({0, 0, 0.3}, 0.5, 8);
    for (Vec3f& v : ball.vertices) {
        const Vec3d out = normalized(Vec3d(v) - Vec3d(0, 0, 0.3));
        double bump = 0, size = 0.08;
        for (double f = 3; f < 200; f *= 2, size *= 0.55)
            bump += size * std::sin(f * out.x + 1.3 * f * out.y) *
                    std::cos(1.1 * f * out.z - f * out.y);
        v = Vec3f(Vec3d(v) + out * bump);
    }
    return roof::joined({shapes::box({-1.5, -1.5, -0.2}, {1.5, 1.5, 0}), ball});
}

}  // namespace

int main(int argc, char** argv)
{
    const std::string which = argc > 1 ? argv[1] : "all";
    if (which == "roof" || which == "all") {
        day_on("roof, bare", roof::mesh(), 0.05, 0, 0);
        day_on("roof, mossy", roof::mesh(), 0.05, 16384, 0);
        day_on("roof, mossy, sky", roof::mesh(), 0.05, 16384, 60);
    }
    if (which == "rock" || which == "all") day_on("rock", rock(), 0.02, 16384, 60);
    if (which == "day" || which == "all") whole_day("rock", rock(), 0.02, 100'000, 60);
}
