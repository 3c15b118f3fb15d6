#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "apps/forest_maps.h"
#include "solvers/forest/edits.h"
#include "solvers/forest/species.h"

/// Edits and lists of trees in files.
namespace sekitei::apps {

/// What words of such files may mean.
struct ForestWords {
    ForestFrame frame;
    int bands = 5;
    std::vector<forest::Species> species;
    std::uint64_t seed = 1;  ///< of the uids of trees that have none of their own
};

/// Edits by step, in the order of the file within one:
///
///     [[edit]]
///     step = 31
///     map = [3, 4, 5]          # from 1
///     value = 0                # or multiply = 0.5, or image = "map.png"
///     disc = [128, 128, 64]    # or polygon = [[x, y], ...], or mask = "m.png"; none: everywhere
///
///     [[edit]]
///     step = 40
///     fell = true
///     min_height = 16
///
///     [[edit]]
///     step = 41
///     plant = [["tall", 100.5, 90.25, 2.0], [5, 80, 90, 1, "0x1139fd5694aac492"]]
///
/// Pictures lie beside the file. A tree higher than its species can be is planted at that height.
/// @throws InvalidParameter  all mistakes, one a line: `file:line:column: key: found, expected`
/// @throws InvalidInput      a picture, or one uid for two trees
std::vector<forest::Edit> read_edits(const std::filesystem::path& file, const ForestWords& words);
/// Pictures that a file of edits names, as paths beside it.
/// @throws InvalidParameter  not TOML
std::vector<std::filesystem::path> edit_files(const std::filesystem::path& file);

/// A file of edits and the pictures beside it, as names and bytes; the file itself comes first.
/// Reading it back gives the same edits.
/// @param stem  "edits" gives edits.toml, edits_step0031_map3.png
std::vector<std::pair<std::string, std::string>> encode_edits(
    const std::vector<forest::Edit>& edits, const std::vector<forest::Species>& species,
    const std::string& stem);

/// Trees of a list.
struct TreeList {
    std::vector<forest::NewTree> trees;
    std::uint64_t outside = 0;  ///< left out, since they stand outside the forest
    std::uint64_t clamped = 0;  ///< higher than their species can be, and made so high
};

/// Comma-separated values with a header: species, x, y, height and, if wanted, uid, in any order.
/// Species by name or number from 1, metres in the forest's coordinates, a uid in decimal or as
/// 0x1139fd5694aac492. Lines that begin with # are passed over. What is left out or clamped is
/// told in a warning.
/// @throws InvalidInput  all mistakes, one a line: `file:line:column: key = found, expected`
TreeList read_tree_list(const std::filesystem::path& file, const ForestWords& words);
/// The same from text.
TreeList parse_tree_list(const std::string& bytes, const std::string& name,
                         const ForestWords& words);

}  // namespace sekitei::apps
