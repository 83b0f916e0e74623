/// Integrals over time of rates that are known at the ends of an integrator's steps.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

namespace feltmb {

/// z' = h(t) by the Adams-Moulton formula of variable steps: the polynomial through the rates at
/// the last nodes is integrated over the last step. k nodes give the order k. Rates may have kinks:
/// there the order is that of the kink.
class AdamsQuadrature {
 public:
  static constexpr std::size_t kMostNodes = 5;

  /// All integrals are zero.
  explicit AdamsQuadrature(std::size_t count);

  std::size_t size() const { return integral_.size(); }

  /// The rates jump, or were unknown: only nodes from t on count. The integrals go on.
  void start(double t, std::span<const double> rates);

  /// Goes on to t, with at most `nodes` of them, in [2, kMostNodes].
  void step(double t, std::span<const double> rates, std::size_t nodes);

  /// Back to a time within the last step, where a start follows.
  void cut(double t);

  /// Integrals at t within the last step.
  void integrals(double t, std::span<double> z) const;

 private:
  double* row(std::size_t node) { return rates_.data() + rows_[node] * size(); }
  const double* row(std::size_t node) const { return rates_.data() + rows_[node] * size(); }
  void advance(double from, double to, std::span<double> z) const;

  std::size_t known_ = 0;  ///< nodes, the newest first
  std::size_t used_ = 0;   ///< of these, in the last step
  double time_[kMostNodes] = {};
  std::size_t rows_[kMostNodes] = {0, 1, 2, 3, 4};  ///< of each node in rates_
  std::vector<double> rates_;
  std::vector<double> before_;    ///< integrals at the beginning of the last step
  std::vector<double> integral_;  ///< at its end
};

}  // namespace feltmb
