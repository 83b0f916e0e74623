#include "feltmb/numeric/eigenproblem.hpp"

#include <Eigen/Eigenvalues>

namespace feltmb {
namespace {

template <class Solver>
Eigenpairs pairs_of(const Solver& solver) {
  return {solver.eigenvalues(), solver.eigenvectors(), solver.info() == Eigen::Success};
}

}  // namespace

Eigenpairs symmetric_eigenpairs(const Eigen::MatrixXd& a) {
  return pairs_of(Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(a));
}

Eigenpairs symmetric_eigenpairs(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b) {
  return pairs_of(Eigen::GeneralizedSelfAdjointEigenSolver<Eigen::MatrixXd>(a, b));
}

}  // namespace feltmb
