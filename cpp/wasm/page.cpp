/// A mechanism for a page: C functions over numbers in memory. Each that may fail returns 0 or a
/// null pointer then, and feltmb_fault() tells why. What the functions return a pointer to lives
/// until the next call of the same machine.
#include <algorithm>
#include <array>
#include <memory>
#include <string>
#include <vector>

#include "feltmb/core/error.hpp"
#include "feltmb/model/equilibrium.hpp"
#include "feltmb/model/simulation.hpp"
#include "feltmb/planar/archive.hpp"
#include "feltmb/planar/poses.hpp"

#define FELTMB_PAGE extern "C" __attribute__((used, visibility("default")))

namespace {

using namespace feltmb;

std::string fault;

/// What `work` returns; nothing if it throws.
template <class Work>
auto guarded(const Work& work) -> decltype(work()) {
  fault.clear();
  try {
    return work();
  } catch (const std::exception& error) {
    fault = error.what();
    return {};
  }
}

struct PointEvent {
  int point;
  Vec2 direction;  ///< unit
  double travel;   ///< from rest [m]
};

struct Machine {
  MechanismDescription original, description;
  std::vector<DescriptionNumber> numbers;  ///< of description
  std::vector<PointEvent> point_events;
  std::vector<int> peak_contacts, lowest_points;

  std::shared_ptr<const Mechanism> mechanism;  ///< null: a number has changed
  Equilibrium rest;
  RunResult run;
  std::vector<double> shown;  ///< of the last answer
  std::string text;

  /// Assembles anew if a number has changed.
  void assemble_now() {
    if (mechanism) return;
    for (const DescriptionNumber& number : numbers) {
      if (number.range.holds(*number.value)) continue;
      throw InvalidParameter(
          number_fault(number.path.c_str(), *number.value, number.unit.c_str(), number.range));
    }
    auto made = assemble(description);
    rest = find_equilibrium(made);
    mechanism = std::move(made);
  }

  Eigen::VectorXd rest_pose() const {
    return Eigen::Map<const Eigen::VectorXd>(rest.q.data(),
                                             static_cast<Eigen::Index>(rest.q.size()));
  }

  std::vector<Monitor> monitors() const {
    const Dynamics dynamics = located(mechanism, rest_pose());
    std::vector<Monitor> out;
    for (const PointEvent& event : point_events) {
      const auto& point = mechanism->points[static_cast<std::size_t>(event.point)];
      const double level = dot(event.direction, dynamics.position(point.point)) + event.travel;
      out.push_back({point.name, event.point, event.direction, level});
    }
    return out;
  }

  void simulate_now(const InputSignal& input, SimulationOptions options) {
    assemble_now();
    options.peak_contacts = peak_contacts;
    options.lowest_points = lowest_points;
    if (mechanism->finger_contact >= 0) {
      options.finger_reference = finger_place(mechanism, rest_pose());
    }
    run = simulate(mechanism, input, options, SimulationState::of(rest), monitors());
    if (run.status != RunStatus::kDone) throw Error(run.message, run.code);
  }

  template <class Matrix>
  void show(const Matrix& values) {
    for (Eigen::Index i = 0; i < values.rows(); ++i) {
      for (Eigen::Index j = 0; j < values.cols(); ++j) shown.push_back(values(i, j));
    }
  }
};

const double* told(Machine& machine, int* count) {
  *count = static_cast<int>(machine.shown.size());
  return machine.shown.data();
}

}  // namespace

FELTMB_PAGE const char* feltmb_fault() { return fault.c_str(); }

/// A machine from the text of write_description; null if it has faults.
FELTMB_PAGE Machine* feltmb_create(const char* archive) {
  return guarded([&] {
    auto machine = std::make_unique<Machine>();
    machine->original = read_description(archive);
    machine->description = machine->original;
    machine->numbers = numbers_of(machine->description);
    return machine.release();
  });
}

FELTMB_PAGE void feltmb_destroy(Machine* machine) { delete machine; }

/// An event when a point has gone a travel [m] along a direction from its place at rest.
FELTMB_PAGE void feltmb_watch_point(Machine* machine, int point, double x, double y,
                                    double travel) {
  const double length = std::hypot(x, y);
  machine->point_events.push_back({point, {x / length, y / length}, travel});
}

/// The largest force of a contact (its number), or the lowest position of a point, of each run.
FELTMB_PAGE void feltmb_watch_peak(Machine* machine, int contact) {
  machine->peak_contacts.push_back(contact);
}
FELTMB_PAGE void feltmb_watch_lowest(Machine* machine, int point) {
  machine->lowest_points.push_back(point);
}

/// All numbers as they were created.
FELTMB_PAGE void feltmb_reset(Machine* machine) {
  const std::vector<DescriptionNumber> first = numbers_of(machine->original);
  for (std::size_t i = 0; i < first.size(); ++i) *machine->numbers[i].value = *first[i].value;
  machine->mechanism.reset();
}

