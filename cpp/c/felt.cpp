#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <map>
#include <memory>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "feltmb/contact/laws/catalog.hpp"
#include "feltmb/contact/path.hpp"
#include "feltmb/core/error.hpp"
#include "feltmb/planar/archive.hpp"
#pragma GCC visibility push(default)
#include "feltmb_felt.h"
#pragma GCC visibility pop

struct feltmb_felt {
  explicit feltmb_felt(std::shared_ptr<const feltmb::ContactLaw> of) : law(std::move(of)) {}
  std::shared_ptr<const feltmb::ContactLaw> law;
  feltmb::LawPath path{*law};
  double force = 0.0;
};

namespace {

using namespace feltmb;

/// Values of the law's fields from entries of the text; what is used is removed.
std::map<std::string, FieldValue> values_of_entries(
    const LawInfo& law, std::map<std::string, std::vector<std::vector<double>>>& entries) {
  std::map<std::string, FieldValue> out;
  const auto take = [&](const std::string& name, std::size_t count) {
    const auto rows = std::move(entries.at(name));
    entries.erase(name);
    for (const auto& row : rows) {
      if (row.size() != count || (count != 3 && rows.size() != 1)) {
        throw InvalidParameter(
            format("%s: got %zu numbers, expected %zu", name.c_str(), row.size(), count));
      }
    }
    return rows;
  };
  const auto curve = [&](const std::string& name) {
    if (!entries.contains(name)) throw InvalidParameter(name + " a b c is missing");
    const auto rows = take(name, 3);
    return ExponentialCurve{rows[0][0], rows[0][1], rows[0][2]};
  };
  for (const FieldInfo& field : law.fields) {
    const std::string kind = field.kind;
    if (kind == "envelope" && !entries.contains(field.name)) {
      const ExponentialCurve loading = curve("loading"), unloading = curve("unloading");
      const std::string end = "closing_compression";
      const double closing = entries.contains(end) ? take(end, 1)[0][0] : 0.0;
      out[field.name] = Envelope::from_curves(loading, unloading, closing);
    } else if (!entries.contains(field.name)) {
      continue;
    } else if (kind == "envelope") {
      std::vector<double> column[3];
      for (const auto& row : take(field.name, 3)) {
        for (std::size_t k = 0; k < 3; ++k) column[k].push_back(row[k]);
      }
      out[field.name] = Envelope::from_table(column[0], column[1], column[2]);
    } else if (kind == "curve") {
      out[field.name] = curve(field.name);
    } else if (kind == "number") {
      out[field.name] = take(field.name, 1)[0][0];
    }
  }
  for (const auto& [name, rows] : entries) {
    throw InvalidParameter("entry " + name + " is none of the law " + law.name);
  }
  return out;
}

ContactLaw law_from_text(const std::string& text) {
  if (text.starts_with("feltmb-law")) return ContactLaw(read_law(text));
  std::istringstream lines(text);
  std::string line, name;
  std::map<std::string, std::vector<std::vector<double>>> entries;
  while (std::getline(lines, line)) {
    std::istringstream words(line.substr(0, line.find('#')));
    std::string key;
    if (!(words >> key)) continue;
    if (key == "law") {
      words >> name;
      continue;
    }
    auto& row = entries[key].emplace_back();
    for (double number; words >> number;) row.push_back(number);
    if (!words.eof()) throw InvalidParameter("entry " + key + ": expected numbers only");
  }
  for (const LawInfo& law : contact_laws()) {
    if (law.name == name)
      return ContactLaw(make_contact_law(name, values_of_entries(law, entries)));
  }
  return ContactLaw(make_contact_law(name, {}));  // names those that are known
}

bool possible(double compression, double duration) {
  return std::isfinite(compression) && std::isfinite(duration) && duration > 0.0;
}

constexpr double kHitStep = 4e-6;  // longest step of a hit [s]: a hundred in a short contact
constexpr double kMostSteps = 1e5;
constexpr double kLeastWay = 1e-15;  // [m]

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

}  // namespace

feltmb_felt* feltmb_felt_create(const char* text, char* message, size_t size) {
  try {
    return new feltmb_felt(std::make_shared<const ContactLaw>(law_from_text(text)));
  } catch (const std::exception& error) {
    if (message != nullptr && size > 0) std::snprintf(message, size, "%s", error.what());
    return nullptr;
  }
}

feltmb_felt* feltmb_felt_copy(const feltmb_felt* felt) { return new feltmb_felt(*felt); }
void feltmb_felt_free(feltmb_felt* felt) { delete felt; }
void feltmb_felt_reset(feltmb_felt* felt) {
  felt->path.reset();
  felt->force = 0.0;
}

double feltmb_felt_step(feltmb_felt* felt, double compression, double duration) {
  if (!possible(compression, duration)) return kNone;
  return felt->force = felt->path.step(compression, duration);
}
double feltmb_felt_peek(const feltmb_felt* felt, double compression, double duration) {
  return possible(compression, duration) ? felt->path.peek(compression, duration) : kNone;
}
double feltmb_felt_hit(feltmb_felt* felt, double mass, double* compression, double* speed,
                       double duration) {
  if (!possible(*compression, duration) || !std::isfinite(*speed) || !std::isfinite(mass) ||
      mass <= 0.0) {
    return kNone;
  }
  const bool free = std::max(*compression, *compression + duration * *speed) <= 0.0;
  const double steps = free ? 1.0 : std::clamp(std::ceil(duration / kHitStep), 1.0, kMostSteps);
  const double h = duration / steps, first = *speed;
  const double energy = 0.5 * mass * first * first + feltmb_felt_energy(felt);
  for (int i = 0; i < static_cast<int>(steps); ++i) {
    const feltmb_felt before = *felt;
    // The speed first: a body that is at rest deep in the felt must come back.
    *speed -= h * felt->force / mass;
    double way = h * *speed;
    feltmb_felt_step(felt, *compression + way, h);
    // A finite step must not give the felt more than the body has, nor the body more than is left.
    while (feltmb_felt_energy(felt) > energy && way != 0.0) {
      *felt = before;
      way = std::abs(way) > kLeastWay ? 0.5 * way : 0.0;
      feltmb_felt_step(felt, *compression + way, h);
    }
    *compression += way;
    const double left = std::max(energy - feltmb_felt_energy(felt), 0.0);
    const double most = std::sqrt(2.0 * left / mass);
    *speed = std::clamp(*speed, -most, most);
  }
  return mass * (first - *speed) / duration;
}

double feltmb_felt_force(const feltmb_felt* felt) { return felt->force; }
double feltmb_felt_energy(const feltmb_felt* felt) {
  return felt->law->stored_energy(felt->path.compression(), felt->path.memory());
}

size_t feltmb_felt_save(const feltmb_felt* felt, double* numbers, size_t room) {
  std::vector<double> all = felt->path.save();
  all.push_back(felt->force);
  for (std::size_t i = 0; i < std::min(room, all.size()); ++i) numbers[i] = all[i];
  return all.size();
}

int feltmb_felt_restore(feltmb_felt* felt, const double* numbers, size_t count) {
  if (count == 0) return 0;
  try {
    felt->path.restore({numbers, count - 1});
  } catch (const InvalidParameter&) {
    return 0;
  }
  felt->force = numbers[count - 1];
  return 1;
}
