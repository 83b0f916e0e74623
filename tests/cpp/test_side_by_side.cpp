// Many contacts side by side against each on its own.
#include <doctest/doctest.h>

#include <bit>
#include <cmath>
#include <cstdint>
#include <memory>
#include <vector>

#include "feltmb/contact/side_by_side.hpp"
#include "feltmb/numeric/elementary.hpp"

using namespace feltmb;

namespace {

bool same_bits(double a, double b) {
  return std::bit_cast<std::uint64_t>(a) == std::bit_cast<std::uint64_t>(b);
}

}  // namespace

TEST_CASE("tanh without branches is tanh with them") {
  for (const double x : {0.0, 1e-300, 1e-9, 0.3, 1.0, 7.5, 19.999999, 20.0, 1e3, HUGE_VAL}) {
    for (const double sign : {1.0, -1.0}) {
      const HyperbolicTangent a = fast_tanh(sign * x);
      const HyperbolicTangent b = fast_tanh_flat(sign * x);
      CHECK(std::signbit(a.value) == std::signbit(b.value));
      CHECK(std::fabs(a.value - b.value) <= 1e-15 * std::fabs(a.value));
      CHECK(std::fabs(a.slope - b.slope) <= 1e-15 * a.slope);
    }
  }
  CHECK(std::isnan(fast_tanh_flat(std::nan("")).value));
  CHECK(fast_tanh_flat(std::nan("")).slope == 0.0);
}

TEST_CASE("frictions side by side have the bits of each on its own") {
  std::vector<Friction> all;
  for (int i = 0; i < 11; ++i) {
    Friction f;
    f.amplitude = i == 3 ? 0.0 : 0.1 + 0.07 * i;
    f.b1 = i % 3 == 0 ? 0.0 : 0.4 * i;
    f.b2 = i % 4 == 0 ? 0.0 : 0.2 * i;
    f.threshold_speed = 1e-3 * (1 + i);
    if (i == 5) f.viscous = 0.3;  // has no lane
    all.push_back(f);
  }
  FrictionLanes lanes(all);
  for (const std::vector<std::size_t>& which :
       {std::vector<std::size_t>{}, std::vector<std::size_t>{4},
        std::vector<std::size_t>{0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10},
        std::vector<std::size_t>{10, 2, 7, 5, 1}}) {
    lanes.choose(which);
    for (int round = 0; round < 200; ++round) {
      for (std::size_t i = 0; i < which.size(); ++i) {
        lanes.speed[i] = std::sinh(0.07 * (round - 100)) * 1e-3 * static_cast<double>(1 + i);
      }
      lanes.evaluate();
      for (std::size_t i = 0; i < which.size(); ++i) {
        const Friction& f = all[which[i]];
        if (!FrictionLanes::takes(f)) {
          CHECK(lanes.value[i] == 0.0);
          continue;
        }
        const FrictionValue expected = evaluate(f, lanes.speed[i]);
        // A friction of amplitude zero may have a zero of either sign.
        REQUIRE((f.amplitude == 0.0 ? lanes.value[i] == 0.0
                                    : same_bits(lanes.value[i], expected.value)));
        REQUIRE(same_bits(lanes.slope[i], expected.slope));
      }
    }
  }
}

TEST_CASE("pairs side by side have the bits of each on its own") {
  std::vector<ContactLaw> laws;
  for (int i = 0; i < 9; ++i) {
    ExponentialPair pair;
    pair.loading = {900.0 + 200.0 * i, 500.0 + 400.0 * i, i % 2 == 0 ? 50.0 : -1500.0};
    // Crossing, too high and negative unloading curves among them.
    pair.unloading = {600.0 + 150.0 * i, 520.0 + 420.0 * i, i % 3 == 0 ? -900.0 : 20.0};
    pair.alpha = 10.0 * (1 + i);
    pair.form = i < 5 ? ExponentialPair::Form::kGuarded : ExponentialPair::Form::kPrinted;
    pair.hysteresis = i == 2 || i == 6 ? 1.4 : 1.0;
    laws.emplace_back(pair);
  }
  laws.emplace_back(HuntCrossley{1e5, 1.5, 0.1});  // has no lane
  PairLanes lanes;
  for (const ContactLaw& law : laws) lanes.add(law);
  lanes.finish();
  for (const std::vector<std::size_t>& which :
       {std::vector<std::size_t>{9}, std::vector<std::size_t>{0, 1, 2, 3, 4, 5, 6, 7, 8},
        std::vector<std::size_t>{8, 9, 2}}) {
    lanes.choose(which);
    for (int round = 0; round < 400; ++round) {
      for (std::size_t i = 0; i < which.size(); ++i) {
        lanes.compression[i] = 1e-5 * (1 + round % 37) * static_cast<double>(1 + i % 4);
        lanes.rate[i] = 0.004 * (round % 101 - 50);
      }
      lanes.evaluate();
      for (std::size_t i = 0; i < which.size(); ++i) {
        if (lanes.compression[i] >= lanes.reach(i)) {
          continue;
        }
        const LawValue a = lanes.value(i);
        const LawValue b = laws[which[i]].evaluate(lanes.compression[i], lanes.rate[i]);
        REQUIRE(same_bits(a.force, b.force));
        REQUIRE(same_bits(a.d_compression, b.d_compression));
        REQUIRE(same_bits(a.d_rate, b.d_rate));
      }
    }
    for (std::size_t i = 0; i < which.size(); ++i)
      CHECK((lanes.reach(i) == 0.0) == (which[i] == 9));
  }
}

