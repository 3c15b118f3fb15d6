// Files of a million copies: case, copies, threads, seconds, bytes, hash.
#include <fmt/format.h>

#include <cstdlib>
#include <filesystem>

#include "apps/exchange/files.h"
#include "core/file_output.h"
#include "core/parallel.h"
#include "grids/vdb_file.h"
#include "tests/bench/measure.h"
#include "tests/support/exchange.h"

using namespace sekitei;

/// @param argv  folder for scenes and files, number of copies
int main(int argc, char** argv)
{
    const std::filesystem::path folder = argc > 1 ? argv[1] : ".";
    const std::size_t count =
        argc > 2 ? static_cast<std::size_t>(std::strtoull(argv[2], nullptr, 10)) : 1000000;
    for (const std::string what : {"moss", "forest"}) {
        Scene scene = exchange::ball();
        if (what == "moss")
            scene.points["moss"] = exchange::moss(count);
        else
            exchange::put_forest(scene, count);
        write_vdb(folder / (what + ".vdb"), scene);
        apps::Assembly all;
        const double gathered = bench::seconds_of([&] { all = apps::assemble(scene); });
        fmt::print("{}, gather, {}, {}, {:.2f}\n", what, count, thread_count(), gathered);
        for (const char* suffix : {".glb", ".usda", ".csv"}) {
            const std::filesystem::path path = folder / (what + suffix);
            const double seconds = bench::seconds_of([&] {
                apps::write_export(apps::files_of(path, "", "").front(), scene, &all, {}, {});
            });
            fmt::print("{}, {}, {}, {}, {:.2f}, {}, {}\n", what, suffix, count, thread_count(),
                       seconds, std::filesystem::file_size(path), file_hash(path));
        }
    }
}
