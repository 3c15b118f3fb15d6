#include "apps/forest_edits.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <bit>
#include <charconv>
#include <cmath>
#include <optional>
#include <set>
#include <unordered_map>

#include "apps/forest_species.h"
#include "apps/toml_file.h"
#include "core/csv.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/log.h"
#include "core/random.h"

namespace sekitei::apps {
namespace {

using forest::Edit;
using forest::NewTree;
using forest::Region;
using forest::Species;

constexpr std::uint64_t kLargestLog = 64u << 20;  // a million planted trees
constexpr Stream kPlanted{"forest.planted"}, kListed{"forest.listed"};

/// "0x1139fd5694aac492", or a decimal number; negative ones are the bits of a 64-bit integer.
std::optional<std::uint64_t> uid_of(std::string_view text)
{
    auto whole = [&](auto value, int base) -> std::optional<std::uint64_t> {
        const auto [end, error] =
            std::from_chars(text.data(), text.data() + text.size(), value, base);
        if (error != std::errc{} || end != text.data() + text.size()) return std::nullopt;
        return static_cast<std::uint64_t>(value);
    };
    if (text.starts_with("0x") || text.starts_with("0X")) {
        text.remove_prefix(2);
        return whole(std::uint64_t(0), 16);
    }
    return text.starts_with('-') ? whole(std::int64_t(0), 10) : whole(std::uint64_t(0), 10);
}

std::string uid_text(std::uint64_t uid)
{
    return fmt::format("0x{:016x}", uid);
}

// --- reading edits ---

const std::vector<std::string>& edit_keys()
{
    static const std::vector<std::string> keys{"step",  "map",        "value",   "multiply",
                                               "image", "disc",       "polygon", "mask",
                                               "fell",  "min_height", "plant"};
    return keys;
}

class EditReader {
public:
    EditReader(const std::filesystem::path& file, const ForestWords& words)
        : file_(file), words_(words), errors_(file.string())
    {
    }

    std::vector<Edit> read()
    {
        const toml::table root = read_toml(file_, kLargestLog);
        for (const auto& [key, node, source] : in_file_order(root)) {
            if (key != "edit") {
                errors_.add(source, key + ": unknown key, expected [[edit]] tables" +
                                        did_you_mean(key, {"edit"}));
                continue;
            }
            const toml::array* tables = node->as_array();
            if (!tables || !tables->is_array_of_tables())
                errors_.add(source, "edit: expected tables, each begun by [[edit]]");
            else
                for (const toml::node& table : *tables) read_one(*table.as_table());
        }
        if (errors_.any())
            for (const auto& [place, text] : bad_inputs_) errors_.add(place, text);
        errors_.raise();
        std::vector<std::string> lines;
        for (const auto& [place, text] : bad_inputs_) lines.push_back(place + ": " + text);
        if (!lines.empty()) throw InvalidInput(fmt::format("{}", fmt::join(lines, "\n")));
        if (clamped_ > 0)
            log::warning(
                "{}: {} trees to plant are higher than their species can be, and are "
                "planted at that height",
                file_.string(), clamped_);
        std::stable_sort(edits_.begin(), edits_.end(),
                         [](const Edit& a, const Edit& b) { return a.step < b.step; });
        return std::move(edits_);
    }

private:
    /// Runs `read` on the value of a key if it is there; what it throws gets the value's place.
    template <class F>
    bool with(const toml::table& table, const char* key, F&& read)
    {
        const toml::node* node = table.get(key);
        if (!node) return false;
        try {
            read(*node);
        } catch (const InvalidParameter& error) {
            errors_.add(node->source(), error.what());
        } catch (const InvalidInput& error) {
            bad_inputs_.emplace_back(errors_.place(node->source()),
                                     fmt::format("{}: {}", key, error.what()));
        }
        return true;
    }

    static double number(const toml::node& node, const std::string& key, const Range& range)
    {
        const auto value = node.is_number() ? node.value<double>() : std::nullopt;
        if (!value || !std::isfinite(*value)) throw InvalidParameter(key + ": expected a number");
        if (!range.contains(*value))
            throw InvalidParameter(fmt::format("{} = {}, must be {}", key, *value, range.text()));
        return *value;
    }
    static int integer(const toml::node& node, const std::string& key, int lower, int upper)
    {
        const auto* value = node.as_integer();
        if (!value) throw InvalidParameter(key + ": expected a whole number");
        if (value->get() < lower || value->get() > upper)
            throw InvalidParameter(
                fmt::format("{} = {}, must be {} to {}", key, value->get(), lower, upper));
        return static_cast<int>(value->get());
    }
    static std::vector<double> numbers(const toml::node& node, const std::string& key,
                                       std::size_t count, const std::string& what)
    {
        const toml::array* list = node.as_array();
        if (!list || list->size() != count)
            throw InvalidParameter(fmt::format("{}: expected {}", key, what));
        std::vector<double> values;
        for (const toml::node& one : *list) values.push_back(number(one, key, kAny));
        return values;
    }
    Image16 picture(const toml::node& node, const std::string& key, std::string& name) const
    {
        const auto* text = node.as_string();
        if (!text) throw InvalidParameter(key + ": expected the name of a .png file");
        const std::filesystem::path path = file_.parent_path() / text->get();
        name = path.string();
        return read_png_grey16(path);
    }

