#pragma once

#include <cmath>
#include <tuple>

#include "feltmb/contact/laws/concept.hpp"
#include "feltmb/numeric/elementary.hpp"

namespace feltmb {

/// Loading-unloading pair, thesis eqs 4.21-4.22:
///   F = F_L(e)                                 for de/dt >= 0,
///   F = F_L(e) + (F_L - F_U)(e) tanh(alpha de/dt)  for de/dt < 0.
/// `printed`: literally so; the fits cross at several contacts of Table A.12, beyond which the law
/// leaves its own bounds and creates energy, and F may be negative. `guarded`: F_L held at >= 0 and
/// F_U at 0 <= F_U <= F_L, hence 0 <= F_U <= F <= F_L. Rate dependent: the hysteresis shrinks as
/// alpha |de/dt| falls below 1; no memory of the largest compression.
/// Stored energy: the integral of the loading curve used. Two options: `hysteresis` h widens or
/// narrows the loop, F_U -> F_L - h (F_L - F_U); a rate term as in FeltMemory, F += rate_amplitude
/// (F_L - r), rate_time dr/dt = F_L - r, the sum held at >= 0 (printed: not held).
struct ExponentialPair {
  enum class Form { kPrinted, kGuarded };
  ExponentialCurve loading;
  ExponentialCurve unloading;
  double alpha = 100.0;  ///< transition constant [s/m], > 0; 100 is assumed, the thesis gives none
  Form form = Form::kGuarded;
  double hysteresis = 1.0;      ///< h [-], >= 0; 0: loading curve both ways
  double rate_amplitude = 0.0;  ///< [-], >= 0
  double rate_time = 0.0;       ///< [s], > 0 with a rate term
  // Computed by prepare().
  double first_positive = 0.0;  ///< compression below which a guarded curve is held at 0 [m]
  double energy_offset = 0.0;   ///< integral of the unguarded curve up to there [J]

  static constexpr LawName kNames[] = {
      {"guarded", "loading-unloading pair of eq. 4.22, held inside 0 <= F_U <= F <= F_L"},
      {"printed", "the same pair as printed: may pull and make energy where its fits cross"}};
  static constexpr const char* kTable = "memory";
  static constexpr auto fields() {
    using L = ExponentialPair;
    return std::tuple{
        entry("loading", &L::loading, "loading curve", Place::kContact),
        entry("unloading", &L::unloading, "unloading curve", Place::kContact),
        number("alpha", &L::alpha, "s/m", above(0.0), "transition constant", Place::kContact),
        number("hysteresis", &L::hysteresis, "1", at_least(0.0), "width of the loop",
               Place::kContact),
        number("rate_amplitude", &L::rate_amplitude, "1", at_least(0.0), "of the rate term"),
        number("rate_time", &L::rate_time, "s", at_least(0.0), "of the rate term, > 0 with it")};
  }
  void choose(std::size_t name) { form = name == 0 ? Form::kGuarded : Form::kPrinted; }
  std::size_t chosen() const { return form == Form::kGuarded ? 0 : 1; }
  void check(LawFaults& faults) const { faults.rate_term(rate_amplitude, rate_time); }

  void prepare() {
    if (form != Form::kGuarded) return;
    // Where a e exp(b e) + c e turns positive: 0 if it is positive from the start.
    const bool positive = loading.a + loading.c >= 0.0 || loading.a <= 0.0 || loading.b <= 0.0;
    first_positive = positive ? 0.0 : std::log(-loading.c / loading.a) / loading.b;
    energy_offset = integral(loading, first_positive);
  }

  LawValue force(double e, double rate) const {
    const CurveValue load = evaluate(loading, e);
    const bool guarded = form == Form::kGuarded;
    if (guarded && load.force <= 0.0) return {};
    if (rate >= 0.0) return {load.force, load.slope, 0.0};
    CurveValue unload = evaluate(unloading, e);
    if (guarded) {
      if (unload.force < 0.0) unload = {0.0, 0.0};
      if (unload.force > load.force) unload = load;
    }
    if (hysteresis != 1.0) {
      unload.force = load.force - hysteresis * (load.force - unload.force);
      unload.slope = load.slope - hysteresis * (load.slope - unload.slope);
      if (guarded && unload.force < 0.0) unload = {0.0, 0.0};
    }
    const HyperbolicTangent t = fast_tanh(alpha * rate);
    const double band = load.force - unload.force;
    return {load.force + band * t.value, load.slope + (load.slope - unload.slope) * t.value,
            band * alpha * t.slope};
  }
  /// Loading curve that the pair uses, zero where it is open or held at zero.
  CurveValue rest_force(double e) const {
    if (e <= 0.0) return {};
    const CurveValue load = evaluate(loading, e);
    return form == Form::kGuarded && load.force <= 0.0 ? CurveValue{} : load;
  }
  double energy(double e) const {
    if (form == Form::kGuarded && e <= first_positive) return 0.0;
    return integral(loading, e) - energy_offset;
  }

  // With a rate term there is one state r.
  std::size_t n_states() const { return rate_amplitude > 0.0 ? 1 : 0; }
  LawState state(std::size_t, double) const { return {"overstress", 1.0}; }
  void relax(double e, double* state) const { state[0] = rest_force(e).force; }

  LawValue force(double e, double rate, const LawMemory& memory, LawStates& s) const {
    const CurveValue load = rest_force(e);
    s.force[0] = 0.0;
    s.rate[0] = (load.force - memory.state[0]) / rate_time;
    s.rate_by_compression[0] = load.slope / rate_time;
    s.rate_by_state[0][0] = -1.0 / rate_time;
    if (e <= 0.0) return {};
    LawValue v = force(e, rate);
    const double extra = rate_amplitude * (load.force - memory.state[0]);
    if (form == Form::kGuarded && v.force + extra <= 0.0) return {};
    v.force += extra;
    v.d_compression += rate_amplitude * load.slope;
    s.force[0] = -rate_amplitude;
    return v;
  }

  int piece(double e, double rate, const LawMemory&) const {
    if (e <= 0.0) return kOff;
    const double load = evaluate(loading, e).force;
    const bool guarded = form == Form::kGuarded;
    if (guarded && load <= 0.0) return kOff;
    if (rate >= 0.0) return kLoading;
    if (!guarded) return kUnloading;
    const double unload = evaluate(unloading, e).force;
    if (unload < 0.0) return kNoUnloadingForce;
    return unload > load ? kLoading : kUnloading;
  }
};

}  // namespace feltmb
