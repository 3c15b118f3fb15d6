#include "solvers/tree/crown_light.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>
#include <type_traits>

#include "core/clones.h"
#include "core/error.h"
#include "core/parallel.h"
#include "solvers/rays/embree.h"
#include "solvers/tree/crown_shade.h"

namespace sekitei::tree {
namespace {

constexpr double kFarthest = 1e15;  ///< coordinates; beyond, differences lose all meaning
constexpr std::uint32_t kMostHits = std::numeric_limits<std::uint16_t>::max();

void check(const Balls& balls, const Lookers& lookers)
{
    if (balls.centre.size() != balls.radius.size())
        throw InvalidInput(fmt::format("tree: {} centres of balls with {} radii, must be as many",
                                       balls.centre.size(), balls.radius.size()));
    if (lookers.at.size() != lookers.own.size())
        throw InvalidInput(
            fmt::format("tree: {} places that look with {} own balls, must be as many",
                        lookers.at.size(), lookers.own.size()));
    if (balls.size() >= Lookers::kNoBall)
        throw LimitExceeded(
            fmt::format("tree: {} balls, must be fewer than 2^32 - 1", balls.size()));
    auto near = [](Vec3d p) {
        return std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)}) < kFarthest;
    };
    auto known = [](Vec3d p) { return !std::isnan(p.x) && !std::isnan(p.y) && !std::isnan(p.z); };
    auto bad = [&](Vec3d p) { return !known(p) || !near(p); };
    for (std::size_t i = 0; i < balls.size(); ++i) {
        const Vec3d p = balls.centre[i];
        const double r = balls.radius[i];
        if (bad(p))
            throw InvalidInput(
                fmt::format("tree: centre of ball {} = ({}, {}, {}), must be finite and below 1e15",
                            i, p.x, p.y, p.z));
        if (!(r > 0 && r < kFarthest))
            throw InvalidInput(
                fmt::format("tree: radius of ball {} = {}, must be > 0 and below 1e15", i, r));
    }
    for (std::size_t i = 0; i < lookers.size(); ++i) {
        const Vec3d p = lookers.at[i];
        if (bad(p))
            throw InvalidInput(fmt::format(
                "tree: place {} that looks = ({}, {}, {}), must be finite and below 1e15", i, p.x,
                p.y, p.z));
        if (lookers.own[i] != Lookers::kNoBall && lookers.own[i] >= balls.size())
            throw InvalidInput(fmt::format("tree: own ball of place {} = {}, must be below {}", i,
                                           lookers.own[i], balls.size()));
    }
}

/// A direction with axes across it. Where `back` is a patch it lies exactly opposite, so that one
/// projection serves both.
struct Axis {
    static constexpr std::size_t kNone = ~std::size_t{0};
    Vec3d u, v, t;
    std::size_t front = 0, back = kNone;
};

std::vector<Axis> axes_of(const SkyPatches& sky)
{
    std::vector<Axis> axes;
    for (std::size_t p = 0; p < sky.size(); ++p) {
        const bool pairs = sky.across % 2 == 0;
        if (pairs && sky.opposite(p) < p) continue;
        Axis a;
        a.t = sky.direction[p];
        const double x = std::abs(a.t.x), y = std::abs(a.t.y), z = std::abs(a.t.z);
        const Vec3d least = x <= y && x <= z ? Vec3d(1, 0, 0)
                            : y <= z         ? Vec3d(0, 1, 0)
                                             : Vec3d(0, 0, 1);
        a.u = normalized(cross(least, a.t));
        a.v = cross(a.t, a.u);
        a.front = p;
        if (pairs) a.back = sky.opposite(p);
        axes.push_back(a);
    }
    return axes;
}

/// Points seen along an axis.
struct Projected {
    std::vector<double> u, v, t;

    Projected(const std::vector<Vec3d>& points, const Axis& axis)
        : u(points.size()), v(points.size()), t(points.size())
    {
        for (std::size_t i = 0; i < points.size(); ++i) {
            u[i] = dot(points[i], axis.u);
            v[i] = dot(points[i], axis.v);
            t[i] = dot(points[i], axis.t);
        }
    }
};

/// How many balls shade a place before it and behind it.
struct Count {
    std::int64_t front = 0, back = 0;
};