/// Sets a number, by its place in numbers_of.
FELTMB_PAGE int feltmb_set(Machine* machine, int number, double value) {
  return guarded([&] {
    if (number < 0 || number >= static_cast<int>(machine->numbers.size())) {
      throw InvalidParameter(format("there is no number %d", number));
    }
    *machine->numbers[static_cast<std::size_t>(number)].value = value;
    machine->mechanism.reset();
    return 1;
  });
}

/// A stroke from rest to its end. `kind` as in input_kind; `interpolation`: 0 linear, 1 monotone,
/// 2 spline.
FELTMB_PAGE int feltmb_run(Machine* machine, const char* kind, int interpolation, int knots,
                           const double* time, const double* value, double amplitude,
                           double frequency, double duration, double rtol, double output_rate) {
  return guarded([&] {
    SimulationOptions options;
    options.duration = duration;
    options.rtol = rtol;
    options.output_rate = output_rate;
    options.ledger = false;
    const Profile profile({time, time + knots}, {value, value + knots},
                          static_cast<Profile::Interpolation>(interpolation), amplitude, frequency);
    machine->simulate_now({profile, input_kind(kind)}, options);
    return 1;
  });
}

/// Numbers of the last run, and how many: "time" (n), "data" (n, outputs), "eta" (n, modes),
/// "events" (time, contact number or 0, point event or -1, direction, then compression and approach
/// of each contact), "peaks" (contact number, force, time), "lowest" (point, start, lowest),
/// "counts" (steps, right-hand sides). Null for another name.
FELTMB_PAGE const double* feltmb_read(Machine* machine, const char* name, int* count) {
  return guarded([&]() -> const double* {
    const std::string what = name;
    RunResult& run = machine->run;
    const auto contact = [&](int i) {
      return i < 0 ? 0.0 : machine->mechanism->contacts[static_cast<std::size_t>(i)].number;
    };
    if (what == "time" || what == "data") {  // no copy: these are long
      *count = static_cast<int>(what == "time" ? run.time.size() : run.data.size());
      return what == "time" ? run.time.data() : run.data.data();
    }
    machine->shown.clear();
    if (what == "eta") {
      const Mechanism& m = *machine->mechanism;
      machine->show(run.states.middleCols(2 * m.size() + m.total_law_states, m.total_modes));
    } else if (what == "events") {
      for (std::size_t i = 0; i < run.events.size(); ++i) {
        const SimulationEvent& e = run.events[i];
        const auto row = static_cast<Eigen::Index>(i);
        machine->shown.insert(machine->shown.end(),
                              {e.time, contact(e.contact), static_cast<double>(e.monitor),
                               static_cast<double>(e.direction)});
        machine->show(run.event_compression.row(row));
        machine->show(run.event_approach.row(row));
      }
    } else if (what == "peaks") {
      for (const Peak& p : run.peaks) {
        machine->shown.insert(machine->shown.end(), {contact(p.contact), p.force, p.time});
      }
    } else if (what == "lowest") {
      for (const Lowest& l : run.lowest) {
        machine->shown.insert(machine->shown.end(),
                              {static_cast<double>(l.point), l.start, l.lowest});
      }
    } else if (what == "counts") {
      machine->shown = {static_cast<double>(run.counts.steps), static_cast<double>(run.counts.rhs)};
    } else {
      throw InvalidParameter("there is nothing called " + what);
    }
    return told(*machine, count);
  });
}

/// Names of the last run, one a line: "outputs" with their SI units and descriptions, "contacts"
/// with their numbers, in the order of the columns.
FELTMB_PAGE const char* feltmb_names(Machine* machine, const char* name) {
  return guarded([&]() -> const char* {
    const RunResult& run = machine->run;
    machine->text.clear();
    if (name == std::string("outputs")) {
      for (std::size_t i = 0; i < run.names.size(); ++i) {
        machine->text += run.names[i] + '\t' + run.units[i] + '\t' + run.long_names[i] + '\n';
      }
    } else {
      for (const Contact& c : machine->mechanism->contacts) {
        machine->text += c.name + '\t' + std::to_string(c.number) + '\n';
      }
    }
    return machine->text.c_str();
  });
}

/// Poses of the mechanism of the last run: for each of `count` rows of coordinates, of each body x,
/// y [m] and angle [rad]; of each contact but the finger's x, y [m] and normal; of each flexible
/// beam 25 points [m], in the order of the mechanism.
FELTMB_PAGE const double* feltmb_poses(Machine* machine, int rows, const double* q, int* count) {
  return guarded([&]() -> const double* {
    machine->assemble_now();
    const Eigen::MatrixXd positions =
        Eigen::Map<const RowMatrix>(q, rows, machine->mechanism->size());
    const Poses found = poses_along(machine->mechanism, positions, 25);
    machine->shown.clear();
    for (Eigen::Index row = 0; row < rows; ++row) {
      machine->show(found.bodies.row(row));
      machine->show(found.contacts.row(row));
      for (const auto& [name, line] : found.beams) machine->show(line.row(row));
    }
    return told(*machine, count);
  });
}
