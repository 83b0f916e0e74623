/// Envelopes of a compression loop: virgin loading curve and the shape of its unloading.
#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <vector>

#include "feltmb/contact/curve.hpp"

namespace feltmb {

/// A loop as functions, for envelopes that are computed.
struct EnvelopeShape {
  std::function<double(double)> loading;  ///< F_L(e) [N], growing from F_L(0) = 0
  /// rho(x, e_m) [-], the ratio of unloading to loading force at e = x e_m in the cycle to e_m; it
  /// does not decrease with x, is in [0, 1], and rho(1, e_m) = 1.
  std::function<double(double, double)> ratio;
  double closing = 0.0;  ///< end of the loop e_M [m]
  double reach = 0.0;    ///< F_L is tabulated up to this compression [m], >= closing; then linear
  int rows = 1;          ///< 1: rho does not depend on e_m; else number of rows over e_m, >= 4
};

/// An envelope at one compression within the cycle to e_m.
struct CycleValue {
  double loading = 0.0;        ///< F_L(e) [N]
  double loading_slope = 0.0;  ///< dF_L/de [N/m]
  double ratio = 1.0;          ///< rho(e / e_m, e_m) [-]
  double ratio_slope = 0.0;    ///< d rho / de [1/m]
  double area = 0.0;           ///< W(e_m) [J]
};

class Envelope;

/// Properties of the cycle to e_m that do not depend on the compression; constant between
/// reversals.
struct CycleStart {
  const Envelope* of = nullptr;
  double largest = 0.0;     ///< e_m [m]
  double area = 0.0;        ///< W(e_m) [J]
  std::size_t row[3] = {};  ///< of a table of rho with rows over e_m: the three around it
  double weight[3] = {};    ///< and their weights
};

/// Change that made the unloading shape of a loop monotone.
struct ShapeRepair {
  double force = 0.0;  ///< largest change of the unloading force of the whole loop [N]
  double low = 0.0;    ///< start of the range of the change [m]
  double high = 0.0;   ///< end of the range of the change [m]
};

/// Loading force F_L(e) and unloading ratio rho(x, e_m) = F_U(x e_m; e_m) / F_L(x e_m), 0 <= x <=
/// 1, of one felt. Immutable, shared.
///
/// The unloading branch of a cycle to the compression e_m is F_L(e) rho(e / e_m): the measured
/// shape scaled to the cycle. W(e_m) is the area of that loop.
///
/// The input is corrected so that F_L >= 0, 0 <= rho <= 1, rho(1) = 1, and rho never decreases.
/// Where rho decreases (in every printed pair of curves of Table A.12 except 09 and 15), a deeper
/// cycle would have a higher unloading force at the same compression. rho is replaced by the
/// closest values that do not decrease, weighted by the loading force. The work of the loop is
/// unchanged, and `repair` holds the change of the force.
class Envelope {
 public:
  /// From the curve fits of thesis eq. 4.21. They meet at e_M, found beyond the compressions at
  /// which they may cross near zero; if they never meet below `largest` (contact 2 of Table A.12),
  /// e_M = `closing` must be given, and the last part of the unloading curve is raised to the
  /// loading curve by (1 - rho(1)) x^8. Throws InvalidParameter.
  static std::shared_ptr<const Envelope> from_curves(const ExponentialCurve& loading,
                                                     const ExponentialCurve& unloading,
                                                     double closing = 0.0);

  /// From a measured or computed loop: compressions [m], strictly increasing from 0, and the forces
  /// [N] of both branches there; monotone splines in between; the last point is e_M. Beyond e_M,
  /// the loading curve is continued along its tangent. Throws InvalidParameter.
  static std::shared_ptr<const Envelope> from_table(const std::vector<double>& compression,
                                                    const std::vector<double>& loading,
                                                    const std::vector<double>& unloading);

  /// From functions, as from a table; only a loop with one row is repaired. Throws
  /// InvalidParameter.
  static std::shared_ptr<const Envelope> from_shape(const EnvelopeShape& shape);

  /// e_M [m].
  double closing() const { return closing_; }

  /// Largest compression of the table of F_L [m]; for curves, which have no end, e_M.
  double reach() const { return exponential_ ? closing_ : reach_; }

  /// Change that made rho monotone; its force is 0 if there was none.
  const ShapeRepair& repair() const { return repair_; }

  CurveValue loading(double e) const;  ///< F_L [N] and slope [N/m]

  /// rho [-] and d rho / dx at x = e / e_m of the cycle to e_m [m].
  CurveValue ratio(double x, double e_m) const;

  /// F_L, rho and W together, for 0 < e < e_m [m]; e_m > 0.
  CycleValue cycle(double e, const CycleStart& to) const;
  CycleStart cycle_to(double e_m) const;

  double loading_energy(double e) const;  ///< integral of F_L [J]

  /// W(e_m) = integral over 0..e_m of F_L(e) (1 - rho(e / e_m)) [J], and its slope [N].
  CurveValue loop_area(double e_m) const;

  /// Integral over 0..e of F_L(e') rho(e' / e_m) [J], from a table of its share of the loading
  /// energy.
  double unloading_energy(double e, double e_m) const;

 private:
  friend struct EnvelopeTables;  ///< planar/archive.cpp
  Envelope() = default;
  void tabulate_loading(const std::function<double(double)>& loading, double reach, bool smooth);
  std::vector<double> close(std::vector<double> rho) const;
  void tabulate_ratio(std::vector<double> rho);
  void blend_rows(double e_m, CycleStart& to) const;
  CurveValue ratio_of_root(double s, const CycleStart& to) const;
  CubicPiece blended_piece(std::size_t i, const CycleStart& to) const;
  CurveValue area_by_quadrature(double e_m) const;
  void tabulate_area();
  void tabulate_energy();

  bool exponential_ = true;
  ExponentialCurve curve_;
  double first_positive_ = 0.0;
  double energy_offset_ = 0.0;
  double closing_ = 0.0;
  double reach_ = 0.0;       ///< end of the table of F_L
  double area_reach_ = 0.0;  ///< end of the tables over e_m
  ShapeRepair repair_;
  // Hermite tables over s = sqrt(x), sqrt(e / reach) or sqrt(e_m / area_reach), equally spaced:
  // fine where e is small. Rows of rho and of the energy share one after the other.
  std::size_t rows_ = 1;
  std::vector<double> rho_, rho_slope_;
  std::vector<double> load_, load_slope_, load_energy_;
  std::vector<CubicPiece> rho_pieces_;  ///< if there is one row
  std::vector<CubicPiece> load_pieces_;
  std::vector<double> area_, area_slope_;
  std::vector<double> share_, share_slope_;
};

}  // namespace feltmb
