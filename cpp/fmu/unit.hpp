/// A mechanism or a felt as a co-simulation unit, without a version of the interface: fmi2.cpp and
/// fmi3.cpp are its C functions.
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
  kInput = 1,      ///< in the unit of the kind; of a felt, its compression [m]
  kTolerance = 2,  ///< relative, of the integrator
  kRate = 3,       ///< of the compression of a felt [m/s]
  kOutputs = 1000,
  kPeaks = 50000,   ///< largest force of each contact since the last communication point
  kStarts = 90000,  ///< distance of each coordinate from the rest pose, then its rate
  kParameters = 100000,
};

class Unit {
 public:
  virtual ~Unit() = default;

  void set_start(double time) { start_ = time; }
  double time() const { return start_ + elapsed(); }

  virtual double get(std::uint32_t reference) = 0;
  virtual void set(std::uint32_t reference, double value) = 0;

  virtual void initialize() = 0;
  virtual void reset() = 0;
  void step(double time, double duration);

  /// All that may change, as numbers.
  virtual std::vector<double> save() = 0;
  virtual void restore(const std::vector<double>& saved) = 0;

 protected:
  virtual double elapsed() const = 0;  ///< time since the start [s]
  virtual void advance(double duration) = 0;
  double start_ = 0.0;
};

/// The unit in a folder of resources, whose token must be `token`. Throws Error.
std::unique_ptr<Unit> open_unit(const std::string& resources, const std::string& token);

/// Text of a file of the resources behind its first words, which are `head` and the token.
std::string read_resource(const std::string& path, const std::string& head,
                          const std::string& token);

std::unique_ptr<Unit> open_felt(const std::string& path, const std::string& token);

class Machine final : public Unit {
 public:
  Machine(const std::string& path, const std::string& token);

  double get(std::uint32_t reference) override;
  void set(std::uint32_t reference, double value) override;
  void initialize() override { stepper(); }
  void reset() override;
  std::vector<double> save() override;
  void restore(const std::vector<double>& saved) override;

 private:
  double elapsed() const override { return stepper_ ? stepper_->state().machine.time : 0.0; }
  void advance(double duration) override;
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
  double input_ = 0.0;
  std::vector<double> peaks_;
  bool watched_ = false;  ///< peaks are sought; until then the last step can be made again:
  StepState before_;
  double last_duration_ = 0.0;  ///< 0: no step yet
  double last_input_ = 0.0;
  std::unique_ptr<Stepper> stepper_;  ///< once it is asked for; a parameter makes it anew
};

}  // namespace feltmb::fmu
