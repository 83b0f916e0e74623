#include <pybind11/eigen.h>
#include <pybind11/functional.h>
#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include "bindings.hpp"
#include "feltmb/model/channels.hpp"
#include "feltmb/sensitivity/sensitivity.hpp"

namespace py = pybind11;

namespace feltmb::python {

void bind_sensitivity(py::module_& m) {
  py::class_<Perturbed>(m, "Perturbed")
      .def(py::init([](const std::shared_ptr<Mechanism>& mechanism, const InputSignal& input,
                       double shift,
                       double weight) { return Perturbed{mechanism, input, shift, weight}; }),
           py::arg("mechanism"), py::arg("input"), py::arg("shift"), py::arg("weight"));
  py::class_<SensitivityParameter>(m, "SensitivityParameter")
      .def(py::init([](std::string name, std::vector<Perturbed> nodes, double scale) {
             return SensitivityParameter{std::move(name), std::move(nodes), scale};
           }),
           py::arg("name"), py::arg("nodes"), py::arg("scale"));
  py::class_<SensitivitySegment>(m, "SensitivitySegment")
      .def(py::init([](double begin, double end, std::vector<double> state,
                       std::vector<double> memory, Eigen::MatrixXd directions,
                       Eigen::MatrixXd moves) {
             SensitivitySegment s;
             s.begin = begin;
             s.end = end;
             s.start.y = std::move(state);
             s.start.largest_compression = std::move(memory);
             s.directions = std::move(directions);
             s.moves = std::move(moves);
             return s;
           }),
           py::arg("begin"), py::arg("end"), py::arg("state") = std::vector<double>{},
           py::arg("memory") = std::vector<double>{}, py::arg("directions") = Eigen::MatrixXd{},
           py::arg("moves") = Eigen::MatrixXd{});
  py::class_<SensitivityRequest>(m, "SensitivityRequest")
      .def(py::init([](int output, double begin, double end, int sign) {
             return SensitivityRequest{output, begin, end, sign};
           }),
           py::arg("output"), py::arg("begin"), py::arg("end"), py::arg("sign"));
  py::class_<SensitivityValue>(m, "SensitivityValue")
      .def_readonly("value", &SensitivityValue::value)
      .def_readonly("time", &SensitivityValue::time)
      .def_readonly("edge", &SensitivityValue::edge)
      .def_readonly("rate", &SensitivityValue::rate)
      .def_readonly("derivative", &SensitivityValue::derivative)
      .def_readonly("time_derivative", &SensitivityValue::time_derivative)
      .def_readonly("reason", &SensitivityValue::reason);
  py::class_<SensitivityOptions>(m, "SensitivityOptions")
      .def(py::init<>())
      .def_readwrite("simulation", &SensitivityOptions::simulation)
      .def_readwrite("tolerance", &SensitivityOptions::tolerance)
      .def_readwrite("output_rate", &SensitivityOptions::output_rate)
      .def_readwrite("outputs", &SensitivityOptions::outputs)
      .def_readwrite("threads", &SensitivityOptions::threads)
      .def_readwrite("whole_models", &SensitivityOptions::whole_models)
      .def(
          "set_looks",
          [](SensitivityOptions& o, py::function choose) {
            o.looks = [choose = std::move(choose)](const RunResult& run) {
              const WithInterpreter acquire;
              std::vector<SensitivityRequest> out;
              for (const py::handle each :
                   choose(py::cast(run, py::return_value_policy::reference)))
                out.push_back(each.cast<SensitivityRequest>());
              return out;
            };
          },
          py::arg("choose"))
      .def(
          "add_rule",
          [](SensitivityOptions& o, std::string name, int point,
             std::pair<double, double> direction, double travel) {
            o.rules.push_back(
                {std::move(name), point, {direction.first, direction.second}, travel});
          },
          py::arg("name"), py::arg("point"), py::arg("direction"), py::arg("travel"));
  py::class_<SensitivityEvent>(m, "SensitivityEvent")
      .def_property_readonly("when", [](const SensitivityEvent& e) { return e.event.time; })
      .def_property_readonly("contact", [](const SensitivityEvent& e) { return e.event.contact; })
      .def_property_readonly("monitor", [](const SensitivityEvent& e) { return e.event.monitor; })
      .def_property_readonly("direction",
                             [](const SensitivityEvent& e) { return e.event.direction; })
      .def_readonly("time", &SensitivityEvent::time)
      .def_readonly("compression", &SensitivityEvent::compression)
      .def_readonly("approach", &SensitivityEvent::approach)
      .def_readonly("rate", &SensitivityEvent::rate);
  py::class_<SensitivityResult>(m, "SensitivityResult")
      .def_readonly("run", &SensitivityResult::run)
      .def_readonly("time", &SensitivityResult::time)
      .def_readonly("values", &SensitivityResult::values)
      .def_property_readonly("gradient",
                             [](py::object self) {
                               const auto& r = self.cast<const SensitivityResult&>();
                               const auto times = static_cast<py::ssize_t>(r.values.rows());
                               const auto outputs = static_cast<py::ssize_t>(r.values.cols());
                               const auto columns = static_cast<py::ssize_t>(r.end_state.cols());
                               return py::array_t<double>({times, outputs, columns},
                                                          r.gradient.data(), self);
                             })
      .def_readonly("end_state", &SensitivityResult::end_state)
      .def_readonly("end_memory", &SensitivityResult::end_memory)
      .def_readonly("events", &SensitivityResult::events)
      .def_readonly("peaks", &SensitivityResult::peaks)
      .def_readonly("looks", &SensitivityResult::looks)
      .def_readonly("wall_stroke", &SensitivityResult::wall_stroke)
      .def_readonly("wall", &SensitivityResult::wall)
      .def_property_readonly("counts", [](const SensitivityResult& r) {
        py::dict out;
        out["steps"] = r.counts.steps;
        out["rejected"] = r.counts.rejected;
        out["linearizations"] = r.counts.linearizations;
        out["factorizations"] = r.counts.factorizations;
        out["rhs"] = r.counts.rhs;
        out["switches"] = r.counts.switches;
        out["jumps"] = r.counts.jumps;
        return out;
      });
  m.def(
      "observables",
      [](const std::shared_ptr<Mechanism>& mechanism) {
        py::list out;
        const Channels channels(*mechanism);
        for (const Channel& o : channels.rows()) {
          out.append(py::make_tuple(o.name, o.unit, o.text));
        }
        return out;
      },
      py::arg("mechanism"), "Tuples (name, unit, long name) of all outputs in their order.");
  m.def(
      "state_names",
      [](const std::shared_ptr<Mechanism>& mechanism) {
        const MechanismSystem system(mechanism, {}, false, {}, false);
        std::vector<std::string> out;
        for (std::size_t i = 0; i < system.size(); ++i) out.push_back(system.state_name(i));
        return out;
      },
      py::arg("mechanism"), "Names of the full state in its order.");
  m.def(
      "sensitivities",
      [](const std::shared_ptr<Mechanism>& mechanism, const InputSignal& input,
         const std::vector<SensitivityParameter>& parameters,
         const std::vector<SensitivitySegment>& segments, const SensitivityOptions& options) {
        const Progress watch = [](double) {
          const WithInterpreter acquire;
          if (PyErr_CheckSignals() != 0) throw py::error_already_set();
          return true;
        };
        SensitivityOptions here = options;
        here.threads = threads_with_interpreter(options.threads);
        const WithoutInterpreter release;
        return sensitivities(mechanism, input, parameters, segments, here, watch);
      },
      py::arg("mechanism"), py::arg("input"), py::arg("parameters"), py::arg("segments"),
      py::arg("options"));
}

}  // namespace feltmb::python
