#include "fields.hpp"

#include <cmath>
#include <exception>

namespace feltmb::python {
namespace {

py::object limit(double value) { return std::isfinite(value) ? py::cast(value) : py::none(); }

std::string shown(const py::handle& node) { return py::repr(node).cast<std::string>(); }

void set_field(void* object, const char* type, const FieldTable& table, const std::string& name,
               const py::handle& value) {
  std::string known;
  for (const FieldAccess& field : table) {
    if (name != field.name) {
      known += (known.empty() ? "" : ", ") + std::string(field.name);
      continue;
    }
    void* own = static_cast<char*>(object) + field.place;
    try {
      field.write(own, value);
    } catch (const std::exception&) {  // of a cast, or a name that the enum does not have
      throw InvalidParameter(format("%s: %s = %s, expected a value such as %s", type, field.name,
                                    shown(value).c_str(), shown(field.read(own)).c_str()));
    }
    return;
  }
  throw InvalidParameter(std::string(type) + ": unknown field " + name + "; known are " + known);
}

}  // namespace

void add_range(py::dict& out, const Range& range) {
  out["low"] = limit(range.low);
  out["high"] = limit(range.high);
  out["low_open"] = range.low_open;
  out["high_open"] = range.high_open;
}

void set_fields(void* object, const char* type, const FieldTable& table, const py::kwargs& values) {
  for (const auto& [name, value] : values) {
    set_field(object, type, table, name.cast<std::string>(), value);
  }
}

py::list number_fields(const FieldTable& table, const void* standard) {
  py::list out;
  for (const FieldAccess& field : table) {
    if (field.kind == nullptr || *field.unit == '\0') continue;  // a choice or a name
    const bool required = !field.range.holds(field.standard);
    py::dict row = described(field);
    row["required"] = required;
    row["default"] =
        required ? py::none() : field.read(static_cast<const char*>(standard) + field.place);
    out.append(row);
  }
  return out;
}

void add_property(const py::object& type, const char* name, const py::cpp_function& get,
                  const py::cpp_function& set) {
  py::setattr(type, name, py::module_::import("builtins").attr("property")(get, set));
}

}  // namespace feltmb::python
