/// The fitted compression curve of thesis eq. 4.21.
#pragma once

namespace feltmb {

/// Cubic over one piece of width h of a table: value + u h (slope + u (second + u third)) at
/// 0 <= u <= 1 of it.
struct CubicPiece {
  double value, slope, second, third;
};

/// F(e) = a e exp(b e) + c e, thesis eq. 4.21; F = 0 for e <= 0. Beyond b e = 40, the exponential
/// is continued along its tangent, because trial steps of a solver may reach depths at which exp(b
/// e) overflows.
struct ExponentialCurve {
  double a = 0.0;  ///< [N/m]
  double b = 0.0;  ///< [1/m], >= 0
  double c = 0.0;  ///< [N/m], may be negative

  bool operator==(const ExponentialCurve&) const = default;
};

struct CurveValue {
  double force;  ///< [N]
  double slope;  ///< dF/de [N/m]
};

/// Force and slope at compression e [m].
CurveValue evaluate(const ExponentialCurve& curve, double e);

/// Integral of F from 0 to e [J]; exact also beyond b e = 40.
double integral(const ExponentialCurve& curve, double e);

}  // namespace feltmb
