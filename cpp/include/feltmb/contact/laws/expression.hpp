#pragma once

#include <cmath>
#include <map>
#include <memory>
#include <string>
#include <tuple>

#include "feltmb/contact/laws/concept.hpp"
#include "feltmb/contact/laws/formula.hpp"
#include "feltmb/core/error.hpp"
#include "feltmb/numeric/quadrature.hpp"

namespace feltmb {

/// Law written as a formula in a mechanism file, F = max(0, formula(e, rate)), at e > 0. Stored
/// energy: the integral of F(e, 0) by quadrature. It is passive if the formula is never below its
/// value at rest during loading, and never above it during unloading. This is not checked.
struct Expression {
  std::string formula;
  std::map<std::string, double> parameters;  ///< SI
  std::shared_ptr<const Formula> parsed;     ///< by prepare()

  static constexpr LawName kNames[] = {
      {"expression", "a formula of compression e, rate and parameters, in the mechanism file"}};
  static constexpr auto fields() {
    using L = Expression;
    return std::tuple{
        entry("force", &L::formula, "formula of the force [N], such as k*e^p*(1 + d*rate)"),
        entry("parameters", &L::parameters, "numbers of the formula by name, SI")};
  }
  void check(LawFaults& faults) const {
    if (formula.empty()) return;  // already reported
    try {
      const Formula trial(formula, parameters);
    } catch (const InvalidParameter& error) {
      faults.add(std::string("expression: force: ") + error.what());
    }
  }
  void prepare() { parsed = std::make_shared<const Formula>(formula, parameters); }

  LawValue force(double e, double rate) const {
    const LawValue v = parsed->evaluate(e, rate);
    if (v.force <= 0.0) return {};
    return v;
  }
  /// Over x = e t^2: a power of e is smooth in t.
  double energy(double e) const {
    return integrate_composite([&](double t) { return force(e * t * t, 0.0).force * 2.0 * e * t; },
                               0.0, 1.0, 2);
  }
  int piece(double e, double rate, const LawMemory&) const {
    if (e <= 0.0) return kOff;
    if (force(e, rate).force <= 0.0) return kNoForce;
    return 8 + parsed->choices(e, rate);
  }
};

}  // namespace feltmb
