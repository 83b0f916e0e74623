/// Structs with a table of fields as classes of Python: keyword constructor, attributes and the
/// list of fields follow from the table.
#pragma once

#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cstddef>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "feltmb/contact/law.hpp"
#include "feltmb/core/error.hpp"
#include "feltmb/core/fields.hpp"
#include "feltmb/core/vec2.hpp"

namespace feltmb::python {

namespace py = pybind11;

/// Adds the limits of a range, None where there is none.
void add_range(py::dict& out, const Range& range);

/// Name, kind, unit, meaning and limits of a field.
template <class Field>
py::dict described(const Field& field) {
  py::dict out;
  out["name"] = field.name;
  out["kind"] = field.kind;
  out["unit"] = field.unit;
  out["meaning"] = field.meaning;
  add_range(out, field.range);
  return out;
}

/// What Python has of a field: a pair of numbers for a vector, a law for its parameters.
template <class T>
const T& seen(const T& value) {
  return value;
}
inline std::pair<double, double> seen(const Vec2& value) { return {value.x, value.y}; }
inline ContactLaw seen(const LawParameters& value) { return ContactLaw(value); }

template <class T>
using Seen = std::remove_cvref_t<decltype(seen(std::declval<const T&>()))>;

template <class T>
T unseen(const Seen<T>& value) {
  if constexpr (std::is_same_v<T, Vec2>) {
    return {value.first, value.second};
  } else if constexpr (std::is_same_v<T, LawParameters>) {
    return value.parameters();
  } else {
    return value;
  }
}

template <class T>
py::object to_python(const T& value) {
  return py::cast(seen(value));
}

template <class T>
T from_python(const py::handle& node) {
  if constexpr (std::is_enum_v<T>) {
    // By its name too, as files have it.
    if (py::isinstance<py::str>(node))
      return py::type::of(py::cast(T{})).attr(node).template cast<T>();
  }
  return unseen<T>(node.cast<Seen<T>>());
}

/// A field of some struct. The functions know its type and not the struct: what Python needs is
/// compiled once for each type of a field, and not for each field of each struct.
struct FieldAccess {
  const char* name;
  std::ptrdiff_t place;  ///< bytes from the start of the struct
  py::object (*read)(const void* field);
  void (*write)(void* field, const py::handle& node);
  const char* kind;  ///< "number" or "count"; empty: a choice or a name
  const char* unit;
  const char* meaning;
  Range range;
  double standard;  ///< default of a number
};

using FieldTable = std::vector<FieldAccess>;

/// Address of the struct of an object.
using Address = void* (*)(const py::handle& object);

/// Sets fields by their names; throws InvalidParameter if there is none or a value is of another
/// kind.
void set_fields(void* object, const char* type, const FieldTable& table, const py::kwargs& values);

/// Name, kind, unit, meaning, limits and default of the numbers of a struct.
py::list number_fields(const FieldTable& table, const void* standard);

void add_property(const py::object& type, const char* name, const py::cpp_function& get,
                  const py::cpp_function& set);

template <class T>
FieldAccess bind_field(const py::object& type, Address address, const char* name,
                       std::ptrdiff_t place) {
  const auto field = [address, place](const py::handle& self) -> T& {
    return *reinterpret_cast<T*>(static_cast<char*>(address(self)) + place);
  };
  add_property(
      type, name,
      py::cpp_function([field](const py::handle& self) { return Seen<T>(seen(field(self))); },
                       py::is_method(type)),
      py::cpp_function(
          [field](const py::handle& self, const Seen<T>& value) { field(self) = unseen<T>(value); },
          py::is_setter(), py::is_method(type)));
  FieldAccess out{};
  out.name = name;
  out.place = place;
  out.read = [](const void* own) { return to_python(*static_cast<const T*>(own)); };
  out.write = [](void* own, const py::handle& node) {
    *static_cast<T*>(own) = from_python<T>(node);
  };
  return out;
}

/// The class of a struct: `Name(field=value, ...)`, attributes, `names` of all fields and
/// `numbers`, the table of those that are numbers.
template <class S>
py::class_<S> bind_fields(py::module_& m, const char* type) {
  py::class_<S> out(m, type);
  FieldTable table;
  std::vector<std::string> names;
  S standard{};
  each_field(standard, [&]<class F, class T>(const F& field, T& value) {
    const auto place = reinterpret_cast<char*>(&value) - reinterpret_cast<char*>(&standard);
    FieldAccess access = bind_field<T>(
        out, [](const py::handle& object) -> void* { return &object.cast<S&>(); }, field.name,
        place);
    if constexpr (std::is_same_v<T, double> || std::is_same_v<T, int>) {
      access.kind = std::is_same_v<T, int> ? "count" : "number";
      access.standard = value;
    }
    access.unit = field.unit;
    access.meaning = field.meaning;
    access.range = field.range;
    table.push_back(access);
    names.emplace_back(field.name);
  });
  out.def_static("field_names", [names] { return names; }, "Names of all fields.");
  out.def_static(
      "number_fields",
      [table] {
        const S object{};
        return number_fields(table, &object);
      },
      "Name, kind, unit, meaning, limits and default of the fields that are numbers.");
  out.def(py::init([type, table](const py::kwargs& values) {
            S object{};
            set_fields(&object, type, table, values);
            return object;
          }),
          "From its fields, SI; what is not given keeps its default.");
  return out;
}

}  // namespace feltmb::python
