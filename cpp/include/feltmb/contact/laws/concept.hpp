/// What a contact law must have, and what it may have.
///
/// A law is a struct with its parameters as plain data. It must have
///   kNames      its names in mechanism files, each with a line of text (LawName)
///   fields()    the table of its parameters: a tuple of Field
///   force()     force and exact slopes: `force(e, rate)` at e > 0; a law with states or memory
///               has `force(e, rate, memory, states)` at any e
///   energy()    stored energy [J]: `energy(e)` at e > 0, or `energy(e, memory)` at any e
/// and it may have
///   kTable                       its table in mechanism files; else its first name
///   choose(i), chosen()          which of its names it goes by, if it has several
///   check(faults)                checks between fields; ranges are checked anyway, from fields()
///   prepare()                    computes what follows from the parameters, once
///   rest_force(e)                force and slope with all states at rest, e > 0; else force(e, 0),
///                                so needed with states
///   rest_energy(e)               its integral; else energy with the states relaxed
///   dissipated_power(e, rate, memory)  heat [W]; else (force - rest_force) rate. Needed where the
///                                energy depends on the memory
///   piece(e, rate, memory)       number of the smooth piece, see ContactLaw; else where force > 0
/// With states (maxwell.hpp is an example):
///   n_states()                   how many, at most kMaxLawStates
///   state(i, compression)        name, and scale of its tolerance at a typical compression [m]
///   relax(e, state)              states at rest under a virgin compression
///   still_when_open()            whether they keep still while open; else they do not
///   advance(point, e, duration)  exact motion along a path, false: by substeps (path.hpp)
///   limit(state)                 brings states back into their range after a substep
/// With memory of the largest compression, which changes only at reversals, where the integrator
/// starts again:
///   kRemembers                   true
///   recovery_time                a member: of this memory while open [s], 0: none
///   cycle_envelope()             whose cycle is kept between reversals
///   widen(e, largest, state)     changes the states where virgin loading beyond the largest
///                                compression ends at e
///   turn(e, largest, turns)      adds a turning point below the largest compression, of a law that
///                                remembers all of them; what it wipes out goes
///   inner_compression(e, memory), inner_rate(e, rate, memory)  what the memory is of, if another
///                                part of the law lies in series
#pragma once

#include <array>
#include <concepts>
#include <cstddef>
#include <limits>
#include <string>
#include <tuple>
#include <vector>

#include "feltmb/contact/curve.hpp"
#include "feltmb/contact/envelope.hpp"
#include "feltmb/core/fields.hpp"

namespace feltmb {

/// Largest number of states of one law that are integrated with the rest.
inline constexpr std::size_t kMaxLawStates = 3;

/// Force of a law and its exact slopes.
struct LawValue {
  double force = 0.0;          ///< F [N]
  double d_compression = 0.0;  ///< dF/de [N/m]
  double d_rate = 0.0;         ///< dF/d(de/dt) [N s/m]
};

/// States s of a law, of number n_states(): rates and exact derivatives. Entries beyond n_states()
/// are undefined.
struct LawStates {
  std::array<double, kMaxLawStates> force{};                ///< dF/ds
  std::array<double, kMaxLawStates> rate{};                 ///< ds/dt
  std::array<double, kMaxLawStates> rate_by_compression{};  ///< d(ds/dt)/de
  std::array<double, kMaxLawStates> rate_by_rate{};         ///< d(ds/dt)/d(de/dt)
  std::array<std::array<double, kMaxLawStates>, kMaxLawStates> rate_by_state{};
};

/// A turning point of a law with return-point memory.
struct TurningPoint {
  double compression = 0.0;  ///< [m]
  double apart = 0.0;        ///< how far it is from e_m, as the law measures it
  double value = 0.0;        ///< of what hysteresis the law has, there
  double below = 0.0;        ///< stored energy of the hysteresis there, of a lower one [J]
};
/// From the outermost to the last: lower and upper ones in turn, each pair within the one before.
using TurningPoints = std::vector<TurningPoint>;

/// Number of turning points that are left at e: a loop that was passed is wiped out, a turning
/// point that was passed backward never was one. Odd: the felt rises from the last of them.
std::size_t left_at(double e, const TurningPoints& turns);

/// Memory of a law: integrated states, and the largest compression, which changes only at
/// reversals (and by recovery) and is constant in between.
struct LawMemory {
  const double* state = nullptr;  ///< n_states() values
  double largest = 0.0;           ///< e_m [m]
  /// Properties of the cycle to e_m; they are used if they belong to this e_m, else computed again.
  const CycleStart* cycle = nullptr;
  const TurningPoints* turns = nullptr;  ///< of a law that has them
};

/// Present point of a law in a prescribed history (path.hpp).
struct PathPoint {
  double compression = 0.0;  ///< [m]
  double largest = 0.0;      ///< [m]
  std::array<double, kMaxLawStates> state{};
  TurningPoints turns;
};

/// A state of a law.
struct LawState {
  const char* name;
  double scale;  ///< of its absolute tolerance: the relative one times this
};

/// A name of a law, and what it is in a line.
struct LawName {
  const char* name;
  const char* about;
};

/// Smooth pieces that laws have in common; 0 is no force and no rate of a state.
enum LawPiece { kOff = 0, kLoading = 1, kUnloading = 2, kNoUnloadingForce = 3, kNoForce = 4 };

/// Collects the faults of a law for one message.
class LawFaults {
 public:
  void add(const std::string& text);
  void require(bool ok, const char* field, double value, const char* range);
  void raise() const;  ///< Throws InvalidParameter if there is a fault.

  /// A term with a time constant, which is required if the term is used.
  void rate_term(double amplitude, double time) {
    require(amplitude == 0.0 || time != 0.0, "rate_time [s]", time, "> 0 with a rate term");
  }

 private:
  std::string text_;
};

namespace detail {

template <class L>
concept PlainForce = requires(const L& law, double e) {
  { law.force(e, e) } -> std::same_as<LawValue>;
};
template <class L>
concept StatefulForce = requires(const L& law, double e, const LawMemory& m, LawStates& s) {
  { law.force(e, e, m, s) } -> std::same_as<LawValue>;
};
template <class L>
concept PlainEnergy = requires(const L& law, double e) {
  { law.energy(e) } -> std::same_as<double>;
};
template <class L>
concept StatefulEnergy = requires(const L& law, double e, const LawMemory& m) {
  { law.energy(e, m) } -> std::same_as<double>;
  { law.dissipated_power(e, e, m) } -> std::same_as<double>;
};
template <class L>
concept States = requires(const L& law, std::size_t i, double e, double* s) {
  { law.n_states() } -> std::same_as<std::size_t>;
  { law.state(i, e) } -> std::same_as<LawState>;
  law.relax(e, s);
  { law.rest_force(e) } -> std::same_as<CurveValue>;
};

template <class L>
constexpr bool remembers() {
  if constexpr (requires { L::kRemembers; }) return L::kRemembers;
  return false;
}

}  // namespace detail

/// A contact law.
template <class L>
concept Law = std::default_initializable<L> && std::copyable<L> &&
              requires {
                { L::kNames[0] } -> std::convertible_to<LawName>;
                std::tuple_size<decltype(L::fields())>::value;
              } && (detail::PlainForce<L> || (detail::StatefulForce<L> && detail::States<L>)) &&
              (detail::PlainEnergy<L> || detail::StatefulEnergy<L>);

}  // namespace feltmb
