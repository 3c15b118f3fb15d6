#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <limits>
#include <map>
#include <set>

#include "core/error.h"
#include "core/mesh_formats.h"
#include "core/mesh_objects.h"

// OBJ is read by code of our own: OpenMesh 9 drops groups, opens the material files that a mesh
// names, and indexes its vertex list with whatever a face says.
namespace sekitei::mesh_format {
namespace {

constexpr std::int32_t kNoName = -1;
constexpr std::size_t kMostNamed = 100;  ///< material files and textures to tell of

std::string_view trimmed(std::string_view text)
{
    const auto first = text.find_first_not_of(" \t");
    if (first == std::string_view::npos) return {};
    return text.substr(first, text.find_last_not_of(" \t") - first + 1);
}

/// Names of one statement (g, usemtl or o) and which of them each polygon has.
struct Naming {
    std::vector<std::string> names;
    std::map<std::string, std::int32_t> known;
    std::int32_t now = kNoName;
    std::vector<std::int32_t> of_polygon;

    void set(std::string_view rest)
    {
        rest = trimmed(rest);
        const std::string name(rest.empty() ? "default" : rest);
        const auto [entry, added] = known.emplace(name, static_cast<std::int32_t>(known.size()));
        if (added) names.push_back(name);
        now = entry->second;
    }
};

class Reader {
public:
    Reader(std::string_view bytes, const std::string& name) : lines_(bytes), name_(name)
    {
        out_.name = name;
    }

    Polygons read()
    {
        std::string joined;
        for (std::string_view line; lines_.next(line);) {
            line_ = lines_.number();
            // A backslash at its end carries a line on.
            if (line.ends_with('\\')) {
                joined.assign(line.substr(0, line.size() - 1));
                while (lines_.next(line) && line.ends_with('\\'))
                    joined.append(" ").append(line.substr(0, line.size() - 1));
                if (!line.ends_with('\\')) joined.append(" ").append(line);
                line = joined;
            }
            if (line.find('\0') != std::string_view::npos)
                throw InvalidInput(fmt::format(
                    "{}:{}: a zero byte: this is no text and no OBJ file", name_, line_));
            statement(line);
        }
        check_indices();
        texture_corners();
        out_.materials = material_.names;
        name_groups();
        if (!colours_.empty() && colours_.size() == out_.vertices.size())
            out_.vertex_attributes[kColour] = std::move(colours_);
        return std::move(out_);
    }

private:
    Lines lines_;
    std::string name_;
    Polygons out_;
    std::uint64_t line_ = 0;
    std::uint64_t most_ = 0;  ///< the largest index so far, from 1
    std::uint64_t most_line_ = 0;
    Naming group_, material_, object_;
    std::vector<Vec3f> colours_;
    std::vector<std::array<float, 2>> texture_;  ///< of the lines vt
    /// Of each corner, from the first that has one: its index into texture_ from 1, or 0.
    std::vector<std::uint32_t> texture_index_;
    std::uint64_t most_texture_ = 0, most_texture_line_ = 0;

    InvalidInput error(const std::string& what) const
    {
        return InvalidInput(fmt::format("{}:{}: {}", name_, line_, what));
    }

    void statement(std::string_view line)
    {
        const std::string_view key = take_word(line);
        if (key == "v")
            vertex(line);
        else if (key == "f")
            face(line);
        else if (key == "vt")
            texture(line);
        else if (key == "g")
            group_.set(line);
        else if (key == "usemtl")
            material_.set(line);
        else if (key == "o")
            object_.set(line);
        else if (key == "mtllib" && out_.material_files.size() < kMostNamed)
            out_.material_files.emplace_back(trimmed(line));
        // everything else (normals, curves, comments) has no use here
    }

