#include "solvers/light/photon_map.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/clones.h"
#include "core/error.h"
#include "core/mesh_sites.h"
#include "core/parallel.h"
#include "core/random.h"
#include "solvers/light/lobes.h"

namespace sekitei::light {
namespace {

constexpr Stream kGather{"photons.gather"}, kSunRays{"photons.sun_rays"};
constexpr std::size_t kLeastSunRays = 16, kMostSunRays = 512;  // a place
constexpr float kSameSide = 0.5f;                              // least cosine between normals
constexpr float kNearestLeast = 0.02f, kNearestMost = 0.20f;   // radii by photon_nearest [m]
constexpr std::size_t kGrain = 64;

std::variant<CellIndex, KdTree> search_over(std::span<const Vec3f> points,
                                            const PhotonParams& params)
{
    if (params.photon_search == PhotonSearch::Tree) return KdTree(points);
    // Three cells a radius: fewer points beyond it are looked at than with one.
    return CellIndex(points, 0.34f * static_cast<float>(params.photon_radius));
}

const std::vector<NumberedPoint>& slots_of(const std::variant<CellIndex, KdTree>& search)
{
    return std::visit(
        [](const auto& s) -> const auto& { return s.points(); }, search);
}

void check_places(std::span<const Vec3f> position, std::span<const Vec3f> normal,
                  std::span<const float> area, const char* what)
{
    if (normal.size() != position.size() || area.size() != position.size())
        throw InvalidInput(
            fmt::format("photons: {} {}s with {} normals and {} areas, must be as many of each",
                        position.size(), what, normal.size(), area.size()));
    for (std::size_t i = 0; i < position.size(); ++i) {
        const Vec3f p = position[i], n = normal[i];
        if (!(std::isfinite(p.x + p.y + p.z) && std::abs(dot(n, n) - 1) < 1e-3f))
            throw InvalidInput(fmt::format(
                "photons: {} {}: position ({}, {}, {}) m, normal ({}, {}, {}); must be finite, and "
                "of length 1",
                what, i, p.x, p.y, p.z, n.x, n.y, n.z));
    }
}

/// An order of places that keeps neighbours together.
std::vector<std::uint32_t> neighbourly(std::span<const Vec3f> places)
{
    const KdTree tree(places);
    std::vector<std::uint32_t> order(places.size());
    for (std::size_t i = 0; i < order.size(); ++i) order[i] = tree.points()[i].index;
    return order;
}

/// Something that counts for the places near it: a photon, or a patch of land.
struct Counted {
    Vec3f at, normal;
    float weight;
};
/// A few places side by side.
constexpr std::size_t kLanes = 8;
using Floats = float __attribute__((vector_size(kLanes * sizeof(float))));
using Ints = std::int32_t __attribute__((vector_size(kLanes * sizeof(std::int32_t))));
using HalfDoubles = double __attribute__((vector_size(kLanes / 2 * sizeof(double))));
struct Lanes {
    Floats x, y, z, nx, ny, nz;
};
struct LaneSums {
    HalfDoubles low{}, high{};
    Ints count{};

