#pragma once

#include <filesystem>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "core/params.h"

/// The commands of the program, after the command line has been understood.
namespace sekitei::apps {

/// Options that every command takes.
struct Common {
    std::vector<std::string> output;  ///< "-" is standard output
    bool force = false;
    std::uint64_t seed = 1;
    double memory_limit = 0;  ///< bytes
    bool json = false;
    bool fix_nan = false;
    std::filesystem::path params_file;
};

/// Words given for parameters, by parameter name.
using Words = std::vector<std::pair<std::string, std::string>>;

// Each returns its exit code; failures are thrown.
int command_stage(const std::string& stage, const std::vector<std::string>& inputs,
                  const Words& words, const Common& common);
int command_run(const std::vector<std::string>& recipes, const std::vector<std::string>& overrides,
                const std::set<std::string>& only, bool dry_run, const Common& common);
int command_check(const std::vector<std::string>& recipes,
                  const std::vector<std::string>& overrides, const Common& common);
int command_info(const std::vector<std::string>& files, const Common& common);
int command_replay(const std::string& file, bool every_value);
int command_diff(const std::string& a, const std::string& b, double tolerance,
                 const Common& common);
int command_verify(const std::vector<std::string>& files, const Common& common);
/// @param at    "x,y,z" [m]; the nearest surface cell, or site of a mesh, is explained
/// @param face  number of a face of the mesh beside the scene as given; empty: `at` says where
int command_explain(const std::string& file, const std::string& at, const std::string& face,
                    const Common& common);
/// Writes a web page of a folder with manifest.json, of scenes or of a .glb.
/// @param moss_lod  see AssemblyOptions
int command_view(const std::vector<std::string>& inputs, int moss_lod, const Common& common);

/// A command as the command line describes itself: what pages and completions are made of.
struct CommandPage {
    struct Option {
        std::string name;      ///< "--output"; of what stands by itself its name: "scene"
        std::string shortcut;  ///< "-o" or empty
        std::string negative;  ///< of a switch: "--no-strict" or empty
        std::string value;     ///< what follows it: "FILE", "VALUE"; empty for switches
        std::string help;
        bool plain = false;  ///< stands by itself, without a name
        bool required = false;
        bool repeats = false;
        bool common = false;                ///< many commands have it: "General" in --help
        std::vector<std::string> choices;   ///< all words that may follow, where they are few
        bool file = false, folder = false;  ///< the word that follows is one
    };
    std::string name, summary;
    bool stage = false;  ///< a process: recipes know it too
    std::vector<Option> options;
};
using CommandPages = std::vector<CommandPage>;

enum class SchemaForm { Json, Markdown, Man };
/// @param stage   one stage, or for Man one command; empty: all, for Man the page of the program
/// @param common  with Man and one output: the existing folder that gets every page
int command_schema(const std::string& stage, SchemaForm form, const CommandPages& pages,
                   const Common& common);
int command_completions(const std::string& shell, const CommandPages& pages);

/// The reference page.
std::string markdown_reference(const CommandPages& pages, const std::string& only);
/// A page in the form of man(1), by its file's name: "sekitei.1", "sekitei-lava.1" ...
std::string man_page(const CommandPages& pages, const std::string& name);
/// The names of all man pages, "sekitei.1" first.
std::vector<std::string> man_page_names(const CommandPages& pages);
/// Writes the models of plants that `render` draws into the folder common.output names.
int command_tufts(const std::vector<std::string>& species, double growth, const Common& common);

/// Which trees command_specimens() grows.
struct SpecimenWords {
    std::vector<std::string> species;  ///< names or .toml files
    int variants = 4;                  ///< of each, from as many seeds
    std::vector<int> generations;      ///< height classes: a model at each of these, ascending
};
/// Writes models of trees for instancing into the folder common.output names.
int command_specimens(const SpecimenWords& words, const Common& common);

/// One row of the program's own table of commands.
struct CommandInfo {
    std::string name, summary;
};
/// Commands that are not stages.
const std::vector<CommandInfo>& tool_commands();

/// Prints to standard output, checked: a closed or full pipe is an IoError.
void print(const std::string& text);

}  // namespace sekitei::apps
