#include "core/weather.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <iconv.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "core/error.h"
#include "core/solar_day.h"

namespace sekitei {
namespace {

using testing::AllOf;
using testing::Contains;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;
using testing::ThrowsMessage;

constexpr double kDegree = std::numbers::pi / 180;
constexpr Site kMorioka{39.70 * kDegree, 141.15 * kDegree};

Weather read(const std::string& text, std::optional<Site> site = kMorioka,
             WeatherFill fill = WeatherFill::Error)
{
    return decode_weather(text, "w.csv", site, fill);
}

std::string message(const std::string& text, std::optional<Site> site = kMorioka,
                    WeatherFill fill = WeatherFill::Error)
{
    try {
        read(text, site, fill);
    } catch (const InvalidInput& error) {
        return error.what();
    }
    return "nothing was wrong";
}

/// A year whose values are all different from day to day.
std::vector<WeatherDay> synthetic_year()
{
    std::vector<WeatherDay> days;
    for (int d = 1; d <= 365; ++d) {
        const Date date = date_of(day_number(2023, 1, 1) + d - 1);
        WeatherDay day;
        day.year = date.year;
        day.month = date.month;
        day.day = date.day;
        day.temperature = 283.15 + 0.01 * std::round(1300 * std::sin(d / 58.0)) + 0.001 * d;
        day.humidity = 0.5 + 0.001 * ((d * 37) % 450);
        day.precipitation = d % 3 == 0 ? 0.5 * (d % 41) : 0;
        day.wind_speed = 0.1 * (1 + d % 57);
        day.wind_direction = d * 5 % 8;
        day.possible_sunshine = possible_sunshine(kMorioka.latitude, d);
        day.sunshine = 0.1 * std::floor(day.possible_sunshine * (d % 11));
        day.global_radiation = 100 + 0.25 * d;
        day.pressure = 990 + 0.1 * (d % 100);
        days.push_back(day);
    }
    return days;
}

void expect_same(const std::vector<WeatherDay>& found, const std::vector<WeatherDay>& wanted,
                 bool with_radiation, bool with_pressure)
{
    ASSERT_EQ(found.size(), wanted.size());
    for (std::size_t i = 0; i < found.size(); ++i) {
        const WeatherDay &a = found[i], &b = wanted[i];
        SCOPED_TRACE(fmt::format("{}-{}-{}", b.year, b.month, b.day));
        EXPECT_EQ(day_number(a.year, a.month, a.day), day_number(b.year, b.month, b.day));
        EXPECT_NEAR(a.temperature, b.temperature, 1e-9);
        EXPECT_NEAR(a.humidity, b.humidity, 1e-9);
        EXPECT_NEAR(a.precipitation, b.precipitation, 1e-9);
        EXPECT_NEAR(a.wind_speed, b.wind_speed, 1e-9);
        EXPECT_EQ(a.wind_direction, b.wind_direction);
        EXPECT_NEAR(a.sunshine, b.sunshine, 1e-9);
        EXPECT_NEAR(a.possible_sunshine, b.possible_sunshine, 1e-12);
        if (with_radiation) {
            EXPECT_NEAR(a.global_radiation.value_or(-1), *b.global_radiation, 1e-9);
        }
        if (with_pressure) {
            EXPECT_NEAR(a.pressure, b.pressure, 1e-9);
        }
    }
}

std::string to_shift_jis(std::string text)
{
    const iconv_t converter = iconv_open("CP932", "UTF-8");
    std::string out(text.size(), '\0');
    char *from = text.data(), *to = out.data();
    std::size_t left = text.size(), room = out.size();
    EXPECT_NE(iconv(converter, &from, &left, &to, &room), std::size_t(-1));
    iconv_close(converter);
    out.resize(out.size() - room);
    return out;
}

constexpr const char* kPoints8[] = {"N", "NE", "E", "SE", "S", "SW", "W", "NW"};
constexpr const char* kPointsJma[] = {"北", "北東", "東", "南東", "南", "南西", "西", "北西"};

/// A table as the agency's site hands it out, in UTF-8.
std::string jma(const std::vector<WeatherDay>& days)
{
    std::string text = "ダウンロードした時刻：2024/05/12 10:10:10\r\n\r\n";
    struct Item {
        const char* name;
        int columns;
    };
    const Item items[] = {{"平均気温(℃)", 3},     {"降水量の合計(mm)", 4}, {"日照時間(時間)", 4},
                          {"平均風速(m/s)", 3},   {"最多風向(16方位)", 3}, {"平均湿度(％)", 3},
                          {"最小相対湿度(％)", 3}};
    std::string stations, names, kinds;
    for (const Item& item : items)
        for (int c = 0; c < item.columns; ++c) {
            stations += ",盛岡";
            names += fmt::format(",{}", item.name);
            const int from_end = item.columns - c;
            kinds += c == 0          ? ","
                     : from_end == 1 ? ",均質番号"
                     : from_end == 2 ? ",品質情報"
                                     : ",現象なし情報";
        }
    text +=
        stations + "\r\n年月日" + names + "\r\n" + std::string(23, ',') + "\r\n" + kinds + "\r\n";
    for (const WeatherDay& d : days)
        text += fmt::format(
            "{}/{}/{},{:.10f},8,1,{:.10f},{},8,1,{:.10f},0,8,1,{:.10f},8,1,{},8,1,{:.10f},8,1,11,8,"
            "1\r\n",
            d.year, d.month, d.day, d.temperature - 273.15, d.precipitation,
            d.precipitation > 0 ? 0 : 1, d.sunshine, d.wind_speed, kPointsJma[d.wind_direction],
            d.humidity * 100);
    return text;
}

std::string own(const std::vector<WeatherDay>& days)
{
    std::string text =
        "# A year\n# latitude = 39.70 deg\n# longitude = 141.15 deg\n"
        "date, temperature [C], humidity [%], precipitation [mm], wind_speed [km/h], "
        "wind_direction [deg], sunshine [h], global [MJ/m^2], pressure [kPa], remark\n";
    for (const WeatherDay& d : days)
        text += fmt::format(
            "{:04}-{:02}-{:02},{:.10f},{:.10f},{:.10f},{:.10f},{},{:.10f},{:.12f},"
            "{:.10f},\"dry, mostly\"\n",
            d.year, d.month, d.day, d.temperature - 273.15, d.humidity * 100, d.precipitation,
            d.wind_speed * 3.6, d.wind_direction * 45, d.sunshine, *d.global_radiation * 0.0864,
            d.pressure / 10);
    return text;
}

/// EPW hours around each day's means: what is added before noon is taken off after it.
std::string epw(const std::vector<WeatherDay>& days, bool typical = false)
{
    std::string text =
        "LOCATION,Morioka,-,JPN,TEST,475840,39.70,141.15,9.0,155.0\nDESIGN CONDITIONS,0\n"
        "TYPICAL/EXTREME PERIODS,0\nGROUND 12.33692676ERATURES,0\nHOLIDAYS/DAYLIGHT "
        "SAVINGS,No,0,0,0\n"
        "COMMENTS 1,made for a test\nCOMMENTS 2,\nDATA PERIODS,1,1,Data,Sunday,1/ 1,12/31\n";
    for (const WeatherDay& d : days)
        for (int hour = 1; hour <= 24; ++hour) {
            const double swing = hour <= 12 ? hour - 6.5 : 18.5 - hour;  // sums to zero
            const bool sunny = hour <= 4 + static_cast<int>(d.sunshine) && hour > 4;
            const bool day = hour > 6 && hour <= 18;
            text += fmt::format(
                "{},{},{},{},0,?9?9,{:.10f},{:.10f},{:.10f},{:.8f},0,0,{:.10f},{:.10f},{},{:.10f},"
                "0,0,0,0,{},{:.10f},5,5,9999,99999,9,999999999,99,0.1,0,88,0.2,{:.10f},1\n",
                typical ? 1990 + d.month * 7 % 10 : d.year, d.month, d.day, hour,
                d.temperature - 273.15 + 0.3 * swing, d.temperature - 280,
                d.humidity * 100 - 0.2 * swing, d.pressure * 100, 300 + swing,
                day ? *d.global_radiation * 2 : 0, sunny ? 121 : 119, day ? *d.global_radiation : 0,
                (d.wind_direction * 45 + 350 + hour % 21) % 360, d.wind_speed + 0.01 * swing,
                d.precipitation / 24);
        }
    return text;
}

TEST(Weather, OwnCsvReadsBackTheYearItWasMadeFrom)
{
    const Weather weather = read(own(synthetic_year()), {});
    expect_same(weather.days, synthetic_year(), true, true);
    ASSERT_TRUE(weather.site);
    EXPECT_NEAR(weather.site->latitude, kMorioka.latitude, 1e-12);
    EXPECT_NEAR(weather.site->longitude, kMorioka.longitude, 1e-12);
    EXPECT_THAT(weather.notes, IsEmpty());
}

TEST(Weather, ByteOrderMarkLineEndingsAndSeparatorsDoNotMatter)
{
    auto days = synthetic_year();
    days.resize(40);
    const std::string text = own(days);
    auto replaced = [&](char from, std::string_view to) {
        std::string out;
        for (const char c : text) out += c == from ? std::string(to) : std::string(1, c);
        return out;
    };
    expect_same(read("\xEF\xBB\xBF" + text).days, days, true, true);
    expect_same(read(replaced('\n', "\r\n")).days, days, true, true);
    expect_same(read(replaced('\n', "\r")).days, days, true, true);
    expect_same(read(replaced(',', ";")).days, days, true, true);
    expect_same(read(text.substr(0, text.size() - 1)).days, days, true, true);
}

TEST(Weather, JmaTablesAreReadInShiftJisAndUtf8)
{
    const auto year = synthetic_year();
    for (const std::string& text : {jma(year), to_shift_jis(jma(year))}) {
        const Weather weather = read(text);
        expect_same(weather.days, year, false, false);
        EXPECT_THAT(weather.notes, ElementsAre("station 盛岡"));
        EXPECT_FALSE(weather.days[0].global_radiation);
    }
}

TEST(Weather, JmaQualityTellsWhichValuesCount)
{
    auto days = synthetic_year();
    days.resize(5);
    const std::string text = jma(days);
    auto with = [&](std::string_view quality, std::string_view value) {
        // The second day's temperature and its quality.
        const std::string from = fmt::format("{:.10f},8,1,", days[1].temperature - 273.15);
        std::string out = text;
        return out.replace(out.find(from), from.size(), fmt::format("{},{},1,", value, quality));
    };
    EXPECT_NEAR(read(with("5", "12.5")).days[1].temperature, 285.65, 1e-9);
    for (const char* quality : {"4", "2", "1", "0"}) {
        EXPECT_THAT(
            message(with(quality, "12.5")),
            HasSubstr("w.csv:8:10: temperature: no value on 2023-01-02, expected a number"));
        const Weather bridged = read(with(quality, ""), kMorioka, WeatherFill::Interpolate);
        EXPECT_NEAR(bridged.days[1].temperature, (days[0].temperature + days[2].temperature) / 2,
                    1e-9);
        EXPECT_THAT(bridged.notes, Contains("temperature: interpolated on 1 day"));
        EXPECT_THAT(bridged.notes, Contains("1 values of quality 4 or less taken as missing"));
    }
    // A blank with "no phenomenon" is a dry day.
    std::string dry = text;
    const std::string rain = fmt::format(",8,1,{:.10f},1,8,1", days[0].precipitation);
    dry.replace(dry.find(rain), rain.size(), ",8,1,,1,8,1");
    EXPECT_EQ(read(dry).days[0].precipitation, 0);
}

TEST(Weather, EpwHoursBecomeDailyMeans)
{
    auto year = synthetic_year();
    for (WeatherDay& d : year) d.sunshine = std::min(d.possible_sunshine, std::floor(d.sunshine));
    const Weather weather = read(epw(year), {});
    expect_same(weather.days, year, true, true);
    ASSERT_TRUE(weather.site);
    EXPECT_NEAR(weather.site->latitude, kMorioka.latitude, 1e-12);
    for (const WeatherDay& d : weather.days) {
        EXPECT_NEAR(d.longwave.value_or(-1), 300, 1e-9);
        EXPECT_NEAR(d.diffuse_radiation.value_or(-1), *d.global_radiation / 2, 1e-9);
    }
}

TEST(Weather, EpwMissingCodesAreHonoured)
{
    auto days = synthetic_year();
    days.resize(3);
    for (WeatherDay& d : days) d.sunshine = std::floor(d.sunshine);
    const std::string text = epw(days);
    // Replaces a column in the first `hours` hours of the second day.
    auto with = [&](std::size_t column, std::string_view value, int hours) {
        std::string out;
        std::size_t at = 0;
        for (int line = 1; at < text.size(); ++line) {
            const std::size_t end = text.find('\n', at);
            std::string row = text.substr(at, end - at);
            if (line > 8 + 24 && line <= 8 + 24 + hours) {
                std::size_t begin = 0;
                for (std::size_t c = 1; c < column; ++c) begin = row.find(',', begin) + 1;
                row.replace(begin, std::min(row.find(',', begin), row.size()) - begin, value);
            }
            out += row + "\n";
            at = end + 1;
        }
        return out;
    };
    // Four hours of 24 may lack: their mean is that of the others.
    const double mean =
        (24 * days[1].temperature - 4 * days[1].temperature - 0.3 * (-5.5 - 4.5 - 3.5 - 2.5)) / 20;
    const Weather four = read(with(7, "99.9", 4));
    EXPECT_NEAR(four.days[1].temperature, mean, 1e-9);
    EXPECT_THAT(four.notes, Contains("means of the hours there are on 1 days with hours missing"));
    EXPECT_THAT(message(with(7, "99.9", 5)),
                HasSubstr("temperature: no value on 2023-01-02, expected a number"));
    EXPECT_NEAR(read(with(7, "99.9", 24), {}, WeatherFill::Interpolate).days[1].temperature,
                (days[0].temperature + days[2].temperature) / 2, 1e-9);
    EXPECT_FALSE(read(with(13, "9999", 1)).days[1].longwave);
    EXPECT_FALSE(read(with(14, "9999", 1)).days[1].global_radiation);
    EXPECT_TRUE(read(with(14, "9999", 1)).days[0].global_radiation);
    EXPECT_EQ(read(with(10, "999999", 24)).days[1].pressure, 1013);
    EXPECT_EQ(read(with(21, "999", 24)).days[1].wind_direction, days[0].wind_direction);
    EXPECT_NEAR(read(with(34, "999", 4)).days[1].precipitation, days[1].precipitation, 1e-9);
    EXPECT_THAT(message(with(22, "999", 24)), HasSubstr("wind_speed: no value on 2023-01-02"));
    // Humidity comes from the dew point, sunshine from global radiation.
    EXPECT_THAT(read(with(9, "999", 24)).notes, Contains("humidity: from the dew point on 1 day"));
    EXPECT_THAT(read(with(15, "9999", 24)).notes,
                Contains("sunshine: from global radiation [FAO-56, eq. 35 solved for n] on 1 day"));
    EXPECT_THAT(message(with(9, "130", 1)),
                HasSubstr("w.csv:33:45: relative humidity: 130 %, expected 0 to 110 %"));
}

TEST(Weather, EpwOfATypicalYearGetsOneYear)
{
    auto year = synthetic_year();
    for (WeatherDay& d : year) d.sunshine = 0;
    const Weather weather = read(epw(year, true));
    expect_same(weather.days, year, true, true);
    EXPECT_THAT(weather.notes,
                Contains("a typical year made of months of several years, dated 2023"));
}

constexpr const char* kHeader =
    "date, temperature [C], humidity [%], precipitation [mm], wind_speed [m/s], "
    "wind_direction [deg], sunshine [h]\n";

TEST(Weather, AllBadFieldsAreNamedAtOnce)
{
    const std::string text = std::string(kHeader) +
                             "2023-02-27, 1, 70, 0, 2, 0, 3\n"
                             "2023-02-28, 1, 130, 0, -1, 0, 3\n"
                             "2023-02-30, 1, 70, 0, 2, 0, 3\n"
                             "2023-03-01, warm, 70, 0, 2, 361, 3\n"
                             "2023-03-02, nan, 70, -0.5, 2, 0, 24.5, 7\n";
    EXPECT_EQ(message(text),
              "w.csv:3:16: humidity: 130 %, expected 0 to 100 %\n"
              "w.csv:3:24: wind_speed: -1 m/s, expected 0 to 150 m/s\n"
              "w.csv:4:1: date: '2023-02-30', expected a day of the calendar\n"
              "w.csv:5:13: temperature: 'warm', expected a number\n"
              "w.csv:5:29: wind_direction: 361 deg, expected 0 to 360 deg\n"
              "w.csv:6:13: temperature: 'nan', expected a number\n"
              "w.csv:6:22: precipitation: -0.5 mm, expected 0 to 5000 mm\n"
              "w.csv:6:34: sunshine: 24.5 h, expected 0 to 24 h\n"
              "w.csv:6:40: line has 8 cells, expected the header's 7");
}

TEST(Weather, MissingRepeatedAndSwappedDaysAreNamed)
{
    const std::string text = std::string(kHeader) +
                             "2023-02-27, 1, 70, 0, 2, 0, 3\n"
                             "2023-03-01, 2, 72, 4, 4, 90, 5\n"
                             "2023-03-01, 2, 72, 4, 4, 90, 5\n"
                             "2023-02-28, 2, 72, 4, 4, 90, 5\n"
                             "2023-03-05, 1, 70, 0, 2, 0, 3\n";
    EXPECT_EQ(message(text),
              "w.csv:3:1: date: 2023-02-28 is missing, expected every day; fill = interpolate "
              "bridges gaps\n"
              "w.csv:4:1: date: 2023-03-01 follows 2023-03-01, expected the day after it\n"
              "w.csv:5:1: date: 2023-02-28 follows 2023-03-01, expected the day after it\n"
              "w.csv:6:1: date: 3 days from 2023-03-02 are missing, expected every day; fill = "
              "interpolate bridges gaps");
}

TEST(Weather, GapsAreBridgedByStraightLinesOnlyWhenAskedAndNotTooFar)
{
    const std::string text = std::string(kHeader) +
                             "2023-02-27, 1, 70, 0, 2, 45, 3\n"
                             "2023-03-02, 4, 76, 6, 5, 90, 6\n"
                             "2023-03-03, , 76, 6, 5, 90, 6\n";
    const Weather weather = read(text, kMorioka, WeatherFill::Interpolate);
    ASSERT_EQ(weather.days.size(), 5u);
    for (std::size_t k = 0; k < 4; ++k) {
        const auto t = static_cast<double>(k);
        EXPECT_NEAR(weather.days[k].temperature, 274.15 + t, 1e-9);
        EXPECT_NEAR(weather.days[k].humidity, 0.70 + 0.02 * t, 1e-9);
        EXPECT_NEAR(weather.days[k].precipitation, 2 * t, 1e-9);
        EXPECT_NEAR(weather.days[k].sunshine, 3 + t, 1e-9);
        EXPECT_EQ(weather.days[k].wind_direction, k < 3 ? 1 : 2);
    }
    EXPECT_EQ(weather.days[1].day, 28);
    EXPECT_EQ(weather.days[2].month, 3);
    EXPECT_NEAR(weather.days[4].temperature, 277.15, 1e-9);  // the end holds the last value
    EXPECT_THAT(weather.notes, Contains("2 missing days interpolated between neighbours"));
    EXPECT_THAT(message(std::string(kHeader) + "2023-01-01, 1, 70, 0, 2, 45, 3\n"
                                               "2023-02-02, 1, 70, 0, 2, 45, 3\n",
                        kMorioka, WeatherFill::Interpolate),
                HasSubstr("31 days from 2023-01-02 are missing, interpolation bridges at most 30"));
}

TEST(Weather, WrongEncodingsAreNamedWithTheirPlace)
{
    EXPECT_THAT(message(to_shift_jis("# 盛岡\n") + kHeader + "2023-01-01, 1, 130, 0, 2, 0, 3\n"),
                AllOf(HasSubstr("w.csv:1:3: byte 0x90 is not UTF-8; save the file as UTF-8"),
                      HasSubstr("w.csv:3:16: humidity: 130 %")));
    EXPECT_THAT(message("\xFF\xFE" + std::string("d\0a\0", 4)), HasSubstr("is in UTF-16"));
    EXPECT_THAT(message(std::string("\x89PNG\0\1", 6)), HasSubstr("holds a zero byte at byte 4"));
    EXPECT_EQ(message(""), "w.csv: empty file");
    EXPECT_THAT(message("苔, 石\n1, 2\n"), AllOf(HasSubstr("w.csv:1:1: column '苔' is not known"),
                                                 HasSubstr("w.csv:1:4: column '石' is not known")));
    // Columns count characters, not bytes.
    EXPECT_THAT(message("remark, date, temperature [C], humidity [%], precipitation [mm], "
                        "wind_speed [m/s], sunshine [h]\n石庭の天気, 2023-01-01, x, 70, 0, 1, 3\n"),
                HasSubstr("w.csv:2:20: temperature: 'x'"));
}

TEST(Weather, HeadersThatDoNotFitAreNamed)
{
    EXPECT_THAT(message("date, temprature [C], humidity, precipitation [mm], wind_speed [m/s], "
                        "wind_speed [m/s], sunshine [d]\n2023-01-01,1,1,1,1,1,1\n"),
                AllOf(HasSubstr("w.csv:1:7: column 'temprature' is not known, did you mean "
                                "temperature?"),
                      HasSubstr("w.csv:1:23: humidity: no unit, expected one of: [%] [1]"),
                      HasSubstr("w.csv:1:71: wind_speed is there twice, at columns 53 and 71"),
                      HasSubstr("sunshine: unit 'd', expected one of: [h] [min]")));
    EXPECT_THAT(
        message("date, temperature_max [C], temperature_min [C]\n2023-01-01,5,1\n"),
        AllOf(HasSubstr("precipitation is missing"), HasSubstr("wind_speed is missing"),
              Not(HasSubstr("humidity is missing")), Not(HasSubstr("sunshine is missing"))));
    EXPECT_THAT(message(std::string(kHeader) + "2023-01-01, 1, 70, 0, 2, 0, 3\n", {}),
                HasSubstr("the file names no latitude"));
    EXPECT_THAT(message(kHeader), HasSubstr("no days follow"));
    EXPECT_THAT(message("# latitude = 91 deg\n" + std::string(kHeader)),
                HasSubstr("w.csv:1:1: latitude: 91 deg, expected -90 to 90 deg"));
    EXPECT_THAT(
        [] {
            read("date\n", Site{91 * kDegree, 0});
        },
        ThrowsMessage<InvalidParameter>(
            HasSubstr("weather: latitude = 91 deg, longitude = 0 deg, must be -90 to 90")));
    EXPECT_THROW(read_weather("/nowhere/w.csv", {}, WeatherFill::Error), InvalidInput);
}

TEST(Weather, SunshineLongerThanTheDayIsAnError)
{
    const double n0 = possible_sunshine(kMorioka.latitude, 1);
    auto text = [&](double hours) {
        return fmt::format("{}2023-01-01, 1, 70, 0, 2, 0, {:.6f}\n", kHeader, hours);
    };
    EXPECT_THAT(message(text(n0 * 1.03)),
                HasSubstr("w.csv:2:29: sunshine: 9.52963 h on 2023-01-01, expected at most the "
                          "9.252 h between sunrise and sunset"));
    const Weather cut = read(text(n0 * 1.01));
    EXPECT_EQ(cut.days[0].sunshine, cut.days[0].possible_sunshine);
    EXPECT_THAT(cut.notes, Contains("sunshine: up to 2 % longer than the day on 1 day, cut to it"));
    // In polar night none is possible, and that is legal.
    const Weather night = read(text(0), Site{80 * kDegree, 0});
    EXPECT_EQ(night.days[0].possible_sunshine, 0);
    EXPECT_EQ(night.days[0].sunshine, 0);
}

TEST(Weather, HumidityAndSunshineAreDerivedFromTheTemperatureRange)
{
    const Weather weather = read(
        "date,temperature_max [C],temperature_min [C],precipitation [mm],wind_speed [m/s]\n"
        "2023-07-15, 26.6, 14.8, 0, 2\n"
        "2023-07-16, 14.8, 14.8, 0, 2\n"
        "2023-07-17, 60, 14.8, 0, 2\n");
    // FAO-56 example 15: T_max 26.6, T_min 14.8 C give sqrt(T_max - T_min) = 3.44 and, with k_Rs =
    // 0.16, R_s = 0.55 R_a: then n / N = (0.55 - 0.25) / 0.5.
    const double share = (0.16 * std::sqrt(26.6 - 14.8) - 0.25) / 0.5;
    EXPECT_NEAR(weather.days[0].sunshine / weather.days[0].possible_sunshine, share, 1e-12);
    EXPECT_NEAR(share, 0.6, 0.005);
    EXPECT_EQ(weather.days[1].sunshine, 0);
    EXPECT_EQ(weather.days[2].sunshine, weather.days[2].possible_sunshine);
    EXPECT_NEAR(weather.days[0].temperature, 273.15 + 20.7, 1e-9);
    // e(14.8 C) = 1.684, e(20.7 C) = 2.442 kPa by FAO-56, eq. 11.
    EXPECT_NEAR(weather.days[0].humidity, 1.684 / 2.442, 5e-4);
    EXPECT_EQ(weather.days[1].humidity, 1);
    EXPECT_EQ(weather.notes.size(), 4u);
    EXPECT_THAT(weather.notes,
                Contains("humidity: from the daily minimum temperature as dew point [FAO-56, eq. "
                         "48] on 3 days"));
    EXPECT_THAT(weather.notes,
                Contains("sunshine: from the daily temperature range by Hargreaves, k_Rs = 0.16 "
                         "[FAO-56, eq. 50 and 35] on 3 days"));
    EXPECT_THAT(message("date,temperature_max [C],temperature_min [C],precipitation "
                        "[mm],wind_speed [m/s]\n2023-07-15, 4, 14.8, 0, 2\n"),
                HasSubstr("w.csv:2:16: temperature_min: 14.8 C, expected at most temperature_max = "
                          "4 C"));
}

TEST(Weather, WindsHaveNamesOrDegrees)
{
    auto direction = [](const std::string& text) {
        return read(
                   "date,temperature [C],humidity [%],precipitation [mm],wind_speed "
                   "[m/s],sunshine [h],wind_direction\n2023-07-15,20,70,0,2,3," +
                   text + "\n")
            .days[0]
            .wind_direction;
    };
    for (int k = 0; k < 8; ++k) {
        EXPECT_EQ(direction(kPoints8[k]), k);
        EXPECT_EQ(direction(fmt::format("{}", 45 * k)), k);
        EXPECT_EQ(direction(fmt::format("{}", (45 * k + 338) % 360)), k);
        EXPECT_EQ(direction(fmt::format("{}", 45 * k + 22)), k);
    }
    EXPECT_EQ(direction("360"), 0);
    EXPECT_EQ(direction("NNE"), 0);
    EXPECT_EQ(direction("ENE"), 2);
    EXPECT_EQ(direction("ESE"), 2);
    EXPECT_EQ(direction("SSE"), 4);
    EXPECT_EQ(direction("SSW"), 4);
    EXPECT_EQ(direction("WSW"), 6);
    EXPECT_EQ(direction("WNW"), 6);
    EXPECT_EQ(direction("NNW"), 0);
    EXPECT_THROW(direction("up"), InvalidInput);
}

TEST(Weather, NormalsMakeAYearThatKeepsTheirTotals)
{
    const Weather weather =
        read_weather(SEKITEI_DATA "/weather/morioka-normals.csv", {}, WeatherFill::Error);
    ASSERT_EQ(weather.days.size(), 365u);
    const double temperature[] = {-1.6, -.9, 2.6, 8.7, 14.5, 18.8, 22.4, 23.5, 19.3, 12.6, 6.2, .8};
    const double humidity[] = {.74, .71, .67, .64, .68, .75, .80, .79, .80, .77, .75, .76};
    const double wind[] = {2.9, 3.1, 3.4, 3.4, 3.0, 2.6, 2.5, 2.4, 2.4, 2.5, 2.7, 2.8};
    const double sunshine[] = {3.7, 4.4, 5.1, 5.7, 6.2, 5.3, 4.2, 4.7, 4.1, 4.5, 4.0, 3.3};
    double rain = 0;
    int wet = 0;
    for (std::size_t i = 0; i < 365; ++i) {
        const WeatherDay& d = weather.days[i];
        const auto m = static_cast<std::size_t>(d.month - 1);
        const int n = static_cast<int>(i) + 1;
        EXPECT_EQ(day_of_year(d.year, d.month, d.day), n);
        EXPECT_NEAR(d.temperature, 273.15 + temperature[m], 1e-9);
        EXPECT_EQ(d.wind_speed, wind[m]);
        EXPECT_EQ(d.sunshine, sunshine[m]);
        EXPECT_EQ(d.wind_direction, 3 * n % 8);
        const bool rains = 165 * n / 365 > 165 * (n - 1) / 365;
        EXPECT_NEAR(d.precipitation, rains ? 1271.0 / 165 : 0, 1e-12);
        EXPECT_NEAR(d.humidity, std::min(1.0, humidity[m] * (rains ? 1.1 : 0.93)), 1e-12);
        rain += d.precipitation;
        wet += d.precipitation > 0;
    }
    EXPECT_NEAR(rain, 1271, 1e-9);
    EXPECT_EQ(wet, 165);
    ASSERT_TRUE(weather.site);
    EXPECT_NEAR(weather.site->latitude, 39.70 * kDegree, 1e-12);
}

TEST(Weather, MonthlyRainFallsInItsMonth)
{
    std::string text =
        "month,temperature [C],humidity [%],precipitation [mm],wet_days,wind_speed [m/s],sunshine "
        "[h]\n";
    for (int m = 12; m >= 1; --m) text += fmt::format("{},10,70,{},{},2,3\n", m, 10 * m, m + 3);
    const Weather weather = read(text);
    std::array<double, 12> rain{};
    std::array<int, 12> wet{};
    for (const WeatherDay& d : weather.days) {
        rain[static_cast<std::size_t>(d.month - 1)] += d.precipitation;
        wet[static_cast<std::size_t>(d.month - 1)] += d.precipitation > 0;
    }
    for (int m = 1; m <= 12; ++m) {
        EXPECT_NEAR(rain[static_cast<std::size_t>(m - 1)], 10 * m, 1e-9);
        EXPECT_EQ(wet[static_cast<std::size_t>(m - 1)], m + 3);
    }
    EXPECT_THAT(message("month,temperature [C]\n1,5\n1,5\n13,5\n"),
                AllOf(HasSubstr("w.csv:3:1: month: 1, expected each of 1 to 12 once"),
                      HasSubstr("w.csv:4:1: month: '13', expected a number from 1 to 12"),
                      HasSubstr("month 2 is missing"), HasSubstr("rain is missing")));
}

TEST(Weather, SeattleIsReadWithItsDerivedValues)
{
    const Weather weather =
        read_weather(SEKITEI_DATA "/weather/seattle-2012-2015.csv", {}, WeatherFill::Error);
    ASSERT_EQ(weather.days.size(), 1461u);
    double rain = 0, temperature = 0, humidity = 0;
    for (const WeatherDay& d : weather.days) {
        rain += d.precipitation / 4;
        temperature += d.temperature / 1461;
        humidity += d.humidity / 1461;
        EXPECT_LE(d.sunshine, d.possible_sunshine);
    }
    // Sums of the file by another program; humidity of the city is about 73 % a year.
    EXPECT_NEAR(rain, 1106.5, 1e-6);
    EXPECT_NEAR(temperature, 273.15 + 12.33692676, 1e-6);
    EXPECT_NEAR(humidity, 0.73, 0.04);
}

TEST(Weather, SelectedDaysRepeatWholeYears)
{
    Weather weather;
    for (int i = 0; i < 400; ++i) {
        const Date date = date_of(day_number(2023, 4, 1) + i);
        WeatherDay day;
        day.year = date.year;
        day.month = date.month;
        day.day = date.day;
        day.precipitation = i;
        weather.days.push_back(day);
    }
    weather.site = kMorioka;
    const Weather part = select_days(weather, 7, 3, false);
    ASSERT_EQ(part.days.size(), 3u);
    EXPECT_EQ(part.days[0].precipitation, 7);
    EXPECT_EQ(part.days[2].precipitation, 9);
    EXPECT_TRUE(part.site);
    EXPECT_EQ(select_days(weather, 0, 400, false).days.size(), 400u);
    EXPECT_THAT([&] { select_days(weather, 30, 371, false); },
                ThrowsMessage<InvalidParameter>(
                    "weather: days = 371 from day 30, the series has 400; ask for fewer, or let it "
                    "repeat with --repeat-year"));
    EXPECT_THROW(select_days(weather, 401, 0, false), InvalidParameter);
    EXPECT_THROW(select_days(weather, std::size_t(-1), 2, true), InvalidParameter);

    // From 1 April 2023 to 31 March 2024 are 366 days: after day 400 the calendar goes on.
    const Weather more = select_days(weather, 390, 366 * 2, true);
    ASSERT_EQ(more.days.size(), 732u);
    EXPECT_EQ(more.days[9].precipitation, 399);
    for (std::size_t i = 10; i < more.days.size(); ++i)
        EXPECT_EQ(more.days[i].precipitation, static_cast<double>((390 + i) % 366));
    EXPECT_EQ(more.days[9].month * 100 + more.days[9].day, 504);
    EXPECT_EQ(more.days[10].month * 100 + more.days[10].day, 505);

    weather.days.resize(365);
    EXPECT_THAT([&] { select_days(weather, 0, 366, true); },
                ThrowsMessage<InvalidParameter>(HasSubstr("less than the whole year")));
}

}  // namespace
}  // namespace sekitei
