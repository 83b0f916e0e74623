/// Simulates a mechanism: samples, events, peaks, ledger, statistics.
#pragma once

#include <Eigen/Dense>
#include <functional>
#include <limits>
#include <span>
#include <string>
#include <vector>

#include "feltmb/core/error.hpp"
#include "feltmb/model/channels.hpp"
#include "feltmb/model/mechanism_system.hpp"
#include "feltmb/ode/integrator.hpp"

namespace feltmb {

using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// Called with every accepted step: time [s], whole state, largest compression remembered by each
/// contact from there on [m], whether the strings were free since the last step (kModal).
using StepObserver =
    std::function<void(double, std::span<const double>, std::span<const double>, bool)>;

/// Integration method of a run.
enum class Method {
  kAuto,   ///< kModal if the mechanism has strings, else kCvode
  kCvode,  ///< all states, the modes of the strings among them, by CVODES (BDF)
  kModal,  ///< linear modes exactly, the rest by CVODES; see docs/validation/speed.md
};

/// Name as users write it: "auto", "cvode", "modal". Throws InvalidParameter for another.
Method method_from_name(const std::string& name);
const char* method_name(Method method);

/// Relative tolerance at which a method keeps the largest error of a contact force below `error`
/// times its peak, in (0, 0.1], after a strike of 50 ms on a string
/// (docs/validation/speed.md, "Error asked for"). The tolerance itself is that of a
/// step. What the integrator leaves over adds up with the periods of a string without damping:
/// there the BDF is held to order two and its error falls with the root of the tolerance only.
/// Throws InvalidParameter.
double tolerance_for(double error, const Mechanism& mechanism, Method method);

/// Refuses `count` samples of `columns` numbers that would not fit into 4 GB.
void check_samples(double output_rate, double duration, double count, double columns);

struct SimulationOptions {
  double duration = 0.4;       ///< [s], > 0
  double rtol = 1e-6;          ///< relative tolerance; absolute ones follow from it
  double output_rate = 10000;  ///< samples a second [Hz], > 0
  bool ledger = true;          ///< integrate work and dissipation along
  bool events = true;          ///< find contact openings and closings
  bool outputs = true;         ///< sample the named outputs; false: end state, events, counts only
  double outputs_from = 0.0;   ///< the samples before are not taken [s]
  bool states = true;          ///< keep the full state at every sample
  bool diagnose = true;        ///< count which state and contact limit the step
  Method method = Method::kAuto;
  int max_order = 0;      ///< of the BDF; 0: chosen by the modes of the mechanism, bdf_order.hpp
  double max_step = 0.0;  ///< [s], 0: no limit
  /// A run with a ledger fails if a larger share of the exchanged energy is unaccounted for [-], >
  /// 0.
  double ledger_limit = 0.1;
  long max_steps = 20000000;
  double max_wall = 0.0;           ///< seconds of wall time after which the run stops, 0: none
  std::vector<int> peak_contacts;  ///< numbers of contacts whose largest force is sought
  /// Indices in Mechanism::points whose lowest position over all samples (stored or not) is
  /// computed.
  std::vector<int> lowest_points;
  /// Position of the finger's point along the finger's direction at which its pad just touches [m];
  /// motion input is relative to it. NaN: the position at the start of the run.
  double finger_reference = std::numeric_limits<double>::quiet_NaN();
  StepObserver on_step = {};  ///< none: empty
};

struct Equilibrium;

/// Complete state from which a run can continue.
struct SimulationState {
  double time = 0.0;      ///< [s] on the clock of the run that ended
  std::vector<double> y;  ///< see MechanismSystem
  /// Remembered by each contact [m], then turning points (Dynamics::memories); empty: nothing.
  std::vector<double> largest_compression;

  /// At rest, at time 0.
  static SimulationState of(const Equilibrium& rest);