    void read_one(const toml::table& table)
    {
        Edit edit;
        for (const auto& [key, node, source] : in_file_order(table))
            if (std::find(edit_keys().begin(), edit_keys().end(), key) == edit_keys().end())
                errors_.add(source, key + ": unknown key" + did_you_mean(key, edit_keys()));
        const bool step = with(table, "step", [&](const toml::node& node) {
            edit.step = integer(node, "step", 1, 1 << 30);
        });
        if (!step) errors_.add(table.source(), "step: missing, expected the number of a step");
        read_action(table, edit);
        read_region(table, edit.region);

        const bool on_map = edit.kind == Edit::Kind::Set || edit.kind == Edit::Kind::Multiply ||
                            edit.kind == Edit::Kind::Image;
        std::vector<int> maps{0};
        const bool map = with(table, "map", [&](const toml::node& node) {
            maps.clear();
            if (const toml::array* list = node.as_array()) {
                for (const toml::node& one : *list)
                    maps.push_back(integer(one, "map", 1, words_.bands) - 1);
                if (maps.empty())
                    throw InvalidParameter("map: expected a number or a list of them");
            } else {
                maps.push_back(integer(node, "map", 1, words_.bands) - 1);
            }
        });
        if (on_map && acts_ == 1 && !map)
            errors_.add(table.source(),
                        fmt::format("map: missing, expected 1 to {}, or a list", words_.bands));
        if (!on_map) refuse(table, {"map"}, "is for edits of maps");
        if (edit.kind != Edit::Kind::Fell) refuse(table, {"min_height"}, "goes with fell = true");
        if (edit.kind == Edit::Kind::Plant)
            refuse(table, {"disc", "polygon", "mask"}, "says nothing about trees to plant");
        for (const int band : maps) {
            edit.map = band;
            edits_.push_back(edit);
        }
    }

    void refuse(const toml::table& table, const std::vector<const char*>& keys, const char* why)
    {
        for (const char* key : keys)
            if (const toml::node* node = table.get(key))
                errors_.add(node->source(), fmt::format("{}: {}", key, why));
    }

    /// Exactly one of what an edit may do.
    void read_action(const toml::table& table, Edit& edit)
    {
        acts_ = 0;
        acts_ += with(table, "value", [&](const toml::node& node) {
            edit.kind = Edit::Kind::Set;
            edit.value = number(node, "value", kFraction);
        });
        acts_ += with(table, "multiply", [&](const toml::node& node) {
            edit.kind = Edit::Kind::Multiply;
            edit.value = number(node, "multiply", kNotNegative);
        });
        acts_ += with(table, "image", [&](const toml::node& node) {
            edit.kind = Edit::Kind::Image;
            std::string name;
            const Image16 image = picture(node, "image", name);
            edit.image = image_map(image, name, words_.frame);
        });
        acts_ += with(table, "fell", [&](const toml::node& node) {
            edit.kind = Edit::Kind::Fell;
            const auto* flag = node.as_boolean();
            if (!flag || !flag->get()) throw InvalidParameter("fell: expected true");
        });
        acts_ += with(table, "plant", [&](const toml::node& node) {
            edit.kind = Edit::Kind::Plant;
            read_trees(node, edit);
        });
        with(table, "min_height", [&](const toml::node& node) {
            edit.min_height = number(node, "min_height", kNotNegative);
        });
        if (acts_ != 1)
            errors_.add(table.source(),
                        fmt::format("edit: {} of value, multiply, image, fell and plant, expected "
                                    "one of them",
                                    acts_ == 0 ? "none" : fmt::format("{}", acts_)));
    }

