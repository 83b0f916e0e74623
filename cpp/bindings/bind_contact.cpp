#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include "bindings.hpp"
#include "feltmb/contact/friction.hpp"
#include "feltmb/contact/law.hpp"

namespace py = pybind11;

namespace feltmb::python {

void bind_contact(py::module_& m) {
  py::class_<Friction>(m, "Friction")
      .def(py::init([](double amplitude, double b1, double b2, double threshold_speed) {
             return Friction{amplitude, b1, b2, threshold_speed};
           }),
           py::kw_only(), py::arg("amplitude") = 0.0, py::arg("b1") = 0.0, py::arg("b2") = 0.0,
           py::arg("threshold_speed") = 1e-3)
      .def_readonly("amplitude", &Friction::amplitude)
      .def_readonly("b1", &Friction::b1)
      .def_readonly("b2", &Friction::b2)
      .def_readonly("threshold_speed", &Friction::threshold_speed)
      .def(
          "coefficient",
          [](const Friction& f, py::array_t<double> v) {
            return py::vectorize([&f](double x) { return evaluate(f, x).value; })(v);
          },
          py::arg("speed"), "mu(v) of thesis eq. A.1 at sliding speed [m/s or rad/s].");

  py::class_<ExponentialCurve>(m, "ExponentialCurve")
      .def(py::init([](double a, double b, double c) { return ExponentialCurve{a, b, c}; }),
           py::arg("a"), py::arg("b"), py::arg("c"))
      .def_readonly("a", &ExponentialCurve::a)
      .def_readonly("b", &ExponentialCurve::b)
      .def_readonly("c", &ExponentialCurve::c)
      .def(
          "force",
          [](const ExponentialCurve& c, py::array_t<double> e) {
            return py::vectorize([&c](double x) { return evaluate(c, x).force; })(e);
          },
          py::arg("compression"), "Force [N] of thesis eq. 4.21 at compression [m].");

  py::class_<ExponentialPair>(m, "ExponentialPair")
      .def(py::init([](ExponentialCurve loading, ExponentialCurve unloading, double alpha,
                       bool guarded) {
             return ExponentialPair{loading, unloading, alpha,
                                    guarded ? ExponentialPair::Form::kGuarded
                                            : ExponentialPair::Form::kPrinted};
           }),
           py::kw_only(), py::arg("loading"), py::arg("unloading"), py::arg("alpha") = 100.0,
           py::arg("guarded") = true);
  py::class_<MeanCurve>(m, "MeanCurve")
      .def(py::init([](ExponentialCurve loading, ExponentialCurve unloading) {
             return MeanCurve{loading, unloading};
           }),
           py::kw_only(), py::arg("loading"), py::arg("unloading"));
  py::class_<HuntCrossley>(m, "HuntCrossley")
      .def(py::init([](double stiffness, double exponent, double damping) {
             return HuntCrossley{stiffness, exponent, damping};
           }),
           py::kw_only(), py::arg("stiffness"), py::arg("exponent") = 1.5,
           py::arg("damping") = 0.0);

  py::class_<ContactLaw>(m, "ContactLaw")
      .def(py::init<const LawParameters&>(), py::arg("parameters"))
      .def_property_readonly("name", &ContactLaw::name)
      .def(
          "force",
          [](const ContactLaw& law, py::array_t<double> e, py::array_t<double> rate) {
            return py::vectorize(
                [&law](double x, double v) { return law.evaluate(x, v).force; })(e, rate);
          },
          py::arg("compression"), py::arg("rate") = 0.0,
          "Normal force [N] at compression [m] and compression rate [m/s].")
      .def(
          "slopes",
          [](const ContactLaw& law, double e, double rate) {
            const LawValue v = law.evaluate(e, rate);
            return py::make_tuple(v.d_compression, v.d_rate);
          },
          py::arg("compression"), py::arg("rate") = 0.0, "dF/de [N/m] and dF/d(de/dt) [N s/m].")
      .def(
          "stored_energy",
          [](const ContactLaw& law, py::array_t<double> e) {
            return py::vectorize([&law](double x) { return law.stored_energy(x); })(e);
          },
          py::arg("compression"), "Energy [J] stored at compression [m].");
}

}  // namespace feltmb::python
