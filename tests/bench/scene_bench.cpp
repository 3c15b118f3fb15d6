// Whole scenes at the paper's sizes: seconds a stage, one and two threads, median of five, and the
// peak memory of the process. The paper's own times: cliff 1464 s, tower 541 s, coast 1593 s
// (Pentium IV).
//
//     scene_bench [cliff|tower|coast|large ...]   default: the first three; large: 1000 x 1000 x
//     400 once
#include <fmt/format.h>
#include <sys/resource.h>

#include <algorithm>
#include <chrono>
#include <map>
#include <string>
#include <vector>

#include "apps/stage.h"
#include "core/hash.h"
#include "core/log.h"
#include "core/mesh_io.h"
#include "core/parallel.h"
#include "core/vec.h"

namespace sekitei {
namespace {

using Settings = std::vector<std::pair<std::string, std::string>>;  // "joint.count", "400"

struct Case {
    std::string name;
    Settings settings;
};

const std::vector<Case> kCases{
    {"cliff",
     {{"lava.preset", "cliff"},
      {"joint.count", "250"},
      {"weather.cut", "perpendicular"},
      {"weather.ramp", "cliff"}}},
    {"tower",
     {{"lava.preset", "tower"},
      {"joint.count", "400"},
      {"weather.cut", "perpendicular"},
      {"weather.ramp", "tower"}}},
    {"coast", {{"lava.preset", "coast"}, {"joint.count", "1200"}, {"weather.cut", "horizontal"}}},
    {"large",
     {{"lava.preset", "coast"},
      {"lava.size", "40m,40m,16m"},
      {"lava.voxel", "4cm"},
      {"joint.count", "4000"},
      {"weather.cut", "perpendicular"},
      {"weather.ramp", "cliff"}}},
};

double now()
{
    return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch())
        .count();
}

/// Runs all stages of a case; returns seconds by stage and the hash of the mesh.
std::map<std::string, double> once(const Case& c, std::string& hash, double& voxels)
{
    std::map<std::string, double> seconds;
    Scene scene;
    for (const char* name : {"lava", "cool", "joint", "weather", "mesh"}) {
        const auto stage = apps::make_stage(name);
        for (const auto& [key, value] : c.settings)
            if (key.starts_with(std::string(name) + "."))
                find_param(stage->params(), key.substr(key.find('.') + 1))->set_text(value);
        apps::StageContext context;
        context.seed = 7;
        context.folder = ".";
        scene.history.push_back(apps::history_of(*stage, context));
        const double start = now();
        stage->run(scene, context);
        seconds[name] = now() - start;
        seconds["total"] += seconds[name];
    }
    voxels = static_cast<double>(scene.ints("region").active_count());
    hash = hash_hex(encode_mesh(scene.meshes.at("rock"), ".ply")).substr(0, 16);
    return seconds;
}

void bench(const Case& c, int repeats)
{
    std::map<std::string, double> single;
    for (const std::size_t threads : {1u, 2u}) {
        if (c.name == "large" && threads == 1) continue;
        const ThreadLimit limit(threads);
        std::map<std::string, std::vector<double>> all;
        std::string hash;
        double voxels = 0;
        for (int i = 0; i < repeats; ++i)
            for (const auto& [stage, s] : once(c, hash, voxels)) all[stage].push_back(s);
        for (auto& [stage, list] : all) {
            std::sort(list.begin(), list.end());
            const double median = list[list.size() / 2];
            if (threads == 1) single[stage] = median;
            const double ratio = single.contains(stage) ? single[stage] / median : 0;
            fmt::print("{} {:<8} voxels {:.0f} threads {} seconds {:.3f} speed-up {:.2f} hash {}\n",
                       c.name, stage, voxels, threads, median, ratio, hash);
        }
        rusage usage{};
        getrusage(RUSAGE_SELF, &usage);
        fmt::print("{} peak memory of the process so far {:.2f} GB\n", c.name,
                   static_cast<double>(usage.ru_maxrss) / 1e6);
        std::fflush(stdout);
    }
}

}  // namespace
}  // namespace sekitei

int main(int argc, char** argv)
{
    sekitei::log::set_level(sekitei::log::Level::Warning);
    std::vector<std::string> wanted(argv + 1, argv + argc);
    if (wanted.empty()) wanted = {"cliff", "tower", "coast"};
    for (const sekitei::Case& c : sekitei::kCases)
        if (std::find(wanted.begin(), wanted.end(), c.name) != wanted.end())
            sekitei::bench(c, c.name == "large" ? 1 : 5);
}
