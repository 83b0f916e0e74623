#include "switches.hpp"

#include <algorithm>
#include <cmath>

#include "feltmb/contact/friction.hpp"
#include "feltmb/numeric/bracketing.hpp"

namespace feltmb::detail {
namespace {

constexpr double kWidth = 1e-14;  // s, of a located switch
constexpr double kAtRest = 1e-7;  // m/s: below it a contact is at rest, its rate is rounding

/// Zone of a sliding speed: regularised friction turns within a few threshold speeds, too fast for
/// the error control of a step that looks at three places. Steps end where the zone changes.
int zone(double speed, double threshold) {
  const double x = std::fabs(speed) / threshold;
  const int z = x < 0.6 ? 0 : x < 2.5 ? 1 : 2;
  return speed < 0.0 ? -z : z;
}

/// Looks at the contacts, straps and monitored points along a trajectory.
class Finder {
 public:
  Finder(Trajectory& trajectory, ShiftedModels& models, const SensitivityOptions& options,
         const InputSignal& input)
      : trajectory_(trajectory),
        models_(models),
        options_(options),
        probe_(models.probe()),
        mechanism_(probe_.mechanism()) {
    for (const Contact& c : mechanism_.contacts) {
      active_.push_back(c.finger ? input.kind == InputKind::kMotion : c.enabled);
    }
    y_.resize(probe_.size());
    for (Look* look : {&before_, &after_, &trial_}) {
      look->root.resize(mechanism_.contacts.size() + options.rules.size());
      look->piece.resize(mechanism_.contacts.size() + mechanism_.straps.size());
      look->zone.resize(mechanism_.contacts.size() + mechanism_.coordinates.size());
      look->rate.resize(mechanism_.contacts.size());
    }
  }

  void scan(std::vector<Switch>& out) {
    for (std::size_t node = 0; node < trajectory_.size(); ++node) {
      std::swap(before_, after_);
      const auto state = trajectory_.state(node);
      const auto memory = trajectory_.memory(node);
      std::copy(memory.begin(), memory.end(), probe_.dynamics().largest_compression().begin());
      look_at_state(trajectory_.time(node), state, after_);
      if (node == 0) continue;
      const double a = trajectory_.time(node - 1);
      const double b = trajectory_.time(node);
      for (std::size_t i = 0; i < after_.root.size(); ++i) find_root(i, a, b, out);
      for (std::size_t i = 0; i < after_.piece.size(); ++i) find_change(i, a, b, out);
      for (std::size_t i = 0; i < after_.zone.size(); ++i) find_zones(i, a, b, out);
    }
  }

 private:
  struct Look {
    std::vector<double> root;  ///< compressions, then heights of monitored points
    std::vector<int> piece;    ///< of each law, then whether a strap is taut
    std::vector<double> rate;
    std::vector<int> zone;  ///< of the sliding speed of each contact, then of each joint
  };

  void look_at(double t, Look& out) {
    trajectory_.interpolate_all(t, y_);
    look_at_state(t, y_, out);
  }

  /// Looks at entry i of root or piece (both begin with the contacts) alone.
  void look_at_one(double t, std::size_t i, Look& out) {
    if (i >= mechanism_.contacts.size()) return look_at(t, out);
    if (mechanism_.contacts[i].string_contact >= 0) {
      trajectory_.interpolate_all(t, y_);
    } else {
      trajectory_.interpolate(t, y_);
    }
    probe_.locate_only(t, y_, {&i, 1});
    look_at_contact(i, out);
  }

  /// The same for an entry of zone: contacts, then joints.
  void look_at_zone(double t, std::size_t i, Look& out) {
    const std::size_t contacts = mechanism_.contacts.size();
    if (i < contacts) return look_at_one(t, i, out);
    trajectory_.interpolate(t, y_);
    look_at_joint(i - contacts, y_, out);
  }

  void look_at_joint(std::size_t k, std::span<const double> y, Look& out) const {
    const Friction& friction = mechanism_.joint_friction[k];
    const double speed = y[mechanism_.coordinates.size() + k];
    out.zone[mechanism_.contacts.size() + k] =
        friction.turns_over() ? zone(speed, friction.threshold_speed) : 0;
  }

  void look_at_contact(std::size_t c, Look& out) const {
    const Dynamics& dynamics = probe_.dynamics();
    const ContactState& s = dynamics.contacts()[c];
    out.root[c] = active_[c] ? s.compression : -1.0;
    out.rate[c] = s.rate;
    out.piece[c] = 0;
    const Friction& friction = mechanism_.contacts[c].friction;
    const bool slides = active_[c] && s.compression > 0.0 && friction.turns_over();
    out.zone[c] = slides ? zone(s.slip, friction.threshold_speed) : 0;
    if (!active_[c]) return;
    out.piece[c] = piece_of(probe_, c);
  }

  void look_at_state(double t, std::span<const double> y, Look& out) {
    probe_.locate(t, y, Detail::kAllContacts);
    const Dynamics& dynamics = probe_.dynamics();
    const std::size_t contacts = mechanism_.contacts.size();
    for (std::size_t c = 0; c < contacts; ++c) look_at_contact(c, out);
    for (std::size_t k = 0; k < mechanism_.coordinates.size(); ++k) look_at_joint(k, y, out);
    for (std::size_t i = 0; i < mechanism_.straps.size(); ++i) {
      const Strap& strap = mechanism_.straps[i];
      const Vec2 d = dynamics.position(strap.b) - dynamics.position(strap.a);
      const double taut = strap.free_length + std::max(0.0, strap.slack);
      out.piece[contacts + i] = dot(d, d) > taut * taut ? 1 : 0;
    }
    for (std::size_t r = 0; r < options_.rules.size(); ++r) {
      const auto& rule = options_.rules[r];
      const auto& point = mechanism_.points[static_cast<std::size_t>(rule.point)].point;
      out.root[contacts + r] =
          dot(rule.direction, dynamics.position(point)) - models_.level(r, -1, 0);
    }
  }

