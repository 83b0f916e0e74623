#include "feltmb/contact/laws/felt_memory.hpp"

#include <algorithm>
#include <cmath>

#include "feltmb/numeric/bracketing.hpp"
#include "feltmb/numeric/quadrature.hpp"

namespace feltmb {
namespace {

/// Area Q of the band from 0 to e within the cycle to `largest` [J], whose whole area is `area`.
double band_area(const Envelope& envelope, double e, double largest, double area) {
  return std::clamp(envelope.loading_energy(e) - envelope.unloading_energy(e, largest), 0.0, area);
}

/// The rate-independent part alone, at the compression of the felt itself.
struct FeltCore {
  double force = 0.0, by_compression = 0.0, by_z = 0.0;
  double z_rate = 0.0, z_rate_by_compression = 0.0, z_rate_by_rate = 0.0, z_rate_by_z = 0.0;
  double loading = 0.0, loading_slope = 0.0;
  double band = 0.0;
};

FeltCore evaluate_core(const FeltMemory& law, double e, double rate, const LawMemory& memory) {
  const double z = memory.state[0];
  const double largest = memory.largest;
  FeltCore c;
  if (e <= 0.0) return c;
  if (e >= largest || largest < FeltMemory::nothing) {
    const CurveValue load = law.envelope->loading(e);
    c.loading = c.force = load.force;
    c.loading_slope = c.by_compression = load.slope;
    return c;
  }
  const Envelope& envelope = *law.envelope;
  const CycleStart* kept = memory.cycle;
  const bool known = kept != nullptr && kept->of == &envelope && kept->largest == largest;
  const CycleValue v =
      known ? envelope.cycle(e, *kept) : envelope.cycle(e, envelope.cycle_to(largest));
  c.loading = v.loading;
  c.loading_slope = v.loading_slope;
  const double mix = v.ratio + z * (1.0 - v.ratio);
  c.force = v.loading * mix;
  c.by_compression = v.loading_slope * mix + v.loading * (1.0 - z) * v.ratio_slope;
  c.band = v.loading * (1.0 - v.ratio);
  c.by_z = c.band;
  const double length = law.kappa * v.area;
  if (length <= 0.0) return c;
  const double wiping = law.wiping_out;
  double per_length = 1.0 / length;
  double per_length_slope = 0.0;
  if (wiping > 0.0) {
    const double passed = band_area(envelope, e, largest, v.area);
    per_length = 1.0 / (length + wiping * (rate > 0.0 ? passed : v.area - passed));
    per_length_slope = (rate > 0.0 ? -wiping : wiping) * c.band * per_length * per_length;
  }
  const double band_slope = v.loading_slope * (1.0 - v.ratio) - v.loading * v.ratio_slope;
  const double left = rate > 0.0 ? 1.0 - z : z;
  const double share = c.band * per_length;
  c.z_rate = share * left * rate;
  c.z_rate_by_compression = (band_slope * per_length + c.band * per_length_slope) * left * rate;
  c.z_rate_by_rate = share * left;
  c.z_rate_by_z = -share * std::fabs(rate);
  return c;
}

/// Without creep and rate term: the one state z.
LawValue evaluate_plain(const FeltMemory& law, double e, double rate, const LawMemory& memory,
                        LawStates& states) {
  const FeltCore c = evaluate_core(law, e, rate, memory);
  states.force[0] = c.by_z;
  states.rate[0] = c.z_rate;
  states.rate_by_compression[0] = c.z_rate_by_compression;
  states.rate_by_rate[0] = c.z_rate_by_rate;
  states.rate_by_state[0][0] = c.z_rate_by_z;
  return {c.force, c.by_compression, 0.0};
}

LawValue evaluate_memory(const FeltMemory& law, double e, double rate, const LawMemory& memory,
                         LawStates& states) {
  LawValue v;
  states = {};
  const double* own = memory.state;
  std::size_t next = 1;
  const bool creeps = law.creep_stiffness > 0.0;
  const std::size_t k = creeps ? next++ : 0;
  const std::size_t r = law.rate_amplitude > 0.0 ? next++ : 0;
  const double inner = creeps ? e - own[k] : e;

  // With creep the rate of the felt itself follows from the force: a second look below.
  FeltCore c = evaluate_core(law, inner, creeps ? 0.0 : rate, memory);
  v.force = c.force;
  v.d_compression = c.by_compression;
  states.force[0] = c.by_z;
  if (r != 0) {
    const double extra = law.rate_amplitude * (c.loading - own[r]);
    states.rate[r] = (c.loading - own[r]) / law.rate_time;
    states.rate_by_compression[r] = c.loading_slope / law.rate_time;
    states.rate_by_state[r][r] = -1.0 / law.rate_time;
    if (inner > 0.0 && v.force + extra > 0.0) {
      v.force += extra;
      v.d_compression += law.rate_amplitude * c.loading_slope;
      states.force[r] = -law.rate_amplitude;
    } else {
      v.force = v.d_compression = states.force[0] = 0.0;
    }
  }
  if (!creeps) {
    states.rate[0] = c.z_rate;
    states.rate_by_compression[0] = c.z_rate_by_compression;
    states.rate_by_rate[0] = c.z_rate_by_rate;
    states.rate_by_state[0][0] = c.z_rate_by_z;
    return v;
  }
  // Kelvin element in series: its rate follows from the common force, the felt takes the rest.
  const double inverse = 1.0 / law.creep_damping;
  states.rate[k] = (v.force - law.creep_stiffness * own[k]) * inverse;
  states.rate_by_compression[k] = v.d_compression * inverse;
  for (std::size_t j = 0; j < next; ++j) states.rate_by_state[k][j] = states.force[j] * inverse;
  states.rate_by_state[k][k] = (-v.d_compression - law.creep_stiffness) * inverse;
  states.force[k] = -v.d_compression;
  if (r != 0) states.rate_by_state[r][k] = -states.rate_by_compression[r];
  c = evaluate_core(law, inner, rate - states.rate[k], memory);
  states.rate[0] = c.z_rate;
  states.rate_by_rate[0] = c.z_rate_by_rate;
  states.rate_by_compression[0] =
      c.z_rate_by_compression - c.z_rate_by_rate * states.rate_by_compression[k];
  for (std::size_t j = 0; j < next; ++j) {
    states.rate_by_state[0][j] = -c.z_rate_by_rate * states.rate_by_state[k][j];
  }
  states.rate_by_state[0][0] += c.z_rate_by_z;
  states.rate_by_state[0][k] -= c.z_rate_by_compression;
  return v;
}

/// The stored energy with `wiping_out`, its areas over W.
struct Wiping {
  explicit Wiping(const FeltMemory& law)
      : share(law.wiping_out),
        kappa(law.kappa),
        span(share + 2.0 * kappa),
        stiffness(span / (2.0 * (1.0 + share))) {}

