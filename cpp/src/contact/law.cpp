#include "feltmb/contact/law.hpp"

#include <type_traits>
#include <utility>

#include "feltmb/contact/laws/catalog.hpp"

namespace feltmb {
namespace {

template <class T>
constexpr bool all_are_laws = false;
template <class... Ls>
constexpr bool all_are_laws<std::variant<Ls...>> = (Law<Ls> && ...);
static_assert(all_are_laws<LawParameters>, "a law lacks what contact/laws/concept.hpp asks for");

template <class L>
std::size_t states_of(const L& law) {
  if constexpr (detail::States<L>) return law.n_states();
  return 0;
}

template <class L>
CurveValue rest_force(const L& law, double e) {
  if constexpr (requires { law.rest_force(e); }) {
    return law.rest_force(e);
  } else {
    const LawValue v = law.force(e, 0.0);
    return {v.force, v.d_compression};
  }
}

}  // namespace

ContactLaw::ContactLaw(const LawParameters& parameters) : parameters_(parameters) {
  check_fields(parameters);
  std::visit(
      [this]<class L>(L& law) {
        if constexpr (requires { law.prepare(); }) law.prepare();
        n_states_ = states_of(law);
        has_memory_ = detail::remembers<L>();
        still_when_open_ = n_states_ == 0;
        if constexpr (requires { law.still_when_open(); }) still_when_open_ = law.still_when_open();
        has_turns_ = requires(TurningPoints& turns) { law.turn(0.0, 0.0, turns); };
        if constexpr (requires { law.recovery_time; }) recovery_time_ = law.recovery_time;
        if constexpr (requires { law.cycle_envelope(); }) envelope_ = law.cycle_envelope();
      },
      parameters_);
}

ContactLaw::ContactLaw() : ContactLaw(HuntCrossley{1.0, 1.0, 0.0}) {}

std::string ContactLaw::name() const { return chosen_name(parameters_).name; }

LawState ContactLaw::state(std::size_t i, double compression) const {
  return std::visit(
      [&]<class L>(const L& law) -> LawState {
        if constexpr (detail::States<L>) return law.state(i, compression);
        return {"", 1.0};
      },
      parameters_);
}

LawValue ContactLaw::evaluate(double compression, double rate, const LawMemory& memory,
                              LawStates* states) const {
  return std::visit(
      [&]<class L>(const L& law) -> LawValue {
        if constexpr (detail::StatefulForce<L>) {
          // States go on while the contact is open.
          if (n_states_ > 0 || has_memory_) {
            if (states != nullptr) return law.force(compression, rate, memory, *states);
            LawStates unwanted;
            return law.force(compression, rate, memory, unwanted);
          }
        }
        if constexpr (detail::PlainForce<L>) {
          if (compression > 0.0) return law.force(compression, rate);
        }
        return {};
      },
      parameters_);
}

double ContactLaw::stored_energy(double compression, const LawMemory& memory) const {
  return std::visit(
      [&]<class L>(const L& law) -> double {
        if constexpr (detail::StatefulEnergy<L>) {
          return law.energy(compression, memory);
        } else {
          return compression <= 0.0 ? 0.0 : law.energy(compression);
        }
      },
      parameters_);
}

void ContactLaw::relax(double compression, double* state) const {
  std::visit(
      [&]<class L>(const L& law) {
        if constexpr (detail::States<L>) {
          if (n_states_ > 0) law.relax(compression, state);
        }
      },
      parameters_);
}

CurveValue ContactLaw::static_force(double compression) const {
  if (compression <= 0.0) return {0.0, 0.0};
  return std::visit([&](const auto& law) { return rest_force(law, compression); }, parameters_);
}

double ContactLaw::static_energy(double compression) const {
  if (compression <= 0.0) return 0.0;
  return std::visit(
      [&]<class L>(const L& law) -> double {
        if constexpr (requires { law.rest_energy(compression); }) {
          return law.rest_energy(compression);
        } else if constexpr (detail::StatefulEnergy<L>) {
          double state[kMaxLawStates] = {};
          law.relax(compression, state);
          return law.energy(compression, {state, 0.0});
        } else {
          return law.energy(compression);
        }
      },
      parameters_);
}

double ContactLaw::felt_compression(double compression, const LawMemory& memory) const {
  return std::visit(
      [&]<class L>(const L& law) -> double {
        if constexpr (requires { law.inner_compression(compression, memory); }) {
          return law.inner_compression(compression, memory);
        }
        return compression;
      },
      parameters_);
}

double ContactLaw::felt_rate(double compression, double rate, const LawMemory& memory) const {
  return std::visit(
      [&]<class L>(const L& law) -> double {
        if constexpr (requires { law.inner_rate(compression, rate, memory); }) {
          return law.inner_rate(compression, rate, memory);
        }
        return rate;
      },
      parameters_);
}

double ContactLaw::dissipated_power(double compression, double rate,
                                    const LawMemory& memory) const {
  return std::visit(
      [&]<class L>(const L& law) -> double {
        if constexpr (detail::StatefulEnergy<L>) {
          return law.dissipated_power(compression, rate, memory);
        } else {
          if (compression <= 0.0) return 0.0;
          const double force = evaluate(compression, rate, memory).force;
          return (force - rest_force(law, compression).force) * rate;
        }
      },
      parameters_);
}

int ContactLaw::piece(double compression, double rate, const LawMemory& memory) const {
  return std::visit(
      [&]<class L>(const L& law) -> int {
        if constexpr (requires { law.piece(compression, rate, memory); }) {
          return law.piece(compression, rate, memory);
        } else {
          // Of the others the force says it all.
          if (compression <= 0.0) return kOff;
          return evaluate(compression, rate, memory).force > 0.0 ? kLoading : kNoForce;
        }
      },
      parameters_);
}

bool ContactLaw::advance(PathPoint& at, double compression, double duration) const {
  return std::visit(
      [&]<class L>(const L& law) -> bool {
        if constexpr (requires { law.advance(at, compression, duration); }) {
          return law.advance(at, compression, duration);
        }
        return false;
      },
      parameters_);
}

void ContactLaw::turn(double compression, double largest, TurningPoints& turns) const {
  std::visit(
      [&]<class L>(const L& law) {
        if constexpr (requires { law.turn(compression, largest, turns); }) {
          law.turn(compression, largest, turns);
        }
      },
      parameters_);
}

void ContactLaw::widen(double compression, double largest, double* state) const {
  std::visit(
      [&]<class L>(const L& law) {
        if constexpr (requires { law.widen(compression, largest, state); }) {
          law.widen(compression, largest, state);
        }
      },
      parameters_);
}

void ContactLaw::limit(double* state) const {
  std::visit(
      [&]<class L>(const L& law) {
        if constexpr (requires { law.limit(state); }) law.limit(state);
      },
      parameters_);
}

}  // namespace feltmb
