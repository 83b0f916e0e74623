#include "feltmb/model/simulation.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <numeric>

#include "feltmb/core/error.hpp"
#include "feltmb/core/index.hpp"
#include "feltmb/core/sums.hpp"
#include "feltmb/model/bdf_order.hpp"
#include "feltmb/model/channels.hpp"
#include "feltmb/model/equilibrium.hpp"
#include "feltmb/model/linear_machine.hpp"
#include "feltmb/model/stepper.hpp"
#include "feltmb/numeric/bracketing.hpp"
#include "feltmb/ode/adams_quadrature.hpp"
#include "feltmb/ode/events.hpp"

namespace feltmb {
namespace {

using Clock = std::chrono::steady_clock;

void check(const SimulationOptions& o) {
  const auto positive = [](double v) { return std::isfinite(v) && v > 0.0; };
  if (!positive(o.duration)) {
    throw InvalidParameter(format("duration = %.6g s, must be > 0", o.duration));
  }
  if (!(o.rtol >= 1e-13 && o.rtol <= 1e-2)) {
    throw InvalidParameter(format("rtol = %.6g, must be in [1e-13, 1e-2]", o.rtol));
  }
  if (!positive(o.output_rate)) {
    throw InvalidParameter(format("output_rate = %.6g Hz, must be > 0", o.output_rate));
  }
  if (!(std::isfinite(o.outputs_from) && o.outputs_from >= 0.0)) {
    throw InvalidParameter(format("outputs_from = %.6g s, must be >= 0", o.outputs_from));
  }
  if (o.max_order < 0 || o.max_order > 5) {
    throw InvalidParameter(format("max_order = %d, must be 0 (chosen) to 5", o.max_order));
  }
  if (!(o.max_step >= 0.0)) {
    throw InvalidParameter(format("max_step = %.6g s, must be >= 0 (0: no limit)", o.max_step));
  }
  if (!(o.max_wall >= 0.0)) {
    throw InvalidParameter(format("max_wall = %.6g s, must be >= 0 (0: no limit)", o.max_wall));
  }
  if (!(o.ledger_limit > 0.0)) {
    throw InvalidParameter(format("ledger_limit = %.6g, must be > 0", o.ledger_limit));
  }
  if (o.max_steps < 1) {
    throw InvalidParameter(format("max_steps = %ld, must be >= 1", o.max_steps));
  }
}

/// Grows without moving rows about more than now and then.
void append_row(RowMatrix& matrix, Eigen::Index row, std::span<const double> values) {
  if (row >= matrix.rows()) {
    matrix.conservativeResize(std::max<Eigen::Index>(16, 2 * row),
                              static_cast<Eigen::Index>(values.size()));
  }
  std::copy(values.begin(), values.end(), matrix.row(row).data());
}

/// Watches the largest force of one contact on the dense output.
class PeakWatch {
 public:
  explicit PeakWatch(int contact) : peak_{contact, 0.0, 0.0} {}

  /// At the start of a run, after its first right-hand side: no peak, but the force there.
  void start(const MechanismSystem& system) {
    last_ = force_of(system);
    peak_.force = last_;
    peak_.time = 0.0;
  }

  /// Looks at the last step up to `end`.
  void look(MechanismSystem& system, const Integrator& integrator, double end,
            std::vector<double>& y) {
    if (last_ <= 0.0 && end == integrator.time() && system.surely_open(end, peak_.contact)) return;
    const double begin = integrator.time() - integrator.last_step();
    const double force = force_at(system, integrator, end, y);
    const double before = last_;
    last_ = force;
    if (force <= 0.0 && before <= 0.0) return;
    if (std::max(force, before) < 0.9 * peak_.force) return;
    // Golden section would ask for a unimodal step; a few samples and a parabola do not.
    constexpr int parts = 4;
    double t[parts + 1];
    double f[parts + 1];
    int best = 0;
    for (int i = 0; i <= parts; ++i) {
      t[i] = begin + (end - begin) * i / parts;
      f[i] = i == parts ? force : force_at(system, integrator, t[i], y);
      if (f[i] > f[best]) best = i;
    }
    offer(f[best], t[best]);
    if (best == 0 || best == parts) return;
    const double curvature = f[best - 1] - 2.0 * f[best] + f[best + 1];
    if (curvature >= 0.0) return;
    const double shift = 0.5 * (f[best - 1] - f[best + 1]) / curvature;
    const double top = t[best] + shift * (t[1] - t[0]);
    offer(force_at(system, integrator, top, y), top);
  }

  const Peak& peak() const { return peak_; }

 private:
  double force_at(MechanismSystem& system, const Integrator& integrator, double t,
                  std::vector<double>& y) const {
    integrator.interpolate(t, y);
    const std::size_t own[] = {as_index(peak_.contact)};
    system.locate_only(t, y, own);
    return force_of(system);
  }

  double force_of(const MechanismSystem& system) const {
    const ContactState& s = system.dynamics().contacts()[as_index(peak_.contact)];
    if (!s.closed) return 0.0;
    return system.mechanism()
        .contacts[as_index(peak_.contact)]
        .law.evaluate(s.compression, s.rate, system.dynamics().memory(as_index(peak_.contact)))
        .force;
  }

  void offer(double force, double t) {
    if (force <= peak_.force) return;
    peak_.force = force;
    peak_.time = t;
  }

  Peak peak_;
  double last_ = 0.0;
};

}  // namespace

void check_samples(double output_rate, double duration, double count, double columns) {
  constexpr double most = 5e8;  // numbers, 4 GB
  if (count * columns <= most) return;
  throw InvalidParameter(
      format("output_rate = %.6g Hz over %.6g s gives %.3g samples of %.0f numbers; the limit is "
             "%.3g samples",
             output_rate, duration, count, columns, std::floor(most / columns)));
}

Method method_from_name(const std::string& name) {
  for (const Method m : {Method::kAuto, Method::kCvode, Method::kModal}) {
    if (name == method_name(m)) return m;
  }
  throw InvalidParameter("method = \"" + name + "\", must be \"auto\", \"cvode\" or \"modal\"");
}

const char* status_name(RunStatus status) {
  switch (status) {
    case RunStatus::kDone:
      return "done";
    case RunStatus::kFailed:
      return "failed";
    case RunStatus::kWallTime:
      return "wall_time";
    case RunStatus::kInterrupted:
      return "interrupted";
  }
  return "?";
}

const char* method_name(Method method) {
  return method == Method::kAuto ? "auto" : method == Method::kCvode ? "cvode" : "modal";
}

double tolerance_for(double error, const Mechanism& mechanism, Method method) {
  if (!(error > 0.0 && error <= 0.1)) {
    throw InvalidParameter(format("error = %.6g of the peak, must be in (0, 0.1]", error));
  }
  constexpr double least = 1e-13;
  if (mechanism.strings.empty()) return std::clamp(1e-2 * error, least, 1e-2);
  if (method != Method::kCvode) return std::clamp(3e-2 * error, least, 1e-2);
  if (order_of_strings(mechanism) > 2) return std::clamp(1e-2 * error, least, 1e-2);
  const double rtol = 0.3 * error * error;
  // Below 1e-7 all orders are used, and the error falls with the tolerance again.
  return std::max(rtol >= 1e-7 ? rtol : 1e-4 * error, least);
}

SimulationState SimulationState::of(const Equilibrium& rest) {
  SimulationState state;
  state.y = rest.q;
  state.y.insert(state.y.end(), rest.q.size(), 0.0);
  state.y.insert(state.y.end(), rest.law.begin(), rest.law.end());
  state.y.insert(state.y.end(), rest.eta.begin(), rest.eta.end());
  state.y.insert(state.y.end(), rest.eta.size(), 0.0);
  state.largest_compression = rest.largest_compression;
  return state;
}

void SimulationState::check(const Mechanism& mechanism, std::size_t size) const {
  if (y.size() != size) {
    throw InvalidParameter(
        format("start state: got %zu values, expected %zu of this mechanism", y.size(), size));
  }
  for (std::size_t i = 0; i < size; ++i) {
    if (!std::isfinite(y[i])) {
      throw InvalidParameter(
          format("start state: value %zu is %.6g, expected a finite number", i, y[i]));
    }
  }
  if (largest_compression.empty()) return;
  const std::size_t contacts = mechanism.contacts.size();
  if (largest_compression.size() < contacts || (largest_compression.size() - contacts) % 2 != 0) {
    throw InvalidParameter(
        format("start memory: got %zu values, expected one a contact (%zu) "
               "and pairs of a contact and a turning point",
               largest_compression.size(), contacts));
  }
  constexpr double most = 1.0;  // m: thicker than any felt
  for (std::size_t i = 0; i < contacts; ++i) {
    const double e = largest_compression[i];
    if (!(e >= 0.0 && e <= most)) {
      throw InvalidParameter(
          format("start memory: %s was compressed by %.6g m, expected 0 to %.6g m",
                 mechanism.contacts[i].name.c_str(), e, most));
    }
  }
  for (std::size_t k = contacts; k < largest_compression.size(); k += 2) {
    const double index = largest_compression[k];
    const auto contact = index >= 0.0 && index < static_cast<double>(contacts)
                             ? static_cast<std::size_t>(index)
                             : contacts;
    const double e = largest_compression[k + 1];
    if (contact == contacts || !mechanism.contacts[contact].law.has_turns() ||
        !(e >= 0.0 && e < largest_compression[contact])) {
      throw InvalidParameter(
          format("start memory: turning point at %.6g m of contact %.6g; expected a contact whose "
                 "law has turning points, and 0 to its largest compression",
                 e, index));
    }
  }
}

std::vector<Lowest> Lowest::of(const Mechanism& mechanism, const std::vector<int>& points) {
  std::vector<Lowest> out;
  for (const int point : points) {
    if (point < 0 || as_index(point) >= mechanism.points.size()) {
      throw InvalidParameter(format("lowest_points: there is no point %d", point));
    }
    out.push_back({point, 0.0, 0.0});
  }
  return out;
}

namespace {

/// Everything that a run changes as it goes on, beside the workspaces: assigned anew when one
/// begins.
struct RunState {
  struct Stop {
    double time;
    bool restart;
  };

