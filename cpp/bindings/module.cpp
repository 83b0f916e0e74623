#include "bindings.hpp"

PYBIND11_MODULE(_core, m) {
  m.doc() = "C++ core of feltmb. Use the package feltmb; names here may change.";
  m.attr("__version__") = FELTMB_VERSION;
  feltmb::python::bind_interpreter();
  feltmb::python::bind_error(m);
  feltmb::python::bind_contact(m);
  feltmb::python::bind_felt(m);
  feltmb::python::bind_modal(m);
  feltmb::python::bind_planar(m);
  feltmb::python::bind_model(m);
  feltmb::python::bind_stepper(m);
  feltmb::python::bind_sensitivity(m);
  feltmb::python::bind_batch(m);
  feltmb::python::bind_actuator(m);
  bind_fiber(m);
}