/// The rule: whether a ball at (du, dv, dt) from the place shades what is before or behind it. All
/// methods that count exactly ask this one, about the same numbers.
template <Occlusion rule>
[[gnu::always_inline]] inline void add(Count& count, double du, double dv, double dt, double r2)
{
    const double across2 = du * du + dv * dv;
    const bool met = across2 <= r2;
    if constexpr (rule == Occlusion::Ahead) {
        count.front += met & (dt > 0);
        count.back += met & (dt < 0);
    } else {
        const bool within = across2 + dt * dt <= r2;
        if constexpr (rule == Occlusion::Full) {
            count.front += within | (met & (dt > 0));
            count.back += within | (met & (dt < 0));
        } else {
            count.front += !within & met & (dt > 0);
            count.back += !within & met & (dt < 0);
        }
    }
}

/// Calls f with the rule as a constant.
template <class F>
[[gnu::always_inline]] inline void with_rule(Occlusion rule, F&& f)
{
    if (rule == Occlusion::Ahead)
        f(std::integral_constant<Occlusion, Occlusion::Ahead>{});
    else if (rule == Occlusion::Full)
        f(std::integral_constant<Occlusion, Occlusion::Full>{});
    else
        f(std::integral_constant<Occlusion, Occlusion::Exclude>{});
}

/// Balls side by side.
struct BallRange {
    const double *u, *v, *t, *r2;
    std::size_t size;
};

/// Hits of places [begin, end) by balls.
SEKITEI_CLONES_512 void count_balls(const BallRange& balls, Occlusion occlusion, const double* u,
                                    const double* v, const double* t, std::size_t begin,
                                    std::size_t end, Count* counts)
{
    with_rule(
        occlusion, [&](auto rule) __attribute__((always_inline)) {
            for (std::size_t i = begin; i < end; ++i) {
                const double u0 = u[i], v0 = v[i], t0 = t[i];
                Count count;
                for (std::size_t j = 0; j < balls.size; ++j)
                    add<rule()>(count, balls.u[j] - u0, balls.v[j] - v0, balls.t[j] - t0,
                                balls.r2[j]);
                counts[i - begin] = count;
            }
        });
}

/// Hits of one patch after another, lookers side by side.
using HitColumns = std::vector<std::uint16_t>;

std::uint16_t capped(std::int64_t hits)
{
    return static_cast<std::uint16_t>(std::min<std::int64_t>(hits, kMostHits));
}

/// All pairs along one axis.
void count_pairs(const Axis& axis, const Balls& balls, const Lookers& lookers,
                 const std::vector<double>& r2, Occlusion occlusion, const Progress& progress,
                 HitColumns& hits)
{
    const Projected ball(balls.centre, axis), eye(lookers.at, axis);
    const std::size_t n = lookers.size();
    with_rule(occlusion, [&](auto rule) {
        for (std::size_t i = 0; i < n; ++i) {
            if (i % 256 == 0) progress.check();
            Count count;
            for (std::size_t j = 0; j < balls.size(); ++j)
                if (j != lookers.own[i])
                    add<rule()>(count, ball.u[j] - eye.u[i], ball.v[j] - eye.v[i],
                                ball.t[j] - eye.t[i], r2[j]);
            hits[axis.front * n + i] = capped(count.front);
            if (axis.back != Axis::kNone) hits[axis.back * n + i] = capped(count.back);
        }
    });
}

/// Square cells of the plane across an axis.
struct CellPlan {
    double u0 = 0, v0 = 0, per_length = 0;
    std::uint32_t columns = 1, rows = 1;

    std::uint32_t column(double u) const
    {
        return static_cast<std::uint32_t>((u - u0) * per_length);
    }
    std::uint32_t row(double v) const { return static_cast<std::uint32_t>((v - v0) * per_length); }
};

/// Cells as wide as the largest ball, so that what shades a place lies in its cell or next to it;
/// wider only where the points are very far apart.
CellPlan cell_plan(const Projected& a, const Projected& b, double radius)
{
    double u0 = INFINITY, u1 = -INFINITY, v0 = INFINITY, v1 = -INFINITY;
    for (const Projected* p : {&a, &b})
        for (std::size_t i = 0; i < p->u.size(); ++i) {
            u0 = std::min(u0, p->u[i]), u1 = std::max(u1, p->u[i]);
            v0 = std::min(v0, p->v[i]), v1 = std::max(v1, p->v[i]);
        }
    const double most = 4096 + 2 * static_cast<double>(a.u.size() + b.u.size());
    const double edge = std::max({radius * (1 + 1e-6), (u1 - u0) / most, (v1 - v0) / most, 1e-100});
    CellPlan plan{u0, v0, 1 / edge, 1, 1};
    plan.columns = plan.column(u1) + 1;
    plan.rows = plan.row(v1) + 1;
    return plan;
}