  Clock::time_point begin = Clock::now();
  double duration = 0.0;  ///< [s]
  Progress progress;
  std::vector<Stop> stops;          ///< times that a step does not pass, ascending
  std::vector<double> y;            ///< whole state from which the integrator starts
  bool leaving = false;             ///< the strings can be left to themselves
  std::vector<double> string_heat;  ///< of the times apart that are over [J]
  AdamsQuadrature ledger{0};        ///< integrals of the powers
  std::vector<double> felt_before;  ///< compressions at the start of a step, by remembering_ [m]
  std::vector<double> felt_rate;    ///< of these, near the end of the last step
  std::vector<double> recovered;    ///< heat of recovery by contact [J]
  std::vector<PeakWatch> watches;
  std::string broken;  ///< what is wrong with the last sample
  long rows = 0;       ///< samples taken
  long next_sample = 0;
  double last_sample = -1.0;  ///< [s]
  double next_report = 0.05;  ///< wall time of the next call of progress [s]
  long progress_step = 0;     ///< at which the advance of the time was last checked
  double progress_time = 0.0;
  std::vector<long> state_counts;  ///< how often a state limited the step
  std::vector<long> contact_counts;
  RunResult result;
};

/// A mechanism with its integrators, ready for runs from any state, one after the other.
class Simulator {
 public:
  Simulator(const std::shared_ptr<const Mechanism>& mechanism, const InputSignal& input,
            const SimulationOptions& options, const SimulationState& start,
            const std::vector<Monitor>& monitors, const Progress& progress)
      : options_(options),
        mechanism_(mechanism),
        modal_(options.method != Method::kCvode && !mechanism->strings.empty()),
        finger_reference_(options.finger_reference),
        system_(mechanism, input, options.ledger, monitors, options.events),
        whole_size_(system_.size()),
        locator_(system_),
        power_(system_.ledger_names().size()) {
    system_.set_tolerance(options.rtol);
    for (std::size_t i = 0; i < mechanism->contacts.size(); ++i) {
      const ContactLaw& law = mechanism->contacts[i].law;
      if (!law.has_memory()) continue;
      remembering_.push_back(i);
      if (law.recovery_time() > 0.0) recovering_ = true;
    }
    for (const int number : options.peak_contacts) {
      const int index = mechanism->contact_index(number);
      if (index < 0) {
        throw InvalidParameter(format("peak_contacts: there is no contact %d", number));
      }
      watched_.push_back(index);
    }
    if (options.outputs) channels_ = Channels(*mechanism);
    begin(input, start, options.duration, progress);
  }

  /// For `again`. Both integrators are made now, by what the mechanism is at the start: one that is
  /// made at the first strike depends on it. Motions count from this start.
  void prepare_steps() {
    finger_reference_ = system_.finger_reference();
    if (modal_) {
      system_.allow_free_strings();
      system_.part_strings(0.0, state_.y);
      apart_ = make_integrator(false);
      system_.join_strings(0.0, state_.y);
    }
    whole_ = make_integrator(true);
  }

  /// Another run of the same mechanism and options; nothing of the last one stays but the counts.
  RunResult again(const InputSignal& input, const SimulationState& start, double duration,
                  const Progress& progress) {
    const double share = share_of_tolerance(duration);
    system_.set_tolerance(share * options_.rtol);
    for (auto* each : {whole_.get(), apart_.get()}) {
      if (each == nullptr) continue;
      each->forget();
      each->scale_tolerances(share);
    }
    join_strings();
    begin(input, start, duration, progress);
    return run();
  }

  MechanismSystem& system() { return system_; }

  /// Seeks the largest force of every contact in the runs from now on.
  void watch_all() {
    watched_.resize(mechanism_->contacts.size());
    std::iota(watched_.begin(), watched_.end(), 0);
  }

  /// Lets the strings be part of the state again.
  void join_strings() {
    if (system_.strings_apart()) system_.join_strings(0.0, state_.y);
  }

  RunResult run() {
    Integrator* integrator = set_out();
    std::size_t next_stop = 0;
    for (long steps = 1;; ++steps) {
      const RunState::Stop& stop = state_.stops[next_stop];
      const StepStatus status = step(*integrator, stop.time);
      if (status == StepStatus::kFailed) break;
      const StepEnd end = find_end(*integrator);
      if (!record_step(*integrator, end)) break;
      if (options_.diagnose && steps % 4 == 0) diagnose(*integrator);
      const bool free = system_.strings_apart();
      if (end.reversal.contact >= 0) {
        restart_at(*integrator, end.reversal);
      } else if (end.struck) {
        integrator = meet_strings(*integrator, end.now);
      }
      if (options_.on_step) {
        write_whole(end.now, integrator->state(), state_.y);
        options_.on_step(end.now, state_.y, largest(), free);
      }
      if (end.reversal.contact >= 0 || end.struck) {
        // has been started anew
      } else if (status == StepStatus::kStop) {
        if (++next_stop == state_.stops.size()) break;
        if (stop.restart) {
          // The slope of the input jumps here: the multistep history is void.
          std::copy(integrator->state().begin(), integrator->state().end(), state_.y.begin());
          start_at(*integrator, end.now);
          ++state_.result.restarts;
        }
      } else if (state_.leaving) {
        integrator = leave_strings(*integrator);
      }
      if (!may_go_on(*integrator, steps)) break;
    }
    finish(*integrator);
    return std::move(state_.result);
  }

