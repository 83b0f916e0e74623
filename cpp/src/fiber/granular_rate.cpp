#include "feltmb/fiber/granular_rate.hpp"

#include <Eigen/Dense>
#include <cmath>
#include <numbers>

#include "feltmb/fiber/faults.hpp"

namespace feltmb {
namespace {

/// 1/(1/a + 1/b), 0 when either is 0.
double in_series(double a, double b) { return a > 0.0 && b > 0.0 ? a * b / (a + b) : 0.0; }

}  // namespace

Eigen::Matrix3d granular_stress_rate(const GranularParams& params, const FiberStructure& structure,
                                     double v_f, const Eigen::Matrix3d& stress,
                                     const Eigen::Matrix3d& gradient) {
  const double pi2 = std::numbers::pi * std::numbers::pi;
  const double f2v3 = structure.f * structure.f * v_f * v_f * v_f;
  const double bending =
      256.0 * params.k_b * f2v3 * structure.f * structure.f * v_f * v_f / (pi2 * pi2);
  const double normal = params.E * bending;
  const double axial =
      params.E * params.beta * params.beta * in_series(params.k_t * f2v3 / pi2, bending / 3.0);
  const double transverse =
      params.transverse ? params.E * in_series(3.0 * params.k_t * f2v3 / pi2, bending) : 0.0;
  Eigen::Matrix3d rate =
      -gradient.trace() * stress + stress * gradient.transpose() + gradient * stress;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      for (int k = 0; k < 3; ++k) {
        for (int l = 0; l < 3; ++l) {
          rate(i, j) +=
              gradient(k, l) * (normal * component(structure.nnnn_contact, i, j, k, l) +
                                axial * component(structure.eeee_contact, i, j, k, l) +
                                transverse * component(structure.tttt_contact, i, j, k, l));
        }
      }
    }
  }
  return rate;
}

std::vector<Eigen::Matrix3d> granular_stress_path(const GranularParams& params, double v_random,
                                                  const std::vector<Eigen::Matrix3d>& path,
                                                  std::size_t substeps, std::size_t nodes) {
  Faults faults("granular rate theory");
  faults.positive("E", params.E, "Pa");
  faults.not_negative("k_b", params.k_b, "");
  faults.not_negative("k_t", params.k_t, "");
  faults.not_negative("beta", params.beta, "");
  faults.positive("v_random", v_random, "");
  faults.within("substeps", static_cast<double>(substeps), 1, 1e6, "");
  faults.within("nodes", static_cast<double>(nodes), 8, 128, "");
  if (path.size() < 2) {
    faults.add("number of deformation gradients", static_cast<double>(path.size()), "", ">= 2");
  }
  for (std::size_t i = 0; i < path.size(); ++i) {
    const double determinant = path[i].determinant();
    if (!(determinant > 0.0) || !(v_random / determinant < 1.0)) {
      faults.add(format("det F[%zu]", i).c_str(), determinant, "",
                 format("> %.6g, so that v_f stays below 1", std::max(0.0, v_random)));
    }
  }
  faults.raise_if_any();
  const OrientationQuadrature quadrature(nodes, 2 * nodes, 2 * nodes);
  const Directions directions = quadrature.directions();
  const auto rate = [&](const Eigen::Matrix3d& deformation, const Eigen::Matrix3d& change,
                        const Eigen::Matrix3d& stress) {
    const Eigen::VectorXd density = affine_density(deformation, directions);
    const FiberStructure structure =
        quadrature.compute({density.data(), static_cast<std::size_t>(density.size())});
    return granular_stress_rate(params, structure, v_random / deformation.determinant(), stress,
                                change * deformation.inverse());
  };
  std::vector<Eigen::Matrix3d> result{Eigen::Matrix3d::Zero()};
  Eigen::Matrix3d stress = Eigen::Matrix3d::Zero();
  for (std::size_t i = 0; i + 1 < path.size(); ++i) {
    const Eigen::Matrix3d change = path[i + 1] - path[i];
    const double h = 1.0 / static_cast<double>(substeps);
    for (std::size_t step = 0; step < substeps; ++step) {
      const Eigen::Matrix3d start = path[i] + change * (h * static_cast<double>(step));
      const Eigen::Matrix3d middle = start + 0.5 * h * change;
      const Eigen::Matrix3d end = start + h * change;
      const Eigen::Matrix3d k1 = rate(start, change, stress);
      const Eigen::Matrix3d k2 = rate(middle, change, stress + 0.5 * h * k1);
      const Eigen::Matrix3d k3 = rate(middle, change, stress + 0.5 * h * k2);
      const Eigen::Matrix3d k4 = rate(end, change, stress + h * k3);
      stress += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4);
    }
    result.push_back(stress);
  }
  return result;
}

}  // namespace feltmb
