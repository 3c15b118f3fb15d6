// All readers as one libFuzzer target: SEKITEI_READER says which one. With SEKITEI_SEEDS=FOLDER it
// writes the good files to begin with there, and ends.
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>

#include "core/log.h"
#include "core/parallel.h"
#include "tests/fuzz/readers.h"

namespace {

const sekitei::fuzz::Reader* reader = nullptr;

}  // namespace

extern "C" int LLVMFuzzerInitialize(int*, char***)
{
    using namespace sekitei;
    static const ThreadLimit kOne(1);  // two readers run beside each other
    log::set_level(log::Level::Quiet);
    const char* name = std::getenv("SEKITEI_READER");
    reader = fuzz::find_reader(name ? name : "");
    if (!reader) {
        for (const fuzz::Reader& r : fuzz::readers())
            std::printf("%.*s\n", int(r.name.size()), r.name.data());
        std::exit(name ? 2 : 0);
    }
    if (const char* folder = std::getenv("SEKITEI_SEEDS")) {
        int number = 0;
        for (const std::string& seed : reader->seeds())
            std::ofstream(std::string(folder) + "/seed_" + std::to_string(number++),
                          std::ios::binary)
                << seed;
        std::exit(0);
    }
    return 0;
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size)
{
    reader->read({reinterpret_cast<const char*>(data), size});
    return 0;
}
