#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <optional>
#include <set>

#include "core/error.h"
#include "core/mesh_formats.h"
#include "core/parallel.h"

// PLY is read by code of our own: OpenMesh 9 believes the counts of the header before it looks at
// the file, keeps custom properties only of types and names registered beforehand, and tells no
// line or byte when it fails.
namespace sekitei::mesh_format {
namespace {

enum class Type { Int8, Uint8, Int16, Uint16, Int32, Uint32, Float, Double };

struct TypeName {
    const char* name;
    Type type;
};
constexpr TypeName kTypes[] = {
    {"char", Type::Int8},     {"int8", Type::Int8},     {"uchar", Type::Uint8},
    {"uint8", Type::Uint8},   {"short", Type::Int16},   {"int16", Type::Int16},
    {"ushort", Type::Uint16}, {"uint16", Type::Uint16}, {"int", Type::Int32},
    {"int32", Type::Int32},   {"uint", Type::Uint32},   {"uint32", Type::Uint32},
    {"float", Type::Float},   {"float32", Type::Float}, {"double", Type::Double},
    {"float64", Type::Double}};

std::size_t size_of(Type type)
{
    switch (type) {
        case Type::Int8:
        case Type::Uint8:
            return 1;
        case Type::Int16:
        case Type::Uint16:
            return 2;
        case Type::Double:
            return 8;
        default:
            return 4;
    }
}

bool is_integer(Type type)
{
    return type != Type::Float && type != Type::Double;
}

struct Property {
    std::string name;
    Type type = Type::Float;
    bool list = false;
    Type count_type = Type::Uint8;
};

struct Element {
    std::string name;
    std::uint64_t count = 0;
    std::vector<Property> properties;
};

enum class Encoding { Ascii, Little, Big };

/// The values of one scalar property.
struct Column {
    std::vector<float> numbers;
    std::vector<std::int32_t> integers;
    bool overflow = false;

    void add(Type type, double value)
    {
        if (!is_integer(type)) return numbers.push_back(static_cast<float>(value));
        // Only uint can exceed int32.
        overflow = overflow || value > std::numeric_limits<std::int32_t>::max();
        integers.push_back(overflow ? 0 : static_cast<std::int32_t>(value));
    }
};

class Reader {
public:
    Reader(std::string_view bytes, const std::string& name) : bytes_(bytes), name_(name)
    {
        out_.name = name;
    }

    Polygons read()
    {
        header();
        if (!has_faces())
            throw InvalidInput(fmt::format(
                "{}: the header has no element 'face': a surface is needed, not a point cloud",
                name_));
        for (const Element& element : elements_) {
            if (element.name == "vertex")
                vertices(element);
            else if (element.name == "face")
                faces(element);
            else {
                out_.warnings.push_back(
                    fmt::format("{}: element '{}' is not used", name_, element.name));
                skip(element);
            }
        }
        texture_of_vertices();
        warn_of_rest();
        return std::move(out_);
    }

    std::optional<PointsReport> describe_points()
    {
        header();
        for (const Element& e : elements_)
            if (e.name == "face" && e.count > 0) return std::nullopt;
        PointsReport report;
        report.points = vertex_count_;
        for (const Element& e : elements_)
            if (e.name == "vertex")
                ranges(e, report);
            else
                skip(e);
        warn_of_rest();
        report.warnings = std::move(out_.warnings);
        return report;
    }

private:
    std::string_view bytes_;
    std::string name_;
    Polygons out_;
    Encoding encoding_ = Encoding::Ascii;
    std::vector<Element> elements_;
    std::uint64_t vertex_count_ = 0;
    std::size_t at_ = 0;      ///< the next byte
    std::uint64_t line_ = 0;  ///< lines taken
    std::size_t row_at_ = 0;  ///< where the present row begins
    std::string_view row_;    ///< what is left of the present row of text

    InvalidInput header_error(const std::string& what) const
    {
        return InvalidInput(fmt::format("{}:{}: {}", name_, line_, what));
    }

