/// Contact laws: normal force from compression, compression rate and the law's own history.
///
/// A law knows nothing of bodies. Compression e > 0 when touching [m], rate = de/dt [m/s], force
/// F > 0 pushes the bodies apart [N]. Every law gives its exact slopes, the energy that it can
/// give back (stored energy) and, if it has memory, the rates of its states.
#pragma once

#include <array>
#include <cstddef>
#include <memory>
#include <string>
#include <variant>

#include "feltmb/contact/curve.hpp"
#include "feltmb/contact/envelope.hpp"

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
};

/// Hysteresis-free mean of the two curves, F = max(0, (F_L + F_U)/2), the lower-fidelity contact
/// of thesis section 4.2.4. Conservative; stored energy is its integral.
struct MeanCurve {
  ExponentialCurve loading;
  ExponentialCurve unloading;
};

/// Hunt-Crossley law F = k e^p (1 + d de/dt), clipped at F >= 0
/// (K. H. Hunt, F. R. E. Crossley, J. Appl. Mech. 42 (1975) 440). Stored energy k e^(p+1)/(p+1).
struct HuntCrossley {
  double stiffness = 0.0;  ///< k [N/m^p], > 0
  double exponent = 1.5;   ///< p [-], >= 1
  double damping = 0.0;    ///< d [s/m], >= 0
};

/// Hereditary law F = F0 max(0, e^p - amplitude g), tau0 dg/dt = e^p - g
/// (A. Stulov, J. Acoust. Soc. Am. 97 (1995) 2577; thesis eq. 2.11 in differential form).
/// One state g [m^p]. Stored energy: that of the static curve F0 (1 - amplitude) e^p.
struct Stulov {
  double stiffness = 0.0;  ///< F0, instantaneous [N/m^p], > 0
  double exponent = 2.5;   ///< p [-], >= 1
  double amplitude = 0.0;  ///< hysteresis amplitude [-], in [0, 1)
  double time = 1e-5;      ///< tau0 [s], > 0
};

/// Rate-independent felt with memory.
///
/// Memory: e_m, the largest compression so far, and z in [0, 1], where the force lies between the
/// unloading branch of the cycle to e_m and the virgin loading curve:
///   F = F_U + z D,  F_U = F_L(e) rho(e / e_m),  D = F_L - F_U     for e < e_m,
///   F = F_L(e),  e_m = e                                          for e >= e_m,
///   dz/dt = (D / c) [(1 - z) max(de/dt, 0) - z max(-de/dt, 0)],   c = kappa W(e_m).
/// D vanishes at 0 and at e_m, so the force has no jump at a reversal; reloading meets F_L at e_m.
/// Stored energy psi = integral of (F_U + D/2) + (c/4)(2 z - 1)^2: the power left over,
/// (D/2)(2 z - 1)^2 |de/dt| at fixed e_m and (1/2 - kappa (2 z - 1)^2 / 4) W'(e_m) de_m/dt on
/// virgin loading, is never negative for kappa <= 2: the law is passive.
///
/// Virgin loading keeps z: a felt that was never let go (z = 0) unloads from e_m along F_U, the
/// measured curve, one that was reloaded to e_m (z near 1) along a higher one. To set z back there
/// would not be passive. The option `wiping_out` = w > 0 takes earlier cycles out of the memory:
/// with the area Q(e) = integral of D from 0 to e and R = W - Q
///   dz/dt = D [(1 - z) max(de/dt, 0) / (w Q + c) - z max(-de/dt, 0) / (w R + c)].
/// Near the return points e = 0 and e_m, where Q or R is small, the transition takes an area of the
/// order of c only, so that for kappa << w every cycle to e_m runs along F_L and F_U; between them
/// it takes the share w of the area since the return point. Stored energy: with S = w W + 2 c,
/// z* = 1 - (w Q + c) / S, k = S / (2 (1 + w)),
///   psi = integral of (F_U + z* D) + k (z - z*)^2;
/// power left over: 2 k (z - z*)^2 D |de/dt| / (w Q + c) loading, with R unloading, and
/// (1/2 - k (z - z*)^2 / W) W'(e_m) de_m/dt on virgin loading: not negative for kappa <= 2, any w.
///
/// Options, off by default:
/// recovery of e_m while open, exp(-t / recovery_time); creep, a Kelvin element in series (thesis
/// section 2.2.3, after Stamm); a rate term, F += rate_amplitude (F_L(e) - r), rate_time dr/dt =
/// F_L(e) - r (after Stulov), the sum held at >= 0.
struct FeltMemory {
  /// A felt that was never pressed further [m] is virgin: the slopes of its memory are no numbers.
  static constexpr double nothing = 1e-150;
  std::shared_ptr<const Envelope> envelope;
  double kappa = 0.2;            ///< transition length over the loop [-], in (0, 2]
  double recovery_time = 0.0;    ///< [s], 0: none
  double creep_stiffness = 0.0;  ///< G of the Kelvin element [N/m], 0: no creep
  double creep_damping = 0.0;    ///< its damper [N s/m], > 0 with creep
  double rate_amplitude = 0.0;   ///< [-], >= 0
  double rate_time = 0.0;        ///< [s], > 0 with a rate term
  double wiping_out = 0.0;       ///< w [-], >= 0; 0: z is kept over virgin loading
};

