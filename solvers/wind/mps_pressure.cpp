#include "solvers/wind/mps_pressure.h"

#include <algorithm>
#include <cmath>

#include "core/parallel.h"

namespace sekitei::wind::mps {
namespace {

constexpr std::size_t kChunk = 1024;

/// Row i of A x; four partial sums, since one chain of additions would wait for itself.
inline double row_product(const PressureSystem& a, const double* x, std::size_t i)
{
    const std::uint32_t* column = a.columns.data() + i * a.stride;
    const float* weight = a.weights.data() + i * a.stride;
    const std::size_t n = a.count[i];
    double s0 = 0, s1 = 0, s2 = 0, s3 = 0;
    std::size_t k = 0;
    for (; k + 4 <= n; k += 4) {
        s0 += double(weight[k]) * x[column[k]];
        s1 += double(weight[k + 1]) * x[column[k + 1]];
        s2 += double(weight[k + 2]) * x[column[k + 2]];
        s3 += double(weight[k + 3]) * x[column[k + 3]];
    }
    for (; k < n; ++k) s0 += double(weight[k]) * x[column[k]];
    return a.diagonal[i] * x[i] - ((s0 + s1) + (s2 + s3));
}

/// The system summed over aggregates, factorised. Rows are stored from their first entry to the
/// diagonal (the envelope of [George1981, ch. 4]); Cholesky fills nothing outside it.
class CoarseLevel {
public:
    CoarseLevel(const PressureSystem& a, double edge)
    {
        gather(a, edge);
        assemble(a);
        factorise();
    }

    const std::vector<std::uint32_t>& aggregate() const { return aggregate_; }

    /// y = A_c^-1 Z^T r, one value for each aggregate.
    void correct(const std::vector<double>& r, std::vector<double>& y) const
    {
        const std::size_t n = first_.size();
        parallel_for(
            n,
            [&](std::size_t c) {
                double sum = 0;
                for (std::size_t m = start_[c]; m < start_[c + 1]; ++m) sum += r[members_[m]];
                y[c] = sum;
            },
            32);
        for (std::size_t c = 0; c < n; ++c) {
            const double* row = envelope_.data() + offset_[c];
            double s0 = 0, s1 = 0;
            std::size_t k = first_[c];
            for (; k + 2 <= c; k += 2) {
                s0 += row[k - first_[c]] * y[k];
                s1 += row[k + 1 - first_[c]] * y[k + 1];
            }
            if (k < c) s0 += row[k - first_[c]] * y[k];
            y[c] = (y[c] - (s0 + s1)) * inverse_[c];
        }
        for (std::size_t c = n; c-- > 0;) {
            const double* row = envelope_.data() + offset_[c];
            const double value = y[c] *= inverse_[c];
            for (std::size_t k = first_[c]; k < c; ++k) y[k] -= row[k - first_[c]] * value;
        }
    }

private:
    /// Numbers the aggregates that have members, in the order of x, then y, then z.
    void gather(const PressureSystem& a, double edge)
    {
        Bounds box;
        for (const Vec3d& p : a.place) box.add(p);
        const auto cube = [&](Vec3d p) {
            const Vec3d c = (p - box.lower) / edge;
            return Coord(int(c.x), int(c.y), int(c.z));
        };
        const Coord cubes = cube(box.upper) + Coord(1, 1, 1);
        std::vector<std::uint32_t> number(
            std::size_t(cubes.x) * std::size_t(cubes.y) * std::size_t(cubes.z), 0);
        const auto place = [&](Vec3d p) {
            const Coord c = cube(p);
            return (std::size_t(c.x) * std::size_t(cubes.y) + std::size_t(c.y)) *
                       std::size_t(cubes.z) +
                   std::size_t(c.z);
        };
        for (const Vec3d& p : a.place) number[place(p)] = 1;
        std::uint32_t used = 0;
        for (std::uint32_t& v : number) v = v ? used++ : 0;

        aggregate_.resize(a.size);
        start_.assign(used + 1, 0);
        for (std::size_t i = 0; i < a.size; ++i)
            ++start_[(aggregate_[i] = number[place(a.place[i])]) + 1];
        for (std::size_t c = 0; c < used; ++c) start_[c + 1] += start_[c];
        members_.resize(a.size);
        std::vector<std::uint32_t> next(start_.begin(), start_.end() - 1);
        for (std::size_t i = 0; i < a.size; ++i) members_[next[aggregate_[i]]++] = std::uint32_t(i);
    }

    void assemble(const PressureSystem& a)
    {
        const std::size_t n = start_.size() - 1;
        first_.resize(n);
        parallel_for(
            n,
            [&](std::size_t c) {
                std::uint32_t least = std::uint32_t(c);
                each_entry(a, c, [&](std::size_t, std::uint32_t j, float) {
                    least = std::min(least, aggregate_[j]);
                });
                first_[c] = least;
            },
            16);
        offset_.resize(n + 1);
        offset_[0] = 0;
        for (std::size_t c = 0; c < n; ++c) offset_[c + 1] = offset_[c] + (c - first_[c] + 1);
        envelope_.assign(offset_[n], 0);
        parallel_for(
            n,
            [&](std::size_t c) {
                double* row = envelope_.data() + offset_[c];
                for (std::size_t m = start_[c]; m < start_[c + 1]; ++m)
                    row[c - first_[c]] += a.diagonal[members_[m]];
                each_entry(a, c, [&](std::size_t, std::uint32_t j, float w) {
                    if (aggregate_[j] <= c) row[aggregate_[j] - first_[c]] -= double(w);
                });
            },
            16);
    }

