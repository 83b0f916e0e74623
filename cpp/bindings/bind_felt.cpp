#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include "bindings.hpp"
#include "feltmb/contact/felt_layer.hpp"

namespace py = pybind11;

namespace feltmb::python {

namespace {

template <class Area>
void add_area(py::class_<Area>& c) {
  c.def(
      "area",
      [](const Area& self, py::array_t<double> e) {
        return py::vectorize([&self](double x) { return shared_area(self, x); })(e);
      },
      py::arg("compression"), "Area [m^2] at compression [m]; 0 for compression <= 0.");
}

template <class Area>
Area checked(Area area) {
  validate(area);
  return area;
}

}  // namespace

void bind_felt(py::module_& m) {
  py::class_<ConstantArea> constant(m, "ConstantArea");
  constant.def(py::init([](double size) { return checked(ConstantArea{size}); }), py::arg("size"))
      .def_readonly("size", &ConstantArea::size);
  add_area(constant);
  py::class_<CrossedCylinders> crossed(m, "CrossedCylinders");
  crossed
      .def(py::init([](double a, double b) { return checked(CrossedCylinders{a, b}); }),
           py::arg("radius_a"), py::arg("radius_b"))
      .def_readonly("radius_a", &CrossedCylinders::radius_a)
      .def_readonly("radius_b", &CrossedCylinders::radius_b);
  add_area(crossed);
  py::class_<CircleOnLayer> circle(m, "CircleOnLayer");
  circle
      .def(py::init([](double radius, double width, double length) {
             return checked(CircleOnLayer{radius, width, length});
           }),
           py::arg("radius"), py::arg("width"),
           py::arg("length") = std::numeric_limits<double>::infinity())
      .def_readonly("radius", &CircleOnLayer::radius)
      .def_readonly("width", &CircleOnLayer::width)
      .def_readonly("length", &CircleOnLayer::length);
  add_area(circle);
  py::class_<SphereOnLayer> sphere(m, "SphereOnLayer");
  sphere
      .def(py::init([](double radius) { return checked(SphereOnLayer{radius}); }),
           py::arg("radius"))
      .def_readonly("radius", &SphereOnLayer::radius);
  add_area(sphere);

  py::class_<FeltMaterial>(m, "FeltMaterial")
      .def(py::init([](double mu, double Wf0, double d_f, double v_f0, double v_f_max,
                       std::pair<double, double> loading, std::pair<double, double> unloading,
                       double Q) {
             FeltMaterial out{mu, Wf0, d_f, v_f0, v_f_max, Q, {}, {}};
             out.loading = {loading.first, loading.second};
             out.unloading = {unloading.first, unloading.second};
             validate(out, "felt");
             return out;
           }),
           py::kw_only(), py::arg("mu"), py::arg("Wf0"), py::arg("d_f"), py::arg("v_f0"),
           py::arg("v_f_max"), py::arg("loading"), py::arg("unloading"), py::arg("Q") = 2.0)
      .def_readonly("v_f0", &FeltMaterial::v_f0)
      .def_readonly("v_f_max", &FeltMaterial::v_f_max);

  py::class_<FeltLayer>(m, "FeltLayer")
      .def(py::init([](std::shared_ptr<Envelope> pressure, double thickness,
                       const ContactArea& area, bool columns) {
             return FeltLayer{std::move(pressure), thickness, area,
                              columns ? LayerCompression::kColumns : LayerCompression::kEven};
           }),
           py::arg("pressure"), py::arg("thickness"), py::arg("area"), py::arg("columns") = false);

  m.def(
      "pressure_envelope",
      [](const FeltMaterial& material) {
        const WithoutInterpreter release;
        return std::const_pointer_cast<Envelope>(pressure_envelope(material));
      },
      py::arg("material"), "Pressure [Pa] against strain [-] as a table; kept.");
  m.def(
      "layer_envelope",
      [](const FeltLayer& layer) {
        const WithoutInterpreter release;
        return std::const_pointer_cast<Envelope>(layer_envelope(layer));
      },
      py::arg("layer"), "Envelope of a contact through a felt layer; kept.");

  py::class_<LayerColumns>(m, "LayerColumns")
      .def(py::init<const FeltLayer&, int, double>(), py::arg("layer"), py::arg("columns"),
           py::arg("kappa") = 0.2)
      .def("step", &LayerColumns::step, py::arg("compression"), "Force [N] at compression [m].")
      .def(
          "path",
          [](LayerColumns& self, const std::vector<double>& e) {
            std::vector<double> out;
            {
              const WithoutInterpreter release;
              self.reset();
              for (const double x : e) out.push_back(self.step(x));
            }
            return py::array_t<double>(static_cast<py::ssize_t>(out.size()), out.data());
          },
          py::arg("compression"), "Forces [N] along compressions [m], from virgin felt.");
}

}  // namespace feltmb::python
