#include <doctest/doctest.h>

#include <Eigen/Dense>
#include <cmath>
#include <limits>

#include "feltmb/numeric/dense_lu.hpp"

using feltmb::DenseLu;

namespace {

/// Entries in [-1, 1), the diagonal of every third matrix zero so that rows must be exchanged.
Eigen::MatrixXd some_matrix(int n, unsigned seed) {
  std::srand(seed);
  Eigen::MatrixXd a = Eigen::MatrixXd::Random(n, n);
  if (n > 1 && seed % 3 == 0) a.diagonal().setZero();
  return a;
}

DenseLu loaded(const Eigen::MatrixXd& a) {
  DenseLu lu;
  lu.resize(static_cast<std::size_t>(a.rows()));
  for (Eigen::Index j = 0; j < a.cols(); ++j) {
    for (Eigen::Index i = 0; i < a.rows(); ++i) {
      lu(static_cast<std::size_t>(i), static_cast<std::size_t>(j)) = a(i, j);
    }
  }
  return lu;
}

}  // namespace

TEST_CASE("dense LU: residual at rounding for every size around whole blocks") {
  for (int n = 1; n <= 21; ++n) {
    for (unsigned seed = 1; seed <= 6; ++seed) {
      const Eigen::MatrixXd a = some_matrix(n, 100 * static_cast<unsigned>(n) + seed);
      const Eigen::VectorXd b = Eigen::VectorXd::LinSpaced(n, -1.0, 2.0);
      DenseLu lu = loaded(a);
      REQUIRE(lu.factorize());
      Eigen::VectorXd x = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(lu.stride()));
      x.head(n) = b;
      lu.solve(x.data());
      // Backward error of elimination with partial pivoting.
      const double scale = a.norm() * x.head(n).norm() + b.norm();
      CHECK((a * x.head(n) - b).norm() < 1e-14 * scale);

      Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> rows(n, 2);
      rows << b, -2.0 * b;
      lu.solve_rows(rows.data(), 2, 2);
      CHECK((a * rows.col(1) + 2.0 * b).norm() < 2e-14 * scale);
    }
  }
}

TEST_CASE("dense LU: singular matrices and numbers that are not finite are refused") {
  DenseLu zero = loaded(Eigen::MatrixXd::Zero(5, 5));
  CHECK_FALSE(zero.factorize());
  Eigen::MatrixXd rank = Eigen::MatrixXd::Ones(4, 4);
  DenseLu one = loaded(rank);
  CHECK_FALSE(one.factorize());
  for (const double bad :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    for (int place = 0; place < 9; ++place) {
      Eigen::MatrixXd a = Eigen::MatrixXd::Identity(3, 3);
      a(place / 3, place % 3) = bad;
      DenseLu lu = loaded(a);
      CHECK_FALSE(lu.factorize());
    }
  }
}

TEST_CASE("rows of many right-hand sides: products and solutions, with zeros and spare columns") {
  using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  for (const int columns : {1, 3, 4, 7, 30}) {
    const int n = 9;
    Eigen::MatrixXd a = Eigen::MatrixXd::Random(n, n);
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < n; ++j) {
        if ((i + 2 * j) % 3 == 0 && i != j) a(i, j) = 0.0;
      }
      a(i, (i + 3) % n) += 3.0;  // pivots off the diagonal
    }
    const Rows x = Rows::Random(n, columns);
    Rows b = Rows::Zero(n, columns + 2);
    b.rightCols(2).setConstant(5.0);
    const auto width = static_cast<std::size_t>(columns);
    feltmb::add_row_products(n, a.data(), -0.5, x.data(), width, width, b.data(), width + 2);
    CHECK((b.leftCols(columns) + 0.5 * a * x).norm() < 1e-13);
    DenseLu lu = loaded(a);
    REQUIRE(lu.factorize());
    lu.solve_rows(b.data(), width, width + 2);
    CHECK((b.leftCols(columns) + 0.5 * x).norm() < 1e-12);
    CHECK((b.rightCols(2).array() == 5.0).all());
  }
}

TEST_CASE("two products at once are the sum of both") {
  const int n = 7;
  const auto stride = static_cast<Eigen::Index>(DenseLu::padded(n));
  Eigen::MatrixXd a = Eigen::MatrixXd::Zero(stride, n);
  Eigen::MatrixXd b = a;
  a.topRows(n) = some_matrix(n, 1);
  b.topRows(n) = some_matrix(n, 2);
  const Eigen::VectorXd x = Eigen::VectorXd::LinSpaced(n, 1.0, 2.0);
  const Eigen::VectorXd y = Eigen::VectorXd::LinSpaced(n, -3.0, 1.0);
  Eigen::VectorXd out(stride);
  feltmb::add_products(n, DenseLu::padded(n), a.data(), x.data(), b.data(), y.data(), out.data());
  CHECK((out - (a * x + b * y)).norm() < 1e-14);
}