 private:
  /// A run begins: its input, state, memory, times to stop at and places of its samples.
  void begin(const InputSignal& input, const SimulationState& start, double duration,
             const Progress& progress) {
    if (!start.y.empty()) start.check(*mechanism_, whole_size_);
    state_ = {};
    state_.duration = duration;
    state_.progress = progress;
    const SimulationState from =
        start.y.empty() ? SimulationState::of(find_equilibrium(mechanism_)) : start;
    state_.y = from.y;
    system_.dynamics().set_memories(from.largest_compression.empty()
                                        ? std::vector<double>(mechanism_->contacts.size(), 0.0)
                                        : from.largest_compression);
    system_.set_input(input);
    set_finger_reference();
    system_.set_prescribed_reference(0.0, state_.y);
    scratch_.resize(state_.y.size());
    state_.string_heat.assign(mechanism_->strings.size(), 0.0);
    state_.ledger = AdamsQuadrature(system_.ledger_names().size());
    state_.felt_rate.assign(remembering_.size(), 0.0);  // at rest
    state_.recovered.assign(mechanism_->contacts.size(), 0.0);
    for (const int contact : watched_) state_.watches.emplace_back(contact);
    set_stops(input);
    prepare_result();
  }

  void set_stops(const InputSignal& input) {
    const auto add_stops = [&](const std::vector<double>& times, bool restart) {
      for (const double on_profile : times) {
        const double t = on_profile - input.origin;
        if (t > 0.0 && t < state_.duration) state_.stops.push_back({t, restart});
      }
    };
    add_stops(input.profile.breakpoints(), true);
    add_stops(input.profile.knots(), false);
    std::stable_sort(
        state_.stops.begin(), state_.stops.end(),
        [](const RunState::Stop& a, const RunState::Stop& b) { return a.time < b.time; });
    state_.stops.push_back({state_.duration, false});
  }

  /// Share of the tolerance for a step of the caller. Each start without history has an error of
  /// about one tolerance, however short the step is. With a share in proportion to its duration,
  /// the error over a time does not depend on the number of steps.
  double share_of_tolerance(double duration) const {
    const double least = std::min(1.0, kLeastTolerance / options_.rtol);
    return std::clamp(duration / kWholeTolerance, least, 1.0);
  }

  static constexpr double kWholeTolerance = 0.01;   ///< duration from which the share is one [s]
  static constexpr double kLeastTolerance = 1e-12;  ///< relative, for rounding errors

  struct Reversal {
    int contact = -1;
    double time = std::numeric_limits<double>::infinity();
    double compression = 0.0;
  };

  /// Where the last step ends, or is cut.
  struct StepEnd {
    Reversal reversal;    ///< that cuts it
    bool struck = false;  ///< a free string is met
    double now = 0.0;     ///< [s]
  };

  /// Everything that comes before the first step; the integrator that takes it.
  Integrator* set_out() {
    if (modal_) system_.allow_free_strings();
    locator_.start(0.0, state_.y);
    system_.rhs(0.0, state_.y, scratch_);
    for (auto& watch : state_.watches) watch.start(system_);
    if (modal_ && system_.strings_clear(0.0, kClear)) system_.part_strings(0.0, state_.y);
    auto& integrator = system_.strings_apart() ? apart_ : whole_;
    if (!integrator) integrator = make_integrator(!system_.strings_apart());
    start_at(*integrator, 0.0);
    sample(0.0, state_.y);
    if (!state_.broken.empty()) {
      throw InvalidParameter("start state: " + state_.broken +
                             "; is the run that it is from damaged?");
    }
    if (options_.on_step) options_.on_step(0.0, state_.y, largest(), system_.strings_apart());
    return integrator.get();
  }

  /// One step of the integrator; a failure is told in the result.
  StepStatus step(Integrator& integrator, double stop) {
    try {
      const StepStatus status = integrator.step(stop);
      if (status == StepStatus::kFailed) {
        fail(integrator, ErrorCode::kNotConverged, integrator.message());
      }
      return status;
    } catch (const Error& error) {
      fail(integrator, error.code(), error.what());
      return StepStatus::kFailed;
    }
  }

  StepEnd find_end(const Integrator& integrator) {
    // First, since they read the contacts of the last right-hand side.
    const double reached = integrator.time();
    if (state_.ledger.size() > 0) {
      system_.powers(reached, integrator.state(), power_);
      read_felts(felt_after_);
    }
    StepEnd end{find_reversal(integrator), false, reached};
    const double strike = find_strike(integrator);
    if (strike < end.reversal.time) end.reversal.contact = -1;
    end.struck = strike < reached && end.reversal.contact < 0;
    if (end.reversal.contact >= 0) end.now = end.reversal.time;
    if (end.struck) end.now = strike;
    return end;
  }

  /// Peaks, events, ledger and samples of the last step; false if it shows a fault.
  bool record_step(const Integrator& integrator, const StepEnd& end) {
    if (std::string beyond = system_.dynamics().beyond_string(); !beyond.empty()) {
      sample_until(integrator, end.now);
      fail_at(end.now, ErrorCode::kBeyondString, beyond);
      return false;
    }
    for (auto& watch : state_.watches) watch.look(system_, integrator, end.now, scratch_);
    for (const Crossing& crossing : locator_.scan(integrator, end.now)) {
      record_event(integrator, crossing);
    }
    if (state_.ledger.size() > 0) advance_ledger(integrator, end.now, end.reversal);
    sample_until(integrator, end.now);
    if (!state_.broken.empty()) {
      fail_at(state_.last_sample, ErrorCode::kNotFinite, state_.broken);
      return false;
    }
    if (end.now < integrator.time()) state_.ledger.cut(end.now);
    return true;
  }

  /// Gap beyond which a string is left to itself [m]: more than an opening contact bounces over.
  static constexpr double kClear = 1e-4;

  /// By how much the error test is wider while strings are apart, down to a tolerance of 1e-7. Most
  /// of the true error of a stroke was what Newton's method left over, which no test sees; since it
  /// leaves next to nothing, a wider test gives the same true error
  /// (docs/validation/speed.md).
  static constexpr double kTestWidth = 2.0;

  /// See bdf_order.hpp. At tight tolerances accuracy holds the step further down than stability
  /// does, and the high orders pay.
  void choose_order(IntegratorOptions& o, bool with_strings) const {
    o.max_order = options_.max_order > 0 ? options_.max_order : 5;
    if (options_.max_order > 0 || options_.rtol < 1e-7 || !with_strings) return;
    const Mechanism& m = system_.mechanism();
    const int order = order_of_strings(m);
    o.max_order = order;
    if (order != 3 && order != 4) return;
    // The error test takes the mean square over all states: one alone may have this error.
    const double own = o.rtol * std::sqrt(static_cast<double>(whole_size_));
    const std::vector<FreeMode> modes =
        free_modes(mechanism_, std::span<const double>(state_.y).first(as_index(m.size())));
    o.max_order = order_without_growth(order, modes, own, state_.duration);
    if (o.max_order < 3) return;
    o.long_order = o.max_order;
    o.max_order = 5;
    o.stable_step = stable_step(m, modes);
  }

  std::unique_ptr<Integrator> make_integrator(bool with_strings) {
    IntegratorOptions o;
    o.max_step = options_.max_step;
    // The integrator weighs the mean square of all errors. Strings at rest have none: without
    // them the same tolerance would ask for more of the rest.
    const double fewer =
        std::sqrt(static_cast<double>(whole_size_) / static_cast<double>(system_.size()));
    const bool wide = !with_strings && options_.rtol >= 1e-7;
    o.rtol = options_.rtol * std::min(2.0, fewer) * (wide ? kTestWidth : 1.0);
    o.atol = system_.absolute_tolerances(o.rtol);
    choose_order(o, with_strings);
    return std::make_unique<Integrator>(system_, o);
  }

  /// Starts from state_.y; the rates of the ledger are evaluated there.
  void start_at(Integrator& integrator, double t) {
    integrator.start(t, state_of(state_.y));
    if (state_.ledger.size() == 0) return;
    system_.powers(t, state_of(state_.y), power_);
    state_.ledger.start(t, power_);
    read_felts(state_.felt_before);
  }