    /// "cliff.ply:57" or "cliff.ply: byte 4711".
    std::string place() const
    {
        return encoding_ == Encoding::Ascii ? fmt::format("{}:{}", name_, line_)
                                            : fmt::format("{}: byte {}", name_, row_at_);
    }

    bool take_line(std::string_view& line)
    {
        if (at_ >= bytes_.size()) return false;
        const std::size_t end = std::min(bytes_.find('\n', at_), bytes_.size());
        line = bytes_.substr(at_, end - at_);
        if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
        at_ = std::min(end + 1, bytes_.size());
        ++line_;
        return true;
    }

    Type type(std::string_view word) const
    {
        for (const TypeName& t : kTypes)
            if (word == t.name) return t.type;
        throw header_error(
            fmt::format("type '{}', must be one of char uchar short ushort int uint float double",
                        shown(word)));
    }

    void header()
    {
        std::string_view line;
        if (!take_line(line) || line != "ply")
            throw InvalidInput(
                fmt::format("{}: not a PLY file: it does not begin with 'ply'", name_));
        bool ended = false, formatted = false;
        while (!ended && take_line(line)) {
            if (at_ == bytes_.size() && bytes_.back() != '\n') break;  // a line cut in two
            const std::string_view word = take_word(line);
            if (word == "end_header")
                ended = true;
            else if (word == "format") {
                const std::string_view kind = take_word(line);
                if (kind == "ascii")
                    encoding_ = Encoding::Ascii;
                else if (kind == "binary_little_endian")
                    encoding_ = Encoding::Little;
                else if (kind == "binary_big_endian")
                    encoding_ = Encoding::Big;
                else
                    throw header_error(fmt::format(
                        "format '{}', must be ascii, binary_little_endian or binary_big_endian",
                        shown(kind)));
                formatted = true;
            } else if (word == "element")
                element(line);
            else if (word == "property")
                property(line);
            else if (word != "comment" && word != "obj_info" && !word.empty())
                throw header_error(
                    fmt::format("'{}', expected format, element, property, comment or end_header",
                                shown(word)));
        }
        if (!ended)
            throw InvalidInput(
                fmt::format("{}: truncated: the file of {} bytes ends before end_header", name_,
                            bytes_.size()));
        if (!formatted) throw header_error("the header has no 'format' line");
        check_sizes();
    }

    void element(std::string_view line)
    {
        Element e;
        e.name = shown(take_word(line));
        const std::string_view word = take_word(line);
        std::int64_t count = 0;
        if (!to_integer(word, count) || count < 0)
            throw header_error(fmt::format("element {} has the count '{}', must be 0 or more",
                                           e.name, shown(word)));
        e.count = static_cast<std::uint64_t>(count);
        for (const Element& other : elements_)
            if (other.name == e.name)
                throw header_error(fmt::format("element {} appears twice", e.name));
        elements_.push_back(std::move(e));
    }

    void property(std::string_view line)
    {
        if (elements_.empty()) throw header_error("a property before the first element");
        Property p;
        std::string_view word = take_word(line);
        p.list = word == "list";
        if (p.list) {
            p.count_type = type(take_word(line));
            if (!is_integer(p.count_type))
                throw header_error("the length of a list must be of an integer type");
            word = take_word(line);
        }
        p.type = type(word);
        p.name = shown(take_word(line));
        if (p.name.empty()) throw header_error("a property without a name");
        for (const Property& other : elements_.back().properties)
            if (other.name == p.name)
                throw header_error(fmt::format("property {} appears twice in element {}", p.name,
                                               elements_.back().name));
        elements_.back().properties.push_back(std::move(p));
    }

