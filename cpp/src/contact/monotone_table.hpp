/// Monotone cubic tables: slopes, look-up, repair. Private to the contact laws.
#pragma once

#include <cstddef>
#include <vector>

#include "feltmb/contact/curve.hpp"

namespace feltmb::tables {

inline constexpr std::size_t kKnots = 256;  ///< intervals of a table over s in [0, 1]
inline constexpr double kWidth = 1.0 / static_cast<double>(kKnots);  ///< of one

/// s = i / n, i = 0 ... n.
std::vector<double> knot_positions(std::size_t n = kKnots);

/// Fritsch-Butland slopes of a monotone cubic through (t, v): for data of any origin.
std::vector<double> monotone_slopes(const std::vector<double>& t, const std::vector<double>& v);

/// Slopes of fourth order over equally spaced s in [0, 1], held so that the cubic is monotone where
/// the values are (Hyman): for samples of a smooth function.
std::vector<double> smooth_slopes(const std::vector<double>& v);

/// Cubic through two values with their slopes, a piece of width h apart.
inline CubicPiece piece_between(double v0, double v1, double m0, double m1, double h) {
  const double d = (v1 - v0) / h;
  return {v0, m0, 3.0 * d - 2.0 * m0 - m1, m0 + m1 - 2.0 * d};
}

/// Value and slope at u in [0, 1] of a piece of width h.
inline CurveValue evaluate(const CubicPiece& p, double h, double u) {
  return {p.value + u * h * (p.slope + u * (p.second + u * p.third)),
          p.slope + u * (2.0 * p.second + 3.0 * u * p.third)};
}

inline CurveValue hermite(double v0, double v1, double m0, double m1, double h, double u) {
  return evaluate(piece_between(v0, v1, m0, m1, h), h, u);
}

/// The kKnots pieces of a table.
std::vector<CubicPiece> pieces_of(const std::vector<double>& value,
                                  const std::vector<double>& slope);

/// Value and slope by s of a table of kKnots intervals over s in [0, 1].
inline CurveValue look_up(const double* value, const double* slope, double s) {
  const double position = s * static_cast<double>(kKnots);
  auto i = static_cast<std::size_t>(position);
  if (i >= kKnots) i = kKnots - 1;
  const double u = position - static_cast<double>(i);
  return hermite(value[i], value[i + 1], slope[i], slope[i + 1], kWidth, u);
}
inline CurveValue look_up(const CubicPiece* pieces, double s) {
  const double position = s * static_cast<double>(kKnots);
  auto i = static_cast<std::size_t>(position);
  if (i >= kKnots) i = kKnots - 1;
  return evaluate(pieces[i], kWidth, position - static_cast<double>(i));
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