  /// Compressions of the felts that remember at the state located last; of an open one 0.
  void read_felts(std::vector<double>& to) const {
    to.resize(remembering_.size());
    for (std::size_t i = 0; i < to.size(); ++i) {
      const std::size_t contact = remembering_[i];
      const ContactState& s = system_.dynamics().contacts()[contact];
      to[i] = s.closed ? system_.mechanism().contacts[contact].law.felt_compression(
                             s.compression, system_.dynamics().memory(contact))
                       : 0.0;
    }
  }

  /// Moments of the last step up to `now` at which a felt passes a compression that it remembers.
  void find_passes(const Integrator& integrator, double now, const Reversal& reversal) {
    passes_.clear();
    const double begin = integrator.time() - integrator.last_step();
    for (std::size_t i = 0; i < remembering_.size(); ++i) {
      const std::size_t contact = remembering_[i];
      const double before = state_.felt_before[i];
      const bool turns = reversal.contact == static_cast<int>(contact);
      const double after = turns ? reversal.compression : felt_after_[i];
      const auto look = [&](double remembered) {
        if (!((before - remembered) * (after - remembered) < 0.0)) return;
        const auto beyond = [&](double t) {
          return felt_at(integrator, contact, t).force - remembered;
        };
        const double first = beyond(begin);
        const double last = beyond(now);
        if (!(first * last < 0.0)) return;
        const double t = find_root_bracketed(beyond, begin, first, now, last, kPassWidth);
        if (t > begin + 2.0 * kPassWidth && t < now - 2.0 * kPassWidth) passes_.push_back(t);
      };
      look(largest()[contact]);
      for (const TurningPoint& point : system_.dynamics().turns(contact)) look(point.compression);
    }
    std::sort(passes_.begin(), passes_.end());
    // The nodes of a quadrature are apart.
    const auto near = [](double a, double b) { return b - a < 4.0 * kPassWidth; };
    passes_.erase(std::unique(passes_.begin(), passes_.end(), near), passes_.end());
  }

  /// The ledger goes on over the last step, whose powers at its end are in power_. Where a felt
  /// passes a compression that it remembers, its force has a kink, but the power that it loses
  /// jumps: the loop that ends there has another loss than the curve beyond it. A polynomial over
  /// the jump is off by the jump times the step, so the quadrature starts anew there.
  void advance_ledger(const Integrator& integrator, double now, const Reversal& reversal) {
    const std::size_t nodes = as_index(integrator.last_order()) + 1;
    if (!remembering_.empty()) find_passes(integrator, now, reversal);
    std::swap(state_.felt_before, felt_after_);
    if (!passes_.empty()) {
      power_at_end_ = power_;
      for (const double t : passes_) {
        state_.ledger.step(t, power_at(integrator, t - kPassWidth), nodes);
        sample_until(integrator, t);
        state_.ledger.start(t, power_at(integrator, t + kPassWidth));
      }
      std::swap(power_, power_at_end_);
    }
    state_.ledger.step(integrator.time(), power_, nodes);
  }

  /// Powers at t within the last step.
  std::span<const double> power_at(const Integrator& integrator, double t) {
    integrator.interpolate(t, scratch_);
    system_.powers(t, state_of(scratch_), power_);
    return power_;
  }

  static constexpr double kPassWidth = 1e-12;  ///< to which the time of a pass is found [s]

  /// Of each integral of the ledger that counts as nothing, over rtol [J].
  static constexpr double kLedgerTolerance = 1e-3;

  /// The part of a whole state that is integrated now.
  std::span<const double> state_of(const std::vector<double>& y) const {
    return std::span<const double>(y).first(system_.size());
  }

  /// Writes the whole state at t: the part that is integrated, and free strings where they are.
  void write_whole(double t, std::span<const double> state, std::span<double> to) {
    std::copy(state.begin(), state.end(), to.begin());
    if (system_.strings_apart()) system_.fill_strings(t, to);
  }

  /// Moment of the last step at which a contact meets a free string; infinity if there is none.
  double find_strike(const Integrator& integrator) {
    constexpr double none = std::numeric_limits<double>::infinity();
    const double end = integrator.time();
    state_.leaving = modal_ && !system_.strings_apart() && system_.strings_clear(end, kClear);
    if (!system_.strings_apart()) return none;
    const double after = system_.string_approach(end, integrator.state());
    if (!(after > 0.0)) return none;
    const double begin = end - integrator.last_step();
    const auto approach = [&](double t) {
      integrator.interpolate(t, scratch_);
      return system_.string_approach(t, scratch_);
    };
    const double before = approach(begin);
    if (before >= 0.0) return begin;
    return find_root_bracketed(approach, begin, before, end, after, 1e-12);
  }

  Integrator* meet_strings(const Integrator& integrator, double t) {
    integrator.interpolate(t, state_.y);
    system_.join_strings(t, state_.y);
    for (std::size_t s = 0; s < state_.string_heat.size(); ++s)
      state_.string_heat[s] += system_.string_heat(s);
    if (!whole_) whole_ = make_integrator(true);
    ++state_.result.strikes;
    start_at(*whole_, t);
    read_felt_rates(t);
    return whole_.get();
  }

  Integrator* leave_strings(const Integrator& integrator) {
    std::copy(integrator.state().begin(), integrator.state().end(), state_.y.begin());
    system_.part_strings(integrator.time(), state_.y);
    if (!apart_) apart_ = make_integrator(false);
    start_at(*apart_, integrator.time());
    return apart_.get();
  }

  std::vector<double>& largest() { return system_.dynamics().largest_compression(); }

  void set_finger_reference() {
    const Mechanism& m = system_.mechanism();
    double place = finger_reference_;
    if (m.finger_contact < 0) return;
    if (std::isnan(place)) {
      system_.locate(0.0, state_.y);
      place = dot(m.finger_direction, system_.dynamics().position(m.finger_point));
    }
    system_.set_finger_reference(place);
  }

  /// Compression and rate of the felt of one contact at the state located last.
  CurveValue felt(std::size_t contact) const {
    const Dynamics& dynamics = system_.dynamics();
    const ContactState& s = dynamics.contacts()[contact];
    const ContactLaw& law = system_.mechanism().contacts[contact].law;
    const LawMemory memory = dynamics.memory(contact);
    return {law.felt_compression(s.compression, memory),
            law.felt_rate(s.compression, s.rate, memory)};
  }

  CurveValue felt_at(const Integrator& integrator, std::size_t contact, double t) {
    integrator.interpolate(t, scratch_);
    system_.locate_only(t, scratch_, {&contact, 1});
    return felt(contact);
  }

  /// Rate of a felt [m/s] from which the last right-hand side leaves no doubt about its turn,
  /// though it was taken within a Newton correction of the end of the step: the contact need not be
  /// located again.
  double sure_rate() const { return 1e-5 + 5.0 * options_.rtol; }

  /// First reversal in the last step of a law with turning points. Loops of the size of the error
  /// of the integrator are none: there the felt moves along one branch, without a loss.
  void find_turn(const Integrator& integrator, std::size_t i, Reversal& first) {
    const std::size_t contact = remembering_[i];
    Dynamics& dynamics = system_.dynamics();
    const ContactState& state = dynamics.contacts()[contact];
    const double end = integrator.time();
    const double begin = end - integrator.last_step();
    const double noise = 1e-3 * options_.rtol;  // m
    const double before = state_.felt_rate[i];
    if (!state.closed && std::isnan(before)) return;
    TurningPoints& turns = dynamics.turns(contact);
    const CurveValue after = felt(contact);
    const double remembered = largest()[contact];
    state_.felt_rate[i] = state.closed ? after.slope : std::numeric_limits<double>::quiet_NaN();
    const bool sure = std::fabs(before) > sure_rate();
    if (sure && state.closed && std::copysign(1.0, before) * after.slope > sure_rate()) return;
    const std::size_t one[] = {contact};
    const CurveValue first_in_step = felt_at(integrator, contact, begin);
    // Where the rate leaves a doubt, the law tells the way. Its list alone does not: the felt may
    // have passed the last turning point backward, in a loop smaller than the noise.
    const bool rises = sure ? before > 0.0
                            : std::isnan(before) || after.force > remembered ||
                                  left_at(first_in_step.force, turns) % 2 == 1;
    const double way = rises ? 1.0 : -1.0;
    const auto back = [&](double t) { return -way * felt_at(integrator, contact, t).slope; };
    const double last = back(end);
    const double start = -way * first_in_step.slope;
    if (start < 0.0 && last > 0.0) {
      const double t = find_root_bracketed(back, begin, start, end, last, 1e-12);
      const double e = std::max(0.0, felt_at(integrator, contact, t).force);
      const double from = turns.empty() ? remembered : turns.back().compression;
      if (way * (e - from) > noise && t < first.time) first = {static_cast<int>(contact), t, e};
    }
    system_.locate_only(end, integrator.state(), one);
  }

