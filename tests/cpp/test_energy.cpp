// Energy of runs against exact values: what a felt with memory keeps of a thrown mass, and the
// ledger where the felt is pressed beyond what it remembers.
#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <string>

#include "feltmb/contact/envelope.hpp"
#include "feltmb/model/stepper.hpp"
#include "feltmb/planar/description.hpp"

namespace {

using namespace feltmb;

constexpr double kMass = 0.05;  // kg
constexpr double kKappa = 0.2;  // of the felt
/// Of the ledger at rtol 1e-8: powers are those of predicted states, and a throw has few steps.
constexpr double kMostResidual = 1e-5;

const std::shared_ptr<const Envelope>& felt() {
  static const std::shared_ptr<const Envelope> made =
      Envelope::from_curves({5.52e3, 1.58e3, -0.60e3}, {0.19e3, 5.04e3, 3.04e3});
  return made;
}

/// A mass of 50 g that moves along y toward a felt on the ground, without gravity.
std::shared_ptr<const Mechanism> thrown_mass() {
  MechanismDescription d;
  d.name = "thrown_mass";
  d.gravity = {0.0, 0.0};
  BodyDescription body;
  body.name = "mass";
  body.joint = JointKind::kPrismatic;
  body.coordinate = "mass.y";
  body.mass = kMass;
  d.bodies.push_back(body);
  SurfaceDescription ground;
  ground.name = "ground_line";
  ground.body = "ground";
  ground.kind = SurfaceKind::kLine;
  SurfaceDescription foot;
  foot.name = "foot";
  foot.body = "mass";
  d.surfaces = {ground, foot};
  ContactDescription contact;
  contact.number = 1;
  contact.surface_a = "ground_line";
  contact.surface_b = "foot";
  contact.law = FeltMemory{felt(), kKappa};
  d.contacts.push_back(contact);
  return assemble(d);
}

/// Thrown with a speed [m/s] from 1 mm above the felt, which remembers a compression [m].
RunResult thrown(double speed, double remembered = 0.0, double rtol = 1e-8) {
  SimulationOptions o;
  o.duration = 0.05;
  o.rtol = rtol;
  SimulationState start;
  start.y = {1e-3, -speed, 0.0};
  start.largest_compression = {remembered};
  RunResult run = simulate(thrown_mass(), {Profile()}, o, start);
  REQUIRE(run.status == RunStatus::kDone);
  return run;
}

double last(const RunResult& run, const std::string& name) {
  const auto& names = run.ledger_names;
  const auto found = std::find(names.begin(), names.end(), name);
  REQUIRE(found != names.end());
  return run.ledger(run.ledger.rows() - 1, found - names.begin());
}

double kinetic(double speed) { return 0.5 * kMass * speed * speed; }

/// Loss of a strike from 0 to `deepest` [J] of a felt that remembers a smaller compression, z = 0,
/// by hand: z rises to q = 1 - exp(-1 / kappa) in the loop that it remembers, falls by (W / W')^(1
/// / kappa) on virgin loading, and by exp(-A / c) over the area A of the way back.
double loss(double remembered, double deepest) {
  const double small = felt()->loop_area(remembered).force;
  const double whole = felt()->loop_area(deepest).force;
  const double q = 1.0 - std::exp(-1.0 / kKappa);
  const double z = q * std::pow(small / whole, 1.0 / kKappa);
  return whole * (1.0 - kKappa * q * z) - kKappa * q * small;
}

}  // namespace

TEST_CASE("a mass thrown on virgin felt comes back without the area of its loop") {
  for (const double speed : {0.2, 0.5, 1.0}) {
    CAPTURE(speed);
    const RunResult run = thrown(speed);
    const double deepest = run.end.largest_compression[0];
    const double loop = felt()->loop_area(deepest).force;
    CHECK(felt()->loading_energy(deepest) == doctest::Approx(kinetic(speed)).epsilon(1e-6));
    CHECK(kinetic(run.end.y[1]) == doctest::Approx(kinetic(speed) - loop).epsilon(1e-6));
    // The loop is heat, but for what its friction keeps locked (kappa W / 4 at z = 0).
    const double locked = 0.25 * kKappa * loop;
    CHECK(last(run, "dissipated.contact01.normal") == doctest::Approx(loop - locked).epsilon(1e-6));
    CHECK(run.balance.residual_relative < kMostResidual);
  }
}

TEST_CASE("a felt that is pressed beyond what it remembers keeps less and less of it") {
  for (const double remembered : {1e-4, 2e-4, 3e-4, 5e-4}) {
    CAPTURE(remembered);
    const RunResult run = thrown(1.0, remembered);
    const double deepest = run.end.largest_compression[0];
    CHECK(deepest > remembered);
    CHECK(kinetic(run.end.y[1]) ==
          doctest::Approx(kinetic(1.0) - loss(remembered, deepest)).epsilon(1e-6));
    CHECK(run.balance.residual_relative < kMostResidual);
  }
}

TEST_CASE("what a felt remembers of a touch does not decide on a strike, at any tolerance") {
  for (const double remembered : {1e-7, 18e-6}) {
    for (double rtol = 1e-3; rtol > 5e-11; rtol *= 0.5) {
      CAPTURE(remembered);
      CAPTURE(rtol);
      const RunResult run = thrown(3.0, remembered, rtol);
      const double deepest = run.end.largest_compression[0];
      CHECK(kinetic(run.end.y[1]) ==
            doctest::Approx(kinetic(3.0) - loss(remembered, deepest)).epsilon(1e-3 + 20.0 * rtol));
    }
  }
}

TEST_CASE("a state without memory is that of virgin felt, whatever was pressed before") {
  Stepper stepper(thrown_mass(), InputKind::kForce, StepperOptions{});
  StepState above = stepper.state();
  above.machine.y = {1e-3, -0.5, 0.0};
  above.machine.largest_compression.clear();
  const auto speed_after_the_throw = [&] {
    stepper.set_state(above);
    REQUIRE(stepper.advance(0.05, {0.0}).status == RunStatus::kDone);
    return stepper.state().machine.y[1];
  };
  const double first = speed_after_the_throw();
  CHECK(first > 0.1);
  CHECK(speed_after_the_throw() == first);
}
