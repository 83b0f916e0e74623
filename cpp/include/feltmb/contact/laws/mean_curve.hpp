#pragma once

#include <tuple>

#include "feltmb/contact/laws/concept.hpp"

namespace feltmb {

/// Hysteresis-free mean of the two curves, F = max(0, (F_L + F_U)/2), the lower-fidelity contact
/// of thesis section 4.2.4. Conservative; stored energy is its integral.
struct MeanCurve {
  ExponentialCurve loading;
  ExponentialCurve unloading;
  // Computed by prepare().
  double first_positive = 0.0;  ///< compression below which the mean is held at 0 [m]
  double energy_offset = 0.0;   ///< integral of the mean up to there [J]

  static constexpr LawName kNames[] = {
      {"mean", "mean of loading and unloading, without hysteresis"}};
  static constexpr auto fields() {
    using L = MeanCurve;
    return std::tuple{entry("loading", &L::loading, "loading curve", Place::kContact),
                      entry("unloading", &L::unloading, "unloading curve", Place::kContact)};
  }
  void prepare();

  LawValue force(double e, double) const {
    const CurveValue load = evaluate(loading, e);
    const CurveValue unload = evaluate(unloading, e);
    const double mean = 0.5 * (load.force + unload.force);
    if (mean <= 0.0) return {};
    return {mean, 0.5 * (load.slope + unload.slope), 0.0};
  }
  double energy(double e) const { return e <= first_positive ? 0.0 : work(e) - energy_offset; }

 private:
  double work(double e) const { return 0.5 * (integral(loading, e) + integral(unloading, e)); }
};

/// The mean of two exponential curves has no closed first root: bisection on the sign of F/e.
inline void MeanCurve::prepare() {
  const auto sign = [&](double e) {
    return evaluate(loading, e).force + evaluate(unloading, e).force;
  };
  const auto first = [&] {
    double low = 1e-12;
    if (sign(low) >= 0.0) return 0.0;
    double high = 1e-6;
    while (sign(high) < 0.0) {
      high *= 2.0;
      if (high > 1.0) return 0.0;
    }
    for (int i = 0; i < 200 && high - low > 1e-18; ++i) {
      const double middle = 0.5 * (low + high);
      (sign(middle) < 0.0 ? low : high) = middle;
    }
    return high;
  };
  first_positive = first();
  energy_offset = work(first_positive);
}

}  // namespace feltmb
