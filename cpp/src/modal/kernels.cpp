#include "feltmb/modal/kernels.hpp"

#include <cmath>

namespace feltmb::modal {
namespace {

constexpr std::size_t kLanes = 4;

double total(const double* part) { return (part[0] + part[2]) + (part[1] + part[3]); }

}  // namespace

PointSums point_sums(std::size_t n, const double* __restrict phi, const double* __restrict dphi,
                     const double* __restrict wave_number_squared, const double* __restrict eta,
                     const double* __restrict rate) {
  double a[kLanes] = {}, b[kLanes] = {}, c[kLanes] = {}, d[kLanes] = {}, e[kLanes] = {};
  std::size_t i = 0;
  for (; i + kLanes <= n; i += kLanes) {
    for (std::size_t j = 0; j < kLanes; ++j) {
      const double p = phi[i + j] * eta[i + j];
      a[j] += p;
      b[j] += dphi[i + j] * eta[i + j];
      c[j] += wave_number_squared[i + j] * p;
      d[j] += phi[i + j] * rate[i + j];
      e[j] += dphi[i + j] * rate[i + j];
    }
  }
  for (std::size_t j = 0; i < n; ++i, ++j) {
    const double p = phi[i] * eta[i];
    a[j] += p;
    b[j] += dphi[i] * eta[i];
    c[j] += wave_number_squared[i] * p;
    d[j] += phi[i] * rate[i];
    e[j] += dphi[i] * rate[i];
  }
  return {total(a), total(b), total(c), total(d), total(e)};
}

void accelerate(std::size_t n, const double* __restrict stiffness, const double* __restrict damping,
                const double* __restrict eta, const double* __restrict rate,
                const double* __restrict phi, double force, double* __restrict acceleration) {
  for (std::size_t i = 0; i < n; ++i) {
    acceleration[i] = phi[i] * force - stiffness[i] * eta[i] - damping[i] * rate[i];
  }
}

void newton_factors(std::size_t n, double g, const double* __restrict stiffness,
                    const double* __restrict damping, double* __restrict factor) {
  for (std::size_t i = 0; i < n; ++i) {
    factor[i] = 1.0 / (1.0 + g * (damping[i] + g * stiffness[i]));
  }
}

GramSums gram_sums(std::size_t n, const double* __restrict phi, const double* __restrict dphi,
                   const double* __restrict factor) {
  double a[kLanes] = {}, b[kLanes] = {}, c[kLanes] = {};
  std::size_t i = 0;
  for (; i + kLanes <= n; i += kLanes) {
    for (std::size_t j = 0; j < kLanes; ++j) {
      const double p = phi[i + j] * factor[i + j];
      a[j] += phi[i + j] * p;
      b[j] += dphi[i + j] * p;
      c[j] += dphi[i + j] * dphi[i + j] * factor[i + j];
    }
  }
  for (std::size_t j = 0; i < n; ++i, ++j) {
    const double p = phi[i] * factor[i];
    a[j] += phi[i] * p;
    b[j] += dphi[i] * p;
    c[j] += dphi[i] * dphi[i] * factor[i];
  }
  return {total(a), total(b), total(b), total(c)};
}

GramSums cross_sums(std::size_t n, const double* __restrict phi, const double* __restrict dphi,
                    const double* __restrict other_phi, const double* __restrict other_dphi,
                    const double* __restrict factor) {
  double a[kLanes] = {}, b[kLanes] = {}, c[kLanes] = {}, d[kLanes] = {};
  const auto add = [&](std::size_t lane, std::size_t i) {
    const double p = other_phi[i] * factor[i];
    const double q = other_dphi[i] * factor[i];
    a[lane] += phi[i] * p;
    b[lane] += phi[i] * q;
    c[lane] += dphi[i] * p;
    d[lane] += dphi[i] * q;
  };
  std::size_t i = 0;
  for (; i + kLanes <= n; i += kLanes) {
    for (std::size_t j = 0; j < kLanes; ++j) add(j, i + j);
  }
  for (std::size_t j = 0; i < n; ++i, ++j) add(j, i);
  return {total(a), total(b), total(c), total(d)};
}

void add_load(std::size_t n, const double* __restrict phi, double force,
              double* __restrict acceleration) {
  for (std::size_t i = 0; i < n; ++i) acceleration[i] += phi[i] * force;
}

void reduce_residual(std::size_t n, double g, const double* __restrict stiffness,
                     const double* __restrict factor, const double* __restrict eta,
                     double* __restrict rate) {
  for (std::size_t i = 0; i < n; ++i) {
    rate[i] = (rate[i] - g * stiffness[i] * eta[i]) * factor[i];
  }
}

ResidualSums residual_sums(std::size_t n, double g, const double* __restrict phi,
                           const double* __restrict dphi, const double* __restrict eta,
                           const double* __restrict rate) {
  double a[kLanes] = {}, b[kLanes] = {}, c[kLanes] = {};
  std::size_t i = 0;
  for (; i + kLanes <= n; i += kLanes) {
    for (std::size_t j = 0; j < kLanes; ++j) {
      const double e = eta[i + j] + g * rate[i + j];
      a[j] += phi[i + j] * rate[i + j];
      b[j] += phi[i + j] * e;
      c[j] += dphi[i + j] * e;
    }
  }
  for (std::size_t j = 0; i < n; ++i, ++j) {
    const double e = eta[i] + g * rate[i];
    a[j] += phi[i] * rate[i];
    b[j] += phi[i] * e;
    c[j] += dphi[i] * e;
  }
  return {total(a), total(b), total(c)};
}

void add_force(std::size_t n, double g, double a, double b, const double* __restrict phi,
               const double* __restrict dphi, const double* __restrict factor,
               double* __restrict rate) {
  for (std::size_t i = 0; i < n; ++i) rate[i] += g * (phi[i] * a + dphi[i] * b) * factor[i];
}

void advance(std::size_t n, double g, const double* __restrict rate, double* __restrict eta) {
  for (std::size_t i = 0; i < n; ++i) eta[i] += g * rate[i];
}

void rotate(std::size_t n, const double* __restrict xx, const double* __restrict xv,
            const double* __restrict vx, const double* __restrict vv, double* __restrict x,
            double* __restrict v) {
  for (std::size_t i = 0; i < n; ++i) {
    const double p = x[i];
    const double q = v[i];
    x[i] = xx[i] * p + xv[i] * q;
    v[i] = vx[i] * p + vv[i] * q;
  }
}

void push(std::size_t n, const ForceWeights& w, const double* __restrict shape, double f0,
          double fm, double f1, double* __restrict x, double* __restrict v) {
  const double* __restrict x0 = w.x0;
  const double* __restrict xm = w.xm;
  const double* __restrict x1 = w.x1;
  const double* __restrict v0 = w.v0;
  const double* __restrict vm = w.vm;
  const double* __restrict v1 = w.v1;
  for (std::size_t i = 0; i < n; ++i) {
    x[i] += shape[i] * (x0[i] * f0 + xm[i] * fm + x1[i] * f1);
    v[i] += shape[i] * (v0[i] * f0 + vm[i] * fm + v1[i] * f1);
  }
}

FourSums sense(std::size_t n, const double* __restrict rows, const double* __restrict x,
               const double* __restrict v) {
  const double* __restrict ax = rows;
  const double* __restrict av = rows + n;
  const double* __restrict bx = rows + 2 * n;
  const double* __restrict bv = rows + 3 * n;
  const double* __restrict cx = rows + 4 * n;
  const double* __restrict cv = rows + 5 * n;
  const double* __restrict dx = rows + 6 * n;
  const double* __restrict dv = rows + 7 * n;
  double a[kLanes] = {}, b[kLanes] = {}, c[kLanes] = {}, d[kLanes] = {};
  std::size_t i = 0;
  for (; i + kLanes <= n; i += kLanes) {
    for (std::size_t j = 0; j < kLanes; ++j) {
      a[j] += ax[i + j] * x[i + j] + av[i + j] * v[i + j];
      b[j] += bx[i + j] * x[i + j] + bv[i + j] * v[i + j];
      c[j] += cx[i + j] * x[i + j] + cv[i + j] * v[i + j];
      d[j] += dx[i + j] * x[i + j] + dv[i + j] * v[i + j];
    }
  }
  for (std::size_t j = 0; i < n; ++i, ++j) {
    a[j] += ax[i] * x[i] + av[i] * v[i];
    b[j] += bx[i] * x[i] + bv[i] * v[i];
    c[j] += cx[i] * x[i] + cv[i] * v[i];
    d[j] += dx[i] * x[i] + dv[i] * v[i];
  }
  return {{total(a), total(b), total(c), total(d)}};
}

double reach(std::size_t n, const double* __restrict shape, const double* __restrict stiffness,
             const double* __restrict x, const double* __restrict v) {
  double part[kLanes] = {};
  std::size_t i = 0;
  const auto term = [&](std::size_t m) {
    const double k = stiffness[m];
    const double flexible = k > 0.0 ? 1.0 : 0.0;
    return flexible * std::fabs(shape[m]) * std::sqrt(x[m] * x[m] + v[m] * v[m] / (k + 1e-300));
  };
  for (; i + kLanes <= n; i += kLanes) {
    for (std::size_t j = 0; j < kLanes; ++j) part[j] += term(i + j);
  }
  for (std::size_t j = 0; i < n; ++i, ++j) part[j] += term(i);
  return total(part);
}

}  // namespace feltmb::modal