/// Points sorted into cells, row by row and along rows by column; empty cells take no place.
struct Sorted {
    struct Cell {
        std::uint32_t column, begin;
    };
    std::vector<double> u, v, t;
    std::vector<std::uint32_t> order;      ///< which point
    std::vector<Cell> cells;               ///< that hold points, and one past the last
    std::vector<std::uint32_t> row_begin;  ///< into cells, for each row; and one past the last

    Sorted(const Projected& points, const CellPlan& plan)
    {
        const std::size_t n = points.u.size();
        std::vector<std::uint32_t> row(n), column(n), by_column(n),
            begin(std::max(plan.rows, plan.columns) + 1);
        for (std::size_t i = 0; i < n; ++i) {
            column[i] = plan.column(points.u[i]);
            row[i] = plan.row(points.v[i]);
        }
        // Counting sorts: by column, then by row, which keeps the columns in order.
        for (const std::uint32_t c : column) ++begin[c + 1];
        for (std::uint32_t c = 0; c < plan.columns; ++c) begin[c + 1] += begin[c];
        for (std::uint32_t i = 0; i < n; ++i) by_column[begin[column[i]]++] = i;
        std::fill(begin.begin(), begin.end(), 0u);
        for (const std::uint32_t r : row) ++begin[r + 1];
        for (std::uint32_t r = 0; r < plan.rows; ++r) begin[r + 1] += begin[r];
        order.resize(n);
        for (const std::uint32_t i : by_column) order[begin[row[i]]++] = i;

        u.resize(n), v.resize(n), t.resize(n);
        row_begin.resize(plan.rows + 1);
        std::uint32_t rows_done = 0, last_column = 0;
        for (std::uint32_t k = 0; k < n; ++k) {
            const std::uint32_t i = order[k];
            u[k] = points.u[i], v[k] = points.v[i], t[k] = points.t[i];
            const bool new_row = k == 0 || row[i] >= rows_done;
            if (new_row || column[i] != last_column) {
                while (rows_done <= row[i])
                    row_begin[rows_done++] = static_cast<std::uint32_t>(cells.size());
                cells.push_back({column[i], k});
                last_column = column[i];
            }
        }
        while (rows_done <= plan.rows)
            row_begin[rows_done++] = static_cast<std::uint32_t>(cells.size());
        cells.push_back({0, static_cast<std::uint32_t>(n)});
    }
};

/// The balls of a cell and its neighbours, as many as fill whole registers.
class Nearby {
public:
    void clear() { size_ = 0; }
    void append(const Sorted& balls, const std::vector<double>& r2, std::size_t begin,
                std::size_t end)
    {
        grow(size_ + (end - begin));
        for (std::size_t k = begin; k < end; ++k, ++size_) {
            u_[size_] = balls.u[k], v_[size_] = balls.v[k], t_[size_] = balls.t[k];
            r2_[size_] = r2[k];
        }
    }
    BallRange padded()
    {
        const std::size_t whole = (size_ + 7) / 8 * 8;
        grow(whole);
        for (; size_ < whole; ++size_) {
            u_[size_] = v_[size_] = t_[size_] = 0;
            r2_[size_] = -1;  // shades nothing
        }
        return {u_.data(), v_.data(), t_.data(), r2_.data(), whole};
    }

private:
    void grow(std::size_t size)
    {
        if (u_.size() >= size) return;
        size += size / 2 + 64;
        u_.resize(size), v_.resize(size), t_.resize(size), r2_.resize(size);
    }
    std::vector<double> u_, v_, t_, r2_;
    std::size_t size_ = 0;
};

