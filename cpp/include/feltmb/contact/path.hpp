/// A contact law along a prescribed compression history, without a machine around it.
#pragma once

#include <span>
#include <vector>

#include "feltmb/contact/law.hpp"

namespace feltmb {

/// Law with its memory, advanced step by step: what another engine needs to use the law.
///
/// Within a step the compression is taken linear in time. Laws that can be are advanced exactly
/// (`advance` of contact/laws), so that the force of a rate-independent one depends on the path
/// only, not on time or on the step; the states of others by substeps.
class LawPath {
 public:
  explicit LawPath(const ContactLaw& law);

  /// Forgets everything: virgin felt.
  void reset();

  /// Moves to `compression` [m] within `duration` [s], > 0; returns the normal force [N] there.
  double step(double compression, double duration);

  /// Force if the step were taken, leaving the memory as it is.
  double peek(double compression, double duration) const;

  double compression() const { return at_.compression; }
  double largest() const { return at_.largest; }
  const std::array<double, kMaxLawStates>& state() const { return at_.state; }

 private:
  void move(double compression, double duration);
  void move_by_substeps(double compression, double duration);
  LawMemory memory() const { return {at_.state.data(), at_.largest}; }

  const ContactLaw* law_;
  PathPoint at_;
};

/// Forces [N] at the samples of a history; time [s] strictly growing, compression [m], same
/// length >= 1. The first sample is reached on a virgin loading. Throws InvalidParameter.
std::vector<double> force_along(const ContactLaw& law, std::span<const double> time,
                                std::span<const double> compression);

}  // namespace feltmb
