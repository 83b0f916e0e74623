#pragma once

#include <cmath>
#include <tuple>

#include "feltmb/contact/laws/concept.hpp"

namespace feltmb {

/// Hunt-Crossley law F = k e^p (1 + d de/dt), clipped at F >= 0
/// (K. H. Hunt, F. R. E. Crossley, J. Appl. Mech. 42 (1975) 440). Stored energy k e^(p+1)/(p+1).
struct HuntCrossley {
  double stiffness = 0.0;  ///< k [N/m^p], > 0
  double exponent = 1.5;   ///< p [-], >= 1
  double damping = 0.0;    ///< d [s/m], >= 0

  static constexpr LawName kNames[] = {{"hunt_crossley", "k e^p (1 + d de/dt)"}};
  static constexpr auto fields() {
    using L = HuntCrossley;
    return std::tuple{number("stiffness", &L::stiffness, "N/m^p", above(0.0), "k"),
                      number("exponent", &L::exponent, "1", at_least(1.0), "p"),
                      number("damping", &L::damping, "s/m", at_least(0.0), "d")};
  }

  LawValue force(double e, double rate) const {
    const double elastic = stiffness * std::pow(e, exponent);
    const double factor = 1.0 + damping * rate;
    if (factor <= 0.0) return {};
    return {elastic * factor, exponent * elastic / e * factor, elastic * damping};
  }
  double energy(double e) const {
    return stiffness * std::pow(e, exponent + 1.0) / (exponent + 1.0);
  }
};

}  // namespace feltmb
