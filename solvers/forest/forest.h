#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "core/params.h"
#include "core/progress.h"
#include "core/vec.h"
#include "solvers/forest/edits.h"
#include "solvers/forest/land.h"
#include "solvers/forest/raster.h"
#include "solvers/forest/species.h"

/// Forests that sort themselves into layers [Mizoguchi2008].
///
/// Every tree claims a cone of space that no other may have, apex at its foot. Cones are drawn into
/// slices of 1 m; where two meet, the bigger tree keeps the space. R, the share of its own cone
/// that a tree keeps, weighted by the density maps, is its growth: from r2 on it grows, from r1 on
/// it stands still, below it dies. Grown trees sow around themselves.
///
/// One unit everywhere: a pixel of a slice. Maps are 16-bit, sums of space are integers and every
/// pixel's order depends on the trees alone, so results are the same bits for any size of tiles and
/// any number of threads.
namespace sekitei::forest {

enum class Orientation {
    Inverted,  ///< r(z) = z t, apex at the foot: small trees find room under large ones
    Upright,   ///< r(z) = (H - z) t; a control
    Flat       ///< r = H t; a control: no layers
};
constexpr std::array<std::string_view, 3> choice_names(Orientation)
{
    return {"inverted", "upright", "flat"};
}
enum class Border {
    Clip,  ///< seeds that fall outside are lost
    Wrap   ///< east meets west, north meets south
};
constexpr std::array<std::string_view, 2> choice_names(Border)
{
    return {"clip", "wrap"};
}
enum class Method {
    Columns,  ///< a bit mask a pixel, trees from large to small; the default
    Painter  ///< draws every circle of every slice from small to large, as the paper does: to check
};
constexpr std::array<std::string_view, 2> choice_names(Method)
{
    return {"columns", "painter"};
}
enum class SliceFrame {
    Ground,   ///< slices follow the ground
    Absolute  ///< cones stand upright on slopes; their slices are counted from each pixel's ground
};
constexpr std::array<std::string_view, 2> choice_names(SliceFrame)
{
    return {"ground", "absolute"};
}

struct Params {
    double pixel = 1;
    int slices = 20, band = 4;
    double r1 = 0.15, r2 = 0.25;
    double seed_factor = 1.5, seeds_per_step = 0.5, maturity = 0.9, seedling_height = 1.0;
    SpreadMode spread_mode = SpreadMode::ApexAngle;
    Orientation orientation = Orientation::Inverted;
    Border border = Border::Clip;
    Method method = Method::Columns;
    SliceFrame slice_frame = SliceFrame::Ground;
    int tile = 256;
    double max_trees = 5e7;
    double windthrow = 0, wind_reference = 20;

    static void describe(auto&& field)
    {
        field("pixel", &Params::pixel, "m", between(1e-3, 1e3), "edge of the pixels of space");
        field("slices", &Params::slices, "", between(1, 64), "slices of space, 1 m apart");
        field("band", &Params::band, "", between(1, 64), "slices that share one density map");
        field("r1", &Params::r1, "", kFraction, "a tree that keeps less of its space dies");
        field("r2", &Params::r2, "", kFraction, "a tree that keeps less stands still");
        field("seed_factor", &Params::seed_factor, "", kNotNegative,
              "farthest seed, in heights of the tree");
        field("seeds_per_step", &Params::seeds_per_step, "", between(0, 1000),
              "mean number of seedlings of a grown tree");
        field("maturity", &Params::maturity, "", kFraction,
              "share of its greatest height from which a tree sows");
        field("seedling_height", &Params::seedling_height, "m", between(1e-3, 64),
              "height of a seedling");
        field("spread_mode", &Params::spread_mode, "what the spread of a species means");
        field("orientation", &Params::orientation,
              "inverted: cones with the apex at the foot; upright and flat: controls");
        field("border", &Params::border, "clip: seeds outside are lost; wrap: the domain repeats");
        field("method", &Params::method, "columns, or painter: the slow reference");
        field("slice_frame", &Params::slice_frame,
              "on terrain: slices that follow the ground, or upright cones");
        field("tile", &Params::tile, "", between(16, 65536),
              "edge of the tiles that threads work on, in pixels; results do not depend on it");
        field("max_trees", &Params::max_trees, "", kPositive, "stops after a step with more");
        field("windthrow", &Params::windthrow, "", kFraction,
              "probability in a step that a tree of 20 m falls in wind of wind_reference; 0: none");
        field("wind_reference", &Params::wind_reference, "m/s", kPositive,
              "with windthrow: its wind");
    }
};

/// @throws InvalidParameter
void validate(const Params& params);

struct Tree {
    double x = 0, y = 0, height = 1;  ///< [m]
    std::uint64_t uid = 0;
    std::uint64_t kept = 0;    ///< V: sum of the density maps over what it kept, in 1 / 65535
    std::uint32_t cone = 0;    ///< Vmax: pixels of its own cone within the domain
    std::uint16_t age = 0;     ///< steps
    std::uint8_t species = 0;  ///< from 0
    std::uint8_t spare = 0;    ///< so that files have no byte without a value

