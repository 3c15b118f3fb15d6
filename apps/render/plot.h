#pragma once

#include <optional>
#include <string>
#include <vector>

#include "core/image.h"

namespace sekitei::render {

/// Points joined by a line; a value that is not finite breaks it.
struct Series {
    std::string name;          ///< in the legend; none where empty
    std::vector<double> x, y;  ///< equally many
};

struct PlotParams {
    std::string title, x_name, y_name;  ///< with units: "cover [m²]"
    int width = 900, height = 480;      ///< of the picture
    std::optional<double> low, high;    ///< ends of the y axis; auto: from the values
    bool from_zero = false;             ///< the y axis takes in zero
};

/// Lines over two axes with ticks, units and a legend in eight colours that colour-blind people
/// tell apart [Okabe2008]; from the ninth series on, colours come again.
/// @throws InvalidParameter  a size below 200 x 120 or above 16384, low >= high, unequal lengths
/// @throws InvalidInput  no point to show
Image8 plot(const std::vector<Series>& series, const PlotParams& params);

}  // namespace sekitei::render
