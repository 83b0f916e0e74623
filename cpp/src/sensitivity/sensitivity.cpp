#include "feltmb/sensitivity/sensitivity.hpp"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <iterator>
#include <map>
#include <mutex>
#include <numeric>
#include <optional>
#include <thread>

#include "feltmb/core/error.hpp"
#include "feltmb/core/index.hpp"
#include "feltmb/model/channels.hpp"
#include "feltmb/numeric/parallel.hpp"
#include "feltmb/sensitivity/trajectory.hpp"
#include "looks.hpp"
#include "shifted_models.hpp"
#include "switches.hpp"
#include "variational.hpp"

namespace feltmb {
namespace {

using Clock = std::chrono::steady_clock;
using detail::Columns;
using detail::ShiftedModels;
using detail::Switch;
using detail::SwitchKind;

Eigen::Index index(std::size_t i) { return static_cast<Eigen::Index>(i); }

void check(const std::vector<SensitivitySegment>& segments, const SensitivityOptions& options,
           std::size_t parameters) {
  if (!(options.tolerance > 0.0 && options.tolerance <= 0.1)) {
    throw InvalidParameter(format("tolerance = %.6g, must be in (0, 0.1]", options.tolerance));
  }
  if (!(std::isfinite(options.output_rate) && options.output_rate > 0.0)) {
    throw InvalidParameter(format("output_rate = %.6g Hz, must be > 0", options.output_rate));
  }
  for (std::size_t i = 0; i < segments.size(); ++i) {
    const SensitivitySegment& w = segments[i];
    if (!(std::isfinite(w.begin) && std::isfinite(w.end) && w.end > w.begin)) {
      throw InvalidParameter(format("segment %zu: from %.6g s to %.6g s, must end after it begins",
                                    i, w.begin, w.end));
    }
    const double count = (w.end - w.begin) * options.output_rate;
    const auto columns = parameters + static_cast<std::size_t>(w.directions.cols());
    check_samples(options.output_rate, w.end - w.begin, count,
                  static_cast<double>(1 + options.outputs.size() * (1 + columns)));
  }
}

/// One segment: the stroke, then its derivatives.
class SegmentRun {
 public:
  SegmentRun(ShiftedModels& models, const std::shared_ptr<const Mechanism>& mechanism,
             const InputSignal& input, const SensitivityOptions& options,
             const SensitivitySegment& segment, const Progress& progress)
      : models_(models),
        mechanism_(mechanism),
        input_(input),
        options_(options),
        segment_(segment),
        progress_(progress) {}

