/// One interface to a multistep integrator of stiff systems (SUNDIALS CVODES, BDF).
///
/// SUNDIALS: Hindmarsh et al., ACM Trans. Math. Softw. 31 (2005) 363. The integrator does not
/// depend on a model; it uses an OdeSystem.
#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include "feltmb/ode/system.hpp"

namespace feltmb {

struct IntegratorOptions {
  double rtol = 1e-6;        ///< relative tolerance [-], in (0, 0.1]
  std::vector<double> atol;  ///< absolute tolerance of each state, its unit
  int max_order = 5;         ///< of the BDF, 1 to 5
  int long_order = 0;        ///< of steps beyond stable_step; 0: max_order, any step
  double stable_step = 0.0;  ///< [s], up to which max_order is stable; with long_order
  double max_step = 0.0;     ///< [s], 0: no limit
  double first_step = 0.0;   ///< [s], 0: estimated
};

struct IntegratorCounts {
  long steps = 0;
  long rhs = 0;
  long jacobians = 0;
  long factorizations = 0;
  long rejected = 0;  ///< steps that failed the error test
  long newton_iterations = 0;
  long newton_failures = 0;

  IntegratorCounts& operator+=(const IntegratorCounts& other);
};

enum class StepStatus {
  kStep,    ///< one internal step done
  kStop,    ///< reached the stop time
  kFailed,  ///< cannot go on; see message()
};

/// BDF integrator in one-step mode with dense output over the last step.
class Integrator {
 public:
  Integrator(OdeSystem& system, const IntegratorOptions& options);
  ~Integrator();
  Integrator(const Integrator&) = delete;
  Integrator& operator=(const Integrator&) = delete;

  /// Starts, or restarts after a discontinuity, at (t, y).
  void start(double t, std::span<const double> y);

  /// Forgets everything learned about the system: the next start is like the first one.
  void forget();

  /// All tolerances are the given share, in (0, 1], of those of the options from the next start on.
  void scale_tolerances(double share);

  /// One internal step, never beyond t_stop.
  StepStatus step(double t_stop);

  double time() const;       ///< reached: the end of the last step [s]
  double last_step() const;  ///< [s]
  int last_order() const;
  std::span<const double> state() const;  ///< at time()

  /// Dense output at t within the last internal step.
  void interpolate(double t, std::span<double> y) const;

  /// State with the largest weighted local error of the last step.
  std::size_t limiting_state();

  IntegratorCounts counts() const;     ///< since construction, restarts included
  const std::string& message() const;  ///< of the last failure

 private:
  void choose_order();

  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace feltmb
