/// Whole numbers from real ones that may lie beyond every integer.
#pragma once

#include <cmath>
#include <concepts>

namespace feltmb {

/// Whole number at or below x, held within [first, last]; `first` for a NaN.
///
/// A cast of what the integer cannot hold is undefined: the bounds come before it.
template <std::integral Integer>
Integer floor_within(double x, Integer first, Integer last) {
  if (!(x >= static_cast<double>(first))) return first;
  return x < static_cast<double>(last) ? static_cast<Integer>(std::floor(x)) : last;
}

}  // namespace feltmb
