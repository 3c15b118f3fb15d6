#include <fmt/format.h>

#include <charconv>
#include <sstream>

#include "apps/points_csv.h"
#include "apps/stages/stages.h"
#include "core/error.h"
#include "core/file_output.h"
#include "solvers/joints/joints.h"
#include "solvers/lava/lava.h"

namespace sekitei::apps {
namespace {

/// Files of this stage beside the solver's own parameters.
struct Files {
    std::filesystem::path seeds;

    static void describe(auto&& field)
    {
        field("seeds", &Files::seeds, "CSV of seed points x,y,z [m] to use instead of sampling");
    }
};

class JointStage : public Stage {
public:
    const StageInfo& info() const override
    {
        static const StageInfo kInfo{
            "joint",
            "1",
            "grow contraction centre lines and split the rock into columns",
            OutputKind::Scene,
            true,
            {"region", "body_sdf", "slow_sdf", "temperature_gradient"},
            {"centre_lines", "column", "arc"},
            false,
            {"lava.preset"}};
        return kInfo;
    }

    ParamList params() override
    {
        ParamList list = describe_params(params_);
        for (Param& p : describe_params(files_)) list.push_back(std::move(p));
        return list;
    }
    void validate() override
    {
        joints::validate(params_);
        if (params_.target_cv) warn_unused(*this, {"maturity"}, "with target_cv");
        if (!files_.seeds.empty())
            warn_unused(*this,
                        {"spacing", "count", "seed_radius", "seed_mode", "maturity", "target_cv"},
                        "with seeds of your own");
    }

    Need estimate(SceneOutline& outline, const StageContext&) override
    {
        const double voxels = outline.lava_voxels;
        return {voxels, memory(voxels), voxels * (params_.arc ? 6 : 2)};
    }

    Json run(Scene& scene, const StageContext& context) override
    {
        joints::Inputs inputs{scene.ints("region"),
                              scene.floats("body_sdf"),
                              scene.floats("slow_sdf"),
                              scene.vectors("temperature_gradient"),
                              scene.domain,
                              scene.heat_domain,
                              {},
                              {}};
        if (const Json* made = params_of(scene, "lava"); made && made->contains("preset")) {
            lava::Params lava;
            find_param(describe_params(lava), "preset")->set((*made)["preset"]);
            inputs.default_count = lava::preset_defaults(lava.preset).seed_count;
        }
        if (!files_.seeds.empty())
            inputs.explicit_seeds = read_points_csv(resolve(context, files_.seeds));
        const double voxels = static_cast<double>(inputs.region.active_count());
        check_memory("joint", memory(voxels), context.memory_limit);

        joints::Result result = joints::run(inputs, params_, context.seed, context.progress);
        Json stops = Json::object();
        for (const StopReason reason : result.lines.stop) {
            const std::string name(choice_names(reason)[static_cast<std::size_t>(reason)]);
            stops[name] = stops.value(name, 0) + 1;
        }
        const std::size_t count = result.lines.count();
        Points points = to_points(result.lines, scene.domain.transform);
        points.stage = "joint";
        scene.points["centre_lines"] = std::move(points);
        scene.put("column", std::move(result.column), "joint");
        if (params_.arc) scene.put("arc", std::move(result.arc), "m", "joint");
        return {{"columns", count}, {"stops", stops}, {"voxels", voxels}};
    }

private:
    /// Bytes at the peak: columns, arcs, regions and buffers a voxel, and what does not grow with
    /// them.
    double memory(double voxels) const { return 1e8 + voxels * (params_.arc ? 11 : 7); }

    joints::Params params_;
    Files files_;
};

}  // namespace

std::vector<Vec3d> read_points_csv(const std::filesystem::path& path)
{
    std::vector<Vec3d> points;
    std::istringstream lines(read_file(path, 1ull << 30));
    std::size_t number = 0;
    for (std::string line; std::getline(lines, line);) {
        ++number;
        if (!line.empty() && line.back() == '\r') line.pop_back();
        if (line.empty() || line.front() == '#') continue;
        Vec3d p;
        const char* at = line.data();
        const char* const end = line.data() + line.size();
        for (int axis = 0; axis < 3; ++axis) {
            while (at < end && (*at == ' ' || *at == ',' || *at == '\t')) ++at;
            const auto [next, error] = std::from_chars(at, end, p[axis]);
            if (error != std::errc{} || !std::isfinite(p[axis]))
                throw InvalidInput(
                    fmt::format("{}:{}: '{}' is not a point; expected three numbers x,y,z [m]",
                                path.string(), number, line.substr(0, 60)));
            at = next;
        }
        points.push_back(p);
    }
    if (points.empty())
        throw InvalidInput(path.string() + ": no points in it; expected lines x,y,z [m]");
    return points;
}

std::unique_ptr<Stage> make_joint()
{
    return std::make_unique<JointStage>();
}

}  // namespace sekitei::apps
