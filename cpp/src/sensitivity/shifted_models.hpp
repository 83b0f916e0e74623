/// Workspaces of the model and of its copies with shifted parameters, one set a thread.
#pragma once

#include <array>
#include <memory>
#include <span>
#include <vector>

#include "changes.hpp"
#include "feltmb/sensitivity/sensitivity.hpp"

namespace feltmb::detail {

/// Columns of derivatives at one place: of the state and of the contacts' memory.
struct Columns {
  RowMatrix state;         ///< (n_states, n_columns)
  Eigen::MatrixXd memory;  ///< (n_contacts, n_columns)
};

/// Smooth piece that a contact is on: of its law, and of its surface if it carries a force.
inline int piece_of(const MechanismSystem& system, std::size_t contact) {
  const ContactState& s = system.dynamics().contacts()[contact];
  const ContactLaw& law = system.mechanism().contacts[contact].law;
  const int piece = law.piece(s.compression, s.rate, system.dynamics().memory(contact));
  // On the arc of a hybrid surface the normal turns, on its lines it does not.
  return 4 * piece + (piece != 0 ? s.part : 0);
}

/// Weights of a difference of values at +shift, in the middle and at -shift. A value on another
/// smooth piece says nothing about this one: near a kink, one side is left.
struct Sides {
  Sides(bool up_is_on, bool down_is_on, double shift)
      : up(up_is_on == down_is_on ? 0.5 / shift : up_is_on / shift),
        down(up_is_on == down_is_on ? -0.5 / shift : -down_is_on / shift),
        middle(-up - down) {}
  double up, down, middle;
};

/// The model, and its copies with shifted parameters, as workspaces.
class ShiftedModels {
 public:
  /// @param rest  whether the rest pose and its derivatives are wanted
  ShiftedModels(const std::shared_ptr<const Mechanism>& mechanism, const InputSignal& input,
                const std::vector<SensitivityParameter>& parameters,
                const SensitivityOptions& options, bool rest);

  /// From now on the clock of all starts at `begin` of the input's, with `directions` columns after
  /// those of the parameters; `start` is the state there and `moves` its derivatives by the
  /// parameters: each model counts a prescribed motion from its own start.
  void begin(double begin, std::size_t directions, std::span<const double> start,
             const RowMatrix& moves);

  MechanismSystem& base() { return *base_; }
  MechanismSystem& probe() { return *probe_; }
  std::size_t columns() const { return parameters_.size() + directions_; }
  std::size_t parameters() const { return parameters_.size(); }
  long evaluations() const { return evaluations_; }

  const Mechanism& mechanism() const { return *mechanism_; }
  std::size_t nodes(std::size_t parameter) const { return parameters_[parameter].size(); }
  const Mechanism& mechanism(std::size_t parameter, std::size_t node) const {
    return parameters_[parameter][node].system->mechanism();
  }
  double weight(std::size_t parameter, std::size_t node) const {
    return parameters_[parameter][node].weight;
  }

  /// Row of the first modal coordinate of the strings; all before are [q, v, s].
  std::size_t first_mode() const { return base_->size() - 2 * modes(); }
  std::size_t modes() const { return static_cast<std::size_t>(base_->modes()); }

  /// Whether a parameter moves the modes of a string.
  bool moves_strings(std::size_t parameter) const {
    return changes_[parameter].motions || changes_[parameter].strings;
  }

  /// Rest pose as a start state, and its derivatives.
  SimulationState rest() const;
  const Columns& rest_columns() const { return rest_columns_; }

  /// d f / d parameter at fixed state, memory moving: the inhomogeneous part of S'. The base must
  /// have been linearized there. `out` has the rows that are wanted: all, or those before the
  /// strings'. It lacks the generalized `loads` (n_coordinates, n_columns): M^-1 of them belongs to
  /// the rows of the speeds.
  void rates(double t, std::span<const double> y, std::span<const double> memory,
             const Eigen::MatrixXd& memory_columns, RowMatrix& out, RowMatrix& loads);

  /// Pieces of the contacts where rates() was evaluated last.
  const std::vector<int>& pieces() const { return pieces_; }

