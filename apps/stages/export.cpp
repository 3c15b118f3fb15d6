#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <memory>

#include "apps/exchange/stage.h"
#include "apps/stages/stages.h"
#include "core/error.h"
#include "core/parallel.h"

namespace sekitei::apps {
namespace {

static_assert(std::endian::native == std::endian::little, "PLY is written as it lies in memory");

/// How an attribute's values stand in a PLY file: properties of one type, several for vectors.
struct Property {
    std::string type;
    std::vector<std::string> names;
};

Property property_of(const std::string& name, const Points::Attribute& values)
{
    struct Visitor {
        const std::string& name;
        Property operator()(const std::vector<float>&) const { return {"float", {name}}; }
        Property operator()(const std::vector<double>&) const { return {"double", {name}}; }
        Property operator()(const std::vector<std::int32_t>&) const { return {"int", {name}}; }
        // PLY knows no 64-bit integers; ids stay exact up to 2^53.
        Property operator()(const std::vector<std::int64_t>&) const { return {"double", {name}}; }
        Property operator()(const std::vector<Vec3f>&) const
        {
            if (name == "N") return {"float", {"nx", "ny", "nz"}};
            return {"float", {name + "_x", name + "_y", name + "_z"}};
        }
        Property operator()(const std::vector<std::array<float, 4>>&) const
        {
            return {"float", {name + "_x", name + "_y", name + "_z", name + "_w"}};
        }
    };
    return std::visit(Visitor{name}, values);
}

template <class T>
void put(char* to, const T& value)
{
    if constexpr (std::is_same_v<T, std::int64_t>) {
        const auto number = static_cast<double>(value);
        std::memcpy(to, &number, sizeof number);
    } else
        std::memcpy(to, &value, sizeof value);
}

}  // namespace

std::string encode_points(const Points& points, const Progress& progress)
{
    const std::size_t count = points.position.size();
    std::string bytes = fmt::format(
        "ply\nformat binary_little_endian 1.0\ncomment metres, z up\nelement vertex {}\n"
        "property double x\nproperty double y\nproperty double z\n",
        count);
    std::size_t row = 3 * sizeof(double);
    std::vector<std::pair<std::size_t, const Points::Attribute*>> columns;  // by place in the row
    for (const auto& [name, values] : points.attributes) {
        const Property property = property_of(name, values);
        for (const std::string& part : property.names)
            bytes += fmt::format("property {} {}\n", property.type, part);
        columns.emplace_back(row, &values);
        std::visit(
            [&, attribute = &name](const auto& list) {
                if (list.size() != count)
                    throw InvalidInput(
                        fmt::format("export: attribute {} has {} values, must have {}", *attribute,
                                    list.size(), count));
                row += sizeof(list[0]);  // as long in the file as in memory
            },
            values);
    }
    bytes += "end_header\n";
    const std::size_t first = bytes.size();
    bytes.resize(first + count * row);
    parallel_for_range(
        count,
        [&](std::size_t begin, std::size_t end) {
            progress.check();
            char* const rows = bytes.data() + first;
            for (std::size_t i = begin; i < end; ++i)
                for (int axis = 0; axis < 3; ++axis)
                    put(rows + i * row + static_cast<std::size_t>(axis) * sizeof(double),
                        plain_zero(points.position[i][axis]));
            for (const auto& [place, values] : columns)
                std::visit(
                    [&, at = place](const auto& list) {
                        for (std::size_t i = begin; i < end; ++i)
                            put(rows + i * row + at, plain_zero(list[i]));
                    },
                    *values);
        },
        1 << 14);
    return bytes;
}

namespace {

/// What no file of pictures shows, and what may be large.
constexpr std::array<const char*, 12> kNotShown{
    "vel",           "temperature_gradient", "temperature_gradient_mag",
    "region",        "weathering",           "centre_lines",
    "seeds",         "statistics",           "forest_trees",
    "forest_growth", "tree_growth",          "photons"};
/// What the mesh of a rock comes from.
constexpr std::array<const char*, 4> kRockVolumes{"density", "column", "component", "surface"};

class ExportStage : public ExportingStage {
public:
    const StageInfo& info() const override
    {
        static const StageInfo kInfo{
            "export",
            "2",
            "write what other programs open: glTF, USD, instances, meshes, maps, points",
            OutputKind::Points,
            true,
            {"moss"},
            {},
            false,
            {"moss", "lantern", "tree", "forest"},
            true};
        return kInfo;
    }
    void asked_for(const std::vector<std::string>& files) override
    {
        points_ = files.empty();
        scenes_ = false;
        for (const std::string& file : files) {
            const std::string suffix = std::filesystem::path(file).extension().string();
            points_ = points_ || suffix == ".ply";
            scenes_ = scenes_ || suffix != ".ply";
        }
    }
    std::vector<std::string> needs() override
    {
        return points_ ? std::vector<std::string>{params_.points} : std::vector<std::string>{};
    }
    std::vector<std::string> uses() override
    {
        return scenes_ ? assembly_uses() : std::vector<std::string>{};
    }
    std::vector<std::string> chooses(const std::vector<std::string>& present) const override
    {
        if (!scenes_) return {};
        std::vector<std::string> names;
        const bool rock = std::ranges::find(present, "rock") != present.end();
        for (const std::string& name : present) {
            if (points_ && name == params_.points) continue;
            if (std::ranges::find(kNotShown, name) != kNotShown.end()) continue;
            if (rock && std::ranges::find(kRockVolumes, name) != kRockVolumes.end()) continue;
            names.push_back(name);
        }
        return names;
    }
    ParamList params() override { return describe_params(params_); }
    void validate() override
    {
        validate_described("export", params_);
        if (params_.points.empty()) throw InvalidParameter("export: points: which?");
    }
    Need estimate(SceneOutline& outline, const StageContext&) override
    {
        const double triangles =
            50 * std::pow(std::max(1.0, outline.lava_voxels), 2.0 / 3) + 4 * outline.surface_cells;
        return {0, 1e8 + (scenes_ ? triangles * 150 : 0), outline.surface_cells * 80};
    }
    Json run(Scene& scene, const StageContext& context) override
    {
        Json summary = Json::object();
        table.clear();
        if (points_) {
            const Points& points = scene.points_of(params_.points);
            table = encode_points(points, context.progress);
            summary["points"] = points.position.size();
        }
        if (scenes_) {
            const Assembly& all = gathered(scene, context);
            summary["surfaces"] = all.surfaces.size();
            summary["triangles"] = all.triangles();
            summary["copies"] = all.copies();
        }
        return summary;
    }
    void write(const Scene& scene, const std::filesystem::path& path,
               const StageContext& context) override
    {
        std::filesystem::path own = path;
        // A file beside another is asked for by itself here.
        if (path.extension() == ".mtl") own.replace_extension(".obj");
        if (path.extension() == ".json") own.replace_extension(".png");
        for (const ExportFile& file : files_of(own, params_.points, params_.map))
            if (file.path == path) {
                const bool shown = wants_assembly(file.kind);
                write_export(file, scene, shown ? &gathered(scene, context) : nullptr,
                             options(context), context.progress);
            }
    }
    void done() override
    {
        all_.reset();
        of_ = nullptr;
    }
    ExportOptions options(const StageContext& context) const override
    {
        ExportOptions o;
        o.assembly.trees = params_.trees;
        o.assembly.moss_lod = params_.moss_lod;
        o.assembly.season = params_.season;
        o.assembly.leaf_scale = params_.leaf_scale;
        o.assembly.tuft_size = params_.tuft_size;
        o.assembly.fields = params_.fields;
        o.assembly.seed = context.seed;
        o.assembly.memory_limit = context.memory_limit;
        o.metres_per_pixel = params_.metres_per_pixel;
        o.half = params_.half;
        return o;
    }

private:
    const Assembly& gathered(const Scene& scene, const StageContext& context)
    {
        if (!all_ || of_ != &scene) {
            all_ = std::make_unique<Assembly>(
                assemble(scene, options(context).assembly, context.progress.named("gathering")));
            of_ = &scene;
        }
        return *all_;
    }

    ExportParams params_;
    bool points_ = true, scenes_ = false;
    std::unique_ptr<Assembly> all_;
    const Scene* of_ = nullptr;
};

}  // namespace

std::unique_ptr<Stage> make_export()
{
    return make_exporting_stage();
}

std::unique_ptr<ExportingStage> make_exporting_stage()
{
    return std::make_unique<ExportStage>();
}

}  // namespace sekitei::apps