  void find_root(std::size_t i, double a, double b, std::vector<Switch>& out) {
    const double fa = before_.root[i];
    const double fb = after_.root[i];
    if ((fa > 0.0) == (fb > 0.0)) return;
    double t = fa == 0.0 ? a : b;
    if (fa != 0.0 && fb != 0.0) {
      const auto f = [&](double time) {
        look_at_one(time, i, trial_);
        return trial_.root[i];
      };
      t = find_root_bracketed(f, a, fa, b, fb, kWidth);
    }
    const bool contact = i < mechanism_.contacts.size();
    out.push_back({t, contact ? SwitchKind::kClosing : SwitchKind::kMonitor,
                   static_cast<int>(contact ? i : i - mechanism_.contacts.size()),
                   fb > fa ? 1 : -1});
  }

  void find_change(std::size_t i, double a, double b, std::vector<Switch>& out) {
    if (before_.piece[i] == after_.piece[i]) return;
    if (i < before_.rate.size() && before_.root[i] > 0.0 && after_.root[i] > 0.0 &&
        std::max(std::fabs(before_.rate[i]), std::fabs(after_.rate[i])) < kAtRest) {
      return;
    }
    int from = before_.piece[i];
    constexpr int most = 4;  // changes within one step of the stroke
    for (int k = 0; k < most && from != after_.piece[i]; ++k) {
      double low = a;
      double high = b;
      int next = after_.piece[i];
      while (high - low > kWidth) {
        const double middle = 0.5 * (low + high);
        if (!(middle > low && middle < high)) break;
        look_at_one(middle, i, trial_);
        if (trial_.piece[i] == from) {
          low = middle;
        } else {
          high = middle;
          next = trial_.piece[i];
        }
      }
      out.push_back({high, SwitchKind::kBranch, static_cast<int>(i), 1});
      from = next;
      a = high;
    }
  }

  void find_zones(std::size_t i, double a, double b, std::vector<Switch>& out) {
    const int last = after_.zone[i];
    int from = before_.zone[i];
    if (from == last) return;
    const std::size_t contacts = mechanism_.contacts.size();
    // A contact that closes or opens ends the step anyway.
    if (i < contacts && (before_.root[i] <= 0.0 || after_.root[i] <= 0.0)) return;
    const double width = 1e-3 * (b - a);
    constexpr int most = 10;
    for (int k = 0; k < most && from != last; ++k) {
      double low = a;
      double high = b;
      int next = last;
      while (high - low > width) {
        const double middle = 0.5 * (low + high);
        look_at_zone(middle, i, trial_);
        if (trial_.zone[i] == from) {
          low = middle;
        } else {
          high = middle;
          next = trial_.zone[i];
        }
      }
      out.push_back({high, SwitchKind::kZone, static_cast<int>(i), 1});
      from = next;
      a = high;
    }
  }

  Trajectory& trajectory_;
  ShiftedModels& models_;
  const SensitivityOptions& options_;
  MechanismSystem& probe_;
  const Mechanism& mechanism_;
  std::vector<char> active_;
  std::vector<double> y_;
  Look before_, after_, trial_;
};

}  // namespace

std::vector<Switch> find_switches(Trajectory& trajectory, ShiftedModels& models,
                                  const SensitivityOptions& options, const InputSignal& input) {
  std::vector<Switch> out;
  Finder(trajectory, models, options, input).scan(out);
  const double end = trajectory.time(trajectory.size() - 1);
  for (std::size_t node = 1; node + 1 < trajectory.size(); ++node) {
    const auto now = trajectory.memory(node);
    if (now.empty()) break;
    const auto then = trajectory.memory(node - 1);
    for (std::size_t c = 0; c < now.size(); ++c) {
      if (now[c] > then[c]) {
        out.push_back({trajectory.time(node), SwitchKind::kReversal, static_cast<int>(c), 1});
      }
    }
  }
  const double origin = models.probe().origin();
  // At the knots of a force, or of a motion that a contact transmits, only a derivative of the
  // right hand side jumps. A prescribed coordinate has the acceleration of its profile, which jumps
  // there.
  const auto& breakpoints = input.profile.breakpoints();
  const auto& knots = input.profile.knots();
  const std::size_t inner = is_prescribed(input.kind) ? knots.size() : 0;
  for (std::size_t i = 0; i < breakpoints.size() + inner; ++i) {
    const double on_profile =
        i < breakpoints.size() ? breakpoints[i] : knots[i - breakpoints.size()];
    const double t = on_profile - origin;
    if (t > 0.0 && t < end) out.push_back({t, SwitchKind::kStop, static_cast<int>(i), 1});
  }
  std::stable_sort(out.begin(), out.end(),
                   [](const Switch& a, const Switch& b) { return a.time < b.time; });
  out.push_back({end, SwitchKind::kEnd, -1, 0});
  return out;
}

}  // namespace feltmb::detail
