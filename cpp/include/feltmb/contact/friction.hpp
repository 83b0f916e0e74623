/// Regularised Coulomb friction, thesis eq. A.1.
#pragma once

namespace feltmb {

/// Friction coefficient against sliding speed,
///   mu(v) = A [ tanh(v/v_t) + B1 (v/v_t) / (1 + B2 (v/v_t)^4) ],
/// thesis eq. A.1 (after Hirschkorn). The printed text names the normal speed; the tangential
/// sliding speed is meant. Used for contacts (A without unit, force mu(v) F_n) and for joints
/// (A is the friction torque [N m] or force [N] itself, independent of the joint load).
/// Three more terms, zero by default, that the thesis leaves out:
///   + C v + D |v| v + S exp(-(v/v_s)^2) tanh(v/v_t):
/// viscous and quadratic drag, and the Stribeck excess that holds a slow pivot back (R. Stribeck;
/// the form is that of B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, Automatica 30 (1994)
/// 1083, with tanh for the sign).
/// mu is odd in v, so that mu(v) v >= 0: the force opposes sliding. The regularised law creeps at
/// rest: it holds no load at v = 0.
struct Friction {
  double amplitude = 0.0;         ///< A [-] (contact), [N m] (revolute) or [N] (prismatic), >= 0
  double b1 = 0.0;                ///< B1 [-], >= 0
  double b2 = 0.0;                ///< B2 [-], >= 0
  double threshold_speed = 1e-3;  ///< v_t [m/s] (contact, prismatic) or [rad/s] (revolute), > 0
  double viscous = 0.0;           ///< C, unit of A per unit of v, >= 0
  double quadratic = 0.0;         ///< D, unit of A per squared unit of v, >= 0
  double stribeck = 0.0;          ///< S, unit of A, >= 0
  double stribeck_speed = 0.1;    ///< v_s, unit of v, > 0

  bool operator==(const Friction&) const = default;
};

struct FrictionValue {
  double value;  ///< mu(v), unit of A
  double slope;  ///< d mu / d v, unit of A per unit of v
};

/// Whether the law turns over within a few threshold speeds: a term with tanh(v/v_t) is there.
bool turns_over(const Friction& friction);

/// mu and its exact slope at sliding speed v [m/s or rad/s]. Never throws.
FrictionValue evaluate(const Friction& friction, double v);

}  // namespace feltmb
