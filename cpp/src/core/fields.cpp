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

std::string number_fault(const char* name, double value, const char* unit, const Range& range) {
  const std::string_view shown = unit;
  const bool plain = shown == "1" || shown.find('|') != shown.npos;  // no unit, or one of several
  return format("%s = %.6g%s%s, must be %s", name, value, plain ? "" : " ", plain ? "" : unit,
                range.text().c_str());
}

}  // namespace feltmb
