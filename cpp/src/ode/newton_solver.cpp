#include "newton_solver.hpp"

#include <algorithm>
#include <limits>

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
/// Steps do without the slow parts of the Jacobian until they converge badly again and again: worse
/// than this with a fresh one, a failure counting as much as some. A single bad one is a kink of a
/// force. The limit that is set then rises again with every step.
constexpr double kBadRate = 0.3;
constexpr double kFailure = 1.5;
constexpr double kEnough = 3.0;
constexpr double kForget = 0.5;
constexpr double kRise = 1.015;

}  // namespace

struct NewtonSolver::Calls {
  static NewtonSolver& self(SUNNonlinearSolver s) {
    return *static_cast<NewtonSolver*>(s->content);
  }
  static SUNNonlinearSolver_Type type(SUNNonlinearSolver) { return SUNNONLINEARSOLVER_ROOTFIND; }
  static int solve(SUNNonlinearSolver s, N_Vector, N_Vector correction, N_Vector weights,
                   double tolerance, sunbooleantype renew, void* memory) {
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

void NewtonSolver::forget() {
  rate_ = 1.0;
  gamma_ = worst_ = trouble_ = 0.0;
  fresh_ = false;
  whole_ = true;
  whole_above_ = std::numeric_limits<double>::infinity();
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
  worst_ = 0.0;
  whole_above_ *= kRise;
  bool bad = false;
  for (;;) {
    int flag = residual_(correction, change_, memory);
    if (flag == 0 && renew) {
      sunbooleantype renewed = SUNFALSE;
      flag = setup_(bad ? SUNTRUE : SUNFALSE, &renewed, memory);
      if (fresh_) rate_ = std::min(rate_, kFreshRate);
    }
    if (flag == 0) flag = iterate(correction, weights, tolerance, memory);
    if (flag == 0) {
      judge_part(worst_ > kBadRate ? 1.0 : 0.0);
      return 0;
    }
    ++failures_;
    if (flag > 0) judge_part(kFailure);
    // Once more with a Jacobian of this step; where that fails a smaller step is due.
    if (flag < 0 || bad || fresh_) return flag;
    worst_ = 0.0;
    renew = bad = true;
    N_VConst(0.0, correction);
  }
}

/// Whether what is left out of a fresh Jacobian is missed.
void NewtonSolver::judge_part(double trouble) {
  if (!fresh_ || whole_) return;
  trouble_ = trouble > 0.0 ? trouble_ + trouble : kForget * trouble_;
  if (trouble_ < kEnough) return;
  whole_above_ = 0.5 * gamma_;
  trouble_ = 0.0;
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
      worst_ = std::max(worst_, seen);
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