/// Along one axis, each place against the balls of its cell and the eight around it.
void count_sorted(const Axis& axis, const Balls& balls, const Lookers& lookers,
                  const std::vector<double>& r2, double largest, bool alike, Occlusion occlusion,
                  const Progress& progress, HitColumns& hits)
{
    const Projected ball(balls.centre, axis);
    std::optional<Projected> its_eye;
    if (!alike) its_eye.emplace(lookers.at, axis);
    const Projected& eye = alike ? ball : *its_eye;
    const CellPlan plan = cell_plan(ball, eye, largest);
    const Sorted shading(ball, plan);
    std::optional<Sorted> its_looking;
    if (!alike) its_looking.emplace(eye, plan);
    const Sorted& looking = alike ? shading : *its_looking;
    std::vector<double> sorted_r2(balls.size());
    for (std::size_t k = 0; k < balls.size(); ++k) sorted_r2[k] = r2[shading.order[k]];

    const std::size_t n = lookers.size();
    Nearby nearby;
    std::vector<Count> counts;
    for (std::uint32_t row = 0; row < plan.rows; ++row) {
        progress.check();
        // Three rows of balls and, in each, the cells next to the place's, which only move on.
        const std::uint32_t first_row = row == 0 ? 0 : row - 1,
                            last_row = std::min(row + 1, plan.rows - 1);
        std::array<std::uint32_t, 3> from{}, to{};
        for (std::uint32_t r = first_row; r <= last_row; ++r)
            from[r - first_row] = to[r - first_row] = shading.row_begin[r];
        for (std::uint32_t c = looking.row_begin[row]; c < looking.row_begin[row + 1]; ++c) {
            const std::uint32_t column = looking.cells[c].column;
            nearby.clear();
            for (std::uint32_t r = first_row; r <= last_row; ++r) {
                std::uint32_t &a = from[r - first_row], &b = to[r - first_row];
                const std::uint32_t end = shading.row_begin[r + 1];
                while (a < end && shading.cells[a].column + 1 < column) ++a;
                while (b < end && shading.cells[b].column <= column + 1) ++b;
                nearby.append(shading, sorted_r2, shading.cells[a].begin, shading.cells[b].begin);
            }
            const std::size_t begin = looking.cells[c].begin, end = looking.cells[c + 1].begin;
            counts.resize(std::max(counts.size(), end - begin));
            count_balls(nearby.padded(), occlusion, looking.u.data(), looking.v.data(),
                        looking.t.data(), begin, end, counts.data());
            for (std::size_t k = begin; k < end; ++k) {
                const std::uint32_t i = looking.order[k], own = lookers.own[i];
                Count& count = counts[k - begin];
                if (own != Lookers::kNoBall)
                    with_rule(occlusion, [&](auto rule) {
                        Count its;
                        add<rule()>(its, ball.u[own] - eye.u[i], ball.v[own] - eye.v[i],
                                    ball.t[own] - eye.t[i], r2[own]);
                        count.front -= its.front;
                        count.back -= its.back;
                    });
                hits[axis.front * n + i] = capped(count.front);
                if (axis.back != Axis::kNone) hits[axis.back * n + i] = capped(count.back);
            }
        }
    }
}

/// Balls that Embree finds along half-lines.
class BallScene {
public:
    BallScene(const Balls& balls, const Lookers& lookers) : balls_(balls)
    {
        // About their middle, where floats are finest.
        Bounds box;
        for (const Vec3d p : balls.centre) box.add(p);
        for (const Vec3d p : lookers.at) box.add(p);
        middle_ = box.centre();
        const Vec3d size = box.size();
        slack_ = 1e-6 * (size.x + size.y + size.z);

        device_ = rtcNewDevice(nullptr);
        if (!device_) throw LimitExceeded("tree: Embree could not start");
        scene_ = rtcNewScene(device_);
        rtcSetSceneBuildQuality(scene_, RTC_BUILD_QUALITY_MEDIUM);
        rtcSetSceneFlags(scene_, RTC_SCENE_FLAG_ROBUST);
        RTCGeometry geometry = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_USER);
        rtcSetGeometryUserPrimitiveCount(geometry, static_cast<unsigned>(balls.size()));
        rtcSetGeometryUserData(geometry, this);
        rtcSetGeometryBoundsFunction(geometry, &BallScene::bounds, nullptr);
        rtcSetGeometryIntersectFunction(geometry, &BallScene::intersect);
        rtcCommitGeometry(geometry);
        rtcAttachGeometry(scene_, geometry);
        rtcReleaseGeometry(geometry);
        rtcCommitScene(scene_);
        if (rtcGetDeviceError(device_) != RTC_ERROR_NONE) {
            release();
            throw LimitExceeded(fmt::format("tree: no memory for the rays of {} balls",
                                            count_text(static_cast<double>(balls.size()))));
        }
    }
    ~BallScene() { release(); }
    BallScene(const BallScene&) = delete;
    BallScene& operator=(const BallScene&) = delete;

    std::int64_t count(Vec3d from, std::uint32_t own, Vec3d direction, Occlusion occlusion) const
    {
        Query query(*this, from, direction, own, occlusion);
        RTCRayHit unused;  // nothing ends the ray, so that all balls are asked
        rays::first_hit(scene_,
                        rays::ray_of(Vec3f(from - middle_), Vec3f(direction), 0,
                                     std::numeric_limits<float>::infinity()),
                        unused, query);
        return query.count.front;
    }

