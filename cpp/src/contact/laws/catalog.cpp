#include "feltmb/contact/laws/catalog.hpp"

#include <cmath>
#include <iterator>
#include <optional>
#include <tuple>
#include <type_traits>

#include "feltmb/core/error.hpp"

namespace feltmb {
namespace {

constexpr const char* kind_of(const double&) { return "number"; }
constexpr const char* kind_of(const ExponentialCurve&) { return "curve"; }
constexpr const char* kind_of(const std::shared_ptr<const Envelope>&) { return "envelope"; }
constexpr const char* kind_of(const std::string&) { return "text"; }
constexpr const char* kind_of(const std::map<std::string, double>&) { return "parameters"; }
constexpr const char* kind_of(const std::vector<double>&) { return "list"; }
constexpr const char* kind_of(const LawFunction&) { return "function"; }

/// Whether a value is one that a law can do with: a default that is not is none.
template <class T>
bool given(const Range& range, const T& value) {
  if constexpr (std::is_same_v<T, double>) {
    return range.holds(value);
  } else if constexpr (std::is_same_v<T, ExponentialCurve>) {
    return value.a != 0.0 || value.b != 0.0 || value.c != 0.0;
  } else if constexpr (std::is_same_v<T, std::string>) {
    return !value.empty();
  } else if constexpr (requires { value == nullptr; }) {
    return value != nullptr;
  } else {
    return true;  // a list or a table may be empty
  }
}

template <class L>
std::string table_of() {
  if constexpr (requires { L::kTable; }) return L::kTable;
  return L::kNames[0].name;
}

template <class L>
void add_info(std::vector<LawInfo>& all) {
  for (const LawName& name : L::kNames) {
    LawInfo& info = all.emplace_back(LawInfo{name.name, name.about, "", {}});
    const L standard{};
    each_field(standard, [&](const auto& field, const auto& value) {
      if (field.place == Place::kTable) info.table = table_of<L>();
      info.fields.push_back({field.name, kind_of(value), field.unit, field.meaning, field.range,
                             value, !given(field.range, value), field.place});
    });
  }
}

template <class T>
struct OfList;
template <class... Ls>
struct OfList<std::variant<Ls...>> {
  static std::vector<LawInfo> infos() {
    std::vector<LawInfo> all;
    (add_info<Ls>(all), ...);
    return all;
  }
  /// The law with a name, its fields at their defaults.
  static std::optional<LawParameters> find(const std::string& name) {
    std::optional<LawParameters> found;
    (look<Ls>(name, found), ...);
    return found;
  }

 private:
  template <class L>
  static void look(const std::string& name, std::optional<LawParameters>& found) {
    for (std::size_t i = 0; i < std::size(L::kNames); ++i) {
      if (name != L::kNames[i].name) continue;
      L law{};
      if constexpr (requires { law.choose(i); }) law.choose(i);
      found = law;
    }
  }
};

void check_curve(LawFaults& faults, const ExponentialCurve& curve, const char* which) {
  for (const auto& [name, value] : {std::pair{"a [N/m]", curve.a}, {"c [N/m]", curve.c}}) {
    if (!std::isfinite(value)) {
      faults.add(format("%s curve: %s = %.6g, must be finite", which, name, value));
    }
  }
  if (!(std::isfinite(curve.b) && curve.b >= 0.0)) {
    faults.add(format("%s curve: b = %.6g 1/m, must be finite and >= 0", which, curve.b));
  }
}

}  // namespace

void LawFaults::add(const std::string& text) { text_ += (text_.empty() ? "" : "; ") + text; }

void LawFaults::require(bool ok, const char* field, double value, const char* range) {
  if (!ok) add(format("%s = %.6g, must be %s", field, value, range));
}

void LawFaults::raise() const {
  if (!text_.empty()) throw InvalidParameter(text_);
}

const std::vector<LawInfo>& contact_laws() {
  static const auto& all = *new std::vector<LawInfo>(OfList<LawParameters>::infos());
  return all;
}

LawParameters make_contact_law(const std::string& name,
                               const std::map<std::string, FieldValue>& values) {
  std::optional<LawParameters> made = OfList<LawParameters>::find(name);
  if (!made) {
    std::string known;
    for (const LawInfo& law : contact_laws()) known += (known.empty() ? "" : ", ") + law.name;
    throw InvalidParameter("law \"" + name + "\" is unknown; known are " + known);
  }
  LawFaults faults;
  std::visit(
      [&](auto& law) {
        std::string known;
        auto left = values;
        each_field(law, [&]<class F, class T>(const F& field, T& value) {
          known += (known.empty() ? "" : ", ") + std::string(field.name);
          const auto given = left.find(field.name);
          if (given == left.end()) return;
          if (const T* of_kind = std::get_if<T>(&given->second)) {
            value = *of_kind;
          } else {
            faults.add(format("%s: expected a %s", field.name, kind_of(value)));
          }
          left.erase(given);
        });
        for (const auto& [key, value] : left) {
          faults.add("unknown field " + key + "; known are " + known);
        }
      },
      *made);
  faults.raise();
  return *made;
}

std::map<std::string, FieldValue> values_of(const LawParameters& law) {
  std::map<std::string, FieldValue> out;
  std::visit(
      [&](const auto& own) {
        each_field(own, [&](const auto& field, const auto& value) { out[field.name] = value; });
      },
      law);
  return out;
}

bool same_law(const LawParameters& a, const LawParameters& b) {
  return std::visit(
      [&b]<class L>(const L& one) {
        const L* other = std::get_if<L>(&b);
        if (other == nullptr) return false;
        if constexpr (requires { one.chosen(); }) {
          if (one.chosen() != other->chosen()) return false;
        }
        return std::apply(
            [&](const auto&... field) {
              return ((one.*field.member == other->*field.member) && ...);
            },
            L::fields());
      },
      a);
}

LawName chosen_name(const LawParameters& law) {
  return std::visit(
      []<class L>(const L& own) {
        if constexpr (requires { own.chosen(); }) return L::kNames[own.chosen()];
        return L::kNames[0];
      },
      law);
}

void check_fields(const LawParameters& law) {
  LawFaults faults;
  std::visit(
      [&](const auto& own) {
        each_field(own, [&]<class F, class T>(const F& field, const T& value) {
          if constexpr (std::is_same_v<T, double>) {
            const std::string unit = field.unit;
            const std::string shown = field.name + (unit == "1" ? "" : " [" + unit + "]");
            faults.require(field.range.holds(value), shown.c_str(), value,
                           field.range.text().c_str());
          } else if constexpr (std::is_same_v<T, ExponentialCurve>) {
            check_curve(faults, value, field.name);
          } else if (!given(field.range, value)) {
            faults.add(chosen_name(law).name + std::string(": ") + field.name + " is missing");
          }
        });
        if constexpr (requires { own.check(faults); }) own.check(faults);
      },
      law);
  faults.raise();
}

}  // namespace feltmb
