// Root finder: stays within the bracket, within the width, and within the calls of a bisection.
#include <doctest/doctest.h>

#include <cmath>
#include <functional>
#include <initializer_list>
#include <vector>

#include "feltmb/numeric/bracketing.hpp"

namespace {

struct Problem {
  std::function<double(double)> f;
  double a, b, root;
};

const std::vector<Problem>& problems() {
  static const std::vector<Problem> list{
      {[](double x) { return x * x - 2.0; }, 0.0, 2.0, std::sqrt(2.0)},
      {[](double x) { return 2.0 - x * x; }, 0.0, 2.0, std::sqrt(2.0)},
      {[](double x) { return std::cos(x); }, 0.1, 3.0, std::acos(0.0)},
      {[](double x) { return std::pow(x - 0.3, 9); }, -1.0, 2.0, 0.3},
      {[](double x) { return std::tanh(1e6 * (x - 0.7)); }, 0.0, 1.0, 0.7},
      {[](double x) { return x < 1.0 / 3.0 ? -1e-9 : 1e9; }, 0.0, 1.0, 1.0 / 3.0},
      {[](double x) { return std::exp(x) - 1e4; }, -50.0, 50.0, std::log(1e4)},
      {[](double x) { return std::cbrt(x - 1e-3); }, -1.0, 1.0, 1e-3},
      {[](double x) { return x - 0.25; }, 0.25 - 1e-12, 0.25 + 3e-12, 0.25},
  };
  return list;
}

}  // namespace

TEST_CASE("root within the width, calls bounded by a bisection") {
  for (const auto& p : problems()) {
    for (const double width : {1e-3, 1e-7, 1e-12}) {
      int calls = 0;
      double lowest = p.b, highest = p.a;
      const auto counted = [&](double x) {
        ++calls;
        lowest = std::fmin(lowest, x);
        highest = std::fmax(highest, x);
        return p.f(x);
      };
      const double x = feltmb::find_root_bracketed(counted, p.a, p.f(p.a), p.b, p.f(p.b), width);
      CHECK(std::fabs(x - p.root) <= width * (1.0 + 1e-6));
      const double bisections = std::ceil(std::log2((p.b - p.a) / (2.0 * width)));
      CHECK(calls <= std::fmax(0.0, bisections) + 2.0);
      if (calls > 0) {
        CHECK(lowest > p.a);
        CHECK(highest < p.b);
      }
    }
  }
}

TEST_CASE("smooth functions cost far fewer calls than a bisection") {
  int calls = 0;
  const auto f = [&](double x) {
    ++calls;
    return x * x - 2.0;
  };
  feltmb::find_root_bracketed(f, 0.0, -2.0, 2.0, 2.0, 1e-12);
  CHECK(calls <= 14);
}

TEST_CASE("a bracket narrower than the width needs no call") {
  const auto never = [](double) -> double { throw 1; };
  CHECK(feltmb::find_root_bracketed(never, 1.0, -1.0, 1.5, 1.0, 0.25) == doctest::Approx(1.25));
}
