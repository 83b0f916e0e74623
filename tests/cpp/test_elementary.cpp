#include <doctest/doctest.h>

#include <cmath>
#include <limits>

#include "feltmb/numeric/elementary.hpp"

using feltmb::fast_exp;
using feltmb::fast_tanh;

TEST_CASE("exponential: one unit in the last place against long double") {
  double worst = 0.0;
  for (int i = -70000; i <= 70000; ++i) {
    const double x = 0.0101 * i * 0.98;
    const long double exact = std::exp(static_cast<long double>(x));
    worst = std::fmax(worst, static_cast<double>(std::fabs((fast_exp(x) - exact) / exact)));
  }
  CHECK(worst < 2.3e-16);
  CHECK(fast_exp(0.0) == 1.0);
}

TEST_CASE("hyperbolic tangent: relative error of value and slope over twelve decades") {
  double worst = 0.0;
  double worst_slope = 0.0;
  for (int i = 0; i <= 200000; ++i) {
    const double x = std::pow(10.0, -12.0 + 13.3 * i / 200000.0);
    const auto t = fast_tanh(x);
    if (x >= 20.0) {
      CHECK(t.value == 1.0);
      continue;
    }
    const long double exact = std::tanh(static_cast<long double>(x));
    const long double cosh = std::cosh(static_cast<long double>(x));
    worst = std::fmax(worst, static_cast<double>(std::fabs(t.value / exact - 1.0L)));
    worst_slope =
        std::fmax(worst_slope, static_cast<double>(std::fabs(t.slope * cosh * cosh - 1.0L)));
    CHECK(fast_tanh(-x).value == -t.value);
  }
  CHECK(worst < 6e-16);
  CHECK(worst_slope < 1e-15);
  CHECK(fast_tanh(0.0).value == 0.0);
  CHECK(fast_tanh(0.0).slope == 1.0);
  CHECK(fast_tanh(-std::numeric_limits<double>::infinity()).value == -1.0);
  CHECK(std::isnan(fast_tanh(std::numeric_limits<double>::quiet_NaN()).value));
}
