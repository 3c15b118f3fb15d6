// Visibility of a lantern's cells: the tracer against a bare loop of Embree's single rays in the
// same run, a retrace, the light of a day. Prints: case, sites, threads, seconds, what it comes to,
// hash.

#include <fmt/format.h>

#include <cmath>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "core/parallel.h"
#include "core/solar_day.h"
#include "solvers/light/light.h"
#include "solvers/rays/embree.h"
#include "tests/bench/measure.h"
#include "tests/bench/raw_scene.h"
#include "tests/support/lantern.h"

namespace {

using namespace sekitei;
using bench::hash_of;
using bench::median;

/// A bare loop: the rays of the same directions into the front of each site, as Embree's manual
/// writes it. Returns how many rays.
double raw_rays(RTCScene scene, const std::vector<Vec3f>& directions, const light::Sites& sites,
                std::vector<std::int32_t>& hidden)
{
    hidden.assign(sites.size(), 0);
    std::vector<std::uint32_t> asked(sites.size());
    parallel_for(
        sites.size(),
        [&](std::size_t i) {
            const Vec3f o(sites.origin[i]), n = sites.normal[i];
            for (const Vec3f& d : directions) {
                if (dot(n, d) <= 0) continue;
                hidden[i] += rays::any_hit(scene, rays::ray_of(o, d, 0, INFINITY));
                ++asked[i];
            }
        },
        32);
    double sum = 0;
    for (const std::uint32_t a : asked) sum += a;
    return sum;
}

}  // namespace

int main(int argc, char** argv)
{
    const double voxel = argc > 1 ? std::stod(argv[1]) : 0.0052;
    const lantern::Body body(voxel);
    const light::Sites sites{body.origins, body.cells.normal, body.cells.area};
    const std::size_t n = sites.size();
    const Site site{39.70 * 3.14159265358979 / 180, 2.46};
    const TriMesh* meshes[] = {&body.mesh};
    fmt::print("lantern, voxel {} m: {} cells, {} triangles\n", voxel, n,
               body.mesh.triangles.size());

    // 145 patches and 336 sun bins, one ray each: 481 directions.
    light::Params rays;
    rays.sky_split = 1;
    rays.sun_rows = 12;
    rays.sun_bins = 336;
    rays.rain_rays = 4;
    rays.bounces = 0;
    const light::Directions d = light::directions(site.latitude, {}, rays);
    std::vector<Vec3f> directions = d.sun;
    for (const auto& part : d.sky) directions.push_back(part.centre);
    const bench::RawScene raw(body.mesh);

    WeatherDay weather;
    weather.year = 2024;
    weather.month = 6;
    weather.day = 21;
    weather.possible_sunshine = possible_sunshine(site.latitude, 173);
    weather.sunshine = weather.possible_sunshine / 2;
    const std::vector<sun::Moment> moments = sun::moments_of_day(2024, 6, 21, site);
    const sun::Radiation radiation = sun::radiation(weather, site, moments);

    std::vector<std::int32_t> hidden;
    double count = 0;
    light::Coefficients thin, full, again;
    light::Light light;
    Bounds box;
    box.add({-1.3, 0.9, 0});
    box.add({1.1, 1.0, 1.2});
    struct Case {
        std::string name;
        int rounds;
        std::function<void()> work;
        std::function<std::string()> hash;
    };
    const std::vector<Case> cases = {
        {"bare Embree loop, 481 directions (peer)", 3,
         [&] { count = raw_rays(raw.scene, directions, sites, hidden); },
         [&] { return hash_of(hidden); }},
        {"trace, 481 directions", 3,
         [&] { thin = light::trace(sites, meshes, site.latitude, {}, rays, {}); },
         [&] { return hash_of(thin.bits); }},
        {"trace, all that is stored", 1,
         [&] { full = light::trace(sites, meshes, site.latitude, {}, {}, {}); },
         [&] { return hash_of(full.bits); }},
        {"retrace around a fence", 1,
         [&] { again = light::retrace(full, sites, meshes, std::span(&box, 1), {}); },
         [&] { return hash_of(again.bits); }},
        {"light of a day, 96 moments", 5,
         [&] { light = light::day(full, sites, moments, radiation); },
         [&] { return hash_of(light.total); }},
    };
    const std::vector<bench::Rounds> rounds = bench::in_turn(cases);
    for (std::size_t k = 0; k < rounds.size(); ++k) {
        const double seconds = median(rounds[k].seconds);
        std::string note = fmt::format("{:.2f} M sites/s", double(n) / seconds / 1e6);
        if (k / 2 < 2)
            note = fmt::format("{:.2f} M rays/s, {:.2f} of the peer", count / seconds / 1e6,
                               median(rounds[k % 2].seconds) / seconds);
        fmt::print("{}, {}, {}, {:.4f}, {}, {}\n", cases[k / 2].name, n, k % 2 + 1, seconds, note,
                   rounds[k].hash);
    }
    fmt::print("bytes a site: {} of bits, {} of links, 8 of V and e\n", full.words() * 4,
               full.links.size() * 4 / n);
}
