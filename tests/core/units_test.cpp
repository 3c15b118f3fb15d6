#include "core/units.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <numbers>

#include "core/error.h"

namespace sekitei {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

TEST(Units, AreConvertedToTheUnitAsked)
{
    EXPECT_DOUBLE_EQ(parse_quantity("2cm", "m"), 0.02);
    EXPECT_DOUBLE_EQ(parse_quantity("2.5 km", "m"), 2500);
    EXPECT_DOUBLE_EQ(parse_quantity("20C", "K"), 293.15);
    EXPECT_DOUBLE_EQ(parse_quantity("-40C", "K"), 233.15);
    EXPECT_DOUBLE_EQ(parse_quantity("30d", "s"), 2592000);
    EXPECT_DOUBLE_EQ(parse_quantity("45deg", "rad"), std::numbers::pi / 4);
    EXPECT_DOUBLE_EQ(parse_quantity("1rad", "deg"), 180 / std::numbers::pi);
    EXPECT_DOUBLE_EQ(parse_quantity("50%", ""), 0.5);
    EXPECT_DOUBLE_EQ(parse_quantity("36km/h", "m/s"), 10);
    EXPECT_DOUBLE_EQ(parse_quantity("0.5mm^2/s", "m^2/s"), 5e-7);
    EXPECT_DOUBLE_EQ(parse_quantity(" +1e-3 ", "m"), 1e-3);
    EXPECT_DOUBLE_EQ(parse_quantity("7 W/(m K)", "W/(m K)"), 7);  // a unit the table lacks
}

TEST(Units, ForeignUnitsAreNamedWithThoseThatFit)
{
    EXPECT_THAT([] { parse_quantity("2s", "m"); },
                ThrowsMessage<InvalidParameter>(
                    "'2s' has the unit 's', expected one of: um mm cm m km in ft"));
    EXPECT_THAT(
        [] { parse_quantity("2cm", ""); },
        ThrowsMessage<InvalidParameter>("'2cm' has the unit 'cm', expected a plain number or %"));
    EXPECT_THAT([] { parse_quantity("2cm", "W/(m K)"); },
                ThrowsMessage<InvalidParameter>(HasSubstr("expected one of: W/(m K)")));
    EXPECT_THAT([] { parse_quantity("2,5", "m"); },
                ThrowsMessage<InvalidParameter>(HasSubstr("unit ',5'")));
}

TEST(Units, WhatIsNoNumberIsRefused)
{
    for (const char* text : {"", "m", "zwei", "nan", "inf", "-inf", "1e999", "+-5", "--5", "."})
        EXPECT_THAT([&] { parse_quantity(text, "m"); },
                    ThrowsMessage<InvalidParameter>(HasSubstr("is not a number")))
            << text;
    EXPECT_THAT([] { parse_quantity("1e308km", "m"); },
                ThrowsMessage<InvalidParameter>(HasSubstr("too large")));
}

TEST(Units, TextReadsBackAsTheSameNumber)
{
    for (const double value :
         {0.1, 1.0 / 3, 5e-7, 6.02e23, -273.15, std::numeric_limits<double>::min()})
        for (const char* unit : {"m", "", "m^2/s"})
            EXPECT_EQ(parse_quantity(quantity_text(value, unit), unit), value);
    EXPECT_EQ(quantity_text(0.02, "m"), "0.02 m");
}

TEST(Units, BytesTakeDecimalAndBinaryMultiples)
{
    EXPECT_EQ(parse_bytes("8G"), 8e9);
    EXPECT_EQ(parse_bytes("500 MB"), 5e8);
    EXPECT_EQ(parse_bytes("2GiB"), 2147483648.0);
    EXPECT_EQ(parse_bytes("64K"), 64000);
    EXPECT_EQ(parse_bytes("123"), 123);
    for (const char* text : {"8X", "-8G", "0", "1e300TB"})
        EXPECT_THAT([&] { parse_bytes(text); },
                    ThrowsMessage<InvalidParameter>(HasSubstr("is not a size")))
            << text;
}

TEST(Units, CountsTakeThousandsAndMillions)
{
    const std::pair<const char*, double> good[] = {
        {"20k", 20e3},  {"20K", 20e3}, {"2M", 2e6},    {"1.5M", 1.5e6}, {"2.3M", 2.3e6},
        {"1.1k", 1100}, {"1G", 1e9},   {"8192", 8192}, {"-2k", -2000},  {" 3 k ", 3000},
        {"50%", 0.5},   {"0.5k", 500}, {"1e3k", 1e6}};
    for (const auto& [text, count] : good) EXPECT_EQ(parse_count(text), count) << text;
    for (const char* text : {"", "k", "2kM", "2 kk", "2m", "2cm", "2kB", "1e300G", "nan k"})
        EXPECT_THROW(parse_count(text), InvalidParameter) << text;
}

TEST(ErrorText, BytesAndCountsRoundToTheRightWord)
{
    EXPECT_EQ(bytes_text(0), "0 B");
    EXPECT_EQ(bytes_text(999), "999 B");
    EXPECT_EQ(bytes_text(999.6), "1 kB");
    EXPECT_EQ(bytes_text(5.3e6), "5.3 MB");
    EXPECT_EQ(bytes_text(999.7e6), "1 GB");
    EXPECT_EQ(count_text(9999), "9999");
    EXPECT_EQ(count_text(10000), "10 thousand");
    EXPECT_EQ(count_text(999999), "1 million");
    EXPECT_EQ(count_text(1.2e6), "1.2 million");
    EXPECT_EQ(count_text(999.9e6), "1 billion");
    EXPECT_EQ(count_text(4.2e12), "4.2 trillion");
    EXPECT_EQ(count_text(1e30), "1.0e+30");
}

TEST(ErrorText, EveryKindHasItsExitCode)
{
    EXPECT_EQ(InvalidInput("x").code(), ExitCode::BadInput);
    EXPECT_EQ(InvalidParameter("x").code(), ExitCode::Usage);
    EXPECT_EQ(IoError("x").code(), ExitCode::CannotWrite);
    EXPECT_EQ(LimitExceeded("x").code(), ExitCode::Limit);
    EXPECT_EQ(Cancelled().code(), ExitCode::Interrupted);
    EXPECT_STREQ(IoError("cannot write x").what(), "cannot write x");
}

}  // namespace
}  // namespace sekitei
