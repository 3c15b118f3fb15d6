#include <fmt/format.h>
#include <iconv.h>

#include "apps/forest_edits.h"
#include "apps/points_csv.h"
#include "core/image.h"
#include "core/weather.h"
#include "tests/fuzz/readers.h"

namespace sekitei::fuzz {
namespace {

void read_png(std::string_view bytes)
{
    accepts("a.png", [&] {
        const Image16 grey = decode_png_grey16(bytes, "a.png");
        const Image8 colour = decode_png_rgb8(bytes, "a.png");
        if (grey.width != colour.width || grey.height != colour.height)
            broken("one picture of two sizes");
        // Writing costs much and depends on the pixels alone: small ones show as much.
        if (grey.pixels.size() < 4096 &&
            decode_png_grey16(encode_png(grey), "again.png").pixels != grey.pixels)
            broken("a picture does not come back as it was written");
    });
}

template <class T>
std::string picture(int width, int height, int channels)
{
    Image<T> image(width, height, channels);
    for (std::size_t i = 0; i < image.pixels.size(); ++i)
        image.pixels[i] = static_cast<T>(i * 2654435761u >> 7);
    return encode_png(image);
}

std::vector<std::string> png_seeds()
{
    return {picture<std::uint8_t>(5, 3, 1),  picture<std::uint8_t>(4, 4, 3),
            picture<std::uint8_t>(3, 5, 4),  picture<std::uint16_t>(6, 2, 1),
            picture<std::uint16_t>(2, 3, 3), data_file("forest/path.png")};
}

/// Days that solvers may use.
void read_weather_as(std::string_view bytes, const char* name)
{
    for (const WeatherFill fill : {WeatherFill::Error, WeatherFill::Interpolate})
        accepts(name, [&] {
            const Weather weather = decode_weather(bytes, name, Site{0.7, 2.4}, fill);
            if (weather.days.empty()) broken("weather without days");
            for (const WeatherDay& d : weather.days) {
                const bool good = d.temperature >= 180 && d.temperature <= 340 && d.humidity >= 0 &&
                                  d.humidity <= 1 && d.precipitation >= 0 && d.wind_speed >= 0 &&
                                  d.wind_direction >= 0 && d.wind_direction < 8 &&
                                  d.sunshine >= 0 && d.sunshine <= d.possible_sunshine &&
                                  d.pressure >= 300;
                if (!good) broken(fmt::format("impossible weather on {}-{}", d.month, d.day));
            }
        });
}

std::vector<std::string> own_weather_seeds()
{
    std::string text =
        "# A week\n# latitude = 39.70 deg\n# longitude = 141.15 deg\ndate, "
        "temperature [C], humidity [%], precipitation [mm], wind_speed [km/h], "
        "wind_direction [deg], sunshine [h], global [MJ/m^2], pressure [kPa], "
        "remark\n";
    std::string bare =
        "\xEF\xBB\xBF"
        "date;temperature [K];tmin [C];precipitation [mm];wind_speed [m/s]\r\n";
    for (int d = 1; d <= 7; ++d) {
        text += fmt::format("2021-05-{:02},{},{},{},{},{},{},{},{},\"dry, mostly\"\n", d, 14 + d,
                            80 + d, d % 3, 3 + d, 45 * d, d, 10 + d, 101.3);
        if (d != 4) bare += fmt::format("2020/2/{};{};{};0;1\r\n", 25 + d, 280 + d, d);
    }
    const std::string seattle = data_file("weather/seattle-2012-2015.csv");
    return {text, bare, data_file("weather/morioka-normals.csv"),
            seattle.substr(0, seattle.find('\n', 2000) + 1)};
}

std::vector<std::string> epw_seeds()
{
    std::string text =
        "LOCATION,Morioka,-,JPN,TEST,475840,39.70,141.15,9.0,155.0\nDESIGN "
        "CONDITIONS,0\nTYPICAL/EXTREME PERIODS,0\nGROUND TEMPERATURES,0\n"
        "HOLIDAYS/DAYLIGHT SAVINGS,No,0,0,0\nCOMMENTS 1,made for a test\nCOMMENTS "
        "2,\nDATA PERIODS,1,1,Data,Sunday,1/ 1,12/31\n";
    for (int day = 27; day <= 28; ++day)
        for (int hour = 1; hour <= 24; ++hour)
            text += fmt::format(
                "2023,2,{},{},0,?9?9,{},1.0,{},101300,0,0,{},{},{},{},0,0,0,0,{},{},"
                "5,5,9999,99999,9,999999999,99,0.1,0,88,0.2,0.1,1\n",
                day, hour, 0.3 * hour, 60 + hour, 300 + hour, hour > 6 && hour <= 18 ? 200 : 0,
                hour > 9 && hour < 14 ? 121 : 119, hour > 6 && hour <= 18 ? 100 : 0, hour * 15,
                0.5 * hour);
    return {text};
}

std::vector<std::string> jma_seeds()
{
    std::string text = "ダウンロードした時刻：2024/05/12 10:10:10\r\n\r\n";
    const std::pair<const char*, int> items[] = {{"平均気温(℃)", 3},      {"降水量の合計(mm)", 4},
                                                 {"日照時間(時間)", 4},   {"平均風速(m/s)", 3},
                                                 {"最多風向(16方位)", 3}, {"平均湿度(％)", 3}};
    std::string stations, names, kinds;
    for (const auto& [name, columns] : items)
        for (int c = 0; c < columns; ++c) {
            stations += ",盛岡";
            names += fmt::format(",{}", name);
            kinds += c == 0             ? ","
                     : columns - c == 1 ? ",均質番号"
                     : columns - c == 2 ? ",品質情報"
                                        : ",現象なし情報";
        }
    text +=
        stations + "\r\n年月日" + names + "\r\n" + std::string(20, ',') + "\r\n" + kinds + "\r\n";
    for (int d = 1; d <= 5; ++d)
        text += fmt::format("2023/5/{},{},8,1,{},{},8,1,{},0,8,1,{},8,1,北東,8,1,{},8,1\r\n", d,
                            10 + d, d % 2, d % 2 ? 0 : 1, d, 1 + d, 70 + d);
    std::string shift_jis(text.size(), '\0');
    const iconv_t converter = iconv_open("CP932", "UTF-8");
    char *from = text.data(), *to = shift_jis.data();
    std::size_t left = text.size(), room = shift_jis.size();
    if (converter == iconv_t(-1) || iconv(converter, &from, &left, &to, &room) == std::size_t(-1))
        broken("no Shift_JIS here");
    iconv_close(converter);
    shift_jis.resize(shift_jis.size() - room);
    return {text, shift_jis};
}

void read_trees(std::string_view bytes)
{
    accepts("t.csv", [&] {
        apps::ForestWords words;
        words.frame.width = words.frame.depth = 64;
        words.species = forest::table_species();
        for (const forest::NewTree& tree :
             apps::parse_tree_list(std::string(bytes), "t.csv", words).trees)
            if (tree.species < 0 || std::size_t(tree.species) >= words.species.size() ||
                !(tree.height > 0))
                broken("a tree of no kind or height");
    });
}

void read_seed_points(std::string_view bytes)
{
    accepts("s.csv", [&] {
        if (apps::read_points_csv(put("s.csv", bytes)).empty()) broken("no points");
    });
}

}  // namespace

std::vector<Reader> table_readers()
{
    return {
        {"png", read_png, png_seeds},
        {"weather_csv", [](std::string_view b) { read_weather_as(b, "w.csv"); }, own_weather_seeds},
        {"epw", [](std::string_view b) { read_weather_as(b, "w.epw"); }, epw_seeds},
        {"jma", [](std::string_view b) { read_weather_as(b, "j.csv"); }, jma_seeds},
        {"tree_list", read_trees,
         [] {
             return std::vector<std::string>{
                 "# trees\nspecies,x,y,height,uid\ntall,10,20.5,3,0x1139fd5694aac492\n2,1,2,"
                 "90,17\n",
                 "height; y; x; species\r\n1.5; 2; 3; 1\r\n"};
         }},
        {"seed_points", read_seed_points,
         [] { return std::vector<std::string>{"# x,y,z\n0.1,0.2,0.3\r\n1 2 3\n\n-1e-3,4,5\n"}; }}};
}

}  // namespace sekitei::fuzz
