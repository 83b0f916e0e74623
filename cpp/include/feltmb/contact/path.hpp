/// A contact law for a prescribed history of compression, without a machine.
#pragma once

#include <span>
#include <vector>

#include "feltmb/contact/law.hpp"

namespace feltmb {

/// A law with its memory, advanced step by step, for use in another engine. Within a step, the
/// compression is linear in time. Where possible, a law is advanced exactly (`advance` of
/// contact/laws), so that the force of a rate-independent law depends only on the path. The states
/// of other laws are integrated with substeps.
class LawPath {
 public:
  explicit LawPath(const ContactLaw& law);

  /// Restores virgin felt.
  void reset();

  /// Changes the compression to `compression` [m] within `duration` [s], > 0; returns the normal
  /// force [N].
  double step(double compression, double duration);

  /// Force after the step, without a change of the memory.
  double peek(double compression, double duration) const;

  double compression() const { return at_.compression; }
  double largest() const { return at_.largest; }
  const std::array<double, kMaxLawStates>& state() const { return at_.state; }
  LawMemory memory() const { return {at_.state.data(), at_.largest, nullptr, &at_.turns}; }

  /// Numbers from which `restore` makes the same point: compression, largest compression, states,
  /// turning points.
  std::vector<double> save() const;
  void restore(std::span<const double> saved);  ///< Throws InvalidParameter.

 private:
  void move(double compression, double duration);
  void move_by_substeps(double compression, double duration);

  const ContactLaw* law_;
  PathPoint at_;
};

/// Forces [N] at the samples of a history; time [s] strictly growing, compression [m], same
/// length >= 1. The first sample is reached on a virgin loading. Throws InvalidParameter.
std::vector<double> force_along(const ContactLaw& law, std::span<const double> time,
                                std::span<const double> compression);

}  // namespace feltmb