    void vertex(std::string_view line)
    {
        double value[6];
        int count = 0;
        for (std::string_view word = take_word(line); !word.empty() && !word.starts_with('#');
             word = take_word(line)) {
            if (count == 6) break;
            if (!to_number(word, value[count]))
                throw error(fmt::format("'{}', must be a number", shown(word)));
            ++count;
        }
        if (count < 3) throw error(fmt::format("a vertex of {} numbers, must be 3", count));
        out_.vertices.emplace_back(static_cast<float>(value[0]), static_cast<float>(value[1]),
                                   static_cast<float>(value[2]));
        out_.places.push_back(line_);
        if (count == 6)
            colours_.emplace_back(static_cast<float>(value[3]), static_cast<float>(value[4]),
                                  static_cast<float>(value[5]));
    }

    void texture(std::string_view line)
    {
        std::array<float, 2> uv{};
        for (std::size_t k = 0; k < 2; ++k) {
            const std::string_view word = take_word(line);
            if (k == 1 && (word.empty() || word.starts_with('#'))) break;  // a line of one number
            double number = 0;
            if (!to_number(word, number))
                throw error(fmt::format("'{}', must be a number", shown(word)));
            uv[k] = static_cast<float>(number);
        }
        texture_.push_back(uv);
    }

    /// Reads an index that counts from 1, or back from the last of `count`; notes the largest.
    std::uint32_t index_of(std::string_view digits, std::string_view word, const char* what,
                           std::size_t known, std::uint64_t& most, std::uint64_t& most_line) const
    {
        std::int64_t index = 0;
        if (!to_integer(digits, index))
            throw error(fmt::format("'{}', must be a {} index", shown(word), what));
        const auto count = static_cast<std::int64_t>(known);
        if (index == 0 || index < -count || index > 0xFFFFFFFF)
            throw error(fmt::format("{} index {}, must be from 1, or from -{} when counted back",
                                    what, index, count));
        if (index < 0) return static_cast<std::uint32_t>(index + count + 1);
        if (static_cast<std::uint64_t>(index) > most) {
            most = static_cast<std::uint64_t>(index);
            most_line = line_;
        }
        return static_cast<std::uint32_t>(index);
    }

    void face(std::string_view line)
    {
        for (std::string_view word = take_word(line); !word.empty() && !word.starts_with('#');
             word = take_word(line)) {
            // 7, 7/1, 7//3 or 7/1/3: vertex, texture coordinates, normal
            const std::size_t slash = std::min(word.find('/'), word.size());
            out_.corners.push_back(index_of(word.substr(0, slash), word, "vertex",
                                            out_.vertices.size(), most_, most_line_) -
                                   1);
            std::string_view rest = word.substr(std::min(slash + 1, word.size()));
            rest = rest.substr(0, rest.find('/'));
            if (rest.empty()) continue;
            texture_index_.resize(out_.corners.size(), 0);
            texture_index_.back() =
                index_of(rest, word, "texture", texture_.size(), most_texture_, most_texture_line_);
        }
        out_.ends.push_back(out_.corners.size());
        group_.of_polygon.push_back(group_.now);
        material_.of_polygon.push_back(material_.now);
        object_.of_polygon.push_back(object_.now);
    }

    /// A face may come before its vertices, so the upper bound is known only now.
    void check_indices()
    {
        if (out_.vertices.empty())
            throw InvalidInput(
                fmt::format("{}: no vertex in {} lines: expected an OBJ file with lines 'v x y z'",
                            name_, lines_.number()));
        if (most_ > out_.vertices.size())
            throw InvalidInput(fmt::format("{}:{}: vertex index {}, must be 1 to {}", name_,
                                           most_line_, most_, out_.vertices.size()));
        if (most_texture_ > texture_.size())
            throw InvalidInput(
                fmt::format("{}:{}: texture index {}, but the file has {} lines 'vt'", name_,
                            most_texture_line_, most_texture_, texture_.size()));
    }

    void texture_corners()
    {
        if (texture_index_.empty()) return;
        texture_index_.resize(out_.corners.size(), 0);
        out_.texture.reserve(out_.corners.size());
        std::size_t without = 0;
        for (const std::uint32_t i : texture_index_) {
            without += i == 0;
            out_.texture.push_back(i == 0 ? std::array<float, 2>{} : texture_[i - 1]);
        }
        if (without > 0)
            out_.warnings.push_back(
                fmt::format("{}: {} of {} corners have no texture coordinates: they get (0, 0)",
                            name_, without, out_.corners.size()));
    }

