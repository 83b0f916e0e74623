// What several threads share: mechanisms, tables of felt layers, batches, gradients of segments,
// loops of the fibers. The thread sanitizer runs these cases (tools/sanitize.sh thread).
#include <doctest/doctest.h>

#include <atomic>
#include <cmath>
#include <memory>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "feltmb/batch/batch.hpp"
#include "feltmb/contact/felt_layer.hpp"
#include "feltmb/fiber/compression.hpp"
#include "feltmb/fiber/orientation.hpp"
#include "feltmb/model/stepper.hpp"
#include "feltmb/sensitivity/sensitivity.hpp"
#include "struck_string.hpp"

namespace {

using namespace feltmb;

constexpr std::size_t kThreads = 4;
constexpr double kReach = 0.13;  // m, of the lever

FeltMaterial soft_felt(double v_f0) {
  FeltMaterial m;
  m.mu = 0.35;
  m.Wf0 = 0.8;
  m.d_f = 25e-6;
  m.v_f0 = v_f0;
  m.v_f_max = 0.33;
  m.loading = {4.0e6, 1.3};
  m.unloading = {3.82e5, 3.16};
  return m;
}

std::shared_ptr<const Envelope> felt_table(double v_f0) {
  return layer_envelope({pressure_envelope(soft_felt(v_f0)), 6e-3, CrossedCylinders{9e-3, 5e-4},
                         LayerCompression::kColumns});
}

/// A lever with a felt that remembers meets a string.
std::shared_ptr<const Mechanism> hammer(double mass) {
  MechanismDescription d;
  d.name = "hammer_on_string";
  d.gravity = {0.0, 0.0};
  BodyDescription body;
  body.name = "hammer";
  body.coordinate = "hammer.angle";
  body.mass = mass;
  body.position = {0.0, -kReach};
  body.center_of_mass = {0.0, kReach};
  body.inertia = 1e-7;
  d.bodies.push_back(body);
  TorsionSpringDescription spring;
  spring.name = "spring";
  spring.coordinate = "hammer.angle";
  spring.stiffness = 0.1;
  spring.rest_angle = 1e-3 / kReach;  // off the string
  d.springs.push_back(spring);
  SurfaceDescription nose;
  nose.name = "nose";
  nose.body = "hammer";
  nose.point = {0.0, kReach};
  test::add_struck_string(d, nose, FeltMemory{felt_table(0.132), 0.3}, 0.01, 20, true);
  return assemble(d);
}

/// At 1 mm from the string, on its way there.
SimulationState thrown(const std::shared_ptr<const Mechanism>& m, double speed) {
  SimulationState start = Stepper(m, InputKind::kForce, {}).rest().machine;
  start.y[0] = 1e-3 / kReach;
  start.y[1] = -speed / kReach;
  return start;
}

BatchOptions on(std::size_t threads, bool ordered = true) {
  BatchOptions options;
  options.threads = threads;
  options.ordered = ordered;
  return options;
}

/// Strokes of a batch one after the other, at rising speeds.
BatchSource strokes(const std::shared_ptr<const Mechanism>& m, int count) {
  return [m, count, k = 0](BatchStroke& stroke) mutable {
    if (k == count) return false;
    stroke.mechanism = m;
    stroke.options.duration = 15e-3;
    stroke.options.ledger = false;
    stroke.start = thrown(m, 1.0 + 0.25 * k++);
    return true;
  };
}

}  // namespace

TEST_CASE("a batch on threads: strokes share a mechanism, outcomes are those of one thread") {
  const auto m = hammer(9e-3);
  constexpr int count = 10;
  std::vector<RunResult> one(count);
  const auto keep = [](std::vector<RunResult>& out) {
    return [&out](std::size_t i, RunResult&& run, const std::string& failure) {
      CHECK(failure == std::string{});
      out[i] = std::move(run);
      return true;
    };
  };
  REQUIRE(simulate_many(strokes(m, count), keep(one), on(1)) == count);
  REQUIRE(!one[0].end.largest_compression.empty());
  CHECK(one[0].end.largest_compression[0] > 0.0);
  for (const bool ordered : {true, false}) {
    std::vector<RunResult> many(count);
    std::atomic<std::size_t> taken{0};
    const auto take = [&](std::size_t i, RunResult&& run, const std::string&) {
      if (ordered) CHECK(i == taken);
      ++taken;
      many[i] = std::move(run);  // a place of its own: no lock is needed
      return true;
    };
    CHECK(simulate_many(strokes(m, count), take, on(kThreads, ordered)) == count);
    for (int i = 0; i < count; ++i) {
      const auto k = static_cast<std::size_t>(i);
      CHECK(many[k].end.y == one[k].end.y);
      CHECK(many[k].data == one[k].data);
    }
  }
}

