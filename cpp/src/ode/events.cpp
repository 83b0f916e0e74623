#include "feltmb/ode/events.hpp"

#include <algorithm>

#include "feltmb/numeric/bracketing.hpp"

namespace feltmb {

EventLocator::EventLocator(OdeSystem& system)
    : system_(system),
      before_(system.n_events()),
      after_(system.n_events()),
      trial_(system.n_events()),
      y_(system.size()) {}

void EventLocator::evaluate(double t, std::span<const double> y, std::vector<double>& g) {
  system_.events(t, y, g);
  ++evaluations_;
}

void EventLocator::start(double t, std::span<const double> y) {
  time_ = t;
  if (!before_.empty()) evaluate(t, y, before_);
}

std::span<const Crossing> EventLocator::scan(const Integrator& integrator, double end) {
  found_.clear();
  if (before_.empty()) return found_;
  if (end == integrator.time()) {
    evaluate(end, integrator.state(), after_);
  } else {
    integrator.interpolate(end, y_);
    evaluate(end, y_, after_);
  }
  constexpr double width = 1e-12;  // s
  for (std::size_t i = 0; i < before_.size(); ++i) {
    const bool was = before_[i] > 0.0;
    const bool is = after_[i] > 0.0;
    if (was == is) continue;
    double t = before_[i] == 0.0 ? time_ : end;
    if (before_[i] != 0.0 && after_[i] != 0.0) {
      t = find_root_bracketed(
          [&](double s) {
            integrator.interpolate(s, y_);
            evaluate(s, y_, trial_);
            return trial_[i];
          },
          time_, before_[i], end, after_[i], width);
    }
    found_.push_back({t, i, is ? 1 : -1});
  }
  std::stable_sort(found_.begin(), found_.end(),
                   [](const Crossing& a, const Crossing& b) { return a.time < b.time; });
  std::swap(before_, after_);
  time_ = end;
  return found_;
}

}  // namespace feltmb
