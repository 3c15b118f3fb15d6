#include "apps/page.h"

#include <fmt/format.h>
#include <zlib.h>

#include <algorithm>
#include <bit>
#include <charconv>
#include <cstring>

#include "apps/habitat.h"
#include "apps/render/colour.h"
#include "core/error.h"
#include "core/hash.h"
#include "core/json.h"
#include "core/parallel.h"

namespace sekitei::apps {
namespace {

static_assert(std::endian::native == std::endian::little, "blocks hold little-endian numbers");

std::uint32_t word_at(std::string_view bytes, std::size_t at)
{
    std::uint32_t word;
    std::memcpy(&word, bytes.data() + at, sizeof word);
    return word;
}

/// The two chunks of a .glb whose lengths have been checked.
struct GlbChunks {
    std::string_view json, binary;
};

GlbChunks chunks_of(std::string_view glb)
{
    const std::size_t json = word_at(glb, 12), rest = 20 + json;
    GlbChunks chunks{glb.substr(20, json), {}};
    if (glb.size() >= rest + 8) chunks.binary = glb.substr(rest + 8, word_at(glb, rest));
    return chunks;
}

std::string base64(std::string_view bytes)
{
    static constexpr char kLetters[] =
        "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    std::string text((bytes.size() + 2) / 3 * 4, '=');
    std::size_t to = 0;
    for (std::size_t i = 0; i < bytes.size(); i += 3) {
        const std::size_t n = std::min<std::size_t>(3, bytes.size() - i);
        std::uint32_t word = 0;
        for (std::size_t k = 0; k < 3; ++k)
            word = word << 8 | (k < n ? static_cast<unsigned char>(bytes[i + k]) : 0u);
        for (std::size_t k = 0; k <= n; ++k) text[to + k] = kLetters[word >> (18 - 6 * k) & 63];
        to += 4;
    }
    return text;
}

/// The first bytes of all numbers, then the second ones ...: alike bytes lie together.
std::string by_significance(std::string_view bytes, std::size_t width)
{
    const std::size_t count = bytes.size() / width;
    std::string planes(bytes.size(), '\0');
    for (std::size_t b = 0; b < width; ++b)
        for (std::size_t i = 0; i < count; ++i) planes[b * count + i] = bytes[i * width + b];
    return planes;
}

std::string deflated(std::string_view bytes)
{
    uLongf size = compressBound(static_cast<uLong>(bytes.size()));
    std::string packed(size, '\0');
    if (compress2(reinterpret_cast<Bytef*>(packed.data()), &size,
                  reinterpret_cast<const Bytef*>(bytes.data()), static_cast<uLong>(bytes.size()),
                  1) != Z_OK)
        throw std::bad_alloc();
    packed.resize(size);
    return packed;
}

template <class T>
std::string_view bytes_of(const std::vector<T>& values)
{
    return {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T)};
}

/// 256 colours as one word of hexadecimal digits, sRGB.
template <class F>
std::string colour_table(F&& colour)
{
    std::string text;
    for (int i = 0; i < 256; ++i) {
        const Vec3f c = colour(i);
        for (int k = 0; k < 3; ++k)
            text += fmt::format("{:02x}", render::srgb_byte(static_cast<double>(c[k])));
    }
    return text;
}

/// A JSON text that may stand inside a <script> element.
std::string script_json(const Json& json)
{
    std::string text = json.dump(-1, ' ', true, Json::error_handler_t::replace);
    for (std::size_t at = 0; (at = text.find('<', at)) != std::string::npos;)
        text.replace(at, 1, "\\u003c");
    return text;
}

}  // namespace

