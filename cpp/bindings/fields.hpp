/// Structs with a table of fields as classes of Python: keyword constructor, attributes and the
/// list of fields follow from the table.
#pragma once

#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cmath>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "feltmb/contact/law.hpp"
#include "feltmb/core/error.hpp"
#include "feltmb/core/fields.hpp"
#include "feltmb/core/vec2.hpp"

namespace feltmb::python {

namespace py = pybind11;

/// A limit of a range, None where there is none.
inline py::object limit(double value) {
  return std::isfinite(value) ? py::cast(value) : py::none();
}

inline void add_range(py::dict& out, const Range& range) {
  out["low"] = limit(range.low);
  out["high"] = limit(range.high);
  out["low_open"] = range.low_open;
  out["high_open"] = range.high_open;
}

inline std::string shown(const py::handle& node) { return py::repr(node).cast<std::string>(); }

template <class T>
py::object to_python(const T& value) {
  if constexpr (std::is_same_v<T, Vec2>) {
    return py::make_tuple(value.x, value.y);
  } else if constexpr (std::is_same_v<T, LawParameters>) {
    return py::cast(ContactLaw(value));
  } else {
    return py::cast(value);
  }
}

template <class T>
T from_python(const py::handle& node) {
  if constexpr (std::is_same_v<T, Vec2>) {
    const auto [x, y] = node.cast<std::pair<double, double>>();
    return {x, y};
  } else if constexpr (std::is_same_v<T, LawParameters>) {
    return node.cast<const ContactLaw&>().parameters();
  } else if constexpr (std::is_enum_v<T>) {
    // By its name too, as files have it.
    if (py::isinstance<py::str>(node))
      return py::type::of(py::cast(T{})).attr(node).template cast<T>();
    return node.cast<T>();
  } else {
    return node.cast<T>();
  }
}

/// Sets a field by its name; throws InvalidParameter if there is none or the value is of another
/// kind.
template <class S>
void set_field(S& object, const char* type, const std::string& name, const py::handle& value) {
  bool found = false;
  std::string known;
  each_field(object, [&]<class F, class T>(const F& field, T& own) {
    known += (known.empty() ? "" : ", ") + std::string(field.name);
    if (name != field.name) return;
    found = true;
    try {
      own = from_python<T>(value);
    } catch (const std::exception&) {  // of a cast, or a name that the enum does not have
      throw InvalidParameter(format("%s: %s = %s, expected a value such as %s", type, field.name,
                                    shown(value).c_str(), shown(to_python(own)).c_str()));
    }
  });
  if (!found) {
    throw InvalidParameter(std::string(type) + ": unknown field " + name + "; known are " + known);
  }
}

/// Name, kind, unit, meaning, limits and default of the numbers of a struct.
template <class S>
py::list number_fields() {
  py::list out;
  const S standard{};
  each_field(standard, [&]<class F, class T>(const F& field, const T& value) {
    if constexpr (std::is_same_v<T, double> || std::is_same_v<T, int>) {
      if (*field.unit == '\0') return;  // a choice or a name
      py::dict row;
      row["name"] = field.name;
      row["kind"] = std::is_same_v<T, int> ? "count" : "number";
      row["unit"] = field.unit;
      row["meaning"] = field.meaning;
      add_range(row, field.range);
      row["required"] = !field.range.holds(value);
      row["default"] = field.range.holds(value) ? py::cast(value) : py::none();
      out.append(row);
    }
  });
  return out;
}

/// The class of a struct: `Name(field=value, ...)`, attributes, `names` of all fields and
/// `numbers`, the table of those that are numbers.
template <class S>
py::class_<S> bind_fields(py::module_& m, const char* type) {
  py::class_<S> out(m, type);
  out.def(py::init([type](const py::kwargs& values) {
            S object{};
            for (const auto& [key, value] : values) {
              set_field(object, type, key.template cast<std::string>(), value);
            }
            return object;
          }),
          "From its fields, SI; what is not given keeps its default.");
  std::vector<std::string> names;
  std::apply(
      [&](const auto&... field) {
        const auto add = [&](const auto& one) {
          const auto member = one.member;
          using T = std::remove_cvref_t<decltype(std::declval<S>().*member)>;
          names.emplace_back(one.name);
          if constexpr (std::is_same_v<T, Vec2>) {
            out.def_property(
                one.name,
                [member](const S& object) {
                  return std::pair((object.*member).x, (object.*member).y);
                },
                [member](S& object, std::pair<double, double> value) {
                  object.*member = {value.first, value.second};
                });
          } else if constexpr (std::is_same_v<T, LawParameters>) {
            out.def_property(
                one.name, [member](const S& object) { return ContactLaw(object.*member); },
                [member](S& object, const ContactLaw& law) { object.*member = law.parameters(); });
          } else {
            out.def_property(
                one.name, [member](const S& object) { return T(object.*member); },
                [member](S& object, const T& value) { object.*member = value; });
          }
        };
        (add(field), ...);
      },
      S::fields());
  out.def_static(
      "field_names", [names = std::move(names)] { return names; }, "Names of all fields.");
  out.def_static(
      "number_fields", [] { return number_fields<S>(); },
      "Name, kind, unit, meaning, limits and default of the fields that are numbers.");
  return out;
}

}  // namespace feltmb::python
