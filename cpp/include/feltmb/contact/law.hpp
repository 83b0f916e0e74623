/// Contact laws: normal force from compression, compression rate and the law's own history.
///
/// A law does not depend on bodies. Compression e > 0 when touching [m], rate = de/dt [m/s], force
/// F > 0 pushes the bodies apart [N]. Every law has exact slopes, the stored (recoverable) energy
/// and, with memory, the rates of its states. The laws are in contact/laws; all other code only
/// uses ContactLaw.
#pragma once

#include <cstddef>
#include <string>

#include "feltmb/contact/laws/concept.hpp"
#include "feltmb/contact/laws/list.hpp"

namespace feltmb {

/// A law with checked parameters and derived constants. Immutable.
class ContactLaw {
 public:
  /// Throws InvalidParameter naming the field, its value and the permitted range.
  explicit ContactLaw(const LawParameters& parameters);

  /// A linear spring of 1 N/m, for contacts that are off.
  ContactLaw();

  const LawParameters& parameters() const { return parameters_; }

  /// Name as written in a mechanism file.
  std::string name() const;

  /// Number of states that are integrated.
  std::size_t n_states() const { return n_states_; }

  /// Name of a state, for messages.
  const char* state_name(std::size_t i) const { return state(i, 1.0).name; }

  /// Name of a state, and scale of its tolerance at a typical compression [m].
  LawState state(std::size_t i, double compression) const;

  /// Whether the states are constant while the contact is open, so that nothing must be evaluated.
  bool still_when_open() const { return still_when_open_; }

  /// Whether the law remembers its largest compression.
  bool has_memory() const { return has_memory_; }

  /// Time constant with which an open contact forgets its largest compression [s]; 0: it does not.
  double recovery_time() const { return recovery_time_; }

  /// Whether the law remembers its turning points.
  bool has_turns() const { return has_turns_; }

  /// Adds a turning point at a compression [m] below `largest` to those of a law that has them.
  void turn(double compression, double largest, TurningPoints& turns) const;

  /// Changes the states where virgin loading beyond `largest` [m] ends at a compression of the
  /// felt.
  void widen(double compression, double largest, double* state) const;

  /// Updates the cycle of a law with memory to `largest` [m].
  void keep_cycle(double largest, CycleStart& cycle) const {
    if (envelope_ == nullptr || (cycle.largest == largest && cycle.of == envelope_)) return;
    cycle = envelope_->cycle_to(largest);
  }

  /// Force and slopes at compression [m] and rate [m/s]; zero force for compression <= 0. Never
  /// throws. Laws with states or memory need `memory`; `states` is filled for them if given.
  LawValue evaluate(double compression, double rate, const LawMemory& memory = {},
                    LawStates* states = nullptr) const;

  /// Force and slope for a virgin compression with states at rest; used for the rest pose of a
  /// mechanism.
  CurveValue static_force(double compression) const;
  double static_energy(double compression) const;  ///< its integral from 0 [J]

  /// States at rest under a virgin compression; `state` holds n_states() values.
  void relax(double compression, double* state) const;

  /// Stored energy of the law [J]: the integral of its loading curve from 0 unless the law defines
  /// another one.
  double stored_energy(double compression, const LawMemory& memory = {}) const;

  /// Dissipated power of the law [W]: F de/dt minus the rate of the stored energy.
  double dissipated_power(double compression, double rate, const LawMemory& memory = {}) const;

  /// Compression and rate of the felt itself, behind a creeping layer if there is one.
  double felt_compression(double compression, const LawMemory& memory) const;
  double felt_rate(double compression, double rate, const LawMemory& memory) const;

  /// Number of the smooth piece of the law. At a change of the piece, the slopes of the force jump
  /// but the force does not. 0: the force and all rates of states are zero. Derivatives along a
  /// motion must stop at such a change (a step across it has an error of first order).
  int piece(double compression, double rate, const LawMemory& memory = {}) const;

  /// Advances the memory exactly along a path (path.hpp); false: not possible, nothing was changed.
  bool advance(PathPoint& at, double compression, double duration) const;
  /// Moves states back into their range after a substep.
  void limit(double* state) const;

 private:
  LawParameters parameters_;
  const Envelope* envelope_ = nullptr;  ///< of the parameters
  double recovery_time_ = 0.0;
  std::size_t n_states_ = 0;
  bool has_memory_ = false;
  bool has_turns_ = false;
  bool still_when_open_ = true;
};

}  // namespace feltmb
