#include <doctest/doctest.h>

#include <cmath>
#include <numbers>
#include <vector>

#include "feltmb/core/error.hpp"
#include "feltmb/fiber/carnaby_pan.hpp"
#include "feltmb/fiber/orientation.hpp"
#include "feltmb/numeric/quadrature.hpp"

using namespace feltmb;
using doctest::Approx;

namespace {

const SlidingNetwork kSoft{0.35, 0.8, 25e-6, 0.132, 1.3, 2.0};
constexpr double kPi = std::numbers::pi;

/// Integral over both caps up to theta, by the angle itself.
template <class F>
double over_caps(double ratio, double theta, F&& f) {
  return integrate_composite(
      [&](double t) {
        return 2.0 * kPi * uniaxial_density(ratio, std::cos(t)) * std::sin(t) * f(t);
      },
      0.0, theta, 400);
}

std::vector<double> grid(double from, double to, int n) {
  std::vector<double> v(static_cast<std::size_t>(n));
  for (int i = 0; i < n; ++i) v[static_cast<std::size_t>(i)] = from + (to - from) * i / (n - 1);
  return v;
}

}  // namespace

TEST_CASE("critical angle: the + root where it is one") {
  for (double mu : {0.0, 0.1, 0.35, 1.0}) {
    CAPTURE(mu);
    CHECK(critical_angle(1.0, mu) == 0.0);
    CHECK(critical_angle(1.02, mu) == 0.0);
    CHECK(critical_angle(5.0, mu) == 0.0);
    CHECK(critical_angle(1e-14, mu) == Approx(std::atan2(1.0, mu)).epsilon(1e-12));
    for (double w : {0.001, 0.2, 0.7, 0.99}) {
      const double t = critical_angle(w, mu);
      // Eq. 3.65 holds with equality there.
      CHECK(std::cos(t) == Approx(mu * std::sin(t) + w).epsilon(1e-13));
      CHECK(t == Approx(std::acos(w / std::sqrt(1.0 + mu * mu)) - std::atan(mu)).epsilon(1e-12));
    }
  }
}

TEST_CASE("proportion and resistance are the integrals over both caps") {
  for (double ratio : {1.0, 1.3, 2.0, 6.0}) {
    for (double mu : {0.0, 0.1, 0.35}) {
      for (double theta : {1e-3, 0.05, 0.3, 0.9, 1.15}) {
        CAPTURE(ratio);
        CAPTURE(mu);
        CAPTURE(theta);
        const double r = over_caps(ratio, theta, [](double) { return 1.0; });
        CHECK(sliding_proportion(ratio, theta) == Approx(r).epsilon(1e-10));
        const double g = over_caps(
            ratio, theta, [&](double t) { return 1.0 / (std::cos(t) - mu * std::sin(t)); });
        CHECK(sliding_resistance(ratio, mu, theta) == Approx(g).epsilon(1e-10));
      }
    }
  }
  CHECK(sliding_proportion(3.0, kPi / 2) == Approx(1.0));  // both caps can reach every fiber
}

TEST_CASE("closed forms: isotropic loading, unloading at any R") {
  const double mu = 0.35;
  for (double w : {0.9, 0.3, 1e-3, 1e-8}) {
    const double t = critical_angle(w, mu);
    const double closed = (std::log(1.0 / w) - mu * t) / (1.0 + mu * mu);
    CHECK(sliding_resistance(1.0, mu, t) == Approx(closed).epsilon(1e-9));
    for (double ratio : {1.0, 1.7, 4.0}) {
      const double u = std::tan(t) * std::tan(t);
      const double a = std::sqrt(1.0 + u);
      const double b = std::sqrt(u + ratio * ratio);
      const double c = ratio * (std::log((a + b) / (1.0 + ratio)) - a / b + 1.0 / ratio);
      CHECK(sliding_resistance(ratio, 0.0, t) == Approx(c).epsilon(1e-9));
    }
  }
}

TEST_CASE("resistance at strong forces: precise down to the logarithm") {
  // w -> 0: the integral grows like log(1/w) with slope R x^2 sqrt(1+x^2) / (x^2+R^2)^1.5, x =
  // 1/mu.
  const double mu = 0.35, ratio = 2.0, x = 1.0 / mu;
  const double slope =
      ratio * x * x * std::sqrt(1.0 + x * x) / std::pow(x * x + ratio * ratio, 1.5);
  const double a = sliding_resistance(ratio, mu, critical_angle(1e-6, mu));
  const double b = sliding_resistance(ratio, mu, critical_angle(1e-8, mu));
  CHECK((b - a) / std::log(100.0) == Approx(slope).epsilon(1e-5));
}

TEST_CASE("sliding force lies between the withdrawal and the contact force") {
  for (double v : {0.14, 0.2, 0.33}) {
    for (double q : {1.0001, 1.5, 10.0, 1e4}) {
      const double unit =
          kSoft.Wf0 * kSoft.gamma * kSoft.d_f / -std::expm1(-kSoft.Q * kSoft.gamma * v);
      const Sliding s = sliding_at_force(kSoft, v, q * unit);
      CHECK(s.C_s_loading >= unit * (1.0 - 1e-12));
      CHECK(s.C_s_loading <= s.C * (1.0 + 1e-12));
      CHECK(s.C_s_unloading >= unit * (1.0 - 1e-12));
      CHECK(s.C_s_unloading <= s.C_s_loading * (1.0 + 1e-12));
      CHECK(s.r_sc > 0.0);
      CHECK(s.r_sc < 1.0);
    }
  }
  const Sliding rest = sliding_at_force(kSoft, 0.2, 1e-9);
  CHECK(rest.theta_cr == 0.0);
  CHECK(rest.tau_loading == 0.0);
}

