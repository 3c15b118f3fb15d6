#pragma once

#include <optional>
#include <set>
#include <string>

#include "apps/recipe.h"

namespace sekitei::apps {

struct RunOptions {
    std::set<std::string> only;  ///< run these stages and what they read; empty = all
    bool dry_run = false;
    bool force = false;  ///< replace files this recipe did not make
    double memory_limit = 0;
    bool fix_nan = false;
};

/// Runs a recipe.
///
/// Each stage's result is kept in OUT/.sekitei under a key of the stage's version, its parameters,
/// its seed and the content hashes of what it reads; a stage whose key is there is not run again,
/// and a stage whose inputs come out the same as before is not run either. An interrupted run goes
/// on where it stopped. Files named by `write` and manifest.json, last, are put into OUT.
/// @return a summary: stages with state, reason and seconds, and the output files
Json run_recipe(const Recipe& recipe, const RunOptions& options);

/// Compares every file of a manifest with its recorded size and hash; returns the paths that
/// differ.
std::vector<std::string> verify_manifest(const std::filesystem::path& manifest);

/// An entry of the manifest: kind, size, hash, units and bounds of one output file.
/// @param bounds  of a mesh, where they are known: reading a large file again for them takes long
Json describe_output(const std::filesystem::path& path, const std::string& name,
                     const std::string& stage, const std::optional<Bounds>& bounds = {},
                     const Progress& progress = {});

}  // namespace sekitei::apps