    /// Groups name the faces; without groups the materials do, without these the objects.
    void name_groups()
    {
        Naming* naming = !group_.names.empty()      ? &group_
                         : !material_.names.empty() ? &material_
                                                    : &object_;
        if (naming->names.empty()) return;
        for (std::int32_t& i : naming->of_polygon)
            if (i == kNoName) {
                naming->set("default");
                i = naming->now;
            }
        out_.groups = naming->names;

        // Groups of our own files carry the column.
        std::vector<std::int32_t> column(naming->names.size());
        for (std::size_t i = 0; i < naming->names.size(); ++i) {
            std::string_view text = naming->names[i];
            std::int64_t id = 0;
            if (!text.starts_with("column_") || !to_integer(text.substr(7), id) || id < -1 ||
                id > std::numeric_limits<std::int32_t>::max()) {
                column.clear();
                break;
            }
            column[i] = static_cast<std::int32_t>(id);
        }
        if (!column.empty()) {
            std::vector<std::int32_t> ids;
            for (const std::int32_t i : naming->of_polygon) ids.push_back(column[std::size_t(i)]);
            out_.face_attributes["column"] = std::move(ids);
        }
        out_.face_attributes["group"] = std::move(naming->of_polygon);
    }
};

}  // namespace

bool looks_like_obj(std::string_view bytes)
{
    // Comments may come first, but a vertex, a group or a library soon.
    Lines lines(bytes.substr(0, 1 << 16));
    for (std::string_view line; lines.next(line);) {
        const std::string_view key = take_word(line);
        if (key.empty() || key.starts_with('#')) continue;
        double x = 0;
        if (key == "v") return to_number(take_word(line), x);
        if (key != "mtllib" && key != "o" && key != "g" && key != "s" && key != "usemtl" &&
            key != "vn" && key != "vt")
            return false;
    }
    return false;
}

Polygons read_obj(std::string_view bytes, const std::string& name)
{
    return Reader(bytes, name).read();
}

std::vector<std::string> material_textures(std::string_view mtl,
                                           const std::vector<std::string>& materials)
{
    std::vector<std::string> textures;
    const std::set<std::string_view> wanted(materials.begin(), materials.end());
    bool used = wanted.empty();
    Lines lines(mtl);
    for (std::string_view line; lines.next(line);) {
        const std::string_view key = take_word(line);
        if (key == "newmtl") used = wanted.empty() || wanted.contains(trimmed(line));
        if (!used || (key != "map_Kd" && key != "map_kd")) continue;
        // Options with their values come first: -clamp on, -mm 0 1, -o, -s and -t with 1 to 3.
        for (std::string_view rest = line; take_word(rest).starts_with('-'); rest = line) {
            const std::string_view option = take_word(line);
            const bool place = option == "-o" || option == "-s" || option == "-t";
            double number = 0;
            for (int i = 0; i < (place ? 3 : option == "-mm" ? 2 : 1); ++i) {
                std::string_view after = line;
                const std::string_view value = take_word(after);
                if (place && !to_number(value, number)) break;
                line = after;
            }
        }
        std::string file(trimmed(line));
        std::ranges::replace(file, '\\', '/');
        if (!file.empty() && textures.size() < kMostNamed &&
            std::ranges::count(textures, file) == 0)
            textures.push_back(std::move(file));
    }
    return textures;
}

std::string write_obj(const TriMesh& mesh, const Progress& progress)
{
    ObjCounts counts;
    return "# Sekitei: metres, z up\n" + obj_object(mesh, counts, progress);
}

}  // namespace sekitei::mesh_format

