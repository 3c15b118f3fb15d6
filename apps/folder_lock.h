#pragma once

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <string>

#include "core/error.h"

namespace sekitei::apps {

/// Exclusive use of a folder while it lives; the system lets go of it when the process ends.
class FolderLock {
public:
    /// @param in_use  what to say where another run has it
    /// @throws IoError  it is in use, or cannot be written into
    FolderLock(const std::filesystem::path& folder, const std::string& in_use)
        : file_(::open((folder / "lock").c_str(), O_CREAT | O_RDWR | O_CLOEXEC, 0666))
    {
        if (file_ < 0)
            throw IoError(
                fmt::format("cannot write into {}: {}", folder.string(), std::strerror(errno)));
        if (::flock(file_, LOCK_EX | LOCK_NB) != 0) {
            ::close(file_);
            throw IoError(in_use);
        }
    }
    ~FolderLock() { ::close(file_); }
    FolderLock(const FolderLock&) = delete;
    FolderLock& operator=(const FolderLock&) = delete;

private:
    int file_;
};

}  // namespace sekitei::apps
