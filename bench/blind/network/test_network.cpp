#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "feltmb/core/error.hpp"
#include "feltmb/numeric/floor_within.hpp"
#include "network.hpp"

namespace {

using namespace feltmb::lumped;

// Parameters: mass, stiffness, damping, contact stiffness, exponent, loss, gap, gain, delay, tau,
// coulomb, sliding speed.
const std::vector<double> values{0.1,  200.0, 0.3,  5e4,  1.6,  0.2,
                                 1e-3, 1e-5,  2e-4, 5e-3, 0.05, 0.02};

Sum p(int i, double factor = 1.0) { return {{i, factor}}; }

/// A mass on a spring with friction that strikes a felt with a lag, seen by a late sensor.
Network network(int substeps = 4) {
  Network n;
  n.masses = {p(0)};
  const Travel x{{{0, 1.0}}, {}, 0.0, {}};
  const Travel felt{{{0, 1.0}}, {{0, -1.0}}, 0.0, p(6, -1.0)};
  n.elements = {{Kind::spring, x, {}, p(1), p(2), {}, {}},
                {Kind::contact, felt, {}, p(3), p(4), p(5), {}},
                {Kind::friction, x, {}, {}, p(10), p(11), {}},
                {Kind::drive, {{{0, 1.0}}, {}, 1.0, {}}, {}, {}, {}, {}, {}}};
  n.hidden = {{false, {1}, p(7), p(9), {}}};
  n.sensors = {{x, {}, {}, p(8), {}, -1}};
  n.parameters = static_cast<int>(values.size());
  n.sample_time = 5e-4;
  n.substeps = substeps;
  return n;
}

std::vector<double> input() {
  std::vector<double> u;
  for (int i = 0; i < 200; ++i) {
    u.push_back(2.0 * std::sin(0.05 * i));
  }
  return u;
}

Batch run(const Network& n, const std::vector<double>& parameters, std::vector<double> start,
          std::vector<int> wanted = {}, std::vector<int> states = {}) {
  const std::vector<double> u = input();
  const std::vector<std::span<const double>> inputs{u};
  const std::vector<Segment> segments{{0, 10, 120, 0}};
  Request q;
  q.parameters = parameters;
  q.inputs = inputs;
  q.segments = segments;
  q.starts = start;
  q.wanted = wanted;
  q.wanted_states = states;
  return simulate(n, q);
}

}  // namespace

TEST_CASE("lumped network: derivatives are those of the result") {
  const Network n = network();
  std::vector<int> wanted;
  for (int i = 0; i < static_cast<int>(values.size()); ++i) {
    wanted.push_back(i);
  }
  const std::vector<double> start{-1e-4, 0.02, 1e-6};
  const Batch base = run(n, values, start, wanted, {0, 1, 2});
  REQUIRE(base.columns == 15);
  for (int column = 0; column < base.columns; ++column) {
    auto parameters = values;
    auto x = start;
    double& moved = column < 12 ? parameters[static_cast<std::size_t>(column)]
                                : x[static_cast<std::size_t>(column - 12)];
    const std::array<double, 3> scale{1e-3, 0.1, 1e-4};
    const double step = 1e-5 * (column < 12 ? moved : scale[static_cast<std::size_t>(column - 12)]);
    const double before = moved;
    moved = before + step;
    const Batch up = run(n, parameters, x);
    moved = before - step;
    const Batch down = run(n, parameters, x);
    double error = 0.0;
    double size = 0.0;
    for (std::size_t i = 0; i < up.outputs.size(); ++i) {
      const double slope = (up.outputs[i] - down.outputs[i]) / (2.0 * step);
      const double exact = base.d_outputs[i * 15 + static_cast<std::size_t>(column)];
      error += (slope - exact) * (slope - exact);
      size += exact * exact;
    }
    CAPTURE(column);
    CHECK(size > 0.0);
    CHECK(std::sqrt(error / size) < 2e-4);
    for (std::size_t i = 0; i < 3; ++i) {
      const double slope = (up.ends[i] - down.ends[i]) / (2.0 * step);
      const double exact = base.d_ends[i * 15 + static_cast<std::size_t>(column)];
      CHECK(slope == doctest::Approx(exact).epsilon(1e-3).scale(std::abs(exact) + 1e-9));
    }
  }
}

