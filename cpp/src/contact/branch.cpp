#include "feltmb/contact/branch.hpp"

#include <cmath>

namespace feltmb {
namespace {

enum Piece { kOff = 0, kLoading = 1, kUnloading = 2, kNoUnloadingForce = 3, kNoForce = 4 };

int piece(const ExponentialPair& pair, double e, double rate) {
  const double load = evaluate(pair.loading, e).force;
  const bool guarded = pair.form == ExponentialPair::Form::kGuarded;
  if (guarded && load <= 0.0) return kOff;
  if (rate >= 0.0) return kLoading;
  if (!guarded) return kUnloading;
  const double unload = evaluate(pair.unloading, e).force;
  if (unload < 0.0) return kNoUnloadingForce;
  return unload > load ? kLoading : kUnloading;
}

int piece(const Stulov& law, double e, const LawMemory& memory) {
  if (e <= 0.0) return kOff;
  return std::pow(e, law.exponent) > law.amplitude * memory.state[0] ? kLoading : kNoForce;
}

int piece_of_felt(const ContactLaw& whole, double e, double rate, const LawMemory& memory) {
  const double inner = whole.felt_compression(e, memory);
  // A creeping or relaxing layer goes on while its felt carries nothing.
  if (inner <= 0.0) return kOff;
  if (whole.evaluate(e, rate, memory).force <= 0.0) return kNoForce;
  if (inner >= memory.largest) return kLoading;
  return whole.felt_rate(e, rate, memory) > 0.0 ? kUnloading + 8 : kUnloading;
}

}  // namespace

int branch(const ContactLaw& law, double compression, double rate, const LawMemory& memory) {
  const LawParameters& parameters = law.parameters();
  if (std::holds_alternative<FeltMemory>(parameters)) {
    return piece_of_felt(law, compression, rate, memory);
  }
  if (compression <= 0.0) return kOff;
  if (const auto* pair = std::get_if<ExponentialPair>(&parameters)) {
    return piece(*pair, compression, rate);
  }
  if (const auto* st = std::get_if<Stulov>(&parameters)) return piece(*st, compression, memory);
  // Of the others the force says it all.
  return law.evaluate(compression, rate, memory).force > 0.0 ? kLoading : kNoForce;
}

}  // namespace feltmb
