#pragma once

#include <algorithm>
#include <memory>
#include <tuple>

#include "feltmb/contact/laws/concept.hpp"

namespace feltmb {

/// Rate-independent felt with memory.
///
/// Memory: e_m, the largest compression so far, and z in [0, 1], where the force lies between the
/// unloading branch of the cycle to e_m and the virgin loading curve:
///   F = F_U + z D,  F_U = F_L(e) rho(e / e_m),  D = F_L - F_U     for e < e_m,
///   F = F_L(e),  e_m = e                                          for e >= e_m,
///   dz/dt = (D / c) [(1 - z) max(de/dt, 0) - z max(-de/dt, 0)]     for e < e_m,
///   dz/dt = -(z / c) W'(e_m) de_m/dt                               on virgin loading,
///   c = kappa W(e_m).
/// D vanishes at 0 and at e_m, so the force has no jump at a reversal; reloading meets F_L at e_m.
/// Stored energy psi = integral of (F_U + D/2) + (c/4)(2 z - 1)^2. The power left over is
/// (D/2)(2 z - 1)^2 |de/dt| at fixed e_m. On virgin loading it is W'(e_m) de_m/dt times
/// 1/2 - kappa (2 z - 1)^2 / 4 + z (2 z - 1) = (1 - kappa / 2)(2 z - 1)^2 / 2 + z. Neither is
/// negative for kappa <= 2: the law is passive.
///
/// A felt that was reloaded to e_m (z near 1) unloads from there along a higher force than one that
/// was never let go (z = 0), whose unloading is the measured F_U. Virgin loading wipes this out
/// as its loop grows by the length c, as unloading does: what a felt remembers of a compression
/// fades with the share of the area that this had, and a loop of no area leaves nothing. To set z
/// to 0 at e_m at once would not be passive. The option `wiping_out` = w > 0 takes earlier cycles
/// out of the memory within the loop, too: with the area Q(e) = integral of D from 0 to e and
/// R = W - Q
///   dz/dt = D [(1 - z) max(de/dt, 0) / (w Q + c) - z max(-de/dt, 0) / (w R + c)].
/// Near the return points e = 0 and e_m, where Q or R is small, the transition takes an area of the
/// order of c only, so that for kappa << w every cycle to e_m runs along F_L and F_U; between them
/// it takes the share w of the area since the return point. Stored energy: with S = w W + 2 c,
/// z* = 1 - (w Q + c) / S, k = S / (2 (1 + w)),
///   psi = integral of (F_U + z* D) + k (z - z*)^2;
/// power left over: 2 k (z - z*)^2 D |de/dt| / (w Q + c) loading, with R unloading, and
/// (1/2 - k (z - z*)^2 / W + 2 k z (z - z*) / c) W'(e_m) de_m/dt on virgin loading: not negative
/// for kappa <= 2, any w.
///
/// Options, off by default:
/// recovery of e_m while open, exp(-t / recovery_time); creep, a Kelvin element in series (thesis
/// section 2.2.3, after Stamm); a rate term, F += rate_amplitude (F_L(e) - r), rate_time dr/dt =
/// F_L(e) - r (after Stulov), the sum held at >= 0.
struct FeltMemory {
  /// Below this largest compression [m] a felt counts as virgin, because the slopes of its memory
  /// would not be finite.
  static constexpr double nothing = 1e-150;
  std::shared_ptr<const Envelope> envelope;
  double kappa = 0.2;            ///< transition length over the loop [-], in (0, 2]
  double recovery_time = 0.0;    ///< [s], 0: none
  double creep_stiffness = 0.0;  ///< G of the Kelvin element [N/m], 0: no creep
  double creep_damping = 0.0;    ///< its damper [N s/m], > 0 with creep
  double rate_amplitude = 0.0;   ///< [-], >= 0
  double rate_time = 0.0;        ///< [s], > 0 with a rate term
  double wiping_out = 0.0;       ///< w [-], >= 0; 0: only virgin loading wipes out

  static constexpr LawName kNames[] = {
      {"felt_memory", "rate independent, remembers its largest compression, passive"}};
  static constexpr const char* kTable = "memory";
  static constexpr auto fields() {
    using L = FeltMemory;
    return std::tuple{
        entry("envelope", &L::envelope, "loop: a pair of curves, or a table"),
        number("kappa", &L::kappa, "1", up_to(above(0.0), 2.0), "transition length over the loop"),
        number("wiping_out", &L::wiping_out, "1", at_least(0.0),
               "share of earlier cycles that is forgotten; 0: none"),
        number("recovery_time", &L::recovery_time, "s", at_least(0.0),
               "of the largest compression while open; 0: none"),
        number("creep_stiffness", &L::creep_stiffness, "N/m", at_least(0.0),
               "of the Kelvin element in series; 0: no creep"),
        number("creep_damping", &L::creep_damping, "N s/m", at_least(0.0),
               "of the Kelvin element, > 0 with creep"),
        number("rate_amplitude", &L::rate_amplitude, "1", at_least(0.0), "of the rate term"),
        number("rate_time", &L::rate_time, "s", at_least(0.0), "of the rate term, > 0 with it")};
  }
  void check(LawFaults& faults) const {
    faults.require(creep_stiffness == 0.0 || creep_damping != 0.0, "creep_damping [N s/m]",
                   creep_damping, "> 0 with creep");
    faults.rate_term(rate_amplitude, rate_time);
  }

  static constexpr bool kRemembers = true;
  const Envelope* cycle_envelope() const { return envelope.get(); }
  bool creeps() const { return creep_stiffness > 0.0; }
  std::size_t n_states() const { return 1 + (creeps() ? 1 : 0) + (rate_amplitude > 0.0 ? 1 : 0); }
  /// z is a fraction of a band that is at most a tenth of the force for soft felts; creep is a
  /// length; the overstress is a force of some N.
  LawState state(std::size_t i, double compression) const {
    if (i == 0) return {"z", 10.0};
    if (i == 1 && creeps()) return {"creep", compression};
    return {"overstress", 1.0};
  }
  void relax(double compression, double* state) const;
  bool still_when_open() const { return n_states() == 1; }

  LawValue force(double compression, double rate, const LawMemory& memory, LawStates& states) const;
  CurveValue rest_force(double compression) const;
  double rest_energy(double compression) const;
  double energy(double compression, const LawMemory& memory) const;
  double dissipated_power(double compression, double rate, const LawMemory& memory) const;
  int piece(double compression, double rate, const LawMemory& memory) const;

  /// Compression and rate of the felt itself, which may be in series with a creeping layer.
  double inner_compression(double compression, const LawMemory& memory) const {
    return creeps() ? compression - memory.state[1] : compression;
  }
  double inner_rate(double compression, double rate, const LawMemory& memory) const;

  /// Exact at fixed e_m without options: 1 - z decreases by exp(-A/c) in loading, and z in
  /// unloading, where A is the area of the traversed band. The force depends on the path only.
  bool advance(PathPoint& at, double compression, double duration) const;
  /// What virgin loading from `largest` makes of z, exactly: z (W / W')^(1 / kappa). No force of
  /// it depends on z, so that an integrator may leave z alone until the felt turns.
  void widen(double compression, double largest, double* state) const;
  void limit(double* state) const { state[0] = std::clamp(state[0], 0.0, 1.0); }
};

}  // namespace feltmb
