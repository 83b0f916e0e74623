/// Friction and loading-unloading pairs of many contacts at once, side by side in wide registers.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "feltmb/contact/friction.hpp"
#include "feltmb/contact/law.hpp"

namespace feltmb {

/// Frictions of which some are wanted, one lane each; the same bits as `evaluate(Friction, v)`.
class FrictionLanes {
 public:
  FrictionLanes() = default;
  explicit FrictionLanes(std::vector<Friction> frictions);

  /// Whether a friction consists of the terms of thesis eq. A.1 alone; others have no lane.
  static bool takes(const Friction& friction) {
    return friction.viscous == 0.0 && friction.quadratic == 0.0 && friction.stribeck == 0.0;
  }

  /// From now on lane i is friction which[i]. Allocates nothing.
  void choose(std::span<const std::size_t> which);

  /// Evaluates the chosen lanes at `speed`.
  void evaluate();

  std::vector<double> speed;  ///< sliding speed by lane [m/s, rad/s]
  std::vector<double> value;  ///< as FrictionValue
  std::vector<double> slope;

 private:
  std::vector<Friction> frictions_;
  std::size_t lanes_ = 0;  ///< in whole blocks
  std::vector<double> amplitude_, b1_, b2_, threshold_;
};

/// Laws of which some are wanted: those that are an ExponentialPair without rate term have one lane
/// each, with the same bits as `ContactLaw::evaluate` at a compression > 0.
class PairLanes {
 public:
  /// Adds the next law; `finish` after the last one.
  void add(const ContactLaw& law);
  void finish();

  /// From now on lane i is law which[i]. Allocates nothing.
  void choose(std::span<const std::size_t> which);

  /// Compression up to which a lane may be used [m]: the exponentials are no tangents yet. Zero for
  /// laws that have no lane.
  double reach(std::size_t lane) const { return reach_[lane]; }

  /// Evaluates the chosen lanes at `compression` and `rate`.
  void evaluate();
  LawValue value(std::size_t lane) const {
    return {force_[lane], by_compression_[lane], by_rate_[lane]};
  }

  std::vector<double> compression;  ///< by lane [m]
  std::vector<double> rate;         ///< by lane [m/s]

 private:
  struct Entry {
    ExponentialPair pair;
    double reach = 0.0;
  };

  std::vector<Entry> entries_;
  std::size_t lanes_ = 0;  ///< in whole blocks; 0 if none of the chosen has a lane
  std::vector<double> reach_;
  std::vector<double> load_a_, load_b_, load_c_, unload_a_, unload_b_, unload_c_;
  std::vector<double> alpha_, hysteresis_, guarded_;
  std::vector<double> force_, by_compression_, by_rate_;
};

}  // namespace feltmb