  SensitivityResult run() {
    const auto begin = Clock::now();
    const std::size_t states = models_.base().size();
    const auto width = static_cast<std::size_t>(segment_.directions.cols());
    if (width > 0 && segment_.directions.rows() != index(states)) {
      throw InvalidParameter(format("directions of the start state: got %ld rows, expected %zu",
                                    static_cast<long>(segment_.directions.rows()), states));
    }
    const bool from_rest = segment_.start.y.empty();
    const SimulationState start = from_rest ? models_.rest() : segment_.start;
    if (start.y.size() != states) {
      throw InvalidParameter(format("start state: got %zu values, expected %zu of this mechanism",
                                    start.y.size(), states));
    }
    const auto parameters = index(models_.parameters());
    RowMatrix moves = from_rest ? models_.rest_columns().state : RowMatrix(segment_.moves);
    if (moves.size() == 0) moves.setZero(index(states), parameters);
    if (moves.rows() != index(states) || moves.cols() != parameters) {
      throw InvalidParameter(format("moves of the start state: got %ld by %ld, expected %zu by %ld",
                                    static_cast<long>(moves.rows()),
                                    static_cast<long>(moves.cols()), states,
                                    static_cast<long>(parameters)));
    }
    models_.begin(segment_.begin, width, start.y, moves);
    input_.origin += segment_.begin;
    Trajectory trajectory(models_.probe());
    simulate_stroke(trajectory, start);
    const auto middle = Clock::now();
    result_.wall_stroke = std::chrono::duration<double>(middle - begin).count();
    if (result_.run.status != RunStatus::kDone) return std::move(result_);

    detail::Variational variational(models_, trajectory, options_.tolerance);
    Columns& columns = variational.columns();
    columns.state.leftCols(parameters) = moves;
    if (from_rest) columns.memory.leftCols(parameters) = models_.rest_columns().memory;
    if (width > 0) columns.state.rightCols(index(width)) = segment_.directions;

    const long before = models_.evaluations();
    const auto switches = detail::find_switches(trajectory, models_, options_, input_);
    channels_ = Channels(*mechanism_);
    looks_.emplace(trajectory, models_, channels_, switches);
    prepare_looks();
    prepare_samples();
    std::size_t next = 0;
    y_.resize(states);
    const auto sample = [&](double t, const Columns& now) {
      report(t);
      take(trajectory, t, now);
      if (std::binary_search(look_times_.begin(), look_times_.end(), t)) {
        looks_->take(t, now, variational.shift(), variational.version());
      }
    };
    if (!marks_.empty() && marks_[0] == 0.0) {
      sample(0.0, columns);
      ++next;
    }
    constexpr double together = 1e-13;  // s
    for (const Switch& s : switches) {
      report(s.time);
      if (s.time > variational.time() + together) {
        variational.advance(s.time, marks_, next, sample);
      }
      if (s.kind == SwitchKind::kEnd) continue;
      if (s.kind != SwitchKind::kZone) variational.turn();  // friction is smooth
      pass(trajectory, s, columns);
      if (s.kind == SwitchKind::kClosing && is_sought(s.index)) {
        const bool shifts = s.direction > 0 && time_derivative_.allFinite();
        variational.follow(shifts ? time_derivative_ : Eigen::VectorXd());
      }
    }
    result_.end_state = columns.state;
    result_.end_memory = columns.memory;
    auto looked = looks_->finish();
    const auto peaks = static_cast<std::ptrdiff_t>(result_.run.peaks.size());
    std::move(looked.begin(), looked.begin() + peaks, std::back_inserter(result_.peaks));
    std::move(looked.begin() + peaks, looked.end(), std::back_inserter(result_.looks));
    const long jumps = result_.counts.jumps;
    result_.counts = variational.counts();
    result_.counts.jumps = jumps;
    result_.counts.rhs = models_.evaluations() - before;
    result_.counts.switches = static_cast<long>(switches.size()) - 1;
    result_.wall = std::chrono::duration<double>(Clock::now() - middle).count();
    return std::move(result_);
  }

 private:
  /// Ten times a second; simulate() has its own.
  void report(double t) {
    const auto now = Clock::now();
    if (!progress_ || now - reported_ < std::chrono::milliseconds(100)) return;
    reported_ = now;
    if (!progress_(t)) throw Error("sensitivities: stopped", ErrorCode::kInterrupted);
  }

  void simulate_stroke(Trajectory& trajectory, const SimulationState& start) {
    SimulationOptions o = options_.simulation;
    o.duration = segment_.end - segment_.begin;
    o.ledger = o.states = o.diagnose = false;
    o.outputs = false;
    o.finger_reference = models_.base().finger_reference();
    o.on_step = [&](double t, std::span<const double> y, std::span<const double> memory,
                    bool free) { trajectory.add(t, y, memory, free); };
    std::vector<Monitor> monitors;
    for (std::size_t r = 0; r < options_.rules.size(); ++r) {
      const auto& rule = options_.rules[r];
      monitors.push_back({rule.name, rule.point, rule.direction, models_.level(r, -1, 0)});
    }
    result_.run = simulate(mechanism_, input_, o, start, monitors, progress_);
  }

  /// The extrema and values that are wanted beside the samples.
  void prepare_looks() {
    const double duration = segment_.end - segment_.begin;
    for (const Peak& peak : result_.run.peaks) {
      looks_->add({-1, 0.0, duration, 1}, peak.contact);
    }
    if (!options_.looks) return;
    for (const SensitivityRequest& look : options_.looks(result_.run)) {
      if (look.output < 0 || as_index(look.output) >= channels_.size()) {
        throw InvalidParameter(format("looks: there is no output %d", look.output));
      }
      looks_->add(look);
    }
  }

