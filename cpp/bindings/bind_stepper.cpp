#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include <atomic>

#include "bindings.hpp"
#include "feltmb/core/error.hpp"
#include "feltmb/model/stepper.hpp"
#include "interpreter.hpp"

namespace py = pybind11;

namespace feltmb::python {
namespace {

/// A stepper that refuses a second thread.
class OneUser {
 public:
  explicit OneUser(std::atomic_flag& flag) : flag_(flag) {
    if (flag_.test_and_set()) {
      throw InvalidParameter("machine: is being advanced in another thread; use one a thread");
    }
  }
  ~OneUser() { flag_.clear(); }
  OneUser(const OneUser&) = delete;
  OneUser& operator=(const OneUser&) = delete;

 private:
  std::atomic_flag& flag_;
};

struct SharedStepper {
  Stepper stepper;
  std::atomic_flag busy = ATOMIC_FLAG_INIT;
};

/// Looks for Ctrl-C.
bool no_signal(double) {
  const WithInterpreter acquire;
  if (PyErr_CheckSignals() == 0) return true;
  if (PyErr_ExceptionMatches(PyExc_KeyboardInterrupt) == 0) throw py::error_already_set();
  PyErr_Clear();
  return false;
}

/// Time, y, memory, then kind, value, rate, acceleration and mean rate of the input.
py::tuple to_tuple(const StepState& s) {
  return py::make_tuple(s.machine.time, py::array_t<double>(py::cast(s.machine.y)),
                        s.machine.largest_compression, input_name(s.drive.kind), s.drive.value,
                        s.drive.rate, s.drive.acceleration, s.drive.mean);
}

StepState from_tuple(const py::tuple& t) {
  StepState s;
  s.machine.time = t[0].cast<double>();
  s.machine.y = t[1].cast<std::vector<double>>();
  s.machine.largest_compression = t[2].cast<std::vector<double>>();
  s.drive = {input_kind(t[3].cast<std::string>()), t[4].cast<double>(), t[5].cast<double>(),
             t[6].cast<double>(), t[7].cast<double>()};
  return s;
}

}  // namespace

void bind_stepper(py::module_& m) {
  py::class_<SharedStepper>(m, "Stepper")
      .def(py::init([](const std::shared_ptr<Mechanism>& mechanism, const std::string& kind,
                       double rtol, const std::string& method, int max_order, double max_step,
                       double max_wall, bool events, double finger_reference,
                       const std::vector<Monitor>& monitors) {
             StepperOptions o;
             o.rtol = rtol;
             o.method = method_from_name(method);
             o.max_order = max_order;
             o.max_step = max_step;
             o.max_wall = max_wall;
             o.events = events;
             o.finger_reference = finger_reference;
             const WithoutInterpreter release;
             return std::unique_ptr<SharedStepper>(
                 new SharedStepper{{mechanism, input_kind(kind), o, monitors}});
           }),
           py::arg("mechanism"), py::arg("kind"), py::kw_only(), py::arg("rtol"), py::arg("method"),
           py::arg("max_order"), py::arg("max_step"), py::arg("max_wall"), py::arg("events"),
           py::arg("finger_reference"), py::arg("monitors"))
      .def_property_readonly("rest",
                             [](const SharedStepper& s) { return to_tuple(s.stepper.rest()); })
      .def_property(
          "state",
          [](SharedStepper& s) {
            const OneUser one(s.busy);
            return to_tuple(s.stepper.state());
          },
          [](SharedStepper& s, const py::tuple& state) {
            const OneUser one(s.busy);
            s.stepper.set_state(from_tuple(state));
          })
      .def_property_readonly("time",
                             [](const SharedStepper& s) { return s.stepper.state().machine.time; })
      .def_property_readonly("channels",
                             [](const SharedStepper& s) {
                               py::list out;
                               for (const Channel& c : s.stepper.channels().rows()) {
                                 out.append(py::make_tuple(c.name, c.unit, c.text));
                               }
                               return out;
                             })
      .def("outputs",
           [](SharedStepper& s) {
             const OneUser one(s.busy);
             const auto values = s.stepper.outputs();
             return py::array_t<double>(static_cast<py::ssize_t>(values.size()), values.data());
           })
      .def(
          "advance",
          [](SharedStepper& s, double duration, double value, double rate, bool linear) {
            const OneUser one(s.busy);
            StepResult done;
            {
              const WithoutInterpreter release;
              done = s.stepper.advance(duration, {value, rate},
                                       linear ? Hold::kLinear : Hold::kZero, no_signal);
            }
            py::list events;
            for (const auto& e : done.events) {
              events.append(py::make_tuple(e.time, e.contact, e.monitor, e.direction));
            }
            return py::make_tuple(status_name(done.status), error_code_name(done.code),
                                  done.message, done.failed_state, done.failed_contact, events,
                                  done.steps);
          },
          py::arg("duration"), py::arg("value"), py::arg("rate"), py::arg("linear"));
}

}  // namespace feltmb::python
