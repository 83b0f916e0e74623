/// Mechanisms that are linear but for their contacts: point masses, strings struck at a held point.
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "feltmb/modal/contact_stepper.hpp"
#include "feltmb/model/mechanism_system.hpp"
#include "feltmb/model/simulation.hpp"

namespace feltmb {

/// A mechanism as modes that a few scalar forces join, for modal::ModalContactStepper.
///
/// Prismatic bodies on the ground are modes without stiffness (coordinate sqrt(m) q), strings bring
/// their own, gravity is a constant drive; every closed contact is a scalar force whose compression
/// is linear in the modes.
struct LinearMachine {
  std::vector<double> stiffness, damping, root_mass;
  std::vector<modal::ModalContact> contacts;
  std::vector<modal::ModalDrive> drives;
  std::vector<int> contact_index;  ///< in Mechanism::contacts
  std::vector<std::unique_ptr<modal::ScalarForce>> forces;

  /// The mechanism as modes, or nothing where it is not linear: bodies that turn, friction,
  /// springs, straps, beams, a finger, strike points that move, laws with states or memory, curved
  /// pairs of surfaces.
  static std::optional<LinearMachine> of(const Mechanism& mechanism);
};

/// Runs such a mechanism exactly but for its contact forces, whose error within a step is held at
/// 3 rtol of the largest. Samples only: no ledger, no events.
RunResult simulate_linear(const std::shared_ptr<const Mechanism>& mechanism, LinearMachine machine,
                          const SimulationOptions& options, const SimulationState& start,
                          const Progress& progress);

}  // namespace feltmb