    /// Compares what the header promises with what the file can hold, before anything is allocated.
    void check_sizes()
    {
        double needed = static_cast<double>(at_);
        bool vertex = false;
        for (const Element& e : elements_) {
            double row = 0;
            for (const Property& p : e.properties)
                row += encoding_ == Encoding::Ascii
                           ? 2.0
                           : static_cast<double>(size_of(p.list ? p.count_type : p.type));
            if (encoding_ == Encoding::Ascii && e.properties.empty()) row = 1;
            needed += row * static_cast<double>(e.count);
            vertex = vertex || e.name == "vertex";
            if (e.name == "vertex") vertex_count_ = e.count;
        }
        if (encoding_ == Encoding::Ascii) needed -= 1;  // the last line may lack its end
        if (needed > static_cast<double>(bytes_.size()))
            throw InvalidInput(fmt::format(
                "{}: truncated: the header needs at least {} bytes, the file has {}", name_,
                needed < 9e15 ? fmt::format("{:.0f}", needed) : fmt::format("{:.3g}", needed),
                bytes_.size()));
        if (!vertex)
            throw InvalidInput(fmt::format("{}: the header has no element 'vertex'", name_));
        if (vertex_count_ >= std::numeric_limits<std::uint32_t>::max())
            throw LimitExceeded(
                fmt::format("{}: {} vertices, at most 4.29 billion", name_, vertex_count_));
    }

    bool has_faces() const
    {
        return std::any_of(elements_.begin(), elements_.end(),
                           [](const Element& e) { return e.name == "face"; });
    }

    // One value of the present row ----------------------------------------------------------------

    double value(Type t, const Element& e, const Property& p)
    {
        if (encoding_ == Encoding::Ascii) {
            const std::string_view word = take_word(row_);
            if (word.empty())
                throw InvalidInput(fmt::format("{}: the line ends before property {} of this {}",
                                               place(), p.name, e.name));
            double number = 0;
            if (!to_number(word, number))
                throw InvalidInput(
                    fmt::format("{}: {} = '{}', must be a number", place(), p.name, shown(word)));
            if (is_integer(t)) check_integer(number, t, p, word);
            return number;
        }
        return binary(t, e);
    }

    void check_integer(double number, Type t, const Property& p, std::string_view word) const
    {
        const double bits = 8.0 * static_cast<double>(size_of(t));
        const bool is_signed = t == Type::Int8 || t == Type::Int16 || t == Type::Int32;
        const double upper = std::exp2(is_signed ? bits - 1 : bits) - 1;
        const double lower = is_signed ? -upper - 1 : 0;
        if (!(number >= lower && number <= upper) || number != std::floor(number))
            throw InvalidInput(fmt::format("{}: {} = {}, must be an integer from {} to {}", place(),
                                           p.name, shown(word), lower, upper));
    }

    double binary(Type t, const Element& e)
    {
        const std::size_t size = size_of(t);
        if (bytes_.size() - at_ < size) throw ends(e, size);
        std::uint64_t bits = 0;
        for (std::size_t i = 0; i < size; ++i) {
            const auto byte = static_cast<unsigned char>(bytes_[at_ + i]);
            bits |= std::uint64_t(byte) << 8 * (encoding_ == Encoding::Little ? i : size - 1 - i);
        }
        at_ += size;
        switch (t) {
            case Type::Int8:
                return static_cast<std::int8_t>(bits);
            case Type::Int16:
                return static_cast<std::int16_t>(bits);
            case Type::Int32:
                return static_cast<std::int32_t>(bits);
            case Type::Float:
                return static_cast<double>(std::bit_cast<float>(static_cast<std::uint32_t>(bits)));
            case Type::Double:
                return std::bit_cast<double>(bits);
            default:
                return static_cast<double>(bits);
        }
    }

    InvalidInput ends(const Element& e, std::uint64_t size) const
    {
        return InvalidInput(
            fmt::format("{}: truncated: element {} needs {} bytes more at byte {}, the file has {}",
                        name_, e.name, size, at_, bytes_.size()));
    }

