/// LU factors of small dense matrices, laid out for the vector unit.
#pragma once

#include <cstddef>
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

  /// The same for `columns` right-hand sides side by side: row i begins at b + i * stride.
  void solve_rows(double* b, std::size_t columns, std::size_t stride) const;

 private:
  std::size_t n_ = 0;
  std::size_t stride_ = 0;
  std::vector<double> upper_;       ///< the matrix, then U without its diagonal, zeros below
  std::vector<double> lower_;       ///< L without its diagonal, zeros above
  std::vector<double> inverse_;     ///< of the diagonal of U
  std::vector<std::size_t> pivot_;  ///< row exchanged with row k in step k
  bool exchanged_ = false;          ///< a pivot was not the diagonal
};

/// out = sum over j < columns of x[j] A_j + y[j] B_j, columns of `stride` values (whole blocks).
void add_products(std::size_t columns, std::size_t stride, const double* a, const double* x,
                  const double* b, const double* y, double* out);

/// out += sum over j < columns of x[j] A_j, columns of `stride` values (whole blocks).
void add_columns(std::size_t columns, std::size_t stride, const double* a, const double* x,
                 double* out);

/// Row i of out += scale sum over j of A(i, j) row j of x, for square A (n, n) stored by columns
/// and rows of `columns` numbers, `stride` apart. Zeros of A cost nothing.
void add_row_products(std::size_t n, const double* a, double scale, const double* x,
                      std::size_t columns, std::size_t stride, double* out, std::size_t out_stride);

}  // namespace feltmb
