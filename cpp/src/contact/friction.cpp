#include "feltmb/contact/friction.hpp"

#include <cmath>

namespace feltmb {

FrictionValue evaluate(const Friction& friction, double v) {
  if (friction.amplitude == 0.0) return {0.0, 0.0};
  const double x = v / friction.threshold_speed;
  // Beyond 20 the hyperbolic tangent is +-1 to all digits; joints slide there nearly always.
  const double t = std::fabs(x) < 20.0 ? std::tanh(x) : std::copysign(1.0, x);
  double value = t;
  double slope = 1.0 - t * t;
  if (friction.b1 != 0.0) {
    const double x4 = friction.b2 * x * x * x * x;
    const double d = 1.0 / (1.0 + x4);
    value += friction.b1 * x * d;
    slope += friction.b1 * (1.0 - 3.0 * x4) * d * d;
  }
  return {friction.amplitude * value, friction.amplitude * slope / friction.threshold_speed};
}

}  // namespace feltmb
