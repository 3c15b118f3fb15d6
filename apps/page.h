#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "apps/explain.h"
#include "core/progress.h"

/// Web pages that show a scene: one file with the drawing program, the meshes and what
/// `sekitei explain` says of every place, for browsers without a network.
namespace sekitei::apps {

/// The longest page that browsers open (a piece of text in them has less than 2^29 characters).
inline constexpr double kPageLimit = 480e6;

/// Refuses bytes that are no glTF 2.0 binary or whose parts lie outside of it.
/// @param name  of the file, for messages
/// @return its JSON
/// @throws InvalidInput
Json check_glb(std::string_view glb, const std::string& name);

/// Gathers moments of a scene and writes them as a page.
///
/// Bytes that several moments share (a rock that stays while moss grows) are there once: each
/// buffer view of a .glb and each column of numbers is a block, found by its hash.
class Page {
public:
    explicit Page(std::string title) : title_(std::move(title)) {}

    /// @param label  "day 30"
    /// @param file   that it shows
    /// @param glb    as encode_glb() makes it
    /// @throws InvalidInput   not a .glb
    /// @throws LimitExceeded  the page would be longer than kPageLimit
    void add(const std::string& label, const std::string& file, std::string_view glb,
             const Progress& progress);
    /// What `explain` says of every place of the moment added last.
    /// @param file  the scene, as the page names it in the command it shows
    void explain(const Explainer& explainer, const std::string& file, const Progress& progress);

    std::size_t frames() const { return frames_.size(); }
    /// The page. Equal scenes make equal bytes.
    std::string html() const;

private:
    std::size_t block(std::string_view bytes, std::size_t width);
    Json column(const std::vector<std::string>& words, int digits, int places);

    struct Block {
        std::size_t size, width;  ///< of its bytes, of its numbers
        bool packed;              ///< deflated
        std::string text;         ///< base64
    };
    std::string title_;
    std::vector<Block> blocks_;
    std::map<std::string, std::size_t> known_;  ///< blocks by hash, size and width
    double bytes_ = 0;                          ///< of all blocks as text
    Json frames_ = Json::array();
};

/// Parts of the page that do not depend on the scene, built into the program.
std::string_view viewer_page();
std::string_view viewer_style();
std::string_view viewer_script();

}  // namespace sekitei::apps