  /// A felt that was let go is ready to be pressed from zero.
  void release(std::size_t contact) {
    const ContactLaw& law = system_.mechanism().contacts[contact].law;
    if (!law.has_turns() || system_.dynamics().contacts()[contact].closed) return;
    TurningPoints& turns = system_.dynamics().turns(contact);
    if (turns.size() != 1 || turns[0].compression > 0.0) law.turn(0.0, largest()[contact], turns);
  }

  /// First moment in the last step at which a felt turns from virgin loading to unloading: there
  /// its largest compression is fixed, and the right-hand side changes its branch.
  Reversal find_reversal(const Integrator& integrator) {
    Reversal first;
    if (remembering_.empty()) return first;
    const double end = integrator.time();
    const double h = integrator.last_step();
    const double sure_compression = 1e-9 + 2e-3 * options_.rtol;  // m
    // A felt at rest trembles by rounding: below a thousandth of the tolerance nothing is new.
    const double nothing_new = 2e-7 * options_.rtol;  // m
    const auto may_turn = [&](std::size_t contact, double before, const CurveValue& after,
                              double room) {
      const bool was_open = std::isnan(before);
      // A reversal below the remembered compression is smooth: z takes care of it.
      const double reach =
          after.force + (std::fabs(after.slope) + (was_open ? 0.0 : std::fabs(before))) * h;
      if (!(reach > largest()[contact] + room && reach > room)) return false;
      // A felt that closed within the step may have turned in it, too; one that opened has.
      if (!was_open && before <= -sure_rate()) return false;
      return !(system_.dynamics().contacts()[contact].closed && after.slope > sure_rate());
    };
    turned_.clear();
    for (std::size_t i = 0; i < remembering_.size(); ++i) {
      const std::size_t contact = remembering_[i];
      const ContactState& state = system_.dynamics().contacts()[contact];
      const double before = state_.felt_rate[i];
      if (system_.mechanism().contacts[contact].law.has_turns()) {
        find_turn(integrator, i, first);
        if (recovering_) recover(contact, felt(contact).force, h);
        if (first.contact < 0) release(contact);
        continue;
      }
      if (!state.closed && std::isnan(before)) {
        if (recovering_) recover(contact, felt(contact).force, h);
        continue;
      }
      CurveValue after = felt(contact);
      if (may_turn(contact, before, after, nothing_new - sure_compression)) {
        system_.locate_only(end, integrator.state(), {&contact, 1});
        after = felt(contact);
        if (may_turn(contact, before, after, nothing_new)) turned_.push_back(contact);
      }
      state_.felt_rate[i] = state.closed ? after.slope : std::numeric_limits<double>::quiet_NaN();
      if (recovering_) recover(contact, after.force, h);
    }
    for (const std::size_t contact : turned_) {
      const auto falling = [&](double t) { return -felt_at(integrator, contact, t).slope; };
      const double before = falling(end - h);
      const double after = falling(end);
      if (before >= 0.0 || after <= 0.0) continue;
      const double t = find_root_bracketed(falling, end - h, before, end, after, 1e-12);
      const double top = felt_at(integrator, contact, t).force;
      if (top <= largest()[contact] + nothing_new) continue;
      if (first.contact < 0 || t < first.time) first = {static_cast<int>(contact), t, top};
    }
    if (!turned_.empty()) system_.locate_only(end, integrator.state(), turned_);
    return first;
  }

  /// Between strikes a felt forgets; the energy that its friction held locked turns into heat.
  void recover(std::size_t contact, double compression, double h) {
    const ContactLaw& law = system_.mechanism().contacts[contact].law;
    const double time = law.recovery_time();
    if (time <= 0.0 || compression > 0.0) return;
    const double* state = system_.dynamics().memory(contact).state;
    double& remembered = largest()[contact];
    const double before = law.stored_energy(0.0, {state, remembered});
    remembered *= std::exp(-h / time);
    law.turn(0.0, remembered, system_.dynamics().turns(contact));
    state_.recovered[contact] += before - law.stored_energy(0.0, {state, remembered});
  }

  void restart_at(Integrator& integrator, const Reversal& reversal) {
    integrator.interpolate(reversal.time, state_.y);
    const std::size_t index = as_index(reversal.contact);
    double& remembered = largest()[index];
    const Contact& contact = mechanism_->contacts[index];
    if (options_.on_step) {
      if (system_.strings_apart()) system_.fill_strings(reversal.time, state_.y);
      options_.on_step(reversal.time, state_.y, largest(), system_.strings_apart());
    }
    contact.law.turn(reversal.compression, remembered, system_.dynamics().turns(index));
    contact.law.widen(reversal.compression, remembered,
                      state_.y.data() + 2 * as_index(mechanism_->size()) + contact.first_state);
    remembered = std::max(remembered, reversal.compression);
    start_at(integrator, reversal.time);
    read_felt_rates(reversal.time, reversal.contact);
    ++state_.result.reversals;
  }

  /// Rates where a step was cut, of which the felts knew those at its end. One turns there.
  void read_felt_rates(double t, int turning = -1) {
    if (remembering_.empty()) return;
    system_.locate(t, state_.y, Detail::kAllContacts);
    for (std::size_t i = 0; i < remembering_.size(); ++i) {
      const bool turns = static_cast<int>(remembering_[i]) == turning;
      state_.felt_rate[i] = turns ? 0.0 : felt(remembering_[i]).slope;
    }
  }

  void prepare_result() {
    RunResult& result = state_.result;
    result.method = modal_ ? Method::kModal : Method::kCvode;
    result.lowest = Lowest::of(*mechanism_, options_.lowest_points);
    for (const FlexibleBeam& beam : mechanism_->beams) {
      result.deflections.push_back({beam.name, beam.length, 0.0, 0.0});
    }
    result.ledger_names = system_.ledger_names();
    if (!options_.outputs) return;
    result.name_outputs(channels_);
    const double last = std::floor(state_.duration * options_.output_rate * (1.0 + 1e-12));
    const double skipped = std::ceil(options_.outputs_from * options_.output_rate * (1.0 - 1e-12));
    const double count = std::max(0.0, last - std::max(0.0, skipped));
    const std::size_t integrals = result.ledger_names.size();
    const auto columns = static_cast<double>(1 + result.names.size() + state_.y.size() + integrals);
    check_samples(options_.output_rate, state_.duration, count, columns);
    const auto rows = static_cast<Eigen::Index>(count) + 3;
    result.time.resize(rows);
    result.data.resize(rows, static_cast<Eigen::Index>(result.names.size()));
    if (options_.states) result.states.resize(rows, static_cast<Eigen::Index>(state_.y.size()));
    result.ledger.resize(rows, static_cast<Eigen::Index>(integrals));
    ledger_scratch_.resize(integrals);
  }

  double sample_time(long i) const {
    return std::min(static_cast<double>(i) / options_.output_rate, state_.duration);
  }

  void sample_until(const Integrator& integrator, double now) {
    if (!options_.outputs && state_.result.lowest.empty()) return;
    while (state_.broken.empty() && state_.last_sample < state_.duration &&
           sample_time(state_.next_sample) <= now) {
      const double t = sample_time(state_.next_sample);
      integrator.interpolate(t, scratch_);
      sample(t, scratch_);
    }
  }

