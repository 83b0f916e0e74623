#include "feltmb/model/actuator.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>

#include "feltmb/core/error.hpp"
#include "feltmb/core/index.hpp"
#include "feltmb/model/law_force.hpp"

namespace feltmb {
namespace {

constexpr double kLongestStep = 1e-4;  // s

/// Dashpot as a scalar force along the travel of the tip on a rigid arm.
class DashpotForce final : public modal::ScalarForce {
 public:
  DashpotForce(double damping, bool one_sided) : damping_(damping), one_sided_(one_sided) {}

  Value trial(int stage, double elapsed, double, double rate) override {
    const bool acts = !one_sided_ || rate < 0.0;
    const double force = acts ? damping_ * rate : 0.0;
    stage_[stage] = {elapsed, force * rate};
    return {force, 0.0, acts ? damping_ : 0.0};
  }

  void accept() override {
    const double h = stage_[0].elapsed + stage_[1].elapsed;
    dissipated_ += h / 6.0 * (power_ + 4.0 * stage_[0].power + stage_[1].power);
    power_ = stage_[1].power;
  }

  double dissipated() const { return dissipated_; }

 private:
  struct Stage {
    double elapsed = 0.0, power = 0.0;
  };
  double damping_;  // N s/m
  bool one_sided_;
  Stage stage_[2];
  double power_ = 0.0;
  double dissipated_ = 0.0;
};

enum Output {
  kAngle,
  kAngleRate,
  kTravel,
  kSpeed,
  kDeflection,
  kSlope,
  kTorque,
  kDamper,
  kStopForce,
  kStopCompression,
  kActionForce,
  kFingerForce,
  kKinetic,
  kElastic,
  kStopEnergy,
  kMotorWork,
  kGravityWork,
  kActionWork,
  kStopHeat,
  kDamperHeat,
  kOutputs,
};

struct OutputInfo {
  const char *name, *unit, *text;
};

constexpr OutputInfo kInfo[kOutputs] = {
    {"hub.angle", "rad", "angle of the hub, positive pressing"},
    {"hub.rate", "rad/s", "rate of the hub's angle"},
    {"tip.travel", "m", "travel of the end of the arm, (L + a) theta + w_N"},
    {"tip.speed", "m/s", "speed of the end of the arm"},
    {"tip.deflection", "m", "deflection of the end of the arm against the turning hub, w_N"},
    {"tip.slope", "rad", "slope of the end of the arm against the hub, theta_N"},
    {"motor.torque", "N m", "torque of the motor, positive pressing"},
    {"damper.torque", "N m", "torque of the damper on the hub, against its motion"},
    {"stop.force", "N", "force of the felt stop on the tip"},
    {"stop.compression", "m", "compression of the stop, negative is the gap"},
    {"action.force", "N", "equivalent reaction of the action on the tip"},
    {"finger.force", "N", "force of the tip on the key: stop and action"},
    {"energy.kinetic", "J", "kinetic energy of hub, arm and tip"},
    {"energy.elastic", "J", "elastic energy of the arm"},
    {"energy.stop", "J", "energy stored in the felt"},
    {"work.motor", "J", "work of the motor so far"},
    {"work.gravity", "J", "work of gravity so far"},
    {"work.action", "J", "energy given to the action so far"},
    {"dissipated.stop", "J", "heat in the felt so far"},
    {"dissipated.damper", "J", "heat in the damper so far"},
};

/// Largest size of a signal at a hundred places of a run; never zero, to scale errors by.
double largest_size(const Profile& signal, double duration) {
  constexpr int places = 100;
  double largest = 1e-3;
  for (int i = 0; i <= places; ++i) {
    largest = std::max(largest, std::fabs(signal.value(duration * i / places)));
  }
  return largest;
}

class Run {
 public:
  Run(const Actuator& actuator, const Profile& torque, const ActuatorOptions& options)
      : actuator_(actuator),
        d_(actuator.description()),
        torque_(torque),
        options_(options),
        reach_(actuator.beam().reach()) {
    if (actuator.stop()) stop_.emplace(*actuator.stop());
    if (d_.damper != DamperKind::kNone) {
      damper_.emplace(d_.damping / (reach_ * reach_), d_.damper == DamperKind::kOneSided);
    }
    largest_torque_ = largest_size(torque, options.duration);
  }

