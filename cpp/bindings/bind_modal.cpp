#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include "bindings.hpp"
#include "feltmb/core/error.hpp"
#include "feltmb/modal/string.hpp"
#include "fields.hpp"

namespace py = pybind11;

namespace feltmb::python {
namespace {

py::array_t<double> copy(std::span<const double> values) {
  return py::array_t<double>(static_cast<py::ssize_t>(values.size()), values.data());
}

}  // namespace

void bind_modal(py::module_& m) {
  bind_fields<StringParameters>(m, "StringParameters");
  py::class_<ModalString>(m, "ModalString")
      .def(py::init<const StringParameters&>(), py::arg("parameters"))
      .def_property_readonly("parameters", &ModalString::parameters)
      .def_property_readonly("inharmonicity_index", &ModalString::inharmonicity_index)
      .def_property_readonly(
          "angular_frequency", [](const ModalString& s) { return copy(s.angular_frequency()); },
          "w_j [rad/s], thesis eq. 4.14, shape (modes,).")
      .def(
          "shapes",
          [](const ModalString& s, double y) {
            std::vector<double> phi(static_cast<std::size_t>(s.modes()));
            std::vector<double> dphi(phi.size());
            s.shapes(y, phi, dphi);
            return py::make_tuple(copy(phi), copy(dphi));
          },
          py::arg("y"), "phi_j(y) [kg^-1/2] and their slopes at y [m] from the end y = 0.")
      .def(
          "bridge_force",
          [](const ModalString& s,
             py::array_t<double, py::array::c_style | py::array::forcecast> eta) {
            if (eta.ndim() != 2 || eta.shape(1) != s.modes()) {
              throw InvalidParameter("bridge_force: eta must have the shape (n_times, modes)");
            }
            py::array_t<double> out(eta.shape(0));
            for (py::ssize_t i = 0; i < eta.shape(0); ++i) {
              out.mutable_at(i) =
                  s.bridge_force({eta.data(i, 0), static_cast<std::size_t>(s.modes())});
            }
            return out;
          },
          py::arg("eta"), "Transverse force [N] on the far end, shape (n_times,).");
}

}  // namespace feltmb::python
