#pragma once

#include <tuple>

#include "feltmb/contact/laws/concept.hpp"

namespace feltmb {

/// Linear Kelvin-Voigt law, a spring and a dashpot in parallel: F = k e + c de/dt, clipped at F >=
/// 0. Stored energy k e^2/2; passive. The force jumps by c de/dt when the surfaces meet. Because of
/// this known fault, the law should not be used for felt.
struct KelvinVoigt {
  double stiffness = 0.0;  ///< k [N/m], > 0
  double damping = 0.0;    ///< c [N s/m], >= 0

  static constexpr LawName kNames[] = {
      {"kelvin_voigt", "spring and dashpot, k e + c de/dt; the force jumps at contact"}};
  static constexpr auto fields() {
    using L = KelvinVoigt;
    return std::tuple{number("stiffness", &L::stiffness, "N/m", above(0.0), "k"),
                      number("damping", &L::damping, "N s/m", at_least(0.0), "c")};
  }

  LawValue force(double e, double rate) const {
    const double sum = stiffness * e + damping * rate;
    if (sum <= 0.0) return {};
    return {sum, stiffness, damping};
  }
  CurveValue rest_force(double e) const { return {stiffness * e, stiffness}; }
  double energy(double e) const { return 0.5 * stiffness * e * e; }
};

}  // namespace feltmb
