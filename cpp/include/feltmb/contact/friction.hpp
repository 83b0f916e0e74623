/// Friction of joints and contacts against the speed of sliding: a sum of terms.
///
/// A term is a struct, in the list at the end of this file, that has
///   fields()        the table of its numbers; with their defaults it has no force
///   acts()          whether it has a force at all
///   at(v, v_t)      force and its exact slope at sliding speed v; odd in v and v F(v) >= 0: it
///                   opposes sliding. v_t: threshold speed of terms with tanh(v/v_t)
///   kTurnsOver      whether it has such a tanh
/// and, if it holds a joint back at speeds near zero (breakaway, see feltmb.run.quasistatic),
///   dry_speeds()    where its force rises, and beyond which it has died away or is constant
///   sharpen()       leaves what remains in the limit v_t -> 0
/// Unit of a force: without one at a contact (times the normal force), N m at a revolute joint, N
/// at a prismatic one, independent of the joint's load; a speed is in rad/s at a revolute joint,
/// else in m/s.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>

#include "feltmb/core/fields.hpp"
#include "feltmb/numeric/elementary.hpp"

namespace feltmb {

struct FrictionValue {
  double value;  ///< force, see above
  double slope;  ///< its derivative by the speed
};

struct SpeedRange {
  double low;   ///< [m/s] or [rad/s]
  double high;  ///< infinite: it grows without end
};

/// Regularised Coulomb friction, thesis eq. A.1 (after Hirschkorn),
///   A [ tanh(v/v_t) + B1 (v/v_t) / (1 + B2 (v/v_t)^4) ].
/// The printed text names the normal speed; the tangential sliding speed is meant. At rest it
/// creeps, because its force at v = 0 is zero.
struct CoulombFriction {
  double amplitude = 0.0;         ///< A, >= 0
  double b1 = 0.0;                ///< B1 [-], >= 0
  double b2 = 0.0;                ///< B2 [-], >= 0
  double threshold_speed = 1e-3;  ///< v_t, > 0

  static constexpr bool kTurnsOver = true;
  static constexpr auto fields() {
    using F = CoulombFriction;
    return std::tuple{
        number("amplitude", &F::amplitude, "N m | N | 1", at_least(0.0), "A of eq. A.1"),
        number("b1", &F::b1, "1", at_least(0.0), "B1 of eq. A.1, the bump at low speed"),
        number("b2", &F::b2, "1", at_least(0.0), "B2 of eq. A.1, its end"),
        number("threshold_speed", &F::threshold_speed, "rad/s | m/s", above(0.0),
               "v_t, at which tanh turns over"),
    };
  }
  bool acts() const { return amplitude != 0.0; }
  FrictionValue at(double v, double v_t) const {
    const double x = v / v_t;
    const HyperbolicTangent t = fast_tanh(x);
    double value = t.value;
    double slope = t.slope;
    if (b1 != 0.0) {
      const double x4 = b2 * x * x * x * x;
      const double d = 1.0 / (1.0 + x4);
      value += b1 * x * d;
      slope += b1 * (1.0 - 3.0 * x4) * d * d;
    }
    return {amplitude * value, amplitude * slope / v_t};
  }
  SpeedRange dry_speeds() const {
    double high = 5.0 * threshold_speed;
    if (b2 > 0.0) {  // the bump is at B2^(-1/4) thresholds
      high = std::max(high, 3.0 * threshold_speed * std::pow(b2, -0.25));
    } else if (amplitude > 0.0 && b1 > 0.0) {
      high = std::numeric_limits<double>::infinity();
    }
    return {1e-3 * threshold_speed, high};
  }
  void sharpen() { b1 = b2 = 0.0; }  // the excess lies below v_t
};

/// Viscous and quadratic drag, C v + D |v| v.
struct DragFriction {
  double viscous = 0.0;    ///< C, >= 0
  double quadratic = 0.0;  ///< D, >= 0