namespace {

/// Two masses with every kind of element, hidden state, sensor and correction; every number a
/// parameter of its own but the first stiffness, which stands in two places.
Network complete() {
  Network n;
  int next = 0;
  const auto one = [&] { return p(next++); };
  n.masses = {one(), one()};
  const Sum shared = one();
  const Travel between{{{0, 1.0}, {1, -0.8}}, {{0, -1.0}, {1, 0.5}}, 0.0, one()};
  const Travel second{{{1, 1.0}}, {}, 0.0, {}};
  const Travel pushed{{{0, 1.0}}, {}, -0.3, one()};
  const Gate gate{{{{1, -1.0}}, {{1, 1.0}}, 0.0, one()}, one()};
  n.elements = {{Kind::spring, pushed, {}, shared, one(), one(), {}},
                {Kind::contact, between, {gate}, one(), one(), one(), {}},
                {Kind::friction, second, {}, one(), one(), one(), one()},
                {Kind::spring, second, {}, {{shared[0].index, 0.5}}, {}, {}, {}},
                {Kind::drive, {{{1, 1.0}}, {}, 1.0, {}}, {}, one(), {}, {}, {}}};
  n.hidden = {{false, {1}, one(), one(), {}}, {true, {1, 0}, one(), one(), one()}};
  n.input = {one(), one(), one()};
  n.sensors = {{{{{0, 1.0}}, {{0, 0.4}, {1, -1.0}}, 0.2, one()}, one(), one(), one(), one(), 1},
               {second, {}, {}, {}, {}, -1}};
  n.parameters = next;
  n.sample_time = 5e-4;
  n.substeps = 4;
  return n;
}

std::vector<double> complete_values() {
  return {0.1,  0.06, 250.0, 2e-4,  -1e-3, 2e-3, 6e-4, 0.4,  3e6,  4e4,
          1.7,  0.3,  0.1,   0.05,  0.02,  0.3,  -0.1, 1e-5, 4e-3, 2e-6,
          400., 0.05, 0.02,  -0.03, 3e-4,  1e-5, 0.03, 1e-6, 3e-4, 2e-7};
}

}  // namespace

TEST_CASE("lumped network: derivatives by every number of every kind of part") {
  const Network n = complete();
  n.check();
  const auto numbers = complete_values();
  REQUIRE(static_cast<int>(numbers.size()) == n.parameters);
  const std::vector<double> start{2e-4, 4e-4, 0.05, -0.02, 1e-6, -2e-6, 1e-3};
  const std::vector<double> scale{1e-3, 1e-3, 0.1, 0.1, 1e-5, 1e-5, 1e-2};
  // A delay of the sensor within the segment, beyond its start and beyond its end.
  for (const double delay : {3e-4, 9e-3, -2e-3}) {
    auto base = numbers;
    base[28] = delay;
    std::vector<int> wanted;
    std::vector<int> states;
    for (int i = 0; i < n.parameters; ++i) {
      wanted.push_back(i);
    }
    for (int i = 0; i < n.states(); ++i) {
      states.push_back(i);
    }
    const Batch exact = run(n, base, start, wanted, states);
    const auto columns = static_cast<std::size_t>(exact.columns);
    for (std::size_t column = 0; column < columns; ++column) {
      auto parameters = base;
      auto x = start;
      const bool state = column >= base.size();
      double& moved = state ? x[column - base.size()] : parameters[column];
      const double step = 1e-3 * (state ? scale[column - base.size()] : std::abs(moved));
      const double before = moved;
      // Differences of fourth order: steps of one and two.
      const auto differ = [&](double h) {
        moved = before + h;
        Batch up = run(n, parameters, x);
        moved = before - h;
        const Batch down = run(n, parameters, x);
        for (std::size_t i = 0; i < up.outputs.size(); ++i) {
          up.outputs[i] = (up.outputs[i] - down.outputs[i]) / (2.0 * h);
        }
        for (std::size_t i = 0; i < up.ends.size(); ++i) {
          up.ends[i] = (up.ends[i] - down.ends[i]) / (2.0 * h);
        }
        return up;
      };
      const Batch near = differ(step);
      const Batch far = differ(2.0 * step);
      const auto compare = [&](const std::vector<double>& a, const std::vector<double>& b,
                               const std::vector<double>& d) {
        double error = 0.0;
        double size = 0.0;
        for (std::size_t i = 0; i < a.size(); ++i) {
          const double slope = (4.0 * a[i] - b[i]) / 3.0;
          error += std::pow(slope - d[i * columns + column], 2);
          size += std::pow(slope, 2);
        }
        CAPTURE(delay);
        CAPTURE(column);
        CHECK(size > 0.0);
        // Where the exponent of the felt is not whole its touch is smooth to the first order only.
        CHECK(std::sqrt(error / size) < 1e-4);
      };
      compare(near.outputs, far.outputs, exact.d_outputs);
      if (!(column >= 25 && column <= 29)) {  // numbers of a sensor move no state
        compare(near.ends, far.ends, exact.d_ends);
      }
    }
  }
}