private:
    struct Query : rays::QueryContext {
        Query(const BallScene& s, Vec3d f, Vec3d d, std::uint32_t o, Occlusion rule)
            : scene(s), from(f), direction(d), own(o), occlusion(rule)
        {
        }
        const BallScene& scene;
        const Vec3d from, direction;
        const std::uint32_t own;
        const Occlusion occlusion;
        Count count;
    };

    /// A box that still holds the ball when Embree's ray was rounded.
    static void bounds(const RTCBoundsFunctionArguments* args)
    {
        const auto& scene = *static_cast<const BallScene*>(args->geometryUserPtr);
        const Vec3d c = scene.balls_.centre[args->primID] - scene.middle_;
        const double r = scene.balls_.radius[args->primID] * (1 + 1e-6) + scene.slack_;
        auto down = [](double x) {
            return std::nextafter(static_cast<float>(x), -std::numeric_limits<float>::infinity());
        };
        auto up = [](double x) {
            return std::nextafter(static_cast<float>(x), std::numeric_limits<float>::infinity());
        };
        RTCBounds& box = *args->bounds_o;
        box.lower_x = down(c.x - r), box.upper_x = up(c.x + r);
        box.lower_y = down(c.y - r), box.upper_y = up(c.y + r);
        box.lower_z = down(c.z - r), box.upper_z = up(c.z + r);
    }

    static void intersect(const RTCIntersectFunctionNArguments* args)
    {
        if (args->valid[0] == 0) return;
        auto& q = static_cast<Query&>(static_cast<rays::QueryContext&>(*args->context));
        if (args->primID == q.own) return;
        const Balls& balls = q.scene.balls_;
        const Vec3d d = balls.centre[args->primID] - q.from;
        const double r = balls.radius[args->primID], t = dot(d, q.direction);
        const Vec3d across = d - q.direction * t;
        with_rule(q.occlusion,
                  [&](auto rule) { add<rule()>(q.count, length(across), 0, t, r * r); });
    }
    void release()
    {
        if (scene_) rtcReleaseScene(scene_);
        if (device_) rtcReleaseDevice(device_);
        scene_ = nullptr;
        device_ = nullptr;
    }

    const Balls& balls_;
    Vec3d middle_;
    double slack_ = 0;
    RTCDevice device_ = nullptr;
    RTCScene scene_ = nullptr;
};

void count_by_rays(const SkyPatches& sky, const Balls& balls, const Lookers& lookers,
                   Occlusion occlusion, const Progress& progress, HitColumns& hits)
{
    if (balls.size() == 0) return;
    const BallScene scene(balls, lookers);
    const std::size_t n = lookers.size();
    parallel_for_range(
        n,
        [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) {
                progress.check();
                for (std::size_t p = 0; p < sky.size(); ++p)
                    hits[p * n + i] = capped(
                        scene.count(lookers.at[i], lookers.own[i], sky.direction[p], occlusion));
            }
        },
        16);
}

