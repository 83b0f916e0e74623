#include "feltmb/ode/integrator.hpp"

#include <cvodes/cvodes_ls.h>
#include <sundials/sundials_config.h>

#include <algorithm>
#include <cmath>
#include <exception>

#include "feltmb/core/error.hpp"
#include "feltmb/core/flush_to_zero.hpp"
#include "feltmb/core/sums.hpp"
#include "newton_solver.hpp"
#include "sundials_handles.hpp"
#include "vector_kernels.hpp"

namespace feltmb {
namespace {

const char* flag_text(int flag) {
  switch (flag) {
    case CV_TOO_MUCH_WORK:
      return "too many internal steps";
    case CV_TOO_MUCH_ACC:
      return "the tolerance is below what double precision can give";
    case CV_ERR_FAILURE:
      return "the error test failed at the smallest step";
    case CV_CONV_FAILURE:
      return "the Newton iteration did not converge at the smallest step";
    case CV_LSETUP_FAIL:
      return "the Newton matrix could not be factorised";
    case CV_RHSFUNC_FAIL:
      return "the right-hand side failed";
    case CV_FIRST_RHSFUNC_ERR:
      return "the right-hand side failed at the start";
    case CV_REPTD_RHSFUNC_ERR:
      return "the right-hand side kept failing";
    case CV_UNREC_RHSFUNC_ERR:
      return "the right-hand side failed and the step could not shrink";
    case CV_ILL_INPUT:
      return "the integrator refused its input";
    case CV_TOO_CLOSE:
      return "start and end time are too close";
    default:
      return "the integrator failed";
  }
}

}  // namespace

IntegratorCounts& IntegratorCounts::operator+=(const IntegratorCounts& other) {
  steps += other.steps;
  rhs += other.rhs;
  jacobians += other.jacobians;
  factorizations += other.factorizations;
  rejected += other.rejected;
  newton_iterations += other.newton_iterations;
  newton_failures += other.newton_failures;
  return *this;
}

struct Integrator::Impl {
  OdeSystem& system;
  IntegratorOptions options;
  // In the order in which they depend on each other: each is freed before what it uses.
  detail::Handle<SUNContext> context;
  detail::Handle<N_Vector> y, work, weights, atol;
  detail::Handle<SUNMatrix> matrix;
  detail::Handle<SUNLinearSolver> solver;
  std::unique_ptr<detail::NewtonSolver> newton;
  detail::Handle<void*> cvode;
  bool long_steps = false;  // long_order is in use
  int seen = 0;             // steps in a row that ask for the other order
  int taken = 0;            // steps since the last change
  int patience = 16;

  /// [s]; 0 is no limit
  double longest_step() const {
    if (options.long_order == 0 || long_steps) return options.max_step;
    return options.max_step > 0.0 ? std::min(options.max_step, options.stable_step)
                                  : options.stable_step;
  }
  bool started = false;
  double share = 1.0;   ///< of the tolerances that apply
  double wanted = 1.0;  ///< share from the next start on
  double time = 0.0;
  std::exception_ptr thrown;
  std::string message;
  std::string captured;
  IntegratorCounts total;  ///< of runs before the last restart
  long jacobians = 0;
  long factorizations = 0;
  int stalled = 0;  ///< steps in a row that did not advance the time

  Impl(OdeSystem& s, const IntegratorOptions& o) : system(s), options(o) {}

  static std::span<double> span(N_Vector v) {
    return {NV_DATA_S(v), static_cast<std::size_t>(NV_LENGTH_S(v))};
  }

  /// Runs a callback of CVODE; exceptions are kept and rethrown by step().
  template <class F>
  int guard(F&& call) {
    try {
      call();
      return 0;
    } catch (...) {
      thrown = std::current_exception();
      return -1;
    }
  }

  void apply_tolerances() {
    share = wanted;
    N_VScale(share, atol.get(), work.get());
    check(CVodeSVtolerances(cvode.get(), share * options.rtol, work.get()), "CVodeSVtolerances");
  }

  void check(int flag, const char* what) const {
    if (flag < 0) throw Error(format("integrator: %s failed: %s", what, flag_text(flag)));
  }
};

namespace {

template <class Impl>
Impl& self(void* data) {
  return *static_cast<Impl*>(data);
}

}  // namespace

// CVODE's C callbacks need the private Impl, hence one struct of static functions.
struct IntegratorCallbacks {
  template <class Impl>
  static int rhs(sunrealtype t, N_Vector y, N_Vector rate, void* data) {
    auto& impl = self<Impl>(data);
    int flag = impl.guard([&] { impl.system.rhs(t, impl.span(y), impl.span(rate)); });
    if (flag == 0) {
      // A trial step may leave the domain; CVODE then tries a smaller one.
      const auto values = impl.span(rate);
      if (!std::isfinite(sum_absolute(values.size(), values.data()))) flag = 1;
    }
    return flag;
  }

