/// Laws with memory from the literature, for comparison with the compression laws.
///
/// Input is a history of compression x(t), output stress [Pa] or force [N], both positive in
/// compression and never negative (felt does not pull).
/// For dunlop, stamm_kelvin and maxwell x is engineering strain 1 - v_f0/v_f [-] and the result a
/// stress; for the others x is a compression [m] and the result a force [N]. Sources: thesis 2.2.3,
/// eqs. 2.11, 2.12; Dunlop [23], Stamm [100], Stulov [103-107], Sajn [116], Hunt and Crossley
/// [38], Lankarani and Nikravesh [55].
#pragma once

#include <map>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "feltmb/fiber/compression.hpp"

namespace feltmb {

/// A law with internal state, advanced sample by sample.
class HistoryLaw {
 public:
  virtual ~HistoryLaw() = default;
  /// Back to the virgin state.
  virtual void reset() = 0;
  /// Advances to the next sample.
  /// @param dt    time since the last sample [s] > 0 (0 for the first)
  /// @param x     compression now, [-] or [m]
  /// @param rate  dx/dt now [1/s] or [m/s] (used by the laws that depend on it)
  /// @return stress [Pa] or force [N]
  virtual double step(double dt, double x, double rate) = 0;
};

/// Known laws. Parameters are lists (one value unless said otherwise).
///   dunlop  units in series under one stress s: spring stress s_i follows |s - s_i| <= f_c_i +
///           phi_i s_i; strain is the mean of the units' strains. f_c [Pa] list >= 0,
///           phi [-] list in [0, 1) (one value is repeated). Spring: any compression law.
///           Rate independent, remembers turning points, keeps a residual strain.
///   stamm_kelvin  dunlop in series with a Kelvin element: G [Pa] > 0, c [Pa s] > 0: hysteresis
///   creep. maxwell nonlinear spring E_inf x^p_inf in parallel with Maxwell branches whose springs
///   are
///           E_i x^p_i and relaxation times tau_i [s]: E, p, tau lists (one branch: the
///           three-component model).
///   stulov  eq. 2.11, stiffness F0 [N/m^p], exponent p, amplitude in [0, 1), time tau0 [s]:
///           F = F0 (x^p - amplitude g), tau0 dg/dt = x^p - g.
///   stulov_differential  eq. 2.12, static stiffness F0 [N/m^p], exponent p, time alpha [s]:
///           F = F0 (x^p + alpha d(x^p)/dt).
///   hunt_crossley  stiffness K [N/m^p], exponent n, damping d [s/m]: F = K x^n (1 + d dx/dt).
///   lankarani_nikravesh  stiffness, exponent, restitution e in [0, 1], impact_speed [m/s]:
///           F = K x^n (1 + 3 (1 - e^2)/4 (dx/dt)/impact_speed); good for e near 1.
const std::vector<LawDescription>& history_descriptions();

/// A history law in its virgin state.
/// @param spring  compression law of the springs (dunlop, stamm_kelvin); ignored by others
/// Throws InvalidParameter naming every unknown, missing and out-of-range parameter at once.
std::unique_ptr<HistoryLaw> make_history_law(const std::string& name,
                                             const std::map<std::string, std::vector<double>>& p,
                                             std::shared_ptr<const CompressionLaw> spring = {});

/// Runs a law from its virgin state over samples.
/// @param time  [s], strictly increasing
/// @param x     compression, same size, finite; strain laws: x < 1 - v_f0
/// @param rate  dx/dt, same size
/// @param out   stress [Pa] or force [N], same size
void run_history(HistoryLaw& law, std::span<const double> time, std::span<const double> x,
                 std::span<const double> rate, std::span<double> out);

}  // namespace feltmb