Json check_glb(std::string_view glb, const std::string& name)
{
    auto damaged = [&](const std::string& what) {
        return InvalidInput(fmt::format("{}: {}; export the scene again", name, what));
    };
    if (glb.size() < 20 || glb.substr(0, 4) != "glTF")
        throw damaged(glb.empty() ? "an empty file" : "not a glTF binary (.glb)");
    if (word_at(glb, 4) != 2)
        throw damaged(fmt::format("glTF of version {}, expected 2", word_at(glb, 4)));
    if (word_at(glb, 8) != glb.size())
        throw damaged(fmt::format("truncated: its header says {} bytes, the file has {}",
                                  word_at(glb, 8), glb.size()));
    const std::uint64_t json_size = word_at(glb, 12);
    if (word_at(glb, 16) != 0x4E4F534A || 20 + json_size > glb.size())
        throw damaged("no JSON at its start");
    const std::uint64_t rest = 20 + json_size;
    if (rest != glb.size() &&
        (rest + 8 > glb.size() || rest + 8 + word_at(glb, rest) > glb.size() ||
         word_at(glb, rest + 4) != 0x004E4942))
        throw damaged("its binary part is cut off");
    const GlbChunks chunks = chunks_of(glb);
    Json json = parse_json(chunks.json, false);
    if (!json.is_object()) throw damaged("its JSON cannot be read");
    auto list = [&](const char* key) {
        const Json found = json.value(key, Json::array());
        if (!found.is_array()) throw damaged(fmt::format("'{}' is no list", key));
        return found;
    };
    for (const Json& buffer : list("buffers"))
        if (!buffer.is_object() || buffer.contains("uri"))
            throw damaged("it names other files, where a page has none");
    for (const Json& image : list("images"))
        if (!image.is_object() || image.contains("uri"))
            throw damaged("it names other files, where a page has none");
    auto number = [&](const Json& object, const char* key) -> std::uint64_t {
        const Json value = object.is_object() ? object.value(key, Json(0u)) : Json();
        if (!value.is_number_unsigned()) throw damaged(fmt::format("'{}' is no whole number", key));
        return value.get<std::uint64_t>();
    };
    const std::size_t views = list("bufferViews").size();
    for (const Json& view : list("bufferViews")) {
        const std::uint64_t from = number(view, "byteOffset"), size = number(view, "byteLength");
        if (from > chunks.binary.size() || size > chunks.binary.size() - from)
            throw damaged(
                fmt::format("bytes {} to {} of its binary part, which has {}, are missing", from,
                            from + size, chunks.binary.size()));
    }
    for (const Json& accessor : list("accessors"))
        if (accessor.is_object() && accessor.contains("bufferView") &&
            number(accessor, "bufferView") >= views)
            throw damaged("an accessor without bytes");
    if (list("meshes").empty()) throw damaged("it has no meshes");
    return json;
}

std::size_t Page::block(std::string_view bytes, std::size_t width)
{
    if (width == 0 || bytes.size() % width != 0) width = 1;
    const std::string key = fmt::format("{} {} {}", hash_hex(bytes), bytes.size(), width);
    const auto [found, fresh] = known_.emplace(key, blocks_.size());
    if (!fresh) return found->second;
    const std::string packed =
        width > 1 ? deflated(by_significance(bytes, width)) : deflated(bytes);
    const bool pays = static_cast<double>(packed.size()) < 0.95 * static_cast<double>(bytes.size());
    Block made{bytes.size(), pays ? width : 1, pays, base64(pays ? packed : bytes)};
    bytes_ += static_cast<double>(made.text.size()) + 60;
    blocks_.push_back(std::move(made));
    if (bytes_ > kPageLimit)
        throw LimitExceeded(fmt::format(
            "the page would have more than {} with moment {} of the scene, and browsers open no "
            "more; show fewer moments, larger voxels, or plants with less detail (--moss-lod 2)",
            bytes_text(kPageLimit), frames_.size()));
    return found->second;
}