  ActuatorRun run() {
    const auto begin = std::chrono::steady_clock::now();
    const double spacing = 1.0 / options_.output_rate;
    const auto samples =
        static_cast<Eigen::Index>(std::floor(options_.duration / spacing * (1.0 + 1e-12)));
    const int parts = std::max(1, static_cast<int>(std::ceil(spacing / kLongestStep - 1e-9)));
    interval_ = spacing / parts;
    out_.time.resize(samples + 1);
    out_.data.setZero(samples + 1, kOutputs);
    for (const OutputInfo& o : kInfo) {
      out_.names.emplace_back(o.name);
      out_.units.emplace_back(o.unit);
      out_.long_names.emplace_back(o.text);
    }
    const Eigen::VectorXd zero = Eigen::VectorXd::Zero(actuator_.beam().size());
    field_ = d_.gravity;
    start(d_.action_mass > 0.0, 0.0, interval_, zero, zero);
    before_ = rates(0.0);
    record(0, 0.0);
    for (Eigen::Index row = 1; row <= samples; ++row) {
      const double from = spacing * static_cast<double>(row - 1);
      for (int part = 0; part < parts; ++part) {
        go_by_corners(from + interval_ * part, from + interval_ * (part + 1));
      }
      record(row, spacing * static_cast<double>(row));
    }
    count();
    out_.wall = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    return std::move(out_);
  }

 private:
  /// What the works are made of, at one instant.
  struct Rates {
    double torque = 0.0;                   ///< T
    double field = 0.0;                    ///< of gravity
    double force = 0.0;                    ///< of the action's table
    double angle = 0.0, speed = 0.0;       ///< theta and its rate
    double lever = 0.0, lever_rate = 0.0;  ///< weight . q and its rate
    double travel = 0.0, tip_speed = 0.0;
  };

  void start(bool loaded, double t, double interval, const Eigen::VectorXd& q,
             const Eigen::VectorXd& rate) {
    count();
    loaded_ = loaded;
    const HubBeam& beam = actuator_.beam();
    modes_ = &actuator_.modes(loaded);
    const Eigen::MatrixXd& shapes = modes_->shapes;
    Eigen::MatrixXd mass = beam.mass();
    if (loaded) mass += d_.action_mass * beam.tip() * beam.tip().transpose();
    hub_ = shapes.row(0).transpose();
    tip_ = shapes.transpose() * beam.tip();
    slope_ = shapes.row(beam.size() - 1).transpose();
    weight_ = shapes.transpose() * beam.weight();
    const Eigen::VectorXd x = shapes.transpose() * (mass * q);
    const Eigen::VectorXd v = shapes.transpose() * (mass * rate);

    const auto as_vector = [](const Eigen::VectorXd& e) {
      return std::vector<double>(e.data(), e.data() + e.size());
    };
    std::vector<modal::ModalContact> contacts;
    stop_index_ = damper_index_ = -1;
    if (stop_) {
      stop_index_ = static_cast<int>(contacts.size());
      contacts.push_back({as_vector(tip_), -d_.gap, &*stop_});
    }
    if (damper_) {
      damper_index_ = static_cast<int>(contacts.size());
      // Its travel is counted so that it is never open.
      contacts.push_back({as_vector(reach_ * hub_), kAlwaysClosed, &*damper_});
    }
    std::vector<modal::ModalDrive> drives;
    drives.push_back(
        {as_vector(hub_), [this](double time) { return torque_.value(time); }, largest_torque_});
    if (d_.gravity != 0.0) {
      drives.push_back(
          {as_vector(weight_), [this](double time) { return field(time); }, std::fabs(d_.gravity)});
    }
    if (d_.action_force) {
      drives.push_back({as_vector(-tip_),
                        [this](double time) { return d_.action_force->value(time); },
                        largest_size(*d_.action_force, options_.duration)});
    }
    modal::ModalStepperOptions o;
    o.interval = interval;
    o.tolerance = options_.tolerance;
    const Eigen::VectorXd& k = modes_->stiffness;
    stepper_.emplace(as_vector(k), std::vector<double>(static_cast<std::size_t>(k.size()), 0.0),
                     std::move(contacts), std::move(drives), o);
    stepper_->start(t, {x.data(), static_cast<std::size_t>(x.size())},
                    {v.data(), static_cast<std::size_t>(v.size())});
  }

