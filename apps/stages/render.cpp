#include "apps/render/render.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>

#include "apps/habitat.h"
#include "apps/stages/scenery.h"
#include "apps/stages/stages.h"
#include "core/error.h"

namespace sekitei::apps {
namespace {

/// What chooses between a view of the surface and a slice.
struct SliceChoice {
    std::string slice;
    std::string axis = "x";
    std::optional<double> at, low, high;

    static void describe(auto&& field)
    {
        field("slice", &SliceChoice::slice,
              "grid to cut through instead of looking at the surface");
        field("axis", &SliceChoice::axis, "with slice: normal of the plane, x, y or z");
        field("at", &SliceChoice::at, "m", kAny,
              "with slice: position of the plane; auto: the middle");
        field("low", &SliceChoice::low, "", kAny,
              "with slice: value at the lower end of the colour bar");
        field("high", &SliceChoice::high, "", kAny,
              "with slice: value at the upper end of the colour bar");
    }
};

/// What is shown besides the rock.
struct Scenery {
    bool moss = true;
    std::optional<double> tuft_size;
    bool photons = true;
    std::optional<double> photon_size;

    static void describe(auto&& field)
    {
        field("moss", &Scenery::moss, "mosses of the scene as plants");
        field("tuft_size", &Scenery::tuft_size, "m", kPositive,
              "diameter of a full-grown moss; auto: 1.6 surface cells, "
              "1.15 sizes of those on a mesh");
        field("photons", &Scenery::photons,
              "where no moss is shown: the photons that the light stage kept, as dots");
        field("photon_size", &Scenery::photon_size, "m", kPositive,
              "diameter of a photon's dot; auto: a 240th of the surface");
    }
};

class RenderStage : public Stage {
public:
    const StageInfo& info() const override
    {
        static const StageInfo kInfo{"render",
                                     "2",
                                     "make a picture of the rock or of a slice through a volume",
                                     OutputKind::Picture,
                                     true,
                                     {"rock"},
                                     {},
                                     false,
                                     {"moss", "lantern"},
                                     true};
        return kInfo;
    }

    std::vector<std::string> needs() override
    {
        return {choice_.slice.empty() ? std::string("rock") : choice_.slice};
    }
    std::vector<std::string> uses() override
    {
        if (!choice_.slice.empty()) return {};
        std::vector<std::string> names = scenery_uses();
        if (scenery_.moss) names.push_back("moss");
        if (scenery_.photons) names.push_back("photons");
        if (!params_.field.empty()) names.push_back(grid_of_field(params_.field));
        return names;
    }

    ParamList params() override
    {
        ParamList list = describe_params(params_);
        for (Param& p : describe_params(scenery_)) list.push_back(std::move(p));
        for (Param& p : describe_params(choice_)) list.push_back(std::move(p));
        return list;
    }
    void validate() override
    {
        render::validate(params_);
        if (choice_.slice.empty())
            warn_unused(*this, {"axis", "at", "low", "high"}, "without slice");
        if (choice_.axis != "x" && choice_.axis != "y" && choice_.axis != "z")
            throw InvalidParameter(
                fmt::format("render: axis = {}, must be x, y or z", choice_.axis));
        if (!choice_.slice.empty() && params_.width < 200)
            throw InvalidParameter(fmt::format(
                "render: width = {}, must be at least 200 with slice, for the colour bar",
                params_.width));
    }

    Need estimate(SceneOutline& outline, const StageContext&) override
    {
        const double pixels = double(params_.width) * params_.height;
        const double triangles = 50 * std::pow(std::max(1.0, outline.lava_voxels), 2.0 / 3);
        return {pixels, memory(choice_.slice.empty() ? triangles : 0, 0), pixels * 3};
    }

