#include "bindings.hpp"
#include "feltmb/core/error.hpp"

namespace py = pybind11;

namespace feltmb::python {

void bind_error(py::module_& m) {
  // The exception classes live in Python, so that they can inherit from ValueError too.
  py::module_ errors = py::module_::import("unmodeled.errors");
  static py::object base = errors.attr("Error");
  static py::object parameter = errors.attr("InvalidParameter");
  static py::object model = errors.attr("ModelError");
  // Never destroyed: the interpreter may be gone when statics are.
  base.inc_ref();
  parameter.inc_ref();
  model.inc_ref();
  py::register_exception_translator([](std::exception_ptr p) {
    try {
      if (p) std::rethrow_exception(p);
    } catch (const InvalidParameter& e) {
      PyErr_SetString(parameter.ptr(), e.what());
    } catch (const ModelError& e) {
      PyErr_SetString(model.ptr(), e.what());
    } catch (const Error& e) {
      PyErr_SetString(base.ptr(), e.what());
    }
  });
  (void)m;
}

}  // namespace feltmb::python
