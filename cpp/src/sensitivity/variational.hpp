/// The variational equation along a trajectory.
#pragma once

#include <Eigen/Dense>
#include <functional>
#include <optional>

#include "feltmb/sensitivity/trajectory.hpp"
#include "free_columns.hpp"
#include "shifted_models.hpp"

namespace feltmb::detail {

/// Integrates S' = J S + B for all columns, one smooth stretch at a time.
class Variational {
 public:
  /// Called within a step for a time that was asked for.
  using Sample = std::function<void(double, const Columns&)>;

  Variational(ShiftedModels& models, Trajectory& trajectory, double tolerance);

  Columns& columns() { return columns_; }
  double time() const { return time_; }
  const SensitivityCounts& counts() const { return counts_; }

  /// From now on S + f shift is integrated, f the rate of the state: a shift in time by `shift`
  /// (one a column; empty: none) is a solution, and no error of it counts. columns() and what
  /// samples get stay S.
  void follow(const Eigen::VectorXd& shift) {
    shift_ = shift;
    ++version_;
  }
  /// J and B may jump here.
  void turn() { has_start_point_ = false; }

  const Eigen::VectorXd& shift() const { return shift_; }
  long version() const { return version_; }  ///< of the shift

  /// Integrates to `end` within a stretch without switches; `sample` gets those of `times` (sorted)
  /// that lie in (time(), end], beginning with the one at `next`.
  void advance(double end, const std::vector<double>& times, std::size_t& next,
               const Sample& sample);

 private:
  /// J and B at one time.
  struct Point {
    double time = 0.0;
    std::vector<double> slopes;  ///< J, see MechanismSystem::slopes
    std::vector<int> pieces;     ///< that the contacts are on
    RowMatrix rate, loads;       ///< B, see ShiftedModels::rates
  };

  template <class Rows>
  void measure(const Rows& columns, Eigen::RowVectorXd& size) const;
  bool touched(double t);
  bool step(double h, double from, double to);
  void look(Point& point, double t, double from, double to);
  bool blend(double t, double h);
  void stage(int i, double h);
  void add_motion(double t, double from, double to, double factor, RowMatrix& columns);
  void add_drift(double t, double from, double to, RowMatrix& rate);
  void forget(double from, double to);

  ShiftedModels& models_;
  Trajectory& trajectory_;
  double tolerance_;
  double time_ = 0.0;
  double h_ = 0.0;
  double error_ = 0.0;
  Columns columns_, dense_;
  Eigen::Index rows_ = 0;            ///< that are integrated: all, or those before the strings'
  std::optional<FreeColumns> free_;  ///< none without strings
  std::vector<double> start_;        ///< whole state at the start of a step
  Point start_point_, points_[3];    ///< at the start of a step, and of its stages
  bool has_start_point_ = false;
  bool blends_ = false;  ///< slopes are all of J
  RowMatrix slope_[3], stage_, difference_;
  Eigen::RowVectorXd largest_, size_, present_, error_size_, floor_;
  std::vector<double> y_;
  Eigen::VectorXd shift_, motion_, drift_;
  long version_ = 0;
  SensitivityCounts counts_;
};

}  // namespace feltmb::detail
