#include <fmt/format.h>

#include <bit>
#include <cstring>

#include "apps/stages/stages.h"
#include "core/error.h"
#include "core/parallel.h"

namespace sekitei::apps {
namespace {

struct ExportParams {
    std::string points = "moss";

    static void describe(auto&& field)
    {
        field("points", &ExportParams::points, "points of the scene to write");
    }
};

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
            [&](const auto& list) {
                if (list.size() != count)
                    throw InvalidInput(
                        fmt::format("export: attribute {} has {} values, must have {}", name,
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

class ExportStage : public Stage {
public:
    const StageInfo& info() const override
    {
        static const StageInfo kInfo{"export",
                                     "1",
                                     "write points with their attributes as PLY, for instancing",
                                     OutputKind::Points,
                                     true,
                                     {"moss"},
                                     {}};
        return kInfo;
    }
    std::vector<std::string> needs() override { return {params_.points}; }
    ParamList params() override { return describe_params(params_); }
    void validate() override
    {
        if (params_.points.empty()) throw InvalidParameter("export: points: which?");
    }
    Need estimate(SceneOutline& outline, const StageContext&) override
    {
        return {0, 1e8, outline.surface_cells * 80};
    }
    Json run(Scene& scene, const StageContext& context) override
    {
        const Points& points = scene.points_of(params_.points);
        table = encode_points(points, context.progress);
        return {{"points", points.position.size()}};
    }

private:
    ExportParams params_;
};

}  // namespace

std::unique_ptr<Stage> make_export()
{
    return std::make_unique<ExportStage>();
}

}  // namespace sekitei::apps
