/// Exact motion of strings without contact, at any time.
#pragma once

#include <span>
#include <vector>

#include "feltmb/planar/mechanism.hpp"

namespace feltmb {

/// Free vibration of all strings of a mechanism from a start: a rotation of each mode.
class FreeStrings {
 public:
  explicit FreeStrings(const Mechanism& mechanism);

  /// Sets the state of the free strings at t [s]: eta [m kg^1/2] and its rates.
  void start(double t, std::span<const double> eta, std::span<const double> rate);

  /// Moves eta() and rate() to t >= the start.
  void move(double t);

  std::span<const double> eta() const { return eta_; }
  std::span<const double> rate() const { return rate_; }

  /// Bound on the displacement of a string anywhere since the start [m].
  double reach(std::size_t string) const { return reach_[string]; }

  /// Energy that a string has lost between the start and the time of the last move [J].
  double heat(std::size_t string) const;

 private:
  double energy(std::size_t string) const;

  const Mechanism& mechanism_;
  std::vector<double> decay_, turn_;  ///< xi w, w sqrt(1 - xi^2) of all modes [1/s, rad/s]
  bool still_ = true;                 ///< at rest since the start
  double start_ = 0.0;
  double time_ = 0.0;
  std::vector<double> start_eta_, start_rate_, eta_, rate_;
  std::vector<double> reach_, start_energy_;
};

}  // namespace feltmb
