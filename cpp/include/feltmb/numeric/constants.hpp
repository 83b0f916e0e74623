/// Numbers with a name.
#pragma once

#include <limits>
#include <numbers>

namespace feltmb {

inline constexpr double kPi = std::numbers::pi;
inline constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

}  // namespace feltmb
