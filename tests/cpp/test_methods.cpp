// Methods of a run: what they give must agree within their errors, bit for bit from run to run, and
// without allocation in the right-hand side.
#include <doctest/doctest.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <new>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include "feltmb/core/error.hpp"
#include "feltmb/model/linear_machine.hpp"
#include "feltmb/model/simulation.hpp"
#include "struck_string.hpp"

namespace {
std::atomic<long> allocations{0};
}  // namespace

// Every allocation of this program is counted. GCC does not see that both sides are replaced.
#pragma GCC diagnostic ignored "-Wmismatched-new-delete"
void* operator new(std::size_t size) {
  ++allocations;
  if (void* p = std::malloc(size == 0 ? 1 : size)) return p;
  throw std::bad_alloc();
}
void* operator new(std::size_t size, const std::nothrow_t&) noexcept {
  ++allocations;
  return std::malloc(size == 0 ? 1 : size);
}
void operator delete(void* p, const std::nothrow_t&) noexcept { std::free(p); }
void operator delete(void* p) noexcept { std::free(p); }
void operator delete(void* p, std::size_t) noexcept { std::free(p); }

namespace {

using namespace feltmb;

/// Problem H; `turning` puts the hammer on a lever instead of a slide, so that only the general
/// method serves.
MechanismDescription hammer_on_string(int modes, double damping, bool turning) {
  MechanismDescription d;
  d.name = "hammer_on_string";
  d.gravity = {0.0, 0.0};
  BodyDescription hammer;
  hammer.name = "hammer";
  hammer.coordinate = "hammer.x";
  hammer.mass = 9e-3;
  SurfaceDescription nose;
  nose.name = "nose";
  nose.body = "hammer";
  if (turning) {
    hammer.position = {0.0, -0.13};
    hammer.center_of_mass = {0.0, 0.13};
    hammer.inertia = 1e-7;
    nose.point = {0.0, 0.13};
  } else {
    hammer.joint = JointKind::kPrismatic;
    hammer.axis = {1.0, 0.0};
  }
  d.bodies.push_back(hammer);
  const ExponentialPair law{
      {2.35e4, 1.74e3, -2.41e4}, {2.0e3, 4.52e3, -0.82e3}, 10.0, ExponentialPair::Form::kPrinted};
  test::add_struck_string(d, nose, law, damping, modes, turning);
  return d;
}

struct Curves {
  std::vector<double> x, force;
  RunResult run;
};

Curves simulate_h(const std::shared_ptr<const Mechanism>& m, Method method, double rtol,
                  double speed, bool ledger = false, double gap = 0.0) {
  SimulationOptions o;
  o.duration = 0.05;
  o.output_rate = 20000.0;
  o.rtol = rtol;
  o.ledger = ledger;
  o.events = ledger;
  o.method = method;
  o.peak_contacts = {6};
  SimulationState start;
  start.y.assign(2 + 2 * static_cast<std::size_t>(m->total_modes), 0.0);
  start.y[0] = -gap;
  start.y[1] = speed;
  Curves out;
  out.run = simulate(m, {Profile()}, o, start);
  REQUIRE(out.run.status == RunStatus::kDone);
  for (std::size_t c = 0; c < out.run.names.size(); ++c) {
    const auto column = static_cast<Eigen::Index>(c);
    for (Eigen::Index i = 0; i < out.run.data.rows(); ++i) {
      if (c == 0) out.x.push_back(out.run.data(i, column));
      if (out.run.names[c] == "contact06.force") out.force.push_back(out.run.data(i, column));
    }
  }
  return out;
}

double distance(const std::vector<double>& a, const std::vector<double>& b) {
  REQUIRE(a.size() == b.size());
  double largest = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) largest = std::max(largest, std::fabs(a[i] - b[i]));
  return largest;
}

}  // namespace

TEST_CASE("hammer on string: both methods meet the reference and each other") {
  for (const int modes : {40, 200}) {
    for (const char* damping : {"0.07", "0.0007"}) {
      CAPTURE(modes);
      CAPTURE(damping);
      const auto m = assemble(hammer_on_string(modes, std::stod(damping), false));
      REQUIRE(LinearMachine::of(*m).has_value());
      std::ostringstream path;
      path << FELTMB_REFERENCE "/ref_N" << modes << "_xi" << damping << ".csv";
      std::ifstream in(path.str());
      std::vector<double> x, force;
      std::string line;
      std::getline(in, line);
      while (std::getline(in, line)) {
        double t = 0, a = 0, b = 0, c = 0, f = 0;
        REQUIRE(std::sscanf(line.c_str(), "%lf,%lf,%lf,%lf,%lf", &t, &a, &b, &c, &f) == 5);
        x.push_back(a);
        force.push_back(f);
      }
      const double top = *std::max_element(force.begin(), force.end());
      // Global error of a run from itself: what a tolerance three times tighter changes, and what
      // all tighter ones still would if each changed less than the last by the same ratio, which is
      // not taken to be less than the root of a third. Forces over the peak.
      struct Judged {
        Curves run;
        double error;
      };
      const auto judge = [&](Method method) {
        const Curves runs[] = {simulate_h(m, method, 1e-5, 3.0), simulate_h(m, method, 3e-6, 3.0),
                               simulate_h(m, method, 1e-6, 3.0)};
        CHECK(runs[0].run.method == method);
        const double first = distance(runs[0].force, runs[1].force);
        const double second = distance(runs[1].force, runs[2].force);
        return Judged{runs[0],
                      first / (1.0 - std::clamp(second / first, std::sqrt(1.0 / 3.0), 0.9)) / top};
      };
      const Judged modal = judge(Method::kModal);
      const Judged cvode = judge(Method::kCvode);
      for (const Judged* each : {&modal, &cvode}) {
        const double true_error = distance(each->run.force, force) / top;
        CHECK(true_error < each->error);
        CHECK(each->error < 3.0 * true_error);
      }
      CHECK(distance(modal.run.force, cvode.run.force) / top < modal.error + cvode.error);
      CHECK(distance(modal.run.x, x) < 1e-6);
      // The error that is asked for by name.
      for (const Method method : {Method::kModal, Method::kCvode}) {
        const double rtol = tolerance_for(1e-3, *m, method);
        CHECK(distance(simulate_h(m, method, rtol, 3.0).force, force) < 1e-3 * top);
      }
      CHECK(tolerance_for(1e-3, *m, Method::kModal) == doctest::Approx(3e-5));
      CHECK_THROWS_AS(tolerance_for(0.0, *m, Method::kModal), InvalidParameter);
    }
  }
}

