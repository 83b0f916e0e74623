#include "newton_solver.hpp"

#include <algorithm>
#include <limits>
#include <utility>

namespace feltmb::detail {
namespace {

constexpr int kMostIterations = 3;
/// Between iterations the estimate of the rate follows what is seen, upwards at once.
constexpr double kMemory = 0.1;
/// A step that takes one iteration shows no rate: trust in the last one seen fades.
constexpr double kDoubt = 1.4;
/// A Jacobian of the step itself converges better than this, whatever was seen before.
constexpr double kFreshRate = 0.3;
/// The iteration diverges when a change is so many times the one before.
constexpr double kDivergence = 2.0;
/// Steps do without the slow parts of the Jacobian until one converges with them only; the limit
/// that is set then rises again with every step.
constexpr double kRise = 1.05;

}  // namespace

struct NewtonSolver::Calls {
  static NewtonSolver& self(SUNNonlinearSolver s) {
    return *static_cast<NewtonSolver*>(s->content);
  }
  static SUNNonlinearSolver_Type type(SUNNonlinearSolver) { return SUNNONLINEARSOLVER_ROOTFIND; }
  static int solve(SUNNonlinearSolver s, N_Vector, N_Vector correction, N_Vector weights,
                   double tolerance, booleantype renew, void* memory) {
    return self(s).solve(correction, weights, tolerance, renew != SUNFALSE, memory);
  }
  static int set_residual(SUNNonlinearSolver s, SUNNonlinSolSysFn f) {
    self(s).residual_ = f;
    return 0;
  }
  static int set_setup(SUNNonlinearSolver s, SUNNonlinSolLSetupFn f) {
    self(s).setup_ = f;
    return 0;
  }
  static int set_solve(SUNNonlinearSolver s, SUNNonlinSolLSolveFn f) {
    self(s).linear_solve_ = f;
    return 0;
  }
  static int iterations(SUNNonlinearSolver s, long* count) {
    *count = self(s).iterations_;
    return 0;
  }
  static int failures(SUNNonlinearSolver s, long* count) {
    *count = self(s).failures_;
    return 0;
  }
};

NewtonSolver::NewtonSolver(N_Vector pattern, SUNContext context)
    : handle_(SUNNonlinSolNewEmpty(context)),
      change_(N_VClone(pattern)),
      whole_above_(std::numeric_limits<double>::infinity()) {
  handle_->content = this;
  handle_->ops->gettype = Calls::type;
  handle_->ops->solve = Calls::solve;
  handle_->ops->setsysfn = Calls::set_residual;
  handle_->ops->setlsetupfn = Calls::set_setup;
  handle_->ops->setlsolvefn = Calls::set_solve;
  handle_->ops->getnumiters = Calls::iterations;
  handle_->ops->getnumconvfails = Calls::failures;
}

NewtonSolver::~NewtonSolver() {
  handle_->content = nullptr;
  SUNNonlinSolFreeEmpty(handle_);
  N_VDestroy(change_);
}

void NewtonSolver::made(double gamma, bool renewed, bool whole) {
  gamma_ = gamma;
  if (!renewed) return;
  whole_ = whole;
  fresh_ = true;
}

int NewtonSolver::solve(N_Vector correction, N_Vector weights, double tolerance, bool renew,
                        void* memory) {
  iterations_ = 0;
  failures_ = 0;
  fresh_ = false;
  whole_above_ *= kRise;
  bool bad = false;
  for (;;) {
    int flag = residual_(correction, change_, memory);
    if (flag == 0 && renew) {
      booleantype renewed = SUNFALSE;
      flag = setup_(bad ? SUNTRUE : SUNFALSE, &renewed, memory);
      if (fresh_) rate_ = std::min(rate_, kFreshRate);
    }
    if (flag == 0) flag = iterate(correction, weights, tolerance, memory);
    if (flag == 0) {
      if (forced_) whole_above_ = 0.5 * gamma_;
      forced_ = failed_before_ = false;
      return 0;
    }
    ++failures_;
    // Once more with a Jacobian of this step. Where that fails a force has a kink, and a smaller
    // step helps; only if that fails as well, the whole Jacobian is tried.
    const bool part = fresh_ && !whole_;
    const bool again = part ? std::exchange(failed_before_, true) : !bad;
    if (flag < 0 || !again) {
      forced_ = false;
      return flag;
    }
    forced_ = fresh_;
    renew = bad = true;
    N_VConst(0.0, correction);
  }
}

int NewtonSolver::iterate(N_Vector correction, N_Vector weights, double tolerance, void* memory) {
  double before = 0.0;
  for (int i = 0; i < kMostIterations; ++i) {
    if (i > 0) {
      const int flag = residual_(correction, change_, memory);
      if (flag != 0) return flag;
    }
    ++iterations_;
    N_VScale(-1.0, change_, change_);
    const int flag = linear_solve_(change_, memory);
    if (flag != 0) return flag;
    N_VLinearSum(1.0, correction, 1.0, change_, correction);
    const double size = N_VWrmsNorm(change_, weights);
    if (i > 0) {
      const double seen = size / before;
      if (seen > kDivergence) return SUN_NLS_CONV_RECVR;
      rate_ = std::max(kMemory * rate_, seen);
    }
    if (size * std::min(1.0, rate_) <= tolerance) {
      if (i == 0) rate_ = std::min(1.0, kDoubt * rate_);
      return 0;
    }
    before = size;
  }
  return SUN_NLS_CONV_RECVR;
}

}  // namespace feltmb::detail
