/// Many rotations side by side. Private to the folder.
#pragma once

#include <cstddef>

namespace feltmb::detail {

inline constexpr std::size_t kTurnBlock = 4;

/// Cosines and sines of small angles [rad] as Rotation::of_small has them, to the same bits; others
/// give nothing of use. `count` is a multiple of kTurnBlock.
void small_turns(std::size_t count, const double* angle, double* cosine, double* sine);

}  // namespace feltmb::detail
