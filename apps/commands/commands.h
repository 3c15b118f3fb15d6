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
int command_schema(const std::string& stage, bool markdown);
int command_completions(const std::string& shell);
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