/// Points in the order of a curve that keeps near ones together; ties by index.
std::vector<std::uint32_t> near_order(const std::vector<Vec3d>& points)
{
    Bounds box;
    for (const Vec3d p : points) box.add(p);
    const Vec3d size = box.size();
    const double most = std::max({size.x, size.y, size.z, 1e-100});
    // Every third bit.
    auto spread = [](std::uint64_t v) {
        v = (v | v << 32) & 0x1F00000000FFFF;
        v = (v | v << 16) & 0x1F0000FF0000FF;
        v = (v | v << 8) & 0x100F00F00F00F00F;
        v = (v | v << 4) & 0x10C30C30C30C30C3;
        return (v | v << 2) & 0x1249249249249249;
    };
    std::vector<std::pair<std::uint64_t, std::uint32_t>> keys(points.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
        const Vec3<std::uint64_t> q((points[i] - box.lower) * (0x1FFFFF / most));
        keys[i] = {spread(q.x) | spread(q.y) << 1 | spread(q.z) << 2,
                   static_cast<std::uint32_t>(i)};
    }
    std::sort(keys.begin(), keys.end());
    std::vector<std::uint32_t> order(points.size());
    for (std::size_t k = 0; k < order.size(); ++k) order[k] = keys[k].second;
    return order;
}

/// Hits, and which looker each row of a column is of.
struct Hits {
    HitColumns columns;
    std::vector<std::uint32_t> looker;
};

/// By sorting. Balls and places are first brought near their neighbours, for the sake of memory.
Hits sorted_hits(const SkyPatches& sky, const Balls& balls, const Lookers& lookers,
                 Occlusion occlusion, const Progress& progress)
{
    const std::vector<std::uint32_t> ball_order = near_order(balls.centre);
    std::vector<std::uint32_t> rank(balls.size());
    Balls near;
    std::vector<double> r2(balls.size());
    double largest = 0;
    for (std::uint32_t k = 0; k < balls.size(); ++k) {
        const std::uint32_t j = ball_order[k];
        rank[j] = k;
        near.centre.push_back(balls.centre[j]);
        near.radius.push_back(balls.radius[j]);
        r2[k] = balls.radius[j] * balls.radius[j];
        largest = std::max(largest, balls.radius[j]);
    }
    const bool alike = lookers.at == balls.centre;
    Lookers looking;
    Hits hits{HitColumns(sky.size() * lookers.size()), alike ? ball_order : near_order(lookers.at)};
    for (const std::uint32_t i : hits.looker) {
        const std::uint32_t own = lookers.own[i];
        looking.at.push_back(lookers.at[i]);
        looking.own.push_back(own == Lookers::kNoBall ? own : rank[own]);
    }
    const std::vector<Axis> axes = axes_of(sky);
    parallel_for(axes.size(), [&](std::size_t a) {
        count_sorted(axes[a], near, looking, r2, largest, alike, occlusion, progress, hits.columns);
    });
    return hits;
}

Hits all_hits(const SkyPatches& sky, const Balls& balls, const Lookers& lookers,
              Occlusion occlusion, Method method, const Progress& progress)
{
    if (method == Method::Sweep && balls.size() > 0 && lookers.size() > 0)
        return sorted_hits(sky, balls, lookers, occlusion, progress);
    Hits hits{HitColumns(sky.size() * lookers.size()), std::vector<std::uint32_t>(lookers.size())};
    std::iota(hits.looker.begin(), hits.looker.end(), 0u);
    if (method == Method::Bvh)
        count_by_rays(sky, balls, lookers, occlusion, progress, hits.columns);
    if (method == Method::Naive) {
        std::vector<double> r2;
        for (const double r : balls.radius) r2.push_back(r * r);
        const std::vector<Axis> axes = axes_of(sky);
        parallel_for(axes.size(), [&](std::size_t a) {
            count_pairs(axes[a], balls, lookers, r2, occlusion, progress, hits.columns);
        });
    }
    return hits;
}

/// tau^K for K = 0, 1, ... up to where it is 0 or no more balls are.
std::vector<double> powers(double transmission, std::size_t balls)
{
    std::vector<double> power{1};
    while (power.size() <= std::min<std::size_t>(balls, kMostHits) && power.back() > 0)
        power.push_back(power.back() * transmission);
    return power;
}

/// For each patch how much each other one adds to the brightness of its surroundings.
std::vector<double> brightness_weights(const SkyPatches& sky)
{
    const std::size_t n = sky.size();
    std::vector<double> weights(n * n);
    for (std::size_t p = 0; p < n; ++p)
        for (std::size_t q = 0; q < n; ++q) {
            const double c = std::max(0.0, dot(sky.direction[p], sky.direction[q]));
            weights[p * n + q] = sky.solid[q] * (c * c * c * c);
        }
    return weights;
}

}  // namespace