    void read_region(const toml::table& table, Region& region)
    {
        int regions = 0;
        regions += with(table, "disc", [&](const toml::node& node) {
            const auto at = numbers(node, "disc", 3, "[x, y, radius] in metres");
            if (at[2] < 0)
                throw InvalidParameter(fmt::format("disc: radius = {}, must be >= 0 m", at[2]));
            region.kind = Region::Kind::Disc;
            region.x = at[0];
            region.y = at[1];
            region.radius = at[2];
        });
        regions += with(table, "polygon", [&](const toml::node& node) {
            const toml::array* list = node.as_array();
            if (!list || list->size() < 3)
                throw InvalidParameter("polygon: expected at least three corners [x, y] in metres");
            region.kind = Region::Kind::Polygon;
            for (const toml::node& corner : *list) {
                const auto at = numbers(corner, "polygon", 2, "corners [x, y] in metres");
                region.corners.push_back({at[0], at[1]});
            }
        });
        regions += with(table, "mask", [&](const toml::node& node) {
            region.kind = Region::Kind::Mask;
            region.pixel = words_.frame.pixel;
            std::string name;
            const Image16 image = picture(node, "mask", name);
            region.mask = image_mask(image, name, words_.frame);
        });
        if (regions > 1)
            errors_.add(table.source(), fmt::format("edit: {} regions, expected one of disc, "
                                                    "polygon and mask, or none for everywhere",
                                                    regions));
    }

    void read_trees(const toml::node& node, Edit& edit)
    {
        const toml::array* list = node.as_array();
        if (!list) throw InvalidParameter("plant: expected [[species, x, y, height], ...]");
        for (const toml::node& one : *list) {
            const std::uint64_t place = planted_++;
            try {
                edit.trees.push_back(read_tree(one, place));
            } catch (const InvalidParameter& error) {
                errors_.add(one.source(), error.what());
                continue;
            }
            const NewTree& tree = edit.trees.back();
            const auto [first, is_new] = uids_.try_emplace(tree.uid, errors_.place(one.source()));
            if (!is_new)
                bad_inputs_.emplace_back(
                    errors_.place(one.source()),
                    fmt::format("plant: uid = {} is the tree's at {} already, must be new",
                                uid_text(tree.uid), first->second));
        }
    }

    NewTree read_tree(const toml::node& node, std::uint64_t place)
    {
        const toml::array* row = node.as_array();
        if (!row || row->size() < 4 || row->size() > 5)
            throw InvalidParameter(
                "plant: expected [species, x, y, height] or [species, x, y, height, uid]");
        NewTree tree;
        const toml::node& species = *row->get(0);
        if (const auto* name = species.as_string())
            tree.species = forest_species_index(name->get(), words_.species);
        else if (species.is_integer())
            tree.species = forest_species_index(fmt::format("{}", species.as_integer()->get()),
                                                words_.species);
        else
            throw InvalidParameter("plant: species: expected a name or a number");
        tree.x = number(*row->get(1), "plant: x", kAny);
        tree.y = number(*row->get(2), "plant: y", kAny);
        tree.height = number(*row->get(3), "plant: height", kPositive);
        const double highest = words_.species[std::size_t(tree.species)].max_height;
        if (tree.height > highest) {
            tree.height = highest;
            ++clamped_;
        }
        tree.uid = hash2(hash2(words_.seed, kPlanted.id), place);
        if (row->size() == 5) {
            const toml::node& uid = *row->get(4);
            const auto given = uid.is_string()    ? uid_of(uid.as_string()->get())
                               : uid.is_integer() ? std::optional(std::bit_cast<std::uint64_t>(
                                                        std::int64_t(uid.as_integer()->get())))
                                                  : std::nullopt;
            if (!given)
                throw InvalidParameter(
                    "plant: uid: expected a whole number or \"0x...\" in hexadecimal");
            tree.uid = *given;
        }
        return tree;
    }

    std::filesystem::path file_;
    const ForestWords& words_;
    TomlErrors errors_;
    /// Mistakes that are not the file's own words, with their places.
    std::vector<std::pair<std::string, std::string>> bad_inputs_;
    std::vector<Edit> edits_;
    std::unordered_map<std::uint64_t, std::string> uids_;
    std::uint64_t planted_ = 0, clamped_ = 0;
    int acts_ = 0;  ///< of the table at hand
};

// --- writing edits ---

std::string numbers_text(std::initializer_list<double> values)
{
    return fmt::format("[{}]", fmt::join(values, ", "));
}

class EditWriter {
public:
    EditWriter(const std::vector<Species>& species, std::string stem)
        : species_(species), stem_(std::move(stem))
    {
        files_.push_back({stem_ + ".toml", ""});
    }

