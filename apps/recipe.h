#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "apps/stage.h"

namespace sekitei::apps {

/// A stage of a recipe: one table.
struct RecipeStage {
    std::string name;                ///< of the table
    std::unique_ptr<Stage> process;  ///< with the table's parameters set
    std::vector<std::size_t> from;   ///< indices of the stages it reads
    /// File names inside the output folder. Where a recipe names one scene for a stage that also
    /// makes a mesh, the mesh's follows: "x.vdb", "x.ply".
    std::vector<std::string> write;
    std::uint64_t seed = 1;
    std::string place;  ///< "cliff.toml:12:1" for messages
};

/// A graph of stages, in an order in which each follows those it reads.
struct Recipe {
    std::filesystem::path file, folder;  ///< folder: where relative input paths start
    std::filesystem::path out;           ///< relative to the working directory
    std::uint64_t seed = 1;
    std::vector<RecipeStage> stages;
};

/// Reads and checks a whole recipe: syntax, keys, types, ranges, graph, inputs, file names.
/// @param overrides  "joint.spacing=30cm", "out=elsewhere", "seed=3"
/// @throws InvalidParameter  all errors at once, one a line: `file:line:column: key: found,
/// expected`
/// @throws InvalidInput      the recipe file cannot be read
Recipe read_recipe(const std::filesystem::path& file, const std::vector<std::string>& overrides);

/// The same from the text of a recipe; `file` names it in messages and need not exist.
Recipe parse_recipe(const std::string& text, const std::filesystem::path& file,
                    const std::vector<std::string>& overrides);

/// Looks for every file that stages of a recipe read, and into the small ones, before the first
/// stage runs.
/// @param selected  which stages count, by index
/// @throws InvalidInput  all mistakes, one a line: `file:line:column: stage: key = path: no such
/// file`; InvalidParameter where one is of a file of parameters
void require_input_files(const Recipe& recipe, const std::vector<bool>& selected);

/// Sets the parameters of a stage from a TOML file of `key = value` lines (or a recipe's stage
/// table).
/// @param validate  called when all keys are understood; what it throws gets the place of the key
///                  that its message names
/// @throws InvalidParameter  all errors, one a line: `file:line:column: key: found, expected`
void apply_params_file(const std::filesystem::path& file, const ParamList& params,
                       const std::function<void()>& validate = {});

/// The recipe text that repeats a history and writes `output`.
std::string recipe_from_history(const std::vector<HistoryEntry>& history, const std::string& output,
                                bool every_value);

}  // namespace sekitei::apps
