// Exact modal stepper: closed forms of one mode, energy, convergence, the published reference of a
// hammer on a string, two contacts against a textbook integrator.
#include <doctest/doctest.h>

#include <cmath>
#include <fstream>
#include <functional>
#include <numbers>
#include <string>
#include <vector>

#include "feltmb/contact/law.hpp"
#include "feltmb/core/error.hpp"
#include "feltmb/modal/contact_stepper.hpp"
#include "feltmb/modal/response.hpp"
#include "feltmb/modal/string.hpp"

namespace {

using feltmb::modal::ModalContact;
using feltmb::modal::ModalContactStepper;
using feltmb::modal::ModalDrive;
using feltmb::modal::ModalResponse;
using feltmb::modal::ModalStepperOptions;
using feltmb::modal::ScalarForce;
using feltmb::modal::StepResponse;

struct Law : ScalarForce {
  feltmb::ContactLaw law;
  explicit Law(const feltmb::LawParameters& p) : law(p) {}
  Value trial(int, double, double compression, double rate) override {
    const feltmb::LawValue v = law.evaluate(compression, rate);
    return {v.force, v.d_compression, v.d_rate};
  }
};

/// Problem H: modes of the string, then the hammer as a mode without stiffness.
struct Strike {
  std::vector<double> stiffness, damping, gradient;
  double root_mass = std::sqrt(9e-3);
  Law law{feltmb::ExponentialPair{{2.35e4, 1.74e3, -2.41e4},
                                  {2.0e3, 4.52e3, -0.82e3},
                                  10.0,
                                  feltmb::ExponentialPair::Form::kPrinted}};

  Strike(int modes, double damping_ratio) {
    const feltmb::ModalString s({0.99e-3, 654.0, 0.6315, 5.98e-3, 2e11, damping_ratio, modes});
    stiffness.assign(s.stiffness().begin(), s.stiffness().end());
    damping.assign(s.damping().begin(), s.damping().end());
    gradient.resize(stiffness.size());
    std::vector<double> slope(stiffness.size());
    s.shapes(0.6315 / 8.0, gradient, slope);
    for (double& g : gradient) g = -g;
    stiffness.push_back(0.0);
    damping.push_back(0.0);
    gradient.push_back(1.0 / root_mass);
  }

  ModalContactStepper stepper(double tolerance, ScalarForce& force) {
    ModalStepperOptions o;
    o.tolerance = tolerance;
    ModalContactStepper out(stiffness, damping, {{gradient, 0.0, &force}}, {}, o);
    const std::vector<double> x(stiffness.size(), 0.0);
    std::vector<double> v(stiffness.size(), 0.0);
    v.back() = 3.0 * root_mass;
    out.start(0.0, x, v);
    return out;
  }
};

}  // namespace

TEST_CASE("response of a mode: undamped, damped, overdamped and rigid against closed forms") {
  const double k = 4e6;  // 2000 rad/s
  const double strong = 2.0 * 1.25 * 2000.0;
  const ModalResponse r({k, k, k, 0.0, 0.0}, {0.0, 2.0 * 0.1 * 2000.0, strong, 0.0, 300.0}, 1.0);
  for (const double h : {1e-7, 3e-5, 1.7e-3, 0.02}) {
    const StepResponse s = r.over(h);
    CAPTURE(h);
    const double w = 2000.0;
    CHECK(s.impulse[0] == doctest::Approx(std::sin(w * h) / w).epsilon(1e-12));
    CHECK(s.slope[0] == doctest::Approx(std::cos(w * h)).epsilon(1e-12));
    // Step, ramp and parabola of force on an undamped mode.
    CHECK(s.first[0] ==
          doctest::Approx(2.0 * std::pow(std::sin(0.5 * w * h) / w, 2)).epsilon(1e-11));
    if (w * h > 0.05) {
      CHECK(s.second[0] == doctest::Approx((h - std::sin(w * h) / w) / k).epsilon(1e-10));
      CHECK(s.third[0] ==
            doctest::Approx((0.5 * h * h - (1.0 - std::cos(w * h)) / k) / k).epsilon(1e-9));
    }
    const double wd = w * std::sqrt(1.0 - 0.01);
    CHECK(s.impulse[1] ==
          doctest::Approx(std::exp(-200.0 * h) * std::sin(wd * h) / wd).epsilon(1e-11));
    // Overdamped: roots -1.25 w +- 0.75 w.
    CHECK(s.impulse[2] ==
          doctest::Approx((std::exp(-0.5 * w * h) - std::exp(-2.0 * w * h)) / (1.5 * w))
              .epsilon(1e-10));
    CHECK(s.impulse[3] == doctest::Approx(h).epsilon(1e-13));
    CHECK(s.third[3] == doctest::Approx(h * h * h * h / 24.0).epsilon(1e-12));
    CHECK(s.impulse[4] == doctest::Approx(-std::expm1(-300.0 * h) / 300.0).epsilon(1e-12));
  }
}

