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
    const auto raise = [](const py::object& type, const Error& e) {
      const py::object error = type(e.what());
      error.attr("code") = error_code_name(e.code());
      PyErr_SetObject(type.ptr(), error.ptr());
    };
    try {
      if (p) std::rethrow_exception(p);
    } catch (const InvalidParameter& e) {
      raise(parameter, e);
    } catch (const ModelError& e) {
      raise(model, e);
    } catch (const Error& e) {
      raise(base, e);
    }
  });
  (void)m;
}

}  // namespace feltmb::python
