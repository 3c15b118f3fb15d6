#include <fmt/format.h>

#include <atomic>
#include <cstring>
#include <map>

#include "apps/forest_folder.h"
#include "apps/runner.h"
#include "apps/wind_checkpoint.h"
#include "core/file_output.h"
#include "core/hash.h"
#include "core/mesh_io.h"
#include "grids/leaf_topology.h"
#include "solvers/cooling/cooling.h"
#include "solvers/moss/colony.h"
#include "solvers/moss/population.h"
#include "tests/core/meshes.h"
#include "tests/fuzz/readers.h"

namespace sekitei::fuzz {
namespace {

namespace fs = std::filesystem;

/// Once as they are and once with a hash that fits: else hardly any damage gets past the hash.
template <class F>
void as_they_are_and_signed(std::string_view bytes, F&& read)
{
    read(std::string(bytes));
    read(signed_again(bytes));
}

// --- Checkpoints of stages -----------------------------------------------------------------------

/// Lava of 6 x 6 x 6 voxels under a lid.
const cooling::Inputs& small_lava()
{
    static const IntGrid kRegion = [] {
        auto grid = IntGrid::uninitialised(box_topology({0, 0, 0}, {8, 8, 8}), Transform{}, 1);
        for (int i = 0; i < kLeafSize; ++i) {
            const Coord c = leaf_coord({0, 0, 0}, i);
            const bool lava = c.z < 6 && c.x < 6 && c.y < 6;
            grid.values(0)[i] = lava ? 0 : 1;
            if (lava) grid.mask(0).set(i);
        }
        return grid;
    }();
    static const cooling::Inputs kInputs{kRegion, {{8, 8, 8}, Transform{}}, 6, 0.1};
    return kInputs;
}

void read_cool(std::string_view bytes)
{
    as_they_are_and_signed(bytes, [](std::string text) {
        if (text.empty()) return;  // says that there is none
        accepts("", [&] {
            cooling::Checkpoint checkpoint;
            checkpoint.resume = std::move(text);
            cooling::run(small_lava(), {}, checkpoint, {});
        });
    });
}

std::vector<std::string> cool_seeds()
{
    std::vector<std::string> seeds;
    cooling::Checkpoint checkpoint;
    checkpoint.save = [&](const std::string& bytes) { seeds.push_back(bytes); };
    checkpoint.interval = 0;
    for (const bool stop : {false, true}) {  // stopped, it leaves one too
        const std::atomic<bool> wish = stop;
        try {
            cooling::run(small_lava(), {}, checkpoint,
                         Progress([](const std::string&, double) {}, &wish));
        } catch (const Cancelled&) {
        }
    }
    return seeds;
}

constexpr std::size_t kSites = 5;
constexpr std::uint64_t kSeed = 7;
constexpr const char* kRecipe = R"({"days":3,"species":"bryum"})";

void read_moss(std::string_view bytes)
{
    as_they_are_and_signed(bytes, [](const std::string& text) {
        accepts("m.checkpoint", [&] {
            const auto c = moss::decode(text, "m.checkpoint", kSeed, kRecipe, kSites);
            if (c.population.cover.size() != kSites) broken("arrays of different lengths");
        });
    });
}

std::vector<std::string> moss_seeds()
{
    moss::Checkpoint c{kSeed, kRecipe, moss::Population(kSites), {{"water", {1, 2, 3, 4, 5}}}};
    return {moss::encode(c)};
}

void read_colony(std::string_view bytes)
{
    as_they_are_and_signed(bytes, [](const std::string& text) {
        accepts("c.checkpoint", [&] {
            const auto c = moss::decode_colony(text, "c.checkpoint", kSeed, kRecipe, kSites);
            for (const std::uint32_t site : c.population.plants.site)
                if (site >= kSites) broken("a moss on no site");
        });
    });
}

std::vector<std::string> colony_seeds()
{
    moss::Colony colony;
    moss::Plants& p = colony.plants;
    for (auto* v : {&p.foot, &p.normal}) v->resize(3);
    p.site = {0, 4, 2};
    p.host.resize(3);
    p.species.resize(3);
    p.id = {1, 2, 3};
    for (auto* v : {&p.height, &p.light, &p.light_area, &p.growth, &p.growth_max}) v->resize(3);
    for (auto* v : {&p.landed, &p.born}) v->resize(3);
    moss::ColonyCheckpoint c{kSeed, kRecipe, colony, {{"water", {1, 2, 3, 4, 5}}}};
    return {moss::encode(c), moss::encode(moss::ColonyCheckpoint{kSeed, kRecipe, {}, {}})};
}

void read_wind(std::string_view bytes)
{
    auto read = [](const std::string& text) {
        accepts("w.checkpoint", [&] { apps::decode_wind(text, "w.checkpoint", "abc"); });
    };
    read(std::string(bytes));
    if (bytes.size() > 32) read(hash_hex(bytes.substr(32)) + std::string(bytes.substr(32)));
}

std::vector<std::string> wind_seeds()
{
    wind::State state;
    state.garden[3] = state.object[5] = true;
    state.arrival[5] = {0.5f, 0.25f, 1.5f};
    state.warnings = {"a coarser grid"};
    state.tables.layers.resize(2);
    return {apps::encode_wind(state, "abc")};
}

// --- Forests -------------------------------------------------------------------------------------

forest::Inputs small_forest()
{
    forest::Inputs inputs;
    inputs.width = inputs.depth = 24;
    inputs.params.tile = 16;
    inputs.species = forest::table_species();
    return inputs;
}

const std::vector<forest::Tree>& some_trees()
{
    static const std::vector<forest::Tree> kTrees = [] {
        forest::Forest forest(small_forest());
        forest.sow(std::vector<std::uint64_t>(6, 3));
        forest.advance();
        return forest.trees();
    }();
    return kTrees;
}

const Json kIdentity = {{"seed", 1}, {"size", 24}};

apps::ForestState some_state()
{
    apps::ForestState state;
    state.step = 1;
    state.growth.resize(1);
    state.growth[0].step = 1;
    state.growth[0].counts.resize(6);
    state.fallen.push_back({17, 1, 2, 3.5, 4.5, 0.25, 12});
    return state;
}

void read_forest(std::string_view bytes)
{
    auto read = [](const std::string& text) {
        accepts("", [&] {
            auto found = apps::decode_forest(text, kIdentity, "f.checkpoint");
            if (!found) return;
            forest::Forest forest(small_forest());
            forest.resume(found->first.step, std::move(found->second));
            if (forest.size() < 1000) forest.advance();
        });
    };
    read(std::string(bytes));
    if (bytes.size() < 8) return;
    std::string body(bytes.substr(0, bytes.size() - 8));
    const std::uint64_t hash = hash64(body.data(), body.size());
    read(body.append(reinterpret_cast<const char*>(&hash), sizeof hash));
}

/// Rows in memory.
struct Rows : forest::RowStore {
    std::map<std::pair<int, int>, std::string> rows;

