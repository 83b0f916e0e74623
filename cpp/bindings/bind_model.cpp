#include <pybind11/eigen.h>
#include <pybind11/functional.h>
#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include "bindings.hpp"
#include "feltmb/model/equilibrium.hpp"
#include "feltmb/model/simulation.hpp"

namespace py = pybind11;

namespace feltmb::python {
namespace {

py::dict counts(const IntegratorCounts& c) {
  py::dict out;
  out["steps"] = c.steps;
  out["rhs"] = c.rhs;
  out["jacobians"] = c.jacobians;
  out["factorizations"] = c.factorizations;
  out["rejected"] = c.rejected;
  out["newton_iterations"] = c.newton_iterations;
  out["newton_failures"] = c.newton_failures;
  return out;
}

}  // namespace

void bind_model(py::module_& m) {
  py::enum_<Profile::Interpolation>(m, "Interpolation")
      .value("linear", Profile::Interpolation::kLinear)
      .value("monotone", Profile::Interpolation::kMonotone)
      .value("spline", Profile::Interpolation::kSpline);
  py::class_<Profile>(m, "Profile")
      .def(py::init<std::vector<double>, std::vector<double>, Profile::Interpolation, double,
                    double>(),
           py::arg("time"), py::arg("value"), py::arg("interpolation"),
           py::arg("oscillation_amplitude") = 0.0, py::arg("oscillation_frequency") = 0.0)
      .def_property_readonly("breakpoints", &Profile::breakpoints)
      .def(
          "value",
          [](const Profile& p, py::array_t<double> t) {
            return py::vectorize([&p](double x) { return p.value(x); })(t);
          },
          py::arg("time"))
      .def(
          "rate",
          [](const Profile& p, py::array_t<double> t) {
            return py::vectorize([&p](double x) { return p.rate(x); })(t);
          },
          py::arg("time"))
      .def(
          "acceleration",
          [](const Profile& p, py::array_t<double> t) {
            return py::vectorize([&p](double x) { return p.acceleration(x); })(t);
          },
          py::arg("time"))
      .def_property_readonly("smooth", &Profile::smooth);

  py::class_<InputSignal>(m, "InputSignal")
      .def(py::init([](const Profile& profile, const std::string& kind, double origin) {
             return InputSignal{profile, input_kind(kind), origin};
           }),
           py::arg("profile"), py::arg("kind") = "force", py::arg("origin") = 0.0,
           "What drives a mechanism: a force, the motion of a finger with its pad, a key_motion, a "
           "torque or a motor_motion, from a time [s] on the clock of the profile.")
      .def_readonly("profile", &InputSignal::profile)
      .def_readonly("origin", &InputSignal::origin);

  py::class_<SimulationOptions>(m, "SimulationOptions")
      .def(py::init<>())
      .def_readwrite("duration", &SimulationOptions::duration)
      .def_readwrite("rtol", &SimulationOptions::rtol)
      .def_readwrite("output_rate", &SimulationOptions::output_rate)
      .def_readwrite("ledger", &SimulationOptions::ledger)
      .def_readwrite("events", &SimulationOptions::events)
      .def_readwrite("outputs", &SimulationOptions::outputs)
      .def_readwrite("outputs_from", &SimulationOptions::outputs_from)
      .def_readwrite("lowest_points", &SimulationOptions::lowest_points)
      .def_readwrite("diagnose", &SimulationOptions::diagnose)
      .def_readwrite("max_order", &SimulationOptions::max_order)
      .def_property(
          "method", [](const SimulationOptions& o) { return method_name(o.method); },
          [](SimulationOptions& o, const std::string& name) { o.method = method_from_name(name); })
      .def_readwrite("max_step", &SimulationOptions::max_step)
      .def_readwrite("ledger_limit", &SimulationOptions::ledger_limit)
      .def_readwrite("max_steps", &SimulationOptions::max_steps)
      .def_readwrite("max_wall", &SimulationOptions::max_wall)
      .def_readwrite("peak_contacts", &SimulationOptions::peak_contacts)
      .def_readwrite("finger_reference", &SimulationOptions::finger_reference);

  m.def(
      "tolerance_for",
      [](double error, const std::shared_ptr<Mechanism>& mechanism, const std::string& method) {
        return tolerance_for(error, *mechanism, method_from_name(method));
      },
      py::arg("error"), py::arg("mechanism"), py::arg("method"));

  py::class_<Monitor>(m, "Monitor")
      .def(py::init(
               [](std::string name, int point, std::pair<double, double> direction, double level) {
                 return Monitor{std::move(name), point, {direction.first, direction.second}, level};
               }),
           py::kw_only(), py::arg("name"), py::arg("point"), py::arg("direction"),
           py::arg("level"));

  m.def(
      "find_equilibrium",
      [](const std::shared_ptr<Mechanism>& mechanism, double finger_force) {
        Equilibrium e;
        {
          const WithoutInterpreter release;
          e = find_equilibrium(mechanism, finger_force);
        }
        py::dict out;
        out["q"] = Eigen::VectorXd(
            Eigen::Map<const Eigen::VectorXd>(e.q.data(), static_cast<Eigen::Index>(e.q.size())));
        out["eta"] = Eigen::VectorXd(Eigen::Map<const Eigen::VectorXd>(
            e.eta.data(), static_cast<Eigen::Index>(e.eta.size())));
        out["law"] = e.law;
        out["largest_compression"] = e.largest_compression;
        out["iterations"] = e.iterations;
        out["residual"] = e.residual;
        return out;
      },
      py::arg("mechanism"), py::arg("finger_force") = 0.0);

  py::class_<RunResult>(m, "RunResult")
      .def_property_readonly("status", [](const RunResult& r) { return status_name(r.status); })
      .def_property_readonly("code", [](const RunResult& r) { return error_code_name(r.code); })
      .def_readonly("message", &RunResult::message)
      .def_property_readonly("method", [](const RunResult& r) { return method_name(r.method); })
      .def_readonly("strikes", &RunResult::strikes)
      .def_readonly("reached", &RunResult::reached)
      .def_readonly("failed_state", &RunResult::failed_state)
      .def_readonly("failed_contact", &RunResult::failed_contact)
      .def_readonly("time", &RunResult::time)
      .def_readonly("names", &RunResult::names)
      .def_readonly("units", &RunResult::units)
      .def_readonly("long_names", &RunResult::long_names)
      .def_readonly("data", &RunResult::data)
      .def_readonly("states", &RunResult::states)
      .def_readonly("start", &RunResult::start)
      .def_property_readonly(
          "deflections",
          [](const RunResult& r) {
            py::list out;
            for (const auto& d : r.deflections) {
              out.append(py::make_tuple(d.name, d.length, d.largest, d.time));
            }
            return out;
          },
          "Tuples (name, length [m], largest deflection [m], time [s]) by flexible beam.")
      .def_property_readonly("balance",
                             [](const RunResult& r) {
                               py::dict out;
                               out["residual"] = r.balance.residual;
                               out["residual_largest"] = r.balance.residual_largest;
                               out["turned_over"] = r.balance.turned_over;
                               out["residual_relative"] = r.balance.residual_relative;
                               return out;
                             })
      .def_readonly("ledger_names", &RunResult::ledger_names)
      .def_readonly("ledger", &RunResult::ledger)
      .def_property_readonly(
          "events",
          [](const RunResult& r) {
            py::list out;
            for (const auto& e : r.events) {
              out.append(py::make_tuple(e.time, e.contact, e.monitor, e.direction));
            }
            return out;
          },
          "Tuples (time, contact index or -1, monitor index or -1, direction).")
      .def_readonly("event_states", &RunResult::event_states)
      .def_readonly("event_compression", &RunResult::event_compression)
      .def_readonly("event_approach", &RunResult::event_approach)
      .def_property_readonly("peaks",
                             [](const RunResult& r) {
                               py::list out;
                               for (const auto& p : r.peaks) {
                                 out.append(py::make_tuple(p.contact, p.force, p.time));
                               }
                               return out;
                             })
      .def_property_readonly(
          "lowest",
          [](const RunResult& r) {
            py::list out;
            for (const auto& l : r.lowest) {
              out.append(py::make_tuple(l.point, l.start, l.lowest));
            }
            return out;
          },
          "Tuples (point index, y at the start, smallest y) [m].")
      .def_property_readonly("end_time", [](const RunResult& r) { return r.end.time; })
      .def_property_readonly("end_state",
                             [](const RunResult& r) {
                               return Eigen::VectorXd(Eigen::Map<const Eigen::VectorXd>(
                                   r.end.y.data(), static_cast<Eigen::Index>(r.end.y.size())));
                             })
      .def_property_readonly("end_largest_compression",
                             [](const RunResult& r) { return r.end.largest_compression; })
      .def_property_readonly("counts",
                             [](const RunResult& r) {
                               py::dict out = counts(r.counts);
                               out["event_evaluations"] = r.event_evaluations;
                               out["reversals"] = r.reversals;
                               return out;
                             })
      .def_readonly("restarts", &RunResult::restarts)
      .def_readonly("wall", &RunResult::wall)
      .def_readonly("limiting_states", &RunResult::limiting_states)
      .def_readonly("limiting_contacts", &RunResult::limiting_contacts);

  m.def(
      "simulate",
      [](const std::shared_ptr<Mechanism>& mechanism, const InputSignal& input,
         const SimulationOptions& options, const std::vector<double>& start,
         const std::vector<Monitor>& monitors, const py::object& progress,
         const std::vector<double>& start_memory) {
        Progress report;
        if (!progress.is_none()) {
          // Runs with the GIL released; takes it back for the call and for pending signals.
          report = [&progress](double t) {
            const WithInterpreter acquire;
            if (PyErr_CheckSignals() != 0) throw py::error_already_set();
            return goes_on(progress(t));
          };
        } else {
          report = [](double) {
            const WithInterpreter acquire;
            if (PyErr_CheckSignals() != 0) {
              if (PyErr_ExceptionMatches(PyExc_KeyboardInterrupt) == 0) {
                throw py::error_already_set();
              }
              PyErr_Clear();
              return false;
            }
            return true;
          };
        }
        SimulationState state;
        state.y = start;
        state.largest_compression = start_memory;
        const WithoutInterpreter release;
        return simulate(mechanism, input, options, state, monitors, report);
      },
      py::arg("mechanism"), py::arg("input"), py::arg("options"), py::arg("start"),
      py::arg("monitors"), py::arg("progress") = py::none(),
      py::arg("start_memory") = std::vector<double>{});

  m.def(
      "jacobian_check",
      [](const std::shared_ptr<Mechanism>& mechanism, const std::vector<double>& y,
         const InputSignal& input, double time, double gamma) {
        MechanismSystem system(mechanism, input, false, {}, false);
        if (y.size() != system.size()) {
          throw std::invalid_argument("jacobian_check: wrong length of the state");
        }
        const auto n = static_cast<Eigen::Index>(y.size());
        system.linearize(time, y);
        if (!system.factorize(gamma)) throw std::invalid_argument("jacobian_check: singular");
        Eigen::MatrixXd inverse(n, n);
        for (Eigen::Index j = 0; j < n; ++j) {
          std::vector<double> b(y.size(), 0.0);
          b[static_cast<std::size_t>(j)] = 1.0;
          system.solve(b);
          for (Eigen::Index i = 0; i < n; ++i) inverse(i, j) = b[static_cast<std::size_t>(i)];
        }
        return inverse;
      },
      py::arg("mechanism"), py::arg("y"), py::arg("input"), py::arg("time"), py::arg("gamma"),
      "Inverse of I - gamma J as the structured solver applies it.");

  m.def(
      "rhs",
      [](const std::shared_ptr<Mechanism>& mechanism, const std::vector<double>& y,
         const InputSignal& input, double time) {
        MechanismSystem system(mechanism, input, false, {}, false);
        if (y.size() != system.size()) throw std::invalid_argument("rhs: wrong length of y");
        Eigen::VectorXd rate(static_cast<Eigen::Index>(y.size()));
        system.rhs(time, y, {rate.data(), y.size()});
        return rate;
      },
      py::arg("mechanism"), py::arg("y"), py::arg("input"), py::arg("time"),
      "y' of the full state [q, v, eta, deta/dt].");
}

}  // namespace feltmb::python
