#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <variant>
#include <vector>

#include "core/point_search.h"
#include "core/progress.h"
#include "core/vec.h"
#include "solvers/light/photons.h"

/// Irradiance from stored photons [Nomura2010, ch. 3].
///
///     S(x, n) = sum_p flux_p W(|x_p - x|) / sum_j a_j W(|x_j - x|),   W(d) = max(0, 1 - d / r)
///
/// over photons p and sites j whose normals lie within 60 degrees of n and which lie in a slab
/// along the surface, |(x_p - x) . n| <= r / 4 + 2 s, s the size of moss. The area below the line,
/// where density estimation puts pi r^2 / 3, makes it right at edges, at corners and on curved
/// rock.
namespace sekitei::light {

/// Sites as the kernel sees them: a function of the land, made once.
class SiteKernel {
public:
    /// Views the arrays, one element a site.
    /// @param moss_size  s [m], >= 0
    /// @param triangles  site i is triangle i: sites that are long beside the radius are cut for
    ///                   kernel_area(), where their centroids alone would be a poor sum; null:
    ///                   taken as points
    /// @throws InvalidInput  arrays of different lengths, positions that are not finite, normals
    ///                       that are not unit, areas that are not > 0
    SiteKernel(std::span<const Vec3f> position, std::span<const Vec3f> normal,
               std::span<const float> area, const PhotonParams& params, double moss_size,
               const TriMesh* triangles = nullptr);

    std::size_t size() const { return position_.size(); }
    std::span<const Vec3f> position() const { return position_; }
    std::span<const Vec3f> normal() const { return normal_; }
    std::span<const float> area() const { return area_; }
    double moss_size() const { return moss_size_; }
    /// Half width of the slab for a radius [m].
    float slab(float radius) const { return radius / 4 + 2 * static_cast<float>(moss_size_); }

    /// sum_j a_j W(|x_j - x|) [m^2]; 0 where no site is near.
    float kernel_area(Vec3f at, Vec3f normal, float radius) const;
    /// The same for many places, with photon_radius: what Receivers need.
    std::vector<float> kernel_area(std::span<const Vec3f> at, std::span<const Vec3f> normal) const;
    /// The same for the sites themselves; computed at construction.
    const std::vector<float>& kernel_area() const { return own_area_; }
    /// All sites, neighbours together.
    const std::vector<std::uint32_t>& order() const { return order_; }

    /// Spreads what fell on each site over its neighbourhood [W -> W/m^2]: S_i = c_i sum_j W_ij e_j
    /// flux_j with weights such that sum_i a_i S_i = sum_j flux_j, and that equal light stays
    /// equal, at edges too. The weights are found by alternate scaling at construction. Needs
    /// photon_estimator = site.
    std::vector<float> spread(std::span<const double> flux) const;
    /// Mean of values of sites around a place, weighted by a_j W; 0 where no site is near.
    double mean_around(Vec3f at, Vec3f normal, std::span<const float> values) const;

private:
    struct Patch {
        Vec3f normal;
        float area;
    };
    /// Pieces of the land in an order that finds them by place.
    struct Patches {
        std::variant<CellIndex, KdTree> search;
        std::vector<Patch> of_slot;
    };
    /// Calls f(slot, W) for the patches around a place.
    template <class F>
    void around(const Patches& patches, Vec3f at, Vec3f normal, float radius, F&& f) const;
    void cut(const TriMesh& triangles, const PhotonParams& params);
    std::vector<float> kernel_area(std::span<const Vec3f> at, std::span<const Vec3f> normal,
                                   std::span<const std::uint32_t> order) const;
    /// Calls f(site, W) for the sites that a site shares light with.
    template <class F>
    void partners(std::size_t site, F&& f) const;

    std::span<const Vec3f> position_, normal_;
    std::span<const float> area_;
    float radius_;
    double moss_size_;
    Patches whole_;  // the sites
    Patches cut_;    // the same, none long beside the radius; empty where they are so already
    std::vector<float> own_area_;
    std::vector<std::uint32_t> order_;
    std::vector<double> receive_, send_;  // c and e of spread()
};

/// What plants stand on: photons that hit plant i count as if they had hit this. Empty without
/// moss.
struct MossHosts {
    std::span<const Vec3f> point, normal;
    std::span<const std::uint32_t> site;  ///< used by photon_estimator = site alone
};

/// Places whose light is asked for, beside the sites.
struct Receivers {
    std::span<const Vec3f> position, normal;
    std::span<const float> kernel_area;  ///< SiteKernel::kernel_area()
    /// The ball of moss that is the receiver itself, or -1; empty: all -1. Rays from a plant start
    /// on its ball and meet other moss; all others pass through moss, as photons on it count for
    /// the ground.
    std::span<const std::int32_t> plant;