  /// Total derivative of any function of the model at a fixed time.
  /// @param function  (MechanismSystem&, t, y, out span, index of the parameter's node or -1)
  template <class Function>
  void total(double t, std::span<const double> y, std::span<const double> memory,
             const Columns& columns, std::size_t width, Function&& function, Eigen::MatrixXd& out);

  /// A state, or a component of a tracking point's position.
  struct PlaceOf {
    int state = -1;
    int point = -1;
    Vec2 direction;
  };

  /// Total derivatives of places at a fixed time: one product for all columns.
  void places(std::span<const double> y, const RowMatrix& columns, std::span<const PlaceOf> wanted,
              Eigen::MatrixXd& out);

  /// Adds d exp(-open / recovery time) of each parameter times what is remembered.
  void add_recovery(std::size_t contact, double remembered, double open, double time,
                    Eigen::MatrixXd& memory_columns) const;

  /// d time of a stop of the input by column; `index` in breakpoints() or, after them, knots().
  void stop_time(std::size_t index, Eigen::VectorXd& out) const;

  /// Largest weighted entry of a column of states.
  template <class Column>
  double norm(const Eigen::MatrixBase<Column>& column) const {
    return (column.array() * weight_.array()).abs().maxCoeff();
  }
  const Eigen::VectorXd& weight() const { return weight_; }

  /// Norm of a column below which its relative error does not matter: the parameter changed by its
  /// own size would move a felt contact by 1 % of 0.2 mm.
  double floor(std::size_t column) const { return column < floor_.size() ? floor_[column] : 0.0; }

  /// Level of a monitored point: its place at rest of that model plus the travel.
  double level(std::size_t rule, int parameter, std::size_t node) const;

 private:
  struct Node {
    std::shared_ptr<const Mechanism> mechanism;
    std::unique_ptr<MechanismSystem> system;
    InputSignal input;
    double shift = 0.0;
    double weight = 0.0;
    std::vector<double> levels;
  };
  struct Rest {
    Eigen::VectorXd state;
    Eigen::VectorXd memory;
    double finger = 0.0;
    std::vector<double> levels;
  };
  void find_rests();
  Rest find_rest(const std::shared_ptr<const Mechanism>& mechanism, std::span<const double> near,
                 const InputSignal& input);
  static void remember(MechanismSystem& system, std::span<const double> memory) {
    if (memory.empty()) return;
    std::copy(memory.begin(), memory.end(), system.dynamics().largest_compression().begin());
  }

  std::shared_ptr<const Mechanism> mechanism_;
  InputSignal input_;
  const SensitivityOptions& options_;
  std::unique_ptr<MechanismSystem> base_, probe_;
  static const Node& nearest(const std::vector<Node>& nodes);
  /// The nearest version of a parameter for which `evaluate` says that it is on the pieces of the
  /// model; without one, the nearest. It was evaluated last.
  template <class Evaluate>
  const Node& beside(std::size_t j, Evaluate&& evaluate);
  std::vector<int> pieces_;  ///< of the contacts of the model at hand
  void find_pieces(const MechanismSystem& system);
  bool on_pieces(const MechanismSystem& system) const;
  bool told_by_parts(const Changes& changes, const Drive& drive) const;
  void add_contact(std::size_t j, const Changes::OfContact& of, double t, std::span<const double> y,
                   RowMatrix& out);
  void add_string_force(std::size_t contact, double force, Eigen::Index column, RowMatrix& out);
  void add_links(const Changes& changes);
  void add_members(std::size_t j, std::span<const double> y);
  void add_straps(std::size_t j);
  void add_finger(std::size_t j, double t);
  void add_prescription(std::size_t j, double t, RowMatrix& out);
  double wanted(std::size_t j, double t);
  void add_modes(std::size_t j, std::span<const double> y, RowMatrix& out) const;
  void whole_rates(std::size_t j, double t, std::span<const double> y,
                   std::span<const double> memory, RowMatrix& out);
  void memory_rates(const Eigen::MatrixXd& memory_columns, RowMatrix& out, RowMatrix& loads);
  const Eigen::VectorXd& by_force(std::size_t contact);  ///< dQ/dF of a closed contact
  bool closed(std::size_t contact) const { return base_->dynamics().contacts()[contact].closed; }

