/// LU factors of small dense matrices, laid out for the vector unit.
#pragma once

#include <cstddef>
#include <utility>
#include <vector>

namespace feltmb {

/// P A = L U with partial pivoting (G. H. Golub, C. F. Van Loan, Matrix Computations, 3.4), for the
/// matrices of some tens of rows that a Newton iteration factorises and solves thousands of times.
/// By columns, each padded to whole blocks of four: every inner loop is elementwise over full
/// blocks, so all clones of the kernels give the same bits. Nothing is allocated once the largest
/// size was seen.
class DenseLu {
 public:
  static constexpr std::size_t kBlock = 4;

  /// Rows of a padded column of n.
  static std::size_t padded(std::size_t n) { return (n + kBlock - 1) / kBlock * kBlock; }

  void resize(std::size_t n);
  std::size_t size() const { return n_; }
  std::size_t stride() const { return stride_; }  ///< between columns

  /// The matrix to be factorised; the padding must stay zero.
  double& operator()(std::size_t row, std::size_t column) { return upper_[column * stride_ + row]; }
  double* column(std::size_t j) { return upper_.data() + j * stride_; }

  /// Factorises in place; false if a pivot is zero or something is not finite.
  bool factorize();

  /// Solves A x = b in place; `b` holds stride() values, those beyond size() are scratch.
  void solve(double* b) const;

  /// The same for rows of right-hand sides side by side: b.row(i) are vectors.
  template <class Block>
  void solve_rows(Block& b) const {
    const auto at = [](std::size_t i) { return static_cast<std::ptrdiff_t>(i); };
    for (std::size_t k = 0; k < n_; ++k) {
      if (pivot_[k] != k) b.row(at(k)).swap(b.row(at(pivot_[k])));
    }
    for (std::size_t j = 0; j < n_; ++j) {
      for (std::size_t i = j + 1; i < n_; ++i) {
        b.row(at(i)) -= lower_[j * stride_ + i] * b.row(at(j));
      }
    }
    for (std::size_t j = n_; j-- > 0;) {
      b.row(at(j)) *= inverse_[j];
      for (std::size_t i = 0; i < j; ++i) {
        b.row(at(i)) -= upper_[j * stride_ + i] * b.row(at(j));
      }
    }
  }

 private:
  std::size_t n_ = 0;
  std::size_t stride_ = 0;
  std::vector<double> upper_;       ///< the matrix, then U without its diagonal, zeros below
  std::vector<double> lower_;       ///< L without its diagonal, zeros above
  std::vector<double> inverse_;     ///< of the diagonal of U
  std::vector<std::size_t> pivot_;  ///< row exchanged with row k in step k
};

/// out = sum over j < columns of x[j] A_j + y[j] B_j, columns of `stride` values (whole blocks).
void add_products(std::size_t columns, std::size_t stride, const double* a, const double* x,
                  const double* b, const double* y, double* out);

}  // namespace feltmb