  void prepare_samples() {
    const double duration = segment_.end - segment_.begin;
    const auto count =
        static_cast<std::size_t>(std::floor(duration * options_.output_rate * (1.0 + 1e-12)));
    std::vector<double> times;
    for (std::size_t i = 0; i <= count; ++i) {
      times.push_back(std::min(static_cast<double>(i) / options_.output_rate, duration));
    }
    if (times.back() < duration) times.push_back(duration);
    look_times_ = looks_->times();
    std::set_union(times.begin(), times.end(), look_times_.begin(), look_times_.end(),
                   std::back_inserter(marks_));
    for (const int output : options_.outputs) {
      if (output < 0 || as_index(output) >= channels_.size()) {
        throw InvalidParameter(format("outputs: there is no output %d", output));
      }
      places_only_ = places_only_ && channels_.rows()[as_index(output)].place;
      // Order of Channels.
      const int states = 2 * mechanism_->size();
      const int beyond = output - states;
      if (beyond >= 0 && beyond % 4 > 1) positions_only_ = false;
      positions_.push_back(
          beyond < 0 ? ShiftedModels::PlaceOf{output, -1, {}}
                     : ShiftedModels::PlaceOf{-1, beyond / 4,
                                              beyond % 4 == 0 ? Vec2{1.0, 0.0} : Vec2{0.0, 1.0}});
    }
    positions_only_ = positions_only_ && places_only_;
    result_.time = Eigen::Map<const Eigen::VectorXd>(times.data(), index(times.size()));
    result_.time.array() += segment_.begin;
    result_.values.resize(index(times.size()), index(options_.outputs.size()));
    result_.gradient.resize(times.size() * options_.outputs.size() * models_.columns());
  }

  std::span<const double> place(Trajectory& trajectory, double t) {
    const std::size_t node = trajectory.interpolate_all(t, y_);
    return trajectory.memory(node);
  }

  void take(Trajectory& trajectory, double t, const Columns& columns) {
    const auto memory = place(trajectory, t);
    if (row_ >= result_.time.size() || result_.time[row_] - segment_.begin != local_time(t)) return;
    const std::size_t outputs = options_.outputs.size();
    if (outputs > 0) {
      scratch_.resize(channels_.size());
      const auto look = [&](MechanismSystem& system, double time, std::span<const double> y) {
        if (places_only_) {
          channels_.observe_places(system, y, scratch_);
        } else {
          channels_.observe(system, time, y, scratch_);
        }
      };
      const auto look_all = [&](MechanismSystem& system, double time, std::span<const double> y,
                                std::span<double> out, int, std::size_t) {
        look(system, time, y);
        for (std::size_t i = 0; i < outputs; ++i) out[i] = scratch_[as_index(options_.outputs[i])];
      };
      if (positions_only_) {
        models_.places(y_, columns.state, positions_, derivative_);
      } else {
        models_.total(t, y_, memory, columns, outputs, look_all, derivative_);
      }
      look(models_.probe(), t, y_);
      const std::size_t count = models_.columns();
      double* out = result_.gradient.data() + static_cast<std::size_t>(row_) * outputs * count;
      for (std::size_t i = 0; i < outputs; ++i) {
        result_.values(row_, index(i)) = scratch_[as_index(options_.outputs[i])];
        for (std::size_t j = 0; j < count; ++j) *out++ = derivative_(index(i), index(j));
      }
    }
    ++row_;
  }

  bool is_sought(int contact) const {
    const auto& peaks = result_.run.peaks;
    return std::any_of(peaks.begin(), peaks.end(),
                       [&](const Peak& peak) { return peak.contact == contact; });
  }

  /// As it went through result_.time: adding and subtracting the begin rounds.
  double local_time(double t) const { return (t + segment_.begin) - segment_.begin; }

  /// Compressions, approaches, coordinate rates, monitors: what an event is described by.
  void describe(MechanismSystem& system, double t, std::span<const double> y, std::span<double> out,
                int parameter, std::size_t node) const {
    system.locate(t, y, Detail::kAllContacts);
    const auto contacts = system.dynamics().contacts();
    std::size_t i = 0;
    for (const ContactState& c : contacts) {
      out[i++] = c.compression;
      out[i++] = -dot(c.normal, c.relative_velocity);
      out[i++] = c.rate;
    }
    const std::size_t n = system.mechanism().coordinates.size();
    for (std::size_t k = 0; k < n; ++k) out[i++] = y[n + k];
    for (std::size_t r = 0; r < options_.rules.size(); ++r) {
      const auto& rule = options_.rules[r];
      const auto& point = system.mechanism().points[as_index(rule.point)].point;
      out[i++] = dot(rule.direction, system.dynamics().position(point)) -
                 models_.level(r, parameter, node);
    }
  }

  std::size_t described() const {
    return 3 * mechanism_->contacts.size() + mechanism_->coordinates.size() + options_.rules.size();
  }

  /// Row of `describe` that is zero at the switch.
  std::size_t row_of(const Switch& s) const {
    if (s.kind == SwitchKind::kMonitor) {
      return 3 * mechanism_->contacts.size() + mechanism_->coordinates.size() + as_index(s.index);
    }
    return 3 * as_index(s.index) + (s.kind == SwitchKind::kBranch ? 2 : 0);
  }

