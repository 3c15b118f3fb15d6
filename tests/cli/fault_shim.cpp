// Preloaded into the program by tests: logs, fails or stops it at its n-th call that changes a
// file.
//
// FAULT_LOG    file that takes a line `KIND PATH` for each call
// FAULT_KINDS  the kinds that count, e.g. `write,sync`; all without it
// FAULT_AT     the call that fails, from 1; 0: each one
// FAULT_HOW    a number: fails with this errno; `kill`: the process is killed before it;
//              `short`: a write takes only half of the bytes; `interrupt`: fails once with EINTR
//
// Kinds: create (a file is opened that may not exist), write, overwrite (pwrite), reserve
// (fallocate), truncate, sync (of a file), sync_folder, rename. Standard input, output and error do
// not count.
//
// FAULT_CLOCK    1: the clock on the wall jumps by a year at each look
// EMBREE_CONFIG  what devices of Embree are made with, e.g. `isa=sse2` for the code of another
// processor

#include <dlfcn.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <csignal>
#include <cstdarg>
#include <cstdlib>
#include <cstring>
#include <ctime>

namespace {

std::atomic<long> g_calls{0};
thread_local bool g_interrupted = false;

template <class F>
F* real(const char* name)
{
    return reinterpret_cast<F*>(dlsym(RTLD_NEXT, name));
}

bool counts(const char* kind)
{
    const char* kinds = std::getenv("FAULT_KINDS");
    if (!kinds) return true;
    const std::size_t length = std::strlen(kind);
    for (const char* at = kinds; (at = std::strstr(at, kind)); at += length)
        if ((at == kinds || at[-1] == ',') && (at[length] == ',' || at[length] == '\0'))
            return true;
    return false;
}

void log_call(const char* kind, const char* path)
{
    const char* file = std::getenv("FAULT_LOG");
    if (!file) return;
    char line[8192];
    const std::size_t k = std::strlen(kind), p = std::min(std::strlen(path), sizeof line - k - 2);
    std::memcpy(line, kind, k);
    line[k] = ' ';
    std::memcpy(line + k + 1, path, p);
    line[k + p + 1] = '\n';
    const long fd = syscall(SYS_open, file, O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC, 0666);
    syscall(SYS_write, fd, line, k + p + 2);
    syscall(SYS_close, fd);
}

enum class Verdict { Go, Fail, Short };

/// What becomes of this call; sets errno where it fails.
Verdict judge(const char* kind, const char* path)
{
    if (!counts(kind)) return Verdict::Go;
    const char* how = std::getenv("FAULT_HOW");
    const bool again = how && std::strcmp(how, "interrupt") == 0 && g_interrupted;
    g_interrupted = false;
    if (again) return Verdict::Go;
    log_call(kind, path);
    const long call = ++g_calls;
    const char* at = std::getenv("FAULT_AT");
    if (!how || !at) return Verdict::Go;
    const long wanted = std::atol(at);
    if (wanted != 0 && wanted != call) return Verdict::Go;
    if (std::strcmp(how, "kill") == 0) {
        syscall(SYS_kill, getpid(), SIGKILL);
        pause();
    }
    if (std::strcmp(how, "short") == 0) return Verdict::Short;
    if (std::strcmp(how, "interrupt") == 0) {
        g_interrupted = true;
        errno = EINTR;
    } else
        errno = std::atoi(how);
    return Verdict::Fail;
}

/// The same for an open file; only regular files and folders count.
Verdict judge(const char* kind, const char* folder_kind, int fd)
{
    struct stat info {};
    if (fd <= 2 || fstat(fd, &info) != 0) return Verdict::Go;
    const bool folder = S_ISDIR(info.st_mode);
    if (!S_ISREG(info.st_mode) && !(folder && folder_kind)) return Verdict::Go;
    char link[64] = "/proc/self/fd/", path[4096];
    char digits[16];
    int n = 0;
    for (int rest = fd; rest > 0; rest /= 10) digits[n++] = static_cast<char>('0' + rest % 10);
    std::size_t end = std::strlen(link);
    while (n > 0) link[end++] = digits[--n];
    link[end] = '\0';
    const long length = syscall(SYS_readlink, link, path, sizeof path - 1);
    path[length > 0 ? length : 0] = '\0';
    return judge(folder ? folder_kind : kind, path);
}

}  // namespace

extern "C" {

ssize_t write(int fd, const void* data, std::size_t bytes)
{
    const Verdict verdict = judge("write", nullptr, fd);
    if (verdict == Verdict::Fail) return -1;
    return real<decltype(::write)>("write")(
        fd, data, verdict == Verdict::Short && bytes > 1 ? bytes / 2 : bytes);
}

ssize_t writev(int fd, const iovec* parts, int count)
{
    if (judge("write", nullptr, fd) == Verdict::Fail) return -1;
    return real<decltype(::writev)>("writev")(fd, parts, count);
}

ssize_t pwrite(int fd, const void* data, std::size_t bytes, off_t offset)
{
    const Verdict verdict = judge("overwrite", nullptr, fd);
    if (verdict == Verdict::Fail) return -1;
    return real<decltype(::pwrite)>("pwrite")(
        fd, data, verdict == Verdict::Short && bytes > 1 ? bytes / 2 : bytes, offset);
}

int fallocate(int fd, int mode, off_t offset, off_t length)
{
    if (judge("reserve", nullptr, fd) == Verdict::Fail) return -1;
    return real<decltype(::fallocate)>("fallocate")(fd, mode, offset, length);
}

int ftruncate(int fd, off_t length) noexcept
{
    if (judge("truncate", nullptr, fd) == Verdict::Fail) return -1;
    return real<int(int, off_t)>("ftruncate")(fd, length);
}

int fsync(int fd)
{
    if (judge("sync", "sync_folder", fd) == Verdict::Fail) return -1;
    return real<decltype(::fsync)>("fsync")(fd);
}

int fdatasync(int fd)
{
    if (judge("sync", "sync_folder", fd) == Verdict::Fail) return -1;
    return real<decltype(::fdatasync)>("fdatasync")(fd);
}

int rename(const char* from, const char* to) noexcept
{
    if (judge("rename", to) == Verdict::Fail) return -1;
    return real<int(const char*, const char*)>("rename")(from, to);
}

int open(const char* path, int flags, ...)
{
    mode_t mode = 0;
    if (flags & O_CREAT) {
        va_list rest;
        va_start(rest, flags);
        mode = va_arg(rest, mode_t);
        va_end(rest);
        if (judge("create", path) == Verdict::Fail) return -1;
    }
    return real<int(const char*, int, ...)>("open")(path, flags, mode);
}

int clock_gettime(clockid_t clock, timespec* now) noexcept
{
    const int result = real<int(clockid_t, timespec*)>("clock_gettime")(clock, now);
    const char* jumps = std::getenv("FAULT_CLOCK");
    static std::atomic<long> looks{0};
    if (clock == CLOCK_REALTIME && jumps && jumps[0] == '1')
        now->tv_sec += (looks++ % 2 == 0 ? -1 : 1) * 31'556'952L;
    return result;
}

void* rtcNewDevice(const char* config)
{
    const char* wanted = std::getenv("EMBREE_CONFIG");
    return real<void*(const char*)>("rtcNewDevice")(wanted ? wanted : config);
}
}