  /// Gravity across the turning arm [m/s^2]. Within an interval it goes straight to where the
  /// tangent of the angle leads: continuous, and of second order in 0.1 ms in a cosine that hardly
  /// differs from 1.
  double field(double t) const { return field_ + (t - field_time_) * field_rate_; }

  /// Sets the line of `field` for the interval from `from` to `to` [s].
  void predict_field(double from, double to) {
    field_ = field(from);
    field_time_ = from;
    const double angle = hub_.dot(x()) + (to - from) * hub_.dot(v());
    const double then = d_.linear_gravity ? d_.gravity : d_.gravity * std::cos(angle);
    field_rate_ = to > from ? (then - field_) / (to - from) : 0.0;
  }

  Eigen::Map<const Eigen::VectorXd> x() const {
    return {stepper_->position().data(), static_cast<Eigen::Index>(stepper_->position().size())};
  }
  Eigen::Map<const Eigen::VectorXd> v() const {
    return {stepper_->velocity().data(), static_cast<Eigen::Index>(stepper_->velocity().size())};
  }

  Rates rates(double t) const {
    Rates r;
    r.torque = torque_.value(t);
    r.field = field(t);
    r.angle = hub_.dot(x());
    r.speed = hub_.dot(v());
    r.lever = weight_.dot(x());
    r.lever_rate = weight_.dot(v());
    r.travel = tip_.dot(x());
    r.tip_speed = tip_.dot(v());
    if (d_.action_force) r.force = d_.action_force->value(t);
    return r;
  }

  /// One interval, in pieces over which what drives has no corner.
  void go_by_corners(double from, double to) {
    const double least = 1e-6 * interval_;
    std::vector<double> cuts;
    for (const Profile* drive : {&torque_, d_.action_force ? &*d_.action_force : nullptr}) {
      if (drive == nullptr) continue;
      for (const double t : drive->breakpoints()) {
        if (t > from + least && t < to - least) cuts.push_back(t);
      }
    }
    if (cuts.empty()) {
      go_on(from, to);
      return;
    }
    std::sort(cuts.begin(), cuts.end());
    cuts.push_back(to);
    const auto begin_anew = [this](double t, double interval) {
      const Eigen::VectorXd q = modes_->shapes * x();
      const Eigen::VectorXd rate = modes_->shapes * v();
      start(loaded_, t, interval, q, rate);
    };
    double begin = from;
    for (const double end : cuts) {
      if (end - begin <= least) continue;
      begin_anew(begin, end - begin);
      go_on(begin, end);
      begin = end;
    }
    begin_anew(to, interval_);
  }

  /// One interval of the stepper; the action lets go within the one in which the stop is met.
  void go_on(double from, double to) {
    if (!loaded_ || !stop_) {
      advance(from, to);
      return;
    }
    const Eigen::VectorXd q = modes_->shapes * x();
    const Eigen::VectorXd rate = modes_->shapes * v();
    const LawForce stop_before = *stop_;
    const std::optional<DashpotForce> damper_before = damper_;
    const Rates rates_before = before_;
    const auto work_before = work_;
    const double field_before = field_, field_time_before = field_time_,
                 field_rate_before = field_rate_;
    const std::size_t seen = stepper_->events().size();
    advance(from, to);
    if (stepper_->events().size() == seen) return;
    const double met = std::clamp(stepper_->events()[seen].time, from, to);
    const double least = 1e-6 * interval_;
    *stop_ = stop_before;
    damper_ = damper_before;
    before_ = rates_before;
    work_ = work_before;
    field_ = field_before;
    field_time_ = field_time_before;
    field_rate_ = field_rate_before;
    stepper_.reset();
    Eigen::VectorXd q_met = q;
    Eigen::VectorXd rate_met = rate;
    if (met - from > least) {
      start(true, from, met - from, q, rate);
      advance(from, met);
      q_met = modes_->shapes * x();
      rate_met = modes_->shapes * v();
      stepper_.reset();  // its closing, if it saw one, is that of the next
    }
    const double speed = actuator_.beam().tip().dot(rate_met);
    given_ = 0.5 * d_.action_mass * speed * speed;
    met_ = met;
    out_.events.push_back({met, stop_index_, 1, speed});
    start(false, met, to - met > least ? to - met : interval_, q_met, rate_met);
    before_ = rates(met);
    if (to - met > least) {
      advance(met, to);
      const Eigen::VectorXd q_end = modes_->shapes * x();
      const Eigen::VectorXd rate_end = modes_->shapes * v();
      start(false, to, interval_, q_end, rate_end);
    }
  }

