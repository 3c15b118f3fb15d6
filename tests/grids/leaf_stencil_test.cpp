#include "grids/leaf_stencil.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <functional>
#include <numbers>

#include "core/error.h"
#include "core/random.h"

namespace sekitei {
namespace {

using std::numbers::pi;

double noise(Coord c)
{
    constexpr Stream kNoise{"leaf_stencil_test"};
    return uniform01(3, kNoise, std::uint64_t(c.x * 73856093 ^ c.y * 19349663 ^ c.z * 83492791));
}

/// A problem on all leaves of the box but those that `absent` names; T and freedom by voxel.
HeatProblem problem_of(Coord dims, const std::function<double(Coord)>& temperature,
                       const std::function<bool(Coord)>& free, double alpha = 0.1,
                       const std::function<bool(Coord)>& absent = {})
{
    HeatProblem problem;
    problem.domain = {dims, {{1, 2, 3}, 0.25}};
    std::vector<Coord> origins;
    const TopologyPtr box = box_topology({0, 0, 0}, dims);
    for (const Coord& o : box->origins())
        if (!absent || !absent(o)) origins.push_back(o);
    auto grid = LeafGrid<double>::uninitialised(LeafTopology::build(origins),
                                                problem.domain.transform, 250.0);
    problem.free.resize(grid.leaf_count());
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        for (int i = 0; i < kLeafSize; ++i) {
            const Coord c = leaf_coord(grid.origin(leaf), i);
            grid.values(leaf)[i] = problem.domain.contains(c) ? temperature(c) : -1;
            if (free(c)) problem.free[leaf].set(i);
        }
    grid.compress();
    problem.temperature = std::move(grid);
    problem.alpha = alpha;
    return problem;
}

/// A ragged body between a held top and a held ball, some leaves missing, part of it in air.
HeatProblem ragged(Coord dims, bool convective = true)
{
    auto held = [=](Coord c) {
        return c.z > dims.z - 4 || length(Vec3d(c) - Vec3d(9, 12, 3)) < 4 || noise(c) < 0.02;
    };
    HeatProblem problem = problem_of(
        dims, [=](Coord c) { return held(c) ? 300.0 + c.x : 1000 + 500 * noise(c); },
        [=](Coord c) { return !held(c); }, 0.13,
        [](Coord o) { return o == Coord(8, 0, 0) || o == Coord(16, 24, 8); });
    if (convective) {
        problem.convection = {{}, 290, 0.3};
        for (std::uint32_t leaf = 0; leaf < problem.free.size(); leaf += 3)
            problem.free[leaf].for_each([&](int i) {
                const Coord c = leaf_coord(problem.temperature.origin(leaf), i);
                if (problem.domain.contains(c) && noise(c * 3) < 0.05)
                    problem.convection.voxels.push_back({leaf, static_cast<std::uint16_t>(i),
                                                         static_cast<std::uint16_t>(1 + i % 4)});
            });
    }
    return problem;
}

/// The same step, voxel by voxel with a look-up for each neighbour.
LeafGrid<double> brute_force(const HeatProblem& problem, int steps)
{
    LeafGrid<double> now = problem.temperature;
    now.expand();
    for (int s = 0; s < steps; ++s) {
        LeafGrid<double> next = now;
        for (std::size_t leaf = 0; leaf < now.leaf_count(); ++leaf)
            problem.free[leaf].for_each([&](int i) {
                const Coord c = leaf_coord(now.origin(leaf), i);
                if (!problem.domain.contains(c)) return;
                const double t = now.value(c);
                double flow = 0;
                for (int axis = 0; axis < 3; ++axis)
                    for (int sign = -1; sign <= 1; sign += 2) {
                        Coord n = c;
                        n[axis] += sign;
                        if (problem.domain.contains(n)) flow += now.value(n) - t;
                    }
                for (const auto& v : problem.convection.voxels)
                    if (v.leaf == leaf && v.offset == i)
                        flow += v.faces * (problem.convection.conductance - 1) *
                                (problem.convection.air_temperature - t);
                next.values(leaf)[i] = t + problem.alpha * flow;
            });
        now = next;
    }
    return now;
}

using Make = std::unique_ptr<HeatSolver> (*)(const HeatProblem&);
constexpr Make kSolvers[] = {dense_heat_solver, sparse_heat_solver};

TEST(HeatSolver, AgreesWithALookUpForEachNeighbour)
{
    const HeatProblem problem = ragged({21, 34, 19});
    const LeafGrid<double> expected = brute_force(problem, 7);
    for (const Make make : kSolvers) {
        const auto solver = make(problem);
        solver->advance(6, {});
        solver->step({});
        const LeafGrid<double> found = with_free_values(problem, solver->free_values());
        for (std::size_t leaf = 0; leaf < found.leaf_count(); ++leaf)
            for (int i = 0; i < kLeafSize; ++i)
                ASSERT_NEAR(found.at(leaf, i), expected.at(leaf, i), 1e-9);
    }
}

TEST(HeatSolver, GivesTheSameBitsDenseAndSparseAndOnAnyNumberOfThreads)
{
    for (const Coord dims :
         {Coord(21, 34, 19), Coord(48, 17, 25), Coord(3, 40, 1), Coord(1, 1, 9)}) {
        const HeatProblem problem = ragged(dims);
        const auto dense = dense_heat_solver(problem);
        dense->advance(32, {});
        const double change = dense->step({});
        for (const std::size_t threads : {1u, 2u, 5u}) {
            const ThreadLimit limit(threads);
            const auto sparse = sparse_heat_solver(problem);
            sparse->advance(13, {});
            sparse->advance(1, {});
            sparse->advance(18, {});
            EXPECT_EQ(sparse->step({}), change);
            EXPECT_EQ(sparse->steps(), 33);
            ASSERT_EQ(sparse->free_values(), dense->free_values()) << dims.x << " " << threads;
        }
    }
}

// 300 leaves long, so that several slabs take several steps in one sweep; one end is cold and the
// front wakes one leaf after the other.
TEST(HeatSolver, WakesUniformLeavesInTimeForTheFront)
{
    const Coord dims(600, 40, 20);
    const HeatProblem problem = problem_of(
        dims, [](Coord c) { return c.x < 3 || c.x > 590 ? 200.0 : 2000.0; },
        [](Coord c) { return c.x >= 3 && c.x <= 590; }, 1.0 / 6);
    const auto dense = dense_heat_solver(problem), sparse = sparse_heat_solver(problem);
    for (const int steps : {1, 2, 3, 5, 8, 21, 20}) {
        dense->advance(steps, {});
        sparse->advance(steps, {});
        ASSERT_EQ(sparse->free_values(), dense->free_values()) << dense->steps();
    }
    EXPECT_EQ(sparse->step({}), dense->step({}));
    EXPECT_LT(sparse->free_values()[100], 2000);
}

// Oracle: the eigenfunction of the discrete Laplacian with mirrored borders.
TEST(HeatSolver, DecaysAModeByItsDiscreteFactor)
{
    auto mode = [](Coord c) {
        return 1000 + 100 * std::cos(pi * (c.x + 0.5) / 32) * std::cos(2 * pi * (c.y + 0.5) / 32);
    };
    const double factor = 1 - 0.1 * (4 - 2 * std::cos(pi / 32) - 2 * std::cos(2 * pi / 32));
    EXPECT_NEAR(factor, 0.995194001, 1e-9);
    const HeatProblem problem = problem_of({32, 32, 32}, mode, [](Coord) { return true; });
    for (const Make make : kSolvers) {
        const auto solver = make(problem);
        solver->advance(100, {});
        const LeafGrid<double> end = with_free_values(problem, solver->free_values());
        EXPECT_NEAR(end.value({3, 7, 20}), 1005.700562, 1e-5);
        EXPECT_NEAR(end.value({30, 1, 5}), 1000 + (mode({30, 1, 5}) - 1000) * std::pow(factor, 100),
                    1e-8);
        double sum = 0;
        for (const double t : solver->free_values()) sum += t;
        EXPECT_NEAR(sum / (32 * 32 * 32), 1000, 1e-9);
    }
}

TEST(HeatSolver, GrowsTheHighestModeBeyondTheStableLimit)
{
    auto mode = [](Coord c) {
        return 1000 + std::cos(31 * pi * (c.x + 0.5) / 32) * std::cos(31 * pi * (c.y + 0.5) / 32) *
                          std::cos(31 * pi * (c.z + 0.5) / 32);
    };
    const HeatProblem problem = problem_of(
        {32, 32, 32}, mode, [](Coord) { return true; }, 0.17);
    for (const Make make : kSolvers) {
        const auto solver = make(problem);
        solver->advance(100, {});
        const LeafGrid<double> end = with_free_values(problem, solver->free_values());
        EXPECT_NEAR((end.value({5, 6, 7}) - 1000) / (mode({5, 6, 7}) - 1000), 31.459, 1e-3);
    }
}

TEST(HeatSolver, KeepsTheHeatOfAClosedBoxOfAnySize)
{
    const Coord dims(19, 11, 26);
    const HeatProblem problem = problem_of(
        dims, [](Coord c) { return 900 * noise(c); }, [](Coord) { return true; }, 0.15);
    for (const Make make : kSolvers) {
        const auto solver = make(problem);
        double before = 0, after = 0;
        for (const double t : solver->free_values()) before += t;
        solver->advance(200, {});
        for (const double t : solver->free_values()) after += t;
        EXPECT_NEAR(after / before, 1, 1e-13);
    }
}

TEST(HeatSolver, NeverLeavesTheRangeOfItsStartAtTheStableLimit)
{
    HeatProblem problem = ragged({24, 17, 30}, false);
    problem.alpha = 1.0 / 6;
    const auto solver = sparse_heat_solver(problem);
    solver->advance(50, {});
    for (const double t : solver->free_values()) {
        ASSERT_GE(t, 250);
        ASSERT_LE(t, 1500);
    }
}

TEST(HeatSolver, ContinuesFromItsValuesWithTheSameBits)
{
    const HeatProblem problem = ragged({40, 33, 18});
    for (const Make make : kSolvers) {
        const auto whole = make(problem), first = make(problem), second = make(problem);
        whole->advance(29, {});
        first->advance(11, {});
        second->advance(3, {});  // what it did before must not matter
        second->set_free_values(first->free_values());
        second->advance(18, {});
        EXPECT_EQ(second->free_values(), whole->free_values());
    }
}

TEST(HeatSolver, StopsWhenAskedAndKeepsItsLastWholeStep)
{
    const HeatProblem problem = ragged({40, 33, 18});
    for (const Make make : kSolvers) {
        std::atomic<bool> cancel{false};
        const Progress progress({}, &cancel);
        const auto solver = make(problem);
        solver->advance(4, progress);
        const std::vector<double> values = solver->free_values();
        cancel = true;
        EXPECT_THROW(solver->advance(5, progress), Cancelled);
        EXPECT_THROW(solver->step(progress), Cancelled);
        EXPECT_EQ(solver->steps(), 4);
        EXPECT_EQ(solver->free_values(), values);
    }
}

LeafGrid<double> grid_of(const Domain& domain, const std::function<double(Coord)>& value)
{
    auto grid =
        LeafGrid<double>::uninitialised(box_topology({0, 0, 0}, domain.dims), domain.transform, 0);
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        for (int i = 0; i < kLeafSize; ++i)
            grid.values(leaf)[i] = value(leaf_coord(grid.origin(leaf), i));
    return grid;
}

IntGrid everywhere(const Domain& domain)
{
    IntGrid grid(box_topology({0, 0, 0}, domain.dims), domain.transform, 0);
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        grid.mask(leaf) = domain_mask(domain, grid.origin(leaf));
    return grid;
}

void expect_near(Vec3d found, Vec3d expected)
{
    EXPECT_LT(length(found - expected), 1e-12)
        << found.x << " " << found.y << " " << found.z << " at " << expected.x;
}

TEST(Sobel, IsExactForLinearFieldsAndHalvesTheNormalPartAtTheBorder)
{
    const Domain domain{{12, 12, 12}, {{-3, 5, 1}, 0.5}};
    const auto gradient =
        sobel_gradient(grid_of(domain, [](Coord c) { return 2.0 * c.x - 3.0 * c.y + 0.5 * c.z; }),
                       everywhere(domain), domain);
    for (int x = 1; x < 11; ++x)
        for (int y = 1; y < 11; ++y)
            for (int z = 1; z < 11; ++z) expect_near(gradient.value({x, y, z}), {2, -3, 0.5});
    expect_near(gradient.value({0, 0, 0}), {1, -1.5, 0.25});
    expect_near(gradient.value({11, 11, 11}), {1, -1.5, 0.25});
    expect_near(gradient.value({0, 5, 5}), {1, -3, 0.5});
    expect_near(gradient.value({5, 11, 5}), {2, -1.5, 0.5});
}

TEST(Sobel, FollowsAQuadraticField)
{
    const Domain domain{{12, 12, 12}, {}};
    const auto gradient = sobel_gradient(
        grid_of(domain, [](Coord c) { return 0.3 * c.x * c.x - c.y * c.z + 2.0 * c.z; }),
        everywhere(domain), domain);
    const Vec3d g = gradient.value({4, 6, 3});
    expect_near(g, {2.4, -3, -4});
    EXPECT_LT(length(normalized(g) - Vec3d(0.432731, -0.540914, -0.721218)), 1e-6);
}

TEST(Sobel, AgreesWithTheKernelWrittenOutWithLeavesMissing)
{
    const Domain domain{{21, 13, 30}, {}};
    LeafGrid<double> full = grid_of(domain, noise);
    LeafGrid<double> grid(LeafTopology::build({{0, 0, 0}, {8, 0, 8}, {16, 8, 24}, {8, 8, 8}}), {},
                          0.5);
    grid.expand();
    for (std::size_t leaf = 0; leaf < grid.leaf_count(); ++leaf)
        for (int i = 0; i < kLeafSize; ++i)
            grid.values(leaf)[i] = full.value(leaf_coord(grid.origin(leaf), i));
    grid.set_constant(2, 7.5);
    IntGrid where = everywhere(domain);
    for (std::size_t leaf = 0; leaf < where.leaf_count(); ++leaf)
        for (auto& word : where.mask(leaf).words) word &= 0xF7FFFFFFFFFEFFFFu;
    const auto gradient = sobel_gradient(grid, where, domain);
    auto clamped = [&](Coord c) {
        return grid.value(max(Coord(0, 0, 0), min(c, domain.dims - Coord(1, 1, 1))));
    };
    for (std::size_t leaf = 0; leaf < where.leaf_count(); ++leaf) {
        ASSERT_EQ(gradient.mask(leaf), where.mask(leaf));
        for (int i = 0; i < kLeafSize; ++i) {
            Vec3d expected;
            if (where.mask(leaf).test(i))
                for (int dx = -1; dx <= 1; ++dx)
                    for (int dy = -1; dy <= 1; ++dy)
                        for (int dz = -1; dz <= 1; ++dz)
                            expected +=
                                Vec3d(dx * (2 - std::abs(dy)) * (2 - std::abs(dz)),
                                      dy * (2 - std::abs(dx)) * (2 - std::abs(dz)),
                                      dz * (2 - std::abs(dx)) * (2 - std::abs(dy))) *
                                (clamped(leaf_coord(where.origin(leaf), i) + Coord(dx, dy, dz)) /
                                 32);
            ASSERT_LT(length(gradient.at(leaf, i) - expected), 1e-13);
        }
    }
}

TEST(Masks, ShiftAndDilateAcrossLeaves)
{
    const Domain domain{{24, 16, 20}, {}};
    const auto topology = box_topology({0, 0, 0}, domain.dims);
    std::vector<LeafMask> masks(topology->size());
    auto set = [](Coord c) { return noise(c) < 0.03; };
    for (std::size_t leaf = 0; leaf < masks.size(); ++leaf)
        for (int i = 0; i < kLeafSize; ++i)
            if (set(leaf_coord(topology->origin(leaf), i))) masks[leaf].set(i);
    auto inside = [&](Coord c) { return topology->find(leaf_origin(c)) != kNoLeaf && set(c); };
    const auto grown = dilated_masks(*topology, masks);
    for (std::size_t leaf = 0; leaf < masks.size(); ++leaf)
        for (int i = 0; i < kLeafSize; ++i) {
            const Coord c = leaf_coord(topology->origin(leaf), i);
            bool near = false;
            for (int n = 0; n < 27; ++n)
                near = near || inside(c + Coord(n / 9 - 1, n / 3 % 3 - 1, n % 3 - 1));
            ASSERT_EQ(grown[leaf].test(i), near);
        }
    for (int axis = 0; axis < 3; ++axis)
        for (const int sign : {-1, 1}) {
            const auto shifted = shifted_masks(*topology, masks, axis, sign);
            for (std::size_t leaf = 0; leaf < masks.size(); ++leaf)
                for (int i = 0; i < kLeafSize; ++i) {
                    Coord c = leaf_coord(topology->origin(leaf), i);
                    c[axis] += sign;
                    ASSERT_EQ(shifted[leaf].test(i), inside(c)) << axis << " " << sign;
                }
        }
}

}  // namespace
}  // namespace sekitei
