/// Loops over modes, vectorised for the machine at hand.
#pragma once

#include <cstddef>

namespace feltmb::modal {

/// Sums over modes at one point: phi.eta, dphi.eta, (k^2 phi).eta, phi.rate, dphi.rate.
struct PointSums {
  double displacement, slope, curvature, velocity, slope_rate;
};
PointSums point_sums(std::size_t n, const double* phi, const double* dphi,
                     const double* wave_number_squared, const double* eta, const double* rate);

/// acceleration = -stiffness eta - damping rate + phi force.
void accelerate(std::size_t n, const double* stiffness, const double* damping, const double* eta,
                const double* rate, const double* phi, double force, double* acceleration);

/// factor = 1 / (1 + g (damping + g stiffness)).
void newton_factors(std::size_t n, double g, const double* stiffness, const double* damping,
                    double* factor);

/// Sums of phi^2 f, phi dphi f, dphi^2 f.
struct GramSums {
  double phi_phi, phi_dphi, dphi_dphi;
};
GramSums gram_sums(std::size_t n, const double* phi, const double* dphi, const double* factor);

/// rate = (rate - g stiffness eta) factor.
void reduce_residual(std::size_t n, double g, const double* stiffness, const double* factor,
                     const double* eta, double* rate);

/// Sums of phi.rate, phi.(eta + g rate), dphi.(eta + g rate).
struct ResidualSums {
  double velocity, displacement, slope;
};
ResidualSums residual_sums(std::size_t n, double g, const double* phi, const double* dphi,
                           const double* eta, const double* rate);

/// rate += g (phi a + dphi b) factor.
void add_force(std::size_t n, double g, double a, double b, const double* phi, const double* dphi,
               const double* factor, double* rate);

/// eta += g rate.
void advance(std::size_t n, double g, const double* rate, double* eta);

}  // namespace feltmb::modal
