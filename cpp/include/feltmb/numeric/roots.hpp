/// Root of a scalar function in a bracket.
#pragma once

#include <cmath>
#include <utility>

namespace feltmb {

/// Root of f in [low, high] by Newton steps that fall back to bisection.
///
/// @param f         returns {value, derivative}; value(low) and value(high) must differ in sign
///                  (zero counts as either); otherwise the end with the smaller |value| is returned
/// @param low,high  bracket, low < high, same unit as the root
/// @param tolerance relative to max(|low|, |high|); the bracket or the last step is below it
template <class Function>
double find_root(Function&& f, double low, double high, double tolerance = 1e-15,
                 int max_iterations = 200) {
  const double scale = std::fmax(std::abs(low), std::abs(high));
  const double value_low = f(low).first;
  const double value_high = f(high).first;
  if (value_low == 0.0) return low;
  if (value_high == 0.0) return high;
  if ((value_low > 0.0) == (value_high > 0.0)) {
    return std::abs(value_low) < std::abs(value_high) ? low : high;
  }
  const bool rising = value_high > 0.0;
  double x = 0.5 * (low + high);
  for (int i = 0; i < max_iterations; ++i) {
    const auto [value, slope] = f(x);
    if (value == 0.0) return x;
    if ((value > 0.0) == rising) {
      high = x;
    } else {
      low = x;
    }
    double next = x - value / slope;
    // Written so that a NaN from a zero slope also bisects.
    if (!(next > low && next < high)) next = 0.5 * (low + high);
    if (std::abs(next - x) <= tolerance * scale || high - low <= tolerance * scale) return next;
    x = next;
  }
  return x;
}

}  // namespace feltmb