  /// Passes a switch: derivatives of its event, jumps of the columns.
  void pass(Trajectory& trajectory, const Switch& s, Columns& columns) {
    if (s.kind == SwitchKind::kZone) return;
    if (s.kind == SwitchKind::kReversal) {
      pass_reversal(trajectory, s, columns);
      return;
    }
    const double t = s.time;
    const double end = trajectory.time(trajectory.size() - 1);
    if (s.kind == SwitchKind::kStop) {
      if (find_jump(trajectory, t, end)) {
        models_.stop_time(as_index(s.index), time_derivative_);
        add_jump(columns);
      }
      return;
    }
    const bool event = s.kind != SwitchKind::kBranch;
    if (!event && as_index(s.index) >= mechanism_->contacts.size())
      return;  // a strap: never a jump
    // A law that changes its piece where its contact closes jumps once.
    const bool jump = t - last_jump_ > 1e-11 && find_jump(trajectory, t, end);
    if (!event && !jump) return;

    const auto describe_all = [&](MechanismSystem& system, double time, std::span<const double> y,
                                  std::span<double> out, int parameter, std::size_t node) {
      describe(system, time, y, out, parameter, node);
    };
    const std::size_t width = described();
    const auto memory = place(trajectory, t);
    models_.total(t, y_, memory, columns, width, describe_all, derivative_);
    // Rates of what is described along the motion, on the side before the switch where it turns on.
    const double delta = std::min(1e-8, 0.25 * t);
    Eigen::VectorXd here(index(width)), before(index(width)), earlier(index(width));
    const auto look = [&](double time, Eigen::VectorXd& out) {
      place(trajectory, time);
      describe(models_.probe(), time, y_, {out.data(), width}, -1, 0);
    };
    look(t, here);
    look(t - delta, before);
    look(t - 2.0 * delta, earlier);
    const Eigen::VectorXd along = (1.5 * here - 2.0 * before + 0.5 * earlier) / delta;
    const auto row = index(row_of(s));
    const double speed = along[row];
    const bool known = std::fabs(speed) > 1e-9;
    if (known) {
      time_derivative_ = -derivative_.row(row).transpose() / speed;
    } else {
      time_derivative_.setConstant(derivative_.cols(), std::nan(""));
    }
    if (event) record(s, along, known);
    if (jump && known) {
      add_jump(columns);
      last_jump_ = t;
    }
  }

  void pass_reversal(Trajectory& trajectory, const Switch& s, Columns& columns) {
    // The top of a compression: its time moves, the compression itself does not by that, nor does
    // what the virgin loading that ends there makes of the states of the law.
    const auto contact = as_index(s.index);
    const std::size_t states = mechanism_->contacts[contact].law.n_states();
    const std::size_t node = trajectory.interval(s.time - 1e-12);
    const auto memory = trajectory.memory(node);
    trajectory.interpolate(s.time, y_);
    const auto felt = [&](MechanismSystem& system, double time, std::span<const double> y,
                          std::span<double> out, int, std::size_t) {
      system.locate(time, y, Detail::kAllContacts);
      const ContactState& state = system.dynamics().contacts()[contact];
      const ContactLaw& law = system.mechanism().contacts[contact].law;
      const LawMemory own = system.dynamics().memory(contact);
      out[0] = law.felt_compression(state.compression, own);
      std::copy_n(own.state, states, out.begin() + 1);
      law.widen(out[0], own.largest, out.data() + 1);
    };
    models_.total(s.time, y_, memory, columns, 1 + states, felt, derivative_);
    columns.memory.row(index(contact)) = derivative_.row(0);
    const std::size_t first =
        2 * mechanism_->coordinates.size() + as_index(mechanism_->contacts[contact].first_state);
    columns.state.middleRows(index(first), index(states)) =
        derivative_.middleRows(1, index(states));
  }

  /// Jump of the right-hand side at t; true if there is one to speak of.
  bool find_jump(Trajectory& trajectory, double t, double end) {
    const double delta = std::min({1e-9, 0.1 * t, 0.1 * (end - t)});
    if (!(delta > 0.0)) return false;
    // Straight on to t from both sides: a kink cancels.
    MechanismSystem& probe = models_.probe();
    const auto n = index(y_.size());
    jump_.setZero(n);
    after_.resize(n);
    double size = 0.0;
    for (const auto& [place_at, weight] : {std::pair{t - delta, 2.0},
                                           {t - 2.0 * delta, -1.0},
                                           {t + delta, -2.0},
                                           {t + 2.0 * delta, 1.0}}) {
      place(trajectory, place_at);
      probe.rhs(place_at, y_, {after_.data(), y_.size()});
      jump_ += weight * after_;
      size = std::max(size, models_.norm(after_));
    }
    // Of what a contact decelerates by: 1e-3 of 0.2 m/s in 1 ms is rounding and curvature.
    return models_.norm(jump_) > 1e-4 * size + 1.0;
  }

