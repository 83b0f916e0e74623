/// A mechanism with its strings as one system of ordinary differential equations.
#pragma once

#include <Eigen/Dense>
#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "feltmb/modal/kernels.hpp"
#include "feltmb/model/free_strings.hpp"
#include "feltmb/model/profile.hpp"
#include "feltmb/numeric/dense_lu.hpp"
#include "feltmb/ode/system.hpp"
#include "feltmb/planar/dynamics.hpp"

namespace feltmb {

/// Input of a run.
struct InputSignal {
  Profile profile;  ///< in the unit of the kind
  InputKind kind = InputKind::kForce;
  double origin = 0.0;  ///< time on the clock of the profile at which a run begins [s]

  Drive at(double t) const;
};

/// Height of a tracking point above a level, or of a coordinate; an event when it crosses the
/// level.
struct Monitor {
  std::string name;
  int point = -1;  ///< tracking point index
  Vec2 direction{0.0, 1.0};
  double level = 0.0;  ///< dot(direction, position) - level is the root function [m]
};

/// State y = [q, v, s, eta, deta/dt], n + n + L + N + N: L states of contact laws, N all modes of
/// all strings.
///
/// q' = v; M v' = Q(q, v, eta, deta/dt, t); eta'' + 2 xi w eta' + w^2 eta = phi F.
/// Newton matrix: with dq = r_q + gamma dv the first block goes; the modes are diagonal but for the
/// contact force, one unknown a closed string contact, so they are eliminated: what is factorised
/// is (n + closed string contacts) square. Contacts with one string answer each other through sums
/// over its modes. States of a law are local to its contact and go into
/// effective slopes of its force.
class MechanismSystem : public OdeSystem {
 public:
  MechanismSystem(std::shared_ptr<const Mechanism> mechanism, InputSignal input, bool ledger,
                  std::vector<Monitor> monitors, bool events);

  std::size_t size() const override {
    return static_cast<std::size_t>(2 * (n_ + active_modes()) + law_states_);
  }

  /// Prepares for intervals in which the strings are not part of the state and are advanced
  /// exactly.
  void allow_free_strings();

  /// Leaves the free strings out of the state from t on: y = [q, v, s]. Their contacts are open
  /// until join_strings.
  void part_strings(double t, std::span<const double> y);

  /// Adds the strings to the state again: `y` has the size of the whole state at t, and its string
  /// part is set here.
  void join_strings(double t, std::span<double> y);

  bool strings_apart() const { return apart_; }

  /// Whether every string contact is open by more than `gap` [m] relative to the present string,
  /// according to the last right-hand side, if it was evaluated at t.
  bool strings_clear(double t, double gap) const;

  /// Largest compression of a string contact at (t, y), relative to the free strings at this time;
  /// -infinity if no contact can reach its string.
  double string_approach(double t, std::span<const double> y);

  /// Writes modal coordinates and rates at t of the separate strings into the whole state y.
  void fill_strings(double t, std::span<double> y);

  /// Energy that a string has lost since it was separated, until the last such write [J].
  double string_heat(std::size_t string) const { return free_->heat(string); }
  std::string state_name(std::size_t i) const override;
  void rhs(double t, std::span<const double> y, std::span<double> rate) override;

  /// The right-hand side at y, where everything was evaluated last.
  void read_rates(std::span<const double> y, std::span<double> rate) const;
  void linearize(double t, std::span<const double> y) override;
  void linearize_stiff(double t, std::span<const double> y) override;
  bool factorize(double gamma) override;
  void solve(std::span<double> b) override;

  /// States by rows, right-hand sides side by side.
  using RowBlock = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

  /// All numbers of the last linearization that factorize() and the solutions use, if no law has
  /// states and no motion is prescribed: while the contacts stay on their pieces each is a smooth
  /// function of time.
  void slopes(std::vector<double>& out);
  void set_slopes(std::span<const double> slopes);

  /// `solve` for every column of b at once, in place; vectorised over the columns.
  void solve_many(RowBlock& b, const RowBlock* loads = nullptr);
  std::size_t n_events() const override;
  void events(double t, std::span<const double> y, std::span<double> g) override;
  bool events_nearby(double t, std::span<double> g) override;
  double event_margin() const override { return margin_; }

