#include "feltmb/modal/contact_stepper.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include "feltmb/core/error.hpp"
#include "feltmb/core/flush_to_zero.hpp"
#include "feltmb/core/sums.hpp"
#include "feltmb/modal/kernels.hpp"
#include "feltmb/numeric/bracketing.hpp"

namespace feltmb::modal {
namespace {

/// Largest distance of a cubic from its parabola through 0, h/2 and h over h^3 / 6 times its third
/// derivative: sqrt(3) / 36.
constexpr double kParabola = 0.048112522432468816;

/// Distance of a broken line from its parabola, a unit of the jump in slope times the way, 0.06 at
/// most, and a margin: what the break throws into undamped modes stays there.
constexpr double kShortestKink = 1e-5;  // of the interval: the impulse of a shorter one is nothing
constexpr double kKink = 0.3;

/// Cubic through the ends of a stretch of length h with slopes a, b; value at u in [0, 1].
double hermite(double from, double to, double a, double b, double h, double u) {
  const double d = to - from;
  const double c2 = 3.0 * d - h * (2.0 * a + b);
  const double c3 = h * (a + b) - 2.0 * d;
  return from + u * (h * a + u * (c2 + u * c3));
}

/// Whether that cubic rises above zero between two negative ends.
bool rises(double from, double to, double a, double b, double h) {
  if (a <= 0.0 || b >= 0.0) return false;
  // Both tangents bound a cubic with one maximum from above.
  const double tangent = std::min(from + 0.5 * h * a, to - 0.5 * h * b);
  if (tangent <= 0.0) return false;
  for (int i = 1; i < 8; ++i) {
    if (hermite(from, to, a, b, h, i / 8.0) > 0.0) return true;
  }
  return false;
}

}  // namespace

ModalContactStepper::ModalContactStepper(std::vector<double> stiffness, std::vector<double> damping,
                                         std::vector<ModalContact> contacts,
                                         std::vector<ModalDrive> drives,
                                         const ModalStepperOptions& options)
    : response_(std::move(stiffness), std::move(damping), options.interval),
      contacts_(std::move(contacts)),
      drives_(std::move(drives)),
      options_(options),
      n_(response_.modes()) {
  std::string faults;
  const auto fault = [&](const std::string& text) { faults += "\n  " + text; };
  if (!(options.tolerance > 0.0 && options.tolerance <= 0.1)) {
    fault(format("tolerance = %.6g, must be in (0, 0.1]", options.tolerance));
  }
  if (!(std::isfinite(options.force_scale) && options.force_scale > 0.0)) {
    fault(format("force_scale = %.6g N, must be > 0", options.force_scale));
  }
  if (options.deepest < 1 || options.deepest > 30) {
    fault(format("deepest = %d, must be 1 to 30", options.deepest));
  }
  for (std::size_t c = 0; c < contacts_.size(); ++c) {
    if (contacts_[c].gradient.size() != n_) {
      fault(format("contact %zu: gradient has %zu values, expected one a mode (%zu)", c,
                   contacts_[c].gradient.size(), n_));
    }
    if (contacts_[c].force == nullptr) fault(format("contact %zu: no force is given", c));
    if (!std::isfinite(contacts_[c].offset)) fault(format("contact %zu: offset is not finite", c));
  }
  for (std::size_t d = 0; d < drives_.size(); ++d) {
    if (drives_[d].shape.size() != n_) {
      fault(format("drive %zu: shape has %zu values, expected one a mode (%zu)", d,
                   drives_[d].shape.size(), n_));
    }
    if (!drives_[d].value) fault(format("drive %zu: no value is given", d));
    if (!(drives_[d].largest > 0.0)) {
      fault(format("drive %zu: largest = %.6g, must be > 0", d, drives_[d].largest));
    }
  }
  if (!faults.empty()) throw InvalidParameter("modal stepper:" + faults);
  tables_.resize(static_cast<std::size_t>(options.deepest) + 1);
  for (std::size_t i = 0; i < n_; ++i) {
    if (response_.stiffness()[i] == 0.0) rigid_.push_back(i);
  }
  x_.assign(n_, 0.0);
  v_.assign(n_, 0.0);
  const std::size_t c = contacts_.size();
  now_.resize(c);
  middle_.resize(c);
  end_.resize(c);
  past_.resize(c);
  peak_.resize(c);
  reach_.resize(c);
  known_.resize(4 * c);
  trial_.resize(2 * c);
  matrix_.resize(4 * c * c);
  right_.resize(2 * c);
  for (auto* u : {&drive_now_, &drive_middle_, &drive_end_}) u->resize(drives_.size());
}

void ModalContactStepper::start(double t, std::span<const double> position,
                                std::span<const double> velocity) {
  if (position.size() != n_ || velocity.size() != n_) {
    throw InvalidParameter(
        format("modal stepper: got %zu positions and %zu velocities, expected "
               "%zu",
               position.size(), velocity.size(), n_));
  }
  std::copy(position.begin(), position.end(), x_.begin());
  std::copy(velocity.begin(), velocity.end(), v_.begin());
  start_ = t;
  intervals_ = 0;
  past_step_ = 0.0;
  reach_known_ = false;
  level_ = std::min(3, options_.deepest);
  events_.clear();
  for (std::size_t d = 0; d < drives_.size(); ++d) drive_now_[d] = drives_[d].value(t);
  for (std::size_t c = 0; c < contacts_.size(); ++c) {
    now_[c].compression = compression(c);
    now_[c].rate = rate(c);
    now_[c].force = contacts_[c].force->trial(0, 0.0, now_[c].compression, now_[c].rate).force;
    peak_[c] = {now_[c].force, t};
  }
}

double ModalContactStepper::clock(long tick) const {
  const double part = std::ldexp(static_cast<double>(tick), -options_.deepest);
  return start_ + (static_cast<double>(intervals_) + part) * options_.interval;
}

double ModalContactStepper::time() const { return clock(0); }

double ModalContactStepper::compression(std::size_t contact) const {
  const ModalContact& c = contacts_[contact];
  return c.offset + sum_products(n_, c.gradient.data(), x_.data());
}

double ModalContactStepper::rate(std::size_t contact) const {
  return sum_products(n_, contacts_[contact].gradient.data(), v_.data());
}

const ModalContactStepper::Table& ModalContactStepper::table(int level) {
  Table& t = tables_[static_cast<std::size_t>(level)];
  if (t.ready) return t;
  const StepResponse& whole = response_.at(level);
  const StepResponse& half = response_.at(level + 1);
  t.weights = response_.weights(whole);
  const StepWeights& w = t.weights;
  const double a = 1.0 / whole.step;
  const double b = 2.0 / (whole.step * whole.step);
  const auto& k = response_.stiffness();
  const auto& d = response_.damping();
  const std::size_t contacts = contacts_.size();
  const std::size_t channels = contacts + drives_.size();
  t.rows.resize(8 * n_ * contacts);
  t.answer.assign(12 * contacts * channels, 0.0);
  std::vector<double> by(12 * n_);
  for (std::size_t i = 0; i < n_; ++i) {
    // The parabola through start, middle and end of the whole step, over its first half.
    const double p1 = a * half.second[i];
    const double p2 = b * half.third[i];
    const double q1 = a * half.first[i];
    const double q2 = b * half.second[i];
    by[i] = half.first[i] - 3.0 * p1 + 2.0 * p2;
    by[n_ + i] = 4.0 * (p1 - p2);
    by[2 * n_ + i] = 2.0 * p2 - p1;
    by[3 * n_ + i] = half.impulse[i] - 3.0 * q1 + 2.0 * q2;
    by[4 * n_ + i] = 4.0 * (q1 - q2);
    by[5 * n_ + i] = 2.0 * q2 - q1;
  }
  std::copy(w.x0.begin(), w.x0.end(), by.begin() + static_cast<std::ptrdiff_t>(6 * n_));
  std::copy(w.xm.begin(), w.xm.end(), by.begin() + static_cast<std::ptrdiff_t>(7 * n_));
  std::copy(w.x1.begin(), w.x1.end(), by.begin() + static_cast<std::ptrdiff_t>(8 * n_));
  std::copy(w.v0.begin(), w.v0.end(), by.begin() + static_cast<std::ptrdiff_t>(9 * n_));
  std::copy(w.vm.begin(), w.vm.end(), by.begin() + static_cast<std::ptrdiff_t>(10 * n_));
  std::copy(w.v1.begin(), w.v1.end(), by.begin() + static_cast<std::ptrdiff_t>(11 * n_));
  std::vector<double> product(n_);
  for (std::size_t c = 0; c < contacts; ++c) {
    const auto& s = contacts_[c].gradient;
    double* row = t.rows.data() + 8 * n_ * c;
    for (std::size_t i = 0; i < n_; ++i) {
      row[i] = s[i] * (half.slope[i] + d[i] * half.impulse[i]);
      row[n_ + i] = s[i] * half.impulse[i];
      row[2 * n_ + i] = -s[i] * k[i] * half.impulse[i];
      row[3 * n_ + i] = s[i] * half.slope[i];
      row[4 * n_ + i] = s[i] * w.xx[i];
      row[5 * n_ + i] = s[i] * w.xv[i];
      row[6 * n_ + i] = s[i] * w.vx[i];
      row[7 * n_ + i] = s[i] * w.vv[i];
    }
    for (std::size_t o = 0; o < channels; ++o) {
      const auto& shape = o < contacts ? contacts_[o].gradient : drives_[o - contacts].shape;
      const double sign = o < contacts ? -1.0 : 1.0;
      for (std::size_t i = 0; i < n_; ++i) product[i] = sign * s[i] * shape[i];
      double* answer = t.answer.data() + 12 * (c * channels + o);
      for (std::size_t q = 0; q < 12; ++q) {
        answer[q] = sum_products(n_, product.data(), by.data() + q * n_);
      }
    }
  }
  t.ready = true;
  return t;
}

bool ModalContactStepper::cross_freely() {
  if (!drives_.empty()) return false;
  for (const Point& p : now_) {
    if (p.force != 0.0 || p.compression >= 0.0) return false;
  }
  const auto& k = response_.stiffness();
  if (!reach_known_) {
    for (std::size_t c = 0; c < contacts_.size(); ++c) {
      reach_[c] = reach(n_, contacts_[c].gradient.data(), k.data(), x_.data(), v_.data());
    }
    reach_known_ = true;
  }
  const StepWeights& w = table(0).weights;
  // Modes without stiffness move one way only; the others stay within their reach.
  for (std::size_t c = 0; c < contacts_.size(); ++c) {
    double now = contacts_[c].offset + reach_[c];
    double then = now;
    for (const std::size_t i : rigid_) {
      now += contacts_[c].gradient[i] * x_[i];
      then += contacts_[c].gradient[i] * (x_[i] + w.xv[i] * v_[i]);
    }
    if (now >= 0.0 || then >= 0.0) {
      reach_known_ = false;
      return false;
    }
  }
  rotate(n_, w.xx.data(), w.xv.data(), w.vx.data(), w.vv.data(), x_.data(), v_.data());
  past_step_ = 0.0;
  ++counts_.steps;
  ++counts_.free;
  return true;
}

/// Solves matrix_ x = right_ of n unknowns in place; false if it is singular.
bool ModalContactStepper::solve(std::size_t n) {
  for (std::size_t k = 0; k < n; ++k) {
    std::size_t pivot = k;
    for (std::size_t i = k + 1; i < n; ++i) {
      if (std::fabs(matrix_[i * n + k]) > std::fabs(matrix_[pivot * n + k])) pivot = i;
    }
    if (!(std::fabs(matrix_[pivot * n + k]) > 0.0)) return false;
    if (pivot != k) {
      for (std::size_t j = k; j < n; ++j) std::swap(matrix_[k * n + j], matrix_[pivot * n + j]);
      std::swap(right_[k], right_[pivot]);
    }
    for (std::size_t i = k + 1; i < n; ++i) {
      const double f = matrix_[i * n + k] / matrix_[k * n + k];
      if (f == 0.0) continue;
      for (std::size_t j = k + 1; j < n; ++j) matrix_[i * n + j] -= f * matrix_[k * n + j];
      right_[i] -= f * right_[k];
    }
  }
  for (std::size_t k = n; k-- > 0;) {
    for (std::size_t j = k + 1; j < n; ++j) right_[k] -= matrix_[k * n + j] * right_[j];
    right_[k] /= matrix_[k * n + k];
  }
  return true;
}

/// Newton's method on the forces at the middle and the end, from the values in trial_. What the
/// past of the step gives is in known_.
bool ModalContactStepper::find_forces(const Table& t, double h, double limit) {
  const std::size_t contacts = contacts_.size();
  const std::size_t channels = contacts + drives_.size();
  const std::size_t n = 2 * contacts;
  const auto place = [&](std::size_t c) {
    const double* own = known_.data() + 4 * c;
    Point& m = middle_[c];
    Point& e = end_[c];
    m.compression = own[0];
    m.rate = own[1];
    e.compression = own[2];
    e.rate = own[3];
    for (std::size_t o = 0; o < contacts; ++o) {
      const double* a = t.answer.data() + 12 * (c * channels + o);
      const double fm = trial_[2 * o];
      const double f1 = trial_[2 * o + 1];
      m.compression += a[1] * fm + a[2] * f1;
      m.rate += a[4] * fm + a[5] * f1;
      e.compression += a[7] * fm + a[8] * f1;
      e.rate += a[10] * fm + a[11] * f1;
    }
  };
  double before = 1e300;
  for (int iteration = 0; iteration < 12; ++iteration) {
    for (std::size_t c = 0; c < contacts; ++c) {
      place(c);
      ScalarForce& law = *contacts_[c].force;
      const auto m = law.trial(0, 0.5 * h, middle_[c].compression, middle_[c].rate);
      const auto e = law.trial(1, 0.5 * h, end_[c].compression, end_[c].rate);
      counts_.forces += 2;
      middle_[c].d_rate = m.d_rate;
      end_[c].d_rate = e.d_rate;
      right_[2 * c] = m.force - trial_[2 * c];
      right_[2 * c + 1] = e.force - trial_[2 * c + 1];
      for (std::size_t o = 0; o < contacts; ++o) {
        const double* a = t.answer.data() + 12 * (c * channels + o);
        for (std::size_t s = 0; s < 2; ++s) {
          const double own = o == c ? 1.0 : 0.0;
          matrix_[(2 * c) * n + 2 * o + s] =
              (s == 0 ? own : 0.0) - m.d_compression * a[1 + s] - m.d_rate * a[4 + s];
          matrix_[(2 * c + 1) * n + 2 * o + s] =
              (s == 1 ? own : 0.0) - e.d_compression * a[7 + s] - e.d_rate * a[10 + s];
        }
      }
    }
    if (!solve(n)) return false;
    double largest = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
      trial_[i] += right_[i];
      largest = std::max(largest, std::fabs(right_[i]));
    }
    if (!std::isfinite(largest)) return false;
    // Quadratic convergence: what is left after a small change is its square.
    if (largest <= limit) {
      for (std::size_t c = 0; c < contacts; ++c) {
        place(c);
        middle_[c].force = trial_[2 * c];
        end_[c].force = trial_[2 * c + 1];
      }
      return true;
    }
    if (iteration > 3 && largest > 0.5 * before) return false;
    before = largest;
  }
  return false;
}

