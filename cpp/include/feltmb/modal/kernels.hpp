/// Loops over modes. Sums have a fixed number of partial sums: the same bits on every machine.
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

/// Sums over products of the shapes at one point and at another, weighted: phi phi f, phi dphi f,
/// dphi phi f, dphi dphi f.
struct GramSums {
  double phi_phi = 0.0, phi_dphi = 0.0, dphi_phi = 0.0, dphi_dphi = 0.0;
};
/// At one point with itself.
GramSums gram_sums(std::size_t n, const double* phi, const double* dphi, const double* factor);
/// At a point with another.
GramSums cross_sums(std::size_t n, const double* phi, const double* dphi, const double* other_phi,
                    const double* other_dphi, const double* factor);

/// acceleration += phi force.
void add_load(std::size_t n, const double* phi, double force, double* acceleration);

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

/// (x, v) = (xx x + xv v, vx x + vv v): a step without force.
void rotate(std::size_t n, const double* xx, const double* xv, const double* vx, const double* vv,
            double* x, double* v);

/// Weights of a parabola of force in a step, see StepWeights.
struct ForceWeights {
  const double *x0, *xm, *x1, *v0, *vm, *v1;
};

/// x += shape (x0 f0 + xm fm + x1 f1), v likewise.
void push(std::size_t n, const ForceWeights& w, const double* shape, double f0, double fm,
          double f1, double* x, double* v);

/// Four sums of row x + row v, the rows one after the other in memory: x, v, x, v, ...
struct FourSums {
  double sum[4];
};
FourSums sense(std::size_t n, const double* rows, const double* x, const double* v);

/// Sum of |shape| sqrt(x^2 + v^2 / stiffness) over the modes with stiffness > 0: a bound on
/// |shape . x| from now on.
double reach(std::size_t n, const double* shape, const double* stiffness, const double* x,
             const double* v);

}  // namespace feltmb::modal
