#include "solvers/wind/wind.h"

#include <fmt/format.h>

#include <cstring>
#include <filesystem>

#include "apps/climate.h"
#include "apps/stages/stages.h"
#include "apps/wind_checkpoint.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/hash.h"
#include "core/log.h"

namespace sekitei::apps {
namespace {

namespace fs = std::filesystem;

class WindStage : public Stage {
public:
    const StageInfo& info() const override
    {
        static const StageInfo kInfo = [] {
            StageInfo info{
                "wind",
                "2",
                "wind before an object and beside each of its cells, for eight directions",
                OutputKind::Scene,
                true,
                {"surface_sdf", "surf_normal", "surf_area"},
                {"air_tables"}};
            for (int k = 0; k < 8; ++k) info.makes.push_back(fmt::format("wind_ratio_{}", k));
            return info;
        }();
        return kInfo;
    }
    std::vector<std::string> uses() override
    {
        return {"obstacle_sdf", "water_surface", "canopy_RU"};
    }
    ParamList params() override { return describe_params(params_); }
    void validate() override { wind::validate(params_); }

    Need estimate(SceneOutline& outline, const StageContext&) override
    {
        return {outline.surface_cells, 2e8 + outline.surface_cells * 500,
                outline.surface_cells * 40};
    }

    Json run(Scene& scene, const StageContext& context) override
    {
        const SurfaceCells cells =
            surface_cells(scene.floats("surface_sdf"), scene.vectors("surf_normal"),
                          scene.floats("surf_area"), context.progress.slice(0, 0.01));
        wind::Params params = params_;
        if (!params.ground && scene.domain.dims.z > 0)
            params.ground = scene.domain.transform.origin.z;
        wind::Inputs inputs;
        inputs.object = &scene.floats("surface_sdf");
        if (scene.has("obstacle_sdf")) inputs.obstacle = &scene.floats("obstacle_sdf");
        if (scene.has("water_surface")) inputs.water = &scene.ints("water_surface");
        if (scene.has("canopy_RU")) inputs.canopy = &scene.floats("canopy_RU");
        inputs.cells = cells.position;
        const wind::Plan plan = wind::plan(inputs, params);
        check_memory("wind", plan.bytes, context.memory_limit);

        const fs::path& file = context.checkpoint;
        wind::State before;
        std::string identity;
        if (!file.empty()) {
            std::string all = params_json(describe_params(params)).dump();
            for (const char* name :
                 {"surface_sdf", "surf_area", "obstacle_sdf", "water_surface", "canopy_RU"})
                if (scene.has(name)) all += name + content_hash(scene.grids.at(name));
            identity = hash_hex(all);
            if (fs::exists(file)) {
                before = decode_wind(read_file(file, 1ull << 36), file.string(), identity);
                log::info("wind: going on where an earlier run stopped");
            }
        }
        const wind::Result result =
            wind::run(inputs, params, context.progress.slice(0.01, 1), std::move(before),
                      [&](const wind::State& state) {
                          if (!file.empty()) write_file(file, encode_wind(state, identity));
                      });
        for (const std::string& note : result.notes) {
            if (std::find(plan.notes.begin(), plan.notes.end(), note) == plan.notes.end())
                log::warning("wind: {}", note);
            else
                log::info("wind: {}", note);
        }
        for (std::size_t k = 0; k < 8; ++k)
            scene.put(fmt::format("wind_ratio_{}", k), cells.to_grid(result.ratio[k]), "", "wind");
        scene.points["air_tables"] = table_points(result.tables);
        if (!file.empty()) {
            std::error_code ignored;
            fs::remove(file, ignored);
        }
        Json summary = {{"garden_spacing", plan.garden_spacing},
                        {"object_spacing", plan.object_spacing}};
        auto rounded = [](const wind::AirTables::Table& values) {
            Json list = Json::array();
            for (const double v : values) list.push_back(std::round(v * 1000) / 1000);
            return list;
        };
        summary["A_U"] = rounded(result.tables.speed);
        summary["A_T"] = rounded(result.tables.temperature);
        if (!result.notes.empty()) summary["notes"] = result.notes;
        return summary;
    }

private:
    wind::Params params_;
};

}  // namespace

std::string encode_wind(const wind::State& state, const std::string& identity)
{
    Json json = {{"wind", 1},
                 {"identity", identity},
                 {"garden", state.garden},
                 {"object", state.object},
                 {"warnings", state.warnings},
                 {"A_U", state.tables.speed},
                 {"A_T", state.tables.temperature},
                 {"A_q", state.tables.humidity},
                 {"direction", state.tables.direction},
                 {"layers", state.tables.layers},
                 {"layer_base", state.tables.layer_base},
                 {"layer_height", state.tables.layer_height}};
    for (const std::vector<float>& ratios : state.arrival) {
        std::vector<std::uint8_t> bytes(ratios.size() * sizeof(float));
        if (!bytes.empty()) std::memcpy(bytes.data(), ratios.data(), bytes.size());
        json["arrival"].push_back(Json::binary(std::move(bytes)));
    }
    const std::vector<std::uint8_t> packed = Json::to_cbor(json);
    const std::string body(packed.begin(), packed.end());
    return hash_hex(body) + body;
}

wind::State decode_wind(const std::string& bytes, const std::string& where,
                        const std::string& identity)
{
    constexpr std::size_t kHash = 32;
    if (bytes.size() < kHash || hash_hex(bytes.substr(kHash)) != bytes.substr(0, kHash))
        throw InvalidInput(fmt::format("{}: a damaged checkpoint; remove it to begin anew", where));
    try {
        const Json json = Json::from_cbor(bytes.begin() + kHash, bytes.end());
        if (json.at("wind") != 1 || json.at("identity") != identity)
            throw InvalidInput(fmt::format(
                "{}: a checkpoint of another scene or of other parameters; remove it to begin anew",
                where));
        wind::State state;
        state.garden = json.at("garden");
        state.object = json.at("object");
        state.warnings = json.at("warnings");
        state.tables.speed = json.at("A_U");
        state.tables.temperature = json.at("A_T");
        state.tables.humidity = json.at("A_q");
        state.tables.direction = json.at("direction");
        state.tables.layers = json.at("layers").get<std::vector<wind::AirTables::Table>>();
        state.tables.layer_base = json.at("layer_base");
        state.tables.layer_height = json.at("layer_height");
        for (std::size_t k = 0; k < 8; ++k) {
            const auto& binary = json.at("arrival").at(k).get_binary();
            state.arrival[k].resize(binary.size() / sizeof(float));
            if (!binary.empty())
                std::memcpy(state.arrival[k].data(), binary.data(),
                            state.arrival[k].size() * sizeof(float));
        }
        return state;
    } catch (const Json::exception& error) {
        throw InvalidInput(
            fmt::format("{}: not a checkpoint of the wind: {}", where, error.what()));
    }
}

std::unique_ptr<Stage> make_wind()
{
    return std::make_unique<WindStage>();
}

}  // namespace sekitei::apps