    std::size_t size() const { return position.size(); }
};

/// Light on places [W/m^2], 24-hour means, one element a place.
struct Irradiance {
    std::vector<float> beam, sky, indirect;
    std::vector<std::int32_t> photons;  ///< that the estimate rests on

    float total(std::size_t i) const { return beam[i] + sky[i] + indirect[i]; }
    std::size_t size() const { return beam.size(); }
};

/// Photons in an order that finds them by place.
class PhotonMap {
public:
    /// With direct = rays, first hits of photons of the sun are left out.
    /// @param sites  must outlive the map
    /// @throws InvalidInput  a photon on a site or plant that does not exist
    PhotonMap(std::span<const Photon> photons, const MossHosts& moss, const SiteKernel& sites,
              const PhotonParams& params);

    std::size_t size() const { return beam_or_.size(); }
    /// Memory held for each photon.
    static constexpr std::size_t bytes_per_photon();

    Irradiance at_sites(const Progress& progress) const;
    /// @param at_sites  of this map; needed by photon_estimator = site alone
    Irradiance at(const Receivers& receivers, const Irradiance& at_sites,
                  const Progress& progress) const;

private:
    struct Arrival {
        Vec3f normal;
        float flux;
    };
    Irradiance estimate(const Receivers& receivers, std::span<const std::uint32_t> order,
                        const Progress& progress) const;
    Irradiance by_site(const Progress& progress) const;

    const SiteKernel& sites_;
    PhotonParams params_;
    std::variant<CellIndex, KdTree> search_;
    std::vector<Arrival> arrivals_;      // by slot of the search
    std::vector<std::uint8_t> beam_or_;  // 0 beam, 1 sky, 2 indirect; by slot
    // Of photon_estimator = site: what fell on each site [W], and how often.
    std::array<std::vector<double>, 3> flux_;
    std::vector<std::int32_t> count_;
};

constexpr std::size_t PhotonMap::bytes_per_photon()
{
    return sizeof(NumberedPoint) + sizeof(Arrival) + sizeof(std::uint8_t);
}

/// The sun's own light, along shadow rays to its disc: sum_k E_k max(0, n . s_k) Vis(s_k), one ray
/// for each of many beams, 16 where there is one, and 512 drawn by their light where there are more
/// than that (2 to 3 % of noise).
/// @param salt  tells sets of receivers apart that share a day
std::vector<float> beam_by_rays(const PhotonScene& scene, const Daylight& daylight,
                                const Receivers& receivers, std::uint64_t seed, std::uint64_t day,
                                std::uint64_t salt, const Progress& progress);

/// Light of sky and surfaces at places with fewer than gather_below photons, by gather_rays cosine
/// weighted rays: albedo times the irradiance where each ends, G_d where it leaves upwards.
/// @param at_sites, at_plants  irradiance where rays end; by site and by ball of moss
/// @param salt                 tells sets of receivers apart that share a day
/// @param result               of the receivers; sky and indirect are replaced there
void gather(const PhotonScene& scene, const Daylight& daylight, const Receivers& receivers,
            std::span<const float> at_sites, std::span<const float> at_plants,
            const PhotonParams& params, std::uint64_t seed, std::uint64_t day, std::uint64_t salt,
            Irradiance& result, const Progress& progress);

struct PhotonLight {
    Irradiance sites, receivers;
};

/// All of the above, as the params say.
/// @param photons    of shoot()
/// @param receivers  plants, seeds, anything
/// @throws InvalidInput  arrays of different lengths
///
/// Bit-identical for any number of threads.
PhotonLight light_of_day(const PhotonScene& scene, const SiteKernel& sites,
                         const Daylight& daylight, std::span<const Photon> photons,
                         const MossHosts& moss, const Receivers& receivers,
                         const PhotonParams& params, std::uint64_t seed, std::uint64_t day,
                         const Progress& progress);

/// A running mean over days: mean += (today - mean) / min(day, days). The first day sets it.
/// @param day  1, 2, ...
void running_mean(std::span<float> mean, std::span<const float> today, int day, int days);

}  // namespace sekitei::light