  void sample(double t, std::span<const double> y) {
    const bool taken = options_.outputs && t >= options_.outputs_from;
    if (state_.next_sample == 0 && options_.outputs && options_.ledger) {
      state_.result.start.resize(state_.result.names.size());
      channels_.observe(system_, t, y, state_.result.start);
    }
    if (taken) {
      take_sample(t, y);
    } else if (!state_.result.lowest.empty()) {
      system_.place(y);
    }
    for (Lowest& each : state_.result.lowest) {
      const auto& point = system_.mechanism().points[as_index(each.point)].point;
      each.look(system_.dynamics().position(point).y, state_.next_sample == 0);
    }
    state_.last_sample = t;
    ++state_.next_sample;
  }

  /// Names the first entry of a row that is no number.
  template <class Name>
  void look_for_nan(std::span<const double> row, Name&& name) {
    if (std::isfinite(sum_absolute(row.size(), row.data())) || !state_.broken.empty()) return;
    for (std::size_t i = 0; i < row.size(); ++i) {
      if (std::isfinite(row[i])) continue;
      state_.broken = name(i) + " is not a finite number";
      return;
    }
  }

  /// `row`: the outputs just observed, with the condensed deflections.
  void look_at_deflections(double t, std::span<const double> row) {
    for (std::size_t b = 0; b < state_.result.deflections.size(); ++b) {
      const FlexibleBeam& beam = system_.mechanism().beams[b];
      const double now = beam.deflection(row.subspan(as_index(beam.first), as_index(beam.count)));
      Deflection& seen = state_.result.deflections[b];
      if (now <= seen.largest) continue;
      seen.largest = now;
      seen.time = t;
    }
  }

  void take_sample(double t, std::span<const double> y) {
    if (state_.rows >= state_.result.time.size()) return;
    const auto row = static_cast<Eigen::Index>(state_.rows);
    state_.result.time[row] = t;
    if (options_.states) {
      write_whole(t, y, {state_.result.states.row(row).data(), whole_size_});
    }
    channels_.observe(
        system_, t, y,
        {state_.result.data.row(row).data(), static_cast<std::size_t>(state_.result.data.cols())});
    const std::span<const double> seen{state_.result.data.row(row).data(),
                                       state_.result.names.size()};
    look_for_nan(seen, [&](std::size_t i) { return state_.result.names[i]; });
    look_for_nan(y.first(system_.size()), [&](std::size_t i) { return system_.state_name(i); });
    look_at_deflections(t, seen);
    if (!ledger_scratch_.empty()) {
      state_.ledger.integrals(t, ledger_scratch_);
      // work_in and work_throughput come first, then two columns a contact.
      for (std::size_t i = 0; i < state_.recovered.size(); ++i) {
        ledger_scratch_[2 + 2 * i] += state_.recovered[i];
      }
      const std::size_t strings = 2 + 2 * state_.recovered.size() + as_index(system_.coordinates());
      for (std::size_t s = 0; s < state_.string_heat.size(); ++s) {
        ledger_scratch_[strings + s] += state_.string_heat[s];
        if (system_.strings_apart()) ledger_scratch_[strings + s] += system_.string_heat(s);
      }
      std::copy(ledger_scratch_.begin(), ledger_scratch_.end(),
                state_.result.ledger.row(row).data());
      look_for_nan(ledger_scratch_,
                   [&](std::size_t i) { return "ledger " + state_.result.ledger_names[i]; });
    }
    if (state_.broken.empty()) ++state_.rows;
  }

  void record_event(const Integrator& integrator, const Crossing& crossing) {
    constexpr std::size_t most = 100000;
    if (state_.result.events.size() >= most) return;
    integrator.interpolate(crossing.time, scratch_);
    system_.locate(crossing.time, scratch_, Detail::kAllContacts);
    const auto row = static_cast<Eigen::Index>(state_.result.events.size());
    const auto contacts = system_.dynamics().contacts();
    std::vector<double> compression(contacts.size());
    std::vector<double> approach(contacts.size());
    for (std::size_t i = 0; i < contacts.size(); ++i) {
      compression[i] = contacts[i].compression;
      approach[i] = -dot(contacts[i].normal, contacts[i].relative_velocity);
    }
    const std::span<const double> y{scratch_};
    append_row(state_.result.event_states, row, y.subspan(0, 2 * as_index(system_.coordinates())));
    append_row(state_.result.event_compression, row, compression);
    append_row(state_.result.event_approach, row, approach);
    SimulationEvent event;
    event.time = crossing.time;
    event.direction = crossing.direction;
    const auto& event_contacts = system_.event_contacts();
    if (crossing.event < event_contacts.size()) {
      event.contact = event_contacts[crossing.event];
    } else {
      event.monitor = static_cast<int>(crossing.event - event_contacts.size());
    }
    state_.result.events.push_back(event);
  }

  void diagnose(Integrator& integrator) {
    const std::size_t state = integrator.limiting_state();
    if (state_.state_counts.empty()) {
      state_.state_counts.assign(whole_size_, 0);
      state_.contact_counts.assign(system_.mechanism().contacts.size(), 0);
    }
    ++state_.state_counts[state];
    const int contact = system_.stiffest_contact(state);
    if (contact >= 0) ++state_.contact_counts[as_index(contact)];
  }

  bool may_go_on(Integrator& integrator, long steps) {
    const double now = integrator.time();
    if (steps >= options_.max_steps) {
      stop(RunStatus::kFailed, ErrorCode::kTooManySteps,
           format("%ld steps were not enough; reached t = %.6g s", steps, now));
      return false;
    }
    if (steps % 64 != 0) return true;
    // A regularised law outside its data can hold the step at microscopic sizes for hours.
    constexpr long window = 100000;
    constexpr double least = 1e-5;  // s
    if (steps - state_.progress_step >= window) {
      if (now - state_.progress_time < least) {
        const std::string where = name_limit(integrator);
        stop(RunStatus::kFailed, ErrorCode::kNoProgress,
             format("no progress: %ld steps moved the time by %.3g s only, at t = %.9g s; state %s "
                    "limits the step%s",
                    window, now - state_.progress_time, now, state_.result.failed_state.c_str(),
                    where.c_str()));
        return false;
      }
      state_.progress_step = steps;
      state_.progress_time = now;
    }
    const double wall = std::chrono::duration<double>(Clock::now() - state_.begin).count();
    if (options_.max_wall > 0.0 && wall > options_.max_wall) {
      stop(RunStatus::kWallTime, ErrorCode::kWallTime,
           format("wall time limit of %.3g s reached at t = %.6g s", options_.max_wall, now));
      return false;
    }
    if (state_.progress && wall >= state_.next_report) {
      state_.next_report = wall + 0.05;
      if (!state_.progress(now)) {
        stop(RunStatus::kInterrupted, ErrorCode::kInterrupted,
             format("interrupted at t = %.6g s", now));
        return false;
      }
    }
    return true;
  }

  void stop(RunStatus status, ErrorCode code, std::string why) {
    state_.result.status = status;
    state_.result.code = code;
    state_.result.message = std::move(why);
  }

  void fail_at(double t, ErrorCode code, const std::string& why) {
    stop(RunStatus::kFailed, code, format("failed at t = %.9g s: %s", t, why.c_str()));
  }