std::vector<std::uint16_t> count_hits(const SkyPatches& sky, const Balls& balls,
                                      const Lookers& lookers, Occlusion occlusion, Method method,
                                      const Progress& progress)
{
    check(balls, lookers);
    if (method == Method::Grid)
        throw InvalidParameter("tree: method = grid counts no hits, must be naive, sweep or bvh");
    const Hits found = all_hits(sky, balls, lookers, occlusion, method, progress);
    const std::size_t patches = sky.size(), n = lookers.size();
    std::vector<std::uint16_t> hits(found.columns.size());
    parallel_for(
        n,
        [&](std::size_t k) {
            std::uint16_t* row = &hits[found.looker[k] * patches];
            for (std::size_t p = 0; p < patches; ++p) row[p] = found.columns[p * n + k];
        },
        256);
    return hits;
}

CrownLight crown_light(const SkyPatches& sky, const Balls& balls, const Lookers& lookers,
                       const CrownLightParams& params, const SightOf& sight,
                       const Progress& progress)
{
    if (!(params.transmission >= 0 && params.transmission <= 1))
        throw InvalidParameter(
            fmt::format("tree: transmission = {}, must be 0 to 1", params.transmission));
    if (!(params.blocked_light >= 0 && std::isfinite(params.blocked_light)))
        throw InvalidParameter(
            fmt::format("tree: blocked_light = {}, must be >= 0", params.blocked_light));
    if (params.method == Method::Grid && params.transmission == 0)
        throw InvalidParameter(
            "tree: transmission = 0 with method = grid, must be > 0; method = sweep takes 0");
    check(balls, lookers);

    const std::size_t patches = sky.size(), n = lookers.size();
    Hits hits;
    std::unique_ptr<ExtinctionGrid> grid;
    if (params.method == Method::Grid) {
        grid = std::make_unique<ExtinctionGrid>(sky, balls, params.transmission, params.occlusion,
                                                progress);
        hits.looker = near_order(lookers.at);
    } else if (params.transmission == 1)
        hits.looker = near_order(lookers.at);  // nobody shades anybody
    else
        hits = all_hits(sky, balls, lookers, params.occlusion, params.method, progress);
    const std::vector<double> power = powers(params.transmission, balls.size());
    std::vector<double> weights;
    if (params.direction == LightDirection::Brightest) weights = brightness_weights(sky);

    CrownLight result{std::vector<double>(n), std::vector<Vec3d>(n), std::vector<Vec3d>(n)};
    parallel_for_range(
        n,
        [&](std::size_t begin, std::size_t end) {
            std::vector<double> light(patches);
            for (std::size_t k = begin; k < end; ++k) {
                progress.check();
                const std::size_t i = hits.looker[k];
                if (grid)
                    grid->shade(lookers.at[i], lookers.own[i], light);
                else if (params.transmission == 1)
                    std::ranges::fill(light, 1.0);
                else
                    for (std::size_t p = 0; p < patches; ++p)
                        light[p] =
                            power[std::min<std::size_t>(hits.columns[p * n + k], power.size() - 1)];
                double sum = 0;
                Vec3d towards;
                for (std::size_t p = 0; p < patches; ++p) {
                    double b = sky.brightness[p];
                    if (sight) {
                        const Sight s = sight(i, p);
                        if (s.blocked) b = params.blocked_light;
                        b *= s.transmittance;
                    }
                    light[p] *= b;
                    const double arrives = light[p] * sky.solid[p];
                    sum += arrives;
                    towards += sky.direction[p] * arrives;
                }
                result.light[i] = sum / sky.open;
                if (!(sum > 0)) continue;
                result.mean[i] = towards / sum;
                const double anisotropy = length(result.mean[i]);
                if (params.direction == LightDirection::Mean) {
                    if (anisotropy >= 1e-12) result.towards[i] = result.mean[i] / anisotropy;
                    continue;
                }
                double most = 0;
                for (std::size_t p = 0; p < patches; ++p) {
                    double around = 0;
                    for (std::size_t q = 0; q < patches; ++q)
                        around += weights[p * patches + q] * light[q];
                    if (around > most) most = around, result.towards[i] = sky.direction[p];
                }
            }
        },
        64);
    return result;
}

}  // namespace sekitei::tree
