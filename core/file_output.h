#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>

#include "core/progress.h"

/// Files that are either the old one, whole, or the new one, whole.
namespace sekitei {

/// A file being written beside its target as `.NAME.sekitei-PID.tmp`, and renamed by commit().
///
/// Every write is checked; commit() flushes, syncs the file, checks its size, renames it and syncs
/// the folder. Without commit() the destructor removes the temporary file and the target is
/// untouched.
/// "/dev/stdout" and other special files that cannot be renamed over are refused by check_target().
class AtomicFile {
public:
    /// @throws IoError  no such folder, read-only, not permitted, target is a folder
    explicit AtomicFile(const std::filesystem::path& target);
    ~AtomicFile();
    AtomicFile(const AtomicFile&) = delete;
    AtomicFile& operator=(const AtomicFile&) = delete;

    /// Says how large the file will be: a disk too full is then refused before the first byte.
    void reserve(std::uint64_t bytes);
    /// @throws IoError  "cannot write cliff.vdb: no space: needed 5.3 MB, free 64 kB"
    void write(const void* data, std::size_t bytes);
    void write(std::string_view text) { write(text.data(), text.size()); }
    /// Overwrites bytes already written, e.g. a header field known only at the end.
    void write_at(std::uint64_t offset, const void* data, std::size_t bytes);
    std::uint64_t size() const;

    /// Called with the temporary path after the sync and before the rename; throws to refuse.
    void set_verifier(std::function<void(const std::filesystem::path&)> verifier);
    /// All of commit() but the rename.
    void prepare();
    void commit();

private:
    struct State;
    State* state_;
};

/// Writes one file atomically; cancelled, the target is left as it was.
void write_file(const std::filesystem::path& target, std::string_view bytes,
                const Progress& progress = {});

/// The same with another file, which `rest` writes: what may fail comes before either has its name,
/// so that both are new or both are what they were.
void write_file_with(const std::filesystem::path& target, std::string_view bytes,
                     const std::function<void()>& rest, const Progress& progress = {});

/// Fails now if `target` could not be written later: missing folder, folder read-only, target is a
/// folder, a FIFO or a device.
/// @throws IoError
void check_target(const std::filesystem::path& target);

/// Reads a whole regular file of at most `limit` bytes.
/// @throws InvalidInput  missing, not a regular file, unreadable, too large
std::string read_file(const std::filesystem::path& path, std::uint64_t limit = 1ull << 32,
                      const Progress& progress = {});

/// XXH3-128 of a file's bytes, in hexadecimal.
std::string file_hash(const std::filesystem::path& path, const Progress& progress = {});

/// Removes temporary files left in `folder` by processes that no longer run (a writer holds a lock
/// on its own).
void remove_stale_temporaries(const std::filesystem::path& folder);

}  // namespace sekitei