  /// Which law gives no number where the motion would go on from here, if one does.
  std::string broken_law(const Integrator& integrator) {
    const auto y = integrator.state();
    std::vector<double> ahead(y.begin(), y.end());
    std::vector<double> rate(y.size());
    std::vector<double> change(y.size());
    const double t = integrator.time();
    system_.rhs(t, y, rate);
    for (const double h : {0.0, 1e-12, 1e-10, 1e-8, 1e-6}) {
      for (std::size_t i = 0; i < y.size(); ++i) ahead[i] = y[i] + h * rate[i];
      system_.rhs(t, ahead, change);
      const Mechanism& m = system_.mechanism();
      for (std::size_t i = 0; i < m.contacts.size(); ++i) {
        const ContactState& s = system_.dynamics().contacts()[i];
        if (!s.closed || std::isfinite(s.law.force + s.law.d_compression + s.law.d_rate)) continue;
        return format(
            "; law \"%s\" of %s gives force %g N with slopes %g N/m, %g N s/m at "
            "compression %.6g m, rate %.6g m/s",
            m.contacts[i].law.name().c_str(), m.contacts[i].name.c_str(), s.law.force,
            s.law.d_compression, s.law.d_rate, s.compression, s.rate);
      }
    }
    return "";
  }

  /// Keeps the state and the contact that limit the step, and tells the contact.
  std::string name_limit(Integrator& integrator) {
    const std::size_t state = integrator.limiting_state();
    const int contact = system_.stiffest_contact(state);
    state_.result.failed_state = system_.state_name(state);
    if (contact < 0) return "";
    state_.result.failed_contact = mechanism_->contacts[as_index(contact)].name;
    return ", stiffest contact there " + state_.result.failed_contact;
  }

  void fail(Integrator& integrator, ErrorCode code, const std::string& why) {
    const std::string where = name_limit(integrator);
    stop(RunStatus::kFailed, code,
         format("integration stopped at t = %.9g s (step %.3g s): %s; largest error in state %s",
                integrator.time(), integrator.last_step(), why.c_str(),
                state_.result.failed_state.c_str()) +
             where + broken_law(integrator));
  }

  void finish(Integrator& integrator) {
    const auto y = integrator.state();
    state_.result.reached = integrator.time();
    state_.result.end.time = integrator.time();
    state_.result.end.y.assign(whole_size_, 0.0);
    write_whole(state_.result.reached, y, state_.result.end.y);
    state_.result.end.largest_compression = system_.dynamics().memories();
    for (const auto* each : {whole_.get(), apart_.get()}) {
      if (each != nullptr) state_.result.counts += each->counts();
    }
    state_.result.event_evaluations = locator_.evaluations();
    for (const auto& watch : state_.watches) state_.result.peaks.push_back(watch.peak());
    const auto rows = static_cast<Eigen::Index>(state_.rows);
    if (options_.outputs) {
      state_.result.time.conservativeResize(rows);
      state_.result.data.conservativeResize(rows, Eigen::NoChange);
      if (options_.states) state_.result.states.conservativeResize(rows, Eigen::NoChange);
      state_.result.ledger.conservativeResize(rows, Eigen::NoChange);
    }
    look_for_nan(state_.result.end.y, [&](std::size_t i) { return system_.state_name(i); });
    if (!state_.broken.empty() && state_.result.status == RunStatus::kDone)
      fail_at(state_.result.reached, ErrorCode::kNotFinite, state_.broken);
    balance();
    const auto event_rows = static_cast<Eigen::Index>(state_.result.events.size());
    state_.result.event_states.conservativeResize(event_rows, 2 * system_.coordinates());
    const auto contacts = static_cast<Eigen::Index>(system_.mechanism().contacts.size());
    state_.result.event_compression.conservativeResize(event_rows, contacts);
    state_.result.event_approach.conservativeResize(event_rows, contacts);
    rank(
        state_.state_counts, [&](std::size_t i) { return system_.state_name(i); },
        state_.result.limiting_states);
    rank(
        state_.contact_counts, [&](std::size_t i) { return system_.mechanism().contacts[i].name; },
        state_.result.limiting_contacts);
    state_.result.wall = std::chrono::duration<double>(Clock::now() - state_.begin).count();
  }

  /// What of the energy is missing, over all samples.
  void balance() {
    if (!options_.outputs || !options_.ledger || state_.rows == 0) return;
    const Eigen::Index first =
        static_cast<Eigen::Index>(state_.result.names.size()) - Channels::kStoredParts;
    const Eigen::Map<const Eigen::RowVectorXd> start(state_.result.start.data() + first,
                                                     Channels::kStoredParts);
    const RowMatrix stored = state_.result.data.rightCols(Channels::kStoredParts).rowwise() - start;
    const Eigen::Index losses = state_.result.ledger.cols() - 2;
    const Eigen::VectorXd residual = state_.result.ledger.col(0) - stored.rowwise().sum() -
                                     state_.result.ledger.rightCols(losses).rowwise().sum();
    LedgerBalance& b = state_.result.balance;
    b.residual = residual[residual.size() - 1];
    b.residual_largest = residual.cwiseAbs().maxCoeff();
    // Each of these passed through the mechanism at least once; they are the same energy at other
    // times and in other places, so they do not add up. Kinetic energy counts from rest.
    const auto last = state_.result.ledger.row(state_.result.ledger.rows() - 1);
    b.turned_over = std::max(
        {last[1], last.tail(losses).cwiseAbs().sum(), stored.cwiseAbs().maxCoeff(),
         state_.result.data.rightCols(Channels::kStoredParts).col(0).maxCoeff(), start[0]});
    // What rounding and tolerance leave over is nothing.
    const double least =
        options_.rtol * kLedgerTolerance * static_cast<double>(state_.result.ledger.cols());
    b.residual_relative = b.residual_largest / std::max(b.turned_over, least);
    if (state_.result.status != RunStatus::kDone ||
        !(b.residual_relative > options_.ledger_limit)) {
      return;
    }
    stop(RunStatus::kFailed, ErrorCode::kEnergyBalance,
         format(
             "the energy balance error reaches %.3g J, %.3g %% of the exchanged energy of %.3g J, "
             "expected at most %.3g %% (ledger_limit); use a smaller rtol",
             b.residual_largest, 100.0 * b.residual_relative, b.turned_over,
             100.0 * options_.ledger_limit));
  }

  template <class Name>
  static void rank(const std::vector<long>& counts, Name&& name,
                   std::vector<std::pair<std::string, long>>& out) {
    for (std::size_t i = 0; i < counts.size(); ++i) {
      if (counts[i] > 0) out.emplace_back(name(i), counts[i]);
    }
    std::stable_sort(out.begin(), out.end(),
                     [](const auto& a, const auto& b) { return a.second > b.second; });
  }

  // The same in all runs.
  const SimulationOptions options_;
  const std::shared_ptr<const Mechanism> mechanism_;
  const bool modal_;                      ///< strings that are free are advanced exactly
  std::vector<std::size_t> remembering_;  ///< contacts whose laws have memory
  bool recovering_ = false;               ///< one of these forgets
  std::vector<int> watched_;              ///< contacts whose largest force is sought
  double finger_reference_;               ///< NaN: the place at the start of each
  Channels channels_;

  // Workspaces.
  MechanismSystem system_;
  const std::size_t whole_size_;  ///< of the state with all strings
  EventLocator locator_;
  std::unique_ptr<Integrator> whole_, apart_;
  std::vector<double> scratch_;
  std::vector<double> power_;         ///< rates of the ledger [W]
  std::vector<double> power_at_end_;  ///< of a step with jumps
  std::vector<double> passes_;        ///< times of these jumps [s]
  std::vector<double> felt_after_;    ///< as felt_before, at the end of the step
  std::vector<std::size_t> turned_;   ///< of remembering_, in the last step; kept for its memory
  std::vector<double> ledger_scratch_;

