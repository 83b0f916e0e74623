#include "feltmb/modal/response.hpp"

#include <algorithm>
#include <cmath>

#include "feltmb/core/error.hpp"

namespace feltmb::modal {
namespace {

constexpr double kTaylorReach = 1.0;  // largest |eigenvalue| h of the series
constexpr int kTerms = 19;            // 1 / 20! is below the unit roundoff

/// g = sum a_i, with a_i h^-i the Taylor coefficients of the impulse response.
void sum_series(std::size_t n, double h, const double* __restrict k, const double* __restrict d,
                double* __restrict slope, double* __restrict g0, double* __restrict g1,
                double* __restrict g2, double* __restrict g3) {
  for (std::size_t i = 0; i < n; ++i) {
    const double kh = k[i] * h * h;
    const double dh = d[i] * h;
    double before = 0.0;
    double a = 1.0;  // a_1 / h
    double s = 1.0, s0 = 1.0, s1 = 0.5, s2 = 1.0 / 6.0, s3 = 1.0 / 24.0;
    for (int j = 2; j <= kTerms; ++j) {
      const double p = j;
      const double next = -(dh * (p - 1.0) * a + kh * before) / (p * (p - 1.0));
      before = a;
      a = next;
      s += p * a;
      s0 += a;
      s1 += a / (p + 1.0);
      s2 += a / ((p + 1.0) * (p + 2.0));
      s3 += a / ((p + 1.0) * (p + 2.0) * (p + 3.0));
    }
    slope[i] = s;
    g0[i] = h * s0;
    g1[i] = h * h * s1;
    g2[i] = h * h * h * s2;
    g3[i] = h * h * h * h * s3;
  }
}

/// The response over 2 h: that over h carried on, with the forces' polynomials shifted.
void double_step(std::size_t n, double h, const double* __restrict k, const double* __restrict d,
                 const double* __restrict slope, const double* __restrict g0,
                 const double* __restrict g1, const double* __restrict g2,
                 const double* __restrict g3, double* __restrict slope_out,
                 double* __restrict g0_out, double* __restrict g1_out, double* __restrict g2_out,
                 double* __restrict g3_out) {
  const double half_square = 0.5 * h * h;
  for (std::size_t i = 0; i < n; ++i) {
    const double g = g0[i];
    const double c = slope[i] + d[i] * g;
    slope_out[i] = slope[i] * slope[i] - k[i] * g * g;
    g0_out[i] = g * (c + slope[i]);
    g1_out[i] = c * g1[i] + g * g + g1[i];
    g2_out[i] = c * g2[i] + g * g1[i] + g2[i] + h * g1[i];
    g3_out[i] = c * g3[i] + g * g2[i] + g3[i] + h * g2[i] + half_square * g1[i];
  }
}

void combine(std::size_t n, double h, const double* __restrict k, const double* __restrict d,
             const double* __restrict slope, const double* __restrict g0,
             const double* __restrict g1, const double* __restrict g2, const double* __restrict g3,
             double* __restrict xx, double* __restrict vx, double* __restrict x0,
             double* __restrict xm, double* __restrict x1, double* __restrict v0,
             double* __restrict vm, double* __restrict v1) {
  const double a = 1.0 / h;
  const double b = 2.0 / (h * h);
  for (std::size_t i = 0; i < n; ++i) {
    xx[i] = slope[i] + d[i] * g0[i];
    vx[i] = -k[i] * g0[i];
    const double p1 = a * g2[i];
    const double p2 = b * g3[i];
    x0[i] = g1[i] - 3.0 * p1 + 2.0 * p2;
    xm[i] = 4.0 * (p1 - p2);
    x1[i] = 2.0 * p2 - p1;
    const double q1 = a * g1[i];
    const double q2 = b * g2[i];
    v0[i] = g0[i] - 3.0 * q1 + 2.0 * q2;
    vm[i] = 4.0 * (q1 - q2);
    v1[i] = 2.0 * q2 - q1;
  }
}

void size(StepResponse& r, std::size_t n) {
  for (auto* v : {&r.slope, &r.impulse, &r.first, &r.second, &r.third}) v->resize(n);
}

}  // namespace

ModalResponse::ModalResponse(std::vector<double> stiffness, std::vector<double> damping,
                             double longest)
    : stiffness_(std::move(stiffness)),
      damping_(std::move(damping)),
      longest_(longest),
      fastest_(0.0),
      levels_(kMaxLevel + 1) {
  if (stiffness_.empty() || stiffness_.size() != damping_.size()) {
    throw InvalidParameter(
        format("modes: got %zu stiffnesses and %zu dampings, expected equal and >= 1",
               stiffness_.size(), damping_.size()));
  }
  if (!(std::isfinite(longest) && longest > 0.0)) {
    throw InvalidParameter(format("modes: longest step = %.6g s, must be > 0", longest));
  }
  for (std::size_t i = 0; i < stiffness_.size(); ++i) {
    const double k = stiffness_[i];
    const double d = damping_[i];
    if (!(std::isfinite(k) && k >= 0.0 && std::isfinite(d) && d >= 0.0)) {
      throw InvalidParameter(
          format("modes: mode %zu: stiffness = %.6g 1/s^2, damping = %.6g 1/s, must be >= 0", i + 1,
                 k, d));
    }
    fastest_ = std::max(fastest_, d + std::sqrt(k));
  }
}

double ModalResponse::step(int level) const { return std::ldexp(longest_, -level); }

const StepResponse& ModalResponse::at(int level) {
  StepResponse& own = levels_[static_cast<std::size_t>(level)];
  if (own.step > 0.0) return own;
  const double h = step(level);
  // Beyond the deepest level the series is summed although its terms grow at first.
  own = fastest_ * h <= kTaylorReach ? taylor(h)
        : level < kMaxLevel          ? doubled(at(level + 1))
                                     : over(h);
  return own;
}

StepResponse ModalResponse::over(double step) const {
  int halvings = 0;
  double h = step;
  while (fastest_ * h > kTaylorReach && halvings < 60) {
    h = 0.5 * h;
    ++halvings;
  }
  StepResponse r = taylor(h);
  for (int i = 0; i < halvings; ++i) r = doubled(r);
  return r;
}

StepResponse ModalResponse::taylor(double step) const {
  StepResponse r;
  r.step = step;
  size(r, modes());
  sum_series(modes(), step, stiffness_.data(), damping_.data(), r.slope.data(), r.impulse.data(),
             r.first.data(), r.second.data(), r.third.data());
  return r;
}

StepResponse ModalResponse::doubled(const StepResponse& half) const {
  StepResponse r;
  r.step = 2.0 * half.step;
  size(r, modes());
  double_step(modes(), half.step, stiffness_.data(), damping_.data(), half.slope.data(),
              half.impulse.data(), half.first.data(), half.second.data(), half.third.data(),
              r.slope.data(), r.impulse.data(), r.first.data(), r.second.data(), r.third.data());
  return r;
}

StepWeights ModalResponse::weights(const StepResponse& whole) const {
  StepWeights w;
  const std::size_t n = modes();
  for (auto* v : {&w.xx, &w.vx, &w.x0, &w.xm, &w.x1, &w.v0, &w.vm, &w.v1}) v->resize(n);
  w.xv = whole.impulse;
  w.vv = whole.slope;
  combine(n, whole.step, stiffness_.data(), damping_.data(), whole.slope.data(),
          whole.impulse.data(), whole.first.data(), whole.second.data(), whole.third.data(),
          w.xx.data(), w.vx.data(), w.x0.data(), w.xm.data(), w.x1.data(), w.v0.data(), w.vm.data(),
          w.v1.data());
  return w;
}

}  // namespace feltmb::modal
