#include "solvers/lava/lava.h"

#include <fmt/format.h>

#include "apps/stages/stages.h"
#include "core/error.h"
#include "core/log.h"
#include "core/mesh_io.h"
#include "grids/vdb_file.h"

namespace sekitei::apps {
namespace {

/// How a file is read, beside the solver's own parameters.
struct FileForm {
    UpAxis mesh_up = UpAxis::Z;

    static void describe(auto&& field)
    {
        field("mesh_up", &FileForm::mesh_up,
              "axis of the mesh file that points up; (x, y, z) with y up becomes (x, -z, y)");
    }
};

/// Region ids written as floats, by programs that have no integer grids.
/// @throws InvalidInput  a value that is not 0, 1 or 2
IntGrid whole_numbers(const FloatGrid& floats, const std::string& file)
{
    auto id_of = [&](float value) {
        const auto id = static_cast<std::int32_t>(value);
        if (static_cast<float>(id) != value || id < lava::kLava || id > lava::kSlow)
            throw InvalidInput(fmt::format(
                "{}: grid 'region' holds {}, must be 0 (lava), 1 (cold) or 2 (slow)", file, value));
        return id;
    };
    auto ids =
        IntGrid::uninitialised(floats.topology(), floats.transform(), id_of(floats.background()));
    for (std::size_t leaf = 0; leaf < floats.leaf_count(); ++leaf) {
        ids.mask(leaf) = floats.mask(leaf);
        for (int k = 0; k < kLeafSize; ++k) ids.values(leaf)[k] = id_of(floats.at(leaf, k));
    }
    ids.compress();
    return ids;
}

class LavaStage : public Stage {
public:
    const StageInfo& info() const override
    {
        static const StageInfo kInfo{
            "lava", "1", "make the body of lava and its surroundings",       OutputKind::Scene,
            false,  {},  {"region", "region_coarse", "body_sdf", "slow_sdf"}};
        return kInfo;
    }

    ParamList params() override
    {
        ParamList list = describe_params(params_);
        for (Param& p : describe_params(form_)) list.push_back(std::move(p));
        return list;
    }
    void validate() override
    {
        lava::validate(params_);
        const std::string why =
            fmt::format("with preset = {}",
                        choice_names(params_.preset)[static_cast<std::size_t>(params_.preset)]);
        const bool map = params_.preset == lava::Preset::HeightMap;
        const bool mesh = params_.preset == lava::Preset::Mesh;
        const bool volume = params_.preset == lava::Preset::Volume;
        if (!map)
            warn_unused(*this,
                        {"height_map", "metres_per_pixel", "height_low", "height_high", "base",
                         "cold_ground"},
                        why);
        if (!mesh)
            warn_unused(*this,
                        {"mesh", "mesh_scale", "mesh_up", "strict", "slow_slope", "slow_group",
                         "slow_thickness"},
                        why);
        if (!volume) warn_unused(*this, {"volume"}, why);
        if (!map && !mesh && !volume)
            warn_unused(*this, {"slow", "slow_below", "margin"}, why);
        else
            warn_unused(*this, {"noise_amplitude", "noise_beta"}, why);
    }

    Need estimate(SceneOutline& outline, const StageContext& context) override
    {
        load(context);
        const lava::Estimate e = estimated(context);
        outline.domain.dims = e.dims;
        outline.domain.transform.voxel = e.voxel;
        outline.heat_domain.dims = e.heat_dims;
        outline.heat_domain.transform.voxel = e.heat_cell;
        outline.lava_voxels = e.voxels;
        return {e.voxels, e.bytes, e.bytes / 8};
    }

    Json run(Scene& scene, const StageContext& context) override
    {
        load(context);
        const lava::Estimate e = estimated(context);
        check_memory("lava", e.bytes, context.memory_limit);
        lava::Result result = [&] {
            try {
                return lava::run(inputs_, params_, context.seed, context.progress);
            } catch (const InvalidInput& error) {
                throw named_after(source_file(context), error);
            }
        }();
        scene.domain = result.domain;
        scene.heat_domain = result.heat_domain;
        const double voxels = static_cast<double>(result.region.active_count());
        scene.put("region", std::move(result.region), "lava");
        scene.put("region_coarse", std::move(result.region_coarse), "lava");
        scene.put("body_sdf", std::move(result.body_sdf), "m", "lava", GridClass::LevelSet);
        scene.put("slow_sdf", std::move(result.slow_sdf), "m", "lava", GridClass::LevelSet);
        const Coord d = scene.domain.dims;
        return {{"voxels", voxels},
                {"dims", {d.x, d.y, d.z}},
                {"voxel_m", scene.domain.transform.voxel}};
    }

private:
    lava::Estimate estimated(const StageContext& context) const
    {
        try {
            return lava::estimate(params_, inputs_);
        } catch (const InvalidInput& error) {
            throw named_after(source_file(context), error);
        }
    }

    /// The file that the preset reads; empty: none.
    std::string source_file(const StageContext& context) const
    {
        switch (params_.preset) {
            case lava::Preset::HeightMap:
                return resolve(context, params_.height_map).string();
            case lava::Preset::Mesh:
                return resolve(context, params_.mesh).string();
            case lava::Preset::Volume:
                return resolve(context, params_.volume).string();
            default:
                return "";
        }
    }

    /// Reads the file that the preset names, once.
    void load(const StageContext& context)
    {
        if (loaded_) return;
        auto required = [&](const std::filesystem::path& path, const char* option) {
            if (path.empty())
                throw InvalidParameter(fmt::format(
                    "lava: preset {} needs a file: {}",
                    choice_names(params_.preset)[static_cast<std::size_t>(params_.preset)],
                    option));
            return resolve(context, path);
        };
        if (params_.preset == lava::Preset::HeightMap)
            inputs_.height_map = read_png_grey16(required(params_.height_map, "height_map"));
        if (params_.preset == lava::Preset::Mesh) {
            MeshReadReport report;
            inputs_.mesh = read_mesh(required(params_.mesh, "mesh"), &report);
            raise_up(*inputs_.mesh, form_.mesh_up);
            inputs_.mesh_groups = report.groups;
            log_mesh_report(resolve(context, params_.mesh), report);
        }
        if (params_.preset == lava::Preset::Volume) {
            ReadOptions options;
            options.fix_nan = context.fix_nan;
            options.memory_limit = context.memory_limit;
            volume_ = read_vdb(required(params_.volume, "volume"), options, context.progress);
            if (const auto region = volume_.grids.find("region"); region != volume_.grids.end())
                if (const auto* floats = std::get_if<FloatGrid>(&region->second.values))
                    volume_.put("region", whole_numbers(*floats, params_.volume.string()), "");
            inputs_.volume = &volume_;
        }
        loaded_ = true;
    }

    lava::Params params_;
    FileForm form_;
    lava::Inputs inputs_;
    Scene volume_;
    bool loaded_ = false;
};

}  // namespace

std::unique_ptr<Stage> make_lava()
{
    return std::make_unique<LavaStage>();
}

}  // namespace sekitei::apps
