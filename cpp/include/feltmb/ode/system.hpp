/// Interface of a system of ordinary differential equations for an integrator.
#pragma once

#include <cstddef>
#include <span>
#include <string>
#include <vector>

namespace feltmb {

/// y' = f(t, y) with exact Jacobian in a form of the system's own choosing. An object is a mutable
/// workspace: one a thread. Functions may throw; the integrator turns that into a failed status.
class OdeSystem {
 public:
  virtual ~OdeSystem() = default;

  virtual std::size_t size() const = 0;
  virtual std::string state_name(std::size_t i) const = 0;

  virtual void rhs(double t, std::span<const double> y, std::span<double> rate) = 0;

  /// Evaluates and keeps J = df/dy at (t, y).
  virtual void linearize(double t, std::span<const double> y) = 0;

  /// As above, for Newton's method in a short step: parts of J without influence on such a step may
  /// be omitted if that is faster.
  virtual void linearize_stiff(double t, std::span<const double> y) { linearize(t, y); }

  /// Factorizes I - gamma J with the J kept; returns false if it is singular.
  virtual bool factorize(double gamma) = 0;

  /// Solves (I - gamma J) x = b in place with the last factors.
  virtual void solve(std::span<double> b) = 0;

  /// Root functions; their sign changes are events.
  virtual std::size_t n_events() const { return 0; }
  virtual void events(double /*t*/, std::span<const double> /*y*/, std::span<double> /*g*/) {}

  /// Values of the root functions of the last right-hand side, if that was at t: an accepted state
  /// differs from it by a Newton correction below the tolerance. False if they are not known.
  virtual bool events_nearby(double /*t*/, std::span<double> /*g*/) { return false; }

  /// How far a value of events_nearby must lie from zero for its sign to be certain.
  virtual double event_margin() const { return 0.0; }
};

}  // namespace feltmb