    Json run(Scene& scene, const StageContext& context) override
    {
        if (!choice_.slice.empty()) {
            picture = render::slice(scene, {choice_.slice, choice_.axis, choice_.at, params_.width,
                                            choice_.low, choice_.high});
        } else {
            const auto mesh = scene.meshes.find("rock");
            if (mesh == scene.meshes.end())
                throw InvalidInput(
                    "render: the scene has no mesh; run `sekitei mesh` first or give --slice GRID");
            const auto count = [&](bool shown, const char* name) {
                const auto found = scene.points.find(name);
                return shown && found != scene.points.end() ? double(found->second.position.size())
                                                            : 0.0;
            };
            const double plants = count(scenery_.moss, "moss"),
                         dots = plants > 0 ? 0 : count(scenery_.photons, "photons");
            check_memory(
                "render",
                memory(double(mesh->second.triangles.size()) + kTrianglesPerDot * dots, plants),
                context.memory_limit);
            show(scene, mesh->second, context);
        }
        return {{"width", picture.width}, {"height", picture.height}};
    }

private:
    void show(const Scene& scene, const TriMesh& rock, const StageContext& context)
    {
        render::Params params = params_;
        const bool climate = scene.has("surf_area");
        if ((climate || params_of(scene, "lantern")) && !params.ground_height &&
            scene.domain.dims.z > 0)
            params.ground_height = scene.domain.transform.origin.z;
        const std::string grid = grid_of_field(params.field);
        if (!params.field.empty() && scene.has(grid)) {
            const std::string& unit = scene.grids.at(grid).unit;
            const std::string shown =
                unit.empty() ? params.field : fmt::format("{} [{}]", params.field, unit);
            const TriMesh painted = with_field(rock, scene, grid, shown);
            params.field = shown;
            picture = render::run(painted, params, context.seed, context.progress);
            return;
        }
        if (!params.field.empty() && !rock.vertex_attributes.contains(params.field) &&
            !rock.face_attributes.contains(params.field)) {
            std::vector<std::string> there;
            for (const auto& [name, values] : rock.vertex_attributes) there.push_back(name);
            for (const auto& [name, values] : rock.face_attributes) there.push_back(name);
            throw InvalidInput(fmt::format(
                "render: field = {}: no grid of the scene and no attribute of the mesh is called "
                "that, the mesh has {}{}{}",
                params.field, there.empty() ? "none" : fmt::format("{}", fmt::join(there, ", ")),
                nearest_field(params.field), maker_hint(grid)));
        }
        const double ground = params.ground_height.value_or(double(rock.bounds().lower.z));
        const TriMesh wood = obstacle_mesh(scene), water = water_mesh(scene, ground),
                      foliage = leaf_mesh(scene);
        render::Stuff stuff;
        stuff.pieces.push_back({&rock, render::Substance::Rock});
        if (!wood.triangles.empty()) stuff.pieces.push_back({&wood, render::Substance::Wood});
        if (!water.triangles.empty()) stuff.pieces.push_back({&water, render::Substance::Water});
        if (!foliage.triangles.empty())
            stuff.pieces.push_back({&foliage, render::Substance::Foliage});
        if (scenery_.moss && scene.points.contains("moss")) {
            stuff.moss = render::tufts_of(scene.points.at("moss"));
            for (render::Tuft& tuft : stuff.moss) ++tuft.species;  // points count from 0
            if (const std::vector<std::string> names = species_names(scene); !names.empty())
                stuff.species = names;
            if (climate) stuff.moss_size = 1.6 * scene.floats("surf_area").transform().voxel;
            // Mosses of a mesh know their host; they have a size of their own and stand closer.
            if (const Json* made = params_of(scene, "moss");
                made && scene.points.at("moss").attributes.contains("host") &&
                made->contains("size"))
                stuff.moss_size = 1.15 * (*made)["size"].get<double>();
            if (scenery_.tuft_size) stuff.moss_size = *scenery_.tuft_size;
        }
        if (scenery_.photons && stuff.moss.empty() && scene.points.contains("photons")) {
            picture = render::run(rock, render::photons_of(scene.points.at("photons")),
                                  scenery_.photon_size.value_or(render::photon_dot_size(rock)),
                                  params, context.seed, context.progress);
            return;
        }
        picture = stuff.pieces.size() == 1 && stuff.moss.empty()
                      ? render::run(rock, params, context.seed, context.progress)
                      : render::run(stuff, params, context.seed, context.progress);
    }

    /// Bytes at the peak: film, mesh, corner normals, plants and Embree's trees.
    double memory(double triangles, double plants) const
    {
        return 1e8 + double(params_.width) * params_.height * 60 + triangles * 180 + plants * 600;
    }
    static constexpr int kTrianglesPerDot = 4;

    render::Params params_;
    Scenery scenery_;
    SliceChoice choice_;
};

}  // namespace

std::unique_ptr<Stage> make_render()
{
    return std::make_unique<RenderStage>();
}

}  // namespace sekitei::apps
