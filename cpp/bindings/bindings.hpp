/// One function a file adds its part to the module; no physics in the bindings.
#pragma once

#include <pybind11/pybind11.h>

#include "interpreter.hpp"

void bind_fiber(pybind11::module_& m);

namespace feltmb::python {

void bind_error(pybind11::module_& m);
void bind_contact(pybind11::module_& m);
void bind_felt(pybind11::module_& m);
void bind_modal(pybind11::module_& m);
void bind_planar(pybind11::module_& m);
void bind_model(pybind11::module_& m);
void bind_stepper(pybind11::module_& m);
void bind_sensitivity(pybind11::module_& m);
void bind_batch(pybind11::module_& m);
void bind_actuator(pybind11::module_& m);

}  // namespace feltmb::python
