#include "core/csv.h"

#include <fmt/format.h>
#include <iconv.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <cmath>

#include "core/error.h"

namespace sekitei {
namespace {

constexpr std::size_t kMostTold = 1000;
constexpr std::size_t kMostAlike = 3;  // a month of normals is wrong on each of its days

/// Bytes of the character that starts the text; 0 where it is not UTF-8.
std::size_t utf8_length(std::string_view text)
{
    auto byte = [&](std::size_t i) -> unsigned {
        return i < text.size() ? static_cast<unsigned char>(text[i]) : 0u;
    };
    auto tail = [&](std::size_t i) { return (byte(i) & 0xC0u) == 0x80u; };
    const unsigned first = byte(0);
    if (first < 0x80) return 1;
    if (first >= 0xC2 && first < 0xE0) return tail(1) ? 2 : 0;
    if (first >= 0xE0 && first < 0xF0) {
        // Neither longer forms of short characters nor halves of UTF-16 pairs.
        if (first == 0xE0 && byte(1) < 0xA0) return 0;
        if (first == 0xED && byte(1) >= 0xA0) return 0;
        return tail(1) && tail(2) ? 3 : 0;
    }
    if (first >= 0xF0 && first < 0xF5) {
        if (first == 0xF0 && byte(1) < 0x90) return 0;
        if (first == 0xF4 && byte(1) >= 0x90) return 0;
        return tail(1) && tail(2) && tail(3) ? 4 : 0;
    }
    return 0;
}

/// Counts lines and columns along a text.
struct Place {
    std::size_t line = 1, column = 1;
    char before = 0;
    void pass(char c)
    {
        if (c == '\n' && before == '\r') {
            before = c;
            return;
        }
        before = c;
        if (c == '\n' || c == '\r') {
            ++line;
            column = 1;
        } else if ((static_cast<unsigned char>(c) & 0xC0u) != 0x80u) {
            ++column;
        }
    }
};

/// A converter of the C library, closed in the end.
class Converter {
public:
    Converter() : handle_(iconv_open("UTF-8", "CP932")) {}
    ~Converter()
    {
        if (open()) iconv_close(handle_);
    }
    Converter(const Converter&) = delete;
    Converter& operator=(const Converter&) = delete;
    bool open() const { return reinterpret_cast<std::intptr_t>(handle_) != -1; }

