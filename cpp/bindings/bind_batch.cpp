#include <pybind11/eigen.h>
#include <pybind11/functional.h>
#include <pybind11/stl.h>

#include <optional>

#include "bindings.hpp"
#include "feltmb/batch/batch.hpp"

namespace py = pybind11;

namespace feltmb::python {

void bind_batch(py::module_& m) {
  py::class_<BatchStroke>(m, "BatchStroke")
      .def(py::init([](const std::shared_ptr<Mechanism>& mechanism, const InputSignal& input,
                       const SimulationOptions& options, const std::vector<double>& start,
                       const std::vector<Monitor>& monitors, const std::vector<double>& memory) {
             BatchStroke s;
             s.mechanism = mechanism;
             s.input = input;
             s.options = options;
             s.start.y = start;
             s.start.largest_compression = memory;
             s.monitors = monitors;
             return s;
           }),
           py::arg("mechanism"), py::arg("input"), py::arg("options"), py::arg("start"),
           py::arg("monitors"), py::arg("memory"));
  using Flag = std::atomic<bool>;
  py::class_<Flag, std::shared_ptr<Flag>>(m, "StopFlag", "Ends a batch at once, from any thread.")
      .def(py::init([] { return std::make_shared<Flag>(false); }))
      .def("set", [](Flag& flag) { flag.store(true); })
      .def("is_set", [](const Flag& flag) { return flag.load(); });
  m.def(
      "simulate_many",
      [](const py::iterator& strokes, const py::function& sink, std::size_t threads, bool ordered,
         const std::optional<std::shared_ptr<Flag>>& stop) {
        // The workers run with the GIL released and take it back for the next stroke and for each
        // outcome.
        const BatchSource source = [&strokes](BatchStroke& stroke) {
          const WithInterpreter acquire;
          if (PyErr_CheckSignals() != 0) throw py::error_already_set();
          const py::handle next = PyIter_Next(strokes.ptr());
          if (!next) {
            if (PyErr_Occurred() != nullptr) throw py::error_already_set();
            return false;
          }
          stroke = py::reinterpret_steal<py::object>(next).cast<BatchStroke>();
          return true;
        };
        const BatchSink take = [&sink](std::size_t index, RunResult&& result,
                                       const std::string& failure) {
          const WithInterpreter acquire;
          if (PyErr_CheckSignals() != 0) throw py::error_already_set();
          return goes_on(sink(index, std::move(result), failure));
        };
        const std::size_t many = threads_with_interpreter(threads);
        const WithoutInterpreter release;
        return simulate_many(source, take, {many, ordered, stop.value_or(nullptr)});
      },
      py::arg("strokes"), py::arg("sink"), py::arg("threads") = 0, py::arg("ordered") = true,
      py::arg("stop") = py::none(),
      "Simulates the strokes of an iterator on threads; sink(index, result, failure) gets the "
      "outcomes, in order or as soon as each is known; a returned False ends the rest. Returns "
      "their "
      "number.");
}

}  // namespace feltmb::python
