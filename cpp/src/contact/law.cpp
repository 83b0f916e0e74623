#include "feltmb/contact/law.hpp"

#include <algorithm>
#include <cmath>

#include "feltmb/core/error.hpp"
#include "feltmb/numeric/bracketing.hpp"
#include "feltmb/numeric/elementary.hpp"
#include "law_faults.hpp"

namespace feltmb {
namespace {

/// Where a e exp(b e) + c e turns positive: 0 if it is positive from the start.
double first_positive_compression(const ExponentialCurve& curve) {
  if (curve.a + curve.c >= 0.0 || curve.a <= 0.0 || curve.b <= 0.0) return 0.0;
  return std::log(-curve.c / curve.a) / curve.b;
}

double mean_integral(const MeanCurve& mean, double e) {
  return 0.5 * (integral(mean.loading, e) + integral(mean.unloading, e));
}

/// The mean of two exponential curves has no closed first root: bisection on the sign of F/e.
double first_positive_compression(const MeanCurve& mean) {
  const auto sign = [&](double e) {
    return evaluate(mean.loading, e).force + evaluate(mean.unloading, e).force;
  };
  double low = 1e-12;
  if (sign(low) >= 0.0) return 0.0;
  double high = 1e-6;
  while (sign(high) < 0.0) {
    high *= 2.0;
    if (high > 1.0) return 0.0;
  }
  for (int i = 0; i < 200 && high - low > 1e-18; ++i) {
    const double middle = 0.5 * (low + high);
    (sign(middle) < 0.0 ? low : high) = middle;
  }
  return high;
}

LawValue evaluate_pair(const ExponentialPair& pair, double e, double rate) {
  CurveValue load = evaluate(pair.loading, e);
  const bool guarded = pair.form == ExponentialPair::Form::kGuarded;
  if (guarded && load.force <= 0.0) return {};
  if (rate >= 0.0) return {load.force, load.slope, 0.0};
  CurveValue unload = evaluate(pair.unloading, e);
  if (guarded) {
    if (unload.force < 0.0) unload = {0.0, 0.0};
    if (unload.force > load.force) unload = load;
  }
  if (pair.hysteresis != 1.0) {
    unload.force = load.force - pair.hysteresis * (load.force - unload.force);
    unload.slope = load.slope - pair.hysteresis * (load.slope - unload.slope);
    if (guarded && unload.force < 0.0) unload = {0.0, 0.0};
  }
  const HyperbolicTangent t = fast_tanh(pair.alpha * rate);
  const double band = load.force - unload.force;
  return {load.force + band * t.value, load.slope + (load.slope - unload.slope) * t.value,
          band * pair.alpha * t.slope};
}

/// Loading curve that a pair uses, zero where it is open or held at zero.
CurveValue pair_loading(const ExponentialPair& pair, double e) {
  if (e <= 0.0) return {};
  const CurveValue load = evaluate(pair.loading, e);
  const bool guarded = pair.form == ExponentialPair::Form::kGuarded;
  return guarded && load.force <= 0.0 ? CurveValue{} : load;
}

/// A pair with its rate term, one state r.
LawValue evaluate_relaxing(const ExponentialPair& pair, double e, double rate, const double* state,
                           LawStates& s) {
  const CurveValue load = pair_loading(pair, e);
  s.force[0] = 0.0;
  s.rate[0] = (load.force - state[0]) / pair.rate_time;
  s.rate_by_compression[0] = load.slope / pair.rate_time;
  s.rate_by_state[0][0] = -1.0 / pair.rate_time;
  if (e <= 0.0) return {};
  LawValue v = evaluate_pair(pair, e, rate);
  const double extra = pair.rate_amplitude * (load.force - state[0]);
  if (pair.form == ExponentialPair::Form::kGuarded && v.force + extra <= 0.0) return {};
  v.force += extra;
  v.d_compression += pair.rate_amplitude * load.slope;
  s.force[0] = -pair.rate_amplitude;
  return v;
}

LawValue evaluate_stulov(const Stulov& law, double e, const double* state, LawStates& s) {
  LawValue v;
  s = {};  // nothing stays of another branch
  const double g = state[0];
  const double power = e > 0.0 ? std::pow(e, law.exponent) : 0.0;
  const double power_slope = e > 0.0 ? law.exponent * power / e : 0.0;
  s.rate[0] = (power - g) / law.time;
  s.rate_by_compression[0] = power_slope / law.time;
  s.rate_by_state[0][0] = -1.0 / law.time;
  const double relaxed = power - law.amplitude * g;
  if (e > 0.0 && relaxed > 0.0) {
    v.force = law.stiffness * relaxed;
    v.d_compression = law.stiffness * power_slope;
    s.force[0] = -law.stiffness * law.amplitude;
  }
  return v;
}

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
                        LawStates* states) {
  const FeltCore c = evaluate_core(law, e, rate, memory);
  if (states != nullptr) {
    states->force[0] = c.by_z;
    states->rate[0] = c.z_rate;
    states->rate_by_compression[0] = c.z_rate_by_compression;
    states->rate_by_rate[0] = c.z_rate_by_rate;
    states->rate_by_state[0][0] = c.z_rate_by_z;
  }
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

}  // namespace

ContactLaw::ContactLaw(const LawParameters& parameters) : parameters_(parameters) {
  check_law(parameters);
  if (const auto* pair = std::get_if<ExponentialPair>(&parameters)) {
    if (pair->form == ExponentialPair::Form::kGuarded) {
      first_positive_ = first_positive_compression(pair->loading);
      energy_offset_ = integral(pair->loading, first_positive_);
    }
    if (pair->rate_amplitude > 0.0) n_states_ = 1;
  } else if (const auto* mean = std::get_if<MeanCurve>(&parameters)) {
    first_positive_ = first_positive_compression(*mean);
    energy_offset_ = mean_integral(*mean, first_positive_);
  } else if (std::holds_alternative<Stulov>(parameters)) {
    n_states_ = 1;
  } else if (const auto* memory = std::get_if<FeltMemory>(&parameters)) {
    n_states_ =
        1 + (memory->creep_stiffness > 0.0 ? 1 : 0) + (memory->rate_amplitude > 0.0 ? 1 : 0);
  }
}

const char* ContactLaw::state_name(std::size_t i) const {
  if (std::holds_alternative<Stulov>(parameters_)) return "g";
  if (std::holds_alternative<ExponentialPair>(parameters_)) return "overstress";
  if (i == 0) return "z";
  const auto& memory = std::get<FeltMemory>(parameters_);
  return i == 1 && memory.creep_stiffness > 0.0 ? "creep" : "overstress";
}

std::string ContactLaw::name() const {
  if (const auto* pair = std::get_if<ExponentialPair>(&parameters_)) {
    return pair->form == ExponentialPair::Form::kGuarded ? "guarded" : "printed";
  }
  if (std::holds_alternative<MeanCurve>(parameters_)) return "mean";
  if (std::holds_alternative<HuntCrossley>(parameters_)) return "hunt_crossley";
  if (std::holds_alternative<Stulov>(parameters_)) return "stulov";
  return "felt_memory";
}

LawValue ContactLaw::evaluate(double compression, double rate, const LawMemory& memory,
                              LawStates* states) const {
  // States go on while the contact is open.
  if (const auto* felt = std::get_if<FeltMemory>(&parameters_)) {
    if (n_states_ == 1) return evaluate_plain(*felt, compression, rate, memory, states);
    LawStates unwanted;
    return evaluate_memory(*felt, compression, rate, memory,
                           states != nullptr ? *states : unwanted);
  }
  if (const auto* st = std::get_if<Stulov>(&parameters_)) {
    LawStates unwanted;
    return evaluate_stulov(*st, compression, memory.state, states != nullptr ? *states : unwanted);
  }
  const auto* pair = std::get_if<ExponentialPair>(&parameters_);
  if (pair != nullptr && n_states_ > 0) {
    LawStates unwanted;
    return evaluate_relaxing(*pair, compression, rate, memory.state,
                             states != nullptr ? *states : unwanted);
  }
  if (compression <= 0.0) return {};
  if (pair != nullptr) return evaluate_pair(*pair, compression, rate);
  if (const auto* mean = std::get_if<MeanCurve>(&parameters_)) {
    const CurveValue load = feltmb::evaluate(mean->loading, compression);
    const CurveValue unload = feltmb::evaluate(mean->unloading, compression);
    const double force = 0.5 * (load.force + unload.force);
    if (force <= 0.0) return {};
    return {force, 0.5 * (load.slope + unload.slope), 0.0};
  }
  const auto& hc = std::get<HuntCrossley>(parameters_);
  const double elastic = hc.stiffness * std::pow(compression, hc.exponent);
  const double factor = 1.0 + hc.damping * rate;
  if (factor <= 0.0) return {};
  return {elastic * factor, hc.exponent * elastic / compression * factor, elastic * hc.damping};
}

double ContactLaw::stored_energy(double compression, const LawMemory& memory) const {
  if (const auto* felt = std::get_if<FeltMemory>(&parameters_)) {
    const double inner = felt_compression(compression, memory);
    double energy = memory_energy(*felt, inner, memory.state[0], memory.largest);
    if (felt->creep_stiffness > 0.0) {
      energy += 0.5 * felt->creep_stiffness * memory.state[1] * memory.state[1];
    }
    return energy;
  }
  if (compression <= 0.0) return 0.0;
  if (const auto* pair = std::get_if<ExponentialPair>(&parameters_)) {
    if (pair->form == ExponentialPair::Form::kGuarded && compression <= first_positive_) return 0.0;
    return integral(pair->loading, compression) - energy_offset_;
  }
  if (const auto* mean = std::get_if<MeanCurve>(&parameters_)) {
    return compression <= first_positive_ ? 0.0
                                          : mean_integral(*mean, compression) - energy_offset_;
  }
  if (const auto* hc = std::get_if<HuntCrossley>(&parameters_)) {
    return hc->stiffness * std::pow(compression, hc->exponent + 1.0) / (hc->exponent + 1.0);
  }
  const auto& st = std::get<Stulov>(parameters_);
  return st.stiffness * (1.0 - st.amplitude) * std::pow(compression, st.exponent + 1.0) /
         (st.exponent + 1.0);
}

void ContactLaw::relax(double compression, double* state) const {
  if (const auto* st = std::get_if<Stulov>(&parameters_)) {
    state[0] = compression > 0.0 ? std::pow(compression, st->exponent) : 0.0;
    return;
  }
  if (const auto* pair = std::get_if<ExponentialPair>(&parameters_)) {
    if (n_states_ > 0) state[0] = pair_loading(*pair, compression).force;
    return;
  }
  const auto* felt = std::get_if<FeltMemory>(&parameters_);
  if (felt == nullptr) return;
  state[0] = 0.0;
  std::size_t next = 1;
  double inner = compression;
  if (felt->creep_stiffness > 0.0) {
    inner = std::max(0.0, compression);
    if (inner > 0.0) {
      // Springs in series: F_L(inner) = G (compression - inner).
      const auto excess = [&](double x) {
        return felt->envelope->loading(x).force - felt->creep_stiffness * (compression - x);
      };
      inner = find_root_bracketed(excess, 0.0, excess(0.0), compression,
                                  excess(compression) + 1e-300, 1e-15);
    }
    state[next++] = std::max(0.0, compression) - inner;
  }
  if (felt->rate_amplitude > 0.0) state[next] = felt->envelope->loading(inner).force;
}

CurveValue ContactLaw::static_force(double compression) const {
  if (compression <= 0.0) return {0.0, 0.0};
  if (const auto* st = std::get_if<Stulov>(&parameters_)) {
    const double f = st->stiffness * (1.0 - st->amplitude) * std::pow(compression, st->exponent);
    return {f, st->exponent * f / compression};
  }
  if (const auto* felt = std::get_if<FeltMemory>(&parameters_)) {
    double state[kMaxLawStates] = {};
    relax(compression, state);
    const bool creeps = felt->creep_stiffness > 0.0;
    const CurveValue v = felt->envelope->loading(creeps ? compression - state[1] : compression);
    if (!creeps) return v;
    return {v.force, v.slope * felt->creep_stiffness / (v.slope + felt->creep_stiffness)};
  }
  if (const auto* pair = std::get_if<ExponentialPair>(&parameters_)) {
    return pair_loading(*pair, compression);
  }
  const LawValue v = evaluate(compression, 0.0);
  return {v.force, v.d_compression};
}

double ContactLaw::static_energy(double compression) const {
  const auto* felt = std::get_if<FeltMemory>(&parameters_);
  if (felt == nullptr) return stored_energy(compression);
  if (compression <= 0.0) return 0.0;
  double state[kMaxLawStates] = {};
  relax(compression, state);
  const double creep = felt->creep_stiffness > 0.0 ? state[1] : 0.0;
  return felt->envelope->loading_energy(compression - creep) +
         0.5 * felt->creep_stiffness * creep * creep;
}

double ContactLaw::felt_compression(double compression, const LawMemory& memory) const {
  const auto* felt = std::get_if<FeltMemory>(&parameters_);
  return felt != nullptr && felt->creep_stiffness > 0.0 ? compression - memory.state[1]
                                                        : compression;
}

double ContactLaw::felt_rate(double compression, double rate, const LawMemory& memory) const {
  const auto* felt = std::get_if<FeltMemory>(&parameters_);
  if (felt == nullptr || felt->creep_stiffness == 0.0) return rate;
  LawStates states;
  evaluate(compression, rate, memory, &states);
  return rate - states.rate[1];
}

double ContactLaw::dissipated_power(double compression, double rate,
                                    const LawMemory& memory) const {
  if (const auto* felt = std::get_if<FeltMemory>(&parameters_)) {
    LawStates states;
    const LawValue v = evaluate(compression, rate, memory, &states);
    const double inner = felt_compression(compression, memory);
    const double inner_rate = felt_rate(compression, rate, memory);
    const double z = memory.state[0];
    const double square = (2.0 * z - 1.0) * (2.0 * z - 1.0);
    const FeltCore c = evaluate_core(*felt, inner, inner_rate, memory);
    double power = (v.force - c.force) * inner_rate;
    if (inner > 0.0 && felt->wiping_out > 0.0) {
      const bool virgin = inner > memory.largest || (inner == memory.largest && inner_rate > 0.0);
      const Wiping w(*felt);
      const double reach = std::max(inner, memory.largest);
      const CurveValue area = felt->envelope->loop_area(reach);
      const double passed = band_area(*felt->envelope, inner, reach, area.force);
      const double away = z - w.middle(passed, area.force);
      const double rest = inner_rate > 0.0 ? passed : area.force - passed;
      const double length = w.share * rest + w.kappa * area.force;
      if (virgin) {
        power += (0.5 - w.stiffness * away * away) * area.slope * inner_rate;
      } else if (length > 0.0) {
        power +=
            2.0 * w.stiffness * area.force / length * away * away * c.band * std::fabs(inner_rate);
      }
    } else if (inner > 0.0) {
      const bool virgin = inner > memory.largest || (inner == memory.largest && inner_rate > 0.0);
      power += virgin ? (0.5 - 0.25 * felt->kappa * square) *
                            felt->envelope->loop_area(inner).slope * inner_rate
                      : 0.5 * c.band * square * std::fabs(inner_rate);
    }
    if (felt->creep_stiffness > 0.0) {
      power += felt->creep_damping * states.rate[1] * states.rate[1];
    }
    return power;
  }
  if (compression <= 0.0) return 0.0;
  const double force = evaluate(compression, rate, memory).force;
  double elastic = 0.0;
  if (const auto* hc = std::get_if<HuntCrossley>(&parameters_)) {
    elastic = hc->stiffness * std::pow(compression, hc->exponent);
  } else if (const auto* st = std::get_if<Stulov>(&parameters_)) {
    elastic = st->stiffness * (1.0 - st->amplitude) * std::pow(compression, st->exponent);
  } else if (const auto* pair = std::get_if<ExponentialPair>(&parameters_)) {
    elastic = pair_loading(*pair, compression).force;
  } else {
    elastic = evaluate(compression, 0.0).force;
  }
  return (force - elastic) * rate;
}

}  // namespace feltmb
