// Newton's method of the integrator: it may leave out what a short step does not feel, and takes
// the whole Jacobian where that is not enough.
#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "feltmb/model/mechanism_system.hpp"
#include "feltmb/ode/integrator.hpp"

namespace {

using namespace feltmb;

/// u' = -1000 (u - cos t), w' = -rate w: the stiff part of the Jacobian is that of u alone.
class FastAndSlow : public OdeSystem {
 public:
  FastAndSlow(double rate, bool split) : rate_(rate), split_(split) {}
  std::size_t size() const override { return 2; }
  std::string state_name(std::size_t i) const override { return std::to_string(i); }
  void rhs(double t, std::span<const double> y, std::span<double> rate) override {
    rate[0] = -1000.0 * (y[0] - std::cos(t));
    rate[1] = -rate_ * y[1];
  }
  void linearize(double, std::span<const double>) override {
    slow_ = rate_;
    ++whole;
  }
  void linearize_stiff(double t, std::span<const double> y) override {
    if (!split_) return linearize(t, y);
    slow_ = 0.0;
    ++parts;
  }
  bool factorize(double gamma) override {
    gamma_ = gamma;
    return true;
  }
  void solve(std::span<double> b) override {
    b[0] /= 1.0 + gamma_ * 1000.0;
    b[1] /= 1.0 + gamma_ * slow_;
  }

  long whole = 0;
  long parts = 0;

 private:
  double rate_;
  bool split_;
  double slow_ = 0.0;
  double gamma_ = 0.0;
};

IntegratorCounts counts_to(FastAndSlow& system, double end, double* last) {
  IntegratorOptions o;
  o.rtol = 1e-6;
  o.atol.assign(2, 1e-9);
  Integrator integrator(system, o);
  integrator.start(0.0, std::vector<double>{0.0, 1.0});
  StepStatus status = StepStatus::kStep;
  while (status == StepStatus::kStep) status = integrator.step(end);
  REQUIRE(status == StepStatus::kStop);
  *last = integrator.state()[0];
  return integrator.counts();
}

}  // namespace

TEST_CASE("short steps take the stiff part of the Jacobian, long ones the whole") {
  // Until w has died out the steps resolve it, then they grow beyond 1 / rate.
  FastAndSlow split(50.0, true);
  FastAndSlow whole(50.0, false);
  double with_part = 0.0;
  double with_whole = 0.0;
  const IntegratorCounts a = counts_to(split, 20.0, &with_part);
  const IntegratorCounts b = counts_to(whole, 20.0, &with_whole);
  // u = (10^6 cos t + 10^3 sin t) / (10^6 + 1)
  const double exact = (1e6 * std::cos(20.0) + 1e3 * std::sin(20.0)) / (1e6 + 1.0);
  CHECK(with_part == doctest::Approx(exact).epsilon(1e-5));
  CHECK(with_whole == doctest::Approx(exact).epsilon(1e-5));
  CHECK(split.parts > 10);
  CHECK(split.whole > 0);
  CHECK(a.steps < 2 * b.steps);
  CHECK(a.rhs < 3 * b.rhs);
}

TEST_CASE("a linear system takes one right-hand side a step") {
  FastAndSlow system(50.0, false);
  double last = 0.0;
  const IntegratorCounts c = counts_to(system, 20.0, &last);
  CHECK(c.newton_failures == 0);
  CHECK(static_cast<double>(c.newton_iterations) <
        1.2 * static_cast<double>(c.steps + c.rejected) + 10.0);
}

TEST_CASE("without its slow parts the Jacobian is right to the square of the step") {
  MechanismDescription d;
  for (int b = 0; b < 2; ++b) {
    BodyDescription body;
    body.name = "lever" + std::to_string(b);
    body.position = {0.2 * b, 0.0};
    body.coordinate = body.name + ".angle";
    body.mass = 0.01;
    body.center_of_mass = {0.05, 0.0};
    body.inertia = 1e-5;
    d.bodies.push_back(body);
  }
  SurfaceDescription floor;
  floor.name = "floor";
  floor.body = "ground";
  floor.kind = SurfaceKind::kLine;
  d.surfaces.push_back(floor);
  const ExponentialCurve loading{5.52e3, 1.58e3, -0.60e3};
  const ExponentialCurve unloading{0.19e3, 5.04e3, 3.04e3};
  FeltMemory memory;
  memory.envelope = Envelope::from_curves(loading, unloading);
  for (int c = 0; c < 6; ++c) {
    SurfaceDescription foot;
    foot.name = "foot" + std::to_string(c);
    foot.body = "lever" + std::to_string(c % 2);
    foot.point = {0.02 + 0.001 * c, 0.0};
    foot.radius = 5e-4;
    d.surfaces.push_back(foot);
    ContactDescription contact;
    contact.number = c + 1;
    contact.surface_a = "floor";
    contact.surface_b = foot.name;
    if (c < 4) {
      contact.law = memory;
    } else {
      contact.law = ExponentialPair{loading, unloading};
    }
    contact.friction = feltmb::coulomb(0.3, 0.7, 0.5, 1e-3);
    d.contacts.push_back(contact);
  }
  MechanismSystem system(assemble(d), {Profile()}, false, {}, false);
  std::vector<double> y(system.size(), 0.0);
  y[1] = 1e-3;
  y[2] = -0.1;
  y[3] = 0.08;
  for (std::size_t i = 4; i < y.size(); ++i) y[i] = 0.3;
  for (double& e : system.dynamics().largest_compression()) e = 1e-3;

  const auto difference = [&](double gamma) {
    // As in a step: speeds off by one, places by what that makes in it.
    std::vector<double> part(y.size(), 0.0);
    part[0] = part[1] = gamma;
    part[2] = part[3] = 1.0;
    std::vector<double> whole = part;
    system.linearize_stiff(0.0, y);
    REQUIRE(system.factorize(gamma));
    system.solve(part);
    system.linearize(0.0, y);
    REQUIRE(system.factorize(gamma));
    system.solve(whole);
    double largest = 0.0;
    for (std::size_t i = 0; i < y.size(); ++i) {
      largest = std::max(largest, std::fabs(part[i] - whole[i]) / (1.0 + std::fabs(whole[i])));
    }
    return largest;
  };
  const double coarse = difference(1e-4);
  const double fine = difference(1e-5);
  CHECK(coarse < 0.05);
  CHECK(fine < 2e-3);
  CHECK(fine < 0.2 * coarse);
}
