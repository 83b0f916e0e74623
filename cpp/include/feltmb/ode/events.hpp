/// Sign changes of the event functions of a system along an integration.
#pragma once

#include <span>
#include <vector>

#include "feltmb/ode/integrator.hpp"
#include "feltmb/ode/system.hpp"

namespace feltmb {

struct Crossing {
  double time = 0.0;      ///< [s]
  std::size_t event = 0;  ///< index of the event function
  int direction = 0;      ///< +1 rising, -1 falling
};

/// Finds crossings on the dense output of each accepted step, without stopping the integrator.
///
/// A function that stays at zero, or touches zero and returns within one step, is not a crossing;
/// a zero value belongs to the negative side.
class EventLocator {
 public:
  explicit EventLocator(OdeSystem& system);

  /// Signs at the start.
  void start(double t, std::span<const double> y);

  /// Crossings between the last scan and `end`, within the integrator's last step, in the order of
  /// time.
  std::span<const Crossing> scan(const Integrator& integrator, double end);

  long evaluations() const { return evaluations_; }

 private:
  void evaluate(double t, std::span<const double> y, std::vector<double>& g);
  bool nothing_near(double end);

  OdeSystem& system_;
  double time_ = 0.0;
  bool before_known_ = false;   ///< values, not only signs, at time_
  std::vector<char> positive_;  ///< signs at time_
  std::vector<double> before_, after_, trial_, y_;
  std::vector<Crossing> found_;
  long evaluations_ = 0;
};

}  // namespace feltmb
