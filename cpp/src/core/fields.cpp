#include "feltmb/core/fields.hpp"

#include <cmath>
#include <string_view>

#include "feltmb/core/error.hpp"

namespace feltmb {

bool Range::holds(double value) const {
  if (!std::isfinite(value)) return false;
  return (low_open ? value > low : value >= low) && (high_open ? value < high : value <= high);
}

std::string Range::text() const {
  const bool bottom = std::isfinite(low);
  const bool top = std::isfinite(high);
  if (bottom && top) {
    return format("in %c%g, %g%c", low_open ? '(' : '[', low, high, high_open ? ')' : ']');
  }
  if (bottom) return format("%s %g", low_open ? ">" : ">=", low);
  if (top) return format("%s %g", high_open ? "<" : "<=", high);
  return "finite";
}

std::string unit_at(const char* unit, Site site) {
  constexpr std::string_view between = " | ";
  std::string_view units(unit);
  if (units.find(between) == units.npos) return std::string(units);
  if (site == Site::kAny) return "1";
  // A contact has the unit of a prismatic joint where there are two.
  for (int i = static_cast<int>(site) - static_cast<int>(Site::kRevolute); i > 0; --i) {
    const std::size_t end = units.find(between);
    if (end == units.npos) break;
    units.remove_prefix(end + between.size());
  }
  return std::string(units.substr(0, units.find(between)));
}

std::string number_fault(const char* name, double value, const char* unit, const Range& range,
                         Site site) {
  const std::string shown = unit_at(unit, site);
  const bool plain = shown == "1";
  return format("%s = %.6g%s%s, must be %s", name, value, plain ? "" : " ",
                plain ? "" : shown.c_str(), range.text().c_str());
}

}  // namespace feltmb
