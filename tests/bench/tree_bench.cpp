// Light of leaf-balls in crowns. Prints: case, balls, patches, threads, seconds and balls a second
// of the best round, seconds of processor, hash. Then how much faster sweep is than all pairs, and
// two threads than one.

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <string>
#include <vector>

#include "core/error.h"
#include "core/math.h"
#include "core/parallel.h"
#include "core/random.h"
#include "solvers/tree/crown_light.h"
#include "tests/bench/measure.h"

namespace {

using namespace sekitei;
using namespace sekitei::tree;

/// Balls of radius 2 in the outer part of a crown, as thin as growth keeps it: half-lines meet
/// about ten, however many there are.
Balls crown(std::size_t n, Vec3d middle = {})
{
    Balls balls;
    const double size = 0.5 * std::sqrt(static_cast<double>(n));
    for (std::uint64_t i = 0; i < n; ++i) {
        auto draw = [&](std::uint64_t what) { return uniform_of_key(hash2(n, what), i); };
        const double z = 1.6 * draw(1) - 0.6, a = 2 * math::kPi * draw(2),
                     out = size * std::cbrt(0.4 + 0.6 * draw(3)), s = std::sqrt(1 - z * z);
        balls.centre.push_back(middle +
                               Vec3d(out * s * math::cos(a), out * s * math::sin(a), out * z));
        balls.radius.push_back(2);
    }
    return balls;
}

Balls forest(std::size_t n, int trees)
{
    Balls all;
    const std::size_t each = n / static_cast<std::size_t>(trees * trees);
    for (int i = 0; i < trees; ++i)
        for (int j = 0; j < trees; ++j) {
            const double apart = 1.0 * std::sqrt(static_cast<double>(each));
            const Balls one = crown(each, Vec3d(i, j, 0) * apart);
            all.centre.insert(all.centre.end(), one.centre.begin(), one.centre.end());
            all.radius.insert(all.radius.end(), one.radius.begin(), one.radius.end());
        }
    return all;
}

Lookers all_of(const Balls& balls)
{
    Lookers lookers{balls.centre, {}};
    for (std::uint32_t i = 0; i < balls.size(); ++i) lookers.own.push_back(i);
    return lookers;
}

struct Case {
    std::string name;
    std::size_t balls;
    int rounds;
    std::function<void()> work;
    std::function<std::string()> hash;
};

}  // namespace

/// Arguments: the largest crown for all methods, balls of the forest for grid; 100000 1000000.
int main(int argc, char** argv)
{
    const std::size_t most = argc > 1 ? std::strtoull(argv[1], nullptr, 10) : 100'000,
                      stand = argc > 2 ? std::strtoull(argv[2], nullptr, 10) : 1'000'000;
    const SkyPatches sky = sky_patches(8, 16, 3, 2);
    CrownLight light;
    std::vector<Case> cases;
    auto add = [&](Method method, const Balls& balls, int rounds) {
        const Lookers lookers = all_of(balls);
        cases.push_back({std::string(choice_names(method)[static_cast<std::size_t>(method)]),
                         balls.size(), rounds,
                         [&light, &sky, balls, lookers, method] {
                             light = crown_light(sky, balls, lookers, {.method = method}, {}, {});
                         },
                         [&light] { return bench::hash_of(light.light); }});
    };
    for (const std::size_t n : {1000, 4000, 10'000, 40'000, 100'000})
        if (n <= most) add(Method::Sweep, crown(n), n <= 10'000 ? 9 : 3);
    if (most >= 10'000) {
        add(Method::Naive, crown(10'000), 1);
        add(Method::Bvh, crown(10'000), 1);
        add(Method::Grid, crown(10'000), 1);
    }
    if (stand > 0) add(Method::Grid, forest(stand, 10), 1);

    const auto rounds = bench::in_turn(cases);
    double sweep = 0, naive = 0;
    for (std::size_t c = 0; c < cases.size(); ++c) {
        double seconds[2];
        for (const std::size_t threads : {1u, 2u}) {
            const bench::Rounds& r = rounds[2 * c + threads - 1];
            seconds[threads - 1] = *std::min_element(r.seconds.begin(), r.seconds.end());
            fmt::print(
                "{:6} {:8} balls {} patches {} threads {:9.4f} s {:10.0f} balls/s  "
                "cpu {:8.4f} s  {}\n",
                cases[c].name, cases[c].balls, sky.size(), threads, seconds[threads - 1],
                static_cast<double>(cases[c].balls) / seconds[threads - 1],
                *std::min_element(r.processor.begin(), r.processor.end()), r.hash);
        }
        fmt::print("{:6} {:8} two threads over one: {:.2f}\n", "", "", seconds[0] / seconds[1]);
        if (cases[c].balls == 10'000 && cases[c].name == "sweep") sweep = seconds[1];
        if (cases[c].name == "naive") naive = seconds[1];
    }
    if (sweep > 0 && naive > 0) fmt::print("sweep over naive at 10000: {:.1f}\n", naive / sweep);
}