  /// z* where the area `passed` of `area` lies below.
  double middle(double passed, double area) const {
    return 1.0 - (share * (area > 0.0 ? passed / area : 0.0) + kappa) / span;
  }

  double share, kappa;
  double span;       ///< S / W
  double stiffness;  ///< k / W
};

double memory_energy(const FeltMemory& law, double inner, double z, double largest) {
  const double reach = std::max(largest, inner);
  if (reach <= 0.0) return 0.0;
  if (law.wiping_out > 0.0) {
    const double area = law.envelope->loop_area(reach).force;
    const double back = inner > 0.0 ? law.envelope->unloading_energy(inner, reach) : 0.0;
    const double passed = inner > 0.0 ? band_area(*law.envelope, inner, reach, area) : 0.0;
    const Wiping w(law);
    const double away = z - w.middle(passed, area);
    const double mean = area > 0.0 ? (0.5 * w.share * passed / area + law.kappa) / w.span : 0.0;
    return back + passed * (1.0 - mean) + w.stiffness * area * away * away;
  }
  const double locked =
      0.25 * law.kappa * law.envelope->loop_area(reach).force * (2.0 * z - 1.0) * (2.0 * z - 1.0);
  if (inner <= 0.0) return locked;
  // F_U + D/2 = (F_L + F_U) / 2.
  return locked +
         0.5 * (law.envelope->loading_energy(inner) + law.envelope->unloading_energy(inner, reach));
}

/// Exact change of z between two compressions on the same side of e_m and of 0.
void move_within(const FeltMemory& felt, PathPoint& at, double to) {
  const Envelope& envelope = *felt.envelope;
  const double from = at.compression;
  at.compression = to;
  if (std::max(from, to) <= 0.0 || std::min(from, to) >= at.largest || from == to) return;
  const double length = felt.kappa * envelope.loop_area(at.largest).force;
  if (length <= 0.0) return;
  const double area = std::fabs(integrate_composite(
      [&](double e) {
        return envelope.loading(e).force * (1.0 - envelope.ratio(e / at.largest, at.largest).force);
      },
      std::min(from, to), std::max(from, to), 1));
  double decay = std::exp(-area / length);
  if (felt.wiping_out > 0.0) {
    // Exact too: lengths grow linearly with the area since the return point.
    const double whole = envelope.loop_area(at.largest).force;
    const double low = std::clamp(std::min(from, to), 0.0, at.largest);
    const double below = std::clamp(
        envelope.loading_energy(low) - envelope.unloading_energy(low, at.largest), 0.0, whole);
    const double since = to > from ? below : std::max(0.0, whole - below - area);
    const double start = length + felt.wiping_out * since;
    decay = std::pow(1.0 + felt.wiping_out * area / start, -1.0 / felt.wiping_out);
  }
  at.state[0] = to > from ? 1.0 - (1.0 - at.state[0]) * decay : at.state[0] * decay;
}

}  // namespace

LawValue FeltMemory::force(double compression, double rate, const LawMemory& memory,
                           LawStates& states) const {
  if (n_states() == 1) return evaluate_plain(*this, compression, rate, memory, states);
  return evaluate_memory(*this, compression, rate, memory, states);
}

double FeltMemory::energy(double compression, const LawMemory& memory) const {
  const double inner = inner_compression(compression, memory);
  double z = memory.state[0];
  widen(inner, memory.largest, &z);
  double sum = memory_energy(*this, inner, z, memory.largest);
  if (creeps()) sum += 0.5 * creep_stiffness * memory.state[1] * memory.state[1];
  return sum;
}

void FeltMemory::relax(double compression, double* state) const {
  state[0] = 0.0;
  std::size_t next = 1;
  double inner = compression;
  if (creeps()) {
    inner = std::max(0.0, compression);
    if (inner > 0.0) {
      // Springs in series: F_L(inner) = G (compression - inner).
      const auto excess = [&](double x) {
        return envelope->loading(x).force - creep_stiffness * (compression - x);
      };
      inner = find_root_bracketed(excess, 0.0, excess(0.0), compression,
                                  excess(compression) + 1e-300, 1e-15);
    }
    state[next++] = std::max(0.0, compression) - inner;
  }
  if (rate_amplitude > 0.0) state[next] = envelope->loading(inner).force;
}

CurveValue FeltMemory::rest_force(double compression) const {
  double state[kMaxLawStates] = {};
  relax(compression, state);
  const CurveValue v = envelope->loading(creeps() ? compression - state[1] : compression);
  if (!creeps()) return v;
  return {v.force, v.slope * creep_stiffness / (v.slope + creep_stiffness)};
}

double FeltMemory::rest_energy(double compression) const {
  double state[kMaxLawStates] = {};
  relax(compression, state);
  const double creep = creeps() ? state[1] : 0.0;
  return envelope->loading_energy(compression - creep) + 0.5 * creep_stiffness * creep * creep;
}

double FeltMemory::inner_rate(double compression, double rate, const LawMemory& memory) const {
  if (!creeps()) return rate;
  LawStates states;
  force(compression, rate, memory, states);
  return rate - states.rate[1];
}

double FeltMemory::dissipated_power(double compression, double rate,
                                    const LawMemory& memory) const {
  LawStates states;
  const LawValue v = force(compression, rate, memory, states);
  const double inner = inner_compression(compression, memory);
  const double inner_rate_now = inner_rate(compression, rate, memory);
  double z = memory.state[0];
  widen(inner, memory.largest, &z);
  const double square = (2.0 * z - 1.0) * (2.0 * z - 1.0);
  const FeltCore c = evaluate_core(*this, inner, inner_rate_now, memory);
  double power = (v.force - c.force) * inner_rate_now;
  if (inner > 0.0 && wiping_out > 0.0) {
    const bool virgin = inner > memory.largest || (inner == memory.largest && inner_rate_now > 0.0);
    const Wiping w(*this);
    const double reach = std::max(inner, memory.largest);
    const CurveValue area = envelope->loop_area(reach);
    const double passed = band_area(*envelope, inner, reach, area.force);
    const double away = z - w.middle(passed, area.force);
    const double rest = inner_rate_now > 0.0 ? passed : area.force - passed;
    const double length = w.share * rest + w.kappa * area.force;
    if (virgin) {
      power += (0.5 - w.stiffness * away * away + 2.0 * w.stiffness * z * away / w.kappa) *
               area.slope * inner_rate_now;
    } else if (length > 0.0) {
      power += 2.0 * w.stiffness * area.force / length * away * away * c.band *
               std::fabs(inner_rate_now);
    }
  } else if (inner > 0.0) {
    const bool virgin = inner > memory.largest || (inner == memory.largest && inner_rate_now > 0.0);
    power += virgin ? (z + (0.5 - 0.25 * kappa) * square) * envelope->loop_area(inner).slope *
                          inner_rate_now
                    : 0.5 * c.band * square * std::fabs(inner_rate_now);
  }
  if (creeps()) power += creep_damping * states.rate[1] * states.rate[1];
  return power;
}

void FeltMemory::widen(double compression, double largest, double* state) const {
  if (compression <= largest || state[0] == 0.0) return;
  const double whole = envelope->loop_area(compression).force;
  if (whole <= 0.0) return;
  const double share = std::clamp(envelope->loop_area(largest).force / whole, 0.0, 1.0);
  state[0] *= std::pow(share, 1.0 / kappa);
}

int FeltMemory::piece(double compression, double rate, const LawMemory& memory) const {
  const double inner = inner_compression(compression, memory);
  // A creeping or relaxing layer goes on while its felt carries nothing.
  if (inner <= 0.0) return kOff;
  LawStates states;
  if (force(compression, rate, memory, states).force <= 0.0) return kNoForce;
  if (inner >= memory.largest) return kLoading;
  return inner_rate(compression, rate, memory) > 0.0 ? kUnloading + 8 : kUnloading;
}

bool FeltMemory::advance(PathPoint& at, double compression, double) const {
  if (n_states() != 1) return false;
  // Split where the branch changes: at zero and at the remembered compression.
  const double from = at.compression;
  double stops[2] = {0.0, at.largest};
  if (compression < from) std::swap(stops[0], stops[1]);
  for (const double stop : stops) {
    if ((stop - from) * (compression - stop) > 0.0) move_within(*this, at, stop);
  }
  move_within(*this, at, compression);
  widen(at.compression, at.largest, at.state.data());
  at.largest = std::max(at.largest, at.compression);
  return true;
}

}  // namespace feltmb