  void advance(double from, double to) {
    predict_field(from, to);
    stepper_->advance();
    // Integrals of T theta' and of the others by parts and the trapezoidal rule with end slopes:
    // what vibrates enters undifferentiated, what drives is straight between its corners.
    const Rates now = rates(to);
    const double h = to - from;
    work_.motor +=
        by_parts(h, before_.torque, now.torque, before_.angle, now.angle, before_.speed, now.speed);
    work_.gravity += by_parts(h, before_.field, now.field, before_.lever, now.lever,
                              before_.lever_rate, now.lever_rate);
    work_.action += by_parts(h, before_.force, now.force, before_.travel, now.travel,
                             before_.tip_speed, now.tip_speed);
    before_ = now;
  }

  /// Integral of a b' over h, a straight in between.
  static double by_parts(double h, double a0, double a1, double b0, double b1, double db0,
                         double db1) {
    const double linear = h > 0.0 ? (a1 - a0) / h : 0.0;
    const double mean = 0.5 * h * (b0 + b1) + h * h / 12.0 * (db0 - db1);
    return a1 * b1 - a0 * b0 - linear * mean;
  }

  void record(Eigen::Index row, double t) {
    auto o = out_.data.row(row);
    out_.time[row] = t;
    const Rates r = rates(t);
    const double stop = stop_index_ >= 0 ? stepper_->force(as_index(stop_index_)) : 0.0;
    const double damper = damper_index_ >= 0 ? stepper_->force(as_index(damper_index_)) : 0.0;
    o[kAngle] = r.angle;
    o[kAngleRate] = r.speed;
    o[kTravel] = r.travel;
    o[kSpeed] = r.tip_speed;
    o[kDeflection] = r.travel - reach_ * r.angle;
    o[kSlope] = slope_.dot(x());
    o[kTorque] = r.torque;
    o[kDamper] = damper * reach_;
    o[kStopForce] = stop;
    o[kStopCompression] = r.travel - d_.gap;
    double action = r.force;
    double carried = 0.0;
    if (loaded_) {
      const Eigen::VectorXd a = hub_ * (r.torque - damper * reach_) + weight_ * r.field -
                                tip_ * (stop + r.force) - modes_->stiffness.cwiseProduct(x());
      action += d_.action_mass * tip_.dot(a);
      carried = 0.5 * d_.action_mass * r.tip_speed * r.tip_speed;
    }
    o[kActionForce] = action;
    o[kFingerForce] = action + stop;
    o[kKinetic] = 0.5 * v().squaredNorm() - carried;
    o[kElastic] = 0.5 * x().dot(modes_->stiffness.cwiseProduct(x()));
    o[kStopEnergy] = stop_ ? stop_->stored() : 0.0;
    o[kMotorWork] = work_.motor;
    o[kGravityWork] = work_.gravity;
    o[kActionWork] = work_.action + (loaded_ ? carried : given_);
    o[kStopHeat] = stop_ ? stop_->dissipated() : 0.0;
    o[kDamperHeat] = damper_ ? damper_->dissipated() : 0.0;
  }

