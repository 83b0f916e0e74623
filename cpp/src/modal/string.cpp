#include "feltmb/modal/string.hpp"

#include <cmath>
#include <numbers>

#include "feltmb/core/error.hpp"
#include "feltmb/core/sums.hpp"
#include "feltmb/modal/kernels.hpp"

namespace feltmb {
ModalString::ModalString(const StringParameters& p) : parameters_(p) {
  check_numbers(p, [](const std::string& text) { throw InvalidParameter("string: " + text); });

  const double pi = std::numbers::pi;
  const auto modes = static_cast<std::size_t>(p.modes);
  const double strings = p.count;
  const double d2 = p.diameter * p.diameter;
  inharmonicity_ = pi * d2 * d2 * p.young_modulus / (64.0 * p.length * p.length * p.tension);
  shape_scale_ = std::sqrt(2.0 / (strings * p.linear_density * p.length));
  const double bending = p.young_modulus * pi * d2 * d2 / 64.0;
  wave_number_.resize(modes);
  wave_number_squared_.resize(modes);
  omega_.resize(modes);
  stiffness_.resize(modes);
  damping_.resize(modes);
  bridge_.resize(modes);
  for (std::size_t i = 0; i < modes; ++i) {
    const double j = static_cast<double>(i + 1);
    const double k = j * pi / p.length;
    wave_number_[i] = k;
    wave_number_squared_[i] = k * k;
    omega_[i] =
        k * std::sqrt(p.tension / p.linear_density * (1.0 + inharmonicity_ * pi * pi * j * j));
    stiffness_[i] = omega_[i] * omega_[i];
    damping_[i] = 2.0 * p.damping_ratio * omega_[i];
    const double end_cosine = (i % 2 == 0) ? -1.0 : 1.0;
    bridge_[i] = -strings * shape_scale_ * k * end_cosine * (p.tension + bending * k * k);
  }
  if (!(omega_.back() <= 1e12)) {
    throw InvalidParameter(
        format("string: frequency of the last mode [rad/s] = %.6g, must be <= 1e12; look at "
               "linear_density, tension and modes",
               omega_.back()));
  }
}

void ModalString::shapes(double y, std::span<double> phi, std::span<double> dphi) const {
  const double angle = wave_number_[0] * y;
  // Rotation recurrence: one sine and cosine instead of one pair a mode.
  const double c1 = std::cos(angle);
  const double s1 = std::sin(angle);
  double c = c1;
  double s = s1;
  for (std::size_t i = 0; i < phi.size(); ++i) {
    phi[i] = shape_scale_ * s;
    dphi[i] = shape_scale_ * wave_number_[i] * c;
    const double next = c * c1 - s * s1;
    s = s * c1 + c * s1;
    c = next;
  }
}

StringPoint ModalString::point(double y, std::span<const double> eta,
                               std::span<const double> eta_rate) const {
  std::vector<double> phi(eta.size());
  std::vector<double> dphi(eta.size());
  shapes(y, phi, dphi);
  return point(phi, dphi, eta, eta_rate);
}

StringPoint ModalString::point(std::span<const double> phi, std::span<const double> dphi,
                               std::span<const double> eta,
                               std::span<const double> eta_rate) const {
  const modal::PointSums sums =
      modal::point_sums(eta.size(), phi.data(), dphi.data(), wave_number_squared_.data(),
                        eta.data(), eta_rate.data());
  return {sums.displacement, sums.slope, -sums.curvature, sums.velocity, sums.slope_rate};
}

double ModalString::bridge_force(std::span<const double> eta) const {
  return sum_products(eta.size(), bridge_.data(), eta.data());
}

double ModalString::largest_displacement(std::span<const double> eta) const {
  return shape_scale_ * sum_absolute(eta.size(), eta.data());
}

double ModalString::kinetic_energy(std::span<const double> eta_rate) const {
  return 0.5 * sum_squares(eta_rate.size(), eta_rate.data());
}

double ModalString::elastic_energy(std::span<const double> eta) const {
  return 0.5 * sum_weighted_squares(eta.size(), stiffness_.data(), eta.data());
}

double ModalString::dissipated_power(std::span<const double> eta_rate) const {
  return sum_weighted_squares(eta_rate.size(), damping_.data(), eta_rate.data());
}

}  // namespace feltmb
