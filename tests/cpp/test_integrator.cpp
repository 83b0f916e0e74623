// The integrator and its vector kernels on systems whose solution is known.
#include <doctest/doctest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <stdexcept>
#include <string>
#include <vector>

#include "feltmb/core/error.hpp"
#include "feltmb/ode/integrator.hpp"

namespace {

using namespace feltmb;

/// y' = A y.
class Linear : public OdeSystem {
 public:
  explicit Linear(Eigen::MatrixXd a) : a_(std::move(a)) {}
  std::size_t size() const override { return static_cast<std::size_t>(a_.rows()); }
  std::string state_name(std::size_t i) const override { return std::to_string(i); }
  void rhs(double t, std::span<const double> y, std::span<double> rate) override {
    if (t > fail_after) throw ModelError("beyond the end");
    Eigen::Map<Eigen::VectorXd>(rate.data(), a_.rows()) =
        a_ * Eigen::Map<const Eigen::VectorXd>(y.data(), a_.rows());
    if (t > nan_after) rate[0] = NAN;
  }
  void linearize(double, std::span<const double>) override {}
  bool factorize(double gamma) override {
    lu_.compute(Eigen::MatrixXd::Identity(a_.rows(), a_.rows()) - gamma * a_);
    return true;
  }
  void solve(std::span<double> b) override {
    Eigen::Map<Eigen::VectorXd> x(b.data(), a_.rows());
    x = lu_.solve(x).eval();
  }

  double fail_after = INFINITY;
  double nan_after = INFINITY;

 private:
  Eigen::MatrixXd a_;
  Eigen::PartialPivLU<Eigen::MatrixXd> lu_;
};

IntegratorOptions options(std::size_t n, double rtol) {
  IntegratorOptions o;
  o.rtol = rtol;
  o.atol.assign(n, rtol * 1e-3);
  return o;
}

StepStatus run_to(Integrator& integrator, double end) {
  StepStatus status = StepStatus::kStep;
  while (status == StepStatus::kStep) status = integrator.step(end);
  return status;
}

/// Damped oscillators of several frequencies, tied to blocks on the diagonal.
Eigen::MatrixXd oscillators(int count) {
  Eigen::MatrixXd a = Eigen::MatrixXd::Zero(2 * count, 2 * count);
  for (int i = 0; i < count; ++i) {
    const double w = 5.0 + 30.0 * i;
    a(2 * i, 2 * i + 1) = 1.0;
    a(2 * i + 1, 2 * i) = -w * w;
    a(2 * i + 1, 2 * i + 1) = -0.2 * w;
  }
  return a;
}

double exact(double w, double t) {
  const double d = 0.1 * w;
  const double f = std::sqrt(w * w - d * d);
  return std::exp(-d * t) * (std::cos(f * t) + d / f * std::sin(f * t));
}

double largest_error(double rtol) {
  const int count = 5;
  Linear system(oscillators(count));
  Integrator integrator(system, options(system.size(), rtol));
  std::vector<double> y(system.size(), 0.0);
  for (std::size_t i = 0; i < y.size(); i += 2) y[i] = 1.0;
  integrator.start(0.0, y);
  double worst = 0.0;
  while (integrator.step(1.0) == StepStatus::kStep) {
    for (int i = 0; i < count; ++i) {
      const double error = integrator.state()[static_cast<std::size_t>(2 * i)] -
                           exact(5.0 + 30.0 * i, integrator.time());
      worst = std::fmax(worst, std::fabs(error));
    }
  }
  return worst;
}

}  // namespace

TEST_CASE("errors of a linear system fall with rtol") {
  double before = largest_error(1e-3);
  CHECK(before < 0.1);
  for (const double rtol : {1e-5, 1e-7, 1e-9}) {
    const double error = largest_error(rtol);
    // A BDF of order q errs as rtol^(q/(q+1)) at worst; two decades of rtol give at least 1.3.
    CHECK(error < before / 20.0);
    CHECK(error < 1e3 * rtol);
    before = error;
  }
}

TEST_CASE("vector kernels: copies of one equation stay equal to the bit, for every length") {
  std::vector<double> alone;
  for (int n = 1; n <= 35; ++n) {
    Linear system(-30.0 * Eigen::MatrixXd::Identity(n, n));
    Integrator integrator(system, options(system.size(), 1e-7));
    integrator.start(0.0, std::vector<double>(system.size(), 1.0));
    CHECK(run_to(integrator, 0.3) == StepStatus::kStop);
    const auto y = integrator.state();
    for (const double value : y) CHECK(value == y[0]);
    CHECK(y[0] == doctest::Approx(std::exp(-9.0)).epsilon(1e-4));
    if (n == 1) alone.assign(y.begin(), y.end());
    // The norm is a mean: the steps do not depend on the number of copies.
    CHECK(y[0] == doctest::Approx(alone[0]).epsilon(1e-10));
  }
}

