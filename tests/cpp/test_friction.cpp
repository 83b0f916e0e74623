// Thesis eq. A.1 against the formula, its symmetry, its slope.
#include <doctest/doctest.h>

#include <cmath>
#include <initializer_list>

#include "feltmb/contact/friction.hpp"

using feltmb::coulomb;
using feltmb::evaluate;
using feltmb::Friction;

namespace {

constexpr Friction kFelt = coulomb(0.332, 0.73, 1.0, 1e-3);
constexpr Friction kWood = coulomb(1.085, 1.78, 1.0, 1e-3);
constexpr Friction kJoint = coulomb(2.5e-3, 0.0, 0.0, 1e-4);

}  // namespace

TEST_CASE("friction is eq. A.1") {
  for (const auto& f : {kFelt, kWood, kJoint}) {
    for (const double v : {1e-12, 1e-7, 3e-5, 1e-4, 7e-4, 1e-3, 2e-3, 1e-2, 1.0, 40.0}) {
      const double x = v / f.threshold_speed;
      const double expected =
          f.amplitude * (std::tanh(x) + f.b1 * x / (1.0 + f.b2 * std::pow(x, 4)));
      CHECK(evaluate(f, v).value == doctest::Approx(expected).epsilon(1e-13));
    }
  }
}

TEST_CASE("friction is odd, opposes sliding, vanishes at rest and tends to its amplitude") {
  for (const auto& f : {kFelt, kWood, kJoint}) {
    CHECK(evaluate(f, 0.0).value == 0.0);
    for (const double v : {1e-9, 1e-5, 1e-3, 5e-3, 2.0}) {
      CHECK(evaluate(f, -v).value == -evaluate(f, v).value);
      CHECK(evaluate(f, -v).slope == evaluate(f, v).slope);
      CHECK(evaluate(f, v).value * v > 0.0);
    }
    CHECK(evaluate(f, 1.0).value == doctest::Approx(f.amplitude).epsilon(1e-8));
  }
}

TEST_CASE("slope of the friction is its difference quotient") {
  for (const auto& f : {kFelt, kWood, kJoint}) {
    for (const double v : {-5e-3, -1e-3, -2e-4, 1e-8, 5e-5, 6e-4, 1e-3, 3e-3, 0.2}) {
      const double h = 1e-3 * std::fmin(f.threshold_speed, std::fabs(v));
      const auto g = [&](double x) { return evaluate(f, x).value; };
      const double slope =
          (8.0 * (g(v + h) - g(v - h)) - (g(v + 2.0 * h) - g(v - 2.0 * h))) / (12.0 * h);
      const double room = 1e-8 * f.amplitude / f.threshold_speed + 4e-16 * f.amplitude / h;
      CHECK(std::fabs(evaluate(f, v).slope - slope) <= room);
    }
    const double start = f.amplitude * (1.0 + f.b1) / f.threshold_speed;
    CHECK(evaluate(f, 0.0).slope == doctest::Approx(start).epsilon(1e-14));
  }
}

TEST_CASE("no amplitude, no friction; large speeds stay finite") {
  CHECK(evaluate(Friction{}, 3.0).value == 0.0);
  CHECK(evaluate(Friction{}, 3.0).slope == 0.0);
  CHECK(std::isfinite(evaluate(kWood, 1e90).value));
}

TEST_CASE(
    "friction turns over where a term with the threshold speed is, of eq. A.1 or Stribeck's") {
  for (const bool coulomb : {false, true}) {
    for (const bool stribeck : {false, true}) {
      Friction f;
      f.viscous = 0.3;
      f.quadratic = 0.2;
      f.threshold_speed = 1e-3;
      f.amplitude = coulomb ? 0.1 : 0.0;
      f.stribeck = stribeck ? 0.1 : 0.0;
      // The slope falls by orders of magnitude within a few threshold speeds.
      const bool bends = evaluate(f, 0.0).slope > 10.0 * evaluate(f, 5e-3).slope;
      CHECK(f.turns_over() == bends);
    }
  }
}