TEST_CASE("lumped network: rows of parameters do not remember each other") {
  const Network n = complete();
  auto with = complete_values();
  auto without = with;
  without[17] = 0.0;  // gain of the lag
  without[19] = 0.0;  // gain of the mode
  const std::vector<double> u = input();
  const std::vector<std::span<const double>> inputs{u};
  const std::vector<double> zero(7, 0.0);
  const std::vector<int> wanted{2, 9, 20};
  const auto simulated = [&](const std::vector<std::vector<double>>& rows) {
    Request q;
    std::vector<double> all;
    std::vector<double> starts;
    std::vector<Segment> segments;
    for (const auto& r : rows) {
      segments.push_back({0, 10, 60, static_cast<int>(segments.size())});
      all.insert(all.end(), r.begin(), r.end());
      starts.insert(starts.end(), zero.begin(), zero.end());
    }
    q.parameters = all;
    q.inputs = inputs;
    q.segments = segments;
    q.starts = starts;
    q.wanted = wanted;
    return simulate(n, q);
  };
  const Batch both = simulated({with, without});
  const Batch first = simulated({with});
  const Batch second = simulated({without});
  auto joined = first.outputs;
  joined.insert(joined.end(), second.outputs.begin(), second.outputs.end());
  CHECK(both.outputs == joined);
  auto slopes = first.d_outputs;
  slopes.insert(slopes.end(), second.d_outputs.begin(), second.d_outputs.end());
  CHECK(both.d_outputs == slopes);
}

TEST_CASE("lumped network: any width of the passes gives the same bits") {
  const Network n = network();
  const std::vector<double> start{-1e-4, 0.02, 0.0};
  const Batch plain = run(n, values, start);
  const Batch narrow = run(n, values, start, {3});
  const Batch wide = run(n, values, start, {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11}, {0, 1, 2});
  CHECK(plain.outputs == narrow.outputs);
  CHECK(plain.outputs == wide.outputs);
  for (std::size_t i = 0; i < plain.outputs.size(); ++i) {
    CHECK(narrow.d_outputs[i] == wide.d_outputs[i * 15 + 3]);
  }
}

TEST_CASE("lumped network: a damped spring follows its closed form with the fourth order") {
  double before = 0.0;
  for (const int substeps : {1, 2, 4}) {
    Network n = network(substeps);
    n.elements.resize(1);
    n.hidden.clear();
    n.sensors[0].delay.clear();
    const Batch b = run(n, values, {1e-3, 0.0});
    const double rate = values[2] / (2.0 * values[0]);
    const double omega = std::sqrt(values[1] / values[0] - rate * rate);
    double error = 0.0;
    for (int i = 0; i <= 120; ++i) {
      const double t = 5e-4 * i;
      const double x =
          1e-3 * std::exp(-rate * t) * (std::cos(omega * t) + rate / omega * std::sin(omega * t));
      error = std::max(error, std::abs(x - b.outputs[static_cast<std::size_t>(i)]));
    }
    CHECK(error < 1e-11);
    if (before > 0.0) {
      CHECK(before / error == doctest::Approx(16.0).epsilon(0.05));
    }
    before = error;
  }
}

TEST_CASE("lumped network: windows in turn are the whole") {
  const Network n = network();
  const std::vector<double> u = input();
  const std::vector<std::span<const double>> inputs{u};
  const std::vector<double> start{-1e-4, 0.02, 0.0};
  const Batch whole = run(n, values, start);
  std::vector<double> x = start;
  std::size_t at = 0;
  for (int w = 0; w < 4; ++w) {
    const std::vector<Segment> segments{{0, 10 + 30 * w, 30, 0}};
    Request q;
    q.parameters = values;
    q.inputs = inputs;
    q.segments = segments;
    q.starts = x;
    const Batch part = simulate(n, q);
    x = part.ends;
    for (std::size_t i = 1; i <= 30; ++i) {  // the first is the end of the window before
      CHECK(part.outputs[i] == doctest::Approx(whole.outputs[at + i]).epsilon(1e-4).scale(1e-4));
    }
    at += 30;
  }
  for (std::size_t i = 0; i < 3; ++i) {
    CHECK(x[i] == doctest::Approx(whole.ends[i]).epsilon(1e-9));
  }
}

