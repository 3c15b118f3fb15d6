// brief READER COUNT [CORPUS]: the reader's good files, every file of CORPUS, and COUNT damaged
// ones made from both, the same ones each time. Five seconds each, and a gigabyte more than at the
// start.
#include <fmt/format.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/time.h>
#include <unistd.h>

#include <algorithm>
#include <bit>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <filesystem>

#include "core/file_output.h"
#include "core/log.h"
#include "core/parallel.h"
#include "core/random.h"
#include "tests/fuzz/readers.h"

namespace {

using namespace sekitei;
namespace fs = std::filesystem;

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
constexpr bool kSanitized = true;
#elif defined(__has_feature)
constexpr bool kSanitized = __has_feature(address_sanitizer) || __has_feature(thread_sanitizer);
#else
constexpr bool kSanitized = false;
#endif
constexpr double kMemory = 1 << 30;
constexpr int kSeconds = kSanitized ? 20 : 5;

std::string input, which;

/// Keeps the input that ended the process, and says where.
void keep_input(const char* why)
{
    const std::string name =
        fmt::format("{}/sekitei_{}_{}", fs::temp_directory_path().string(), which, ::getpid());
    if (std::FILE* file = std::fopen(name.c_str(), "wb")) {
        std::fwrite(input.data(), 1, input.size(), file);
        std::fclose(file);
    }
    fmt::print(stderr, "{}: {}; the input is in {}\n", which, why, name);
}

void on_signal(int number)
{
    keep_input(number == SIGALRM ? "too slow" : "crashed");
    signal(number, SIG_DFL);
    raise(number);
}

/// Random numbers have an address: the number of the input and of the draw.
struct Dice {
    std::uint64_t key;
    std::uint32_t draw = 0;

    std::uint64_t below(std::uint64_t n) { return n == 0 ? 0 : hash2(key, draw++) % n; }
};

/// Numbers at which readers stumble, in the forms that files hold.
std::string extreme(Dice& dice)
{
    static constexpr std::uint64_t kBits[] = {0,
                                              1,
                                              0x7f,
                                              0x80,
                                              0xff,
                                              0x7fff,
                                              0xffff,
                                              0x7fffffff,
                                              0x80000000,
                                              0xffffffff,
                                              0x7fffffffffffffff,
                                              0x8000000000000000,
                                              0xffffffffffffffff,
                                              0x7ff0000000000000,  // infinity, as a double
                                              0x7ff8000000000000,  // not a number
                                              0x7f8000007f800000,
                                              0x7fc000007fc00000,
                                              0xff7fffffff7fffff};
    static constexpr const char* kTexts[] = {"0",
                                             "-1",
                                             "1e308",
                                             "-1e308",
                                             "1e-320",
                                             "nan",
                                             "inf",
                                             "-inf",
                                             "99999999999999999999",
                                             "-9223372036854775808",
                                             "4294967296",
                                             "2147483648",
                                             "1000000000000",
                                             "\"\"",
                                             "[]",
                                             "{}",
                                             "true",
                                             "null",
                                             "[[[[[[[[[[[[[[[[",
                                             "\\u0000",
                                             "\n",
                                             ",",
                                             "\"",
                                             ""};
    if (dice.below(2) == 0) return kTexts[dice.below(std::size(kTexts))];
    const std::uint64_t bits = kBits[dice.below(std::size(kBits))];
    std::string bytes(std::size_t(1) << dice.below(4), '\0');
    std::memcpy(bytes.data(), &bits, bytes.size());
    return bytes;
}

/// Where a number stands in text, from `from` on; the place itself where none follows.
std::pair<std::size_t, std::size_t> number_at(const std::string& text, std::size_t from)
{
    constexpr std::string_view kDigits = "0123456789.+-";
    const std::size_t begin = std::min(text.find_first_of("0123456789", from), text.size());
    if (begin == text.size()) return {from, 1};
    const std::size_t end = std::min(text.find_first_not_of(kDigits, begin), text.size());
    return {begin, end - begin};
}

std::string damaged(const std::vector<std::string>& good, std::uint64_t number)
{
    Dice dice{hash2(0x66757a7a, number)};
    std::string bytes = good[dice.below(good.size())];
    for (std::uint64_t times = 1 + dice.below(4); times > 0; --times) {
        const std::size_t at = dice.below(bytes.size() + 1);
        switch (dice.below(7)) {
            case 0:
                for (std::uint64_t k = 1 + dice.below(3); k > 0 && !bytes.empty(); --k) {
                    const std::size_t i = dice.below(bytes.size());
                    bytes[i] = static_cast<char>(bytes[i] ^ (1 << dice.below(8)));
                }
                break;
            case 1:
                bytes.resize(at);
                break;
            case 2: {  // a piece of another file, in place or between
                const std::string& other = good[dice.below(good.size())];
                const std::string piece =
                    other.substr(dice.below(other.size() + 1), dice.below(64));
                bytes.replace(at, dice.below(2) ? piece.size() : 0, piece);
                break;
            }
            case 3: {
                const std::string value = extreme(dice);
                const bool over = dice.below(2);
                bytes.replace(at, over ? value.size() : 0, value);
                break;
            }
            case 4: {
                const auto [begin, length] = number_at(bytes, at);
                if (begin < bytes.size()) bytes.replace(begin, length, extreme(dice));
                break;
            }
            case 5:
                bytes.erase(at, dice.below(16));
                break;
            default:  // the same again, as lines and records may come
                bytes.insert(at, bytes.substr(at, dice.below(200)));
        }
    }
    return bytes;
}

void limit_memory()
{
    if (kSanitized) return;  // they reserve terabytes
    double pages = 0;
    if (std::FILE* file = std::fopen("/proc/self/statm", "r")) {
        if (std::fscanf(file, "%lf", &pages) != 1) pages = 0;
        std::fclose(file);
    }
    const auto most = static_cast<rlim_t>(pages * double(sysconf(_SC_PAGESIZE)) + kMemory);
    const rlimit space{most, most};
    setrlimit(RLIMIT_AS, &space);
}

}  // namespace

