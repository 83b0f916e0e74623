#include "feltmb/contact/side_by_side.hpp"

#include <algorithm>
#include <limits>
#include <utility>
#include <variant>

#include "feltmb/core/multiversion.hpp"
#include "feltmb/numeric/elementary.hpp"

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

}  // namespace

FrictionLanes::FrictionLanes(std::vector<Friction> frictions) : frictions_(std::move(frictions)) {
  const std::size_t most = whole_blocks(frictions_.size());
  for (auto* v : {&speed, &value, &slope, &amplitude_, &b1_, &b2_}) v->assign(most, 0.0);
  threshold_.assign(most, 1.0);
}

void FrictionLanes::choose(std::span<const std::size_t> which) {
  lanes_ = whole_blocks(which.size());
  for (std::size_t i = 0; i < lanes_; ++i) {
    const bool taken = i < which.size() && takes(frictions_[which[i]]);
    const Friction f = taken ? frictions_[which[i]] : Friction{};
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
  constexpr double below_tangent = 39.0;  // of b e; see ExponentialCurve
  const double b = std::max(pair->loading.b, pair->unloading.b);
  entries_.back() = {*pair, b > 0.0 ? below_tangent / b : std::numeric_limits<double>::max()};
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

}  // namespace feltmb
