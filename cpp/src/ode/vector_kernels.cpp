#include "vector_kernels.hpp"

#include <cmath>

#include "feltmb/core/multiversion.hpp"

namespace feltmb::detail {
namespace {

double* data(N_Vector v) { return NV_DATA_S(v); }
sunindextype length(N_Vector v) { return NV_LENGTH_S(v); }

// Vectors are the same or apart, never shifted: no loop carries anything from turn to turn. The
// operations themselves are multiversioned, since vectors are short and calls count.
#if defined(__GNUC__) && !defined(__clang__)
#define FELTMB_APART _Pragma("GCC ivdep")
#else
#define FELTMB_APART
#endif

inline void linear_sum(sunindextype n, double a, const double* x, double b, const double* y,
                       double* z) {
  FELTMB_APART for (sunindextype i = 0; i < n; ++i) z[i] = a * x[i] + b * y[i];
}

inline void add_scaled(sunindextype n, double a, const double* x, double* z) {
  FELTMB_APART for (sunindextype i = 0; i < n; ++i) z[i] += a * x[i];
}

inline void add_two(sunindextype n, double a, const double* x, double b, const double* y,
                    double* z) {
  FELTMB_APART for (sunindextype i = 0; i < n; ++i) z[i] += a * x[i] + b * y[i];
}

inline void scale(sunindextype n, double c, const double* x, double* z) {
  FELTMB_APART for (sunindextype i = 0; i < n; ++i) z[i] = c * x[i];
}

FELTMB_CLONES void product(sunindextype n, const double* x, const double* y, double* z) {
  for (sunindextype i = 0; i < n; ++i) z[i] = x[i] * y[i];
}

FELTMB_CLONES void quotient(sunindextype n, const double* x, const double* y, double* z) {
  for (sunindextype i = 0; i < n; ++i) z[i] = x[i] / y[i];
}

FELTMB_CLONES void absolute(sunindextype n, const double* x, double* z) {
  for (sunindextype i = 0; i < n; ++i) z[i] = std::fabs(x[i]);
}

FELTMB_CLONES void inverse(sunindextype n, const double* x, double* z) {
  for (sunindextype i = 0; i < n; ++i) z[i] = 1.0 / x[i];
}

FELTMB_CLONES void add_constant(sunindextype n, const double* x, double b, double* z) {
  for (sunindextype i = 0; i < n; ++i) z[i] = x[i] + b;
}

FELTMB_CLONES void constant(sunindextype n, double c, double* z) {
  for (sunindextype i = 0; i < n; ++i) z[i] = c;
}

inline double square_sum(sunindextype n, const double* x, const double* w) {
  double part[8] = {};
  sunindextype i = 0;
  for (; i + 8 <= n; i += 8) {
    for (int j = 0; j < 8; ++j) {
      const double p = x[i + j] * w[i + j];
      part[j] += p * p;
    }
  }
  for (; i < n; ++i) {
    const double p = x[i] * w[i];
    part[i % 8] += p * p;
  }
  return ((part[0] + part[4]) + (part[1] + part[5])) + ((part[2] + part[6]) + (part[3] + part[7]));
}

FELTMB_CLONES double max_norm(sunindextype n, const double* x) {
  double largest = 0.0;
  for (sunindextype i = 0; i < n; ++i) {
    const double v = std::fabs(x[i]);
    largest = v > largest ? v : largest;
  }
  return largest;
}

FELTMB_CLONES void op_linear_sum(double a, N_Vector x, double b, N_Vector y, N_Vector z) {
  if (a == 1.0 && y == z && b == 1.0) return add_scaled(length(x), 1.0, data(x), data(z));
  if (b == 1.0 && y == z) return add_scaled(length(x), a, data(x), data(z));
  if (a == 1.0 && x == z) return add_scaled(length(x), b, data(y), data(z));
  linear_sum(length(x), a, data(x), b, data(y), data(z));
}
void op_const(double c, N_Vector z) { constant(length(z), c, data(z)); }
void op_prod(N_Vector x, N_Vector y, N_Vector z) { product(length(x), data(x), data(y), data(z)); }
void op_div(N_Vector x, N_Vector y, N_Vector z) { quotient(length(x), data(x), data(y), data(z)); }
FELTMB_CLONES void op_scale(double c, N_Vector x, N_Vector z) {
  scale(length(x), c, data(x), data(z));
}
void op_abs(N_Vector x, N_Vector z) { absolute(length(x), data(x), data(z)); }
void op_inv(N_Vector x, N_Vector z) { inverse(length(x), data(x), data(z)); }
void op_addconst(N_Vector x, double b, N_Vector z) { add_constant(length(x), data(x), b, data(z)); }
double op_maxnorm(N_Vector x) { return max_norm(length(x), data(x)); }
FELTMB_CLONES double op_wrmsnorm(N_Vector x, N_Vector w) {
  return std::sqrt(square_sum(length(x), data(x), data(w)) / static_cast<double>(length(x)));
}

FELTMB_CLONES int op_linear_combination(int nvec, double* c, N_Vector* x, N_Vector z) {
  const sunindextype n = length(z);
  int next = 1;
  if (x[0] == z) {
    if (c[0] != 1.0) scale(n, c[0], data(z), data(z));
  } else if (nvec > 1) {
    linear_sum(n, c[0], data(x[0]), c[1], data(x[1]), data(z));
    next = 2;
  } else {
    scale(n, c[0], data(x[0]), data(z));
  }
  for (; next + 1 < nvec; next += 2) {
    add_two(n, c[next], data(x[next]), c[next + 1], data(x[next + 1]), data(z));
  }
  if (next < nvec) add_scaled(n, c[next], data(x[next]), data(z));
  return 0;
}

FELTMB_CLONES int op_scale_add_multi(int nvec, double* a, N_Vector x, N_Vector* y, N_Vector* z) {
  const sunindextype n = length(x);
  for (int j = 0; j < nvec; ++j) {
    if (y[j] == z[j]) {
      add_scaled(n, a[j], data(x), data(z[j]));
    } else {
      linear_sum(n, a[j], data(x), 1.0, data(y[j]), data(z[j]));
    }
  }
  return 0;
}

}  // namespace

N_Vector make_vector(sunindextype size, SUNContext context) {
  N_Vector v = N_VNew_Serial(size, context);
  if (v == nullptr) return nullptr;
  v->ops->nvlinearsum = op_linear_sum;
  v->ops->nvconst = op_const;
  v->ops->nvprod = op_prod;
  v->ops->nvdiv = op_div;
  v->ops->nvscale = op_scale;
  v->ops->nvabs = op_abs;
  v->ops->nvinv = op_inv;
  v->ops->nvaddconst = op_addconst;
  v->ops->nvmaxnorm = op_maxnorm;
  v->ops->nvwrmsnorm = op_wrmsnorm;
  v->ops->nvlinearcombination = op_linear_combination;
  v->ops->nvscaleaddmulti = op_scale_add_multi;
  return v;
}

}  // namespace feltmb::detail
