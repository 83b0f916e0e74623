/// A contact law along a prescribed compression history, without a machine around it.
#pragma once

#include <span>
#include <vector>

#include "feltmb/contact/law.hpp"

namespace feltmb {

/// Law with its memory, advanced step by step: what another engine needs to use the law.
///
/// Within a step the compression is taken linear in time. felt_memory without options is advanced
/// exactly at fixed e_m (loading: 1 - z falls by exp(-A/c), unloading: z does, A the area of the
/// band passed), so that its force depends on the path only, not on time or on the step; Stulov's
/// state by the exponential of its linear equation; creep and overstress by substeps.
class LawPath {
 public:
  explicit LawPath(const ContactLaw& law);

  /// Forgets everything: virgin felt.
  void reset();

  /// Moves to `compression` [m] within `duration` [s], > 0; returns the normal force [N] there.
  double step(double compression, double duration);

  /// Force if the step were taken, leaving the memory as it is.
  double peek(double compression, double duration) const;

  double compression() const { return compression_; }
  double largest() const { return largest_; }
  const std::array<double, kMaxLawStates>& state() const { return state_; }

 private:
  void move(double compression, double duration);
  void move_within(double to);

  const ContactLaw* law_;
  double compression_ = 0.0;
  double largest_ = 0.0;
  std::array<double, kMaxLawStates> state_{};
};

/// Forces [N] at the samples of a history; time [s] strictly growing, compression [m], same
/// length >= 1. The first sample is reached on a virgin loading. Throws InvalidParameter.
std::vector<double> force_along(const ContactLaw& law, std::span<const double> time,
                                std::span<const double> compression);

}  // namespace feltmb