int main(int argc, char** argv)
{
    const fuzz::Reader* reader = argc < 3 ? nullptr : fuzz::find_reader(argv[1]);
    if (!reader) {
        fmt::print(stderr, "usage: {} READER COUNT [CORPUS]\n", argv[0]);
        return 2;
    }
    which = argv[1];
    log::set_level(log::Level::Quiet);
    const ThreadLimit one(1);
    std::vector<std::string> good = reader->seeds();
    const std::size_t seeds = good.size();
    if (argc > 3 && fs::exists(argv[3])) {
        std::vector<fs::path> paths;
        for (const auto& entry : fs::directory_iterator(argv[3])) paths.push_back(entry.path());
        std::ranges::sort(paths);
        for (const fs::path& path : paths) good.push_back(read_file(path));
    }
    for (const int s : {SIGALRM, SIGABRT, SIGSEGV, SIGBUS, SIGFPE, SIGILL}) signal(s, on_signal);
    std::set_terminate([] {
        try {
            std::rethrow_exception(std::current_exception());
        } catch (const std::exception& error) {
            fmt::print(stderr, "not an Error: {}\n", error.what());
        }
        std::abort();
    });
    auto give = [&](std::string bytes) {
        input = std::move(bytes);
        alarm(kSeconds);
        reader->read(input);
        alarm(0);
    };
    for (const std::string& bytes : good) give(bytes);  // what they need once is not the input's
    limit_memory();
    for (const std::string& bytes : good) give(bytes);
    const std::uint64_t count = std::strtoull(argv[2], nullptr, 10);
    for (std::uint64_t i = 0; i < count; ++i) give(damaged(good, i));
    fmt::print("{}: {} good files, {} kept, {} damaged\n", which, seeds, good.size() - seeds,
               count);
    return 0;
}
