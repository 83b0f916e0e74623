#include "feltmb/contact/friction.hpp"

#include <cmath>

#include "feltmb/numeric/elementary.hpp"

namespace feltmb {
namespace {

/// Viscous, quadratic and Stribeck terms.
FrictionValue extra_terms(const Friction& f, double v) {
  FrictionValue out{(f.viscous + f.quadratic * std::fabs(v)) * v,
                    f.viscous + 2.0 * f.quadratic * std::fabs(v)};
  if (f.stribeck != 0.0) {
    const double y = v / f.stribeck_speed;
    const double bell = f.stribeck * std::exp(-y * y);
    const HyperbolicTangent t = fast_tanh(v / f.threshold_speed);
    out.value += bell * t.value;
    out.slope += bell * (t.slope / f.threshold_speed - 2.0 * y / f.stribeck_speed * t.value);
  }
  return out;
}

}  // namespace

bool turns_over(const Friction& friction) {
  return friction.amplitude != 0.0 || friction.stribeck != 0.0;
}

FrictionValue evaluate(const Friction& friction, double v) {
  const bool plain =
      friction.viscous == 0.0 && friction.quadratic == 0.0 && friction.stribeck == 0.0;
  if (!plain) {
    Friction own = friction;
    own.viscous = own.quadratic = own.stribeck = 0.0;
    const FrictionValue base = evaluate(own, v);
    const FrictionValue more = extra_terms(friction, v);
    return {base.value + more.value, base.slope + more.slope};
  }
  if (friction.amplitude == 0.0) return {0.0, 0.0};
  const double x = v / friction.threshold_speed;
  const HyperbolicTangent t = fast_tanh(x);
  double value = t.value;
  double slope = t.slope;
  if (friction.b1 != 0.0) {
    const double x4 = friction.b2 * x * x * x * x;
    const double d = 1.0 / (1.0 + x4);
    value += friction.b1 * x * d;
    slope += friction.b1 * (1.0 - 3.0 * x4) * d * d;
  }
  return {friction.amplitude * value, friction.amplitude * slope / friction.threshold_speed};
}

}  // namespace feltmb
