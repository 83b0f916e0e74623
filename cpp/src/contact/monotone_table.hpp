/// Monotone cubic tables: slopes, look-up, repair. Private to the contact laws.
#pragma once

#include <cstddef>
#include <vector>

#include "feltmb/contact/curve.hpp"

namespace feltmb::tables {

inline constexpr std::size_t kKnots = 256;  ///< intervals of a table over s in [0, 1]

/// s = i / n, i = 0 ... n.
std::vector<double> knot_positions(std::size_t n = kKnots);

/// Fritsch-Butland slopes of a monotone cubic through (t, v): for data of any origin.
std::vector<double> monotone_slopes(const std::vector<double>& t, const std::vector<double>& v);

/// Slopes of fourth order over equally spaced s in [0, 1], held so that the cubic is monotone where
/// the values are (Hyman): for samples of a smooth function.
std::vector<double> smooth_slopes(const std::vector<double>& v);

/// Cubic on one interval of width h at u in [0, 1] of it, with its slope.
inline CurveValue hermite(double v0, double v1, double m0, double m1, double h, double u) {
  const double d = (v1 - v0) / h;
  const double c2 = 3.0 * d - 2.0 * m0 - m1;
  const double c3 = m0 + m1 - 2.0 * d;
  return {v0 + u * h * (m0 + u * (c2 + u * c3)), m0 + u * (2.0 * c2 + 3.0 * u * c3)};
}

/// Value and slope by s of a table of kKnots intervals over s in [0, 1].
inline CurveValue look_up(const double* value, const double* slope, double s) {
  const double position = s * static_cast<double>(kKnots);
  auto i = static_cast<std::size_t>(position);
  if (i >= kKnots) i = kKnots - 1;
  const double u = position - static_cast<double>(i);
  return hermite(value[i], value[i + 1], slope[i], slope[i + 1], 1.0 / static_cast<double>(kKnots),
                 u);
}

/// Nearest values that never fall, in the sense of weighted least squares: neighbors that fall are
/// pooled into their weighted mean, so that the weighted sum stays what it was.
std::vector<double> never_falling(const std::vector<double>& value,
                                  const std::vector<double>& weight);

/// Monotone cubic through a user's table.
struct Spline {
  std::vector<double> t, v, m;
  Spline(const std::vector<double>& at, const std::vector<double>& value);
  double operator()(double x) const;
};

}  // namespace feltmb::tables
