#include "looks.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "feltmb/core/index.hpp"
#include "feltmb/numeric/bracketing.hpp"

namespace feltmb::detail {
namespace {

constexpr double kBeside = 2e-9;    // s, from a switch: a stage is never nearer than half of it
constexpr double kTogether = 1e-8;  // s: nearer switches are one
constexpr double kAround = 1e-6;    // s, from an extremum

}  // namespace

Looks::Looks(Trajectory& trajectory, ShiftedModels& models, const Channels& channels,
             const std::vector<Switch>& switches)
    : trajectory_(trajectory), models_(models), channels_(channels) {
  y_.resize(models.base().size());
  scratch_.resize(channels.size());
  double begin = 0.0;
  double last = 0.0;
  for (const Switch& s : switches) {
    // The end is the last switch.
    if (s.time - last > kTogether || s.kind == SwitchKind::kEnd) {
      if (s.kind == SwitchKind::kEnd && s.time - last <= kTogether && !pieces_.empty()) {
        pieces_.back().end = s.time;
        return;
      }
      pieces_.push_back({begin, s.time});
    }
    begin = last = s.time;
  }
}

void Looks::evaluate(const Sought& s, MechanismSystem& system, double t, std::span<const double> y,
                     std::span<double> out) {
  if (s.contact < 0) {
    if (channels_.rows()[as_index(s.look.output)].place) {
      channels_.observe_places(system, y, scratch_);
    } else {
      channels_.observe(system, t, y, scratch_);
    }
    out[0] = scratch_[as_index(s.look.output)];
    return;
  }
  system.locate(t, y, Detail::kAllContacts);
  const auto contact = as_index(s.contact);
  const ContactState& state = system.dynamics().contacts()[contact];
  out[0] = system.mechanism()
               .contacts[contact]
               .law.evaluate(state.compression, state.rate, system.dynamics().memory(contact))
               .force;
}

double Looks::value(const Sought& s, double t) {
  trajectory_.interpolate_all(t, y_);
  double out = 0.0;
  evaluate(s, models_.probe(), t, y_, {&out, 1});
  return out;
}

Looks::Piece Looks::piece(double t) const {
  for (const Piece& p : pieces_) {
    if (t <= p.end) return {std::min(p.begin, t), p.end};
  }
  return pieces_.back();
}

double Looks::rate(const Sought& s, double t) {
  const auto [begin, end] = piece(t);
  const double step = std::min(1e-7, 0.1 * (end - begin));
  const double low = begin > 0.0 ? begin + 0.5 * kBeside : begin;
  const double high = end - 0.5 * kBeside;
  if (t - step >= low && t + step <= high) {
    return (value(s, t + step) - value(s, t - step)) / (2.0 * step);
  }
  const double way = t - step < low ? step : -step;
  return (-1.5 * value(s, t) + 2.0 * value(s, t + way) - 0.5 * value(s, t + 2.0 * way)) / way;
}

void Looks::add_side(Sought& s, double t) {
  Side side;
  side.time = t;
  side.rate = rate(s, t);
  s.sides.push_back(std::move(side));
}

void Looks::add(const SensitivityRequest& look, int contact) {
  Sought s;
  s.look = look;
  s.contact = contact;
  const double last = trajectory_.time(trajectory_.size() - 1);
  s.look.begin = std::clamp(look.begin, 0.0, last);
  s.look.end = std::clamp(look.end, s.look.begin, last);
  if (look.sign == 0) {
    const double t = s.look.begin;
    s.out.time = t;
    s.out.value = value(s, t);
    s.out.edge = -1;
    add_side(s, t > 10.0 * kBeside ? t - kBeside : t);
  } else {
    locate(s);
  }
  sought_.push_back(std::move(s));
}

/// The extremum between two times, which are apart from switches or ends of the look.
Looks::Found Looks::refine(const Sought& s, double low, double high) {
  const auto beside = [](const Piece& p) {
    return std::clamp(0.25 * (p.end - p.begin), kBeside, kAround);
  };
  const double sign = s.look.sign;
  Found best;
  best.value = -std::numeric_limits<double>::infinity();
  const auto offer = [&](double t, double before, double after, double jump = 0.0) {
    const double v = sign * value(s, t);
    if (v > best.value) best = {t, v, before, after, jump};
  };
  if (low == s.look.begin) offer(low, low, low);
  if (high == s.look.end) offer(high, high, high);
  for (std::size_t i = 0; i < pieces_.size(); ++i) {
    const Piece& p = pieces_[i];
    if (p.end <= low || p.begin >= high) continue;
    const double a = std::max(low, p.begin + (p.begin > 0.0 ? kBeside : 0.0));
    const double b = std::min(high, p.end - kBeside);
    if (p.end < high && i + 1 < pieces_.size()) {
      const Piece& next = pieces_[i + 1];
      const double jump = value(s, next.begin + kBeside) - value(s, p.end - kBeside);
      // Straight lines meet at a kink; if only the curvature jumps, they need some distance.
      double one = p.end - kBeside;
      double two = next.begin + kBeside;
      const double turn = rate(s, two) - rate(s, one);
      const double low_end = p.end - beside(p);
      const double high_end = next.begin + beside(next);
      if (std::fabs(turn) < 0.5 * std::fabs(rate(s, high_end) - rate(s, low_end))) {
        one = low_end;
        two = high_end;
      }
      offer(p.end, one, two, std::fabs(jump));
    }
    if (b - a < 4.0 * kBeside) continue;
    const double ra = sign * rate(s, a);
    const double rb = sign * rate(s, b);
    if (!(ra > 0.0 && rb < 0.0)) continue;
    const double t =
        find_root_bracketed([&](double x) { return sign * rate(s, x); }, a, ra, b, rb, 1e-12);
    const double room = 0.5 * std::min(t - p.begin, p.end - t) - kBeside;
    const double around = std::clamp(room, 0.1 * kBeside, kAround);
    offer(t, t - around, t + around);
  }
  if (!std::isfinite(best.value)) {
    const double t = 0.5 * (low + high);
    offer(t, t, t);
  }
  return best;
}

void Looks::locate(Sought& s) {
  const double sign = s.look.sign;
  std::vector<double> times{s.look.begin};
  for (std::size_t node = 0; node < trajectory_.size(); ++node) {
    const double t = trajectory_.time(node);
    if (t > times.back() && t < s.look.end) times.push_back(t);
  }
  if (s.look.end > s.look.begin) times.push_back(s.look.end);
  std::vector<double> values;
  for (const double t : times) values.push_back(sign * value(s, t));
  const std::size_t last = values.size() - 1;
  std::vector<std::size_t> tops;
  for (std::size_t i = 0; i <= last; ++i) {
    if ((i == 0 || values[i] > values[i - 1]) && (i == last || values[i] >= values[i + 1])) {
      tops.push_back(i);
    }
  }
  std::stable_sort(tops.begin(), tops.end(),
                   [&](std::size_t a, std::size_t b) { return values[a] > values[b]; });
  constexpr std::size_t most = 6;  // between two steps, a lower top may still be the highest
  if (tops.size() > most) tops.resize(most);
  std::vector<Found> found;
  for (const std::size_t i : tops) {
    found.push_back(refine(s, times[i == 0 ? 0 : i - 1], times[std::min(i + 1, last)]));
  }
  std::stable_sort(found.begin(), found.end(),
                   [](const Found& a, const Found& b) { return a.value > b.value; });
  const Found& top = found[0];
  s.out.time = top.time;
  s.out.value = sign * top.value;
  const double range = top.value - *std::min_element(values.begin(), values.end());
  for (std::size_t i = 1; i < found.size(); ++i) {
    const double behind = top.value - found[i].value;
    // Equal but for rounding: the quantity rests, and its derivative is the same at both times.
    if (behind > 1e-10 * range && behind < 1e-7 * range && found[i].time != top.time) {
      s.out.reason = "two extrema are equal to seven digits";
    }
  }
  if (top.before == top.after) {
    const bool inside = top.time > s.look.begin && top.time < s.look.end;
    s.out.edge = inside ? 0 : top.time == s.look.begin ? -1 : 1;
    add_side(s, top.time);
    return;
  }
  if (top.jump > 1e-3 * range) {
    s.out.reason = "the output jumps at its extremum";
  }
  add_side(s, top.before);
  add_side(s, top.after);
}

std::vector<double> Looks::times() const {
  std::vector<double> out;
  for (const Sought& s : sought_) {
    for (const Side& side : s.sides) out.push_back(side.time);
  }
  std::sort(out.begin(), out.end());
  out.erase(std::unique(out.begin(), out.end()), out.end());
  return out;
}

void Looks::take(double t, const Columns& columns, const Eigen::VectorXd& shift, long version) {
  Columns shifted;
  for (Sought& s : sought_) {
    for (Side& side : s.sides) {
      if (side.time != t) continue;
      const auto memory = trajectory_.memory(trajectory_.interpolate_all(t, y_));
      if (shift.size() > 0 && shifted.state.size() == 0) {
        shifted = columns;
        slope_.resize(static_cast<Eigen::Index>(y_.size()));
        models_.probe().rhs(t, y_, {slope_.data(), y_.size()});
        shifted.state.noalias() += slope_ * shift.transpose();
      }
      const auto function = [&](MechanismSystem& system, double time, std::span<const double> y,
                                std::span<double> out, int,
                                std::size_t) { evaluate(s, system, time, y, out); };
      models_.total(t, y_, memory, shift.size() > 0 ? shifted : columns, 1, function, derivative_);
      side.derivative = derivative_.row(0).transpose();
      side.shift = shift;
      side.version = version;
    }
  }
}

std::vector<SensitivityValue> Looks::finish() {
  std::vector<SensitivityValue> out;
  const auto count = static_cast<Eigen::Index>(models_.columns());
  const Eigen::VectorXd unknown = Eigen::VectorXd::Constant(count, std::nan(""));
  for (Sought& s : sought_) {
    SensitivityValue& o = s.out;
    const bool together = s.sides.size() == 2 && s.sides[0].version == s.sides[1].version;
    Eigen::VectorXd shift = Eigen::VectorXd::Zero(count);
    for (Side& side : s.sides) {
      if (side.derivative.size() == 0) side.derivative = unknown;
      if (side.shift.size() == 0) continue;
      if (together) {
        shift = side.shift;
      } else {
        side.derivative -= side.rate * side.shift;
      }
    }
    const Side& one = s.sides.front();
    const Side& two = s.sides.back();
    const double turn = two.rate - one.rate;
    if (s.sides.size() == 1) {
      o.derivative = one.derivative;
      o.rate = o.edge == 0 ? 0.0 : one.rate;
      o.time_derivative = o.edge == 0 ? unknown : Eigen::VectorXd(Eigen::VectorXd::Zero(count));
    } else if (turn == 0.0) {
      o.derivative = 0.5 * (one.derivative + two.derivative);
      o.time_derivative = unknown;
    } else {
      const double share = std::clamp(two.rate / turn, 0.0, 1.0);  // 1: the rate before is zero
      o.derivative = share * one.derivative + (1.0 - share) * two.derivative;
      o.time_derivative = shift - (two.derivative - one.derivative) / turn;
    }
    if (!o.reason.empty()) o.derivative = o.time_derivative = unknown;
    out.push_back(std::move(o));
  }
  return out;
}

}  // namespace feltmb::detail
