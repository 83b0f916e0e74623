#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include <cmath>
#include <cstdint>

#include "bindings.hpp"
#include "feltmb/contact/friction.hpp"
#include "feltmb/contact/law.hpp"
#include "feltmb/contact/laws/catalog.hpp"
#include "feltmb/contact/path.hpp"
#include "fields.hpp"

namespace py = pybind11;

namespace feltmb::python {

namespace {

/// The values that make_law takes, from keywords.
std::map<std::string, FieldValue> values_from(const py::dict& fields) {
  std::map<std::string, FieldValue> values;
  for (const auto& [key, node] : fields) {
    const auto name = key.cast<std::string>();
    if (py::isinstance<Envelope>(node)) {
      values[name] = std::shared_ptr<const Envelope>(node.cast<std::shared_ptr<Envelope>>());
    } else if (py::isinstance<ExponentialCurve>(node)) {
      values[name] = node.cast<ExponentialCurve>();
    } else if (py::isinstance<py::str>(node)) {
      values[name] = node.cast<std::string>();
    } else if (py::isinstance<py::dict>(node)) {
      values[name] = node.cast<std::map<std::string, double>>();
    } else if (py::isinstance<py::list>(node)) {
      values[name] = node.cast<std::vector<double>>();
    } else if (name == "function") {
      // An address: what Python's ctypes and numba give of a compiled function.
      values[name] = reinterpret_cast<LawFunction>(node.cast<std::uintptr_t>());
    } else {
      values[name] = node.cast<double>();
    }
  }
  return values;
}

py::object from_value(const FieldValue& value) {
  if (const auto* envelope = std::get_if<std::shared_ptr<const Envelope>>(&value)) {
    return py::cast(std::const_pointer_cast<Envelope>(*envelope));
  }
  if (const auto* function = std::get_if<LawFunction>(&value)) {
    return py::cast(reinterpret_cast<std::uintptr_t>(*function));
  }
  return std::visit(
      []<class T>(const T& own) -> py::object {
        if constexpr (std::is_same_v<T, LawFunction>) {
          return py::none();  // done above
        } else {
          return py::cast(own);
        }
      },
      value);
}

py::dict as_dict(const FieldInfo& field) {
  py::dict out = described(field);
  out["required"] = field.required;
  out["default"] = field.required ? py::none() : from_value(field.standard);
  out["in_contact"] = field.place == Place::kContact;
  return out;
}

py::list list_laws() {
  py::list out;
  for (const LawInfo& law : contact_laws()) {
    py::list fields;
    for (const FieldInfo& field : law.fields) fields.append(as_dict(field));
    py::dict entry;
    entry["name"] = law.name;
    entry["about"] = law.about;
    entry["table"] = law.table;
    entry["fields"] = fields;
    out.append(entry);
  }
  return out;
}

}  // namespace

void bind_contact(py::module_& m) {
  bind_fields<Friction>(m, "Friction")
      .def_property_readonly("acts", &Friction::acts, "Whether a term is there.")
      .def_property_readonly("turns_over", &Friction::turns_over,
                             "Whether a term that acts turns over near the threshold speed.")
      .def("dry", &Friction::dry, "The terms that hold a joint back at speeds near zero, alone.")
      .def("sharpened", &Friction::sharpened, py::arg("threshold_speed"),
           "The limit of a threshold speed of zero, regularized at a chosen speed.")
      .def_property_readonly(
          "dry_speeds",
          [](const Friction& f) {
            const SpeedRange range = f.dry_speeds();
            return py::make_tuple(range.low, range.high);
          },
          "Speeds between which the dry terms rise and die away; infinite: they do not.")
      .def(
          "coefficient",
          [](const Friction& f, py::array_t<double> v) {
            return py::vectorize([&f](double x) { return evaluate(f, x).value; })(v);
          },
          py::arg("speed"), "Sum of all terms at sliding speed [m/s or rad/s].");

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

  py::class_<Envelope, std::shared_ptr<Envelope>>(m, "Envelope")
      .def_static(
          "from_curves",
          [](const ExponentialCurve& loading, const ExponentialCurve& unloading, double closing) {
            return std::const_pointer_cast<Envelope>(
                Envelope::from_curves(loading, unloading, closing));
          },
          py::arg("loading"), py::arg("unloading"), py::arg("closing") = 0.0)
      .def_static(
          "from_table",
          [](const std::vector<double>& compression, const std::vector<double>& loading,
             const std::vector<double>& unloading) {
            return std::const_pointer_cast<Envelope>(
                Envelope::from_table(compression, loading, unloading));
          },
          py::arg("compression"), py::arg("loading"), py::arg("unloading"))
      .def_property_readonly("closing", &Envelope::closing, "Compression e_M [m].")
      .def(
          "loading",
          [](const Envelope& e, py::array_t<double> x) {
            return py::vectorize([&e](double v) { return e.loading(v).force; })(x);
          },
          py::arg("compression"), "Virgin loading force [N].")
      .def(
          "unloading",
          [](const Envelope& e, py::array_t<double> x, double largest) {
            return py::vectorize([&e, largest](double v) {
              return v <= 0.0 ? 0.0 : e.loading(v).force * e.ratio(v / largest, largest).force;
            })(x);
          },
          py::arg("compression"), py::arg("largest"),
          "Unloading force [N] of the cycle to the compression `largest` [m].")
      .def(
          "loop_area",
          [](const Envelope& e, py::array_t<double> x) {
            return py::vectorize([&e](double v) { return e.loop_area(v).force; })(x);
          },
          py::arg("largest"), "Energy lost [J] in the cycle to `largest` [m].")
      .def(
          "loading_energy",
          [](const Envelope& e, py::array_t<double> x) {
            return py::vectorize([&e](double v) { return e.loading_energy(v); })(x);
          },
          py::arg("compression"), "Work [J] of a virgin loading to compression [m].")
      .def(
          "unloading_energy",
          [](const Envelope& e, py::array_t<double> x, double largest) {
            return py::vectorize(
                [&e, largest](double v) { return e.unloading_energy(v, largest); })(x);
          },
          py::arg("compression"), py::arg("largest"),
          "Work [J] that the cycle to `largest` [m] gives back from compression [m].")
      .def_property_readonly(
          "repair",
          [](const Envelope& e) {
            return py::make_tuple(e.repair().force, e.repair().low, e.repair().high);
          },
          "Largest change [N] of the unloading force that made its shape monotone, from and to "
          "[m]; "
          "zeros if none.");
  py::class_<ContactLaw>(m, "ContactLaw")
      .def(py::init([](const std::string& name, const py::kwargs& fields) {
             return ContactLaw(make_contact_law(name, values_from(fields)));
           }),
           py::arg("name"), "A contact law by its name and the fields of contact_laws(), SI.")
      .def_property_readonly(
          "fields",
          [](const ContactLaw& law) {
            py::dict out;
            for (const auto& [name, value] : values_of(law.parameters())) {
              out[name.c_str()] = from_value(value);
            }
            return out;
          },
          "Values of all fields by name.")
      .def_property_readonly("name", &ContactLaw::name)
      .def_property_readonly("n_states", &ContactLaw::n_states)
      .def_property_readonly("has_memory", &ContactLaw::has_memory)
      .def(
          "force",
          [](const ContactLaw& law, py::array_t<double> e, py::array_t<double> rate,
             const std::vector<double>& state, double largest) {
            std::array<double, kMaxLawStates> s{};
            std::copy_n(state.begin(), std::min(state.size(), s.size()), s.begin());
            return py::vectorize([&](double x, double v) {
              return law.evaluate(x, v, {s.data(), largest}).force;
            })(e, rate);
          },
          py::arg("compression"), py::arg("rate") = 0.0, py::arg("state") = std::vector<double>{},
          py::arg("largest") = 0.0,
          "Normal force [N] at compression [m] and compression rate [m/s].")
      .def(
          "evaluate",
          [](const ContactLaw& law, double e, double rate, const std::vector<double>& state,
             double largest) {
            std::array<double, kMaxLawStates> s{};
            std::copy_n(state.begin(), std::min(state.size(), s.size()), s.begin());
            LawStates states;
            const LawValue v = law.evaluate(e, rate, {s.data(), largest}, &states);
            py::dict out;
            out["force"] = v.force;
            out["d_compression"] = v.d_compression;
            out["d_rate"] = v.d_rate;
            out["d_state"] = states.force;
            out["state_rate"] = states.rate;
            out["rate_by_compression"] = states.rate_by_compression;
            out["rate_by_rate"] = states.rate_by_rate;
            out["rate_by_state"] = states.rate_by_state;
            out["dissipated_power"] = law.dissipated_power(e, rate, {s.data(), largest});
            out["stored_energy"] = law.stored_energy(e, {s.data(), largest});
            return out;
          },
          py::arg("compression"), py::arg("rate"), py::arg("state"), py::arg("largest"),
          "Force, slopes, state rates and powers at one point, as a dict.")
      .def(
          "slopes",
          [](const ContactLaw& law, double e, double rate) {
            std::array<double, kMaxLawStates> s{};
            const LawValue v = law.evaluate(e, rate, {s.data(), 0.0});
            return py::make_tuple(v.d_compression, v.d_rate);
          },
          py::arg("compression"), py::arg("rate") = 0.0, "dF/de [N/m] and dF/d(de/dt) [N s/m].")
      .def(
          "stored_energy",
          [](const ContactLaw& law, py::array_t<double> e) {
            return py::vectorize([&law](double x) { return law.static_energy(x); })(e);
          },
          py::arg("compression"), "Energy [J] stored under a virgin compression, states at rest.");

  py::class_<LawPath>(m, "LawPath")
      .def(py::init<const ContactLaw&>(), py::arg("law"), py::keep_alive<1, 2>())
      .def("reset", &LawPath::reset)
      .def("step", &LawPath::step, py::arg("compression"), py::arg("duration"),
           "Moves to compression [m] within duration [s]; returns the force [N].")
      .def("peek", &LawPath::peek, py::arg("compression"), py::arg("duration"),
           "Force [N] if the step were taken; the memory stays.")
      .def("save", &LawPath::save, "Compression, largest one, states, turning points, as numbers.")
      .def(
          "restore", [](LawPath& path, const std::vector<double>& saved) { path.restore(saved); },
          py::arg("saved"))
      .def(
          "energy",
          [](const LawPath& path, const ContactLaw& law) {
            return law.stored_energy(path.compression(), path.memory());
          },
          py::arg("law"), "Stored energy [J].")
      .def_property_readonly("compression", &LawPath::compression)
      .def_property_readonly("largest", &LawPath::largest)
      .def_property_readonly("state", &LawPath::state);
  m.def("contact_laws", &list_laws,
        "All contact laws: name, about, table and fields, each with name, kind, unit, meaning, "
        "limits, default and whether it stands in the contact itself.");
  m.def(
      "force_along",
      [](const ContactLaw& law, const std::vector<double>& time,
         const std::vector<double>& compression) {
        std::vector<double> out;
        {
          const WithoutInterpreter release;
          out = force_along(law, time, compression);
        }
        return py::array_t<double>(static_cast<py::ssize_t>(out.size()), out.data());
      },
      py::arg("law"), py::arg("time"), py::arg("compression"),
      "Forces [N] of a law along a compression history.");
}

}  // namespace feltmb::python