    /// R of the step before; 0 before the first.
    double share() const { return cone == 0 ? 0 : double(kept) / (65535.0 * double(cone)); }
};

/// Larger first: greater height, then greater age, then smaller uid.
inline bool bigger(const Tree& a, const Tree& b)
{
    if (a.height != b.height) return a.height > b.height;
    if (a.age != b.age) return a.age > b.age;
    return a.uid < b.uid;
}

enum class Cause { Competition, Environment, Age, Wind, Felled };
inline constexpr int kCauses = 5;
constexpr std::array<std::string_view, kCauses> choice_names(Cause)
{
    return {"competition", "environment", "age", "wind", "felled"};
}

/// Counts of one step, taken after deaths and before seedlings.
struct StepStatistics {
    static constexpr int kClasses = 4;
    /// Upper ends of the height classes [m]; the last has none.
    static constexpr std::array<double, 3> kClassEnds{3, 8, 12};

    int step = 0;
    std::uint64_t trees = 0;
    std::uint64_t births = 0;  ///< seedlings of this step
    std::uint64_t lost = 0;    ///< seeds that fell outside or where none may stand
    std::array<std::uint64_t, kCauses> deaths{};
    std::vector<std::array<std::uint64_t, kClasses>> counts;  ///< by species and class
    double mean_share = 0;                                    ///< of R
    double seconds_draw = 0, seconds_grow = 0;

    std::uint64_t of_class(int k) const
    {
        std::uint64_t sum = 0;
        for (const auto& c : counts) sum += c[std::size_t(k)];
        return sum;
    }
};

/// A tree that the wind threw.
struct Fallen {
    std::uint64_t uid = 0;
    int step = 0, species = 0;
    double x = 0, y = 0;  ///< foot [m]
    double azimuth = 0;   ///< it fell to, from east to north [rad]
    double length = 0;    ///< [m]
};

/// Wind over the forest: the vector [m/s] at a place and height above its ground.
using WindField = std::function<Vec3d(double x, double y, double height)>;

struct Inputs {
    double width = 512, depth = 512;  ///< [m], multiples of the pixel
    Params params;
    std::vector<Species> species;
    Land land;
    std::vector<DensityMap> density;  ///< one a band; empty: 1 everywhere
    std::vector<Edit> edits;          ///< ordered by step
    WindField wind;                   ///< of windthrow
    std::uint64_t seed = 1;

    int pixels_x() const;
    int pixels_y() const;
    int bands() const { return (params.slices + params.band - 1) / params.band; }
};

/// @throws InvalidParameter, InvalidInput  naming what does not fit
void validate(const Inputs& inputs);

enum class Status { Growing, Extinct, Limit };

/// Where the trees of a forest too large for memory wait between their turns: one block of bytes
/// for each row of tiles. The caller keeps files.
class RowStore {
public:
    virtual ~RowStore() = default;
    virtual std::string load(int step, int row) = 0;
    virtual void save(int step, int row, const std::string& bytes) = 0;
    /// All rows of a step are saved: those of earlier steps are not needed any more.
    virtual void complete(int step) = 0;
};

/// Calls f(tree, i, j, slices) with the slices (bit k - 1 for slice k) that a tree keeps in pixel
/// (i, j), for one tile, trees from large to small.
using OwnedVisitor = std::function<void(const Tree& tree, int i, int j, std::uint64_t slices)>;

class Forest {
public:
    /// @throws InvalidParameter, InvalidInput
    explicit Forest(Inputs inputs);
    /// One that keeps only a few rows of tiles in memory, see RowStore; `inputs.params.border` must
    /// be Clip. `store` must outlive it.
    Forest(Inputs inputs, RowStore& store);
    ~Forest();
    Forest(Forest&&) = default;
    Forest(const Forest&) = delete;
    Forest& operator=(const Forest&) = delete;

