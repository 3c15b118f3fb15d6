#include "solvers/wind/grid_pressure.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/clones.h"
#include "core/parallel.h"

namespace sekitei::wind::grid {
namespace {

constexpr std::size_t kDirect = 120;  // largest coarsest level
// Roots of the Chebyshev polynomial of degree two over the upper three quarters of the spectrum.
constexpr float kFirst = 0.562f, kSecond = 1.389f;
constexpr int kLanes = 8;

/// b - A x of a row.
inline float residual(const float* tx, const float* ty, const float* tz, const float* d,
                      const float* b, const float* x, std::ptrdiff_t sx, std::ptrdiff_t sy,
                      std::ptrdiff_t k)
{
    return b[k] - (d[k] * x[k] - (tx[k] * x[k - sx] + tx[k + sx] * x[k + sx]) -
                   (ty[k] * x[k - sy] + ty[k + sy] * x[k + sy]) -
                   (tz[k] * x[k - 1] + tz[k + 1] * x[k + 1]));
}

SEKITEI_CLONES
void smooth_row(const float* tx, const float* ty, const float* tz, const float* d,
                const float* inverse, const float* b, const float* x, std::ptrdiff_t sx,
                std::ptrdiff_t sy, float weight, float* y, std::ptrdiff_t n)
{
    for (std::ptrdiff_t k = 0; k < n; ++k)
        y[k] = x[k] + weight * inverse[k] * residual(tx, ty, tz, d, b, x, sx, sy, k);
}

SEKITEI_CLONES
void residual_row(const float* tx, const float* ty, const float* tz, const float* d, const float* b,
                  const float* x, std::ptrdiff_t sx, std::ptrdiff_t sy, float* r, std::ptrdiff_t n)
{
    for (std::ptrdiff_t k = 0; k < n; ++k) r[k] = residual(tx, ty, tz, d, b, x, sx, sy, k);
}

SEKITEI_CLONES
void scale_row(const float* inverse, const float* b, float weight, float* x, std::ptrdiff_t n)
{
    for (std::ptrdiff_t k = 0; k < n; ++k) x[k] = weight * inverse[k] * b[k];
}

SEKITEI_CLONES
void apply_row(const float* tx, const float* ty, const float* tz, const float* d, const double* x,
               std::ptrdiff_t sx, std::ptrdiff_t sy, double* y, std::ptrdiff_t n)
{
    for (std::ptrdiff_t k = 0; k < n; ++k)
        y[k] = double(d[k]) * x[k] - (double(tx[k]) * x[k - sx] + double(tx[k + sx]) * x[k + sx]) -
               (double(ty[k]) * x[k - sy] + double(ty[k + sy]) * x[k + sy]) -
               (double(tz[k]) * x[k - 1] + double(tz[k + 1]) * x[k + 1]);
}

/// Sum of a[k] b[k], in lanes of a fixed number so that it does not depend on the processor.
template <class A, class B>
inline double dot_row(const A* a, const B* b, std::ptrdiff_t n)
{
    std::array<double, kLanes> sum{};
    std::ptrdiff_t k = 0;
    for (; k + kLanes <= n; k += kLanes)
        for (int l = 0; l < kLanes; ++l) sum[std::size_t(l)] += double(a[k + l]) * double(b[k + l]);
    for (; k < n; ++k) sum[0] += double(a[k]) * double(b[k]);
    return ((sum[0] + sum[1]) + (sum[2] + sum[3])) + ((sum[4] + sum[5]) + (sum[6] + sum[7]));
}

SEKITEI_CLONES
double dot_doubles(const double* a, const double* b, std::ptrdiff_t n)
{
    return dot_row(a, b, n);
}

SEKITEI_CLONES
double dot_mixed(const double* a, const float* b, std::ptrdiff_t n)
{
    return dot_row(a, b, n);
}

/// Moves x and r along p; the largest |r|.
SEKITEI_CLONES
double advance_row(double* x, double* r, const double* p, const double* q, double alpha,
                   std::ptrdiff_t n)
{
    std::array<double, kLanes> most{};
    std::ptrdiff_t k = 0;
    for (; k + kLanes <= n; k += kLanes)
        for (int l = 0; l < kLanes; ++l) {
            x[k + l] += alpha * p[k + l];
            r[k + l] -= alpha * q[k + l];
            const double size = std::abs(r[k + l]);
            most[std::size_t(l)] = size > most[std::size_t(l)] ? size : most[std::size_t(l)];
        }
    for (; k < n; ++k) {
        x[k] += alpha * p[k];
        r[k] -= alpha * q[k];
        most[0] = std::max(most[0], std::abs(r[k]));
    }
    return *std::max_element(most.begin(), most.end());
}

/// Calls f(first index) for each row along z of the box.
template <class F>
void for_rows(const Lattice& lattice, F&& f)
{
    const auto columns = std::size_t(lattice.n.y);
    const std::size_t rows = std::size_t(lattice.n.x) * columns;
    parallel_for_range(
        rows,
        [&](std::size_t begin, std::size_t end) {
            for (std::size_t row = begin; row < end; ++row)
                f(lattice.at(int(row / columns), int(row % columns), 0));
        },
        std::max<std::size_t>(16, 8192 / std::size_t(lattice.n.z)));
}

/// The same with a sum, or another fold, over slabs across the stream.
template <class F, class Join>
double fold_rows(const Lattice& lattice, F&& f, Join&& join)
{
    return parallel_fold(
        std::size_t(lattice.n.x), 2, 0.0,
        [&](std::size_t begin, std::size_t end) {
            double total = 0;
            for (std::size_t i = begin; i < end; ++i)
                for (int j = 0; j < lattice.n.y; ++j)
                    total = join(total, f(lattice.at(int(i), j, 0)));
            return total;
        },
        join);
}

double add(double a, double b)
{
    return a + b;
}

double larger(double a, double b)
{
    return std::max(a, b);
}

}  // namespace

PressureSolver::PressureSolver(Lattice lattice, const std::vector<std::uint8_t>& air)
{
    Level fine;
    fine.lattice = lattice;
    const std::size_t size = lattice.size(), sx = lattice.stride_x(), sy = lattice.stride_y();
    fine.tx.assign(size, 0), fine.ty.assign(size, 0), fine.tz.assign(size, 0);
    fine.diagonal.assign(size, 0);
    for (int i = 0; i < lattice.n.x; ++i)
        for (int j = 0; j < lattice.n.y; ++j)
            for (int k = 0; k < lattice.n.z; ++k) {
                const std::size_t c = lattice.at(i, j, k);
                if (!air[c]) continue;
                fine.tx[c] = i > 0 && air[c - sx];
                fine.ty[c] = j > 0 && air[c - sy];
                fine.tz[c] = k > 0 && air[c - 1];
                if (i == lattice.n.x - 1) fine.diagonal[c] = 2;
            }
    levels_.push_back(std::move(fine));
    const auto count = [&] {
        const Coord n = levels_.back().lattice.n;
        return std::size_t(n.x) * std::size_t(n.y) * std::size_t(n.z);
    };
    while (count() > kDirect) coarsen();
    for (Level& level : levels_) {
        const Lattice& l = level.lattice;
        const std::size_t dx = l.stride_x(), dy = l.stride_y();
        level.inverse.assign(l.size(), 0);
        level.x.assign(l.size(), 0), level.y.assign(l.size(), 0), level.b.assign(l.size(), 0);
        for_rows(l, [&](std::size_t row) {
            for (std::size_t c = row; c < row + std::size_t(l.n.z); ++c) {
                const float sum = (level.tx[c] + level.tx[c + dx]) +
                                  (level.ty[c] + level.ty[c + dy]) +
                                  (level.tz[c] + level.tz[c + 1]);
                level.diagonal[c] += sum;
                level.inverse[c] = level.diagonal[c] > 0 ? 1 / level.diagonal[c] : 0;
            }
        });
    }
    factorise();
    r_.assign(size, 0), p_.assign(size, 0), q_.assign(size, 0);
}

/// Joins cells by pairs along every axis that has more than one.
void PressureSolver::coarsen()
{
    const Level& fine = levels_.back();
    const Lattice& from = fine.lattice;
    Level coarse;
    Coord step;
    for (int axis = 0; axis < 3; ++axis) {
        step[axis] = from.n[axis] > 1 ? 2 : 1;
        coarse.lattice.n[axis] = (from.n[axis] + step[axis] - 1) / step[axis];
    }
    const Lattice& to = coarse.lattice;
    coarse.tx.assign(to.size(), 0), coarse.ty.assign(to.size(), 0), coarse.tz.assign(to.size(), 0);
    coarse.diagonal.assign(to.size(), 0);
    for (int i = 0; i < from.n.x; ++i)
        for (int j = 0; j < from.n.y; ++j)
            for (int k = 0; k < from.n.z; ++k) {
                const std::size_t f = from.at(i, j, k);
                const std::size_t c = to.at(i / step.x, j / step.y, k / step.z);
                if (i % step.x == 0) coarse.tx[c] += fine.tx[f] / float(step.x);
                if (j % step.y == 0) coarse.ty[c] += fine.ty[f] / float(step.y);
                if (k % step.z == 0) coarse.tz[c] += fine.tz[f] / float(step.z);
                coarse.diagonal[c] += fine.diagonal[f] / float(step.x);  // the open end
            }
    levels_.push_back(std::move(coarse));
}

void PressureSolver::factorise()
{
    const Level& level = levels_.back();
    const Lattice& l = level.lattice;
    std::vector<int> number(l.size(), -1);
    for (std::size_t c = 0; c < l.size(); ++c)
        if (level.diagonal[c] > 0) {
            number[c] = int(last_cells_.size());
            last_cells_.push_back(c);
        }
    const std::size_t n = last_cells_.size();
    factor_.assign(n * n, 0);
    const auto couple = [&](std::size_t row, std::size_t other, float t) {
        if (t > 0 && number[other] >= 0) factor_[row * n + std::size_t(number[other])] = -double(t);
    };
    for (std::size_t row = 0; row < n; ++row) {
        const std::size_t c = last_cells_[row];
        factor_[row * n + row] = double(level.diagonal[c]);
        couple(row, c - l.stride_x(), level.tx[c]);
        couple(row, c - l.stride_y(), level.ty[c]);
        couple(row, c - 1, level.tz[c]);
    }
    for (std::size_t i = 0; i < n; ++i)
        for (std::size_t j = 0; j <= i; ++j) {
            double sum = factor_[i * n + j];
            for (std::size_t k = 0; k < j; ++k) sum -= factor_[i * n + k] * factor_[j * n + k];
            factor_[i * n + j] = i == j ? std::sqrt(sum) : sum / factor_[j * n + j];
        }
}

void PressureSolver::solve_coarsest()
{
    Level& level = levels_.back();
    const std::size_t n = last_cells_.size();
    std::vector<double> y(n);
    for (std::size_t i = 0; i < n; ++i) {
        double sum = double(level.b[last_cells_[i]]);
        for (std::size_t k = 0; k < i; ++k) sum -= factor_[i * n + k] * y[k];
        y[i] = sum / factor_[i * n + i];
    }
    for (std::size_t i = n; i-- > 0;) {
        double sum = y[i];
        for (std::size_t k = i + 1; k < n; ++k) sum -= factor_[k * n + i] * y[k];
        y[i] = sum / factor_[i * n + i];
        level.x[last_cells_[i]] = float(y[i]);
    }
}

/// x of a level from its b.
void PressureSolver::cycle(std::size_t number)
{
    if (number + 1 == levels_.size()) {
        solve_coarsest();
        return;
    }
    Level& level = levels_[number];
    Level& coarse = levels_[number + 1];
    const Lattice& l = level.lattice;
    const auto sx = std::ptrdiff_t(l.stride_x()), sy = std::ptrdiff_t(l.stride_y());
    const std::ptrdiff_t n = l.n.z;
    const auto smooth = [&](float weight) {
        for_rows(l, [&](std::size_t c) {
            smooth_row(&level.tx[c], &level.ty[c], &level.tz[c], &level.diagonal[c],
                       &level.inverse[c], &level.b[c], &level.x[c], sx, sy, weight, &level.y[c], n);
        });
        level.x.swap(level.y);
    };
    for_rows(l, [&](std::size_t c) {
        scale_row(&level.inverse[c], &level.b[c], kFirst, &level.x[c], n);
    });
    smooth(kSecond);
    for_rows(l, [&](std::size_t c) {
        residual_row(&level.tx[c], &level.ty[c], &level.tz[c], &level.diagonal[c], &level.b[c],
                     &level.x[c], sx, sy, &level.y[c], n);
    });

    // Sum what is left over the joined cells, solve there, and add to each its cell's answer.
    const Lattice& to = coarse.lattice;
    const int step_x = l.n.x > 1 ? 2 : 1, step_y = l.n.y > 1 ? 2 : 1, step_z = l.n.z > 1 ? 2 : 1;
    parallel_for(
        std::size_t(to.n.x),
        [&](std::size_t i) {
            for (int j = 0; j < to.n.y; ++j) {
                float* b = &coarse.b[to.at(int(i), j, 0)];
                std::fill_n(b, to.n.z, 0.0f);
                for (int di = 0; di < step_x; ++di)
                    for (int dj = 0; dj < step_y; ++dj) {
                        // An odd end has no second cell; the margin holds 0 there.
                        const float* y = &level.y[l.at(int(i) * step_x + di, j * step_y + dj, 0)];
                        for (int k = 0; k < to.n.z; ++k)
                            b[k] += step_z == 2 ? y[2 * k] + y[2 * k + 1] : y[k];
                    }
            }
        },
        4);
    cycle(number + 1);
    for_rows(l, [&](std::size_t row) {
        const std::size_t from_corner = row - l.at(0, 0, 0);
        const int i = int(from_corner / std::size_t(sx));
        const int j = int(from_corner % std::size_t(sx) / std::size_t(sy));
        const float* x = &coarse.x[to.at(i / step_x, j / step_y, 0)];
        for (std::ptrdiff_t k = 0; k < n; ++k)
            if (level.inverse[row + std::size_t(k)] > 0)
                level.x[row + std::size_t(k)] += x[k / step_z];
    });
    smooth(kSecond);
    smooth(kFirst);
}

Convergence PressureSolver::solve(const std::vector<double>& b, double tolerance,
                                  int most_iterations, std::vector<double>& x)
{
    Level& fine = levels_[0];
    const Lattice& l = fine.lattice;
    const auto sx = std::ptrdiff_t(l.stride_x()), sy = std::ptrdiff_t(l.stride_y());
    const std::ptrdiff_t n = l.n.z;
    const auto apply = [&](std::size_t c, const std::vector<double>& from) {
        apply_row(&fine.tx[c], &fine.ty[c], &fine.tz[c], &fine.diagonal[c], &from[c], sx, sy,
                  &q_[c], n);
    };
    const auto precondition = [&] {
        for_rows(l, [&](std::size_t c) {
            for (std::size_t k = c; k < c + std::size_t(n); ++k) fine.b[k] = float(r_[k]);
        });
        cycle(0);
        return fold_rows(
            l, [&](std::size_t c) { return dot_mixed(&r_[c], &fine.x[c], n); }, add);
    };

    Convergence report;
    report.residual = fold_rows(
        l,
        [&](std::size_t c) {
            apply(c, x);
            double most = 0;
            for (std::size_t k = c; k < c + std::size_t(n); ++k) {
                r_[k] = b[k] - q_[k];
                most = std::max(most, std::abs(r_[k]));
            }
            return most;
        },
        larger);
    double last = 0;
    while (report.residual > tolerance && report.iterations < most_iterations) {
        const double rz = precondition();
        const double beta = report.iterations == 0 ? 0 : rz / last;
        last = rz;
        for_rows(l, [&](std::size_t c) {
            for (std::size_t k = c; k < c + std::size_t(n); ++k)
                p_[k] = double(fine.x[k]) + beta * p_[k];
        });
        const double curvature = fold_rows(
            l,
            [&](std::size_t c) {
                apply(c, p_);
                return dot_doubles(&p_[c], &q_[c], n);
            },
            add);
        const double alpha = rz / curvature;
        report.residual = fold_rows(
            l, [&](std::size_t c) { return advance_row(&x[c], &r_[c], &p_[c], &q_[c], alpha, n); },
            larger);
        ++report.iterations;
    }
    // Not a number compares as false: only what is small has converged.
    report.converged = report.residual <= tolerance;
    return report;
}

}  // namespace sekitei::wind::grid