TEST_CASE("pressures are inverted to rounding") {
  for (double v : {0.14, 0.2, 0.33}) {
    for (double C : {1e-6, 3e-5, 4e-4, 1e-2}) {
      CAPTURE(v);
      CAPTURE(C);
      const Sliding s = sliding_at_force(kSoft, v, C);
      bool unique = false;
      CHECK(sliding_at_pressure(kSoft, v, s.sigma, Stress::elastic).C == Approx(C).epsilon(1e-11));
      CHECK(sliding_at_pressure(kSoft, v, s.sigma + s.tau_loading, Stress::loading).C ==
            Approx(C).epsilon(1e-11));
      CHECK(
          sliding_at_pressure(kSoft, v, s.sigma - s.tau_unloading, Stress::unloading, &unique).C ==
          Approx(C).epsilon(1e-11));
      CHECK(unique);
    }
  }
}

TEST_CASE("unloading is unique from mu = 0.298 at R = 1 on, 0.080 at R = 2") {
  CHECK(unloading_is_unique(1.0, 0.299));
  CHECK_FALSE(unloading_is_unique(1.0, 0.296));
  CHECK(unloading_is_unique(1.25, 0.178));
  CHECK_FALSE(unloading_is_unique(1.25, 0.175));
  CHECK(unloading_is_unique(2.0, 0.081));
  CHECK_FALSE(unloading_is_unique(2.0, 0.079));
  SlidingNetwork slick = kSoft;
  slick.mu = 0.1;
  const double v = 0.1325;
  const double unit = slick.Wf0 * slick.gamma * slick.d_f / -std::expm1(-slick.Q * slick.gamma * v);
  // Beyond the turn the largest contact force is found, and the doubt is told.
  const Sliding s = sliding_at_force(slick, v, 3.5 * unit);
  bool unique = true;
  const Sliding back =
      sliding_at_pressure(slick, v, s.sigma - s.tau_unloading, Stress::unloading, &unique);
  CHECK(back.sigma - back.tau_unloading == Approx(s.sigma - s.tau_unloading).epsilon(1e-10));
  CHECK(back.C >= s.C * (1.0 - 1e-10));
  CHECK_FALSE(unique);
}

TEST_CASE("load-driven march and compression-driven form agree") {
  const auto v = grid(0.132, 0.33, 60);
  for (FrictionForm form : {FrictionForm::repaired, FrictionForm::printed}) {
    const CarnabyPanLoop a = carnaby_pan(kSoft, 2.5e9, 24.0, v, form);
    const CarnabyPanLoop b = carnaby_pan_march(kSoft, 2.5e9, 24.0, a.C, 16, form);
    for (std::size_t i = 1; i < v.size(); ++i) {
      CHECK(b.v_f[i] == Approx(v[i]).epsilon(1e-7));
      CHECK(b.P_loading[i] == Approx(a.P_loading[i]).epsilon(1e-5));
      CHECK(b.P_unloading[i] == Approx(a.P_unloading[i]).epsilon(1e-5));
    }
  }
}

TEST_CASE("total form loses energy, the printed increments gain it") {
  const auto v = grid(0.132, 0.33, 400);
  const auto area = [&](const CarnabyPanLoop& loop) {
    double sum = 0.0;
    for (std::size_t i = 1; i < v.size(); ++i) {
      const auto band = [&](std::size_t k) {
        return (loop.P_loading[k] - loop.P_unloading[k]) / (v[k] * v[k]);
      };
      sum += 0.5 * (band(i) + band(i - 1)) * (v[i] - v[i - 1]);
    }
    return sum;
  };
  CHECK(area(carnaby_pan(kSoft, 2.5e9, 0.64, v)) > 0.0);
  CHECK(area(carnaby_pan(kSoft, 2.5e9, 0.64, v, FrictionForm::printed)) < 0.0);
}

TEST_CASE("no withdrawal force to speak of, no friction: the bonded network remains") {
  SlidingNetwork stiff = kSoft;
  stiff.Wf0 = 1e6;  // nothing slides
  const auto v = grid(0.132, 0.33, 20);
  const CarnabyPanLoop loop = carnaby_pan(stiff, 2.5e9, 24.0, v);
  for (std::size_t i = 0; i < v.size(); ++i) {
    CHECK(loop.P_loading[i] == loop.P_unloading[i]);
    CHECK(loop.r_sc[i] == 0.0);
  }
}

TEST_CASE("every fault of the arguments is named") {
  const std::vector<double> v = {0.1};
  const SlidingNetwork bad{-0.1, 0.0, 25e-6, 0.132, 1.3, 2.0};
  try {
    carnaby_pan(bad, 2.5e9, 24.0, v);
    FAIL("no exception");
  } catch (const InvalidParameter& error) {
    const std::string text = error.what();
    CHECK(text.find("mu = -0.1") != std::string::npos);
    CHECK(text.find("Wf0 = 0 N/m") != std::string::npos);
  }
  CHECK_THROWS_WITH_AS(carnaby_pan(kSoft, 2.5e9, 24.0, v), doctest::Contains("v_f[0] = 0.1"),
                       InvalidParameter);
}
