/// Equal stiff strings with pinned ends, struck together, in modal coordinates: thesis
/// eqs 4.10-4.20.
#pragma once

#include <span>
#include <vector>

#include "feltmb/core/fields.hpp"

namespace feltmb {

/// Parameters of the stiff string of thesis Table 4.1; all but `count` are those of one string.
struct StringParameters {
  double diameter = 0.0;        ///< d [m], > 0
  double tension = 0.0;         ///< T [N], > 0
  double length = 0.0;          ///< speaking length L [m], > 0
  double linear_density = 0.0;  ///< mu [kg/m], > 0
  double young_modulus = 0.0;   ///< E [Pa], >= 0
  double damping_ratio = 0.0;   ///< xi [-], the same for all modes, 0 <= xi < 1
  int modes = 40;               ///< number of modes N, >= 1
  int count = 1;                ///< equal strings struck together n, >= 1

  static constexpr auto fields() {
    using S = StringParameters;
    return std::tuple{
        number("diameter", &S::diameter, "m", above(0.0), "of the wire"),
        number("tension", &S::tension, "N", above(0.0), "of one string"),
        number("length", &S::length, "m", above(0.0), "speaking length"),
        number("linear_density", &S::linear_density, "kg/m", above(0.0), "of one string"),
        number("young_modulus", &S::young_modulus, "Pa", at_least(0.0), "of the wire"),
        number("damping_ratio", &S::damping_ratio, "1", below(at_least(0.0), 1.0), "of all modes"),
        feltmb::count("modes", &S::modes, up_to(at_least(1.0), 5000.0), "number of modes"),
        feltmb::count("count", &S::count, up_to(at_least(1.0), 1000.0),
                      "equal strings struck together"),
    };
  }
};

/// Mode shape sums at one point of the string.
struct StringPoint {
  double displacement = 0.0;  ///< w = sum phi_j eta_j [m]
  double slope = 0.0;         ///< dw/dy [-]
  double curvature = 0.0;     ///< d2w/dy2 [1/m]
  double velocity = 0.0;      ///< dw/dt at fixed y [m/s]
  double slope_rate = 0.0;    ///< d/dt of the slope at fixed y [1/s]
};

/// mu w_tt + E I w_yyyy - T w_yy = f(t)/n delta(y - y_c), thesis eq. 4.10, pinned at y = 0 and L:
/// n equal strings share the force f and move alike. The striker sees n times the mass, tension and
/// bending stiffness of one string; frequencies and the forms of vibration stay. No coupling of the
/// strings by the bridge, no mistuning.
///
/// w = sum phi_j(y) eta_j, phi_j = sqrt(2/(n mu L)) sin(j pi y / L) [kg^-1/2], eta_j in m kg^1/2;
///   eta_j'' + 2 xi w_j eta_j' + w_j^2 eta_j = phi_j(y_c) f,   eqs 4.13, 4.15;
///   w_j = (pi j / L) sqrt(T/mu (1 + eps pi^2 j^2)), eps = pi d^4 E / (64 L^2 T), eq. 4.14.
/// Displacement w and force f have the same sense: positive away from the striker. f, the force on
/// the bridge and the energies are of all strings together.
class ModalString {
 public:
  /// Throws InvalidParameter naming the field, its value and the permitted range.
  explicit ModalString(const StringParameters& parameters);

  const StringParameters& parameters() const { return parameters_; }
  int modes() const { return parameters_.modes; }

  /// eps of eq. 4.14 [-]. Partials are f_j = j f_0 sqrt(1 + eps pi^2 j^2): B = pi^2 eps.
  double inharmonicity_index() const { return inharmonicity_; }

  std::span<const double> angular_frequency() const { return omega_; }  ///< w_j [rad/s]
  std::span<const double> stiffness() const { return stiffness_; }      ///< w_j^2 [1/s^2]
  std::span<const double> damping() const { return damping_; }          ///< 2 xi w_j [1/s]

  /// Largest value of every mode shape, sqrt(2/(n mu L)) [kg^-1/2].
  double shape_scale() const { return shape_scale_; }

  /// phi_j(y) [kg^-1/2] and dphi_j/dy for all modes at y [m]; both spans of length modes().
  void shapes(double y, std::span<double> phi, std::span<double> dphi) const;

  /// Displacement, slope, curvature and rates at y [m] from eta and deta/dt.
  StringPoint point(double y, std::span<const double> eta, std::span<const double> eta_rate) const;

  /// Same, with phi and dphi of `shapes` at that y already known.
  StringPoint point(std::span<const double> phi, std::span<const double> dphi,
                    std::span<const double> eta, std::span<const double> eta_rate) const;

  /// Transverse force of all strings on the bridge at y = L [N],
  /// -n (T w_y - E I w_yyy)(L), positive in the sense of w.
  double bridge_force(std::span<const double> eta) const;

  /// Bound on |w| anywhere: the sum of the modal amplitudes [m].
  double largest_displacement(std::span<const double> eta) const;

  double kinetic_energy(std::span<const double> eta_rate) const;    ///< [J]
  double elastic_energy(std::span<const double> eta) const;         ///< [J]
  double dissipated_power(std::span<const double> eta_rate) const;  ///< >= 0 [W]

 private:
  StringParameters parameters_;
  double inharmonicity_ = 0.0;
  double shape_scale_ = 0.0;
  std::vector<double> wave_number_;
  std::vector<double> wave_number_squared_;
  std::vector<double> omega_;
  std::vector<double> stiffness_;
  std::vector<double> damping_;
  std::vector<double> bridge_;
};

}  // namespace feltmb
