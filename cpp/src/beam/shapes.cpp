#include "feltmb/beam/shapes.hpp"

#include <cmath>

#include "feltmb/core/error.hpp"
#include "feltmb/numeric/bracketing.hpp"
#include "feltmb/numeric/constants.hpp"

namespace feltmb {
namespace {

/// k-th positive root of cos(b) = sign / cosh(b); sign -1: clamped-free, +1: clamped-clamped.
double frequency_root(int k, double sign) {
  const double center = sign < 0.0 ? (k - 0.5) * kPi : (k + 0.5) * kPi;
  const auto f = [&](double b) { return std::cos(b) - sign / std::cosh(b); };
  const double low = center - 0.4;
  const double high = center + 0.4;
  return find_root_bracketed(f, low, f(low), high, f(high), 1e-15 * center);
}

struct Curve {
  double value, slope, curvature;
};

/// cosh - cos - r (sinh - sin) at b s, with derivatives by s / L. 1 - r is formed without
/// cancellation, since cosh and sinh agree to all digits for the higher modes.
Curve vibration_mode(double b, double s, double length, double sign) {
  const double denominator = std::sinh(b) - sign * std::sin(b);
  const double ratio = (std::cosh(b) - sign * std::cos(b)) / denominator;
  const double rest =
      (-std::exp(-b) - sign * std::sin(b) + sign * std::cos(b)) / denominator;  // 1 - ratio
  const double x = b * s;
  const double grow = 0.5 * rest * std::exp(x);
  const double decay = 0.5 * (1.0 + ratio) * std::exp(-x);
  const double c = std::cos(x);
  const double n = std::sin(x);
  const double k = b / length;
  return {grow + decay - c + ratio * n, k * (grow - decay + n + ratio * c),
          k * k * (grow + decay + c - ratio * n)};
}

}  // namespace

BeamShapes::BeamShapes(ShapeSet set, double length, int axial, int lateral)
    : set_(set), length_(length), axial_(axial), lateral_(lateral) {
  if (!(std::isfinite(length) && length > 0.0)) {
    throw InvalidParameter(format("beam: length = %.6g m, must be > 0", length));
  }
  if (axial < 0 || axial > 12) {
    throw InvalidParameter(format("beam: axial_shapes = %d, must be 0 to 12", axial));
  }
  if (lateral < 1 || lateral > 12) {
    throw InvalidParameter(format("beam: lateral_shapes = %d, must be 1 to 12", lateral));
  }
  if (set == ShapeSet::kCraigBampton && lateral < 2) {
    throw InvalidParameter("beam: lateral_shapes = 1, must be >= 2 for the Craig-Bampton set");
  }
  if (set == ShapeSet::kClampedFree) {
    for (int k = 1; k <= lateral; ++k) roots_.push_back(frequency_root(k, -1.0));
  } else if (set == ShapeSet::kCraigBampton) {
    for (int k = 1; k <= lateral - 2; ++k) roots_.push_back(frequency_root(k, 1.0));
  }
}

ShapeValues BeamShapes::at(double x) const {
  ShapeValues out;
  const double s = x / length_;
  const double inverse = 1.0 / length_;
  for (int k = 1; k <= axial_; ++k) {
    double value = 0.0;
    double slope = 0.0;
    if (set_ == ShapeSet::kPolynomial) {
      value = std::pow(s, k);
      slope = k * std::pow(s, k - 1) * inverse;
    } else if (set_ == ShapeSet::kClampedFree) {
      const double w = (k - 0.5) * kPi;
      const double tip = (k % 2 == 1) ? 1.0 : -1.0;
      value = tip * std::sin(w * s);
      slope = tip * w * inverse * std::cos(w * s);
    } else if (k == 1) {
      value = s;
      slope = inverse;
    } else {
      const double w = (k - 1) * kPi;
      value = std::sin(w * s);
      slope = w * inverse * std::cos(w * s);
    }
    out.axial.push_back(value);
    out.axial_slope.push_back(slope);
  }
  const auto push = [&](double value, double slope, double curvature) {
    out.lateral.push_back(value);
    out.lateral_slope.push_back(slope);
    out.lateral_curvature.push_back(curvature);
  };
  for (int k = 1; k <= lateral_; ++k) {
    if (set_ == ShapeSet::kPolynomial) {
      push(std::pow(s, k + 1), (k + 1) * std::pow(s, k) * inverse,
           (k + 1) * k * std::pow(s, k - 1) * inverse * inverse);
    } else if (set_ == ShapeSet::kClampedFree) {
      const double b = roots_[static_cast<std::size_t>(k - 1)];
      const double tip = 1.0 / vibration_mode(b, 1.0, length_, -1.0).value;
      const Curve c = vibration_mode(b, s, length_, -1.0);
      push(tip * c.value, tip * c.slope, tip * c.curvature);
    } else if (k == 1) {
      push(s * s * (3.0 - 2.0 * s), 6.0 * s * (1.0 - s) * inverse,
           (6.0 - 12.0 * s) * inverse * inverse);
    } else if (k == 2) {
      push(s * s * (s - 1.0), s * (3.0 * s - 2.0) * inverse, (6.0 * s - 2.0) * inverse * inverse);
    } else {
      const Curve c = vibration_mode(roots_[static_cast<std::size_t>(k - 3)], s, length_, 1.0);
      push(c.value, c.slope, c.curvature);
    }
  }
  return out;
}

int BeamShapes::quadrature_points() const {
  const int most = axial_ > lateral_ ? axial_ : lateral_;
  // Polynomials: degree 2 (n + 1) of a product. Modes: oscillate, and converge geometrically.
  return set_ == ShapeSet::kPolynomial ? most + 2 : 2 * most + 10;
}

}  // namespace feltmb