  /// The last evaluation was a right-hand side at t, and this contact was open there for certain.
  bool surely_open(double t, int contact) const;

  /// Relative tolerance of the integration, from which the margin of the events follows.
  void set_tolerance(double rtol) { margin_ = rtol; }

  /// Names of the ledger's integrals: work_in, work_throughput, dissipated.* [J].
  const std::vector<std::string>& ledger_names() const { return ledger_names_; }

  /// Rates of the ledger's integrals at (t, y) [W], from the last right-hand side if that was at t.
  void powers(double t, std::span<const double> y, std::span<double> out);

  /// Contact indices in the order of the event functions, then monitors.
  const std::vector<int>& event_contacts() const { return event_contacts_; }
  const std::vector<Monitor>& monitors() const { return monitors_; }

  Dynamics& dynamics() { return dynamics_; }
  const Dynamics& dynamics() const { return dynamics_; }
  const Mechanism& mechanism() const { return dynamics_.mechanism(); }
  int coordinates() const { return n_; }
  int modes() const { return modes_; }
  int law_states() const { return law_states_; }
  int active_modes() const { return apart_ ? 0 : modes_; }

  /// The parts of y.
  MechanicalState parts(std::span<const double> y) const;

  /// Evaluates everything at (t, y) for outputs.
  void evaluate(double t, std::span<const double> y, Detail detail = Detail::kClosedContacts);
  void locate(double t, std::span<const double> y, Detail detail = Detail::kClosedContacts);
  void place(std::span<const double> y);  ///< the links alone
  Drive drive(double t) const;

  /// Locates some contacts at (t, y), which may differ from the last right-hand side by a Newton
  /// correction only; the others stay as that left them. Free strings count as out of reach.
  void locate_only(double t, std::span<const double> y, std::span<const std::size_t> contacts);

  /// A prescribed motion is relative to the start state from now on. Throws InvalidParameter if the
  /// initial speed of the profile differs from the state.
  void set_prescribed_reference(double t, std::span<const double> y);

  /// Position along its direction, and speed, of the point under the finger; for inputs of a motor,
  /// of the motor's coordinate.
  std::pair<double, double> driven_place(double t, std::span<const double> y);

  /// Another input of the same kind.
  void set_input(const InputSignal& input);

  /// See SimulationOptions::finger_reference.
  void set_finger_reference(double place) {
    finger_reference_ = place;
    fresh_ = false;
  }
  double finger_reference() const { return finger_reference_; }

  /// See InputSignal::origin.
  void set_origin(double origin) {
    input_.origin = origin;
    fresh_ = false;
  }
  double origin() const { return input_.origin; }

  /// Absolute tolerance of each state: rtol times 0.2 mm of travel and 0.2 m/s at the contacts, the
  /// scale of a felt compression; strings likewise at their largest displacement.
  std::vector<double> absolute_tolerances(double rtol) const;

  /// Contact with the largest influence on the stiffness of the given state at the last
  /// linearization, -1 if none.
  int stiffest_contact(std::size_t state) const;

 private:
  void check_input(const Mechanism& m) const;

  Dynamics dynamics_;
  InputSignal input_;
  double finger_reference_ = 0.0;
  double prescribed_reference_ = 0.0;
  /// Time of the last evaluation, if it was a right-hand side or its powers.
  double rhs_time_ = std::numeric_limits<double>::quiet_NaN();
  bool fresh_ = false;             ///< nothing was located since
  std::vector<double> rhs_state_;  ///< and its state and memory
  std::vector<double> rhs_largest_;
  double margin_ = 1e-6;  ///< [m], rtol of coordinates of order one with arms below a meter
  int n_ = 0;
  int modes_ = 0;
  int law_states_ = 0;
  std::unique_ptr<FreeStrings> free_;
  bool apart_ = false;
  std::vector<double> modal_stiffness_;
  std::vector<double> modal_damping_;
  std::vector<double> modal_rate_factor_;
  std::vector<std::string> ledger_names_;
  Eigen::VectorXd finger_load_;  ///< scratch of powers: generalized forces
  std::vector<int> event_contacts_;
  std::vector<Monitor> monitors_;

