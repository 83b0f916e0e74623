/// Root of a scalar function in a bracket, without derivatives.
#pragma once

#include <cmath>

namespace feltmb {

/// Root of f in [a, b] by the ITP method (I. F. D. Oliveira, R. H. C. Takahashi, ACM Trans. Math.
/// Softw. 47 (2020) 5): superlinear, never slower than bisection by more than one step.
///
/// @param f      continuous; f(a) = fa and f(b) = fb differ in sign, neither is zero
/// @param a,b    bracket, a < b
/// @param width  the returned point lies within `width` of the root, > 0, unit of a
template <class Function>
double find_root_bracketed(Function&& f, double a, double fa, double b, double fb, double width) {
  const double sign = fb > 0.0 ? 1.0 : -1.0;
  const double k1 = 0.2 / (b - a);
  const int bisections = static_cast<int>(std::ceil(std::log2((b - a) / (2.0 * width)))) + 1;
  double limit = width * std::ldexp(1.0, bisections < 0 ? 0 : bisections);
  while (b - a > 2.0 * width) {
    const double middle = 0.5 * (a + b);
    const double false_position = (fb * a - fa * b) / (fb - fa);
    const double direction = middle >= false_position ? 1.0 : -1.0;
    const double shift = k1 * (b - a) * (b - a);
    double x =
        shift <= std::fabs(middle - false_position) ? false_position + direction * shift : middle;
    const double radius = limit - 0.5 * (b - a);
    if (std::fabs(x - middle) > radius) x = middle - direction * radius;
    if (!(x > a && x < b)) x = middle;
    const double fx = f(x);
    if (fx == 0.0) return x;
    if (sign * fx > 0.0) {
      b = x;
      fb = fx;
    } else {
      a = x;
      fa = fx;
    }
    limit *= 0.5;
  }
  return 0.5 * (a + b);
}

}  // namespace feltmb
