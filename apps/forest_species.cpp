#include "apps/forest_species.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <set>

#include "apps/habitat.h"
#include "apps/toml_file.h"
#include "apps/trees.h"
#include "core/csv.h"
#include "core/error.h"

namespace sekitei::apps {
namespace {

using forest::Limits;
using forest::Species;

constexpr std::size_t kMostSpecies = 255;

std::vector<std::string> names_of(const std::vector<Species>& species)
{
    std::vector<std::string> names;
    for (const Species& s : species) names.push_back(s.name);
    return names;
}

/// Six ascending numbers of one factor.
Limits limits_of(const std::string& factor, const toml::node& node)
{
    const std::string key = "limits." + factor;
    const toml::array* list = node.as_array();
    std::vector<double> at;
    if (list)
        for (const toml::node& one : *list)
            if (const auto number = one.value<double>(); number && one.is_number())
                at.push_back(*number);
    if (!list || list->size() != 6 || at.size() != 6)
        throw InvalidParameter(
            key +
            ": expected six numbers: dies_below, stands_below, best_from, best_to, stands_above, "
            "dies_above");
    return {factor, at[0], at[1], at[2], at[3], at[4], at[5]};
}

class SpeciesReader {
public:
    SpeciesReader(const std::filesystem::path& file, forest::SpreadMode mode)
        : errors_(file.string()), mode_(mode)
    {
    }

    std::vector<Species> read(const toml::table& root)
    {
        for (const auto& [key, node, source] : in_file_order(root)) {
            if (key != "species") {
                errors_.add(source, key + ": unknown key, expected [[species]] tables" +
                                        did_you_mean(key, {"species"}));
                continue;
            }
            const toml::array* tables = node->as_array();
            if (!tables || !tables->is_array_of_tables())
                errors_.add(source, "species: expected tables, each begun by [[species]]");
            else
                for (const toml::node& table : *tables) read_one(*table.as_table());
        }
        if (species_.empty() && !errors_.any())
            errors_.add(root.source(), "species: there is none, expected [[species]] tables");
        if (species_.size() > kMostSpecies)
            errors_.add(root.source(), fmt::format("species: {}, must be at most {}",
                                                   species_.size(), kMostSpecies));
        errors_.raise();
        return species_;
    }

private:
    void read_one(const toml::table& table)
    {
        Species species;
        const ParamList params = describe_params(species);
        std::vector<std::string> known{"limits"};
        for (const Param& param : params) known.push_back(param.name);
        bool good = true;
        auto wrong = [&](const toml::source_region& at, const std::string& text) {
            errors_.add(at, text);
            good = false;
        };
        if (!table.contains("name")) wrong(table.source(), "name: missing, expected a word");
        for (const auto& [key, node, source] : in_file_order(table)) {
            try {
                if (key == "limits") {
                    const toml::table* limits = node->as_table();
                    if (!limits)
                        throw InvalidParameter(
                            "limits: expected a table such as { water = [0.2, 0.3, 0.4, 0.6, 0.7, "
                            "0.8] }");
                    for (const auto& [factor, six, where] : in_file_order(*limits)) try {
                            species.limits.push_back(limits_of(factor, *six));
                        } catch (const InvalidParameter& error) {
                            wrong(six->source(), error.what());
                        }
                } else if (const Param* param = find_param(params, key)) {
                    param->set(json_of(*node, key));
                } else {
                    wrong(source, key + ": unknown key" + did_you_mean(key, known));
                }
            } catch (const InvalidParameter& error) {
                wrong(node->source(), error.what());
            }
        }
        if (good) check(table, species);
        if (good && !names_.insert(species.name).second)
            errors_.add(table.at("name").source(),
                        fmt::format("name: there are two species '{}'", species.name));
        species_.push_back(std::move(species));
    }

    /// What one key alone does not show.
    void check(const toml::table& table, const Species& species)
    {
        try {
            forest::validate(species, mode_);
        } catch (const InvalidParameter& error) {
            const std::string what = error.what();
            toml::source_region at = place_of_blame(
                table, fmt::format("species '{}'", species.name), what, table.source());
            if (const toml::table* limits = table.get_as<toml::table>("limits"))
                for (const auto& [factor, six] : *limits)
                    if (what.find(fmt::format("limits.{}:", factor.str())) != std::string::npos)
                        at = six.source();
            errors_.add(at, what);
        }
        std::vector<std::string> kinds;
        for (const tree::Species& kind : preset_trees()) kinds.push_back(kind.name);
        if (!species.tree.ends_with(".toml") &&
            std::find(kinds.begin(), kinds.end(), species.tree) == kinds.end())
            errors_.add(
                table.contains("tree") ? table.at("tree").source() : table.source(),
                fmt::format("tree = {}: no such kind of tree, expected one of {}{}", species.tree,
                            fmt::join(kinds, ", "), did_you_mean(species.tree, kinds)));
    }

    TomlErrors errors_;
    forest::SpreadMode mode_;
    std::vector<Species> species_;
    std::set<std::string> names_;
};

/// "hills.toml" and "fir,oak" of "hills.toml:fir,oak".
std::pair<std::string, std::string> halves(const std::string& text)
{
    // A colon in a folder's name is none of ours.
    const std::size_t colon = text.rfind(':'), toml = text.rfind(".toml");
    if (colon == std::string::npos || (toml != std::string::npos && colon < toml))
        return {text, ""};
    return {text.substr(0, colon), text.substr(colon + 1)};
}

}  // namespace

std::vector<Species> read_forest_species(const std::filesystem::path& file, forest::SpreadMode mode)
{
    return SpeciesReader(file, mode).read(read_toml(file));
}

std::vector<Species> find_forest_species(const std::string& text,
                                         const std::filesystem::path& folder,
                                         forest::SpreadMode mode)
{
    const auto [name, chosen] = halves(text);
    std::vector<Species> all;
    if (const std::filesystem::path path(name); path.extension() == ".toml")
        all = read_forest_species(path.is_absolute() ? path : folder / path, mode);
    else if (name == kForestTable)
        all = forest::table_species();
    else
        throw InvalidParameter(
            fmt::format("species = {}: no such species, expected {} or a .toml file{}", text,
                        kForestTable, did_you_mean(name, {kForestTable})));
    if (name.size() == text.size()) return all;
    std::vector<Species> some;
    for (const std::string& one : split_names(chosen)) {
        const Species& species = all[std::size_t(forest_species_index(one, all))];
        if (std::any_of(some.begin(), some.end(),
                        [&](const Species& other) { return other.name == species.name; }))
            throw InvalidParameter(
                fmt::format("species = {}: '{}' is chosen twice", text, species.name));
        some.push_back(species);
    }
    if (some.empty())
        throw InvalidParameter(
            fmt::format("species = {}: nothing is chosen after the colon", text));
    return some;
}

std::filesystem::path forest_species_file(const std::string& text)
{
    const std::filesystem::path path(halves(text).first);
    return path.extension() == ".toml" ? path : std::filesystem::path();
}

int forest_species_index(const std::string& name, const std::vector<Species>& species)
{
    for (std::size_t s = 0; s < species.size(); ++s)
        if (species[s].name == name) return static_cast<int>(s);
    if (const auto number = number_of(name))
        if (*number >= 1 && *number <= double(species.size()) && *number == int(*number))
            return static_cast<int>(*number) - 1;
    const std::vector<std::string> names = names_of(species);
    throw InvalidParameter(
        fmt::format("species = {}: no such species, expected 1 to {} or one of {}{}", name,
                    species.size(), fmt::join(names, ", "), did_you_mean(name, names)));
}

}  // namespace sekitei::apps
