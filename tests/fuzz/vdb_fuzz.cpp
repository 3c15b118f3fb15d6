// libFuzzer target: whatever the bytes are, reading a scene from them ends in a scene or a clean
// error.
#include <unistd.h>

#include <cstdint>
#include <cstdio>
#include <cstdlib>

#include "core/error.h"
#include "core/file_output.h"
#include "core/log.h"
#include "grids/vdb_file.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size)
{
    static const std::string path = [] {
        sekitei::log::set_level(sekitei::log::Level::Quiet);
        char name[] = "/dev/shm/vdb_fuzz_XXXXXX";
        if (const int fd = mkstemp(name); fd >= 0) close(fd);
        static std::string kept = name;
        std::atexit([] { std::remove(kept.c_str()); });
        return kept;
    }();
    if (std::FILE* file = std::fopen(path.c_str(), "wb")) {
        std::fwrite(data, 1, size, file);
        std::fclose(file);
    }
    try {
        sekitei::read_vdb(path, {.fix_nan = true, .memory_limit = 2e8});
        sekitei::inspect_vdb(path);
    } catch (const sekitei::Error&) {
    }
    return 0;
}