  /// Adds what the stepper has done so far to the result.
  void count() {
    if (!stepper_) return;
    const auto& c = stepper_->counts();
    out_.counts.steps += c.steps;
    out_.counts.rejected += c.rejected;
    out_.counts.free += c.free;
    out_.counts.forces += c.forces;
    for (const auto& event : stepper_->events()) {
      // The closing at which the action let go is known already.
      const bool known = event.direction > 0 && event.time < met_ + 1e-7;
      if (event.contact == stop_index_ && !known) out_.events.push_back(event);
    }
    if (stop_index_ >= 0 && stepper_->largest_force(as_index(stop_index_)) > out_.peak_force) {
      out_.peak_force = stepper_->largest_force(as_index(stop_index_));
      out_.peak_time = stepper_->largest_force_time(as_index(stop_index_));
    }
  }

  static constexpr double kAlwaysClosed = 1e3;  // m

  struct Works {
    double motor = 0.0, gravity = 0.0, action = 0.0;
  };

  const Actuator& actuator_;
  const ActuatorDescription& d_;
  const Profile& torque_;
  ActuatorOptions options_;
  double reach_;
  double largest_torque_;
  double interval_ = 0.0;
  std::optional<LawForce> stop_;
  std::optional<DashpotForce> damper_;
  std::optional<modal::ModalContactStepper> stepper_;
  const HubBeamModes* modes_ = nullptr;
  Eigen::VectorXd hub_, tip_, slope_, weight_;  ///< rows of the outputs, by mode
  int stop_index_ = -1;
  int damper_index_ = -1;
  bool loaded_ = false;
  double field_ = 0.0, field_time_ = 0.0, field_rate_ = 0.0;  ///< of gravity by time
  Rates before_;
  Works work_;
  double given_ = 0.0;  ///< energy that the action took along [J]
  double met_ = -1.0;   ///< when it let go [s]
  ActuatorRun out_;
};

}  // namespace

Actuator::Actuator(const ActuatorDescription& description)
    : description_(description), beam_(description.arm) {
  std::string faults;
  const auto need = [&](bool ok, const std::string& text) {
    if (!ok) faults += "\n  " + text;
  };
  const auto& d = description_;
  need(std::isfinite(d.gravity), "gravity is not finite");
  need(std::isfinite(d.gap) && d.gap >= 0.0, format("gap = %.6g m, must be >= 0", d.gap));
  need(std::isfinite(d.damping) && d.damping >= 0.0,
       format("damping = %.6g N m s/rad, must be >= 0", d.damping));
  need(std::isfinite(d.action_mass) && d.action_mass >= 0.0,
       format("action_mass = %.6g kg, must be >= 0", d.action_mass));
  if (d.stop) {
    try {
      stop_.emplace(*d.stop);
    } catch (const InvalidParameter& error) {
      faults += std::string("\n  stop: ") + error.what();
    }
  }
  if (!faults.empty()) throw InvalidParameter("actuator:" + faults);
  free_ = beam_.modes();
  loaded_ = d.action_mass > 0.0 ? beam_.modes(d.action_mass) : free_;
}

ActuatorRun simulate(const Actuator& actuator, const Profile& torque,
                     const ActuatorOptions& options) {
  const auto positive = [](double v) { return std::isfinite(v) && v > 0.0; };
  std::string faults;
  if (!positive(options.duration)) {
    faults += format("\n  duration = %.6g s, must be > 0", options.duration);
  }
  if (!positive(options.output_rate)) {
    faults += format("\n  output_rate = %.6g Hz, must be > 0", options.output_rate);
  } else if (options.duration * options.output_rate > 1e7) {
    faults += format("\n  output_rate = %.6g Hz over %.6g s gives more than 1e7 samples",
                     options.output_rate, options.duration);
  } else if (positive(options.duration) && options.duration * options.output_rate < 1.0) {
    faults += format("\n  duration %.6g s at output_rate %.6g Hz: less than one sample",
                     options.duration, options.output_rate);
  }
  if (!faults.empty()) throw InvalidParameter("actuator:" + faults);
  return Run(actuator, torque, options).run();
}

}  // namespace feltmb
