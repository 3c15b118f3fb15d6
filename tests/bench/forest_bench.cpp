// Forests: seconds a step, trees x steps a second, columns against the painter, threads against
// one. forest_bench [size in m, 512] [steps, 50] [painter's size, 256]
#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>
#include <vector>

#include "core/hash.h"
#include "core/parallel.h"
#include "solvers/forest/forest.h"
#include "tests/bench/measure.h"

using namespace sekitei;

namespace {

forest::Inputs inputs_of(double size)
{
    forest::Inputs inputs;
    inputs.width = inputs.depth = size;
    inputs.species = forest::table_species();
    return inputs;
}

struct Run {
    double seconds = 0, draw = 0, grow = 0;  ///< of the median of the last ten steps
    std::uint64_t trees = 0;
    std::uint64_t hash = 0;
    std::size_t bytes = 0;
};

Run run(forest::Inputs inputs, int steps, std::size_t threads)
{
    const ThreadLimit limit(threads);
    const double area = inputs.width * inputs.depth / (512.0 * 512.0);
    forest::Forest forest(std::move(inputs));
    forest.sow(std::vector<std::uint64_t>(6, std::uint64_t(1000 * area)));
    std::vector<std::pair<double, double>> seconds;
    Run result;
    for (int n = 0; n < steps; ++n) {
        const forest::StepStatistics row = forest.advance();
        seconds.emplace_back(row.seconds_draw + row.seconds_grow, row.seconds_draw);
        result.trees = row.trees;
    }
    std::vector<std::pair<double, double>> last(seconds.end() - std::min(10, steps), seconds.end());
    std::ranges::sort(last);
    std::tie(result.seconds, result.draw) = last[last.size() / 2];
    result.grow = result.seconds - result.draw;
    const auto trees = forest.trees();
    result.hash = hash64(trees.data(), trees.size() * sizeof(trees[0]));
    result.bytes = forest.memory_bytes();
    return result;
}

}  // namespace

int main(int count, char** words)
{
    const double size = count > 1 ? std::atof(words[1]) : 512;
    const int steps = count > 2 ? std::atoi(words[2]) : 50;
    const double painted = count > 3 ? std::atof(words[3]) : 256;
    fmt::print("case, trees, threads, seconds a step, draw, grow, trees*steps/s, MB, hash\n");
    auto tell = [](const char* name, std::size_t threads, const Run& r) {
        fmt::print("{}, {}, {}, {:.4f}, {:.4f}, {:.4f}, {:.3g}, {:.1f}, {:016x}\n", name, r.trees,
                   threads, r.seconds, r.draw, r.grow, double(r.trees) / r.seconds,
                   double(r.bytes) / 1e6, r.hash);
    };
    if (size > 0) {
        const Run one = run(inputs_of(size), steps, 1), two = run(inputs_of(size), steps, 2);
        tell("columns", 1, one);
        tell("columns", 2, two);
        fmt::print("two threads {:.2f} x, hashes {}\n", one.seconds / two.seconds,
                   one.hash == two.hash ? "equal" : "DIFFER");
    }
    if (painted > 0) {
        forest::Inputs inputs = inputs_of(painted);
        const Run columns = run(inputs, 20, 1);
        inputs.params.method = forest::Method::Painter;
        const Run painter = run(inputs, 20, 1);
        tell("columns", 1, columns);
        tell("painter", 1, painter);
        fmt::print("columns {:.1f} x painter, hashes {}\n", painter.seconds / columns.seconds,
                   painter.hash == columns.hash ? "equal" : "DIFFER");
    }
}