  RunState state_;
};

/// Options of a stepper as those of its runs.
SimulationOptions for_steps(const StepperOptions& o) {
  SimulationOptions out;
  out.rtol = o.rtol;
  out.method = o.method;
  out.max_order = o.max_order;
  out.max_step = o.max_step;
  out.max_wall = o.max_wall;
  out.events = o.events;
  out.finger_reference = o.finger_reference;
  out.ledger = out.outputs = out.states = out.diagnose = false;
  check(out);
  return out;
}

/// Input that goes on from a drive; for what is read at its start.
Profile going_on(const StepDrive& drive) {
  // A line would be a motion with corners.
  if (is_prescribed(drive.kind) || drive.acceleration != 0.0) {
    return Profile::cubic({drive.value, drive.rate, 0.5 * drive.acceleration, 0.0}, 1.0);
  }
  if (drive.rate != 0.0) {
    return Profile({0.0, 1.0}, {drive.value, drive.value + drive.rate},
                   Profile::Interpolation::kLinear);
  }
  return Profile({0.0}, {drive.value}, Profile::Interpolation::kLinear);
}

}  // namespace

struct Stepper::Impl {
  Impl(const std::shared_ptr<const Mechanism>& mechanism, InputKind input,
       const StepperOptions& options, const std::vector<Monitor>& monitors, StepState rest)
      : kind(input),
        state(std::move(rest)),
        simulator(mechanism, InputSignal{going_on({}), input}, for_steps(options), state.machine,
                  monitors, Progress{}),
        channels(*mechanism) {
    simulator.prepare_steps();
    const auto [place, speed] = simulator.system().driven_place(0.0, state.machine.y);
    reference = place;
    state.drive = {};
  }

  /// Place and speed of what a motion moves, counted from the rest.
  std::pair<double, double> driven() {
    simulator.join_strings();
    auto [place, speed] = simulator.system().driven_place(0.0, state.machine.y);
    const double origin = is_prescribed(kind) ? reference : simulator.system().finger_reference();
    return {place - origin, speed};
  }

  Profile over_step(double duration, const StepInput& input, Hold hold) {
    if (is_prescribed(kind)) {
      const auto [place, speed] = driven();
      const double mean = (input.value - place) / duration;
      // The rate at the end of a motion sampled with this step, in second order.
      const double end =
          std::isnan(input.rate) ? mean + 0.5 * (mean - state.drive.mean) : input.rate;
      return Profile::cubic({place, speed, (3.0 * mean - 2.0 * speed - end) / duration,
                             (speed + end - 2.0 * mean) / (duration * duration)},
                            duration);
    }
    if (hold == Hold::kZero) {
      return Profile({0.0}, {input.value}, Profile::Interpolation::kLinear);
    }
    // Goes on beyond the step: its end is no corner of this input.
    return Profile({0.0, 2.0 * duration},
                   {state.drive.value, 2.0 * input.value - state.drive.value},
                   Profile::Interpolation::kLinear);
  }

  InputKind kind;
  StepState state;
  Simulator simulator;
  Channels channels;
  double reference = 0.0;  ///< place from which a prescribed motion counts
  long state_steps = 0;    ///< of the integrators so far
  bool observed = false;
  std::vector<double> outputs;
  std::vector<double> forces;  ///< of the contacts, with the outputs
};

Stepper::Stepper(const std::shared_ptr<const Mechanism>& mechanism, InputKind kind,
                 const StepperOptions& options, const std::vector<Monitor>& monitors) {
  StepState rest;
  rest.machine = SimulationState::of(find_equilibrium(mechanism));
  rest.drive.kind = kind;
  impl_ = std::make_unique<Impl>(mechanism, kind, options, monitors, std::move(rest));
  impl_->state.drive.kind = kind;
  rest_ = impl_->state;
}

Stepper::~Stepper() = default;

const StepState& Stepper::state() const { return impl_->state; }

void Stepper::set_state(const StepState& state) {
  Impl& d = *impl_;
  state.machine.check(d.simulator.system().mechanism(), rest_.machine.y.size());
  for (const double number : {state.machine.time, state.drive.value, state.drive.rate,
                              state.drive.acceleration, state.drive.mean}) {
    if (!std::isfinite(number)) {
      throw InvalidParameter(format("state: time or input is %.6g, expected finite", number));
    }
  }
  d.state = state;
  d.observed = false;
  if (state.drive.kind == d.kind) return;
  d.state.drive = {};
  d.state.drive.kind = d.kind;
  if (!is_motion(d.kind)) return;
  const auto [place, speed] = d.driven();
  d.state.drive.value = place;
  d.state.drive.rate = d.state.drive.mean = speed;
}

StepResult Stepper::advance(double duration, const StepInput& input, Hold hold,
                            const Progress& progress) {
  Impl& d = *impl_;
  if (!(std::isfinite(duration) && duration > 0.0)) {
    throw InvalidParameter(format("advance: duration = %.6g s, must be > 0", duration));
  }
  if (!std::isfinite(input.value) || std::isinf(input.rate)) {
    throw InvalidParameter(
        format("advance: input %.6g with rate %.6g, must be finite", input.value, input.rate));
  }
  const Profile profile = d.over_step(duration, input, hold);
  const double mean = (profile.value(duration) - profile.value(0.0)) / duration;
  RunResult done = d.simulator.again({profile, d.kind}, d.state.machine, duration, progress);
  StepResult out;
  out.status = done.status;
  out.code = done.code;
  out.message = std::move(done.message);
  out.failed_state = std::move(done.failed_state);
  out.failed_contact = std::move(done.failed_contact);
  out.steps = done.counts.steps - d.state_steps;
  d.state_steps = done.counts.steps;
  if (done.status != RunStatus::kDone) return out;
  const double begin = d.state.machine.time;
  out.events = std::move(done.events);
  for (SimulationEvent& event : out.events) event.time += begin;
  for (const Peak& peak : done.peaks) out.peaks.push_back(peak.force);
  d.state.machine = std::move(done.end);
  d.state.machine.time = begin + duration;
  d.state.drive = {d.kind, profile.value(duration), profile.rate(duration),
                   is_prescribed(d.kind) ? profile.acceleration(duration) : 0.0, mean};
  d.observed = false;
  return out;
}

std::span<const double> Stepper::outputs() {
  Impl& d = *impl_;
  if (d.observed) return d.outputs;
  d.simulator.join_strings();
  MechanismSystem& system = d.simulator.system();
  system.dynamics().set_memories(d.state.machine.largest_compression);
  Profile profile = going_on(d.state.drive);
  if (is_prescribed(d.kind)) {
    // The reaction is that of a motion which holds here: errors of a step are not to be corrected.
    const auto [place, speed] = d.driven();
    profile = going_on({d.kind, place, speed, d.state.drive.acceleration, 0.0});
  }
  system.set_input({profile, d.kind});
  system.set_prescribed_reference(0.0, d.state.machine.y);
  d.outputs.resize(d.channels.size());
  d.channels.observe(system, 0.0, d.state.machine.y, d.outputs);
  d.forces.clear();
  for (const ContactState& contact : system.dynamics().contacts()) {
    d.forces.push_back(contact.closed ? contact.law.force : 0.0);
  }
  d.observed = true;
  return d.outputs;
}

void Stepper::watch_peaks() { impl_->simulator.watch_all(); }

std::span<const double> Stepper::forces() {
  outputs();
  return impl_->forces;
}

const Channels& Stepper::channels() const { return impl_->channels; }

void RunResult::name_outputs(const Channels& channels) {
  for (const Channel& channel : channels.rows()) {
    names.push_back(channel.name);
    units.push_back(channel.unit);
    long_names.push_back(channel.text);
  }
}

RunResult simulate(const std::shared_ptr<const Mechanism>& mechanism, const InputSignal& input,
                   const SimulationOptions& options, const SimulationState& start,
                   const std::vector<Monitor>& monitors, const Progress& progress) {
  check(options);
  if (options.method == Method::kModal && mechanism->strings.empty()) {
    throw InvalidParameter("method = \"modal\": mechanism \"" + mechanism->name +
                           "\" has no string with modes; use \"auto\" or \"cvode\"");
  }
  const bool samples_only = !options.ledger && !options.events && monitors.empty();
  if (options.method != Method::kCvode && !mechanism->strings.empty() && samples_only) {
    if (auto machine = LinearMachine::of(*mechanism)) {
      return simulate_linear(mechanism, std::move(*machine), options, start, progress);
    }
  }
  return Simulator(mechanism, input, options, start, monitors, progress).run();
}

}  // namespace feltmb
