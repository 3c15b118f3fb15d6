#pragma once

#include <array>
#include <cstddef>
#include <string_view>
#include <vector>

#include "core/params.h"
#include "core/weather.h"

/// What a garden does to the weather before it reaches an object [Ogasawara2003, section 4]: plain
/// formulas over the tables that the wind solvers fill.
namespace sekitei::wind {

/// How the exchange over water depends on the wind.
enum class ExchangeLaw {
    Laminar,   ///< [Ogasawara2003, eq. 4b] at all speeds
    Piecewise  ///< [Ogasawara2003, eq. 4a to 4d] by Reynolds number
};
constexpr std::array<std::string_view, 2> choice_names(ExchangeLaw)
{
    return {"laminar", "piecewise"};
}

struct Exchange {
    ExchangeLaw law = ExchangeLaw::Laminar;
    bool bounded = true;  ///< air takes on 1 - exp(-A C) of the water's state, else A C

    static void describe(auto&& field)
    {
        field("exchange_law", &Exchange::law,
              "how the exchange of heat and vapour over water depends on the wind");
        field("exchange_bounded", &Exchange::bounded,
              "air never gets beyond the water's own temperature and humidity");
    }
};

/// C(U) of heat and vapour over water. The length in its Reynolds number is fixed, 0.03 m: the
/// paper's, U times the time step, would make C depend on the step. The viscosity of air is
/// 1.51e-5 m^2/s, the diffusivity of vapour 2.54e-5 m^2/s.
/// @param speed  U [m/s]; below 0.05 counts as 0.05
double exchange_coefficient(double speed, ExchangeLaw law);

/// k_i / C(U0), the exchange of a parcel that moves at `speed` within a layer `depth` over water
/// for `dt`: (U0 dt / d) (U / U0)^(1/2). Its sum along a path is A, whatever the temperatures are.
/// @param speed   U of the parcel [m/s], >= 0
/// @param stream  U0 [m/s], > 0
double water_touch(double speed, double dt, double stream, double depth);

/// What the air before the object is to the air of the weather, by where the wind blows from:
/// index 0..7 = N NE E SE S SW W NW. A function of the geometry alone.
struct AirTables {
    using Table = std::array<double, 8>;
    Table speed{1, 1, 1, 1, 1, 1, 1, 1};  ///< A_U, speed / U0
    Table temperature{};                  ///< A_T, water touched, >= 0
    Table humidity{};                     ///< A_q, equal to A_T
    /// From where the air really comes at the object [rad], clockwise from north, 0 to 2 pi.
    Table direction = straight();

    /// A_T by height; empty where not asked for. Layer i spans base + [i, i + 1) layer_height.
    std::vector<Table> layers;
    double layer_base = 0, layer_height = 0.5;  ///< [m]

    static Table straight();
    /// The layer at height z; what lies beyond the ends belongs to them. `layers` is not empty.
    std::size_t layer_at(double z) const;
};

/// The index 0..7 nearest to a direction [rad].
int nearest_direction(double azimuth);

struct Air {
    double temperature = 0;  ///< T_d' [K]
    double humidity = 0;     ///< rh_d', 0..1
    double speed = 0;        ///< U_d' [m/s]
};

/// Air before the object on a day: f = 1 - exp(-A C(U0')) of the way from the weather's to the
/// water's temperature and specific humidity; U_d' = A_U U0' [Ogasawara2003, eq. 19 to 21].
/// @param water  temperature of the water [K]
/// @throws InvalidInput  a field of the day or the water's temperature out of range, with its value
Air air_before(const WeatherDay& day, double water, const AirTables& tables,
               const Exchange& exchange);

/// The same for each of tables.layers; empty where there are none.
std::vector<Air> air_by_layer(const WeatherDay& day, double water, const AirTables& tables,
                              const Exchange& exchange);

/// Temperature of a pond [K]: 10 C at the end of January, 20 C at the end of July.
/// @param day  of the year, 1 to 366
double water_temperature(int day);

}  // namespace sekitei::wind
