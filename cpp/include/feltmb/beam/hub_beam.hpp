/// A rigid hub that turns a flexible arm with a tip mass, by Hermite finite elements.
#pragma once

#include <Eigen/Dense>
#include <vector>

namespace feltmb {

/// A section of the arm with constant cross section.
struct ArmSection {
  double length = 0.0;         ///< [m], > 0
  double density = 0.0;        ///< rho [kg/m^3], > 0
  double area = 0.0;           ///< A [m^2], > 0
  double young_modulus = 0.0;  ///< E [Pa], > 0
  double second_moment = 0.0;  ///< I [m^4], > 0
};

/// Position of the tip mass: r perpendicular to the arm (it rotates with the end of the arm), or r
/// beyond the end of the arm.
enum class TipPlacement { kAcross, kAlong };

struct HubBeamDescription {
  double hub_radius = 0.0;           ///< a [m], >= 0: distance of the arm's start from the axis
  double hub_inertia = 0.0;          ///< J_h about the axis [kg m^2], > 0
  std::vector<ArmSection> sections;  ///< from the hub outward, at least one
  double tip_mass = 0.0;             ///< m_t [kg], >= 0
  double eccentricity = 0.0;         ///< r [m], >= 0
  TipPlacement tip = TipPlacement::kAcross;
  int elements = 10;  ///< N, at least one per section; distributed by length
  /// true: the second shape function as printed in thesis eq. 5.2, l phi_1, which does not
  /// interpolate a slope. The frequencies then increase with N instead of converging. For
  /// comparison only.
  bool printed_shapes = false;
};

/// Free vibration in coordinates q = modes x, with modes^T M modes = 1.
struct HubBeamModes {
  Eigen::VectorXd stiffness;  ///< w^2 [1/s^2], ascending; the first is the rigid mode, 0
  Eigen::MatrixXd shapes;     ///< columns [kg^-1/2 ...]
};

/// M q'' + K q = Q (thesis eq. 5.17) of q = [theta, w_1, theta_1, ..., w_N, theta_N], 2 N + 1
/// coordinates: hub angle [rad], deflection [m] and slope [rad] of each node against the turning
/// hub (w_0 = theta_0 = 0 imposed in eq. 5.6). Thesis eqs 5.1-5.13; 5.2 and 5.10 repaired: phi_2 =
/// l (s - 2 s^2 + s^3), and the tip mass turns with the hub too, m r^2 (theta' + theta_N')^2 / 2.
/// Small deflections and linear kinematics: no centrifugal stiffening, no rotary inertia or shear
/// of the arm.
class HubBeam {
 public:
  /// Throws InvalidParameter that lists all faults.
  explicit HubBeam(const HubBeamDescription& description);

  const HubBeamDescription& description() const { return description_; }
  int size() const { return static_cast<int>(mass_.rows()); }
  double length() const { return length_; }                           ///< L of the arm [m]
  double reach() const { return description_.hub_radius + length_; }  ///< a + L [m]
  const std::vector<double>& stations() const { return stations_; }   ///< x of the nodes [m]
  const Eigen::MatrixXd& mass() const { return mass_; }               ///< M
  const Eigen::MatrixXd& stiffness() const { return stiffness_; }     ///< K
  const Eigen::VectorXd& tip() const { return tip_; }  ///< b = tip . q = (L + a) theta + w_N [m]
  /// Generalized force of a unit gravity field perpendicular to the arm [kg, kg m], thesis eq.
  /// 5.15. As there, the contributions of the hub, which is assumed to be balanced, and of r are
  /// neglected.
  const Eigen::VectorXd& weight() const { return weight_; }

  /// Moment of inertia about the axis with a rigid arm [kg m^2].
  double rigid_inertia() const { return mass_(0, 0); }

  /// Modes with an additional mass `tip_mass` [kg] at the tip (the equivalent mass of an action).
  HubBeamModes modes(double tip_mass = 0.0) const;

  /// The lowest frequencies [Hz], from the flexibility: relative error of rounding 1e-12 for the
  /// low ones, whatever the number of elements. @param count  1 to 2 N
  /// @param clamped  true: the hub held
  Eigen::VectorXd frequencies(int count, bool clamped = false) const;

 private:
  void check() const;
  void add_element(int node, double x, double length, const ArmSection& section);

  HubBeamDescription description_;
  double length_ = 0.0;
  std::vector<double> stations_;
  Eigen::MatrixXd mass_, stiffness_;
  Eigen::VectorXd tip_, weight_;
};

}  // namespace feltmb
