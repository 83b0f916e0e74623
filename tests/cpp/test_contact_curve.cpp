// Thesis eq. 4.21 and its continuation against the formula in long double, differences, quadrature.
#include <doctest/doctest.h>

#include <cmath>
#include <initializer_list>

#include "feltmb/contact/curve.hpp"
#include "quadrature.hpp"
#include "table_a12.hpp"

namespace {

using feltmb::ExponentialCurve;

/// Eq. 4.21; beyond b e = 40 the exponential follows its tangent at 40.
long double formula(const ExponentialCurve& k, long double e) {
  if (e <= 0.0L) return 0.0L;
  const long double x = static_cast<long double>(k.b) * e;
  const long double grown = x <= 40.0L ? expl(x) : expl(40.0L) * (1.0L + (x - 40.0L));
  return k.a * e * grown + k.c * e;
}

/// Size of the terms that may cancel in the force and in its slope.
double term_size(const ExponentialCurve& k, double e) {
  const double x = k.b * e;
  const double grown = x <= 40.0 ? std::exp(x) : std::exp(40.0) * (x - 39.0);
  return std::fabs(k.a) * grown + std::fabs(k.c);
}

const std::initializer_list<double> kDepths{1e-300, 1e-15, 1e-12, 1e-9, 1e-7, 1e-6, 1e-5, 5e-5,
                                            1e-4,   3e-4,  1e-3,  2e-3, 5e-3, 2e-2, 0.1,  1.0};

}  // namespace

TEST_CASE("force is eq. 4.21 for every curve of Table A.12 at every depth") {
  for (const auto& row : table_a12::kRows) {
    for (const auto& curve : {row.loading, row.unloading}) {
      for (const double e : kDepths) {
        const double expected = static_cast<double>(formula(curve, e));
        // The relative error of exp(x) is that of x times x.
        const double room = (4.0 + curve.b * e) * 2.3e-16 * e * term_size(curve, e);
        CHECK(std::fabs(feltmb::evaluate(curve, e).force - expected) <= room);
      }
    }
  }
}

TEST_CASE("no force and no slope without compression") {
  const ExponentialCurve curve{2e4, 1e3, 5e3};
  for (const double e : {0.0, -0.0, -1e-300, -1e-3, -10.0}) {
    CHECK(feltmb::evaluate(curve, e).force == 0.0);
    CHECK(feltmb::evaluate(curve, e).slope == 0.0);
    CHECK(feltmb::integral(curve, e) == 0.0);
  }
}

TEST_CASE("slope is the difference quotient, from e -> 0+ to beyond the continuation") {
  for (const auto& row : table_a12::kRows) {
    for (const auto& curve : {row.loading, row.unloading}) {
      for (const double e : kDepths) {
        if (e < 1e-290) continue;  // the steps would be denormal
        const double h = 1e-3 * std::fmin(e, 1.0 / curve.b);
        if (std::fabs(curve.b * e - 40.0) < 2.1 * curve.b * h) continue;
        const auto f = [&](double x) { return formula(curve, x); };
        const long double difference =
            (8.0L * (f(e + h) - f(e - h)) - (f(e + 2.0 * h) - f(e - 2.0 * h))) / (12.0L * h);
        const double scale = (1.0 + curve.b * e) * term_size(curve, e);
        CHECK(std::fabs(feltmb::evaluate(curve, e).slope - static_cast<double>(difference)) <=
              1e-10 * scale);
      }
    }
  }
}

TEST_CASE("first slope is a + c") {
  const ExponentialCurve curve{2.35e4, 1.74e3, -2.41e4};
  CHECK(feltmb::evaluate(curve, 1e-17).slope == doctest::Approx(-600.0).epsilon(1e-9));
}

TEST_CASE("the continuation joins in value and slope, and stays finite") {
  for (const auto& row : table_a12::kRows) {
    const auto& curve = row.unloading;
    const double joint = 40.0 / curve.b;
    const auto below = feltmb::evaluate(curve, joint * (1.0 - 1e-12));
    const auto above = feltmb::evaluate(curve, joint * (1.0 + 1e-12));
    CHECK(above.force == doctest::Approx(below.force).epsilon(1e-9));
    CHECK(above.slope == doctest::Approx(below.slope).epsilon(1e-9));
    CHECK(std::isfinite(feltmb::evaluate(curve, 1e3).force));
  }
}

TEST_CASE("integral is the quadrature of the force, across the continuation too") {
  for (const auto& row : table_a12::kRows) {
    for (const auto& curve : {row.loading, row.unloading}) {
      for (const double e : {1e-12, 1e-9, 1e-7, 5e-7, 1e-6, 1e-5, 1e-4, 1e-3, 5e-3, 0.1}) {
        const double joint = std::fmin(e, 40.0 / curve.b);
        const auto f = [&](double x) { return feltmb::evaluate(curve, x).force; };
        const double expected = quadrature(f, 0.0, joint, 64) + quadrature(f, joint, e, 8);
        const double scale = 0.5 * e * e * term_size(curve, e);
        // The closed form cancels as x^-2; the series takes over below x = 1e-3.
        const double x = curve.b * e;
        const double room = 2e-13 + (x > 0.99e-3 ? 1e-15 / (x * x) : 0.0);
        CHECK(std::fabs(feltmb::integral(curve, e) - expected) <= room * scale);
      }
    }
  }
}

TEST_CASE("integral of curves without exponent") {
  CHECK(feltmb::integral({300.0, 0.0, 200.0}, 2e-3) == doctest::Approx(1e-3).epsilon(1e-14));
  CHECK(feltmb::integral({0.0, 1e3, 200.0}, 1e-2) == doctest::Approx(1e-2).epsilon(1e-14));
}