  template <class Impl>
  static int linear_system(sunrealtype t, N_Vector y, N_Vector, SUNMatrix, sunbooleantype jok,
                           sunbooleantype* jcur, sunrealtype gamma, void* data, N_Vector, N_Vector,
                           N_Vector) {
    auto& impl = self<Impl>(data);
    bool regular = true;
    const int flag = impl.guard([&] {
      if (!jok) {
        const bool whole = impl.newton->needs_whole(gamma);
        if (whole) {
          impl.system.linearize(t, impl.span(y));
        } else {
          impl.system.linearize_stiff(t, impl.span(y));
        }
        impl.newton->made(gamma, true, whole);
        ++impl.jacobians;
      } else {
        impl.newton->made(gamma, false, false);
      }
      regular = impl.system.factorize(gamma);
      ++impl.factorizations;
    });
    *jcur = jok ? SUNFALSE : SUNTRUE;
    if (flag != 0) return flag;
    return regular ? 0 : 1;
  }

  template <class Impl>
  static int solve(SUNLinearSolver s, SUNMatrix, N_Vector x, N_Vector b, sunrealtype) {
    auto& impl = self<Impl>(s->content);
    return impl.guard([&] {
      const auto from = impl.span(b);
      const auto to = impl.span(x);
      if (from.data() != to.data()) std::copy(from.begin(), from.end(), to.begin());
      impl.system.solve(to);
    });
  }

  template <class Impl>
#if SUNDIALS_VERSION_MAJOR >= 7
  static void error(int, const char*, const char*, const char* text, SUNErrCode, void* data,
                    SUNContext) {
    self<Impl>(data).captured = text;
  }
#else
  static void error(int, const char*, const char*, char* text, void* data) {
    self<Impl>(data).captured = text;
  }
#endif

