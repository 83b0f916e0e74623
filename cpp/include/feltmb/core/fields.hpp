/// Tables of fields: the only list of the numbers of a struct with unit, range and meaning. Schemas
/// of files, keyword constructors of other languages, messages and references are derived from it.
#pragma once

#include <limits>
#include <string>
#include <tuple>
#include <type_traits>

namespace feltmb {

/// Permitted values of a number; all are finite.
struct Range {
  double low = -std::numeric_limits<double>::infinity();
  double high = std::numeric_limits<double>::infinity();
  bool low_open = false;   ///< `low` itself is not permitted
  bool high_open = false;  ///< `high` itself is not permitted

  bool holds(double value) const;
  std::string text() const;  ///< such as "> 0" or "in (0, 2]"
};

/// Place of a number whose unit depends on the place.
enum class Site { kAny, kRevolute, kPrismatic, kContact };

/// Unit at one place from the units of all, "N m | N | 1"; "1" if none is stated.
std::string unit_at(const char* unit, Site site);

/// "name = value unit, must be range", with the unit of the place.
std::string number_fault(const char* name, double value, const char* unit, const Range& range,
                         Site site = Site::kAny);

constexpr Range any_number() { return {}; }
constexpr Range above(double low) {
  Range range;
  range.low = low;
  range.low_open = true;
  return range;
}
constexpr Range at_least(double low) {
  Range range;
  range.low = low;
  return range;
}
constexpr Range up_to(Range range, double high) {
  range.high = high;
  return range;
}
constexpr Range below(Range range, double high) {
  range.high = high;
  range.high_open = true;
  return range;
}

/// Place of a field in a mechanism file.
enum class Place {
  kTable,    ///< in the table of its own struct
  kContact,  ///< of a law: in the contact itself, shared by the laws that have it
};

/// A field of a struct S. It is required if it has no default, i.e. for a curve, or a number whose
/// default is out of its range.
template <class S, class T>
struct Field {
  const char* name;
  T S::* member;
  const char* unit;  ///< SI; "1" of a pure number, "N/m^p" where it depends on the exponent,
                     ///< "N m | N | 1" where it is another at a revolute joint, a prismatic joint
                     ///< and a contact (two: a contact has that of a prismatic joint)
  Range range;
  const char* meaning;
  Place place = Place::kTable;
};

template <class S>
constexpr Field<S, double> number(const char* name, double S::* member, const char* unit,
                                  Range range, const char* meaning, Place place = Place::kTable) {
  return {name, member, unit, range, meaning, place};
}

template <class S>
constexpr Field<S, int> count(const char* name, int S::* member, Range range, const char* meaning) {
  return {name, member, "1", range, meaning};
}

template <class S, class T>
constexpr Field<S, T> entry(const char* name, T S::* member, const char* meaning,
                            Place place = Place::kTable) {
  return {name, member, "", {}, meaning, place};
}

/// Calls `use(field, its value)` for each field of an object.
template <class S, class Use>
void each_field(S& object, Use&& use) {
  std::apply([&](const auto&... field) { (use(field, object.*(field.member)), ...); },
             std::remove_const_t<S>::fields());
}

/// Whether all fields of two objects are equal.
template <class S>
bool same_fields(const S& a, const S& b) {
  return std::apply(
      [&](const auto&... field) { return ((a.*(field.member) == b.*(field.member)) && ...); },
      S::fields());
}

/// Calls `fault(text)` for each number that is out of its range.
template <class S, class Fault>
void check_numbers(const S& object, Fault&& fault, Site site = Site::kAny) {
  each_field(object, [&]<class F, class T>(const F& field, const T& value) {
    if constexpr (std::is_same_v<T, double> || std::is_same_v<T, int>) {
      if (!field.range.holds(value))
        fault(number_fault(field.name, value, field.unit, field.range, site));
    }
  });
}

}  // namespace feltmb
