#include "core/parallel.h"

#include <gtest/gtest.h>

#include <atomic>
#include <cmath>

#include "core/error.h"
#include "core/hash.h"
#include "core/progress.h"
#include "core/random.h"

namespace sekitei {
namespace {

constexpr Stream kTerms{"test.terms"};

/// Terms of very different size, whose sum depends on the order.
double term(std::size_t i)
{
    return (uniform01(1, kTerms, i) - 0.5) * std::ldexp(1.0, static_cast<int>(i % 60));
}

TEST(Parallel, SumsAreTheSameOnAnyNumberOfThreads)
{
    for (const std::size_t count : {0u, 1u, 1023u, 1024u, 1025u, 100003u}) {
        std::vector<double> sums;
        for (const std::size_t threads : {1u, 2u, 7u}) {
            const ThreadLimit limit(threads);
            sums.push_back(parallel_sum(count, term));
        }
        EXPECT_EQ(sums[0], sums[1]);
        EXPECT_EQ(sums[0], sums[2]);
    }
}

TEST(Parallel, FoldsJoinChunksInTheirOrder)
{
    const auto text = parallel_fold(
        23, 4, std::string(),
        [](std::size_t begin, std::size_t end) {
            std::string out;
            for (std::size_t i = begin; i != end; ++i) out += static_cast<char>('a' + i);
            return out + "|";
        },
        [](const std::string& a, const std::string& b) { return a + b; });
    EXPECT_EQ(text, "abcd|efgh|ijkl|mnop|qrst|uvw|");
}

TEST(Parallel, LoopsVisitEveryIndexOnce)
{
    for (const std::size_t threads : {1u, 2u, 7u}) {
        const ThreadLimit limit(threads);
        EXPECT_EQ(thread_count(), threads);
        std::vector<int> visits(10007, 0);
        parallel_for(visits.size(), [&](std::size_t i) { ++visits[i]; });
        parallel_for_range(
            visits.size(),
            [&](std::size_t begin, std::size_t end) {
                for (std::size_t i = begin; i != end; ++i) ++visits[i];
            },
            64);
        EXPECT_EQ(std::count(visits.begin(), visits.end(), 2), 10007);
    }
}

TEST(Parallel, ErrorsOfTasksReachTheCaller)
{
    EXPECT_THROW(parallel_for(1000,
                              [](std::size_t i) {
                                  if (i == 777) throw InvalidInput("777");
                              }),
                 InvalidInput);
}

TEST(Parallel, PrefixSumEndsWithTheTotal)
{
    EXPECT_EQ(prefix_sum(std::vector<int>{3, 0, 4}), (std::vector<int>{0, 3, 3, 7}));
    EXPECT_EQ(prefix_sum(std::vector<int>{}), std::vector<int>{0});
}

TEST(Progress, SlicesMapTheirPartOntoTheWhole)
{
    std::vector<std::pair<std::string, double>> heard;
    const Progress whole(
        [&](const std::string& stage, double fraction) { heard.emplace_back(stage, fraction); },
        nullptr);
    whole.named("cool").slice(0.5, 0.9).slice(0.5, 1).update(0.5);
    whole.update(1);
    ASSERT_EQ(heard.size(), 2u);
    EXPECT_EQ(heard[0].first, "cool");
    EXPECT_DOUBLE_EQ(heard[0].second, 0.8);
    EXPECT_EQ(heard[1], (std::pair<std::string, double>{"", 1.0}));
}

TEST(Progress, StopsEverySliceOnceAsked)
{
    std::atomic<bool> cancel = false;
    int heard = 0;
    const Progress progress([&](const std::string&, double) { ++heard; }, &cancel);
    const Progress part = progress.slice(0.2, 0.4);
    EXPECT_NO_THROW(part.update(0.1));
    EXPECT_NO_THROW(part.check());
    cancel = true;
    EXPECT_TRUE(part.cancelled());
    EXPECT_THROW(part.update(0.2), Cancelled);
    EXPECT_THROW(part.check(), Cancelled);
    EXPECT_EQ(heard, 1);
    EXPECT_THROW(parallel_for(100, [&](std::size_t) { part.check(); }), Cancelled);
}

TEST(Progress, ReportsToNobodyByDefault)
{
    EXPECT_NO_THROW(Progress().update(0.5));
    EXPECT_FALSE(Progress().cancelled());
}

TEST(Hash, AgreesWithThePublishedValuesOfXxh3)
{
    // xxHash 0.8: XXH3 of the empty input with seed 0
    EXPECT_EQ(hash64("", 0), 0x2D06800538D394C2u);
    EXPECT_EQ(hash_hex(""), "99aa06d3014798d86001c324468d497f");
}

TEST(Hash, StreamsMindWhereOneTextEndsAndTheNextBegins)
{
    auto of = [](auto... parts) {
        Hasher hasher;
        (hasher.add(std::string_view(parts)), ...);
        return hasher.hex();
    };
    EXPECT_EQ(of("ab", "c"), of("ab", "c"));
    EXPECT_NE(of("ab", "c"), of("a", "bc"));
    EXPECT_EQ(of("ab").size(), 32u);
}

TEST(Hash, BytesMayComeInAnyPieces)
{
    std::string bytes;
    for (int i = 0; i < 5000; ++i) bytes += static_cast<char>(i * 7 % 251);
    Hasher pieces;
    for (std::size_t at = 0, step = 1; at < bytes.size(); at += step, step = step % 97 + 3)
        pieces.add(bytes.data() + at, std::min(step, bytes.size() - at));
    EXPECT_EQ(pieces.hex(), hash_hex(bytes));
    bytes[4321] = static_cast<char>(bytes[4321] ^ 1);
    EXPECT_NE(pieces.hex(), hash_hex(bytes));
}

}  // namespace
}  // namespace sekitei
