#include <fmt/format.h>

#include <bit>
#include <cstring>

#include "apps/stages/stages.h"
#include "core/error.h"

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

template <class T>
void put(std::string& bytes, T value)
{
    char raw[sizeof(T)];
    std::memcpy(raw, &value, sizeof(T));
    bytes.append(raw, sizeof(T));
}

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

}  // namespace

std::string encode_points(const Points& points)
{
    std::string header = fmt::format(
        "ply\nformat binary_little_endian 1.0\ncomment metres, z up\nelement vertex {}\n"
        "property double x\nproperty double y\nproperty double z\n",
        points.position.size());
    for (const auto& [name, values] : points.attributes) {
        const Property property = property_of(name, values);
        for (const std::string& part : property.names)
            header += fmt::format("property {} {}\n", property.type, part);
    }
    std::string bytes = header + "end_header\n";
    for (std::size_t i = 0; i < points.position.size(); ++i) {
        for (int axis = 0; axis < 3; ++axis) put(bytes, points.position[i][axis]);
        for (const auto& [name, values] : points.attributes)
            std::visit(
                [&](const auto& list) {
                    using T = typename std::decay_t<decltype(list)>::value_type;
                    if constexpr (std::is_same_v<T, std::int64_t>)
                        put(bytes, static_cast<double>(list[i]));
                    else if constexpr (std::is_arithmetic_v<T>)
                        put(bytes, list[i]);
                    else if constexpr (std::is_same_v<T, Vec3f>) {
                        put(bytes, list[i].x);
                        put(bytes, list[i].y);
                        put(bytes, list[i].z);
                    } else
                        for (const float part : list[i]) put(bytes, part);
                },
                values);
    }
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
    Json run(Scene& scene, const StageContext&) override
    {
        const Points& points = scene.points_of(params_.points);
        table = encode_points(points);
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
