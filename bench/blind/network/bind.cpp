#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include <optional>

#include "feltmb/core/error.hpp"
#include "network.hpp"

namespace py = pybind11;

namespace feltmb::lumped {
namespace {

using Doubles = py::array_t<double, py::array::c_style | py::array::forcecast>;

Sum sum_of(const py::handle& list) {
  Sum sum;
  for (const py::handle& item : list) {
    const auto pair = item.cast<std::pair<int, double>>();
    sum.push_back({pair.first, pair.second});
  }
  return sum;
}

Sum sum_of(const py::dict& d, const char* key) { return d.contains(key) ? sum_of(d[key]) : Sum{}; }

Travel travel_of(const py::dict& d) {
  return {sum_of(d, "coordinates"), sum_of(d, "hidden"),
          d.contains("input") ? d["input"].cast<double>() : 0.0, sum_of(d, "offset")};
}

Element element_of(const py::dict& d) {
  const auto kind = d["kind"].cast<std::string>();
  Element e{Kind::contact, travel_of(d), {}, {}, {}, {}, {}};
  if (kind == "contact") {
    e.a = sum_of(d, "stiffness");
    e.b = sum_of(d, "exponent");
    e.c = sum_of(d, "loss");
    for (const py::handle& item : d.contains("gates") ? d["gates"] : py::list()) {
      const auto gate = item.cast<py::dict>();
      e.gates.push_back({travel_of(gate), sum_of(gate, "width")});
    }
  } else if (kind == "spring") {
    e.kind = Kind::spring;
    e.a = sum_of(d, "stiffness");
    e.b = sum_of(d, "damping");
    e.c = sum_of(d, "cubic");
  } else if (kind == "friction") {
    e.kind = Kind::friction;
    e.a = sum_of(d, "viscous");
    e.b = sum_of(d, "coulomb");
    e.c = sum_of(d, "sliding_speed");
    e.d = sum_of(d, "quadratic");
  } else if (kind == "drive") {
    e.kind = Kind::drive;
    e.a = sum_of(d, "constant");
  } else {
    throw InvalidParameter("lumped network: element of kind '" + kind +
                           "', expected contact, spring, friction or drive");
  }
  return e;
}

Network network_of(const py::dict& d) {
  Network n;
  for (const py::handle& mass : d["masses"]) {
    n.masses.push_back(sum_of(mass));
  }
  for (const py::handle& e : d["elements"]) {
    n.elements.push_back(element_of(e.cast<py::dict>()));
  }
  for (const py::handle& item : d["hidden"]) {
    const auto h = item.cast<py::dict>();
    n.hidden.push_back({h["mode"].cast<bool>(), h["sources"].cast<std::vector<int>>(),
                        sum_of(h, "gain"), sum_of(h, "time"), sum_of(h, "damping")});
  }
  for (const py::handle& item : d["sensors"]) {
    const auto s = item.cast<py::dict>();
    n.sensors.push_back({travel_of(s), sum_of(s, "scale"), sum_of(s, "gauge_offset"),
                         sum_of(s, "delay"), sum_of(s, "flexibility"),
                         s.contains("element") ? s["element"].cast<int>() : -1});
  }
  const auto input = d["input"].cast<py::dict>();
  n.input = {sum_of(input, "gain"), sum_of(input, "offset"), sum_of(input, "delay")};
  n.parameters = d["parameters"].cast<int>();
  n.sample_time = d["sample_time"].cast<double>();
  n.substeps = d["substeps"].cast<int>();
  n.check();
  return n;
}

Doubles array(const std::vector<double>& values, std::vector<py::ssize_t> shape) {
  return Doubles(std::move(shape), values.data());
}

std::span<const double> view(const Doubles& a) {
  return {a.data(), static_cast<std::size_t>(a.size())};
}

}  // namespace

void bind_network(py::module_& m) {
  py::class_<Network>(m, "LumpedNetwork", "Network of lumped masses; see lumped.py.",
                      py::module_local())
      .def(py::init(&network_of), py::arg("description"))
      .def_property_readonly("states", &Network::states)
      .def_readonly("parameters", &Network::parameters)
      .def(
          "simulate",
          [](const Network& net, const Doubles& parameters, const std::vector<Doubles>& inputs,
             const py::array_t<int, py::array::c_style | py::array::forcecast>& segments,
             const Doubles& starts, const std::vector<int>& wanted,
             const std::vector<int>& wanted_states, bool forces,
             const std::optional<Doubles>& unknown) {
            if (segments.ndim() != 2 || segments.shape(1) != 4) {
              throw InvalidParameter("lumped network: segments must have the shape (n, 4)");
            }
            std::vector<Segment> pieces;
            py::ssize_t rows = 0;
            for (py::ssize_t i = 0; i < segments.shape(0); ++i) {
              const int* s = segments.data(i, 0);
              pieces.push_back({s[0], s[1], s[2], s[3]});
              rows += s[2] + 1;
            }
            std::vector<std::span<const double>> signals;
            for (const Doubles& u : inputs) {
              signals.push_back(view(u));
            }
            Request request{view(parameters), signals, pieces, view(starts), wanted, wanted_states,
                            forces,           0,       {}};
            if (unknown) {
              if (unknown->ndim() != 3) {
                throw InvalidParameter(
                    "lumped network: unknown forces must have the shape (segments, masses, knots)");
              }
              request.knots = static_cast<int>(unknown->shape(2));
              request.unknown = view(*unknown);
            }
            Batch b;
            {
              const py::gil_scoped_release free;
              b = simulate(net, request);
            }
            const auto n_y = static_cast<py::ssize_t>(net.sensors.size());
            const auto n_g = static_cast<py::ssize_t>(pieces.size());
            const auto n_e = static_cast<py::ssize_t>(net.elements.size());
            return py::make_tuple(array(b.outputs, {rows, n_y}), array(b.ends, {n_g, net.states()}),
                                  array(b.d_outputs, {rows, n_y, b.columns}),
                                  array(b.d_ends, {n_g, net.states(), b.columns}),
                                  array(b.forces, {forces ? rows : 0, n_e}));
          },
          py::arg("parameters"), py::arg("inputs"), py::arg("segments"), py::arg("starts"),
          py::arg("wanted") = std::vector<int>{}, py::arg("wanted_states") = std::vector<int>{},
          py::arg("forces") = false, py::arg("unknown") = py::none(),
          "(outputs, ends, d_outputs, d_ends, forces) of segments (input, first, steps, row).");
}

}  // namespace feltmb::lumped

PYBIND11_MODULE(_network, m) {
  m.doc() = "Networks of lumped masses; see lumped.py.";
  // As in the core, exceptions are those of Python's unmodeled.errors; never destroyed.
  static PyObject* invalid =
      py::object(py::module_::import("unmodeled.errors").attr("InvalidParameter")).release().ptr();
  py::register_local_exception_translator([](std::exception_ptr p) {
    try {
      if (p) std::rethrow_exception(p);
    } catch (const feltmb::InvalidParameter& e) {
      PyErr_SetString(invalid, e.what());
    }
  });
  feltmb::lumped::bind_network(m);
}
