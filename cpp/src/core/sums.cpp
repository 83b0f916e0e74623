#include "feltmb/core/sums.hpp"

#include <cmath>

namespace feltmb {
namespace {

constexpr std::size_t kLanes = 8;

/// Sum of term(i) in kLanes partial sums.
template <class Term>
inline __attribute__((always_inline)) double lanes(std::size_t n, Term&& term) {
  double part[kLanes] = {};
  std::size_t i = 0;
  for (; i + kLanes <= n; i += kLanes) {
    for (std::size_t j = 0; j < kLanes; ++j) part[j] += term(i + j);
  }
  for (std::size_t j = 0; i < n; ++i, ++j) part[j] += term(i);
  return ((part[0] + part[4]) + (part[1] + part[5])) + ((part[2] + part[6]) + (part[3] + part[7]));
}

}  // namespace

double sum_absolute(std::size_t n, const double* __restrict x) {
  return lanes(n, [=](std::size_t i) { return std::fabs(x[i]); });
}

double sum_squares(std::size_t n, const double* __restrict x) {
  return lanes(n, [=](std::size_t i) { return x[i] * x[i]; });
}

double sum_products(std::size_t n, const double* __restrict x, const double* __restrict y) {
  return lanes(n, [=](std::size_t i) { return x[i] * y[i]; });
}

double sum_weighted_squares(std::size_t n, const double* __restrict w, const double* __restrict x) {
  return lanes(n, [=](std::size_t i) { return w[i] * x[i] * x[i]; });
}

}  // namespace feltmb