TEST_CASE("vector kernels: every entry follows its own exponential, for every length") {
  for (int n = 1; n <= 35; ++n) {
    Eigen::MatrixXd a = Eigen::MatrixXd::Zero(n, n);
    for (int i = 0; i < n; ++i) a(i, i) = -1.0 - 3.0 * i;
    Linear system(a);
    Integrator integrator(system, options(system.size(), 1e-9));
    integrator.start(0.0, std::vector<double>(system.size(), 1.0));
    run_to(integrator, 0.5);
    for (int i = 0; i < n; ++i) {
      CHECK(std::fabs(integrator.state()[static_cast<std::size_t>(i)] -
                      std::exp(-0.5 * (1.0 + 3.0 * i))) < 1e-7);
    }
  }
}

TEST_CASE("dense output within the last step") {
  Linear system(-1.0 * Eigen::MatrixXd::Identity(1, 1));
  Integrator integrator(system, options(1, 1e-8));
  integrator.start(0.0, std::vector<double>{1.0});
  double value = 0.0;
  while (integrator.step(2.0) == StepStatus::kStep) {
    const double t = integrator.time() - 0.37 * integrator.last_step();
    integrator.interpolate(t, {&value, 1});
    CHECK(value == doctest::Approx(std::exp(-t)).epsilon(1e-6));
  }
  CHECK(integrator.time() == 2.0);
}

TEST_CASE("an exception of the system comes out of step, with its own words") {
  Linear system(-1.0 * Eigen::MatrixXd::Identity(2, 2));
  system.fail_after = 0.5;
  Integrator integrator(system, options(2, 1e-6));
  integrator.start(0.0, std::vector<double>(2, 1.0));
  CHECK_THROWS_WITH_AS(run_to(integrator, 1.0), "beyond the end", ModelError);
}

TEST_CASE("a right-hand side that turns NaN fails with a message and keeps what was reached") {
  Linear system(-1.0 * Eigen::MatrixXd::Identity(2, 2));
  system.nan_after = 0.5;
  Integrator integrator(system, options(2, 1e-6));
  integrator.start(0.0, std::vector<double>(2, 1.0));
  CHECK(run_to(integrator, 1.0) == StepStatus::kFailed);
  CHECK(!integrator.message().empty());
  CHECK(integrator.time() > 0.3);
  CHECK(integrator.time() <= 0.5 + 1e-9);
  CHECK(integrator.state()[0] == doctest::Approx(std::exp(-integrator.time())).epsilon(1e-4));
}

TEST_CASE("options out of range are refused") {
  Linear system(-1.0 * Eigen::MatrixXd::Identity(2, 2));
  auto o = options(2, 0.0);
  CHECK_THROWS_AS(Integrator(system, o), InvalidParameter);
  o = options(3, 1e-6);
  CHECK_THROWS_AS(Integrator(system, o), InvalidParameter);
  o = options(2, 1e-6);
  o.max_order = 6;
  CHECK_THROWS_AS(Integrator(system, o), InvalidParameter);
  o.max_order = 5;
  o.long_order = 3;  // beyond no step
  CHECK_THROWS_AS(Integrator(system, o), InvalidParameter);
  o.stable_step = 1.0;
  o.long_order = 6;
  CHECK_THROWS_AS(Integrator(system, o), InvalidParameter);
  Integrator integrator(system, options(2, 1e-6));
  CHECK_THROWS_AS(integrator.start(0.0, std::vector<double>(3, 1.0)), InvalidParameter);
}

TEST_CASE("limits on order and step are kept") {
  Linear system(oscillators(1));
  auto o = options(2, 1e-6);
  o.max_order = 2;
  o.max_step = 1e-3;
  Integrator integrator(system, o);
  integrator.start(0.0, std::vector<double>{1.0, 0.0});
  while (integrator.step(0.1) == StepStatus::kStep) {
    CHECK(integrator.last_order() <= 2);
    CHECK(integrator.last_step() <= 1e-3 * (1.0 + 1e-9));
  }
}

TEST_CASE("long steps have a lower order, short ones may have the highest") {
  // A slow motion with a fast part that dies out: first short steps, then long ones.
  Eigen::MatrixXd a = Eigen::MatrixXd::Zero(4, 4);
  a(0, 1) = a(2, 3) = 1.0;
  a(1, 0) = -1.0;
  a(3, 2) = -1e6;
  a(3, 3) = -200.0;
  Linear system(a);
  auto o = options(4, 1e-6);
  o.long_order = 3;
  o.stable_step = 8e-4;
  Integrator integrator(system, o);
  integrator.start(0.0, std::vector<double>{1.0, 0.0, 1.0, 0.0});
  int highest = 0;
  double longest = 0.0;
  while (integrator.step(6.0) == StepStatus::kStep) {
    highest = std::max(highest, integrator.last_order());
    longest = std::fmax(longest, integrator.last_step());
    if (integrator.last_step() > o.stable_step * (1.0 + 1e-9)) CHECK(integrator.last_order() <= 3);
  }
  CHECK(highest == 5);
  CHECK(longest > 10.0 * o.stable_step);
  CHECK(integrator.state()[0] == doctest::Approx(std::cos(6.0)).epsilon(1e-3));
}
