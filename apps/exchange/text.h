#pragma once

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <functional>
#include <iterator>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/mesh.h"
#include "core/parallel.h"
#include "core/progress.h"
#include "grids/scene.h"

/// Text of large files, in pieces.
namespace sekitei::apps {

/// Collects text and passes it on in large pieces.
class TextOut {
public:
    explicit TextOut(const std::function<void(std::string_view)>& sink,
                     const Progress& progress = {})
        : sink_(sink), progress_(progress)
    {
    }
    template <class... Args>
    void put(fmt::format_string<Args...> format, Args&&... args)
    {
        fmt::format_to(std::back_inserter(text_), format, std::forward<Args>(args)...);
        if (text_.size() > 1 << 20) flush();
    }
    /// Text of many rows, written by many threads at once: f(row, where to append).
    template <class F>
    void rows(std::size_t count, F&& f)
    {
        flush();
        constexpr std::size_t kRows = 4096, kChunks = 16;
        std::vector<std::string> parts(kChunks);
        for (std::size_t begin = 0; begin < count; begin += kRows * kChunks) {
            progress_.check();
            const std::size_t left = std::min(count - begin, kRows * kChunks),
                              chunks = (left + kRows - 1) / kRows;
            parallel_for(chunks, [&](std::size_t c) {
                parts[c].clear();
                const std::size_t end = std::min(left, (c + 1) * kRows);
                for (std::size_t i = c * kRows; i < end; ++i) f(begin + i, parts[c]);
            });
            for (std::size_t c = 0; c < chunks; ++c) sink_(parts[c]);
        }
    }
    void flush()
    {
        sink_(text_);
        text_.clear();
    }
    void check() const { progress_.check(); }

private:
    const std::function<void(std::string_view)>& sink_;
    const Progress progress_;
    std::string text_;
};

/// A name that USD takes for a prim or a property.
inline std::string usd_identifier(const std::string& name)
{
    std::string text;
    for (const char c : name) text += std::isalnum(static_cast<unsigned char>(c)) ? c : '_';
    if (text.empty() || std::isdigit(static_cast<unsigned char>(text[0]))) text.insert(0, 1, '_');
    return text;
}

/// `NAME = [...]` of a USD prim; item(i, text) appends one of `count` values.
template <class F>
void put_usd_list(TextOut& out, const std::string& pad, const std::string& type_and_name,
                  std::size_t count, F&& item)
{
    out.put("{}{} = [", pad, type_and_name);
    out.rows(count, [&](std::size_t i, std::string& text) {
        if (i > 0) text += ", ";
        item(i, text);
    });
    out.put("]");
}

/// Extent, faces and points of a USD Mesh.
inline void put_usd_triangles(TextOut& out, const std::string& pad, const TriMesh& mesh,
                              const Bounds& box)
{
    out.put("{}float3[] extent = [({:.6g}, {:.6g}, {:.6g}), ({:.6g}, {:.6g}, {:.6g})]\n", pad,
            box.lower.x, box.lower.y, box.lower.z, box.upper.x, box.upper.y, box.upper.z);
    put_usd_list(out, pad, "int[] faceVertexCounts", mesh.triangles.size(),
                 [](std::size_t, std::string& text) { text += '3'; });
    out.put("\n");
    put_usd_list(out, pad, "int[] faceVertexIndices", mesh.triangles.size(),
                 [&](std::size_t i, std::string& text) {
                     const auto& t = mesh.triangles[i];
                     fmt::format_to(std::back_inserter(text), "{}, {}, {}", t[0], t[1], t[2]);
                 });
    out.put("\n");
    put_usd_list(out, pad, "point3f[] points", mesh.vertices.size(),
                 [&](std::size_t i, std::string& text) {
                     const Vec3f p = plain_zero(mesh.vertices[i]);
                     fmt::format_to(std::back_inserter(text), "({}, {}, {})", p.x, p.y, p.z);
                 });
    out.put("\n");
}

}  // namespace sekitei::apps