/// Numbers as text, every one of the same format.
/// @param digits  of %.{digits}g, given as {:.{digits - 1}e}; 0: places counts
/// @param places  of %.{places}f
Json Page::column(const std::vector<std::string>& words, int digits, int places)
{
    if (digits > 0) {
        std::vector<std::int16_t> mantissa(words.size());
        std::vector<std::int8_t> exponent(words.size());
        parallel_for(
            words.size(),
            [&](std::size_t i) {
                const std::string& word = words[i];  // "-1.234e-05"
                const std::size_t e = word.find('e');
                if (e == std::string::npos) {
                    exponent[i] = 127;
                    return;
                }
                int m = 0, power = 0;
                for (std::size_t k = 0; k < e; ++k)
                    if (word[k] >= '0' && word[k] <= '9') m = 10 * m + (word[k] - '0');
                std::from_chars(word.data() + e + 1 + (word[e + 1] == '+'),
                                word.data() + word.size(), power);
                mantissa[i] = static_cast<std::int16_t>(word[0] == '-' ? -m : m);
                exponent[i] = static_cast<std::int8_t>(std::clamp(power - digits + 1, -120, 120));
            },
            4096);
        return {{"digits", digits},
                {"mantissa", block(bytes_of(mantissa), 2)},
                {"exponent", block(bytes_of(exponent), 1)}};
    }
    constexpr std::int16_t kNone = -32768, kMinusZero = -32767;
    std::vector<std::int16_t> fixed(words.size(), kNone);
    for (std::size_t i = 0; i < words.size(); ++i) {
        const std::string& word = words[i];  // "-0.12"
        if (word.find('.') == std::string::npos) continue;
        int m = 0;
        for (const char c : word)
            if (c >= '0' && c <= '9') m = std::min(10 * m + (c - '0'), 32766);
        fixed[i] = static_cast<std::int16_t>(word[0] != '-' ? m : m == 0 ? int(kMinusZero) : -m);
    }
    return {{"places", places}, {"fixed", block(bytes_of(fixed), 2)}};
}

void Page::add(const std::string& label, const std::string& file, std::string_view glb,
               const Progress& progress)
{
    progress.check();
    const Json json = check_glb(glb, file);
    const GlbChunks chunks = chunks_of(glb);
    Json frame = {{"label", label}, {"file", file}, {"explain", nullptr}};
    frame["glb"] = {{"json", block(chunks.json, 1)}, {"views", Json::array()}};
    frames_.push_back(frame);
    Json& views = frames_.back()["glb"]["views"];
    const Json described = json.value("bufferViews", Json::array());
    for (std::size_t i = 0; i < described.size(); ++i) {
        progress.check();
        const auto from = described[i].value("byteOffset", std::size_t(0));
        const auto size = described[i].value("byteLength", std::size_t(0));
        views.push_back({{"offset", from}, {"block", block(chunks.binary.substr(from, size), 4)}});
    }
}

