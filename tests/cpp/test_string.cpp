// The stiff string against exact solutions: partials, orthonormality, static load, end force.
#include <doctest/doctest.h>

#include <cmath>
#include <initializer_list>
#include <numbers>
#include <string>
#include <vector>

#include "feltmb/core/error.hpp"
#include "feltmb/modal/string.hpp"
#include "quadrature.hpp"

namespace {

using feltmb::ModalString;
using feltmb::StringParameters;

constexpr double kPi = std::numbers::pi;

StringParameters thesis(int modes, int count = 1) {
  return {0.99e-3, 654.0, 0.6315, 5.98e-3, 2e11, 0.07, modes, count};
}

double bending(const StringParameters& p) {
  return p.young_modulus * kPi * std::pow(p.diameter, 4) / 64.0;
}

/// Deflection at y of a stiff string with pinned ends under the force f at c:
/// E I w'''' - T w'' = f delta(y - c). The string's triangle less the share that stiffness takes.
double static_deflection(const StringParameters& p, double f, double c, double y) {
  if (y > c) {
    y = p.length - y;
    c = p.length - c;
  }
  const double k = std::sqrt(p.tension / bending(p));
  const double rest = p.length - c;
  // sinh(k y) sinh(k rest) / sinh(k L) without overflow.
  const double hyperbolic = 0.5 * std::exp(k * (y + rest - p.length)) *
                            (1.0 - std::exp(-2.0 * k * y)) * (1.0 - std::exp(-2.0 * k * rest)) /
                            (1.0 - std::exp(-2.0 * k * p.length));
  return f / p.tension * (y * rest / p.length - hyperbolic / k);
}

std::vector<double> static_modes(const ModalString& s, double f, double c) {
  std::vector<double> phi(static_cast<std::size_t>(s.modes()));
  std::vector<double> dphi(phi.size());
  s.shapes(c, phi, dphi);
  for (std::size_t i = 0; i < phi.size(); ++i) phi[i] *= f / s.stiffness()[i];
  return phi;
}

std::string message_of(StringParameters p) {
  try {
    const ModalString s(p);
  } catch (const feltmb::InvalidParameter& error) {
    return error.what();
  }
  return "";
}

}  // namespace

TEST_CASE("partials of the stiff string of Table 4.1") {
  const ModalString s(thesis(60));
  CHECK(s.inharmonicity_index() == doctest::Approx(3.616e-5).epsilon(2e-4));
  CHECK(s.angular_frequency()[0] / (2.0 * kPi) == doctest::Approx(261.886).epsilon(2e-6));
  const auto p = thesis(60);
  for (int j = 1; j <= 60; ++j) {
    const double k = j * kPi / p.length;
    // mu w^2 = T k^2 + E I k^4 of eq. 4.10.
    const double square = (p.tension * k * k + bending(p) * std::pow(k, 4)) / p.linear_density;
    const auto i = static_cast<std::size_t>(j - 1);
    CHECK(s.stiffness()[i] == doctest::Approx(square).epsilon(1e-13));
    CHECK(s.angular_frequency()[i] == doctest::Approx(std::sqrt(square)).epsilon(1e-13));
    CHECK(s.damping()[i] == doctest::Approx(0.14 * std::sqrt(square)).epsilon(1e-13));
  }
}

TEST_CASE("a flexible string is harmonic") {
  auto p = thesis(20);
  p.young_modulus = 0.0;
  const ModalString s(p);
  const double fundamental = kPi / p.length * std::sqrt(p.tension / p.linear_density);
  for (std::size_t i = 0; i < 20; ++i) {
    CHECK(s.angular_frequency()[i] ==
          doctest::Approx(fundamental * static_cast<double>(i + 1)).epsilon(1e-14));
  }
}

TEST_CASE("mode shapes: sines, slopes, orthonormal with the mass of the string") {
  const int modes = 12;
  const auto p = thesis(modes);
  const ModalString s(p);
  std::vector<double> phi(modes), dphi(modes), up(modes), down(modes), unused(modes);
  const double y = 0.123;
  s.shapes(y, phi, dphi);
  s.shapes(y + 1e-6, up, unused);
  s.shapes(y - 1e-6, down, unused);
  for (std::size_t i = 0; i < phi.size(); ++i) {
    const double k = static_cast<double>(i + 1) * kPi / p.length;
    CHECK(phi[i] ==
          doctest::Approx(std::sqrt(2.0 / (p.linear_density * p.length)) * std::sin(k * y))
              .epsilon(1e-12));
    CHECK(dphi[i] == doctest::Approx((up[i] - down[i]) / 2e-6).epsilon(1e-8));
  }
  for (std::size_t a = 0; a < phi.size(); ++a) {
    for (std::size_t b = 0; b < phi.size(); ++b) {
      const auto product = [&](double x) {
        s.shapes(x, phi, dphi);
        return p.linear_density * phi[a] * phi[b];
      };
      CHECK(std::fabs(quadrature(product, 0.0, p.length, 48) - (a == b ? 1.0 : 0.0)) < 1e-12);
    }
  }
}