TEST_CASE("a batch on threads is stopped: from outside, by its sink, by what a sink throws") {
  const auto m = hammer(9e-3);
  constexpr int count = 1000;
  std::size_t seen = 0;
  const auto stop_at_three = [&](std::size_t, RunResult&&, const std::string&) {
    return ++seen < 3;
  };
  CHECK(simulate_many(strokes(m, count), stop_at_three, on(kThreads)) == 3);
  const auto fail = [](std::size_t, RunResult&&, const std::string&) -> bool {
    throw std::runtime_error("full");
  };
  for (const bool ordered : {true, false}) {
    CHECK_THROWS_WITH(simulate_many(strokes(m, count), fail, on(kThreads, ordered)), "full");
  }
  const auto flag = std::make_shared<std::atomic<bool>>(false);
  std::atomic<int> given{0};
  const auto tell = [&](std::size_t, RunResult&&, const std::string&) {
    ++given;
    given.notify_one();
    return true;
  };
  std::thread other([&] {
    given.wait(0);
    *flag = true;
  });
  BatchOptions stoppable = on(kThreads);
  stoppable.stop = flag;
  CHECK(simulate_many(strokes(m, count), tell, stoppable) < count);
  other.join();
}

TEST_CASE("tables of felt layers that several threads want at once") {
  // Numbers that no other case has: nobody has made the table yet.
  std::vector<std::shared_ptr<const Envelope>> tables(kThreads);
  std::vector<std::thread> threads;
  for (std::size_t i = 0; i < kThreads; ++i) {
    threads.emplace_back([&tables, i] {
      tables[i] = felt_table(0.1301);
      static_cast<void>(felt_table(0.1302 + 1e-4 * static_cast<double>(i)));
    });
  }
  for (auto& t : threads) t.join();
  for (const auto& table : tables) CHECK(table == tables[0]);
}

TEST_CASE("steppers of one mechanism, each on a thread of its own") {
  const auto m = hammer(9e-3);
  const auto run = [&m] {
    Stepper stepper(m, InputKind::kForce, {});
    StepState start = stepper.rest();
    start.machine.y = thrown(m, 1.5).y;
    stepper.set_state(start);
    for (int k = 0; k < 8; ++k) {
      if (stepper.advance(2e-3, {}).status != RunStatus::kDone) return std::vector<double>{};
    }
    return stepper.state().machine.y;
  };
  const std::vector<double> wanted = run();
  std::vector<std::vector<double>> found(kThreads);
  std::vector<std::thread> threads;
  for (auto& one : found) threads.emplace_back([&] { one = run(); });
  for (auto& t : threads) t.join();
  REQUIRE(!wanted.empty());
  for (const auto& one : found) CHECK(one == wanted);
}

TEST_CASE("gradients of segments on threads are those of one thread") {
  constexpr double mass = 9e-3;
  constexpr double shift = 2e-6 * mass;
  const auto m = hammer(mass);
  SensitivityParameter parameter;
  parameter.name = "mass";
  parameter.scale = mass;
  for (const double sign : {1.0, -1.0}) {
    parameter.nodes.push_back({hammer(mass + sign * shift), {}, sign * shift, sign * 0.5 / shift});
  }
  std::vector<SensitivitySegment> segments;
  for (int k = 0; k < 6; ++k) {
    segments.push_back({0.0, 12e-3, thrown(m, 1.0 + 0.2 * k), {}, {}});
  }
  const auto solve = [&](std::size_t threads) {
    SensitivityOptions options;
    options.simulation.rtol = 1e-7;
    options.outputs = {0, 1};
    options.threads = threads;
    return sensitivities(m, {}, {parameter}, segments, options);
  };
  const auto one = solve(1);
  const auto many = solve(kThreads);
  REQUIRE(one.size() == segments.size());
  for (std::size_t i = 0; i < one.size(); ++i) {
    CHECK(one[i].end_state.col(0).norm() > 0.0);
    CHECK(many[i].end_state == one[i].end_state);
    CHECK(many[i].gradient == one[i].gradient);
  }
}

TEST_CASE("loops of the fibers on threads give the numbers of one thread") {
  const Directions one = make_random_directions(300, 7, 3, 1);
  const Directions many = make_random_directions(300, 7, 3, kThreads);
  CHECK(one == many);
  CHECK(estimate_structure(one, 1).f.value == estimate_structure(one, kThreads).f.value);
  CHECK(estimate_tensors(one, 1).f == estimate_tensors(one, kThreads).f);
  const auto law = make_law("van_wyk", {{"k_p", 0.01}, {"E", 3e9}, {"v_f0", 0.1}});
  std::vector<double> v(20000);
  for (std::size_t i = 0; i < v.size(); ++i) v[i] = 0.1 + 1e-5 * static_cast<double>(i);
  std::vector<double> a(v.size());
  std::vector<double> b(v.size());
  evaluate_law(*law, LawQuantity::pressure, v, a, 1);
  evaluate_law(*law, LawQuantity::pressure, v, b, kThreads);
  CHECK(a == b);
}
