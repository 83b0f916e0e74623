/// Newton's method for the implicit steps of CVODES.
///
/// As the method of SUNDIALS, but for how it judges convergence. What Newton's method leaves over
/// is not seen by the error test, and in stiff friction it has one sign and adds up: it was the
/// larger part of the error of a stroke. Here the Jacobian is renewed often (see Integrator), the
/// rate of convergence is remembered from step to step instead of being forgotten with every new
/// matrix, and one iteration suffices where that rate says so.
#pragma once

#include <sundials/sundials_nonlinearsolver.h>
#include <sundials/sundials_nvector.h>

namespace feltmb::detail {

class NewtonSolver {
 public:
  /// For vectors like `pattern`.
  NewtonSolver(N_Vector pattern, SUNContext context);
  ~NewtonSolver();
  NewtonSolver(const NewtonSolver&) = delete;
  NewtonSolver& operator=(const NewtonSolver&) = delete;

  /// For CVodeSetNonlinearSolver; owned by this object.
  SUNNonlinearSolver handle() { return handle_; }

  /// Whether steps of this gamma need the whole Jacobian: without its slow parts the method did not
  /// converge there.
  bool needs_whole(double gamma) const { return gamma >= whole_above_; }

  /// Forgets rates of convergence and what they led to.
  void forget();

  /// Told by the callback that makes the matrix.
  void made(double gamma, bool renewed, bool whole);

 private:
  struct Calls;  ///< the C functions that SUNDIALS calls

  int solve(N_Vector correction, N_Vector weights, double tolerance, bool renew, void* memory);
  int iterate(N_Vector correction, N_Vector weights, double tolerance, void* memory);
  void judge_part(double trouble);

  SUNNonlinearSolver handle_ = nullptr;
  SUNNonlinSolSysFn residual_ = nullptr;
  SUNNonlinSolLSetupFn setup_ = nullptr;
  SUNNonlinSolLSolveFn linear_solve_ = nullptr;
  N_Vector change_ = nullptr;
  long iterations_ = 0;  ///< of the last call
  long failures_ = 0;
  double rate_ = 1.0;     ///< estimated: error after an iteration over that before
  double gamma_ = 0.0;    ///< of the matrix
  bool fresh_ = false;    ///< the matrix holds the Jacobian of this very step
  bool whole_ = true;     ///< and all of it
  double worst_ = 0.0;    ///< rate seen in the step
  double trouble_ = 0.0;  ///< of late with a part of a fresh Jacobian
  double whole_above_;    ///< see needs_whole
};

}  // namespace feltmb::detail
