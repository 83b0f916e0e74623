#include "feltmb/model/linear_machine.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>

#include "feltmb/core/error.hpp"
#include "feltmb/core/index.hpp"
#include "feltmb/model/channels.hpp"
#include "feltmb/model/equilibrium.hpp"

namespace feltmb {
namespace {

using Clock = std::chrono::steady_clock;

class MemorylessForce : public modal::ScalarForce {
 public:
  explicit MemorylessForce(const ContactLaw& law) : law_(law) {}
  Value trial(int, double, double compression, double rate) override {
    const LawValue v = law_.evaluate(compression, rate);
    return {v.force, v.d_compression, v.d_rate};
  }

 private:
  const ContactLaw& law_;
};

bool is_linear(const Mechanism& m) {
  if (!m.beams.empty() || !m.springs.empty() || !m.straps.empty() || !m.dashpots.empty() ||
      m.finger_contact >= 0 || m.motor_contact >= 0 || m.motor_coordinate >= 0) {
    return false;
  }
  for (std::size_t i = 1; i < m.links.size(); ++i) {
    if (m.links[i].kind != LinkKind::kPrismatic || m.links[i].parent != 0) return false;
  }
  for (const Friction& f : m.joint_friction) {
    if (f.acts()) return false;
  }
  for (const Contact& c : m.contacts) {
    if (!c.enabled) continue;
    if (c.kind != PairKind::kLineCircle || c.friction.acts() || c.law.n_states() > 0 ||
        c.law.has_memory()) {
      return false;
    }
  }
  return std::none_of(m.string_contacts.begin(), m.string_contacts.end(),
                      [](const StringContact& c) { return c.moving; });
}

}  // namespace

std::optional<LinearMachine> LinearMachine::of(const Mechanism& m) {
  if (!is_linear(m)) return std::nullopt;
  LinearMachine out;
  const std::size_t n = as_index(m.size());
  const std::size_t size = n + as_index(m.total_modes);
  out.stiffness.assign(size, 0.0);
  out.damping.assign(size, 0.0);
  out.root_mass.assign(n, 0.0);
  std::vector<Vec2> along(m.links.size());
  std::vector<std::size_t> coordinate(m.links.size(), 0);
  std::vector<double> weight(size, 0.0);
  bool heavy = false;
  for (std::size_t i = 1; i < m.links.size(); ++i) {
    const Motion& motion = m.motions[as_index(m.links[i].motions[0])];
    coordinate[i] = as_index(motion.coordinate);
    along[i] = m.links[i].base * motion.translation;
    out.root_mass[coordinate[i]] = std::sqrt(m.links[i].mass);
    weight[coordinate[i]] = out.root_mass[coordinate[i]] * dot(m.gravity, along[i]);
    heavy = heavy || weight[coordinate[i]] != 0.0;
  }
  for (const AttachedString& s : m.strings) {
    std::copy(s.string.stiffness().begin(), s.string.stiffness().end(),
              out.stiffness.begin() + static_cast<std::ptrdiff_t>(n) + s.offset);
    std::copy(s.string.damping().begin(), s.string.damping().end(),
              out.damping.begin() + static_cast<std::ptrdiff_t>(n) + s.offset);
  }
  if (heavy) out.drives.push_back({weight, [](double) { return 1.0; }, 1.0});
  for (std::size_t i = 0; i < m.contacts.size(); ++i) {
    const Contact& c = m.contacts[i];
    if (!c.enabled) continue;
    const auto place = [&](LinkPoint p) {
      return m.links[as_index(p.link)].position + m.links[as_index(p.link)].base * p.local;
    };
    const Vec2 normal = m.links[as_index(c.a.link)].base * c.normal_a;
    modal::ModalContact contact;
    contact.gradient.assign(size, 0.0);
    contact.offset = c.radius_b - dot(normal, place(c.b) - place(c.a));
    for (const auto& [point, sign] : {std::pair{c.a, 1.0}, std::pair{c.b, -1.0}}) {
      if (point.link == 0) continue;
      const std::size_t k = coordinate[as_index(point.link)];
      contact.gradient[k] += sign * dot(normal, along[as_index(point.link)]) / out.root_mass[k];
    }
    if (c.string_contact >= 0) {
      const StringContact& touch = m.string_contacts[as_index(c.string_contact)];
      const AttachedString& s = m.string_of(touch);
      std::vector<double> slope(as_index(s.string.modes()));
      const std::span<double> phi{contact.gradient.data() + n + as_index(s.offset), slope.size()};
      s.string.shapes(touch.position, phi, slope);
      for (double& p : phi) p *= -touch.side;
    }
    out.forces.push_back(std::make_unique<MemorylessForce>(c.law));
    contact.force = out.forces.back().get();
    out.contacts.push_back(std::move(contact));
    out.contact_index.push_back(static_cast<int>(i));
  }
  return out;
}

RunResult simulate_linear(const std::shared_ptr<const Mechanism>& mechanism, LinearMachine machine,
                          const SimulationOptions& options, const SimulationState& start,
                          const Progress& progress) {
  const auto begin = Clock::now();
  const std::size_t n = as_index(mechanism->size());
  const std::size_t modes = as_index(mechanism->total_modes);
  MechanismSystem system(mechanism, {}, false, {}, false);
  std::vector<double> y(2 * (n + modes), 0.0);
  if (start.y.empty()) {
    const Equilibrium rest = find_equilibrium(mechanism);
    std::copy(rest.q.begin(), rest.q.end(), y.begin());
    std::copy(rest.eta.begin(), rest.eta.end(), y.begin() + static_cast<std::ptrdiff_t>(2 * n));
  } else {
    start.check(*mechanism, y.size());
    y = start.y;
  }
  RunResult out;
  out.method = Method::kModal;
  Channels channels;
  if (options.outputs) {
    channels = Channels(*mechanism);
    out.name_outputs(channels);
  }
  const double interval = std::min(1.0 / options.output_rate, options.duration);
  const double count = std::floor(options.duration / interval * (1.0 + 1e-12));
  check_samples(options.output_rate, options.duration, count,
                static_cast<double>(1 + out.names.size() + (options.states ? y.size() : 0)));
  const auto samples = static_cast<long>(count);
  const double rest_of_time = options.duration - static_cast<double>(samples) * interval;
  const bool partial = rest_of_time > 1e-9 * interval;
  if (options.outputs) {
    // Those before outputs_from stay unused.
    const Eigen::Index rows = samples + 1 + (partial ? 1 : 0);
    out.time.resize(rows);
    out.data.resize(rows, static_cast<Eigen::Index>(out.names.size()));
    out.ledger.resize(rows, 0);
    if (options.states) out.states.resize(rows, static_cast<Eigen::Index>(y.size()));
  }
  modal::ModalStepperOptions stepping;
  stepping.interval = interval;
  stepping.tolerance = std::min(0.1, 3.0 * options.rtol);
  std::vector<double> x(n + modes), v(n + modes);
  const auto to_modes = [&] {
    for (std::size_t k = 0; k < n; ++k) {
      x[k] = machine.root_mass[k] * y[k];
      v[k] = machine.root_mass[k] * y[n + k];
    }
    std::copy_n(y.begin() + static_cast<std::ptrdiff_t>(2 * n), modes,
                x.begin() + static_cast<std::ptrdiff_t>(n));
    std::copy_n(y.begin() + static_cast<std::ptrdiff_t>(2 * n + modes), modes,
                v.begin() + static_cast<std::ptrdiff_t>(n));
  };
  const auto from_modes = [&](const modal::ModalContactStepper& s) {
    const auto p = s.position();
    const auto r = s.velocity();
    for (std::size_t k = 0; k < n; ++k) {
      y[k] = p[k] / machine.root_mass[k];
      y[n + k] = r[k] / machine.root_mass[k];
    }
    std::copy_n(p.begin() + static_cast<std::ptrdiff_t>(n), modes,
                y.begin() + static_cast<std::ptrdiff_t>(2 * n));
    std::copy_n(r.begin() + static_cast<std::ptrdiff_t>(n), modes,
                y.begin() + static_cast<std::ptrdiff_t>(2 * n + modes));
  };
  Eigen::Index row = 0;
  out.lowest = Lowest::of(*mechanism, options.lowest_points);
  const auto sample = [&](double t) {
    out.reached = t;
    for (Lowest& each : out.lowest) {
      system.place(y);
      const auto& point = mechanism->points[as_index(each.point)].point;
      each.look(system.dynamics().position(point).y, t == 0.0);
    }
    if (!options.outputs || t < options.outputs_from) return;
    out.time[row] = t;
    if (options.states) std::copy(y.begin(), y.end(), out.states.row(row).data());
    channels.observe(system, t, y,
                     {out.data.row(row).data(), static_cast<std::size_t>(out.data.cols())});
    for (Eigen::Index i = 0; i < out.data.cols(); ++i) {
      if (std::isfinite(out.data(row, i))) continue;
      throw Error(format("failed at t = %.9g s: %s is not a finite number", t,
                         out.names[static_cast<std::size_t>(i)].c_str()),
                  ErrorCode::kNotFinite);
    }
    ++row;
  };
  for (const int number : options.peak_contacts) {
    const int index = mechanism->contact_index(number);
    if (index < 0) {
      throw InvalidParameter(format("peak_contacts: there is no contact %d", number));
    }
    out.peaks.push_back({index, 0.0, 0.0});
  }
  const auto take = [&](const modal::ModalContactStepper& s) {
    out.counts.steps += s.counts().steps;
    out.counts.rejected += s.counts().rejected;
    out.counts.rhs += s.counts().forces;
    for (Peak& peak : out.peaks) {
      for (std::size_t c = 0; c < machine.contact_index.size(); ++c) {
        if (machine.contact_index[c] != peak.contact || s.largest_force(c) <= peak.force) continue;
        peak.force = s.largest_force(c);
        peak.time = s.largest_force_time(c);
      }
    }
  };
  const auto stop = [&](RunStatus status, ErrorCode code, const std::string& why) {
    out.status = status;
    out.code = code;
    out.message = why;
  };
  const auto may_go_on = [&](const modal::ModalContactStepper& s) {
    const double wall = std::chrono::duration<double>(Clock::now() - begin).count();
    if (s.counts().steps >= options.max_steps) {
      stop(RunStatus::kFailed, ErrorCode::kTooManySteps,
           format("%ld steps were not enough; reached t = %.6g s", s.counts().steps, out.reached));
    } else if (options.max_wall > 0.0 && wall > options.max_wall) {
      stop(
          RunStatus::kWallTime, ErrorCode::kWallTime,
          format("wall time limit of %.3g s reached at t = %.6g s", options.max_wall, out.reached));
    } else if (progress && !progress(out.reached)) {
      stop(RunStatus::kInterrupted, ErrorCode::kInterrupted,
           format("interrupted at t = %.6g s", out.reached));
    }
    return out.status == RunStatus::kDone;
  };

  to_modes();
  sample(0.0);
  modal::ModalContactStepper stepper(machine.stiffness, machine.damping, machine.contacts,
                                     machine.drives, stepping);
  stepper.start(0.0, x, v);
  try {
    for (long i = 1; i <= samples; ++i) {
      stepper.advance();
      from_modes(stepper);
      sample(std::min(static_cast<double>(i) * interval, options.duration));
      if (i % 64 == 0 && !may_go_on(stepper)) break;
    }
    if (partial && out.status == RunStatus::kDone) {
      stepping.interval = rest_of_time;
      modal::ModalContactStepper last(machine.stiffness, machine.damping, machine.contacts,
                                      machine.drives, stepping);
      to_modes();
      last.start(out.reached, x, v);
      last.advance();
      from_modes(last);
      sample(options.duration);
      take(last);
    }
  } catch (const InvalidParameter&) {
    throw;
  } catch (const Error& error) {
    stop(RunStatus::kFailed, error.code(), error.what());
  }
  take(stepper);
  if (options.outputs) {
    out.time.conservativeResize(row);
    out.data.conservativeResize(row, Eigen::NoChange);
    out.ledger.conservativeResize(row, 0);
    if (options.states) out.states.conservativeResize(row, Eigen::NoChange);
  }
  out.event_states.resize(0, 2 * static_cast<Eigen::Index>(n));
  out.event_compression.resize(0, static_cast<Eigen::Index>(mechanism->contacts.size()));
  out.event_approach.resize(0, static_cast<Eigen::Index>(mechanism->contacts.size()));
  out.end = {out.reached, y, start.largest_compression};
  if (out.end.largest_compression.empty()) {
    out.end.largest_compression.assign(mechanism->contacts.size(), 0.0);
  }
  out.wall = std::chrono::duration<double>(Clock::now() - begin).count();
  return out;
}

}  // namespace feltmb
