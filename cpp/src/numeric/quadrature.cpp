#include "feltmb/numeric/quadrature.hpp"

#include <numbers>

#include "feltmb/core/error.hpp"

namespace feltmb {

QuadratureRule make_gauss_legendre(std::size_t n) {
  if (n < 1 || n > 4096) {
    throw InvalidParameter(
        format("Gauss-Legendre rule: n = %zu nodes, must be between 1 and 4096", n));
  }
  QuadratureRule rule{std::vector<double>(n), std::vector<double>(n)};
  const double count = static_cast<double>(n);
  for (std::size_t i = 0; i < (n + 1) / 2; ++i) {
    double x = std::cos(std::numbers::pi * (static_cast<double>(i) + 0.75) / (count + 0.5));
    double derivative = 1.0;
    for (int iteration = 0; iteration < 100; ++iteration) {
      double previous = 1.0;
      double current = x;
      for (std::size_t k = 2; k <= n; ++k) {
        const double degree = static_cast<double>(k);
        const double next =
            ((2.0 * degree - 1.0) * x * current - (degree - 1.0) * previous) / degree;
        previous = current;
        current = next;
      }
      if (n == 1) {
        derivative = 1.0;
      } else {
        derivative = count * (x * current - previous) / (x * x - 1.0);
      }
      const double step = current / derivative;
      x -= step;
      if (std::abs(step) < 1e-16) break;
    }
    const double weight = 2.0 / ((1.0 - x * x) * derivative * derivative);
    rule.nodes[i] = -x;
    rule.nodes[n - 1 - i] = x;
    rule.weights[i] = weight;
    rule.weights[n - 1 - i] = weight;
  }
  if (n % 2 == 1) rule.nodes[n / 2] = 0.0;
  return rule;
}

const QuadratureRule& gauss16() {
  static const QuadratureRule& rule = *new QuadratureRule(make_gauss_legendre(16));
  return rule;
}

}  // namespace feltmb