using LawParameters = std::variant<ExponentialPair, MeanCurve, HuntCrossley, Stulov, FeltMemory>;

/// Largest number of states of one law that are integrated with the rest.
inline constexpr std::size_t kMaxLawStates = 3;

/// Force of a law and its exact slopes.
struct LawValue {
  double force = 0.0;          ///< F [N]
  double d_compression = 0.0;  ///< dF/de [N/m]
  double d_rate = 0.0;         ///< dF/d(de/dt) [N s/m]
};

/// States s of a law that has any, of number n_states(): rates and exact derivatives. What lies
/// beyond n_states() means nothing.
struct LawStates {
  std::array<double, kMaxLawStates> force{};                ///< dF/ds
  std::array<double, kMaxLawStates> rate{};                 ///< ds/dt
  std::array<double, kMaxLawStates> rate_by_compression{};  ///< d(ds/dt)/de
  std::array<double, kMaxLawStates> rate_by_rate{};         ///< d(ds/dt)/d(de/dt)
  std::array<std::array<double, kMaxLawStates>, kMaxLawStates> rate_by_state{};
};

/// Memory of a law: integrated states, and the largest compression, which changes only at
/// reversals (and by recovery) and is constant in between.
struct LawMemory {
  const double* state = nullptr;  ///< n_states() values
  double largest = 0.0;           ///< e_m [m]
  /// What the envelope knows of the cycle to e_m; used if it is that, else formed anew.
  const CycleStart* cycle = nullptr;
};

/// A law ready for use: parameters checked, derived constants computed. Immutable.
class ContactLaw {
 public:
  /// Throws InvalidParameter naming the field, its value and the permitted range.
  explicit ContactLaw(const LawParameters& parameters);

  const LawParameters& parameters() const { return parameters_; }

  /// Name as written in a mechanism file: "printed", "guarded", "mean", "hunt_crossley",
  /// "stulov", "felt_memory".
  std::string name() const;

  /// Number of states that are integrated.
  std::size_t n_states() const { return n_states_; }

  /// Name of a state, for messages.
  const char* state_name(std::size_t i) const;

  /// Whether the states keep still while the contact is open: nothing need be evaluated then.
  bool still_when_open() const {
    return n_states_ == 0 || (n_states_ == 1 && std::holds_alternative<FeltMemory>(parameters_));
  }

  /// Whether the law remembers its largest compression.
  bool has_memory() const { return std::holds_alternative<FeltMemory>(parameters_); }

  /// Brings the cycle to `largest` [m] of a law with memory up to date.
  void keep_cycle(double largest, CycleStart& cycle) const {
    const Envelope* envelope = std::get<FeltMemory>(parameters_).envelope.get();
    if (cycle.largest != largest || cycle.of != envelope) cycle = envelope->cycle_to(largest);
  }

  /// Force and slopes at compression [m] and rate [m/s]; zero force for compression <= 0. Never
  /// throws. Laws with states or memory need `memory`; `states` is filled for them if given.
  LawValue evaluate(double compression, double rate, const LawMemory& memory = {},
                    LawStates* states = nullptr) const;

  /// Force and slope after the states have come to rest under a virgin compression [m]; the rest
  /// pose of a mechanism uses this.
  CurveValue static_force(double compression) const;
  double static_energy(double compression) const;  ///< its integral from 0 [J]

  /// States at rest under a virgin compression; `state` holds n_states() values.
  void relax(double compression, double* state) const;

  /// Energy that the law stores [J]: the integral of its loading curve from 0 unless the law
  /// names its own.
  double stored_energy(double compression, const LawMemory& memory = {}) const;

  /// Power that the law turns into heat [W], F de/dt minus the rate of the stored energy.
  double dissipated_power(double compression, double rate, const LawMemory& memory = {}) const;

  /// Compression and rate of the felt itself, behind a creeping layer if there is one.
  double felt_compression(double compression, const LawMemory& memory) const;
  double felt_rate(double compression, double rate, const LawMemory& memory) const;

 private:
  LawParameters parameters_;
  double first_positive_ = 0.0;  ///< compression below which a guarded curve is held at 0 [m]
  double energy_offset_ = 0.0;   ///< integral of the unguarded curve up to first_positive_ [J]
  std::size_t n_states_ = 0;
};

}  // namespace feltmb
