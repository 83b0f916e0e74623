#include "feltmb/model/law_force.hpp"

#include <algorithm>

namespace feltmb {

LawForce::LawForce(const ContactLaw& law)
    : law_(&law), now_{LawPath(law)}, stage_{{LawPath(law)}, {LawPath(law)}} {}

double LawForce::heat(const Point& p) const {
  if (p.compression <= 0.0 && law_->n_states() == 0) return 0.0;
  const LawMemory memory = p.path.memory();
  const double rate = p.compression > 0.0 ? p.rate : 0.0;
  return law_->dissipated_power(std::max(0.0, p.compression), rate, memory);
}

modal::ScalarForce::Value LawForce::trial(int stage, double elapsed, double compression,
                                          double rate) {
  Point& p = stage_[stage];
  p.compression = compression;
  p.rate = rate;
  p.elapsed = elapsed;
  Value out;
  if (law_->n_states() == 0 && !law_->has_memory()) {
    if (compression <= 0.0) return out;
    const LawValue v = law_->evaluate(compression, rate);
    return {v.force, v.d_compression, v.d_rate};
  }
  p.path = stage == 0 ? now_.path : stage_[0].path;
  if (elapsed <= 0.0) return out;
  if (compression > 0.0) {
    // The memory moves with the compression: its share of the slope by a difference.
    constexpr double shift = 1e-9;  // m
    out.d_compression =
        (p.path.peek(compression + shift, elapsed) - p.path.peek(compression - shift, elapsed)) /
        (2.0 * shift);
  }
  out.force = p.path.step(compression, elapsed);
  return out;
}

void LawForce::accept() {
  Point& middle = stage_[0];
  Point& end = stage_[1];
  middle.heat = heat(middle);
  end.heat = heat(end);
  const double h = middle.elapsed + end.elapsed;
  dissipated_ += h / 6.0 * (now_.heat + 4.0 * middle.heat + end.heat);
  now_ = end;
}

double LawForce::stored() const {
  const LawMemory memory = now_.path.memory();
  return law_->stored_energy(std::max(0.0, now_.compression), memory);
}

}  // namespace feltmb
