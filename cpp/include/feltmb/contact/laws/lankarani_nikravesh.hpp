#pragma once

#include <cmath>
#include <tuple>

#include "feltmb/contact/laws/concept.hpp"

namespace feltmb {

/// Lankarani and Nikravesh, thesis section 2.3: F = K e^n (1 + 3 (1 - r^2)/4 (de/dt)/v), clipped at
/// F >= 0 (J. Mech. Des. 112 (1990) 369). At the impact speed v, the damping gives the restitution
/// r to first order in 1 - r, so that the law is accurate for r near 1. The authors use the v of
/// each impact; here v is a parameter. Stored energy K e^(n+1)/(n+1); passive.
struct LankaraniNikravesh {
  double stiffness = 0.0;     ///< K [N/m^n], > 0
  double exponent = 1.5;      ///< n [-], >= 1; 3/2: Hertz
  double restitution = 1.0;   ///< r [-], in [0, 1]
  double impact_speed = 1.0;  ///< v [m/s], > 0

  static constexpr LawName kNames[] = {
      {"lankarani_nikravesh", "K e^n (1 + 3 (1 - r^2)/4 (de/dt)/v), r the restitution at speed v"}};
  static constexpr auto fields() {
    using L = LankaraniNikravesh;
    return std::tuple{
        number("stiffness", &L::stiffness, "N/m^p", above(0.0), "K"),
        number("exponent", &L::exponent, "1", at_least(1.0), "n; 3/2: Hertz"),
        number("restitution", &L::restitution, "1", up_to(at_least(0.0), 1.0),
               "r; the impact gives more: 0.725 for 0.5, 0.80 for 0.7, 0.91 for 0.9"),
        number("impact_speed", &L::impact_speed, "m/s", above(0.0), "v, at which r is meant")};
  }

  LawValue force(double e, double rate) const {
    const double elastic = stiffness * std::pow(e, exponent);
    const double damping = 0.75 * (1.0 - restitution * restitution) / impact_speed;
    const double factor = 1.0 + damping * rate;
    if (factor <= 0.0) return {};
    return {elastic * factor, exponent * elastic / e * factor, elastic * damping};
  }
  double energy(double e) const {
    return stiffness * std::pow(e, exponent + 1.0) / (exponent + 1.0);
  }
};

}  // namespace feltmb