namespace sekitei {

std::string obj_object(const TriMesh& mesh, ObjCounts& counts, const Progress& progress)
{
    auto vectors = [&](const char* name) -> const std::vector<Vec3f>* {
        const auto found = mesh.vertex_attributes.find(name);
        return found == mesh.vertex_attributes.end()
                   ? nullptr
                   : std::get_if<std::vector<Vec3f>>(&found->second);
    };
    const auto* normals = vectors(mesh_format::kNormal);
    const auto* colours = vectors(mesh_format::kColour);
    std::string out;
    auto to = std::back_inserter(out);
    for (std::size_t i = 0; i < mesh.vertices.size(); ++i) {
        progress.check();
        const Vec3f v = mesh.vertices[i];
        fmt::format_to(to, "v {} {} {}", v.x, v.y, v.z);
        if (colours) {
            const Vec3f c = (*colours)[i];
            fmt::format_to(to, " {} {} {}", c.x, c.y, c.z);
        }
        out += '\n';
    }
    if (normals)
        for (const Vec3f& n : *normals) {
            progress.check();
            fmt::format_to(to, "vn {} {} {}\n", n.x, n.y, n.z);
        }

    // Equal texture coordinates are written once.
    const auto texture = mesh_format::texture_of(mesh);
    std::vector<std::uint64_t> pairs;
    const auto pair_of = [&](std::size_t k, std::uint32_t t) {
        const Vec3f uv = (*texture[k])[t];
        return std::uint64_t(std::bit_cast<std::uint32_t>(uv.x)) << 32 |
               std::bit_cast<std::uint32_t>(uv.y);
    };
    if (texture[0]) {
        pairs.reserve(3 * mesh.triangles.size());
        for (std::uint32_t t = 0; t < mesh.triangles.size(); ++t)
            for (std::size_t k = 0; k < 3; ++k) pairs.push_back(pair_of(k, t));
        std::sort(pairs.begin(), pairs.end());
        pairs.erase(std::unique(pairs.begin(), pairs.end()), pairs.end());
        for (const std::uint64_t p : pairs) {
            progress.check();
            fmt::format_to(to, "vt {} {}\n",
                           std::bit_cast<float>(static_cast<std::uint32_t>(p >> 32)),
                           std::bit_cast<float>(static_cast<std::uint32_t>(p & 0xFFFFFFFFu)));
        }
    }

    // Faces in their order, or column by column.
    std::vector<std::uint32_t> order(mesh.triangles.size());
    for (std::uint32_t t = 0; t < order.size(); ++t) order[t] = t;
    const std::vector<std::int32_t>* column = nullptr;
    if (const auto found = mesh.face_attributes.find("column"); found != mesh.face_attributes.end())
        column = std::get_if<std::vector<std::int32_t>>(&found->second);
    if (column)
        std::stable_sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
            progress.check();
            return (*column)[a] < (*column)[b];
        });
    for (std::size_t i = 0; i < order.size(); ++i) {
        progress.check();
        const std::uint32_t t = order[i];
        if (column && (i == 0 || (*column)[t] != (*column)[order[i - 1]]))
            (*column)[t] < 0 ? fmt::format_to(to, "g column_{}\n", (*column)[t])
                             : fmt::format_to(to, "g column_{:05}\n", (*column)[t]);
        out += 'f';
        for (std::size_t k = 0; k < 3; ++k) {
            const std::uint32_t v = mesh.triangles[t][k];
            fmt::format_to(to, " {}", counts.vertices + v + 1);
            if (texture[0])
                fmt::format_to(to, "/{}",
                               std::lower_bound(pairs.begin(), pairs.end(), pair_of(k, t)) -
                                   pairs.begin() + 1 +
                                   static_cast<std::ptrdiff_t>(counts.textures));
            if (normals)
                fmt::format_to(to, "{}{}", texture[0] ? "/" : "//", counts.normals + v + 1);
        }
        out += '\n';
    }
    counts.vertices += mesh.vertices.size();
    if (normals) counts.normals += normals->size();
    counts.textures += pairs.size();
    return out;
}

}  // namespace sekitei
