/// Envelopes of a compression loop: virgin loading curve and the shape of its unloading.
#pragma once

#include <memory>
#include <vector>

#include "feltmb/contact/curve.hpp"

namespace feltmb {

/// Loading force F_L(e) and unloading ratio rho(x) = F_U(x e_M) / F_L(x e_M), 0 <= x <= 1, of one
/// felt. Repaired on the way in: F_L >= 0, 0 <= rho <= 1, rho(1) = 1. Immutable, shared.
///
/// The unloading branch of a cycle to the compression e_m is F_L(e) rho(e / e_m): the measured
/// shape scaled to the cycle. W(e_m) is the area of that loop.
class Envelope {
 public:
  /// From the curve fits of thesis eq. 4.21. They meet at e_M, found beyond the compressions at
  /// which they may cross near zero; if they never meet below `largest` (contact 2 of Table A.12),
  /// e_M = `closing` must be given, and the last part of the unloading curve is raised to the
  /// loading curve by (1 - rho(1)) x^8. Throws InvalidParameter.
  static std::shared_ptr<const Envelope> from_curves(const ExponentialCurve& loading,
                                                     const ExponentialCurve& unloading,
                                                     double closing = 0.0);

  /// From a measured or computed loop: compressions [m], strictly growing from 0, and the forces
  /// [N] of both branches there; monotone splines in between; the last point is e_M. Beyond it the
  /// loading curve goes on along its tangent. Throws InvalidParameter.
  static std::shared_ptr<const Envelope> from_table(const std::vector<double>& compression,
                                                    const std::vector<double>& loading,
                                                    const std::vector<double>& unloading);

  /// e_M [m].
  double closing() const { return closing_; }

  CurveValue loading(double e) const;     ///< F_L [N] and slope [N/m]
  CurveValue ratio(double x) const;       ///< rho [-] and d rho / dx
  double loading_energy(double e) const;  ///< integral of F_L [J]

  /// W(e_m) = integral over 0..e_m of F_L(e) (1 - rho(e / e_m)) [J], and its slope [N].
  CurveValue loop_area(double e_m) const;

  /// Integral over 0..e of F_L(e') rho(e' / e_m) [J]; by quadrature, not for inner loops.
  double unloading_energy(double e, double e_m) const;

 private:
  Envelope() = default;
  void tabulate_ratio(const std::vector<double>& x, std::vector<double> rho);
  void tabulate_area();

  bool exponential_ = true;
  ExponentialCurve curve_;
  double first_positive_ = 0.0;
  double energy_offset_ = 0.0;
  double closing_ = 0.0;
  // Hermite tables over s = sqrt(x) or sqrt(e / e_M), equally spaced: fine where e is small.
  std::vector<double> rho_, rho_slope_;
  std::vector<double> load_, load_slope_, load_energy_;
  std::vector<double> area_, area_slope_;
};

}  // namespace feltmb