  static SUNLinearSolver_Type solver_type(SUNLinearSolver) { return SUNLINEARSOLVER_DIRECT; }
  static SUNMatrix_ID matrix_id(SUNMatrix) { return SUNMATRIX_CUSTOM; }
  static int solver_ok(SUNLinearSolver) { return 0; }
  static int setup_ok(SUNLinearSolver, SUNMatrix) { return 0; }
  static int free_solver(SUNLinearSolver s) {
    s->content = nullptr;
    SUNLinSolFreeEmpty(s);
    return 0;
  }
  static void free_matrix(SUNMatrix m) { SUNMatFreeEmpty(m); }
};

Integrator::Integrator(OdeSystem& system, const IntegratorOptions& options)
    : impl_(std::make_unique<Impl>(system, options)) {
  Impl& d = *impl_;
  if (!(options.rtol > 0.0 && options.rtol <= 0.1)) {
    throw InvalidParameter(format("rtol = %.6g, must be in (0, 0.1]", options.rtol));
  }
  if (options.max_order < 1 || options.max_order > 5) {
    throw InvalidParameter(format("max_order = %d, must be 1 to 5", options.max_order));
  }
  if (options.long_order != 0 &&
      !(options.long_order > 0 && options.long_order <= options.max_order &&
        options.stable_step > 0.0)) {
    throw InvalidParameter(
        format("long_order = %d beyond %.6g s, must be 1 to max_order = %d "
               "beyond a time > 0",
               options.long_order, options.stable_step, options.max_order));
  }
  if (options.atol.size() != system.size()) {
    throw InvalidParameter(format("atol: got %zu values, expected one a state (%zu)",
                                  options.atol.size(), system.size()));
  }
  SUNContext context = nullptr;
#if SUNDIALS_VERSION_MAJOR >= 7
  const bool made = SUNContext_Create(SUN_COMM_NULL, &context) == 0;
#else
  const bool made = SUNContext_Create(nullptr, &context) == 0;
#endif
  d.context.reset(context);
  if (!made) throw Error("integrator: no SUNDIALS context");
  const auto n = static_cast<sunindextype>(system.size());
  d.y.reset(detail::make_vector(n, context));
  if (!d.y) throw Error("integrator: out of memory");
  d.work.reset(N_VClone(d.y.get()));
  d.weights.reset(N_VClone(d.y.get()));
  d.atol.reset(N_VClone(d.y.get()));
  std::copy(options.atol.begin(), options.atol.end(), Impl::span(d.atol.get()).begin());

  d.matrix.reset(SUNMatNewEmpty(context));
  d.matrix->ops->getid = IntegratorCallbacks::matrix_id;
  d.matrix->ops->destroy = IntegratorCallbacks::free_matrix;
  d.solver.reset(SUNLinSolNewEmpty(context));
  d.solver->content = impl_.get();
  d.solver->ops->gettype = IntegratorCallbacks::solver_type;
  d.solver->ops->initialize = IntegratorCallbacks::solver_ok;
  d.solver->ops->setup = IntegratorCallbacks::setup_ok;
  d.solver->ops->solve = IntegratorCallbacks::solve<Impl>;
  d.solver->ops->free = IntegratorCallbacks::free_solver;
  d.newton = std::make_unique<detail::NewtonSolver>(d.y.get(), context);
}

Integrator::~Integrator() = default;

void Integrator::start(double t, std::span<const double> y) {
  Impl& d = *impl_;
  if (y.size() != d.system.size()) {
    throw InvalidParameter(
        format("start state: got %zu values, expected %zu", y.size(), d.system.size()));
  }
  std::copy(y.begin(), y.end(), Impl::span(d.y.get()).begin());
  d.time = t;
  if (!d.started) {
    d.cvode.reset(CVodeCreate(CV_BDF, d.context.get()));
    if (!d.cvode) throw Error("integrator: CVodeCreate failed");
#if SUNDIALS_VERSION_MAJOR >= 7
    SUNContext_ClearErrHandlers(d.context.get());
    SUNContext_PushErrHandler(d.context.get(), IntegratorCallbacks::error<Impl>, &d);
#else
    CVodeSetErrHandlerFn(d.cvode.get(), IntegratorCallbacks::error<Impl>, &d);
#endif
    d.check(CVodeInit(d.cvode.get(), IntegratorCallbacks::rhs<Impl>, t, d.y.get()), "CVodeInit");
    d.check(CVodeSetUserData(d.cvode.get(), &d), "CVodeSetUserData");
    d.check(CVodeSetLinearSolver(d.cvode.get(), d.solver.get(), d.matrix.get()),
            "CVodeSetLinearSolver");
    d.check(CVodeSetNonlinearSolver(d.cvode.get(), d.newton->handle()), "CVodeSetNonlinearSolver");
    d.check(CVodeSetLinSysFn(d.cvode.get(), IntegratorCallbacks::linear_system<Impl>),
            "CVodeSetLinSysFn");
    d.check(CVodeSetMaxOrd(d.cvode.get(), d.options.max_order), "CVodeSetMaxOrd");
    d.check(CVodeSetMaxNumSteps(d.cvode.get(), -1), "CVodeSetMaxNumSteps");
    CVodeSetMaxHnilWarns(d.cvode.get(), -1);
    // What Newton's method leaves over is error that the error test does not see; a new Jacobian
    // every other step and a tight test of convergence cost less than the steps that they save. A
    // step that may grow by a tenth pays, too (docs/validation/speed.md).
    constexpr long every = 2;
    CVodeSetLSetupFrequency(d.cvode.get(), every);
    CVodeSetJacEvalFrequency(d.cvode.get(), every);
    CVodeSetDeltaGammaMaxBadJac(d.cvode.get(), 1e9);
    CVodeSetNonlinConvCoef(d.cvode.get(), 0.03);
    CVodeSetEtaFixedStepBounds(d.cvode.get(), 0.0, 1.1);
    d.long_steps = false;
    CVodeSetMaxStep(d.cvode.get(), d.longest_step());
    if (d.options.first_step > 0.0) CVodeSetInitStep(d.cvode.get(), d.options.first_step);
    d.apply_tolerances();
    d.started = true;
    return;
  }
  d.total = counts();
  d.jacobians = 0;
  d.factorizations = 0;
  d.check(CVodeReInit(d.cvode.get(), t, d.y.get()), "CVodeReInit");
  if (d.share != d.wanted) d.apply_tolerances();
  d.seen = 0;
}

/// Takes max_order with steps up to stable_step, or long_order with any, by what the last steps
/// were. A lower order begins anew, since the history holds more than it may have; so it is tried
/// the less often the sooner the last trial ended.
void Integrator::choose_order() {
  Impl& d = *impl_;
  if (d.options.long_order == 0) return;
  constexpr int few = 16;
  constexpr double kWorth = 1.2;  // times stable_step: shorter steps are not worth the lower order
  constexpr double kHeld = 0.9;   // of stable_step: a step that may not grow by a tenth stays there
  const double h = last_step();
  ++d.taken;
  if (d.long_steps) {
    if (d.taken < 4 * few) return;  // the first steps of a start are short
    d.seen = h < kWorth * d.options.stable_step ? d.seen + 1 : 0;
    if (d.seen < few) return;
    d.patience = d.taken < 8 * d.patience ? std::min(2 * d.patience, 4096) : few;
    d.check(CVodeSetMaxOrd(d.cvode.get(), d.options.max_order), "CVodeSetMaxOrd");
  } else {
    d.seen = h > kHeld * d.options.stable_step ? d.seen + 1 : 0;
    if (d.seen < d.patience) return;
    const std::vector<double> y(state().begin(), state().end());
    d.check(CVodeSetMaxOrd(d.cvode.get(), d.options.long_order), "CVodeSetMaxOrd");
    start(d.time, y);
  }
  d.seen = 0;
  d.taken = 0;
  d.long_steps = !d.long_steps;
  CVodeSetMaxStep(d.cvode.get(), d.longest_step());
}

void Integrator::forget() {
  impl_->newton->forget();
  impl_->stalled = 0;
}

void Integrator::scale_tolerances(double share) { impl_->wanted = share; }

StepStatus Integrator::step(double t_stop) {
  Impl& d = *impl_;
  const FlushToZero flush;
  choose_order();
  CVodeSetStopTime(d.cvode.get(), t_stop);
  double reached = d.time;
  const int flag = CVode(d.cvode.get(), t_stop, d.y.get(), &reached, CV_ONE_STEP);
  // A right-hand side that ends at some time would be approached for ever with steps below the
  // spacing of the numbers.
  d.stalled = flag == CV_SUCCESS && reached <= d.time ? d.stalled + 1 : 0;
  d.time = reached;
  if (d.thrown) {
    const std::exception_ptr thrown = d.thrown;
    d.thrown = nullptr;
    std::rethrow_exception(thrown);
  }
  if (flag == CV_TSTOP_RETURN) return StepStatus::kStop;
  if (d.stalled >= 100) {
    d.message = "the steps are too small to advance the time";
    return StepStatus::kFailed;
  }
  if (flag >= 0) return StepStatus::kStep;
  d.message = flag_text(flag);
  if (flag == CV_ILL_INPUT && !d.captured.empty()) d.message += ": " + d.captured;
  return StepStatus::kFailed;
}

double Integrator::time() const { return impl_->time; }

double Integrator::last_step() const {
  double h = 0.0;
  CVodeGetLastStep(impl_->cvode.get(), &h);
  return h;
}

int Integrator::last_order() const {
  int order = 0;
  CVodeGetLastOrder(impl_->cvode.get(), &order);
  return order;
}

std::span<const double> Integrator::state() const { return Impl::span(impl_->y.get()); }

void Integrator::interpolate(double t, std::span<double> y) const {
  CVodeGetDky(impl_->cvode.get(), t, 0, impl_->work.get());
  const auto from = Impl::span(impl_->work.get());
  std::copy(from.begin(), from.end(), y.begin());
}

std::size_t Integrator::limiting_state() {
  Impl& d = *impl_;
  CVodeGetEstLocalErrors(d.cvode.get(), d.work.get());
  CVodeGetErrWeights(d.cvode.get(), d.weights.get());
  const auto e = Impl::span(d.work.get());
  const auto w = Impl::span(d.weights.get());
  std::size_t worst = 0;
  double largest = -1.0;
  for (std::size_t i = 0; i < e.size(); ++i) {
    const double x = std::fabs(e[i] * w[i]);
    if (x > largest) {
      largest = x;
      worst = i;
    }
  }
  return worst;
}

IntegratorCounts Integrator::counts() const {
  const Impl& d = *impl_;
  IntegratorCounts c = d.total;
  if (!d.started) return c;
  long steps = 0, rhs = 0, setups = 0, fails = 0, newton = 0, newton_fails = 0;
  CVodeGetNumSteps(d.cvode.get(), &steps);
  CVodeGetNumRhsEvals(d.cvode.get(), &rhs);
  CVodeGetNumLinSolvSetups(d.cvode.get(), &setups);
  CVodeGetNumErrTestFails(d.cvode.get(), &fails);
  CVodeGetNonlinSolvStats(d.cvode.get(), &newton, &newton_fails);
  c.steps += steps;
  c.rhs += rhs;
  c.jacobians += d.jacobians;
  c.factorizations += d.factorizations;
  c.rejected += fails;
  c.newton_iterations += newton;
  c.newton_failures += newton_fails;
  return c;
}

const std::string& Integrator::message() const { return impl_->message; }

}  // namespace feltmb
