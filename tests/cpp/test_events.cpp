// Event locator on a clock and on an oscillator whose crossings are known.
#include <doctest/doctest.h>

#include <cmath>
#include <numbers>
#include <string>
#include <vector>

#include "feltmb/ode/events.hpp"

namespace {

using namespace feltmb;

constexpr double kRate = 2.0 * std::numbers::pi * 50.0;

/// x'' = -w^2 x; events: x, x - 0.5, the time less 0.0123 s, and a constant.
class Swing : public OdeSystem {
 public:
  std::size_t size() const override { return 2; }
  std::string state_name(std::size_t) const override { return "x"; }
  void rhs(double, std::span<const double> y, std::span<double> rate) override {
    rate[0] = y[1];
    rate[1] = -kRate * kRate * y[0];
  }
  void linearize(double, std::span<const double>) override {}
  bool factorize(double gamma) override {
    gamma_ = gamma;
    return true;
  }
  void solve(std::span<double> b) override {
    const double g = gamma_;
    const double k = kRate * kRate;
    const double x = (b[0] + g * b[1]) / (1.0 + g * g * k);
    b[1] = (b[1] - g * k * b[0]) / (1.0 + g * g * k);
    b[0] = x;
  }
  std::size_t n_events() const override { return 4; }
  void events(double t, std::span<const double> y, std::span<double> g) override {
    g[0] = y[0];
    g[1] = y[0] - 0.5;
    g[2] = t - 0.0123;
    g[3] = 0.0;
  }

 private:
  double gamma_ = 0.0;
};

std::vector<Crossing> crossings(double x0, double v0, double end) {
  Swing system;
  IntegratorOptions o;
  o.rtol = 1e-10;
  o.atol.assign(2, 1e-13);
  Integrator integrator(system, o);
  EventLocator locator(system);
  const std::vector<double> y{x0, v0};
  integrator.start(0.0, y);
  locator.start(0.0, y);
  std::vector<Crossing> all;
  StepStatus status = StepStatus::kStep;
  while (status == StepStatus::kStep) {
    status = integrator.step(end);
    for (const auto& c : locator.scan(integrator, integrator.time())) all.push_back(c);
  }
  CHECK(locator.evaluations() > 0);
  return all;
}

}  // namespace

TEST_CASE("crossings of an oscillator: times, senses, order") {
  const auto all = crossings(1.0, 0.0, 0.05);
  std::vector<double> zero, half;
  double before = 0.0;
  for (const auto& c : all) {
    CHECK(c.time >= before);
    before = c.time;
    CHECK(c.event != 3);
    if (c.event == 0) {
      CHECK(c.direction == (zero.size() % 2 == 0 ? -1 : 1));
      zero.push_back(c.time);
    } else if (c.event == 1) {
      CHECK(c.direction == (half.size() % 2 == 0 ? -1 : 1));
      half.push_back(c.time);
    } else {
      CHECK(c.time == doctest::Approx(0.0123).epsilon(1e-9));
      CHECK(c.direction == 1);
    }
  }
  REQUIRE(zero.size() == 5);
  REQUIRE(half.size() == 5);
  for (std::size_t i = 0; i < 5; ++i) {
    CHECK(std::fabs(zero[i] - (0.005 + 0.01 * static_cast<double>(i))) < 1e-8);
  }
  CHECK(std::fabs(half[0] - std::acos(0.5) / kRate) < 1e-8);
}

TEST_CASE("a function that starts at zero and rises crosses at the start") {
  const auto all = crossings(0.0, 100.0, 0.004);
  REQUIRE(!all.empty());
  CHECK(all.front().event == 0);
  CHECK(all.front().direction == 1);
  CHECK(all.front().time == 0.0);
}

TEST_CASE("a function that starts at zero and falls does not cross") {
  for (const auto& c : crossings(0.0, -100.0, 0.004)) CHECK(c.event != 0);
}
