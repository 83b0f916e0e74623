#pragma once

#include <cmath>
#include <tuple>

#include "feltmb/contact/laws/concept.hpp"
#include "feltmb/numeric/bracketing.hpp"

namespace feltmb {

/// Maxwell relaxation with nonlinear springs, the three-component model (thesis section 2.2.3,
/// after Sajn): F = E e^p + B (e^q - g), tau dg/dt = e^q - g, clipped at F >= 0. A spring beside a
/// branch whose force relaxes in the time tau. One state g [m^q].
/// Stored energy, with e_g = g^(1/q) where the branch carries nothing: the integral of E x^p from 0
/// to e plus that of B (x^q - g) from e_g to e; where the surface has left the felt behind, both
/// at the compression at which the felt is free. Heat B (e - e_g)(e^q - g)/tau >= 0: passive.
struct Maxwell {
  double stiffness = 0.0;         ///< E, slow [N/m^p], > 0
  double exponent = 2.5;          ///< p [-], >= 1
  double branch_stiffness = 0.0;  ///< B [N/m^q], >= 0
  double branch_exponent = 2.5;   ///< q [-], >= 1
  double branch_time = 1e-3;      ///< tau [s], > 0

  static constexpr LawName kNames[] = {
      {"maxwell", "spring beside one that relaxes: E e^p + B (e^q - g), tau dg/dt = e^q - g"}};
  static constexpr auto fields() {
    using L = Maxwell;
    return std::tuple{
        number("stiffness", &L::stiffness, "N/m^p", above(0.0), "E, slow"),
        number("exponent", &L::exponent, "1", at_least(1.0), "p"),
        number("branch_stiffness", &L::branch_stiffness, "N/m^p", at_least(0.0), "B"),
        number("branch_exponent", &L::branch_exponent, "1", at_least(1.0), "q"),
        number("branch_time", &L::branch_time, "s", above(0.0), "tau, relaxation time")};
  }

  std::size_t n_states() const { return 1; }
  LawState state(std::size_t, double compression) const {
    return {"g", std::pow(compression, branch_exponent)};
  }
  void relax(double e, double* state) const { state[0] = power(e, branch_exponent); }

  LawValue force(double e, double, const LawMemory& memory, LawStates& s) const {
    s = {};
    const double g = memory.state[0];
    const double now = power(e, branch_exponent);
    const double slope = e > 0.0 ? branch_exponent * now / e : 0.0;
    s.rate[0] = (now - g) / branch_time;
    s.rate_by_compression[0] = slope / branch_time;
    s.rate_by_state[0][0] = -1.0 / branch_time;
    if (e <= 0.0) return {};
    const double slow = stiffness * std::pow(e, exponent);
    const double sum = slow + branch_stiffness * (now - g);
    if (sum <= 0.0) return {};
    s.force[0] = -branch_stiffness;
    return {sum, exponent * slow / e + branch_stiffness * slope, 0.0};
  }
  CurveValue rest_force(double e) const {
    const double slow = stiffness * std::pow(e, exponent);
    return {slow, exponent * slow / e};
  }
  double energy(double e, const LawMemory& memory) const {
    const double g = memory.state[0];
    const double free = free_compression(g);
    const double at = std::fmax(e, free);
    if (at <= 0.0) return 0.0;
    const double start = branch_start(g);
    const double n = branch_exponent + 1.0;
    return stiffness * std::pow(at, exponent + 1.0) / (exponent + 1.0) +
           branch_stiffness * ((std::pow(at, n) - std::pow(start, n)) / n - g * (at - start));
  }
  double dissipated_power(double e, double, const LawMemory& memory) const {
    const double g = memory.state[0];
    const double at = std::fmax(e, free_compression(g));
    return branch_stiffness * (at - branch_start(g)) * (power(e, branch_exponent) - g) /
           branch_time;
  }
  int piece(double e, double, const LawMemory& memory) const {
    if (e <= 0.0) return kOff;
    return e > free_compression(memory.state[0]) ? kLoading : kNoForce;
  }

  /// e^q taken linear within the step: exact exponential of the linear equation.
  bool advance(PathPoint& at, double compression, double duration) const {
    const double before = power(at.compression, branch_exponent);
    const double after = power(compression, branch_exponent);
    const double x = duration / branch_time;
    const double decay = std::exp(-x);
    const double mean = x > 1e-6 ? -std::expm1(-x) / x : 1.0 - 0.5 * x;
    at.state[0] = at.state[0] * decay + before * (mean - decay) + after * (1.0 - mean);
    at.compression = compression;
    return true;
  }

 private:
  static double power(double e, double exponent) { return e > 0.0 ? std::pow(e, exponent) : 0.0; }
  /// Compression at which the force of the branch is zero [m].
  double branch_start(double g) const { return power(g, 1.0 / branch_exponent); }
  /// Compression below which the force of the felt is zero [m].
  double free_compression(double g) const {
    const double start = branch_start(g);
    if (start <= 0.0 || branch_stiffness == 0.0) return 0.0;
    const auto sum = [&](double x) {
      return stiffness * power(x, exponent) + branch_stiffness * (power(x, branch_exponent) - g);
    };
    const double top = sum(start);
    return top > 0.0 ? find_root_bracketed(sum, 0.0, sum(0.0), start, top, 1e-15) : start;
  }
};

}  // namespace feltmb
