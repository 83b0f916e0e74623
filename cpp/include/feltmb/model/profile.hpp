/// Force or motion of the finger as a function of time.
#pragma once

#include <array>
#include <vector>

namespace feltmb {

/// Piecewise profile through knots; held constant before the first and after the last knot.
///
/// value(t) = interpolant(t) [1 + amplitude sin(2 pi frequency t)].
/// `linear`: straight between knots, every knot is a breakpoint at which an integrator should
/// restart. `monotone`: cubic Hermite without overshoot (PCHIP), continuous in slope. `spline`:
/// cubic spline, continuous in curvature, at rest (slope 0) at both ends, for motion that a body
/// has to follow.
class Profile {
 public:
  enum class Interpolation { kLinear, kMonotone, kSpline };

  Profile() : Profile({0.0}, {0.0}, Interpolation::kLinear) {}

  /// @param time   knots [s], strictly increasing, at least one
  /// @param value  at the knots, same length: force [N] or displacement [m]
  /// @param oscillation_amplitude  relative [-], @param oscillation_frequency [Hz]
  /// Throws InvalidParameter naming the first knot at fault.
  Profile(std::vector<double> time, std::vector<double> value, Interpolation interpolation,
          double oscillation_amplitude = 0.0, double oscillation_frequency = 0.0);

  /// c[0] + c[1] t + c[2] t^2 + c[3] t^3 from 0 to twice `duration` > 0 [s]: up to there it has no
  /// corner.
  static Profile cubic(const std::array<double, 4>& c, double duration);

  double value(double t) const;
  double rate(double t) const;          ///< d value / dt [1/s]
  double acceleration(double t) const;  ///< d^2 value / dt^2 [1/s^2]

  /// Whether the slope is continuous, so that a body can follow the motion with finite forces.
  bool smooth() const { return interpolation_ != Interpolation::kLinear || time_.size() < 2; }
  const std::vector<double>& breakpoints() const { return breakpoints_; }  ///< slope jumps [s]
  const std::vector<double>& knots() const { return knots_; }  ///< to stop at without restart [s]

  bool operator==(const Profile&) const = default;

 private:
  std::size_t interval(double t) const;
  double base(double t) const;
  double base_rate(double t) const;
  double base_acceleration(double t) const;
  void fit_spline();

  std::vector<double> time_;
  std::vector<double> value_;
  std::vector<double> slope_;
  std::vector<double> breakpoints_;
  std::vector<double> knots_;
  Interpolation interpolation_;
  double amplitude_;
  double omega_;
};

}  // namespace feltmb
