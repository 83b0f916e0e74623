/// Friction, loading-unloading pairs and felt with memory of many contacts at once, side by side in
/// wide registers.
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

  /// Whether the friction of a chosen lane is one that has a lane.
  bool taken(std::size_t lane) const { return taken_[lane] != 0; }

  /// Evaluates the chosen lanes at `speed`.
  void evaluate();

  std::vector<double> speed;  ///< sliding speed by lane [m/s, rad/s]
  std::vector<double> value;  ///< as FrictionValue
  std::vector<double> slope;

 private:
  std::vector<Friction> frictions_;
  std::size_t lanes_ = 0;  ///< in whole blocks
  std::vector<double> amplitude_, b1_, b2_, threshold_;
  std::vector<char> taken_;
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

/// Laws of which some are wanted: those that are FeltMemory without creep and rate term have one
/// lane each, with the same bits as `ContactLaw::evaluate` at a compression > 0.
class MemoryLanes {
 public:
  static bool takes(const ContactLaw& law) {
    const auto* felt = std::get_if<FeltMemory>(&law.parameters());
    return felt != nullptr && law.n_states() == 1 && felt->wiping_out == 0.0;
  }

  /// Adds the next law, which must outlive the lanes; `finish` after the last one.
  void add(const ContactLaw& law);
  void finish();

  /// From now on lane i is law which[i], of those that are taken, in no cycle yet. Allocates
  /// nothing.
  void choose(std::span<const std::size_t> which);

  /// Largest compression of the cycle that a lane is in [m]; no number before `begin`.
  double largest(std::size_t lane) const { return largest_[lane]; }

  /// From now on a lane is in this cycle, which must be one of its law. Allocates nothing.
  void begin(std::size_t lane, const CycleStart& cycle);

  /// Compression up to which a lane may be used [m].
  double reach(std::size_t lane) const { return reach_[lane]; }

  /// Evaluates the chosen lanes at `compression`, `rate` and `state`.
  void evaluate();
  LawValue value(std::size_t lane) const { return {force_[lane], by_compression_[lane], 0.0}; }
  /// What concerns z; the rest of `to` stays.
  void states(std::size_t lane, LawStates& to) const {
    to.force[0] = by_state_[lane];
    to.rate[0] = state_rate_[lane];
    to.rate_by_compression[0] = state_rate_by_compression_[lane];
    to.rate_by_rate[0] = state_rate_by_rate_[lane];
    to.rate_by_state[0][0] = state_rate_by_state_[lane];
  }

  std::vector<double> compression;  ///< by lane [m]
  std::vector<double> rate;         ///< by lane [m/s]
  std::vector<double> state;        ///< z by lane [-]

 private:
  struct Entry {
    const Envelope* envelope = nullptr;
    double kappa = 0.0;
    double reach = 0.0;
    std::vector<CubicPiece> room;  ///< for pieces of rho, if there are several rows
    double blended = -1.0;         ///< largest compression that `room` is of [m]
  };
  /// Places in a table of pieces, and the pieces there.
  struct Places {
    std::vector<double> root, within, value, slope, second, third;
    std::vector<int> index;
    std::vector<const CubicPiece*> table;
  };
  static void gather(std::size_t lanes, Places& places);

  std::vector<Entry> entries_;
  std::vector<std::size_t> which_;  ///< entry by lane
  std::size_t lanes_ = 0;           ///< in whole blocks
  bool exponential_ = false;        ///< a chosen lane has an exponential loading curve
  bool tabulated_ = false;          ///< or a table
  std::vector<double> reach_, largest_, per_length_, a_, b_, c_, from_, end_, is_table_;
  Places ratio_, loading_;
  std::vector<double> curve_, curve_slope_;  ///< loading curves that are exponential
  std::vector<double> table_, table_slope_;  ///< and those that are tables
  std::vector<double> force_, by_compression_, by_state_, state_rate_, state_rate_by_compression_,
      state_rate_by_rate_, state_rate_by_state_;
};

}  // namespace feltmb
