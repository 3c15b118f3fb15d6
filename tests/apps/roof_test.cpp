// The experiments under a roof [Nomura2010, section 4] as the recipe that we ship runs them, with
// three seeds.

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <map>
#include <sstream>

#include "apps/recipe.h"
#include "apps/runner.h"
#include "core/file_output.h"
#include "core/log.h"
#include "tests/support/temporary_folder.h"

namespace sekitei::apps {
namespace {

constexpr double kAny = std::numeric_limits<double>::infinity();

/// What the means of three seeds must hold: of the value, or of value / first.
struct Bound {
    const char *measure, *scene;
    bool ratio;
    double lower, upper;
};
const Bound kBounds[] = {
    {"living in the shelter, last day", "R1", false, 100, kAny},
    // One or two may stand in the very edge of the roof's shadow.
    {"living in the open after day 100, for 1000 in the shelter", "R1", false, 0, 1},
    {"living in the shelter, with / without indirect light", "R1/R2", true, 10, kAny},
    {"growth in the shelter without gate, with / without indirect light", "R3", true, 1.05, kAny},
    {"underside, day 100, 288.15 K / 293.15 K", "R4 bryum", true, 1.1, kAny},
    {"underside, day 100, 288.15 K / 293.15 K", "R4 hypnum", true, 1.1, kAny},
    {"underside, day 100, 288.15 K / 293.15 K", "R4 polytrichum", true, 1.1, kAny},
    // By day 60 the mosses of R5 stand at the cap, by day 100 those of R1 too.
    {"living in the shelter, day 40, with sky / without", "R5/R1", true, 1, kAny},
    {"water of half the back floor, sheltered", "R6", false, 0, 1e-3},
    {"water of half the front floor", "R6", false, 0.4, 0.49},
    {"living on the back floor, day 100, sheltered / rained on", "R6/R6_wet", true, 0, 0.5},
    {"living in the shelter, 8192 / 262144 photons", "R7/R1", true, 1.0 / 3, 3},
    {"noise of S on the front floor, 8192 photons", "R7", false, 0.20, 0.27}};

/// A line of comma-separated values, some in quotes.
std::vector<std::string> cells(const std::string& line)
{
    std::vector<std::string> list(1);
    bool quoted = false;
    for (const char c : line) {
        if (c == '"')
            quoted = !quoted;
        else if (c == ',' && !quoted)
            list.emplace_back();
        else
            list.back() += c;
    }
    return list;
}

struct Sum {
    double value = 0, first = 0;
};

TEST(RoofExperiments, MeansOfThreeSeedsAreWithinTheirBounds)
{
    log::set_level(log::Level::Quiet);
    std::map<std::pair<std::string, std::string>, Sum> sums;
    for (const int seed : {1, 2, 3}) {
        const TemporaryFolder folder;
        run_recipe(read_recipe(SEKITEI_DATA "/recipes/roof2x2-table.toml",
                               {"out=" + (folder / "out").string(), fmt::format("seed={}", seed)}),
                   {});
        std::istringstream table(read_file(folder / "out" / "table.csv"));
        std::string line;
        std::getline(table, line);
        while (std::getline(table, line)) {
            const std::vector<std::string> row = cells(line);
            ASSERT_GE(row.size(), 4u) << line;
            std::printf("    seed %d: %s\n", seed, line.c_str());
            std::fflush(stdout);
            Sum& sum = sums[{row[0], row[1]}];
            sum.value += std::stod(row[2]) / 3;
            sum.first += std::stod(row[3]) / 3;
        }
    }
    for (const Bound& bound : kBounds) {
        SCOPED_TRACE(fmt::format("{}, {}", bound.measure, bound.scene));
        const auto found = sums.find({bound.measure, bound.scene});
        ASSERT_NE(found, sums.end());
        const auto& [value, first] = found->second;
        const double held = bound.ratio ? value / first : value;
        std::printf("    %s, %s: %g\n", bound.scene, bound.measure, held);
        EXPECT_GE(held, bound.lower);
        EXPECT_LE(held, bound.upper);
    }
}

}  // namespace
}  // namespace sekitei::apps
