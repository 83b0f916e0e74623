/// Play of a joint: a pin that moves in its hole up to the wall.
#pragma once

#include <cmath>

namespace feltmb {

/// Force R x / (w - |x|) against a displacement x from the middle of the hole.
///
/// A smooth form of a hole of radial clearance w: under a load F the pin stands at
/// x = w F / (F + R), near the wall for F >> R. As w goes to 0 the joint becomes the ideal one,
/// and the displacement under a given load is proportional to w. Conservative: energy
/// R (w ln(w / (w - |x|)) - |x|). Beyond |x| = 0.99 w the force goes on along its tangent.
struct Play {
  double clearance = 0.0;  ///< w [m or rad], 0: none
  double seating = 0.0;    ///< R [N or N m]

  struct Value {
    double force = 0.0;   ///< toward the middle
    double slope = 0.0;   ///< d force / dx
    double energy = 0.0;  ///< [J]
  };

  Value at(double x) const {
    if (clearance == 0.0) return {};
    const double end = 0.99 * clearance;
    const double inside = std::fmin(std::fabs(x), end);
    const double room = clearance - inside;
    Value v;
    v.force = seating * inside / room;
    v.slope = seating * clearance / (room * room);
    v.energy = seating * (clearance * std::log(clearance / room) - inside);
    const double beyond = std::fabs(x) - inside;
    v.energy += beyond * (v.force + 0.5 * v.slope * beyond);
    v.force = std::copysign(v.force + v.slope * beyond, x);
    return v;
  }
};

}  // namespace feltmb
