/// A mechanism as a co-simulation unit, without a version of the interface: fmi2.cpp and fmi3.cpp
/// are its C functions.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "feltmb/model/stepper.hpp"
#include "feltmb/planar/archive.hpp"

namespace feltmb::fmu {

/// References of variables; feltmb/run/fmu.py writes the same into the model description.
enum Reference : std::uint32_t {
  kTime = 0,
  kInput = 1,      ///< in the unit of the kind
  kTolerance = 2,  ///< relative, of the integrator
  kOutputs = 1000,
  kPeaks = 50000,   ///< largest force of each contact since the last communication point
  kStarts = 90000,  ///< distance of each coordinate from the rest pose, then its rate
  kParameters = 100000,
};

class Unit {
 public:
  /// `token` must be that of the resources. Throws Error.
  Unit(const std::string& resources, const std::string& token);

  void set_start(double time) { start_ = time; }

  double get(std::uint32_t reference);
  void set(std::uint32_t reference, double value);

  void initialize() { stepper(); }
  void reset();
  void step(double time, double duration);
  double time() const;

  /// All that may change, as numbers.
  std::vector<double> save();
  void restore(const std::vector<double>& saved);

 private:
  Stepper& stepper();
  /// The stepper, whose outputs depend on the input where that acts directly.
  Stepper& with_input();
  /// Largest force of each contact in the last step; NaN: no step yet. They are sought once they
  /// are asked for.
  const std::vector<double>& peaks();

  InputKind kind_ = InputKind::kForce;
  Hold hold_ = Hold::kZero;
  StepperOptions options_;
  MechanismDescription original_, description_;
  std::vector<DescriptionNumber> numbers_;  ///< of description_
  std::vector<double> starts_;              ///< initial values, see kStarts
  double start_ = 0.0;
  double input_ = 0.0;
  std::vector<double> peaks_;
  bool watched_ = false;  ///< peaks are sought; until then the last step can be made again:
  StepState before_;
  double last_duration_ = 0.0;  ///< 0: no step yet
  double last_input_ = 0.0;
  std::unique_ptr<Stepper> stepper_;  ///< once it is asked for; a parameter makes it anew
};

}  // namespace feltmb::fmu
