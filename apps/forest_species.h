#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "solvers/forest/species.h"

/// Species of a forest from files.
namespace sekitei::apps {

/// The name of forest::table_species().
inline constexpr const char* kForestTable = "table-5.1";

/// Species of a file of [[species]] tables, with the keys of forest::Species and limits = { water =
/// [0.2, 0.3, 0.4, 0.6, 0.7, 0.8] }.
/// @throws InvalidParameter  all mistakes, one a line: `file:line:column: key: found, expected`
std::vector<forest::Species> read_forest_species(const std::filesystem::path& file,
                                                 forest::SpreadMode mode);

/// "table-5.1" or a .toml file; with ":tall,shrub" or ":1,5" after it only these, in this order.
/// @throws InvalidParameter
std::vector<forest::Species> find_forest_species(const std::string& text,
                                                 const std::filesystem::path& folder,
                                                 forest::SpreadMode mode);
/// The file that such a text names; empty for the table.
std::filesystem::path forest_species_file(const std::string& text);

/// Index of a species by its name or by its number from 1.
/// @throws InvalidParameter  there is none, with the nearest name
int forest_species_index(const std::string& name, const std::vector<forest::Species>& species);

}  // namespace sekitei::apps