    double sum(std::size_t k) const { return k < kLanes / 2 ? low[k] : high[k - kLanes / 2]; }
};

/// sum += weight W for all that lies within the radius, on the same side and within the slab: for
/// each place the same operations in the same order as for it alone.
SEKITEI_CLONES
void add_up(const Counted* list, std::size_t size, const Lanes& lanes, float radius, float half,
            LaneSums& sums)
{
    const float r2 = radius * radius, per_radius = 1 / radius;
    const Lanes l = lanes;
    LaneSums s = sums;
    for (std::size_t i = 0; i < size; ++i) {
        const Counted c = list[i];
        const Floats x = c.at.x - l.x, y = c.at.y - l.y, z = c.at.z - l.z;
        const Floats d2 = x * x + y * y + z * z;
        const Floats along = x * l.nx + y * l.ny + z * l.nz;
        const Floats facing = c.normal.x * l.nx + c.normal.y * l.ny + c.normal.z * l.nz;
        const Ints counts = (d2 <= r2) & (facing >= kSameSide) & (along <= half) & (along >= -half);
        Floats d;
        for (std::size_t k = 0; k < kLanes; ++k) d[k] = std::sqrt(d2[k]);
        const Floats w = c.weight * (1 - d * per_radius);
        const auto kept = reinterpret_cast<Floats>(reinterpret_cast<Ints>(w) & counts);
        s.low +=
            __builtin_convertvector(__builtin_shufflevector(kept, kept, 0, 1, 2, 3), HalfDoubles);
        s.high +=
            __builtin_convertvector(__builtin_shufflevector(kept, kept, 4, 5, 6, 7), HalfDoubles);
        s.count -= counts;
    }
    sums = s;
}

/// Sums over what counts for places, kinds apart: neighbours share one look into the search.
/// @param order    of the places, neighbourly()
/// @param counted  Counted(slot), and kind(slot) < Kinds
/// @param put      put(place, sum of each kind, count)
template <std::size_t Kinds, class Search, class CountedAt, class KindOf, class Put>
void sum_around(const Search& search, std::span<const Vec3f> position,
                std::span<const Vec3f> normal, std::span<const std::uint32_t> order, float radius,
                float half, const CountedAt& counted, const KindOf& kind, const Put& put,
                const Progress& progress)
{
    constexpr std::size_t kGroup = 64;
    parallel_for((order.size() + kGroup - 1) / kGroup, [&](std::size_t group) {
        if (group % 64 == 0) progress.check();
        std::array<std::vector<Counted>, Kinds> lists;
        auto work = [&](auto& self, std::size_t begin, std::size_t end) -> void {
            Bounds box;
            for (std::size_t i = begin; i < end; ++i) box.add(Vec3d(position[order[i]]));
            const Vec3f centre(box.centre());
            float far2 = 0;
            for (std::size_t i = begin; i < end; ++i)
                far2 = std::max(far2, squared_distance(centre, position[order[i]]));
            // Sharing saves most where places are dense beside the radius; where they lie far
            // apart, each looks for itself.
            const float far = std::sqrt(far2);
            const std::size_t size = end - begin;
            if (size > 1 && far > (size > kLanes ? radius / 8 : radius / 2)) {
                const std::size_t half_way =
                    size > kLanes ? (size / 2 + kLanes - 1) / kLanes * kLanes : size / 2;
                self(self, begin, begin + half_way);
                self(self, begin + half_way, end);
                return;
            }
            for (auto& list : lists) list.clear();
            search.within_slots(centre, (radius + far) * (1 + 1e-5f), [&](std::size_t slot, float) {
                lists[kind(slot)].push_back(counted(slot));
            });
            for (std::size_t first = begin; first < end; first += kLanes) {
                const std::size_t lanes = std::min(kLanes, end - first);
                Lanes at;
                for (std::size_t k = 0; k < kLanes; ++k) {
                    const std::uint32_t place = order[first + std::min(k, lanes - 1)];
                    const Vec3f p = position[place], n = normal[place];
                    at.x[k] = p.x, at.y[k] = p.y, at.z[k] = p.z;
                    at.nx[k] = n.x, at.ny[k] = n.y, at.nz[k] = n.z;
                }
                std::array<LaneSums, Kinds> sums;
                for (std::size_t j = 0; j < Kinds; ++j)
                    add_up(lists[j].data(), lists[j].size(), at, radius, half, sums[j]);
                for (std::size_t k = 0; k < lanes; ++k) {
                    std::array<double, Kinds> sum;
                    std::int32_t count = 0;
                    for (std::size_t j = 0; j < Kinds; ++j) {
                        sum[j] = sums[j].sum(k);
                        count += sums[j].count[k];
                    }
                    put(order[first + k], sum, count);
                }
            }
        };
        work(work, group * kGroup, std::min(order.size(), (group + 1) * kGroup));
    });
}

std::int32_t plant_of(const Receivers& receivers, std::size_t i)
{
    return receivers.plant.empty() ? -1 : receivers.plant[i];
}

}  // namespace

SiteKernel::SiteKernel(std::span<const Vec3f> position, std::span<const Vec3f> normal,
                       std::span<const float> area, const PhotonParams& params, double moss_size,
                       const TriMesh* triangles)
    : position_(position),
      normal_(normal),
      area_(area),
      radius_(static_cast<float>(params.photon_radius)),
      moss_size_(moss_size)
{
    validate(params);
    check_places(position, normal, area, "site");
    for (std::size_t i = 0; i < area.size(); ++i)
        if (!(area[i] > 0 && std::isfinite(area[i])))
            throw InvalidInput(
                fmt::format("photons: site {}: area = {} m^2, must be > 0", i, area[i]));
    if (!(moss_size >= 0 && std::isfinite(moss_size)))
        throw InvalidParameter(
            fmt::format("photons: size of moss = {:.6g} m, must be >= 0", moss_size));
    whole_.search = search_over(position, params);
    for (const NumberedPoint& p : slots_of(whole_.search))
        whole_.of_slot.push_back({normal[p.index], area[p.index]});
    if (triangles) cut(*triangles, params);
    order_ = neighbourly(position);
    own_area_ = kernel_area(position, normal, order_);
    if (params.photon_estimator != PhotonEstimator::Site) return;

    // Scale until equal light on all sites comes out equal: c_i sum_j a_j c_j W_ij = 1.
    const std::size_t n = size();
    std::vector<double>& c = receive_;
    c.resize(n);
    for (std::size_t i = 0; i < n; ++i) c[i] = 1 / std::sqrt(static_cast<double>(own_area_[i]));
    std::vector<double> row(n);
    auto sum_rows = [&] {
        parallel_for(
            n,
            [&](std::size_t i) {
                double sum = 0;
                partners(i, [&](std::size_t j, double w) { sum += area_[j] * c[j] * w; });
                row[i] = sum;
            },
            kGrain);
    };
    // Errors halve with each round.
    constexpr int kMostRounds = 30;
    for (int round = 0; round < kMostRounds; ++round) {
        sum_rows();
        double worst = 0;
        for (std::size_t i = 0; i < n; ++i) {
            worst = std::max(worst, std::abs(c[i] * row[i] - 1));
            c[i] = std::sqrt(c[i] / row[i]);
        }
        if (worst < 1e-3) break;
    }
    // W is symmetric, so these are column sums as well: what site j sends adds up to what it got.
    sum_rows();
    send_.resize(n);
    for (std::size_t j = 0; j < n; ++j) send_[j] = 1 / row[j];
}

void SiteKernel::cut(const TriMesh& triangles, const PhotonParams& params)
{
    // A sum over pieces of a third of the radius is good to half a per cent. With photon_nearest
    // the radius may be far smaller than it is here; its sums are as rough as its light.
    const SitePieces pieces = cut_sites(triangles, area_, double(radius_) / 3);
    if (pieces.site.size() == size()) return;
    cut_.search = search_over(pieces.position, params);
    for (const NumberedPoint& p : slots_of(cut_.search))
        cut_.of_slot.push_back({normal_[pieces.site[p.index]], pieces.area[p.index]});
}

template <class F>
void SiteKernel::around(const Patches& patches, Vec3f at, Vec3f normal, float radius, F&& f) const
{
    const float half = slab(radius), per_radius = 1 / radius;
    std::visit(
        [&](const auto& search) {
            const NumberedPoint* points = search.points().data();
            search.within_slots(at, radius, [&](std::size_t slot, float d2) {
                if (dot(patches.of_slot[slot].normal, normal) < kSameSide ||
                    std::abs(dot(points[slot].at - at, normal)) > half)
                    return;
                f(slot, 1 - std::sqrt(d2) * per_radius);
            });
        },
        patches.search);
}

template <class F>
void SiteKernel::partners(std::size_t site, F&& f) const
{
    const Vec3f at = position_[site];
    const float half = slab(radius_);
    const NumberedPoint* points = slots_of(whole_.search).data();
    around(whole_, at, normal_[site], radius_, [&](std::size_t slot, float w) {
        // Seen from the other side too, or the relation would not be symmetric.
        if (std::abs(dot(points[slot].at - at, whole_.of_slot[slot].normal)) <= half)
            f(points[slot].index, static_cast<double>(w));
    });
}

float SiteKernel::kernel_area(Vec3f at, Vec3f normal, float radius) const
{
    double sum = 0;
    const Patches& patches = cut_.of_slot.empty() ? whole_ : cut_;
    around(patches, at, normal, radius, [&](std::size_t slot, float w) {
        sum += static_cast<double>(patches.of_slot[slot].area * w);
    });
    return static_cast<float>(sum);
}

std::vector<float> SiteKernel::kernel_area(std::span<const Vec3f> at,
                                           std::span<const Vec3f> normal) const
{
    return kernel_area(at, normal, neighbourly(at));
}

std::vector<float> SiteKernel::kernel_area(std::span<const Vec3f> at, std::span<const Vec3f> normal,
                                           std::span<const std::uint32_t> order) const
{
    std::vector<float> areas(at.size());
    const Patches& patches = cut_.of_slot.empty() ? whole_ : cut_;
    std::visit(
        [&](const auto& search) {
            const NumberedPoint* points = search.points().data();
            sum_around<1>(
                search, at, normal, order, radius_, slab(radius_),
                [&](std::size_t slot) {
                    const Patch& patch = patches.of_slot[slot];
                    return Counted{points[slot].at, patch.normal, patch.area};
                },
                [](std::size_t) { return 0u; },
                [&](std::size_t place, const std::array<double, 1>& sum, std::int32_t) {
                    areas[place] = static_cast<float>(sum[0]);
                },
                {});
        },
        patches.search);
    return areas;
}

std::vector<float> SiteKernel::spread(std::span<const double> flux) const
{
    std::vector<float> result(size());
    parallel_for(
        size(),
        [&](std::size_t i) {
            double sum = 0;
            partners(i, [&](std::size_t j, double w) { sum += w * send_[j] * flux[j]; });
            result[i] = static_cast<float>(receive_[i] * sum);
        },
        kGrain);
    return result;
}

double SiteKernel::mean_around(Vec3f at, Vec3f normal, std::span<const float> values) const
{
    double sum = 0, weight = 0;
    const NumberedPoint* points = slots_of(whole_.search).data();
    around(whole_, at, normal, radius_, [&](std::size_t slot, float w) {
        const double share = static_cast<double>(whole_.of_slot[slot].area) * w;
        sum += share * values[points[slot].index];
        weight += share;
    });
    return weight > 0 ? sum / weight : 0;
}

PhotonMap::PhotonMap(std::span<const Photon> photons, const MossHosts& moss,
                     const SiteKernel& sites, const PhotonParams& params)
    : sites_(sites), params_(params)
{
    validate(params);
    if (moss.normal.size() != moss.point.size())
        throw InvalidInput(fmt::format("photons: {} feet of moss with {} normals, must be as many",
                                       moss.point.size(), moss.normal.size()));
    for (const Photon& p : photons)
        if (p.target >= (p.on_moss ? moss.point.size() : sites.size()))
            throw InvalidInput(fmt::format("photons: one hit {} {}, of which there are {}",
                                           p.on_moss ? "moss" : "site", p.target,
                                           p.on_moss ? moss.point.size() : sites.size()));
    auto kind = [](const Photon& p) {
        return static_cast<std::uint8_t>(p.bounce > 0 ? 2 : p.source == Source::Sky ? 1 : 0);
    };
    auto counts = [&](const Photon& p) {
        return params.direct == DirectLight::Photons || kind(p) != 0;
    };

    if (params.photon_estimator == PhotonEstimator::Site) {
        for (auto& part : flux_) part.assign(sites.size(), 0);
        count_.assign(sites.size(), 0);
        for (const Photon& p : photons) {
            if (!counts(p) || (p.on_moss ? moss.site.empty() : p.back != 0)) continue;
            const std::size_t site = p.on_moss ? moss.site[p.target] : p.target;
            flux_[kind(p)][site] += p.flux;
            ++count_[site];
        }
        return;
    }

    // What hit moss counts where the moss stands.
    std::vector<std::uint32_t> chosen;
    chosen.reserve(photons.size());
    for (std::size_t i = 0; i < photons.size(); ++i)
        if (counts(photons[i])) chosen.push_back(static_cast<std::uint32_t>(i));
    std::vector<Vec3f> points(chosen.size());
    parallel_for(
        chosen.size(),
        [&](std::size_t i) {
            const Photon& p = photons[chosen[i]];
            points[i] = p.on_moss ? moss.point[p.target] : p.position;
        },
        16384);
    search_ = search_over(points, params);
    arrivals_.resize(points.size());
    beam_or_.resize(points.size());
    std::visit(
        [&](const auto& search) {
            parallel_for(
                points.size(),
                [&](std::size_t slot) {
                    const Photon& p = photons[chosen[search.points()[slot].index]];
                    arrivals_[slot] = {p.on_moss ? moss.normal[p.target] : p.normal, p.flux};
                    beam_or_[slot] = kind(p);
                },
                16384);
        },
        search_);
}

Irradiance PhotonMap::estimate(const Receivers& receivers, std::span<const std::uint32_t> order,
                               const Progress& progress) const
{
    const std::size_t n = receivers.size();
    Irradiance result;
    for (auto* part : {&result.beam, &result.sky, &result.indirect}) part->resize(n);
    result.photons.resize(n);
    auto put = [&](std::size_t i, float area, const std::array<double, 3>& sum,
                   std::int32_t count) {
        if (!(area > 0)) return;
        result.beam[i] = static_cast<float>(sum[0] / area);
        result.sky[i] = static_cast<float>(sum[1] / area);
        result.indirect[i] = static_cast<float>(sum[2] / area);
        result.photons[i] = count;
    };
    auto by_radius = [&](const auto& search) {
        const NumberedPoint* points = search.points().data();
        const auto radius = static_cast<float>(params_.photon_radius);
        sum_around<3>(
            search, receivers.position, receivers.normal, order, radius, sites_.slab(radius),
            [&](std::size_t slot) {
                return Counted{points[slot].at, arrivals_[slot].normal, arrivals_[slot].flux};
            },
            [&](std::size_t slot) { return beam_or_[slot]; },
            [&](std::size_t i, const std::array<double, 3>& sum, std::int32_t count) {
                put(i, receivers.kernel_area[i], sum, count);
            },
            progress);
    };
    auto by_nearest = [&](const auto& search) {
        const NumberedPoint* points = search.points().data();
        parallel_for_range(
            n,
            [&](std::size_t begin, std::size_t end) {
                progress.check();
                for (std::size_t i = begin; i < end; ++i) {
                    const Vec3f at = receivers.position[i], normal = receivers.normal[i];
                    const float radius = std::max(
                        kNearestLeast,
                        search.distance_to_nearest(at, params_.photon_nearest, kNearestMost));
                    const float half = sites_.slab(radius), per_radius = 1 / radius;
                    std::array<double, 3> sum{};
                    std::int32_t count = 0;
                    search.within_slots(at, radius, [&](std::size_t slot, float d2) {
                        const Arrival& p = arrivals_[slot];
                        if (dot(p.normal, normal) < kSameSide ||
                            std::abs(dot(points[slot].at - at, normal)) > half)
                            return;
                        sum[beam_or_[slot]] += p.flux * (1 - std::sqrt(d2) * per_radius);
                        ++count;
                    });
                    put(i, sites_.kernel_area(at, normal, radius), sum, count);
                }
            },
            kGrain);
    };
    std::visit(
        [&](const auto& search) {
            if (params_.photon_nearest > 0)
                by_nearest(search);
            else
                by_radius(search);
        },
        search_);
    return result;
}

Irradiance PhotonMap::by_site(const Progress& progress) const
{
    progress.check();
    Irradiance result{
        sites_.spread(flux_[0]), sites_.spread(flux_[1]), sites_.spread(flux_[2]), {}};
    result.photons = count_;
    return result;
}

Irradiance PhotonMap::at_sites(const Progress& progress) const
{
    if (params_.photon_estimator == PhotonEstimator::Site) return by_site(progress);
    return estimate({sites_.position(), sites_.normal(), sites_.kernel_area(), {}}, sites_.order(),
                    progress);
}

Irradiance PhotonMap::at(const Receivers& receivers, const Irradiance& at_sites,
                         const Progress& progress) const
{
    check_places(receivers.position, receivers.normal, receivers.kernel_area, "receiver");
    if (params_.photon_estimator == PhotonEstimator::Kernel)
        return estimate(receivers, neighbourly(receivers.position), progress);
    const std::size_t n = receivers.size();
    Irradiance result;
    for (auto* part : {&result.beam, &result.sky, &result.indirect}) part->resize(n);
    result.photons.resize(n);
    const std::vector<float> counts(count_.begin(), count_.end());
    parallel_for(
        n,
        [&](std::size_t i) {
            auto mean = [&](const std::vector<float>& values) {
                return static_cast<float>(
                    sites_.mean_around(receivers.position[i], receivers.normal[i], values));
            };
            result.beam[i] = mean(at_sites.beam);
            result.sky[i] = mean(at_sites.sky);
            result.indirect[i] = mean(at_sites.indirect);
            result.photons[i] = static_cast<std::int32_t>(mean(counts));
        },
        kGrain);
    return result;
}

std::vector<float> beam_by_rays(const PhotonScene& scene, const Daylight& daylight,
                                const Receivers& receivers, std::uint64_t seed, std::uint64_t day,
                                std::uint64_t salt, const Progress& progress)
{
    std::vector<float> result(receivers.size());
    struct Sun {
        Vec3d towards;
        double irradiance;
    };
    std::vector<Sun> suns;
    std::vector<double> upto;  // summed irradiances
    for (const auto& [towards, irradiance] : daylight.beams)
        if (towards.z > 0 && irradiance > 0) {
            suns.push_back({normalized(towards), irradiance});
            upto.push_back(irradiance + (upto.empty() ? 0 : upto.back()));
        }
    if (suns.empty()) return result;
    const std::uint64_t key = hash2(hash2(hash2(seed, kSunRays.id), day), salt);
    // A day's suns need one ray each; one that stands still gets several over its disc, and of
    // those of many days each place draws some, as many from each stretch of equal light.
    const bool drawn = suns.size() > kMostSunRays;
    const std::size_t rays =
        drawn ? kMostSunRays : (kLeastSunRays + suns.size() - 1) / suns.size() * suns.size();
    const std::size_t each = drawn ? 1 : rays / suns.size();
    static const double cap = cap_of_cone(kSunRadius);
    parallel_for_range(
        receivers.size(),
        [&](std::size_t begin, std::size_t end) {
            progress.check();
            for (std::size_t i = begin; i < end; ++i) {
                const Vec3d n(receivers.normal[i]);
                const std::int32_t plant = plant_of(receivers, i);
                const std::uint64_t place = hash2(key, i);
                double sum = 0;
                for (std::size_t k = 0; k < rays; ++k) {
                    double weight = 0, u = uniform_of_key(place, 2 * k);
                    const double v = uniform_of_key(place, 2 * k + 1);
                    const Sun* sun = nullptr;
                    if (drawn) {
                        const double light =
                            (static_cast<double>(k) + u) / static_cast<double>(rays) * upto.back();
                        const auto at = std::upper_bound(upto.begin(), upto.end() - 1, light);
                        sun = &suns[static_cast<std::size_t>(at - upto.begin())];
                        weight = upto.back() / static_cast<double>(rays);
                        u = uniform_of_key(place, 2 * rays + k);
                    } else {
                        sun = &suns[k / each];
                        weight = sun->irradiance / static_cast<double>(each);
                        u = (static_cast<double>(k % each) + u) / static_cast<double>(each);
                    }
                    const Vec3d towards = cap_direction(Frame(sun->towards), cap, u, v);
                    const double cosine = dot(n, towards);
                    if (!(cosine > 0)) continue;
                    Vec3f origin = scene.off_surface(Vec3d(receivers.position[i]), n);
                    if (plant >= 0) {
                        const auto& [centre, radius] =
                            scene.moss()[static_cast<std::size_t>(plant)];
                        origin = scene.off_surface(
                            Vec3d(centre) + towards * static_cast<double>(radius), towards);
                    }
                    if (!scene.occluded(origin, Vec3f(towards), plant >= 0)) sum += weight * cosine;
                }
                result[i] = static_cast<float>(sum);
            }
        },
        kGrain);
    return result;
}

void gather(const PhotonScene& scene, const Daylight& daylight, const Receivers& receivers,
            std::span<const float> at_sites, std::span<const float> at_plants,
            const PhotonParams& params, std::uint64_t seed, std::uint64_t day, std::uint64_t salt,
            Irradiance& result, const Progress& progress)
{
    const std::uint64_t key = hash2(hash2(seed, day), salt);
    const int rays = params.gather_rays;
    parallel_for_range(
        receivers.size(),
        [&](std::size_t begin, std::size_t end) {
            progress.check();
            for (std::size_t i = begin; i < end; ++i) {
                if (result.photons[i] >= params.gather_below) continue;
                const Vec3d n(receivers.normal[i]);
                const std::int32_t plant = plant_of(receivers, i);
                Vec3f origin = scene.off_surface(Vec3d(receivers.position[i]), n);
                if (plant >= 0) {
                    const auto& [centre, radius] = scene.moss()[static_cast<std::size_t>(plant)];
                    origin = scene.off_surface(Vec3d(centre) + n * static_cast<double>(radius), n);
                }
                // A lattice, shifted at random from place to place.
                const Frame frame(n);
                const double shift = uniform01(key, kGather, i, 0);
                const double turn = uniform01(key, kGather, i, 1);
                double sky = 0, surfaces = 0;
                for (int k = 0; k < rays; ++k) {
                    const double v = turn + k * 0.61803398874989485;
                    const Vec3f direction(
                        cosine_direction(frame, (k + shift) / rays, v - std::floor(v)));
                    PhotonScene::Hit hit;
                    if (!scene.intersect(origin, direction, hit, plant >= 0)) {
                        if (direction.z > 0) sky += daylight.sky;
                    } else if (hit.on_moss)
                        surfaces += at_plants[hit.target] * scene.albedo_of(true, hit.target);
                    else if (!hit.back)
                        surfaces += at_sites[hit.target] * scene.albedo_of(false, hit.target);
                }
                result.sky[i] = static_cast<float>(sky / rays);
                result.indirect[i] = static_cast<float>(surfaces / rays);
            }
        },
        8);
}

PhotonLight light_of_day(const PhotonScene& scene, const SiteKernel& sites,
                         const Daylight& daylight, std::span<const Photon> photons,
                         const MossHosts& moss, const Receivers& receivers,
                         const PhotonParams& params, std::uint64_t seed, std::uint64_t day,
                         const Progress& progress)
{
    if (!receivers.plant.empty() && receivers.plant.size() != receivers.size())
        throw InvalidInput(fmt::format("photons: {} receivers with {} plants, must be as many",
                                       receivers.size(), receivers.plant.size()));
    if (scene.sites() != sites.size())
        throw InvalidInput(fmt::format("photons: {} sites on {} triangles, must be as many",
                                       sites.size(), scene.sites()));
    for (std::size_t i = 0; i < receivers.plant.size(); ++i)
        if (receivers.plant[i] >= static_cast<std::int64_t>(scene.moss().size()))
            throw InvalidInput(
                fmt::format("photons: receiver {} is plant {}, of which there are {}", i,
                            receivers.plant[i], scene.moss().size()));
    const PhotonMap map(photons, moss, sites, params);
    PhotonLight light;
    light.sites = map.at_sites(progress);
    light.receivers = map.at(receivers, light.sites, progress);
    const Receivers all_sites{sites.position(), sites.normal(), sites.kernel_area(), {}};
    if (params.direct == DirectLight::Rays) {
        light.sites.beam = beam_by_rays(scene, daylight, all_sites, seed, day, 0, progress);
        light.receivers.beam = beam_by_rays(scene, daylight, receivers, seed, day, 1, progress);
    }
    if (!params.final_gather) return light;

    // Dim places light each other: the second look sees what the first one found. All look at what
    // was there before, so that the order of places plays no part.
    std::vector<float> at_sites(sites.size()), at_plants(scene.moss().size(), 0.0f);
    for (std::size_t i = 0; i < receivers.size(); ++i)
        if (const std::int32_t plant = plant_of(receivers, i); plant >= 0)
            at_plants[static_cast<std::size_t>(plant)] = light.receivers.total(i);
    auto look = [&](const Receivers& places, Irradiance& result, std::uint64_t salt) {
        for (std::size_t i = 0; i < at_sites.size(); ++i) at_sites[i] = light.sites.total(i);
        gather(scene, daylight, places, at_sites, at_plants, params, seed, day, salt, result,
               progress);
    };
    look(all_sites, light.sites, 0);
    look(all_sites, light.sites, 1);
    look(receivers, light.receivers, 2);
    return light;
}

void running_mean(std::span<float> mean, std::span<const float> today, int day, int days)
{
    const auto share = static_cast<float>(std::max(1, std::min(day, days)));
    for (std::size_t i = 0; i < mean.size(); ++i) mean[i] += (today[i] - mean[i]) / share;
}

}  // namespace sekitei::light
