#include "feltmb/model/free_strings.hpp"

#include <algorithm>
#include <cmath>

#include "feltmb/core/flush_to_zero.hpp"
#include "feltmb/core/index.hpp"
#include "feltmb/modal/kernels.hpp"

namespace feltmb {

FreeStrings::FreeStrings(const Mechanism& mechanism) : mechanism_(mechanism) {
  for (const auto& s : mechanism.strings) {
    const double ratio = s.string.parameters().damping_ratio;
    for (const double omega : s.string.angular_frequency()) {
      decay_.push_back(ratio * omega);
      turn_.push_back(omega * std::sqrt((1.0 - ratio) * (1.0 + ratio)));
    }
  }
  for (auto* v : {&start_eta_, &start_rate_, &eta_, &rate_}) v->assign(decay_.size(), 0.0);
  reach_.assign(mechanism.strings.size(), 0.0);
  start_energy_.assign(mechanism.strings.size(), 0.0);
}

void FreeStrings::start(double t, std::span<const double> eta, std::span<const double> rate) {
  start_ = time_ = t;
  std::copy(eta.begin(), eta.end(), start_eta_.begin());
  std::copy(rate.begin(), rate.end(), start_rate_.begin());
  eta_ = start_eta_;
  rate_ = start_rate_;
  const auto at_rest = [](double x) { return x == 0.0; };
  still_ = std::all_of(eta.begin(), eta.end(), at_rest) &&
           std::all_of(rate.begin(), rate.end(), at_rest);
  for (std::size_t s = 0; s < mechanism_.strings.size(); ++s) {
    const AttachedString& a = mechanism_.strings[s];
    const std::size_t count = as_index(a.string.modes());
    const std::size_t first = as_index(a.offset);
    const std::vector<double> shape(count, a.string.shape_scale());
    reach_[s] = modal::reach(count, shape.data(), a.string.stiffness().data(), eta_.data() + first,
                             rate_.data() + first);
    start_energy_[s] = energy(s);
  }
}

void FreeStrings::move(double t) {
  if (t == time_) return;
  time_ = t;
  if (still_) return;
  // From the start each time: where the strings are does not depend on when they were looked at.
  const FlushToZero flush;
  const double h = std::max(0.0, t - start_);
  for (std::size_t i = 0; i < decay_.size(); ++i) {
    const double scale = std::exp(-decay_[i] * h);
    const double c = scale * std::cos(turn_[i] * h);
    const double s = scale * std::sin(turn_[i] * h) / turn_[i];  // impulse response
    const double x = start_eta_[i];
    const double v = start_rate_[i];
    const double square = turn_[i] * turn_[i] + decay_[i] * decay_[i];
    eta_[i] = (c + decay_[i] * s) * x + s * v;
    rate_[i] = (c - decay_[i] * s) * v - square * s * x;
  }
}

double FreeStrings::energy(std::size_t string) const {
  const AttachedString& a = mechanism_.strings[string];
  const auto own = [&](const std::vector<double>& v) {
    return std::span<const double>(v).subspan(as_index(a.offset), as_index(a.string.modes()));
  };
  return a.string.kinetic_energy(own(rate_)) + a.string.elastic_energy(own(eta_));
}

double FreeStrings::heat(std::size_t string) const {
  return start_energy_[string] - energy(string);
}

}  // namespace feltmb
