#include "feltmb/model/free_strings.hpp"

#include <algorithm>
#include <cmath>

#include "feltmb/core/flush_to_zero.hpp"
#include "feltmb/modal/kernels.hpp"

namespace feltmb {
namespace {

std::size_t at(int i) { return static_cast<std::size_t>(i); }

modal::ModalResponse all_modes(const Mechanism& m, double interval) {
  std::vector<double> stiffness, damping;
  for (const auto& s : m.strings) {
    stiffness.insert(stiffness.end(), s.string.stiffness().begin(), s.string.stiffness().end());
    damping.insert(damping.end(), s.string.damping().begin(), s.string.damping().end());
  }
  return {std::move(stiffness), std::move(damping), interval};
}

}  // namespace

FreeStrings::FreeStrings(const Mechanism& mechanism, double interval)
    : mechanism_(mechanism),
      response_(all_modes(mechanism, interval)),
      sample_(response_.weights(response_.over(interval))),
      interval_(interval) {
  const std::size_t modes = response_.modes();
  for (auto* v : {&start_eta_, &start_rate_, &eta_, &rate_}) v->assign(modes, 0.0);
  reach_.assign(mechanism.strings.size(), 0.0);
  start_energy_.assign(mechanism.strings.size(), 0.0);
}

void FreeStrings::start(double t, std::span<const double> eta, std::span<const double> rate) {
  start_ = time_ = t;
  std::copy(eta.begin(), eta.end(), start_eta_.begin());
  std::copy(rate.begin(), rate.end(), start_rate_.begin());
  eta_ = start_eta_;
  rate_ = start_rate_;
  for (std::size_t s = 0; s < mechanism_.strings.size(); ++s) {
    const AttachedString& a = mechanism_.strings[s];
    const std::size_t count = at(a.string.modes());
    const std::size_t first = at(a.offset);
    const std::vector<double> shape(count, a.string.shape_scale());
    reach_[s] = modal::reach(count, shape.data(), response_.stiffness().data() + first,
                             eta_.data() + first, rate_.data() + first);
    start_energy_[s] = energy(s);
  }
}

void FreeStrings::move(double t) {
  if (t == time_) return;
  const FlushToZero flush;
  const std::size_t n = response_.modes();
  const auto by = [&](const modal::StepWeights& w) {
    modal::rotate(n, w.xx.data(), w.xv.data(), w.vx.data(), w.vv.data(), eta_.data(), rate_.data());
  };
  // Sample times are rounded; a difference of one part in 10^11 turns no mode.
  if (std::fabs(t - time_ - interval_) < 1e-11 * interval_) {
    by(sample_);
  } else {
    eta_ = start_eta_;
    rate_ = start_rate_;
    if (t > start_) by(response_.weights(response_.over(t - start_)));
  }
  time_ = t;
}

double FreeStrings::energy(std::size_t string) const {
  const AttachedString& a = mechanism_.strings[string];
  const auto own = [&](const std::vector<double>& v) {
    return std::span<const double>(v).subspan(at(a.offset), at(a.string.modes()));
  };
  return a.string.kinetic_energy(own(rate_)) + a.string.elastic_energy(own(eta_));
}

double FreeStrings::heat(std::size_t string) const {
  return start_energy_[string] - energy(string);
}

}  // namespace feltmb
