#include "feltmb/contact/curve.hpp"

#include <cmath>

#include "feltmb/numeric/elementary.hpp"

namespace feltmb {
namespace {

constexpr double kLargestExponent = 40.0;

}  // namespace

CurveValue evaluate(const ExponentialCurve& curve, double e) {
  if (e <= 0.0) return {0.0, 0.0};
  const double x = curve.b * e;
  if (x <= kLargestExponent) {
    const double g = curve.a * fast_exp(x);
    return {(g + curve.c) * e, g * (1.0 + x) + curve.c};
  }
  const double top = curve.a * std::exp(kLargestExponent);
  const double g = top * (1.0 + x - kLargestExponent);
  return {(g + curve.c) * e, g + top * x + curve.c};
}

double integral(const ExponentialCurve& curve, double e) {
  if (e <= 0.0) return 0.0;
  const double x = curve.b * e;
  const double linear = 0.5 * curve.c * e * e;
  if (x < 1e-3) {
    // Series of [(x - 1) e^x + 1] / x^2, whose closed form cancels for small x.
    const double series = 0.5 + x * (1.0 / 3.0 + x * (1.0 / 8.0 + x * (1.0 / 30.0 + x / 144.0)));
    return curve.a * e * e * series + linear;
  }
  const double scale = curve.a / (curve.b * curve.b);
  if (x <= kLargestExponent) return scale * ((x - 1.0) * std::exp(x) + 1.0) + linear;
  const double top = std::exp(kLargestExponent);
  const double k = kLargestExponent;
  // Integral of x e^k (1 + x - k) dx from k to x.
  const double beyond = top * ((1.0 - k) * 0.5 * (x * x - k * k) + (x * x * x - k * k * k) / 3.0);
  return scale * ((k - 1.0) * top + 1.0 + beyond) + linear;
}

}  // namespace feltmb
