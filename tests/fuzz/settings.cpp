#include <algorithm>
#include <sstream>

#include "apps/forest.h"
#include "apps/forest_edits.h"
#include "apps/forest_species.h"
#include "apps/ground.h"
#include "apps/habitat.h"
#include "apps/recipe.h"
#include "apps/trees.h"
#include "tests/fuzz/readers.h"

namespace sekitei::fuzz {
namespace {

using namespace apps;
namespace fs = std::filesystem;

/// Lines "#set NAME=VALUE" are words of the command line.
void read_recipe_text(std::string_view bytes)
{
    std::vector<std::string> overrides;
    std::istringstream lines{std::string(bytes)};
    for (std::string line; std::getline(lines, line);)
        if (line.starts_with("#set ")) overrides.push_back(line.substr(5));
    accepts(overrides.empty() ? "r.toml" : "", [&] {
        const Recipe recipe = parse_recipe(std::string(bytes), scratch() / "r.toml", overrides);
        require_input_files(recipe, std::vector<bool>(recipe.stages.size(), true));
    });
}

std::vector<std::string> recipe_seeds()
{
    std::vector<std::string> seeds = data_files("recipes", ".toml");
    seeds.push_back(
        "sekitei = 1\nseed = 7\nout = \"o\"\n[lava]\npreset = \"slab\"\nsize = "
        "[\"1.6m\", \"1.6m\", \"1.6m\"]\nvoxel = \"4cm\"\n[cool]\nsteps = "
        "40\n[joint]\nspacing = \"40cm\"\n[rock]\nstage = \"mesh\"\nfrom = "
        "[\"joint\"]\nwrite = [\"rock.ply\"]\n#set joint.spacing=30cm\n#set "
        "out=elsewhere\n#set seed=3\n");
    return seeds;
}

/// The first line names the stage: "# cool".
void read_params(std::string_view bytes)
{
    const std::string_view line = bytes.substr(0, bytes.find('\n'));
    std::string name = line.starts_with("# ") ? std::string(line.substr(2)) : "";
    const auto& infos = stage_infos();
    if (std::ranges::find(infos, name, &StageInfo::name) == infos.end()) name = "lava";
    const auto stage = make_stage(name);
    const fs::path file = put("p.toml", bytes);
    accepts("p.toml",
            [&] { apply_params_file(file, stage->params(), [&] { stage->validate(); }); });
}

std::vector<std::string> params_seeds()
{
    std::vector<std::string> seeds{"# cool\n" + data_file("materials/basalt.toml")};
    for (const StageInfo& info : stage_infos()) {
        std::string text = "# " + info.name + "\n";
        const auto stage = make_stage(info.name);
        for (const Param& p : stage->params()) {
            const Json value = p.get();
            if (!value.is_null() && !value.is_object())
                text += p.name + " = " + value.dump() + "\n";
        }
        seeds.push_back(text);
    }
    return seeds;
}

void read_moss(std::string_view bytes)
{
    put("m.toml", bytes);
    accepts("m.toml", [&] { find_species("m.toml", scratch()); });
}

void read_soil(std::string_view bytes)
{
    put("s.toml", bytes);
    accepts("s.toml", [&] { find_soil("s.toml", scratch()); });
}

void read_tree(std::string_view bytes)
{
    put("t.toml", bytes);
    accepts("t.toml", [&] { find_tree("t.toml", scratch()); });
}

void read_forest(std::string_view bytes)
{
    const fs::path file = put("f.toml", bytes);
    accepts("f.toml", [&] {
        if (read_forest_species(file, forest::SpreadMode::ApexAngle).empty())
            broken("a forest of no species");
    });
}

void read_edit_log(std::string_view bytes)
{
    static const fs::path kMap = put("map.png", data_file("forest/path.png"));
    const fs::path file = put("e.toml", bytes);
    ForestWords words;
    words.frame.width = words.frame.depth = 32;
    words.frame.fit = true;
    words.species = forest::table_species();
    accepts("e.toml", [&] { edit_files(file); });
    // A picture that is not as it must be is to blame by its own name.
    accepts("", [&] { encode_edits(read_edits(file, words), words.species, "edits"); });
}

std::vector<std::string> edit_seeds()
{
    std::vector<std::string> seeds;
    for (const std::string& text : data_files("forest", ".toml"))
        if (text.find("[[edit]]") != std::string::npos) seeds.push_back(text);
    seeds.push_back(
        "[[edit]]\nstep = 3\nmap = [1, 2]\nvalue = 0\ndisc = [12, 12, "
        "4]\n[[edit]]\nstep = 4\nmap = 1\nmultiply = 0.5\npolygon = [[1, 1], [20, 1], "
        "[20, 30]]\n[[edit]]\nstep = 4\nmap = 2\nimage = \"map.png\"\n[[edit]]\nstep = "
        "5\nmap = 3\nvalue = 1\nmask = \"map.png\"\n[[edit]]\nstep = 6\nfell = "
        "true\nmin_height = 16\nspecies = [\"tall\"]\n[[edit]]\nstep = 7\nplant = "
        "[[\"tall\", 10.5, 9.25, 2.0], [5, 8, 9, 1, \"0x1139fd5694aac492\"]]\n");
    return seeds;
}

/// The same text under both names that scenes keep such text by.
Scene scene_of_settings(std::string_view bytes)
{
    Scene scene;
    for (const char* grid : {"canopy_lad", "canopy_height"})
        scene.put(grid, FloatGrid(), "", "tree");
    scene.grids.at("canopy_lad").extra["tree"] = std::string(bytes);
    scene.grids.at("canopy_height").extra[kForestSettings] = std::string(bytes);
    return scene;
}

void read_grove(std::string_view bytes)
{
    const Scene scene = scene_of_settings(bytes);
    accepts("", [&] { grove_record(scene); });
}

void read_forest_settings(std::string_view bytes)
{
    const Scene scene = scene_of_settings(bytes);
    accepts("", [&] {
        // A double has not all digits of every number, so the text settles in a second turn.
        const std::string text = forest_settings(forest_record(scene));
        if (forest_settings(forest_record(scene_of_settings(text))) != text)
            broken("a forest's settings do not come back as they were written");
    });
}

std::vector<std::string> grove_seeds()
{
    const tree::Grove grove(tree::GroveParams{}, {preset_trees().front()}, {{{0, 0, 0}, 0}}, 7);
    return {grove_settings(grove)};
}

std::vector<std::string> forest_settings_seeds()
{
    ForestRecord record;
    record.width = record.depth = 64;
    record.species = forest::table_species();
    record.species.front().limits.push_back({"water", 0.2, 0.3, 0.4, 0.6, 0.7, 0.8});
    record.models.kinds = {"beech", "oak"};
    record.step = 12;
    return {forest_settings(record)};
}

}  // namespace

std::vector<Reader> settings_readers()
{
    return {{"recipe", read_recipe_text, recipe_seeds},
            {"params", read_params, params_seeds},
            {"moss_species", read_moss, [] { return data_files("species", ".toml"); }},
            {"soil", read_soil, [] { return data_files("soils", ".toml"); }},
            {"tree_kind", read_tree, [] { return data_files("trees", ".toml"); }},
            {"forest_species", read_forest, [] { return data_files("forest", ".toml"); }},
            {"edit_log", read_edit_log, edit_seeds},
            {"grove_settings", read_grove, grove_seeds},
            {"forest_settings", read_forest_settings, forest_settings_seeds}};
}

}  // namespace sekitei::fuzz
