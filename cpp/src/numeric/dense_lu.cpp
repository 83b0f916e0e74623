#include "feltmb/numeric/dense_lu.hpp"

#include <algorithm>
#include <cmath>

#include "feltmb/core/multiversion.hpp"

namespace feltmb {
namespace {

constexpr std::size_t kBlock = DenseLu::kBlock;

#if defined(__GNUC__)
/// Four numbers side by side, wherever they lie; clones without the wide registers take halves.
using Four = double __attribute__((vector_size(32), aligned(8), may_alias));
#else
struct Four {
  double v[4];
  Four& operator+=(const Four& b) {
    for (int i = 0; i < 4; ++i) v[i] += b.v[i];
    return *this;
  }
  Four& operator-=(const Four& b) {
    for (int i = 0; i < 4; ++i) v[i] -= b.v[i];
    return *this;
  }
  friend Four operator+(Four a, const Four& b) { return a += b; }
  friend Four operator*(double k, Four a) {
    for (int i = 0; i < 4; ++i) a.v[i] *= k;
    return a;
  }
};
#endif

const Four& four(const double* p) { return *reinterpret_cast<const Four*>(p); }
Four& four(double* p) { return *reinterpret_cast<Four*>(p); }

/// The rows i ... i + 3 of a column at step k: those below row k, times `inverse`, become
/// multipliers, those above stay, and zeros take the place of the others.
inline void split_block(std::size_t k, std::size_t i, double inverse, double* column,
                        double* multiplier) {
#if defined(__GNUC__)
  using Mask = long long __attribute__((vector_size(32)));
  const auto first = static_cast<long long>(i);
  const auto pivot = static_cast<long long>(k);
  const Mask row{first, first + 1, first + 2, first + 3};
  const Four own = four(column + i);
  const Four scaled = inverse * own;
  four(multiplier + i) = reinterpret_cast<Four>(reinterpret_cast<Mask>(scaled) & (row > pivot));
  four(column + i) = reinterpret_cast<Four>(reinterpret_cast<Mask>(own) & (row < pivot));
#else
  for (std::size_t j = i; j < i + kBlock; ++j) {
    multiplier[j] = j > k ? inverse * column[j] : 0.0;
    if (j >= k) column[j] = 0.0;
  }
#endif
}

/// Where the block of row i begins.
inline std::size_t block(std::size_t i) { return i / kBlock * kBlock; }

FELTMB_CLONES bool factorize_columns(std::size_t n, std::size_t stride, double* __restrict a,
                                     double* __restrict lower, double* __restrict inverse,
                                     std::size_t* __restrict pivot) {
  double sum[kBlock] = {};
  for (std::size_t i = 0; i < n * stride; i += kBlock) four(sum) += 0.0 * four(a + i);
  if (!(sum[0] + sum[1] + sum[2] + sum[3] == 0.0)) return false;  // something is not finite
  for (std::size_t k = 0; k < n; ++k) {
    double* own = a + k * stride;
    double* multiplier = lower + k * stride;
    std::size_t best = k;
    double most = std::fabs(own[k]);
    for (std::size_t i = k + 1; i < n; ++i) {
      const double v = std::fabs(own[i]);
      if (v > most) {
        most = v;
        best = i;
      }
    }
    if (!(most > 0.0)) return false;
    pivot[k] = best;
    if (best != k) {
      for (std::size_t j = 0; j < n; ++j) std::swap(a[j * stride + k], a[j * stride + best]);
      for (std::size_t j = 0; j < k; ++j) {
        std::swap(lower[j * stride + k], lower[j * stride + best]);
      }
    }
    inverse[k] = 1.0 / own[k];
    // The multipliers, with zeros down to row k: rows above in the same block stay as they are.
    // What is left of the column is that of U, without the diagonal. Whole blocks are written,
    // since whole blocks are read next.
    const std::size_t own_block = block(k);
    for (std::size_t i = 0; i < own_block; i += kBlock) four(multiplier + i) = Four{};
    for (std::size_t i = own_block; i < stride; i += kBlock) {
      split_block(k, i, inverse[k], own, multiplier);
    }
    const std::size_t from = block(k + 1);
    for (std::size_t j = k + 1; j < n; ++j) {
      double* other = a + j * stride;
      const double x = other[k];
      if (x == 0.0) continue;
      for (std::size_t i = from; i < stride; i += kBlock) {
        four(other + i) -= x * four(multiplier + i);
      }
    }
  }
  return true;
}

FELTMB_CLONES void solve_columns(std::size_t n, std::size_t stride, const double* upper,
                                 const double* lower, const double* inverse, double* b) {
  for (std::size_t j = 0; j + 1 < n; ++j) {
    const double x = b[j];
    const double* column = lower + j * stride;
    for (std::size_t i = block(j + 1); i < stride; i += kBlock) {
      four(b + i) -= x * four(column + i);
    }
  }
  for (std::size_t j = n; j-- > 0;) {
    const double x = b[j] * inverse[j];
    const double* column = upper + j * stride;
    for (std::size_t i = 0; i < j; i += kBlock) four(b + i) -= x * four(column + i);
    b[j] = x;
  }
}

#if defined(__GNUC__)
#define FELTMB_INLINE __attribute__((always_inline)) inline

/// The same for up to 4 `blocks` unknowns, all in registers: step after step needs the number that
/// the one before has left, which a way through memory would hold up.
template <std::size_t J, std::size_t blocks>
FELTMB_INLINE void forward_step(std::size_t n, std::size_t stride, const double* lower,
                                Four (&r)[blocks]) {
  if constexpr (J + 1 < kBlock * blocks) {
    if (J + 1 >= n) return;
    const double x = r[J / kBlock][J % kBlock];
    for (std::size_t i = (J + 1) / kBlock; i < blocks; ++i) {
      r[i] -= x * four(lower + J * stride + i * kBlock);
    }
    forward_step<J + 1, blocks>(n, stride, lower, r);
  }
}

template <std::size_t J, std::size_t blocks>
FELTMB_INLINE void backward_step(std::size_t n, std::size_t stride, const double* upper,
                                 const double* inverse, double* b, Four (&r)[blocks]) {
  if (J < n) {
    const double x = r[J / kBlock][J % kBlock] * inverse[J];
    for (std::size_t i = 0; i * kBlock < J; ++i) {
      r[i] -= x * four(upper + J * stride + i * kBlock);
    }
    b[J] = x;
  }
  if constexpr (J > 0) backward_step<J - 1, blocks>(n, stride, upper, inverse, b, r);
}

template <std::size_t blocks>
FELTMB_INLINE void solve_in_registers(std::size_t n, const double* upper, const double* lower,
                                      const double* inverse, double* b) {
  constexpr std::size_t stride = kBlock * blocks;
  Four r[blocks];
  for (std::size_t i = 0; i < blocks; ++i) r[i] = four(b + i * kBlock);
  forward_step<0, blocks>(n, stride, lower, r);
  backward_step<stride - 1, blocks>(n, stride, upper, inverse, b, r);
}

FELTMB_CLONES void solve_few(std::size_t n, std::size_t stride, const double* upper,
                             const double* lower, const double* inverse, double* b) {
  if (stride == kBlock) return solve_in_registers<1>(n, upper, lower, inverse, b);
  if (stride == 2 * kBlock) return solve_in_registers<2>(n, upper, lower, inverse, b);
  if (stride == 3 * kBlock) return solve_in_registers<3>(n, upper, lower, inverse, b);
  solve_in_registers<4>(n, upper, lower, inverse, b);
}
#else
void solve_few(std::size_t n, std::size_t stride, const double* upper, const double* lower,
               const double* inverse, double* b) {
  solve_columns(n, stride, upper, lower, inverse, b);
}
#endif

FELTMB_CLONES void products(std::size_t columns, std::size_t stride, const double* a,
                            const double* x, const double* b, const double* y, double* out) {
  for (std::size_t i = 0; i < stride; i += kBlock) {
    Four first{}, second{};
    for (std::size_t k = 0; k < columns; ++k) {
      first += x[k] * four(a + k * stride + i);
      second += y[k] * four(b + k * stride + i);
    }
    four(out + i) = first + second;
  }
}

FELTMB_CLONES void sum_columns(std::size_t columns, std::size_t stride, const double* a,
                               const double* x, double* out) {
  for (std::size_t i = 0; i < stride; i += kBlock) {
    Four sum = four(out + i);
    for (std::size_t k = 0; k < columns; ++k) sum += x[k] * four(a + k * stride + i);
    four(out + i) = sum;
  }
}

/// Row of y += k times row of x.
inline void add_row(std::size_t count, double k, const double* __restrict x, double* __restrict y) {
  for (std::size_t c = 0; c < count; ++c) y[c] += k * x[c];
}

FELTMB_CLONES void solve_all_rows(std::size_t n, std::size_t stride, const double* upper,
                                  const double* lower, const double* inverse,
                                  const std::size_t* pivot, double* b, std::size_t columns,
                                  std::size_t row) {
  for (std::size_t k = 0; k < n; ++k) {
    if (pivot[k] == k) continue;
    for (std::size_t c = 0; c < columns; ++c) std::swap(b[k * row + c], b[pivot[k] * row + c]);
  }
  // The tree leaves many factors zero.
  for (std::size_t j = 0; j < n; ++j) {
    for (std::size_t i = j + 1; i < n; ++i) {
      const double factor = lower[j * stride + i];
      if (factor != 0.0) add_row(columns, -factor, b + j * row, b + i * row);
    }
  }
  for (std::size_t j = n; j-- > 0;) {
    double* own = b + j * row;
    for (std::size_t c = 0; c < columns; ++c) own[c] *= inverse[j];
    for (std::size_t i = 0; i < j; ++i) {
      const double factor = upper[j * stride + i];
      if (factor != 0.0) add_row(columns, -factor, own, b + i * row);
    }
  }
}

FELTMB_CLONES void row_products(std::size_t n, const double* a, double scale, const double* x,
                                std::size_t columns, std::size_t stride, double* out,
                                std::size_t out_stride) {
  for (std::size_t j = 0; j < n; ++j) {
    for (std::size_t i = 0; i < n; ++i) {
      const double factor = scale * a[j * n + i];
      if (factor != 0.0) add_row(columns, factor, x + j * stride, out + i * out_stride);
    }
  }
}

}  // namespace

void DenseLu::resize(std::size_t n) {
  n_ = n;
  stride_ = padded(n);
  upper_.assign(n * stride_, 0.0);
  lower_.resize(n * stride_);
  inverse_.resize(n);
  pivot_.resize(n);
}

bool DenseLu::factorize() {
  const bool regular =
      factorize_columns(n_, stride_, upper_.data(), lower_.data(), inverse_.data(), pivot_.data());
  exchanged_ = false;
  for (std::size_t k = 0; k < n_; ++k) exchanged_ = exchanged_ || pivot_[k] != k;
  return regular;
}

void DenseLu::solve(double* b) const {
  if (n_ == 0) return;
  if (exchanged_) {
    for (std::size_t k = 0; k < n_; ++k) std::swap(b[k], b[pivot_[k]]);
  }
  if (stride_ <= 4 * kBlock) {
    solve_few(n_, stride_, upper_.data(), lower_.data(), inverse_.data(), b);
  } else {
    solve_columns(n_, stride_, upper_.data(), lower_.data(), inverse_.data(), b);
  }
}

void DenseLu::solve_rows(double* b, std::size_t columns, std::size_t stride) const {
  solve_all_rows(n_, stride_, upper_.data(), lower_.data(), inverse_.data(), pivot_.data(), b,
                 columns, stride);
}

void add_row_products(std::size_t n, const double* a, double scale, const double* x,
                      std::size_t columns, std::size_t stride, double* out,
                      std::size_t out_stride) {
  row_products(n, a, scale, x, columns, stride, out, out_stride);
}

void add_columns(std::size_t columns, std::size_t stride, const double* a, const double* x,
                 double* out) {
  if (columns > 0) sum_columns(columns, stride, a, x, out);
}

void add_products(std::size_t columns, std::size_t stride, const double* a, const double* x,
                  const double* b, const double* y, double* out) {
  products(columns, stride, a, x, b, y, out);
}

}  // namespace feltmb
