#include "newton_kernels.hpp"

#include "feltmb/core/multiversion.hpp"

namespace feltmb::detail {
namespace {

FELTMB_CLONES void add_slopes(std::size_t n, const int* coordinates, std::size_t count,
                              const ContactColumns& c, double slope, double rate_slope,
                              double* __restrict column, double* __restrict rate_column,
                              double* __restrict stiffness, double* __restrict damping) {
  for (std::size_t i = 0; i < n; ++i) {
    column[i] = c.force[i] * slope + c.compression[i];
    rate_column[i] = c.force[i] * rate_slope;
  }
  for (std::size_t y = 0; y < count; ++y) {
    const auto j = static_cast<std::size_t>(coordinates[y]);
    const double by_place = c.gradient[j];
    const double by_rate = c.rate_gradient[j];
    double* __restrict to_stiffness = stiffness + j * n;
    double* __restrict to_damping = damping + j * n;
    for (std::size_t i = 0; i < n; ++i) {
      to_stiffness[i] += column[i] * by_place + rate_column[i] * by_rate;
      to_damping[i] += rate_column[i] * by_place;
    }
  }
}

FELTMB_CLONES void form_columns(std::size_t n, double gamma, const double* __restrict mass,
                                const double* __restrict damping,
                                const double* __restrict stiffness, std::size_t stride,
                                double* __restrict newton, std::size_t rows,
                                double* __restrict mass_columns,
                                double* __restrict stiffness_columns) {
  for (std::size_t k = 0; k < n; ++k) {
    for (std::size_t j = 0; j < n; ++j) {
      const double m = mass[k * n + j];
      const double s = gamma * stiffness[k * n + j];
      mass_columns[k * rows + j] = m;
      stiffness_columns[k * rows + j] = s;
      newton[k * stride + j] = m - gamma * (damping[k * n + j] + s);
    }
  }
}

}  // namespace

void add_contact_slopes(std::size_t n, std::span<const int> coordinates, const ContactColumns& c,
                        double slope, double rate_slope, double* scratch, double* stiffness,
                        double* damping) {
  add_slopes(n, coordinates.data(), coordinates.size(), c, slope, rate_slope, scratch, scratch + n,
             stiffness, damping);
}

void form_newton(std::size_t n, double gamma, const double* mass, const double* damping,
                 const double* stiffness, std::size_t stride, double* newton, std::size_t rows,
                 double* mass_columns, double* stiffness_columns) {
  form_columns(n, gamma, mass, damping, stiffness, stride, newton, rows, mass_columns,
               stiffness_columns);
}

}  // namespace feltmb::detail
