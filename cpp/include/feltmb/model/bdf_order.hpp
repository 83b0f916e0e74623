/// Permitted order of the BDF for a mechanism.
///
/// No order above two is stable for every undamped mode at every step (G. Dahlquist, BIT 3 (1963)
/// 27). Two things follow. Fast modes that move less than the tolerance, as most of a string's do,
/// hold the step at the border of stability unless the sector of the order holds them: A(90, 90,
/// 86.0, 73.3, 51.8 degrees) for the orders 1 to 5, a mode of damping ratio xi at the angle
/// acos(xi). Modes that the error test resolves are damped by the orders 1, 2 and 5 at short steps,
/// but grow under 3 and 4 however short the step is: the tolerance is relative and grows with them.
///
/// So order 5 is used in steps that are short enough for every mode, and the order of the sector in
/// longer ones only (IntegratorOptions::long_order).
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "feltmb/planar/mechanism.hpp"

namespace feltmb {

/// A free mode of a mechanism, without contact or drive.
struct FreeMode {
  double rate = 0.0;     ///< omega [rad/s], > 0
  double damping = 0.0;  ///< ratio xi [-]
};

/// Modes of bodies, springs and flexible members about a pose, with constant condensed coordinates;
/// modes of strings are not included. Only members have damping: friction saturates and does not
/// damp large motions.
std::vector<FreeMode> free_modes(const std::shared_ptr<const Mechanism>& mechanism,
                                 std::span<const double> pose);

/// Largest order whose sector holds the modes of all strings; 5 without strings.
int order_of_strings(const Mechanism& mechanism);

/// Growth of an undamped mode under the BDF of an order, 1 to 5, with the step h: e-folds a radian.
/// @param step  h omega [rad], > 0, below the border of stability
double growth_per_radian(int order, double step);

/// h omega up to which the BDF of order 5 is stable for a mode of this damping ratio [rad].
double border_of_stability(double damping);

/// Longest step in which every mode of strings and members is stable under the BDF of order 5 [s];
/// infinity if there are none.
double stable_step(const Mechanism& mechanism, const std::vector<FreeMode>& modes);

/// Largest order, at most `order`, under which no mode grows by more than a factor e in `duration`
/// [s].
/// @param rtol  relative error that the error test leaves to one state in one step [-]
int order_without_growth(int order, const std::vector<FreeMode>& modes, double rtol,
                         double duration);

}  // namespace feltmb
