#include "grids/vdb_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <openvdb/io/File.h>
#include <openvdb/openvdb.h>
#include <openvdb/tools/LevelSetSphere.h>
#include <openvdb/tools/Prune.h>
#include <sys/mount.h>
#include <unistd.h>

#include <atomic>
#include <cmath>
#include <fstream>
#include <thread>

#include "core/error.h"
#include "core/file_output.h"
#include "core/log.h"
#include "core/math.h"
#include "core/random.h"
#include "grids/vdb_format.h"
#include "tests/support/temporary_folder.h"

namespace sekitei {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::ThrowsMessage;

constexpr Transform kPlace{.origin = {1.1, -2.7, 0.3}, .voxel = 0.07};

class VdbFile : public ::testing::Test {
protected:
    void SetUp() override { openvdb::initialize(); }
    fs::path file(const std::string& name = "a.vdb") const { return folder_ / name; }
    Scene round_trip(const Scene& scene, const WriteOptions& options = {}) const
    {
        write_vdb(file(), scene, options);
        return read_vdb(file());
    }

    TemporaryFolder temporary_;
    const fs::path folder_ = temporary_.path();
};

double random_at(Coord c, std::uint64_t draw)
{
    const std::uint64_t key =
        hash2(hash2(static_cast<std::uint32_t>(c.x), draw), static_cast<std::uint32_t>(c.y));
    return uniform_of_key(key, static_cast<std::uint32_t>(c.z));
}

template <class T>
T value_at(Coord c);
template <>
float value_at<float>(Coord c)
{
    return static_cast<float>(random_at(c, 1) * 300 - 20);
}
template <>
std::int32_t value_at<std::int32_t>(Coord c)
{
    return static_cast<std::int32_t>(random_at(c, 2) * 4e9 - 2e9);
}
template <>
Vec3f value_at<Vec3f>(Coord c)
{
    return {value_at<float>(c), value_at<float>(c + Coord(1, 0, 0)), 0.25f};
}

/// Every kind of leaf: full, partly active, with one, two or many inactive values, constant
/// active, constant inactive, empty; on both sides of the origin and far apart.
template <class T>
LeafGrid<T> varied(T background)
{
    std::vector<Coord> origins;
    for (int x = -16; x < 24; x += 8)
        for (int y = -8; y < 16; y += 8)
            for (int z = -24; z < 8; z += 8) origins.push_back({x, y, z});
    origins.push_back({-80000, 5000 * 8, 12344});
    LeafGrid<T> grid(LeafTopology::build(origins), kPlace, background);
    grid.expand();
    const T other = value_at<T>({7, 7, 7}), third = value_at<T>({9, 9, 9});
    for (std::size_t i = 0; i < grid.leaf_count(); ++i) {
        const int kind = static_cast<int>(i % 9);
        for (int v = 0; v < kLeafSize; ++v) {
            const Coord c = leaf_coord(grid.origin(i), v);
            const bool on = random_at(c, 3) < 0.4;
            T& x = grid.values(i)[v];
            x = value_at<T>(c);
            if (kind == 0 || on || kind == 5) grid.mask(i).set(v);
            if (kind == 1 && !on) x = background;
            if (kind == 2 && !on) x = other;
            if (kind == 3 && !on) x = random_at(c, 4) < 0.5 ? background : other;
            if (kind == 4 && !on) x = random_at(c, 4) < 0.5 ? third : other;
            if (kind == 5) x = other;
            if (kind == 6 || kind == 7) {
                grid.mask(i).reset(v);
                x = kind == 6 ? other : background;
            }
        }
    }
    grid.compress();
    return grid;
}

template <class T>
void expect_same(const LeafGrid<T>& a, const LeafGrid<T>& b)
{
    EXPECT_EQ(a.transform(), b.transform());
    EXPECT_EQ(a.background(), b.background());
    EXPECT_EQ(a.active_count(), b.active_count());
    for (const LeafGrid<T>* grid : {&a, &b})
        for (std::size_t i = 0; i < grid->leaf_count(); ++i)
            for (int v = 0; v < kLeafSize; ++v) {
                const Coord c = leaf_coord(grid->origin(i), v);
                const T x = a.value(c), y = b.value(c);
                ASSERT_EQ(std::memcmp(&x, &y, sizeof x), 0) << c.x << " " << c.y << " " << c.z;
                ASSERT_EQ(a.active(c), b.active(c)) << c.x << " " << c.y << " " << c.z;
            }
}

Points some_points(std::size_t count)
{
    Points p;
    std::vector<float> f;
    std::vector<double> d;
    std::vector<std::int32_t> i;
    std::vector<std::int64_t> l;
    std::vector<Vec3f> v;
    std::vector<std::array<float, 4>> q;
    for (std::size_t n = 0; n < count; ++n) {
        const Coord c(static_cast<int>(n), 1, 2);
        p.position.emplace_back(random_at(c, 5) * 10 - 3, random_at(c, 6) * 4, random_at(c, 7));
        f.push_back(value_at<float>(c));
        d.push_back(random_at(c, 8));
        i.push_back(value_at<std::int32_t>(c));
        l.push_back(static_cast<std::int64_t>(n) << 40);
        v.push_back(value_at<Vec3f>(c));
        q.push_back({0.5f, -0.5f, f.back(), 0.25f});
    }
    p.attributes = {{"age", f}, {"arc", d}, {"line", i}, {"id", l}, {"colour", v}, {"orient", q}};
    p.stage = "joint";
    return p;
}

/// A scene of about 9 kB with everything in it.
Scene small_scene()
{
    Scene scene;
    scene.domain = {.dims = {24, 16, 8}, .transform = kPlace};
    scene.heat_domain = {.dims = {3, 2, 1}, .transform = {.origin = kPlace.origin, .voxel = 0.56}};
    FloatGrid t(box_topology({-8, 0, 0}, {8, 8, 8}), kPlace, 288.15f);
    t.expand();
    for (std::size_t i = 0; i < t.leaf_count(); ++i)
        for (int v = 0; v < kLeafSize; ++v) {
            t.values(i)[v] = v % 3 ? 400.0f + static_cast<float>(v) : 288.15f;
            if (v % 3) t.mask(i).set(v);
        }
    scene.put("temperature", t, "K", "cool");
    IntGrid c(box_topology({0, 0, 0}, {24, 8, 8}), kPlace, -1);
    for (std::size_t i = 0; i < c.leaf_count(); ++i) {
        c.set_constant(i, static_cast<std::int32_t>(i));
        c.mask(i) = LeafMask::full();
    }
    scene.put("column", c, "joint");
    scene.points["lines"] = some_points(5);
    scene.history.push_back({.stage = "cool",
                             .version = "1",
                             .params = {{"alpha", 0.1}},
                             .seed = ~0ull,
                             .inputs = {{"a.ply", "00ff"}}});
    return scene;
}

/// A wish to stop that comes once `share` of the work is done.
struct StopAt {
    std::atomic<bool> stop{false};
    double share;
    explicit StopAt(double s) : stop(s < 0), share(s) {}
    Progress progress()
    {
        return {[this](const std::string&, double done) {
                    if (done >= share) stop = true;
                },
                &stop};
    }
};

TEST_F(VdbFile, AStoppedWriteLeavesTheOldFileAndNothingElse)
{
    Scene scene;
    scene.put("values", varied<float>(3), "", "test");
    scene.put("more", varied<std::int32_t>(5), "test");
    write_vdb(file(), Scene{});
    const std::string before = read_file(file());
    for (const double share : {-1.0, 0.0, 0.3, 0.79, 0.85}) {
        StopAt at(share);
        EXPECT_THROW(write_vdb(file(), scene, {}, at.progress()), Cancelled) << share;
        EXPECT_EQ(read_file(file()), before);
        EXPECT_EQ(std::distance(fs::directory_iterator(folder_), fs::directory_iterator()), 1);
    }
}

TEST_F(VdbFile, AReadCanBeStoppedAtAnyGrid)
{
    Scene scene;
    scene.put("values", varied<float>(3), "", "test");
    scene.put("more", varied<std::int32_t>(5), "test");
    write_vdb(file(), scene);
    for (const double share : {-1.0, 0.0, 0.5}) {
        StopAt at(share);
        EXPECT_THROW(read_vdb(file(), {}, at.progress()), Cancelled) << share;
    }
    EXPECT_EQ(read_vdb(file(), {}, StopAt(2).progress()).grids.size(), 2u);
}

TEST_F(VdbFile, AStoppedPipeIsRefusedByItsReader)
{
    Scene scene;
    scene.put("values", varied<float>(3), "", "test");
    for (const double share : {-1.0, 0.0}) {
        int ends[2];
        ASSERT_EQ(pipe(ends), 0);
        StopAt at(share);
        EXPECT_THROW(write_vdb_stream(ends[1], scene, at.progress()), Cancelled);
        close(ends[1]);
        EXPECT_THROW(read_vdb_stream(ends[0]), InvalidInput);
        StopAt reading(-1);
        EXPECT_THROW(read_vdb_stream(ends[0], {}, "", reading.progress()), Cancelled);
        close(ends[0]);
    }
}

TEST_F(VdbFile, GridsComeBackBitForBit)
{
    Scene scene;
    scene.put("f", varied<float>(-3.5f), "K", "cool", GridClass::FogVolume);
    scene.put("zero", varied<float>(0.0f), "", "cool");
    scene.put("i", varied<std::int32_t>(-1), "joint");
    scene.put("v", varied<Vec3f>({1, 2, 3}), "m/s", "wind", "covariant normalize");
    const Scene back = round_trip(scene);
    expect_same(scene.floats("f"), back.floats("f"));
    expect_same(scene.floats("zero"), back.floats("zero"));
    expect_same(scene.ints("i"), back.ints("i"));
    expect_same(scene.vectors("v"), back.vectors("v"));
    EXPECT_EQ(back.grids.at("f").grid_class, GridClass::FogVolume);
    EXPECT_EQ(back.grids.at("f").unit, "K");
    EXPECT_EQ(back.grids.at("v").vector_type, "covariant normalize");
    EXPECT_EQ(back.grids.at("i").stage, "joint");
    for (const auto& [name, grid] : scene.grids)
        EXPECT_EQ(content_hash(grid), content_hash(back.grids.at(name))) << name;
}

TEST_F(VdbFile, DomainHistoryAndPointsComeBackExactly)
{
    const Scene scene = small_scene();
    const Scene back = round_trip(scene);
    EXPECT_EQ(back.domain, scene.domain);
    EXPECT_EQ(back.heat_domain, scene.heat_domain);
    ASSERT_EQ(back.history.size(), 1u);
    EXPECT_EQ(back.history[0].seed, ~0ull);
    EXPECT_EQ(back.history[0].params, scene.history[0].params);
    EXPECT_EQ(back.history[0].inputs, scene.history[0].inputs);
    EXPECT_EQ(back.points_of("lines").stage, "joint");

    for (const std::size_t count : {std::size_t{0}, std::size_t{1}, std::size_t{3000}}) {
        Scene many;
        many.points["p"] = some_points(count);
        const Points read = round_trip(many).points_of("p");
        EXPECT_EQ(read.position, many.points["p"].position);
        EXPECT_EQ(read.attributes, many.points["p"].attributes);
        EXPECT_EQ(content_hash(read), content_hash(many.points["p"]));
    }
}

TEST_F(VdbFile, NegativeZerosOfPointsAreZeros)
{
    // A block of nothing but zeros is stored as one of them.
    for (const float first : {0.0f, -0.0f}) {
        Scene scene;
        Points& p = scene.points["p"];
        p.position = {{first, 1, 2}, {-first, 1, 2}, {0.01, 1, 2}};
        p.attributes["f"] = std::vector<float>{first, -first, first};
        p.attributes["d"] = std::vector<double>{-first, first, first};
        p.attributes["N"] = std::vector<Vec3f>{{first, 0, 1}, {-first, 0, 1}, {first, 0, 1}};
        p.attributes["q"] = std::vector<std::array<float, 4>>{
            {first, 0, 0, 1}, {-first, 0, 0, 1}, {first, 0, 0, 1}};
        const Points read = round_trip(scene).points_of("p");
        EXPECT_EQ(content_hash(read), content_hash(p));
        for (const float x : std::get<std::vector<float>>(read.attributes.at("f")))
            EXPECT_FALSE(std::signbit(x));
        for (const Vec3d x : read.position) EXPECT_FALSE(std::signbit(x.x));
    }
}

TEST_F(VdbFile, AnEmptySceneIsAFile)
{
    const Scene back = round_trip(Scene{});
    EXPECT_TRUE(back.grids.empty());
    Scene empty_grid;
    empty_grid.put("e", FloatGrid(LeafTopology::build({}), kPlace, 1.0f), "", "s");
    EXPECT_EQ(round_trip(empty_grid).floats("e").active_count(), 0u);
}

TEST_F(VdbFile, EqualScenesAreEqualBytesOnAnyNumberOfThreads)
{
    Scene scene = small_scene();
    scene.put("f", varied<float>(0.5f), "K", "cool");
    scene.points["many"] = some_points(4000);
    std::vector<std::string> files;
    for (const std::size_t threads : {1, 2, 7}) {
        const ThreadLimit limit(threads);
        write_vdb(file(), scene);
        files.push_back(read_file(file()));
    }
    EXPECT_EQ(files[0], files[1]);
    EXPECT_EQ(files[0], files[2]);
    // A scene read back is the same file again, and so is one that was never compressed.
    write_vdb(file("b.vdb"), read_vdb(file()));
    EXPECT_EQ(read_file(file("b.vdb")), files[0]);
    FloatGrid expanded = scene.floats("f");
    expanded.expand();
    scene.put("f", expanded, "K", "cool");
    write_vdb(file("c.vdb"), scene);
    EXPECT_EQ(read_file(file("c.vdb")), files[0]);
}

TEST_F(VdbFile, HalfFloatsAreTheNearestHalves)
{
    Scene scene;
    scene.put("f", varied<float>(0.3f), "K", "cool");
    scene.put("v", varied<Vec3f>({1, 2, 0.3f}), "m/s", "wind", "");
    scene.put("i", varied<std::int32_t>(-1), "joint");
    const Scene back = round_trip(scene, {.half = true});
    expect_same(vdb::truncated_to_half(scene.floats("f")), back.floats("f"));
    expect_same(vdb::truncated_to_half(scene.vectors("v")), back.vectors("v"));
    expect_same(scene.ints("i"), back.ints("i"));
    EXPECT_THAT(verify_vdb(file()).good, ElementsAre("f", "i", "v"));
    EXPECT_FLOAT_EQ(back.floats("f").background(), 0.30004883f);
}

/// Compares with what OpenVDB itself reads.
template <class G, class T>
void expect_openvdb_sees(const fs::path& path, const std::string& name, const LeafGrid<T>& grid)
{
    openvdb::io::File in(path.string());
    in.open(false);
    const auto read = openvdb::gridPtrCast<G>(in.readGrid(name));
    ASSERT_TRUE(read);
    auto as_ours = [](const auto& x) {
        if constexpr (std::is_same_v<T, Vec3f>)
            return Vec3f(x.x(), x.y(), x.z());
        else
            return x;
    };
    EXPECT_EQ(read->activeVoxelCount(), grid.active_count());
    EXPECT_EQ(as_ours(read->background()), grid.background());
    auto accessor = read->getConstAccessor();
    for (std::size_t i = 0; i < grid.leaf_count(); ++i)
        for (int v = 0; v < kLeafSize; ++v) {
            const Coord c = leaf_coord(grid.origin(i), v);
            const openvdb::Coord o(c.x, c.y, c.z);
            ASSERT_EQ(as_ours(accessor.getValue(o)), grid.value(c));
            ASSERT_EQ(accessor.isValueOn(o), grid.active(c));
        }
    const auto world = read->indexToWorld(openvdb::Vec3d(3, -4, 5));
    const Vec3d ours = grid.transform().world(centre_of({3, -4, 5}));
    EXPECT_NEAR(world.x(), ours.x, 1e-12);
    EXPECT_NEAR(world.y(), ours.y, 1e-12);
    EXPECT_NEAR(world.z(), ours.z, 1e-12);
}

TEST_F(VdbFile, OpenVdbReadsWhatWeWrite)
{
    Scene scene = small_scene();
    scene.put("f", varied<float>(-3.5f), "K", "cool", GridClass::LevelSet);
    scene.put("v", varied<Vec3f>({0, 0, 0}), "", "wind", "covariant normalize");
    scene.put("i", varied<std::int32_t>(-1), "joint");
    write_vdb(file(), scene);
    expect_openvdb_sees<openvdb::FloatGrid>(file(), "f", scene.floats("f"));
    expect_openvdb_sees<openvdb::Vec3SGrid>(file(), "v", scene.vectors("v"));
    expect_openvdb_sees<openvdb::Int32Grid>(file(), "i", scene.ints("i"));
    openvdb::io::File in(file().string());
    in.open(true);  // delayed loading too
    EXPECT_EQ(in.getGrids()->size(), 6u);
    EXPECT_EQ(in.readGrid("f")->getGridClass(), openvdb::GRID_LEVEL_SET);
    EXPECT_EQ(in.readGrid("v")->getVectorType(), openvdb::VEC_COVARIANT_NORMALIZE);
    EXPECT_EQ(in.readGrid("lines")->type(), "Tree_ptdataidx32_5_4_3");
}

/// A grid as OpenVDB makes it: leaves, and tiles on every level.
template <class G, class Make>
typename G::Ptr openvdb_grid(typename G::ValueType background, Make&& make)
{
    auto grid = G::create(background);
    grid->setTransform(openvdb::math::Transform::createLinearTransform(0.25));
    auto accessor = grid->getAccessor();
    for (int n = 0; n < 3000; ++n) {
        const Coord c(n * 7 % 90 - 40, n * 11 % 70, n * 13 % 50 - 100);
        if (n % 3)
            accessor.setValueOn({c.x, c.y, c.z}, make(c));
        else
            accessor.setValueOff({c.x, c.y, c.z}, make(c));
    }
    grid->fill({{128, 128, 128}, {255, 255, 255}}, make({1, 2, 3}), true);
    grid->fill({{-264, 0, 0}, {-257, 7, 7}}, make({4, 5, 6}), false);
    return grid;
}

TEST_F(VdbFile, ReadsWhatOpenVdbWritesInEveryCompression)
{
    for (const std::uint32_t compression : {0u, 1u, 2u, 3u, 4u, 6u}) {
        for (const bool half : {false, true}) {
            auto grid = openvdb_grid<openvdb::FloatGrid>(
                0.5f, [](Coord c) { return std::round(value_at<float>(c)); });
            grid->setName("density");
            grid->setSaveFloatAsHalf(half);
            grid->insertMeta("artist", openvdb::StringMetadata("Aoki"));
            openvdb::io::File out(file().string());
            out.setCompression(compression);
            out.write({grid});
            out.close();
            const Scene scene = read_vdb(file());
            const FloatGrid& read = scene.floats("density");
            EXPECT_EQ(scene.grids.at("density").extra.at("artist"), "Aoki");
            EXPECT_EQ(read.active_count(), grid->activeVoxelCount());
            auto accessor = grid->getConstAccessor();
            for (std::size_t i = 0; i < read.leaf_count(); ++i)
                for (int v = 0; v < kLeafSize; ++v) {
                    const Coord c = leaf_coord(read.origin(i), v);
                    ASSERT_EQ(read.value(c), accessor.getValue({c.x, c.y, c.z}))
                        << compression << half;
                    ASSERT_EQ(read.active(c), accessor.isValueOn({c.x, c.y, c.z}));
                }
            EXPECT_DOUBLE_EQ(read.transform().voxel, 0.25);
            EXPECT_DOUBLE_EQ(read.transform().origin.x, -0.125);
        }
    }
}

TEST_F(VdbFile, WritesTheVeryBytesOpenVdbWouldWrite)
{
    auto grid = openvdb_grid<openvdb::Int32Grid>(
        -1, [](Coord c) { return value_at<std::int32_t>(c) % 100; });
    openvdb::tools::prune(grid->tree());
    grid->setName("g");
    openvdb::io::File out(file().string());
    out.setCompression(openvdb::io::COMPRESS_BLOSC | openvdb::io::COMPRESS_ACTIVE_MASK);
    out.write({grid});
    out.close();
    const std::string bytes = read_file(file());
    const vdb::Header header = vdb::parse_header(bytes, "a.vdb");
    const vdb::RawGrid theirs = vdb::extract(bytes, header, header.grids.at(0));
    const vdb::RawGrid ours = vdb::encode_tree(read_vdb(file()).ints("g"), false);
    EXPECT_EQ(ours.topology, theirs.topology);
    EXPECT_EQ(ours.buffers, theirs.buffers);
}

TEST_F(VdbFile, ALevelSetKeepsItsInsideAsTiles)
{
    auto sphere = openvdb::tools::createLevelSetSphere<openvdb::FloatGrid>(30, {1, 2, 3}, 0.5f, 4);
    sphere->setName("sdf");
    openvdb::io::File(file().string()).write({sphere});
    const Scene scene = read_vdb(file());
    EXPECT_EQ(scene.grids.at("sdf").grid_class, GridClass::LevelSet);
    EXPECT_EQ(scene.floats("sdf").value({2, 4, 6}), -2.0f);
    EXPECT_LT(scene.floats("sdf").dense_leaf_count(), sphere->tree().leafCount() + 1);
    write_vdb(file("b.vdb"), scene);
    openvdb::io::File in(file("b.vdb").string());
    in.open(false);
    const auto back = openvdb::gridPtrCast<openvdb::FloatGrid>(in.readGrid("sdf"));
    EXPECT_TRUE(back->tree().hasSameTopology(sphere->tree()));
    for (auto v = sphere->cbeginValueAll(); v; ++v)
        ASSERT_EQ(back->tree().getValue(v.getCoord()), *v);
}

TEST_F(VdbFile, GridsOfOtherTypesPassThroughUntouched)
{
    auto doubles = openvdb_grid<openvdb::DoubleGrid>(0.5, [](Coord c) { return random_at(c, 9); });
    doubles->setName("precise");
    auto mask = openvdb::MaskGrid::create();
    mask->setName("mask");
    mask->fill({{0, 0, 0}, {20, 9, 9}}, true, true);
    auto shared = openvdb::GridBase::Ptr(doubles->copyGrid());
    shared->setName("shared");
    shared->setTransform(openvdb::math::Transform::createLinearTransform(3.0));
    openvdb::io::File(file().string()).write({doubles, mask, shared});
    Scene scene = read_vdb(file());
    EXPECT_EQ(scene.grids.at("precise").type_name(), "double");
    EXPECT_EQ(scene.grids.at("precise").active_count(), doubles->activeVoxelCount());
    EXPECT_THAT([&] { scene.floats("precise"); },
                ThrowsMessage<InvalidInput>(AllOf(HasSubstr("double"), HasSubstr("float"))));
    scene.put("f", varied<float>(0), "K", "cool");
    write_vdb(file("b.vdb"), scene);
    write_vdb(file("c.vdb"), read_vdb(file("b.vdb")));
    EXPECT_EQ(read_file(file("b.vdb")), read_file(file("c.vdb")));

    openvdb::io::File in(file("c.vdb").string());
    in.open(false);
    for (const char* name : {"precise", "shared"}) {
        const auto back = openvdb::gridPtrCast<openvdb::DoubleGrid>(in.readGrid(name));
        ASSERT_TRUE(back->tree().hasSameTopology(doubles->tree()));
        for (auto v = doubles->cbeginValueAll(); v; ++v)
            ASSERT_EQ(back->tree().getValue(v.getCoord()), *v);
    }
    EXPECT_DOUBLE_EQ(in.readGrid("shared")->voxelSize()[0], 3.0);
    EXPECT_EQ(in.readGrid("mask")->activeVoxelCount(), 2100u);
}

TEST_F(VdbFile, PointsThatAnotherProgramRewroteAreRead)
{
    Scene scene;
    scene.points["p"] = some_points(200);
    write_vdb(file(), scene);
    openvdb::io::File in(file().string());
    in.open(false);
    openvdb::io::File(file("b.vdb").string()).write(*in.getGrids());
    const Points back = read_vdb(file("b.vdb")).points_of("p");
    EXPECT_EQ(back.position, scene.points["p"].position);
    EXPECT_EQ(back.attributes, scene.points["p"].attributes);
}

// --- damage -------------------------------------------------------------------------------------

void put_bytes(const fs::path& path, std::string_view bytes)
{
    std::ofstream(path, std::ios::binary).write(bytes.data(), std::streamsize(bytes.size()));
}

TEST_F(VdbFile, EveryTruncationIsNamed)
{
    write_vdb(file(), small_scene());
    const std::string whole = read_file(file());
    auto refuse = [&](std::size_t length, auto&& read) {
        try {
            read();
            ADD_FAILURE() << length;
        } catch (const InvalidInput& error) {
            EXPECT_THAT(error.what(),
                        ::testing::AnyOf(HasSubstr("truncated"), HasSubstr("empty file")))
                << length;
        }
    };
    const std::string_view bytes = whole;
    for (std::size_t length = 0; length < whole.size(); ++length)
        refuse(length, [&] { vdb::parse_header(bytes.substr(0, length), "cut.vdb"); });
    for (std::size_t length = whole.size() - 1; length > 0;
         length -= std::min(length, whole.size() / 90)) {
        fs::copy_file(file(), file("cut.vdb"), fs::copy_options::overwrite_existing);
        fs::resize_file(file("cut.vdb"), length);
        refuse(length, [&] { read_vdb(file("cut.vdb")); });
    }
    put_bytes(file("long.vdb"), whole + "x");
    EXPECT_THROW(read_vdb(file("long.vdb")), InvalidInput);
}

TEST_F(VdbFile, NoFlippedBitOfAnOwnFileIsAccepted)
{
    write_vdb(file(), small_scene());
    const std::string whole = read_file(file());
    int grid_named = 0;
    constexpr int kTrials = 3000;
    for (std::uint64_t trial = 0; trial < kTrials; ++trial) {
        std::string bytes = whole;
        for (std::uint64_t flip = 0; flip <= trial % 3; ++flip) {
            const auto bit = static_cast<std::size_t>(uniform01(7, Stream("flip"), trial, flip) *
                                                      double(bytes.size() * 8));
            bytes[bit / 8] = static_cast<char>(bytes[bit / 8] ^ (1 << bit % 8));
        }
        if (bytes == whole) continue;
        put_bytes(file("bad.vdb"), bytes);
        try {
            read_vdb(file("bad.vdb"));
            FAIL() << trial;
        } catch (const InvalidInput& error) {
            grid_named +=
                std::string(error.what()).find("hash mismatch in grid") != std::string::npos;
        }
        if (trial % 10 == 0) {
            bool verified = false;
            try {
                verified = verify_vdb(file("bad.vdb")).damaged.empty();
            } catch (const InvalidInput&) {
            }
            ASSERT_FALSE(verified);
        }
    }
    EXPECT_GT(grid_named, kTrials / 2);
}

TEST_F(VdbFile, TheUuidItselfIsGuarded)
{
    write_vdb(file(), small_scene());
    std::string bytes = read_file(file());
    EXPECT_TRUE(vdb::is_own_uuid(bytes.substr(21, 36)));
    for (std::size_t bit = 21 * 8; bit < (21 + 36) * 8; ++bit) {
        bytes[bit / 8] = static_cast<char>(bytes[bit / 8] ^ (1 << bit % 8));
        put_bytes(file("bad.vdb"), bytes);
        EXPECT_THROW(read_vdb(file("bad.vdb")), InvalidInput) << bit;
        bytes[bit / 8] = static_cast<char>(bytes[bit / 8] ^ (1 << bit % 8));
    }
}

TEST_F(VdbFile, TheDamagedGridIsNamed)
{
    write_vdb(file(), small_scene());
    std::string bytes = read_file(file());
    const vdb::Header header = vdb::parse_header(bytes, "");
    for (const vdb::Entry& grid : header.grids) {
        std::string bad = bytes;
        bad[grid.end - 1] = static_cast<char>(bad[grid.end - 1] ^ 4);
        put_bytes(file("bad.vdb"), bad);
        EXPECT_THAT(
            [&] { read_vdb(file("bad.vdb")); },
            ThrowsMessage<InvalidInput>(HasSubstr("hash mismatch in grid " + grid.shown + ";")));
        EXPECT_THAT(verify_vdb(file("bad.vdb")).damaged, ElementsAre(grid.shown));
    }
}

TEST_F(VdbFile, DamagedForeignFilesNeverCrashHangOrFillTheMemory)
{
    auto grid = openvdb_grid<openvdb::FloatGrid>(0.5f, value_at<float>);
    grid->setName("density");
    std::vector<std::string> files;
    for (const std::uint32_t compression : {2u, 3u, 6u}) {
        openvdb::io::File out(file().string());
        out.setCompression(compression);
        out.write({grid});
        out.close();
        files.push_back(read_file(file()));
    }
    int refused = 0;
    for (std::uint64_t trial = 0; trial < 1500; ++trial) {
        std::string bytes = files[trial % files.size()];
        for (std::uint64_t flip = 0; flip < 3; ++flip) {
            // Half of the damage goes to the first 2 kB, where lengths and positions are.
            const double u = uniform01(8, Stream("flip"), trial, flip);
            const double span = trial % 2 ? double(bytes.size()) : 2000.0;
            const auto bit = static_cast<std::size_t>(u * span * 8);
            bytes[bit / 8] = static_cast<char>(bytes[bit / 8] ^ (1 << bit % 8));
        }
        put_bytes(file("bad.vdb"), bytes);
        try {
            read_vdb(file("bad.vdb"), {.memory_limit = 3e8});
        } catch (const Error&) {
            ++refused;
        }
    }
    EXPECT_GT(refused, 100);
}

TEST_F(VdbFile, DamagedForeignPointsAreTriedInAProcessOfTheirOwn)
{
    Scene scene;
    scene.points["p"] = some_points(60);
    write_vdb(file(), scene);
    openvdb::io::File in(file().string());
    in.open(false);
    openvdb::io::File(file("b.vdb").string()).write(*in.getGrids());
    const std::string whole = read_file(file("b.vdb"));
    for (std::uint64_t trial = 0; trial < 150; ++trial) {
        std::string bytes = whole;
        for (std::uint64_t flip = 0; flip < 3; ++flip) {
            const auto bit = static_cast<std::size_t>(
                (0.1 + 0.9 * uniform01(9, Stream("flip"), trial, flip)) * double(bytes.size() * 8));
            bytes[bit / 8] = static_cast<char>(bytes[bit / 8] ^ (1 << bit % 8));
        }
        put_bytes(file("bad.vdb"), bytes);
        try {
            read_vdb(file("bad.vdb"), {.memory_limit = 1e9});
        } catch (const Error&) {
        }
    }
}

TEST_F(VdbFile, BadFilesAreNamed)
{
    auto reading = [&](const std::string& bytes) {
        put_bytes(file("bad.vdb"), bytes);
        return [this] { read_vdb(file("bad.vdb")); };
    };
    write_vdb(file(), small_scene());
    std::string whole = read_file(file());
    EXPECT_THAT(reading(""), ThrowsMessage<InvalidInput>(HasSubstr("empty file")));
    EXPECT_THAT(reading("\x89PNG\r\n\x1a\n" + std::string(200, 'x')),
                ThrowsMessage<InvalidInput>(HasSubstr("not a VDB: magic")));
    EXPECT_THAT(reading(whole.substr(0, whole.size() / 2)),
                ThrowsMessage<InvalidInput>(
                    AllOf(HasSubstr("truncated: header says"),
                          HasSubstr(" bytes, file has " + std::to_string(whole.size() / 2)))));
    whole[8] = static_cast<char>(225);
    EXPECT_THAT(reading(whole), ThrowsMessage<InvalidInput>(HasSubstr("version 225 is newer")));
    EXPECT_THAT([&] { read_vdb(file("none.vdb")); },
                ThrowsMessage<InvalidInput>(HasSubstr("no such file")));
    EXPECT_THAT([&] { read_vdb(folder_); }, ThrowsMessage<InvalidInput>(HasSubstr("is a folder")));
}

TEST_F(VdbFile, MissingAndRepeatedGridsAreNamed)
{
    write_vdb(file(), small_scene());
    EXPECT_THAT([&] { read_vdb(file(), {.only = {"density"}}); },
                ThrowsMessage<InvalidInput>(
                    AllOf(HasSubstr("density"), HasSubstr("column, temperature, lines"))));
    EXPECT_EQ(read_vdb(file(), {.only = {"column"}}).grids.size(), 1u);
    EXPECT_THAT([&] { read_vdb(file()).floats("density"); },
                ThrowsMessage<InvalidInput>(HasSubstr("column, temperature, lines (points)")));
    EXPECT_THAT([&] { read_vdb(file()).floats("column"); },
                ThrowsMessage<InvalidInput>(AllOf(HasSubstr("int32"), HasSubstr("float"))));

    auto a = openvdb::FloatGrid::create(1), b = openvdb::FloatGrid::create(2);
    a->setName("density");
    b->setName("density");
    openvdb::io::File(file("two.vdb").string()).write({a, b});
    EXPECT_THAT([&] { read_vdb(file("two.vdb")); },
                ThrowsMessage<InvalidInput>(HasSubstr("--grid density[1]")));
    const Scene second = read_vdb(file("two.vdb"), {.only = {"density[1]"}});
    EXPECT_EQ(second.floats("density[1]").background(), 2.0f);
}

TEST_F(VdbFile, NanAndInfinityAreCountedAndMended)
{
    auto grid = openvdb_grid<openvdb::FloatGrid>(0.5f, value_at<float>);
    grid->setName("density");
    grid->getAccessor().setValueOn({3, -4, 5}, NAN);
    grid->getAccessor().setValueOn({60, 1, 1}, INFINITY);
    openvdb::io::File(file().string()).write({grid});
    EXPECT_THAT([&] { read_vdb(file()); },
                ThrowsMessage<InvalidInput>(
                    AllOf(HasSubstr("2 voxels"), HasSubstr("(3, -4, 5)"), HasSubstr("--fix-nan"))));
    const Scene fixed = read_vdb(file(), {.fix_nan = true});
    EXPECT_EQ(fixed.floats("density").value({3, -4, 5}), 0.5f);
    EXPECT_TRUE(fixed.floats("density").active({3, -4, 5}));

    // Infinity as the value of "never" is the background, and welcome.
    FloatGrid time(box_topology({0, 0, 0}, {8, 8, 8}), kPlace, INFINITY);
    time.expand();
    for (int v = 0; v < kLeafSize; ++v) {
        time.values(0)[v] = v % 2 ? 3.0f : INFINITY;
        time.mask(0).set(v);
    }
    Scene scene;
    scene.put("front_time", time, "s", "cool");
    expect_same(round_trip(scene).floats("front_time"), time);
}

TEST_F(VdbFile, AbsurdTemperaturesAreRefused)
{
    for (const float t : {1e38f, 1e-40f}) {
        FloatGrid grid(box_topology({0, 0, 0}, {8, 8, 8}), kPlace, 300.0f);
        grid.set_constant(0, t);
        grid.mask(0) = LeafMask::full();
        Scene scene;
        scene.put("temperature", grid, "K", "cool");
        EXPECT_THAT([&] { round_trip(scene); },
                    ThrowsMessage<InvalidInput>(
                        AllOf(HasSubstr("512 voxels out of range"), HasSubstr(" K at (0, 0, 0)"))));
    }
}

TEST_F(VdbFile, TransformsThatNoStageAcceptsAreNamed)
{
    auto with_matrix = [&](const openvdb::Mat4R& m) {
        auto grid = openvdb::FloatGrid::create(1);
        grid->setName("density");
        grid->setTransform(openvdb::math::Transform::createLinearTransform(m));
        openvdb::io::File(file().string()).write({grid});
        return [this] { read_vdb(file()); };
    };
    using M = openvdb::Mat4R;
    EXPECT_THAT(with_matrix(M(1, 0, 0, 0, 0, 2, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1)),
                ThrowsMessage<InvalidInput>(AllOf(HasSubstr("density"), HasSubstr("1 2 1"))));
    EXPECT_THROW(with_matrix(M(1, 1, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1))(), InvalidInput);
    EXPECT_THROW(with_matrix(M(-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1))(), InvalidInput);
    EXPECT_NO_THROW(with_matrix(M(2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 7, 8, 9, 1))());
    EXPECT_DOUBLE_EQ(read_vdb(file()).floats("density").transform().origin.y, 7);

    auto frustum = openvdb::FloatGrid::create(1);
    frustum->setName("density");
    frustum->setTransform(openvdb::math::Transform::createFrustumTransform(
        openvdb::BBoxd({0, 0, 0}, {10, 10, 10}), 0.5, 10, 1));
    openvdb::io::File(file().string()).write({frustum});
    EXPECT_THAT([&] { read_vdb(file()); }, ThrowsMessage<InvalidInput>(HasSubstr("frustum")));
}

TEST_F(VdbFile, LimitsAreKeptBeforeAnythingIsAllocated)
{
    auto grid = openvdb::FloatGrid::create(0);
    grid->setName("density");
    grid->fill({{0, 0, 0}, {8191, 8191, 8191}}, 1.0f, true);  // eight tiles of 4096^3
    openvdb::io::File(file().string()).write({grid});
    EXPECT_THAT([&] { read_vdb(file()); },
                ThrowsMessage<LimitExceeded>(AllOf(HasSubstr("need"), HasSubstr("--memory"))));
    write_vdb(file(), small_scene());
    EXPECT_THROW(read_vdb(file(), {.memory_limit = 1000}), LimitExceeded);
    EXPECT_THROW(read_vdb(file(), {.memory_limit = 15000}), LimitExceeded);
}

TEST_F(VdbFile, AFullDiskLeavesTheOldFile)
{
    const fs::path disk = folder_ / "disk";
    if (!temporary_.mount_small(disk, "64k"))
        GTEST_SKIP() << "mounting a file system is not permitted";
    const fs::path path = disk / "a.vdb";
    write_vdb(path, small_scene());
    const std::string old = read_file(path);
    Scene big;
    big.put("f", varied<float>(0), "K", "cool");
    EXPECT_THAT([&] { write_vdb(path, big); },
                ThrowsMessage<IoError>(AllOf(HasSubstr("no space: needed"), HasSubstr("free"))));
    EXPECT_EQ(read_file(path), old);
    EXPECT_EQ(std::distance(fs::directory_iterator(disk), fs::directory_iterator()), 1);
}

// --- pipes, info, other programs -----------------------------------------------------------------

TEST_F(VdbFile, AScenePassesThroughAPipe)
{
    Scene scene = small_scene();
    scene.put("f", varied<float>(0.5f), "K", "cool");
    int ends[2];
    ASSERT_EQ(pipe(ends), 0);
    std::jthread writer([&] {
        write_vdb_stream(ends[1], scene);
        close(ends[1]);
    });
    const Scene back = read_vdb_stream(ends[0]);
    close(ends[0]);
    writer.join();
    write_vdb(file("a.vdb"), scene);
    write_vdb(file("b.vdb"), back);
    EXPECT_EQ(read_file(file("a.vdb")), read_file(file("b.vdb")));
}

TEST_F(VdbFile, ACutOrChangedPipeIsNoticed)
{
    const fs::path path = file("frame");
    FILE* out = fopen(path.c_str(), "wb");
    write_vdb_stream(fileno(out), small_scene());
    fclose(out);
    const std::string whole = read_file(path);
    EXPECT_EQ(read_vdb(path).grids.size(), 2u);  // a frame that a shell put into a file
    auto piped = [&](const std::string& bytes) {
        put_bytes(file("part"), bytes);
        FILE* in = fopen(file("part").c_str(), "rb");
        const std::string head(8, '\0');
        struct Close {
            FILE* f;
            ~Close() { fclose(f); }
        } closing{in};
        return read_vdb_stream(fileno(in)).grids.size();
    };
    EXPECT_EQ(piped(whole), 2u);
    for (const std::size_t n : {std::size_t{0}, std::size_t{5}, std::size_t{12}, std::size_t{100},
                                whole.size() / 2, whole.size() - 1})
        EXPECT_THROW(piped(whole.substr(0, n)), InvalidInput) << n;
    std::string bad = whole;
    bad[whole.size() / 2] = static_cast<char>(bad[whole.size() / 2] ^ 1);
    EXPECT_THROW(piped(bad), InvalidInput);
    bad = whole;
    bad[14] = '\x7f';  // a length of 10^16 bytes
    EXPECT_THROW(piped(bad), LimitExceeded);
    // Plain VDB files may be piped too.
    write_vdb(file(), small_scene());
    EXPECT_EQ(piped(read_file(file())), 2u);
}

TEST_F(VdbFile, InfoTellsWhatIsInside)
{
    write_vdb(file(), small_scene());
    const VdbFileInfo info = inspect_vdb(file());
    EXPECT_EQ(info.bytes, fs::file_size(file()));
    EXPECT_THAT(info.creator, HasSubstr("Sekitei"));
    EXPECT_EQ(info.domain, small_scene().domain);
    ASSERT_EQ(info.history.size(), 1u);
    EXPECT_EQ(info.history[0].stage, "cool");
    ASSERT_EQ(info.grids.size(), 3u);
    const VdbGridInfo& column = info.grids[0];
    EXPECT_EQ(column.name, "column");
    EXPECT_EQ(column.type, "int32");
    EXPECT_EQ(column.active_voxels, 3u * 512);
    EXPECT_DOUBLE_EQ(column.voxel, 0.07);
    EXPECT_DOUBLE_EQ(column.lower.x, 1.1);
    EXPECT_DOUBLE_EQ(column.upper.x, 1.1 + 24 * 0.07);
    EXPECT_EQ(info.grids[1].unit, "K");
    EXPECT_TRUE(info.grids[2].points);
    EXPECT_EQ(info.grids[2].active_voxels, 5u);
    const VerifyResult verified = verify_vdb(file());
    EXPECT_THAT(verified.good, ElementsAre("column", "temperature", "lines"));
    EXPECT_TRUE(verified.damaged.empty());
}

std::string output_of(const std::string& command)
{
    std::string text;
    FILE* pipe = popen((command + " 2>&1").c_str(), "r");
    char buffer[512];
    while (fgets(buffer, sizeof buffer, pipe)) text += buffer;
    pclose(pipe);
    return text;
}

TEST_F(VdbFile, PyopenvdbReadsOursAndWeReadIts)
{
    if (output_of("/usr/bin/python3 -c 'import pyopenvdb; print(\"yes\")'") != "yes\n")
        GTEST_SKIP() << "/usr/bin/python3 has no pyopenvdb";
    write_vdb(file(), small_scene());
    put_bytes(file("read.py"),
              "import pyopenvdb as v, sys\n"
              "g = v.read(sys.argv[1], 'temperature')\n"
              "print(g.name, g.gridClass, g.activeVoxelCount(), g.metadata['sekitei:unit'])\n"
              "a = g.getAccessor()\n"
              "a.setValueOn((100, 0, 0), 5.0)\n"
              "b = v.BoolGrid(); b.name = 'flags'; b.fill((0, 0, 0), (9, 9, 9), True)\n"
              "v.write(sys.argv[2], grids=[g, b])\n");
    EXPECT_EQ(output_of("/usr/bin/python3 " + file("read.py").string() + " " + file().string() +
                        " " + file("b.vdb").string()),
              "temperature unknown 682 K\n");
    std::string said;
    log::set_sink([&](log::Level, const std::string& line) { said += line; });
    const Scene back = read_vdb(file("b.vdb"));
    log::set_sink({});
    EXPECT_EQ(back.floats("temperature").value({100, 0, 0}), 5.0f);
    EXPECT_EQ(back.floats("temperature").active_count(), 683u);
    EXPECT_EQ(back.grids.at("flags").type_name(), "bool");
    EXPECT_THAT(said, HasSubstr("changed by another program"));
}

TEST_F(VdbFile, VdbPrintShowsOurGrids)
{
    if (output_of("vdb_print -version").find("OpenVDB") == std::string::npos)
        GTEST_SKIP() << "vdb_print is not installed";
    write_vdb(file(), small_scene());
    const std::string text = output_of("vdb_print " + file().string());
    EXPECT_THAT(text, AllOf(HasSubstr("temperature"), HasSubstr("column"), HasSubstr("lines"),
                            HasSubstr("682")));
}

TEST_F(VdbFile, WhatCannotBeStoredIsNamed)
{
    Scene scene;
    scene.points["p"] = some_points(3);
    scene.points["p"].position[1].y = NAN;
    EXPECT_THAT([&] { write_vdb(file(), scene); },
                ThrowsMessage<InvalidInput>(HasSubstr("position 1 is not finite")));
    scene.points["p"] = some_points(3);
    scene.points["p"].attributes["bad name"] = std::vector<float>(3);
    EXPECT_THAT([&] { write_vdb(file(), scene); },
                ThrowsMessage<InvalidInput>(HasSubstr("bad name")));
    scene.points["p"].attributes.erase("bad name");
    scene.points["p"].attributes["short"] = std::vector<float>(2);
    EXPECT_THAT([&] { write_vdb(file(), scene); },
                ThrowsMessage<InvalidInput>(HasSubstr("2 values for 3 points")));
    EXPECT_FALSE(fs::exists(file()));
}

}  // namespace
}  // namespace sekitei
