/// Integral of a smooth function as a function of its upper limit.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <vector>

namespace feltmb {

/// F(x) = int_a^x f(t) dt for a <= x <= b, from Chebyshev interpolation of degree 15 on equal
/// panels, integrated term by term. F is exact to rounding when f is analytic and varies on a
/// length not shorter than a few panels; F(a) = 0 exactly. Evaluation takes some 20 ns.
class CumulativeIntegral {
 public:
  CumulativeIntegral() = default;

  template <class Function>
  CumulativeIntegral(Function&& f, double a, double b, std::size_t panels)
      : a_(a), panels_(std::max<std::size_t>(1, panels)) {
    width_ = (b - a) / static_cast<double>(panels_);
    integrand_.resize(panels_ * kTerms);
    integral_.resize(panels_ * (kTerms + 1));
    start_.assign(panels_ + 1, 0.0);
    for (std::size_t panel = 0; panel < panels_; ++panel) {
      std::array<double, kTerms> values{};
      const double left = a + width_ * static_cast<double>(panel);
      for (std::size_t i = 0; i < kTerms; ++i) {
        const double x = std::cos(std::numbers::pi * (static_cast<double>(i) + 0.5) / kTerms);
        values[i] = f(left + 0.5 * width_ * (x + 1.0));
      }
      double* c = &integrand_[panel * kTerms];
      for (std::size_t j = 0; j < kTerms; ++j) {
        double sum = 0.0;
        for (std::size_t i = 0; i < kTerms; ++i) {
          sum += values[i] * std::cos(std::numbers::pi * static_cast<double>(j) *
                                      (static_cast<double>(i) + 0.5) / kTerms);
        }
        c[j] = sum * (j == 0 ? 1.0 : 2.0) / kTerms;
      }
      // int T_j = T_{j+1} / (2(j+1)) - T_{j-1} / (2(j-1)); the constant makes it 0 at the left end.
      double* d = &integral_[panel * (kTerms + 1)];
      const auto term = [&](std::size_t j) { return j < kTerms ? c[j] : 0.0; };
      d[1] = c[0] - 0.5 * term(2);
      for (std::size_t j = 2; j <= kTerms; ++j) {
        d[j] = (term(j - 1) - term(j + 1)) / (2.0 * static_cast<double>(j));
      }
      double at_left = 0.0;
      for (std::size_t j = 1; j <= kTerms; ++j) at_left += (j % 2 == 0 ? d[j] : -d[j]);
      d[0] = -at_left;
      double at_right = 0.0;
      for (std::size_t j = 0; j <= kTerms; ++j) at_right += d[j];
      start_[panel + 1] = start_[panel] + 0.5 * width_ * at_right;
    }
  }

  /// F(x) [unit of f times unit of x]; x outside [a, b] is extrapolated from the last panel.
  [[nodiscard]] double integral(double x) const {
    const auto [panel, t] = locate(x);
    if (x == a_) return 0.0;
    return start_[panel] + 0.5 * width_ * clenshaw(&integral_[panel * (kTerms + 1)], kTerms + 1, t);
  }

  /// f(x) as interpolated.
  [[nodiscard]] double integrand(double x) const {
    const auto [panel, t] = locate(x);
    return clenshaw(&integrand_[panel * kTerms], kTerms, t);
  }

 private:
  static constexpr std::size_t kTerms = 16;
  struct Place {
    std::size_t panel;
    double t;
  };
  [[nodiscard]] Place locate(double x) const {
    const double position = (x - a_) / width_;
    const double last = static_cast<double>(panels_ - 1);
    const double panel = std::clamp(std::floor(position), 0.0, last);
    return {static_cast<std::size_t>(panel), 2.0 * (position - panel) - 1.0};
  }
  static double clenshaw(const double* c, std::size_t n, double t) {
    double b1 = 0.0;
    double b2 = 0.0;
    for (std::size_t j = n - 1; j > 0; --j) {
      const double b0 = 2.0 * t * b1 - b2 + c[j];
      b2 = b1;
      b1 = b0;
    }
    return t * b1 - b2 + c[0];
  }
  double a_ = 0.0;
  double width_ = 1.0;
  std::size_t panels_ = 1;
  std::vector<double> integrand_, integral_, start_;
};

}  // namespace feltmb
