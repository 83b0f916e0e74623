// Play of a joint, drag and Stribeck friction, options of the exponential pair: formulas written
// again, slopes and energies against difference quotients and quadrature.
#include <doctest/doctest.h>

#include <cmath>
#include <initializer_list>

#include "feltmb/contact/friction.hpp"
#include "feltmb/contact/law.hpp"
#include "feltmb/core/error.hpp"
#include "feltmb/planar/play.hpp"
#include "quadrature.hpp"
#include "table_a12.hpp"

using namespace feltmb;

TEST_CASE("play: a pin under the load F stands at w F / (F + R)") {
  const Play play{5e-5, 0.2};
  for (const double load : {-5.0, -0.3, 1e-4, 0.2, 3.0, 15.0}) {
    const double x = std::copysign(5e-5 * std::fabs(load) / (std::fabs(load) + 0.2), load);
    CHECK(play.at(x).force == doctest::Approx(load).epsilon(1e-9));
  }
}

TEST_CASE("play: force is the slope of the energy, stiffness the slope of the force") {
  const Play play{5e-5, 0.2};
  for (const double x : {-1.2e-4, -5e-5, -4.9e-5, -2e-5, 1e-7, 3e-5, 4.94e-5, 4.96e-5, 8e-5}) {
    const double h = 1e-10;
    const auto up = play.at(x + h);
    const auto down = play.at(x - h);
    CHECK((up.energy - down.energy) / (2.0 * h) == doctest::Approx(play.at(x).force).epsilon(1e-5));
    CHECK((up.force - down.force) / (2.0 * h) == doctest::Approx(play.at(x).slope).epsilon(1e-5));
  }
  CHECK(play.at(0.0).force == 0.0);
  CHECK(Play{}.at(1.0).force == 0.0);
  const double work = quadrature([&](double x) { return play.at(x).force; }, 0.0, 4e-5, 400);
  CHECK(play.at(4e-5).energy == doctest::Approx(work).epsilon(1e-6));
}

TEST_CASE("viscous, quadratic and Stribeck friction") {
  Friction f = coulomb(2.5e-3, 0.3, 1.0, 1e-4);
  f.viscous = 3e-4;
  f.quadratic = 2e-5;
  f.stribeck = 1e-3;
  f.stribeck_speed = 0.2;
  const Friction base = coulomb(2.5e-3, 0.3, 1.0, 1e-4);
  for (const double v : {-12.0, -0.3, -1e-3, 0.0, 2e-5, 1e-4, 0.05, 0.4, 7.0}) {
    const double expected = evaluate(base, v).value + 3e-4 * v + 2e-5 * v * std::fabs(v) +
                            1e-3 * std::exp(-v * v / 0.04) * std::tanh(v / 1e-4);
    CHECK(evaluate(f, v).value == doctest::Approx(expected).epsilon(1e-13));
    CHECK(evaluate(f, -v).value == -evaluate(f, v).value);
    const double h = 1e-4 * std::fmax(1e-4, std::fabs(v));
    const double slope = (evaluate(f, v + h).value - evaluate(f, v - h).value) / (2.0 * h);
    CHECK(evaluate(f, v).slope == doctest::Approx(slope).epsilon(1e-5));
  }
  // Zero terms are not there, to the last bit.
  Friction same = base;
  same.viscous = same.quadratic = same.stribeck = 0.0;
  same.stribeck_speed = 7.0;
  CHECK(evaluate(same, 0.37).value == evaluate(base, 0.37).value);
}

namespace {

ExponentialPair pair_of(std::size_t row) {
  const auto& k = table_a12::kRows[row];
  return {k.loading, k.unloading, 100.0, ExponentialPair::Form::kGuarded};
}

}  // namespace

TEST_CASE("hysteresis factor of a pair scales the loop") {
  for (const std::size_t row : {0U, 1U, 2U, 6U}) {
    const auto plain = ContactLaw(pair_of(row));
    for (const double h : {0.0, 0.5, 1.0, 1.3}) {
      auto p = pair_of(row);
      p.hysteresis = h;
      const ContactLaw law(p);
      for (const double e : {1e-4, 4e-4, 8e-4}) {
        const double up = plain.evaluate(e, 0.1).force;
        const double down = plain.evaluate(e, -10.0).force;
        CHECK(law.evaluate(e, 0.1).force == up);
        const double expected = std::fmax(0.0, up - h * (up - down));
        CHECK(law.evaluate(e, -10.0).force == doctest::Approx(expected).epsilon(1e-12));
        if (h == 1.0) CHECK(law.evaluate(e, -3e-3).force == plain.evaluate(e, -3e-3).force);
      }
    }
  }
}

TEST_CASE("rate term of a pair: relaxation after a step, exact derivatives, energy") {
  auto p = pair_of(2);
  p.rate_amplitude = 0.25;
  p.rate_time = 0.03;
  const ContactLaw law(p);
  const ContactLaw plain(pair_of(2));
  REQUIRE(law.n_states() == 1);
  const double e = 6e-4;
  const double full = plain.evaluate(e, 0.0).force;
  double r = 0.0;
  law.relax(e, &r);
  CHECK(r == full);
  CHECK(law.evaluate(e, 0.0, {&r, 0.0}).force == full);
  CHECK(law.static_force(e).force == full);
  // A step from rest: F = F_L (1 + A exp(-t / tau)).
  for (const double t : {0.0, 0.01, 0.1}) {
    r = full * (1.0 - std::exp(-t / 0.03));
    LawStates s;
    const double force = law.evaluate(e, 0.0, {&r, 0.0}, &s).force;
    CHECK(force == doctest::Approx(full * (1.0 + 0.25 * std::exp(-t / 0.03))).epsilon(1e-12));
    CHECK(s.rate[0] == doctest::Approx(full * std::exp(-t / 0.03) / 0.03).epsilon(1e-12));
  }
  r = 0.4 * full;
  for (const double rate : {-2e-3, -1e-4, 5e-3}) {
    LawStates s, up, down;
    const auto v = law.evaluate(e, rate, {&r, 0.0}, &s);
    const double h = 1e-9;
    const auto a = law.evaluate(e + h, rate, {&r, 0.0}, &up);
    const auto b = law.evaluate(e - h, rate, {&r, 0.0}, &down);
    CHECK(v.d_compression == doctest::Approx((a.force - b.force) / (2.0 * h)).epsilon(1e-6));
    CHECK(s.rate_by_compression[0] ==
          doctest::Approx((up.rate[0] - down.rate[0]) / (2.0 * h)).epsilon(1e-6));
    CHECK(s.force[0] == -0.25);
    CHECK(s.rate_by_state[0][0] == doctest::Approx(-1.0 / 0.03));
    // Power in = rate of the stored energy + what is lost.
    const double stored = plain.evaluate(e, 0.0).force * rate;
    CHECK(law.dissipated_power(e, rate, {&r, 0.0}) ==
          doctest::Approx(v.force * rate - stored).epsilon(1e-12));
  }
  // Open: no force, the state fades.
  LawStates s;
  CHECK(law.evaluate(-1e-4, 0.0, {&r, 0.0}, &s).force == 0.0);
  CHECK(s.rate[0] == doctest::Approx(-r / 0.03));
  p.rate_time = 0.0;
  CHECK_THROWS_AS(ContactLaw{p}, InvalidParameter);
}