    /// Goes through the rows of an element; scalar(property, value), item(property, value) for each
    /// entry of a list, done() behind each row.
    template <class Scalar, class Item, class Done>
    void rows(const Element& e, const Scalar& scalar, const Item& item, const Done& done)
    {
        if (e.properties.empty() && encoding_ != Encoding::Ascii) return;
        for (std::uint64_t row = 0; row < e.count; ++row) {
            row_at_ = at_;
            if (encoding_ == Encoding::Ascii) {
                // Empty lines are not rows, unless a row has nothing to say.
                do {
                    if (!take_line(row_))
                        throw InvalidInput(
                            fmt::format("{}: truncated: the file ends after {} of {} rows of "
                                        "element {}",
                                        name_, row, e.count, e.name));
                } while (!e.properties.empty() &&
                         row_.find_first_not_of(" \t") == std::string_view::npos);
            }
            for (std::size_t i = 0; i < e.properties.size(); ++i) {
                const Property& p = e.properties[i];
                if (!p.list) {
                    scalar(i, value(p.type, e, p));
                    continue;
                }
                const double length = value(p.count_type, e, p);
                if (length < 0)
                    throw InvalidInput(
                        fmt::format("{}: list {} has the length {}, must be 0 or more", place(),
                                    p.name, length));
                const double least = encoding_ == Encoding::Ascii
                                         ? 2 * length - 1
                                         : length * static_cast<double>(size_of(p.type));
                const double left = static_cast<double>(
                    encoding_ == Encoding::Ascii ? row_.size() : bytes_.size() - at_);
                if (length > 0 && least > left)
                    throw InvalidInput(fmt::format(
                        "{}: truncated: list {} of {} entries {} needs {} bytes, {} are left",
                        name_, p.name, length,
                        encoding_ == Encoding::Ascii ? fmt::format("in line {}", line_)
                                                     : fmt::format("at byte {}", row_at_),
                        least, left));
                for (double k = 0; k < length; ++k) item(i, value(p.type, e, p));
            }
            if (encoding_ == Encoding::Ascii && !e.properties.empty()) {
                const std::string_view more = take_word(row_);
                if (!more.empty())
                    throw InvalidInput(fmt::format("{}: '{}' behind the last property of this {}",
                                                   place(), shown(more), e.name));
            }
            done();
        }
    }

    void skip(const Element& e)
    {
        rows(
            e, [](std::size_t, double) {}, [](std::size_t, double) {}, [] {});
    }

    void warn_of_rest()
    {
        if (encoding_ != Encoding::Ascii && at_ < bytes_.size())
            out_.warnings.push_back(fmt::format("{}: {} bytes behind the last element are not used",
                                                name_, bytes_.size() - at_));
    }

    /// Between which values each property of the points lies.
    void ranges(const Element& e, PointsReport& report)
    {
        std::vector<PointsReport::Property> found(e.properties.size());
        rows(
            e,
            [&](std::size_t i, double number) {
                if (!std::isfinite(number)) {
                    ++found[i].not_finite;
                    return;
                }
                found[i].least = std::min(found[i].least, number);
                found[i].most = std::max(found[i].most, number);
            },
            [](std::size_t, double) {}, [] {});
        warn_of_lists(e, {});
        for (std::size_t i = 0; i < found.size(); ++i) {
            const Property& p = e.properties[i];
            if (p.list) continue;
            found[i].name = p.name;
            // Of the two names of each type, the one that every program knows.
            for (const TypeName& t : kTypes)
                if (t.type == p.type && found[i].type.empty()) found[i].type = t.name;
            report.properties.push_back(std::move(found[i]));
        }
    }

    // The two elements that matter ----------------------------------------------------------------

    static std::size_t find(const Element& e, std::string_view name)
    {
        for (std::size_t i = 0; i < e.properties.size(); ++i)
            if (e.properties[i].name == name) return i;
        return e.properties.size();
    }

    void warn_of_lists(const Element& e, std::set<std::size_t> used)
    {
        for (std::size_t i = 0; i < e.properties.size(); ++i)
            if (e.properties[i].list && !used.contains(i))
                out_.warnings.push_back(
                    fmt::format("{}: list property '{}' of element {} is not used", name_,
                                e.properties[i].name, e.name));
    }

