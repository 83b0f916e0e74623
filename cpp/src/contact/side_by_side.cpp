#include "feltmb/contact/side_by_side.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <variant>

#include "feltmb/core/multiversion.hpp"
#include "feltmb/numeric/elementary.hpp"
#include "monotone_table.hpp"

namespace feltmb {
namespace {

constexpr std::size_t kBlock = 4;

std::size_t whole_blocks(std::size_t n) { return (n + kBlock - 1) / kBlock * kBlock; }

struct FrictionArrays {
  const double *amplitude, *b1, *b2, *threshold, *speed;
};

FELTMB_CLONES void friction_lanes(std::size_t blocks, const FrictionArrays& f,
                                  double* __restrict value, double* __restrict slope) {
  for (std::size_t i = 0; i < blocks * kBlock; ++i) {
    const double x = f.speed[i] / f.threshold[i];
    const HyperbolicTangent t = fast_tanh_flat(x);
    const double x4 = f.b2[i] * x * x * x * x;
    const double d = 1.0 / (1.0 + x4);
    const bool more = f.b1[i] != 0.0;
    const double v = more ? t.value + f.b1[i] * x * d : t.value;
    const double s = more ? t.slope + f.b1[i] * (1.0 - 3.0 * x4) * d * d : t.slope;
    value[i] = f.amplitude[i] * v;
    slope[i] = f.amplitude[i] * s / f.threshold[i];
  }
}

struct PairArrays {
  const double *load_a, *load_b, *load_c, *unload_a, *unload_b, *unload_c;
  const double *alpha, *hysteresis, *guarded, *compression, *rate;
};

/// The steps of the law of one pair with every branch as a choice between two values.
FELTMB_CLONES void pair_lanes(std::size_t blocks, const PairArrays& p, double* __restrict force,
                              double* __restrict by_compression, double* __restrict by_rate) {
  for (std::size_t i = 0; i < blocks * kBlock; ++i) {
    const double e = p.compression[i];
    const double rate = p.rate[i];
    const bool guarded = p.guarded[i] != 0.0;
    const double load_x = p.load_b[i] * e;
    const double load_g = p.load_a[i] * fast_exp(load_x);
    const double load = (load_g + p.load_c[i]) * e;
    const double load_slope = load_g * (1.0 + load_x) + p.load_c[i];
    const double unload_x = p.unload_b[i] * e;
    const double unload_g = p.unload_a[i] * fast_exp(unload_x);
    double unload = (unload_g + p.unload_c[i]) * e;
    double unload_slope = unload_g * (1.0 + unload_x) + p.unload_c[i];
    const bool low = guarded & (unload < 0.0);
    unload = low ? 0.0 : unload;
    unload_slope = low ? 0.0 : unload_slope;
    const bool high = guarded & (unload > load);
    unload = high ? load : unload;
    unload_slope = high ? load_slope : unload_slope;
    const double h = p.hysteresis[i];
    const bool plain = h == 1.0;
    double wide = load - h * (load - unload);
    double wide_slope = load_slope - h * (load_slope - unload_slope);
    const bool below = guarded & (wide < 0.0);
    wide = below ? 0.0 : wide;
    wide_slope = below ? 0.0 : wide_slope;
    unload = plain ? unload : wide;
    unload_slope = plain ? unload_slope : wide_slope;
    const HyperbolicTangent t = fast_tanh_flat(p.alpha[i] * rate);
    const double band = load - unload;
    const bool rising = rate >= 0.0;
    const bool none = guarded & (load <= 0.0);
    const double f = rising ? load : load + band * t.value;
    const double k = rising ? load_slope : load_slope + (load_slope - unload_slope) * t.value;
    const double c = rising ? 0.0 : band * p.alpha[i] * t.slope;
    force[i] = none ? 0.0 : f;
    by_compression[i] = none ? 0.0 : k;
    by_rate[i] = none ? 0.0 : c;
  }
}

/// Where sqrt(numerator / denominator) lies in a table; `lowest` is the least ratio.
FELTMB_CLONES void place_lanes(std::size_t blocks, const double* numerator,
                               const double* denominator, double lowest, double* __restrict root,
                               int* __restrict index, double* __restrict within) {
  constexpr double pieces = static_cast<double>(Envelope::kPieces);
  for (std::size_t i = 0; i < blocks * kBlock; ++i) {
    double x = numerator[i] / denominator[i];
    x = x < lowest ? lowest : x;
    x = x < 1.0 ? x : 1.0;  // beyond, nobody looks at the result
    const double s = std::sqrt(x);
    const double position = s * pieces;
    // The last piece holds its end as well.
    const double below = position < pieces - 1.0 ? position : pieces - 1.0;
    const int j = static_cast<int>(below);
    root[i] = s;
    index[i] = j;
    within[i] = position - static_cast<double>(j);
  }
}

FELTMB_CLONES void exponential_lanes(std::size_t blocks, const double* a, const double* b,
                                     const double* c, const double* from, const double* compression,
                                     double* __restrict load, double* __restrict load_slope) {
  for (std::size_t i = 0; i < blocks * kBlock; ++i) {
    const double e = compression[i];
    const double x = b[i] * e;
    const double g = a[i] * fast_exp(x);
    const bool carries = e > from[i];
    const double value = (g + c[i]) * e;
    const double slope = g * (1.0 + x) + c[i];
    load[i] = carries ? value : 0.0;
    load_slope[i] = carries ? slope : 0.0;
  }
}

struct PieceArrays {
  const double *root, *within, *value, *slope, *second, *third;
};

FELTMB_CLONES void table_lanes(std::size_t blocks, const PieceArrays& p, const double* end,
                               double* __restrict load, double* __restrict load_slope) {
  for (std::size_t i = 0; i < blocks * kBlock; ++i) {
    const CubicPiece piece{p.value[i], p.slope[i], p.second[i], p.third[i]};
    const CurveValue v = tables::evaluate(piece, tables::kWidth, p.within[i]);
    load[i] = v.force;
    load_slope[i] = v.slope / (2.0 * p.root[i] * end[i]);
  }
}

struct MemoryArrays {
  const double *compression, *rate, *state, *largest, *per_length;
  const double *curve, *curve_slope, *table, *table_slope, *is_table;
};

/// The steps of the law of one felt with every branch as a choice; on the virgin loading curve z
/// rests.
FELTMB_CLONES void memory_lanes(std::size_t blocks, const MemoryArrays& m, const PieceArrays& rho,
                                double* __restrict force, double* __restrict by_compression,
                                double* __restrict by_state, double* __restrict z_rate,
                                double* __restrict z_rate_by_compression,
                                double* __restrict z_rate_by_rate, double* __restrict z_rate_by_z) {
  for (std::size_t i = 0; i < blocks * kBlock; ++i) {
    const double e = m.compression[i];
    const double rate = m.rate[i];
    const double z = m.state[i];
    const double largest = m.largest[i];
    const bool in_table = m.is_table[i] != 0.0;
    const double table = m.table[i];
    const double table_slope = m.table_slope[i];
    const double curve = m.curve[i];
    const double curve_slope = m.curve_slope[i];
    const double load = in_table ? table : curve;
    const double load_slope = in_table ? table_slope : curve_slope;
    const bool beyond = (e >= largest) | (largest < FeltMemory::nothing);
    const CubicPiece piece{rho.value[i], rho.slope[i], rho.second[i], rho.third[i]};
    const CurveValue v = tables::evaluate(piece, tables::kWidth, rho.within[i]);
    const double ratio = v.force;
    const double ratio_slope = v.slope / (2.0 * rho.root[i] * largest);
    const double mix = ratio + z * (1.0 - ratio);
    const double f = load * mix;
    const double k = load_slope * mix + load * (1.0 - z) * ratio_slope;
    const double band = load * (1.0 - ratio);
    const double band_slope = load_slope * (1.0 - ratio) - load * ratio_slope;
    const double up = 1.0 - z;
    const double left = rate > 0.0 ? up : z;
    const double per_length = m.per_length[i];
    const double share = band * per_length;
    force[i] = beyond ? load : f;
    by_compression[i] = beyond ? load_slope : k;
    by_state[i] = beyond ? 0.0 : band;
    const bool still = beyond | (per_length == 0.0);
    const double by_rate = share * left;
    const double z_rate_now = by_rate * rate;
    const double by_e = band_slope * per_length * left * rate;
    const double by_z = -share * std::fabs(rate);
    z_rate[i] = still ? 0.0 : z_rate_now;
    z_rate_by_compression[i] = still ? 0.0 : by_e;
    z_rate_by_rate[i] = still ? 0.0 : by_rate;
    z_rate_by_z[i] = still ? 0.0 : by_z;
  }
}

/// Of b e: below the tangent of ExponentialCurve.
constexpr double kBelowTangent = 39.0;

double reach_of(double b) {
  return b > 0.0 ? kBelowTangent / b : std::numeric_limits<double>::max();
}

}  // namespace

FrictionLanes::FrictionLanes(std::vector<Friction> frictions) : frictions_(std::move(frictions)) {
  const std::size_t most = whole_blocks(frictions_.size());
  for (auto* v : {&speed, &value, &slope, &amplitude_, &b1_, &b2_}) v->assign(most, 0.0);
  threshold_.assign(most, 1.0);
  taken_.assign(most, 0);
}

void FrictionLanes::choose(std::span<const std::size_t> which) {
  lanes_ = whole_blocks(which.size());
  for (std::size_t i = 0; i < lanes_; ++i) {
    const bool taken = i < which.size() && takes(frictions_[which[i]]);
    const Friction f = taken ? frictions_[which[i]] : Friction{};
    taken_[i] = taken ? 1 : 0;
    amplitude_[i] = f.amplitude;
    b1_[i] = f.b1;
    b2_[i] = f.b2;
    threshold_[i] = f.threshold_speed;
    speed[i] = 0.0;
  }
}

void FrictionLanes::evaluate() {
  friction_lanes(lanes_ / kBlock,
                 {amplitude_.data(), b1_.data(), b2_.data(), threshold_.data(), speed.data()},
                 value.data(), slope.data());
}

void PairLanes::add(const ContactLaw& law) {
  const auto* pair = std::get_if<ExponentialPair>(&law.parameters());
  entries_.emplace_back();
  if (pair == nullptr || law.n_states() > 0) return;
  entries_.back() = {*pair, reach_of(std::max(pair->loading.b, pair->unloading.b))};
}

void PairLanes::finish() {
  const std::size_t most = whole_blocks(entries_.size());
  for (auto* v :
       {&compression, &rate, &reach_, &load_a_, &load_b_, &load_c_, &unload_a_, &unload_b_,
        &unload_c_, &alpha_, &hysteresis_, &guarded_, &force_, &by_compression_, &by_rate_}) {
    v->assign(most, 0.0);
  }
}

void PairLanes::choose(std::span<const std::size_t> which) {
  lanes_ = whole_blocks(which.size());
  bool any = false;
  for (std::size_t i = 0; i < lanes_; ++i) {
    const Entry entry = i < which.size() ? entries_[which[i]] : Entry{};
    const ExponentialPair& pair = entry.pair;
    reach_[i] = entry.reach;
    load_a_[i] = pair.loading.a;
    load_b_[i] = pair.loading.b;
    load_c_[i] = pair.loading.c;
    unload_a_[i] = pair.unloading.a;
    unload_b_[i] = pair.unloading.b;
    unload_c_[i] = pair.unloading.c;
    alpha_[i] = pair.alpha;
    hysteresis_[i] = pair.hysteresis;
    guarded_[i] = pair.form == ExponentialPair::Form::kGuarded ? 1.0 : 0.0;
    compression[i] = rate[i] = 0.0;
    any = any || entry.reach > 0.0;
  }
  if (!any) lanes_ = 0;
}

void PairLanes::evaluate() {
  pair_lanes(lanes_ / kBlock,
             {load_a_.data(), load_b_.data(), load_c_.data(), unload_a_.data(), unload_b_.data(),
              unload_c_.data(), alpha_.data(), hysteresis_.data(), guarded_.data(),
              compression.data(), rate.data()},
             force_.data(), by_compression_.data(), by_rate_.data());
}

void MemoryLanes::add(const ContactLaw& law) {
  Entry& entry = entries_.emplace_back();
  if (!takes(law)) return;
  const auto& felt = std::get<FeltMemory>(law.parameters());
  const Envelope& envelope = *felt.envelope;
  entry.envelope = &envelope;
  entry.kappa = felt.kappa;
  entry.reach = envelope.curve() != nullptr ? reach_of(envelope.curve()->b) : envelope.reach();
  if (envelope.needs_room()) entry.room.resize(Envelope::kPieces);
}

void MemoryLanes::finish() {
  const std::size_t most = whole_blocks(entries_.size());
  for (auto* v : {&compression,
                  &rate,
                  &state,
                  &reach_,
                  &largest_,
                  &per_length_,
                  &a_,
                  &b_,
                  &c_,
                  &from_,
                  &end_,
                  &is_table_,
                  &curve_,
                  &curve_slope_,
                  &table_,
                  &table_slope_,
                  &force_,
                  &by_compression_,
                  &by_state_,
                  &state_rate_,
                  &state_rate_by_compression_,
                  &state_rate_by_rate_,
                  &state_rate_by_state_}) {
    v->assign(most, 0.0);
  }
  for (Places* places : {&ratio_, &loading_}) {
    for (auto* v : {&places->root, &places->within, &places->value, &places->slope, &places->second,
                    &places->third}) {
      v->assign(most, 0.0);
    }
    places->index.assign(most, 0);
    places->table.assign(most, nullptr);
  }
  which_.assign(most, 0);
}

void MemoryLanes::choose(std::span<const std::size_t> which) {
  static constexpr CubicPiece nothing[Envelope::kPieces] = {};
  lanes_ = whole_blocks(which.size());
  exponential_ = tabulated_ = false;
  for (std::size_t i = 0; i < lanes_; ++i) {
    ratio_.table[i] = loading_.table[i] = nothing;
    reach_[i] = a_[i] = b_[i] = c_[i] = from_[i] = is_table_[i] = per_length_[i] = 0.0;
    end_[i] = largest_[i] = 1.0;
    compression[i] = rate[i] = state[i] = 0.0;
    if (i >= which.size()) continue;
    which_[i] = which[i];
    const Entry& entry = entries_[which[i]];
    largest_[i] = std::numeric_limits<double>::quiet_NaN();
    reach_[i] = entry.reach;
    if (const ExponentialCurve* curve = entry.envelope->curve()) {
      exponential_ = true;
      a_[i] = curve->a;
      b_[i] = curve->b;
      c_[i] = curve->c;
      from_[i] = entry.envelope->first_positive();
    } else {
      tabulated_ = true;
      is_table_[i] = 1.0;
      end_[i] = entry.envelope->reach();
      loading_.table[i] = entry.envelope->loading_pieces();
    }
  }
}

void MemoryLanes::begin(std::size_t lane, const CycleStart& cycle) {
  Entry& entry = entries_[which_[lane]];
  largest_[lane] = cycle.largest;
  const double length = entry.kappa * cycle.area;
  per_length_[lane] = length <= 0.0 ? 0.0 : 1.0 / length;
  // The pieces of a single row are no work, those of several are kept for the next closing.
  if (!entry.room.empty() && entry.blended == cycle.largest) {
    ratio_.table[lane] = entry.room.data();
    return;
  }
  ratio_.table[lane] = entry.envelope->ratio_pieces(cycle, entry.room.data());
  entry.blended = cycle.largest;
}

void MemoryLanes::gather(std::size_t lanes, Places& places) {
  for (std::size_t i = 0; i < lanes; ++i) {
    const CubicPiece& piece = places.table[i][places.index[i]];
    places.value[i] = piece.value;
    places.slope[i] = piece.slope;
    places.second[i] = piece.second;
    places.third[i] = piece.third;
  }
}

void MemoryLanes::evaluate() {
  if (lanes_ == 0) return;
  const std::size_t blocks = lanes_ / kBlock;
  const auto pieces = [](const Places& p) {
    return PieceArrays{p.root.data(),  p.within.data(), p.value.data(),
                       p.slope.data(), p.second.data(), p.third.data()};
  };
  const auto find = [&](Places& p, const std::vector<double>& end, double lowest) {
    place_lanes(blocks, compression.data(), end.data(), lowest, p.root.data(), p.index.data(),
                p.within.data());
    gather(lanes_, p);
  };
  find(ratio_, largest_, Envelope::kSmallest);
  if (exponential_) {
    exponential_lanes(blocks, a_.data(), b_.data(), c_.data(), from_.data(), compression.data(),
                      curve_.data(), curve_slope_.data());
  }
  if (tabulated_) {
    find(loading_, end_, 0.0);
    table_lanes(blocks, pieces(loading_), end_.data(), table_.data(), table_slope_.data());
  }
  memory_lanes(
      blocks,
      {compression.data(), rate.data(), state.data(), largest_.data(), per_length_.data(),
       curve_.data(), curve_slope_.data(), table_.data(), table_slope_.data(), is_table_.data()},
      pieces(ratio_), force_.data(), by_compression_.data(), by_state_.data(), state_rate_.data(),
      state_rate_by_compression_.data(), state_rate_by_rate_.data(), state_rate_by_state_.data());
}

}  // namespace feltmb
