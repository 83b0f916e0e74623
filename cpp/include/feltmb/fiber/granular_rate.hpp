/// Rate theory of granular fiber networks in tensor form (Alkhagen and Toll).
///
/// Thesis eqs. 3.39, 3.44, 3.52, 3.53: Truesdell rate of the Cauchy stress
///   sigma' + tr(L) sigma - sigma L^T - L sigma = [N <nnnn>_c + X <eeee>_c (+ T <tttt>_c)] : L,
///   N = 256 k_b E f^4 v^5 / pi^4,
///   X = E beta^2 / ((k_t f^2 v^3 / pi^2)^-1 + (256 k_b f^4 v^5 / (3 pi^4))^-1),
///   T = E / ((3 k_t f^2 v^3 / pi^2)^-1 + (256 k_b f^4 v^5 / pi^4)^-1)  (left out for beta^2 >> 1).
/// Stress is positive in tension; pressure of uniaxial compression is -sigma_33.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "feltmb/fiber/orientation.hpp"

namespace feltmb {

/// Parameters of eq. 3.53.
struct GranularParams {
  double E;                 ///< fiber modulus [Pa] > 0
  double k_b = 1.0;         ///< bending constant [-] >= 0
  double k_t = 1.0;         ///< torsion constant [-] >= 0
  double beta = 0.0;        ///< crimp ratio l_c / r_f [-] >= 0
  bool transverse = false;  ///< keep the <tttt> term
};

/// Rate of the Cauchy stress [Pa/s].
/// @param structure  averages of the present orientation (f and contact tensors)
/// @param v_f        present volume fraction [-]
/// @param stress     Cauchy stress [Pa], symmetric
/// @param gradient   spatial velocity gradient L [1/s]
Eigen::Matrix3d granular_stress_rate(const GranularParams& params, const FiberStructure& structure,
                                     double v_f, const Eigen::Matrix3d& stress,
                                     const Eigen::Matrix3d& gradient);

/// Stress along a path of deformation gradients, from zero stress at the first.
///
/// The network was isotropic at F = I with fraction v_random; fibers rotate affinely (eq. 3.46).
/// F is interpolated linearly between the given ones; RK4 with `substeps` steps each.
/// @param path      deformation gradients, det > 0, v_random / det F < 1
/// @param substeps  >= 1
/// @param nodes     Gauss nodes of the orientation average, 8..128 (raise it for strong anisotropy)
/// @return Cauchy stress at every given F [Pa]. Throws InvalidParameter.
std::vector<Eigen::Matrix3d> granular_stress_path(const GranularParams& params, double v_random,
                                                  const std::vector<Eigen::Matrix3d>& path,
                                                  std::size_t substeps = 4, std::size_t nodes = 24);

}  // namespace feltmb
