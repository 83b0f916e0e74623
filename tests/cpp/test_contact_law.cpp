// The contact laws against formulas written again here: bounds, slopes, stored energy, messages.
#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <random>
#include <string>
#include <vector>

#include "feltmb/contact/law.hpp"
#include "feltmb/core/error.hpp"
#include "feltmb/numeric/bracketing.hpp"
#include "quadrature.hpp"
#include "table_a12.hpp"

namespace {

using namespace feltmb;

double curve(const ExponentialCurve& k, double e) { return k.a * e * std::exp(k.b * e) + k.c * e; }

ContactLaw pair_law(const table_a12::Row& row, ExponentialPair::Form form, double alpha = 100.0) {
  return ContactLaw(ExponentialPair{row.loading, row.unloading, alpha, form});
}

constexpr auto kPrinted = ExponentialPair::Form::kPrinted;
constexpr auto kGuarded = ExponentialPair::Form::kGuarded;

/// Depth at which the curve reaches 60 N: contacts of a forte stroke stay below.
double depth_of_60_newton(const ExponentialCurve& k) {
  const auto f = [&](double e) { return curve(k, e) - 60.0; };
  return find_root_bracketed(f, 1e-6, f(1e-6), 0.02, f(0.02), 1e-12);
}

std::vector<LawParameters> one_of_each() {
  const auto& row = table_a12::kRows[5];
  return {ExponentialPair{row.loading, row.unloading, 100.0, kPrinted},
          ExponentialPair{row.loading, row.unloading, 100.0, kGuarded},
          MeanCurve{row.loading, row.unloading}, HuntCrossley{1.1e5, 1.5, 1.0}};
}

std::string message_of(const LawParameters& parameters) {
  try {
    const ContactLaw law(parameters);
  } catch (const InvalidParameter& error) {
    return error.what();
  }
  return "";
}

}  // namespace

TEST_CASE("printed law is eqs 4.21-4.22 word by word") {
  for (const auto& row : table_a12::kRows) {
    const auto law = pair_law(row, kPrinted);
    for (const double e : {1e-9, 1e-6, 1e-5, 1e-4, 4e-4, 8e-4}) {
      const double up = curve(row.loading, e);
      const double down = curve(row.unloading, e);
      for (const double v : {-3.0, -0.1, -1e-2, -1e-4, 0.0, 1e-3, 2.0}) {
        const double expected = v >= 0.0 ? up : up + (up - down) * std::tanh(100.0 * v);
        const double size = std::fabs(up) + std::fabs(down) + e * 5e4;
        CHECK(std::fabs(law.evaluate(e, v).force - expected) <= 1e-13 * size);
      }
    }
  }
}

TEST_CASE("guarded law: 0 <= F_U <= F <= F_L, for every row of Table A.12") {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> exponent(-9.0, 0.0);
  for (const auto& row : table_a12::kRows) {
    const auto law = pair_law(row, kGuarded);
    const double deepest = depth_of_60_newton(row.loading);
    for (int i = 0; i < 2000; ++i) {
      const double e = deepest * std::pow(10.0, exponent(random));
      const double v = -std::pow(10.0, exponent(random) + 1.0);
      const double upper = std::max(0.0, curve(row.loading, e));
      const double lower = std::clamp(curve(row.unloading, e), 0.0, upper);
      const double room = 1e-12 * (upper + e * 5e4);
      const double loading = law.evaluate(e, 0.0).force;
      const double fast = law.evaluate(e, -10.0).force;
      const double force = law.evaluate(e, v).force;
      CHECK(std::fabs(loading - upper) <= room);
      CHECK(std::fabs(fast - lower) <= room);
      CHECK(force >= 0.0);
      CHECK(force <= loading);
      CHECK(force >= lower - room);
      const double expected = upper + (upper - lower) * std::tanh(100.0 * v);
      CHECK(std::fabs(force - expected) <= room);
      CHECK(law.evaluate(e, v).d_rate >= 0.0);
    }
  }
}

TEST_CASE("the guarded law never takes the compression for an energy source on a closed loop") {
  // In at one speed, out at another: the work put in is at least the work given back.
  for (const auto& row : table_a12::kRows) {
    const auto law = pair_law(row, kGuarded);
    const double deepest = depth_of_60_newton(row.loading);
    for (const double v : {1e-4, 1e-2, 1.0}) {
      const double in =
          quadrature([&](double e) { return law.evaluate(e, v).force; }, 0.0, deepest, 200);
      const double out =
          quadrature([&](double e) { return law.evaluate(e, -v).force; }, 0.0, deepest, 200);
      CHECK(out <= in);
      CHECK(out >= 0.0);
    }
  }
}