    std::string load(int step, int row) override
    {
        const auto found = rows.find({step, row});
        if (found == rows.end()) throw InvalidInput(fmt::format("no row {} of step {}", row, step));
        return found->second;
    }
    void save(int step, int row, const std::string& bytes) override { rows[{step, row}] = bytes; }
    void complete(int) override {}
};

Rows some_rows()
{
    Rows store;
    forest::Forest forest(small_forest(), store);
    forest.sow(std::vector<std::uint64_t>(6, 3));
    forest.advance();
    return store;
}

/// Row 0 of step 1 of a forest on disk.
void read_row(std::string_view bytes)
{
    static const Rows kGood = some_rows();
    constexpr std::size_t kHash = 24, kHeader = 32;
    auto read = [](const std::string& text) {
        Rows store = kGood;
        store.rows[{1, 0}] = text;
        accepts("", [&] {
            forest::Forest forest(small_forest(), store);
            forest.resume(1);
            if (text.size() < 100000) forest.advance();
        });
    };
    read(std::string(bytes));
    if (bytes.size() < kHeader) return;
    std::string body(bytes);
    const std::uint64_t hash = hash64(body.data() + kHeader, body.size() - kHeader);
    std::memcpy(body.data() + kHash, &hash, sizeof hash);
    read(body);
}

/// state.json of a folder of a forest.
void read_forest_folder(std::string_view bytes)
{
    static const fs::path kFolder = [] {
        fs::create_directory(scratch() / "forest");
        return scratch() / "forest";
    }();
    put("forest/state.json", bytes);
    accepts("forest", [&] { apps::ForestFolder(kFolder, kIdentity, {}); });
}

std::vector<std::string> forest_folder_seeds()
{
    const fs::path folder = scratch() / "forest_seed";
    fs::create_directory(folder);
    apps::ForestFolder(folder, kIdentity, {}).keep(some_state());
    return {read_file(folder / "state.json")};
}

// --- Runs ----------------------------------------------------------------------------------------

/// The cheapest recipe that keeps, reads and writes: its run has been made.
const apps::Recipe& small_recipe()
{
    static const apps::Recipe kSmall = apps::parse_recipe(
        fmt::format("sekitei = 1\nout = \"{0}\"\n[rock]\nstage = \"mesh\"\nfile = "
                    "\"{1}\"\nwrite = [\"rock.ply\"]\n",
                    (scratch() / "out").string(),
                    put("rock.obj", encode_mesh(meshes::tetrahedron(), ".obj")).string()),
        scratch() / "small.toml", {});
    return kSmall;
}

enum class Kept { State, Record, Manifest };

fs::path kept_file(Kept which)
{
    const fs::path out = scratch() / "out";
    if (which == Kept::Manifest) return out / "manifest.json";
    if (which == Kept::State) return out / ".sekitei/state.json";
    for (const auto& entry : fs::directory_iterator(out / ".sekitei"))
        if (entry.path().extension() == ".json" && entry.path().filename() != "state.json")
            return entry.path();
    broken("a run that keeps no record");
}

void run_once()
{
    fs::remove_all(scratch() / "out");
    apps::run_recipe(small_recipe(), {});
}

/// A run that finds this among what it kept ends well, or refuses.
template <Kept which>
void read_kept(std::string_view bytes)
{
    static const fs::path kFile = (run_once(), kept_file(which));
    put(fs::relative(kFile, scratch()), bytes);
    if (which == Kept::Manifest) accepts("manifest.json", [&] { apps::verify_manifest(kFile); });
    accepts(which == Kept::Manifest ? "manifest.json" : "", [&] {
        apps::RunOptions options;
        options.dry_run = true;
        apps::run_recipe(small_recipe(), options);
        // What costs milliseconds is worth it where something was understood.
        const Json json = Json::parse(bytes, nullptr, false);
        if (!json.is_object()) return;
        options.dry_run = false;
        options.only = {"rock"};
        apps::run_recipe(small_recipe(), options);
    });
}

template <Kept which>
std::vector<std::string> kept_seeds()
{
    run_once();
    return {read_file(kept_file(which))};
}

}  // namespace

std::vector<Reader> record_readers()
{
    return {{"cool_checkpoint", read_cool, cool_seeds},
            {"moss_checkpoint", read_moss, moss_seeds},
            {"colony_checkpoint", read_colony, colony_seeds},
            {"wind_checkpoint", read_wind, wind_seeds},
            {"forest_checkpoint", read_forest,
             [] {
                 return std::vector<std::string>{
                     apps::encode_forest(kIdentity, some_state(), some_trees())};
             }},
            {"forest_row", read_row,
             [] {
                 return std::vector<std::string>{some_rows().rows.at({1, 0})};
             }},
            {"forest_folder", read_forest_folder, forest_folder_seeds},
            {"run_state", read_kept<Kept::State>, kept_seeds<Kept::State>},
            {"run_record", read_kept<Kept::Record>, kept_seeds<Kept::Record>},
            {"manifest", read_kept<Kept::Manifest>, kept_seeds<Kept::Manifest>}};
}

}  // namespace sekitei::fuzz
