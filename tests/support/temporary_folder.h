#pragma once

#include <stdlib.h>
#include <sys/mount.h>

#include <cerrno>
#include <filesystem>
#include <string>
#include <system_error>
#include <vector>

namespace sekitei {

/// An empty folder under a name that nobody else has; it is gone with everything in it at the end.
class TemporaryFolder {
public:
    TemporaryFolder()
    {
        std::string name = (std::filesystem::temp_directory_path() / "sekitei_XXXXXX").string();
        if (!mkdtemp(name.data())) throw std::system_error(errno, std::generic_category(), name);
        path_ = name;
    }
    ~TemporaryFolder()
    {
        for (const auto& m : mounted_) umount2(m.c_str(), MNT_DETACH);
        std::error_code ignored;
        std::filesystem::remove_all(path_, ignored);
    }
    TemporaryFolder(const TemporaryFolder&) = delete;
    TemporaryFolder& operator=(const TemporaryFolder&) = delete;

    const std::filesystem::path& path() const { return path_; }
    std::filesystem::path operator/(const std::filesystem::path& name) const
    {
        return path_ / name;
    }

    /// A file system of its own in the folder `where`, e.g. size "64k"; false where not permitted.
    bool mount_small(const std::filesystem::path& where, const std::string& size,
                     unsigned long flags = 0)
    {
        std::filesystem::create_directory(where);
        if (mount("tmpfs", where.c_str(), "tmpfs", flags, ("size=" + size).c_str()) != 0)
            return false;
        mounted_.push_back(where);
        return true;
    }

private:
    std::filesystem::path path_;
    std::vector<std::filesystem::path> mounted_;
};

}  // namespace sekitei
