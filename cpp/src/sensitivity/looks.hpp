/// Values of outputs at given times and their extrema over time, with their derivatives.
#pragma once

#include <Eigen/Dense>
#include <utility>
#include <vector>

#include "feltmb/model/channels.hpp"
#include "feltmb/sensitivity/trajectory.hpp"
#include "shifted_models.hpp"
#include "switches.hpp"

namespace feltmb::detail {

/// An extremum is an event. With g the output, D its derivatives at a fixed time and r its rate,
/// shortly before (1) and after (2) the extremum, both follow from g = D p + r t on each side:
///   dt/dp = -(D2 - D1) / (r2 - r1),  dg/dp = (r2 D1 - r1 D2) / (r2 - r1).
/// At a smooth extremum (r2 = -r1) that is the mean, i.e. the derivative at a fixed time; at a kink
/// it includes the change of the time at which the branches meet.
class Looks {
 public:
  Looks(Trajectory& trajectory, ShiftedModels& models, const Channels& channels,
        const std::vector<Switch>& switches);

  /// Adds a look; its times are those of the trajectory.
  /// @param contact  whose force is meant in place of an output, or -1
  void add(const SensitivityRequest& look, int contact = -1);

  /// Times at which take() must be called, in order.
  std::vector<double> times() const;

  /// Takes the columns at a time. `shift`: d time by column that removes the common shift in time,
  /// see Variational::follow; `version` counts its changes.
  void take(double t, const Columns& columns, const Eigen::VectorXd& shift, long version);

  std::vector<SensitivityValue> finish();

 private:
  /// Smooth stretch of the motion between two switches.
  struct Piece {
    double begin, end;
  };
  struct Side {
    double time = 0.0;
    double rate = 0.0;
    Eigen::VectorXd derivative;  ///< with the shift
    Eigen::VectorXd shift;       ///< empty: none
    long version = 0;
  };
  struct Found {
    double time = 0.0, value = 0.0;
    double before = 0.0, after = 0.0;  ///< times of the two sides; equal at an edge
    double jump = 0.0;                 ///< of the output there
  };
  struct Sought {
    SensitivityRequest look;
    int contact = -1;
    SensitivityValue out;
    std::vector<Side> sides;
  };

  void evaluate(const Sought& s, MechanismSystem& system, double t, std::span<const double> y,
                std::span<double> out);
  double value(const Sought& s, double t);
  double rate(const Sought& s, double t);
  Piece piece(double t) const;
  void locate(Sought& s);
  Found refine(const Sought& s, double low, double high);
  void add_side(Sought& s, double t);

  Trajectory& trajectory_;
  ShiftedModels& models_;
  const Channels& channels_;
  std::vector<Piece> pieces_;
  std::vector<Sought> sought_;
  std::vector<double> y_, scratch_;
  Eigen::VectorXd slope_;
  Eigen::MatrixXd derivative_;
};

}  // namespace feltmb::detail