TEST_CASE("loading and unloading fits meet where they are known to") {
  for (const auto& row : table_a12::kRows) {
    if (row.crossing_force == 0.0) continue;
    // The last crossing: below it unloading stays below loading.
    double e = 4e-3;
    const auto band = [&](double x) { return curve(row.loading, x) - curve(row.unloading, x); };
    while (band(e) < 0.0) e *= 0.99;
    CHECK(curve(row.loading, e) == doctest::Approx(row.crossing_force).epsilon(0.04));
    const auto printed = pair_law(row, kPrinted);
    CHECK(printed.evaluate(1.2 * e, -1.0).force > printed.evaluate(1.2 * e, 0.0).force);
    const auto guarded = pair_law(row, kGuarded);
    CHECK(guarded.evaluate(1.2 * e, -1.0).force == guarded.evaluate(1.2 * e, 0.0).force);
  }
}

TEST_CASE("contact 6 as printed pulls below 14.5 um, guarded it does not") {
  const auto& row = table_a12::kRows[5];
  CHECK(pair_law(row, kPrinted).evaluate(7e-6, 1.0).force < -1e-3);
  CHECK(pair_law(row, kPrinted).evaluate(15e-6, 1.0).force > 0.0);
  CHECK(pair_law(row, kGuarded).evaluate(7e-6, 1.0).force == 0.0);
  CHECK(pair_law(row, kGuarded).evaluate(14.6e-6, 1.0).force > 0.0);
}

TEST_CASE("mean law: half of both curves, no rate, never pulls") {
  for (const auto& row : table_a12::kRows) {
    const ContactLaw law(MeanCurve{row.loading, row.unloading});
    for (const double e : {1e-9, 1e-6, 1e-5, 1e-4, 5e-4}) {
      const double expected =
          std::max(0.0, 0.5 * (curve(row.loading, e) + curve(row.unloading, e)));
      CHECK(law.evaluate(e, -3.0).force == doctest::Approx(expected).epsilon(1e-11));
      CHECK(law.evaluate(e, -3.0).force == law.evaluate(e, 5.0).force);
      CHECK(law.evaluate(e, 1.0).d_rate == 0.0);
    }
  }
}

TEST_CASE("Hunt-Crossley: k e^p (1 + d v), never pulls") {
  const ContactLaw law(HuntCrossley{2e6, 2.3, 0.4});
  for (const double e : {1e-9, 1e-5, 1e-3}) {
    for (const double v : {-2.4, -0.3, 0.0, 1.7}) {
      CHECK(law.evaluate(e, v).force ==
            doctest::Approx(2e6 * std::pow(e, 2.3) * (1.0 + 0.4 * v)).epsilon(1e-13));
    }
    CHECK(law.evaluate(e, -2.6).force == 0.0);
    CHECK(law.evaluate(e, -2.6).d_rate == 0.0);
  }
  const ContactLaw linear(HuntCrossley{500.0, 1.0, 0.0});
  CHECK(linear.evaluate(1e-12, 0.0).d_compression == doctest::Approx(500.0).epsilon(1e-12));
}

TEST_CASE("slopes of every law are difference quotients of its force") {
  std::vector<LawParameters> laws = one_of_each();
  for (const auto& row : table_a12::kRows) {
    for (const auto form : {kPrinted, kGuarded}) {
      laws.push_back(ExponentialPair{row.loading, row.unloading, 10.0, form});
    }
  }
  for (const auto& parameters : laws) {
    const ContactLaw law(parameters);
    for (const double e : {1e-8, 1e-6, 3e-5, 1e-4, 4e-4, 1e-3}) {
      for (const double v : {-1.3, -2e-2, -1e-3, -1e-5, 1e-4, 0.7}) {
        // A guard switches within the step: no derivative there.
        const double h = 1e-3 * std::min(e, 1e-5);
        const auto f = [&](double x) { return law.evaluate(x, v).force; };
        const auto g = [&](double w) { return law.evaluate(e, w).force; };
        const LawValue value = law.evaluate(e, v);
        const double left = law.evaluate(e - 2.0 * h, v).d_compression;
        const double right = law.evaluate(e + 2.0 * h, v).d_compression;
        const double scale = std::fabs(value.d_compression) + std::fabs(value.force) / e + 1e3;
        if (std::fabs(left - right) < 0.05 * scale) {
          const double slope =
              (8.0 * (f(e + h) - f(e - h)) - (f(e + 2.0 * h) - f(e - 2.0 * h))) / (12.0 * h);
          CHECK(std::fabs(value.d_compression - slope) <= 1e-7 * scale);
        }
        const double k = 1e-3 * std::min(std::fabs(v), 1e-2);
        const double rate =
            (8.0 * (g(v + k) - g(v - k)) - (g(v + 2.0 * k) - g(v - 2.0 * k))) / (12.0 * k);
        CHECK(std::fabs(value.d_rate - rate) <=
              1e-7 * (std::fabs(value.d_rate) + std::fabs(value.force) / std::fabs(v)) + 1e-9);
      }
    }
  }
}

