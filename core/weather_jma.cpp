#include <fmt/format.h>

#include <algorithm>

#include "core/error.h"
#include "core/weather_formats.h"

/// Daily values as the Japan Meteorological Agency's site hands them out.
///
/// A line with the time of download, a blank one, the stations, the items with units, a row or two
/// that say what each column of an item is (value, quality, homogeneity, flag), then days.
namespace sekitei::weather_formats {
namespace {

/// Quality numbers: 8 sound, 5 made of at least four fifths of the observations; 4 of fewer, 2
/// doubtful, 1 missing, 0 not observed.
constexpr bool usable(double quality)
{
    return quality == 8 || quality == 5;
}

constexpr std::array<std::string_view, 16> kPoints{
    "北", "北北東", "北東", "東北東", "東", "東南東", "南東", "南南東",
    "南", "南南西", "南西", "西南西", "西", "西北西", "北西", "北北西"};
constexpr std::string_view kCalm = "静穏";

struct Item {
    std::string_view word, not_word;
    Quantity quantity;
    Unit unit;
};
const std::vector<Item>& items()
{
    static const std::vector<Item> all{
        {"平均気温", "", kTemperature, {"C", 273.15, 1}},
        {"最低気温", "", kTemperatureMin, {"C", 273.15, 1}},
        {"最高気温", "", kTemperatureMax, {"C", 273.15, 1}},
        {"湿度", "最小", kHumidity, {"%", 0, 0.01}},
        {"降水量の合計", "", kPrecipitation, {"mm", 0, 1}},
        {"日照時間", "", kSunshine, {"h", 0, 1}},
        {"合計全天日射量", "", kGlobal, {"MJ/m^2", 0, 1e6 / 86400}},
        {"平均風速", "", kWindSpeed, {"m/s", 0, 1}},
        {"最多風向", "", kWindDirection, {"deg", 0, 1}},
        {"平均現地気圧", "", kPressure, {"hPa", 0, 1}},
    };
    return all;
}

bool holds(std::string_view text, std::string_view word)
{
    return !word.empty() && text.find(word) != std::string_view::npos;
}

/// Where a quantity stands in a line.
struct Place {
    std::size_t value = 0, quality = 0, no_phenomenon = 0;  // cell numbers; 0: none
    const Item* item = nullptr;
};

/// Finds each quantity's columns from the rows above the days.
std::vector<Place> find_columns(const std::vector<std::vector<std::string>>& header,
                                const std::vector<CsvCell>& item_row)
{
    std::vector<Place> places;
    for (std::size_t c = 1; c < item_row.size(); ++c) {
        const std::string_view name = item_row[c].text;
        auto below = [&](std::string_view word) {
            return std::any_of(header.begin(), header.end(), [&](const auto& row) {
                return c < row.size() && holds(row[c], word);
            });
        };
        const bool continues =
            !places.empty() && c > 1 && name == item_row[c - 1].text && places.back().item;
        if (below("均質番号") || below("時刻") || below("風向")) continue;
        if (below("品質情報")) {
            if (continues && places.back().quality == 0) places.back().quality = c;
            continue;
        }
        if (below("現象なし情報")) {
            if (continues) places.back().no_phenomenon = c;
            continue;
        }
        Place place;
        place.value = c;
        for (const Item& item : items())
            if (holds(name, item.word) && !holds(name, item.not_word)) {
                place.item = &item;
                break;
            }
        places.push_back(place);
    }
    std::erase_if(places, [](const Place& p) { return !p.item; });
    return places;
}

std::optional<double> read_direction(const CsvCell& cell, std::size_t line, Problems& problems)
{
    if (cell.text.empty() || cell.text == kCalm) return std::nullopt;
    const auto point = std::find(kPoints.begin(), kPoints.end(), cell.text);
    if (point == kPoints.end()) {
        problems.add(line, cell.column,
                     fmt::format("wind_direction: {}, expected one of 16 directions like 北北東 or "
                                 "静穏",
                                 quoted(cell.text)));
        return std::nullopt;
    }
    return direction_of_sixteenth(static_cast<int>(point - kPoints.begin()));
}

}  // namespace

RawWeather read_jma(std::string_view text, Problems& problems)
{
    RawWeather raw;
    CsvReader reader(text);
    std::string_view line;
    std::vector<CsvCell> cells, items_row, before;
    std::vector<std::vector<std::string>> header;  // rows between items and days
    std::vector<Place> places;
    bool in_header = true;
    std::size_t unusable = 0;

    // The row of items begins with 年月日; the stations stand above it.
    while (items_row.empty() && reader.next_line(line)) {
        CsvReader::split(line, ',', cells);
        if (cells[0].text.starts_with("年月日")) {
            items_row = cells;
            raw.header_line = reader.line();
        } else if (cells.size() > 1) {
            before = cells;
        }
    }
    if (items_row.empty()) {
        problems.add(1, 1, "no row of items, expected one that begins with 年月日");
        return raw;
    }
    if (items_row[0].text != "年月日") {
        problems.add(raw.header_line, 1,
                     fmt::format("{}, expected daily values, whose row begins with 年月日; choose "
                                 "日別値 when downloading",
                                 quoted(items_row[0].text)));
        return raw;
    }
    std::string_view station;
    for (std::size_t c = 1; c < before.size(); ++c) {
        if (before[c].text.empty()) continue;
        if (station.empty()) station = before[c].text;
        if (before[c].text != station) {
            problems.add(raw.header_line - 1, before[c].column,
                         fmt::format("stations {} and {}, expected one", quoted(station),
                                     quoted(before[c].text)));
            return raw;
        }
    }

    while (reader.next_line(line)) {
        if (line.find_first_not_of(" \t,") == std::string_view::npos && !in_header) continue;
        CsvReader::split(line, ',', cells);
        if (in_header) {
            const bool day = !cells[0].text.empty();
            if (!day) {
                std::vector<std::string> row;
                for (const CsvCell& cell : cells) row.emplace_back(cell.text);
                if (header.size() < 4) header.push_back(std::move(row));
                continue;
            }
            in_header = false;
            places = find_columns(header, items_row);
            for (const Place& place : places) {
                if (raw.given[place.item->quantity])
                    problems.add(raw.header_line, items_row[place.value].column,
                                 fmt::format("{} is there twice, expected one station and one "
                                             "period",
                                             quoted(items_row[place.value].text)));
                raw.given[place.item->quantity] = true;
            }
        }
        RawDay day;
        day.line = reader.line();
        const auto date = read_date(cells[0], day.line, problems);
        for (const Place& place : places) {
            const Quantity q = place.item->quantity;
            if (place.value >= cells.size()) {
                problems.add(
                    day.line, cells.back().column,
                    fmt::format("line has {} cells, expected {}", cells.size(), items_row.size()));
                break;
            }
            const CsvCell& cell = cells[place.value];
            day.column[q] = cell.column;
            auto flag = [&](std::size_t c, std::string_view name) -> std::optional<double> {
                if (c == 0 || c >= cells.size() || cells[c].text.empty()) return std::nullopt;
                const auto number = number_of(cells[c].text);
                if (!number)
                    problems.add(
                        day.line, cells[c].column,
                        fmt::format("{}: {}, expected a number", name, quoted(cells[c].text)));
                return number;
            };
            const auto quality = flag(place.quality, "品質情報");
            const auto nothing = flag(place.no_phenomenon, "現象なし情報");
            if (quality && !usable(*quality)) {
                ++unusable;
                continue;
            }
            if (q == kWindDirection)
                day.value[q] = read_direction(cell, day.line, problems);
            else if (cell.text.empty() && nothing == 1)
                day.value[q] = 0;
            else
                day.value[q] = read_quantity(cell, day.line, q, place.item->unit, problems);
        }
        if (date) {
            day.date = *date;
            raw.days.push_back(day);
        } else {
            raw.dates_complete = false;
        }
    }
    if (!station.empty()) raw.notes.push_back(fmt::format("station {}", station));
    if (unusable > 0)
        raw.notes.push_back(
            fmt::format("{} values of quality 4 or less taken as missing", unusable));
    return raw;
}

}  // namespace sekitei::weather_formats
