#include "core/file_output.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <memory>
#include <stdexcept>
#include <vector>

#include "core/error.h"
#include "core/hash.h"

namespace sekitei {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kBuffer = 1 << 20;
constexpr std::size_t kChunk = 1 << 24;    // between looks at the wish to stop
constexpr std::size_t kLongestName = 255;  // bytes, on every file system in use

/// A descriptor that is closed when it goes out of scope.
class Descriptor {
public:
    explicit Descriptor(int fd) : fd_(fd) {}
    ~Descriptor()
    {
        if (fd_ >= 0) ::close(fd_);
    }
    Descriptor(const Descriptor&) = delete;
    Descriptor& operator=(const Descriptor&) = delete;
    int get() const { return fd_; }

private:
    int fd_;
};

template <class Call>
auto retry_interrupted(Call&& call)
{
    auto result = call();
    while (result < 0 && errno == EINTR) result = call();
    return result;
}

[[noreturn]] void cannot_write(const fs::path& shown, const std::string& why)
{
    throw IoError(fmt::format("cannot write {}: {}", shown.string(), why));
}

std::string reason(int error)
{
    switch (error) {
        case EACCES:
        case EPERM:
            return "permission denied";
        case EROFS:
            return "the file system is read-only";
        case ENOENT:
            return "no such folder";
        case ENOTDIR:
            return "a part of the path is a file, expected a folder";
        case ENAMETOOLONG:
            return "the name is too long";
        case EFBIG:
            return "the file would be larger than this process or file system allows";
        default:
            return std::strerror(error);
    }
}

fs::path folder_of(const fs::path& file)
{
    return file.has_parent_path() ? file.parent_path() : fs::path(".");
}

/// The file a chain of symbolic links ends at, which need not exist yet.
fs::path follow_links(const fs::path& target)
{
    fs::path file = target;
    for (int i = 0; i < 40; ++i) {
        std::error_code ignored;
        if (!fs::is_symlink(fs::symlink_status(file, ignored))) return file;
        const fs::path next = fs::read_symlink(file, ignored);
        if (ignored) cannot_write(target, "unreadable symbolic link");
        file = next.is_absolute() ? next : folder_of(file) / next;
    }
    cannot_write(target, "symbolic links lead in a circle");
}

/// @param file  where the links of `target`, the name in messages, end
void check_resolved(const fs::path& file, const fs::path& target)
{
    const std::string name = file.filename().string();
    if (name.empty() || name == "." || name == "..")
        cannot_write(target, "expected the name of a file, found a folder");
    if (name.size() > kLongestName)
        cannot_write(target, fmt::format("its name has {} bytes, at most {} are possible",
                                         name.size(), kLongestName));

    const fs::path folder = folder_of(file);
    struct stat info {};
    if (::stat(folder.c_str(), &info) != 0) {
        if (errno == ENOENT)
            cannot_write(target,
                         fmt::format("no such folder {}; create it first", folder.string()));
        cannot_write(target, reason(errno));
    }
    if (!S_ISDIR(info.st_mode))
        cannot_write(target, fmt::format("{} is a file, expected a folder", folder.string()));

    if (::stat(file.c_str(), &info) == 0) {
        if (S_ISDIR(info.st_mode)) cannot_write(target, "it is a folder, expected a file name");
        if (!S_ISREG(info.st_mode))
            cannot_write(target,
                         "it is a pipe or device, which cannot be replaced safely; use - for "
                         "standard output");
    }
    if (::access(folder.c_str(), W_OK | X_OK) != 0)
        cannot_write(target, fmt::format("folder {}: {}", folder.string(), reason(errno)));
}

/// `.NAME.sekitei-PID.tmp`, NAME cut between characters where the whole would be too long.
std::string temporary_name(const std::string& name, int attempt)
{
    const std::string tail = attempt == 0 ? fmt::format(".sekitei-{}.tmp", ::getpid())
                                          : fmt::format(".sekitei-{}.{}.tmp", ::getpid(), attempt);
    std::size_t keep = std::min(name.size(), kLongestName - 1 - tail.size());
    if (keep < name.size())
        while (keep > 0 && (static_cast<unsigned char>(name[keep]) & 0xC0) == 0x80) --keep;
    return "." + name.substr(0, keep) + tail;
}

/// Whether `name` is one that temporary_name() makes.
bool is_temporary_name(const std::string& name)
{
    constexpr std::string_view kMark = ".sekitei-", kEnd = ".tmp";
    const std::size_t mark = name.rfind(kMark);
    if (name.empty() || name[0] != '.' || mark == std::string::npos || !name.ends_with(kEnd))
        return false;
    const std::size_t first = mark + kMark.size();
    if (first + kEnd.size() >= name.size()) return false;
    const std::string_view id(name.data() + first, name.size() - first - kEnd.size());
    return id.find_first_not_of("0123456789.") == std::string_view::npos;
}

std::uint64_t free_space(int fd)
{
    struct statvfs info {};
    if (::fstatvfs(fd, &info) != 0) return 0;
    return static_cast<std::uint64_t>(info.f_bavail) * info.f_frsize;
}

}  // namespace