    std::vector<std::pair<std::string, std::string>> write(const std::vector<Edit>& edits)
    {
        std::string text;
        for (const Edit& edit : edits) text += (text.empty() ? "" : "\n") + table(edit);
        files_.front().second = std::move(text);
        return std::move(files_);
    }

private:
    std::string table(const Edit& edit)
    {
        std::string text = fmt::format("[[edit]]\nstep = {}\n", edit.step);
        std::string what = fmt::format("map{}", edit.map + 1);
        switch (edit.kind) {
            case Edit::Kind::Set:
                text += fmt::format("map = {}\nvalue = {}\n", edit.map + 1, edit.value);
                break;
            case Edit::Kind::Multiply:
                text += fmt::format("map = {}\nmultiply = {}\n", edit.map + 1, edit.value);
                break;
            case Edit::Kind::Image:
                text += fmt::format(
                    "map = {}\nimage = {}\n", edit.map + 1,
                    Json(add(edit.step, what, encode_png(map_image(edit.image)))).dump());
                break;
            case Edit::Kind::Fell:
                what = "fell";
                text += "fell = true\n";
                if (edit.min_height > 0) text += fmt::format("min_height = {}\n", edit.min_height);
                break;
            case Edit::Kind::Plant:
                text += "plant = [\n";
                for (const NewTree& tree : edit.trees)
                    text += fmt::format("    [{}, {}, {}, {}, \"{}\"],\n",
                                        Json(species_.at(std::size_t(tree.species)).name).dump(),
                                        tree.x, tree.y, tree.height, uid_text(tree.uid));
                return text + "]\n";
        }
        const Region& region = edit.region;
        if (region.kind == Region::Kind::Disc)
            text += fmt::format("disc = {}\n", numbers_text({region.x, region.y, region.radius}));
        if (region.kind == Region::Kind::Polygon) {
            std::vector<std::string> corners;
            for (const auto& [x, y] : region.corners) corners.push_back(numbers_text({x, y}));
            text += fmt::format("polygon = [{}]\n", fmt::join(corners, ", "));
        }
        if (region.kind == Region::Kind::Mask)
            text += fmt::format(
                "mask = {}\n",
                Json(add(edit.step, what + "_mask", encode_png(mask_image(region.mask)))).dump());
        return text;
    }

    /// A picture beside the file, under a name that no other has.
    std::string add(int step, const std::string& what, std::string bytes)
    {
        const std::string base = fmt::format("{}_step{:04}_{}", stem_, step, what);
        std::string name = base + ".png";
        for (int k = 2; !names_.insert(name).second; ++k) name = fmt::format("{}_{}.png", base, k);
        files_.push_back({name, std::move(bytes)});
        return name;
    }

    const std::vector<Species>& species_;
    std::string stem_;
    std::vector<std::pair<std::string, std::string>> files_;
    std::set<std::string> names_;
};

// --- lists of trees ---

class ListReader {
public:
    ListReader(const std::string& name, const ForestWords& words)
        : name_(name), words_(words), problems_(name)
    {
    }

    TreeList read(const std::string& bytes)
    {
        const std::string text = decode_text(bytes, name_, "", problems_);
        CsvReader reader(text);
        std::string_view line;
        std::vector<CsvCell> cells;
        bool header = false;
        while (reader.next_line(line)) {
            if (line.find_first_not_of(" \t") == std::string_view::npos || line.starts_with('#'))
                continue;
            CsvReader::split(line, ',', cells);
            if (!header) {
                header = true;
                read_header(cells, reader.line());
                problems_.throw_if_any();  // without columns no row has a meaning
            } else {
                read_row(cells, reader.line());
            }
        }
        if (!header) problems_.add(1, 1, "no header, expected species,x,y,height");
        problems_.throw_if_any();
        if (list_.outside > 0)
            log::warning("{}: {} of {} trees stand outside the forest and are left out", name_,
                         list_.outside, rows_);
        if (list_.clamped > 0)
            log::warning("{}: {} trees are higher than their species can be, and made so high",
                         name_, list_.clamped);
        return std::move(list_);
    }

private:
    enum { kSpecies, kX, kY, kHeight, kUid, kCount };

    void read_header(const std::vector<CsvCell>& cells, std::size_t line)
    {
        const std::vector<std::string> names{"species", "x", "y", "height", "uid"};
        column_.fill(-1);
        for (std::size_t c = 0; c < cells.size(); ++c) {
            const std::string cell(cells[c].text);
            const auto found = std::find(names.begin(), names.end(), cell);
            if (found == names.end())
                problems_.add(line, cells[c].column,
                              fmt::format("{}: unknown column, expected species, x, y, height and "
                                          "uid{}",
                                          sekitei::quoted(cell), did_you_mean(cell, names)));
            else if (int& place = column_[std::size_t(found - names.begin())]; place >= 0)
                problems_.add(line, cells[c].column, cell + ": this column is there already");
            else
                place = static_cast<int>(c);
        }
        for (std::size_t k = 0; k < kUid; ++k)
            if (column_[k] < 0)
                problems_.add(line, 1, fmt::format("{}: this column is missing", names[k]));
        width_ = cells.size();
    }

