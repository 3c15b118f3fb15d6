#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "core/error.h"

/// Everything that reads bytes which Sekitei may not have written, each behind one function of
/// bytes. libfuzzer.cpp and brief.cpp feed them.
namespace sekitei::fuzz {

struct Reader {
    std::string_view name;
    /// Any bytes are read or refused; what was read is whole. Everything else ends the process.
    void (*read)(std::string_view bytes);
    /// Good files to begin with.
    std::vector<std::string> (*seeds)();
};

std::vector<Reader> mesh_readers();
std::vector<Reader> table_readers();
std::vector<Reader> settings_readers();
std::vector<Reader> record_readers();
std::vector<Reader> scene_readers();
/// All of the above.
const std::vector<Reader>& readers();
/// @return null if there is none of this name
const Reader* find_reader(std::string_view name);

/// Says what is wrong with a reader and ends the process as a crash does.
[[noreturn]] void broken(const std::string& what);

/// Whether f() took its input. It may refuse it with an Error that names what it read, and with
/// nothing else.
/// @param name  must be in the message; empty where there is no name
template <class F>
bool accepts(std::string_view name, F&& f)
{
    try {
        f();
        return true;
    } catch (const Error& error) {
        if (error.code() != ExitCode::BadInput && error.code() != ExitCode::Usage &&
            error.code() != ExitCode::Limit)
            broken(std::string("refused with another exit code: ") + error.what());
        if (std::string_view(error.what()).find(name) == std::string_view::npos)
            broken(std::string("refused without the file's name: ") + error.what());
        return false;
    }
}

/// A folder of this process's own.
const std::filesystem::path& scratch();
/// Puts a file there.
/// @param name  relative
std::filesystem::path put(const std::filesystem::path& name, std::string_view bytes);
/// A file of the folder data/.
std::string data_file(const std::filesystem::path& name);
/// All files of a folder below data/ with this ending, by name.
std::vector<std::string> data_files(const std::filesystem::path& folder, std::string_view suffix);

/// With the 32 digits at the end that fit what is before them, so that damage gets past the hash.
std::string signed_again(std::string_view bytes);

}  // namespace sekitei::fuzz
