#include "tests/fuzz/readers.h"

#include <algorithm>
#include <cstdio>
#include <cstdlib>

#include "core/file_output.h"
#include "core/hash.h"
#include "tests/support/temporary_folder.h"

namespace sekitei::fuzz {

namespace fs = std::filesystem;

const std::vector<Reader>& readers()
{
    static const std::vector<Reader> kAll = [] {
        std::vector<Reader> all;
        for (const auto& some : {mesh_readers(), table_readers(), settings_readers(),
                                 record_readers(), scene_readers()})
            all.insert(all.end(), some.begin(), some.end());
        return all;
    }();
    return kAll;
}

const Reader* find_reader(std::string_view name)
{
    const auto found = std::ranges::find(readers(), name, &Reader::name);
    return found == readers().end() ? nullptr : &*found;
}

void broken(const std::string& what)
{
    std::fprintf(stderr, "broken: %s\n", what.c_str());
    std::abort();
}

const fs::path& scratch()
{
    static const TemporaryFolder kFolder;
    return kFolder.path();
}

fs::path put(const fs::path& name, std::string_view bytes)
{
    const fs::path path = scratch() / name;
    std::FILE* file = std::fopen(path.c_str(), "wb");
    if (!file) broken("cannot write " + path.string());
    std::fwrite(bytes.data(), 1, bytes.size(), file);
    std::fclose(file);
    return path;
}

std::string data_file(const fs::path& name)
{
    return read_file(fs::path(SEKITEI_DATA) / name);
}

std::vector<std::string> data_files(const fs::path& folder, std::string_view suffix)
{
    std::vector<fs::path> paths;
    for (const auto& entry : fs::directory_iterator(fs::path(SEKITEI_DATA) / folder))
        if (entry.path().extension() == suffix) paths.push_back(entry.path());
    std::ranges::sort(paths);
    std::vector<std::string> files;
    for (const fs::path& path : paths) files.push_back(read_file(path));
    return files;
}

std::string signed_again(std::string_view bytes)
{
    constexpr std::size_t kDigits = 32;
    if (bytes.size() < kDigits) return std::string(bytes);
    const std::string body(bytes.substr(0, bytes.size() - kDigits));
    return body + hash_hex(body);
}

}  // namespace sekitei::fuzz
