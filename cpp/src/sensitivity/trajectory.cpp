#include "feltmb/sensitivity/trajectory.hpp"

#include <algorithm>
#include <cmath>

#include "feltmb/core/error.hpp"

namespace feltmb {

Trajectory::Trajectory(MechanismSystem& system) : system_(system), width_(system.size()) {
  for (const auto& contact : system.mechanism().contacts) {
    if (contact.law.has_turns()) {
      throw InvalidParameter(format(
          "sensitivity: contact %s has the law %s, whose turning points have no derivatives; use "
          "the law felt_memory there, or differences between runs",
          contact.name.c_str(), contact.law.name().c_str()));
    }
    remembers_ = remembers_ || contact.law.has_memory();
  }
  for (auto& s : slopes_) s.value.resize(width_);
  if (system.modes() > 0) strings_.emplace(system.mechanism());
  // Room for most strokes: what is not used is never touched.
  constexpr std::size_t usual = 16384;
  time_.reserve(usual);
  states_.reserve(usual * width_);
}

void Trajectory::add(double t, std::span<const double> y, std::span<const double> memory,
                     bool free) {
  if (!time_.empty() && t <= time_.back()) {
    // A restart at the same time. With another memory, states of laws are others, too.
    const auto before = this->memory(time_.size() - 1);
    if (std::equal(before.begin(), before.end(), memory.begin())) return;
  }
  time_.push_back(t);
  free_.push_back(free ? 1 : 0);
  states_.insert(states_.end(), y.begin(), y.end());
  if (remembers_) memory_.insert(memory_.end(), memory.begin(), memory.end());
}

namespace {

/// Equal but for what a smooth input changes within a picosecond.
bool near(double a, double b) { return std::fabs(a - b) <= 1e-6 * (1e-3 + std::fabs(a)); }

}  // namespace

std::span<const double> Trajectory::memory(std::size_t node) const {
  if (!remembers_) return {};
  const std::size_t width = system_.mechanism().contacts.size();
  return {memory_.data() + node * width, width};
}

std::size_t Trajectory::interval(double t) const {
  if (time_.size() < 2) return 0;
  const std::size_t last = time_.size() - 2;
  std::size_t i = std::min(last_, last);
  if (t >= time_[i] && t <= time_[i + 1]) return last_ = i;
  if (i < last && t >= time_[i + 1] && t <= time_[i + 2]) return last_ = i + 1;
  const auto it = std::upper_bound(time_.begin(), time_.end(), t);
  const auto after = static_cast<std::size_t>(it - time_.begin());
  i = after == 0 ? 0 : std::min(after - 1, last);
  return last_ = i;
}

std::span<const double> Trajectory::slope(std::size_t node, bool left) {
  for (const Slope& s : slopes_) {
    if (s.node == node && s.left == left) return s.value;
  }
  // The speed of a driven finger may jump at a node, and what a felt remembers: each side has its
  // own slope then.
  const double t = time_[node];
  const double inside = 1e-12 * (1.0 + std::fabs(t));
  if (!remembers_) {
    const Drive before = system_.drive(t - inside);
    const Drive after = system_.drive(t + inside);
    if (near(before.force, after.force) && near(before.displacement, after.displacement) &&
        near(before.speed, after.speed) && near(before.acceleration, after.acceleration)) {
      for (const Slope& s : slopes_) {
        if (s.node == node) return s.value;
      }
    }
  }
  Slope& s = slopes_[next_slope_];
  next_slope_ = (next_slope_ + 1) % 4;
  s.node = node;
  s.left = left;
  system_.rhs(left ? t - inside : t + inside, state(node), s.value);
  return s.value;
}

std::size_t Trajectory::interpolate(double t, std::span<double> y) {
  const std::size_t i = interval(t);
  if (remembers_) {
    const auto row = memory(i);
    std::copy(row.begin(), row.end(), system_.dynamics().largest_compression().begin());
  }
  const auto a = state(i);
  if (time_.size() < 2) {
    std::copy(a.begin(), a.end(), y.begin());
    return i;
  }
  const auto b = state(i + 1);
  const double h = time_[i + 1] - time_[i];
  if (h == 0.0) {
    std::copy(b.begin(), b.end(), y.begin());
    return i;
  }
  const double u = (t - time_[i]) / h;
  const std::span<const double> fa = slope(i, false);
  const std::span<const double> fb = slope(i + 1, true);
  const double u2 = u * u;
  const double u3 = u2 * u;
  const double wb = 3.0 * u2 - 2.0 * u3;
  const double wa = 1.0 - wb;
  const double va = h * (u3 - 2.0 * u2 + u);
  const double vb = h * (u3 - u2);
  for (std::size_t k = 0; k < width_; ++k) {
    y[k] = wa * a[k] + wb * b[k] + va * fa[k] + vb * fb[k];
  }
  return i;
}

std::size_t Trajectory::interpolate_all(double t, std::span<double> y) {
  const std::size_t i = interpolate(t, y);
  if (!strings_ || i + 1 >= free_.size() || free_[i + 1] == 0) return i;
  const auto modes = static_cast<std::size_t>(system_.modes());
  const auto from = state(i).last(2 * modes);
  strings_->start(time_[i], from.first(modes), from.last(modes));
  strings_->move(t);
  const auto to = y.last(2 * modes);
  std::copy(strings_->eta().begin(), strings_->eta().end(), to.begin());
  std::copy(strings_->rate().begin(), strings_->rate().end(), to.last(modes).begin());
  return i;
}

}  // namespace feltmb
