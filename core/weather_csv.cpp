#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/error.h"
#include "core/math.h"
#include "core/params.h"
#include "core/units.h"
#include "core/weather_formats.h"

/// Our own CSV: names with units in the header, one line a day or a month.
namespace sekitei::weather_formats {
namespace {

constexpr std::array<std::string_view, 16> kPoints{"N",  "NNE", "NE", "ENE", "E",  "ESE",
                                                   "SE", "SSE", "S",  "SSW", "SW", "WSW",
                                                   "W",  "WNW", "NW", "NNW"};

/// A column of the file.
struct Column {
    enum Kind { Skip, Day, Month, Value, WetDays } kind = Skip;
    Quantity quantity = kTemperature;
    Unit unit{"", 0, 1};
};

/// Totals of a year that a file of normals may give instead of monthly ones.
struct YearTotals {
    std::optional<double> precipitation, wet_days;
};

struct Table {
    char separator = ',';
    std::vector<Column> columns;
    std::size_t header_line = 0;  // 0: none found
    std::optional<double> latitude, longitude, hargreaves;
    YearTotals totals;

    const Column* find(Column::Kind kind) const
    {
        for (const Column& c : columns)
            if (c.kind == kind) return &c;
        return nullptr;
    }
};

/// "# latitude = 47.44 deg" before the header; other comments are for people.
void read_comment(std::string_view line, std::size_t number, Table& table, Problems& problems)
{
    line.remove_prefix(line.find('#') + 1);
    const std::size_t equals = line.find('=');
    if (equals == std::string_view::npos) return;
    auto trimmed = [](std::string_view t) {
        // Spreadsheets pad every line with separators.
        while (!t.empty() && std::string_view(" \t,;\"").find(t.front()) != t.npos)
            t.remove_prefix(1);
        while (!t.empty() && std::string_view(" \t,;\"").find(t.back()) != t.npos)
            t.remove_suffix(1);
        return t;
    };
    const std::string_view key = trimmed(line.substr(0, equals)),
                           text = trimmed(line.substr(equals + 1));
    auto take = [&](std::optional<double>& value, std::string_view unit, double low, double high) {
        try {
            const double v = parse_quantity(text, unit);
            if (!(v >= low && v <= high))
                problems.add(
                    number, 1,
                    fmt::format("{}: {}, expected {:g} to {:g} {}", key, text, low, high, unit));
            else
                value = v;
        } catch (const InvalidInput& error) {
            problems.add(number, 1, fmt::format("{}: {}", key, error.what()));
        }
    };
    if (key == "latitude") take(table.latitude, "deg", -90, 90);
    if (key == "longitude") take(table.longitude, "deg", -360, 360);
    if (key == "hargreaves") take(table.hargreaves, "", 0.05, 0.5);
    if (key == "precipitation") take(table.totals.precipitation, "mm", 0, 30000);
    if (key == "wet_days") take(table.totals.wet_days, "", 0, 366);
}

std::string names_text()
{
    std::string all;
    for (int q = 0; q < kQuantities; ++q) {
        const QuantityInfo& of = info(static_cast<Quantity>(q));
        all += fmt::format("{}{} [{}]", all.empty() ? "" : ", ", of.name, of.units[0].name);
    }
    return all;
}

void read_header(std::string_view line, std::size_t number, Table& table, Problems& problems)
{
    table.header_line = number;
    auto holds = [&](char c) { return line.find(c) != std::string_view::npos; };
    table.separator = holds(',') ? ',' : holds(';') ? ';' : holds('\t') ? '\t' : ',';
    std::vector<CsvCell> cells;
    CsvReader::split(line, table.separator, cells);
    bool names_told = false;
    std::array<std::size_t, kQuantities> seen{};
    for (const CsvCell& cell : cells) {
        // "humidity [%]" is a name and a unit.
        std::string_view name = cell.text, unit;
        if (const std::size_t open = name.find('['); open != std::string_view::npos) {
            unit = name.substr(open + 1);
            unit = unit.substr(0, std::min(unit.find(']'), unit.size()));
            name = name.substr(0, open);
            while (!name.empty() && name.back() == ' ') name.remove_suffix(1);
        }
        Column column;
        auto& kind = column.kind;
        if (name == "date") kind = Column::Day;
        if (name == "month") kind = Column::Month;
        if (name == "wet_days") kind = Column::WetDays;
        std::vector<std::string> known{"date", "month", "wet_days", "remark"};
        for (int q = 0; q < kQuantities && kind == Column::Skip; ++q) {
            const auto quantity = static_cast<Quantity>(q);
            const QuantityInfo& of = info(quantity);
            known.emplace_back(of.name);
            if (name != of.name) continue;
            kind = Column::Value;
            column.quantity = quantity;
            if (seen[quantity] > 0)
                problems.add(number, cell.column,
                             fmt::format("{} is there twice, at columns {} and {}", name,
                                         seen[quantity], cell.column));
            seen[quantity] = cell.column;
            const auto found = std::find_if(of.units.begin(), of.units.end(),
                                            [&](const Unit& u) { return u.name == unit; });
            if (found != of.units.end()) {
                column.unit = *found;
            } else if (quantity == kWindDirection && unit.empty()) {
                column.unit = of.units[0];  // names of winds
            } else {
                std::string units;
                for (const Unit& u : of.units)
                    units += fmt::format("{}[{}]", units.empty() ? "" : " ", u.name);
                problems.add(number, cell.column,
                             fmt::format("{}: {}, expected one of: {}", name,
                                         unit.empty() ? "no unit" : "unit " + quoted(unit), units));
            }
        }
        if (kind == Column::Skip && name != "remark" && !name.empty()) {
            const std::string near = nearest_name(name, known);
            problems.add(number, cell.column,
                         fmt::format("column {} is not known{}", quoted(name),
                                     !near.empty() ? fmt::format(", did you mean {}?", near)
                                     : !names_told ? fmt::format(", expected date, {} or remark",
                                                                 names_text())
                                                   : ""));
            names_told = names_told || near.empty();
        }
        table.columns.push_back(column);
    }
}

/// Degrees, or the name of one of 8 or 16 winds.
std::optional<double> read_direction(const CsvCell& cell, std::size_t line, const Unit& unit,
                                     Problems& problems)
{
    const auto point = std::find(kPoints.begin(), kPoints.end(), cell.text);
    if (point != kPoints.end())
        return direction_of_sixteenth(static_cast<int>(point - kPoints.begin()));
    if (!cell.text.empty() && !number_of(cell.text)) {
        problems.add(line, cell.column,
                     fmt::format("wind_direction: {}, expected degrees or one of N NNE NE ENE ...",
                                 quoted(cell.text)));
        return std::nullopt;
    }
    const auto degrees = read_quantity(cell, line, kWindDirection, unit, problems);
    if (!degrees) return std::nullopt;
    return direction_of_degrees(*degrees);
}

/// Calls row(cells, line) for each line after the header.
template <class Row>
Table read_table(std::string_view text, Problems& problems, Row&& row)
{
    Table table;
    CsvReader reader(text);
    std::string_view line;
    std::vector<CsvCell> cells;
    while (reader.next_line(line)) {
        const std::size_t begin = line.find_first_not_of(" \t\",;");
        if (begin == std::string_view::npos) continue;
        if (line[begin] == '#') {
            read_comment(line, reader.line(), table, problems);
        } else if (table.header_line == 0) {
            read_header(line, reader.line(), table, problems);
        } else {
            CsvReader::split(line, table.separator, cells);
            while (cells.size() > table.columns.size() && cells.back().text.empty())
                cells.pop_back();
            if (cells.size() > table.columns.size())
                problems.add(reader.line(), cells[table.columns.size()].column,
                             fmt::format("line has {} cells, expected the header's {}",
                                         cells.size(), table.columns.size()));
            row(table, cells, reader.line());
        }
    }
    return table;
}

/// The values of a line, put into `day`.
void read_values(const Table& table, const std::vector<CsvCell>& cells, std::size_t line,
                 RawDay& day, Problems& problems)
{
    const std::size_t end = cells.empty() ? 1 : cells.back().column + cells.back().text.size();
    for (std::size_t c = 0; c < table.columns.size(); ++c) {
        const Column& column = table.columns[c];
        if (column.kind != Column::Value) continue;
        const CsvCell cell = c < cells.size() ? cells[c] : CsvCell{{}, end};
        day.column[column.quantity] = cell.column;
        day.value[column.quantity] =
            column.quantity == kWindDirection
                ? read_direction(cell, line, column.unit, problems)
                : read_quantity(cell, line, column.quantity, column.unit, problems);
    }
}

void take_header(const Table& table, RawWeather& raw)
{
    raw.header_line = std::max<std::size_t>(1, table.header_line);
    for (const Column& c : table.columns)
        if (c.kind == Column::Value) raw.given[c.quantity] = true;
    raw.hargreaves = table.hargreaves;
    // Without a longitude noon is at 12 hours of universal time, which daily means do not see.
    if (table.latitude)
        raw.site =
            Site{*table.latitude * math::kPi / 180, table.longitude.value_or(0) * math::kPi / 180};
}

/// The header's number of a cell of this kind on a line; what is wrong becomes a problem.
std::optional<double> read_cell(const Table& table, Column::Kind kind,
                                const std::vector<CsvCell>& cells, std::size_t line,
                                std::string_view name, double low, double high, Problems& problems)
{
    const Column* column = table.find(kind);
    if (!column) return std::nullopt;
    const auto at = static_cast<std::size_t>(column - table.columns.data());
    const CsvCell cell = at < cells.size() ? cells[at] : CsvCell{{}, 1};
    const auto value = number_of(cell.text);
    if (!value || !(*value >= low && *value <= high)) {
        problems.add(line, cell.column,
                     fmt::format("{}: {}, expected a number from {:g} to {:g}", name,
                                 quoted(cell.text), low, high));
        return std::nullopt;
    }
    return value;
}

int days_in(int month)
{
    constexpr std::array<int, 12> kDays{31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31};
    return kDays[static_cast<std::size_t>(month - 1)];
}

}  // namespace

RawWeather read_own(std::string_view text, Problems& problems)
{
    RawWeather raw;
    const Table table =
        read_table(text, problems, [&](const Table& t, const auto& cells, std::size_t line) {
            const Column* date = t.find(Column::Day);
            if (!date) return;  // told below, once
            const auto at = static_cast<std::size_t>(date - t.columns.data());
            RawDay day;
            day.line = line;
            const auto read =
                read_date(at < cells.size() ? cells[at] : CsvCell{{}, 1}, line, problems);
            read_values(t, cells, line, day, problems);
            if (!read) {
                raw.dates_complete = false;
                return;
            }
            day.date = *read;
            raw.days.push_back(day);
        });
    take_header(table, raw);
    if (!table.find(Column::Day))
        problems.add(raw.header_line, 1,
                     "no column date, expected a header like: date, temperature [C], humidity [%], "
                     "precipitation [mm], wind_speed [m/s], sunshine [h]; or a daily CSV of the "
                     "Japan Meteorological Agency; or EPW, which begins with LOCATION");
    return raw;
}

RawWeather read_normals(std::string_view text, Problems& problems)
{
    std::array<RawDay, 12> months;
    std::array<std::optional<double>, 12> wet_days;
    const Table table =
        read_table(text, problems, [&](const Table& t, const auto& cells, std::size_t line) {
            RawDay values;
            values.line = line;
            read_values(t, cells, line, values, problems);
            const auto number = read_cell(t, Column::Month, cells, line, "month", 1, 12, problems);
            if (!number) return;
            const auto month = static_cast<std::size_t>(*number) - 1;
            if (*number != std::floor(*number) || months[month].line > 0) {
                problems.add(line, 1,
                             fmt::format("month: {}, expected each of 1 to 12 once", *number));
                return;
            }
            wet_days[month] = read_cell(t, Column::WetDays, cells, line, "wet_days", 0,
                                        days_in(static_cast<int>(month) + 1), problems);
            months[month] = values;
        });
    RawWeather raw;
    take_header(table, raw);
    for (std::size_t m = 0; m < 12; ++m)
        if (months[m].line == 0)
            problems.add(raw.header_line, 1,
                         fmt::format("month {} is missing, expected 1 to 12", m + 1));
    const bool monthly = raw.given[kPrecipitation] && table.find(Column::WetDays);
    const YearTotals& totals = table.totals;
    if (!monthly && !(totals.precipitation && totals.wet_days))
        problems.add(
            raw.header_line, 1,
            "rain is missing, expected the columns precipitation [mm] and wet_days, or "
            "lines before the header like: # precipitation = 1271 mm and # wet_days = 165");
    if (problems.any()) return raw;

    // Days of a common year; a wet day is one on which the count of wet days so far steps up.
    raw.given[kPrecipitation] = true;
    int day_of_year = 0;
    for (int month = 1; month <= 12; ++month) {
        const auto m = static_cast<std::size_t>(month - 1);
        for (int day = 1; day <= days_in(month); ++day) {
            ++day_of_year;
            RawDay d = months[m];
            d.date = {2023, month, day};
            double wet = 0, of = 0, rain = 0;
            int step = 0;
            if (monthly) {
                wet = *wet_days[m];
                of = days_in(month);
                step = day;
                rain = months[m].value[kPrecipitation].value_or(0);
            } else {
                wet = *totals.wet_days;
                of = 365;
                step = day_of_year;
                rain = *totals.precipitation;
            }
            const bool rains =
                std::floor(wet * step / of) > std::floor(wet * (step - 1) / of) && wet >= 1;
            d.value[kPrecipitation] = rains ? rain / std::floor(wet) : 0;
            if (d.value[kHumidity])
                d.value[kHumidity] = std::min(1.0, *d.value[kHumidity] * (rains ? 1.1 : 0.93));
            raw.days.push_back(d);
        }
    }
    raw.notes.push_back(
        "a year made of monthly normals, dated 2023: wet days evenly spread, each with the same "
        "rain and 1.1 times the mean humidity, dry days 0.93 times; all else the month's mean");
    return raw;
}

}  // namespace sekitei::weather_formats
