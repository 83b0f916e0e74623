/// Collects all faults of a set of arguments for one exception.
#pragma once

#include <cmath>
#include <string>
#include <vector>

#include "feltmb/core/error.hpp"

namespace feltmb {

/// Faults found in the arguments of one function or law.
class Faults {
 public:
  /// @param where  name of the function, law or file that checks, put in front of every line
  explicit Faults(std::string where) : where_(std::move(where)) {}

  /// Adds "where: name = value unit, must be expected (hint)".
  void add(const char* name, double value, const char* unit, const std::string& expected,
           const std::string& hint = "") {
    std::string line = format("%s: %s = %.6g", where_.c_str(), name, value);
    if (unit[0] != '\0') line += std::string(" ") + unit;
    line += ", must be " + expected;
    if (!hint.empty()) line += " (" + hint + ")";
    lines_.push_back(line);
  }
  void add_text(const std::string& text) { lines_.push_back(where_ + ": " + text); }

  void positive(const char* name, double value, const char* unit, const std::string& hint = "") {
    if (!(value > 0.0) || !std::isfinite(value)) add(name, value, unit, "finite and > 0", hint);
  }
  void not_negative(const char* name, double value, const char* unit,
                    const std::string& hint = "") {
    if (!(value >= 0.0) || !std::isfinite(value)) add(name, value, unit, "finite and >= 0", hint);
  }
  void finite(const char* name, double value, const char* unit, const std::string& hint = "") {
    if (!std::isfinite(value)) add(name, value, unit, "finite", hint);
  }
  /// Closed range [low, high].
  void within(const char* name, double value, double low, double high, const char* unit,
              const std::string& hint = "") {
    if (!(value >= low && value <= high)) {
      add(name, value, unit, format("between %.6g and %.6g", low, high), hint);
    }
  }

  [[nodiscard]] bool any() const { return !lines_.empty(); }

  /// Throws InvalidParameter with one line per fault.
  void raise_if_any() const {
    if (lines_.empty()) return;
    std::string text;
    for (const std::string& line : lines_) text += (text.empty() ? "" : "\n") + line;
    throw InvalidParameter(text);
  }

 private:
  std::string where_;
  std::vector<std::string> lines_;
};

}  // namespace feltmb
