/// Where the bodies, contacts and beams of a mechanism are in given poses, for drawings.
#pragma once

#include <Eigen/Dense>
#include <array>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "feltmb/planar/dynamics.hpp"

namespace feltmb {

/// A mechanism in many poses, one a row.
struct Poses {
  std::vector<std::string> names;  ///< of the bodies
  Eigen::MatrixXd bodies;          ///< x, y [m], angle [rad] of each, side by side
  std::vector<int> numbers;        ///< of the contacts, without that of the finger
  Eigen::MatrixXd contacts;        ///< x, y [m] and unit normal of each
  /// By name of a flexible beam: points of its centerline [m] in the frame of its clamped end.
  std::vector<std::pair<std::string, Eigen::MatrixXd>> beams;
};

/// Origin x, y [m] and angle [rad] of a body in the ground frame.
std::array<double, 3> pose_of(const Dynamics& dynamics, const Placement& placement);

/// Points (count, 2) [m] of the centerline of a beam in its own clamped frame.
Eigen::MatrixXd centerline(const FlexibleBeam& beam, const Eigen::VectorXd& q, int count);

/// The pose `q` with strings at rest: places of bodies and points. Throws InvalidParameter.
Dynamics located(const std::shared_ptr<const Mechanism>& mechanism, const Eigen::VectorXd& q);

/// Place of the finger's point along its direction [m]. Throws InvalidParameter.
double finger_place(const std::shared_ptr<const Mechanism>& mechanism, const Eigen::VectorXd& q);

/// All poses, a row of `q` each; `count` points of a centerline. Throws InvalidParameter.
Poses poses_along(const std::shared_ptr<const Mechanism>& mechanism, const Eigen::MatrixXd& q,
                  int count);

}  // namespace feltmb