  /// Throws InvalidParameter unless this is a possible state of `mechanism` with `size` values.
  void check(const Mechanism& mechanism, std::size_t size) const;
};

/// Unaccounted energy in the ledger of a run, over all samples.
struct LedgerBalance {
  double residual = 0.0;          ///< at the end [J]
  double residual_largest = 0.0;  ///< largest size of it [J]
  /// The largest of: work at the input without its sign, heat, kinetic energy, change of each part
  /// of the stored energy [J].
  double turned_over = 0.0;
  double residual_relative = 0.0;  ///< residual_largest / turned_over [-]
};

struct SimulationEvent {
  double time = 0.0;  ///< [s]
  int contact = -1;   ///< index in Mechanism::contacts, or -1
  int monitor = -1;   ///< index of the monitor, or -1
  int direction = 0;  ///< +1: closes or rises, -1: opens or falls
};

struct Peak {
  int contact = -1;    ///< index in Mechanism::contacts
  double force = 0.0;  ///< largest normal force [N], from dense output
  double time = 0.0;   ///< [s]
};

/// Lowest position of a point.
struct Lowest {
  int point = -1;       ///< index in Mechanism::points
  double start = 0.0;   ///< y at time zero [m]
  double lowest = 0.0;  ///< smallest y at a sample time [m]

  /// Throws InvalidParameter if there is no such point.
  static std::vector<Lowest> of(const Mechanism& mechanism, const std::vector<int>& points);

  void look(double y, bool first) {
    if (first) start = lowest = y;
    if (y < lowest) lowest = y;
  }
};

/// Largest displacement of a flexible beam relative to its base, along or perpendicular to it.
struct Deflection {
  std::string name;
  double length = 0.0;   ///< of the beam [m]
  double largest = 0.0;  ///< over all samples taken [m]
  double time = 0.0;     ///< [s]
};

enum class RunStatus { kDone, kFailed, kWallTime, kInterrupted };

/// "done", "failed", "wall_time" or "interrupted".
const char* status_name(RunStatus status);

struct RunResult {
  RunStatus status = RunStatus::kDone;
  ErrorCode code = ErrorCode::kNone;  ///< why the run stopped early
  std::string message;                ///< empty when done
  double reached = 0.0;               ///< [s]
  std::string failed_state;           ///< with the largest error at the failure
  std::string failed_contact;

  Eigen::VectorXd time;            ///< (n_times) [s]
  std::vector<std::string> names;  ///< of the outputs
  std::vector<std::string> units;
  std::vector<std::string> long_names;
  void name_outputs(const Channels& channels);
  RowMatrix data;             ///< (n_times, n_outputs)
  RowMatrix states;           ///< (n_times, n_states)
  std::vector<double> start;  ///< outputs at time zero, taken or not; with a ledger
  LedgerBalance balance;
  std::vector<std::string> ledger_names;
  RowMatrix ledger;                     ///< (n_times, n_ledger) [J]
  std::vector<SimulationEvent> events;  ///< rows of the three matrices that follow
  RowMatrix event_states;               ///< (n_events, 2 n): q, v
  RowMatrix event_compression;          ///< (n_events, n_contacts) [m]
  RowMatrix event_approach;             ///< (n_events, n_contacts) [m/s] of the materials
  std::vector<Peak> peaks;
  std::vector<Deflection> deflections;  ///< by beam
  std::vector<Lowest> lowest;           ///< as SimulationOptions::lowest_points
  SimulationState end;
  IntegratorCounts counts;
  Method method = Method::kCvode;  ///< that was used
  long strikes = 0;                ///< times that a free string was met (kModal)
  long event_evaluations = 0;
  long restarts = 0;
  long reversals = 0;  ///< restarts at new largest compressions of felts with memory
  double wall = 0.0;   ///< [s]
  std::vector<std::pair<std::string, long>> limiting_states;  ///< most often first
  std::vector<std::pair<std::string, long>> limiting_contacts;
};

/// Called now and then with the simulated time [s]; returning false interrupts the run.
using Progress = std::function<bool(double)>;

/// Integrates from `start` (the rest pose if y is empty). The clock starts at 0.
/// Throws InvalidParameter for bad options; a solver failure is a status, not an exception.
RunResult simulate(const std::shared_ptr<const Mechanism>& mechanism, const InputSignal& input,
                   const SimulationOptions& options, const SimulationState& start = {},
                   const std::vector<Monitor>& monitors = {}, const Progress& progress = {});

}  // namespace feltmb
