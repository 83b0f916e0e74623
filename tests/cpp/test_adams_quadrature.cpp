// Integrals of known rates over steps of changing size: order, output within a step, restarts.
#include <doctest/doctest.h>

#include <cmath>
#include <vector>

#include "feltmb/ode/adams_quadrature.hpp"

namespace {

using namespace feltmb;

/// Largest error of the integrals of cos 3 t and of t^4 over [0, 1], at steps that grow and shrink.
double largest_error(int steps, std::size_t nodes) {
  AdamsQuadrature quadrature(2);
  const auto rates = [](double t) { return std::vector<double>{std::cos(3.0 * t), t * t * t * t}; };
  quadrature.start(0.0, rates(0.0));
  double worst = 0.0;
  for (int i = 1; i <= steps; ++i) {
    const double s = static_cast<double>(i) / steps;
    const double t = s + 0.03 * std::sin(20.0 * s) * (1.0 - s);
    quadrature.step(t, rates(t), nodes);
    std::vector<double> z(2);
    quadrature.integrals(t, z);
    worst = std::max(worst, std::fabs(z[0] - std::sin(3.0 * t) / 3.0));
    worst = std::max(worst, std::fabs(z[1] - std::pow(t, 5) / 5.0));
  }
  return worst;
}

}  // namespace

TEST_CASE("k nodes of an Adams quadrature give the order k with variable steps") {
  for (const std::size_t nodes : {2, 3, 4, 5}) {
    CAPTURE(nodes);
    const double order = std::log2(largest_error(200, nodes) / largest_error(400, nodes));
    // The first steps have fewer nodes: a few errors of the order two, three, four.
    CHECK(order > std::min(static_cast<double>(nodes), 3.0) - 0.2);
    CHECK(largest_error(400, nodes) < 1e-4 * std::pow(10.0, 2.0 - static_cast<double>(nodes)));
  }
}

TEST_CASE("an Adams quadrature gives integrals within the last step and goes on from there") {
  AdamsQuadrature quadrature(1);
  const auto rate = [](double t) { return std::vector<double>{1.0 + 2.0 * t}; };
  quadrature.start(0.0, rate(0.0));
  quadrature.step(0.5, rate(0.5), 5);
  quadrature.step(1.25, rate(1.25), 5);
  std::vector<double> z(1);
  for (const double t : {0.5, 0.8, 1.25}) {
    quadrature.integrals(t, z);
    CHECK(z[0] == doctest::Approx(t + t * t).epsilon(1e-14));
  }
  quadrature.cut(1.0);
  quadrature.start(1.0, std::vector<double>{7.0});
  quadrature.integrals(1.0, z);
  CHECK(z[0] == doctest::Approx(2.0).epsilon(1e-14));
  quadrature.step(1.5, std::vector<double>{7.0}, 5);
  quadrature.integrals(1.5, z);
  CHECK(z[0] == doctest::Approx(5.5).epsilon(1e-14));
}