struct AtomicFile::State {
    fs::path shown;      // as the caller named it, for messages
    fs::path target;     // with symbolic links followed
    fs::path temporary;  // empty once renamed
    int fd = -1;
    bool prepared = false;
    std::uint64_t written = 0;   // in the file
    std::uint64_t expected = 0;  // from reserve()
    std::vector<char> buffer;
    std::function<void(const fs::path&)> verifier;

    ~State()
    {
        if (fd >= 0) ::close(fd);
        if (!temporary.empty()) ::unlink(temporary.c_str());
    }

    [[noreturn]] void fail(int error, std::uint64_t needed)
    {
        if (error != ENOSPC && error != EDQUOT) cannot_write(shown, reason(error));
        // What the temporary file holds is free as soon as it is removed.
        const std::uint64_t available = free_space(fd) + written;
        cannot_write(
            shown, fmt::format("no space{}: needed {}, free {}", error == EDQUOT ? " (quota)" : "",
                               bytes_text(static_cast<double>(std::max(needed, expected))),
                               bytes_text(static_cast<double>(available))));
    }

    /// Opens a new temporary file and locks it: the lock tells remove_stale_temporaries() that its
    /// writer lives, in whatever process-id namespace.
    void open()
    {
        for (int attempt = 0; attempt < 1000; ++attempt) {
            const fs::path path =
                folder_of(target) / temporary_name(target.filename().string(), attempt);
            const int opened = retry_interrupted([&] {
                return ::open(path.c_str(), O_CREAT | O_EXCL | O_WRONLY | O_CLOEXEC, 0666);
            });
            if (opened < 0 && errno == EEXIST) continue;
            if (opened < 0) {
                if (errno == ENOSPC || errno == EDQUOT)
                    cannot_write(shown, "no space for a new file");
                cannot_write(shown, reason(errno));
            }
            struct stat info {};
            if (::flock(opened, LOCK_EX | LOCK_NB) == 0 && ::fstat(opened, &info) == 0 &&
                info.st_nlink == 0) {  // taken for a stale one before it was locked
                ::close(opened);
                continue;
            }
            fd = opened;
            temporary = path;
            return;
        }
        cannot_write(shown, "too many temporary files of earlier runs in its folder; remove them");
    }

    void put(const char* data, std::size_t bytes)
    {
        const std::uint64_t needed = written + bytes;
        while (bytes > 0) {
            const ssize_t n = retry_interrupted([&] { return ::write(fd, data, bytes); });
            if (n < 0) fail(errno, needed);
            if (n == 0) fail(ENOSPC, needed);
            data += n;
            bytes -= static_cast<std::size_t>(n);
            written += static_cast<std::uint64_t>(n);
        }
    }

