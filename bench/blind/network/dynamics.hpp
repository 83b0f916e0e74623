/// Forces and rates of a lumped network with their linearization.
#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <vector>

#include "network.hpp"
#include "slopes.hpp"

namespace feltmb::lumped {

/// Displacement and its rate.
struct Moved {
  double d, rate;
};

/// A network with the numbers of one row of parameters.
///
/// Rates are linear in the derivatives of the states: with every evaluation come the slopes of each
/// rate by the states and, sparse, by the columns. The derivatives of a whole step are then sums of
/// few rows, however many elements there are.
class Dynamics {
 public:
  /// `columns`: for every parameter the columns that stand for it; empty without derivatives.
  /// `moving`: the hidden states that start with a value or a derivative.
  Dynamics(const Network& network, std::span<const double> parameters,
           const std::vector<std::vector<std::size_t>>& columns, const std::vector<bool>& moving);

  /// Sum of parameters with its derivatives.
  Number sum(const Sum& terms) const;
  /// Corrected input at the time `t` [samples]: cubic Hermite with centered slopes.
  void set_input(std::span<const double> u, double t);
  /// Unknown forces at the share `x` of the segment: knots (coordinates, m).
  void set_unknown(std::span<const double> knots, double x);
  /// Rates of the states and, where there are columns, their slopes. What rests (see `live`) is not
  /// written: `dx` holds zeros there.
  void rates(const double* x, double* dx);

  /// Displacement along a travel; `dx`: rates of the states, for lags, or null.
  Moved moved(const Travel& t, double offset, const double* x, const double* dx) const;
  /// Slopes by states and columns of `by_place` times the displacement and `by_rate` times its
  /// rate, as far as states have a rate of their own (lags have none here).
  void append_travel(const Travel& t, const Slopes& offset, double by_place, double by_rate,
                     Slopes& states, Slopes& columns) const;

  double force(std::size_t element) const { return forces_[element].f; }
  const Slopes& force_by_states(std::size_t element) const { return forces_[element].states; }
  const Slopes& force_by_columns(std::size_t element) const { return forces_[element].columns; }
  std::size_t elements() const { return forces_.size(); }

  /// States that can be other than zero, in rising order.
  const std::vector<std::size_t>& live() const { return live_; }
  /// The state that is the rate of this one; itself where the rate has slopes of its own.
  std::size_t rate_of(std::size_t state) const { return rate_of_[state]; }
  /// Slopes of the rate of a state by the states, dense, and by the columns.
  const double* by_states(std::size_t state) const { return by_states_.data() + state * n_; }
  const Slopes& by_columns(std::size_t state) const { return by_columns_[state]; }
  /// First state of a hidden one.
  std::size_t place(int hidden) const { return place_[static_cast<std::size_t>(hidden)]; }

 private:
  struct Values {
    Number offset, a, b, c, d;
    std::vector<Number> gate_offset, gate_slope;
    bool cubic = true;
    bool damped = true;  ///< spring: damping; friction: the dry part
    bool quadratic = true;
  };
  struct Force {
    double f = 0.0;
    bool acts = false;
    Slopes states, columns;
  };

  double place_along(const Travel& t, double offset, const double* x) const;
  void evaluate(const Element& e, const Values& p, const double* x, Force& out);
  void evaluate_contact(const Element& e, const Values& p, const double* x, Force& out);
  void linearize(const double* x);
  void linearize_hidden(std::size_t h, const double* x);

  const Network& net_;
  std::span<const double> p_;
  const std::vector<std::vector<std::size_t>>& columns_;
  bool with_slopes_;
  std::size_t n_q_;
  std::size_t n_ = 0;
  std::vector<std::size_t> place_, live_, live_hidden_, rate_of_;
  std::vector<std::size_t> present_;  ///< elements that can act
  std::vector<Number> inverse_mass_;
  std::vector<Values> elements_;
  std::vector<std::array<Number, 3>> hidden_;  ///< gain, 1 / time or omega, damping
  std::vector<Force> forces_;
  std::vector<double> unknown_, push_, fed_;
  std::vector<double> by_states_;
  std::vector<Slopes> by_columns_;
  Number gain_, offset_, delay_;
  double input_ = 0.0, input_rate_ = 0.0;
  Slopes input_d_, input_rate_d_;
};

}  // namespace feltmb::lumped