    /// Converts the character at the front of `bytes` and drops it; nothing where it is none.
    std::optional<std::string> next(std::string_view& bytes)
    {
        for (std::size_t length = 1; length <= std::min<std::size_t>(2, bytes.size()); ++length) {
            std::array<char, 8> out{};
            std::array<char, 2> in{bytes[0], length > 1 ? bytes[1] : '\0'};
            char *from = in.data(), *to = out.data();
            std::size_t left = length, room = out.size();
            iconv(handle_, nullptr, nullptr, nullptr, nullptr);
            if (iconv(handle_, &from, &left, &to, &room) != std::size_t(-1) && left == 0) {
                bytes.remove_prefix(length);
                return std::string(out.data(), out.size() - room);
            }
        }
        return std::nullopt;
    }

private:
    iconv_t handle_;
};

std::string decode_shift_jis(std::string_view bytes, const std::string& file, Problems& problems)
{
    Converter converter;
    if (!converter.open())
        throw InvalidInput(
            file +
            ": is in Shift_JIS, which this system's C library cannot convert (its table CP932 is "
            "missing); save the file as UTF-8");
    std::string text;
    text.reserve(bytes.size() * 3 / 2);
    Place place;
    std::size_t told = 0;  // the line whose fault is told
    while (!bytes.empty()) {
        if (static_cast<unsigned char>(bytes[0]) < 0x80) {
            text += bytes[0];
            place.pass(bytes[0]);
            bytes.remove_prefix(1);
        } else if (const auto character = converter.next(bytes)) {
            text += *character;
            ++place.column;
        } else {
            if (place.line != told)
                problems.add(place.line, place.column,
                             fmt::format("byte 0x{:02x} is not Shift_JIS, expected the encoding of "
                                         "the rest of the file",
                                         static_cast<unsigned char>(bytes[0])));
            told = place.line;
            text += '?';
            ++place.column;
            bytes.remove_prefix(1);
        }
    }
    return text;
}

}  // namespace

void Problems::add(std::size_t line, std::size_t column, std::string text)
{
    if (++count_ <= kMostTold) texts_[{line, column}].push_back(std::move(text));
}

void Problems::throw_if_any() const
{
    if (count_ == 0) return;
    std::string all;
    for (const auto& [place, texts] : texts_) {
        const std::string where = fmt::format("{}:{}:{}: ", file_, place.first, place.second);
        auto line = [&](const std::string& text) {
            all += (all.empty() ? "" : "\n") + where + text;
        };
        // Alike but for their numbers.
        auto shape = [](std::string text) {
            std::erase_if(text, [](char c) { return c == '.' || (c >= '0' && c <= '9'); });
            return text;
        };
        std::map<std::string, std::size_t> told;
        for (const std::string& text : texts)
            if (++told[shape(text)] <= kMostAlike) line(text);
        for (const auto& [text, count] : told)
            if (count > kMostAlike) line(fmt::format("{} more like it", count - kMostAlike));
    }
    if (count_ > kMostTold) all += fmt::format("\n{}: {} more", file_, count_ - kMostTold);
    throw InvalidInput(all);
}

std::string decode_text(std::string_view bytes, const std::string& file,
                        std::string_view shift_jis_mark, Problems& problems)
{
    if (bytes.empty()) throw InvalidInput(file + ": empty file");
    if (bytes.starts_with("\xFF\xFE") || bytes.starts_with("\xFE\xFF"))
        throw InvalidInput(file + ": is in UTF-16, expected UTF-8; save it as CSV in UTF-8");
    if (const auto zero = bytes.find('\0'); zero != std::string_view::npos)
        throw InvalidInput(
            fmt::format("{}: holds a zero byte at byte {}, expected a text file", file, zero));
    if (bytes.starts_with("\xEF\xBB\xBF")) bytes.remove_prefix(3);
    if (!shift_jis_mark.empty() && bytes.find(shift_jis_mark) != std::string_view::npos)
        return decode_shift_jis(bytes, file, problems);

    std::string text;
    text.reserve(bytes.size());
    Place place;
    std::size_t told = 0;
    while (!bytes.empty()) {
        const std::size_t length = utf8_length(bytes);
        if (length == 0) {
            if (place.line != told)
                problems.add(place.line, place.column,
                             fmt::format("byte 0x{:02x} is not UTF-8; save the file as UTF-8",
                                         static_cast<unsigned char>(bytes[0])));
            told = place.line;
            text += '?';
            place.pass('?');
            bytes.remove_prefix(1);
            continue;
        }
        for (const char c : bytes.substr(0, length)) place.pass(c);
        text.append(bytes.substr(0, length));
        bytes.remove_prefix(length);
    }
    return text;
}

bool CsvReader::next_line(std::string_view& line)
{
    if (rest_.empty()) return false;
    const std::size_t end = std::min(rest_.find_first_of("\r\n"), rest_.size());
    line = rest_.substr(0, end);
    const std::size_t ending = rest_.substr(end, 2) == "\r\n" ? 2 : 1;
    rest_.remove_prefix(std::min(end + ending, rest_.size()));
    ++line_;
    return true;
}

void CsvReader::split(std::string_view line, char separator, std::vector<CsvCell>& cells)
{
    cells.clear();
    std::size_t column = 1, at = 0;
    auto blank = [](char c) { return c == ' ' || c == '\t'; };
    auto width = [](std::string_view text) {
        return static_cast<std::size_t>(std::count_if(text.begin(), text.end(), [](char c) {
            return (static_cast<unsigned char>(c) & 0xC0u) != 0x80u;
        }));
    };
    for (;;) {
        // The end of the cell: the next separator outside quotes.
        std::size_t begin = at;
        while (begin < line.size() && line[begin] != separator && blank(line[begin])) ++begin;
        std::size_t end = begin;
        if (begin < line.size() && line[begin] == '"') {
            const std::size_t close = line.find('"', begin + 1);
            end = close == std::string_view::npos ? line.size() : close + 1;
        }
        end = std::min(line.find(separator, end), line.size());
        std::string_view text = line.substr(begin, end - begin);
        while (!text.empty() && blank(text.back())) text.remove_suffix(1);
        CsvCell cell{text, column + width(line.substr(at, begin - at))};
        if (text.size() >= 2 && text.front() == '"' && text.back() == '"') {
            cell.text = text.substr(1, text.size() - 2);
            while (!cell.text.empty() && blank(cell.text.back())) cell.text.remove_suffix(1);
            while (!cell.text.empty() && blank(cell.text.front())) cell.text.remove_prefix(1);
        }
        cells.push_back(cell);
        if (end >= line.size()) return;
        column += width(line.substr(at, end + 1 - at));
        at = end + 1;
    }
}

std::optional<double> number_of(std::string_view text)
{
    // from_chars takes no plus sign, and takes "nan" and "inf".
    if (text.size() > 1 && text.front() == '+' && text[1] != '-') text.remove_prefix(1);
    double value = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc{} || end != text.data() + text.size() || !std::isfinite(value))
        return std::nullopt;
    return value;
}

std::string quoted(std::string_view text)
{
    constexpr std::size_t kLongest = 40;
    std::size_t end = std::min(text.size(), kLongest);
    while (end < text.size() && end > 0 && (static_cast<unsigned char>(text[end]) & 0xC0u) == 0x80u)
        --end;
    std::string shown(text.substr(0, end));
    for (char& c : shown)
        if (static_cast<unsigned char>(c) < 0x20 || c == 0x7F) c = ' ';
    return "'" + shown + (end < text.size() ? "...'" : "'");
}

}  // namespace sekitei