bool ModalContactStepper::step(int level, long tick, double& error) {
  const Table& t = table(level);
  const double h = response_.step(level);
  const std::size_t contacts = contacts_.size();
  const std::size_t channels = contacts + drives_.size();
  const double begin = clock(tick);
  error = 0.0;
  for (std::size_t d = 0; d < drives_.size(); ++d) {
    const auto& value = drives_[d].value;
    drive_middle_[d] = value(begin + 0.5 * h);
    drive_end_[d] = value(begin + h);
    const double parabola = 0.375 * drive_now_[d] + 0.75 * drive_middle_[d] - 0.125 * drive_end_[d];
    const double off = std::fabs(value(begin + 0.25 * h) - parabola);
    error = std::max(error, off / (options_.tolerance * drives_[d].largest));
  }
  if (error > 1.0) return false;
  bool open = true;
  for (std::size_t c = 0; c < contacts; ++c) {
    const FourSums free = sense(n_, t.rows.data() + 8 * n_ * c, x_.data(), v_.data());
    double* own = known_.data() + 4 * c;
    own[0] = contacts_[c].offset + free.sum[0];
    own[1] = free.sum[1];
    own[2] = contacts_[c].offset + free.sum[2];
    own[3] = free.sum[3];
    for (std::size_t o = 0; o < channels; ++o) {
      const double* a = t.answer.data() + 12 * (c * channels + o);
      const bool drive = o >= contacts;
      const double f0 = drive ? drive_now_[o - contacts] : now_[o].force;
      const double fm = drive ? drive_middle_[o - contacts] : 0.0;
      const double f1 = drive ? drive_end_[o - contacts] : 0.0;
      for (std::size_t q = 0; q < 4; ++q) {
        own[q] += a[3 * q] * f0 + a[3 * q + 1] * fm + a[3 * q + 2] * f1;
      }
    }
    open = open && now_[c].force == 0.0 && now_[c].compression <= 0.0 && own[0] <= 0.0 &&
           own[2] <= 0.0 && !rises(now_[c].compression, own[0], now_[c].rate, own[1], 0.5 * h) &&
           !rises(own[0], own[2], own[1], own[3], 0.5 * h);
  }
  if (open) {
    for (std::size_t c = 0; c < contacts; ++c) {
      const double* own = known_.data() + 4 * c;
      // An open contact's memory goes on too.
      contacts_[c].force->trial(0, 0.5 * h, own[0], own[1]);
      contacts_[c].force->trial(1, 0.5 * h, own[2], own[3]);
      middle_[c] = {0.0, own[0], own[1]};
      end_[c] = {0.0, own[2], own[3]};
    }
    return true;
  }
  double smallest_scale = 1e300;
  for (std::size_t c = 0; c < contacts; ++c) {
    const double f = now_[c].force;
    double fm = f;
    double f1 = f;
    if (past_step_ > 0.0) {
      // The parabola of the step before, carried on.
      const double slope = (past_[c].start - 4.0 * past_[c].middle + 3.0 * f) / past_step_;
      const double bend =
          2.0 * (past_[c].start - 2.0 * past_[c].middle + f) / (past_step_ * past_step_);
      fm += 0.5 * h * (slope + 0.5 * h * bend);
      f1 += h * (slope + h * bend);
    }
    trial_[2 * c] = fm;
    trial_[2 * c + 1] = f1;
    smallest_scale = std::min(smallest_scale, std::max(options_.force_scale, peak_[c].force));
  }
  right_.assign(right_.size(), 0.0);
  const std::vector<double>::size_type n = 2 * contacts;
  double predicted[16];
  std::vector<double> many;
  double* guess = predicted;
  if (n > 16) {
    many.resize(n);
    guess = many.data();
  }
  std::copy(trial_.begin(), trial_.end(), guess);
  if (!find_forces(t, h, 1e-3 * options_.tolerance * smallest_scale)) {
    error = 1e300;
    return false;
  }
  const double gain =
      past_step_ > 0.0 ? kParabola * h * h / ((h + 0.5 * past_step_) * (h + past_step_)) : 0.125;
  for (std::size_t c = 0; c < contacts; ++c) {
    double off = 0.0;
    if (past_step_ > 0.0) {
      off = gain * std::fabs(end_[c].force - guess[2 * c + 1]);
    } else {
      off = gain * std::fabs(now_[c].force - 2.0 * middle_[c].force + end_[c].force);
    }
    // A law whose slope jumps where the rate changes its sign (loading, unloading) bends the force
    // within the step, and the past cannot predict it.
    if (now_[c].rate * end_[c].rate < 0.0 && h > kShortestKink * options_.interval) {
      off = std::max(off, kKink * std::fabs((end_[c].d_rate - now_[c].d_rate) *
                                            (end_[c].rate - now_[c].rate)));
    }
    const double scale = std::max({options_.force_scale, peak_[c].force, std::fabs(end_[c].force)});
    error = std::max(error, off / (options_.tolerance * scale));
  }
  return error <= 1.0;
}