    void factorise()
    {
        const std::size_t n = first_.size();
        inverse_.resize(n);
        for (std::size_t c = 0; c < n; ++c) {
            double* row = envelope_.data() + offset_[c];
            const double whole = row[c - first_[c]];
            for (std::size_t k = first_[c]; k < c; ++k) {
                const double* other = envelope_.data() + offset_[k];
                double s0 = 0, s1 = 0, s2 = 0, s3 = 0;
                std::size_t m = std::max(first_[c], first_[k]);
                const double* p = row + (m - first_[c]);
                const double* q = other + (m - first_[k]);
                std::size_t left = k - m;
                for (; left >= 4; left -= 4, p += 4, q += 4) {
                    s0 += p[0] * q[0];
                    s1 += p[1] * q[1];
                    s2 += p[2] * q[2];
                    s3 += p[3] * q[3];
                }
                for (; left > 0; --left, ++p, ++q) s0 += *p * *q;
                row[k - first_[c]] = (row[k - first_[c]] - ((s0 + s1) + (s2 + s3))) * inverse_[k];
            }
            double pivot = whole;
            for (std::size_t k = first_[c]; k < c; ++k)
                pivot -= row[k - first_[c]] * row[k - first_[c]];
            // A part without any known pressure has a constant in its null space: leave that out.
            inverse_[c] = pivot > 1e-10 * whole ? 1 / std::sqrt(pivot) : 0;
        }
    }

    template <class F>
    void each_entry(const PressureSystem& a, std::size_t c, F&& f) const
    {
        for (std::size_t m = start_[c]; m < start_[c + 1]; ++m) {
            const std::size_t i = members_[m];
            for (std::size_t k = 0; k < a.count[i]; ++k)
                f(i, a.columns[i * a.stride + k], a.weights[i * a.stride + k]);
        }
    }

    std::vector<std::uint32_t> aggregate_, start_, members_;
    std::vector<std::uint32_t> first_;  ///< first column of each row of the envelope
    std::vector<std::size_t> offset_;
    std::vector<double> envelope_, inverse_;
};

}  // namespace

void PressureSystem::resize(std::size_t unknowns, std::size_t row_length)
{
    size = unknowns;
    stride = row_length;
    count.resize(size);
    columns.resize(size * stride);
    weights.resize(size * stride);
    diagonal.resize(size);
    rhs.resize(size);
    place.resize(size);
}

Convergence solve(const PressureSystem& a, double aggregate, double tolerance, int max_iterations,
                  std::vector<double>& x)
{
    Convergence result{0, 0, true};
    const std::size_t n = a.size;
    if (n == 0) return result;
    const double scale = std::sqrt(parallel_sum(
        n, [&](std::size_t i) { return a.rhs[i] * a.rhs[i]; }, kChunk));
    if (scale == 0) {
        std::fill(x.begin(), x.end(), 0.0);
        return result;
    }
    std::vector<double> r(n), z(n), p(n), q(n);
    double squared = parallel_fold(
        n, kChunk, 0.0,
        [&](std::size_t begin, std::size_t end) {
            double sum = 0;
            for (std::size_t i = begin; i < end; ++i) {
                r[i] = a.rhs[i] - row_product(a, x.data(), i);
                sum += r[i] * r[i];
            }
            return sum;
        },
        std::plus<>());
    result.residual = std::sqrt(squared) / scale;
    if (result.residual <= tolerance) return result;

    const CoarseLevel coarse(a, aggregate);
    std::vector<double> y(n);
    double rz_before = 0;
    while (result.iterations < max_iterations) {
        // z = (D^-1 + Z A_c^-1 Z^T) r
        coarse.correct(r, y);
        const double rz = parallel_fold(
            n, kChunk, 0.0,
            [&](std::size_t begin, std::size_t end) {
                double sum = 0;
                for (std::size_t i = begin; i < end; ++i) {
                    z[i] = r[i] / a.diagonal[i] + y[coarse.aggregate()[i]];
                    sum += r[i] * z[i];
                }
                return sum;
            },
            std::plus<>());
        const double beta = result.iterations == 0 ? 0 : rz / rz_before;
        rz_before = rz;
        parallel_for(
            n, [&](std::size_t i) { p[i] = z[i] + beta * p[i]; }, 4096);

        const double pq = parallel_fold(
            n, kChunk, 0.0,
            [&](std::size_t begin, std::size_t end) {
                double sum = 0;
                for (std::size_t i = begin; i < end; ++i) {
                    q[i] = row_product(a, p.data(), i);
                    sum += p[i] * q[i];
                }
                return sum;
            },
            std::plus<>());
        const double step = rz / pq;
        squared = parallel_fold(
            n, kChunk, 0.0,
            [&](std::size_t begin, std::size_t end) {
                double sum = 0;
                for (std::size_t i = begin; i < end; ++i) {
                    x[i] += step * p[i];
                    r[i] -= step * q[i];
                    sum += r[i] * r[i];
                }
                return sum;
            },
            std::plus<>());
        ++result.iterations;
        result.residual = std::sqrt(squared) / scale;
        if (result.residual <= tolerance) return result;
        if (!std::isfinite(result.residual)) break;
    }
    result.converged = false;
    return result;
}

}  // namespace sekitei::wind::mps
