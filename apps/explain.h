#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "core/params.h"
#include "grids/scene.h"
#include "solvers/moss/growth.h"

/// Why a moss does or does not grow at a place: the climate a scene has there, each factor of each
/// species' fitness, and which one limits. `sekitei explain` prints it, and the pages of
/// `sekitei view` hold it for every place.
namespace sekitei::apps {

/// A number that is known of every place.
struct Measure {
    std::string name;         ///< of the grid or attribute; "wind_speed"
    std::string label, unit;  ///< for people
    std::function<double(std::size_t place)> value;
};

/// What one species makes of a place, at the means of its climate.
struct Verdict {
    moss::Fitness fitness;
    int limiting = 0;            ///< index into kFactors
    bool grows = false;          ///< G is above the species' threshold
    std::optional<double> mean;  ///< of every day's G, where the moss stage left it
};
inline constexpr std::array<const char*, 4> kFactors{"temperature", "humidity", "light", "gate"};

/// A moss that stands on a place.
struct Growing {
    std::string name;
    double growth = 0;
    int days = 0;
};

/// The places of a scene that have a climate: surface cells of a volume or sites of a mesh.
/// The scene must outlive it.
class Explainer {
public:
    /// @param file   for messages
    /// @param sites  sites of a mesh are meant although the scene may have none
    /// @throws InvalidInput  a surface without a climate, no sites
    Explainer(const Scene& scene, const std::string& file, bool sites);

    bool of_mesh() const { return mesh_; }
    std::size_t size() const { return position_.size(); }
    Vec3d position(std::size_t place) const { return position_[place]; }
    Vec3f normal(std::size_t place) const { return normal_[place]; }
    double area(std::size_t place) const { return double(area_[place]); }  ///< [m^2]
    /// "cell", "face 12"
    std::string name(std::size_t place) const;
    /// The place whose position is nearest; the first of several.
    std::size_t nearest(Vec3d point) const;

    /// In the order they are told, of what the scene has.
    const std::vector<Measure>& measures() const { return measures_; }
    /// Share of the inflow that wind from each of the eight directions has here.
    bool has_wind() const { return !wind_.empty(); }
    double wind_ratio(std::size_t place, int direction) const
    {
        return wind_[std::size_t(direction)](place);
    }

    /// Those of the moss stage, else the presets; empty where the climate is not known.
    const std::vector<moss::Species>& species() const { return species_; }
    Verdict verdict(std::size_t place, std::size_t species) const;

    /// Whether the scene says what grows.
    bool knows_moss() const { return knows_moss_; }
    std::vector<Growing> growing(std::size_t place) const;

private:
    std::function<double(std::size_t)> values_of(const std::string& name) const;
    bool known(const std::string& name) const;
    void find_measures(const Scene& scene);
    void find_species(const Scene& scene);
    void find_mosses();

    const Scene& scene_;
    bool mesh_, knows_moss_ = false;
    std::vector<Vec3d> position_;
    std::vector<Vec3f> normal_;
    std::vector<float> area_;
    std::vector<Coord> voxel_;  ///< of cells
    std::vector<Measure> measures_;
    std::vector<std::function<double(std::size_t)>> wind_;
    std::vector<moss::Species> species_;
    moss::Rules rules_;
    std::function<double(std::size_t)> warmth_, humidity_, light_;  ///< what fitness is made of
    std::vector<std::function<double(std::size_t)>> suit_;          ///< of each species, or null
    std::vector<std::string> names_;                                ///< of the moss stage's species
    std::multimap<std::int64_t, std::size_t> on_site_;              ///< mosses of a mesh, in order
};

/// As `sekitei explain` prints it.
/// @param asked  the point that was asked for, if one was
std::string explain_text(const Explainer& explainer, std::size_t place,
                         const std::optional<Vec3d>& asked);
Json explain_json(const Explainer& explainer, std::size_t place, const std::optional<Vec3d>& asked);

}  // namespace sekitei::apps