TEST_CASE("a drive that is a parabola of time is answered exactly, however long the step") {
  // x'' + w^2 x = u0 + u2 t^2 from rest: x = (u0 - 2 u2/w^2)(1 - cos wt)/w^2 + u2 t^2 / w^2.
  const double w = 2.0 * std::numbers::pi * 5000.0;
  ModalStepperOptions o;
  o.interval = 2e-3;
  ModalDrive drive{{1.0}, [](double t) { return 2.0 + 3e4 * t * t; }, 2.0};
  ModalContactStepper s({w * w}, {0.0}, {}, {drive}, o);
  s.start(0.0, std::vector<double>{0.0}, std::vector<double>{0.0});
  for (int i = 0; i < 20; ++i) s.advance();
  const double t = s.time();
  CHECK(t == doctest::Approx(0.04));
  const double exact =
      (2.0 - 2.0 * 3e4 / (w * w)) * (1.0 - std::cos(w * t)) / (w * w) + 3e4 * t * t / (w * w);
  CHECK(s.position()[0] == doctest::Approx(exact).epsilon(1e-9));
  CHECK(s.counts().steps < 60);
}

TEST_CASE("an elastic hammer on an undamped string keeps its energy") {
  Strike strike(200, 0.0);
  Law elastic{feltmb::HuntCrossley{4e8, 2.5, 0.0}};
  double last = 0.0;
  for (const double tolerance : {1e-4, 1e-6}) {
    auto s = strike.stepper(tolerance, elastic);
    double worst = 0.0;
    for (int i = 0; i < 400; ++i) {
      s.advance();
      double energy = 0.0;
      for (std::size_t j = 0; j < strike.stiffness.size(); ++j) {
        const double x = s.position()[j];
        const double v = s.velocity()[j];
        energy += 0.5 * (v * v + strike.stiffness[j] * x * x);
      }
      energy += elastic.law.stored_energy(s.compression(0));
      worst = std::max(worst, std::fabs(energy / 0.0405 - 1.0));
    }
    CAPTURE(tolerance);
    CHECK(worst < 10.0 * tolerance);
    last = worst;
  }
  CHECK(last < 1e-6);
}

TEST_CASE("a mass on a Hertz spring: contact time and largest force in closed form") {
  // Hunt & Crossley, p = 1.5: e_m = (5 m v^2 / 4 k)^(2/5), contact time 2.94327 e_m / v.
  Law hertz{feltmb::HuntCrossley{1e7, 1.5, 0.0}};
  const double mass = 0.01;
  const double speed = 1.5;
  ModalStepperOptions o;
  o.interval = 1e-3;
  o.tolerance = 1e-7;
  ModalContactStepper s({0.0}, {0.0}, {{{1.0 / std::sqrt(mass)}, -5e-4, &hertz}}, {}, o);
  s.start(0.0, std::vector<double>{0.0}, std::vector<double>{speed * std::sqrt(mass)});
  for (int i = 0; i < 20; ++i) s.advance();
  const double reach = std::pow(5.0 * mass * speed * speed / (4.0 * 1e7), 0.4);
  CHECK(s.largest_force(0) == doctest::Approx(1e7 * std::pow(reach, 1.5)).epsilon(1e-6));
  REQUIRE(s.events().size() == 2);
  CHECK(s.events()[0].time == doctest::Approx(5e-4 / speed).epsilon(1e-9));
  CHECK(s.events()[0].rate == doctest::Approx(speed).epsilon(1e-6));
  CHECK(s.events()[1].time - s.events()[0].time ==
        doctest::Approx(2.943275 * reach / speed).epsilon(1e-5));
  CHECK(s.velocity()[0] == doctest::Approx(-speed * std::sqrt(mass)).epsilon(1e-6));
}