  void add_jump(Columns& columns) {
    columns.state += jump_ * time_derivative_.transpose();
    ++result_.counts.jumps;
  }

  void record(const Switch& s, const Eigen::VectorXd& along, bool known) {
    // The event of the stroke that this switch is.
    const SimulationEvent* found = nullptr;
    double nearest = 1e-6;  // s
    for (const SimulationEvent& e : result_.run.events) {
      const int own = s.kind == SwitchKind::kMonitor ? e.monitor : e.contact;
      if (own != s.index || e.direction != s.direction) continue;
      if (std::fabs(e.time - s.time) < nearest) {
        nearest = std::fabs(e.time - s.time);
        found = &e;
      }
    }
    if (found == nullptr) return;
    SensitivityEvent out;
    out.event = *found;
    out.known = known;
    out.time = time_derivative_;
    const auto count = index(models_.columns());
    const auto contacts = index(mechanism_->contacts.size());
    const auto n = index(mechanism_->coordinates.size());
    out.compression.resize(contacts, count);
    out.approach.resize(contacts, count);
    out.rate.resize(n, count);
    const auto moved = [&](Eigen::Index i) {
      return derivative_.row(i) + along[i] * time_derivative_.transpose();
    };
    for (Eigen::Index c = 0; c < contacts; ++c) {
      out.compression.row(c) = moved(3 * c);
      out.approach.row(c) = moved(3 * c + 1);
    }
    for (Eigen::Index k = 0; k < n; ++k) out.rate.row(k) = moved(3 * contacts + k);
    out.event.time += segment_.begin;
    result_.events.push_back(std::move(out));
  }

  ShiftedModels& models_;
  std::shared_ptr<const Mechanism> mechanism_;
  InputSignal input_;
  const SensitivityOptions& options_;
  const SensitivitySegment& segment_;
  Progress progress_;
  Clock::time_point reported_{};
  SensitivityResult result_;
  std::vector<double> y_;
  std::vector<double> marks_;
  std::vector<double> look_times_;
  std::optional<detail::Looks> looks_;
  double last_jump_ = -1.0;
  Eigen::Index row_ = 0;
  Channels channels_;
  bool places_only_ = true;     ///< no output is wanted that needs the forces
  bool positions_only_ = true;  ///< nor one that is the speed of a point
  std::vector<ShiftedModels::PlaceOf> positions_;
  std::vector<double> scratch_;
  Eigen::MatrixXd derivative_;
  Eigen::VectorXd jump_, after_, time_derivative_;
};

}  // namespace

std::vector<SensitivityResult> sensitivities(const std::shared_ptr<const Mechanism>& mechanism,
                                             const InputSignal& input,
                                             const std::vector<SensitivityParameter>& parameters,
                                             const std::vector<SensitivitySegment>& segments,
                                             const SensitivityOptions& options,
                                             const Progress& progress) {
  check(segments, options, parameters.size());
  std::vector<SensitivityResult> results(segments.size());
  const std::size_t threads =
      std::min(resolve_threads(options.threads), std::max<std::size_t>(1, segments.size()));
  std::atomic<std::size_t> next{0};
  std::mutex guard;
  const Progress shared = progress ? Progress([&](double t) {
    const std::lock_guard<std::mutex> lock(guard);
    return progress(t);
  })
                                   : Progress{};
  // A motion of the finger and what is monitored count from the rest pose.
  const bool rest = input.kind == InputKind::kMotion || !options.rules.empty() ||
                    std::any_of(segments.begin(), segments.end(),
                                [](const auto& s) { return s.start.y.empty(); });
  // Workers take the next segment; each has its own workspaces.
  parallel_for(threads, threads, [&](std::size_t, std::size_t) {
    ShiftedModels models(mechanism, input, parameters, options, rest);
    for (std::size_t i = next++; i < segments.size(); i = next++) {
      results[i] = SegmentRun(models, mechanism, input, options, segments[i], shared).run();
    }
  });
  return results;
}

}  // namespace feltmb
