/// Derivatives of a run by parameters of the mechanism, of the input, and by its start state.
///
/// Along the recorded steps of a run the variational equation S' = J(t) S + df/dp is integrated for
/// all columns at once by the L-stable three-stage SDIRK method of order three (R. Alexander, SIAM
/// J. Numer. Anal. 14 (1977) 1006) with its own error control. J is the exact Jacobian, known
/// at the start of a step and at its first and last stage, and between these on a parabola; a stage
/// costs one factorization of the structured Newton matrix, shared by all columns. df/dp comes from
/// immutable mechanisms built with shifted parameters, of which those count whose contacts are on
/// the smooth pieces of the model: just after a felt turns, a shift can take it past its top. While
/// no string is touched its columns are rotated exactly, mode by mode, and the rest alone is
/// integrated. Steps end where a contact
/// closes, opens or turns from loading to unloading; where the right-hand side itself jumps there,
/// S does too: S+ = S- + (f- - f+) dt*/dp (saltation). While a contact whose largest force is
/// sought is closed, S + f dt/dp is integrated, with the time t of its closing: what is left of S
/// without the common shift in time, which would hide it.
#pragma once

#include <Eigen/Dense>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "feltmb/model/mechanism_system.hpp"
#include "feltmb/model/simulation.hpp"

namespace feltmb {

/// The model with one parameter shifted, and its weight in the difference formula.
struct Perturbed {
  std::shared_ptr<const Mechanism> mechanism;
  InputSignal input;
  double shift = 0.0;   ///< of the parameter, its unit
  double weight = 0.0;  ///< derivative ~ sum of weight x value [1 / unit of the parameter]
};

/// One column of the gradient: the evaluations for the derivative by a parameter. The parts that
/// the parameter changes are found by comparison, and only their forces are evaluated, at the state
/// of the base. A complete right-hand side is evaluated only if the links move differently.
struct SensitivityParameter {
  std::string name;
  std::vector<Perturbed> nodes;  ///< weights sum to zero, weight x shift to one
  double scale = 1.0;            ///< size of the parameter, > 0, its unit: for the error control
};

/// A time segment of a stroke.
struct SensitivitySegment {
  double begin = 0.0;     ///< on the clock of the input [s]
  double end = 0.4;       ///< [s], > begin
  SimulationState start;  ///< y empty: the rest pose, which moves with the parameters
  /// Directions of the start state, one a column after the parameters; rows as in
  /// MechanismSystem, or none.
  Eigen::MatrixXd directions;
  /// Derivatives of a given start state by the parameters (n_states, n_parameters), or none: zero.
  Eigen::MatrixXd moves;
};

/// A value of an output that is wanted with its derivatives: at a time, or an extremum over time.
struct SensitivityRequest {
  int output = -1;     ///< index in Channels
  double begin = 0.0;  ///< [s] on the clock of the stroke, as the times of its events
  double end = 0.0;    ///< [s]
  int sign = 0;        ///< +1: the largest value from begin to end, -1: the smallest, 0: at begin
};

struct SensitivityValue {
  double value = 0.0;
  double time = 0.0;  ///< [s], as in SensitivityRequest
  int edge = 0;  ///< -1: it is at the begin, +1: at the end, whose time may move too; 0: between
  double rate = 0.0;  ///< of the output at an edge: what the derivative gets by the edge's own time
  Eigen::VectorXd derivative;       ///< by column, with the time of an edge fixed
  Eigen::VectorXd time_derivative;  ///< [s / unit of the column]
  std::string reason;               ///< why the derivatives are not known; empty: they are
};

struct SensitivityOptions {
  SimulationOptions simulation;  ///< of each segment; duration, ledger, outputs are set here
  double tolerance = 1e-3;       ///< local relative error of a column, in (0, 0.1]
  double output_rate = 1000.0;   ///< samples a second [Hz]
  std::vector<int> outputs;      ///< indices in Channels
  std::size_t threads = 1;       ///< over segments; 0: all cores
  bool whole_models = false;     ///< a whole right-hand side a parameter, for tests
  /// Height above the rest position at which a monitored point is an event.
  struct Rule {
    std::string name;
    int point = -1;
    Vec2 direction;
    double travel = 0.0;  ///< [m]
  };
  std::vector<Rule> rules;
  /// Looks that are wanted, given the stroke; none: empty.
  std::function<std::vector<SensitivityRequest>(const RunResult&)> looks = {};
};

struct SensitivityEvent {
  SimulationEvent event;
  Eigen::VectorXd time;   ///< d time / d column [s]
  RowMatrix compression;  ///< (n_contacts, n_columns): of the gap at the event, its time moving
  RowMatrix approach;     ///< (n_contacts, n_columns) of the materials
  RowMatrix rate;         ///< (n_coordinates, n_columns)
  bool known = false;     ///< false: the crossing is too flat for a derivative
};

struct SensitivityCounts {
  long steps = 0;  ///< of the variational equation
  long rejected = 0;
  long linearizations = 0;  ///< of the equations of motion along the stroke
  long factorizations = 0;  ///< one a stage
  long rhs = 0;             ///< evaluations with shifted parameters
  long switches = 0;        ///< places where a step had to end
  long jumps = 0;           ///< of them with a jump of the right-hand side
};

struct SensitivityResult {
  RunResult run;                 ///< the stroke itself: events, peaks, counts, end
  Eigen::VectorXd time;          ///< (n_times) on the clock of the input [s]
  RowMatrix values;              ///< (n_times, n_outputs)
  std::vector<double> gradient;  ///< (n_times, n_outputs, n_columns)
  RowMatrix end_state;           ///< (n_states, n_columns)
  RowMatrix end_memory;          ///< (n_contacts, n_columns)
  std::vector<SensitivityEvent> events;
  std::vector<SensitivityValue> peaks;  ///< largest forces, as run.peaks
  std::vector<SensitivityValue> looks;  ///< as SensitivityOptions::looks gave them
  SensitivityCounts counts;
  double wall_stroke = 0.0;  ///< [s]
  double wall = 0.0;         ///< of the variational part [s]
};

/// Integrates each segment with its sensitivities. Segments run on `threads`; the results do not
/// depend on their number. Throws InvalidParameter; a solver failure of a segment is its
/// run.status.
std::vector<SensitivityResult> sensitivities(const std::shared_ptr<const Mechanism>& mechanism,
                                             const InputSignal& input,
                                             const std::vector<SensitivityParameter>& parameters,
                                             const std::vector<SensitivitySegment>& segments,
                                             const SensitivityOptions& options,
                                             const Progress& progress = {});

}  // namespace feltmb