    void flush()
    {
        put(buffer.data(), buffer.size());
        buffer.clear();
    }
};

AtomicFile::AtomicFile(const fs::path& target)
{
    auto state = std::make_unique<State>();
    state->shown = target;
    state->target = follow_links(target);
    check_resolved(state->target, target);
    state->open();
    state_ = state.release();
}

AtomicFile::~AtomicFile()
{
    delete state_;
}

void AtomicFile::reserve(std::uint64_t bytes)
{
    state_->expected = bytes;
    if (bytes == 0) return;
    const int error =
        ::fallocate(state_->fd, FALLOC_FL_KEEP_SIZE, 0, static_cast<off_t>(bytes)) == 0 ? 0 : errno;
    if (error == ENOSPC || error == EDQUOT) state_->fail(error, bytes);
    // Other errors: a file system that cannot reserve. Writing tells.
}

void AtomicFile::write(const void* data, std::size_t bytes)
{
    if (state_->buffer.size() + bytes > kBuffer) state_->flush();
    const char* source = static_cast<const char*>(data);
    if (bytes >= kBuffer)
        state_->put(source, bytes);
    else
        state_->buffer.insert(state_->buffer.end(), source, source + bytes);
}

void AtomicFile::write_at(std::uint64_t offset, const void* data, std::size_t bytes)
{
    if (offset > size() || bytes > size() - offset)
        throw std::logic_error("AtomicFile::write_at: beyond what is written");
    state_->flush();
    const char* source = static_cast<const char*>(data);
    while (bytes > 0) {
        const ssize_t n = retry_interrupted(
            [&] { return ::pwrite(state_->fd, source, bytes, static_cast<off_t>(offset)); });
        if (n <= 0) state_->fail(n < 0 ? errno : ENOSPC, state_->written);
        source += n;
        offset += static_cast<std::uint64_t>(n);
        bytes -= static_cast<std::size_t>(n);
    }
}

std::uint64_t AtomicFile::size() const
{
    return state_->written + state_->buffer.size();
}

void AtomicFile::set_verifier(std::function<void(const fs::path&)> verifier)
{
    state_->verifier = std::move(verifier);
}

void AtomicFile::prepare()
{
    State& s = *state_;
    if (s.prepared) return;
    s.flush();
    // A reservation larger than the content would stay allocated.
    if (s.expected > s.written && ::ftruncate(s.fd, static_cast<off_t>(s.written)) != 0)
        s.fail(errno, s.written);
    if (retry_interrupted([&] { return ::fsync(s.fd); }) != 0) s.fail(errno, s.written);
    struct stat info {};
    if (::fstat(s.fd, &info) != 0) cannot_write(s.shown, reason(errno));
    if (static_cast<std::uint64_t>(info.st_size) != s.written)
        cannot_write(s.shown, fmt::format("{} bytes were written, the file has {}", s.written,
                                          static_cast<std::uint64_t>(info.st_size)));
    if (s.verifier) s.verifier(s.temporary);
    s.prepared = true;
}

