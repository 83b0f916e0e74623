#include "turns.hpp"

#include "feltmb/core/multiversion.hpp"
#include "feltmb/core/vec2.hpp"

namespace feltmb::detail {
namespace {

FELTMB_CLONES void taylor_lanes(std::size_t blocks, const double* angle, double* __restrict cosine,
                                double* __restrict sine) {
  for (std::size_t i = 0; i < blocks * kTurnBlock; ++i) {
    const Rotation r = Rotation::of_small(angle[i]);
    cosine[i] = r.c;
    sine[i] = r.s;
  }
}

}  // namespace

void small_turns(std::size_t count, const double* angle, double* cosine, double* sine) {
  taylor_lanes(count / kTurnBlock, angle, cosine, sine);
}

}  // namespace feltmb::detail
