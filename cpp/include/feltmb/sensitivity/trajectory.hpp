/// Recorded steps of a run, as a function of time.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "feltmb/model/free_strings.hpp"
#include "feltmb/model/mechanism_system.hpp"
#include "feltmb/model/simulation.hpp"

namespace feltmb {

/// States at the accepted steps of an integrator, joined by cubic Hermite polynomials with the
/// exact slopes of the equations: whatever integrator made the steps, its error stays at them.
class Trajectory {
 public:
  /// @param system  workspace that evaluates the slopes; kept by reference
  explicit Trajectory(MechanismSystem& system);

  /// Takes one accepted step; times must not fall. Memory as in Dynamics::largest_compression.
  /// @param free  whether the strings were free since the last step, so that it did not resolve
  ///   their vibration
  void add(double t, std::span<const double> y, std::span<const double> memory, bool free);

  std::size_t size() const { return time_.size(); }
  double time(std::size_t node) const { return time_[node]; }
  std::span<const double> state(std::size_t node) const {
    return {states_.data() + node * width_, width_};
  }

  /// Memory of the contacts in the interval that follows a node.
  std::span<const double> memory(std::size_t node) const;

  /// Interval of nodes [i, i + 1] that holds t; searched from the one found last.
  std::size_t interval(double t) const;

  /// State at t; sets the memory of `system` (given at construction) and returns the interval.
  /// Between two steps, the vibration of free strings is not valid.
  std::size_t interpolate(double t, std::span<double> y);

  /// The same with free strings where they are, which costs more.
  std::size_t interpolate_all(double t, std::span<double> y);

 private:
  std::span<const double> slope(std::size_t node, bool left);

  MechanismSystem& system_;
  std::size_t width_ = 0;
  std::vector<double> time_;
  std::vector<double> states_;
  std::vector<double> memory_;  ///< one row a node; empty if no law remembers
  std::vector<char> free_;      ///< whether strings are free in the interval before each node
  std::optional<FreeStrings> strings_;
  mutable std::size_t last_ = 0;
  struct Slope {
    std::size_t node = static_cast<std::size_t>(-1);
    bool left = false;
    std::vector<double> value;
  };
  Slope slopes_[4];
  std::size_t next_slope_ = 0;
  bool remembers_ = false;
};

}  // namespace feltmb