    void vertices(const Element& e)
    {
        std::array<std::size_t, 3> axis{};
        for (int k = 0; k < 3; ++k) {
            const char name[] = {static_cast<char>('x' + k), 0};
            axis[std::size_t(k)] = find(e, name);
            if (axis[std::size_t(k)] == e.properties.size() ||
                e.properties[axis[std::size_t(k)]].list)
                throw InvalidInput(
                    fmt::format("{}: element vertex has no property '{}'", name_, name));
        }
        warn_of_lists(e, {});
        std::vector<Column> columns(e.properties.size());
        out_.binary = encoding_ != Encoding::Ascii;
        out_.vertices.reserve(e.count);
        out_.places.reserve(e.count);
        Vec3f point;
        rows(
            e,
            [&](std::size_t i, double number) {
                for (int k = 0; k < 3; ++k)
                    if (axis[std::size_t(k)] == i) {
                        point[k] = static_cast<float>(number);
                        return;
                    }
                columns[i].add(e.properties[i].type, number);
            },
            [](std::size_t, double) {},
            [&] {
                out_.vertices.push_back(point);
                out_.places.push_back(encoding_ == Encoding::Ascii ? line_ : row_at_);
            });
        attributes(e, columns, out_.vertex_attributes);
    }

    void faces(const Element& e)
    {
        std::size_t indices = find(e, "vertex_indices");
        if (indices == e.properties.size()) indices = find(e, "vertex_index");
        if (indices == e.properties.size() || !e.properties[indices].list ||
            !is_integer(e.properties[indices].type))
            throw InvalidInput(fmt::format(
                "{}: element face has no integer list 'vertex_indices' or 'vertex_index'", name_));
        std::size_t texture = find(e, "texcoord");  // u and v of each corner in turn
        if (texture != e.properties.size() &&
            (!e.properties[texture].list || is_integer(e.properties[texture].type)))
            texture = e.properties.size();
        bool textured = texture != e.properties.size();
        std::vector<float> row_texture;
        std::size_t without = 0;
        warn_of_lists(e, {indices, texture});
        std::vector<Column> columns(e.properties.size());
        out_.ends.reserve(e.count);
        rows(
            e, [&](std::size_t i, double number) { columns[i].add(e.properties[i].type, number); },
            [&](std::size_t i, double number) {
                if (i == texture && textured) row_texture.push_back(static_cast<float>(number));
                if (i != indices) return;
                if (number < 0 || number >= static_cast<double>(vertex_count_))
                    throw InvalidInput(fmt::format(
                        "{}: face {} has the vertex index {}, must be 0 to {}", place(),
                        out_.ends.size(), number, static_cast<double>(vertex_count_) - 1));
                out_.corners.push_back(static_cast<std::uint32_t>(number));
            },
            [&] {
                out_.ends.push_back(out_.corners.size());
                if (!textured) return;
                const std::size_t corners = out_.corners.size() - out_.texture.size();
                without += row_texture.empty();
                if (row_texture.empty()) row_texture.resize(2 * corners);
                if (row_texture.size() != 2 * corners) {
                    out_.warnings.push_back(fmt::format(
                        "{}: list 'texcoord' of face {} has {} numbers for {} corners: texture "
                        "coordinates are not used",
                        place(), out_.ends.size() - 1, row_texture.size(), corners));
                    textured = false;
                    without = 0;
                    out_.texture = {};
                    return;
                }
                for (std::size_t k = 0; k < corners; ++k)
                    out_.texture.push_back({row_texture[2 * k], row_texture[2 * k + 1]});
                row_texture.clear();
            });
        if (without > 0)
            out_.warnings.push_back(
                fmt::format("{}: {} of {} faces have no texture coordinates: they get (0, 0)",
                            name_, without, out_.ends.size()));
        attributes(e, columns, out_.face_attributes);
    }

    /// Texture coordinates of vertices are handed to the corners, so that they do not keep vertices
    /// at one place apart.
    void texture_of_vertices()
    {
        auto& attributes = out_.vertex_attributes;
        for (const auto& [u, v] :
             {std::pair("s", "t"), std::pair("u", "v"), std::pair("texture_u", "texture_v"),
              std::pair("texture_s", "texture_t")}) {
            const auto first = attributes.find(u), second = attributes.find(v);
            if (first == attributes.end() || second == attributes.end()) continue;
            const auto* us = std::get_if<std::vector<float>>(&first->second);
            const auto* vs = std::get_if<std::vector<float>>(&second->second);
            if (!us || !vs) continue;
            if (out_.texture.empty())
                for (const std::uint32_t i : out_.corners)
                    out_.texture.push_back({(*us)[i], (*vs)[i]});
            attributes.erase(u);
            attributes.erase(v);
        }
    }

