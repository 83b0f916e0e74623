#pragma once

#include <cmath>
#include <tuple>

#include "feltmb/contact/laws/concept.hpp"

namespace feltmb {

/// Stulov's second form, the slow limit of the hereditary law (thesis eq. 2.12):
/// F = F0 (e^p + alpha d(e^p)/dt), clipped at F >= 0. Stored energy F0 e^(p+1)/(p+1); passive.
struct StulovDifferential {
  double stiffness = 0.0;  ///< F0, static [N/m^p], > 0
  double exponent = 2.5;   ///< p [-], >= 1
  double time = 0.0;       ///< alpha, retarded time [s], >= 0

  static constexpr LawName kNames[] = {
      {"stulov_differential", "slow limit of stulov: F0 (e^p + alpha d(e^p)/dt)"}};
  static constexpr auto fields() {
    using L = StulovDifferential;
    return std::tuple{number("stiffness", &L::stiffness, "N/m^p", above(0.0), "F0, static"),
                      number("exponent", &L::exponent, "1", at_least(1.0), "p"),
                      number("time", &L::time, "s", at_least(0.0), "alpha, retarded time")};
  }

  LawValue force(double e, double rate) const {
    const double elastic = stiffness * std::pow(e, exponent);
    const double slope = exponent * elastic / e;
    const double sum = elastic + time * slope * rate;
    if (sum <= 0.0) return {};
    return {sum, slope * (1.0 + time * (exponent - 1.0) / e * rate), time * slope};
  }
  double energy(double e) const {
    return stiffness * std::pow(e, exponent + 1.0) / (exponent + 1.0);
  }
};

}  // namespace feltmb