TEST_CASE("lumped network: bad descriptions are refused") {
  Network n = network();
  n.elements[1].a = p(99);
  CHECK_THROWS_AS(n.check(), feltmb::InvalidParameter);
  CHECK_THROWS_AS(run(network(), values, {0.0}), feltmb::InvalidParameter);
}

TEST_CASE("whole numbers within bounds, whatever the real number is") {
  const double infinity = std::numeric_limits<double>::infinity();
  for (const double x : {-infinity, -1e300, -1e10, -3.0, -2.5}) {
    CHECK(feltmb::floor_within(x, -2, 5) == -2);
  }
  for (const double x : {infinity, 1e300, 1e10, 6.5, 5.0}) {
    CHECK(feltmb::floor_within(x, -2, 5) == 5);
  }
  CHECK(feltmb::floor_within(std::numeric_limits<double>::quiet_NaN(), -2, 5) == -2);
  CHECK(feltmb::floor_within(-0.5, -2, 5) == -1);
  CHECK(feltmb::floor_within(3.999, -2, 5) == 3);
  CHECK(feltmb::floor_within<std::size_t>(-1.0, 0, 5) == 0);
}

TEST_CASE("lumped network: a delay beyond every index looks past the ends") {
  Network n = network();
  n.elements.resize(1);
  n.hidden.clear();
  auto parameters = values;
  // Ahead of the end the sensor follows a parabola: a hundred times as far is 1e4 times as much.
  parameters[8] = -1e5;
  const double far = run(n, parameters, {1e-3, 0.0}).outputs[120];
  parameters[8] = -1e7;
  CHECK(run(n, parameters, {1e-3, 0.0}).outputs[120] == doctest::Approx(1e4 * far).epsilon(1e-3));

  // A record that is late by more than it lasts says nothing but its last sample.
  Network driven = network();
  driven.elements = {driven.elements[0], driven.elements[3]};
  driven.hidden.clear();
  driven.sensors[0].delay.clear();
  driven.input.delay = p(8);
  parameters[8] = 1e3;
  const Batch late = run(driven, parameters, {0.0, 0.0});
  parameters[8] = 1e30;
  CHECK(run(driven, parameters, {0.0, 0.0}).outputs == late.outputs);
}

TEST_CASE("lumped network: the record of the input is a reading of what acts") {
  // y = (1 + gain) a(t - delay) + offset, for the input as for an output: a sensor in the path of
  // the drive and a sensor of the drive with the same errors undo each other.
  Network n;
  n.masses = {p(0)};
  const Travel x{{{0, 1.0}}, {}, 0.0, {}};
  n.elements = {{Kind::spring, x, {}, p(1), p(2), {}, {}},
                {Kind::drive, {{{0, 1.0}}, {}, 1.0, {}}, {}, {}, {}, {}, {}}};
  n.sensors = {{x, {}, {}, {}, {}, -1}};
  n.input = {p(3), p(4), p(5)};
  n.parameters = 6;
  n.sample_time = 5e-4;
  n.substeps = 8;
  const double gain = 0.02;
  const double offset = 0.3;
  const double delay = 1.5e-3;
  const auto acts = [](double t) { return 2.0 * std::sin(100.0 * t); };
  std::vector<double> truth;
  std::vector<double> reading;
  for (int i = 0; i < 200; ++i) {
    truth.push_back(acts(i * n.sample_time));
    reading.push_back((1.0 + gain) * acts(i * n.sample_time - delay) + offset);
  }
  const std::vector<Segment> segments{{0, 10, 120, 0}};
  const std::vector<double> start{0.0, 0.0};
  const auto answer = [&](const std::vector<double>& u, std::vector<double> parameters) {
    const std::vector<std::span<const double>> inputs{u};
    Request q;
    q.parameters = parameters;
    q.inputs = inputs;
    q.segments = segments;
    q.starts = start;
    return simulate(n, q).outputs;
  };
  const auto expected = answer(truth, {0.1, 200.0, 0.3, 0.0, 0.0, 0.0});
  const auto found = answer(reading, {0.1, 200.0, 0.3, gain, offset, delay});
  double largest = 0.0;
  for (const double y : expected) largest = std::max(largest, std::abs(y));
  REQUIRE(largest > 1e-3);
  for (std::size_t i = 0; i < expected.size(); ++i) {
    CHECK(std::abs(found[i] - expected[i]) < 1e-4 * largest);
  }
}