/// Openings, closings and the largest force of the step just found.
void ModalContactStepper::record(std::size_t c, double begin, double h) {
  const Point* points[3] = {&now_[c], &middle_[c], &end_[c]};
  for (int half = 0; half < 2; ++half) {
    const Point& from = *points[half];
    const Point& to = *points[half + 1];
    const double length = 0.5 * h;
    const double t = begin + half * length;
    if ((from.compression > 0.0) != (to.compression > 0.0)) {
      const auto at = [&](double u) {
        return hermite(from.compression, to.compression, from.rate, to.rate, length, u);
      };
      const double u = from.compression == 0.0 ? 0.0
                                               : find_root_bracketed(at, 0.0, from.compression, 1.0,
                                                                     to.compression, 1e-9);
      const double rate = from.rate + u * (to.rate - from.rate);
      events_.push_back({t + u * length, static_cast<int>(c), to.compression > 0.0 ? 1 : -1, rate});
    }
  }
  Peak& peak = peak_[c];
  const double f0 = points[0]->force;
  const double fm = points[1]->force;
  const double f1 = points[2]->force;
  if (fm > peak.force) peak = {fm, begin + 0.5 * h};
  if (f1 > peak.force) peak = {f1, begin + h};
  const double bend = f0 - 2.0 * fm + f1;
  if (bend < 0.0 && std::max({f0, fm, f1}) > 0.9 * peak.force) {
    const double shift = 0.5 * (f0 - f1) / bend;
    if (std::fabs(shift) <= 1.0) {
      const double top = fm - 0.25 * (f0 - f1) * shift;
      if (top > peak.force) peak = {top, begin + 0.5 * h * (1.0 + shift)};
    }
  }
}