  // Linearisation kept between Newton iterations.
  struct StringCoupling {
    int string = -1;
    int offset = 0;  ///< of the modes
    int count = 0;   ///< of the modes
    int shape = 0;   ///< of its values of the mode shapes
    double force = 0.0;
    double by_compression = 0.0;  ///< dF/de
    double by_rate = 0.0;         ///< dF/d(de/dt)
    double strike_speed = 0.0;
    Eigen::VectorXd force_column;         ///< b
    Eigen::VectorXd compression_column;   ///< c
    Eigen::VectorXd displacement_column;  ///< -(b dF/de + c): effect of the string's displacement
    Eigen::VectorXd gradient;             ///< de/dq
    Eigen::VectorXd rate_gradient;        ///< d(de/dt)/dq
    Eigen::VectorXd strike;               ///< dy/dq
    Eigen::VectorXd slope_force;          ///< dQ/d(F x slope of the string)
    Eigen::VectorXd rate_column, slope_column, by_force, by_strike;  ///< scratch of factorize
    /// By coupling: sums over the modes of shapes here times shapes there, zero on another string.
    std::vector<modal::GramSums> to;
  };
  /// A contact whose law has states, through which its slopes depend on gamma.
  struct StatefulContact {
    int contact = -1;
    int coupling = -1;    ///< index in couplings_ if it is a closed string contact
    bool closed = false;  ///< else there is no gradient
    LawValue law;
    LawStates states;
    const ContactGradient* gradient = nullptr;  ///< of dynamics_, until the next linearization
    Eigen::Matrix3d inverse;                    ///< (I - gamma d(ds/dt)/ds)^-1
    Eigen::Vector3d by_compression, by_rate;    ///< ds for unit de, d(de/dt)
    double slope = 0.0, rate_slope = 0.0;       ///< effective dF/de, dF/d(de/dt)
    int first_state = 0;
    int single = -1;  ///< place in SingleStates if it is there
  };
  /// Closed contacts with one state and without a string: their couplings to the other equations,
  /// in adjacent columns of whole blocks.
  struct SingleStates {
    std::vector<int> contacts;       ///< indices in stateful_
    std::vector<double> by_force;    ///< a column a contact: force on each coordinate for unit ds
    std::vector<double> by_q, by_v;  ///< a column a coordinate: ds of each contact for dq, dv
    std::vector<double> residual;    ///< of s of each contact, divided by its own factor
    std::vector<double> change;      ///< ds of each contact
  };
  void gather_single();
  void add_string_answers();
  void read_events(std::span<double> g) const;
  void evaluate_apart(double t, std::span<const double> y);
  bool within_reach() const;
  bool evaluated_at(double t, std::span<const double> y) const;
  void keep_slopes();
  template <class Visit>
  void visit_slopes(Visit&& visit);
  void add_stateful(const ContactGradient* gradient, int contact, int coupling);
  void reduce_law_states(double gamma);
  void reduce_one_state(StatefulContact& c, double gamma, const std::vector<int>& coordinates);
  static void reduce_states(StatefulContact& c, double gamma, Eigen::Index count);
  void add_contact_slopes(Eigen::MatrixXd& stiffness, Eigen::MatrixXd& damping,
                          const ContactGradient& gradient, double slope, double rate_slope);

  Eigen::MatrixXd mass_, stiffness_, damping_;
  Eigen::MatrixXd base_stiffness_, base_damping_;  ///< without contacts whose laws have states
  std::vector<StatefulContact> stateful_;
  int stateful_count_ = 0;
  SingleStates single_;
  std::vector<StringCoupling> couplings_;
  int coupling_count_ = 0;
  int constraint_ = 0;  ///< 1 with a prescribed motion: its reaction is one more unknown
  std::vector<double> phi_, dphi_;              ///< of each string contact
  Eigen::VectorXd slope_column_, rate_column_;  ///< scratch of add_contact_slopes
  std::vector<double> kept_slope_;  ///< dF/de of dynamics_.gradients() at the last linearization
  double gamma_ = 0.0;
  DenseLu lu_;
  RowBlock right_rows_;           ///< scratch of solve_many
  std::vector<double> residual_;  ///< M, then gamma K, by padded columns: of the right-hand side
  Eigen::VectorXd right_;         ///< and solution
};

}  // namespace feltmb
