#include "apps/render/render.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>

#include "apps/habitat.h"
#include "apps/stages/forest_scenery.h"
#include "apps/stages/scenery.h"
#include "apps/stages/stages.h"
#include "core/error.h"
#include "core/math.h"

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
    bool trees = true;
    Season season = Season::Auto;
    double leaf_scale = 2.2;

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
        field("trees", &Scenery::trees, "trees of the scene, with bark and leaves");
        field("season", &Scenery::season,
              "leaves of trees: auto (by species), green, autumn, blossom or bare (none)");
        field("leaf_scale", &Scenery::leaf_scale, "", between(0.01, 100),
              "how much larger than they are single leaves of trees are drawn: crowns of the paper "
              "are lighter than those of gardens");
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
                                     {"moss", "lantern", "tree"},
                                     true};
        return kInfo;
    }

    void meets_trees(bool alone) override { only_trees_ = alone; }
    void meets_forest(bool alone) override { only_forest_ = alone; }
    std::vector<std::string> needs() override
    {
        if (!choice_.slice.empty()) return {choice_.slice};
        return {only_trees_ ? "tree_skeleton" : only_forest_ ? "forest_instances" : "rock"};
    }
    std::vector<std::string> uses() override
    {
        if (!choice_.slice.empty()) return {};
        std::vector<std::string> names = scenery_uses();
        for (std::string& name : forest_uses()) names.push_back(std::move(name));
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
            if (mesh == scene.meshes.end() && (scene.points.contains("tree_skeleton") ||
                                               scene.points.contains("forest_instances"))) {
                show_trees(scene, context);
                return {{"width", picture.width}, {"height", picture.height}};
            }
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
    /// Bark and leaves as a picture wants them.
    struct Trees {
        TriMesh bark;
        std::vector<Crown> crown;
        Season season;

        Trees(const Scene& scene, const Scenery& scenery, const Progress& progress)
            : season(scenery.season)
        {
            const bool grown = scene.points.contains("tree_skeleton");
            if (grown && !scenery.trees) return;
            if (grown) bark = bark_mesh(scene, progress.slice(0, 0));
            if (season != Season::Bare) crown = crowns(scene, scenery.leaf_scale);
        }
        void add_to(render::Stuff& stuff) const
        {
            if (!bark.triangles.empty()) stuff.pieces.push_back({&bark, render::Substance::Bark});
            for (const Crown& c : crown)
                if (!c.leaves.triangles.empty())
                    stuff.pieces.push_back({&c.leaves, render::Substance::Foliage,
                                            leaf_colours(c.species, c.needles, season)});
        }
    };

    /// Single trees on level ground at their feet, a forest on its own.
    void show_trees(const Scene& scene, const StageContext& context)
    {
        if (!params_.field.empty())
            throw InvalidInput(fmt::format(
                "render: field = {}: the scene has trees and no rock to paint", params_.field));
        const Trees trees(scene, scenery_, context.progress);
        const TriMesh wood = obstacle_mesh(scene), floor = forest_floor(scene);
        render::Stuff stuff;
        if (!floor.triangles.empty()) stuff.pieces.push_back({&floor, render::Substance::Floor});
        trees.add_to(stuff);
        if (!wood.triangles.empty()) stuff.pieces.push_back({&wood, render::Substance::Wood});
        forest_to(stuff, scene, context);
        if (stuff.pieces.empty())
            throw InvalidInput("render: no tree is left, there is nothing to show");
        double triangles = 0, foot = INFINITY;
        for (const render::Piece& piece : stuff.pieces)
            triangles += double(piece.mesh->triangles.size());
        check_memory("render", memory(triangles, double(stuff.trees.size())), context.memory_limit);
        for (const char* name : {"tree_skeleton", "trees"})
            if (const auto plants = scene.points.find(name); plants != scene.points.end())
                for (const Vec3d& at : plants->second.position) foot = std::min(foot, at.z);
        render::Params params = params_;
        if (floor.triangles.empty()) {
            params.zoom *= kTreeZoom;
        } else {
            if (!params.eye && !params.target && !params.view_elevation)
                look_over(params, floor.bounds(), stuff.trees);
            foot = floor.bounds().lower.z + 0.01;  // which its border reaches
        }
        if (!params.ground_height && std::isfinite(foot)) params.ground_height = foot;
        picture = render::run(stuff, params, context.seed, context.progress);
    }

    /// From above its near border over all of a forest to the horizon, which stays in the picture's
    /// upper part.
    static void look_over(render::Params& params, const Bounds& land,
                          const std::vector<render::StandingTree>& trees)
    {
        constexpr double kDegree = math::kPi / 180;
        double top = land.upper.z;
        for (const render::StandingTree& t : trees)
            top = std::max(top, t.position.z + static_cast<double>(t.scale.z));
        const double far = 0.72 * std::sqrt(land.size().x * land.size().y) / params.zoom,
                     azimuth = params.view_azimuth * kDegree,
                     down = 0.36 * params.field_of_view * kDegree;
        const Vec3d away(math::sin(azimuth), math::cos(azimuth), 0);
        params.eye = Vec3d(land.centre().x, land.centre().y, top + 0.20 * far) + away * far;
        params.target = *params.eye - away * math::cos(down) - Vec3d(0, 0, math::sin(down));
    }

    void forest_to(render::Stuff& stuff, const Scene& scene, const StageContext& context) const
    {
        if (scenery_.trees)
            add_forest(stuff, scene, scenery_.season, scenery_.leaf_scale, params_.eye,
                       context.seed, context.progress.slice(0, 0));
    }

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
        const TriMesh wood = obstacle_mesh(scene), water = water_mesh(scene, ground);
        const Trees trees(scene, scenery_, context.progress);
        render::Stuff stuff;
        stuff.pieces.push_back({&rock, render::Substance::Rock});
        if (!wood.triangles.empty()) stuff.pieces.push_back({&wood, render::Substance::Wood});
        if (!water.triangles.empty()) stuff.pieces.push_back({&water, render::Substance::Water});
        trees.add_to(stuff);
        forest_to(stuff, scene, context);
        if (scenery_.moss && scene.points.contains("moss")) {
            stuff.moss = render::tufts_of(scene.points.at("moss"));
            for (render::Tuft& tuft : stuff.moss) ++tuft.species;  // points count from 0
            if (const std::vector<std::string> names = species_names(scene); !names.empty())
                stuff.species = names;
            stuff.moss_size = moss_size(scene).value_or(stuff.moss_size);
            if (scenery_.tuft_size) stuff.moss_size = *scenery_.tuft_size;
        }
        if (scenery_.photons && stuff.moss.empty() && scene.points.contains("photons")) {
            picture = render::run(rock, render::photons_of(scene.points.at("photons")),
                                  scenery_.photon_size.value_or(render::photon_dot_size(rock)),
                                  params, context.seed, context.progress);
            return;
        }
        picture = stuff.pieces.size() == 1 && stuff.moss.empty() && stuff.trees.empty()
                      ? render::run(rock, params, context.seed, context.progress)
                      : render::run(stuff, params, context.seed, context.progress);
    }

    /// Bytes at the peak: film, mesh, corner normals, plants and Embree's trees.
    double memory(double triangles, double plants) const
    {
        return 1e8 + double(params_.width) * params_.height * 60 + triangles * 180 + plants * 600;
    }
    static constexpr int kTrianglesPerDot = 4;

    /// Crowns are wider than deep, and leave more of the picture free than rocks of their size.
    static constexpr double kTreeZoom = 1.3;

    render::Params params_;
    Scenery scenery_;
    SliceChoice choice_;
    bool only_trees_ = false, only_forest_ = false;
};

}  // namespace

std::unique_ptr<Stage> make_render()
{
    return std::make_unique<RenderStage>();
}

}  // namespace sekitei::apps
