#include "apps/forest_instances.h"

#include <fmt/format.h>

#include <bit>
#include <cmath>
#include <cstring>
#include <set>

#include "apps/exchange/text.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/math.h"

namespace sekitei::apps {
namespace {

namespace fs = std::filesystem;
using forest::Instance;

static_assert(std::endian::native == std::endian::little, "PLY is written as it lies in memory");

/// Calls f(name, value) for each column of a row, in the order of files.
template <class F>
void columns(const Instance& at, F&& f)
{
    const auto q = at.orient();
    f("x", plain_zero(at.position.x));
    f("y", plain_zero(at.position.y));
    f("z", plain_zero(at.position.z));
    f("orient_x", q[0]);
    f("orient_y", q[1]);
    f("orient_z", q[2]);
    f("orient_w", q[3]);
    f("scale_x", static_cast<float>(at.scale.x));
    f("scale_y", static_cast<float>(at.scale.y));
    f("scale_z", static_cast<float>(at.scale.z));
    f("pscale", 1.0f);
    f("id_high", static_cast<std::uint32_t>(at.uid >> 32));
    f("id_low", static_cast<std::uint32_t>(at.uid));
    f("height", static_cast<float>(at.height));
    f("crown_radius", static_cast<float>(at.crown_radius));
    f("cone_radius", static_cast<float>(at.cone_radius));
    f("R", static_cast<float>(at.share));
    f("species", at.species);
    f("variant", at.variant);
    f("age", at.age);
    f("model", at.model);
}

template <class T>
constexpr const char* ply_type()
{
    if constexpr (std::is_same_v<T, double>) return "double";
    if constexpr (std::is_same_v<T, float>) return "float";
    if constexpr (std::is_same_v<T, std::uint32_t>) return "uint";
    if constexpr (std::is_same_v<T, std::int32_t>) return "int";
}

/// A trunk and a crown of few faces, as wide and high as a model's.
TriMesh plain_shape(double radius, double base)
{
    constexpr int kSides = 6;
    TriMesh mesh;
    std::vector<std::int32_t> part;
    // Rings of a trunk and of a crown, each closed by a point above and below.
    auto spindle = [&](double low, double middle, double high, double r, std::int32_t of_part) {
        const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
        for (int k = 0; k < kSides; ++k)
            mesh.vertices.push_back(
                Vec3f(Vec3d(r * math::cos(2 * math::kPi * k / kSides),
                            r * math::sin(2 * math::kPi * k / kSides), middle)));
        mesh.vertices.emplace_back(0.0f, 0.0f, static_cast<float>(low));
        mesh.vertices.emplace_back(0.0f, 0.0f, static_cast<float>(high));
        for (std::uint32_t k = 0; k < kSides; ++k) {
            const std::uint32_t a = first + k, b = first + (k + 1) % kSides;
            mesh.triangles.push_back({b, a, first + kSides});
            mesh.triangles.push_back({a, b, first + kSides + 1});
            part.insert(part.end(), {of_part, of_part});
        }
    };
    base = std::clamp(base, 0.0, 0.9);
    spindle(-0.02, 0, base + 0.1, 0.02, 0);
    spindle(base, base + 0.4 * (1 - base), 1, std::max(0.02, radius), 1);
    mesh.face_attributes["part"] = std::move(part);
    return mesh;
}

void put_mesh(TextOut& out, const TriMesh& mesh, const Bounds& box)
{
    const std::string pad(12, ' '), inner(16, ' ');
    out.put("{}def Mesh \"shape\"\n{}{{\n", pad, pad);
    out.put("{}uniform bool doubleSided = 1\n", inner);
    put_usd_triangles(out, inner, mesh, box);
    const auto part = mesh.face_attributes.find("part");
    if (part != mesh.face_attributes.end())
        if (const auto* parts = std::get_if<std::vector<std::int32_t>>(&part->second)) {
            put_usd_list(out, inner, "color3f[] primvars:displayColor", parts->size(),
                         [&](std::size_t i, std::string& text) {
                             text += (*parts)[i] == 0 ? "(0.2, 0.14, 0.09)" : "(0.1, 0.2, 0.05)";
                         });
            out.put(" (\n{}    interpolation = \"uniform\"\n{})\n", inner, inner);
        }
    out.put("{}uniform token subdivisionScheme = \"none\"\n{}}}\n", inner, pad);
}

template <class T>
const std::vector<T>& column(const Points& points, const std::string& name, const char* attribute)
{
    if (const auto* values = points.values<T>(attribute)) return *values;
    throw InvalidInput(
        fmt::format("the points '{}' have no attribute '{}' of the kind that `sekitei forest` "
                    "writes",
                    name, attribute));
}

}  // namespace

Points instance_points(std::span<const Instance> instances, const std::string& stage)
{
    Points points;
    points.stage = stage;
    const std::size_t n = instances.size();
    std::vector<std::array<float, 4>> orient(n);
    std::vector<Vec3f> scale(n);
    std::vector<std::int64_t> id(n);
    std::vector<float> height(n), crown(n), cone(n), share(n);
    std::vector<std::int32_t> species(n), variant(n), age(n), model(n);
    points.position.resize(n);
    for (std::size_t i = 0; i < n; ++i) {
        const Instance& at = instances[i];
        points.position[i] = at.position;
        orient[i] = at.orient();
        scale[i] = Vec3f(at.scale);
        id[i] = std::bit_cast<std::int64_t>(at.uid);
        height[i] = static_cast<float>(at.height);
        crown[i] = static_cast<float>(at.crown_radius);
        cone[i] = static_cast<float>(at.cone_radius);
        share[i] = static_cast<float>(at.share);
        species[i] = at.species;
        variant[i] = at.variant;
        age[i] = at.age;
        model[i] = at.model;
    }
    points.attributes = {{"orient", std::move(orient)},
                         {"scale", std::move(scale)},
                         {"pscale", std::vector<float>(n, 1.0f)},
                         {"id", std::move(id)},
                         {"height", std::move(height)},
                         {"crown_radius", std::move(crown)},
                         {"cone_radius", std::move(cone)},
                         {"R", std::move(share)},
                         {"species", std::move(species)},
                         {"variant", std::move(variant)},
                         {"age", std::move(age)},
                         {"model", std::move(model)}};
    return points;
}

std::vector<Instance> instances_of(const Points& points, const std::string& name)
{
    const auto& orient = column<std::array<float, 4>>(points, name, "orient");
    const auto& scale = column<Vec3f>(points, name, "scale");
    const auto& id = column<std::int64_t>(points, name, "id");
    auto floats = [&](const char* attribute) -> const std::vector<float>& {
        return column<float>(points, name, attribute);
    };
    auto ints = [&](const char* attribute) -> const std::vector<std::int32_t>& {
        return column<std::int32_t>(points, name, attribute);
    };
    const auto &height = floats("height"), &crown = floats("crown_radius"),
               &cone = floats("cone_radius"), &share = floats("R");
    const auto &species = ints("species"), &variant = ints("variant"), &age = ints("age"),
               &model = ints("model");
    std::vector<Instance> list(points.position.size());
    for (std::size_t i = 0; i < list.size(); ++i) {
        Instance& at = list[i];
        at.uid = std::bit_cast<std::uint64_t>(id[i]);
        at.position = points.position[i];
        at.yaw = 2 * math::atan2(double(orient[i][2]), double(orient[i][3]));
        if (at.yaw < 0) at.yaw += 2 * math::kPi;
        at.scale = Vec3d(scale[i]);
        at.height = double(height[i]);
        at.crown_radius = double(crown[i]);
        at.cone_radius = double(cone[i]);
        at.share = double(share[i]);
        at.species = species[i];
        at.variant = variant[i];
        at.age = age[i];
        at.model = model[i];
    }
    return list;
}

std::string instance_ply_header(std::uint64_t count)
{
    std::string text = fmt::format(
        "ply\nformat binary_little_endian 1.0\ncomment trees of a forest, metres, z up\n"
        "element vertex {}\n",
        count);
    columns({}, [&]<class T>(const char* name, T) {
        text += fmt::format("property {} {}\n", ply_type<T>(), name);
    });
    return text + "end_header\n";
}

void append_ply(std::string& bytes, std::span<const Instance> instances)
{
    for (const Instance& at : instances)
        columns(at, [&]<class T>(const char*, T value) {
            char raw[sizeof value];
            std::memcpy(raw, &value, sizeof value);
            bytes.append(raw, sizeof value);
        });
}

std::string instance_csv_header()
{
    std::string text;
    columns({}, [&](const char* name, auto) {
        if (!text.empty()) text += ',';
        text += name;
    });
    return text + "\n";
}

void append_csv(std::string& text, std::span<const Instance> instances)
{
    auto out = std::back_inserter(text);
    for (const Instance& at : instances) {
        columns(at, [&](const char*, auto value) { fmt::format_to(out, "{},", value); });
        text.back() = '\n';
    }
}

void write_usda(const InstanceBlocks& instances, std::span<const Prototype> prototypes,
                Vec3d corner, const std::function<void(std::string_view)>& write,
                const Progress& progress)
{
    // Names of their own, and what each model fills.
    std::vector<std::string> names;
    std::set<std::string> taken;
    std::vector<TriMesh> plain(prototypes.size());
    std::vector<const TriMesh*> shapes;
    std::vector<Bounds> boxes(prototypes.size());
    for (std::size_t m = 0; m < prototypes.size(); ++m) {
        const Prototype& p = prototypes[m];
        names.push_back(usd_identifier(p.name));
        while (!taken.insert(names.back()).second) names.back() += fmt::format("_{}", m);
        const bool own = p.mesh && !p.mesh->triangles.empty();
        if (!own) plain[m] = plain_shape(p.crown_radius, p.crown_base);
        shapes.push_back(own ? p.mesh : &plain[m]);
        for (const Vec3f& v : shapes[m]->vertices) boxes[m].add(Vec3d(v));
    }

    // Whatever its yaw is, a tree stays within this.
    Bounds extent;
    std::uint64_t count = 0;
    instances([&](std::span<const Instance> block) {
        progress.check();
        count += block.size();
        for (const Instance& at : block) {
            if (at.model < 0 || std::size_t(at.model) >= prototypes.size())
                throw InvalidInput(
                    fmt::format("forest: tree {:016x} has the model {}, there are {}", at.uid,
                                at.model, prototypes.size()));
            const Bounds& box = boxes[std::size_t(at.model)];
            const double x = std::max(std::abs(box.lower.x), std::abs(box.upper.x)),
                         y = std::max(std::abs(box.lower.y), std::abs(box.upper.y));
            const double r = std::sqrt(x * x + y * y) * at.scale.x;
            const Vec3d foot = at.position - corner;
            extent.add(foot + Vec3d(-r, -r, box.lower.z * at.scale.z));
            extent.add(foot + Vec3d(r, r, box.upper.z * at.scale.z));
        }
    });
    if (extent.empty()) extent.add(Vec3d(0));

    TextOut out(write, progress);
    out.put(
        "#usda 1.0\n(\n    defaultPrim = \"forest\"\n    doc = \"Trees of a forest by Sekitei\"\n"
        "    metersPerUnit = 1\n    upAxis = \"Z\"\n)\n\n"
        "def PointInstancer \"forest\"\n{{\n");
    out.put("    float3[] extent = [({:.6g}, {:.6g}, {:.6g}), ({:.6g}, {:.6g}, {:.6g})]\n",
            extent.lower.x, extent.lower.y, extent.lower.z, extent.upper.x, extent.upper.y,
            extent.upper.z);
    auto array = [&](const char* type_and_name, auto&& item) {
        progress.check();
        out.put("    {} = [", type_and_name);
        std::uint64_t n = 0;
        instances([&](std::span<const Instance> block) {
            progress.check();
            for (const Instance& at : block) {
                if (n++ > 0) out.put(", ");
                item(at);
            }
        });
        if (n != count)
            throw InvalidInput(
                fmt::format("forest: {} trees, then {}: they must stay the same "
                            "while a file is written",
                            count, n));
        out.put("]");
    };
    // Some readers refuse a sign here.
    array("int64[] ids", [&](const Instance& at) { out.put("{}", at.uid & ~(1ull << 63)); });
    out.put("\n");
    array("quath[] orientations", [&](const Instance& at) {  // the real part first
        const auto q = at.orient();
        out.put("({:.5g}, 0, 0, {:.5g})", q[3], q[2]);
    });
    out.put("\n");
    array("point3f[] positions", [&](const Instance& at) {
        const Vec3f p = plain_zero(Vec3f(at.position - corner));
        out.put("({}, {}, {})", p.x, p.y, p.z);
    });
    out.put("\n");
    array("float[] primvars:height",
          [&](const Instance& at) { out.put("{}", static_cast<float>(at.height)); });
    out.put(" (\n        interpolation = \"vertex\"\n    )\n");
    array("int[] primvars:species", [&](const Instance& at) { out.put("{}", at.species); });
    out.put(" (\n        interpolation = \"vertex\"\n    )\n");
    array("int[] protoIndices", [&](const Instance& at) { out.put("{}", at.model); });
    out.put("\n    rel prototypes = [");
    for (std::size_t m = 0; m < names.size(); ++m)
        out.put("{}</forest/prototypes/{}>", m > 0 ? ", " : "", names[m]);
    out.put("]\n");
    array("float3[] scales", [&](const Instance& at) {
        const Vec3f s(at.scale);
        out.put("({}, {}, {})", s.x, s.y, s.z);
    });
    out.put("\n    double3 xformOp:translate = ({}, {}, {})\n", plain_zero(corner.x),
            plain_zero(corner.y), plain_zero(corner.z));
    out.put("    uniform token[] xformOpOrder = [\"xformOp:translate\"]\n\n");
    out.put("    def Scope \"prototypes\"\n    {{\n");
    for (std::size_t m = 0; m < names.size(); ++m) {
        progress.check();
        out.put("{}        def Xform \"{}\"\n        {{\n", m > 0 ? "\n" : "", names[m]);
        put_mesh(out, *shapes[m], boxes[m]);
        out.put("        }}\n");
    }
    out.put("    }}\n}}\n");
    out.flush();
}

void write_instances(const fs::path& file, std::uint64_t count, const InstanceBlocks& instances,
                     std::span<const Prototype> prototypes, Vec3d corner, const Progress& progress)
{
    const std::string suffix = file.extension().string();
    if (suffix != ".ply" && suffix != ".csv" && suffix != ".usda")
        throw InvalidParameter(
            fmt::format("forest: {}: must end in .ply, .csv or .usda", file.string()));
    AtomicFile target(file);
    if (suffix == ".usda") {
        write_usda(
            instances, prototypes, corner, [&](std::string_view text) { target.write(text); },
            progress);
    } else {
        const bool ply = suffix == ".ply";
        target.write(ply ? instance_ply_header(count) : instance_csv_header());
        std::uint64_t written = 0;
        std::string rows;
        instances([&](std::span<const Instance> block) {
            constexpr std::size_t kRows = 8192;
            for (std::size_t begin = 0; begin < block.size(); begin += kRows) {
                progress.check();
                const auto part = block.subspan(begin, std::min(kRows, block.size() - begin));
                rows.clear();
                if (ply)
                    append_ply(rows, part);
                else
                    append_csv(rows, part);
                target.write(rows);
                written += part.size();
                progress.update(double(written) / double(std::max<std::uint64_t>(count, written)));
            }
        });
        if (ply && written != count)
            throw InvalidInput(
                fmt::format("forest: {} trees were announced, {} written", count, written));
    }
    target.commit();
}

}  // namespace sekitei::apps