    /// Sows `counts[s]` trees of species s: anywhere, 1 m to min(3, Hmax) high, before the first
    /// step.
    /// @return  how many found no place where they may stand and were left out
    std::uint64_t sow(const std::vector<std::uint64_t>& counts);
    /// Adds trees of a list, before the first step.
    /// @return  number outside the domain, which are left out
    /// @throws InvalidInput  height <= 0 or not finite, unknown species, a uid that is there
    /// already
    std::uint64_t plant(std::span<const NewTree> trees);
    /// Trees as they were after a step, to go on from there.
    /// @throws InvalidInput  a tree outside the domain, of no species or of no height
    void resume(int step, std::vector<Tree> trees);
    /// The same for trees that the store keeps.
    void resume(int step);

    int step() const { return step_; }  ///< number of steps done
    /// One step: edits; order; space; shares; deaths; growth; ages; seeds. All but the edits and
    /// the heights of those that sow read the state before the step.
    /// @throws Cancelled     from `progress`, between tiles; the forest is then of no use any more
    /// @throws InvalidInput  an edit plants a uid that is there already
    StepStatistics advance(const Progress& progress = {});
    /// Adds an edit, e.g. of a map painted meanwhile; those of steps done change nothing.
    void add_edit(Edit edit);

    std::uint64_t size() const { return size_; }
    const Inputs& inputs() const { return inputs_; }
    double slope(int species) const { return slope_[std::size_t(species)]; }  ///< r / z
    const std::vector<DensityMap>& density() const { return density_; }       ///< now
    const std::vector<Fallen>& fallen() const
    {
        return fallen_;
    }  ///< of all steps, by step and uid

    /// Calls f with all trees, strip after strip northwards, by pixel row, pixel column and uid: an
    /// order that no size of tiles changes.
    void visit(const std::function<void(std::span<const Tree>)>& f) const;
    std::vector<Tree> trees() const;
    /// All trees, the biggest first: place in it + 1 is the rank.
    std::vector<Tree> ranked() const;

    /// @name Space that trees keep, by their present heights. Not with a store.
    int tiles() const { return tiles_x_ * tiles_y_; }
    /// The pixels [i0, i1) x [j0, j1) of a tile.
    std::array<int, 4> tile_bounds(int tile) const;
    /// From any number of threads, one a tile. `tree` lives as long as the forest does not change.
    void visit_owned(int tile, const OwnedVisitor& f) const;
    /// Pixels of a tree's own cone within the domain, by slice (index k - 1).
    std::vector<std::uint32_t> footprint(const Tree& tree) const;
    /// Rank that owns each pixel of each slice, 0 where nobody: [slice][j][i]. For small forests.
    std::vector<std::uint32_t> occupancy(Method method) const;

    std::size_t memory_bytes() const;  ///< of trees and maps

private:
    struct Work;
    void make(RowStore* store);
    int tile_of(double x, double y) const;
    int pixel_of(double at, int count) const;
    void add(const Tree& tree);
    void begin_step(Work& work);
    void edit_tiles(Work& work, int first, int last);
    std::vector<struct Claim> claims_of(int tile) const;
    void draw_tile(const struct Canvas& canvas, int tile);
    void draw_all_painted(const struct Canvas& canvas);
    void grow_tile(Work& work, int tile);
    void settle(Work& work, int tile);
    void advance_in_memory(Work& work, const Progress& progress);
    void advance_by_rows(Work& work, const Progress& progress);
    void load_row(int step, int row);
    void save_row(int step, int row);

    Inputs inputs_;
    RowStore* store_ = nullptr;
    std::vector<DensityMap> density_;
    std::vector<double> slope_;  // r / z by species
    int step_ = 0;
    std::uint64_t size_ = 0;
    int nx_ = 0, ny_ = 0, tiles_x_ = 0, tiles_y_ = 0;
    int halo_ = 1;       // tiles that a crown may reach beyond its own
    int seed_halo_ = 1;  // the same of seeds
    std::vector<std::vector<Tree>> tile_;
    std::vector<Fallen> fallen_;
};

}  // namespace sekitei::forest
