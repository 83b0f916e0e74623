#pragma once

#include <cmath>
#include <tuple>

#include "feltmb/contact/laws/concept.hpp"

namespace feltmb {

/// Hereditary law F = F0 max(0, e^p - amplitude g), tau0 dg/dt = e^p - g
/// (A. Stulov, J. Acoust. Soc. Am. 97 (1995) 2577; thesis eq. 2.11 in differential form).
/// One state g [m^p]. Stored energy: that of the static curve F0 (1 - amplitude) e^p.
struct Stulov {
  double stiffness = 0.0;  ///< F0, instantaneous [N/m^p], > 0
  double exponent = 2.5;   ///< p [-], >= 1
  double amplitude = 0.0;  ///< hysteresis amplitude [-], in [0, 1)
  double time = 1e-5;      ///< tau0 [s], > 0

  static constexpr LawName kNames[] = {
      {"stulov", "hereditary: F0 (e^p - amplitude g), tau0 dg/dt = e^p - g"}};
  static constexpr auto fields() {
    using L = Stulov;
    return std::tuple{number("stiffness", &L::stiffness, "N/m^p", above(0.0), "F0, instantaneous"),
                      number("exponent", &L::exponent, "1", at_least(1.0), "p"),
                      number("amplitude", &L::amplitude, "1", below(at_least(0.0), 1.0),
                             "epsilon, amplitude of the hysteresis"),
                      number("time", &L::time, "s", above(0.0), "tau0")};
  }

  std::size_t n_states() const { return 1; }
  LawState state(std::size_t, double compression) const {
    return {"g", std::pow(compression, exponent)};
  }
  void relax(double e, double* state) const { state[0] = power(e); }

  LawValue force(double e, double, const LawMemory& memory, LawStates& s) const {
    LawValue v;
    s = {};  // nothing stays of another branch
    const double g = memory.state[0];
    const double now = power(e);
    const double slope = e > 0.0 ? exponent * now / e : 0.0;
    s.rate[0] = (now - g) / time;
    s.rate_by_compression[0] = slope / time;
    s.rate_by_state[0][0] = -1.0 / time;
    const double relaxed = now - amplitude * g;
    if (e > 0.0 && relaxed > 0.0) {
      v.force = stiffness * relaxed;
      v.d_compression = stiffness * slope;
      s.force[0] = -stiffness * amplitude;
    }
    return v;
  }
  CurveValue rest_force(double e) const {
    const double f = stiffness * (1.0 - amplitude) * std::pow(e, exponent);
    return {f, exponent * f / e};
  }
  double energy(double e) const {
    return stiffness * (1.0 - amplitude) * std::pow(e, exponent + 1.0) / (exponent + 1.0);
  }
  int piece(double e, double, const LawMemory& memory) const {
    if (e <= 0.0) return kOff;
    return std::pow(e, exponent) > amplitude * memory.state[0] ? kLoading : kNoForce;
  }

  /// e^p taken linear within the step: exact exponential of the linear equation.
  bool advance(PathPoint& at, double compression, double duration) const {
    const double before = power(at.compression);
    const double after = power(compression);
    const double x = duration / time;
    const double decay = std::exp(-x);
    const double mean = x > 1e-8 ? (1.0 - decay) / x : 1.0 - 0.5 * x;
    at.state[0] = at.state[0] * decay + before * (mean - decay) + after * (1.0 - mean);
    at.compression = compression;
    return true;
  }

 private:
  double power(double e) const { return e > 0.0 ? std::pow(e, exponent) : 0.0; }
};

}  // namespace feltmb
