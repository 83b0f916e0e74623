/// Inner loops of the Newton matrix. Private to the folder.
#pragma once

#include <cstddef>
#include <span>

namespace feltmb::detail {

/// Adds the slopes of one contact, K += (b s + c) g^T + b r h^T and D += b r g^T, to matrices of n
/// columns of n numbers: force column b, compression column c, gradient g, rate gradient h, which
/// are zero but for `coordinates`, slope s by compression and r by rate. `scratch` holds 2 n.
struct ContactColumns {
  const double *force, *compression, *gradient, *rate_gradient;
};
void add_contact_slopes(std::size_t n, std::span<const int> coordinates, const ContactColumns& c,
                        double slope, double rate_slope, double* scratch, double* stiffness,
                        double* damping);

/// M - gamma (D + gamma K) into columns `stride` numbers apart, M and gamma K into columns `rows`
/// apart.
void form_newton(std::size_t n, double gamma, const double* mass, const double* damping,
                 const double* stiffness, std::size_t stride, double* newton, std::size_t rows,
                 double* mass_columns, double* stiffness_columns);

}  // namespace feltmb::detail
