/// A felt alone as a co-simulation unit: compression and its rate in, force out.
#include <algorithm>
#include <cmath>
#include <optional>

#include "feltmb/contact/path.hpp"
#include "feltmb/core/error.hpp"
#include "unit.hpp"

namespace feltmb::fmu {
namespace {

/// The memory has only the compressions that were inputs. Behind a step the compression goes on
/// with its rate until it is set again, so that the force there is a prediction of second order,
/// and the force at an input has no delay.
class Felt final : public Unit {
 public:
  Felt(const std::string& path, const std::string& token)
      : original_(read_law(read_resource(path, "feltmb-felt", token))), parameters_(original_) {
    initialize();
  }

  double get(std::uint32_t reference) override {
    switch (reference) {
      case kTime:
        return time();
      case kInput:
        return input_;
      case kRate:
        return rate_;
      case kOutputs:
        return now().force;
      case kOutputs + 1:
        return now().energy;
      default:
        return number(reference);
    }
  }

  void set(std::uint32_t reference, double value) override {
    if (reference == kTolerance) return;  // nothing is integrated
    if (!std::isfinite(value)) throw InvalidParameter("an input is not a finite number");
    if (reference == kInput) {
      input_ = compression_ = value;
    } else if (reference == kRate) {
      rate_ = value;
    } else {
      double& changed = number(reference);
      if (elapsed_ > 0.0) {
        throw InvalidParameter("a parameter is fixed: it can be set before the first step only");
      }
      changed = value;
      law_.reset();
    }
  }

  void initialize() override { law(); }

  void reset() override {
    parameters_ = original_;
    numbers_ = numbers_of(parameters_);
    start_ = elapsed_ = last_ = input_ = rate_ = compression_ = 0.0;
    law_.reset();
  }

  std::vector<double> save() override {
    std::vector<double> out{start_, elapsed_, last_, input_, rate_, compression_};
    for (const DescriptionNumber& each : numbers_) out.push_back(*each.value);
    law();
    const std::vector<double> memory = path_->save();
    out.insert(out.end(), memory.begin(), memory.end());
    return out;
  }

  void restore(const std::vector<double>& saved) override {
    const std::size_t own = 6 + numbers_.size();
    if (saved.size() < own) throw InvalidParameter("the state is of another unit");
    std::size_t i = 0;
    for (double* each : {&start_, &elapsed_, &last_, &input_, &rate_, &compression_}) {
      *each = saved[i++];
    }
    for (const DescriptionNumber& each : numbers_) *each.value = saved[i++];
    law_.reset();
    law();
    path_->restore({saved.data() + own, saved.size() - own});
  }

 private:
  double elapsed() const override { return elapsed_; }

  void advance(double duration) override {
    if (!(duration > 0.0 && std::isfinite(duration))) {
      throw InvalidParameter(format("step of %.9g s, must be finite and > 0", duration));
    }
    law();
    move(*path_);
    compression_ += rate_ * duration;
    elapsed_ += duration;
    last_ = duration;
  }

  double& number(std::uint32_t reference) {
    if (reference < kParameters || reference - kParameters >= numbers_.size()) {
      throw InvalidParameter(format("there is no variable with reference %u", reference));
    }
    return *numbers_[reference - kParameters].value;
  }

  const ContactLaw& law() {
    if (!law_) {
      law_.emplace(parameters_);
      path_.emplace(*law_);
    }
    return *law_;
  }

  /// Moves a path to the present compression; returns the force there. Before the first step the
  /// felt is at rest under it.
  double move(LawPath& path) const {
    if (last_ > 0.0) return path.step(compression_, last_);
    std::vector<double> rest(2 + law_->n_states(), 0.0);
    rest[0] = compression_;
    if (compression_ > 0.0) {
      law_->relax(compression_, rest.data() + 2);
      const LawMemory virgin{rest.data() + 2, 0.0};
      if (law_->has_memory()) rest[1] = law_->felt_compression(compression_, virgin);
    }
    path.restore(rest);
    return law_->evaluate(compression_, rate_, path.memory()).force;
  }

  struct Point {
    double force;   ///< [N]
    double energy;  ///< stored [J]
  };
  Point now() {
    law();
    LawPath path = *path_;
    const double force = move(path);
    return {force, law_->stored_energy(path.compression(), path.memory())};
  }

  const LawParameters original_;
  LawParameters parameters_;
  std::vector<DescriptionNumber> numbers_ = numbers_of(parameters_);
  std::optional<ContactLaw> law_;  ///< of parameters_; a changed one makes it anew
  std::optional<LawPath> path_;    ///< up to the last input before a step
  double elapsed_ = 0.0;           ///< [s]
  double last_ = 0.0;              ///< duration of the last step [s]; 0: none yet
  double input_ = 0.0, rate_ = 0.0;
  double compression_ = 0.0;  ///< present one: the input, or where the rate led
};

}  // namespace

std::unique_ptr<Unit> open_felt(const std::string& path, const std::string& token) {
  return std::make_unique<Felt>(path, token);
}

}  // namespace feltmb::fmu
