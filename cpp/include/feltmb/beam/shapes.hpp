/// Shape functions of a clamped planar beam.
#pragma once

#include <vector>

namespace feltmb {

enum class ShapeSet {
  kPolynomial,    ///< Rayleigh-Ritz polynomials of thesis eqs 4.1-4.4
  kClampedFree,   ///< vibration modes of the clamped-free uniform beam
  kCraigBampton,  ///< static shapes of the tip and modes with the tip held
};

/// Values of all shapes at one station.
struct ShapeValues {
  std::vector<double> axial;              ///< U_k(x) [-]
  std::vector<double> axial_slope;        ///< dU_k/dx [1/m]
  std::vector<double> lateral;            ///< V_k(x) [-]
  std::vector<double> lateral_slope;      ///< dV_k/dx [1/m]
  std::vector<double> lateral_curvature;  ///< d2V_k/dx2 [1/m^2]
};

/// Displacement of the centerline u(x) = sum U_k(x) u_k, v(x) = sum V_k(x) v_k of a beam clamped at
/// x = 0. Every shape is scaled so that its coordinate is a length [m]:
///  - polynomial: U_k = (x/L)^k, V_k = (x/L)^(k+1), k = 1, 2, ... (eqs 4.1-4.4 with coordinates
///    scaled by powers of L);
///  - clamped-free: modes with cos(b) cosh(b) = -1, axial sin((2k - 1) pi x / 2L), scaled to 1 at
///    the tip;
///  - Craig-Bampton: V_1 = 3 s^2 - 2 s^3 (tip displacement), V_2 = s^3 - s^2 (L times tip slope),
///    s = x/L, then clamped-clamped modes; U_1 = s, then sin(k pi s). At least two lateral shapes
///    (R. R. Craig, M. C. C. Bampton, AIAA J. 6 (1968) 1313).
class BeamShapes {
 public:
  /// @param length   L [m], > 0
  /// @param axial    number of axial shapes, >= 0;  @param lateral  of lateral shapes, >= 1; both
  ///                 at most 12 (polynomials of higher degree are numerically dependent)
  BeamShapes(ShapeSet set, double length, int axial, int lateral);

  int axial() const { return axial_; }
  int lateral() const { return lateral_; }
  double length() const { return length_; }

  /// Values at x [m], 0 <= x <= L.
  ShapeValues at(double x) const;

  /// Number of Gauss points that integrates products of two shapes to rounding.
  int quadrature_points() const;

 private:
  ShapeSet set_;
  double length_;
  int axial_;
  int lateral_;
  std::vector<double> roots_;  ///< of the frequency equation, for the vibration modes
};

}  // namespace feltmb