TEST_CASE("hammer on string: error against the reference of two other methods") {
  for (const int modes : {40, 200}) {
    for (const char* damping : {"0.07", "0.0007"}) {
      std::ifstream in(std::string(FELTMB_REFERENCE) + "/ref_N" + std::to_string(modes) + "_xi" +
                       damping + ".csv");
      REQUIRE(in.good());
      Strike strike(modes, std::stod(damping));
      auto coarse = strike.stepper(2e-5, strike.law);
      Law same = strike.law;
      auto fine = strike.stepper(1e-7, same);
      std::string line;
      std::getline(in, line);
      double off = 0.0, off_fine = 0.0, off_x = 0.0, top = 0.0;
      for (int i = 0; std::getline(in, line); ++i) {
        double t = 0, x = 0, v = 0, u = 0, f = 0;
        REQUIRE(std::sscanf(line.c_str(), "%lf,%lf,%lf,%lf,%lf", &t, &x, &v, &u, &f) == 5);
        if (i > 0) {
          coarse.advance();
          fine.advance();
        }
        CHECK(coarse.time() == doctest::Approx(t).epsilon(1e-12));
        off = std::max(off, std::fabs(coarse.force(0) - f));
        off_fine = std::max(off_fine, std::fabs(fine.force(0) - f));
        off_x = std::max(off_x, std::fabs(fine.position().back() / strike.root_mass - x));
        top = std::max(top, f);
      }
      CAPTURE(modes);
      CAPTURE(damping);
      CHECK(off < 1e-3 * top);
      CHECK(off_fine < 1e-6 * top);
      CHECK(off_x < 1e-10);
      CHECK(coarse.counts().free > 900);
    }
  }
}

TEST_CASE("two contacts at once against a classical Runge-Kutta run of the same equations") {
  // Two masses, the first hits the second, which stands before a wall with a spring of its own.
  Law between{feltmb::HuntCrossley{2e6, 1.5, 0.2}};
  Law wall{feltmb::HuntCrossley{5e6, 1.5, 0.1}};
  const double m1 = 0.02, m2 = 0.01, k2 = 3e3;
  const double a = 1.0 / std::sqrt(m1), b = 1.0 / std::sqrt(m2);
  ModalStepperOptions o;
  o.interval = 1e-4;
  o.tolerance = 1e-7;
  ModalContactStepper s({0.0, k2 / m2}, {0.0, 0.0},
                        {{{a, -b}, 0.0, &between}, {{0.0, b}, -2e-4, &wall}}, {}, o);
  s.start(0.0, std::vector<double>{0.0, 0.0}, std::vector<double>{2.0 / a, 0.0});
  std::vector<double> y{0.0, 0.0, 2.0, 0.0};
  const auto rate = [&](const std::vector<double>& z) {
    const double f = between.law.evaluate(z[0] - z[1], z[2] - z[3]).force;
    const double g = wall.law.evaluate(z[1] - 2e-4, z[3]).force;
    return std::vector<double>{z[2], z[3], -f / m1, (f - g - k2 * z[1]) / m2};
  };
  const double h = 1e-7;
  for (int sample = 0; sample < 30; ++sample) {
    for (int i = 0; i < 1000; ++i) {
      const auto axpy = [&](const std::vector<double>& k, double c) {
        std::vector<double> z = y;
        for (std::size_t j = 0; j < 4; ++j) z[j] += c * k[j];
        return z;
      };
      const auto k1 = rate(y);
      const auto k2r = rate(axpy(k1, 0.5 * h));
      const auto k3 = rate(axpy(k2r, 0.5 * h));
      const auto k4 = rate(axpy(k3, h));
      for (std::size_t j = 0; j < 4; ++j) {
        y[j] += h / 6.0 * (k1[j] + 2.0 * k2r[j] + 2.0 * k3[j] + k4[j]);
      }
    }
    s.advance();
    CHECK(std::fabs(s.position()[0] * a - y[0]) < 1e-9);
    CHECK(std::fabs(s.position()[1] * b - y[1]) < 1e-9);
  }
  CHECK(s.events().size() >= 4);
}

TEST_CASE("bad input of the modal stepper is named, all faults at once") {
  try {
    ModalStepperOptions o;
    o.tolerance = 0.0;
    const ModalContactStepper s({1.0}, {0.0}, {{{1.0, 2.0}, 0.0, nullptr}}, {}, o);
    FAIL("no error");
  } catch (const feltmb::InvalidParameter& error) {
    const std::string text = error.what();
    CHECK(text.find("tolerance = 0") != std::string::npos);
    CHECK(text.find("contact 0: gradient has 2 values, expected one a mode (1)") !=
          std::string::npos);
    CHECK(text.find("contact 0: no force is given") != std::string::npos);
  }
}