TEST_CASE("the recurrence of the shapes holds for thousands of modes") {
  const auto p = thesis(5000);
  const ModalString s(p);
  std::vector<double> phi(5000), dphi(5000);
  for (const double y : {1e-4, 0.0694, 0.31, 0.6314}) {
    s.shapes(y, phi, dphi);
    const double top = std::sqrt(2.0 / (p.linear_density * p.length));
    for (std::size_t i = 0; i < phi.size(); ++i) {
      const double k = static_cast<double>(i + 1) * kPi / p.length;
      CHECK(std::fabs(phi[i] - top * std::sin(k * y)) < 1e-10 * top);
      CHECK(std::fabs(dphi[i] - top * k * std::cos(k * y)) < 1e-10 * top * k);
    }
  }
}

TEST_CASE("values at a point: displacement, slope, curvature, rates") {
  const ModalString s(thesis(9));
  const std::vector<double> eta{1e-4, -3e-5, 2e-5, 1e-5, 0.0, 4e-6, -1e-6, 2e-6, 1e-6};
  std::vector<double> rate(eta.rbegin(), eta.rend());
  const double y = 0.2;
  const double h = 1e-4;
  const auto w = [&](double x) { return s.point(x, eta, rate).displacement; };
  const auto middle = s.point(y, eta, rate);
  CHECK(middle.slope == doctest::Approx((w(y + h) - w(y - h)) / (2.0 * h)).epsilon(1e-5));
  CHECK(middle.curvature ==
        doctest::Approx((w(y + h) - 2.0 * w(y) + w(y - h)) / (h * h)).epsilon(1e-4));
  const auto still = s.point(y, rate, eta);
  CHECK(middle.velocity == doctest::Approx(still.displacement).epsilon(1e-14));
  CHECK(middle.slope_rate == doctest::Approx(still.slope).epsilon(1e-14));
}

TEST_CASE("static deflection under a point load is the exact one of a stiff string") {
  const auto p = thesis(4000);
  const ModalString s(p);
  const double load = 20.0;
  for (const double c : {0.0694, 0.3, 0.55}) {
    const auto eta = static_modes(s, load, c);
    const std::vector<double> still(eta.size(), 0.0);
    const double top = static_deflection(p, load, c, c);
    for (const double y : {0.02, 0.0694, 0.15, 0.3, 0.5, 0.6}) {
      const double exact = static_deflection(p, load, c, y);
      CHECK(std::fabs(s.point(y, eta, still).displacement - exact) < 5e-8 * top);
    }
  }
}

TEST_CASE("the error of the static deflection falls with the number of modes") {
  const double c = 0.0694;
  const double exact = static_deflection(thesis(1), 20.0, c, c);
  double before = 1.0;
  for (const int modes : {20, 40, 80, 160, 320}) {
    const ModalString s(thesis(modes));
    const auto eta = static_modes(s, 20.0, c);
    const std::vector<double> still(eta.size(), 0.0);
    const double error = std::fabs(s.point(c, eta, still).displacement / exact - 1.0);
    CHECK(error < 0.7 * before);
    before = error;
  }
  CHECK(before < 1e-3);
}

TEST_CASE("the far end carries the share c/L of a static load") {
  const auto p = thesis(5000);
  const ModalString s(p);
  for (const double c : {0.0694, 0.3, 0.5}) {
    // Moments about the near end; the series converges as 1/N, so average over two last sums.
    const double force = s.bridge_force(static_modes(s, 20.0, c));
    CHECK(std::fabs(force - 20.0 * c / p.length) < 20.0 * 5e-4);
  }
}