TEST_CASE("no law acts without compression, and force and slopes vanish for e -> 0+") {
  for (const auto& parameters : one_of_each()) {
    const ContactLaw law(parameters);
    for (const double e : {0.0, -1e-12, -1.0}) {
      const LawValue value = law.evaluate(e, -1.0);
      CHECK(value.force == 0.0);
      CHECK(value.d_compression == 0.0);
      CHECK(value.d_rate == 0.0);
      CHECK(law.stored_energy(e) == 0.0);
      CHECK(law.static_force(e).force == 0.0);
    }
    CHECK(std::fabs(law.evaluate(1e-200, 1.0).force) < 1e-190);
    CHECK(std::isfinite(law.evaluate(10.0, -1.0).force));
  }
}

TEST_CASE("stored energy is the integral of the loading curve, and its slope the elastic force") {
  std::vector<LawParameters> laws = one_of_each();
  for (const auto& row : table_a12::kRows) {
    laws.push_back(ExponentialPair{row.loading, row.unloading, 100.0, kPrinted});
    laws.push_back(ExponentialPair{row.loading, row.unloading, 100.0, kGuarded});
    laws.push_back(MeanCurve{row.loading, row.unloading});
  }
  for (const auto& parameters : laws) {
    const ContactLaw law(parameters);
    for (const double e : {1e-7, 1e-5, 1e-4, 5e-4, 1e-3, 2.5e-3}) {
      // Many parts: a guarded curve has a corner, whose place is not asked for here.
      const double expected =
          quadrature([&](double x) { return law.evaluate(x, 0.0).force; }, 0.0, e, 4000);
      const double size = law.evaluate(e, 0.0).force * e + e * e * 5e4;
      CHECK(std::fabs(law.stored_energy(e) - expected) <= 1e-8 * size);
      const double force = law.evaluate(e, 0.0).force;
      CHECK(law.static_force(e).force == doctest::Approx(force).epsilon(1e-13));
    }
  }
}

TEST_CASE("names of the laws") {
  std::vector<std::string> names;
  for (const auto& parameters : one_of_each()) names.push_back(ContactLaw(parameters).name());
  CHECK(names == std::vector<std::string>{"printed", "guarded", "mean", "hunt_crossley"});
}

TEST_CASE("parameters out of range are named with value and range") {
  const ExponentialCurve good{1e3, 1e3, 0.0};
  CHECK(
      message_of(ExponentialPair{good, good, 0.0, kGuarded}).find("alpha [s/m] = 0, must be > 0") !=
      std::string::npos);
  CHECK(message_of(ExponentialPair{{1e3, -2.0, 0.0}, good, 1.0, kGuarded})
            .find("loading curve: b = -2") != std::string::npos);
  CHECK(message_of(MeanCurve{good, {NAN, 1.0, 1.0}}).find("unloading curve") != std::string::npos);
  CHECK(message_of(HuntCrossley{-1.0, 1.5, 0.0}).find("stiffness [N/m^p] = -1") !=
        std::string::npos);
  CHECK(message_of(HuntCrossley{1.0, 0.5, 0.0}).find("exponent = 0.5, must be >= 1") !=
        std::string::npos);
  CHECK(message_of(HuntCrossley{1.0, 1.5, -3.0}).find("damping [s/m] = -3") != std::string::npos);
  CHECK(message_of(HuntCrossley{1.0, 1.0, 0.0}).empty());
  CHECK(message_of(HuntCrossley{-1.0, 0.5, -3.0}) ==
        "stiffness [N/m^p] = -1, must be > 0; exponent = 0.5, must be >= 1; damping [s/m] = -3, "
        "must be >= 0");
  CHECK(message_of(FeltMemory{}).find("felt_memory: envelope is missing") == 0);
}
