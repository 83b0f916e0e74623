#include "feltmb/ode/events.hpp"

#include <algorithm>

#include "feltmb/numeric/bracketing.hpp"

namespace feltmb {

EventLocator::EventLocator(OdeSystem& system)
    : system_(system),
      positive_(system.n_events()),
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
  if (before_.empty()) return;
  evaluate(t, y, before_);
  before_known_ = true;
  for (std::size_t i = 0; i < before_.size(); ++i) positive_[i] = before_[i] > 0.0;
}

/// Most steps end far from any sign change, and the integrator has just evaluated the system there:
/// then nothing is evaluated again.
bool EventLocator::nothing_near(double end) {
  if (!system_.events_nearby(end, after_)) return false;
  const double margin = system_.event_margin();
  for (std::size_t i = 0; i < after_.size(); ++i) {
    if (!((positive_[i] != 0 ? after_[i] : -after_[i]) > margin)) return false;
  }
  return true;
}

std::span<const Crossing> EventLocator::scan(const Integrator& integrator, double end) {
  found_.clear();
  if (before_.empty()) return found_;
  if (end == integrator.time() && nothing_near(end)) {
    before_known_ = false;
    time_ = end;
    return found_;
  }
  if (end == integrator.time()) {
    evaluate(end, integrator.state(), after_);
  } else {
    integrator.interpolate(end, y_);
    evaluate(end, y_, after_);
  }
  constexpr double width = 1e-12;  // s
  for (std::size_t i = 0; i < before_.size(); ++i) {
    const bool was = positive_[i] != 0;
    const bool is = after_[i] > 0.0;
    if (was == is) continue;
    if (!before_known_) {
      integrator.interpolate(time_, y_);
      evaluate(time_, y_, before_);
      before_known_ = true;
    }
    // A value that the dense output puts on the other side of zero is zero within its error.
    if ((before_[i] > 0.0) != was) before_[i] = 0.0;
    positive_[i] = is;
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
  before_known_ = true;
  time_ = end;
  return found_;
}

}  // namespace feltmb