void Page::explain(const Explainer& explainer, const std::string& file, const Progress& progress)
{
    const std::size_t count = explainer.size();
    std::vector<std::string> words(count);
    auto general = [&](int digits, auto&& value) {
        progress.check();
        parallel_for(
            count,
            [&](std::size_t i) { words[i] = fmt::format("{:.{}e}", double(value(i)), digits - 1); },
            1024);
        return column(words, digits, 0);
    };
    auto fixed = [&](int places, auto&& value) {
        progress.check();
        parallel_for(
            count,
            [&](std::size_t i) { words[i] = fmt::format("{:.{}f}", double(value(i)), places); },
            1024);
        return column(words, 0, places);
    };
    Json table = {{"file", file},
                  {"of_mesh", explainer.of_mesh()},
                  {"count", count},
                  {"factors", kFactors},
                  {"wind", Json::array()},
                  {"winds", Json::array()},
                  {"measures", Json::array()},
                  {"species", Json::array()},
                  {"growing", nullptr}};
    std::vector<double> position;
    position.reserve(3 * count);
    for (std::size_t i = 0; i < count; ++i)
        for (int axis = 0; axis < 3; ++axis) position.push_back(explainer.position(i)[axis]);
    table["position"] = block(bytes_of(position), 8);
    for (int axis = 0; axis < 3; ++axis) {
        table["at"].push_back(
            general(4, [&](std::size_t i) { return explainer.position(i)[axis]; }));
        table["normal"].push_back(
            fixed(2, [&](std::size_t i) { return explainer.normal(i)[axis]; }));
    }
    table["area"] = general(3, [&](std::size_t i) { return explainer.area(i) * 1e4; });
    for (const Measure& m : explainer.measures())
        table["measures"].push_back({{"name", m.name},
                                     {"label", m.label},
                                     {"unit", m.unit},
                                     {"column", general(4, m.value)}});
    for (int k = 0; explainer.has_wind() && k < 8; ++k) {
        table["winds"].push_back(wind_name(k));
        table["wind"].push_back(
            fixed(2, [&](std::size_t i) { return explainer.wind_ratio(i, k); }));
    }
    for (std::size_t k = 0; k < explainer.species().size(); ++k) {
        std::vector<Verdict> verdicts(count);
        parallel_for(
            count, [&](std::size_t i) { verdicts[i] = explainer.verdict(i, k); }, 1024);
        Json entry = {{"name", explainer.species()[k].name}, {"mean", nullptr}};
        for (auto&& value : {+[](const Verdict& v) { return v.fitness.temperature; },
                             +[](const Verdict& v) { return v.fitness.humidity; },
                             +[](const Verdict& v) { return v.fitness.light; },
                             +[](const Verdict& v) { return v.fitness.gate; },
                             +[](const Verdict& v) { return v.fitness.total(); }})
            entry["numbers"].push_back(fixed(3, [&](std::size_t i) { return value(verdicts[i]); }));
        if (!verdicts.empty() && verdicts.front().mean)
            entry["mean"] = fixed(3, [&](std::size_t i) { return *verdicts[i].mean; });
        std::string flags(count, '\0');
        for (std::size_t i = 0; i < count; ++i)
            flags[i] = static_cast<char>(verdicts[i].limiting | (verdicts[i].grows ? 4 : 0));
        entry["flags"] = block(flags, 1);
        table["species"].push_back(std::move(entry));
    }
    if (explainer.knows_moss()) {
        std::vector<std::uint32_t> begin{0};
        std::vector<std::uint16_t> who;
        std::vector<std::int32_t> days;
        std::vector<std::string> growth, names;
        for (std::size_t i = 0; i < count; ++i) {
            for (const Growing& moss : explainer.growing(i)) {
                const auto name = std::find(names.begin(), names.end(), moss.name);
                who.push_back(static_cast<std::uint16_t>(name - names.begin()));
                if (name == names.end()) names.push_back(moss.name);
                growth.push_back(fmt::format("{:.2e}", moss.growth));
                days.push_back(moss.days);
            }
            begin.push_back(static_cast<std::uint32_t>(who.size()));
        }
        table["names"] = names;
        table["growing"] = {{"begin", block(bytes_of(begin), 4)},
                            {"who", block(bytes_of(who), 2)},
                            {"growth", column(growth, 3, 0)},
                            {"days", block(bytes_of(days), 4)}};
    }
    frames_.back()["explain"] = std::move(table);
}

std::string Page::html() const
{
    Json blocks = Json::array();
    for (const Block& b : blocks_)
        blocks.push_back({{"size", b.size}, {"width", b.width}, {"packed", b.packed}});
    const Json meta = {
        {"sekitei", SEKITEI_VERSION},
        {"title", title_},
        {"frames", frames_},
        {"start", frames_.size() - 1},
        {"blocks", blocks},
        {"colours",
         {{"values", colour_table([](int i) { return render::colour_of_value(i / 255.0); })},
          {"ids", colour_table([](int i) { return render::colour_of_id(i); })}}}};
    std::string data =
        "<script type=\"application/json\" id=\"sekitei\">" + script_json(meta) + "</script>\n";
    std::size_t length =
        data.size() + viewer_page().size() + viewer_style().size() + viewer_script().size();
    for (const Block& b : blocks_) length += b.text.size() + 60;
    std::string page;
    page.reserve(length);
    std::string_view rest = viewer_page();
    auto up_to = [&](std::string_view mark) {
        const std::size_t at = rest.find(mark);
        page += rest.substr(0, at);
        rest.remove_prefix(std::min(rest.size(), at + mark.size()));
    };
    up_to("/*STYLE*/");
    page += viewer_style();
    up_to("<!--DATA-->");
    page += data;
    for (std::size_t i = 0; i < blocks_.size(); ++i)
        page += fmt::format("<script type=\"text/plain\" id=\"b{}\">", i) + blocks_[i].text +
                "</script>\n";
    up_to("/*SCRIPT*/");
    page += viewer_script();
    page += rest;
    return page;
}

}  // namespace sekitei::apps