    /// Names the columns: x, y, z of one vector come back as one attribute.
    void attributes(const Element& e, std::vector<Column>& columns,
                    std::map<std::string, TriMesh::Attribute>& out)
    {
        auto vector = [&](const std::string& name, const std::string& x, const std::string& y,
                          const std::string& z, Type type, float scale) {
            const std::size_t at[3] = {find(e, x), find(e, y), find(e, z)};
            for (const std::size_t i : at)
                if (i == e.properties.size() || e.properties[i].list ||
                    e.properties[i].type != type ||
                    (columns[i].numbers.empty() && columns[i].integers.empty()))
                    return;
            std::vector<Vec3f> values(e.count);
            for (int k = 0; k < 3; ++k) {
                Column& column = columns[at[k]];
                for (std::size_t i = 0; i < values.size(); ++i)
                    values[i][k] = is_integer(type) ? static_cast<float>(column.integers[i]) / scale
                                                    : column.numbers[i] / scale;
                column = {};
            }
            out[name] = std::move(values);
        };
        vector(kNormal, "nx", "ny", "nz", Type::Float, 1);
        vector(kNormal, "nx", "ny", "nz", Type::Double, 1);
        vector(kColour, "red", "green", "blue", Type::Uint8, 255);
        vector(kColour, "red", "green", "blue", Type::Float, 1);
        for (const Property& p : e.properties)
            if (p.name.size() > 2 && p.name.ends_with("_x")) {
                const std::string stem = p.name.substr(0, p.name.size() - 2);
                if (find(e, stem) == e.properties.size() && !out.contains(stem))
                    vector(stem, stem + "_x", stem + "_y", stem + "_z", Type::Float, 1);
            }
        for (std::size_t i = 0; i < columns.size(); ++i) {
            const Property& p = e.properties[i];
            Column& column = columns[i];
            if (column.numbers.empty() && column.integers.empty()) continue;
            if (out.contains(p.name)) continue;
            if (column.overflow)
                out_.warnings.push_back(fmt::format(
                    "{}: property '{}' of element {} has values beyond 2147483647 and is not used",
                    name_, p.name, e.name));
            else if (is_integer(p.type))
                out[p.name] = std::move(column.integers);
            else
                out[p.name] = std::move(column.numbers);
        }
    }
};

// Writing -----------------------------------------------------------------------------------------

void append32(std::string& out, std::uint32_t bits)
{
    char bytes[4];
    for (int i = 0; i < 4; ++i) bytes[i] = static_cast<char>(bits >> 8 * i & 0xFF);
    out.append(bytes, 4);
}

void append_float(std::string& out, float value)
{
    append32(out, std::bit_cast<std::uint32_t>(value));
}

/// A property's name is one word.
std::string property_name(std::string name)
{
    for (char& c : name)
        if (static_cast<unsigned char>(c) <= ' ') c = '_';
    return name;
}

using Attributes = std::map<std::string, TriMesh::Attribute>;
/// Those that are written as properties of their own.
using Listed = std::vector<const Attributes::value_type*>;

Listed list_all(const Attributes& attributes)
{
    Listed listed;
    for (const auto& entry : attributes) listed.push_back(&entry);
    return listed;
}

void declare(std::string& header, const Listed& attributes, std::set<std::string> taken)
{
    auto add = [&](const char* type, const std::string& name) {
        if (name.empty() || !taken.insert(name).second)
            throw InvalidInput(
                fmt::format("ply: two attributes would be called '{}': rename one of them", name));
        header += fmt::format("property {} {}\n", type, name);
    };
    for (const auto* entry : attributes) {
        const auto& [name, attribute] = *entry;
        const std::string word = property_name(name);
        if (std::holds_alternative<std::vector<float>>(attribute))
            add("float", word);
        else if (std::holds_alternative<std::vector<std::int32_t>>(attribute))
            add("int", word);
        else if (name == kNormal)
            for (const char* axis : {"nx", "ny", "nz"}) add("float", axis);
        else if (name == kColour)
            for (const char* channel : {"red", "green", "blue"}) add("uchar", channel);
        else
            for (const char* axis : {"_x", "_y", "_z"}) add("float", word + axis);
    }
}

void append_row(std::string& out, const Listed& attributes, std::size_t i)
{
    for (const auto* entry : attributes) {
        const auto& [name, attribute] = *entry;
        if (const auto* numbers = std::get_if<std::vector<float>>(&attribute))
            append_float(out, (*numbers)[i]);
        else if (const auto* integers = std::get_if<std::vector<std::int32_t>>(&attribute))
            append32(out, static_cast<std::uint32_t>((*integers)[i]));
        else {
            const Vec3f v = std::get<std::vector<Vec3f>>(attribute)[i];
            for (int k = 0; k < 3; ++k)
                if (name == kColour)
                    // Every program reads colours of one byte a channel, few any other.
                    out += static_cast<char>(static_cast<unsigned char>(
                        v[k] > 0 ? std::min(v[k], 1.0f) * 255.0f + 0.5f : 0.0f));
                else
                    append_float(out, v[k]);
        }
    }
}

/// Appends `count` rows of one length, each made by write(row, i), on all cores.
template <class Write>
void append_rows(std::string& out, std::size_t count, const Progress& progress, Write&& write)
{
    if (count == 0) return;
    constexpr std::size_t kRows = 1 << 16;
    std::string first;
    write(first, 0);
    const std::size_t begin = out.size();
    out.resize(begin + count * first.size());
    parallel_for((count + kRows - 1) / kRows, [&](std::size_t chunk) {
        progress.check();
        std::string rows;
        rows.reserve(kRows * first.size());
        for (std::size_t i = chunk * kRows; i < std::min(count, (chunk + 1) * kRows); ++i)
            write(rows, i);
        rows.copy(out.data() + begin + chunk * kRows * first.size(), rows.size());
    });
}

}  // namespace

bool looks_like_ply(std::string_view bytes)
{
    return bytes.starts_with("ply\n") || bytes.starts_with("ply\r\n");
}

Polygons read_ply(std::string_view bytes, const std::string& name)
{
    return Reader(bytes, name).read();
}

std::optional<PointsReport> describe_ply_points(std::string_view bytes, const std::string& name)
{
    return Reader(bytes, name).describe_points();
}

std::string write_ply(const TriMesh& mesh, const Progress& progress)
{
    std::string out = fmt::format(
        "ply\nformat binary_little_endian 1.0\ncomment Sekitei: metres, z up\nelement vertex {}\n"
        "property float x\nproperty float y\nproperty float z\n",
        mesh.vertices.size());
    const Listed vertex_attributes = list_all(mesh.vertex_attributes);
    declare(out, vertex_attributes, {"x", "y", "z"});
    out += fmt::format("element face {}\nproperty list uchar int vertex_indices\n",
                       mesh.triangles.size());
    // Texture coordinates go the way other programs know: one list a face.
    const auto texture = texture_of(mesh);
    Listed face_attributes = list_all(mesh.face_attributes);
    if (texture[0]) {
        std::erase_if(face_attributes, [](const auto* entry) {
            return std::ranges::count(kTexture, entry->first) > 0;
        });
        out += "property list uchar float texcoord\n";
    }
    declare(out, face_attributes, {"vertex_indices", "texcoord"});
    out += "end_header\n";
    append_rows(out, mesh.vertices.size(), progress, [&](std::string& row, std::size_t i) {
        for (int k = 0; k < 3; ++k) append_float(row, mesh.vertices[i][k]);
        append_row(row, vertex_attributes, i);
    });
    append_rows(out, mesh.triangles.size(), progress, [&](std::string& row, std::size_t t) {
        row += '\x03';
        for (const std::uint32_t v : mesh.triangles[t]) append32(row, v);
        if (texture[0]) {
            row += '\x06';
            for (const std::vector<Vec3f>* corner : texture) {
                append_float(row, (*corner)[t].x);
                append_float(row, (*corner)[t].y);
            }
        }
        append_row(row, face_attributes, t);
    });
    return out;
}

}  // namespace sekitei::mesh_format
