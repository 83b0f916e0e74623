#include "feltmb/ode/adams_quadrature.hpp"

#include <algorithm>

namespace feltmb {
namespace {

/// Adds the integrals over [from, to] of the polynomials through the rates at the nodes: weights of
/// the nodes by Gauss' rule with three points, exact for five nodes.
template <std::size_t nodes>
void add_integrals(const double* node, const double* const* rate, double from, double to,
                   std::span<double> z) {
  constexpr double kPoint = 0.774596669241483377035853079956480;
  constexpr double points[] = {-kPoint, 0.0, kPoint};
  constexpr double shares[] = {5.0 / 18.0, 4.0 / 9.0, 5.0 / 18.0};
  double weight[nodes];
  for (std::size_t i = 0; i < nodes; ++i) {
    double sum = 0.0;
    for (std::size_t g = 0; g < 3; ++g) {
      const double t = 0.5 * (from + to) + 0.5 * (to - from) * points[g];
      double basis = shares[g];
      for (std::size_t j = 0; j < nodes; ++j) basis *= j == i ? 1.0 : t - node[j];
      sum += basis;
    }
    double apart = 1.0;
    for (std::size_t j = 0; j < nodes; ++j) apart *= j == i ? 1.0 : node[i] - node[j];
    weight[i] = (to - from) * sum / apart;
  }
  for (std::size_t k = 0; k < z.size(); ++k) {
    double sum = z[k];
    for (std::size_t i = 0; i < nodes; ++i) sum += weight[i] * rate[i][k];
    z[k] = sum;
  }
}

}  // namespace

AdamsQuadrature::AdamsQuadrature(std::size_t count)
    : rates_(kMostNodes * count), before_(count), integral_(count) {}

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

void AdamsQuadrature::advance(double from, double to, std::span<double> z) const {
  const double* rate[kMostNodes] = {};
  for (std::size_t i = 0; i < used_; ++i) rate[i] = row(i);
  switch (used_) {
    case 2:
      return add_integrals<2>(time_, rate, from, to, z);
    case 3:
      return add_integrals<3>(time_, rate, from, to, z);
    case 4:
      return add_integrals<4>(time_, rate, from, to, z);
    default:
      return add_integrals<5>(time_, rate, from, to, z);
  }
}

}  // namespace feltmb
