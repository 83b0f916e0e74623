/// Key actuator of thesis chapter 5: motor, hub, flexible arm, tip mass, felt stop.
///
/// Positive is pressing throughout: angles, travel, torque, forces on the key (the thesis counts
/// them up; ERRATA of its chapter 5 in docs/explanation/actuator.md).
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "feltmb/beam/hub_beam.hpp"
#include "feltmb/contact/law.hpp"
#include "feltmb/modal/contact_stepper.hpp"
#include "feltmb/model/profile.hpp"
#include "feltmb/model/simulation.hpp"

namespace feltmb {

enum class DamperKind {
  kNone,
  kDashpot,   ///< grounded at the hub: -c theta'
  kOneSided,  ///< the same, only while the key is released (theta' < 0)
};

struct ActuatorDescription {
  HubBeamDescription arm;
  double gravity = 9.81;        ///< acceleration across the arm that presses [m/s^2]; < 0 lifts
  bool linear_gravity = false;  ///< true: cos(theta) = 1 in eq. 5.15
  double gap = 0.0;             ///< travel of the tip to the stop [m], >= 0
  std::optional<LawParameters> stop;
  DamperKind damper = DamperKind::kNone;
  double damping = 0.0;  ///< c [N m s/rad], >= 0
  /// Equivalent reaction of the action: a mass that the tip carries until it first meets the stop
  /// [kg], >= 0; besides, a force against the tip by time [N].
  double action_mass = 0.0;
  std::optional<Profile> action_force;
};

/// Checked and assembled; immutable, shared between threads.
class Actuator {
 public:
  /// Throws InvalidParameter that lists all faults.
  explicit Actuator(const ActuatorDescription& description);

  const ActuatorDescription& description() const { return description_; }
  const HubBeam& beam() const { return beam_; }
  const std::optional<ContactLaw>& stop() const { return stop_; }
  const HubBeamModes& modes(bool with_action) const { return with_action ? loaded_ : free_; }

 private:
  ActuatorDescription description_;
  HubBeam beam_;
  std::optional<ContactLaw> stop_;
  HubBeamModes free_, loaded_;
};

struct ActuatorOptions {
  double duration = 0.2;       ///< [s], > 0
  double output_rate = 10000;  ///< samples a second [Hz], > 0
  double tolerance = 1e-5;     ///< of a force within a step over the largest, in (0, 0.1]
};

struct ActuatorRun {
  Eigen::VectorXd time;            ///< (n_times) [s]
  std::vector<std::string> names;  ///< of the outputs
  std::vector<std::string> units;
  std::vector<std::string> long_names;
  RowMatrix data;                         ///< (n_times, n_outputs)
  std::vector<modal::ModalEvent> events;  ///< of the stop
  double peak_force = 0.0;                ///< of the stop [N], between samples too
  double peak_time = 0.0;                 ///< [s]
  modal::ModalStepperCounts counts;
  double wall = 0.0;  ///< [s]
};

/// From rest, the arm straight. The modes answer exactly, the stop and the damper are implicit
/// scalar forces; see ModalContactStepper. Throws InvalidParameter, or Error when a force cannot be
/// found.
ActuatorRun simulate(const Actuator& actuator, const Profile& torque,
                     const ActuatorOptions& options);

}  // namespace feltmb
