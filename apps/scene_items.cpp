#include "apps/scene_items.h"

#include <algorithm>
#include <set>

#include "apps/habitat.h"
#include "core/error.h"

namespace sekitei::apps {
namespace {

using Kind = SceneItem::Kind;
using Attribute = SceneItem::Attribute;
constexpr GridClass kPlain = GridClass::Unknown, kFog = GridClass::FogVolume,
                    kLevelSet = GridClass::LevelSet;

/// Stands for whatever a user may write, and where numbers stop to be worth a try.
constexpr const char* kAnyName = "any";
constexpr double kMostTried = 1e6;

SceneItem grid(std::string name, std::string type, std::string unit, GridClass grid_class,
               std::string meaning)
{
    return {std::move(name), Kind::Grid, std::move(type),
            std::move(unit), grid_class, std::move(meaning)};
}

SceneItem points(std::string name, std::string meaning, std::vector<Attribute> attributes)
{
    return {std::move(name),    Kind::Points,         "points", "", GridClass::Unknown,
            std::move(meaning), std::move(attributes)};
}

/// Columns of tables are described where they are filled.
std::vector<Attribute> statistics_columns()
{
    std::vector<Attribute> list;
    for (const auto* columns : {&Statistics::columns(), &Statistics::photon_columns()})
        for (const auto& column : *columns)
            list.push_back({column.name, "double", column.unit, column.meaning});
    return list;
}

std::vector<Attribute> instance_attributes()
{
    return {{"orient", "quatf", "", "rotation x y z w that turns the model upright and around"},
            {"scale", "vec3f", "", "of a model of height 1: across, across, up"},
            {"pscale", "float", "", "1: `scale` says it all"},
            {"id", "int64", "", "the tree for all its life, the bits of an unsigned number"},
            {"height", "float", "m", "of the tree"},
            {"crown_radius", "float", "m", "of the tree"},
            {"cone_radius", "float", "m", "of the space that it claims"},
            {"R", "float", "", "share of that space that it keeps"},
            {"species", "int32", "", "from 0, in the order of the forest's list"},
            {"variant", "int32", "", "which sibling among the models of a kind, from 0"},
            {"age", "int32", "steps", "of the tree"},
            {"model", "int32", "", "of `sekitei specimens`: kind, variant and age in one number"}};
}

std::vector<SceneItem> all_items()
{
    const std::vector<Attribute> fields{
        {"N", "vec3f", "", "outward normal"},
        {"area", "float", "m^2", "of the site"},
        {"face", "int32", "", "of the mesh as given that the site was cut from"}};
    return {
        // Rock.
        grid("region", "int32", "", kPlain,
             "0 lava, 1 cold (air, ground), 2 slow cooling (vent, deep rock); lava is active, the "
             "background 1"),
        grid("region_coarse", "int32", "", kPlain, "the same on the cells of heat conduction"),
        grid("body_sdf", "float", "m", kLevelSet, "signed distance to the body of lava"),
        grid("slow_sdf", "float", "m", kLevelSet,
             "signed distance to the slow part; empty where there is none"),
        grid("temperature", "float", "K", kPlain,
             "after cooling; virtual degrees with the presets' defaults"),
        grid("temperature_gradient", "vec3s", "", kPlain,
             "unit normal of the isotherms, from cold to hot; 0 where there is no direction"),
        grid("temperature_gradient_mag", "float", "K/cell", kPlain,
             "its length before it was made a unit vector, by heat cell"),
        points("centre_lines", "vertices of the lines along which columns grew",
               {{"line", "int32", "", "number of the line, as in `column`"},
                {"order", "int32", "", "of the vertex along its line, from 0"},
                {"arc", "float", "m", "length of the line up to here"},
                {"stop", "int32", "", "why the line ended"}}),
        grid("column", "int32", "", kPlain, "line that owns the voxel; background -1"),
        grid("arc", "float", "m", kPlain, "length of that line up to the voxel's nearest point"),
        grid("component", "int32", "", kPlain, "connected piece after cutting; background -1"),
        grid("weathering", "float", "", kPlain,
             "W, 0 to 1: how prone the piece is to break away, one value a piece, at its cuts"),
        grid("density", "float", "", kFog,
             "rock in a voxel, anti-aliased: 0 none, 1 full; the surface lies at half"),
        grid("surface", "int32", "", kPlain,
             "class of the nearest boundary: 0 joint wall, 1 cut, 2 cooling contact, 3 slow "
             "contact, 4 cut of the terrain, 5 wall of the box"),
        {"rock",
         Kind::Mesh,
         "triangles",
         "",
         GridClass::Unknown,
         "surface of the rock or object, beside the scene file as .ply; light and moss on a mesh "
         "cut its faces into sites and leave every field of the surface on them",
         {{"column", "int32", "", "as the grid `column`"},
          {"component", "int32", "", "as the grid `component`"},
          {"surface", "int32", "", "as the grid `surface`"},
          {"geology", "int32", "", "as the grid `geology`"},
          {"zone", "int32", "", "given by the user: a part of the surface that tables tell apart"},
          {"group", "int32", "", "number of the OBJ group or material"},
          {"uv_0", "vec3f", "", "texture coordinates of the first corner; z = 0"},
          {"uv_1", "vec3f", "", "of the second"},
          {"uv_2", "vec3f", "", "of the third"}}},
        // Surfaces and their climate.
        grid("surface_sdf", "float", "m", kLevelSet,
             "signed distance to the surface that has a climate"),
        grid("surf_normal", "vec3s", "", kPlain, "outward normal of the surface cell"),
        grid("surf_area", "float", "m^2", kPlain, "of the surface in the cell"),
        grid("obstacle_sdf", "float", "m", kLevelSet,
             "signed distance to what stands around: fences, trunks"),
        grid("water_surface", "int32", "", kPlain, "1 in the uppermost voxels of ponds"),
        grid("ground_height", "float", "m", kPlain,
             "one layer, pixels of 1 m: height of a garden's land, on which forests stand"),
        grid("blocked_height", "float", "m", kPlain,
             "one layer, pixels of 1 m: how far stones reach above the ground"),
        grid("plantable", "float", "", kPlain,
             "one layer, pixels of 1 m: 0 where no tree of a forest may germinate"),
        points("sites", "the middle of every piece of a mesh that has a climate of its own",
               fields),
        grid("light_S", "float", "W/m^2", kPlain, "all light on the surface, 24-hour mean"),
        grid("light_direct", "float", "W/m^2", kPlain, "of it straight from the sun"),
        grid("light_sky", "float", "W/m^2", kPlain, "of it from the sky"),
        grid("light_reflected", "float", "W/m^2", kPlain, "of it thrown back by other surfaces"),
        grid("light_indirect", "float", "W/m^2", kPlain,
             "of it by photons that were reflected before"),
        grid("sky_view", "float", "", kPlain, "share of the sky seen, weighted by the cosine"),
        grid("rain_exposure", "float", "", kPlain,
             "share of the rain on level ground that arrives"),
        points("daylight", "what each surface cell sees of sun, sky and other cells",
               {{"bits_<k>", "int32", "", "32 places of the sun: which of them the cell sees"},
                {"link_<k>", "int32", "", "a cell that throws light on this one; -1 none"}}),
        points(
            "weather", "a point for each day, at the origin",
            {{"year", "int32", "", ""},
             {"month", "int32", "", "1 to 12"},
             {"day", "int32", "", "1 to 31"},
             {"temperature", "double", "K", "mean of the day"},
             {"humidity", "double", "", "mean, 0 to 1"},
             {"precipitation", "double", "mm", "of the day"},
             {"wind_speed", "double", "m/s", "mean"},
             {"wind_direction", "int32", "", "0 to 7 = N NE E SE S SW W NW, where it blows from"},
             {"possible_sunshine", "double", "h", "from sunrise to sunset"},
             {"sunshine", "double", "h", "of bright sun"},
             {"pressure", "double", "hPa", "mean"},
             {"global_radiation", "double", "W/m^2", "24-hour mean; -1: not measured"},
             {"diffuse_radiation", "double", "W/m^2", "24-hour mean; -1: not measured"},
             {"longwave", "double", "W/m^2", "from the sky; -1: not measured"},
             {"latitude", "double", "rad", "of the place, north positive"},
             {"longitude", "double", "rad", "of the place, east positive"}}),
        points("photons", "photons where they hit something",
               {{"N", "vec3f", "", "normal of the surface, on the side the photon came from"},
                {"dir", "vec3f", "", "direction of flight"},
                {"flux", "float", "W", "power it carries"},
                {"bounce", "int32", "", "reflections before"}}),
        grid("wind_ratio_<k>", "float", "", kPlain,
             "speed beside the surface over that of the free wind, for wind from direction k: 0 to "
             "7 = N NE E SE S SW W NW"),
        points("air_tables", "a point for each of the eight directions of the wind, at the origin",
               {{"A_U", "double", "", "speed before the object over that of the free wind"},
                {"A_T", "double", "",
                 "water that the air touched: how far it takes over a pond's warmth"},
                {"A_q", "double", "", "the same for its humidity"},
                {"direction", "double", "rad",
                 "where the air really comes from, clockwise from north"},
                {"A_T_layer_<k>", "double", "", "A_T of the layer k, with per_layer"},
                {"layer_base", "double", "m", "height at which layer 0 begins"},
                {"layer_height", "double", "m", "of each layer"}}),
        grid("geology", "int32", "", kPlain,
             "soil of the cell: 1 humus, 2 sand, 3 rock, 4 asphalt, 5 printed asphalt, 100 the "
             "stage's own"),
        grid("soil_h", "float", "mm", kPlain, "depth of the soil"),
        grid("soil_water", "float", "mm", kPlain, "water in it, after the last day"),
        grid("soil_theta", "float", "", kPlain, "water content, mean of all days"),
        grid("soil_beta", "float", "", kPlain,
             "evaporation efficiency, mean: 0 dry, 1 as free water"),
        grid("soil_Ts", "float", "K", kPlain, "temperature of the surface, mean"),
        grid("soil_rh", "float", "", kPlain, "relative humidity at the surface, mean"),
        grid("soil_E", "float", "mm/day", kPlain, "evaporation, mean"),
        grid("soil_runoff", "float", "mm/day", kPlain, "water that ran off downhill, mean"),
        // Moss.
        grid("suit_<species>", "float", "", kPlain,
             "G, 0 to 1: how the climate suits a moss here, last day"),
        grid("moss_species", "int32", "", kPlain, "which moss: 1 the first of the list, 0 none"),
        grid("moss_growth", "float", "", kPlain, "its growth; 1 ripe for gemmae, 2 full-grown"),
        grid("moss_growth_max", "float", "", kPlain, "the highest growth it has had"),
        grid("moss_age", "int32", "", kPlain, "its age in days"),
        grid("moss_cover", "float", "", kPlain, "share of the surface under moss"),
        grid("moss_id", "int32", "", kPlain, "lower bits of its id"),
        grid("seed_kind", "int32", "", kPlain, "what rests here: 0 nothing, 1 gemma, 2 spore"),
        grid("seed_species", "int32", "", kPlain, "of that moss, 1 the first of the list"),
        grid("seed_age", "int32", "", kPlain, "its age in days"),
        grid("seed_id", "int32", "", kPlain, "lower bits of its id"),
        points("moss", "a point for each living plant, to instance the models of data/species",
               {{"N", "vec3f", "", "normal of what it stands on"},
                {"orient", "quatf", "", "rotation x y z w that turns +y to the plant's axis"},
                {"pscale", "float", "", "size over that of a full-grown plant"},
                {"species", "int32", "", "from 0, in the order of the moss stage's list"},
                {"growth", "float", "", "2: full-grown"},
                {"growth_max", "float", "", "the highest it has had"},
                {"age", "int32", "days", ""},
                {"id", "int64", "", "the plant for all its life"},
                {"wetness", "float", "", "relative humidity where it stands"},
                {"site", "int32", "", "on cells: number of its cell"},
                {"host", "int64", "", "on a mesh: id of the moss it stands on, or -1 - its site"},
                {"S", "float", "W/m^2", "on a mesh: light on it"},
                {"suit", "float", "", "on a mesh: its G"},
                {"interior", "int32", "", "on a mesh: 1 within a dense patch"}}),
        points("seeds", "on a mesh: a point for each resting gemma and spore",
               {{"species", "int32", "", "from 0"},
                {"kind", "int32", "", "1 gemma, 2 spore"},
                {"age", "int32", "days", ""}}),
        points("statistics", "a point for each day and species, at the origin",
               statistics_columns()),
        points("zones", "a point for each day, zone and species, at the origin",
               {{"day", "double", "", "1 on the first"},
                {"zone", "double", "", "as the face attribute `zone` says"},
                {"species", "double", "", "from 0"},
                {"living", "double", "", "mosses"},
                {"growth", "double", "", "sum over them"},
                {"fitness", "double", "", "mean G"},
                {"light", "double", "W/m^2", "mean S"},
                {"light_sd", "double", "W/m^2", "its standard deviation"},
                {"theta", "double", "", "mean water content of the soil"},
                {"theta_median", "double", "", "the value that half the area does not exceed"}}),
        // Trees.
        points("tree_skeleton", "the far end of every piece of wood",
               {{"parent", "int32", "", "piece it grows on; -1 none"},
                {"tree", "int32", "", "index into the points `trees`"},
                {"key", "int64", "", "of its random numbers"},
                {"generation", "int32", "", "it was born in"},
                {"order", "int32", "", "of conifers: 0 trunk, 1 bough, 2 shoot"},
                {"flags", "int32", "",
                 "bits: 1 tip, 2 died of an obstacle, 4 sprout, 8 pruned, 16 latent bud gone, 32 "
                 "strong bough, 64 trunk, 128 dead"},
                {"s<axis>", "double", "units", "start: sx, sy, sz, in lengths of a branch"},
                {"d<axis>", "double", "", "unit direction: dx, dy, dz"},
                {"m<axis>", "double", "", "where light came from when it was born: mx, my, mz"},
                {"length", "double", "units", "of the piece, in lengths of a branch"},
                {"light", "double", "", "L when it was born, 1 in the open"},
                {"radius", "float", "m", "of the wood"},
                {"tip", "int32", "", "its place in the order of growth; -1: no tip"},
                {"bough", "int32", "", "generation in which its bough began; -1 the leader"},
                {"dead_tips", "int32", "", "tips that left their wood to it"},
                {"died", "int32", "", "generation it died in; -1: it lives"}}),
        points("trees", "a point for each tree, at its foot",
               {{"id", "int32", "", "index, as others name it"},
                {"species", "int32", "", "from 0"},
                {"from", "int32", "", "generation it began to grow in"},
                {"unit_length", "double", "m", "length of a branch"},
                {"tips", "int32", "", "living tips"},
                {"height", "float", "m", ""},
                {"crown_radius", "float", "m", ""},
                {"crown_base", "float", "m", "height at which leaves begin"},
                {"trunk_radius", "float", "m", "at the foot"},
                {"o<axis>", "double", "m", "the foot to the last bit: ox, oy, oz"}}),
        points("tree_buds", "latent buds that wait to sprout",
               {{"key", "int64", "", "of their random numbers"},
                {"tree", "int32", "", "index into `trees`"},
                {"generation", "int32", "", "in which they sprout"},
                {"s<axis>", "double", "units", "start"},
                {"d<axis>", "double", "", "unit direction"}}),
        points(
            "tree_growth", "a point for each generation",
            {{"generation", "double", "", ""},
             {"tips", "double", "", "living"},
             {"births", "double", "", "of branches"},
             {"deaths", "double", "", "of tips, for want of light"},
             {"obstructed", "double", "", "tips that met an obstacle"},
             {"sprouts", "double", "", "from latent buds"},
             {"shed", "double", "", "branches that fell"},
             {"mean_light", "double", "", "L of the new tips, before any died"},
             {"lowest", "double", "units", "height of the lowest tip, in lengths of a branch"},
             {"highest", "double", "units", "of the highest"},
             {"rms_radius", "double", "units", "of the tips about their tree's foot"},
             {"weeping", "double", "", "share of tips with a branch that points down below them"}}),
        points("leaves", "a point for each leaf or bunch of leaves, to instance",
               {{"N", "vec3f", "", "normal"},
                {"orient", "quatf", "", "rotation x y z w of a leaf that lies along +y, facing +z"},
                {"pscale", "float", "m", "half the edge of a square of its area"},
                {"area", "float", "m^2", "of the leaf"},
                {"id", "int64", "", "the leaf for all its life"},
                {"ball", "int32", "", "leaf-ball it belongs to"},
                {"species", "int32", "", "as in `trees`"},
                {"tree", "int32", "", "index into `trees`"}}),
        grid("tree_light", "float", "", kFog, "L that reaches the tips, 1 in the open"),
        grid("tree_sdf", "float", "m", kLevelSet, "signed distance to the wood"),
        grid("canopy_lad", "float", "1/m", kFog, "leaf area in a volume"),
        grid("canopy_RU", "float", "1/m", kFog, "drag of leaves on wind: its loss by metre"),
        // Forests.
        points("forest_instances", "a point for each tree, at its foot, to instance models",
               instance_attributes()),
        points("forest_heroes", "trees left out of the instances for the tree stage to grow",
               instance_attributes()),
        points("forest_trees", "the forest's own state: position x, y and height",
               {{"uid", "int64", "", "the tree for all its life, the bits of an unsigned number"},
                {"kept", "int64", "", "space it kept, weighted by density maps, in 1/65535 pixel"},
                {"cone", "int64", "pixels", "space of its whole cone within the forest"},
                {"species", "int32", "", "from 0"},
                {"age", "int32", "steps", ""},
                {"rank", "int32", "", "with occupancy: its number in `forest_occupancy`"}}),
        points("forest_growth", "a point for each step",
               {{"step", "double", "", ""},
                {"trees", "double", "", "living"},
                {"births", "double", "", "in the step"},
                {"lost", "double", "", "seeds that fell outside or where none may stand"},
                {"mean_share", "double", "", "R, mean of all trees"},
                {"competition", "double", "", "deaths for want of space"},
                {"environment", "double", "", "deaths by water, warmth, slope"},
                {"age", "double", "", "deaths of old age"},
                {"felled", "double", "", "trees felled"},
                {"wind", "double", "", "trees that wind threw"},
                {"count_<species>_<class>", "double", "",
                 "living trees of a species and a class of height"}}),
        points("forest_fallen", "trees that wind threw, where they stood",
               {{"id", "int64", "", "of the tree"},
                {"step", "int32", "", "it fell in"},
                {"species", "int32", "", "from 0"},
                {"azimuth", "double", "rad", "where it fell to, from east to north"},
                {"length", "double", "m", "of the trunk"},
                {"x", "double", "m", "in the forest"},
                {"y", "double", "m", "in the forest"}}),
        grid("canopy_height", "float", "m", kPlain,
             "one layer: height of the tree that owns the uppermost slice above a pixel"),
        grid("canopy_transmittance", "float", "", kFog,
             "share of light that reaches a voxel through the leaves above"),
        grid("ground_transmittance", "float", "", kPlain, "one layer: the same at the ground"),
        grid("terrain_height", "float", "m", kPlain, "one layer: height of the ground"),
        grid("forest_lad", "float", "1/m", kFog,
             "leaf area in a volume of the forest without the trees that the tree stage grew"),
        grid("forest_occupancy", "int32", "", kPlain,
             "rank of the tree that owns the voxel; 0 nobody"),
        grid("forest_density", "float", "", kPlain,
             "the density maps, one layer for each band of height"),
        // Wind of other programs.
        grid("vel", "vec3s", "m/s", kPlain, "wind that a scene of another program brings"),
    };
}

/// Whether a pattern with parts like "<k>" can stand for `name`; each part takes one byte or more.
bool stands_for(std::string_view pattern, std::string_view name)
{
    const std::size_t open = pattern.find('<');
    if (open == std::string_view::npos) return pattern == name;
    if (name.substr(0, open) != pattern.substr(0, open)) return false;
    const std::string_view rest = pattern.substr(pattern.find('>', open) + 1);
    for (std::size_t at = open + 1; at <= name.size(); ++at)
        if (stands_for(rest, name.substr(at))) return true;
    return false;
}

/// The entry of this very name, else the first whose pattern stands for it, else null.
template <class T>
const T* named(const std::vector<T>& list, std::string_view name)
{
    for (const T& entry : list)
        if (entry.name == name) return &entry;
    for (const T& entry : list)
        if (stands_for(entry.name, name)) return &entry;
    return nullptr;
}

}  // namespace

const std::vector<SceneItem>& scene_items()
{
    static const std::vector<SceneItem> items = all_items();
    return items;
}

const SceneItem* find_scene_item(std::string_view name)
{
    return named(scene_items(), name);
}

const Attribute* find_attribute(const SceneItem& item, std::string_view name)
{
    if (const Attribute* attribute = named(item.attributes, name)) return attribute;
    if (item.name != "rock" && item.name != "sites") return nullptr;
    // A field of the surface, as grids hold it too.
    static const std::vector<Attribute> fields = [] {
        std::vector<Attribute> list;
        for (const SceneItem& grid : scene_items())
            if (grid.kind == Kind::Grid)
                list.push_back({grid.name, grid.type, grid.unit, grid.meaning});
        return list;
    }();
    return named(fields, name);
}

StageItems items_of_stage(const std::string& stage)
{
    StageItems items;
    std::set<std::string> met[3];
    /// @param own  a name that the user would have given: of no interest
    auto gather = [&](Stage& variant, const Json& own) {
        std::vector<std::string>* lists[3] = {&items.needs, &items.uses, &items.makes};
        const std::vector<std::string> found[3] = {variant.needs(), variant.uses(),
                                                   variant.makes()};
        for (int k = 0; k < 3; ++k)
            for (const std::string& name : found[k]) {
                if (name.empty() || own == name) continue;
                const SceneItem* item = find_scene_item(name);
                const std::string& known = item ? item->name : name;
                if (met[k].insert(known).second) lists[k]->push_back(known);
            }
    };
    const ParamList described = make_stage(stage)->params();
    // What it reads decides too: nothing, a mesh, trees alone, a forest alone.
    for (int reading = 0; reading < 4; ++reading) {
        auto fresh = [&] {
            auto variant = make_stage(stage);
            if (reading == 1) variant->meets_mesh(true);
            if (reading == 2) variant->meets_trees(true);
            if (reading == 3) variant->meets_forest(true);
            return variant;
        };
        gather(*fresh(), nullptr);
        for (const Param& p : described) {
            std::vector<Json> values;
            if (p.kind == Param::Kind::Flag) values = {true, false};
            if (p.kind == Param::Kind::Choice)
                for (const std::string& choice : p.choices) values.emplace_back(choice);
            if (p.kind == Param::Kind::Text || p.kind == Param::Kind::Path) values = {kAnyName};
            if ((p.kind == Param::Kind::Number || p.kind == Param::Kind::Integer) &&
                p.range.upper < kMostTried)
                values = {p.range.upper};
            for (const Json& value : values) {
                const auto variant = fresh();
                try {
                    find_param(variant->params(), p.name)->set(value);
                    gather(*variant, value);
                } catch (const Error&) {
                    // No value that it takes.
                }
            }
        }
    }
    return items;
}

}  // namespace sekitei::apps
