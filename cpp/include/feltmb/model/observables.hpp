/// Named outputs of a mechanism: one list for Python, files, plots and measured data.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "feltmb/model/mechanism_system.hpp"

namespace feltmb {

/// The last outputs: stored energy, kinetic first [J].
inline constexpr int kStoredParts = 5;

struct ObservableInfo {
  std::string name;
  std::string unit;
  std::string long_name;
};

/// The outputs of a mechanism in a fixed order:
/// coordinates and their rates, tracking points (.x .y .vx .vy), contacts (.force .compression
/// .rate .friction), straps (.force), finger.force, strings (.strike, .bridge_force), energies.
std::vector<ObservableInfo> list_observables(const Mechanism& mechanism);

/// Values at (t, y); `out` has the length of list_observables.
void observe(MechanismSystem& system, double t, std::span<const double> y, std::span<double> out);

/// Whether an output follows from the places and speeds of the links alone.
bool is_place(const Mechanism& mechanism, int output);

/// As `observe`, but only the outputs that are places are filled in: no force is evaluated.
void observe_places(MechanismSystem& system, std::span<const double> y, std::span<double> out);

}  // namespace feltmb
