#include "variational.hpp"

#include <algorithm>
#include <cmath>

#include "feltmb/core/error.hpp"
#include "feltmb/core/flush_to_zero.hpp"

namespace feltmb::detail {
namespace {

// R. Alexander, SIAM J. Numer. Anal. 14 (1977) 1006: SDIRK of order three, L-stable, stiffly
// accurate; gamma is the root of x^3 - 3 x^2 + 3 x / 2 - 1 / 6 in (1/6, 1/2).
constexpr double kGamma = 0.43586652150845899942;
constexpr double kC[3] = {kGamma, 0.5 * (1.0 + kGamma), 1.0};
constexpr double kB1 = -0.25 * (6.0 * kGamma * kGamma - 16.0 * kGamma + 1.0);
constexpr double kB2 = 0.25 * (6.0 * kGamma * kGamma - 20.0 * kGamma + 5.0);
constexpr double kA21 = 0.5 * (1.0 - kGamma);
// Order two with the first two stages only, for the error.
constexpr double kE2 = (0.5 - kC[0]) / (kC[1] - kC[0]);
constexpr double kE1 = 1.0 - kE2;

// The error swings with the elastic modes: bolder steps are rejected, more than they save.
constexpr double kSafety = 0.8;
constexpr double kGrowth = 2.0;

/// Weights of the three slopes at the fraction u of a step: the quadratic through them, integrated.
void dense_weights(double u, double (&weight)[3]) {
  const Eigen::Matrix3d vandermonde{
      {1.0, 1.0, 1.0}, {kC[0], kC[1], kC[2]}, {kC[0] * kC[0], kC[1] * kC[1], kC[2] * kC[2]}};
  const Eigen::Vector3d moments{u, u * u / 2.0, u * u * u / 3.0};
  const Eigen::Vector3d w = vandermonde.inverse() * moments;
  for (int i = 0; i < 3; ++i) weight[i] = w[i];
}

/// Largest of `size` and the weighted row, by column.
void grow(std::size_t n, double weight, const double* __restrict row, double* __restrict size) {
  for (std::size_t i = 0; i < n; ++i) {
    const double own = weight * std::fabs(row[i]);
    size[i] = own > size[i] ? own : size[i];
  }
}

}  // namespace

Variational::Variational(ShiftedModels& models, Trajectory& trajectory, double tolerance)
    : models_(models), trajectory_(trajectory), tolerance_(tolerance) {
  if (models.modes() > 0) free_.emplace(models);
  const auto states = static_cast<Eigen::Index>(models.base().size());
  const auto count = static_cast<Eigen::Index>(models.columns());
  const auto contacts = static_cast<Eigen::Index>(models.base().mechanism().contacts.size());
  columns_.state.setZero(states, count);
  columns_.memory.setZero(contacts, count);
  dense_ = columns_;
  largest_.setZero(count);
  floor_.setZero(count);
  for (Eigen::Index j = 0; j < count; ++j) floor_[j] = models.floor(static_cast<std::size_t>(j));
  y_.resize(models.base().size());
  start_.resize(y_.size());
  blends_ = models.base().law_states() == 0 && !is_prescribed(models.base().drive(0.0).kind);
}

bool Variational::touched(double t) {
  trajectory_.interpolate_all(t, y_);
  MechanismSystem& probe = models_.probe();
  probe.locate(t, y_);
  for (const auto& c : models_.mechanism().string_contacts) {
    if (probe.dynamics().contacts()[static_cast<std::size_t>(c.contact)].closed) return true;
  }
  return false;
}

/// Adds factor f shift^T to the rows that are integrated, f the rate of the state at t. Outside of
/// [from, to], where a law may be on the other branch, f goes straight on.
void Variational::add_motion(double t, double from, double to, double factor, RowMatrix& columns) {
  if (shift_.size() == 0) return;
  motion_.resize(static_cast<Eigen::Index>(y_.size()));
  const auto add = [&](double time, double weight) {
    trajectory_.interpolate_all(time, y_);
    models_.probe().rhs(time, y_, {motion_.data(), y_.size()});
    columns.topRows(rows_).noalias() += weight * motion_.head(rows_) * shift_.transpose();
  };
  const double inside = std::clamp(t, from, to);
  add(inside, inside == t ? factor : 2.0 * factor);
  if (inside != t) add(2.0 * inside - t, -factor);
}

/// Adds what an input that changes does to f shift^T: its rate at a fixed state, at (t, y_).
void Variational::add_drift(double t, double from, double to, RowMatrix& rate) {
  MechanismSystem& probe = models_.probe();
  const double low = std::max(from, t - 1e-7);
  const double high = std::min(to, t + 1e-7);
  const Drive a = probe.drive(low);
  const Drive b = probe.drive(high);
  if (a.force == b.force && a.displacement == b.displacement && a.speed == b.speed &&
      a.acceleration == b.acceleration) {
    return;
  }
  motion_.resize(static_cast<Eigen::Index>(y_.size()));
  drift_.resize(motion_.size());
  probe.rhs(low, y_, {motion_.data(), y_.size()});
  probe.rhs(high, y_, {drift_.data(), y_.size()});
  drift_ = (drift_ - motion_) / (high - low);
  rate.noalias() += drift_.head(rows_) * shift_.transpose();
}

void Variational::look(Point& point, double t, double from, double to) {
  const std::size_t node = trajectory_.interpolate(t, y_);
  MechanismSystem& base = models_.base();
  const auto memory = trajectory_.memory(node);
  if (!memory.empty()) {
    std::copy(memory.begin(), memory.end(), base.dynamics().largest_compression().begin());
  }
  base.linearize(t, y_);
  ++counts_.linearizations;
  base.slopes(point.slopes);
  point.time = t;
  point.rate.resize(rows_, columns_.state.cols());
  models_.rates(t, y_, memory, columns_.memory, point.rate, point.loads);
  point.pieces = models_.pieces();
  if (shift_.size() > 0) add_drift(t, from, to, point.rate);
}

/// J and B of the second stage, at t, from those at the start of the step and of the other two
/// stages: between switches each number is a parabola of time. False if they can not tell it.
bool Variational::blend(double t, double h) {
  const Point& first = points_[0];
  const Point& last = points_[2];
  const auto alike = [&](const Point& other) {
    return other.pieces == last.pieces && other.slopes.size() == last.slopes.size() &&
           other.rate.rows() == last.rate.rows();
  };
  if (!alike(start_point_) || !alike(first) || first.time - start_point_.time < 0.1 * h ||
      last.time - first.time < 0.1 * h) {
    return false;
  }
  const auto weight = [&](const Point& own, const Point& one, const Point& two) {
    return (t - one.time) * (t - two.time) / ((own.time - one.time) * (own.time - two.time));
  };
  const double a = weight(start_point_, first, last);
  const double b = weight(first, start_point_, last);
  const double c = weight(last, start_point_, first);
  Point& out = points_[1];
  out.slopes.resize(last.slopes.size());
  for (std::size_t k = 0; k < out.slopes.size(); ++k) {
    out.slopes[k] = a * start_point_.slopes[k] + b * first.slopes[k] + c * last.slopes[k];
  }
  out.rate = a * start_point_.rate + b * first.rate + c * last.rate;
  out.loads = a * start_point_.loads + b * first.loads + c * last.loads;
  return true;
}

void Variational::stage(int i, double h) {
  MechanismSystem& base = models_.base();
  if (!base.factorize(kGamma * h)) {
    throw Error(
        format("sensitivities: the Newton matrix is singular at t = %.9g s", time_ + kC[i] * h),
        ErrorCode::kNotConverged);
  }
  ++counts_.factorizations;
  // (I - gamma h J) Z = U + gamma h B, k = (Z - U) / (gamma h).
  const double g = kGamma * h;
  RowMatrix& start = slope_[i];
  start = columns_.state.topRows(rows_);
  if (i == 1) start += (h * kA21) * slope_[0];
  if (i == 2) start += (h * kB1) * slope_[0] + (h * kB2) * slope_[1];
  stage_ = start + g * points_[i].rate;
  base.solve_many(stage_, &points_[i].loads);
  slope_[i] = (1.0 / g) * (stage_ - start);
}

template <class Rows>
void Variational::measure(const Rows& columns, Eigen::RowVectorXd& size) const {
  size.setZero(columns.cols());
  for (Eigen::Index i = 0; i < columns.rows(); ++i) {
    grow(static_cast<std::size_t>(columns.cols()), models_.weight()[i],
         columns.data() + i * columns.cols(), size.data());
  }
}

bool Variational::step(double h, double from, double to) {
  // Stages stay inside the stretch: at its ends a law may already be on the other branch.
  const auto place = [&](int i) { return std::clamp(time_ + kC[i] * h, from, to); };
  bool blended = false;
  if (blends_) {
    if (!has_start_point_) look(start_point_, std::max(time_, from), from, to);
    has_start_point_ = true;
    look(points_[0], place(0), from, to);
    look(points_[2], place(2), from, to);
    blended = blend(place(1), h);
  }
  for (int i = 0; i < 3; ++i) {
    if (blended) {
      models_.base().set_slopes(points_[i].slopes);
    } else {
      look(points_[i], place(i), from, to);
    }
    stage(i, h);
  }
  difference_ =
      (h * (kB1 - kE1)) * slope_[0] + (h * (kB2 - kE2)) * slope_[1] + (h * kGamma) * slope_[2];
  models_.base().solve_many(difference_);
  error_ = 0.0;
  measure(stage_, size_);
  measure(difference_, error_size_);
  for (Eigen::Index j = 0; j < size_.size(); ++j) {
    const double size = std::max({size_[j], present_[j], 1e-2 * largest_[j], floor_[j]});
    if (size > 0.0) error_ = std::max(error_, error_size_[j] / size);
  }
  return error_ <= tolerance_;
}

void Variational::forget(double from, double to) {
  if (columns_.memory.size() == 0) return;
  // Open felts with a recovery time forget exponentially.
  const auto& contacts = models_.base().mechanism().contacts;
  const auto before = trajectory_.memory(trajectory_.interval(from));
  const auto after = trajectory_.memory(trajectory_.interval(to));
  for (std::size_t c = 0; c < before.size(); ++c) {
    if (after[c] >= before[c] || before[c] <= 0.0) continue;
    const double time = contacts[c].law.recovery_time();
    if (time <= 0.0) continue;
    const auto row = static_cast<Eigen::Index>(c);
    const double ratio = after[c] / before[c];
    columns_.memory.row(row) *= ratio;
    models_.add_recovery(c, after[c], -std::log(ratio) * time, time, columns_.memory);
  }
}

void Variational::advance(double end, const std::vector<double>& times, std::size_t& next,
                          const Sample& sample) {
  // Models with a shifted input pass its breakpoints up to 0.2 ns earlier or later.
  const double inside = std::min(1e-9, 0.1 * (end - time_));
  const double from = time_ + inside;
  const double to = end - inside;
  if (h_ <= 0.0) h_ = end - time_;
  // Between two switches a string is touched all the time or never.
  const bool apart = free_ && !touched(0.5 * (time_ + end));
  rows_ = static_cast<Eigen::Index>(apart ? models_.first_mode() : y_.size());
  const double begin = time_;
  add_motion(begin, from, to, 1.0, columns_.state);
  measure(columns_.state.topRows(rows_), present_);  // a switch may have changed them
  if (apart) trajectory_.interpolate_all(begin, start_);
  const FlushToZero flush;
  while (time_ < end) {
    double h = std::min(h_, end - time_);
    const bool last = end - time_ <= h * (1.0 + 1e-12);
    constexpr double least = 1e-13;  // s
    const bool good = step(h, from, to);
    const double factor =
        error_ > 0.0 ? std::clamp(kSafety * std::cbrt(tolerance_ / error_), 0.2, kGrowth) : kGrowth;
    if (!good && h > least) {
      ++counts_.rejected;
      h_ = h * factor;
      continue;
    }
    ++counts_.steps;
    const double reached = last ? end : time_ + h;
    while (next < times.size() && times[next] <= reached) {
      double weight[3];
      dense_weights(std::clamp((times[next] - time_) / h, 0.0, 1.0), weight);
      dense_.state = columns_.state;
      dense_.state.topRows(rows_) +=
          h * (weight[0] * slope_[0] + weight[1] * slope_[1] + weight[2] * slope_[2]);
      add_motion(times[next], from, to, -1.0, dense_.state);
      if (apart) free_->move(times[next] - begin, start_, dense_.state);
      dense_.memory = columns_.memory;
      sample(times[next], dense_);
      ++next;
    }
    forget(time_, reached);
    columns_.state.topRows(rows_) = stage_;
    present_ = size_;
    std::swap(start_point_, points_[2]);
    largest_ = largest_.cwiseMax(size_);
    // A step cut short by the end says nothing about the next.
    if (!last || factor < 1.0) h_ = h * factor;
    time_ = reached;
  }
  add_motion(end, from, to, -1.0, columns_.state);
  if (apart) free_->move(end - begin, start_, columns_.state);
}

}  // namespace feltmb::detail