TEST_CASE("energies and power are those of independent oscillators of unit mass") {
  const ModalString s(thesis(3));
  const std::vector<double> eta{1e-4, -2e-5, 3e-5};
  const std::vector<double> rate{0.1, 0.2, -0.3};
  double elastic = 0.0, power = 0.0;
  for (std::size_t i = 0; i < 3; ++i) {
    elastic += 0.5 * s.stiffness()[i] * eta[i] * eta[i];
    power += s.damping()[i] * rate[i] * rate[i];
  }
  CHECK(s.kinetic_energy(rate) == doctest::Approx(0.07));
  CHECK(s.elastic_energy(eta) == doctest::Approx(elastic));
  CHECK(s.dissipated_power(rate) == doctest::Approx(power));
  // The same by integration along the string: T w_y^2 / 2 + E I w_yy^2 / 2.
  const auto density = [&](double y) {
    const auto at = s.point(y, eta, rate);
    return 0.5 * (654.0 * at.slope * at.slope + bending(thesis(3)) * at.curvature * at.curvature);
  };
  CHECK(s.elastic_energy(eta) ==
        doctest::Approx(quadrature(density, 0.0, 0.6315, 8)).epsilon(1e-12));
}

TEST_CASE("n strings are one of n times the density, tension and bending stiffness") {
  const int n = 3;
  const ModalString many(thesis(30, n));
  auto p = thesis(30);
  p.linear_density *= n;
  p.tension *= n;
  p.young_modulus *= n;
  const ModalString heavy(p);
  CHECK(many.inharmonicity_index() == doctest::Approx(heavy.inharmonicity_index()).epsilon(1e-14));
  CHECK(many.shape_scale() == doctest::Approx(heavy.shape_scale()).epsilon(1e-14));
  std::vector<double> phi(30), dphi(30), phi_heavy(30), dphi_heavy(30), eta(30);
  many.shapes(0.0694, phi, dphi);
  heavy.shapes(0.0694, phi_heavy, dphi_heavy);
  for (std::size_t i = 0; i < 30; ++i) {
    CHECK(many.stiffness()[i] == doctest::Approx(heavy.stiffness()[i]).epsilon(1e-13));
    CHECK(many.damping()[i] == doctest::Approx(heavy.damping()[i]).epsilon(1e-13));
    CHECK(phi[i] == doctest::Approx(phi_heavy[i]).epsilon(1e-13));
    eta[i] = 1e-4 / static_cast<double>(i + 1);
  }
  CHECK(many.bridge_force(eta) == doctest::Approx(heavy.bridge_force(eta)).epsilon(1e-13));
}

TEST_CASE("n strings under a force move as one under its n-th part; the rest is n times") {
  const double load = 20.0;
  const double c = 0.0694;
  for (const int n : {2, 3, 5}) {
    const ModalString one(thesis(60));
    const ModalString many(thesis(60, n));
    const auto eta_one = static_modes(one, load / n, c);
    const auto eta_many = static_modes(many, load, c);
    const std::vector<double> still(60, 0.0);
    for (const double y : {0.02, 0.0694, 0.3, 0.6}) {
      CHECK(many.point(y, eta_many, still).displacement ==
            doctest::Approx(one.point(y, eta_one, still).displacement).epsilon(1e-12));
    }
    CHECK(many.bridge_force(eta_many) ==
          doctest::Approx(n * one.bridge_force(eta_one)).epsilon(1e-12));
    CHECK(many.elastic_energy(eta_many) ==
          doctest::Approx(n * one.elastic_energy(eta_one)).epsilon(1e-12));
    // The same motion as a speed.
    CHECK(many.kinetic_energy(eta_many) ==
          doctest::Approx(n * one.kinetic_energy(eta_one)).epsilon(1e-12));
    CHECK(many.dissipated_power(eta_many) ==
          doctest::Approx(n * one.dissipated_power(eta_one)).epsilon(1e-12));
  }
}

TEST_CASE("parameters of a string out of range are named") {
  auto p = thesis(40);
  p.tension = -1.0;
  CHECK(message_of(p).find("tension = -1 N, must be > 0") != std::string::npos);
  p = thesis(0);
  CHECK(message_of(p).find("modes") != std::string::npos);
  p = thesis(40, 0);
  CHECK(message_of(p).find("count = 0, must be in [1, 1000]") != std::string::npos);
  p = thesis(40);
  p.damping_ratio = 1.0;
  CHECK(message_of(p).find("damping_ratio = 1, must be in [0, 1)") != std::string::npos);
  p = thesis(40);
  p.length = NAN;
  CHECK(message_of(p).find("length") != std::string::npos);
}