  std::vector<int> condensed_;  ///< coordinates without an equation
  std::vector<std::vector<Node>> parameters_;
  std::vector<Changes> changes_;  ///< by parameter
  std::size_t directions_ = 0;
  Rest rest_;
  Columns rest_columns_;
  Eigen::VectorXd weight_;
  std::vector<double> floor_;
  std::vector<double> scratch_, shifted_, moved_memory_;
  Eigen::VectorXd one_, two_, three_;
  Eigen::VectorXd here_;           ///< a function of the model, without a shift
  bool has_base_ = false;          ///< two_ holds the rates of the base
  std::vector<double> reference_;  ///< of a prescribed motion: see wanted(), without the input
  long evaluations_ = 0;
};

template <class Function>
void ShiftedModels::total(double t, std::span<const double> y, std::span<const double> memory,
                          const Columns& columns, std::size_t width, Function&& function,
                          Eigen::MatrixXd& out) {
  // Largest move of a state, in tolerance weights (0.2 mm of felt): far below any curvature.
  constexpr double small = 1e-5;
  constexpr double most = 1e-4;
  const auto rows = static_cast<Eigen::Index>(width);
  out.setZero(rows, static_cast<Eigen::Index>(this->columns()));
  one_.resize(rows);
  const std::size_t n = y.size();
  shifted_.resize(n);
  moved_memory_.assign(memory.begin(), memory.end());
  const std::span<double> value{one_.data(), width};
  const auto move = [&](Eigen::Index j, double shift) {
    for (std::size_t i = 0; i < n; ++i) {
      shifted_[i] = y[i] + shift * columns.state(static_cast<Eigen::Index>(i), j);
    }
    for (std::size_t c = 0; c < memory.size(); ++c) {
      moved_memory_[c] = memory[c] + shift * columns.memory(static_cast<Eigen::Index>(c), j);
    }
  };
  remember(*probe_, memory);
  function(*probe_, t, y, value, -1, std::size_t{0});
  here_ = one_;
  find_pieces(*probe_);
  for (std::size_t j = 0; j < this->columns(); ++j) {
    const auto column = static_cast<Eigen::Index>(j);
    const double size = norm(columns.state.col(column));
    bool together = false;
    if (j < parameters_.size()) {
      auto& nodes = parameters_[j];
      double shift = 0.0;
      for (const Node& node : nodes) shift = std::max(shift, std::fabs(node.shift));
      together = shift * size <= most;
      bool all_on = true;
      two_.resize(0);
      for (std::size_t k = 0; k < nodes.size(); ++k) {
        Node& node = nodes[k];
        if (node.shift == 0.0 && node.mechanism == mechanism_) {
          out.col(column) += node.weight * here_;
          continue;
        }
        move(column, together ? node.shift : 0.0);
        remember(*node.system, moved_memory_);
        function(*node.system, t, std::span<const double>(shifted_), value, static_cast<int>(j), k);
        out.col(column) += node.weight * one_;
        const bool on = on_pieces(*node.system);
        if (on && two_.size() == 0) two_ = (one_ - here_) / node.shift;
        all_on = all_on && on;
        ++evaluations_;
      }
      if (!all_on && two_.size() > 0) out.col(column) = two_;
    }
    if (together || size == 0.0) continue;
    const double shift = small / size;
    std::array<bool, 2> on{};
    for (const int side : {0, 1}) {
      move(column, side == 0 ? shift : -shift);
      remember(*probe_, moved_memory_);
      function(*probe_, t, std::span<const double>(shifted_), value, -1, std::size_t{0});
      on[static_cast<std::size_t>(side)] = on_pieces(*probe_);
      (side == 0 ? two_ : three_) = one_;
      ++evaluations_;
    }
    const Sides weight(on[0], on[1], shift);
    out.col(column) += weight.up * two_ + weight.down * three_ + weight.middle * here_;
  }
  remember(*probe_, memory);
}

}  // namespace feltmb::detail