void ModalContactStepper::advance() {
  const FlushToZero flush;
  if (cross_freely()) {
    ++intervals_;
    for (std::size_t c = 0; c < contacts_.size(); ++c) now_[c].force = 0.0;
    return;
  }
  if (reach_known_ || past_step_ == 0.0) {
    for (std::size_t c = 0; c < contacts_.size(); ++c) {
      now_[c].compression = compression(c);
      now_[c].rate = rate(c);
    }
  }
  reach_known_ = false;
  const long all = 1L << options_.deepest;
  long tick = 0;
  while (tick < all) {
    long length = 1L << (options_.deepest - level_);
    while (tick % length != 0) {
      length /= 2;
      ++level_;
    }
    double error = 0.0;
    if (!step(level_, tick, error)) {
      ++counts_.rejected;
      calm_ = 0;
      if (level_ == options_.deepest) {
        throw Error(format("modal stepper: the contact forces were not found at t = %.9g s with "
                           "the shortest step of %.3g s",
                           clock(tick), response_.step(level_)),
                    ErrorCode::kNotConverged);
      }
      ++level_;
      continue;
    }
    const double h = response_.step(level_);
    const double begin = clock(tick);
    const StepWeights& w = tables_[static_cast<std::size_t>(level_)].weights;
    const ForceWeights by{w.x0.data(), w.xm.data(), w.x1.data(),
                          w.v0.data(), w.vm.data(), w.v1.data()};
    rotate(n_, w.xx.data(), w.xv.data(), w.vx.data(), w.vv.data(), x_.data(), v_.data());
    for (std::size_t c = 0; c < contacts_.size(); ++c) {
      record(c, begin, h);
      const double f0 = now_[c].force;
      const double fm = middle_[c].force;
      const double f1 = end_[c].force;
      past_[c] = {fm, f0};
      now_[c] = end_[c];
      contacts_[c].force->accept();
      if (f0 == 0.0 && fm == 0.0 && f1 == 0.0) continue;
      push(n_, by, contacts_[c].gradient.data(), -f0, -fm, -f1, x_.data(), v_.data());
    }
    for (std::size_t d = 0; d < drives_.size(); ++d) {
      push(n_, by, drives_[d].shape.data(), drive_now_[d], drive_middle_[d], drive_end_[d],
           x_.data(), v_.data());
      drive_now_[d] = drive_end_[d];
    }
    past_step_ = h;
    ++counts_.steps;
    tick += length;
    // Twice the step makes eight times the error.
    calm_ = error < 1.0 / 16.0 ? calm_ + 1 : 0;
    if (calm_ >= 2 && level_ > 0 && tick % (2 * length) == 0) {
      --level_;
      calm_ = 0;
    }
  }
  ++intervals_;
}

}  // namespace feltmb::modal
