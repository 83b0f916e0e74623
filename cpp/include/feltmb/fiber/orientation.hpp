/// Orientation of the fibers of a network and the averages that the contact and compression
/// models take over it.
///
/// A fiber direction is an axis: e and -e are the same fiber. theta is the polar angle between
/// e and the third axis (the direction of compression), phi the azimuth.
/// Density: `psi(e)` is per steradian of the full sphere (integral 1); the thesis's Omega lives on
/// the half sphere [0, pi]^2, Omega = 2 psi (eq. 3.18; isotropic 1/(2 pi), eq. 3.23).
/// Contact average (eq. 3.45): <q>_c = (1/f) int int q |e x e'| psi psi' de de'.
/// n = e x e' / |e x e'| is the contact normal.
///
/// Method: pairs of axes are counted by the plane they span (normal n) and their angles p, p' in
/// it, de de' = |sin(p - p')| dn dp dp' / 2 (Blaschke-Petkantschin). The factor |e x e'| then
/// becomes sin^2(p - p') = sin^2 p cos^2 p' + ... , so that every contact average is a product of
/// in-plane moments, integrated over n: all integrands are smooth.
/// Source of the averages: thesis 3.1.3, 3.2 (eqs. 3.5, 3.9, 3.45, 3.46, 3.57, 3.60, 3.63).
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace feltmb {

/// Structural numbers of an initially isotropic network after F = diag(1, 1, 1/R), eq. 3.57.
/// All dimensionless. R = 1: pi/4, 1/5, 1/5, 1/2, 2/3; R -> infinity (planar): 2/pi, 1, 0, 0, 1.
struct UniaxialStructure {
  double ratio;  ///< R = v_f / v_random, > 1 compressed, < 1 stretched
  double f;      ///< int int |e x e'| psi psi', eq. 3.51
  double n3;     ///< <n3^4>_c, contact normals, eq. 3.45
  double e3;     ///< <e3^4>_c, fiber axes at contacts, eq. 3.45
  double K3;     ///< mean |cos theta| = 1/(1+R); eq. 3.60 with |cos| (printed: cos, gives 0)
  double M3;     ///< mean sin^2 theta, eq. 3.63
  double cos4;   ///< mean cos^4 theta over fibers, Phi / epsilon_33 of eq. 3.27
  double sine;   ///< mean sin theta over fibers: encounters of a line along axis 3
};

/// Exact numbers by quadrature over complete elliptic integrals; relative error below 1e-11.
/// @param ratio  R, 1e-3 .. 1e6. Throws InvalidParameter outside.
UniaxialStructure compute_uniaxial_structure(double ratio);

/// The same numbers from a Chebyshev table in log R (made once, thread safe), for inner loops:
/// relative difference to compute_uniaxial_structure below 1e-10 for 1e-2 <= R <= 1e4; outside
/// that range the exact function is called.
UniaxialStructure uniaxial_structure(double ratio);

/// Psi(R) = int psi J Theta [-], the mean blocked length in Pan's model (from eqs. 3.5, 3.8, 3.9),
/// relative error below 1e-9; isotropic pi^2/8. Some milliseconds.
double uniaxial_obstruction(double ratio);

/// Omega(theta) on the half sphere [1/sr]: R / (2 pi (sin^2 theta + R^2 cos^2 theta)^(3/2)).
double uniaxial_density(double ratio, double cos_theta);

/// J(theta) of eq. 3.5 [-]: mean sine of the angle between a fiber at theta and the others.
double uniaxial_mean_sine(double ratio, double cos_theta);

/// Theta(theta) of eq. 3.9 [-]: mean 1/sine; grows like log R, infinite for a planar network.
double uniaxial_mean_inverse_sine(double ratio, double cos_theta);

/// Full tensor of rank four, row-major: component ijkl at ((i*3 + j)*3 + k)*3 + l.
using Tensor4 = std::array<double, 81>;

/// Component of a rank four tensor, indices 0..2.
inline double component(const Tensor4& t, int i, int j, int k, int l) {
  return t[static_cast<std::size_t>(((i * 3 + j) * 3 + k) * 3 + l)];
}

/// Averages over a general orientation distribution.
struct FiberStructure {
  double f = 0.0;                                ///< as UniaxialStructure
  double n3 = 0.0;                               ///< <n3^4>_c
  double e3 = 0.0;                               ///< <e3^4>_c
  double K3 = 0.0;                               ///< mean |e3| over fibers
  double M3 = 0.0;                               ///< mean 1 - e3^2 over fibers
  double obstruction = 0.0;                      ///< Psi; NaN when it was not asked for
  Eigen::Matrix3d ee = Eigen::Matrix3d::Zero();  ///< <e e> over fibers, trace 1
  Tensor4 eeee{};                                ///< <e e e e> over fibers
  Tensor4 nnnn_contact{};                        ///< <n n n n>_c
  Tensor4 eeee_contact{};                        ///< <e e e e>_c
  Tensor4 tttt_contact{};                        ///< <t t t t>_c, t = n x e (theta of the thesis)
};

/// Points at which an orientation density must be known so that all averages of FiberStructure
/// can be formed. Spectral accuracy for smooth densities: double the sizes until nothing changes.
class OrientationQuadrature {
 public:
  /// @param n_polar      Gauss nodes in |cos| of sphere nodes and plane normals, 2..512
  /// @param n_azimuth    equidistant azimuths, 4..2048
  /// @param n_circle     points on each great circle, over half of it, 4..4096
  /// @param obstruction  also the points for Psi (n_polar * n_azimuth * n_azimuth/2 * n_circle)
  OrientationQuadrature(std::size_t n_polar, std::size_t n_azimuth, std::size_t n_circle,
                        bool obstruction = false);

  [[nodiscard]] std::size_t size() const;

  /// Unit vectors [-], one row per point; first the sphere nodes, then the great circles.
  [[nodiscard]] Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor> directions() const;

  /// @param density  psi or any multiple of it at directions(), >= 0; normalized here
  /// @return averages. Throws InvalidParameter for a wrong size, negative or not finite values.
  [[nodiscard]] FiberStructure compute(std::span<const double> density) const;

  /// Integral of the given density over the full sphere (1 for psi, 2 for a half-sphere Omega
  /// continued to both halves).
  [[nodiscard]] double norm(std::span<const double> density) const;

 private:
  std::size_t n_polar_, n_azimuth_, n_circle_;
  bool obstruction_;
  std::vector<double> polar_nodes_, polar_weights_;
};

/// psi(e) [1/sr] of an isotropic network deformed by F (eq. 3.46): 1/(4 pi det F |F^-1 e|^3).
/// @param deformation  F, det F > 0
/// @param directions   unit vectors, one row each
Eigen::VectorXd affine_density(
    const Eigen::Matrix3d& deformation,
    const Eigen::Ref<const Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>>& directions);

using Directions = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;

/// Random isotropic fiber axes (thesis 3.1.3): points uniform in a cube, those outside the unit
/// ball rejected, the rest projected on the sphere; then spread by diffusion: every axis is pushed
/// along the sphere away from the axes (and their opposites) nearer than 2.5 mean distances.
/// @param n        number of fibers, 2 .. 1 000 000
/// @param seed     equal seeds give equal networks, for every thread count
/// @param spread   diffusion steps, >= 0; 0 leaves the axes independent of each other
/// @param threads  0: all cores
Directions make_random_directions(std::size_t n, std::uint64_t seed, std::size_t spread,
                                  std::size_t threads = 0);

/// Affine rotation of every axis, e = F e_r / |F e_r| (eq. 3.46). det F > 0.
Directions deform_directions(const Eigen::Ref<const Directions>& directions,
                             const Eigen::Matrix3d& deformation);

/// Estimate with its standard error.
struct Estimate {
  double value;
  double error;  ///< one standard error, for independent fibers
};

/// Structural numbers estimated from fiber axes (pairs i < j for the contact averages).
struct SampledStructure {
  Estimate f, n3, e3, K3, M3;
};

/// U-statistics over all pairs with their sampling error (Hoeffding's two terms, delta method
/// for the ratios). Errors hold for independent axes; a spread network scatters less.
/// Work n^2; n <= 200 000. Results do not depend on `threads`.
SampledStructure estimate_structure(const Eigen::Ref<const Directions>& directions,
                                    std::size_t threads = 0);

/// All tensors of FiberStructure by pair sums over given axes (n <= 200 000); obstruction NaN.
FiberStructure estimate_tensors(const Eigen::Ref<const Directions>& directions,
                                std::size_t threads = 0);

/// Stiffness of a bonded network whose fibers are stretched only (Narter, eqs. 3.16-3.22) [Pa].
/// Order of components 11, 22, 33, 12, 13, 23; engineering shear strains.
/// S = K <e e e e> with K = E v_f (A_f E times fiber length per volume; the thesis's N_fv must be
/// a length per volume, not a number).
/// @param eeee       <e e e e> over fibers
/// @param stiffness  K [Pa] > 0
Eigen::Matrix<double, 6, 6> narter_stiffness(const Tensor4& eeee, double stiffness);

/// Compliance, the inverse [1/Pa]. Isotropic: 6/K, -3/(2K), 15/K (eq. 3.24).
/// Throws InvalidParameter when S is singular (planar or parallel fibers resist nothing across).
Eigen::Matrix<double, 6, 6> narter_compliance(const Eigen::Matrix<double, 6, 6>& stiffness);

/// Engineering constants of a compliance with the axes as principal directions.
struct EngineeringModuli {
  std::array<double, 3> young;    ///< E1, E2, E3 [Pa]; isotropic K/6 (eq. 3.25 printed 1/(6K))
  std::array<double, 3> shear;    ///< G12, G13, G23 [Pa]
  std::array<double, 6> poisson;  ///< nu12, nu13, nu21, nu23, nu31, nu32 [-]
};
EngineeringModuli engineering_moduli(const Eigen::Matrix<double, 6, 6>& compliance);

}  // namespace feltmb
