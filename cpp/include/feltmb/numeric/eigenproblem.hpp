/// Symmetric eigenproblems of dense matrices. Eigen's templates for them are compiled here only.
#pragma once

#include <Eigen/Core>

namespace feltmb {

struct Eigenpairs {
  Eigen::VectorXd values;   ///< in rising order
  Eigen::MatrixXd vectors;  ///< one a column
  bool found = false;       ///< the iteration converged
};

/// A x = lambda x, with vectors of length one.
Eigenpairs symmetric_eigenpairs(const Eigen::MatrixXd& a);

/// A x = lambda B x with B positive definite, with x^T B x = 1.
Eigenpairs symmetric_eigenpairs(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b);

}  // namespace feltmb