TEST_CASE("felts with memory side by side have the bits of each on its own") {
  std::vector<std::shared_ptr<const Envelope>> envelopes{
      Envelope::from_curves({5520.0, 1580.0, -600.0}, {190.0, 5040.0, 900.0}),
      Envelope::from_table({0.0, 1e-4, 3e-4, 7e-4, 1e-3}, {0.0, 0.4, 2.0, 9.0, 20.0},
                           {0.0, 0.1, 0.7, 6.0, 20.0})};
  EnvelopeShape shape;
  shape.loading = [](double e) { return 3e6 * e * e; };
  shape.ratio = [](double x, double largest) { return std::pow(x, 0.3 + 200.0 * largest); };
  shape.closing = 1e-3;
  shape.reach = 2e-3;
  shape.rows = 9;
  envelopes.push_back(Envelope::from_shape(shape));
  std::vector<ContactLaw> laws;
  for (std::size_t i = 0; i < 8; ++i) {
    FeltMemory felt;
    felt.envelope = envelopes[i % 3];
    felt.kappa = 0.1 + 0.05 * static_cast<double>(i);
    if (i == 5) felt.rate_amplitude = felt.rate_time = 1e-3;  // has no lane
    laws.emplace_back(felt);
  }
  laws.emplace_back(HuntCrossley{1e5, 1.5, 0.1});
  MemoryLanes lanes;
  for (const ContactLaw& law : laws) {
    CHECK(MemoryLanes::takes(law) == (law.has_memory() && law.n_states() == 1));
    lanes.add(law);
  }
  lanes.finish();
  for (const std::vector<std::size_t>& which :
       {std::vector<std::size_t>{}, std::vector<std::size_t>{0}, std::vector<std::size_t>{1, 2},
        std::vector<std::size_t>{0, 1, 2, 3, 4, 6, 7}, std::vector<std::size_t>{2, 0, 3}}) {
    lanes.choose(which);
    for (int round = 0; round < 600; ++round) {
      // Virgin, in the first cycle and in deeper ones.
      const double largest = 1e-4 * (round / 100);
      std::vector<CycleStart> cycles(which.size());
      for (std::size_t i = 0; i < which.size(); ++i) {
        laws[which[i]].keep_cycle(largest, cycles[i]);
        if (lanes.largest(i) != largest) lanes.begin(i, cycles[i]);
        lanes.compression[i] = std::pow(10.0, -9.0 + 0.061 * (round % 100)) * (1.0 + 0.1 * i);
        if (round % 100 == 99) lanes.compression[i] = largest > 0.0 ? largest : 1e-4;
        lanes.rate[i] = 0.004 * (round % 101 - 50);
        lanes.state[i] = 0.01 * (round % 102);
      }
      lanes.evaluate();
      for (std::size_t i = 0; i < which.size(); ++i) {
        const double e = lanes.compression[i];
        if (e >= lanes.reach(i)) continue;
        LawStates a, b;
        lanes.states(i, a);
        const LawMemory memory{&lanes.state[i], largest, &cycles[i]};
        const LawValue expected = laws[which[i]].evaluate(e, lanes.rate[i], memory, &b);
        const LawValue value = lanes.value(i);
        REQUIRE(same_bits(value.force, expected.force));
        REQUIRE(same_bits(value.d_compression, expected.d_compression));
        REQUIRE(value.d_rate == 0.0);
        REQUIRE(same_bits(a.force[0], b.force[0]));
        REQUIRE(same_bits(a.rate[0], b.rate[0]));
        REQUIRE(same_bits(a.rate_by_compression[0], b.rate_by_compression[0]));
        REQUIRE(same_bits(a.rate_by_rate[0], b.rate_by_rate[0]));
        REQUIRE(same_bits(a.rate_by_state[0][0], b.rate_by_state[0][0]));
      }
    }
    for (std::size_t i = 0; i < which.size(); ++i) CHECK(lanes.reach(i) >= 1e-3);
  }
}