TEST_CASE("a string that is left, and met again: methods agree, the ledger closes") {
  // The lever starts away from the string, strikes it and flies on; slow enough to be caught up
  // with by the string's swing.
  for (const double damping : {0.07, 7e-4}) {
    CAPTURE(damping);
    const auto m = assemble(hammer_on_string(40, damping, true));
    CHECK_FALSE(LinearMachine::of(*m).has_value());
    const double rate = -1.0 / 0.13;
    const Curves modal = simulate_h(m, Method::kModal, 1e-8, rate, true, -2e-3 / 0.13);
    const Curves cvode = simulate_h(m, Method::kCvode, 1e-8, rate, true, -2e-3 / 0.13);
    CHECK(modal.run.strikes >= 1);
    CHECK(cvode.run.strikes == 0);
    const double top = *std::max_element(cvode.force.begin(), cvode.force.end());
    REQUIRE(top > 1.0);
    CHECK(distance(modal.x, cvode.x) < 1e-6);
    CHECK(distance(modal.force, cvode.force) < 1e-4 * top);
    REQUIRE(modal.run.events.size() == cvode.run.events.size());
    for (std::size_t i = 0; i < modal.run.events.size(); ++i) {
      CHECK(modal.run.events[i].time == doctest::Approx(cvode.run.events[i].time).epsilon(1e-6));
    }
    // Energy: kinetic, elastic, stored and string at the start is what is left, and the heat.
    const auto total = [](const Curves& c, Eigen::Index row) {
      double sum = 0.0;
      for (std::size_t i = 0; i < c.run.names.size(); ++i) {
        if (c.run.names[i].rfind("energy.", 0) == 0) {
          sum += c.run.data(row, static_cast<Eigen::Index>(i));
        }
      }
      return sum;
    };
    for (const Curves* c : {&modal, &cvode}) {
      const Eigen::Index last = c->run.data.rows() - 1;
      double heat = 0.0;
      for (std::size_t i = 2; i < c->run.ledger_names.size(); ++i) {
        heat += c->run.ledger(last, static_cast<Eigen::Index>(i));
      }
      CHECK(total(*c, last) + heat == doctest::Approx(total(*c, 0)).epsilon(1e-5));
      CHECK(heat > 0.0);
    }
    // The string's state at every sample is that of the whole system.
    CHECK((modal.run.states - cvode.run.states).cwiseAbs().maxCoeff() < 1e-3);
  }
}

TEST_CASE("runs are the same to the last bit, on any number of threads") {
  const auto m = assemble(hammer_on_string(40, 7e-4, true));
  for (const Method method : {Method::kModal, Method::kCvode}) {
    const Curves first = simulate_h(m, method, 1e-5, -1.0 / 0.13, false, -2e-3 / 0.13);
    std::vector<RunResult> others(4);
    std::vector<std::thread> threads;
    for (auto& other : others) {
      threads.emplace_back([&] {
        SimulationOptions o;
        o.duration = 0.05;
        o.output_rate = 20000.0;
        o.rtol = 1e-5;
        o.ledger = o.events = false;
        o.method = method;
        o.peak_contacts = {6};
        SimulationState start;
        start.y.assign(2 + 2 * static_cast<std::size_t>(m->total_modes), 0.0);
        start.y[0] = 2e-3 / 0.13;
        start.y[1] = -1.0 / 0.13;
        other = simulate(m, {Profile()}, o, start);
      });
    }
    for (auto& t : threads) t.join();
    for (const auto& other : others) {
      CHECK(other.data == first.run.data);
      CHECK(other.end.y == first.run.end.y);
      CHECK(other.peaks[0].force == first.run.peaks[0].force);
    }
  }
}

TEST_CASE("the right-hand side and the event functions allocate nothing") {
  const auto m = assemble(hammer_on_string(40, 0.07, true));
  MechanismSystem system(m, {Profile()}, true, {}, true);
  std::vector<double> y(system.size(), 0.0), rate(y.size());
  y[0] = -1e-3 / 0.13;
  y[1] = -1.0 / 0.13;
  std::vector<double> g(system.n_events());
  const auto all = [&] {
    system.rhs(0.0, y, rate);
    system.events(0.0, y, g);
  };
  all();
  REQUIRE(system.dynamics().contacts()[0].closed);
  const long before = allocations;
  for (int i = 0; i < 10; ++i) all();
  CHECK(allocations == before);
}

TEST_CASE("methods by name") {
  CHECK(method_from_name("modal") == Method::kModal);
  CHECK_THROWS_WITH_AS(method_from_name("fast"),
                       "method = \"fast\", must be \"auto\", \"cvode\" or \"modal\"",
                       InvalidParameter);
  auto d = hammer_on_string(40, 0.07, false);
  d.strings[0].rigid = true;
  SimulationOptions o;
  o.method = Method::kModal;
  CHECK_THROWS_AS(simulate(assemble(d), {Profile()}, o), InvalidParameter);
}
