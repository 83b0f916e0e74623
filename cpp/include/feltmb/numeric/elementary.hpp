/// Exponential and hyperbolic tangent for the inner loops: inline, without a table, and of the same
/// bits on every machine (a math library picks fused multiply-adds where the processor has them).
#pragma once

#include <cmath>
#include <cstdint>

namespace feltmb {

/// exp(x) = scale (1 + rest).
struct ExponentialParts {
  double scale;  ///< a power of two
  double rest;   ///< in [-0.3, 0.42], to its last digits
};

/// For |x| <= 700. x = k ln 2 + r with |r| <= ln(2)/2, Taylor's series of exp(r) - 1 to r^13.
inline ExponentialParts exponential_parts(double x) {
  constexpr double per_ln2 = 1.44269504088896340736;
  constexpr double ln2_high = 6.93147180369123816490e-01;  // its last 21 bits are zero
  constexpr double ln2_low = 1.90821492927058770002e-10;
  constexpr double shift = 6755399441055744.0;  // 1.5 * 2^52: rounds to the nearest integer
  const double shifted = x * per_ln2 + shift;
  const double k = shifted - shift;
  const double r = (x - k * ln2_high) - k * ln2_low;
  const double r2 = r * r;
  const double r4 = r2 * r2;
  // Pairs and pairs of pairs: short chains.
  const double a = 0.5 + r * (1.0 / 6.0);
  const double b = 1.0 / 24.0 + r * (1.0 / 120.0);
  const double c = 1.0 / 720.0 + r * (1.0 / 5040.0);
  const double d = 1.0 / 40320.0 + r * (1.0 / 362880.0);
  const double e = 1.0 / 3628800.0 + r * (1.0 / 39916800.0);
  const double f = 1.0 / 479001600.0 + r * (1.0 / 6227020800.0);
  const double series = (a + r2 * b) + r4 * ((c + r2 * d) + r4 * (e + r2 * f));
  // What std::bit_cast is; the library of Clang 13 has none.
  const auto bits =
      __builtin_bit_cast(std::int64_t, shifted) - __builtin_bit_cast(std::int64_t, shift);
  return {__builtin_bit_cast(double, (bits + 1023) << 52), r + r2 * series};
}

/// exp(x) for |x| <= 700, to 1 unit in the last place.
inline double fast_exp(double x) {
  const ExponentialParts p = exponential_parts(x);
  return p.scale + p.scale * p.rest;
}

/// tanh(x), to a few units in the last place, and 1 - tanh(x)^2.
struct HyperbolicTangent {
  double value;
  double slope;
};
inline HyperbolicTangent fast_tanh(double x) {
  const double size = std::fabs(x);
  // From here on it is 1 to all digits; the slope is below 1e-16 and has died out.
  if (!(size < 20.0)) return {size >= 20.0 ? std::copysign(1.0, x) : x, 0.0};
  const ExponentialParts p = exponential_parts(2.0 * size);
  const double grown = (p.scale - 1.0) + p.scale * p.rest;  // exp(2 |x|) - 1
  const double inverse = 1.0 / (grown + 2.0);
  const double value = grown * inverse;
  return {std::copysign(value, x), 4.0 * (1.0 + grown) * inverse * inverse};
}

}  // namespace feltmb
