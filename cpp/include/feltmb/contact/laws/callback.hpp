#pragma once

#include <cmath>
#include <tuple>
#include <vector>

#include "feltmb/contact/laws/concept.hpp"
#include "feltmb/numeric/quadrature.hpp"

namespace feltmb {

/// Compiled function of compression [m], rate [m/s] and parameters, that writes F [N], dF/de [N/m]
/// and dF/d(de/dt) [N s/m]. It is called from several threads simultaneously and must not have a
/// state.
using LawFunction = void (*)(double e, double rate, const double* parameters, double* out);

/// Law by a compiled function of the caller, F = max(0, function), at e > 0. A file cannot contain
/// it, because a function is an address in this process. Stored energy: the integral of F(e, 0) by
/// quadrature.
struct Callback {
  LawFunction function = nullptr;
  std::vector<double> parameters;

  static constexpr LawName kNames[] = {
      {"callback", "a compiled function of the caller, from Python or C++ only"}};
  static constexpr auto fields() {
    using L = Callback;
    return std::tuple{entry("function", &L::function, "address of the function"),
                      entry("parameters", &L::parameters, "numbers that it is given")};
  }

  LawValue force(double e, double rate) const {
    double out[3] = {};
    function(e, rate, parameters.data(), out);
    if (out[0] <= 0.0) return {};
    return {out[0], out[1], out[2]};
  }
  /// Over x = e t^2: a power of e is smooth in t.
  double energy(double e) const {
    return integrate_composite([&](double t) { return force(e * t * t, 0.0).force * 2.0 * e * t; },
                               0.0, 1.0, 2);
  }
};

}  // namespace feltmb