    void read_row(const std::vector<CsvCell>& cells, std::size_t line)
    {
        const std::uint64_t row = rows_++;
        if (cells.size() != width_) {
            problems_.add(
                line, 1,
                fmt::format("{} cells, expected {} as in the header", cells.size(), width_));
            return;
        }
        bool good = true;
        auto wrong = [&](int k, const std::string& text) {
            problems_.add(line, cells[std::size_t(column_[std::size_t(k)])].column, text);
            good = false;
        };
        auto cell = [&](int k) { return cells[std::size_t(column_[std::size_t(k)])].text; };
        auto number = [&](int k, const char* key) {
            const auto value = number_of(cell(k));
            if (!value) wrong(k, fmt::format("{} = {}, must be a number", key, quoted(cell(k))));
            return value.value_or(1);
        };
        NewTree tree;
        try {
            tree.species = forest_species_index(std::string(cell(kSpecies)), words_.species);
        } catch (const InvalidParameter& error) {
            wrong(kSpecies, error.what());
        }
        tree.x = number(kX, "x");
        tree.y = number(kY, "y");
        tree.height = number(kHeight, "height");
        if (!(tree.height > 0))
            wrong(kHeight, fmt::format("height = {}, must be > 0 m", tree.height));
        tree.uid = hash2(hash2(words_.seed, kListed.id), row);
        if (column_[kUid] >= 0 && !cell(kUid).empty()) {
            if (const auto uid = uid_of(cell(kUid)))
                tree.uid = *uid;
            else
                wrong(kUid,
                      fmt::format("uid = {}, must be a whole number of 64 bits, in decimal or "
                                  "as 0x...",
                                  quoted(cell(kUid))));
        }
        if (!good) return;
        if (const auto [first, is_new] = lines_.try_emplace(tree.uid, line); !is_new) {
            problems_.add(line, column_[kUid] < 0 ? 1 : cells[std::size_t(column_[kUid])].column,
                          fmt::format("uid = {} is that of the tree in line {} too, must be new",
                                      uid_text(tree.uid), first->second));
            return;
        }
        const ForestFrame& frame = words_.frame;
        if (!(tree.x >= 0 && tree.y >= 0 && tree.x < frame.width * frame.pixel &&
              tree.y < frame.depth * frame.pixel)) {
            ++list_.outside;
            return;
        }
        if (const double highest = words_.species[std::size_t(tree.species)].max_height;
            tree.height > highest) {
            tree.height = highest;
            ++list_.clamped;
        }
        list_.trees.push_back(tree);
    }

    std::string name_;
    const ForestWords& words_;
    Problems problems_;
    TreeList list_;
    std::array<int, kCount> column_{};
    std::size_t width_ = 0;
    std::uint64_t rows_ = 0;
    std::unordered_map<std::uint64_t, std::size_t> lines_;  // where each uid stands
};

}  // namespace

std::vector<Edit> read_edits(const std::filesystem::path& file, const ForestWords& words)
{
    return EditReader(file, words).read();
}

std::vector<std::filesystem::path> edit_files(const std::filesystem::path& file)
{
    std::vector<std::filesystem::path> files;
    const toml::table root = read_toml(file, kLargestLog);
    if (const toml::array* edits = root.get_as<toml::array>("edit"))
        for (const toml::node& edit : *edits)
            if (const toml::table* table = edit.as_table())
                for (const char* key : {"image", "mask"})
                    if (const auto* name = table->get_as<std::string>(key)) {
                        const auto path = file.parent_path() / name->get();
                        if (std::find(files.begin(), files.end(), path) == files.end())
                            files.push_back(path);
                    }
    return files;
}

std::vector<std::pair<std::string, std::string>> encode_edits(const std::vector<Edit>& edits,
                                                              const std::vector<Species>& species,
                                                              const std::string& stem)
{
    return EditWriter(species, stem).write(edits);
}

TreeList read_tree_list(const std::filesystem::path& file, const ForestWords& words)
{
    return parse_tree_list(read_file(file), file.string(), words);
}

TreeList parse_tree_list(const std::string& bytes, const std::string& name,
                         const ForestWords& words)
{
    return ListReader(name, words).read(bytes);
}

}  // namespace sekitei::apps
