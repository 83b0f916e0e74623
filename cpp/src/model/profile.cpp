#include "feltmb/model/profile.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "feltmb/core/error.hpp"

namespace feltmb {

Profile::Profile(std::vector<double> time, std::vector<double> value, Interpolation interpolation,
                 double oscillation_amplitude, double oscillation_frequency)
    : time_(std::move(time)),
      value_(std::move(value)),
      interpolation_(interpolation),
      amplitude_(oscillation_amplitude),
      omega_(2.0 * std::numbers::pi * oscillation_frequency) {
  if (time_.empty() || time_.size() != value_.size()) {
    throw InvalidParameter(format("profile: got %zu times and %zu values, expected equal and >= 1",
                                  time_.size(), value_.size()));
  }
  for (std::size_t i = 0; i < time_.size(); ++i) {
    if (!std::isfinite(time_[i]) || !std::isfinite(value_[i])) {
      throw InvalidParameter(format("profile: knot %zu is not a finite number", i));
    }
    if (i > 0 && time_[i] <= time_[i - 1]) {
      throw InvalidParameter(format("profile: time %.9g s of knot %zu does not follow %.9g s",
                                    time_[i], i, time_[i - 1]));
    }
  }
  const std::size_t n = time_.size();
  slope_.assign(n, 0.0);
  if (interpolation_ == Interpolation::kLinear) {
    // Knots on a straight line need no stop; a sampled record would otherwise restart everywhere.
    for (std::size_t i = 0; i < n; ++i) {
      const double left = i == 0 ? 0.0 : (value_[i] - value_[i - 1]) / (time_[i] - time_[i - 1]);
      const double right =
          i + 1 == n ? 0.0 : (value_[i + 1] - value_[i]) / (time_[i + 1] - time_[i]);
      if (std::fabs(right - left) > 1e-9 * (std::fabs(left) + std::fabs(right))) {
        breakpoints_.push_back(time_[i]);
      }
    }
    return;
  }
  if (interpolation_ == Interpolation::kSpline) {
    fit_spline();
    return;
  }
  // Fritsch-Carlson slopes with the weighted harmonic mean of Fritsch and Butland.
  for (std::size_t i = 1; i + 1 < n; ++i) {
    const double h0 = time_[i] - time_[i - 1];
    const double h1 = time_[i + 1] - time_[i];
    const double s0 = (value_[i] - value_[i - 1]) / h0;
    const double s1 = (value_[i + 1] - value_[i]) / h1;
    if (s0 * s1 <= 0.0) continue;
    const double w0 = 2.0 * h1 + h0;
    const double w1 = h1 + 2.0 * h0;
    slope_[i] = (w0 + w1) / (w0 / s0 + w1 / s1);
  }
  // Flat ends join the constant continuation. Knots are stops: at rest a step could pass over a
  // whole pulse.
  knots_ = time_;
}

Profile Profile::cubic(const std::array<double, 4>& c, double duration) {
  const double end = 2.0 * duration;
  const double last = c[0] + end * (c[1] + end * (c[2] + end * c[3]));
  Profile out({0.0, end}, {c[0], last}, Interpolation::kMonotone);
  out.slope_ = {c[1], c[1] + end * (2.0 * c[2] + end * 3.0 * c[3])};
  out.knots_.clear();
  return out;
}

/// Slopes of the spline from continuity of curvature at the inner knots (Thomas algorithm).
void Profile::fit_spline() {
  const std::size_t n = time_.size();
  if (n > 2) {
    std::vector<double> factor(n, 0.0);
    for (std::size_t i = 1; i + 1 < n; ++i) {
      const double left = 1.0 / (time_[i] - time_[i - 1]);
      const double right = 1.0 / (time_[i + 1] - time_[i]);
      const double target = 3.0 * ((value_[i] - value_[i - 1]) * left * left +
                                   (value_[i + 1] - value_[i]) * right * right);
      const double pivot = 2.0 * (left + right) - left * factor[i - 1];
      factor[i] = right / pivot;
      slope_[i] = (target - left * slope_[i - 1]) / pivot;
    }
    for (std::size_t i = n - 2; i > 0; --i) slope_[i] -= factor[i] * slope_[i + 1];
  }
  // Curvature jumps at the two ends only. Stops keep a step at rest from passing over a pulse.
  breakpoints_ = n > 1 ? std::vector<double>{time_.front(), time_.back()} : time_;
  constexpr double spacing = 5e-4;  // s
  for (std::size_t i = 1; i + 1 < n; ++i) {
    if (knots_.empty() || time_[i] - knots_.back() >= spacing) knots_.push_back(time_[i]);
  }
}

std::size_t Profile::interval(double t) const {
  const auto it = std::upper_bound(time_.begin(), time_.end(), t);
  return static_cast<std::size_t>(it - time_.begin()) - 1;
}

double Profile::base(double t) const {
  if (t <= time_.front()) return value_.front();
  if (t >= time_.back()) return value_.back();
  const std::size_t i = interval(t);
  const double h = time_[i + 1] - time_[i];
  const double u = (t - time_[i]) / h;
  if (interpolation_ == Interpolation::kLinear) {
    return value_[i] + u * (value_[i + 1] - value_[i]);
  }
  const double u2 = u * u;
  const double u3 = u2 * u;
  return (2.0 * u3 - 3.0 * u2 + 1.0) * value_[i] + (u3 - 2.0 * u2 + u) * h * slope_[i] +
         (-2.0 * u3 + 3.0 * u2) * value_[i + 1] + (u3 - u2) * h * slope_[i + 1];
}

double Profile::base_rate(double t) const {
  if (t < time_.front() || t >= time_.back()) return 0.0;
  const std::size_t i = interval(t);
  const double h = time_[i + 1] - time_[i];
  const double secant = (value_[i + 1] - value_[i]) / h;
  if (interpolation_ == Interpolation::kLinear) return secant;
  const double u = (t - time_[i]) / h;
  return 6.0 * u * (1.0 - u) * secant + (3.0 * u * u - 4.0 * u + 1.0) * slope_[i] +
         (3.0 * u * u - 2.0 * u) * slope_[i + 1];
}

double Profile::base_acceleration(double t) const {
  if (interpolation_ == Interpolation::kLinear || t < time_.front() || t >= time_.back()) {
    return 0.0;
  }
  const std::size_t i = interval(t);
  const double h = time_[i + 1] - time_[i];
  const double secant = (value_[i + 1] - value_[i]) / h;
  const double u = (t - time_[i]) / h;
  return (6.0 * (1.0 - 2.0 * u) * secant + (6.0 * u - 4.0) * slope_[i] +
          (6.0 * u - 2.0) * slope_[i + 1]) /
         h;
}

double Profile::value(double t) const {
  return amplitude_ == 0.0 ? base(t) : base(t) * (1.0 + amplitude_ * std::sin(omega_ * t));
}

double Profile::rate(double t) const {
  if (amplitude_ == 0.0) return base_rate(t);
  return base_rate(t) * (1.0 + amplitude_ * std::sin(omega_ * t)) +
         base(t) * amplitude_ * omega_ * std::cos(omega_ * t);
}

double Profile::acceleration(double t) const {
  if (amplitude_ == 0.0) return base_acceleration(t);
  const double sine = amplitude_ * std::sin(omega_ * t);
  const double cosine = amplitude_ * omega_ * std::cos(omega_ * t);
  return base_acceleration(t) * (1.0 + sine) + 2.0 * base_rate(t) * cosine -
         base(t) * omega_ * omega_ * sine;
}

}  // namespace feltmb