  static constexpr bool kTurnsOver = false;
  static constexpr auto fields() {
    using F = DragFriction;
    return std::tuple{
        number("viscous", &F::viscous, "N m s/rad | N s/m | s/m", at_least(0.0), "C of C v"),
        number("quadratic", &F::quadratic, "N m s^2/rad^2 | N s^2/m^2 | s^2/m^2", at_least(0.0),
               "D of D |v| v"),
    };
  }
  bool acts() const { return viscous != 0.0 || quadratic != 0.0; }
  FrictionValue at(double v, double) const {
    return {(viscous + quadratic * std::fabs(v)) * v, viscous + 2.0 * quadratic * std::fabs(v)};
  }
};

/// Stribeck's excess friction at low speed, S exp(-(v/v_s)^2) tanh(v/v_t) (R. Stribeck; the form is
/// that of B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, Automatica 30 (1994) 1083, with
/// tanh for the sign).
struct StribeckFriction {
  double stribeck = 0.0;        ///< S, >= 0
  double stribeck_speed = 0.1;  ///< v_s, > 0

  static constexpr bool kTurnsOver = true;
  static constexpr auto fields() {
    using F = StribeckFriction;
    return std::tuple{
        number("stribeck", &F::stribeck, "N m | N | 1", at_least(0.0), "S, excess at low speed"),
        number("stribeck_speed", &F::stribeck_speed, "rad/s | m/s", above(0.0),
               "v_s, beyond which it dies away"),
    };
  }
  bool acts() const { return stribeck != 0.0; }
  FrictionValue at(double v, double v_t) const {
    const double y = v / stribeck_speed;
    const double bell = stribeck * std::exp(-y * y);
    const HyperbolicTangent t = fast_tanh(v / v_t);
    return {bell * t.value, bell * (t.slope / v_t - 2.0 * y / stribeck_speed * t.value)};
  }
  SpeedRange dry_speeds() const { return {1e-3 * stribeck_speed, 3.0 * stribeck_speed}; }
  void sharpen() {}  // it has a speed of its own
};

/// A sum of terms, with the fields of all.
template <class... Terms>
struct FrictionSum : Terms... {
  static constexpr auto fields() { return std::tuple_cat(Terms::fields()...); }
  bool acts() const { return (Terms::acts() || ...); }

  /// Whether an active term changes its sign within a few threshold speeds.
  bool turns_over() const { return ((Terms::kTurnsOver && Terms::acts()) || ...); }

  FrictionValue at(double v) const { return sum<Terms...>(v); }

  /// Speeds at which the dry terms have risen and have decayed.
  SpeedRange dry_speeds() const {
    SpeedRange out{std::numeric_limits<double>::infinity(), 0.0};
    const auto widen = [&]<class T>(const T& term) {
      if constexpr (requires { term.dry_speeds(); }) {
        out.low = std::min(out.low, term.dry_speeds().low);
        out.high = std::max(out.high, term.dry_speeds().high);
      }
    };
    (widen(static_cast<const Terms&>(*this)), ...);
    return out;
  }

  /// The dry terms alone.
  FrictionSum dry() const {
    FrictionSum out;
    const auto copy = [&]<class T>(const T& term) {
      if constexpr (requires { term.dry_speeds(); }) static_cast<T&>(out) = term;
    };
    (copy(static_cast<const Terms&>(*this)), ...);
    return out;
  }

  /// The limit v_t -> 0 of all terms, regularized at a chosen speed.
  FrictionSum sharpened(double v_t) const {
    FrictionSum out = *this;
    const auto sharpen = []<class T>(T& term) {
      if constexpr (requires { term.sharpen(); }) term.sharpen();
    };
    (sharpen(static_cast<Terms&>(out)), ...);
    out.threshold_speed = v_t;
    return out;
  }

 private:
  /// Starts with the last term; an inactive term changes no bit.
  template <class Term, class... Rest>
  FrictionValue sum(double v) const {
    FrictionValue own{0.0, 0.0};
    if (Term::acts()) own = Term::at(v, this->threshold_speed);
    if constexpr (sizeof...(Rest) > 0) {
      const FrictionValue rest = sum<Rest...>(v);
      own = {own.value + rest.value, own.slope + rest.slope};
    }
    return own;
  }
};

/// List of the terms: a new term needs its struct above and its name here.
using Friction = FrictionSum<  //
    CoulombFriction,           //
    DragFriction,              //
    StribeckFriction>;

/// Friction of the Coulomb term alone.
constexpr Friction coulomb(double amplitude, double b1, double b2, double threshold_speed) {
  Friction f{};
  f.amplitude = amplitude;
  f.b1 = b1;
  f.b2 = b2;
  f.threshold_speed = threshold_speed;
  return f;
}

/// Force and its exact slope at sliding speed v [m/s or rad/s]. Never throws.
inline FrictionValue evaluate(const Friction& friction, double v) { return friction.at(v); }

}  // namespace feltmb
