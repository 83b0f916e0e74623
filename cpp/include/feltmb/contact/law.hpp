/// Contact laws: normal force from compression, compression rate and the law's own history.
///
/// A law knows nothing of bodies. Compression e > 0 when touching [m], rate = de/dt [m/s], force
/// F > 0 pushes the bodies apart [N]. Every law gives its exact slopes, the energy that it can
/// give back (stored energy) and, if it has memory, the rates of its states.
#pragma once

#include <string>
#include <variant>

#include "feltmb/contact/curve.hpp"

namespace feltmb {

/// Loading-unloading pair, thesis eqs 4.21-4.22:
///   F = F_L(e)                                 for de/dt >= 0,
///   F = F_L(e) + (F_L - F_U)(e) tanh(alpha de/dt)  for de/dt < 0.
/// `printed`: literally so; the fits cross at several contacts of Table A.12, beyond which the law
/// leaves its own bounds and creates energy, and F may be negative. `guarded`: F_L held at >= 0 and
/// F_U at 0 <= F_U <= F_L, hence 0 <= F_U <= F <= F_L. Rate dependent: the hysteresis shrinks as
/// alpha |de/dt| falls below 1; no memory of the largest compression.
/// Stored energy: the integral of the loading curve used.
struct ExponentialPair {
  enum class Form { kPrinted, kGuarded };
  ExponentialCurve loading;
  ExponentialCurve unloading;
  double alpha = 100.0;  ///< transition constant [s/m], > 0; 100 is assumed, the thesis gives none
  Form form = Form::kGuarded;
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

using LawParameters = std::variant<ExponentialPair, MeanCurve, HuntCrossley>;

/// Force of a law and its exact derivatives.
struct LawValue {
  double force = 0.0;             ///< F [N]
  double d_compression = 0.0;     ///< dF/de [N/m]
  double d_rate = 0.0;            ///< dF/d(de/dt) [N s/m]
};

/// A law ready for use: parameters checked, derived constants computed. Immutable.
class ContactLaw {
 public:
  /// Throws InvalidParameter naming the field, its value and the permitted range.
  explicit ContactLaw(const LawParameters& parameters);

  const LawParameters& parameters() const { return parameters_; }

  /// Name as written in a mechanism file: "printed", "guarded", "mean", "hunt_crossley".
  std::string name() const;

  /// Force and slopes at compression [m] and rate [m/s]; zero for compression <= 0. Never throws.
  LawValue evaluate(double compression, double rate) const;

  /// Energy that the law stores [J], the integral of its loading curve from 0.
  double stored_energy(double compression) const;

  /// Slope of the stored energy, the elastic part of the force [N]; F minus this, times the rate,
  /// is the dissipated power.
  double elastic_force(double compression) const;

 private:
  LawParameters parameters_;
  double first_positive_ = 0.0;   ///< compression below which a guarded curve is held at 0 [m]
  double energy_offset_ = 0.0;    ///< integral of the unguarded curve up to first_positive_ [J]
};

}  // namespace feltmb
