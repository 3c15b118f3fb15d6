#pragma once

/// A day's place in the year, its length and the sunlight above the atmosphere: closed formulas of
/// [Allen1998] that need the date and the latitude only. Angles in radians.
namespace sekitei {

/// Whether the date exists in the Gregorian calendar.
bool date_exists(int year, int month, int day);
/// 1 on the first of January.
int day_of_year(int year, int month, int day);
/// Days since 1970-01-01; consecutive dates differ by 1.
long day_number(int year, int month, int day);
struct Date {
    int year = 1970, month = 1, day = 1;
    friend constexpr bool operator==(const Date&, const Date&) = default;
};
/// The inverse of day_number().
Date date_of(long day_number);

/// Hour angle of sunset: 0 in polar night, pi in polar day [Allen1998, eq. 25].
double sunset_angle(double latitude, int day_of_year);
/// N0 [h], from sunrise to sunset [Allen1998, eq. 34].
double possible_sunshine(double latitude, int day_of_year);
/// Ra, on the horizontal above the atmosphere, 24-hour mean [W/m^2] [Allen1998, eq. 21].
double extraterrestrial_radiation(double latitude, int day_of_year);

}  // namespace sekitei
