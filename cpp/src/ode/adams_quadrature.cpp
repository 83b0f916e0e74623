#include "feltmb/ode/adams_quadrature.hpp"

#include <algorithm>

namespace feltmb {

AdamsQuadrature::AdamsQuadrature(std::size_t count)
    : rates_(kMostNodes * count), before_(count), integral_(count) {}

void AdamsQuadrature::reset() {
  known_ = used_ = 0;
  std::fill(before_.begin(), before_.end(), 0.0);
  std::fill(integral_.begin(), integral_.end(), 0.0);
}

void AdamsQuadrature::start(double t, std::span<const double> rates) {
  time_[0] = t;
  known_ = used_ = 1;
  before_ = integral_;
  std::copy(rates.begin(), rates.end(), row(0));
}

void AdamsQuadrature::step(double t, std::span<const double> rates, std::size_t nodes) {
  known_ = std::min(known_ + 1, kMostNodes);
  used_ = std::min(known_, nodes);
  std::rotate(time_, time_ + kMostNodes - 1, time_ + kMostNodes);
  std::rotate(rows_, rows_ + kMostNodes - 1, rows_ + kMostNodes);
  time_[0] = t;
  std::copy(rates.begin(), rates.end(), row(0));
  before_ = integral_;
  advance(time_[1], t, integral_);
}

void AdamsQuadrature::cut(double t) { integrals(t, integral_); }

void AdamsQuadrature::integrals(double t, std::span<double> z) const {
  std::copy(before_.begin(), before_.end(), z.begin());
  if (used_ > 1) advance(time_[1], t, z);
}

/// Weights of the nodes by Gauss' rule with three points, exact for five nodes.
void AdamsQuadrature::advance(double from, double to, std::span<double> z) const {
  constexpr double kPoint = 0.774596669241483377035853079956480;
  constexpr double points[] = {-kPoint, 0.0, kPoint};
  constexpr double shares[] = {5.0 / 18.0, 4.0 / 9.0, 5.0 / 18.0};
  double weight[kMostNodes] = {};
  for (std::size_t g = 0; g < 3; ++g) {
    const double t = 0.5 * (from + to) + 0.5 * (to - from) * points[g];
    for (std::size_t i = 0; i < used_; ++i) {
      double basis = shares[g];
      for (std::size_t j = 0; j < used_; ++j) {
        if (j != i) basis *= (t - time_[j]) / (time_[i] - time_[j]);
      }
      weight[i] += basis;
    }
  }
  for (std::size_t i = 0; i < used_; ++i) {
    const double w = (to - from) * weight[i];
    const double* rate = row(i);
    for (std::size_t k = 0; k < z.size(); ++k) z[k] += w * rate[k];
  }
}

}  // namespace feltmb
