#include <openvdb/io/File.h>
#include <openvdb/openvdb.h>
#include <openvdb/points/PointConversion.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cstring>

#include "apps/recipe.h"
#include "core/file_output.h"
#include "core/hash.h"
#include "grids/vdb_file.h"
#include "grids/vdb_format.h"
#include "tests/fuzz/readers.h"

namespace sekitei::fuzz {
namespace {

/// A file with this UUID is another program's: nothing vouches for its bytes.
constexpr std::string_view kForeign = "00000000-0000-4000-8000-000000000000";

/// Bytes that a scene may take. A tile of a few bytes may stand for a million leaves, which a
/// sanitizer sorts in seconds.
constexpr double kMemory = 3e7;

void read_file_of(std::string_view bytes)
{
    const auto path = put("a.vdb", bytes);
    accepts("a.vdb", [&] { inspect_vdb(path); });
    accepts("a.vdb", [&] { verify_vdb(path); });
    accepts("a.vdb", [&] {
        const Scene scene = read_vdb(path, {.fix_nan = true, .memory_limit = kMemory});
        for (const auto& [name, points] : scene.points) content_hash(points);
        if (!scene.history.empty())
            accepts("", [&] { apps::recipe_from_history(scene.history, "a.vdb", true); });
    });
}

/// Once as it is and once as another program's, since our own must have the hash of its content.
void read_scene(std::string_view bytes)
{
    read_file_of(bytes);
    if (bytes.size() < vdb::kUuidPosition + vdb::kUuidLength ||
        !vdb::is_own_uuid(bytes.substr(vdb::kUuidPosition, vdb::kUuidLength)))
        return;
    std::string foreign(bytes);
    foreign.replace(vdb::kUuidPosition, vdb::kUuidLength, kForeign);
    read_file_of(foreign);
}

/// Bytes as a pipe hands them out.
void read_stream_of(std::string_view bytes)
{
    const int file = memfd_create("pipe", MFD_CLOEXEC);
    if (file < 0 || ::write(file, bytes.data(), bytes.size()) != ssize_t(bytes.size()) ||
        lseek(file, 0, SEEK_SET) != 0)
        broken("no memory for a pipe");
    std::string start(3, '\0');
    start.resize(std::size_t(::read(file, start.data(), start.size())));
    accepts("standard input",
            [&] { read_vdb_stream(file, {.fix_nan = true, .memory_limit = kMemory}, start); });
    ::close(file);
}

/// Once as it is and once in a frame that fits.
void read_pipe(std::string_view bytes)
{
    read_stream_of(bytes);
    constexpr std::size_t kHead = 16, kTail = 32;
    if (bytes.size() < kHead + kTail) return;
    const std::string_view inside = bytes.substr(kHead, bytes.size() - kHead - kTail);
    const std::uint64_t length = inside.size();
    std::string framed(bytes.substr(0, kHead - sizeof length));
    framed.append(reinterpret_cast<const char*>(&length), sizeof length);
    framed += inside;
    read_stream_of(framed + hash_hex(inside));
}

// --- Seeds ---------------------------------------------------------------------------------------

Scene small_scene()
{
    Scene scene;
    const Transform place{{1, -2, 0.5}, 0.25};
    scene.domain = {{16, 8, 8}, place};
    auto density = FloatGrid::uninitialised(box_topology({0, 0, 0}, {16, 8, 8}), place, 0);
    for (int i = 0; i < kLeafSize; ++i) {
        density.values(0)[i] = float(i % 3);
        if (i % 3) density.mask(0).set(i);
        density.values(1)[i] = 1;
        density.mask(1).set(i);
    }
    density.compress();
    IntGrid column(box_topology({0, 0, 0}, {8, 8, 8}), place, -1);
    column.set_constant(0, 7);
    column.mask(0) = LeafMask::full();
    auto gradient = VectorGrid::uninitialised(box_topology({0, 0, 0}, {8, 8, 8}), place, {});
    for (int i = 0; i < kLeafSize; ++i) {
        gradient.values(0)[i] = Vec3f(float(i) / 512, 0, 1);
        gradient.mask(0).set(i);
    }
    scene.put("density", std::move(density), "", "weather", GridClass::FogVolume);
    scene.put("column", std::move(column), "joint");
    scene.put("temperature_gradient", std::move(gradient), "", "cool", "covariant normalize");
    Points moss;
    for (int i = 0; i < 5; ++i) moss.position.emplace_back(0.1 * i, 0.5, 0.25 * i);
    moss.attributes = {{"pscale", std::vector<float>(5, 0.5f)},
                       {"species", std::vector<std::int32_t>{0, 1, 0, 2, 1}},
                       {"orient", std::vector<std::array<float, 4>>(5, {0, 0, 0, 1})}};
    moss.stage = "moss";
    scene.points["moss"] = moss;
    scene.history.push_back({"lava", "1", {{"preset", "slab"}, {"voxel", 0.04}}, 7});
    scene.history.push_back({"cool", "1", {{"steps", 40}}, 7});
    return scene;
}

/// Files as other programs write them.
std::vector<std::string> foreign_files()
{
    openvdb::initialize();
    std::vector<std::string> files;
    const auto path = scratch() / "seed.vdb";
    auto write = [&](const openvdb::GridPtrVec& grids, std::uint32_t compression) {
        openvdb::io::File out(path.string());
        out.setCompression(compression);
        out.write(grids);
        out.close();
        std::string bytes = read_file(path);
        bytes.replace(vdb::kUuidPosition, vdb::kUuidLength, kForeign);
        files.push_back(std::move(bytes));
    };
    auto filled = [](auto grid, const char* name, auto value) {
        grid->setName(name);
        grid->fill(openvdb::CoordBBox({0, 0, 0}, {3, 3, 9}), value);
        grid->fill(openvdb::CoordBBox({-128, 0, 0}, {-1, 127, 127}), value);
        return grid;
    };
    auto density = filled(openvdb::FloatGrid::create(0), "density", 0.5f);
    for (int i = 0; i < 40; ++i)
        density->tree().setValue({i * 5 % 8, i * 3 % 8, i % 8}, float(i) / 7);
    using namespace openvdb::io;
    for (const std::uint32_t compression :
         {std::uint32_t(COMPRESS_NONE), std::uint32_t(COMPRESS_ACTIVE_MASK),
          std::uint32_t(COMPRESS_ZIP | COMPRESS_ACTIVE_MASK),
          std::uint32_t(COMPRESS_BLOSC | COMPRESS_ACTIVE_MASK)})
        write({density}, compression);
    auto half = density->deepCopy();
    half->setSaveFloatAsHalf(true);
    write({half, filled(openvdb::Int32Grid::create(-1), "column", 3),
           filled(openvdb::Vec3SGrid::create(openvdb::Vec3s(0)), "vel", openvdb::Vec3s(1, 2, 3))},
          COMPRESS_BLOSC | COMPRESS_ACTIVE_MASK);
    auto precise = openvdb::DoubleGrid::create(0.5);
    precise->tree().setValue({1, 2, 3}, 4.0);
    auto mask = openvdb::MaskGrid::create();
    mask->tree().setValueOn({1, 2, 3});
    write({precise, mask}, COMPRESS_ACTIVE_MASK);

    const std::vector<openvdb::Vec3s> at{{0, 0, 0}, {0.3f, 1, 2}, {5, 5, 5}};
    const auto points = openvdb::points::createPointDataGrid<openvdb::points::NullCodec,
                                                             openvdb::points::PointDataGrid>(
        at, *openvdb::math::Transform::createLinearTransform(1.0));
    points->setName("points");
    write({points}, COMPRESS_BLOSC | COMPRESS_ACTIVE_MASK);
    return files;
}

std::vector<std::string> scene_seeds()
{
    std::vector<std::string> seeds = foreign_files();
    write_vdb(scratch() / "seed.vdb", small_scene());
    seeds.push_back(read_file(scratch() / "seed.vdb"));
    return seeds;
}

std::vector<std::string> pipe_seeds()
{
    const int file = memfd_create("pipe", MFD_CLOEXEC);
    write_vdb_stream(file, small_scene());
    std::string bytes(std::size_t(lseek(file, 0, SEEK_CUR)), '\0');
    if (pread(file, bytes.data(), bytes.size(), 0) != ssize_t(bytes.size())) broken("no pipe");
    ::close(file);
    write_vdb(scratch() / "seed.vdb", small_scene());
    return {bytes, read_file(scratch() / "seed.vdb")};
}

}  // namespace

std::vector<Reader> scene_readers()
{
    return {{"vdb", read_scene, scene_seeds}, {"pipe", read_pipe, pipe_seeds}};
}

}  // namespace sekitei::fuzz
