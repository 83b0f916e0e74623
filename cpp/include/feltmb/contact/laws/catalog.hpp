/// The laws by name: their tables of fields, and laws from names and values, for files and for
/// other languages.
#pragma once

#include <map>
#include <memory>
#include <string>
#include <variant>
#include <vector>

#include "feltmb/contact/laws/list.hpp"

namespace feltmb {

/// Value of a field.
using FieldValue =
    std::variant<double, ExponentialCurve, std::shared_ptr<const Envelope>, std::string,
                 std::map<std::string, double>, std::vector<double>, LawFunction>;

/// A field of a law, as files and other languages see it.
struct FieldInfo {
  std::string name;
  std::string kind;  ///< "number", "curve", "envelope", "text", "parameters", "list", "function"
  std::string unit;
  std::string meaning;
  Range range;
  FieldValue standard;  ///< its default
  bool required;        ///< there is no default
  Place place;
};

/// A law with one of its names.
struct LawInfo {
  std::string name;
  std::string about;
  std::string table;  ///< in mechanism files; empty if no field stands in one
  std::vector<FieldInfo> fields;
};

/// All laws in the order of the list.
const std::vector<LawInfo>& contact_laws();

/// Law by name; missing values have their default. Throws InvalidParameter if the name or a field
/// is unknown or a value of the wrong kind; ranges are checked by ContactLaw.
LawParameters make_contact_law(const std::string& name,
                               const std::map<std::string, FieldValue>& values);

/// Values of all fields.
std::map<std::string, FieldValue> values_of(const LawParameters& law);

LawName chosen_name(const LawParameters& law);

/// Whether two laws have the same name and equal fields; envelopes are equal if they are the same
/// object.
bool same_law(const LawParameters& a, const LawParameters& b);

/// Throws InvalidParameter with every field out of range and every other fault.
void check_fields(const LawParameters& law);

}  // namespace feltmb
