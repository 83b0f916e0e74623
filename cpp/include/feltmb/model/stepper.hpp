/// Simulation of a mechanism in steps of the caller, each with its own input, for controllers,
/// haptic devices and co-simulation. Shares its code with `simulate` (simulation.cpp).
#pragma once

#include <limits>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "feltmb/model/simulation.hpp"

namespace feltmb {

struct StepperOptions {
  /// Relative tolerance of a step of 10 ms or more; in proportion to the duration of shorter ones,
  /// so that the error over a time does not depend on the number of steps. The others are as those
  /// of SimulationOptions.
  double rtol = 1e-6;
  Method method = Method::kAuto;
  int max_order = 0;
  double max_step = 0.0;
  double max_wall = 0.0;  ///< of one step [s]
  bool events = true;
  double finger_reference = std::numeric_limits<double>::quiet_NaN();  ///< NaN: the rest pose
};

/// Time function of a force, of a torque or of a finger's motion within a step.
enum class Hold {
  kZero,    ///< constant at the value
  kLinear,  ///< straight from the value at the end of the last step
};

/// Input of a step, in the unit of the kind.
struct StepInput {
  double value = 0.0;
  /// Rate of a prescribed motion, whose value and rate are reached at the end of the step by a
  /// cubic. NaN: the rate follows from equally spaced values.
  double rate = std::numeric_limits<double>::quiet_NaN();
};

/// Input at the end of a step.
struct StepDrive {
  InputKind kind = InputKind::kForce;
  double value = 0.0;  ///< motions count from the rest pose
  double rate = 0.0;
  double acceleration = 0.0;
  double mean = 0.0;  ///< rate over the step
};

/// Everything that determines the following steps, except mechanism, options and kind of input.
/// Steps do not depend on the clock, which is for the caller.
struct StepState {
  SimulationState machine;
  StepDrive drive;
};

struct StepResult {
  RunStatus status = RunStatus::kDone;  ///< else the state is that before the step
  ErrorCode code = ErrorCode::kNone;
  std::string message;
  std::string failed_state;
  std::string failed_contact;
  std::vector<SimulationEvent> events;  ///< on the clock of the state
  std::vector<double> peaks;            ///< largest force of each contact [N], if watched
  long steps = 0;                       ///< of the integrator
};

/// Each step starts without integrator history: the input may jump, and the result depends only on
/// the state, bit for bit. A mutable workspace; use one per thread.
class Stepper {
 public:
  /// Starts at rest. Throws InvalidParameter in the same cases as `simulate`.
  Stepper(const std::shared_ptr<const Mechanism>& mechanism, InputKind kind,
          const StepperOptions& options, const std::vector<Monitor>& monitors = {});
  ~Stepper();
  Stepper(const Stepper&) = delete;
  Stepper& operator=(const Stepper&) = delete;

  const StepState& rest() const { return rest_; }
  const StepState& state() const;

  /// Sets a state of this mechanism, which may have another kind of input: then a force is zero,
  /// and a finger just touches the key. Throws InvalidParameter.
  void set_state(const StepState& state);

  /// Throws InvalidParameter for bad arguments; a solver failure is a status.
  StepResult advance(double duration, const StepInput& input, Hold hold = Hold::kZero,
                     const Progress& progress = {});

  /// Values of channels() at the state, with the input at the end of the last step.
  std::span<const double> outputs();
  const Channels& channels() const;

  /// Seeks the largest force of each contact in the steps from now on; they take up to twice as
  /// long and end in the same states.
  void watch_peaks();

  /// Normal force of each contact at the state [N].
  std::span<const double> forces();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
  StepState rest_;
};

}  // namespace feltmb
