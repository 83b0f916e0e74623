#include <Eigen/Dense>

#include "feltmb/fiber/faults.hpp"
#include "feltmb/fiber/orientation.hpp"
#include "feltmb/numeric/eigenproblem.hpp"

namespace feltmb {
Eigen::Matrix<double, 6, 6> narter_stiffness(const Tensor4& eeee, double stiffness) {
  Faults faults("narter");
  faults.positive("K", stiffness, "Pa");
  faults.raise_if_any();
  constexpr int kPairs[6][2] = {{0, 0}, {1, 1}, {2, 2}, {0, 1}, {0, 2}, {1, 2}};
  Eigen::Matrix<double, 6, 6> result;
  for (int i = 0; i < 6; ++i) {
    for (int j = 0; j < 6; ++j) {
      result(i, j) =
          stiffness * component(eeee, kPairs[i][0], kPairs[i][1], kPairs[j][0], kPairs[j][1]);
    }
  }
  return result;
}

Eigen::Matrix<double, 6, 6> narter_compliance(const Eigen::Matrix<double, 6, 6>& stiffness) {
  const Eigen::VectorXd values = symmetric_eigenpairs(stiffness).values;
  const double smallest = values.minCoeff();
  const double largest = values.maxCoeff();
  if (!(smallest > 1e-12 * largest)) {
    throw InvalidParameter(
        format("narter: smallest eigenvalue of the stiffness = %.6g Pa, must be > 0 (planar or "
               "parallel fibers carry no load across; use a spatial orientation)",
               smallest));
  }
  return stiffness.inverse();
}

EngineeringModuli engineering_moduli(const Eigen::Matrix<double, 6, 6>& c) {
  EngineeringModuli result{};
  for (std::size_t i = 0; i < 3; ++i) {
    const auto k = static_cast<Eigen::Index>(i);
    result.young[i] = 1.0 / c(k, k);
    result.shear[i] = 1.0 / c(k + 3, k + 3);
  }
  // nu_ij = -(strain j) / (strain i) under stress along i.
  result.poisson = {-c(1, 0) / c(0, 0), -c(2, 0) / c(0, 0), -c(0, 1) / c(1, 1),
                    -c(2, 1) / c(1, 1), -c(0, 2) / c(2, 2), -c(1, 2) / c(2, 2)};
  return result;
}

}  // namespace feltmb
