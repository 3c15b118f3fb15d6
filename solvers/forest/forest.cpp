#include "solvers/forest/forest.h"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <bit>
#include <chrono>
#include <cmath>
#include <cstring>
#include <mutex>
#include <optional>
#include <unordered_map>

#include "core/error.h"
#include "core/hash.h"
#include "core/math.h"
#include "core/parallel.h"
#include "core/random.h"
#include "solvers/forest/draw.h"

namespace sekitei::forest {
namespace {

// Draws of a seed lot besides those of its seedlings, which count from 0.
constexpr std::uint64_t kCount = 0xFFFF, kGust = 0xFFFE;

/// R as a whole number, so that sums do not depend on their order.
std::uint64_t fixed(double share)
{
    return static_cast<std::uint64_t>(share * 0x1p32);
}

bool lies_before(const Tree& a, const Tree& b, double pixel)
{
    const double ja = std::floor(a.y / pixel), jb = std::floor(b.y / pixel);
    if (ja != jb) return ja < jb;
    const double ia = std::floor(a.x / pixel), ib = std::floor(b.x / pixel);
    if (ia != ib) return ia < ib;
    return a.uid < b.uid;
}

/// Makes room for more without doubling: trees are what memory is full of.
void make_room(std::vector<Tree>& list, std::size_t more)
{
    const std::size_t wanted = list.size() + more;
    if (wanted > list.capacity()) list.reserve(wanted + wanted / 16);
}

/// Empties a list and gives its memory back, which clear() and `= {}` keep.
template <class T>
void give_back(std::vector<T>& list)
{
    std::vector<T>().swap(list);
}

int whole_pixels(double length, double pixel)
{
    return int(std::lround(length / pixel));
}

[[noreturn]] void reject(const std::string& key, double value, const std::string& expected)
{
    throw InvalidParameter(fmt::format("forest: {} = {}, must be {}", key, value, expected));
}

}  // namespace

/// What a step needs and leaves.
struct Forest::Work {
    struct Part {
        std::uint64_t trees = 0, births = 0, lost = 0, share = 0;
        std::array<std::uint64_t, kCauses> deaths{};
        std::vector<std::array<std::uint64_t, StepStatistics::kClasses>> counts;
        std::vector<Fallen> fallen;
        std::vector<std::pair<int, Tree>> seeds;  ///< and the tiles they fall into
    };
    int step = 0;
    std::vector<Edit> edits;
    std::vector<Part> parts;                             ///< by tile
    std::vector<std::vector<Tree>> pending;              ///< seedlings by tile
    std::unordered_map<std::uint64_t, NewTree> planted;  ///< of this step, by uid
    double seconds_draw = 0, seconds_grow = 0;
};

int Inputs::pixels_x() const
{
    return whole_pixels(width, params.pixel);
}
int Inputs::pixels_y() const
{
    return whole_pixels(depth, params.pixel);
}

void validate(const Params& params)
{
    validate_described("forest", params);
    if (params.r1 > params.r2) reject("r1", params.r1, fmt::format("at most r2 = {}", params.r2));
}

void validate(const Inputs& inputs)
{
    validate(inputs.params);
    const double p = inputs.params.pixel;
    for (const double length : {inputs.width, inputs.depth}) {
        if (!(length > 0) || !std::isfinite(length)) reject("size", length, "> 0 m");
        if (length / p > 131072) reject("size", length, fmt::format("at most {} m", 131072 * p));
        if (std::abs(std::round(length / p) * p - length) > 1e-9 * length)
            reject("size", length, fmt::format("a multiple of the pixel, {} m", p));
    }
    if (inputs.species.empty() || inputs.species.size() > 255)
        reject("species", double(inputs.species.size()), "1 to 255 kinds");
    double reach = 0;
    for (const Species& s : inputs.species) {
        validate(s, inputs.params.spread_mode);
        reach = std::max(reach, s.max_height * slope_of(s, inputs.params.spread_mode));
    }
    if (inputs.params.border == Border::Wrap &&
        2 * reach + 2 * p > std::min(inputs.width, inputs.depth))
        throw InvalidParameter(
            fmt::format("forest: border = wrap: crowns of {:.4g} m would meet themselves in a "
                        "domain of {} x {} "
                        "m; make it larger",
                        2 * reach, inputs.width, inputs.depth));
    if (!inputs.density.empty() && int(inputs.density.size()) != inputs.bands())
        throw InvalidParameter(fmt::format(
            "forest: {} density maps, must be {}: one for each {} of {} slices",
            inputs.density.size(), inputs.bands(), inputs.params.band, inputs.params.slices));
    auto fits = [&](const auto& raster, const std::string& name) {
        if (!raster.empty() &&
            (raster.width() != inputs.pixels_x() || raster.depth() != inputs.pixels_y()))
            throw InvalidInput(fmt::format("forest: {}: {} x {} pixels, must be {} x {}", name,
                                           raster.width(), raster.depth(), inputs.pixels_x(),
                                           inputs.pixels_y()));
    };
    for (std::size_t b = 0; b < inputs.density.size(); ++b)
        fits(inputs.density[b], fmt::format("density map {}", b + 1));
    fits(inputs.land.ground, "terrain");
    fits(inputs.land.plantable, "plantable");
    fits(inputs.land.blocked_height, "blocked_height");
    for (const Factor& factor : inputs.land.factors) fits(factor.value, factor.name);
    if (inputs.params.windthrow > 0 && !inputs.wind)
        throw InvalidParameter("forest: windthrow without a wind; give one, or windthrow = 0");
}

Forest::Forest(Inputs inputs) : inputs_(std::move(inputs))
{
    make(nullptr);
}

Forest::Forest(Inputs inputs, RowStore& store) : inputs_(std::move(inputs))
{
    if (inputs_.params.border != Border::Clip)
        throw InvalidParameter("forest: border = wrap does not go with a forest out of core");
    if (inputs_.params.method != Method::Columns)
        throw InvalidParameter("forest: method = painter does not go with a forest out of core");
    make(&store);
}

Forest::~Forest() = default;

void Forest::make(RowStore* store)
{
    validate(inputs_);
    store_ = store;
    nx_ = inputs_.pixels_x();
    ny_ = inputs_.pixels_y();
    const int edge = inputs_.params.tile;
    tiles_x_ = (nx_ + edge - 1) / edge;
    tiles_y_ = (ny_ + edge - 1) / edge;
    tile_.resize(std::size_t(tiles()));
    double crown = 0, seed = 0;
    for (const Species& s : inputs_.species) {
        slope_.push_back(slope_of(s, inputs_.params.spread_mode));
        crown = std::max(crown, std::max(1.0, s.max_height) * slope_.back());
        seed = std::max(seed, std::max(s.max_height, inputs_.params.seedling_height) *
                                  inputs_.params.seed_factor);
    }
    const double metres = double(edge) * inputs_.params.pixel;
    // A pixel more: the trunk's pixel is claimed wherever its centre lies.
    halo_ = int(std::min(double(std::max(tiles_x_, tiles_y_)),
                         std::ceil((crown + inputs_.params.pixel) / metres)));
    seed_halo_ = int(std::min(double(tiles_y_), std::ceil(seed / metres)));
    density_ = inputs_.density;
    if (density_.empty())
        density_.assign(std::size_t(inputs_.bands()), DensityMap(nx_, ny_, 65535));
    inputs_.density.clear();
    inputs_.land.pixel = inputs_.params.pixel;
    inputs_.land.bind(inputs_.species);
    std::ranges::stable_sort(inputs_.edits, {}, &Edit::step);
}

int Forest::pixel_of(double at, int count) const
{
    return std::clamp(int(std::floor(at / inputs_.params.pixel)), 0, count - 1);
}

int Forest::tile_of(double x, double y) const
{
    const int edge = inputs_.params.tile;
    return pixel_of(y, ny_) / edge * tiles_x_ + pixel_of(x, nx_) / edge;
}

std::array<int, 4> Forest::tile_bounds(int tile) const
{
    const int edge = inputs_.params.tile, i0 = tile % tiles_x_ * edge, j0 = tile / tiles_x_ * edge;
    return {i0, std::min(nx_, i0 + edge), j0, std::min(ny_, j0 + edge)};
}

void Forest::add(const Tree& tree)
{
    std::vector<Tree>& list = tile_[std::size_t(tile_of(tree.x, tree.y))];
    make_room(list, 1);
    list.push_back(tree);
    ++size_;
}

std::uint64_t Forest::sow(const std::vector<std::uint64_t>& counts)
{
    auto tree_at = [&](std::size_t s, std::uint64_t i) {
        Tree tree;
        tree.uid = hash2(inputs_.seed, ((s + 1) << 32) + i);
        tree.x = inputs_.width * uniform_of_key(tree.uid, 0);
        tree.y = inputs_.depth * uniform_of_key(tree.uid, 1);
        const double most = std::min(3.0, inputs_.species[s].max_height);
        tree.height = 1 + uniform_of_key(tree.uid, 2) * (most - 1);
        tree.species = static_cast<std::uint8_t>(s);
        return tree;
    };
    auto each = [&](auto&& f) {
        for (std::size_t s = 0; s < counts.size() && s < inputs_.species.size(); ++s)
            for (std::uint64_t i = 0; i < counts[s]; ++i) f(tree_at(s, i));
    };
    // Tiles that grow tree by tree would leave memory in pieces.
    std::vector<std::size_t> room(tile_.size(), 0);
    each([&](const Tree& tree) { ++room[std::size_t(tile_of(tree.x, tree.y))]; });
    for (std::size_t t = 0; t < tile_.size(); ++t) tile_[t].reserve(tile_[t].size() + room[t]);
    std::uint64_t left_out = 0;
    each([&](const Tree& tree) {
        if (inputs_.land.admits(tree.species, pixel_of(tree.x, nx_), pixel_of(tree.y, ny_)))
            add(tree);
        else
            ++left_out;
    });
    return left_out;
}

namespace {

Tree tree_of(const NewTree& from, const Inputs& inputs)
{
    if (from.species < 0 || from.species >= int(inputs.species.size()))
        throw InvalidInput(fmt::format("forest: tree {:016x} is of species {}, there are {}",
                                       from.uid, from.species + 1, inputs.species.size()));
    if (!(from.height > 0) || !std::isfinite(from.height))
        throw InvalidInput(
            fmt::format("forest: tree {:016x} is {} m high, must be > 0", from.uid, from.height));
    Tree tree;
    tree.uid = from.uid;
    tree.x = from.x;
    tree.y = from.y;
    tree.height = std::min(from.height, inputs.species[std::size_t(from.species)].max_height);
    tree.species = static_cast<std::uint8_t>(from.species);
    return tree;
}

bool within(double x, double y, const Inputs& inputs)
{
    return x >= 0 && x < inputs.width && y >= 0 && y < inputs.depth;
}

/// Whether a tree of a file can be one of this forest.
bool belongs(const Tree& tree, const Inputs& inputs)
{
    return within(tree.x, tree.y, inputs) && tree.species < inputs.species.size() &&
           tree.height > 0 && tree.height <= std::max(1.0, inputs.species[tree.species].max_height);
}

[[noreturn]] void reject_twins(std::uint64_t uid, double ax, double ay, double bx, double by)
{
    throw InvalidInput(fmt::format(
        "forest: two trees have the uid {:016x}: at ({:.6g}, {:.6g}) and at ({:.6g}, {:.6g}) m",
        uid, ax, ay, bx, by));
}

}  // namespace

std::uint64_t Forest::plant(std::span<const NewTree> trees)
{
    std::unordered_map<std::uint64_t, std::array<double, 2>> places;
    std::uint64_t outside = 0;
    for (const NewTree& tree : trees) {
        const auto [found, fresh] = places.try_emplace(tree.uid, std::array{tree.x, tree.y});
        if (!fresh) reject_twins(tree.uid, found->second[0], found->second[1], tree.x, tree.y);
    }
    for (const auto& tile : tile_)
        for (const Tree& there : tile)
            if (const auto found = places.find(there.uid); found != places.end())
                reject_twins(there.uid, there.x, there.y, found->second[0], found->second[1]);
    for (const NewTree& tree : trees) {
        const Tree made = tree_of(tree, inputs_);
        if (within(tree.x, tree.y, inputs_))
            add(made);
        else
            ++outside;
    }
    return outside;
}

void Forest::resume(int step, std::vector<Tree> trees)
{
    for (auto& tile : tile_) tile.clear();
    size_ = 0;
    step_ = step;
    for (const Tree& tree : trees) {
        if (!belongs(tree, inputs_))
            throw InvalidInput(fmt::format(
                "forest: tree {:016x} at ({}, {}) m, {} m high, of species {}: not of this forest",
                tree.uid, tree.x, tree.y, tree.height, tree.species + 1));
        add(tree);
    }
    for (const Edit& edit : inputs_.edits)
        if (edit.step <= step) apply(edit, density_, inputs_.params.pixel);
}

void Forest::resume(int step)
{
    resume(step, {});
    for (int row = 0; row < tiles_y_; ++row) {
        load_row(step, row);
        for (int i = 0; i < tiles_x_; ++i) {
            auto& tile = tile_[std::size_t(row * tiles_x_ + i)];
            size_ += tile.size();
            give_back(tile);
        }
    }
}

void Forest::add_edit(Edit edit)
{
    const auto place = std::ranges::upper_bound(inputs_.edits, edit.step, {}, &Edit::step);
    inputs_.edits.insert(place, std::move(edit));
}

// --- Space -------------------------------------------------------------------------------------

namespace {

/// Puts the biggest first. Whole numbers decide nearly always: heights as bits, which ascend with
/// positive numbers, then the age and most of the uid.
void sort_claims(std::vector<Claim>& claims)
{
    struct Key {
        std::uint64_t height, rest;
        std::uint32_t place;
    };
    std::vector<Key> keys(claims.size());
    for (std::size_t c = 0; c < claims.size(); ++c) {
        const Tree& tree = *claims[c].tree;
        keys[c] = {std::bit_cast<std::uint64_t>(tree.height),
                   std::uint64_t(tree.age) << 48 | ~tree.uid >> 16, static_cast<std::uint32_t>(c)};
    }
    std::ranges::sort(keys, [&](const Key& a, const Key& b) {
        if (a.height != b.height) return a.height > b.height;
        if (a.rest != b.rest) return a.rest > b.rest;
        const Claim &first = claims[a.place], &second = claims[b.place];
        if (first.tree != second.tree) return bigger(*first.tree, *second.tree);
        return a.place < b.place;  // images of one tree
    });
    std::vector<Claim> sorted(claims.size());
    for (std::size_t c = 0; c < keys.size(); ++c) sorted[c] = claims[keys[c].place];
    claims = std::move(sorted);
}

Claim claim_of(const Tree& tree, const Inputs& inputs, int shift_x, int shift_y)
{
    const double p = inputs.params.pixel;
    const int nx = inputs.pixels_x(), ny = inputs.pixels_y();
    return {tree.height,
            tree.x + double(shift_x) * inputs.width,
            tree.y + double(shift_y) * inputs.depth,
            std::clamp(int(std::floor(tree.x / p)), 0, nx - 1) + shift_x * nx,
            std::clamp(int(std::floor(tree.y / p)), 0, ny - 1) + shift_y * ny,
            &tree};
}

}  // namespace

std::vector<Claim> Forest::claims_of(int tile) const
{
    const auto box = tile_bounds(tile);
    const int i0 = box[0], i1 = box[1], j0 = box[2], j1 = box[3];
    const double p = inputs_.params.pixel;
    const Canvas canvas(inputs_.params, inputs_.land, density_, slope_, nx_, ny_);
    const bool wraps = inputs_.params.border == Border::Wrap;
    std::vector<Claim> claims;
    claims.reserve(tile_[std::size_t(tile)].size() * 5 / 4);
    auto gather = [&](const std::vector<Tree>& trees, int shift_x, int shift_y) {
        for (const Tree& tree : trees) {
            const double r = canvas.radius(tree) + p;
            const double x = tree.x + double(shift_x) * inputs_.width,
                         y = tree.y + double(shift_y) * inputs_.depth;
            if (x + r < i0 * p || x - r > i1 * p || y + r < j0 * p || y - r > j1 * p) continue;
            claims.push_back(claim_of(tree, inputs_, shift_x, shift_y));
        }
    };
    // A few small tiles may be reached several times around a domain that wraps.
    const int tx = tile % tiles_x_, ty = tile / tiles_x_;
    for (int y = ty - halo_; y <= ty + halo_; ++y)
        for (int x = tx - halo_; x <= tx + halo_; ++x) {
            if (!wraps) {
                if (x >= 0 && x < tiles_x_ && y >= 0 && y < tiles_y_)
                    gather(tile_[std::size_t(y * tiles_x_ + x)], 0, 0);
                continue;
            }
            const int shift_x = x < 0           ? -1
                                : x >= tiles_x_ ? 1
                                                : 0,
                      shift_y = y < 0           ? -1
                                : y >= tiles_y_ ? 1
                                                : 0;
            const int at_x = x - shift_x * tiles_x_, at_y = y - shift_y * tiles_y_;
            if (at_x < 0 || at_x >= tiles_x_ || at_y < 0 || at_y >= tiles_y_) continue;
            gather(tile_[std::size_t(at_y * tiles_x_ + at_x)], shift_x, shift_y);
        }
    sort_claims(claims);
    return claims;
}

void Forest::draw_tile(const Canvas& canvas, int tile)
{
    const std::vector<Claim> claims = claims_of(tile);
    std::vector<Gain> gains;
    draw_columns(canvas, tile_bounds(tile), claims, gains);
    // Neighbours draw the same tree in their tiles; whole numbers add up in any order.
    for (std::size_t c = 0; c < claims.size(); ++c) {
        Tree& tree = const_cast<Tree&>(*claims[c].tree);  // ours; claims are of const trees
        std::atomic_ref(tree.kept).fetch_add(gains[c].kept, std::memory_order_relaxed);
        std::atomic_ref(tree.cone).fetch_add(gains[c].cone, std::memory_order_relaxed);
    }
}

namespace {

/// All trees and, where the domain wraps, the images that reach into it.
std::vector<Claim> all_claims(const std::vector<std::vector<Tree>>& tiles, const Inputs& inputs,
                              const Canvas& canvas)
{
    std::vector<Claim> claims;
    const double p = inputs.params.pixel;
    const int around = inputs.params.border == Border::Wrap ? 1 : 0;
    for (const auto& tile : tiles)
        for (const Tree& tree : tile)
            for (int sy = -around; sy <= around; ++sy)
                for (int sx = -around; sx <= around; ++sx) {
                    const Claim claim = claim_of(tree, inputs, sx, sy);
                    const double r = canvas.radius(tree) + p;
                    if (claim.x + r < 0 || claim.x - r > inputs.width || claim.y + r < 0 ||
                        claim.y - r > inputs.depth)
                        continue;
                    claims.push_back(claim);
                }
    sort_claims(claims);
    return claims;
}

}  // namespace

void Forest::draw_all_painted(const Canvas& canvas)
{
    const std::vector<Claim> claims = all_claims(tile_, inputs_, canvas);
    std::vector<Gain> gains;
    count_painted(canvas, paint(canvas, claims), claims, gains);
    for (std::size_t c = 0; c < claims.size(); ++c) {
        Tree& tree = const_cast<Tree&>(*claims[c].tree);
        tree.kept += gains[c].kept;
        tree.cone += gains[c].cone;
    }
}

void Forest::visit_owned(int tile, const OwnedVisitor& f) const
{
    const Canvas canvas(inputs_.params, inputs_.land, density_, slope_, nx_, ny_);
    visit_columns(canvas, tile_bounds(tile), claims_of(tile), f);
}

std::vector<std::uint32_t> Forest::footprint(const Tree& tree) const
{
    const Canvas canvas(inputs_.params, inputs_.land, density_, slope_, nx_, ny_);
    std::vector<std::uint32_t> counts(std::size_t(inputs_.params.slices), 0);
    // Alone: without rocks, too.
    Land bare;
    bare.pixel = inputs_.land.pixel;
    const bool sloping = inputs_.params.slice_frame == SliceFrame::Absolute;
    const Land& land = inputs_.land.blocked_height.empty() ? inputs_.land : bare;
    if (&land == &bare && sloping) bare.ground = inputs_.land.ground;
    const Canvas alone(inputs_.params, land, density_, slope_, nx_, ny_);
    const int around = inputs_.params.border == Border::Wrap ? 1 : 0;
    for (int sy = -around; sy <= around; ++sy)
        for (int sx = -around; sx <= around; ++sx) {
            const Claim claim = claim_of(tree, inputs_, sx, sy);
            const double p = inputs_.params.pixel, r = alone.radius(tree) + p;
            // The box of its pixels that lies in the domain.
            auto low = [&](double at) { return std::max(0.0, std::floor((at - r) / p)); };
            const std::array<int, 4> box{
                int(std::min(low(claim.x), double(nx_))),
                int(std::clamp(std::ceil((claim.x + r) / p), 0.0, double(nx_))),
                int(std::min(low(claim.y), double(ny_))),
                int(std::clamp(std::ceil((claim.y + r) / p), 0.0, double(ny_)))};
            if (box[0] >= box[1] || box[2] >= box[3]) continue;
            visit_columns(alone, box, {claim}, [&](const Tree&, int, int, std::uint64_t slices) {
                for (; slices != 0; slices &= slices - 1)
                    ++counts[std::size_t(std::countr_zero(slices))];
            });
        }
    return counts;
}

std::vector<std::uint32_t> Forest::occupancy(Method method) const
{
    const Canvas canvas(inputs_.params, inputs_.land, density_, slope_, nx_, ny_);
    const std::vector<Claim> claims = all_claims(tile_, inputs_, canvas);
    // Images of one tree have its rank.
    std::unordered_map<std::uint64_t, std::uint32_t> rank;
    for (const Claim& claim : claims)
        rank.try_emplace(claim.tree->uid, static_cast<std::uint32_t>(rank.size() + 1));
    const auto width = std::size_t(nx_), area = width * std::size_t(ny_);
    if (method == Method::Painter) {
        std::vector<std::uint32_t> image = paint(canvas, claims);
        for (std::uint32_t& v : image)
            v = v == kBlocked || v == 0 ? 0 : rank.at(claims[v - 1].tree->uid);
        return image;
    }
    std::vector<std::uint32_t> image(area * std::size_t(inputs_.params.slices), 0);
    for (int t = 0; t < tiles(); ++t)
        visit_owned(t, [&](const Tree& tree, int i, int j, std::uint64_t slices) {
            const std::uint32_t of = rank.at(tree.uid);
            for (; slices != 0; slices &= slices - 1)
                image[std::size_t(std::countr_zero(slices)) * area + std::size_t(j) * width +
                      std::size_t(i)] = of;
        });
    return image;
}

// --- A step ------------------------------------------------------------------------------------

void Forest::begin_step(Work& work)
{
    work.step = step_ + 1;
    work.parts.resize(tile_.size());
    work.pending.resize(tile_.size());
    for (const Edit& edit : inputs_.edits) {
        if (edit.step != work.step) continue;
        apply(edit, density_, inputs_.params.pixel);
        if (edit.kind != Edit::Kind::Fell && edit.kind != Edit::Kind::Plant) continue;
        work.edits.push_back(edit);
        for (const NewTree& tree : edit.trees)
            if (const auto [found, fresh] = work.planted.try_emplace(tree.uid, tree); !fresh)
                reject_twins(tree.uid, found->second.x, found->second.y, tree.x, tree.y);
    }
}

/// Fells and plants in the tiles [first, last).
void Forest::edit_tiles(Work& work, int first, int last)
{
    for (int t = first; t < last; ++t) {
        auto& list = tile_[std::size_t(t)];
        if (!work.planted.empty())
            for (const Tree& there : list)
                if (const auto found = work.planted.find(there.uid); found != work.planted.end())
                    reject_twins(there.uid, there.x, there.y, found->second.x, found->second.y);
        for (const Edit& edit : work.edits)
            if (edit.kind == Edit::Kind::Fell) {
                const std::size_t gone = std::erase_if(list, [&](const Tree& tree) {
                    return tree.height >= edit.min_height && edit.region.contains(tree.x, tree.y);
                });
                work.parts[std::size_t(t)].deaths[std::size_t(Cause::Felled)] += gone;
            } else
                for (const NewTree& tree : edit.trees)
                    if (within(tree.x, tree.y, inputs_) && tile_of(tree.x, tree.y) == t) {
                        make_room(list, 1);
                        list.push_back(tree_of(tree, inputs_));
                    }
        for (Tree& tree : list) tree.kept = 0, tree.cone = 0;
    }
}

void Forest::grow_tile(Work& work, int tile)
{
    const Params& p = inputs_.params;
    auto& list = tile_[std::size_t(tile)];
    Work::Part& part = work.parts[std::size_t(tile)];
    part.counts.assign(inputs_.species.size(), {});
    const auto step = static_cast<std::uint64_t>(work.step);
    std::size_t alive = 0;
    for (std::size_t n = 0; n < list.size(); ++n) {
        Tree tree = list[n];
        const Species& kind = inputs_.species[tree.species];
        const double share = tree.share();
        const int i = pixel_of(tree.x, nx_), j = pixel_of(tree.y, ny_);
        const double vigour = inputs_.land.vigour(tree.species, i, j);
        const std::uint64_t lot = hash2(tree.uid, step);

        // Who dies.
        std::optional<Cause> cause;
        if (share < p.r1)
            cause = Cause::Competition;
        else if (vigour < 0)
            cause = Cause::Environment;
        else if (kind.max_age > 0 && tree.age >= kind.max_age)
            cause = Cause::Age;
        else if (p.windthrow > 0) {
            const Vec3d wind = inputs_.wind(tree.x, tree.y, tree.height);
            const double u = std::sqrt(wind.x * wind.x + wind.y * wind.y) / p.wind_reference;
            if (uniform_of_key(lot, kGust) < p.windthrow * u * u * (tree.height / 20)) {
                cause = Cause::Wind;
                part.fallen.push_back({tree.uid, work.step, tree.species, tree.x, tree.y,
                                       math::atan2(wind.y, wind.x), tree.height});
            }
        }
        if (cause) {
            ++part.deaths[std::size_t(*cause)];
            continue;
        }

        if (share >= p.r2 && tree.height < kind.max_height)
            tree.height = std::min(kind.max_height, tree.height + kind.growth * share * vigour);
        if (tree.age < 0xFFFF) ++tree.age;
        list[alive++] = tree;
        ++part.trees;
        part.share += fixed(share);
        std::size_t height_class = 0;
        while (height_class < StepStatistics::kClassEnds.size() &&
               tree.height > StepStatistics::kClassEnds[height_class])
            ++height_class;
        ++part.counts[tree.species][height_class];

        if (tree.height < p.maturity * kind.max_height) continue;
        const auto count =
            static_cast<std::uint64_t>(std::floor(p.seeds_per_step + uniform_of_key(lot, kCount)));
        for (std::uint64_t k = 0; k < count; ++k) {
            Tree child;
            child.uid = hash2(lot, k);
            const double angle = 2 * math::kPi * uniform_of_key(child.uid, 0),
                         far =
                             p.seed_factor * tree.height * std::sqrt(uniform_of_key(child.uid, 1));
            child.x = tree.x + far * math::cos(angle);
            child.y = tree.y + far * math::sin(angle);
            if (p.border == Border::Wrap) {
                child.x -= inputs_.width * std::floor(child.x / inputs_.width);
                child.y -= inputs_.depth * std::floor(child.y / inputs_.depth);
            }
            child.height = std::min(p.seedling_height, kind.max_height);
            child.species = tree.species;
            if (!within(child.x, child.y, inputs_) ||
                !inputs_.land.admits(child.species, pixel_of(child.x, nx_),
                                     pixel_of(child.y, ny_))) {
                ++part.lost;
                continue;
            }
            ++part.births;
            part.seeds.emplace_back(tile_of(child.x, child.y), child);
        }
    }
    list.resize(alive);
}

/// Adds the seedlings that fell into a tile, in the order of the tiles they came from.
void Forest::settle(Work& work, int tile)
{
    auto& list = tile_[std::size_t(tile)];
    auto& seedlings = work.pending[std::size_t(tile)];
    make_room(list, seedlings.size());
    list.insert(list.end(), seedlings.begin(), seedlings.end());
    give_back(seedlings);
}

void Forest::advance_in_memory(Work& work, const Progress& progress)
{
    using Clock = std::chrono::steady_clock;
    const Canvas canvas(inputs_.params, inputs_.land, density_, slope_, nx_, ny_);
    const auto count = std::size_t(tiles());
    const auto start = Clock::now();
    parallel_for(count, [&](std::size_t t) { edit_tiles(work, int(t), int(t) + 1); });
    if (inputs_.params.method == Method::Painter)
        draw_all_painted(canvas);
    else
        parallel_for(count, [&](std::size_t t) {
            progress.check();
            draw_tile(canvas, int(t));
        });
    const auto drawn = Clock::now();
    parallel_for(count, [&](std::size_t t) { grow_tile(work, int(t)); });
    for (Work::Part& part : work.parts) {
        for (const auto& [tile, tree] : part.seeds) work.pending[std::size_t(tile)].push_back(tree);
        give_back(part.seeds);
    }
    parallel_for(count, [&](std::size_t t) { settle(work, int(t)); });
    work.seconds_draw = std::chrono::duration<double>(drawn - start).count();
    work.seconds_grow = std::chrono::duration<double>(Clock::now() - drawn).count();
}

// Rows pass through memory from south to north. A row is drawn when those that its crowns come from
// are there; it grows when all rows that its crowns reach are drawn, for till then they need its
// heights as they were; it leaves when all rows that sow into it have grown.
void Forest::advance_by_rows(Work& work, const Progress& progress)
{
    using Clock = std::chrono::steady_clock;
    const Canvas canvas(inputs_.params, inputs_.land, density_, slope_, nx_, ny_);
    int loaded = 0;
    auto each_tile = [&](int row, auto&& f) {
        parallel_for(std::size_t(tiles_x_), [&](std::size_t x) {
            progress.check();
            f(row * tiles_x_ + int(x));
        });
    };
    const int last = tiles_y_ + halo_ + seed_halo_;
    for (int turn = 0; turn < last; ++turn) {
        auto now = Clock::now();
        auto took = [&](double& seconds) {
            const auto then = std::exchange(now, Clock::now());
            seconds += std::chrono::duration<double>(now - then).count();
        };
        for (; loaded < std::min(tiles_y_, turn + halo_ + 1); ++loaded) {
            load_row(step_, loaded);
            edit_tiles(work, loaded * tiles_x_, (loaded + 1) * tiles_x_);
        }
        if (turn < tiles_y_) each_tile(turn, [&](int t) { draw_tile(canvas, t); });
        took(work.seconds_draw);
        if (const int row = turn - halo_; row >= 0 && row < tiles_y_) {
            each_tile(row, [&](int t) { grow_tile(work, t); });
            for (int t = row * tiles_x_; t < (row + 1) * tiles_x_; ++t) {
                Work::Part& part = work.parts[std::size_t(t)];
                for (const auto& [tile, tree] : part.seeds)
                    work.pending[std::size_t(tile)].push_back(tree);
                give_back(part.seeds);
            }
        }
        if (const int row = turn - halo_ - seed_halo_; row >= 0 && row < tiles_y_) {
            each_tile(row, [&](int t) { settle(work, t); });
            save_row(work.step, row);
            for (int t = row * tiles_x_; t < (row + 1) * tiles_x_; ++t)
                give_back(tile_[std::size_t(t)]);
        }
        took(work.seconds_grow);
        progress.update(double(turn + 1) / double(last));
    }
    store_->complete(work.step);
}

StepStatistics Forest::advance(const Progress& progress)
{
    Work work;
    // Trees sown or planted so far wait in memory; rows are read from the store.
    if (store_ && step_ == 0) {
        bool any = false;
        for (const auto& tile : tile_) any = any || !tile.empty();
        if (any)
            for (int row = 0; row < tiles_y_; ++row) {
                save_row(0, row);
                for (int t = row * tiles_x_; t < (row + 1) * tiles_x_; ++t)
                    give_back(tile_[std::size_t(t)]);
            }
        store_->complete(0);
    }
    begin_step(work);
    store_ ? advance_by_rows(work, progress) : advance_in_memory(work, progress);

    StepStatistics row;
    row.step = step_ = work.step;
    row.counts.assign(inputs_.species.size(), {});
    row.seconds_draw = work.seconds_draw;
    row.seconds_grow = work.seconds_grow;
    std::uint64_t share = 0;
    std::vector<Fallen> fallen;
    for (const Work::Part& part : work.parts) {
        row.trees += part.trees;
        row.births += part.births;
        row.lost += part.lost;
        share += part.share;
        for (std::size_t c = 0; c < part.deaths.size(); ++c) row.deaths[c] += part.deaths[c];
        for (std::size_t s = 0; s < part.counts.size(); ++s)
            for (std::size_t k = 0; k < part.counts[s].size(); ++k)
                row.counts[s][k] += part.counts[s][k];
        fallen.insert(fallen.end(), part.fallen.begin(), part.fallen.end());
    }
    if (row.trees > 0) row.mean_share = double(share) * 0x1p-32 / double(row.trees);
    std::ranges::sort(fallen, {}, &Fallen::uid);
    fallen_.insert(fallen_.end(), fallen.begin(), fallen.end());
    size_ = row.trees + row.births;
    return row;
}

// --- Trees in order, rows in a store -------------------------------------------------------------

void Forest::visit(const std::function<void(std::span<const Tree>)>& f) const
{
    const bool stored = store_ && step_ > 0;
    std::vector<Tree> strip;
    for (int row = 0; row < tiles_y_; ++row) {
        // Rows of a store are read into a forest that holds nothing else.
        if (stored) const_cast<Forest*>(this)->load_row(step_, row);
        strip.clear();
        for (int x = 0; x < tiles_x_; ++x) {
            auto& tile = const_cast<Forest*>(this)->tile_[std::size_t(row * tiles_x_ + x)];
            strip.insert(strip.end(), tile.begin(), tile.end());
            if (stored) give_back(tile);
        }
        std::ranges::sort(strip, [&](const Tree& a, const Tree& b) {
            return lies_before(a, b, inputs_.params.pixel);
        });
        f(strip);
    }
}

std::vector<Tree> Forest::trees() const
{
    std::vector<Tree> all;
    all.reserve(size_);
    visit([&](std::span<const Tree> strip) { all.insert(all.end(), strip.begin(), strip.end()); });
    return all;
}

std::vector<Tree> Forest::ranked() const
{
    std::vector<Tree> all = trees();
    std::ranges::sort(all, bigger);
    return all;
}

std::size_t Forest::memory_bytes() const
{
    std::size_t bytes = 0;
    for (const auto& tile : tile_) bytes += tile.capacity() * sizeof(Tree);
    for (const DensityMap& map : density_) bytes += map.memory_bytes();
    return bytes;
}

namespace {

constexpr char kMagic[8] = {'S', 'K', 'F', 'O', 'R', 'O', 'W', '1'};

struct RowHeader {
    char magic[8];
    std::int32_t step, row, tiles, size_of_tree;
    std::uint64_t hash;  ///< of all that follows
};
static_assert(sizeof(Tree) == 48 && std::is_trivially_copyable_v<Tree>);

}  // namespace

void Forest::save_row(int step, int row)
{
    std::size_t count = 0;
    for (int x = 0; x < tiles_x_; ++x) count += tile_[std::size_t(row * tiles_x_ + x)].size();
    std::string bytes(
        sizeof(RowHeader) + std::size_t(tiles_x_) * sizeof(std::uint64_t) + count * sizeof(Tree),
        '\0');
    char* to = bytes.data() + sizeof(RowHeader);
    for (int x = 0; x < tiles_x_; ++x) {
        const std::uint64_t trees = tile_[std::size_t(row * tiles_x_ + x)].size();
        std::memcpy(to, &trees, sizeof trees);
        to += sizeof trees;
    }
    for (int x = 0; x < tiles_x_; ++x) {
        const auto& tile = tile_[std::size_t(row * tiles_x_ + x)];
        if (!tile.empty()) std::memcpy(to, tile.data(), tile.size() * sizeof(Tree));
        to += tile.size() * sizeof(Tree);
    }
    RowHeader header{{}, step, row, tiles_x_, std::int32_t(sizeof(Tree)), 0};
    std::memcpy(header.magic, kMagic, sizeof kMagic);
    header.hash = hash64(bytes.data() + sizeof header, bytes.size() - sizeof header);
    std::memcpy(bytes.data(), &header, sizeof header);
    store_->save(step, row, bytes);
}

void Forest::load_row(int step, int row)
{
    const std::string bytes = store_->load(step, row);
    auto damaged = [&](const char* what) {
        throw InvalidInput(fmt::format(
            "forest: row {} of step {}: {}; remove the folder to begin anew", row, step, what));
    };
    RowHeader header{};
    if (bytes.size() < sizeof header) damaged("cut short");
    std::memcpy(&header, bytes.data(), sizeof header);
    if (std::memcmp(header.magic, kMagic, sizeof kMagic) != 0) damaged("no row of trees");
    if (header.step != step || header.row != row || header.tiles != tiles_x_ ||
        header.size_of_tree != std::int32_t(sizeof(Tree)))
        damaged("of another forest or version");
    if (header.hash != hash64(bytes.data() + sizeof header, bytes.size() - sizeof header))
        damaged("damaged or cut short");
    const char* from = bytes.data() + sizeof header;
    std::vector<std::uint64_t> counts(static_cast<std::size_t>(tiles_x_));
    std::size_t total = sizeof header + counts.size() * sizeof counts[0];
    if (bytes.size() < total) damaged("cut short");
    std::memcpy(counts.data(), from, counts.size() * sizeof counts[0]);
    from += counts.size() * sizeof counts[0];
    for (const std::uint64_t n : counts) {
        if (n > bytes.size() / sizeof(Tree)) damaged("its numbers do not fit its size");
        total += n * sizeof(Tree);
    }
    if (bytes.size() != total) damaged("its numbers do not fit its size");
    for (int x = 0; x < tiles_x_; ++x) {
        auto& tile = tile_[std::size_t(row * tiles_x_ + x)];
        tile.resize(counts[std::size_t(x)]);
        if (!tile.empty()) std::memcpy(tile.data(), from, tile.size() * sizeof(Tree));
        from += tile.size() * sizeof(Tree);
        for (const Tree& tree : tile)
            if (!belongs(tree, inputs_) || tile_of(tree.x, tree.y) != row * tiles_x_ + x)
                damaged("a tree in it is not of this forest");
    }
}

}  // namespace sekitei::forest
