// Scenes as other programs get them: read back by a small parser, against the scene itself.
#include "tests/support/exchange.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <ctime>
#include <map>
#include <set>
#include <sstream>

#include "apps/exchange/files.h"
#include "core/error.h"
#include "core/file_output.h"
#include "core/mesh_io.h"
#include "core/parallel.h"
#include "tests/support/shapes.h"
#include "tests/support/temporary_folder.h"

namespace sekitei::apps {
namespace {

using testing::Contains;
using testing::HasSubstr;
using testing::Not;
using testing::ThrowsMessage;

/// A binary glTF file, taken apart.
struct Glb {
    Json json;
    std::string data;

    explicit Glb(const std::string& bytes)
    {
        auto word = [&](std::size_t at) {
            std::uint32_t value = 0;
            std::memcpy(&value, bytes.data() + at, 4);
            return value;
        };
        EXPECT_EQ(bytes.substr(0, 4), "glTF");
        EXPECT_EQ(word(4), 2u);
        EXPECT_EQ(word(8), bytes.size());
        const std::uint32_t text = word(12);
        EXPECT_EQ(text % 4, 0u);
        json = Json::parse(bytes.substr(20, text));
        EXPECT_EQ(word(20 + text) + 28 + text, bytes.size());
        data = bytes.substr(28 + text);
    }
    static std::size_t components(const Json& accessor)
    {
        const std::map<std::string, std::size_t> sizes{
            {"SCALAR", 1}, {"VEC2", 2}, {"VEC3", 3}, {"VEC4", 4}};
        return sizes.at(accessor["type"]);
    }
    /// All components of all elements; indices as numbers.
    std::vector<float> values(const Json& number) const
    {
        const Json& accessor = json["accessors"][number.get<std::size_t>()];
        const Json& view = json["bufferViews"][accessor["bufferView"].get<std::size_t>()];
        const std::size_t count = accessor["count"].get<std::size_t>() * components(accessor);
        EXPECT_EQ(view["byteLength"].get<std::size_t>(), 4 * count);
        EXPECT_EQ(view["byteOffset"].get<std::size_t>() % 4, 0u);
        EXPECT_LE(view["byteOffset"].get<std::size_t>() + 4 * count, data.size());
        std::vector<float> out(count);
        const char* const from = data.data() + view["byteOffset"].get<std::size_t>();
        if (accessor["componentType"] == 5126) {
            std::memcpy(out.data(), from, 4 * count);
        } else {
            EXPECT_EQ(accessor["componentType"], 5125);
            std::vector<std::uint32_t> whole(count);
            std::memcpy(whole.data(), from, 4 * count);
            out.assign(whole.begin(), whole.end());
        }
        return out;
    }
    const Json& node(const std::string& name) const
    {
        for (const Json& n : json["nodes"])
            if (n["name"] == name) return n;
        throw std::out_of_range("no node " + name);
    }
    /// Attributes of the first primitive of a node.
    const Json& attributes(const std::string& name) const
    {
        return json["meshes"][node(name)["mesh"].get<std::size_t>()]["primitives"][0]["attributes"];
    }
    std::vector<float> attribute(const std::string& name, const std::string& semantic) const
    {
        return values(attributes(name).at(semantic));
    }
    std::vector<Json> instance_nodes() const
    {
        std::vector<Json> list;
        for (const Json& n : json["nodes"])
            if (n.contains("extensions")) list.push_back(n);
        return list;
    }
};

/// q v q*
Vec3d rotated(const std::array<double, 4>& q, Vec3d v)
{
    const Vec3d u(q[0], q[1], q[2]), t = cross(u, v) * 2.0;
    return v + t * q[3] + cross(u, t);
}

Scene garden(std::size_t plants = 500)
{
    Scene scene = exchange::ball();
    scene.points["moss"] = exchange::moss(plants);
    scene.points["leaves"] = exchange::leaves(60, true);
    exchange::put_forest(scene, 40);
    return scene;
}

/// What EXT_mesh_gpu_instancing asks for, of every node that has it; returns the copies of a set.
std::size_t check_instancing(const Glb& glb, const std::string& set, const Bounds& box)
{
    EXPECT_THAT(glb.json["extensionsUsed"], Contains("EXT_mesh_gpu_instancing"));
    EXPECT_FALSE(glb.json.contains("extensionsRequired"));
    std::size_t copies = 0;
    for (const Json& node : glb.instance_nodes()) {
        const Json& extras = node["extras"]["sekitei"];
        EXPECT_EQ(extras["kind"], "instances");
        if (extras["set"] != set) continue;
        EXPECT_EQ(node["name"], set + "/" + extras["prototype"].get<std::string>());
        EXPECT_LT(node["mesh"].get<std::size_t>(), glb.json["meshes"].size());
        const Json& attributes = node["extensions"]["EXT_mesh_gpu_instancing"]["attributes"];
        const std::map<std::string, std::string> types{
            {"TRANSLATION", "VEC3"}, {"ROTATION", "VEC4"}, {"SCALE", "VEC3"}, {"_ID", "VEC2"}};
        const std::size_t count =
            glb.json["accessors"][attributes["TRANSLATION"].get<std::size_t>()]["count"];
        EXPECT_GT(count, 0u);
        for (const auto& [name, number] : attributes.items()) {
            const Json& accessor = glb.json["accessors"][number.get<std::size_t>()];
            EXPECT_EQ(accessor["count"], count) << name;
            EXPECT_EQ(accessor["componentType"], 5126) << name;
            const auto known = types.find(name);
            EXPECT_EQ(accessor["type"], known == types.end() ? "SCALAR" : known->second) << name;
            EXPECT_TRUE(known != types.end() || name.starts_with("_")) << name;
            for (const float x : glb.values(number)) EXPECT_TRUE(std::isfinite(x)) << name;
        }
        for (const auto& [name, type] : types) EXPECT_TRUE(attributes.contains(name)) << name;
        const auto q = glb.values(attributes["ROTATION"]);
        for (std::size_t i = 0; i < count; ++i) {
            double norm = 0;
            for (std::size_t k = 0; k < 4; ++k) norm += double(q[4 * i + k]) * double(q[4 * i + k]);
            EXPECT_NEAR(norm, 1, 1e-5);
        }
        const auto at = glb.values(attributes["TRANSLATION"]);
        for (std::size_t i = 0; i < count; ++i) {  // y up
            const Vec3d p(double(at[3 * i]), -double(at[3 * i + 2]), double(at[3 * i + 1]));
            for (int k = 0; k < 3; ++k) {
                EXPECT_GE(p[k], box.lower[k] - 1e-4);
                EXPECT_LE(p[k], box.upper[k] + 1e-4);
            }
        }
        for (const float s : glb.values(attributes["SCALE"])) EXPECT_GT(s, 0);
        copies += count;
    }
    return copies;
}

TEST(Exchange, InstancesInGltfAreSoundAndAsManyAsPlantsThatHaveASize)
{
    const Scene scene = garden();
    const Glb glb(encode_glb(assemble(scene)));
    for (const auto& [set, points] : std::map<std::string, std::string>{
             {"moss", "moss"}, {"forest", "forest_instances"}, {"leaves", "leaves"}}) {
        const Points& of = scene.points.at(points);
        Bounds box;
        for (const Vec3d& p : of.position) box.add(p);
        std::size_t there = of.position.size();
        if (set == "moss")
            there = std::size_t(
                std::ranges::count_if(*of.values<float>("pscale"), [](float s) { return s > 0; }));
        EXPECT_EQ(check_instancing(glb, set, box), there) << set;
        EXPECT_EQ(glb.json["asset"]["extras"]["sekitei"]["instances"][set]["count"], there);
    }
    // Every prototype once, and none that nobody uses.
    std::set<std::size_t> meshes;
    for (const Json& node : glb.json["nodes"])
        if (node.contains("mesh")) {
            EXPECT_TRUE(meshes.insert(node["mesh"].get<std::size_t>()).second);
        }
    EXPECT_EQ(meshes.size(), glb.json["meshes"].size());
}

TEST(Exchange, ACopyInGltfStandsWhereTheScenesPlantStands)
{
    const Scene scene = garden();
    const Assembly all = assemble(scene);
    const Glb glb(encode_glb(all));
    constexpr Vec3d kLocal(0.3, 0.8, -0.2);  // z up, in the prototype's own space
    for (const CopySet& set : all.sets)
        for (std::size_t p = 0; p < set.prototypes.size(); ++p) {
            const Json& node = glb.node(set.name + "/" + set.prototypes[p].name);
            const Json& attributes = node["extensions"]["EXT_mesh_gpu_instancing"]["attributes"];
            const auto t = glb.values(attributes["TRANSLATION"]),
                       r = glb.values(attributes["ROTATION"]), s = glb.values(attributes["SCALE"]),
                       id = glb.values(attributes["_ID"]);
            for (std::size_t i = 0; i < t.size() / 3; i += 7) {
                const std::uint32_t row = set.order[set.first[p] + i];
                const Points& points = *set.points;
                const auto& q = (*points.values<std::array<float, 4>>("orient"))[row];
                if (set.turned.empty()) {
                    const Placement at = set.at(row);
                    const Vec3d world =
                        points.position[row] +
                        rotated({double(q[0]), double(q[1]), double(q[2]), double(q[3])},
                                {kLocal.x * double(at.scale.x), kLocal.y * double(at.scale.y),
                                 kLocal.z * double(at.scale.z)});
                    // The same by what stands in the file: (x, y, z) is (x, z, -y) there.
                    const Vec3d y_up(kLocal.x * double(s[3 * i]), kLocal.z * double(s[3 * i + 1]),
                                     -kLocal.y * double(s[3 * i + 2]));
                    const Vec3d found =
                        rotated({double(r[4 * i]), double(r[4 * i + 1]), double(r[4 * i + 2]),
                                 double(r[4 * i + 3])},
                                y_up) +
                        Vec3d(double(t[3 * i]), double(t[3 * i + 1]), double(t[3 * i + 2]));
                    EXPECT_NEAR(found.x, world.x, 1e-4);
                    EXPECT_NEAR(found.y, world.z, 1e-4);
                    EXPECT_NEAR(-found.z, world.y, 1e-4);
                }
                const auto whole = static_cast<std::uint64_t>(set.id(row));
                EXPECT_EQ(std::uint64_t(id[2 * i]) | std::uint64_t(id[2 * i + 1]) << 24,
                          whole & 0xFFFFFFFFFFFF);
            }
        }
    // A plant of pscale 1 is as wide as the mat that cells of 10 cm close; a tree as high as told.
    EXPECT_NEAR(all.sets[0].size, 0.16, 1e-9);
    const CopySet& forest = all.sets[1];
    EXPECT_EQ(forest.at(3).scale.z, (*forest.points->values<float>("height"))[3]);
}

TEST(Exchange, MatsOfHypnumLieOnTheRockAndOtherMossesStandAsGrown)
{
    const Scene scene = garden();
    const Assembly all = assemble(scene);
    const CopySet& set = all.sets.front();
    ASSERT_EQ(set.turned.size(), scene.points.at("moss").position.size());
    const auto& species = *set.points->values<std::int32_t>("species");
    std::size_t turned = 0;
    for (std::size_t i = 0; i < set.turned.size(); ++i)
        if (set.turned[i] != (*set.orient)[i]) {
            EXPECT_EQ(species[i], 1);
            ++turned;
        }
    EXPECT_GT(turned, 10u);
}

TEST(Exchange, PrototypesAreWrittenOnceHoweverManyCopiesTheyHave)
{
    auto bytes = [](std::size_t plants) {
        Scene scene;
        scene.points["moss"] = exchange::moss(plants);
        return encode_glb(assemble(scene)).size();
    };
    const std::size_t few = bytes(2000), many = bytes(12000);
    // Place, turn, size, number and four floats.
    EXPECT_NEAR(double(many - few) / 10000, 12 + 16 + 12 + 8 + 4 * 4, 2);
}

TEST(Exchange, FieldsOfCellsStandAtVerticesAndEveryVertexHasAValue)
{
    const Scene scene = exchange::ball();
    const Glb glb(encode_glb(assemble(scene)));
    const auto at = glb.attribute("rock", "POSITION"), level = glb.attribute("rock", "_LEVEL"),
               upper = glb.attribute("rock", "_UPPER"), patch = glb.attribute("rock", "_PATCH"),
               normal = glb.attribute("rock", "NORMAL");
    ASSERT_EQ(level.size(), at.size() / 3);
    Bounds box;
    for (std::size_t i = 0; i < level.size(); ++i) {
        const Vec3d p(double(at[3 * i]), -double(at[3 * i + 2]), double(at[3 * i + 1]));
        box.add(p);
        // Means over cells of 10 cm, whose centres lie inside.
        EXPECT_NEAR(double(level[i]), p.z, 0.11);
        EXPECT_TRUE(upper[i] == 0 || upper[i] == 1) << "kinds have no mean";
        if (std::abs(p.z - 1) > 0.15) {
            EXPECT_EQ(upper[i], p.z > 1 ? 1 : 0);
        }
        // The western half takes what its border knows.
        EXPECT_TRUE(std::isfinite(patch[i]));
        EXPECT_GE(patch[i], 1.9);
        EXPECT_LE(patch[i], 4.1);
        if (p.x > 2.2) {
            EXPECT_NEAR(double(patch[i]), p.y, 0.11);
        }
        // A ball's normals point away from its middle.
        const Vec3d n(double(normal[3 * i]), -double(normal[3 * i + 2]), double(normal[3 * i + 1]));
        EXPECT_NEAR(length(n), 1, 1e-5);
        EXPECT_GT(dot(n, normalized(p - Vec3d(2, 3, 1))), 0.9);
    }
    EXPECT_NEAR(box.lower.y, 2, 0.02);
    EXPECT_NEAR(box.upper.z, 2, 0.02);
    const Json& fields = glb.json["asset"]["extras"]["sekitei"]["fields"];
    EXPECT_EQ(fields["_LEVEL"]["name"], "level");
    EXPECT_EQ(fields["_PATCH"]["unit"], "K");
    EXPECT_EQ(fields["_LEVEL"]["low"].get<float>(), *std::ranges::min_element(level));
    EXPECT_EQ(fields["_LEVEL"]["high"].get<float>(), *std::ranges::max_element(level));
    EXPECT_FALSE(fields.contains("_SURFACE_SDF")) << "a volume is no field of the surface";
    EXPECT_THAT(encode_glb(assemble(scene, {.fields = false})), Not(HasSubstr("_LEVEL")));
}

TEST(Exchange, ColumnsSplitTheRocksVerticesAndTexturesKeepTheirSeams)
{
    Scene scene;
    TriMesh mesh = shapes::box({0, 0, 0}, {1, 2, 3});
    std::vector<std::int32_t> column;
    for (const auto& t : mesh.triangles) {
        bool top = true;
        for (const std::uint32_t v : t) top = top && mesh.vertices[v].z == 3;
        column.push_back(top ? 42 : 7);
    }
    mesh.face_attributes["column"] = column;
    std::array<std::vector<Vec3f>, 3> uv;
    for (std::size_t t = 0; t < mesh.triangles.size(); ++t)
        for (std::size_t k = 0; k < 3; ++k)
            uv[k].emplace_back(float(t) / 16, 0.25f * float(k), 0.0f);
    scene.meshes["rock"] = mesh;
    const Glb plain(encode_glb(assemble(scene)));
    EXPECT_EQ(plain.attribute("rock", "_COLUMN_ID").size(), 12u);
    for (std::size_t k = 0; k < 3; ++k)
        scene.meshes["rock"].face_attributes["uv_" + std::to_string(k)] = uv[k];
    const Glb glb(encode_glb(assemble(scene)));
    const auto coordinates = glb.attribute("rock", "TEXCOORD_0");
    const Json& primitive = glb.json["meshes"][0]["primitives"][0];
    const auto index = glb.values(primitive["indices"]);
    const auto at = glb.attribute("rock", "POSITION"), ids = glb.attribute("rock", "_COLUMN_ID");
    ASSERT_EQ(index.size(), 3 * mesh.triangles.size());
    for (std::size_t c = 0; c < index.size(); ++c) {
        const auto v = std::size_t(index[c]);
        const Vec3f p = mesh.vertices[mesh.triangles[c / 3][c % 3]];
        EXPECT_EQ(Vec3f(at[3 * v], -at[3 * v + 2], at[3 * v + 1]), p);
        EXPECT_EQ(coordinates[2 * v], uv[c % 3][c / 3].x);
        EXPECT_EQ(coordinates[2 * v + 1], 1 - uv[c % 3][c / 3].y);
        EXPECT_EQ(ids[v], float(column[c / 3]));
    }
    EXPECT_THAT(glb.json.dump(), Not(HasSubstr("_UV_0")));
}

TEST(Exchange, FilesAreTheSameBytesOnAnyNumberOfThreads)
{
    const Scene scene = garden(30000);
    auto made = [&](std::size_t threads) {
        const ThreadLimit limit(threads);
        const Assembly all = assemble(scene);
        std::vector<std::string> files(4);
        auto to = [&](std::size_t i) -> Sink {
            return [&files, i](std::string_view part) { files[i] += part; };
        };
        write_glb(all, to(0));
        write_usda(all, to(1));
        write_instances_csv(all, to(2));
        files[3] = make_map(scene, all, "level", {}).notes.dump() +
                   encode_png(make_map(scene, all, "level", {}).picture);
        return files;
    };
    EXPECT_EQ(made(1), made(4));
}

/// The items of an array of a USD file.
std::vector<std::string> usd_array(const std::string& text, const std::string& name,
                                   std::size_t from = 0)
{
    const std::size_t at = text.find(name + " = [", from);
    if (at == std::string::npos) return {};
    const std::size_t begin = at + name.size() + 4, end = text.find(']', begin);
    std::vector<std::string> items;
    int depth = 0;
    std::string item;
    for (const char c : text.substr(begin, end - begin)) {
        depth += (c == '(') - (c == ')');
        if (c == ',' && depth == 0) {
            items.push_back(item);
            item.clear();
        } else if (c != ' ' || depth > 0)
            item += c;
    }
    if (!item.empty()) items.push_back(item);
    return items;
}

TEST(Exchange, UsdHasMeshesWithPrimvarsAndAnInstancerForEachSet)
{
    Scene scene = exchange::ball();
    scene.points["moss"] = exchange::moss(3);
    // Turned by 90 degrees about z.
    scene.points["moss"].attributes["orient"] =
        std::vector<std::array<float, 4>>(3, {0, 0, 0.70710678f, 0.70710678f});
    scene.points["moss"].attributes["pscale"] = std::vector<float>{1, 0.5f, 0.25f};
    scene.points["moss"].attributes["species"] = std::vector<std::int32_t>{0, 2, 0};
    scene.points["moss"].attributes["id"] = std::vector<std::int64_t>{11, 12, -13};
    const Assembly all = assemble(scene);
    std::string text;
    write_usda(all, [&](std::string_view part) { text += part; });
    EXPECT_TRUE(text.starts_with("#usda 1.0\n"));
    EXPECT_THAT(text, HasSubstr("upAxis = \"Z\""));
    EXPECT_THAT(text, HasSubstr("metersPerUnit = 1"));
    EXPECT_EQ(std::ranges::count(text, '{'), std::ranges::count(text, '}'));
    EXPECT_THAT(text, Not(HasSubstr("nan")));
    const TriMesh& rock = all.surfaces.front().mesh();
    EXPECT_EQ(usd_array(text, "point3f[] points").size(), rock.vertices.size());
    EXPECT_EQ(usd_array(text, "int[] faceVertexIndices").size(), 3 * rock.triangles.size());
    EXPECT_EQ(usd_array(text, "float[] primvars:level").size(), rock.vertices.size());
    const std::size_t moss = text.find("def PointInstancer \"moss\"");
    ASSERT_NE(moss, std::string::npos);
    const auto positions = usd_array(text, "point3f[] positions", moss),
               orientations = usd_array(text, "quath[] orientations", moss),
               scales = usd_array(text, "float3[] scales", moss),
               prototypes = usd_array(text, "int[] protoIndices", moss),
               rel = usd_array(text, "rel prototypes", moss),
               ids = usd_array(text, "int64[] ids", moss);
    ASSERT_EQ(positions.size(), 3u);
    EXPECT_EQ(ids.size(), 3u);
    EXPECT_EQ(orientations, std::vector<std::string>(3, "(0.70711, 0, 0, 0.70711)"));
    EXPECT_THAT(scales, Contains("(0.16, 0.16, 0.16)"));
    EXPECT_THAT(ids, Not(Contains(HasSubstr("-"))));
    std::set<std::string> used(prototypes.begin(), prototypes.end());
    EXPECT_EQ(used.size(), rel.size());
    for (const std::string& target : rel) {
        const std::string name = target.substr(target.rfind('/') + 1);
        EXPECT_THAT(text, HasSubstr("def Xform \"" + name.substr(0, name.size() - 1) + "\""));
    }
}

std::vector<std::vector<std::string>> rows_of(const std::string& csv)
{
    std::vector<std::vector<std::string>> rows;
    std::istringstream lines(csv);
    for (std::string line; std::getline(lines, line);) {
        rows.emplace_back();
        std::istringstream cells(line + ",");
        for (std::string cell; std::getline(cells, cell, ',');) rows.back().push_back(cell);
    }
    return rows;
}

TEST(Exchange, TheTableOfInstancesPutsEachCopyInItsPlace)
{
    const Scene scene = garden();
    const Assembly all = assemble(scene);
    std::string text;
    write_instances_csv(all, [&](std::string_view part) { text += part; });
    const auto rows = rows_of(text);
    ASSERT_EQ(rows.size(), all.copies() + 1);
    auto column = [&](const std::string& name) {
        const auto at = std::ranges::find(rows[0], name);
        EXPECT_NE(at, rows[0].end()) << name;
        return std::size_t(at - rows[0].begin());
    };
    std::size_t line = 1;
    for (const CopySet& set : all.sets)
        for (std::size_t p = 0; p < set.prototypes.size(); ++p)
            for (std::uint32_t k = set.first[p]; k < set.first[p + 1]; ++k, ++line) {
                const auto& row = rows[line];
                ASSERT_EQ(row.size(), rows[0].size());
                auto number = [&](const std::string& name) { return std::stod(row[column(name)]); };
                const Placement at = set.at(set.order[k]);
                EXPECT_EQ(row[0], set.name);
                EXPECT_EQ(row[1], set.prototypes[p].name);
                EXPECT_EQ(row[2], std::to_string(static_cast<std::uint64_t>(set.id(set.order[k]))));
                EXPECT_NEAR(number("P_x"), at.position.x, 1e-6);
                EXPECT_NEAR(number("P_z"), at.position.z, 1e-6);
                EXPECT_NEAR(number("orient_w"), double(at.orient[3]), 1e-5);
                EXPECT_NEAR(number("scale_x") * number("pscale"), double(at.scale.x), 1e-5);
                EXPECT_NEAR(number("scale_z") * number("pscale"), double(at.scale.z), 1e-5);
                EXPECT_EQ(row[column("wetness")].empty(), set.name != "moss");
            }
}

TEST(Exchange, ObjHasAnObjectForEachSurfaceAndAGroupForEachColumn)
{
    Scene scene;
    TriMesh rock = shapes::box({0, 0, 0}, {1, 1, 1});
    rock.face_attributes["column"] = std::vector<std::int32_t>(rock.triangles.size(), 42);
    scene.meshes["rock"] = rock;
    std::vector<std::pair<std::string, TriMesh>> more;
    more.emplace_back("bench", shapes::box({3, 0, 0}, {4, 1, 1}));
    const Assembly all = assemble(scene, {}, {}, std::move(more));
    std::string text;
    write_obj(all, "x.mtl", [&](std::string_view part) { text += part; });
    EXPECT_THAT(text, HasSubstr("mtllib x.mtl\n"));
    EXPECT_THAT(text, HasSubstr("o rock\nusemtl rock\n"));
    EXPECT_THAT(text, HasSubstr("g column_00042\n"));
    EXPECT_THAT(text, HasSubstr("o bench\nusemtl wood\n"));
    EXPECT_THAT(obj_materials(all), HasSubstr("newmtl wood\n"));
    // Faces of the second object mean its own vertices.
    const TriMesh both = decode_mesh(text, "x.obj");
    EXPECT_EQ(both.triangles.size(), 24u);
    EXPECT_NEAR(both.signed_volume(), 2, 1e-6);
    EXPECT_EQ(both.bounds().upper.x, 4);

    const TriMesh joined = joined_surfaces(all);
    EXPECT_NEAR(joined.signed_volume(), 2, 1e-6);
    const auto& part = std::get<std::vector<std::int32_t>>(joined.face_attributes.at("part"));
    EXPECT_EQ(std::ranges::count(part, 1), 12);
}

TEST(Exchange, AMapTellsHeightsFromAboveWithNorthUp)
{
    // A roof that rises to the north-east, 4 m by 2 m; a hole beside it.
    Scene scene;
    TriMesh roof;
    roof.vertices = {{0, 0, 1}, {4, 0, 3},    {4, 2, 4},   {0, 2, 2},
                     {0, 4, 0}, {0.1f, 4, 0}, {0, 3.9f, 0}};
    roof.triangles = {{0, 1, 2}, {0, 2, 3}, {4, 6, 5}};
    scene.meshes["rock"] = roof;
    const FieldMap map = make_map(scene, assemble(scene), "height", 0.125);
    EXPECT_EQ(map.picture.width, 32);
    EXPECT_EQ(map.picture.height, 32);
    const double low = map.notes["low"], high = map.notes["high"];
    EXPECT_EQ(map.notes["first"], 1);
    EXPECT_EQ(map.notes["corner"], Json({0.0, 0.0}));
    auto height = [&](int x, int row) {
        return low + (high - low) * (map.picture.at(x, row) - 1) / 65534;
    };
    for (const int x : {0, 5, 31})
        for (const int row : {16, 20, 31}) {
            const double east = (x + 0.5) / 8, north = 4 - (row + 0.5) / 8;
            EXPECT_NEAR(height(x, row), 1 + 0.5 * east + 0.5 * north, 1e-3);
        }
    EXPECT_EQ(map.picture.at(20, 8), 0) << "nothing is seen there";
    EXPECT_THAT([&] { make_map(scene, assemble(scene), "hieght", 0.125); },
                ThrowsMessage<InvalidParameter>(HasSubstr("did you mean 'height'?")));
    EXPECT_THAT([&] { make_map(scene, assemble(scene), "height", 1e-4); },
                ThrowsMessage<LimitExceeded>(HasSubstr("metres_per_pixel")));
    const Scene ball = exchange::ball();
    const FieldMap level = make_map(ball, assemble(ball), "level", {});
    EXPECT_NEAR(level.notes["high"].get<double>(), 2, 0.12);
    EXPECT_EQ(level.notes["unit"], "m");
}

TEST(Exchange, MistakesAreNamed)
{
    Scene nothing;
    nothing.points["weather"] = Points();
    EXPECT_THAT([&] { assemble(nothing); },
                ThrowsMessage<InvalidInput>(
                    testing::AllOf(HasSubstr("nothing to draw"), HasSubstr("weather"))));
    EXPECT_THAT([&] { files_of("garden.fbx", "", "height"); },
                ThrowsMessage<InvalidParameter>(HasSubstr("garden.fbx: export writes .glb")));
    Scene scene;
    scene.points["moss"] = exchange::moss(3);
    auto refused = [&](const std::string& attribute, Points::Attribute values,
                       const std::string& words) {
        Scene wrong = scene;
        wrong.points["moss"].attributes[attribute] = std::move(values);
        EXPECT_THAT([&] { assemble(wrong); }, ThrowsMessage<InvalidInput>(HasSubstr(words)));
    };
    refused("species", std::vector<std::int32_t>{0, 4, 0},
            "moss 1 is of species 4, must be 0 to 3");
    refused("orient", std::vector<std::array<float, 4>>(3, {0, 0, 0, 0}), "orientation");
    refused("pscale", std::vector<float>{1, NAN, 1}, "point 1 of 'moss'");
    refused("orient", std::vector<float>(3), "need the attributes");
    Scene forest;
    exchange::put_forest(forest, 3);
    forest.points["forest_instances"].attributes["model"] = std::vector<std::int32_t>{0, 1, 4};
    EXPECT_THAT([&] { assemble(forest); },
                ThrowsMessage<InvalidInput>(HasSubstr("tree 2 is of model 4, must be 0 to 3")));
}

TEST(Exchange, AMillionPlantsAreWrittenInSecondsAndBelow200Megabytes)
{
    Scene scene = exchange::ball();
    scene.points["moss"] = exchange::moss(1000000);
    const TemporaryFolder folder;
    for (const char* suffix : {".glb", ".usda", ".csv"}) {
        // Time of all processors together: others may be busy.
        const std::clock_t start = std::clock();
        const Assembly all = assemble(scene);
        const std::filesystem::path path = folder / (std::string("moss") + suffix);
        write_export(files_of(path, "", "").front(), scene, &all, {}, {});
        const double seconds = double(std::clock() - start) / CLOCKS_PER_SEC;
        RecordProperty(suffix, std::to_string(seconds));
        EXPECT_LT(seconds, 10) << suffix;
        EXPECT_LT(std::filesystem::file_size(path), 200e6) << suffix;
    }
}

}  // namespace
}  // namespace sekitei::apps