void AtomicFile::commit()
{
    prepare();
    State& s = *state_;
    // A folder or pipe of this name may have appeared since the check at the start.
    check_resolved(s.target, s.shown);
    if (::rename(s.temporary.c_str(), s.target.c_str()) != 0) cannot_write(s.shown, reason(errno));
    s.temporary.clear();

    // Make the new name last through a power cut, where the file system can.
    const Descriptor folder(
        ::open(folder_of(s.target).c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
    if (folder.get() >= 0 && retry_interrupted([&] { return ::fsync(folder.get()); }) != 0 &&
        errno != EINVAL && errno != ENOTSUP)
        cannot_write(s.shown, fmt::format("cannot sync its folder: {}", reason(errno)));
}

void write_file(const fs::path& target, std::string_view bytes, const Progress& progress)
{
    write_file_with(
        target, bytes, [] {}, progress);
}

void write_file_with(const fs::path& target, std::string_view bytes,
                     const std::function<void()>& rest, const Progress& progress)
{
    AtomicFile file(target);
    file.reserve(bytes.size());
    for (; !bytes.empty(); bytes.remove_prefix(std::min(kChunk, bytes.size()))) {
        progress.check();
        file.write(bytes.substr(0, kChunk));
    }
    progress.check();
    file.prepare();
    rest();
    file.commit();
}

void check_target(const fs::path& target)
{
    check_resolved(follow_links(target), target);
}

namespace {

/// Opens a regular file for reading; a FIFO without a writer does not block.
int open_regular(const fs::path& path, std::uint64_t& size)
{
    const int fd =
        retry_interrupted([&] { return ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK); });
    if (fd < 0)
        throw InvalidInput(fmt::format("{}: {}", path.string(),
                                       errno == ENOENT || errno == ENOTDIR ? "no such file"
                                       : errno == EACCES                   ? "permission denied"
                                                                           : std::strerror(errno)));
    struct stat info {};
    if (::fstat(fd, &info) != 0 || !S_ISREG(info.st_mode)) {
        ::close(fd);
        throw InvalidInput(
            fmt::format("{}: {}, expected a regular file", path.string(),
                        S_ISDIR(info.st_mode) ? "is a folder" : "is a pipe or device"));
    }
    size = static_cast<std::uint64_t>(info.st_size);
    return fd;
}

std::size_t read_some(int fd, const fs::path& path, char* data, std::size_t bytes)
{
    const ssize_t n = retry_interrupted([&] { return ::read(fd, data, bytes); });
    if (n < 0)
        throw InvalidInput(fmt::format("{}: cannot read: {}", path.string(), std::strerror(errno)));
    return static_cast<std::size_t>(n);
}

}  // namespace

std::string read_file(const fs::path& path, std::uint64_t limit, const Progress& progress)
{
    std::uint64_t size = 0;
    const Descriptor file(open_regular(path, size));
    if (size > limit)
        throw InvalidInput(fmt::format("{}: has {}, at most {} can be read", path.string(),
                                       bytes_text(static_cast<double>(size)),
                                       bytes_text(static_cast<double>(limit))));
    std::string bytes(size, '\0');
    std::size_t have = 0;
    while (have < bytes.size()) {
        progress.check();
        const std::size_t n =
            read_some(file.get(), path, bytes.data() + have, std::min(kChunk, bytes.size() - have));
        if (n == 0) break;  // shortened while it was read
        have += n;
    }
    bytes.resize(have);
    return bytes;
}

std::string file_hash(const fs::path& path, const Progress& progress)
{
    std::uint64_t size = 0;
    const Descriptor file(open_regular(path, size));
    Hasher hasher;
    std::vector<char> block(kBuffer);
    while (const std::size_t n = read_some(file.get(), path, block.data(), block.size())) {
        progress.check();
        hasher.add(block.data(), n);
    }
    return hasher.hex();
}

void remove_stale_temporaries(const fs::path& folder)
{
    std::error_code ignored;
    std::vector<fs::path> found;
    for (fs::directory_iterator i(folder, ignored), end; !ignored && i != end; i.increment(ignored))
        if (is_temporary_name(i->path().filename().string())) found.push_back(i->path());
    for (const fs::path& path : found) {
        const Descriptor file(::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK | O_NOFOLLOW));
        struct stat info {};
        if (file.get() < 0 || ::fstat(file.get(), &info) != 0 || !S_ISREG(info.st_mode)) continue;
        // Whoever writes it holds its lock; the kernel drops the lock when that process ends.
        if (::flock(file.get(), LOCK_EX | LOCK_NB) == 0) ::unlink(path.c_str());
    }
}

}  // namespace sekitei
