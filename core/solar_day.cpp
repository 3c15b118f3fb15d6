#include "core/solar_day.h"

#include <chrono>

#include "core/math.h"

namespace sekitei {
namespace {

std::chrono::year_month_day calendar(int year, int month, int day)
{
    return {std::chrono::year(year), std::chrono::month(static_cast<unsigned>(month)),
            std::chrono::day(static_cast<unsigned>(day))};
}

double declination(int day_of_year)  // [Allen1998, eq. 24]
{
    return 0.409 * math::sin(2 * math::kPi / 365 * day_of_year - 1.39);
}

}  // namespace

bool date_exists(int year, int month, int day)
{
    return year > -32767 && year < 32767 && month >= 1 && month <= 12 && day >= 1 && day <= 31 &&
           calendar(year, month, day).ok();
}

long day_number(int year, int month, int day)
{
    return std::chrono::sys_days(calendar(year, month, day)).time_since_epoch().count();
}

Date date_of(long number)
{
    const std::chrono::year_month_day date{
        std::chrono::sys_days(std::chrono::days(static_cast<int>(number)))};
    return {static_cast<int>(date.year()), static_cast<int>(static_cast<unsigned>(date.month())),
            static_cast<int>(static_cast<unsigned>(date.day()))};
}

int day_of_year(int year, int month, int day)
{
    return static_cast<int>(day_number(year, month, day) - day_number(year, 1, 1)) + 1;
}

double sunset_angle(double latitude, int day_of_year)
{
    const double d = declination(day_of_year);
    // cos(latitude) vanishes only at the poles, where the clamp of acos tells day from night.
    const double cosine = math::cos(latitude) * math::cos(d);
    const double sine = math::sin(latitude) * math::sin(d);
    if (-sine >= cosine) return 0;
    if (sine >= cosine) return math::kPi;
    return math::acos(-sine / cosine);
}

double possible_sunshine(double latitude, int day_of_year)
{
    return 24 / math::kPi * sunset_angle(latitude, day_of_year);
}

double extraterrestrial_radiation(double latitude, int day_of_year)
{
    constexpr double kSolarConstant = 0.0820e6 / 60;  // Gsc = 0.0820 MJ m^-2 min^-1 [W/m^2]
    const double d = declination(day_of_year), ws = sunset_angle(latitude, day_of_year);
    const double distance = 1 + 0.033 * math::cos(2 * math::kPi / 365 * day_of_year);
    const double share = (ws * math::sin(latitude) * math::sin(d) +
                          math::cos(latitude) * math::cos(d) * math::sin(ws)) /
                         math::kPi;
    return share > 0 ? kSolarConstant * distance * share : 0;
}

}  // namespace sekitei
