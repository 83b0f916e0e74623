/// Rest pose of a mechanism under gravity.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "feltmb/planar/dynamics.hpp"

namespace feltmb {

struct Equilibrium {
  std::vector<double> q;                    ///< rest pose [rad, m]
  std::vector<double> eta;                  ///< static modal coordinates of the strings [m kg^1/2]
  std::vector<double> law;                  ///< states of the contact laws, at rest
  std::vector<double> largest_compression;  ///< remembered by each contact [m]
  int iterations = 0;
  double residual = 0.0;  ///< largest |Q_k| x coordinate_scale [J]
};

/// Minimizes the potential energy (gravity, springs, straps, loading curves of the contacts;
/// friction holds nothing at rest) by Newton's method with a trust region, from the mechanism's
/// start pose. Strings take their static deflection.
///
/// A constant finger force may act. With `near`, a pose close to rest, the search starts there and
/// goes on until rounding stops it: derivatives are taken from such poses. Throws ModelError that
/// names the coordinates which do not come to rest when no stable equilibrium is reached.
Equilibrium find_equilibrium(const std::shared_ptr<const Mechanism>& mechanism,
                             double finger_force = 0.0, std::span<const double> near = {});

}  // namespace feltmb
